"""dynsr: the equations of a dynamical system from its trajectories, as formulas you can read."""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
