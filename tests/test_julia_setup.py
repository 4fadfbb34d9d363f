import os
import sys
import time
from pathlib import Path

import pytest

from dynsr.engines.julia import setup as julia_setup
from dynsr.engines.julia.engine import JuliaEngine
from dynsr.engines.julia.setup import find_missing, find_sources
from dynsr.engines.registry import find_engine
from dynsr.errors import EngineError, EngineUnavailable

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
    find_engine.__globals__["_STARTED"].pop("julia", None)
    start = time.monotonic()
    with pytest.raises(EngineUnavailable, match=r"pip install 'dynsr\[julia\]'"):
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
        "mend PYTHON_JULIAPKG_*"
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
    julia_setup._own_depot.cache_clear()
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
    julia_setup._own_depot.cache_clear()
    passing = Path(julia_setup._own_depot())
    assert passing.is_dir() and passing != own
    monkeypatch.delenv("PYTHON_JULIACALL_PROJECT")
    assert "JULIA_DEPOT_PATH" not in julia_setup.start_environment()
    julia_setup._own_depot.cache_clear()


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
