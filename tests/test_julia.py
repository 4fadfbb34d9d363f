import importlib.util
import inspect
import os
import pickle
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from dynsr.data.system import CART_POLE, PENDULUM
from dynsr.engines.base import InitialValueProblem, SparseProblem
from dynsr.engines.drives import Drive
from dynsr.engines.embedded import EmbeddedEngine
from dynsr.engines.julia import engine as julia
from dynsr.engines.julia import process as worker_process
from dynsr.engines.julia import shared
from dynsr.engines.julia import worker as julia_worker
from dynsr.engines.julia.diffeqpy import DiffeqpyEngine
from dynsr.engines.julia.engine import JuliaEngine
from dynsr.engines.julia.setup import find_sources
from dynsr.engines.simulation import simulate
from dynsr.errors import EngineError, EngineUnavailable
from dynsr.expression.parsing import parse
from dynsr.jobs.budget import TimeUp, time_limit
from dynsr.verdict.prediction import predict

FAKE = Path(__file__).parent / "fake_julia"
pytestmark = pytest.mark.skipif(os.name != "posix", reason="the stand-in is a POSIX program")
DIE, HANG, RAISE, CHATTER, NOT_FINITE, WRONG_SHAPE, CRASH = 13, 14, 15, 16, 17, 18, 19
LINE = SparseProblem(np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 2.0]]), np.array([0.0, 2.0, 4.0]))


def decay(max_steps: int = 1000, **settings) -> InitialValueProblem:
    """Pose dx/dt = -x from 1; the number of steps tells the stand-in how to behave."""
    t = np.linspace(0.0, 1.0, 5)
    return InitialValueProblem(
        (parse("-x", ["x"]),), ("x",), [1.0], t, max_steps=max_steps, **settings
    )


