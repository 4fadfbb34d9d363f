"""Linear fits: robust least squares, backward elimination, ratios, independent columns.

Rows are made robust by Cauchy weights everywhere. ``scipy.optimize.least_squares(loss="cauchy")``
solves one problem at a time; on a batch such as the brute-force search has (200 problems of 1000
rows and 3 columns) it takes eleven times as long as :func:`fit_robustly`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

# Share of a size below which a number is rounding, of float64 or of a fit.
ROUNDING = 1e-12
# The same of a singular value of unit columns, and of a square that is left of them.
DEPENDENT, NOTHING_LEFT = 1e-10, 1e-13
# What the steps of Levenberg and Marquardt are damped by at first, and by how much more after one
# that is no better.
DAMPED, DAMPING = 1e-4, 10.0
_ROUNDS = 5
# Rows that the first rounds look at.
_START = 250


def cauchy_weights(residual: np.ndarray, unit: float | np.ndarray) -> np.ndarray:
    """Weights 1 / (1 + (r / u)^2) of residuals of any shape, ``unit`` u in the residuals' unit.

    Reweighting by them minimises the Cauchy loss sum log(1 + (r / u)^2), for which large errors
    among small ones count little (Holland and Welsch 1977).

    >>> cauchy_weights(np.array([0.0, 2.0]), 2.0)
    array([1. , 0.5])
    """
    return np.asarray(1 / (1 + np.square(residual / unit)))


def cauchy_scale(residual: np.ndarray, least: float) -> float:
    """Scale s at which residuals (n,) are most probable for a Cauchy law, at least ``least``.

    Half of the probability lies within one scale of 0. Where errors of very different sizes are
    mixed, as those that a solver makes from step to step, it is about the median size; inf where a
    residual is not finite.

    >>> round(cauchy_scale(np.array([-3.0, -1.0, 1.0, 3.0]), 0.0), 2)
    1.73
    """
    most, least = float(np.max(np.abs(residual))), max(least, float(np.finfo(float).tiny))

    def above(log: float) -> float:
        # The bits do not change with the scale where the weights are a half in the mean.
        with np.errstate(over="ignore"):
            return 0.5 - float(np.mean(cauchy_weights(residual, math.exp(log))))

    if not math.isfinite(most):
        return math.inf
    if most <= least or above(math.log(least)) <= 0:
        return least
    return math.exp(brentq(above, math.log(least), math.log(most)))


def cauchy_bits(residual: np.ndarray, scale: float) -> float:
    """Mean bits of residuals (n,) in their own unit by a Cauchy law of a scale; inf for no numbers.

    >>> round(cauchy_bits(np.array([1.0]), 1.0), 3)
    2.651
    """
    with np.errstate(over="ignore", invalid="ignore"):
        mean = float(np.mean(np.log2(1 + np.square(residual / scale))))
    return math.log2(math.pi * scale) + mean if math.isfinite(mean) else math.inf


def fit_linear(design: np.ndarray, z: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """Least squares of K problems: (K, n, k) designs, (K, n) or (n,) z -> (K, k) coefficients.

    ``roots`` (K, n) or (n,) are square roots of weights. By normal equations of columns scaled to
    norm 1, with one step of iterative refinement, which brings back the digits that squaring
    the condition number lost.

    >>> x = np.linspace(0.0, 1.0, 9)
    >>> design = np.column_stack([np.ones(9), x])[None]
    >>> bool(np.allclose(fit_linear(design, 3 - 2 * x, np.ones(9)), [[3.0, -2.0]]))
    True
    """
    columns = design * np.broadcast_to(roots, design.shape[:2])[:, :, None]
    right = np.broadcast_to(z, design.shape[:2]) * roots
    norms = np.sqrt(np.einsum("kni,kni->ki", columns, columns))
    norms[norms == 0] = 1.0
    columns = columns / norms[:, None, :]
    normal = columns.transpose(0, 2, 1) @ columns
    # Equal columns share their coefficient instead of stopping the whole batch.
    normal += 1e-14 * np.eye(design.shape[2])
    found = np.zeros((len(design), design.shape[2]))
    for _ in range(2):
        rest = right[:, :, None] - columns @ found[:, :, None]
        moments = columns.transpose(0, 2, 1) @ rest
        found = found + np.linalg.solve(normal, moments)[:, :, 0]
    return found / norms


def fit_robustly(design: np.ndarray, z: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Fit with Cauchy weights 1 / (1 + (r / s)^2), s twice the median of |r|, found by iteration.

    ``scales`` (n,) turn residuals of z into residuals of y. Slopes of trajectories carry a few
    large errors among many small ones; these weights leave them out. All rounds but the last two
    look at some hundred evenly spaced rows alone.
    """
    step = max(1, design.shape[1] // _START)
    few = slice(None, None, step)
    z = np.broadcast_to(z, design.shape[:2])
    start = np.broadcast_to(scales, design.shape[:2])[:, few]
    found = _reweight(design[:, few], z[:, few], scales[few], start, _ROUNDS - 1)
    if step == 1:
        return found
    return _reweight(design, z, scales, _weigh(design, z, scales, found), 1)


def _reweight(
    design: np.ndarray, z: np.ndarray, scales: np.ndarray, roots: np.ndarray, rounds: int
) -> np.ndarray:
    """Fit, and ``rounds`` times more with weights from the residuals of the fit before."""
    found = fit_linear(design, z, roots)
    for _ in range(rounds):
        found = fit_linear(design, z, _weigh(design, z, scales, found))
    return found


def _weigh(design: np.ndarray, z: np.ndarray, scales: np.ndarray, found: np.ndarray) -> np.ndarray:
    """(K, n) roots of the Cauchy weights of a fit's residuals."""
    rest = np.abs(z - (design @ found[:, :, None])[:, :, 0]) * scales
    size = _medians(np.abs(z * scales))
    middle = np.maximum(2 * _medians(rest), ROUNDING * size + 1e-300)
    return scales * np.sqrt(cauchy_weights(rest, middle))


def _medians(values: np.ndarray) -> np.ndarray:
    """(K, 1) upper medians of rows."""
    half = values.shape[1] // 2
    return np.partition(values, half, axis=1)[:, half : half + 1]


def eliminate(
    columns: np.ndarray,
    y: np.ndarray,
    *,
    robust: bool = False,
    unit: float | None = None,
    few: int | None = None,
) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """Yield least-squares fits with ever fewer columns (backward elimination).

    Each time the column leaves whose absence raises the squared error least: the smallest
    c_k^2 / ((A'A)^-1)_kk (Miller 2002, "Subset selection in regression", section 3.4). Columns of
    zeros are left out, and dependent columns share their coefficient.

    Parameters
    ----------
    columns : (n, k) values.
    y : (n,) target.
    robust : weight the rows by :func:`cauchy_weights`, iterated at every number of columns.
    unit : that of the weights; the median residual of the first fit by default.
    few : above this many columns an eighth of them leaves at a time; by default always one.

    Yields (numbers of the columns kept, their coefficients).

    >>> x = np.linspace(0.0, 1.0, 9)
    >>> [kept for kept, _ in eliminate(np.column_stack([x**2, x]), 3 * x + 0.1 * x**2)]
    [(0, 1), (1,)]
    """
    norms = np.linalg.norm(columns, axis=0)
    kept = [int(j) for j in np.flatnonzero(norms > 0)]
    scaled = columns / np.where(norms > 0, norms, 1.0)
    if not robust:
        # The triangular factor holds all that plain fits need, in as many rows as columns.
        factor = np.linalg.qr(np.column_stack([scaled, y]), mode="reduced")[1]
        scaled, y = factor[:, :-1], factor[:, -1]
    trust = np.ones(len(y))
    while kept:
        many = few is not None and len(kept) > few
        for _ in range((2 if many else 8) if robust else 1):
            coefficients, gain = _fit_and_gain(scaled[:, kept], y, np.sqrt(trust))
            if robust:
                rest = y - scaled[:, kept] @ coefficients
                unit = unit or max(float(np.median(np.abs(rest))), ROUNDING * np.ptp(y), 1e-300)
                before, trust = trust, cauchy_weights(rest, unit)
                if np.abs(trust - before).max() < 1e-3:
                    break
        yield tuple(kept), coefficients / norms[kept]
        order = np.argsort(gain, kind="stable")
        for index in sorted(order[: len(kept) // 8 if many else 1], reverse=True):
            del kept[int(index)]


def _fit_and_gain(
    columns: np.ndarray, y: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted least squares, and how much each column lowers the sum of squares."""
    # The triangular factor has the same right singular vectors at a fraction of the size.
    q, triangle = np.linalg.qr(columns * root[:, None])
    u, s, vt = np.linalg.svd(triangle, full_matrices=False)
    inverse = np.where(s > ROUNDING * s[0], 1 / np.maximum(s, 1e-300), 0.0)
    coefficients = vt.T @ (inverse * (u.T @ (q.T @ (y * root))))
    variance = np.square(vt.T * inverse).sum(axis=1)
    return coefficients, np.square(coefficients) / np.maximum(variance, 1e-300)


@dataclass(frozen=True, eq=False)
class RatioFit:
    """Coefficients of a fitted ratio N / D.

    ``numerator`` (a,) and ``denominator`` (b,) are the factors of the columns given; ``residual``
    (n,) is y - N / D, and ``weight`` (n,) the 1 / |D| that the repeated fit has come to.
    """

    numerator: np.ndarray
    denominator: np.ndarray
    residual: np.ndarray
    weight: np.ndarray


def fit_ratio(
    above: np.ndarray,
    below: np.ndarray,
    y: np.ndarray,
    lead: np.ndarray | None = None,
    weights: np.ndarray | None = None,
    rounds: int = 8,
) -> RatioFit:
    """Fit y = N / D, N = sum_i a_i above_i and D = lead + sum_j b_j below_j, by least squares.

    The linear fit of y D = N makes small what a D near zero makes small by itself. It is repeated
    with rows weighted by 1 / |D| of the round before (Sanathanan and Koerner 1963), and the round
    of least error of N / D itself is given.

    Parameters
    ----------
    above, below : (a, n) and (b, n) values; b may be 0.
    y : (n,) target.
    lead : (n,) the term of D whose coefficient is 1; the constant 1 by default.
    weights : (n,) weight of each sample.
    rounds : linear fits.

    >>> x = np.linspace(0.0, 2.0, 50)
    >>> fit = fit_ratio(np.array([x]), np.array([x**2]), 3 * x / (1 + 0.5 * x**2))
    >>> float(fit.numerator[0].round(9)), float(fit.denominator[0].round(9))
    (3.0, 0.5)
    """
    first = np.ones(len(y)) if lead is None else lead
    root = np.ones(len(y)) if weights is None else np.sqrt(weights)
    columns, target = np.vstack([above, -y * below]).T, y * first
    weight, best, least = np.ones(len(y)), None, np.inf
    for _ in range(rounds if len(below) else 1):
        scale = (root * weight)[:, None]
        solution = np.linalg.lstsq(columns * scale, target * scale[:, 0], rcond=None)[0]
        a, b = solution[: len(above)], solution[len(above) :]
        bottom = first + b @ below
        with np.errstate(all="ignore"):
            residual = y - a @ above / bottom
            error = float(np.sum(np.square(root * residual)))
        if best is None or error < least:
            best, least = (a, b, residual), error
        # A row where D nearly vanishes counts no more than where D is a thousandth of its size.
        floor = max(1e-3 * float(np.sqrt(np.mean(bottom**2))), 1e-300)
        weight = 1 / np.maximum(np.abs(bottom), floor)
    if best is None:
        raise ValueError(f"{rounds} rounds fit no ratio")
    return RatioFit(*best, weight)


def linearly_independent(rows: np.ndarray, tolerance: float = 1e-6) -> np.ndarray:
    """Give the numbers of the rows that are no linear combination of earlier rows kept.

    ``rows`` is (p, n); a row counts as a combination when what the rows before do not explain is
    below ``tolerance`` of it. How many residuals are statistically independent is another thing:
    :func:`dynsr.fit.independent_rows`.

    >>> linearly_independent(np.array([[1.0, 1.0], [2.0, 2.0], [0.0, 1.0]])).tolist()
    [0, 2]
    """
    basis = np.empty((0, rows.shape[1]))
    kept = []
    for index, row in enumerate(rows):
        norm = np.linalg.norm(row)
        if not norm > 0 or len(basis) == rows.shape[1]:
            continue
        rest = row / norm
        for _ in range(2):  # twice is enough (Kahan): the second pass mends rounding of the first
            rest = rest - basis.T @ (basis @ rest)
        size = np.linalg.norm(rest)
        if size > tolerance:
            kept.append(index)
            basis = np.vstack([basis, rest / size])
    return np.array(kept, dtype=int)


def orthogonal(columns: np.ndarray) -> np.ndarray:
    """Give (N, r) orthonormal columns that span those given.

    Parameters
    ----------
    columns : (N, P).

    >>> orthogonal(np.array([[1.0, 2.0], [0.0, 0.0]])).shape
    (2, 1)
    """
    if not columns.size:
        return np.zeros((len(columns), 0))
    left, values, _ = np.linalg.svd(unit_columns(columns)[0], full_matrices=False)
    basis: np.ndarray = left[:, values > DEPENDENT * values[0]]
    return basis


def unit_columns(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give columns (N, P) divided by their norms, and these (P,); a column of zeros stays."""
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return columns / size, size


def fit_columns(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Give the factors (P,) of columns (N, P) of any sizes that are nearest to a target (N,).

    >>> fit_columns(np.array([[1.0, 1e9], [1.0, -1e9]]), np.array([3.0, 1.0])).round(12)
    array([2.e+00, 1.e-09])
    """
    unit, size = unit_columns(columns)
    return np.asarray(np.linalg.lstsq(unit, target, rcond=ROUNDING)[0] / size)


def invert_normal(normal: np.ndarray) -> np.ndarray:
    """Give the pseudo-inverse (P, P) of normal equations, in units that make their diagonal 1.

    >>> np.diag(invert_normal(np.diag([4.0, 0.0, 1e-20])))
    array([2.5e-01, 0.0e+00, 1.0e+20])
    """
    own = np.diag(normal)
    scale = np.sqrt(np.where(own > 0, own, np.inf))
    units = np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(normal / units, rcond=NOTHING_LEFT, hermitian=True) / units)


def know(
    values: np.ndarray, covariance: np.ndarray, index: int, number: float
) -> tuple[np.ndarray, np.ndarray]:
    """Give fitted values (P,) and their covariance (P, P) once one of them is known.

    Parameters
    ----------
    values, covariance : as fitted. One of no variance, or of an infinite one, says nothing of the
        others, which stay as they are; nor is one of infinite covariance moved.
    index, number : which one is known, and what it is.

    >>> know(np.array([1.1, 2.0]), np.array([[0.02, 0.01], [0.01, 0.02]]), 0, 1.0)[0]
    array([1.  , 1.95])
    """
    variance = float(covariance[index, index])
    if not 0 < variance < math.inf:
        moved, left = values.copy(), covariance.copy()
        moved[index], left[index], left[:, index] = float(number), 0.0, 0.0
        return moved, left
    # What may be anything is no better known.
    own = np.where(np.isfinite(covariance[index]), covariance[index], 0.0)
    moved = values + own / variance * (float(number) - values[index])
    return moved, covariance - np.outer(own / variance, own)
