"""Assembling: named columns, and how they are put together from frames, mappings and arrays."""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.data.limits import Limits
from dynsr.data.name_parts import bare_name
from dynsr.data.trajectory import FEWEST_ROWS, as_floats, as_times, without_mask
from dynsr.errors import InputError, one_line, printable

# What a file may hold, unpacked. Larger ones would be thinned to MAX_ROWS anyway.
MAX_BYTES = 1 << 30
# A value with its error, such as "1.2 ± 0.1" and "1.2 (0.1)"; whole numbers in brackets may count.
_WITH_ERROR = re.compile(
    r"(?P<value>[^\u00b1]*\d[^\u00b1]*?)\s*(?:\u00b1|\+/-|\+-)\s*(?P<error>[^\u00b1]*\d[^\u00b1]*)"
    r"|(?P<mean>[-+\d.,eE]*\d)\s*\(\s*(?P<own>\d*[.,]\d+)\s*\)"
)
# Array of names in an archive -> the matrix whose columns they name.
LABELS = {"states": "x", "input_names": "inputs", "columns": "data"}


@dataclass(frozen=True, eq=False)
class Columns:
    """Named columns as they were in the source.

    Parameters
    ----------
    names : the names, in the order of the source.
    values : one array (n,) a column: float64, dates, or objects where a cell is no number.
    label : what a message calls the source.
    notes : what was noticed on reading, a sentence each.
    named : whether the names are the source's own.
    inputs : names of the columns that the source declares to be inputs.
    time_unit : what the first column is counted in where that is known to be the time.
    units : column -> its unit, where a row below the header or the cells themselves name it.
    left_out : column that was left out on reading -> the reason.
    faults : column that cannot be used as it is -> what is said when it is needed.
    twice : names that several columns of the source have, the first of which keeps its name.
    words : column -> number in it -> the word of the source that was read as it.
    limits : column -> its cells in which only a limit is known; those of no column go.
    above : what rows above the names say -> column -> cell.
    """

    names: tuple[str, ...]
    values: tuple[np.ndarray, ...]
    label: str
    notes: tuple[str, ...] = ()
    named: bool = True
    inputs: tuple[str, ...] = ()
    time_unit: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)
    twice: tuple[str, ...] = ()
    words: Mapping[str, Mapping[float, str]] = field(default_factory=dict)
    limits: Mapping[str, Limits] = field(default_factory=dict)
    above: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.values[0])

    def __post_init__(self) -> None:
        """Check that there are columns of one length, each with a name of its own."""
        # The name of a file may be any bytes; the label goes into records, pages and tables.
        object.__setattr__(self, "label", printable(self.label))
        if not self.names:
            raise InputError(f"{self.label} has no columns; it needs times and states")
        if not len(self.values[0]):
            raise InputError(f"{self.label} has no rows; it needs rows of times and states")
        kept = {name: own for name, own in self.limits.items() if name in self.names}
        object.__setattr__(self, "limits", kept)
        often = Counter(self.names)
        for name, value in zip(self.names, self.values, strict=True):
            if name and often[name] > 1:
                raise InputError(f"column name {name!r} is used twice in {self.label}; rename one")
            if len(value) != len(self.values[0]):
                raise InputError(
                    f"column {name!r} of {self.label} has {len(value)} rows but "
                    f"{self.names[0]!r} has {len(self.values[0])}; "
                    "give all columns the same length"
                )

    def only(self, names: Sequence[str]) -> Columns:
        """Give some of the columns, in the order of the source.

        Parameters
        ----------
        names : names of the source; others are left out.

        Raises InputError when none is left.
        """
        pairs = [p for p in zip(self.names, self.values, strict=True) if p[0] in names]
        return replace(
            self,
            names=tuple(name for name, _ in pairs),
            values=tuple(values for _, values in pairs),
            inputs=tuple(name for name in self.inputs if name in names),
            twice=(),  # the caller knows them by the names that they have here
        )

    def check_usable(self, names: Sequence[str]) -> None:
        """Raise InputError when one of these columns cannot be used as it is."""
        for name in names:
            if name in self.faults:
                raise InputError(f"column {name!r} of {self.label} {self.faults[name]}")


