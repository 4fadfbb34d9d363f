"""Records as people have them: the right law, or a verdict that says what is missing."""

from pathlib import Path

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

import dynsr
from dynsr.data import Trajectory
from dynsr.expression import evaluate, parse
from dynsr.methods import RationalSearch
from dynsr.verdict.flow_verdict import give_verdict
from dynsr.verdict.map_verdict import give_map_verdict

# Sums and ratios of two terms compete with the law; more of them only take longer.
FEW = {"method": RationalSearch(costs=(2,), max_terms=2, rounds=1), "jobs": 1}
RECORDS = Path(__file__).parents[1] / "docs" / "records"


def solve(slope, start, t, names, noise=0.0):
    """Integrate a system; noise of this share of each state's spread is added."""
    x = solve_ivp(slope, (t[0], t[-1]), start, "LSODA", t, rtol=1e-10, atol=1e-12).y.T
    x = x + noise * x.std(axis=0) * np.random.default_rng(3).standard_normal(x.shape)
    return Trajectory(t, x, names)


def coefficients(expr):
    """Term -> coefficient of the expanded expression."""
    return {str(t): float(c) for t, c in sympy.expand(expr).as_coefficients_dict().items()}


def check_what_is_said(found):
    """Every explanation begins with the printed formula and its level."""
    for line, (state, own) in zip(
        str(found).splitlines()[1:], found.verdict.states.items(), strict=True
    ):
        assert found.explanation[state].startswith(f"{line}: {own.level}; ")


@pytest.mark.slow
def test_hare_and_lynx_follow_lotka_and_volterra():
    """21 yearly counts give the form, and constants inside the published intervals."""
    found = dynsr.discover(RECORDS / "hare-lynx.csv", **FEW)
    hare, lynx = (coefficients(found.equations[s]) for s in ("hare", "lynx"))
    assert set(hare) == {"hare", "hare*lynx"} and set(lynx) == {"lynx", "hare*lynx"}
    assert hare["hare"] == pytest.approx(0.55, abs=0.07)
    assert hare["hare*lynx"] == pytest.approx(-0.028, abs=0.004)
    assert lynx["lynx"] == pytest.approx(-0.80, abs=0.09)
    assert lynx["hare*lynx"] == pytest.approx(0.024, abs=0.004)
    # 21 rows do not make a law.
    assert found.verdict.level == "approximation"
    assert "21 rows are few" in found.verdict.states["hare"].reason
    check_what_is_said(found)


@pytest.mark.slow
def test_an_epidemic_of_one_column_lacks_a_state():
    """Boys in bed rise and fall again: what moves them is not in the table."""
    found = dynsr.discover(RECORDS / "influenza.csv", **FEW)
    assert found.verdict.level == "not found"
    assert "may be missing among the columns" in found.verdict.states["in_bed"].reason
    check_what_is_said(found)


@pytest.mark.slow
def test_two_species_with_one_percent_noise_are_a_law():
    """Constants of Lotka-Volterra lie in their own intervals, and the verdict is law."""
    run = solve(
        lambda t, x: [1.37 * x[0] - 0.83 * x[0] * x[1], 0.91 * x[0] * x[1] - 2.63 * x[1]],
        [2.0, 1.0],
        np.linspace(0, 12, 200),
        ("prey", "pred"),
        0.01,
    )
    found = dynsr.discover(run, **FEW)
    truth = {
        "prey": {"prey": 1.37, "pred*prey": -0.83},
        "pred": {"pred": -2.63, "pred*prey": 0.91},
    }
    assert {s: set(coefficients(e)) for s, e in found.equations.items()} == {
        s: set(own) for s, own in truth.items()
    }
    assert found.verdict.level == "law"
    for state, constants in found.constants.items():
        for constant in constants:
            # Three standard errors: four intervals of 95 % may well miss one of four constants.
            reach = 1.5 * (constant.high - constant.low) / 2
            assert min(abs(abs(v) - abs(constant.value)) for v in truth[state].values()) < reach
    check_what_is_said(found)


@pytest.mark.slow
def test_gompertz_growth_is_found():
    """With 5 % noise the answer is V and V log V, or says what it cannot be told apart from."""
    run = solve(lambda t, v: 0.5 * v * np.log(10 / v), [0.5], np.linspace(0, 20, 100), ("V",), 0.05)
    found = dynsr.discover(run, **FEW)
    own = coefficients(found.equations["V"])
    assert set(own) == {"V", "V*log(V)"} or found.verdict.level == "approximation"
    assert own.get("V*log(V)", -0.5) == pytest.approx(-0.5, abs=0.05)
    check_what_is_said(found)


