"""Checks of a table's cells and rows: each problem is one line with the value and the remedy."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from datetime import timedelta
from typing import Any

import numpy as np

from dynsr.data.roles import Roles
from dynsr.data.times import count_times, read_compact_dates, read_times, unit_in_name
from dynsr.data.trajectory import as_floats
from dynsr.errors import DynsrWarning, InputError

MIN_ROWS = 10
_MIN_ROWS_EACH = 5
_SCALE_RATIO = 1e6


def to_numbers(values: np.ndarray, name: str, label: str) -> np.ndarray:
    """Give a column as float64.

    Parameters
    ----------
    values : (n,) cells.
    name, label : what a message calls the column and its source.

    Raises InputError that names the first cell which is no number.
    """
    if values.dtype.kind == "f":
        return values
    if values.dtype.kind == "M":
        raise InputError(f"column {name!r} of {label} holds dates; only the time may be a date")
    if values.dtype.kind == "m" or all(isinstance(cell, timedelta) for cell in values):
        return as_floats(values, f"column {name!r} of {label}")
    numbers = [_as_number(cell) for cell in values]
    if None in numbers:
        row = numbers.index(None)
        many = len(set(map(str, values))) < len(values) and all(n is None for n in numbers)
        remedy = f", or say --trajectory {name} if it tells trajectories apart" if many else ""
        raise InputError(
            f"column {name!r} of {label} holds the text {str(values[row])[:40]!r} in row "
            f"{row + 1}; give numbers, or leave the column out{remedy}"
        )
    return np.array(numbers, dtype=float)


def to_times(values: np.ndarray, name: str, label: str) -> tuple[np.ndarray, str]:
    """Give the column of the times as float64 with its unit, "" where nothing says it.

    Parameters
    ----------
    values : (n,) cells: numbers, dates or durations.
    name, label : what a message calls the column and its source; the name may say the unit.

    Raises InputError that names the first cell which is no time.
    """
    numbers = values.dtype.kind == "f" or (
        values.dtype.kind == "O" and _as_number(values[0]) is not None
    )
    if numbers:
        dates = read_compact_dates(to_numbers(values, name, label), name)
    else:
        dates = read_times(values)
    if dates is not None:
        return count_times(dates)
    if values.dtype.kind == "O" and not numbers:
        raise InputError(
            f"time {name!r} of {label} holds {str(values[0])[:40]!r} in row 1; give numbers, or "
            "dates such as 2024-12-31"
        )
    return to_numbers(values, name, label), unit_in_name(name)


def _as_number(cell: Any) -> float | None:
    try:
        return np.nan if cell is None else float(cell)
    except (TypeError, ValueError, OverflowError):
        return None


def check_rows(t: np.ndarray, time: str, groups: Mapping[str, np.ndarray], label: str) -> None:
    """Check that each trajectory has rows enough and times that increase.

    Parameters
    ----------
    t : (n,) times.
    time, label : what a message calls the column and its source.
    groups : trajectory -> its rows.

    Raises InputError that names the first row which is wrong.
    """
    if len(t) < MIN_ROWS:
        raise InputError(
            f"{label} has {len(t)} row{'s' * (len(t) != 1)}, which cannot show an equation; "
            f"give at least {MIN_ROWS}"
        )
    bad = np.flatnonzero(~np.isfinite(t))
    if bad.size:
        raise InputError(
            f"time {time!r} of {label} is {t[bad[0]]} in row {bad[0] + 1}{_more(bad)}; "
            "remove or repair such rows"
        )
    for name, rows in groups.items():
        where = f" of trajectory {name}" if len(groups) > 1 else ""
        if len(rows) < _MIN_ROWS_EACH:
            raise InputError(
                f"trajectory {name} of {label} has {len(rows)} rows; "
                f"give each at least {_MIN_ROWS_EACH}, or leave it out"
            )
        _check_order(t, rows, f"time {time!r}{where}", label)


def _check_order(t: np.ndarray, rows: np.ndarray, what: str, label: str) -> None:
    steps = np.diff(t[rows])
    bad = np.flatnonzero(steps <= 0)
    if not bad.size:
        return
    here, row = t[rows[bad[0]]], rows[bad[0] + 1]
    if steps[bad[0]] == 0:
        raise InputError(
            f"{what} repeats in row {row + 1} of {label} ({here:g} twice){_more(bad)}; "
            "keep one row a time, or name the column that tells trajectories apart (--trajectory)"
        )
    raise InputError(
        f"{what} runs backwards at row {row + 1} of {label} ({here:g} then {t[row]:g})"
        f"{_more(bad)}; sort the rows by time"
    )


def _more(bad: np.ndarray) -> str:
    return f" and {len(bad) - 1} more" if len(bad) > 1 else ""


def check_values(
    data: Sequence[np.ndarray], names: Sequence[str], roles: Roles, label: str
) -> None:
    """Check that values are finite, and states neither constant nor copies of each other.

    Parameters
    ----------
    data : one array (n,) a column, states before inputs.
    names : the names of these columns.
    roles : which of them are states.
    label : what a message calls the source.

    Raises InputError on values that are not finite and on a constant state that nobody asked for;
    warns with DynsrWarning on copies and on states of very different scale.
    """
    for name, values in zip(names, data, strict=True):
        _check_finite(values, name, label)
    states = dict(zip(roles.states, data, strict=False))
    for name, values in states.items():
        if values.min() == values.max():
            _refuse_constant(name, values[0], roles, label)
    _warn_identical(dict(zip(names, data, strict=True)), label)
    _warn_scales(states, label)


def _check_finite(values: np.ndarray, name: str, label: str) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if not bad.size:
        return
    if np.isnan(values[bad[0]]):
        breaks = np.flatnonzero(np.diff(bad) > 1)
        end = bad[breaks[0]] if breaks.size else bad[-1]
        run = f"row {bad[0] + 1}" if end == bad[0] else f"rows {bad[0] + 1} to {end + 1}"
        raise InputError(
            f"column {name!r} of {label} has no value (NaN) in {run} ({bad.size} in all); "
            "fill them, remove those rows, or split the data there into trajectories"
        )
    raise InputError(
        f"column {name!r} of {label} holds {values[bad[0]]} in row {bad[0] + 1}{_more(bad)}; "
        "remove or repair such rows"
    )


def _refuse_constant(name: str, value: float, roles: Roles, label: str) -> None:
    if roles.chosen:
        warnings.warn(
            f"state {name!r} of {label} is {value:g} in every row, so its equation can only be 0",
            DynsrWarning,
            stacklevel=4,
        )
        return
    others = ",".join(other for other in roles.states if other != name) or "..."
    raise InputError(
        f"column {name!r} of {label} is {value:g} in every row, so it has no equation to find; "
        f"leave it out (--states {others}) or make it an input (--inputs {name})"
    )


def _warn_identical(columns: Mapping[str, np.ndarray], label: str) -> None:
    seen: dict[bytes, str] = {}
    for name, values in columns.items():
        first = seen.setdefault(values.tobytes(), name)
        if first != name:
            warnings.warn(
                f"columns {first!r} and {name!r} of {label} are identical, so formulas in one or "
                f"the other cannot be told apart; leave one out",
                DynsrWarning,
                stacklevel=4,
            )


def _warn_scales(states: Mapping[str, np.ndarray], label: str) -> None:
    scales = {name: float(np.std(values)) for name, values in states.items() if np.std(values) > 0}
    if not scales:
        return
    low, high = min(scales, key=lambda n: scales[n]), max(scales, key=lambda n: scales[n])
    if scales[high] > _SCALE_RATIO * scales[low]:
        warnings.warn(
            f"states {low!r} and {high!r} of {label} vary by {scales[low]:.1g} and "
            f"{scales[high]:.1g}; choose units that bring them closer",
            DynsrWarning,
            stacklevel=4,
        )


def thin(
    groups: Mapping[str, np.ndarray], total: int, max_rows: int, label: str
) -> list[np.ndarray]:
    """Keep every k-th row of each trajectory when there are more than ``max_rows``, and warn."""
    if total <= max_rows:
        return list(groups.values())
    stride = -(-total // max_rows)
    warnings.warn(
        f"{label} has {total} rows; every {stride}th was kept "
        f"(give a shorter piece of it, such as its first {max_rows} rows, to keep the fine steps)",
        DynsrWarning,
        stacklevel=4,
    )
    return [rows[::stride] if len(rows) >= 5 * stride else rows for rows in groups.values()]
