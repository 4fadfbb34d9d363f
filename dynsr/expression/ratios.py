"""Ratios: the ways in which one ratio can be written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import sympy


def expand_terms(expr: sympy.Expr) -> sympy.Expr:
    """Multiply a formula out, but for powers of sums that are no whole ones, and exponents.

    SymPy writes (1 - x)^(8/5) as (1 - x)^(3/5) - x (1 - x)^(3/5), and exp(x + y) as exp(x) exp(y).

    Parameters
    ----------
    expr : the formula.

    >>> x = sympy.Symbol("x")
    >>> expand_terms(x * (2 - x) * (1 - x) ** sympy.Rational(8, 5))
    -x**2*(1 - x)**(8/5) + 2*x*(1 - x)**(8/5)
    """
    held = {
        power: sympy.Dummy()
        for power in expr.atoms(sympy.Pow)
        if power.base.is_Add and power.exp.is_Number and not power.exp.is_Integer
    }
    found = sympy.expand(expr.xreplace(held), power_exp=False)
    return found.xreplace({own: power for power, own in held.items()})


def ratio_forms(expr: sympy.Expr) -> Iterator[sympy.Expr]:
    """Give a formula, and where it is a ratio its other forms, which are the same function.

    Each number of the denominator may be 1. If the denominator has a variable, polynomial division
    gives a sum and a ratio: (v^2 + 3 v)/(v + 1) = v + 2 v/(v + 1) = v + 2 - 2/(v + 1). In a sum of
    ratios one of them is written in another form.

    Parameters
    ----------
    expr : the formula.

    >>> x = sympy.Symbol("x")
    >>> [str(form) for form in ratio_forms((4.0 * x) / (1 + 2.0 * x))]
    ['4.0*x/(2.0*x + 1)', '2.0*x/(x + 0.5)', '2.0 - 2.0/(2.0*x + 1)', '2.0 - 1.0/(x + 0.5)']
    """
    yield expr
    for place, term in enumerate(expr.args if expr.is_Add else ()):
        rest = sympy.Add(*expr.args[:place], *expr.args[place + 1 :])
        yield from (rest + other for other in _other_forms(term))
    yield from _other_forms(expr)


@lru_cache(maxsize=2_000)
def _other_forms(ratio: sympy.Expr) -> tuple[sympy.Expr, ...]:
    top, bottom = sympy.fraction(ratio)
    if not bottom.is_Add:
        return ()
    found = []
    for beside, rest in [(sympy.S.Zero, top), *_divided(top, bottom)]:
        for scale in [sympy.S.One, *(t.as_coeff_Mul()[0] for t in bottom.args)]:
            line = sympy.Add(*[_scaled(term, scale) for term in bottom.args])
            found.append(beside + sympy.expand(rest / scale) / line)
    return tuple(form for form in dict.fromkeys(found) if form != ratio)


def _scaled(term: sympy.Expr, scale: sympy.Expr) -> sympy.Expr:
    factor, rest = term.as_coeff_Mul()
    return rest if factor == scale else factor / scale * rest


def _divided(top: sympy.Expr, bottom: sympy.Expr) -> Iterator[tuple[sympy.Expr, sympy.Expr]]:
    """Give quotient and remainder of a ratio: with the remainder of least degree, and of most.

    By the usual division, and by that which begins with the lowest powers.
    """
    for variable in sorted(bottom.free_symbols, key=str):
        if not (bottom.is_polynomial(variable) and top.is_polynomial(variable)):
            continue
        below = sympy.Poly(bottom, variable).all_coeffs()
        above = sympy.Poly(top, variable).all_coeffs()
        if any(c.free_symbols for c in below):
            continue
        if len(above) < len(below):
            # From the lowest power on it can be divided: 1/(1 + v) = 1 - v/(1 + v).
            if below[-1] != 0 != above[-1]:
                whole = sympy.expand(above[-1] / below[-1])
                yield whole, sympy.expand(top - whole * bottom)
            continue
        # By hand: with rounded numbers SymPy's division may find no end.
        quotient, rest = [], list(above)
        while len(rest) >= len(below):
            factor = sympy.expand(rest[0] / below[0])
            quotient.append(factor)
            rest = [sympy.expand(a - factor * b) for a, b in zip(rest, below, strict=False)][
                1:
            ] + rest[len(below) :]
        whole, left = _sum(quotient, variable), _sum(rest, variable)
        if whole == 0:
            continue
        yield whole, left
        if below[-1] != 0:
            # Its value at 0 is taken out of the quotient, and goes back over the line.
            shift = sympy.expand(quotient[-1] - above[-1] / below[-1])
            yield sympy.expand(whole - shift), sympy.expand(left + shift * bottom)


def _sum(coefficients: Sequence[sympy.Expr], variable: sympy.Symbol) -> sympy.Expr:
    highest = len(coefficients) - 1
    return sympy.Add(
        *[sympy.expand(c * variable ** (highest - i)) for i, c in enumerate(coefficients)]
    )
