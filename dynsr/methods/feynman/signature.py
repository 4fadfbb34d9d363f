"""Telling functions apart by their values: sketches, hashes and a table of those seen.

A function is known by random projections of its values on the probe rows. Two functions whose
projections agree to ROUNDING of their norm are taken for one. Projections on directions that sum
to zero do not see an added constant, so the same numbers also tell functions apart up to an
affine map.
"""

from __future__ import annotations

import numpy as np

ROUNDING = 1e-9
AFFINE_ROUNDING = 1e-7
SKETCHES = 3
# A row whose spread is below this part of its norm is a constant with rounding errors on top.
CONSTANT = 1e-4
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


def hash_integers(columns: np.ndarray) -> np.ndarray:
    """Mix (rows, k <= 4) whole numbers, held as floats, into one uint64 a row, never 0."""
    whole = columns.astype(np.int64).view(np.uint64)
    mixed = np.zeros(len(columns), dtype=np.uint64)
    for column, odd in zip(whole.T, _ODD, strict=False):
        mixed = (mixed ^ (mixed >> np.uint64(29))) * _ODD[3] + column * odd
    mixed ^= mixed >> np.uint64(32)
    mixed *= _ODD[0]
    mixed ^= mixed >> np.uint64(29)
    return np.maximum(mixed, np.uint64(1))


class Spread:
    """Mean, norm and spread of value rows, from their projections and sums of squares.

    ``usable`` marks the rows that are finite, not constant and of sane size.
    """

    def __init__(self, projections: np.ndarray, squares: np.ndarray, rows: int) -> None:
        """Take (B, 1 + SKETCHES) projections and (B,) sums of squares."""
        self.total = projections[:, 0]
        self.sketches = projections[:, 1 : 1 + SKETCHES]
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
        signed = np.where(self.sketches[:, 0] < 0, -1.0, 1.0) / (ROUNDING * norm)
        parts = np.column_stack(
            [
                self.total * signed,
                self.sketches[:, 0] * signed,
                self.sketches[:, 1] * signed,
                np.log(norm) / ROUNDING,
            ]
        )
        return hash_integers(np.rint(parts))

    def affine(self) -> np.ndarray:
        """Hash each function g up to c g + d."""
        signed = np.where(self.sketches[:, 0] < 0, -1.0, 1.0) / np.sqrt(self.variance)
        return hash_integers(np.rint(self.sketches * (signed / AFFINE_ROUNDING)[:, None]))

    def take(self, index: np.ndarray) -> Spread:
        """Give some rows."""
        part = Spread.__new__(Spread)
        for name in ("total", "sketches", "squares", "variance", "usable"):
            setattr(part, name, getattr(self, name)[index])
        return part


class Seen:
    """A set of hashes with bulk insertion: open addressing in one array.

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
        self.owner = np.zeros(1 << bits, dtype=np.int32)

    def __len__(self) -> int:
        """Count the hashes."""
        return self.count

    @property
    def nbytes(self) -> int:
        """Bytes in use."""
        return self.table.nbytes + self.owner.nbytes

    def must_grow(self, more: int) -> bool:
        """Whether ``more`` hashes would fill more than half of the table."""
        return 2 * (self.count + more) > len(self.table)

    def has(self, hashes: np.ndarray) -> np.ndarray:
        """Give which hashes were added before, without adding any."""
        known = np.zeros(len(hashes), dtype=bool)
        left = np.arange(len(hashes))
        slots = (hashes >> np.uint64(64 - self.bits)).astype(np.int64)
        while len(left):
            held = self.table[slots]
            known[left[held == hashes[left]]] = True
            going = (held != 0) & (held != hashes[left])
            left, slots = left[going], (slots[going] + 1) & (len(self.table) - 1)
        return known

    def add(self, hashes: np.ndarray) -> np.ndarray:
        """Add hashes (none of them 0); give which were new, the first of equals counting."""
        while self.must_grow(len(hashes)):
            held = self.table[self.table != 0]
            self._allocate(self.bits + 1)
            self.add(held)
        new = np.zeros(len(hashes), dtype=bool)
        left = np.arange(len(hashes), dtype=np.int32)
        slots = (hashes >> np.uint64(64 - self.bits)).astype(np.int64)
        mask = len(self.table) - 1
        while len(left):
            empty = np.flatnonzero(self.table[slots] == 0)
            place, who = slots[empty], left[empty]
            self.owner[place[::-1]] = who[::-1]
            won = self.owner[place] == who
            self.table[place[won]] = hashes[who[won]]
            new[who[won]] = True
            differs = self.table[slots] != hashes[left]
            left, slots = left[differs], (slots[differs] + 1) & mask
        self.count += int(new.sum())
        return new
