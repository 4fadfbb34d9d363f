"""Delays of inputs: equations that contain an input as it was some time before."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr import Discovery, InputError, Trajectory, discover, load
from dynsr.expression import skeleton
from dynsr.fit import (
    DelayedSystem,
    MixedMesh,
    ParetoFront,
    drives_of,
    measure_runs,
)
from dynsr.parameters.delays import Delay, Delayed, DelaySettings
from dynsr.selection import ComparisonSettings
from tests.command_line import run as call

Y, U, BEFORE = sympy.symbols("y u u_delayed")
END, ROWS = 40.0, 201


@dataclass(frozen=True)
class Known:
    """A system that is known: its slope in y and u(t - delay), delay, equation, and constants."""

    slope: Callable[[float, float], float]
    delay: float
    equation: sympy.Expr
    constants: tuple[float, ...]

    def run(self, held, noise=0.0, seed=0, delay=None):
        """Give 201 rows of y and u, which is held for a while again and again, or smooth."""
        t = np.linspace(0, END, ROWS)
        y = _solution(self, held, self.delay if delay is None else delay)
        y = y + noise * y.std() * np.random.default_rng(seed).normal(size=len(y))
        u = _steps(t) if held else _waves(t)
        return Trajectory(t, y[:, None], ("y",), u[:, None], ("u",))

    def fit(self, runs):
        """Fit the delay and all constants, from a delay that is too long."""
        delayed = Delayed.of(runs, DelaySettings())
        fit = delayed.fit({"y": self.equation}, 1.04 * self.delay, ComparisonSettings())
        return delayed.measured(fit, ComparisonSettings())


PIPE = Known(lambda y, u: (u - y) / 0.8, 1.7, 1.2 * BEFORE - 1.3 * Y, (1.25, 1.25))
HEATER = Known(
    lambda y, u: 2.0 * u - 0.5 * y - 0.1 * y**2,
    1.3,
    2.1 * BEFORE - 0.45 * Y - 0.11 * Y**2,
    (0.1, 0.5, 2.0),
)


def _changes():
    """Give the rows, of which most are no neighbours, at which an input steps, and its values."""
    rng = np.random.default_rng(3)
    rows = np.sort(rng.choice(np.arange(2, ROWS - 1, 2), 19, replace=False))
    return np.append(0, rows), rng.uniform(0.2, 1.5, 20)


def _steps(t):
    rows, values = _changes()
    return values[np.searchsorted(END / (ROWS - 1) * rows, t + 1e-9, side="right") - 1]


def _waves(t):
    return 1 + 0.4 * np.sin(0.7 * t) + 0.25 * np.sin(1.9 * t + 1)


@cache
def _solution(system, held, delay):
    """Give y at all rows by scipy's DOP853, which begins again wherever the input jumps."""
    rows, values = _changes()
    jumps = END / (ROWS - 1) * rows[1:] + delay
    ends = np.array([0.0, *(jumps[jumps < END] if held else [delay] * (delay > 0)), END])
    t, y, found = np.linspace(0, END, ROWS), [0.3], []
    for number, (begin, end) in enumerate(pairwise(ends)):

        def slope(s, y, number=number):
            u = values[number] if held else _waves(max(s - delay, 0.0))
            return [system.slope(y[0], u)]

        piece = solve_ivp(
            slope, (begin, end), y, "DOP853", rtol=1e-12, atol=1e-13, dense_output=True
        )
        y = piece.y[:, -1]
        found.append(piece.sol(t[(t >= begin) & ((t < end) | (end == END))])[0])
    return np.concatenate(found)


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["previous", "linear", "smooth"])
@pytest.mark.parametrize("state_too", [False, True])
def test_the_derivatives_of_the_defects_are_those_of_small_differences(hold, state_too):
    """By the states, the constants and the delay, in two runs whose input changes at every row."""
    t = np.linspace(0, 6, 61)
    x = np.column_stack([np.sin(t), np.cos(1.3 * t)])
    u = np.random.default_rng(1).normal(size=(61, 1))
    run = Trajectory(t, x, ("x", "y"), u, ("u",), hold={"u": hold})
    runs = [run, run.select(slice(40))]
    rows = MixedMesh.of(measure_runs(runs, {}, 500, {}), ("x", "y"))
    x, y, before, a, b = sympy.symbols("x y x_delayed a b")
    equations = {
        "x": a * y * (before if state_too else 1) + BEFORE * x,
        "y": -x * BEFORE**2 - b * sympy.exp(-BEFORE) * y + 0.1 * U,
    }
    names = {"x": "x_delayed"} if state_too else {}
    inputs = drives_of(("u",), runs, {})
    system = DelayedSystem(equations, {**names, "u": "u_delayed"}, ("a", "b"), inputs)
    problem, _ = system.problem(rows, np.array([0.9, 0.4, 0.77]), 1.0)
    states, constants = np.ascontiguousarray(problem.mesh.start.T), problem.constants
    point = problem._linearise(states, constants)
    by_states = point.by_states.toarray()

    def differences(move):
        sides = [problem._defects(*move(step)).ravel() for step in (1e-6, -1e-6)]
        return (sides[0] - sides[1]) / 2e-6

    for place in range(0, states.size, 29):
        row, state = divmod(place, 2)
        one = np.zeros_like(states)
        one[state, row] = 1.0
        slope = differences(lambda step, one=one: (states + step * one, constants))
        assert by_states[:, place] == pytest.approx(slope, abs=1e-7 * np.abs(by_states).max())
    for one, own in zip(np.eye(3), point.by_constant.swapaxes(0, 1), strict=True):
        slope = differences(lambda step, one=one: (states, constants + step * one))
        assert own.ravel() == pytest.approx(slope, abs=1e-5 * np.abs(own).max())


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("system", [PIPE, HEATER])
@pytest.mark.slow
def test_the_error_of_the_rule_is_counted_in_exact_data(system, held):
    """The interval contains a delay between rows, and it is narrow."""
    fit = system.fit([system.run(held)])
    own = fit.as_delay("u")
    assert own.low < system.delay < own.high
    assert own.error < 1e-4
    numbers = sorted(abs(float(c)) for c in fit.equations["y"].atoms(sympy.Float))
    assert numbers == pytest.approx(system.constants, rel=1e-4)


