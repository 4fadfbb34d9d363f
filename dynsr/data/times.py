"""Times: dates and durations counted in a unit of the size of their steps, and what a name says."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from datetime import time as clock_time
from typing import Any

import numpy as np

_YEAR = 365.25 * 86400.0
# Unit -> its seconds; the longest that the usual step is not shorter than is taken.
_SECONDS = {"years": _YEAR, "days": 86400.0, "h": 3600.0, "min": 60.0, "s": 1.0}
# A year has 365 days or 366.
_SLACK = 0.999
_WORDS = {
    "ns": "ns|nanosec(ond)?s?",
    "µs": "us|µs|μs|micros|microsec(ond)?s?",
    "ms": "ms|msecs?|millis|millisec(ond)?s?",
    "s": "s|secs?|seconds?|sek|sekunden?|secondes?|segundos?|secondi",
    "min": "mins?|minutes?|minuten?|minutos?|minuti",
    "h": "h|hrs?|hours?|std|stunden?|heures?|horas?",
    "days": "d|days?|tage?|jours?|d[ií]as?",
    "weeks": "wk|weeks?|wochen?|semaines?|semanas?",
    "months": "months?|monate?|mois|meses",
    "years": "y|yrs?|years?|jahre?|an(n[ée]e)?s|a[ñn]os?",
}
_SHORTEST = 3
_DAY = 86400.0
_NAMES = (
    r"(?:test|step|total|run|rel(?:\w*)|abs(?:\w*)|record|sampl(?:e|ing)|meas(?:urement)?|"
    r"sim(?:ulation)?|system)[\W_]?time|"
    r"t|ts|(?:unix|epoch|posix).?(?:time|timestamp|seconds)?|times?|timestamps?|time.?stamps?|time.?points?|date.{0,3}time|dates?|elapsed.*|secs?|seconds?|zeit|datum|"
    r"tid|tidspunkt|tidpunkt|dato|klokkesl[æe]t|klokkeslett|klockslag|kl\.?|aika|päivämäärä|kello|"
    r"uhrzeit|zeitpunkt|zeitstempel|tiempo|fecha|hora|temps|heure|tempo|ora|tijd|tijdstip|czas|"
    r"время|дата|时间|時間|日期|日時"
)
# Such as "t [s]", "Zeit (min)", "time_ms", "elapsed time in h", "hours".
_OF_NAME = re.compile(
    rf"(?:(?:{_NAMES})(?:[\W_]+(?:{_NAMES}))*[\W_]+(?:in[\W_]+)?)?[\[(]?(?P<unit>[^\W\d_]+)[\])]?",
    re.IGNORECASE,
)
_NAME = re.compile(rf"(?:{_NAMES})(?:[\W_]+(?:{_NAMES}))*", re.IGNORECASE)
_DATES = re.compile(
    r"(.*(date|datum|fecha|timestamp).*|day|tag|yyyymmdd\w*|yyyyddd|y(ea)?r?.?doy|(date.?)?time)",
    re.IGNORECASE,
)
# Forms of dates without marks between their parts, and their digits.
_COMPACT = (("%Y%j", 7), ("%Y%m%d", 8), ("%Y%m%d%H%M", 12), ("%Y%m%d%H%M%S", 14))
# Years that a number such as 202407 may begin with, and names of such columns.
_YEARS = (1700, 2300)
_OF_YEARS = re.compile(r".*week.*|.*month.*|yyyymm|y+_?m+|period|date")
_SERIALS = re.compile(r".*(date|datum|fecha).*", re.IGNORECASE)
_SPELT = {"s": "seconds", "ms": "milliseconds", "µs": "microseconds", "ns": "nanoseconds"}
_EPOCHS = {"s": 1.0, "ms": 1e3, "µs": 1e6, "ns": 1e9}
_SINCE = tuple(float(np.datetime64(day, "s").astype(int)) for day in ("2000-01-01", "2100-01-01"))
# The day that a spreadsheet counts as 0, in seconds since 1970.
_SERIAL_0 = float(np.datetime64("1899-12-30", "s").astype(int))
_DURATION = re.compile(
    r"-?(\d+ ?d(ays?)?,? )-?\d+:\d\d(:\d\d(\.\d*)?)?|\d+ days?|-\d+:\d\d(:\d\d(\.\d*)?)?|"
    r"P(\d+D)?(T(\d+H)?(\d+M)?(\d+(\.\d+)?S)?)?"
)
# Such as 1h 30m or 2m3.5s.
_IN_PARTS = re.compile(r"(\d+ ?d ?)?(\d+ ?h ?)?(\d+ ?m(in)? ?)?(\d+(\.\d+)? ?s)?")
_CLOCK = (
    r"(?P<h>\d+)[:h](?P<m>\d\d)(?:[:m](?P<s>\d\d))?(?:[.,](?P<f>\d{1,9}))?s?"
    r"\s*(?P<half>[AaPp])?(?(half)\s?\.?\s?[Mm]\.?)"
)
_ZONE = r"\s*(?P<zone>Z|UTC|GMT|[+-]\d\d:?\d\d)?"
_TIME_OF_DAY = re.compile(_CLOCK + _ZONE)
# A name that says minutes and seconds, such as "elapsed (min:s)" or "time mm:ss".
_STOPWATCH = re.compile(r"\b(m{1,2}|min)\s*:\s*(s{1,2}|sec)\b", re.IGNORECASE)
# A word and a number in every cell, such as "Day 3", "week_2", "T12" or "t=0.5 h".
_COUNTED = re.compile(
    r"(?P<word>[^\W\d_]*)[\s_.=:#-]*(?P<number>\d+(?:[.,]\d+)?)\s*(?P<unit>[^\W\d_]*)"
)
_COUNTING = ("", "t", "tp", "time", "timepoint", "point", "zeit", "zeitpunkt")
_QUARTERS = tuple(
    re.compile(form, re.IGNORECASE)
    for form in (
        r"(?P<year>\d{4})[\s./-]*Q(?P<quarter>[1-4])",
        r"Q(?P<quarter>[1-4])[\s./-]*(?P<year>\d{4})",
    )
)
_WEEK = re.compile(r"(?P<year>\d{4})[\s-]*W(?P<week>\d\d)(?:-?(?P<day>[1-7]))?", re.IGNORECASE)
# A clock with points, of three numbers or after a date: 08.05.30, 26-11-2025 08.05.
_DOTTED = re.compile(
    r"^(.*[\s,T_]|(?=\d\d?\.\d\d\.\d\d))(\d\d?)\.([0-5]\d)(?:\.([0-5]\d(?:,\d+)?))?$"
)
_STAMP = re.compile(
    r"(?:[^\W\d]{2,10}\.?,?\s+)?(?P<a>\d{1,4})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<c>\d{2,4})\.?"
    rf"(?:[\s,T_]+{_CLOCK})?{_ZONE}"
)
_MONTHS = {
    "jan": "janv janvier januar ene enero gen gennaio janeiro januari",
    "feb": "févr fév fev février februar febrero febbraio fevereiro februari",
    "mar": "mär mrz märz mars marzo março maart mrt",
    "apr": "abr avr avril abril aprile",
    "may": "mai mayo maj mei mag maggio maio",
    "jun": "juin juni junio giu giugno junho",
    "jul": "juil juillet juli julio lug luglio julho",
    "aug": "ago août aout agosto augustus augusti",
    "sep": "sept set septembre septiembre settembre setembro",
    "oct": "okt out octobre oktober octubre ott ottobre outubro",
    "nov": "noviembre novembre novembro",
    "dec": "dez dic déc décembre dezember diciembre dicembre dezembro desember",
}
_IN_ENGLISH = {own: month for month, names in _MONTHS.items() for own in names.split()}
_MONTH = re.compile(r"[^\W\d]{3,10}\.?")
# Zones by their letters, and hours that they are before the one of Greenwich.
_ZONES = {
    "WET": 0, "WEST": 1, "BST": 1, "CET": 1, "CEST": 2, "MEZ": 1, "MESZ": 2, "EET": 2, "EEST": 3,
    "JST": 9, "AEST": 10, "AEDT": 11, "EST": -5, "EDT": -4, "CST": -6, "CDT": -5, "MST": -7,
    "MDT": -6, "PST": -8, "PDT": -7,
}  # fmt: skip
_BY_LETTERS = re.compile(rf"(?<=\d)\s*({'|'.join(_ZONES)})$")
# What date of Unix prints: Sat Mar 30 00:00:01 CET 2024.
_OF_UNIX = re.compile(r"[A-Z][a-z]{2} ([A-Z][a-z]{2}) +(\d+) (\d+:\d+:\d+)( [A-Z]{3,4})? (\d{4})")
_FULL = re.compile(
    "january|february|march|april|june|july|august|september|october|november|december|"
    "monday|tuesday|wednesday|thursday|friday|saturday|sunday"
)
# A month and a day without a year, or a year without a day: Jan-26, 26. Jan, Jan '26.
_MONTH_AND_NUMBER = re.compile(
    r"(?:(?P<before>\d{1,2})[\s./-]+)?(?P<month>[^\W\d]{3,9})\.?(?(before)|[\s./'-]+(?P<behind>\d{1,2}))"
)
# A month by its name between a day and a year of two digits: 14Mar11, 11-Mar-14, 14MAR2011:09:00.
_MONTH_BETWEEN = re.compile(
    r"(?P<first>\d{1,4})[\s./-]*(?P<month>[^\W\d]{3,9})\.?[\s./-]*(?P<last>\d{2,4})(?:[\s,:T_]+(?P<rest>\d.*))?"
)
_YEAR_FIRST = re.compile(r"y+[\W_]*m+[\W_]*d+.*", re.IGNORECASE)
# Years of days without a year count from a year of 365 days.
_NO_YEAR = 2001
# Names that begin again when all of them have gone by, and what they are called.
_CYCLES = {
    "months": tuple(_MONTHS),
    "days": ("mon", "tue", "wed", "thu", "fri", "sat", "sun"),
    "quarters": ("q1", "q2", "q3", "q4"),
}
# A record that pauses so many times longer if days are read as months is read the other way.
_PAUSE = 10.0


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
    return count_seconds(seconds, np.diff(seconds))


def count_seconds(seconds: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, str]:
    """Give seconds in the unit of their usual step, and that unit.

    Parameters
    ----------
    seconds : (n,) times.
    steps : the steps between them within trajectories; those that are not above 0 do not count.

    >>> count_seconds(np.array([0.0, 600.0, 1200.0]), np.array([600.0, 600.0]))
    (array([ 0., 10., 20.]), 'min')
    """
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

    >>> [unit_in_name(name) for name in ("t [s]", "Zeit (min)", "time_ms", "hours", "t", "dates")]
    ['s', 'min', 'ms', 'h', '', '']
    """
    found = _OF_NAME.fullmatch(name.strip())
    word = found["unit"] if found else ""
    if word == name.strip() and len(word) < _SHORTEST:  # "y" and "d" are states more often
        return ""
    return next((u for u, words in _WORDS.items() if re.fullmatch(words, word, re.IGNORECASE)), "")