def assemble(
    names: Sequence[str],
    columns: Sequence[np.ndarray],
    label: str,
    *,
    units: Sequence[str] = (),
    notes: Sequence[str] = (),
    inputs: Sequence[str] = (),
    decimal: str | None = None,
    delimiter: str = "",
) -> Columns:
    """Put columns together: cells are read, empty columns and rows are left out, names are given.

    Parameters
    ----------
    names : one per column, "" for none; no names at all for a source without.
    columns : one array (n,) each.
    label : what messages call the source.
    units : one per column, "" for none; empty where the source has no such row.
    notes, inputs : as in :class:`Columns`.
    decimal, delimiter : as :func:`dynsr.data.cells.read_columns` takes them.

    Raises InputError when nothing is left.

    >>> columns = [np.array([0.0, 1.0]), np.array(["ON", "OFF"]), np.array(["", "-"])]
    >>> found = assemble(["t", "valve", "note"], columns, "data.csv")
    >>> found.names, found.values[1].tolist(), found.left_out
    (('t', 'valve'), [1.0, 0.0], {'note': 'has no value in any row'})
    """
    from dynsr.data.blocks import find_blocks, stack_blocks
    from dynsr.data.cells import read_columns

    _check_lengths(names, columns, label)
    blocks = find_blocks(names, columns) if names else None
    if blocks is not None:
        names, columns, units = stack_blocks(blocks, names, columns, units)
        notes = (*notes, f"{label} has {blocks.sentence}")
    called = list(names) or list(generated_names(len(columns)))
    called, columns, units = _apart(called, columns, units)
    readings = read_columns(columns, decimal, delimiter)
    there = np.any([_has_value(reading.values) for reading in readings], axis=0)
    for reading in readings:
        there = there if reading.limits is None else there | reading.limits.there
    if not there.any():
        raise InputError(f"{label} has no rows with a value; it needs rows of times and states")
    new, repeats, renamed = _distinguish(called, [reading.values for reading in readings])
    left_out: dict[str, str] = {}
    limits: dict[str, Limits] = {}
    found: list[tuple[str, np.ndarray]] = []
    told, units_of, faults, words = list(notes), {}, {}, {}
    for j, (name, reading) in enumerate(zip(new, readings, strict=True)):
        reason = reading.left_out or repeats.get(j, "")
        if reason:
            if name or reading.unit or _has_value(reading.values).any():
                left_out[name if name and j not in repeats else f"column {j + 1}"] = reason
            continue
        found.append((name, reading.values[there]))
        told += [f"column {name!r} of {label}: {note}" for note in reading.notes]
        if unit := (units[j] if j < len(units) else "") or reading.unit:
            units_of[name] = unit
        if reading.fault:
            faults[name] = reading.fault
        if reading.words:
            words[name] = reading.words
        if reading.limits is not None:
            limits[name] = reading.limits.select(there)
    for old in dict.fromkeys(old for old, _ in renamed):
        others = [repr(name) for own, name in renamed if own == old]
        often = "twice" if len(others) == 1 else f"{len(others) + 1} times"
        are = "one of them is" if len(others) == 1 else "the others are"
        told.append(
            f"column name {old!r} is used {often} in {label}; {are} called {', '.join(others)} here"
        )
    return Columns(
        tuple(name for name, _ in found),
        tuple(values for _, values in found),
        label,
        tuple(told),
        named=bool(names),
        inputs=tuple(inputs),
        units=units_of,
        left_out=left_out,
        faults=faults,
        twice=tuple(dict.fromkeys(old for old, _ in renamed)),
        words=words,
        limits=limits,
    )


def _apart(
    names: Sequence[str], columns: Sequence[np.ndarray], units: Sequence[str]
) -> tuple[list[str], list[np.ndarray], list[str]]:
    """Give the errors of cells such as "1.2 ± 0.1" and "1.2 (0.1)" a column of their own."""
    found: list[tuple[str, np.ndarray, str]] = []
    for j, (name, column) in enumerate(zip(names, columns, strict=True)):
        unit = units[j] if j < len(units) else ""
        cells = column.tolist() if column.dtype.kind == "O" else []
        pairs = [_WITH_ERROR.fullmatch(c) if isinstance(c, str) else None for c in cells]
        if 2 * sum(pair is not None for pair in pairs) <= len(column):
            found.append((name, column, unit))
            continue
        both = [
            (p["value"] or p["mean"], p["error"] or p["own"]) if p else (c, None)
            for p, c in zip(pairs, cells, strict=True)
        ]
        values, errors = (np.array(part, dtype=object) for part in zip(*both, strict=True))
        found += [(name, values, unit), (f"{bare_name(name)}_sd", errors, unit)]
    return [f[0] for f in found], [f[1] for f in found], [f[2] for f in found]


