"""Delays: equations that contain a state as it was some time before."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr import Discovery, InputError, Trajectory, discover, load
from dynsr.discovery import delayed as delayed_search
from dynsr.discovery.delayed import _begin, _Begun, search_delayed
from dynsr.discovery.options import Options
from dynsr.expression import parse, skeleton
from dynsr.fit import (
    DelayedSystem,
    MixedMesh,
    ParetoFront,
    measure_runs,
    with_floats,
)
from dynsr.jobs import TimeUp
from dynsr.parameters.delays import Delay, Delayed, DelaySettings, follow
from dynsr.selection import ComparisonSettings
from dynsr.verdict.levels import StateVerdict, Verdict
from tests.command_line import run

X, BEFORE = sympy.symbols("x x_delayed")


def solve(slope, delay, start, end):
    """Give a function of times that solves x' = slope(x, x(t - delay)), where x was ``start``.

    The method of steps: over each delay scipy's DOP853, whose dense output is the next one's past.
    """
    pieces, x = [], [start]
    for i in range(round(np.ceil(end / delay))):
        past = pieces[-1] if pieces else lambda _: [start]
        ends = i * delay, (i + 1) * delay
        piece = solve_ivp(
            lambda t, x, past=past: [slope(x[0], past(t - delay)[0])],
            ends,
            x,
            "DOP853",
            rtol=1e-12,
            atol=1e-13,
            max_step=delay / 8,
            dense_output=True,
        )
        pieces.append(piece.sol)
        x = piece.y[:, -1]
    return lambda t: np.array([pieces[min(int(s // delay), len(pieces) - 1)](s)[0] for s in t])


@dataclass(frozen=True)
class Known:
    """A system that is known: its slope, delay, last time, equation, and true constants."""

    slope: Callable[[float, float], float]
    delay: float
    end: float
    equation: sympy.Expr
    constants: tuple[float, ...]

    def rows(self, noise=0.0, seed=0, delay=None, start=0.5, count=401):
        """Give times and states."""
        t = np.linspace(0, self.end, count)
        x = _states(self, self.delay if delay is None else delay, start, count)
        return t, x + noise * x.std() * np.random.default_rng(seed).normal(size=len(x))

    def fit(self, rows, begin=1.04):
        """Fit the delay and all constants, from a delay that is too long."""
        delayed = Delayed.of([as_run(rows)], DelaySettings())
        fit = delayed.fit({"x": self.equation}, begin * self.delay, ComparisonSettings())
        return delayed.measured(fit, ComparisonSettings())


@cache
def _states(system, delay, start, count):
    return solve(system.slope, delay, start, system.end)(np.linspace(0, system.end, count))


HUTCHINSON = Known(
    lambda x, before: 1.2 * x * (1 - before / 2), 1.6, 40, 1.21 * X - 0.59 * X * BEFORE, (0.6, 1.2)
)
GLASS = Known(
    lambda x, before: 0.2 * before / (1 + before**10) - 0.1 * x,
    17.0,
    300,
    0.21 * BEFORE / (1.01 * BEFORE**10 + 1) - 0.09 * X,
    (0.1, 0.2, 1.0),
)


def hutchinson(noise=0.0, seed=0):
    """Give the delayed logistic equation x' = 1.2 x (1 - x(t - 1.6) / 2) at 401 rows."""
    return HUTCHINSON.rows(noise, seed)


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


@pytest.mark.slow
def test_a_delay_is_fitted_with_the_other_constants():
    """From a delay 6 % off, in 1 % noise: the interval holds 1.6, and the constants are right."""
    delayed = Delayed.of([as_run(hutchinson(0.01))], DelaySettings())
    fit = delayed.fit({"x": -0.5 * X * BEFORE + 1.1 * X}, 1.7, ComparisonSettings())
    own = fit.as_delay("x")
    assert own.low < 1.6 < own.high
    assert own.error < 0.0005
    numbers = sorted(float(c) for c in fit.equations["x"].atoms(sympy.Float))
    assert numbers == pytest.approx([-0.6, 1.2], rel=0.002)


