"""Verdict: how far equations can be trusted: against the data, other formulas or a known truth."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
