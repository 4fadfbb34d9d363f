"""Additive and multiplicative separability: f = g(x_S) + h(x_R) or g(x_S) h(x_R)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import evaluate
from dynsr.methods.feynman.stages.base import Context, Surrogate
from dynsr.methods.feynman.stages.reduction import (
    AbstractReducer,
    AbstractReduction,
    Support,
    leading,
)


def partitions(count: int) -> Iterator[tuple[list[int], list[int]]]:
    """Split range(count) into two parts that are not empty, each way once.

    >>> list(partitions(3))
    [([0], [1, 2]), ([0, 1], [2]), ([0, 2], [1])]
    """
    for size in range(count - 1):
        for others in combinations(range(1, count), size):
            first = [0, *others]
            yield first, [j for j in range(count) if j not in first]


@dataclass(frozen=True, eq=False)
class Split(AbstractReduction):
    """f is the sum (or the product) of a function of the columns S and one of the columns R.

    The first factor is solved on ``values``, the surrogate along x_S with x_R fixed. The second is
    solved on what the samples themselves leave once the first is taken off, so that the
    surrogate's own error does not enter it. Rows at which the first factor of a product is below
    ``small`` times its largest are left out of the second.
    """

    kind: str
    error: float
    first: tuple[int, ...]
    second: tuple[int, ...]
    values: np.ndarray
    product: bool
    small: float
    support: Support

    def solve(self, samples: Samples, context: Context) -> list[sympy.Expr]:
        """Solve for S, then for R, and join."""
        part = _columns(samples, self.first, self.values)
        joined = []
        for left in leading(context.solve(part, context.deeper()), part):
            remaining = self._rest(samples, left.expr)
            if remaining is None:
                continue
            for right in leading(context.solve(remaining, context.deeper()), remaining):
                both = left.expr * right.expr if self.product else left.expr + right.expr
                joined.append(both)
        return joined

    def _rest(self, samples: Samples, expr: sympy.Expr) -> Samples | None:
        known = evaluate(expr, samples.columns)
        if not np.all(np.isfinite(known)):
            return None
        if not self.product:
            return _columns(samples, self.second, samples.y - known)
        rows = np.abs(known) > self.small * np.abs(known).max()
        if not self.support.enough(rows):
            return None
        return _columns(samples.select(rows), self.second, samples.y[rows] / known[rows])


def _columns(samples: Samples, which: tuple[int, ...], y: np.ndarray) -> Samples:
    names = tuple(samples.names[j] for j in which)
    return replace(samples, X=samples.X[:, list(which)], y=y, names=names)


@dataclass(frozen=True)
class Separability(AbstractReducer):
    """Test every partition of the variables for a sum and for a product.

    The errors are the medians of |f - f(x_S, m_R) - f(m_S, x_R) + f(m)| and of
    |f - f(x_S, m_R) f(m_S, x_R) / f(m)| (Udrescu et al. 2020), over the rows near
    which all three points have samples; m is the sample nearest the middle at which f is not small.

    Parameters
    ----------
    tolerance : accepted error, in validation errors of the surrogate.
    additive : look for g(x_S) + h(x_R).
    multiplicative : look for g(x_S) h(x_R).
    small : rows at which g is below this share of its largest value do not determine h.
    """

    tolerance: float = 1.0
    additive: bool = True
    multiplicative: bool = True
    small: float = 0.02
    name = "separability"

    def find(
        self, samples: Samples, surrogate: Surrogate, support: Support
    ) -> list[AbstractReduction]:
        """Test every partition."""
        X = samples.X
        here = surrogate.predict(X)
        middle = _middle(X, here)
        centre = here[middle]
        found: list[AbstractReduction] = []
        for first, second in partitions(X.shape[1]):
            held, freed = X.copy(), X.copy()
            held[:, second] = X[middle, second]
            freed[:, first] = X[middle, first]
            rows = support.near(held) & support.near(freed)
            if not support.enough(rows):
                continue
            left, right = surrogate.predict(held), surrogate.predict(freed)
            for product in (False, True):
                error = self._error(here, left, right, centre, product, rows)
                if error <= self.tolerance * surrogate.validation_error:
                    kind = f"{self.name}: {'multiplicative' if product else 'additive'}"
                    parts = tuple(first), tuple(second)
                    found.append(Split(kind, error, *parts, left, product, self.small, support))
        return found

    def _error(
        self,
        here: np.ndarray,
        left: np.ndarray,
        right: np.ndarray,
        centre: float,
        product: bool,
        rows: np.ndarray,
    ) -> float:
        if not (self.multiplicative if product else self.additive):
            return np.inf
        joined = left * right / centre if product else left + right - centre
        return float(np.median(np.abs(here - joined)[rows]))


def _middle(X: np.ndarray, values: np.ndarray) -> int:
    """Row nearest the medians among those with at least half the typical |value|."""
    scale = np.std(X, axis=0)
    distance = np.linalg.norm((X - np.median(X, axis=0)) / np.where(scale > 0, scale, 1.0), axis=1)
    small = np.abs(values) < 0.5 * float(np.sqrt(np.mean(np.square(values))))
    return int(np.argmin(np.where(small, np.inf, distance)))
