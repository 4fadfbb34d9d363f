"""Drives: measured inputs on their way to an engine, as pieces of polynomials."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynsr.errors import InputError


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
