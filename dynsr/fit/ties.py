"""Ties: constants that are one, fitted in several places.

What is of one kind obeys one law, what leaves one column enters another, and a difference counts
both its sides alike. Data that cannot distinguish such constants measure one constant twice, and
know it better so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, permutations

import numpy as np
import sympy
from scipy.special import chdtri

from dynsr.expression import skeleton
from dynsr.fit.settings import FitSettings

Names = dict[sympy.Symbol, sympy.Symbol]

# Ways of exchanging the names of columns that are looked through at most.
_MOST = 120
# Stands for every constant: skeletons have no signs, and names that change places may turn one.
_ANY = sympy.Float(1.5)
# Constants of a term that are tried in every order; more have no order that is sure.
_IN_A_TERM = 3


def ways_alike(
    expr: sympy.Expr, state: str, twin: sympy.Expr, other: str, columns: Sequence[str]
) -> tuple[Names, ...]:
    """Give the ways of exchanging names by which one equation has the shape of another.

    Parameters
    ----------
    expr, state : an equation and whose it is.
    twin, other : the other equation and whose it is.
    columns : names that may be exchanged.

    >>> x, y = sympy.symbols("x y")
    >>> ways_alike(2.0 * x - 1.5 * x * y, "x", 0.5 * y - 0.3 * x * y, "y", ["x", "y"])
    ({x: y, y: x},)
    """
    if expr.is_Symbol or twin.is_Symbol or len(expr.args) != len(twin.args):
        return ()
    if len(expr.free_symbols) != len(twin.free_symbols):
        return ()
    alike = expr.xreplace(dict.fromkeys(expr.atoms(sympy.Float), _ANY))
    return _ways_alike(alike, state, skeleton(twin), other, tuple(columns))


@lru_cache(maxsize=20_000)
def _ways_alike(
    expr: sympy.Expr, state: str, twin: sympy.Expr, other: str, columns: tuple[str, ...]
) -> tuple[Names, ...]:
    ways = exchanges(expr, state, other, columns)
    return tuple(names for names in ways if skeleton(expr.xreplace(names)) == twin)


def exchanges(expr: sympy.Expr, state: str, other: str, columns: Sequence[str]) -> Iterator[Names]:
    """Exchange names so that one state becomes another; other names stay where possible.

    Parameters
    ----------
    expr : the equation of the first.
    state, other : the states.
    columns : names that may be exchanged.
    """
    own, theirs = sympy.Symbol(state), sympy.Symbol(other)
    names = [sympy.Symbol(name) for name in columns]
    beside = [name for name in names if name in expr.free_symbols and name != own]
    free = [name for name in names if name != theirs]
    if math.perm(len(free), len(beside)) > _MOST:
        return
    for places in permutations(free, len(beside)):
        found = dict(zip([own, *beside], [theirs, *places], strict=True))
        left = [name for name in names if name not in found.values()]
        for name in (n for n in names if n not in found):
            found[name] = name if name in left else left[0]
            left.remove(found[name])
        yield found


@dataclass(frozen=True)
class Ties:
    """Constants that stand for one, and what all are once that is known.

    Parameters
    ----------
    values : (P,) constants, tied ones alike up to their signs.
    covariance : (P, P) of them.
    partners : place -> {place: sign} of all that stand for the same constant, itself with them.
    distance : squared standard errors that the ties moved the constants by.
    count : how many numbers the ties save.
    """

    values: np.ndarray
    covariance: np.ndarray
    partners: Mapping[int, Mapping[int, int]]
    distance: float = 0.0
    count: int = 0

    @classmethod
    def untied(cls, values: np.ndarray, covariance: np.ndarray) -> Ties:
        """Give constants each of which stands for itself.

        Parameters
        ----------
        values, covariance : (P,) and (P, P), as fitted.
        """
        return cls(values, covariance, {i: {i: 1} for i in range(len(values))})


def find_ties(
    shapes: Mapping[str, sympy.Expr],
    constants: Sequence[sympy.Symbol],
    values: np.ndarray,
    covariance: np.ndarray,
    settings: FitSettings,
    held: frozenset[int] = frozenset(),
) -> Ties:
    """Give the constants of a fit that are one, as far as its data show.

    Constants may be one where they are at the same place of the same term: of another equation,
    of the same one under names that change places (all its constants at once, or one), or of
    another column of the same equation. They are where the fitted values
    are more probable so (Bayes' factor) by more bits than choosing the tie costs, and the
    likelihood ratio of the linearised fit allows it.

    Parameters
    ----------
    shapes : state -> equation with P symbols in the places of its constants.
    constants : these symbols.
    values, covariance : (P,) and (P, P), as fitted.
    settings : level of the likelihood ratio.
    held : places of constants that are known.

    >>> x, y, c0, c1 = sympy.symbols("x y c0 c1")
    >>> shapes = {"x": c0 * y * x, "y": c1 * x * y}
    >>> spread = np.diag([1e-6, 1e-6])
    >>> ties = find_ties(shapes, [c0, c1], np.array([0.731, -0.732]), spread, FitSettings())
    >>> ties.values.round(6).tolist()
    [0.7315, -0.7315]
    """
    ties = Ties.untied(values, covariance)
    if not np.all(np.isfinite(covariance)) or len(values) < 2:
        return ties
    places = {symbol: i for i, symbol in enumerate(constants)}
    pairs, groups = _offered(shapes, places)
    sets = [
        *((group, math.log2(len(groups)) + 1) for group in groups),
        *(({pair}, math.log2(len(pairs)) + 1) for pair in pairs),
    ]
    offered = [
        ([(i, j) for i, j in sorted(group) if not {i, j} & held], cost) for group, cost in sets
    ]
    while True:
        options = []
        for group, cost in offered:
            found = _tie(ties, group, cost, settings)
            if found is not None:
                options.append(found)
        if not options:
            return ties
        _, ties = max(options, key=lambda option: option[0])


def _offered(
    shapes: Mapping[str, sympy.Expr], places: Mapping[sympy.Symbol, int]
) -> tuple[list[tuple[int, int]], list[frozenset[tuple[int, int]]]]:
    """Give pairs of constants that may be one, and sets of pairs that make equations equal."""
    columns = list(shapes)
    terms = {state: sympy.Add.make_args(expr) for state, expr in shapes.items()}
    floats = {s: e.xreplace(dict.fromkeys(places, _ANY)) for s, e in shapes.items()}
    pairs: dict[tuple[int, int], None] = {}
    groups: dict[frozenset[tuple[int, int]], None] = {}
    for state, other in combinations(shapes, 2):
        for names in ({}, *ways_alike(floats[state], state, floats[other], other, columns)):
            found = _matched(terms[state], terms[other], names, places)
            pairs |= dict.fromkeys(found)
            if names and len(found) > 1:
                groups[frozenset(found)] = None
    pairs |= dict.fromkeys(_within(terms, places))
    return list(pairs), list(groups)


def _within(
    terms: Mapping[str, Sequence[sympy.Expr]], places: Mapping[sympy.Symbol, int]
) -> Iterator[tuple[int, int]]:
    """Give the pairs of constants of one equation that are at like powers of columns."""
    for own in terms.values():
        for one, another in combinations(own, 2):
            if _is_plain(one, places) and _is_plain(another, places):
                if _powers(one, places) == _powers(another, places):
                    first, second = sorted(_own(one, places) + _own(another, places))
                    yield first, second


def pairs_alike(
    shapes: Mapping[str, sympy.Expr], constants: Sequence[sympy.Symbol]
) -> list[tuple[int, int]]:
    """Give the pairs of constants that one number may stand for: what leaves one state for another.

    They are at the same place of the same term of two equations, or at like powers of two columns
    in one, as in ``k*(y - x)``.

    Parameters
    ----------
    shapes : state -> equation with symbols in the places of its constants.
    constants : these symbols.

    >>> x, y, a, b, c = sympy.symbols("x y a b c")
    >>> pairs_alike({"x": -a * x * y, "y": b * x * y - c * y}, [a, b, c])
    [(0, 1)]
    """
    places = {symbol: i for i, symbol in enumerate(constants)}
    terms = {state: sympy.Add.make_args(expr) for state, expr in shapes.items()}
    found = [
        pair
        for state, other in combinations(shapes, 2)
        for pair in _matched(terms[state], terms[other], {}, places)
    ]
    return list(dict.fromkeys([*found, *_within(terms, places)]))


def _is_plain(term: sympy.Expr, places: Mapping[sympy.Symbol, int]) -> bool:
    """Whether a term is a constant times powers of columns."""
    others = len(sympy.Mul.make_args(term)) - 1
    return len(_own(term, places)) == 1 and len(_powers(term, places)) == others


def _own(term: sympy.Expr, places: Mapping[sympy.Symbol, int]) -> list[int]:
    return [places[factor] for factor in sympy.Mul.make_args(term) if factor in places]


def _powers(term: sympy.Expr, places: Mapping[sympy.Symbol, int]) -> list[float]:
    found = [factor.as_base_exp() for factor in sympy.Mul.make_args(term) if factor not in places]
    return sorted(float(power) for base, power in found if base.is_Symbol and power.is_number)


def _matched(
    terms: Sequence[sympy.Expr],
    others: Sequence[sympy.Expr],
    names: Mapping[sympy.Symbol, sympy.Symbol],
    places: Mapping[sympy.Symbol, int],
) -> list[tuple[int, int]]:
    """Give the places of the constants of terms and of those that are the same in new names."""
    found = []
    for term in terms:
        own = sorted(term.free_symbols & places.keys(), key=lambda s: places[s])
        renamed = term.xreplace(names)
        shape = skeleton(renamed.xreplace(dict.fromkeys(own, _ANY)))
        for other in others:
            theirs = sorted(other.free_symbols & places.keys(), key=lambda s: places[s])
            if not own or len(own) != len(theirs) or len(own) > _IN_A_TERM:
                continue
            if skeleton(other.xreplace(dict.fromkeys(theirs, _ANY))) != shape:
                continue
            for order in permutations(theirs):
                changed = renamed.xreplace(dict(zip(own, order, strict=True)))
                if changed in (other, -other):
                    found += [(places[a], places[b]) for a, b in zip(own, order, strict=True)]
                    break
    return found


def _tie(
    ties: Ties, group: Sequence[tuple[int, int]], cost: float, settings: FitSettings
) -> tuple[float, Ties] | None:
    """Tie pairs more, with the bits that this saves; None where it saves none or is not allowed."""
    values, covariance = ties.values, ties.covariance
    partners = {i: dict(own) for i, own in ties.partners.items()}
    rows, saved = [], 0.0
    for i, j in group:
        if j in partners[i]:
            continue
        sign = 1 if values[i] * values[j] > 0 else -1
        row = np.zeros(len(values))
        row[i], row[j] = 1.0, -sign
        rows.append(row)
        # Untied, the second may be anything of the size of the first, with either sign.
        saved += math.log2(max(2 * abs(values[i]), 1e-300))
        joined = {**partners[i], **{k: sign * s for k, s in partners[j].items()}}
        for k, own in joined.items():
            partners[k] = {m: own * s for m, s in joined.items()}
    if not rows:
        return None
    apart = np.array(rows)
    gap, spread = apart @ values, apart @ covariance @ apart.T
    positive, volume = np.linalg.slogdet(2 * math.pi * spread)
    if not (positive > 0 and math.isfinite(volume)):
        return None
    pull = np.linalg.solve(spread, gap)
    beyond = float(gap @ pull)
    distance, count = ties.distance + beyond, ties.count + len(rows)
    gain = saved - cost - (beyond + volume) / (2 * math.log(2))
    if not (gain > 0 and distance <= chdtri(count, 1 - settings.joint)):
        return None
    across = covariance @ apart.T
    moved = values - across @ pull
    known = covariance - across @ np.linalg.solve(spread, across.T)
    for place, alike in partners.items():
        # The tied differ by rounding alone.
        moved[place] = alike[min(alike)] * moved[min(alike)]
    return gain, Ties(moved, known, partners, distance, count)
