"""Polynomials: systems of all products of the columns, fitted at once and thinned.

At first each equation is searched alone, with the other states read from smoothed curves. Where an
oscillation has few rows, or half of the rows are lost, these curves are wrong, and so are equations
fitted to them. A system with all products of low degree follows the states whatever its law is, if
that is smooth. Its states are better curves. Without the terms that the data do not need, it is a
start for the search along them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
import sympy

from dynsr.selection.alone import Alone
from dynsr.selection.changes import least_sure, without_constant
from dynsr.selection.comparison import (
    Equations,
    SystemComparison,
    SystemFit,
    leaves_noise,
    owners_of,
)
from dynsr.selection.terms import products

# Degrees that are tried, measured numbers for each constant at least, and rows from which on curves
# are good.
_DEGREES, _EACH, _ROWS = (2, 3), 1.5, 320


def whole_polynomials(
    comparison: SystemComparison, alone: Mapping[str, Alone], exprs: Equations
) -> Iterator[SystemFit]:
    """Fit all products of low degree in every equation.

    Parameters
    ----------
    comparison : fits the systems.
    alone : each state whose equation is no bare column, by itself.
    exprs : state -> equation; that of a bare column, such as q' = v, stays as it is.

    None of them where curves are good enough, or numbers too few.
    """
    if comparison.mesh.rows.max() > _ROWS or len(comparison.names) < 2:
        return
    yield from _fitted(comparison, alone, exprs)


def _fitted(
    comparison: SystemComparison, alone: Mapping[str, Alone], exprs: Equations
) -> Iterator[SystemFit]:
    """Fit all products of each degree that can be fitted."""
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


def thinned_polynomials(
    comparison: SystemComparison, alone: Mapping[str, Alone], exprs: Equations
) -> Iterator[SystemFit]:
    """Fit all products of low degree at once, and take them out one by one.

    The constant that is least sure goes first (Wald), whatever its equation. The system of the
    fewest bits on this way is given. All products together follow the states as closely as noise
    allows, so that errors of the other states' curves bend no equation. Higher degrees come where
    lower ones leave more than noise.

    Parameters
    ----------
    comparison, alone, exprs : as for :func:`whole_polynomials`.
    """
    for fit in _fitted(comparison, alone, exprs):
        yield min(_thin(comparison, fit), key=lambda one: one.bits)
        if leaves_noise(fit, comparison.settings):
            break


def _thin(comparison: SystemComparison, fit: SystemFit | None) -> Iterator[SystemFit]:
    """Give a system, and then without its least sure constants, a few of many at a time."""
    while fit is not None:
        yield fit
        fit = next(filter(None, (comparison.fit(e, fit) for e in _shorter(fit))), None)


def _shorter(fit: SystemFit) -> Iterator[Equations]:
    """Give a system without its least sure constants, and without each other one alone."""
    order = least_sure(fit)
    few = max(1, math.isqrt(len(order)) // 2)
    each = (order[:few], *order[few:, None]) if len(order) else ()
    systems = (_without(fit, some) for some in each)
    return (shorter for shorter in systems if shorter is not None)


def _without(fit: SystemFit, places: np.ndarray) -> Equations | None:
    """Give a system without some constants; None where an equation would be gone."""
    owners, found = owners_of(fit.exprs), dict(fit.exprs)
    for place in places:
        lost = without_constant(found[owners[place]], fit.fit.constants[place])
        if lost is None or lost == 0:
            return None
        found[owners[place]] = lost
    return found
