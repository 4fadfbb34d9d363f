"""Bottom-up formation: all functions of one complexity from the stored simpler ones, in batches.

Levels of distinct functions are formed in order, and each function is offered to the screen once.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import sympy

from dynsr.methods.feynman.enumeration.alphabet import BINARY, LEAF, ONE_SIGN, Letter
from dynsr.methods.feynman.enumeration.backend import Backend
from dynsr.methods.feynman.enumeration.bank import (
    Bank,
    Chunk,
    Labels,
    Level,
    Seen,
    Spread,
    join_labels,
    sketch_directions,
)
from dynsr.methods.feynman.enumeration.screening import Screen, Shortlist

CHUNK = 16384
_COMMUTES = ("+", "*", "-")  # a - b and b - a are one function up to sign
_SUMS, _PRODUCTS = frozenset("+-"), frozenset("*/")
# Functions of functions that are, up to sign, others of at most the same size.
_REPEATS = {
    "inv": ("inv", "/", "exp", "sqrt", "square"),
    "square": ("sqrt",),
    "log": ("inv",),
    "abs": ("abs", "square", "sqrt", "exp"),
}


def form_leaves(values: np.ndarray, backend: Backend) -> Chunk:
    """Give the functions of complexity 1 from (leaves, rows) values."""
    places = np.arange(len(values), dtype=np.int32)
    kinds = np.full(len(values), LEAF, dtype=np.uint8)
    return Chunk(backend.put(values), kinds, places, places, np.zeros(len(values), dtype=np.uint8))


def form_level(
    bank: Bank, size: int, nested: bool, exact: bool, backend: Backend
) -> Iterator[Chunk]:
    """Form every function of ``size`` letters whose arguments are stored, chunk by chunk.

    A chunk's values are good until the next one is asked for.

    One-argument letters on level size - 1; two-argument letters on every pair of levels that adds
    up to size - 1, the symmetric ones once. Left out is what algebra says is another of at most
    this size up to its sign, such as a + (b + 1), a / (1 / b) and sqrt(f) where f is negative,
    and, unless ``exact``, f + 1. Functions plus a constant come first and reciprocals last.
    """
    levels = bank.levels
    one_less = levels[size - 2] if size - 2 < len(levels) else None
    if exact and one_less is not None and size > 2:
        last = levels[size - 3]
        yield from _form_pairs(bank, "+-", _constants(bank), _rows(last), backend)
    if one_less is not None:
        yield from _form_unary(bank, one_less, nested, backend, False)
    for one in range(1, size - 1):
        other = size - 1 - one
        if one <= len(levels) and other <= len(levels):
            yield from _form_binary(bank, levels[one - 1], levels[other - 1], backend)
    if one_less is not None:
        yield from _form_unary(bank, one_less, nested, backend, True)


def count_formations(bank: Bank, size: int) -> int:
    """Count (from above) the functions that form_level would form."""
    lengths = [0, *(len(level) for level in bank.levels)]
    unary = sum(letter.arity == 1 for letter in bank.letters)
    total = unary * lengths[size - 1] if size - 1 < len(lengths) else 0
    for one in range(1, size - 1):
        other = size - 1 - one
        if one < len(lengths) and other < len(lengths):
            for letter in bank.letters:
                if letter.arity == 2 and (one <= other or letter.token not in _COMMUTES):
                    pairs = lengths[one] * lengths[other]
                    total += pairs // 2 if one == other and letter.token in _COMMUTES else pairs
    return total


def _form_unary(
    bank: Bank, level: Level, nested: bool, backend: Backend, inverses: bool
) -> Iterator[Chunk]:
    rows = level.rows
    tokens = np.array([letter.token for letter in bank.letters] + ["leaf"])
    kinds = tokens[np.minimum(rows.letter, len(bank.letters))]
    signs = backend.signs(rows.values)
    for number, letter in enumerate(bank.letters):
        if letter.arity != 1 or (letter.token == "inv") is not inverses:
            continue
        wanted = ~np.isin(kinds, _REPEATS.get(letter.token, ()))
        if not nested and letter.family:
            wanted &= (rows.family & letter.family) == 0
        if letter.token in ONE_SIGN:
            wanted &= signs == letter.sign
        allowed = np.flatnonzero(wanted)
        for begin in range(0, len(allowed), CHUNK):
            index = allowed[begin : begin + CHUNK]
            values = backend.pick(rows.values, index)
            values = backend.form(letter.token, values if letter.sign > 0 else -values)
            left = (level.start + index).astype(np.int32)
            codes = np.full(len(index), number, dtype=np.uint8)
            yield Chunk(values, codes, left, left, rows.family[index] | np.uint8(letter.family))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Part of a level: value rows, families, and the numbers of the functions."""

    values: Any
    family: np.ndarray
    numbers: np.ndarray


