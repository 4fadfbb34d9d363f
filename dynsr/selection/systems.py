"""Whole systems compared on the measured states: which terms the data themselves ask for.

Slopes of noisy data are biased by their smoother, and a formula that follows the bias may beat the
true one on them. Here whole systems are compared on the states. First each equation alone, the
other states read from their smoothed curves: those of the pool, and sums of terms that a linear fit
expects most of; then the best of each state together; then the search climbs by changes of one
equation, for as long as that takes fewer bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import sympy

from dynsr.expression import ByText, compile_columns, evaluate, skeleton
from dynsr.fit import (
    Measurements,
    one_of_each_shape,
    orthogonal,
    with_floats,
)
from dynsr.selection.alone import Alone, Leader, constants
from dynsr.selection.changes import prune_each
from dynsr.selection.comparison import (
    COMPARISON,
    ComparisonSettings,
    Equations,
    SystemComparison,
    SystemFit,
    apart_by,
    leaves_noise,
    shuffle,
)
from dynsr.selection.couplings import try_couplings
from dynsr.selection.integration import integrate
from dynsr.selection.polynomials import thinned_polynomials, whole_polynomials
from dynsr.selection.renewal import renew
from dynsr.selection.shapes import bare_terms, bodies_of, is_plain, rounded

# How much further apart different functions are where columns take any of their values.
_ASIDE = 5.0
# The same where they are twice as far from their mean.
_FURTHER = 2.0
# Leaders of each other equation whose terms are offered to one.
_CITED = 8
# Different formulas that are named however far behind they are.
_NAMED = 3
# Equations in which a system may differ that speaks against each of them.
_AT_ONCE = 2


@dataclass(frozen=True, eq=False)
class SystemChoice:
    """The system that the states support best.

    Parameters
    ----------
    exprs : state -> equation; one that nothing beat comes back as it was given.
    fit : its fit to the states; None where the states could not be used.
    others : state -> (formula, bits more) of the other formulas that were fitted in its place,
        the closest first; of one with no more constants the bits are those of the residuals.
    """

    exprs: Equations
    fit: SystemFit | None = None
    others: Mapping[str, tuple[tuple[sympy.Expr, float], ...]] = field(default_factory=dict)

    def explains(self, settings: ComparisonSettings) -> bool:
        """Whether the system leaves nothing but noise, and reproduces the runs or pieces of them.

        Parameters
        ----------
        settings : the numbers that decide.
        """
        if self.fit is None or not leaves_noise(self.fit, settings):
            return False
        # Neighbours part on a chaotic run, so that no integration follows the whole of it.
        return any(
            integrate(self.fit, settings.evaluations, pieces) > settings.reproduces
            for pieces in (1, settings.pieces)
        )

    def different(
        self, share: float = COMPARISON.apart
    ) -> dict[str, list[tuple[sympy.Expr, float]]]:
        """State -> (formula, bits more) of those that are other functions of the columns.

        Two columns of a run may be so close to each other that different functions are equal along
        it. They differ where each column takes any of its values.

        Parameters
        ----------
        share : rms difference, as a share of the slopes' spread, from which on two formulas are
            different along the fitted states. Away from these it is five times as large, since
            constants are uncertain. Twice as far from their mean as they go it is twice as large,
            for formulas of no more constants than one with a function has.
        """
        assert self.fit is not None
        mesh = self.fit.problem.mesh
        columns = {**mesh.columns, **dict(zip(mesh.states, self.fit.fit.states.T, strict=True))}
        beside, wider = shuffle(columns), _widen(columns)
        found: dict[str, list[tuple[sympy.Expr, float]]] = {}
        for state, others in self.others.items():
            mine = self.fit.exprs[state]
            own, aside, far = (evaluate(mine, c) for c in (columns, beside, wider))
            count, curved = constants(mine), bool(mine.atoms(sympy.Function))
            near = found[state] = []
            terms = bare_terms(mine)
            # A constant is no alternative for a state that moves.
            moving = [pair for pair in others if pair[0].free_symbols][:60]
            # What has one term more than the law, and a small one, is no other law, and neither is
            # one with a constant that the law has as 1.
            for expr, more in [o for o in moving if not terms <= bare_terms(rounded(o[0]))]:
                apart = apart_by(own, expr, columns)
                told = apart > share or apart_by(aside, expr, beside) > _ASIDE * share
                # Two functions of a short arc may be one there, and part where a run goes further.
                if curved and not told and constants(expr) <= count:
                    told = apart_by(far, expr, wider) > _FURTHER * share
                if told:
                    near.append((expr, more))
            # All of them have a share of the probability, but for what is far behind.
            near[_NAMED:] = [pair for pair in near[_NAMED:] if pair[1] < COMPARISON.near]
        return found


def _widen(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Give the columns twice as far from their mean; those above 0 stay above it."""
    wider = {n: 2 * v - np.mean(v) for n, v in columns.items()}
    return {
        n: np.maximum(w, np.min(columns[n]) / 2) if np.min(columns[n]) > 0 else w
        for n, w in wider.items()
    }


