"""Tsit5 on step ends that are given, so that another solver's choice of steps can be followed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynsr.engines.base import InitialValueProblem
from dynsr.engines.tsit5 import Steps
from dynsr.engines.tsit5_tableau import stages_of_step
from dynsr.errors import InputError
from dynsr.expression import compile_scalar


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
    for start, end in zip(ends, ends[1:], strict=False):
        taken, x = stages_of_step(slopes, x, start, end - start, first)
        first = taken[6]
        states.append(x)
        stages.append(taken)
    return Steps(np.array(ends), np.array(states), np.array(stages), 0, "")
