from .asked import AskedMethod, fit_polynomials
from .base import AbstractMethod, Progress, Report, silent
from .demands import Constraints, Demands, Must, read_demands
from .feynman.search import STAGES, DynAIFeynman
from .genetic import GeneticAlgorithm
from .library import Library, polynomials, trigonometrics
from .limits import Limits
from .parts import AbstractKeeper, keeping, recalled
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
    "STAGES",
    "AbstractKeeper",
    "AbstractMethod",
    "AskedMethod",
    "Constraints",
    "Demands",
    "DynAIFeynman",
    "GeneticAlgorithm",
    "Library",
    "Limits",
    "Must",
    "Progress",
    "RationalSearch",
    "Report",
    "SINDy",
    "choose_methods",
    "describe_methods",
    "describe_presets",
    "find_method",
    "fit_polynomials",
    "keeping",
    "make_method",
    "polynomials",
    "read_demands",
    "recalled",
    "silent",
    "trigonometrics",
]
