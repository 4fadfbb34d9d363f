"""Rates that leave one equation and enter another are looked for in both at once."""

import sympy
from measured_systems import floats, measured

from dynsr.fit import skeleton
from dynsr.methods import read_demands
from dynsr.selection.alone import Alone, Leader
from dynsr.selection.comparison import COMPARISON, ComparisonSettings, SystemComparison
from dynsr.selection.shared import share_rates

EATEN = {
    "n": "0.7 - 0.45*n - 0.62*p*n^2/(1.2 + n^2)",
    "p": "0.66*p*n^2/(1.2 + n^2) - 0.5*p",
}
# Each follows its own state as well as the law does.
ALIKE = {"n": "0.7 - 0.4*n - 0.3*n*p", "p": "0.8*p - 0.8*p/n"}


def shared(settings: ComparisonSettings = COMPARISON):
    """The law's own fit, and those of systems with a rate in common."""
    data = measured(tuple(EATEN.items()), (0.3, 1.9), 25.0, 150, 0.01)
    comparison = SystemComparison(data.mesh(tuple(EATEN)), settings)
    alone = {state: Alone.of(state, data, settings) for state in EATEN}
    leaders = {state: [Leader(expr, 0.0)] for state, expr in floats(ALIKE).items()}
    return comparison.fit(floats(EATEN)), share_rates(alone, comparison, leaders)


def test_what_is_eaten_is_found_in_both_equations():
    """The law itself comes out, though look-alikes lead both equations."""
    law, found = shared()
    assert found[0].bits <= law.bits + 0.1
    assert any(
        [skeleton(own.exprs[s]) for s in EATEN] == [skeleton(law.exprs[s]) for s in EATEN]
        for own in found
    )


def test_no_rate_is_shared_that_a_user_forbids():
    """Where fractions are forbidden, none is given."""
    demands = read_demands(tuple(EATEN), tuple(EATEN), functions=[])
    _, found = shared(ComparisonSettings(demands=demands))
    assert not any(sympy.fraction(e)[1].free_symbols for f in found for e in f.exprs.values())
