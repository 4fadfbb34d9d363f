"""Polishing: the constants of the chosen equations, together, on all the data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np
import sympy
from scipy.special import chdtrc, chdtri

from dynsr.data import Samples, Trajectory
from dynsr.expression import complexity, free_constants, number_bits
from dynsr.fit.collocation import AlongFit, Measurements, fit_along
from dynsr.fit.constants import as_floats
from dynsr.fit.description import data_bits, shift_bits, written_bits, written_constant
from dynsr.fit.linear import know
from dynsr.fit.noise import NOISY, Noise, is_noisy, noise_and_spread, residual_noise
from dynsr.fit.settings import FIT, FitSettings
from dynsr.fit.shooting import Match, fitted_values, match_trajectories, measure_errors, prepare
from dynsr.fit.simple import reach, simple_value
from dynsr.fit.snapping import readable, snap, usable_numbers
from dynsr.fit.ties import Ties, find_ties
from dynsr.fit.variation import loosen, with_floats
from dynsr.fit.whole import StatesFit, fit_states, interval_reach

Data: TypeAlias = Sequence[Trajectory] | Measurements
Fit: TypeAlias = StatesFit | AlongFit


class Estimate(Protocol):
    """Constants (P,) with their covariance (P, P), and the equations that contain them."""

    @property
    def constants(self) -> np.ndarray:
        """Their values."""

    @property
    def covariance(self) -> np.ndarray:
        """Their covariance."""

    @property
    def errors(self) -> np.ndarray:
        """Their standard errors."""

    def put(self, numbers: Sequence[sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give the equations with P numbers in the places of the constants."""


def polish(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    samples: Mapping[str, Samples],
    noise: Mapping[str, Noise],
    settings: FitSettings = FIT,
    data: Measurements | None = None,
    confirmed: Match | None = None,
) -> Match:
    """Give the equations with final constants, and the standard error of each of these.

    Clean slopes are trusted: their constants are snapped on all samples, and those that stay
    floats are fitted to the states. Slopes of noisy data are biased by their smoother: there all
    constants are fitted to the states first. A simpler formula is kept when formula and states
    together take fewer bits with it.

    Parameters
    ----------
    exprs : state -> the equation chosen for it.
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t``, where it is known.
    samples, noise : state -> its samples, and what cannot be explained in them.
    settings : the numbers that decide.
    data : the noisy states with their noise and smoothed curves, where they are known.
    confirmed : the equations as exact states confirmed them, which are final already.
    """
    if confirmed is not None:
        return _with_errors(confirmed, runs, inputs, settings)
    if data is not None or is_noisy(runs):
        return _Polishing(runs if data is None else data, inputs, settings).match(exprs)
    start = {s: snap(with_floats(e), samples[s], noise[s], settings) for s, e in exprs.items()}
    match = match_trajectories(start, runs, inputs=inputs, settings=settings)
    if match.success and len(match.misses):
        level = residual_noise([match.misses], np.ones(len(match.misses)))
        match = _snap_by_errors(match, runs, inputs, level, settings)
    elif not match.success:
        match = Match.untouched(start)
    if match.success and not settings.snap:
        match = match_trajectories(loosen_all(match.exprs), runs, inputs=inputs, settings=settings)
    return _with_errors(match, runs, inputs, settings)


def _with_errors(
    match: Match,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings,
) -> Match:
    """Round and tidy the equations, and give every constant its standard error."""
    final = {s: readable(_round_floats(e)) for s, e in match.exprs.items()}
    loose = loosen_all(final)
    measured = measure_errors(loose, runs, inputs, settings)
    fitted = fitted_values(loose, runs, inputs, settings)
    # Errors of the states' solver are no chance: a number that was taken is no less sure than far.
    errors = {
        s: tuple(
            (value, max(error, abs(value - near)))
            for (value, error), near in zip(pairs, fitted[s], strict=True)
        )
        for s, pairs in measured.items()
    }
    return replace(match, exprs=final, errors=errors, fitted=fitted)


