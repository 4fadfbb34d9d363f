"""Trajectory: states of a system at increasing times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from functools import cached_property
from typing import Any

import numpy as np

from dynsr.arguments import Renamed, checked
from dynsr.data.holding import (
    Hold,
    check_hold,
    choose_hold,
    choose_hold_together,
    holds_its_value,
)
from dynsr.data.known_noise import KnownNoise
from dynsr.data.limits import Limits
from dynsr.data.sums import MeasuredSum
from dynsr.data.times import check_time_unit, count_times
from dynsr.errors import InputError, one_line
from dynsr.expression import check_name

# A trajectory of fewer rows tells too little of slopes and noise to find equations in.
FEWEST_ROWS = 8
# Characters of a wrong value that a message repeats.
_LONGEST_SHOWN = 60


def without_mask(values: Any) -> Any:
    """Give NaN, or NaT, where values of an array are masked: what is below a mask is no data.

    >>> without_mask(np.ma.masked_array([1.0, -99.0], mask=[False, True]))
    array([ 1., nan])

    Raises InputError where values that are no numbers, dates or durations are masked.
    """
    if not isinstance(values, np.ma.MaskedArray):
        return values
    count = int(np.sum(np.ma.getmaskarray(values)))
    if not count:
        return values.data
    if values.dtype.kind in "mM":
        return np.where(np.ma.getmaskarray(values), np.array("NaT", values.dtype), values.data)
    if values.dtype.kind not in "fiub":
        raise InputError(
            f"{count} of {values.size} values are masked; drop those rows, or fill them in"
        )
    return np.where(np.ma.getmaskarray(values), np.nan, values.data.astype(float))


def as_times(values: Any, what: str) -> tuple[np.ndarray, str]:
    """Give times as float64, and the unit in which dates and durations are counted.

    Parameters
    ----------
    values : an array, or what makes one.
    what : what a message calls them.

    Raises InputError where :func:`as_floats` does. Plain numbers have no unit.

    >>> as_times(np.array(["2024-01-01", "2024-01-02"], dtype="datetime64[D]"), "t")
    (array([0., 1.]), 'days')
    """
    values = without_mask(values)
    try:
        array = np.asarray(values)
        array = _as_one_kind(array) if array.dtype.kind == "O" else array
    except (TypeError, ValueError):
        return as_floats(values, what), ""
    if array.dtype.kind in "mM" and array.ndim == 1 and array.size:
        return count_times(array)
    return as_floats(array, what), ""


def as_floats(values: Any, what: str) -> np.ndarray:
    """Give values as float64 without a loss: durations as seconds.

    Parameters
    ----------
    values : an array, or what makes one.
    what : what a message calls them.

    Masked values are NaN. Raises InputError when values are complex, integers that float64 does not
    hold, or no numbers.

    >>> as_floats(np.array([0, 1500], dtype="timedelta64[ms]"), "t").tolist()
    [0.0, 1.5]
    """
    try:
        array = np.asarray(without_mask(values))
        if array.dtype.kind == "O":
            array = _as_one_kind(array)
        if array.dtype.kind == "c":
            raise InputError(f"{what} holds complex numbers; give real and imaginary parts apart")
        if array.dtype.kind == "M":
            raise InputError(f"{what} holds dates; only the time may be a date")
        if array.dtype.kind == "m":
            return np.asarray(array / np.timedelta64(1, "s"), dtype=float)
        found = np.asarray(array, dtype=float)
    except InputError:
        raise
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{what} has values that are no numbers; give numbers") from None
    if array.dtype.kind in "iu" and np.any(np.abs(found) > 2**53):
        if any(int(a) != int(b) for a, b in zip(array.flat, found.flat, strict=True)):
            raise InputError(
                f"{what} holds whole numbers of more than 16 digits, which float64 would round; "
                "subtract the first one"
            )
    return found


def _as_one_kind(array: np.ndarray) -> np.ndarray:
    """Give objects that are all durations, dates or complex numbers as an array of that kind."""
    cells = list(array.flat)
    if cells and all(isinstance(cell, (timedelta, np.timedelta64)) for cell in cells):
        return np.array(cells, dtype="timedelta64[ns]").reshape(array.shape)
    if cells and all(isinstance(cell, datetime) and cell.tzinfo is None for cell in cells):
        return np.array(cells, dtype="datetime64[us]").reshape(array.shape)
    if any(isinstance(cell, complex) for cell in cells):
        return array.astype(complex)
    return array


@checked
@dataclass(frozen=True, eq=False)
class Trajectory:
    """States (and inputs) of one run of a system.

    Parameters
    ----------
    t : (n,) times, strictly increasing; dates and durations are counted in a unit of the size of
        their steps, which :attr:`time_unit` then says.
    x : (n, k) states in the system's own units; NaN where a state was not measured.
    states : the k names of the columns of ``x``.
    inputs : (n, m) known inputs at the same times; empty by default.
    input_names : the m names of the columns of ``inputs``.
    origin : where it came from: engine, version, tolerances, unit of the times.
    hold : input -> what it does between rows: "previous" (keeps its value until the next row),
        "linear" or "smooth"; for inputs that are not named its values show it; see :attr:`holds`.
    noise : state -> its measurement errors, where they are known; see
        :class:`dynsr.data.KnownNoise`. Those of other columns go.
    sums : state that nobody measured alone -> the sum in which it was measured; see
        :class:`dynsr.data.MeasuredSum`. Those of other columns go.
    limits : state -> the rows in which it was only seen to be below or above a limit; see
        :class:`dynsr.data.Limits`. Those of measured cells and of other columns go.
    unmeasured : (n, k) cells that were not measured, whatever ``x`` holds there; by default those
        that are NaN. Empty where every cell was measured.

    Raises InputError, naming the row, when times do not increase, a value is infinite, or an input
    has none.

    >>> Trajectory([0.0, 0.5], [[1.0], [2.0]], ("x",)).x.shape
    (2, 1)
    """

    t: np.ndarray
    x: np.ndarray
    states: tuple[str, ...]
    inputs: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    input_names: tuple[str, ...] = ()
    origin: Mapping[str, Any] = field(default_factory=dict)
    hold: Mapping[str, Hold] = field(default_factory=dict)
    unmeasured: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=bool))
    noise: Mapping[str, KnownNoise] = field(default_factory=dict)
    sums: Mapping[str, MeasuredSum] = field(default_factory=dict)
    limits: Mapping[str, Limits] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Bring the fields to float64 and check them."""
        t, unit = as_times(self.t, "t")
        x = as_floats(self.x, "x")
        u = as_floats(self.inputs, "inputs")
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
        clash = sorted(n for n, often in Counter(names).items() if often > 1 or n == "t")
        if clash:
            raise InputError(f"column name {clash[0]!r} is used twice (t is the time); rename one")
        _check_times(t)
        gaps = _find_gaps(x, self.unmeasured)
        _check_finite(np.column_stack([np.where(gaps, 0.0, x) if gaps.size else x, u]), names)
        object.__setattr__(self, "unmeasured", gaps)
        known = {state: own for state, own in self.noise.items() if state in states}
        for state, own in known.items():
            if own.sd.shape != t.shape:
                raise InputError(f"noise {own.sd.shape} of {state!r} does not fit t {t.shape}")
        object.__setattr__(self, "noise", known)
        sums = {s: own for s, own in self.sums.items() if {s, *own.others} <= set(states)}
        object.__setattr__(self, "sums", sums)
        object.__setattr__(self, "limits", _find_limits(self.limits, states, gaps, len(t)))
        for key, value in (("t", t), ("x", x), ("inputs", u), ("states", states)):
            object.__setattr__(self, key, value)
        object.__setattr__(self, "input_names", input_names)
        object.__setattr__(self, "hold", check_hold(self.hold, input_names))
        if unit:
            object.__setattr__(self, "origin", {**self.origin, "time_unit": unit})

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.t)

    @property
    def time_unit(self) -> str:
        """The unit of the times: "s", "min", "h", "days", "years" or such; "" where unknown."""
        return check_time_unit(self.origin.get("time_unit", ""))

    @property
    def names(self) -> tuple[str, ...]:
        """States, then inputs."""
        return (*self.states, *self.input_names)

    @property
    def measured(self) -> np.ndarray:
        """(n, k) whether a state was measured at a row."""
        return ~self.unmeasured if self.unmeasured.size else np.ones(self.x.shape, dtype=bool)

    @property
    def observed(self) -> np.ndarray:
        """(n, k) the states as they were measured; NaN where they were not."""
        return np.where(self.unmeasured, np.nan, self.x) if self.unmeasured.size else self.x

    def as_measured(self) -> Trajectory:
        """Give the same run with NaN where a state was not measured, whatever was there."""
        return replace(self, x=self.observed) if self.unmeasured.size else self

    def without_measurements(self, states: Sequence[str]) -> Trajectory:
        """Give the same run with some states that count as never measured; their curves stay.

        Parameters
        ----------
        states : which; columns that were made from others.
        """
        if not states:
            return self
        gaps = ~self.measured
        gaps[:, [self.index(state) for state in states]] = True
        return replace(self, unmeasured=gaps)

    def of_states(self, states: Sequence[str]) -> Trajectory:
        """Give the same run with some of its states alone.

        Parameters
        ----------
        states : which, in this order.
        """
        places = [self.index(state) for state in states]
        gaps = self.unmeasured[:, places] if self.unmeasured.size else self.unmeasured
        return replace(self, x=self.x[:, places], states=tuple(states), unmeasured=gaps)

    def with_inputs(self, values: Mapping[str, float]) -> Trajectory:
        """Give the same run with more inputs, which are constant along it.

        Parameters
        ----------
        values : input -> its value.

        >>> run = Trajectory([0.0, 1.0], [[1.0], [2.0]], ("x",)).with_inputs({"k1": 0.5})
        >>> run.inputs[:, 0].tolist(), run.input_names
        ([0.5, 0.5], ('k1',))
        """
        constant = np.tile(list(values.values()), (len(self), 1))
        inputs = np.column_stack([self.inputs, constant])
        return replace(self, inputs=inputs, input_names=(*self.input_names, *values))

    def with_states(self, values: Mapping[str, float]) -> Trajectory:
        """Give the same run with more states, which are constant along it.

        Parameters
        ----------
        values : state -> its value.

        >>> run = Trajectory([0.0, 1.0], [[1.0], [2.0]], ("x",)).with_states({"y": 0.0})
        >>> run.x.tolist(), run.states
        ([[1.0, 0.0], [2.0, 0.0]], ('x', 'y'))
        """
        constant = np.tile(list(values.values()), (len(self), 1))
        x = np.column_stack([self.observed, constant])
        return replace(
            self, x=x, states=(*self.states, *values), unmeasured=np.empty((0, 0), dtype=bool)
        )

    def own_rows(self, state: str) -> np.ndarray:
        """Give the rows at which a state was measured.

        Parameters
        ----------
        state : the state.

        >>> Trajectory([0.0, 1.0], [[1.0], [np.nan]], ("x",)).own_rows("x").tolist()
        [0]
        """
        return np.flatnonzero(self.measured[:, self.index(state)])

    told_rows = Renamed("known_rows")

    def known_rows(self, state: str) -> np.ndarray:
        """Give the rows at which a state was measured and all others are known from their curves.

        Before its first and after its last row nothing is known of a state.

        Parameters
        ----------
        state : the state.

        >>> x = [[1.0, np.nan], [1.0, 2.0], [np.nan, 3.0], [1.0, 4.0]]
        >>> Trajectory(np.arange(4.0), x, ("x", "y")).known_rows("x").tolist()
        [1, 3]
        """
        begun = np.maximum.accumulate(self.measured, axis=0)
        ended = np.maximum.accumulate(self.measured[::-1], axis=0)[::-1]
        inside = np.flatnonzero(np.all(begun & ended, axis=1))
        return np.intersect1d(self.own_rows(state), inside)

    @property
    def columns(self) -> np.ndarray:
        """(n, k + m) states, then inputs."""
        return np.column_stack([self.x, self.inputs])

    @property
    def by_name(self) -> dict[str, np.ndarray]:
        """Name -> (n,) values of every column, and the times as t."""
        return {**dict(zip(self.names, self.columns.T, strict=True)), "t": self.t}

    @cached_property
    def holds(self) -> dict[str, Hold]:
        """Every input with what it does between rows, as given or as its values show it."""
        columns = zip(self.input_names, self.inputs.T, strict=True)
        return {name: self.hold.get(name) or choose_hold(self.t, own) for name, own in columns}

    def held(self, name: str) -> Hold:
        """Give what a column does between rows where it drives others.

        Parameters
        ----------
        name : an input, see :attr:`holds`; or a state, which is smooth unless it steps.
        """
        if name in self.input_names:
            return self.holds[name]
        return "previous" if holds_its_value(self.x[:, self.index(name)]) else "smooth"

    def index(self, state: str) -> int:
        """Position of a state; raises InputError that lists the states when there is none."""
        if state not in self.states:
            raise InputError(f"unknown state {state!r}; the states are: {', '.join(self.states)}")
        return self.states.index(state)

    def every(self, stride: int) -> np.ndarray:
        """Give the rows left where one in ``stride`` is kept, and each at which an input steps.

        Between the rows that are kept a held input then has one value. Of a state that was not
        measured at every row, one in so many of its own rows is kept that as many are left of it,
        or all where it has no more.
        """
        if stride == 1 or not self.unmeasured.size:
            return np.union1d(self._one_in(stride), self._steps)
        wanted = -(-len(self) // stride)
        own = [self.own_rows(state) for state in self.states]
        own += [np.flatnonzero(limits.there) for limits in self.limits.values()]
        kept = [rows[:: max(1, len(rows) // wanted)] for rows in own]
        return np.unique(np.concatenate([*kept, self._steps]))

    def _one_in(self, stride: int) -> np.ndarray:
        return np.arange(0, len(self), stride)

    @property
    def _steps(self) -> np.ndarray:
        """Rows at which a held input steps."""
        held = [i for i, name in enumerate(self.input_names) if self.holds[name] == "previous"]
        changed = np.any(np.diff(self.inputs[:, held], axis=0) != 0, axis=1)
        return np.flatnonzero(changed) + 1

    def thin(self, stride: int, stretches: int = 4) -> list[np.ndarray]:
        """Give the rows that stand for the run where about one in ``stride`` is wanted.

        Parameters
        ----------
        stride : one over the share of the rows.
        stretches : where a held input steps so often that :meth:`every` leaves twice as many, so
            many stretches of all their rows are given instead, evenly spaced over the run.
        """
        wanted = len(self) // stride
        many = len(np.union1d(self._one_in(stride), self._steps)) > 2 * wanted
        if not many or wanted < 2 * stretches:
            return [self.every(stride)]
        length = wanted // stretches
        starts = np.linspace(0, len(self) - length, stretches).astype(int)
        return [start + np.arange(length) for start in starts]

    def select(self, rows: slice | np.ndarray) -> Trajectory:
        """Give the trajectory of some rows.

        Parameters
        ----------
        rows : a slice, (m,) whole numbers or (n,) booleans, one for each row.

        Raises InputError when they are no rows, or times do not increase in that order.
        """
        check_rows(rows, len(self))
        gaps = self.unmeasured[rows] if self.unmeasured.size else self.unmeasured
        noise = {state: own.select(rows) for state, own in self.noise.items()}
        sums = {state: own.select(rows) for state, own in self.sums.items()}
        limits = {state: own.select(rows) for state, own in self.limits.items()}
        return replace(
            self,
            t=self.t[rows],
            x=self.x[rows],
            inputs=self.inputs[rows],
            unmeasured=gaps,
            noise=noise,
            sums=sums,
            limits=limits,
        )


def check_rows(rows: Any, count: int) -> None:
    """Raise InputError unless rows can be taken of so many.

    Parameters
    ----------
    rows : a slice, whole numbers or booleans.
    count : how many rows there are.

    >>> check_rows(np.array([0.5]), 3)
    Traceback (most recent call last):
    ...
    dynsr.errors.InputError: array([0.5]) cannot be taken of 3 rows; give a slice or whole numbers
    """
    try:
        # An array without a size of its own: a record may be long, and its blocks many.
        fits = np.broadcast_to(0, (count,))[rows].ndim == 1
    except (IndexError, TypeError, ValueError):
        fits = False
    if not fits:
        shown = one_line(repr(rows))
        shown = shown if len(shown) <= _LONGEST_SHOWN else f"{shown[: _LONGEST_SHOWN - 3]}..."
        raise InputError(f"{shown} cannot be taken of {count} rows; give a slice or whole numbers")


def decide_hold(
    runs: Sequence[Trajectory], hold: Mapping[str, str] | str | None = None
) -> list[Trajectory]:
    """Give the runs with one way for each input, so that all of a call read it alike.

    Parameters
    ----------
    runs : trajectories of the same columns.
    hold : input -> "previous", "linear" or "smooth", or one word for all; for the others the runs
        say it, or their values together.

    Raises InputError when an input or a way is unknown.

    >>> t = np.arange(6.0)
    >>> steps = Trajectory(t, t[:, None], ("x",), np.array([[0.0, 0, 0, 1, 1, 1]]).T, ("u",))
    >>> decide_hold([steps])[0].hold, decide_hold([steps], "linear")[0].hold
    ({'u': 'previous'}, {'u': 'linear'})
    """
    names = runs[0].input_names
    asked = check_hold(hold, names)
    for place, name in enumerate(names):
        given = [run.hold[name] for run in runs if name in run.hold]
        if name not in asked and given:
            asked[name] = given[0]
        if name not in asked:
            asked[name] = choose_hold_together([(run.t, run.inputs[:, place]) for run in runs])
    return [replace(run, hold=asked) for run in runs]


def columns_of(runs: Sequence[Trajectory]) -> dict[str, np.ndarray]:
    """Name -> (n,) values of every column of all runs, one below the other, and the times as t.

    Parameters
    ----------
    runs : trajectories of the same columns.

    >>> runs = [Trajectory(np.arange(2.0), np.ones((2, 1)), ("x",))] * 2
    >>> columns_of(runs)["t"]
    array([0., 1., 0., 1.])
    """
    named = [run.by_name for run in runs]
    return {name: np.concatenate([own[name] for own in named]) for name in named[0]}


def _find_gaps(x: np.ndarray, unmeasured: Any) -> np.ndarray:
    """(n, k) cells that were not measured; empty where all were."""
    gaps = np.asarray(np.isnan(x))
    given = np.asarray(unmeasured, dtype=bool)
    if given.size:
        if given.shape != x.shape:
            raise InputError(f"unmeasured {given.shape} does not fit x {x.shape}")
        gaps |= given
    return gaps if np.any(gaps) else np.empty((0, 0), dtype=bool)


def _find_limits(
    given: Mapping[str, Limits], states: Sequence[str], gaps: np.ndarray, rows: int
) -> dict[str, Limits]:
    """Give the limits of cells that were not measured, of the states that have any."""
    found = {}
    for state, own in given.items():
        if state not in states or not gaps.size:
            continue
        if not own.below.shape == own.above.shape == (rows,):
            raise InputError(f"limits {own.below.shape} of {state!r} do not fit {rows} rows")
        left = own.where(gaps[:, list(states).index(state)])
        if left.there.any():
            found[state] = left
    return found


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
