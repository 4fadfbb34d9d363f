from .bits import LARGEST_IN_FRACTION, REAL_RESOLUTION, complexity, number_bits
from .constants import free_constants, skeleton
from .curves import Curve, write_out
from .dimensions import Unit, Units, bare_term, read_units
from .evaluation import (
    Rows,
    compile_numpy,
    compile_rows,
    compile_scalar,
    differentiate,
    evaluate,
)
from .export import (
    JULIA_WORDS,
    AllDigits,
    abridged,
    arguments_of,
    call_names,
    julia_code,
    left_of,
    shown,
    slope_latex,
    take_inputs,
    to_latex,
    to_latex_formula,
    to_mathml,
    to_numpy,
    with_signs,
    write_line,
)
from .operators import FUNCTIONS, OPERATORS
from .own_bits import added_bits, bits_in_force, counting, read_own_bits
from .parsing import check_name, parse, unknown_calls
from .poles import has_pole
from .program import Program, compile_columns
from .ratios import expand_terms, ratio_forms
from .vocabulary import NAMED_FUNCTIONS, Vocabulary
from .writing import ByText, as_float_tree, marks, round_constants, to_text

__all__ = [
    "FUNCTIONS",
    "JULIA_WORDS",
    "LARGEST_IN_FRACTION",
    "NAMED_FUNCTIONS",
    "OPERATORS",
    "REAL_RESOLUTION",
    "AllDigits",
    "ByText",
    "Curve",
    "Program",
    "Rows",
    "Unit",
    "Units",
    "Vocabulary",
    "abridged",
    "added_bits",
    "arguments_of",
    "as_float_tree",
    "bare_term",
    "bits_in_force",
    "call_names",
    "check_name",
    "compile_columns",
    "compile_numpy",
    "compile_rows",
    "compile_scalar",
    "complexity",
    "counting",
    "differentiate",
    "evaluate",
    "expand_terms",
    "free_constants",
    "has_pole",
    "julia_code",
    "left_of",
    "marks",
    "number_bits",
    "parse",
    "ratio_forms",
    "read_own_bits",
    "read_units",
    "round_constants",
    "shown",
    "skeleton",
    "slope_latex",
    "take_inputs",
    "to_latex",
    "to_latex_formula",
    "to_mathml",
    "to_numpy",
    "to_text",
    "unknown_calls",
    "with_signs",
    "write_line",
    "write_out",
]
