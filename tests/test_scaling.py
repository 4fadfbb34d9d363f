import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.discovery.scaling import Units
from dynsr.discovery.search import discover
from dynsr.errors import InputError
from dynsr.expression import free_constants
from dynsr.expression.parsing import parse
from dynsr.fit import loosen
from dynsr.methods import RationalSearch

T = np.linspace(0.0, 10.0, 100)
QUICK = {
    "method": RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1),
    "jobs": 1,
}


def value_at(expr, **values):
    """Give the number that a formula is at some values."""
    return float(expr.subs(values))


@pytest.mark.parametrize("size", [1e-40, 1e-9, 1e9, 1e40])
def test_a_decay_is_found_at_any_size(size):
    """Half a unit a second: the rate does not depend on the unit of x."""
    found = discover((T, size * np.exp(-T / 2)[:, None]), **QUICK)
    assert found.equations == {"x": parse("-0.5*x")}
    assert found.simulate().x[-1, 0] == pytest.approx(size * np.exp(-5), rel=1e-6)


@pytest.mark.parametrize("second", [1e-40, 1e-9, 3.15e7, 1e40])
def test_a_decay_is_found_in_any_unit_of_time(second):
    """The rate is half of one over the unit, and its standard error stands beside it."""
    found = discover((T * second, np.exp(-T / 2)[:, None]), **QUICK)
    assert value_at(found.equations["x"], x=1.0) == pytest.approx(-0.5 / second, rel=1e-6)
    value, error = found.errors["x"][0]
    assert value == pytest.approx(-0.5 / second, rel=1e-6)
    assert 0 < error < 1e-3 / second


@pytest.mark.slow
def test_a_population_of_billions_keeps_its_law_and_its_constants():
    """x' = x - x^2/1e9: equation, errors, front and score are in the units of the data."""
    found = discover((T, 1e9 / (1 + 9 * np.exp(-T))[:, None]), **QUICK)
    expr = found.equations["x"]
    assert value_at(expr, x=5e8) == pytest.approx(2.5e8, rel=1e-6)
    assert sorted(v for v, _ in found.errors["x"]) == pytest.approx([-1e-9, 1.0], rel=1e-6)
    assert found.score()["x"]["slope_rmse"] < 1e-6 * 2.5e8
    assert found.front["x"].best_fit.loss < 1e-6 * 2.5e8
    assert "in units for x of 1e+08" in found.explanation["x"]
    assert found.settings["units"] == {"t": 1.0, "x": 1e8}


@pytest.mark.slow
def test_other_formulas_and_words_of_a_verdict_are_in_the_units_of_the_data():
    """An alternative gives slopes of the size of the data, and the span is in its unit of time."""
    t = np.linspace(0, 6, 60)
    x = 1 / (1 + 9 * np.exp(-t)) + 0.02 * np.random.default_rng(0).normal(size=60)
    found = discover((1e-9 * t, 1e9 * x[:, None]), preset="quick", jobs=1)
    other = parse(found.verdict.states["x"].alternatives[0].equation)
    sizes = [abs(float(e.subs("x", 5e8))) for e in (other, found.equations["x"])]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.3)
    assert found.verdict.span == pytest.approx(6e-9)
    reason = found.verdict.states["x"].reason
    assert reason.endswith("(in units for the time of 1e-09, x of 1e+08)")


@pytest.mark.slow
def test_intervals_of_tiny_and_huge_data_hold_the_truth():
    """x' = 2 - 0.5 x/1e-9 with 1 % noise, x of 1e-9: each interval is about its own constant."""
    x = 1e-9 * (4 - 3.5 * np.exp(-T / 2))
    noise = 1e-11 * np.random.default_rng(1).normal(size=len(T))
    found = discover((T, (x + noise)[:, None]), jobs=1)
    constants = found.constants["x"]
    assert len(constants) == 2
    for one, truth in zip(sorted(constants, key=lambda c: abs(c.value)), (2e-9, -0.5), strict=True):
        assert one.low <= truth <= one.high
        assert one.low <= one.value <= one.high
        assert one.high - one.low < 0.2 * abs(truth)
        assert one.fitted == pytest.approx(truth, rel=0.1)


def test_constants_of_one_value_keep_their_errors_in_other_units():
    """Two rates of the same value, and each has its own standard error."""
    x, y = sympy.symbols("x y")
    expr = sympy.Float(0.5) * x - sympy.Float(0.5) * y
    units = Units(sympy.Integer(1), {"x": sympy.Integer(10**9), "y": sympy.Integer(1000)})
    values = list(free_constants(loosen(expr), "c")[1].values())
    errors = {"x": tuple((v, 0.01 * (i + 1)) for i, v in enumerate(values))}
    empty = {"front": {}, "explanation": {}, "settings": {}}
    told = units.restore(Discovery({"x": expr}, errors=errors, **empty), (), {})
    sizes = {round(abs(v)): round(e / abs(v), 6) for v, e in told.errors["x"]}
    assert sizes in ({0: 0.02, 500000: 0.04}, {0: 0.04, 500000: 0.02})


