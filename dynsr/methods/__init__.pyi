from .base import AbstractMethod, Progress, Report, silent
from .genetic import GeneticAlgorithm
from .library import Library
from .registry import METHODS, choose_methods, make_method
from .sindy import SINDy

__all__ = [
    "AbstractMethod",
    "GeneticAlgorithm",
    "Library",
    "METHODS",
    "Progress",
    "Report",
    "SINDy",
    "choose_methods",
    "make_method",
    "silent",
]
