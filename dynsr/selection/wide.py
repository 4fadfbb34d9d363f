"""Wide terms: products of functions, and functions of two columns, for one equation of a system.

They are too many to be looked through wherever sums of terms are. A system that follows the data
says what its equations are worth along its states; sums that are worth the same there are soon
found among thousands of terms, and only the likeliest of them are fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import combinations, combinations_with_replacement
from typing import Any

import numpy as np
import sympy

from dynsr.expression import bits_in_force
from dynsr.selection.costs import shape_bits, unusual_bits
from dynsr.selection.terms import never_negative

# What a function may stand beside: columns, two of them, functions of other columns, other
# saturations with a column, or nothing.
_COLUMNS, _PAIRS, _FUNCTIONS = "columns", "pairs", "functions"
_SATURATIONS, _NOTHING = "saturations", "nothing"
# Constants inside, as multiples of the usual size or of the spread of a column.
_SIZES, _SPREADS = (0.3, 1.0, 3.0), (0.15, 0.5, 1.0)
# The same of half-saturations in powers: these change fast.
_HALVES = (0.35, 0.7, 1.4, 2.8)
# Exponents that are free to move.
_POWERS = (0.6, 1.4, 2.6)
# Where the middle of a step may lie, in spreads from the mean; directions that two columns step in.
_MIDDLES, _TURNS = (-1.0, 0.0, 1.0), (22.5, 45.0, 67.5, 112.5, 135.0, 157.5)
# What spans less, in radians, shows little of a wave.
_BEND = 0.7
# Share of its usual size above which a column stays apart from 0.
_APART = 0.1
# Values that are too large to be squared and summed.
LARGEST = 1e100
# What the logarithm of an exponential may reach.
_STEEP = 30.0
# Constants of a term that are moved, the step of their logarithms, and how far they may.
_BENT, _NUDGE, _FARTHEST = 3, 1e-5, 1.0
# Of the terms that bend the likest ones, as many times those asked for, have their constants moved
# so often.
DRAFTED, _MOVES = 3, 8
# Steps, of e-folds of the constants, by which terms of one shape are told apart.
_FINE = 10
# What of its own is left of a column, as a share of it, from which on it tells anything.
_TOLD = 1e-4

# A function written once: of NumPy or SymPy, of columns and of constants.
Written = Callable[..., Any]


@dataclass(frozen=True)
class _Part:
    """A function of one or two columns, given by their places, with constants inside."""

    make: Written
    columns: tuple[int, ...]
    constants: tuple[float, ...] = ()
    beside: tuple[str, ...] = (_COLUMNS,)

    def rows(self, constants: Sequence[float], points: np.ndarray) -> np.ndarray:
        """(1 + c, n) values with these constants, and slopes by their logarithms."""
        columns = [points[i] for i in self.columns]
        found = np.empty((1 + len(constants), points.shape[1]))
        found[0] = self.make(np, *columns, *constants)
        for i, constant in enumerate(constants):
            moved = [*constants[:i], constant * (1 + _NUDGE), *constants[i + 1 :]]
            found[1 + i] = (self.make(np, *columns, *moved) - found[0]) / _NUDGE
        return found


@dataclass(frozen=True, eq=False)
class Likest:
    """A wide term like a function: its place, its constants, its values and their slopes by these.

    ``block`` (1 + c, n) holds the values first; the slopes are by the constants' logarithms.
    """

    place: int
    constants: tuple[float, ...]
    block: np.ndarray


@dataclass(frozen=True, eq=False)
class WideTerms:
    """Terms made of factors; a term is written out only where it is asked for.

    Parameters
    ----------
    names : the columns.
    parts : the P factors, 1 and the columns the first of them.
    bits : (P,) what each costs in a term.
    places : (p, 3) the factors of each term.
    """

    names: tuple[str, ...]
    parts: tuple[_Part, ...]
    bits: np.ndarray
    places: np.ndarray

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        points: np.ndarray,
        angles: Sequence[str],
        *,
        powers: bool = False,
    ) -> WideTerms:
        """Make the terms of columns that take these values.

        Parameters
        ----------
        names, points : the columns and their values (len(names), n).
        angles : columns that may be angles.
        powers : whether exponents are constants inside too; noise tells few of them.

        >>> points = np.array([np.linspace(0.5, 3.0, 50), np.linspace(-1.0, 1.0, 50)])
        >>> wide = WideTerms.of(["x", "v"], points, ["v"])
        >>> any(str(wide.write(i)) == "sin(v)*cos(x)" for i in range(len(wide.places)))
        True
        """
        parts = [_Part(lambda m: 1, ()), *(_Part(_itself, (i,)) for i in range(len(names)))]
        plain = len(parts)
        for place, values in enumerate(points):
            parts += _of_one(place, values)
            parts += _powers_of(place, values) if powers else ()
        for pair in combinations(range(len(names)), 2):
            parts += _of_two(pair, points[list(pair)])
        parts = [replace(part, constants=tuple(map(_short, part.constants))) for part in parts]
        turning = [name in angles for name in names]
        counted = bits_in_force()
        bits = [
            _bits_of(p.make, tuple(turning[i] for i in p.columns), len(p.constants), counted)
            for p in parts
        ]
        places = np.array(list(_terms(parts, plain)), dtype=int).reshape(-1, 3)
        return cls(tuple(names), tuple(parts), np.array(bits) - bits[0], places)

    def write(self, place: int, constants: Sequence[float] | None = None) -> sympy.Expr:
        """Give a term, with other constants inside if they are given."""
        numbers = iter(self.constants(place) if constants is None else constants)
        found = sympy.S.One
        for part in (self.parts[i] for i in self.places[place]):
            symbols = (sympy.Symbol(self.names[i]) for i in part.columns)
            inside = (sympy.Float(next(numbers)) for _ in part.constants)
            found *= part.make(sympy, *symbols, *inside)
        return found

    def constants(self, place: int) -> tuple[float, ...]:
        """Give the constants inside a term."""
        return tuple(c for i in self.places[place] for c in self.parts[i].constants)

    def _bend(self, place: int, constants: Sequence[float], points: np.ndarray) -> np.ndarray:
        """(1 + c, n) values of a term with other constants inside, and slopes by these."""
        parts, numbers = [self.parts[i] for i in self.places[place]], iter(constants)
        rows = [part.rows([next(numbers) for _ in part.constants], points) for part in parts]
        slopes = [
            slope * math.prod(row[0] for i, row in enumerate(rows) if i != at)
            for at, own in enumerate(rows)
            for slope in own[1:]
        ]
        return np.array([math.prod(row[0] for row in rows), *slopes])

    def values(self, points: np.ndarray) -> np.ndarray:
        """(p, 1 + _BENT, n) values at points (len(names), n), and slopes by constants inside.

        These are by the logarithms; 0 where there are fewer constants.
        """
        parts = np.ones((len(self.parts), points.shape[1]))
        slopes = np.zeros((len(self.parts), _BENT, points.shape[1]))
        with np.errstate(all="ignore"):
            for place, part in enumerate(self.parts):
                rows = part.rows(part.constants, points)
                parts[place], slopes[place, : len(part.constants)] = rows[0], rows[1:]
            one, other, third = (parts[self.places[:, i]] for i in range(3))
            first, second = (slopes[self.places[:, i]] for i in range(2))
            values = np.empty((len(self.places), 1 + _BENT, points.shape[1]))
            values[:, 0] = one * other * third
            values[:, 1:] = first * (other * third)[:, None]
            # What stands beside another function has one constant at most, and so has that one.
            values[:, -1] += second[:, 0] * one * third
        return values

    @property
    def costs(self) -> np.ndarray:
        """(p,) bits of the functions in each term, its constants not counted."""
        return np.asarray(self.bits[self.places].sum(axis=1))

    @property
    def inside(self) -> np.ndarray:
        """(p,) constants inside each term."""
        own = np.array([len(part.constants) for part in self.parts])
        return np.asarray(own[self.places].sum(axis=1))

    @cached_property
    def _shapes(self) -> np.ndarray:
        """(p,) the same number for terms that differ in their constants alone."""
        kinds: dict[tuple[Written, tuple[int, ...]], int] = {}
        own = np.array([kinds.setdefault((p.make, p.columns), len(kinds)) for p in self.parts])
        return np.unique(own[self.places], axis=0, return_inverse=True)[1].reshape(-1)

    def likest(
        self,
        columns: np.ndarray,
        target: np.ndarray,
        beside: Sequence[np.ndarray],
        which: np.ndarray,
        count: int,
        points: np.ndarray,
        drafted: int = DRAFTED,
    ) -> list[Likest]:
        """Give the terms most like a function once the constants inside have moved.

        Parameters
        ----------
        columns : (p, 1 + _BENT, n) of :meth:`values`.
        target : (n,) the function.
        beside : what may stand beside a term, (c, n) each; for each so many are given.
        which : (p,) whether a term is looked at.
        count : terms for each and for each number of constants inside, one of every shape.
        points : (len(names), n) values of the columns.
        drafted : of the terms that bend, as many times ``count`` have their constants moved.
        """
        tame = np.all(np.abs(columns) < LARGEST, axis=(1, 2))
        chosen = np.flatnonzero(tame & which)
        block, inside = columns[chosen], self.inside[chosen]
        found: dict[tuple[int, ...], Likest] = {}
        for others in beside:
            basis = np.linalg.qr(others.T)[0]
            rest = block - (block @ basis) @ basis.T
            goal = target - basis @ (basis.T @ target)
            order = np.argsort(-_gains(rest, goal, block), kind="stable")
            # What bends more says more: each is held against those that bend as much.
            for bends in np.unique(inside):
                own = chosen[order[inside[order] == bends]]
                first = np.unique(self._shapes[own], return_index=True)[1]
                draft = own[np.sort(first)[: count * (drafted if bends else 1)]].tolist()
                for place in draft[:count]:
                    still = Likest(place, self.constants(place), columns[place])
                    found.setdefault((place,), still)
                moved = [self._move(place, points, basis, goal) for place in draft if bends]
                moved.sort(key=lambda pair: -pair[0])
                for _, one in moved[: count // 2]:
                    # Beside other terms the constants of one term end elsewhere.
                    ended = (round(_FINE * math.log(abs(c) or 1.0)) for c in one.constants)
                    found.setdefault((one.place, *ended), one)
        return list(found.values())

    def _move(
        self, place: int, points: np.ndarray, basis: np.ndarray, goal: np.ndarray
    ) -> tuple[float, Likest]:
        """Move the constants inside a term as a linear fit asks; gives the squares it explains.

        ``basis`` (n, k) is taken out of it, and was out of the function ``goal`` (n,).
        """
        constants = np.array(self.constants(place))
        moves = np.zeros(len(constants))
        best = -math.inf, Likest(place, tuple(constants), np.zeros((1, len(goal))))
        with np.errstate(all="ignore"):
            for _ in range(_MOVES if len(constants) else 1):
                block = self._bend(place, constants.tolist(), points)
                rest = block - (block @ basis) @ basis.T
                # What is too large for a number is no gain: NumPy's floats say so without an end.
                coefficient = rest[0] @ goal / max(rest[0] @ rest[0], 1e-300)
                gain = coefficient * (rest[0] @ goal)
                if np.all(np.abs(block) < LARGEST) and best[0] < gain < math.inf:
                    best = float(gain), Likest(place, tuple(constants.tolist()), block)
                    # Over the coefficient that the term has, small steps lead uphill; over the one
                    # that the linear fit gives it they may lead anywhere.
                    solved = np.linalg.lstsq(rest.T, goal, rcond=None)[0][1:] / coefficient
                    moves = np.clip(np.nan_to_num(solved), -_FARTHEST, _FARTHEST)
                else:
                    moves = moves / 4
                constants = np.array(best[1].constants) * np.exp(moves)
        return best


def _gains(rest: np.ndarray, goal: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """(p,) squares that terms explain, their constants inside free where they move little.

    ``rest`` are the columns (p, c, n) with others taken out of ``whole``, ``goal`` (n,) is what is
    left of the function.
    """
    sizes = np.linalg.norm(rest, axis=2)
    told = sizes > _TOLD * np.linalg.norm(whole, axis=2)
    unit = np.where(told, 1 / np.maximum(sizes, 1e-300), 0.0)
    columns = rest * unit[:, :, None]
    pull = columns @ goal
    gram = columns @ np.swapaxes(columns, 1, 2) + 1e-6 * np.eye(rest.shape[1])
    solved = np.linalg.solve(gram, pull[..., None])[..., 0]
    with np.errstate(all="ignore"):
        values = solved * unit
        near = np.all(np.abs(np.nan_to_num(values[:, 1:] / values[:, :1])) <= _FARTHEST, axis=1)
    bent = np.einsum("pc,pc->p", pull, solved)
    return np.where(near & told[:, 0], bent, np.where(told[:, 0], pull[:, 0] ** 2, 0.0))


@lru_cache(maxsize=1024)
def _bits_of(
    make: Written, turning: tuple[bool, ...], inside: int, counted: tuple[tuple[str, float], ...]
) -> float:
    """Bits of a constant times a function; ``counted`` are the user's own."""
    del counted
    names = [f"v{i}" for i in range(len(turning))]
    expr = make(sympy, *map(sympy.Symbol, names), *[sympy.Float(0.7)] * inside)
    angles = [name for name, turns in zip(names, turning, strict=True) if turns]
    whole = sympy.S.One * expr
    return shape_bits(sympy.Float(0.5) * whole) + unusual_bits(whole, angles)


