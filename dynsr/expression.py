"""Expressions: the operator table, a parser without ``eval``, evaluation and complexity.

Every other part of dynsr that needs to know what ``sin`` or ``/`` means asks :data:`OPERATORS`.
"""

from __future__ import annotations

import ast
import keyword
import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from typing import Any

import numpy as np
import sympy
from sympy.printing.str import StrPrinter

from dynsr.errors import InputError


@dataclass(frozen=True)
class Operator:
    """One operator: its token, arity, and what it is in numpy, SymPy, torch and Julia.

    ``torch`` and ``julia`` are names, not functions, so that neither library is imported here.
    """

    token: str
    arity: int
    numpy: Callable[..., Any]
    sympy: Callable[..., Any]
    torch: str
    julia: str


def _table(*operators: Operator) -> dict[str, Operator]:
    return {operator.token: operator for operator in operators}


OPERATORS: dict[str, Operator] = _table(
    Operator("+", 2, np.add, lambda a, b: a + b, "add", "+"),
    Operator("-", 2, np.subtract, lambda a, b: a - b, "subtract", "-"),
    Operator("*", 2, np.multiply, lambda a, b: a * b, "multiply", "*"),
    Operator("/", 2, np.divide, lambda a, b: a / b, "divide", "/"),
    Operator("^", 2, np.power, lambda a, b: a**b, "pow", "^"),
    Operator("identity", 1, np.positive, lambda a: a, "positive", "identity"),
    Operator("neg", 1, np.negative, lambda a: -a, "negative", "-"),
    Operator("inv", 1, np.reciprocal, lambda a: 1 / a, "reciprocal", "inv"),
    Operator("square", 1, np.square, lambda a: a**2, "square", "abs2"),
    Operator("sqrt", 1, np.sqrt, sympy.sqrt, "sqrt", "sqrt"),
    Operator("exp", 1, np.exp, sympy.exp, "exp", "exp"),
    Operator("log", 1, np.log, sympy.log, "log", "log"),
    Operator("sin", 1, np.sin, sympy.sin, "sin", "sin"),
    Operator("cos", 1, np.cos, sympy.cos, "cos", "cos"),
    Operator("tan", 1, np.tan, sympy.tan, "tan", "tan"),
    Operator("asin", 1, np.arcsin, sympy.asin, "arcsin", "asin"),
    Operator("acos", 1, np.arccos, sympy.acos, "arccos", "acos"),
    Operator("atan", 1, np.arctan, sympy.atan, "arctan", "atan"),
    Operator("sinh", 1, np.sinh, sympy.sinh, "sinh", "sinh"),
    Operator("cosh", 1, np.cosh, sympy.cosh, "cosh", "cosh"),
    Operator("tanh", 1, np.tanh, sympy.tanh, "tanh", "tanh"),
    Operator("abs", 1, np.abs, sympy.Abs, "abs", "abs"),
    Operator("sign", 1, np.sign, sympy.sign, "sign", "sign"),
)

FUNCTIONS: dict[str, Operator] = {k: v for k, v in OPERATORS.items() if k.isidentifier()}
_FUNCTION_ALIASES = {
    "Abs": "abs",
    "ln": "log",
    "arcsin": "asin",
    "arccos": "acos",
    "arctan": "atan",
}
CONSTANTS: dict[str, sympy.Expr] = {"pi": sympy.pi}
_BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}
_MAX_LENGTH = 100_000
_MAX_DEPTH = 200


def check_name(name: str, role: str = "variable") -> str:
    """Give ``name`` back if it can name a variable in an expression.

    Raises InputError when it is no identifier, a Python keyword, or the name of a function or
    constant of the operator table, which would make expressions ambiguous.

    >>> check_name("theta1")
    'theta1'
    """
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InputError(
            f"{role} name {str(name)[:60]!r} cannot stand in a formula; "
            "use letters, digits and underscores, starting with a letter"
        )
    if name in FUNCTIONS or name in _FUNCTION_ALIASES or name in CONSTANTS:
        raise InputError(
            f"{role} name {name!r} is the name of a function or constant; rename it, e.g. {name}_1"
        )
    return name


