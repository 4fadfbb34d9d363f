import inspect
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_line import run

from dynsr.checks import doctor
from dynsr.cli.progress import SearchProgress
from dynsr.engines import START_NOTES
from dynsr.engines.julia import process as worker_process
from dynsr.engines.julia import setup as julia_setup
from dynsr.engines.julia.diffeqpy import DiffeqpyEngine
from dynsr.engines.julia.engine import JuliaEngine
from dynsr.engines.julia.setup import find_missing, find_sources
from dynsr.engines.registry import find_engine
from dynsr.errors import EngineError, EngineUnavailable, say_install

ROOT = Path(__file__).parents[1]
FAKE = Path(__file__).parent / "fake_julia"
pytestmark = pytest.mark.skipif(os.name != "posix", reason="the stand-in is a POSIX program")


@pytest.fixture
def fake_julia(monkeypatch, tmp_path):
    """Put the stand-in for juliacall on the path, as a Julia of the user's own."""
    monkeypatch.syspath_prepend(str(FAKE))
    monkeypatch.setenv("PYTHON_JULIACALL_EXE", sys.executable)
    monkeypatch.setenv("PYTHON_JULIACALL_PROJECT", str(tmp_path))


def test_without_juliacall_the_engine_is_unavailable(monkeypatch):
    """The message says what to install, within two seconds; nothing else is used instead."""
    monkeypatch.setattr(julia_setup.importlib.util, "find_spec", lambda name: None)
    inspect.unwrap(find_engine).__globals__["_STARTED"].pop("julia", None)
    start = time.monotonic()
    with pytest.raises(EngineUnavailable, match=re.escape(say_install("julia"))):
        find_engine("julia")
    assert time.monotonic() - start < 2


@pytest.mark.parametrize(
    ("program", "project", "words"),
    [
        (None, ".", "PYTHON_JULIACALL_PROJECT is set without PYTHON_JULIACALL_EXE; set both"),
        (sys.executable, None, "PYTHON_JULIACALL_EXE is set without PYTHON_JULIACALL_PROJECT"),
        ("/no/julia", ".", "PYTHON_JULIACALL_EXE names no program: '/no/julia'"),
        (sys.executable, "/no/project", "PYTHON_JULIACALL_PROJECT does not exist: '/no/project'"),
        (sys.executable, ".", ""),
        (None, None, "dynsr doctor --install"),
    ],
)
def test_settings_of_the_environment_are_checked(fake_julia, monkeypatch, program, project, words):
    """Half a setting, or one that points nowhere, is told in one line before anything starts."""
    monkeypatch.setattr(julia_setup, "_is_resolved", lambda: False)
    for name, value in (("EXE", program), ("PROJECT", project)):
        monkeypatch.delenv(f"PYTHON_JULIACALL_{name}")
        if value is not None:
            monkeypatch.setenv(f"PYTHON_JULIACALL_{name}", value)
    found = find_missing()
    assert words in found and bool(words) == bool(found)


def test_settings_that_juliapkg_refuses_are_told(fake_julia, monkeypatch):
    """A setting of juliapkg's own that it cannot use is one line, not its stack."""
    for name in ("EXE", "PROJECT"):
        monkeypatch.delenv(f"PYTHON_JULIACALL_{name}")

    def refuse():
        raise Exception("PYTHON_JULIAPKG_PROJECT must be an absolute path")

    monkeypatch.setattr(julia_setup, "_is_resolved", refuse)
    assert find_missing() == (
        "juliapkg refuses its settings: PYTHON_JULIAPKG_PROJECT must be an absolute path; "
        "correct PYTHON_JULIAPKG_*"
    )


def test_installing_checks_the_settings_of_the_environment(fake_julia, monkeypatch):
    """Half a setting is told, and one of the user's own is left as it is."""
    assert julia_setup.install().startswith("nothing to install: PYTHON_JULIACALL_PROJECT names")
    monkeypatch.delenv("PYTHON_JULIACALL_PROJECT")
    with pytest.raises(EngineUnavailable, match="EXE is set without PYTHON_JULIACALL_PROJECT"):
        julia_setup.install()


