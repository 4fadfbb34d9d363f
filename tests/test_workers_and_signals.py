"""Workers that die, forks, signals and closed streams end in an answer or one line."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import sympy
from command_line import run
from waiting import wait_for

from dynsr.data.reading import write_csv
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.search import discover
from dynsr.errors import InputError
from dynsr.fit.candidates import ParetoFront, score_candidate
from dynsr.jobs.pool import spread
from dynsr.methods.base import AbstractMethod
from dynsr.methods.rational import RationalSearch

QUICK = RationalSearch(costs=(2,), max_terms=3, denominators=False, rounds=1)
T = np.linspace(0, 6, 61)
X = np.column_stack([np.exp(-0.5 * T), np.exp(-0.5 * T) * (1 + T)])


@dataclass(frozen=True)
class Dying(AbstractMethod):
    """A method whose process is killed the first times, as where the memory is short.

    With ``after`` it waits until another has been killed twice.
    """

    marks: Path
    times: int
    name: str = "dying"
    after: Path | None = None

    def search(self, samples, rng, report=None):
        """Kill the process until there are enough marks, then search quickly."""
        while self.after is not None and len(list(self.after.iterdir())) < 2:
            time.sleep(0.05)
        number = len(list(self.marks.iterdir()))
        if number < self.times:
            (self.marks / f"{number}-{os.getpid()}").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return QUICK.search(samples, rng)


@pytest.mark.slow
@pytest.mark.parametrize("late", [False, True])
def test_a_worker_that_dies_is_started_again_and_named_if_it_always_dies(tmp_path, late):
    """One that dies once is not spoken of; one that always does is named, and others answer."""
    marks = [tmp_path / name for name in ("once", "always")]
    for path in marks:
        path.mkdir()
    once = Dying(marks[0], 1, "dying once", marks[1] if late else None)
    dying = [once, Dying(marks[1], 99, "always dying")]
    found = discover((T, X), method=[QUICK, *dying], jobs=2, targets="x")
    assert str(found.equations["x"]) == "-0.5*x"
    said = found.explanation["x"]
    assert "Without always dying, which failed (DynsrError: its process died" in said
    assert "dying once" not in said and said.count("failed") == 1
    assert len(list(marks[0].iterdir())) == 1
    assert any(c.source.startswith("rational") for c in found.front["x"])


@pytest.mark.slow
def test_no_more_workers_start_than_there_are_tasks():
    """Of 24 workers asked for, two are started for two calls."""
    before = set(_children())
    pids = dict(spread(_with_siblings, [(os.getpid(),), (os.getpid(),)], 24))
    started = {pid for found in pids.values() for pid in found} - before
    # Two workers, and the trackers of loky; none where an earlier test has left two to use again.
    assert sorted(pids) == [0, 1]
    assert len(started) <= 4


def _children(parent=None):
    """List the processes that this one, or another, has started."""
    path = Path(f"/proc/{parent or os.getpid()}/task")
    return [int(p) for c in path.glob("*/children") for p in c.read_text().split()]


def _with_siblings(parent):
    time.sleep(0.3)
    return _children(parent)


TWO_JOBS_IN_A_FORK = """
import multiprocessing
from dynsr.jobs.pool import spread

def in_the_fork(queue):
    queue.put(dict(spread(pow, [(2, 3), (2, 5)], 2)))

if __name__ == "__main__":
    fork = multiprocessing.get_context("fork")
    queue = fork.Queue()
    child = fork.Process(target=in_the_fork, args=(queue,))
    child.start()
    assert queue.get(timeout=120) == {0: 8, 1: 32}
    child.join(timeout=120)
    assert child.exitcode == 0
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_two_jobs_in_a_forked_process_end(tmp_path):
    """A fork of multiprocessing waits for its children, so that its workers must end before it.

    The program runs by itself: other tests load JAX, which warns of any fork after it.
    """
    program = tmp_path / "fork.py"
    program.write_text(TWO_JOBS_IN_A_FORK, encoding="utf-8")
    run = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr


@pytest.fixture
def table(tmp_path):
    """A table of two coupled states."""
    write_csv(Trajectory(T, X, ("x", "y")), tmp_path / "d.csv")
    return tmp_path / "d.csv"


@pytest.fixture
def long_search(tmp_path):
    """A table whose noise leaves much to search, so that no end comes before the signal."""
    noise = np.random.default_rng(0).normal(0, 0.02, X.shape)
    write_csv(Trajectory(T, X + noise, ("x", "y")), tmp_path / "noisy.csv")
    return tmp_path / "noisy.csv"


