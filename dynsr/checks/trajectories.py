"""Comparisons as rows, and trajectories of an engine against recorded ones and independent solvers.

The solvers are SciPy's DOP853 and the embedded engine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

from dynsr.data import System, find_system
from dynsr.engines import (
    DEFAULT_ABSTOL,
    DEFAULT_RELTOL,
    AbstractEngine,
    EmbeddedEngine,
    InitialValueProblem,
    Integration,
)
from dynsr.expression import compile_scalar
from dynsr.paper import trajectory_record


@dataclass(frozen=True)
class CrosscheckRow:
    """One comparison.

    Parameters
    ----------
    section, system, subject : what was compared.
    ours, theirs : the two programs.
    compared : how many numbers were compared.
    difference : the largest, relative for coefficients and in the states' own units for
        trajectories; None where one side is absent.
    limit : up to which difference the two agree.
    worst : where the largest difference occurred, or why a side is absent.
    judged : whether a program is compared with the truth instead of another program.

    ``verdict`` is agrees, differs or absent; for a comparison with the truth, right or wrong.

    >>> CrosscheckRow("records", "pendulum", "states", "embedded", "scipy", 9, 1e-9, 1e-8).verdict
    'agrees'
    """

    section: str
    system: str
    subject: str
    ours: str
    theirs: str
    compared: int
    difference: float | None
    limit: float
    worst: str = ""
    judged: bool = False
    verdict: str = field(init=False)

    def __post_init__(self) -> None:
        """Compare the difference with its limit."""
        if self.difference is None:
            verdict = "absent"
        else:
            words = ("right", "wrong") if self.judged else ("agrees", "differs")
            verdict = words[not self.difference <= self.limit]
        object.__setattr__(self, "verdict", verdict)


def absent(section: str, system: str, ours: str, theirs: str, reason: str) -> CrosscheckRow:
    """Give the row of a comparison that cannot be made."""
    return CrosscheckRow(section, system, "", ours, theirs, 0, None, math.nan, reason)


DEFAULT_LIMIT = 2e-5
TIGHT_LIMIT = 1e-8
RECORDED = "OrdinaryDiffEqTsit5 1.1.0 (recorded)"


def trajectory_rows(system_name: str, engine: AbstractEngine) -> Iterator[CrosscheckRow]:
    """Compare an engine's states over the training span with four independent answers.

    The recorded states at the accepted steps of default tolerances, and the number of those
    steps; the recorded states at tolerances of 1e-10; scipy's DOP853 at 1e-12; and, for another
    engine than it, the embedded engine's states.

    Parameters
    ----------
    system_name : one of the paper's systems.
    engine : the engine to check.

    Raises EngineError when the engine fails.
    """
    system = find_system(system_name)
    t, x = trajectory_record(system_name, "steps")
    loose = _integrate(system, engine, t)
    yield _states(system, engine, "default tolerances", RECORDED, t, loose.x, x, DEFAULT_LIMIT)
    yield _steps(system, engine, loose, len(t) - 1)
    t, x = trajectory_record(system_name, "tight")
    tight = _integrate(system, engine, t, 1e-10, 1e-10)
    yield _states(system, engine, "tolerances 1e-10", RECORDED, t, tight.x, x, TIGHT_LIMIT)
    tighter = _integrate(system, engine, t, 1e-12, 1e-12)
    peer = _solve_by_scipy(system, t)
    theirs = "scipy DOP853 at 1e-12"
    yield _states(system, engine, "tolerances 1e-12", theirs, t, tighter.x, peer, TIGHT_LIMIT)
    if not isinstance(engine, EmbeddedEngine):
        t = system.times(system.train)
        here, there = (_integrate(system, e, t).x for e in (engine, EmbeddedEngine()))
        yield _states(
            system, engine, "default tolerances", "embedded", t, here, there, DEFAULT_LIMIT
        )


def _integrate(
    system: System,
    engine: AbstractEngine,
    t: np.ndarray,
    reltol: float = DEFAULT_RELTOL,
    abstol: float = DEFAULT_ABSTOL,
) -> Integration:
    problem = InitialValueProblem(
        system.closed_rhs(), system.states, np.array(system.x0), t, reltol, abstol
    )
    return engine.integrate(problem)


def _solve_by_scipy(system: System, t: np.ndarray) -> np.ndarray:
    slopes = compile_scalar(system.closed_rhs(), [*system.states, "t"])
    solution = solve_ivp(
        lambda now, x: slopes(*x, now),
        (t[0], t[-1]),
        system.x0,
        "DOP853",
        t,
        rtol=1e-12,
        atol=1e-12,
    )
    return solution.y.T


def _states(
    system: System,
    engine: AbstractEngine,
    subject: str,
    theirs: str,
    t: np.ndarray,
    found: np.ndarray,
    expected: np.ndarray,
    limit: float,
) -> CrosscheckRow:
    gaps = np.abs(found - expected)
    # A state that is missing is as far off as can be.
    gaps[np.isnan(gaps)] = np.inf
    row, column = np.unravel_index(np.argmax(gaps), gaps.shape)
    return CrosscheckRow(
        "trajectories",
        system.name,
        f"states, {subject}",
        engine.name,
        theirs,
        gaps.size,
        float(gaps[row, column]),
        limit,
        f"{system.states[column]} at t = {t[row]:g}",
    )


def _steps(
    system: System, engine: AbstractEngine, found: Integration, expected: int
) -> CrosscheckRow:
    return CrosscheckRow(
        "trajectories",
        system.name,
        "accepted steps, default tolerances",
        engine.name,
        RECORDED,
        expected,
        float(abs(found.accepted - expected)),
        0.0,
        f"{found.accepted} and {expected}",
    )
