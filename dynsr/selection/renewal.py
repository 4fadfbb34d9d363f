"""Renewal: one equation of a system proposed anew, along the states of the system itself.

Alone, an equation is looked for with the others read off their smoothed curves. Where rows are few
these are off, and so is what follows them best. The states of a system that follows the data are
better curves, and with its other equations beside it, their constants free, a new one has to make
up for no errors of theirs. A term that another equation has costs no more than naming it. Where the
system leaves only noise, terms of the equation are added, exchanged and dropped.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import sympy

from dynsr.fit import skeleton
from dynsr.selection.changes import prune, while_better
from dynsr.selection.comparison import SystemComparison, SystemFit, leaves_noise
from dynsr.selection.evidence import Evidence
from dynsr.selection.twins import exchanged


def renewals(comparison: SystemComparison, fit: SystemFit, state: str) -> list[sympy.Expr]:
    """Give the equations that are expected to do best in the place of one.

    Parameters
    ----------
    comparison : fits the systems.
    fit : the system.
    state : whose equation is proposed anew.
    """
    settings = comparison.settings
    settled = leaves_noise(fit, settings)
    # The states of a system that misses them are not quite those of another.
    weight = None if settled else settings.softness
    nodes = settings.proposals.nodes
    evidence = Evidence.in_place(fit.fit, fit.problem, state, comparison.columns, nodes, weight)
    if evidence is None:
        return []
    others = [(s, expr) for s, expr in fit.exprs.items() if s != state]
    # What is far from a law is no start for one.
    return comparison.propose(state, evidence, others, near=fit.exprs[state] if settled else None)


def renew(comparison: SystemComparison, best: SystemFit) -> SystemFit:
    """Propose each equation of a system anew and take the best, until that saves less than a bit.

    Parameters
    ----------
    comparison : fits the systems.
    best : the system.
    """
    settings, mesh = comparison.settings, comparison.mesh
    # What does not change says nothing of an equation.
    left, right = mesh.ends
    moves = np.any(mesh.start[left] != mesh.start[right], axis=0)
    moving = {s for s, moved in zip(mesh.states, moves, strict=True) if moved}

    def renewed(fit: SystemFit) -> Iterator[SystemFit]:
        for state in (s for s, expr in fit.exprs.items() if s in moving and not expr.is_Symbol):
            anew = renewals(comparison, fit, state)[: settings.tried]
            anew += twins(comparison, fit, state)
            systems = [one for expr in anew for one in comparison.changed(fit, state, expr)]
            for one in filter(None, map(comparison.fit_anew, systems)):
                close = one.bits < fit.bits + settings.behind
                yield prune(comparison, one, state) if close else one

    return while_better(renewed, best, gain=settings.gain)


def twins(comparison: SystemComparison, fit: SystemFit, state: str) -> list[sympy.Expr]:
    """Give the other equations with names exchanged so that they are one.

    All are fitted: where one equation of two bodies is wrong, the states are bent beside it, and
    along them its twin looks far behind.

    Parameters
    ----------
    comparison : fits the systems.
    fit : the system.
    state : whose equation is proposed anew.
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
