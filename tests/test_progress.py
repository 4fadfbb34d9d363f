import io

import pytest
import sympy
from rich.console import Console

from dynsr.commands import progress as module
from dynsr.commands.progress import SearchProgress, best_equation
from dynsr.expression import parse
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
    """Where stderr is no terminal, a new stage is one line, at most one in two seconds."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    with SearchProgress() as progress:
        for second, stage in ((0, "read"), (1, "skipped"), (3, "grow"), (9, "grow"), (9.5, "end")):
            now[0] = second
            progress(stage, 2, 2 if stage == "end" else None, "x*y")
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["read: x*y", "grow: x*y", "[2/2] end: x*y"]


def test_quiet_says_nothing(capsys):
    """With --quiet nothing is written."""
    with SearchProgress(quiet=True) as progress:
        progress("read", 1, 2, "x*y")
        progress.say("a line")
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
        progress("brute force [1]", 1, total, "-x*y + 1.5*x")
        progress._bar.refresh()
        progress.say("one line [2]")
    drawn = screen.getvalue()
    assert "brute force [1]" in drawn and "one line [2]" in drawn
    assert "-x*y + 1.5*x" in drawn and "left" in drawn
