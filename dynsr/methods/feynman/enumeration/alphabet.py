"""The letters that the brute-force search builds functions from, and how many strings they make.

A function and its negative are one building block. That loses nothing: ``+`` and ``-`` are both
tried, the odd and even functions and products carry a sign outward, and the functions that do
not (exp, sqrt, log) are applied to both signs as two letters.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import sympy

from dynsr.errors import InputError
from dynsr.expression import OPERATORS

BINARY = ("+", "-", "*", "/")
PLAIN = ("inv", "square", "abs")
# A function of one family is not nested inside another of the same: no sin(x + cos(y)).
FAMILIES = {
    **dict.fromkeys(("sin", "cos", "tan", "asin", "acos", "atan"), 1),
    **dict.fromkeys(("exp", "log", "sinh", "cosh", "tanh"), 2),
}
BOTH_SIGNS = ("exp",)
ONE_SIGN = ("sqrt", "log")
UNARY = (*PLAIN, "sqrt", *FAMILIES)
LEAF = 255


@dataclass(frozen=True)
class Letter:
    """One operator of the enumeration: ``token`` applied to ``sign`` times its argument."""

    token: str
    sign: int = 1

    @property
    def arity(self) -> int:
        """How many arguments it takes."""
        return OPERATORS[self.token].arity

    @property
    def family(self) -> int:
        """Bit of the family that must not be nested in itself; 0 for none."""
        return FAMILIES.get(self.token, 0)

    def build(self, *arguments: sympy.Expr) -> sympy.Expr:
        """Apply it to SymPy expressions."""
        first, *rest = arguments
        return OPERATORS[self.token].sympy(self.sign * first, *rest)


def make_letters(operators: Sequence[str], nested: bool) -> tuple[tuple[Letter, ...], bool]:
    """Give the letters of operator tokens; raises InputError for a token that has none."""
    letters: list[Letter] = []
    for token in operators:
        if token not in BINARY and token not in UNARY:
            known = ", ".join((*BINARY, *UNARY))
            raise InputError(f"operator {token!r} cannot be enumerated; those that can: {known}")
        letters.append(Letter(token))
        if token in BOTH_SIGNS or token in ONE_SIGN:
            letters.append(Letter(token, -1))
    return tuple(dict.fromkeys(letters)), nested


def count_strings(letters: Sequence[Letter], leaves: int, length: int, nested: bool) -> int:
    """Count the strings in reverse Polish notation of up to ``length`` letters.

    By the recurrence over the length and the families used: a string is a leaf, a one-argument
    letter behind a string one shorter, or a two-argument letter behind two strings.

    >>> count_strings([Letter("+"), Letter("sin")], 2, 3, nested=True)
    10
    """
    counts: list[dict[int, int]] = [{}, {0: leaves}]
    binary = sum(letter.arity == 2 for letter in letters)
    families = [letter.family for letter in letters if letter.arity == 1]
    for size in range(2, length + 1):
        level: dict[int, int] = defaultdict(int)
        for used, number in counts[size - 1].items():
            for family in families:
                if nested or not used & family:
                    level[used | family] += number
        for left in range(1, size - 1):
            for used, number in counts[left].items():
                for other, times in counts[size - 1 - left].items():
                    level[used | other] += binary * number * times
        counts.append(dict(level))
    return sum(sum(level.values()) for level in counts[: length + 1])
