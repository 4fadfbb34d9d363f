import os
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from dynsr.errors import InputError
from dynsr.jobs.store import RecordWarning
from dynsr.paper.replication import replicate

HERE = Path(__file__).parent
# A program that replicates with a slow fake method until it is done or killed.
PROGRAM = """
import sys
sys.path.insert(0, {here!r})
from fake_methods import make
from dynsr.paper.replication import replicate
replicate(["pendulum"], ["guess0.15"], runs=8, seed=3, jobs=2, out=sys.argv[1], make=make)
"""


sys.path.insert(0, str(HERE))
from fake_methods import make  # noqa: E402 (worker processes import it by this name too)

CELLS = {"systems": ["pendulum"], "methods": ["guess0.15"], "runs": 8, "seed": 3, "make": make}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Eight cells by two workers, never interrupted."""
    return replicate(**CELLS, jobs=2, out=tmp_path_factory.mktemp("whole"))


@pytest.fixture
def copied(whole, tmp_path):
    """Give a folder with the same results."""
    return shutil.copytree(whole.folder, tmp_path / "copied")


def timeless(records):
    """Give records without the one part that is not determined."""
    return [replace(r, seconds=0.0) for r in records]


@pytest.mark.slow
def test_the_result_depends_on_the_seed_alone(whole, tmp_path):
    """One worker gives the records that two give, whatever else is run; another seed does not."""
    chosen = {**CELLS, "systems": ["lotka-volterra", "pendulum"], "runs": 2}
    more = replicate(**chosen, jobs=1, out=tmp_path / "more").records
    same = [r for r in more if r.system == "pendulum"]
    assert timeless(same) == timeless(whole.records[:2])
    other = replicate(**{**CELLS, "runs": 1, "seed": 4}, jobs=1, out=tmp_path / "other").records
    formulas = [r.expression for r in (*whole.records, *other)]
    assert len(set(formulas)) == len(formulas) == 9


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_replication_is_continued_to_the_same_result(whole, tmp_path, number):
    """Killed or interrupted at a random moment, the next call ends with a whole run's records."""
    program, out = tmp_path / "program.py", tmp_path / "out"
    program.write_text(PROGRAM.format(here=str(HERE)))
    child = subprocess.Popen(
        [sys.executable, program, out],
        env={**os.environ, "PYTHONPATH": str(HERE.parent)},
        stderr=subprocess.DEVNULL,
    )
    while not list(out.glob("cells/*.json")):
        assert child.poll() is None
        time.sleep(0.005)
    delay = random.uniform(0.0, 0.4)
    time.sleep(delay)
    child.send_signal(number)
    assert child.wait(timeout=30) != 0
    left = len(list(out.glob("cells/*.json")))
    assert left >= 1 and not (out / "report.html").exists(), f"killed after {delay} s"
    continued = replicate(**CELLS, jobs=1, out=out)
    assert timeless(continued.records) == timeless(whole.records), f"killed after {delay} s"
    assert (out / "report.html").exists()


@pytest.mark.slow
def test_records_are_used_again(whole, copied):
    """A second call computes nothing: it gives the records of the first, seconds included."""
    again = replicate(**CELLS, jobs=1, out=copied)
    assert again.records == whole.records


@pytest.mark.slow
def test_damaged_records_are_computed_again(whole, copied):
    """Records that are cut short, altered or misplaced give warnings and the right result."""
    one, two, three, four, five, six = (
        copied / "cells" / f"pendulum.guess0.15.{run}.json" for run in range(1, 7)
    )
    one.write_text(one.read_text()[:200])
    two.write_text(two.read_text().replace('"theta2"', '"theta1"'))
    three.write_text(six.read_text())
    four.write_text("")
    five.write_bytes(b"\xff[1, 2]")
    with pytest.warns(RecordWarning, match="computing it again") as warned:
        again = replicate(**CELLS, jobs=1, out=copied)
    assert len(warned) == 5
    assert timeless(again.records) == timeless(whole.records)


def test_a_record_of_other_settings_is_computed_again(copied):
    """When a method's own settings changed, its old records are not used."""
    chosen = {**CELLS, "runs": 1, "make": lambda name, *rest: make("guess0.01", *rest)}
    with pytest.warns(RecordWarning, match="other data or with other settings"):
        again = replicate(**chosen, jobs=1, out=copied)
    assert again.records[0].settings["pause"] == 0.01


@pytest.mark.slow
def test_a_failed_cell_is_a_record_and_is_tried_again(tmp_path):
    """A method that raises, finds nothing or kills its process fails alone, and says why."""
    methods = ["guess", "broken-raises", "broken-finds-nothing", "broken-dies"]
    result = replicate(["pendulum"], methods, 1, jobs=2, out=tmp_path, make=make)
    assert [r.status for r in result.records] == ["done", "failed", "failed", "failed"]
    errors = [r.error for r in result.failed]
    assert errors[0] == "ValueError: no luck today"
    assert "finite values" in errors[1] and "process died" in errors[2]
    page = (tmp_path / "report.html").read_text()
    assert "no luck today" in page and "process died" in page
    repaired = replicate(
        ["pendulum"],
        methods,
        1,
        jobs=1,
        out=tmp_path,
        make=lambda name, *rest: make("guess", *rest),
    )
    assert not repaired.failed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, r"holds results with seed 3, not 1; give another folder, or seed 3"),
        ({"quick": True}, "holds results with quick False, not True"),
    ],
)
def test_other_settings_in_the_same_folder_are_refused(whole, change, message):
    """A folder of results is only continued with the settings that it was begun with."""
    with pytest.raises(InputError, match=message):
        replicate(**{**CELLS, **change}, out=whole.folder)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"systems": ["pendlum"]}, "unknown system 'pendlum'; the systems are: lotka-volterra"),
        (
            {"methods": ["gaa"]},
            "unknown method 'gaa' of the paper; the methods are: dynaifeynman, ga",
        ),
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


@pytest.mark.slow
def test_quick_runs_say_so(tmp_path):
    """Quick means two runs with the quick preset, and the record and the report say it."""
    result = replicate(["pendulum"], ["ga"], jobs=1, out=tmp_path, quick=True)
    assert [r.preset for r in result.records] == ["quick", "quick"]
    assert result.records[0].settings["iterations"] == 4
    assert "A quick run" in (tmp_path / "report.html").read_text()


def test_the_genetic_algorithm_replicates_in_the_paper_settings(tmp_path):
    """A real cell: the paper's settings are in the record, its losses are those of its formula."""
    from dynsr.data.system import PENDULUM
    from dynsr.paper.protocol import printed_loss
    from dynsr.verdict.scoring import equation_rmse, trajectory_loss

    record = replicate(["pendulum"], ["ga"], 1, jobs=1, out=tmp_path).records[0]
    assert (record.settings["bits"], record.settings["population"]) == (20, 70)
    assert record.equation_rmse == pytest.approx(equation_rmse(PENDULUM, record.expr))
    assert record.printed_loss == pytest.approx(printed_loss(PENDULUM, record.expr, "GA"))
    assert record.trajectory_loss == pytest.approx(trajectory_loss(PENDULUM, record.expr))
    assert record.versions["numpy"] and record.engine == "embedded" and record.seconds > 0
    assert record.front[-1]["expression"] == record.expression
