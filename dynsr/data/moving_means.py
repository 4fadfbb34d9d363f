"""Moving means: columns that only say another one again, smoothed over some rows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from dynsr.data.lines import last_digit
from dynsr.data.trajectory import FEWEST_ROWS

_CALLED = re.compile(
    r".*(average|avg|mean|rolling|moving|smooth|mittel|moyenne|media|promedio).*", re.IGNORECASE
)
# A month of days at most. A column must move by so many digits that no other is as close by chance.
_WIDEST, _DIGITS = 31, 20.0


def find_moving_means(columns: Mapping[str, Sequence[np.ndarray]]) -> dict[str, tuple[str, int]]:
    """Give the columns that are moving means, each with the one that it is of, and how many rows.

    Parameters
    ----------
    columns : name -> values in each trajectory, in order of time; NaN where a cell is empty. Only
        one that is called a mean is looked at.

    A mean is of the rows up to its own, or of as many before as behind it.

    >>> cases = np.array([1.0, 4, 9, 16, 25, 36, 49, 64, 81, 100])
    >>> means = np.append([np.nan] * 2, (cases[:-2] + cases[1:-1] + cases[2:]) / 3)
    >>> find_moving_means({"cases": [cases], "rolling mean": [means.round(1)]})
    {'rolling mean': ('cases', 3)}
    """
    found = {}
    for name in filter(_CALLED.fullmatch, columns):
        for other in (n for n in columns if n != name and n not in found):
            width = _width(columns[name], columns[other])
            if width:
                found[name] = other, width
                break
    return found


def _width(means: Sequence[np.ndarray], values: Sequence[np.ndarray]) -> int:
    """Give the rows that each mean is of; 0 where they are no means."""
    finite = [own[np.isfinite(own)] for own in (np.concatenate(means), np.concatenate(values))]
    if not all(map(len, finite)):
        return 0
    digit = last_digit(finite[0])
    if np.ptp(finite[0]) <= _DIGITS * digit:
        return 0
    for width in range(2, _WIDEST + 1):
        for back in {width - 1, (width - 1) // 2}:
            seen = [_off(one, own, width, back) for one, own in zip(means, values, strict=True)]
            off = np.concatenate(seen)
            if len(off) >= FEWEST_ROWS and off.max() <= digit:
                return width
    return 0


def _off(means: np.ndarray, values: np.ndarray, width: int, back: int) -> np.ndarray:
    """Give how far means are from those of ``width`` rows, ``back`` of them before their own."""
    if len(values) < width:
        return np.empty(0)
    windows = np.lib.stride_tricks.sliding_window_view(values, width)
    own = means[back : back + len(windows)] - windows.mean(axis=1)
    return np.abs(own[np.isfinite(own)])
