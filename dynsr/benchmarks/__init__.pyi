from .noise import Recovery, Search, measure_recovery
from .zoo.catalogue import find_animals
from .zoo.conditions import draw_conditions
from .zoo.random_systems import draw_systems
from .zoo.running import ZooRecord, make_methods, run_zoo, score_table, verdict_table
from .zoo.suite import read_suite
from .zoo.system import ZooSystem

__all__ = [
    "Recovery",
    "Search",
    "ZooRecord",
    "ZooSystem",
    "draw_conditions",
    "draw_systems",
    "find_animals",
    "make_methods",
    "measure_recovery",
    "read_suite",
    "run_zoo",
    "score_table",
    "verdict_table",
]
