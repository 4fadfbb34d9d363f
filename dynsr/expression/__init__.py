"""Expressions: the operator table, a parser without ``eval``, evaluation, text and complexity."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
