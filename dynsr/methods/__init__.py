"""Methods that search for the equation of one state: the GA, SINDy, DynAIFeynman, ratios."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
