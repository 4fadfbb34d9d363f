"""The engine that was asked for is the engine that runs, and records name the one that ran."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import run

import dynsr
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.estimator import DynsrRegressor
from dynsr.discovery.result import Discovery
from dynsr.discovery.search import discover
from dynsr.engines import registry
from dynsr.engines.julia import setup as julia_setup
from dynsr.engines.registry import find_engine, share_engine
from dynsr.engines.testing import RecordingEngine
from dynsr.errors import EngineUnavailable, InputError, say_install
from dynsr.methods.genetic import GeneticAlgorithm
from dynsr.methods.sindy import SINDy
from dynsr.verdict.prediction import MEASURED, predict

T = np.linspace(0.0, 3.0, 61)
FAKE = Path(__file__).parent / "fake_julia"
SINDY = {"method": "sindy", "preset": "quick", "functions": (), "jobs": 1}


def decay(count: int = 1) -> Trajectory:
    """One or more states that decay, each at a rate of its own."""
    x = np.column_stack([2 * np.exp(-0.5 * (i + 1) * T) for i in range(count)])
    return Trajectory(T, x, ("x", "y", "z")[:count])


@pytest.fixture
def no_julia(monkeypatch):
    """Take Julia away."""
    monkeypatch.setattr(julia_setup.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(registry, "_STARTED", {})


@pytest.fixture
def julia(monkeypatch):
    """Put an engine that keeps what it is asked in the place of Julia."""
    engine = RecordingEngine("julia")
    monkeypatch.setitem(registry._STARTED, "julia", engine)
    return engine


@pytest.fixture
def table(tmp_path):
    """Write decay as a table."""
    path = tmp_path / "x.csv"
    path.write_text("t,x\n" + "".join(f"{t},{2 * np.exp(-0.5 * t)}\n" for t in T))
    return path


def test_an_unknown_engine_is_refused_before_any_work(tmp_path):
    """The names are listed before the data are looked at or a folder is made."""
    with pytest.raises(InputError, match="unknown engine 'nonsense'; the engines are: embedded, j"):
        discover("no such file.csv", engine="nonsense", out=tmp_path / "kept")
    assert not list(tmp_path.iterdir())


def test_an_absent_engine_is_refused_before_any_work(no_julia, tmp_path):
    """Without Julia there is no discovery that says it used it; the remedy is named."""
    with pytest.raises(EngineUnavailable, match=re.escape(f"run {say_install('julia')}")):
        discover("no such file.csv", engine="julia", out=tmp_path / "kept")
    with pytest.raises(EngineUnavailable, match="dynsr"):
        discover(decay(), method=SINDy(engine="julia"), out=tmp_path / "kept")
    with pytest.raises(EngineUnavailable, match="dynsr"):
        DynsrRegressor(engine="julia").fit(T[:, None], T)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("engine", "words"), [("nonsense", "unknown engine 'nonsense'"), ("julia", "pip install")]
)
def test_the_shell_refuses_in_one_line(no_julia, table, monkeypatch, engine, words):
    """Unknown or absent, the command ends with code 2 and one line, and makes no folder."""
    monkeypatch.chdir(table.parent)
    result = run("discover", "x.csv", "--engine", engine, code=2)
    assert words in result.stderr and result.stderr.count("\n") == 1
    assert [path.name for path in table.parent.iterdir()] == ["x.csv"]


def test_the_engine_regresses_simulates_and_scores(julia):
    """Asked for by name it does each of the three, and nothing that the record denies it."""
    found = discover(decay(), engine="julia", **SINDY)
    assert str(found.equations["x"]) == "-0.5*x"
    searched = len(julia.regressed)
    assert searched > 5 and found.settings["engine"] == "julia"
    assert found.settings["engines"] == {
        "regress": "julia",
        "fit": "embedded (multiple shooting)",
        "forecast": "embedded (multiple shooting)",
        "simulate": "julia",
        "bands": "embedded (a curve for each draw of the constants)",
    }
    before = len(julia.integrated)
    assert found.simulate().origin["engine"] == "julia"
    assert len(julia.integrated) == before + 1
    assert found.score()["x"]["trajectory_rmse"] < 1e-6
    assert len(julia.integrated) == before + 2
    assert len(julia.regressed) == searched


@pytest.mark.slow
def test_the_report_draws_what_the_engine_integrated(julia, tmp_path):
    """The curve and the score of the report come from the discovery's engine."""
    found = discover(decay(), engine="julia", **SINDY)
    before = len(julia.integrated)
    page = found.report(tmp_path / "report.html").read_text("utf-8")
    assert len(julia.integrated) == before + 2
    assert "regress: julia" in page and "simulate: julia" in page


def test_the_embedded_engine_is_asked_for_nothing_else(julia):
    """Without an engine named, the other one is not touched."""
    found = discover(decay(), **SINDY)
    found.simulate()
    assert found.settings["engines"]["regress"] == found.settings["engine"] == "embedded"
    assert not julia.regressed and not julia.integrated


@pytest.mark.slow
def test_a_discovery_in_the_shell_regresses_on_the_engine(julia, table, tmp_path):
    """dynsr discover --engine julia --method sindy; its saved result keeps the engine."""
    words = ("discover", table, "--engine", "julia", "--method", "sindy", "--functions", "")
    found = json.loads(run(*words, "-j", 1, "--json", "-q", "--out", tmp_path / "kept").stdout)
    assert (
        julia.regressed and found["engine"] == found["settings"]["engines"]["simulate"] == "julia"
    )
    saved = tmp_path / "kept" / "discovery.json"
    count = len(julia.integrated)
    run("simulate", saved, "--x0", 1, "--span", "0,1")
    run("score", saved, table)
    assert len(julia.integrated) == count + 2
    run("simulate", saved, "--x0", 1, "--span", "0,1", "--engine", "embedded")
    run("score", saved, table, "--engine", "embedded")
    assert len(julia.integrated) == count + 2


