"""Couplings looked for: an acceleration said by another one and a few terms, then written out.

Alone, the fraction that belongs to another acceleration is longer than others which follow the
states as well, and a search that counts its terms passes it by. Said by the other one it is
short, and is found as short sums are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import sympy

from dynsr.expression import ByText, compile_columns
from dynsr.fit import Probes, constant_bits, structure_bits
from dynsr.selection.changes import climb_while_better, gram_of, prune
from dynsr.selection.comparison import SystemComparison, SystemFit, owners_of
from dynsr.selection.mass_matrix import FACTORS, Ratio, read_ratio, slope_of
from dynsr.selection.subsets import best_subsets, solve_scaled, taken_whole, without
from dynsr.selection.terms import Joint

# Terms beside the other acceleration at most, sums of them that are written out, and fitted.
_MOST, _KEPT, _TRIED = 3, 6, 3


def try_couplings(
    comparison: SystemComparison,
    best: SystemFit,
    climb: Callable[[SystemFit], SystemFit],
) -> SystemFit:
    """Fit systems in which one acceleration is said by another; gives that of fewest bits.

    Parameters
    ----------
    comparison : fits the systems.
    best : the system.
    climb : takes changes from a system for as long as they take fewer bits.
    """

    def coupled(best: SystemFit) -> Iterator[SystemFit]:
        for state, expr in _couple(comparison, best):
            fit = comparison.fit({**best.exprs, state: expr}, best)
            if fit is not None:
                yield prune(comparison, fit, state)

    return climb_while_better(coupled, best, climb, comparison.settings.again)


def _couple(comparison: SystemComparison, fit: SystemFit) -> Iterator[tuple[str, sympy.Expr]]:
    """Give the equations that another one and a few terms are expected to say best."""
    ratios = {by: read_ratio(expr) for by, expr in fit.exprs.items()}
    for by, ratio in ratios.items():
        for state, expr in fit.exprs.items():
            if ratio is not None and state != by and not expr.is_Symbol:
                said = list(_say(comparison, fit, state, by, ratio))
                said.sort(key=lambda pair: (pair[0], ByText(pair[1])))
                yield from ((state, other) for _, other in said[:_TRIED])


def _say(
    comparison: SystemComparison, fit: SystemFit, state: str, by: str, ratio: Ratio
) -> Iterator[tuple[float, sympy.Expr]]:
    """Give one equation said by another one, with the bits that are expected of it."""
    mesh, found = comparison.mesh, fit.fit
    limits = comparison.settings.demands.limits(state)
    joint = Joint.of(str(ratio.main.args[0]), comparison.names)
    terms = [e for e in joint.above if limits.allow(e)]
    waves = [ratio.main**main * ratio.other**other for main, other in FACTORS]
    exprs = [-fit.exprs[state], *(wave * fit.exprs[by] for wave in waves), *terms]
    slopes = compile_columns(exprs, comparison.columns)(*fit.points)
    probes = Probes(np.full(len(exprs), mesh.states.index(state)), slopes)
    gram = gram_of(fit, probes) if np.all(np.isfinite(slopes)) else None
    if gram is None:
        return
    rows, each = float(mesh.rows.sum()), constant_bits(float(mesh.rows.max()))
    costs = each + np.array([structure_bits(sympy.Float(0.5) * e) for e in terms])
    others = [i for i, owner in enumerate(owners_of(fit.exprs)) if owner != state]
    gone = len(found.constants)
    first = gone + 1 + len(waves)
    gram = taken_whole(gram, gone)
    for place, (wave, factor) in enumerate(zip(waves, FACTORS, strict=True), gone + 1):
        loose = [*others, place]
        rest = without(gram, loose, first)
        written = structure_bits(sympy.Float(0.5) * wave * slope_of(by)) + each
        for subset in best_subsets(
            rest[:-1, :-1], -rest[:-1, -1], rest[-1, -1], costs, rows, most=_MOST, keep=_KEPT
        ):
            free = [place, *(first + i for i in subset.places), *others]
            size, *sizes = -solve_scaled(gram, free, gram[free, -1:])[: 1 + len(subset.places), 0]
            bodies = [terms[i] for i in subset.places]
            beside = [sympy.Float(c) * e for c, e in zip(sizes, bodies, strict=True)]
            expr = ratio.put_in(fit.exprs[by], float(size), factor, sympy.Add(*beside))
            yield subset.bits + written, expr
