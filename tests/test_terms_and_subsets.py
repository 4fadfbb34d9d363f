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
from dynsr.engines import simulate
from dynsr.expression import compile_columns, counting, evaluate, parse
from dynsr.fit import Measurements, skeleton, structure_bits
from dynsr.library import find_turning
from dynsr.methods.demands import read_demands
from dynsr.selection import ComparisonSettings
from dynsr.selection.costs import (
    shape_bits,
    unusual_bits,
    written_length,
)
from dynsr.selection.subsets import best_subsets
from dynsr.selection.systems import explore
from dynsr.selection.terms import Terms, TermSettings

X, Y = sympy.symbols("x y")
RNG = np.random.default_rng(0)
POSITIVE = RNG.uniform(0.5, 4, (2, 200))
BOTH_SIGNS = RNG.uniform(-2, 2, (2, 200))


def grow(points, names=("x", "y"), angles=(), own=(), **changed):
    """Make terms in variables that take these values."""
    return Terms.grow(names, points, TermSettings(**changed), angles, own)


def terms_of_many_kinds():
    """Give terms whose constants matter by their signs, by their sizes, or not at all."""
    lines = (X + 1.5, Y - 0.7, X**2 + 1.5, 0.3 * X + Y)
    yield from (X / line for line in lines)
    yield from (X * Y / (X + 1.5), 1 / (Y + 2.25), X * Y, X**1.5, X**0.7, Y**-0.5)
    yield from (sympy.sin(X), sympy.sin(1.7 * Y), sympy.exp(-0.3 * X), sympy.log(X) * Y)


def bare(terms):
    """Give the terms with every constant inside replaced by its sign."""
    return {e.xreplace({f: sympy.sign(f) for f in e.atoms(sympy.Float)}) for e in terms.exprs}


def test_products_up_to_the_degree_are_terms():
    """All ten products of two variables up to the third degree are there, and none above."""
    found = grow(BOTH_SIGNS)
    powers = {X**i * Y**j for i in range(4) for j in range(4 - i)}
    assert powers <= set(found.exprs)
    assert not {X**4, X**5, X**2 * Y**2} & set(found.exprs)
    assert not {X**3, X**2 * Y} & set(grow(BOTH_SIGNS, degree=2).exprs)


def test_a_variable_that_is_the_only_one_has_powers_up_to_the_fifth():
    """Normal forms and radiation ask for them; two variables have no more than cubes."""
    assert {X, X**2, X**3, X**4, X**5} <= set(grow(BOTH_SIGNS[:1], names=("x",)).exprs)


def test_positive_variables_saturate():
    """Of positive variables there are roots, logarithms, inverses, x/(x + c), Hill's form."""
    found = bare(grow(POSITIVE))
    assert {sympy.sqrt(X), sympy.log(X), 1 / X, X * sympy.log(X), Y / (X + 1)} <= found
    assert {X**2 / (X**2 + 1), Y * X**2 / (X**2 + 1), sympy.exp(-X), X * Y / X**2} <= found
    assert not any(e.has(sympy.sin, sympy.cos) for e in found)


def test_variables_of_both_signs_have_no_poles():
    """Where a variable passes 0 nothing is divided by it and no root or logarithm is taken."""
    for expr in grow(BOTH_SIGNS).exprs:
        assert not expr.has(sympy.log)
        for power in expr.atoms(sympy.Pow):
            assert power.exp.is_Integer
            assert power.exp > 0 or power.base not in (X, Y)
    assert np.isfinite(grow(BOTH_SIGNS).values(BOTH_SIGNS)).all()


def test_only_angles_have_sines():
    """Sines and cosines are of the angles named, alone and times a variable."""
    found = grow(BOTH_SIGNS, angles=("x",)).exprs
    assert {sympy.sin(X), sympy.cos(X), Y * sympy.sin(X)} <= set(found)
    assert not {sympy.sin(Y), sympy.cos(Y)} & set(found)


def test_no_term_repeats_another():
    """No two terms are proportional on the points, and all are finite there."""
    values = grow(POSITIVE).values(POSITIVE)
    units = values / np.linalg.norm(values, axis=1)[:, None]
    cosines = np.abs(units @ units.T - np.eye(len(units)))
    assert cosines.max() < 1 - 5e-9


def test_a_copy_of_a_variable_is_left_out():
    """Of two columns of which one is twice the other only one makes terms."""
    found = grow(np.stack([POSITIVE[0], 2 * POSITIVE[0]])).exprs
    assert len({X, Y} & set(found)) == len({X**2, X * Y, Y**2} & set(found)) == 1


