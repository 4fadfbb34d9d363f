"""Inner functions: f = F(h(x)), f = F(h(x_S), x_R) and f = F(g(x_S) + h(x_R))."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import sympy

from dynsr.expression import evaluate
from dynsr.methods.feynman.gradients import find_inner_functions, inner_features
from dynsr.methods.feynman.reduction import (
    AbstractReducer,
    AbstractReduction,
    Substitution,
    Support,
)
from dynsr.methods.feynman.separability import partitions
from dynsr.methods.feynman.stage import Surrogate
from dynsr.samples import Samples

_MISALIGNED = 0.01


@dataclass(frozen=True)
class AbstractInnerSearch(AbstractReducer):
    """What the searches for inner functions share.

    Parameters
    ----------
    tolerance : accepted error of y as a function of h, in validation errors of the surrogate.
    max_cost : highest cost of a feature (:func:`dynsr.methods.feynman.features.build_features`).
    max_features : most features that the inner function is put together from.
    """

    tolerance: float = 1.5
    max_cost: int = 4
    max_features: int = 60

    def _inner(
        self,
        samples: Samples,
        gradient: np.ndarray,
        which: list[int],
        features: list[sympy.Expr] | None = None,
    ) -> list[tuple[sympy.Expr, float]]:
        """Inner functions of some of the variables, with their misalignment."""
        columns = {samples.names[j]: samples.X[:, j] for j in which}
        if features is None:
            features = inner_features(columns, self.max_cost, self.max_features)
        standard = gradient[:, which] * np.std(samples.X[:, which], axis=0)
        found = find_inner_functions(columns, standard, features)
        return [(h.expr, h.misalignment) for h in found if h.misalignment <= _MISALIGNED]


def scatter(values: np.ndarray, y: np.ndarray) -> float:
    """Error of y as a function of one variable, from neighbours: median |second difference|.

    For y = F(u) + noise, three neighbours in u differ from a straight line by noise alone. The
    median is given in units of a standard deviation.

    >>> scatter(np.arange(100.0), 3 * np.arange(100.0)) < 1e-9
    True
    """
    order = np.argsort(values, kind="stable")
    u, v = values[order], y[order]
    gap = np.maximum(u[2:] - u[:-2], 1e-300)
    share = np.clip((u[1:-1] - u[:-2]) / gap, 0.0, 1.0)
    off = v[1:-1] - (1 - share) * v[:-2] - share * v[2:]
    weight = np.sqrt(1 + (1 - share) ** 2 + share**2)
    return float(np.median(np.abs(off / weight))) / 0.6745


@dataclass(frozen=True)
class Compositionality(AbstractInnerSearch):
    """Look for f = F(h(x)) with h a short sum of features, by the direction of the gradient.

    An inner function counts when y, ordered by h, is a smooth curve to within the tolerance.
    """

    name = "compositionality"

    def find(self, samples: Samples, surrogate: Surrogate) -> list[AbstractReduction]:
        """Find inner functions of all variables."""
        if not Support(samples.X).fills_space:
            return []
        everything = list(range(samples.X.shape[1]))
        inner = self._inner(samples, surrogate.gradient(samples.X), everything)
        return _accepted(self.name, inner, samples, self.tolerance * surrogate.validation_error)


@dataclass(frozen=True)
class GeneralSeparability(AbstractInnerSearch):
    """Look for f = F(g(x_S) + h(x_R)): a sum inside one more function of one variable.

    Products are sums of logarithms, so F(g(x_S) h(x_R)) is found too where g and h have one sign.
    """

    max_cost: int = 6
    name = "general separability"

    def find(self, samples: Samples, surrogate: Surrogate) -> list[AbstractReduction]:
        """Find sums over each partition of the variables."""
        if not Support(samples.X).fills_space:
            return []
        gradient = surrogate.gradient(samples.X)
        found: list[AbstractReduction] = []
        for first, second in partitions(samples.X.shape[1]):
            features: list[sympy.Expr] = []
            for part in (first, second):
                columns = {samples.names[j]: samples.X[:, j] for j in part}
                features += inner_features(columns, self.max_cost, self.max_features // 2)
            everything = list(range(samples.X.shape[1]))
            inner = self._inner(samples, gradient, everything, features)
            limit = self.tolerance * surrogate.validation_error
            found += _accepted(self.name, inner, samples, limit)
        return found


def _accepted(
    kind: str, inner: list[tuple[sympy.Expr, float]], samples: Samples, limit: float
) -> list[AbstractReduction]:
    found: list[AbstractReduction] = []
    for expr, _ in inner[:2]:
        error = scatter(evaluate(expr, samples.columns), samples.y)
        if error <= limit:
            found.append(Substitution(f"{kind} in {_name(expr)}", error, expr, samples.names))
    return found


def _name(expr: sympy.Expr) -> str:
    return str(expr.xreplace({n: sympy.Float(float(n), 4) for n in expr.atoms(sympy.Float)}))


@dataclass(frozen=True)
class GeneralisedSymmetry(AbstractInnerSearch):
    """Look for f = F(h(x_S), x_R) with two or more, but not all, of the variables in h.

    The gradient restricted to x_S must have the direction of grad h for all values of the others.
    An inner function is accepted when its gradient is within ``angle`` (radians, root mean square)
    of that direction.
    """

    max_features: int = 36
    angle: float = 0.05
    name = "generalised symmetry"

    def find(self, samples: Samples, surrogate: Surrogate) -> list[AbstractReduction]:
        """Try every subset of the variables."""
        count = samples.X.shape[1]
        if count < 3 or not Support(samples.X).fills_space:
            return []
        gradient = surrogate.gradient(samples.X)
        found: list[AbstractReduction] = []
        for size in range(2, count):
            for which in combinations(range(count), size):
                names = tuple(samples.names[j] for j in which)
                for expr, misalignment in self._inner(samples, gradient, list(which))[:1]:
                    if misalignment <= self.angle**2:
                        error = surrogate.validation_error * misalignment / self.angle**2
                        kind = f"{self.name} in {_name(expr)}"
                        found.append(Substitution(kind, error, expr, names))
        return found