def is_time_name(name: str) -> bool:
    """Whether a column of that name may be the time.

    >>> [is_time_name(name) for name in ("t", "Date/Time", "Datum Uhrzeit", "temperature")]
    [True, True, True, False]
    """
    return _NAME.fullmatch(name.strip(" _")) is not None


@dataclass(frozen=True, eq=False)
class Moments:
    """Cells that were read as dates or durations.

    Parameters
    ----------
    values : (n,) dates or durations of NumPy, NaT where a cell is empty.
    written : what they were, for a sentence; "" where it goes without saying.
    clock : whether they are times of the day alone.
    cyclic : whether they are names that come again, such as those of months.
    """

    values: np.ndarray
    written: str = ""
    clock: bool = False
    cyclic: bool = False

    @property
    def days_only(self) -> bool:
        """Whether they are dates without a time of the day."""
        if self.values.dtype.kind != "M":
            return False
        there = self.values[~np.isnat(self.values)]
        return bool(np.all(there == there.astype("datetime64[D]")))

    @property
    def first(self) -> tuple[str, float] | None:
        """What seconds are counted from: a date, in seconds since 1970, or the start of a day."""
        if self.clock:
            return ("clock", 0.0)
        if self.values.dtype.kind != "M" or self.cyclic:
            return None
        first = np.min(self.values[~np.isnat(self.values)])
        return ("date", float((first - np.datetime64(0, "s")) / np.timedelta64(1, "s")))

    @property
    def seconds(self) -> np.ndarray:
        """(n,) seconds, of dates from the first one on; NaN where a cell is empty."""
        values = self.values
        if values.dtype.kind == "M":
            values = values - np.min(values[~np.isnat(values)])
        return np.asarray(values / np.timedelta64(1, "s"), dtype=float)


