import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas
import pytest
import sympy
from command_line import run

from dynsr.cli.results import flatten
from dynsr.data.system import LOTKA_VOLTERRA
from dynsr.discovery import Discovery
from dynsr.errors import InputError
from dynsr.expression.parsing import parse
from dynsr.paper.protocol import paper_method
from dynsr.parameters import FreeParts, RunParameters

T = np.linspace(0.0, 3.0, 151)


def refuse(*words):
    """Run a command line that must end in one line on stderr and exit code 2; give the line."""
    result = run(*words, code=2)
    lines = result.stderr.splitlines()
    assert result.stdout == "" and lines[-1].startswith("error: ")
    assert sum(line.startswith("error: ") for line in lines) == 1
    return lines[-1]


def decay(path, **columns):
    """Write exponential decay (and further columns) as CSV; give its path."""
    pandas.DataFrame({"t": T, "x": 2 * np.exp(-0.5 * T), **columns}).to_csv(path, index=False)
    return path


def broken(row, column, value):
    """Write decay with one cell replaced."""

    def write(path):
        frame = pandas.read_csv(decay(path)).astype(object)
        frame.iloc[row, column] = value
        frame.to_csv(path, index=False)

    return write


def text(content):
    """Write this text or these bytes."""
    return lambda path: path.write_bytes(
        content if isinstance(content, bytes) else content.encode()
    )


def with_columns(**columns):
    """Write decay with further columns."""
    return lambda path: decay(path, **columns)


BAD_DATA = {
    "empty file": (text(""), "is empty"),
    "header alone": (text("t,x\n"), "header but no rows"),
    "three rows": (text("t,x\n0,1\n1,2\n2,4\n"), "3 rows"),
    "wrong delimiter": (
        text("t!x\n" + "".join(f"{i}!{i}\n" for i in range(20))),
        "cannot separate",
    ),
    "ragged rows": (text("t,x\n" + "1,2\n" * 9 + "1,2,3\n"), "one cell a column"),
    "duplicate time": (broken(5, 0, T[4]), "repeats in row 6"),
    "unsorted time": (broken(5, 0, 0.01), "runs backwards at row 6"),
    "few values": (broken(slice(7, None), 1, np.nan), "'x' has 7 values in the 151 rows"),
    "infinite value": (broken(7, 1, np.inf), "holds inf in row 8"),
    "text cell": (broken(7, 1, "broken"), "has the text 'broken' in row 8"),
    "code in a cell": (broken(7, 1, "__import__('os')"), "has the text"),
    "constant column": (broken(slice(0, None), 1, 1.0), "'x' of data.csv is 1 in every row"),
    "binary": (text(bytes(range(256)) * 9), "is binary"),
    "Excel": (text(b"PK\x03\x04" + bytes(99)), "zip or Excel"),
    "directory": (lambda path: path.mkdir(), "is a directory"),
    "missing": (lambda path: None, "there is no file"),
    "time alone": (text("t\n" + "\n".join(map(str, range(20)))), "no column left for a state"),
    "no time": (text("a,b\n" + "1,2\n" * 12), "looks like the time"),
}


@pytest.mark.parametrize("case", BAD_DATA)
def test_bad_data_end_in_one_line(tmp_path, monkeypatch, case):
    """Data that cannot be used end in one line that names what is wrong, and exit code 2."""
    monkeypatch.chdir(tmp_path)
    write, said = BAD_DATA[case]
    write(tmp_path / "data.csv")
    assert said in refuse("discover", "data.csv")
    assert not (tmp_path / "data-dynsr").exists()


ODD_DATA = {
    "identical columns": ({"y": 2 * np.exp(-0.5 * T)}, "are identical"),
    "units a billion apart": ({"y": 1e9 * np.sin(T)}, "units that bring them closer"),
    "function name": ({"sin": np.sin(T)}, "'sin' -> sin_1"),
    "no identifier": ({"2nd y": np.sin(T)}, "'2nd y' -> x2nd_y"),
    "code as name": ({"__import__('os')": np.sin(T)}, "-> import_os"),
}


