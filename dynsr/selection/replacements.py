"""Replacements: one equation of a system found anew, along the states of the system itself.

Alone, an equation is looked for with the others read off their smoothed curves. Where rows are few
these are off, and so is what follows them best. The states of a system that follows the data are
better curves, and with its other equations beside it, their constants free, a new one has to make
up for no errors of theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy

from dynsr.expression import ByText, compile_columns
from dynsr.fit import Linearised, Probes, constant_bits, skeleton
from dynsr.selection.alone import columns_of, expected_sums
from dynsr.selection.changes import climb_while_better, gram_of, prune
from dynsr.selection.comparison import SystemComparison, SystemFit, leaves_noise, owners_of
from dynsr.selection.costs import (
    bodies_of,
    citing_bits,
    is_plain,
    shape_bits,
    term_bodies,
    unusual_bits,
)
from dynsr.selection.likeness import Likeness
from dynsr.selection.subsets import taken_whole, without
from dynsr.selection.twins import exchanged

# Sums of every kind that are looked at, and that are fitted.
_COUNT, _TRIED = 2, 8
# Of sums with wide terms or terms of other equations, and of twins of these, those fitted.
_WIDE, _CITED, _TWINS = 8, 4, 8
# Times that equations are found anew at most, each time along a better system.
_ROUNDS = 4
# Systems close to the best one from which the other equations are found anew.
_NEAR = 2
# Rows along which an equation is compared with sums.
_ROWS = 300
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
        settled, along = leaves_noise(best, comparison.settings), Along(comparison, best)
        for state, own in best.exprs.items():
            if own.is_Symbol:
                continue
            plain = is_plain(own) and sympy.total_degree(own) <= _DEGREE
            anew = [] if settled and plain else replacements(comparison, best, state)[:_TRIED]
            systems = [one for expr in anew for one in comparison.changed(best, state, expr)]
            fits = [comparison.fit(exprs, best) for exprs in systems]
            # Functions begun from other constants may have ended elsewhere.
            known = Replaceable.of(along, state)
            found = [*known.wide(), *known.cited(), *known.twins()]
            systems = [one for expr in found for one in comparison.changed(best, state, expr)]
            fits += [comparison.fit_anew(exprs) for exprs in systems]
            for fit in (f for f in fits if f is not None):
                close = fit.bits < best.bits + comparison.settings.behind
                yield prune(comparison, fit, state) if close else fit

    def cited(best: SystemFit, known: SystemFit) -> Iterator[SystemFit]:
        """What one equation pays for a term, another may save that has it too."""
        along = Along(comparison, best)
        new = [s for s, e in best.exprs.items() if skeleton(e) != skeleton(known.exprs[s])]
        for state in (s for s, e in best.exprs.items() if s not in new and not e.is_Symbol):
            for expr in Replaceable.of(along, state).cited():
                fit = comparison.fit_anew({**best.exprs, state: expr})
                if fit is not None:
                    yield prune(comparison, fit, state)

    def both(best: SystemFit) -> Iterator[SystemFit]:
        found = sorted(replaced(best), key=lambda f: f.bits)
        yield from found
        near = [f for f in found if best.bits < f.bits < best.bits + comparison.settings.near]
        if found and found[0].bits >= best.bits:
            for fit in list(dict.fromkeys(near))[:_NEAR]:
                yield from cited(fit, best)

    return climb_while_better(both, best, climb, _ROUNDS)


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


@dataclass(frozen=True, eq=False)
class Along:
    """Some rows along the states of a system, the same for each of its equations."""

    comparison: SystemComparison
    fit: SystemFit

    @cached_property
    def points(self) -> np.ndarray:
        """(names + 1, n) values of the columns, the time the last."""
        rows = len(self.comparison.mesh.t)
        few = np.unique(np.linspace(0, rows - 1, min(rows, _ROWS)).astype(int))
        return self.fit.points[:, few]

    @cached_property
    def columns(self) -> np.ndarray:
        """Values of the wide terms, and their slopes."""
        return self.comparison.wide.values(self.points[:-1])


@dataclass(frozen=True, eq=False)
class Replaceable:
    """One equation of a system by its ``values`` along the states, and sums ``like`` it.

    Only sums are given that are shorter than the equation, of ``own`` bits, or not longer by more
    than the system's misses could save: of ``most`` bits.
    """

    along: Along
    state: str
    values: np.ndarray
    like: Likeness
    own: float
    most: float

    @classmethod
    def of(cls, along: Along, state: str) -> Replaceable:
        """Take one equation.

        Parameters
        ----------
        along : the rows of the system.
        state : whose equation it is.
        """
        comparison, fit = along.comparison, along.fit
        own, mesh = fit.exprs[state], comparison.mesh
        each = constant_bits(float(mesh.rows.max()))
        values = compile_columns([own], comparison.columns)(*along.points)[0]
        bits = shape_bits(own) + unusual_bits(own, comparison.angles)
        bits += each * len(own.atoms(sympy.Float))
        most = bits + comparison.settings.near
        if not leaves_noise(fit, comparison.settings):
            most += float(mesh.rows @ np.log2(np.maximum(fit.fit.mean_squares, 1.0))) / 2
        allow = comparison.settings.demands.limits(state).allow
        like = Likeness(
            comparison.terms, comparison.wide, comparison.columns, along.points, each, allow
        )
        return cls(along, state, values, like, bits, most)

    def wide(self) -> list[sympy.Expr]:
        """Give sums with a wide term, those that are expected to do best."""
        return self._expected(self.like.wide_sums(self.along.columns, self.values, self.most))[
            :_WIDE
        ]

    def cited(self) -> list[sympy.Expr]:
        """Give sums with a term of another equation, or with its line below a fraction."""
        others = [expr for s, expr in self.along.fit.exprs.items() if s != self.state]
        written = [body for expr in others for body in bodies_of(expr)]
        return self._expected(self.like.cited_sums(self.values, self.most, written))[:_CITED]

    def twins(self) -> list[sympy.Expr]:
        """Give the other equations with names exchanged so that they are this one.

        All are fitted: where one equation of two bodies is wrong, the states are bent beside it,
        and along them its twin looks far behind.
        """
        states, equations = self.along.comparison.mesh.states, self.along.fit.exprs
        found = {
            skeleton(expr): expr
            for other, own in equations.items()
            if other != self.state and not own.is_Symbol
            for expr in exchanged(own, other, self.state, states)
        }
        found.pop(skeleton(equations[self.state]), None)
        allow = self.like.allow
        fine = [e for e in found.values() if all(allow(body) for body in bodies_of(e))]
        return fine[:_TWINS]

    def _expected(self, likely: Sequence[tuple[sympy.Expr, float]]) -> list[sympy.Expr]:
        """Fit sums to what is known, and put those first that the data are expected to like best.

        They come with the bits of their terms and constants.
        """
        fit, comparison = self.along.fit, self.along.comparison
        own = fit.exprs[self.state]
        points = fit.points
        shapes = {skeleton(expr): (expr, bits) for expr, bits in reversed(likely)}
        shapes.pop(skeleton(own), None)
        fitted = [(self.like.fitted(expr, self.values), bits) for expr, bits in shapes.values()]
        bodies = list(dict.fromkeys(body for expr, _ in fitted for body in bodies_of(expr)))
        if not bodies:
            return []
        columns = compile_columns([own, *bodies], comparison.columns)(*points)
        gram = _gram_in_place(comparison, fit, self.state, columns)
        if gram is None:
            return []
        rows, ranked = float(comparison.mesh.rows.sum()), []
        places_of = {body: place for place, body in enumerate(bodies, 1)}
        for expr, bits in [(own, self.own), *fitted]:
            places = [0] if expr is own else [places_of[body] for body in bodies_of(expr)]
            left = float(without(gram, places, len(columns))[0, 0])
            if np.all(np.isfinite(columns[places])) and left > 0:
                ranked.append((bits + rows / 2 * np.log2(left / rows), ByText(expr)))
        # What is expected to be far behind the equation itself is not worth a fit.
        most = ranked[0][0] + comparison.settings.behind if ranked else np.inf
        return [text.expr for bits, text in sorted(ranked) if bits < most and text.expr is not own]


def _normal(
    comparison: SystemComparison, fit: SystemFit, state: str, tiers: Sequence[np.ndarray]
) -> Linearised | None:
    """Give the normal equations of terms in the place of one equation, the others' constants free.

    None where the system does not tell.
    """
    columns = columns_of(comparison.terms, tiers, fit.points[:-1], curved=True)
    gram = _gram_in_place(comparison, fit, state, columns)
    if gram is None:
        return None
    return Linearised(gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1]))


def _gram_in_place(
    comparison: SystemComparison, fit: SystemFit, state: str, columns: np.ndarray
) -> np.ndarray | None:
    """Give the products of columns in the place of one equation, and of the misses as the last."""
    mesh, points = comparison.mesh, fit.points
    own = compile_columns([fit.exprs[state]], comparison.columns)(*points)
    values = np.concatenate([-own, columns])
    slopes = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    probes = Probes(np.full(len(values), mesh.states.index(state)), slopes)
    # The states of a system that misses them are not quite those of another.
    settings = comparison.settings
    weight = None if leaves_noise(fit, settings) else settings.softness
    gram = gram_of(fit, probes, weight)
    if gram is None:
        return None
    owners = owners_of(fit.exprs)
    gone = len(owners)
    others = [place for place, owner in enumerate(owners) if owner != state]
    # The equation as it was is taken out, and the misses are left to what takes its place.
    return without(taken_whole(gram, gone), others, gone + 1)
