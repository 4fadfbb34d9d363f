from functools import partial

import numpy as np
import pytest
import sympy
from command_line import run
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from dynsr.data.reading import take_trajectories
from dynsr.data.system import System
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.engines.base import InitialValueProblem
from dynsr.engines.simulation import simulate
from dynsr.errors import EngineError, InputError
from dynsr.expression.parsing import parse
from dynsr.verdict.maps import iterate
from dynsr.verdict.prediction import Measured, predict

T = np.linspace(0.0, 10.0, 101)
SINE = np.sin(T)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("equations", "start"),
    [
        ({"x": "y", "y": "-400*x + u"}, [0.0, 0.0]),
        ({"x": "-180*x + u"}, [1.0]),
        ({"x": "-1e5*x + u"}, [1.0]),
    ],
)
def test_fast_systems_with_a_measured_input_agree_with_scipy(equations, start):
    """Ten or a hundred thousand time constants between two rows: Radau finds the same states."""
    exprs = {s: parse(e) for s, e in equations.items()}
    slopes = sympy.lambdify(sympy.symbols([*exprs, "u"]), list(exprs.values()))
    times = T[:31]
    spline = CubicSpline(times, np.sin(times))
    expected = solve_ivp(
        lambda t, x: slopes(*x, spline(t)), (0, 3), start, "Radau", times, rtol=1e-9, atol=1e-12
    ).y.T
    found = predict(exprs, start, times, {"u": np.sin(times)}).x
    assert np.abs(found - expected).max() < 1e-6


@pytest.fixture
def few_steps(monkeypatch):
    """Let explicit steps end after 5,000, where the implicit method goes on, not 100,000."""
    problem = partial(InitialValueProblem, max_steps=5_000)
    monkeypatch.setattr("dynsr.engines.simulation.InitialValueProblem", problem)


@pytest.mark.slow
def test_a_stiff_system_says_that_it_was_integrated_implicitly(few_steps):
    """Beside its name the engine that answered is named, for both kinds of input."""
    stiff = {"x": parse("-1e6*(x - u)")}
    measured = predict(stiff, [1.0], T, {"u": SINE})
    assert "Radau" in measured.origin["engine"]
    assert np.abs(measured.x[1:, 0] - SINE[1:]).max() < 1e-5
    exact = predict(stiff, [1.0], T, {"u": "sin(t)"})
    assert (
        "Radau" in exact.origin["engine"]
        and "Radau"
        not in predict({"x": parse("u - x")}, [1.0], T, {"u": "sin(t)"}).origin["engine"]
    )
    assert np.abs(exact.x[1:, 0] - SINE[1:]).max() < 1e-5


def test_robertsons_reactions_are_solved(few_steps):
    """Robertson (1966), time constants of 1e-4 to 1e4: the states sum to 1 and agree with LSODA."""
    rates = {
        "a": "-0.04*a + 1e4*b*c",
        "b": "0.04*a - 1e4*b*c - 3e7*b^2",
        "c": "3e7*b^2",
    }
    system = System.from_strings(rates, x0=[1.0, 0.0, 0.0])
    t = np.array([0.0, 1.0, 40.0, 1000.0])
    found = simulate(system, t=t, reltol=1e-8, abstol=1e-12)

    def slopes(_, x):
        fast, slow = 1e4 * x[1] * x[2], 3e7 * x[1] ** 2
        return [-0.04 * x[0] + fast, 0.04 * x[0] - fast - slow, slow]

    expected = solve_ivp(slopes, (0, 1000), [1.0, 0, 0], "LSODA", t, rtol=1e-10, atol=1e-14).y.T
    assert np.abs(found.x[1:] / expected[1:] - 1).max() < 1e-5
    assert np.abs(found.x.sum(axis=1) - 1).max() < 1e-7


@pytest.mark.parametrize(
    ("expr", "end"), [("-1/x + u", "0.5"), ("1/(t - 1)^2 + u", "1"), ("x^2 + u", "1")]
)
def test_a_pole_is_an_error_with_time_and_state(expr, end):
    """No step runs through a pole, and the message says when and where the solution ended."""
    with pytest.raises(EngineError, match=rf"no solution at t = .*ends at t = {end}.*, x = "):
        predict({"x": parse(expr)}, [1.0], T, {"u": 0 * T})


def test_a_system_whose_engine_gives_up_says_where():
    """An engine's own divergence names the last state that was reached too."""
    grows = System.from_strings({"x": "x^2"}, x0=[1.0])
    with pytest.raises(EngineError, match=r"it ends at t = 0\.9, x = 9\.99"):
        simulate(grows, t=np.linspace(0.0, 2.0, 21), reltol=1e-3, abstol=1e-6)


