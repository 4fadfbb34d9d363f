"""The search of DataDrivenSparse.jl as it is today: a path of thresholds, and left-hand sides.

Of several thresholds, tried in ascending order and each started from the one before, the solution
of lowest BIC is kept; of the left-hand sides of an implicit problem, the relation of lowest AICc.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynsr.engines.base import SparseSolution
from dynsr.engines.iteration import relations
from dynsr.engines.sparse_current import Algorithm, Iteration
from dynsr.engines.stack import Stack


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

    Only relations with two terms or more beside the left-hand side, one of them of the
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
            counts[done], converged[done] = step, live.settled()[stopped]
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
