"""Sparse regression as DataDrivenSparse.jl does it today.

The optimizers SR3, ADMM and STLSQ; the path of thresholds; the search over left-hand sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from dynsr.engines.base import SparseSolution
from dynsr.engines.sparse.iteration import (
    EPSILON,
    AbstractIteration,
    Resolvent,
    Stack,
    distances,
    least_squares,
    relations,
    shrink,
)

TOLERANCE = float(np.sqrt(EPSILON))
PRIMAL_TOLERANCE = 1e-4


@dataclass(frozen=True)
class SR3:
    """X = prox((A'A + nu I)^-1 (A'y + nu X)); the answer is X with its exact zeros.

    The hard threshold t keeps entries above t (lambda = t^2 / 2); the soft one shrinks by t.
    """

    nu: float
    soft: bool

    def begin(self, stack: Stack, threshold: float) -> Iteration:
        """Give the iteration at its start, the ridge solution."""
        return _SR3Iteration(self, stack, threshold)

    def active(self, x: np.ndarray, threshold: float) -> np.ndarray:
        """Say which coefficients count as terms."""
        return np.abs(x) > threshold


@dataclass(frozen=True)
class ADMM:
    """X = (A'A + rho I)^-1 (A'y + rho (a - w)), a = soft(X + w, t / rho), w += X - a."""

    rho: float

    def begin(self, stack: Stack, threshold: float) -> Iteration:
        """Give the iteration at its start, the ridge solution."""
        return _ADMMIteration(self, stack, threshold)

    def active(self, x: np.ndarray, threshold: float) -> np.ndarray:
        """Say which coefficients count as terms."""
        return np.abs(x) > threshold / self.rho


@dataclass(frozen=True)
class STLSQ:
    """Least squares (ridge when rho > 0) on the coefficients above the threshold, repeated."""

    rho: float

    def begin(self, stack: Stack, threshold: float) -> Iteration:
        """Give the iteration at its start, least squares or ridge on all rows."""
        return _STLSQIteration(self, stack, threshold)

    def active(self, x: np.ndarray, threshold: float) -> np.ndarray:
        """Say which coefficients count as terms."""
        return np.abs(x) > threshold


Algorithm = SR3 | ADMM | STLSQ


class Iteration(AbstractIteration):
    """An iteration at one ``threshold`` that can be copied in part and written back."""

    threshold: float
    algorithm: Algorithm
    previous: np.ndarray
    work: np.ndarray

    def part(self, problems: np.ndarray) -> Iteration:
        """Give a copy of some of the problems."""
        out = copy(self)
        out.select(problems)
        return out

    def write(self, problems: np.ndarray, part: Iteration, which: np.ndarray) -> None:
        """Take over problems ``which`` of a part as mine."""
        for name in self.arrays:
            getattr(self, name)[problems] = getattr(part, name)[which]

    def stops(self) -> np.ndarray:
        """Say which problems moved so little, or have so little left, that they stop."""
        moved = distances(self.x, self.previous, self.work)
        size = np.linalg.norm(self.x, axis=1)
        idle = ~self.algorithm.active(self.x, self.threshold).any(axis=1)
        return idle | (moved < TOLERANCE) | (moved < TOLERANCE * size)

    def converged(self) -> np.ndarray:
        """Say which problems are at a solution, given that they stopped."""
        return np.ones(len(self.x), dtype=bool)


class _SR3Iteration(Iteration):
    arrays = ("x", "previous", "right", "work", "inner")

    def __init__(self, algorithm: SR3, stack: Stack, threshold: float) -> None:
        self.threshold = threshold
        self.algorithm, self.nu, self.soft = algorithm, algorithm.nu, algorithm.soft
        self.resolvent = stack.resolvent(algorithm.nu)
        self.right = stack.correlation
        self.x, self.previous, self.work, self.inner = (np.empty_like(self.right) for _ in range(4))
        self.resolvent.apply(self.right, self.x)

    def advance(self) -> np.ndarray:
        self.x, self.previous = self.previous, self.x
        np.multiply(self.previous, self.nu, out=self.inner)
        np.add(self.inner, self.right, out=self.inner)
        self.resolvent.apply(self.inner, self.x)
        if self.soft:
            shrink(self.x, self.threshold, self.x, self.work)
        else:
            self.x[np.abs(self.x) <= self.threshold] = 0.0
        return self.stops()


class _ADMMIteration(Iteration):
    arrays = ("x", "previous", "right", "work", "alpha", "dual", "gap")

    def __init__(self, algorithm: ADMM, stack: Stack, threshold: float) -> None:
        self.threshold = threshold
        self.algorithm, self.rho = algorithm, algorithm.rho
        self.resolvent = stack.resolvent(algorithm.rho)
        self.right = stack.correlation
        self.x, self.previous, self.work = (np.empty_like(self.right) for _ in range(3))
        self.alpha, self.dual, self.gap = (np.zeros_like(self.right) for _ in range(3))
        if stack.rows.shape[0] > stack.rows.shape[1]:
            self.x = stack.start()
        else:
            self.resolvent.apply(self.right, self.x)

    def advance(self) -> np.ndarray:
        self.x, self.previous = self.previous, self.x
        vectors = self.right + self.rho * (self.alpha - self.dual)
        self.resolvent.apply(vectors, self.x)
        np.add(self.x, self.dual, out=vectors)
        shrink(vectors, self.threshold / self.rho, self.alpha, self.work)
        np.subtract(self.x, self.alpha, out=self.gap)
        np.add(self.dual, self.gap, out=self.dual)
        self.x[~self.algorithm.active(self.x, self.threshold)] = 0.0
        return self.stops()

    def converged(self) -> np.ndarray:
        size = np.maximum(np.linalg.norm(self.x, axis=1), np.linalg.norm(self.alpha, axis=1))
        return np.linalg.norm(self.gap, axis=1) <= PRIMAL_TOLERANCE * size


class _STLSQIteration(Iteration):
    arrays = ("x", "previous", "work", "targets", "right", "support")

    def __init__(self, algorithm: STLSQ, stack: Stack, threshold: float) -> None:
        self.threshold = threshold
        self.algorithm, self.stack = algorithm, stack
        self.resolvent = Resolvent(np.empty((0, 0)), None)
        # The ridge term is dropped where there are more functions than samples.
        skinny = stack.rows.shape[0] <= stack.rows.shape[1]
        self.ridge = algorithm.rho if skinny else 0.0
        self.targets, self.right = stack.short_targets, stack.correlation
        self.x, self.previous = np.zeros_like(self.right), np.zeros_like(self.right)
        self.work = np.empty_like(self.right)
        for k in range(len(self.x)):
            self._fit(k, stack.regressors(k))
        self.support = algorithm.active(self.x, threshold)

    def _fit(self, problem: int, use: np.ndarray) -> None:
        if self.ridge > 0:
            gram = self.stack.gram[np.ix_(use, use)] + self.ridge * np.eye(len(use))
            self.x[problem, use] = np.linalg.solve(gram, self.right[problem, use])
        else:
            rows = self.stack.short_rows[use]
            self.x[problem, use] = least_squares(rows, self.targets[problem])

    def advance(self) -> np.ndarray:
        self.previous[:] = self.x
        for k, use in enumerate(self.support):
            self._fit(k, np.flatnonzero(use))
        self.support = self.algorithm.active(self.x, self.threshold)
        self.x[~self.support] = 0.0
        return self.stops()


@dataclass(eq=False)
class _Best:
    """The solution kept for each of k problems: coefficients, terms, and their criterion."""

    x: np.ndarray
    terms: np.ndarray
    bic: np.ndarray

    def offer(
        self, problems: np.ndarray, x: np.ndarray, terms: np.ndarray, bic: np.ndarray
    ) -> None:
        """Take over what has a criterion no higher than mine."""
        better = bic <= self.bic[problems]
        chosen = problems[better]
        self.x[chosen], self.terms[chosen] = x[better], terms[better]
        self.bic[chosen] = bic[better]


def solve_explicit(
    theta: np.ndarray, dx: np.ndarray, algorithm: Algorithm, thresholds: Sequence[float], cap: int
) -> SparseSolution:
    """Regress dx (m,) on theta (p, m); of several thresholds the lowest BIC is kept."""
    best, counts, converged = _solve(Stack.explicit(theta, dx), algorithm, thresholds, cap)
    return SparseSolution(best.x[0], int(counts[0]), bool(converged[0]))


def solve_implicit(
    theta: np.ndarray, dx: np.ndarray, algorithm: Algorithm, thresholds: Sequence[float], cap: int
) -> SparseSolution:
    """Search q with ``[dx theta; theta]' q = 0``: of all left-hand sides the lowest AICc.

    Only relations with two terms or more in addition to the left-hand side, one of them of the
    denominator, are candidates. The left-hand side has coefficient -1.
    """
    stack = Stack.leave_one_out(np.vstack([dx * theta, theta]), 1.0)
    best, counts, converged = _solve(stack, algorithm, thresholds, cap)
    allowed = (best.terms >= 2) & best.x[:, : len(theta)].any(axis=1)
    if not allowed.any():
        return SparseSolution(np.zeros(2 * len(theta)), None, False)
    aicc = np.where(allowed, _aicc(_residual(stack, best.x), best.terms, len(dx)), np.inf)
    winner = int(np.flatnonzero(allowed)[np.argmin(aicc[allowed])])
    relation = relations(stack, best.x, -1.0)[winner]
    return SparseSolution(relation, int(counts[winner]), bool(converged[winner]))


def _solve(
    stack: Stack, algorithm: Algorithm, thresholds: Sequence[float], cap: int
) -> tuple[_Best, np.ndarray, np.ndarray]:
    ascending = sorted(thresholds)
    state = algorithm.begin(stack, ascending[0])
    count, samples = len(state.x), stack.rows.shape[1]
    best: _Best | None = None
    counts = np.zeros(count, dtype=int)
    for threshold in ascending:
        steps, converged = _run_threshold(state, threshold, cap, best, stack)
        counts += steps
        if best is None:
            # During the first threshold every iterate replaces the one before.
            terms = algorithm.active(state.x, threshold).sum(axis=1)
            best = _Best(state.x.copy(), terms, _bic(_residual(stack, state.x), terms, samples))
    assert best is not None
    return best, counts, converged


def _run_threshold(
    state: Iteration, threshold: float, cap: int, best: _Best | None, stack: Stack
) -> tuple[np.ndarray, np.ndarray]:
    """Bring every problem to its stop at one threshold; give step counts and convergence."""
    state.threshold = threshold
    active = np.arange(len(state.x))
    counts, converged = np.full(len(active), cap), np.zeros(len(active), dtype=bool)
    live = state.part(active)
    for step in range(1, cap + 1):
        stopped = live.advance()
        if best is not None:
            terms = live.algorithm.active(live.x, threshold).sum(axis=1)
            rss = _residual(stack, live.x, active)
            best.offer(active, live.x, terms, _bic(rss, terms, stack.rows.shape[1]))
        if stopped.any():
            done = active[stopped]
            counts[done], converged[done] = step, live.converged()[stopped]
            state.write(done, live, stopped)
            active = active[~stopped]
            if not active.size:
                return counts, converged
            live.select(np.flatnonzero(~stopped))
    state.write(active, live, np.ones(len(active), dtype=bool))
    return counts, converged


def _residual(stack: Stack, x: np.ndarray, problems: np.ndarray | None = None) -> np.ndarray:
    targets = stack.short_targets if problems is None else stack.short_targets[problems]
    return np.sum((x @ stack.short_rows - targets) ** 2, axis=1)


def _deviance(rss: np.ndarray, samples: int) -> np.ndarray:
    """Minus twice the log likelihood, without its constant; -inf for an exact fit."""
    with np.errstate(divide="ignore"):
        return samples * np.log(rss / samples)


def _bic(rss: np.ndarray, terms: np.ndarray, samples: int) -> np.ndarray:
    return _deviance(rss, samples) + terms * np.log(samples)


def _aicc(rss: np.ndarray, terms: np.ndarray, samples: int) -> np.ndarray:
    with np.errstate(divide="ignore"):
        small = 2.0 * terms * (terms + 1) / np.float64(samples - terms - 1)
    return _deviance(rss, samples) + 2 * terms + small
