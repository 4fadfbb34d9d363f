"""Names of files and columns may hold any bytes and signs: nothing is lost, nothing steers."""

import json
import os
import re
import sys
import traceback
from pathlib import Path

import numpy as np
import pytest
from command_line import run

import dynsr
from dynsr.data.reading import read_trajectories
from dynsr.data.trajectory import Trajectory
from dynsr.data.writing import write_text
from dynsr.discovery.result import Discovery
from dynsr.errors import (
    DynsrError,
    DynsrWarning,
    EngineError,
    InputError,
    in_words,
    one_line,
    printable,
)
from dynsr.jobs.store import RunFolder, read_json, to_json, write_json

SMALL = ("--preset", "quick", "--functions", "none", "-j", 1)
T = np.linspace(0, 6, 60)
X = 2 * np.exp(-T / 2)
# What a name may hold: no UTF-8, a colour, a bell, a return, a turn of the direction, one byte C1.
NAMES = [b"ol\xe9", b"a\x1b[31mred", b"a\x07b", b"a\rb", "a\u202eb".encode(), "a\x9b31mb".encode()]
# The first is no text in any encoding that is known of a file, the second ends a line of a table.
NO_CELLS = (b"ol\xe9", b"a\rb")
BAD = {chr(c) for c in range(32)} - {"\n"} | {chr(c) for c in range(127, 160)}
BAD |= set("\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u061c\ufeff")
BAD |= {chr(c) for c in range(0xD800, 0xE000)}

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="names of any bytes are Linux's")


