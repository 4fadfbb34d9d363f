"""Polynomials: systems of all products of the columns, fitted at once and thinned.

Alone, an equation is looked for with the others read off their smoothed curves. Where rows are few
an oscillation, or half of them are lost, these curves are far off, and no equation that is read off
them is right. A system that holds all products of low degree follows the states whatever its law
is, if that is smooth: its states are better curves, and what is left of it when the terms that the
data do not need are gone is a start for the search along them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import sympy

from dynsr.selection.alone import Alone
from dynsr.selection.changes import drop_least
from dynsr.selection.comparison import Equations, SystemComparison, SystemFit, owners_of
from dynsr.selection.terms import products

# Degrees that are tried, measured numbers for each constant at least, and rows from which on curves
# are good.
_DEGREES, _EACH, _ROWS = (2, 3), 1.5, 320
# Bits above the best from which on no shorter system is better.
_BEYOND = 60.0


def fit_polynomials(
    comparison: SystemComparison, alone: Mapping[str, Alone], exprs: Equations
) -> list[SystemFit]:
    """Fit all products of low degree in every equation; gives the best thinned system of each.

    None of them where curves are good enough, or numbers too few.

    Parameters
    ----------
    comparison : fits the systems.
    alone : each state whose equation is no bare column, by itself.
    exprs : state -> equation; that of a bare column, such as q' = v, stays as it is.
    """
    whole = whole_polynomials(comparison, alone, exprs)
    return [min(_thin(comparison, fit), key=lambda f: f.bits) for fit in whole]


def whole_polynomials(
    comparison: SystemComparison, alone: Mapping[str, Alone], exprs: Equations
) -> Iterator[SystemFit]:
    """Fit all products of low degree in every equation, as :func:`fit_polynomials` begins.

    Parameters
    ----------
    comparison, alone, exprs : as there.
    """
    if comparison.mesh.rows.max() > _ROWS or len(comparison.names) < 2:
        return
    for degree in _DEGREES:
        system = _all_products(comparison, alone, exprs, degree)
        fit = None if system is None else comparison.fit(system)
        if fit is not None:
            yield fit


def _all_products(
    comparison: SystemComparison, alone: Mapping[str, Alone], exprs: Equations, degree: int
) -> Equations | None:
    """Put all products into every equation, as they follow the curves; None where too many."""
    bodies = [sympy.S.One, *products(comparison.names, degree)]
    own = [s for s, e in exprs.items() if not e.is_Symbol]
    if comparison.mesh.rows.sum() < _EACH * len(bodies) * len(own):
        return None
    settings, found = comparison.settings, dict(exprs)
    for state in own:
        allow = settings.demands.limits(state).allow
        told = alone[state].fitted([b for b in bodies if allow(b)])
        if told is None:
            return None
        found[state] = settings.demands.force(state, told)
    return found


def _thin(comparison: SystemComparison, fit: SystemFit) -> Iterator[SystemFit]:
    """Take out the constant that is told least from 0, one after the other."""
    least = fit.bits
    while fit.bits < least + _BEYOND:
        yield fit
        least = min(least, fit.bits)
        values, errors = np.abs(fit.fit.constants), fit.fit.errors
        owners = owners_of(fit.exprs)
        with np.errstate(over="ignore", invalid="ignore"):
            ratios = np.nan_to_num(values / np.maximum(errors, 1e-300))
        if not len(ratios):
            break
        state = owners[int(np.argmin(ratios))]
        less = drop_least(fit, state)
        shorter = comparison.fit({**fit.exprs, state: sympy.S.Zero if less is None else less}, fit)
        if shorter is None:
            break
        fit = shorter
