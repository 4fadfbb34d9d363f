"""How the paper made the data of its SINDy rows."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np

from dynsr.engines.base import AbstractEngine, InitialValueProblem
from dynsr.engines.select import find_engine
from dynsr.engines.tsit5 import interpolate
from dynsr.engines.tsit5_replay import replay_steps
from dynsr.errors import InputError
from dynsr.expression import compile_numpy
from dynsr.paper.bases import END, SLOPE_STEP, STATE_STEPS
from dynsr.samples import Samples
from dynsr.simulate import simulate
from dynsr.system import System
from dynsr.trajectory import Trajectory


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

    >>> from dynsr.catalogue import LOTKA_VOLTERRA
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