def test_juliapkg_is_asked_for_julia_when_none_is_given(fake_julia, monkeypatch, tmp_path, capfd):
    """Installing runs juliapkg in a process of its own, shows its words, tells where Julia is."""
    for name in ("EXE", "PROJECT"):
        monkeypatch.delenv(f"PYTHON_JULIACALL_{name}")
    (tmp_path / "juliapkg.py").write_text(
        "import os\n"
        "def resolve():\n"
        "    print('Found dependencies')\n"
        "    assert os.environ['JULIA_CONDAPKG_BACKEND'] == 'Null'\n"
        "    if os.environ.get('FAKE_JULIAPKG') == 'die': raise SystemExit(3)\n"
        "    if os.environ.get('FAKE_JULIAPKG') == 'fail': raise OSError('no network')\n"
        "executable = lambda: '/opt/julia'\n"
        "project = lambda: '/opt/project'\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    assert julia_setup.install() == "Julia and its packages are set up: /opt/julia in /opt/project"
    told = capfd.readouterr()
    assert (told.out, told.err.strip()) == ("", "Found dependencies")
    for manner, words in (("die", "it ended with exit code 3;"), ("fail", "OSError no network;")):
        monkeypatch.setenv("FAKE_JULIAPKG", manner)
        with pytest.raises(EngineError, match=f"juliapkg cannot set up Julia: {words}"):
            julia_setup.install()
    assert "Traceback" not in capfd.readouterr().err


def test_a_program_that_is_no_julia_is_named_not_the_project(monkeypatch):
    """Told apart are a Julia, an older one, another program, and one that cannot be run."""

    def explain(program):
        monkeypatch.setenv("PYTHON_JULIACALL_EXE", str(program))
        return julia_setup.explain_start("not enough values to unpack (expected 2, got 1)")

    told = explain(sys.executable)
    assert "PYTHON_JULIACALL_EXE names no Julia" in told and "'Python 3" in told
    assert "unpack" not in told and told.endswith("; give the path of julia")
    assert explain(FAKE / "julia").endswith("dynsr's julia/Project.toml and PythonCall")
    assert "cannot be run" in explain(FAKE / "nothing")
    monkeypatch.setattr(julia_setup, "OLDEST_JULIA", (1, 11))
    assert "is julia version 1.10.0, and 1.11 is the oldest" in explain(FAKE / "julia")
    monkeypatch.delenv("PYTHON_JULIACALL_EXE")
    assert julia_setup.explain_start("x") == "Julia does not start: x; run dynsr doctor --install"


def test_an_engine_over_a_program_that_is_no_julia_says_so(fake_julia, monkeypatch):
    """What juliacall says of its own unpacking never reaches the user."""
    monkeypatch.setenv("FAKE_JULIA_START", "no julia")
    engine = JuliaEngine(start_seconds=60.0)
    with pytest.raises(EngineUnavailable) as caught:
        engine.versions()
    assert "PYTHON_JULIACALL_EXE names no Julia" in str(caught.value)


def test_a_depot_that_cannot_be_written_gets_one_in_front(fake_julia, monkeypatch, tmp_path):
    """The read-only ones stay behind it, with Julia's own; a writable one is left alone."""
    file = tmp_path / "file"
    file.write_text("")
    fixed, free, cache = file / "depot", tmp_path / "free", tmp_path / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    monkeypatch.setenv("HOME", str(tmp_path))
    julia_setup.own_depot.cache_clear()
    own = cache / "dynsr" / "julia"

    def depots(value):
        monkeypatch.setenv("JULIA_DEPOT_PATH", value)
        return julia_setup.start_environment()["JULIA_DEPOT_PATH"]

    assert depots(f"{fixed}{os.pathsep}") == f"{own}{os.pathsep}{fixed}{os.pathsep}"
    assert own.is_dir()
    assert depots(str(free)) == str(free)
    assert depots("") == ""
    monkeypatch.delenv("JULIA_DEPOT_PATH")
    assert "JULIA_DEPOT_PATH" not in julia_setup.start_environment()
    monkeypatch.setenv("HOME", str(file))
    home = file / ".julia"
    found = julia_setup.start_environment()["JULIA_DEPOT_PATH"]
    assert found == f"{own}{os.pathsep}{home}{os.pathsep}"
    monkeypatch.setenv("XDG_CACHE_HOME", str(file))
    julia_setup.own_depot.cache_clear()
    passing = Path(julia_setup.own_depot())
    assert passing.is_dir() and passing != own
    monkeypatch.delenv("PYTHON_JULIACALL_PROJECT")
    assert "JULIA_DEPOT_PATH" not in julia_setup.start_environment()
    julia_setup.own_depot.cache_clear()


def test_a_julia_that_somebody_has_set_up_ought_to_start(fake_julia, monkeypatch):
    """Half a setting counts, and so do settings that juliapkg refuses; nothing at all does not."""
    monkeypatch.delenv("PYTHON_JULIACALL_PROJECT")
    assert julia_setup.is_configured()
    monkeypatch.delenv("PYTHON_JULIACALL_EXE")
    for resolved in (True, False):
        monkeypatch.setattr(julia_setup, "_is_resolved", lambda resolved=resolved: resolved)
        assert julia_setup.is_configured() is resolved

    def refuse():
        raise Exception("no")

    monkeypatch.setattr(julia_setup, "_is_resolved", refuse)
    assert julia_setup.is_configured()
    monkeypatch.setattr(julia_setup.importlib.util, "find_spec", lambda name: None)
    assert not julia_setup.is_configured()


def test_the_sources_are_found_from_a_checkout():
    """The julia folder beside the package is found."""
    assert (find_sources() / "src" / "DynSR.jl").is_file()


def test_the_julia_tests_find_their_data():
    """The folder that runtests.jl reads from, counted from where it lies, holds its files."""
    source = ROOT / "julia" / "test" / "runtests.jl"
    text = source.read_text()
    (up,) = re.findall(r"CHECKOUT = joinpath\(realpath\(@__DIR__\), (.+)\)", text)
    (below,) = re.findall(r"GOLDEN = joinpath\(CHECKOUT, (.+)\)", text)
    golden = source.parent.joinpath(*json.loads(f"[{up}]"), *json.loads(f"[{below}]"))
    named = re.findall(r'read_numbers\("([^"$]+)"', text)
    systems = json.loads("[{}]".format(re.findall(r"SYSTEMS = \((.+)\)", text)[0]))
    assert {f"{system}.csv" for system in systems} | set(named) <= set(os.listdir(golden))


def test_the_page_of_the_engines_names_a_folder_that_is_there(tmp_path):
    """Its command that compiles the package gives Julia the folder of the package, run as shown."""
    page = (ROOT / "docs" / "engines.md").read_text()
    (command,) = re.findall(r"```\n(julia --project=.+?)\n```", page, re.DOTALL)
    program = tmp_path / "julia"
    program.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    program.chmod(0o755)
    path = os.pathsep.join([str(tmp_path), str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-c", command],
        check=True,
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PATH": path},
    )
    *_, code, folder = done.stdout.splitlines()
    assert "Pkg.develop(path = ARGS[1])" in code
    assert 'name = "DynSR"' in (Path(folder) / "Project.toml").read_text()


JULIAPKG = """
import os
files = lambda: [os.path.normpath(p) for p in os.environ["LISTS"].split(os.pathsep)]
class deps:
    deps_files = staticmethod(files)
"""


def test_of_two_copies_of_the_julia_package_one_is_taken(monkeypatch, tmp_path):
    """That of the dynsr in use; the other is named, and lists of other packages stay."""
    (tmp_path / "juliapkg.py").write_text(JULIAPKG)
    copy, other = tmp_path / "dynsr_julia", tmp_path / "other"
    for folder in (copy, other):
        (folder / "src").mkdir(parents=True)
        (folder / "juliapkg.json").write_text("{}")
    (copy / "src" / "DynSR.jl").write_text("module DynSR end")
    own = find_sources()
    lists = [str(folder / "juliapkg.json") for folder in (copy, own, other)]
    code = (
        "from dynsr.engines.julia.setup import keep_one_list; keep_one_list(); keep_one_list(); "
        "import juliapkg; print(*juliapkg.deps.deps_files(), sep='\\n')"
    )
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    kept = {n: v for n, v in os.environ.items() if not n.startswith("PYTHON_JULIA")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        text=True,
        env={**kept, "LISTS": os.pathsep.join(lists), "PYTHONPATH": path},
    )
    assert done.stdout.split() == lists[1:]
    assert done.stderr == f"dynsr's Julia code is taken from {own}, not from {copy}\n"


def test_a_newer_julia_is_let_in_and_noted(monkeypatch):
    """dynsr doctor says of a Julia beyond the one that was run that it is newer; of no other."""

    class Engine:
        name = "julia"

        def __init__(self, version):
            self.version = version

        def versions(self):
            return {"julia": self.version, "OrdinaryDiffEqTsit5": "2.1.3"}

    def details(version):
        return [check.detail for check in doctor._examine_versions(Engine(version))]

    assert details("1.10.5") == ["1.10.5", "2.1.3"]
    assert details("1.13.0-rc1")[0].startswith("1.13.0-rc1, newer than 1.10.5")


def test_diffeqpy_leaves_the_users_project_as_it_is(fake_julia, monkeypatch, tmp_path):
    """What diffeqpy adds goes into a project beside it, and the versions name what integrates."""
    log = tmp_path / "log"
    monkeypatch.setenv("FAKE_JULIA_DIFFEQPY", "9.9.9")
    monkeypatch.setenv("FAKE_JULIA_LOG", str(log))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    engine = DiffeqpyEngine(start_seconds=60.0)
    versions = engine.versions()
    engine.close()
    assert versions["DifferentialEquations"] == "9.9.9" and "diffeqpy" in versions
    active = [line.split()[1] for line in log.read_text().splitlines() if "active" in line]
    assert active == [str(tmp_path / "dynsr" / "julia" / "environments" / "diffeqpy")]


def test_a_long_stage_is_told_again(monkeypatch):
    """After the first line of a stage come others at growing gaps, with the seconds so far."""
    now = [0.0]
    monkeypatch.setattr(worker_process.time, "monotonic", lambda: now[0])
    reports, told = worker_process._Reports(), []
    reports.begin("compiling")
    for second in range(100):
        now[0] = float(second)
        reports.announce("julia", told.append)
    assert told == [
        "julia: compiling",
        "julia: compiling (9 s so far)",
        "julia: compiling (33 s so far)",
    ]


@pytest.mark.parametrize("command", ["audit", "crosscheck"])
@pytest.mark.slow
def test_a_long_check_says_how_far_it_is(command):
    """On standard error, a line for what has ended; -q keeps silent, and the answer is the same."""
    less = ["--sections", "corrected", "--engines", "embedded"] if command == "crosscheck" else []
    loud, quiet = (run(command, "--json", *asked, *less) for asked in ((), ("-q",)))
    assert re.search(r"\[\d+/\d+\]", loud.stderr) and quiet.stderr == ""
    assert loud.stdout == quiet.stdout and loud.stdout.startswith("[")


def test_julia_says_how_long_it_takes_to_start(fake_julia, capsys):
    """Before the first answer comes, a line says what the wait is for."""
    SearchProgress().say_start("embedded", "julia")
    told = " ".join(capsys.readouterr().err.split())
    assert told == START_NOTES["julia"]
