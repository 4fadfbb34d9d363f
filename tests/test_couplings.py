"""Accelerations that one mass matrix ties together are found as they are said by each other."""

import numpy as np
import pytest
import sympy

import dynsr
from dynsr.benchmarks.noise import compare_formulas
from dynsr.data import System
from dynsr.engines import add_noise
from dynsr.expression import evaluate, parse, skeleton
from dynsr.fit import Measurements, with_floats
from dynsr.selection.comparison import SystemComparison
from dynsr.selection.couplings import try_couplings
from dynsr.selection.mass_matrix import find_couplings, read_ratio, slope_of

# A hanging pole of 0.7 m and 0.4 kg on a cart of 1.2 kg: 0.7 y' = -cos(w) z' - 9.81 sin(w) and
# 1.6 z' = F + 0.28 y^2 sin(w) - 0.28 cos(w) y', solved for y' and z' by hand.
POLE = {
    "y": "(-3.5714285714*F*cos(w) - y^2*sin(w)*cos(w) - 56.0571428571*sin(w))/(3 + sin(w)^2)",
    "z": "(2.5*F + 0.7*y^2*sin(w) + 9.81*sin(w)*cos(w))/(3 + sin(w)^2)",
}
# Where the angle is small, as near as noise is.
LIKE = "(-3.5714285714*F*cos(w) - y^2*sin(w) - 56.0571428571*sin(w))/(3 + sin(w)^2)"


def floats(equations):
    """Give {state: formula with free constants}."""
    return {state: with_floats(parse(text)) for state, text in equations.items()}


def constants_of(exprs):
    """Give the floats of formulas in the order in which they stand there."""
    return np.array([float(n) for e in exprs.values() for n in _numbers(e)])


def _numbers(expr):
    if expr.is_Float:
        return [expr]
    return [n for argument in expr.args for n in _numbers(argument)]


@pytest.fixture
def columns():
    """Values of the pole's and the cart's columns, far from small angles too."""
    rng = np.random.default_rng(0)
    return {name: rng.uniform(-2.5, 2.5, 50) for name in "wxyzF"}


@pytest.mark.parametrize("factor", [(0, 0), (1, 0), (0, 1)])
def test_division_loses_nothing(columns, factor):
    """What comes out even and the rest over the line are the ratio times the wave, everywhere."""
    for text in (*POLE.values(), "(2*x*cos(w)^3 + F*sin(w)^2)/(3 - 2*cos(w))"):
        expr = with_floats(parse(text))
        ratio, constants = read_ratio(expr), constants_of({"": expr})
        even, rest = (ratio.write(part) for part in ratio.divide(constants, factor))
        first, last = ratio.line(constants)
        line = first / last + ratio.main**ratio.degree
        waves = ratio.main ** factor[0] * ratio.other ** factor[1]
        found, wanted = evaluate(even + rest / line, columns), evaluate(expr * waves, columns)
        assert np.allclose(found, wanted, rtol=1e-12)


@pytest.mark.parametrize(
    "text", ["x/(1 + x^2)", "1/(1 + sin(w)*cos(x))", "1/(1 + sin(w) + cos(w))", "exp(x)*sin(w)"]
)
def test_other_lines_are_left_alone(text):
    """Lines that no wave of one angle stands in alone are not read."""
    assert read_ratio(with_floats(parse(text))) is None


def test_a_multiple_is_written_out(columns):
    """A multiple of a ratio with terms beside it is one ratio over its line, everywhere."""
    expr = with_floats(parse(POLE["z"]))
    beside = sympy.Float(-2.5) * parse("F*sin(w)") + sympy.Float(0.3) * parse("y^2")
    found = read_ratio(expr).put_in(expr, 1.7, (0, 1), beside)
    wanted = 1.7 * np.cos(columns["w"]) * evaluate(expr, columns) + evaluate(beside, columns)
    assert sympy.fraction(found)[1] == sympy.fraction(expr)[1]
    assert np.allclose(evaluate(found, columns), wanted, rtol=1e-12)