def parse(text: str | float | sympy.Expr, names: Iterable[str] | None = None) -> sympy.Expr:
    """Read an expression from text, without ever evaluating it as Python.

    Accepts ``+ - * / ^ **``, the functions of :data:`OPERATORS`, numbers, ``pi`` and variables.
    ``names``, when given, lists the variables that may occur. A SymPy expression is checked
    against ``names`` and given back.

    Raises InputError when the text is not such an expression.

    >>> parse("x*(1.5 - y)", ["x", "y"])
    x*(1.5 - y)
    """
    allowed = None if names is None else frozenset(names)
    if isinstance(text, sympy.Basic):
        _check_symbols({str(s) for s in text.free_symbols}, allowed, str(text))
        return text
    source = str(text).strip()
    shown = source if len(source) <= 60 else source[:57] + "..."
    if not source:
        raise InputError("an expression is empty; write a formula such as 'x*(1.5 - y)'")
    if len(source) > _MAX_LENGTH:
        raise InputError(
            f"expression {shown!r} is longer than {_MAX_LENGTH} characters; shorten it"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)
            tree = ast.parse(source.replace("^", "**"), mode="eval")
        result = _convert(tree.body, allowed, shown, 0)
    except InputError:
        raise
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise InputError(f"cannot read expression {shown!r}; write it like 'x*(1.5 - y)'") from None
    return result


def _check_symbols(found: set[str], allowed: frozenset[str] | None, shown: str) -> None:
    if allowed is None:
        return
    unknown = sorted(found - allowed)
    if unknown:
        known = ", ".join(sorted(allowed)) or "none"
        raise InputError(f"unknown name {unknown[0]!r} in {shown!r}; the variables are: {known}")


def _convert(node: ast.AST, allowed: frozenset[str] | None, shown: str, depth: int) -> sympy.Expr:
    if depth > _MAX_DEPTH:
        # A long sum nests to the left; only a tower of other operators gets this deep.
        if not (isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Sub))):
            raise InputError(f"expression {shown!r} is nested too deeply; simplify it")
    match node:
        case ast.Constant(value=bool() | complex()):
            pass
        case ast.Constant(value=int(value)):
            return sympy.Integer(value) if abs(value) < 10**300 else sympy.Float(value)
        case ast.Constant(value=float(value)) if math.isfinite(value):
            return sympy.Float(value)
        case ast.Name(id=name):
            return _symbol(name, allowed, shown)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_convert(operand, allowed, shown, depth + 1)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _convert(operand, allowed, shown, depth + 1)
        case ast.BinOp(op=ast.Add() | ast.Sub()):
            return _convert_sum(node, allowed, shown, depth)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            a = _convert(left, allowed, shown, depth + 1)
            b = _convert(right, allowed, shown, depth + 1)
            return (
                _power(a, b)
                if isinstance(op, ast.Pow)
                else OPERATORS[_BINARY[type(op)]].sympy(a, b)
            )
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]):
            token = _FUNCTION_ALIASES.get(name, name)
            if token not in FUNCTIONS:
                known = ", ".join(sorted(FUNCTIONS))
                raise InputError(
                    f"unknown function {name!r} in {shown!r}; the functions are: {known}"
                )
            return FUNCTIONS[token].sympy(_convert(argument, allowed, shown, depth + 1))
    raise InputError(f"cannot read expression {shown!r}; write it like 'x*(1.5 - y)'")


def _convert_sum(
    node: ast.AST, allowed: frozenset[str] | None, shown: str, depth: int
) -> sympy.Expr:
    terms = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Sub)):
        term = _convert(node.right, allowed, shown, depth + 1)
        terms.append(-term if isinstance(node.op, ast.Sub) else term)
        node = node.left
    terms.append(_convert(node, allowed, shown, depth + 1))
    return sympy.Add(*reversed(terms))


def _symbol(name: str, allowed: frozenset[str] | None, shown: str) -> sympy.Expr:
    if allowed is not None and name in allowed:
        return sympy.Symbol(name)
    if name in CONSTANTS:
        return CONSTANTS[name]
    if name == "E" and allowed is not None:
        return sympy.E
    _check_symbols({name}, allowed, shown)
    return sympy.Symbol(check_name(name))


