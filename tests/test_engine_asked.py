"""Nothing that is given an engine answers without asking it.

What takes an engine is looked up, not listed: a new function or command without a line here fails.
"""

import importlib
import inspect
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy
import typer
from command_line import run

import dynsr
import dynsr.benchmarks
import dynsr.checks
from dynsr.cli.app import app
from dynsr.data.system import LOTKA_VOLTERRA, PENDULUM, System
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.estimator import DynsrRegressor
from dynsr.discovery.search import discover
from dynsr.engines import registry
from dynsr.engines.base import InitialValueProblem, SparseProblem
from dynsr.engines.drives import Drive
from dynsr.engines.embedded import EmbeddedEngine
from dynsr.engines.simulation import add_noise, simulate, simulate_driven
from dynsr.engines.testing import RecordingEngine
from dynsr.errors import EngineError, EngineUnavailable, InputError
from dynsr.parameters import Delay, follow
from dynsr.verdict.prediction import MEASURED, predict_with_doses

ROOMS = [
    *("data", "engines", "fit", "methods", "selection", "verdict", "parameters", "discovery"),
    *("report", "paper", "checks", "benchmarks"),
]
T = np.linspace(0.0, 3.0, 61)
DECAY = Trajectory(T, 2 * np.exp(-0.5 * T)[:, None], ("x",))
X = sympy.Symbol("x")
RHS = LOTKA_VOLTERRA.rhs[-1]
FEW = {"method": "rational", "preset": "quick", "functions": (), "jobs": 1}
LINEAR = System.from_strings({"x": "-x/2"}, x0=(2.0,), name="linear")


@pytest.fixture
def julia(monkeypatch):
    """Put an engine that keeps what it is asked in the place of Julia."""
    engine = RecordingEngine("julia")
    monkeypatch.setitem(registry._STARTED, "julia", engine)
    return engine


def asked(engine: RecordingEngine) -> int:
    """Count the problems that an engine was given."""
    return len(engine.integrated) + len(engine.regressed)


def takes_engine(function) -> bool:
    """Whether a callable has a parameter for an engine."""
    try:
        names = inspect.signature(function).parameters
    except (ValueError, TypeError):
        return False
    return "engine" in names or "engines" in names


def public_takers() -> set[str]:
    """Name all functions, classes and methods behind the rooms' doors that take an engine."""
    found = set()
    for room in ROOMS:
        module = importlib.import_module(f"dynsr.{room}")
        for name in module.__all__:
            thing = getattr(module, name)
            if callable(thing) and takes_engine(thing):
                found.add(name)
            for attribute, member in inspect.getmembers(thing) if inspect.isclass(thing) else ():
                if not attribute.startswith("_") and callable(member) and takes_engine(member):
                    found.add(f"{name}.{attribute}")
    # Methods that hold an engine for a search, and what only writes a name down or passes it on.
    return {
        name
        for name in found
        if not name.endswith(".with_engine")
        and name not in {"AskedMethod", "Discovery", "Record", "share_engine"}
        and name not in {"is_embedded", "name_engines", "refuse_idle", "start_engine"}
    }


def driven() -> InitialValueProblem:
    """Pose x' = u with a measured input."""
    ramp = Drive("u", np.array([0.0]), np.array([[1.0], [0.0]]))
    return InitialValueProblem((sympy.Symbol("u"),), ("x",), [1.0], T, drives=(ramp,))


@cache
def found_flow():
    """Give the decay as a discovery that keeps the embedded engine."""
    return discover(DECAY, **FEW)


FUNCTIONS = {
    "discover": lambda e, _: discover(DECAY, engine=e, **FEW),
    "Discovery.simulate": lambda e, _: found_flow().simulate(engine=e),
    "Discovery.score": lambda e, _: found_flow().score(engine=e),
    "DynsrRegressor": lambda e, _: DynsrRegressor("sindy", engine=e).fit(T[:, None], 3 * T),
    "SINDy": lambda e, _: discover(DECAY, method=dynsr.SINDy(engine=e), functions=(), jobs=1),
    "simulate": lambda e, _: simulate(PENDULUM, engine=e),
    "simulate_driven": lambda e, _: simulate_driven(driven(), e),
    "training_trajectory": lambda e, _: dynsr.engines.training_trajectory(PENDULUM, e),
    "predict": lambda e, _: dynsr.discovery.predict({"x": -X}, [1.0], T, engine=e),
    "predict_with_doses": lambda e, _: predict_with_doses(
        {"x": -X}, [1.0], T, {"x": np.zeros(len(T))}, engine=e
    ),
    "follow": lambda e, _: follow(
        {"x": -sympy.Symbol("x_late")},
        {"x_late": Delay("x", 1.0)},
        lambda t: np.ones((1, len(t))),
        T,
        {},
        e,
    ),
    "equation_rmse": lambda e, _: dynsr.equation_rmse(LOTKA_VOLTERRA, RHS, engine=e),
    "trajectory_loss": lambda e, _: dynsr.trajectory_loss(LOTKA_VOLTERRA, RHS, engine=e),
    "trajectory_losses": lambda e, _: dynsr.discovery.trajectory_losses(
        LOTKA_VOLTERRA, [RHS], engine=e
    ),
    "score_expressions": lambda e, _: dynsr.score_expressions(
        LOTKA_VOLTERRA, [RHS], "sindy", engine=e
    ),
    "printed_loss": lambda e, _: dynsr.printed_loss(LOTKA_VOLTERRA, RHS, "GA", engine=e),
    "audit": lambda e, _: dynsr.audit(e, unrounded=lambda engine: {}),
    "replicate": lambda e, _: replicate_here(e),
    "measure_recovery": lambda e, _: list(
        dynsr.benchmarks.measure_recovery([LINEAR], lambda data, seed: {}, [0.0], engine=e)
    ),
    "crosscheck": lambda e, _: dynsr.checks.crosscheck(["pendulum"], [e], ["trajectories"]),
    "examine": lambda e, _: dynsr.checks.examine([e]),
}


