"""Expressions read from text, without ever evaluating it as Python."""

from __future__ import annotations

import ast
import keyword
import math
import re
import sys
import unicodedata
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.errors import InputError, quoted
from dynsr.expression.operators import CONSTANTS, FUNCTIONS, OPERATORS

FUNCTION_ALIASES = {
    "Abs": "abs",
    "ln": "log",
    "arcsin": "asin",
    "arccos": "acos",
    "arctan": "atan",
}
_BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}
_MAX_LENGTH = 100_000
_MAX_DEPTH = 200
# What no formula needs: strings, lists, comparisons, calls with several arguments, ...
_FOREIGN = re.compile(r"[^\w\s.+*/^()-]")
# SymPy takes up to three times as long for each of these that stands in another one.
_SLOW = {"sinh": 6, "cosh": 6, "tanh": 6, "abs": 2, "sign": 2}
_MAX_NESTED = 20
_LARGEST_POWER = 1000
# Exact integers stop here, as those of NumPy do; beyond, a number is a float64.
_LARGEST_EXACT = 2**63
_LARGEST = sys.float_info.max
# What SymPy writes for numbers that are not finite.
_NOT_FINITE = ("zoo", "nan", "oo", "inf")
_INFINITE = (sympy.zoo, sympy.nan, sympy.oo, sympy.S.NegativeInfinity)


def check_name(name: str, role: str = "variable") -> str:
    """Give ``name`` back if it can name a variable in an expression.

    Raises InputError when it is no identifier, a Python keyword, a name that Unicode (NFKC) writes
    otherwise, as the micro sign, or that of a function or constant of the operator table, which
    would make expressions ambiguous.

    >>> check_name("theta1")
    'theta1'
    """
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InputError(
            f"{role} name {quoted(name)} cannot be used in a formula; "
            "use letters, digits and underscores, starting with a letter"
        )
    normal = unicodedata.normalize("NFKC", name)
    if normal != name:
        raise InputError(
            f"{role} name {name!r} is read as {normal!r} (U+{ord(normal[0]):04X}) in a formula; "
            "call it so"
        )
    if name in (*FUNCTIONS, *FUNCTION_ALIASES, *CONSTANTS, *_NOT_FINITE):
        raise InputError(
            f"{role} name {name!r} is the name of a function or constant; rename it, e.g. {name}_1"
        )
    return name


@checked
def parse(
    text: str | float | sympy.Expr,
    names: Iterable[str] | None = None,
    values: Mapping[str, float] | None = None,
    functions: Mapping[str, Callable[..., sympy.Expr]] | None = None,
) -> sympy.Expr:
    """Read an expression from text, without ever evaluating it as Python.

    Accepts ``+ - * / ^ **``, the functions of :data:`OPERATORS`, numbers, ``pi`` and variables.
    Time is proportional to the length: that, the depth, exponents and the size of numbers are
    bounded, and every part without a variable is a finite real number in float64.

    Parameters
    ----------
    text : the expression; one of SymPy is checked against ``names`` and given back.
    names : the variables that may occur; any by default.
    values : name -> the finite number that it stands for.
    functions : name -> a function of one argument that is in no table, such as that of a curve.

    Raises InputError when the text is not such an expression.

    >>> parse("x*(1.5 - y)", ["x", "y"])
    x*(1.5 - y)
    >>> parse("9**9**9**9")
    Traceback (most recent call last):
    ...
    dynsr.errors.InputError: a number in '9**9**9**9' is beyond what float64 holds; write it smaller
    """
    allowed = None if names is None else frozenset(names)
    if isinstance(text, sympy.Expr):
        _check_symbols({str(s) for s in text.free_symbols}, allowed, text)
        return text
    source = str(text).strip()
    shown = source if len(source) <= 60 else source[:57] + "..."
    if not source:
        raise InputError("an expression is empty; write a formula such as 'x*(1.5 - y)'")
    if len(source) > _MAX_LENGTH:
        raise InputError(
            f"expression {shown!r} is longer than {_MAX_LENGTH} characters; shorten it"
        )
    reader = _Reader(allowed, values or {}, shown, functions or {})
    if _FOREIGN.search(source):
        raise reader.unreadable
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)
            tree = ast.parse(source.replace("^", "**"), mode="eval")
        return reader.finish(reader.convert(tree.body, 0, 0)[0])
    except InputError:
        raise
    except (SyntaxError, ValueError, ArithmeticError, MemoryError, RecursionError):
        raise reader.unreadable from None


