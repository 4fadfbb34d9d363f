"""Delays: equations that contain a state as it was some time before."""

from __future__ import annotations

import time

import numpy as np
import pytest
import sympy

from dynsr import Discovery, InputError, Trajectory, discover, load
from dynsr.discovery.delayed import search_delayed
from dynsr.discovery.delays import Delay, Delayed, DelaySettings, follow
from dynsr.expression import parse
from dynsr.fit import ParetoFront
from dynsr.jobs import TimeUp
from dynsr.selection import ComparisonSettings
from tests.command_line import run

X, BEFORE = sympy.symbols("x x_delayed")


def solve(slope, delay, start, end, step):
    """Give times and states of x' = slope(x, x(t - delay)) by Runge and Kutta's method."""
    back, count = round(delay / step), round(end / step)
    x = np.full(count + 1, start)

    def past(place):
        return start if place < 0 else x[place]

    for i in range(count):
        first, last = past(i - back), past(i + 1 - back)
        middle = (first + last) / 2
        a = slope(x[i], first)
        b = slope(x[i] + step / 2 * a, middle)
        c = slope(x[i] + step / 2 * b, middle)
        d = slope(x[i] + step * c, last)
        x[i + 1] = x[i] + step / 6 * (a + 2 * b + 2 * c + d)
    return np.linspace(0, end, count + 1), x


def hutchinson(noise=0.0, seed=0):
    """Give the delayed logistic equation x' = 1.2 x (1 - x(t - 1.6) / 2) at 401 rows."""
    t, x = solve(lambda x, before: 1.2 * x * (1 - before / 2), 1.6, 0.5, 40, 0.01)
    t, x = t[::10], x[::10]
    return t, x + noise * x.std() * np.random.default_rng(seed).normal(size=len(x))


def as_run(pair):
    """Give times and states as a trajectory."""
    return Trajectory(pair[0], pair[1][:, None], ("x",))


def test_the_method_of_steps_solves_an_equation_that_can_be_solved_by_hand():
    """x' = -x(t - 1), 1 before: 1 - t until 1, then 1 - t + (t - 1)^2 / 2."""
    t = np.linspace(0, 2, 21)
    found = follow(
        {"x": -BEFORE}, {"x_delayed": Delay("x", 1.0)}, lambda s: np.ones((1, len(s))), t, {}
    )
    truth = np.where(t <= 1, 1 - t, 1 - t + (t - 1) ** 2 / 2)
    assert found.x[:, 0] == pytest.approx(truth, abs=1e-6)


def test_a_delay_is_fitted_with_the_other_constants():
    """From a delay 6 % off, in 1 % noise: the interval holds 1.6, and the constants are right."""
    delayed = Delayed.of([as_run(hutchinson(0.01))], DelaySettings())
    fit = delayed.fit({"x": -0.5 * X * BEFORE + 1.1 * X}, 1.7, ComparisonSettings())
    own = fit.as_delay("x")
    assert own.low < 1.6 < own.high
    assert own.error < 0.005
    numbers = sorted(float(c) for c in fit.equations["x"].atoms(sympy.Float))
    assert numbers == pytest.approx([-0.6, 1.2], rel=0.01)


def test_the_same_table_is_scored_and_reported_without_a_column_of_the_delayed_state(tmp_path):
    """Scores and the report read the delayed state off the data themselves."""
    (own,) = Delayed.of([as_run(hutchinson(0.01))], DelaySettings()).columns(1.6, 1.6)
    equations = {"x": 1.2 * X - 0.6 * X * BEFORE}
    delays = {"x_delayed": Delay("x", 1.6, 0.01, 1.58, 1.62)}
    front = {"x": ParetoFront()}
    found = Discovery(equations, {"x": ()}, front, {}, (own,), delays=delays)
    scores = found.score(hutchinson(0.01))
    assert scores["x"]["trajectory_rmse"] < 0.1 * np.std(own.x)
    assert scores["x"] == pytest.approx(found.score()["x"], rel=0.05)
    page = found.report(tmp_path / "page.html").read_text("utf-8")
    assert "x_delayed" in page


def test_terms_that_make_up_for_the_error_of_a_delay_are_dropped():
    """Of the sums that a delay was fitted with, the first has the two terms of the law."""
    delayed = Delayed.of([as_run(hutchinson())], DelaySettings(minima=1))
    fits = delayed.candidates(ComparisonSettings(), [1.5])
    best = min(fits, key=lambda fit: fit.bits)
    assert set(best.equations["x"].as_coefficients_dict()) == {X, X * BEFORE}


@pytest.mark.slow
def test_hutchinsons_delay_is_found_in_exact_data(tmp_path):
    """The law, its delay, and its solution from other starts, from the data alone and saved."""
    found = discover(hutchinson(), delays=True, jobs=1)
    assert found.verdict.level == "law"
    assert found.delays["x_delayed"].value == pytest.approx(1.6, rel=1e-4)
    assert found.equations["x"].coeff(X * BEFORE) == pytest.approx(-0.6, rel=1e-3)
    assert "x(t - 1.6" in str(found)
    t, x = hutchinson()
    own = found.simulate()
    assert own.x[:, 0] == pytest.approx(np.interp(own.t, t, x), abs=1e-3 * x.max())
    found.save(tmp_path / "found.json")
    again = load(tmp_path / "found.json")
    assert again.delays == found.delays
    assert again.simulate([0.5], t[:100]).x[:, 0] == pytest.approx(x[:100], abs=2e-3 * x.max())


