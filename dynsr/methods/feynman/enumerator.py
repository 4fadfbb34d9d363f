"""The running enumeration: levels of distinct functions, each offered to the screen once."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np
import sympy

from dynsr.methods.feynman.alphabet import Letter
from dynsr.methods.feynman.backend import Backend
from dynsr.methods.feynman.bank import Bank, Chunk, Level, join_chunks
from dynsr.methods.feynman.enumeration import count_formations, form_leaves, form_level
from dynsr.methods.feynman.screening import Screen, Shortlist
from dynsr.methods.feynman.signature import Seen, Spread, sketch_directions

# Functions formed in levels up to this many are looked at for the power law too.
_LOGARITHMS = 400_000
# A level of so few functions is stored even if nothing is built on it: sums draw on it.
_SMALL = 20_000
_SKETCH_SEED = 20210


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
        self._sketch = backend.put(sketch_directions(len(X), _SKETCH_SEED))
        self._leaf_values = self.bank.leaf_values(X)

    @property
    def nbytes(self) -> int:
        """Bytes held by stored functions and tables of hashes."""
        return self._each * len(self.bank) + self._exact.nbytes + self._affine.nbytes

    def form(
        self, size: int, screen: Screen, keep: int, most: float, deadline: float, last: bool
    ) -> Shortlist:
        """Form the level of ``size`` letters and give its best functions.

        Ends in the middle of a level once ``most`` functions are formed in all, or ``deadline`` (a
        ``time.monotonic()`` value) has passed. A large level that is the ``last``, or would
        pass ``most``, is not stored, and nothing after it.
        """
        shortlist = Shortlist(screen.count, keep)
        whole = self.complete == size - 1 and self.storing
        ahead = count_formations(self.bank, size)
        if ahead > _SMALL and (last or self.formed + ahead >= most):
            self.storing = False
        stored: list[Chunk] = []
        fresh: list[np.ndarray] = []
        for chunk in self._chunks(size):
            index, new = self._look_at(chunk, screen, shortlist)
            if size == 1:  # A constant is no candidate, but an argument.
                index, new = np.arange(len(chunk)), np.isin(np.arange(len(chunk)), index[new])
            if self._has_room(len(index) + sum(map(len, stored))):
                stored.append(chunk.take(index, self.backend))
                fresh.append(new)
            if self.formed >= most or time.monotonic() > deadline:
                self.stopped = "candidates" if self.formed >= most else "deadline"
                whole = False
                break
        rows = join_chunks([self._nothing(), *stored], self.backend)
        marks = np.concatenate([np.zeros(0, dtype=bool), *fresh])
        self.bank.levels.append(Level(len(self.bank), rows, marks))
        if whole:
            self.complete = size
        return shortlist

    def _chunks(self, size: int) -> Iterator[Chunk]:
        if size == 1:
            return iter([form_leaves(self._leaf_values, self.backend)])
        return form_level(self.bank, size, self.nested, self.backend)

    def _nothing(self) -> Chunk:
        return form_leaves(np.empty((0, self.rows)), self.backend)

    def _look_at(
        self, chunk: Chunk, screen: Screen, shortlist: Shortlist
    ) -> tuple[np.ndarray, np.ndarray]:
        """Test the new functions of a chunk; give them, and which are new up to an affine map."""
        values = chunk.values
        squares = self.backend.square_sums(values)
        spread = Spread(self.backend.get(values @ self._sketch), squares, self.rows)
        index = np.flatnonzero(spread.usable)
        spread = spread.take(index)
        if self.storing:
            new = self._enter(self._exact, spread.exact())
            index, spread = index[new], spread.take(new)
        fresh = self._enter(self._affine, spread.affine())
        shares = screen.shares(values, squares, self.formed < _LOGARITHMS)
        shortlist.offer(shares[index[fresh]], chunk, index[fresh])
        self.formed += len(chunk)
        self.distinct += int(np.count_nonzero(fresh))
        return index, fresh

    def _enter(self, seen: Seen, hashes: np.ndarray) -> np.ndarray:
        """Enter hashes; give which were new. When the table may not grow, only look them up."""
        if seen.must_grow(len(hashes)) and self.nbytes + 2 * seen.nbytes > self.memory:
            self.storing = False
            return ~seen.has(hashes)
        return seen.add(hashes)

    def _has_room(self, pending: int) -> bool:
        if self.storing and self.nbytes + pending * self._each > self.memory:
            self.storing = False
        return self.storing
