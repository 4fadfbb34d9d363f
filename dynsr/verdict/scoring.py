"""Scoring: how far an equation that was found is from the true one, for any known system.

- **equation RMSE**: root mean square of f_hat(x) - f(x) along the true states of the test span,
  for the target alone (Weilbach et al. 2021, section 4.1).
- **trajectory loss**: the true system and the one with the equation replaced are integrated over
  the test span, both from x0 at its first time; loss = sqrt(mean over t of the sum over all states
  d of (x_hat_d - x_d)^2).

The loss behind the numbers that the paper prints differs from the second one in its start and its
states; it is the paper's alone, :mod:`dynsr.paper.protocol`.

Both integrations take Tsit5 at its default tolerances and are compared at 5001 times. A solution
that diverges, leaves its domain or needs more than 10 000 steps (the true ones of the paper need
18 to 34) has loss infinity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import System
from dynsr.engines import AbstractEngine, InitialValueProblem, find_engine
from dynsr.errors import EngineError
from dynsr.expression import compile_numpy

COMPARED_TIMES = 5001
MAX_STEPS = 10_000
_AT_ONCE = 256


_LOSSES = ("equation_rmse", "printed_loss", "trajectory_loss")


@checked
@dataclass(frozen=True)
class Score:
    """One equation that a method found, with its losses.

    Parameters
    ----------
    system, method, seed : what was searched, by what, from which seed.
    target : the state whose equation was sought.
    expr : the right-hand side found for it.
    equation_rmse : state units per second.
    trajectory_loss : state units.
    printed_loss : the loss behind the numbers that the paper prints, state units; None unless the
        paper's protocol was asked for and the system is one of the paper's.
    seconds : time that the search took.
    origin : where the numbers come from (engine and versions).

    >>> Score("decay", "sindy", 0, "x", sympy.Symbol("x"), 0.5, 2.0).losses
    {'equation_rmse': 0.5, 'trajectory_loss': 2.0}
    """

    system: str
    method: str
    seed: int | None
    target: str
    expr: sympy.Expr
    equation_rmse: float
    trajectory_loss: float
    printed_loss: float | None = None
    seconds: float = math.nan
    origin: Mapping[str, Any] = field(default_factory=dict)

    @property
    def losses(self) -> dict[str, float]:
        """Every loss that was measured, by its name."""
        values = {name: getattr(self, name) for name in _LOSSES}
        return {name: value for name, value in values.items() if value is not None}


@checked
def equation_rmse(
    system: System,
    expr: sympy.Expr,
    target: str | None = None,
    engine: str | AbstractEngine = "embedded",
) -> float:
    """Root mean square of f_hat(x) - f(x) along the true states of the test span.

    Parameters
    ----------
    system : the true system.
    expr : right-hand side that was found; may use the states, the inputs and ``t``.
    target : the state it was found for; the system's own target by default.
    engine : what integrates.

    Infinity where it has no value. Raises InputError for an unknown name or target, EngineError
    when the true system has no solution over its test span.

    >>> from dynsr.data.system import PENDULUM
    >>> from dynsr.expression import parse
    >>> round(equation_rmse(PENDULUM, parse("-9.81*sin(theta1) - 0.1*theta2 + 0.25")), 12)
    0.25
    """
    return _Test.of(system, find_engine(engine)).equation_rmse(expr, target or system.target)


@checked
def trajectory_loss(
    system: System,
    expr: sympy.Expr,
    target: str | None = None,
    engine: str | AbstractEngine = "embedded",
) -> float:
    """Trajectory loss: sqrt(mean over t of sum over all states of (x_hat - x)^2), both from x0.

    Parameters
    ----------
    system : the true system.
    expr : right-hand side that was found; may use the states, the inputs and ``t``.
    target : the state it was found for; the system's own target by default.
    engine : what integrates.

    Infinity when the altered system diverges. Raises InputError for an unknown name or target,
    EngineError when the true system has no solution over its test span.

    >>> from dynsr.data.system import LOTKA_VOLTERRA
    >>> from dynsr.expression import parse
    >>> trajectory_loss(LOTKA_VOLTERRA, parse("-y*(3 - x)"))
    0.0
    """
    return trajectory_losses(system, [expr], target, engine)[0]


def trajectory_losses(
    system: System,
    exprs: Sequence[sympy.Expr],
    target: str | None = None,
    engine: str | AbstractEngine = "embedded",
    *,
    start: Sequence[float] | None = None,
    states: Sequence[str] | None = None,
) -> list[float]:
    """Give the trajectory loss of each of many equations of one target.

    Parameters
    ----------
    system, target, engine : as in :func:`trajectory_loss`.
    exprs : the right-hand sides that were found.
    start : (k,) where the altered systems start; the true one always starts at its x0, the default.
    states : whose distances are added up; all by default.

    >>> from dynsr.data.system import CART_POLE
    >>> from dynsr.expression import parse
    >>> some = trajectory_losses(CART_POLE, [parse("-2*w")], states=["w", "x"])
    >>> some < trajectory_losses(CART_POLE, [parse("-2*w")])
    True
    """
    test = _Test.of(system, find_engine(engine))
    return test.trajectory_losses(exprs, target or system.target, start, states)


@checked
def score_expressions(
    system: System,
    exprs: Sequence[sympy.Expr],
    method: str,
    *,
    target: str | None = None,
    seed: int | None = None,
    seconds: float = math.nan,
    engine: str | AbstractEngine = "embedded",
) -> list[Score]:
    """Score many equations of one target at once; the score of each, in order.

    Parameters
    ----------
    system : the true system; any one.
    exprs : right-hand sides that were found; equal ones are integrated once.
    method : name of the method that found them, kept in the scores.
    target : the state they were found for; the system's own target by default.
    seed, seconds : of the search, kept in the scores.
    engine : what integrates.

    Raises InputError for an unknown name or target, and EngineError when the true system itself
    has no solution over its test span.

    >>> from dynsr.data.system import PENDULUM
    >>> from dynsr.expression import parse
    >>> score_expressions(PENDULUM, [parse("-10*sin(theta1)")], "sindy")[0].trajectory_loss < 1.5
    True
    """
    chosen, target = find_engine(engine), target or system.target
    test = _Test.of(system, chosen)
    origin = {"engine": chosen.name, "versions": chosen.versions()}
    distinct = list(dict.fromkeys(exprs))
    losses = dict(zip(distinct, test.trajectory_losses(distinct, target), strict=True))
    rmse = {expr: test.equation_rmse(expr, target) for expr in distinct}
    return [
        Score(
            system.name,
            method,
            seed,
            target,
            expr,
            rmse[expr],
            losses[expr],
            seconds=seconds,
            origin=origin,
        )
        for expr in exprs
    ]


@dataclass(frozen=True, eq=False)
class _Test:
    """The true system over its test span: ``x`` (n, k) at ``t`` (n,)."""

    system: System
    engine: AbstractEngine
    t: np.ndarray
    x: np.ndarray

    @classmethod
    def of(cls, system: System, engine: AbstractEngine) -> _Test:
        start, end = system.test
        t = system.times(system.test, (end - start) / (COMPARED_TIMES - 1))
        truth = engine.integrate(
            InitialValueProblem(system.closed_rhs(), system.states, np.array(system.x0), t)
        )
        if not truth.success:
            raise EngineError(f"{system.name} itself has no solution over {start:g} to {end:g} s")
        return cls(system, engine, t, truth.x)

    def trajectory_losses(
        self,
        exprs: Sequence[sympy.Expr],
        target: str,
        start: Sequence[float] | None = None,
        states: Sequence[str] | None = None,
    ) -> list[float]:
        columns = [self.system.index(state) for state in states or self.system.states]
        x0 = np.array(self.system.x0 if start is None else start)
        losses = []
        for first in range(0, len(exprs), _AT_ONCE):
            altered = [self.system.with_rhs(target, e) for e in exprs[first : first + _AT_ONCE]]
            problems = [
                InitialValueProblem(one.closed_rhs(), one.states, x0, self.t, max_steps=MAX_STEPS)
                for one in altered
            ]
            losses += [
                self.distance(found.x, columns) for found in self.engine.integrate_all(problems)
            ]
        return losses

    def distance(self, found: np.ndarray, columns: Sequence[int]) -> float:
        with np.errstate(all="ignore"):
            gaps = found[:, columns] - self.x[:, columns]
            loss = float(np.sqrt(np.mean(np.sum(gaps * gaps, axis=1))))
        return loss if math.isfinite(loss) else math.inf

    def equation_rmse(self, expr: sympy.Expr, target: str) -> float:
        altered = self.system.with_rhs(target, expr)
        at = self.system.index(target)
        names = [*self.system.states, "t"]
        values = np.vstack([self.x.T, self.t])
        found = compile_numpy([altered.closed_rhs()[at]], names)(values)
        true = compile_numpy([self.system.closed_rhs()[at]], names)(values)
        with np.errstate(all="ignore"):
            rmse = float(np.sqrt(np.mean((found - true) ** 2)))
        return rmse if math.isfinite(rmse) else math.inf
