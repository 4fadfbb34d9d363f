"""Last resort: where no law was found, the equations whose integration keeps closest to the data.

What slopes and bits prefer may go elsewhere when it is integrated. Then the most accurate formulas
of every front and sums of terms chosen for their integration compete by the share of the states
that they explain. Causes that were found, such as a missing state, stay in the verdict.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import sympy

from dynsr.data import FEWEST_SMOOTH, diagnose
from dynsr.discovery.adoption import adopt_better
from dynsr.discovery.problem import Problem
from dynsr.discovery.result import Discovery
from dynsr.expression import has_pole, round_constants
from dynsr.fit import FLOOR, Match, fit_along, score_candidate, untouched_match
from dynsr.selection import Approximation, MeasuredRuns, find_approximations
from dynsr.verdict import (
    APPROXIMATION,
    LAW,
    NOT_FOUND,
    Verdict,
    followed_r2,
    follows_to,
    least_r2,
    likely_cause,
    round_off,
    summarise,
)

# Systems of the most accurate formulas of every front that are integrated.
_MOST = 4
# Followers whose constants are fitted to the noisy states.
_FITTED = 2
# Digits that constants are written with, and the share of the misses that this may add.
_DIGITS, _ROUNDING = (3, 4, 6), 0.02
# Share of a column's range beyond its ends where a pole is close.
_BESIDE = 0.1
SOURCE = "sums that follow"


def follow_anyway(problem: Problem, found: Discovery) -> Discovery | None:
    """Give equations that keep closer to the data than those found; None where there are none.

    Parameters
    ----------
    problem : the data and what is given of their equations.
    found : what was found, with its verdict.
    """
    runs, verdict = problem.runs, found.verdict
    short = min(map(len, runs)) < FEWEST_SMOOTH
    if verdict.level == LAW or problem.form.discrete or problem.known or short:
        return None
    measured_runs = _measured_runs(problem, tuple(found.equations))
    whole = verdict.span >= max(np.ptp(run.t) for run in runs)
    followed = verdict.level != NOT_FOUND and (whole or _leaves_noise(problem, verdict))
    noise = {s: own.noise for s, own in verdict.states.items()}
    least = {s: least_r2(noise[s], problem.settings.verdict) for s in measured_runs.states}
    enough = float(np.mean(list(least.values())))
    if followed or _follow(measured_runs, found.equations).r2 > enough or _jumps(problem):
        return None
    best = _best(problem, found, measured_runs)
    if best is None or best.r2 <= enough:
        return None
    best = _rounded(best, measured_runs)
    match = untouched_match(best.exprs, runs, problem.inputs, problem.settings.selection.fit)
    changed = _put(problem, found, match)
    changed = adopt_better(problem, problem.with_verdict(changed, None), None)
    if verdict.level == APPROXIMATION and not whole and not _closer(changed.verdict, verdict):
        return None
    judged = _approximate(changed.verdict, measured_runs, changed.equations, least)
    return None if judged.rank > verdict.rank else replace(changed, verdict=judged)


def _leaves_noise(problem: Problem, verdict: Verdict) -> bool:
    """Whether nothing but noise is left where errors grow too far for whole runs to be followed.

    Neighbouring trajectories separate on such runs, so a closer fit to a whole run is chance.
    """
    limits = problem.settings.verdict
    return all(
        own.chi_square < limits.excess and own.r2 >= followed_r2(own.noise, limits)
        for own in verdict.states.values()
    )


def _closer(judged: Verdict, verdict: Verdict) -> bool:
    """Whether equations keep closer than others over parts as long, where no whole run is followed.

    All states count together: what one misses less, another may miss more.
    """
    own, others = (
        sum(math.log(max(1 - state.r2, FLOOR)) for state in one.states.values())
        for one in (judged, verdict)
    )
    return judged.span >= verdict.span and own < others


def _measured_runs(problem: Problem, states: tuple[str, ...]) -> MeasuredRuns:
    data = problem.measurements
    smoothed = None if data is None or len(data.runs) != len(problem.runs) else data.smoothed
    return MeasuredRuns(
        problem.runs, problem.inputs, states, smoothed, problem.settings.approximations
    )


def _jumps(problem: Problem) -> bool:
    """Whether the data are those of a map, which slopes have nothing to say of."""
    states = problem.runs[0].states
    return any(c.kind == "map" for state in states for c in diagnose(problem.runs, state))


def _best(problem: Problem, found: Discovery, measured_runs: MeasuredRuns) -> Approximation | None:
    """Give the shortest of the systems that follow the data about as well as the best."""
    given, demands = problem.form.known, problem.demands
    pool = find_approximations(measured_runs, demands, given, problem.form.explicit_time)
    pool += [_follow(measured_runs, e) for e in _accurate(found, given) if demands.keep_all(e)]
    likely = sorted(pool, key=lambda f: -f.r2)[:_FITTED]
    pool += [_follow(measured_runs, e) for e in _fit(problem, likely)]
    pool = [f for f in pool if all(problem.is_allowed(s, e) for s, e in f.exprs.items())]
    # What comes close to a pole follows one run by chance, and no other.
    pool = [f for f in pool if not _comes_close(problem, f)] or pool
    if not pool:
        return None
    most = max(f.r2 for f in pool)
    near = [f for f in pool if f.r2 >= most - measured_runs.settings.tie]
    return min(near, key=lambda f: (f.terms, -f.r2))


def _comes_close(problem: Problem, one: Approximation) -> bool:
    runs = [run.by_name for run in problem.runs]
    return any(has_pole(expr, run, _BESIDE) for expr in one.exprs.values() for run in runs)


def _accurate(found: Discovery, given: Mapping[str, sympy.Expr]) -> Iterator[dict[str, sympy.Expr]]:
    """Give the systems of the most accurate formulas, the second most accurate, and so on."""
    fronts = {s: [c.expr for c in found.front.get(s, ())][::-1] for s in found.equations}
    for place in range(min(_MOST, max(map(len, fronts.values()), default=0))):
        yield {
            s: given[s] if s in given else own[min(place, len(own) - 1)] if own else expr
            for (s, own), expr in zip(fronts.items(), found.equations.values(), strict=True)
        }


def _fit(problem: Problem, pool: list[Approximation]) -> Iterator[dict[str, sympy.Expr]]:
    """Fit the constants of systems to the noisy states."""
    data = problem.measurements
    for one in pool if data is not None else ():
        assert data is not None
        fitted = fit_along(one.exprs, data, problem.settings.selection.fit.along)
        if fitted is not None:
            yield fitted.found.exprs


def _put(problem: Problem, found: Discovery, match: Match) -> Discovery:
    """Put other equations in the place of those found, and on their fronts."""
    front, explanation = dict(found.front), dict(found.explanation)
    for state, expr in match.exprs.items():
        if state in problem.form.known:
            continue
        samples = problem.samples(state, problem.runs)
        front[state] = front[state].add(score_candidate(expr, samples, SOURCE))
        notes = explanation.get(state, "").partition("Found by ")[2].partition(".")[2]
        explanation[state] = (
            " Found by following: no law was found, and of the formulas found and many sums of "
            f"terms this one keeps closest to the data when it is integrated.{notes}"
        )
    return replace(
        found,
        equations=match.exprs,
        errors=match.errors,
        fitted=match.fitted,
        reach=match.reach,
        front=front,
        explanation=explanation,
        details={},
    )


def _follow(measured_runs: MeasuredRuns, exprs: Mapping[str, sympy.Expr]) -> Approximation:
    return Approximation(dict(exprs), float(np.mean(measured_runs.r2(exprs))))


def _rounded(one: Approximation, measured_runs: MeasuredRuns) -> Approximation:
    """Write constants with as few digits as keep to the data as closely."""
    for digits in _DIGITS:
        short = {s: round_constants(e, digits) for s, e in one.exprs.items()}
        other = _follow(measured_runs, short)
        if other.r2 >= one.r2 - _ROUNDING * (1 - one.r2):
            return other
    return one


def _approximate(
    verdict: Verdict,
    measured_runs: MeasuredRuns,
    exprs: Mapping[str, sympy.Expr],
    least: Mapping[str, float],
) -> Verdict:
    """Take what was chosen for how far it follows noisy data, and does, for an approximation.

    A fit of the starts may end elsewhere, and forms that compete by their integration alone are as
    many as the noise has shapes.
    """
    r2 = dict(zip(measured_runs.states, measured_runs.r2(exprs).tolist(), strict=True))
    states = {}
    for state, own in verdict.states.items():
        found = own
        if own.level == LAW and measured_runs.smoothed is not None:
            why = "follows the data within their noise, but its terms were chosen for that alone."
            found = replace(own, level=APPROXIMATION, reason=why)
        if own.level == NOT_FOUND and r2[state] > max(least[state], own.r2):
            why = f"{follows_to(r2[state])}, and was chosen for that."
            why = f"{why} {likely_cause(measured_runs.runs, state)}".strip()
            found = replace(own, level=APPROXIMATION, reason=why, r2=round_off(r2[state]))
        states[state] = found
    return summarise(states, verdict.span)
