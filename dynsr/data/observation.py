"""Observation: each state counts where it was measured, and is read from its curve elsewhere.

A search evaluates formulas in all states at once. Where one of them was not measured, it is for
a moment on the smooth curve through its own rows; that this is no measurement is kept with it
(:attr:`dynsr.data.Trajectory.unmeasured`), so that nothing is fitted to it and nothing counts it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynsr.data.smoothing import estimate_noise, smooth
from dynsr.data.trajectory import FEWEST_ROWS, Trajectory
from dynsr.errors import InputError


def carry(runs: Sequence[Trajectory]) -> list[Trajectory]:
    """Give runs in which a state is on its curve where it was not measured.

    The cells stay marked as unmeasured. Runs that were measured everywhere stay as they are.

    Parameters
    ----------
    runs : trajectories of the same columns.

    A state that was never measured but has a curve keeps it. Raises InputError when another one
    was measured in fewer than 8 rows of all runs together.

    >>> t = np.linspace(0.0, 6.0, 61)
    >>> x = np.sin(t)
    >>> x[20:22] = np.nan
    >>> (run,) = carry([Trajectory(t, x[:, None], ("x",))])
    >>> bool(abs(run.x[20, 0] - np.sin(t[20])) < 1e-3), bool(run.measured[20, 0])
    (True, False)
    """
    if not any(np.isnan(run.x).any() for run in runs):
        return list(runs)
    if curved := [state for state in runs[0].states if _is_a_curve(runs, state)]:
        kept = [state for state in runs[0].states if state not in curved]
        places = [runs[0].index(state) for state in kept]
        found = []
        for run, own in zip(runs, carry([run.of_states(kept) for run in runs]), strict=True):
            x = run.x.copy()
            x[:, places] = own.x
            found.append(replace(run, x=x))
        return found
    for place, state in enumerate(runs[0].states):
        count = sum(int(np.sum(run.measured[:, place])) for run in runs)
        if count < FEWEST_ROWS:
            raise InputError(
                f"state {state!r} was measured in {count} rows; give at least {FEWEST_ROWS}, or "
                "leave it out"
            )
    begun = [_with_lines(run, _usual(runs)) for run in runs]
    noise = estimate_noise(begun)
    return [
        replace(run, x=np.where(run.measured, run.x, within_limits(run, smooth(run, noise).x)))
        if run.unmeasured.size
        else run
        for run in begun
    ]


def within_limits(run: Trajectory, x: np.ndarray) -> np.ndarray:
    """Give curves with what is on the wrong side of a limit moved to it.

    Parameters
    ----------
    run : the trajectory, whose limits they are.
    x : (n, k) curves of its states.
    """
    if not run.limits:
        return x
    moved = x.copy()
    for state, own in run.limits.items():
        if state not in run.sums:
            place = run.index(state)
            moved[:, place] = own.within(x[:, place])
    return moved


def told_rows(runs: Sequence[Trajectory], state: str) -> list[np.ndarray]:
    """Give for each run the rows at which a state was measured and all others are known.

    Where that leaves next to nothing, as with states that were measured one after the other, all
    rows at which it was measured.

    Parameters
    ----------
    runs : trajectories of the same columns.
    state : the state.
    """
    told = [run.known_rows(state) for run in runs]
    return told if sum(map(len, told)) >= FEWEST_ROWS else [run.own_rows(state) for run in runs]


def at_own_rows(runs: Sequence[Trajectory], state: str, fewest: int = 1) -> list[Trajectory]:
    """Give runs at the rows of :func:`told_rows`, where all states count as measured.

    Parameters
    ----------
    runs : trajectories of the same columns, which may lack values.
    state : the state.
    fewest : runs that have fewer such rows are left out.
    """
    if not any(run.unmeasured.size for run in runs):
        return list(runs)
    none = np.empty((0, 0), dtype=bool)
    some = zip(carry(runs), told_rows(runs, state), strict=True)
    return [replace(run.select(rows), unmeasured=none) for run, rows in some if len(rows) >= fewest]


def _is_a_curve(runs: Sequence[Trajectory], state: str) -> bool:
    """Whether a state was never measured, and has a curve everywhere."""
    place = runs[0].index(state)
    return not any(run.measured[:, place].any() or np.isnan(run.x[:, place]).any() for run in runs)


def _usual(runs: Sequence[Trajectory]) -> np.ndarray:
    """(k,) mean of every state where it was measured."""
    return np.asarray(np.nanmean(np.concatenate([run.observed for run in runs]), axis=0))


def _with_lines(run: Trajectory, usual: np.ndarray) -> Trajectory:
    """Give a run with lines between measured rows; ``usual`` where there are none at all."""
    if not run.unmeasured.size:
        return run
    x = run.x.copy()
    for place, own in enumerate(run.measured.T):
        x[:, place] = np.interp(run.t, run.t[own], run.x[own, place]) if own.any() else usual[place]
    return replace(run, x=x)
