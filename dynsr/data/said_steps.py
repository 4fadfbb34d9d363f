"""Steps that are said: the sampling rate or the interval between rows, in a line above a table."""

from __future__ import annotations

import re
from collections.abc import Iterable

_NUMBER = r"\W*?(?P<number>\d+(?:[.,]\d+)?(?:e[+-]?\d+)?)"
_RATE = re.compile(
    r"\b(?:(?:sampl(?:e|ing)|frame|acquisition|acq|scan|data|logging)[\s_.-]*(?:rate|freq(?:uency)?)|fs)"
    rf"\b(?:\W*(?P<before>k|M)?Hz)?{_NUMBER}\s*(?P<by>k|M)?(?:Hz|fps|sps|S/s|/s|per second)?\W*$",
    re.IGNORECASE,
)
_STEP = re.compile(
    r"\b(?:(?:sampl(?:e|ing)|logging|scan|frame|time)[\s_.-]*(?:interval|period|step|increment)|dt|delta[\s_]?t)"
    rf"\b(?:\W*\(?(?P<before>ns|us|µs|ms|s|min|h)\)?)?{_NUMBER}"
    r"\s*(?P<unit>ns|us|µs|ms|s|secs?|seconds?|min|minutes?|h|hours?)?\W*$",
    re.IGNORECASE,
)
_THOUSANDS = {"k": 1e3, "m": 1e6}
_SECONDS = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}


def find_said_step(lines: Iterable[str]) -> tuple[float, str] | None:
    """Give the seconds between rows that a line says, and the line; None where none does.

    Parameters
    ----------
    lines : what is above a table.

    >>> find_said_step(["Operator: me", "Sampling rate: 2 kHz"])
    (0.0005, 'Sampling rate: 2 kHz')
    >>> find_said_step(["Laser frequency: 5 Hz"]) is None
    True
    """
    for line in lines:
        text = line.strip().strip(',;\t"# ').replace('"', "")
        if rate := _RATE.search(text):
            more = (rate["by"] or rate["before"] or "").lower()
            number = float(rate["number"].replace(",", ".")) * _THOUSANDS.get(more, 1.0)
            step = 1 / number if number else 0.0
        elif said := _STEP.search(text):
            unit = (said["unit"] or said["before"] or "s").lower()
            size = next(size for start, size in _SECONDS.items() if unit.startswith(start))
            step = float(said["number"].replace(",", ".")) * size
        else:
            continue
        if step > 0:
            return step, text
    return None
