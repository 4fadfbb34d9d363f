import builtins
import contextlib
import dataclasses
import importlib
import importlib.util
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import typer
from command_line import run
from typer.testing import CliRunner

from dynsr.cli.app import app
from dynsr.cli.group import CommandGroup
from dynsr.data.reading import read_trajectories
from dynsr.errors import say_install

COMMAND = typer.main.get_command(app)
NAMES = sorted(COMMAND.commands)


def refuse(*words):
    """Run a command line that must end in one line on stderr and exit code 2; give the line."""
    result = run(*words, code=2)
    assert result.stdout == ""
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    return result.stderr


def spawn(*words, **options):
    """Start a command line in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "dynsr", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def test_all_commands_are_there():
    """The command has its verbs."""
    wanted = (
        "systems generate describe discover score simulate replicate audit crosscheck benchmark"
    )
    assert set(NAMES) == {
        *wanted.split(),
        "export",
        "import",
        "report",
        "doctor",
        "app",
        "profile",
        "suggest",
    }


@pytest.mark.parametrize("name", NAMES)
def test_help_has_an_example_that_parses(name):
    """Each command's help ends in an example, whose words and options the command knows."""
    shown = run(name, "--help").stdout
    example = COMMAND.commands[name].epilog.removeprefix("Example: ")
    assert " ".join(example.split()) in " ".join(shown.split())
    words = shlex.split(example.split("&&")[0])
    assert words[:2] == ["dynsr", name]
    COMMAND.commands[name].make_context(name, words[2:])


@pytest.mark.parametrize("name", NAMES)
def test_help_shows_every_letter_of_what_options_say(name, monkeypatch):
    """Nothing of a text is taken for markup, as "x[n+1]" would be, and no line ends early."""
    monkeypatch.setenv("COLUMNS", "4000")
    shown = run(name, "--help").stdout
    own = COMMAND.commands[name]
    assert [p.help for p in own.params if p.help and p.help not in shown] == []
    assert all(" ".join(part.split()) in shown for part in own.help.split("\n\n"))


@pytest.mark.parametrize("name", NAMES)
def test_every_command_speaks_json(name):
    """Each command has --json."""
    assert any("--json" in parameter.opts for parameter in COMMAND.commands[name].params)


