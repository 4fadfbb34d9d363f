"""Bottom-up formation: all functions of one complexity from the stored simpler ones, in batches."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynsr.methods.feynman.alphabet import LEAF
from dynsr.methods.feynman.backend import Backend
from dynsr.methods.feynman.bank import Bank, Chunk, Level

CHUNK = 16384
_COMMUTES = ("+", "*", "-")  # a - b and b - a are one function up to sign


def form_leaves(values: np.ndarray, backend: Backend) -> Chunk:
    """Give the functions of complexity 1 from (leaves, rows) values."""
    places = np.arange(len(values), dtype=np.int32)
    kinds = np.full(len(values), LEAF, dtype=np.uint8)
    return Chunk(backend.put(values), kinds, places, places, np.zeros(len(values), dtype=np.uint8))


def form_level(bank: Bank, size: int, nested: bool, backend: Backend) -> Iterator[Chunk]:
    """Form every function of ``size`` letters whose arguments are stored, chunk by chunk.

    One-argument letters on level size - 1; two-argument letters on every pair of levels that adds
    up to size - 1, the symmetric ones once.
    """
    levels = bank.levels
    if size - 2 < len(levels):
        yield from _form_unary(bank, levels[size - 2], nested, backend)
    for one in range(1, size - 1):
        other = size - 1 - one
        if one <= len(levels) and other <= len(levels):
            yield from _form_binary(bank, levels[one - 1], levels[other - 1], backend)


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


def _form_unary(bank: Bank, level: Level, nested: bool, backend: Backend) -> Iterator[Chunk]:
    rows = level.rows
    for number, letter in enumerate(bank.letters):
        if letter.arity != 1:
            continue
        allowed = np.arange(len(rows))
        if not nested and letter.family:
            allowed = allowed[(rows.family & letter.family) == 0]
        for begin in range(0, len(allowed), CHUNK):
            index = allowed[begin : begin + CHUNK]
            values = backend.pick(rows.values, index)
            values = backend.apply(letter.token, values if letter.sign > 0 else -values)
            left = (level.start + index).astype(np.int32)
            kinds = np.full(len(index), number, dtype=np.uint8)
            yield Chunk(values, kinds, left, left, rows.family[index] | np.uint8(letter.family))


def _form_binary(bank: Bank, first: Level, second: Level, backend: Backend) -> Iterator[Chunk]:
    for number, letter in enumerate(bank.letters):
        if letter.arity != 2 or not len(first) or not len(second):
            continue
        once = letter.token in _COMMUTES
        if once and first.start > second.start:
            continue
        triangle = once and first is second
        wide = min(len(second), CHUNK)
        tall = max(1, CHUNK // wide)
        for begin in range(0, len(first), tall):
            a = slice(begin, min(begin + tall, len(first)))
            for other in range(begin if triangle else 0, len(second), wide):
                b = slice(other, min(other + wide, len(second)))
                yield _pairs(number, letter.token, first, a, second, b, backend)


def _pairs(
    number: int, token: str, first: Level, a: slice, second: Level, b: slice, backend: Backend
) -> Chunk:
    left, right = first.rows.values[a], second.rows.values[b]
    values = backend.apply(token, left[:, None, :], right[None, :, :])
    tall, wide, rows = values.shape
    lefts = np.repeat(np.arange(a.start, a.stop, dtype=np.int32) + np.int32(first.start), wide)
    rights = np.tile(np.arange(b.start, b.stop, dtype=np.int32) + np.int32(second.start), tall)
    family = (first.rows.family[a][:, None] | second.rows.family[b][None, :]).ravel()
    kinds = np.full(tall * wide, number, dtype=np.uint8)
    return Chunk(values.reshape(tall * wide, rows), kinds, lefts, rights, family)
