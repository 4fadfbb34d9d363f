"""Output that nobody reads, or that a full disk refuses, costs no result: all is saved first."""

import contextlib
import io
import json
import os
import subprocess
import sys

import numpy as np
import pytest
import typer
from rich.text import Text

from dynsr import discover
from dynsr.cli import discovery as discovering
from dynsr.cli import output
from dynsr.data import read_trajectories
from dynsr.discovery import result
from dynsr.discovery.result import Discovery
from dynsr.jobs import take_lost
from dynsr.jobs.screen import Screen, is_lost, printing

pytestmark = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
SMALL = ("--preset", "quick", "--functions", "none", "-j", "1")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """An exact decay as a table."""
    t, path = np.linspace(0, 6, 60), tmp_path_factory.mktemp("data") / "d.csv"
    rows = [f"{a!r},{b!r}" for a, b in zip(t.tolist(), np.exp(-t / 2).tolist(), strict=True)]
    path.write_text("\n".join(["t,x", *rows]))
    return path


@pytest.fixture(scope="module")
def saved(data):
    """The file of a discovery in that table."""
    asked = {"preset": "quick", "functions": [], "jobs": 1, "progress": False}
    runs = read_trajectories(data).trajectories
    return discover(runs, **asked).save(data.parent / "discovery.json")


def run_into(kind, *words, both=False):
    """Run a command whose output goes to a reader that is gone, or to a full disk."""
    if kind == "full":
        out = os.open("/dev/full", os.O_WRONLY)
    else:
        reader, out = os.pipe()
        os.close(reader)
    try:
        command = [sys.executable, "-m", "dynsr", *map(str, words)]
        return subprocess.run(
            command, stdout=out, stderr=out if both else subprocess.PIPE, text=True, timeout=120
        )
    finally:
        os.close(out)


def check_end(done, kind):
    """A reader that is gone is no fault; a full disk is one line and exit code 2."""
    said = [line for line in (done.stderr or "").splitlines() if line.startswith("error")]
    if kind == "full":
        line = "error: cannot write the output: No space left on device"
        assert (done.returncode, said) == (2, [line])
    else:
        assert (done.returncode, said) == (0, [])
    assert "Traceback" not in (done.stderr or "") and "Exception" not in (done.stderr or "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "option"),
    [
        *[("full", option) for option in ((), ("-q",), ("--json",), ("--details",))],
        ("gone", ()),
    ],
)
def test_a_discovery_is_saved_whatever_becomes_of_its_output(kind, option, data, tmp_path):
    """The result and its report are there, whether anybody reads the equations or not.

    Each option has a printer of its own; all of them learn in one place what became of the output.
    """
    done = run_into(kind, "discover", data, *SMALL, *option, "-o", tmp_path / "out")
    check_end(done, kind)
    assert str(Discovery.load(tmp_path / "out" / "discovery.json")).endswith("\nx' = -0.5*x")
    assert (tmp_path / "out" / "report.html").read_text().startswith("<!doctype html>")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["full", "gone"])
def test_where_nobody_hears_anything_the_work_is_done(kind, data, tmp_path):
    """Standard error may be gone too: progress and notes end no search."""
    done = run_into(kind, "discover", data, *SMALL, "-o", tmp_path / "out", both=True)
    assert done.returncode == (2 if kind == "full" else 0)
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["full", "gone"])
def test_other_commands_end_as_quietly(kind, data, saved, tmp_path):
    """Tables, scores, reports, replications and lists: files are written, the end is told."""
    replication = ("--systems", "pendulum", "--methods", "sindy", "--runs", "1", "-q")
    lines = {
        ("generate", "pendulum", "--span", "0,100"): None,
        ("generate", "pendulum", "--json", "-o", tmp_path / "m.csv"): tmp_path / "m.csv",
        ("simulate", saved, "--x0", "1", "--span", "0,1", "--dt", "0.1"): None,
        ("score", saved, data): None,
        ("score", saved, data, "--json"): None,
        ("report", saved, "-o", tmp_path / "r.html", "--json"): tmp_path / "r.html",
        ("systems",): None,
        ("benchmark",): None,
        ("--help",): None,
        ("--version",): None,
        ("replicate", *replication, "-o", tmp_path / "rep"): tmp_path / "rep" / "report.html",
    }
    for words, written in lines.items():
        done = run_into(kind, *words)
        said = [line for line in done.stderr.splitlines() if line.startswith("error")]
        assert (done.returncode, len(said)) == ((2, 1) if kind == "full" else (0, 0)), words
        assert "Traceback" not in done.stderr and "Exception" not in done.stderr, words
        assert written is None or written.stat().st_size > 0, words


