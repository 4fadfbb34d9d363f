"""Prediction: the states that found equations give from a start, with known or measured inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import sympy

from dynsr.data import Hold, System, Trajectory, check_hold, choose_hold, sample_input
from dynsr.engines import (
    DEFAULT_ENGINE,
    DRIVEN,
    EXPLICIT,
    AbstractEngine,
    Drive,
    InitialValueProblem,
    find_engine,
    is_embedded,
    rows_of,
    simulate,
    simulate_driven,
)
from dynsr.errors import InputError
from dynsr.expression import arguments_of, as_float_tree, parse, write_out
from dynsr.methods import AbstractMethod

RELTOL, ABSTOL = 1e-8, 1e-10
# States below this are integrated with an absolute tolerance of their own size.
_TINY = 1e-6
# Times outside the rows by this share of their span are rounded ones.
SLACK = 1e-9
# A function of the time is evaluated at so many times at least, and so often between two.
_SAMPLES, _FEWEST_PARTS = 2000, 4
# What integrates where inputs, or states without an equation, are read from measurements.
MEASURED = f"embedded ({EXPLICIT} {DRIVEN})"
# What does what for a map.
_OF_MAP = {
    "fit": "none (least squares on one step)",
    "forecast": "none (iteration)",
    "simulate": "none (iteration)",
    "bands": "none",
}


def predict(
    equations: Mapping[str, sympy.Expr],
    x0: Sequence[float] | np.ndarray,
    t: Sequence[float] | np.ndarray,
    inputs: Mapping[str, Any] | None = None,
    engine: str | AbstractEngine = DEFAULT_ENGINE,
    hold: Mapping[str, str] | str | None = None,
    size: float | None = None,
) -> Trajectory:
    """Integrate equations from ``x0`` at ``t[0]`` and give the states at every ``t``.

    Parameters
    ----------
    equations : state -> right-hand side in the states, the inputs and ``t``; state units a second.
    x0 : (k,) start states in the order of the equations.
    t : (n,) increasing times in seconds.
    inputs : name -> expression in ``t``, function of one time, (n,) values at the times, or
        :class:`Measured` values at times of their own. No step passes over a value, and where an
        input jumps the integration begins again.
        An engine that takes no measured inputs gives way to the embedded one; the origin of the
        trajectory says which integrated.
    engine : "embedded", "julia" or an engine.
    hold : input -> what it does between its values, "previous", "linear" or "smooth", or one word
        for all; by default what the values show.
    size : usual size of the states, of which the absolute error is a share; by default that of the
        start.

    Every integration is adaptive, with a relative error of 1e-8 a step, and implicit where the
    explicit method needs too many steps. Raises InputError when a state or input is missing, a time
    lies beyond the measured values or the engine is unknown, EngineUnavailable when it is absent,
    and EngineError, with time and state, where the solution ends before the last time.

    >>> decay = {"x": -2 * sympy.Symbol("x")}
    >>> bool(np.isclose(predict(decay, [1.0], [0.0, 1.0]).x[-1, 0], np.exp(-2)))
    True
    """
    chosen, times = find_engine(engine), np.asarray(t, dtype=float)
    given = dict(inputs or {})
    if chosen.name != DEFAULT_ENGINE:
        # Other engines know the functions of the operator table alone.
        equations = {state: write_out(expr) for state, expr in equations.items()}
    used = {str(s) for e in equations.values() for s in e.free_symbols} - {"t"}
    missing = sorted(used - set(equations) - set(given))
    if missing:
        raise InputError(
            f"nothing says what {missing[0]!r} does in time; give it as an input "
            "or discover its equation too"
        )
    measured = _take_measured(given, times, hold)
    exact = {k: parse(v, ["t"]) for k, v in given.items() if k not in measured}
    start = np.asarray(x0, dtype=float)
    if start.shape != (len(equations),):
        raise InputError(f"x0 must be {len(equations)} numbers, one per state; it is {x0!r}")
    abstol = ABSTOL * (size or _size(start))
    if measured:
        return _follow_measured(equations, start, times, exact, measured, abstol, chosen)
    system = System(
        "found",
        tuple(equations),
        tuple(map(as_float_tree, equations.values())),
        tuple(start),
        exact,
    )
    return simulate(system, start, times, RELTOL, abstol, chosen)


def predict_with_doses(
    equations: Mapping[str, sympy.Expr],
    x0: Sequence[float] | np.ndarray,
    t: Sequence[float] | np.ndarray,
    doses: Mapping[str, Any] | None,
    inputs: Mapping[str, Any] | None = None,
    engine: str | AbstractEngine = DEFAULT_ENGINE,
    hold: Mapping[str, str] | str | None = None,
) -> Trajectory:
    """Integrate as :func:`predict` does; states jump where amounts are given to them.

    Parameters
    ----------
    doses : state -> (n,) amounts that are added right after each time; None for none.
    equations, x0, t, inputs, engine, hold : as for :func:`predict`.

    Raises InputError too when a state is unknown or the amounts do not fit the times.

    >>> decay = {"x": -2 * sympy.Symbol("x")}
    >>> found = predict_with_doses(decay, [0.0], [0.0, 1.0, 2.0], {"x": [1.0, 0.0, 0.0]})
    >>> bool(np.allclose(found.x[:, 0], [0.0, np.exp(-2), np.exp(-4)]))
    True
    """
    times = np.asarray(t, dtype=float)
    if not doses:
        return predict(equations, x0, times, inputs, engine, hold)
    given = np.zeros((len(times), len(equations)))
    for state, amounts in doses.items():
        if state not in equations:
            raise InputError(
                f"doses are given to a state, and {state!r} is no state; the states are: "
                f"{', '.join(equations)}"
            )
        given[:, list(equations).index(state)] = sample_input(f"doses of {state}", amounts, times)
    # Values at the times are read once, over all of them.
    read = {**(inputs or {}), **_take_measured(dict(inputs or {}), times, hold)}
    at = np.flatnonzero(given[:-1].any(axis=1)).tolist()
    edges = sorted({0, *at, len(times) - 1})
    start, parts = np.asarray(x0, dtype=float), []
    for begin, end in pairwise(edges):
        part = predict(equations, start + given[begin], times[begin : end + 1], read, engine)
        start = part.x[-1]
        parts.append(part)
    x = np.concatenate([np.asarray(x0, dtype=float)[None], *(part.x[1:] for part in parts)])
    rows = [part.inputs[int(i > 0) :] for i, part in enumerate(parts)]
    return replace(parts[0], t=times, x=x, inputs=np.concatenate(rows))


@dataclass(frozen=True, eq=False)
class Measured:
    """An input that was measured: (m,) ``values`` at times ``t``.

    ``hold`` says what it does between them: "previous", "linear" or "smooth"; by default its
    values show it. ``past`` is what it was before the first of them, where that is known. Raises
    InputError when the values do not fit the times or are not finite.
    """

    name: str
    t: np.ndarray
    values: np.ndarray
    hold: Hold | None = None
    past: Measured | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if self.values.shape != self.t.shape:
            raise InputError(
                f"input {self.name!r} has shape {self.values.shape} but there are {len(self.t)} "
                "times; give one value a time"
            )
        bad = np.flatnonzero(~np.isfinite(self.values))
        if bad.size:
            raise InputError(
                f"input {self.name!r} is {self.values[bad[0]]} at t = {self.t[bad[0]]:g}; fill it"
            )

    @cached_property
    def drive(self) -> Drive:
        """The input as pieces, which engines take."""
        hold = self.hold or choose_hold(self.t, self.values)
        own = Drive.through(self.name, self.t, self.values, hold)
        return own if self.past is None else self.past.drive.then(own)

    @property
    def first(self) -> float:
        """The first time at which it is known without a gap after it."""
        own = float(self.t[0])
        if self.past is None or self.past.t[-1] < own - self._slack:
            return own
        return min(own, self.past.first)

    @property
    def _slack(self) -> float:
        return SLACK * float(np.ptp(self.t))

    def is_known_from(self, time: float) -> bool:
        """Whether it is known from some time on.

        Parameters
        ----------
        time : the time.
        """
        return self.first <= time + self._slack

    def later(self, name: str, delay: float) -> Measured:
        """Give the input as it was some time before.

        Parameters
        ----------
        name : of the delayed input.
        delay : how long before.
        """
        past = self.past and self.past.later(name, delay)
        return replace(self, name=name, t=self.t + delay, past=past)

    def aligned(self, times: np.ndarray) -> Measured:
        """Give the input with times that are some others where rounding alone sets them apart.

        Parameters
        ----------
        times : (n,) the others, increasing.
        """
        after = np.clip(np.searchsorted(times, self.t), 1, len(times) - 1)
        before = times[after - 1]
        near = np.where(self.t - before < times[after] - self.t, before, times[after])
        t = np.where(np.abs(near - self.t) <= self._slack, near, self.t)
        return replace(self, t=t, past=self.past and self.past.aligned(times))

    def check_covers(self, times: np.ndarray) -> None:
        """Raise InputError when a time lies beyond the rows; nothing is known there."""
        first, last = self.first, float(self.t[-1])
        slack = self._slack
        beyond = times[(times < first - slack) | (times > last + slack)]
        if beyond.size:
            raise InputError(
                f"{self.name!r} was measured from t = {first:g} to {last:g}, and t = "
                f"{beyond[0]:g} lies beyond; stay inside or give it as an input"
            )


def is_sampled(value: Any) -> bool:
    """Whether an input is given by its values at the times.

    Parameters
    ----------
    value : of the input: else an expression, a function or :class:`Measured`.
    """
    return not (isinstance(value, (str, sympy.Basic, int, float, Measured)) or callable(value))


def _size(start: np.ndarray) -> float:
    """What the absolute tolerance is a share of: 1, unless all states are far smaller."""
    largest = float(np.max(np.abs(start)))
    return largest if 0 < largest < _TINY else 1.0


def _take_measured(
    given: Mapping[str, Any], times: np.ndarray, hold: Mapping[str, str] | str | None
) -> dict[str, Measured]:
    measured = {}
    for name, value in given.items():
        if isinstance(value, Measured):
            measured[name] = value
        elif callable(value) and not isinstance(value, sympy.Basic):
            measured[name] = _sample(name, value, times)
        elif is_sampled(value):
            measured[name] = Measured(name, times, sample_input(name, value, times))
        else:
            continue
        measured[name].check_covers(times)
    asked = check_hold(hold, [*measured])
    return {name: replace(one, hold=asked.get(name, one.hold)) for name, one in measured.items()}


def _sample(name: str, value: Callable[..., Any], times: np.ndarray) -> Measured:
    """Read a function of the time off at the times and between them."""
    parts = max(_FEWEST_PARTS, -(-_SAMPLES // len(times)))
    inner = np.arange(parts) / parts
    fine = (times[:-1, None] + inner * np.diff(times)[:, None]).ravel()
    fine = np.append(fine, times[-1])
    return Measured(name, fine, sample_input(name, value, fine))


def _follow_measured(
    equations: Mapping[str, sympy.Expr],
    start: np.ndarray,
    times: np.ndarray,
    exact: Mapping[str, sympy.Expr],
    measured: Mapping[str, Measured],
    abstol: float,
    engine: AbstractEngine,
) -> Trajectory:
    """Integrate with the measured inputs; no step passes over a row of theirs."""
    measured = {name: one.aligned(times) for name, one in measured.items()}
    replaced = {sympy.Symbol(k): v for k, v in exact.items()}
    rhs = [as_float_tree(e.xreplace(replaced)) for e in equations.values()]
    rows = np.concatenate([times, *(one.t for one in measured.values())])
    rows = np.concatenate([rows, rows_of(rhs, (times[0], times[-1]))]) if exact else rows
    inside = rows[(rows >= times[0]) & (rows <= times[-1])]
    found, how = simulate_driven(
        InitialValueProblem(
            tuple(rhs),
            tuple(equations),
            start,
            times,
            RELTOL,
            abstol,
            drives=tuple(one.drive for one in measured.values()),
            stops=inside,
        ),
        engine,
    )
    values = np.column_stack([one.drive.at(times) for one in measured.values()])
    held = {name: one.hold for name, one in measured.items() if one.hold}
    return Trajectory(
        times, found, tuple(equations), values, tuple(measured), {"engine": how}, held
    )


def name_engines(
    methods: Iterable[AbstractMethod],
    engine: AbstractEngine,
    equations: Mapping[str, sympy.Expr],
    drives: Mapping[str, sympy.Expr],
    along: bool = False,
    looked: bool = False,
    discrete: bool = False,
) -> dict[str, str]:
    """Say which engine does what in a discovery, for its record.

    Parameters
    ----------
    methods : those that search, each with the engine that it uses, if any.
    engine : the one that was asked for.
    equations : state -> right-hand side.
    drives : inputs that are known as expressions in ``t``; others are read from measurements.
    along : whether sums of terms were looked for along noisy states.
    looked : whether the slopes had a first look before the methods.
    discrete : whether the equations are a map.

    >>> name_engines([], find_engine("embedded"), {"x": sympy.Symbol("x")}, {})["simulate"]
    'embedded'
    """
    own = [method.engine for method in methods]
    regress = dict.fromkeys(find_engine(one).name for one in own if one is not None)
    takes = engine.takes_drives and not is_embedded(engine)
    driven = f"{engine.name} ({DRIVEN})" if takes else MEASURED
    where = ["on the states"] * along + ["on the slopes"] * (looked or None in own)
    return {
        **({"search": f"none (NumPy {' and '.join(where)})"} if where else {}),
        **({"regress": ", ".join(regress)} if regress else {}),
        "fit": "embedded (multiple shooting)",
        "forecast": "embedded (multiple shooting)",
        "simulate": driven if set(arguments_of(equations)) - set(drives) else engine.name,
        "bands": "embedded (a curve for each draw of the constants)",
        **(_OF_MAP if discrete else {}),
    }


def record_hold(
    run: Trajectory, drives: Mapping[str, sympy.Expr], discrete: bool, hold: Any
) -> dict[str, dict[str, str]]:
    """Give what measured inputs do between rows, for the record; a map has nothing there.

    Parameters
    ----------
    run : one of the data.
    drives : inputs that are known as expressions in ``t``.
    discrete : whether a map is sought.
    hold : what the user said of it.

    Raises InputError where that is said of a map.
    """
    if discrete and hold is not None:
        raise InputError("a map has no time between rows; leave hold out")
    held = {} if discrete else {n: way for n, way in run.holds.items() if n not in drives}
    return {"hold": dict(held)} if held else {}
