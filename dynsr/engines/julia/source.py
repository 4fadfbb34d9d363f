"""Right-hand sides as Julia source: written from SymPy, compiled and called in Julia."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import sympy

from dynsr.errors import InputError
from dynsr.expression import FUNCTIONS

# Operators that SymPy knows as functions of their own; the others it writes as powers or sums.
_JULIA_NAMES = {
    operator.sympy: operator.julia
    for operator in FUNCTIONS.values()
    if isinstance(operator.sympy, sympy.core.function.FunctionClass)
}


def write_slopes(
    rhs: Sequence[sympy.Expr], states: Sequence[str], inputs: Sequence[str] = ()
) -> str:
    """Write k expressions in ``states`` and ``t`` as a Julia function ``(du, u, p, t) -> ...``.

    States become ``u[1]``, ``u[2]``, ..., so that no name of theirs can clash with Julia's.
    Common subexpressions are computed once. ``sqrt``, ``power`` and the like are those of DynSR's
    module ``Formulas``, which give NaN outside their domain.

    Parameters
    ----------
    rhs : k SymPy expressions, in state units per second.
    states : the k names of the states, in order.
    inputs : the names of measured inputs, in the order of the pieces that Julia is given.

    Raises InputError when an expression holds something that is not in the operator table.

    >>> from dynsr.expression import parse
    >>> print(write_slopes([parse("y"), parse("-x/3 + t^2")], ["x", "y"]))
    (du, u, p, t) -> begin
        du[1] = u[2]
        du[2] = (t^2 + -0.3333333333333333 * u[1])
        nothing
    end
    """
    names: dict[sympy.Symbol, str] = {sympy.Symbol("t"): "t"}
    names.update({sympy.Symbol(s): f"u[{i}]" for i, s in enumerate(states, 1)})
    names.update({sympy.Symbol(s): f"i{i}" for i, s in enumerate(inputs, 1)})
    fresh = sympy.numbered_symbols("common", cls=sympy.Dummy)
    common, reduced = sympy.cse(list(rhs), symbols=fresh, order="none")
    lines = [f"i{i} = drive(p, {i}, t)" for i in range(1, len(inputs) + 1)]
    for i, (symbol, part) in enumerate(common, 1):
        lines.append(f"s{i} = {write_julia(part, names)}")
        names[symbol] = f"s{i}"
    lines += [f"du[{i}] = {write_julia(e, names)}" for i, e in enumerate(reduced, 1)]
    return "\n    ".join(["(du, u, p, t) -> begin", *lines, "nothing"]) + "\nend"


def write_julia(expr: sympy.Expr, names: Mapping[sympy.Symbol, str]) -> str:
    """Write one expression in Julia; every number but an exponent becomes a float."""
    if expr.is_Symbol:
        if expr not in names:
            raise InputError(f"unknown name {str(expr)!r} in a right-hand side")
        return names[expr]
    if expr.is_number and not expr.args:
        return _write_number(expr)
    if expr.is_Add:
        return "(" + " + ".join(write_julia(a, names) for a in expr.args) + ")"
    if expr.is_Mul:
        return _write_product(expr, names)
    if expr.is_Pow:
        return _write_power(expr.base, expr.exp, names)
    if expr.func in _JULIA_NAMES and len(expr.args) == 1:
        return f"{_JULIA_NAMES[expr.func]}({write_julia(expr.args[0], names)})"
    raise InputError(f"{expr.func.__name__} in a right-hand side cannot be written in Julia")


def _write_number(number: sympy.Expr) -> str:
    value = complex(number)
    if value.imag or math.isnan(value.real):
        return "NaN"
    if math.isinf(value.real):
        return "Inf" if value.real > 0 else "(-Inf)"
    return repr(value.real)


def _write_product(expr: sympy.Expr, names: Mapping[sympy.Symbol, str]) -> str:
    above, below = [], []
    for factor in expr.args:
        if factor.is_Pow and factor.exp.is_number and factor.exp.is_negative:
            below.append(_write_power(factor.base, -factor.exp, names))
        else:
            above.append(write_julia(factor, names))
    product = " * ".join(above) or "1.0"
    return f"({product}) / ({' * '.join(below)})" if below else product


def _write_power(base: sympy.Expr, exponent: sympy.Expr, names: Mapping[sympy.Symbol, str]) -> str:
    if exponent.is_number and exponent.is_negative:
        return f"(1.0 / {_write_power(base, -exponent, names)})"
    inner = write_julia(base, names)
    if exponent.is_Integer and exponent < 2**31:
        wrapped = inner if inner.replace("[", "").replace("]", "").isalnum() else f"({inner})"
        return wrapped if exponent == 1 else f"{wrapped}^{int(exponent)}"
    if exponent == sympy.Rational(1, 2):
        return f"sqrt({inner})"
    return f"power({inner}, {write_julia(exponent, names)})"