def test_the_derivatives_of_the_defects_are_those_of_small_differences():
    """By the states, also those before, by the constants, and by the delay, of two states."""
    t = np.linspace(0, 6, 41)
    run = Trajectory(t, np.column_stack([np.sin(t), np.cos(1.3 * t)]), ("x", "y"))
    rows = MixedMesh.of(measure_runs([run], {}, 500, {}), ("x", "y"))
    x, y, x_delayed, y_delayed, a, b = sympy.symbols("x y x_delayed y_delayed a b")
    equations = {"x": a * y * x_delayed, "y": -x * y_delayed - b * x_delayed**2}
    system = DelayedSystem(equations, {"x": "x_delayed", "y": "y_delayed"}, ("a", "b"))
    problem, _ = system.problem(rows, np.array([0.9, 0.4, 0.77]), 1.0)
    states, constants = np.ascontiguousarray(problem.mesh.start.T), problem.constants
    point = problem._linearise(states, constants)
    # Nothing is asked of the intervals that are history.
    history = problem.mesh.t[problem.mesh.left] < 1.0
    assert np.array_equal(np.all(point.defects == 0, axis=0), history)

    def defects(states, constants):
        return problem._defects(states, constants).ravel()

    by_states = point.by_states.toarray()
    for place in range(0, states.size, 7):
        row, state = divmod(place, 2)
        moved = states.copy()
        moved[state, row] += 1e-6
        slope = (defects(moved, constants) - defects(states, constants)) / 1e-6
        assert by_states[:, place] == pytest.approx(
            slope, rel=1e-3, abs=1e-4 * np.abs(by_states).max()
        )
    for place in range(3):
        moved = constants.copy()
        moved[place] += 1e-6
        slope = (defects(states, moved) - defects(states, constants)) / 1e-6
        own = point.by_constant[:, place].ravel()
        assert own == pytest.approx(slope, rel=1e-3, abs=1e-5 * np.abs(own).max())


@pytest.mark.slow
def test_history_that_the_law_could_explain_takes_more_bits():
    """The law on a quarter of the rows less, which are history then, is the worse explanation."""
    delayed = Delayed.of([as_run(hutchinson(0.01))], DelaySettings())
    bits = [
        delayed.fit({"x": HUTCHINSON.equation}, 1.6, ComparisonSettings(), begin).bits
        for begin in (2.0, 12.0)
    ]
    assert bits[0] < bits[1] - 50


@pytest.mark.slow
@pytest.mark.parametrize(("system", "noises"), [(HUTCHINSON, (0.01, 0.05)), (GLASS, (0.01, 0.01))])
def test_95_percent_intervals_contain_the_truth_as_often_as_they_say(system, noises):
    """Of 20 draws of noise, 90 % or more of the intervals of the delay and of each constant."""
    inside = np.zeros(1 + len(system.constants))
    for seed in range(20):
        fit = system.fit(system.rows(noises[seed % 2], seed, count=201))
        # Parameters are named without their signs.
        order = np.argsort(np.abs(fit.fit.theta[:-1]))
        values = np.append(np.abs(fit.fit.theta[:-1][order]), fit.delay)
        errors = np.sqrt(np.diag(fit.fit.covariance))[np.append(order, -1)]
        off = np.abs(values - np.array([*system.constants, system.delay]))
        inside += off < fit.fit.reach * errors
    assert np.all(inside >= 18)


