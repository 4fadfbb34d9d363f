"""Maps x[n+1] = f(x[n]) are found from row to row, iterated, scored and written out."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import sympy
from command_line import run

import dynsr
from dynsr.data import Trajectory, odd_times, read_trajectories
from dynsr.errors import EngineError, InputError
from dynsr.methods import RationalSearch
from dynsr.verdict.maps import iterate, measure_step_errors, pair_rows, score_map

FEW = RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1)


def logistic(rows=200, noise=0.0, seed=0):
    """Iterate x -> 3.7 x (1 - x), with noise of the motion itself that stays inside (0, 1)."""
    rng, x = np.random.default_rng(seed), [0.3]
    while len(x) < rows:
        following = 3.7 * x[-1] * (1 - x[-1]) + noise * rng.normal()
        if 0 < following < 1:
            x.append(following)
    return Trajectory(np.arange(float(rows)), np.array(x)[:, None], ("x",))


def henon(rows=200, noise=0.0):
    """Iterate the map of Henon (1976), a = 1.4 and b = 0.3."""
    rng, x = np.random.default_rng(0), [np.array([0.1, 0.1])]
    while len(x) < rows:
        u, v = x[-1]
        x.append(np.array([1 - 1.4 * u**2 + v, 0.3 * u]) + noise * rng.normal(size=2))
    return Trajectory(np.arange(float(rows)), np.array(x), ("x", "y"))


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_the_logistic_map_is_found(noise):
    """Clean and with process noise of 1 % of the spread: 3.7 x - 3.7 x^2."""
    found = dynsr.discover(logistic(noise=noise), discrete=True, jobs=1, method=FEW)
    x = sympy.Symbol("x")
    assert sympy.expand(found.equations["x"] - 3.7 * x + 3.7 * x**2).subs(x, 0.3) == pytest.approx(
        0, abs=1e-9
    )
    assert str(found).splitlines()[1] == "x[n+1] = -3.7*x**2 + 3.7*x"
    score = found.score()["x"]
    assert score["step_rmse"] <= 1.2 * noise + 1e-12
    assert found.settings["kind"] == "map" and found.is_map


@pytest.mark.parametrize("noise", [0.0, 0.007])
def test_the_map_of_henon_is_found(noise):
    """Both equations, clean and with process noise of 1 % of the spread."""
    three = replace(FEW, max_terms=3)
    found = dynsr.discover(henon(noise=noise), discrete=True, jobs=1, method=three)
    x, y = sympy.symbols("x y")
    truth = {"x": 1 - 1.4 * x**2 + y, "y": 0.3 * x}
    for state, expr in truth.items():
        miss = sympy.expand(found.equations[state] - expr)
        assert abs(float(miss.subs({x: 0.7, y: 0.2}))) < 3 * noise + 1e-9
        assert {str(s) for s in found.equations[state].free_symbols} == {
            str(s) for s in expr.free_symbols
        }


@pytest.mark.slow
def test_a_map_is_simulated_by_iteration_and_exported_as_a_step(tmp_path):
    """simulate, to_python, to_numpy and LaTeX give the next state; the file says so."""
    data = logistic(50)
    found = dynsr.discover(data, discrete=True, jobs=1, method=FEW)
    made = found.simulate([0.4], np.arange(4.0))
    x = 0.4
    for value in made.x[:, 0]:
        assert value == pytest.approx(x, rel=1e-9)
        x = 3.7 * x * (1 - x)
    scope = {}
    exec(compile(found.to_python(), "step", "exec"), scope)
    assert scope["step"](0.0, [0.4])[0] == pytest.approx(3.7 * 0.24)
    assert found.to_numpy()(0.0, np.array([0.4]))[0] == pytest.approx(3.7 * 0.24)
    assert "function step!(du, u, p, t)" in found.to_julia()
    assert "{x}_{n+1} &=" in found.latex() and "dot" not in found.latex()
    again = type(found).load(found.save(tmp_path / "map.json"))
    assert again.is_map and str(again) == str(found)
    assert np.array_equal(again.simulate([0.4], np.arange(4.0)).x, made.x)
    page = found.report(tmp_path / "map.html").read_text()
    assert "x[n+1] = " in page and "--map" in page and "next values" in page


def test_what_needs_slopes_refuses_a_map():
    """Ensembles and hybrid models say in one line that a map has no slopes."""
    found = dynsr.discover(logistic(50), discrete=True, jobs=1, method=FEW)
    with pytest.raises(InputError, match="a map has none"):
        dynsr.bootstrap(found)
    with pytest.raises(InputError, match="a map has none"):
        found.hybrid()
    with pytest.raises(InputError, match="a map goes from row to row"):
        dynsr.discover(logistic(50), discrete=True, order=2)


def test_rows_are_paired_where_one_usual_step_lies_between():
    """A gap in the times pairs nothing across it; times all uneven are refused."""
    t = np.array([0.0, 1, 2, 3, 7, 8, 9])
    gap = Trajectory(t, np.arange(7.0)[:, None], ("x",))
    assert pair_rows([gap], "x").y.tolist() == [1, 2, 3, 5, 6]
    assert pair_rows([gap, gap], "x").X[:, 0].tolist() == [0, 1, 2, 4, 5] * 2
    uneven = Trajectory(np.cumsum(np.arange(1.0, 9)), np.arange(8.0)[:, None], ("x",))
    with pytest.raises(InputError, match="one row a step"):
        pair_rows([uneven], "x")


@pytest.mark.parametrize("frequency", ["MS", "ME", "QS", "YS", "6MS"])
def test_months_and_years_are_one_step_each(frequency):
    """A map has a pair for each month though months differ in days, and none for a missing one."""
    dates = pd.date_range("2001-01-31", periods=50, freq=frequency).delete(20)
    frame = pd.DataFrame({"date": dates, "x": np.sin(np.arange(49.0) ** 2)})
    (run,) = read_trajectories(frame).trajectories
    assert len(pair_rows([run], "x").y) == 47
    assert not any(odd.kind == "uneven" for odd in odd_times(run.t[:20], unit=run.time_unit))


def test_standard_errors_are_the_spread_over_draws():
    """The stated error of the growth rate is its deviation over draws of process noise."""
    x = sympy.Symbol("x")
    expr = sympy.Float(3.7) * x - sympy.Float(3.7) * x**2
    drawn, stated = [], []
    for seed in range(60):
        pairs, fitted = measure_step_errors(expr, pair_rows([logistic(200, 0.005, seed)], "x"))
        drawn.append(fitted[0])
        stated.append(pairs[0][1])
    assert np.mean(stated) == pytest.approx(np.std(drawn), rel=0.35)
    assert abs(abs(np.mean(drawn)) - 3.7) < 0.005


def test_a_map_that_diverges_ends_in_words():
    """Iteration stops with the step at which no number is left; its score is inf."""
    square = {"x": sympy.Symbol("x") ** 2}
    with pytest.raises(EngineError, match="after step"):
        iterate(square, [10.0], np.arange(30.0))
    grown = Trajectory(np.arange(30.0), np.full((30, 1), 2.0) + np.eye(30, 1), ("x",))
    assert score_map(square, [grown])["x"]["trajectory_rmse"] == np.inf


def test_inputs_of_a_map_are_values_or_expressions():
    """A driven map reads its input at every row; a missing one is named."""
    driven = {"x": sympy.Symbol("x") / 2 + sympy.Symbol("F")}
    times = np.arange(4.0)
    by_values = iterate(driven, [0.0], times, {"F": times**2})
    by_formula = iterate(driven, [0.0], times, {"F": "t**2"})
    assert by_values.x.ravel().tolist() == by_formula.x.ravel().tolist() == [0, 0, 1, 4.5]
    with pytest.raises(InputError, match="'F'"):
        iterate(driven, [0.0], times)


@pytest.mark.slow
def test_the_command_finds_and_iterates_a_map(tmp_path):
    """--map prints x[n+1], --json says "map", and simulate iterates what was saved."""
    dynsr.data.write_csv(logistic(100), tmp_path / "m.csv")
    words = ("discover", tmp_path / "m.csv", "--preset", "quick", "--method", "sindy", "-j", "1")
    words = (*words, "--functions", "none")
    done = run(*words, "--map", "--json", "--out", tmp_path / "out")
    told = json.loads(done.stdout)
    assert told["kind"] == "map" and told["text"][0].startswith("x[n+1] = ")
    assert told["scores"]["data"]["x"]["step_rmse"] < 1e-9
    made = run("simulate", tmp_path / "out" / "discovery.json", "--x0", "0.4", "--span", "0,3")
    lines = made.stdout.splitlines()
    assert len(lines) == 5 and float(lines[2].split(",")[1]) == pytest.approx(3.7 * 0.24)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_a_map_of_ricker_is_found_in_noise(noise):
    """Methods for sums of powers do not try N exp(-b N); a first look does, as for flows."""
    rng, counts = np.random.default_rng(1), [0.7]
    for _ in range(79):
        counts.append(counts[-1] * np.exp(2.3 * (1 - counts[-1] / 4)))
    seen = np.array(counts) * np.exp(noise * rng.normal(size=80))
    data = {"year": np.arange(80.0), "N": seen}
    found = dynsr.discover(data, discrete=True, preset="quick", snap=False, jobs=1)
    N = sympy.Symbol("N")
    match = found.equations["N"].match(sympy.Wild("a") * N * sympy.exp(-sympy.Wild("b") * N))
    assert match is not None and N not in sympy.Add(*match.values()).free_symbols
    size, rate = (float(match[sympy.Wild(name)]) for name in ("a", "b"))
    assert size == pytest.approx(np.exp(2.3), rel=0.05) and rate == pytest.approx(0.575, rel=0.05)
