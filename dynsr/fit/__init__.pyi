from .candidates import Candidate, ParetoFront, rmse, score_candidate
from .constants import free_constants, refit, skeleton
from .description import Noise, choose, data_bits, description_length, estimate_noise, noise_of
from .flow import Flow, KeptWindows, ProbedFlow, Windows, cut_windows
from .linear import fit_robustly
from .polishing import polish
from .shooting import (
    Shooting,
    build_shooting,
    choose_substeps,
    drives_of,
    is_noisy,
    prepare,
    read_inputs,
)
from .snapping import MOST_CONSTANTS, one_a_shape, score_snapped, snap_best, tidy
from .variation import improve, loosen, neighbours

__all__ = [
    "Candidate",
    "Flow",
    "KeptWindows",
    "MOST_CONSTANTS",
    "Noise",
    "ParetoFront",
    "ProbedFlow",
    "Shooting",
    "Windows",
    "build_shooting",
    "choose",
    "choose_substeps",
    "cut_windows",
    "data_bits",
    "description_length",
    "drives_of",
    "estimate_noise",
    "fit_robustly",
    "free_constants",
    "improve",
    "is_noisy",
    "loosen",
    "neighbours",
    "noise_of",
    "one_a_shape",
    "polish",
    "prepare",
    "read_inputs",
    "refit",
    "rmse",
    "score_candidate",
    "score_snapped",
    "skeleton",
    "snap_best",
    "tidy",
]
