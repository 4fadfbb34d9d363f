import json

import pytest
import sympy

from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.jobs import live as module
from dynsr.jobs.live import LiveFolder, Teller
from dynsr.methods.base import Progress

X = sympy.Symbol("x")
ABOUT = {"state": "x", "method": "ga"}


def progress(done, *exprs):
    """Give a report whose front holds these formulas, each longer and better than the last."""
    front = ParetoFront(Candidate(e, 1.0 / (i + 1), i + 1.0) for i, e in enumerate(exprs))
    return Progress("generations", done, 9, front)


def test_a_running_part_tells_its_stage_and_best_formula(tmp_path):
    """What a part reports is read back: stage, how far, best formula in decimals, whole front."""
    live = LiveFolder(tmp_path)
    teller = Teller(live, "search-x-ga", ABOUT)
    (said,) = live.read()
    assert said["stage"] == "" and said["state"] == "x" and said["method"] == "ga"
    teller(progress(4, X, sympy.Rational(981, 100) * X))
    (said,) = live.read()
    assert (said["stage"], said["done"], said["total"]) == ("generations", 4, 9)
    assert (said["best"], said["loss"]) == ("9.81*x", 0.5)
    assert [c["expr"] for c in said["front"]] == ["x", "981*x/100"]
    teller.end({"front": [{"expr": "3*x"}]})
    assert live.read()[0]["front"] == [{"expr": "3*x"}]
    live.remove("search-x-ga")
    assert live.read() == []


def test_reports_are_kept_seldom(tmp_path, monkeypatch):
    """Of many reports at most two a second are written, fewer where writing is slow."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    live = LiveFolder(tmp_path)
    teller = Teller(live, "a", ABOUT)
    kept = []
    for done in range(100):
        now[0] = done * 0.1
        teller(progress(done, X))
        kept.append(live.read()[0]["done"])
    assert len(set(kept)) == pytest.approx(20, abs=1)


def test_a_part_that_is_asked_to_stop_is_not_finished(tmp_path):
    """After stop() the next report raises KeyboardInterrupt, and what the part had is kept."""
    live = LiveFolder(tmp_path)
    teller = Teller(live, "a", ABOUT)
    teller(progress(1, X))
    live.stop()
    with pytest.raises(KeyboardInterrupt):
        teller(progress(2, X))
    with pytest.raises(KeyboardInterrupt):
        teller.end({"front": [{"expr": "2*x"}]})
    assert live.read()[0]["front"] == [{"expr": "2*x"}]


@pytest.mark.parametrize("path", [None, "gone"])
def test_without_a_folder_nothing_is_told_and_nothing_fails(tmp_path, path):
    """Parts of a process that does not see the folder run all the same."""
    live = LiveFolder(None if path is None else tmp_path / path)
    teller = Teller(live, "a", ABOUT)
    teller(progress(1, X))
    live.stop()
    assert not live.stopped and live.read() == []
    teller.end({"front": []})


def test_a_damaged_file_is_left_out(tmp_path):
    """What is no whole JSON is not read."""
    live = LiveFolder(tmp_path)
    live.write("good", {"part": "good"})
    (tmp_path / "cut.json").write_text(json.dumps({"part": "cut"})[:5])
    assert live.read() == [{"part": "good"}]
