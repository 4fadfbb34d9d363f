"""Time columns: which column, or date and clock together, is the time; which only repeat it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dynsr.data.angles import count_on
from dynsr.data.columns import Columns
from dynsr.data.lines import follows_line, last_digit, numbers_rows
from dynsr.data.name_parts import bare_name, bracketed_unit
from dynsr.data.names import find_column, list_names
from dynsr.data.times import (
    Moments,
    count_seconds,
    is_time_name,
    read_counted,
    read_dotted_clocks,
    read_nanoseconds,
    read_numbers_as_dates,
    read_times,
    unit_in_name,
)
from dynsr.data.trajectory import as_floats
from dynsr.errors import InputError, quoted

_DAY, _HOUR = 86400.0, 3600.0
_HOURS = re.compile(r"h|hrs?|hours?|stunden?|heures?|horas?|ora", re.IGNORECASE)
_DECIMAL_YEAR = re.compile(
    r"y{4}[._]y+|decimal|(dec|decimal|fractional)[\W_]?(year|date)|(year|date)[\W_]*(dec|decimal|frac\w*)\W?",
    re.IGNORECASE,
)
# Twelfths of a year by which months and their names are apart, from their first day to their last.
_WITHIN_A_MONTH = 0.6
# A letter T in such a unit is a temperature.
_OF_TEMPERATURE = re.compile(r"[°º].*|deg.*|[CFK℃℉]|celsius|fahrenheit|kelvin", re.IGNORECASE)
# Ages of layers and ice, and what is left of a time.
_BEFORE_NOW = re.compile(
    r"(?<![^\W\d_])(bp|b2k|ago|ka|kyr|ma|myr|countdown|remaining)(?![^\W\d_])", re.IGNORECASE
)
_FRAME = re.compile(r"frames?|bild", re.IGNORECASE)
_OTHER_TIME = re.compile(r"(t|time|time.?stamp|date.?time)_\w+|position_t", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Times:
    """The times of the rows of a source.

    Parameters
    ----------
    name : the column.
    values : (n,) plain numbers as they are, or seconds; NaN where there is none.
    unit : what plain numbers are counted in; "" where nothing says it.
    counted : whether they are seconds of dates or durations, which get the unit of their steps.
    from_first : whether they are counted from the first one.
    first : what their 0 is where they are: "date" and seconds since 1970, or "clock" and those
        since the day began; None otherwise.
    clock : the column of the time of the day next to one of dates.
    daily : whether they are times of the day alone, which begin again at midnight.
    left_out : other columns of dates or times -> the reason why they are not used.
    notes : what was assumed, a sentence each.
    """

    name: str
    values: np.ndarray
    unit: str = ""
    counted: bool = False
    from_first: bool = False
    first: tuple[str, float] | None = None
    clock: str | None = None
    daily: bool = False
    left_out: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that it is made of."""
        return (self.name,) if self.clock is None else (self.name, self.clock)

    def within(self, codes: np.ndarray) -> np.ndarray:
        """Give the (n,) times; those of a clock go on on the next day where it passes midnight.

        Parameters
        ----------
        codes : (n,) the number of the trajectory of each row.
        """
        if not self.daily:
            return self.values
        found = self.values.copy()
        for code in np.unique(codes):
            rows = np.flatnonzero(codes == code)
            found[rows] = _pass_midnight(found[rows])
        return found

    def at(self, rows: np.ndarray) -> Times:
        """Give the times of some rows."""
        return replace(self, values=self.values[rows])


def _pass_midnight(seconds: np.ndarray) -> np.ndarray:
    """Add a day wherever a clock falls back at midnight."""
    there = np.flatnonzero(np.isfinite(seconds))
    steps = np.diff(seconds[there])
    if not np.any(steps < 0) or np.sum(steps < 0) > np.sum(steps > 0):
        return seconds
    longest = float(np.max(steps, initial=0.0))
    # Nearer to the next day than to a clock that runs backwards, or no pause at all.
    over = (steps < 0) & ((steps + _DAY <= _DAY / 2) | (steps + _DAY <= 2 * longest))
    found = seconds.copy()
    found[there[1:]] += _DAY * np.cumsum(over)
    return found


