"""Costs: the bits of formulas as those who know such laws would write them.

To the length of a formula come bits of what is unusual in it; what saturates is one function, what
terms or equations share is written once, and what hangs from an angle is written in its sine and
cosine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from typing import Any

import sympy

from dynsr.expression import added_bits, bits_in_force, expand_terms, plausibility_bits
from dynsr.fit import skeleton, structure_bits

# Bits of a power that is half of a whole one: of a root, and of any other.
_ROOT_BITS, _HALF_BITS = 2.0, 4.0
# Bits of an exponent to be fitted; at no half the prior of formulas counts them.
_FREE_BITS = 3.0
# Bits of a saturation in the ratio of two columns.
_SHARED_BITS = 3.0
# Share of a whole number within which a constant may be that.
_NEARLY = 0.05
# More terms may make up for a function that is none of theirs.
_PLAIN = 4
# Bits that a function costs beside its length: laws are mostly made of powers and their ratios.
FUNCTION_BITS = {
    sympy.log: 3.0,
    sympy.exp: 3.0,
    sympy.sin: 3.0,
    sympy.cos: 3.0,
    sympy.tanh: 5.0,
    sympy.Abs: 5.0,
}


@dataclass(frozen=True)
class _Kind:
    """Formulas that cost the same: they are ``alike`` in all but the sizes of their constants."""

    alike: Hashable
    expr: sympy.Expr = field(compare=False)

    @classmethod
    def of(cls, expr: sympy.Expr) -> _Kind:
        sizes: list[float] = []
        alike = _alike(expr, sizes)
        # Terms that hold the same constant may become one.
        return cls(alike if len(set(sizes)) == len(sizes) else expr, expr)


def _alike(node: sympy.Basic, sizes: list[float]) -> Hashable:
    """Give a formula with the signs alone of its constants, whose sizes are put in a list.

    What is whole, in an exponent or in a function is kept: its size may be unusual.
    """
    if node.is_Float:
        value = float(node)
        if value.is_integer():
            return node
        sizes.append(abs(value))
        return "positive" if value > 0 else "negative"
    if node.is_Add:
        return node.func, frozenset(Counter(_alike(a, sizes) for a in node.args).items())
    if node.is_Mul:
        return node.func, *(_alike(a, sizes) for a in node.args)
    return (node.func, _alike(node.base, sizes), node.exp) if node.is_Pow else node


def _once_a_kind(cost: Callable[..., float]) -> Callable[..., float]:
    """Count a formula's bits once for all that are of its kind, and for each of the user's own."""

    @lru_cache(maxsize=20_000)
    def counted(kind: _Kind, own: tuple[tuple[str, float], ...], *more: Hashable) -> float:
        return cost(kind.expr, *more)

    @wraps(cost)
    def count(expr: sympy.Expr, *more: Any) -> float:
        return counted(_Kind.of(expr), bits_in_force(), *map(tuple, more))

    return count


@_once_a_kind
def unusual_bits(expr: sympy.Expr, angles: Collection[str]) -> float:
    """Give the bits that the functions of a formula cost beside its length.

    Parameters
    ----------
    expr : the formula.
    angles : columns that may be angles.

    >>> x = sympy.Symbol("x")
    >>> unusual_bits(x / (1 + x), ()), unusual_bits(sympy.log(x), ())
    (0.0, 3.0)
    """
    functions = sum(FUNCTION_BITS.get(f.func, 3.0) for f in expr.atoms(sympy.Function))
    powers = expr.atoms(sympy.Pow)
    halves = [p.exp for p in powers if p.exp.is_Rational and p.exp.q == 2]
    functions += sum(_ROOT_BITS if p == sympy.S.Half else _HALF_BITS for p in halves)
    functions += _SHARED_BITS * sum(is_shared(p.base) for p in powers)
    # What is still to be fitted is no half, wherever it begins.
    functions += _FREE_BITS * sum(p.exp.is_Float and float(2 * p.exp).is_integer() for p in powers)
    return functions + plausibility_bits(expr, angles)


class saturation(sympy.Function):  # noqa: N801
    """What v^n / (v^n + k) and 1 / (v^n + k) are to who writes them often: one function."""


def shape_bits(expr: sympy.Expr) -> float:
    """Give the bits of the length of a formula as those who know such laws would write it.

    v / (k + v) is to rates what sin(v) is to angles: one function of a variable and a constant,
    and not a ratio of sums that somebody had to find. What all terms have in common is written
    once, as in x (a - b x - c y).

    Parameters
    ----------
    expr : the formula.

    >>> x = sympy.Symbol("x")
    >>> shape_bits(0.5 * x / (x + 1.5)) < structure_bits(0.5 * x / (x + 1.5)) - 5
    True
    >>> shape_bits(0.5 * x) == structure_bits(0.5 * x)
    True
    """
    return written_length(expr) + unwritten_bits(expr)


@_once_a_kind
def written_length(expr: sympy.Expr) -> float:
    """Give the bits of the length of a formula as :func:`as_written` has it.

    Parameters
    ----------
    expr : the formula.
    """
    return structure_bits(as_written(expr))


def unwritten_bits(expr: sympy.Expr) -> float:
    """Give the user's own bits of operations that :func:`as_written` says in other words.

    They are bits of the formula that is given, however shortly it may be written.

    Parameters
    ----------
    expr : the formula.
    """
    return added_bits(expr) - added_bits(as_written(expr)) if bits_in_force() else 0.0


def as_written(expr: sympy.Expr) -> sympy.Expr:
    """Write a formula in saturations, with a common factor before a bracket where that is shorter.

    Parameters
    ----------
    expr : the formula.

    >>> x, y = sympy.symbols("x y")
    >>> as_written(1.5 * x - 0.5 * x**2 - 2.5 * x * y / (y + 1.5))
    x*(-0.5*x - 2.5*saturation(y, 1.5) + 1.5)
    """
    named = in_saturations(expr)
    terms = sympy.Add.make_args(named)
    shared: set[sympy.Expr] = set.intersection(*(divisors(term) for term in terms))
    if len(terms) == 1 or not shared:
        return named
    outside = sympy.Mul(*shared)
    bracket = sympy.Mul(outside, sympy.Add(*[term / outside for term in terms]), evaluate=False)
    return min(named, bracket, key=structure_bits)


def divisors(term: sympy.Expr) -> set[sympy.Expr]:
    """Give the symbols and functions that a term may be divided by.

    Parameters
    ----------
    term : the term.
    """
    parts = (factor.as_base_exp() for factor in sympy.Mul.make_args(term))
    return {
        base for base, power in parts if power.is_positive and power >= 1 and not base.is_Number
    }


def in_saturations(expr: sympy.Expr) -> sympy.Expr:
    """Write a formula with :class:`saturation` for what saturates, and for what inhibits.

    Parameters
    ----------
    expr : the formula.

    >>> x, y = sympy.symbols("x y")
    >>> in_saturations(2.5 * x**2 * y / (x**2 + 1.5))
    2.5*y*saturation(x**2, 1.5)
    """
    if not any(p.exp is sympy.S.NegativeOne and p.base.is_Add for p in expr.atoms(sympy.Pow)):
        return expr
    return sympy.Add(*[_name_saturations(term) for term in sympy.Add.make_args(expr)])


def _name_saturations(term: sympy.Expr) -> sympy.Expr:
    for factor in sympy.Mul.make_args(term):
        below = 1 / factor
        # x y / (x + k y) is a saturation too, in the ratio of two columns.
        if is_shared(below):
            pair = sorted(below.free_symbols, key=lambda symbol: str(symbol.name))
            rest = term / factor / sympy.Mul(*pair)
            if not rest.as_numer_denom()[1].free_symbols & set(pair):
                k = next((a for a in factor.atoms(sympy.Float)), sympy.S.One)
                term = rest * saturation(pair[0], k * pair[1])
            continue
        line = saturating(below)
        if line is None:
            continue
        power, constant, _ = line
        rest = term / factor
        above = rest / power
        # Only a power that stands above the line is cancelled by it.
        cancelled = above.as_numer_denom()[1].free_symbols != power.free_symbols
        cancelled = cancelled and power.free_symbols <= rest.free_symbols
        term = (above if cancelled else rest) * saturation(power, constant)
    return term


def is_shared(below: sympy.Expr) -> bool:
    """Whether a line is a sum of two columns, as in x y / (x + k y).

    Parameters
    ----------
    below : what stands below a fraction line.
    """
    bodies = [a.as_coeff_Mul()[1] for a in below.args] if below.is_Add else []
    return len(bodies) == 2 and all(body.is_Symbol for body in bodies)


def saturating(below: sympy.Expr) -> tuple[sympy.Expr, sympy.Expr, sympy.Expr] | None:
    """Give v^n, k and c of a line k + c v^n; None for another.

    Parameters
    ----------
    below : what stands below a fraction line.
    """
    if not (below.is_Add and len(below.args) == 2 and any(a.is_Number for a in below.args)):
        return None
    constant = next(a for a in below.args if a.is_Number)
    coefficient, power = next(a for a in below.args if not a.is_Number).as_coeff_Mul()
    if constant * coefficient <= 0:
        # That has a pole, and is no saturation.
        return None
    base, exponent = power.as_base_exp()
    plain = base.is_Symbol and exponent.is_Number and exponent > 0
    return (power, constant, coefficient) if plain else None


def wide_factors(body: sympy.Expr) -> list[sympy.Expr]:
    """Give the shapes of the functions of several columns, and powers of their sums, in a term.

    Parameters
    ----------
    body : the term.

    >>> x, y = sympy.symbols("x y")
    >>> wide_factors(x**2 * sympy.exp(y) * abs(x - y))
    [Abs(x - y)]
    """
    wide = (
        skeleton(factor)
        for factor in sympy.Mul.make_args(body)
        if len(factor.free_symbols) > 1
        and (factor.is_Function or (factor.is_Pow and factor.base.is_Add))
    )
    return list(dict.fromkeys(wide))


def bodies_of(expr: sympy.Expr) -> list[sympy.Expr]:
    """Give the terms of a sum without their coefficients.

    Parameters
    ----------
    expr : the sum.

    >>> x, y = sympy.symbols("x y")
    >>> bodies_of(2.5 * x * y - 3 * x)
    [x, x*y]
    """
    return [term.as_coeff_Mul()[1] for term in sympy.Add.make_args(expr)]


def bare_terms(expr: sympy.Expr) -> set[sympy.Expr]:
    """Give the shapes of the terms of a sum, without their coefficients.

    Parameters
    ----------
    expr : the sum.
    """
    return set(map(skeleton, bodies_of(expand_terms(expr))))


def rounded(expr: sympy.Expr) -> sympy.Expr:
    """Give a formula with whole numbers for the constants inside its terms that are close to one.

    Parameters
    ----------
    expr : the formula.

    >>> x = sympy.Symbol("x")
    >>> rounded(2.0 * x**0.98 - sympy.tanh(1.02 * x))
    2.0*x - tanh(x)
    """
    found = []
    for term in sympy.Add.make_args(expr):
        coefficient, body = term.as_coeff_Mul()
        whole = {c: sympy.Integer(round(c)) for c in body.atoms(sympy.Float)}
        near = {c: n for c, n in whole.items() if n and abs(c - n) <= _NEARLY * abs(n)}
        found.append(coefficient * body.xreplace(near))
    return sympy.Add(*found)


def is_plain(expr: sympy.Expr) -> bool:
    """Whether a formula is a polynomial of few terms.

    Parameters
    ----------
    expr : the formula.
    """
    few = len(sympy.Add.make_args(expr)) <= _PLAIN
    return few and bool(expr.is_polynomial(*expr.free_symbols))
