"""Formulas that come from outside are read in bounded time, hold numbers, and run nothing."""

import ast
import inspect
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

import dynsr
from dynsr.data.system import System
from dynsr.errors import InputError
from dynsr.expression.evaluation import evaluate
from dynsr.expression.operators import FUNCTIONS
from dynsr.expression.parsing import check_name, parse
from dynsr.expression.writing import to_text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1/0", "beyond what float64 holds"),
        ("x/0", "beyond what float64 holds"),
        ("1/(x - x)", "beyond what float64 holds"),
        ("0*log(0)", "beyond what float64 holds"),
        ("0/0", "no real value"),
        ("sqrt(-1)*x", "no real value"),
        ("asin(2)", "no real value"),
        ("zoo", "'zoo' in 'zoo' is no number"),
        ("x + nan", "'nan' in 'x .* nan' is no number"),
        ("-oo", "'oo' in '-oo' is no number"),
        ("1e400*x", "beyond what float64 holds"),
        ("9" * 4000, "beyond what float64 holds"),
        ("exp(exp(exp(exp(9))))", "beyond what float64 holds"),
        ("sinh(sinh(sinh(sinh(9))))", "nested too deeply"),
        ("pi**pi**pi**pi", "beyond what float64 holds"),
        ("x*10**300*10**300", "beyond what float64 holds"),
        ("(2*x)**10**12", "an exponent in .* is beyond 1000"),
        ("((2*x)**1000)**1000", "beyond what float64 holds"),
        ("x**1e308", "an exponent in .* is beyond 1000"),
        ("square(2*x*" * 32 + "x" + ")" * 32, "nested too deeply"),
        ("abs(x+" * 100 + "x" + ")" * 100, "nested too deeply"),
        ("tanh(x+" * 9 + "x" + ")" * 9, "nested too deeply"),
        ("sin(" * 190 + "1" + ")" * 190, "nested too deeply"),
        ("x#y", "cannot read"),
        ("[" * 90 + "x" + "]" * 90, "cannot read"),
        ("(" * 5000 + "x" + ")" * 5000, "cannot read"),
    ],
)
def test_towers_and_numbers_that_are_none_are_refused_at_once(text, said):
    """Each would stand still, fill the memory or mean no number; one short line says so."""
    with pytest.raises(InputError, match=said) as caught:
        parse(text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "text", ["9**9**9", "1/0", "nan", "(2*k)**40000", "x**(k**k**k)", "x.real"]
)
def test_equations_of_a_system_are_read_by_the_same_reader(text):
    """Parameters are numbers as soon as they are read, so that no power of them runs away."""
    with pytest.raises(InputError):
        System.from_strings({"x": text}, parameters={"k": 64})


def test_parameters_are_numbers_inside_the_formula():
    """A whole parameter stays exact, another is a float, and a large one no exact integer."""
    found = System.from_strings(
        {"x": "a*x**n + b"}, parameters={"a": np.int64(2), "n": 3, "b": 10**30}
    )
    (x,) = sympy.symbols(("x",))
    assert found.rhs == (2 * x**3 + sympy.Float(1e30),)


def test_large_integers_can_be_evaluated():
    """Integers beyond those of NumPy become floats, since its sine takes no others."""
    assert evaluate(parse("x*sin(10**30)"), {"x": np.ones(1)}) == pytest.approx(math.sin(1e30))


def test_names_that_unicode_writes_otherwise_are_refused():
    """The micro sign is read as mu in a formula: a state of that name would be unknown there."""
    with pytest.raises(InputError, match=r"is read as .* \(U\+03BC\) in a formula; call it so"):
        System.from_strings({"\u00b5": "-\u00b5"})
    assert check_name("\u03bc") == "\u03bc"
    assert str(parse("-\u00b5", ["\u03bc"])) == "-\u03bc"


def _leaves():
    numbers = st.one_of(
        st.integers(0, 10**6).map(str),
        st.floats(0, 1e300, allow_nan=False).map(repr),
        st.sampled_from(["pi", "0", "1e-300", "10**18", "9**9**9"]),
    )
    return st.one_of(st.sampled_from(["x", "y"]), numbers)


def _grow(inner):
    return st.one_of(
        st.tuples(inner, st.sampled_from("+-*/^"), inner).map(lambda p: f"({p[0]}){p[1]}({p[2]})"),
        st.tuples(st.sampled_from(sorted(FUNCTIONS)), inner).map(lambda p: f"{p[0]}({p[1]})"),
        inner.map(lambda text: f"-({text})"),
    )


FORMULAS = st.recursive(_leaves(), _grow, max_leaves=14)
_MATH = {
    "abs": abs,
    "inv": lambda a: 1 / a,
    "square": lambda a: a * a,
    "neg": lambda a: -a,
    "identity": lambda a: a,
    "sign": lambda a: float((a > 0) - (a < 0)),
}


