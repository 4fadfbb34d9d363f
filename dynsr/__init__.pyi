from .data import (
    SYSTEMS,
    Description,
    Samples,
    System,
    Trajectory,
    add_doses,
    describe,
    find_system,
    make_samples,
)
from .discovery import (
    Discovery,
    DiscoverySettings,
    DynsrRegressor,
    TrajectoryRegressor,
    bootstrap,
    discover,
    load,
)
from .engines import add_noise, find_engine, simulate
from .errors import DynsrError, EngineError, EngineUnavailable, InputError
from .export import read_petab, read_sbml
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
from .parameters import Parameter, Parameters, ParametricSystem, identifiability
from .verdict import Score, equation_rmse, score_expressions, trajectory_loss

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
    "add_doses",
    "add_noise",
    "audit",
    "bootstrap",
    "describe",
    "discover",
    "equation_rmse",
    "find_engine",
    "find_system",
    "identifiability",
    "load",
    "make_method",
    "make_samples",
    "parse",
    "printed_loss",
    "read_petab",
    "read_sbml",
    "replicate",
    "score_expressions",
    "simulate",
    "trajectory_loss",
]
