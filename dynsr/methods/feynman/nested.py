"""Power laws inside one function: y = v T^-1(C x_1^a_1 ... x_p^a_p), v one variable or 1.

Such as n0 exp(-m g x / (k T)), whose exponent is too long to be enumerated. No search is needed:
for each change T and each v the exponents are one linear fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy

from dynsr.methods.feynman.domain import CHANGES, Target, make_targets
from dynsr.methods.feynman.finishing import as_power, signs_of, snap_all, write_power
from dynsr.methods.feynman.fitting import fit_robustly
from dynsr.methods.feynman.pool import Found, Writer, measure
from dynsr.methods.feynman.problem import has_logarithm


def find_nested(X: np.ndarray, y: np.ndarray, symbols: Sequence[sympy.Expr]) -> list[Found]:
    """Give the best formula for every change and variable.

    >>> X = np.random.default_rng(0).uniform(1.0, 2.0, (50, 3))
    >>> y = X[:, 0] * np.exp(-X[:, 1] / X[:, 2])
    >>> best = min(find_nested(X, y, sympy.symbols("a b c")), key=lambda f: f.loss)
    >>> bool(best.loss < 1e-12)
    True
    """
    usable = [j for j in range(X.shape[1]) if has_logarithm(X[:, j])]
    targets = make_targets(y, tuple(CHANGES))[1:]
    for j in usable:
        targets += make_targets(y, tuple(CHANGES), X[:, j], symbols[j])[1:]
    return [found for target in targets for found in _fit(target, X, y, symbols, usable)]


def _fit(
    target: Target,
    X: np.ndarray,
    y: np.ndarray,
    symbols: Sequence[sympy.Expr],
    usable: Sequence[int],
) -> list[Found]:
    size = np.abs(target.values)
    if size.min() <= 1e-9 * size.max() or not usable:
        return []
    logs = np.log(np.abs(X[:, usable]))
    design = np.column_stack([np.ones(len(y)), logs])[None]
    powers = snap_all(fit_robustly(design, np.log(size), size * target.weights)[:, 1:], len(usable))
    law = np.exp(logs @ powers[0])
    for j, power in zip(usable, powers[0], strict=True):
        law = law * signs_of(X[:, j], np.array([power]))[0]
    factor = fit_robustly(law[None, :, None], target.values, target.weights)[0, 0]

    def write(k: int) -> tuple[float, Writer]:
        numbers = [as_power(power) for power in powers[0]]
        factors = [
            write_power(symbols[j], X[:, j], n) for j, n in zip(usable, numbers, strict=True)
        ]
        letters = 8.0 + 3 * sum(n != 0 for n in numbers) + 4 * sum(n.is_Float for n in numbers)
        return letters, lambda: target.build(sympy.Mul(sympy.Float(factor), *factors))

    return measure(target.invert(factor * law)[None], y, write)
