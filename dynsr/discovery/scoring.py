"""Scoring: how far an equation that was found is from the true one, measured in three ways.

- **equation RMSE**, the formula of the paper's text: root mean square of f_hat(x) - f(x) along the
  true states of the test span, for the target alone (Weilbach et al. 2021, section 4.1).
- **printed loss**, what the paper's tables really hold (decoded from its printed expressions):
  the true system and the one with the equation replaced are integrated over the test span from
  the start x0 placed at its first time, and loss = sqrt(mean over t of the sum over states d in D
  of (x_hat_d - x_d)^2). D is all states for SINDy and the first two for every other method; the
  altered pendulum starts at (0.3, 0), the truth at x0.
- **trajectory loss**, the corrected one: the same with D all states, and both from x0.

Both integrations take Tsit5 at its default tolerances and are compared at 5001 times. A solution
that diverges, leaves its domain or needs more than 10 000 steps (the true ones of the paper need
18 to 34) has loss infinity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
import sympy

from dynsr.data import System
from dynsr.engines import AbstractEngine, InitialValueProblem, find_engine
from dynsr.errors import EngineError
from dynsr.expression import compile_numpy, parse, to_text

COMPARED_TIMES = 5001
MAX_STEPS = 10_000
# Evidently the first two of the cart-pole's own start, copied.
PRINTED_STARTS: dict[str, tuple[float, ...]] = {"pendulum": (0.3, 0.0)}
_AT_ONCE = 256


@dataclass(frozen=True)
class Losses:
    """The three losses of one equation; infinity where it has no value or diverges."""

    equation_rmse: float
    printed_loss: float
    trajectory_loss: float


_LOSSES = tuple(f.name for f in fields(Losses))


@dataclass(frozen=True)
class Score:
    """One equation that a method found, with its three losses (state units, or those per second).

    ``expr`` is the right-hand side found for ``target``; ``seconds`` the time the search took;
    ``origin`` says where the numbers come from (engine and versions).
    """

    system: str
    method: str
    seed: int | None
    target: str
    expr: sympy.Expr
    equation_rmse: float
    printed_loss: float
    trajectory_loss: float
    seconds: float = math.nan
    origin: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Give the parts as JSON can hold them: the expression as text, infinity as None."""
        record = {**asdict(self), "expr": to_text(self.expr), "origin": dict(self.origin)}
        for name in (*_LOSSES, "seconds"):
            record[name] = record[name] if math.isfinite(record[name]) else None
        return record

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> Score:
        """Read back what :meth:`as_dict` gave."""
        known = {f.name: record[f.name] for f in fields(cls) if f.name in record}
        for name in _LOSSES:
            known[name] = math.inf if known[name] is None else float(known[name])
        if known.get("seconds") is None:
            known["seconds"] = math.nan
        return cls(**{**known, "expr": parse(known["expr"])})


def equation_rmse(
    system: System,
    expr: sympy.Expr,
    target: str | None = None,
    engine: str | AbstractEngine = "embedded",
) -> float:
    """Root mean square of f_hat(x) - f(x) along the true states of the test span.

    ``expr`` may use the states, the inputs and ``t``. Infinity where it has no value. Raises
    InputError for an unknown name or target.

    >>> from dynsr.data.system import PENDULUM
    >>> round(equation_rmse(PENDULUM, parse("-9.81*sin(theta1) - 0.1*theta2 + 0.25")), 12)
    0.25
    """
    return _Test.of(system, find_engine(engine)).equation_rmse(expr, target or system.target)


def trajectory_loss(
    system: System,
    expr: sympy.Expr,
    target: str | None = None,
    engine: str | AbstractEngine = "embedded",
) -> float:
    """Corrected loss: sqrt(mean over t of sum over all states of (x_hat - x)^2), both from x0.

    Infinity when the altered system diverges. Raises InputError for an unknown name or target.

    >>> from dynsr.data.system import LOTKA_VOLTERRA
    >>> trajectory_loss(LOTKA_VOLTERRA, parse("-y*(3 - x)"))
    0.0
    """
    test = _Test.of(system, find_engine(engine))
    altered = system.with_rhs(target or system.target, expr)
    return test.distance(test.integrate([(altered, system.x0)])[0], system.states)