def test_accelerations_are_said_by_each_other(columns):
    """Either acceleration of a pole on a cart is what Newton's laws say by the other one."""
    exprs = floats(POLE)
    values = constants_of(exprs)
    ties = {c.state: c for c in find_couplings(exprs, values, np.diag((1e-4 * values) ** 2))}
    assert sorted(ties["y"].constants) == pytest.approx([-9.81 / 0.7, -1 / 0.7])
    assert sorted(ties["z"].constants) == pytest.approx([-0.175, 0.175, 0.625])
    for state, by in (("y", "z"), ("z", "y")):
        known = {**columns, str(slope_of(by)): evaluate(exprs[by], columns)}
        said = evaluate(ties[state].expr, known)
        assert np.allclose(said, evaluate(exprs[state], columns), rtol=1e-6)
        assert ties[state].loss < 1e-3


@pytest.mark.parametrize("extra", ["0.002*x", "0.001"])
def test_what_does_not_belong_is_not_tied(extra):
    """A look-alike has no coupling, nor has an equation with a small term too many."""
    top, line = POLE["y"].split("/")
    for text in (LIKE, f"({top} + {extra})/{line}"):
        exprs = floats({**POLE, "y": text})
        values = constants_of(exprs)
        assert not list(find_couplings(exprs, values, np.diag((0.02 * values) ** 2)))


@pytest.mark.slow
def test_the_loss_is_that_of_the_restrictions():
    """Of constants with errors, twice the loss in nats is chi-square of three, and errors are real.

    Three numbers above the line and the line itself are the other's, but for the multiple.
    """
    exprs, rng = floats(POLE), np.random.default_rng(1)
    values = constants_of(exprs)
    root = 0.01 * values[:, None] * (np.eye(8) + 0.3 * rng.standard_normal((8, 8)))
    losses, sizes, errors = [], [], []
    shapes = {s: skeleton(e) for s, e in exprs.items()}
    for _ in range(200):
        drawn = values + root @ rng.standard_normal(len(values))
        put = dict(zip(map(sympy.Float, values), map(sympy.Float, drawn), strict=False))
        moved = {s: e.xreplace(put) for s, e in exprs.items()}
        assert {s: skeleton(e) for s, e in moved.items()} == shapes
        tie = next(c for c in find_couplings(moved, drawn, root @ root.T) if c.state == "y")
        losses.append(2 * np.log(2) * tie.loss)
        sizes.append(tie.constants[0])
        errors.append(tie.errors[0])
    assert np.mean(losses) == pytest.approx(3.0, rel=0.15)
    assert np.std(sizes) == pytest.approx(np.median(errors), rel=0.15)


@pytest.fixture(scope="module")
def noisy():
    """A pole on a cart under a known force, with 1 % of noise."""
    equations, start = {"w": "y", "x": "z", **POLE}, (0.3, 0.0, 1.0, 0.0)
    system = System.from_strings(equations, x0=start, inputs={"F": "-0.2 + 0.5*sin(5*t)"})
    data = add_noise(dynsr.simulate(system), 0.01, np.random.default_rng(2))
    return Measurements.of([data], dict(system.inputs), 2000).mesh(system.states)


@pytest.mark.slow
def test_a_look_alike_gives_way_to_what_belongs(noisy):
    """From a fraction that follows the noisy states as well, the true one is found.

    The look-alike is shorter by itself and misses no more; it takes more bits all the same.
    """
    comparison = SystemComparison(noisy)
    still = {"w": sympy.Symbol("y"), "x": sympy.Symbol("z")}
    like = comparison.fit({**still, **floats({**POLE, "y": LIKE})})
    true = comparison.fit({**still, **floats(POLE)})
    assert abs(np.sum(like.fit.misses**2) - np.sum(true.fit.misses**2)) < 3
    assert true.bits < like.bits - 5
    found = try_couplings(comparison, like)
    assert all(compare_formulas(found.exprs[s], parse(POLE[s]))[0] for s in POLE)


@pytest.mark.slow
def test_two_that_are_said_by_each_other_are_found_at_once(noisy):
    """From sums without any line that follow the noisy states as well, both fractions are found."""
    comparison = SystemComparison(noisy)
    still = {"w": 0.999 * sympy.Symbol("y"), "x": sympy.Symbol("z")}
    bent = {"y": "-1.19*F + F*w^2 - w*y^2/3 - 18*tanh(w)", "z": "0.83*F - F*w^2/3 + 3*w"}
    begun = comparison.fit({**still, **floats(bent)})
    found = try_couplings(comparison, begun)
    assert found.bits < begun.bits - 20
    for state, text in POLE.items():
        assert compare_formulas(found.exprs[state], parse(text))[0]