def _terms(parts: Sequence[_Part], plain: int) -> Iterator[tuple[int, int, int]]:
    """Give the factors of every term: functions alone, beside a column, and beside each other."""
    for place in range(plain, len(parts)):
        for beside in range(plain if _COLUMNS in parts[place].beside else 1):
            yield place, beside, 0
        if _PAIRS in parts[place].beside:
            pairs = combinations_with_replacement(range(1, plain), 2)
            yield from ((place, *pair) for pair in pairs)
    for kind, more in ((_FUNCTIONS, range(1)), (_SATURATIONS, range(1, plain))):
        own = [i for i, part in enumerate(parts) if kind in part.beside]
        for first, second in combinations(own, 2):
            if parts[first].columns != parts[second].columns:
                yield from ((first, second, beside) for beside in more)


def _itself(_: Any, v: Any) -> Any:
    return v


def _sine(m: Any, v: Any) -> Any:
    return m.sin(v)


def _cosine(m: Any, v: Any) -> Any:
    return m.cos(v)


def _double_sine(m: Any, v: Any) -> Any:
    return m.sin(v) * m.cos(v)


def _squared_sine(m: Any, v: Any) -> Any:
    return m.sin(v) ** 2


def _fourth(_: Any, v: Any) -> Any:
    return v**4


