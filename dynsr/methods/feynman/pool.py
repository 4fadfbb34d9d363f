"""The pool: formulas found so far with their errors on all rows, written out only at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.expression import REAL_RESOLUTION, complexity
from dynsr.pareto import Candidate

_BEST, _EACH = 24, 4
_LETTER = 6.0
Writer = Callable[[], sympy.Expr]


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
    write: Writer

    def resembles(self, other: Found | None) -> bool:
        """Whether another is as long and differs by less than half of the residuals."""
        if other is None or other.size != self.size:
            return False
        apart = np.median(np.abs(self.residual - other.residual))
        return bool(apart <= 0.5 * np.median(np.abs(self.residual)))


def measure(
    predicted: np.ndarray, y: np.ndarray, write: Callable[[int], tuple[float, Writer]]
) -> list[Found]:
    """Make Founds of the best rows of (K, n) predictions at all samples.

    Best are the ``_EACH`` of least bits and those of least RMSE. ``write(k)`` gives size and
    writer of row k.
    """
    with np.errstate(all="ignore"):
        residuals = y - predicted
        losses = np.sqrt(np.einsum("kn,kn->k", residuals, residuals) / len(y))
        scale = REAL_RESOLUTION * (float(np.sqrt(np.mean(y * y))) or 1.0)
        bits = np.mean(np.log2(1 + np.abs(residuals) / scale), axis=1)
    finite = np.flatnonzero(np.isfinite(losses) & np.isfinite(bits))
    best = [finite[np.argsort(error[finite], kind="stable")[:_EACH]] for error in (bits, losses)]
    found = []
    for k in np.unique(np.concatenate(best)):
        size, writer = write(int(k))
        found.append(Found(size, float(bits[k]), float(losses[k]), residuals[k].copy(), writer))
    return found


class Pool:
    """Formulas that nothing beats in size and bits, or in size and RMSE, and the best in bits."""

    def __init__(self) -> None:
        """Start empty."""
        self.found: list[Found] = []

    def add(self, found: Iterable[Found]) -> None:
        """Take formulas in and drop what is not worth keeping."""
        everything = [*self.found, *found]
        by_bits = sorted(everything, key=lambda f: (f.bits, f.size))[:_BEST]
        kept = [*_front(everything, "bits"), *_front(everything, "loss"), *by_bits]
        chosen = {id(f) for f in kept}
        self.found = [f for f in everything if id(f) in chosen]

    @property
    def best(self) -> Found | None:
        """The formula of fewest error bits."""
        return min(self.found, key=lambda f: (f.bits, f.size), default=None)

    @property
    def shortest(self) -> Found | None:
        """The formula of least description length, letters counted at _LETTER bits.

        The noise floor is the least median residual of all, and every row counts.
        """
        if not self.found:
            return None
        sizes = np.abs([found.residual for found in self.found])
        floor = float(np.median(sizes, axis=1).min()) or 1e-300
        bits = np.log2(1 + (sizes / floor) ** 2).sum(axis=1) / 2
        lengths = bits + _LETTER * np.array([found.size for found in self.found])
        return self.found[int(np.argmin(lengths))]

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
