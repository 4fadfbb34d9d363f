"""Constants that differ from run to run: which do, their values, and what they follow."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.optimize import curve_fit

from dynsr import Discovery, InputError, Trajectory, discover, load
from dynsr.jobs import FolderTaken
from dynsr.parameters import RunParameters
from dynsr.verdict.flow_verdict import give_verdict
from tests.command_line import run

X = sympy.Symbol("x")
T = np.linspace(0, 10, 40)
RATES = (0.5, 0.8, 1.2)


def logistic(rate: float, most: float, x0: float) -> np.ndarray:
    """Give the closed form of x' = rate x (1 - x / most)."""
    return most / (1 + (most / x0 - 1) * np.exp(-rate * T))


def as_runs(curves: list[np.ndarray], noise: float = 0.0, seed: int = 0) -> tuple[Trajectory, ...]:
    """Give runs of one state with noise as a share of the spread."""
    rng = np.random.default_rng(seed)
    return tuple(
        Trajectory(T, (x + noise * x.std() * rng.normal(size=len(T)))[:, None], ("x",))
        for x in curves
    )


def grown(noise: float, seed: int = 0) -> Discovery:
    """Give a logistic law whose rate differs, of equations with middling constants."""
    curves = [logistic(rate, 2.0, 0.1 * (1 + i)) for i, rate in enumerate(RATES)]
    return known({"x": 0.7 * X - 0.35 * X**2}, as_runs(curves, noise, seed))


def known(equations: dict[str, sympy.Expr], runs: tuple[Trajectory, ...]) -> Discovery:
    """Give equations as if they were found on runs."""
    return Discovery(equations, {}, {}, {}, runs)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_a_capacity_that_runs_share_is_found_where_their_rates_differ(noise):
    """Both coefficients of a logistic law differ, and one is half the other: one differs."""
    found = grown(noise).vary()
    ((name, own),) = found.by_run.constants.items()
    (follows,) = found.by_run.follows.values()
    factor = sympy.sympify(follows).coeff(sympy.Symbol(name))
    assert float(factor) == pytest.approx(2.0, rel=max(noise, 1e-4))
    tolerance = max(noise, 1e-4)
    assert [p.value for p in own] == pytest.approx([r / 2 for r in RATES], rel=tolerance)
    assert found.verdict.level == "law"


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_what_runs_share_is_shared(noise):
    """Decays of one rate to levels of their own: the rate is one constant, the source is not."""
    curves = [c + (3 - c) * np.exp(-0.6 * T) for c in (0.5, 1.0, 2.0)]
    found = known({"x": 0.5 - 0.5 * X}, as_runs(curves, noise)).vary()
    ((name, own),) = found.by_run.constants.items()
    assert found.equations["x"].coeff(sympy.Symbol(name)) == 1
    error = max(noise, 1e-4)
    assert [p.value for p in own] == pytest.approx([0.3, 0.6, 1.2], abs=error)
    rate = next(p for p in found.parameters.values() if p.of == "x")
    assert rate.value == pytest.approx(0.6, abs=error)
    assert rate.low < 0.6 < rate.high


def test_runs_of_one_law_have_one_set_of_constants():
    """Where nothing differs, the discovery stays as it was."""
    found = known({"x": -0.5 * X}, as_runs([a * np.exp(-0.6 * T) for a in (1.0, 2.0)], 0.01))
    assert found.vary() is found
    assert not found.by_run.constants


def test_constants_by_hand_are_those_of_a_fit_to_each_run():
    """A decay with a rate for each run is scipy's fit of an exponential to each run alone."""
    runs = as_runs([3 * np.exp(-k * T) for k in (0.3, 0.6)], 0.02)
    found = known({"x": -0.5 * X}, runs).vary("k1")
    for own, each in zip(found.by_run["k1"], runs, strict=True):
        (_, rate), spread = curve_fit(lambda t, a, k: a * np.exp(-k * t), T, each.x[:, 0], [3, 0.5])
        assert own.value == pytest.approx(rate, abs=0.1 * np.sqrt(spread[1, 1]))
        assert own.error == pytest.approx(np.sqrt(spread[1, 1]), rel=0.35)