def read_numbers_as_dates(numbers: np.ndarray, name: str) -> Moments | None:
    """Read numbers as dates where their name and their size say so; None where they are not.

    Parameters
    ----------
    numbers : (n,) cells; NaN where empty.
    name : that of the column, which must speak of times.

    Read are 20241231, 2024366, 202412311405 and 20241231140500; seconds, milli-, micro- and
    nanoseconds since 1970 of this century; and days as spreadsheets count them.

    >>> read_numbers_as_dates(np.array([1.7e12, 1.7e12 + 250]), "timestamp").seconds
    array([0.  , 0.25])
    """
    there = numbers[np.isfinite(numbers)]
    if not len(there) or there.min() < 1e4:
        return None
    whole = bool(np.all(there % 1 == 0))
    years = there // 100
    if whole and np.all((years >= _YEARS[0]) & (years <= _YEARS[1])):
        parts = _read_year_and_part(numbers, name)
        if parts is not None:
            return Moments(parts)
    if whole and _DATES.fullmatch(name.strip()):
        for form, digits in _COMPACT:
            century = there // 10.0 ** (digits - 2)
            if np.all((century >= 10) & (century < 30)):
                found = _read_compact(numbers, form)
                if found is not None:
                    return Moments(found)
    unit = unit_in_name(name)
    if is_time_name(name) or unit in _EPOCHS:
        for scale, size in _EPOCHS.items():
            low, high = there.min() / size, there.max() / size
            if unit in ("", scale) and _SINCE[0] <= low and high < _SINCE[1]:
                # Whole numbers of a unit are kept to the last one; float64 holds no more.
                ticks = np.where(np.isfinite(numbers), numbers, 0.0)
                own = np.round(ticks * (1e9 / size)) if not whole else ticks
                dates = own.astype("int64") * (int(1e9 / size) if whole else 1)
                stamps = dates.astype("datetime64[ns]")
                stamps[~np.isfinite(numbers)] = np.datetime64("NaT")
                return Moments(stamps, f"{_SPELT[scale]} since 1970")
    if _SERIALS.fullmatch(name.strip()):
        low, high = (_SERIAL_0 + _DAY * end for end in (there.min(), there.max()))
        if _SINCE[0] <= low and high < _SINCE[1]:
            return Moments(_from_seconds(numbers * _DAY + _SERIAL_0), "days since 1900")
    return None