def _size(_: Any, v: Any) -> Any:
    return abs(v)


def _falling(m: Any, v: Any, c: Any) -> Any:
    return m.exp(-c * v)


def _rising(m: Any, v: Any, c: Any) -> Any:
    return m.exp(c * v)


def _bounded(m: Any, v: Any, c: Any) -> Any:
    return m.tanh(c * v)


def _thermal(m: Any, v: Any, c: Any) -> Any:
    return m.exp(-c / v)


def _root(m: Any, v: Any) -> Any:
    return m.sqrt(v)


def _logarithm(m: Any, v: Any) -> Any:
    return m.log(v)


def _reciprocal(_: Any, v: Any) -> Any:
    return 1 / v


def _reciprocal_square(_: Any, v: Any) -> Any:
    return 1 / v**2


def _reciprocal_cube(_: Any, v: Any) -> Any:
    return 1 / v**3


def _inhibits(_: Any, v: Any, k: Any) -> Any:
    return 1 / (k + v)


def _saturates(_: Any, v: Any, k: Any) -> Any:
    return v / (k + v)


def _inhibits_itself(_: Any, v: Any, k: Any, c: Any) -> Any:
    return 1 / (k + v + c * v**2)


def _step(m: Any, v: Any, c: Any, a: Any) -> Any:
    """The logistic function."""
    return 1 / (1 + m.exp(c - a * v))


