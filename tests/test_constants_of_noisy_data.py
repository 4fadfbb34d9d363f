"""Claims about constants fitted to noisy states: their intervals, and when they become simple."""

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.discovery.search import discover
from dynsr.expression import free_constants
from dynsr.expression.parsing import parse
from dynsr.fit.polishing import polish
from dynsr.fit.settings import FitSettings
from dynsr.fit.simple import simple_value
from dynsr.fit.variation import loosen
from dynsr.fit.whole import fit_states, interval_reach
from dynsr.methods.rational import RationalSearch

PREY = {"prey": {"prey": 1.37, "pred*prey": -0.83}, "pred": {"pred": -2.63, "pred*prey": 0.91}}


@pytest.fixture(scope="module")
def hunters():
    """Predators and prey of constants that are no small fractions, solved by scipy."""
    t = np.linspace(0, 10, 500)
    found = solve_ivp(
        lambda t, u: [u[0] * (1.37 - 0.83 * u[1]), u[1] * (0.91 * u[0] - 2.63)],
        (0, 10),
        [1.0, 1.0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
    )
    return Trajectory(t, found.y.T, ("prey", "pred"))


def disturb(run, share, seed, growing=False):
    """Add noise, a share of each state's spread, or of each value where it is ``growing``."""
    size = np.abs(run.x) if growing else run.x.std(axis=0)
    noise = np.random.default_rng(seed).normal(size=run.x.shape)
    return Trajectory(run.t, run.x + share * size * noise, run.states)


def coefficients(expr):
    """Give {term: coefficient} of a sum."""
    pairs = (term.as_coeff_Mul() for term in sympy.Add.make_args(sympy.expand(expr)))
    return {str(rest): float(value) for value, rest in pairs}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_wrong_simple_numbers_give_way_to_what_the_data_say(hunters, seed):
    """From -5/6 and 0.9, every constant comes within two standard errors of its fitted value.

    The fitted value itself lies within four standard errors of the truth, which few rows of a
    millionth would miss.
    """
    wrong = {"prey": "-5*pred*prey/6 + 11*prey/8", "pred": "9*pred*prey/10 - 13*pred/5"}
    start = {s: sympy.nsimplify(parse(e), rational=True) for s, e in wrong.items()}
    found = polish(start, [disturb(hunters, 0.01, seed)], {}, {}, {})
    for state, true in PREY.items():
        assert set(coefficients(found.exprs[state])) == set(true)
        for (value, error), fitted in zip(found.errors[state], found.fitted[state], strict=True):
            assert abs(value - fitted) <= 2 * error
            exact = min(true.values(), key=lambda v: abs(v - value))
            assert abs(fitted - exact) < 4 * error < 0.01


@pytest.mark.slow
def test_every_constant_stands_beside_its_fitted_value_and_error(hunters):
    """Values, errors and fitted values run in the order of the formula with all factors free."""
    rough = {"prey": parse("1.3*prey - 0.8*pred*prey"), "pred": parse("0.9*pred*prey - 2.6*pred")}
    found = polish(rough, [disturb(hunters, 0.01, 0)], {}, {}, {})
    for state, expr in found.exprs.items():
        _, values = free_constants(loosen(expr), "c")
        assert [v for v, _ in found.errors[state]] == list(values.values())
        assert found.fitted[state] == pytest.approx(list(values.values()), rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("growing", [False, True])
def test_intervals_hold_the_truth(growing):
    """Of 120 intervals of 95 % between 88 and 99 % hold the truth, also where noise grows."""
    t = np.linspace(0, 12, 100)
    exact = Trajectory(t, (0.73 / (0.31 + (7.3 - 0.31) * np.exp(-0.73 * t)))[:, None], ("x",))
    truth = np.array([0.73, -0.31])
    held = []
    for seed in range(60):
        run = disturb(exact, 0.05, seed, growing)
        fit = fit_states({"x": parse("0.7*x - 0.3*x^2")}, [run], {})
        order = np.array([truth[0] if value > 0 else truth[1] for value in fit.constants])
        held.append(np.abs(fit.constants - order) <= interval_reach(fit.freedom) * fit.errors)
    assert 0.88 <= np.mean(held) <= 0.99


@pytest.mark.slow
def test_rows_whose_noise_is_large_count_less(monkeypatch):
    """Where noise grows with the state, weights make the constants surer than equal rows do."""
    t = np.linspace(0, 6, 80)
    exact = Trajectory(t, np.exp(-t)[:, None], ("x",))
    runs = [disturb(exact, 0.1, seed, growing=True) for seed in range(10)]
    weighed = [fit_states({"x": parse("-0.9*x")}, [run], {}).constants[0] for run in runs]
    monkeypatch.setattr("dynsr.fit.whole._Descent.weighed", lambda own: own)
    plain = [fit_states({"x": parse("-0.9*x")}, [run], {}).constants[0] for run in runs]
    assert np.std(weighed) < 0.7 * np.std(plain)
    assert abs(np.mean(weighed) + 1) < 0.01


@pytest.mark.parametrize(
    ("value", "error", "number"),
    [
        (1.502, 0.003, "3/2"),
        (-2.6664, 0.003, "-8/3"),
        (0.8304, 0.0006, "83/100"),
        (9.8102, 0.0005, "981/100"),
        (3.14161, 0.0005, "pi"),
        (28.01, 0.01, "28"),
    ],
)
def test_numbers_in_use_are_recognised(value, error, number):
    """A fitted value close to a number that people write stands for it."""
    assert simple_value(value, error) == sympy.sympify(number)


@pytest.mark.parametrize(
    ("value", "error"),
    [
        (0.9104, 0.05),  # 0.9, 0.91 and 1 all lie within two standard errors
        (-0.8303, 0.0006 / 4),  # 2.0001 errors and more from 0.83, and 5/6 is 20 away
        (0.4547, 0.0004),  # 5/11 is no number that people write
        (2.7183, 0.002),  # e is the base of exp, and no factor that people write
        (1.3750, 0.001),  # 11/8 lies right here, and 1.37 and 1.38 do as well
    ],
)
def test_numbers_that_would_lie_there_by_chance_are_not_believed(value, error):
    """Where the simple numbers are dense for the error, or of rare kinds, none is taken."""
    assert simple_value(value, error) is None


def test_rare_fractions_are_believed_where_the_value_is_pinned():
    """5/11 is taken once the relative error is far below 1e-4."""
    assert simple_value(5 / 11 + 1e-7, 1e-6) == sympy.Rational(5, 11)


def test_without_snapping_constants_stay_as_fitted(hunters):
    """Every constant is the fitted one to its last digit, also on clean data."""
    rough = {"prey": parse("1.3*prey - 0.8*pred*prey"), "pred": parse("0.9*pred*prey - 2.6*pred")}
    found = polish(rough, [disturb(hunters, 0.01, 0)], {}, {}, {}, settings=FitSettings(snap=False))
    for state, pairs in found.errors.items():
        assert [v for v, _ in pairs] == pytest.approx(list(found.fitted[state]), rel=1e-7)
        assert all(abs(v - round(v, 3)) > 1e-7 for v, _ in pairs)


@pytest.mark.slow
def test_the_switch_reaches_the_whole_discovery():
    """With ``snap=False`` clean decay of 0.5 keeps the digits of its fit; by default it is 0.5."""
    t = np.linspace(0, 3, 301)
    x = np.exp(-0.5 * t) * (1 + 1e-6 * np.sin(37 * t))
    sums = RationalSearch(costs=(2,), max_terms=3, denominators=False, rounds=1)
    simple = discover((t, x[:, None]), method=sums, jobs=1)
    fitted = discover((t, x[:, None]), method=sums, jobs=1, snap=False)
    assert simple.equations["x"] == parse("-0.5*x")
    assert coefficients(fitted.equations["x"])["x"] != -0.5
    assert coefficients(fitted.equations["x"])["x"] == pytest.approx(-0.5, rel=1e-4)
    assert fitted.settings["details"]["selection"]["fit"]["snap"] is False


def test_fitted_values_are_saved_and_read(tmp_path):
    """What constants were before they became simple numbers comes back from the file."""
    x = sympy.Symbol("x")
    found = Discovery(
        {"x": -2 * x}, {"x": ((-2.0, 0.1),)}, {}, {}, fitted={"x": (-2.05,)}, reach=2.1
    )
    again = Discovery.load(found.save(tmp_path / "found.json"))
    assert again.fitted == {"x": (-2.05,)}
    assert again.reach == 2.1
