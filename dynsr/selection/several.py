"""Several constants inside: steps of lines, bumps, powers of what is left, beside plain terms.

With the constants inside a function held, everything else is linear, so that only these are moved
(variable projection; Golub and Pereyra 1973; the slopes of Kaufman 1975), from many starts side by
side. On exact slopes one of them ends at the law, and the terms that are not needed then leave. In
noise the same is done on what the integrals of the slopes leave of the measured states.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import compile_columns
from dynsr.fit import solve_each
from dynsr.selection.terms import never_negative, products, weighted_sum

# A function written once: of NumPy or SymPy, of columns and of constants.
Written = Callable[..., Any]
# Size of a term, in that of the slopes, from which on terms only cancel each other.
_CANCELLED = 100.0
# Middles of a step, in spreads from the mean, and its widths in spreads.
_MIDDLES, _WIDTHS = (-1.5, -0.75, 0.0, 0.75, 1.5), (0.15, 0.4, 1.0)
# Half-saturations as multiples of the usual size; powers.
_SIZES, _POWERS = (0.2, 0.7, 2.0, 6.0), (0.5, 1.0, 2.0, 4.0)
# What is left over the largest value, as a share of it, where a power falls to 0.
_BEYOND = (0.03, 0.3, 2.0)
# Times the span of a column that an end may be off it, and largest power.
_FAR, _STEEPEST = 10.0, 8.0
# Turns that a wave makes over the range of its column, in radians.
_WAVES = (1.5, 3.0, 6.0, 12.0, 24.0)
# Directions of a line of two columns.
_TURNS = np.deg2rad(np.arange(0.0, 180.0, 22.5) + 11.25)
# Share of the second column in a difference that is nothing.
_LITTLE = 0.05
# Columns that a line is drawn through at most.
_LINED = 3
# Steps that all starts make, that the likeliest make then, and how many these are.
_FIRST, _THEN, _LIKELIEST = 4, 25, 12
# How far a constant may go in one step, in its own units; the step by which slopes are measured;
# what damps a step, from first to last.
_FARTHEST, _NUDGE, _DAMPED = 2.0, 1e-6, (1e-2, 1e-12)
# Plain terms at most, and rows for each constant at least.
_MOST, _ROWS_EACH = 15, 3
# Share by which a step must be better to be followed by another.
_BETTER = 1e-4
# Constants of a sum up to which it may be a law, and no curve that follows another; waves follow
# any.
_LONGEST, _LONGEST_WAVES = 9, 6
# Constants of an exact sum up to which no longer ones are looked for.
_SURELY = 4
# Sums that are given.
_GIVEN = 6


@dataclass(frozen=True)
class Family:
    """Functions side by side with the same constants inside.

    Parameters
    ----------
    make : gives the functions, for NumPy or SymPy, of columns and constants.
    columns : the places of the columns.
    starts : (S, c) constants that are begun with.
    mirrored : gives 1 without the function, where that is as usual.
    reach : most that each constant may be off 0.
    longest : constants of a sum up to which it may be a law.
    """

    make: Written
    columns: tuple[int, ...]
    starts: np.ndarray
    mirrored: Written | None = None
    reach: tuple[float, ...] = ()
    longest: int = _LONGEST

    def sides(self) -> Iterator[Family]:
        """Give it, and what gives 1 without the function."""
        yield self
        if self.mirrored is not None:
            yield replace(self, make=self.mirrored)

    def rows(self, points: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """(B, f, n) values at points (names, n) with constants (B, c)."""
        constants = [column[:, None] for column in inside.T]
        if self.reach:
            pairs = zip(constants, self.reach, strict=True)
            constants = [np.where(np.abs(own) <= far, own, np.nan) for own, far in pairs]
        found = self.make(np, *(points[i] for i in self.columns), *constants)
        return np.stack(np.broadcast_arrays(*found), axis=1)

    def write(
        self, names: Sequence[str], inside: np.ndarray, before: Sequence[sympy.Expr]
    ) -> list[sympy.Expr]:
        """Write the functions, each with what may stand before it.

        Parameters
        ----------
        names : all columns.
        inside : (c,) the constants.
        before : what may stand before.
        """
        symbols = [sympy.Symbol(names[i]) for i in self.columns]
        halves = [sympy.Rational(round(2 * c), 2) for c in inside.tolist()]
        pairs = zip(halves, inside.tolist(), strict=True)
        numbers = [half if float(half) == c else sympy.Float(c) for half, c in pairs]
        made = self.make(sympy, *symbols, *numbers)
        return [factor * function for function in made for factor in before]


def _step(m: Any, v: Any, at: Any, steep: Any) -> tuple[Any, ...]:
    """The logistic function; those of several columns are of a line."""
    return (1 / (1 + m.exp(at - steep * v)),)


def _step_of_two(m: Any, v: Any, w: Any, at: Any, a: Any, b: Any) -> tuple[Any, ...]:
    return (1 / (1 + m.exp(at - a * v - b * w)),)


def _step_of_three(m: Any, v: Any, w: Any, u: Any, at: Any, a: Any, b: Any, c: Any) -> Any:
    return (1 / (1 + m.exp(at - a * v - b * w - c * u)),)


def _falling_step(m: Any, v: Any, at: Any, steep: Any) -> tuple[Any, ...]:
    return (1 / (1 + m.exp(steep * v - at)),)


def _falling_step_of_two(m: Any, v: Any, w: Any, at: Any, a: Any, b: Any) -> tuple[Any, ...]:
    return (1 / (1 + m.exp(a * v + b * w - at)),)


def _falling_step_of_three(m: Any, v: Any, w: Any, u: Any, at: Any, a: Any, b: Any, c: Any) -> Any:
    return (1 / (1 + m.exp(a * v + b * w + c * u - at)),)


_FALLING: dict[Written, Written] = {
    _step: _falling_step,
    _step_of_two: _falling_step_of_two,
    _step_of_three: _falling_step_of_three,
}


def _bump(m: Any, v: Any, at: Any, steep: Any) -> tuple[Any, ...]:
    return (m.exp(-steep * (v - at) ** 2),)


def _wave(m: Any, v: Any, k: Any) -> tuple[Any, ...]:
    return m.sin(k * v), m.cos(k * v)


def _wave_of_two(m: Any, v: Any, w: Any, a: Any, b: Any) -> tuple[Any, ...]:
    return m.sin(a * v + b * w), m.cos(a * v + b * w)


def _activates(_: Any, v: Any, half: Any, n: Any) -> tuple[Any, ...]:
    return (v**n / (half**n + v**n),)


def _represses(_: Any, v: Any, half: Any, n: Any) -> tuple[Any, ...]:
    return (half**n / (half**n + v**n),)


def _inhibits_itself(_: Any, v: Any, k: Any, c: Any) -> tuple[Any, ...]:
    below = 1 / (k + v + c * v**2)
    return below, v * below


def _power_of_rest(_: Any, v: Any, most: Any, n: Any, p: Any) -> tuple[Any, ...]:
    """Growth that ends where its limit is reached (Blumberg 1968; Tsoularis and Wallace 2002)."""
    return (v**n * (most - v) ** p,)


def _power_of_share(_: Any, v: Any, n: Any, p: Any) -> tuple[Any, ...]:
    """Of a share that is done, what is left goes on by itself and by what is done (Kamal 1974)."""
    return (1 - v) ** p, v**n * (1 - v) ** p


def _power_from(_: Any, v: Any, begin: Any, n: Any) -> tuple[Any, ...]:
    return ((v - begin) ** n,)


def _power_to(_: Any, v: Any, end: Any, n: Any) -> tuple[Any, ...]:
    return ((end - v) ** n,)


def _inhibit_together(_: Any, v: Any, w: Any, k: Any, c: Any) -> tuple[Any, ...]:
    below = 1 / (k + v + c * w)
    return below, v * below, w * below, v * w * below


def _saturate_both(_: Any, v: Any, w: Any, k: Any, c: Any) -> tuple[Any, ...]:
    return (v / (k + v) * w / (c + w),)


def _powers_of_both(_: Any, v: Any, w: Any, n: Any, p: Any) -> tuple[Any, ...]:
    return (v**n * w**p,)


def _softened(_: Any, v: Any, w: Any, core: Any, n: Any) -> tuple[Any, ...]:
    """What falls with a power of the distance, beside its components."""
    falls = (core**2 + v**2 + w**2) ** -n
    return v * falls, w * falls


def _apart(m: Any, v: Any, w: Any, k: Any) -> tuple[Any, ...]:
    # With next to nothing of the other it is the size of one.
    k = np.where(np.abs(k) > _LITTLE, k, np.nan) if m is np else k
    return (abs(v - k * w),)


def find_families(points: np.ndarray) -> list[Family]:
    """Give the functions of several constants that textbooks have of such columns.

    Parameters
    ----------
    points : (names, n) values of the columns.

    >>> x = np.linspace(0.1, 0.9, 30)[None]
    >>> len(find_families(x)) > 5
    True
    """
    moving = [i for i, row in enumerate(points) if np.ptp(row) > 0]
    found = [family for i in moving for family in _of_one(i, points[i])]
    for first, second in combinations(moving, 2):
        found += _of_two(first, second, points[[first, second]])
    for three in combinations(moving, _LINED):
        found.append(_lined(_step_of_three, three, points[list(three)], _directions()))
    return found


def _directions() -> np.ndarray:
    """Directions of a line of three columns, of two that are opposite one."""
    whole = [way for way in product((-1.0, 0.0, 1.0), repeat=_LINED) if way > (0.0,) * _LINED]
    return np.array(whole) / np.linalg.norm(whole, axis=1)[:, None]


def _of_one(place: int, row: np.ndarray) -> Iterator[Family]:
    own, spread, mean = (place,), float(np.std(row)), float(np.mean(row))
    low, high, size = float(row.min()), float(row.max()), float(np.median(np.abs(row)))
    yield _lined(_step, own, row[None], np.ones((1, 1)))
    bumps = [
        (mean + at * spread, 1 / (2 * wide * spread) ** 2) for at in _MIDDLES for wide in _WIDTHS
    ]
    yield Family(_bump, own, np.array(bumps))
    turns = np.array([[turn / (high - low)] for turn in _WAVES])
    yield Family(_wave, own, turns, longest=_LONGEST_WAVES)
    ends = [share * (high - low) for share in _BEYOND]
    far = (max(abs(low), abs(high)) + _FAR * (high - low), _STEEPEST)
    from_, to = (
        product([low - e for e in ends], _POWERS),
        product([high + e for e in ends], _POWERS),
    )
    yield Family(_power_from, own, np.array([*from_]), reach=far)
    yield Family(_power_to, own, np.array([*to]), reach=far)
    if low > 0:
        halves = [share * size for share in _SIZES]
        yield Family(_activates, own, np.array([*product(halves, _POWERS)]), _represses, far)
        limits = [high + e for e in ends]
        starts = np.array([*product(limits, _POWERS[:3], _POWERS[:3])])
        yield Family(_power_of_rest, own, starts, reach=(*far, _STEEPEST))
        if high < 1:
            starts = np.array([*product(_POWERS[:3], _POWERS[:3])])
            yield Family(_power_of_share, own, starts, reach=(_STEEPEST, _STEEPEST))
    if never_negative(row) and size > 0:
        pairs = product([share * size for share in _SIZES], [1 / (s * size) for s in _SIZES])
        yield Family(_inhibits_itself, own, np.array([*pairs]))


def _of_two(first: int, second: int, rows: np.ndarray) -> Iterator[Family]:
    pair, sizes = (first, second), np.median(np.abs(rows), axis=1)
    ways = np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=1)
    yield _lined(_step_of_two, pair, rows, ways)
    if np.min(rows) > 0:
        alike = [
            (one * sizes[0], other * sizes[0] / sizes[1]) for one, other in product(_SIZES, _SIZES)
        ]
        yield Family(_inhibit_together, pair, np.array(alike))
        both = [(one * sizes[0], other * sizes[1]) for one, other in product(_SIZES, _SIZES)]
        yield Family(_saturate_both, pair, np.array(both))
        powers = (-1.0, -0.5, 0.5, 1.5)
        starts = np.array([*product(powers, powers)])
        yield Family(_powers_of_both, pair, starts, reach=(_STEEPEST, _STEEPEST))
    length = float(np.median(np.hypot(*rows)))
    if length > 0 and np.all(np.ptp(rows, axis=1) > 0):
        cores = [share * length for share in (0.1, 1.0)]
        starts = np.array([*product(cores, (-0.5, 0.5, 1.0, 1.5, 2.0))])
        yield Family(_softened, pair, starts, reach=(_FAR * length, _STEEPEST))
    lines = [(a, float(np.ptp(rows[0] + a * rows[1]))) for a in (-1.0, 1.0)]
    turns = [(t / wide, a * t / wide) for t in _WAVES for a, wide in lines if wide > 0]
    yield Family(_wave_of_two, pair, np.array(turns), longest=_LONGEST_WAVES)
    gaps = ((k, rows[0] - k * rows[1]) for k in (-1.0, 1.0))
    passing = [[k] for k, gap in gaps if np.min(gap) < 0 < np.max(gap)]
    if passing:
        yield Family(_apart, pair, np.array(passing))


def _lined(make: Written, places: tuple[int, ...], rows: np.ndarray, ways: np.ndarray) -> Family:
    """Give the family of a line of columns, with starts along directions (d, columns)."""
    spreads, means = np.std(rows, axis=1), np.mean(rows, axis=1)
    starts = []
    for way, wide, at in product(ways, _WIDTHS, _MIDDLES):
        along = float(np.std(way @ ((rows - means[:, None]) / spreads[:, None])))
        slopes = way / spreads / (wide * max(along, 1e-6))
        starts.append((float(slopes @ means + at / wide), *slopes))
    return Family(make, places, np.array(starts), _FALLING[make])


@dataclass(frozen=True, eq=False)
class Goal:
    """What sums of terms are to be like.

    Parameters
    ----------
    names, points : the columns and their values (names, n).
    target : the state whose equation is sought.
    y : (n,) the slopes at the points.
    """

    names: tuple[str, ...]
    points: np.ndarray
    target: str
    y: np.ndarray


@dataclass(frozen=True, eq=False)
class SeveralInside:
    """Sums with a function of several constants that are like slopes.

    Parameters
    ----------
    goal : the slopes.
    allowed : whether a term may be used.
    """

    goal: Goal
    allowed: Callable[[sympy.Expr], bool] = lambda _: True

    @classmethod
    def of(
        cls, samples: Samples, allowed: Callable[[sympy.Expr], bool] = lambda _: True
    ) -> SeveralInside:
        """Take rows of exact slopes.

        Parameters
        ----------
        samples : the rows.
        allowed : whether a term may be used.
        """
        return cls(Goal(samples.names, samples.X.T, samples.target, samples.y), allowed)

    def sums(self, most: Sequence[float]) -> list[sympy.Expr]:
        """Give sums that leave no more than the first of some sizes that any does.

        Those of fewest constants come first.

        Parameters
        ----------
        most : root mean squares that a sum may leave, the smallest first.

        >>> x = np.linspace(0.02, 0.97, 60)
        >>> rates = (0.3 + 1.4 * x**0.8) * (1 - x) ** 1.6
        >>> own = Samples(x[:, None], rates, ("x",), "x", "given", x)
        >>> found = SeveralInside.of(own).sums([1e-7])[0]
        >>> sorted({round(float(a), 6) for a in found.atoms(sympy.Float)})
        [0.3, 0.8, 1.4, 1.6]
        """
        ended: list[_End] = []
        exact: list[_End] = []
        with np.errstate(all="ignore"):
            for level in self._levels():
                ended += level
                exact += [short for end in level for short in end.thinned_to(most[0])]
                # What so few constants say exactly, more terms say no better.
                if any(short.count <= _SURELY for short in exact):
                    break
            limit = next((l for l in most if any(end.left <= l for end in ended)), most[-1])
            thin = exact
            if limit != most[0]:
                thin = [short for end in ended for short in end.thinned_to(limit)]
            thin = [short for short in thin if short.count <= short.search.family.longest]
            thin.sort(key=lambda end: (end.count, end.left))
            written = dict.fromkeys(end.write() for end in thin)
            return [expr for expr in written if expr is not None][:_GIVEN]

    def _usable(
        self, family: Family, before: Sequence[sympy.Expr], plain: Sequence[sympy.Expr]
    ) -> tuple[np.ndarray, int]:
        """Give the places of the terms that may be used, each once, and how many are functions."""
        terms = [*family.write(self.goal.names, family.starts[0] + _NUDGE, before), *plain]
        first = {term: i for i, term in reversed([*enumerate(terms)])}
        kept = np.array(sorted(i for term, i in first.items() if self.allowed(term)), dtype=int)
        return kept, len(terms) - len(plain)

    def _levels(self) -> Iterator[list[_End]]:
        """Give where the constants of all functions end beside few terms, then beside more."""
        names = self.goal.names
        short, own = [sympy.S.One, *products(names, 1)], sympy.Symbol(self.goal.target)
        near = [sympy.S.One, own] if own in short else short
        richer = [sympy.S.One, *products(names, 2)]
        families = find_families(self.goal.points)
        for before, plain in (
            ([sympy.S.One], near),
            (near, short),
            (short, short),
            (short, richer),
        ):
            ends = (self._end_of(family, before, plain) for family in families)
            yield [end for end in ends if end is not None]

    def _end_of(
        self, family: Family, before: Sequence[sympy.Expr], plain: Sequence[sympy.Expr]
    ) -> _End | None:
        """Give where the constants of a family end beside some terms; None where too many."""
        kept, functions = self._usable(family, before, plain)
        count = len(kept) + family.starts.shape[1]
        if not np.any(kept < functions) or len(plain) > _MOST:
            return None
        if _ROWS_EACH * count > len(self.goal.y):
            return None
        search = _Projection.of(self.goal, family, before, plain)
        inside, left = search.descend(kept)
        return _End(search, kept, inside, left)


def _nudged(inside: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Give constants (B, c) with one of them moved a little, and by how much (B,), one by one."""
    for i in range(inside.shape[1]):
        moved = inside.copy()
        moved[:, i] += _NUDGE * np.maximum(np.abs(inside[:, i]), 0.1)
        yield moved, moved[:, i] - inside[:, i]


