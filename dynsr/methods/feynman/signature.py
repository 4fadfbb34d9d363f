"""Telling functions apart by their values: sketches, hashes and a table of those seen.

A function is known by random projections of its values on the probe rows. Two functions whose
projections agree to ROUNDING of their norm are taken for one. Projections on directions that sum
to zero do not see an added constant, so the same numbers also tell functions apart up to an
affine map.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

ROUNDING = 1e-9
AFFINE_ROUNDING = 1e-7
SKETCHES = 3
# A row whose spread is below this part of its norm is a constant with rounding errors on top.
CONSTANT = 1e-4
# Hashes moved at once when the table grows.
_REHASHED = 1 << 16
LARGEST, SMALLEST = 1e10, 1e-10
_ODD = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93],
    dtype=np.uint64,
)


def sketch_directions(rows: int, seed: int) -> np.ndarray:
    """Give (rows, 1 + SKETCHES) directions: ones, then random ones that sum to zero."""
    random = np.random.default_rng(seed).standard_normal((rows, SKETCHES))
    random -= random.mean(axis=0)
    return np.column_stack([np.ones(rows), random / np.linalg.norm(random, axis=0)])


def hash_integers(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Mix k <= 4 arrays of whole numbers, held as floats, into one array of uint64, never 0."""
    mixed = np.zeros(len(parts[0]), dtype=np.uint64)
    for part, odd in zip(parts, _ODD, strict=False):
        mixed = (mixed ^ (mixed >> np.uint64(29))) * _ODD[3] + part.astype(np.int64).view(
            "u8"
        ) * odd
    mixed ^= mixed >> np.uint64(32)
    mixed *= _ODD[0]
    mixed ^= mixed >> np.uint64(29)
    return np.maximum(mixed, np.uint64(1))


class Spread:
    """Mean, norm and spread of value rows, from their projections and sums of squares.

    ``usable`` marks the rows that are finite, not constant and of sane size.
    """

    def __init__(self, projections: np.ndarray, squares: np.ndarray, rows: int) -> None:
        """Take (1 + SKETCHES or more, B) projections and (B,) sums of squares."""
        self.total = projections[0]
        self.sketches = projections[1 : 1 + SKETCHES]
        self.squares = squares
        self.variance = squares - self.total**2 / rows
        self.usable = (
            (squares < LARGEST**2 * rows)
            & (squares > SMALLEST**2 * rows)
            & (self.variance > CONSTANT**2 * squares)
        )

    def exact(self) -> np.ndarray:
        """Hash each function up to its sign."""
        norm = np.sqrt(self.squares)
        signed = np.copysign(1 / (ROUNDING * norm), self.sketches[0])
        first, second = self.sketches[0] * signed, self.sketches[1] * signed
        parts = (self.total * signed, first, second, np.log(norm) / ROUNDING)
        return hash_integers([np.rint(part) for part in parts])

    def affine(self) -> np.ndarray:
        """Hash each function g up to c g + d."""
        signed = np.copysign(1 / (AFFINE_ROUNDING * np.sqrt(self.variance)), self.sketches[0])
        return hash_integers([np.rint(sketch * signed) for sketch in self.sketches])

    def take(self, index: np.ndarray) -> Spread:
        """Give some rows."""
        part = Spread.__new__(Spread)
        for name in ("total", "squares", "variance", "usable"):
            setattr(part, name, getattr(self, name)[index])
        part.sketches = self.sketches[:, index]
        return part


class Seen:
    """A set of hashes with bulk insertion: open addressing in one array.

    A hash's place is given by its highest bits, so that sorted hashes go through the table in
    order, which memory likes.

    >>> seen = Seen()
    >>> seen.add(np.array([7, 8, 7], dtype=np.uint64)).tolist()
    [True, True, False]
    >>> seen.add(np.array([8, 9], dtype=np.uint64)).tolist()
    [False, True]
    """

    def __init__(self, bits: int = 16) -> None:
        """Make a table of 2^bits places."""
        self._allocate(bits)

    def _allocate(self, bits: int) -> None:
        self.bits, self.count = bits, 0
        self.table = np.zeros(1 << bits, dtype=np.uint64)

    def __len__(self) -> int:
        """Count the hashes."""
        return self.count

    @property
    def nbytes(self) -> int:
        """Bytes in use."""
        return self.table.nbytes

    def must_grow(self, more: int) -> bool:
        """Whether ``more`` hashes would fill more than 5/8 of the table."""
        return 8 * (self.count + more) > 5 * len(self.table)

    def has(self, hashes: np.ndarray) -> np.ndarray:
        """Give which hashes were added before, without adding any."""
        known = np.zeros(len(hashes), dtype=bool)
        left, slots = np.arange(len(hashes)), self._slots(hashes)
        while len(left):
            held = self.table[slots]
            known[left[held == hashes[left]]] = True
            going = (held != 0) & (held != hashes[left])
            left, slots = left[going], (slots[going] + 1) & (len(self.table) - 1)
        return known

    def add(self, hashes: np.ndarray) -> np.ndarray:
        """Add hashes (none of them 0); give which were new, the first of equals counting."""
        new = np.zeros(len(hashes), dtype=bool)
        if not len(hashes):
            return new
        while self.must_grow(len(hashes)):
            held = self.table[self.table != 0]
            self._allocate(self.bits + 2)
            for begin in range(0, len(held), _REHASHED):
                self._place(held[begin : begin + _REHASHED])
        order = np.argsort(hashes)
        ordered = hashes[order]
        starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
        firsts = np.minimum.reduceat(order, starts)
        new[firsts[self._place(ordered[starts])]] = True
        return new

    def _slots(self, hashes: np.ndarray) -> np.ndarray:
        return (hashes >> np.uint64(64 - self.bits)).astype(np.int64)

    def _place(self, hashes: np.ndarray) -> np.ndarray:
        """Put distinct hashes into the table; give which were not there."""
        table, mask = self.table, len(self.table) - 1
        new = np.zeros(len(hashes), dtype=bool)
        left, slots = np.arange(len(hashes)), self._slots(hashes)
        while len(left):
            mine, held = hashes[left], table[slots]
            empty = np.flatnonzero(held == 0)
            table[slots[empty]] = mine[empty]
            # Of several that want one empty place the last has written; the others go on.
            won = empty[table[slots[empty]] == mine[empty]]
            new[left[won]] = True
            going = held != mine
            going[won] = False
            left, slots = left[going], (slots[going] + 1) & mask
        self.count += int(np.count_nonzero(new))
        return new
