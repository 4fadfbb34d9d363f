"""Doses: amounts given at a time, at which a state jumps.

A row is measured before what is given at its time. So the run goes on from there with the state
plus the amount: it is cut at every dose, and each part is a run of its own whose first row is the
last one of the part before, the amount added. No slope, fit or integration reaches over a jump.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dynsr.data.trajectory import FEWEST_ROWS, Trajectory
from dynsr.errors import DynsrWarning, InputError


def cut_at_doses(
    runs: Sequence[Trajectory], doses: Mapping[str, str] | None, fewest: int = FEWEST_ROWS
) -> list[Trajectory]:
    """Cut runs where an amount is given; the columns of amounts are no states and no inputs then.

    Parameters
    ----------
    runs : trajectories of the same columns.
    doses : state -> column of the amounts that are given to it right after each row, 0 elsewhere.
    fewest : parts of fewer rows are left out, with a DynsrWarning.

    Raises InputError when a state or a column is unknown, or no part is long enough.

    >>> t = np.arange(20.0)
    >>> given = np.where(t == 9, 5.0, 0.0)
    >>> run = Trajectory(t, np.where(t > 9, 5.0, 0.0)[:, None], ("x",), given[:, None], ("dose",))
    >>> before, after = cut_at_doses([run], {"x": "dose"})
    >>> before.names, before.t.tolist()[-1], after.t.tolist()[0], after.x.tolist()[0]
    (('x',), 9.0, 9.0, [5.0])
    """
    if doses is None:
        return list(runs)
    if not isinstance(doses, Mapping) or not doses:
        raise InputError(f'doses {doses!r} must say state -> column of amounts: {{"x": "dose"}}')
    columns, names = list(dict.fromkeys(doses.values())), runs[0].names
    states = [state for state in runs[0].states if state not in columns]
    for state, column in doses.items():
        if column not in names:
            raise InputError(f"there is no column {column!r}; the columns are: {', '.join(names)}")
        if state not in states:
            raise InputError(
                f"doses are given to a state, and {state!r} is no state; the states are: "
                f"{', '.join(states)}"
            )
    parts = [part for run in runs for part in _cut(run, doses, states)]
    kept = [part for part in parts if len(part) >= fewest]
    if not kept:
        raise InputError(
            f"there are {max(map(len, parts))} rows between doses at most; give at least {fewest}"
        )
    if len(kept) < len(parts):
        warnings.warn(
            f"{len(parts) - len(kept)} of {len(parts)} parts between doses have fewer than "
            f"{fewest} rows and are left out",
            DynsrWarning,
            stacklevel=2,
        )
    return kept


def _cut(run: Trajectory, doses: Mapping[str, str], states: Sequence[str]) -> list[Trajectory]:
    columns, given = run.by_name, np.zeros((len(run), len(states)))
    for state, column in doses.items():
        # An empty cell says that nothing was given.
        given[:, states.index(state)] += np.nan_to_num(columns[column])
    inputs = [name for name in run.input_names if name not in doses.values()]
    plain = replace(
        run.of_states(states),
        inputs=run.inputs[:, [run.input_names.index(name) for name in inputs]],
        input_names=tuple(inputs),
        hold={name: way for name, way in run.hold.items() if name in inputs},
        origin={**run.origin, "doses": dict(doses)},
    )
    # What is given at the last row is followed by none.
    at = np.flatnonzero(given[:-1].any(axis=1))
    parts = []
    for begin, end in pairwise([-1, *at.tolist(), len(run) - 1]):
        if begin < 0 and end == 0:
            continue
        part = plain.select(slice(max(begin, 0), end + 1))
        if begin >= 0:
            x = part.x.copy()
            x[0] += given[begin]
            part = replace(part, x=x)
        parts.append(part)
    return parts