def printed_loss(
    system: System,
    expr: sympy.Expr,
    method: str,
    target: str | None = None,
    engine: str | AbstractEngine = "embedded",
) -> float:
    """Loss as the paper's tables were really made for ``method`` (see the module's text).

    Infinity when the altered system diverges. Raises InputError for an unknown name or target.

    >>> from dynsr.data.system import CART_POLE
    >>> round(printed_loss(CART_POLE, parse("-2*w"), "GA"), 5)
    0.41711
    """
    test = _Test.of(system, find_engine(engine))
    altered = system.with_rhs(target or system.target, expr)
    found = test.integrate([(altered, printed_start(system))])[0]
    return test.distance(found, compared_states(system, method))


def score_model(
    system: System,
    expr: sympy.Expr,
    method: str,
    engine: str | AbstractEngine = "embedded",
    target: str | None = None,
) -> Losses:
    """Give the three losses of one equation; the system is integrated once for all of them.

    Raises InputError for an unknown name or target, EngineError when the true system itself has
    no solution over its test span.
    """
    return _Test.of(system, find_engine(engine)).losses([expr], target or system.target, method)[0]


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
    """Score many equations of one target at once; the three losses of each, in order.

    Equal expressions are integrated once. Raises InputError for an unknown name or target, and
    EngineError when the true system itself has no solution over its test span.

    >>> from dynsr.data.system import PENDULUM
    >>> score_expressions(PENDULUM, [parse("-10*sin(theta1)")], "sindy")[0].trajectory_loss < 1.5
    True
    """
    chosen, target = find_engine(engine), target or system.target
    test = _Test.of(system, chosen)
    origin = {"engine": chosen.name, "versions": chosen.versions()}
    distinct = list(dict.fromkeys(exprs))
    losses: dict[sympy.Expr, Losses] = {}
    for first in range(0, len(distinct), _AT_ONCE):
        some = distinct[first : first + _AT_ONCE]
        losses.update(zip(some, test.losses(some, target, method), strict=True))
    return [
        Score(
            system.name,
            method,
            seed,
            target,
            expr,
            **asdict(losses[expr]),
            seconds=seconds,
            origin=origin,
        )
        for expr in exprs
    ]


def printed_start(system: System) -> tuple[float, ...]:
    """Start of the altered system in the paper's protocol."""
    return PRINTED_STARTS.get(system.name, system.x0)


def compared_states(system: System, method: str) -> tuple[str, ...]:
    """States whose distances the paper's tables add up for ``method``."""
    return system.states if "sindy" in method.lower() else system.states[:2]


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

    def integrate(self, altered: Sequence[tuple[System, Sequence[float]]]) -> list[np.ndarray]:
        problems = [
            InitialValueProblem(
                one.closed_rhs(), one.states, np.array(x0), self.t, max_steps=MAX_STEPS
            )
            for one, x0 in altered
        ]
        return [found.x for found in self.engine.integrate_all(problems)]

    def losses(self, exprs: Sequence[sympy.Expr], target: str, method: str) -> list[Losses]:
        """Three losses of each; one integration for two of them where both have the same start."""
        altered = [self.system.with_rhs(target, expr) for expr in exprs]
        right = self.integrate([(one, self.system.x0) for one in altered])
        start, compared = printed_start(self.system), compared_states(self.system, method)
        same = start == self.system.x0
        wrong = right if same else self.integrate([(one, start) for one in altered])
        return [
            Losses(
                self.equation_rmse(expr, target),
                self.distance(as_printed, compared),
                self.distance(corrected, self.system.states),
            )
            for expr, as_printed, corrected in zip(exprs, wrong, right, strict=True)
        ]

    def distance(self, found: np.ndarray, states: Sequence[str]) -> float:
        columns = [self.system.index(state) for state in states]
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
