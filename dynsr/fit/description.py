"""Description length: the bits a formula costs plus the bits its residuals cost.

With the noise floor eps and m independent residuals among n,

    L(f) = complexity(f) + m * mean_i log2(1 + (r_i / eps)^2) / 2.

A residual far above the floor costs log2(|r| / eps) bits, as in AI Feynman 2.0 (Udrescu et al.
2020, eq. 5); one below it costs next to nothing, so that a formula gains nothing by following
noise; and a few large residuals cost little, so that the errors of a few bad steps do not decide.
AI Feynman sets eps = 2^-30; here it is estimated from the data, because slopes taken from a
trajectory are never that exact.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dynsr.data import SCHEMES, Samples
from dynsr.expression import REAL_RESOLUTION, complexity, evaluate
from dynsr.fit.candidates import Candidate

# Share of the slopes below which nothing is told apart, unless the slopes were given.
_FINEST = 1e-6


@dataclass(frozen=True)
class Noise:
    """What cannot be explained: ``floor`` in units of y, and how many rows are independent."""

    floor: float
    effective_rows: float


def estimate_noise(
    residuals: Iterable[np.ndarray], y: np.ndarray, rows_per_run: float = 2.0
) -> Noise:
    """Take the noise from the residuals of the formula that explains most rows best.

    The floor is the smallest median of |r| over the given residual vectors, at least 2^-30 of the
    size of ``y``. Residuals of a trajectory keep their sign over many rows, so a run of one sign
    counts as ``rows_per_run`` independent rows (n rows of white noise have n / 2 runs).

    >>> estimate_noise([np.array([1.0, -1.0, 1.0, -1.0])], np.ones(4))
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
    runs = 1 + int(np.count_nonzero(np.diff(np.signbit(best))))
    return Noise(floor, float(min(len(y), rows_per_run * runs)))


def data_bits(residual: np.ndarray, noise: Noise) -> float:
    """Bits of the residuals: m * mean log2(1 + (r / eps)^2) / 2; inf where one is not finite.

    >>> round(data_bits(np.array([0.0, np.sqrt(3.0)]), Noise(1.0, 2.0)), 12)
    1.0
    """
    with np.errstate(all="ignore"):
        bits = float(np.mean(np.log2(1 + np.square(residual / noise.floor)))) / 2
    return noise.effective_rows * bits if math.isfinite(bits) else math.inf


def residuals(candidate: Candidate, samples: Samples) -> np.ndarray:
    """(n,) y - f(X)."""
    return samples.y - evaluate(candidate.expr, samples.columns)


def description_length(candidate: Candidate, samples: Samples, noise: Noise) -> float:
    """Bits of the formula plus bits of its residuals."""
    return complexity(candidate.expr) + data_bits(residuals(candidate, samples), noise)


def noise_of(candidates: Iterable[Candidate], samples: Samples) -> Noise:
    """Estimate the noise of samples from the residuals of many candidates.

    Errors of plain differences change their sign inside every step of the solver that made the
    states and average out; those of a smoother hang together over its whole window, beyond the
    runs of their sign, and count half. What remains of the bias of clean slopes is a function of
    the states that a long formula can follow, so nothing below a millionth of the slopes counts.
    """
    misses = (residuals(c, samples) for c in candidates)
    if samples.scheme == "given":
        return estimate_noise(misses, samples.y)
    noise = estimate_noise(misses, samples.y, 2.0 if samples.scheme in SCHEMES else 1.0)
    size = float(np.sqrt(np.mean(np.square(samples.y))))
    return Noise(max(noise.floor, _FINEST * size), noise.effective_rows)


def choose(
    candidates: Iterable[Candidate], samples: Samples, noise: Noise | None = None
) -> Candidate:
    """Give the candidate of least description length; ValueError when there is none.

    >>> import sympy
    >>> t = np.arange(9.0)
    >>> s = Samples(t[:, None], 2 * t, ("x",), "x", "given", t)
    >>> x = sympy.Symbol("x")
    >>> choose([Candidate(x, 4.76, 1.0), Candidate(2 * x, 0.0, 4.6)], s).expr
    2*x
    """
    pool = list(candidates)
    if not pool:
        raise ValueError("there is no candidate to choose from")
    measured = noise or noise_of(pool, samples)
    return min(pool, key=lambda c: (description_length(c, samples, measured), str(c.expr)))