def read_dotted_clocks(numbers: np.ndarray, name: str) -> Moments | None:
    """Read numbers such as 17.55 as hours and minutes, as Danes, Finns and Italians write them.

    Parameters
    ----------
    numbers : (n,) cells; NaN where empty.
    name : that of the column, which must speak of times and name no unit.

    All are times of a day, and their steps are even as such and uneven as numbers.

    >>> read_dotted_clocks(np.array([8.4, 8.5, 9.0, 9.1]), "Tid").seconds / 60
    array([520., 530., 540., 550.])
    """
    there = numbers[np.isfinite(numbers)]
    if len(there) < 2 or not is_time_name(name) or unit_in_name(name):
        return None
    digits = np.round(100 * there)
    hours, minutes = digits // 100, digits % 100
    of_day = np.all((hours >= 0) & (hours < 24) & (minutes < 60))
    if not of_day or not np.allclose(digits, 100 * there, rtol=0, atol=1e-6):
        return None
    steps = [
        np.diff(own) % (24 * hour) for own, hour in ((60 * hours + minutes, 60), (digits, 100))
    ]
    counts = [len(np.unique(own)) for own in steps]
    if not counts[0] == 1 < counts[1]:
        return None
    seconds = np.full(len(numbers), np.nan)
    seconds[np.isfinite(numbers)] = 60.0 * (60 * hours + minutes)
    ticks = np.where(np.isfinite(seconds), seconds, 0.0).astype("timedelta64[s]")
    ticks[~np.isfinite(seconds)] = np.timedelta64("NaT")
    shown = f"{hours[-1]:.0f}.{minutes[-1]:02.0f}"
    return Moments(ticks, f"hours and minutes, such as {shown} for {shown.replace('.', ':')}", True)


def read_nanoseconds(cells: np.ndarray, name: str) -> Moments | None:
    """Read whole numbers as nanoseconds since 1970, all of which float64 would round.

    Parameters
    ----------
    cells : (n,) objects.
    name : that of the column, which must speak of times.

    >>> cells = np.array([1700000000000000001, 1700000000000000003], dtype=object)
    >>> read_nanoseconds(cells, "t").values.astype("int64") % 10
    array([1, 3])
    """
    if not is_time_name(name) or not all(isinstance(c, (int, np.integer)) for c in cells):
        return None
    low, high = (int(end * 1e9) for end in _SINCE)
    if not all(low <= cell < high for cell in cells.tolist()):
        return None
    stamps = np.array(cells.tolist(), dtype="int64").astype("datetime64[ns]")
    return Moments(stamps, "nanoseconds since 1970")


def _from_seconds(seconds: np.ndarray) -> np.ndarray:
    """Give dates of seconds since 1970, to the millisecond."""
    there = np.isfinite(seconds)
    found = np.round(np.where(there, seconds, 0.0) * 1e3).astype("int64").astype("datetime64[ms]")
    found[~there] = np.datetime64("NaT")
    return found


def _read_year_and_part(numbers: np.ndarray, name: str) -> np.ndarray | None:
    """Read 202407 as a month, or as a week where the name says so, as the day it begins."""
    called = name.strip().lower()
    part = numbers[np.isfinite(numbers)] % 100
    longest = 53 if "week" in called else 12
    if not _OF_YEARS.fullmatch(called) or np.any((part < 1) | (part > longest)):
        return None
    found = np.full(len(numbers), np.datetime64("NaT"), dtype="datetime64[ms]")
    there = np.isfinite(numbers)
    years = numbers[there] // 100
    found[there] = first_of_weeks(years, part) if longest > 12 else _first_of_months(years, part)
    return found


def _first_of_months(years: np.ndarray, months: np.ndarray) -> np.ndarray:
    return (12 * (years - 1970) + months - 1).astype("datetime64[M]").astype("datetime64[ms]")


def first_of_weeks(years: np.ndarray, weeks: np.ndarray) -> np.ndarray:
    """Give the Monday of each week (n,) of years (n,), as ISO 8601 counts them.

    >>> first_of_weeks(np.array([2020.0, 2021.0]), np.array([53.0, 1.0])).astype("datetime64[D]")
    array(['2020-12-28', '2021-01-04'], dtype='datetime64[D]')
    """
    fourth = (years - 1970).astype("datetime64[Y]").astype("datetime64[D]") + 3
    # The fourth of January is in the first week; the first of 1970 was a Thursday.
    weekday = (fourth.astype(int) + 3) % 7
    days = (7 * (weeks - 1) - weekday).astype("timedelta64[D]")
    return np.asarray((fourth + days).astype("datetime64[ms]"))


