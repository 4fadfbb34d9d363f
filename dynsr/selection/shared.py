"""Shared rates: a term of two equations, looked for in both at once.

What is eaten leaves one equation and enters another. Alone, neither need be led by a sum that holds
it: in each some other sum follows the states as well and is shorter. Written once for both, it is
the shortest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import sympy

from dynsr.expression import ByText
from dynsr.selection.alone import Alone, Leader
from dynsr.selection.comparison import SystemComparison, SystemFit
from dynsr.selection.costs import citing_bits
from dynsr.selection.subsets import FARTHEST, best_subsets, solve_scaled, without
from dynsr.selection.terms import move_inside, weighted_sum

# Terms that may be shared, plain ones beside them, and how many of these at most.
_OFFERED, _PLAINEST, _BESIDE = 160, 40, 3
# Subsets of each size that are grown, systems that are fitted, and those that are given.
_BEAM, _FITTED, _GIVEN = 8, 8, 2


@dataclass(frozen=True)
class _Sum:
    """A sum that holds some term: the bits expected, the shift of the constant in it, the rest."""

    bits: float
    size: float
    shift: float
    beside: sympy.Expr


def share_rates(
    alone: Mapping[str, Alone],
    comparison: SystemComparison,
    leaders: Mapping[str, Sequence[Leader]],
) -> list[SystemFit]:
    """Fit systems in which a term leaves one equation and enters another; gives the best of them.

    Parameters
    ----------
    alone : the states whose equations are sought, each by itself.
    comparison : fits the systems.
    leaders : what leads alone; the equations of the other states.
    """
    open_ = {state: own for state, own in alone.items() if not own.is_clear()}
    if len(open_) < 2:
        return []
    bodies = _shareable(comparison)
    sums = {state: _sums_with(own, bodies, comparison) for state, own in open_.items()}
    ranked = sorted(
        (
            sums[one][body].bits + sums[other][body].bits - citing_bits(body),
            ByText(body),
            one,
            other,
        )
        for one, other in combinations(open_, 2)
        for body in sums[one].keys() & sums[other].keys()
        if sums[one][body].size * sums[other][body].size < 0
    )
    fits = []
    for _, body, one, other in ranked[:_FITTED]:
        both = [sums[state][body.expr] for state in (one, other)]
        # The constant is one, and either equation says where it goes.
        moved = move_inside(body.expr, float(np.mean([own.shift for own in both])))
        exprs = {state: pool[0].expr for state, pool in leaders.items()}
        for state, own in zip((one, other), both, strict=True):
            told = sympy.Float(own.size) * moved + own.beside
            exprs[state] = comparison.settings.demands.force(state, told)
        fits.append(comparison.fit(exprs))
    return sorted((f for f in fits if f is not None), key=lambda f: f.bits)[:_GIVEN]


def _shareable(comparison: SystemComparison) -> list[sympy.Expr]:
    """Give the terms that are worth citing: functions, with one constant inside at most."""
    terms, symbols = comparison.terms, [sympy.Symbol(name) for name in comparison.names]
    return [
        expr
        for expr, inside in zip(terms.exprs, terms.inside, strict=True)
        if inside <= 1 and citing_bits(expr) > 0 and not expr.is_polynomial(*symbols)
    ][:_OFFERED]


def _sums_with(
    alone: Alone, bodies: Sequence[sympy.Expr], comparison: SystemComparison
) -> dict[sympy.Expr, _Sum]:
    """Give the best sum of each term and a few plain ones for one state."""
    allow = comparison.settings.demands.limits(alone.state).allow
    bodies = [body for body in bodies if allow(body)]
    terms = zip(comparison.terms.exprs, comparison.terms.inside, strict=True)
    plain = [e for e, inside in terms if not inside and allow(e)][:_PLAINEST]
    gram = alone.gram(bodies, plain) if plain else None
    if gram is None:
        return {}
    costs = np.array([alone.term_bits(expr) for expr in plain])
    found = {}
    for place, body in enumerate(bodies):
        loose = [place, len(bodies) + place] if body.atoms(sympy.Float) else [place]
        own = _sum_with(gram, loose, plain, costs, alone)
        found[body] = replace(own, bits=own.bits + alone.term_bits(body))
    return found


def _sum_with(
    gram: np.ndarray,
    loose: Sequence[int],
    plain: Sequence[sympy.Expr],
    costs: np.ndarray,
    alone: Alone,
) -> _Sum:
    """Give the best sum of one term, and of its slope by the constant in it, and plain ones."""
    first = len(gram) - 1 - len(plain)
    rest = without(gram, loose, first)
    left = max(float(rest[-1, -1]), 1e-300)
    best = best_subsets(
        rest[:-1, :-1],
        -rest[:-1, -1],
        left,
        costs,
        alone.rows,
        beam=_BEAM,
        most=_BESIDE,
        keep=1,
    )
    places = best[0].places if best else ()
    bits = best[0].bits if best else alone.rows / 2 * math.log2(left / alone.rows)
    free = [*loose, *(first + place for place in places)]
    sizes = -solve_scaled(gram, free, gram[free, -1:])[:, 0]
    shift = sizes[1] / sizes[0] if len(loose) > 1 else 0.0
    if not abs(shift) <= FARTHEST:
        # A linear step says nothing of what is far away.
        return _sum_with(gram, loose[:1], plain, costs, alone)
    beside = weighted_sum(sizes[len(loose) :].tolist(), [plain[i] for i in places])
    return _Sum(bits, float(sizes[0]), float(shift), beside)