@pytest.fixture(scope="module")
def fake_julia(tmp_path_factory):
    """Put the stand-in for juliacall on the path, as a Julia of the user's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FAKE))
        patch.setenv("PYTHON_JULIACALL_EXE", str(FAKE / "julia"))
        patch.setenv("PYTHON_JULIACALL_PROJECT", str(tmp_path_factory.mktemp("project")))
        yield


@pytest.fixture(scope="module")
def engine(fake_julia):
    """Give an engine over the stand-in and end its process afterwards."""
    engine = JuliaEngine(start_seconds=60.0)
    yield engine
    engine.close()


def process_of(engine: JuliaEngine) -> str:
    """Give the number of the process that answers."""
    engine._versions = {}
    return engine.versions()["OrdinaryDiffEqTsit5"]


def test_states_travel_to_julia_and_back(engine):
    """Equations sent as Julia source come back as the states they have at every time."""
    solved = engine.integrate(decay())
    assert solved.success and solved.accepted > 0
    assert np.abs(solved.x[:, 0] - np.exp(-np.linspace(0.0, 1.0, 5))).max() < 1e-9


@pytest.mark.parametrize("system", [PENDULUM, CART_POLE], ids=lambda s: s.name)
def test_a_system_simulates_on_the_engine(engine, system):
    """A trajectory by this engine is that of the embedded one, and names its origin."""
    t = np.linspace(0.0, 2.0, 21)
    here = simulate(system, t=t, engine=engine)
    there = simulate(system, t=t, reltol=1e-9, abstol=1e-9)
    assert np.abs(here.x - there.x).max() < 1e-7
    assert here.origin["engine"] == "julia"
    assert here.origin["versions"]["juliacall"] == "0.0-fake"


def test_measured_inputs_travel_to_julia_and_back(engine):
    """Two inputs of different pieces, and stops inside the span, give what the embedded one has."""
    t = np.linspace(0.0, 2.0, 9)
    bend = Drive("v", np.array([0.0, 0.7]), np.array([[3.0, 0.0], [0.0, 1.0], [0.0, 1.47]]))
    ramp = Drive("u", np.array([0.0]), np.array([[1.0], [0.5]]))
    problem = InitialValueProblem(
        (parse("v - x*u", ["x", "u", "v"]), parse("x + t", ["x", "t"])),
        ("x", "y"),
        [1.0, 0.0],
        t,
        1e-11,
        1e-11,
        drives=(bend, ramp),
        stops=np.array([0.0, 0.7, 0.7, 1.3, 2.0]),
    )
    there, here = engine.integrate(problem), EmbeddedEngine().integrate(problem)
    assert there.success and np.abs(there.x - here.x).max() < 1e-8
    assert there.accepted == 40 * 10
    with pytest.raises(EngineError, match="diffeqpy integrates no measured inputs"):
        DiffeqpyEngine.integrate(DiffeqpyEngine.__new__(DiffeqpyEngine), problem)


def test_a_prediction_with_a_measured_input_asks_julia(engine):
    """States, values of the input and the origin name it; they are those of the embedded engine."""
    t = np.linspace(0.0, 3.0, 31)
    asked = ({"x": parse("u - x", ["x", "u"])}, [1.0], t, {"u": np.sin(2 * t)})
    there, here = predict(*asked, engine), predict(*asked)
    assert there.origin["engine"] == "julia (on measured inputs)"
    assert here.origin["engine"] == "embedded (Tsit5 on measured inputs)"
    assert np.abs(there.x - here.x).max() < 1e-7
    assert np.array_equal(there.inputs, here.inputs)


def test_regressions_travel_to_julia_and_back(engine):
    """Library, settings and coefficients pass unharmed; -1 iterations mean an empty search."""
    solution = engine.regress(LINE)
    assert solution.coefficients.round(9).tolist() == [0.0, 2.0]
    assert solution.iterations == LINE.max_iterations and solution.converged
    empty = engine.regress(SparseProblem(LINE.theta, LINE.dx, implicit=True))
    assert empty.iterations is None and not empty.coefficients.any()


def test_one_process_answers_until_the_engine_is_closed(engine):
    """The worker lives as long as the engine, is none of ours, and a closed engine starts again."""
    first = process_of(engine)
    assert engine.integrate(decay()).success and process_of(engine) == first
    assert first != f"process{os.getpid()}"
    engine.close()
    assert process_of(engine) != first


def test_a_crash_is_an_error_and_the_next_call_works(engine):
    """When Julia dies, the session goes on: an error tells how, then a new process answers."""
    before = process_of(engine)
    with pytest.raises(EngineError, match=r"SIGKILL.*something broke"):
        engine.integrate(decay(DIE))
    assert engine.integrate(decay()).success
    assert process_of(engine) != before


def test_the_words_of_a_crash_are_its_cause_and_not_its_stack(engine):
    """Of sixty lines of a stack none is told; the line that names the fault is."""
    with pytest.raises(EngineError) as caught:
        engine.integrate(decay(CRASH))
    words = str(caught.value)
    assert words.endswith("its last words: [7] signal 11 (1): Segmentation fault")
    assert "SIGSEGV" in words and "unknown function" not in words


def test_a_worker_killed_between_calls_is_replaced(engine):
    """A process that somebody killed is noticed and started anew without an error."""
    before = process_of(engine)
    number = int(before.removeprefix("process"))
    os.kill(number, signal.SIGKILL)
    engine._process._process.wait(timeout=10)
    assert engine.integrate(decay()).success
    assert process_of(engine) != before


@pytest.mark.slow
def test_what_takes_too_long_is_stopped(engine, monkeypatch):
    """A call past its limit is an EngineError in time, and the next call works."""
    monkeypatch.setattr(julia, "GRACE_SECONDS", 0.5)
    assert engine.integrate(decay()).success
    start = time.monotonic()
    with pytest.raises(EngineError, match=r"did not answer within 1 s and was stopped"):
        engine.integrate(decay(HANG, max_seconds=0.5))
    assert time.monotonic() - start < 5
    assert engine.integrate(decay(max_seconds=30.0)).success


def test_an_error_of_julia_is_told_in_its_words(engine):
    """What Julia raises becomes one line without its stack, and the process lives on."""
    before = process_of(engine)
    with pytest.raises(EngineError) as caught:
        engine.integrate(decay(RAISE))
    assert str(caught.value) == "UndefVarError: `foo` not defined"
    assert process_of(engine) == before


def test_what_julia_prints_does_not_harm_the_protocol(engine):
    """Output of Julia or a library, even straight to the descriptor, reaches no message."""
    assert engine.integrate(decay(CHATTER)).success


@pytest.mark.slow
def test_an_answer_that_breaks_off_is_an_error_and_never_half_an_answer(fake_julia, monkeypatch):
    """Wherever the stream of a worker ends inside an answer, the call is an EngineError."""
    answer = pickle.dumps(({"event": "answer"}, {"x": np.arange(3.0)}))
    for length in (1, 11, len(answer) // 2, len(answer) - 1, len(answer)):
        code = f"import os; os.read(0, 1); os.write(1, {answer[:length]!r})"
        monkeypatch.setattr(worker_process, "_start_code", lambda module, code=code: code)
        worker = worker_process.WorkerProcess("none", "julia", dict(os.environ))
        if length == len(answer):
            assert worker.request({}, {}, 9.0, 9.0, print)[1]["x"].tolist() == [0.0, 1.0, 2.0]
        else:
            with pytest.raises(EngineError, match=r"ended unexpectedly .exit code 0."):
                worker.request({}, {}, 9.0, 9.0, print)
        worker.close()


def test_success_is_decided_by_the_states(engine):
    """A solution that Julia calls fine is none when a state is not finite."""
    solved = engine.integrate(decay(NOT_FINITE))
    assert not solved.success and solved.message == "the solution is not finite"
    with pytest.raises(EngineError, match=r"x of shape \(1, 5\) where \(5, 1\)"):
        engine.integrate(decay(WRONG_SHAPE))


def test_a_julia_that_does_not_start_is_unavailable(engine, monkeypatch):
    """A failing start is one line with the remedy, and is tried afresh the next time."""
    monkeypatch.setenv("FAKE_JULIA_START", "fail")
    engine.close()
    with pytest.raises(EngineUnavailable, match=r"PythonCall.jl did not start properly") as caught:
        engine.integrate(decay())
    words = str(caught.value)
    assert words.startswith('Julia does not start: SystemError: opening file "/depot/logs": Read-o')
    assert "\n" not in words and "Project.toml" in words and "deep_" not in words
    monkeypatch.delenv("FAKE_JULIA_START")
    assert engine.integrate(decay()).success


@pytest.mark.slow
def test_a_long_start_shows_its_progress(fake_julia, monkeypatch):
    """While Julia precompiles, a line says so."""
    monkeypatch.setenv("FAKE_JULIA_START", "slow")
    monkeypatch.setattr(worker_process, "QUIET_SECONDS", 0.3)
    lines: list[str] = []
    engine = JuliaEngine(start_seconds=60.0, announce=lines.append)
    assert engine.integrate(decay()).success
    engine.close()
    assert "julia: [ Info: Precompiling Symbolics [0c5d862f]" in lines


def test_an_interrupt_ends_the_call_and_leaves_no_late_answer(engine, monkeypatch):
    """After Ctrl-C during a call, the next call gets its own answer."""
    before = process_of(engine)

    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(worker_process.WorkerProcess, "_wait", interrupt)
        with pytest.raises(KeyboardInterrupt):
            engine.integrate(decay())
    assert np.isclose(engine.integrate(decay()).x[-1, 0], np.exp(-1.0))
    assert process_of(engine) != before


def test_a_program_that_is_no_julia_is_told_in_its_words():
    """What a program says on its standard error is part of the one line."""
    problem = subprocess.CalledProcessError(1, ["julia"], stderr="x\nERROR: no julia here\n")
    assert julia_worker._one_line(problem).endswith("It said: ERROR: no julia here")
    assert len(julia_worker._one_line(RuntimeError("word " * 1000))) <= 600


def test_an_engine_travels_as_settings(engine):
    """A copy in another process is an engine of its own, which starts a Julia of its own."""
    assert engine.integrate(decay()).success
    copy = pickle.loads(pickle.dumps(engine))
    assert copy.start_seconds == 60.0 and copy._process is None


@pytest.fixture
def guest(engine, monkeypatch):
    """Give an engine that asks the one above, as in a process which that one's process started."""
    monkeypatch.setenv(shared.VARIABLE, "")
    engine.share()
    monkeypatch.setattr(shared.os, "getppid", os.getpid)
    guest = JuliaEngine(start_seconds=60.0)
    yield guest
    guest.close()
    engine._host = None


