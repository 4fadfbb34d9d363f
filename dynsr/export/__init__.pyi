from .formats import FORMATS, find_format, save_format, write_format
from .from_petab import read_petab
from .from_sbml import read_sbml
from .objects import make_casadi, make_control, make_do_mpc
from .source import Source

__all__ = [
    "FORMATS",
    "Source",
    "find_format",
    "make_casadi",
    "make_control",
    "make_do_mpc",
    "read_petab",
    "read_sbml",
    "save_format",
    "write_format",
]
