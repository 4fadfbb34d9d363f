"""Changes: an equation of a system without what its data do not need."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np
import sympy
from scipy.linalg import LinAlgError

from dynsr.expression import compile_columns
from dynsr.fit import (
    Probes,
    shift_bits,
    without_flat_line,
)
from dynsr.selection.comparison import (
    Equations,
    SystemComparison,
    SystemFit,
    owners_of,
)
from dynsr.selection.shapes import bodies_of

# Share of the slopes' spread by which a term with a shorter line may be off before it is fitted.
_LIKE = 0.3
# Standard errors from 1 at which a factor may be none, and their share of it at most.
_LIKE_ONE, _KNOWN = 2.0, 0.3


def without_constant(expr: sympy.Expr, value: float) -> sympy.Expr | None:
    """Give an equation with a constant at 0; None where it lacks that constant or its value."""
    lost = expr.xreplace({sympy.Float(float(value)): sympy.S.Zero})
    return None if lost == expr or lost.has(sympy.zoo, sympy.nan) else lost


def least_sure(fit: SystemFit) -> np.ndarray:
    """(P,) places of the constants, first the one that is expected to raise the residuals least.

    Without a constant of value c and standard error e the sum of squared residuals is expected to
    rise by (c / e)^2 (Wald).
    """
    with np.errstate(over="ignore"):
        ratios = np.abs(fit.fit.constants) / np.maximum(fit.fit.errors, 1e-300)
    return np.argsort(ratios, kind="stable")


def drop_least(fit: SystemFit, state: str, most: float = math.inf) -> sympy.Expr | None:
    """Give an equation without its least sure constant; None where nothing can go.

    Parameters
    ----------
    fit, state : the system, and whose equation it is.
    most : bits that the data are expected to lose by it (Wald), at most.
    """
    owners, values = owners_of(fit.exprs), fit.fit.constants
    for index in least_sure(fit):
        with np.errstate(all="ignore"):
            far = shift_bits(values[index], fit.fit.errors[index]) > most
        if owners[index] == state and not far:
            lost = without_constant(fit.exprs[state], values[index])
            if lost is not None and lost != 0:
                return lost
    return None


def prune(comparison: SystemComparison, fit: SystemFit, state: str) -> SystemFit:
    """Take terms out of one equation while bits fall, the least important term first.

    A denominator that hardly changes is dropped before all others, and exponents become whole or
    half ones.
    """
    while comparison.settings.parts.has("pruning"):
        for system in _shorter_systems(comparison, fit, state):
            less = comparison.fit_near(system, fit)
            if less is not None and less.bits < fit.bits:
                fit = less
                break
        else:
            break
    return fit


def prune_each(
    comparison: SystemComparison, fit: SystemFit, states: Iterable[str] | None = None
) -> SystemFit:
    """Take terms out of one equation after the other, those of all states by default."""
    for state in tuple(fit.exprs) if states is None else states:
        fit = prune(comparison, fit, state)
    return fit


def _shorter_systems(
    comparison: SystemComparison, fit: SystemFit, state: str
) -> Iterator[Equations]:
    for expr in _shorter(comparison, fit, state):
        if expr is not None:
            yield from comparison.changed(fit, state, expr)


def _shorter(
    comparison: SystemComparison, fit: SystemFit, state: str
) -> Iterator[sympy.Expr | None]:
    """Give shorter equations, each made when the one before it has been turned down."""
    yield _without_line(comparison, fit, state)
    yield _with_shorter_line(comparison, fit, state)
    yield _round_powers(fit.exprs[state])
    yield _without_one(fit, state)
    # What would miss by far is not fitted.
    yield drop_least(fit, state, comparison.settings.behind)


def _round_powers(expr: sympy.Expr) -> sympy.Expr | None:
    """Give an equation with the nearest half for every exponent that was set free; None for none.

    >>> x = sympy.Symbol("x")
    >>> _round_powers(2.5 * x**1.97)
    2.5*x**2
    """
    free = [p for p in expr.atoms(sympy.Pow) if p.exp.is_Float]
    nearest = {p: p.base ** sympy.Rational(round(2 * float(p.exp)), 2) for p in free}
    return expr.xreplace(nearest) if free else None


def _with_shorter_line(
    comparison: SystemComparison, fit: SystemFit, state: str
) -> sympy.Expr | None:
    """Give an equation whose denominator has one part alone, the closest; None if none is close."""
    terms = sympy.Add.make_args(fit.exprs[state])
    others = []
    for i, term in enumerate(terms):
        lines = [1 / factor for factor in sympy.Mul.make_args(term)]
        for below in (line for line in lines if line.is_Add and line.free_symbols):
            changed = (term * below / part for part in below.args)
            others += [sympy.Add(*terms[:i], other, *terms[i + 1 :]) for other in changed]
    if not others:
        return None
    points = fit.points
    values = compile_columns([fit.exprs[state], *others], comparison.columns)(*points)
    with np.errstate(all="ignore"):
        apart = np.nan_to_num(np.std(values[1:] - values[0], axis=1), nan=np.inf)
    place = int(np.argmin(apart))
    return others[place] if apart[place] <= _LIKE * np.std(values[0]) else None


def _without_one(fit: SystemFit, state: str) -> sympy.Expr | None:
    """Give an equation without a factor inside a term that may be 1, the closest; None for none."""
    expr, owners = fit.exprs[state], owners_of(fit.exprs)
    inside = {float(number) for body in bodies_of(expr) for number in body.atoms(sympy.Float)}
    values, errors = np.abs(fit.fit.constants), fit.fit.errors
    with np.errstate(all="ignore"):
        apart = np.where(errors < _KNOWN * values, np.abs(values - 1) / errors, np.inf)
    for index in np.argsort(apart, kind="stable"):
        value = float(fit.fit.constants[index])
        if apart[index] <= _LIKE_ONE and owners[index] == state and value in inside:
            return expr.xreplace({sympy.Float(value): sympy.Integer(round(value))})
    return None


def _without_line(comparison: SystemComparison, fit: SystemFit, state: str) -> sympy.Expr | None:
    if not sympy.fraction(fit.exprs[state])[1].is_Add:
        return None
    points = fit.points
    columns = dict(zip(comparison.columns, points, strict=True))
    return without_flat_line(fit.exprs[state], columns)


def while_better(
    make: Callable[[SystemFit], Iterable[SystemFit]],
    best: SystemFit,
    often: float = math.inf,
    gain: float = 0.0,
) -> SystemFit:
    """Take the best of what is made of a system, for as long as that takes fewer bits.

    Parameters
    ----------
    make : gives other systems for one.
    best : the system that the search starts from.
    often : times at most.
    gain : bits that one must save for others to be made of it.
    """
    saved, times = math.inf, 0
    while saved > gain and times < often:
        first = min(make(best), key=lambda fit: fit.bits, default=best)
        saved, times = best.bits - first.bits, times + 1
        best = min(best, first, key=lambda fit: fit.bits)
    return best


def gram_of(fit: SystemFit, probes: Probes) -> np.ndarray | None:
    """Products of the slopes by constants and probes, and of the residuals as the last column.

    Parameters
    ----------
    fit : the system.
    probes : Q constants that the system might have.
    """
    found = fit.fit
    try:
        gram = fit.problem.normal(found.states, found.constants, probes).gram
    except (LinAlgError, ValueError):
        return None
    return gram if np.all(np.isfinite(gram)) else None
