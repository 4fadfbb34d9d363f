"""Selection: from fronts to one equation per state, and whole systems compared."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
