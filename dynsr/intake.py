"""Intake: whatever the user has becomes trajectories of the same columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy

from dynsr.errors import InputError
from dynsr.expression import check_name, compile_numpy, parse
from dynsr.trajectory import Trajectory

_FEWEST_ROWS = 8
_HELD_BACK = 0.2
_FEWEST_HELD_BACK = 12


def take_trajectories(
    data: Any, inputs: Mapping[str, Any] | Sequence[str] | None = None
) -> tuple[list[Trajectory], dict[str, sympy.Expr]]:
    """Give the trajectories of the data, and the inputs that are known as expressions in ``t``.

    ``data`` is a Trajectory, a list of them, ``(t, x)`` arrays or a source of
    :func:`dynsr.tabular.read_trajectories`. ``inputs`` names columns that are inputs, or maps
    names to expressions in ``t``. Raises InputError when nothing usable is there.

    >>> runs, inputs = take_trajectories(([0.0, *range(1, 9)], np.ones((9, 1))), {"F": "sin(t)"})
    >>> runs[0].names, inputs
    (('x', 'F'), {'F': sin(t)})
    """
    named = inputs if isinstance(inputs, Mapping) else {}
    columns = [] if inputs is None or isinstance(inputs, Mapping) else list(inputs)
    runs = [_as_inputs(run, columns) for run in _read(data)]
    if not runs:
        raise InputError("there is no trajectory in the data; give at least one")
    if any(run.names != runs[0].names for run in runs):
        raise InputError("the trajectories have different columns; give all the same columns")
    short = min(runs, key=len)
    if len(short) < _FEWEST_ROWS:
        raise InputError(
            f"{len(short)} rows are too few to find equations in; "
            f"give at least {_FEWEST_ROWS} a trajectory"
        )
    drives = {check_name(name, "input"): parse(e, ["t"]) for name, e in named.items()}
    return [_with_drives(run, drives) for run in runs], drives


def _read(data: Any) -> list[Trajectory]:
    if isinstance(data, Trajectory):
        return [data]
    if isinstance(data, (list, tuple)) and data and all(isinstance(d, Trajectory) for d in data):
        return list(data)
    if isinstance(data, tuple) and len(data) == 2 and not isinstance(data[0], str):
        return [_from_arrays(*data)]
    if isinstance(data, list) and data and all(isinstance(d, tuple) for d in data):
        return [_from_arrays(*pair) for pair in data]
    from dynsr.tabular import read_trajectories

    return read_trajectories(data).trajectories


def _from_arrays(t: Any, x: Any) -> Trajectory:
    try:
        times, states = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
    except (TypeError, ValueError):
        raise InputError("t and x must be arrays of numbers; give (t, x) or a file") from None
    if states.ndim == 1:
        states = states[:, None]
    if states.ndim != 2:
        raise InputError(f"x has shape {states.shape}; rows are times, columns are states")
    names = ("x", "y", "z") if states.shape[1] <= 3 else ()
    chosen = names[: states.shape[1]] or tuple(f"x{i + 1}" for i in range(states.shape[1]))
    return Trajectory(times, states, chosen)


def _as_inputs(run: Trajectory, columns: Sequence[str]) -> Trajectory:
    """Move state columns to the inputs."""
    moved = [name for name in columns if name not in run.input_names]
    for name in moved:
        run.index(name)
    if not moved:
        return run
    kept = [name for name in run.states if name not in moved]
    if not kept:
        raise InputError("every column is an input; leave at least one state")
    x = run.x[:, [run.index(name) for name in kept]]
    extra = run.x[:, [run.index(name) for name in moved]]
    inputs = np.column_stack([run.inputs, extra])
    return Trajectory(run.t, x, tuple(kept), inputs, (*run.input_names, *moved), run.origin)


def _with_drives(run: Trajectory, drives: Mapping[str, sympy.Expr]) -> Trajectory:
    """Put the values of inputs that are expressions beside the columns."""
    new = {name: expr for name, expr in drives.items() if name not in run.input_names}
    clash = [name for name in new if name in run.states]
    if clash:
        raise InputError(f"input {clash[0]!r} is already a state; give it another name")
    if not new:
        return run
    values = compile_numpy(list(new.values()), ["t"])(run.t[None]).T
    inputs = np.column_stack([run.inputs, values])
    return Trajectory(run.t, run.x, run.states, inputs, (*run.input_names, *new), run.origin)


def split_held_back(
    runs: Sequence[Trajectory],
) -> tuple[list[Trajectory], list[Trajectory]]:
    """Hold a fifth back: whole trajectories when there are five or more, else each one's tail.

    Nothing is held back where that would leave too few rows to learn from.

    >>> t = np.arange(100.0)
    >>> training, held_back = split_held_back([Trajectory(t, t[:, None], ("x",))])
    >>> len(training[0]), len(held_back[0])
    (80, 20)
    """
    if len(runs) >= 5:
        last = max(1, round(_HELD_BACK * len(runs)))
        return list(runs[:-last]), list(runs[-last:])
    cuts = [round((1 - _HELD_BACK) * len(run)) for run in runs]
    if min(len(run) - cut for run, cut in zip(runs, cuts, strict=True)) < _FEWEST_HELD_BACK:
        return list(runs), []
    return (
        [run.select(slice(None, cut)) for run, cut in zip(runs, cuts, strict=True)],
        [run.select(slice(cut, None)) for run, cut in zip(runs, cuts, strict=True)],
    )
