"""Renewal: one equation of a system proposed again, along the states of the system itself.

At first each equation is searched alone, with the other states read from smoothed curves. Where
rows are few these curves are wrong, and so is the equation that follows them best. The states of a
system that follows the data are better curves. The constants of its other equations are free, so
that a new equation need not correct their errors. A term that another equation has costs only its
name. Where the residuals are noise, terms of the equation are added, exchanged and dropped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import sympy

from dynsr.expression import skeleton
from dynsr.selection.changes import prune_each, while_better
from dynsr.selection.comparison import (
    Equations,
    SystemComparison,
    SystemFit,
    form_of,
    leaves_noise,
)
from dynsr.selection.permuted import exchanged
from dynsr.selection.rates import fluxes


def renewals(comparison: SystemComparison, fit: SystemFit, state: str) -> list[sympy.Expr]:
    """Give the equations that are expected to do best in the place of one."""
    own = fit.exprs[state]
    others = {s: expr for s, expr in fit.exprs.items() if s != state}
    # What is far from a law is no start for one.
    near = own if leaves_noise(fit, comparison.settings) else None
    return _propose(comparison, fit, {state: (1.0, own)}, others, near)


def _propose(
    comparison: SystemComparison,
    fit: SystemFit,
    parts: Mapping[str, tuple[float, sympy.Expr]],
    others: Equations,
    near: sympy.Expr | None = None,
) -> list[sympy.Expr]:
    """Give the sums that are expected to replace parts of the system best."""
    evidence = comparison.evidence(fit, parts)
    if evidence is None:
        return []
    return comparison.propose(next(iter(parts)), evidence, tuple(others.items()), near=near)


def renew(comparison: SystemComparison, best: SystemFit) -> SystemFit:
    """Propose each equation of a system again; take the best until that saves less than a bit."""
    settings, mesh = comparison.settings, comparison.mesh
    # What does not change says nothing of an equation.
    left, right = mesh.ends
    moves = np.any(mesh.start[left] != mesh.start[right], axis=0)
    moving = {s for s, moved in zip(mesh.states, moves, strict=True) if moved}

    def different(fit: SystemFit, systems: Iterable[Equations]) -> Iterator[Equations]:
        """Give the first systems of other forms than those before them and than the fit."""
        known = {form_of(fit.exprs)}
        for system in systems:
            if (form := form_of(system)) not in known:
                known.add(form)
                yield system
            if len(known) > settings.tried:
                return

    def systems_of(fit: SystemFit) -> Iterator[tuple[str, Equations]]:
        for state in (s for s, expr in fit.exprs.items() if s in moving and not expr.is_Symbol):
            anew = renewals(comparison, fit, state)
            changed = (one for e in anew for one in comparison.changed(fit, state, e))
            yield from ((state, one) for one in different(fit, changed))
            anew = twins(comparison, fit, state)
            yield from ((state, one) for e in anew for one in comparison.changed(fit, state, e))
        along = {**comparison.mesh.columns, **dict(zip(mesh.states, fit.fit.states.T, strict=True))}
        shared = fluxes(fit.exprs, fit.fit.constants, fit.fit.errors, along)
        for flux in shared if settings.parts.has("fluxes") else []:
            others, lead = {**fit.exprs, **flux.rest}, next(iter(flux.parts))
            anew = _propose(comparison, fit, flux.parts, others)
            replaced = (flux.replaced(fit.exprs, expr) for expr in anew)
            yield from ((lead, one) for one in different(fit, replaced))

    def renewed(fit: SystemFit) -> Iterator[SystemFit]:
        for state, exprs in systems_of(fit):
            one = comparison.fit_again(exprs)
            if one is not None:
                # What made up for a wrong equation, in others too, does not pay beside a right one.
                far = one.bits - fit.bits
                pruned = (
                    fit.exprs if far < settings.near else (state,) if far < settings.behind else ()
                )
                yield prune_each(comparison, one, pruned)

    return while_better(renewed, prune_each(comparison, best), gain=settings.gain)


def twins(comparison: SystemComparison, fit: SystemFit, state: str) -> list[sympy.Expr]:
    """Give the permuted equations of one state: the others with names exchanged.

    All are fitted. Where one equation of two bodies is wrong, it biases the states, and along these
    the permuted equation looks much worse than it is.
    """
    found = {
        skeleton(expr): expr
        for other, own in fit.exprs.items()
        if other != state and not own.is_Symbol
        for expr in exchanged(own, other, state, comparison.mesh.states)
    }
    found.pop(skeleton(fit.exprs[state]), None)
    allow = comparison.settings.demands.limits(state).allow
    return [expr for expr in found.values() if allow(expr)]
