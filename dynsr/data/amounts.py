"""Amounts: what the text of one cell says: a number, perhaps beyond a limit or with a unit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

# What people and programs write where there is no value; compared without case.
_NOTHING = """
nan n/a na <na> n.a. n.a n.d. n.d nd n.m. k.a. null none
nil missing void
. .. ... - -- --- \u2013 \u2014 ? ?? * ** *** #n/a #na #nv #div/0! #value! #ref! #num!
#name? #null! #wert! #zahl! #bezug! -nan nan(ind) -nan(ind) 1.#qnan 1.#ind -1.#ind
"""
# What says that a value was below the limit of its measurement, which is not written.
_BELOW = "bdl bld b.d.l. blq bql bloq lod loq <lod <loq <lloq <dl <ld <lq <mdl"
_BELOW_WORDS = (
    "below detection limit",
    "below limit of detection",
    "below quantification limit",
    "below limit of quantification",
    "below lod",
    "below loq",
    "not detected",
)
BELOW = frozenset((*_BELOW_WORDS, *_BELOW.split()))
_NO_WORDS = (
    "not determined",
    "not measured",
    "not available",
    "not sampled",
    "no sample",
    "sample lost",
    "no data",
)
# What says that a value was beyond the end of the range, which is not written.
_ABOVE = "overflow ovrflw overrange >max tntc"
_ABOVE_WORDS = ("over range", "out of range high", "too numerous to count", "too many to count")
ABOVE = frozenset((*_ABOVE_WORDS, *_ABOVE.split()))
MISSING = frozenset(("", *_NO_WORDS, *_NOTHING.split(), *BELOW, *ABOVE))
_SPACES = " \u00a0\u202f\u2009"
_CELL = re.compile(
    r"""(?P<limit>[<>≤≥]=?|=[<>])?\s*(?P<money>[$€£¥])?\s*(?P<sign>[-+\u2212]?)
    (?P<body>(?:[0-9]|[.,](?=[0-9]))(?:[0-9.,'\u2019 \u00a0\u202f\u2009]*[0-9])?[.,]?)
    (?P<power>[eEdD][-+\u2212]?[0-9]+)?
    (?P<gap>\s*)(?P<unit>[^\d\s.,'\u2019:;<>=+/_-][^:;<>=,]{0,23})?""",
    re.VERBOSE,
)
_BASE = (
    r"(?:(?:da|[pnuµμmcdhkMGT])?(?:s|m|g|L|l|M|mol|A|V|W|J|N|Pa|bar|K|Hz|cd|lm|lx|Ohm|ohm|Ω|S|H|F|"
    r"T|C|Wb|eV|Wh|cal|U|IU|Da|Bq|Sv|Gy|OD|rad|sr|B|b|atm|ppm|ppb|VA|Ah|gal|in|ft|lb)"
    r"|secs?|seconds?|mins?|minutes?|hr?s?|hours?|d|days?|wks?|weeks?|months?|yrs?|years?"
    r"|°\s?[CFKR]?|º\s?[CF]?|deg\s?[CF]?|℃|℉|%|‰|percent|pct|rpm|cps|cfu|CFU|pfu|PFU|cells?|counts?"
    r"|ind|px|NTU|dB|dBm|psi|torr|Torr|mmHg|inHg|mi|mph|kn|knots?|oz|lux|au|a\.u\.|AU|RFU|RLU|pH"
    r"|degrees?(?: (?:celsius|Celsius|fahrenheit|Fahrenheit))?|celsius|Celsius|kelvin|Kelvin|volts?"
    r"|amp(?:ere)?s?|watts?|(?:milli|centi|kilo)?met(?:er|re)s?|(?:milli)?lit(?:er|re)s?"
    r"|(?:milli|kilo)?grams?|pascals?|eq|ppt|units?|USD|EUR|GBP|[$€£¥])"
)
_UNIT = re.compile(
    rf"(?:1\s*/\s*)?{_BASE}(?:\^?[-\u2212]?[\d²³⁻¹]+)?(?:\s*[/*·.\s]\s*\(?{_BASE}\)?(?:\^?[-\u2212]?[\d²³⁻¹]+)?)*"
)
_LONGEST_UNIT = 24
# A power as people write it, such as 1.2x10^5. A sign behind the number, as accounts have it.
_POWER = re.compile(
    r"(?<=\d)\s*[x\u00d7\u00b7\u22c5*]\s*10\s*(?:(?:\^|\*\*)\s*\(?(?P<plain>[-+\u2212]?\d{1,3})\)?"
    r"|(?P<raised>[\u207b\u207a]?[\u2070\u00b9\u00b2\u00b3\u2074-\u2079]{1,3}))"
)
_RAISED = str.maketrans(
    "\u207b\u207a\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079", "-+0123456789"
)
_BEHIND = re.compile(r"(?P<number>\d[\d.,]*)(?P<sign>[-\u2212])")
# Where a number is too wide for its column, programs in Fortran fill that with stars.
_STARS = re.compile(r"\*+")
_MARKED = re.compile(r"\s*[~\u2248]?\s*(?P<number>\S*\d)\s*[*\u2020\u2021\u00a7]{0,3}\s*")
# Fortran leaves the E of an exponent of three digits out.
_WIDE_POWER = re.compile(r"([-+]?\d?\.\d{3,})([-+][1-3]\d\d)")
# A number that a spreadsheet was made to keep as text: ="0.50", '0.50.
_AS_TEXT = re.compile(r"^=\"(.*)\"$|^'(?=[-+.,\d])(.*)$")
# A word behind a number that makes it a time of a day or a date.
_CALENDAR = re.compile(
    r"[ap]\.?\s?m\.?|h\d\d|jan|feb|mar|m[äa]r|apr|ma[iy]|jun|jul|aug|sep|o[ck]t|nov|de[cz]",
    re.IGNORECASE,
)


def is_unit(text: str) -> bool:
    """Whether a text is a unit that is known, such as "mg/L" or "m s^-1".

    >>> [is_unit(text) for text in ("mg/L", "°C", "%", "h", "biomass", "a")]
    [True, True, True, True, False, False]
    """
    return len(text) <= _LONGEST_UNIT and _UNIT.fullmatch(text.strip()) is not None


def is_missing(cell: Any) -> bool:
    """Whether a cell says that there is no value.

    >>> [is_missing(cell) for cell in ("n.d.", "#N/A", "", None, "0", "none at all")]
    [True, True, True, True, False, False]
    """
    if isinstance(cell, str):
        text = cell.strip()
        named = text.lower() in MISSING or _STARS.fullmatch(text) is not None
        return named or says_below(cell) or says_above(cell)
    try:
        return cell is None or bool(cell != cell)  # noqa: PLR0124
    except (TypeError, ValueError):  # pandas.NA, or a cell that holds several values
        return type(cell).__name__ == "NAType"


def says_below(cell: Any) -> bool:
    """Whether a cell says that the value is below a limit that is not written.

    >>> [says_below(cell) for cell in ("BDL", "< LOD", "n.d.", "<0.5", None)]
    [True, True, False, False, False]
    """
    return isinstance(cell, str) and " ".join(cell.lower().split()).replace("< ", "<") in BELOW


def says_above(cell: Any) -> bool:
    """Whether a cell says that the value is above the end of the range, which is not written.

    >>> [says_above(cell) for cell in ("OVRFLW", "Over range", "overcast", None)]
    [True, True, False, False]
    """
    return isinstance(cell, str) and " ".join(cell.lower().split()) in ABOVE


@cache
def _shape(mark: str) -> re.Pattern[str]:
    """What a number without sign and exponent looks like where this is the decimal mark."""
    other = "," if mark == "." else "."
    group = rf"[1-9][0-9]{{0,2}}(?:(?P<g>[{other}'\u2019{_SPACES}])[0-9]{{3}})(?:(?P=g)[0-9]{{3}})*"
    point = re.escape(mark)
    return re.compile(rf"(?P<whole>[0-9]+|{group})?(?:{point}(?P<part>[0-9]*))?")


def _read(body: str, mark: str) -> str | None:
    """Give a number with a point as its decimal mark; None where it does not fit that mark."""
    found = _shape(mark).fullmatch(body)
    if found is None or (not found["whole"] and not found["part"]):
        return None
    whole = re.sub(r"[^0-9]", "", found["whole"] or "0")
    return f"{whole}.{found['part'] or '0'}"


@dataclass(frozen=True)
class Amount:
    """A cell that begins with a number: how it reads with a point and with a comma as the mark."""

    text: str
    sign: str
    power: str
    readings: Mapping[str, str | None]
    limit: str
    unit: str
    apart: bool

    @property
    def is_below(self) -> bool:
        """Whether the value is below the number, where it is beyond it."""
        return "<" in self.limit or "\u2264" in self.limit

    @property
    def marks(self) -> frozenset[str]:
        """The decimal marks that this cell may have; both where neither mark matters."""
        if self.power and self.ambiguous:
            # Nobody groups the digits of a mantissa.
            return frozenset("." if "." in self.text else ",")
        return frozenset(mark for mark, text in self.readings.items() if text is not None)

    @property
    def ambiguous(self) -> bool:
        """Whether it is one number with a point as the mark and another one with a comma."""
        return len({text for text in self.readings.values() if text is not None}) > 1

    @property
    def bare(self) -> bool:
        """Whether it is a whole number of at most three digits that is not 0."""
        return self.text.isdigit() and len(self.text) <= 3 and int(self.text) > 0

    def value(self, mark: str) -> float | None:
        """Give the number where this is the decimal mark; None where it cannot be."""
        text = self.readings[mark] if mark in self.marks else None
        return None if text is None else float(f"{self.sign}{text}{self.power}")


def without_marks(cell: str) -> str:
    """Give a cell without the sign of a footnote behind its number, or of a rounding before it.

    >>> [without_marks(cell) for cell in ("0.96*", "~ 1.2", "3", "*")]
    ['0.96', '1.2', '3', '*']
    """
    found = _MARKED.fullmatch(cell)
    return found["number"] if found else cell


def _plain(cell: str) -> str:
    """Give a cell with its power behind an e, and its sign before it."""
    text = _AS_TEXT.sub(r"\1\2", cell.strip())
    if behind := _BEHIND.fullmatch(text):
        return f"-{behind['number']}"
    if wide := _WIDE_POWER.fullmatch(text):
        return f"{wide[1]}e{wide[2]}"
    return _POWER.sub(lambda own: f"e{own['plain'] or own['raised'].translate(_RAISED)}", text)


def parse_number(cell: str) -> Amount | None:
    """Take a cell apart that is a number, perhaps beyond a limit or with a unit; None for others.

    >>> parse_number("< 8,5 mg/L").unit, parse_number("12.03.2024"), parse_number("x")
    ('mg/L', None, None)
    >>> [parse_number(cell).value(".") for cell in ("1.2x10^5", "4 \u00d7 10\u207b\u00b2", "0.5-")]
    [120000.0, 0.04, -0.5]
    >>> parse_number("0.1234-101").value(".")
    1.234e-102
    """
    found = _CELL.fullmatch(_plain(cell))
    if found is None:
        return None
    body = found["body"].strip()
    readings = {mark: _read(body, mark) for mark in ".,"}
    if not any(readings.values()):
        return None
    unit = (found["unit"] or "").strip().strip("[]()").strip()
    if _CALENDAR.fullmatch(unit[:3].strip()) or unit[:1].isdigit():
        return None  # a time, or two numbers
    apart = bool(found["gap"]) or (found["unit"] or "")[:1] in "[("
    if unit and not apart and not is_unit(unit):
        return None
    power = (found["power"] or "").lower().replace("d", "e").replace("\u2212", "-")
    return Amount(
        body,
        found["sign"].replace("\u2212", "-"),
        power,
        readings,
        found["limit"] or "",
        unit or found["money"] or "",
        apart,
    )
