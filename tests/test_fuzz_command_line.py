"""A thousand broken command lines and files: each ends in an answer or in one line.

``DYNSR_FUZZ_SEED`` draws others.
"""

import json
import os
import random
import traceback

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from dynsr.cli import discovery as discovering
from dynsr.cli.app import app
from dynsr.cli.group import CommandGroup
from dynsr.data.reading import write_csv
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.errors import InputError
from dynsr.expression.parsing import parse

SEED = int(os.environ.get("DYNSR_FUZZ_SEED", "0"))
COUNT = 1000
COMMAND = typer.main.get_command(app)
T = np.linspace(0, 3, 40)

NUMBERS = ["0", "1", "-1", "nan", "inf", "1e999", "1e-320", "0x10", "1_0", "1,2", "", "two", "1 2"]
WORDS = [
    *("", ",", "x", "x,y", "q", "t", "µ", "x'", "a" * 300, "%s", "{}", "[red]", "-", "--", "\n"),
    *("../..", "/dev/null", "/", "\udcff", "😀", "lorenz", "pendulum", "embedded", "julia", "ga"),
    *("x=1", "F=sin(t)", "F=1/0", "F=x", "x'=-x", "x'=1/0; y'=x", "x'=9**9**9", "t'=1"),
    *("x'=" + "sin(" * 50 + "x" + ")" * 50, "sin'=x", "x'=-x; x'=x", "x'=zoo", "µ'=-µ"),
    *("a\x1b[31m", "\x07", "a\rb", "\u202ex", "x\x9b2J", "x'=-x\x1b]0;t\x07"),
    *("savgol(4,9)", "savgol(999,2)", "forward", "auto", "best", "quick", "typo", "sindy,typo"),
]
EQUATIONS = [
    "-x",
    "x**2",
    "1/x",
    "exp(exp(x))",
    "sqrt(x)",
    "log(x - 9)",
    "t**3",
    "sign(x)",
    "1e300*x",
]
OPTIONS = {
    "systems": [],
    "generate": ["--equations", "--inputs", "--noise", "--seed", "--x0", "--engine", "--span"],
    "simulate": ["--equations", "--inputs", "--x0", "--engine", "--span"],
    "discover": [
        *("--time", "--states", "--inputs", "--trajectory", "--method", "--preset", "--targets"),
        *("--known", "--scheme", "--seed", "--jobs", "--engine", "--system"),
    ],
    "score": ["--time", "--states", "--inputs", "--trajectory", "--engine"],
    "report": [],
    "replicate": ["--systems", "--methods", "--runs", "--seed", "--jobs", "--engine"],
    "benchmark": ["--systems", "--noise", "--seeds", "--method", "--engine"],
}
NUMERIC = {"--noise", "--seed", "--x0", "--span", "--jobs", "--runs", "--seeds"}


