"""The terms that sums are made of, and the best sums of them."""

from itertools import combinations

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from measured_systems import floats, measured
from scipy.integrate import solve_ivp

from dynsr.data import Trajectory
from dynsr.data.system import CART_POLE
from dynsr.discovery import discover
from dynsr.engines import simulate
from dynsr.expression import compile_columns, evaluate, parse, skeleton
from dynsr.fit import Measurements
from dynsr.library import find_turning
from dynsr.methods.demands import read_demands
from dynsr.selection import ComparisonSettings
from dynsr.selection.alone import Alone
from dynsr.selection.subsets import best_subsets
from dynsr.selection.systems import explore

X, Y = sympy.symbols("x y")
RNG = np.random.default_rng(0)
POSITIVE = RNG.uniform(0.5, 4, (2, 200))
BOTH_SIGNS = RNG.uniform(-2, 2, (2, 200))


def exhaustive(columns, y, costs, rows, most):
    """Give the subset of fewest bits by trying all of them."""

    def bits(places):
        a = columns[:, places]
        left = np.sum((y - a @ np.linalg.lstsq(a, y, rcond=None)[0]) ** 2)
        return rows / 2 * np.log2(left / rows) + costs[list(places)].sum()

    every = (c for n in range(1, most + 1) for c in combinations(range(columns.shape[1]), n))
    return min((bits(places), places) for places in every)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.sampled_from([0.03, 0.3, 3.0]))
def test_best_subsets_are_those_of_trying_all(seed, noise):
    """Up to four of nine columns: the subset of fewest bits, with its coefficients and squares."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(40, 9)) * 10.0 ** rng.uniform(-3, 3, 9)
    y = columns[:, [1, 4, 7]] @ (rng.normal(size=3) / columns[:, [1, 4, 7]].std(axis=0))
    y += noise * rng.normal(size=40)
    costs = rng.uniform(5, 20, 9)
    best = best_subsets(columns.T @ columns, columns.T @ y, y @ y, costs, 40.0, most=4)[0]
    bits, places = exhaustive(columns, y, costs, 40.0, 4)
    assert best.places == places
    assert best.bits == pytest.approx(bits, abs=1e-6)
    coefficients, squares = np.linalg.lstsq(columns[:, places], y, rcond=None)[:2]
    np.testing.assert_allclose(best.coefficients, coefficients, rtol=1e-6)
    assert best.squares == pytest.approx(squares[0], rel=1e-6)


def test_subsets_come_in_order_of_their_bits():
    """They are sorted, all different, no more than asked for, and never larger than allowed."""
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(60, 12))
    y = columns[:, 0] - columns[:, 3] + 0.2 * rng.normal(size=60)
    found = best_subsets(
        columns.T @ columns, columns.T @ y, y @ y, np.full(12, 8.0), 60.0, most=3, keep=15
    )
    assert len(found) == 15
    assert [s.bits for s in found] == sorted(s.bits for s in found)
    assert len({s.places for s in found}) == 15
    assert max(len(s.places) for s in found) <= 3


def test_a_column_that_others_make_up_is_never_added():
    """Of three columns with a + b = c no subset holds all, and coefficients stay of usual size."""
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(50, 3))
    columns[:, 2] = columns[:, 0] + columns[:, 1]
    y = columns[:, 0] + 2 * columns[:, 1] + 0.01 * rng.normal(size=50)
    found = best_subsets(columns.T @ columns, columns.T @ y, y @ y, np.full(3, 5.0), 50.0)
    assert all(len(s.places) < 3 for s in found)
    assert max(np.abs(s.coefficients).max() for s in found) < 10


@pytest.mark.parametrize("left", [-1e9, 0.0])
def test_a_slope_of_which_nothing_is_left_moves_no_constant(left):
    """What else is free may take all of a huge column but rounding, which falls below 0 as well;
    its term is found as one without it is.
    """
    columns = RNG.normal(size=(50, 2))
    y = columns @ [1.5, -0.7] + 0.01 * RNG.normal(size=50)
    information, pull = np.zeros((3, 3)), np.array([*(columns.T @ y), 1e-3])
    information[:2, :2] = columns.T @ columns
    information[2] = information[:, 2] = [1e-3, 1e-3, left]
    found = best_subsets(information, pull, y @ y, np.full(2, 5.0), 50.0, slopes=np.array([2, -1]))[
        0
    ]
    plain = best_subsets(information[:2, :2], pull[:2], y @ y, np.full(2, 5.0), 50.0)[0]
    assert found.places == plain.places == (0, 1)
    assert not found.shifts.any()
    np.testing.assert_allclose(found.coefficients, plain.coefficients, rtol=1e-9)


def test_a_term_of_infinite_cost_is_never_taken():
    """What the user's demands rule out is in no subset, however well it fits."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(50, 4))
    y = columns[:, 2] + 0.01 * rng.normal(size=50)
    costs = np.array([5.0, 5.0, np.inf, 5.0])
    found = best_subsets(columns.T @ columns, columns.T @ y, y @ y, costs, 50.0)
    assert found and all(2 not in s.places for s in found)