def _check_lengths(names: Sequence[str], columns: Sequence[np.ndarray], label: str) -> None:
    if not len(columns):
        raise InputError(f"{label} has no columns; it needs times and states")
    if not len(columns[0]):
        raise InputError(f"{label} has no rows; it needs rows of times and states")
    for name, column in zip(names, columns, strict=False):
        if len(column) != len(columns[0]):
            raise InputError(
                f"column {name!r} of {label} has {len(column)} rows but {names[0]!r} has "
                f"{len(columns[0])}; give all columns the same length"
            )


def _has_value(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind in "mM":
        return ~np.isnat(values)
    if values.dtype.kind == "f":
        return ~np.isnan(values)
    import pandas

    return ~np.asarray(pandas.isna(values), dtype=bool)


def _distinguish(
    names: Sequence[str], values: Sequence[np.ndarray]
) -> tuple[list[str], dict[int, str], list[tuple[str, str]]]:
    """Give each column a name of its own, and say which repeat one before and which are renamed."""
    first: dict[str, int] = {}
    told, repeats, renamed = list(names), {}, []
    for j, name in enumerate(names):
        if not name or not _has_value(values[j]).any():
            continue
        if name not in first:
            first[name] = j
        elif _equal(values[first[name]], values[j]):
            repeats[j] = f"repeats column {name!r}"
        else:
            number = 2
            while f"{name}_{number}" in (*names, *told):
                number += 1
            told[j] = f"{name}_{number}"
            renamed.append((name, told[j]))
    return told, repeats, renamed


def _equal(one: np.ndarray, other: np.ndarray) -> bool:
    floats = one.dtype.kind == other.dtype.kind == "f"
    return bool(np.array_equal(one, other, equal_nan=floats))


def check_size(path: Path, size: int) -> None:
    """Raise InputError when what a file holds, unpacked, is more than is read."""
    if size > MAX_BYTES:
        raise InputError(
            f"{path.name!r} holds {size / 2**30:.1f} GB of data, more than the "
            f"{MAX_BYTES / 2**30:.3g} GB that are read; give fewer rows or columns"
        )


def unreadable(path: Path, kind: str, error: Exception) -> InputError:
    """Give the error of a file that cannot be read: it holds objects, or it is damaged."""
    if "pickle" in str(error).lower() or "object array" in str(error).lower():
        return InputError(
            f"{path.name!r} holds Python objects, which could run code when read; "
            "save plain numbers (dtype float64) instead"
        )
    return InputError(f"{path.name!r} is damaged or not a {kind}; write it again and retry")


def load_frame(source: Any, label: str, decimal: str | None = None) -> Columns:
    """Load the columns of a frame, its index too where that has a name or is a time."""
    index: Any = getattr(source, "index", None)
    named = [name for name in getattr(index, "names", ()) if name is not None]
    if clash := [name for name in named if name in source.columns]:
        raise InputError(
            f"{clash[0]!r} is the index and a column of {label}; drop or rename one of the two"
        )
    if not named and getattr(index, "nlevels", 1) == 2 and "run" not in source.columns:
        # pandas.concat names what each row is from.
        fractions = getattr(index.get_level_values(1).dtype, "kind", "") in "fmM"
        timed = fractions and "time" not in source.columns
        named = ["run", "time"] if timed else ["run"]
        source = (source if timed else source.droplevel(1)).rename_axis(index=named)
    if not named and _is_time_index(index) and "time" not in source.columns:
        source, named = source.rename_axis(index="time"), ["time"]
    if named:
        source = source.reset_index()  # pandas: a named index is a column too
    return assemble(*_take_apart(source, label), label, decimal=decimal)


def _take_apart(source: Any, label: str) -> tuple[list[str], list[np.ndarray]]:
    """Give the names and the columns of a frame; the one place that meets errors of its library."""
    import narwhals

    pandas = sys.modules.get("pandas")
    try:
        if pandas is not None and isinstance(source, pandas.DataFrame):
            # Its columns may share a name or have one of several levels, unlike those of others.
            names = [_flat(name) for name in source.columns]
            parts = [source.iloc[:, j] for j in range(source.shape[1])]
            periods = pandas.PeriodDtype
            parts = [p.dt.to_timestamp() if isinstance(p.dtype, periods) else p for p in parts]
            found = [narwhals.from_native(part, series_only=True).to_numpy() for part in parts]
        else:
            frame = narwhals.from_native(source)
            frame = frame.collect() if isinstance(frame, narwhals.LazyFrame) else frame
            names = [str(name) for name in frame.columns]
            found = [column.to_numpy() for column in frame.iter_columns()]
    except narwhals.exceptions.DuplicateError:
        names = [str(name) for name in getattr(source, "column_names", source.columns)]
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"column name {twice!r} is used twice in {label}; rename one") from None
    except Exception as error:  # each library has its own, and a lazy frame has anything
        raise InputError(f"cannot read {label}: {one_line(error)[:120]}") from None
    return names, [_plain(column) for column in found]


