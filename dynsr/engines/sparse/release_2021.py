"""Sparse regression as DataDrivenDiffEq.jl 0.5 did it in spring 2021, when the paper was written.

SR3 and ADMM with their least-squares start, fixed thresholds on normalised coefficients and stop
at machine precision, and the implicit search over every left-hand side (SINDy-PI, Kaheman et al.
2020). The stop asks that a step move less than 2.2e-16 in absolute terms, so the exact count at
which it happens depends on the rounding of the linear algebra underneath; the answer does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynsr.engines.base import SparseSolution
from dynsr.engines.sparse.iteration import (
    EPSILON,
    AbstractIteration,
    Stack,
    distances,
    relations,
    run,
    shrink,
)


@dataclass(frozen=True)
class SR3:
    """Sparse relaxed regularised regression with an L1 penalty (Zheng et al. 2018).

    X = (A'A + I/nu)^-1 (A'y + W/nu), then W = soft(X, tau nu lambda), with
    tau = sqrt(2 lambda / nu). The answer is X, its entries below tau set to zero. ``weight`` is
    lambda.
    """

    weight: float
    nu: float

    @property
    def threshold(self) -> float:
        """tau: coefficients of smaller magnitude become zero."""
        return float(np.sqrt(2 * self.weight / self.nu))

    def begin(self, stack: Stack) -> AbstractIteration:
        """Give the iteration at its start."""
        return _SR3Iteration(self, stack)


@dataclass(frozen=True)
class ADMM:
    """Lasso by the alternating direction method of multipliers (Boyd et al. 2011).

    x = (A'A + rho I)^-1 (A'y + rho X - u), X = soft(x + u/rho, tau), u += rho (x - X), with
    tau = lambda / rho. The answer is X, its entries below tau set to zero. ``weight`` is lambda.
    """

    weight: float
    rho: float

    @property
    def threshold(self) -> float:
        """tau: coefficients of smaller magnitude become zero."""
        return self.weight / self.rho

    def begin(self, stack: Stack) -> AbstractIteration:
        """Give the iteration at its start."""
        return _ADMMIteration(self, stack)


class _SR3Iteration(AbstractIteration):
    arrays = ("x", "w", "right", "new", "work")

    def __init__(self, settings: SR3, stack: Stack) -> None:
        self.nu = settings.nu
        self.width = settings.threshold * settings.nu * settings.weight
        self.resolvent = stack.resolvent(1 / settings.nu)
        self.right = stack.correlation
        self.w = stack.start()
        self.x, self.new, self.work = (np.empty_like(self.w) for _ in range(3))

    def advance(self) -> np.ndarray:
        # P (A'y + W/nu), not P A'y + P W/nu: the rounding of the latter keeps the steps above the
        # stop a little longer.
        w = self.w if self.nu == 1 else np.divide(self.w, self.nu, out=self.new)
        np.add(w, self.right, out=self.new)
        self.resolvent.apply(self.new, self.x)
        shrink(self.x, self.width, self.new, self.work)
        self.w, self.new = self.new, self.w
        return distances(self.new, self.w, self.work) / self.nu < EPSILON


class _ADMMIteration(AbstractIteration):
    arrays = ("x", "u", "fixed", "inner", "shifted", "new", "work")

    def __init__(self, settings: ADMM, stack: Stack) -> None:
        self.rho, self.width = settings.rho, settings.threshold
        self.resolvent = stack.resolvent(settings.rho)
        self.x = stack.start()
        self.u = np.zeros_like(self.x)
        self.inner, self.shifted, self.new, self.work, self.fixed = (
            np.empty_like(self.x) for _ in range(5)
        )
        self.resolvent.apply(stack.correlation, self.fixed)

    def advance(self) -> np.ndarray:
        np.multiply(self.x, self.rho, out=self.new)
        np.subtract(self.new, self.u, out=self.new)
        self.resolvent.apply(self.new, self.inner)
        np.add(self.inner, self.fixed, out=self.inner)
        np.divide(self.u, self.rho, out=self.shifted)
        np.add(self.shifted, self.inner, out=self.shifted)
        shrink(self.shifted, self.width, self.new, self.work)
        np.subtract(self.inner, self.new, out=self.inner)
        np.multiply(self.inner, self.rho, out=self.inner)
        np.add(self.u, self.inner, out=self.u)
        self.x, self.new = self.new, self.x
        return distances(self.new, self.x, self.work) < EPSILON


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A relation q with D'q near zero, from one left-hand side and one optimizer."""

    relation: np.ndarray
    iterations: int
    converged: bool
    skipped: bool


