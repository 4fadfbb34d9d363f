import threading
import time

import pytest

from dynsr.jobs.checkpoint import Part
from dynsr.jobs.live import LiveFolder
from dynsr.jobs.watch import Watch, estimate_left

PLAN = {"a": "rational", "b": "genetic", "c": "pick"}


def test_the_time_left_shrinks_and_scales():
    """The estimate falls as parts run and end, grows on a slow machine, and halves with workers."""
    first = estimate_left(PLAN, {}, {}, 1)
    assert estimate_left(PLAN, {}, {"a": 3.0}, 1) == pytest.approx(first - 3)
    usual = estimate_left(PLAN, {"a": {"seconds": 6.0}}, {}, 1)
    slow = estimate_left(PLAN, {"a": {"seconds": 60.0}}, {}, 1)
    assert usual < first < slow
    # A part that had nothing to search says nothing of the machine.
    assert estimate_left(PLAN, {"a": {"seconds": 0.0}}, {}, 1) == usual
    assert first / 2 <= estimate_left(PLAN, {}, {}, 2) < first


def test_a_part_that_takes_long_is_never_nearly_over():
    """Something is left while a part runs, however long it has run; nothing once all have ended."""
    assert estimate_left({"a": "sindy"}, {}, {"a": 1000.0}, 1) >= 100
    assert estimate_left(PLAN, dict.fromkeys(PLAN, {}), {}, 1) is None


def test_running_parts_are_reported_while_nothing_ends(tmp_path):
    """Reports come while the main thread works, and tell of the parts that have not ended."""
    live = LiveFolder(tmp_path)
    said = {"state": "x", "method": "genetic", "stage": "grow", "done": 1, "total": 4}
    said |= {"best": "2*x", "loss": 0.5, "front": []}
    steps, seen = [], threading.Event()

    def progress(step):
        steps.append(step)
        if step.running:
            seen.set()

    with Watch(progress, live, PLAN, 1) as watch:
        live.write("b", {"part": "b", "began": time.time() - 3.0, **said})
        assert seen.wait(10)
        watch(Part("b", "key", dict, ()), {"seconds": 3.0})
    (running,) = next(step for step in steps if step.running).running
    assert (running.part, running.stage, running.best) == ("b", "grow", "2*x")
    assert running.seconds == pytest.approx(3.0, abs=2.0)
    assert (steps[0].what, steps[0].done, steps[0].total) == ("", 0, 3)
    ended = next(step for step in steps if step.what)
    assert (ended.what, ended.done, ended.record, ended.running) == ("b", 1, {"seconds": 3.0}, ())
    assert watch.records == {"b": {"seconds": 3.0}}


def test_without_a_listener_no_thread_is_started(tmp_path):
    """A discovery that nobody watches keeps the records and nothing else."""
    before = threading.active_count()
    with Watch(None, LiveFolder(tmp_path), PLAN, 1) as watch:
        watch(Part("a", "key", dict, ()), {})
        assert threading.active_count() == before
    assert watch.records == {"a": {}}
