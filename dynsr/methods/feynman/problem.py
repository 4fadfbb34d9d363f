"""What a searched function f is fitted to: T(y) = b_1 g_1(x) + ... + b_q g_q(x) + c h(f(x)).

T is a change of the target: search for T(y) instead of y, and come back by the inverse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.errors import InputError
from dynsr.expression import OPERATORS

Values = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Change:
    """T(y) with its inverse: ``forward`` and ``back`` are tokens of OPERATORS.

    ``valid`` says whether T undoes ``back`` on the whole range of y; ``slope`` is dT/dy.
    ``mirrored`` changes may be applied to -y where y is negative throughout.
    """

    name: str
    forward: str
    back: str
    valid: Callable[[np.ndarray], bool]
    slope: Values
    mirrored: bool = False


def _inside(low: float, high: float) -> Callable[[np.ndarray], bool]:
    return lambda y: bool(y.min() >= low and y.max() <= high)


def _positive(y: np.ndarray) -> bool:
    return bool(y.min() > 1e-9 * np.abs(y).max())


def _nonzero(y: np.ndarray) -> bool:
    return bool(np.abs(y).min() > 1e-6 * np.abs(y).max())


_HALF = np.pi / 2
_ROUND = 1 - 1e-9
CHANGES = {
    change.name: change
    for change in (
        Change("y", "identity", "identity", lambda y: True, np.ones_like),
        Change("inv", "inv", "inv", _nonzero, lambda y: 1 / y**2),
        Change("square", "square", "sqrt", _positive, lambda y: 2 * y, True),
        Change("sqrt", "sqrt", "square", _positive, lambda y: 0.5 / np.sqrt(y), True),
        Change("log", "log", "exp", _positive, lambda y: 1 / y, True),
        Change("exp", "exp", "log", _inside(-20, 20), np.exp),
        Change("sin", "sin", "asin", _inside(-_HALF, _HALF), np.cos),
        Change("cos", "cos", "acos", _inside(0, np.pi), np.sin),
        Change(
            "tan", "tan", "atan", _inside(-_HALF * 0.99, _HALF * 0.99), lambda y: np.cos(y) ** -2
        ),
        Change("asin", "asin", "sin", _inside(-_ROUND, _ROUND), lambda y: (1 - y * y) ** -0.5),
        Change("acos", "acos", "cos", _inside(-_ROUND, _ROUND), lambda y: (1 - y * y) ** -0.5),
        Change("atan", "atan", "tan", _inside(-1e6, 1e6), lambda y: 1 / (1 + y * y)),
    )
}


@dataclass(frozen=True, eq=False)
class Target:
    """One changed target: ``values`` = T(sign * y / factor), and the way back to y.

    ``factor`` is 1 or a variable's values, ``symbol`` the same written.
    """

    change: Change
    sign: float
    values: np.ndarray
    weights: np.ndarray
    factor: np.ndarray | float = 1.0
    symbol: sympy.Expr = sympy.S.One

    @property
    def name(self) -> str:
        """The change's name, with the variable that y was divided by."""
        return self.change.name if self.symbol == 1 else f"{self.change.name} of y/{self.symbol}"

    def invert(self, predicted: np.ndarray) -> np.ndarray:
        """Turn predictions of T(y) into predictions of y; NaN where the inverse is undefined."""
        with np.errstate(all="ignore"):
            return self.factor * self.sign * OPERATORS[self.change.back].numpy(predicted)

    def build(self, expr: sympy.Expr) -> sympy.Expr:
        """Turn a formula for T(y) into one for y."""
        inner = OPERATORS[self.change.back].sympy(expr)
        return self.symbol * (-inner if self.sign < 0 else inner)


