import numpy as np
import pytest
import sympy

from dynsr.data.samples import Samples
from dynsr.expression import skeleton
from dynsr.expression.parsing import parse
from dynsr.expression.writing import to_text
from dynsr.fit.candidates import score_candidate
from dynsr.fit.constants import refit
from dynsr.fit.description import Noise
from dynsr.fit.snapping import (
    normal_forms,
    readable,
    simple_numbers,
    snap,
    snap_best,
    tidy,
)
from dynsr.fit.variation import improve, loosen, neighbours


@pytest.fixture
def ratio():
    """Give slopes of a ratio with a small error, of which a few are wild."""
    rng = np.random.default_rng(0)
    X = rng.uniform(0.2, 2.0, (300, 2))
    x, v = X.T
    y = (2.5 * x - 3 * v) / (2 + x**2) + rng.normal(0, 1e-4, 300)
    y[::50] += 0.05
    return Samples(X, y, ("x", "v"), "v", "given", np.arange(300.0))


def same(expr, text):
    """Say whether two formulas are the same function."""
    return sympy.simplify(expr - sympy.nsimplify(parse(text), rational=True)) == 0


def test_simple_numbers_hold_the_usual_ones():
    """Near 2.6665 are 0, 3, 8/3 and short decimals, each once."""
    found = simple_numbers(2.6665)
    assert sympy.Rational(8, 3) in found and sympy.Rational(27, 10) in found
    assert len(found) == len(set(found))


def test_constants_of_a_ratio_snap_in_the_form_where_they_are_simple(ratio):
    """A ratio normalised otherwise is brought to the form with simple constants."""
    rough = parse("(1.26*x - 1.49*v)/(1 + 0.51*x^2)")
    found = snap(rough, ratio, Noise(1e-4, 300.0))
    assert same(found, "(2.5*x - 3*v)/(2 + x^2)")
    assert not found.atoms(sympy.Float)


def test_terms_that_do_not_pay_are_dropped(ratio):
    """A term whose constant is within the errors becomes 0."""
    rough = parse("(1.26*x - 1.49*v + 0.0001*v^2)/(1 + 0.51*x^2)")
    assert same(snap(rough, ratio, Noise(1e-4, 300.0)), "(2.5*x - 3*v)/(2 + x^2)")


def test_wild_rows_do_not_move_the_fit(ratio):
    """The robust fit is right although every fiftieth slope is wild."""
    found = refit(parse("(1.2*x - 1.4*v)/(1 + 0.6*x^2)"), ratio, 1e-4)
    values = sorted(float(a) for a in found.atoms(sympy.Float))
    assert values == pytest.approx([-1.5, 0.5, 1.25], abs=1e-3)


def test_every_normal_form_is_the_same_function():
    """The forms of a ratio agree in value."""
    forms = normal_forms(parse("(1.5*x + 2.0)/(4.0 + 0.5*x)"))
    assert len(forms) == 3
    assert {round(float(f.subs("x", 0.7)), 12) for f in forms} == {round(3.05 / 4.35, 12)}


def test_decimals_are_written_as_such_and_thirds_stay():
    """981/100 becomes 9.81, 8/3 and powers stay; 251/9 has too long a numerator to be shown."""
    found = tidy(parse("981/100*x^2 - 8/3*y"))
    assert found == sympy.Float(9.81) * parse("x^2") - sympy.Rational(8, 3) * sympy.Symbol("y")
    assert tidy(parse("251*x/9 + sqrt(x)")) == parse("27.8888888889*x + sqrt(x)")


def test_loosening_frees_every_coefficient_but_one():
    """Above the line all coefficients are floats; below it the last stays."""
    loose = loosen(parse("(x - 3*v)/(2 - x)"))
    assert len(loose.atoms(sympy.Float)) == 3


def test_a_variable_gives_way_to_its_sine():
    """Where y = sin(w) x, the near miss w x is led to it."""
    rng = np.random.default_rng(1)
    X = rng.uniform(-0.5, 0.5, (400, 2))
    y = 3 * np.sin(X[:, 0]) * X[:, 1] + rng.normal(0, 1e-5, 400)
    samples = Samples(X, y, ("w", "x"), "x", "given", np.arange(400.0))
    start = score_candidate(parse("2.9*w*x"), samples, "planted")
    found = improve(start, samples, Noise(1e-5, 400.0))
    assert same(found.expr, "3*sin(w)*x")
    assert parse("x*sin(w)") in neighbours(parse("w*x"))


