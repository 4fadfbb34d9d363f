"""A path of sparse models: many thresholds, then one term less at a time.

One threshold has to be guessed. Here the data choose: a list of thresholds gives a list of
supports, each support is refitted without shrinkage, and terms leave it one by one, each time the
one whose loss costs least (Boninsegna, Nueske and Clementi 2018, stepwise sparse regression).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from dynsr.engines.base import AbstractEngine, Optimizer, SparseProblem

_DEPENDENT = 1e-6
_REWEIGHTINGS = 8
_ITERATIONS = 100

Terms = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Model:
    """dx = (numerator . theta) / (denominator . theta); no denominator means 1.

    ``numerator`` and ``denominator`` map a row of theta to its coefficient.
    """

    numerator: dict[int, float]
    denominator: dict[int, float]
    error: float

    @property
    def size(self) -> int:
        """Count the coefficients."""
        return len(self.numerator) + len(self.denominator)

    def predict(self, theta: np.ndarray) -> np.ndarray:
        """Evaluate on the rows of theta; inf or NaN where the denominator is 0."""
        top = np.array(list(self.numerator.values())) @ theta[list(self.numerator)]
        if not self.denominator:
            return top
        with np.errstate(all="ignore"):
            below = np.array(list(self.denominator.values())) @ theta[list(self.denominator)]
            return top / below


def independent_rows(theta: np.ndarray) -> np.ndarray:
    """Indices of the rows that are no combination of earlier rows kept, to one part in 1e6.

    >>> independent_rows(np.array([[1.0, 1.0], [2.0, 2.0], [0.0, 1.0]])).tolist()
    [0, 2]
    """
    basis = np.empty((0, theta.shape[1]))
    kept = []
    for index, row in enumerate(theta):
        norm = np.linalg.norm(row)
        if not norm > 0 or len(basis) == theta.shape[1]:
            continue
        rest = row / norm
        for _ in range(2):  # twice is enough (Kahan): the second pass mends rounding of the first
            rest = rest - basis.T @ (basis @ rest)
        size = np.linalg.norm(rest)
        if size > _DEPENDENT:
            kept.append(index)
            basis = np.vstack([basis, rest / size])
    return np.array(kept, dtype=int)


def eliminate(columns: np.ndarray, target: np.ndarray) -> Iterator[tuple[Terms, np.ndarray]]:
    """Yield least-squares fits of target (m,) on columns (s, m), of s, s - 1, ..., 1 columns.

    Each time the column leaves whose absence raises the squared error least: the smallest
    ``c_k^2 / ((A'A)^-1)_kk``.
    """
    chosen = list(range(len(columns)))
    factor = scipy.linalg.qr(np.vstack([columns, target]).T, mode="r", check_finite=False)[0]
    factor = factor[: factor.shape[1]]
    matrix, right = factor[:, :-1], factor[:, -1]
    while chosen:
        q, r = np.linalg.qr(matrix[:, chosen])
        inverse = scipy.linalg.solve_triangular(r, np.eye(len(chosen)), check_finite=False)
        coefficients = inverse @ (q.T @ right)
        yield tuple(chosen), coefficients
        price = coefficients**2 / np.sum(inverse**2, axis=1)
        chosen.pop(int(np.argmin(price)))


def explicit_models(
    theta: np.ndarray,
    dx: np.ndarray,
    engine: AbstractEngine,
    optimizer: Optimizer,
    thresholds: Sequence[float],
) -> Iterator[list[Model]]:
    """Yield, after each threshold, models dx = c . theta with few terms.

    Thresholds act on the coefficients of rows and dx scaled to a root mean square of 1.
    """
    scaled, scale = _unit_rows(theta)
    size = float(np.sqrt(np.mean(dx**2)))
    seen: set[Terms] = set()
    supports = [tuple(range(len(theta)))]
    for threshold in thresholds:
        found = _regress(engine, optimizer, scaled, dx / size, threshold, implicit=False)
        supports.append(tuple(np.flatnonzero(found).tolist()))
        yield [
            Model(dict(zip(terms, c * size / scale[list(terms)], strict=True)), {}, error)
            for support in supports
            for terms, c, error in _descend(scaled, dx / size, support, seen)
        ]
        supports = []


def _regress(
    engine: AbstractEngine,
    optimizer: Optimizer,
    theta: np.ndarray,
    dx: np.ndarray,
    threshold: float,
    implicit: bool,
) -> np.ndarray:
    settings = {"threshold": threshold}
    problem = SparseProblem(theta, dx, optimizer, settings, False, _ITERATIONS, implicit)
    return engine.regress(problem).coefficients


def _descend(
    columns: np.ndarray, target: np.ndarray, support: Terms, seen: set[Terms]
) -> Iterator[tuple[Terms, np.ndarray, float]]:
    """Eliminate from a support until a support comes that was seen before."""
    if not support:
        return
    index = list(support)
    for chosen, coefficients in eliminate(columns[index], target):
        terms = tuple(index[k] for k in chosen)
        if terms in seen:
            return
        seen.add(terms)
        residual = coefficients @ columns[list(terms)] - target
        yield terms, coefficients, float(np.sqrt(np.mean(residual**2)))


def implicit_models(
    theta: np.ndarray,
    dx: np.ndarray,
    engine: AbstractEngine,
    optimizer: Optimizer,
    thresholds: Sequence[float],
    max_terms: int,
) -> Iterator[list[Model]]:
    """Yield, after each threshold, rational models found from relations [dx theta; theta]' q = 0.

    A relation makes dx N(x) - D(x) small, which a D near zero does by itself. Each support is
    therefore refitted to dx - N / D by reweighting with 1 / D (Sanathanan and Koerner 1963).
    """
    scaled, scale = _unit_rows(theta)
    size = float(np.sqrt(np.mean(dx**2)))
    seen: set[tuple[Terms, Terms]] = set()
    p = len(theta)
    for threshold in thresholds:
        relation = _regress(engine, optimizer, scaled, dx / size, threshold, implicit=True)
        den = tuple(np.flatnonzero(relation[:p]).tolist())
        num = tuple(np.flatnonzero(relation[p:]).tolist())
        found = []
        for fit in _thin(scaled, dx / size, num, den, seen, max_terms):
            top = {i: c * size / scale[i] for i, c in fit.numerator.items()}
            bottom = {i: c / scale[i] for i, c in fit.denominator.items()}
            found.append(Model(top, bottom, fit.error))
        yield found


def _thin(
    theta: np.ndarray,
    dx: np.ndarray,
    num: Terms,
    den: Terms,
    seen: set[tuple[Terms, Terms]],
    max_terms: int,
) -> Iterator[Model]:
    """Refit a ratio, and again with one term less, for as long as both its parts have terms."""
    while num and len(den) > 1 and (num, den) not in seen:
        seen.add((num, den))
        model, weight = _fit_ratio(theta, dx, num, den)
        if model.size <= max_terms:
            yield model
        lead = den[0]
        columns = np.vstack([theta[list(num)], dx * theta[list(den[1:])]]) * weight
        fits = eliminate(columns, dx * theta[lead] * weight)
        next(fits)
        chosen, _ = next(fits, ((), np.empty(0)))
        kept = set(chosen)
        num, den = (
            tuple(i for k, i in enumerate(num) if k in kept),
            (lead, *(i for k, i in enumerate(den[1:], len(num)) if k in kept)),
        )


def _fit_ratio(
    theta: np.ndarray, dx: np.ndarray, num: Terms, den: Terms
) -> tuple[Model, np.ndarray]:
    """Fit N / D to dx, the first term of D at coefficient 1; give also the last weights 1 / D."""
    top, bottom = theta[list(num)], theta[list(den[1:])]
    columns = np.vstack([top, -dx * bottom])
    target = dx * theta[den[0]]
    weight = np.ones(len(dx))
    best = Model({}, {}, np.inf)
    for _ in range(_REWEIGHTINGS):
        fitted = np.linalg.lstsq((columns * weight).T, target * weight, rcond=None)[0]
        a, b = fitted[: len(num)], fitted[len(num) :]
        below = theta[den[0]] + b @ bottom
        with np.errstate(all="ignore"):
            error = float(np.sqrt(np.mean((a @ top / below - dx) ** 2)))
        if error < best.error:
            best = Model(
                dict(zip(num, a, strict=True)),
                dict(zip(den, (1.0, *b), strict=True)),
                error,
            )
        floor = 1e-3 * float(np.sqrt(np.mean(below**2)))
        weight = 1 / np.maximum(np.abs(below), max(floor, 1e-300))
    return best, weight


def _unit_rows(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    scale = np.sqrt(np.mean(theta**2, axis=1))
    return theta / scale[:, None], scale