@pytest.mark.slow
def test_saturation_is_no_other_law_without_a_word():
    """Michaelis-Menten with 1 % noise: the ratio, or an approximation with formulas as good."""
    run = solve(lambda t, s: -1.2 * s / (0.8 + s), [8.0], np.linspace(0, 20, 100), ("S",), 0.01)
    found = dynsr.discover(run, **FEW)
    s = sympy.Symbol("S")
    slope = sympy.lambdify(s, found.equations["S"])
    for value in (2.0, 4.0, 6.0):
        assert slope(value) == pytest.approx(-1.2 * value / (0.8 + value), rel=0.05)
    own = found.verdict.states["S"]
    if sympy.simplify(sympy.numer(sympy.together(found.equations["S"])) / s).free_symbols:
        assert own.level == "approximation" and "cannot distinguish it" in own.reason
    check_what_is_said(found)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_another_form_is_no_law_of_a_map(noise):
    """Ricker's map and a ratio with sines that follows it closely: the first alone is a law."""
    rng, values = np.random.default_rng(0), [0.3]
    while len(values) < 200:
        chance = np.exp(noise * rng.standard_normal())
        values.append(values[-1] * np.exp(2.8 * (1 - values[-1])) * chance)
    run = Trajectory(np.arange(200.0), np.array(values)[:, None], ("x",))
    x = sympy.Symbol("x")
    ratio = (-9 * x**2 + 27.25 * x - 20 * sympy.sin(x)) / (x + 0.4)
    assert give_map_verdict({"x": ratio}, [run]).level != "law"
    assert give_map_verdict({"x": x * sympy.exp(2.8 - 2.8 * x)}, [run]).level == "law"


@pytest.mark.parametrize(
    ("name", "wanted"),
    [("q", ["--order 2"]), ("z", ["--order 2", "--explicit-time", "period 6.28"])],
)
@pytest.mark.slow
def test_one_column_that_swings_lacks_something(name, wanted):
    """The position alone of a pendulum, and sin t: order, or time, is named as the cause."""
    t = np.linspace(0, 20, 400)
    run = (
        solve(lambda t, x: [x[1], -9.81 * np.sin(x[0])], [1.0, 0.0], t, ("q", "v"))
        if name == "q"
        else Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), ("z", "v"))
    )
    alone = Trajectory(run.t, run.x[:, :1], (name,))
    found = dynsr.discover(alone, order=1, **FEW)
    assert found.verdict.level == "not found"
    for word in wanted:
        assert word in found.verdict.states[name].reason
    check_what_is_said(found)


def chaotic(rows=200):
    """Iterate x -> 3.8 x (1 - x)."""
    x = [0.3]
    while len(x) < rows:
        x.append(3.8 * x[-1] * (1 - x[-1]))
    return Trajectory(np.arange(float(rows)), np.array(x)[:, None], ("x",))


@pytest.mark.slow
def test_a_map_taken_for_a_flow_is_called_a_map():
    """A chaotic map is no state at rest with noise: the verdict names --map."""
    found = dynsr.discover(chaotic(), **FEW)
    assert found.verdict.level == "not found"
    assert "--map" in found.verdict.states["x"].reason
    assert give_verdict({"x": sympy.S.Zero}, [chaotic()]).level == "not found"


def test_noise_around_a_state_at_rest_is_still_rest():
    """White noise follows from nothing: x' = 0 stands."""
    x = 1 + 0.1 * np.random.default_rng(0).standard_normal((300, 1))
    assert (
        give_verdict({"x": sympy.S.Zero}, [Trajectory(np.linspace(0, 9, 300), x, ("x",))]).level
        == "law"
    )


def test_a_map_has_a_verdict():
    """Clean: a law; and the explanation is about x[n+1]."""
    found = dynsr.discover(chaotic(), discrete=True, **FEW)
    assert found.verdict.level == "law"
    assert [t.term for t in found.verdict.states["x"].terms] == ["x", "x**2"]
    check_what_is_said(found)
    adopted = found.with_choice("x", 0)
    assert adopted.is_map and adopted.verdict.level == "not found"


@pytest.mark.slow
def test_layers_that_hold_few_rows_are_named():
    """Van der Pol, mu = 50, over evenly spaced noisy rows: what is missing, and what to do."""
    x, y = sympy.symbols("x y")
    run = solve(
        lambda t, s: [s[1], 50 * (1 - s[0] ** 2) * s[1] - s[0]],
        [2.0, 0.0],
        np.linspace(0, 200, 500),
        ("x", "y"),
        0.001,
    )
    said = give_verdict({"x": y, "y": 50 * (1 - x**2) * y - x}, [run])
    assert said.level == "not found"
    assert "Measure the layers with more rows" in said.states["y"].reason


