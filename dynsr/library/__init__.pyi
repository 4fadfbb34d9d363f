from .atoms import FEW
from .forms import Form, Library, LibrarySettings
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
from .structure import find_coordinates, find_turning, structure_in, structure_of
from .values import FormValues

__all__ = [
    "FEW",
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
    "find_turning",
    "read_body",
    "read_equation",
    "structure_in",
    "structure_of",
    "textbooks",
    "write_down",
]
