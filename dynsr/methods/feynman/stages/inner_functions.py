"""Inner functions: f = F(h(x)), f = F(h(x_S), x_R) and f = F(g(x_S) + h(x_R)).

They are found from gradients: h such that grad f is parallel to grad h (Udrescu et al. 2020).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import compile_numpy, complexity, evaluate, skeleton
from dynsr.methods.features import build_features
from dynsr.methods.feynman.stages.base import Surrogate
from dynsr.methods.feynman.stages.reduction import (
    AbstractReducer,
    AbstractReduction,
    Substitution,
    Support,
)
from dynsr.methods.feynman.stages.separability import partitions
from dynsr.methods.limits import Limits


@dataclass(frozen=True)
class InnerFunction:
    """A formula h, and the mean square of the sine of the angle between grad h and grad f."""

    expr: sympy.Expr
    misalignment: float


def inner_features(
    columns: dict[str, np.ndarray],
    max_cost: int,
    most: int,
    functions: tuple[str, ...] | None = None,
) -> list[sympy.Expr]:
    """Features that an inner function may be a sum of, cheapest first, without the constant."""
    features = build_features(columns, max_cost, 3, most + 1, functions=functions)
    return [expr for expr in features.exprs if expr.free_symbols]


def find_inner_functions(
    columns: dict[str, np.ndarray],
    gradient: np.ndarray,
    features: list[sympy.Expr],
    largest: int = 3,
    keep: int = 3,
    close: float = 4.0,
) -> list[InnerFunction]:
    """Find short sums of features whose gradient has the direction of ``gradient`` (n, p).

    Features and gradients are over all p ``columns``. A sum has at most ``largest`` features; one
    that leaves a variable out is no answer. Of the sums whose misalignment is within a factor
    ``close`` of the least, the ``keep`` simplest are given; a constant in them is of any size and
    sign.
    """
    names = list(columns)
    slopes = _feature_gradients(columns, features)
    norm = np.linalg.norm(gradient, axis=1)
    rows = norm > 1e-3 * np.median(norm)
    u = (gradient[rows] / norm[rows, None])[None]
    slopes = slopes[:, rows]
    good = np.all(np.isfinite(slopes), axis=(1, 2))
    features = [f for f, ok in zip(features, good, strict=True) if ok]
    slopes = slopes[good]
    if not features:
        return []
    # Distances count alike along all variables: gradients are taken in standardised coordinates.
    across = slopes - np.sum(slopes * u, axis=2, keepdims=True) * u
    total = np.einsum("aij,bij->ab", slopes, slopes)
    missed = np.einsum("aij,bij->ab", across, across)
    found = []
    for size in range(1, largest + 1):
        sets = [
            chosen
            for chosen in combinations(range(len(features)), size)
            if set().union(*(features[k].free_symbols for k in chosen))
            == {sympy.Symbol(n) for n in names}
        ]
        if sets:
            found += _best_of_size(np.array(sets), total, missed, features, 10 * keep)
    least = max(min((h.misalignment for h in found), default=0.0), 1e-12)
    best = [h for h in found if h.misalignment <= close * least]
    return sorted(best, key=lambda h: (complexity(skeleton(h.expr)), h.misalignment))[:keep]


def _feature_gradients(columns: dict[str, np.ndarray], features: list[sympy.Expr]) -> np.ndarray:
    """(m, n, p) derivatives of the features in standardised coordinates."""
    names = list(columns)
    values = np.array(list(columns.values()))
    exprs = [sympy.diff(f, sympy.Symbol(name)) for f in features for name in names]
    slopes = compile_numpy(exprs, names)(values).reshape(len(features), len(names), -1)
    return np.swapaxes(slopes * np.std(values, axis=1)[None, :, None], 1, 2)


def _best_of_size(
    sets: np.ndarray,
    total: np.ndarray,
    missed: np.ndarray,
    features: list[sympy.Expr],
    keep: int,
) -> list[InnerFunction]:
    norms = np.sqrt(np.diag(total))
    total, missed = total / np.outer(norms, norms), missed / np.outer(norms, norms)
    index = sets[:, :, None], sets[:, None, :]
    sizes = np.arange(sets.shape[1])
    below = total[index]
    # Features that are all but parallel make the quotient meaningless.
    below[:, sizes, sizes] += 1e-10
    inverse = np.linalg.inv(np.linalg.cholesky(below))
    whitened = inverse @ missed[index] @ np.swapaxes(inverse, 1, 2)
    shares, vectors = np.linalg.eigh(whitened)
    weights = np.einsum("aji,aj->ai", inverse, vectors[:, :, 0])
    found = []
    for place in np.argsort(shares[:, 0], kind="stable")[:keep]:
        scaled = weights[place] / norms[sets[place]]
        lead = scaled[np.argmax(np.abs(weights[place]))]
        exprs = [features[k] for k in sets[place]]
        terms = [_coefficient(c / lead) * e for c, e in zip(scaled, exprs, strict=True)]
        found.append(InnerFunction(sympy.Add(*terms), max(float(shares[place, 0]), 0.0)))
    return found


def _coefficient(value: float) -> sympy.Expr:
    nearest = round(value)
    if nearest and abs(value - nearest) < 0.02 * abs(value):
        return sympy.Integer(nearest)
    return sympy.Float(value)


@dataclass(frozen=True)
class AbstractInnerSearch(AbstractReducer):
    """What the searches for inner functions share.

    Parameters
    ----------
    tolerance : accepted error of y as a function of h, in validation errors of the surrogate.
    max_cost : highest cost of a feature (:func:`dynsr.methods.features.build_features`).
    max_features : most features that the inner function is put together from.
    max_terms : most features in one inner function.
    misalignment : largest mean square of the sine of the angle between grad h and grad f.
    close : inner functions whose misalignment is within this factor of the least count as equally
        good, and the simplest of them is taken.
    keep : inner functions handed on.
    functions : those that features are made of; None for sin, cos, exp, log and sqrt.
    """

    tolerance: float = 1.5
    max_cost: int = 4
    max_features: int = 60
    max_terms: int = 3
    misalignment: float = 0.01
    close: float = 4.0
    keep: int = 3
    functions: tuple[str, ...] | None = None

    def within(self, limits: Limits) -> AbstractInnerSearch:
        """Give the search on features of the functions that are allowed."""
        vocabulary = limits.vocabulary
        return self if vocabulary is None else replace(self, functions=vocabulary.functions)

    def _inner(
        self,
        samples: Samples,
        gradient: np.ndarray,
        which: list[int],
        features: list[sympy.Expr] | None = None,
    ) -> list[InnerFunction]:
        """Inner functions of some of the variables."""
        columns = {samples.names[j]: samples.X[:, j] for j in which}
        if features is None:
            features = inner_features(columns, self.max_cost, self.max_features, self.functions)
        standard = gradient[:, which] * np.std(samples.X[:, which], axis=0)
        found = find_inner_functions(
            columns, standard, features, self.max_terms, self.keep, self.close
        )
        return [h for h in found if h.misalignment <= self.misalignment]

    def _accepted(
        self, inner: list[InnerFunction], samples: Samples, surrogate: Surrogate
    ) -> list[AbstractReduction]:
        """Give the first two that y is a smooth function of, to within the tolerance."""
        found: list[AbstractReduction] = []
        for h in inner[:2]:
            error = scatter(evaluate(h.expr, samples.columns), samples.y)
            if error <= self.tolerance * surrogate.validation_error:
                kind = f"{self.name}: {shown(h.expr)}"
                found.append(Substitution(kind, error, h.expr, samples.names))
        return found


def shown(expr: sympy.Expr) -> str:
    """Write a formula with numbers of four digits.

    >>> shown(sympy.Float(1 / 3) * sympy.Symbol("x"))
    '0.3333*x'
    """
    return str(expr.xreplace({n: sympy.Float(float(n), 4) for n in expr.atoms(sympy.Float)}))


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

    def find(
        self, samples: Samples, surrogate: Surrogate, support: Support
    ) -> list[AbstractReduction]:
        """Find inner functions of all variables."""
        if not support.fills_space:
            return []
        everything = list(range(samples.X.shape[1]))
        inner = self._inner(samples, surrogate.gradient(samples.X), everything)
        return self._accepted(inner, samples, surrogate)


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

    def find(
        self, samples: Samples, surrogate: Surrogate, support: Support
    ) -> list[AbstractReduction]:
        """Try every subset of the variables."""
        count = samples.X.shape[1]
        if count < 3 or not support.fills_space:
            return []
        gradient = surrogate.gradient(samples.X)
        found: list[AbstractReduction] = []
        for size in range(2, count):
            for which in combinations(range(count), size):
                names = tuple(samples.names[j] for j in which)
                for h in self._inner(samples, gradient, list(which))[:1]:
                    if h.misalignment <= self.angle**2:
                        error = surrogate.validation_error * h.misalignment / self.angle**2
                        kind = f"{self.name}: {shown(h.expr)}"
                        found.append(Substitution(kind, error, h.expr, names))
        return found


@dataclass(frozen=True)
class GeneralSeparability(AbstractInnerSearch):
    """Look for f = F(g(x_S) + h(x_R)): a sum inside one more function of one variable.

    Products are sums of logarithms, so F(g(x_S) h(x_R)) is found too where g and h have one sign.
    """

    max_cost: int = 6
    name = "general separability"

    def find(
        self, samples: Samples, surrogate: Surrogate, support: Support
    ) -> list[AbstractReduction]:
        """Find sums over each partition of the variables."""
        if not support.fills_space:
            return []
        gradient = surrogate.gradient(samples.X)
        found: list[AbstractReduction] = []
        for first, second in partitions(samples.X.shape[1]):
            features: list[sympy.Expr] = []
            for part in (first, second):
                columns = {samples.names[j]: samples.X[:, j] for j in part}
                most = self.max_features // 2
                features += inner_features(columns, self.max_cost, most, self.functions)
            everything = list(range(samples.X.shape[1]))
            inner = self._inner(samples, gradient, everything, features)
            found += self._accepted(inner, samples, surrogate)
        return found