def _plain(data: Data) -> Sequence[Trajectory]:
    return data.runs if isinstance(data, Measurements) else data


def _numbers(fit: Fit, taken: Mapping[int, sympy.Expr]) -> list[sympy.Expr]:
    """Give the constants, some of them with the numbers that were taken for them."""
    return [taken.get(i, number) for i, number in enumerate(as_floats(fit.constants))]


@dataclass(frozen=True, eq=False)
class _Polishing:
    """The fits of constants to noisy states, and the simple numbers that these allow.

    Parameters
    ----------
    data : the trajectories, or the noisy states with their smoothed curves.
    inputs : input name -> expression in ``t``, where it is known.
    settings : the numbers that decide.
    """

    data: Data
    inputs: Mapping[str, sympy.Expr]
    settings: FitSettings

    def match(self, exprs: Mapping[str, sympy.Expr]) -> Match:
        """Fit all constants to the states, and take simple numbers."""
        fit, settings = self._fit(loosen_all(exprs)), self.settings
        if len(exprs) > 1 and (fit is None or not self._follows(fit, list(exprs))):
            # One wrong equation would bend the constants of all: each reads the others off the
            # data.
            return _together([self.match({s: e}) for s, e in exprs.items()])
        if fit is None:
            return untouched_match(exprs, self.data, self.inputs, settings)
        numbers: list[sympy.Expr] = as_floats(fit.constants)
        if settings.snap:
            numbers = self._simple_numbers(fit, self._whole_numbers(fit))
        final = {s: readable(e) for s, e in fit.put(numbers).items()}
        loose = loosen_all(final)
        free = self._fit(loose, near=fit) or fit
        _, values, owners = prepare(loose, _plain(self.data), self.inputs)
        errors, fitted = free.errors, free.constants
        if not settings.snap and len(fitted) == len(values):
            final, values = free.put(as_floats(fitted)), fitted.tolist()
        if len(fitted) != len(values):
            return untouched_match(final, self.data, self.inputs, settings)
        pairs = list(zip(owners, values, errors.tolist(), fitted.tolist(), strict=True))
        return Match(
            final,
            {s: tuple((v, e) for owner, v, e, _ in pairs if owner == s) for s in exprs},
            free.misses.transpose(2, 1, 0).ravel(),
            True,
            {s: tuple(f for owner, _, _, f in pairs if owner == s) for s in exprs},
            interval_reach(free.freedom),
        )

    def _fit(self, exprs: Mapping[str, sympy.Expr], near: Fit | None = None) -> Fit | None:
        """Fit by collocation where smoothed curves are known, else over windows."""
        settings = self.settings
        if isinstance(self.data, Measurements) and not isinstance(near, StatesFit):
            return fit_along(exprs, self.data, settings.along, near)
        assert not isinstance(near, AlongFit)
        return fit_states(exprs, _plain(self.data), self.inputs, settings, near=near)

    def _fit_with(self, fit: Fit, taken: Mapping[int, sympy.Expr]) -> Fit | None:
        """Fit all other constants again once some have numbers."""
        return self._fit(fit.put(_numbers(fit, taken)), near=fit)

    def _follows(self, fit: Fit, states: Sequence[str]) -> bool:
        """Say whether the residuals of every state are of the size of its measurement noise."""
        if isinstance(fit, AlongFit):
            allowed = fit.found.mean_squares - fit.found.allowed
            return bool(np.all(allowed <= self.settings.followed**2))
        runs = _plain(self.data)
        noise, spread = noise_and_spread(runs)
        columns = [runs[0].index(state) for state in states]
        # Noise is estimated too; what a clean state misses by less than this share is no fault.
        sizes = np.maximum(noise, NOISY * spread)[columns]
        return bool(np.all(fit.sizes <= self.settings.followed * sizes))

    def _whole_numbers(self, fit: Fit) -> dict[int, sympy.Expr]:
        """Give the constants that are whole numbers, where all that are near to one may be.

        Whole numbers are used most, and the others are surer once these are known.
        """
        settings = self.settings
        near = [(i, round(float(v))) for i, v in enumerate(fit.constants)]
        whole = {
            i: sympy.Integer(n)
            for i, n in near
            if n != 0 and abs(n - fit.constants[i]) <= settings.near * abs(n)
        }
        far = any(_distance(fit, i, n) > reach(n, settings) for i, n in whole.items())
        return whole if whole and not far and self._allowed(fit, whole) else {}

    def _allowed(self, fit: Fit, taken: Mapping[int, sympy.Expr]) -> bool:
        """Say whether the likelihood ratio allows these numbers together.

        At the level of ``surely_zero`` standard errors, as for terms: most whole numbers are
        factors 1.
        """
        again = self._fit_with(fit, taken)
        beyond = chdtrc(1, self.settings.surely_zero**2)
        return again is not None and fit.ratio(again) <= chdtri(len(taken), beyond)

    def _simple_numbers(self, fit: Fit, whole: Mapping[int, sympy.Expr]) -> list[sympy.Expr]:
        """Give each constant its simple number where one by one and jointly the data allow it.

        Those in ``whole`` have theirs, and constants that are one have the same.
        Those that have none are fitted again and written with the digits their errors support.
        """
        base = (self._fit_with(fit, whole) if whole else None) or fit
        ties = _ties(fit, list(whole), self.settings)
        taken = {**whole, **_simple_together(fit, whole, ties, self.settings)}
        while True:
            again = self._fit_with(fit, taken) if taken else fit
            more = [i for i in taken if i not in whole]
            allowed = chdtri(len(more), 1 - self.settings.joint) if more else math.inf
            if again is None and not more:
                again, taken = fit, {}
            elif again is None or base.ratio(again) > allowed:
                worst = max(more, key=lambda i: _distance(fit, i, taken[i]))
                taken = {i: number for i, number in taken.items() if i not in ties.partners[worst]}
                continue
            break
        every = range(len(fit.constants))
        order = list(every if again is fit else _places(fit, _numbers(fit, taken)))
        rest = dict(zip(order, self._write_tied(again), strict=True))
        return [
            taken[i] if i in taken else sympy.Float(rest[i] if i in rest else written_constant(*at))
            for i, at in enumerate(zip(fit.constants, fit.errors, strict=True))
        ]

    def _write_tied(self, fit: Fit) -> list[float]:
        """Give the numbers with which constants of a fit are written; those that are one, alike."""
        ties = _ties(fit, (), self.settings)
        if ties.count:
            numbers = [sympy.Rational(float(v)) for v in ties.values]
            held = self._fit(fit.put(numbers), near=fit)
            # The others rest where the linearised fit has them, which may cost as much as one more.
            allowed = chdtri(ties.count + 1, 1 - self.settings.joint)
            if held is None or fit.ratio(held) > allowed:
                ties = Ties.untied(fit.constants, fit.covariance)
        return _write(ties)


