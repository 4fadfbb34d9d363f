"""Expressions: the operator table, a parser without ``eval``, evaluation and complexity."""

from dynsr.expression.bits import LARGEST_IN_FRACTION, REAL_RESOLUTION, complexity, number_bits
from dynsr.expression.evaluation import compile_numpy, compile_scalar, evaluate
from dynsr.expression.operators import CONSTANTS, FUNCTIONS, OPERATORS, Operator
from dynsr.expression.parsing import check_name, parse
from dynsr.expression.text import as_float_tree, round_constants, to_text

__all__ = [
    "CONSTANTS",
    "FUNCTIONS",
    "LARGEST_IN_FRACTION",
    "OPERATORS",
    "REAL_RESOLUTION",
    "Operator",
    "as_float_tree",
    "check_name",
    "compile_numpy",
    "compile_scalar",
    "complexity",
    "evaluate",
    "number_bits",
    "parse",
    "round_constants",
    "to_text",
]
