"""Profile likelihoods: what the data say of a constant when all others are fitted again."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from command_line import run
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import dynsr
from dynsr.discovery import Discovery
from dynsr.errors import InputError
from dynsr.fit import Measurements, Profiling, fit_along, loosen_all
from dynsr.verdict import StateVerdict, Verdict

LAW = Verdict("law", "it follows", {"x": StateVerdict("law", "it follows", 1.0)})
# The truth behind them: an enzyme, x' = -x/(x + 3), that starts far from saturation.
ENZYME, SPEED, HALF = "-1.1*x/(x + 3.2)", -1.0, 3.0


def solved(rhs, start, end, rows):
    """Give times, and a solution by scipy at them."""
    t = np.linspace(0, end, rows)
    found = solve_ivp(rhs, (0, end), start, t_eval=t, rtol=1e-10, atol=1e-12)
    return t, found.y.T


def found_in(t, values, **texts):
    """Give a discovery of some equations in data, that stopped a bit off its best constants."""
    run_ = dynsr.Trajectory(t, values, tuple(texts))
    equations = {state: dynsr.parse(text) for state, text in texts.items()}
    front = {state: dynsr.ParetoFront([]) for state in texts}
    return Discovery(equations, {}, front, {}, trajectories=(run_,), verdict=LAW)


def enzyme(noise, seed=1, start=0.5):
    """Give the enzyme in noise, as a share of the spread."""
    t, x = solved(lambda _, s: SPEED * s / (HALF + s), [start], 8.0, 60)
    rng = np.random.default_rng(seed)
    return found_in(t, x + noise * np.std(x) * rng.standard_normal(x.shape), x=ENZYME)


def noisy_rabbits(noise, seed=1):
    """Give predator and prey in noise, as a share of the spread of each."""
    t, x = solved(
        lambda _, s: [1.5 * s[0] - s[0] * s[1], s[0] * s[1] - 3 * s[1]], [1.0, 1.0], 8.0, 60
    )
    rng = np.random.default_rng(seed)
    x = x + noise * x.std(axis=0) * rng.standard_normal(x.shape)
    return found_in(t, x, x="1.4*x - 1.1*x*y", y="0.9*x*y - 3.1*y")


def holds(own, value):
    """Whether the interval of a profile holds a value; a side that is open has no end."""
    low = -math.inf if own.low is None else own.low
    high = math.inf if own.high is None else own.high
    return low <= value <= high


@pytest.mark.slow
def test_a_profile_is_what_solving_and_fitting_again_give():
    """Each value held, scipy's solver and least squares rise by the same, away from a parabola."""
    found = enzyme(0.05, start=1.0)
    run_ = found.trajectories[0]
    data = Measurements.of([run_], {}, 2000)
    begun = Profiling.of(fit_along(loosen_all(found.equations), data))
    weights = data.mesh(("x",)).weights[:, 0]
    rows = weights > 0

    def missed(speed, half, start):
        path = solve_ivp(
            lambda _, s: speed * s / (half + s),
            (0, 8.0),
            [start],
            t_eval=run_.t,
            rtol=1e-9,
            atol=1e-11,
        )
        return (path.y[0] - run_.x[:, 0]) * weights[rows]

    best = least_squares(lambda p: missed(*p), [-1.0, 3.0, 1.0])
    scale = 2 * best.cost / (len(run_) - 3)
    rises = begun.profile(1)
    for held in rises.held[::4]:
        again = least_squares(lambda p, v=held.value: missed(p[0], v, p[1]), best.x[[0, 2]])
        rise = 2 * (again.cost - best.cost) / scale
        assert held.rise == pytest.approx(rise, rel=0.03, abs=0.03)


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_on_a_parabola_profile_and_standard_error_agree(noise):
    """A rate of decay in noise has the same interval either way, which is the one kept."""
    t, x = solved(lambda _, s: -0.5 * s, [2.0], 5.0, 80)
    rng = np.random.default_rng(3)
    found = found_in(t, x + noise * np.std(x) * rng.standard_normal(x.shape), x="-0.45*x")
    own = found.profile(("x", 0))
    assert own.bounded == (True, True) and own.low < -0.5 < own.high
    width = own.wald[1] - own.wald[0]
    assert [own.low, own.high] == pytest.approx(own.wald, abs=0.03 * width)
    assert found.with_profiles().profiled == {}


