"""Subsets of terms: the sums that a linear fit expects to follow the states best.

All is read from the normal equations of the terms with the states eliminated; a beam of the best
subsets of one size is grown by one term at a time. A term with a constant inside brings a second
column, its slope by that constant, which says what another value of the constant would do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dynsr.fit import ROUNDING

# Square of what is left of a unit column from which on it is rounding.
_NOTHING = 1e-7
# Share of its size, of the largest, or of all squares, below which something is only rounding.
SINGULAR = 1e-9
# Logarithm of a constant inside by which a linear fit may move it.
FARTHEST = 1.0


@dataclass(frozen=True, eq=False)
class Subset:
    """Some terms, their coefficients, the sum of squares that is left and the bits of it all.

    ``shifts`` are the logarithms of what the constants inside are to be multiplied by; 0 for a term
    without one.
    """

    places: tuple[int, ...]
    coefficients: np.ndarray
    squares: float
    bits: float
    shifts: np.ndarray


def best_subsets(
    information: np.ndarray,
    pull: np.ndarray,
    squares: float,
    costs: np.ndarray,
    rows: float,
    *,
    beam: int = 40,
    most: int = 6,
    keep: int = 40,
    least: float = 0.0,
    slopes: np.ndarray | None = None,
) -> list[Subset]:
    """Give the subsets that take the fewest bits, the best first.

    Parameters
    ----------
    information : (p, p) products of the terms, with what else is free eliminated.
    pull : (p,) products of the terms with the target.
    squares : the target's own sum of squares.
    costs : (p,) bits of each term with its coefficient.
    rows : m of the bits m / 2 log2(squares / m).
    beam : subsets of each size that are grown further; all single terms are, since two
        that explain nothing alone may explain everything together.
    most : terms of a subset at most.
    keep : subsets that are given at most.
    least : sum of squares below which nothing is gained, at least a billionth of ``squares``.
    slopes : (terms,) place of the column that is the slope of a term by the logarithm of the
        constant inside it, -1 for a term without; the first columns are the terms, in the order of
        ``costs``, and by default they are all.
    """
    slopes = np.full(len(costs), -1) if slopes is None else slopes
    own = np.diag(information)
    # What else is free may leave nothing of a term but rounding, below 0 too.
    scale = np.where(own > 0, np.sqrt(np.maximum(own, 1e-300)), np.inf)
    gram, target = information / np.outer(scale, scale), pull / scale
    known: list[tuple[float, tuple[int, ...], _Layer, int]] = []
    layer = _Layer.of(gram, target, squares, [()], slopes)
    for size in range(most):
        gains = layer.gains(slopes, scale)
        reached = np.maximum(layer.left[:, None] - gains, max(least, SINGULAR * squares))
        bits = rows / 2 * np.log2(reached / rows) + costs
        bits += np.array([costs[list(places)].sum() for places in layer.places])[:, None]
        bits[~((gains > 0) & np.isfinite(bits))] = np.inf
        grown: dict[tuple[int, ...], float] = {}
        for flat in _ascending(bits.ravel(), 4 * beam if size else bits.size):
            parent, place = divmod(int(flat), len(costs))
            if (size and len(grown) == beam) or not bits[parent, place] < np.inf:
                break
            grown.setdefault(
                tuple(sorted((*layer.places[parent], place))), float(bits[parent, place])
            )
        if not grown:
            break
        ranked = sorted(grown, key=lambda p: (grown[p], p))
        layer = _Layer.of(gram, target, squares, ranked, slopes)
        known += [(grown[places], places, layer, i) for i, places in enumerate(layer.places)]
    known.sort(key=lambda found: found[:2])
    return [
        _subset(places, bits, layer.coefficients[i] / scale, layer.left[i], slopes)
        for bits, places, layer, i in known[:keep]
    ]


def _ascending(values: np.ndarray, first: int) -> Iterator[int]:
    """Give the places of values in their order, equal ones by place; more are sorted if asked for.

    Nearly always the first are enough of a million.
    """
    given = 0
    while given < len(values):
        count = min(max(first, 2 * given), len(values))
        bound = np.partition(values, count - 1)[count - 1]
        among = np.flatnonzero(~(values > bound))
        order = among[np.argsort(values[among], kind="stable")]
        yield from order[given:].tolist()
        given = len(order)


def _subset(
    places: tuple[int, ...], bits: float, found: np.ndarray, left: float, slopes: np.ndarray
) -> Subset:
    own, values = slopes[list(places)], found[list(places)]
    if np.all(own < 0):
        return Subset(places, values, float(left), bits, np.zeros(len(own)))
    moved = np.where(own >= 0, found[own], 0.0)
    with np.errstate(all="ignore"):
        shifts = np.nan_to_num(np.clip(moved / values, -FARTHEST, FARTHEST))
    return Subset(places, values, float(left), bits, shifts)


@dataclass(frozen=True, eq=False)
class _Layer:
    """Subsets of one size with their columns taken out of all others.

    ``coefficients`` (b, c) of all columns, 0 for those that are not their own; ``left`` (b,) sums
    of squares; ``rest`` (b, c) products of the target, and ``diagonal`` (b, c) squares, of the
    residual of each column, 0 for their own; ``beside`` (b, p) products of the residuals of each
    term and of its slope, where any has one.
    """

    places: list[tuple[int, ...]]
    coefficients: np.ndarray
    left: np.ndarray
    rest: np.ndarray
    diagonal: np.ndarray
    beside: np.ndarray

    @classmethod
    def of(
        cls,
        gram: np.ndarray,
        target: np.ndarray,
        squares: float,
        places: list[tuple[int, ...]],
        slopes: np.ndarray,
    ) -> _Layer:
        count = len(gram)
        left, coefficients = np.full(len(places), squares), np.zeros((len(places), count))
        rest, diagonal = np.tile(target, (len(places), 1)), np.tile(np.diag(gram), (len(places), 1))
        terms = np.arange(len(slopes))
        beside = np.tile(gram[terms, slopes], (len(places), 1))
        found = cls(places, coefficients, left, rest, diagonal, beside)
        alone = [i for i, own in enumerate(places) if len(own) == 1 and slopes[own[0]] < 0]
        if alone:
            found._take_out_one(np.array(alone), gram, target, slopes)
        sides = np.column_stack([target, gram])
        for i, own in enumerate(places):
            mine = [*own, *(int(slopes[p]) for p in own if slopes[p] >= 0)]
            if len(mine) > 1:
                found._take_out(i, mine, sides, slopes)
        return found

    def _take_out_one(
        self, rows: np.ndarray, gram: np.ndarray, target: np.ndarray, slopes: np.ndarray
    ) -> None:
        """Take one column out in each of some rows."""
        own = np.array([self.places[row][0] for row in rows])
        mine, inverse = gram[own], 1 / gram[own, own]
        value, solved = target[own] * inverse, mine * inverse[:, None]
        self.coefficients[rows, own] = value
        self.rest[rows] -= value[:, None] * mine
        self.diagonal[rows] -= mine * solved
        self.diagonal[rows, own] = 0.0
        if np.any(slopes >= 0):
            self.beside[rows] -= mine[:, : len(slopes)] * solved[:, slopes]
        self.left[rows] -= target[own] * value

    def _take_out(self, row: int, mine: list[int], sides: np.ndarray, slopes: np.ndarray) -> None:
        """Take columns out in one row; ``sides`` (c, 1 + c) are their products with all."""
        own = sides[mine]
        solved = np.linalg.lstsq(own[:, 1:][:, mine], own, rcond=ROUNDING)[0]
        gained, left = solved[:, 0], own[:, 1:]
        self.coefficients[row, mine] = gained
        self.rest[row] -= gained @ left
        self.diagonal[row] -= np.einsum("sc,sc->c", left, solved[:, 1:])
        self.diagonal[row, mine] = 0.0
        if np.any(slopes >= 0):
            terms = np.arange(len(slopes))
            both = left[:, terms], solved[:, 1:][:, slopes]
            self.beside[row] -= np.einsum("sp,sp->p", *both)
        self.left[row] -= own[:, 0] @ gained

    def gains(self, slopes: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """(b, p) what each term takes off the sums of squares, its constant inside set free.

        Where a linear fit would move that far, the term is taken as it is.
        """
        terms = np.arange(len(slopes))
        own, rest = self.diagonal[:, terms], self.rest[:, terms]
        alone = np.where(own > _NOTHING, rest**2 / np.maximum(own, _NOTHING), 0.0)
        if not np.any(slopes >= 0):
            return alone
        other, pull = self.diagonal[:, slopes], self.rest[:, slopes]
        with np.errstate(all="ignore"):
            whole = own * other - self.beside**2
            mine = (rest * other - pull * self.beside) / whole
            moved = (pull * own - rest * self.beside) / whole
            shift = moved / mine * (scale[terms] / scale[slopes])
            both = mine * rest + moved * pull
        fine = (slopes >= 0) & (own > _NOTHING) & (whole > _NOTHING * own)
        return np.where(fine & (np.abs(shift) <= FARTHEST), both, alone)


def solve_scaled(gram: np.ndarray, loose: Sequence[int], sides: np.ndarray) -> np.ndarray:
    """(l, s): what the normal equations of some directions give for right sides (l, s).

    Parameters
    ----------
    gram : (P, P) products of all directions.
    loose : places of the l that are free.
    sides : (l, s) right sides.
    """
    scale = np.sqrt(np.maximum(np.diag(gram)[loose], 1e-300))
    scaled = gram[np.ix_(loose, loose)] / np.outer(scale, scale) + SINGULAR * np.eye(len(loose))
    return np.asarray(np.linalg.solve(scaled, sides / scale[:, None]) / scale[:, None])


def without(gram: np.ndarray, loose: Sequence[int], first: int) -> np.ndarray:
    """Give the products of the directions from ``first`` on, with others free.

    Parameters
    ----------
    gram : (P, P) products of all directions.
    loose : places of those that are free.
    first : place of the first that is left.
    """
    moved = solve_scaled(gram, loose, gram[loose, first:])
    return np.asarray(gram[first:, first:] - gram[first:, loose] @ moved)


def taken_whole(gram: np.ndarray, place: int) -> np.ndarray:
    """Give the products with the factor of one direction fixed at 1; the last are the residuals.

    Parameters
    ----------
    gram : (P, P) products of all directions, the residuals the last.
    place : of the direction.
    """
    step = np.eye(len(gram))
    step[-1, place] = 1.0
    return np.asarray(step @ gram @ step.T)