def _read_compact(numbers: np.ndarray, form: str) -> np.ndarray | None:
    import pandas

    cells = [f"{number:.0f}" if np.isfinite(number) else None for number in numbers]
    found: np.ndarray | None = _attempt(lambda: pandas.to_datetime(cells, format=form).to_numpy())
    return found


def check_time_unit(text: object) -> str:
    r"""Give a unit of time back where it is one that is known, else "".

    >>> check_time_unit("days"), check_time_unit("days\nimport os")
    ('days', '')
    """
    return str(text) if text in _WORDS else ""


def read_counted(cells: np.ndarray) -> tuple[np.ndarray, list[str]] | None:
    """Read cells of a word and a number, such as "Day 3" or "T12"; None where they are not.

    Parameters
    ----------
    cells : (n,) objects; empty ones are NaN.

    Gives the (n,) numbers, and the unit of each cell that is not empty, "" where the word is no
    unit.

    >>> read_counted(np.array(["Day 0", "Day 7", "Day 14"], dtype=object))
    (array([ 0.,  7., 14.]), ['days', 'days', 'days'])
    """
    found = [
        None if _is_missing(cell) else _COUNTED.fullmatch(cell.strip())
        for cell in cells
        if _is_missing(cell) or isinstance(cell, str)
    ]
    there = [match for match in found if match is not None]
    empty = sum(map(_is_missing, cells))
    if not there or len(there) + empty < len(cells):
        return None
    units = []
    for match in there:
        before, after = _unit_of_word(match["word"]), _unit_of_word(match["unit"])
        plain = match["word"].lower() in _COUNTING
        if (match["unit"] and not after) or not (plain or before) or (before and after):
            return None
        units.append(before or after)
    values = np.full(len(cells), np.nan)
    values[[not _is_missing(cell) for cell in cells]] = [
        float(match["number"].replace(",", ".")) for match in there
    ]
    return values, units


def _unit_of_word(word: str) -> str:
    return next((u for u, words in _WORDS.items() if re.fullmatch(words, word, re.IGNORECASE)), "")


def read_times(cells: np.ndarray, name: str = "") -> Moments | None:
    """Read cells that are dates or durations, as text or objects; None where they are not.

    Parameters
    ----------
    cells : (n,) objects.
    name : that of the column, which may say that a clock shows minutes and seconds.

    ISO 8601 is read; dates of numbers between points, slashes or hyphens, whose day and month are
    distinguished by all of them together; names of months; clocks of 12 or 24 hours, alone or after
    a date; and durations as pandas writes them, such as "1 days 02:00:00". Empty cells are NaT.

    >>> read_times(np.array(["3/12/24 1:59 PM", "3/13/24 2:00 AM"], dtype=object)).seconds
    array([    0., 43260.])
    """
    if cells.dtype.kind == "M" and np.datetime_data(cells.dtype)[0] in ("Y", "M"):
        return Moments(cells.astype("datetime64[s]"))  # months are of no fixed length
    if cells.dtype.kind in "mM":
        return Moments(cells)
    there = [cell for cell in cells if not _is_missing(cell)]
    if not there:
        return None
    if all(isinstance(cell, (timedelta, np.timedelta64)) for cell in there):
        return Moments(np.array([_or_nat(c, "m") for c in cells], dtype="timedelta64[ns]"))
    if all(isinstance(cell, clock_time) for cell in there):
        texts = [None if _is_missing(cell) else cell.isoformat() for cell in cells]
        return _read_clocks(texts, name)
    if all(isinstance(cell, date) for cell in there):
        import pandas

        read = _attempt(lambda: pandas.to_datetime(list(cells), utc=True))
        return None if read is None else Moments(read.tz_localize(None).to_numpy())
    if not all(isinstance(cell, str) for cell in there):
        return None
    texts = [None if _is_missing(cell) else cell.strip() for cell in cells]
    named = _read_names(texts)
    if named is not None or not any(map(str.isdigit, there[0])):
        return named
    return _read_text(texts, name)


def _is_missing(cell: Any) -> bool:
    return cell is None or cell == "" or bool(cell != cell)  # noqa: PLR0124


def _or_nat(cell: Any, kind: str) -> Any:
    return np.timedelta64("NaT") if _is_missing(cell) else np.timedelta64(cell)


def _in_usual_form(text: str) -> str:
    """Write what other programs and languages have between the parts of a time as most do.

    >>> [_in_usual_form(t) for t in ("2024/03/30-10:11", "0:00:01:500", "2024-03-30 10:11 CET")]
    ['2024/03/30 10:11', '0:00:01.500', '2024-03-30 10:11+01:00']
    """
    text = _OF_UNIX.sub(r"\2 \1 \5 \3\4", text)
    text = re.sub(r"(\d{4})\s*[年년]\s*(\d+)\s*[月월]\s*(\d+)\s*[日일]", r"\1-\2-\3", text)
    text = re.sub(r"(?<=[\w.]) de (?=\w)", " ", text)
    text = re.sub(r"(?<=[./-]\d\d)-(?=\d\d:\d\d)", " ", text)
    text = re.sub(r"^(\d+:\d\d:\d\d):(\d{3})$", r"\1.\2", text)
    return _BY_LETTERS.sub(lambda zone: f"{_ZONES[zone[1]]:+03d}:00", text)


