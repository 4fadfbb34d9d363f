"""Small noise does not turn the errors of a loose solver into terms."""

from dataclasses import replace

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data import Trajectory
from dynsr.expression import parse
from dynsr.fit import Measurements, with_floats
from dynsr.selection.comparison import COMPARISON, SystemComparison


def compare(damping, tolerance, settings=COMPARISON):
    """Give what fits a pendulum with 0.1 % of noise in states from a solver at a tolerance."""
    t = np.linspace(0, 20, 800)
    swing = lambda t, x: [x[1], -4 * np.sin(x[0]) - damping * x[1]]  # noqa: E731
    x = solve_ivp(swing, (0, 20), [1.2, 0.0], t_eval=t, rtol=tolerance, atol=tolerance).y.T
    noise = 0.001 * np.std(x, axis=0) * np.random.default_rng(0).standard_normal(x.shape)
    data = Measurements.of([Trajectory(t, x + noise, ("q", "v"))], {}, 2000)
    comparison = SystemComparison(data.mesh(("q", "v")), settings)
    return lambda text: comparison.fit({"q": sympy.Symbol("v"), "v": with_floats(parse(text))}).bits


@pytest.mark.parametrize("extra", ["q^3", "q*v^2"])
@pytest.mark.slow
def test_errors_of_a_solver_are_no_terms(extra):
    """The true equation takes fewer bits than with a term for what the solver left behind.

    Held as strictly to its own solution as where noise is large, it takes more.
    """
    true, longer = "-4.1*sin(q) - 0.1*v", f"-4.1*sin(q) - 0.1*v + 0.01*{extra}"
    bits = compare(0.1, 1e-3)
    assert bits(true) < bits(longer)
    strict = compare(0.1, 1e-3, replace(COMPARISON, loose=1e-9))
    assert strict(true) > strict(longer)


@pytest.mark.slow
def test_small_true_terms_stay():
    """A damping by which the swings shrink by 3 % in all is not taken for an error."""
    bits = compare(0.003, 1e-10)
    assert bits("-4.1*sin(q) - 0.01*v") < bits("-4.1*sin(q)") - 20