@pytest.mark.slow
def test_equations_that_do_not_follow_the_data_have_no_profiles():
    """Lorenz' flow with one wrong equation: no fit comes to rest whose rises would say anything."""
    t, x = solved(
        lambda _, s: [10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 8 / 3 * s[2]],
        [-8.0, 8.0, 27.0],
        8.0,
        401,
    )
    x = x + 0.01 * np.std(x, axis=0) * np.random.default_rng(0).standard_normal(x.shape)
    wrong = {"x": "9.0*y - 9.0*x", "y": "3.0*x - 5.0*y", "z": "1.1*x*y - 3.0*z"}
    run_ = dynsr.Trajectory(t, x, ("x", "y", "z"))
    found = Discovery({s: dynsr.parse(e) for s, e in wrong.items()}, {}, {}, {}, (run_,))
    with pytest.raises(dynsr.InputError, match="does not come to rest"):
        found.profile(("x", 0))


@pytest.mark.slow
def test_exact_data_bound_a_constant_closely():
    """Without noise the interval holds the truth and is narrower than a thousandth of it."""
    t, x = solved(lambda _, s: SPEED * s / (HALF + s), [0.5], 8.0, 60)
    for own, truth in zip(found_in(t, x, x=ENZYME).profiles(), (SPEED, HALF), strict=True):
        assert own.high - own.low < 1e-3 * abs(truth)
        assert own.low <= truth <= own.high


@pytest.mark.slow
def test_the_error_of_the_rule_is_counted_in_exact_data():
    """Of an oscillator in closed form, at 61 rows: each interval is narrow and has the truth."""
    t, rate = np.linspace(0, 12, 61), np.sqrt(2 - 0.05**2)
    x = np.exp(-0.05 * t) * (np.cos(rate * t) + 0.05 / rate * np.sin(rate * t))
    v = -2 / rate * np.exp(-0.05 * t) * np.sin(rate * t)
    run = dynsr.Trajectory(t, np.column_stack([x, v]), ("x", "v"))
    law = {"x": dynsr.parse("v"), "v": dynsr.parse("-2.0*x - 0.1*v")}
    for own in Discovery(law, {}, {}, {}, (run,)).profiles():
        truth = {"x": -2.0, "v": -0.1}[own.of]
        assert own.low <= truth <= own.high and own.high - own.low < 1e-6 * abs(truth)
        assert own.wald[0] <= truth <= own.wald[1]


def test_what_data_do_not_bound_is_open_on_that_side():
    """Far below saturation both constants may be as large as one likes, only not too small."""
    speed, half = enzyme(0.1).profiles()
    assert half.bounded == (True, False) and speed.bounded == (False, True)
    assert 0 < half.low < HALF and half.interval_text == f"{half.low:.3g} or more"
    assert SPEED < speed.high < 0 and speed.interval_text == f"{speed.high:.3g} or less"
    assert half.values[-1] > 100 * abs(half.value) and half.criterion[-1] < half.limit


@pytest.mark.slow
def test_a_wrong_interval_gives_way_to_the_profile():
    """Where the chi-square is no parabola, constants have the interval of their profile."""
    found = enzyme(0.05).with_profiles()
    for own, constant in zip(found.profiles(), found.constants["x"], strict=True):
        assert constant.profiled
        assert [constant.low, constant.high] == [own.low, own.high]
    # The profile is lopsided: further from 0 there is more room.
    half = found.profile("x:1")
    assert half.high - half.value > 1.5 * (half.value - half.low)


def test_intervals_of_profiles_are_kept_in_the_file(tmp_path):
    """A saved discovery has them when it is read, sides that are open as well."""
    found = enzyme(0.1).with_profiles()
    again = Discovery.load(found.save(tmp_path / "discovery.json"))
    assert again.profiled == found.profiled
    assert [c.high for c in again.constants["x"]][1] is None
    assert again.constants["x"] == found.constants["x"]


