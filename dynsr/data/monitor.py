"""Monitors: lines with a name before each value, or a clock and an arrow before them.

So write small computers on their serial line, and people who print while a program runs.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

import numpy as np

from dynsr.data.amounts import is_unit
from dynsr.data.assembling import Columns, assemble
from dynsr.data.trajectory import FEWEST_ROWS

_ARROW = re.compile(r"\s*(?P<stamp>\d{1,2}:\d\d:\d\d(?:[.,]\d+)?)\s*->\s*(?P<rest>.*)")
# What a program writes to its log: perhaps a time, how grave it is, perhaps who writes.
_LOGGED = re.compile(
    r"\W{0,2}(?P<stamp>\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d(?:[.,]\d+)?)?.{0,60}?"
    r"\b(?:DEBUG|INFO|WARN(?:ING)?|ERROR|CRITICAL)\b[\]:|\s>-]*(?:[\w.]+:(?=[^\W\d])|.* - )?"
    r"(?P<rest>.*)"
)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan|inf"
_PAIR = re.compile(
    rf"[\s,;|]*(?P<name>[^\W\d][\w ()/%-]*?)\s*[:=]\s*(?P<value>{_NUMBER})(?![.:\d])"
)
_UNIT = re.compile(r"\s*(?P<unit>[^\s,;|:=\d]+)(?=[\s,;|]|$)(?!\s*[:=])")
_BETWEEN = re.compile(r"[\s,;|]+")
_VALUE = re.compile(_NUMBER, re.IGNORECASE)
_CLOCK = "time"

Cells = dict[str, str]


def read_monitor(lines: Iterable[str], label: str) -> Columns | None:
    """Read lines that a program printed; None where most of them are not of that kind.

    Parameters
    ----------
    lines : those of the file.
    label : what a message calls it.

    A line is of pairs such as ``t: 0.1, x = 2.5 mV``, or of a clock, ``->`` and pairs or numbers.
    What a log has before them is left out, but for the time.
    Lines that are neither, or have other names than most, are left out.

    >>> found = read_monitor([f"t={k} x={k * k}" for k in range(9)], "log.txt")
    >>> found.names, found.values[1][:4]
    (('t', 'x'), array([0., 1., 4., 9.]))
    >>> read_monitor(["a: 1", "b: 2"] * 9, "notes.txt") is None
    True
    """
    texts = [line for line in lines if line.strip()]
    every = [_read_line(line) for line in texts]
    usual = Counter(tuple(cells) for cells in every if cells).most_common(1)
    names, count = usual[0] if usual else ((), 0)
    if len(names) < 2 or count < FEWEST_ROWS or 2 * count <= len(texts):
        return None
    rows = [cells for cells in every if cells and tuple(cells) == names]
    notes: tuple[str, ...] = ()
    if count < len(texts):
        other = next(t for t, cells in zip(texts, every, strict=True) if tuple(cells) != names)
        lost = len(texts) - count
        what = "1 line" if lost == 1 else f"{lost} lines"
        notes = (
            f"{what} of {label} without the names of the others ({other.strip()[:40]!r}) skipped",
        )
    columns = [np.array([cells[name] for cells in rows], dtype=object) for name in names]
    return assemble(list(names), columns, label, notes=notes)


def _read_line(line: str) -> Cells:
    """Give name -> cell of a line; nothing where it is no such line."""
    stamped = _ARROW.fullmatch(line.rstrip()) or _LOGGED.fullmatch(line.strip())
    rest = stamped["rest"] if stamped else line.strip()
    cells = _read_pairs(rest)
    if stamped and not cells:
        own = [part for part in _BETWEEN.split(rest.strip()) if part]
        if all(map(_VALUE.fullmatch, own)):
            cells = {f"x{k}" if len(own) > 1 else "x": cell for k, cell in enumerate(own, 1)}
    if stamped and stamped["stamp"] and cells and _CLOCK not in cells:
        return {_CLOCK: stamped["stamp"].replace(",", "."), **cells}
    return cells


def _read_pairs(text: str) -> Cells:
    found: Cells = {}
    place = 0
    while place < len(text):
        pair = _PAIR.match(text, place)
        if pair is None or pair["name"].strip() in found:
            return {}
        place = pair.end()
        name = pair["name"].strip()
        unit = _UNIT.match(text, place)
        if unit is not None:
            if not is_unit(unit["unit"]):
                return {}
            name, place = f"{name} [{unit['unit']}]", unit.end()
        found[name] = pair["value"]
    return found
