"""Looking around: what is found for one cell of a ring is tried for the others before a search."""

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.methods import Limits
from dynsr.selection import Look, look_around
from dynsr.selection.first_look import LookSettings
from dynsr.selection.parts import Parts

NAMES = tuple(f"x{i}" for i in range(8))
ROWS = np.random.default_rng(5).uniform(-1.0, 1.0, (80, 8))


def cell(place, rate, pull):
    """The equation of an oscillator that both its neighbours in a ring pull."""
    before, own, after = sympy.symbols([NAMES[(place + j) % 8] for j in (-1, 0, 1)])
    return rate + pull * (sympy.sin(after - own) + sympy.sin(before - own))


def samples_of(place, rate, pull):
    """Exact slopes of it."""
    expr = sympy.lambdify(sympy.symbols(NAMES), cell(place, rate, pull))
    return Samples(ROWS, expr(*ROWS.T), NAMES, NAMES[place], "given", np.arange(80.0))


def test_the_law_of_one_cell_is_that_of_all_with_their_own_constants():
    """Over the end of the ring too, and where what is known has other constants."""
    known = {"x2": cell(2, sympy.Rational(26, 25), sympy.Rational(3, 5))}
    for place, rate in ((3, 0.5), (7, 1.25), (0, 0.8)):
        found = look_around(samples_of(place, rate, 0.4), Limits(), known)
        assert found.final
        assert sympy.simplify(found.candidates[0].expr.evalf() - cell(place, rate, 0.4)) == 0


def test_what_is_not_its_law_says_nothing():
    """A cell of another kind is searched as if nothing were known; so is one without this part."""
    known = {"x2": cell(2, 1.0, 0.6)}
    other = Samples(ROWS, ROWS[:, 0] * ROWS[:, 4], NAMES, "x4", "given", np.arange(80.0))
    assert look_around(other, Limits(), known) == Look()
    without = LookSettings(parts=Parts(("look-permuted",)))
    assert look_around(samples_of(3, 0.5, 0.4), Limits(), known, without) == Look()
