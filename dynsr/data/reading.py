"""Reading: whatever the user has becomes trajectories of the same columns.

Files, frames, mappings and arrays become named columns; roles say which is the time, a state, an
input; checks name what is wrong and the remedy.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import sympy

from dynsr.data.columns import Columns, beside, load_columns
from dynsr.data.roles import Roles, clean_name, guess_roles
from dynsr.data.table_checks import check_rows, check_values, thin, to_numbers
from dynsr.data.trajectory import Trajectory
from dynsr.errors import DynsrWarning, InputError
from dynsr.expression import check_name, compile_numpy, parse

MAX_ROWS = 200_000


@dataclass(frozen=True, eq=False)
class Table:
    """Trajectories that were read, and a sentence on how their columns were understood."""

    trajectories: list[Trajectory]
    guess: str


def read_trajectories(
    source: Any,
    time: str | np.ndarray | None = None,
    states: Sequence[str] | str | None = None,
    inputs: Sequence[str] | Mapping[str, str] | str | None = None,
    trajectory: str | None = None,
    *,
    max_rows: int = MAX_ROWS,
) -> Table:
    """Read one or many trajectories from a table, a file of one, or a list of such sources.

    Parameters
    ----------
    source : a CSV, TSV, Parquet, .npz or .npy file; a pandas or polars frame; a mapping of
        columns; a pair of arrays (t (n,), x (n, k)); an array whose first column is the time; a
        Trajectory; or a list of any of these, one or more trajectories each.
    time : name of the time column, or the (n,) times themselves; guessed by default.
    states : names of the state columns; every other column by default. A source without
        names, such as an array, takes these names.
    inputs : columns that are known inputs, or expressions in t, such as ``"F=0.5*sin(6*t)"`` or
        ``{"F": "0.5*sin(6*t)"}``.
    trajectory : the column whose value names the trajectory that a row belongs to.
    max_rows : more rows than this are thinned evenly, with a DynsrWarning.

    Times may be uneven. Names that cannot stand in a formula are changed, with a DynsrWarning.
    Raises InputError, one line that names the value and the remedy, when the table cannot be used.

    >>> t = np.linspace(0, 1, 11)
    >>> table = read_trajectories({"t": t, "x": t**2, "y": t**3})
    >>> print(table.guess)
    the mapping: time 't', 11 rows from 0 to 1 every 0.1; states x, y
    """
    if isinstance(source, list):
        return _read_list(source, time, states, inputs, trajectory, max_rows)
    if isinstance(time, (np.ndarray, list, tuple)):
        source, time = (np.asarray(time), source), None
    columns = _with_names(load_columns(source), states)
    for note in columns.notes:
        warnings.warn(note, DynsrWarning, stacklevel=2)
    named, formulas = _split_inputs(inputs)
    roles = guess_roles(columns, time, _listed(states), named, formulas, trajectory)
    runs = _cut(columns, roles, formulas, max_rows)
    return Table(runs, f"{columns.label}: {describe(runs, roles, formulas)}")


def _read_list(sources: list[Any], *arguments: Any) -> Table:
    if not sources:
        raise InputError("no data was given; give at least one file, frame or array")
    *options, max_rows = arguments
    share = max(max_rows // len(sources), 1)
    tables = [read_trajectories(source, *options, max_rows=share) for source in sources]
    runs = [run for table in tables for run in table.trajectories]
    for run in runs[1:]:
        if run.states != runs[0].states or run.input_names != runs[0].input_names:
            raise InputError(
                f"the trajectories have different columns ({', '.join(runs[0].names)} and "
                f"{', '.join(run.names)}); give all the same columns"
            )
    return Table(runs, "; ".join(dict.fromkeys(table.guess for table in tables)))


def _listed(names: Sequence[str] | str | None) -> list[str] | None:
    if names is None:
        return None
    given = names.split(",") if isinstance(names, str) else names
    return [str(name).strip() for name in given if str(name).strip()]


def _with_names(columns: Columns, states: Sequence[str] | str | None) -> Columns:
    """Let the caller's state names name the columns of a source that has none."""
    wanted = _listed(states)
    if columns.named or not wanted or set(wanted) <= set(columns.names):
        return columns
    if len(wanted) != len(columns.names) - 1:
        raise InputError(
            f"{len(wanted)} state names ({', '.join(wanted)}) do not fit {columns.label} with "
            f"{len(columns.names) - 1} columns beside the time; give one name a column"
        )
    return replace(columns, names=("t", *wanted))


