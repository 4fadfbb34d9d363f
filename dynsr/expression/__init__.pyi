from .bits import LARGEST_IN_FRACTION, REAL_RESOLUTION, complexity, number_bits
from .evaluation import compile_numpy, compile_scalar, evaluate
from .export import (
    arguments_of,
    shown,
    to_julia,
    to_latex,
    to_mathml,
    to_numpy,
    to_python,
    to_text_block,
)
from .operators import FUNCTIONS, OPERATORS
from .parsing import check_name, parse
from .writing import as_float_tree, round_constants, to_text

__all__ = [
    "FUNCTIONS",
    "LARGEST_IN_FRACTION",
    "OPERATORS",
    "REAL_RESOLUTION",
    "arguments_of",
    "as_float_tree",
    "check_name",
    "compile_numpy",
    "compile_scalar",
    "complexity",
    "evaluate",
    "number_bits",
    "parse",
    "round_constants",
    "shown",
    "to_julia",
    "to_latex",
    "to_mathml",
    "to_numpy",
    "to_python",
    "to_text",
    "to_text_block",
]