@pytest.mark.parametrize("case", ODD_DATA)
def test_odd_data_are_used_with_a_warning(tmp_path, monkeypatch, seen, case):
    """Data that are odd but usable reach the search, and one line says what is odd."""
    monkeypatch.chdir(tmp_path)
    columns, said = ODD_DATA[case]
    result = run("discover", decay(tmp_path / "data.csv", **columns), "--json")
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    assert said in line
    assert len(seen["data"][0].states) == 2


class Found:
    """A discovery that finds decay whatever the data."""

    equations = {"x": sympy.Float(-0.5) * sympy.Symbol("x")}
    errors = {"x": ((-0.5, 0.001),)}
    explanation = {"x": "the only one"}
    front = {}
    inputs = {}
    seconds = 0.25
    complete = True
    verdict = Discovery({}, {}, {}, {}).verdict
    heading = "No verdict."
    constants = {}
    details = {}
    ensemble = {}
    by_run = RunParameters()
    delays = {}
    free = FreeParts()
    volumes = {}
    volume_notes = ()
    hidden = {}
    hidden_notes = {}
    diffusion = {}
    noise_notes = {}
    further = {}
    trajectories = ()

    def __init__(self, settings):
        """Keep the settings."""
        self.settings = {**settings, **self.further}

    def save(self, path):
        """Write a mark."""
        path.write_text("{}")
        return path

    def report(self, path):
        """Write a mark."""
        path.write_text("<html>")
        return path

    def score(self, data):
        """Give scores, one of them infinite."""
        return {"x": {"slope_rmse": 0.5, "forecast": 0.25, "trajectory_rmse": float("inf")}}


@pytest.fixture
def seen(monkeypatch):
    """Put a search in place that finds at once, and give what it was called with."""
    import dynsr.discovery

    calls = {}

    def discover(data, *, progress, **options):
        calls.update(options, data=data)
        progress(dynsr.discovery.search.Step("x' by fake", 1, 1, None, "-0.5*x  (error 0.1)"))
        return Found({"engine": options["engine"], "seed": options["seed"], "methods": ["fake"]})

    monkeypatch.setattr(dynsr.discovery, "discover", discover)
    return calls


def test_options_reach_the_search(tmp_path, seen):
    """Every option of the command reaches the search under its name."""
    path = decay(tmp_path / "data.csv", u=np.sin(T), v=np.cos(T))
    words = ["discover", path, "--states", "x,v", "--inputs", "u", "--inputs", "F=2*t"]
    words += ["--method", "sindy", "--preset", "quick", "--targets", "x", "--seed", 7, "-j", 1]
    words += ["--scheme", "central4", "--functions", "exp,/", "--max-complexity", 40]
    words += ["--terms", "x*v", "--constraint", "x: v < 0", "--conserved", "x+v"]
    words += [
        "--nonnegative",
        "x,v",
        "--time-budget",
        60,
        "--no-snap",
        "--order",
        2,
        "--explicit-time",
    ]
    words += ["--complexity", "sin=8", "--loss", "huber", "--must", "x: x*v", "--start", "old"]
    words += ["--units", "x=m,t=s", "--ensemble", "--vary", "x"]
    words += ["--observed", "v=w + x", "--delays", "1.5", "--hidden", "y"]
    words += ["--known", "x'=-0.1*x", "--out", tmp_path / "kept", "--json"]
    found = json.loads(run(*words).stdout)
    (data,) = seen.pop("data")
    assert data.states == ("x", "v") and data.input_names == ("u",)
    assert seen == {
        "functions": ["exp", "/"],
        "max_complexity": 40.0,
        "terms": ["x*v"],
        "constraints": ["x: v < 0"],
        "conserved": ["x+v"],
        "nonnegative": ["x", "v"],
        "time_budget": 60.0,
        "units": "x=m,t=s",
        "ensemble": True,
        "vary": ["x"],
        "delays": [1.5],
        "hidden": "y",
        "stochastic": False,
        "observed": {"v": "w + x"},
        "complexity": {"sin": 8.0},
        "loss": "huber",
        "must": ["x: x*v"],
        "start": Path("old"),
        "method": "sindy",
        "preset": "quick",
        "scheme": "central4",
        "targets": ["x"],
        "inputs": {"F": "2*t"},
        "doses": None,
        "known": {"x": "-0.1*x"},
        "snap": False,
        "order": 2,
        "explicit_time": True,
        "discrete": False,
        "seed": 7,
        "jobs": 1,
        "engine": "embedded",
        "out": tmp_path / "kept",
    }
    assert found["equations"] == {"x": "-0.5*x"} and found["seed"] == 7
    assert found["engine"] == "embedded" and found["seconds"] == 0.25
    scores = {"slope_rmse": 0.5, "forecast": 0.25, "trajectory_rmse": None}
    assert found["scores"]["data"] == {"x": scores}
    assert found["complete"] and found["warned"] == []
    assert "data.csv: time 't'" in found["guessed"][0]
    assert [Path(path).exists() for path in found["files"]] == [True, True]


