"""Turning: tables whose times run from left to right are turned, so that rows are times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile

import numpy as np

from dynsr.data.amounts import is_missing
from dynsr.data.columns import Columns
from dynsr.data.grouping import is_number, is_text, label_of
from dynsr.data.limits import Limits
from dynsr.data.name_parts import is_label_name
from dynsr.data.times import read_counted, read_times
from dynsr.data.trajectory import FEWEST_ROWS
from dynsr.errors import quoted

_BLANK = re.compile(r"|unnamed: \d+|column \d+", re.IGNORECASE)


def turn_rows(columns: Columns) -> tuple[Columns, list[str]]:
    """Turn a table around whose columns are moments; other tables stay as they are.

    Parameters
    ----------
    columns : the columns of the source.

    The names of most columns, or the cells of its first row, are then times that rise, and each of
    those columns holds numbers. One column before them names the quantity, or the run, of each row.
    Further ones name runs. Where the names are dates, or have units of time, numbers before them
    are parameters of the rows. Gives the columns and a sentence on what was done.

    >>> names = ("species", *(f"t{k}" for k in range(8)))
    >>> cells = [np.array([1.0, 2.0])] * 8
    >>> columns = Columns(names, (np.array(["prey", "cats"], dtype=object), *cells), "it")
    >>> turn_rows(columns)[0].names
    ('time', 'prey', 'cats')
    """
    named, remarks = _with_head(columns)
    own = dict(zip(named.names, named.values, strict=True))
    times, first, dated = None, 0, False
    for first, name in enumerate(named.names):
        times = _read_moments(named.names[first:]) if _is_moment(name) else None
        # What is measured stands before no moments: one look at a wide table is enough.
        if times is not None or _is_measured(name, own[name]):
            break
    if times is None:
        first = len(named.names) - sum(1 for _ in takewhile(_is_moment, reversed(named.names)))
        # Numbers may count what was measured again and again at the times of a column.
        dated = not all(map(is_number, named.names[first:]))
        times = _read_moments(named.names[first:]) if dated else None
    moments, labels = named.names[first:], named.names[:first]
    if times is None or len(moments) < FEWEST_ROWS:
        return columns, []
    given = [name for name in labels if dated and own[name].dtype.kind == "f"]
    if any(_may_be_time(name, own[name]) for name in labels if name not in given):
        return columns, []
    numbers = [values.dtype.kind == "f" for values in named.values[first:]]
    names = [name for name in labels if is_text(own[name]) or is_label_name(name)]
    if not all(numbers) or not names:
        return columns, []
    table = np.column_stack(named.values[first:])
    none = Limits.none(len(table))
    each = [named.limits.get(name, none) for name in moments]
    limits = Limits(
        *(np.column_stack([getattr(own, n) for own in each]) for n in ("below", "above"))
    )
    said = (
        f"Columns such as {moments[0]!r} and {moments[-1]!r} are times, so the table was turned: "
        f"its rows are named by {', '.join(map(repr, names))}."
    )
    notes = [said]
    if remarks:
        what = "A row" if len(remarks) == 1 else f"{len(remarks)} rows"
        was = "was" if len(remarks) == 1 else "were"
        notes.append(f"{what} with a single cell, such as {quoted(remarks[0])}, {was} skipped.")
    names += [name for name in given if np.isfinite(own[name]).any() and name not in names]
    return _turn(named, times, table, names, limits), notes


def _turn(
    columns: Columns,
    times: tuple[np.ndarray, str],
    table: np.ndarray,
    labels: Sequence[str],
    limits: Limits,
) -> Columns:
    by_name = dict(zip(columns.names, columns.values, strict=True))
    keys = [[label_of(cell) for cell in by_name[name].tolist()] for name in labels]
    t, unit = times
    alone = len(labels) == 1 and len(set(keys[0])) == len(table) and not is_label_name(labels[0])
    if alone:
        return replace(
            columns,
            names=("time", *keys[0]),
            values=(t, *table),
            units={"time": unit} if unit else {},
            inputs=(),
            time_unit=unit,
            named=True,
            limits={key: limits.select(np.array(row)) for row, key in enumerate(keys[0])},
        )
    rows = len(table)
    count = len(t)
    values = [np.repeat(by_name[name], count) for name in labels]
    values += [np.tile(t, rows), table.reshape(-1)]
    return replace(
        columns,
        names=(*labels, "time", "value"),
        values=tuple(values),
        units={"time": unit} if unit else {},
        inputs=(),
        named=True,
        limits={"value": Limits(limits.below.reshape(-1), limits.above.reshape(-1))},
    )


def _with_head(columns: Columns) -> tuple[Columns, list[str]]:
    """Take the first row for the names of the columns where it names the first one.

    Gives also the first cells of the rows that are left out since they have no more than one other.
    """
    cells = [values[0] if len(values) else None for values in columns.values]
    if columns.named or len(columns.values[0]) < 2 or not isinstance(cells[0], str):
        return columns, []
    filled = np.array([[not is_missing(cell) for cell in v[1:]] for v in columns.values[1:]])
    whole = filled.sum(axis=0) > 1
    remarks = [label_of(cell) for cell in columns.values[0][1:][~whole]]
    rest = tuple(_as_numbers(values[1:][whole]) for values in columns.values)
    names = tuple(map(label_of, cells))
    limits = {
        new: columns.limits[old].select(slice(1, None)).select(whole)
        for old, new in zip(columns.names, names, strict=True)
        if old in columns.limits
    }
    return replace(columns, names=names, values=rest, named=True, limits=limits), remarks


def _as_numbers(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind != "O":
        return values
    try:
        return np.array([np.nan if cell is None else float(cell) for cell in values])
    except (TypeError, ValueError):
        return values


def _may_be_time(name: str, values: np.ndarray) -> bool:
    """Whether a column before the moments is itself a time, so that the others are measured."""
    return _is_measured(name, values) or read_times(values, name) is not None


def _is_measured(name: str, values: np.ndarray) -> bool:
    """Whether a column holds dates, or numbers that are no labels."""
    return values.dtype.kind in "mM" or (values.dtype.kind == "f" and not is_label_name(name))


def _is_moment(name: str) -> bool:
    return any(map(str.isdigit, name)) and not _BLANK.fullmatch(name)


def _read_moments(names: Sequence[str]) -> tuple[np.ndarray, str] | None:
    """Give the times that names of columns say, and their unit; None where they do not rise."""
    cells = np.array(list(names), dtype=object)
    try:
        found: tuple[np.ndarray, str] | None = (np.array([float(n) for n in names]), "")
    except ValueError:
        counted = read_counted(cells)
        found = None
        if counted is not None and len(set(counted[1])) == 1:
            found = counted[0], counted[1][0]
        elif counted is None and (moments := read_times(cells)) is not None:
            found = moments.values, ""
    if found is None or np.any(found[0] != found[0]):
        return None
    return found if np.all(found[0][1:] > found[0][:-1]) else None
