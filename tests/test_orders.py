"""Equations of second order are found from the position alone; the time may be a variable."""

import json

import numpy as np
import pytest
import sympy
from command_line import run
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import dynsr
from dynsr.data import Trajectory, add_velocities, choose_second_samples
from dynsr.discovery.orders import Form, form_of, read_form, write_lines
from dynsr.errors import InputError

T = np.linspace(0, 10, 500)
FEW = T[::2]
# Without functions, which no claim below is about.
QUICK = {"preset": "quick", "functions": (), "jobs": 1}


def swing(noise=0.0, times=T):
    """Give the position of a damped linear oscillator, known in closed form, and its derivatives.

    x'' = -4 x - 0.2 x'.
    """
    root = -0.1 + 1j * np.sqrt(4 - 0.01)
    z = np.exp(root * times)
    draws = np.random.default_rng(0).normal(size=len(times))
    run = Trajectory(times, (z.real + noise * draws)[:, None], ("x",))
    return run, (root * z).real, (root**2 * z).real


@pytest.mark.parametrize(
    ("uneven", "noise", "velocity", "acceleration"),
    [(False, 0.0, 1e-5, 1e-3), (False, 0.01, 0.03, 0.06), (True, 0.05, 0.06, 0.1)],
)
@pytest.mark.slow
def test_derivatives_of_a_known_swing(uneven, noise, velocity, acceleration):
    """First and second derivative are those in closed form, on even and uneven times."""
    times = np.sort(np.random.default_rng(1).uniform(0, 10, 500)) if uneven else T
    one, first, second = swing(noise, times)
    (wide,) = add_velocities([one], {"x": "v"})
    rows = np.searchsorted(times, wide.t)
    assert np.std(wide.x[:, 1] - first[rows]) < velocity * np.std(first)
    assert np.array_equal(wide.x[:, 0], one.x[rows, 0])
    samples = choose_second_samples([wide], {"x": "v"}, "v")
    rows = np.searchsorted(times, samples.t)
    assert samples.names == ("x", "v") and samples.target == "v"
    assert np.std(samples.y - second[rows]) < acceleration * np.std(second)


@pytest.mark.slow
def test_an_oscillator_is_found_from_its_position(tmp_path):
    """x'' = -4 x - x'/5 comes out of noise, as a system of first order and as one line."""
    found = dynsr.discover(swing(0.01, T[::4])[0], order=2, **QUICK)
    assert list(found.equations) == ["x", "x_dot"]
    assert found.equations["x"] == sympy.Symbol("x_dot")
    assert str(found).splitlines()[1] in ("x'' = -4*x - 0.2*x'", "x'' = -4*x - x'/5")
    # Noise of 0.01 on 125 rows leaves the stiffness sure to about 3e-3.
    value, error = next(p for p in found.errors["x_dot"] if abs(p[0]) > 1)
    assert abs(value + 4) < 0.02 and error < 0.01
    again = type(found).load(found.save(tmp_path / "swing.json"))
    assert str(again) == str(found)


@pytest.mark.slow
@pytest.mark.parametrize("draw", [0, 3])
def test_a_velocity_that_was_made_is_no_measurement(draw):
    """Its error is that of a smoothed curve: the verdict rests on the position, and says law."""
    run = swing(0.0, np.arange(0, 15, 0.05))[0]
    noise = np.random.default_rng(draw).normal(scale=0.005, size=run.x.shape)
    found = dynsr.discover(Trajectory(run.t, run.x + noise, ("x",)), order=2, **QUICK)
    assert {str(s) for s in found.equations["x_dot"].free_symbols} == {"x", "x_dot"}
    assert found.verdict.level == "law"
    assert "was not measured" in found.verdict.states["x_dot"].reason