def test_a_narrow_pulse_from_rest_is_seen():
    """A Gaussian pulse a thousandth of the span wide carries its whole area, measured or not."""
    t = np.array([0.0, 10.0])
    area = np.sqrt(np.pi) * 0.01
    rest = {"x": parse("u")}
    exact = predict(rest, [0.0], t, {"u": "exp(-((t - 5.0123)/0.01)^2)"})
    assert exact.x[-1, 0] == pytest.approx(area, rel=1e-6)
    system = System.from_strings({"x": "u"}, inputs={"u": "exp(-((t - 5.0123)/0.01)^2)"}, x0=[0.0])
    assert simulate(system, t=t).x[-1, 0] == pytest.approx(area, rel=1e-2)
    fine = np.linspace(0.0, 10.0, 10_001)
    pulse = np.exp(-(((fine - 5.0123) / 0.01) ** 2))
    measured = predict(rest, [0.0], t, {"u": Measured("u", fine, pulse)})
    assert measured.x[-1, 0] == pytest.approx(area, rel=1e-6)


@pytest.mark.filterwarnings("ignore:columns were renamed")
def test_a_start_may_be_given_by_name():
    """By the names of the equations or of the data, in any order; all of them, and no others."""
    runs, _ = take_trajectories({"t": T, "a cell": SINE, "b [g]": T**2})
    a, b = sympy.symbols("a_cell b")
    found = Discovery({"a_cell": -a + b, "b": -b}, {}, {}, {}, trajectories=tuple(runs))
    wanted = found.simulate([1.0, 2.0], [0.0, 1.0]).x
    for start in ({"b": 2.0, "a_cell": 1.0}, {"b [g]": 2.0, "a cell": 1.0}):
        np.testing.assert_array_equal(found.simulate(start, [0.0, 1.0]).x, wanted)
    for start in ({}, {"b": 2.0}, {"b": 2.0, "a_cell": 1.0, "c": 0.0}):
        with pytest.raises(InputError, match=r"give a start for each of: a_cell, b$"):
            found.simulate(start, [0.0, 1.0])


def test_beyond_the_measured_input_nothing_is_held():
    """The input after its last row is not known: the call is refused, and names what is missing."""
    data = Trajectory(T, SINE[:, None], ("x",), np.cos(T)[:, None], ("u",))
    found = Discovery({"x": parse("u")}, {"x": ()}, {}, {}, (data,))
    assert found.simulate().x[-1, 0] == pytest.approx(np.sin(10.0), abs=1e-5)
    with pytest.raises(InputError, match=r"'u' was measured from t = 0 to 10, and t = 12 lies"):
        found.simulate(t=[0.0, 5.0, 12.0])
    later = found.simulate(t=[0.0, 12.0], inputs={"u": "cos(t)"})
    assert later.x[-1, 0] == pytest.approx(np.sin(12.0), abs=1e-6)


def test_few_times_see_the_whole_measured_input():
    """Two times of an answer do not thin out the 101 rows of the input."""
    data = Trajectory(T, SINE[:, None], ("x",), np.cos(T)[:, None], ("u",))
    found = Discovery({"x": parse("u")}, {"x": ()}, {}, {}, (data,))
    assert found.simulate(t=[0.0, 10.0]).x[-1, 0] == pytest.approx(np.sin(10.0), abs=1e-5)


def test_a_measured_input_with_holes_is_refused():
    """A NaN among the values is named with its time."""
    with pytest.raises(InputError, match="input 'u' is nan at t = 5"):
        predict({"x": parse("u")}, [0.0], T, {"u": np.where(T == 5.0, np.nan, SINE)})


def test_scores_take_the_input_of_the_data():
    """x' = u with another u than the discovery's: slopes, forecasts and trajectories follow it."""
    data = Trajectory(T, (T**2 / 2)[:, None], ("x",), T[:, None], ("u",))
    found = Discovery({"x": parse("u")}, {"x": ()}, {}, {}, (), {"u": parse("cos(t)")})
    scores = found.score(data)["x"]
    assert scores["slope_rmse"] < 1e-6
    assert scores["forecast"] < 1e-6
    assert scores["trajectory_rmse"] < 1e-6


def test_a_score_that_diverges_is_a_word(tmp_path):
    """x' = x^2 on data that stay finite: the cell says so, and the JSON holds null."""
    saved = Discovery({"x": parse("x^2")}, {"x": ()}, {}, {}, settings={"engine": "embedded"}).save(
        tmp_path / "found.json"
    )
    data = tmp_path / "data.csv"
    rows = "\n".join(f"{t:.3f},{np.exp(-t):.9f}" for t in np.linspace(0, 3, 61))
    data.write_text(f"t,x\n{rows}\n", "utf-8")
    assert "diverges" in run("score", saved, data).output
    assert "null" in run("score", saved, data, "--json").output


@pytest.mark.parametrize(
    "value",
    [object(), [object()] * 3, [[1.0], [1.0, 2.0]], 1j, ["a"] * 3, [0.0], [0.0, np.nan, 1.0], None],
)
@pytest.mark.parametrize("held", [True, False])
def test_inputs_that_are_no_values_are_refused_by_name(value, held):
    """Of a flow, with an input whose hold the data told or another one, and of a map."""
    u, t = sympy.Symbol("u"), np.arange(3.0)
    settings = {"hold": {"u": "linear"}} if held else {}
    flow = Discovery({"x": u}, {}, {}, {}, settings=settings)
    with pytest.raises(InputError, match="input 'u'"):
        flow.simulate([1.0], t, inputs={"u": value})
    with pytest.raises(InputError, match="input 'u'"):
        iterate({"x": u}, [1.0], t, {"u": value})
