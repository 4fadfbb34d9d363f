"""What a searched function f is fitted to: T(y) = b_1 g_1(x) + ... + b_q g_q(x) + c h(f(x)).

Three kinds of problem share one bank of functions:

* affine: y, or a domain change of it, is c f + d;
* power law: y = C x_1^a_1 ... x_p^a_p f^b, linear in the logarithms, so that the exponents and C
  of every f come in closed form;
* exponential: y = C x_1^a_1 ... x_p^a_p exp(b f), likewise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.methods.feynman.domain import CHANGES, Target, make_targets


@dataclass(frozen=True, eq=False)
class Problem:
    """One linear problem.

    ``target`` holds T(y) at all rows; ``powers`` are the numbers of the variables whose logarithms
    are in the background beside the constant, and ``logs`` (n, k) those logarithms; ``by_log``
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
