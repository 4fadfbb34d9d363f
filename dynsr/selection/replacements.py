"""Replacements: one equation of a system found anew, along the states of the system itself.

Alone, an equation is looked for with the others read off their smoothed curves. Where rows are few
these are off, and so is what follows them best. The states of a system that follows the data are
better curves, and with its other equations beside it, their constants free, a new one has to make
up for no errors of theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import sympy

from dynsr.expression import compile_columns
from dynsr.fit import Linearised, constant_bits, skeleton
from dynsr.selection.alone import columns_of, expected_sums
from dynsr.selection.changes import climb_while_better, gram_of, prune
from dynsr.selection.comparison import SystemComparison, SystemFit, leaves_noise, owners_of
from dynsr.selection.costs import citing_bits, is_plain, term_bodies
from dynsr.selection.subsets import taken_whole, without

# Sums of every kind that are looked at, and that are fitted.
_COUNT, _TRIED = 2, 8
# Degree of a short polynomial that is good enough where it leaves only noise.
_DEGREE = 2


def try_replacements(
    comparison: SystemComparison, best: SystemFit, climb: Callable[[SystemFit], SystemFit]
) -> SystemFit:
    """Fit systems with one equation found anew; gives that of fewest bits.

    Parameters
    ----------
    comparison : fits the systems.
    best : the system.
    climb : takes changes from a system for as long as they take fewer bits.
    """

    def replaced(best: SystemFit) -> Iterator[SystemFit]:
        settled = leaves_noise(best, comparison.settings)
        for state, own in best.exprs.items():
            plain = is_plain(own) and sympy.total_degree(own) <= _DEGREE
            if own.is_Symbol or (settled and plain):
                continue
            for expr in replacements(comparison, best, state)[:_TRIED]:
                fit = comparison.fit({**best.exprs, state: expr}, best)
                if fit is not None and fit.bits < best.bits + comparison.settings.near:
                    fit = prune(comparison, fit, state)
                if fit is not None:
                    yield fit

    return climb_while_better(replaced, best, climb, comparison.settings.again)


def replacements(comparison: SystemComparison, fit: SystemFit, state: str) -> list[sympy.Expr]:
    """Give the sums of terms that are expected to do best in the place of one equation.

    Parameters
    ----------
    comparison : fits the systems.
    fit : the system.
    state : whose equation is found anew.
    """
    terms = comparison.terms
    tiers = (*terms.tiers, terms.divisible_by(state))
    normal = _normal(comparison, fit, state, tiers)
    if normal is None:
        return []
    rows = comparison.mesh.rows
    costs = terms.bits + constant_bits(float(rows.max())) * (1 + terms.inside)
    allow = comparison.settings.demands.limits(state).allow
    beside = set().union(*(term_bodies(e) for s, e in fit.exprs.items() if s != state))
    for i, term in enumerate(terms.exprs):
        if not allow(term):
            costs[i] = np.inf
        elif skeleton(term) in beside:
            costs[i] -= citing_bits(term)
    return expected_sums(normal, terms, tiers, costs, float(rows.sum()), _COUNT, curved=True)


def _normal(
    comparison: SystemComparison, fit: SystemFit, state: str, tiers: Sequence[np.ndarray]
) -> Linearised | None:
    """Give the normal equations of terms in the place of one equation, the others' constants free.

    None where the system does not tell.
    """
    mesh, found = comparison.mesh, fit.fit
    points = fit.problem.points(found.states, found.constants)
    own = compile_columns([fit.exprs[state]], [*comparison.names, "t"])(*points)
    columns = columns_of(comparison.terms, tiers, points[:-1], curved=True)
    slopes = np.zeros((len(mesh.states), 1 + len(columns), points.shape[1]))
    values = np.concatenate([-own, columns])
    slopes[mesh.states.index(state)] = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    # The states of a system that misses them are not quite those of another.
    settings = comparison.settings
    weight = None if leaves_noise(fit, settings) else settings.softness
    gram = gram_of(fit, slopes, weight)
    if gram is None:
        return None
    owners = owners_of(fit.exprs)
    gone = len(owners)
    others = [place for place, owner in enumerate(owners) if owner != state]
    # The equation as it was is taken out, and the misses are left to what takes its place.
    rest = without(taken_whole(gram, gone), others, gone + 1)
    return Linearised(rest[:-1, :-1], rest[:-1, -1], float(rest[-1, -1]))
