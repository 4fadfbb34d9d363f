import importlib.util
import os
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dynsr.data import PAPER_SYSTEMS, take_trajectories
from dynsr.engines import simulate

ROOT = Path(__file__).parent.parent
SCRIPTS = ("table1", "table2", "figure1", "appendix_ga", "appendix_dynaifeynman", "appendix_sindy")


@pytest.fixture
def run(monkeypatch, capsys):
    """Give a call that runs a script in this process; it gives the exit code and what it said."""
    monkeypatch.syspath_prepend(ROOT / "scripts")
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")

    def call(script, *arguments):
        monkeypatch.setattr(sys, "argv", [script, *map(str, arguments)])
        code = 0
        try:
            runpy.run_path(str(ROOT / "scripts" / f"{script}.py"), run_name="__main__")
        except SystemExit as end:
            code = end.code
        return code, *capsys.readouterr()

    yield call
    sys.modules.pop("experiment", None)


@pytest.mark.parametrize("name", SCRIPTS)
def test_each_script_is_small_and_says_what_it_makes(name):
    """A script is a few lines over the API and names its table or figure first."""
    text = (ROOT / "scripts" / f"{name}.py").read_text()
    assert len(text.splitlines()) <= 25
    assert os.access(ROOT / "scripts" / f"{name}.py", os.X_OK)
    assert text.splitlines()[1].startswith(('"""Table', '"""Figure'))


@pytest.mark.slow
def test_the_appendix_of_the_ga_is_made_and_continued(tmp_path, run):
    """--quick gives three tables of two runs each; the next call takes them from the records."""
    code, shown, said = run("appendix_ga", "--quick", "--out", tmp_path)
    assert code == 0, said
    assert shown.count("GA-Baseline on") == 3
    table = (tmp_path / "tables" / "appendix_ga_pendulum.csv").read_text().splitlines()
    assert table[0].startswith("By,Runs,Formula,Stage,As printed")
    assert [line.partition(",")[0] for line in table[1:]].count("paper") >= 3
    cells = {p: p.stat().st_mtime_ns for p in tmp_path.glob("cells/*.json")}
    assert len(cells) == 6 and run("appendix_ga", "--quick", "--out", tmp_path)[0] == 0
    assert {p: p.stat().st_mtime_ns for p in tmp_path.glob("cells/*.json")} == cells
    code, _, said = run("appendix_ga", "--out", tmp_path)
    assert code == 2 and "quick True" in said
    assert "Traceback" not in said


def test_table_2_is_printed_and_written(tmp_path, run):
    """The script of Table 2 needs no search."""
    code, shown, said = run("table2", "--out", tmp_path)
    assert code == 0, said
    assert "bitstring length" in shown
    assert "| iterations | 100 | 40 | 100 |" in (tmp_path / "tables" / "table2.md").read_text()


def test_pages_hold_what_their_blocks_print(tmp_path):
    """Blocks run in order and share names; an old output gives way, and prose stays."""
    page = tmp_path / "page.md"
    page.write_text("A\n\n```python\nx = 2\n```\n\nB\n\n```python\nprint(x + 1)\n```\n\nC\n")
    for _ in range(2):
        done = subprocess.run([sys.executable, ROOT / "scripts" / "pages", page], check=True)
        assert done.returncode == 0
        shown = "```python\nprint(x + 1)\n```\n\n```text\n3\n```\n\nC\n"
        assert page.read_text() == f"A\n\n```python\nx = 2\n```\n\nB\n\n{shown}"