def test_readers_get_equations_and_a_report(tmp_path, monkeypatch, seen):
    """With --details: equations first, then the reason, explained scores, the guess, the files.
    Without it neither scores nor the guess, which was shown at the start, come on stdout.
    """
    monkeypatch.chdir(tmp_path)
    short = run("discover", decay(tmp_path / "data.csv"))
    assert short.stdout.startswith("No verdict.\nx' = -0.5*x\nx: the only one")
    assert "slope error" not in short.stdout and "guessed" not in short.stdout
    result = run("discover", tmp_path / "data.csv", "--details", "--out", "more")
    guess = "data.csv: time 't', 151 rows from 0 to 3 every 0.02; states x"
    places = [
        result.stdout.index(words)
        for words in ("x' = -0.5*x", "x: the only one", "slope error", "diverges", "forecast error")
    ]
    assert result.stdout.startswith("No verdict.\nx' = -0.5*x\n") and places[:-1] == sorted(
        places[:-1]
    )
    assert "1 = the state's spread" in result.stdout
    assert guess in result.stderr and f"guessed: {guess}" in result.stdout.replace(
        str(tmp_path) + os.sep, ""
    )
    assert "x' by fake: -0.5*x  (error 0.1)" in result.stderr
    page = os.path.join("data-dynsr", "report.html")
    assert f"saved in data-dynsr: discovery.json; open {page}\n" in short.stderr
    assert (tmp_path / "data-dynsr" / "report.html").exists()


def test_a_terminal_gets_the_equations_in_a_frame(monkeypatch, capsys):
    """On a terminal the equations are in a frame; a warning is repeated at the end."""
    from rich.console import Console

    from dynsr.cli import output
    from dynsr.cli.discovery import show_equations, show_reasons

    wide = Console(force_terminal=True, width=80, highlight=False, color_system=None)
    monkeypatch.setattr(output, "console", lambda stderr=False: wide)
    told = {"guessed": ["time 't'"], "warned": ["columns are identical"]}
    show_equations(Found({}))
    show_reasons(Found({}), {}, told)
    shown = capsys.readouterr().out
    assert shown.startswith("╭─") and "│ No verdict. │" in shown and "│ x' = -0.5*x" in shown
    assert "warned: columns are identical" in shown and "guessed: time 't'" not in shown


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.slow
def test_a_warning_is_shown_once_in_one_place(tmp_path, apart):
    """On one terminal or in one file it is there once; apart, it is with the results too."""
    code = (
        "from types import SimpleNamespace as N; from dynsr.cli.discovery import show_reasons; "
        "show_reasons(N(explanation={}, delays={}, hidden_notes={}, noise_notes={}, "
        "volume_notes=(), ensemble={}, details={}, settings={}, constants={}, "
        "verdict=N(states={}), free=N(sentences=[]), by_run=N(constants={})), {}, "
        "{'warned': ['once']})"
    )
    own = subprocess.PIPE if apart else subprocess.STDOUT
    ran = subprocess.run(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=own, text=True, check=True
    )
    assert ("warned: once" in ran.stdout) is apart


def test_equations_are_shown_before_files_are_made(tmp_path, monkeypatch, seen):
    """The report takes longer than many a search; a disk that is full then hides no result."""
    monkeypatch.chdir(tmp_path)

    def full(found, folder):
        raise InputError("no space left on the device; choose another folder with --out")

    monkeypatch.setattr("dynsr.cli.discovery.keep", full)
    result = run("discover", decay(tmp_path / "data.csv"), code=2)
    assert "x' = -0.5*x" in result.stdout and "no space left" in result.stderr


