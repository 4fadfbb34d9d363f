from .forms import Form, Library, LibrarySettings

__all__ = ["Form", "Library", "LibrarySettings"]