def _read_text(texts: list[str | None], name: str) -> Moments | None:
    texts = [None if text is None else _in_usual_form(text) for text in texts]
    found = _read_clocks(texts, name)
    if found is not None:
        return found
    import pandas

    first = next(text for text in texts if text)
    if _DURATION.fullmatch(first):
        whole = [c if c is None else re.sub(r"(?<=\d) ?d(?=,? )", " days", c) for c in texts]
        full = [c if c is None or c.count(":") != 1 else f"{c}:00" for c in whole]
        read = _attempt(lambda: pandas.to_timedelta(full).to_numpy())
        return None if read is None else Moments(read)
    counted = read_counted(np.array(texts, dtype=object))
    if counted is not None and len(set(counted[1])) > 1 and set(counted[1]) <= set(_SECONDS):
        values = np.full(len(texts), np.timedelta64("NaT"), dtype="timedelta64[ns]")
        there = np.isfinite(counted[0])
        sizes = np.array([_SECONDS[unit] for unit in counted[1]])
        values[there] = np.round(counted[0][there] * sizes * 1e9).astype("int64")
        return Moments(values)
    if counted is None and all(text is None or _IN_PARTS.fullmatch(text) for text in texts):
        read = _attempt(lambda: pandas.to_timedelta(texts).to_numpy())
        return None if read is None else Moments(read)
    stamps = _read_stamps(texts)
    dotted = [None if text is None else _DOTTED.sub(r"\1\2:\3:\4", text) for text in texts]
    if all(text is None or text != new for text, new in zip(texts, dotted, strict=True)):
        dotted = [None if text is None else text.removesuffix(":") for text in dotted]
        clocks = _read_text(dotted, name)
        # Of a clock and a date, the one whose steps are all alike.
        if clocks is not None and (stamps is None or _count_steps(clocks.values) == 1):
            return clocks
    if stamps is None:
        stamps = _read_parts_of_years(texts)
    if stamps is None:
        stamps = _attempt(
            lambda: pandas.to_datetime(texts, format="ISO8601", utc=True).tz_localize(None)
        )
    if stamps is None and _MONTH.search(first) and sum(map(str.isdigit, first)) > 1:
        english = [None if text is None else _MONTH.sub(_in_english, text) for text in texts]
        months = _read_months(english)
        if months is not None:
            return months
        between = _read_month_between(texts, name)
        if between is not None:
            return between
        if all(text is None or _has_month(text) for text in english):
            stamps = _attempt(
                lambda: pandas.to_datetime(english, format="mixed", dayfirst=True, utc=True)
            )
            stamps = None if stamps is None else stamps.tz_localize(None)
            # A year of two digits right behind a day makes a year of four.
            far = stamps is not None and not _YEARS[0] <= stamps.year.min() <= _YEARS[1]
            stamps = None if far else stamps
    return None if stamps is None else Moments(np.asarray(stamps))


def _count_steps(values: np.ndarray) -> int:
    return len(np.unique(np.diff(values)))


def _in_english(found: re.Match[str]) -> str:
    word = found[0].rstrip(".").lower()
    return _IN_ENGLISH.get(word, word)


def _has_month(text: str) -> bool:
    return any(word[:3] in _MONTHS for word in map(str.lower, _MONTH.findall(text)))


def _read_months(texts: Sequence[str | None]) -> Moments | None:
    """Read months with a number of at most two digits, such as Jan-26 and 26. Jan; None for others.

    The number is a year where every date has another month than the one before, else a day. Days
    go on in the next year after New Year; which year that is nothing says.
    """
    there = [text for text in texts if text is not None]
    found = {text: _MONTH_AND_NUMBER.fullmatch(text) for text in dict.fromkeys(there)}
    if not all(found.values()):
        return None
    months, numbers = np.array([_month_and_number(m) for m in found.values() if m]).T
    if np.any(months == 0):
        return None
    ones, steps = np.ones(len(months), dtype=int), np.diff(12 * numbers + months)
    if np.all(np.diff(months) != 0) and (np.all(steps > 0) or np.all(steps < 0)):
        dates, written = _as_dates(np.column_stack([numbers, months, ones]), "ymd"), ""
    else:
        written = "days without a year"
        turns = np.diff(months)
        later = np.cumsum(np.append(0, (turns < -6).astype(int) - (turns > 6)))
        # The first year that has all of these days.
        tried = (
            _as_dates(np.column_stack([year + later, months, numbers]), "ymd")
            for year in range(_NO_YEAR, _NO_YEAR + 4)
        )
        dates = next((days for days in tried if days is not None), None)
    if dates is None:
        return None
    by_text = dict(zip(found, dates, strict=True))
    nowhere = np.datetime64("NaT", "ns")
    values = np.array([nowhere if text is None else by_text[text] for text in texts])
    return Moments(values, written)