def _together(alone: Sequence[Match]) -> Match:
    """Put the equations together that were fitted one by one."""
    return Match(
        {s: e for match in alone for s, e in match.exprs.items()},
        {s: pairs for match in alone for s, pairs in match.errors.items()},
        np.concatenate([match.misses for match in alone]),
        all(match.success for match in alone),
        {s: values for match in alone for s, values in match.fitted.items()},
        max(match.reach for match in alone),
    )


def untouched_match(
    exprs: Mapping[str, sympy.Expr],
    runs: Data,
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings = FIT,
) -> Match:
    """Give equations as they came, with the standard errors that their constants would have.

    Parameters
    ----------
    exprs : state -> right-hand side.
    runs : trajectories, or the noisy states with their smoothed curves.
    inputs : input name -> expression in ``t``, where it is known.
    settings : the numbers that decide.
    """
    final = {s: readable(_round_floats(e)) for s, e in exprs.items()}
    errors = measure_errors(loosen_all(final), _plain(runs), inputs, settings)
    fitted = {s: tuple(value for value, _ in pairs) for s, pairs in errors.items()}
    return replace(Match.untouched(final), errors=errors, fitted=fitted)


def loosen_all(exprs: Mapping[str, sympy.Expr]) -> dict[str, sympy.Expr]:
    """Make coefficients floats; a bare column, q' = v, and 0 are structure.

    Parameters
    ----------
    exprs : state -> right-hand side.

    >>> q, v = sympy.symbols("q v")
    >>> loosen_all({"q": v, "v": -2 * q})
    {'q': v, 'v': -2.0*q}
    """
    return {s: e if e.is_Symbol or e == 0 else loosen(e) for s, e in exprs.items()}


