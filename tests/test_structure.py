from dataclasses import replace

import numpy as np
import pytest
import sympy

from dynsr.benchmarks.noise import compare_formulas
from dynsr.data.system import LOTKA_VOLTERRA, PENDULUM
from dynsr.engines.simulation import add_noise, training_trajectory
from dynsr.expression.parsing import parse
from dynsr.selection.systems import (
    Judge,
    independent_rows,
    library,
    promising_changes,
    settle,
    swap_everywhere,
    term_bits,
    turn_terms,
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
    settled = settle(exprs, {}, [noisy(PENDULUM, 0.05)])
    assert settled["theta1"] == parse("theta2")
    same, off = compare_formulas(settled["theta2"], PENDULUM.rhs[1])
    assert same and off < 0.02


def test_the_true_form_stays_as_it_was_given():
    """Nothing beats the true terms of Lotka-Volterra at 5 % noise; its snapped numbers stay."""
    exprs = dict(zip(LOTKA_VOLTERRA.states, map(sympy.expand, LOTKA_VOLTERRA.rhs), strict=True))
    assert settle(exprs, {}, [noisy(LOTKA_VOLTERRA, 0.05)]) == exprs


def test_rivals_are_tried():
    """A cubic in the place of the sine gives way to a formula of the front, its constants off."""
    exprs = {"theta1": parse("theta2"), "theta2": parse("1.2*theta1^3 - 9.5*theta1 - 0.08*theta2")}
    rivals = {"theta2": [parse("-0.05*theta2 - 9.4*sin(theta1)")]}
    settled = settle(exprs, rivals, [noisy(PENDULUM, 0.05)])
    same, off = compare_formulas(settled["theta2"], PENDULUM.rhs[1])
    assert same and off < 0.02


def test_what_cannot_be_judged_comes_back():
    """Clean data, a state without an equation and a system that diverges change nothing."""
    run = noisy(PENDULUM, 0.05)
    wrong = {"theta1": parse("theta2"), "theta2": parse("-9.7*sin(theta1)")}
    assert settle(wrong, {}, [noisy(PENDULUM, 1e-4)]) == wrong
    alone = {"theta2": wrong["theta2"]}
    assert settle(alone, {}, [run]) == alone
    wild = {"theta1": parse("theta2"), "theta2": parse("exp(exp(9*theta1^2))")}
    assert settle(wild, {}, [run]) == wild


def test_the_linearised_fit_foresees_the_fit():
    """The change expected first is the missing damping, and its bits are those that a fit finds."""
    run = noisy(PENDULUM, 0.05)
    sigma = 0.05 * training_trajectory(PENDULUM).x.std(axis=0)
    judge = Judge([run], {}, sigma, 60)
    fit = judge.fit({"theta1": parse("theta2"), "theta2": parse("-9.7*sin(theta1)")})
    judge = judge.with_rows(independent_rows(fit.misses))
    fit = replace(fit, bits=judge.bits(fit))
    first = promising_changes(judge, fit)[0]
    assert first.state == "theta2" and compare_formulas(first.expr, PENDULUM.rhs[1])[0]
    found = judge.fit({**fit.exprs, "theta2": first.expr}, fit)
    assert found.bits - fit.bits == pytest.approx(first.bits, rel=0.1)


def test_white_misses_count_as_they_are():
    """White noise has as many independent rows as it has rows; runs of ten have a tenth."""
    white = np.random.default_rng(0).normal(size=(1000, 2, 3))
    assert independent_rows(white) == pytest.approx(3000, rel=0.05)
    assert independent_rows(np.repeat(white, 10, axis=0)) == pytest.approx(3000, rel=0.05)


def test_directions():
    """Products, sines and turned terms are among the directions; numbers cost no term bits."""
    x, y = sympy.symbols("x y")
    terms = library(["x", "y"])
    assert {x, x * y, y * sympy.sin(x), x**3} <= set(terms) and len(set(terms)) == len(terms)
    assert swap_everywhere(x * sympy.cos(x)) == [sympy.sin(x) * sympy.cos(x)]
    assert turn_terms(parse("2*y*sin(x)*cos(x)")) == [parse("2*y*sin(x)")]
    assert term_bits(parse("2.5*x + 0.1*y")) == term_bits(parse("7.5*x - 3.25*y"))
