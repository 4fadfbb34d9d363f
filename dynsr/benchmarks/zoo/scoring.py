"""Scores of an answer: what its trajectories explain, whether it is the law, what it claimed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import sympy
from scipy.optimize import least_squares

from dynsr.benchmarks.noise import compare_formulas
from dynsr.benchmarks.zoo.conditions import Measurement
from dynsr.benchmarks.zoo.system import ZooSystem
from dynsr.data import Trajectory
from dynsr.engines import InitialValueProblem, find_engine
from dynsr.errors import DynsrError
from dynsr.expression import as_float_tree, compile_numpy, evaluate, free_constants, to_text
from dynsr.fit import r_squared

_RELTOL, _ABSTOL, _MAX_SECONDS = 1e-8, 1e-10, 15.0
_CLOSE = 0.2
_SAME = 0.01
# Longer formulas are no law of the zoo, and take long to compare term by term.
_LONGEST = 1500

Interval = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method makes of some data.

    Parameters
    ----------
    equations : state -> right-hand side.
    verdict : what it says of the whole system: "law", "approximation", "not found" or "".
    intervals : state -> the formula whose floats have intervals, and (value, low, high) of each,
        at 95 %, in the order of its floats.
    failure : why there is no answer, if there is none.
    """

    equations: Mapping[str, sympy.Expr]
    verdict: str = ""
    intervals: Mapping[str, tuple[sympy.Expr, Sequence[Interval]]] = field(default_factory=dict)
    failure: str = ""


@dataclass(frozen=True)
class Scores:
    """How good an answer is.

    Parameters
    ----------
    reproduced, unseen : R2 from the trained and from the second start; the latter infinite where
        there is no second start.
    exact : whether every equation has the terms of the true one, constants within 20 %.
    constants_off : the largest relative error of a constant where all terms are right, else inf.
    slopes_off : rms error of the right-hand sides along both true trajectories, as a share of the
        rms slope; that of the worst state.
    covered, constants : intervals that contain the true constant, of how many; of exact answers.
    """

    reproduced: float
    unseen: float
    exact: bool
    constants_off: float
    slopes_off: float
    covered: int
    constants: int

    @property
    def is_law(self) -> bool:
        """Whether the answer is the law: in form, or the same function within 1 %."""
        return self.exact or self.slopes_off <= _SAME


def score_answer(answer: Answer, animal: ZooSystem, measured: Measurement) -> Scores:
    """Compare an answer with the truth of a system of the zoo.

    Parameters
    ----------
    answer : equations, and what is claimed of them.
    animal : the true system.
    measured : its true trajectories from both starts; measured values are not looked at.
    """
    runs = [run for run in (measured.truth, measured.unseen) if run is not None]
    found = [follow(answer.equations, run, s) for run, s in zip(runs, animal.starts, strict=False)]
    r2 = [r_squared(run.x, x) for run, x in zip(runs, found, strict=True)]
    off = slopes_off(answer.equations, animal, runs)
    exact, constants_off = _compare(answer.equations, animal, off)
    covered = [_covers(answer, animal, state, runs) for state in animal.equations if exact]
    return Scores(
        reproduced=r2[0],
        unseen=r2[1] if len(r2) > 1 else np.inf,
        exact=exact and constants_off <= _CLOSE,
        constants_off=constants_off,
        slopes_off=off,
        covered=sum(held for held, _ in covered),
        constants=sum(count for _, count in covered),
    )


def follow(
    equations: Mapping[str, sympy.Expr], run: Trajectory, start: Sequence[float]
) -> np.ndarray:
    """Integrate equations from a start at time 0 to the times of a run; (n, k).

    States are NaN where a solution diverges or takes too long, all of them where an equation is
    missing or cannot be integrated.

    >>> x = sympy.Symbol("x")
    >>> line = Trajectory([0.5, 1.0], [[1.0], [1.0]], ("x",))
    >>> follow({"x": 2 + 0 * x}, line, [1.0]).round(6).tolist()
    [[2.0], [3.0]]
    """
    lost = np.full(run.x.shape, np.nan)
    if set(equations) != set(run.states):
        return lost
    rhs = tuple(as_float_tree(equations[state]) for state in run.states)
    late = run.t[0] > 0
    times = np.concatenate([[0.0], run.t]) if late else run.t
    try:
        problem = InitialValueProblem(
            rhs, run.states, np.array(start), times, _RELTOL, _ABSTOL, max_seconds=_MAX_SECONDS
        )
        return find_engine("embedded").integrate(problem).x[int(late) :]
    except (DynsrError, ValueError, TypeError, OverflowError):
        return lost