@pytest.mark.slow
def test_the_name_travels_to_worker_processes(tmp_path):
    """Two workers find one Julia by the name, that of the process that started them."""
    log = tmp_path / "calls"
    code = (
        "import numpy as np, dynsr\n"
        "t = np.linspace(0, 3, 41)\n"
        "x = {'t': t, 'x': 2 * np.exp(-t / 2), 'y': np.exp(-t)}\n"
        "found = dynsr.discover(\n"
        "    x, engine='julia', method='sindy', preset='quick', functions=(), jobs=2\n"
        ")\n"
        "found.simulate()\n"
        "print(found.settings['engines']['regress'], dynsr.find_engine('julia').name)\n"
    )
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(FAKE), str(Path(dynsr.__file__).parents[1])]),
        "PYTHON_JULIACALL_EXE": sys.executable,
        "PYTHON_JULIACALL_PROJECT": str(tmp_path),
        "FAKE_JULIA_LOG": str(log),
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["julia", "julia"]
    calls = [line.split() for line in log.read_text().splitlines()]
    regressing, integrating = (
        {process for call, process in calls if call.startswith(verb)}
        for verb in ("regress", "integrate")
    )
    assert len(regressing) == 1 and regressing == integrating


@pytest.mark.slow
def test_an_engine_of_ones_own_is_used():
    """An engine may be handed over; it regresses and integrates, and its name is recorded."""
    engine = RecordingEngine("mine")
    found = discover(decay(), engine=engine, **SINDY)
    assert found.settings["engine"] == "mine" and engine.regressed
    assert found.simulate().origin["engine"] == "mine" and engine.integrated
    regressor = DynsrRegressor(method="sindy", engine=engine)
    before = len(engine.regressed)
    regressor.fit(T[:, None] + 1, 3 * (T + 1))
    assert len(engine.regressed) > before


@pytest.mark.slow
def test_a_method_keeps_the_engine_that_it_was_given():
    """SINDy with an engine of its own regresses there; the record names both engines."""
    own, asked = RecordingEngine("own"), RecordingEngine("asked")
    found = discover(decay(), method=SINDy.preset("best", engine=own), engine=asked, jobs=1)
    assert own.regressed and not asked.regressed
    assert found.settings["engines"]["regress"] == "own"
    assert found.settings["engines"]["simulate"] == found.settings["engine"] == "asked"
    assert GeneticAlgorithm().with_engine(asked) == GeneticAlgorithm()


class Tied(RecordingEngine):
    """An engine that holds what cannot be copied."""

    def __init__(self):
        """Hold a function without a name."""
        super().__init__("tied")
        self.hold = lambda: None


@pytest.mark.slow
def test_an_engine_that_cannot_be_copied_stays_in_its_process():
    """It works with one job; with more one line says why not, before any work."""
    engine = Tied()
    line = "engine 'tied' cannot be copied into worker processes .*; use jobs=1"
    with pytest.raises(InputError, match=line):
        discover(decay(2), engine=engine, method="sindy", jobs=2)
    with pytest.raises(InputError, match=line):
        discover(decay(2), method=SINDy.preset("best", engine=engine), jobs=2)
    assert not engine.regressed
    found = discover(decay(2), engine=engine, **SINDY)
    assert engine.regressed and found.settings["engine"] == "tied"


def test_what_stands_for_an_engine_elsewhere():
    """A name where it gives the same engine, else the engine; whatever answers to the name."""
    assert share_engine(find_engine("embedded"), 8) == "embedded"
    stranger = RecordingEngine("embedded")
    assert share_engine(stranger, 8) is stranger
    assert repr(stranger) == "RecordingEngine('embedded')"


def test_a_saved_discovery_keeps_its_engine(julia, no_julia_after, tmp_path):
    """Loaded where the engine is absent it refuses to simulate, unless another one is named."""
    found = discover(decay(), engine="julia", **SINDY)
    again = Discovery.load(found.save(tmp_path / "found.json"))
    assert again.engine == "julia"
    no_julia_after()
    with pytest.raises(EngineUnavailable, match="pip install"):
        again.simulate([1.0], T)
    with pytest.raises(EngineUnavailable, match="pip install"):
        again.score(decay())
    assert again.simulate([1.0], T, engine="embedded").origin["engine"] == "embedded"


@pytest.fixture
def no_julia_after(monkeypatch):
    """Give a call that takes Julia away."""

    def take_away():
        monkeypatch.setattr(julia_setup.importlib.util, "find_spec", lambda name: None)
        monkeypatch.setattr(registry, "_STARTED", {})

    return take_away


@pytest.mark.slow
def test_measured_inputs_are_integrated_where_the_record_says(julia):
    """By the embedded engine unless another one is asked for, which the origin then names."""
    force = np.sin(2 * T)
    x = predict({"x": dynsr.parse("u - x")}, [1.0], T, {"u": force})
    assert x.origin["engine"] == MEASURED and not julia.integrated
    data = Trajectory(T, x.x, ("x",), force[:, None], ("u",))
    plain = discover(data, method="rational", preset="quick", functions=(), jobs=1)
    assert plain.settings["engines"]["simulate"] == MEASURED == plain.simulate().origin["engine"]
    assert not julia.regressed and not julia.integrated
    found = discover(data, engine="julia", **SINDY)
    assert found.settings["engines"]["simulate"] == "julia (on measured inputs)"
    assert found.simulate().origin["engine"] == "julia (on measured inputs)"
    assert julia.regressed and len(julia.integrated) == 2