def _flat(name: Any) -> str:
    """Give the name of a column, several levels of it in one."""
    return "_".join(str(n) for n in name if str(n)) if isinstance(name, tuple) else str(name)


def _is_time_index(index: Any) -> bool:
    """Whether an index of pandas holds dates, periods, durations or rising fractions."""
    dtype = getattr(index, "dtype", None)
    kind = getattr(dtype, "kind", "")
    return (
        kind in ("m", "M")
        or str(dtype).startswith("period")
        or (kind == "f" and bool(index.is_monotonic_increasing))
    )


def load_mapping(arrays: Mapping[str, Any], label: str, decimal: str | None = None) -> Columns:
    """Spread matrices over columns; an array of strings names the columns of the one before."""
    labels = {k: tuple(map(str, v)) for k, v in arrays.items() if _is_text(v) and k in LABELS}
    names: list[str] = []
    values: list[np.ndarray] = []
    arrays = upright(arrays)
    single = [k for k, v in arrays.items() if isinstance(v, np.ndarray) and v.ndim == 0]
    for key, value in arrays.items():
        if key in labels or key in single:
            continue
        if hasattr(value, "columns"):
            raise InputError(
                f"{key!r} of {label} is a data frame; give a list of frames, one for each run: "
                "list(data.values())"
            )
        try:
            array = np.asarray(without_mask(value))
        except ValueError:
            raise InputError(f"{key!r} of {label} has rows of different lengths") from None
        if array.ndim == 1:
            names.append(str(key))
            values.append(_plain(array))
        elif array.ndim == 2:
            names += _matrix_names(str(key), array, labels)
            values += [_plain(column) for column in array.T]
        elif array.ndim == 0:
            raise InputError(
                f"{key!r} of {label} is a {type(value).__name__}, not a column; "
                "give a value for each row"
            )
        else:
            raise InputError(
                f"array {key!r} of {label} has {array.ndim} dimensions; "
                "give one column (n,) or a table (n, k), one row a time"
            )
    inputs = tuple(name for name in labels.get("input_names", ()) if name)
    # Such as the step or a parameter beside the columns of an archive.
    are = "is no column" if len(single) == 1 else "are no columns"
    notes = (f"{', '.join(map(repr, single))} of {label} {are}; left out",) if single else ()
    return assemble(names, values, label, notes=notes, inputs=inputs, decimal=decimal)