@pytest.mark.slow
def test_constants_that_come_to_one_value_leave_the_error_of_the_delay():
    """In exact data of a pipe both constants become 1.25, and are one from then on."""
    rng, t = np.random.default_rng(3), np.linspace(0, 20, 101)
    when = np.append(0, np.sort(rng.choice(t[1:-1], 9, replace=False)))
    change, since = rng.normal(size=10), t[:, None] - when
    y = (1 - np.exp(-np.maximum(since - 1, 0) / 0.8)) @ change
    u = (since >= 0) @ change
    run = Trajectory(t, y[:, None], ("y",), u[:, None], ("u",), hold={"u": "previous"})
    delayed = Delayed.of([run], DelaySettings())
    fit = delayed.fit({"y": 1.25 * BEFORE - 1.24 * Y}, 1.02, ComparisonSettings())
    fine = delayed.measured(fit, ComparisonSettings())
    assert (len(fit.fit.theta), len(fine.fit.theta)) == (3, 2)
    own = fine.as_delay("u")
    assert own.low < 1 < own.high
    assert own.error < 1e-4


@pytest.mark.parametrize(
    ("system", "held", "noise"), [(PIPE, False, 0.05), (HEATER, True, 0.01), (HEATER, True, 0.05)]
)
@pytest.mark.slow
def test_the_delay_of_an_input_is_fitted_in_noise(system, held, noise):
    """It is within three of its standard errors, and these are a share of a row."""
    own = system.fit([system.run(held, noise, 1)]).as_delay("u")
    assert own.error < 0.2 * noise
    assert abs(own.value - system.delay) < 3 * own.error


