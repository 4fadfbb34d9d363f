from dataclasses import replace

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.samples import Samples
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.search import discover
from dynsr.expression.parsing import parse
from dynsr.verdict.drift import drift_of_rows
from dynsr.verdict.drift_exact import same_in_time
from dynsr.verdict.flow_verdict import give_verdict
from dynsr.verdict.levels import explain
from dynsr.verdict.map_verdict import give_map_verdict
from dynsr.verdict.maps import keep_within, measure_step_errors


def integrate(slope, x0, end, rows, noise=0.0, seed=0, names=("x", "y")):
    """Integrate with SciPy and add noise, a share of each state's spread."""
    t = np.linspace(0, end, rows)
    x = solve_ivp(slope, (0, end), x0, t_eval=t, rtol=1e-10, atol=1e-12).y.T
    drawn = np.random.default_rng(seed).standard_normal(x.shape)
    return Trajectory(t, x + noise * x.std(axis=0) * drawn, names[: x.shape[1]])


def step_on(step, x0, rows):
    """Iterate ``step(row, state)``."""
    found = [np.array(x0, dtype=float)]
    for row in range(rows - 1):
        found.append(np.array(step(row, found[-1]), dtype=float))
    return Trajectory(np.arange(float(rows)), np.array(found), ("x", "y")[: len(x0)])


def equations(**texts):
    """Read equations."""
    return {state: parse(text) for state, text in texts.items()}


# Maps


def test_an_exact_map_whose_parameter_drifts_is_no_law_and_its_drift_is_named():
    """A logistic map that goes from 3.5 to 3.9 is told as that, with both ends."""
    data = step_on(lambda n, x: (3.5 + 0.4 * n / 298) * x * (1 - x), [0.3], 300)
    found = give_map_verdict(equations(x="3.7*x - 3.7*x**2"), [data])
    assert found.level != "law"
    assert "its constants change along the record: x's coefficient from 3.5 to 3.9" in found.reason
    assert "t*x" in found.alternatives["x"][0].equation and found.alternatives["x"][0].bits < -1000


def test_a_drift_within_chance_in_the_motion_is_found():
    """A Henon map with noise in its steps whose parameter goes from 1.2 to 1.4 is no law."""
    rng = np.random.default_rng(0)

    def step(n, x):
        noise = 0.005 * rng.standard_normal()
        return 1 - (1.2 + 0.2 * n / 300) * x[0] ** 2 + x[1] + noise, 0.3 * x[0]

    data = step_on(step, [0.1, 0.1], 300)
    found = give_map_verdict(equations(x="1 - 1.3*x**2 + y", y="0.3*x"), [data])
    assert "x**2's coefficient from -1.2 to -1.4" in found.states["x"].reason
    assert found.states["y"].level == "law"


@pytest.mark.parametrize("seed", range(4))
def test_chance_that_grows_along_the_record_is_no_drift(seed):
    """A Henon map whose steps are shaken ten times as much at its end keeps its law."""
    rng = np.random.default_rng(seed)

    def step(n, x):
        noise = 0.001 * (1 + 9 * n / 300) * rng.standard_normal()
        return 1 - 1.2 * x[0] ** 2 + x[1] + noise, 0.3 * x[0]

    data = step_on(step, [0.1, 0.1], 300)
    assert give_map_verdict(equations(x="1 - 1.2*x**2 + y", y="0.3*x"), [data]).level == "law"


@pytest.mark.slow
def test_false_alarms_of_maps_are_rare():
    """Of 200 logistic maps with noise in their steps none is said to drift."""
    x, n = sympy.Symbol("x"), np.arange(199.0)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        noise = 0.004 * rng.standard_normal(200)
        rows = [0.3]
        for one in noise[1:]:
            rows.append(3.6 * rows[-1] * (1 - rows[-1]) + one)
        pairs = Samples(np.array(rows[:-1])[:, None], np.array(rows[1:]), ("x",), "x", "given", n)
        assert drift_of_rows("x", 3.6 * x * (1 - x), pairs, 1e-11, discrete=True) is None


def test_a_simple_number_outside_its_interval_is_no_constant_of_a_map():
    """11/3 for 3.651 to within 0.002 becomes what was fitted; 3.65 stays."""
    rng, x = np.random.default_rng(0), np.linspace(0.1, 0.9, 80)
    noise = 0.005 * rng.standard_normal(80)
    rows = Samples(x[:, None], 3.651 * x * (1 - x) + noise, ("x",), "x", "given", x)
    kept = keep_within(parse("11*x/3 - 11*x**2/3"), rows)
    for (value, error), fitted in zip(*measure_step_errors(kept, rows), strict=True):
        assert abs(value - fitted) <= 1.96 * error
    assert keep_within(parse("3.65*x - 3.65*x**2"), rows) == parse("3.65*x - 3.65*x**2")


