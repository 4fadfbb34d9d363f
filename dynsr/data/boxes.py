"""Boxes: tables that are printed with lines around their cells, as data frames are."""

from __future__ import annotations

import re

_BARS = re.compile("[\u2502\u2503\u2506\u250a\u2551]")
_RULE = re.compile("[\\s\u2500-\u257f+|=:-]*")
_ASCII = re.compile(r"^\s*\+[=-]{2,}(\+[=-]{2,})*\+\s*$", re.MULTILINE)
# What stands above a printed frame: its size.
_SIZE = re.compile("\\s*(shape: \\(.*\\)|\\d+\u00d7\\d+ \\w*DataFrame.*)\\s*")
# Types of columns, as Polars, Julia and R print them below the names.
_TYPE = re.compile(
    r"---|[uif]\d{1,2}|str|bool|date|U?Int\d*|Float\d*\??|String\d*\??|Bool|Any|Date\w*|<\w+>",
)


def is_boxed(text: str) -> bool:
    """Whether a table has lines around its cells.

    Parameters
    ----------
    text : the whole table, or its head.

    >>> is_boxed("+---+---+"), is_boxed("t,x")
    (True, False)
    """
    return bool(_BARS.search(text) or _ASCII.search(text))


def without_box(text: str) -> str:
    """Give a table without the lines around its cells.

    Parameters
    ----------
    text : the whole table.

    >>> lines = ["+---+---+", "| t | x |", "+===+===+", "| 0 | 2 |", "+---+---+"]
    >>> print(without_box(chr(10).join(lines)))
    | t | x |
    | 0 | 2 |
    """
    lines = [line for line in text.splitlines() if line.strip()]
    kept = [line for line in lines if not (_RULE.fullmatch(line) or _SIZE.fullmatch(line))]
    if _BARS.search(text):
        kept = [_BARS.sub(" ", line).strip() for line in kept]
        kept = [line for line in kept if not all(map(_TYPE.fullmatch, line.split()))]
    return "\n".join(kept)
