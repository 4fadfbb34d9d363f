"""All products fitted at once, and thinned, where curves of the other columns are far off."""

import pytest
import sympy
from measured_systems import floats, measured

from dynsr.fit import skeleton
from dynsr.selection.alone import Alone
from dynsr.selection.comparison import COMPARISON, SystemComparison
from dynsr.selection.polynomials import fit_polynomials

RING = {
    "x": "-1.3*x - 3.7*y - 3.7*z - y^2",
    "y": "-1.3*y - 3.7*z - 3.7*x - z^2",
    "z": "-1.3*z - 3.7*x - 3.7*y - x^2",
}
BENT = {"q": "v", "v": "0.9*q - 1.4*q^3 - 0.2*v"}


def fitted(equations, start, end, rows):
    """Systems of products for rows with 1 % noise, and the law's own fit."""
    data = measured(tuple(equations.items()), start, end, rows, 0.01)
    mesh, begun = data.mesh(tuple(equations)), floats(equations)
    alone = {s: Alone.of(s, data, COMPARISON) for s in equations}
    found = fit_polynomials(SystemComparison(mesh), alone, begun)
    return found, SystemComparison(mesh).fit(begun), data


def shapes(fit):
    """Give the equations without their constants."""
    return {state: skeleton(expr) for state, expr in fit.exprs.items()}


@pytest.mark.parametrize("rows", [60, 80])
def test_a_ring_of_squares_is_found_in_few_rows(rows):
    """Ten rows an oscillation show a chaotic flow: all its terms, no others, in no more bits."""
    found, law, data = fitted(RING, (-4.1, -3.9, 0.5), 8.0, rows)
    assert data.period < 11
    best = min(found, key=lambda fit: fit.bits)
    assert shapes(best) == shapes(law)
    assert best.bits == pytest.approx(law.bits, abs=0.1)


def test_a_speed_stays_a_speed():
    """q' = v is kept as it is, and the force on it is found with its cube."""
    found, law, _ = fitted(BENT, (1.3, 0.0), 20.0, 80)
    best = min(found, key=lambda fit: fit.bits)
    assert best.exprs["q"] == sympy.Symbol("v")
    assert shapes(best) == shapes(law)


def test_many_rows_and_few_numbers_are_left_alone():
    """Where curves are good nothing is fitted, nor where numbers are no more than constants."""
    for rows, end in ((400, 8.0), (12, 2.0)):
        data = measured(tuple(RING.items()), (-4.1, -3.9, 0.5), end, rows, 0.01)
        comparison = SystemComparison(data.mesh(tuple(RING)), COMPARISON)
        alone = {s: Alone.of(s, data, COMPARISON) for s in RING}
        assert fit_polynomials(comparison, alone, floats(RING)) == []
