"""Torture: discoveries killed and interrupted at random moments must end in the same result.

Every trial starts ``dynsr discover`` on a folder, ends it (or one of its workers) at a random
moment, and starts it again until it finishes. What it saves must be what an undisturbed run
saves, but for times; no process, no shared memory and no temporary file may be left. With
``--warm`` the command begins as a fork of a process that has loaded the libraries and found a
first law: trials are quicker, and only its loading is not hit.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
# Longer than any run takes; a run that is still there has hung.
_LONGEST = 600.0
_STARTS = 3
_SEARCH = ("--preset", "quick", "--method", "rational,sindy")
# For every line it reads: forks a command, writes its number, and then how it ended.
_WARM = """
import gc, json, os, sys, tempfile
import numpy, pandas, dynsr
from dynsr.cli import app, discovery, main, results
# Much is loaded, and remembered, only by a first discovery and its report.
t = numpy.linspace(0, 6, 31)
law = dynsr.discover(
    (t, numpy.exp(-t)[:, None]), method=["rational", "sindy"], preset="quick", jobs=1
)
with tempfile.TemporaryDirectory() as folder:
    law.report(os.path.join(folder, "report.html"))
# What is there now is looked at by no fork, which would copy it.
gc.freeze()
for line in sys.stdin:
    words, environment, said = json.loads(line)
    child = os.fork()
    if not child:
        os.setsid()
        os.environ.update(environment)
        tempfile.tempdir = None
        for number, path in enumerate((os.devnull, os.devnull, said)):
            os.dup2(os.open(path, os.O_RDWR | os.O_CREAT), number)
        sys.argv[1:] = words
        main()
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@dataclass
class Tally:
    """What was done, and what went wrong."""

    trials: dict[str, int] = field(default_factory=dict)
    hits: dict[str, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)

    def check(self, holds: bool, what: str) -> None:
        """Note a fault unless something holds."""
        if not holds:
            self.faults.append(what)


@dataclass(frozen=True)
class Whole:
    """What an undisturbed run has saved, how long it took, and how many records it kept."""

    found: dict[str, Any]
    seconds: float
    records: int


def make_data(path: Path) -> None:
    """Write two coupled states in closed form."""
    t = np.linspace(0, 6, 121)
    x, y = np.exp(-0.5 * t), np.exp(-0.5 * t) * (1 + t)
    rows = np.column_stack([t, x, y])
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="t,x,y", comments="")


class Forked:
    """A command in a fork of a warm process, with what is asked here of a Popen."""

    def __init__(self, warm: subprocess.Popen[str], words: list[str], scratch: Path) -> None:
        """Start it; what it says on stderr goes into a file."""
        self._warm, self._said = warm, scratch.with_name("said")
        self._said.write_text("")
        assert warm.stdin is not None
        assert warm.stdout is not None
        self._end = warm.stdout
        warm.stdin.write(json.dumps([words, _surroundings(scratch), str(self._said)]) + "\n")
        warm.stdin.flush()
        self.pid, self.returncode = int(self._end.readline()), -1
        self._over = False

    def poll(self) -> int | None:
        """Give how it ended, None while it runs."""
        if not self._over and select.select([self._end], [], [], 0)[0]:
            self.returncode, self._over = int(self._end.readline()), True
        return self.returncode if self._over else None

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Wait for its end; gives what it said."""
        if not self._over and not select.select([self._end], [], [], timeout)[0]:
            raise subprocess.TimeoutExpired("dynsr", timeout or 0)
        self.poll()
        return "", self._said.read_text("utf-8")


@dataclass
class Work:
    """What is tortured.

    Parameters
    ----------
    folder : where everything happens.
    search : the options of the discovery.
    starts : a trial hits at most so many starts of the command.
    warm : the process that forks the command; None to start it from nothing.
    """

    folder: Path
    search: tuple[str, ...] = _SEARCH
    starts: int = _STARTS
    warm: subprocess.Popen[str] | None = None

    def start(self, out: Path, jobs: int) -> subprocess.Popen[str] | Forked:
        """Start the discovery in a session of its own."""
        scratch = self.folder / "scratch"
        words = ["discover", self.folder / "data.csv", *self.search, "-j", jobs, "-q", "-o", out]
        plain = [str(word) for word in words]
        if self.warm is not None:
            return Forked(self.warm, plain, scratch)
        return subprocess.Popen(
            [sys.executable, "-m", "dynsr", *plain],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **_surroundings(scratch)},
            start_new_session=True,
        )


def _surroundings(scratch: Path) -> dict[str, str]:
    """Have the whole tree of processes write its temporary files where they are seen."""
    return {"TMPDIR": str(scratch), "JOBLIB_TEMP_FOLDER": str(scratch), "PYTHONPATH": str(ROOT)}


def processes_of(session: int) -> list[int]:
    """List the processes of a session that still run."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, own = entry.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(own) == session and state != "Z":
            found.append(int(entry.parent.name))
    return found


