"""Lines: columns that only say the time or the row again, however coarsely they are written."""

from __future__ import annotations

import re

import numpy as np

from dynsr.data.name_parts import bare_name

_ROWS = re.compile(
    r"|#|n[ro]\.?|n°|№|num(ber)?|rownames?|(row|record|obs(ervation)?|sample|meas(urement)?|line|point|"
    r"reading|scan|messung|lfd\.?)[\s_.]*(n[ro]\.?|num(ber)?|id|index|#)|index|idx|obs|sample|id|"
    r"unnamed: \d+",
    re.IGNORECASE,
)
# What programs of tests count, and people who train: steps, cycles, laps.
_PHASES = re.compile(
    r"(program.?)?(step|cycle|segment|stage|phase|loop|sub.?step|lap)[\s_.]*"
    r"(n[ro]\.?|num(ber)?|id|index|idx|count(er)?|#)|laps?",
    re.IGNORECASE,
)
# What differs by no more than this share of its size differs in the rounding of float64 alone.
ROUNDED = 8 * float(np.finfo(float).eps)
_FEWEST = 8
# Columns that rise over so many of their own digits follow a line closely where they follow one.
_DIGITS = 200.0
_EXACT = 1e-9
# Rounding moves the fitted slope too.
_OFF = 1.2


def last_digit(values: np.ndarray) -> float:
    """Give the value of the last decimal digit that numbers are written with; whole numbers have 1.

    >>> last_digit(np.array([0.25, 1.5])), last_digit(np.array([20.0, 30.0]))
    (0.01, 1.0)
    """
    largest = float(np.max(np.abs(values), initial=0.0))
    reach = ROUNDED * largest
    few = values[:: max(len(values) // 1000, 1)]
    for digits in range(16):
        for own in (few, values):
            if np.any(np.abs(own - np.round(own, digits)) > reach):
                break
        else:
            return float(10.0**-digits)
    return max(reach, float(np.finfo(float).tiny))


def follows_line(values: np.ndarray, t: np.ndarray, codes: np.ndarray | None = None) -> bool:
    """Whether numbers are a straight line in the times, no further off than both are rounded.

    Parameters
    ----------
    values, t : (n,) finite numbers.
    codes : (n,) the number of the trajectory of each row: all have the same slope, each its own
        start; None for one.
    """
    if not np.ptp(values) > 0 or not np.ptp(t) > 0:
        return False
    codes = np.zeros(len(t), dtype=int) if codes is None else codes
    own, times = _centred(values, codes), _centred(t, codes)
    square = float(np.sum(times**2))
    if not square > 0:
        return False
    slope = float(np.sum(own * times)) / square
    off = own - slope * times
    order = np.argsort(codes, kind="stable")
    starts = np.flatnonzero(np.diff(codes[order], prepend=-1))
    widest = np.maximum.reduceat(off[order], starts) - np.minimum.reduceat(off[order], starts)
    allowed = _OFF * (last_digit(values) + abs(slope) * last_digit(t))
    return slope != 0 and bool(np.all(widest <= allowed + _EXACT * float(np.ptp(values))))


def _centred(values: np.ndarray, codes: np.ndarray) -> np.ndarray:
    sums = np.bincount(codes, values)
    return np.asarray(values - (sums / np.bincount(codes))[codes])


def is_second_time(values: np.ndarray, t: np.ndarray, codes: np.ndarray, called: bool) -> bool:
    """Whether a column is the time again, in another unit or from another start.

    Parameters
    ----------
    values, t : (n,) finite numbers.
    codes : (n,) the number of the trajectory of each row.
    called : whether its name speaks of time. Otherwise it must rise over many of its own digits: a
        slow quantity that was rounded is a line too as long as it moves by few.
    """
    if not called and np.ptp(values) < _DIGITS * last_digit(values):
        return False
    return follows_line(values, t, codes)


def numbers_phases(name: str, values: np.ndarray) -> bool:
    """Whether a column counts the steps or cycles of a program, by its name and whole numbers.

    Parameters
    ----------
    name : its name.
    values : (n,) numbers.

    >>> laps = np.repeat([1.0, 2.0], 9)
    >>> [numbers_phases(name, laps) for name in ("Step_Index", "lap", "steps")]
    [True, True, False]
    """
    return _PHASES.fullmatch(bare_name(name)) is not None and bool(np.all(values % 1 == 0))


def numbers_rows(name: str, values: np.ndarray, codes: np.ndarray) -> bool:
    """Whether a column only numbers the rows, of the file or of each trajectory.

    Parameters
    ----------
    name : its name; one that speaks of rows needs less evidence.
    values : (n,) numbers.
    codes : (n,) the number of the trajectory of each row.

    >>> rows = np.arange(1.0, 10.0)
    >>> one = np.zeros(9, dtype=int)
    >>> [numbers_rows("x", own, one) for own in (rows, rows[::-1], rows**2)]
    [True, True, False]
    """
    if len(values) < _FEWEST or not np.all(np.isfinite(values)) or np.any(values % 1 != 0):
        return False
    steps = np.diff(values)
    if np.all(steps == 1):
        return True
    moved = steps[steps != 0]  # a row that is written twice has one number
    one_way = len(moved) > len(steps) / 2 and (np.all(moved > 0) or np.all(moved < 0))
    if one_way and _ROWS.fullmatch(bare_name(name)):
        return True
    order = np.argsort(codes, kind="stable")
    inside = np.diff(values[order])[np.diff(codes[order]) == 0]
    if len(inside) >= _FEWEST - 1 and np.all(inside == 1):
        return True
    # Those of a file that was sorted otherwise since.
    ranks = np.sort(values)
    return bool(ranks[0] in (0, 1) and np.all(np.diff(ranks) == 1))
