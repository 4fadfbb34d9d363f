"""Renewal: one equation of a system proposed anew, along the states of the system itself.

Alone, an equation is looked for with the others read off their smoothed curves. Where rows are few
these are off, and so is what follows them best. The states of a system that follows the data are
better curves, and with its other equations beside it, their constants free, a new one has to make
up for no errors of theirs. A term that another equation has costs no more than naming it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import sympy

from dynsr.fit import one_of_each_shape, precision_bits, skeleton
from dynsr.library import Library, write_down
from dynsr.selection.changes import climb_while_better, prune
from dynsr.selection.comparison import SystemComparison, SystemFit, leaves_noise
from dynsr.selection.costs import bodies_of, is_plain, wide_factors
from dynsr.selection.evidence import Evidence
from dynsr.selection.propose import Proposer, write_all
from dynsr.selection.twins import exchanged

# Degree of a short polynomial that is good enough where it leaves only noise.
_DEGREE = 2


def propose(
    comparison: SystemComparison,
    state: str,
    evidence: Evidence,
    others: Sequence[tuple[str, sympy.Expr]] = (),
    *,
    functions: bool = True,
) -> list[sympy.Expr]:
    """Give the sums of terms of the library that are expected to take the fewest bits.

    Parameters
    ----------
    comparison : its settings, and which columns may be angles.
    state : whose equation is sought.
    evidence : what the data say of it.
    others : states and equations of theirs; what stands in these costs less.
    functions : whether others than their terms and products of the columns are terms.
    """
    settings, demands = comparison.settings.proposals, comparison.settings.demands
    names, angles = comparison.names, comparison.angles
    cited = cited_terms((expr for _, expr in others), state)
    offered, beside = (*demands.offered, *cited), evidence.names[len(names) :]
    kinds = replace(settings.library, functions=functions)
    library = Library.of(names, evidence.points, angles, offered, kinds, beside)
    written = write_down(others)
    # Of what the whole slope is worth in the data, a constant has about that precision.
    each = precision_bits(np.array([[evidence.y @ evidence.y]]), np.ones(1))
    allow = demands.limits(state).allow
    costs = np.full(len(library.forms), np.inf)
    for i, (form, own) in enumerate(zip(library.forms, library.starts, strict=True)):
        body = form.write(evidence.names, own[0])
        if allow(body):
            inside = len(body.atoms(sympy.Float)) if form.own is not None else form.constants
            costs[i] = comparison.term_bits(body, state, written) + each * (1 + inside)
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
    weight = None if leaves_noise(fit, settings) else settings.softness
    nodes = settings.proposals.nodes
    evidence = Evidence.in_place(fit.fit, fit.problem, state, comparison.columns, nodes, weight)
    if evidence is None:
        return []
    others = [(s, expr) for s, expr in fit.exprs.items() if s != state]
    return propose(comparison, state, evidence, others)


def cited_terms(exprs: Iterable[sympy.Expr], state: str) -> list[sympy.Expr]:
    """Give the terms of equations, which cost less in another one.

    Beside the terms themselves that is what slows this state down as it does another one, such as a
    speed.

    Parameters
    ----------
    exprs : the equations.
    state : whose equation is proposed.

    >>> x, y = sympy.symbols("x y")
    >>> [str(term) for term in cited_terms([0.5 * x - 0.3 * x * sympy.Abs(x - y)], "y")]
    ['x', 'x*Abs(x - y)', 'y*Abs(x - y)']
    """
    bodies = [body for expr in exprs for body in bodies_of(expr) if body.free_symbols]
    own = sympy.Symbol(state)
    wide = [f * own for body in bodies for f in sympy.Mul.make_args(body) if wide_factors(f)]
    return one_of_each_shape([*bodies, *wide])


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
