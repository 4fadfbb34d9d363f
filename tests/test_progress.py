import io

import pytest
import sympy
from rich.console import Console

from dynsr.commands import progress as module
from dynsr.commands.progress import SearchProgress, best_equation
from dynsr.expression import parse
from dynsr.methods.base import Progress
from dynsr.pareto import Candidate, ParetoFront

FRONT = ParetoFront(
    [
        Candidate(sympy.Symbol("x"), 1.0, 1.0),
        Candidate(parse("1.50000001*x - x*y"), 0.001, 9.0),
        Candidate(parse("1.5*x - x*y + 0.001*x^2"), 0.0009, 30.0),
    ]
)


def test_best_equation_is_the_knee():
    """The equation shown is the knee of the front, with short constants and its error."""
    assert best_equation(FRONT) == "-x*y + 1.5*x  (error 0.001)"
    assert best_equation(ParetoFront()) == ""
    long = ParetoFront([Candidate(sympy.Add(*sympy.symbols("abcdef0:20")), 1.0, 1.0)])
    assert len(best_equation(long)) < 80


def test_a_log_gets_one_line_a_stage(capsys, monkeypatch):
    """Where stderr is no terminal, a new stage is one line, and never more than one at a time."""
    now = iter([0.0, 10.0, 10.0, 10.5, 10.6, 20.0, 20.0])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(now, 30.0))
    with SearchProgress() as progress:
        progress._last = ("", -10.0)
        for stage in ("read", "read", "polynomials", "network"):
            progress(Progress(stage, 1, None, FRONT))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "read: -x*y + 1.5*x  (error 0.001)"
    assert len(lines) == len(set(lines)) <= 3


def test_quiet_says_nothing(capsys):
    """With --quiet nothing is written."""
    with SearchProgress(quiet=True) as progress:
        progress(Progress("read", 1, 2, FRONT))
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("total", [None, 4])
def test_a_terminal_shows_stage_and_equation(monkeypatch, total):
    """On a terminal the stage, the time left and the best equation so far are drawn."""
    screen = io.StringIO()
    monkeypatch.setattr(
        module,
        "console",
        lambda stderr: Console(file=screen, force_terminal=True, width=160, highlight=False),
    )
    with SearchProgress() as progress:
        progress(Progress("brute force [1]", 1, total, FRONT))
        progress(Progress("network", 2, total, FRONT))
        progress._bar.refresh()
    drawn = screen.getvalue()
    assert "brute force [1]" in drawn or "network" in drawn
    assert "-x*y + 1.5*x" in drawn and "left" in drawn