@pytest.mark.slow
def test_constants_of_a_rotor_of_many_turns_are_those_of_least_squares():
    """Noise of 2e-4 of its range is large for its velocity: constants come from the angle alone."""
    t = np.arange(0, 6, 0.02)

    def solved(drag, pull, angle, speed):
        law = lambda _, s: [s[1], -pull * np.sin(s[0]) - drag * s[1]]  # noqa: E731
        return solve_ivp(law, (0, 6), [angle, speed], t_eval=t, rtol=1e-9, atol=1e-9).y[0]

    angle = solved(0.15, 20.0, 0.5, 20.0)
    seen = angle + 0.004 * np.random.default_rng(0).normal(size=len(t))
    assert 3e-4 * np.std(angle) > 0.004
    fit = least_squares(lambda p: solved(*p) - seen, [0.15, 20.0, 0.5, 20.0], x_scale="jac")
    errors = 0.004 * np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))[:2]
    options = {"order": 2, "functions": ("sin",), "snap": False, "preset": "quick", "jobs": 1}
    found = dynsr.discover((t, seen[:, None]), **options)
    (state,) = [s for s in found.equations if s != "x"]
    own = sorted((-value, error) for value, error in found.errors[state])
    assert np.allclose([value for value, _ in own], fit.x[:2], atol=errors / 2)
    ratios = np.array([error for _, error in own]) / errors
    assert np.all((ratios > 0.5) & (ratios < 2))


@pytest.mark.slow
def test_a_position_alone_is_of_second_order_by_itself():
    """Without an order the law is of second order, and the answer says so; order=1 is kept."""
    run = swing(0.01, FEW)[0]
    found = dynsr.discover(run, **QUICK)
    assert list(found.equations) == ["x", "x_dot"]
    assert found.verdict.level == "law"
    assert "So the order is 2; order=1 (--order 1) sets it back." in found.explanation["x"]
    kept = dynsr.discover(swing(0.0, FEW)[0], order=1, **QUICK)
    assert list(kept.equations) == ["x"]
    assert "try --order 2" in kept.verdict.states["x"].reason


@pytest.mark.slow
def test_a_column_that_does_not_come_back_is_of_first_order():
    """Growth to a limit is searched in first order alone."""
    t = np.linspace(0, 10, 60)
    found = dynsr.discover(Trajectory(t, (1 / (1 + 9 * np.exp(-t)))[:, None], ("x",)), **QUICK)
    assert list(found.equations) == ["x"]
    assert "order" not in found.explanation["x"]


@pytest.mark.slow
def test_two_positions_are_of_second_order_by_themselves():
    """Two oscillators on springs: no law of first order, then one of second order for both."""
    t = np.linspace(0, 20, 200)
    # x + y and x - y are oscillators of their own.
    plus, minus = 1.3 * np.cos(t), 0.7 * np.cos(np.sqrt(3) * t)
    run = Trajectory(t, np.column_stack([plus + minus, plus - minus]) / 2, ("x", "y"))
    found = dynsr.discover(run, **QUICK)
    assert list(found.equations) == ["x", "x_dot", "y", "y_dot"]
    assert found.verdict.level == "law"
    x, y = sympy.symbols("x y")
    assert sympy.simplify(found.equations["x_dot"] - (y - 2 * x)) == 0
    assert sympy.simplify(found.equations["y_dot"] - (x - 2 * y)) == 0
    assert "So the order is 2" in found.explanation["y"]


@pytest.mark.slow
def test_of_two_states_one_may_be_of_second_order():
    """With order={"x": 2} a first-order column keeps its slopes and its place."""
    one, _, _ = swing(times=FEW)
    decay = np.exp(-0.3 * FEW)
    both = Trajectory(FEW, np.column_stack([one.x[:, 0], decay]), ("x", "c"))
    found = dynsr.discover(both, order={"x": 2}, **QUICK)
    assert list(found.equations) == ["x", "x_dot", "c"]
    assert str(found).splitlines()[2] in ("c' = -0.3*c", "c' = -3*c/10")
    scores = found.score(both)
    assert scores["x"]["trajectory_rmse"] < 1e-3 and scores["c"]["trajectory_rmse"] < 1e-3


@pytest.mark.slow
def test_a_known_force_on_the_velocity_is_left_out():
    """known may speak of the velocity: only the rest is searched."""
    found = dynsr.discover(swing(times=FEW)[0], order=2, known={"x_dot": "-4*x"}, **QUICK)
    x, v = sympy.symbols("x x_dot")
    rest = found.equations["x_dot"].subs({x: 0, v: 1})
    assert float(rest) == pytest.approx(-0.2, abs=1e-4)


