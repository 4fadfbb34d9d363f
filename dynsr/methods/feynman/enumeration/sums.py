"""Sums of functions of the bank: of two or three from one Gram matrix, of more by a beam search."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from dynsr.methods.feynman.enumeration.backend import Backend
from dynsr.methods.feynman.enumeration.bank import Bank
from dynsr.methods.feynman.problem import Problem

# Two functions whose correlation leaves less than this of 1 are one function and its noise.
_DISTINCT = 1e-5


@dataclass(frozen=True, eq=False)
class Gram:
    """Inner products of M functions among each other (M, M) and with the target (M,)."""

    inner: np.ndarray
    moments: np.ndarray
    usable: np.ndarray


def make_gram(values: np.ndarray, problem: Problem, rows: np.ndarray, roots: np.ndarray) -> Gram:
    """Project the background out of (M, len(rows)) function values and of the target.

    ``roots`` (len(rows),) are the square roots of the weights. Functions that are not finite on
    all rows, or that the background spans, are not usable.
    """
    columns = problem.feature(values) * roots
    usable = np.isfinite(columns).all(axis=1)
    columns[~usable] = 0.0
    base = np.linalg.qr(problem.background[rows] * roots[:, None])[0]
    target = problem.target.values[rows] * roots
    target = target - base @ (base.T @ target)
    before = np.einsum("ij,ij->i", columns, columns)
    columns -= (columns @ base) @ base.T
    after = np.einsum("ij,ij->i", columns, columns)
    usable &= after > 1e-8 * before
    columns *= np.where(usable, 1 / np.sqrt(np.where(usable, after, 1.0)), 0.0)[:, None]
    norm = np.linalg.norm(target) or 1.0
    return Gram(columns @ columns.T, columns @ (target / norm), usable)


def best_pairs(gram: Gram, keep: int) -> np.ndarray:
    """Give the (<= keep, 2) pairs that explain most, best first."""
    p = gram.moments
    first, second = np.triu_indices(len(p), 1)
    g = gram.inner[first, second]
    left = 1 - g * g
    left[(left < _DISTINCT) | ~(gram.usable[first] & gram.usable[second])] = np.inf
    a, b = p[first], p[second]
    share = (a * a + b * b - 2 * g * a * b) / left
    best = _largest(share, keep)
    return np.column_stack([first[best], second[best]])


def best_triples(gram: Gram, pairs: Sequence[np.ndarray], keep: int) -> np.ndarray:
    """Give the (<= keep, 3) best triples that contain one of the given pairs, best first."""
    if not len(pairs):
        return np.empty((0, 3), dtype=int)
    chosen = np.array(pairs)
    inner, moments = gram.inner[chosen], gram.moments[chosen]
    system = np.take_along_axis(inner, chosen[:, None, :], axis=2)
    both = np.linalg.solve(system, np.concatenate([inner, moments[:, :, None]], axis=2))
    left = 1 - np.einsum("kij,kij->kj", inner, both[:, :, :-1])
    rest = gram.moments - np.einsum("kij,ki->kj", inner, both[:, :, -1])
    explained = np.einsum("ki,ki->k", moments, both[:, :, -1])
    share = explained[:, None] + rest**2 / np.maximum(left, _DISTINCT)
    share[(left < _DISTINCT) | ~gram.usable] = 0.0
    np.put_along_axis(share, chosen, 0.0, axis=1)
    rows, shares = [], []
    for pair, explains in zip(chosen, share, strict=True):
        for third in _largest(explains, 4):
            rows.append(sorted((*pair, third)))
            shares.append(explains[third])
    if not rows:
        return np.empty((0, 3), dtype=int)
    triples, first = np.unique(np.array(rows), axis=0, return_index=True)
    return triples[_largest(np.array(shares)[first], keep)]


def _largest(values: np.ndarray, keep: int) -> np.ndarray:
    """Places of the largest values above 0, largest first; equal ones in order of place."""
    if len(values) > keep:
        least = np.partition(values, len(values) - keep)[len(values) - keep]
        places = np.flatnonzero(values >= least)
    else:
        places = np.arange(len(values))
    places = places[values[places] > 0]
    return places[np.argsort(-values[places], kind="stable")][:keep]


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
        """(R, q) background basis, (K, R, m) bases next to it, (K, R) residues, and the groups."""
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
