from .base import AbstractMethod, Progress, Report, silent
from .feynman.search import DynAIFeynman
from .genetic import GeneticAlgorithm
from .library import Library, MonomialLibrary
from .rational import RationalSearch
from .registry import (
    AUTO,
    DEFAULT_PRESET,
    METHODS,
    PAPER_METHODS,
    PRESETS,
    choose_methods,
    describe_methods,
    describe_presets,
    find_method,
    make_method,
)
from .sindy import SINDy

__all__ = [
    "AUTO",
    "DEFAULT_PRESET",
    "METHODS",
    "PAPER_METHODS",
    "PRESETS",
    "AbstractMethod",
    "DynAIFeynman",
    "GeneticAlgorithm",
    "Library",
    "MonomialLibrary",
    "Progress",
    "RationalSearch",
    "Report",
    "SINDy",
    "choose_methods",
    "describe_methods",
    "describe_presets",
    "find_method",
    "make_method",
    "silent",
]