def _without_summer_time(time: Times) -> Times:
    """Give dates of a local clock as they passed, where it jumps by an hour in the night to Sunday.

    Only a step that is an hour longer, or shorter, than the usual one is such a jump.
    """
    there = np.flatnonzero(np.isfinite(time.values))
    steps = np.diff(time.values[there])
    if time.first is None or time.first[0] != "date" or not np.any(steps > 0):
        return time
    extra = steps - np.median(steps[steps > 0])
    hours = np.where(np.abs(np.abs(extra) - _HOUR) < 1, np.sign(extra), 0.0)
    stamps = time.first[1] + time.values[there[1:]]
    # The week began with a Thursday in 1970.
    sunday = (stamps // _DAY + 3) % 7 == 6
    hours *= sunday & (np.abs(stamps % _DAY - 2 * _HOUR) <= _HOUR)
    at = np.flatnonzero(hours)
    # Such nights are half a year apart, and each record passes at most a few of them.
    if not at.size or np.any(np.diff(time.values[there[at]]) < 100 * _DAY):
        return time
    values = time.values.copy()
    values[there[1:]] -= _HOUR * np.cumsum(hours)
    nights = stamps[at].astype("datetime64[s]").astype("datetime64[D]").astype(str).tolist()
    note = (
        f"the clock of {time.name!r} jumps by an hour on {' and '.join(nights)}, as one of summer "
        "time does: the hour was taken out; stamps with a zone, such as 01:30+01:00, say it "
        "themselves"
    )
    return replace(time, values=values, notes=(*time.notes, note))


def _counted_on(time: Times) -> Times:
    """Give a clock of so many bits that begins again at 0 as one that goes on."""
    found = None if time.counted else count_on(time.values)
    if found is None:
        return time
    note = (
        f"{time.name!r} begins again after {found[1]} bits, as a clock that overflows: it goes on"
    )
    return replace(time, values=found[0], notes=(*time.notes, note))


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore")
def find_time(columns: Columns, time: str | Sequence[str] | None) -> Times:
    """Find the times: as the caller said, or by the values of the columns, then by their names.

    Parameters
    ----------
    columns : the columns of the source.
    time : name of the column in the source or in formulas, or those of the date and the clock,
        two names or one text with a comma between; None to guess.

    A date and a clock in two columns are one time. Of several columns that say the same time the
    finest is taken. Raises InputError that lists the columns when it is not there or none can be
    the time.
    """
    look = _Look(columns)
    found = _counted_on(_without_summer_time(look.named(time) if time else look.guess()))
    if columns.time_unit and found.name == columns.names[0]:
        found = replace(found, unit=columns.time_unit)
    stated = columns.units.get(found.name) or bracketed_unit(found.name)
    if not found.unit and stated:
        found = replace(found, unit=unit_in_name(f"[{stated}]"))
    return look.with_others(found)


def in_seconds_or_units(time: Times, t: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, str]:
    """Give times in their unit, which is that of the usual step where they are dates.

    Parameters
    ----------
    time : the column.
    t : (n,) its times, as :meth:`Times.within` gives them.
    steps : the steps between them within trajectories.
    """
    return count_seconds(t, steps) if time.counted else (t, time.unit)


class _Look:
    """Looks for the times among the columns of a source."""

    def __init__(self, columns: Columns) -> None:
        """Remember the columns."""
        self._columns = columns
        self._read: dict[str, Moments | None] = {}

    def _values(self, name: str) -> np.ndarray:
        return self._columns.values[self._columns.names.index(name)]

    def _moments(self, name: str) -> Moments | None:
        """Read a column as dates or durations; None where it holds others."""
        if name not in self._read:
            values = self._values(name)
            if values.dtype.kind == "f":
                found = read_numbers_as_dates(values, name)
                self._read[name] = found or read_dotted_clocks(values, name)
            elif values.dtype.kind == "m" and np.datetime_data(values.dtype)[0] in "YM":
                self._read[name] = None  # years and months are of no fixed length
            else:
                found = read_times(values, name)
                found = read_nanoseconds(values, name) if found is None else found
                if found is None and (numbers := _as_numbers(values)) is not None:
                    found = read_numbers_as_dates(numbers, name)
                self._read[name] = found
        return self._read[name]

    def _numbers(self, name: str) -> np.ndarray | None:
        values = self._values(name)
        return values if values.dtype.kind == "f" else _as_numbers(values)

    def _time(self, name: str) -> Times | None:
        moments = self._moments(name)
        if moments is not None:
            dates = moments.values.dtype.kind == "M"
            notes = (f"{name!r} holds {moments.written}",) if moments.written else ()
            return Times(
                name,
                moments.seconds,
                counted=True,
                from_first=dates or moments.clock,
                first=moments.first,
                daily=moments.clock,
                notes=notes,
            )
        numbers = self._numbers(name)
        if numbers is not None:
            return Times(name, numbers, unit_in_name(name))
        values = self._values(name)
        counted = read_counted(values) if values.dtype.kind == "O" else None
        if counted is None or len(set(counted[1])) > 1:
            return None
        return Times(name, counted[0], counted[1][0] or unit_in_name(name))

    def named(self, time: str | Sequence[str]) -> Times:
        """Give the times that the caller named."""
        if isinstance(time, str) and time not in self._columns.names and "," in time:
            time = [part.strip() for part in time.split(",") if part.strip()]
        names = [time] if isinstance(time, str) else list(time)
        names = [find_column(name, self._columns, "time") for name in names]
        if len(names) > 2:
            raise InputError(f"{len(names)} columns for the time; give one, or a date and a clock")
        if len(names) == 2:
            found = self._join(*names) or self._join(*names[::-1])
            if found is None:
                raise InputError(
                    f"columns {names[0]!r} and {names[1]!r} are both the time, and no date and "
                    "clock; choose one"
                )
            return found
        found = self._time(names[0])
        if found is None:
            self._refuse(names[0])
        assert found is not None
        if self._is_day(names[0]):
            found = self._with_clock(names[0]) or found
        return found

    def _refuse(self, name: str) -> None:
        self._columns.check_usable([name])
        values = self._values(name)
        rows = _first_of_each_form(values)
        if len(rows) > 1 and all(read_times(values[[i]], name) is not None for i in rows):
            first = rows[0]
            other = next((i for i in rows if read_times(values[[first, i]], name) is None), rows[1])
            raise InputError(
                f"time {name!r} of {self._columns.label} is written in two ways: "
                f"{quoted(values[first])} in row {first + 1} and {quoted(values[other])} "
                f"in row {other + 1}; write all dates in one way, such as 2024-12-31"
            )
        # Where the first is a time, it is the first of the others that is none.
        reads = read_times(values[:1], name) is not None
        row = next(
            (
                i
                for i in range(len(values))
                if (
                    read_times(values[i : i + 1], name) if reads else _as_numbers(values[i : i + 1])
                )
                is None
            ),
            0,
        )
        raise InputError(
            f"time {name!r} of {self._columns.label} has the text "
            f"{quoted(values[row])} in row "
            f"{row + 1}; give numbers, or dates such as 2024-12-31"
        )

    def _is_day(self, name: str) -> bool:
        moments = self._moments(name)
        return moments is not None and moments.days_only

    def _is_cyclic(self, name: str) -> bool:
        moments = self._moments(name)
        return moments is not None and moments.cyclic

    def _with_clock(self, day: str) -> Times | None:
        """Join a column of dates with the clock next to it, if there is one."""
        for name in self._columns.names:
            if name != day and (found := self._join(day, name)) is not None:
                return found
        return None

    def _join(self, day: str, clock: str) -> Times | None:
        """Join dates and times of the day; None where they are not."""
        if not self._is_day(day):
            return None
        seconds = self._time_of_day(clock, self._values(day))
        if seconds is None:
            return None
        dates = self._moments(day)
        assert dates is not None
        return Times(
            day,
            dates.seconds + seconds,
            counted=True,
            from_first=True,
            first=dates.first,
            clock=clock,
        )

    def _time_of_day(self, name: str, days: np.ndarray) -> np.ndarray | None:
        moments = self._moments(name)
        if moments is not None:
            return moments.seconds if moments.clock else None
        numbers = self._values(name)
        if not _HOURS.fullmatch(bare_name(name)) or numbers.dtype.kind != "f":
            return None
        there = numbers[np.isfinite(numbers)]
        # Hours since a start are none of the day: those of one day are each there once.
        within = len(there) and there.min() >= 0 and there.max() < 24
        again = len(set(map(str, days))) > 1 and len(np.unique(there)) < len(there)
        return 3600.0 * numbers if within and again else None

    def guess(self) -> Times:
        """Give the times by values and names."""
        names = self._columns.names
        called = [n for n in names if is_time_name(bare_name(n)) or _OTHER_TIME.fullmatch(n)]
        called = [n for n in called if not _OF_TEMPERATURE.fullmatch(self._unit(n))]
        if not self._columns.named:
            called = [self._first_that_moves()]
        named = [found for n in called if (found := self._time(n)) is not None]
        # Names of months next to a time are the month that each row is of.
        cyclic = {n for n in names if named and self._is_cyclic(n)}
        others = [n for n in names if n not in called and n not in cyclic]
        stamped = [found for n in others if (found := self._stamped(n))]
        known = {*cyclic, *(t.name for t in (*named, *stamped))}
        counted = [t for t in self._counted() if t.name not in known]
        usable = [t for t in (*named, *stamped, *counted) if _moves(t.values)]
        usable.sort(key=self._rank)
        # A date and a clock beside it are one time, also where the date does not change.
        days = [t.name for t in (*named, *stamped) if self._is_day(t.name)]
        joined = [found for day in days if (found := self._with_clock(day)) is not None][:1]
        parts = [name for found in joined for name in found.columns]
        usable = [*joined, *(t for t in usable if t.name not in parts)]
        broken = [n for n in (*called, *self._in_units()) if self._is_broken(n)]
        usable = usable or (self._rising() if not broken else []) or named or self._worded()
        if usable:
            return self._finest(usable)
        if called or broken:
            self._refuse((*broken, *called)[0])
        raise InputError(
            f"no column of {self._columns.label} looks like the time (columns: "
            f"{list_names(names)}); name it, e.g. --time seconds, or give the step between rows, "
            "e.g. --time 0.1"
        )

    def _first_that_moves(self) -> str:
        """Give the first column, or of those that rise the first where it mostly stays the same.

        A year is the same in the rows of all its months.
        """
        names = self._columns.names
        first = self._numbers(names[0])
        if first is None or 2 * np.count_nonzero(np.diff(first) == 0) <= len(first):
            return names[0]
        others = ((name, self._numbers(name)) for name in names[1:])
        rising = (name for name, v in others if v is not None and np.all(np.diff(v) > 0))
        return next(rising, names[0])

    def _stamped(self, name: str) -> Times | None:
        if self._values(name).dtype.kind == "f" or self._moments(name) is None:
            return None
        return self._time(name)

    def _rank(self, time: Times) -> tuple[bool, bool]:
        """Put what rises first, and a letter that may be a temperature last."""
        steps = np.diff(time.values[np.isfinite(time.values)])
        return not np.sum(steps > 0) > len(steps) / 2, time.name == "T"

    def _in_units(self) -> list[str]:
        return [n for n in self._columns.names if unit_in_name(n)]

    def _is_broken(self, name: str) -> bool:
        """Whether most cells of a column are times, and others cannot be read."""
        if self._time(name) is not None:
            return False
        values = self._values(name)
        # Dates that are written in several ways.
        forms = _first_of_each_form(values) if values.dtype.kind == "O" else []
        if 1 < len(forms) < len(values) / 2 and all(
            read_times(values[[row]], name) is not None for row in forms
        ):
            return True
        read = sum(_as_numbers(values[i : i + 1]) is not None for i in range(len(values)))
        return 2 * read > len(values)

    def _counted(self) -> list[Times]:
        times = [
            t for n in self._in_units() if (t := self._time(n)) is not None and _moves(t.values)
        ]
        return times if len(times) == 1 else [t for t in times if _rises(t.values)]

    def _worded(self) -> list[Times]:
        """Give the only column whose name ends in a whole word of time, such as "visit_day".

        Or that of frames, as programs that follow cells through a film number them.
        """
        found = []
        for name in self._columns.names:
            word = re.split(r"[\W_]+", bare_name(name))[-1]
            numbers = self._numbers(name)
            if _FRAME.fullmatch(name) and numbers is not None:
                return [Times(name, numbers)]
            if (
                len(word) > 3 - (word.lower() == "day")
                and unit_in_name(word)
                and numbers is not None
            ):
                found.append(Times(name, numbers, unit_in_name(word)))
        return found if len(found) == 1 else []

    def _rising(self) -> list[Times]:
        """Give the first column that rises from row to row; one that numbers them comes last."""
        named = [n for n in self._columns.names if n and self._values(n).dtype.kind == "f"]
        rising = [n for n in named if _rises(self._values(n))]
        one = np.zeros(len(self._columns.values[0]), dtype=int)
        # What is measured in a unit is more than a number of a row.
        rising.sort(key=lambda n: numbers_rows(n, self._values(n), one) and not self._unit(n))
        found = next((t for n in rising[:1] if (t := self._time(n)) is not None), None)
        if found is None:
            return []
        note = (
            f"No column is called a time; {found.name!r} rises from row to row and was taken for "
            "it; if it is another one, name that (--time)."
        )
        if _BEFORE_NOW.search(found.name):
            note += " It counts back from now: take minus it, else slopes have the other sign."
        return [replace(found, notes=(*found.notes, note))]

    def _unit(self, name: str) -> str:
        return (self._columns.units.get(name) or bracketed_unit(name)).strip()

    def _finest(self, times: list[Times]) -> Times:
        """Give the first of them, or one that says the same in finer steps, or with a unit."""
        best = times[0]
        for other in times[1:]:
            there = np.isfinite(best.values) & np.isfinite(other.values)
            if not there.any() or best.daily or other.daily:
                continue
            own, beside = best.values[there], other.values[there]
            if not follows_line(beside, own):
                continue
            named = bool(other.unit) and not best.unit and not _finer(own, beside)
            if named or _finer(beside, own):
                best = other
        return best

    def with_others(self, time: Times) -> Times:
        """Say of the other columns of dates that they are not used."""
        left_out = {}
        for name in self._columns.names:
            values = self._values(name)
            if name in time.columns:
                continue
            if values.dtype.kind == "f":
                # Dates as numbers, and years of 365 and 366 days, are no line in days.
                dated = _OTHER_TIME.fullmatch(name) and self._moments(name) is not None
                if time.counted and (dated or _DECIMAL_YEAR.fullmatch(name)):
                    left_out[name] = f"is a second time in addition to {time.name!r}"
                elif not time.counted and (part := _part_of(values, time.values)):
                    left_out[name] = f"is the {part} of {time.name!r}"
                continue
            if values.dtype.kind == "m" and not is_time_name(name):
                continue
            moments = self._moments(name)
            if moments is None:
                continue
            still = not _moves(moments.seconds)
            left_out[name] = (
                "is the same time in every row"
                if still
                else f"is a second time in addition to {time.name!r}"
            )
        return replace(time, left_out=left_out)


def _part_of(values: np.ndarray, t: np.ndarray) -> str:
    """Name the part of decimal years that a column says again; "" for none."""
    if np.array_equal(values, np.floor(t)):
        return "whole part"
    # Months are not all of one length.
    month = 12 * np.mod(t, 1) + 0.5
    is_month = np.ptp(month) > 1 and np.all(np.abs(values - month) <= _WITHIN_A_MONTH)
    return "month" if is_month and np.all((values % 1 == 0) & (values > 0)) else ""


def _as_numbers(values: np.ndarray) -> np.ndarray | None:
    if values.dtype.kind != "O" or not len(values):
        return None
    try:
        return as_floats([np.nan if cell is None else float(cell) for cell in values], "t")
    except (TypeError, ValueError, OverflowError, InputError):
        return None


def _first_of_each_form(values: np.ndarray) -> list[int]:
    """Give the first row of each pattern of digits and letters that the cells of a column have."""
    found: dict[str, int] = {}
    for row, cell in enumerate(values):
        found.setdefault(re.sub(r"[^\W\d_]", "a", re.sub(r"\d", "9", str(cell))), row)
    return sorted(found.values())


def _moves(t: np.ndarray) -> bool:
    there = t[np.isfinite(t)]
    return len(there) > 1 and bool(np.any(there != there[0]))


def _rises(t: np.ndarray) -> bool:
    there = t[np.isfinite(t)]
    return len(there) > 1 and bool(np.all(np.diff(there) > 0))


def _finer(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether one of two columns that say the same time says it more finely."""
    counts = len(np.unique(one)), len(np.unique(other))
    if counts[0] != counts[1]:
        return counts[0] > counts[1]
    known = _tells(one, other), _tells(other, one)
    if known[0] != known[1]:
        return known[0]
    # Rounding makes even steps uneven.
    spreads = [np.ptp(steps := np.diff(np.unique(t))) / np.mean(steps) for t in (one, other)]
    return bool(spreads[0] < spreads[1])


def _tells(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether one column, rounded, gives the other."""
    slope, start = np.polyfit(one - one[0], other, 1)
    off = other - (slope * (one - one[0]) + start)
    return bool(np.ptp(off) <= last_digit(other) * (1 + 1e-6))
