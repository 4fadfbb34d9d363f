from .formats import FORMATS, find_format, save_format, write_format
from .from_petab import read_petab
from .from_sbml import read_sbml
from .source import Source

__all__ = [
    "FORMATS",
    "Source",
    "find_format",
    "read_petab",
    "read_sbml",
    "save_format",
    "write_format",
]