def workers_of(session: int) -> list[int]:
    """List the workers of a discovery: those that loky has started."""
    found = []
    for pid in processes_of(session):
        try:
            words = Path(f"/proc/{pid}/cmdline").read_bytes()
        except OSError:
            continue
        if pid != session and b"popen_loky" in words:
            found.append(pid)
    return found


def saved(out: Path) -> Any:
    """Give what a discovery has saved, without times and what follows from them."""
    record = json.loads((out / "discovery.json").read_text("utf-8"))
    return {k: v for k, v in record.items() if k not in ("seconds", "checksum")}


def finish(child: subprocess.Popen[str] | Forked, tally: Tally, what: str) -> tuple[int, str]:
    """Wait for the end of a command and of all its processes; gives its code and its words."""
    try:
        said = child.communicate(timeout=_LONGEST)[1]
    except subprocess.TimeoutExpired:
        tally.check(False, f"{what}: it hangs")
        os.killpg(child.pid, signal.SIGKILL)
        said = child.communicate()[1]
    until = time.monotonic() + 30
    while (left := processes_of(child.pid)) and time.monotonic() < until:
        time.sleep(0.05)
    tally.check(not left, f"{what}: {len(left)} processes are left")
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    tally.check("Traceback" not in said, f"{what}: a traceback: {said[-300:]}")
    return child.returncode, said


def hit(
    child: subprocess.Popen[str] | Forked, kind: str, out: Path, kept: int, pause: float
) -> bool:
    """Send a signal a pause after a number of records is kept; says whether there was what to hit.

    A worker is waited for.
    """
    while child.poll() is None and (
        len(list(out.glob("records/[!.]*"))) < kept
        or (kind == "worker" and not workers_of(child.pid))
    ):
        time.sleep(0.01)
    until = time.monotonic() + pause
    while time.monotonic() < until and child.poll() is None:
        time.sleep(0.01)
    if child.poll() is not None:
        return False
    target = child.pid
    if kind == "worker":
        workers = workers_of(child.pid)
        if not workers:
            return False
        target = random.choice(workers)
    number = {"interrupt": signal.SIGINT, "terminate": signal.SIGTERM}.get(kind, signal.SIGKILL)
    try:
        os.kill(target, number)
    except ProcessLookupError:
        return False
    return True