# Exact flows


@pytest.mark.parametrize(
    ("solution", "slope", "law", "other"),
    [
        ("1 + t + t**2/2", "1 + t", "1.41421356237*sqrt(x - 0.5)", "t + 1"),
        ("sin(t)", "cos(t)", "sqrt(1 - x**2)", "cos(t)"),
        ("exp(-t**2/2)", "-t*exp(-t**2/2)", "-1.41421356237*x*sqrt(-log(x))", "-t*x"),
    ],
)
def test_along_one_run_of_one_way_a_shorter_law_in_the_time_is_told(solution, slope, law, other):
    """What is as exact and shorter in the time keeps an equation from being a law."""
    t = np.linspace(0, 1.3, 150)
    columns = {
        name: np.array([float(e.subs("t", v)) for v in t])
        for name, e in {"x": parse(solution, ["t"]), "y": parse(slope, ["t"])}.items()
    }
    rows = Samples(columns["x"][:, None], columns["y"], ("x",), "x", "given", t)
    found = same_in_time("x", parse(law), rows)
    assert found is not None
    assert str(found.expr) == other
    assert found.said == (
        f"the data cannot distinguish it from x' = {other}; a run from another start decides"
    )


@pytest.mark.parametrize(
    ("slope", "law", "start"),
    [
        (lambda _, x: -0.5 * x, "-0.5*x", 2.0),
        (lambda _, x: -0.5 * x, "-0.5*x", 1.0),
        (lambda _, x: 0.9 * x - 0.18 * x**2, "0.9*x - 0.18*x**2", 0.3),
        (lambda _, x: -0.1 * np.sqrt(x), "-0.1*sqrt(x)", 2.0),
        (lambda _, x: 6 - 0.3 * x, "6 - 0.3*x", 80.0),
    ],
)
def test_a_law_that_is_shorter_than_its_twin_in_the_time_stays_one(slope, law, start):
    """One run of a decay, of growth to a limit, or of an outflow is enough for its law."""
    assert give_verdict(equations(x=law), [integrate(slope, [start], 5, 150)]).level == "law"


@pytest.mark.slow
def test_runs_from_other_starts_tell():
    """With a second run the square root is wrong and t + 1 is told, with one it is a guess."""
    law = equations(x="1.41421356237*sqrt(x - 0.5)")
    t = np.linspace(0, 3, 150)
    one, two = (Trajectory(t, (c + t + t**2 / 2)[:, None], ("x",)) for c in (1.0, 3.0))
    assert "a run from another start decides" in give_verdict(law, [one]).reason
    found = give_verdict(law, [one, two])
    assert found.level != "law"
    assert "x' = t + 1" in found.reason


@pytest.mark.slow
def test_clean_slopes_that_drift_are_told_whatever_was_found():
    """A cooling body whose surroundings grow warmer evenly is told beside a wrong equation."""
    data = integrate(lambda t, x: -0.3 * (x - 20 - 0.8 * t), [80.0], 20, 150)
    found = give_verdict(equations(x="10 - 0.375*x"), [data])
    assert found.level != "law"
    assert "its constants change along the record: its constant term from 6" in found.reason


# Flows with noise


@pytest.mark.slow
def test_a_spring_that_stiffens_beats_an_odd_law():
    """A function of position and speed that stands for the time is told apart from a drift."""
    data = integrate(
        lambda t, x: [x[1], -(1 + 0.03 * t) * x[0] - 0.1 * x[1]], [1.0, 0.0], 40, 400, 0.01
    )
    odd = equations(x="y", y="-1.031*x/(x**2 + y**2 + 0.0919)**0.283 - 0.09341*y")
    own = give_verdict(odd, [data]).states["y"]
    assert own.level != "law"
    assert "its constants change along the record: x's coefficient from -1 to -2.2" in own.reason
    first = own.alternatives[0]
    assert first.bits < 0 and "t*x" in first.equation.replace("x*t", "t*x")
    # The formula stands in the reason, and is not said again.
    assert explain("y", odd["y"], own).endswith(
        "change along the record: " + own.reason.split("record: ")[1]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slope", "start", "end", "found", "said"),
    [
        (
            lambda t, x: [x[1], -x[0] - (0.05 + 0.01 * t) * x[1]],
            [1.0, 0.0],
            30,
            {"x": "y", "y": "-x - 0.2*y"},
            "y's coefficient from -0.05",
        ),
        (
            lambda t, x: [
                (1.3 + 0.05 * t) * x[0] - 0.9 * x[0] * x[1],
                0.8 * x[0] * x[1] - 1.6 * x[1],
            ],
            [1.5, 1.0],
            12,
            {"x": "1.6*x - 0.9*x*y", "y": "0.8*x*y - 1.6*y"},
            "x's coefficient from 1.3",
        ),
        (
            lambda t, x: -0.3 * (x - 20 - 0.8 * t),
            [80.0],
            20,
            {"x": "8 - 0.3*x"},
            "its constant term from",
        ),
    ],
)
def test_a_drift_in_noise_is_named(slope, start, end, found, said):
    """Damping, growth and surroundings that change evenly are named beside fixed constants."""
    judged = give_verdict(equations(**found), [integrate(slope, start, end, 250, 0.01)])
    assert judged.level != "law"
    reasons = " ".join(own.reason for own in judged.states.values())
    assert "its constants change along the record" in reasons
    assert said in reasons