def slopes_off(
    equations: Mapping[str, sympy.Expr], animal: ZooSystem, runs: Sequence[Trajectory]
) -> float:
    """Give the rms error of the right-hand sides along runs as a share of the rms slope.

    Parameters
    ----------
    equations : state -> right-hand side; that of the worst state counts, inf for a missing one.
    animal : the true system.
    runs : trajectories whose states the right-hand sides are compared at.
    """
    x = np.concatenate([run.x for run in runs])
    columns = dict(zip(animal.system.states, x.T, strict=True))
    worst = 0.0
    for state, true in zip(animal.system.states, animal.system.rhs, strict=True):
        if state not in equations or not _known(equations[state], columns):
            return float("inf")
        slope = evaluate(true, columns)
        miss = evaluate(equations[state], columns) - slope
        share = float(np.sqrt(np.mean(miss**2) / np.mean(slope**2)))
        worst = max(worst, share if np.isfinite(share) else float("inf"))
    return worst


def _known(expr: sympy.Expr, columns: Mapping[str, np.ndarray]) -> bool:
    return {str(symbol) for symbol in expr.free_symbols} <= columns.keys()


def _compare(
    equations: Mapping[str, sympy.Expr], animal: ZooSystem, off: float
) -> tuple[bool, float]:
    """Say whether all equations have the true terms, and the largest error of a constant."""
    # Constants within 20 % leave slopes that are not off by more than they are themselves.
    if not off < 1 or any(len(to_text(e)) > _LONGEST for e in equations.values()):
        return False, float("inf")
    largest = 0.0
    for state, true in zip(animal.system.states, animal.system.rhs, strict=True):
        try:
            same, far = compare_formulas(plain_form(equations[state]), plain_form(true))
        except (ValueError, TypeError, ArithmeticError, RecursionError, AttributeError):
            return False, float("inf")
        if not same:
            return False, float("inf")
        largest = max(largest, far)
    return True, largest


def plain_form(expr: sympy.Expr) -> sympy.Expr:
    """Write equal functions alike: logarithms of products as sums, powers to two digits.

    >>> x = sympy.Symbol("x")
    >>> plain_form(sympy.log(2.0 * x) * x**1.312)
    x**(13/10)*(log(x) + 0.693147180559945)
    """

    def squeezed(node: sympy.Expr) -> sympy.Expr:
        digits = sympy.Rational(f"{float(node.exp):.1e}")
        return node.base**digits

    def opened(node: sympy.Expr) -> sympy.Expr:
        argument = sympy.expand(node.args[0])
        fractions = [n for n in argument.atoms(sympy.Rational) if not n.is_Integer]
        # Powers keep their fractions: the square root of x is no x^0.5.
        inside = argument.xreplace({n: sympy.Float(n) for n in fractions})
        return node.func(inside if not argument.has(sympy.Pow) else argument)

    def is_power(node: sympy.Expr) -> bool:
        return bool(node.is_Pow and node.exp.is_number and not node.exp.is_Integer)

    whole = {n: sympy.Integer(int(n)) for n in expr.atoms(sympy.Float) if float(n).is_integer()}
    expr = sympy.expand_log(expr.xreplace(whole), force=True)
    expr = expr.replace(lambda n: isinstance(n, sympy.Function), opened)
    expr = expr.replace(
        lambda n: n.is_Function and not n.free_symbols, lambda n: sympy.Float(float(n))
    )
    return expr.replace(is_power, squeezed)


def _covers(
    answer: Answer, animal: ZooSystem, state: str, runs: Sequence[Trajectory]
) -> tuple[int, int]:
    """Count the intervals of a state that contain the true constant, and all of its intervals.

    The true constants of a formula are those with which it is the true function.
    """
    if state not in answer.intervals:
        return 0, 0
    expr, intervals = answer.intervals[state]
    template, values = free_constants(expr, "constant ")
    finite = [np.isfinite([low, high]).all() and high > low for _, low, high in intervals]
    if len(values) != len(intervals) or not any(finite):
        return 0, 0
    true = _true_constants(template, values, animal, state, runs)
    if true is None:
        return 0, 0
    held = [
        low <= value <= high
        for value, (_, low, high), known in zip(true, intervals, finite, strict=True)
        if known
    ]
    return sum(held), len(held)


def _true_constants(
    template: sympy.Expr,
    values: Mapping[sympy.Symbol, float],
    animal: ZooSystem,
    state: str,
    runs: Sequence[Trajectory],
) -> np.ndarray | None:
    """Fit a formula to the true function; None where it cannot be that function."""
    x = np.concatenate([run.x for run in runs])
    names = [*animal.system.states, *map(str, values)]
    function = compile_numpy([template], names)
    true = evaluate(
        animal.system.rhs[animal.system.index(state)],
        dict(zip(animal.system.states, x.T, strict=True)),
    )

    def residual(constants: np.ndarray) -> np.ndarray:
        rows = np.broadcast_to(constants[:, None], (len(constants), len(x)))
        miss = function(np.concatenate([x.T, rows]))[0] - true
        return np.where(np.isfinite(miss), miss, 1e6)

    start = np.array(list(values.values()))
    fit = least_squares(residual, start, x_scale=np.maximum(np.abs(start), 1e-6), xtol=1e-14)
    size = float(np.sqrt(np.mean(true**2)))
    return fit.x if np.sqrt(np.mean(fit.fun**2)) < 1e-5 * size else None
