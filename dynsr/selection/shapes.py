"""Shapes: the terms and functions that formulas are made of, whatever their constants are."""

from __future__ import annotations

import sympy

from dynsr.expression import expand_terms, skeleton
from dynsr.fit import FIT

# More terms may compensate for a function that is none of theirs.
_PLAIN = 4


def wide_factors(body: sympy.Expr) -> list[sympy.Expr]:
    """Give the shapes of the functions of several columns, and powers of their sums, in a term.

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
    """Give the shapes of the terms of a sum, without their coefficients."""
    return set(map(skeleton, bodies_of(expand_terms(expr))))


def rounded(expr: sympy.Expr) -> sympy.Expr:
    """Give a formula with whole numbers for the constants inside its terms that are close to one.

    >>> x = sympy.Symbol("x")
    >>> rounded(2.0 * x**0.98 - sympy.tanh(1.02 * x))
    2.0*x - tanh(x)
    """
    found = []
    for term in sympy.Add.make_args(expr):
        coefficient, body = term.as_coeff_Mul()
        whole = {c: sympy.Integer(round(c)) for c in body.atoms(sympy.Float)}
        near = {c: n for c, n in whole.items() if n and abs(c - n) <= FIT.near * abs(n)}
        found.append(coefficient * body.xreplace(near))
    return sympy.Add(*found)


def is_plain(expr: sympy.Expr) -> bool:
    """Whether a formula is a polynomial of few terms."""
    few = len(sympy.Add.make_args(expr)) <= _PLAIN
    return few and bool(expr.is_polynomial(*expr.free_symbols))
