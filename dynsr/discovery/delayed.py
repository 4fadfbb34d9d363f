"""Delayed: equations are searched with states and inputs as they were some time before."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import sympy

from dynsr.data import Trajectory
from dynsr.discovery.options import Options, Search
from dynsr.discovery.problem import DISCOVERY
from dynsr.discovery.result import Discovery, ended_early
from dynsr.errors import InputError
from dynsr.expression import shown, skeleton
from dynsr.fit import tidy
from dynsr.jobs import Budget, finish_by
from dynsr.parameters import Delayed, DelayFit, leaves_only_noise
from dynsr.selection import ComparisonSettings
from dynsr.verdict import (
    LAW,
    NOBODY,
    NOT_FOUND,
    doubt_laws,
    explain,
    give_verdict,
    is_probable,
)

# Share of the variance of the states that equations explain with their own delayed states.
_LEAST = DISCOVERY.verdict.r2


def check_delays(
    asked: Any, runs: Sequence[Trajectory], options: Options, varied: bool = False
) -> list[float]:
    """Give the delays to search with, none for those that the data determine; raises InputError.

    Parameters
    ----------
    asked : True, one delay, or several.
    runs : the data.
    options : of the search.
    varied : whether constants may differ from run to run.
    """
    if varied:
        raise InputError(
            "delays go with constants that all trajectories share; leave vary out, or search each "
            "trajectory alone"
        )
    if options.discrete or not options.first_order:
        raise InputError("delays go with equations of first order; leave order and discrete out")
    if isinstance(asked, bool):
        return []
    given = np.atleast_1d(np.asarray(asked, dtype=float)).tolist()
    share = options.settings.delays.longest
    longest = share * min(float(np.ptp(run.t)) for run in runs)
    for delay in given:
        if not 0 < delay <= longest:
            raise InputError(
                f"a delay of {delay:g} is not between 0 and {share:.0%} of the shortest "
                f"trajectory, {longest:g}; give another, or longer trajectories"
            )
    return given


def search_delayed(
    search: Search,
    runs: Sequence[Trajectory],
    options: Options,
    asked: Sequence[float],
) -> Discovery:
    """Search equations that may contain states and inputs as they were some time before.

    Parameters
    ----------
    search : finds equations of trajectories.
    runs : the data.
    options : of the search.
    asked : delays where the fits start; none for those that the data determine.
    """
    began, details, inputs = monotonic(), options.settings, options.drives
    budget = Budget(options.time_budget)
    delayed = Delayed.of(runs, details.delays)
    comparison = details.selection.comparison
    most = len(asked) or details.delays.searched
    fits: list[DelayFit] = []

    def scan() -> None:
        for fit in delayed.candidates(comparison, asked):
            fits.append(fit)  # noqa: PERF402 (a scan that is cut leaves what it found)

    _, late = finish_by(budget.until(details.shares.searches), scan, lambda: None)
    waiting = _begin(delayed, fits, inputs, comparison)

    def begin() -> Iterator[_Begun]:
        until, any_begun = budget.until(details.shares.choices), False
        # Whether equations follow the runs is seen of one delay after the other, when it is needed.
        while first := finish_by(until, lambda: next(waiting, None), lambda: None)[0]:
            yield first
            until, any_begun = budget.until(1.0), True
        if not any_begun:
            yield from (_Begun(delay, delayed) for delay in asked)

    answers: list[Discovery] = []
    out = options.out
    # A delay that the data do not need is none: of an exponential decay any would do.
    most_bits = min((fit.bits for fit in fits), default=0.0) + details.verdict.alternative_bits
    needs_none = any(not fit.has_delay and fit.bits < most_bits for fit in fits)
    if needs_none:
        found = search(runs, replace(options, time_budget=budget.rest(2 * most + 1)))
        if found.verdict.level == LAW or not found.complete:
            return replace(found, seconds=monotonic() - began)
        answers.append(found)
    for number, first in enumerate(islice(begin(), most), start=1):
        # Each delay is searched with twice.
        own = replace(options, time_budget=budget.rest(2 * (most - number + 1)))
        if answers and budget.is_over:
            late = True
            break
        own = replace(own, out=None if out is None else Path(out) / f"delay-{number}")
        columns = first.delayed.columns(first.delay, first.delay)
        found = search(columns, replace(own, start=first.start or own.start))
        if not found.complete:
            return found
        study = _Study(delayed, search, comparison, inputs, own, fits)
        answer, cut = finish_by(
            budget.until(1.0),
            partial(study.fitted, first, found),
            partial(study.unfitted, first, found),
        )
        late |= cut
        answers.append(answer)
        if answer.verdict.level == LAW:
            break
    if not answers or not (needs_none or answers[-1].delays or budget.is_over):
        answers.append(search(runs, replace(options, time_budget=budget.rest())))
    best = min(answers, key=lambda found: found.verdict.rank)
    if late:
        said = "" if best.delays else " The time budget ended the search for delays; give more."
        best = ended_early(best, ["delays"], said)
    return replace(best, seconds=monotonic() - began)


@dataclass(frozen=True)
class _Study:
    """What the searches with several delays have in common.

    Parameters
    ----------
    delayed, search, comparison, inputs : as in :func:`search_delayed`.
    own : options of a search with one delay.
    fits : equations and delays that were compared.
    """

    delayed: Delayed
    search: Search
    comparison: ComparisonSettings
    inputs: Mapping[str, sympy.Expr]
    own: Options
    fits: Sequence[DelayFit] = ()

    def fitted(self, first: _Begun, found: Discovery) -> Discovery:
        """Give what was found with a delay after the delay was fitted with the constants."""
        comparison, short = self.comparison, first.fit
        if short is not None and _alike(short.equations, found.equations):
            found = self._doubted(found, short)
            return _with_delays(self.delayed, found, short, first.delay, self.inputs)
        fit = self.delayed.fit(found.equations, first.delay, comparison)
        if fit is not None:
            fit = self.delayed.measured(fit, comparison)
            again = replace(self.own, out=None, start=found)
            near = self.search(fit.delayed.columns(fit.delay, fit.delay), again)
            if not _alike(near.equations, fit.equations):
                other = self.delayed.fit(near.equations, fit.delay, comparison)
                fit = fit if other is None else self.delayed.measured(other, comparison)
            found = near
        # Errors of a delayed state look like further terms: a short sum may take fewer bits.
        if short is not None and (fit is None or short.bits < fit.bits):
            found, fit = _as_found(found, short, self.inputs), short
        found = found if fit is None else self._doubted(found, fit)
        return _with_delays(self.delayed, found, fit, first.delay, self.inputs)

    def _doubted(self, found: Discovery, fit: DelayFit) -> Discovery:
        """Take for no law what other equations, or another delay, explain in as few bits."""
        settings, verdict = DISCOVERY.verdict, found.verdict
        if verdict.level != LAW:
            return found
        others: dict[tuple[sympy.Expr, ...], DelayFit] = {}
        for other in sorted(self.fits, key=lambda own: own.bits):
            if other.bits - fit.bits >= settings.alternative_bits:
                break
            delays = self.delayed.delays_in(other.equations, other.delay)
            follows = other.delayed.explained(other.equations, delays, self.inputs) > _LEAST
            if follows and not _alike(other.equations, fit.equations):
                others.setdefault(tuple(map(skeleton, other.equations.values())), other)
        if is_probable([other.bits - fit.bits for other in others.values()], settings):
            return found
        closest = next(iter(others.values()))
        text = ", ".join(f"{s}' = {shown(tidy(e), 4)}" for s, e in closest.equations.items())
        with_delay = (
            f"with a delay of {closest.delay:.4g}" if closest.has_delay else "without a delay"
        )
        why = f"the data cannot distinguish it from {text} {with_delay}."
        return replace(found, verdict=doubt_laws(verdict, dict.fromkeys(verdict.states, why)))

    def unfitted(self, first: _Begun, found: Discovery) -> Discovery:
        """Give what was found with a delay that is not fitted, without a verdict."""
        if not self.delayed.delays_in(found.equations, first.delay):
            return found
        unknown = replace(found, verdict=NOBODY)
        return _with_delays(self.delayed, unknown, None, first.delay, self.inputs)


@dataclass(frozen=True, eq=False)
class _Begun:
    """A delay that is searched with: the curves, and the sum that it was fitted with."""

    delay: float
    delayed: Delayed
    fit: DelayFit | None = None

    @property
    def start(self) -> Discovery | None:
        """What a search begins with: a short sum that is a law of the data ends it."""
        return None if self.fit is None else Discovery(dict(self.fit.equations), {}, {}, {})

    def is_apart(self, others: Sequence[_Begun], far: float) -> bool:
        """Whether a fit of other delays would not move them to this one."""
        pairs = ((self.delay, other.delay) for other in others)
        return all(abs(one - other) > far * min(one, other) for one, other in pairs)


def _alike(some: Mapping[str, sympy.Expr], others: Mapping[str, sympy.Expr]) -> bool:
    """Whether equations are the same but for the values of their constants."""
    return {s: skeleton(e) for s, e in some.items()} == {s: skeleton(e) for s, e in others.items()}


def _begin(
    delayed: Delayed,
    fits: Sequence[DelayFit],
    inputs: Mapping[str, sympy.Expr],
    comparison: ComparisonSettings,
) -> Iterator[_Begun]:
    """Give delays, and the curves of sums that follow the runs with their own delayed columns.

    In an oscillation, a delay longer by a period, or a very short one, explains slopes as well.
    What takes far more bits than one that leaves nothing but noise is not given.
    """
    found: list[_Begun] = []
    most = math.inf
    for fit in sorted(fits, key=lambda fit: fit.bits):
        if fit.bits > most:
            return
        one = _Begun(fit.delay, fit.delayed, fit)
        delays = delayed.delays_in(fit.equations, fit.delay)
        if delays and one.is_apart(found, delayed.settings.far):
            if fit.delayed.explained(fit.equations, delays, inputs) > _LEAST:
                best = delayed.measured(fit, comparison)
                found.append(_Begun(best.delay, best.delayed, best))
                if leaves_only_noise(best.fit, comparison):
                    most = min(most, best.bits + comparison.behind)
                yield found[-1]


def _as_found(found: Discovery, fit: DelayFit, inputs: Mapping[str, sympy.Expr]) -> Discovery:
    """Give the equations of a fit in the place of those that were found, with their verdict."""
    runs = fit.delayed.columns(fit.delay, fit.delay)
    verdict = give_verdict(fit.equations, runs, inputs, front=found.front)
    return replace(
        found,
        equations=fit.equations,
        errors=dict.fromkeys(fit.equations, ()),
        fitted={},
        profiled={},
        trajectories=tuple(runs),
        details={},
        verdict=verdict,
        explanation=dict.fromkeys(fit.equations, ""),
    )


def _with_delays(
    delayed: Delayed,
    found: Discovery,
    fit: DelayFit | None,
    delay: float,
    inputs: Mapping[str, sympy.Expr],
) -> Discovery:
    """Give a discovery that knows its delays, with errors of constants that were fitted with it."""
    delays = delayed.delays_in(found.equations, delay, fit)
    if not delays:
        return found
    errors = dict(found.errors)
    if fit is not None:
        sizes = iter(np.sqrt(np.maximum(np.diag(fit.fit.covariance), 0.0))[:-1].tolist())
        named = fit.errors_of(found.equations, list(sizes))
        errors = {s: named.get(s, own) for s, own in errors.items()}
    verdict = found.verdict
    if verdict.tested and verdict.level != NOT_FOUND:
        explained = delayed.explained(found.equations, delays, inputs)
        if not explained > _LEAST:
            reason = (
                "integrated with its own delayed values, it does not reproduce the data "
                f"(R2 {explained:.2g})."
            )
            states = {
                s: replace(own, level=NOT_FOUND, reason=reason) for s, own in verdict.states.items()
            }
            verdict = replace(verdict, level=NOT_FOUND, reason=reason, states=states)
    said = "".join(f" {column} is {own.text}." for column, own in delays.items())
    text = {column: f"{own.state}(t - {own.value:.6g})" for column, own in delays.items()}
    return replace(
        found,
        errors=errors,
        verdict=verdict,
        delays=delays,
        explanation={
            s: (explain(s, found.equations[s], verdict.states[s]) if verdict.tested else why) + said
            for s, why in found.explanation.items()
        },
        settings={**found.settings, "delays": text},
    )
