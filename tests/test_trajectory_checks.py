import re
import sys
from pathlib import Path

import numpy as np
import pytest

from dynsr.checks.crosschecks import PROGRAMS, crosscheck
from dynsr.checks.trajectories import trajectory_rows
from dynsr.engines.base import Integration, SparseProblem
from dynsr.engines.embedded import EmbeddedEngine
from dynsr.engines.julia import diffeqpy
from dynsr.engines.julia.diffeqpy import DiffeqpyEngine
from dynsr.errors import EngineError, EngineUnavailable, say_install
from dynsr.paper.protocol import PAPER_NAMES
from dynsr.paper.reference import trajectory_record

FAKE = Path(__file__).parent / "fake_julia"


@pytest.mark.parametrize("system", PAPER_NAMES)
def test_the_embedded_engine_agrees_with_julia_and_scipy(system):
    """All four trajectory rows of every system are filled, and their verdict is that both agree."""
    rows = crosscheck([system], ["embedded"], ["trajectories"])
    assert len(rows) == 4
    assert {row.verdict for row in rows} == {"agrees"}
    assert all(row.compared >= 30 for row in rows)


class Skewed(EmbeddedEngine):
    """An engine whose last state is off, whose steps are too many, or whose solution ends early."""

    name = "skewed"

    def __init__(self, gap: float = 0.0, steps: int = 0) -> None:
        """Be off by ``gap`` in the middle of a trajectory and by so many steps."""
        self.gap, self.steps = gap, steps

    def integrate(self, problem) -> Integration:
        """Solve and spoil."""
        solved = super().integrate(problem)
        solved.x[len(problem.t) // 2, -1] += self.gap
        return Integration(solved.x, True, solved.accepted + self.steps, 0)


def test_a_wrong_trajectory_is_found_out_and_located():
    """One state off at one time turns the verdict of every row of states and is named."""
    rows = list(trajectory_rows("pendulum", Skewed(gap=1e-4)))
    verdicts = {row.subject: row.verdict for row in rows}
    assert verdicts["accepted steps, default tolerances"] == "agrees"
    states = [row for row in rows if row.subject.startswith("states")]
    assert {row.verdict for row in states} == {"differs"}
    assert states[1].worst == "theta2 at t = 5"
    assert states[1].difference == pytest.approx(1e-4, rel=1e-6)


def test_a_step_more_is_found_out():
    """Where the states agree but one more step was taken, the row of steps says so."""
    rows = list(trajectory_rows("pendulum", Skewed(steps=1)))
    assert [r.subject for r in rows if r.verdict == "differs"] == [
        "accepted steps, default tolerances"
    ]


def test_a_missing_state_is_as_far_off_as_can_be():
    """NaN never agrees."""
    rows = list(trajectory_rows("pendulum", Skewed(gap=np.nan)))
    assert rows[0].verdict == "differs" and rows[0].difference == np.inf


def test_the_records_are_over_the_training_span():
    """Steps and saved times begin at 0 and end at 10, and both begin at the system's start."""
    for system in PAPER_NAMES:
        for case in ("steps", "tight"):
            t, x = trajectory_record(system, case)
            assert t[0] == 0.0 and t[-1] == pytest.approx(10.0) and np.isfinite(x).all()


@pytest.fixture
def fake_julia(monkeypatch, tmp_path):
    """Put the stand-ins for juliacall and diffeqpy on the path."""
    monkeypatch.syspath_prepend(str(FAKE))
    monkeypatch.setenv("PYTHON_JULIACALL_EXE", sys.executable)
    monkeypatch.setenv("PYTHON_JULIACALL_PROJECT", str(tmp_path))


@pytest.mark.slow
def test_diffeqpy_is_compared_on_request(fake_julia, monkeypatch):
    """Its rows come from a process of its own, and only its trajectories are compared.

    The stand-in solves by many small steps, so that it meets the states of tight tolerances and
    cannot meet those of default ones.
    """
    engine = DiffeqpyEngine(start_seconds=60.0)
    monkeypatch.setitem(PROGRAMS, "diffeqpy", lambda: engine)
    monkeypatch.setattr("dynsr.checks.crosschecks._start_program", lambda name: PROGRAMS[name]())
    rows = crosscheck(["pendulum"], [], extra=["diffeqpy"])
    engine.close()
    assert {(row.section, row.ours) for row in rows} == {("trajectories", "diffeqpy")}
    verdicts = {(row.subject, row.theirs): row.verdict for row in rows}
    assert verdicts["states, tolerances 1e-12", "scipy DOP853 at 1e-12"] == "agrees"
    assert verdicts["states, default tolerances", "embedded"] == "differs"
    with pytest.raises(EngineError, match="only integrates"):
        engine.regress(SparseProblem(np.ones((1, 2)), np.ones(2)))


def test_without_diffeqpy_its_rows_are_absent(monkeypatch):
    """Asked for and not installed: one absent row a system, with the remedy."""
    monkeypatch.setattr(diffeqpy.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr("dynsr.checks.crosschecks._start_program", lambda name: PROGRAMS[name]())
    with pytest.raises(EngineUnavailable, match=re.escape(say_install("diffeqpy"))):
        DiffeqpyEngine()
    rows = crosscheck(["pendulum", "cart-pole"], [], extra=["diffeqpy"])
    assert [(row.verdict, row.system) for row in rows] == [
        ("absent", "pendulum"),
        ("absent", "cart-pole"),
    ]
