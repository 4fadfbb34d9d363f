"""Batch: a discovery for each of many files, and a table of them."""

import re
from dataclasses import replace
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest
from command_line import run
from fake_methods import DiesOnce

from dynsr.discovery import discover_each, read_batch
from dynsr.discovery.batch import Discovered
from dynsr.errors import InputError
from dynsr.jobs import RecordError
from dynsr.methods import RationalSearch

T = np.linspace(0.0, 4.0, 60)
QUICK = {
    "report": False,
    "method": RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1),
}
RATES = {"slow": 0.5, "fast": 2.0, "late": 1.25}


def write(folder, rates):
    """Write a decay for each rate; gives the files."""
    files = []
    for name, rate in rates.items():
        table = np.column_stack([T, 3 * np.exp(-rate * T)])
        files.append(folder / f"{name}.csv")
        np.savetxt(files[-1], table, delimiter=",", header="t,x", comments="", fmt="%.17g")
    return files


def timeless(rows):
    """The table without what a clock says."""
    return [replace(row, seconds=0.0) for row in rows]


@pytest.mark.slow
def test_each_file_has_its_own_law(tmp_path):
    """Three decays of three rates are three laws, in the order of the files; a bad file is said."""
    files = write(tmp_path, RATES)
    (tmp_path / "bad.csv").write_text("t,x\n0,1\n1,2\n")
    files.insert(1, tmp_path / "bad.csv")
    steps = []
    rows = discover_each(files, tmp_path / "out", jobs=1, progress=steps.append, **QUICK)
    assert [row.equations for row in rows] == [
        ("x' = -0.5*x",),
        (),
        ("x' = -2*x",),
        ("x' = -1.25*x",),
    ]
    assert [row.level for row in rows] == ["law", "failed", "law", "law"]
    assert "rows" in rows[1].reason and "\n" not in rows[1].reason
    assert [step.done for step in steps if step.what] == [1, 2, 3, 4]
    assert len(list((tmp_path / "out" / "each").glob("*/discovery.json"))) == 3


@pytest.mark.slow
def test_the_same_call_does_what_is_left(tmp_path):
    """Files that were searched are read back; new, changed and failed ones are searched."""
    files = write(tmp_path, RATES)
    first = discover_each(files[:2], tmp_path / "out", jobs=1, **QUICK)
    write(tmp_path, {"fast": 3.0})
    with pytest.warns(match="computing it again"):
        again = discover_each(files, tmp_path / "out", jobs=1, **QUICK)
    # What is read back has the seconds that it took.
    assert again[0] == first[0]
    assert [row.equations for row in again[1:]] == [("x' = -3*x",), ("x' = -1.25*x",)]


def test_wrong_calls_are_said_in_one_line(tmp_path):
    """No file, one file twice, and a folder of other settings."""
    files = write(tmp_path, {"slow": 0.5})
    with pytest.raises(InputError, match="no file was given"):
        discover_each([], tmp_path / "out")
    with pytest.raises(InputError, match=r"slow.csv' is given twice"):
        discover_each(files * 2, tmp_path / "out")
    discover_each(files, tmp_path / "out", jobs=1, **QUICK)
    with pytest.raises(InputError, match="give another folder"):
        discover_each(files, tmp_path / "out", jobs=1, seed=1, **QUICK)


@pytest.mark.slow
def test_files_of_one_name_have_folders_of_their_own(tmp_path):
    """Two folders with a run.csv each are two discoveries."""
    files = []
    for name, rate in (("a", 0.5), ("b", 2.0)):
        (tmp_path / name).mkdir()
        files += write(tmp_path / name, {"run": rate})
    rows = discover_each(files, tmp_path / "out", jobs=1, **QUICK)
    assert [row.equations for row in rows] == [("x' = -0.5*x",), ("x' = -2*x",)]


@pytest.mark.slow
def test_a_batch_leaves_a_table_and_a_page(tmp_path):
    """Each file has a row with verdict, equations and a link to its report; a bad one has none."""
    files = write(tmp_path, {"a strain": 0.5})
    (tmp_path / "bad.csv").write_text("t,x\n0,1\n1,2\n")
    out = tmp_path / "out"
    rows = discover_each([*files, tmp_path / "bad.csv"], out, jobs=1, **{**QUICK, "report": True})
    table = pd.read_csv(out / "discoveries.csv").fillna("")
    assert list(table["verdict"]) == ["law", "failed"]
    assert list(table["equations"]) == ["x' = -0.5*x", ""]
    # Of each constant the term, the value and its interval.
    assert table["constants"][0].startswith("x', x: -0.5 (-0.5") and not table["constants"][1]
    assert "give at least 8" in table["reason"][1]
    assert (out / table["report"][0]).is_file() and not table["report"][1]
    page = (out / "report.html").read_text()
    (address,) = re.findall('href="(each/[^"]+)"', page)
    assert unquote(address) == table["report"][0]
    assert "1 law, 1 failed." in page and "x&#39; = -0.5*x" in page
    assert read_batch(out) == rows
    # What is no page of dynsr is not replaced, and is said before the work.
    (out / "report.html").write_text("mine")
    with pytest.raises(InputError, match="is there and not of dynsr"):
        discover_each(files, out, jobs=1, **{**QUICK, "report": True})
    with pytest.raises(RecordError, match="no manifest of a dynsr batch"):
        read_batch(tmp_path)


@pytest.mark.slow
def test_two_workers_of_which_one_dies_make_the_same_table(tmp_path):
    """A worker that is gone in the middle of a file changes nothing of the table."""
    files = write(tmp_path, RATES)
    mark = tmp_path / "mark"
    settings = {"method": DiesOnce(mark=str(mark)), "seed": 3}
    spread = discover_each(files, tmp_path / "two", jobs=2, **settings)
    assert mark.exists()
    alone = discover_each(files, tmp_path / "one", jobs=1, **settings)
    assert timeless(spread) == timeless(alone)


@pytest.mark.slow
def test_the_shell_prints_the_table(tmp_path, monkeypatch):
    """dynsr discover --batch shows file, verdict and equations; a system has no files."""
    monkeypatch.chdir(tmp_path)
    files = [str(file) for file in write(tmp_path, {"slow": 0.5, "fast": 2.0})]
    said = run("discover", *files, "--batch", "-q", "--jobs", "1").output
    assert "x' = -0.5*x" in said and "x' = -2*x" in said and "law" in said
    each = tmp_path / "batch-dynsr" / "each"
    assert {own.name.partition("-")[0] for own in each.iterdir()} == {"slow", "fast"}
    assert len(list(each.glob("*/report.html"))) == 2
    # The page and the table are made again from the records alone.
    page = (tmp_path / "batch-dynsr" / "report.html").read_text()
    for name in ("report.html", "discoveries.csv"):
        (tmp_path / "batch-dynsr" / name).unlink()
    run("report", "batch-dynsr")
    again = (tmp_path / "batch-dynsr" / "report.html").read_text()
    # They are sorted by their names then.
    rows = re.compile("<tr.*?</tr>")
    assert sorted(rows.findall(again)) == sorted(rows.findall(page))
    assert len(rows.findall(page)) == 3
    assert "leave -o out" in run("report", "batch-dynsr", "-o", "a.html", code=2).output


def test_a_record_says_in_a_few_words_what_was_found():
    """Its equations, or else why there are none."""
    assert Discovered("a.csv", "law", "fine.", ("x' = -x",), 1.0).summary == "law: x' = -x"
    assert Discovered("a.csv", "failed", "no rows", (), 1.0).summary == "failed: no rows"
