"""Renewal: one equation of a system proposed anew, along the states of the system itself.

Alone, an equation is looked for with the others read off their smoothed curves. Where rows are few
these are off, and so is what follows them best. The states of a system that follows the data are
better curves, and with its other equations beside it, their constants free, a new one has to make
up for no errors of theirs. A term that another equation has costs no more than naming it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import sympy

from dynsr.fit import constant_bits, skeleton
from dynsr.library import Library
from dynsr.selection.changes import climb_while_better, prune
from dynsr.selection.comparison import SystemComparison, SystemFit, leaves_noise
from dynsr.selection.costs import (
    bodies_of,
    citing_bits,
    is_plain,
    shape_bits,
    unusual_bits,
    wide_factors,
)
from dynsr.selection.evidence import Evidence
from dynsr.selection.propose import Proposer, write_all
from dynsr.selection.twins import exchanged

# Degree of a short polynomial that is good enough where it leaves only noise.
_DEGREE = 2


def propose(
    comparison: SystemComparison,
    state: str,
    evidence: Evidence,
    cited: Mapping[sympy.Expr, float] = {},
    *,
    functions: bool = True,
) -> list[sympy.Expr]:
    """Give the sums of terms of the library that are expected to take the fewest bits.

    Parameters
    ----------
    comparison : its settings, and which columns may be angles.
    state : whose equation is sought.
    evidence : what the data say of it.
    cited : a term that another equation has -> the bits that it saves for that.
    functions : whether others than these and products of the columns are terms.
    """
    settings, demands = comparison.settings.proposals, comparison.settings.demands
    names, angles = comparison.names, comparison.angles
    offered, beside = (*demands.offered, *cited), evidence.names[len(names) :]
    kinds = replace(settings.library, functions=functions)
    library = Library.of(names, evidence.points, angles, offered, kinds, beside)
    saved = {skeleton(body): bits for body, bits in cited.items()}
    each = constant_bits(float(np.max(comparison.mesh.rows)))
    allow = demands.limits(state).allow
    costs = np.full(len(library.forms), np.inf)
    for i, (form, own) in enumerate(zip(library.forms, library.starts, strict=True)):
        body = form.write(evidence.names, own[0])
        if allow(body):
            written = shape_bits(sympy.Float(0.5) * body) + unusual_bits(body, angles)
            inside = len(body.atoms(sympy.Float)) if form.own is not None else form.constants
            costs[i] = written + each * (1 + inside)
            costs[i] -= saved.get(skeleton(body), 0.0)
    return write_all(Proposer(evidence, library, costs, settings).best(), library)


def renewals(comparison: SystemComparison, fit: SystemFit, state: str) -> list[sympy.Expr]:
    """Give the equations that are expected to do best in the place of one.

    Parameters
    ----------
    comparison : fits the systems.
    fit : the system.
    state : whose equation is proposed anew.
    """
    settings = comparison.settings
    # The states of a system that misses them are not quite those of another.
    weight = None if leaves_noise(fit, settings) else settings.proposals.softness
    nodes = settings.proposals.nodes
    evidence = Evidence.in_place(fit.fit, fit.problem, state, comparison.columns, nodes, weight)
    if evidence is None:
        return []
    others = [expr for s, expr in fit.exprs.items() if s != state]
    return propose(comparison, state, evidence, cited_terms(others, state))


def cited_terms(exprs: Iterable[sympy.Expr], state: str) -> dict[sympy.Expr, float]:
    """Give the terms of equations that cost less in another one, and the bits that they save.

    Beside the terms themselves that is what slows this state down as it does another one, such as a
    speed.

    Parameters
    ----------
    exprs : the equations.
    state : whose equation is proposed.

    >>> x, y = sympy.symbols("x y")
    >>> [str(term) for term in cited_terms([0.5 * x - 0.3 * x * sympy.Abs(x - y)], "y")]
    ['x*Abs(x - y)', 'y*Abs(x - y)']
    """
    bodies = [body for expr in exprs for body in bodies_of(expr)]
    found = {body: citing_bits(body) for body in bodies if body.free_symbols}
    for factor in (f for body in bodies for f in sympy.Mul.make_args(body) if wide_factors(f)):
        found.setdefault(factor * sympy.Symbol(state), citing_bits(factor))
    return {body: bits for body, bits in found.items() if bits > 0}


def renew(
    comparison: SystemComparison, best: SystemFit, climb: Callable[[SystemFit], SystemFit]
) -> SystemFit:
    """Fit systems with one equation proposed anew; gives that of fewest bits.

    Parameters
    ----------
    comparison : fits the systems.
    best : the system.
    climb : takes changes from a system for as long as they take fewer bits.
    """
    settings = comparison.settings

    def renewed(best: SystemFit) -> Iterator[SystemFit]:
        settled = leaves_noise(best, settings)
        for state, own in best.exprs.items():
            if own.is_Symbol:
                continue
            plain = is_plain(own) and sympy.total_degree(own) <= _DEGREE
            anew = [] if settled and plain else renewals(comparison, best, state)
            anew = [*anew[: settings.tried], *twins(comparison, best, state)]
            systems = [one for expr in anew for one in comparison.changed(best, state, expr)]
            for fit in filter(None, map(comparison.fit_anew, systems)):
                close = fit.bits < best.bits + settings.behind
                yield prune(comparison, fit, state) if close else fit

    return climb_while_better(renewed, best, climb, settings.rounds)


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