def _power(base: sympy.Expr, exponent: sympy.Expr) -> sympy.Expr:
    # 9**9**9 in exact integers would fill the memory; floats overflow harmlessly instead.
    if base.is_Number and exponent.is_Number and abs(exponent) > 64:
        return sympy.Float(base) ** sympy.Float(exponent)
    return base**exponent


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

    >>> to_text(parse("0.1*x + 1/3"))
    '0.1*x + 1/3'
    """
    return _TextPrinter({"order": None}).doprint(expr)


def as_float_tree(expr: sympy.Expr) -> sympy.Expr:
    """Replace rationals (but not integers) by floats, as code for Julia or torch needs it."""
    rationals = {a: sympy.Float(float(a)) for a in expr.atoms(sympy.Rational) if not a.is_Integer}
    return expr.xreplace(rationals)


@lru_cache(maxsize=4096)
def _lambdified(
    exprs: tuple[sympy.Expr, ...], names: tuple[str, ...], module: str
) -> Callable[..., Any]:
    symbols = [sympy.Symbol(name) for name in names]
    dummies = [sympy.Dummy() for _ in names]
    known = {sympy.zoo: sympy.nan, **dict(zip(symbols, dummies, strict=True))}
    swapped = [e.xreplace(known) for e in exprs]
    return sympy.lambdify(dummies, swapped, modules=module, cse=True)


def compile_numpy(
    exprs: Sequence[sympy.Expr], names: Sequence[str]
) -> Callable[[np.ndarray], np.ndarray]:
    """Compile k expressions of p variables into one function of arrays.

    The function takes ``values`` of shape (p, ...) and gives shape (k, ...), float64. Values
    outside an expression's domain become NaN or inf without a warning.

    >>> f = compile_numpy([parse("x*y"), parse("2")], ["x", "y"])
    >>> f(np.array([[1.0, 2.0], [3.0, 4.0]])).tolist()
    [[3.0, 8.0], [2.0, 2.0]]
    """
    function = _lambdified(tuple(exprs), tuple(names), "numpy")
    count = len(exprs)

    def evaluate_all(values: np.ndarray) -> np.ndarray:
        values = np.asarray(values, dtype=float)
        out = np.empty((count, *values.shape[1:]))
        with np.errstate(all="ignore"):
            for row, value in enumerate(function(*values)):
                out[row] = _real(value)
        return out

    return evaluate_all


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


REAL_RESOLUTION = 2.0**-30


def number_bits(number: sympy.Expr) -> float:
    """Bits that one number of an expression costs.

    An integer n costs log2(1 + |n|), a rational p/q costs log2((1 + |p|) q), and a real the
    cheaper of its shortest decimal, n/10^k at log2((1 + |n|) 10^k), and 30 + |log2|r||: thirty
    bits of digits and those of the exponent. So a constant that is rounded to the digits which the
    data support becomes cheaper. Udrescu et al. (2020, "AI Feynman 2.0", table 1) take
    log2(1 + (|r| / 2^-30)^2) / 2 for reals, which agrees above 1 but makes small ones free.

    >>> round(number_bits(sympy.Integer(3)), 3)
    2.0
    """
    if number.is_Rational:
        return math.log2((1 + abs(int(number.p))) * int(number.q))
    value = float(number)
    if not math.isfinite(value):
        return math.inf
    real = abs(math.log2(abs(value))) - math.log2(REAL_RESOLUTION) if value else 0.0
    _, digits, exponent = Decimal(repr(value)).normalize().as_tuple()
    shifted = int("".join(map(str, digits))) * 10 ** max(int(exponent), 0)
    return min(real, math.log2(1 + shifted) + max(-int(exponent), 0) * math.log2(10))


def complexity(expr: sympy.Expr) -> float:
    """Complexity of an expression in bits: its description length without the data.

    k log2(n) bits for k occurrences of n distinct variables, functions and operations, plus
    :func:`number_bits` of every number (Udrescu et al. 2020, eq. 4). A sum of j terms holds j - 1
    additions; the signs -1 and the reciprocal in a quotient count as operations.

    >>> complexity(parse("x")) < complexity(parse("x + y")) < complexity(parse("2.718*x + sin(y)"))
    True
    """
    kinds: list[Any] = []
    bits = 0.0
    stack = [expr]
    while stack:
        node = stack.pop()
        if node.is_Symbol or node in (sympy.pi, sympy.E):
            kinds.append(node)
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
    return len(kinds) * math.log2(max(len(set(kinds)), 2)) + bits


def round_constants(expr: sympy.Expr, digits: int) -> sympy.Expr:
    """Round every float of an expression to so many significant digits.

    >>> round_constants(parse("2.99999*x"), 3)
    3.0*x
    """
    return expr.xreplace(
        {a: sympy.Float(float(f"{float(a):.{digits - 1}e}")) for a in expr.atoms(sympy.Float)}
    )
