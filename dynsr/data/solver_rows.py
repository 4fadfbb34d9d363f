"""Rows that a solver put on polynomials between its steps, and the errors that it left there.

Solvers of medium order give the rows that are asked for by a polynomial over each step (Shampine
1986). Its slope follows the equations at the ends of the step and errs between them, however
smooth the rows look. Where two polynomials meet, their second derivatives differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Degree of the polynomials.
_DEGREE = 4
# A jump J of the second derivative makes fifth differences of J h^2 times 1, -3, 3 and -1. The
# slope of a step of length H errs by about J H / 8, since it is right at both ends of it.
_SEEN, _BULGE = 2.0, 8.0
# Share of the rows on polynomials, and error of the slopes as a share of their size, from which on
# rows count as interpolated.
_LEAST, _ERROR = 0.1, 1e-5
# Share of the largest difference below which others are rounding.
_FAR_BELOW = 1e-6
# Share of a step by which times may differ that are even.
_EVEN = 1e-3


@dataclass(frozen=True)
class SolverRows:
    """What differences show of rows between the steps of a solver.

    Parameters
    ----------
    share : share of the rows that lie on polynomials of degree 4 or less.
    error : usual error of the slopes between the steps, in units of the column per second.
    relative : the same as a share of the slopes' root mean square.
    """

    share: float
    error: float
    relative: float

    @property
    def interpolated(self) -> bool:
        """Whether rows were interpolated with errors that matter."""
        return self.share >= _LEAST and self.relative >= _ERROR


def find_solver_rows(columns: Sequence[np.ndarray], step: float) -> SolverRows | None:
    """Look for rows on polynomials; None where there are too few rows for that.

    Parameters
    ----------
    columns : (n,) values of one state of each run, all at even times.
    step : time between rows, in seconds.

    >>> from scipy.interpolate import CubicHermiteSpline
    >>> t, ends = np.linspace(0, 10, 201), np.linspace(0, 10, 21)
    >>> rows = CubicHermiteSpline(ends, np.sin(ends), np.cos(ends))
    >>> found = find_solver_rows([rows(t)], 0.05)
    >>> found.interpolated, float(round(found.error / np.std(rows(t, 1) - np.cos(t)), 1))
    (True, 0.4)
    """
    columns = [x for x in columns if len(x) > _DEGREE + 1]
    if not columns:
        return None
    # Each at the middle of the rows that a fifth difference spans.
    first = np.concatenate([np.diff(x)[2:-2] for x in columns])
    third = np.concatenate([np.abs(np.diff(x, 3))[1:-1] for x in columns])
    fifth = np.concatenate([np.abs(np.diff(x, _DEGREE + 1)) for x in columns])
    # A fifth difference is a sum of rows, 32 of them with their signs; twice that is rounding.
    rounding = 64 * np.finfo(float).eps * max(float(np.max(np.abs(x))) for x in columns)
    inside = (fifth <= rounding) & (third > 4 * rounding)
    share = float(np.mean(inside))
    # What is far below the largest of them is rounding too, where polynomials are evaluated.
    met = fifth > max(rounding, _FAR_BELOW * float(fifth.max()))
    if not met.any():
        return SolverRows(share, 0.0, 0.0)
    length = (_DEGREE + 1) * step / float(np.mean(met))
    error = float(np.median(fifth[met])) / (_SEEN * step**2) * length / _BULGE
    size = float(np.sqrt(np.mean(first**2))) / step
    return SolverRows(share, error, error / size if size else 0.0)


def are_even(steps: np.ndarray) -> bool:
    """Whether times between rows are the same, but for a thousandth; False without any.

    Parameters
    ----------
    steps : (n,) times between rows.
    """
    return len(steps) > 0 and bool(np.ptp(steps) <= _EVEN * np.median(steps))


def solver_errors(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(k,) errors that a solver left in the slopes of columns, per second; 0 where none is seen.

    Parameters
    ----------
    t : (n,) times.
    x : (n, k) columns.
    """
    steps = np.diff(t)
    if not are_even(steps):
        return np.zeros(x.shape[1])
    found = [find_solver_rows([column], float(np.median(steps))) for column in x.T]
    return np.array([one.error if one is not None and one.interpolated else 0.0 for one in found])
