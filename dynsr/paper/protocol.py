"""The paper's protocol: its methods' settings for its own systems, and how its data were made.

Keyed by the catalogue's systems themselves, never by a name that a user could choose.
"""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

import numpy as np

from dynsr.data import PAPER_SYSTEMS, Samples, System, Trajectory
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
from dynsr.methods import AbstractMethod, Library, make_method

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

# Table 2 of the paper, and per system the terminals of its printed words, which hold the true
# coefficients ("an optimistic estimate", section 4). Twenty bits hold those words only with eight
# symbols and four functions (see the grammar's own text); sixty hold the whole grammar.
GENETIC: dict[str, dict[str, Any]] = {
    "lotka-volterra": {
        "bits": 20,
        "population": 70,
        "iterations": 100,
        "constants": (1.0, -3.0),
        "operators": ("+", "*", "^"),
        "functions": ("sin", "cos", "exp", "identity"),
    },
    "pendulum": {
        "bits": 20,
        "population": 70,
        "iterations": 40,
        "constants": (-9.81, -0.1, -1.0),
        "operators": ("+", "*"),
        "functions": ("sin", "cos", "exp", "identity"),
    },
    "cart-pole": {
        "bits": 60,
        "population": 100,
        "iterations": 100,
        "constants": (-1.0, 2.0, 9.81, 0.5, 6.0, -0.2),
        "variables": ("w", "x", "y", "z"),
    },
}

# The methods that the paper compares, as its tables call them.
PAPER_METHODS: tuple[str, ...] = ("dynaifeynman", "ga", "sindy")

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


def is_of_paper(system: System) -> bool:
    """Say whether a system is one of the paper's three, equal in all that the catalogue says.

    >>> is_of_paper(System.from_strings({"x": "-x"}, name="pendulum"))
    False
    """
    return system in PAPER_SYSTEMS


def paper_method(name: str, system: System, quick: bool = False) -> AbstractMethod:
    """Give a method with the settings that the paper has for a system.

    Parameters
    ----------
    name : one of PAPER_METHODS.
    system : the system; on one that is not the paper's, its general choices stand.
    quick : a tenth of the genetic algorithm's iterations and a short DynAIFeynman, for a first
        look; SINDy is done in a second as it is.

    Raises InputError for another name, and for SINDy on a system that is not the paper's, since
    its library is chosen by hand for each.

    >>> from dynsr.data import find_system
    >>> paper_method("ga", find_system("pendulum")).iterations
    40
    """
    if name not in PAPER_METHODS:
        raise InputError(
            f"unknown method {name!r} of the paper; the methods are: {', '.join(PAPER_METHODS)}"
        )
    ours = is_of_paper(system)
    if name == "sindy":
        if not ours:
            raise InputError(
                f"SINDy has no paper settings for {system.name!r}; they exist for "
                f"{', '.join(BASES)}; use preset best for other data"
            )
        optimizer, settings, cap = OPTIMIZERS[system.name]
        return make_method(
            name,
            "paper",
            library=Library.from_strings(BASES[system.name]),
            optimizer=optimizer,
            settings=settings,
            max_iterations=cap,
        )
    if name == "ga":
        changes: dict[str, Any] = dict(GENETIC[system.name]) if ours else {}
        if quick:
            changes["iterations"] = max(4, changes.get("iterations", 100) // 10)
        return make_method(name, "paper", **changes)
    return make_method(name, "quick" if quick else "paper")