def test_quiet_leaves_the_verdict_and_the_equations(tmp_path, monkeypatch, seen):
    """With --quiet stdout is the verdict and the equations, one a line, and stderr is empty."""
    monkeypatch.chdir(tmp_path)
    result = run("discover", decay(tmp_path / "data.csv"), "--quiet")
    assert (result.stdout, result.stderr) == ("No verdict.\nx' = -0.5*x\n", "")


def test_quiet_keeps_what_changes_the_meaning_of_an_answer(tmp_path, monkeypatch, seen):
    """An interrupted search, a budget that ended it and odd data are told with --quiet too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Found, "heading", Discovery({}, {}, {}, {}, complete=False).heading)
    monkeypatch.setattr(Found, "further", {"ended_by_budget": ["search-x-sindy"]})
    result = run("discover", decay(tmp_path / "data.csv", y=2 * np.exp(-0.5 * T)), "--quiet")
    assert result.stdout.startswith("The search was interrupted; the best so far.")
    assert "budget ended a step" in result.stderr and "are identical" in result.stderr


def test_long_fractions_are_shown_as_decimals(capsys):
    """981/100 is written 9.81; 8/3 stays."""
    from dynsr.cli.discovery import show_equations

    found = Found({})
    x = sympy.Symbol("x")
    found.equations = {"x": sympy.Rational(981, 100) * x - sympy.Rational(8, 3) * x**2 / 1}
    show_equations(found, quiet=True)
    shown = capsys.readouterr().out.splitlines()[1]
    assert shown in ("x' = -8*x**2/3 + 9.81*x", "x' = 9.81*x - 8*x**2/3")


def test_json_keeps_nothing_unasked(tmp_path, monkeypatch, seen):
    """With --json and no folder nothing is written; --quiet leaves stderr empty."""
    monkeypatch.chdir(tmp_path)
    result = run("discover", "--system", "cart-pole", "--json", "-q", "--target", "z")
    found = json.loads(result.stdout)
    assert result.stderr == "" and not list(tmp_path.iterdir())
    assert set(found["scores"]["truth"]["x"]) == {
        "equation_rmse",
        "printed_loss",
        "trajectory_loss",
    }
    assert seen["data"][0].input_names == ("F",) and set(seen["inputs"]) == {"F"}


def test_the_papers_loss_is_its_own_systems_alone(tmp_path, monkeypatch, seen):
    """A known system that the paper lacks has the general losses, in JSON and in the table."""
    monkeypatch.chdir(tmp_path)
    found = json.loads(run("discover", "--system", "lorenz", "-q", "--json").stdout)
    for scores in found["scores"]["truth"].values():
        assert set(scores) == {"equation_rmse", "trajectory_loss"}
    shown = run("discover", "--system", "lorenz").stdout
    assert "test error" in shown and "paper's loss" not in shown
    assert "paper's loss" in run("discover", "--system", "cart-pole").stdout


def test_the_paper_preset_of_a_system(seen):
    """A system of the paper gets the paper's own settings, another the names as they are."""
    run("discover", "--system", "lotka-volterra", "--preset", "paper", "--json", "-q")
    found = {method.name: method for method in seen["method"]}
    assert set(found) == {"dynaifeynman", "genetic", "sindy"} and seen["scheme"] is None
    assert found["sindy"] == paper_method("sindy", LOTKA_VOLTERRA)
    assert found["genetic"] == paper_method("ga", LOTKA_VOLTERRA)
    run(
        "discover",
        "--system",
        "lotka-volterra",
        "--preset",
        "paper",
        "--method",
        "ga",
        "--json",
        "-q",
    )
    assert [method.name for method in seen["method"]] == ["genetic"]
    run("discover", "--system", "lorenz", "--preset", "paper", "--method", "ga", "--json", "-q")
    assert seen["method"] == "ga" and seen["preset"] == "paper"


def test_a_folder_that_cannot_be_written(tmp_path):
    """A folder for the results that is a file is refused before the search."""
    path = decay(tmp_path / "data.csv")
    assert "cannot write to folder" in refuse("discover", path, "--out", path)


def test_scores_as_lines():
    """Nested scores become lines with the path as their name."""
    assert list(flatten({"a": {"b": 1, "c": {"d": None}}})) == [("a b", 1), ("a c d", None)]


