"""Rates that several equations share, and equations found anew along the states of a system."""

from dataclasses import replace

import numpy as np
import pytest
import sympy
from measured_systems import floats, measured

from dynsr.expression import free_constants, parse, skeleton
from dynsr.library import textbooks
from dynsr.methods.demands import read_demands
from dynsr.selection import ComparisonSettings, compare_systems, explore
from dynsr.selection.changes import prune
from dynsr.selection.comparison import SystemComparison
from dynsr.selection.rates import fluxes, shared_bits
from dynsr.selection.renewal import renew, renewals
from dynsr.selection.shapes import rounded
from dynsr.selection.subsets import taken_whole, without

SETTINGS = ComparisonSettings()
# A ligand, its receptor and their complex, bound at 0.7 and let go at 0.4 per unit.
BINDING = {"a": "-0.7*a*b + 0.4*c", "b": "-0.7*a*b + 0.4*c", "c": "0.7*a*b - 0.4*c"}
# A repressor's loop: the message is made where its own protein is, and both decay.
LOOP = {"m": "1.3*p^2/(1.2 + p^2) - 0.6*m", "p": "0.9*m - 0.5*p"}


def bound(rows=120):
    """Measurements of the binding at 1 %."""
    return measured(tuple(BINDING.items()), (2.1, 1.2, 0.2), 6.0, rows, 0.01)


def looped():
    """Measurements of the loop at 1 %."""
    return measured(tuple(LOOP.items()), (1.1, 0.6), 14.0, 100, 0.01)


def of(equations, errors):
    """What constants save together and its cost, as they are there, with relative errors."""
    exprs = floats(equations)
    values = numbers_of(exprs)
    return shared_bits(exprs, values, np.diag((errors * values) ** 2))


def numbers_of(exprs):
    """The constants of a system in their order."""
    return np.array([n for e in exprs.values() for n in free_constants(e, "c")[1].values()])


def columns_of(exprs):
    """Values of the states, drawn at random."""
    rng = np.random.default_rng(1)
    return {str(s): rng.uniform(0.5, 2.0, 50) for s in exprs}


def fluxes_of(exprs):
    """The fluxes of a system whose constants have errors of 0.01."""
    numbers = numbers_of(exprs)
    return fluxes(exprs, numbers, np.full(len(numbers), 0.01), columns_of(exprs))


def test_one_rate_has_one_constant():
    """What leaves x as it enters y has no second constant, as in a share p of the textbooks.

    Against 1 - p for one of its own there is p 2 |c| phi(0) / s more, s the difference's error.
    """
    saved, cost = of({"x": "-0.5*x*y", "y": "0.5*x*y"}, 0.01)
    same = textbooks().share("same factor of a product")
    factor = 2 / (np.sqrt(2 * np.pi) * 0.01 * np.sqrt(2))
    assert saved == {(1,): pytest.approx(np.log2(1 + same / (1 - same) * factor))}
    assert cost == pytest.approx(-np.log2(1 - same))
    apart, also = of({"x": "-0.5*x*y", "y": "0.6*x*y"}, 0.01)
    assert apart == {(1,): pytest.approx(0, abs=1e-9)} and also == cost
    unknown, _ = of({"x": "-0.5*x*y", "y": "0.5*x*y"}, np.inf)
    assert unknown == {(1,): 0}
    assert of({"x": "-0.5*x*y", "y": "0.5*y"}, 0.01) == ({}, 0)


def test_one_of_several_earlier_rates_is_named():
    """A rate that is one of two earlier ones is half as probable: it takes a bit to say which."""
    one = of({"x": "-0.5*x*y", "y": "0.5*x*y"}, 0.01)[0][(1,)]
    two = of({"x": "-0.5*x*y", "y": "0.9*x*y", "z": "0.5*x*y"}, 0.01)[0][(2,)]
    assert 2**two - 1 == pytest.approx((2**one - 1) / 2)


def test_constants_inside_are_shared_with_their_signs():
    """Decay is not the inverse of growth, while what leaves one state enters another."""
    alike = of({"x": "exp(-0.5*x)", "y": "exp(-0.5*x) + 1"}, 0.01)[0]
    opposite = of({"x": "exp(-0.5*x)", "y": "exp(0.5*x) + 1"}, 0.01)[0]
    assert alike[(4,)] > 5 and opposite[(4,)] == 0


