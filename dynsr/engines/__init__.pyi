from .adaptive import EXPLICIT, Motion, follow, rows_of
from .base import (
    DEFAULT_ABSTOL,
    DEFAULT_RELTOL,
    AbstractEngine,
    InitialValueProblem,
    Integration,
    Optimizer,
    Release,
    SparseProblem,
    SparseSolution,
)
from .drives import Drive, jumps_of
from .embedded import EmbeddedEngine
from .equilibria import (
    Branches,
    FixedPoint,
    Linearisation,
    find_fixed_points,
    follow_parameter,
    linearise,
)
from .julia.diffeqpy import DiffeqpyEngine
from .julia.setup import install, is_configured, note_julia
from .registry import (
    DEFAULT_ENGINE,
    ENGINES,
    START_NOTES,
    find_engine,
    is_embedded,
    refuse_idle,
    share_engine,
    start_engine,
)
from .simulation import DRIVEN, add_noise, simulate, simulate_driven, training_trajectory
from .testing import RecordingEngine
from .tsit5.single import interpolate, replay_steps

__all__ = [
    "DEFAULT_ABSTOL",
    "DEFAULT_ENGINE",
    "DEFAULT_RELTOL",
    "DRIVEN",
    "ENGINES",
    "EXPLICIT",
    "START_NOTES",
    "AbstractEngine",
    "Branches",
    "DiffeqpyEngine",
    "Drive",
    "EmbeddedEngine",
    "FixedPoint",
    "InitialValueProblem",
    "Integration",
    "Linearisation",
    "Motion",
    "Optimizer",
    "RecordingEngine",
    "Release",
    "SparseProblem",
    "SparseSolution",
    "add_noise",
    "find_engine",
    "find_fixed_points",
    "follow",
    "follow_parameter",
    "install",
    "interpolate",
    "is_configured",
    "is_embedded",
    "jumps_of",
    "linearise",
    "note_julia",
    "refuse_idle",
    "replay_steps",
    "rows_of",
    "share_engine",
    "simulate",
    "simulate_driven",
    "start_engine",
    "training_trajectory",
]
