"""Times: dates and durations counted in a unit of the size of their steps, and what a name says."""

from __future__ import annotations

import re
from datetime import date, datetime, timedelta
from typing import Any

import numpy as np

_YEAR = 365.25 * 86400.0
# Unit -> its seconds; the longest that the usual step is not shorter than is taken.
_SECONDS = {"years": _YEAR, "days": 86400.0, "h": 3600.0, "min": 60.0, "s": 1.0}
# A year has 365 days or 366.
_SLACK = 0.999
_WORDS = {
    "ns": "ns|nanosec(ond)?s?",
    "µs": "us|µs|μs|microsec(ond)?s?",
    "ms": "ms|msecs?|millisec(ond)?s?",
    "s": "s|secs?|seconds?|sekunden?",
    "min": "mins?|minutes?|minuten?",
    "h": "h|hrs?|hours?|stunden?",
    "days": "d|days?|tage?",
    "weeks": "wk|weeks?|wochen?",
    "months": "months?|monate?",
    "years": "y|yrs?|years?|jahre?",
}
# Such as "t [s]", "time (days)", "time_ms", "hours".
_OF_NAME = re.compile(
    r"(?:(?:t|times?|elapsed)\W*_?)?[\s\[(]*(?P<unit>[^\W\d_]+)[\])\s]*", re.IGNORECASE
)
_SHORTEST = 3
_DATES = re.compile(r"date|day|datum|tag|yyyymmdd|timestamp|time", re.IGNORECASE)
# Written otherwise than ISO 8601; taken where one of them alone reads every cell.
_FORMATS = ("%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y")
_CLOCKS = ("", " %H:%M", " %H:%M:%S")
_DURATION = re.compile(r"-?(\d+ days?,? )?-?\d+:\d\d(:\d\d(\.\d*)?)?|\d+ days?")


def count_times(values: np.ndarray) -> tuple[np.ndarray, str]:
    """Count dates from the first, or durations, in the unit of their usual step.

    Parameters
    ----------
    values : (n,) dates or durations of NumPy, in any order; one not there is NaN.

    Gives the (n,) times and the unit: "s", "min", "h", "days" or "years" (of 365.25 days).

    >>> count_times(np.array(["2024-02-28", "2024-02-29", "2024-03-01"], dtype="datetime64[D]"))
    (array([0., 1., 2.]), 'days')
    """
    if values.dtype.kind == "M":
        values = values - values[0]
    seconds = np.asarray(values / np.timedelta64(1, "s"), dtype=float)
    with np.errstate(invalid="ignore"):
        steps = np.diff(seconds)
        steps = steps[steps > 0]
    usual = float(np.median(steps)) if steps.size else 1.0
    unit = next((u for u, size in _SECONDS.items() if usual >= _SLACK * size), "s")
    return seconds / _SECONDS[unit], unit


def convert_times(t: np.ndarray, unit: str, other: str) -> np.ndarray | None:
    """Give times in another unit; None where the two cannot be compared.

    >>> convert_times(np.array([1.0]), "days", "h")
    array([24.])
    """
    if unit == other:
        return t
    if unit not in _SECONDS or other not in _SECONDS:
        return None
    return t * (_SECONDS[unit] / _SECONDS[other])


def unit_in_name(name: str) -> str:
    """Give the unit of time that the name of a column states; "" where it states none.

    >>> [unit_in_name(name) for name in ("t [s]", "time (days)", "time_ms", "hours", "t", "tau")]
    ['s', 'days', 'ms', 'h', '', '']
    """
    found = _OF_NAME.fullmatch(name.strip())
    word = found["unit"] if found else ""
    if word == name.strip() and len(word) < _SHORTEST:  # "y" and "d" are states more often
        return ""
    return next((u for u, words in _WORDS.items() if re.fullmatch(words, word, re.IGNORECASE)), "")


def read_compact_dates(numbers: np.ndarray, name: str) -> np.ndarray | None:
    """Read whole numbers such as 20241231 as dates; None where they are none.

    Parameters
    ----------
    numbers : (n,) cells.
    name : that of the column, which must speak of dates.

    >>> read_compact_dates(np.array([20240228.0, 20240301.0]), "date")[1].astype(str)[:10]
    '2024-03-01'
    """
    if not _DATES.fullmatch(name.strip()) or not np.all((numbers > 1e7) & (numbers < 3e7)):
        return None
    import pandas

    cells = [f"{number:.0f}" for number in numbers] if np.all(numbers % 1 == 0) else ["none"]
    return _attempt(lambda: pandas.to_datetime(cells, format="%Y%m%d").to_numpy())


def check_time_unit(text: object) -> str:
    r"""Give a unit of time back where it is one that is known, else "".

    >>> check_time_unit("days"), check_time_unit("days\nimport os")
    ('days', '')
    """
    return str(text) if text in _WORDS else ""


def read_times(cells: np.ndarray) -> np.ndarray | None:
    """Read cells that are dates or durations, as text or objects; None where they are not.

    ISO 8601 is read, and 31.12.2024, 31/12/2024 or 12/31/2024 where every cell fits one of these
    alone; durations are those that pandas writes, such as "1 days 02:00:00", and times of a clock.
    """
    if cells.dtype.kind in "mM":
        return cells
    if all(isinstance(cell, (timedelta, np.timedelta64)) for cell in cells):
        return np.array(list(cells), dtype="timedelta64[ns]")
    if not all(isinstance(cell, (str, date, datetime)) for cell in cells):
        return None
    import pandas

    if all(isinstance(cell, str) and _DURATION.fullmatch(cell.strip()) for cell in cells):
        full = [c if c.count(":") != 1 else f"{c}:00" for c in cells]
        return _attempt(lambda: pandas.to_timedelta(full).to_numpy())
    found = _attempt(lambda: pandas.to_datetime(cells, format="ISO8601", utc=True))
    if found is None:
        formats = [day + clock for day in _FORMATS for clock in _CLOCKS]
        read = [
            _attempt(lambda f=form: pandas.to_datetime(cells, format=f, utc=True))
            for form in formats
        ]
        fits = [dates for dates in read if dates is not None]
        found = fits[0] if len(fits) == 1 else None
    return None if found is None else found.tz_localize(None).to_numpy()


def _attempt(read: Any) -> Any:
    try:
        return read()
    except (ValueError, TypeError, OverflowError):
        return None