def start(*words, **options):
    """Start the command."""
    return subprocess.Popen(
        [sys.executable, "-m", "dynsr", *map(str, words)],
        stdout=options.pop("stdout", subprocess.PIPE),
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def _session(leader):
    """List the processes of a session that still run."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = entry.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(session) == leader and state != "Z":
            found.append(int(entry.parent.name))
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc to look at processes")
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_command_that_is_ended_leaves_no_worker_and_no_shared_memory(end, long_search, tmp_path):
    """SIGTERM or kill -9 of the parent alone ends all workers at once and leaves no file."""
    before = {path.name for path in Path("/dev/shm").iterdir()}
    words = ("discover", long_search, "-j", 2, "-o", tmp_path / "out")
    child = start(*words, start_new_session=True)
    records = tmp_path / "out" / "records"
    assert wait_for(lambda: len(_session(child.pid)) >= 3, 60)
    os.kill(child.pid, end)
    said = child.communicate()[1]
    assert child.returncode == (143 if end == signal.SIGTERM else -9)
    assert "Traceback" not in said
    assert wait_for(lambda: not _session(child.pid), 60)
    left = {path.name for path in Path("/dev/shm").iterdir()} - before
    assert not [name for name in left if f"_{child.pid}_" in name or f"-{child.pid}-" in name]
    assert not list(records.glob(".*")) or end == signal.SIGKILL


@pytest.mark.slow
def test_ctrl_c_on_one_of_two_commands_on_a_folder_leaves_the_other(table, tmp_path):
    """Two discoveries write the same records; the end of one is not that of the other."""
    words = ("discover", table, "--preset", "quick", "--method", "rational", "--targets", "x")
    search = (*words, "--functions", "none", "-j", 1, "-q", "-o")
    words = (*search, tmp_path / "out")
    run(*search, tmp_path / "whole")
    one, two = start(*words), start(*words)
    assert wait_for((tmp_path / "out" / "manifest.json").exists, 60)
    one.send_signal(signal.SIGINT)
    one.communicate()
    said = two.communicate()[1]
    assert two.returncode == 0, said
    same = [(tmp_path / n / "discovery.json").read_text() for n in ("out", "whole")]
    assert _without_times(same[0]) == _without_times(same[1])


def _without_times(text):
    return [
        line for line in text.splitlines() if '"seconds"' not in line and "checksum" not in line
    ]


@pytest.mark.slow
@pytest.mark.parametrize("words", [("systems",), ("--help",)])
def test_a_reader_that_has_enough_is_no_fault(words):
    """Piped into head -1, every command ends with 0 and says nothing on stderr."""
    reader, writer = os.pipe()
    child = start(*words, stdout=writer)
    os.close(writer)
    os.read(reader, 10)
    os.close(reader)
    said = child.communicate()[1]
    assert (child.returncode, said) == (0, "")


@pytest.mark.slow
def test_a_full_output_is_one_line():
    """What cannot be written is told, with exit code 2."""
    with open("/dev/full", "w") as full:
        child = start("generate", "lorenz", stdout=full)
        said = child.communicate()[1]
    assert child.returncode == 2 and said.count("\n") == 1 and "No space left" in said


def test_a_closed_output_is_nothing():
    """With stdout closed the command ends with 0."""
    command = f"'{sys.executable}' -m dynsr systems >&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


# Commands one after the other, their answers apart.
TWICE = """
import sys
from dynsr.cli import main
words = sys.argv[1:]
for last in ([], ["--json"]):
    sys.argv[1:] = [*words, *last]
    try:
        main()
    except SystemExit as end:
        assert not end.code
    print("--", flush=True)
"""


@pytest.mark.slow
def test_names_are_printed_whatever_the_terminal_knows(tmp_path):
    """With an encoding that has no Greek letters, they are escaped; JSON stays JSON."""
    write_csv(Trajectory(T, X[:, :1], ("μ",)), tmp_path / "d.csv")
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    environment |= {"PYTHONIOENCODING": "ascii:strict", "MPLBACKEND": "no such backend"}
    words = ("discover", "d.csv", "--preset", "quick", "--method", "rational", "-j", "1")
    words = (*words, "--functions", "none")
    child = subprocess.run(
        [sys.executable, "-c", TWICE, *words, "-o", "out"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert child.returncode == 0, child.stderr
    plain, record, rest = child.stdout.split("--\n")
    assert "\\u03bc" in plain and "\\u03bc" in record and not rest
    assert "Traceback" not in child.stderr
    assert set(json.loads(record)["equations"]) == {"μ"}


@pytest.mark.slow
def test_ctrl_c_while_it_starts_is_one_line():
    """However early after Python itself it comes, there is no traceback."""
    code = (
        "import os, signal, sys\n"
        "from dynsr.cli import main\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == sys.argv[1]: os.kill(os.getpid(), {int(signal.SIGINT)})\n"
        "sys.meta_path.insert(0, Finder())\n"
        "at = sys.argv[1]\n"
        "sys.argv[1:] = ['systems']\n"
        "Finder.find_spec.__defaults__\n"
        "real = Finder.find_spec\n"
        "Finder.find_spec = lambda self, name, path=None, target=None: "
        f"os.kill(os.getpid(), {int(signal.SIGINT)}) if name == at else None\n"
        "main()\n"
    )
    for at in ("typer", "dynsr.cli.app", "numpy", "dynsr.cli.group"):
        done = subprocess.run([sys.executable, "-c", code, at], capture_output=True, text=True)
        if done.returncode:  # a module that this command does not load interrupts nothing
            assert (done.returncode, done.stderr) == (130, "error: interrupted\n")
    assert done.returncode == 130


@pytest.mark.parametrize(
    "words",
    [
        ("replicate", "--systems", ""),
        ("replicate", "--methods", ","),
        ("benchmark", "recovery", "--systems", ""),
        ("crosscheck", "--systems", ","),
        ("discover", "--system", "lorenz", "--targets", ""),
    ],
)
def test_names_that_are_empty_start_nothing(words, tmp_path, monkeypatch):
    """An option that names nothing is no option left out."""
    monkeypatch.chdir(tmp_path)
    assert f"{words[-2]} names nothing" in run(*words, code=2).stderr
    assert not list(tmp_path.iterdir())


def test_a_value_that_diverges_is_told(table, tmp_path):
    """The table of scores says so where a JSON null would be a blank cell."""
    from dynsr.discovery.result import Discovery
    from dynsr.expression.parsing import parse

    saved = Discovery({"x": parse("x**3"), "y": parse("y**3")}, {}, {}, {}).save(
        tmp_path / "d.json"
    )
    assert "diverges" in run("score", saved, table).stdout


@pytest.mark.slow
@pytest.mark.parametrize("part", ["records/search-x-rational.json", "manifest.json"])
def test_a_flipped_bit_in_what_is_finished_is_never_believed(part, tmp_path):
    """A damaged record is made again, with a word; a damaged manifest is refused."""
    asked = {"method": QUICK, "targets": "x", "jobs": 1, "out": tmp_path}
    whole = discover((T, X), **asked)
    path = tmp_path / part
    content = bytearray(path.read_bytes())
    for at in range(40, len(content), max(1, len(content) // 5)):
        changed = bytearray(content)
        changed[at] ^= 4
        path.write_bytes(changed)
        if part == "manifest.json":
            # Of the hex digits of the key, a flipped one is still a key: another discovery's.
            with pytest.raises(InputError, match=r"damaged|holds results with"):
                discover((T, X), **asked)
            continue
        with pytest.warns(UserWarning, match="computing it again"):
            again = discover((T, X), **asked)
        assert {**again.as_record(), "seconds": 0} == {**whole.as_record(), "seconds": 0}
        path.write_bytes(content)


@pytest.mark.slow
def test_states_whose_names_a_file_system_confuses_have_records_of_their_own(tmp_path):
    """Upper and lower case, Greek letters and very long names each keep their own record."""
    names = ("x", "X", "μ", "n" * 300)
    states = np.column_stack([np.exp(-(0.2 + 0.1 * i) * T) for i in range(4)])
    found = discover(Trajectory(T, states, names), method=QUICK, jobs=1, out=tmp_path)
    files = [path.name for path in (tmp_path / "records").iterdir()]
    assert len({name.lower() for name in files}) == 8 and all(map(str.isascii, files))
    again = discover(Trajectory(T, states, names), method=QUICK, jobs=1, out=tmp_path)
    assert again.equations == found.equations


@dataclass(frozen=True)
class Quarter(AbstractMethod):
    """A method whose formula SymPy reads back in another form than it was written from."""

    name = "quarter"

    def search(self, samples, rng, report=None):
        """Give y/4/(log(x) + 7/2) beside a poorer one."""
        x, y = sympy.symbols("x y")
        odd = y / 4 / (sympy.log(x) + sympy.Rational(7, 2))
        return ParetoFront(score_candidate(e, samples, self.name) for e in (odd, -x / 2))


@pytest.mark.filterwarnings("ignore:the slopes given")
@pytest.mark.slow
def test_what_is_read_back_gives_the_very_same_result(tmp_path):
    """Formulas that were kept and read have the same form as those that were never written."""
    slopes = X[:, 1] / 4 / (np.log(X[:, 0]) + 3.5)
    options = {"method": Quarter(), "jobs": 1, "targets": "x", "slopes": {"x": slopes}}
    kept = [discover((T, X), **options, out=tmp_path / "out").as_record() for _ in range(2)]
    fresh = discover((T, X), **options).as_record()
    assert all({**record, "seconds": 0} == {**fresh, "seconds": 0} for record in kept)
