"""The running enumeration: levels of distinct functions, each offered to the screen once."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import sympy

from dynsr.methods.feynman.alphabet import Letter
from dynsr.methods.feynman.backend import Backend
from dynsr.methods.feynman.bank import Bank, Chunk, Labels, join_labels
from dynsr.methods.feynman.enumeration import CHUNK, count_formations, form_leaves, form_level
from dynsr.methods.feynman.screening import Screen, Shortlist
from dynsr.methods.feynman.signature import Seen, Spread, sketch_directions

# Functions formed in levels up to this many are looked at for the power law too.
_LOGARITHMS = 400_000
# A level of so few functions is stored even if nothing is built on it: sums draw on it.
_SMALL = 20_000
# A level of more is stored only if ``most`` leaves room for the next one, so many times as large:
# its value rows are most of the memory, and fresh memory is slow.
_LARGE, _GROWTH = 300_000, 4
_SKETCH_SEED = 20210
# Functions formed in blocks of pairs beyond those that count_formations counts.
_SLACK = 8 * CHUNK


class Enumerator:
    """Forms levels of functions until a bound is met.

    Counts: ``formed`` functions evaluated on the probe rows; ``distinct`` of them up to an affine
    map, each tested once against every problem; ``complete`` the largest size of which every
    function was looked at. ``stopped`` says which bound ended it.

    Memory rule: when the stored functions and the tables of hashes would pass ``memory`` bytes, no
    further function is stored and no further hash is entered; what is stored goes on being
    combined and tested, but then a function may be looked at twice, and levels are no longer
    complete.
    """

    def __init__(
        self,
        X: np.ndarray,
        leaves: Sequence[sympy.Expr],
        letters: tuple[Letter, ...],
        nested: bool,
        backend: Backend,
        memory: int,
    ) -> None:
        """Start with no level; ``X`` (probes, p) are the probe rows."""
        self.backend, self.nested, self.memory = backend, nested, memory
        self.bank = Bank(letters, tuple(leaves), X.shape[1])
        self.rows = len(X)
        self._each = 8 * self.rows + 11
        self.formed = self.distinct = self.complete = 0
        self.storing = True
        self.stopped = ""
        self._exact, self._affine = Seen(), Seen()
        self._sketch = sketch_directions(len(X), _SKETCH_SEED).T
        self._leaf_values = self.bank.leaf_values(X)

    @property
    def nbytes(self) -> int:
        """Bytes held by stored functions and tables of hashes."""
        return self._each * len(self.bank) + self._exact.nbytes + self._affine.nbytes

    def form(
        self,
        size: int,
        screen: Screen,
        keep: int,
        most: float,
        deadline: float,
        last: bool,
        draws: bool = False,
    ) -> Shortlist:
        """Form the level of ``size`` letters and give its best functions.

        Ends in the middle of a level once ``most`` functions are formed in all, or ``deadline`` (a
        ``time.monotonic()`` value) has passed. A large level that is the ``last``, or would
        pass ``most``, is not stored, and nothing after it; and unless a beam ``draws`` on what is
        stored, nor is a level that leaves the next one no room under ``most``.
        """
        shortlist = Shortlist(screen.count, keep)
        whole = self.complete == size - 1 and self.storing
        ahead = max(count_formations(self.bank, size), len(self.bank.leaves))
        self._decide_storing(ahead, most, last, draws)
        room = max(0, self.memory - self.nbytes) // self._each if self.storing else 0
        stored = self.backend.reserve(min(ahead + _SLACK, room), self.rows)
        labels: list[Labels] = []
        fresh: list[np.ndarray] = []
        directions = self.backend.put(np.concatenate([self._sketch, screen.directions]))
        for chunk in self._chunks(size):
            index, new = self._look_at(chunk, directions, screen, shortlist)
            if size == 1:  # A constant is no candidate, but an argument.
                index, new = np.arange(len(chunk)), np.isin(np.arange(len(chunk)), index[new])
            if self._has_room(len(index) + sum(map(len, fresh))):
                stored.add(chunk.values, index)
                labels.append(chunk.labels(index))
                fresh.append(new)
            if self.formed >= most or time.monotonic() > deadline:
                self.stopped = "candidates" if self.formed >= most else "deadline"
                whole = False
                break
        marks = np.concatenate([np.zeros(0, dtype=bool), *fresh])
        self.bank.append(Chunk(stored.finish(), *join_labels(labels)), marks)
        if whole:
            self.complete = size
        return shortlist

    def _decide_storing(self, ahead: int, most: float, last: bool, draws: bool) -> None:
        following = 0 if draws or ahead <= _LARGE else _GROWTH * ahead
        if ahead > _SMALL and (last or self.formed + ahead + following >= most):
            self.storing = False

    def _chunks(self, size: int) -> Iterator[Chunk]:
        if size == 1:
            return iter([form_leaves(self._leaf_values, self.backend)])
        return form_level(self.bank, size, self.nested, self.storing, self.backend)

    def _look_at(
        self, chunk: Chunk, directions: Any, screen: Screen, shortlist: Shortlist
    ) -> tuple[np.ndarray, np.ndarray]:
        """Test the new functions of a chunk; give them, and which are new up to an affine map."""
        values = chunk.values
        squares = self.backend.square_sums(values)
        projected = self.backend.get(directions @ values.T)
        spread = Spread(projected, squares, self.rows)
        index = np.flatnonzero(spread.usable)
        spread = spread.take(index)
        if self.storing:
            new = self._enter(self._exact, spread.exact())
            index, spread = index[new], spread.take(new)
        fresh = self._enter(self._affine, spread.affine())
        tested = index[fresh]
        rows = self.backend.pick(values, tested) if self.formed < _LOGARITHMS else None
        shares = screen.shares(projected[len(self._sketch) :, tested], squares[tested], rows)
        shortlist.offer(shares, chunk, tested)
        self.formed += len(chunk)
        self.distinct += len(tested)
        return index, fresh

    def _enter(self, seen: Seen, hashes: np.ndarray) -> np.ndarray:
        """Enter hashes; give which were new. When the table may not grow, only look them up."""
        if seen.must_grow(len(hashes)) and self.nbytes + 4 * seen.nbytes > self.memory:
            self.storing = False
            return ~seen.has(hashes)
        return seen.add(hashes)

    def _has_room(self, pending: int) -> bool:
        if self.storing and self.nbytes + pending * self._each > self.memory:
            self.storing = False
        return self.storing
