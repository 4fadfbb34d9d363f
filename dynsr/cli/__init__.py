"""The ``dynsr`` command: one verb a task, one file a group of commands."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