@pytest.mark.slow
@pytest.mark.parametrize("words", ["--help", "discover --help", "systems", "systems lorenz"])
def test_looking_around_is_quick(words):
    """Help and the list of systems load none of the libraries that search, plot or read tables."""
    heavy = "{'numpy', 'sympy', 'scipy', 'pandas', 'sklearn', 'torch', 'matplotlib', 'joblib'}"
    code = (
        f"import sys, runpy; sys.argv = ['dynsr', *{words.split()}]\n"
        "try: runpy.run_module('dynsr', run_name='__main__')\n"
        f"except SystemExit: print(sorted({heavy} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr.strip() == "[]"


def test_version():
    """--version prints the version alone."""
    import dynsr

    assert run("--version").stdout == f"dynsr {dynsr.__version__}\n"


def test_no_words_show_help():
    """Without any word the help is shown."""
    assert "generate" in run().stdout


def test_systems():
    """The known systems are listed; as JSON with equations that SymPy reads."""
    import sympy

    assert "lotka-volterra" in run("systems").stdout
    listed = json.loads(run("systems", "--json").stdout)
    assert [system["name"] for system in listed][:3] == ["lotka-volterra", "pendulum", "cart-pole"]
    (one,) = json.loads(run("systems", "pendulum", "--json").stdout)
    assert sympy.sympify(one["equations"]["theta2"]).free_symbols == set(
        sympy.symbols("theta1 theta2")
    )


def test_generate_is_the_solution(tmp_path):
    """Data that generate writes follow the system: linear decay to the solver's tolerance."""
    out = tmp_path / "d.csv"
    options = ("--x0", "2", "--span", "0,3", "--dt", "0.1", "--reltol", "1e-9", "--abstol", "1e-12")
    said = run("generate", "--equations", "x'=-x", *options, "-o", out).stderr
    assert "31 rows of t, x" in said
    (part,) = read_trajectories(out).trajectories
    assert np.allclose(part.x[:, 0], 2 * np.exp(-part.t), rtol=1e-8)


def test_generate_columns_and_noise(tmp_path):
    """Columns are t, states, inputs; noise is the asked fraction and comes from the seed."""
    paths = [tmp_path / f"{name}.csv" for name in "abc"]
    run("generate", "cart-pole", "-o", paths[0])
    assert paths[0].read_text().splitlines()[0] == "t,w,x,y,z,F"
    for path in paths[1:]:
        run("generate", "cart-pole", "-o", path, "--noise", 0.1, "--seed", 3)
    assert paths[1].read_bytes() == paths[2].read_bytes()
    clean, noisy = (read_trajectories(path).trajectories[0] for path in paths[:2])
    ratio = (noisy.x - clean.x).std(axis=0) / clean.x.std(axis=0)
    assert np.allclose(ratio, 0.1, rtol=0.1)
    assert np.array_equal(clean.inputs, noisy.inputs)


def test_generate_to_stdout():
    """Without a file the table, or with --json the columns, go to stdout and nothing else does."""
    text = run("generate", "pendulum", "--span", "0,0.05").stdout
    found = json.loads(run("generate", "pendulum", "--span", "0,0.05", "--json").stdout)
    assert found["rows"] == len(text.splitlines()) - 1 == 6
    assert text.splitlines()[1].split(",") == [
        repr(found["columns"][name][0]) for name in ("t", "theta1", "theta2")
    ]


def test_simulate_own_equations():
    """Simulate integrates equations of the user's own, with an input."""
    words = ("--equations", "dx/dt = F", "--inputs", "F=cos(t)", "--x0", "0", "--span", "0,2")
    found = json.loads(run("simulate", *words, "--json").stdout)["columns"]
    assert np.allclose(found["x"], np.sin(found["t"]), atol=1e-5)


BAD = {
    "unknown system": ("generate nope", "unknown system 'nope'"),
    "unknown system to show": ("systems nope", "unknown system 'nope'"),
    "no system": ("generate", "name of a known system or --equations"),
    "unknown command": ("nope", "No such command 'nope'"),
    "unknown option": ("systems --nope", "No such option"),
    "unknown engine": ("generate lorenz --engine nope", "unknown engine 'nope'"),
    "negative noise": ("generate lorenz --noise -1", "noise -1"),
    "noise not finite": ("generate lorenz --noise nan", "noise nan"),
    "step of zero": ("generate lorenz --dt 0", "--dt 0 must be above 0"),
    "step too small": ("generate lorenz --dt 1e-12", "more than 5e+06 numbers"),
    "step too large": ("generate lorenz --dt 100", "fit into the span"),
    "span backwards": ("generate lorenz --span 5,1", "must run forward"),
    "span of text": ("generate lorenz --span a,b", "'a,b' is not 2 numbers"),
    "span infinite": ("generate lorenz --span 0,inf", "not 2 numbers"),
    "wrong start": ("generate lorenz --x0 1,2", "'1,2' is not 3 numbers"),
    "no equation": ("generate --equations nonsense", "cannot read equation 'nonsense'"),
    "unknown name": ("generate --equations x'=y", "unknown name 'y'"),
    "code": ("generate --equations x'=__import__('os').system('true')", "cannot read expression"),
    "function as state": ("generate --equations sin'=1", "name of a function"),
    "two equations": ("generate --equations x'=1;x'=2", "'x' has two equations"),
    "divergence": ("generate --equations x'=x^2 --x0 1", "no solution at t ="),
    "tolerance": ("generate lorenz --reltol 0", "reltol 0"),
    "file type": ("generate lorenz -o out.xlsx", "ends in .csv or .tsv"),
    "no folder": ("generate lorenz -o /nowhere/at/all.csv", "cannot write"),
    "seed": ("generate lorenz --seed -1", "--seed"),
    "unknown benchmark": ("benchmark nope", "unknown benchmark 'nope'"),
    "no data": ("discover", "give a file of data or --system"),
    "both data": ("discover a.csv --system lorenz", "one of the two"),
    "unknown system to discover": ("discover --system nope", "unknown system 'nope'"),
    "missing file": ("discover nowhere.csv", "there is no file 'nowhere.csv'"),
    "directory": ("discover .", "is a directory"),
    "missing discovery": ("score nowhere.json nowhere.csv", "there is no file 'nowhere.json'"),
    "missing results": ("report nowhere", "there is no file 'nowhere'"),
    "unknown replicated system": ("replicate --systems nope", "unknown system 'nope'"),
    "unknown replicated method": ("replicate --methods nope", "unknown method 'nope'"),
    "no runs": ("replicate --runs 0", "--runs"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_command_lines_end_in_one_line(case, tmp_path, monkeypatch):
    """A command line that cannot be obeyed ends in one line that names the value, and code 2."""
    monkeypatch.chdir(tmp_path)
    words, said = BAD[case]
    assert said in refuse(*words.split(" "))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_not_a_fault_without_a_reader():
    """A reader that closes the pipe, such as head, is no error."""
    child = spawn("generate", "lorenz", "--dt", "0.001")
    assert child.stdout is not None and child.stderr is not None
    child.stdout.readline()
    child.stdout.close()
    errors = child.stderr.read()
    child.stderr.close()
    assert child.wait() == 0 and errors == ""


@pytest.mark.slow
def test_interrupt_is_130():
    """Ctrl-C ends a running command in one line and exit code 130."""
    child = spawn("generate", "lorenz", "--dt", "0.0001", start_new_session=True)
    assert child.stdout is not None and child.stderr is not None
    child.stdout.readline()  # 100 000 rows do not fit into the pipe, so the command still runs
    os.killpg(child.pid, signal.SIGINT)
    assert child.stderr.read() == "error: interrupted\n"
    child.stdout.close()
    child.stderr.close()
    assert child.wait() == 130


def test_interrupt_that_a_search_swallows_is_130():
    """A search that answers Ctrl-C with its best so far has its result printed, with code 130."""
    small = typer.Typer(cls=CommandGroup)

    @small.command()
    def search() -> None:
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(30)
        except KeyboardInterrupt:
            typer.echo("best so far")

    @small.callback()
    def words() -> None:
        pass

    result = CliRunner().invoke(small, ["search"])
    assert (result.exit_code, result.stdout) == (130, "best so far\n")


@pytest.mark.parametrize(
    ("number", "code", "said"),
    [(signal.SIGTERM, 143, "error: terminated\n"), (signal.SIGINT, 130, "error: interrupted\n")],
)
@pytest.mark.parametrize("becomes", ["ValueError", "SystemError", "ImportError", "nothing"])
def test_an_end_by_a_signal_is_no_fault_whatever_it_becomes(number, code, said, becomes, capfd):
    """Compiled code may make another error of the exception of a signal: still the signal's end.

    It may lose the exception too; then the command says what it has, with the signal's code.
    """
    small = typer.Typer(cls=CommandGroup)

    @small.command()
    def draw() -> None:
        try:
            os.kill(os.getpid(), number)
            time.sleep(30)
        except BaseException:
            pass
        if becomes != "nothing":
            raise getattr(builtins, becomes)("Invalid affine transformation matrix")

    @small.callback()
    def words() -> None:
        pass

    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    with pytest.raises(SystemExit) as end:
        typer.main.get_command(small).main(["draw"])
    quiet = becomes == "nothing" and number == signal.SIGINT  # a search has answered it
    assert (end.value.code, capfd.readouterr().err) == (code, "" if quiet else said)
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before


def test_after_ctrl_c_an_error_with_a_remedy_is_told():
    """A search answers Ctrl-C with its best so far; that it cannot be written is said."""
    small = typer.Typer(cls=CommandGroup)

    @small.command()
    def search() -> None:
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(30)
        raise OSError(28, "full")

    @small.callback()
    def words() -> None:
        pass

    result = CliRunner().invoke(small, ["search"])
    assert (result.exit_code, result.stderr) == (2, "error: cannot use: full\n")


def test_faults_are_told_from_bad_input():
    """A fault of our own ends in one line that says so, exit code 1; memory and files in 2."""
    small = typer.Typer(cls=CommandGroup)

    @small.command()
    def fail(kind: str) -> None:
        raise {
            "fault": ZeroDivisionError("1/0"),
            "memory": MemoryError(),
            "file": OSError(28, "full"),
        }[kind]

    @small.callback()
    def words() -> None:
        pass

    for kind, code, said in (
        ("fault", 1, "a fault in dynsr: ZeroDivisionError: 1/0"),
        ("memory", 2, "there is not enough memory"),
        ("file", 2, "full"),
    ):
        result = CliRunner().invoke(small, ["fail", kind])
        assert result.exit_code == code and said in result.stderr
        assert result.stderr.count("\n") == 1


@pytest.mark.slow
def test_exit_codes_in_a_real_shell(tmp_path):
    """The process itself ends with 0 and pure JSON, or with 2 and one line."""
    good = spawn("systems", "--json")
    out, _ = good.communicate()
    assert good.returncode == 0 and len(json.loads(out)) >= 9
    bad = spawn("systems", "nope", "--json")
    out, errors = bad.communicate()
    assert bad.returncode == 2 and out == "" and errors.count("\n") == 1


@pytest.mark.slow
def test_replicate_and_report(tmp_path, monkeypatch):
    """A replication ends in records, tables, the figure and a page; the page can be made anew."""
    import dynsr.paper

    out = tmp_path / "results"
    words = ("--systems", "lotka-volterra", "--methods", "ga", "--runs", 1, "--quick", "-j", 1)
    written = []
    write = dynsr.paper.write_results
    monkeypatch.setattr(
        dynsr.paper, "write_results", lambda *args: written.append(args) or write(*args)
    )
    found = json.loads(run("replicate", *words, "-o", out, "--json", "-q").stdout)
    assert len(written) == 1
    assert found["settings"]["quick"] and len(found["records"]) == 1
    assert all(Path(path).exists() for path in found["files"])
    page = (out / "report.html").read_bytes()
    (out / "report.html").unlink()
    run("report", out)
    assert (out / "report.html").read_bytes() == page
    run("report", out, "-o", tmp_path / "other.html")
    assert (tmp_path / "other.html").read_bytes() == page
    assert "with seed 0, not 1" in refuse("replicate", *words, "--seed", 1, "-o", out)
    (record,) = (out / "cells").iterdir()
    record.write_bytes(record.read_bytes()[:-40])
    assert record.name in refuse("report", out)
    (out / "manifest.json").write_text("{")
    assert "manifest" in refuse("report", out)


def test_an_interrupted_replication_says_how_to_go_on(monkeypatch, tmp_path):
    """Ctrl-C in a replication ends in 130 and says where the finished cells are."""

    def stop(**options):
        raise KeyboardInterrupt

    monkeypatch.setattr("dynsr.paper.replicate", stop)
    said = run("replicate", "-o", tmp_path / "here", code=130).stderr
    assert "here; the same command goes on" in said and "error: interrupted" in said


def test_folders_that_are_not_ours(tmp_path):
    """A folder that holds other things, a file, and one that cannot be made are refused."""
    (tmp_path / "letter.txt").write_text("dear")
    words = ("replicate", "--systems", "pendulum", "--methods", "ga", "--quick", "-o")
    assert "letter.txt" in refuse(*words, tmp_path)
    assert "is a file" in refuse(*words, tmp_path / "letter.txt")
    assert "cannot write" in refuse(*words, tmp_path / "letter.txt" / "below")


@pytest.mark.slow
def test_audit():
    """The audit gives 33 rows with what other tools read, of which 31 agree."""
    rows = json.loads(run("audit", "--json").stdout)
    assert len(rows) == 33 and sum(row["agrees"] for row in rows) == 31
    assert {"system", "method", "run", "printed", "ours", "agrees", "note"} <= set(rows[0])
    assert all(row["unrounded"] for row in rows if not row["agrees"])


@pytest.mark.slow
def test_julia_without_julia_is_one_line():
    """Asking for an engine that is absent gives one line and exit code 2, before any work."""
    if importlib.util.find_spec("juliacall"):
        pytest.skip("juliacall is installed here")
    for words in (("generate", "lorenz"), ("discover", "--system", "lorenz"), ("audit",)):
        child = spawn(*words, "--engine", "julia")
        out, errors = child.communicate()
        assert child.returncode == 2 and out == "" and errors.count("\n") == 1
        assert f"run {say_install('julia')}" in errors


def test_doctor():
    """The doctor names what is installed with its version, and what mends what is missing."""
    found = {check["name"]: check for check in json.loads(run("doctor", "--json").stdout)}
    assert found["numpy"]["detail"] == np.__version__
    assert found["embedded: integration"]["state"] == "ok"
    assert all(check["remedy"] for check in found.values() if check["state"] == "missing")
    assert "embedded: regression" in run("doctor").stdout


def test_doctor_fails_on_what_is_needed(monkeypatch):
    """What is needed and missing is exit code 2, what fails 1, each after the whole table."""
    import dynsr.checks

    broken = dynsr.checks.doctor.Check("numpy", "missing", "not installed", "pip install numpy")
    monkeypatch.setattr(dynsr.checks, "examine", lambda: [broken])
    assert "pip install numpy" in run("doctor", code=2).stdout
    still = dynsr.checks.doctor.Check("julia: engine", "fails", "no start", "mend it", False)
    monkeypatch.setattr(dynsr.checks, "examine", lambda: [broken, still])
    assert "mend it" in run("doctor", code=1).stdout


@pytest.mark.slow
def test_crosscheck(monkeypatch):
    """A crosscheck gives a verdict a row, and exit code 2 when one differs."""
    import dynsr.checks

    words = ("crosscheck", "--systems", "cart-pole", "--sections", "corrected")
    rows = json.loads(run(*words, "--json").stdout)
    assert rows and {row["verdict"] for row in rows} <= {"agrees", "absent"}
    assert "unknown section 'nope'" in refuse("crosscheck", "--sections", "nope")
    row, *_ = dynsr.checks.crosscheck(["cart-pole"], sections=["corrected"])
    wrong = dataclasses.replace(row, difference=1.0)
    monkeypatch.setattr(dynsr.checks, "crosscheck", lambda **_: [wrong])
    assert json.loads(run("crosscheck", "--json", code=2).stdout)[0]["verdict"] == "differs"


def test_benchmarks_are_listed():
    """Without a name the benchmarks are listed."""
    rows = json.loads(run("benchmark", "--json").stdout)
    assert [row["name"] for row in rows] == ["recovery", "zoo", "random", "FILE.json"]
    assert all(row["name"] in run("benchmark").stdout for row in rows)


def test_random_systems_cannot_be_chosen_by_name():
    """Names beside a benchmark of random systems are refused, with the option that counts them."""
    words = run("benchmark", "random", "--systems", "logistic", code=2).stderr
    assert "leave --systems out, give --count" in words


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("dynsr gen", "generate"),
        ("dynsr generate lot", "lotka-volterra"),
        ("dynsr discover --system pen", "pendulum"),
        ("dynsr generate lorenz --engine emb", "embedded"),
    ],
)
def test_shell_completion(typed, offered):
    """The shell completes commands, systems and engines."""
    words = typed.split()
    environment = {
        "_DYNSR_COMPLETE": "complete_bash",
        "COMP_WORDS": typed,
        "COMP_CWORD": str(len(words) - 1),
    }
    result = CliRunner().invoke(app, [], prog_name="dynsr", env=environment)
    assert result.stdout.split() == [offered]


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("--states ", ["t", "x_speed", "y", "xx"]),
        ("--states y,x", ["y,x_speed", "y,xx"]),
        ("--states x,x_", ["x,x_speed"]),
        ("--time t", ["t"]),
        ("--trajectory xx", ["xx"]),
        ("--json --inputs y", ["y"]),
        ("--scheme central4", ["central4"]),
        ("--scheme w", ["weak"]),
        ("--loss h", ["huber"]),
    ],
)
def test_the_shell_completes_the_columns_of_the_file(tmp_path, typed, offered):
    """Options that name columns offer those of the file on the line, after a comma the next."""
    file = tmp_path / "data.csv"
    file.write_text("t,x_speed,y,xx\n" + "".join(f"{i},{i},{i},{i}\n" for i in range(5)))
    line = f"dynsr discover {file} {typed}"
    environment = {"_DYNSR_COMPLETE": "complete_bash", "COMP_WORDS": line}
    environment["COMP_CWORD"] = str(len(line.split(" ")) - 1)
    result = CliRunner().invoke(app, [], prog_name="dynsr", env=environment)
    assert result.stdout.split() == offered
    environment["COMP_WORDS"] = line.replace("data.csv", "none.csv")
    result = CliRunner().invoke(app, [], prog_name="dynsr", env=environment)
    assert result.stdout.split() == (offered if "scheme" in typed or "loss" in typed else [])
