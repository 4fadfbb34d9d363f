"""Calendars: a time in columns of years, months, days, hours and so on is put together."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np

from dynsr.data.columns import Columns
from dynsr.data.name_parts import bare_name
from dynsr.data.times import first_of_weeks, month_of

# Part of a date -> names of columns that hold it.
_PARTS = {
    "year": r"years?|yyyy|yr|jahr|ann[ée]e|a[ñn]o",
    "quarter": r"quarters?|qtr|q|quartal|trimestre",
    "month": r"months?|mon|monat|mois|mes",
    "week": r"(?:iso|epi|mmwr|calendar)?[ _.-]?weeks?(?:[ _.-]?(?:no|nr|number))?|wk|kw|woche|"
    r"kalenderwoche|semaine|semana",
    "day": r"days?|dd|dom|tag|jour|d[ií]a",
    "of_year": r"doy|day.?of.?year|julian.?day|jday|yday|tag.?im.?jahr",
    "clock": r"hh:?mm|hrmn|hr:?min|hour:?min(ute)?",
    "hour": r"hours?|hh|hr|h|stunde|heure|hora",
    "minute": r"minutes?|min|mi|minuto",
    "second": r"seconds?|ss|sec|s|sekunde|seconde|segundo",
}
_RANGES = {
    "year": (1700, 2300),
    "quarter": (1, 4),
    "month": (1, 12),
    "week": (1, 53),
    "day": (1, 31),
    "of_year": (0, 367),
    "clock": (0, 2400),
    "hour": (0, 24),
    "minute": (0, 60),
    "second": (0, 61),
}
_WHOLE = ("year", "quarter", "month", "week", "day", "clock")
_DATE = ("year", "month", "day")
_SCALES = {"day": 86400, "hour": 3600, "minute": 60, "second": 1}
_ENDS = {"hour": 24, "minute": 60, "second": 60}
_QUARTER = re.compile(r"\s*q?\s*([1-4])\s*", re.IGNORECASE)


def join_calendar(columns: Columns, said: Collection[str]) -> Columns:
    """Put the parts of a date in separate columns together as one column of dates.

    Parameters
    ----------
    columns : the columns of the source.
    said : names that the caller gave a role; such a part is left as it is.

    There must be a year, and a quarter, a month, a week or the day of the year; days, hours,
    minutes and seconds are added where they are there. Days and hours without a year are counted
    from day 0. Hours and minutes, or minutes and seconds, without a day are a clock or a duration.
    Gives the columns as they are where no times come of it.

    >>> parts = {"Year": [2023.0] * 2, "Month": [1.0, 1.0], "Day": [30.0, 31.0], "x": [1.0, 2.0]}
    >>> columns = Columns(tuple(parts), tuple(map(np.array, parts.values())), "the mapping")
    >>> join_calendar(columns, ()).names
    ('Year, Month, Day', 'x')
    """
    parts = _find_parts(columns, said)
    found = {part: _numbers(columns, name, part) for part, name in parts.items()}
    if "clock" in found:  # 1530 is half past three
        found["hour"], found["minute"] = divmod(found.pop("clock"), 100)
        if np.any(found["minute"] >= _ENDS["minute"]):
            return columns
    if "year" in parts and {"quarter", "month", "week", "of_year"} & set(parts):
        stamps = _put_together(found)
    elif not {"year", "month", "quarter", "week", "of_year"} & set(parts) and len(parts) > 1:
        stamps = _count(found)
    else:
        return columns
    if stamps is None or len(set(stamps.tolist())) < 2:
        return columns
    used = list(parts.values())
    kept = [name for name in columns.names if name not in used]
    place = min(columns.names.index(name) for name in used)
    names = [", ".join(used) if j == place else n for j, n in enumerate(columns.names)]
    names = [n for n in names if n in kept or n == ", ".join(used)]
    values = [stamps if n not in kept else _values(columns, n) for n in names]
    return replace(columns, names=tuple(names), values=tuple(values))


def unroll_months(columns: Columns) -> tuple[Columns, list[str]]:
    """Put a table of a row for each year and a column for each month into one row for each month.

    Parameters
    ----------
    columns : the columns of the source.

    Gives the columns, and a sentence where the table was such a one. What else is in it, such as
    means of years, is left out.

    >>> months = ("Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec").split()
    >>> values = (np.array([2001.0, 2002.0]), *np.arange(24.0).reshape(2, 12).T)
    >>> found, said = unroll_months(Columns(("Year", *months), values, "data.csv"))
    >>> found.names, found.values[0][1], found.values[1][:3]
    (('Year', 'value'), np.datetime64('2001-02'), array([0., 1., 2.]))
    """
    months = {n: month_of(bare_name(n)) for n in columns.names if month_of(bare_name(n))}
    years = [n for n in columns.names if _part(bare_name(n), ()) == "year"]
    values = [_values(columns, n) for n in (*years, *months)]
    if len(years) != 1 or sorted(months.values()) != list(range(1, 13)):
        return columns, []
    year = values[0]
    if any(own.dtype.kind != "f" for own in values) or not np.isfinite(year).all():
        return columns, []
    if np.any(year % 1 != 0) or len(set(year.tolist())) < len(year):
        return columns, []
    order = np.argsort(year)
    table = np.column_stack([_values(columns, n) for n in sorted(months, key=months.__getitem__)])
    first = (year[order].astype(int) - 1970).astype("datetime64[Y]").astype("datetime64[M]")
    stamps = (first[:, None] + np.arange(12)).reshape(-1)
    others = [n for n in columns.names if n not in (*years, *months)]
    why = dict.fromkeys(others, "has one cell for each year, next to those of months")
    said = (
        f"{columns.label} has a row for each year and a column for each month: the months were put "
        "one below the other, as 'value'."
    )
    found = replace(
        columns,
        names=(years[0], "value"),
        values=(stamps, table[order].reshape(-1)),
        units={},
        limits={},
        left_out={**columns.left_out, **why},
    )
    return found, [said]


def _values(columns: Columns, name: str) -> np.ndarray:
    return columns.values[columns.names.index(name)]


def _numbers(columns: Columns, name: str, part: str) -> np.ndarray:
    """Give a column as numbers; a quarter may be written as Q1, a month by its name."""
    values = _values(columns, name)
    if values.dtype.kind == "f" or part not in ("quarter", "month"):
        return values
    if part == "month":
        months = [month_of(cell.strip()) if isinstance(cell, str) else 0 for cell in values]
        return np.array([float(month) or np.nan for month in months])
    found = [_QUARTER.fullmatch(cell) if isinstance(cell, str) else None for cell in values]
    return np.array([np.nan if match is None else float(match[1]) for match in found])


def _find_parts(columns: Columns, said: Collection[str]) -> dict[str, str]:
    """Give part -> its column, in the order of the parts."""
    found: dict[str, str] = {}
    longest = _longest(list(map(bare_name, columns.names)))
    for name in columns.names:
        part = _part(bare_name(name), found)
        values = _numbers(columns, name, part)
        if name in said or values.dtype.kind != "f" or not np.isfinite(values).all():
            continue
        low, high = _RANGES.get(part, (0, 0))
        if part == longest:
            low, high = 0, 10_000  # days or hours of an experiment
        whole = part not in _WHOLE or bool(np.all(values % 1 == 0))
        if part and part not in found and whole and low <= values.min() <= values.max() <= high:
            found[part] = name
    if {"month", "week", "of_year"} & set(found):
        found.pop("quarter", None)
    if not {"year", "month", "quarter", "week", "of_year"} & set(found):
        for part in ("day", "hour"):  # all of it on one day, or within one hour
            longest = next((p for p in _PARTS if p in found), "")
            if part == longest and _is_still(columns, found[part]):
                del found[part]
    if "week" in found:  # it says the day itself, and a month next to it no more
        found = {p: own for p, own in found.items() if p in ("year", "week")}
    if "hour" in found or not {"day", "of_year"} & set(found):
        found.pop("clock", None)
    parts = [p for p in _PARTS if p in found and not (p in ("month", "day") and "of_year" in found)]
    return {part: found[part] for part in _without_breaks(parts, found)}


def _longest(names: Sequence[str]) -> str:
    """Give the part that counts on from the start of an experiment; "" where there are dates."""
    called = {_part(name, ()) for name in names}
    called = {_part(name, called) for name in names}
    if {"year", "quarter", "month", "week", "of_year"} & called:
        return ""
    return next((part for part in ("day", "hour", "minute") if part in called), "")


def _is_still(columns: Columns, name: str) -> bool:
    values = _values(columns, name)
    return bool(np.all(values == values[0]))


def _without_breaks(parts: Sequence[str], found: Mapping[str, str]) -> list[str]:
    """Leave out a part below one that is missing, such as seconds without minutes."""
    clock = [p for p in ("hour", "minute", "second") if p in parts]
    dates = [p for p in parts if p not in clock]
    if dates and ("hour" not in clock or not {"day", "of_year"} & set(dates)):
        clock = []
    if "minute" not in clock or ("second" in clock and not _are_alike(found)):
        clock = [p for p in clock if p != "second"]
    return [*dates, *clock]


def _are_alike(found: Mapping[str, str]) -> bool:
    """Whether seconds are called as minutes are: an S next to minutes is more often a substrate."""
    minute, second = (bare_name(found[part]) for part in ("minute", "second"))
    letters = len(minute) == 1 and minute.islower() == second.islower()
    return len(second) > 1 or letters or (minute.lower(), second) == ("min", "s")


def _part(name: str, found: Collection[str]) -> str:
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
    if "week" in parts:
        return first_of_weeks(parts["year"], parts["week"])
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


def _count(parts: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Give (n,) durations or clocks of days, hours and so on; None where they make no time.

    The shorter parts rise within each value of the longest one, and begin again in the next.
    """
    longest, *shorter = parts
    seconds = np.sum([_SCALES[part] * own for part, own in parts.items()], axis=0)
    same, steps = np.diff(parts[longest]) == 0, np.diff(seconds)
    if not same.any() or same.all() or 2 * np.sum(steps > 0) <= len(steps):
        return None
    broken = any(np.any(parts[part] % 1 != 0) for part in (longest, *shorter[:-1]))
    beyond = any(np.any(parts[part] >= _ENDS[part]) for part in shorter)
    if broken or beyond or np.any(steps[same] < 0):
        return None
    if longest == "hour" and np.any(steps < 0) and parts["hour"].max() < 24:
        # A clock, which may pass midnight.
        midnight = datetime(2000, 1, 1, tzinfo=UTC)
        moments = [midnight + timedelta(seconds=float(own)) for own in seconds]
        return np.array([moment.time() for moment in moments], dtype=object)
    return np.asarray(np.round(1e3 * seconds).astype("timedelta64[ms]"))