@pytest.mark.slow
def test_a_law_is_none_beside_an_equation_that_is_none():
    """Two states are followed together; what one gets wrong the other may make up for."""
    x, y = sympy.symbols("x y")
    run = solve(
        lambda t, s: [s[0] * (1.5 - s[0] - 0.5 * s[1]), s[1] * (1 - s[1] - 0.4 * s[0])],
        [0.1, 0.2],
        np.linspace(0, 100, 500),
        ("x", "y"),
        0.05,
    )
    root = -2.63 * x ** sympy.Rational(3, 2) + 3.17 * x - 0.572 * y
    other = -0.945 * y**2 + 1.58 * y / (x**2 + 1.83) + 0.0033 / x
    said = give_verdict({"x": root, "y": other}, [run])
    assert said.states["x"].level == said.states["y"].level == "approximation"
    right = give_verdict({"x": 1.5 * x - x**2 - 0.5 * x * y, "y": y - y**2 - 0.4 * x * y}, [run])
    assert right.level == "law"


@pytest.mark.slow
def test_exact_rows_far_apart_are_no_noise():
    """The Brusselator, eight to ten rows a turn at uneven times: the law itself, to the last digit,
    though such rows miss their neighbours as noise of a fifth of the spread does.
    """
    rows = np.random.default_rng(3).choice(100, 50, replace=False)
    t = np.linspace(0, 25, 100)[np.sort(rows)]
    run = solve(lambda _, s: _turn(*s), [1.0, 2.0], t, ("x", "y"))
    found = dynsr.discover(run, jobs=1)
    assert found.verdict.level == "law"
    assert coefficients(found.equations["x"]) == {"1": 1.1, "x": -3.9, "x**2*y": 1.0}
    assert coefficients(found.equations["y"]) == {"x": 2.9, "x**2*y": -1.0}


@pytest.mark.slow
def test_of_formulas_as_near_to_rough_slopes_the_states_choose_one():
    """A switch with a constant inflow, of which the rows hardly see the bend: the law, not
    1.082 - 2 exp(-4.8 x), which follows the rows to a millionth.
    """
    t = np.linspace(0, 24, 100)
    run = solve(lambda _, s: -0.44 * s + np.tanh(2.4 * s) + 0.082, [0.83], t, ("x",))
    rows = np.sort(np.random.default_rng(3).permutation(np.arange(2, 100))[:50])
    found = dynsr.discover(Trajectory(t[rows], run.x[rows], ("x",)), jobs=1)
    assert found.verdict.level == "law"
    assert sympy.simplify(found.equations["x"] - parse("0.082 - 0.44*x + tanh(2.4*x)")) == 0


@pytest.mark.slow
def test_sums_of_products_are_confirmed_between_distant_exact_rows():
    """Eight rows a turn, most of which is a jump that none of them sees: the law at the first look,
    though curves through such rows tell nothing of the fast state.
    """
    t = np.linspace(0, 45, 50)
    run = solve(lambda _, s: _jumps(*s), [4.0, 1.1, 4.0], t, ("x", "y", "z"))
    found = dynsr.discover(run, jobs=1)
    assert found.settings["first_look"] == ["x", "y", "z"]
    assert found.verdict.level == "law"
    assert coefficients(found.equations["x"]) == {"x": 30.0, "y": 30.0, "x*y": -30.0, "x**2": -0.9}
    assert coefficients(found.equations["y"]) == {"z": 0.24, "y": -0.2, "x*y": -0.2}
    assert coefficients(found.equations["z"]) == {"x": 0.3, "z": -0.3}


@pytest.mark.slow
def test_what_slopes_of_few_exact_rows_leave_open_the_states_decide():
    """A cyclic flow of sines of scaled columns (after Thomas 1999), twenty rows a turn: the law."""
    t = np.linspace(0, 50, 100)
    run = solve(lambda _, s: _ring(*s), [0.4, 1.2, -0.7], t, ("x", "y", "z"))
    found = dynsr.discover(run, jobs=1)
    assert found.verdict.level == "law"
    laws = {"x": "sin(1.37*y) - 0.23*x", "y": "sin(1.37*z) - 0.23*y", "z": "sin(1.37*x) - 0.23*z"}
    columns = dict(zip("xyz", np.random.default_rng(0).uniform(-2, 2, (3, 50)), strict=True))
    for state, law in laws.items():
        true = evaluate(parse(law), columns)
        assert evaluate(found.equations[state], columns) == pytest.approx(true, abs=1e-6)


def _ring(x, y, z):
    return [np.sin(1.37 * y) - 0.23 * x, np.sin(1.37 * z) - 0.23 * y, np.sin(1.37 * x) - 0.23 * z]


def _jumps(x, y, z):
    return [30 * (x + y - x * y) - 0.9 * x**2, (1.2 * z - y - x * y) / 5, 0.3 * (x - z)]


def _turn(x, y):
    return [1.1 - 3.9 * x + x**2 * y, 2.9 * x - x**2 * y]