def _by_hand(node, x, y, shaken=0.0):
    """Evaluate Python's syntax tree with its own floats, of which each may be a little another."""
    match node:
        case ast.Constant(value=value):
            return float(value) * (1 + shaken * (node.col_offset % 7))
        case ast.Name(id=name):
            return {"x": x, "y": y, "pi": math.pi}[name]
        case ast.UnaryOp(operand=operand):
            return -_by_hand(operand, x, y, shaken)
        case ast.Call(func=func, args=[argument]):
            function = _MATH.get(func.id) or getattr(math, func.id)
            return function(_by_hand(argument, x, y, shaken))
    power = not isinstance(node.op, (ast.Add, ast.Sub, ast.Mult, ast.Div))
    # A root of a negative number is none, and its whole powers are.
    exact = power and isinstance(node.right, ast.Constant)
    a, b = _by_hand(node.left, x, y, shaken), _by_hand(node.right, x, y, 0.0 if exact else shaken)
    match node.op:
        case ast.Add():
            return a + b
        case ast.Sub():
            return a - b
        case ast.Mult():
            return a * b
        case ast.Div():
            return a / b
    return math.pow(a, b)


def _steady(text, x, y):
    """Give the value by hand where a change in the last digits changes little; else None."""
    tree = ast.parse(text.replace("^", "**"), mode="eval").body
    try:
        value = _by_hand(tree, x, y)
        nearby = _by_hand(tree, x * (1 + 1e-11), y * (1 - 1e-11), 1e-11)
    except (ValueError, ArithmeticError):
        return None
    steady = math.isclose(value, nearby, rel_tol=1e-7) and 1e-200 < abs(value) < 1e200
    return value if steady else None


@pytest.mark.parametrize("text", ["sqrt(-1)", "sqrt(-((x)/(x)))", "x + (-x/x)^0.5"])
def test_a_formula_without_a_real_value_is_refused(text):
    """What SymPy cancels to the root of a negative number is none of the real numbers."""
    with pytest.raises(InputError, match="no real value"):
        parse(text)


def test_what_sympy_draws_together_is_not_lost_in_rounding():
    """SymPy reads acos(cos(10^18)) as 10^18 less a multiple of pi, which is 128 in float64."""
    found = evaluate(parse("x - acos(cos(10**18))"), {"x": np.array([0.5])})[0]
    assert found == pytest.approx(0.5 - math.acos(math.cos(1e18)), rel=1e-9)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(FORMULAS)
def test_a_formula_means_what_arithmetic_says_or_is_refused(text):
    """What is read has the value that Python's floats give, and stays so when written and read."""
    try:
        expr = parse(text)
    except InputError:
        return
    assert all(abs(number) <= sys.float_info.max for number in expr.atoms(sympy.Number))
    assert not expr.has(sympy.zoo, sympy.nan, sympy.oo)
    point = {"x": np.array([0.7]), "y": np.array([1.9])}
    value = _steady(text, 0.7, 1.9)
    found = evaluate(expr, point)[0]
    if value is not None and np.isfinite(found):
        assert found == pytest.approx(value, rel=1e-5)
    try:
        again = evaluate(parse(to_text(expr)), point)[0]
    except InputError:
        # SymPy may write a number as a power or a quotient that float64 does not hold.
        return
    if value is not None:
        np.testing.assert_allclose(again, found, rtol=1e-6)


@pytest.mark.slow
@settings(max_examples=500, deadline=None)
@given(
    st.text(
        alphabet="xy019.e+-*/^() \t\nsincoepqrtabzuI_,[]'\"\\\u00b5\u2212\ud800\0#", max_size=60
    )
)
def test_any_text_is_a_formula_or_one_line(text):
    """Whatever stands there, the answer is an expression or an InputError of one line."""
    try:
        found = parse(text)
    except InputError as error:
        found = error
    assert isinstance(found, sympy.Expr) or "\n" not in str(found)


def test_no_string_reaches_the_parser_of_sympy(monkeypatch):
    """Reading, writing and evaluating never call it, even where SymPy converts by itself."""

    def refuse(*args, **kwargs):
        raise AssertionError("SymPy was asked to evaluate a string")

    monkeypatch.setattr("sympy.parsing.sympy_parser.parse_expr", refuse)
    with pytest.raises(AssertionError):
        sympy.sympify("x + 1")
    system = System.from_strings({"x": "-k*x + F"}, inputs={"F": "sin(t)"}, parameters={"k": 2})
    assert to_text(parse(to_text(system.rhs[0]), ["x", "F"])) == "F - 2*x"


FORBIDDEN = {"sympify", "parse_expr", "eval", "exec", "literal_eval"}


def _calls(path):
    """Name the calls of a file that could evaluate text."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            bare = isinstance(node.func, ast.Name)
            # re.compile compiles no Python; S of SymPy is fine as a namespace.
            if name in FORBIDDEN or (name == "compile" and bare) or name == "S":
                yield f"{path.name}:{node.lineno} {name}"


@pytest.mark.slow
def test_no_file_evaluates_text():
    """The only reader of formulas is dynsr.expression.parse, and it builds them node by node."""
    folder = Path(inspect.getfile(dynsr)).parent
    found = [call for path in sorted(folder.rglob("*.py")) for call in _calls(path)]
    assert found == []
    assert list(_calls(Path(__file__)))  # the search itself finds this file's own call
