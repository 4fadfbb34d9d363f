"""Best small subsets of features for y = N(x) / D(x), by a beam search on Gram matrices."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

Support = frozenset[int]
_COLLINEAR = 1e-7
_CANCELLATION = 50.0
# Squared errors fall to less than this share, or a further term was not worth it.
_IDLE = 0.9**2
# Subsets extended in one stack: enough to be quick, few enough to stay in the cache.
_CHUNK = 32


@dataclass(frozen=True, eq=False)
class SubsetSearch:
    """Search for few terms with y D(x) = N(x), linear in the coefficients of both.

    With D = 1 - sum_j b_j d_j(x) and N = sum_k a_k n_k(x) this is the regression of y on the
    columns n_k and y d_j. The error that matters is that of N / D, so a subset's score is
    sum (y D - N)^2 / mean(D^2): without the denominator a D that is nearly 0 everywhere would win.

    Parameters
    ----------
    numerators : (m, n) values of the features that N may hold.
    denominators : (q, n) values of the features that D may hold; q may be 0.
    y : (n,) target.
    weights : (n,) weight of each sample.
    width : how many subsets of each size are kept.
    deadline : ``time.monotonic()`` value after which no further subset is extended.
    """

    numerators: np.ndarray
    denominators: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    width: int = 200
    deadline: float = math.inf

    @cached_property
    def _columns(self) -> tuple[np.ndarray, np.ndarray]:
        columns = np.vstack([self.numerators, self.denominators * self.y])
        columns = columns * np.sqrt(self.weights)
        norms = np.linalg.norm(columns, axis=1)
        norms[norms == 0] = np.inf
        return columns / norms[:, None], norms

    @cached_property
    def _gram(self) -> tuple[np.ndarray, np.ndarray, float]:
        columns, _ = self._columns
        y = self.y * np.sqrt(self.weights)
        return columns @ columns.T, columns @ y, float(y @ y)

    @cached_property
    def _denominator_moments(self) -> tuple[np.ndarray, np.ndarray]:
        weighted = self.denominators * (self.weights / self.weights.sum())
        return weighted.sum(axis=1), weighted @ self.denominators.T

    def extend(self, supports: Sequence[Support]) -> np.ndarray:
        """(b, m + q) score of each of b subsets of one size with each column added.

        Useless additions score inf. By the bordered normal equations all additions to a subset of
        s columns together cost O((m + q) s^2).
        """
        gram, projections, total = self._gram
        chosen = np.array([sorted(support) for support in supports], dtype=int)
        rows = gram[chosen]
        systems = np.take_along_axis(rows, chosen[:, None, :], axis=2)
        right = np.concatenate([rows, projections[chosen][..., None]], axis=2)
        both = _solve(systems, right)
        solved, fitted = both[..., :-1], both[..., -1]
        pivots = 1 - np.einsum("bij,bij->bj", rows, solved)
        moments = projections - np.einsum("bij,bi->bj", rows, fitted)
        rest = total - np.einsum("bi,bi->b", projections[chosen], fitted)
        usable = pivots > _COLLINEAR
        np.put_along_axis(usable, chosen, False, axis=1)
        added = np.where(usable, moments / np.where(usable, pivots, 1.0), 0.0)
        coefficients = fitted[..., None] - solved * added[:, None, :]
        size = np.maximum(np.abs(added), np.abs(coefficients).max(axis=1, initial=0.0))
        usable &= size < _CANCELLATION * np.sqrt(total)
        # The difference below is exact only to rounding of the total.
        error = np.maximum(rest[:, None] - added * moments, 1e-15 * total)
        square = self._mean_square_denominators(chosen, coefficients, added)
        return np.where(usable, error / np.maximum(square, 1e-9), np.inf)

    def _mean_square_denominators(
        self, chosen: np.ndarray, coefficients: np.ndarray, added: np.ndarray
    ) -> np.ndarray:
        """(b, m + q) mean of D^2 after each addition."""
        m = len(self.numerators)
        square = np.ones(added.shape)
        if not len(self.denominators):
            return square
        _, norms = self._columns
        first, second = self._denominator_moments
        own = added[:, m:] / norms[m:]
        square[:, m:] += -2 * own * first + own**2 * np.diag(second)
        # Columns of the numerator take no part in D: their coefficients count as 0 there.
        inside = chosen >= m
        index = np.where(inside, chosen - m, 0)
        b = np.where(inside[..., None], coefficients / norms[chosen][..., None], 0.0)
        square -= 2 * np.einsum("bs,bsj->bj", first[index], b)
        pairs = second[index[:, :, None], index[:, None, :]]
        square += np.einsum("bsj,bsj->bj", b, pairs @ b)
        square[:, m:] += 2 * own * np.einsum("bsj,bsj->bj", b[..., m:], second[index])
        return square

    def search(self, max_size: int) -> list[list[Support]]:
        """Give, for each size from 1 to ``max_size``, the best subsets found, best first.

        Every size starts from all additions to the subsets one smaller; then members are swapped,
        one at a time, until no swap improves the kept ones. Ends once two more terms lower the
        error by less than a tenth.
        """
        found: list[list[Support]] = []
        scores: list[float] = []
        parents: list[Support] = [frozenset()]
        for _ in range(max_size):
            pool: dict[Support, float] = {}
            self._grow(parents, 40, pool)
            kept = self._swap(pool)
            if not kept:
                break
            found.append(list(kept))
            scores.append(min(kept.values()))
            parents = found[-1]
            idle = len(scores) > 2 and scores[-1] > _IDLE * scores[-3]
            if idle or time.monotonic() > self.deadline:
                break
        return found

    def _grow(self, supports: Sequence[Support], most: int, pool: dict[Support, float]) -> None:
        for start in range(0, len(supports), _CHUNK):
            if time.monotonic() > self.deadline:
                break
            chunk = supports[start : start + _CHUNK]
            scores = self.extend(chunk)
            most = min(most, scores.shape[1])
            best = np.argpartition(scores, most - 1, axis=1)[:, :most]
            values = np.take_along_axis(scores, best, axis=1)
            for row, column in zip(*np.nonzero(np.isfinite(values)), strict=True):
                grown = chunk[row] | {int(best[row, column])}
                pool.setdefault(grown, float(values[row, column]))

    def _best(self, pool: dict[Support, float]) -> dict[Support, float]:
        ordered = sorted(pool.items(), key=lambda item: (item[1], sorted(item[0])))
        return dict(ordered[: self.width])

    def _swap(self, pool: dict[Support, float]) -> dict[Support, float]:
        kept = self._best(pool)
        tried: set[Support] = set()
        reduced: set[Support] = set()
        for _ in range(8):
            waiting = [support for support in kept if support not in tried]
            if not waiting:
                break
            pool = dict(kept)
            tried.update(waiting)
            smaller = dict.fromkeys(s - {member} for s in waiting for member in sorted(s))
            fresh = [support for support in smaller if support not in reduced]
            reduced.update(fresh)
            self._grow(fresh, 10, pool)
            kept = self._best(pool)
        return kept


def _solve(systems: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a stack of normal equations; a singular one among them as if barely regular."""
    if not systems.shape[1]:
        return np.zeros(right.shape)
    try:
        return np.linalg.solve(systems, right)
    except np.linalg.LinAlgError:
        return np.linalg.solve(systems + 1e-12 * np.eye(systems.shape[1]), right)