@pytest.mark.slow
def test_exploration_keeps_to_the_vocabulary():
    """With no functions allowed a saturation is described by powers and ratios only."""
    rng = np.random.default_rng(4)
    t = np.linspace(0, 6, 80)
    x = 2 / (1 + 9 * np.exp(-1.2 * t))
    run = Trajectory(t, (x * (1 + 0.03 * rng.normal(size=80)))[:, None], ("x",))
    data = Measurements.of([run], {}, 2000)
    demands = read_demands(("x",), ("x",), functions=[])
    found = list(explore("x", data, ComparisonSettings(demands=demands)))
    assert found and not any(e.atoms(sympy.Function) for e in found)
    assert set(sympy.expand(found[0]).as_coefficients_dict()) == {X, X**2}


@pytest.mark.slow
def test_own_terms_take_part_in_the_exploration():
    """Sums hold the terms that the user asks for, where the data do."""
    t, own = np.linspace(0, 6, 80), parse("exp(-x^4)")
    x = solve_ivp(lambda _, x: 1.3 * np.exp(-(x**4)) - 0.2 * x, (0, 6), [-1.5], t_eval=t).y.T
    x = x + 0.01 * x.std() * np.random.default_rng(0).normal(size=x.shape)
    data = Measurements.of([Trajectory(t, x, ("x",))], {}, 2000)
    demands = read_demands(("x",), ("x",), terms=["exp(-x^4)"])
    found = list(explore("x", data, ComparisonSettings(demands=demands)))
    assert any(own in expr.atoms(sympy.exp) for expr in found[:5])


@pytest.mark.slow
def test_the_hinged_cart_is_found_in_noise():
    """Of a cart-pole measured to 0.3 %, z' over 1 + sin(w)^2 is left open by the data of z alone.

    It is near enough to the best to be fitted with the equation of y; together they are the law.
    """
    t = np.linspace(0, 8, 121)
    clean = simulate(CART_POLE, CART_POLE.x0, t, reltol=1e-9, abstol=1e-9)
    off = 0.003 * clean.x.std(axis=0) * np.random.default_rng(0).standard_normal(clean.x.shape)
    force = compile_columns([CART_POLE.inputs["F"]], ["t"])(t)[0]
    run = Trajectory(t, clean.x + off, clean.states, inputs=force[:, None], input_names=("F",))
    data = Measurements.of([run], {}, 2000)
    found = list(explore("z", data, ComparisonSettings()))
    alone = Alone.of("z", data, ComparisonSettings())
    truth = CART_POLE.rhs[CART_POLE.index("z")]
    columns = {n: RNG.uniform(-1, 1, 50) for n in ("w", "y", "F")}
    values = evaluate(truth, columns)
    law = next(e for e in found if np.allclose(evaluate(e, columns), values, atol=0.1))
    best, bits = (alone.comparison.fit({"z": e}).bits for e in (found[0], law))
    assert bits < best + ComparisonSettings().near
    whole = discover(run, targets=["y", "z"], jobs=1)
    assert whole.verdict.level == "law"
    assert np.allclose(evaluate(whole.equations["z"], columns), values, atol=0.01)


def test_a_constant_inside_is_found_between_those_that_are_tried():
    """A saturation at 2.2 is reached from one at 1.5 by its slope, not by a sum of others."""
    x, noise = np.linspace(0.3, 6, 60), 1e-3 * np.random.default_rng(3).standard_normal(60)
    columns = np.stack([x / (x + 1.5), x, x**2, x**3, -1.5 * x / (x + 1.5) ** 2])
    target = 3 * x / (x + 2.2) + noise
    best = best_subsets(
        columns @ columns.T / 1e-6,
        columns @ target / 1e-6,
        target @ target / 1e-6,
        np.array([20.0, 10.0, 10.0, 10.0]),
        60.0,
        slopes=np.array([4, -1, -1, -1]),
    )
    alone = next(s for s in best if s.places == (0,))
    assert 1.5 * np.exp(alone.shifts[0]) == pytest.approx(2.2, rel=0.1)
    assert alone.coefficients[0] == pytest.approx(3, rel=0.1)


def test_a_pair_that_tells_nothing_alone_is_found():
    """Two of forty columns whose difference is the target are found, though others lead alone."""
    rng = np.random.default_rng(5)
    common = 100 * rng.standard_normal(80)
    pair = np.stack([common + rng.standard_normal(80), common])
    target = pair[0] - pair[1]
    others = 0.1 * target + rng.standard_normal((60, 80))
    columns = np.concatenate([others, pair])
    best = best_subsets(
        columns @ columns.T, columns @ target, target @ target, np.full(62, 5.0), 80.0
    )
    assert best[0].places == (60, 61)


def test_a_phase_that_turns_on_may_have_sines():
    """A column that goes one way by more than half a turn may be an angle."""
    t = np.linspace(0, 1, 50)
    assert find_turning(["short", "long", "back"], [1 + t, 1 + 9 * t, 5 + 4 * np.cos(9 * t)]) == (
        "long",
    )


@pytest.mark.slow
def test_what_saturates_in_the_fifth_power_is_found_in_noise():
    """The normal form of a subcritical pitchfork, from rows on its positive side alone."""
    law = {"a": "0.4*a + 0.9*a^3 - 0.3*a^5"}
    data = measured(tuple(law.items()), (0.1,), 8.0, 300, 0.01)
    found = list(explore("a", data, ComparisonSettings()))
    assert skeleton(floats(law)["a"]) in map(skeleton, found[:3])
