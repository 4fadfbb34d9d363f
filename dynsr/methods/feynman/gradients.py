"""Inner functions from gradients: h such that grad f is parallel to grad h.

If f = F(h(x_S), x_R) then the derivatives of f by the x_S are those of h times one number, so
their direction is that of grad h wherever one looks (Udrescu et al. 2020, section 2.5). For
h = sum_k c_k phi_k(x) the part of grad h across that direction u is linear in c,

    sum_k c_k (grad phi_k - (grad phi_k . u) u) = 0,

so the best c for given features is the least generalised eigenvector of two Gram matrices, and
all small sets of features are tried at once. AI Feynman tries formulas without constants
instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import sympy

from dynsr.expression import compile_numpy, complexity
from dynsr.methods.constants import skeleton
from dynsr.methods.feynman.features import build_features

_CLOSE = 4.0
_LARGEST_SET = 3


@dataclass(frozen=True)
class InnerFunction:
    """A formula h, and the mean square of the sine of the angle between grad h and grad f."""

    expr: sympy.Expr
    misalignment: float


def inner_features(columns: dict[str, np.ndarray], max_cost: int, most: int) -> list[sympy.Expr]:
    """Features that an inner function may be a sum of, cheapest first, without the constant."""
    features = build_features(columns, max_cost, 3, most + 1)
    return [expr for expr in features.exprs if expr.free_symbols]


def find_inner_functions(
    columns: dict[str, np.ndarray],
    gradient: np.ndarray,
    features: list[sympy.Expr],
    largest: int = _LARGEST_SET,
    keep: int = 3,
) -> list[InnerFunction]:
    """Find short sums of features whose gradient has the direction of ``gradient`` (n, p).

    Features and gradients are over all p ``columns``. A sum that leaves a variable out is no
    answer. Of the sums whose misalignment is within a factor 4 of the least, the ``keep``
    simplest are given; a constant in them is of any size and sign.
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
    close = [h for h in found if h.misalignment <= _CLOSE * least]
    return sorted(close, key=lambda h: (complexity(skeleton(h.expr)), h.misalignment))[:keep]


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