def upright(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Turn matrices (k, n) next to columns (n,), as solvers write them, so that rows are times.

    Parameters
    ----------
    arrays : columns and matrices by name, arrays or lists; what is neither stays as it is.

    >>> upright({"t": [0, 1, 2], "y": [[1, 2, 3], [4, 5, 6]]})["y"]
    [[1, 4], [2, 5], [3, 6]]
    """

    def shape(value: Any) -> tuple[int, ...]:
        if isinstance(value, np.ndarray):
            return value.shape
        if not isinstance(value, list) or not value:
            return ()
        inner = {len(row) if isinstance(row, list) else 0 for row in value}
        return (len(value), *(inner - {0})) if len(inner) == 1 else ()

    shapes = {name: shape(value) for name, value in arrays.items()}
    rows = {own[0] for own in shapes.values() if len(own) == 1 and own[0] > 1}
    turned = dict(arrays)
    for name, own in shapes.items():
        if len(own) == 2 and own[0] not in rows and own[1] in rows:
            value = arrays[name]
            is_list = isinstance(value, list)
            turned[name] = [[*row] for row in zip(*value, strict=True)] if is_list else value.T
    return turned


def _matrix_names(
    key: str, matrix: np.ndarray, labels: Mapping[str, tuple[str, ...]]
) -> Sequence[str]:
    for label, named in LABELS.items():
        if key == named and len(labels.get(label, ())) == matrix.shape[1]:
            return labels[label]
    return [f"{key}{j + 1}" for j in range(matrix.shape[1])]


def _is_text(value: Any) -> bool:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    return array.ndim == 1 and array.dtype.kind in "US"


def _plain(array: np.ndarray) -> np.ndarray:
    """Give numbers, dates and durations as they are, and all else as objects."""
    array = without_mask(array)
    return np.asarray(array) if array.dtype.kind in "mMfiubc" else array.astype(object)


def beside(t: Any, x: Any) -> tuple[np.ndarray, str]:
    """Put times (n,) and states (n,) or (n, k) next to each other as one array (n, 1 + k).

    States (k, n), as solvers give them, are turned where k is not n. Gives it with the unit of the
    times, "" where they are plain numbers. Raises InputError when they are no numbers or their
    shapes do not fit.

    >>> beside([0.0, 1.0], [2.0, 3.0])[0].tolist()
    [[0.0, 2.0], [1.0, 3.0]]
    """
    t, unit = as_times(t, "t")
    x = as_floats(x, "x")
    if x.ndim == 2 and len(x) != len(t) == x.shape[1]:
        x = x.T
    if t.ndim != 1 or x.ndim not in (1, 2) or len(x) != len(t):
        raise InputError(f"t {t.shape} and x {x.shape} do not fit; give t (n,) and x (n, k)")
    return np.column_stack([t, x]), unit


def with_times(columns: Columns, t: Any) -> Columns:
    """Give columns with times that are separate as their first one, ``t``.

    Parameters
    ----------
    columns : those of a source without times.
    t : (n,) the times.

    Raises InputError when there is a column ``t`` already or the lengths differ.
    """
    if "t" in columns.names:
        raise InputError(f"{columns.label} has a column 't'; drop it, or leave time= out")
    t, unit = as_times(t, "time")
    names, values = ("t", *columns.names), (t, *columns.values)  # noqa: PD011
    return replace(columns, names=names, values=values, time_unit=unit)


def load_array(array: np.ndarray, label: str) -> Columns:
    """Load the columns of an array, the first of which is the time, or of its named fields.

    An array of fewer rows than columns whose first row is the time is turned.
    """
    if array.dtype.names:
        return load_mapping({name: array[name] for name in array.dtype.names}, label)
    if array.ndim != 2 or array.shape[1] < 2:
        raise InputError(
            f"{label} has shape {array.shape} and so no times; give them too: (t, x), time=t, or "
            "an array (n, 1 + k) whose first column they are"
        )
    columns = array if _is_turned(array) else array.T
    return assemble((), [_plain(c) for c in columns], label)


def _is_turned(array: np.ndarray) -> bool:
    """Whether the first of a few rows has the times, and the first column none."""
    rows, columns = array.shape
    if array.dtype.kind not in "iuf" or not 1 < rows < columns:
        return False
    # So few rows show no equation, whatever they are.
    none = rows < FEWEST_ROWS <= columns or not np.all(np.diff(array[:, 0]) > 0)
    return bool(none and np.all(np.diff(array[0]) > 0))


def generated_names(count: int) -> tuple[str, ...]:
    """Name the columns of a table without a header: t, then x or x1, x2, ...

    >>> generated_names(3)
    ('t', 'x1', 'x2')
    """
    return ("t", "x") if count == 2 else ("t", *(f"x{j}" for j in range(1, count)))


def names_of_states(count: int) -> tuple[str, ...]:
    """Name the states of an array that has none: x, y, z, or x1, x2, ... of more.

    >>> names_of_states(2), names_of_states(4)
    (('x', 'y'), ('x1', 'x2', 'x3', 'x4'))
    """
    return ("x", "y", "z")[:count] if count <= 3 else tuple(f"x{i + 1}" for i in range(count))
