"""Trajectory: states of a system at increasing times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynsr.errors import InputError
from dynsr.expression import check_name


def refuse_mask(values: Any) -> None:
    """Raise InputError when values of an array are masked: what stands below a mask is no data.

    >>> refuse_mask(np.ma.masked_array([1.0, -99.0], mask=[False, True]))
    Traceback (most recent call last):
    ...
    dynsr.errors.InputError: 1 of 2 values are masked; drop those rows, or fill them in
    """
    count = int(np.sum(np.ma.getmaskarray(values))) if isinstance(values, np.ma.MaskedArray) else 0
    if count:
        raise InputError(
            f"{count} of {values.size} values are masked; drop those rows, or fill them in"
        )


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States (and inputs) of one run of a system.

    Parameters
    ----------
    t : (n,) times in seconds, strictly increasing.
    x : (n, k) states in the system's own units.
    states : the k names of the columns of ``x``.
    inputs : (n, m) known inputs at the same times; empty by default.
    input_names : the m names of the columns of ``inputs``.
    origin : where it came from: engine, version, tolerances.

    Raises InputError, naming the row, when times do not increase or a value is not finite.

    >>> Trajectory([0.0, 0.5], [[1.0], [2.0]], ("x",)).x.shape
    (2, 1)
    """

    t: np.ndarray
    x: np.ndarray
    states: tuple[str, ...]
    inputs: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    input_names: tuple[str, ...] = ()
    origin: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Bring the fields to float64 and check them."""
        for given in (self.t, self.x, self.inputs):
            refuse_mask(given)
        t = np.asarray(self.t, dtype=float)
        x = np.asarray(self.x, dtype=float)
        u = np.asarray(self.inputs, dtype=float)
        states, input_names = tuple(self.states), tuple(self.input_names)
        if not input_names:
            u = np.empty((len(t), 0))
        if t.ndim != 1 or x.shape != (len(t), len(states)) or u.shape != (len(t), len(input_names)):
            raise InputError(
                f"t {t.shape}, x {x.shape} and inputs {u.shape} do not fit {len(states)} states "
                f"and {len(input_names)} inputs; rows are times, columns are states"
            )
        names = [*states, *input_names]
        for name in names:
            check_name(name, "column")
        clash = sorted({n for n in names if names.count(n) > 1 or n == "t"})
        if clash:
            raise InputError(f"column name {clash[0]!r} is used twice (t is the time); rename one")
        _check_times(t)
        _check_finite(np.column_stack([x, u]), names)
        for key, value in (("t", t), ("x", x), ("inputs", u), ("states", states)):
            object.__setattr__(self, key, value)
        object.__setattr__(self, "input_names", input_names)

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.t)

    @property
    def names(self) -> tuple[str, ...]:
        """States, then inputs."""
        return (*self.states, *self.input_names)

    @property
    def columns(self) -> np.ndarray:
        """(n, k + m) states, then inputs."""
        return np.column_stack([self.x, self.inputs])

    def index(self, state: str) -> int:
        """Position of a state; raises InputError that lists the states when there is none."""
        if state not in self.states:
            raise InputError(f"unknown state {state!r}; the states are: {', '.join(self.states)}")
        return self.states.index(state)

    def select(self, rows: slice | np.ndarray) -> Trajectory:
        """Give the trajectory of some rows."""
        return Trajectory(
            self.t[rows],
            self.x[rows],
            self.states,
            self.inputs[rows],
            self.input_names,
            self.origin,
        )


def _check_times(t: np.ndarray) -> None:
    bad = np.flatnonzero(~np.isfinite(t))
    if bad.size:
        raise InputError(f"time in row {bad[0] + 1} is {t[bad[0]]}; remove or repair that row")
    steps = np.diff(t)
    bad = np.flatnonzero(steps <= 0)
    if bad.size:
        i = int(bad[0])
        word = "repeats" if steps[i] == 0 else "runs backwards"
        raise InputError(
            f"time {word} at row {i + 2} ({t[i]:g} then {t[i + 1]:g}); "
            "sort the rows by time and keep one row a time"
        )


def _check_finite(values: np.ndarray, names: list[str]) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        row, column = bad[0]
        raise InputError(
            f"column {names[column]!r} holds {values[row, column]} in row {row + 1}; "
            "remove or fill such rows"
        )
