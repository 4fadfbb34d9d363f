"""The same claims on every engine. Julia's half is skipped where it is not set up, or fails
instead when DYNSR_REQUIRE_JULIA is 1.
"""

import os
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynsr.checks.crosschecks import coefficient_difference
from dynsr.data.system import CART_POLE, LOTKA_VOLTERRA, PAPER_SYSTEMS, PENDULUM, System
from dynsr.engines.base import AbstractEngine, InitialValueProblem, SparseProblem
from dynsr.engines.drives import Drive
from dynsr.engines.julia import setup as julia_setup
from dynsr.engines.julia.diffeqpy import DiffeqpyEngine
from dynsr.engines.registry import ENGINES, find_engine
from dynsr.errors import EngineUnavailable, InputError
from dynsr.expression.parsing import parse
from dynsr.paper.reference import SparseRecord, sparse_records

GOLDEN = Path(__file__).parent / "golden" / "tsit5"
FILES = {
    LOTKA_VOLTERRA.name: "lotka_volterra",
    PENDULUM.name: "simple_pendulum",
    CART_POLE.name: "cart_pole",
}
BY_SYSTEM = pytest.mark.parametrize("system", PAPER_SYSTEMS, ids=lambda s: s.name)
RECORDS = [*sparse_records("2021"), *sparse_records("current")]


def find_or_skip(name: str) -> AbstractEngine:
    """Give an engine; where it is not set up, skip or fail as DYNSR_REQUIRE_JULIA says.

    diffeqpy is no engine of dynsr's and brings all of DifferentialEquations.jl along: it has
    DYNSR_REQUIRE_DIFFEQPY for itself.
    """
    variable = f"DYNSR_REQUIRE_{name.upper()}"
    try:
        return DiffeqpyEngine() if name == "diffeqpy" else find_engine(name)
    except EngineUnavailable as problem:
        if os.environ.get(variable) == "1":
            pytest.fail(f"{variable} is 1, but {problem}")
        pytest.skip(str(problem))


@pytest.fixture(scope="module", params=ENGINES)
def engine(request):
    """Give each engine in turn."""
    return find_or_skip(request.param)


@pytest.fixture(scope="module", params=[*ENGINES, "diffeqpy"])
def integrator(request):
    """Give each engine in turn, and diffeqpy, which integrates only."""
    found = find_or_skip(request.param)
    yield found
    if request.param == "diffeqpy":
        found.close()


def read_golden(system: System, case: str) -> np.ndarray:
    """Give the rows (t, states) that OrdinaryDiffEqTsit5 saved."""
    return np.loadtxt(GOLDEN / f"{FILES[system.name]}_{case}.csv.gz", delimiter=",")


def pose(text: str, x0: float, t, **settings) -> InitialValueProblem:
    """Pose dx/dt = text."""
    return InitialValueProblem((parse(text, ["x", "t"]),), ("x",), [x0], t, **settings)


@BY_SYSTEM
@pytest.mark.parametrize(
    ("case", "tolerances", "limit"),
    [
        ("train_saveat0.01_default", {}, 2e-5),
        ("test_saveat0.05_default", {}, 2e-5),
        ("train_saveat0.1_tight", {"reltol": 1e-10, "abstol": 1e-10}, 1e-8),
    ],
)
def test_states_are_those_of_tsit5(integrator: AbstractEngine, system, case, tolerances, limit):
    """States at default and tight tolerances are those that OrdinaryDiffEqTsit5 saved."""
    golden = read_golden(system, case)
    problem = InitialValueProblem(
        system.closed_rhs(), system.states, golden[0, 1:], golden[:, 0], **tolerances
    )
    solved = integrator.integrate(problem)
    assert solved.success and solved.message == ""
    assert np.abs(solved.x - golden[:, 1:]).max() < limit


