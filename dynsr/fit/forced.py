"""Forced terms: those that an equation must hold, with coefficients that are fitted."""

from __future__ import annotations

from collections.abc import Iterable

import sympy

from dynsr.expression import bare_term, expand_terms, skeleton


def missing_terms(expr: sympy.Expr, terms: Iterable[sympy.Expr]) -> list[sympy.Expr]:
    """Give the terms that a formula, multiplied out, does not hold; floats in them are free.

    Parameters
    ----------
    expr : the formula.
    terms : terms without their coefficients; 1 is the constant term.

    >>> x, y = sympy.symbols("x y")
    >>> missing_terms(x * (0.5 - y), [x, x * y, sympy.S.One])
    [1]
    """
    wanted = list(terms)
    if not wanted:
        return []
    held = {
        skeleton(bare_term(term)) for term in sympy.Add.make_args(expand_terms(expr)) if term != 0
    }
    return [term for term in wanted if skeleton(term) not in held]