@pytest.mark.slow
def test_the_shell_takes_and_shows_delays(tmp_path):
    """`--delays 1.5` finds 1.6, and prints it with its interval."""
    table = tmp_path / "x.csv"
    np.savetxt(table, np.column_stack(hutchinson()), header="t,x", delimiter=",", comments="")
    said = run("discover", table, "--delays", "1.5", "-j", "1", "-o", tmp_path / "out").output
    assert "x(t - 1.6), the delay is 1.59999" in said


@pytest.mark.slow
def test_mackey_and_glass_are_found_in_exact_data():
    """x' = 0.2 x(t - 17) / (1 + x(t - 17)^10) - 0.1 x on its chaotic attractor."""
    t, x = solve(lambda x, b: 0.2 * b / (1 + b**10) - 0.1 * x, 17, 0.9, 300, 0.05)
    found = discover((t[::15], x[::15, None]), delays=17.5, preset="quick", jobs=1)
    assert found.delays["x_delayed"].value == pytest.approx(17, rel=1e-3)
    truth = 0.2 * BEFORE / (1 + BEFORE**10) - 0.1 * X
    apart = sympy.lambdify((X, BEFORE), found.equations["x"] - truth)
    values = np.linspace(0.4, 1.3, 10)
    assert np.max(np.abs(apart(values, values[::-1]))) < 1e-3


def test_what_has_no_delay_is_refused_in_one_line(tmp_path):
    """Delays that are no times, other orders, histories of equations without a delay."""
    data = hutchinson()
    with pytest.raises(
        InputError, match="a delay of -1 is not between 0 and 25% of the shortest trajectory"
    ):
        discover(data, delays=-1.0)
    with pytest.raises(InputError, match="delays go with equations of first order"):
        discover(data, delays=True, order=2)
    with pytest.raises(InputError, match="leave vary out, or search each trajectory alone"):
        discover([data, data], delays=True, vary=True)
    with pytest.raises(InputError, match="'x_delayed' is a column already"):
        Delayed.of([Trajectory(data[0], np.ones((401, 2)), ("x", "x_delayed"))], DelaySettings())
    with pytest.raises(InputError, match="a delay of nan is no time"):
        Delay("x", np.nan)
    plain = Discovery({"x": -X}, {}, {}, {})
    with pytest.raises(InputError, match="no delays; leave history out"):
        plain.simulate([1.0], [0.0, 1.0], history=np.sin)
    table = tmp_path / "x.csv"
    np.savetxt(table, np.column_stack(data), header="t,x", delimiter=",", comments="")
    assert "must be auto" in run("discover", table, "--delays", "soon", code=2).output


@pytest.fixture
def clock(monkeypatch):
    """Give a clock that only stands still or is put forward, in the place of the machine's."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def study(monkeypatch, clock, seconds):
    """Search three delays, each search of which takes some seconds; give budgets and the answer."""
    given = []
    run = as_run(hutchinson())

    def search(runs, settings):
        given.append(settings["time_budget"])
        clock[0] += seconds
        columns = [name for name in runs[0].names if name.endswith("_delayed")]
        expr = parse("x - x*x_delayed") if columns else parse("x")
        return Discovery({"x": expr}, {"x": ()}, {}, {"x": ""})

    monkeypatch.setattr(Delayed, "candidates", lambda *_: iter(()))
    monkeypatch.setattr(Delayed, "fit", lambda *_: None)
    monkeypatch.setattr(Delayed, "explained", lambda *_: 1.0)
    asked = {"time_budget": 12.0, "inputs": {}}
    return given, search_delayed(search, [run], asked, [1.0, 2.0, 4.0], {})


def test_each_search_of_a_delay_has_its_part_of_the_time_that_is_left(monkeypatch, clock):
    """Three delays share what is left, and each may be searched with twice."""
    given, found = study(monkeypatch, clock, 2.0)
    assert given == [12 / 6, 10 / 4, 8 / 2]
    assert found.delays and "ended_by_budget" not in found.settings


def test_no_delay_is_searched_when_the_time_is_over(monkeypatch, clock):
    """What is not searched is said, and a delay that nothing confirmed has no verdict."""
    given, found = study(monkeypatch, clock, 12.5)
    assert given == [12 / 6]
    assert found.delays and not found.verdict.tested
    assert found.settings["ended_by_budget"] == ["delays"]


def test_a_scan_that_takes_too_long_leaves_a_search_without_delays(monkeypatch, clock):
    """The scan ends by its part of the time, and the rest is for the equations."""
    given = []

    def slow(*_):
        clock[0] += 100.0
        raise TimeUp
        yield

    def search(runs, settings):
        given.append((runs[0].names, settings["time_budget"]))
        return Discovery({"x": parse("x")}, {"x": ()}, {}, {"x": ""})

    monkeypatch.setattr(Delayed, "candidates", slow)
    asked = {"time_budget": 12.0, "inputs": {}}
    found = search_delayed(search, [as_run(hutchinson())], asked, [], {})
    assert [names for names, _ in given] == [("x",)] and 0 < given[0][1] < 0.01
    assert found.settings["ended_by_budget"] == ["delays"]
