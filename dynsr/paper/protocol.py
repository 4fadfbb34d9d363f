"""The paper's SINDy settings as data (section A.3), and how the data of its rows were made."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np

from dynsr.data import Samples, System, Trajectory
from dynsr.engines import (
    AbstractEngine,
    InitialValueProblem,
    Optimizer,
    find_engine,
    interpolate,
    replay_steps,
    simulate,
)
from dynsr.errors import InputError
from dynsr.expression import compile_numpy

BASES: dict[str, tuple[str, ...]] = {
    "pendulum": (
        "theta1",
        "theta2",
        "sin(theta1)",
        "cos(theta2)",
        "cos(theta1)",
        "sin(theta2)",
        "cos(theta1)*sin(theta2)",
        "1",
    ),
    "lotka-volterra": (
        "x",
        "y",
        "x*y",
        "sin(x)",
        "sin(y)",
        "cos(x)",
        "cos(y)",
        "1",
        "1.5*x - x*y",
    ),
    "cart-pole": (
        "1",
        "w",
        "x",
        "y",
        "z",
        "y^2",
        "z^2",
        "y^3",
        "z^3",
        "y^4",
        "z^4",
        "sin(w)",
        "cos(w)",
        "sin(w)*y",
        "sin(w)*z",
        "sin(w)*y^2",
        "sin(w)*z^2",
        "cos(w)^2",
        "cos(w)*sin(w)",
        "cos(w)*sin(w)*y",
        "cos(w)*sin(w)*z",
        "cos(w)*sin(w)*y^2",
        "cos(w)*sin(w)*z^2",
        "F",
        "cos(w)*F",
        "sin(w)*F",
        "-(cos(w)*F + 19.62*sin(w) + cos(w)*sin(w)*y^2) / (2 - cos(w)^2)",
    ),
}

# System -> (optimizer, its settings, iteration cap).
OPTIMIZERS: dict[str, tuple[Optimizer, dict[str, float], int]] = {
    "pendulum": ("SR3", {"lambda": 0.01, "nu": 1.0}, 5000),
    "lotka-volterra": ("ADMM", {"lambda": 0.1, "rho": 2.0}, 10_000),
    "cart-pole": ("SR3", {"lambda": 0.01, "nu": 1.0}, 5000),
}

# Seconds between saved states. The slope's own step is 0.01 s for all three.
STATE_STEPS = {"pendulum": 0.01, "lotka-volterra": 0.01, "cart-pole": 0.001}
SLOPE_STEP = 0.01
END = 10.0


def sindy_samples(
    system: System, engine: str | AbstractEngine = "embedded", own_steps: bool = False
) -> Samples:
    """Give the samples from which the paper's SINDy model of a system comes.

    Tsit5 at default tolerances over (0, 10.01) s from the system's start; the slope of the last
    state is ``(u(t + 0.01) - u(t)) / 0.01`` at every saved t in [0, 10]: 1001 rows 0.01 s apart,
    10001 rows 0.001 s apart for the cart-pole.

    The embedded engine ends its steps where the release of 2021 ended them,
    :func:`recorded_steps`. With ``own_steps``, and on every other engine, they are the engine's
    own. Those end up to 1e-6 s elsewhere, since the controller works in single precision; the
    cart-pole's regression makes 3e-5 of that, relative, in its largest coefficient.

    Raises InputError when the system is not one of the paper's.

    >>> from dynsr.data.system import LOTKA_VOLTERRA
    >>> len(sindy_samples(LOTKA_VOLTERRA))
    1001
    """
    if system.name not in STATE_STEPS:
        raise InputError(
            f"the paper has no SINDy row for {system.name!r}; it has: {', '.join(STATE_STEPS)}"
        )
    step = STATE_STEPS[system.name]
    rows, ahead = round(END / step) + 1, round(SLOPE_STEP / step)
    # Divided, not multiplied: i / 1000 is the float nearest to the decimal time, as in Julia.
    times = np.arange(rows + ahead) / round(1 / step)
    if find_engine(engine).name == "embedded" and not own_steps:
        trajectory = _replay(system, times)
    else:
        trajectory = simulate(system, t=times, engine=engine)
    column = trajectory.x[:, trajectory.index(system.target)]
    slopes = (column[ahead:] - column[:-ahead]) / SLOPE_STEP
    return Samples(
        trajectory.columns[:rows],
        slopes,
        trajectory.names,
        system.target,
        "forward",
        times[:rows],
    )


def recorded_steps(system_name: str) -> list[float]:
    """Ends in seconds of the steps that the release of 2021 took over (0, 10.01).

    They were found from its dense output, whose pieces fit Tsit5's interpolant to 6e-13.

    >>> len(recorded_steps("cart-pole"))
    61
    """
    path = files("dynsr.paper") / "references" / "tsit5_2021_steps.json"
    return json.loads(path.read_text(encoding="utf-8"))[system_name]


def _replay(system: System, times: np.ndarray) -> Trajectory:
    problem = InitialValueProblem(
        system.closed_rhs(), system.states, np.array(system.x0), times[[0, -1]]
    )
    states = interpolate(replay_steps(problem, recorded_steps(system.name)), times)
    inputs = compile_numpy(list(system.inputs.values()), ["t"])(times[None]).T
    return Trajectory(times, states, system.states, inputs, tuple(system.inputs))