@pytest.mark.slow
def test_the_time_is_a_variable_where_it_is_asked_for():
    """z' = cos t from z = sin t, clean and with noise."""
    t = np.linspace(0, 20, 150)
    for noise in (0.0, 0.01):
        z = np.sin(t) + noise * np.random.default_rng(0).normal(size=150)
        run = Trajectory(t, z[:, None], ("z",))
        options = {"method": "rational", "preset": "quick", "functions": ("cos",), "jobs": 1}
        found = dynsr.discover(run, explicit_time=True, **options)
        assert str(found).endswith("\nz' = cos(t)")
        assert found.score()["z"]["trajectory_rmse"] < 0.02
        assert found.settings["explicit_time"] is True


@pytest.mark.slow
def test_the_time_is_no_variable_otherwise():
    """Without the switch the equation of z = sin t has no t."""
    t = np.linspace(0, 20, 150)
    without = dynsr.discover((t, np.sin(t)[:, None]), preset="quick", jobs=1, method="sindy")
    assert sympy.Symbol("t") not in without.equations.popitem()[1].free_symbols


@pytest.mark.parametrize(
    ("order", "slopes", "words"),
    [
        (3, None, "must be 1 or 2"),
        (True, None, "must be 1 or 2"),
        ({"x": 0}, None, "must be 1 or 2"),
        ({"q": 2}, None, "unknown state 'q'"),
        (2, {"x": np.ones(500)}, "own slopes go with order 1"),
    ],
)
def test_orders_that_make_no_sense_are_refused(order, slopes, words):
    """One line says what an order may be."""
    with pytest.raises(InputError, match=words):
        dynsr.discover(swing()[0], order=order, slopes=slopes)


def test_a_velocity_takes_no_name_that_a_column_has():
    """x_dot is taken: the next name is used; when all are, a line says so."""
    names = ("x", "x_dot", "x_velocity", "x_rate")
    for count in (2, 3):
        run = Trajectory([0.0, 1.0], np.eye(2, count), names[:count])
        assert read_form(2, False, False, [run], ["x"]).velocities == {"x": names[count]}
    with pytest.raises(InputError, match="rename it"):
        read_form(2, False, False, [Trajectory([0.0, 1.0], np.eye(2, 4), names)], ["x"])


def test_forms_survive_their_record_and_strange_ones_are_plain():
    """A form is read back from settings; what is no form means first order."""
    form = Form({"x": "x_dot"}, explicit_time=True)
    assert form_of(form.record) == form
    for strange in ({"velocities": 3}, {"velocities": {"x": 1}}, {"explicit_time": "yes"}):
        assert form_of(strange) == Form()
    assert write_lines({"x": sympy.Symbol("y")}, {}) == ["x' = y"]


@pytest.mark.slow
def test_the_command_takes_orders(tmp_path):
    """--order x=2 finds the oscillator, prints x'', and --json has the first-order system."""
    dynsr.data.write_csv(swing(times=FEW)[0], tmp_path / "swing.csv")
    words = (
        "discover",
        tmp_path / "swing.csv",
        "--preset",
        "quick",
        "--functions",
        "",
        "-j",
        "1",
    )
    done = run(*words, "--order", "x=2", "--json", "--out", tmp_path / "out")
    told = json.loads(done.stdout)
    assert set(told["equations"]) == {"x", "x_dot"} and told["kind"] == "flow"
    assert told["text"][0] in ("x'' = -4*x - 0.2*x'", "x'' = -4*x - x'/5")
    assert told["settings"]["velocities"] == {"x": "x_dot"}
    assert "--order x=2" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize("order", ["3", "x=two", "1,x=2", "x="])
def test_bad_orders_of_the_command_are_one_line(tmp_path, order):
    """A bad --order ends with exit code 2 and a line that says how to write it."""
    dynsr.data.write_csv(swing()[0], tmp_path / "swing.csv")
    done = run("discover", tmp_path / "swing.csv", "--order", order, code=2)
    assert "--order" in done.stderr and "Traceback" not in done.stderr
