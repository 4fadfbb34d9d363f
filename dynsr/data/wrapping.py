"""Wrapping: what is around the cells of a table of text where it was made to be looked at.

Printed frames have lines around their cells, pages of the web and LaTeX have marks, a terminal has
colours, some programs put every line in quotation marks, vectors in brackets, or prose between the
rows, and ARFF and GROMACS have their names line by line.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterable
from html.parser import HTMLParser

_BARS = re.compile("[\u2502\u2503\u2506\u250a\u2551]")
_RULE = re.compile("[\\s\u2500-\u257f+|=:-]*")
_ASCII = re.compile(r"^\s*\+[=-]{2,}(\+[=-]{2,})*\+\s*$", re.MULTILINE)
# What stands above a printed frame: its size.
_SIZE = re.compile("\\s*(shape: \\(.*\\)|\\d+\u00d7\\d+ \\w*DataFrame.*)\\s*")
# Types of columns, as Polars, Julia and R print them below the names.
_TYPE = re.compile(
    r"---|[uif]\d{1,2}|str|bool|date|U?Int\d*|Float\d*\??|String\d*\??|Bool|Any|Date\w*|<\w+>",
)
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_ATTRIBUTE = re.compile(r"(?im)^\s*@attribute\s+('[^']*'|\"[^\"]*\"|\S+)\s")
_DATA = re.compile(r"(?im)^\s*@data\b.*$")
_LEGEND = re.compile(r'(?m)^\s*@\s*s\d+\s+legend\s+"([^"]*)"')
_LABEL = re.compile(r'(?m)^\s*@\s*xaxis\s+label\s+"([^"]*)"')
_FLUENT = re.compile(r'(?m)^\(("[^"]*"(?:\s+"[^"]*")*)\)\s*$')
_VALUE = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
_NUMBERS = re.compile(rf"\s*{_VALUE}(?:\s+{_VALUE})*\s*")
_SPACES = "[ \\t]"
_VECTOR = re.compile(
    rf"(?m)^{_SPACES}*{_VALUE}(?:{_SPACES}+{_VALUE})*"
    rf"(?:{_SPACES}+\(+{_SPACES}*{_VALUE}(?:[ \t()]+{_VALUE})+{_SPACES}*\)+)+{_SPACES}*$"
)
_WORD = re.compile(r"[^\W\d_]+[.,:;]?")
_FEWEST = 8
_LATEX_ROW = re.compile(r"^[^&%]*&.*\\\\(\[.*?\])?\s*(\\[a-z]+(\{[^}]*\}|\([^)]*\))*\s*)*$")
_COMMAND = re.compile(
    r"\\(hline|toprule|midrule|bottomrule|cline|cmidrule)(\([^)]*\))?(\{[^}]*\})?"
)
_PAGE = re.compile(r"(?i)\s*(<\?xml[^>]*>\s*)?<(!doctype html|html|table)\b")
_QUOTED = re.compile(r'\s*"([^"]|"")*[,;\t]([^"]|"")*"[,;\s]*')


def unwrapped(head: str) -> Callable[[str], str] | None:
    """Give what takes a text out of its wrapping, as its head shows it; None for none.

    Parameters
    ----------
    head : the first lines of the text.

    >>> unwrapped("t,x") is None
    True
    >>> lines = ["+---+---+", "| t | x |", "+===+===+", "| 0 | 2 |", "+---+---+"]
    >>> text = chr(10).join(lines)
    >>> print(unwrapped(text)(text))
    | t | x |
    | 0 | 2 |
    """
    taken: list[Callable[[str], str]] = []
    for shows, takes in _WRAPPINGS:
        if shows(head):
            taken.append(takes)
            head = takes(head)
    if not taken:
        return None

    def take(text: str) -> str:
        for one in taken:
            text = one(text)
        return text

    return take


def without_colours(text: str) -> str:
    """Give a text without the colours of a terminal.

    Parameters
    ----------
    text : the text.

    >>> without_colours(chr(27) + "[32mok" + chr(27) + "[0m")
    'ok'
    """
    return _COLOUR.sub("", text)


def _is_boxed(text: str) -> bool:
    return bool(_BARS.search(text) or _ASCII.search(text))


def _without_box(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    kept = [line for line in lines if not (_RULE.fullmatch(line) or _SIZE.fullmatch(line))]
    if _BARS.search(text):
        kept = [_BARS.sub(" ", line).strip() for line in kept]
        kept = [line for line in kept if not all(map(_TYPE.fullmatch, line.split()))]
    return "\n".join(kept)


def _is_quoted(text: str) -> bool:
    """Whether each line is one cell in quotation marks with several in it."""
    lines = [line for line in text.splitlines() if line.strip()][:-1]
    return len(lines) > 1 and all(map(_QUOTED.fullmatch, lines))


def _without_quotes(text: str) -> str:
    stripped = (line.strip().strip(",;\t ") for line in text.splitlines())
    return "\n".join(line[1:-1].replace('""', '"') for line in stripped)


def _is_latex(text: str) -> bool:
    lines = [line.strip() for line in text.splitlines()]
    return sum(_LATEX_ROW.match(line) is not None for line in lines) > max(1, len(lines) / 3)


def _without_latex(text: str) -> str:
    lines = (_COMMAND.sub("", line).strip() for line in text.splitlines())
    rows = (line.split("\\\\")[0] for line in lines if _LATEX_ROW.match(line))
    plain = (row.replace("$", "").replace("\\%", "%").replace("\\_", "_") for row in rows)
    return _written(re.split(r"(?<!\\)&", row) for row in plain)


def _without_arff(text: str) -> str:
    names = [name.strip("'\"") for name in _ATTRIBUTE.findall(text)]
    _, _, rows = _DATA.sub("@data", text, count=1).partition("@data")
    kept = (line for line in rows.splitlines() if line.strip() and line.lstrip()[0] != "%")
    return _written([names]) + "\n".join(line.replace(",", "\t") for line in kept)


def _without_plot(text: str) -> str:
    """Write the names of GROMACS above its rows, that of the time first."""
    label = _LABEL.search(text)
    names = [label[1] if label else "t", *_LEGEND.findall(text)]
    rows = (
        line.split() for line in text.splitlines() if line.strip() and line.strip()[0] not in "#@&"
    )
    return _written([names, *rows])


def _without_fluent(text: str) -> str:
    """Write the names of Fluent without brackets, and nothing above them."""
    found = _FLUENT.search(text)
    assert found is not None
    names = re.findall(r'"([^"]*)"', found[1])
    return _written([names, *map(str.split, text[found.end() :].strip().splitlines())])


def _without_vectors(text: str) -> str:
    lines = text.splitlines()
    return "\n".join(re.sub("[()]", " ", o) if _VECTOR.fullmatch(o) else o for o in lines)


def _rows_of_numbers(text: str) -> list[int]:
    """Give the places of the lines that are numbers between blanks, as many as in most."""
    counts = [len(o.split()) if _NUMBERS.fullmatch(o) else 0 for o in text.splitlines()]
    usual = Counter(count for count in counts if count > 1).most_common(1)
    return [j for j, count in enumerate(counts) if usual and count == usual[0][0]]


def _find_prose(text: str) -> set[int]:
    """Give the places of lines of words between rows of numbers and after them.

    The names of the columns may come again there.
    """
    lines, rows = text.splitlines(), _rows_of_numbers(text)
    if len(rows) < _FEWEST or 2 * len(rows) < len(lines):
        return set()
    names, width = lines[max(rows[0] - 1, 0)], len(lines[rows[0]].split())

    def is_prose(line: str) -> bool:
        cells = line.split()
        wordy = 2 * sum(_WORD.fullmatch(cell) is not None for cell in cells) > len(cells) > 2
        return line != names and wordy and len(cells) != width and line.lstrip()[0] not in "#%@"

    return {j for j, line in enumerate(lines) if j > rows[0] and is_prose(line)}


def _without_prose(text: str) -> str:
    prose = _find_prose(text)
    return "\n".join(line for j, line in enumerate(text.splitlines()) if j not in prose)


def _without_page(text: str) -> str:
    """Give the largest table of a page."""
    parser = _Tables()
    parser.feed(text)
    parser.close()
    largest: list[list[str]] = max(parser.tables, key=len, default=[])
    return _written(largest)


class _Tables(HTMLParser):
    """Takes the cells of all tables of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self._cell: list[str] | None = None
        self._wide, self._hidden = 1, 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin a table, a row or a cell."""
        if tag == "table":
            self.tables.append([])
        elif tag == "tr" and self.tables:
            self._end_cell()
            self.tables[-1].append([])
        elif tag in ("td", "th") and self.tables and self.tables[-1]:
            self._end_cell()
            spans = dict(attrs).get("colspan") or "1"
            self._cell, self._wide = [], int(spans) if spans.isdecimal() else 1
        elif tag in ("sup", "style", "script"):
            self._hidden += 1

    def handle_endtag(self, tag: str) -> None:
        """End a cell, or what is no part of it."""
        if tag in ("td", "th", "tr", "table"):
            self._end_cell()
        elif tag in ("sup", "style", "script"):
            self._hidden = max(self._hidden - 1, 0)

    def handle_data(self, data: str) -> None:
        """Add to a cell."""
        if self._cell is not None and not self._hidden:
            self._cell.append(data)

    def _end_cell(self) -> None:
        if self._cell is not None:
            text = " ".join("".join(self._cell).split())
            self.tables[-1][-1] += [text, *[""] * (min(self._wide, 100) - 1)]
            self._cell = None


def _written(rows: Iterable[Iterable[str]]) -> str:
    found = io.StringIO()
    writer = csv.writer(found, delimiter="\t", lineterminator="\n")
    writer.writerows([" ".join(cell.split()) for cell in row] for row in rows)
    return found.getvalue()


# What shows a wrapping in a text, and what takes the text out of it.
_WRAPPINGS: tuple[tuple[Callable[[str], object], Callable[[str], str]], ...] = (
    (_COLOUR.search, without_colours),
    (_PAGE.match, _without_page),
    (_ATTRIBUTE.search, _without_arff),
    (_LEGEND.search, _without_plot),
    (_FLUENT.search, _without_fluent),
    (_VECTOR.search, _without_vectors),
    (_find_prose, _without_prose),
    (_is_latex, _without_latex),
    (_is_quoted, _without_quotes),
    (_is_boxed, _without_box),
)
