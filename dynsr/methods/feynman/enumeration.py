"""Bottom-up formation: all functions of one complexity from the stored simpler ones, in batches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynsr.methods.feynman.alphabet import BINARY, LEAF, ONE_SIGN
from dynsr.methods.feynman.backend import Backend
from dynsr.methods.feynman.bank import Bank, Chunk, Level

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