def test_terms_of_one_proportion_are_a_flux():
    """What is in two equations in one proportion is a flux, and the rest is that of each."""
    system = floats(
        {
            "a": "0.875*a*b - 2*a*c + 0.5*b*c",
            "b": "2*a*c - 1.875*a*b - 0.5*b*c - 0.3*b",
            "c": "1 - c^2",
        }
    )
    flux, other = fluxes_of(system)
    assert flux.parts["a"] == (1.0, system["a"] - parse("0.875*a*b"))
    assert flux.parts["b"] == (pytest.approx(-1), floats({"b": "2*a*c - 0.5*b*c"})["b"])
    assert flux.rest == {**floats({"a": "0.875*a*b", "b": "-1.875*a*b - 0.3*b"})}
    assert other.parts["b"] == (pytest.approx(-15 / 7), parse("-1.875*a*b"))
    moved = flux.replaced(system, parse("0.7*a*b^2"))
    assert moved["a"].equals(parse("0.7*a*b^2 + 0.875*a*b")) and moved["c"] == system["c"]
    assert moved["b"].equals(parse("-0.7*a*b^2 - 1.875*a*b - 0.3*b"))
    assert fluxes_of(floats({"x": "0.4*x", "y": "0.3 - 0.2*y"})) == []
    assert fluxes_of({"x": parse("v"), **floats({"v": "-4*x - 0.2*v"})}) == []


def test_a_proportion_is_that_of_values():
    """Where constants inside differ, so do the factors of what is one rate in the data."""
    system = floats({"s": "-1.5*s*x/(s + 0.5)", "x": "3.0*s*x/(s + 1.5) - 0.2*x", "y": "0.1 - y"})
    (flux,) = fluxes_of(system)
    columns = columns_of(system)
    s, x = columns["s"], columns["x"]
    mine, theirs = -1.5 * s * x / (s + 0.5), 3 * s * x / (s + 1.5)
    assert flux.parts["x"][0] == pytest.approx((mine @ theirs) / (mine @ mine))
    assert flux.rest["x"] == parse("-0.2*x")


def test_constants_inside_a_rate_are_shared_too():
    """Of Monod's rate in two equations both constants of the second are known from the first."""
    saved, _ = of({"s": "-1.5*s*x/(s + 0.5)", "x": "1.5*s*x/(s + 0.5) - 0.25*x"}, 0.01)
    assert len(saved) == 2 and min(saved.values()) > 4


@pytest.mark.slow
def test_a_conserved_sum_hides_no_rate():
    """Bound and free ligand tell each other; still every equation is the rate of mass action."""
    data = bound()
    pools = {s: list(explore(s, data, SETTINGS)) for s in BINDING}
    first = {s: pool[0] for s, pool in pools.items()}
    best = compare_systems(first, pools, data, SETTINGS).exprs
    for state, text in BINDING.items():
        assert {t.as_coeff_Mul()[1] for t in best[state].args} == {
            t.as_coeff_Mul()[1] for t in parse(text).args
        }


@pytest.mark.slow
def test_an_equation_is_found_anew_along_the_system():
    """From a straight line in the place of Hill's function a system no longer than the loop."""
    comparison = SystemComparison(looped().mesh(("m", "p")), SETTINGS)
    wrong = comparison.fit(floats({"m": "0.4*p - 0.3*m + 0.1", "p": LOOP["p"]}))
    best = renew(comparison, wrong)
    shapes = {skeleton(e) for e in [best.exprs["m"], *renewals(comparison, best, "m")]}
    assert skeleton(floats(LOOP)["m"]) in shapes
    assert best.bits <= comparison.fit(floats(LOOP)).bits < wrong.bits - 50


@pytest.mark.slow
def test_what_the_user_forbids_is_not_found_anew():
    """No sum for the message holds a term or a function that its equation may not hold."""
    demands = read_demands(("m", "p"), ("m", "p"), functions=[], constraints=["m: p = 0"])
    forbidding = replace(SETTINGS, demands=demands)
    comparison = SystemComparison(looped().mesh(("m", "p")), forbidding)
    fit = comparison.fit(floats({"m": "0.4 - 0.3*m", "p": LOOP["p"]}))
    found = renewals(comparison, fit, "m")
    assert found
    assert not any(e.has(sympy.Function) for e in found)
    assert all(e.as_coefficients_dict().get(sympy.Symbol("p")) is None for e in found)


@pytest.mark.slow
def test_a_forcing_is_cited_too():
    """What moves one equation with the time is offered to another along the system."""
    forced = {"x": "0.9*cos(t) - x", "v": "0.4*cos(t) - 0.5*v + x"}
    data = measured(tuple(forced.items()), (1.0, 0.0), 20.0, 150, 0.01)
    exprs = floats(forced)
    comparison = SystemComparison(data.mesh(("x", "v")), SETTINGS)
    fit = comparison.fit({**exprs, "v": parse("1.0*x - 0.5*v")})
    assert skeleton(exprs["v"]) in map(skeleton, renewals(comparison, fit, "v"))


