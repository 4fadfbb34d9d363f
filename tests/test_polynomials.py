"""All products fitted at once, where curves of the other columns are far off."""

import numpy as np
import pytest
from measured_systems import floats, measured

from dynsr.selection.alone import Alone
from dynsr.selection.comparison import COMPARISON, SystemComparison
from dynsr.selection.polynomials import thinned_polynomials, whole_polynomials
from dynsr.selection.shapes import bare_terms

RING = {
    "x": "-1.3*x - 3.7*y - 3.7*z - y^2",
    "y": "-1.3*y - 3.7*z - 3.7*x - z^2",
    "z": "-1.3*z - 3.7*x - 3.7*y - x^2",
}


def ring(rows, end, share=0.01):
    """Rows of the ring with noise."""
    return measured(tuple(RING.items()), (-4.1, -3.9, 0.5), end, rows, share)


def fitted(rows, end):
    """Systems of products for rows of the ring with 1 % noise."""
    data = ring(rows, end)
    alone = {s: Alone.of(s, data, COMPARISON) for s in RING}
    return list(whole_polynomials(SystemComparison(data.mesh(tuple(RING))), alone, floats(RING)))


@pytest.mark.parametrize("rows", [60, 80])
@pytest.mark.slow
def test_all_products_follow_a_ring_of_squares_in_few_rows(rows):
    """Ten rows an oscillation bend smoothed curves; what holds the law is nearer to the states."""
    best = min(fitted(rows, 8.0), key=lambda fit: fit.bits)
    clean, mesh = ring(rows, 8.0, 0.0).mesh(tuple(RING)), best.problem.mesh
    states, smoothed = (x[mesh.measured] for x in (best.fit.states, mesh.start))
    true = clean.x[clean.measured]
    assert np.std(states - true) < 0.8 * np.std(smoothed - true)


@pytest.mark.parametrize(("rows", "end"), [(400, 8.0), (12, 2.0)])
@pytest.mark.slow
def test_many_rows_and_few_numbers_are_left_alone(rows, end):
    """Where curves are good nothing is fitted, nor where numbers are no more than constants."""
    assert fitted(rows, end) == []


SPIRAL = {"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + x*z - 5.7*z"}
BOWL = {"x": "y", "y": "2*y - 2*x^2*y - x"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "start", "end", "rows", "share", "systems"),
    [(SPIRAL, (3.0, 5.0, 0.0), 30, 601, 0.1, 1), (BOWL, (0.0, 2.0), 10, 201, 0.1, 2)],
)
def test_polynomials_are_found_by_taking_terms_out(law, start, end, rows, share, systems):
    """Of all products at once, those of the law are left; a cubic law needs those of degree 3."""
    data = measured(tuple(law.items()), start, end, rows, share)
    alone = {s: Alone.of(s, data, COMPARISON) for s in law}
    comparison = SystemComparison(data.mesh(tuple(law)), COMPARISON)
    all_moving = floats(law | {s: "1.0" for s, e in law.items() if e == "y"})
    found = list(thinned_polynomials(comparison, alone, all_moving))
    assert len(found) == systems
    for state, expr in found[-1].exprs.items():
        assert bare_terms(expr) == bare_terms(floats(law)[state] * 1.0)
