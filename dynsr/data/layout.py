"""Layout: where in a sheet of cells the table is, what is above it, and what below."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, time, timedelta
from itertools import zip_longest
from typing import Any

import numpy as np

from dynsr.data.amounts import is_missing, is_unit, parse_number
from dynsr.data.name_parts import FEWEST_WELLS, WELL

_MONTH = r"(jan|feb|mar|m\u00e4r|apr|may|mai|jun|jul|aug|sep|oct|okt|nov|dec|dez)[a-z]*\.?"
_DATE = re.compile(
    rf"\d{{1,4}}[-/.]\d{{1,2}}[-/.]\d{{1,4}}([ T,].*)?|\d{{1,4}}\.?[-/ ]{_MONTH}[-/ ,]+\d.*|"
    rf"{_MONTH} \d{{1,2}},? \d.*|\d{{1,4}}:\d{{2}}(:\d{{2}}([.,]\d*)?)?(\s?[ap]\.?m\.?)?|"
    r"-?\d+ days?.*",
    re.IGNORECASE,
)
_BRACKETED = re.compile(r"\s*[\[(<].{0,24}[\])>]\s*")
_NO_UNIT = frozenset(
    ("", "-", "--", "\u2013", "\u2014", "1", "none", "n/a", "na", "-/-", "[-]", "(-)")
)
# Types of columns that R prints in brackets.
_TYPES = frozenset(("dbl", "int", "chr", "lgl", "fct", "date", "dttm", "drtn"))
_TIME = re.compile(
    r"t|(time|zeit|temps|date|datum|uhrzeit|timestamp)\w*|elapsed.*|.*\b(time|zeit)\b.*",
    re.IGNORECASE,
)
_NAME = re.compile(r"[^\W\d]\w*")
_TOTAL = re.compile(
    r".*\b((sub)?.?totals?|sum|mean|average|avg|summe|gesamt|mittelwert|moyenne|suma)\b.*",
    re.IGNORECASE,
)
_ENOUGH = 3
_SAMPLE = 200
TEXT, NUMBER, NONE = "text", "number", ""


def kind(cell: Any) -> str:
    """Say whether a cell is a number or a time, a text, or says nothing.

    >>> [kind(cell) for cell in ("< 8 mg/L", "2024-03-12 14:05", "12 Mar 2024", 2.0)]
    ['number', 'number', 'number', 'number']
    >>> kind("relay 12"), kind("n.d.")
    ('text', '')
    """
    if is_missing(cell):
        return NONE
    if isinstance(cell, str):
        text = cell.strip()
        if text.lstrip("+-")[:1].isdigit() and text.replace(".", "", 1).lstrip("+-").isdigit():
            return NUMBER
        number = _DATE.fullmatch(text) or parse_number(text)
        return NUMBER if number else TEXT
    told = (int, float, np.number, date, datetime, time, timedelta, np.datetime64)
    return NUMBER if isinstance(cell, told) and not isinstance(cell, bool) else TEXT


@dataclass(frozen=True)
class Row:
    """Cells of a row of a sheet, its place from 0, and whether it is marked as a comment."""

    cells: Sequence[Any]
    place: int
    comment: bool = False
    kinds: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Look at each cell once."""
        object.__setattr__(self, "kinds", tuple(map(kind, self.cells)))

    @property
    def width(self) -> int:
        """The number of cells up to the last that says something."""
        return max((j + 1 for j, cell in enumerate(self.cells) if not is_blank(cell)), default=0)


def is_blank(cell: Any) -> bool:
    """Whether there is nothing at all in a cell."""
    return not cell.strip() if isinstance(cell, str) else is_missing(cell)


@dataclass(frozen=True)
class Layout:
    """Where a table is.

    Parameters
    ----------
    first : place of the first row of data.
    names : names of the columns; empty where there are none.
    units : units of the columns as a row below the names gives them; empty where there is none.
    skipped : places of the rows above the data that are neither.
    above : whether the names are in a comment.
    """

    first: int
    names: list[str]
    units: list[str]
    skipped: list[int]
    above: bool = False