@pytest.mark.skipif(os.name != "posix", reason="the scripts are of a POSIX shell")
@pytest.mark.parametrize(
    ("arguments", "slow", "last"),
    [
        ((), False, "Tests marked slow did not run; scripts/test --all runs them too."),
        (("--all",), True, "1 failed in 2.00s"),
        (("-n", "0", "tests/test_scripts.py"), True, "1 failed in 2.00s"),
    ],
)
def test_slow_tests_are_left_out_by_one_call_alone(tmp_path, arguments, slow, last):
    """Without arguments the slow ones do not run, and its end says so; a failure stays one."""
    log, python = tmp_path / "log", tmp_path / "bin" / "python"
    python.parent.mkdir()
    python.write_text(f"#!/bin/sh\nprintf '%s\\n' \"$@\" > {log}\necho 1 failed in 2.00s\nexit 1\n")
    python.chmod(0o755)
    environment = {**os.environ, "VIRTUAL_ENV": str(tmp_path), "DYNSR_USE_ACTIVE_ENV": "1"}
    command = [ROOT / "scripts" / "test", *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (1, last)
    words = log.read_text().splitlines()
    assert words[:2] == ["-m", "pytest"] and "--all" not in words
    assert ("not slow" in words) is not slow
    if arguments[1:]:
        assert words[2:] == list(arguments)


@pytest.mark.skipif(os.name != "posix", reason="the scripts are of a POSIX shell")
@pytest.mark.parametrize("can", [True, False])
def test_continuous_integration_checks_and_runs_every_test(tmp_path, can):
    """.ci/run calls the checks, then all tests, and first installs what tests of pages and exports
    need, or says which tests are skipped. No job of the forge leaves the slow ones out.
    """
    programs = ("chromium", "gcc", "gfortran", "octave-cli", "Rscript")
    bring = "for p in $*; do case $p in octave) p=octave-cli ;; r-*) p=Rscript ;; esac; "
    scripts = {
        ".ci/run": (ROOT / ".ci" / "run").read_text(),
        "scripts/environment": "#!/bin/sh\necho .venv/bin/python\n",
        "scripts/check": "#!/bin/sh\necho check ${DYNSR_REQUIRE_CHROMIUM:-0}\n",
        "scripts/test": "#!/bin/sh\necho test $*\n",
        "bin/id": f"#!/bin/sh\necho {0 if can else 1000}\n",
        "bin/apt-get": f"#!/bin/sh\n[ $1 = install ] && {bring}ln -sf id {tmp_path}/bin/$p; done\n",
    }
    for name, text in scripts.items():
        script = tmp_path / name
        script.parent.mkdir(exist_ok=True)
        script.write_text(text)
        script.chmod(0o755)
    for name in ("bash", "dirname", "ln"):
        (tmp_path / "bin" / name).symlink_to(shutil.which(name))
    done = subprocess.run(
        [tmp_path / ".ci" / "run"],
        env={"PATH": str(tmp_path / "bin")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == [f"check {int(can)}", "test --all"]
    skipped = [line.partition(" ")[0] for line in done.stderr.splitlines()]
    assert skipped == ([] if can else list(programs)), done.stderr
    assert "slow" not in (ROOT / ".github" / "workflows" / "ci.yml").read_text()


@pytest.mark.skipif(os.name != "posix", reason="the scripts are of a POSIX shell")
@pytest.mark.parametrize("installed", [True, False])
@pytest.mark.parametrize("arguments", [("--quick",), ("--engine", "julia"), ("--engine=julia",)])
def test_a_replication_in_julia_sets_julia_up_first(tmp_path, arguments, installed):
    """Where juliacall is missing it is installed, then Julia; without that engine nothing is."""
    log, python = tmp_path / "log", tmp_path / "bin" / "python"
    python.parent.mkdir()
    found = 0 if installed else 1
    python.write_text(
        f'#!/bin/sh\n[ "$1" = -c ] && exit {found}\nshift 1\necho "$*" | cut -d" " -f1-3 >> {log}\n'
    )
    python.chmod(0o755)
    environment = {**os.environ, "VIRTUAL_ENV": str(tmp_path), "DYNSR_USE_ACTIVE_ENV": "1"}
    subprocess.run([ROOT / "scripts" / "replicate", *arguments], env=environment, check=True)
    calls = log.read_text().splitlines()
    assert calls.pop().startswith(f"dynsr replicate {arguments[0]}")
    if "julia" not in " ".join(arguments):
        assert calls == []
    else:
        assert calls == [*([] if installed else ["pip install --quiet"]), "dynsr doctor --install"]


@pytest.mark.slow
@pytest.mark.parametrize("julia", ["stand-in", "real"])
def test_data_of_sciml_are_those_of_the_embedded_engine(julia, tmp_path):
    """Written with diffeqpy alone, three tables hold what the embedded engine integrates."""
    path = ROOT
    environment = dict(os.environ)
    if julia == "stand-in":
        # diffeqpy finds Julia by its folder on the path.
        path = os.pathsep.join([str(ROOT / "tests" / "fake_julia"), str(ROOT)])
        environment["PATH"] = os.pathsep.join(["/opt/julia/bin", os.environ["PATH"]])
    elif importlib.util.find_spec("diffeqpy") is None:
        if os.environ.get("DYNSR_REQUIRE_DIFFEQPY") == "1":
            pytest.fail("DYNSR_REQUIRE_DIFFEQPY is 1, but diffeqpy is not installed")
        pytest.skip("diffeqpy is not installed")
    tight = ["--reltol", "1e-10", "--abstol", "1e-10"]
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "sciml_data.py", *tight, "--out", tmp_path],
        capture_output=True,
        text=True,
        env={**environment, "PYTHONPATH": str(path)},
    )
    assert done.returncode == 0, done.stderr
    for system in PAPER_SYSTEMS:
        (run,), _ = take_trajectories(tmp_path / f"{system.name}.csv", system.inputs)
        assert run.states == system.states and len(run) == 1002
        own = simulate(system, t=run.t, reltol=1e-12, abstol=1e-12)
        assert abs(run.x - own.x).max() < 1e-6
        assert abs(run.inputs - own.inputs).max(initial=0.0) < 1e-12


def test_records_are_the_published_tables():
    """21 years, hares at their most in 1903 and lynx a year later; 14 days, most in bed: 298."""
    folder = ROOT / "docs" / "records"
    rows = [line.split(",") for line in (folder / "hare-lynx.csv").read_text().splitlines()[1:]]
    assert [int(year) for year, _, _ in rows] == list(range(1900, 1921))
    assert max(rows, key=lambda row: float(row[1]))[:2] == ["1903", "77.4"]
    assert max(rows, key=lambda row: float(row[2])) == ["1904", "36.3", "59.4"]
    beds = [int(line.split(",")[1]) for line in (folder / "influenza.csv").read_text().split()[1:]]
    assert len(beds) == 14 and max(beds) == beds[5] == 298
