"""Parameters: the constants of a found law, and how far the data determine them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
