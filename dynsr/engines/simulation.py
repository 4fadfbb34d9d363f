"""Simulation: a system and an engine give a trajectory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynsr.data import System, Trajectory
from dynsr.engines.base import (
    DEFAULT_ABSTOL,
    DEFAULT_RELTOL,
    AbstractEngine,
    InitialValueProblem,
    Integration,
)
from dynsr.engines.registry import DEFAULT_ENGINE, find_engine
from dynsr.errors import EngineError, InputError
from dynsr.expression import compile_numpy


def simulate(
    system: System,
    x0: Sequence[float] | np.ndarray | None = None,
    t: Sequence[float] | np.ndarray | None = None,
    reltol: float = DEFAULT_RELTOL,
    abstol: float = DEFAULT_ABSTOL,
    engine: str | AbstractEngine = DEFAULT_ENGINE,
) -> Trajectory:
    """Integrate a system from ``x0`` at ``t[0]`` and give its states and inputs at every ``t``.

    Parameters
    ----------
    system : the system, its inputs as expressions in ``t``.
    x0 : (k,) start state; the system's own by default.
    t : (n,) increasing times in seconds; the system's training span by default.
    reltol, abstol : tolerances of Tsit5.
    engine : "embedded", "julia" or an engine.

    Raises InputError for a start or times that do not fit and for an unknown engine,
    EngineUnavailable for an absent one, EngineError for a divergence.

    >>> from dynsr.data.system import PENDULUM
    >>> simulate(PENDULUM).x.shape
    (1001, 2)
    """
    chosen = find_engine(engine)
    times = system.times(system.train) if t is None else np.asarray(t, dtype=float)
    start = np.asarray(system.x0 if x0 is None else x0, dtype=float)
    rhs = system.closed_rhs()
    problem = InitialValueProblem(rhs, system.states, start, times, reltol, abstol)
    integration = chosen.integrate(problem)
    if not integration.success:
        raise EngineError(_divergence(system, problem, integration))
    origin = {"system": system.name, "engine": chosen.name, "versions": chosen.versions()}
    return Trajectory(
        times,
        integration.x,
        system.states,
        _input_columns(system, times),
        tuple(system.inputs),
        origin={**origin, "reltol": reltol, "abstol": abstol},
    )


def training_trajectory(
    system: System, engine: str | AbstractEngine = DEFAULT_ENGINE, step: float | None = None
) -> Trajectory:
    """Give the training data of the paper, with the rows that forward differences need.

    The system is solved at default tolerances over its training span and one sampling step more,
    (0, 10.01), and saved every ``step`` seconds (the system's own by default): 1002 rows for the
    paper's systems, so that forward differences have the 1001 rows t = 0, 0.01, ..., 10.

    Parameters
    ----------
    system : the system.
    engine : "embedded", "julia" or an engine.
    step : seconds between rows.

    Raises as :func:`simulate` does.

    >>> from dynsr.data.system import LOTKA_VOLTERRA
    >>> len(training_trajectory(LOTKA_VOLTERRA))
    1002
    """
    start, end = system.train
    return simulate(system, t=system.times((start, end + system.step), step), engine=engine)


def add_noise(trajectory: Trajectory, relative: float, rng: np.random.Generator) -> Trajectory:
    """Add Gaussian noise with ``relative`` times each state's own standard deviation.

    Inputs stay exact.

    Parameters
    ----------
    trajectory : the states (n, k) without noise.
    relative : standard deviation of the noise as a share of each state's; 0.01 is 1 %.
    rng : the generator that the noise comes from.

    Raises InputError when ``relative`` is not a number from 0 up.

    >>> line = Trajectory([0.0, 1.0], [[0.0], [2.0]], ("x",))
    >>> add_noise(line, 0.0, np.random.default_rng(0)).x.tolist()
    [[0.0], [2.0]]
    """
    if not (np.isfinite(relative) and relative >= 0):
        raise InputError(f"noise {relative} must be a number from 0 up, such as 0.01 for 1 %")
    noise = rng.standard_normal(trajectory.x.shape) * (relative * trajectory.x.std(axis=0))
    return Trajectory(
        trajectory.t,
        trajectory.x + noise,
        trajectory.states,
        trajectory.inputs,
        trajectory.input_names,
        {**trajectory.origin, "noise": relative},
    )


def _input_columns(system: System, times: np.ndarray) -> np.ndarray:
    return compile_numpy(list(system.inputs.values()), ["t"])(times[None]).T


def _divergence(system: System, problem: InitialValueProblem, integration: Integration) -> str:
    lost = np.flatnonzero(~np.isfinite(integration.x).all(axis=1))
    time = problem.t[lost[0]] if lost.size else problem.t[-1]
    reason = f": {integration.message}" if integration.message else ""
    return f"{system.name} has no solution at t = {time:g}{reason}; shorten the time span"