def _falling_step(m: Any, v: Any, c: Any, a: Any) -> Any:
    return 1 / (1 + m.exp(c + a * v))


def _hill(power: int) -> tuple[Written, Written]:
    """Hill's function of one power: what activates, and what represses."""
    return partial(_activates, n=power), partial(_represses, n=power)


def _activates(_: Any, v: Any, half: Any, n: Any) -> Any:
    return v**n / (half**n + v**n)


def _represses(_: Any, v: Any, half: Any, n: Any) -> Any:
    return 1 / (half**n + v**n)


def _softened(m: Any, v: Any, half: Any) -> Any:
    """Beside its column, what levels off to either side."""
    return 1 / m.sqrt(half**2 + v**2)


def _softened_attraction(m: Any, v: Any, half: Any) -> Any:
    return 1 / m.sqrt(half**2 + v**2) ** 3


def _to_power(_: Any, v: Any, n: Any) -> Any:
    return v**n


def _to_inverse_power(_: Any, v: Any, n: Any) -> Any:
    return v**-n


_HILL = {power: _hill(power) for power in (2, 3, 4, 6, 8)}


def _sine_apart(m: Any, v: Any, w: Any) -> Any:
    return m.sin(v - w)


def _cosine_apart(m: Any, v: Any, w: Any) -> Any:
    return m.cos(v - w)