def write_table(path, names=("t", "x")):
    """Write an exact decay as a table."""
    rows = [",".join(names), *(f"{t!r},{x!r}" for t, x in zip(T.tolist(), X.tolist(), strict=True))]
    path.write_text("\n".join(rows))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_file_of_any_name_is_searched_and_its_results_are_kept(name, tmp_path, monkeypatch):
    """Search, record, report, score and simulation work; the files are text that can be read."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / os.fsdecode(name)
    folder.mkdir()
    data = folder / os.fsdecode(name + b".csv")
    write_table(data)
    done = run("discover", data, *SMALL, "-o", folder / "out")
    assert not BAD & set(done.stdout + done.stderr)
    saved = folder / "out" / "discovery.json"
    for path in (saved, folder / "out" / "report.html"):
        assert not BAD & set(path.read_bytes().decode("utf-8"))
    assert str(Discovery.load(saved)).endswith("\nx' = -0.5*x")
    for words in (
        ("report", saved, "-o", folder / "again.html"),
        ("score", saved, data),
        ("score", saved, data, "--json"),
        ("describe", data),
        ("describe", data, "--json"),
        ("simulate", saved, "--x0", "1", "--span", "0,1", "--dt", "0.5", "-o", folder / "s.csv"),
        ("discover", data, *SMALL, "--start", saved, "-o", folder / "from", "--json"),
    ):
        done = run(*words)
        assert not BAD & set(done.stdout + done.stderr), words
    # Without --out the folder is named after the file.
    assert not BAD & set(run("discover", data, *SMALL).stderr)


@pytest.mark.parametrize("name", NAMES)
def test_a_source_is_called_by_a_name_that_can_be_shown(name, tmp_path):
    """What a trajectory says of its origin holds no sign that steers, and no half of a pair."""
    data = tmp_path / os.fsdecode(name + b".csv")
    write_table(data)
    table = read_trajectories(data)
    (made,) = table.trajectories
    assert not BAD & set(table.guess + json.dumps(made.origin, ensure_ascii=False))


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in NAMES if n not in NO_CELLS])
def test_a_column_of_any_name_is_told_without_its_signs(name, tmp_path):
    """Warnings, guesses and errors name a column by what can be seen of it."""
    text = name.decode()
    data = tmp_path / "d.csv"
    write_table(data, ("t", f'"{text}"'))
    done = run("discover", data, *SMALL, "-o", tmp_path / "out")
    assert not BAD & set(done.stdout + done.stderr)
    assert not BAD & set(run("describe", data).stdout)
    for wrong in (("--trajectory", text), ("--states", f"{text},q"), ("--inputs", text)):
        assert not BAD & set(run("discover", data, *SMALL, *wrong, code=2).stderr)


@pytest.mark.parametrize("name", NAMES)
def test_errors_about_files_are_one_line_without_their_signs(name, tmp_path):
    """Whatever is wrong with a file, its name steers nothing."""
    gone = tmp_path / os.fsdecode(name + b".csv")
    there = tmp_path / os.fsdecode(b"x" + name + b".csv")
    there.write_text("t,x\n0,1\n1,\x1b[31mred\x07\n")
    for words in (
        ("discover", gone),
        ("discover", there),
        ("score", gone, gone),
        ("score", there, there),
        ("report", gone),
        ("simulate", f"{gone}.json"),
        ("generate", "pendulum", "-o", there),
        ("generate", os.fsdecode(name)),
        ("generate", "pendulum", "--engine", os.fsdecode(name)),
        ("app", "--no-browser", gone),
        ("benchmark", f"{gone}.json"),
        ("benchmark", os.fsdecode(name)),
        ("discover", there, f"--{os.fsdecode(name)}"),
        (os.fsdecode(name),),
    ):
        said = run(*words, code=2).stderr
        assert said.count("\n") == 1 and not BAD & set(said), words


def test_what_may_be_shown():
    """Letters of every writing and spaces stay; what steers or ends a line becomes its number."""
    for kept in ("x' = -3*y", "µ 測 é ü\u00a0°C\u3000|", ""):
        assert printable(kept) == kept
    assert printable("two\nlines") == "two\\nlines" and printable("a\nb", "\n") == "a\nb"
    for c in BAD:
        assert c not in printable(f"a{c}b") and not BAD & set(printable(f"a{c}b"))
    once = printable("\x1b]0;title\x07\u2028\u202e\udcff")
    assert printable(once) == once
    assert one_line(InputError("a\x1b[2J\n b")) == in_words(InputError("a\x1b[2J\n b"))
    assert one_line("a\x1b[2J\n b") == "a\\x1b[2J b"


def test_commands_print_in_one_place():
    """No command prints but by cli/output.py, which shows what is safe and minds what is lost."""
    commands = Path(dynsr.__file__).parent / "cli"
    own = {"output.py", "group.py", "app.py", "start.py"}
    for path in sorted(commands.glob("*.py")):
        found = re.findall(r"typer\.echo|(?<![.\w])print\(|sys\.std(?:out|err)", path.read_text())
        assert path.name in own or not found, path


def test_errors_and_warnings_steer_no_terminal(tmp_path):
    """What Python itself prints of an error or a warning is safe too, folders and records named."""
    evil = "a\x1b[2J\u202eb\udcff"
    seen = "a\\x1b[2J\\u202eb\\udcff"
    for kind in (DynsrError, InputError, EngineError, DynsrWarning):
        assert str(kind(evil)) == seen
    folder = tmp_path / evil
    folder.mkdir()
    (folder / f"x{evil}").write_text("mine")
    with pytest.raises(InputError) as caught:
        RunFolder(folder).claim("discovery", {})
    assert not BAD & set("".join(traceback.format_exception(caught.value)))


def test_halves_of_pairs_reach_no_file(tmp_path):
    """JSON and text that hold the bytes of a name that are no text are written, as numbers."""
    write_json(tmp_path / "a.json", {"ol\udce9": ["\ud800", tmp_path / "\udcff"]})
    (key,) = read_json(tmp_path / "a.json")
    assert key == "ol\\udce9"
    assert json.loads(to_json("\udcff")) == "\\udcff"
    write_text(tmp_path / "a.txt", "ol\udce9 測")
    assert (tmp_path / "a.txt").read_bytes().decode() == "ol\\udce9 測"
    made = Trajectory(T, X[:, None], ("x",), origin={"source": "ol\udce9"})
    assert "udce9" in to_json(made.origin)