@dataclass(frozen=True, eq=False)
class Compared:
    """What one comparison of some data learnt for the next: its fits, and where they led.

    ``told`` has the formulas that were fitted to each state by itself, with their bits, ``alone``
    the comparison of each, ``together`` that of all, and ``refined`` the system that the end of a
    search came to.
    """

    told: dict[str, Mapping[sympy.Expr, float]] = field(default_factory=dict)
    alone: dict[str, Alone] = field(default_factory=dict)
    together: dict[tuple[str, ...], SystemComparison] = field(default_factory=dict)
    refined: dict[SystemFit, SystemFit] = field(default_factory=dict)


def compare_systems(
    exprs: Mapping[str, sympy.Expr],
    alternatives: Mapping[str, Iterable[sympy.Expr]],
    data: Measurements,
    settings: ComparisonSettings = COMPARISON,
    known: Compared | None = None,
) -> SystemChoice:
    """Give the equations whose terms the states support best, climbing from ``exprs``.

    Parameters
    ----------
    exprs : state -> the equation chosen so far.
    alternatives : state -> other formulas that were found for it, the most probable first.
    data : the measured states, their noise and smoothed curves.
    settings : the numbers that decide.
    known : what an earlier comparison of the same data by the same settings learnt.

    An equation that nothing beats comes back as it was given, and so does one that is one bare
    column, such as q' = v. All come back so where the data cannot be followed, and where their
    noise is so small that slopes are good enough.
    """
    if not settings.ask(data):
        return SystemChoice(dict(exprs))
    states = tuple(exprs)
    force = settings.demands.force
    pools = {
        s: distinct_shapes(force(s, e) for e in [exprs[s], *alternatives.get(s, ())])
        for s in states
    }
    pools = {s: pool[: settings.alone] for s, pool in pools.items()}
    known = Compared() if known is None else known
    comparison = known.together.get(states) or SystemComparison(data.mesh(states), settings)
    known.together[states] = comparison
    found = _search(pools, data, comparison, known)
    if not found:
        return SystemChoice(dict(exprs))
    best = known.refined.get(found[0]) or _refine(comparison, found[0])
    known.refined[found[0]] = known.refined[best] = best
    same = {s: skeleton(best.exprs[s]) == skeleton(with_floats(exprs[s])) for s in states}
    chosen = {s: exprs[s] if same[s] else best.exprs[s] for s in states}
    return SystemChoice(chosen, best, _closest(comparison, best))


def best_so_far(exprs: Mapping[str, sympy.Expr], known: Compared) -> SystemChoice:
    """Give the best system that a comparison had fitted when it was ended.

    Parameters
    ----------
    exprs : state -> the equation chosen before; what comes back where there is none better.
    known : what the comparison has learnt.
    """
    comparison = known.together.get(tuple(exprs))
    fits = [] if comparison is None else list(comparison.fits())
    if not fits:
        return SystemChoice(dict(exprs))
    best = min(fits, key=lambda fit: fit.bits)
    return SystemChoice(dict(best.exprs), best)


