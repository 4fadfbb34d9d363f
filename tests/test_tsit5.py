import itertools
import math
import time
from pathlib import Path

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.system import (
    CART_POLE,
    LORENZ,
    LOTKA_VOLTERRA,
    PAPER_SYSTEMS,
    PENDULUM,
    SYSTEMS,
    System,
)
from dynsr.engines.base import InitialValueProblem
from dynsr.engines.tsit5.single import Steps, interpolate, solve, solve_steps
from dynsr.engines.tsit5.tableau import stages_of_step
from dynsr.expression.evaluation import compile_scalar
from dynsr.expression.parsing import parse

GOLDEN = Path(__file__).parent / "golden" / "tsit5"
FILES = {
    LOTKA_VOLTERRA.name: "lotka_volterra",
    PENDULUM.name: "simple_pendulum",
    CART_POLE.name: "cart_pole",
}
BY_NAME = pytest.mark.parametrize("system", PAPER_SYSTEMS, ids=lambda s: s.name)


def read_golden(system: System, case: str) -> np.ndarray:
    """Give the rows (t, states) of one golden file."""
    return np.loadtxt(GOLDEN / f"{FILES[system.name]}_{case}.csv.gz", delimiter=",")


def problem_of(system: System, t, **settings) -> InitialValueProblem:
    """Pose the system's own initial value problem on other times."""
    return InitialValueProblem(system.closed_rhs(), system.states, system.x0, t, **settings)


def one_equation(text: str, x0: float, t, **settings) -> InitialValueProblem:
    """Pose dx/dt = text."""
    return InitialValueProblem((parse(text, ["x", "t"]),), ("x",), [x0], t, **settings)


@BY_NAME
def test_the_accepted_steps_are_those_of_ordinarydiffeq(system):
    """Every golden case takes the same number of steps, at the same times."""
    golden = read_golden(system, "train_steps_default")
    steps = solve_steps(problem_of(system, [0.0, 10.0]))
    assert len(steps.t) == len(golden)
    tolerance = 5e-4 if system is CART_POLE else 1e-5
    assert np.abs(steps.t - golden[:, 0]).max() < tolerance
    assert np.abs(steps.x - golden[:, 1:]).max() < 20 * tolerance


@BY_NAME
@pytest.mark.parametrize(
    ("case", "settings", "tolerance"),
    [
        ("train_saveat0.01_default", {}, 2e-5),
        ("test_saveat0.05_default", {}, 2e-5),
        ("train_saveat0.1_tight", {"reltol": 1e-10, "abstol": 1e-10}, 1e-8),
    ],
)
def test_saved_states_are_those_of_ordinarydiffeq(system, case, settings, tolerance):
    """States at the times asked for agree with the golden ones, also with the start at t = 10."""
    golden = read_golden(system, case)
    found = solve(problem_of(system, golden[:, 0], **settings))
    assert found.success
    assert np.abs(found.x - golden[:, 1:]).max() < tolerance


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda s: s.name)
def test_tight_solutions_agree_with_dop853(system):
    """Another method of another library gives the same states at tight tolerance."""
    t = system.times((system.train[0], system.train[0] + 5.0), 0.05)
    found = solve(problem_of(system, t, reltol=1e-11, abstol=1e-11))
    f = compile_scalar(system.closed_rhs(), [*system.states, "t"])
    reference = solve_ivp(
        lambda s, x: f(*x, s), (t[0], t[-1]), system.x0, "DOP853", t, rtol=1e-12, atol=1e-12
    )
    assert np.abs(found.x - reference.y.T).max() < 1e-6 * np.abs(found.x).max()


def test_the_error_falls_with_the_fifth_power_of_the_step():
    """Steps of equal length h leave an error of order h^5 on a problem with a known solution."""

    def error_after(count: int) -> float:
        x, h = [1.0], 1.0 / count
        for step in range(count):
            t = step * h
            k1 = [x[0] * math.cos(t)]
            _, x = stages_of_step(lambda u, s: [u * math.cos(s)], x, t, h, k1)
        return abs(x[0] - math.exp(math.sin(1.0)))

    errors = [error_after(count) for count in (8, 16, 32)]
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert all(4.7 < order < 5.6 for order in orders)