def test_terms_cost_their_length_and_their_functions():
    """A term costs the bits of its structure with one constant before it; functions cost more."""
    found = grow(POSITIVE, angles=())
    for expr, bits, inside in zip(found.exprs, found.bits, found.inside, strict=True):
        assert bits == pytest.approx(shape_bits(sympy.Float(0.5) * expr) + unusual_bits(expr, ()))
        assert inside == len(expr.atoms(sympy.Float))
    cost = dict(zip(found.exprs, found.bits, strict=True))
    assert cost[X] < cost[X**2] < cost[X**3]
    assert cost[X * Y] < cost[X * sympy.log(Y)]


def test_a_sine_of_what_is_no_angle_costs_more():
    """sin(x) costs 3 bits where x may be an angle and 4 more where not."""
    assert unusual_bits(sympy.sin(X), ("x",)) == 3
    assert unusual_bits(sympy.sin(X), ("y",)) == 7
    assert unusual_bits(X**2 / (1 + X), ()) == 0
    assert unusual_bits(sympy.tanh(X), ()) == 5


def test_the_cheapest_are_kept():
    """With room for so many only, none that is left out is cheaper than one that stays."""
    few, all_ = grow(POSITIVE, most=20), grow(POSITIVE)
    assert len(few.exprs) <= 20
    left_out = [b for e, b in zip(all_.exprs, all_.bits, strict=True) if e not in few.exprs]
    assert few.bits.max() <= min(left_out) + 1e-9


def test_terms_of_the_users_own_are_there():
    """A term that the library lacks is there when it is asked for, with its cost."""
    own = parse("exp(-x*y)")
    assert own not in grow(POSITIVE).exprs
    assert own in grow(POSITIVE, own=[own]).exprs


def test_values_are_those_of_the_terms():
    """Values are the terms' own at any points, constants too."""
    found = grow(POSITIVE)
    at = np.array([[2.0, 3.0], [0.5, 1.5]])
    values = found.values(at)
    for expr, row in zip(found.exprs, values, strict=True):
        expected = [float(expr.subs({X: a, Y: b})) for a, b in at.T]
        np.testing.assert_allclose(row, expected, rtol=1e-10)


def exhaustive(columns, y, costs, rows, most):
    """Give the subset of fewest bits by trying all of them."""

    def bits(places):
        a = columns[:, places]
        left = np.sum((y - a @ np.linalg.lstsq(a, y, rcond=None)[0]) ** 2)
        return rows / 2 * np.log2(left / rows) + costs[list(places)].sum()

    every = (c for n in range(1, most + 1) for c in combinations(range(columns.shape[1]), n))
    return min((bits(places), places) for places in every)


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


def test_exploration_keeps_to_the_vocabulary():
    """With no functions allowed a saturation is described by powers and ratios only."""
    rng = np.random.default_rng(4)
    t = np.linspace(0, 6, 80)
    x = 2 / (1 + 9 * np.exp(-1.2 * t))
    run = Trajectory(t, (x * (1 + 0.03 * rng.normal(size=80)))[:, None], ("x",))
    data = Measurements.of([run], {}, 2000)
    demands = read_demands(("x",), ("x",), functions=[])
    found = explore("x", data, ComparisonSettings(demands=demands))
    assert found and not any(e.atoms(sympy.Function) for e in found)
    assert set(sympy.expand(found[0]).as_coefficients_dict()) == {X, X**2}


def test_own_terms_take_part_in_the_exploration():
    """Sums hold the terms that the user asks for, where the data do."""
    t, own = np.linspace(0, 6, 80), parse("exp(-x^4)")
    x = solve_ivp(lambda _, x: 1.3 * np.exp(-(x**4)) - 0.2 * x, (0, 6), [-1.5], t_eval=t).y.T
    x = x + 0.01 * x.std() * np.random.default_rng(0).normal(size=x.shape)
    data = Measurements.of([Trajectory(t, x, ("x",))], {}, 2000)
    demands = read_demands(("x",), ("x",), terms=["exp(-x^4)"])
    found = explore("x", data, ComparisonSettings(demands=demands))
    assert any(own in expr.atoms(sympy.exp) for expr in found[:5])


