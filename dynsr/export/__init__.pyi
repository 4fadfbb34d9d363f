from .formats import FORMATS, find_format, save_format, write_format
from .source import Source

__all__ = [
    "FORMATS",
    "Source",
    "find_format",
    "save_format",
    "write_format",
]