def replicate_here(engine: str) -> None:
    """Compute a cell in this process, where the recording engine is."""
    from dynsr.paper.replication import Cell, Plan, compute_cell

    record = compute_cell(Cell(PENDULUM, "sindy", 1), Plan(0, "quick", engine))
    assert record.done and record.engine == engine, record.error


def test_every_function_that_takes_an_engine_is_tested_below():
    """The table of calls has a line for each public function, class or method that takes one."""
    assert public_takers() == set(FUNCTIONS)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_function_answers_without_asking(julia, tmp_path, name):
    """Given engine="julia", each asks it for an integration or a regression."""
    FUNCTIONS[name]("julia", tmp_path)
    assert asked(julia) > 0


def table(folder: Path) -> Path:
    """Write the decay as a table."""
    path = folder / "x.csv"
    path.write_text("t,x\n" + "".join(f"{t},{x}\n" for t, x in zip(T, DECAY.x[:, 0], strict=True)))
    return path


COMMANDS = {
    "discover": lambda folder: (
        *(table(folder), "--method", "rational", "--functions", "none", "--preset", "quick"),
        *("-j", 1, "--json"),
    ),
    "simulate": lambda folder: ("pendulum", "--span", "0,1", "--json"),
    "generate": lambda folder: ("pendulum", "--span", "0,1", "-o", folder / "made.csv"),
    "score": lambda folder: (found_flow().save(folder / "found.json"), table(folder), "--json"),
    "audit": lambda folder: ("--json",),
    "crosscheck": lambda folder: ("--systems", "pendulum", "--sections", "corrected", "--json"),
    "benchmark": lambda folder: (
        *("recovery", "--systems", "pendulum", "--noise", 0),
        *("--method", "sindy", "--preset", "quick", "-j", 1, "--json", "-q"),
    ),
}
# Its cells run in processes of their own; one of them is computed here by replicate_here.
APART = {"replicate"}


def test_every_command_that_takes_an_engine_is_tested_below():
    """The table of commands has a line for each that has --engine or --engines."""
    commands = typer.main.get_command(app).commands
    takers = {
        name
        for name, command in commands.items()
        if any(p.name in ("engine", "engines") for p in command.params)
    }
    assert takers == set(COMMANDS) | APART


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.slow
def test_no_command_answers_without_asking(julia, tmp_path, monkeypatch, name):
    """With --engine julia each command asks it."""
    monkeypatch.chdir(tmp_path)
    flag = "--engines" if name == "crosscheck" else "--engine"
    run(name, *COMMANDS[name](tmp_path), flag, "julia")
    assert asked(julia) > 0


@pytest.mark.slow
def test_noisy_data_are_followed_by_the_engine(julia):
    """Found along the states by NumPy alone, as the record says, then integrated by the engine."""
    noisy = add_noise(DECAY, 0.03, np.random.default_rng(1))
    found = discover(noisy, preset="quick", functions=(), engine="julia", jobs=1)
    engines = found.settings["engines"]
    assert engines["search"] == "none (NumPy on the states)" and "regress" not in engines
    assert not julia.regressed and len(julia.integrated) == 1
    confirmed = found.settings["confirmed"]
    assert (confirmed["engine"], confirmed["versions"]) == ("julia", julia.versions())
    distance = found.score()["x"]["trajectory_rmse"]
    assert confirmed["trajectory_rmse"]["x"] == pytest.approx(distance, rel=1e-12)
    json.dumps(found.settings["confirmed"], allow_nan=False)


