"""Calendars: a time in columns of years, months, days, hours and so on is put together."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from dynsr.data.columns import Columns, bare_name

# Part of a date -> names of columns that hold it.
_PARTS = {
    "year": r"years?|yyyy|yr|jahr|ann[ée]e|a[ñn]o",
    "month": r"months?|mon|monat|mois|mes",
    "day": r"days?|dd|dom|tag|jour|d[ií]a",
    "of_year": r"doy|day.?of.?year|julian.?day|jday|yday|tag.?im.?jahr",
    "hour": r"hours?|hh|hr|h|stunde|heure|hora",
    "minute": r"minutes?|min|mi|minuto",
    "second": r"seconds?|ss|sec|s|sekunde|seconde|segundo",
}
_RANGES = {
    "year": (1700, 2300),
    "month": (1, 12),
    "day": (1, 31),
    "of_year": (0, 367),
    "hour": (0, 24),
    "minute": (0, 60),
    "second": (0, 61),
}
_WHOLE = ("year", "month", "day")


def join_calendar(columns: Columns, said: Collection[str]) -> Columns:
    """Put the parts of a date in separate columns together as one column of dates.

    Parameters
    ----------
    columns : the columns of the source.
    said : names that the caller gave a role; such a part is left as it is.

    There must be a year, and a month or the day of the year; days, hours, minutes and seconds are
    added where they are there. Gives the columns as they are where no dates come of it.

    >>> parts = {"Year": [2023.0] * 2, "Month": [1.0, 1.0], "Day": [30.0, 31.0], "x": [1.0, 2.0]}
    >>> columns = Columns(tuple(parts), tuple(map(np.array, parts.values())), "the mapping")
    >>> join_calendar(columns, ()).names
    ('Year, Month, Day', 'x')
    """
    parts = _find_parts(columns, said)
    if "year" not in parts or not {"month", "of_year"} & set(parts):
        return columns
    stamps = _put_together({part: _values(columns, name) for part, name in parts.items()})
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


def _find_parts(columns: Columns, said: Collection[str]) -> dict[str, str]:
    """Give part -> its column, in the order of the parts."""
    found: dict[str, str] = {}
    for name in columns.names:
        values = _values(columns, name)
        if name in said or values.dtype.kind != "f" or not np.isfinite(values).all():
            continue
        part = _part(bare_name(name), found)
        low, high = _RANGES.get(part, (0, 0))
        whole = part not in _WHOLE or bool(np.all(values % 1 == 0))
        if part and part not in found and whole and low <= values.min() <= values.max() <= high:
            found[part] = name
    parts = [p for p in _PARTS if p in found and not (p in ("month", "day") and "of_year" in found)]
    # An hour without a day is none of a date.
    if not {"day", "of_year"} & set(parts):
        parts = [p for p in parts if p in ("year", "month")]
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
    date = {part: parts.get(part, ones) for part in _WHOLE}
    try:
        stamps = pandas.to_datetime(date).to_numpy().astype("datetime64[ms]")
    except ValueError:  # such as the 31st of April
        return None
    days = parts["of_year"] - 1 if "of_year" in parts else 0.0
    seconds = 86400.0 * days + sum(
        scale * parts.get(part, 0.0)
        for part, scale in (("hour", 3600), ("minute", 60), ("second", 1))
    )
    more: np.ndarray = np.round(1e3 * seconds * ones).astype("timedelta64[ms]")
    return np.asarray(stamps + more)
