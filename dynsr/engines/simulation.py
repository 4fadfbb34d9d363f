"""Simulation: a system and an engine give a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import System, Trajectory
from dynsr.engines.adaptive import Motion, describe_end, follow, rows_of
from dynsr.engines.base import (
    DEFAULT_ABSTOL,
    DEFAULT_RELTOL,
    FINE_ABSTOL,
    FINE_RELTOL,
    AbstractEngine,
    InitialValueProblem,
    Integration,
)
from dynsr.engines.registry import DEFAULT_ENGINE, find_engine, is_embedded
from dynsr.engines.tsit5.tableau import Slopes
from dynsr.errors import EngineError, InputError
from dynsr.expression import compile_numpy, compile_scalar

# Integrations that are this many tolerances apart saw different inputs.
_NEAR = 100.0
# What an origin says of an integration with inputs that were measured.
DRIVEN = "on measured inputs"


@checked
def simulate(
    system: System,
    x0: Sequence[float] | np.ndarray | None = None,
    t: Sequence[float] | np.ndarray | None = None,
    reltol: float = FINE_RELTOL,
    abstol: float = FINE_ABSTOL,
    engine: str | AbstractEngine = DEFAULT_ENGINE,
) -> Trajectory:
    """Integrate a system from ``x0`` at ``t[0]`` and give its states and inputs at every ``t``.

    Parameters
    ----------
    system : the system, its inputs as expressions in ``t``.
    x0 : (k,) start state; the system's own by default.
    t : (n,) increasing times in seconds; the system's training span by default.
    reltol, abstol : tolerances of Tsit5; data for a discovery should have no error of a solver.
        The paper's data have DifferentialEquations.jl's 1e-3 and 1e-6, see
        :func:`training_trajectory`.
    engine : "embedded", "julia" or an engine.

    Where the engine runs out of steps the system is stiff, and Radau goes on; where it stepped
    over something that moves in time alone, such as a narrow pulse from rest, the integration is
    done again with steps that do not. ``origin["engine"]`` says so.

    Raises InputError for a start or times that do not fit and for an unknown engine,
    EngineUnavailable for an absent one, and EngineError, with time and state, where the solution
    ends before the last time.

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
    motion = Motion(system.name, system.states, _slopes(problem), _rows(problem))
    if integration.success:
        x, also = _see_pulses(motion, problem, integration.x)
    else:
        x, also = _go_on(motion, problem, integration)
    name = f"{chosen.name} ({also})" if also else chosen.name
    origin = {"system": system.name, "engine": name, "versions": chosen.versions()}
    return Trajectory(
        times,
        x,
        system.states,
        _input_columns(system, times),
        tuple(system.inputs),
        origin={**origin, "reltol": reltol, "abstol": abstol},
    )


def simulate_driven(
    problem: InitialValueProblem, engine: str | AbstractEngine = DEFAULT_ENGINE
) -> tuple[np.ndarray, str]:
    """Integrate a problem with measured inputs; gives the states (n, k) and what integrated.

    Parameters
    ----------
    problem : the problem with its drives; its limit of steps holds for another engine than the
        embedded one, where Radau goes on after it.
    engine : "embedded", "julia" or an engine; the embedded one replaces one that takes no
        measured inputs, and is named.

    Raises as :func:`simulate` does.

    >>> from dynsr.engines import Drive
    >>> ramp = Drive("u", np.array([0.0]), np.array([[1.0], [0.0]]))
    >>> t = np.array([0.0, 1.0])
    >>> problem = InitialValueProblem((sympy.Symbol("u"),), ("x",), [0.0], t, drives=(ramp,))
    >>> x, how = simulate_driven(problem)
    >>> round(float(x[-1, 0]), 6), how
    (0.5, 'embedded (Tsit5 on measured inputs)')
    """
    chosen, motion = find_engine(engine), Motion.of("the system", problem)
    if is_embedded(chosen) or not chosen.takes_drives:
        x, how = follow(motion, problem.x0, problem.t, problem.reltol, problem.abstol)
        return x, f"embedded ({how} {DRIVEN})"
    integration = chosen.integrate(problem)
    if integration.success:
        return integration.x, f"{chosen.name} ({DRIVEN})"
    x, also = _go_on(motion, problem, integration)
    return x, f"{chosen.name} ({DRIVEN}, {also})"


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
    times = system.times((start, end + system.step), step)
    return simulate(system, None, times, DEFAULT_RELTOL, DEFAULT_ABSTOL, engine)


@checked
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
    origin = {**trajectory.origin, "noise": relative}
    return replace(trajectory, x=trajectory.x + noise, origin=origin)


def _input_columns(system: System, times: np.ndarray) -> np.ndarray:
    return compile_numpy(list(system.inputs.values()), ["t"])(times[None]).T


def _slopes(problem: InitialValueProblem) -> Slopes:
    return compile_scalar(problem.rhs, [*problem.states, "t"])


def _rows(problem: InitialValueProblem) -> np.ndarray:
    """Times that no step may pass over; none where nothing depends on the time."""
    if not any(sympy.Symbol("t") in expr.free_symbols for expr in problem.rhs):
        return np.empty(0)
    return rows_of(problem.rhs, (float(problem.t[0]), float(problem.t[-1])))


def _see_pulses(
    motion: Motion, problem: InitialValueProblem, x: np.ndarray
) -> tuple[np.ndarray, str]:
    """Give the states as they are, unless steps that pass over no row lead far away from them."""
    if not len(motion.rows):
        return x, ""
    seen, how = follow(motion, problem.x0, problem.t, problem.reltol, problem.abstol)
    near = _NEAR * (problem.abstol + problem.reltol * np.max(np.abs(seen), axis=0))
    if np.all(np.abs(seen - x) <= near):
        return x, ""
    return seen, f"again by {how}, with shorter steps"


def _go_on(
    motion: Motion, problem: InitialValueProblem, integration: Integration
) -> tuple[np.ndarray, str]:
    """Integrate by the implicit method from the last row that was reached."""
    rows = int(np.argmin(np.isfinite(integration.x).all(axis=1)))
    at, tries = max(rows - 1, 0), integration.accepted + integration.rejected
    start = integration.x[at] if rows else problem.x0
    if tries < problem.max_steps:
        lost, last = problem.t[rows], problem.t[at]
        raise EngineError(describe_end(motion, lost, last, start, integration.message))
    x = integration.x.copy()
    x[at:], how = follow(motion, start, problem.t[at:], problem.reltol, problem.abstol, 0)
    return x, f"{how} from t = {problem.t[at]:g}"
