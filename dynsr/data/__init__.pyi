from .catalogue import DEFINITIONS, find_definition
from .reading import read_trajectories, split_held_back, take_trajectories, write_csv
from .samples import SCHEMES, Samples, make_samples
from .slopes import SlopeSettings, choose_samples, measurement_noise, robust_scale
from .system import PAPER_SYSTEMS, SYSTEMS, System, find_system
from .trajectory import Trajectory

__all__ = [
    "DEFINITIONS",
    "PAPER_SYSTEMS",
    "SCHEMES",
    "SYSTEMS",
    "Samples",
    "SlopeSettings",
    "System",
    "Trajectory",
    "choose_samples",
    "find_definition",
    "find_system",
    "make_samples",
    "measurement_noise",
    "read_trajectories",
    "robust_scale",
    "split_held_back",
    "take_trajectories",
    "write_csv",
]
