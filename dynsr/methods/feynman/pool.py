"""The pool: formulas found so far with their errors on all rows, written out only at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.expression import REAL_RESOLUTION, complexity
from dynsr.pareto import Candidate, rmse

_BEST = 24


@dataclass(frozen=True, eq=False)
class Found:
    """A formula: its ``size`` in letters, the error ``bits`` a row, its RMSE, and how to write it.

    bits = mean log2(1 + |r| / (2^-30 size of y)), which a few bad rows do not decide (Udrescu et
    al. 2020, eq. 5).
    """

    size: float
    bits: float
    loss: float
    residual: np.ndarray
    write: Callable[[], sympy.Expr]


def measure(
    predicted: np.ndarray, y: np.ndarray, size: float, write: Callable[[], sympy.Expr]
) -> Found | None:
    """Make a Found of predictions at all rows; None where one is not finite."""
    loss = rmse(predicted, y)
    if not np.isfinite(loss):
        return None
    scale = REAL_RESOLUTION * (float(np.sqrt(np.mean(y * y))) or 1.0)
    residual = y - predicted
    bits = float(np.mean(np.log2(1 + np.abs(residual) / scale)))
    return Found(size, bits, loss, residual, write)


class Pool:
    """Formulas that nothing beats in size and bits, or in size and RMSE, and the best in bits."""

    def __init__(self) -> None:  # noqa: D107 (nothing to say)
        self.found: list[Found] = []

    def add(self, found: Iterable[Found | None]) -> None:
        """Take formulas in and drop what is not worth keeping."""
        everything = [*self.found, *(f for f in found if f is not None)]
        by_bits = sorted(everything, key=lambda f: (f.bits, f.size))[:_BEST]
        kept = [*_front(everything, "bits"), *_front(everything, "loss"), *by_bits]
        chosen = {id(f) for f in kept}
        self.found = [f for f in everything if id(f) in chosen]

    @property
    def best(self) -> Found | None:
        """The formula of fewest error bits."""
        return min(self.found, key=lambda f: (f.bits, f.size), default=None)

    def candidates(self, source: str) -> list[Candidate]:
        """Write the formulas out, simplest first, equal ones once."""
        written: dict[sympy.Expr, Candidate] = {}
        for found in sorted(self.found, key=lambda f: (f.size, f.bits)):
            expr = found.write()
            if expr not in written and not expr.has(sympy.zoo, sympy.nan, sympy.oo, sympy.I):
                written[expr] = Candidate(expr, found.loss, complexity(expr), source)
        return list(written.values())


def _front(found: list[Found], error: str) -> list[Found]:
    kept: list[Found] = []
    for one in sorted(found, key=lambda f: (f.size, getattr(f, error))):
        if not kept or getattr(one, error) < getattr(kept[-1], error):
            kept.append(one)
    return kept
