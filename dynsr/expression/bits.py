"""Complexity: the bits of an expression and of the numbers in it."""

from __future__ import annotations

import math
from collections.abc import Collection
from decimal import Decimal
from typing import Any

import sympy

from dynsr.expression.own_bits import added_bits

REAL_RESOLUTION = 2.0**-30
# Fractions of larger numbers are written as decimals.
LARGEST_IN_FRACTION = 12


def number_bits(number: sympy.Expr) -> float:
    """Bits that one number of an expression costs.

    An integer n costs log2(1 + |n|), a rational p/q costs log2((1 + |p|) q), and a real the
    cheapest of its shortest decimal, n/10^k at log2((1 + |n|) 10^k), the fraction that it is, if
    one of numbers up to 12, and 30 + |log2|r||: thirty bits of digits and those of the exponent.
    So a constant that is rounded to the digits which the data support becomes cheaper. Udrescu et
    al. (2020, "AI Feynman 2.0", table 1) take log2(1 + (|r| / 2^-30)^2) / 2 for reals, which
    agrees above 1 but makes small ones free.

    >>> round(number_bits(sympy.Integer(3)), 3), number_bits(sympy.Float(1.5))
    (2.0, 3.0)
    """
    if number.is_Rational:
        return math.log2((1 + abs(int(number.p))) * int(number.q))
    value = float(number)
    if not math.isfinite(value):
        return math.inf
    real = abs(math.log2(abs(value))) - math.log2(REAL_RESOLUTION) if value else 0.0
    _, digits, exponent = Decimal(repr(value)).normalize().as_tuple()
    shifted = int("".join(map(str, digits))) * 10 ** max(int(exponent), 0)
    decimal = math.log2(1 + shifted) + max(-int(exponent), 0) * math.log2(10)
    return min(real, decimal, _fraction_bits(abs(value)))


def _fraction_bits(value: float) -> float:
    for denominator in range(1, LARGEST_IN_FRACTION + 1):
        numerator = value * denominator
        if numerator <= LARGEST_IN_FRACTION and numerator.is_integer():
            return math.log2((1 + numerator) * denominator)
    return math.inf


def complexity(expr: sympy.Expr, constants: Collection[sympy.Symbol] = ()) -> float:
    """Complexity of an expression in bits: its description length without the data.

    k log2(n) bits for k occurrences of n distinct variables, functions and operations, plus
    :func:`number_bits` of every number (Udrescu et al. 2020, eq. 4). A sum of j terms holds j - 1
    additions; the signs -1 and the reciprocal in a quotient count as operations. ``constants``
    are symbols that stand for numbers yet unknown: all of them count as one kind. Bits of the
    user's own (:func:`dynsr.expression.counting`) come on top.

    >>> from dynsr.expression import parse
    >>> complexity(parse("x")) < complexity(parse("x + y")) < complexity(parse("2.718*x + sin(y)"))
    True
    """
    kinds: list[Any] = []
    bits = 0.0
    stack = [expr]
    while stack:
        node = stack.pop()
        if node.is_Symbol or node in (sympy.pi, sympy.E):
            kinds.append("constant" if node in constants else node)
        elif node.is_Number:
            bits += number_bits(node)
        elif node.is_Add or node.is_Mul:
            kinds.extend([node.func] * (len(node.args) - 1))
            for argument in node.args:
                if argument is sympy.S.NegativeOne:
                    kinds[-1] = "neg"
                else:
                    stack.append(argument)
        elif node.is_Pow and node.exp is sympy.S.NegativeOne:
            kinds.append("inv")
            stack.append(node.base)
        else:
            kinds.append(node.func)
            stack.extend(node.args)
    return len(kinds) * math.log2(max(len(set(kinds)), 2)) + bits + added_bits(expr)
