import json
import math
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import sympy

from dynsr.cli.output import make_folder
from dynsr.data.temporary import open_part
from dynsr.errors import InputError
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate
from dynsr.jobs.store import (
    RecordError,
    RecordWarning,
    RunFolder,
    fingerprint,
    from_plain,
    read_record,
    to_plain,
    write_record,
    write_text,
)
from dynsr.paper.records import Record, describe_settings

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
    write_record(path, record)
    again, _ = read_record(path, Record)
    assert again == record and again.printed_loss == math.inf

    def refuse(name):
        raise AssertionError(name)

    json.loads(path.read_text(), parse_constant=refuse)
    assert os.listdir(tmp_path) == ["cell.json"]


def test_every_cut_and_every_flipped_character_is_known(tmp_path):
    """No prefix of a record, and none with a character changed, is read as another record."""
    path = tmp_path / "cell.json"
    write_record(path, RECORD)
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
            assert read_record(path, Record)[0] == RECORD
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


def claim(path, settings, key="", work="replication"):
    """Claim a folder of a replication."""
    RunFolder(path, "cells").claim(work, settings, key, alone=("cells", "tables"))


def test_a_folder_is_continued_with_the_same_settings_alone(tmp_path):
    """Equal settings continue a folder; the first that differs is named with both values."""
    settings = {"seed": 1, "quick": False}
    folder = tmp_path / "a" / "b"
    claim(folder, settings)
    claim(folder, settings)
    with pytest.raises(InputError, match="holds results with seed 1, not 2; give another folder"):
        claim(folder, {"seed": 2, "quick": True})
    with pytest.raises(InputError, match="holds results with other options; give another folder"):
        claim(folder, settings, "key")
    with pytest.raises(InputError, match="no manifest of a dynsr discovery; give a new or an emp"):
        claim(folder, settings, work="discovery")


def test_a_folder_without_a_manifest_yet_is_continued(tmp_path):
    """A call that was killed before it wrote its manifest does not make the folder useless."""
    (tmp_path / "cells").mkdir()
    open_part(tmp_path)[1].close()
    claim(tmp_path, {"seed": 1})
    assert json.loads((tmp_path / "manifest.json").read_text())["settings"] == {"seed": 1}


def test_what_is_left_half_written_is_removed_when_it_is_old(tmp_path):
    """A part of an hour ago goes, one of just now may belong to a process that runs."""
    claim(tmp_path, {})
    made = [open_part(tmp_path / "cells") for _ in range(2)]
    for _, file in made:
        file.close()
    (old, _), (new, _) = made
    os.utime(old, (time.time() - 7200,) * 2)
    claim(tmp_path, {})
    assert not old.exists() and new.exists()


@pytest.mark.parametrize("folder", [".", "cells"])
@pytest.mark.parametrize("name", [".film.mkv.part", ".a.csv.7-9.part", ".dynsr-mine.part"])
def test_what_others_left_half_written_stays(folder, name, tmp_path):
    """Whatever ends in .part, and links of dynsr's own names, are nobody's to remove."""
    claim(tmp_path, {})
    theirs = tmp_path / folder / name
    theirs.write_text("half of a film")
    link = theirs.with_name(".dynsr-0123456789abcdef.part")
    link.symlink_to(tmp_path / "gone")
    for path in (theirs, link):
        os.utime(path, (time.time() - 7200,) * 2, follow_symlinks=False)
    claim(tmp_path, {})
    assert theirs.read_text() == "half of a film" and link.is_symlink()


def test_a_folder_with_the_half_written_file_of_others_is_refused(tmp_path):
    """Another program's download makes no folder one of dynsr's."""
    (tmp_path / ".film.mkv.part").write_text("half")
    with pytest.raises(InputError, match=r"holds '\.film\.mkv\.part' and no results of dynsr"):
        claim(tmp_path, {})