def find_layout(rows: Sequence[Row], whole: bool = True) -> Layout | None:
    """Find the table in the first rows of a sheet; None where no row is one of data.

    Parameters
    ----------
    rows : rows that are not blank, comments included.
    whole : whether there are no more; else a table of text alone is not looked for.

    A row of data agrees with what most rows have in the columns that are mostly numbers. The names
    are the nearest row above the data that has text in most of these; rows of units, of longer
    names and remarks may be between.

    >>> rows = ["Logger 7", "Time,Temp", "(s),(C)", "0,20.5", "1,20.7"]
    >>> found = find_layout([Row(row.split(","), j) for j, row in enumerate(rows)])
    >>> found.first, found.names, found.units, found.skipped
    (3, ['Time', 'Temp'], ['s', 'C'], [0])
    """
    numeric = _numeric_columns(rows)
    is_data = [not row.comment and _is_data(row, numeric) for row in rows]
    if not any(is_data):
        return _all_text(rows) if whole else None
    starts = [j for j, yes in enumerate(is_data) if yes and not (j and is_data[j - 1])]
    lengths = {
        j: next((k for k in range(j, len(rows)) if not is_data[k]), len(rows)) - j for j in starts
    }
    starts, lengths = _without_remarks(rows, lengths)
    width = max(rows[j].width for j, yes in enumerate(is_data) if yes)
    heads = {j: _find_head(rows[:j], numeric, width) for j in starts}
    longest = max(lengths.values())
    # A line or two of settings, such as "Samples 200 200", may have a head above them too.
    named = max((lengths[j] for j in starts if heads[j]), default=longest)
    for j in starts:
        if lengths[j] >= min(_ENOUGH, named if heads[j] else longest):
            return _arrange(rows, j, heads[j])
    return None


def _without_remarks(
    rows: Sequence[Row], lengths: Mapping[int, int]
) -> tuple[list[int], dict[int, int]]:
    """Begin tables below the remarks right above them, such as "Wavelength;600;nm".

    Parameters
    ----------
    rows : all rows.
    lengths : first row of a table -> its number of rows.

    A remark has a text in it. It has fewer cells than the rows of the table, or a blank row below
    it and fewer values.
    """
    found = {}
    for start, length in lengths.items():
        own = rows[start : start + length]
        usual = Counter(len(row.cells) for row in own).most_common(1)[0][0]
        begin = 0
        while TEXT in own[begin].kinds and len(own[begin].cells) < usual:
            begin += 1
        for j in range(begin + 1, len(own)):
            apart = own[j].place > own[j - 1].place + 1 and TEXT in own[j - 1].kinds
            if apart and max(row.width for row in own[:j]) < own[j].width:
                begin = j
        found[start + begin] = length - begin
    return list(found), found


def search_layout(make: Callable[[int], Row], places: Sequence[int]) -> Layout | None:
    """Find the table in a sheet whose rows are made as they are needed.

    Parameters
    ----------
    make : gives the row at a place.
    places : those of the rows that are not blank, in order.
    """
    count = _SAMPLE
    while True:
        whole = count >= len(places)
        found = find_layout([row for row in map(make, places[:count]) if row.width], whole)
        # A table that begins late: more of it tells better what its rows are.
        if whole or (found is not None and 2 * found.first < places[count]):
            return found
        count *= 4


def _numeric_columns(rows: Sequence[Row]) -> list[int]:
    """Columns that are mostly numbers in the rows that are mostly numbers."""
    count: dict[int, int] = {}
    for row in rows:
        told = [k for k in row.kinds if k]
        if row.comment or 2 * told.count(NUMBER) < len(told):
            continue
        for j, one in enumerate(row.kinds):
            if one:
                count[j] = count.get(j, 0) + (1 if one == NUMBER else -1)
    return sorted(j for j, balance in count.items() if balance > 0)


def _texts(row: Row, numeric: Sequence[int]) -> int:
    return sum(j < len(row.kinds) and row.kinds[j] == TEXT for j in numeric)


def _is_data(row: Row, numeric: Sequence[int]) -> bool:
    good = sum(j < len(row.kinds) and row.kinds[j] == NUMBER for j in numeric)
    bad = _texts(row, numeric)
    leads = bool(numeric) and len(row.kinds) > numeric[0] and row.kinds[numeric[0]] == NUMBER
    return not _names_time(row, numeric) and (good > bad or (good == bad > 0 and leads))


def _names_time(row: Row, numeric: Sequence[int]) -> bool:
    """Whether the first column of numbers is called a time here, whatever the others are called."""
    if not numeric or len(row.cells) <= numeric[0]:
        return False
    return _TIME.fullmatch(_bare(cell_text(row.cells[numeric[0]]))) is not None


def _is_head(row: Row, numeric: Sequence[int]) -> bool:
    return 2 * _texts(row, numeric) > len(numeric) or _names_time(row, numeric)


def _all_text(rows: Sequence[Row]) -> Layout | None:
    """A table without a number: its first row names the columns."""
    rows = [row for row in rows if not row.comment]
    if not rows:
        return None
    names = [cell_text(cell) for cell in rows[0].cells]
    return Layout(rows[1].place if len(rows) > 1 else rows[0].place + 1, names, [], [])


