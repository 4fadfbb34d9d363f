"""Exact data: equations that runs without noise confirm, and the simple numbers in them.

What integrates to all measured states within a millionth of the way that these go is no
approximation, whatever the errors of slopes between distant rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import sympy

from dynsr.data import Samples, Trajectory, columns_of
from dynsr.errors import InputError
from dynsr.expression import compile_columns, free_constants, ratio_forms
from dynsr.fit.candidates import Candidate, score_candidate
from dynsr.fit.description import structure_bits
from dynsr.fit.linear import ROUNDING
from dynsr.fit.settings import FIT, FitSettings
from dynsr.fit.shooting import INTERVALS, Match, match_trajectories
from dynsr.fit.simple import simple_number_bits, simple_value

# Bits of equations without their constants.
Structure: TypeAlias = Callable[[Mapping[str, sympy.Expr]], float]


# Misses that need no finer steps, as a share of the spread, and how much finer they may be.
_ENOUGH, _FINE = 1e-8, 4
# Misses, in those that leave no doubt, that may be of steps which are too long.
_NEARLY = 100.0
# Share of the loss that a step near a law lowers at least.
_STRIDE = 0.03
# Intervals of the windows that what is far off is fitted over.
_SHORT = (1, 2, 3)
# Misses below this share of those that leave no doubt are of the steps of the integration.
_NOTHING = 0.01
# How much smaller than others a constant is at least that may be rounding.
_UNEVEN = 1e-9


def _structure(exprs: Mapping[str, sympy.Expr]) -> float:
    return sum(map(structure_bits, exprs.values()))


def confirm(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings = FIT,
    structure: Structure = _structure,
) -> Match | None:
    """Give the equations fitted to the states where these leave no doubt of them; else None.

    Parameters
    ----------
    exprs : state -> right-hand side.
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t``, where it is known.
    settings : ``confirmed`` is the most that they miss, as a share of the way that the states go
        in ten intervals.
    structure : bits of equations without their constants, by which the simplest form is chosen.

    >>> t = np.linspace(0, 4, 81)
    >>> decay = Trajectory(t, np.exp(-0.5 * t)[:, None], ("x",))
    >>> confirm({"x": -0.49 * sympy.Symbol("x")}, [decay], {}).exprs
    {'x': -x/2}
    """
    constants = sum(len(free_constants(e, "constant ")[1]) for e in exprs.values())
    columns = [runs[0].index(state) for state in exprs]
    rows = sum(int(np.sum(run.measured[:, columns])) for run in runs)
    if rows < 5 * constants or min(map(len, runs)) <= INTERVALS:
        return None
    try:
        with np.errstate(all="ignore"):
            most = settings.confirmed * _way(runs, list(exprs))
            match = match_trajectories(exprs, runs, inputs=inputs, settings=_roughly(settings))
            if not _size(match) <= _NEARLY * most:
                return None
            if not _size(match) <= most:
                match = match_trajectories(match.exprs, runs, inputs=inputs, settings=settings)
            if _size(match) > _ENOUGH:
                # Between rows that are far apart the misses are those of the steps.
                settings = replace(
                    settings,
                    match_substeps=_FINE * settings.match_substeps,
                    match_losses=settings.match_losses[-1:],
                )
                match = match_trajectories(match.exprs, runs, inputs=inputs, settings=settings)
            if _size(match) > most:
                return None
            return _simplify(match, runs, inputs, settings, most, structure)
    except (InputError, ArithmeticError, np.linalg.LinAlgError):
        return None


def is_nearly_confirmed(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings = FIT,
) -> bool:
    """Whether fitted equations follow the states nearly as closely as those beyond doubt.

    Parameters
    ----------
    exprs, runs, inputs, settings : as :func:`confirm` takes them.

    >>> t = np.linspace(0, 4, 81)
    >>> x = sympy.Symbol("x")
    >>> decay = Trajectory(t, np.exp(-0.5 * t)[:, None], ("x",))
    >>> [is_nearly_confirmed({"x": e}, [decay], {}) for e in (-0.4 * x, -0.4 * x**2)]
    [True, False]
    """
    try:
        with np.errstate(all="ignore"):
            match = match_trajectories(exprs, runs, inputs=inputs, settings=_roughly(settings))
            return _size(match) <= _NEARLY * settings.confirmed * _way(runs, list(exprs))
    except (InputError, ArithmeticError, np.linalg.LinAlgError):
        return False


def leaves_nothing(match: Match) -> bool:
    """Whether what equations miss of the states may be the error of the integration alone.

    Parameters
    ----------
    match : the fit.
    """
    return _size(match) <= _ENOUGH


def bits_of_misses(match: Match) -> float:
    """Give the bits of what equations miss, to the error of the integration.

    Parameters
    ----------
    match : the fit.
    """
    return len(match.misses) * math.log2(max(_size(match), _ENOUGH))


def approach(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings = FIT,
) -> dict[str, sympy.Expr] | None:
    """Give the equations fitted to exact states from far off; None where these are not met.

    The windows begin with a single interval, over which nothing diverges, and what the states do
    not need is left out, so that :func:`confirm` has little left to do.

    Parameters
    ----------
    exprs : state -> right-hand side.
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t``, where it is known.
    settings : ``confirmed`` is the share of an equation that is nothing.

    >>> t = np.linspace(0, 4, 81)
    >>> x = sympy.Symbol("x")
    >>> decay = Trajectory(t, np.exp(-0.5 * t)[:, None], ("x",))
    >>> approach({"x": -3.0 * x + 2.0 * x**2}, [decay], {})["x"].n(6)
    -0.5*x
    """
    columns = columns_of(runs)
    try:
        with np.errstate(all="ignore"):
            for window in _SHORT:
                match = match_trajectories(
                    exprs, runs, inputs=inputs, window=window, settings=_roughly(settings)
                )
                exprs = match.exprs
            if not _size(match) <= _NEARLY * settings.confirmed * _way(runs, list(exprs)):
                return None
            left = {s: _without_nothing(e, columns, settings.confirmed) for s, e in exprs.items()}
    except (InputError, ArithmeticError, np.linalg.LinAlgError):
        return None
    return left


def _roughly(settings: FitSettings) -> FitSettings:
    """Give the settings of a fit that ends where it is no law that is fitted.

    Close to a law each step leaves a small part of the residuals; elsewhere they creep.
    """
    return replace(settings, match_losses=settings.match_losses[:1], match_gain=_STRIDE)


def _size(match: Match) -> float:
    """Root mean square of the residuals, in units of the states' spread; inf without any."""
    if not match.success or not len(match.misses):
        return np.inf
    return float(np.sqrt(np.mean(match.misses**2)))