def mutate(content: bytes, draw: random.Random) -> bytes:
    """Cut, flip, double or insert something somewhere."""
    at = draw.randrange(len(content) + 1)
    match draw.randrange(6):
        case 0:
            return content[:at]
        case 1:
            return content[:at] + bytes([draw.randrange(256)]) + content[at + 1 :]
        case 2:
            return content[:at] + content[at // 2 :]
        case 3:
            extra = draw.choice(
                [b"\0", b'"', b"#", b"nan", b"1e400", b",", b"\xff\xfe", b"\r", b"-"]
            )
            return content[:at] + extra + content[at:]
        case 4:
            lines = content.split(b"\n")
            draw.shuffle(lines)
            return b"\n".join(lines)
    return content


def change(record, draw: random.Random):
    """Replace or drop one value of a saved discovery."""
    inside = record
    while True:
        keys = list(inside) if isinstance(inside, dict) else list(range(len(inside)))
        key = draw.choice(keys)
        deeper = inside[key]
        if draw.random() < 0.4 or not isinstance(deeper, (dict, list)) or not deeper:
            break
        inside = deeper
    value = [
        None,
        5,
        "text",
        [],
        {},
        -1.5,
        True,
        "zoo",
        "9**9**9",
        [["x"]],
        {"q": "x"},
        "import os",
    ]
    if isinstance(inside, dict) and draw.random() < 0.2:
        del inside[key]
    else:
        inside[key] = draw.choice(value)


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    """Good files of every kind, of which broken ones are made."""
    folder = tmp_path_factory.mktemp("seeds")
    run = Trajectory(T, np.column_stack([np.exp(-T), np.sin(T)]), ("x", "y"))
    write_csv(run, folder / "d.csv")
    np.savez(folder / "d.npz", t=T, x=run.x)
    np.save(folder / "d.npy", np.column_stack([T, run.x]))
    equations = {"x": parse("-x"), "y": parse("x - F")}
    found = Discovery(equations, {"x": ((-1.0, 0.1),)}, {}, {"x": "it fits"})
    return folder, json.loads(found.save(folder / "d.json").read_text())


_ANY = ("csv", "csv", "csv", "json", "json", "npz", "npy", "none", "folder")
_TABLES = ("csv", "csv", "csv", "npz", "npy")
_FILES = {
    "discover": (_TABLES,),
    "score": (("json",), _TABLES),
    "simulate": (("json",),),
    "report": (("json",),),
}


def write_broken(seeds, folder, draw, kinds):
    """Write one broken file of some kind; gives its path, which may not be there."""
    source, record = seeds
    kind = draw.choice(kinds)
    path = folder / f"in{draw.randrange(3)}.{kind}"
    if kind == "json":
        record = json.loads(json.dumps(record))
        if draw.random() < 0.8:
            record.pop("checksum")
            for _ in range(draw.randrange(1, 3)):
                change(record, draw)
        path.write_text(json.dumps(record))
    elif kind == "folder":
        path.mkdir(exist_ok=True)
    elif kind != "none":
        content = (source / f"d.{kind}").read_bytes()
        for _ in range(draw.randrange(4)):
            content = mutate(content, draw)
        path.write_bytes(content)
    return path


def make_line(seeds, folder, draw):
    """Make one command line."""
    command = draw.choice([*OPTIONS, "discover", "score", "simulate"])
    words = [command]
    sane = draw.random() < 0.8
    if command in ("discover", "score", "simulate", "report"):
        kinds = _FILES[command] if sane else (_ANY,) * draw.randrange(3)
        words += [str(write_broken(seeds, folder, draw, kind)) for kind in kinds]
    elif draw.random() < 0.5 and command not in ("generate", "replicate"):
        words.append(draw.choice(["lorenz", "pendulum", "recovery", *WORDS]))
    elif command == "generate":
        first, second = draw.choice(EQUATIONS), draw.choice(EQUATIONS)
        words += draw.choice([["lorenz"], ["--equations", f"x'={first}; y'={second}"]])
    for option in draw.sample(OPTIONS[command], min(draw.randrange(4), len(OPTIONS[command]))):
        value = draw.choice(NUMBERS if option in NUMERIC and draw.random() < 0.8 else WORDS)
        if option == "--equations" and draw.random() < 0.7:
            value = f"x'={draw.choice(EQUATIONS)}; y'={draw.choice(EQUATIONS)}"
        words += [option, value]
    if draw.random() < 0.1:
        words += [draw.choice(["--json", "--typo", "-o", "--help"])]
    if draw.random() < 0.2 and command in ("generate", "simulate", "report", "discover"):
        words += ["-o", str(folder / draw.choice(["o.csv", "o.html", "no/such/o.csv", "in0.csv"]))]
    return words


def fault_of(words) -> str:
    """Run a command line; say what is wrong with its end, "" for nothing."""
    try:
        done = CliRunner().invoke(app, words)
    except Exception:
        return traceback.format_exc()
    lines = done.stderr.splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    if steering := {"\x1b", "\x07", "\r", "\u202e", "\x9b"} & set(done.output):
        return f"steers a terminal: {steering}"
    if done.exit_code == 0:
        return ""
    if done.exit_code != 2 or len(errors) > 1 or "Traceback" in done.output:
        return f"exit {done.exit_code}: {done.output[-500:]}"
    return "" if errors and lines[-1] == errors[0] else f"no last line: {done.output[-500:]}"


def refuse(*args, **settings):
    """Stand in for a search that would begin."""
    raise InputError("it would be searched")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("part", range(5))
def test_every_broken_command_line_ends_in_an_answer_or_one_line(
    part, seeds, tmp_path, monkeypatch
):
    """No fault (exit 1), no traceback, no second line: 0, or 2 with one last line that says why."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(discovering, "search", refuse)
    monkeypatch.setattr("dynsr.cli.benchmarks.search", refuse)
    monkeypatch.setattr("dynsr.paper.replicate", refuse, raising=False)
    # The runner would make all commands anew for every line.
    monkeypatch.setattr("typer.testing._get_command", lambda app: COMMAND, raising=False)
    assert isinstance(COMMAND, CommandGroup)
    draw = random.Random(SEED + part)
    faults = {}
    for _ in range(COUNT // 5):
        words = make_line(seeds, tmp_path, draw)
        fault = fault_of(words)
        if fault:
            faults[" ".join(map(repr, words))[:300]] = fault
    assert not faults, json.dumps(faults, indent=1, ensure_ascii=False)
