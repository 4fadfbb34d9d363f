import gc
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import joblib
import pytest
from joblib._parallel_backends import ThreadingBackend
from joblib.externals.loky.process_executor import BrokenProcessPool
from waiting import wait_for

from dynsr.jobs import pool
from dynsr.jobs.pool import spread


def is_running(pid):
    """Say whether a process is there and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_every_result_comes_with_its_number(jobs):
    """Results come in any order, each with the number of its call."""
    assert dict(spread(pow, [(2, i) for i in range(5)], jobs)) == {i: 2**i for i in range(5)}


@pytest.mark.parametrize("backend", ["threading", "multiprocessing", "no generators"])
def test_every_backend_gives_the_same(backend):
    """A backend that gives all results only at the end serves as well."""
    joblib.register_parallel_backend("no generators", WithoutGenerators)
    with joblib.parallel_config(backend=backend):
        assert dict(spread(pow, [(2, i) for i in range(4)], 2)) == {i: 2**i for i in range(4)}


class WithoutGenerators(ThreadingBackend):
    """A backend like Ray's, which cannot give results one by one."""

    supports_return_generator = False


@pytest.mark.slow
def test_a_broken_or_closed_pool_is_followed_by_a_good_one():
    """After results that nobody takes, an error and a worker that dies, the next call works."""
    with closing(spread(time.sleep, [(0,), (600,), (600,)], 2)) as results:
        next(results)
    with pytest.raises(ZeroDivisionError):
        list(spread(divmod, [(1, 0), (1, 1)], 2))
    with pytest.raises(BrokenProcessPool):
        list(spread(os._exit, [(9,), (9,)], 2))
    assert dict(spread(pow, [(2, i) for i in range(4)], 2)) == {i: 2**i for i in range(4)}


# loky's own thread trips over calls that it had not handed out yet.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.slow
def test_an_interrupt_while_workers_start_leaves_no_pool_behind(monkeypatch):
    """Ctrl-C held back until the workers are there ends them, and does not end those of the next.

    A pool that is left open would end the workers of whatever runs when it is collected.
    """
    make = pool._make_pool

    def start_and_interrupt(*options):
        """Give a pool in whose start Ctrl-C comes."""

        def start(calls):
            results = make(*options)(calls)
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
            return results

        return start

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        monkeypatch.setattr(pool, "_make_pool", start_and_interrupt)
        with pytest.raises(KeyboardInterrupt) as caught:
            list(spread(time.sleep, [(600,), (600,)], 2))
        monkeypatch.undo()
        running = spread(pow, [(2, i) for i in range(4)], 2)
        first = next(running)
        del caught
        gc.collect()
        assert dict([first, *running]) == {i: 2**i for i in range(4)}
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("jobs", [1, 2])
def test_apart_is_another_process_with_one_thread(jobs):
    """Even one call at a time runs in another process, whose libraries have one thread."""
    found = dict(spread(os.getenv, [("OMP_NUM_THREADS",)] * 3, jobs, apart=True))
    assert found == dict.fromkeys(range(3), "1")
    pids = dict(spread(os.getpid, [()] * 3, jobs, apart=True))
    assert os.getpid() not in pids.values()


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
@pytest.mark.slow
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
        assert wait_for(lambda: len(list(tmp_path.iterdir())) == 2, 20)
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
