from dataclasses import replace

import numpy as np
import pytest
import sympy

from dynsr.benchmarks.noise import compare_formulas
from dynsr.data.system import LOTKA_VOLTERRA, PENDULUM
from dynsr.engines.simulation import add_noise, training_trajectory
from dynsr.expression.parsing import parse
from dynsr.fit.description import structure_bits
from dynsr.fit.noise import independent_rows
from dynsr.methods.library import MonomialLibrary
from dynsr.selection.systems import (
    SystemComparison,
    compare_systems,
    promising_changes,
    swap_everywhere,
    toggle_factors,
)

WRONG = {
    "a term too many": "0.06*theta1*theta2^2 - 0.09*theta2 - 10*sin(theta1)",
    "no damping": "-9.7*sin(theta1)",
}


def noisy(system, level, seed=0):
    """Training data with noise."""
    return add_noise(training_trajectory(system), level, np.random.default_rng(seed))


@pytest.mark.parametrize("start", WRONG.values(), ids=WRONG)
def test_terms_come_right_on_the_states(start):
    """From a wrong neighbour the damped pendulum is found at 5 % noise, its constants to 2 %."""
    exprs = {"theta1": parse("theta2"), "theta2": parse(start)}
    found = compare_systems(exprs, {}, [noisy(PENDULUM, 0.05)])
    assert found["theta1"] == parse("theta2")
    same, off = compare_formulas(found["theta2"], PENDULUM.rhs[1])
    assert same and off < 0.02


def test_the_true_form_stays_as_it_was_given():
    """Nothing beats the true terms of Lotka-Volterra at 5 % noise; its snapped numbers stay."""
    exprs = dict(zip(LOTKA_VOLTERRA.states, map(sympy.expand, LOTKA_VOLTERRA.rhs), strict=True))
    assert compare_systems(exprs, {}, [noisy(LOTKA_VOLTERRA, 0.05)]) == exprs


def test_alternatives_are_tried():
    """A cubic in the place of the sine gives way to a formula of the front, its constants off."""
    exprs = {"theta1": parse("theta2"), "theta2": parse("1.2*theta1^3 - 9.5*theta1 - 0.08*theta2")}
    alternatives = {"theta2": [parse("-0.05*theta2 - 9.4*sin(theta1)")]}
    found = compare_systems(exprs, alternatives, [noisy(PENDULUM, 0.05)])
    same, off = compare_formulas(found["theta2"], PENDULUM.rhs[1])
    assert same and off < 0.02


def test_what_cannot_be_compared_comes_back():
    """Clean data, a state without an equation and a system that diverges change nothing."""
    run = noisy(PENDULUM, 0.05)
    wrong = {"theta1": parse("theta2"), "theta2": parse("-9.7*sin(theta1)")}
    assert compare_systems(wrong, {}, [noisy(PENDULUM, 1e-4)]) == wrong
    alone = {"theta2": wrong["theta2"]}
    assert compare_systems(alone, {}, [run]) == alone
    wild = {"theta1": parse("theta2"), "theta2": parse("exp(exp(9*theta1^2))")}
    assert compare_systems(wild, {}, [run]) == wild


def test_the_linearised_fit_foresees_the_fit():
    """The change expected first is the missing damping, and its bits are those that a fit finds."""
    run = noisy(PENDULUM, 0.05)
    sigma = 0.05 * training_trajectory(PENDULUM).x.std(axis=0)
    comparison = SystemComparison([run], {}, sigma, 60)
    fit = comparison.fit({"theta1": parse("theta2"), "theta2": parse("-9.7*sin(theta1)")})
    comparison = comparison.with_rows(independent_rows(fit.misses))
    fit = replace(fit, bits=comparison.bits(fit))
    first = promising_changes(comparison, fit)[0]
    assert first.state == "theta2" and compare_formulas(first.expr, PENDULUM.rhs[1])[0]
    found = comparison.fit({**fit.exprs, "theta2": first.expr}, fit)
    assert found.bits - fit.bits == pytest.approx(first.bits, rel=0.1)


def test_white_misses_count_as_they_are():
    """White noise has as many independent rows as it has rows; runs of ten have a tenth."""
    white = np.random.default_rng(0).normal(size=(1000, 2, 3))
    assert independent_rows(white) == pytest.approx(3000, rel=0.05)
    assert independent_rows(np.repeat(white, 10, axis=0)) == pytest.approx(3000, rel=0.05)


def test_directions():
    """Every product of columns, sines and cosines of equal cost is a term, or none of that cost."""
    x, y = sympy.symbols("x y")
    terms = MonomialLibrary().for_names(["x", "y"]).functions
    assert {1, x, x * y, y * sympy.sin(x), x**3, x * y**2, sympy.sin(x) * sympy.cos(y)} <= {*terms}
    assert x**2 * sympy.sin(y) in terms and sympy.sin(x) ** 2 not in terms
    five = MonomialLibrary().for_names("abcde").functions
    assert len(five) == 1 + 5 + 25 + 85 == len({*five})
    assert len(MonomialLibrary(limit=400).for_names("abcde")) == 116 + 200


def test_one_edit_away():
    """A sine swaps with its argument everywhere, and a term gains or loses one factor."""
    x, y = sympy.symbols("x y")
    assert swap_everywhere(x * sympy.cos(x)) == [sympy.sin(x) * sympy.cos(x)]
    assert toggle_factors(parse("2*y*sin(x)*cos(x)"), [sympy.cos(x)]) == [parse("2*y*sin(x)")]
    assert toggle_factors(parse("(x + 2)/(y + 1)"), [y]) == [
        parse("(x + 2*y)/(y + 1)"),
        parse("(x*y + 2)/(y + 1)"),
    ]


def test_a_second_term_of_one_form_costs_what_the_first_did():
    """Constants count as one kind of symbol, never as each other: two sines are two terms."""
    one, two = parse("2.5*sin(1.5*x)"), parse("2.5*sin(1.5*x) + 0.5*sin(3.5*x)")
    # Five symbols of four kinds, c * sin(c * x); twice that and a sum of five kinds.
    assert structure_bits(one) == pytest.approx(6 * np.log2(4))
    assert structure_bits(two) == pytest.approx(13 * np.log2(5))
    assert structure_bits(parse("2.5*x + 0.1*y")) == structure_bits(parse("7.5*x - 3.25*y"))
