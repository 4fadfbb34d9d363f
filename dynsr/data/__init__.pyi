from .catalogue import DEFINITIONS, find_definition
from .reading import read_trajectories, split_held_back, take_trajectories, write_csv
from .samples import SCHEMES, Samples, make_samples
from .slopes import choose_samples, estimate_noise
from .system import PAPER_SYSTEMS, SYSTEMS, System, find_system
from .trajectory import Trajectory

__all__ = [
    "DEFINITIONS",
    "PAPER_SYSTEMS",
    "SCHEMES",
    "SYSTEMS",
    "Samples",
    "System",
    "Trajectory",
    "choose_samples",
    "estimate_noise",
    "find_definition",
    "find_system",
    "make_samples",
    "read_trajectories",
    "split_held_back",
    "take_trajectories",
    "write_csv",
]
