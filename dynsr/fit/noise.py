"""Noise: how much of the residuals nothing can explain, and how many of them are independent.

:func:`dynsr.data.measurement_noise` is another thing: the noise of the measured states themselves,
known before any formula is. Here the noise is that of a fit, read from its residuals.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dynsr.data import SCHEMES, Samples, Trajectory, measurement_noise, scale_of
from dynsr.expression import REAL_RESOLUTION, evaluate
from dynsr.fit.candidates import Candidate

# Share of the slopes below which nothing is told apart, unless the slopes were given: what remains
# of the bias of central differences is a function of the states, which a long formula can follow.
FINEST_SLOPES = 1e-6
# Noise above this share of a state's spread makes slopes too unsure to snap constants on them.
NOISY = 1e-5
# Sums or means of squared residuals, in units of the noise or the spread, are never thought less.
FLOOR = 1e-12
# Slopes of less relative error are exact; misses of more than the other share explain nothing.
EXACT = 1e-3
UNEXPLAINED = 0.05


@dataclass(frozen=True)
class Noise:
    """What cannot be explained: ``floor`` in units of y, and how many rows are independent."""

    floor: float
    effective_rows: float


def independent_rows(misses: np.ndarray, rows_per_run: float = 2.0) -> np.ndarray:
    """Count the independent rows among correlated residuals.

    Residuals of a trajectory keep their sign over many rows. A run of one sign counts as
    ``rows_per_run`` rows, and n rows of white noise have n / 2 runs (Wald and Wolfowitz 1940), so
    that white noise counts as it is; never more than there are.

    Parameters
    ----------
    misses : (n, k, W) residuals of k states at n times of W windows.
    rows_per_run : rows that a run of one sign counts as.

    Gives (k,).

    >>> independent_rows(np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0]).reshape(6, 1, 1))
    array([4.])
    """
    signs = np.signbit(misses)
    runs = misses.shape[2] + np.count_nonzero(signs[1:] != signs[:-1], axis=(0, 2))
    return np.minimum(rows_per_run * runs, float(misses.shape[0] * misses.shape[2]))


def residual_noise(
    residuals: Iterable[np.ndarray], y: np.ndarray, rows_per_run: float = 2.0
) -> Noise:
    """Take the noise from the residuals of the formula that explains most rows best.

    The floor is the smallest median of |r| over the given residual vectors (n,), at least 2^-30 of
    the size of ``y`` (n,); the independent rows are :func:`independent_rows` of that vector.

    >>> residual_noise([np.array([1.0, -1.0, 1.0, -1.0])], np.ones(4))
    Noise(floor=1.0, effective_rows=4.0)
    """
    size = float(np.sqrt(np.mean(np.square(y)))) or 1.0
    best, floor = np.zeros(len(y)), math.inf
    for residual in residuals:
        median = float(np.median(np.abs(residual)))
        if median < floor:
            best, floor = residual, median
    if not math.isfinite(floor):
        floor = size
    if floor <= REAL_RESOLUTION * size:
        # Rounding errors are no noise: their signs say nothing, and every row is exact.
        return Noise(REAL_RESOLUTION * size, float(len(y)))
    return Noise(floor, float(independent_rows(best[:, None, None], rows_per_run)[0]))


def slope_size(samples: Samples) -> float:
    """Root mean square of the slopes; 1 where all are 0."""
    return float(np.sqrt(np.mean(np.square(samples.y)))) or 1.0


def is_exact(samples: Samples) -> bool:
    """Say whether the slopes' own error is known, and below a thousandth of their size."""
    return samples.noise is not None and samples.noise <= EXACT * slope_size(samples)


def residuals(candidate: Candidate, samples: Samples) -> np.ndarray:
    """(n,) y - f(X), or what their own loss makes of it."""
    return samples.residuals(evaluate(candidate.expr, samples.columns))


def noise_of(candidates: Iterable[Candidate], samples: Samples) -> Noise:
    """Estimate the noise of samples from the residuals of many candidates.

    Errors of plain differences change their sign inside every step of the solver that made the
    states and average out; those of a smoother are correlated over its whole window, beyond the
    runs of their sign, and count half. Slopes that were not given are never surer than a millionth
    of their size. Where exact slopes are explained by none of the candidates, what these leave is
    no noise: the floor is the slopes' own error, and every row counts.
    """
    misses = (residuals(c, samples) for c in candidates)
    if samples.scheme == "given":
        return residual_noise(misses, samples.y)
    noise = residual_noise(misses, samples.y, 2.0 if samples.scheme in SCHEMES else 1.0)
    size = slope_size(samples)
    if is_exact(samples) and noise.floor > UNEXPLAINED * size:
        return Noise(max(float(samples.noise or 0.0), FINEST_SLOPES * size), float(len(samples)))
    return Noise(max(noise.floor, FINEST_SLOPES * size), noise.effective_rows)


def noise_and_spread(runs: Sequence[Trajectory]) -> tuple[np.ndarray, np.ndarray]:
    """Measurement noise and spread (both standard deviations) of every state, (k,) each.

    The noise is the mean over the trajectories of more than four rows; 0 where all are shorter, and
    of a state that was never measured, whose spread is that of its curve.
    """
    long = [measurement_noise(run) for run in runs if len(run) > 4]
    noise = np.zeros(len(runs[0].states))
    if long:
        told = np.isfinite(long)
        noise = np.sum(np.where(told, long, 0.0), axis=0) / np.maximum(np.sum(told, axis=0), 1)
    return noise, spread_of(runs)


def spread_of(runs: Sequence[Trajectory]) -> np.ndarray:
    """(k,) scale of each state where it was measured, or of its curve if nowhere."""
    found = []
    for place in range(len(runs[0].states)):
        seen = np.concatenate([run.x[run.measured[:, place], place] for run in runs])
        whole = seen if len(seen) else np.concatenate([run.x[:, place] for run in runs])
        found.append(scale_of(whole))
    return np.array(found)


def is_noisy(runs: Sequence[Trajectory]) -> bool:
    """Say whether measurement noise of a state is above 1e-5 of its spread.

    A state that was not measured at every row counts as noisy: where it starts is to be fitted.
    """
    if any(run.unmeasured.size for run in runs):
        return True
    noise, spread = noise_and_spread(runs)
    return bool(np.any(noise > NOISY * spread))