@pytest.mark.slow
def test_parameters_by_hand_differ_and_all_others_are_shared():
    """Only the parameter that was named has a value for each run."""
    found = grown(0.01)
    name = next(n for n, p in found.parameters.items() if p.of == "x")
    varied = found.vary([name])
    assert list(varied.by_run) == [name]
    assert len(varied.parameters.rows()) == 1


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.slow
def test_a_rate_that_follows_a_temperature_is_said_as_arrhenius(noise):
    """Five runs at their temperatures: k = A exp(-E/T), with the E that was put in."""
    warm = np.array([280.0, 295.0, 310.0, 325.0, 340.0])
    rates = 0.2 * np.exp(-2000 / warm + 2000 / 280)
    runs = [
        run.with_inputs({"temperature": degrees})
        for run, degrees in zip(
            as_runs([3 * np.exp(-k * T) for k in rates], noise), warm, strict=True
        )
    ]
    found = known({"x": -0.5 * X}, tuple(runs)).vary()
    assert not found.by_run.constants
    (text,) = found.by_run.follows.values()
    temperature = sympy.Symbol("temperature")
    follows = sympy.sympify(text)
    own = [float(follows.subs(temperature, degrees)) for degrees in warm]
    assert own == pytest.approx(rates.tolist(), rel=max(2 * noise, 1e-4))
    if noise == 0:
        (power,) = (f.args[0] for f in follows.atoms(sympy.exp))
        assert float(power * temperature) == pytest.approx(-2000, rel=0.01)


@pytest.mark.slow
def test_a_constant_in_proportion_to_a_known_number_is_found_as_such():
    """Rates in proportion to a dose of each run: the law holds the dose, and no rate differs."""
    doses = (1.0, 2.0, 3.0, 5.0)
    runs = as_runs([3 * np.exp(-0.1 * d * T) for d in doses], 0.02)
    each = [one.with_inputs({"dose": d}) for one, d in zip(runs, doses, strict=True)]
    found = known({"x": -0.5 * X}, tuple(each)).vary()
    coefficient = found.equations["x"].coeff(X * sympy.Symbol("dose"))
    assert float(coefficient) == pytest.approx(-0.1, rel=0.02)
    assert "differs too: it is 0.1" in found.explanation["x"].replace("0.09", "0.1")


@pytest.mark.slow
def test_a_constant_differs_with_a_label_of_the_runs():
    """Four runs of two strains: one rate for each strain, and the sentence names the label."""
    rates = (0.3, 0.3, 0.7, 0.7)
    runs = as_runs([a * np.exp(-k * T) for a, k in zip((1, 2, 1, 3), rates, strict=True)], 0.02)
    named = [
        Trajectory(T, own.x, ("x",), origin={"name": f"{s}{i}", "labels": {"strain": s}})
        for i, (own, s) in enumerate(zip(runs, "aabb", strict=True))
    ]
    found = known({"x": -0.5 * X}, tuple(named)).vary()
    (own,) = found.by_run.constants.values()
    assert [p.value for p in own] == pytest.approx(rates, rel=0.03)
    assert own[0] == own[1] and own[2] == own[3]
    assert "differs with strain" in found.explanation["x"]
    assert found.by_run.to_frame().loc["b3", "strain"] == "b"


@pytest.mark.slow
def test_intervals_by_run_hold_the_truth_in_90_to_98_percent():
    """Over 20 draws of three runs, at 1 % and 5 % in turn, each with two constants of its own."""
    inside: list[bool] = []
    for seed in range(20):
        found = grown((0.01, 0.05)[seed % 2], seed)
        names = {p.of: n for n, p in found.parameters.items()}
        varied = found.vary(list(names.values()))
        for of, scale in (("x", 1.0), ("x**2", 0.5)):
            pairs = zip(varied.by_run[names[of]], RATES, strict=True)
            inside += [p.low <= scale * rate <= p.high for p, rate in pairs]
    assert 0.90 <= np.mean(inside) <= 0.98


@pytest.mark.slow
def test_a_law_whose_constants_differ_is_found_where_one_set_fits_no_run():
    """Predators and prey whose growth differs: the search finds the law of all runs."""
    from scipy.integrate import solve_ivp

    rng, t, runs = np.random.default_rng(3), np.linspace(0, 12, 80), []
    for i, k in enumerate((0.5, 0.8, 1.2)):
        x = solve_ivp(
            lambda _, s, k=k: [k * s[0] - 0.2 * s[0] * s[1], 0.1 * s[0] * s[1] - 0.3 * s[1]],
            (0, 12),
            [5, 2 + i],
            t_eval=t,
            rtol=1e-9,
        ).y.T
        runs.append(Trajectory(t, x + 0.02 * x.std(0) * rng.normal(size=x.shape), ("x", "y")))
    found = discover(runs, vary=True, jobs=1)
    (own,) = found.by_run.constants.values()
    assert [abs(p.value) for p in own] == pytest.approx([0.5, 0.8, 1.2], rel=0.02)
    assert found.verdict.level == "law"
    assert found.settings["vary"] is True


