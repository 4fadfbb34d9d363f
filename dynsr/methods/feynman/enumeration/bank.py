"""The bank: every distinct function met so far, by complexity, as one value row on probe points.

Functions are distinguished by their values: sketches, hashes and a table of those seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy

from dynsr.expression import OPERATORS
from dynsr.methods.feynman.enumeration.alphabet import LEAF, Letter

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
    """Mix k <= 4 arrays of whole numbers, kept as floats, into one array of uint64, never 0."""
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


@dataclass(frozen=True, eq=False)
class Chunk:
    """Functions formed together: value rows, letter numbers, arguments and families used."""

    values: Any
    letter: np.ndarray
    left: np.ndarray
    right: np.ndarray
    family: np.ndarray

    def __len__(self) -> int:
        """Count the functions."""
        return len(self.letter)

    def labels(self, index: np.ndarray) -> Labels:
        """Give letters, arguments and families of some of them."""
        return self.letter[index], self.left[index], self.right[index], self.family[index]


Labels = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def join_labels(pieces: Sequence[Labels]) -> Labels:
    """Put letters, left and right arguments and families of several pieces below each other."""
    kinds = (np.uint8, np.int32, np.int32, np.uint8)
    return tuple(  # type: ignore[return-value]
        np.concatenate([np.empty(0, dtype=kind), *(piece[k] for piece in pieces)])
        for k, kind in enumerate(kinds)
    )


@dataclass(frozen=True, eq=False)
class Level:
    """The stored functions of one complexity; ``start`` is the number of the first.

    ``fresh`` marks those that are no affine map of an earlier function. The first ``shifted``
    ones are functions plus a constant, the last ``inverted`` ones reciprocals.
    """

    start: int
    rows: Chunk
    fresh: np.ndarray
    shifted: int = 0
    inverted: int = 0

    def __len__(self) -> int:
        """Count the functions."""
        return len(self.rows)


@dataclass
class Bank:
    """Levels 1, 2, ... of stored functions; numbers run through all levels.

    Winners that are not stored get negative numbers in ``extra``.
    """

    letters: tuple[Letter, ...]
    leaves: tuple[sympy.Expr, ...]
    columns: int
    levels: list[Level] = field(default_factory=list)
    extra: list[tuple[int, int, int]] = field(default_factory=list)
    _extra_numbers: dict[tuple[int, int, int], int] = field(default_factory=dict)

    def __len__(self) -> int:
        """Count the stored functions."""
        return sum(len(level) for level in self.levels)

    def append(self, rows: Chunk, fresh: np.ndarray) -> None:
        """Put the next level on, formed in the order that form_level keeps."""
        tokens = np.array([letter.token for letter in self.letters] + ["leaf"])
        kinds = tokens[np.minimum(rows.letter, len(self.letters))]
        # Level 1 holds the leaves, the constants last.
        first, last = self.columns, len(self.leaves)
        shift = np.isin(kinds, ("+", "-"))
        shift &= ((rows.left >= first) & (rows.left < last)) | (
            (rows.right >= first) & (rows.right < last)
        )
        counts = (int(np.count_nonzero(marks)) for marks in (shift, kinds == "inv"))
        self.levels.append(Level(len(self), rows, fresh, *counts))

    def number(self, letter: int, left: int, right: int) -> int:
        """Give an unstored function a (negative) number."""
        key = (int(letter), int(left), int(right))
        if key not in self._extra_numbers:
            self.extra.append(key)
            self._extra_numbers[key] = -len(self.extra)
        return self._extra_numbers[key]

    def node(self, number: int) -> tuple[int, int, int]:
        """Give the letter and arguments of a function; for a leaf LEAF and its place."""
        if number < 0:
            return self.extra[-number - 1]
        for level in self.levels:
            if number < level.start + len(level):
                i, rows = number - level.start, level.rows
                return int(rows.letter[i]), int(rows.left[i]), int(rows.right[i])
        raise IndexError(number)

    def fold(self, number: int, leaf: Callable[[int], Any], apply: Callable[..., Any]) -> Any:
        """Build the value of a function from its leaves by ``apply(letter, *arguments)``."""
        letter, left, right = self.node(number)
        if letter == LEAF:
            return leaf(left)
        first = self.fold(left, leaf, apply)
        if self.letters[letter].arity == 1:
            return apply(self.letters[letter], first)
        return apply(self.letters[letter], first, self.fold(right, leaf, apply))

    def size(self, number: int) -> int:
        """Count the letters of a function."""
        return self.fold(number, lambda place: 1, lambda letter, *sizes: 1 + sum(sizes))

    def expression(self, number: int) -> sympy.Expr:
        """Write a function as a SymPy expression."""
        return self.fold(number, self.leaves.__getitem__, lambda letter, *a: letter.build(*a))

    def leaf_values(self, X: np.ndarray) -> np.ndarray:
        """(leaves, n) values of the variables, then of the constants, at rows of variables."""
        constants = [np.full(len(X), float(leaf)) for leaf in self.leaves[self.columns :]]
        return np.array([*X.T, *constants])

    def evaluate_all(self, X: np.ndarray, levels: int) -> np.ndarray:
        """Evaluate every function of the first levels, (n, p) -> (m, n); NaN outside domains."""
        count = sum(len(level) for level in self.levels[:levels])
        values = np.empty((count, len(X)))
        with np.errstate(all="ignore"):
            for level in self.levels[:levels]:
                rows, block = level.rows, slice(level.start, level.start + len(level))
                values[block][rows.letter == LEAF] = self.leaf_values(X)[
                    rows.left[rows.letter == LEAF]
                ]
                for number, letter in enumerate(self.letters):
                    mine = np.flatnonzero(rows.letter == number)
                    if len(mine):
                        first = letter.sign * values[rows.left[mine]]
                        rest = [values[rows.right[mine]]] if letter.arity == 2 else []
                        apply = OPERATORS[letter.token].numpy
                        values[level.start + mine] = apply(first, *rest)
        return values

    def evaluate(self, number: int, X: np.ndarray) -> np.ndarray:
        """Evaluate a function on rows of variables, (n, p) -> (n,)."""
        values = self.leaf_values(X)

        def leaf(place: int) -> np.ndarray:
            return values[place]

        def apply(letter: Letter, first: np.ndarray, *rest: np.ndarray) -> np.ndarray:
            return OPERATORS[letter.token].numpy(first if letter.sign > 0 else -first, *rest)

        with np.errstate(all="ignore"):
            return self.fold(number, leaf, apply)
