"""Programs of array operations, against sympy's own lambdify and exact values."""

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from dynsr.expression import compile_columns, compile_numpy, differentiate, parse

NAMES = ["x", "y", "z"]
SYMBOLS = sympy.symbols(NAMES)
FUNCTIONS = [sympy.sin, sympy.cos, sympy.tanh, sympy.exp, sympy.log, sympy.Abs, sympy.sqrt]
FUNCTIONS += [sympy.asin, sympy.acos, sympy.atan, sympy.tan]


def numbers():
    """Give whole numbers, fractions and floats."""
    whole = st.integers(-5, 5).map(sympy.Integer)
    ratio = st.fractions(-4, 4, max_denominator=6).map(lambda f: sympy.Rational(str(f)))
    return whole | ratio | st.floats(-10, 10, allow_nan=False).map(sympy.Float)


def expressions():
    """Give expressions of sums, products, powers, roots, ratios and nested functions."""
    exponent = st.sampled_from(
        [
            -3,
            -2,
            -1,
            2,
            3,
            4,
            5,
            sympy.Rational(1, 2),
            sympy.Rational(-1, 2),
            sympy.Rational(1, 3),
            sympy.Rational(-3, 2),
            sympy.Float(1.7),
        ]
    )
    return st.recursive(
        st.sampled_from(SYMBOLS) | numbers(),
        lambda inner: (
            st.tuples(inner, inner).map(lambda p: p[0] + p[1])
            | st.tuples(inner, inner).map(lambda p: p[0] * p[1])
            | st.tuples(inner, inner).map(lambda p: p[0] - p[1] / 3)
            | st.tuples(inner, inner).map(lambda p: p[0] / (p[1] ** 2 + 1))
            | st.tuples(inner, exponent).map(lambda p: p[0] ** p[1])
            | st.tuples(st.sampled_from(FUNCTIONS), inner).map(lambda p: p[0](p[1]))
        ),
        max_leaves=8,
    ).filter(lambda e: not e.has(sympy.I, sympy.zoo, sympy.nan, sympy.oo, sympy.AccumBounds))


@pytest.mark.slow
@settings(max_examples=80, deadline=None, derandomize=True)
@given(st.lists(expressions(), min_size=1, max_size=3))
def test_programs_agree_with_lambdify(exprs):
    """Where both are finite, every expression has the values of sympy's own translation."""
    points = np.random.default_rng(0).uniform(0.1, 3, (3, 20))
    found = compile_columns(exprs, NAMES)(*points)
    expected = compile_numpy(exprs, NAMES)(points)
    with np.errstate(all="ignore"):
        both = np.isfinite(found) & np.isfinite(expected) & (np.abs(expected) < 1e100)
    # A rounding in an argument of 1e15 turns a sine: only what is well posed is compared.
    moved = compile_numpy(exprs, NAMES)(points * (1 + 1e-13))
    with np.errstate(all="ignore"):
        posed = np.abs(moved - expected) <= 1e-9 * np.abs(expected) + 1e-300
    both &= posed
    np.testing.assert_allclose(found[both], expected[both], rtol=1e-8)
    assert np.array_equal(np.isfinite(found)[posed], np.isfinite(expected)[posed])


@pytest.mark.slow
@settings(max_examples=80, deadline=None, derandomize=True)
@given(expressions())
def test_slopes_agree_with_sympy(expr):
    """Slopes by every argument are the values of SymPy's own derivatives."""
    points = np.random.default_rng(0).uniform(0.1, 3, (3, 20))
    slopes = [differentiate(expr, sympy.Symbol(name)) for name in NAMES]
    expected = compile_numpy(slopes, NAMES)(points)
    moved = compile_numpy(slopes, NAMES)(points * (1 + 1e-13))
    found = compile_columns([expr], NAMES, NAMES)(*points)[1:]
    with np.errstate(all="ignore"):
        posed = np.abs(moved - expected) <= 1e-9 * np.abs(expected) + 1e-300
        posed &= np.abs(expected) < 1e100
    np.testing.assert_allclose(found[posed], expected[posed], rtol=1e-8, atol=1e-300)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("x^(-1)", 0.25),
        ("x^(-2)", 0.0625),
        ("y*x^(-3)", 9 / 64),
        ("1/(x*y)", 1 / 36),
        ("-x", -4.0),
        ("2 - x/y", 2 - 4 / 9),
        ("sqrt(x)", 2.0),
        ("x/sqrt(y)", 4 / 3),
        ("y^(3/2)", 27.0),
        ("y^(-3/2)", 1 / 27),
        ("x^5", 1024.0),
        ("x^y", 4.0**9),
        ("x^0.5*x^1.5", 16.0),
        ("exp(log(sqrt(x) + abs(-y)))", 11.0),
        ("pi", np.pi),
        ("7", 7.0),
        ("sin(pi/6)*x", 2.0),
    ],
)
def test_values_are_exact(text, value):
    """Powers, roots, ratios, constants and nested functions have the values they should."""
    assert float(compile_columns([parse(text)], ["x", "y"])(4.0, 9.0)[0]) == pytest.approx(
        value, rel=1e-14
    )


