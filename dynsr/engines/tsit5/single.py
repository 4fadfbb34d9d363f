"""Tsit5 for one small system, step for step as OrdinaryDiffEq.jl takes it, or on given steps."""

from __future__ import annotations

import itertools
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynsr.engines.base import InitialValueProblem, Integration
from dynsr.engines.tsit5.batch import BatchIntegration, solve_batch
from dynsr.engines.tsit5.tableau import (
    FIRST_ERROR,
    INTERPOLANT,
    Slopes,
    divisor,
    error_of_step,
    stages_of_step,
)
from dynsr.errors import InputError
from dynsr.expression import compile_scalar

__all__ = ["BatchIntegration", "Steps", "interpolate", "solve", "solve_batch", "take_steps"]

# What an expression raises where it has no real value. A power of a negative number is complex
# in Python, and the next function of it (or the error norm) raises TypeError.
NO_REAL_VALUE = (ValueError, ZeroDivisionError, OverflowError, TypeError)
_CLOCK_EVERY = 64


@dataclass(frozen=True, eq=False)
class Steps:
    """The m accepted steps of one solution.

    ``t`` (m + 1,) their ends in seconds and ``x`` (m + 1, k) the states there; ``slopes``
    (m, 7, k) the stages of each; ``message`` says why it ended early, empty when it did not.
    """

    t: np.ndarray
    x: np.ndarray
    slopes: np.ndarray
    rejected: int
    message: str


def solve(problem: InitialValueProblem) -> Integration:
    """Integrate by Tsit5 and give the states at the times of the problem.

    A solution that leaves the real numbers or the finite ones, or needs more steps or time than
    the problem allows, is NaN from there on. Where a trial step meets no real value it is
    repeated with a fifth of its length.

    >>> import sympy
    >>> x = sympy.Symbol("x")
    >>> decay = InitialValueProblem((-x,), ("x",), np.array([1.0]), np.array([0.0, 1.0]))
    >>> bool(abs(solve(decay).x[-1, 0] - np.exp(-1)) < 1e-3)
    True
    """
    steps = solve_steps(problem)
    return Integration(
        x=interpolate(steps, problem.t),
        success=not steps.message,
        accepted=len(steps.t) - 1,
        rejected=steps.rejected,
        message=steps.message,
    )


def solve_steps(problem: InitialValueProblem) -> Steps:
    """Integrate by Tsit5 and give the accepted steps themselves."""
    return take_steps(
        compile_scalar(problem.rhs, [*problem.states, "t"]),
        problem.x0.tolist(),
        (float(problem.t[0]), float(problem.t[-1])),
        problem.reltol,
        problem.abstol,
        problem.max_steps,
        problem.max_seconds,
    )


def interpolate(steps: Steps, t: np.ndarray) -> np.ndarray:
    """Give the states (n, k) at times ``t`` (n,) from the free interpolant; NaN past the end."""
    k = steps.x.shape[1]
    out = np.full((len(t), k), np.nan)
    inside = t[: np.searchsorted(t, steps.t[-1], side="right")]
    if len(steps.t) == 1:
        out[: len(inside)] = steps.x[0]
        return out
    at = np.maximum(np.searchsorted(steps.t, inside, side="left") - 1, 0)
    h = np.diff(steps.t)
    theta = ((inside - steps.t[at]) / h[at])[:, None]
    powers = np.einsum("msk,sp->mpk", steps.slopes, INTERPOLANT) * h[:, None, None]
    # One row a step: its four coefficients of each state, then the state it starts from.
    rows = np.column_stack([powers.reshape(len(h), -1), steps.x[:-1]]).take(at, axis=0)
    values = rows[:, 3 * k : 4 * k] * theta
    for power in (2, 1, 0):
        values += rows[:, power * k : (power + 1) * k]
        values *= theta
    values += rows[:, 4 * k :]
    ends = np.flatnonzero(theta[:, 0] == 1.0)
    values[ends] = steps.x[at[ends] + 1]
    out[: len(inside)] = values
    return out


def take_steps(
    slopes: Slopes,
    x0: Sequence[float],
    span: tuple[float, float],
    reltol: float,
    abstol: float,
    max_steps: int = 100_000,
    max_seconds: float = 60.0,
    longest: Callable[[float], float] | None = None,
) -> Steps:
    """Step from ``x0`` over ``span``; ``slopes(*x, t)`` gives k slopes of k states.

    PI controller with exponents 7/50 and 2/25, safety 0.9, a step at most five times shorter
    or ten times longer than the last; the last one is cut to hit the end, and each to be at most
    ``longest`` of the time that it starts from.
    """
    (t, end), x = span, list(x0)
    times, states, rejected, last_error = [t], [x], 0, FIRST_ERROR
    stages: list[tuple[Sequence[float], ...]] = []
    k1 = _slopes_or_none(slopes, x, t)
    if k1 is None:
        return _as_steps(times, states, stages, 0, f"the equations have no value at t = {t:g}")
    h = first_step(slopes, x, k1, span, reltol, abstol)
    deadline, message = time.perf_counter() + max_seconds, ""
    shortest = sys.float_info.epsilon * max(abs(t), abs(end))
    while t < end:
        h = min(h, end - t, math.inf if longest is None else longest(t))
        if message := _limit_met(h, shortest, t, len(stages) + rejected, max_steps, deadline):
            break
        error, ks, new = _try_step(slopes, x, t, h, k1, reltol, abstol)
        step, h = h, h / divisor(error, last_error)
        if error > 1.0:
            rejected += 1
            continue
        last_error = max(error, FIRST_ERROR)
        # Julia takes a time within 100 roundings of the end for the end.
        t = end if end - (t + step) < 100 * shortest else t + step
        x, k1 = new, ks[6]
        times.append(t)
        states.append(x)
        stages.append(ks)
    return _as_steps(times, states, stages, rejected, message)


