"""Terms of several columns, found on exact values, and equations found anew among them."""

from dataclasses import replace

import numpy as np
import pytest
import sympy
from looking import look_twice
from measured_systems import floats, measured

from dynsr.data import Samples
from dynsr.expression import evaluate, parse, skeleton
from dynsr.library import Library
from dynsr.methods.demands import read_demands
from dynsr.selection import ComparisonSettings
from dynsr.selection.comparison import SystemComparison
from dynsr.selection.renewal import renew, renewals

SETTINGS = ComparisonSettings()
RNG = np.random.default_rng(4)
# Two columns along which nothing is at rest, both positive, the second the larger one.
COLUMNS = {"x": RNG.uniform(0.4, 3.1, 200), "y": RNG.uniform(3.2, 5.0, 200)}
POINTS = np.array(list(COLUMNS.values()))
# What drifts with the flow in one of many cells side by side.
CELL = {"x": "-0.8*sin(x)*cos(y)", "y": "0.8*cos(x)*sin(y)"}
# Equations that it might begin from.
BEGUN = {"x": "1.0 - 0.8*y", "y": "0.8*x - 1.1"}


@pytest.mark.parametrize(
    "text",
    [
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
def test_a_sum_is_found_by_its_values(text):
    """Among thousands of terms the sum that has the values of a function comes up."""
    values = evaluate(parse(text), COLUMNS)
    samples = Samples(POINTS.T, values, ("x", "y"), "x", "given", np.arange(200.0))
    best = look_twice(samples).candidates[0].expr
    beside = {"x": np.linspace(0.5, 4.0, 20), "y": np.linspace(6.0, 4.5, 20)}
    np.testing.assert_allclose(evaluate(best, beside), evaluate(parse(text), beside), rtol=1e-4)


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
    best = renew(comparison, wrong)
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
        library = Library.of(["x", "y"], np.array([x, other]))
        pairs = zip(library.forms, library.starts, strict=True)
        return any(form.write(["x", "y"], own[0]).has(sympy.Abs) for form, own in pairs)

    assert has_distance(3.0 - x)
    assert not has_distance(5.0 + np.sin(x))