@pytest.mark.slow
@pytest.mark.parametrize("system", [HUTCHINSON, GLASS])
def test_the_error_of_the_rule_is_counted_in_exact_data(system):
    """From three starts and delays: each interval contains the delay, and it is narrow."""
    rng = np.random.default_rng(0)
    for _ in range(3):
        delay = system.delay * rng.uniform(0.97, 1.03)
        own = system.fit(system.rows(delay=delay, start=rng.uniform(0.3, 0.9))).as_delay("x")
        assert own.low < delay < own.high
        assert own.error < 1e-4 * delay


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_report_draws_what_follows_from_the_history_alone(tmp_path, monkeypatch):
    """The curve of a report is that of the method of steps, which reads no row after the first."""
    from dynsr.report import discovery as reports

    curves, draw = [], reports.draw_states

    def note(run, model=None, bands=None):
        curves.append(model)
        return draw(run, model, bands)

    monkeypatch.setattr(reports, "draw_states", note)
    (own,) = Delayed.of([as_run(hutchinson(0.01))], DelaySettings()).columns(1.6, 1.6)
    delays = {"x_delayed": Delay("x", 1.6, 0.01, 1.58, 1.62)}
    # The true factors are 1.2 and 0.6.
    equations, errors = {"x": 1.1 * X - 0.6 * X * BEFORE}, {"x": ((1.1, 0.01), (-0.6, 0.01))}
    found = Discovery(equations, errors, {"x": ParetoFront()}, {}, (own,), delays=delays)
    found.report(tmp_path / "page.html")
    assert curves[0].x == pytest.approx(found.simulate().x)
    # In the rows of the data the same equations stay near them.
    assert np.std(curves[0].x - own.x) > 0.3 * np.std(own.x)


@pytest.mark.slow
def test_terms_that_make_up_for_the_error_of_a_delay_are_dropped():
    """Of the sums that a delay was fitted with, the first has the two terms of the law."""
    delayed = Delayed.of([as_run(hutchinson())], DelaySettings(minima=1))
    fits = delayed.candidates(ComparisonSettings(), [1.5])
    best = min(fits, key=lambda fit: fit.bits)
    assert set(best.equations["x"].as_coefficients_dict()) == {X, X * BEFORE}


@pytest.mark.slow
def test_a_delay_that_takes_far_more_bits_than_one_that_explains_all_is_not_searched(monkeypatch):
    """Another delay is searched too where it takes as many bits, or where neither explains all."""
    monkeypatch.setattr(Delayed, "explained", lambda *_: 1.0)
    settings = ComparisonSettings()
    delayed = Delayed.of([as_run(hutchinson(0.01))], DelaySettings())
    best = delayed.fit({"x": HUTCHINSON.equation}, 1.61, settings)
    misses = replace(settings, excess=-1.0)

    def searched(more, settings):
        other = replace(best, delay=3.2, bits=best.bits + more)
        return len(list(_begin(delayed, [best, other], {}, settings)))

    assert searched(settings.behind - 1, settings) == 2
    assert searched(settings.behind + 1, settings) == 1
    assert searched(settings.behind + 1, misses) == 2


@pytest.mark.slow
def test_hutchinsons_delay_is_found_in_exact_data(tmp_path):
    """The law, its delay, and its solution from other starts, from the data alone and saved."""
    found = discover(hutchinson(), delays=True, jobs=1)
    assert found.verdict.level == "law"
    own = found.delays["x_delayed"]
    assert own.low < 1.6 < own.high and own.high - own.low < 1e-5
    assert found.equations["x"].coeff(X * BEFORE) == pytest.approx(-0.6, rel=1e-5)
    assert "x(t - 1.6" in str(found)
    t, x = hutchinson()
    own = found.simulate()
    assert own.x[:, 0] == pytest.approx(np.interp(own.t, t, x), abs=1e-4 * x.max())
    found.save(tmp_path / "found.json")
    again = load(tmp_path / "found.json")
    assert again.delays == found.delays
    assert again.simulate([0.5], t[:100]).x[:, 0] == pytest.approx(x[:100], abs=1e-4 * x.max())