def _find_head(rows: Sequence[Row], numeric: Sequence[int], width: int) -> list[Row]:
    """Give the rows of names, units and longer names above the data."""
    head: list[Row] = []
    other = 0
    plain = False
    for row in reversed(rows):
        fits = row.width == width and not plain if row.comment else row.width > (width > 1)
        # R names the rows in a column without a name.
        short = not head and not other and numeric[:1] == [1] and row.width == width - 1
        short = short and set(row.kinds) == {TEXT}
        names = short or _is_head(row, numeric) or _as_units(row) is not None
        if fits and (names or _names_groups(row, head)):
            head.append(row)
            if short:
                return head
        elif row.comment:
            plain = True  # below a remark a comment names nothing
        elif head or other == _ENOUGH:
            break
        else:
            other += 1
        if len(head) > _ENOUGH:
            break
    head.reverse()
    while head and not _is_head(head[0], numeric) and not _names_groups(head[0], head[:0:-1]):
        head.pop(0)
    return head


def _names_groups(row: Row, below: Sequence[Row]) -> bool:
    """Whether a row names groups of columns: those of the row below have the same names again.

    So does one that names those columns which have no name below.
    """
    if not below or row.comment or not set(row.kinds) <= {TEXT, NONE}:
        return False
    upper, lower = ([cell_text(cell) for cell in own.cells] for own in (row, below[-1]))
    if _fills(upper, lower):
        return True
    return not _distinct(lower) and _distinct(_join(upper, lower))


def _arrange(rows: Sequence[Row], first: int, head: list[Row]) -> Layout:
    """Distinguish names, units and remarks among the rows above the data."""
    units: list[str] = []
    unit_row = None
    if len(head) > 1:
        for row in (*reversed(head[1:]), head[0]):  # units stand below the names, seldom above
            found = _as_units(row)
            if found is not None:
                units, unit_row = found, row
                break
    rest = [row for row in head if row is not unit_row]
    rest = [row for row in rest if not row.comment] or rest
    if unit_row is not None and unit_row is not head[0]:  # what stands below the units are remarks
        rest = [row for row in rest if row.place < unit_row.place] or rest
    names, used = _choose_names(rest)
    kept = {row.place for row in used} | ({unit_row.place} if unit_row else set())
    skipped = [r.place for r in rows[:first] if r.place not in kept and not r.comment]
    above = bool(used) and used[0].comment
    return Layout(rows[first].place, names, units, skipped, above)


def settings_of_wells(
    cells_of: Callable[[int], Sequence[Any]], layout: Layout
) -> tuple[dict[str, dict[str, Any]], list[int]]:
    """Give the rows above the names of the wells of a plate that say what was set in each.

    Parameters
    ----------
    cells_of : gives the cells of a row at a place.
    layout : where the table is.

    Gives setting -> well -> cell, and the places of the other rows above.
    """
    wells = [j for j, name in enumerate(layout.names) if WELL.fullmatch(name)]
    found: dict[str, dict[str, Any]] = {}
    others = []
    for place in layout.skipped if len(wells) >= FEWEST_WELLS else []:
        cells = cells_of(place)
        label = cell_text(cells[0]) if wells[0] and len(cells) > wells[-1] else ""
        if label:
            found[label] = {layout.names[j]: cells[j] for j in wells}
        else:
            others.append(place)
    return found, others if found else layout.skipped


def _as_units(row: Row) -> list[str] | None:
    """Give the units that a row holds; None where it is no row of units."""
    cells = [cell_text(cell) for cell in row.cells]
    told = [cell for cell in cells if cell.lower() not in _NO_UNIT]
    if not told or not all(_BRACKETED.fullmatch(cell) or is_unit(cell) for cell in told):
        return None
    bare = [cell.strip("[]()<> ") for cell in cells]
    return ["" if cell.lower() in _NO_UNIT | _TYPES else cell for cell in bare]


