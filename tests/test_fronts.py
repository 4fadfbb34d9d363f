import numpy as np
import pytest
import sympy

from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.report.discovery import HEIGHT, place_front

X = sympy.Symbol("x")


def test_places_follow_bits_and_the_logarithm_of_the_loss():
    """Linear in bits across, from 0, and in the log of the loss down, as read from the ticks."""
    front = ParetoFront(
        [Candidate(X, 30.0, 3.0), Candidate(X**2, 0.2, 17.0), Candidate(X**3, 4e-5, 61.0)]
    )
    chart = place_front(front, "x**2")
    places, labels = zip(*chart.columns, strict=True)
    across = np.interp([dot.x for dot in chart.dots], places, [float(label) for label in labels])
    np.testing.assert_allclose(across, [3.0, 17.0, 61.0], atol=0.02)
    assert [label for _, label in chart.rows] == ["10²", "10⁰", "10⁻²", "10⁻⁴"]
    down = np.interp([dot.y for dot in chart.dots], [p for p, _ in chart.rows], [2, 0, -2, -4])
    np.testing.assert_allclose(down[:2], np.log10([30.0, 0.2]), atol=0.01)
    assert [dot.chosen for dot in chart.dots] == [False, True, False]


@pytest.mark.parametrize("bits", [0.0, 1.0, 3.7, 8.0, 99.0, 101.0, 498.0, 5000.0])
def test_ticks_are_few_and_hold_every_point(bits):
    """Between two and six ticks from 0, no point beyond the last, whatever the bits are."""
    chart = place_front(ParetoFront([Candidate(X, 1.0, bits)]), "")
    assert 2 <= len(chart.columns) <= 6
    assert chart.columns[0] == (0.0, "0") and chart.columns[-1][0] == 100.0
    assert 0 <= chart.dots[0].x <= 100 and 0 <= chart.dots[0].y <= HEIGHT


def test_a_loss_of_nothing_and_an_empty_front_have_a_place():
    """A loss of 0 stands at the bottom, and no formulas give an axis without points."""
    front = ParetoFront([Candidate(X, 1.0, 1.0), Candidate(2 * X, 0.0, 2.0)])
    assert place_front(front, "x").dots[1].y == HEIGHT
    empty = place_front(ParetoFront(), "x")
    assert empty.dots == () and len(empty.columns) > 1


def test_what_was_chosen_off_the_front_is_drawn_beside_it():
    """A chosen candidate that is worse than the front is a point, and no step of the line."""
    front = ParetoFront([Candidate(X, 1.0, 2.0), Candidate(parse("2*x"), 0.1, 4.0)])
    chosen = Candidate(parse("2.5*x"), 0.5, 5.0)
    chart = place_front(front, chosen)
    assert [dot.chosen for dot in chart.dots] == [False, False, True]
    assert len(chart.steps) == 2 and max(x2 for _, _, x2, _ in chart.steps) == 80.0
