"""Checks of a table's cells and rows: each problem is one line with the value and the remedy."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from datetime import timedelta
from typing import Any

import numpy as np

from dynsr.data.roles import Roles
from dynsr.data.trajectory import FEWEST_ROWS, as_floats
from dynsr.errors import DynsrWarning, InputError, quoted

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
        remedy = f", or say --trajectory {name} if it distinguishes trajectories" if many else ""
        raise InputError(
            f"column {name!r} of {label} has the text {quoted(values[row])} in row "
            f"{row + 1}; give a number or leave the cell empty, or leave the column out{remedy}"
        )
    return np.array(numbers, dtype=float)


def _as_number(cell: Any) -> float | None:
    try:
        return np.nan if cell is None else float(cell)
    except (TypeError, ValueError, OverflowError):
        return None


def _more(bad: np.ndarray) -> str:
    return f" and {len(bad) - 1} more" if len(bad) > 1 else ""


def check_values(
    data: Sequence[np.ndarray], names: Sequence[str], roles: Roles, label: str
) -> None:
    """Check that states are neither constant nor copies of each other.

    Parameters
    ----------
    data : one array (n,) a column, states before inputs.
    names : the names of these columns.
    roles : which of them are states.
    label : what a message calls the source.

    Raises InputError on a constant state that nobody asked for; warns with DynsrWarning on copies
    and on states of very different scale.
    """
    states = dict(zip(roles.states, data, strict=False))
    for name, values in states.items():
        if np.nanmin(values) == np.nanmax(values):
            _refuse_constant(name, float(np.nanmin(values)), roles, label)
    _warn_identical(dict(zip(names, data, strict=True)), label)
    _warn_scales(states, label)


def check_infinite(values: np.ndarray, name: str, label: str) -> None:
    """Check that numbers are finite where there are any.

    Parameters
    ----------
    values : (n,) numbers; NaN where there is none.
    name, label : what a message calls the column and its source.

    Raises InputError that names the first row which is wrong.
    """
    bad = np.flatnonzero(np.isinf(values))
    if bad.size:
        raise InputError(
            f"column {name!r} of {label} holds {values[bad[0]]} in row {bad[0] + 1}{_more(bad)}; "
            "leave such cells empty, or correct them"
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
                f"the other cannot be distinguished; leave one out",
                DynsrWarning,
                stacklevel=4,
            )


def _warn_scales(states: Mapping[str, np.ndarray], label: str) -> None:
    every = {name: float(np.nanstd(values)) for name, values in states.items()}
    scales = {name: size for name, size in every.items() if size > 0}
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


def thin(lengths: Sequence[int], max_rows: int, label: str) -> list[slice]:
    """Keep every k-th row of each trajectory when there are more than ``max_rows``, and warn.

    Parameters
    ----------
    lengths : the rows of each trajectory.
    max_rows : the most of them together.
    label : what a message calls the source.
    """
    total = sum(lengths)
    if total <= max_rows:
        return [slice(None)] * len(lengths)
    stride = -(-total // max_rows)
    warnings.warn(
        f"{label} has {total} rows; every {stride}th was kept "
        f"(give a shorter piece of it, such as its first {max_rows} rows, to keep the fine steps)",
        DynsrWarning,
        stacklevel=4,
    )
    return [slice(None, None, stride if rows >= FEWEST_ROWS * stride else 1) for rows in lengths]