def _way(runs: Sequence[Trajectory], states: Sequence[str]) -> float:
    """How far the state that goes least goes in ten intervals, or as many as there are."""
    columns = [runs[0].index(state) for state in states]
    spread = np.std(np.concatenate([run.x[:, columns] for run in runs]), axis=0)
    rows = min(INTERVALS, max(len(run.t) for run in runs) - 1)
    way = np.concatenate([run.x[rows:, columns] - run.x[:-rows, columns] for run in runs])
    moving = spread > 0
    if not moving.any():
        return 0.0
    return float(np.min(np.sqrt(np.mean(way[:, moving] ** 2, axis=0)) / spread[moving]))


def _simplify(
    match: Match,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings,
    most: float,
    structure: Structure,
) -> Match:
    """Leave out what is 0 and write simple numbers, all at once, where misses stay as small."""
    columns = columns_of(runs)

    def simplify(state: str, expr: sympy.Expr) -> sympy.Expr:
        return simplest_form(expr, columns, settings, length=lambda e: structure({state: e}))

    # A fit without what was nothing shows what else is nothing.
    for _ in range(settings.variation_rounds):
        simple = {s: simplify(s, e) for s, e in match.exprs.items()}
        if simple == match.exprs:
            break
        again = match_trajectories(simple, runs, inputs=inputs, settings=settings)
        small = max(settings.alike * _size(match) + settings.finest, _NOTHING * most)
        if not _size(again) <= small:
            break
        match = again
    return match


