from .candidates import Candidate, ParetoFront, r_squared, rmse, score_candidate
from .collocation import (
    Collocation,
    CollocationFit,
    CollocationSettings,
    Linearised,
    Measurements,
    Mesh,
)
from .constants import free_constants, refit, skeleton
from .description import (
    choose,
    constant_bits,
    data_bits,
    description_length,
    information_criterion,
    mean_error_bits,
    shift_bits,
    structure_bits,
)
from .exact import confirm, simplest_form
from .flow import Flow, Windows, cut_windows
from .forced import missing_terms
from .linear import (
    RatioFit,
    cauchy_weights,
    eliminate,
    fit_ratio,
    fit_robustly,
    linearly_independent,
)
from .losses import LOSSES, Loss, LossFunction, judge_by_loss, read_loss
from .noise import (
    FINEST_SLOPES,
    Noise,
    independent_rows,
    is_noisy,
    noise_and_spread,
    noise_of,
    residual_noise,
    slope_size,
)
from .parsimony import collapse, without_flat_line
from .polishing import polish
from .settings import FitSettings
from .shooting import (
    Match,
    Shooting,
    build_shooting,
    choose_substeps,
    drives_of,
    match_trajectories,
    prepare,
    read_inputs,
)
from .simple import simplicity_bits
from .snapping import one_a_shape, score_snapped, snap_best, tidy
from .variation import improve, loosen, neighbours, with_floats

__all__ = [
    "FINEST_SLOPES",
    "LOSSES",
    "Candidate",
    "Collocation",
    "CollocationFit",
    "CollocationSettings",
    "FitSettings",
    "Flow",
    "Linearised",
    "Loss",
    "LossFunction",
    "Match",
    "Measurements",
    "Mesh",
    "Noise",
    "ParetoFront",
    "RatioFit",
    "Shooting",
    "Windows",
    "build_shooting",
    "cauchy_weights",
    "choose",
    "choose_substeps",
    "collapse",
    "confirm",
    "constant_bits",
    "cut_windows",
    "data_bits",
    "description_length",
    "drives_of",
    "eliminate",
    "fit_ratio",
    "fit_robustly",
    "free_constants",
    "improve",
    "independent_rows",
    "information_criterion",
    "is_noisy",
    "judge_by_loss",
    "linearly_independent",
    "loosen",
    "match_trajectories",
    "mean_error_bits",
    "missing_terms",
    "neighbours",
    "noise_and_spread",
    "noise_of",
    "one_a_shape",
    "polish",
    "prepare",
    "r_squared",
    "read_inputs",
    "read_loss",
    "refit",
    "residual_noise",
    "rmse",
    "score_candidate",
    "score_snapped",
    "shift_bits",
    "simplest_form",
    "simplicity_bits",
    "skeleton",
    "slope_size",
    "snap_best",
    "structure_bits",
    "tidy",
    "with_floats",
    "without_flat_line",
]
