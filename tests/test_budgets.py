"""Time budgets: whatever takes long is ended, and there is always an answer."""

import importlib
import pickle
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
import sympy

import dynsr
from dynsr.discovery import hidden, problem, search, stages, tasks
from dynsr.jobs import End, TimeUp, finish_by, time_limit
from dynsr.jobs.budget import uncut
from dynsr.parameters import delays

T = np.linspace(0, 6, 61)
EXACT = dynsr.Trajectory(T, np.exp(-0.7 * T)[:, None] + 0.2, ("x",))
NOISE = 0.03 * np.random.default_rng(3).normal(size=(61, 1))
NOISY = dynsr.Trajectory(T, EXACT.x + NOISE, ("x",))


HITS: list[str] = []


def endless(*_: object, **__: object) -> None:
    """Work without an end; a test that waits for it fails."""
    HITS.append("begun")
    until = time.monotonic() + 20
    while time.monotonic() < until:
        sum(range(1000))
    pytest.fail("nobody ended it")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "step", "run"),
    [
        (problem.Measurements, "of", NOISY),
        (problem, "is_noisy", EXACT),
        (tasks, "look", EXACT),
        (tasks, "explore", NOISY),
        (tasks, "pick_equation", EXACT),
        (stages, "pool_formulas", NOISY),
        (problem, "compare_systems", NOISY),
        (problem, "confirm", EXACT),
        (problem, "polish", NOISY),
        (problem, "polish", EXACT),
        (problem, "give_verdict", NOISY),
        (stages, "follow_anyway", NOISY),
        (stages._Steps, "_end_early", EXACT),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_no_step_takes_longer_than_the_budget(monkeypatch, place, step, run):
    """A step that would never end is ended, what ended is said, and each state has an equation."""
    monkeypatch.setattr(place, step, endless)
    HITS.clear()
    found = dynsr.discover(run, jobs=1, time_budget=0.5)
    assert list(found.equations) == ["x"]
    assert found.complete
    assert found.verdict.tested
    assert found.settings.get("ended_by_budget") or not HITS


@pytest.mark.slow
def test_a_budget_holds_in_any_thread(monkeypatch):
    """Where no alarm comes, the step is ended as well, and nothing follows into later work."""
    monkeypatch.setattr(problem, "give_verdict", endless)
    found: list[dynsr.Discovery] = []
    budgets = {"jobs": 1, "time_budget": 0.5}
    thread = threading.Thread(target=lambda: found.append(dynsr.discover(EXACT, **budgets)))
    thread.start()
    thread.join()
    assert "verdict" in found[0].settings["ended_by_budget"]
    assert found[0].verdict.tested
    assert "the time budget ended" in found[0].verdict.reason


@pytest.mark.slow
def test_an_answer_in_no_time_has_an_end_itself(monkeypatch):
    """Where polynomials of degree 2 of many states take too long, those of degree 1 are given."""
    fit = tasks.fit_polynomials
    few = {1: fit, 2: endless}
    monkeypatch.setattr(tasks, "fit_polynomials", lambda own, degree: few[degree](own, degree))
    monkeypatch.setattr(tasks, "look", endless)
    found = dynsr.discover(EXACT, jobs=1, time_budget=0.2)
    # How exact its constants are depends on the time that is left for them.
    assert sympy.Poly(found.equations["x"], sympy.Symbol("x")).degree() == 1
    assert float(found.equations["x"].subs("x", 1.2)) == pytest.approx(-0.7, rel=0.01)


@pytest.mark.slow
def test_a_hidden_state_that_is_not_found_in_time_leaves_the_equations_without_it(monkeypatch):
    """There is an answer, and it says that no equations with the hidden state were found."""
    monkeypatch.setattr(hidden, "best_alone", endless)
    found = dynsr.discover(EXACT, hidden="y", jobs=1, time_budget=2.0)
    # How exact its constants are depends on the time that is left for them.
    assert float(found.equations["x"].subs("x", 1.2)) == pytest.approx(-0.7, rel=0.01)
    assert "No equations with y were found in this time" in found.explanation["x"]
    assert "hidden" in found.settings["ended_by_budget"]


@pytest.mark.slow
def test_delays_that_were_not_searched_in_time_are_not_taken_for_none(monkeypatch):
    """Equations without a delay say that nobody looked for one."""
    monkeypatch.setattr(delays.Delayed, "candidates", endless)
    found = dynsr.discover(EXACT, delays=True, jobs=1, time_budget=2.0)
    assert not found.delays
    assert "The time budget ended the search for delays" in found.explanation["x"]


@pytest.mark.slow
def test_an_ensemble_is_ended_too(monkeypatch):
    """What comes after the search has no time of its own; the equations stay."""
    monkeypatch.setattr(search, "with_ensemble", endless)
    found = dynsr.discover(EXACT, jobs=1, ensemble=True, time_budget=1.5)
    assert found.settings["ended_by_budget"][-1] == "ensemble"


def test_an_end_lies_within_that_of_what_it_is_a_step_of():
    """The outer end comes first; the inner work does not go on with what is shorter."""
    done = []

    def outer() -> None:
        finish_by(time.monotonic() + 10, endless, lambda: done.append("inner"))

    assert finish_by(time.monotonic() + 0.1, outer, lambda: "outer") == ("outer", True)
    assert done == []


@pytest.mark.slow
@pytest.mark.parametrize("in_thread", [False, True])
def test_an_end_that_is_not_heeded_comes_again(in_thread):
    """Who answers an end may finish what he has, but not go on for ever."""
    heard = []

    def stubborn() -> None:
        with suppress(KeyboardInterrupt):
            endless()
        heard.append(time.monotonic())

    def run() -> None:
        with pytest.raises(TimeUp), time_limit(time.monotonic() + 0.05):
            _ = stubborn(), stubborn(), endless()

    if in_thread:
        thread = threading.Thread(target=run)
        thread.start()
        thread.join()
    else:
        run()
    assert len(heard) == 2


def test_what_may_not_be_cut_ends_first():
    """An end that falls into it comes right behind."""
    done = []

    def work() -> None:
        with uncut():
            until = time.monotonic() + 0.2
            while time.monotonic() < until:
                pass
            done.append("whole")
        done.append("behind")

    assert finish_by(time.monotonic() + 0.05, work, lambda: None) == (None, True)
    assert done == ["whole"]


def test_an_import_is_not_cut(tmp_path, monkeypatch):
    """A module that loads while the time ends is loaded as a whole."""
    (tmp_path / "slow_to_load.py").write_text("import time\ntime.sleep(0.2)\nvalue = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    module = []

    def work() -> None:
        module.append(importlib.import_module("slow_to_load"))
        endless()

    assert finish_by(time.monotonic() + 0.05, work, lambda: None) == (None, True)
    assert module[0].value == 1


def test_an_end_is_the_same_in_another_process_and_on_another_machine(monkeypatch):
    """It goes by the monotonic clock here, and by the clock on the wall where that is another."""
    end = End(time.monotonic() + 100)
    text = pickle.dumps(end)
    assert pickle.loads(text) == end
    monkeypatch.setattr("platform.node", lambda: "elsewhere")
    assert pickle.loads(text).left == pytest.approx(100, abs=1)
    assert pickle.loads(pickle.dumps(End(float("inf")))).left == float("inf")


def test_a_clock_that_is_set_changes_no_budget(monkeypatch):
    """Nothing asks the clock on the wall, which may jump by hours."""
    monkeypatch.setattr(time, "time", lambda: 1e12 * np.random.default_rng().random())
    assert finish_by(time.monotonic() + 30, lambda: 1, lambda: 2) == (1, False)
