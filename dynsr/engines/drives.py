"""Drives: measured inputs as functions of the time, in pieces of polynomials.

The one home of what an input is between its rows: fits, integrations and exports read it here.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import PPoly, make_interp_spline

from dynsr.data import Hold
from dynsr.errors import InputError

# Degree of the spline through a smooth input, whose slopes must not bend at rows either.
_DEGREE = 5
# A difference of two pieces below this share of the values is rounding and no jump.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Drive:
    """An input as pieces of polynomials in the time.

    Parameters
    ----------
    name : what right-hand sides call it.
    starts : (m,) times in seconds at which the pieces begin, none before the one in front of it.
        Before the first and after the last that piece goes on.
    pieces : (c, m) coefficients of each piece in the time since its start, highest power first.

    Raises InputError when they do not fit each other.

    >>> ramp = Drive("u", np.array([0.0, 1.0]), np.array([[1.0, 0.0], [0.0, 1.0]])).compile()
    >>> ramp(0.5), ramp(3.0)
    (0.5, 1.0)
    """

    name: str
    starts: np.ndarray
    pieces: np.ndarray

    def __post_init__(self) -> None:
        """Check the shapes."""
        starts, pieces = np.asarray(self.starts, float), np.asarray(self.pieces, float)
        if (
            starts.ndim != 1
            or pieces.ndim != 2
            or pieces.shape[1:] != starts.shape
            or not len(starts)
        ):
            raise InputError(
                f"input {self.name!r} has {starts.shape} starts and {pieces.shape} pieces; give "
                "(m,) and (c, m) numbers"
            )
        object.__setattr__(self, "starts", starts)
        object.__setattr__(self, "pieces", pieces)

    @classmethod
    def through(cls, name: str, t: np.ndarray, values: np.ndarray, hold: Hold) -> Drive:
        """Give the input that has (n,) values at (n,) times and follows ``hold`` between them.

        Parameters
        ----------
        name : what right-hand sides call it.
        t, values : its rows, times increasing.
        hold : "previous" keeps each value until the next row, "linear" goes straight there, and
            "smooth" is a spline of degree 5, or less where rows are few.

        >>> held = Drive.through("u", np.arange(3.0), np.array([0.0, 2.0, 2.0]), "previous")
        >>> held.at(np.array([0.5, 1.0, 1.5])).tolist(), held.jumps.tolist()
        ([0.0, 2.0, 2.0], [1.0])
        """
        if hold == "previous" or len(t) < 2:
            return cls(name, t, values[None])
        if hold == "linear":
            return cls(name, t[:-1], np.stack([np.diff(values) / np.diff(t), values[:-1]]))
        degree = min(_DEGREE, (len(t) - 1) // 2 * 2 - 1) if len(t) > 3 else 1
        pieces = PPoly.from_spline(make_interp_spline(t, values, k=degree))
        # Knots that coincide at the ends begin pieces of no length.
        some = np.flatnonzero(np.diff(pieces.x) > 0)
        return cls(name, pieces.x[some], pieces.c[:, some])

    @cached_property
    def jumps(self) -> np.ndarray:
        """Times, increasing, at which the input changes its value at once."""
        after = self.pieces[-1, 1:]
        before = _value(self.pieces[:, :-1], np.diff(self.starts))
        size = _ROUNDING * np.max(np.abs(self.pieces[-1]))
        found: np.ndarray = self.starts[1:][np.abs(after - before) > size]
        return found

    def at(self, t: np.ndarray, before: bool = False) -> np.ndarray:
        """Give the input at times of any shape; where it jumps, what it is after the jump.

        Parameters
        ----------
        t : the times.
        before : give what it is before a jump.
        """
        after = np.searchsorted(self.starts, t, side="left" if before else "right")
        place = np.maximum(after - 1, 0)
        return _value(self.pieces[:, place], t - self.starts[place])

    def within(self, begin: float, end: float) -> Drive:
        """Give the pieces between two times; the last one goes on, so that no jump is at the end.

        Parameters
        ----------
        begin, end : the times.
        """
        first = max(int(np.searchsorted(self.starts, begin, side="right")) - 1, 0)
        last = max(int(np.searchsorted(self.starts, end)), first + 1)
        return replace(self, starts=self.starts[first:last], pieces=self.pieces[:, first:last])

    def compile(self) -> Callable[[float], float]:
        """Give the input as a function of one time, without arrays."""
        starts, rows = self.starts.tolist(), self.pieces.T.tolist()

        def at(t: float) -> float:
            i = max(bisect_right(starts, t) - 1, 0)
            value, past = 0.0, t - starts[i]
            for coefficient in rows[i]:
                value = value * past + coefficient
            return value

        return at


def jumps_of(drives: Sequence[Drive]) -> np.ndarray:
    """Give the times, increasing, at which any of some inputs jumps.

    Parameters
    ----------
    drives : the inputs.
    """
    return np.unique(np.concatenate([np.empty(0), *(drive.jumps for drive in drives)]))


def _value(pieces: np.ndarray, past: np.ndarray) -> np.ndarray:
    """Evaluate pieces (c, ...), the highest power first, the time ``past`` their starts."""
    value = np.zeros(np.shape(past))
    for coefficients in pieces:
        value = value * past + coefficients
    return value