def test_a_process_asks_the_julia_of_the_one_that_started_it(engine, guest):
    """One process answers both engines, at the same time too, and errors arrive as they are."""
    one = process_of(engine)
    assert process_of(guest) == one and isinstance(guest._process, shared.Guest)
    assert guest.regress(LINE).coefficients.round(9).tolist() == [0.0, 2.0]
    with ThreadPoolExecutor(2) as threads:
        solved = list(threads.map(lambda e: e.integrate(decay()).success, [engine, guest] * 20))
    assert len(solved) == 40 and all(solved)
    with pytest.raises(EngineError, match=r"^UndefVarError: `foo` not defined$"):
        guest.integrate(decay(RAISE))
    with pytest.raises(EngineError, match="SIGSEGV"):
        guest.integrate(decay(CRASH))
    assert guest.integrate(decay()).success and process_of(guest) == process_of(engine) != one


@pytest.mark.slow
def test_a_guest_that_gives_up_ends_what_it_asked_for(engine, guest, monkeypatch):
    """Julia is not held by a call that nobody waits for: the next one answers at once."""
    assert guest.integrate(decay()).success
    busy = process_of(engine)
    monkeypatch.setattr(julia, "GRACE_SECONDS", 60.0)
    start = time.monotonic()
    with time_limit(time.monotonic() + 0.7), pytest.raises(TimeUp):
        guest.integrate(decay(HANG))
    assert engine.integrate(decay()).success
    assert time.monotonic() - start < 20 and process_of(engine) != busy
    assert guest.integrate(decay()).success and process_of(guest) == process_of(engine)


