import json
import os
import random
import signal
import subprocess
import sys
import time

import joblib
import numpy as np
import pytest

from dynsr.discovery.problem import Problem
from dynsr.discovery.result import Discovery
from dynsr.discovery.search import discover
from dynsr.errors import InputError
from dynsr.expression.parsing import parse
from dynsr.methods.genetic import GeneticAlgorithm
from dynsr.methods.rational import RationalSearch

QUICK = RationalSearch(costs=(2,), max_terms=3, denominators=False, rounds=1)
KILLED = {
    "method": [QUICK, GeneticAlgorithm(population=60, iterations=10)],
    "targets": "y",
    "jobs": 1,
}
ENDLESS = GeneticAlgorithm(population=30, iterations=10**7)


@pytest.fixture(scope="module")
def decay():
    """Two coupled linear states in closed form."""
    t = np.linspace(0, 6, 121)
    return t, np.column_stack([np.exp(-0.5 * t), np.exp(-0.5 * t) * (1 + t)])


class Interrupt:
    """Sends this process Ctrl-C, once, as soon as a step of the discovery is as it is wanted."""

    def __init__(self, wanted):
        """Take the condition on a step."""
        self.wanted, self.sent, self.steps = wanted, False, []

    def __call__(self, step):
        """Look at a step."""
        self.steps.append(step)
        if not self.sent and self.wanted(step):
            self.sent = True
            os.kill(os.getpid(), signal.SIGINT)


def has_formula(step):
    """Say whether a running search has a formula."""
    return any(running.best for running in step.running)


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_ctrl_c_gives_the_best_so_far(decay, tmp_path, jobs):
    """Interrupted in endless searches, discover gives what ended and what they have so far."""
    before = signal.getsignal(signal.SIGINT)
    ctrl_c = Interrupt(lambda step: step.done and has_formula(step))
    found = discover(
        decay, method=[QUICK, ENDLESS], targets="y", jobs=jobs, out=tmp_path, progress=ctrl_c
    )
    assert ctrl_c.sent and not found.complete
    # The quick search had ended, so its formula is the best there is.
    (term,) = {parse("x - 0.5*y") - found.equations["y"]}
    assert all(abs(float(n)) < 1e-3 for n in term.as_coefficients_dict().values())
    assert "best so far" in found.explanation["y"] and len(found.front["y"]) > 1
    assert [path.name for path in (tmp_path / "records").iterdir()] == ["search-y-rational.json"]
    kept = {path.name for path in tmp_path.iterdir()}
    # Of the endless one the last state is kept, if it had the time.
    assert kept - {"parts"} == {"data.csv", "discovery.json", "manifest.json", "records"}
    assert signal.getsignal(signal.SIGINT) is before
    saved = Discovery.load(found.save(tmp_path / "d.json"))
    assert not saved.complete and saved.equations == found.equations


@pytest.mark.slow
# From Python 3.12 on a fork beside threads is warned of; the user chose the backend.
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("jobs", [1, 2])
def test_fronts_of_running_searches_count(decay, jobs):
    """Where no search has ended, the fronts of those that run give the equations, of forks too."""
    ctrl_c = Interrupt(lambda step: sum(bool(r.best) for r in step.running) == jobs)
    with joblib.parallel_config(backend="multiprocessing"):
        found = discover(decay, method=ENDLESS, jobs=jobs, progress=ctrl_c)
    assert not found.complete and list(found.equations) == ["x", "y"][:jobs]
    assert set(found.explanation) == {"x", "y"}
    assert all(len(found.front[state]) for state in found.equations)
    assert ("nothing yet" in found.explanation["y"]) == (jobs == 1)


def test_ctrl_c_while_equations_are_judged_gives_them_unjudged(decay, monkeypatch):
    """What was found is given also where the interrupt comes when the searches are over."""

    def interrupt(self, found, alternatives):
        raise KeyboardInterrupt

    monkeypatch.setattr(Problem, "give_verdict_in_time", interrupt)
    found = discover(decay, method=QUICK, jobs=1)
    assert set(found.equations) == {"x", "y"} and not found.complete
    assert not found.verdict.tested and found.heading.endswith("No verdict.")


@pytest.mark.slow
def test_a_search_that_was_cut_short_has_no_verdict(decay, monkeypatch):
    """Who ends a search waits for no verdict on what it had."""

    def give_verdict(self, found, alternatives):
        raise AssertionError

    monkeypatch.setattr(Problem, "give_verdict_in_time", give_verdict)
    ctrl_c = Interrupt(lambda step: step.done and has_formula(step))
    found = discover(decay, method=[QUICK, ENDLESS], targets="y", jobs=1, progress=ctrl_c)
    assert ctrl_c.sent and not found.verdict.tested and "best so far" in found.explanation["y"]


@pytest.mark.slow
def test_searches_in_threads_stop_too(decay):
    """Searches in threads, which cannot be killed, end at their next report."""
    ctrl_c = Interrupt(lambda step: sum(bool(r.best) for r in step.running) == 2)
    with joblib.parallel_config(backend="threading"):
        found = discover(decay, method=ENDLESS, jobs=2, progress=ctrl_c)
    assert not found.complete and list(found.equations) == ["x", "y"]


