"""Forecasting: how far equations miss data that they are integrated along."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy

from dynsr.methods.matching import build_shooting, choose_substeps, prepare
from dynsr.trajectory import Trajectory


def forecast_misses(
    exprs: Mapping[str, sympy.Expr],
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    inputs: Mapping[str, sympy.Expr] | None = None,
    window: int = 50,
) -> np.ndarray:
    """Give the sizes of the misses of W forecasts over ``window`` intervals, (window, k, W).

    Each starts at its first measurement; states without an expression are read from the data.
    In units of the spread; inf where a forecast diverges.

    >>> t = np.linspace(0, 1, 51)
    >>> decay = Trajectory(t, np.exp(-2 * t)[:, None], ("x",))
    >>> forecast_misses({"x": -2 * sympy.Symbol("x")}, decay).shape
    (50, 1, 1)
    """
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    flow, values, _ = prepare(exprs, runs, inputs or {})
    shooting = build_shooting(flow, runs, inputs or {}, window, False)
    with np.errstate(all="ignore"):
        starts, constants = shooting.windows.x[0], np.array(values)
        substeps = choose_substeps(shooting, constants, starts)
        misses = np.abs(replace(shooting, substeps=substeps).misses(constants, starts))
    return np.nan_to_num(misses, nan=np.inf, posinf=np.inf)


def forecast_miss(
    exprs: Mapping[str, sympy.Expr],
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    inputs: Mapping[str, sympy.Expr] | None = None,
) -> float:
    """Give the median of :func:`forecast_misses`; inf when most forecasts diverge."""
    return float(np.median(forecast_misses(exprs, trajectories, inputs=inputs)))