def _rows(level: Level, part: slice | np.ndarray = slice(None)) -> _Rows:
    numbers = np.arange(level.start, level.start + len(level), dtype=np.int32)
    return _Rows(level.rows.values[part], level.rows.family[part], numbers[part])


def _constants(bank: Bank) -> _Rows:
    return _rows(bank.levels[0], slice(bank.columns, None))


def _operands(bank: Bank, level: Level, token: str) -> _Rows:
    """Give the functions that a two-argument letter makes something new of."""
    tokens = {letter.token for letter in bank.letters}
    first = level is bank.levels[0]
    if token in _SUMS:
        # The constants meet every function elsewhere.
        end = bank.columns if first else len(level)
        return _rows(level, slice(level.shifted if tokens >= _SUMS else 0, end))
    end = len(level) - level.inverted if tokens >= _PRODUCTS else len(level)
    if first and (token == "*" or "inv" in tokens):
        ones = [float(leaf) == 1 for leaf in bank.leaves[bank.columns :]]
        end = bank.columns + ones.index(True) if ones and all(ones) else end
    return _rows(level, slice(0, end))


def _form_binary(bank: Bank, first: Level, second: Level, backend: Backend) -> Iterator[Chunk]:
    for token in BINARY:
        if token not in _COMMUTES or first.start <= second.start:
            left = _operands(bank, first, token)
            right = left if first is second else _operands(bank, second, token)
            yield from _form_pairs(bank, token, left, right, backend)


def _form_pairs(
    bank: Bank, tokens: str, first: _Rows, second: _Rows, backend: Backend
) -> Iterator[Chunk]:
    """Form all pairs, of the symmetric letters on one level each pair once."""
    tall_all, wide_all = len(first.numbers), len(second.numbers)
    for number, letter in enumerate(bank.letters):
        if letter.token not in tokens or not tall_all or not wide_all:
            continue
        triangle = letter.token in _COMMUTES and first is second
        wide = min(wide_all, CHUNK)
        tall = max(1, CHUNK // wide)
        for begin in range(0, tall_all, tall):
            a = slice(begin, min(begin + tall, tall_all))
            for other in range(begin if triangle else 0, wide_all, wide):
                b = slice(other, min(other + wide, wide_all))
                values = backend.form(
                    letter.token, first.values[a][:, None, :], second.values[b][None, :, :]
                )
                yield _pairs(number, values, first, a, second, b)


def _pairs(number: int, values: Any, first: _Rows, a: slice, second: _Rows, b: slice) -> Chunk:
    tall, wide, rows = values.shape
    lefts, rights = np.repeat(first.numbers[a], wide), np.tile(second.numbers[b], tall)
    family = (first.family[a][:, None] | second.family[b][None, :]).ravel()
    codes = np.full(tall * wide, number, dtype=np.uint8)
    return Chunk(values.reshape(tall * wide, rows), codes, lefts, rights, family)


# The following say what is worth its memory, not what is looked at.
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
        powers_up_to: int,
    ) -> None:
        """Start with no level; ``X`` (probes, p) are the probe rows."""
        self.powers_up_to = powers_up_to
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
        """Bytes of stored functions and tables of hashes."""
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
        for chunk, projected, squares in self._measured(self._chunks(size), directions):
            index, new = self._look_at(chunk, projected, squares, screen, shortlist)
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

    def _measured(
        self, chunks: Iterator[Chunk], directions: Any
    ) -> Iterator[tuple[Chunk, np.ndarray, np.ndarray]]:
        """Give chunks with products (k, B) with the directions, and sums of squares (B,).

        However many are measured at once, they come one by one: all that is counted, and the order
        in which equals come, is the same on any device.
        """
        together = self.backend.together(CHUNK, self.rows)
        while batch := list(islice(chunks, together)):
            found = self.backend.measure([chunk.values for chunk in batch], directions)
            for chunk, (projected, squares) in zip(batch, found, strict=True):
                yield chunk, projected, squares

    def _look_at(
        self,
        chunk: Chunk,
        projected: np.ndarray,
        squares: np.ndarray,
        screen: Screen,
        shortlist: Shortlist,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Test the new functions of a chunk; give them, and which are new up to an affine map."""
        spread = Spread(projected, squares, self.rows)
        index = np.flatnonzero(spread.usable)
        spread = spread.take(index)
        if self.storing:
            new = self._enter(self._exact, spread.exact())
            index, spread = index[new], spread.take(new)
        fresh = self._enter(self._affine, spread.affine())
        tested = index[fresh]
        rows = self.backend.pick(chunk.values, tested) if self.formed < self.powers_up_to else None
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