@pytest.mark.slow
def test_a_rate_that_grows_with_the_time_in_every_run_is_named():
    """Three decays of -(0.3 + 0.1 t) x, the time begun anew in each, have one drift."""
    runs = [
        integrate(lambda t, x: -(0.3 + 0.1 * t) * x, [start], 5, 100, 0.01, seed)
        for seed, start in enumerate((1.0, 2.0, 4.0))
    ]
    noise = [np.full((100, 1), 0.01 * run.x.std()) for run in runs]
    found = give_verdict(equations(x="-0.45*x"), runs, noise=noise)
    assert found.level != "law"
    assert "its constants change along the record: x's coefficient from -0." in found.reason


@pytest.mark.parametrize("held", ["run", "formula", "both"])
@pytest.mark.slow
def test_a_drift_is_named_beside_an_input_of_any_name(held):
    """An input called as dynsr calls the time is none, in a run or as a formula."""
    run = integrate(
        lambda t, x: [-0.5 * (1 + 0.05 * t) * x[0] + np.sin(2 * t)], [2.0], 20, 200, 0.01
    )
    if held != "formula":
        column = np.sin(2 * run.t)[:, None]
        run = replace(run, inputs=column, input_names=("unmeasured",))
    inputs = {} if held == "run" else {"unmeasured": parse("sin(2*t)")}
    found = give_verdict(equations(x="unmeasured - 0.7*x"), [run], inputs)
    assert found.level != "law"
    assert "change along the record: x's coefficient from -0.5" in found.reason


@pytest.mark.slow
def test_a_decay_that_hangs_on_the_time_is_told_beside_a_strange_function():
    """x' = -t x, with 1 % noise, is shorter than a function of x that follows one run as well."""
    data = integrate(lambda t, x: -t * x, [1.0], 3, 200, 0.01)
    found = give_verdict(equations(x="-1.56*x**0.8265*sqrt(1.009 - x) + 0.076*x"), [data])
    assert found.level != "law"
    assert "t*x; a run from another start decides" in found.reason


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("slope", "start", "end", "law", "noise"),
    [
        (
            lambda _, x: [1.3 * x[0] - 0.9 * x[0] * x[1], 0.8 * x[0] * x[1] - 1.6 * x[1]],
            [1.5, 1.0],
            12,
            {"x": "1.3*x - 0.9*x*y", "y": "0.8*x*y - 1.6*y"},
            0.05,
        ),
        (lambda _, x: -0.5 * x, [2.0], 5, {"x": "-0.5*x"}, 0.05),
        (lambda _, x: x - 0.1 * x**2, [0.5], 8, {"x": "x - 0.1*x**2"}, 0.01),
        (
            lambda _, x: [x[1], -9.81 * np.sin(x[0]) - 0.2 * x[1]],
            [1.5, 0.0],
            10,
            {"x": "y", "y": "-9.81*sin(x) - 0.2*y"},
            0.01,
        ),
    ],
)
def test_true_laws_in_noise_do_not_drift(slope, start, end, law, noise, seed):
    """Nothing about the time is said of equations that are right."""
    judged = give_verdict(equations(**law), [integrate(slope, start, end, 150, noise, seed)])
    for own in judged.states.values():
        assert "record" not in own.reason and "time" not in own.reason
        assert "not random" not in own.reason and "another start" not in own.reason


@pytest.mark.slow
def test_a_discovery_names_the_drift():
    """What was searched without the time says that its constants change, and stays without it."""
    data = integrate(
        lambda t, x: [x[1], -(1 + 0.03 * t) * x[0] - 0.1 * x[1]], [1.0, 0.0], 40, 400, 0.0
    )
    found = discover(data, preset="quick", functions=[], jobs=1)
    assert found.verdict.level != "law"
    assert "y' = -0.03*t*x - x - 0.1*y" in found.explanation["y"]
    assert all("t" not in map(str, e.free_symbols) for e in found.equations.values())
