"""Known noise: measurement errors that the user, or a column of the data, says."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynsr.errors import InputError, one_line

_SHARE = re.compile(r"\s*(?P<number>[^%]*)%\s*")


@dataclass(frozen=True, eq=False)
class KnownNoise:
    """The measurement errors of one state of a run.

    Parameters
    ----------
    sd : (n,) standard deviation at every row that does not grow with the state, in its units.
    share : standard deviation as a share of the state's size, which is added in squares.
    sure : whether its size is right; otherwise it says how rows differ, and its size is
        estimated.

    >>> KnownNoise(np.array([3.0, 3.0]), 0.1).at(np.array([0.0, 40.0]))
    array([3., 5.])
    """

    sd: np.ndarray
    share: float = 0.0
    sure: bool = True

    def at(self, x: np.ndarray) -> np.ndarray:
        """Give the standard deviation (n,) at true values (n,) of the state."""
        found: np.ndarray = np.hypot(self.sd, self.share * x)
        return found

    def select(self, rows: slice | np.ndarray) -> KnownNoise:
        """Give the errors of some rows."""
        return replace(self, sd=self.sd[rows])

    def in_units(self, unit: float) -> KnownNoise:
        """Give the errors where the state is counted in another unit."""
        return replace(self, sd=self.sd / unit)


def read_noise(state: str, value: Any, rows: int) -> KnownNoise | str:
    """Read what a caller says of the errors of one state; the name of a column comes back as such.

    Parameters
    ----------
    state : the state.
    value : a standard deviation in its units, a share of it such as "5 %", (n,) standard deviations
        at the rows, or the name of a column.
    rows : how many there are.

    Raises InputError when it is not one of these, or no error is above 0.

    >>> read_noise("x", "5 %", 2).share, read_noise("x", 0.1, 2).sd, read_noise("x", "x_sd", 2)
    (0.05, array([0.1, 0.1]), 'x_sd')
    """
    share, said = 0.0, _shown(value)
    if isinstance(value, str):
        percent = _SHARE.fullmatch(value)
        number = _as_number(percent["number"] if percent else value)
        if number is None and percent is None:
            return value.strip()
        value, share = (0.0, (number or 0.0) / 100) if percent else (number, 0.0)
    try:
        sd = np.array(value, dtype=float)
    except (TypeError, ValueError):
        sd = np.array(np.nan)
    sd = np.full(rows, float(sd)) if sd.ndim == 0 else sd
    if sd.shape != (rows,):
        raise InputError(
            f"the noise of {state!r} has shape {sd.shape} but there are {rows} rows; give one "
            "number, a share such as '5 %', a column, or one number a row"
        )
    return check_noise(state, KnownNoise(sd, share), said)


def check_noise(state: str, noise: KnownNoise, said: str) -> KnownNoise:
    """Give errors that can be used: where a row has none above 0, the usual one is taken.

    Parameters
    ----------
    state, noise : whose errors.
    said : how a message calls them.

    Raises InputError when no error is above 0, or one is negative.
    """
    if noise.share > 0:
        return noise
    there = np.isfinite(noise.sd) & (noise.sd > 0)
    if not there.any() or np.any(noise.sd < 0):
        raise InputError(
            f"the noise of {state!r} is {said}; give a standard deviation above 0, a share such as "
            "'5 %', or a column of them"
        )
    usual = float(np.sqrt(np.mean(noise.sd[there] ** 2)))
    return replace(noise, sd=np.where(there, noise.sd, usual))


def check_names(noise: Mapping[str, Any], states: Sequence[str]) -> None:
    """Raise InputError where the noise of something is said that is no state."""
    for state in noise:
        if state not in states:
            raise InputError(
                f"noise names {state!r}, which is no state; the states are: {', '.join(states)}"
            )


def _as_number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _shown(value: Any) -> str:
    return one_line(repr(value))[:60]
