"""Profiles: functions with one constant inside, beside sums of powers, on exact slopes.

With the constant held, everything else is linear, so that what is left of the slopes is a function
of that one number (variable projection; Golub and Pereyra 1973). On exact slopes it falls to their
error at the constant of the law and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations

import numpy as np
import sympy
from scipy.optimize import minimize_scalar

from dynsr.data import Samples
from dynsr.expression import ByText, compile_columns
from dynsr.fit import eliminate
from dynsr.selection.terms import products, weighted_sum

# Highest degree of the powers, and of what stands before the function, from simple to rich.
_LADDER = ((1, 1), (2, 1), (3, 1), (2, 2), (3, 2))
# Columns at most, of so many rows a column at least; rows that are looked at.
_MOST, _ROWS_EACH, _ROWS = 40, 2, 240
# Values of a constant that are tried, and functions whose constant is then refined.
_TRIED, _REFINED = 24, 20
# Share of a column that is not in the others from which on it says anything of its own.
_OWN = 1e-7
# Times the median miss beyond which a row is one where differences fail; share that may be.
_FAR, _WILD = 5.0, 0.05
# Size of a term, in that of the slopes, from which on terms only cancel each other.
_CANCELLED = 100.0
# Powers and frequencies that are tried; next to a whole power one is one of those beside it.
_POWERS = tuple(np.arange(-3.9, 4.0, 0.2).tolist())
_FREQUENCIES = tuple(np.arange(0.5, 4.1, 0.25).tolist())
INSIDE = sympy.Symbol("constant inside")
# How far the constant moves when terms leave, in steps of those tried.
_CLOSE = 0.02
# Gauss-Newton steps of the constant then; each doubles its digits.
_STEPS = 5


@dataclass(frozen=True)
class Profile:
    """Functions of columns with one constant inside.

    Parameters
    ----------
    make : gives, for the constant, the functions that stand side by side, such as sine and cosine,
        in each of the ways to write them.
    tried : values of the constant; one where there is none.
    """

    make: Callable[[sympy.Expr], tuple[tuple[sympy.Expr, ...], ...]]
    tried: tuple[float, ...]

    @property
    def count(self) -> int:
        """Functions that stand side by side."""
        return len(self.make(INSIDE)[0])


def find_profiles(samples: Samples) -> list[Profile]:
    """Give the functions that textbooks have of such columns: saturations, powers, exponentials.

    Parameters
    ----------
    samples : the columns.

    >>> x = np.linspace(0.5, 3.0, 30)
    >>> some = find_profiles(Samples(x[:, None], x, ("x",), "x", "given", x))
    >>> sympy.Symbol("k") in some[0].make(sympy.Symbol("k"))[0][0].free_symbols
    True
    """
    rows = [(sympy.Symbol(n), row) for n, row in zip(samples.names, samples.X.T, strict=True)]
    moving = [(x, row) for x, row in rows if np.ptp(row) > 0]
    found = [profile for x, row in moving for profile in _of_one(x, row)]
    for (x, first), (y, second) in combinations(moving, 2):
        found += _of_two(x, y, first, second)
    return found


def _grid(low: float, high: float) -> tuple[float, ...]:
    return tuple(np.geomspace(low, high, _TRIED).tolist())


def _of_one(x: sympy.Symbol, row: np.ndarray) -> Iterator[Profile]:
    low, high, size = float(row.min()), float(row.max()), float(np.median(np.abs(row)))
    span = high - low
    # Poles lie outside of the data, at either side.
    away = _grid(0.01 * span, 30 * max(span, size))
    for poles in ([gap - low for gap in away], [-high - gap for gap in away]):
        yield _saturation(lambda k: x + k, x, poles)
        yield _saturation(lambda k: (x + k) ** 2, x, poles)
    for power in (x**2, x**3, x**4):
        if power.exp % 2 == 0 or low > 0:
            halves = [v ** int(power.exp) for v in _grid(0.05 * size, 20 * size)]
            yield _saturation(partial(sympy.Add, power), power, halves)
    steep = _grid(0.1 / span, 30 / span)
    both = (*[-v for v in steep], *steep)
    yield Profile(lambda k: ((sympy.exp(k * x),),), both)
    yield Profile(lambda k: ((sympy.exp(k * x), sympy.exp(2 * k * x)),), both)
    yield Profile(lambda k: ((sympy.tanh(k * x),),), steep)
    if low > 0:
        yield Profile(lambda k: ((x**k,),), _POWERS)
        yield Profile(lambda k: ((1 / x, x**-2, x**k),), _POWERS)
        yield Profile(lambda _: ((1 / x, x**-2, x**-3),), (0.0,))
    if low < 0 < high:
        yield Profile(lambda _: ((sympy.Abs(x),),), (0.0,))
    yield Profile(lambda k: ((sympy.sin(k * x), sympy.cos(k * x)),), _FREQUENCIES)
    sine, cosine = sympy.sin(x), sympy.cos(x)
    twice = (sine, cosine, sympy.sin(2 * x), sympy.cos(2 * x))
    yield Profile(lambda _: (twice, (sine, cosine, sine * cosine, sine**2)), (0.0,))


def _saturation(
    below: Callable[[sympy.Expr], sympy.Expr], above: sympy.Expr, tried: Sequence[float]
) -> Profile:
    """What stands below a line, with 1 or its own power above."""
    return Profile(lambda k: ((1 / below(k),), (above / below(k),)), tuple(tried))


def _of_two(
    x: sympy.Symbol, y: sympy.Symbol, first: np.ndarray, second: np.ndarray
) -> Iterator[Profile]:
    if min(first.min(), second.min()) > 0:
        alike = float(np.median(first) / np.median(second))
        yield Profile(
            lambda k: ((1 / (x + k * y),), (x / (x + k * y),), (y / (x + k * y),)),
            _grid(0.03 * alike, 30 * alike),
        )
    gap = first - second
    if gap.min() < 0 < gap.max():
        yield Profile(lambda _: ((sympy.Abs(x - y),),), (0.0,))
    else:
        way = x - y if gap.min() >= 0 else y - x
        yield Profile(lambda k: ((way**k,),), tuple(p for p in _POWERS if p > 0))


def sums_beside(
    samples: Samples, errors: np.ndarray, within: float, most: int = 6
) -> list[sympy.Expr]:
    """Give sums that leave no more than the errors of the slopes, the fewest terms first.

    Parameters
    ----------
    samples : exact slopes.
    errors : (n,) of these.
    within : root mean square that a sum may leave in units of them, beside rows where they fail.
    most : terms at most.

    >>> x = np.linspace(0.2, 3.0, 80)
    >>> own = Samples(x[:, None], 0.5 - x + 2 / (x**2 + 1.75), ("x",), "x", "given", x)
    >>> found = sums_beside(own, np.full(80, 1e-7), 3.0)[0]
    >>> [round(float(a), 6) for a in sorted(found.atoms(sympy.Float)) if a > 1]
    [1.75, 2.0]
    """
    profiles = find_profiles(samples)
    rows = np.unique(np.linspace(0, len(samples) - 1, min(len(samples), _ROWS)).astype(int))
    thinned, unit = samples.select(rows), errors[rows]
    for degrees in _LADDER:
        beside = _Beside.of(thinned, unit, degrees)
        if not beside.can_tell(1):
            break
        found = [
            (len(sympy.Add.make_args(expr)), ByText(expr))
            for profile, tried in beside.likeliest(profiles)
            for expr in _settle(beside, profile, tried, within, most)
        ]
        if found:
            return [text.expr for _, text in sorted(found)]
    return []


@dataclass(frozen=True, eq=False)
class _Beside:
    """Functions beside powers, with what may stand ``before`` them, at rows in units of errors."""

    samples: Samples
    unit: np.ndarray
    powers: tuple[sympy.Expr, ...]
    before: tuple[sympy.Expr, ...]

    @classmethod
    def of(cls, samples: Samples, unit: np.ndarray, degrees: tuple[int, int]) -> _Beside:
        """Make one step of the ladder."""
        powers, before = ((sympy.S.One, *products(samples.names, d)) for d in degrees)
        return cls(samples, unit, powers, before)

    def can_tell(self, functions: int) -> bool:
        """Whether the rows can tell the coefficients of so many functions.

        Parameters
        ----------
        functions : their number.
        """
        count = len(self.powers) + functions * len(self.before)
        return count <= _MOST and _ROWS_EACH * count <= len(self.samples)

    @cached_property
    def y(self) -> np.ndarray:
        """(n,) slopes in units of their errors."""
        return self.samples.y / self.unit

    def compile(self, exprs: Sequence[sympy.Expr]) -> Callable[[float], np.ndarray]:
        """Give the values (p, n) of expressions at a constant inside, in units of the errors."""
        program = compile_columns(exprs, (*self.samples.names, str(INSIDE)))

        def at(k: float) -> np.ndarray:
            with np.errstate(all="ignore"):
                values = program(*self.samples.X.T, np.full(len(self.unit), k))
                return np.asarray(values / self.unit)

        return at

    @cached_property
    def _factors(self) -> np.ndarray:
        return self.compile(self.before)(0.0) * self.unit

    @cached_property
    def _basis(self) -> np.ndarray:
        """(n, q) orthonormal columns that span the powers."""
        return _span(self.compile(self.powers)(0.0).T)

    @cached_property
    def _rest(self) -> np.ndarray:
        """(n,) slopes without what the powers follow."""
        return self.y - self._basis @ (self._basis.T @ self.y)

    def rest(self, functions: np.ndarray) -> np.ndarray:
        """(n,) what functions (q, n) beside the powers leave of the slopes; inf where they fail."""
        columns = (functions[:, None] * self._factors[None]).reshape(-1, len(self._rest)).T
        if not np.all(np.isfinite(columns)):
            return np.full_like(self._rest, np.inf)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        own = _span(columns - self._basis @ (self._basis.T @ columns), 1.0)
        return self._rest - own @ (own.T @ self._rest)

    def follow(self, profile: Profile) -> Callable[[float], np.ndarray]:
        """Give what is left of the slopes (n,) as a function of the constant inside."""
        at = self.compile(profile.make(INSIDE)[0])
        return lambda k: self.rest(at(k))

    def likeliest(self, profiles: Sequence[Profile]) -> list[tuple[Profile, list[float]]]:
        """Give the functions that leave least, with what each constant tried leaves."""
        tried = []
        for profile in (p for p in profiles if self.can_tell(p.count)):
            rest = self.follow(profile)
            tried.append((profile, [_size(rest(k)) for k in profile.tried]))
        return sorted(tried, key=lambda pair: min(pair[1]))[:_REFINED]

    def refine(self, profile: Profile, near: tuple[float, float], k: float) -> float:
        """Give the constant between two others that leaves least."""
        rest = self.follow(profile)
        if near[0] == near[1]:
            return k
        return _least(lambda value: _size(rest(value)), k, min(near), max(near))

    def select(self, rows: np.ndarray) -> _Beside:
        """Give the same on some rows."""
        return replace(self, samples=self.samples.select(rows), unit=self.unit[rows])


def _span(columns: np.ndarray, unit: float | None = None) -> np.ndarray:
    """Orthonormal columns that span those given, as far as they differ."""
    if unit is None:
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    u, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return u[:, sizes > _OWN * (sizes[0] if unit is None else unit)]


def _least(miss: Callable[[float], float], k: float, low: float, high: float) -> float:
    """Give the constant between two others that leaves least, ``k`` where none leaves less."""
    best = minimize_scalar(
        lambda value: np.log(miss(value) + 1e-300),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-11 * abs(k), "maxiter": 60},
    )
    return float(best.x) if best.fun < np.log(miss(k) + 1e-300) else k


def _size(rest: np.ndarray) -> float:
    with np.errstate(all="ignore"):
        return float(np.sqrt(np.mean(rest**2)))


def _settle(
    beside: _Beside, profile: Profile, tried: Sequence[float], within: float, most: int
) -> Iterator[sympy.Expr]:
    """Give the sums with the constant that leaves least, where that is no more than the errors."""
    place = int(np.argmin(tried))
    near = (profile.tried[max(place - 1, 0)], profile.tried[min(place + 1, len(tried) - 1)])
    k = beside.refine(profile, near, profile.tried[place])
    misses = np.abs(beside.follow(profile)(k))
    kept = misses <= _FAR * np.median(misses)
    if not kept.all() and np.mean(kept) >= 1 - _WILD:
        # Rows where differences fail would move the constant.
        beside = beside.select(np.flatnonzero(kept))
        k = beside.refine(profile, near, k)
    if not (beside.can_tell(profile.count) and _size(beside.follow(profile)(k)) <= within):
        return
    for which in range(len(profile.make(sympy.Float(k)))):
        expr = _thin(beside, profile, which, k, near, within, most)
        if expr is not None:
            yield expr


def _thin(
    beside: _Beside,
    profile: Profile,
    which: int,
    k: float,
    near: tuple[float, float],
    within: float,
    most: int,
) -> sympy.Expr | None:
    """Leave out the terms that are not needed, in one way to write the functions."""
    y = beside.y
    functions = profile.make(INSIDE)[which]
    terms = [*beside.powers, *(f * m for f in functions for m in beside.before)]
    at = beside.compile(terms)
    turns = beside.compile([term.diff(INSIDE) for term in terms])
    columns = at(k)
    if not np.all(np.isfinite(columns)):
        return None
    kept: list[int] = []
    for places, values in eliminate(columns.T, y):
        if _size(y - values @ columns[list(places)]) > within:
            break
        kept = list(places)

    def left(own: Sequence[int]) -> tuple[float, float]:
        """What some of the terms leave, and the constant near the one known that does."""

        def fit(value: float) -> tuple[float, float]:
            """Give what is left at a constant, and the step that makes it least."""
            columns = at(value)[own].T
            if not np.all(np.isfinite(columns)):
                return np.inf, 0.0
            coefficients = np.linalg.lstsq(columns, y, rcond=None)[0]
            turned = np.column_stack([columns, coefficients @ turns(value)[own]])
            step = 0.0
            if width and np.all(np.isfinite(turned)):
                step = float(np.linalg.lstsq(turned, y, rcond=None)[0][-1])
            return _size(y - columns @ coefficients), step

        value, (miss, step) = k, fit(k)
        for _ in range(_STEPS):
            moved = float(np.clip(value + step, k - width, k + width))
            least, further = fit(moved)
            if not least < miss:
                break
            value, miss, step = moved, least, further
        return miss, value

    width = _CLOSE * abs(near[1] - near[0])
    while 1 < len(kept) <= 2 * most:
        # Fewer terms tell the constant better, and a better constant needs fewer terms.
        fewer = [[i for i in kept if i != one] for one in kept]
        tried = [left(own) for own in fewer]
        best = min(range(len(tried)), key=lambda i: tried[i][0])
        if tried[best][0] > within:
            break
        kept, k = fewer[best], tried[best][1]
    if not 0 < len(kept) <= most:
        return None
    values = at(k)[kept]
    coefficients = np.linalg.lstsq(values.T, y, rcond=None)[0]
    chosen = [terms[i].xreplace({INSIDE: sympy.Float(k)}) for i in kept]
    return write_sum(coefficients, chosen, values * beside.unit, beside.samples.y)


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
