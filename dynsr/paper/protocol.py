"""The paper's protocol: what it did with its own three systems, and with no other.

Everything is found by the catalogue's own system (:func:`find_protocol`), never by a name: a system
that somebody else calls "pendulum" is not the paper's.

The **printed loss** is what the paper's tables really hold, decoded from its printed expressions:
the trajectory loss of :mod:`dynsr.verdict.scoring` over all states for SINDy and over the first
two for every other method, where the altered pendulum starts at (0.3, 0) and the truth at x0.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import PAPER_SYSTEMS, SYSTEMS, Samples, System, Trajectory
from dynsr.engines import (
    DEFAULT_ABSTOL,
    DEFAULT_RELTOL,
    AbstractEngine,
    InitialValueProblem,
    Optimizer,
    interpolate,
    replay_steps,
    simulate,
)
from dynsr.errors import InputError
from dynsr.expression import compile_numpy
from dynsr.methods import PAPER_METHODS, AbstractMethod, Library, make_method
from dynsr.verdict import Score, score_expressions, trajectory_losses

PAPER_NAMES: tuple[str, ...] = tuple(system.name for system in PAPER_SYSTEMS)

# The slope's own step and the last saved time, in seconds, of every row of SINDy.
SLOPE_STEP = 0.01
END = 10.0


# The protocol of each system.


@dataclass(frozen=True, eq=False)
class Protocol:
    """What the paper did with one of its systems.

    Parameters
    ----------
    system : the catalogue's own.
    basis : functions of SINDy's library (section A.3).
    optimizer, settings, iterations : SINDy's sparse regression (section A.3): optimizer, its
        settings, cap on its iterations.
    genetic : settings of the GA (table 2), and as its terminals those of the printed words, which
        contain the true coefficients ("an optimistic estimate", section 4). Twenty bits are enough
        for those words only with eight symbols and four functions (see the grammar's own text);
        sixty are enough for the whole grammar.
    state_step : seconds between the saved states that SINDy's row was made from.
    printed_start : (k,) where the altered system started when the printed losses were made; the
        system's x0 by default.
    """

    system: System
    basis: tuple[str, ...]
    optimizer: Optimizer
    settings: dict[str, float]
    iterations: int
    genetic: dict[str, Any]
    state_step: float
    printed_start: tuple[float, ...] | None = None


def _split(basis: str) -> tuple[str, ...]:
    return tuple(basis.split(", "))


PROTOCOLS = (
    Protocol(
        SYSTEMS["lotka-volterra"],
        basis=_split("x, y, x*y, sin(x), sin(y), cos(x), cos(y), 1, 1.5*x - x*y"),
        optimizer="ADMM",
        settings={"lambda": 0.1, "rho": 2.0},
        iterations=10_000,
        genetic={
            "bits": 20,
            "population": 70,
            "iterations": 100,
            "constants": (1.0, -3.0),
            "operators": ("+", "*", "^"),
            "functions": ("sin", "cos", "exp", "identity"),
        },
        state_step=0.01,
    ),
    Protocol(
        SYSTEMS["pendulum"],
        basis=_split(
            "theta1, theta2, sin(theta1), cos(theta2), cos(theta1), sin(theta2), "
            "cos(theta1)*sin(theta2), 1"
        ),
        optimizer="SR3",
        settings={"lambda": 0.01, "nu": 1.0},
        iterations=5000,
        genetic={
            "bits": 20,
            "population": 70,
            "iterations": 40,
            "constants": (-9.81, -0.1, -1.0),
            "operators": ("+", "*"),
            "functions": ("sin", "cos", "exp", "identity"),
        },
        state_step=0.01,
        # Evidently the first two of the cart-pole's own start, copied.
        printed_start=(0.3, 0.0),
    ),
    Protocol(
        SYSTEMS["cart-pole"],
        basis=_split(
            "1, w, x, y, z, y^2, z^2, y^3, z^3, y^4, z^4, sin(w), cos(w), sin(w)*y, "
            "sin(w)*z, sin(w)*y^2, sin(w)*z^2, cos(w)^2, cos(w)*sin(w), cos(w)*sin(w)*y, "
            "cos(w)*sin(w)*z, cos(w)*sin(w)*y^2, cos(w)*sin(w)*z^2, F, cos(w)*F, sin(w)*F, "
            "-(cos(w)*F + 19.62*sin(w) + cos(w)*sin(w)*y^2) / (2 - cos(w)^2)"
        ),
        optimizer="SR3",
        settings={"lambda": 0.01, "nu": 1.0},
        iterations=5000,
        genetic={
            "bits": 60,
            "population": 100,
            "iterations": 100,
            "constants": (-1.0, 2.0, 9.81, 0.5, 6.0, -0.2),
            "variables": ("w", "x", "y", "z"),
        },
        state_step=0.001,
    ),
)


def is_of_paper(system: System) -> bool:
    """Whether a system is one of the paper's: the catalogue's own or one equal to it.

    >>> from dynsr.data.system import PENDULUM
    >>> is_of_paper(PENDULUM), is_of_paper(System.from_strings({"x": "-x"}, name="pendulum"))
    (True, False)
    """
    return any(system == protocol.system for protocol in PROTOCOLS)


def find_protocol(system: System) -> Protocol:
    """Give the protocol of one of the paper's systems; raises InputError for any other.

    >>> from dynsr.data.system import LOTKA_VOLTERRA
    >>> find_protocol(LOTKA_VOLTERRA).optimizer
    'ADMM'
    """
    for protocol in PROTOCOLS:
        if system == protocol.system:
            return protocol
    raise InputError(
        f"{system.name!r} is not one of the paper's own systems, so the paper has no protocol for "
        f"it; give one of {', '.join(PAPER_NAMES)} from dynsr.SYSTEMS"
    )


# The methods as the paper set them.


def paper_method(name: str, system: System, quick: bool = False) -> AbstractMethod:
    """Give a method with the settings that the paper has for a system.

    Parameters
    ----------
    name : one of PAPER_METHODS.
    system : the system; on one that is not the paper's, its general choices apply.
    quick : a tenth of the genetic algorithm's iterations and a short DynAIFeynman, for a first
        look; SINDy is done in a second as it is.

    Raises InputError for another name, and for SINDy on a system that is not the paper's, since
    its library is chosen by hand for each.

    >>> from dynsr.data.system import PENDULUM
    >>> paper_method("ga", PENDULUM).iterations
    40
    """
    if name not in PAPER_METHODS:
        raise InputError(
            f"unknown method {name!r} of the paper; the methods are: {', '.join(PAPER_METHODS)}"
        )
    if name == "sindy":
        if not is_of_paper(system):
            raise InputError(
                f"SINDy has no paper settings for {system.name!r}; they exist for "
                f"{', '.join(PAPER_NAMES)}; use preset best for other data"
            )
        protocol = find_protocol(system)
        return make_method(
            name,
            "paper",
            library=Library.from_strings(protocol.basis),
            optimizer=protocol.optimizer,
            settings=protocol.settings,
            max_iterations=protocol.iterations,
        )
    if name == "ga":
        changes = dict(find_protocol(system).genetic) if is_of_paper(system) else {}
        if quick:
            changes["iterations"] = max(4, changes.get("iterations", 100) // 10)
        return make_method(name, "paper", **changes)
    return make_method(name, "quick" if quick else "paper")


# The printed loss.


def compared_states(system: System, method: str) -> tuple[str, ...]:
    """States whose distances the paper's tables add up for ``method``."""
    return system.states if "sindy" in method.lower() else system.states[:2]


def printed_losses(
    system: System,
    exprs: Sequence[sympy.Expr],
    method: str,
    target: str | None = None,
    engine: str | AbstractEngine = "embedded",
) -> list[float]:
    """Give the printed loss of each of many equations; see :func:`printed_loss`."""
    return trajectory_losses(
        system,
        exprs,
        target,
        engine,
        start=find_protocol(system).printed_start,
        states=compared_states(system, method),
    )


@checked
def printed_loss(
    system: System,
    expr: sympy.Expr,
    method: str,
    target: str | None = None,
    engine: str | AbstractEngine = "embedded",
) -> float:
    """Loss as the paper's tables were really made for ``method`` (see the module's text).

    Parameters
    ----------
    system : one of the paper's three, as :data:`dynsr.SYSTEMS` holds them.
    expr : right-hand side that was found; may use the states, the inputs and ``t``.
    method : the name of the method; SINDy's losses count all states, the others' two.
    target : the state it was found for; the system's own target by default.
    engine : what integrates.

    Infinity when the altered system diverges. Raises InputError for a system that is not one of
    the paper's, and for an unknown name or target.

    >>> from dynsr.data.system import CART_POLE
    >>> from dynsr.expression import parse
    >>> round(printed_loss(CART_POLE, parse("-2*w"), "GA"), 5)
    0.41711
    """
    return printed_losses(system, [expr], method, target, engine)[0]


def score_as_printed(
    system: System, exprs: Sequence[sympy.Expr], method: str, **options: Any
) -> list[Score]:
    """Score as :func:`dynsr.score_expressions`, and by the printed loss on the paper's systems.

    ``options`` are those of that function. On any other system ``printed_loss`` stays None.

    >>> from dynsr.data.system import LORENZ, LOTKA_VOLTERRA
    >>> [score_as_printed(s, [s.rhs[-1]], "ga")[0].printed_loss for s in (LORENZ, LOTKA_VOLTERRA)]
    [None, 0.0]
    """
    scores = score_expressions(system, exprs, method, **options)
    if not is_of_paper(system):
        return scores
    where = {key: options[key] for key in ("target", "engine") if key in options}
    distinct = list(dict.fromkeys(exprs))
    losses = dict(zip(distinct, printed_losses(system, distinct, method, **where), strict=True))
    return [replace(score, printed_loss=losses[score.expr]) for score in scores]


# The samples of SINDy's rows.


def sindy_samples(
    system: System, engine: str | AbstractEngine = "embedded", recorded_steps: bool = False
) -> Samples:
    """Give the samples from which the paper's SINDy model of a system comes.

    Tsit5 at default tolerances over (0, 10.01) s from the system's start; the slope of the last
    state is ``(u(t + 0.01) - u(t)) / 0.01`` at every saved t in [0, 10]: 1001 rows 0.01 s apart,
    10001 rows 0.001 s apart for the cart-pole.

    Parameters
    ----------
    system : one of the paper's three.
    engine : what integrates.
    recorded_steps : end the steps where the release of 2021 ended them, :func:`recorded_ends`,
        instead of where the engine's own controller ends them; the embedded engine alone can.
        Own steps end up to 3e-6 s elsewhere, since the controller works in single precision. The
        cart-pole's regression makes 3e-5 of that, relative, in its largest coefficient: 1642.359
        for the printed 1642.312. The other two rows have every printed digit either way.

    Raises InputError when the system is not one of the paper's, or the engine takes no recorded
    steps.

    >>> from dynsr.data.system import LOTKA_VOLTERRA
    >>> len(sindy_samples(LOTKA_VOLTERRA))
    1001
    """
    step = find_protocol(system).state_step
    rows, ahead = round(END / step) + 1, round(SLOPE_STEP / step)
    # Divided, not multiplied: i / 1000 is the float nearest to the decimal time, as in Julia.
    times = np.arange(rows + ahead) / round(1 / step)
    if recorded_steps:
        check_replays(engine)
        trajectory = _replay(system, times)
    else:
        trajectory = simulate(system, None, times, DEFAULT_RELTOL, DEFAULT_ABSTOL, engine)
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


def check_replays(engine: str | AbstractEngine) -> None:
    """Raise InputError unless an engine can take recorded steps."""
    name = engine if isinstance(engine, str) else engine.name
    if name != "embedded":
        raise InputError(
            f"engine {name!r} takes no recorded steps; give engine embedded, or its own steps"
        )


def recorded_ends(system: System) -> list[float]:
    """Ends in seconds of the steps that the release of 2021 took over (0, 10.01).

    They were found from its dense output, whose pieces fit Tsit5's interpolant to 6e-13. Raises
    InputError when the system is not one of the paper's.

    >>> from dynsr.data.system import CART_POLE
    >>> len(recorded_ends(CART_POLE))
    61
    """
    path = files("dynsr.paper") / "references" / "tsit5_2021_steps.json"
    return json.loads(path.read_text(encoding="utf-8"))[find_protocol(system).system.name]


def _replay(system: System, times: np.ndarray) -> Trajectory:
    problem = InitialValueProblem(
        system.closed_rhs(), system.states, np.array(system.x0), times[[0, -1]]
    )
    states = interpolate(replay_steps(problem, recorded_ends(system)), times)
    inputs = compile_numpy(list(system.inputs.values()), ["t"])(times[None]).T
    return Trajectory(times, states, system.states, inputs, tuple(system.inputs))
