"""Summary: what a saved discovery keeps of data that it does not hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dynsr.arguments import checked
from dynsr.data import Trajectory
from dynsr.errors import InputError


@checked
@dataclass(frozen=True)
class DataSummary:
    """What is known of the data without them.

    Parameters
    ----------
    start : state -> its value at the first time of the first trajectory.
    span : (first, last) time of the first trajectory.
    step : the median time from row to row.
    spread : state -> standard deviation of all its values.
    covariance : (p, p) covariance of the parameters, in their order; empty where it is not known,
        inf where the data do not determine it.

    >>> DataSummary({"x": 1.0}, (0.0, 2.0), 0.5, {"x": 0.3}).step
    0.5
    """

    start: dict[str, float]
    span: tuple[float, float]
    step: float
    spread: dict[str, float] = field(default_factory=dict)
    covariance: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        """Check what a file may say otherwise; raises InputError."""
        first, last = self.span
        finite = [*self.start.values(), *self.spread.values(), first, last, self.step]
        if not all(map(math.isfinite, finite)):
            raise InputError("a number of the data's summary is not finite; save it again")
        if not (0 < self.step <= last - first and math.isfinite((last - first) / self.step)):
            raise InputError(f"no data go from {first:g} to {last:g} by {self.step:g}")
        if any(len(row) != len(self.covariance) for row in self.covariance):
            raise InputError("the covariance of the data's summary is no square; save it again")


def summarise(runs: Sequence[Trajectory], states: Sequence[str]) -> DataSummary:
    """Give what is kept of data.

    Parameters
    ----------
    runs : the trajectories, the states of which are measured at the first time.
    states : the states that have equations.

    >>> run = Trajectory(np.array([0.0, 1.0, 2.0]), np.array([[1.0], [2.0], [3.0]]), ("x",))
    >>> summarise([run], ["x"]).start
    {'x': 1.0}
    """
    first = runs[0]
    own = [state for state in states if state in first.states]
    columns = {s: np.concatenate([run.x[:, run.index(s)] for run in runs]) for s in own}
    return DataSummary(
        {s: float(first.x[0, first.index(s)]) for s in own},
        (float(first.t[0]), float(first.t[-1])),
        float(np.median(np.diff(first.t))),
        {s: float(np.nanstd(values)) for s, values in columns.items()},
    )