def unknown_calls(text: str) -> list[tuple[str, ast.Call]]:
    """Give name and call of each function that is in no table; none if the text is no formula.

    Parameters
    ----------
    text : the formula.

    >>> [name for name, _ in unknown_calls("a - f(x)*sin(y)")]
    ['f']
    """
    try:
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval")
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        return []
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    named = ((call.func.id, call) for call in calls if isinstance(call.func, ast.Name))
    return [pair for pair in named if FUNCTION_ALIASES.get(pair[0], pair[0]) not in FUNCTIONS]


def _check_symbols(
    found: set[str], allowed: frozenset[str] | None, shown: str | sympy.Expr
) -> None:
    if allowed is None:
        return
    unknown = sorted(found - allowed)
    if unknown:
        known = ", ".join(sorted(allowed)) or "none"
        raise InputError(
            f"unknown name {unknown[0]!r} in {str(shown)!r}; the variables are: {known}"
        )


# Numbers so many times larger than their sum leave it to rounding; SymPy makes such a sum of
# acos(cos(10^18)).
_LOST = 1e6
# A part of an expression, and its value where no variable stands in it.
_Part = tuple[sympy.Expr, float | None]


@dataclass(frozen=True)
class _Reader:
    """Converts Python's syntax tree of one expression; ``shown`` is what messages call it."""

    allowed: frozenset[str] | None
    values: Mapping[str, float]
    shown: str
    functions: Mapping[str, Callable[..., sympy.Expr]]

    @property
    def unreadable(self) -> InputError:
        return InputError(f"cannot read expression {self.shown!r}; write it like 'x*(1.5 - y)'")

    @property
    def too_large(self) -> InputError:
        return InputError(
            f"a number in {self.shown!r} is beyond what float64 holds; write it smaller"
        )

    @property
    def not_real(self) -> InputError:
        return InputError(
            f"a part of {self.shown!r} has no real value, as log(-1) has none; correct it"
        )

    @property
    def too_deep(self) -> InputError:
        return InputError(f"expression {self.shown!r} is nested too deeply; simplify it")

    def convert(self, node: ast.AST, depth: int, nested: int) -> _Part:
        """Convert a node below so many others, and within functions of so much weight."""
        # A long sum nests to the left; only a tower of other operators gets this deep.
        if depth > _MAX_DEPTH and not _is_sum(node):
            raise self.too_deep
        match node:
            case ast.Constant(value=bool() | complex()):
                pass
            case ast.Constant(value=int(value) | float(value)):
                return self._number(value)
            case ast.Name(id=name):
                return self._name(name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self._apply("neg", [self.convert(operand, depth + 1, nested)])
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.convert(operand, depth + 1, nested)
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                return self._sum(node, depth, nested)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                parts = [self.convert(side, depth + 1, nested) for side in (left, right)]
                return self._apply(_BINARY[type(op)], parts)
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]):
                return self._call(name, argument, depth, nested)
        raise self.unreadable

    def _number(self, value: float) -> _Part:
        exact = isinstance(value, int) and abs(value) <= _LARGEST_EXACT
        if abs(value) > _LARGEST:
            raise self.too_large
        return (sympy.Integer(value) if exact else sympy.Float(float(value))), float(value)

    def _name(self, name: str) -> _Part:
        if name in self.values:
            return self._number(self.values[name])
        if self.allowed is not None and name in self.allowed:
            return sympy.Symbol(name), None
        known = CONSTANTS.get(name) or (sympy.E if name == "E" and self.allowed else None)
        if known is not None:
            return known, float(known)
        _check_symbols({name}, self.allowed, self.shown)
        if name in _NOT_FINITE:
            raise InputError(f"{name!r} in {self.shown!r} is no number; give a finite one")
        return sympy.Symbol(check_name(name)), None

    def _call(self, name: str, argument: ast.AST, depth: int, nested: int) -> _Part:
        token = FUNCTION_ALIASES.get(name, name)
        if name in self.functions:
            return self.functions[name](self.convert(argument, depth + 1, nested)[0]), None
        if token not in FUNCTIONS:
            known = ", ".join(sorted(FUNCTIONS))
            raise InputError(
                f"unknown function {name!r} in {self.shown!r}; the functions are: {known}"
            )
        nested += _SLOW.get(token, 1)
        if nested > _MAX_NESTED:
            raise self.too_deep
        return self._apply(token, [self.convert(argument, depth + 1, nested)])

    def _sum(self, node: ast.AST, depth: int, nested: int) -> _Part:
        terms = []
        while isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Sub)):
            term = self.convert(node.right, depth + 1, nested)
            terms.append(self._apply("neg", [term]) if isinstance(node.op, ast.Sub) else term)
            node = node.left
        terms.append(self.convert(node, depth + 1, nested))
        values = [value for _, value in terms if value is not None]
        expr = sympy.Add(*(expr for expr, _ in reversed(terms)))
        return self._check(expr, sum(values) if len(values) == len(terms) else None)

    def _apply(self, token: str, parts: Sequence[_Part]) -> _Part:
        """Apply an operator; what its value is, is known before SymPy computes with it."""
        value = None
        numbers = [number for _, number in parts if number is not None]
        if len(numbers) == len(parts):
            with np.errstate(all="ignore"):
                value = float(OPERATORS[token].numpy(*map(np.float64, numbers)))
            self._check_value(value)
        exprs = [expr for expr, _ in parts]
        if token == "^":
            return self._check(self._power(parts, exprs), value)
        if token == "square":
            self._power([parts[0], (sympy.Integer(2), 2.0)], [exprs[0], sympy.Integer(2)])
        return self._check(OPERATORS[token].sympy(*exprs), value)

    def _power(self, parts: Sequence[_Part], exprs: Sequence[sympy.Expr]) -> sympy.Expr:
        (base, constant), (exponent, size) = parts
        if size is None:
            return OPERATORS["^"].sympy(*exprs)
        if constant is None and abs(size) > _LARGEST_POWER:
            raise InputError(
                f"an exponent in {self.shown!r} is beyond {_LARGEST_POWER}; write it smaller"
            )
        if base.is_Rational and exponent.is_Rational and abs(size) > 64:
            return sympy.Float(constant) ** sympy.Float(size)
        coefficient = abs(float(base.as_coeff_Mul()[0]))
        # SymPy raises the number before the variables at once, as an exact integer.
        if coefficient and abs(size * math.log(coefficient)) > math.log(_LARGEST):
            raise self.too_large
        return OPERATORS["^"].sympy(*exprs)

    def _check_value(self, value: float) -> None:
        if math.isnan(value):
            raise self.not_real
        if math.isinf(value):
            raise self.too_large

    def _check(self, expr: sympy.Expr, value: float | None) -> _Part:
        """Check what SymPy has made; numbers too long to be exact become float64."""
        if any(expr is bad for bad in _INFINITE):
            raise self.too_large
        coefficient = expr.as_coeff_Mul()[0]
        if abs(coefficient) > _LARGEST:
            raise self.too_large
        if value is not None and (expr.is_Rational or expr.is_Float):
            value = float(expr)
            # SymPy's floats go on below those of float64.
            if (expr.is_Float and not value) or _is_long(expr):
                expr = sympy.Float(value)
        elif value and expr.is_Add and max(abs(float(a)) for a in expr.args) > _LOST * abs(value):
            expr = sympy.Float(value)
        if value is not None:
            self._check_value(value)
        return expr, value

    def finish(self, expr: sympy.Expr) -> sympy.Expr:
        """Check the whole: SymPy may have drawn numbers together from several parts."""
        if expr.has(*_INFINITE):
            raise self.too_large
        if expr.has(sympy.I):
            raise self.not_real
        long = {}
        for number in expr.atoms(sympy.Number):
            if abs(number) > _LARGEST:
                raise self.too_large
            if _is_long(number):
                long[number] = sympy.Float(float(number))
        return expr.xreplace(long) if long else expr


def _is_long(number: sympy.Number) -> bool:
    return number.is_Rational and max(abs(number.p), number.q) > _LARGEST_EXACT


def _is_sum(node: ast.AST) -> bool:
    return isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Sub))
