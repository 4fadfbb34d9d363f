"""Brackets: tables that are written as arrays, as Python, NumPy, MATLAB and C print them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynsr.errors import InputError

_BEGINS = re.compile(r"[\[({]\s*([-+]?\.?\d|nan\b)", re.IGNORECASE)
# A part without a bracket in it, with the brackets around it.
_INNER = re.compile(r"[\[({]([^\[\](){}]*)[\])}]")
_APART = re.compile(r"[,\s]+")
_ROW_ENDS = re.compile(r"[;\n]")
# What stands behind the rows: brackets, and the type of numbers that NumPy prints.
_BEHIND = re.compile(r"[\s,;\[\](){}]*(dtype\s*=\s*[\w.]+[\s,;\[\](){}]*)?")
_CUT = re.compile(r"\.\.\.|\u2026")
_FEWEST = 3


@dataclass(frozen=True)
class Bracketed:
    """The (n, k) numbers of an array in brackets, and the names above it, if there are any."""

    names: tuple[str, ...]
    values: np.ndarray


def may_be_bracketed(head: str) -> bool:
    """Whether a number follows a bracket early in a text.

    Parameters
    ----------
    head : its first lines.

    >>> may_be_bracketed("[[0.0, 1.0],"), may_be_bracketed("t [s],x (m)"), may_be_bracketed("5(2)")
    (True, False, True)
    """
    return _BEGINS.search(head) is not None


def read_brackets(text: str, label: str) -> Bracketed | None:
    r"""Read a text that is one array in brackets; None where it is anything else.

    Parameters
    ----------
    text : all of it.
    label : its name, for messages.

    Raises InputError where NumPy left out rows.

    >>> read_brackets("t x\n[[0.  1.]\n [0.1 2.]\n [0.2 3.]]", "a.txt").names
    ('t', 'x')
    >>> read_brackets("x = [0 1\n 0.1 2\n 0.2 3];", "a.m").values[:, 1].tolist()
    [1.0, 2.0, 3.0]
    """
    parts = list(_INNER.finditer(text))
    rows = [_APART.split(part[1].strip(" \t\r\n,;")) for part in parts]
    widths = Counter(len(row) for row in rows if len(row) > 1)
    if not widths:
        return None
    width = widths.most_common(1)[0][0]
    first = next(j for j, row in enumerate(rows) if len(row) == width)
    # Those before it are the sizes that C declares.
    above, behind = text[: parts[first].start()], text[parts[-1].end() :]
    between = [text[a.end() : b.start()] for a, b in pairwise(parts[first:])]
    if not all(_BEHIND.fullmatch(_CUT.sub("", own)) for own in (*between, behind)):
        return None
    rows = rows[first:]
    if len(rows) == 1:
        lines = (line.strip(" \t\r,") for line in _ROW_ENDS.split(parts[first][1]))
        rows = [_APART.split(line) for line in lines if line]
    if any(map(_CUT.search, (*between, *(cell for row in rows for cell in row)))):
        raise InputError(
            f"{label!r} is an array of which a part is left out (...); save all of it, "
            "in Python by numpy.savetxt"
        )
    if len(rows) < _FEWEST or len({len(row) for row in rows}) > 1:
        return None
    try:
        values = np.array(rows, dtype=float)
    except ValueError:
        return None
    return Bracketed(_names_above(above, values.shape[1]), values)


def _names_above(text: str, width: int) -> tuple[str, ...]:
    """Give the names in the last line above the rows that has as many words as these have cells."""
    lines: Sequence[str] = [line.strip(" \t\r#%,;[({") for line in text.splitlines()]
    for line in (line for line in reversed(lines) if line):
        words = tuple(_APART.split(line))
        return words if len(words) == width > 1 and "=" not in line else ()
    return ()