@pytest.mark.slow
def test_runs_that_share_a_delay_are_fitted_together():
    """Two runs of 5 % noise say more of the delay than either of them."""
    runs = [PIPE.run(True, 0.05, 1), PIPE.run(False, 0.05, 2)]
    alone = [PIPE.fit([run]).as_delay("u").error for run in runs]
    own = PIPE.fit(runs).as_delay("u")
    assert own.error < 0.95 * min(alone)
    assert abs(own.value - 1.7) < 3 * own.error


@pytest.mark.slow
def test_intervals_hold_the_truth_in_90_to_98_percent():
    """Over 20 draws, at 1 % and 5 % in turn, of the delay and of both constants."""
    inside = []
    for seed in range(20):
        noise = (0.01, 0.05)[seed % 2]
        delayed = Delayed.of([PIPE.run(True, noise, seed)], DelaySettings())
        fit = delayed.fit({"y": PIPE.equation}, 1.75, ComparisonSettings())
        values = np.append(np.abs(fit.fit.theta[:2]), fit.delay)
        errors = np.sqrt(np.diag(fit.fit.covariance))
        inside.append(np.abs(values - np.array([1.25, 1.25, 1.7])) < fit.fit.reach * errors)
    assert 0.90 <= np.mean(inside) <= 0.98


def found_pipe(runs=()):
    """Give the pipe as it is found, with its data or without them."""
    holds = dict(runs[0].holds) if runs else {"u": "previous", "u_delayed": "previous"}
    return Discovery(
        {"y": 1.25 * BEFORE - 1.25 * Y},
        {"y": ()},
        {"y": ParetoFront()},
        {},
        tuple(runs),
        delays={"u_delayed": Delay("u", 1.7, 0.01, 1.68, 1.72)},
        settings={"hold": holds},
    )


@pytest.mark.slow
def test_a_held_input_steps_between_rows_where_no_state_was_measured():
    """Each step is at its own time, the rows of the data stay, and those more are unmeasured."""
    run = PIPE.run(True)
    (own,) = Delayed.of([run], DelaySettings()).columns(1.73, 1.73)
    rows = _changes()[0]
    steps = own.t[1:][np.diff(own.inputs[:, own.input_names.index("u_delayed")]) != 0]
    assert steps == pytest.approx(
        [t for t in END / (ROWS - 1) * rows[1:] + 1.73 if t < END], abs=1e-9
    )
    measured = own.measured[:, 0]
    assert np.array_equal(own.t[measured], run.t[run.t >= 1.73])
    assert np.array_equal(own.x[measured, 0], run.x[run.t >= 1.73, 0])
    assert own.holds["u_delayed"] == "previous"


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.slow
def test_simulation_follows_the_data_with_the_input_that_was_before(held):
    """At the rows of the data, from their input, or from the same given again."""
    run = PIPE.run(held)
    found = found_pipe(Delayed.of([run], DelaySettings()).columns(1.7, 1.7))
    later = run.t >= 1.7
    t, truth = run.t[later], run.x[later, 0]
    # A function is read a few times between two rows, so that it may have no steps there.
    functions = [] if held else [{"u": _waves}]
    for given in (None, {"u": run.inputs[later, 0]}, *functions):
        own = found.simulate([truth[0]], t, given)
        assert own.x[:, 0] == pytest.approx(truth, abs=1e-5)


@pytest.mark.slow
def test_simulation_with_a_new_input_needs_its_past():
    """An expression has one, data may have one, and what has none is refused in one line."""
    t = np.linspace(0, 10, 101)
    truth = solve_ivp(
        lambda t, y: [(np.sin(t - 1.7) - y[0]) / 0.8],
        (0, 10),
        [0.3],
        "DOP853",
        t_eval=t,
        rtol=1e-12,
        atol=1e-13,
    )
    found = found_pipe()
    own = found.simulate([0.3], t, {"u": "sin(t)"})
    assert own.x[:, 0] == pytest.approx(truth.y[0], abs=1e-7)
    with pytest.raises(
        InputError, match=r"what 'u' was from t = -1.7 on; give it as an expression"
    ):
        found.simulate([0.3], t, {"u": np.ones(101)})
    run = PIPE.run(True)
    found = found_pipe(Delayed.of([run], DelaySettings()).columns(1.7, 1.7))
    # From the end of the data on: what was in the pipe arrives first.
    last, later = float(run.inputs[-1, 0]), np.linspace(40, 42, 21)
    own = found.simulate([last], later, {"u": np.full(21, 5.0)})
    assert np.all(np.abs(own.x[later < 41.6, 0] - last) < 1.5) and own.x[-1, 0] > last + 1


