"""One state alone, the others read off their curves: which sums lead."""

import numpy as np
import pytest
import sympy
from measured_systems import measured

from dynsr.expression import parse, skeleton
from dynsr.fit import Linearised, with_floats
from dynsr.selection import explore
from dynsr.selection.alone import Alone
from dynsr.selection.comparison import COMPARISON
from dynsr.selection.subsets import without


@pytest.mark.parametrize("few", [1, 4])
def test_squares_that_are_left_are_those_of_least_squares(few):
    """What some terms leave is what the fitted minimum of the quadratic form is."""
    rng = np.random.default_rng(few)
    design, y = rng.normal(size=(50, 5)), rng.normal(size=50)
    normal = Linearised(design.T @ design, design.T @ y, float(y @ y))
    places = list(range(few))
    left = np.linalg.lstsq(design[:, places], y, rcond=None)[1][0]
    assert without(normal.gram, places, 5)[0, 0] == pytest.approx(left, rel=1e-9)


@pytest.mark.slow
def test_forces_of_long_sums_are_found():
    """The six forces on a joint with a partner are the best of all sums that are fitted."""
    texts = {
        "x": "v",
        "v": "-2.2*sin(x) + 0.8*cos(x) + 0.6*v - 0.6*x^2*v + 0.7*y - 0.7*x",
        "y": "w",
        "w": "-1.6*sin(y) - 0.2*w*abs(w) + 0.7*x - 0.7*y",
    }
    data = measured(tuple(texts.items()), (0.8, 0.3, -0.5, 0.9), 22.0, 150, 0.01)
    alone = Alone.of("v", data, COMPARISON)
    found = list(alone.rank(alone.propose()))
    law = alone.comparison.fit({**alone.beside, "v": with_floats(parse(texts["v"]))})
    assert skeleton(found[0]) == skeleton(law.exprs["v"])


@pytest.mark.slow
def test_a_sum_of_whole_powers_goes_before_any_exponent():
    """A fan's friction and drag are found, no power between them; a lone state may have one."""
    texts = {"i": "-1.4*i - 0.6*w + 5", "w": "1.2*i - 0.1*w - 0.07*w^2"}
    data = measured(tuple(texts.items()), (0.1, 0.1), 8.0, 300, 0.01)
    alone = Alone.of("w", data, COMPARISON)
    found = list(alone.rank(alone.propose()))
    law = alone.comparison.fit({"w": with_floats(parse(texts["w"]))})
    assert skeleton(found[0]) == skeleton(law.exprs["w"])
    grown = (("n", "1.3*n - 0.4*n^1.7"),)
    alone = Alone.of("n", measured(grown, (0.1,), 6.0, 300, 0.01), COMPARISON)
    best = list(alone.rank(alone.propose()))[:5]
    powers = [float(p.exp) for e in best for p in e.atoms(sympy.Pow) if p.exp.is_Float]
    assert powers and min(abs(power - 1.7) for power in powers) < 0.15


@pytest.mark.slow
def test_a_gene_that_is_repressed_has_a_limit():
    """Where repression is strong throughout, no number over a power of the other column leads."""
    texts = {"a": "1.1/(1 + b^4) - 0.64*a", "b": "0.8*a - 0.5*b + 0.9"}
    data = measured(tuple(texts.items()), (3.0, 1.5), 14.0, 100, 0.01, 3)
    best, *_ = explore("a", data, COMPARISON)
    assert not any(p.base.is_Symbol and p.exp < 0 for p in best.atoms(sympy.Pow))
