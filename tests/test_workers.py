import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import joblib
import pytest

from dynsr.jobs.pool import spread


def is_running(pid):
    """Say whether a process is there and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_for(condition, seconds=20.0):
    """Wait until a condition holds; say whether it did."""
    until = time.monotonic() + seconds
    while not condition() and time.monotonic() < until:
        time.sleep(0.05)
    return bool(condition())


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_result_comes_with_its_number(jobs):
    """Results come in any order, each with the number of its call."""
    assert dict(spread(pow, [(2, i) for i in range(5)], jobs)) == {i: 2**i for i in range(5)}


# From Python 3.12 on a fork beside threads is warned of; the user chose the backend.
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("backend", ["threading", "multiprocessing"])
def test_other_backends_serve(backend):
    """Whatever joblib runs calls with is used."""
    with joblib.parallel_config(backend=backend):
        assert dict(spread(pow, [(2, i) for i in range(4)], 2)) == {i: 2**i for i in range(4)}


CHILD = """
import os, sys, time
from dynsr.jobs.pool import spread
def work(folder, i):
    open(f"{folder}/{os.getpid()}", "w").close()
    time.sleep(600)
try:
    list(spread(work, [(sys.argv[1], i) for i in range(4)], 2))
except KeyboardInterrupt:
    print("interrupted", flush=True)
    time.sleep(600)
"""


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc to look at processes")
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL], ids=["interrupt", "kill"])
def test_no_worker_is_left(tmp_path, end):
    """Ctrl-C in the whole group kills the workers at once; after kill -9 they end themselves."""
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert wait_for(lambda: len(list(tmp_path.iterdir())) == 2)
        pids = [int(path.name) for path in tmp_path.iterdir()]
        assert child.pid not in pids and all(map(is_running, pids))
        if end == signal.SIGINT:
            os.killpg(child.pid, end)
            assert child.stdout is not None and child.stdout.readline() == "interrupted\n"
        else:
            os.kill(child.pid, end)
        assert wait_for(lambda: not any(map(is_running, pids)), 10)
    finally:
        child.kill()
        _, errors = child.communicate()
    assert "Traceback" not in errors
