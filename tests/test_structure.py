"""Claims about which terms measured states ask for."""

import numpy as np
import pytest
import sympy

from dynsr.benchmarks.noise import compare_formulas
from dynsr.data.system import PENDULUM
from dynsr.engines.simulation import add_noise, training_trajectory
from dynsr.expression.parsing import parse
from dynsr.fit.collocation import CollocationFit, Measurements
from dynsr.fit.description import structure_bits
from dynsr.methods.library import MonomialLibrary
from dynsr.selection.changes import (
    drop_least,
)
from dynsr.selection.comparison import COMPARISON, SystemComparison
from dynsr.selection.systems import SystemChoice, compare_systems, explore

WRONG = {
    "a term too many": "0.06*theta1*theta2^2 - 0.09*theta2 - 10*sin(theta1)",
    "no damping": "-9.7*sin(theta1)",
}


def noisy(system, level, seed=0):
    """Training data with noise, smoothed."""
    run = add_noise(training_trajectory(system), level, np.random.default_rng(seed))
    return Measurements.of([run], {}, COMPARISON.rows)


@pytest.fixture(scope="module")
def swings():
    """A damped pendulum at 5 % noise."""
    return noisy(PENDULUM, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("start", WRONG.values(), ids=WRONG)
def test_terms_come_right_on_the_states(swings, start):
    """From a wrong neighbour the damped pendulum is found at 5 % noise, its constants to 2 %."""
    exprs = {"theta1": parse("theta2"), "theta2": parse(start)}
    found = compare_systems(exprs, {}, swings)
    assert found.exprs["theta1"] == parse("theta2")
    same, off = compare_formulas(found.exprs["theta2"], PENDULUM.rhs[1])
    assert same and off < 0.02
    assert found.explains(COMPARISON)


@pytest.mark.slow
def test_what_leaves_more_than_noise_explains_nothing(swings):
    """Undamped, the best fit of a pendulum misses by more than the noise."""
    fit = SystemComparison(swings.mesh(("theta1", "theta2"))).fit(
        {"theta1": parse("theta2"), "theta2": parse("-9.7*sin(theta1)")}
    )
    assert not SystemChoice(fit.exprs, fit).explains(COMPARISON)


@pytest.mark.slow
def test_alternatives_are_tried(swings):
    """A cubic in the place of the sine gives way to a formula of the front, its constants off."""
    exprs = {"theta1": parse("theta2"), "theta2": parse("1.2*theta1^3 - 9.5*theta1 - 0.08*theta2")}
    alternatives = {"theta2": [parse("-0.05*theta2 - 9.4*sin(theta1)")]}
    found = compare_systems(exprs, alternatives, swings)
    same, off = compare_formulas(found.exprs["theta2"], PENDULUM.rhs[1])
    assert same and off < 0.02


@pytest.mark.slow
def test_sums_of_terms_are_found_along_the_states(swings):
    """With nothing given, gravity and damping alone are the best sum, beside smoothed angles."""
    same, off = compare_formulas(next(iter(explore("theta2", swings, COMPARISON))), PENDULUM.rhs[1])
    assert same and off < 0.1


@pytest.mark.slow
def test_what_cannot_be_compared_comes_back(swings):
    """Clean data change nothing, and no fit is claimed for them."""
    wrong = {"theta1": parse("theta2"), "theta2": parse("-9.7*sin(theta1)")}
    found = compare_systems(wrong, {}, noisy(PENDULUM, 1e-4))
    assert found.exprs == wrong and found.fit is None


@pytest.mark.slow
def test_an_equation_without_values_is_replaced(swings):
    """What cannot be fitted gives way to sums that hold terms of the other equations."""
    wild = {"theta1": parse("theta2"), "theta2": parse("exp(exp(9*theta1^2))")}
    same, off = compare_formulas(compare_systems(wild, {}, swings).exprs["theta2"], PENDULUM.rhs[1])
    assert same and off < 0.1


@pytest.mark.slow
def test_a_state_alone_is_compared_beside_the_measured_others(swings):
    """The pendulum's damping comes back where only its second equation is sought."""
    found = compare_systems({"theta2": parse("-9.7*sin(theta1)")}, {}, swings)
    same, off = compare_formulas(found.exprs["theta2"], PENDULUM.rhs[1])
    assert same and off < 0.1


def test_what_is_missed_least_is_dropped(swings):
    """Of gravity, damping and a cube that is not there, the cube goes."""
    comparison = SystemComparison(swings.mesh(("theta1", "theta2")))
    start = parse("0.01*theta2^3 - 0.1*theta2 - 9.7*sin(theta1)")
    fit = comparison.fit({"theta1": parse("theta2"), "theta2": start})
    assert compare_formulas(drop_least(fit, "theta2"), PENDULUM.rhs[1])[0]


def test_directions():
    """Every product of columns, sines and cosines of equal cost is a term, or none of that cost."""
    x, y = sympy.symbols("x y")
    terms = MonomialLibrary().for_names(["x", "y"]).functions
    assert {1, x, x * y, y * sympy.sin(x), x**3, x * y**2, sympy.sin(x) * sympy.cos(y)} <= {*terms}
    assert x**2 * sympy.sin(y) in terms and sympy.sin(x) ** 2 not in terms
    five = MonomialLibrary().for_names("abcde").functions
    assert len(five) == 1 + 5 + 25 + 85 == len({*five})
    assert len(MonomialLibrary(limit=400).for_names("abcde")) == 116 + 200


def test_a_second_term_of_one_form_costs_what_the_first_did():
    """Constants count as one kind of symbol, never as each other: two sines are two terms."""
    one, two = parse("2.5*sin(1.5*x)"), parse("2.5*sin(1.5*x) + 0.5*sin(3.5*x)")
    # Five symbols of four kinds, c * sin(c * x); twice that and a sum of five kinds.
    assert structure_bits(one) == pytest.approx(6 * np.log2(4))
    assert structure_bits(two) == pytest.approx(13 * np.log2(5))
    assert structure_bits(parse("2.5*x + 0.1*y")) == structure_bits(parse("7.5*x - 3.25*y"))


def test_what_the_data_say_nothing_of_has_no_error_bars():
    """A constant that moves no state is known to no digit; the others to one over the root."""
    x, none = sympy.Symbol("x"), np.empty((0, 1))
    fit = CollocationFit({"x": x}, np.ones(2), none, none, np.ones(1), np.diag([4.0, 0.0]))
    assert fit.errors.tolist() == [0.5, np.inf]
