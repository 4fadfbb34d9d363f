import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from dynsr.errors import InputError
from dynsr.records import RecordWarning
from dynsr.replicate import replicate

HERE = Path(__file__).parent
# A program that replicates with a slow fake method until it is done or killed.
PROGRAM = """
import sys
sys.path.insert(0, {here!r})
from fake_methods import make
from dynsr.replicate import replicate
replicate(["pendulum"], ["guess0.15"], runs=8, seed=3, jobs=2, out=sys.argv[1], make=make)
"""


@pytest.fixture
def make(monkeypatch):
    """Make fake methods, which worker processes can import too."""
    monkeypatch.syspath_prepend(HERE)
    from fake_methods import make

    return make


def timeless(records):
    """Give records without the one part that is not determined."""
    return [replace(r, seconds=0.0) for r in records]


def test_the_result_does_not_depend_on_the_number_of_workers(make, tmp_path):
    """One worker and three give equal records, tables and pictures, from one seed."""
    arguments = (["pendulum", "lotka-volterra"], ["guess"], 2, 5)
    one = replicate(*arguments, jobs=1, out=tmp_path / "one", make=make)
    three = replicate(*arguments, jobs=3, out=tmp_path / "three", make=make)
    assert timeless(one.records) == timeless(three.records)
    assert len({r.expression for r in one.records}) == 4
    pictures = [(tmp_path / name / "figure1.png").read_bytes() for name in ("one", "three")]
    assert pictures[0] == pictures[1]


def test_another_seed_or_selection(make, tmp_path):
    """A seed decides the formulas; what else is replicated with a cell does not."""
    alone = replicate(["pendulum"], ["guess"], 1, 5, 1, tmp_path / "a", make=make)
    more = replicate(["cart-pole", "pendulum"], ["guess"], 2, 5, 1, tmp_path / "b", make=make)
    other = replicate(["pendulum"], ["guess"], 1, 6, 1, tmp_path / "c", make=make)
    same = [r for r in more.records if r.system == "pendulum" and r.run == 1]
    assert timeless(alone.records) == timeless(same)
    assert alone.records[0].expression != other.records[0].expression


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.23, 0.55])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_replication_is_continued_to_the_same_result(make, tmp_path, delay, number):
    """Killed or interrupted at some moment, the next call ends with the records of a whole run."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.format(here=str(HERE)))
    out = tmp_path / "out"
    environment = {**os.environ, "PYTHONPATH": str(HERE.parent)}
    child = subprocess.Popen(
        [sys.executable, program, out], env=environment, stderr=subprocess.DEVNULL
    )
    while not list(out.glob("cells/*.json")):
        assert child.poll() is None
        time.sleep(0.01)
    time.sleep(delay)
    child.send_signal(number)
    assert child.wait(timeout=20) != 0
    left = len(list(out.glob("cells/*.json")))
    assert 1 <= left < 8 and not (out / "report.html").exists()
    continued = replicate(
        ["pendulum"], ["guess0.15"], runs=8, seed=3, jobs=2, out=out, make=make
    )
    whole = replicate(
        ["pendulum"], ["guess0.15"], runs=8, seed=3, jobs=2, out=tmp_path / "whole", make=make
    )
    assert timeless(continued.records) == timeless(whole.records)
    assert (out / "report.html").exists()


def test_records_are_used_again(make, tmp_path):
    """A second call computes nothing: it gives the records of the first, seconds included."""
    first = replicate(["pendulum"], ["guess"], 2, jobs=1, out=tmp_path, make=make)
    again = replicate(["pendulum"], ["guess"], 2, jobs=1, out=tmp_path, make=make)
    assert first == again


@pytest.mark.parametrize("damage", ["cut", "changed", "other", "empty", "list"])
def test_a_damaged_record_is_computed_again(make, tmp_path, damage):
    """A record that is cut short, altered or misplaced gives a warning and the right result."""
    first = replicate(["pendulum"], ["guess"], 2, jobs=1, out=tmp_path, make=make)
    one, two = (tmp_path / "cells" / f"pendulum.guess.{run}.json" for run in (1, 2))
    text = one.read_text()
    one.write_text(
        {
            "cut": text[: len(text) // 2],
            "changed": text.replace('"theta2"', '"theta1"'),
            "other": two.read_text(),
            "empty": "",
            "list": "[1, 2]",
        }[damage]
    )
    with pytest.warns(RecordWarning, match="computing it again"):
        again = replicate(["pendulum"], ["guess"], 2, jobs=1, out=tmp_path, make=make)
    assert timeless(again.records) == timeless(first.records)


def test_a_record_of_other_settings_is_computed_again(make, tmp_path):
    """When a method's own settings changed, its old records are not used."""
    replicate(["pendulum"], ["guess"], 1, jobs=1, out=tmp_path, make=make)
    old = tmp_path / "cells" / "pendulum.guess.1.json"
    assert json.loads(old.read_text())["settings"]["pause"] == 0.0

    def slower(name, preset, system_name):
        return make("guess0.01", preset, system_name)

    with pytest.warns(RecordWarning, match="other settings of the method"):
        replicate(["pendulum"], ["guess"], 1, jobs=1, out=tmp_path, make=slower)


