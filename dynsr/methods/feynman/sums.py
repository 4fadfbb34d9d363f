"""Sums of two or three functions of the bank, chosen from all pairs by one Gram matrix.

With the background projected out, columns f_i and target z of norm 1, g = f_i . f_j and
p_i = f_i . z, the best c_i f_i + c_j f_j explains

    (p_i^2 + p_j^2 - 2 g p_i p_j) / (1 - g^2)

of z; so M functions give M (M - 1) / 2 pairs for the cost of one product of matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
    """Give the (<= keep, 3) best triples that hold one of the given pairs, best first."""
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
