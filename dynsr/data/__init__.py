"""Data: systems, trajectories and samples as values; reading what users have; slopes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
