"""The local page: a CSV dropped in a browser becomes equations, for those who do not program."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
