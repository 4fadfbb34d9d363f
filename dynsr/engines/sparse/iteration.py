"""Iterations over many least-squares problems at once.

A stack holds many problems over one matrix, reduced once; an iteration runs on all of them and
freezes each when it stops.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

EPSILON = float(np.finfo(float).eps)


def compress(rows: np.ndarray) -> np.ndarray:
    """Give (n, min(n, m)) rows with the same inner products as the (n, m) rows given.

    The triangular factor of a Householder QR: orthogonal invariance makes every least-squares
    solution and residual norm over the short rows the same as over the long ones, without the
    loss of digits that forming the Gram matrix would bring.

    >>> short = compress(np.array([[3.0, 4.0, 0.0]]))
    >>> abs(float(short[0, 0]))
    5.0
    """
    if rows.shape[1] <= rows.shape[0]:
        return np.ascontiguousarray(rows)
    return np.ascontiguousarray(
        scipy.linalg.qr(rows.T, mode="r", check_finite=False)[0][: rows.shape[0]].T
    )


def least_squares(rows: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Solve ``min |c . rows - target|`` by column-pivoted QR; the shortest c when not unique."""
    if rows.shape[0] == 0:
        return np.zeros(0)
    return scipy.linalg.lstsq(
        rows.T, target, cond=min(rows.shape) * EPSILON, lapack_driver="gelsy", check_finite=False
    )[0]


@dataclass(frozen=True, eq=False)
class Stack:
    """k regressions of some rows on others, all taken from one matrix.

    Parameters
    ----------
    rows : (n, m) regressors.
    targets : (k, m) what each problem is to reproduce.
    left : (k,), when given, names for each problem the row that it must leave out: its
        coefficient stays zero. Coefficients of the stack are (k, n), one problem a row.
    short_rows, short_targets : the same in few columns, :func:`compress`.
    """

    rows: np.ndarray
    targets: np.ndarray
    left: np.ndarray | None
    short_rows: np.ndarray
    short_targets: np.ndarray

    @classmethod
    def explicit(cls, theta: np.ndarray, dx: np.ndarray) -> Stack:
        """One problem: dx on all rows of theta."""
        short = compress(np.vstack([theta, dx]))
        return cls(theta, dx[None], None, short[:-1], short[-1:])

    @classmethod
    def leave_one_out(cls, rows: np.ndarray, sign: float) -> Stack:
        """As many problems as rows: each row times ``sign`` on all the others."""
        short = compress(rows)
        return cls(rows, sign * rows, np.arange(len(rows)), short, sign * short)

    def scaled(self, scale: np.ndarray) -> Stack:
        """Give the same problems with each regressor divided by its scale."""
        column = scale[:, None]
        return replace(self, rows=self.rows / column, short_rows=self.short_rows / column)

    @cached_property
    def norms(self) -> np.ndarray:
        """2-norm of each row; 1 for a row of zeros, which no division can help."""
        norms = np.linalg.norm(self.rows, axis=1)
        return np.where(norms > 0, norms, 1.0)

    @cached_property
    def gram(self) -> np.ndarray:
        """(n, n) inner products of the rows."""
        return self.rows @ self.rows.T

    @cached_property
    def correlation(self) -> np.ndarray:
        """(k, n) inner products of targets and rows; zero where a row is left out."""
        product = self.targets @ self.rows.T
        if self.left is not None:
            product[np.arange(len(product)), self.left] = 0.0
        return product

    def regressors(self, problem: int) -> np.ndarray:
        """Indices of the rows that one problem may use."""
        every = np.arange(len(self.rows))
        return every if self.left is None else np.delete(every, self.left[problem])

    def start(self) -> np.ndarray:
        """(k, n) plain least-squares solutions."""
        out = np.zeros((len(self.targets), len(self.rows)))
        for k, target in enumerate(self.short_targets):
            use = self.regressors(k)
            out[k, use] = least_squares(self.short_rows[use], target)
        return out

    def resolvent(self, shift: float) -> Resolvent:
        """Give the map v -> (G + shift I)^-1 v of every problem at once."""
        return Resolvent(shifted_inverse(self.gram, shift), self.left)


def shifted_inverse(gram: np.ndarray, shift: float) -> np.ndarray:
    """Inverse of ``gram + shift I``; the pseudo-inverse when that is singular to rounding."""
    matrix = gram + shift * np.eye(len(gram))
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(matrix)


class Resolvent:
    """(G + shift I)^-1 for each problem of a stack, applied to (k, n) vectors in one product.

    With P the inverse of the whole matrix, v P has no component j when v_j is set to
    -sum_i v_i P_ij / P_jj over the others; the rest is then the solution of the system without
    row and column j (block inversion). So the inverses of the problems are never formed.
    """

    def __init__(self, inverse: np.ndarray, left: np.ndarray | None) -> None:
        """Keep the inverse (n, n) and, a problem, the row of it to project out."""
        self.inverse = inverse
        self.left = left
        if left is not None:
            self._at = np.arange(len(left)) * len(inverse) + left
            self._project = inverse[left] / -inverse[left, left][:, None]
            self._project.reshape(-1)[self._at] = 0.0

    def select(self, problems: np.ndarray) -> Resolvent:
        """Give the resolvent of some of the problems."""
        return Resolvent(self.inverse, None if self.left is None else self.left[problems])

    def apply(self, vectors: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Write the (k, n) solutions to ``out``.

        A vector's entry at its problem's left-out row must be zero, and so it is in the solution.
        """
        if self.left is None:
            return np.matmul(vectors, self.inverse, out=out)
        entries = vectors.reshape(-1)
        entries[self._at] = np.einsum("ij,ij->i", vectors, self._project)
        np.matmul(vectors, self.inverse, out=out)
        entries[self._at] = 0.0
        out.reshape(-1)[self._at] = 0.0
        return out


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