@pytest.mark.slow
def test_known_equations_are_fitted_to_each_run_before_anything_is_searched():
    """Their numbers cannot be right in each run: structures that are a law need no search."""
    curves = [logistic(k, 2.0, 0.1) for k in (0.4, 0.6, 0.9)]
    asked = {"vary": True, "known": {"x": "0.5*x - 0.3*x**2"}, "jobs": 1}
    found = discover(list(as_runs(curves, 0.01)), **asked)
    assert found.settings["methods"] == ["known"]
    assert found.verdict.level == "law"
    (own,) = found.by_run.constants.values()
    assert [p.value for p in own] == pytest.approx([0.2, 0.3, 0.45], rel=0.02)


@pytest.mark.slow
def test_a_law_without_constants_has_none_that_differs():
    """x' = x of two runs: nothing is left to fit, in any of them."""
    t = np.linspace(0, 5, 40)
    runs = [Trajectory(t, a * np.exp(t)[:, None], ("x",)) for a in (1.0, 2.0)]
    found = discover(runs, vary=True, jobs=1, preset="quick", method="sindy")
    assert found.equations == {"x": X} and not found.by_run.constants


@pytest.mark.slow
def test_runs_without_a_constant_that_differs_are_kept_in_one_folder(tmp_path):
    """Each search has a folder in it, and the law of all runs is the result of the folder."""
    runs = list(as_runs([logistic(0.5, 2.0, start) for start in (0.1, 0.2)], 0.01))
    asked = {"vary": True, "jobs": 1, "preset": "quick", "out": tmp_path / "out"}
    found = discover(runs, **asked)
    assert found.verdict.level == "law" and not found.by_run.constants
    assert load(tmp_path / "out").equations == found.equations
    assert {"run-1", "run-2", "together"} <= {own.name for own in (tmp_path / "out").iterdir()}
    assert discover(runs, **asked).equations == found.equations
    with pytest.raises(FolderTaken, match="other options"):
        discover(runs, **asked, seed=1)


@pytest.mark.slow
def test_cultures_of_two_treatments_are_told_by_the_shell(tmp_path):
    """A table with labels: `--vary all` prints a table of the constant that differs with them."""
    rng, rows = np.random.default_rng(0), []
    for treatment, most in (("warm", 9.0), ("cold", 4.0)):
        for replicate in (1, 2):
            x = logistic(0.6, most, 0.2)
            x = x + 0.05 * rng.normal(size=len(T))
            rows += [(treatment, replicate, *pair) for pair in zip(T, x, strict=True)]
    table = pd.DataFrame(rows, columns=["treatment", "replicate", "hours", "density"])
    table.to_csv(tmp_path / "data.csv", index=False)
    answer = run("discover", tmp_path / "data.csv", "--vary", "all", "--json", "-j", "1")
    by_run = json.loads(answer.stdout)["by_run"]
    assert by_run["labels"]["treatment"] == ["warm", "warm", "cold", "cold"]
    assert list(by_run["by"].values()) == ["treatment"]


@pytest.mark.slow
def test_constants_of_second_order_differ_too():
    """Springs of their own and one damping, from positions alone."""
    t, runs = np.linspace(0, 10, 120), []
    rng = np.random.default_rng(5)
    for stiffness in (1.0, 2.0, 3.0):
        own = np.sqrt(stiffness - 0.01)
        x = np.exp(-0.1 * t) * (np.cos(own * t) + 0.1 / own * np.sin(own * t))
        runs.append(Trajectory(t, (x + 0.005 * rng.normal(size=120))[:, None], ("x",)))
    v = sympy.Symbol("x_dot")
    equations = {"x": v, "x_dot": -1.8 * X - 0.2 * v}
    settings = {"velocities": {"x": "x_dot"}}
    found = Discovery(equations, {}, {}, {}, tuple(runs), settings=settings).vary()
    (own,) = found.by_run.constants.values()
    assert [p.value for p in own] == pytest.approx([1.0, 2.0, 3.0], rel=0.01)
    damping = next(p for p in found.parameters.values() if p.of == "x_dot")
    assert damping.value == pytest.approx(0.2, abs=0.01)


