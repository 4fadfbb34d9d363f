from .data import (
    SYSTEMS,
    Description,
    Samples,
    System,
    Trajectory,
    describe,
    find_system,
    make_samples,
)
from .discovery import (
    Discovery,
    DiscoverySettings,
    DynsrRegressor,
    Parameter,
    Parameters,
    ParametricSystem,
    Score,
    TrajectoryRegressor,
    bootstrap,
    discover,
    equation_rmse,
    score_expressions,
    trajectory_loss,
)
from .engines import add_noise, find_engine, simulate
from .errors import DynsrError, EngineError, EngineUnavailable, InputError
from .expression import parse
from .fit import Candidate, ParetoFront
from .methods import (
    AbstractMethod,
    DynAIFeynman,
    GeneticAlgorithm,
    RationalSearch,
    SINDy,
    make_method,
)
from .paper import audit, printed_loss, replicate

__version__: str

__all__ = [
    "SYSTEMS",
    "AbstractMethod",
    "Candidate",
    "Description",
    "Discovery",
    "DiscoverySettings",
    "DynAIFeynman",
    "DynsrError",
    "DynsrRegressor",
    "EngineError",
    "EngineUnavailable",
    "GeneticAlgorithm",
    "InputError",
    "Parameter",
    "Parameters",
    "ParametricSystem",
    "ParetoFront",
    "RationalSearch",
    "SINDy",
    "Samples",
    "Score",
    "System",
    "Trajectory",
    "TrajectoryRegressor",
    "__version__",
    "add_noise",
    "audit",
    "bootstrap",
    "describe",
    "discover",
    "equation_rmse",
    "find_engine",
    "find_system",
    "make_method",
    "make_samples",
    "parse",
    "printed_loss",
    "replicate",
    "score_expressions",
    "simulate",
    "trajectory_loss",
]
