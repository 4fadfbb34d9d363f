"""The operator table: every other part that needs to know what ``sin`` or ``/`` means asks it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy


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
    Operator("asin", 1, np.arcsin, sympy.asin, "asin", "asin"),
    Operator("acos", 1, np.arccos, sympy.acos, "acos", "acos"),
    Operator("atan", 1, np.arctan, sympy.atan, "atan", "atan"),
    Operator("sinh", 1, np.sinh, sympy.sinh, "sinh", "sinh"),
    Operator("cosh", 1, np.cosh, sympy.cosh, "cosh", "cosh"),
    Operator("tanh", 1, np.tanh, sympy.tanh, "tanh", "tanh"),
    Operator("abs", 1, np.abs, sympy.Abs, "abs", "abs"),
    Operator("sign", 1, np.sign, sympy.sign, "sign", "sign"),
)

FUNCTIONS: dict[str, Operator] = {k: v for k, v in OPERATORS.items() if k.isidentifier()}
CONSTANTS: dict[str, sympy.Expr] = {"pi": sympy.pi}