def _sine_together(m: Any, v: Any, w: Any) -> Any:
    return m.sin(v + w)


def _cosine_together(m: Any, v: Any, w: Any) -> Any:
    return m.cos(v + w)


def _length(m: Any, v: Any, w: Any) -> Any:
    return m.sqrt(v**2 + w**2)


def _inverse_length(m: Any, v: Any, w: Any) -> Any:
    return 1 / m.sqrt(v**2 + w**2)


def _inverse_square_length(_: Any, v: Any, w: Any) -> Any:
    return 1 / (v**2 + w**2)


def _attraction(m: Any, v: Any, w: Any) -> Any:
    """Of what falls with the square of a distance, beside a column its component."""
    return 1 / m.sqrt(v**2 + w**2) ** 3


def _distance(_: Any, v: Any, w: Any) -> Any:
    return abs(v - w)


def _square_apart(_: Any, v: Any, w: Any) -> Any:
    return (v - w) ** 2


def _cube_apart(_: Any, v: Any, w: Any) -> Any:
    return (v - w) ** 3


def _bounded_together(m: Any, v: Any, w: Any, a: Any, b: Any) -> Any:
    return m.tanh(a * v + b * w)


def _bounded_apart(m: Any, v: Any, w: Any, a: Any, b: Any) -> Any:
    return m.tanh(a * v - b * w)


def _root_apart(m: Any, v: Any, w: Any) -> Any:
    return m.sqrt(v - w)


def _inhibit_together(_: Any, v: Any, w: Any, k: Any, c: Any) -> Any:
    return 1 / (k + v + c * w)


def _step_together(m: Any, v: Any, w: Any, c: Any, a: Any, b: Any) -> Any:
    return 1 / (1 + m.exp(c - a * v - b * w))


def _step_apart(m: Any, v: Any, w: Any, c: Any, a: Any, b: Any) -> Any:
    return 1 / (1 + m.exp(c - a * v + b * w))


def _of_one(place: int, values: np.ndarray) -> Iterator[_Part]:
    """Give the functions of one column."""
    own, both = (place,), (_COLUMNS, _FUNCTIONS)
    size, middle = float(np.median(np.abs(values))), float(np.mean(values))
    spread, largest = float(np.std(values)), float(np.max(np.abs(values)))
    if not (size > 0 and spread > 0):
        return
    positive = bool(np.min(values) > 0)
    stands = never_negative(values)
    if np.ptp(values) > _BEND:
        yield from (_Part(wave, own, (), both) for wave in (_sine, _cosine))
        yield from (_Part(wave, own) for wave in (_double_sine, _squared_sine))
    sizes = (_fourth, _size) if _changes_sign(values) else (_fourth,)
    yield from (_Part(make, own) for make in sizes)
    for power in (power for power in _HILL if stands or power % 2 == 0):
        beside = both if power == 2 else (_COLUMNS,)
        halves = [share * size for share in _HALVES]
        yield from (_Part(make, own, (half,), beside) for half in halves for make in _HILL[power])
    softened = (_softened, _softened_attraction)
    yield from (_Part(make, own, (share * size,)) for share in _SIZES for make in softened)
    for share in _SIZES:
        scale = share * size
        if largest < _STEEP * scale:
            yield _Part(_falling, own, (1 / scale,), both)
            yield _Part(_rising, own, (1 / scale,))
        yield _Part(_bounded, own, (1 / scale,), both)
        if positive:
            yield _Part(_thermal, own, (scale,))
        if stands:
            yield _Part(_inhibits, own, (scale,), both)
            yield _Part(_saturates, own, (scale,), (*both, _SATURATIONS))
            for other in _SIZES:
                constants = (scale, 1 / (other * size))
                yield _Part(_inhibits_itself, own, constants, (_COLUMNS, _PAIRS))
    if positive:
        yield _Part(_root, own, (), both)
        yield _Part(_logarithm, own)
    if np.min(values) > _APART * size:
        yield _Part(_reciprocal, own, (), (*both, _PAIRS))
        yield from (_Part(make, own) for make in (_reciprocal_square, _reciprocal_cube))
    for share in _SPREADS:
        for at in _MIDDLES:
            slope, shift = 1 / (share * spread), (middle + at * spread) / (share * spread)
            yield _Part(_step, own, (shift, slope))
            yield _Part(_falling_step, own, (-shift, slope))


