"""Settings of runs: a table of a row for each run says what was set in it, such as a layout.

One of its columns has the names of the trajectories, or of their files. Its numbers are parameters
of these.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.data.amounts import is_missing, parse_number
from dynsr.data.columns import Columns
from dynsr.data.description import Description
from dynsr.data.formats import split_sheet
from dynsr.data.grouping import is_text, label_of
from dynsr.data.name_parts import WELL, bare_name, bracketed_unit, is_label_name
from dynsr.data.names import clean_name, list_names
from dynsr.data.time_columns import find_time
from dynsr.data.times import is_time_name, unit_in_name
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError

# A file of more bytes, or a frame of more rows, is one of measurements.
_LARGEST, _MOST_ROWS = 1 << 20, 5000


@dataclass(frozen=True, eq=False)
class RunSettings:
    """What was set in each run.

    Parameters
    ----------
    label : what messages call the source.
    column : what names the runs there, in words.
    values : name of a run -> setting -> its number; NaN where the cell is empty.
    renamed : its columns of numbers -> their names in formulas.
    units : setting -> its unit, where there is one.
    left_out : its other columns, with the reason.
    """

    label: str
    column: str
    values: Mapping[str, Mapping[str, float]]
    renamed: Mapping[str, str]
    units: Mapping[str, str]
    left_out: Mapping[str, str]

    def of(self, names: Sequence[str]) -> list[Mapping[str, float]] | None:
        """Give the settings of each trajectory; None where most are not in the table.

        Parameters
        ----------
        names : those of the trajectories, or of the files that they are.

        Raises InputError that names the trajectories that have no row.
        """
        found = [self.values.get(_key(name)) for name in names]
        lacking = [name for name, own in zip(names, found, strict=True) if own is None]
        if 2 * len(lacking) > len(names):
            return None
        if lacking:
            raise InputError(
                f"{self.label} has no row of {list_names(lacking)} in {self.column}; give each run "
                "a row"
            )
        return [own for own in found if own is not None]


def find_settings(source: Any, load: Callable[[], Columns]) -> list[RunSettings]:
    """Read a source as settings of runs, once for each column that may name these.

    Parameters
    ----------
    source : a file, a frame or a mapping; large ones are not looked at.
    load : gives its columns.

    >>> table = {"well": ["A1", "A2"], "dose": [0.5, 2.0]}
    >>> (found,) = find_settings(table, lambda: Columns(("well", "dose"), (np.array(["A1", "A2"],
    ...     dtype=object), np.array([0.5, 2.0])), "layout.csv"))
    >>> found.of(["A01", "A02"])
    [{'dose': 0.5}, {'dose': 2.0}]
    """
    if not _is_small(source):
        return []
    try:
        columns = load()
    except InputError:  # said where it is read
        return []
    if _has_time(columns):
        return []
    by_name = dict(zip(columns.names, columns.values, strict=True))
    numbers = {n: v for n, v in by_name.items() if v.dtype.kind == "f" and n}
    found = []
    for name, cells in by_name.items():
        keys = [_key(label_of(cell)) for cell in cells.tolist()]
        labels = is_text(cells) or (name in numbers and is_label_name(name))
        if not columns.named or not labels or len(set(keys)) < len(keys):
            continue
        own = {clean_name(n): v for n, v in numbers.items() if n != name}
        said = {clean_name(n): columns.units.get(n) or bracketed_unit(n) for n in numbers}
        values = {
            key: {n: float(v[row]) for n, v in own.items()} for row, key in enumerate(keys) if key
        }
        others = [n for n in by_name if n != name and n not in numbers]
        called = {n: clean_name(n) for n in numbers if n != name}
        units = {n: unit for n, unit in said.items() if n in own and unit}
        out = dict.fromkeys(others, f"is text of {columns.label}, which is no number")
        found.append(RunSettings(columns.label, f"its column {name!r}", values, called, units, out))
    return found


def settings_above(columns: Columns) -> RunSettings | None:
    """Read rows above the names of the wells of a plate as settings of these; None without any.

    Parameters
    ----------
    columns : whose ``above`` has a row for each setting.
    """
    if not columns.above:
        return None
    names = [_key(name) for own in columns.above.values() for name in own]
    read = {
        label: {_key(n): _number(cell) for n, cell in own.items()}
        for label, own in columns.above.items()
    }
    numbers: dict[str, dict[str, float]] = {}
    for label, own in read.items():
        told = {n: v for n, v in own.items() if v is not None}
        if len(told) == len(own) and np.isfinite(list(told.values())).any():
            numbers[label] = told
    renamed = {label: clean_name(label) for label in numbers}
    return RunSettings(
        columns.label,
        "the wells",
        {n: {renamed[label]: own[n] for label, own in numbers.items()} for n in names},
        renamed,
        {renamed[n]: unit for n in numbers if (unit := bracketed_unit(n))},
        {n: "is text above the names, which is no number" for n in read if n not in numbers},
    )


def _number(cell: Any) -> float | None:
    """Give a cell as a number, NaN where it is empty; None for text."""
    if is_missing(cell):
        return np.nan
    if isinstance(cell, (int, float)):
        return float(cell)
    amount = parse_number(str(cell))
    values = [] if amount is None else [amount.value(mark) for mark in ".,"]
    return next((value for value in values if value is not None), None)


def apply_settings(
    runs: Sequence[Trajectory],
    description: Description,
    found: Sequence[RunSettings],
    count: int,
) -> tuple[list[Trajectory], Description] | None:
    """Give trajectories what was set in each; None where a source names other runs.

    Parameters
    ----------
    runs : the trajectories.
    description : what they were understood to be, with their names.
    found : the settings, of each column that may name them.
    count : sources of settings.

    Runs with an empty cell there, such as the blanks of a plate, are left out, with a note. Raises
    InputError where a setting is called as a column of the runs, or no run is left.
    """
    names = [run.name for run in description.trajectories]
    fits = [own for own in found if own.of(names) is not None]
    if len(fits) != count:
        return None
    for own in fits:
        given = own.of(names) or []
        values = {n: np.array([each[n] for each in given]) for n in own.renamed.values()}
        values = {n: v for n, v in values.items() if np.isfinite(v).any()}
        if clash := [n for n in values if n in runs[0].names]:
            raise InputError(
                f"column {clash[0]!r} of {own.label} is one of the runs too; rename it there"
            )
        there = np.all([np.ones(len(runs)), *map(np.isfinite, values.values())], axis=0)
        rows = np.flatnonzero(there).tolist()
        gone = [name for name, stays in zip(names, there, strict=True) if not stays]
        notes = [_say_empty(own, gone)] if gone else []
        if not rows:
            raise InputError(f"{own.label} has an empty cell in every row; fill them")
        moving = {n: v for n, v in values.items() if len(set(v[there].tolist())) > 1}
        still = dict.fromkeys(values.keys() - moving.keys(), "is the same in every run")
        notes.append(
            f"{own.label} has {', '.join(moving) or 'no number that differs'} for each run, named "
            f"by {own.column}."
        )
        units = {n: unit for n, unit in own.units.items() if n in moving}
        runs = [
            replace(
                runs[i].with_inputs({n: float(v[i]) for n, v in moving.items()}),
                origin={
                    **runs[i].origin,
                    "units": {**runs[i].origin.get("units", {}), **units},
                },
            )
            for i in rows
        ]
        sources = dict.fromkeys([*description.source.split(", "), own.label])
        description = replace(
            description,
            source=", ".join(sources),
            trajectories=tuple(description.trajectories[i] for i in rows),
            parameters=(*description.parameters, *moving),
            renamed={**description.renamed, **own.renamed},
            units={**description.units, **units},
            left_out={**description.left_out, **own.left_out, **still},
            notes=(*description.notes, *notes),
        )
        names = [names[i] for i in rows]
    return list(runs), description


def _say_empty(own: RunSettings, names: Sequence[str]) -> str:
    what = "Trajectory" if len(names) == 1 else "Trajectories"
    were = "was" if len(names) == 1 else "were"
    return f"{what} {list_names(names)} {were} left out: {own.label} has an empty cell there."


def _is_small(source: Any) -> bool:
    if isinstance(source, (str, os.PathLike)):
        path = split_sheet(Path(source))[0]
        return path.is_file() and path.stat().st_size <= _LARGEST
    if isinstance(source, Mapping):
        return all(np.size(cells) <= _MOST_ROWS for cells in source.values())
    return hasattr(source, "columns") and len(source) <= _MOST_ROWS


def _has_time(columns: Columns) -> bool:
    """Whether a column is a time by its name or its cells, and not since it rises alone."""
    try:
        found = find_time(columns, None)
    except InputError:
        return False
    called = is_time_name(bare_name(found.name)) or unit_in_name(found.name)
    return bool(called or found.counted)


def _key(name: str) -> str:
    """Give a name as it is compared: A01 is A1, and run1.csv is run1."""
    stem = re.sub(r"\.[a-z]\w{1,7}$", "", name.strip(), flags=re.IGNORECASE)
    return f"{stem[0]}{int(stem[1:])}" if WELL.fullmatch(stem) else stem.casefold()