def simple_numbers(
    fit: Estimate, simple: Sequence[sympy.Expr | None], settings: FitSettings
) -> list[sympy.Expr]:
    """Give each constant its simple number where the covariance allows all of them together.

    Nothing is fitted again: the others are at their mean once those are known.

    Parameters
    ----------
    fit : the constants with their covariance.
    simple : the numbers that constants have already, None for floats. They stay within
        ``settings.surely_zero`` standard errors.
    settings : the numbers that decide.
    """
    whole = {
        i: number
        for i, number in enumerate(simple)
        if number is not None and _distance(fit, i, number) <= settings.surely_zero
    }
    taken = dict(whole)
    if settings.snap:
        taken |= _simple_together(fit, whole, _ties(fit, list(whole), settings), settings)
    values, covariance = fit.constants.copy(), fit.covariance.copy()
    for i, number in taken.items():
        values, covariance = know(values, covariance, i, number)
    written = _write(Ties.untied(values, covariance))
    return [taken[i] if i in taken else sympy.Float(written[i]) for i in range(len(values))]


def _write(ties: Ties) -> list[float]:
    """Give the numbers with which constants are written; that of the fewest digits is made first.

    What rounding changes in one constant, correlated ones correct: their fitted values move, and
    their errors shrink. Rounded one by one, constants that are determined only together would give
    another function. Constants that are one are written as one.
    """
    values, covariance, found = ties.values, ties.covariance, dict[int, float]()
    while left := [place for place in range(len(values)) if place not in found]:
        sizes, errors = np.abs(values[left]), np.sqrt(np.maximum(np.diag(covariance)[left], 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            first = int(np.argmax(np.nan_to_num(errors / sizes, nan=0.0)))
        place, number = left[first], written_constant(values[left[first]], errors[first])
        for other, sign in ties.partners[place].items():
            found[other] = sign * number
            values, covariance = know(values, covariance, other, sign * number)
    return [found[place] for place in range(len(values))]


def _ties(fit: Estimate, held: Sequence[int], settings: FitSettings) -> Ties:
    """Give the constants of a fit that are one; those that are known are alone."""
    # The space keeps these names apart from any name of a column.
    symbols = [sympy.Symbol(f"constant {i}") for i in range(len(fit.constants))]
    shapes, known = fit.put(symbols), frozenset(held)
    return find_ties(shapes, symbols, fit.constants, fit.covariance, settings, known)


def _places(fit: Fit, numbers: Sequence[sympy.Expr]) -> list[int]:
    """Give the places in a fit of the floats among numbers, in their order once these are put.

    SymPy sorts the terms of a sum by their numbers, so that other numbers have another order.
    """
    left = [i for i, number in enumerate(numbers) if number.is_Float]
    shown = [
        value
        for expr in fit.put(numbers).values()
        for value in free_constants(expr, "constant ")[1].values()
    ]
    found = []
    for value in shown:
        place = next((i for i in left if float(numbers[i]) == value), None)
        if place is None:
            # What was multiplied out has no place of its own; its neighbours keep theirs.
            return [i for i, number in enumerate(numbers) if number.is_Float][: len(shown)]
        left.remove(place)
        found.append(place)
    return found


def _distance(fit: Estimate, index: int, number: sympy.Expr) -> float:
    """Standard errors between a number and the fitted constant at ``index``."""
    return abs(float(number) - fit.constants[index]) / max(fit.errors[index], 1e-300)


def _simple_together(
    fit: Estimate, whole: Mapping[int, sympy.Expr], ties: Ties, settings: FitSettings
) -> dict[int, sympy.Expr]:
    """Give the constants that stand for simple numbers, as the linearised fit allows together.

    Those that are one, as one. The surest first: once it is known, the others are surer, by their
    covariance with it.
    """
    values, covariance = ties.values.copy(), ties.covariance.copy()
    for i, number in whole.items():
        values, covariance = know(values, covariance, i, number)
    taken: dict[int, sympy.Expr] = {}
    distance, count = ties.distance, ties.count
    while np.all(np.isfinite(covariance)):
        options = []
        for i in range(len(values)):
            if i in taken or i in whole:
                continue
            error = math.sqrt(max(covariance[i, i], 0.0))
            number = simple_value(values[i], error, settings)
            # Whole numbers that are known shift the others: those errors are within theirs.
            most = settings.surely_zero if whole else reach(number, settings) if number else 0.0
            if number is None or _distance(fit, i, number) > most:
                continue
            z = (float(number) - values[i]) / max(error, 1e-300)
            if distance + z**2 <= chdtri(count + 1, 1 - settings.joint):
                options.append((number_bits(number) + shift_bits(z), i, number, z))
        if not options:
            break
        _, i, number, z = min(options, key=lambda option: option[:2])
        values, covariance = know(values, covariance, i, number)
        taken |= {j: sign * number for j, sign in ties.partners[i].items()}
        distance, count = distance + z**2, count + 1
    return taken


def _bits(match: Match, level: Noise) -> float:
    """Description length of formulas and states, each constant written as its error supports."""
    return written_bits(match.exprs, match.errors) + data_bits(match.misses, level)


def _snap_by_errors(
    match: Match,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    level: Noise,
    settings: FitSettings,
) -> Match:
    """Snap each state's surest constant, fit the others again, and so on, while bits fall."""
    least = _bits(match, level)
    for _ in range(settings.snap_rounds):
        snapped = {s: _snap_surest(e, match.errors[s], settings) for s, e in match.exprs.items()}
        if snapped == match.exprs:
            break
        following = match_trajectories(snapped, runs, inputs=inputs, settings=settings)
        reached = _bits(following, level) if following.success else math.inf
        if not reached <= least + settings.tie_bits:
            break
        match, least = following, reached
    return match


def _snap_surest(
    expr: sympy.Expr, pairs: Sequence[tuple[float, float]], settings: FitSettings
) -> sympy.Expr:
    """Snap the constant for which that saves most bits; the formula itself where none does."""
    template, values = free_constants(expr, "constant ")
    written = {
        c: sympy.Float(written_constant(*pair)) for c, pair in zip(values, pairs, strict=True)
    }
    before = complexity(template.xreplace(written))
    best: tuple[float, sympy.Symbol, sympy.Expr] | None = None
    for symbol, (value, error) in zip(values, pairs, strict=True):
        # Integration itself is not surer than the finest; inf costs nothing.
        sure = max(error, settings.finest * abs(value), 1e-300)
        for simple in usable_numbers(value, sure, settings):
            changed = template.xreplace({**written, symbol: simple})
            if changed.has(sympy.zoo, sympy.nan):
                continue
            gain = before - complexity(changed) - shift_bits(float(simple) - value, sure)
            if gain > -settings.tie_bits and (best is None or gain > best[0]):
                best = (gain, symbol, simple)
    if best is None:
        return expr
    kept = {s: sympy.Float(v) for s, v in values.items() if s != best[1]}
    return template.xreplace({**kept, best[1]: best[2]})


def _round_floats(expr: sympy.Expr) -> sympy.Expr:
    return expr.xreplace(
        {a: sympy.Float(float(f"{float(a):.9e}")) for a in expr.atoms(sympy.Float)}
    )
