"""Holding: what a measured input does between its rows, chosen from its values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from dynsr.errors import InputError

Hold = Literal["previous", "linear", "smooth"]
HOLDS: tuple[Hold, ...] = get_args(Hold)

Piece = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class HoldSettings:
    """How the values of an input say what it does between rows.

    Parameters
    ----------
    repeats : share of the rows that must repeat the value before for a held input.
    abrupt : share of its changes that must be abrupt: alone, or next to one of the other sign.
    coarse : smallest distance of two values, as a share of their range, from which on steps of that
        size are no mere rounding of a quantity that moves.
    rounded : share of the changes that are of that size where a moving quantity was rounded.
    same : misses below this share of the range are rounding.
    white : half the mean squared step over the variance (von Neumann 1941) from which on a row
        says little of the next. It is 1 for independent values, 0 for slow ones.
    """

    repeats: float = 0.1
    abrupt: float = 0.5
    coarse: float = 0.05
    rounded: float = 0.8
    same: float = 1e-9
    white: float = 0.5


_SETTINGS = HoldSettings()


def choose_hold(t: np.ndarray, values: np.ndarray, settings: HoldSettings = _SETTINGS) -> Hold:
    """Choose what an input does between its rows: keep its value, go straight, or bend.

    Parameters
    ----------
    t : (n,) times, strictly increasing.
    values : (n,) values of the input at those times.
    settings : the numbers that decide.

    "previous" (zero-order hold): it repeats its value and changes in steps
    (:func:`holds_its_value`), or its values are independent of each other, as a program sends them
    out. "smooth" (a spline): most rows lie nearer to the cubic through their four neighbours than
    to the line through two. "linear": all else, such as ramps and measurements with noise.

    >>> t = np.linspace(0.0, 10.0, 101)
    >>> choose_hold(t, np.floor(t / 1.5) % 2), choose_hold(t, np.sin(t))
    ('previous', 'smooth')
    >>> choose_hold(t, np.abs(t - 4.0))
    'linear'
    """
    return choose_hold_together([(t, values)], settings)


def choose_hold_together(pieces: Sequence[Piece], settings: HoldSettings = _SETTINGS) -> Hold:
    """Choose as :func:`choose_hold` does, one way for an input of several runs.

    Parameters
    ----------
    pieces : (times, values) of each run.
    settings : the numbers that decide.

    >>> t = np.linspace(0.0, 10.0, 101)
    >>> choose_hold_together([(t, np.full(101, 2.0)), (t, np.sin(t))])
    'smooth'
    """
    columns = [np.asarray(values, float) for _, values in pieces]
    if holds_its_value(columns, settings):
        return "previous"
    reach = settings.same * max(float(np.ptp(x)) for x in columns)
    misses = [_misses(np.asarray(t, float), np.asarray(x, float)) for t, x in pieces if len(t) > 4]
    straight, bent = np.concatenate([np.empty((2, 0)), *misses], axis=1)
    # A row on both, as on a ramp between its kinks, says nothing.
    told = np.maximum(straight, bent) > reach
    if 2 * np.sum(bent[told] < straight[told]) > np.sum(told):
        return "smooth"
    steps = sum(float(np.sum(np.diff(x) ** 2)) for x in columns)
    squares = sum(float(np.sum((x - np.mean(x)) ** 2)) for x in columns)
    return "previous" if steps > 2 * settings.white * squares else "linear"


def holds_its_value(
    values: np.ndarray | Sequence[np.ndarray], settings: HoldSettings = _SETTINGS
) -> bool:
    """Say whether a column keeps its value over rows and then steps: valve, voltage, setpoint.

    Parameters
    ----------
    values : (n,) values, or those of each run.
    settings : the numbers that decide.

    A quantity that moves and was rounded repeats its value too, but it steps by one digit. A pause
    in a motion repeats it, but the motion goes on over several rows in one direction. A column that
    is constant in every run is a held input.

    >>> t = np.linspace(0.0, 10.0, 101)
    >>> holds_its_value(np.floor(t / 1.5) % 2), holds_its_value(np.round(np.sin(t), 1))
    (True, False)
    """
    columns = [values] if isinstance(values, np.ndarray) else values
    levels = np.unique(np.concatenate([np.asarray(x, float) for x in columns]))
    steps = [np.diff(np.asarray(x, float)) for x in columns]
    every = np.concatenate(steps)
    changes = np.abs(every[every != 0])
    if not len(changes):
        return True
    repeats = int(np.sum(every == 0))
    if repeats < settings.repeats * len(every):
        return False
    smallest = float(np.min(np.diff(levels)))
    if smallest < settings.coarse * (levels[-1] - levels[0]):
        single = int(np.sum(changes < 1.5 * smallest))
        # Of a rounded motion as many steps are of one digit as of none, or all are.
        if repeats <= single or single >= settings.rounded * len(changes):
            return False
    abrupt = sum(_count_abrupt(own) for own in steps)
    return bool(abrupt >= settings.abrupt * len(changes))


def _count_abrupt(steps: np.ndarray) -> int:
    """Count the changes that do not go on in the same direction before or after."""
    sign = np.pad(np.sign(steps), 1)
    here, before, after = sign[1:-1], sign[:-2], sign[2:]
    return int(np.sum((here != 0) & (here != before) & (here != after)))


def _misses(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(2, n - 4) residuals of inner rows: the line through two, the cubic through four others."""
    found = []
    for others in ((1, 3), (0, 1, 3, 4)):
        guess = np.zeros(len(t) - 4)
        at = t[2:-2]
        for i in others:
            weight = np.ones(len(at))
            for j in others:
                if j != i:
                    own, other = (t[k : len(t) - 4 + k] for k in (i, j))
                    weight *= (at - other) / (own - other)
            guess += weight * x[i : len(t) - 4 + i]
        found.append(np.abs(guess - x[2:-2]))
    return np.array(found)


def check_hold(hold: Mapping[str, str] | str | None, names: Sequence[str]) -> dict[str, Hold]:
    """Give the way of every input that a caller named; one word says it of all.

    Parameters
    ----------
    hold : input -> "previous", "linear" or "smooth"; or one of these words.
    names : the inputs that there are.

    Raises InputError when an input or a way is unknown.

    >>> check_hold("linear", ["u", "v"])
    {'u': 'linear', 'v': 'linear'}
    """
    asked = {} if hold is None else hold
    if isinstance(asked, str):
        asked = dict.fromkeys(names, asked)
    if not isinstance(asked, Mapping):
        raise InputError(
            f"hold {hold!r} must be one of {', '.join(HOLDS)}, or such a word for each input: "
            '{"u": "previous"}'
        )
    for name, way in asked.items():
        if name not in names:
            known = f"the inputs are: {', '.join(names)}" if names else "there are no inputs"
            raise InputError(f"hold names {name!r}, which is no input; {known}")
        if way not in HOLDS:
            raise InputError(
                f"input {name!r} cannot be held {way!r}; the ways are: {', '.join(HOLDS)}"
            )
    return {str(name): next(w for w in HOLDS if w == way) for name, way in asked.items()}
