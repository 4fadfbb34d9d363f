"""Calendars: a time in columns of years, months, days, hours and so on is put together."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from dynsr.data.columns import Columns
from dynsr.data.name_parts import bare_name

# Part of a date -> names of columns that hold it.
_PARTS = {
    "year": r"years?|yyyy|yr|jahr|ann[ée]e|a[ñn]o",
    "quarter": r"quarters?|qtr|q|quartal|trimestre",
    "month": r"months?|mon|monat|mois|mes",
    "day": r"days?|dd|dom|tag|jour|d[ií]a",
    "of_year": r"doy|day.?of.?year|julian.?day|jday|yday|tag.?im.?jahr",
    "hour": r"hours?|hh|hr|h|stunde|heure|hora",
    "minute": r"minutes?|min|mi|minuto",
    "second": r"seconds?|ss|sec|s|sekunde|seconde|segundo",
}
_RANGES = {
    "year": (1700, 2300),
    "quarter": (1, 4),
    "month": (1, 12),
    "day": (1, 31),
    "of_year": (0, 367),
    "hour": (0, 24),
    "minute": (0, 60),
    "second": (0, 61),
}
_WHOLE = ("year", "quarter", "month", "day")
_DATE = ("year", "month", "day")
_SCALES = {"day": 86400, "hour": 3600, "minute": 60, "second": 1}
_QUARTER = re.compile(r"\s*q?\s*([1-4])\s*", re.IGNORECASE)


def join_calendar(columns: Columns, said: Collection[str]) -> Columns:
    """Put the parts of a date in separate columns together as one column of dates.

    Parameters
    ----------
    columns : the columns of the source.
    said : names that the caller gave a role; such a part is left as it is.

    There must be a year, and a quarter, a month or the day of the year; days, hours, minutes and
    seconds are added where they are there. Days and hours without a year are counted from day 0.
    Gives the columns as they are where no times come of it.

    >>> parts = {"Year": [2023.0] * 2, "Month": [1.0, 1.0], "Day": [30.0, 31.0], "x": [1.0, 2.0]}
    >>> columns = Columns(tuple(parts), tuple(map(np.array, parts.values())), "the mapping")
    >>> join_calendar(columns, ()).names
    ('Year, Month, Day', 'x')
    """
    parts = _find_parts(columns, said)
    found = {part: _numbers(columns, name, part) for part, name in parts.items()}
    if "year" in parts and {"quarter", "month", "of_year"} & set(parts):
        stamps = _put_together(found)
    elif {"day", "hour"} <= set(parts) and not {"year", "month", "quarter"} & set(parts):
        stamps = _count_days(found)
    else:
        return columns
    if stamps is None or len(np.unique(stamps)) < 2:
        return columns
    used = list(parts.values())
    kept = [name for name in columns.names if name not in used]
    place = min(columns.names.index(name) for name in used)
    names = [", ".join(used) if j == place else n for j, n in enumerate(columns.names)]
    names = [n for n in names if n in kept or n == ", ".join(used)]
    values = [stamps if n not in kept else _values(columns, n) for n in names]
    return replace(columns, names=tuple(names), values=tuple(values))


def _values(columns: Columns, name: str) -> np.ndarray:
    return columns.values[columns.names.index(name)]


def _numbers(columns: Columns, name: str, part: str) -> np.ndarray:
    """Give a column as numbers; a quarter may be written as Q1."""
    values = _values(columns, name)
    if values.dtype.kind == "f" or part != "quarter":
        return values
    found = [_QUARTER.fullmatch(cell) if isinstance(cell, str) else None for cell in values]
    return np.array([np.nan if match is None else float(match[1]) for match in found])


def _find_parts(columns: Columns, said: Collection[str]) -> dict[str, str]:
    """Give part -> its column, in the order of the parts."""
    found: dict[str, str] = {}
    for name in columns.names:
        part = _part(bare_name(name), found)
        values = _numbers(columns, name, part)
        if name in said or values.dtype.kind != "f" or not np.isfinite(values).all():
            continue
        low, high = _RANGES.get(part, (0, 0))
        if part == "day" and "year" not in found and "month" not in found:
            low, high = 0, 10_000  # days of an experiment
        whole = part not in _WHOLE or bool(np.all(values % 1 == 0))
        if part and part not in found and whole and low <= values.min() <= values.max() <= high:
            found[part] = name
    if {"month", "of_year"} & set(found):
        found.pop("quarter", None)
    parts = [p for p in _PARTS if p in found and not (p in ("month", "day") and "of_year" in found)]
    # An hour without a day is none of a date.
    if not {"day", "of_year"} & set(parts):
        parts = [p for p in parts if p in ("year", "quarter", "month")]
    return {part: found[part] for part in parts}


def _part(name: str, found: Mapping[str, str]) -> str:
    """Say which part of a date a column of that name holds; "" for none."""
    if name.lower() in ("mm", "m"):  # months and minutes are written alike
        return "minute" if "hour" in found else "month"
    return next((p for p, own in _PARTS.items() if re.fullmatch(own, name, re.IGNORECASE)), "")


def _put_together(parts: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Give (n,) dates of their parts; None where one of them is no date."""
    import pandas

    ones = np.ones(len(parts["year"]))
    if "quarter" in parts:
        parts = {**parts, "month": 3 * parts["quarter"] - 2}
    date = {part: parts.get(part, ones) for part in _DATE}
    try:
        stamps = pandas.to_datetime(date).to_numpy().astype("datetime64[ms]")
    except ValueError:  # such as the 31st of April
        return None
    days = parts["of_year"] - 1 if "of_year" in parts else 0.0
    seconds = 86400.0 * days + sum(
        scale * parts.get(part, 0.0) for part, scale in _SCALES.items() if part != "day"
    )
    more: np.ndarray = np.round(1e3 * seconds * ones).astype("timedelta64[ms]")
    return np.asarray(stamps + more)


def _count_days(parts: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Give (n,) durations of numbered days and hours; None where these are no one time.

    Hours of the day rise within each day, and begin again on the next.
    """
    seconds = sum((scale * parts[part] for part, scale in _SCALES.items() if part in parts), 0.0)
    same = np.diff(parts["day"]) == 0
    steps = np.diff(np.asarray(seconds))
    if not same.any() or same.all() or 2 * np.sum(steps > 0) <= len(steps):
        return None
    if np.any(parts["hour"] >= 24) or np.any(steps[same] < 0):
        return None
    return np.asarray(np.round(1e3 * np.asarray(seconds)).astype("timedelta64[ms]"))
