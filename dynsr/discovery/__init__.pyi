from .batch import EACH, Discovered, discover_each, read_batch
from .by_run import RunParameters
from .cut_short import keep_formulas, next_to_data
from .delays import Delay, DelaySettings
from .diffusion import Cells, Diffusion, DiffusionTerm, cells_of
from .estimator import DynsrRegressor
from .every_row import name_windows
from .free_parts import FreePart, FreeParts, FreeSettings
from .hybrid import HybridModel
from .identifying import Identifiability, IdentifiabilitySettings, identifiability
from .intervals import Constant, write_interval
from .orders import write_lines
from .parameters import Parameter, Parameters, ParametricSystem
from .problem import DISCOVERY, DiscoverySettings
from .profile import Profile
from .records import RECORD, is_own_record
from .result import Discovery, Inclusion, is_own_data, keep, load
from .search import discover
from .second_order import explain_order
from .suggesting import Alternative, Experiment, Suggestion, SuggestionSettings
from .trajectory_estimator import TrajectoryRegressor
from .uncertainty import bootstrap
from .varying import VarySettings

__all__ = [
    "DISCOVERY",
    "EACH",
    "RECORD",
    "Alternative",
    "Cells",
    "Constant",
    "Delay",
    "DelaySettings",
    "Diffusion",
    "DiffusionTerm",
    "Discovered",
    "Discovery",
    "DiscoverySettings",
    "DynsrRegressor",
    "Experiment",
    "FreePart",
    "FreeParts",
    "FreeSettings",
    "HybridModel",
    "Identifiability",
    "IdentifiabilitySettings",
    "Inclusion",
    "Parameter",
    "Parameters",
    "ParametricSystem",
    "Profile",
    "RunParameters",
    "Suggestion",
    "SuggestionSettings",
    "TrajectoryRegressor",
    "VarySettings",
    "bootstrap",
    "cells_of",
    "discover",
    "discover_each",
    "explain_order",
    "identifiability",
    "is_own_data",
    "is_own_record",
    "keep",
    "keep_formulas",
    "load",
    "name_windows",
    "next_to_data",
    "read_batch",
    "write_interval",
    "write_lines",
]
