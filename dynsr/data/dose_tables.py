"""Dose tables: doses that are in a table of their own become a column of the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.arguments import checked
from dynsr.data.amounts import is_missing
from dynsr.data.assembling import Columns
from dynsr.data.codes import NONE
from dynsr.data.columns import load_columns
from dynsr.data.dosing import is_dose_name
from dynsr.data.grouping import find_restarts
from dynsr.data.name_parts import bare_name
from dynsr.data.names import clean_name, find_column
from dynsr.data.nonmem import find_nonmem
from dynsr.data.time_columns import Times, find_time
from dynsr.data.times import convert_times
from dynsr.errors import InputError

_STATES = ("state", "compartment", "variable", "quantity")
_FILES = ("file", "filename")


@checked
def add_doses(
    data: Any, doses: Any, time: str | None = None, trajectory: str | None = None
) -> dict[str, np.ndarray]:
    """Add doses that are in a table of their own to the data, as columns of amounts.

    Parameters
    ----------
    data : a file or frame of measurements, as :func:`dynsr.discover` takes it.
    doses : a file or frame with a row for each dose: its time, its amount, and the columns that say
        which trajectory it belongs to, such as a subject, called as in the data. Without such a
        column every trajectory gets all doses. A column ``state`` names the state of each dose.
    time : the column of times in the data; guessed by default.
    trajectory : the column that says which trajectory a row of the data belongs to.

    A measurement at the time of a dose was taken before it. A dose between two rows of the data
    gets a row of its own. Gives column -> values, to be used as data. The amounts are in a column
    of the name that they have in ``doses``, or in one for each state, such as ``amount_c``. Raises
    InputError when the tables do not fit together.

    >>> data = {"t": [0.0, 1.0, 2.0], "c": [0.0, 4.0, 3.0]}
    >>> add_doses(data, {"t": [0.0], "amount": [5.0]})["amount"].tolist()
    [5.0, 0.0, 0.0]
    """
    columns, given = load_columns(data), load_columns(doses)
    merged = _merge(columns, given, time, trajectory)
    _refuse_lost(merged.lost, given, f"{columns.label} has no row")
    return dict(zip(merged.columns.names, merged.columns.values, strict=True))


def load_with_doses(
    files: Sequence[str | Path],
    doses: str | Path,
    said: Mapping[str, str] | None = None,
    time: str | None = None,
    trajectory: str | None = None,
    decimal: str | None = None,
    *,
    others: Sequence[str | Path] = (),
) -> tuple[list[Columns], dict[str, str]]:
    """Load files with the doses of one table, as :func:`add_doses` adds them to each.

    Parameters
    ----------
    files : the measurements, at least one. Where a column ``file`` of the doses names files, each
        gets its own; else each gets the doses of the trajectories that it has.
    doses : the table of doses.
    said : state -> column of amounts, or ``column/volume``, where the caller says it.
    time, trajectory : as for :func:`add_doses`.
    decimal : as for :func:`load_columns`.
    others : further files that the column ``file`` may name.

    Gives the columns of each file, and state -> column of its amounts. Raises InputError when the
    tables do not fit together, or nothing says which state the doses go to.
    """
    given = load_columns(doses, decimal, NONE)
    column = next((n for n in given.names if bare_name(n).lower() in _FILES), None)
    named = [] if column is None else _cells(given, column)
    known = {name for file in (*files, *others) for name in _names_of(file)}
    if unknown := [name for name in named if name not in known]:
        raise InputError(f"{given.label} has doses of file {unknown[0]!r}, which is not given")
    merged = []
    for file in files:
        own = np.array([name in _names_of(file) for name in named]) if named else None
        merged.append(_merge(load_columns(file, decimal, NONE), given, time, trajectory, own))
    for one in merged if named else ():
        _refuse_lost(one.lost, given, f"{one.columns.label} has no row")
    lost = {n: words for n, words in merged[0].lost.items() if all(n in m.lost for m in merged)}
    many = len(files) > 1
    _refuse_lost(lost, given, "no file has a row" if many else f"{files[0]} has no row")
    found = dict(said or {}) or {s: name for one in merged for s, name in one.goes_to.items()}
    if not found:
        amount = merged[0].columns.names[-1]
        raise InputError(
            f"{given.label!r} does not say which state its doses go to: --dose x={amount}, or "
            f"--dose x={amount}/V with a volume V that is fitted"
        )
    return [one.columns for one in merged], found


def _names_of(file: str | Path) -> tuple[str, ...]:
    return str(file), Path(file).name, Path(file).stem


def _refuse_lost(lost: Mapping[int, str], doses: Columns, where: str) -> None:
    for words in lost.values():
        raise InputError(f"{doses.label} has doses of {words}, of which {where}")


@dataclass(frozen=True, eq=False)
class _Merged:
    """Data with the doses of a table.

    Parameters
    ----------
    columns : the data, with columns of amounts as the last.
    goes_to : state -> column of its amounts, by a column of states, or where there is one state.
    lost : row of a dose whose trajectory the data do not have -> what names that trajectory.
    """

    columns: Columns
    goes_to: Mapping[str, str]
    lost: Mapping[int, str]


def _merge(
    data: Columns,
    doses: Columns,
    time: str | None = None,
    trajectory: str | None = None,
    own: np.ndarray | None = None,
) -> _Merged:
    """Merge the columns of data and of doses, as :func:`add_doses` does.

    Parameters
    ----------
    data, doses, time, trajectory : as for :func:`add_doses`.
    own : whether each row of the doses belongs to these data; all by default.
    """
    find_nonmem(doses, doses.label)
    when = find_time(data, time)
    given = _times_of(doses, when.name, data.label)
    t, at = _in_one_unit(when, given, data.label, doses.label)
    runs, goes_to, shared, lost = _runs(data, doses, t, when, trajectory)
    amount = _amount(doses, {*given.columns, *shared})
    amounts = np.nan_to_num(doses.values[doses.names.index(amount)].astype(float))
    state = next((n for n in doses.names if bare_name(n).lower() in _STATES), None)
    of = _cells(doses, state) if state is not None else [""] * len(at)
    states = list(dict.fromkeys(of))
    for name in states:
        if name:
            find_column(name, data, f"state of a dose in {doses.label}")
    names = {name: f"{amount}_{clean_name(name)}" if name else amount for name in states}
    if clash := [name for name in names.values() if name in data.names]:
        raise InputError(
            f"column {clash[0]!r} is in {data.label} and in {doses.label}; give doses once"
        )
    # Each dose goes into the row of its time, or into a new one behind the last row before it.
    length = len(t)
    rows, made = {name: np.zeros(length) for name in names.values()}, []
    used = np.ones(len(at), dtype=bool) if own is None else own
    for dose in np.flatnonzero((amounts != 0) & used).tolist():
        for run in goes_to[dose]:
            there = np.flatnonzero(runs == run)
            same = there[t[there] == at[dose]]
            if same.size:
                rows[names[of[dose]]][same[-1]] += amounts[dose]
                continue
            before = there[t[there] < at[dose]]
            # A new row has the labels of its run, those of the row that it is next to.
            near = int(before[-1]) if before.size else int(there[0])
            made.append((near + bool(before.size), at[dose], near, dose))
    made.sort(key=lambda one: one[:2])
    places = np.array([place for place, *_ in made], dtype=int)
    values = []
    for name, column in zip(data.names, data.values, strict=True):
        if name in when.columns:
            new = [_raw(column, when, doses, given, dose, when_) for _, when_, _, dose in made]
        elif name in shared:
            new = [column[near] for *_, near, _ in made]
        else:
            new = [np.nan if column.dtype.kind == "f" else None for _ in made]
        filled = column if column.dtype.kind in "fMO" else column.astype(object)
        values.append(
            np.insert(filled, places, np.array(new, dtype=filled.dtype)) if made else filled
        )
    for name, column in rows.items():
        new = [amounts[dose] if names[of[dose]] == name else 0.0 for *_, dose in made]
        values.append(np.insert(column, places, new))
    stays = np.flatnonzero(np.insert(np.ones(length), places, 0))
    limits = {name: own.at(stays, len(values[0])) for name, own in data.limits.items()}
    found = replace(data, names=(*data.names, *rows), values=tuple(values), limits=limits)
    if states == [""]:
        labels = {*when.columns, *shared}
        pairs = zip(data.names, data.values, strict=True)
        states = [name for name, v in pairs if v.dtype.kind == "f" and name not in labels]
        names = dict.fromkeys(states, amount) if len(states) == 1 else {}
    to = {clean_name(name): column for name, column in names.items() if name}
    return _Merged(found, to, {dose: words for dose, words in lost.items() if used[dose]})


def _times_of(doses: Columns, name: str, label: str) -> Times:
    """Give the times of doses, in the column that is called as that of the data."""
    same = [own for own in doses.names if bare_name(own).lower() == bare_name(name).lower()]
    try:
        return find_time(doses, same[0] if same else None)
    except InputError:
        raise InputError(
            f"{doses.label} has no column of times (columns: {', '.join(doses.names)}); call it "
            f"{name!r}, as in {label}"
        ) from None


def _in_one_unit(
    when: Times, given: Times, label: str, other: str
) -> tuple[np.ndarray, np.ndarray]:
    """Give the times of the rows and those of the doses on one scale."""
    if when.clock or given.clock or when.daily or given.daily:
        raise InputError(f"doses need times in one column; join the date and the clock in {label}")
    if when.counted != given.counted:
        what = ("dates", "numbers") if when.counted else ("numbers", "dates")
        raise InputError(
            f"times are {what[0]} in {label} and {what[1]} in {other}; give both alike"
        )
    if when.counted:
        first = [0.0 if one.first is None else one.first[1] for one in (when, given)]
        return when.values + first[0], given.values + first[1]
    at = given.values
    if when.unit and given.unit:
        found = convert_times(given.values, given.unit, when.unit)
        if found is None:
            raise InputError(f"times are in {when.unit} in {label} and in {given.unit} in {other}")
        at = found
    return when.values, at


def _runs(
    data: Columns, doses: Columns, t: np.ndarray, when: Times, trajectory: str | None
) -> tuple[np.ndarray, list[list[int]], list[str], dict[int, str]]:
    """Give the number of the run of each row, the runs of each dose, and the columns of both.

    Also row of a dose that has no run -> what names that run.
    """
    count = len(doses.values[0])
    shared = [
        n for n in doses.names if n in data.names and n not in when.columns and _is_label(data, n)
    ]
    if trajectory is not None and not shared:
        shared = [find_column(trajectory, data, "trajectory")]
    if not shared:
        codes = find_restarts(t)
        return codes, [np.unique(codes).tolist()] * count, [], {}
    keys = list(zip(*(_cells(data, name) for name in shared), strict=True))
    number = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    codes = np.array([number[key] for key in keys])
    if shared[0] not in doses.names:
        return codes, [list(number.values())] * count, shared, {}
    wanted = list(zip(*(_cells(doses, name) for name in shared), strict=True))
    lost = {
        dose: ", ".join(f"{n} {c}" for n, c in zip(shared, key, strict=True))
        for dose, key in enumerate(wanted)
        if key not in number
    }
    return codes, [[number[key]] if key in number else [] for key in wanted], shared, lost


def _is_label(columns: Columns, name: str) -> bool:
    """Whether a column contains text or whole numbers, and so may name runs."""
    values = columns.values[columns.names.index(name)]
    return values.dtype.kind != "f" or bool(np.all(values == np.round(values)))


def _cells(columns: Columns, name: str) -> list[str]:
    """Give labels as text, whole numbers without a point."""
    values = columns.values[columns.names.index(name)]
    words = columns.words.get(name, {})
    if values.dtype.kind == "f":
        return [words.get(v, f"{v:.15g}") for v in values.tolist()]
    return ["" if is_missing(v) else str(v).strip() for v in values]


def _amount(doses: Columns, others: set[str]) -> str:
    """Give the column of amounts: the one that is called so, or the only one of numbers left."""
    left = [
        n
        for n, v in zip(doses.names, doses.values, strict=True)
        if v.dtype.kind == "f" and n not in others
    ]
    called = [name for name in left if is_dose_name(bare_name(name))]
    for found in (called, left):
        if len(found) == 1:
            return found[0]
    raise InputError(
        f"{doses.label} needs one column of amounts (columns: {', '.join(doses.names)}); call it "
        "'amount'"
    )


def _raw(
    column: np.ndarray, when: Times, doses: Columns, given: Times, dose: int, at: float
) -> Any:
    """Give the time of a dose as the data write theirs."""
    if not when.counted:
        return at
    own = doses.values[doses.names.index(given.name)]
    if own.dtype.kind != column.dtype.kind:
        raise InputError(f"the dates of {doses.label} are written otherwise than those of the data")
    return own[dose]