@BY_SYSTEM
def test_as_many_steps_are_taken_as_by_tsit5(integrator: AbstractEngine, system):
    """Over the training span, the accepted steps are as many as OrdinaryDiffEqTsit5 took."""
    golden = read_golden(system, "train_steps_default")
    problem = InitialValueProblem(
        system.closed_rhs(), system.states, np.array(system.x0), np.array([0.0, 10.0])
    )
    assert integrator.integrate(problem).accepted == len(golden) - 1


def test_a_known_solution_is_met(integrator: AbstractEngine):
    """dx/dt = -x + sin t has a closed form, which tight tolerances reach at uneven times."""
    t = np.array([0.5, 0.6, 1.7, 5.0])
    exact = (np.sin(t) - np.cos(t)) / 2 + np.exp(-t)
    solved = integrator.integrate(
        pose("sin(t) - x", float(exact[0]), t, reltol=1e-11, abstol=1e-11)
    )
    assert np.abs(solved.x[:, 0] - exact).max() < 1e-9


def test_measured_inputs_are_integrated(engine: AbstractEngine):
    """x' = u + 2v, of pieces, has a closed form; a narrow pulse is met for its stops alone."""
    bend = Drive("u", np.array([0.0, 1.0]), np.array([[3.0, 0.0], [0.0, 0.0], [0.0, 3.0]]))
    ramp = Drive("v", np.array([0.0]), np.array([[1.0], [0.0]]))
    settings = {"reltol": 1e-10, "abstol": 1e-10}
    problem = InitialValueProblem(
        (parse("u + 2*v", ["u", "v"]),),
        ("x",),
        [0.0],
        np.array([0.0, 1.0, 2.0]),
        **settings,
        drives=(bend, ramp),
        stops=np.array([0.25, 1.0, 1.75]),
    )
    assert np.abs(engine.integrate(problem).x[:, 0] - [0.0, 2.0, 8.0]).max() < 1e-9
    pulse = Drive("u", np.array([0.0, 50.0, 50.01]), np.array([[0.0, 100.0, 0.0]]))
    rest = InitialValueProblem(
        (parse("u", ["u"]),),
        ("x",),
        [0.0],
        np.array([0.0, 100.0]),
        **settings,
        drives=(pulse,),
        stops=np.array([50.0, 50.01]),
    )
    assert abs(engine.integrate(rest).x[-1, 0] - 1.0) < 1e-6


def test_a_divergence_is_a_result(integrator: AbstractEngine):
    """dx/dt = x^2 ends at t = 1: states up to there, NaN from there on, and no exception."""
    solved = integrator.integrate(pose("x^2", 1.0, [0.0, 0.5, 2.0, 3.0], reltol=1e-8, abstol=1e-8))
    assert not solved.success and solved.message
    assert abs(solved.x[1, 0] - 2.0) < 1e-6
    assert np.isnan(solved.x[2:]).all()


def test_leaving_the_real_numbers_is_a_divergence(integrator: AbstractEngine):
    """A square root of a negative state ends the solution like any divergence."""
    solved = integrator.integrate(pose("-sqrt(x - 0.5)", 0.4, [0.0, 1.0]))
    assert not solved.success and solved.x[0, 0] == 0.4 and np.isnan(solved.x[1, 0])


def test_limits_of_steps_and_time_end_a_solution(integrator: AbstractEngine):
    """A solution that needs more steps or seconds than allowed is NaN from there on."""
    waves = pose("50*cos(50*t)", 0.0, [0.0, 1000.0], max_steps=50)
    solved = integrator.integrate(waves)
    assert not solved.success and solved.accepted + solved.rejected <= 51
    hurried = replace(waves, max_steps=10**8, max_seconds=1e-6, reltol=1e-9, abstol=1e-9)
    assert not integrator.integrate(hurried).success


@pytest.mark.parametrize("record", RECORDS, ids=lambda r: f"{r.problem.release} {r.title}")
def test_coefficients_are_those_of_both_releases(engine: AbstractEngine, record: SparseRecord):
    """Every recorded answer of DataDrivenDiffEq 0.5.7 and DataDrivenSparse 0.1.2 is met."""
    solution = engine.regress(record.problem)
    # An implicit relation holds up to a factor, which depends on the left-hand side chosen.
    implicit = record.problem.implicit
    gap = coefficient_difference(solution.coefficients, record.coefficients, implicit)
    assert gap < 1e-6
    assert (solution.iterations is None) == (record.iterations is None)


