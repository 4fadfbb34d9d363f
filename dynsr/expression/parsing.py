"""Expressions read from text, without ever evaluating it as Python."""

from __future__ import annotations

import ast
import keyword
import math
import sys
import warnings
from collections.abc import Iterable

import sympy

from dynsr.errors import InputError
from dynsr.expression.operators import CONSTANTS, FUNCTIONS, OPERATORS

_FUNCTION_ALIASES = {
    "Abs": "abs",
    "ln": "log",
    "arcsin": "asin",
    "arccos": "acos",
    "arctan": "atan",
}
_BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}
_MAX_LENGTH = 100_000
_LARGEST = sympy.Float(sys.float_info.max)
# Of e: exp of more is no float64.
_LARGEST_EXPONENT = 709.0
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
    """Convert a node; every number on the way is one that float64 holds."""
    result = _convert_node(node, allowed, shown, depth)
    # 1/0 is no number but a value that a formula may have: infinite wherever it is evaluated.
    if result.is_Number and result.is_finite and abs(result) > _LARGEST:
        raise InputError(f"a number in {shown!r} is beyond what float64 holds; write it smaller")
    return result


def _convert_node(
    node: ast.AST, allowed: frozenset[str] | None, shown: str, depth: int
) -> sympy.Expr:
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
                _power(a, b, shown)
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


def _power(base: sympy.Expr, exponent: sympy.Expr, shown: str) -> sympy.Expr:
    if base.is_Number and exponent.is_Number and base != 0:
        # 9**9**9 would fill the memory in exact integers, and 9.0**9**9**9 take for ever.
        if abs(float(exponent) * math.log(abs(float(base)))) > _LARGEST_EXPONENT:
            raise InputError(f"a power in {shown!r} is beyond what float64 holds; write it smaller")
        if abs(exponent) > 64:
            return sympy.Float(base) ** sympy.Float(exponent)
    return base**exponent