@pytest.mark.slow
def test_the_terms_of_a_law_with_a_delay_are_found_in_noise():
    """The true terms and no others, a delay whose interval holds the truth, and the verdict."""
    found = discover(hutchinson(0.05), delays=True, jobs=1, preset="quick")
    # A whole number may stand for a constant.
    assert skeleton(with_floats(found.equations["x"])) == skeleton(HUTCHINSON.equation)
    assert found.verdict.level == "law"
    own = found.delays["x_delayed"]
    assert own.low < HUTCHINSON.delay < own.high


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
    found = discover(GLASS.rows(start=0.9), delays=17.5, preset="quick", jobs=1)
    own = found.delays["x_delayed"]
    assert own.low < 17 < own.high and own.high - own.low < 1e-3
    truth = 0.2 * BEFORE / (1 + BEFORE**10) - 0.1 * X
    apart = sympy.lambdify((X, BEFORE), found.equations["x"] - truth)
    values = np.linspace(0.4, 1.3, 10)
    assert np.max(np.abs(apart(values, values[::-1]))) < 1e-4


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
    with pytest.raises(InputError, match="a trajectory of 4 rows shows no delay; leave it out"):
        Delayed.of([as_run((np.arange(4.0), np.ones(4)))], DelaySettings())
    with pytest.raises(InputError, match="a delay of nan is no time"):
        Delay("x", np.nan)
    plain = Discovery({"x": -X}, {}, {}, {})
    with pytest.raises(InputError, match="no delays; leave history out"):
        plain.simulate([1.0], [0.0, 1.0], history=np.sin)
    table = tmp_path / "x.csv"
    np.savetxt(table, np.column_stack(data), header="t,x", delimiter=",", comments="")
    assert "must be auto" in run("discover", table, "--delays", "soon", code=2).output


@pytest.mark.parametrize(("more", "first"), [(2.0, ("x",)), (20.0, ("x", "x_delayed"))])
@pytest.mark.slow
def test_a_delay_that_the_data_do_not_need_is_none(monkeypatch, more, first):
    """A sum without a delay that takes hardly more bits than one with it is searched first.

    Of an exponential decay, any delay with another rate is the same function.
    """
    fits = [SimpleNamespace(bits=bits, has_delay=late) for bits, late in ((0, True), (more, False))]
    monkeypatch.setattr(Delayed, "candidates", lambda *_: iter(fits))
    monkeypatch.setattr(Delayed, "fit", lambda *_: None)
    monkeypatch.setattr(delayed_search, "_begin", lambda own, *_: iter([_Begun(1.6, own)]))
    given = []

    def search(runs, options):
        given.append(runs[0].names)
        law = Verdict("law", "", {"x": StateVerdict("law", "", 1.0)})
        return Discovery({"x": parse("x")}, {"x": ()}, {}, {"x": ""}, verdict=law)

    search_delayed(search, [as_run(hutchinson())], Options(inputs={}), [])
    assert given[0] == first


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

    def search(runs, options):
        given.append(options.time_budget)
        clock[0] += seconds
        columns = [name for name in runs[0].names if name.endswith("_delayed")]
        expr = parse("x - x*x_delayed") if columns else parse("x")
        return Discovery({"x": expr}, {"x": ()}, {}, {"x": ""})

    monkeypatch.setattr(Delayed, "candidates", lambda *_: iter(()))
    monkeypatch.setattr(Delayed, "fit", lambda *_: None)
    monkeypatch.setattr(Delayed, "explained", lambda *_: 1.0)
    asked = Options(time_budget=12.0, inputs={})
    return given, search_delayed(search, [run], asked, [1.0, 2.0, 4.0])


@pytest.mark.slow
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

    def search(runs, options):
        given.append((runs[0].names, options.time_budget))
        return Discovery({"x": parse("x")}, {"x": ()}, {}, {"x": ""})

    monkeypatch.setattr(Delayed, "candidates", slow)
    asked = Options(time_budget=12.0, inputs={})
    found = search_delayed(search, [as_run(hutchinson())], asked, [])
    assert [names for names, _ in given] == [("x",)] and 0 < given[0][1] < 0.01
    assert found.settings["ended_by_budget"] == ["delays"]
