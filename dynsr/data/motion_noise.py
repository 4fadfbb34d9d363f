"""Noise in the motion: how much of the noise of a state is in its motion, seen without an equation.

The value between two others, less the line through these, has a variance that errors of measurement
make the same at every distance h. Noise in the motion makes it grow as h, and a smooth motion as
h^4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from dynsr.data.noise_model import robust_scale
from dynsr.data.trajectory import Trajectory


@dataclass(frozen=True)
class MotionNoise:
    """What differences of one state say of its noise.

    Parameters
    ----------
    diffusion : variance of its change in unit time, more than 0.
    error : standard deviation of its measurement.
    share : of the variance of a value between its two neighbours, the share that is noise in the
        motion.
    rows : values between two others.
    """

    diffusion: float
    error: float
    share: float
    rows: int

    @property
    def is_sure(self) -> bool:
        """Whether most of the noise is in the motion for sure."""
        return self.rows > 0 and self.share > 0.5 + 4 / math.sqrt(self.rows)


def measure_motion_noise(
    runs: Sequence[Trajectory], state: str, lags: Sequence[int] = (1, 2, 3, 4), least: float = 1e-9
) -> MotionNoise:
    """Say how much of the noise of a state is in its motion.

    Parameters
    ----------
    runs : trajectories of the same columns.
    state : which state.
    lags : rows between the values that are compared.
    least : share of the noise that is in the motion where none is seen.

    >>> walk = np.cumsum(np.random.default_rng(0).standard_normal(5000))
    >>> found = measure_motion_noise([Trajectory(np.arange(5000.0), walk[:, None], ("x",))], "x")
    >>> round(found.diffusion, 1), round(found.share, 1), found.is_sure
    (0.9, 0.9, True)
    """
    place = runs[0].index(state)
    columns = [(run.t, run.observed[:, place]) for run in runs]
    design, target, counts = [], [], []
    for lag in lags:
        parts = list(_between(columns, lag))
        off, before, after = (np.concatenate([p[i] for p in parts]) for i in range(3))
        if len(off) < len(lags):
            return MotionNoise(1.0, 0.0, 0.0, 0)
        counts.append(len(off))
        # Where a state rests or jumps says nothing of the others.
        target.append(float(robust_scale(off)) ** 2)
        share, whole = before / (before + after), before + after
        square = before * after
        design.append(
            [
                np.mean(1 + (1 - share) ** 2 + share**2),
                np.mean(square / whole),
                np.mean(square**2),
            ]
        )
    rows, goal = np.array(design), np.array(target)
    if not np.all(goal > np.finfo(float).tiny):
        return MotionNoise(1.0, 0.0, 0.0, 0)
    scaled = rows / goal[:, None]
    unit = np.linalg.norm(scaled, axis=0)
    found = nnls(scaled / unit, np.ones(len(goal)))[0] / unit
    all_of_it = float(rows[0] @ found)
    in_motion = float(rows[0, 1] * found[1]) / all_of_it if all_of_it > 0 else 0.0
    smallest = max(least * float(goal[0] / rows[0, 1]), float(np.finfo(float).tiny))
    diffusion = max(float(found[1]), smallest)
    return MotionNoise(diffusion, math.sqrt(float(found[0])), in_motion, counts[0])


def _between(
    columns: Sequence[tuple[np.ndarray, np.ndarray]], lag: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Give how far values are off the line through two others, and the times to these."""
    for t, x in columns:
        last = max(len(t) - 2 * lag, 0)
        one, two = t[lag:][:last] - t[:last], t[2 * lag :][:last] - t[lag:][:last]
        with np.errstate(invalid="ignore", divide="ignore"):
            line = (two * x[:last] + one * x[2 * lag :][:last]) / (one + two)
            off = x[lag:][:last] - line
        told = np.isfinite(off)
        yield off[told], one[told], two[told]