def test_columns_go_with_a_file():
    """Options about columns are refused beside a known system, which has its own."""
    for option, value in (("--time", "t"), ("--states", "x"), ("--inputs", "F=t")):
        line = refuse("discover", "--system", "lorenz", option, value)
        assert f"{option} goes with a file" in line


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Discover decay for real and keep it; gives the data and the saved discovery."""
    from dynsr.discovery.search import discover

    folder = tmp_path_factory.mktemp("kept")
    data = decay(folder / "data.csv")
    discover(str(data), method="rational", jobs=1).save(folder / "discovery.json")
    return data, folder / "discovery.json"


@pytest.mark.slow
def test_score_of_a_saved_discovery(kept):
    """A saved discovery is scored on other data; its folder stands for it."""
    data, saved = kept
    found = json.loads(run("score", saved, data, "--json").stdout)
    assert found["x"]["trajectory_rmse"] < 1e-4
    assert "trajectory_rmse" in run("score", saved.parent, data).stdout
    assert "unknown state 'x'" in refuse("score", saved, decay_of_y(data.parent / "y.csv"))


def decay_of_y(path):
    """Write data that have no state x."""
    pandas.DataFrame({"t": T, "y": np.exp(-T)}).to_csv(path, index=False)
    return path


def test_simulate_a_saved_discovery(kept):
    """A saved discovery is integrated from another start, by default from that of its data."""
    _, saved = kept
    found = json.loads(run("simulate", saved, "--x0", "4", "--span", "0,2", "--json").stdout)
    t, x = np.array(found["columns"]["t"]), np.array(found["columns"]["x"])
    assert np.allclose(x, 4 * np.exp(-0.5 * t), rtol=1e-3)
    again = json.loads(run("simulate", saved, "--json").stdout)["columns"]
    assert again["t"][0] == 0.0 and again["t"][-1] == pytest.approx(T[-1])
    assert np.allclose(again["x"], again["x"][0] * np.exp(-0.5 * np.array(again["t"])), rtol=1e-3)
    assert "leave --reltol" in refuse("simulate", saved, "--reltol", "1e-3")


def test_report_of_a_saved_discovery(kept, tmp_path):
    """A saved discovery is reported on as one page."""
    found = json.loads(run("report", kept[1], "-o", tmp_path / "page.html", "--json").stdout)
    assert "<html" in Path(found["report"]).read_text(encoding="utf-8")


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"format": "other"}', "\0\1", "x,y\n"])
def test_files_that_are_no_discovery(kept, tmp_path, content):
    """A file that is no discovery, or the first half of one, is refused in one line."""
    data, saved = kept
    path = tmp_path / "cut.json"
    path.write_text(content)
    for words in (("score", path, data), ("simulate", path, "--x0", "1"), ("report", path)):
        assert "cut.json" in refuse(*words)
    path.write_bytes(saved.read_bytes()[:200])
    assert "cut.json" in refuse("score", path, data)


def start_search(path, out, *words):
    """Start a search in a process group of its own; wait until one task has ended."""
    words = [sys.executable, "-m", "dynsr", "discover", path, "-o", out, *words]
    child = subprocess.Popen(
        [str(word) for word in words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not list((out / "records").glob("search*")):
        assert child.poll() is None
        time.sleep(0.05)
    return child


@pytest.mark.slow
def test_interrupt_of_a_search_is_130(tmp_path):
    """Ctrl-C ends a search with its best so far, saved, and 130; the same command goes on."""
    path = decay(tmp_path / "data.csv", y=np.sin(3 * T), z=np.cos(T) * T)
    child = start_search(path, tmp_path / "kept", "-j", "2")
    os.killpg(child.pid, signal.SIGINT)
    out, errors = child.communicate(timeout=60)
    assert child.returncode == 130, (out, errors)
    assert "Traceback" not in errors and "x' = " in out
    assert "the same command goes on from there" in errors
    saved = json.loads((tmp_path / "kept" / "discovery.json").read_text())
    assert saved["equations"] and not saved["complete"]


def test_a_second_interrupt_ends_at_once():
    """Ctrl-C pressed again does not wait for what the first one began."""
    code = (
        "import typer, time\n"
        "from dynsr.cli.group import CommandGroup\n"
        "app = typer.Typer(cls=CommandGroup)\n"
        "app.callback()(lambda: None)\n"
        "@app.command()\n"
        "def wait():\n"
        "    for words in ('once', 'more'):\n"
        "        try:\n"
        "            print(words, flush=True); time.sleep(60)\n"
        "        except KeyboardInterrupt: pass\n"
        "app(['wait'])"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    for words in ("once", "more"):
        assert child.stdout.readline().strip() == words
        child.send_signal(signal.SIGINT)
    _out, errors = child.communicate(timeout=20)
    assert (child.returncode, errors) == (130, "error: interrupted twice\n")


@pytest.mark.slow
def test_another_discovery_gets_a_folder_of_its_own(tmp_path, monkeypatch):
    """A default folder that holds another discovery is left alone; one asked for is refused."""
    monkeypatch.chdir(tmp_path)
    t = np.linspace(0, 1, 101)
    pandas.DataFrame({"t": t, "x": t}).to_csv("line.csv", index=False)
    words = ("discover", "line.csv", "--method", "sindy", "-j", 1, "-q")
    monkeypatch.setattr("dynsr.cli.discovery.keep", lambda found, folder: [])
    for seed in (0, 1, 0, 1):
        result = run(*words[:-1], "--seed", seed)
        said = "holds results with seed 0, not 1; this one goes to 'line-dynsr-2'"
        assert (said in result.stderr) == (seed == 1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["line-dynsr", "line-dynsr-2", "line.csv"]
    assert "give another folder" in refuse(*words, "--seed", 2, "-o", "line-dynsr")


def test_equations_that_are_not_found_have_no_intervals(capsys):
    """A reason that states share is there once, whatever its numbers, and intervals of constants
    of equations that the data refuse are details.
    """
    from dynsr.cli.discovery import show_equations, show_reasons
    from dynsr.verdict.levels import StateVerdict, summarise

    words = "the equations do not reproduce the data (R2 {})."
    states = {
        "x": StateVerdict("not found", words.format(0.31), 0.31),
        "y": StateVerdict("not found", words.format(0.42), 0.42),
        "z": StateVerdict("law", "reproduces the data.", 1.0),
    }
    found = Discovery(
        dict(zip(states, map(parse, ("-2*x", "-3*y", "-4*z")), strict=True)),
        {"x": ((-2.0, 0.1),), "y": ((-3.0, 0.1),), "z": ((-4.0, 0.1),)},
        {},
        {s: f"{s}' = 1: {own.level}; {own.reason} Found by sums." for s, own in states.items()},
        verdict=summarise(states, 1.0),
    )
    show_equations(found)
    show_reasons(found, {}, {})
    short = capsys.readouterr().out
    assert short.count("do not reproduce") == 1
    assert "z'  z" in short and "x'  x" not in short and "y'  y" not in short
    show_reasons(found, {}, {}, details=True)
    assert "y'  y" in capsys.readouterr().out


def test_a_reason_is_printed_once(monkeypatch, capsys):
    """The line of an equation that is no law gives its reason only where the verdict does not; a
    law has no line, but with details.
    """
    from types import SimpleNamespace

    from dynsr.cli.discovery import show_reasons
    from dynsr.verdict.levels import StateVerdict, summarise

    states = {
        "x": StateVerdict("law", "reproduces the data.", 1.0),
        "y": StateVerdict("not found", "it diverges.", -1.0),
        "z": StateVerdict("approximation", "a forecast is off.", 0.9),
    }
    found = SimpleNamespace(
        verdict=summarise(states, 1.0),
        heading="Not found: y: it diverges.",
        explanation={
            state: f"{state}' = 1: {own.level}; {own.reason} Found by sums. A note."
            for state, own in states.items()
        },
        constants={},
        ensemble={},
        by_run=RunParameters(),
        free=FreeParts(),
        delays={},
        volume_notes=(),
        hidden_notes={},
        noise_notes={},
        details={},
        settings={},
    )
    show_reasons(found, {}, {})
    short = capsys.readouterr().out
    assert short == "y: A note.\nz: approximation; a forecast is off. A note.\n"
    show_reasons(found, {}, {}, details=True)
    assert "x' = 1: law; reproduces the data." in capsys.readouterr().out