def _powers_of(place: int, values: np.ndarray) -> Iterator[_Part]:
    """Give the functions of one column whose exponent is free."""
    if not np.min(values) > 0 or not np.std(values) > 0:
        return
    size, both = float(np.median(values)), (_COLUMNS, _FUNCTIONS)
    for power in _POWERS:
        yield from (
            _Part(make, (place,), (power,), both) for make in (_to_power, _to_inverse_power)
        )
        for share in _HALVES:
            constants = (share * size, power)
            yield from (_Part(make, (place,), constants) for make in (_activates, _represses))


def _of_two(pair: tuple[int, int], rows: np.ndarray) -> Iterator[_Part]:
    """Give the functions of two columns."""
    first, second = rows
    spreads, sizes = np.std(rows, axis=1), np.median(np.abs(rows), axis=1)
    if not np.min(spreads) > 0:
        return
    if np.min(np.ptp(rows, axis=1)) > _BEND:
        waves = (_sine_apart, _cosine_apart, _sine_together, _cosine_together)
        yield from (_Part(wave, pair) for wave in waves)
    yield from (_Part(make, pair) for make in _sizes_of_two(first, second))
    for order, apart in ((pair, first - second), (pair[::-1], second - first)):
        if np.min(apart) > 0:
            yield _Part(_root_apart, order)
    if all(map(never_negative, rows)):
        for one in _SIZES:
            for other in _SIZES:
                scales = (float(other * sizes[0]), float(one * sizes[0] / sizes[1]))
                yield _Part(_inhibit_together, pair, scales, (_COLUMNS, _PAIRS))
    for turn in np.deg2rad(_TURNS):
        ways = np.array([np.cos(turn), np.sin(turn)]) / spreads
        for share in _SPREADS:
            line = (float(abs(ways[0])) / share, float(ways[1]) / share)
            yield _Part(_bounded_together if ways[0] > 0 else _bounded_apart, pair, line)
            for at in _MIDDLES:
                shift = float(ways @ np.mean(rows, axis=1) + at) / share
                slopes = (float(ways[0]) / share, float(ways[1]) / share)
                # Of c - a v - b w both slopes are positive, whichever way the step goes.
                if slopes[0] > 0:
                    yield _Part(_step_together, pair, (shift, *slopes), (_NOTHING,))
                else:
                    slopes = (-slopes[0], slopes[1])
                    yield _Part(_step_apart, pair, (-shift, *slopes), (_NOTHING,))


def _sizes_of_two(first: np.ndarray, second: np.ndarray) -> Iterator[Written]:
    """Give the functions without a constant: lengths, what falls with them, and differences."""
    yield from (_length, _square_apart, _cube_apart)
    # Of one sign a distance is a difference, which simpler terms are.
    if _changes_sign(first - second):
        yield _distance
    lengths = np.hypot(first, second)
    if np.min(lengths) > _APART * np.median(lengths):
        yield from (_inverse_length, _inverse_square_length, _attraction)


def _changes_sign(values: np.ndarray) -> bool:
    return bool(np.min(values) < 0 < np.max(values))


def _short(value: float) -> float:
    return float(f"{value:.3g}")