@pytest.mark.slow
def test_the_hinged_cart_is_found_in_noise():
    """Of a cart-pole measured to 0.3 %, z' over 1 + sin(w)^2 is one of the first two."""
    t = np.linspace(0, 8, 121)
    clean = simulate(CART_POLE, CART_POLE.x0, t, reltol=1e-9, abstol=1e-9)
    off = 0.003 * clean.x.std(axis=0) * np.random.default_rng(0).standard_normal(clean.x.shape)
    force = compile_columns([CART_POLE.inputs["F"]], ["t"])(t)[0]
    run = Trajectory(t, clean.x + off, clean.states, inputs=force[:, None], input_names=("F",))
    first = explore("z", Measurements.of([run], {}, 2000), ComparisonSettings())[:2]
    truth = CART_POLE.rhs[CART_POLE.index("z")]
    columns = {n: RNG.uniform(-1, 1, 50) for n in ("w", "y", "F")}
    values = evaluate(truth, columns)
    assert any(np.allclose(evaluate(expr, columns), values, atol=0.1) for expr in first)


def test_a_saturation_costs_what_a_function_does():
    """Monod's and Hill's terms cost no more than a few bits beside a power of the same variable."""
    half = sympy.Float(0.5)
    for term in (X / (X + 1.5), X**2 / (X**2 + 1.5), 1 / (X**4 + 1.5)):
        assert shape_bits(half * X**2) < shape_bits(half * term) < shape_bits(half * X**2) + 8
        assert shape_bits(half * Y * term) < structure_bits(half * Y * term)


def test_a_pole_is_no_saturation():
    """1.5 - x below a line costs all its symbols, 1.5 + x those of one function."""
    half = sympy.Float(0.5)
    assert shape_bits(half * X / (1.5 - X)) == structure_bits(half * X / (1.5 - X))
    assert shape_bits(half * X / (1.5 + X)) < structure_bits(half * X / (1.5 + X))


def test_a_bracket_saves_no_bits_of_the_users_own():
    """A square that costs 100 bits costs them too where a common factor hides it."""
    growth = 1.5 * X - 0.5 * X**2
    plain = shape_bits(growth)
    with counting({"**": 100.0}):
        assert shape_bits(growth) == pytest.approx(plain + 100)


@given(st.permutations(list(terms_of_many_kinds())), st.integers(2, 4), st.randoms())
def test_bits_known_of_one_formula_are_those_of_another_of_its_kind(terms, count, random):
    """Whatever was counted before, sums cost what they do when nothing is known."""
    bodies = terms[:count]
    for _ in range(3):
        numbers = [random.choice([-2, -1, -0.5, 0.5, 1, 1.5]) for _ in bodies]
        expr = sympy.Add(*[sympy.Float(c) * body for c, body in zip(numbers, bodies, strict=True)])
        expr = expr.xreplace({c: c * random.choice([1, 1.25]) for c in expr.atoms(sympy.Float)})
        assert written_length(expr) == pytest.approx(written_length.__wrapped__(expr))
        assert unusual_bits(expr, ["x"]) == unusual_bits.__wrapped__(expr, ["x"])


def test_what_all_terms_share_is_written_once():
    """x (a - b x - c y) costs less than its terms do one by one, and a sum without a factor not."""
    growth = 1.5 * X - 0.5 * X**2 - 2.5 * X * Y
    assert shape_bits(growth) < structure_bits(growth)
    assert shape_bits(growth + 0.5) == structure_bits(growth + 0.5)


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


def test_phases_that_turn_on_pull_each_other_along():
    """Of two columns that turn on there are the sine and cosine of their difference, as in
    Kuramoto's model; of others there are none.
    """
    t = np.linspace(0, 9, 80)
    on, ahead, back = 0.3 + t, 1.2 + 0.9 * t + np.sin(t) / 3, 2 + np.sin(t)
    pull = {sympy.sin(X - Y), sympy.cos(X - Y)}
    assert pull <= set(grow(np.stack([on, ahead])).exprs)
    assert not any(e.atoms(sympy.sin) for e in grow(np.stack([on, back])).exprs)


@pytest.mark.slow
def test_what_saturates_in_the_fifth_power_is_found_in_noise():
    """The normal form of a subcritical pitchfork, from rows on its positive side alone."""
    law = {"a": "0.4*a + 0.9*a^3 - 0.3*a^5"}
    data = measured(tuple(law.items()), (0.1,), 8.0, 300, 0.01)
    found = explore("a", data, ComparisonSettings())
    assert skeleton(floats(law)["a"]) in map(skeleton, found[:3])