def test_no_record_is_written_through_a_link(tmp_path):
    """A link in a folder of results, sent by somebody, leads to no file and no folder outside."""
    claim(tmp_path / "run", {})
    theirs = tmp_path / "thesis.txt"
    theirs.write_text("mine")
    folder = RunFolder(tmp_path / "run", "cells")
    folder.file("a").symlink_to(theirs)
    folder.save("a", "key", RECORD)
    assert theirs.read_text() == "mine" and not folder.file("a").is_symlink()
    elsewhere = tmp_path / "elsewhere"
    (tmp_path / "run" / "cells").rename(elsewhere)
    (tmp_path / "run" / "cells").symlink_to(elsewhere)
    with pytest.raises(InputError, match="contains a link 'cells' to another folder"):
        claim(tmp_path / "run", {})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda p: p.write_text("x"), "is a file; give a folder"),
        (lambda p: (p.mkdir(), (p / "thesis.doc").write_text("x")), "holds 'thesis.doc' and no"),
        (
            lambda p: (p.mkdir(), (p / "manifest.json").write_text("{}")),
            "no manifest of a dynsr replication",
        ),
        (
            lambda p: (p.mkdir(), (p / "manifest.json").write_text("{")),
            "no manifest of a dynsr replication",
        ),
        (
            lambda p: (p.mkdir(), (p / "manifest.json").write_text("[]")),
            "no manifest of a dynsr replication",
        ),
    ],
)
def test_a_folder_that_is_not_ours_is_refused(tmp_path, make, message):
    """One line says why, and what is there stays as it is."""
    make(tmp_path / "out")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=message) as caught:
        claim(tmp_path / "out", {})
    assert "\n" not in str(caught.value) and sorted(tmp_path.rglob("*")) == before


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, monkeypatch):
    """A folder below a file, or one that the system refuses, is named in one line."""
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match=r"cannot write results into .*: Not a directory; give"):
        claim(tmp_path / "file" / "out", {})
    monkeypatch.setattr(
        os, "replace", lambda a, b: (_ for _ in ()).throw(PermissionError(13, "no"))
    )
    with pytest.raises(InputError, match=r"cannot write results into .*: no; give another folder"):
        claim(tmp_path / "out", {})


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
        "bound": None,
        "names": ["a", "b"],
    }
    assert describe_settings(outer) == to_plain(outer) == expected
    assert json.loads(json.dumps(expected, allow_nan=False)) == expected


def test_values_of_every_type_read_back():
    """Candidates, optional values, tuples and mappings are what they were; null is infinity."""
    found = (Candidate(parse("1/3*x"), 0.1 + 0.2, 7.5, "ga"), Candidate(parse("2.0*x"), 0.5, 3.0))
    for kind, value in (
        (tuple[Candidate, ...], found),
        (tuple[tuple[str, ...], float], (("a", "b"), math.inf)),
        (dict[str, float], {"a": 1e-300}),
        (float | None, 2.5),
    ):
        assert from_plain(kind, json.loads(json.dumps(to_plain(value)))) == value


@pytest.mark.parametrize("loss", [None, math.inf, 2.5])
def test_what_is_not_there_is_told_from_what_is_infinite(tmp_path, loss):
    """A record reads back with None where nothing was measured and infinity where it diverged."""
    record = replace(RECORD, printed_loss=loss)
    write_record(tmp_path / "record.json", record)
    assert read_record(tmp_path / "record.json", Record)[0] == record


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (int, "1"),
        (Candidate, {"expr": "x"}),
        (Candidate, []),
        (Candidate, {"expr": "open('f')", "loss": 1.0, "complexity": 1.0, "source": ""}),
        (tuple[float, float], [1.0]),
    ],
)
def test_a_value_of_another_type_is_refused(kind, value):
    """What is not of the type asked for is an error, and code in a formula is never run."""
    with pytest.raises((ValueError, TypeError)):
        from_plain(kind, value)


def test_a_record_of_another_key_or_type_is_refused(tmp_path):
    """A record counts only for the data and settings that it was made from, and if finished."""
    folder = RunFolder(tmp_path)
    folder.claim("test", {})
    folder.save("a", "one", RECORD)
    assert folder.load("a", "one", Record) == RECORD and folder.load("b", "one", Record) is None
    assert folder.load("a", "two", Record, lambda record: False) is None
    with pytest.warns(RecordWarning, match="other data or with other settings; computing it again"):
        assert folder.load("a", "two", Record) is None
    with pytest.raises(RecordError, match="does not have the fields of a Candidate"):
        read_record(folder.file("a"), Candidate)


def test_fingerprints_tell_values_apart():
    """Equal values have one fingerprint; another number, type, shape or nesting has another."""
    values = [
        np.arange(4.0),
        np.arange(4),
        np.arange(4.0).reshape(2, 2),
        [0.0, 1.0],
        [[0.0], 1.0],
        {"a": 1},
        {"a": "1"},
    ]
    assert len({fingerprint(v) for v in values}) == len(values)
    assert fingerprint({"a": 1, "b": [2]}) == fingerprint({"b": [2], "a": 1})


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit])
def test_a_signal_just_as_a_part_is_made_leaves_none(tmp_path, monkeypatch, end):
    """The file is there, and who made it has not heard of it yet."""
    make = Path.open

    def interrupted(path, mode):
        make(path, mode)
        raise end

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", interrupted)
        with pytest.raises(end):
            open_part(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_signal_as_a_folder_is_tried_leaves_no_part(tmp_path, monkeypatch):
    """Where a command tries whether it can write, a signal may fall just behind the closing."""

    class Closed:
        def close(self):
            raise SystemExit(143)

    def opened(folder):
        part, file = open_part(folder)
        file.close()
        return part, Closed()

    monkeypatch.setattr("dynsr.data.open_part", opened)
    with pytest.raises(SystemExit):
        make_folder(tmp_path)
    assert not list(tmp_path.iterdir())
