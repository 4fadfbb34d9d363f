"""Drift of noisy data: formulas with the time in the place of one equation of a fitted system.

The time is one more column of the system (:class:`dynsr.selection.SystemComparison`). What may
be in the place of an equation is proposed along the fitted states, with all the rest free, and
the most probable formulas are fitted and compared in bits, as all systems are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy

from dynsr.data import Trajectory
from dynsr.expression import evaluate
from dynsr.fit import Measurements, same_form, with_floats
from dynsr.library import textbooks
from dynsr.selection import Evidence, SystemComparison, SystemFit, prune
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
        runs = [_with_inputs(run, inputs) for run in course.runs]
        data = Measurements.of(runs, inputs, sum(map(len, runs)))
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
        found = {}
        for state, expr in equations.items():
            terms = sympy.Add.make_args(expr)
            free = with_floats(sympy.Add(*(term for term in terms if term not in self._known)))
            known = (own for term, own in self._known.items() if term in terms)
            found[state] = sympy.Add(free, *known).xreplace({TIME: self._clock})
        return found

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
        own, best = now.exprs[state], now
        for expr in self._propose(state, now):
            fit = None
            if not same_form(expr, own):
                fit = self._comparison.fit_again({**now.exprs, state: expr})
            if fit is not None:
                best = min(best, prune(self._comparison, fit, state), key=self._bits)
        return best

    def _propose(self, state: str, now: SystemFit) -> list[sympy.Expr]:
        """Give the formulas that are likely to do better than the equation of a state."""
        comparison, own = self._comparison, now.exprs[state]
        names, nodes = comparison.columns, comparison.settings.proposals.nodes
        parts = {state: (1.0, own)}
        evidence = Evidence.in_place(now.fit, now.problem, parts, names, nodes, None)
        if evidence is None:
            return []
        columns = dict(zip(names, evidence.points, strict=True))
        own = own.xreplace({self._clock: TIME})
        columns.pop(self._clock.name)
        library = TermsInTime.of(state, own, columns, self.settings)
        design, slopes = library.design(columns), slopes_by_constants(own, columns)[0]
        views = [evidence.mapped(values.T).T for values in (design, slopes)]
        # What is left whatever an equation is.
        target = np.append(evidence.y, np.sqrt(evidence.beside))
        there = np.broadcast_to(evaluate(own, columns), evidence.points.shape[1])
        misses = target - np.append(evidence.mapped(there), 0.0)
        whole = [np.vstack([one, np.zeros(one.shape[1])]) for one in views]
        rows = evidence.rows
        lines = Lines(misses, target, whole[1], whole[0], rows, LEAST_SQUARE * rows)
        return [one.xreplace({TIME: self._clock}) for one in lines.propose(own, library)]

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


def _with_inputs(run: Trajectory, inputs: Mapping[str, sympy.Expr]) -> Trajectory:
    """Give a run with a column for each input that it lacks."""
    missing = {name: expr for name, expr in inputs.items() if name not in run.names}
    more = [np.broadcast_to(evaluate(expr, {"t": run.t}), len(run)) for expr in missing.values()]
    columns = np.column_stack([run.inputs, *more])
    return replace(run, inputs=columns, input_names=(*run.input_names, *missing))
