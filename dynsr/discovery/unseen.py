"""Unseen steps: intervals in which an input steps between two rows do not count in a search.

Where the rows next to the steps show it, runs are cut before the search
(:func:`dynsr.data.find_unseen_steps`). Where only whole runs show it, their search ends with
equations whose residuals are not noise. These are fitted to runs that are cut at all steps, and if
far less is left of the residuals there, a law is searched in the cut runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from warnings import warn

import numpy as np
import sympy
from scipy.special import fdtrc

from dynsr.data import (
    Trajectory,
    UnseenSteps,
    UnseenStepSettings,
    check_hold,
    cut_at_unseen_steps,
    find_steps,
    find_unseen_steps,
)
from dynsr.discovery.options import Options, Search
from dynsr.discovery.result import Discovery, keep_if_asked, with_words
from dynsr.errors import DynsrWarning
from dynsr.fit import Measurements, fit_along, loosen_all
from dynsr.jobs import Budget
from dynsr.verdict import LAW


@dataclass(frozen=True, eq=False)
class Stepped:
    """Runs, and what is known of the steps of their inputs.

    Parameters
    ----------
    runs : the trajectories to search in.
    whole : the trajectories as they were measured.
    steps : the steps that lie between rows; None where none is seen.
    cut : whether ``runs`` are cut at them.
    stay : whether runs have to stay whole.
    """

    runs: Sequence[Trajectory]
    whole: Sequence[Trajectory]
    steps: UnseenSteps | None = None
    cut: bool = False
    stay: bool = False

    def say(self, found: Discovery) -> Discovery:
        """Give a discovery whose record and explanation have the steps, and warn of them.

        What bends between rows because of a delay of the input is no such step.
        """
        delayed = {delay.state for delay in found.delays.values()}
        if self.steps is None or delayed & {*self.steps.inputs}:
            return found
        said = self._words(self.steps)
        warn(said, DynsrWarning, stacklevel=2)
        record = {
            "inputs": list(self.steps.inputs),
            "intervals": self.steps.count,
            "times": self._times(self.steps),
            "cut": self.cut,
        }
        return with_words(found, f" {said}", unseen_steps=record)

    def _times(self, steps: UnseenSteps) -> list[list[float]]:
        """Give the times of the rows before and after each step, run by run."""
        pairs = zip(self.whole, steps.rows, strict=True)
        return [run.t[row : row + 2].tolist() for run, rows in pairs for row in rows]

    def _words(self, steps: UnseenSteps) -> str:
        begin, end = self._times(steps)[0]
        names, one = " and ".join(steps.inputs), len(steps.inputs) == 1
        where = f"{names} step{'s' * one} between rows, such as from t = {begin:g} to {end:g}."
        does = (
            f"The {steps.count} intervals with a step do not count, because the time of the step "
            "is unknown"
            if self.cut
            else "The equations take the value of the table there, which leaves residuals"
        )
        return (
            f"{where} {does}. Measure more often around the steps, or give the input as it was "
            "applied."
        )


def take_steps(runs: Sequence[Trajectory], asked: Options, whole: bool) -> Stepped:
    """Cut runs where the rows next to steps show that inputs step between rows.

    Parameters
    ----------
    runs : the trajectories.
    asked : options of the search.
    whole : whether runs have to stay whole.
    """
    if asked.discrete:
        return Stepped(runs, runs, stay=True)
    drives = asked.drives
    said = check_hold(asked.hold, [n for n in runs[0].input_names if n not in drives])
    lines = [name for name, way in said.items() if way == "linear"]
    steps = find_unseen_steps(runs, [*drives, *lines])
    # The user's own slopes, and doses of an unknown volume, are those of whole runs.
    whole = whole or asked.says("slopes") or any("dosing" in run.origin for run in runs)
    parts = None if steps is None or whole else cut_at_unseen_steps(runs, steps)
    return Stepped(parts or runs, runs, steps, parts is not None, whole)


def search_stepped(search: Search, stepped: Stepped, asked: Options) -> tuple[Discovery, Stepped]:
    """Search, and search again in runs cut at all steps where these alone may hide a law.

    Parameters
    ----------
    search : takes trajectories and options.
    stepped : what :func:`take_steps` gave.
    asked : options of the search.

    Gives what was found, and the runs that it was found in.
    """
    budget, drives = Budget(asked.time_budget), asked.drives
    runs, found = stepped.runs, search(stepped.runs, asked)
    judged = found.complete and found.verdict.tested
    if stepped.stay or stepped.steps or not judged or found.verdict.level == LAW:
        return found, stepped
    steps = find_steps(runs, drives)
    parts = None if steps is None else cut_at_unseen_steps(runs, steps)
    if steps is None or parts is None or not _hide(found, runs, steps, drives):
        return found, stepped
    if budget.is_over:
        return found, stepped
    again = search(parts, replace(asked, out=None, time_budget=budget.rest()))
    if again.verdict.level != LAW:
        return found, stepped
    keep_if_asked(again, asked.out)
    return again, Stepped(parts, runs, steps, cut=True)


def _hide(
    found: Discovery,
    runs: Sequence[Trajectory],
    steps: UnseenSteps,
    drives: Mapping[str, sympy.Expr],
) -> bool:
    """Whether equations leave far less of the residuals where states begin again at the steps.

    So many starts more take squares away by chance, and from wrong equations anywhere: in the
    middle between two steps they must take less.
    """
    count = len(found.equations)
    if set(found.equations) != set(runs[0].states):
        return False
    middles = [
        np.unique(np.append(0, rows[:-1]) + np.diff(rows, prepend=0) // 2) for rows in steps.rows
    ]
    exprs = loosen_all(found.equations)
    at_steps, elsewhere = (
        _gain(exprs, runs, replace(steps, rows=tuple(rows)), drives)
        for rows in (steps.rows, middles)
    )
    if at_steps is None or (elsewhere is not None and elsewhere[0] > at_steps[0]):
        return False
    gain, rows = at_steps
    starts = steps.count * count
    chance = float(fdtrc(starts, max(rows - starts, 1), gain / starts))
    return chance < UnseenStepSettings().chance


def _gain(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    steps: UnseenSteps,
    drives: Mapping[str, sympy.Expr],
) -> tuple[float, int] | None:
    """Give the squares that starts after steps take away, in units of the rest, and all rows."""
    parts = cut_at_unseen_steps(runs, steps)
    if parts is None:
        return None
    squares = []
    for some in (runs, parts):
        # All rows are fitted, so that both fits have the same ones.
        fit = fit_along(exprs, Measurements.of(some, drives, sum(map(len, some))))
        if fit is None:
            return None
        mesh = fit.problem.mesh
        missed = fit.found.misses / np.where(mesh.weights > 0, mesh.weights, np.inf)
        squares.append(missed[mesh.measured] ** 2)
    whole, cut = squares
    flags = [np.zeros(len(run), dtype=bool) for run in runs]
    for own, places in zip(flags, steps.parts(runs), strict=True):
        for rows in places:
            own[rows] = True
    kept = np.concatenate(flags)
    if len(whole) != len(kept) or len(cut) != np.sum(kept):
        return None
    rest = np.maximum(np.mean(cut, axis=0), 1e-300)
    return float(np.sum((whole[kept] - cut) / rest)), cut.size