def test_a_parameter_is_profiled_at_all_of_its_places():
    """What leaves one state for another is held in both equations, and known better so."""
    t, x = solved(lambda _, s: [-0.8 * s[0], 0.8 * s[0] - 0.3 * s[1]], [2.0, 0.0], 6.0, 60)
    x = x + 0.05 * x.std(axis=0) * np.random.default_rng(5).standard_normal(x.shape)
    found = found_in(t, x, x="-0.75*x", y="0.75*x - 0.35*y")
    assert list(found.parameters) == ["k1", "k2"]
    own, alone = found.profile("k1"), found.profile(("x", 0))
    assert own.low < 0.8 < own.high and own.value > 0 > alone.value
    assert own.high - own.low < alone.high - alone.low
    assert own.wald == pytest.approx((own.low, own.high), rel=0.02)


def test_other_data_are_profiled_along():
    """The data may be given again, as a saved discovery needs it."""
    found = enzyme(0.02)
    run_ = found.trajectories[0]
    again = Discovery(found.equations, {}, found.front, {})
    table = {"t": run_.t, "x": run_.x[:, 0]}
    assert again.profile("x:0", table).low == found.profile("x:0").low


def test_a_profile_that_finds_a_better_fit_begins_again():
    """A start that was no minimum leaves no mark: the profile touches 0 at the best value."""
    found = enzyme(0.02)
    fit = fit_along(loosen_all(found.equations), Measurements.of(found.trajectories, {}, 2000))
    begun = Profiling.of(fit)
    right = begun.profile(1)
    constants = fit.constants * [1.02, 1.02]
    states = fit.found.states.T
    off = type(begun.best)(math.nan, 0.0, constants, states)
    cost = fit.problem.cost(states, constants)
    wrong = replace(begun, best=off, cost=cost).profile(1)
    assert min(held.rise for held in wrong.held) == pytest.approx(0.0, abs=0.1)
    assert [wrong.low, wrong.high] == pytest.approx([right.low, right.high], rel=0.01)


@pytest.mark.slow
def test_numbers_of_any_size_are_profiled():
    """The same data in units a billion times smaller have the same interval in those units."""
    small = enzyme(0.05)
    run_ = small.trajectories[0]
    large = found_in(run_.t, 1e9 * run_.x, x="-1.1e9*x/(x + 3.2e9)")
    for own, other in zip(small.profiles(), large.profiles(), strict=True):
        assert other.low / 1e9 == pytest.approx(own.low, rel=0.02)
        assert other.high / 1e9 == pytest.approx(own.high, rel=0.02)


@pytest.mark.slow
def test_a_driven_system_is_profiled():
    """An input that was measured drives the joint fit at every value that is held."""
    t, x = solved(lambda s, y: -0.8 * y + np.sin(s), [1.0], 12.0, 120)
    rng = np.random.default_rng(0)
    x = x + 0.02 * np.std(x) * rng.standard_normal(x.shape)
    run_ = dynsr.Trajectory(t, x, ("x",), np.sin(t)[:, None], ("u",))
    found = Discovery({"x": dynsr.parse("-0.7*x + 1.1*u")}, {}, {}, {}, trajectories=(run_,))
    values = {c.of: c for c in found.profiles()}
    assert holds(values["x"], -0.8) and holds(values["u"], 1.0)


@pytest.mark.parametrize(
    ("which", "words"),
    [
        (("x", 2), "x has 2 constants, counted from 0; 2 is not one of them"),
        (("y", 0), "'y' has no equation; those that have: x"),
        ("k3", "'k3' is no parameter; those are k1, k2"),
        (("x",), "names no constant; give a parameter, or state and place from 0"),
        ("x:-1", "'x:-1' names no constant"),
        (("x", "first"), "names no constant"),
    ],
)
def test_a_constant_that_is_none_is_refused(which, words):
    """A name of no constant ends in one line that says how to name one."""
    with pytest.raises(InputError, match=re.escape(words)) as error:
        enzyme(0.05).profile(which)
    assert "\n" not in str(error.value)


