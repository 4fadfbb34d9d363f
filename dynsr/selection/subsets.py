"""Subsets of terms: the sums that a linear fit expects to follow the states best.

All is read off the normal equations of the terms with the states eliminated; a beam of the best
subsets of one size is grown by one term at a time.
"""

from __future__ import annotations

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
    known: list[Subset] = []
    layer = _Layer.of(gram, target, squares, [()])
    for _ in range(most):
        gains = np.where(
            layer.diagonal > 1e-7, layer.rest**2 / np.maximum(layer.diagonal, 1e-12), 0.0
        )
        reached = np.maximum(layer.left[:, None] - gains, max(least, 1e-9 * squares))
        bits = rows / 2 * np.log2(reached / rows) + costs
        bits += np.array([costs[list(places)].sum() for places in layer.places])[:, None]
        bits[~((gains > 0) & np.isfinite(bits))] = np.inf
        grown: dict[tuple[int, ...], float] = {}
        for flat in np.argsort(bits, axis=None, kind="stable"):
            parent, place = divmod(int(flat), len(costs))
            if len(grown) == beam or not bits[parent, place] < np.inf:
                break
            grown.setdefault(
                tuple(sorted((*layer.places[parent], place))), float(bits[parent, place])
            )
        if not grown:
            break
        layer = _Layer.of(gram, target, squares, sorted(grown, key=lambda p: (grown[p], p)))
        known += [
            Subset(places, found / scale[list(places)], float(left), grown[places])
            for places, found, left in zip(
                layer.places, layer.coefficients, layer.left, strict=True
            )
        ]
    return sorted(known, key=lambda s: (s.bits, s.places))[:keep]


@dataclass(frozen=True, eq=False)
class _Layer:
    """Subsets of one size with their terms taken out of all others.

    ``coefficients`` (b, s); ``left`` (b,) sums of squares; ``rest`` (b, p) products of the target,
    and ``diagonal`` (b, p) squares, of what is left of each term, 0 for their own.
    """

    places: list[tuple[int, ...]]
    coefficients: np.ndarray
    left: np.ndarray
    rest: np.ndarray
    diagonal: np.ndarray

    @classmethod
    def of(
        cls, gram: np.ndarray, target: np.ndarray, squares: float, places: list[tuple[int, ...]]
    ) -> _Layer:
        own = np.array(places, dtype=int).reshape(len(places), -1)
        rows, pull = gram[own], target[own]
        solved = np.zeros((*own.shape, 1 + len(gram)))
        for one, mine in zip(solved, own if own.size else (), strict=False):
            sides = np.column_stack([target[mine], gram[mine]])
            one[:] = np.linalg.lstsq(gram[np.ix_(mine, mine)], sides, rcond=1e-12)[0]
        found = solved[..., 0]
        diagonal = np.diag(gram) - np.einsum("bsp,bsp->bp", rows, solved[..., 1:])
        np.put_along_axis(diagonal, own, 0.0, axis=1)
        rest = target - np.einsum("bsp,bs->bp", rows, found)
        return cls(places, found, squares - np.einsum("bs,bs->b", pull, found), rest, diagonal)
