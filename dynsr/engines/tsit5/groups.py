"""Many initial value problems at once: those that differ in numbers alone share their lanes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import sympy

from dynsr.engines.base import InitialValueProblem, Integration
from dynsr.engines.tsit5.batch import lane_slopes, solve_batch
from dynsr.engines.tsit5.single import solve

# Fewer lanes than this are faster one by one, in plain floats.
LANES_THAT_PAY = 6
# A lane that needs more steps goes on alone, where a step costs less.
STEPS_TOGETHER = 200


def solve_all(problems: Sequence[InitialValueProblem]) -> list[Integration]:
    """Solve many problems by Tsit5, one answer each in the same order.

    Problems of the same states, times, limits and form (equal but for the floating-point numbers
    in their right-hand sides, and for their starts) are integrated together. A lane takes the
    steps that it would take alone; its numbers differ in the last bits.

    >>> from dynsr.expression import parse
    >>> decays = [
    ...     InitialValueProblem((parse(f"-{rate}*x"),), ("x",), [1.0], [0.0, 1.0])
    ...     for rate in (0.5, 1.5)
    ... ]
    >>> [round(float(found.x[-1, 0]), 3) for found in solve_all(decays)]
    [0.607, 0.223]
    """
    answers: list[Integration | None] = [None] * len(problems)
    for form, members in _forms(problems).items():
        chosen = [problems[i] for i, _ in members]
        if len(members) < LANES_THAT_PAY:
            found = [solve(problem) for problem in chosen]
        else:
            found = _solve_form(form[-1], chosen, np.array([numbers for _, numbers in members]))
        for (i, _), answer in zip(members, found, strict=True):
            answers[i] = answer
    return [answer for answer in answers if answer is not None]


def split_numbers(expr: sympy.Expr) -> tuple[Any, list[float]]:
    """Split an expression into its form and the floating-point numbers that fill it.

    Two expressions that differ in those numbers alone have equal forms, whatever the order in
    which SymPy holds their terms.

    >>> from dynsr.expression import parse
    >>> one, two = split_numbers(parse("1.5*x + y")), split_numbers(parse("y + 2.5*x"))
    >>> one[0] == two[0], one[1], two[1]
    (True, [1.5], [2.5])
    """
    if expr.is_Float:
        return None, [float(expr)]
    if not expr.has(sympy.Float):
        return expr, []
    parts = [split_numbers(argument) for argument in expr.args]
    if expr.is_Add or expr.is_Mul:
        parts.sort(key=lambda part: repr(part[0]))
    return (expr.func, *(form for form, _ in parts)), [n for _, numbers in parts for n in numbers]


def fill_form(form: Any, numbers: Iterator[sympy.Expr]) -> sympy.Expr:
    """Put an expression for every number back into a form, in the order of split_numbers."""
    if form is None:
        return next(numbers)
    if isinstance(form, tuple):
        return form[0](*[fill_form(part, numbers) for part in form[1:]])
    return form


def _forms(
    problems: Sequence[InitialValueProblem],
) -> dict[tuple[Any, ...], list[tuple[int, list[float]]]]:
    groups: dict[tuple[Any, ...], list[tuple[int, list[float]]]] = {}
    for i, problem in enumerate(problems):
        parts = [split_numbers(expr) for expr in problem.rhs]
        limits = (problem.reltol, problem.abstol, problem.max_steps, problem.max_seconds)
        form = (problem.states, problem.t.tobytes(), *limits, tuple(form for form, _ in parts))
        numbers = [n for _, numbers in parts for n in numbers]
        groups.setdefault(form, []).append((i, numbers))
    return groups


def _solve_form(
    forms: tuple[Any, ...], problems: list[InitialValueProblem], numbers: np.ndarray
) -> list[Integration]:
    one = problems[0]
    # Longer than any state's name, so that none is taken.
    prefix = "_" * (1 + max(len(state) for state in one.states))
    names = [f"{prefix}{i}" for i in range(numbers.shape[1])]
    symbols = iter([sympy.Symbol(name) for name in names])
    rhs = [fill_form(form, symbols) for form in forms]
    batch = solve_batch(
        lane_slopes(rhs, one.states, names, numbers.T),
        np.array([problem.x0 for problem in problems]),
        one.t,
        one.reltol,
        one.abstol,
        min(one.max_steps, STEPS_TOGETHER),
        one.max_seconds * len(problems),
    )
    tries = batch.accepted + batch.rejected
    return [
        solve(problem)
        if not batch.success[i] and tries[i] >= STEPS_TOGETHER
        else Integration(
            batch.x[i],
            bool(batch.success[i]),
            int(batch.accepted[i]),
            int(batch.rejected[i]),
            "" if batch.success[i] else f"the solution diverged at t = {batch.reached[i]:.6g}",
        )
        for i, problem in enumerate(problems)
    ]
