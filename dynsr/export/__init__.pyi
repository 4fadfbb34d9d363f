from .formats import (
    FORMATS,
    find_format,
    list_formats,
    name_file,
    pack_format,
    save_format,
    write_format,
)
from .from_petab import read_petab
from .from_sbml import read_sbml
from .objects import make_casadi, make_control, make_do_mpc
from .source import Source

__all__ = [
    "FORMATS",
    "Source",
    "find_format",
    "list_formats",
    "make_casadi",
    "make_control",
    "make_do_mpc",
    "name_file",
    "pack_format",
    "read_petab",
    "read_sbml",
    "save_format",
    "write_format",
]
