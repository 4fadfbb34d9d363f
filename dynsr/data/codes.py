"""Codes: numbers that stand for no value, such as -999, are read as empty cells."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynsr.data.assembling import Columns
from dynsr.data.name_parts import is_label_name
from dynsr.data.oddities import OddSettings
from dynsr.errors import InputError, quoted

Missing = Sequence[float] | float | str
# Numbers of nines, and of integers at the end of their range, that programs write for no value.
_NINES = re.compile(r"-99(9*|\.9+|9+\.9+)|999+(\.9+)?")
_ENDS = (-(2.0**15), -(2.0**31), 2.0**31 - 1)
# So are large powers of ten, the largest numbers of float32 and float64, and that of NetCDF.
_POWERS = frozenset(float(f"1e{power}") for power in range(20, 39))
_LARGEST = (float(np.finfo(np.float32).max), float(np.finfo(np.float64).max), 9.96921e36)
# Fewer other numbers in a column do not show where its values are.
_FEWEST = 3
NONE = "none"


def read_missing(missing: Missing | None) -> tuple[float, ...] | None:
    """Read which numbers stand for no value; None where the columns decide.

    Parameters
    ----------
    missing : numbers, or one, also as text such as "-1, -99"; "none" for no number.

    Raises InputError where it is not one of these.

    >>> read_missing("-1, -99"), read_missing(-1), read_missing("none"), read_missing(None)
    ((-1.0, -99.0), (-1.0,), (), None)
    """
    if missing is None or (isinstance(missing, str) and missing.strip().lower() == NONE):
        return None if missing is None else ()
    parts = missing.split(",") if isinstance(missing, str) else missing
    given = np.ravel(np.asarray(parts, dtype=object)).tolist()
    try:
        numbers = tuple(float(part) for part in given)
    except (TypeError, ValueError):
        numbers = ()
    if not numbers or not np.isfinite(numbers).all():
        raise InputError(
            f"missing {quoted(missing)} must be the numbers that stand for no value, such as "
            "-999, or none"
        )
    return numbers


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore")
def without_codes(columns: Columns, missing: Missing | None, guess: bool = True) -> Columns:
    """Give columns in which numbers that stand for no value are empty cells.

    Parameters
    ----------
    columns : as they were read; those that rise from row to row, as times do, and those that name
        trajectories keep their numbers.
    missing : as for :func:`read_missing`.
    guess : whether usual codes, such as -999, are searched where ``missing`` is None: a number
        that is far from all others of its column, or negative where no other is.

    >>> x = np.array([0.2, -999.0, 0.4, 0.6])
    >>> found = without_codes(Columns(("x",), (x,), "data.csv"), None)
    >>> found.values[0], found.notes
    (array([0.2, nan, 0.4, 0.6]), ('x is -999 in 1 of 4 rows and else 0.2 to 0.6: ...',))
    """
    codes = read_missing(missing)
    if codes == () or (codes is None and not guess):
        return columns
    values, seen = [], []
    for name, own in zip(columns.names, columns.values, strict=True):
        there = np.zeros(len(own), dtype=bool)
        if own.dtype.kind == "f" and not is_label_name(name) and not np.all(own[1:] > own[:-1]):
            there = _usual(own) if codes is None else np.isin(own, codes)
        if there.any():
            seen.append(_say(name, own, there))
        values.append(np.where(there, np.nan, own) if there.any() else own)
    if not seen:
        return columns
    more = f" So in {len(seen) - 1} more columns." if len(seen) > 1 else ""
    how = "" if codes is not None else '; missing="none" (--missing none) keeps such numbers'
    note = f"{seen[0]}: read as no value{how}.{more}"
    return replace(columns, values=tuple(values), notes=(*columns.notes, note))


def _say(name: str, values: np.ndarray, there: np.ndarray) -> str:
    rest = values[~there & np.isfinite(values)]
    else_ = f" and else {rest.min():.4g} to {rest.max():.4g}" if rest.size else ""
    number = float(values[there][0])
    return f"{name} is {number:.6g} in {there.sum()} of {len(values)} rows{else_}"


def _usual(values: np.ndarray) -> np.ndarray:
    """Say which rows have a usual code that is far from all other values."""
    found = np.zeros(len(values), dtype=bool)
    levels = np.unique(values[np.isfinite(values)])
    for code in {float(levels[0]), float(levels[-1])} if levels.size > _FEWEST else ():
        rest = levels[levels != code]
        gap = min(abs(code - rest[0]), abs(code - rest[-1]))
        # Amounts have no sign: a negative one is none of them, however large the others are.
        if is_code(code) and (code < 0 <= rest[0] or gap > OddSettings().spike * np.ptp(rest)):
            found |= values == code
    return found


def is_code(number: float) -> bool:
    """Whether programs write a number where there is no value.

    >>> [is_code(own) for own in (-999.0, -99.9, 9999.0, 1e30, -32768.0, 99.0, -9.0, 999999.4)]
    [True, True, True, True, True, False, False, False]
    """
    size = abs(number)
    large = size in _POWERS or any(math.isclose(size, end, rel_tol=1e-6) for end in _LARGEST)
    return large or number in _ENDS or _NINES.fullmatch(f"{number:.15g}") is not None