def follow_anything(
    exprs: Equations, data: Measurements, settings: ComparisonSettings
) -> Iterator[SystemFit]:
    """Fit systems of all products of the columns, of degree two and then three.

    Exact rows that are far apart show no slopes, but what integrates to all of them shows which of
    the products are nothing.

    Parameters
    ----------
    exprs : state -> equation; that of a bare column, such as q' = v, stays as it is.
    data : the measured states, their noise and smoothed curves.
    settings : the numbers that decide.
    """
    own = [state for state, expr in exprs.items() if not expr.is_Symbol]
    # There is no noise that would hide the errors of the rule.
    finer = replace(data, fineness=2 * data.fineness)
    comparison = SystemComparison(finer.mesh(tuple(exprs)), settings)
    alone = {state: Alone.of(state, finer, settings) for state in own}
    yield from whole_polynomials(comparison, alone, exprs)


def _refine(comparison: SystemComparison, best: SystemFit) -> SystemFit:
    """Search other equations given the rest of a system, and drop terms that do not pay."""
    has = comparison.settings.parts.has
    # What belongs together is passed by where one equation at a time is changed.
    coupled = try_couplings(comparison, best) if has("couplings") else best
    renewed = renew(comparison, coupled) if has("renewal") else coupled
    if has("couplings") and renewed is not best:
        renewed = try_couplings(comparison, renewed)
    return prune_each(comparison, renewed)


def _search(
    pools: Mapping[str, Sequence[sympy.Expr]],
    data: Measurements,
    together: SystemComparison,
    known: Compared,
) -> list[SystemFit]:
    """Rank each state's formulas alone, put the best together and climb; where that ended.

    ``known`` has the states that were looked at alone before, and those that are now.
    """
    settings = together.settings
    # What is one bare column, such as q' = v, is known well enough.
    own = [state for state, pool in pools.items() if not pool[0].is_Symbol]
    for state in (s for s in own if s not in known.alone):
        known.alone[state] = Alone.of(state, data, settings, known.told.get(state))
    alone = {s: known.alone[s] for s in own}
    given = {s: [Leader(pool[0], 0.0)] for s, pool in pools.items()}
    first = given | {s: own.lead(pools[s]) or given[s] for s, own in alone.items()}
    # What leaves one state enters another: terms of the one are cheap in the other.
    leaders = first | {
        s: own.lead_citing(
            first[s], [(o, e.expr) for o in first if o != s for e in first[o][:_CITED]]
        )
        for s, own in (alone.items() if settings.parts.has("citing") else ())
    }
    fits = [fit for own in (first, leaders) if (fit := _compose(together, own)) is not None]
    if settings.parts.has("polynomials"):
        fits += thinned_polynomials(together, alone, {s: p[0] for s, p in pools.items()})

    def finish(fit: SystemFit) -> SystemFit:
        # Alone, terms compensate for the errors of the curves that the others are read from.
        return _climb(together, prune_each(together, fit, pools), leaders)

    least = min((fit.bits for fit in fits), default=math.inf)
    ends = [finish(f) for f in dict.fromkeys(fits) if f.bits <= least + settings.behind]
    return sorted(dict.fromkeys(ends), key=lambda fit: fit.bits)


def distinct_shapes(pool: Iterable[sympy.Expr]) -> list[sympy.Expr]:
    """Give formulas with free constants, one of each shape."""
    return one_of_each_shape(map(with_floats, pool))


def explore(
    state: str, data: Measurements, settings: ComparisonSettings = COMPARISON
) -> dict[sympy.Expr, float]:
    """Give sums of terms that follow one state best, and their bits, fewest bits first.

    The other states are read from their curves.

    The terms are evaluated along the smoothed states, and their integrals are fitted to the
    measured ones (the weak form of Schaeffer and McCalla 2017, with windows of all lengths). Exact
    fits put all in order.

    Parameters
    ----------
    state : whose equation is sought.
    data : the measured states, their noise and smoothed curves.
    settings : the numbers that decide.
    """
    alone = Alone.of(state, data, settings)
    found = alone.rank_sums()
    best = alone.best()
    if best and is_plain(best.exprs[state]) and leaves_noise(best, settings):
        return found
    angles = alone.comparison.coordinates if settings.parts.has("joints") else ()
    joints = [one for angle in angles for one in alone.sums_around(angle)]
    return alone.rank(joints) if joints else found


