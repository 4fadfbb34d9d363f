"""Expressions written: as text that reads back the same, with floats, with fewer digits."""

from __future__ import annotations

import math

import sympy
from sympy.printing.str import StrPrinter


class _TextPrinter(StrPrinter):
    """Print floats with the fewest digits that read back as the same float64."""

    def _print_Exp1(self, expr: sympy.Expr) -> str:  # noqa: N802 (SymPy's protocol)
        # "E" may be the name of a state (SEIR models).
        return "exp(1)"

    def _print_Float(self, expr: sympy.Float) -> str:  # noqa: N802 (SymPy's protocol)
        text = repr(float(expr))
        return text if math.isfinite(float(expr)) else super()._print_Float(expr)


def to_text(expr: sympy.Expr) -> str:
    """Write an expression so that :func:`parse` (and SymPy) read the same float64 numbers back.

    >>> from dynsr.expression import parse
    >>> to_text(parse("0.1*x + 1/3"))
    '0.1*x + 1/3'
    """
    return _TextPrinter({"order": None}).doprint(expr)


class ByText:
    """Orders expressions by their text; the last part of a key, it is printed for ties alone.

    Printing takes longer than all else in a comparison.

    >>> [str(key.expr) for key in sorted(map(ByText, sympy.symbols("y x")))]
    ['x', 'y']
    """

    def __init__(self, expr: sympy.Expr) -> None:
        self.expr = expr

    def __lt__(self, other: ByText) -> bool:
        """Compare the texts of what is not the very same expression."""
        return self.expr is not other.expr and str(self.expr) < str(other.expr)


def as_float_tree(expr: sympy.Expr) -> sympy.Expr:
    """Replace rationals (but not integers) by floats, as code for Julia or torch needs it."""
    rationals = {a: sympy.Float(float(a)) for a in expr.atoms(sympy.Rational) if not a.is_Integer}
    return expr.xreplace(rationals)


def marks(count: int) -> list[sympy.Float]:
    """Give so many floats, no two alike, that show where each of as many constants is written."""
    return [sympy.Float(1 + (i + 1) / 4096) for i in range(count)]


def round_constants(expr: sympy.Expr, digits: int) -> sympy.Expr:
    """Round every float of an expression to so many significant digits.

    >>> from dynsr.expression import parse
    >>> round_constants(parse("2.99999*x"), 3)
    3.0*x
    """
    return expr.xreplace(
        {a: sympy.Float(float(f"{float(a):.{digits - 1}e}")) for a in expr.atoms(sympy.Float)}
    )
