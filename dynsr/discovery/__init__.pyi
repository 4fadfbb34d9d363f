from .batch import EACH, Discovered, discover_each, read_batch
from .cut_short import keep_formulas, next_to_data
from .estimator import DynsrRegressor
from .every_row import name_windows
from .hybrid import HybridModel
from .orders import write_lines
from .problem import DISCOVERY, DiscoverySettings
from .records import RECORD, is_own_record
from .result import Discovery, Inclusion, is_own_data, keep, load
from .search import discover
from .second_order import explain_order
from .trajectory_estimator import TrajectoryRegressor
from .uncertainty import bootstrap

__all__ = [
    "DISCOVERY",
    "EACH",
    "RECORD",
    "Discovered",
    "Discovery",
    "DiscoverySettings",
    "DynsrRegressor",
    "HybridModel",
    "Inclusion",
    "TrajectoryRegressor",
    "bootstrap",
    "discover",
    "discover_each",
    "explain_order",
    "is_own_data",
    "is_own_record",
    "keep",
    "keep_formulas",
    "load",
    "name_windows",
    "next_to_data",
    "read_batch",
    "write_lines",
]