@dataclass(frozen=True, eq=False)
class _Projection:
    """The slopes without a sum whose coefficients are always the best.

    Parameters
    ----------
    goal, family : the slopes, and the functions.
    before, plain : what may stand before these, and plain terms.
    factors, beside : (g, n) values of the first, and (p, n) those of the others.
    """

    goal: Goal
    family: Family
    before: Sequence[sympy.Expr]
    plain: Sequence[sympy.Expr]
    factors: np.ndarray
    beside: np.ndarray

    @classmethod
    def of(
        cls,
        goal: Goal,
        family: Family,
        before: Sequence[sympy.Expr],
        plain: Sequence[sympy.Expr],
    ) -> _Projection:
        values = compile_columns([*before, *plain], goal.names)(*goal.points)
        beside = values[len(before) :]
        return cls(goal, family, before, plain, values[: len(before)], beside)

    def columns(self, inside: np.ndarray) -> np.ndarray:
        """(B, q, r) all terms with constants (B, c) inside, functions first."""
        rows = self.family.rows(self.goal.points, inside)
        before = (rows[:, :, None] * self.factors).reshape(len(inside), -1, rows.shape[2])
        plain = np.broadcast_to(self.beside, (len(inside), *self.beside.shape))
        return np.concatenate([before, plain], axis=1)

    def descend(self, kept: np.ndarray) -> tuple[np.ndarray, float]:
        """Give the constants that leave least from all starts, and the root mean square left.

        Parameters
        ----------
        kept : places of the terms.
        """
        inside = self.family.starts
        chosen = np.broadcast_to(kept, (len(inside), len(kept)))
        inside, left = self.move(inside, chosen, _FIRST)
        likely = np.argsort(left, kind="stable")[:_LIKELIEST]
        inside, left = self.move(inside[likely], chosen[likely], _THEN)
        best = int(np.argmin(left))
        return inside[best], float(left[best])

    def move(
        self,
        inside: np.ndarray,
        chosen: np.ndarray,
        steps: int,
        held: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Move constants where these leave less (Levenberg, Marquardt); gives what is left too.

        Parameters
        ----------
        inside : (B, c) the constants.
        chosen : (B, q) places of the terms.
        steps : at most.
        held : (B, c) which constants stay as they are; none by default.
        """
        best, least = inside.copy(), np.full(len(inside), np.inf)
        step = np.zeros_like(best)
        damped = np.full(len(inside), _DAMPED[0])
        jacobian = np.zeros((*inside.shape, len(self.goal.y)))
        missed = np.zeros((len(inside), len(self.goal.y)))
        open_ = np.arange(len(inside))
        for number in range(steps + 1):
            tried = best[open_] + step[open_]
            rest, slopes = self._project(tried, chosen[open_], sloped=number < steps)
            left = np.sqrt(np.mean(rest**2, axis=1))
            left = np.where(np.isfinite(left), left, np.inf)
            better = left < least[open_]
            slow = better & (left > (1 - _BETTER) * least[open_])
            now = open_[better]
            best[now], least[now] = tried[better], left[better]
            if number == steps:
                break
            missed[now], jacobian[now] = rest[better], slopes[better]
            if held is not None:
                jacobian[held] = 0.0
            damped[now] = np.maximum(damped[now] / 10, _DAMPED[1])
            damped[open_[~better]] *= 10
            open_ = open_[~slow & np.isfinite(least[open_]) & (damped[open_] < 1e6)]
            if not len(open_):
                break
            step[open_] = _damped_step(jacobian[open_], missed[open_], damped[open_])
            size = np.maximum(np.abs(best[open_]), 0.1)
            step[open_] = np.clip(step[open_], -_FARTHEST * size, _FARTHEST * size)
        return best, least

    def _project(
        self, inside: np.ndarray, chosen: np.ndarray, *, sloped: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """(B, n) what is left of the slopes, and, if asked, (B, c, n) by the constants."""
        columns = np.take_along_axis(self.columns(inside), chosen[:, :, None], axis=1)
        fine = np.all(np.isfinite(columns), axis=(1, 2))
        columns = np.where(fine[:, None, None], columns, 0.0)
        basis, values = solve_each(columns, self.goal.y)
        told = basis.swapaxes(1, 2) @ self.goal.y
        rest = self.goal.y - (basis @ told[..., None])[..., 0]
        slopes = np.empty((*inside.shape, len(self.goal.y)))
        for i, (moved, gap) in enumerate(_nudged(inside) if sloped else ()):
            shifted = np.take_along_axis(self.columns(moved), chosen[:, :, None], axis=1)
            turned = (shifted - columns) / gap[:, None, None]
            own = np.einsum("bq,bqn->bn", values, np.nan_to_num(turned))
            slopes[:, i] = own - (basis @ (basis.swapaxes(1, 2) @ own[..., None]))[..., 0]
        rest[~fine] = np.inf
        return rest, slopes


def _damped_step(jacobian: np.ndarray, missed: np.ndarray, damped: np.ndarray) -> np.ndarray:
    """(B, c) steps of constants, where slopes (B, c, n) would take away what is missed (B, n)."""
    sizes = np.maximum(np.linalg.norm(jacobian, axis=2), 1e-300)
    unit = jacobian / sizes[:, :, None]
    gram = unit @ unit.swapaxes(1, 2)
    gram += damped[:, None, None] * np.eye(gram.shape[1])
    pull = (unit @ missed[..., None])[..., 0]
    return np.asarray(np.linalg.solve(gram, pull[..., None])[..., 0] / sizes)


@dataclass(frozen=True, eq=False)
class _End:
    """Where the constants of a family ended beside some terms, and what is left there."""

    search: _Projection
    chosen: np.ndarray
    inside: np.ndarray
    left: float
    held: tuple[int, ...] = ()

    @property
    def count(self) -> int:
        """Constants of the sum that are no whole or half numbers."""
        return len(self.chosen) + len(self.inside) - len(self.held)

    def thinned_to(self, limit: float) -> Iterator[_End]:
        """Give the same without what is not needed, with either of two functions whose sum is 1.

        Parameters
        ----------
        limit : root mean square that may be left; nothing is given where more is.
        """
        if not self.left <= limit:
            return
        for family in self.search.family.sides():
            side = replace(self, search=replace(self.search, family=family))
            yield side.thin(limit).settled().round(lambda _: limit)

    def settled(self) -> _End:
        """Give the same with the constants where they leave least."""
        inside, left = self.search.move(self.inside[None], self.chosen[None], _THEN)
        return replace(self, inside=inside[0], left=float(left[0]))

    def thin(self, limit: float) -> _End:
        """Take out the terms that are not needed, each time the one that is missed least.

        Parameters
        ----------
        limit : root mean square that may be left.
        """
        search, end = self.search, self
        functions = len(search.columns(self.inside[None])[0]) - len(search.plain)
        while len(end.chosen) > 1:
            fewer = np.array([np.delete(end.chosen, i) for i in range(len(end.chosen))])
            fewer = fewer[np.any(fewer < functions, axis=1)]
            if not len(fewer):
                break
            inside, left = np.repeat(end.inside[None], len(fewer), axis=0), np.array([np.inf])
            # Without a term the constants may go far.
            for steps in (_FIRST, _THEN):
                if not np.min(left) <= limit:
                    inside, left = search.move(inside, fewer, steps)
            best = int(np.argmin(left))
            if not left[best] <= limit:
                break
            end = replace(end, chosen=fewer[best], inside=inside[best], left=float(left[best]))
        return end

    def round(self, most: Callable[[float], float]) -> _End:
        """Hold constants at 0, whole and half numbers where that leaves no more.

        Parameters
        ----------
        most : root mean square that may be left for what leaves so much now.
        """
        end = self
        for i, value in enumerate(self.inside.tolist()):
            for near in dict.fromkeys((0.0, round(2 * value) / 2)):
                held = (*end.held, i)
                inside, which = end.inside[None].copy(), np.zeros((1, len(end.inside)), dtype=bool)
                inside[0, i], which[0, list(held)] = near, True
                moved, left = self.search.move(inside, end.chosen[None], _THEN, which)
                if left[0] <= most(end.left):
                    end = replace(end, inside=moved[0], left=float(left[0]), held=held)
                    break
        return end

    def write(self) -> sympy.Expr | None:
        """Write the sum; None where its terms only cancel each other."""
        search, own = self.search, self.search.goal
        terms = [*search.family.write(own.names, self.inside, search.before), *search.plain]
        columns = search.columns(self.inside[None])[0][self.chosen]
        values = np.linalg.lstsq(columns.T, own.y, rcond=None)[0]
        return write_sum(values, [terms[i] for i in self.chosen], columns, own.y)


def write_sum(
    coefficients: np.ndarray, terms: Sequence[sympy.Expr], values: np.ndarray, y: np.ndarray
) -> sympy.Expr | None:
    """Write a sum; None where its terms only cancel each other.

    Parameters
    ----------
    coefficients, terms : (c,) those of the sum.
    values : (c, n) what the terms are worth.
    y : (n,) the slopes.

    >>> x, row = sympy.Symbol("x"), np.ones(3)
    >>> write_sum(np.array([2.0]), [x], row[None], row)
    2.0*x
    >>> write_sum(np.array([500.0, -499.0]), [x, x**2], np.array([row, row]), row) is None
    True
    """
    sizes = np.abs(coefficients) * np.max(np.abs(values), axis=1)
    if np.max(sizes) > _CANCELLED * np.max(np.abs(y)):
        return None
    return weighted_sum(coefficients, terms)