def _split_inputs(
    inputs: Sequence[str] | Mapping[str, str] | str | None,
) -> tuple[list[str] | None, dict[str, str]]:
    """Separate input columns from ``name=expression in t``; None means that inputs are guessed."""
    if inputs is None:
        return None, {}
    if isinstance(inputs, Mapping):
        return None, {clean_name(k): str(v) for k, v in inputs.items()}
    columns: list[str] = []
    formulas: dict[str, str] = {}
    for item in [inputs] if isinstance(inputs, str) and "=" in inputs else _listed(inputs) or []:
        name, equals, text = item.partition("=")
        if equals:
            formulas[clean_name(name.strip())] = text.strip()
        else:
            columns.append(name)
    return (None if formulas and not columns else columns), formulas


def _cut(
    columns: Columns, roles: Roles, formulas: Mapping[str, str], max_rows: int
) -> list[Trajectory]:
    by_name = dict(zip(columns.names, columns.values, strict=True))
    wanted = [*roles.states, *roles.inputs]
    t = to_numbers(by_name[roles.time], roles.time, columns.label, time=True)
    data = [to_numbers(by_name[name], name, columns.label) for name in wanted]
    groups = _groups(by_name.get(roles.trajectory) if roles.trajectory else None, t)
    check_rows(t, roles.time, groups, columns.label)
    check_values(data, wanted, roles, columns.label)
    table = np.column_stack(data)
    functions = compile_numpy([parse(text, ["t"]) for text in formulas.values()], ["t"])
    count, origin = len(roles.states), {"source": columns.label}
    names = [roles.renamed[name] for name in wanted]
    runs = []
    for rows in thin(groups, len(t), max_rows, columns.label):
        extra = functions(t[rows][None]).T
        inputs = np.column_stack([table[rows, count:], extra])
        _check_formulas(extra, t[rows], formulas)
        runs.append(
            Trajectory(
                t[rows],
                table[rows, :count],
                tuple(names[:count]),
                inputs,
                (*names[count:], *formulas),
                origin,
            )
        )
    return runs


def _check_formulas(values: np.ndarray, t: np.ndarray, formulas: Mapping[str, str]) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        row, column = bad[0]
        name, text = list(formulas.items())[column]
        raise InputError(
            f"input {name} = {text} is {values[row, column]} at t = {t[row]:g}; "
            "give a formula that is finite over the whole data"
        )


def _groups(labels: np.ndarray | None, t: np.ndarray) -> dict[str, np.ndarray]:
    """Rows of each trajectory, in order of appearance; one that starts again is a new one."""
    if labels is not None:
        text = np.array([str(label) for label in labels])
        _, first, inverse = np.unique(text, return_index=True, return_inverse=True)
        return {text[first[g]]: np.flatnonzero(inverse == g) for g in np.argsort(first)}
    starts = np.flatnonzero((np.diff(t) < 0) & (t[1:] == t[0])) + 1
    pieces = np.split(np.arange(len(t)), starts)
    return {str(i + 1): piece for i, piece in enumerate(pieces)}


def describe(runs: Sequence[Trajectory], roles: Roles, formulas: Mapping[str, str]) -> str:
    """Say how the columns were understood: times, states, inputs, and what is not used."""
    total = sum(len(run) for run in runs)
    many = f"{len(runs)} trajectories" + (
        f" named by {roles.trajectory!r}" if roles.trajectory else ", each starting the time again"
    )
    head = f"time {roles.time!r}, " + (f"{many}, " if len(runs) > 1 else "")
    first, last = min(run.t[0] for run in runs), max(run.t[-1] for run in runs)
    clauses = [f"{head}{total} rows from {first:g} to {last:g} {_spacing(runs)}"]
    clauses.append(f"states {', '.join(roles.renamed[name] for name in roles.states)}")
    inputs = [roles.renamed[name] for name in roles.inputs]
    inputs += [f"{name} = {text}" for name, text in formulas.items()]
    if inputs:
        clauses.append(f"inputs {', '.join(inputs)}")
    if roles.ignored:
        clauses.append(f"not used: {', '.join(map(repr, roles.ignored))}")
    return "; ".join(clauses)