@pytest.mark.slow
def test_equations_of_one_run_have_its_numbers():
    """`for_run` puts the numbers of a run, with their intervals, into the equations."""
    found = grown(0.01).vary()
    one = found.for_run("2")
    ((name, own),) = found.by_run.constants.items()
    assert not one.by_run.constants
    assert any(p.value == pytest.approx(own[1].value) for p in one.parameters.values())
    assert one.simulate().x[-1, 0] == pytest.approx(found.trajectories[1].x[-1, 0], rel=0.05)
    assert name not in one.system.inputs
    assert not one.front["x"]


def test_a_discovery_whose_constants_differ_is_saved_and_read(tmp_path):
    """The table by run is in the file, and the equations take a number in its place."""
    found = grown(0.01).vary()
    found.save(tmp_path / "found.json")
    again = load(tmp_path / "found.json")
    assert again.by_run == found.by_run
    (name,) = again.by_run
    end = again.simulate([0.1], [0.0, 20.0], inputs={name: 0.4}).x[-1, 0]
    assert end == pytest.approx(2.0, rel=0.01)


@pytest.mark.slow
def test_runs_of_the_same_names_are_scored_with_their_own_constants():
    """The same runs without the column of the parameter: each gets its own; others are refused."""
    found = grown(0.01).vary()
    plain = [Trajectory(run.t, run.x, run.states) for run in found.trajectories]
    assert found.score(plain) == found.score()
    with pytest.raises(InputError, match="these runs are others"):
        found.score(plain[:1])


@pytest.mark.slow
def test_a_report_shows_the_table_by_run(tmp_path):
    """The page has the parameter of each run, and says that it differs."""
    found = grown(0.02).vary()
    page = found.report(tmp_path / "page.html").read_text("utf-8")
    (name,) = found.by_run
    assert "Parameters that differ from run to run" in page
    assert f"{found.by_run[name][2].value:.6g}" in page


@pytest.mark.slow
def test_what_cannot_differ_is_refused_in_one_line():
    """One run, an unknown parameter, a short run, a map, and profiles of what differs."""
    runs = as_runs([np.exp(-0.5 * T), np.exp(-0.9 * T)], 0.01)
    found = known({"x": -0.5 * X}, runs)
    with pytest.raises(InputError, match="one trajectory has one set"):
        known({"x": -0.5 * X}, runs[:1]).vary()
    with pytest.raises(InputError, match=r"'k7' cannot differ; give parameters \(k1\)"):
        found.vary(["k7"])
    with pytest.raises(InputError, match="of 3 rows determines no constants of its own"):
        known({"x": -0.5 * X}, (runs[0], runs[1].select(slice(0, 3)))).vary()
    with pytest.raises(InputError, match="there is one; give several"):
        discover(runs[0], vary=True)
    with pytest.raises(InputError, match=r"vary names 'k1', .*ask them: found.vary\(\['k1'\]\)"):
        discover(runs, vary="k1")
    with pytest.raises(InputError, match="a map has no joint fit"):
        discover(runs, vary=True, discrete=True)
    varied = found.vary()
    with pytest.raises(InputError, match="ask for_run"):
        varied.profile("k1")
    with pytest.raises(InputError, match="differ already"):
        varied.vary()
    with pytest.raises(InputError, match="'nobody' is no run; the runs, counted from 0, are: 1, 2"):
        varied.for_run("nobody")
    with pytest.raises(InputError, match="'k1' has 1 values for 2 runs"):
        RunParameters(("a", "b"), {"k1": varied.by_run["k1"][:1]})


@pytest.mark.slow
def test_a_constant_of_two_runs_keeps_no_relation_of_columns():
    """An epidemic whose infection rate differs: that this takes two values says nothing of the law.

    The same values given as a measured input leave it open how the rate depends on them.
    """
    t, runs = np.arange(0, 40, 0.5), []
    for rate in (0.5, 0.8):

        def slope(_: float, x: np.ndarray, rate: float = rate) -> list[float]:
            caught = rate * x[0] * x[1]
            return [-caught, caught - 0.15 * x[1], 0.15 * x[1]]

        solved = solve_ivp(slope, (0, 40), [0.99, 0.01, 0], t_eval=t, rtol=1e-10, atol=1e-12)
        runs.append(Trajectory(t, solved.y.T, ("S", "I", "R")))
    infected, free = sympy.symbols("I S")
    caught = 0.6 * infected * free
    law = {"S": -caught, "I": caught - 0.15 * infected, "R": 0.15 * infected}
    found = known(law, tuple(runs)).vary(["k1"])
    assert found.verdict.level == "law"
    assert [p.value for p in found.by_run["k1"]] == pytest.approx([0.5, 0.8], rel=1e-5)
    given = give_verdict(found.equations, found.trajectories)
    assert "a run from another start decides" in given.states["S"].reason
