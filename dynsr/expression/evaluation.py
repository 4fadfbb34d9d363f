"""Expressions evaluated: compiled for many times, node by node for once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import sympy

from dynsr.expression.operators import FUNCTIONS

# A function of p columns and of the array that its values are written to.
Rows = Callable[[Iterable[Any], np.ndarray], None]


@lru_cache(maxsize=4096)
def _lambdified(
    exprs: tuple[sympy.Expr, ...], names: tuple[str, ...], module: str
) -> Callable[..., Any]:
    symbols, dummies = map(sympy.Symbol, names), _dummies(len(names))
    known = {sympy.zoo: sympy.nan, **dict(zip(symbols, dummies, strict=True))}
    swapped = [e.xreplace(known) for e in exprs]
    # Nobody reads the function's docstring, which is a quarter of the work.
    return sympy.lambdify(dummies, swapped, modules=module, cse=True, docstring_limit=0)


@lru_cache
def _dummies(count: int) -> list[sympy.Dummy]:
    # The same every time, so that SymPy knows parts that it has seen; it sorts by their names.
    return [sympy.Dummy(f"Dummy_{place:08}") for place in range(count)]


def differentiate(expr: sympy.Expr, by: sympy.Symbol) -> sympy.Expr:
    """Give the derivative of a formula of real variables, whose sizes have one too.

    Parameters
    ----------
    expr : the formula.
    by : the variable.

    >>> v, k = sympy.symbols("v k")
    >>> differentiate(abs(v - k), k)
    sign(k - v)
    """
    if not expr.has(sympy.Abs, sympy.sign):
        return sympy.diff(expr, by)
    real = {s: sympy.Symbol(s.name, real=True) for s in (*expr.free_symbols, by)}
    slope = sympy.diff(expr.xreplace(real), real[by])
    # A jump has no slope to follow.
    slope = slope.replace(sympy.DiracDelta, lambda *_: sympy.S.Zero)
    return slope.xreplace({own: symbol for symbol, own in real.items()})


def compile_numpy(
    exprs: Sequence[sympy.Expr], names: Sequence[str]
) -> Callable[[np.ndarray], np.ndarray]:
    """Compile k expressions of p variables into one function of arrays.

    The function takes ``values`` of shape (p, ...) and gives shape (k, ...), float64. Values
    outside an expression's domain become NaN or inf without a warning.

    >>> from dynsr.expression import parse
    >>> f = compile_numpy([parse("x*y"), parse("2")], ["x", "y"])
    >>> f(np.array([[1.0, 2.0], [3.0, 4.0]])).tolist()
    [[3.0, 8.0], [2.0, 2.0]]
    """
    fill = compile_rows(exprs, names)
    count = len(exprs)

    def evaluate_all(values: np.ndarray) -> np.ndarray:
        values = np.asarray(values, dtype=float)
        out = np.empty((count, *values.shape[1:]))
        with np.errstate(all="ignore"):
            fill(values, out)
        return out

    return evaluate_all


def compile_rows(exprs: Sequence[sympy.Expr], names: Sequence[str]) -> Rows:
    """Compile k expressions of p variables for many calls on few values each.

    The function takes p arrays or floats that broadcast, and writes to its second argument (k,
    ...). The caller says what becomes of warnings.

    Parameters
    ----------
    exprs : the k expressions.
    names : names of the p arguments, in their order.

    >>> from dynsr.expression import parse
    >>> f, out = compile_rows([parse("a*x"), parse("2")], ["a", "x"]), np.empty((2, 2))
    >>> f((3.0, np.array([1.0, 2.0])), out)
    >>> out.tolist()
    [[3.0, 6.0], [2.0, 2.0]]
    """
    function = _lambdified(tuple(exprs), tuple(names), "numpy")

    def fill(columns: Iterable[Any], out: np.ndarray) -> None:
        for row, value in enumerate(function(*columns)):
            out[row] = _real(value)

    return fill


def _real(value: Any) -> Any:
    # Nearly every value is a plain array of floats; the checks below cost more than some formulas.
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    if isinstance(value, (complex, np.complexfloating)) or (
        isinstance(value, np.ndarray) and np.iscomplexobj(value)
    ):
        array = np.asarray(value)
        return np.where(array.imag == 0, array.real, np.nan)
    return value


def compile_scalar(exprs: Sequence[sympy.Expr], names: Sequence[str]) -> Callable[..., list[float]]:
    """Compile expressions into a function of p floats that gives a list of k floats.

    Faster than :func:`compile_numpy` for one point at a time. It raises ``ValueError``,
    ``ZeroDivisionError`` or ``OverflowError`` where an expression has no real value.
    """
    return _lambdified(tuple(exprs), tuple(names), "math")


def evaluate(expr: sympy.Expr, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Evaluate one expression once on named columns of equal length.

    Goes through the expression node by node, which for one evaluation is some fifty times quicker
    than compiling it. Values outside the domain become NaN or inf without a warning.

    >>> from dynsr.expression import parse
    >>> evaluate(parse("x + 1"), {"x": np.array([1.0, 2.0])}).tolist()
    [2.0, 3.0]
    """
    known: dict[sympy.Basic, Any] = {
        sympy.Symbol(name): np.asarray(values, dtype=float) for name, values in columns.items()
    }
    shape = next((v.shape for v in known.values()), ())
    with np.errstate(all="ignore"):
        return np.array(np.broadcast_to(_value(expr, known), shape), dtype=float)


_BY_CLASS: dict[Any, Callable[..., Any]] = {
    operator.sympy: operator.numpy
    for operator in FUNCTIONS.values()
    if isinstance(operator.sympy, type)
}


def _value(node: sympy.Basic, known: dict[sympy.Basic, Any]) -> Any:
    if node in known:
        return known[node]
    if node.is_number and not node.args:
        value = _number(node)
    elif node.is_Add:
        value = sum(_value(a, known) for a in node.args)
    elif node.is_Mul:
        value = _product(node, known)
    elif node.is_Pow:
        value = _raised(_value(node.base, known), node.exp, known)
    elif node.func in _BY_CLASS:
        value = _BY_CLASS[node.func](_value(node.args[0], known))
    elif (own := getattr(node.func, "_imp_", None)) is not None:
        value = own(_value(node.args[0], known))
    elif node.is_Symbol:
        raise KeyError(str(node))
    else:
        names = [str(symbol) for symbol in known if symbol.is_Symbol]
        columns = [known[sympy.Symbol(name)] for name in names]
        value = compile_numpy([node], names)(np.array(columns))[0]
    known[node] = value
    return value


def _number(node: sympy.Basic) -> float:
    try:
        return float(node)
    except TypeError:  # an imaginary number or complex infinity
        return math.nan


def _product(node: sympy.Mul, known: dict[sympy.Basic, Any]) -> Any:
    above: Any = 1.0
    below: Any = None
    for factor in node.args:
        if factor.is_Pow and factor.exp.is_Rational and factor.exp < 0:
            divisor = _value(factor.base**-factor.exp, known)
            below = divisor if below is None else below * divisor
        else:
            above = above * _value(factor, known)
    return above if below is None else np.divide(above, below)


def _raised(base: Any, exponent: sympy.Expr, known: dict[sympy.Basic, Any]) -> Any:
    if exponent == sympy.Rational(1, 2):
        return np.sqrt(base)
    if exponent.is_Rational and exponent < 0:
        return np.divide(1.0, _raised(base, -exponent, known))
    if exponent.is_Integer:
        return np.power(base, int(exponent)) if exponent != 1 else base
    return np.power(base, _value(exponent, known))
