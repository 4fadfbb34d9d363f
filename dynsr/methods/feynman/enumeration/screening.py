"""Screening: how well every function of a chunk fits every problem, in closed form, at once.

For a problem with orthonormal background Q and unit target z orthogonal to it, the best linear
fit by f explains the share (f . z)^2 / (f . f - |Q^T f|^2) of what the background leaves. That is
one product of matrices for a whole chunk. It is taken on the probe rows alone; only the few best
functions of a level are looked at on all rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynsr.methods.feynman.enumeration.backend import Backend
from dynsr.methods.feynman.enumeration.bank import Chunk
from dynsr.methods.feynman.problem import Problem

# Less than this share of a function's square left beside the background is rounding.
_LEFT = 1e-8


@dataclass(frozen=True, eq=False)
class _Group:
    """Problems of one background: ``places`` in the list of all, columns of Q and of z."""

    places: list[int]
    base: np.ndarray
    targets: np.ndarray


def _make_groups(problems: Sequence[Problem], by_log: bool, rows: np.ndarray) -> list[_Group]:
    groups: dict[tuple[int, ...], list[int]] = {}
    for place, problem in enumerate(problems):
        if problem.by_log == by_log:
            groups.setdefault(problem.powers, []).append(place)
    made = []
    for places in groups.values():
        base = np.linalg.qr(problems[places[0]].background[rows])[0]
        targets = np.column_stack([problems[p].target.values[rows] for p in places])
        scale = np.linalg.norm(targets - targets.mean(axis=0), axis=0)
        targets = targets - base @ (base.T @ targets)
        norm = np.linalg.norm(targets, axis=0)
        # A target that the background explains alone leaves nothing to look for.
        norm[norm <= 1e-10 * scale] = np.inf
        made.append(_Group(places, base, targets / norm))
    return made


class Screen:
    """The problems on the probe rows, ready for chunks; ``rows`` are the probe rows."""

    def __init__(self, problems: Sequence[Problem], rows: np.ndarray, backend: Backend) -> None:
        """Bring backgrounds and targets on the probe rows to the backend."""
        self.backend = backend
        self.count = len(problems)
        self._groups = [_make_groups(problems, by_log, rows) for by_log in (False, True)]
        self.directions, self._logarithmic = (
            np.concatenate([part.T for g in groups for part in (g.base, g.targets)])
            if groups
            else np.empty((0, len(rows)))
            for groups in self._groups
        )
        self._logarithmic = backend.put(self._logarithmic)

    def shares(self, projected: np.ndarray, squares: np.ndarray, values: Any = None) -> np.ndarray:
        """(problems, B) share of each problem's target that each of B functions explains.

        ``projected`` (k, B) are the products of the k ``directions`` with their value rows,
        ``squares`` (B,) the sums of squares. The power law's share is 0 unless the (B, probes)
        ``values`` are given, since logarithms cost more than all the rest.
        """
        out = np.zeros((self.count, len(squares)))
        self._fill(out, 0, projected, squares)
        if values is not None and self._groups[1]:
            logarithms = self.backend.apply("log", self.backend.apply("abs", values))
            projected = self.backend.get(self._logarithmic @ logarithms.T)
            self._fill(out, 1, projected, self.backend.square_sums(logarithms))
        return out

    def _fill(self, out: np.ndarray, kind: int, projected: np.ndarray, squares: np.ndarray) -> None:
        row = 0
        for group in self._groups[kind]:
            middle = row + group.base.shape[1]
            inside = projected[row:middle]
            rest = squares - np.einsum("ij,ij->j", inside, inside)
            scale = 1 / np.where(rest > _LEFT * squares, rest, np.inf)
            row = middle + group.targets.shape[1]
            for place, product in zip(group.places, projected[middle:row], strict=True):
                np.multiply(product, product, out=out[place])
                out[place] *= scale


@dataclass
class Shortlist:
    """The ``keep`` functions of greatest share for each of ``problems`` problems.

    ``bound`` is the least share that still gets in; ties go to the one that came first.
    """

    problems: int
    keep: int
    bound: np.ndarray = field(init=False)
    _held: list[list[np.ndarray]] = field(init=False)

    def __post_init__(self) -> None:
        """Start empty."""
        self.bound = np.full(self.problems, 1e-6)
        self._held = [[np.empty((0, 4))] for _ in range(self.problems)]

    def offer(self, shares: np.ndarray, chunk: Chunk, index: np.ndarray) -> None:
        """Take in the functions ``index`` of a chunk with their (problems, len(index)) shares."""
        for place, share in enumerate(shares):
            mine = np.flatnonzero(share > self.bound[place])
            if not len(mine):
                continue
            at = index[mine]
            entries = np.column_stack(
                [share[mine], chunk.letter[at], chunk.left[at], chunk.right[at]]
            )
            self._held[place].append(entries)
            if sum(map(len, self._held[place])) > 8 * self.keep:
                self._prune(place)

    def _prune(self, place: int) -> None:
        entries = np.concatenate(self._held[place])
        order = np.argsort(-entries[:, 0], kind="stable")[: self.keep]
        entries = entries[np.sort(order)]
        self._held[place] = [entries]
        if len(entries) == self.keep:
            self.bound[place] = entries[:, 0].min()

    def winners(self, place: int) -> list[tuple[int, int, int]]:
        """Give letter and arguments of a problem's best functions, best first."""
        self._prune(place)
        entries = self._held[place][0]
        order = np.argsort(-entries[:, 0], kind="stable")
        return [(int(e[1]), int(e[2]), int(e[3])) for e in entries[order]]