def run_trial(
    kind: str, number: int, work: Work, whole: Whole, draw: random.Random, tally: Tally
) -> None:
    """Hit one discovery at random moments, let it finish, and compare."""
    out, scratch = work.folder / f"{kind}-{number}", work.folder / "scratch"
    scratch.mkdir(exist_ok=True)
    what, struck, pids = f"{kind} {number}", 0, []
    for _ in range(draw.randrange(1, work.starts + 1)):
        child = work.start(out, draw.choice([1, 2]) if kind != "worker" else 2)
        pids.append(child.pid)
        kept = draw.randrange(whole.records)
        pause = draw.uniform(0.1, 1.0) * whole.seconds / (1 if kept == 0 else whole.records)
        struck += hit(child, kind, out, kept, pause)
        code, said = finish(child, tally, what)
        good = {"parent": (0, -9), "worker": (0,), "terminate": (0, 143, -15)}
        # Python itself answers a Ctrl-C while it starts.
        tally.check(code in good.get(kind, (0, 130, -2)), f"{what}: exit {code}: {said[-300:]}")
    code, said = finish(work.start(out, 1), tally, what)
    tally.check(code == 0, f"{what}: the rerun ends with {code}: {said[-300:]}")
    if code == 0:
        found = saved(out)
        differ = sorted(k for k in {**found, **whole.found} if found.get(k) != whole.found.get(k))
        tally.check(not differ, f"{what}: another result in {differ}")
    # A process that is killed while it writes leaves the part that it has written, nothing else.
    parts = [p.name for p in out.rglob(".*.part")]
    killed = struck if kind in ("parent", "worker") else 0
    tally.check(len(parts) <= killed, f"{what}: {parts} are left")
    left = [p.name for p in scratch.iterdir()]
    tally.check(not left, f"{what}: temporary files are left: {left[:3]}")
    names = [p.name for p in Path("/dev/shm").iterdir()] if Path("/dev/shm").exists() else []
    held = [name for name in names for pid in pids if f"-{pid}-" in name or f"_{pid}_" in name]
    tally.check(not held, f"{what}: shared memory is left: {held[:3]}")
    tally.trials[kind] = tally.trials.get(kind, 0) + 1
    tally.hits[kind] = tally.hits.get(kind, 0) + struck
    shutil.rmtree(out)
    shutil.rmtree(scratch)


@contextmanager
def warmed() -> Iterator[subprocess.Popen[str]]:
    """Start a process that has loaded what a discovery needs and forks commands; end it last."""
    with subprocess.Popen(
        [sys.executable, "-c", _WARM],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"},
    ) as warm:
        yield warm


def torture(counts: dict[str, int], seed: int, work: Work) -> Tally:
    """Run so many trials of each kind; gives what came of them."""
    tally, draw = Tally(), random.Random(seed)
    random.seed(seed)
    make_data(work.folder / "data.csv")
    (work.folder / "scratch").mkdir()
    out = work.folder / "whole"
    child, began = work.start(out, 1), time.monotonic()
    code, said = finish(child, tally, "")
    if code:
        raise SystemExit(f"the undisturbed run ends with {code}: {said}")
    records = len(list(out.glob("records/*")))
    whole = Whole(saved(out), time.monotonic() - began, records)
    for kind, count in counts.items():
        for number in range(count):
            run_trial(kind, number, work, whole, draw, tally)
            print(f"{kind} {number + 1} of {count}: {len(tally.faults)} faults", flush=True)
    return tally


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--parents", type=int, default=100, help="trials with kill -9 of the command"
    )
    parser.add_argument("--workers", type=int, default=100, help="trials with kill -9 of a worker")
    parser.add_argument("--interrupts", type=int, default=25, help="trials with SIGINT")
    parser.add_argument("--terminations", type=int, default=25, help="trials with SIGTERM")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--warm", action="store_true", help="fork commands from a warm process")
    asked = parser.parse_args()
    counts = {
        "parent": asked.parents,
        "worker": asked.workers,
        "interrupt": asked.interrupts,
        "terminate": asked.terminations,
    }
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as ends:
        warm = ends.enter_context(warmed()) if asked.warm else None
        tally = torture(counts, asked.seed, Work(Path(folder), warm=warm))
    for kind, count in tally.trials.items():
        print(f"{kind}: {count} trials, {tally.hits[kind]} hits")
    print(f"{len(tally.faults)} faults in {time.monotonic() - began:.0f} s")
    for fault in tally.faults:
        print(f"  {fault}")
    sys.exit(bool(tally.faults))


if __name__ == "__main__":
    main()
