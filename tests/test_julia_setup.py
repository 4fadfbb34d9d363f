import sys
import time
from pathlib import Path

import pytest

from dynsr.engines.julia import setup as julia_setup
from dynsr.engines.julia.setup import find_missing, find_sources
from dynsr.engines.registry import find_engine
from dynsr.errors import EngineError, EngineUnavailable

FAKE = Path(__file__).parent / "fake_julia"


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


def test_the_sources_are_found_from_a_checkout():
    """The julia folder beside the package is found."""
    assert (find_sources() / "src" / "DynSR.jl").is_file()
