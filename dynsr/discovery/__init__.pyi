from .estimator import DynsrRegressor
from .prediction import predict
from .result import Discovery
from .scoring import (
    Score,
    equation_rmse,
    score_expressions,
    trajectory_loss,
    trajectory_losses,
)
from .search import DiscoverySettings, discover
from .uncertainty import bootstrap

__all__ = [
    "Discovery",
    "DiscoverySettings",
    "DynsrRegressor",
    "Score",
    "bootstrap",
    "discover",
    "equation_rmse",
    "predict",
    "score_expressions",
    "trajectory_loss",
    "trajectory_losses",
]