def _pendulum_samples(noise: np.ndarray) -> Samples:
    t = np.linspace(0.0, 10.0, len(noise))
    angle, speed = np.sin(2.5 * t) * np.exp(-0.05 * t), 2.5 * np.cos(2.5 * t)
    y = -9.81 * np.sin(angle) - 0.1 * speed + noise
    return Samples(np.column_stack([angle, speed]), y, ("a", "v"), "v", "given", t)


def _heavy_tailed(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Errors as those of an adaptive solver: small, but for a few stretches."""
    return 2e-3 * rng.standard_t(1.5, rows)


def test_snapping_one_constant_frees_the_others():
    """Both constants come out exact though each fit alone is off in the third digit."""
    samples = _pendulum_samples(_heavy_tailed(np.random.default_rng(3), 1000))
    got = snap(parse("-9.79*sin(a) - 0.104*v"), samples, Noise(2e-3, 300.0))
    assert tidy(got) == parse("-9.81*sin(a) - 0.1*v")


def test_a_term_of_no_use_is_snapped_to_zero():
    """A small extra term that follows only noise disappears."""
    samples = _pendulum_samples(_heavy_tailed(np.random.default_rng(4), 1000))
    got = snap(parse("-9.79*sin(a) - 0.104*v + 0.002*a**3"), samples, Noise(2e-3, 300.0))
    assert not got.has(parse("a**3"))


def test_a_constant_that_is_not_simple_keeps_its_digits():
    """With exact samples pi times e is not replaced by a short number."""
    x = np.linspace(1.0, 2.0, 100)
    samples = Samples(x[:, None], np.pi * np.e * x, ("x",), "x", "given", x)
    got = snap(parse("8.5*x"), samples, Noise(1e-12, 100.0))
    assert float(got.coeff(sympy.Symbol("x"))) == pytest.approx(np.pi * np.e, rel=1e-10)


@pytest.mark.parametrize("value", [0.333337, -2.00001, 9.8099, 1e-9, 1234.6])
def test_simple_numbers_lie_near_or_are_zero(value):
    """Zero and the nearest whole number are always looked at; all others lie within 5 %."""
    numbers = simple_numbers(value)
    assert {0, round(value)} <= set(numbers)
    rest = set(numbers) - {0, round(value)}
    assert all(abs(float(n) - value) <= 0.05 * abs(value) for n in rest)


def test_snap_best_puts_the_true_shape_first():
    """Among a polynomial, a needlessly long and the true shape, the true one leads, exact."""
    samples = _pendulum_samples(_heavy_tailed(np.random.default_rng(5), 1000))
    shapes = ("-9.6*a - 0.1*v + 1.4*a**3", "-9.7*sin(a) - 0.11*v", "-9.7*sin(a) - 0.1*v + 0.01*a*v")
    candidates = [score_candidate(parse(s), samples) for s in shapes]
    best = snap_best(candidates, samples)[0]
    assert skeleton(best.expr) == skeleton(parse("-9.81*sin(a) - 0.1*v"))
    assert best.loss <= min(c.loss for c in candidates) * 1.01


def test_snap_best_of_nothing_is_nothing():
    """No candidate, no result."""
    assert snap_best([], _pendulum_samples(np.zeros(50))) == []


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("-6*x/(5*x + 4)", "-1.2*x/(x + 0.8)"),
        ("-4.027215932*x/(5*x + 7.574971234)", "-0.8054431864*x/(x + 1.5149942468)"),
        ("(3*x + 2)/(5*x + 4*y + 2)", "(0.6*x + 0.4)/(x + 0.8*y + 0.4)"),
        ("2*x + x**2/(4*x**2 + 9)", "0.25*x**2/(x**2 + 2.25) + 2*x"),
        ("x/(2*x + 1)", "x/(2*x + 1)"),
        ("x/(7*x + 3)", "x/(7*x + 3)"),
    ],
)
def test_ratios_are_written_as_in_textbooks(text, written):
    """A coefficient of the denominator is 1, but not where whole numbers would become long."""
    assert to_text(readable(parse(text))) == written