def test_a_failed_cell_is_a_record_and_is_tried_again(make, tmp_path):
    """A method that raises, finds nothing or kills its process fails alone, and says why."""
    methods = ["guess", "broken-raises", "broken-finds-nothing", "broken-dies"]
    result = replicate(["pendulum"], methods, 1, jobs=2, out=tmp_path, make=make)
    assert [r.status for r in result.records] == ["done", "failed", "failed", "failed"]
    errors = [r.error for r in result.failed]
    assert errors[0] == "ValueError: no luck today"
    assert "finite values" in errors[1] and "process died" in errors[2]
    page = (tmp_path / "report.html").read_text()
    assert "no luck today" in page and "process died" in page

    def repaired(name, preset, system_name):
        return make("guess", preset, system_name)

    assert not replicate(["pendulum"], methods, 1, jobs=2, out=tmp_path, make=repaired).failed


@pytest.mark.parametrize(
    "change, message",
    [
        ({"seed": 1}, r"holds results with seed 0, not 1; give another folder, or seed 0"),
        ({"quick": True}, "holds results with quick False, not True"),
    ],
)
def test_other_settings_in_the_same_folder_are_refused(make, tmp_path, change, message):
    """A folder of results is only continued with the settings that it was begun with."""
    replicate(["pendulum"], ["guess"], 1, jobs=1, out=tmp_path, make=make)
    with pytest.raises(InputError, match=message):
        replicate(["pendulum"], ["guess"], 1, **{"jobs": 1, "out": tmp_path, "make": make, **change})


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"systems": ["pendlum"]}, "unknown system 'pendlum'; the systems are: lotka-volterra"),
        ({"methods": ["gaa"]}, "unknown method 'gaa'; the methods are: dynaifeynman, ga, sindy"),
        ({"methods": []}, "nothing to replicate"),
        ({"engine": "matlab"}, "unknown engine 'matlab'"),
        ({"runs": 0}, "runs 0 must be"),
        ({"seed": -1}, "seed -1 must be"),
        ({"jobs": 0}, "jobs 0 must be"),
    ],
)
def test_bad_arguments_are_named_before_anything_is_written(tmp_path, arguments, message):
    """One line names the value and the remedy, and no folder is made."""
    with pytest.raises(InputError, match=message) as caught:
        replicate(**{"methods": ["ga"], "out": tmp_path / "new", **arguments})
    assert "\n" not in str(caught.value) and not (tmp_path / "new").exists()


def test_quick_runs_say_so(make, tmp_path):
    """Quick means two runs with the quick preset, and the record and the report say it."""
    result = replicate(["pendulum"], ["ga"], jobs=1, out=tmp_path, quick=True)
    assert [r.preset for r in result.records] == ["quick", "quick"]
    assert result.records[0].settings["iterations"] == 4
    assert "A quick run" in (tmp_path / "report.html").read_text()


def test_the_genetic_algorithm_replicates_in_the_paper_settings(tmp_path):
    """A real cell: the paper's settings are in the record, its losses are those of its formula."""
    from dynsr.catalogue import PENDULUM
    from dynsr.scoring import equation_rmse, printed_loss, trajectory_loss

    record = replicate(["pendulum"], ["ga"], 1, jobs=1, out=tmp_path).records[0]
    assert (record.settings["bits"], record.settings["population"]) == (20, 70)
    assert record.equation_rmse == pytest.approx(equation_rmse(PENDULUM, record.expr))
    assert record.printed_loss == pytest.approx(printed_loss(PENDULUM, record.expr, "GA"))
    assert record.trajectory_loss == pytest.approx(trajectory_loss(PENDULUM, record.expr))
    assert record.versions["numpy"] and record.engine == "embedded" and record.seconds > 0
    assert record.front[-1]["expression"] == record.expression
