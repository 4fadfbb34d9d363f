"""Sums that hold any stored function: a beam of groups, each extended by the whole bank at once.

For a group with orthonormal basis B (background included) and target residue z, adding f explains

    (f . z)^2 / (f . f - |B^T f|^2)

more of the target. All groups meet all stored functions in one product of matrices on the probe
rows; the best few are then fitted on all rows.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from dynsr.methods.feynman.backend import Backend
from dynsr.methods.feynman.bank import Bank
from dynsr.methods.feynman.problem import Problem

# Less than this share of a function's square left beside a group is rounding.
_LEFT = 1e-6
_CHUNK = 16384
Group = tuple[int, ...]


class Beam:
    """Extends groups of function numbers; ``X`` (probes, p) and ``rows`` are the probe rows."""

    def __init__(
        self,
        bank: Bank,
        X: np.ndarray,
        rows: np.ndarray,
        backend: Backend,
        deadline: float = math.inf,
    ) -> None:
        """Take a bank whose levels are formed; after ``deadline`` no chunk of it is looked at."""
        self.bank, self.X, self.rows, self.backend = bank, X, rows, backend
        self.deadline = deadline

    def singles(self, count: int) -> list[Group]:
        """Give the simplest functions that are no affine map of each other, one to a group."""
        fresh = [level.start + np.flatnonzero(level.fresh) for level in self.bank.levels]
        return [(int(number),) for number in np.concatenate(fresh)[:count]]

    def pairs(self, count: int) -> list[Group]:
        """Give all pairs of so many simplest functions."""
        return [(a[0], b[0]) for a, b in combinations(self.singles(count), 2)]

    def extend(self, problem: Problem, groups: Sequence[Group], keep: int) -> list[Group]:
        """Give the ``keep`` best groups of one function more; all groups are of one length."""
        shared, bases, residues, groups = self._bases(problem, groups)
        if not groups:
            return []
        backend = self.backend
        base = backend.put(np.concatenate([shared, *bases], axis=1))
        residue = backend.put(residues.T)
        left = 1 - np.einsum("kr,kr->k", residues, residues)
        best = np.full(keep, -np.inf)
        chosen: list[Group] = [()] * keep
        for level in self.bank.levels:
            for begin in range(0, len(level), _CHUNK):
                if time.monotonic() > self.deadline:
                    break
                values = self._features(problem, level.rows.values[begin : begin + _CHUNK])
                share = left + self._gains(values, base, residue, shared.shape[1])
                flat = np.flatnonzero(share.ravel() > best.min())
                flat = flat[np.argsort(-share.ravel()[flat], kind="stable")][: 4 * keep]
                for place in flat:
                    row, k = divmod(int(place), len(groups))
                    group = (*groups[k], level.start + begin + row)
                    worst = int(np.argmin(best))
                    if share[row, k] > best[worst] and not _is_in(group, chosen):
                        best[worst], chosen[worst] = share[row, k], group
        order = np.argsort(-best, kind="stable")
        return [chosen[i] for i in order if chosen[i]]

    def _features(self, problem: Problem, values: Any) -> Any:
        if not problem.by_log:
            return values
        return self.backend.apply("log", self.backend.apply("abs", values))

    def _gains(self, values: Any, base: Any, residue: Any, shared: int) -> np.ndarray:
        """(B, K) share each function adds to each group; ``shared`` columns belong to all."""
        squares = self.backend.square_sums(values)
        inside = self.backend.get(values @ base)
        np.square(inside, out=inside)
        common = squares - inside[:, :shared].sum(axis=1)
        gains = self.backend.get(values @ residue)
        own = inside[:, shared:].reshape(*gains.shape, -1)
        rest = common[:, None] - (own[:, :, 0] if own.shape[2] == 1 else own.sum(axis=2))
        rest[rest <= _LEFT * squares[:, None]] = np.inf
        np.square(gains, out=gains)
        gains /= rest
        gains[~np.isfinite(squares)] = -np.inf
        return gains

    def _bases(
        self, problem: Problem, groups: Sequence[Group]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Group]]:
        """(R, q) background basis, (K, R, m) bases beside it, (K, R) residues, and the groups."""
        background = problem.background[self.rows]
        target = problem.target.values[self.rows]
        base = np.linalg.qr(background)[0]
        target = target - base @ (base.T @ target)
        target = target / (np.linalg.norm(target) or 1.0)
        numbers = sorted({number for group in groups for number in group})
        features = {n: problem.feature(self.bank.evaluate(n, self.X)) for n in numbers}
        kept = [g for g in groups if all(np.isfinite(features[n]).all() for n in g)]
        if not kept:
            return base, np.empty((0, 0, 0)), np.empty((0, 0)), []
        columns = [np.column_stack([base, *(features[n] for n in g)]) for g in kept]
        scaled = [c / (np.linalg.norm(c, axis=0) + 1e-300) for c in columns]
        bases = np.array([np.linalg.qr(c)[0][:, base.shape[1] :] for c in scaled])
        return base, bases, target - np.einsum("krm,ksm,s->kr", bases, bases, target), kept


def _is_in(group: Group, chosen: Sequence[Group]) -> bool:
    return any(set(group) == set(other) for other in chosen)
