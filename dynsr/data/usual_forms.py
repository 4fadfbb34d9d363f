"""Usual forms: what other libraries give and take, as the arrays and times that it is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np

from dynsr.errors import InputError


def in_known_form(source: Any, time: Any) -> tuple[Any, Any]:
    """Give a source, and its times, in a form that is read; other ones stay as they are.

    Parameters
    ----------
    source : also what :func:`as_array` takes, and an array (runs, n, k).
    time : also the step from row to row, or a list of the times of each run.

    Raises InputError where a step is not above 0.

    >>> in_known_form([[1.0, 2.0], [3.0, 4.0]], 0.5)
    (array([[1., 2.],
           [3., 4.]]), array([0. , 0.5]))
    >>> [x.shape for x in in_known_form(np.zeros((3, 9, 2)), None)[0]]
    [(9, 2), (9, 2), (9, 2)]
    """
    source = as_array(source)
    if isinstance(source, np.ndarray) and source.ndim == 3 and not source.dtype.names:
        source = list(source)
    if is_step(time) and isinstance(source, np.ndarray) and source.ndim:
        time = times_of(time, len(source))
    if isinstance(source, list) and isinstance(time, (list, tuple)) and len(time) == len(source):
        arrays = [as_array(run) for run in source]
        each = all(np.ndim(own) == 1 for own in time)
        if each and all(isinstance(run, np.ndarray) for run in arrays):
            return list(zip(time, arrays, strict=True)), None
    return source, time


def is_step(time: Any) -> bool:
    """Whether times are a number, the step between rows.

    Parameters
    ----------
    time : what was given.
    """
    return isinstance(time, Real) and not isinstance(time, bool)


def times_of(step: float, rows: int) -> np.ndarray:
    """Give the times (n,) of rows that are one step from another; InputError for a step of none.

    >>> times_of(0.5, 3)
    array([0. , 0.5, 1. ])
    """
    if not 0 < step < math.inf:
        raise InputError(f"time {step} must be the step from row to row, above 0, or the times")
    return float(step) * np.arange(rows)


def as_array(source: Any) -> Any:
    """Give tensors, rows of numbers and solutions as arrays; what is something else as it is.

    Parameters
    ----------
    source : a tensor, rows of numbers in lists, what ``scipy.integrate.solve_ivp`` gives, or a
        solution of DifferentialEquations.jl, with its times ``t`` and states ``u``.

    >>> as_array([[0.0, 2.0], [0.1, 1.9]]).shape
    (2, 2)
    """
    if isinstance(source, Mapping) and {"t", "y", "t_events", "nfev"} <= source.keys():
        return source["t"], source["y"]
    if hasattr(source, "detach"):  # a tensor of torch, which may be on another device
        return source.detach().cpu().numpy()
    is_rows = isinstance(source, list) and source and all(isinstance(r, list) for r in source)
    if is_rows and all(isinstance(cell, Real) for row in source for cell in row):
        return np.array(source, dtype=float) if len({*map(len, source)}) == 1 else source
    # Frames, records and datasets have their columns as attributes.
    if hasattr(source, "t") and hasattr(source, "u") and not _has_columns(source):
        states = [np.atleast_1d(np.asarray(state, dtype=float)) for state in source.u]
        return np.asarray(source.t, dtype=float), np.array(states)
    return source


def _has_columns(source: Any) -> bool:
    """Whether a source is a table by itself."""
    return isinstance(source, (Mapping, np.ndarray)) or any(
        hasattr(source, name) for name in ("columns", "dims")
    )
