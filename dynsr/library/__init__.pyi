from .atoms import FEW
from .forms import Form, Library, LibrarySettings
from .inside import unusual_bits
from .prior import (
    Place,
    Prior,
    Term,
    Written,
    exact_bits,
    read_body,
    read_equation,
    textbooks,
    write_down,
)
from .repeats import INSIDE, find_repeats
from .structure import find_coordinates, find_turning, structure_in, structure_of
from .values import FormValues

__all__ = [
    "FEW",
    "INSIDE",
    "Form",
    "FormValues",
    "Library",
    "LibrarySettings",
    "Place",
    "Prior",
    "Term",
    "Written",
    "exact_bits",
    "find_coordinates",
    "find_repeats",
    "find_turning",
    "read_body",
    "read_equation",
    "structure_in",
    "structure_of",
    "textbooks",
    "unusual_bits",
    "write_down",
]
