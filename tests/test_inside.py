"""Constants inside terms: with what they are compared, and what an unusual one costs."""

import math

import pytest
import sympy

from dynsr.library.inside import constants_inside, unusual_bits

x, y, t = sympy.symbols("x y t")


@pytest.mark.parametrize(
    ("expr", "expected"),
    [
        (2.5 * x * y, []),
        (1.5 + 0.3 * x, []),
        (2.5 * y * x**2 / (x**2 + 9.0), [(9.0, x**2)]),
        (0.4 * sympy.exp(-5.0 * x), [(0.2, x)]),
        (sympy.tanh(4.0 * (x - 0.5)), [(0.25, x), (2.0, 4.0 * x)]),
        (0.3 * sympy.sin(20.0 * t) * x, []),
    ],
)
def test_constants_go_with_what_they_are_added_to_or_multiplied_by(expr, expected):
    """Coefficients of terms, and what goes with the time alone, are no constants inside."""
    assert list(constants_inside(expr)) == expected


def test_an_unusual_constant_costs_bits_of_a_normal_distribution_of_decades():
    """A half-saturation as large as its column costs none, one of ten and a hundred times does."""
    costs = [unusual_bits([x / (x + k)], lambda _: 2.0) for k in (2.0, 20.0, 200.0, 0.2)]
    unit = 1 / (2 * math.log(2))
    assert costs == pytest.approx([0.0, unit, 4 * unit, unit])


def test_what_has_no_size_costs_nothing():
    """A column that rests at 0 has no size to compare with."""
    assert unusual_bits([x / (x + 5.0)], lambda _: 0.0) == 0.0