def solve_explicit(
    theta: np.ndarray, dx: np.ndarray, optimizer: SR3 | ADMM, normalize: bool, cap: int
) -> SparseSolution:
    """Regress dx (m,) on theta (p, m)."""
    coefficients, counts, converged = _solve(Stack.explicit(theta, dx), optimizer, normalize, cap)
    return SparseSolution(coefficients[0], int(counts[0]), bool(converged[0]))


def solve_implicit(
    theta: np.ndarray,
    dx: np.ndarray,
    optimizers: Sequence[SR3 | ADMM],
    normalize: bool,
    cap: int,
    corrected: bool,
) -> SparseSolution:
    """Search q with ``[dx theta; theta]' q = 0``, trying every row and optimizer in turn.

    ``corrected`` chooses the best candidate of all; otherwise the choice of 2021 is repeated.
    """
    stack = Stack.leave_one_out(np.vstack([dx * theta, theta]), -1.0)
    solved = []
    for optimizer in optimizers:
        coefficients, counts, converged = _solve(stack, optimizer, normalize, cap)
        solved.append((relations(stack, coefficients, 1.0), counts, converged))
    p = len(theta)
    candidates = [
        _Candidate(
            q[j], int(counts[j]), bool(converged[j]), not (q[j, :p].any() and q[j, p:].any())
        )
        for j in range(2 * p)
        for q, counts, converged in solved
    ]
    choose = _choose_best if corrected else _choose_2021
    return choose(candidates, stack.short_rows)


def _solve(
    stack: Stack, optimizer: SR3 | ADMM, normalize: bool, cap: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    scale = stack.norms if normalize else np.ones(len(stack.rows))
    x, counts, converged = run(optimizer.begin(stack.scaled(scale)), cap)
    return np.where(np.abs(x) < optimizer.threshold, 0.0, x) / scale, counts, converged


def _score(relation: np.ndarray, rows: np.ndarray) -> float:
    return float(np.hypot(np.count_nonzero(relation), np.linalg.norm(relation @ rows)))


def _unit(relation: np.ndarray) -> np.ndarray:
    return relation / np.abs(relation).max()


def _empty(rows: np.ndarray) -> SparseSolution:
    return SparseSolution(np.zeros(len(rows)), None, False)


def _choose_2021(candidates: Sequence[_Candidate], rows: np.ndarray) -> SparseSolution:
    """Choose as the release did.

    The incumbent starts as the zero vector, which nothing beats except that the first candidate
    is taken without asking. A candidate is compared at its own scale, the incumbent at largest
    magnitude one. The iterations reported are the fewest of all that were ever accepted.
    """
    best, bound, accepted = None, 0.0, []
    for position, candidate in enumerate(candidates):
        if candidate.skipped:
            continue
        if position == 0 or _score(candidate.relation, rows) < bound:
            best = _unit(candidate.relation)
            bound = _score(best, rows)
            accepted.append(candidate)
    if best is None:
        return _empty(rows)
    fewest = min(c.iterations for c in accepted)
    return SparseSolution(best, fewest, accepted[-1].converged)


def _choose_best(candidates: Sequence[_Candidate], rows: np.ndarray) -> SparseSolution:
    """Choose the lowest score, every candidate at largest magnitude one; the first of equals."""
    scored = [(_score(_unit(c.relation), rows), c) for c in candidates if not c.skipped]
    if not scored:
        return _empty(rows)
    best = min(scored, key=lambda pair: pair[0])[1]
    return SparseSolution(_unit(best.relation), best.iterations, best.converged)