def test_ctrl_c_before_anything_is_found_is_raised(decay):
    """With nothing found there is no discovery to give; what hears Ctrl-C is as it was before."""
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        discover(decay, method=ENDLESS, jobs=1, progress=Interrupt(lambda step: True))
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.slow
def test_a_signal_that_became_an_error_is_no_failure_of_the_method(
    decay, tmp_path, monkeypatch, number
):
    """What a signal ended is not kept as failed, though a library made a ValueError of its end.

    The search ends with what it has, and the same call gives the result of an undisturbed one.
    """
    method, search = [QUICK], RationalSearch.search

    def draw(self, samples, rng, report):
        try:
            signal.raise_signal(number)
        except BaseException:
            raise ValueError("Invalid affine transformation matrix") from None

    def end(number, frame):
        signal.signal(number, signal.SIG_IGN)
        raise SystemExit(143)

    whole = discover(decay, method=method, jobs=1)
    before = signal.signal(signal.SIGTERM, end)
    try:
        monkeypatch.setattr(RationalSearch, "search", draw)
        assert not discover(decay, method=method, jobs=1, out=tmp_path).complete
        now = signal.getsignal(signal.SIGTERM)
        assert now == (signal.SIG_IGN if number == signal.SIGTERM else end)
    finally:
        signal.signal(signal.SIGTERM, before)
    monkeypatch.setattr(RationalSearch, "search", search)
    again = discover(decay, method=method, jobs=1, out=tmp_path)
    assert {**again.as_record(), "seconds": 0} == {**whole.as_record(), "seconds": 0}


# An interrupt between the opening of a file and its ``with`` leaves the file to the collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.slow
def test_an_interrupted_search_is_searched_again(decay, tmp_path):
    """What an interrupted search had does not pass for its result: the rerun is as if undisturbed.

    The interrupt comes while an equation is being chosen, too.
    """
    method = [QUICK, GeneticAlgorithm(population=30, iterations=20)]
    whole = discover(decay, method=method, jobs=1, out=tmp_path / "whole")
    moments = [
        has_formula,
        lambda step: any(r.stage == "choosing" for r in step.running),
        lambda step: step.done == step.total,
    ]
    for moment in moments:
        ctrl_c = Interrupt(moment)
        found = discover(decay, method=method, jobs=1, out=tmp_path / "cut", progress=ctrl_c)
        assert found.complete != ctrl_c.sent
    again = discover(decay, method=method, jobs=1, out=tmp_path / "cut")
    assert {**again.as_record(), "seconds": 0} == {**whole.as_record(), "seconds": 0}


@pytest.mark.slow
def test_a_folder_belongs_to_one_discovery(decay, tmp_path):
    """Other data, settings or targets are refused in a line that names the first difference."""
    t, x = decay
    discover(decay, method=QUICK, targets="x", jobs=1, out=tmp_path)
    for changes, said in (
        ({"seed": 1}, "holds results with seed 0, not 1; give another folder"),
        ({"targets": "all"}, "with targets x, not x, y"),
        ({"method": [QUICK, "sindy"]}, "with methods rational, not rational, sindy"),
        ({"data": (t, 1.01 * x)}, "with data 121 rows of x, y, .*, not 121 rows of"),
        ({"method": RationalSearch(costs=(2,), max_terms=2)}, "other options; give another folder"),
    ):
        asked = {"data": decay, "method": QUICK, "targets": "x", **changes}
        with pytest.raises(InputError, match=said):
            discover(asked.pop("data"), jobs=1, out=tmp_path, **asked)
    assert discover(decay, method=QUICK, targets="x", jobs=2, out=tmp_path).complete


CHILD = """
import sys
import numpy as np
from dynsr.discovery.search import discover
from dynsr.methods.rational import RationalSearch
from dynsr.methods.genetic import GeneticAlgorithm
t = np.linspace(0, 6, 121)
x = np.column_stack([np.exp(-0.5 * t), np.exp(-0.5 * t) * (1 + t)])
quick = RationalSearch(costs=(2,), max_terms=3, denominators=False, rounds=1)
methods = [quick, GeneticAlgorithm(population=60, iterations=10)]
tell = lambda step: print(step.done, step.total, flush=True)
discover((t, x), method=methods, targets="y", jobs=1, out=sys.argv[1], progress=tell)
print("over", flush=True)
"""


@pytest.mark.slow
def test_kill_9_at_random_moments_changes_nothing(decay, tmp_path):
    """Killed again and again, in searches, choice or polishing, the rerun ends in the same result.

    A task that is finished is never done again.
    """
    whole = discover(decay, **KILLED)
    moments = random.Random(1)
    times: dict[str, int] = {}
    for done in (1, 3):
        child = subprocess.Popen(
            [sys.executable, "-c", CHILD, str(tmp_path)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert child.stdout is not None
        for line in child.stdout:
            if line == "over\n" or int(line.split()[0]) >= done:
                break
        time.sleep(moments.uniform(0, 0.3))
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
        child.stdout.close()
        kept = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "records").glob("[!.]*")}
        assert len(kept) >= done and times.items() <= kept.items()
        assert all("key" in json.loads((tmp_path / "records" / n).read_text()) for n in kept)
        times = kept
    again = discover(decay, **KILLED, out=tmp_path)
    assert {**again.as_record(), "seconds": 0} == {**whole.as_record(), "seconds": 0}