def _compose(
    comparison: SystemComparison, leaders: Mapping[str, Sequence[Leader]]
) -> SystemFit | None:
    """Fit the system of each state's best formulas, or of the next where that cannot be fitted."""
    for place in range(max(map(len, leaders.values()))):
        exprs = {s: pool[min(place, len(pool) - 1)].expr for s, pool in leaders.items()}
        found = comparison.fit(exprs)
        if found is not None:
            return found
    return None


def _climb(
    comparison: SystemComparison, fit: SystemFit, leaders: Mapping[str, Sequence[Leader]]
) -> SystemFit:
    """Put what leads alone in the place of an equation until none of it takes fewer bits."""
    moves = comparison.settings.parts.has("move-leaders")
    others = {s: [one.expr for one in pool] for s, pool in leaders.items() if moves}
    for _ in range(comparison.settings.rounds):
        expected = (
            (more, state, expr)
            for state, exprs in others.items()
            for more, expr in _expected(comparison, fit, state, exprs)
        )
        best = fit
        for more, state, expr in sorted(expected, key=lambda change: change[0]):
            # What is expected to be far from the best of those before it is not fitted.
            if more >= best.bits - fit.bits + comparison.settings.near:
                break
            fits = [comparison.fit(e, fit) for e in comparison.changed(fit, state, expr)]
            best = min([best, *(f for f in fits if f is not None)], key=lambda f: f.bits)
        if best is fit:
            break
        fit = best
    return fit


def _expected(
    comparison: SystemComparison, fit: SystemFit, state: str, exprs: Sequence[sympy.Expr]
) -> list[tuple[float, sympy.Expr]]:
    """Give how many bits more than its own one other equations of a state are expected to take.

    Their terms are fitted in its place, with all the rest of the system free; the constants inside
    stay as they are.
    """
    view = comparison.evidence(fit, {state: (1.0, fit.exprs[state])})
    if view is None:
        return [(0.0, expr) for expr in exprs]
    expected = []
    for expr in (fit.exprs[state], *exprs):
        bodies = bodies_of(expr)
        with np.errstate(all="ignore"):
            rows = view.mapped(compile_columns(bodies, view.names)(*view.points))
        if not np.all(np.isfinite(rows)):
            expected.append(math.inf)
            continue
        basis = orthogonal(rows.T)
        rest = view.y - basis @ (basis.T @ view.y)
        said = comparison.structure({**fit.exprs, state: expr}) + view.constant_bits * len(bodies)
        expected.append(float(view.misses(float(rest @ rest))) + said)
    own, *others = expected
    more = [bits - own if math.isfinite(own) else 0.0 for bits in others]
    return list(zip(more, exprs, strict=True))


def _closest(
    comparison: SystemComparison, best: SystemFit
) -> dict[str, tuple[tuple[sympy.Expr, float], ...]]:
    """Give the other formulas of each state that were fitted with the best of the other states."""
    shapes = {s: skeleton(e) for s, e in best.exprs.items()}
    found: dict[str, list[tuple[sympy.Expr, float]]] = {s: [] for s in shapes}
    for fit in comparison.fits():
        changed = [s for s, e in fit.exprs.items() if skeleton(e) != shapes[s]]
        # A rate that two equations share comes or goes in both.
        if 1 <= len(changed) <= _AT_ONCE:
            above = fit.bits - best.bits
            for state in changed:
                found[state].append((fit.exprs[state], above))
    return {s: tuple(sorted(o, key=lambda p: (p[1], ByText(p[0])))) for s, o in found.items()}
