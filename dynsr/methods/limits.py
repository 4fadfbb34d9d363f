"""Limits: what the user allows and adds in the search for one equation, as a method takes it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import sympy

from dynsr.expression import Vocabulary

# A term costs at least its constant, its column, a product and a sum, of four kinds: 2 bits each.
_BITS_OF_TERM = 8.0


@dataclass(frozen=True)
class Limits:
    """What a search may use.

    Parameters
    ----------
    vocabulary : functions and operators; None leaves the method its own.
    terms : terms of the user's own, in the columns of the samples.
    left_out : terms that the equation must not have.
    max_complexity : most bits of a formula, each fitted constant counted as one symbol.

    >>> Limits(max_complexity=20.0).most_terms(6)
    3
    """

    vocabulary: Vocabulary | None = None
    terms: tuple[sympy.Expr, ...] = ()
    left_out: tuple[sympy.Expr, ...] = ()
    max_complexity: float = math.inf

    def most_terms(self, own: int) -> int:
        """Give how many terms a formula may have; ``own`` is the method's bound.

        A term costs eight bits at least, but for a first one that may be a bare number.
        """
        if math.isinf(self.max_complexity):
            return own
        return max(1, min(own, 1 + int(self.max_complexity / _BITS_OF_TERM)))

    def functions(self, own: Iterable[str]) -> tuple[str, ...]:
        """Give the functions of one argument to search with.

        Parameters
        ----------
        own : those that the method uses where the user names none.
        """
        return tuple(own) if self.vocabulary is None else self.vocabulary.functions

    def tokens(self, own: Iterable[str], possible: Iterable[str]) -> tuple[str, ...]:
        """Give tokens of operators to search with: the method's allowed ones, then those asked for.

        Parameters
        ----------
        own : tokens that the method uses where the user names none.
        possible : tokens that it could use.
        """
        if self.vocabulary is None:
            return tuple(own)
        kept = [token for token in own if self.vocabulary.has(token)]
        asked = [token for token in possible if token in self.vocabulary.functions]
        return tuple(dict.fromkeys([*kept, *asked]))

    @property
    def check(self) -> Callable[[sympy.Expr], bool] | None:
        """What says whether a term may enter a library; None where all may."""
        return self.allow if self.left_out or self.vocabulary is not None else None

    def allow(self, expr: sympy.Expr) -> bool:
        """Whether a term may enter a library."""
        if expr in self.left_out:
            return False
        return self.vocabulary is None or self.vocabulary.allows(expr)
