"""Trajectories from tables: which column is the time, a state, an input; checked in plain words."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.columns import Columns
from dynsr.errors import DynsrWarning, InputError
from dynsr.expression import compile_numpy, parse
from dynsr.roles import Roles, clean_name, guess_roles
from dynsr.sources import load_columns
from dynsr.table_checks import check_rows, check_values, thin, to_numbers
from dynsr.trajectory import Trajectory

MAX_ROWS = 200_000


@dataclass(frozen=True, eq=False)
class Table:
    """Trajectories that were read, and in words how their columns were understood."""

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
    states : names of the state columns; every column left over by default. A source without
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
    parts = _cut(columns, roles, formulas, max_rows)
    return Table(parts, f"{columns.label}: {describe(parts, roles, formulas)}")


def _read_list(sources: list[Any], *arguments: Any) -> Table:
    if not sources:
        raise InputError("no data was given; give at least one file, frame or array")
    *options, max_rows = arguments
    share = max(max_rows // len(sources), 1)
    tables = [read_trajectories(source, *options, max_rows=share) for source in sources]
    parts = [part for table in tables for part in table.trajectories]
    for part in parts[1:]:
        if part.states != parts[0].states or part.input_names != parts[0].input_names:
            raise InputError(
                f"the trajectories have different columns ({', '.join(parts[0].names)} and "
                f"{', '.join(part.names)}); give all the same columns"
            )
    return Table(parts, "; ".join(dict.fromkeys(table.guess for table in tables)))


def _listed(names: Sequence[str] | str | None) -> list[str] | None:
    if names is None:
        return None
    parts = names.split(",") if isinstance(names, str) else names
    return [str(part).strip() for part in parts if str(part).strip()]


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
    """Tell input columns from ``name=expression in t``; None means that inputs are guessed."""
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
    parts = []
    for rows in thin(groups, len(t), max_rows, columns.label):
        extra = functions(t[rows][None]).T
        inputs = np.column_stack([table[rows, count:], extra])
        _check_formulas(extra, t[rows], formulas)
        parts.append(
            Trajectory(
                t[rows],
                table[rows, :count],
                tuple(names[:count]),
                inputs,
                (*names[count:], *formulas),
                origin,
            )
        )
    return parts


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


def describe(parts: Sequence[Trajectory], roles: Roles, formulas: Mapping[str, str]) -> str:
    """Say in words how the columns were understood."""
    total = sum(len(part) for part in parts)
    many = f"{len(parts)} trajectories" + (
        f" named by {roles.trajectory!r}" if roles.trajectory else ", each starting the time again"
    )
    head = f"time {roles.time!r}, " + (f"{many}, " if len(parts) > 1 else "")
    first, last = min(part.t[0] for part in parts), max(part.t[-1] for part in parts)
    words = [f"{head}{total} rows from {first:g} to {last:g} {_spacing(parts)}"]
    words.append(f"states {', '.join(roles.renamed[name] for name in roles.states)}")
    inputs = [roles.renamed[name] for name in roles.inputs]
    inputs += [f"{name} = {text}" for name, text in formulas.items()]
    if inputs:
        words.append(f"inputs {', '.join(inputs)}")
    if roles.ignored:
        words.append(f"not used: {', '.join(map(repr, roles.ignored))}")
    return "; ".join(words)


def _spacing(parts: Sequence[Trajectory]) -> str:
    steps = np.concatenate([np.diff(part.t) for part in parts])
    low, high = float(steps.min()), float(steps.max())
    # Times written with few digits differ in their last one.
    if high - low <= 1e-3 * high:
        return f"every {float(np.median(steps)):.4g}"
    return f"in uneven steps of {low:.3g} to {high:.3g}"


def write_csv(
    trajectories: Trajectory | Sequence[Trajectory], path: str | os.PathLike[str]
) -> None:
    """Write t, the states and the inputs as CSV (TSV when the name ends so), to full precision.

    Many trajectories get a first column ``trajectory`` that counts from 1. Raises InputError when
    the file cannot be written or the trajectories have different columns.
    """
    import pandas

    parts = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    if not parts:
        raise InputError("there is no trajectory to write; give at least one")
    frames = []
    for number, part in enumerate(parts, start=1):
        if part.names != parts[0].names:
            raise InputError("the trajectories have different columns; write them to several files")
        frame = pandas.DataFrame(
            np.column_stack([part.t, part.columns]), columns=["t", *part.names]
        )
        if len(parts) > 1:
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
