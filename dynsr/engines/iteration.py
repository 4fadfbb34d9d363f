"""Run an iteration on every problem of a stack at once, and freeze each when it stops."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from dynsr.engines.stack import Resolvent, Stack


class AbstractIteration(ABC):
    """The state of k problems under way. ``x`` (k, n) is what would be the answer now.

    ``arrays`` names every (k, n) array of the state, so that problems can be dropped.
    """

    x: np.ndarray
    resolvent: Resolvent
    arrays: tuple[str, ...]

    @abstractmethod
    def advance(self) -> np.ndarray:
        """Take one step and give the (k,) booleans that say which problems stop here."""

    def select(self, problems: np.ndarray) -> None:
        """Go on with some of the problems."""
        self.resolvent = self.resolvent.select(problems)
        for name in self.arrays:
            setattr(self, name, getattr(self, name)[problems])


def run(iteration: AbstractIteration, cap: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give (k, n) answers, (k,) step counts, and (k,) whether each stopped before the cap."""
    answer = np.zeros_like(iteration.x)
    counts = np.full(len(answer), cap)
    converged = np.zeros(len(answer), dtype=bool)
    active = np.arange(len(answer))
    for step in range(1, cap + 1):
        stopped = iteration.advance()
        if stopped.any():
            done = active[stopped]
            answer[done], counts[done], converged[done] = iteration.x[stopped], step, True
            active = active[~stopped]
            if not active.size:
                return answer, counts, converged
            iteration.select(np.flatnonzero(~stopped))
    answer[active] = iteration.x
    return answer, counts, converged


def shrink(x: np.ndarray, width: float, out: np.ndarray, work: np.ndarray) -> None:
    """Write ``sign(x) max(|x| - width, 0)`` to ``out``; ``work`` is scratch."""
    np.clip(x, -width, width, out=work)
    np.subtract(x, work, out=out)


def distances(a: np.ndarray, b: np.ndarray, work: np.ndarray) -> np.ndarray:
    """(k,) 2-norms of the rows of ``a - b``; ``work`` is scratch."""
    np.subtract(a, b, out=work)
    return np.sqrt(np.einsum("ij,ij->i", work, work))


def relations(stack: Stack, coefficients: np.ndarray, own: float) -> np.ndarray:
    """(k, n) coefficients with that of each problem's own left-out row put in as ``own``."""
    out = coefficients.copy()
    out[np.arange(len(out)), stack.left] = own
    return out
