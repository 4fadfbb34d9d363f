"""Renewal: one equation of a system proposed again, along the states of the system itself.

At first each equation is searched alone, with the other states read from smoothed curves. Where
rows are few these curves are wrong, and so is the equation that follows them best. The states of a
system that follows the data are better curves. The constants of its other equations are free, so
that a new equation need not correct their errors. A term that another equation has costs only its
name. Where the residuals are noise, terms of the equation are added, exchanged and dropped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

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


def renewals(
    comparison: SystemComparison, fit: SystemFit, state: str, *, from_nothing: bool = False
) -> list[sympy.Expr]:
    """Give the equations that are expected to do best in the place of one."""
    own = fit.exprs[state]
    others = {s: expr for s, expr in fit.exprs.items() if s != state}
    # What is far from a law is no start for one.
    near = own if leaves_noise(fit, comparison.settings) else None
    return _propose(comparison, fit, {state: (1.0, own)}, others, near, from_nothing=from_nothing)


def _propose(
    comparison: SystemComparison,
    fit: SystemFit,
    parts: Mapping[str, tuple[float, sympy.Expr]],
    others: Equations,
    near: sympy.Expr | None = None,
    *,
    from_nothing: bool = False,
) -> list[sympy.Expr]:
    """Give the sums that are expected to replace parts of the system best."""
    evidence = comparison.evidence(fit, parts)
    if evidence is None:
        return []
    state, known = next(iter(parts)), tuple(others.items())
    return comparison.propose(state, evidence, known, near=near, from_nothing=from_nothing)


def renew(comparison: SystemComparison, best: SystemFit) -> SystemFit:
    """Propose each equation of a system again; take the best until that saves less than a bit.

    Where no change of an equation is better, all are proposed from nothing: two terms in the place
    of two others are passed by where one changes at a time.
    """
    gain, renewal = comparison.settings.gain, _Renewal(comparison)

    def climbed(fit: SystemFit) -> SystemFit:
        return while_better(lambda one: renewal.fits(one, renewal.changed(one)), fit, gain=gain)

    def from_nothing(fit: SystemFit) -> Iterator[SystemFit]:
        found = renewal.fits(fit, renewal.from_nothing(fit))
        least = min(found, key=lambda one: one.bits, default=fit)
        if least.bits < fit.bits - gain:
            yield climbed(least)

    return while_better(from_nothing, climbed(prune_each(comparison, best)), gain=gain)


@dataclass(frozen=True, eq=False)
class _Renewal:
    """Systems with an equation that is proposed again.

    Parameters
    ----------
    comparison : fits them.
    """

    comparison: SystemComparison

    @cached_property
    def _moving(self) -> set[str]:
        """The states that change; what does not says nothing of an equation."""
        mesh = self.comparison.mesh
        left, right = mesh.ends
        moves = np.any(mesh.start[left] != mesh.start[right], axis=0)
        return {s for s, moved in zip(mesh.states, moves, strict=True) if moved}

    def _open(self, fit: SystemFit) -> list[str]:
        """Give the states whose equations may change."""
        return [s for s, e in fit.exprs.items() if s in self._moving and not e.is_Symbol]

    def _different(self, fit: SystemFit, systems: Iterable[Equations]) -> Iterator[Equations]:
        """Give the first systems of other forms than those before them and than the fit."""
        known = {form_of(fit.exprs)}
        for system in systems:
            if (form := form_of(system)) not in known:
                known.add(form)
                yield system
            if len(known) > self.comparison.settings.tried:
                return

    def _with(self, fit: SystemFit, state: str, exprs: Iterable[sympy.Expr]) -> Iterator[Equations]:
        return (one for expr in exprs for one in self.comparison.changed(fit, state, expr))

    def from_nothing(self, fit: SystemFit) -> Iterator[tuple[str, Equations]]:
        """Give systems with an equation that is proposed from nothing, where they leave noise."""
        comparison = self.comparison
        for state in self._open(fit) if leaves_noise(fit, comparison.settings) else ():
            again = renewals(comparison, fit, state, from_nothing=True)
            yield from ((state, o) for o in self._different(fit, self._with(fit, state, again)))

    def changed(self, fit: SystemFit) -> Iterator[tuple[str, Equations]]:
        """Give systems with an equation, or a rate that several have, that is proposed again."""
        comparison = self.comparison
        for state in self._open(fit):
            again = self._with(fit, state, renewals(comparison, fit, state))
            yield from ((state, one) for one in self._different(fit, again))
            alike = self._with(fit, state, twins(comparison, fit, state))
            yield from ((state, one) for one in alike)
        mesh = comparison.mesh
        along = {**mesh.columns, **dict(zip(mesh.states, fit.fit.states.T, strict=True))}
        shared = fluxes(fit.exprs, fit.fit.constants, fit.fit.errors, along)
        for flux in shared if comparison.settings.parts.has("fluxes") else []:
            others, lead = {**fit.exprs, **flux.rest}, next(iter(flux.parts))
            proposed = _propose(comparison, fit, flux.parts, others)
            replaced = (flux.replaced(fit.exprs, expr) for expr in proposed)
            yield from ((lead, one) for one in self._different(fit, replaced))

    def fits(self, fit: SystemFit, systems: Iterable[tuple[str, Equations]]) -> Iterator[SystemFit]:
        """Fit systems, and take out what does not pay with what is new."""
        comparison, settings = self.comparison, self.comparison.settings
        for state, exprs in systems:
            one = comparison.fit_again(exprs)
            if one is not None:
                # What corrected a wrong equation, in others too, does not pay with a right one.
                far = one.bits - fit.bits
                pruned = (
                    fit.exprs if far < settings.near else (state,) if far < settings.behind else ()
                )
                yield prune_each(comparison, one, pruned)


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