def _read_month_between(texts: Sequence[str | None], name: str) -> Moments | None:
    """Read dates whose month is a name between the day and the year, of which either may be first.

    It is the day where nothing shows it: neither that the dates rise, nor the name of the column.
    """
    found = [None if text is None else _MONTH_BETWEEN.fullmatch(text) for text in texts]
    if any(text is not None and match is None for text, match in zip(texts, found, strict=True)):
        return None
    if not all(month_of(match["month"]) for match in found if match):
        return None
    numbers = [
        m and f"{m['first']}.{month_of(m['month'])}.{m['last']} {m['rest'] or ''}".strip()
        for m in found
    ]
    orders = ("ymd",) if _YEAR_FIRST.fullmatch(name) else ("dmy", "ymd")
    stamps, shown = _read_stamps(numbers, orders), ""
    if stamps is None and (stamps := _read_stamps(numbers, orders[:1])) is not None:
        row = next(i for i, text in enumerate(texts) if text is not None)
        shown = f"dates such as {texts[row]!r}, which was read as {str(stamps[row])[:10]}"
    return None if stamps is None else Moments(stamps, shown)


def _month_and_number(found: re.Match[str]) -> tuple[int, int]:
    """Give the month, 0 for none, and the number next to it."""
    name = found["month"][:3].lower()
    return month_of(name), int(found["before"] or found["behind"])


def month_of(text: str) -> int:
    """Give the number of a month by its name, such as 5 for May; 0 for another word.

    >>> month_of("May"), month_of("märz"), month_of("Mayor"), month_of("x")
    (5, 3, 0, 0)
    """
    return _place(text, tuple(_MONTHS)) + 1


def _place(text: str, names: Sequence[str]) -> int:
    """Give the place of a name among those of a cycle, also where it is written in full, or -1."""
    word = _in_english(found) if (found := _MONTH.fullmatch(text)) else text.lower()
    short = word[:3] if _FULL.fullmatch(word) or len(word) == _SHORTEST else word
    return names.index(short) if short in names else -1


def _read_names(texts: Sequence[str | None]) -> Moments | None:
    """Read names of months, days or quarters one after the other; None for others.

    The next year or week begins where the names begin again. Which one it is nothing says.
    """
    there = [text for text in texts if text is not None]
    for called, names in _CYCLES.items():
        places = np.array([_place(text, names) for text in there])
        if np.any(places < 0):
            continue
        steps = np.diff(places) % len(names)
        if not len(steps) or np.any(steps == 0) or np.median(steps) > len(names) / 2:
            return None
        counts = places[0] + np.append(0, np.cumsum(steps))
        unit = "D" if called == "days" else "M"
        sizes = counts * (3 if called == "quarters" else 1)
        first = np.array(f"{_NO_YEAR}-01-01", dtype=f"datetime64[{unit}]")  # a Monday
        values = np.full(len(texts), np.datetime64("NaT"), dtype="datetime64[ms]")
        values[[text is not None for text in texts]] = first + sizes.astype(f"timedelta64[{unit}]")
        words = f"names of {called}, which are counted on from row to row"
        return Moments(values, words, cyclic=True)
    return None


def _read_parts_of_years(texts: Sequence[str | None]) -> np.ndarray | None:
    """Read quarters and weeks of years, such as 2021-Q3 and 2021-W07, as the day they begin."""
    for pattern in (*_QUARTERS, _WEEK):
        found = [None if text is None else pattern.fullmatch(text) for text in texts]
        if any(t is not None and m is None for t, m in zip(texts, found, strict=True)):
            continue
        days: list[date | None] = []
        for match in found:
            if match is None:
                days.append(None)
            elif pattern is not _WEEK:
                days.append(date(int(match["year"]), 3 * int(match["quarter"]) - 2, 1))
            else:
                try:
                    days.append(
                        date.fromisocalendar(
                            int(match["year"]), int(match["week"]), int(match["day"] or 1)
                        )
                    )
                except ValueError:  # there is no such week
                    return None
        return np.array(days, dtype="datetime64[D]").astype("datetime64[ms]")
    return None


def _read_clocks(texts: Sequence[str | None], name: str = "") -> Moments | None:
    """Read times of the day, or of a stopwatch: 14:05, 2:05 PM, 0:31.25."""
    found = [None if text is None else _TIME_OF_DAY.fullmatch(text) for text in texts]
    if any(text is not None and match is None for text, match in zip(texts, found, strict=True)):
        return None
    seconds = [np.nan if match is None else _seconds_of(match) for match in found]
    if any(np.isinf(seconds)):
        return None
    two = all(m is None or (m["s"] is None and not m["f"] and not m["half"]) for m in found)
    minutes = two and _STOPWATCH.search(name) is not None
    if minutes:
        seconds = [second / 60.0 for second in seconds]
    values = np.full(len(seconds), np.timedelta64("NaT"), dtype="timedelta64[ns]")
    there = np.isfinite(seconds)
    values[there] = np.round(np.array(seconds)[there] * 1e9).astype("int64")
    within = bool(np.all(np.array(seconds)[there] < _DAY))
    if minutes:
        return Moments(values, "minutes and seconds")
    # A count from 0:00, or beyond a day, may be one of minutes and seconds too.
    elapsed = two and (not within or np.array(seconds)[there][0] == 0)
    written = "hours and minutes; if these are minutes and seconds, call it 'time (min:s)'"
    return Moments(values, written if elapsed else "", clock=within)


