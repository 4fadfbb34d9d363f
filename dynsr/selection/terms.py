"""Terms: products of columns, and sums of terms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations_with_replacement

import numpy as np
import sympy


def move_inside(term: sympy.Expr, shift: float) -> sympy.Expr:
    """Multiply the one constant inside a term by exp(shift).

    Parameters
    ----------
    term, shift : the term, and the logarithm.
    """
    return term.xreplace({c: c * sympy.Float(np.exp(shift)) for c in term.atoms(sympy.Float)})


def products(names: Sequence[str], degree: int) -> list[sympy.Expr]:
    """Give the products of one variable up to as many as the degree says.

    Parameters
    ----------
    names, degree : the variables, and how many a product has at most.
    """
    symbols = [sympy.Symbol(name) for name in names]
    degrees = range(1, degree + 1)
    chosen = (c for power in degrees for c in combinations_with_replacement(symbols, power))
    return list(dict.fromkeys(sympy.Mul(*c) for c in chosen))


def weighted_sum(values: Iterable[float], exprs: Iterable[sympy.Expr]) -> sympy.Expr:
    """Give the sum of terms, each times its coefficient.

    Parameters
    ----------
    values, exprs : as many coefficients as terms.
    """
    return sympy.Add(*[sympy.Float(c) * e for c, e in zip(values, exprs, strict=True)])
