import io
import time
from dataclasses import replace

import numpy as np
import pytest
import sympy
from rich.console import Console

import dynsr
from dynsr.cli import progress as module
from dynsr.cli.progress import SearchProgress
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.jobs.progress import Running, Step, Turns, best_equation

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


def step(seconds, done=0, what="", running=(), left=65.0):
    """Give a report of a run of four tasks."""
    found = best_equation(FRONT) if what else ""
    return Step(what, done, 4, None, found, running, seconds, left if done < 4 else None)


def search(stage="generations", total=40.0):
    """Give a running search that has a formula."""
    best, began = "2*x*[y]  (error 0.5)", time.time() - 7
    return Running("search-y-ga", "y' by ga", stage, 12.0, total, best, began)


def test_a_log_gets_a_line_a_task_at_most_one_in_two_seconds(capsys):
    """Where stderr is no terminal, tasks that end are lines with the equation and time left."""
    with SearchProgress() as progress:
        for report in (
            step(0),
            step(1, 1, "x' by a"),
            step(1.5, 2, "x' by b"),
            step(4, 3, "x' by c"),
        ):
            progress(report)
        progress(step(4.5, 4, "choice of x'"))
        progress(step(5, 4))
    found = "-x*y + 1.5*x  (error 0.001)"
    assert capsys.readouterr().err.splitlines() == [
        f"[1/4] 0:01 x' by a: {found}; about 1:05 left",
        f"[3/4] 0:04 x' by c: {found}; about 1:05 left",
        f"[4/4] 0:04 choice of x': {found}",
    ]


def test_a_log_tells_of_long_searches_ever_less_often(capsys):
    """While nothing ends, a running search is told of after 10, 30, 70, 150, ... seconds."""
    with SearchProgress() as progress:
        for seconds in range(400):
            progress(step(float(seconds), running=(search(),)))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "[0/4] 0:10 y' by ga, generations 12/40: 2*x*[y]  (error 0.5)"
    assert [line.split()[1] for line in lines] == [
        "0:10",
        "0:30",
        "1:10",
        "2:30",
        "3:50",
        "5:10",
        "6:30",
    ]


def test_quiet_says_nothing(capsys):
    """With --quiet nothing is written."""
    with SearchProgress(quiet=True) as progress:
        progress(step(100, 1, "a", (search(),)))
        progress.say("a line")
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("total", [None, 40.0])
def test_a_terminal_shows_every_running_search(monkeypatch, total):
    """On a terminal each running task is a line with its stage and formula, cut to the width."""
    screen = io.StringIO()
    narrow = Console(file=screen, force_terminal=True, width=100, highlight=False)
    monkeypatch.setattr(module, "console", lambda stderr: narrow)
    with SearchProgress() as progress:
        long = replace(search(), task="search-x-ga", title="x' by ga", best="x + " * 100)
        progress(step(75, 1, "a", (search("brute force [1]", total), long)))
        progress._lines.bar.refresh()
        progress.say("one line [2]")
        drawn = screen.getvalue()
        assert "brute force [1]" in drawn and "one line [2]" in drawn and "2*x*[y]" in drawn
        assert "1 of 4 tasks" in drawn and "1:15" in drawn and "about 1:05 left" in drawn
        assert "x + x + x" in drawn and "…" in drawn
        assert len(progress._lines.bar.tasks) == 3
        progress(step(80, 2, "b", (search(),)))
        assert len(progress._lines.bar.tasks) == 2
        progress(step(90, 4, "b"))
        progress._lines.bar.refresh()
    assert "finishing" in screen.getvalue()


@pytest.mark.parametrize("asked", [{"hidden": "y"}, {"stochastic": True}])
@pytest.mark.slow
def test_whole_systems_are_shown_while_they_are_searched(asked):
    """What is best so far is in reports of what runs, and in those of what has ended."""
    t, steps = np.linspace(0, 8, 80), []
    x = np.exp(-0.1 * t) * np.cos(2 * t) + 0.01 * np.random.default_rng(0).normal(size=80)
    found = dynsr.discover((t, x[:, None]), jobs=1, progress=steps.append, **asked)
    running = [one for step in steps for one in step.running if one.equations]
    assert running and all(one.best.startswith("x' = ") for one in running)
    assert [step.what for step in steps if step.what and step.found]
    assert any("y' = " in step.found for step in steps) == bool(found.hidden)


def test_turns_say_what_ran_before():
    """The best so far stays until something better is found, and ends with what ended."""
    steps: list[Step] = []
    with Turns(["a", "b"], str, steps.append) as turns:
        for item in turns:
            if item == "a":
                turns.say({"x": parse("2*x")})
    assert [(step.what, step.found) for step in steps if step.what] == [
        ("a", "x' = 2*x"),
        ("b", "x' = 2*x"),
    ]