def test_what_a_first_look_ends_is_no_regression_of_any_engine():
    """Where no method runs, the record names none; nothing is confirmed by the embedded engine."""
    found = discover(DECAY, jobs=1)
    assert found.settings["first_look"] == ["x"] and str(found.equations["x"]) == "-0.5*x"
    engines = found.settings["engines"]
    assert engines["search"] == "none (NumPy on the slopes)" and "regress" not in engines
    assert "confirmed" not in found.settings


@pytest.mark.slow
def test_what_has_no_solution_is_confirmed_as_such(julia, monkeypatch):
    """An engine that gives up leaves no distance, Ctrl-C nothing at all; the equations stay."""

    def give_up(problem):
        julia.integrated.append(problem)
        raise EngineError("no")

    monkeypatch.setattr(julia, "integrate", give_up)
    found = discover(DECAY, engine="julia", method="rational", jobs=1)
    assert str(found.equations["x"]) == "-0.5*x"
    assert found.settings["confirmed"]["trajectory_rmse"] == {"x": None}

    def interrupt(problem):
        raise KeyboardInterrupt

    monkeypatch.setattr(julia, "integrate", interrupt)
    found = discover(DECAY, engine="julia", method="rational", jobs=1)
    assert str(found.equations["x"]) == "-0.5*x" and "confirmed" not in found.settings


def test_an_engine_that_does_not_start_is_told_before_the_search(julia, monkeypatch):
    """No regression is asked for, and no data are read, once its start has failed."""

    def refuse():
        raise EngineUnavailable("Julia does not start: x")

    monkeypatch.setattr(julia, "versions", refuse)
    with pytest.raises(EngineUnavailable, match="does not start"):
        discover("no such file.csv", engine="julia", jobs=1)
    assert asked(julia) == 0


def test_where_an_engine_has_nothing_to_do_it_is_refused(julia, tmp_path):
    """A map that no method regresses, its iteration, a regressor of another kind, a benchmark."""
    halving = Trajectory(np.arange(12.0), 0.5 ** np.arange(12.0)[:, None], ("x",))
    words = "engine 'julia' has nothing to do; leave it out"
    with pytest.raises(InputError, match=words):
        discover(halving, discrete=True, method="rational", engine="julia", jobs=1)
    with pytest.raises(InputError, match=words):
        DynsrRegressor("rational", engine="julia").fit(T[:, None], 3 * T)
    found = discover(halving, discrete=True, method="rational", jobs=1)
    with pytest.raises(InputError, match=words):
        found.simulate(engine="julia")
    with pytest.raises(InputError, match=words):
        found.score(engine="julia")
    saved = found.save(tmp_path / "map.json")
    assert words in run("simulate", saved, "--engine", "julia", code=2).stderr
    assert words in run("benchmark", "zoo", "--engine", "julia", "-q", code=2).stderr
    assert asked(julia) == 0
    assert len(found.simulate(engine="embedded")) == 12


def measured() -> Trajectory:
    """Give x' = u - x with u = sin 2t, which was measured."""
    force = np.sin(2 * T)
    x = dynsr.discovery.predict({"x": dynsr.parse("u - x")}, [1.0], T, {"u": force})
    return Trajectory(T, x.x, ("x",), force[:, None], ("u",))


@pytest.mark.slow
def test_measured_inputs_cross_the_seam(julia):
    """Predictions, simulations, scores and the discovery itself ask the engine with its drives."""
    found = discover(
        measured(), engine="julia", method="rational", functions=(), preset="quick", jobs=1
    )
    told = "julia (on measured inputs)"
    assert found.settings["engines"]["simulate"] == told
    assert found.settings["confirmed"]["trajectory_rmse"]["x"] < 1e-3
    for call in (found.simulate, found.score):
        before = len(julia.integrated)
        call()
        assert len(julia.integrated) == before + 1
        assert [drive.name for drive in julia.integrated[-1].drives] == ["u"]
    assert found.simulate().origin["engine"] == told


@pytest.mark.slow
def test_an_engine_that_takes_no_measured_inputs_gives_way_and_that_is_said(julia, monkeypatch):
    """The embedded one integrates; origin and record name it, and nothing is confirmed."""
    monkeypatch.setattr(julia, "takes_drives", False)
    found = discover(
        measured(), engine="julia", method="rational", functions=(), preset="quick", jobs=1
    )
    assert found.settings["engines"]["simulate"] == MEASURED == found.simulate().origin["engine"]
    assert "confirmed" not in found.settings and asked(julia) == 0


def test_the_embedded_engine_is_the_same_seam():
    """What is counted above is what the embedded engine answers: the two verbs of the seam."""
    engine = RecordingEngine(base=EmbeddedEngine())
    engine.regress(SparseProblem(np.ones((1, 3)), np.ones(3), "STLSQ"))
    assert asked(engine) == 1