def test_columns_set_free_are_those_of_least_squares():
    """What is left of the normal equations is that of the columns with the others projected out."""
    rng = np.random.default_rng(2)
    free, kept = rng.normal(size=(50, 2)), rng.normal(size=(50, 3))
    both = np.column_stack([free, kept])
    off = np.eye(50) - free @ np.linalg.pinv(free)
    found = without(both.T @ both, [0, 1], 2)
    np.testing.assert_allclose(found, kept.T @ off @ kept, rtol=1e-6, atol=1e-6)


def test_what_is_taken_whole_is_added_to_the_misses():
    """The products are those of the columns once one of them is added to the last."""
    columns = np.random.default_rng(2).normal(size=(50, 4))
    found = taken_whole(columns.T @ columns, 1)
    columns[:, -1] += columns[:, 1]
    np.testing.assert_allclose(found, columns.T @ columns)


def test_a_fit_that_ended_far_off_is_tried_from_elsewhere():
    """A half-saturation begun far off ends beside the best one; begun near, it is found."""
    comparison = SystemComparison(looped().mesh(("m", "p")), SETTINGS)
    comparison.fit(floats(LOOP))
    few = SystemComparison(comparison.mesh, replace(SETTINGS, fit=replace(SETTINGS.fit, steps=1)))
    few.fit(floats({"m": "0.3*p - 0.1*m", "p": LOOP["p"]}))
    far = few.fit(floats({**LOOP, "m": "1.3*p^2/(30.0 + p^2) - 0.6*m"}))
    near = few.fit(floats(LOOP))
    assert near.bits < far.bits - 50
    assert few.fit(floats({**LOOP, "m": "1.3*p^2/(60.0 + p^2) - 0.6*m"})).bits == near.bits


def test_a_line_is_cut_to_the_part_that_counts():
    """A ratio of two columns of which one is next to nothing is the other column."""
    comparison = SystemComparison(looped().mesh(("m", "p")), SETTINGS)
    fit = comparison.fit(floats({**LOOP, "p": "900.0*m*p/(0.003*m + 1000.0*p) - 0.5*p"}))
    assert skeleton(prune(comparison, fit, "p").exprs["p"]) == skeleton(floats(LOOP)["p"])


def test_a_factor_that_may_be_one_goes():
    """What two columns share out evenly is xy / (x + y), without a constant before the y."""
    equations = {"x": "0.8*x - 0.6*x*y/(x + y)", "y": "0.7*x*y/(x + y) - 0.5*y"}
    data = measured(tuple(equations.items()), (1.0, 2.0), 6.0, 90, 0.005)
    comparison = SystemComparison(data.mesh(("x", "y")), SETTINGS)
    begun = {**floats(equations), "x": parse("0.8*x - 0.6*x*y/(x + 1.1*y)")}
    assert prune(comparison, comparison.fit(begun), "x").exprs["x"].has(1 / parse("x + y"))


def test_a_constant_of_one_makes_no_other_law():
    """An exponent of 0.99 or a scale of 1.02 is none; one of 0.9 is."""
    assert rounded(parse("0.4*r^0.99")) == parse("0.4*r")
    assert rounded(parse("0.4*r^0.9")) == parse("0.4*r^0.9")


@pytest.mark.slow
def test_what_two_states_exchange_is_found_from_both():
    """Of a reaction there and back that is near its balance, one state shows next to nothing.

    Begun with another flux from a to b that looks as good, both equations lead to the true one.
    """
    truth = {
        "a": "0.88*b^2 - 0.79*a*c^2",
        "b": "0.79*a*c^2 - 0.88*b^2 - a^2*b",
        "c": "a^2*b + 0.12 - 0.42*c",
    }
    flux = "0.87*a^2*b - 3.5*a^4*c/(a^4 + 1.4) - 0.046*a"
    begun = {"a": flux, "b": f"-({flux}) - a^2*b", "c": truth["c"]}
    data = measured(tuple(truth.items()), (1.28, 2.57, 2.95), 16.0, 150, 0.01)
    comparison = SystemComparison(data.mesh(tuple(truth)), SETTINGS)
    fit = comparison.fit({s: sympy.expand(e) for s, e in floats(begun).items()})
    found = renew(comparison, fit)
    assert {s: skeleton(e) for s, e in found.exprs.items()} == {
        s: skeleton(e) for s, e in floats(truth).items()
    }
