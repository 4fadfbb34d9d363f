import pickle
import threading
import time

import pytest
import sympy
from waiting import wait_for

from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.jobs import progress as module
from dynsr.jobs.progress import Line, Messages, Reporter
from dynsr.methods.base import Progress

X = sympy.Symbol("x")


class Record:
    """What a task has come to."""

    front = ParetoFront([Candidate(3 * X, 0.25, 2.0)])


def progress(done, *exprs):
    """Give a report whose front holds these formulas, each longer and better than the last."""
    front = ParetoFront(Candidate(e, 1.0 / (i + 1), i + 1.0) for i, e in enumerate(exprs))
    return Progress("generations", done, 9, front)


@pytest.fixture(params=["same process", "another process"])
def ends(request):
    """Give the messages of a run, and what a task of the same or of another process tells them."""
    messages = Messages()
    yield (
        messages,
        messages if request.param == "same process" else pickle.loads(pickle.dumps(messages)),
    )
    messages.end()
    messages.end()


def test_a_running_task_tells_its_stage_and_best_formula(ends):
    """What a task reports arrives: stage, how far, best formula in decimals, whole front."""
    messages, far = ends
    report = Reporter(far, "search-x-ga", "x' by ga")
    assert wait_for(lambda: messages.last)["search-x-ga"].title == "x' by ga"
    report(progress(4, X, sympy.Rational(981, 100) * X))
    assert wait_for(lambda: messages.last["search-x-ga"].stage == "generations")
    said = messages.last["search-x-ga"]
    assert (said.done, said.total, said.best) == (4, 9, "9.81*x  (error 0.5)")
    assert [c.expr for c in said.front] == [X, sympy.Rational(981, 100) * X]
    report.end(Record)
    assert wait_for(lambda: messages.last["search-x-ga"].front == Record.front)
    report.close()


def test_reports_are_passed_on_seldom(monkeypatch):
    """Of many reports at most two a second are passed on, fewer where telling is slow."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    messages = Messages()
    report = Reporter(messages, "a", "a")
    kept = []
    for done in range(100):
        now[0] = done * 0.1
        report(progress(done, X))
        kept.append(messages.last["a"].done)
    assert len(set(kept)) == pytest.approx(20, abs=1)


def test_a_task_that_is_asked_to_stop_is_not_finished(ends):
    """Once stopped, the next report raises KeyboardInterrupt, and what the task had arrives."""
    messages, far = ends
    report = Reporter(far, "a", "a")
    report(progress(1, X))
    messages.stopped = True

    def reports_no_more():
        try:
            report(progress(2, X))
        except KeyboardInterrupt:
            return True
        return False

    assert wait_for(reports_no_more)
    with pytest.raises(KeyboardInterrupt):
        report.end(Record)
    assert wait_for(lambda: messages.last["a"].front == Record.front)


@pytest.mark.parametrize("how", ["never heard of", "ended", "ends meanwhile"])
def test_without_anyone_at_the_end_nothing_fails(how):
    """Tasks of a process that cannot reach the run go on all the same."""
    messages = Messages()
    far = pickle.loads(pickle.dumps(messages))
    if how == "never heard of":
        far = Line(None, b"")
    if how == "ended":
        messages.end()
    report = Reporter(far, "a", "a")
    if how == "ends meanwhile":
        messages.end()
    for done in range(3):
        report(progress(done, X))
        time.sleep(0.1)
    report.end(Record)
    report.close()
    messages.end()


def test_a_stranger_is_not_heard():
    """Who does not know the key of the run cannot tell it anything."""
    messages = Messages()
    line = pickle.loads(pickle.dumps(messages))
    stranger = Line(line._address, b"guess")
    Reporter(stranger, "a", "a").close()
    Reporter(line, "b", "b").close()
    assert wait_for(lambda: messages.last) and set(messages.last) == {"b"}
    messages.end()


def test_a_run_whose_tasks_stay_in_the_process_listens_to_nobody():
    """No connection and no thread is made before a task goes to another process."""
    # Threads of others may end meanwhile.
    before = set(threading.enumerate())
    messages = Messages()
    Reporter(messages, "a", "a").end(Record)
    messages.end()
    assert set(threading.enumerate()) <= before and messages._listener is None
