"""Constants: the floats of a formula taken out of it, so that its shape is left."""

from __future__ import annotations

from functools import lru_cache

import sympy


def free_constants(expr: sympy.Expr, prefix: str) -> tuple[sympy.Expr, dict[sympy.Symbol, float]]:
    """Put a symbol in the place of every float; give the template and the symbols' values.

    Every occurrence gets its own symbol. Integers, rationals, pi and exponents that are whole
    numbers belong to the structure and stay.

    >>> template, values = free_constants(sympy.Float(2.5) * sympy.Symbol("x"), "c")
    >>> template, list(values.values())
    (c0*x, [2.5])
    """
    template, values = _free_constants(expr, prefix)
    return template, dict(values)


@lru_cache(maxsize=4096)
def _free_constants(
    expr: sympy.Expr, prefix: str
) -> tuple[sympy.Expr, tuple[tuple[sympy.Symbol, float], ...]]:
    values: dict[sympy.Symbol, float] = {}

    def replaced(node: sympy.Expr) -> sympy.Expr:
        if node.is_Float:
            symbol = sympy.Symbol(f"{prefix}{len(values)}")
            values[symbol] = float(node)
            return symbol
        if not node.args:
            return node
        if node.is_Pow and node.exp.is_Float and float(node.exp).is_integer():
            return node.func(replaced(node.base), sympy.Integer(int(node.exp)))
        found = [replaced(argument) for argument in node.args]
        # SymPy builds a node anew in a hundred times the time that this takes.
        kept = all(new is old for new, old in zip(found, node.args, strict=True))
        return node if kept else node.func(*found)

    return replaced(expr), tuple(values.items())


# Systems differ in one equation from those before them.
@lru_cache(maxsize=4096)
def skeleton(expr: sympy.Expr) -> sympy.Expr:
    """Write a formula with all its floats alike; formulas of one shape have one skeleton.

    >>> skeleton(sympy.sympify("2.5*x + 1.1")) == skeleton(sympy.sympify("0.3*x - 7.0"))
    True
    """
    return expr.xreplace(dict.fromkeys(expr.atoms(sympy.Float), sympy.pi))