def test_why_julia_does_not_start_reaches_a_guest(engine, guest, monkeypatch):
    """The line and the kind of error are the same on both sides of the line."""
    engine.close()
    monkeypatch.setenv("FAKE_JULIA_START", "fail")
    with pytest.raises(EngineUnavailable, match=r"^Julia does not start: SystemError: .*Project"):
        guest.integrate(decay())


@pytest.mark.slow
def test_without_a_host_a_process_starts_its_own(fake_julia, monkeypatch):
    """Where the variable names another process, or one that is gone, nothing is shared."""
    engine = JuliaEngine(start_seconds=60.0)
    for value in ("", "1 00 @nowhere", f"{os.getppid()} 00 @nowhere", f"{os.getppid()} x"):
        monkeypatch.setenv(shared.VARIABLE, value)
        assert engine.integrate(decay()).success
        assert isinstance(engine._process, worker_process.WorkerProcess)
        engine.close()


def test_time_without_end_is_a_limit_too(engine):
    """No limit in seconds reaches Julia as a finite number."""
    assert engine.integrate(decay(max_seconds=float("inf"))).success


def test_a_failing_warm_up_leaves_the_question_open():
    """What is compiled ahead may fail: only the call that was asked for is told about."""

    def fail(*_):
        raise RuntimeError("singular")

    stages: list[str] = []
    session = julia_worker.Session(stages.append)
    session._calls["integrate"] = fail
    session.warm_up({"call": "integrate"}, {})
    session.warm_up({"call": "integrate"}, {})
    assert stages == ["compiling integrate, once a session"]
    with pytest.raises(RuntimeError, match="singular"):
        session.answer({"call": "integrate"}, {})