def _choose_names(rows: Sequence[Row]) -> tuple[list[str], list[Row]]:
    """Choose the row of names: the one that names a time; else short names before long ones."""
    if not rows:
        return [], []
    named = {row.place: [cell_text(cell) for cell in row.cells] for row in rows}
    nearest = rows[-1]
    last = named[nearest.place]
    full = [r for r in rows if r.width == nearest.width and _distinct(named[r.place])]
    with_time = [r for r in full if any(_TIME.fullmatch(_bare(n)) for n in named[r.place])]
    chosen = with_time[-1] if with_time else nearest
    short = [
        r
        for r in (with_time or full)
        if all(_NAME.fullmatch(_bare(n)) for n in named[r.place] if n)
    ]
    if short and not all(_NAME.fullmatch(_bare(n)) for n in last if n):
        chosen = short[0]
    names = named[chosen.place]
    above = [r for r in rows if r.place < chosen.place]
    if above and _fills(upper := named[above[-1].place], names):
        pairs = zip_longest(names, upper, fillvalue="")
        return [name or group for name, group in pairs], [above[-1], chosen]
    if above and not _distinct(names):
        joined = _join(named[above[-1].place], names)
        if _distinct(joined):
            return joined, [above[-1], chosen]
    return names, [chosen]


def _fills(upper: Sequence[str], lower: Sequence[str]) -> bool:
    """Whether a row names all columns that have no name in the row of names below it, and groups.

    A single cell is a title.
    """
    last = max((j for j, name in enumerate(lower) if name), default=-1)
    blank = [j for j, name in enumerate(lower[:last]) if not name]
    told = [j for j, name in enumerate(upper) if name]
    return bool(blank) and {*blank} < {*told} and _distinct(lower)


def _join(upper: Sequence[str], lower: Sequence[str]) -> list[str]:
    """Put the name of a group of columns behind each of its columns' names.

    A unit below the name of a single column is its unit.
    """
    group, joined = "", []
    for j, name in enumerate(lower):
        own = upper[j] if j < len(upper) else ""
        group = own or group
        alone = bool(own) and (j + 1 >= len(upper) or bool(upper[j + 1]))
        if alone and (is_unit(name) or _BRACKETED.fullmatch(name)):
            joined.append(f"{own} [{name.strip('[]()<> ')}]")
        else:
            joined.append("_".join(filter(None, (name, group))))
    return joined


def _distinct(names: Sequence[str]) -> bool:
    told = [name for name in names if name]
    return len(set(told)) == len(told)


def _bare(name: str) -> str:
    return re.sub(r"\s*[\[(][^\])]*[\])]\s*$", "", name).strip()


def cell_text(cell: Any) -> str:
    r"""Give what a cell of a header says, in one line.

    >>> cell_text(2019.0), cell_text(" a\n b ")
    ('2019', 'a b')
    """
    if isinstance(cell, float):
        return "" if cell != cell else f"{cell:.15g}"  # noqa: PLR0124
    return "" if cell is None else " ".join(str(cell).split())


def rows_that_are_none(columns: Sequence[np.ndarray], label: str) -> tuple[np.ndarray, list[str]]:
    """Find rows of a table that are no data: below its end, and single words between its rows.

    Parameters
    ----------
    columns : one array (n,) each, as they were read.
    label : what a note calls the source.

    Gives (n,) whether a row is no data, and a sentence on those that are.
    """
    none = np.zeros(len(columns[0]), dtype=bool)
    texts = [j for j, column in enumerate(columns) if column.dtype.kind == "O"]
    if not texts or not len(none):
        return none, []
    import pandas

    filled = np.array([~pandas.isna(column) for column in columns])
    counts = filled.sum(axis=0)
    numeric: dict[int, bool] = {}

    def is_remark(row: int) -> bool:
        """Whether the first cell of a row is a text where other rows have numbers."""
        j = int(np.argmax(filled[:, row]))
        if j not in texts or kind(columns[j][row]) != TEXT:
            return False
        if j not in numeric:
            kinds = [kind(cell) for cell in columns[j][:_SAMPLE]]
            numeric[j] = kinds.count(NUMBER) > kinds.count(TEXT)
        return numeric[j]

    notes = []
    single = np.flatnonzero(counts == 1).tolist() if len(columns) > 1 else []
    alone = [row for row in single if is_remark(row)]
    none[alone] = True
    # So are sums and means of the rows above them.
    labels = columns[0].tolist() if 0 in texts else []
    sums = [k for k, cell in enumerate(labels) if isinstance(cell, str) and _TOTAL.fullmatch(cell)]
    none[[row for row in sums if is_remark(row)]] = True
    for row in range(len(none) - 1, -1, -1):
        if counts[row] and not none[row] and not is_remark(row):
            break
        none[row] = none[row] or bool(counts[row])
    if none.any():
        found = np.flatnonzero(none)
        first = cell_text(columns[int(np.argmax(filled[:, found[0]]))][found[0]])[:40]
        what = "1 row" if len(found) == 1 else f"{len(found)} rows"
        were = "has no data" if len(found) == 1 else "have no data"
        notes.append(f"{what} of {label} {were} ({first!r}); skipped")
    return none, notes
