"""How the paper made the data of its SINDy rows."""

from __future__ import annotations

import numpy as np

from dynsr.engines.base import AbstractEngine
from dynsr.errors import InputError
from dynsr.paper.bases import END, SLOPE_STEP, STATE_STEPS
from dynsr.samples import Samples
from dynsr.simulate import simulate
from dynsr.system import System


def sindy_samples(system: System, engine: str | AbstractEngine = "embedded") -> Samples:
    """Give the samples from which the paper's SINDy model of a system comes.

    Tsit5 at default tolerances over (0, 10.01) s from the system's start; the slope of the last
    state is ``(u(t + 0.01) - u(t)) / 0.01`` at every saved t in [0, 10]: 1001 rows 0.01 s apart,
    10001 rows 0.001 s apart for the cart-pole.

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