def simplest_form(
    expr: sympy.Expr,
    columns: Mapping[str, np.ndarray],
    settings: FitSettings = FIT,
    share: float | None = None,
    length: Callable[[sympy.Expr], float] = structure_bits,
) -> sympy.Expr:
    """Write a formula of exact data as it is shortest, with simple numbers where they are such.

    Parameters
    ----------
    expr : the formula.
    columns : the values at which it holds; what adds less than ``settings.confirmed`` is left out.
    settings : the numbers that decide.
    share : of themselves to which its constants are sure; ``settings.confirmed`` by default.
    length : bits of a formula without its constants.

    >>> v = sympy.Symbol("v")
    >>> simplest_form((4.0 * v + 1e-12) / (1 + 2.0 * v), {"v": np.linspace(0, 3, 9)})
    2*v/(v + 1/2)
    >>> simplest_form(sympy.exp(-2.5 * v + 0.3), {"v": np.linspace(0, 3, 9)})
    exp(3/10 - 5*v/2)
    >>> simplest_form(0.4 * v + 0.82 - 0.4182 / (v + 0.51), {"v": np.linspace(0, 3, 9)})
    2*v/5 + 41*v/(50*(v + 51/100))
    """
    share = settings.confirmed if share is None else share

    def simple(values: Mapping[sympy.Symbol, float]) -> dict[sympy.Symbol, sympy.Expr]:
        if not settings.snap:
            return {}
        found = {s: simple_value(v, share * abs(v), settings) for s, v in values.items()}
        return {symbol: number for symbol, number in found.items() if number is not None}

    best: tuple[int, float, str] | None = None
    found = begun = expr
    while True:
        for form in ratio_forms(begun):
            # A form with as many odd numbers, besides what came to be rounding, is no simpler.
            if best and expr.is_Add and 0 < _count_odd(form, simple) >= best[0]:
                continue
            left = _without_nothing(form, columns, settings.confirmed)
            bits = length(left)
            for template, values in _with_shifts(*free_constants(left, "constant ")):
                numbers = simple(values)
                order = (
                    len(values) - len(numbers),
                    bits + sum(map(simple_number_bits, numbers.values())),
                    str(left),
                )
                if best is None or order < best:
                    floats = {symbol: sympy.Float(value) for symbol, value in values.items()}
                    best, found = order, template.xreplace({**floats, **numbers})
        # In a sum of ratios one after the other is written anew, from simple numbers on.
        if found.evalf() == begun or not expr.is_Add:
            return found
        begun = found.evalf()


def _count_odd(
    form: sympy.Expr,
    simple: Callable[[Mapping[sympy.Symbol, float]], Mapping[sympy.Symbol, sympy.Expr]],
) -> int:
    values = free_constants(form, "constant ")[1]
    least = _UNEVEN * max(map(abs, values.values()), default=0.0)
    return len({s: v for s, v in values.items() if abs(v) > least}.keys() - simple(values).keys())


def _with_shifts(
    template: sympy.Expr, values: Mapping[sympy.Symbol, float]
) -> Iterator[tuple[sympy.Expr, Mapping[sympy.Symbol, float]]]:
    """Give a formula, and with the factors of its exponentials in their exponents, if there are.

    SymPy takes every float out of an exponent, and 1/(1 + exp(0.3 - 5.2 v)) loses its 0.3.
    """
    yield template, values
    shifted, logs = {}, dict(values)
    for product in template.atoms(sympy.Mul):
        factors = [f for f in product.args if values.get(f, 0.0) > 0]
        waves = [f for f in product.args if isinstance(f, sympy.exp)]
        if len(product.args) == 2 and len(factors) == len(waves) == 1:
            shifted[product] = sympy.exp(waves[0].args[0] + factors[0])
            logs[factors[0]] = math.log(values[factors[0]])
    if shifted:
        yield template.xreplace(shifted), logs


def without_rounding(candidate: Candidate, samples: Samples) -> Candidate:
    """Give a candidate without the terms and constants that add no more than rounding to it.

    Fits of many columns leave coefficients of the size of rounding where a term is nothing.

    Parameters
    ----------
    candidate : the formula.
    samples : where it holds.

    >>> x = sympy.Symbol("x")
    >>> s = Samples(np.array([[1.0], [2.0]]), np.array([-0.5, -1.0]), ("x",), "x", "given",
    ...             np.arange(2.0))
    >>> without_rounding(score_candidate(-0.5 * x + 8.5e-16 * sympy.tanh(x), s), s).expr
    -0.5*x
    """
    sizes = [abs(float(number)) for number in candidate.expr.atoms(sympy.Float)]
    if not sizes or min(sizes) > _UNEVEN * max(1.0, *sizes):
        return candidate
    columns = samples.timed
    left = _without_nothing(candidate.expr, columns, ROUNDING)
    return score_candidate(left, samples, candidate.source) if left != candidate.expr else candidate


def _without_nothing(
    expr: sympy.Expr, columns: Mapping[str, np.ndarray], share: float
) -> sympy.Expr:
    """Put 0 for every constant whose absence changes a formula by less than a share of it."""
    template, values = free_constants(expr, "constant ")
    held = np.array(list(values.values()))
    # All constants first, then each of them put to 0.
    each = np.concatenate([held[None], held * (1 - np.eye(len(held)))])[..., None]
    program = compile_columns([template], (*columns, *map(str, values)))
    with np.errstate(all="ignore"):
        whole, *lost = np.atleast_2d(program(*columns.values(), *np.moveaxis(each, 1, 0))[0])
        most = share * float(np.sqrt(np.mean(whole**2)))
        nothing = [float(np.sqrt(np.mean((own - whole) ** 2))) <= most for own in lost]
    kept = {
        symbol: sympy.S.Zero if none else sympy.Float(value)
        for (symbol, value), none in zip(values.items(), nothing, strict=True)
    }
    return template.xreplace(kept)