def make_targets(
    y: np.ndarray,
    names: Sequence[str],
    factor: np.ndarray | float = 1.0,
    symbol: sympy.Expr = sympy.S.One,
) -> list[Target]:
    """Give the changes of ``y / factor`` that can be undone on its range, the identity first.

    ``weights`` of a target are 1 / |dT/dy|: least squares of T(y) with them is least squares of y
    to first order. ``symbol`` is the factor written. Raises InputError for an unknown name.

    >>> [t.change.name for t in make_targets(np.array([1.0, 2.0, 4.0]), ["log", "asin"])]
    ['y', 'log']
    """
    targets = []
    y = y / factor
    for name in dict.fromkeys(("y", *names)):
        if name not in CHANGES:
            raise InputError(f"unknown domain change {name!r}; they are: {', '.join(CHANGES)}")
        change = CHANGES[name]
        sign = -1.0 if change.mirrored and y.max() < 0 else 1.0
        if not change.valid(sign * y):
            continue
        with np.errstate(all="ignore"):
            values = OPERATORS[change.forward].numpy(sign * y)
            slopes = np.abs(change.slope(sign * y))
        if np.all(np.isfinite(values)) and np.ptp(values) > 0:
            weights = 1 / np.maximum(slopes, 1e-6 * slopes.max())
            weights = weights * np.abs(factor)
            targets.append(Target(change, sign, values, weights, factor, symbol))
    return targets


@dataclass(frozen=True, eq=False)
class Problem:
    """One linear problem.

    ``target`` holds T(y) at all rows; ``powers`` are the numbers of the variables whose logarithms
    are in the background with the constant, and ``logs`` (n, k) those logarithms; ``by_log``
    says that log |f| is fitted instead of f.
    """

    name: str
    target: Target
    powers: tuple[int, ...]
    logs: np.ndarray
    by_log: bool

    @property
    def background(self) -> np.ndarray:
        """(n, 1 + k) the constant 1 and the logarithms."""
        return np.column_stack([np.ones(len(self.logs)), self.logs])

    def feature(self, values: np.ndarray) -> np.ndarray:
        """Give h(f): f or log |f|."""
        if not self.by_log:
            return values
        with np.errstate(all="ignore"):
            return np.log(np.abs(values))


def make_problems(
    X: np.ndarray,
    y: np.ndarray,
    changes: Sequence[str],
    monomials: bool,
    ratios: Sequence[sympy.Expr] = (),
) -> list[Problem]:
    """Give the problems of y: one for each domain change that fits its range, then the monomials'.

    ``ratios`` are the names of the columns of X when y / v and v / y are wanted too. Power
    laws and exponentials need a target that is nowhere 0.

    >>> x = np.linspace(1.0, 2.0, 5)[:, None]
    >>> [p.name for p in make_problems(x, np.exp(x[:, 0]), ["log"], True)]
    ['y', 'log', 'power law', 'exponential']
    """
    none = np.empty((len(y), 0))
    targets = make_targets(y, changes)
    for column, symbol in zip(X.T, ratios, strict=False):
        if has_logarithm(column):
            targets += make_targets(y, ("inv",), column, symbol)
    targets = [t for t in targets if not _ruled_by_few(t.values)]
    problems = [Problem(t.name, t, (), none, False) for t in targets]
    size = np.abs(y)
    if not monomials or size.min() <= 1e-9 * size.max():
        return problems
    logarithm = Target(CHANGES["log"], 1.0, np.log(size), size)
    if np.ptp(logarithm.values) == 0:
        return problems
    powers = tuple(j for j in range(X.shape[1]) if has_logarithm(X[:, j]))
    logs = np.log(np.abs(X[:, powers]))
    problems.append(Problem("power law", logarithm, powers, logs, True))
    problems.append(Problem("exponential", logarithm, powers, logs, False))
    return problems


def _ruled_by_few(values: np.ndarray) -> bool:
    """Whether one row holds most of the spread, so that any function with a pole there fits."""
    spread = (values - values.mean()) ** 2
    return bool(len(values) > 4 and spread.max() > 0.5 * spread.sum())


def has_logarithm(column: np.ndarray) -> bool:
    """Whether a variable is nowhere 0 and not constant."""
    size = np.abs(column)
    return bool(size.min() > 1e-9 * size.max() and np.ptp(size) > 1e-9 * size.max())
