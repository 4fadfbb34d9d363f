"""Subsets of terms: the sums that a linear fit expects to follow the states best.

All is read off the normal equations of the terms with the states eliminated; a beam of the best
subsets of one size is grown by one term at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Subset:
    """Some terms, their coefficients, the sum of squares that is left and the bits of it all."""

    places: tuple[int, ...]
    coefficients: np.ndarray
    squares: float
    bits: float


def best_subsets(
    information: np.ndarray,
    pull: np.ndarray,
    squares: float,
    costs: np.ndarray,
    rows: float,
    *,
    beam: int = 24,
    most: int = 6,
    keep: int = 40,
    least: float = 0.0,
) -> list[Subset]:
    """Give the subsets that take the fewest bits, the best first.

    Parameters
    ----------
    information : (p, p) products of the terms, with what else is free eliminated.
    pull : (p,) products of the terms with the target.
    squares : the target's own sum of squares.
    costs : (p,) bits of each term with its coefficient.
    rows : m of the bits m / 2 log2(squares / m).
    beam : subsets of each size that are grown further.
    most : terms of a subset at most.
    keep : subsets that are given at most.
    least : sum of squares below which nothing is gained, at least a billionth of ``squares``.
    """
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    gram, target = information / np.outer(scale, scale), pull / scale
    known: dict[tuple[int, ...], Subset] = {}
    layer: Sequence[tuple[int, ...]] = [()]
    for _ in range(most):
        grown: dict[tuple[int, ...], float] = {}
        for places in layer:
            left, rest, diagonal = _sweep(gram, target, squares, places)
            gains = np.where(diagonal > 1e-7, rest**2 / np.maximum(diagonal, 1e-12), 0.0)
            reached = np.maximum(left - gains, max(least, 1e-9 * squares))
            bits = rows / 2 * np.log2(reached / rows) + costs + costs[list(places)].sum()
            bits[gains <= 0] = np.inf
            for place in np.argsort(bits, kind="stable")[:beam]:
                if np.isfinite(bits[place]):
                    grown.setdefault(tuple(sorted((*places, int(place)))), float(bits[place]))
        layer = sorted(grown, key=lambda p: (grown[p], p))[:beam]
        for places in layer:
            known[places] = _solve(gram, target, squares, scale, places, grown[places])
    return sorted(known.values(), key=lambda s: (s.bits, s.places))[:keep]


def _sweep(
    gram: np.ndarray, target: np.ndarray, squares: float, places: Sequence[int]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Take some terms out: squares left, products with the rest, and squares of the rest."""
    if not places:
        return squares, target, np.diag(gram).copy()
    own = list(places)
    block = gram[np.ix_(own, own)]
    solved = np.linalg.lstsq(block, np.column_stack([target[own], gram[own]]), rcond=1e-12)[0]
    rest = target - gram[:, own] @ solved[:, 0]
    diagonal = np.diag(gram) - np.einsum("ip,ip->p", gram[own], solved[:, 1:])
    diagonal[own] = 0.0
    return float(squares - target[own] @ solved[:, 0]), rest, diagonal


def _solve(
    gram: np.ndarray,
    target: np.ndarray,
    squares: float,
    scale: np.ndarray,
    places: tuple[int, ...],
    bits: float,
) -> Subset:
    own = list(places)
    found = np.linalg.lstsq(gram[np.ix_(own, own)], target[own], rcond=1e-12)[0]
    return Subset(places, found / scale[own], float(squares - target[own] @ found), bits)
