"""Following: a fitted system integrated from its states, with no defects."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from dynsr.fit import r_squared
from dynsr.selection.comparison import COMPARISON, SystemFit


class _TooLong(Exception):
    """An integration takes more evaluations than any that reproduces the data."""


def follow(
    fit: SystemFit, evaluations: int = COMPARISON.evaluations, pieces: int = 1
) -> np.ndarray:
    """Integrate a system from its fitted states over the runs, or pieces of them.

    Gives the (n, k) states at the rows of its mesh; NaN where no solution goes.

    Parameters
    ----------
    fit : the system.
    evaluations : of the right-hand sides for each row; a run that takes more has no solution.
    pieces : of each run; a chaotic one parts from the data over the whole.
    """
    from scipy.integrate import solve_ivp

    mesh, constants = fit.problem.mesh, fit.fit.constants
    slope = fit.problem.slope.at
    used = {str(symbol) for expr in fit.exprs.values() for symbol in expr.free_symbols}
    read = [name in used for name in mesh.driven_names]
    numbers = constants.tolist()
    first = np.setdiff1d(np.arange(len(mesh.t)), mesh.left + 1)
    found = np.full(mesh.x.shape, np.nan)
    ends = [*first[1:], len(mesh.t)]
    cuts = [
        np.unique(np.linspace(a, b, pieces + 1).astype(int))
        for a, b in zip(first, ends, strict=True)
    ]
    for begin, end in [pair for cut in cuts for pair in pairwise(cut)]:
        left = iter(range(evaluations * (end - begin)))

        def rhs(at: float, x: np.ndarray, own: slice, left: Iterator[int] = left) -> list[float]:
            if next(left, None) is None:
                raise _TooLong
            driven = [
                float(np.interp(at, mesh.t[own], row)) if needed else 0.0
                for row, needed in zip(mesh.driven[:, own], read, strict=True)
            ]
            return slope(*x.tolist(), *driven, *numbers)

        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            start = fit.fit.states[begin]
            # A row that is there twice is a jump: a solver begins anew.
            jumps = begin + 1 + np.flatnonzero(np.diff(mesh.t[begin:end]) == 0)
            for first_row, last in pairwise([begin, *jumps, end]):
                piece = slice(first_row, last)
                t = mesh.t[piece]
                if len(t) == 1:
                    found[piece] = start
                    continue
                try:
                    solved = solve_ivp(
                        rhs, (t[0], t[-1]), start, "LSODA", t, rtol=1e-5, atol=1e-8, args=(piece,)
                    )
                except _TooLong:
                    found[begin:end] = np.nan
                    break
                if solved.y.shape[1] < len(t) or not np.all(np.isfinite(solved.y[:, -1])):
                    found[begin:end] = np.nan
                    break
                found[piece], start = solved.y.T, solved.y[:, -1]
    return found


def integrate(fit: SystemFit, evaluations: int = COMPARISON.evaluations, pieces: int = 1) -> float:
    """Give the mean R2 of a system that is integrated from its fitted states.

    R2 is 1 - sum (x - y)^2 / sum (y - mean y)^2 of each measured state, from -1 up.

    Parameters
    ----------
    fit, evaluations, pieces : as in :func:`follow`.
    """
    mesh = fit.problem.mesh
    found, own = follow(fit, evaluations, pieces), np.ix_(mesh.measured, mesh.rows > 0)
    return r_squared(mesh.x[own], found[own])
