import json
import math
import os
import time
from dataclasses import dataclass, replace

import numpy as np
import pytest
import sympy

from dynsr.errors import InputError
from dynsr.jobs.store import write_text
from dynsr.paper.records import (
    Record,
    RecordError,
    describe_settings,
    open_folder,
    plain_values,
    read_record,
    write_record,
)

RECORD = Record(
    system="pendulum",
    method="ga",
    run=2,
    target="theta2",
    seed=(1, 2, 3, 2),
    status="done",
    engine="embedded",
    versions={"numpy": "2"},
    preset="paper",
    settings={"bits": 20, "constants": [0.1, -9.81]},
    expression="-9.81*sin(theta1) - 0.1*theta2",
    fit_loss=0.1 + 0.2,
    complexity=31.0,
    equation_rmse=1e-300,
    printed_loss=math.inf,
    trajectory_loss=2.5,
    seconds=0.25,
    front=({"expression": "1/3*x", "loss": 0.5, "complexity": 2.0},),
)


@pytest.mark.parametrize(
    "record", [RECORD, replace(RECORD, status="failed", error="no", expression="", front=())]
)
def test_a_record_reads_back_as_it_was(tmp_path, record):
    """Every number keeps all its bits, infinity included, and the file is strict JSON."""
    path = tmp_path / "cell.json"
    write_record(record, path)
    again = read_record(path)
    assert again == record and again.printed_loss == math.inf

    def refuse(name):
        raise AssertionError(name)

    json.loads(path.read_text(), parse_constant=refuse)
    assert os.listdir(tmp_path) == ["cell.json"]


def test_every_cut_and_every_flipped_character_is_known(tmp_path):
    """No prefix of a record, and none with a character changed, is read as another record."""
    path = tmp_path / "cell.json"
    write_record(RECORD, path)
    text = path.read_text()
    rng = np.random.default_rng(0)
    damaged = [text[:n] for n in range(0, len(text) - 1, 37)]
    for at in rng.choice(len(text) - 1, 60, replace=False):
        if not text[at].isspace():
            damaged.append(text[:at] + ("7" if text[at] != "7" else "8") + text[at + 1 :])
    refused = 0
    for content in damaged:
        path.write_text(content)
        try:
            # The last digit of a number may change and leave the same float64.
            assert read_record(path) == RECORD
        except RecordError:
            refused += 1
    assert refused >= len(damaged) - 2


def test_a_write_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    """When the disk is full the file keeps its old content, whole."""
    path = tmp_path / "file.txt"
    write_text(path, "old")
    monkeypatch.setattr(os, "fsync", lambda number: (_ for _ in ()).throw(OSError(28, "full")))
    with pytest.raises(OSError, match="full"):
        write_text(path, "new")
    assert path.read_text() == "old"


def test_a_folder_is_continued_with_the_same_settings_alone(tmp_path):
    """Equal settings continue a folder; the first that differs is named with both values."""
    settings = {"seed": 1, "quick": False}
    folder = open_folder(tmp_path / "a" / "b", settings)
    assert open_folder(folder, settings) == folder
    with pytest.raises(InputError, match="holds results with seed 1, not 2; give another folder"):
        open_folder(folder, {"seed": 2, "quick": True})


def test_a_folder_without_a_manifest_yet_is_continued(tmp_path):
    """A call that was killed before it wrote its manifest does not make the folder useless."""
    (tmp_path / "cells").mkdir()
    (tmp_path / ".manifest.json.77.part").write_text("{")
    assert open_folder(tmp_path, {"seed": 1}) == tmp_path


def test_what_is_left_half_written_is_removed_when_it_is_old(tmp_path):
    """A part of an hour ago goes, one of just now may belong to a process that runs."""
    folder = open_folder(tmp_path, {})
    old, new = folder / "cells" / ".a.1.part", folder / "cells" / ".b.2.part"
    for part in (old, new):
        part.write_text("{")
    os.utime(old, (time.time() - 7200,) * 2)
    open_folder(tmp_path, {})
    assert not old.exists() and new.exists()


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda p: p.write_text("x"), "is a file; give a folder"),
        (lambda p: (p.mkdir(), (p / "thesis.doc").write_text("x")), "holds 'thesis.doc' and no"),
        (lambda p: (p.mkdir(), (p / "manifest.json").write_text("{}")), "no manifest of dynsr"),
        (lambda p: (p.mkdir(), (p / "manifest.json").write_text("{")), "no manifest of dynsr"),
        (lambda p: (p.mkdir(), (p / "manifest.json").write_text("[]")), "no manifest of dynsr"),
    ],
)
def test_a_folder_that_is_not_ours_is_refused(tmp_path, make, message):
    """One line says why, and what is there stays as it is."""
    make(tmp_path / "out")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=message) as caught:
        open_folder(tmp_path / "out", {})
    assert "\n" not in str(caught.value) and sorted(tmp_path.rglob("*")) == before


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, monkeypatch):
    """A folder below a file, or one that the system refuses, is named in one line."""
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot write results into .*: Not a directory; give"):
        open_folder(tmp_path / "file" / "out", {})
    monkeypatch.setattr(
        os, "replace", lambda a, b: (_ for _ in ()).throw(PermissionError(13, "no"))
    )
    with pytest.raises(InputError, match="cannot write results into .*: no; give another folder"):
        open_folder(tmp_path / "out", {})


def test_settings_become_plain_values():
    """Expressions, arrays, nested settings and classes become what JSON holds."""

    @dataclass(frozen=True)
    class Inner:
        law: sympy.Expr

    @dataclass(frozen=True)
    class Outer:
        inner: Inner
        numbers: np.ndarray
        kind: type
        bound: float
        names: frozenset

    x = sympy.Symbol("x")
    outer = Outer(Inner(x / 3), np.array([1.0, 2.0]), int, math.inf, frozenset("ba"))
    expected = {
        "inner": {"law": "x/3"},
        "numbers": [1.0, 2.0],
        "kind": "int",
        "bound": "inf",
        "names": ["a", "b"],
    }
    assert describe_settings(outer) == plain_values(outer) == expected
    assert json.loads(json.dumps(expected, allow_nan=False)) == expected
