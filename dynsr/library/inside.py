"""Inside: how the constants inside a formula compare with the columns that they go with.

In x / (x + K) the half-saturation K is about as large as x: far above it the term is a line, and
far below it a constant. In exp(-k x) it is 1/k that is as large as x.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import sympy

_TIME = sympy.Symbol("t")


def constants_inside(expr: sympy.Expr) -> Iterator[tuple[float, sympy.Expr]]:
    """Give what is added to a constant inside a term, or multiplied by it, with the constant.

    Of a factor it is the inverse, so that both are of one size where the constant is usual. What
    contains nothing but the time is left out: how fast an input turns is independent of how long
    one measures.

    Parameters
    ----------
    expr : a sum of terms, its constants floats.

    >>> x = sympy.Symbol("x")
    >>> list(constants_inside(2.0 * x / (x + 0.5))), list(constants_inside(sympy.exp(-4.0 * x)))
    ([(0.5, x)], [(0.25, x)])
    """
    for term in sympy.Add.make_args(expr):
        for part in sympy.Mul.make_args(term):
            for node in sympy.preorder_traversal(part):
                for constant, rest in _constants_of(node):
                    if rest.free_symbols - {_TIME}:
                        yield constant, rest


def _constants_of(node: sympy.Expr) -> Iterator[tuple[float, sympy.Expr]]:
    if isinstance(node, sympy.Add):
        number, rest = node.as_coeff_Add()
        if number.is_Float and number:
            yield abs(float(number)), rest
    elif isinstance(node, sympy.Function):
        for part in sympy.Add.make_args(node.args[0]):
            number, rest = part.as_coeff_Mul()
            if number.is_Float and number:
                yield 1 / abs(float(number)), rest


def unusual_bits(exprs: Iterable[sympy.Expr], size: Callable[[sympy.Expr], float]) -> float:
    """Give the bits of constants inside that are of another size than their columns.

    They are log-normal around the size of the columns, with a standard deviation of one decade.

    Parameters
    ----------
    exprs : equations, their constants floats.
    size : gives the usual size of an expression of the columns along the data.

    >>> x = sympy.Symbol("x")
    >>> round(unusual_bits([2.0 * x / (x + 300.0)], lambda expr: 3.0), 2)
    2.89
    """
    bits = 0.0
    for expr in exprs:
        for constant, rest in constants_inside(expr):
            usual = size(rest)
            if 0 < usual < math.inf:
                bits += math.log10(constant / usual) ** 2 / (2 * math.log(2))
    return bits