@pytest.mark.slow
def test_a_result_is_saved_before_it_is_shown(data, tmp_path, monkeypatch):
    """When the first equation is shown the file is there; the report may come later."""
    seen = []

    def look(found, quiet=False):
        seen.append((tmp_path / "out" / "discovery.json").exists())

    monkeypatch.setattr(discovering, "show_equations", look)
    discovering.discover([data], preset="quick", functions="none", jobs=1, out=tmp_path / "out")
    assert seen == [True] and (tmp_path / "out" / "report.html").exists()


@pytest.mark.slow
def test_what_cannot_be_saved_is_shown(data, tmp_path, monkeypatch, capsys):
    """Where the file cannot be written the equations are on the screen, and the error comes."""

    def refuse(path, record):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(result, "write_discovery", refuse)
    saves = pytest.warns(UserWarning, match="No space left")
    with saves, pytest.raises(OSError, match="No space"):
        discovering.discover([data], preset="quick", functions="none", jobs=1, out=tmp_path / "o")
    assert "x' = -0.5*x" in capsys.readouterr().out


def test_what_is_lost_is_told_once():
    """The first failure is remembered, what comes later goes nowhere, stderr is nobody's matter."""
    for error in (BrokenPipeError(32, "Broken pipe"), OSError(28, "full")):
        with printing():
            raise error
    with printing(stderr=True):
        raise OSError(5, "gone")
    assert is_lost() and isinstance(take_lost(), BrokenPipeError)
    assert not is_lost() and take_lost() is None
    with pytest.raises(ValueError, match="no matter"), printing():
        raise ValueError("no matter of the output")


def shown(*objects, **how):
    """Give what a screen writes to a terminal, without its own signs of style."""
    screen = Screen(file=io.StringIO(), force_terminal=True, width=200, color_system=None)
    screen.print(*objects, **how)
    return screen.file.getvalue()


def test_a_screen_shows_what_is_there():
    """Neither signs that steer, nor what looks like markup or an emoji, change what is read."""
    evil = "\x1b[2J\x9b31m\u202eabc [red]x[/red] :smile: \udcff"
    seen = "\\x1b[2J\\x9b31m\\u202eabc [red]x[/red] :smile: \\udcff"
    assert shown(Text(evil)) == f"{seen}\n"
    output_of_table = io.StringIO()
    with contextlib.redirect_stdout(output_of_table):
        output.print_table(evil, (f"a {evil}",), [(f"b {evil}",)], evil)
    said = output_of_table.getvalue()
    for start in ("", "a ", "b "):
        assert f"{start}{seen}" in said
    assert said.count(seen) == 4 and "\x1b" not in said


def test_json_holds_every_sign_as_an_escape(capsys):
    """What a program reads is the text itself, and no terminal is steered on the way."""
    evil = "\x1b[2J\x9b31m\u202eabc\U000e0041 é測\n"
    output.print_json({"a": evil, "b\x07": [evil]})
    said = capsys.readouterr().out
    assert json.loads(said) == {"a": evil, "b\x07": [evil]}
    assert not {"\x1b", "\x9b", "\u202e", "\U000e0041"} & set(said) and "測" in said


def test_a_note_is_one_line(capsys):
    """The name of a file makes no second line that looks like one of ours."""
    output.note("saved: a\nerror: all is lost\x1b[31m")
    output.print_lines("x' = 1", "y' = \x07")
    said = capsys.readouterr()
    assert said.err == "saved: a\\nerror: all is lost\\x1b[31m\n"
    assert said.out == "x' = 1\ny' = \\x07\n"


def test_no_completion_steers_the_shell(tmp_path):
    """Columns whose names cannot be typed are not offered."""
    from dynsr.cli.options import complete_column

    (tmp_path / "d.csv").write_text("t,x\x1b[2J,y\n0,1,2\n1,2,3\n")
    context = typer.Context(typer.main.get_command(typer.Typer(callback=lambda: None)))
    context.args = [str(tmp_path / "d.csv")]
    assert complete_column(context, "") == ["t", "y"]
