"""Constants that are one, fitted in several places of noisy data."""

import numpy as np
import pytest
import sympy
from measured_systems import floats, measured

from dynsr.expression import free_constants
from dynsr.fit import polish
from dynsr.fit.settings import FIT
from dynsr.fit.ties import find_ties

# Equations and a start.
SYSTEMS = {
    "a ring of three": (
        {
            "x": "-1.31*x - 0.83*y^2 + 0.57",
            "y": "-1.31*y - 0.83*z^2 + 0.57",
            "z": "-1.31*z - 0.83*x^2 + 0.57",
        },
        (0.9, 0.1, 0.4),
    ),
    "what leaves one column enters another": (
        {"a": "-0.83*a*b + 0.372*c", "b": "-0.83*a*b + 0.372*c - 0.21*b", "c": "0.83*a*b - 1.17*c"},
        (1.4, 0.9, 0.2),
    ),
    "a difference": ({"x": "3.17*(y - x)", "y": "-0.772*x"}, (1.0, -0.6)),
}


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.slow
def test_what_is_one_is_printed_as_one(name):
    """At 1 %, a constant is the same number in every place where the law has it, and within 1 %."""
    texts, start = SYSTEMS[name]
    data = measured(tuple(texts.items()), start, 6.0, 200, 0.01, 1)
    found = polish(floats(texts), [], {}, {}, {}, FIT, data).exprs
    printed = [abs(float(v)) for e in found.values() for v in sympy.expand(e).atoms(sympy.Number)]
    for expr in floats(texts).values():
        for true in map(abs, free_constants(sympy.expand(expr), "c")[1].values()):
            (one,) = {value for value in printed if value == pytest.approx(true, rel=0.05)}
            assert one == pytest.approx(true, rel=0.01)


@pytest.mark.slow
def test_what_the_data_tell_apart_stays_apart():
    """The same ring whose third rate is 4 % off: that one has a number of its own."""
    texts, start = SYSTEMS["a ring of three"]
    texts = {**texts, "z": "-1.363*z - 0.83*x^2 + 0.57"}
    data = measured(tuple(texts.items()), start, 6.0, 200, 0.001)
    found = polish(floats(texts), [], {}, {}, {}, FIT, data).exprs
    own = {s: float(e.coeff(sympy.Symbol(s))) for s, e in found.items()}
    assert own["x"] == own["y"] == pytest.approx(-1.31, rel=0.005)
    assert own["z"] == pytest.approx(-1.363, rel=0.005)


def test_tied_constants_are_their_weighted_mean():
    """Of independent errors the mean is weighted by their inverse squares, and so is its error."""
    x, y, c, d = sympy.symbols("x y c d")
    shapes = {"x": c * x * y, "y": -d * x * y}
    found = find_ties(shapes, [c, d], np.array([0.73, 0.733]), np.diag([4e-6, 1e-6]), FIT)
    assert found.values == pytest.approx([(0.73 + 4 * 0.733) / 5] * 2)
    assert found.covariance == pytest.approx(np.full((2, 2), 8e-7))
    assert found.distance == pytest.approx(0.003**2 / 5e-6)


def test_ties_are_no_accident_of_wide_errors():
    """Two constants that agree only because neither is known well are left alone."""
    x, y, c, d = sympy.symbols("x y c d")
    shapes = {"x": c * x * y, "y": d * x * y}
    found = find_ties(shapes, [c, d], np.array([0.7, 0.9]), np.diag([0.3, 0.3]), FIT)
    assert found.count == 0