def test_what_is_compiled_ahead_is_what_is_asked(fake_julia, monkeypatch, tmp_path):
    """An implicit search with two thresholds is warmed by such a one, and each kind only once."""
    log = tmp_path / "calls"
    monkeypatch.setenv("FAKE_JULIA_LOG", str(log))
    engine = JuliaEngine(start_seconds=60.0)
    two = {"threshold": (0.1, 0.2)}
    implicit = SparseProblem(LINE.theta, LINE.dx, "ADMM", two, implicit=True)
    for problem in (LINE, LINE, implicit):
        engine.regress(problem)
    engine.close()
    calls = [line.split()[0] for line in log.read_text().splitlines()]
    assert calls == ["include"] + ["regress-explicit-1"] * 3 + ["regress-implicit-2"] * 2
    stages: list[str] = []
    session = julia_worker.Session(stages.append)
    session._calls["regress"] = lambda *_: None
    header = {"call": "regress", "optimizer": "SR3", "release": "2021", "proximal": "hard"}
    for kind in (False, True, False):
        session.warm_up({**header, "implicit": kind}, {"weights": np.array([0.1])})
    assert stages == [
        "compiling regress explicit SR3 2021 hard, once a session",
        "compiling regress implicit SR3 2021 hard, once a session",
    ]


def test_the_stage_of_the_start_says_what_is_done_with_packages(fake_julia, monkeypatch):
    """With an own project none are installed, and none are announced to be."""
    assert "installed" not in julia_worker._announce_packages()
    monkeypatch.delenv("PYTHON_JULIACALL_PROJECT")
    assert "installed" in julia_worker._announce_packages()


def test_why_diffeqpy_does_not_load_is_told(monkeypatch):
    """Its packages load before the time of a call counts; a failure there is not passed over."""

    def fail():
        raise RuntimeError("no network")

    monkeypatch.setattr(julia_worker, "_load_diffeqpy", fail)
    with pytest.raises(RuntimeError, match="no network"):
        julia_worker.Session(print).warm_up({"call": "diffeqpy"}, {})


@pytest.mark.parametrize(("held", "done"), [("ours", "import"), ("other", "include")])
def test_the_package_is_loaded_where_the_project_holds_it(
    fake_julia, monkeypatch, tmp_path, held, done
):
    """A project that holds this very package loads it compiled; any other includes its file."""
    log, other = tmp_path / "calls", tmp_path / "DynSR.jl"
    other.write_text("module DynSR end")
    ours = find_sources() / "src" / "DynSR.jl"
    monkeypatch.setenv("FAKE_JULIA_LOG", str(log))
    monkeypatch.setenv("FAKE_JULIA_PACKAGE", str(ours if held == "ours" else other))
    engine = JuliaEngine(start_seconds=60.0)
    assert engine.versions()["juliacall"]
    engine.close()
    assert [line.split()[0] for line in log.read_text().splitlines()] == [done]


def test_the_worker_knows_no_torch(engine):
    """Torch is not loaded where Julia runs, whatever the session has loaded."""
    code = (
        "import sys, dynsr.engines.julia.worker; "
        "print([m for m in ('torch', 'matplotlib', 'pandas') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_stand_in_takes_what_julia_takes():
    """The arguments of integrate and regress in Julia are, in order, those tested here."""
    spec = importlib.util.spec_from_file_location("stand_in", FAKE / "juliacall" / "__init__.py")
    stand_in = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(stand_in)
    for name in ("integrate", "integrate_driven", "regress"):
        function = getattr(stand_in, f"_{name}")
        text = (find_sources() / "src" / f"{name.partition('_')[0]}.jl").read_text()
        (arguments,) = re.findall(rf"^function {name}\(([^)]*)\)", text, re.MULTILINE)
        in_julia = [word for word in re.split(r"[,\s]+", arguments) if word]
        assert list(inspect.signature(function).parameters) == in_julia