def _spacing(runs: Sequence[Trajectory]) -> str:
    steps = np.concatenate([np.diff(run.t) for run in runs])
    low, high = float(steps.min()), float(steps.max())
    # Times written with few digits differ in their last one.
    if high - low <= 1e-3 * high:
        return f"every {float(np.median(steps)):.4g}"
    return f"in uneven steps of {low:.3g} to {high:.3g}"


def write_csv(
    trajectories: Trajectory | Sequence[Trajectory], path: str | os.PathLike[str]
) -> None:
    """Write t, the states and the inputs as text, to full precision.

    Parameters
    ----------
    trajectories : one or many; many get a first column ``trajectory`` that counts from 1.
    path : the file, delimited by tabs when its name ends in .tsv, else by commas.

    Raises InputError when the file cannot be written or the trajectories have different columns.
    """
    import pandas

    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    if not runs:
        raise InputError("there is no trajectory to write; give at least one")
    frames = []
    for number, run in enumerate(runs, start=1):
        if run.names != runs[0].names:
            raise InputError("the trajectories have different columns; write them to several files")
        frame = pandas.DataFrame(np.column_stack([run.t, run.columns]), columns=["t", *run.names])
        if len(runs) > 1:
            frame.insert(0, "trajectory", number)
        frames.append(frame)
    target = Path(path)
    try:
        pandas.concat(frames).to_csv(
            target, index=False, sep="\t" if target.suffix.lower() == ".tsv" else ","
        )
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot write {str(path)!r}: {reason}; choose another file") from None


_FEWEST_ROWS = 8


def take_trajectories(
    data: Any, inputs: Mapping[str, Any] | Sequence[str] | None = None
) -> tuple[list[Trajectory], dict[str, sympy.Expr]]:
    """Give the trajectories of the data, and the inputs that are known as expressions in ``t``.

    Parameters
    ----------
    data : a Trajectory, a list of them, ``(t, x)`` arrays or a list of such pairs, or a source of
        :func:`dynsr.data.reading.read_trajectories`.
    inputs : names of columns that are inputs, or input name -> expression in ``t``.

    Raises InputError when nothing usable is there.

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

    return read_trajectories(data).trajectories


def _from_arrays(t: Any, x: Any) -> Trajectory:
    table = beside(t, x)
    count = table.shape[1] - 1
    names = ("x", "y", "z")[:count] if count <= 3 else tuple(f"x{i + 1}" for i in range(count))
    return Trajectory(table[:, 0], table[:, 1:], names)


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
    runs: Sequence[Trajectory], share: float = 0.2, fewest: int = 12
) -> tuple[list[Trajectory], list[Trajectory]]:
    """Hold rows back: whole trajectories when there are enough of them, else each one's tail.

    Parameters
    ----------
    runs : the trajectories.
    share : the share of the trajectories, or of each one's rows, that is held back.
    fewest : a tail of fewer rows shows nothing, so that nothing is held back.

    >>> t = np.arange(100.0)
    >>> training, held_back = split_held_back([Trajectory(t, t[:, None], ("x",))])
    >>> len(training[0]), len(held_back[0])
    (80, 20)
    """
    if len(runs) * share >= 1:
        last = round(share * len(runs))
        return list(runs[:-last]), list(runs[-last:])
    cuts = [round((1 - share) * len(run)) for run in runs]
    if min(len(run) - cut for run, cut in zip(runs, cuts, strict=True)) < fewest:
        return list(runs), []
    return (
        [run.select(slice(None, cut)) for run, cut in zip(runs, cuts, strict=True)],
        [run.select(slice(cut, None)) for run, cut in zip(runs, cuts, strict=True)],
    )
