from .forms import MOST_INSIDE, Form, Library, LibrarySettings
from .prior import (
    Place,
    Prior,
    Written,
    exact_bits,
    read_body,
    read_equation,
    textbooks,
    write_down,
)

__all__ = [
    "MOST_INSIDE",
    "Form",
    "Library",
    "LibrarySettings",
    "Place",
    "Prior",
    "Written",
    "exact_bits",
    "read_body",
    "read_equation",
    "textbooks",
    "write_down",
]