@dataclass(frozen=True, eq=False)
class RatioFit:
    """Coefficients of one subset: ``numerator`` and ``denominator`` map feature -> coefficient.

    D holds the constant 1 besides; ``residual`` (n,) is y - N / D.
    """

    numerator: dict[int, float]
    denominator: dict[int, float]
    residual: np.ndarray


def fit_ratio(
    search: SubsetSearch, support: Support, rounds: int = 6, weights: np.ndarray | None = None
) -> RatioFit:
    """Fit a subset so that the error of N / D itself is least.

    Repeats the linear fit with rows weighted by 1 / |D| of the round before (Sanathanan and
    Koerner 1963), by orthogonal factorisation, so that an exact relation is fitted exactly.
    """
    m = len(search.numerators)
    chosen = sorted(support)
    top = [c for c in chosen if c < m]
    bottom = [c - m for c in chosen if c >= m]
    columns = np.vstack([search.numerators[top], search.denominators[bottom] * search.y]).T
    root = np.sqrt(search.weights if weights is None else weights)
    denominator = np.ones_like(search.y)
    solution = np.zeros(len(chosen))
    for _ in range(rounds if bottom else 1):
        scale = root / np.maximum(np.abs(denominator), 1e-12)
        solution = np.linalg.lstsq(columns * scale[:, None], search.y * scale, rcond=None)[0]
        denominator = 1 - solution[len(top) :] @ search.denominators[bottom]
    with np.errstate(all="ignore"):
        predicted = (solution[: len(top)] @ search.numerators[top]) / denominator
    return RatioFit(
        dict(zip(top, solution.tolist(), strict=False)),
        {j: -c for j, c in zip(bottom, solution[len(top) :].tolist(), strict=True)},
        search.y - predicted,
    )