@pytest.mark.parametrize("release", ["2021", None])
def test_a_vanishing_threshold_is_least_squares(engine: AbstractEngine, release):
    """With a threshold and a relaxation near nothing, SR3 gives the least-squares solution."""
    rng = np.random.default_rng(3)
    theta = rng.normal(size=(4, 60))
    dx = np.array([1.0, -2.0, 0.5, 3.0]) @ theta + 0.1 * rng.normal(size=60)
    exact = np.linalg.lstsq(theta.T, dx, rcond=None)[0]
    nu = 1e9 if release else 1e-9
    settings = {"threshold": 1e-9, "nu": nu}
    problem = SparseProblem(theta, dx, "SR3", settings, max_iterations=50, release=release)
    assert np.abs(engine.regress(problem).coefficients - exact).max() < 1e-6


@pytest.mark.slow
def test_a_planted_rational_equation_is_found(engine: AbstractEngine):
    """The corrected implicit search finds dx = 2 x / (1 + x) among 1 and x."""
    x = np.linspace(0.1, 2.0, 200)
    theta, dx = np.array([np.ones_like(x), x]), 2 * x / (1 + x)
    problem = SparseProblem(
        theta, dx, "SR3", {"lambda": 1e-8}, False, 20_000, True, "2021-corrected"
    )
    q = engine.regress(problem).coefficients
    assert np.abs(-(q[2:] @ theta) / (q[:2] @ theta) - dx).max() < 1e-9


def test_convergence_is_judged_by_the_residual(engine: AbstractEngine):
    """ADMM that stands still at its dense start after one step has not converged."""
    record = next(
        r
        for r in sparse_records("current")
        if r.system == "lotka-volterra" and r.problem.optimizer == "ADMM" and r.iterations == 1
    )
    assert not engine.regress(record.problem).converged


def test_settings_that_do_not_exist_are_refused(engine: AbstractEngine):
    """A setting of another optimizer is told in one line, whatever the engine."""
    one = np.ones((1, 3))
    with pytest.raises(InputError, match="unknown setting 'rho' of SR3"):
        engine.regress(SparseProblem(one, one[0], "SR3", {"rho": 1.0}))


def test_a_closed_engine_starts_again(integrator: AbstractEngine):
    """After it is closed, an engine answers as before and names its parts."""
    problem = pose("-x", 1.0, [0.0, 1.0])
    before = integrator.integrate(problem).x
    integrator.close()
    assert np.array_equal(integrator.integrate(problem).x, before)
    assert len(integrator.versions()) >= 3


@pytest.mark.slow
def test_julias_own_tests_pass():
    """runtests.jl holds the Julia code to golden data, without Python."""
    find_or_skip("julia")
    program, project = julia_setup.locate()
    tests = julia_setup.find_sources() / "test" / "runtests.jl"
    command = [program, f"--project={project}", "--startup-file=no", str(tests)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


def test_a_missing_julia_fails_where_it_is_required(monkeypatch):
    """DYNSR_REQUIRE_JULIA=1 turns the skip of an absent engine into a failure."""

    def unavailable(name):
        raise EngineUnavailable("not set up")

    monkeypatch.setitem(find_or_skip.__globals__, "find_engine", unavailable)
    monkeypatch.delenv("DYNSR_REQUIRE_JULIA", raising=False)
    with pytest.raises(pytest.skip.Exception, match="not set up"):
        find_or_skip("julia")
    monkeypatch.setenv("DYNSR_REQUIRE_JULIA", "1")
    with pytest.raises(pytest.fail.Exception, match="DYNSR_REQUIRE_JULIA is 1, but not set up"):
        find_or_skip("julia")
