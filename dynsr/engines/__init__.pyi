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
from .embedded import EmbeddedEngine
from .julia.diffeqpy import DiffeqpyEngine
from .julia.setup import install
from .registry import DEFAULT_ENGINE, ENGINES, find_engine, share_engine
from .simulation import add_noise, simulate, training_trajectory
from .testing import RecordingEngine
from .tsit5.single import interpolate, replay_steps

__all__ = [
    "DEFAULT_ABSTOL",
    "DEFAULT_ENGINE",
    "DEFAULT_RELTOL",
    "ENGINES",
    "AbstractEngine",
    "DiffeqpyEngine",
    "EmbeddedEngine",
    "InitialValueProblem",
    "Integration",
    "Optimizer",
    "RecordingEngine",
    "Release",
    "SparseProblem",
    "SparseSolution",
    "add_noise",
    "find_engine",
    "install",
    "interpolate",
    "replay_steps",
    "share_engine",
    "simulate",
    "training_trajectory",
]
