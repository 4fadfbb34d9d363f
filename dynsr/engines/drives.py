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

    @cached_property
    def slope(self) -> Drive:
        """The derivative of the input by the time, piece by piece."""
        powers = np.arange(len(self.pieces) - 1, 0, -1)[:, None]
        found = self.pieces[:-1] * powers
        return replace(self, pieces=found if len(found) else np.zeros_like(self.pieces))

    @cached_property
    def kinks(self) -> np.ndarray:
        """Times, increasing, at which the input or its slope changes its value at once.

        Pieces of a higher degree than 1 are those of a spline, which has none.

        >>> t = np.arange(4.0)
        >>> Drive.through("u", t, np.abs(t - 1), "linear").kinks.tolist()
        [1.0]
        """
        if len(self.pieces) > 2:
            return np.empty(0)
        return np.union1d(self.jumps, self.slope.jumps)

    def at(
        self, t: np.ndarray, before: bool = False, inside: np.ndarray | None = None
    ) -> np.ndarray:
        """Give the input at times of any shape; where it jumps, what it is after the jump.

        Parameters
        ----------
        t : the times.
        before : give what it is before a jump.
        inside : times of the same shape, whose pieces are taken: at its end, a piece is what it is
            before a jump.
        """
        where = t if inside is None else inside
        after = np.searchsorted(self.starts, where, side="left" if before else "right")
        place = np.maximum(after - 1, 0)
        return _value(self.pieces[:, place], t - self.starts[place])

    def later(self, name: str, delay: float) -> Drive:
        """Give the input as it was some time before.

        Parameters
        ----------
        name : what right-hand sides call it.
        delay : how long before.

        >>> step = Drive.through("u", np.arange(3.0), np.array([0.0, 2.0, 2.0]), "previous")
        >>> step.later("u_delayed", 0.25).jumps.tolist()
        [1.25]
        """
        return replace(self, name=name, starts=self.starts + delay)

    def within(self, begin: float, end: float) -> Drive:
        """Give the pieces between two times; the last one goes on, so that no jump is at the end.

        Parameters
        ----------
        begin, end : the times.
        """
        first = max(int(np.searchsorted(self.starts, begin, side="right")) - 1, 0)
        last = max(int(np.searchsorted(self.starts, end)), first + 1)
        return replace(self, starts=self.starts[first:last], pieces=self.pieces[:, first:last])

    def then(self, other: Drive) -> Drive:
        """Give this input until another one begins, and that from there on.

        Parameters
        ----------
        other : the other one.

        >>> one, two = (Drive("u", np.array([t]), np.array([[t]])) for t in (1.0, 2.0))
        >>> one.then(two).at(np.array([1.5, 2.5])).tolist()
        [1.0, 2.0]
        """
        own = self.starts < other.starts[0]
        parts = self.pieces[:, own], other.pieces
        rows = max(map(len, parts))
        full = [np.pad(part, ((rows - len(part), 0), (0, 0))) for part in parts]
        starts = np.concatenate([self.starts[own], other.starts])
        return replace(self, starts=starts, pieces=np.concatenate(full, axis=1))

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
