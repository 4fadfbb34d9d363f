from .estimator import DynsrRegressor
from .prediction import predict
from .result import Discovery
from .scoring import (
    Score,
    equation_rmse,
    printed_loss,
    score_expressions,
    score_model,
    trajectory_loss,
)
from .search import discover
from .uncertainty import bootstrap

__all__ = [
    "Discovery",
    "DynsrRegressor",
    "Score",
    "bootstrap",
    "discover",
    "equation_rmse",
    "predict",
    "printed_loss",
    "score_expressions",
    "score_model",
    "trajectory_loss",
]
