"""Drift: what the time, or a column that an equation does not contain, explains of its data.

Terms of an equation times the time, the time itself, and terms of every column are tried in
addition: a score test (Rao 1948) of the residuals of the equation says which of them would help.
Sums that contain the time are tried in its place. What is likely is fitted and compared with the
equation in bits, those of the residuals, of the structure and of the constants: the more terms are
tried, the longer each of them is to name, so that a find by chance among many pays for them.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import compress
from typing import Any

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import differentiate, evaluate, expand_terms, shown, write_line
from dynsr.fit import (
    DEPENDENT,
    constant_bits,
    orthogonal,
    refit,
    same_form,
    tidy,
    unit_columns,
    with_floats,
)
from dynsr.library import Place, Written, find_turning, structure_of, textbooks
from dynsr.selection import (
    VANISHES,
    Subset,
    best_subsets,
    bodies_of,
    move_inside,
    products,
    term_bits,
    weighted_sum,
)
from dynsr.verdict.following import open_constants

TIME = sympy.Symbol("t")
# What changes along a record, such as a temperature, is an input that nobody measured.
UNMEASURED = sympy.Symbol("unmeasured")


@dataclass(frozen=True)
class DriftSettings:
    """The numbers that decide which terms are tried; a discovery's record contains them.

    Parameters
    ----------
    degree, most : variables of the equation in a product that is tried, and products at most, the
        shortest first.
    powers : powers of the time that multiply terms.
    inside : constants of functions of the time alone, in units of one over the span of the times.
    beside : terms that are added to an equation, at most.
    more : terms that a sum in its place may have more than it.
    beam : sums of each length that are grown further.
    fitted : likely formulas of each kind that are fitted, at most.
    margin : bits that lines may expect of one more than of the equation: they are rough.
    exact : share of their size by which slopes of one exact function may differ.
    """

    degree: int = 3
    most: int = 12
    powers: tuple[int, ...] = (1, 2)
    inside: tuple[float, ...] = (0.3, 1.0, 3.0)
    beside: int = 2
    more: int = 2
    beam: int = 30
    fitted: int = 4
    margin: float = 5.0
    exact: float = 1e-5


DRIFT: DriftSettings = DriftSettings()
# Bits from which on one formula follows data clearly better than another.
_CLEARLY = 8.0


@dataclass(frozen=True)
class Drift:
    """A formula that takes fewer bits than the equation of a state.

    Parameters
    ----------
    expr : the formula.
    bits : the bits that it takes more than the equation: below 0.
    said : what it means, in words.
    timed : whether it contains the time, and the equation does not.
    """

    expr: sympy.Expr
    bits: float
    said: str
    timed: bool = True


@dataclass(frozen=True, eq=False)
class TermsInTime:
    """Terms that are tried in addition to an equation or in its place.

    Parameters
    ----------
    terms : the p terms.
    values : (n, p) what they are on the rows of the data.
    functions : those that are functions of the time alone with a constant inside.
    settings : the numbers that decide.
    place : where the equation is, for what textbooks would say of a term.
    """

    terms: tuple[sympy.Expr, ...]
    values: np.ndarray
    functions: Collection[sympy.Expr]
    settings: DriftSettings
    place: Place

    @classmethod
    def of(
        cls,
        state: str,
        expr: sympy.Expr,
        columns: Mapping[str, np.ndarray],
        settings: DriftSettings = DRIFT,
        *,
        functions: bool = True,
    ) -> TermsInTime:
        """Give the terms for an equation.

        Parameters
        ----------
        state, expr : the equation.
        columns : name -> (n,) values of what it may hold, of which ``t`` is the time.
        settings : which terms.
        functions : whether these include functions of the time alone, of any rate.
        """
        names = [name for name in columns if name != "t"]
        held = [name for name in names if sympy.Symbol(name) in expr.free_symbols]
        bodies = [p.term for p in open_constants({"": expr})[1].values() if p.term is not None]
        grown = products(held, settings.degree)[: settings.most]
        plain = dict.fromkeys([sympy.S.One, *map(sympy.Symbol, names), *bodies, *grown])
        timed = [TIME**power * term for power in settings.powers for term in plain]
        alone = dict.fromkeys(_functions(columns["t"], settings) if functions else ())
        every = dict.fromkeys([*plain, *timed, *alone])
        rows = len(columns["t"])
        values = [np.broadcast_to(evaluate(e, columns), rows) for e in every]
        finite = [bool(np.all(np.isfinite(v))) for v in values]
        terms, columns_of = (tuple(compress(some, finite)) for some in (every, values))
        moved = {e for e in alone if e.atoms(sympy.Float)}
        return cls(terms, np.array(columns_of).T, moved, settings, place_among(state, columns))

    @cached_property
    def inside(self) -> tuple[sympy.Expr, ...]:
        """For each of the functions the slope by the logarithm of the constant inside."""
        return tuple(_slope_inside(e) for e in self.terms if e in self.functions)

    @cached_property
    def slopes(self) -> np.ndarray:
        """(p,) place of that slope, counted on from the terms; -1 for none."""
        movable = np.array([e in self.functions for e in self.terms])
        return np.where(movable, len(movable) + np.cumsum(movable) - 1, -1)

    @cached_property
    def timed(self) -> np.ndarray:
        """(p,) whether each contains the time."""
        return np.array([TIME in e.free_symbols for e in self.terms])

    @cached_property
    def kinds(self) -> list[np.ndarray]:
        """Places of all terms, and of those without terms that only the equation has.

        Terms of an equation that is wrong crowd others out.
        """
        plain = [e.free_symbols <= {TIME} or bool(e.is_polynomial()) for e in self.terms]
        return [np.arange(len(plain))] + ([] if all(plain) else [np.flatnonzero(plain)])

    @cached_property
    def structure(self) -> np.ndarray:
        """(p,) bits of each, without those of constants."""
        driven = (e.xreplace({TIME: UNMEASURED}) for e in self.terms)
        return np.array([term_bits(e, self.place, Written()) for e in driven])

    def costs(self, rows: float) -> np.ndarray:
        """(p,) bits of each with its constants, fitted to so many rows."""
        return self.structure + constant_bits(rows) * (1 + (self.slopes >= 0))

    def design(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """(n, p + q) values of the terms, and of the slopes of q of them by what is inside."""
        more = [np.broadcast_to(evaluate(e, columns), len(self.values)) for e in self.inside]
        return np.column_stack([self.values, *more])

    def add_up(self, found: Subset, places: Iterable[int]) -> sympy.Expr:
        """Write the sum of some terms, the constants inside them moved."""
        terms = [
            move_inside(self.terms[p], shift) if shift else self.terms[p]
            for p, shift in zip(places, found.shifts, strict=True)
        ]
        return weighted_sum(found.coefficients, terms)


def _slope_inside(term: sympy.Expr) -> sympy.Expr:
    """Give the slope of a term by the logarithm of the one constant inside it."""
    (number,) = term.atoms(sympy.Float)
    symbol = sympy.Symbol("inside")
    slope = symbol * differentiate(term.xreplace({number: symbol}), symbol)
    return slope.xreplace({symbol: number})


def _functions(t: np.ndarray, settings: DriftSettings) -> Iterator[sympy.Expr]:
    """Give functions of the time alone, as curves of one way have them."""
    span, first = float(np.ptp(t)) or 1.0, float(t.min())
    yield TIME**3
    for inside in settings.inside:
        for own in waves_in_time(sympy, TIME, sympy.Float(inside / span), sympy.Float(first)):
            yield from own


def waves_in_time(of: Any, t: Any, rate: Any, first: Any) -> list[list[Any]]:
    """Give the functions of the time by a rate and its beginning, of NumPy or SymPy, in lists.

    >>> waves_in_time(sympy, TIME, 2, 0)
    [[exp(-2*t)], [exp(2*t)], [sin(2*t), cos(2*t)], [1/(t + 0.5)]]
    """
    return [
        [of.exp(-rate * t)],
        [of.exp(rate * t)],
        [of.sin(rate * t), of.cos(rate * t)],
        [1 / (t + (1 / rate - first))],
    ]


def with_time(samples: Samples, target: str) -> Samples:
    """Give samples with the time as one more column."""
    columns = samples.timed
    values = np.column_stack(list(columns.values()))
    return Samples(values, samples.y, tuple(columns), target, "given", samples.t)


@dataclass(frozen=True, eq=False)
class Lines:
    """The linear view of an equation: what is to be explained, and what explains it.

    ``target`` (N,) is to be the sum of terms with the ``design`` (N, p), and ``misses`` (N,) are
    what the equation leaves of it, whose slopes by its constants are ``own`` (N, q). Squares below
    ``least`` are nothing.
    """

    misses: np.ndarray
    target: np.ndarray
    own: np.ndarray
    design: np.ndarray
    rows: float
    least: float = 0.0

    def propose(self, expr: sympy.Expr, library: TermsInTime) -> list[sympy.Expr]:
        """Give the most probable formulas: with more terms than the equation, and with the time.

        Parameters
        ----------
        expr : the equation.
        library : the terms that the design is of.
        """
        settings, basis = library.settings, orthogonal(self.own)
        rest = self.misses - basis @ (basis.T @ self.misses)
        now = self._bits(float(rest @ rest))
        most = len(sympy.Add.make_args(expr)) + settings.more
        enough = now + formula_bits(expr, self.rows, library.place) + settings.margin
        found = [expr + one for one in self._beside(rest, basis, now, library)]
        for kind in library.kinds:
            found += self._instead(kind, most, enough, library)
        return list(dict.fromkeys(found))

    def _beside(
        self,
        rest: np.ndarray,
        basis: np.ndarray,
        now: float,
        library: TermsInTime,
    ) -> list[sympy.Expr]:
        """Give the terms that are likely to be missing in an equation."""
        own = self.design[:, : len(library.terms)]
        left = own - basis @ (basis.T @ own)
        # What the constants of the equation can do already is no news.
        size = np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        news = np.flatnonzero(np.linalg.norm(left, axis=0) > VANISHES * size)
        if not len(news):
            return []
        costs = library.costs(self.rows)[news]
        settings = library.settings
        best = self._best(left[:, news], rest, costs, settings.beside, settings.beam)
        better = [one for one in best if one.bits < now][: settings.fitted]
        return [library.add_up(one, news[list(one.places)]) for one in better]

    def _instead(
        self,
        kind: np.ndarray,
        most: int,
        enough: float,
        library: TermsInTime,
    ) -> list[sympy.Expr]:
        """Give the likely sums of terms of a kind that contain the time."""
        inside = library.slopes[kind]
        slopes = np.where(inside >= 0, len(kind) + np.cumsum(inside >= 0) - 1, -1)
        design = self.design[:, [*kind, *inside[inside >= 0]]]
        costs = library.costs(self.rows)[kind]
        settings = library.settings
        sums = self._best(design, self.target, costs, most, settings.beam, slopes)
        pairs = [(one, kind[list(one.places)]) for one in sums if one.bits < enough]
        timed = [pair for pair in pairs if library.timed[pair[1]].any()]
        return [library.add_up(*pair) for pair in timed[: settings.fitted]]

    def _best(
        self,
        design: np.ndarray,
        target: np.ndarray,
        costs: np.ndarray,
        most: int,
        beam: int,
        slopes: np.ndarray | None = None,
    ) -> list[Subset]:
        return best_subsets(
            design.T @ design,
            design.T @ target,
            float(target @ target),
            costs,
            self.rows,
            beam=beam,
            most=most,
            keep=beam * (most + len(costs)),
            least=self.least,
            slopes=slopes,
        )

    def _bits(self, squares: float) -> float:
        return self.rows / 2 * math.log2(max(squares, self.least, 1e-300) / self.rows)


def place_among(state: str, columns: Mapping[str, np.ndarray]) -> Place:
    """Give the place of a state's equation among columns, of which ``t`` is any change in time.

    Parameters
    ----------
    state, columns : the state, and name -> (n,) values in order.
    """
    names = tuple(name for name in columns if name != "t")
    turning = find_turning(names, (columns[name] for name in names))
    driven = (*names, UNMEASURED.name) if "t" in columns else names
    return Place(state, names, driven, (*turning, UNMEASURED.name))


def formula_bits(expr: sympy.Expr, rows: float, place: Place) -> float:
    """Give the bits of a formula whose constants are fitted to so many rows.

    Parameters
    ----------
    expr, rows, place : the formula, the rows, and where it is.
    """
    loose = with_floats(expr).xreplace({TIME: UNMEASURED})
    written = structure_of({place.state: loose}, place.columns, place.states, place.angles)
    written += textbooks().driven_bits * (UNMEASURED in loose.free_symbols)
    return written + len(open_constants({"": expr})[1]) * constant_bits(rows)


def drift_of_rows(
    state: str,
    expr: sympy.Expr,
    samples: Samples,
    floor: float,
    settings: DriftSettings = DRIFT,
    *,
    discrete: bool = False,
) -> Drift | None:
    """Give the formula that gives rows in fewer bits than an equation; None where there is none.

    Parameters
    ----------
    state, expr : the equation.
    samples : its rows, with what it is to give, and misses.
    floor : residuals below this count as 0.
    settings : which terms are tried.
    discrete : whether the equation is a map.

    >>> n = np.arange(60.0)
    >>> x = 1 + np.sin(7 * n)
    >>> rows = Samples(x[:, None], (2 + n / 60) * x + 0.01 * np.cos(9 * n), ("x",), "x", "given", n)
    >>> found = drift_of_rows("x", 2.6 * sympy.Symbol("x"), rows, 1e-6, discrete=True)
    >>> found.said.split(", as")[0]
    "its constants change along the record: x's coefficient from 2 to 2.98"
    """
    columns, n = samples.timed, len(samples)
    own = slopes_by_constants(expr, columns)[0]
    misses = samples.y - np.broadcast_to(evaluate(expr, columns), n)
    if not (np.all(np.isfinite(own)) and np.all(np.isfinite(misses))):
        return None
    library = TermsInTime.of(state, expr, columns, settings)
    lines = Lines(misses, samples.y, own, library.design(columns), n, n * floor**2)
    timed = with_time(samples, state)
    basis = orthogonal(own)
    least = float(np.mean((misses - basis @ (basis.T @ misses)) ** 2))
    found = []
    for one in lines.propose(expr, library):
        other = refit(one, timed)
        squares = float(np.mean((samples.y - evaluate(other, columns)) ** 2))
        if not math.isfinite(squares) or same_form(other, expr):
            continue
        gain = n / 2 * math.log2(max(least, floor**2) / max(squares, floor**2))
        gain *= _told_by_size(other, timed) if squares > floor**2 else 1.0
        bits = formula_bits(other, n, library.place) - formula_bits(expr, n, library.place) - gain
        found.append((bits, gain, other))
    bits, gain, best = min(found, key=lambda one: one[:2], default=(0.0, 0.0, expr))
    if bits >= 0:
        return None
    said = say(state, best, expr, samples.t, gain, discrete=discrete)
    return Drift(best, bits, said, is_timed(best, expr))


def slopes_by_constants(
    expr: sympy.Expr, columns: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, list[bool]]:
    """(n, q) slopes of a formula by its constants, and whether each belongs to the time.

    Parameters
    ----------
    expr, columns : the formula, and name -> (n,) values of its columns, of which ``t`` is the time.
    """
    opened, places = open_constants({"": expr})
    put = {symbol: sympy.Float(place.value) for symbol, place in places.items()}
    by = [differentiate(opened[""], symbol).xreplace(put) for symbol in places]
    rows = len(columns["t"])
    values = np.array([np.broadcast_to(evaluate(e, columns), rows) for e in by])
    return values.reshape(len(by), rows).T, [TIME in e.free_symbols for e in by]


def _told_by_size(expr: sympy.Expr, samples: Samples) -> float:
    """Give the share of what constants with the time seem to say, where chance changes its size.

    Chance that grows along the record pulls them more than its mean size says: the share is that of
    the Wald statistics with the covariance of White (1980) and with that of one size, 1 at most.
    """
    slopes, timed = slopes_by_constants(expr, samples.columns)
    chosen = np.flatnonzero(timed)
    if not len(chosen) or not np.all(np.isfinite(slopes)):
        return 1.0
    left = samples.y - evaluate(expr, samples.columns)
    unit, scale = unit_columns(slopes)
    inverse = np.linalg.pinv(unit, rcond=DEPENDENT)
    plain, white = inverse @ inverse.T * np.mean(left**2), (inverse * left**2) @ inverse.T
    values = np.array([place.value for place in open_constants({"": expr})[1].values()])
    mine = (values * scale)[chosen]
    square = np.ix_(chosen, chosen)
    most, least = (
        mine @ np.linalg.pinv(some[square], hermitian=True) @ mine for some in (plain, white)
    )
    return float(min(1.0, least / most)) if most > 0 else 1.0


def is_timed(expr: sympy.Expr, own: sympy.Expr) -> bool:
    """Whether a formula contains the time and the equation does not."""
    return TIME in expr.free_symbols and TIME not in own.free_symbols


def say(
    state: str,
    expr: sympy.Expr,
    own: sympy.Expr,
    t: np.ndarray,
    gain: float,
    *,
    discrete: bool = False,
) -> str:
    """Say in words what a formula with the time or more terms means for an equation.

    Parameters
    ----------
    state, expr : the formula.
    own : the equation.
    t : the times of the data.
    gain : the bits by which it follows the data better, its length not counted.
    discrete : whether it is a map.

    >>> q, v, t = sympy.symbols("q v t")
    >>> say("v", -0.03 * q * t - q - 0.1 * v, -q - 0.1 * v, np.array([0.0, 40.0]), 90.0)
    "its constants change along the record: q's coefficient from -1 to -2.2, as in v' = ..."
    >>> say("x", t + 1, sympy.sqrt(q), np.array([0.0, 40.0]), 0.0)
    "the data cannot distinguish it from x' = t + 1; a run from another start decides"
    >>> say("q", 0.2 - 0.5 * q, -0.5 * q, np.array([0.0, 40.0]), 90.0)
    'the residuals are not random: a constant term follows the data better'
    """
    written = write_line(state, tidy(expr), discrete, 4)
    if not is_timed(expr, own):
        more = [shown(body, 4) for body in bodies_of(expr) if body not in bodies_of(own)]
        if more == ["1"]:
            return "the residuals are not random: a constant term follows the data better"
        return f"the residuals are not random: they depend on {' and '.join(more) or written}"
    factors = {body: sympy.Add(*parts) for body, parts in _coefficients(expr).items()}
    changing = {body for body, factor in factors.items() if TIME in factor.free_symbols}
    ends = {"t": np.array([float(t.min()), float(t.max())])}
    drifts = any(len(_coefficients(expr)[body]) > 1 for body in changing)
    if drifts and set(factors) != {sympy.S.One}:
        parts = []
        for body in sorted(changing, key=str):
            first, last = np.broadcast_to(evaluate(factors[body], ends), 2)
            name = "its constant term" if body == 1 else f"{shown(body, 4)}'s coefficient"
            parts.append(f"{name} from {first:.3g} to {last:.3g}")
        return f"its constants change along the record: {' and '.join(parts)}, as in {written}"
    if gain > _CLEARLY:
        return f"{written}, which contains the time, fits them better"
    return f"the data cannot distinguish it from {written}; a run from another start decides"


def _coefficients(expr: sympy.Expr) -> dict[sympy.Expr, list[sympy.Expr]]:
    """Give for every product without the time the terms in the time alone that multiply it."""
    found: dict[sympy.Expr, list[sympy.Expr]] = {}
    for term in sympy.Add.make_args(expand_terms(expr)):
        factors = sympy.Mul.make_args(term)
        mine = [f for f in factors if f.free_symbols <= {TIME}]
        body = sympy.Mul(*(f for f in factors if f not in mine))
        found.setdefault(body, []).append(sympy.Mul(*mine))
    return found