def test_what_has_no_profile_says_why():
    """Without data, with too few rows, of a map and where slopes diverge there is one line."""
    bare = Discovery({"x": dynsr.parse("-x")}, {}, {}, {})
    with pytest.raises(InputError, match="the data are not here"):
        bare.profiles()
    with pytest.raises(InputError, match="4 rows are too few"):
        bare.profiles(dynsr.Trajectory(np.arange(4.0), np.exp(-np.arange(4.0))[:, None], ("x",)))
    iterated = Discovery({"x": dynsr.parse("2*x")}, {}, {}, {}, settings={"kind": "map"})
    with pytest.raises(InputError, match="a map has no joint fit"):
        iterated.profiles()
    t = np.linspace(-1, 1, 60)
    with pytest.raises(InputError, match="cannot be fitted along these data"):
        found_in(t, t[:, None], x="log(x)").profiles()


@pytest.mark.slow
def test_the_shell_shows_profiles(tmp_path):
    """The command prints a row a constant, and as JSON the curve as well."""
    found = enzyme(0.1)
    model, table = found.save(tmp_path / "discovery.json"), tmp_path / "data.csv"
    run_ = found.trajectories[0]
    np.savetxt(table, np.column_stack([run_.t, run_.x]), "%.12g", ",", header="t,x", comments="")
    shown = run("profile", model, table).stdout
    assert "or more" in shown and "or less" in shown
    told = json.loads(run("profile", model, table, "--constant", "x:1", "--json").stdout)
    (own,) = told["profiles"]
    assert own["high"] is None and own["low"] > 0 and len(own["values"]) == len(own["criterion"])
    refused = run("profile", model, table, "--constant", "x:7", code=2)
    assert "7 is not one of them" in refused.stderr


@pytest.mark.slow
def test_the_report_draws_profiles_and_says_whose_interval_it_is(tmp_path):
    """In noise the page has a picture of the profiles; a constant says where its interval is from.

    A discovery that was found in exact data has none.
    """
    page = enzyme(0.05).with_profiles().report(tmp_path / "report.html").read_text("utf-8")
    assert (
        "The profile likelihood of each constant" in page
        and "that of the profile likelihood" in page
    )
    t, x = solved(lambda _, s: SPEED * s / (HALF + s), [0.5], 8.0, 60)
    exact = found_in(t, x, x=ENZYME).report(tmp_path / "exact.html").read_text("utf-8")
    assert "The profile likelihood of each constant" not in exact


def test_a_picture_shows_the_profile_and_its_parabola():
    """The figure has the fits, the parabola and the line at which an interval ends."""
    figure = enzyme(0.05).profile("x:1").plot()
    labels = {line.get_label() for line in figure.axes[0].lines}
    assert labels == {"profile", "standard error", "95 %"}


@pytest.mark.slow
def test_intervals_of_profiles_hold_the_truth_as_often_as_they_say():
    """Over 20 draws of each system, at 1 % and 5 % in turn, 95 % intervals hold the truth in 90 to
    98.5 %.
    """
    kept = []
    for seed in range(20):
        noise = (0.01, 0.05)[seed % 2]
        for found, truth in (
            (enzyme(noise, seed), (SPEED, HALF)),
            (noisy_rabbits(noise, seed), (-1.0, 1.5, 1.0, -3.0)),
        ):
            kept += [holds(own, v) for own, v in zip(found.profiles(), truth, strict=True)]
    assert 0.90 <= np.mean(kept) <= 0.985


@pytest.mark.slow
def test_a_search_in_noise_gives_intervals_of_profiles_where_they_are_needed():
    """Hares and lynxes, 21 rows: what bounds their constants is no parabola on every side."""
    runs = dynsr.data.read_trajectories("docs/records/hare-lynx.csv").trajectories
    found = dynsr.discover(runs, preset="quick", jobs=1, progress=False)
    assert any(c.profiled for own in found.constants.values() for c in own)
    for own in found.profiles():
        assert own.bounded == (True, True)
