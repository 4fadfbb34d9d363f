"""Functions that may stand for each other in noise are fitted in each other's place."""

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data import Trajectory
from dynsr.expression import evaluate, parse
from dynsr.fit import Measurements, skeleton, with_floats
from dynsr.selection import compare_systems
from dynsr.selection.stand_ins import stand_ins

FOUND = "2.0 - 1.9*tanh(x)"
TRUE = "1.7 - 2.4*x/(x + 0.5)"


@pytest.fixture(scope="module")
def data():
    """A state fed at a constant rate and cleared by a saturating enzyme, with 3 % of noise."""
    t = np.linspace(0, 12, 200)
    feed = lambda t, x: 1.7 - 2.4 * x / (x + 0.5)  # noqa: E731
    x = solve_ivp(feed, (0, 12), [6.0], t_eval=t, rtol=1e-9, atol=1e-9).y[0]
    noisy = x + 0.03 * np.std(x) * np.random.default_rng(1).standard_normal(len(x))
    return Measurements.of([Trajectory(t, noisy[:, None], ("x",))], {}, 2000)


@pytest.mark.slow
def test_the_truth_is_fitted_in_the_place_of_its_stand_in(data):
    """From another saturation alone, the true one is reached, or stands beside what is taken."""
    choice = compare_systems({"x": with_floats(parse(FOUND))}, {}, data)
    # a - b x/(x + K) is a - b + b K/(x + K): either way of writing it will do.
    wanted = {skeleton(with_floats(parse(e))) for e in (TRUE, "0.7 + 1.2/(x + 0.5)")}
    near = [bits for expr, bits in choice.others["x"] if skeleton(expr) in wanted]
    assert skeleton(choice.exprs["x"]) in wanted or min(near) < 8


def test_whole_powers_and_angles_keep_their_place():
    """Polynomials and sines of angles have no stand-ins."""
    columns = {"q": np.linspace(-3, 3, 9), "v": np.linspace(-1, 1, 9)}
    assert list(stand_ins(parse("-0.2*v - 4*sin(q) + q^3*v").evalf(), columns)) == []


def test_stand_ins_begin_near_what_they_stand_for():
    """Their coefficients are those that come closest to the equation where the data are."""
    x, y = sympy.symbols("x y")
    columns = {"x": np.linspace(0.5, 3, 40), "y": np.cos(np.linspace(0, 9, 40))}
    expr = -1.5 * y * sympy.tanh(x) + 0.7 * x
    values = evaluate(expr, columns)
    found = {skeleton(e): e for e in stand_ins(expr, columns)}
    near = found[skeleton(0.5 * x - 2.5 * x * y / (x + 1.5))]
    assert np.std(evaluate(near, columns) - values) < 0.05 * np.std(values)
    for other in found.values():
        assert np.std(evaluate(other, columns) - values) < np.std(values)
