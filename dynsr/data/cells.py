"""Cells: what the text in a cell of a table says, decided by the evidence of its whole column."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynsr.data.amounts import (
    Amount,
    is_missing,
    is_unit,
    parse_number,
    says_above,
    says_below,
    without_marks,
)
from dynsr.data.limits import Limits
from dynsr.data.trajectory import as_floats
from dynsr.errors import InputError

# Words of a switch that is on, and of the same one off; a column holds those of one pair.
_PAIRS = (
    ("on", "off"),
    ("heat heating", "off idle"),
    ("cool cooling", "off idle"),
    ("yes", "no"),
    ("true", "false"),
    ("open opened", "closed close shut"),
    ("high", "low"),
    ("running started start", "stopped stop"),
    ("enabled", "disabled"),
    ("active", "inactive"),
    ("an ein", "aus"),
    ("ja", "nein"),
    ("wahr", "falsch"),
    ("auf offen ge\u00f6ffnet", "zu geschlossen"),
    ("oui", "non"),
    ("vrai", "faux"),
    ("ouvert ouverte", "ferm\u00e9 ferm\u00e9e ferme"),
    ("marche", "arr\u00eat arret"),
    ("si s\u00ed", "no"),
    ("verdadero", "falso"),
    ("abierto abierta", "cerrado cerrada"),
    ("encendido", "apagado"),
)
_SWITCHES = [
    {**dict.fromkeys(on.split(), 1.0), **dict.fromkeys(off.split(), 0.0)} for on, off in _PAIRS
]
_EMPTY = "has no value in any row"
_TRUTH = "true and false were read as 1 and 0"
# A number of one cell a line that shows its decimal mark: that mark cannot set thousands apart.
_SHOWN = {
    mark: re.compile(
        rf"^[-+]?(?:0?{sign}|[0-9]{{4,}}{sign}|[0-9]+{sign}(?![0-9]{{3}}\n))", re.MULTILINE
    )
    for mark, sign in ((".", r"\."), (",", ","))
}


@dataclass(frozen=True, eq=False)
class Reading:
    """What a column says.

    Parameters
    ----------
    values : (n,) float64, dates or durations; objects where a cell is not one of these.
    unit : the unit in its cells; "" for none.
    notes : what was decided on reading, a clause each that begins with the column.
    left_out : why it is of no use as a column; "" where it is.
    fault : what a message says once the column is needed; "" for nothing.
    words : number -> the word that was read as it.
    limits : the cells in which only a limit is known; None for none.
    """

    values: np.ndarray
    unit: str = ""
    notes: tuple[str, ...] = ()
    left_out: str = ""
    fault: str = ""
    words: Mapping[float, str] = field(default_factory=dict)
    limits: Limits | None = None


def read_columns(
    columns: Sequence[np.ndarray], decimal: str | None = None, delimiter: str = ""
) -> list[Reading]:
    """Read the cells of columns; which decimal mark they have is decided by all of them together.

    Parameters
    ----------
    columns : one array (n,) each; arrays of numbers and dates stay as they are.
    decimal : "." or ",", as the user says; found by default.
    delimiter : what is between the cells of a text.

    >>> column = np.array(["1.633,0", "867", "n.d."], dtype=object)
    >>> read_columns([column])[0].values
    array([1633.,  867.,   nan])
    """
    looks = [_look(column) for column in columns]
    own = [look.mark for look in looks if isinstance(look, _Look) and len(look.decisive) == 1]
    other = own[0] if len(set(own)) == 1 else ""
    return [
        look.read(decimal, other, delimiter) if isinstance(look, _Look) else look for look in looks
    ]


def _look(column: np.ndarray) -> Reading | _Look:
    """Read a column whose cells need no parsing, or make ready to parse its text."""
    if column.dtype.kind in "mM":
        return Reading(column, left_out="" if (~np.isnat(column)).any() else _EMPTY)
    if column.dtype.kind == "b":
        return Reading(column.astype(float), notes=(_TRUTH,))
    if column.dtype.kind in "fiuc":
        return _as_numbers(column)
    import pandas

    try:
        look = _Look(column.astype(object))
    except TypeError:  # cells that hold lists or such
        return Reading(column.astype(object))
    if len(look.texts) or not look.others.any():
        return look
    inferred = pandas.api.types.infer_dtype(look.distinct, skipna=True)
    filled = pandas.Series(column.astype(object)).where(look.there, None)
    if inferred == "boolean":
        return Reading(filled.astype(float).to_numpy(), notes=(_TRUTH,))
    if inferred in ("datetime", "datetime64", "date", "timedelta", "timedelta64"):
        as_dates = pandas.to_timedelta if inferred.startswith("timedelta") else pandas.to_datetime
        try:
            return Reading(as_dates(filled).to_numpy())
        except (ValueError, TypeError, OverflowError):
            return Reading(column)
    if inferred == "time":
        return Reading(filled.map(str, na_action="ignore").to_numpy(object))
    return _as_numbers(filled.to_numpy(object, na_value=np.nan))


def _as_numbers(column: np.ndarray) -> Reading:
    try:
        numbers = as_floats(column, "it")
    except InputError as error:
        # An identity of many digits stops a table only where it is wanted as a number.
        return Reading(column.astype(object), fault=str(error).removeprefix("it "))
    return Reading(numbers, left_out=_EMPTY if len(numbers) and np.isnan(numbers).all() else "")


class _Look:
    """The distinct cells of a column with text in it, and the evidence that they give."""

    def __init__(self, column: np.ndarray) -> None:
        import pandas

        self.column = column
        self.codes, self.distinct = pandas.factorize(column)
        self.counts = np.bincount(self.codes[self.codes >= 0], minlength=len(self.distinct))
        self.decisive: dict[str, str] = {}
        self.low: list[int] = []
        self.high: list[int] = []
        self.parsed: list[Amount | None] = []
        self.marked: list[int] = []
        self.numbers = self._all_alike(self.distinct)
        if self.numbers is not None:
            self.there, self.places = self.codes >= 0, np.arange(len(self.distinct))
            self.others, self.texts = np.zeros(len(self.distinct), dtype=bool), self.distinct
            return
        self._find_texts(np.array([is_missing(cell) for cell in self.distinct], dtype=bool))
        if self.others.any() or len(self.texts) == len(self.distinct):
            self._parse()
            return
        self.numbers = self._all_alike(self.texts)
        if self.numbers is None:
            self._parse()

    def _find_texts(self, empty: np.ndarray) -> None:
        """Find the places of the distinct cells that are texts, and of those that are not."""
        self.there = np.append(~empty, False)[self.codes]
        words = np.array([isinstance(cell, str) for cell in self.distinct], dtype=bool)
        self.places = np.flatnonzero(words & ~empty)
        self.others = ~words & ~empty
        self.texts = [self.distinct[j].strip() for j in self.places]
        said = np.flatnonzero(empty).tolist()
        self.low = [j for j in said if says_below(self.distinct[j])]
        self.high = [j for j in said if says_above(self.distinct[j])]

    def _parse(self) -> None:
        """Take each text apart as a number, and note which decimal marks are shown."""
        self.parsed = [parse_number(text) for text in self.texts]
        for j, text in enumerate(self.texts):
            if self.parsed[j] is None and (plain := without_marks(text)) != text:
                self.parsed[j] = parse_number(plain)
                self.marked += [j] if self.parsed[j] is not None else []
        self._drop_odd_units()
        for number in filter(None, self.parsed):
            if len(number.marks) == 1:
                self.decisive.setdefault(next(iter(number.marks)), number.text)

    @property
    def mark(self) -> str:
        """The decimal mark that cells of this column show, where there is one."""
        return next(iter(self.decisive))

    def _count(self, wanted: Callable[[Amount | None], bool]) -> int:
        """Count the cells of text that are numbers of a kind."""
        pairs = zip(self.places, self.parsed, strict=True)
        return sum(int(self.counts[j]) for j, number in pairs if wanted(number))

    def _spread(self, values: Sequence[Any] | np.ndarray, others: bool = False) -> np.ndarray:
        """Give the column with a value for each distinct text; the rest as it is, or NaN."""
        table = np.full(len(self.distinct) + 1, np.nan, dtype=object)
        table[self.places] = values
        if others:
            table[:-1][self.others] = self.distinct[self.others]
        return table[self.codes]

    def _all_alike(self, cells: Sequence[Any]) -> np.ndarray | None:
        """Give the numbers where all cells are numbers of one mark that one of them shows."""
        try:
            lines = "\n".join([*cells, ""])
            signs = lines.encode("ascii")
        except (TypeError, UnicodeError):  # not texts alone, or signs of no plain number
            return None
        for mark, pattern in _SHOWN.items():
            shown = pattern.search(lines)
            if shown and not signs.translate(None, b"0123456789+-eE\n" + mark.encode()):
                try:
                    numbers = np.array(lines.replace(",", ".").split("\n")[:-1], dtype=float)
                except ValueError:
                    return None
                self.decisive = {mark: shown[0]}
                return numbers
        return None

    def _drop_odd_units(self) -> None:
        """Take an unknown word after numbers for a unit only where it follows all of them."""
        units = {n.unit for n in self.parsed if n is not None}
        alone = len(units) == 1 and None not in self.parsed
        whole = all(n is None or (n.text.isdigit() and not n.apart) for n in self.parsed)
        for j, number in enumerate(self.parsed):
            if number is None or not number.unit:
                continue
            letter = len(number.unit) == 1 and number.unit.isupper()
            if (letter and whole) or not (alone or is_unit(number.unit)):
                self.parsed[j] = None

    def read(self, decimal: str | None, other: str, delimiter: str) -> Reading:
        """Read the column.

        Parameters
        ----------
        decimal : the decimal mark, as the user says.
        other : the mark that other columns show, "" for none.
        delimiter : what is between cells.
        """
        if not self.there.any():
            return Reading(np.full(len(self.column), np.nan), left_out=_EMPTY)
        if self.numbers is not None and decimal in (None, self.mark):
            values = self._spread(self.numbers).astype(float)
            return Reading(values, limits=self._find_limits(self.mark)[0])
        if self.numbers is not None:
            self.texts = list(self.texts)
            self._parse()
        words = {text.lower() for text in self.texts}
        switch = next((pair for pair in _SWITCHES if words <= pair.keys()), None)
        # One word in some rows, and nothing in the others, is a remark.
        if switch is not None and not self.others.any() and (len(words) > 1 or self.there.all()):
            said = " and ".join(f"{word!r} as {switch[word]:g}" for word in sorted(words))
            values = self._spread([switch[text.lower()] for text in self.texts])
            shown = {switch[text.lower()]: text for text in self.texts}
            return Reading(values.astype(float), notes=(f"was read with {said}",), words=shown)
        bad = self._count(lambda number: number is None)
        beyond = self._count(lambda number: number is not None and number.limit != "")
        good = int(self.there.sum()) - beyond - bad
        if beyond and not good and not bad:
            reason = f"is beyond a limit in every row ({self._limits()})"
            return Reading(np.full(len(self.column), np.nan), left_out=reason)
        return self._as_numbers(decimal, other, delimiter) if good > bad else self._as_text()

    def _as_text(self) -> Reading:
        blank = np.array([not isinstance(c, str) or bool(c.strip()) for c in self.distinct], bool)
        cells = [cell.strip() if isinstance(cell, str) else cell for cell in self.distinct]
        table = np.array([*cells, np.nan], dtype=object)
        table[:-1][~blank] = np.nan
        values = table[self.codes]
        filled = int(self.there.sum())
        # Less than half of the rows: a text that names a run stands in each of its rows.
        if 2 * filled < len(values) and not self.others.any():
            return Reading(values, left_out=f"holds remarks in {filled} of {len(values)} rows")
        return Reading(values)

    def _limits(self) -> str:
        pairs = zip(self.texts, self.parsed, strict=True)
        found = [text for text, number in pairs if number is not None and number.limit]
        return ", ".join(found[:3]) + (", ..." if len(found) > 3 else "")

    def _as_numbers(self, decimal: str | None, other: str, delimiter: str) -> Reading:
        mark, notes, doubt = self._choose_mark(decimal, other, delimiter)
        units = sorted({n.unit for n in self.parsed if n is not None and n.unit})
        if not doubt and len(units) > 1:
            doubt = f"holds numbers in {units[0]!r} and in {units[1]!r}; give it one unit"
        if doubt:
            return Reading(self.column, fault=doubt)
        table: list[Any] = []
        for text, own in zip(self.texts, self.parsed, strict=True):
            value = None if own is None else own.value(mark)
            table.append(text if value is None else np.nan if own and own.limit else value)
        if beyond := self._count(lambda number: number is not None and number.limit != ""):
            cells = "1 cell is" if beyond == 1 else f"{beyond} cells are"
            notes += (
                f"{cells} beyond a limit ({self._limits()}), which counts in place of a value",
            )
        limits, said = self._find_limits(mark)
        notes += said
        if self.marked:
            count = sum(int(self.counts[self.places[j]]) for j in self.marked)
            cells = "1 cell has" if count == 1 else f"{count} cells have"
            notes += (f"{cells} a mark ({self.texts[self.marked[0]]!r}) and were read without it",)
        values = self._spread(table, others=True)
        unit = units[0] if units else ""
        if any(isinstance(value, str) for value in table):
            return Reading(values, unit, notes)
        try:
            return Reading(values.astype(float), unit, notes, limits=limits)
        except (TypeError, ValueError, OverflowError):  # dates among numbers
            return Reading(values, unit, notes)

    def _find_limits(self, mark: str) -> tuple[Limits | None, tuple[str, ...]]:
        """Give the limits that cells say, and what is said of words that mean one of these."""
        pairs = zip(self.places, self.parsed, strict=False)
        beyond = [(place, own) for place, own in pairs if own is not None and own.limit]
        if not beyond and not self.low and not self.high:
            return None, ()
        table = Limits.none(len(self.distinct) + 1)
        for place, number in beyond:
            value = number.value(mark)
            side = table.below if number.is_below else table.above
            side[place] = np.nan if value is None else value
        written = np.unique(table.below[~np.isnan(table.below)])
        table.below[self.low] = written[0] if len(written) == 1 else np.inf
        ends = np.unique(table.above[~np.isnan(table.above)])
        table.above[self.high] = ends[0] if len(ends) == 1 else -np.inf
        if not table.there.any():
            return None, ()
        word = self.distinct[self.low[0]].strip() if self.low else ""
        said = (f"{word!r} was read as <{written[0]:g}",) if word and len(written) == 1 else ()
        return table.select(self.codes), said

    def _choose_mark(
        self, decimal: str | None, other: str, delimiter: str
    ) -> tuple[str, tuple[str, ...], str]:
        """Give the decimal mark, what is said of the choice, and the doubt where there is none."""
        if decimal:
            return decimal, (), ""
        if len(self.decisive) == 2:
            point, comma = self.decisive["."], self.decisive[","]
            doubt = f"holds both {point!r} and {comma!r}, so that no one knows its decimal mark"
            return "", (), f"{doubt}; write one mark throughout, or say it (--decimal)"
        if self.decisive:
            return self.mark, (), ""
        unclear = [n for n in self.parsed if n is not None and n.ambiguous]
        signs = {"," if "," in n.text else "." for n in unclear}
        # A point is the decimal mark where nothing speaks for a comma.
        if not unclear or (signs == {"."} and other != ","):
            return ".", (), ""
        first, sign = unclear[0], min(signs)
        # Digits in threes beside whole numbers below 1000 that have no mark: a number with three
        # decimals would be whole once in a thousand times.
        bare = any(n is not None and n.bare for n in self.parsed)
        large = any(n is not None and n.text.isdigit() and len(n.text) > 3 for n in self.parsed)
        groups = (bare and not large) or (not other and delimiter == sign == ",")
        # The mark of other columns separates no thousands.
        groups &= other != sign
        found = {other} if other else set()
        found |= {"." if sign == "," else ","} if groups else set()
        # Semicolons stand between cells where commas stand in numbers.
        found |= {","} if not found and delimiter == ";" and sign == "," else set()
        if len(signs) == 1 and len(found) == 1:
            mark = found.pop()
            # Where another column shows the mark, nothing was guessed.
            sure = mark == other
            said = f"{first.text!r} was read as {first.value(mark):.12g}; --decimal says the mark"
            return mark, () if sure else (said,), ""
        values = f"{first.value('.'):.12g} or {first.value(','):.12g}"
        doubt = f"holds {first.text!r}, which may be {values}"
        return "", (), f"{doubt}; say the decimal mark (--decimal), or write it otherwise"
