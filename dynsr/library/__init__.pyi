from .forms import Form, Library, LibrarySettings
from .prior import Place, Prior, Written, read_body, read_equation, textbooks, write_down

__all__ = [
    "Form",
    "Library",
    "LibrarySettings",
    "Place",
    "Prior",
    "Written",
    "read_body",
    "read_equation",
    "textbooks",
    "write_down",
]
