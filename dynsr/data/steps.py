"""Steps: columns that hold their value over rows and then jump are set from outside."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from dynsr.data.holding import choose_hold
from dynsr.data.lines import last_digit
from dynsr.data.name_parts import bare_name

_SET = re.compile(
    r".*(valve|set.?point|heater|pump|relay|switch|pwm|duty|dose|dosing|on.?off|ventil|heiz|pumpe|"
    r"soll|consign|v[áa]lvula|bomba|vanne|pompe|command|cmd|feed|inflow|"
    r"stirrer|throttle|fan|lamp|led).*",
    re.IGNORECASE,
)
# What is set as often as it is measured.
_MEASURED_TOO = re.compile(
    r".*(voltage|spannung|tensi[óo]n|current|strom|courant|corriente).*", re.IGNORECASE
)


@dataclass(frozen=True)
class StepSettings:
    """How the values of a column say that it is set from outside.

    Parameters
    ----------
    repeats : share of the rows that repeat the row before.
    alone : share of all that it moves which it moves in single steps between rows that repeat.
    large : smallest usual step, counted in distances of neighbouring values: what moves and was
        rounded, or counts, goes by one.
    coarse : smallest distance of neighbouring values, counted in their last digit, of what steps
        by less.
    single : share of the steps from which on it goes by one at a time.
    few : most values of what does, as up a stair.
    many : more values than these that follow each other smoothly are those of a slow measurement.
    smooth : half the mean squared step over the variance (von Neumann 1941) below which they do.
    pulses : the same from which on it comes in pulses, as rain does, and rests between them.
    """

    repeats: float = 0.5
    alone: float = 0.8
    large: float = 2.0
    coarse: float = 3.0
    single: float = 0.8
    few: int = 6
    many: int = 10
    smooth: float = 0.3
    pulses: float = 0.5


_SETTINGS = StepSettings()


def is_set(name: str, pieces: Sequence[np.ndarray], settings: StepSettings = _SETTINGS) -> bool:
    """Whether a column holds its value and steps, so that it is an input and no state.

    Parameters
    ----------
    name : that of the column; one of what is set, such as a valve, needs no large steps. Nor does a
        voltage or a current whose values do not follow each other as those of a slow measurement.
    pieces : its values in each trajectory, in order of time; NaN where a cell is empty.
    settings : the numbers that decide.

    >>> valve = np.repeat([0.0, 3.0, 1.0, 3.0, 0.0], 6)
    >>> slow = np.round(np.linspace(20, 22, 100), 1)
    >>> is_set("u", [valve]), is_set("u", [slow])
    (True, False)
    """
    own = [piece[np.isfinite(piece)] for piece in pieces]
    every = np.concatenate(own)
    levels, counts = np.unique(every, return_counts=True)
    if len(levels) < 2:
        return False
    if len(levels) == 2:
        return bool(counts.min() > 1)
    steps = [np.diff(values) for values in own]
    still = sum(int(np.sum(step == 0)) for step in steps)
    # What is another constant in each trajectory never steps.
    if still == sum(map(len, steps)) or still < settings.repeats * sum(map(len, steps)):
        return False
    jumps = np.concatenate([_single_steps(step) for step in steps])
    smallest = float(np.min(np.diff(levels)))
    changes = np.abs(np.concatenate(steps))
    if float(np.sum(jumps)) < settings.alone * float(np.sum(changes)):
        large = np.median(changes[changes > 0]) >= (settings.large - 1e-6) * smallest
        return bool(large and _roughness(own) >= settings.pulses)
    both_ways = np.array_equal(levels, levels[-1] * np.array([-1.0, 0.0, 1.0]))
    if both_ways or _SET.fullmatch(bare_name(name)):
        return True
    rough = _roughness([v[np.flatnonzero(np.diff(v, prepend=np.nan) != 0)] for v in own])
    often = len(levels) <= settings.few or rough >= settings.smooth
    if often and _MEASURED_TOO.fullmatch(bare_name(name)):
        return True
    if len(levels) > settings.many and rough < settings.smooth:
        return False
    if float(np.median(jumps)) >= (settings.large - 1e-6) * smallest:
        return True
    if smallest < (settings.coarse - 1e-6) * last_digit(levels):
        return False
    single = float(np.mean(jumps < 1.5 * smallest))
    return len(levels) <= settings.few or single < settings.single


def is_noted_at_changes(name: str, pieces: Sequence[np.ndarray], fewest: int = 0) -> bool:
    """Whether a column has cells only where it changes, and holds its value between them.

    Parameters
    ----------
    name : that of the column.
    pieces : its values in each trajectory, in order of time; NaN where a cell is empty.
    fewest : a column of fewer cells is one that is noted so.
    """
    if any(not np.isfinite(piece[0]) for piece in pieces) or all(
        np.isfinite(piece).all() for piece in pieces
    ):
        return False
    own = [piece[np.isfinite(piece)] for piece in pieces]
    levels = np.unique(np.concatenate(own))
    few = len(levels) == 2 or max(map(len, own)) < fewest
    return len(levels) > 1 and (
        few or _SET.fullmatch(bare_name(name)) is not None or is_set(name, own)
    )


def hold_on(values: np.ndarray) -> np.ndarray:
    """Give empty cells the value before them.

    Parameters
    ----------
    values : (n,) numbers; those before the first value stay NaN.

    >>> hold_on(np.array([np.nan, 1.0, np.nan, 2.0]))
    array([nan,  1.,  1.,  2.])
    """
    there = np.isfinite(values)
    last = np.maximum.accumulate(np.where(there, np.arange(len(values)), -1))
    return np.where(last >= 0, values[np.maximum(last, 0)], np.nan)


def between_rows(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Give the values of an input at all rows, where some of its cells are empty.

    Between its rows an input keeps its value, or goes on to the next one
    (:func:`dynsr.data.holding.choose_hold`).

    Parameters
    ----------
    t : (n,) times.
    values : (n,) numbers; NaN where a cell is empty. Without any number they stay as they are.

    >>> between_rows(np.arange(5.0), np.array([0.0, np.nan, 2.0, 4.0, np.nan]))
    array([0., 1., 2., 4., 4.])
    """
    there = np.isfinite(values)
    if there.all() or not there.any():
        return values
    own_t, own = t[there], values[there]
    hold = choose_hold(own_t, own)
    if hold == "previous":
        held = hold_on(values)
        return np.where(np.isfinite(held), held, own[0])
    if hold == "smooth" and len(own) > 3:
        inside = np.clip(t, own_t[0], own_t[-1])
        return np.where(there, values, CubicSpline(own_t, own)(inside))
    return np.where(there, values, np.interp(t, own_t, own))


def _single_steps(steps: np.ndarray) -> np.ndarray:
    """Give the sizes of the steps between rows that repeat."""
    moves = np.pad(steps != 0, 1)
    return np.asarray(np.abs(steps)[moves[1:-1] & ~moves[:-2] & ~moves[2:]])


def _roughness(pieces: Sequence[np.ndarray]) -> float:
    """Give half the mean squared step over the variance: 1 for independent values."""
    steps = sum(float(np.sum(np.diff(piece) ** 2)) for piece in pieces)
    squares = sum(float(np.sum((piece - np.mean(piece)) ** 2)) for piece in pieces)
    return steps / (2 * squares) if squares > 0 else 0.0
