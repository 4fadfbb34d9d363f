"""Discovery: from trajectories to the equations of every state, and what is done with them."""

import lazy_loader

from dynsr.arguments import moved_exports, renamed_exports

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = moved_exports(__getattr__, "dynsr.verdict", "dynsr.parameters")
__getattr__ = renamed_exports(__name__, __getattr__, Rival="OtherFormula")
