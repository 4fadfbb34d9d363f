"""Wide terms, sums that are like an equation, and equations found anew among them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy
from measured_systems import floats, measured

from dynsr.expression import evaluate, parse
from dynsr.fit import skeleton
from dynsr.methods.demands import read_demands
from dynsr.selection import ComparisonSettings
from dynsr.selection.comparison import SystemComparison
from dynsr.selection.likeness import Likeness
from dynsr.selection.renewal import renew, renewals
from dynsr.selection.terms import Terms, TermSettings
from dynsr.selection.wide import WideTerms

SETTINGS = ComparisonSettings()
RNG = np.random.default_rng(4)
# Two columns along which nothing is at rest, both positive, the second the larger one.
COLUMNS = {"x": RNG.uniform(0.4, 3.1, 200), "y": RNG.uniform(3.2, 5.0, 200)}
POINTS = np.array(list(COLUMNS.values()))
WIDE = WideTerms.of(tuple(COLUMNS), POINTS, ())
VALUES = WIDE.values(POINTS)
# What drifts with the flow in one of many cells side by side.
CELL = {"x": "-0.8*sin(x)*cos(y)", "y": "0.8*cos(x)*sin(y)"}
# Equations that it might begin from.
BEGUN = {"x": "1.0 - 0.8*y", "y": "0.8*x - 1.1"}


def places(text):
    """Places of the terms of one shape."""
    shape = skeleton(parse(text))
    return [i for i in range(len(WIDE.places)) if skeleton(WIDE.write(i)) == shape]


def like(allow=lambda _: True):
    """What looks for sums like a function of the two columns."""
    terms = Terms.grow(tuple(COLUMNS), POINTS, TermSettings(), ())
    return Likeness(terms, WIDE, tuple(COLUMNS), POINTS, 4.0, allow)


def test_a_term_is_worth_what_is_written():
    """Every tenth term has the values that its formula has."""
    values = WIDE.values(POINTS)[:, 0]
    assert len(WIDE.places) > 800
    for place in range(0, len(WIDE.places), 10):
        expected = evaluate(WIDE.write(place), COLUMNS)
        np.testing.assert_allclose(values[place], expected, rtol=1e-9, atol=1e-12)


def test_slopes_by_constants_are_those_of_the_formula():
    """The slope of exp(c x) y by log c is c x exp(c x) y; of a product both are there."""
    x, y = POINTS
    values = WIDE.values(POINTS)
    for place in places("y*exp(-1.5*x)"):
        (c,) = WIDE.write(place).atoms(sympy.Float)
        expected = float(c) * x * np.exp(float(c) * x) * y
        np.testing.assert_allclose(values[place, 1], expected, rtol=1e-3)
    for place in places("x*y/((1.5 + x)*(2.5 + y))"):
        lines = sympy.fraction(WIDE.write(place))[1].args
        by = {str(name): float(k) for k, name in (line.args for line in lines)}
        own = values[place, 0]
        expected = sorted([by["x"] / (by["x"] + x), by["y"] / (by["y"] + y)], key=np.sum)
        found = sorted([-values[place, 1] / own, -values[place, -1] / own], key=np.sum)
        np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_every_kind_of_function_is_there():
    """Products of functions, functions of two columns, steps and lines of two columns are terms."""
    shapes = {skeleton(WIDE.write(i)) for i in range(len(WIDE.places))}
    for text in (
        "sin(x)*cos(y)",
        "sin(x - y)",
        "x*sqrt(x^2 + y^2)",
        "sqrt(y - x)",
        "x*y/(x + 1.5*y + 2.5)",
        "x*y/(x + 1.5*x^2 + 2.5)",
        "exp(-1.5/x)",
        "1/x^3",
        "1/(1 + exp(1.5 - 2.5*x - 3.5*y))",
        "1/(1 + exp(1.5 - 2.5*x + 3.5*y))",
        "x*y/((x + 1.5)*(y + 2.5))",
        "(x - y)^3",
        "tanh(1.5*x - 2.5*y)",
        "tanh(1.5*x + 2.5*y)",
    ):
        assert skeleton(parse(text)) in shapes, text


def test_roots_of_what_may_be_negative_are_left_out():
    """Of x - y, which is negative throughout, and of a column of both signs there is no root."""
    assert not places("sqrt(x - y)")
    both = WideTerms.of(("x", "v"), np.array([POINTS[0], POINTS[1] - 4]), ())
    exprs = [both.write(i) for i in range(len(both.places))]
    v = sympy.Symbol("v")
    assert not any(e.has(sympy.sqrt(v), sympy.log(v), 1 / v) for e in exprs)


@pytest.mark.parametrize(
    "text",
    [
        "0.9*sin(x)*cos(y) - 0.4*x",
        "1.1/(1 + exp(0.9 - 5.2*x + 3.1*y)) - 0.9*x",
        "1.3/x^3 - 1.1/x^2",
        "0.7 - 0.9*sqrt(y - x)",
        "1.2*x/(0.5 + x + 0.8*y)",
        "0.7 - 1.3*(x - y)^3 - 0.4*y",
        # What curves as much as others do leads once its constant has moved to its place.
        "0.9*x - 0.3*x^2 - 0.8*x*y/(0.7 + x)",
        "1.7/(1.2 + x^3) - 0.5*y",
        "2.3/(1.4 + x^6) - 0.5*y",
    ],
)
@pytest.mark.slow
def test_a_sum_is_found_by_what_it_is_worth(text):
    """Among thousands of terms the sum that has the values of a function comes up."""
    found = like().wide_sums(VALUES, evaluate(parse(text), COLUMNS), np.inf)
    assert skeleton(parse(text)) in {skeleton(expr) for expr, _ in found}


def test_constants_move_to_their_places():
    """From the nearest of a few half-saturations a term comes to that of the function."""
    target = evaluate(parse("2.5*x^2/(1.7 + x^2)"), COLUMNS)
    which = np.isin(np.arange(len(WIDE.places)), places("x^2/(1.5 + x^2)"))
    still, found = WIDE.likest(VALUES, target, [POINTS[:0]], which, 2, POINTS)
    assert still.constants != pytest.approx([math.sqrt(1.7)], rel=1e-3)
    assert found.constants == pytest.approx([math.sqrt(1.7)], rel=1e-4)
    term = WIDE.write(found.place, found.constants)
    np.testing.assert_allclose(2.5 * evaluate(term, COLUMNS), target, rtol=1e-4)
    np.testing.assert_allclose(found.block[0], evaluate(term, COLUMNS))


@pytest.mark.parametrize("size", [1e80, 1e120, 1e180, 1e250])
@pytest.mark.slow
def test_values_beyond_numbers_are_let_be(size):
    """A function whose squares are no numbers is like nothing, and ends no search."""
    target = size * evaluate(parse("exp(1.2*x)*y"), COLUMNS)
    found = like().wide_sums(VALUES, target, np.inf)
    assert bool(found) == (size < 1e100)


def test_what_holds_no_constant_is_fitted_already():
    """A product of two columns is given back as it is."""
    assert like().fitted(parse("x*y"), POINTS[0]) == parse("x*y")


def test_what_begins_at_nothing_saturates_too():
    """A column that noise takes a little below 0 has saturations; one of both signs has none."""
    shape = skeleton(parse("x/(1.5 + x)"))
    for least, has in ((-0.01, True), (-0.5, False)):
        rows = np.array([np.linspace(least, 1.2, 50)])
        wide = WideTerms.of(("x",), rows, ())
        assert (shape in {skeleton(wide.write(i)) for i in range(len(wide.places))}) == has


def test_no_sum_is_longer_than_asked_for():
    """With room for few bits only short sums come, and with none there are none."""
    target = evaluate(parse("0.9*sin(x)*cos(y) - 0.4*x"), COLUMNS)
    assert all(bits < 30 for _, bits in like().wide_sums(VALUES, target, 30.0))
    assert like().wide_sums(VALUES, target, 0.0) == []


def test_no_sum_is_like_a_constant():
    """What is the same everywhere has no likeness, and neither has what is no number."""
    for value in (0.0, 2.5, np.nan):
        assert like().wide_sums(VALUES, np.full(200, value), np.inf) == []


def test_what_is_not_allowed_is_in_no_sum():
    """Without functions no sum has one."""
    target = evaluate(parse("0.9*sin(x)*cos(y) - 0.4*x"), COLUMNS)
    found = like(lambda e: not e.has(sympy.Function)).wide_sums(VALUES, target, np.inf)
    assert found
    assert not any(expr.has(sympy.Function) for expr, _ in found)


def drifting():
    """A comparison of the drift at 1 %."""
    data = measured(tuple(CELL.items()), (0.9, 0.6), 12.0, 120, 0.01)
    return SystemComparison(data.mesh(("x", "y")), SETTINGS)


@pytest.mark.slow
@pytest.mark.parametrize("state", ["x", "y"])
def test_a_product_of_waves_is_found_from_a_line(state):
    """Beside the other equation one is found anew as a product of a sine and a cosine."""
    comparison = drifting()
    wrong = comparison.fit(floats({**CELL, state: BEGUN[state]}))
    best = renew(comparison, wrong, lambda fit: fit)
    assert skeleton(best.exprs[state]) == skeleton(floats(CELL)[state])
    assert best.bits < wrong.bits - 50


@pytest.mark.slow
def test_what_the_user_forbids_is_no_wide_term():
    """Where no function is allowed, none is found anew."""
    demands = read_demands(("x", "y"), ("x", "y"), functions=[], constraints=[])
    comparison = SystemComparison(drifting().mesh, replace(SETTINGS, demands=demands))
    found = renewals(comparison, comparison.fit(floats(BEGUN)), "x")
    assert found
    assert not any(e.has(sympy.Function) for e in found)


def test_a_distance_is_offered_only_where_the_difference_changes_sign():
    """Of one sign it is the difference itself, and beside the data it would be another law."""
    x = np.linspace(0.5, 2.0, 60)

    def has_distance(other):
        wide = WideTerms.of(["x", "y"], np.array([x, other]), [])
        return any(wide.write(i).has(sympy.Abs) for i in range(len(wide.places)))

    assert has_distance(3.0 - x)
    assert not has_distance(5.0 + np.sin(x))


@pytest.mark.slow
def test_exponents_are_free_where_they_are_asked_for():
    """A repression of the power 2.5 is found from exact values; without, no term has its shape."""
    x = np.linspace(0.3, 3.0, 150)
    points = np.array([x, 1.5 + np.sin(3 * x)])
    target = 1.8 / (1 + x**2.5) - 0.6 * points[1]
    for powers in (True, False):
        wide = WideTerms.of(["x", "y"], points, [], powers=powers)
        terms = Terms.grow(["x", "y"], points, TermSettings(inside=()), [])
        one = Likeness(terms, wide, ("x", "y"), points, 4.0, lambda _: True, drafted=20)
        sums = [
            one.fitted(e, target) for e, _ in one.wide_sums(wide.values(points), target, np.inf)
        ]
        columns = dict(zip("xy", points, strict=True))
        missed = min(np.max(np.abs(evaluate(e, columns) - target)) for e in sums)
        assert (missed < 1e-6) == powers