def _seconds_of(match: re.Match[str]) -> float:
    """Give the seconds of a clock; infinite where there is no such time."""
    hours, minutes, seconds = int(match["h"]), int(match["m"]), int(match["s"] or 0)
    if match["half"]:
        if not 1 <= hours <= 12:
            return np.inf
        hours = hours % 12 + 12 * (match["half"] in "pP")
    if minutes > 59 or seconds > 60:
        return np.inf
    fraction = float(f"0.{match['f'] or 0}")
    if match["f"] and match["s"] is None:  # of two numbers the first are then minutes
        return 60.0 * hours + minutes + fraction
    return 3600.0 * hours + 60.0 * minutes + seconds + fraction


def _read_stamps(
    texts: Sequence[str | None], allowed: Sequence[str] = ("dmy", "mdy", "ymd")
) -> np.ndarray | None:
    """Read dates of three numbers, with a clock or without, in the one order that they allow."""
    found = [None if text is None else _STAMP.fullmatch(text) for text in texts]
    if any(text is not None and match is None for text, match in zip(texts, found, strict=True)):
        return None
    there = [match for match in found if match is not None]
    numbers = np.array([[int(m["a"]), int(m["b"]), int(m["c"])] for m in there])
    clocks = np.array([_seconds_of(m) if m["h"] else 0.0 for m in there])
    if not np.all(clocks < _DAY):
        return None
    clocks -= np.array([_offset(m["zone"]) for m in there])
    first, last = ({len(m[part]) for m in there} for part in "ac")
    if first == {4}:
        orders = ["ymd"]
    elif 4 in first or 3 in last or len(last) > 1:
        return None
    else:
        orders = ["dmy", "mdy"] + ["ymd"] * (last == {2} and first == {2})
        # Nobody writes the month first between points.
        orders = [o for o in orders if o != "mdy" or there[0]["mark"] != "."]
    ticks = np.round(clocks * 1e9).astype("int64").astype("timedelta64[ns]")
    read = [_as_dates(numbers, order) for order in orders if order in allowed]
    dates = _choose([days + ticks for days in read if days is not None])
    if dates is None:
        return None
    every = np.full(len(texts), np.datetime64("NaT"), dtype="datetime64[ns]")
    every[[match is not None for match in found]] = dates
    return every


def _offset(zone: str | None) -> float:
    """Give the seconds that a zone is ahead of UTC."""
    if not zone or zone[0] not in "+-":
        return 0.0
    ahead = 3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:])
    return -ahead if zone[0] == "-" else ahead


def _as_dates(numbers: np.ndarray, order: str) -> np.ndarray | None:
    """Give the dates of three numbers in an order; None where one is no date."""
    years, months, days = (numbers[:, order.index(part)] for part in "ymd")
    # As POSIX counts years of two digits.
    years = np.where(years < 69, years + 2000, np.where(years < 100, years + 1900, years))
    if np.any((months < 1) | (months > 12) | (days < 1)):
        return None
    month = (12 * (years - 1970) + months - 1).astype("datetime64[M]")
    found = month.astype("datetime64[D]") + (days - 1).astype("timedelta64[D]")
    same = found.astype("datetime64[M]") == month
    return found.astype("datetime64[ns]") if np.all(same) else None


def _choose(readings: Sequence[np.ndarray]) -> np.ndarray | None:
    """Choose among dates in several orders: those that rise, and that do not pause."""
    different: dict[bytes, np.ndarray] = {}
    for dates in readings:  # the same times from the first on are the same to us
        different.setdefault((dates - dates[0]).tobytes(), dates)
    left = list(different.values())
    if len(left) > 1:
        falls = [int(np.sum(np.diff(dates) < np.timedelta64(0))) for dates in left]
        left = [dates for dates, often in zip(left, falls, strict=True) if often == min(falls)]
    if len(left) > 1:
        pauses = [_longest_pause(dates) for dates in left]
        left = [d for d, pause in zip(left, pauses, strict=True) if pause < _PAUSE * min(pauses)]
    return left[0] if len(left) == 1 else None


def _longest_pause(dates: np.ndarray) -> float:
    """Give the longest step, in usual ones; in nanoseconds where dates repeat without a clock."""
    steps = np.diff(dates).astype(float)
    again = bool(np.any(steps == 0))
    steps = steps[steps > 0]
    if not steps.size:
        return 1.0
    return float(steps.max() / (1.0 if again else np.median(steps)))


def _attempt(read: Any) -> Any:
    try:
        return read()
    except (ValueError, TypeError, OverflowError):
        return None
