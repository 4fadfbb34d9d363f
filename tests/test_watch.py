import signal
import threading
import time
from dataclasses import dataclass

import pytest

from dynsr.jobs.progress import Running, Watch, estimate_left

PLAN = {"a": 6.0, "b": 10.0, "c": 6.0}


@dataclass(frozen=True)
class Record:
    """What a task gave."""

    seconds: float = 0.0
    summary: str = "2*x"


def test_the_time_left_shrinks_and_scales():
    """The estimate falls as tasks run and end, grows on a slow machine, and halves with workers."""
    first = estimate_left(PLAN, {}, {}, 1)
    assert estimate_left(PLAN, {}, {"a": 3.0}, 1) == pytest.approx(first - 3)
    usual = estimate_left(PLAN, {"a": 6.0}, {}, 1)
    slow = estimate_left(PLAN, {"a": 60.0}, {}, 1)
    assert usual < first < slow
    # A task that had nothing to search says nothing of the machine.
    assert estimate_left(PLAN, {"a": 0.0}, {}, 1) == usual
    assert first / 2 <= estimate_left(PLAN, {}, {}, 2) < first


def test_a_task_that_takes_long_is_never_nearly_over():
    """Something is left while a task runs, however long it has run; nothing once all have ended."""
    assert estimate_left({"a": 4.0}, {}, {"a": 1000.0}, 1) >= 100
    assert estimate_left(PLAN, dict.fromkeys(PLAN, 1.0), {}, 1) is None


@pytest.mark.slow
def test_running_tasks_are_reported_while_nothing_ends():
    """Reports come while the main thread works, and tell of the tasks that have not ended."""
    steps, seen = [], threading.Event()

    def progress(step):
        steps.append(step)
        if step.running:
            seen.set()

    with Watch(progress, PLAN, 1) as watch:
        watch.messages.send(Running("b", "x' by b", "grow", 1, 4, "2*x", time.time() - 3.0))
        assert seen.wait(10)
        watch("b", "x' by b", Record(3.0))
    (running,) = next(step for step in steps if step.running).running
    assert (running.task, running.stage, running.best) == ("b", "grow", "2*x")
    assert running.seconds == pytest.approx(3.0, abs=2.0)
    assert (steps[0].what, steps[0].done, steps[0].total) == ("", 0, 3)
    ended = next(step for step in steps if step.what)
    assert (ended.what, ended.found, ended.done) == ("x' by b", "2*x", 1)
    assert (ended.record, ended.running) == (Record(3.0), ())
    assert watch.records == {"b": Record(3.0)}


def test_without_a_listener_no_thread_is_started():
    """A run that nobody watches keeps the records and nothing else."""
    before = threading.active_count()
    with Watch(None, PLAN, 1) as watch:
        watch("a", "a", Record())
        assert threading.active_count() == before
    assert watch.records == {"a": Record()}


def test_ctrl_c_asks_the_tasks_to_stop():
    """Ctrl-C does what it did, and tells the tasks; afterwards it is as before."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), Watch(None, PLAN, 1) as watch:
            signal.raise_signal(signal.SIGINT)
        assert watch.messages.stopped
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