def test_profiles_of_tiny_data_are_in_their_units():
    """An interval by the profile likelihood has the units of its constant, whichever way it is
    printed.
    """
    x = sympy.Symbol("x")
    expr = 0.4 * x / (x + 0.7) - 1.5 * x**2
    units = Units(sympy.Integer(1), {"x": sympy.Rational(1, 10**9)})
    plain = Discovery({"x": expr}, {"x": ()}, {}, {})
    values = list(free_constants(loosen(expr), "c")[1].values())
    errors = {"x": tuple((v, 0.1 * abs(v)) for v in values)}
    ends = tuple((c.value - 0.1 * abs(c.value), np.inf) for c in plain.constants["x"])
    told = Discovery({"x": expr}, errors, {}, {}, profiled={"x": ends})
    restored = units.restore(told, (), {}).constants["x"]
    assert len(restored) == 3
    for one in restored:
        assert one.profiled
        assert one.high is None
        assert one.low == pytest.approx(one.value - 0.1 * abs(one.value))


@pytest.mark.slow
def test_known_parts_inputs_and_slopes_are_counted_in_the_same_units():
    """x' = -2e-9 x + u with x of 1e9 and t of 1e8 s: the known part and the input are mapped."""
    t = T * 1e8
    x = 1e9 * (np.exp(-t * 2e-9) + 0.5 * np.sin(t * 2e-8))
    u = 1e9 * (0.5 * 2e-8 * np.cos(t * 2e-8) + 1e-9 * np.sin(t * 2e-8))
    run = Trajectory(t, x[:, None], ("x",), u[:, None], ("u",))
    slopes = {"x": -2e-9 * x + u}
    for given in ({"known": {"x": "-2e-9*x"}}, {"slopes": slopes}):
        found = discover(run, **given, **QUICK)
        assert value_at(found.equations["x"], x=1e9, u=0) == pytest.approx(-2.0, rel=1e-4)
        assert value_at(found.equations["x"], x=0, u=1) == pytest.approx(1.0, rel=1e-4)


def test_usual_sizes_are_left_alone():
    """From millionths to millions nothing is scaled, so nothing changes."""
    sizes = np.column_stack([2e-6 * np.exp(-T), 9e5 * np.exp(-T)])
    assert Units.of([Trajectory(T, sizes, ("a", "b"))]).usual


def test_there_and_back_is_the_same_formula():
    """A slope in scaled units and back is the formula that it was, for ratios too."""
    units = Units.of([Trajectory(T * 1e9, 1e-12 * np.exp(-T)[:, None], ("s",))])
    expr = parse("-3*s/(s + 2) + t*s^2")
    again = units.restore_slope("s", units.apply_slope("s", expr))
    assert sympy.simplify(again - expr) == 0


@pytest.mark.parametrize(
    ("t", "size", "name"),
    [(1.0, 2e200, "column 'x'"), (1e-300, 1.0, "the time"), (1e-40, 1e40, "the slope of 'x'")],
)
def test_sizes_beyond_float64_are_refused_in_one_line(t, size, name):
    """What cannot be multiplied without leaving float64 is named, with its size and a remedy."""
    with pytest.raises(InputError, match=f"{name} is of the size of .*give it in a unit") as caught:
        discover((t * T, size * np.exp(-T / 2)[:, None]), **QUICK)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_swing_of_huge_numbers_has_its_law_of_second_order():
    """Its velocity, which no column has, is in the units of the data too."""
    found = discover((T, 1e9 * np.cos(T)[:, None]), **QUICK)
    assert str(found).endswith("x'' = -x")
    run = found.trajectories[0]
    assert run.states == ("x", "x_dot")
    assert np.allclose(run.x, 1e9 * np.column_stack([np.cos(run.t), -np.sin(run.t)]), atol=1e7)
    assert found.simulate().x[-1, 0] == pytest.approx(1e9 * np.cos(run.t[-1]), rel=1e-6)


@pytest.mark.slow
def test_a_rotor_in_degrees_is_searched_in_radians():
    """Over ten turns, in noise: its sine is found, and constants are of the degrees of the data."""
    t = np.linspace(0, 6, 300)
    law = lambda _, s: [s[1], -20 * np.sin(s[0]) - 0.3 * s[1]]  # noqa: E731
    path = np.degrees(solve_ivp(law, (0, 6), [0.5, 14.0], t_eval=t, rtol=1e-9).y)
    noisy = path + np.array([[0.2], [2.0]]) * np.random.default_rng(0).normal(size=path.shape)
    data = {"t [s]": t, "phi [deg]": noisy[0], "w [deg/s]": noisy[1]}
    found = discover(data, preset="quick", jobs=1)
    assert found.verdict.level == "law"
    assert str(found.equations["phi"]) == "w"
    gap = found.equations["w"] - parse("-1145.916*sin(0.01745329*phi) - 0.3*w")
    for phi in (10.0, 200.0, 3000.0):
        assert abs(value_at(gap, phi=phi, w=700.0)) < 0.02 * 1145
