"""Prediction: the states that found equations give from a start, with known or measured inputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from scipy.interpolate import make_interp_spline

from dynsr.data import System, Trajectory
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, find_engine, simulate
from dynsr.errors import InputError
from dynsr.expression import as_float_tree, parse
from dynsr.fit import Flow, Windows
from dynsr.methods import AbstractMethod

_RELTOL, _ABSTOL = 1e-8, 1e-10
# What integrates where inputs, or states without an equation, are read from measurements.
MEASURED = "embedded (Runge-Kutta 4 on measured inputs)"


def predict(
    equations: Mapping[str, sympy.Expr],
    x0: Sequence[float] | np.ndarray,
    t: Sequence[float] | np.ndarray,
    inputs: Mapping[str, Any] | None = None,
    engine: str | AbstractEngine = DEFAULT_ENGINE,
) -> Trajectory:
    """Integrate equations from ``x0`` at ``t[0]`` and give the states at every ``t``.

    Parameters
    ----------
    equations : state -> right-hand side in the states, the inputs and ``t``; state units a second.
    x0 : (k,) start states in the order of the equations.
    t : (n,) increasing times in seconds.
    inputs : name -> expression in ``t``, or (n,) values at the times. With such values the embedded
        Runge-Kutta 4 integrates, whatever the engine, since no array of inputs crosses the seam;
        the origin of the trajectory says so.
    engine : "embedded", "julia" or an engine.

    Raises InputError when a state or input is missing or the engine is unknown, EngineUnavailable
    when it is absent, EngineError when the solution diverges.

    >>> decay = {"x": -2 * sympy.Symbol("x")}
    >>> bool(np.isclose(predict(decay, [1.0], [0.0, 1.0]).x[-1, 0], np.exp(-2)))
    True
    """
    chosen, times = find_engine(engine), np.asarray(t, dtype=float)
    given = dict(inputs or {})
    used = {str(s) for e in equations.values() for s in e.free_symbols} - {"t"}
    missing = sorted(used - set(equations) - set(given))
    if missing:
        raise InputError(
            f"nothing says what {missing[0]!r} does in time; give it as an input "
            "or discover its equation too"
        )
    measured = _take_measured(given, times)
    exact = {k: parse(v, ["t"]) for k, v in given.items() if k not in measured}
    start = np.asarray(x0, dtype=float)
    if start.shape != (len(equations),):
        raise InputError(f"x0 must be {len(equations)} numbers, one a state; it is {x0!r}")
    if measured:
        return _march(equations, start, times, exact, measured)
    system = System(
        "found",
        tuple(equations),
        tuple(map(as_float_tree, equations.values())),
        tuple(start),
        exact,
    )
    return simulate(system, start, times, _RELTOL, _ABSTOL, chosen)


def _take_measured(given: Mapping[str, Any], times: np.ndarray) -> dict[str, np.ndarray]:
    measured = {k: np.asarray(v, dtype=float) for k, v in given.items() if _is_array(v)}
    for name, values in measured.items():
        if values.shape != times.shape:
            raise InputError(
                f"input {name!r} has shape {values.shape} but there are {len(times)} times; "
                "give one value a time"
            )
    return measured


def _is_array(value: Any) -> bool:
    return not isinstance(value, (str, sympy.Basic, int, float))


def _march(
    equations: Mapping[str, sympy.Expr],
    start: np.ndarray,
    times: np.ndarray,
    exact: Mapping[str, sympy.Expr],
    measured: Mapping[str, np.ndarray],
) -> Trajectory:
    """Integrate on the times themselves, inputs interpolated, until halving changes nothing."""
    replaced = {sympy.Symbol(k): v for k, v in exact.items()}
    flow = Flow({s: e.xreplace(replaced) for s, e in equations.items()}, tuple(measured), ())
    values = np.column_stack(list(measured.values()))
    spline = make_interp_spline(times, values, k=min(3, len(times) - 1))
    lanes = np.zeros((len(times), len(equations), 1))
    windows = Windows(times[:, None], lanes, lambda at: np.vstack([spline(at).T, at]))
    found = flow.run(windows, start[:, None], np.zeros(0), 1)[:, :, 0]
    for substeps in (2, 4, 8, 16, 32):
        finer = flow.run(windows, start[:, None], np.zeros(0), substeps)[:, :, 0]
        moved = np.nanmax(np.abs(finer - found), initial=0.0)
        found = finer
        if moved < 1e-8 * (1 + np.nanmax(np.abs(found), initial=0.0)):
            break
    if not np.all(np.isfinite(found)):
        lost = times[np.flatnonzero(~np.isfinite(found).all(axis=1))[0]]
        raise InputError(f"the equations have no solution at t = {lost:g}; shorten the time span")
    origin = {"engine": MEASURED}
    return Trajectory(times, found, tuple(equations), values, tuple(measured), origin)


def name_engines(
    methods: Iterable[AbstractMethod], engine: AbstractEngine, measured: bool
) -> dict[str, str]:
    """Say which engine does what in a discovery, for its record.

    Parameters
    ----------
    methods : those that search, each with the engine that it uses, if any.
    engine : the one that was asked for.
    measured : whether the equations read inputs or other states from measurements.

    >>> name_engines([], find_engine("embedded"), False)["simulate"]
    'embedded'
    """
    own = [method.engine for method in methods]
    regress = dict.fromkeys(find_engine(one).name for one in own if one is not None)
    return {
        **({"search": "none (NumPy on the slopes)"} if None in own else {}),
        **({"regress": ", ".join(regress)} if regress else {}),
        "fit": "embedded (multiple shooting)",
        "forecast": "embedded (multiple shooting)",
        "simulate": MEASURED if measured else engine.name,
        "bands": "embedded (a curve for each draw of the constants)",
    }
