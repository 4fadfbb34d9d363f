"""Drift of exact laws: shorter formulas in the time that are the same along all of the data.

Along one run that goes one way the time is a function of the states, and a law in the states may be
one in the time. Which of them is shorter, with its constants written out, is more probable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import sympy
from scipy.optimize import minimize_scalar

from dynsr.data import Samples
from dynsr.expression import complexity, evaluate
from dynsr.fit import refit, simplest_form
from dynsr.selection import best_subsets
from dynsr.verdict.drift import (
    DRIFT,
    TIME,
    Drift,
    DriftSettings,
    TermsInTime,
    drift_of_rows,
    say,
    waves_in_time,
    with_time,
)
from dynsr.verdict.following import ENOUGH_ROWS

# Every so manieth row shows whether another formula comes near.
_EVERY = 4
# Times the share to which formulas are the same, below which a sum of columns may vanish: columns
# are counted in units of their own size, and formulas in that of what they give.
_FLAT = 10.0
# Share of themselves to which constants of exact slopes are sure.
_SURE = 1e-4
# Rates of functions of the time that are begun with, in units of one over its span, and the share
# of the target that the nearest of them misses where one between them may be exact.
_RATES = np.geomspace(0.05, 30.0, 24)
_NEAR = 0.05


def same_in_time(
    state: str,
    expr: sympy.Expr,
    samples: Samples,
    settings: DriftSettings = DRIFT,
    *,
    discrete: bool = False,
) -> Drift | None:
    """Give the shorter formula with the time that an exact equation is the same as; None for none.

    Parameters
    ----------
    state, expr : the equation.
    samples : its rows, with what it gives.
    settings : which terms are tried.
    discrete : whether the equation is a map.

    >>> t = np.linspace(0.0, 3.0, 100)
    >>> x = 1 + t + t**2 / 2
    >>> rows = Samples(x[:, None], 1 + t, ("x",), "x", "given", t)
    >>> same_in_time("x", 1.41421356 * sympy.sqrt(sympy.Symbol("x") - 0.5), rows).expr
    t + 1
    >>> t = np.linspace(0.0, 3.0, 100)
    >>> rows = Samples(np.exp(-t / 2)[:, None], -np.exp(-t / 2) / 2, ("x",), "x", "given", t)
    >>> same_in_time("x", -0.5 * sympy.Symbol("x"), rows) is None
    True
    """
    timed = with_time(samples, state)
    columns = timed.columns
    floor = settings.exact * float(np.std(samples.y))
    best, least = None, complexity(expr)
    for one in _propose(expr, timed, floor, settings):
        other = refit(one, timed)
        if float(np.max(np.abs(samples.y - evaluate(other, columns)))) <= _FLAT * floor:
            other = simplest_form(other, columns)
            bits = complexity(other)
            if TIME in other.free_symbols and bits < least:
                best, least = other, bits
    if best is None:
        return None
    said = say(state, best, expr, samples.t, 0.0, discrete=discrete)
    return Drift(best, least - complexity(expr), said)


def drift_of_slopes(
    expr: sympy.Expr, samples: Samples, settings: DriftSettings = DRIFT
) -> Drift | None:
    """Give the formula with the time that exact slopes follow, where an equation does not.

    Parameters
    ----------
    expr : the equation, which the slopes do not follow.
    samples : the slopes.
    settings : which terms are tried.

    >>> t = np.linspace(0.0, 1.4, 100)
    >>> rows = Samples(np.sin(t)[:, None], np.cos(t), ("x",), "x", "given", t)
    >>> drift_of_slopes(1.1 - 0.7 * sympy.Symbol("x"), rows).expr
    cos(t)
    """
    size = float(np.sqrt(np.mean(samples.y**2)))
    floor = max(float(samples.noise or 0.0), settings.exact * size)
    found = drift_of_rows(samples.target, expr, samples, floor, settings)
    if found is None or not found.timed:
        return None
    columns = samples.timed
    left = float(np.median(np.abs(samples.y - evaluate(found.expr, columns))))
    if left > floor:
        return None
    written = simplest_form(found.expr, columns, share=_SURE)
    said = say(samples.target, written, expr, samples.t, math.inf)
    return Drift(written, found.bits, said)


def _propose(
    expr: sympy.Expr, samples: Samples, floor: float, settings: DriftSettings
) -> Iterator[sympy.Expr]:
    """Give formulas with the time that may be the same as an equation."""
    if not floor:
        return
    some = np.unique(np.linspace(0, len(samples) - 1, ENOUGH_ROWS).astype(int))
    few = samples.select(some)
    share = floor / float(np.std(samples.y))
    yield from _functions(few.t, few.y, share)
    yield from _sums(expr, few, floor, settings)


def _sums(
    expr: sympy.Expr, samples: Samples, floor: float, settings: DriftSettings
) -> Iterator[sympy.Expr]:
    """Give the sums of few terms, some with the time, that are the target."""
    library = TermsInTime.of(samples.target, expr, samples.columns, settings, functions=False)
    values, y = library.values, samples.y
    # Each term is a symbol at least; what is exact is written out and counted later.
    costs = np.array([float(e.count_ops()) for e in library.terms])
    sums = best_subsets(
        values.T @ values,
        values.T @ y,
        float(y @ y),
        costs,
        len(y),
        beam=settings.beam,
        most=len(sympy.Add.make_args(expr)) + settings.more,
        keep=10 * settings.beam,
    )
    exact: list[set[int]] = []
    # What holds an exact sum is that one, and what adds nothing.
    for one in sorted(sums, key=lambda one: len(one.places)):
        places = list(one.places)
        if not any(less <= set(places) for less in exact):
            left = y - values[:, places] @ np.linalg.lstsq(values[:, places], y, rcond=None)[0]
            if np.max(np.abs(left)) <= _FLAT * floor:
                exact.append(set(places))
                if library.timed[places].any():
                    yield library.add_up(one, places)


def _functions(t: np.ndarray, y: np.ndarray, share: float) -> Iterator[sympy.Expr]:
    """Give the functions of the time alone that a target is to within a share of its spread."""
    size, span = float(np.std(y)), float(np.ptp(t))
    if not span:
        return
    first, t_few, y_few = float(t.min()), t[::_EVERY], y[::_EVERY]
    for family in range(len(_families(np, t, 1.0, first))):

        def miss(
            log_rate: float, t: np.ndarray = t, y: np.ndarray = y, family: int = family
        ) -> float:
            own = _families(np, t, math.exp(log_rate), first)[family]
            basis = np.array([np.ones(len(t)), *own]).T
            if not np.all(np.isfinite(basis)):
                return math.inf
            left = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
            return float(np.sqrt(np.mean(left**2)))

        rates = np.log(_RATES / span)
        tried = [miss(rate, t_few, y_few) for rate in rates]
        place = int(np.argmin(tried))
        if tried[place] > _NEAR * size:
            continue
        ends = rates[np.clip([place - 1, place + 1], 0, len(rates) - 1)]
        best = minimize_scalar(miss, bounds=ends, method="bounded", options={"xatol": 1e-8})
        if best.fun <= _FLAT * share * size:
            rate = sympy.Float(math.exp(best.x))
            terms = _families(sympy, TIME, rate, sympy.Float(first))[family]
            yield sum(sympy.Float(0.5) * term for term in (sympy.S.One, *terms))


def _families(of: Any, t: Any, rate: Any, first: Any) -> list[list[Any]]:
    """Give the functions of the time alone that are tried together."""
    return [[t, t**2, t**3], *waves_in_time(of, t, rate, first)]