def test_arguments_broadcast():
    """Arguments of shapes (3, 1, 1), (4, 1) and (5,) give (k, 3, 4, 5), constants too."""
    x, y, z = np.arange(3.0)[:, None, None], np.arange(4.0)[:, None], np.arange(5.0)
    found = compile_columns([parse("x + 10*y + 100*z"), parse("2.5"), parse("x")], NAMES)(x, y, z)
    assert found.shape == (3, 3, 4, 5)
    np.testing.assert_array_equal(found[0], x + 10 * y + 100 * z)
    np.testing.assert_array_equal(found[1], np.full((3, 4, 5), 2.5))
    np.testing.assert_array_equal(found[2], np.broadcast_to(x, (3, 4, 5)))


@pytest.mark.filterwarnings("error")
def test_outside_the_domain_there_is_no_number():
    """log and roots of negative numbers are NaN, a pole is inf, an overflow inf, with no word."""
    exprs = [parse(e) for e in ("log(x)", "sqrt(x)", "x^(1/3)", "1/(x + 1)", "exp(-1000*x)")]
    found = compile_columns(exprs, ["x"])(np.array([-1.0, 1.0]))
    assert np.isnan(found[:3, 0]).all()
    assert np.isinf(found[3, 0]) and np.isinf(found[4, 0])
    np.testing.assert_allclose(found[:, 1], [0, 1, 1, 0.5, 0])


def test_an_imaginary_number_is_no_number():
    """What sympy turned complex gives NaN rather than an error."""
    x = sympy.Symbol("x")
    assert np.isnan(compile_columns([sympy.I * x], ["x"])(2.0)[0])
    assert np.isnan(compile_columns([sympy.zoo + x], ["x"])(2.0)[0])


def test_a_variable_without_argument_is_named():
    """The name that has no argument is in the KeyError."""
    with pytest.raises(KeyError, match="w"):
        compile_columns([parse("x*w")], ["x"])


def test_equal_subexpressions_are_computed_once():
    """Ten copies of one formula take as many steps as one of them."""
    expr = parse("sin(x*y)/(1 + exp(x*y))")
    one = compile_columns([expr], NAMES)
    ten = compile_columns([expr] * 10, NAMES)
    assert len(one.steps) == len(ten.steps)
    assert ten(1.0, 2.0, 3.0).tolist() == [float(one(1.0, 2.0, 3.0)[0])] * 10


def test_arguments_stay_as_they_are():
    """No argument is written to."""
    x = np.array([1.0, 2.0])
    x.flags.writeable = False
    compile_columns([parse("x"), parse("x^2 + x"), parse("-x")], ["x"])(x)
    np.testing.assert_array_equal(x, [1, 2])


@pytest.mark.slow
@settings(max_examples=80, deadline=None, derandomize=True)
@given(st.lists(expressions(), min_size=1, max_size=3), st.tuples(*[st.integers(-3, 3)] * 3))
def test_a_point_has_the_very_values_of_arrays(exprs, whole):
    """At floats, zeros among them, a program gives bit for bit what it gives for arrays."""
    program, point = compile_columns(exprs, NAMES), [0.7 * number for number in whole]
    expected = program(*np.array(point)[:, None])[:, 0]
    with np.errstate(all="ignore"):
        found = program.at(*point)
    assert all(type(value) is float for value in found)
    np.testing.assert_array_equal(found, expected)
