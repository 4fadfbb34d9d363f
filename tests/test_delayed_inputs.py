"""Delays of inputs: equations that contain an input as it was some time before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr import Trajectory
from dynsr.discovery.delays import Delayed, DelaySettings
from dynsr.fit import DelayedSystem, MixedMesh, drives_of, measure_runs
from dynsr.selection import ComparisonSettings

Y, U, BEFORE = sympy.symbols("y u u_delayed")
END, ROWS = 40.0, 401


@dataclass(frozen=True)
class Known:
    """A system that is known: its slope in y and u(t - delay), delay, equation, and constants."""

    slope: Callable[[float, float], float]
    delay: float
    equation: sympy.Expr
    constants: tuple[float, ...]

    def run(self, held, noise=0.0, seed=0, delay=None):
        """Give 401 rows of y and u, which is held for a while again and again, or smooth."""
        t = np.linspace(0, END, ROWS)
        y = _solution(self, held, self.delay if delay is None else delay)
        y = y + noise * y.std() * np.random.default_rng(seed).normal(size=len(y))
        u = _steps(t) if held else _waves(t)
        return Trajectory(t, y[:, None], ("y",), u[:, None], ("u",))

    def fit(self, run):
        """Fit the delay and all constants, from a delay that is too long."""
        delayed = Delayed.of([run], DelaySettings())
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

    for place in range(0, states.size, 7):
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
def test_the_error_of_the_rule_is_counted_in_exact_data(system, held):
    """The interval contains a delay between rows, and it is narrow."""
    fit = system.fit(system.run(held))
    own = fit.as_delay("u")
    assert own.low < system.delay < own.high
    assert own.error < 1e-5
    numbers = sorted(abs(float(c)) for c in fit.equations["y"].atoms(sympy.Float))
    assert numbers == pytest.approx(system.constants, rel=1e-5)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("system", [PIPE, HEATER])
@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_the_delay_of_an_input_is_fitted_in_noise(system, held, noise):
    """It is within three of its standard errors, and these are a share of a row."""
    own = system.fit(system.run(held, noise, 1)).as_delay("u")
    assert own.error < 0.15 * noise
    assert abs(own.value - system.delay) < 3 * own.error


@pytest.mark.slow
@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("system", [PIPE, HEATER])
def test_95_percent_intervals_contain_the_truth_as_often_as_they_say(system, held):
    """Of 20 draws of 5 % noise, 90 % or more of the intervals of the delay and all constants."""
    inside = np.zeros(1 + len(system.constants))
    for seed in range(20):
        fit = system.fit(system.run(held, 0.05, seed))
        order = np.argsort(np.abs(fit.fit.theta[:-1]))
        values = np.append(np.abs(fit.fit.theta[:-1][order]), fit.delay)
        errors = np.sqrt(np.diag(fit.fit.covariance))[np.append(order, -1)]
        off = np.abs(values - np.array([*system.constants, system.delay]))
        inside += off < fit.fit.reach * errors
    assert inside.sum() >= 0.9 * 20 * len(inside)
    assert inside[-1] >= 18
