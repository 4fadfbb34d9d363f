import math

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from dynsr.errors import InputError
from dynsr.expression.bits import complexity, number_bits
from dynsr.expression.evaluation import compile_numpy, compile_scalar, evaluate
from dynsr.expression.operators import OPERATORS
from dynsr.expression.parsing import check_name, parse
from dynsr.expression.writing import round_constants, to_text

x, y = sympy.symbols("x y")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1.5x",
        "__import__('os').system('true')",
        "x.__class__",
        "x[0]",
        "lambda: 1",
        "unknown(x)",
        "(x",
        "x if y else 1",
        "sin(x, y)",
        "'a'",
        "1j",
        "z + 1",
        "x = 1",
        "x" * 200_000,
        "-" * 500 + "x",
    ],
)
def test_what_is_no_expression_is_refused_in_one_line(text: str):
    """Nothing but arithmetic on the given names is read, and the refusal is one short line."""
    with pytest.raises(InputError) as caught:
        parse(text, ["x", "y"])
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


@pytest.mark.parametrize(
    "text",
    [
        "9**9**9",
        "9**9**9**9",
        "((((10**64)**64)**64)**64)**64",
        "10**10**8 * x",
        "x + 1e308*10",
        "sinh(sinh(sinh(9.0)))",
        "exp(1e10)",
    ],
)
def test_numbers_beyond_float64_are_refused_at_once(text: str):
    """Exact arithmetic would need 370 million digits for 9^9^9, and has no end for the tower."""
    with pytest.raises(InputError, match="beyond what float64 holds"):
        parse(text)


def test_large_powers_that_float64_holds_are_read():
    """Up to the largest float64, powers are read to rounding."""
    assert float(parse("2**1000")) == 2.0**1000
    assert float(parse("10**-300*x").subs(sympy.Symbol("x"), 1)) == pytest.approx(1e-300)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_text_keeps_every_float(value: float):
    """to_text and parse bring the same float64 back."""
    expr = sympy.Float(value) * x + 1
    again = parse(to_text(expr))
    assert again == expr


def test_sympy_reads_the_text_too():
    """SymPy's own reader gives the same function for what to_text writes."""
    expr = parse("x*(1.5 - y)/(2 + cos(x)^2) - 0.1*exp(-y) + abs(x)")
    other = sympy.sympify(to_text(expr))
    assert abs(complex((expr - other).subs({x: 0.3, y: 0.7}))) < 1e-15


@pytest.mark.parametrize(
    "name", ["sin", "1x", "a b", "lambda", "", "pi", "x-y", "__import__('os')"]
)
def test_names_that_cannot_stand_in_a_formula_are_refused(name: str):
    """Identifiers only, and none that is a function, a constant or a keyword."""
    with pytest.raises(InputError):
        check_name(name)


def test_an_expression_that_is_taken_is_not_printed():
    """Printing takes longer than the check; what is refused is shown."""

    class Unprintable(sympy.Function):
        def _sympystr(self, printer):
            raise AssertionError

    assert parse(Unprintable(x), ["x"]) == Unprintable(x)
    with pytest.raises(InputError, match=r"unknown name 'x' in '2\*x'; the variables are: y"):
        parse(2 * x, ["y"])


def test_every_operator_means_the_same_in_numpy_and_sympy():
    """The table's numpy and SymPy columns agree at random points."""
    points = np.random.default_rng(0).uniform(0.1, 0.9, size=(2, 20))
    for operator in OPERATORS.values():
        symbols = (x, y)[: operator.arity]
        compiled = compile_numpy([operator.sympy(*symbols)], ["x", "y"])(points)[0]
        np.testing.assert_allclose(
            compiled, operator.numpy(*points[: operator.arity]), rtol=1e-12, err_msg=operator.token
        )


def test_values_outside_the_domain_are_nan_without_a_warning():
    """log and sqrt of negative numbers and a division by zero are marked, not raised."""
    columns = {"x": np.array([-1.0, 0.0, 1.0])}
    assert np.isnan(evaluate(parse("log(x)"), columns)[0])
    assert np.isnan(evaluate(parse("sqrt(x)"), columns)[0])
    assert not np.isfinite(evaluate(parse("1/x"), columns)[1])


def test_scalar_and_array_functions_agree():
    """compile_scalar gives at a point what compile_numpy gives on arrays."""
    exprs = [parse("x*sin(y) - 2"), parse("x^3/(1 + y^2)")]
    array = compile_numpy(exprs, ["x", "y"])(np.array([1.3, 0.4]))
    assert compile_scalar(exprs, ["x", "y"])(1.3, 0.4) == pytest.approx(array.tolist(), rel=1e-15)


def test_complexity_counts_as_the_formula_says():
    """x*y + x holds 5 occurrences of 4 kinds, and the constant 3 two bits more."""
    assert complexity(x * y + x) == pytest.approx(5 * math.log2(4))
    assert complexity(x * y + 3 * x) == pytest.approx(6 * math.log2(4) + 2)


def test_rounding_a_constant_makes_it_cheaper():
    """9.81 costs fewer bits than 9.8100371, and that fewer than a real of full precision."""
    bits = [number_bits(sympy.Float(v)) for v in (9.81, 9.8100371, 9.810037134567891)]
    assert bits == sorted(bits) and bits[0] < bits[-1]
    assert round_constants(parse("9.8100371*x"), 3) == parse("9.81*x")


@pytest.mark.parametrize(
    "text",
    [
        "1.5*x - x*y/3 + pi",
        "(x**2 - 2*y)/(1 + cos(y)**2)",
        "sqrt(x)*log(y)/y**3",
        "x**0.5 + x**-1.5 + x**(1/3) + 2**x",
        "exp(-x/y)*tanh(x)*abs(y) + asin(x/9) + sign(-y)",
        sympy.log(-x) + sympy.I,
        "5",
        sympy.zoo,
    ],
)
def test_walked_and_compiled_values_agree(text):
    """Node-by-node evaluation gives what the compiled function gives, NaN and inf included."""
    rng = np.random.default_rng(7)
    columns = {"x": rng.uniform(0.1, 3, 40), "y": rng.uniform(0.1, 3, 40)}
    expr = parse(text)
    compiled = compile_numpy([expr], ["x", "y"])(np.array(list(columns.values())))[0]
    np.testing.assert_allclose(evaluate(expr, columns), compiled, rtol=1e-12)


def test_walking_names_a_missing_column():
    """An expression in a variable that no column gives is an error, not a number."""
    with pytest.raises(KeyError, match="z"):
        evaluate(parse("x + z"), {"x": np.ones(3)})
