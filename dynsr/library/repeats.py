"""Repeats: where a system has a term again, or a part of a term with constants inside.

What leaves one species enters another: s' = -k s x / (m + s) and x' = k s x / (m + s) - d x have
the term again, and the part 1/(m + s) with the constant inside it. Textbooks often give both the
same constants (stoichiometry); how often is a choice of the prior.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import sympy

from dynsr.expression import free_constants

INSIDE = "same inside"
# Choices by what a term is that an earlier equation has too: a column, a product of columns, or
# with a function.
FACTORS = ("same factor of a column", "same factor of a product", "same factor of a function")


@dataclass(frozen=True)
class Repeat:
    """Constants that may be those of an earlier place of the same form.

    Parameters
    ----------
    choice : the choice of the prior: INSIDE, or one of FACTORS.
    own : numbers of the constants, as they appear in the system.
    earlier : the same of each earlier place.
    """

    choice: str
    own: tuple[int, ...]
    earlier: tuple[tuple[int, ...], ...]


def find_repeats(exprs: Mapping[str, sympy.Expr]) -> Iterator[Repeat]:
    """Give the constants of a system whose form was there before, in their order.

    Factors are compared with those in other equations, constants inside with those in the same
    equation too.

    Parameters
    ----------
    exprs : state -> equation, its constants floats.

    >>> s, x = sympy.symbols("s x")
    >>> uptake = s * x / (s + 0.4)
    >>> for repeat in find_repeats({"s": -1.5 * uptake, "x": 0.7 * uptake}):
    ...     print(repeat)
    Repeat(choice='same inside', own=(3,), earlier=((1,),))
    Repeat(choice='same factor of a function', own=(2,), earlier=((0,),))
    """
    inside: dict[sympy.Expr, list[tuple[int, ...]]] = {}
    factors: dict[sympy.Expr, list[tuple[int, ...]]] = {}
    first = 0
    for expr in exprs.values():
        template, values = free_constants(expr, "constant ")
        places = {symbol: first + i for i, symbol in enumerate(values)}
        like = dict.fromkeys(places, sympy.pi)
        anew: list[tuple[sympy.Expr, tuple[int, ...]]] = []
        for term in sympy.Add.make_args(template):
            parts = sympy.Mul.make_args(term)
            for part in parts:
                own = tuple(sorted(places[c] for c in part.free_symbols & places.keys()))
                if own and part not in places and not part.is_Add:
                    shape = part.xreplace(like)
                    if shape in inside:
                        yield Repeat(INSIDE, own, tuple(inside[shape]))
                    inside.setdefault(shape, []).append(own)
            body = sympy.Mul(*[part for part in parts if part not in places]).xreplace(like)
            number = tuple(places[part] for part in parts if part in places)
            if number and body.free_symbols:
                anew.append((body, number))
                if body in factors:
                    yield Repeat(_kind(body), number, tuple(factors[body]))
        for body, number in anew:
            factors.setdefault(body, []).append(number)
        first += len(places)


def _kind(body: sympy.Expr) -> str:
    """Give the choice of the factor of a term."""
    if body.is_Symbol:
        return FACTORS[0]
    powers = (part.as_base_exp() for part in sympy.Mul.make_args(body))
    return FACTORS[1] if all(b.is_Symbol and e.is_number for b, e in powers) else FACTORS[2]
