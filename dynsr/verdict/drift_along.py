"""Drift of noisy data: formulas with the time in the place of one equation of a fitted system.

The time is one more column of the system (:class:`dynsr.selection.SystemComparison`). What may
be in the place of an equation is proposed along the fitted states, with all the rest free, and
the most probable formulas are fitted and compared in bits, as all systems are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy

from dynsr.data import KnownNoise, with_drives
from dynsr.expression import evaluate
from dynsr.fit import Measurements, same_form, with_floats
from dynsr.library import textbooks
from dynsr.selection import SystemComparison, SystemFit, prune
from dynsr.verdict.drift import (
    DRIFT,
    TIME,
    UNMEASURED,
    Drift,
    DriftSettings,
    Lines,
    TermsInTime,
    is_timed,
    say,
    slopes_by_constants,
)
from dynsr.verdict.following import LEAST_SQUARE, Course


@dataclass(frozen=True, eq=False)
class Along:
    """Equations along noisy trajectories, against which others are tried.

    Parameters
    ----------
    equations : state -> right-hand side.
    course : the trajectories.
    settings : which terms are tried.
    fixed : terms whose factors are known.
    exact : states without noise, whose errors are at most those of the trajectories.
    """

    equations: Mapping[str, sympy.Expr]
    course: Course
    settings: DriftSettings = DRIFT
    fixed: Collection[sympy.Expr] = ()
    exact: Collection[str] = ()

    def look(self, states: Collection[str]) -> dict[str, Drift]:
        """Give for states the formula that takes fewer bits than the equation, where one does.

        Parameters
        ----------
        states : those that are looked at.
        """
        found: dict[str, Drift] = {}
        asked, now = [state for state in self.equations if state in states], self._fitted
        # One equation that drifts is missed by all others: what they want beside it is their own.
        while asked and now is not None:
            tried = {state: self._best(state, now) for state in asked}
            better = {
                state: one for state, one in tried.items() if self._bits(one) < self._bits(now)
            }
            if not better:
                break
            first = min(better, key=lambda state: self._bits(better[state]))
            found[first] = self._say(first, better[first], now)
            asked, now = [state for state in better if state != first], better[first]
        return found

    def refit(self, equations: Mapping[str, sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give equations with the constants that fit the trajectories best, where a fit ends.

        Parameters
        ----------
        equations : state -> right-hand side.
        """
        fit = self._comparison.fit(self._open(equations))
        return dict(equations) if fit is None else self._close(fit)

    @cached_property
    def _fitted(self) -> SystemFit | None:
        return self._comparison.fit(self._open(self.equations))

    @cached_property
    def _comparison(self) -> SystemComparison:
        """The trajectories with their noise, and with the time as one more column."""
        course, inputs = self.course, {**self.course.inputs, self._clock.name: TIME}
        runs = [with_drives(run, inputs) for run in course.runs]
        # How large the noise is needs no estimate; whether it is known is for the data to say.
        sure = [
            replace(run, noise={**run.noise, **_as_known(course.states, own)})
            for run, own in zip(runs, course.noise, strict=True)
        ]
        data = Measurements.of(sure, inputs, sum(map(len, runs)))
        back = [replace(own, noise=run.noise) for own, run in zip(data.runs, runs, strict=True)]
        data = replace(data, runs=back)
        noise = [np.array(own) for own in data.deviations]
        columns = [runs[0].index(state) for state in course.states]
        for own, told in zip(noise, course.noise, strict=True):
            own[:, columns] = told
        mesh = replace(data, sums=noise).mesh(course.states)
        known = mesh.known | np.isin(mesh.states, list(self.exact))
        return SystemComparison(replace(mesh, known=known))

    @cached_property
    def _clock(self) -> sympy.Symbol:
        """The column that is the time."""
        name = UNMEASURED.name
        while name in {*self.course.runs[0].names, *self.course.inputs}:
            name += "_"
        return sympy.Symbol(name)

    def _open(self, equations: Mapping[str, sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give equations with free constants and the column in the place of the time."""
        return {
            state: with_floats(expr, self._known)
            .xreplace(self._known)
            .xreplace({TIME: self._clock})
            for state, expr in equations.items()
        }

    @cached_property
    def _known(self) -> dict[sympy.Expr, sympy.Expr]:
        """Term whose factor is known -> the same without any number that a fit would move."""
        return {
            term: term.xreplace({own: sympy.Rational(own) for own in term.atoms(sympy.Float)})
            for term in self.fixed
        }

    def _close(self, fit: SystemFit) -> dict[str, sympy.Expr]:
        back = {own: term for term, own in self._known.items()}
        return {s: e.xreplace(back).xreplace({self._clock: TIME}) for s, e in fit.exprs.items()}

    def _best(self, state: str, now: SystemFit) -> SystemFit:
        """Give the system of the fewest bits among those with another equation of a state."""
        best = now
        for expr in self._propose(state, now):
            fit = self._comparison.fit_again({**now.exprs, state: expr})
            if fit is not None:
                best = min(best, prune(self._comparison, fit, state), key=self._bits)
        return best

    def _propose(self, state: str, now: SystemFit) -> list[sympy.Expr]:
        """Give the formulas that are likely to do better than the equation of a state."""
        comparison = self._comparison
        evidence = comparison.evidence(now, {state: (1.0, now.exprs[state])})
        if evidence is None:
            return []
        columns = dict(zip(comparison.columns, evidence.points, strict=True))
        del columns[self._clock.name]
        own = now.exprs[state].xreplace({self._clock: TIME})
        library = TermsInTime.of(state, own, columns, self.settings)
        terms, slopes = library.design(columns), slopes_by_constants(own, columns)[0]
        there = np.broadcast_to(evaluate(own, columns), evidence.points.shape[1])
        # What is left whatever an equation is has a row of its own.
        target = np.append(evidence.y, np.sqrt(evidence.beside))
        given, by, design = (
            np.append(evidence.mapped(values.T).T, np.zeros((1, *values.shape[1:])), axis=0)
            for values in (there, slopes, terms)
        )
        rows = evidence.rows
        lines = Lines(target - given, target, by, design, rows, LEAST_SQUARE * rows)
        others = lines.propose(own, library)
        return [one.xreplace({TIME: self._clock}) for one in others if not same_form(one, own)]

    def _bits(self, fit: SystemFit) -> float:
        """Bits of a system, with those of what nobody measured."""
        driven = any(self._clock in expr.free_symbols for expr in fit.exprs.values())
        return fit.bits + textbooks().driven_bits * driven

    def _say(self, state: str, fit: SystemFit, now: SystemFit) -> Drift:
        expr, own = self._close(fit)[state], self.equations[state]
        times = np.concatenate([run.t for run in self.course.runs])
        gain = self._comparison.missed_bits(now.fit) - self._comparison.missed_bits(fit.fit)
        bits = self._bits(fit) - self._bits(now)
        return Drift(expr, bits, say(state, expr, own, times, gain), is_timed(expr, own))


def _as_known(states: Sequence[str], noise: np.ndarray) -> dict[str, KnownNoise]:
    """Give noise (n, k) of states as what is known of those that were measured."""
    pairs = zip(states, noise.T, strict=True)
    return {state: KnownNoise(own) for state, own in pairs if np.isfinite(own).any()}
