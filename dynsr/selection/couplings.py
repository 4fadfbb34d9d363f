"""Couplings looked for: an acceleration said by another one and a few terms, then written out.

Alone, the fraction that belongs to another acceleration is longer than others which follow the
states as well, and a search that counts its terms passes it by. Said by the other one it is
short, and is found as short sums are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations, product

import numpy as np
import sympy

from dynsr.expression import ByText, compile_columns
from dynsr.fit import Probes, constant_bits, structure_bits
from dynsr.selection.changes import gram_of, prune_each, while_better
from dynsr.selection.comparison import Equations, SystemComparison, SystemFit, owners_of
from dynsr.selection.joints import Joint
from dynsr.selection.mass_matrix import FACTORS, read_ratio, slope_of
from dynsr.selection.subsets import best_subsets, solve_scaled, taken_whole, without

# Terms beside the other acceleration at most, sums of them that are written out, and fitted.
_MOST, _KEPT, _TRIED = 3, 6, 3


def try_couplings(comparison: SystemComparison, best: SystemFit) -> SystemFit:
    """Fit systems in which one acceleration is said by another; gives that of fewest bits.

    Parameters
    ----------
    comparison : fits the systems.
    best : the system.
    """

    def coupled(best: SystemFit) -> Iterator[SystemFit]:
        for exprs in _couple(comparison, best):
            fit = comparison.fit({**best.exprs, **exprs}, best)
            if fit is not None:
                yield prune_each(comparison, fit, exprs)

    return while_better(coupled, best, comparison.settings.again)


def _couple(comparison: SystemComparison, fit: SystemFit) -> Iterator[Equations]:
    """Give equations that are expected to be shortest when they contain one another.

    One contains another with the same denominator, or two contain each other.
    """
    speeds = {s: e.as_coeff_Mul()[1] for s, e in fit.exprs.items()}
    own = [state for state, expr in speeds.items() if not expr.is_Symbol]
    for state, by in permutations(own, 2):
        ratio = read_ratio(fit.exprs[by])
        if ratio is not None:
            said = _say(comparison, fit, state, by, (ratio.main, ratio.other))
            for one in said[:_TRIED]:
                expr = ratio.put_in(fit.exprs[by], one.size, one.factor, one.beside)
                yield {state: expr}
    joints = [s for s, e in speeds.items() if e.is_Symbol and s in comparison.angles]
    pairs = [
        pair
        for angle in map(sympy.Symbol, joints)
        for two in combinations(own, 2)
        for pair in _say_both(comparison, fit, two, (sympy.sin(angle), sympy.cos(angle)))
    ]
    # Most are never written out.
    pairs.sort(key=lambda pair: pair.bits)
    yield from (pair.solved() for pair in pairs[:_TRIED])


@dataclass(frozen=True)
class _Said:
    """One equation said by another one: ``size`` times waves times it, and what is ``beside`` it.

    ``factor`` are the powers of the two waves, ``bits`` what is expected of it.
    """

    bits: float
    size: float
    factor: tuple[int, int]
    beside: sympy.Expr


@dataclass(frozen=True)
class _SaidByEachOther:
    """Two equations, each said by the other one.

    ``rest`` is the one of the two waves that is in neither.
    """

    states: tuple[str, str]
    said: tuple[_Said, _Said]
    wave: sympy.Expr
    rest: sympy.Expr

    @property
    def bits(self) -> float:
        """Bits that are expected of both."""
        return sum(own.bits for own in self.said)

    @property
    def tie(self) -> float:
        """The product of both factors."""
        one, other = self.said
        return one.size * other.size

    def solved(self) -> Equations:
        """Give the equations solved for."""
        own, its = self.said
        # Over 1 - a b and what is 1 less the square of the wave, nothing can be 0.
        line = 1 + sympy.Float(self.tie / (1 - self.tie)) * self.rest**2
        tops = (
            own.beside + sympy.Float(own.size) * self.wave * its.beside,
            its.beside + sympy.Float(its.size) * self.wave * own.beside,
        )
        share = sympy.Float(1 / (1 - self.tie))
        pairs = zip(self.states, tops, strict=True)
        return {state: sympy.expand(share * top) / line for state, top in pairs}


def _say_both(
    comparison: SystemComparison,
    fit: SystemFit,
    states: tuple[str, str],
    waves: tuple[sympy.Expr, sympy.Expr],
) -> Iterator[_SaidByEachOther]:
    """Give two equations that are said by each other.

    Masses are positive: of y' = a c z' + f and z' = b c y' + g, c a wave, a b is between 0 and 1.
    """
    one, other = (_say(comparison, fit, s, by, waves) for s, by in (states, states[::-1]))
    for own, its in product(one, other):
        if own.factor == its.factor != (0, 0):
            wave, rest = waves if own.factor == (1, 0) else waves[::-1]
            both = _SaidByEachOther(states, (own, its), wave, rest)
            if 0 < both.tie < 1:
                yield both


def _say(
    comparison: SystemComparison,
    fit: SystemFit,
    state: str,
    by: str,
    both: tuple[sympy.Expr, sympy.Expr],
) -> list[_Said]:
    """Give one equation said by another one and few terms, the best first."""
    mesh, found = comparison.mesh, fit.fit
    limits = comparison.settings.demands.limits(state)
    joint = Joint.of(str(both[0].args[0]), comparison.names)
    terms = [e for e in joint.above if limits.allow(e)]
    waves = [both[0] ** first * both[1] ** second for first, second in FACTORS]
    exprs = [-fit.exprs[state], *(wave * fit.exprs[by] for wave in waves), *terms]
    slopes = compile_columns(exprs, comparison.columns)(*fit.points)
    probes = Probes(np.full(len(exprs), mesh.states.index(state)), slopes)
    gram = gram_of(fit, probes) if np.all(np.isfinite(slopes)) else None
    if gram is None:
        return []
    rows, each = float(mesh.rows.sum()), constant_bits(float(mesh.rows.max()))
    costs = each + np.array([structure_bits(sympy.Float(0.5) * e) for e in terms])
    others = [i for i, owner in enumerate(owners_of(fit.exprs)) if owner != state]
    gone = len(found.constants)
    first = gone + 1 + len(waves)
    gram = taken_whole(gram, gone)
    said = []
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
            beside = sympy.Add(*[sympy.Float(c) * e for c, e in zip(sizes, bodies, strict=True)])
            said.append(_Said(subset.bits + written, float(size), factor, beside))
    return sorted(said, key=lambda one: (one.bits, ByText(one.beside)))