@pytest.mark.slow
def test_a_delayed_input_is_kept_exported_and_scored_as_what_it_is(tmp_path):
    """In the record and the report; formats without delays take it as an input."""
    run = PIPE.run(True)
    found = found_pipe(Delayed.of([run], DelaySettings()).columns(1.7, 1.7))
    assert found.score(run)["y"]["trajectory_rmse"] < 1e-6
    found.save(tmp_path / "found.json")
    again = load(tmp_path / "found.json")
    assert again.delays == found.delays
    for language in ("python", "c", "modelica", "casadi"):
        assert "u_delayed is u(t - 1.7), the delay is 1.68 to 1.72; give it" in again.export(
            language
        )
    page = found.report(tmp_path / "page.html").read_text("utf-8")
    assert "u(t - 1.7)" in page and "--delays 1.7" in page


@pytest.mark.slow
def test_an_input_that_acts_at_once_takes_fewer_bits_without_a_delay():
    """Of all sums that are fitted, the true one without a delay is the first."""
    delayed = Delayed.of([PIPE.run(True, 0.05, 5, 0.0)], DelaySettings())
    best = min(delayed.candidates(ComparisonSettings(), [1.7]), key=lambda fit: fit.bits)
    assert not best.has_delay
    assert skeleton(best.equations["y"]) == skeleton(1.25 * U - 1.25 * Y)


def check_pipe(found, noise):
    """The true terms and no others, a delay whose interval contains the truth, and a law."""
    assert found.verdict.level == "law"
    assert skeleton(found.equations["y"]) == skeleton(1.25 * BEFORE - 1.25 * Y)
    own = found.delays["u_delayed"]
    assert own.state == "u" and own.low < 1.7 < own.high
    assert own.error < max(0.2 * noise, 1e-4)


@pytest.mark.slow
def test_a_pipe_is_found():
    """The law of a smooth input and its delay, in 1 % noise."""
    found = discover(PIPE.run(False, 0.01), delays=1.6, jobs=1, preset="quick")
    check_pipe(found, 0.01)


@pytest.mark.slow
def test_no_delay_is_found_where_there_is_none():
    """An input that acts at once, in 5 % noise: the law, without a delay."""
    run = PIPE.run(False, 0.05, 5, 0.0)
    found = discover(run, delays=True, jobs=1, preset="quick")
    assert found.verdict.level == "law" and not found.delays
    assert skeleton(found.equations["y"]) == skeleton(1.25 * U - 1.25 * Y)


@pytest.mark.slow
def test_the_shell_takes_and_shows_the_delay_of_an_input(tmp_path):
    """`--inputs u --delays 1.6` finds the law and about 1.7, of a held input in 5 % noise.

    Nothing is said of steps between rows.
    """
    run, table = PIPE.run(True, 0.05), tmp_path / "pipe.csv"
    columns = np.column_stack([run.t, run.x, run.inputs])
    np.savetxt(table, columns, header="t,y,u", delimiter=",", comments="")
    asked = (
        "--inputs",
        "u",
        "--delays",
        "1.6",
        "--preset",
        "quick",
        "-j",
        "1",
        "-o",
        tmp_path / "out",
    )
    said = call("discover", table, *asked).output
    low, high = re.search(r"u\(t - [\d.]+\), the delay is ([\d.]+) to ([\d.]+)\.", said).groups()
    assert float(low) < 1.7 < float(high)
    assert "steps between rows" not in said
    check_pipe(load(tmp_path / "out"), 0.05)