def first_step(
    slopes: Slopes,
    x: list[float],
    k1: Sequence[float],
    span: tuple[float, float],
    reltol: float,
    abstol: float,
) -> float:
    """Length of the first step by Hairer's recipe (Solving ODEs I, section II.4), order 5."""
    scale = [abstol + reltol * abs(u) for u in x]
    d0 = _rms([u / s for u, s in zip(x, scale, strict=True)])
    d1 = _rms([a / s for a, s in zip(k1, scale, strict=True)])
    length = span[1] - span[0]
    h0 = min(1e-6 if d0 < 1e-5 or d1 < 1e-5 else d0 / d1 / 100, length)
    k2 = _slopes_or_none(slopes, [u + h0 * a for u, a in zip(x, k1, strict=True)], span[0] + h0)
    if k2 is None:
        return h0
    if list(k1) == list(k2):
        return min(100 * h0, length)
    d2 = _rms([(b - a) / s for a, b, s in zip(k1, k2, scale, strict=True)]) / h0
    largest = max(d1, d2)
    h1 = max(1e-6, h0 / 1000) if largest <= 1e-15 else 10.0 ** (-(2 + math.log10(largest)) / 5)
    return min(100 * h0, h1, length)


def _rms(values: Sequence[float]) -> float:
    try:
        return math.sqrt(sum(v * v for v in values) / len(values))
    except OverflowError:
        return math.inf


def _slopes_or_none(slopes: Slopes, x: Sequence[float], t: float) -> Sequence[float] | None:
    try:
        k = slopes(*x, t)
        return k if math.isfinite(sum(k)) else None
    except NO_REAL_VALUE:
        return None


def _limit_met(
    h: float, shortest: float, t: float, tries: int, max_steps: int, deadline: float
) -> str:
    if (h <= shortest and t != 0.0) or h == 0.0 or t + h == t:
        return f"the solution diverged at t = {t:.6g} (the step became too small)"
    if tries >= max_steps:
        return f"more than {max_steps} steps were needed; stopped at t = {t:.6g}"
    if tries % _CLOCK_EVERY == 0 and time.perf_counter() > deadline:
        return f"the time allowed was used up at t = {t:.6g}"
    return ""


def _try_step(
    slopes: Slopes,
    x: list[float],
    t: float,
    h: float,
    k1: Sequence[float],
    reltol: float,
    abstol: float,
) -> tuple[float, tuple[Sequence[float], ...], list[float]]:
    """One trial step: its error (1 is just acceptable, inf when it has no value), stages, end."""
    try:
        ks, new = stages_of_step(slopes, x, t, h, k1)
        error = error_of_step(x, new, h, ks, reltol, abstol)
        # The error norm loses an overflow in inf / inf.
        if error < math.inf and math.isfinite(sum(new)) and math.isfinite(sum(ks[6])):
            return error, ks, new
    except NO_REAL_VALUE:
        pass
    return math.inf, (), []


def _as_steps(
    times: list[float],
    states: list[list[float]],
    stages: list[tuple[Sequence[float], ...]],
    rejected: int,
    message: str,
) -> Steps:
    slopes = np.array(stages, dtype=float).reshape(len(stages), 7, len(states[0]))
    return Steps(np.array(times), np.array(states, dtype=float), slopes, rejected, message)


def replay_steps(problem: InitialValueProblem, ends: Sequence[float]) -> Steps:
    """Take the steps from ``ends[0]`` to ``ends[1]``, ``ends[2]``, ..., whatever their errors.

    The problem's own times and tolerances are not used. Raises InputError when the ends do not
    increase.

    >>> import sympy
    >>> x = sympy.Symbol("x")
    >>> decay = InitialValueProblem((-x,), ("x",), np.ones(1), np.array([0.0, 1.0]))
    >>> steps = replay_steps(decay, [0.0, 0.5, 1.0])
    >>> bool(abs(steps.x[-1, 0] - np.exp(-1)) < 1e-5)
    True
    """
    if len(ends) < 2 or not np.all(np.diff(ends) > 0):
        raise InputError("the step ends must be at least two increasing times")
    slopes = compile_scalar(problem.rhs, [*problem.states, "t"])
    x = problem.x0.tolist()
    states, stages = [x], []
    first: Sequence[float] = slopes(*x, ends[0])
    for start, end in itertools.pairwise(ends):
        taken, x = stages_of_step(slopes, x, start, end - start, first)
        first = taken[6]
        states.append(x)
        stages.append(taken)
    return Steps(np.array(ends), np.array(states), np.array(stages), 0, "")
