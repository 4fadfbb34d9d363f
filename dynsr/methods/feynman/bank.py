"""The bank: every distinct function met so far, by complexity, as one value row on probe points.

A function is a letter and the numbers of its arguments, so that a formula is written out only for
the winners.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy

from dynsr.expression import OPERATORS
from dynsr.methods.feynman.alphabet import LEAF, Letter


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
