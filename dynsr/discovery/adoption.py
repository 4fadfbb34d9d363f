"""Adoption: a formula that follows the data better than the answer becomes the answer.

Alternatives are compared with the answer by a linearised fit. One that seems better there is
fitted to all data and tested as the answer was. Where it is better, it takes its place. Where it
is not, the bits that it takes more are reported. So no answer has an alternative that is better.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import sympy

from dynsr.discovery.problem import OtherFormulas, Problem
from dynsr.discovery.result import Discovery
from dynsr.expression import parse, shown
from dynsr.fit import ParetoFront, constant_bits, same_form, tidy, with_floats
from dynsr.jobs import finish_by
from dynsr.library import structure_in
from dynsr.verdict import LEAST_SQUARE, LEVELS, NOT_FOUND, OtherFormula, Verdict, count_constants


def adopt_better(
    problem: Problem, found: Discovery, alternatives: OtherFormulas | None
) -> Discovery:
    """Give the answer after each alternative that seemed better was tried in its place.

    Parameters
    ----------
    problem : the data and what is given of their equations.
    found : what was found, with its verdict.
    alternatives : state -> (formula, bits above the equation) where they were compared before.
    """
    if problem.settings.selection.loss is not None:
        # What counts for the user is no matter of bits.
        return found
    for _ in range(problem.settings.verdict.adopted * len(found.equations)):
        doubt = _doubt(problem, found.verdict)
        if doubt is None:
            return found
        state, alternative = doubt
        expr, more = _formula(found, alternatives, state, alternative), math.inf
        other = None if problem.demands.conserved else problem.with_equation(found, state, expr)
        if other is not None:
            moved = (
                None
                if alternatives is None
                else _seen_from(alternatives, found, other, state, alternative.bits)
            )
            other = problem.with_verdict(other, moved)
            more = _behind(problem, found, other)
            if more < 0:
                found, alternatives = other, moved
                continue
        found, alternatives = _told(problem, found, {(state, alternative.equation): more})
    # Nothing is called better that was not tried.
    left = {
        (state, one.equation): 0.0
        for state, own in found.verdict.states.items()
        for one in own.alternatives
        if one.bits < 0 and _may_be_returned(problem, one)
    }
    return _told(problem, found, left)[0] if left else found


def adopt_in_time(
    problem: Problem, found: Discovery, alternatives: OtherFormulas | None
) -> Discovery:
    """Do the same within the time of the verdict; if that runs out, nothing changes.

    Parameters
    ----------
    problem, found, alternatives : as for :func:`adopt_better`.
    """
    best, cut = finish_by(
        problem.until("verdict"),
        lambda: adopt_better(problem, found, alternatives),
        lambda: found,
    )
    problem.cut.extend(["alternatives"] if cut else [])
    return best


def _doubt(problem: Problem, verdict: Verdict) -> tuple[str, OtherFormula] | None:
    """Give the alternative that seems better by most, and its state; None where none does."""
    better = [
        (state, one)
        for state, own in verdict.states.items()
        for one in own.alternatives
        if own.level != NOT_FOUND and one.bits < 0 and _may_be_returned(problem, one)
    ]
    return min(better, key=lambda pair: pair[1].bits, default=None)


def _may_be_returned(problem: Problem, alternative: OtherFormula) -> bool:
    """Whether an equation may contain what this one does; the time, only where it is asked for."""
    columns = {*problem.runs[0].names, *(["t"] if problem.form.explicit_time else [])}
    return {str(symbol) for symbol in parse(alternative.equation).free_symbols} <= columns


def _formula(
    found: Discovery, alternatives: OtherFormulas | None, state: str, alternative: OtherFormula
) -> sympy.Expr:
    """Give an alternative with all its digits where they are known."""
    known = [e for e, _ in (alternatives or {}).get(state, ())]
    known += [c.expr for c in found.front.get(state, ())]
    alike = (e for e in known if shown(tidy(e), 4) == alternative.equation)
    return next(alike, None) or parse(alternative.equation)


def _seen_from(
    alternatives: OtherFormulas, found: Discovery, other: Discovery, state: str, bits: float
) -> OtherFormulas:
    """Give the alternatives to another answer, which takes so many bits more."""
    pairs = alternatives.get(state, ())
    own = [(e, more - bits) for e, more in pairs if not same_form(e, other.equations[state])]
    return {**alternatives, state: [*own, (found.equations[state], -bits)]}


def _behind(problem: Problem, own: Discovery, other: Discovery) -> float:
    """Bits that another answer takes more, once it is fitted and tested; inf for a worse level.

    A better level goes before bits, and what is followed for longer is called better.
    """
    ranks = [
        sorted((LEVELS.index(one.level) for one in found.verdict.states.values()), reverse=True)
        for found in (own, other)
    ]
    if ranks[0] != ranks[1]:
        return math.inf if ranks[1] > ranks[0] else -math.inf
    if other.verdict.span < own.verdict.span:
        return math.inf
    theirs = other.verdict.states
    rows = {s: max(mine.rows, theirs[s].rows) for s, mine in own.verdict.states.items()}
    return _length(problem, other, rows) - _length(problem, own, rows)


def _length(problem: Problem, found: Discovery, independent: Mapping[str, float]) -> float:
    """Bits of the residuals, of the formulas and of their constants.

    Residuals with a pattern, such as those of a solver, count as fewer independent ones.
    """
    rows = sum(map(len, problem.runs))
    written = {s: with_floats(expr) for s, expr in found.equations.items()}
    bits = structure_in(problem.columns)(written)
    for state, expr in found.equations.items():
        own = found.verdict.states[state]
        square = own.noise**2 if problem.form.discrete else max(own.chi_square, LEAST_SQUARE)
        bits += (independent[state] or rows) / 2 * math.log2(max(square, 1e-300))
        bits += count_constants(expr) * constant_bits(rows)
    return bits


def _told(
    problem: Problem, found: Discovery, bits: Mapping[tuple[str, str], float]
) -> tuple[Discovery, OtherFormulas]:
    """Test the same answer again, with what alternatives take more once they were tried."""
    alternatives = {
        state: [
            (_formula(found, None, state, one), more)
            for one in own.alternatives
            if math.isfinite(more := bits.get((state, one.equation), one.bits))
        ]
        for state, own in found.verdict.states.items()
    }
    if not problem.form.discrete:
        return problem.with_verdict(found, alternatives), alternatives
    # What one step tells of a map is exact: what was tried and is worse is none beside it.
    beaten = {
        state: ParetoFront(c for c in own if (state, shown(tidy(c.expr), 4)) not in bits)
        for state, own in found.front.items()
    }
    verdict = problem.give_verdict(replace(found, front=beaten), None)
    return replace(found, verdict=verdict), alternatives