def test_the_interpolant_is_of_fourth_order():
    """Between the ends of one step the free interpolant is off by h^5, at the ends by nothing."""

    def worst(h: float) -> float:
        ks, new = stages_of_step(lambda u, t: [u], [1.0], 0.0, h, [1.0])
        steps = Steps(np.array([0.0, h]), np.array([[1.0], new]), np.array([ks]), 0, "")
        t = np.linspace(0.0, h, 33)
        x = interpolate(steps, t)[:, 0]
        assert x[0] == 1.0 and x[-1] == new[0]
        return np.abs(x - np.exp(t)).max()

    assert 4.7 < math.log2(worst(0.1) / worst(0.05)) < 5.3


@pytest.mark.parametrize("power", ["x^2", "x^3 + t"])
def test_a_blow_up_in_finite_time_is_a_result(power):
    """A solution that runs to infinity is NaN from there on, with the reason, and no exception."""
    found = solve(one_equation(power, 1.0, np.linspace(0.0, 2.0, 201)))
    assert not found.success
    assert "diverged" in found.message
    finite = np.isfinite(found.x[:, 0])
    assert finite[0] and not finite[-1]
    assert (np.diff(finite.astype(int)) <= 0).all()


def test_states_before_the_blow_up_are_kept():
    """dx/dt = x^2 from 1 is 1 / (1 - t) until it blows up at t = 1."""
    t = np.linspace(0.0, 2.0, 41)
    found = solve(one_equation("x^2", 1.0, t, reltol=1e-9, abstol=1e-9))
    before = t < 0.96
    assert np.allclose(found.x[before, 0], 1 / (1 - t[before]), rtol=1e-6)
    assert np.isnan(found.x[t > 1.0]).all()


@pytest.mark.parametrize("text", ["log(x - 2)", "sqrt(-x)", "1/(x - 1)", "x^0.5 - 1/t"])
def test_equations_without_a_value_at_the_start_are_a_result(text):
    """Where the right-hand side has no real value at the start, only the start is known."""
    found = solve(one_equation(text, 1.0, [0.0, 1.0]))
    assert not found.success
    assert np.isnan(found.x[1:]).all()


def test_leaving_the_domain_of_the_equation_is_a_result():
    """dx/dt = -1/sqrt(x) reaches 0, where the square root ends, and is NaN from there on."""
    found = solve(one_equation("-1/sqrt(x)", 1.0, np.linspace(0.0, 1.0, 11)))
    # x = (1 - 3 t / 2)^(2/3) ends at t = 2/3.
    finite = np.isfinite(found.x[:, 0])
    assert finite[:6].all() and not finite[7:].any()


def test_a_stiff_problem_stops_at_the_step_limit():
    """An explicit method on a very stiff equation meets the limit of steps instead of hanging."""
    problem = one_equation("-10^9*(x - cos(t))", 2.0, [0.0, 1000.0], max_steps=2000)
    found = solve(problem)
    assert not found.success
    assert found.accepted + found.rejected == 2000
    assert "2000 steps" in found.message


def test_the_time_limit_stops_a_long_integration():
    """More time than allowed ends the integration soon after."""
    start = time.perf_counter()
    found = solve(one_equation("-10^9*(x - cos(t))", 2.0, [0.0, 1e6], max_seconds=0.05))
    assert time.perf_counter() - start < 1.0
    assert not found.success and "time" in found.message


def test_an_equation_at_rest_stays_there():
    """Zero slopes give the start state at every time, in few steps."""
    found = solve(one_equation("0*x", 3.0, np.linspace(0.0, 100.0, 11)))
    assert found.success and (found.x == 3.0).all()
    assert found.accepted < 20


def test_saving_more_often_changes_no_step():
    """The times asked for are interpolated; they do not touch the steps."""
    few = solve(problem_of(LORENZ, [0.0, 5.0]))
    many = solve(problem_of(LORENZ, np.linspace(0.0, 5.0, 5001)))
    assert few.accepted == many.accepted
    assert (few.x[-1] == many.x[-1]).all()


def test_the_same_problem_gives_the_same_bits():
    """Integration is deterministic."""
    t = np.linspace(0.0, 10.0, 101)
    first, second = (solve(problem_of(LORENZ, t)).x for _ in range(2))
    assert (first == second).all()


def test_a_tower_of_powers_does_not_hang():
    """Huge right-hand sides overflow into a divergence, not into an exception."""
    x = sympy.Symbol("x")
    tower = sympy.exp(sympy.exp(sympy.exp(x * 3)))
    found = solve(InitialValueProblem((tower,), ("x",), [1.0], [0.0, 1.0]))
    assert not found.success
