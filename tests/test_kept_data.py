"""The folder of a discovery holds its data, so that later steps need nothing else."""

import json
import shutil

import numpy as np
import pytest
from command_line import run as command

from dynsr.data import DATA, KnownNoise, MeasuredSum, Trajectory, read_kept, write_csv, write_kept
from dynsr.data.dosing import Dosing
from dynsr.data.kept import KeptData
from dynsr.discovery import Discovery, discover, keep
from dynsr.errors import DynsrWarning, InputError
from dynsr.jobs import from_plain, to_plain
from dynsr.methods.rational import RationalSearch

QUICK = RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1)


def rich_run(rows, name, rng):
    """Give a run with everything that a run may have."""
    t = np.cumsum(rng.uniform(0.1, 1, rows)) / 3
    x = rng.normal(size=(rows, 3)) * [1e-300, 1.0, 1e300]
    x[2, 1] = np.nan
    gaps = np.isnan(x)
    # A hidden state: a curve that nobody measured.
    gaps[:, 2] = True
    errors = KnownNoise(rng.uniform(1, 2, rows), 0.1, sure=False)
    return Trajectory(
        t,
        x,
        ("a", "b", "c"),
        rng.normal(size=(rows, 1)),
        ("u",),
        {
            "name": name,
            "time_unit": "h",
            "units": {"a": "mg/L"},
            "labels": {"strain": "α, β"},
            "dosing": Dosing(((0.5, "a", 2.0),), None, {"a": 1.0}),
        },
        {"u": "previous"},
        gaps,
        {"a": errors},
        {"b": MeasuredSum(rng.normal(size=rows), {"a": 0.5}, KnownNoise(np.ones(rows)))},
    )


@pytest.mark.parametrize("count", [1, 3])
def test_runs_come_back_with_all_their_bits(count):
    """Gaps, curves, errors, sums, doses, inputs, names and units are those that were kept."""
    rng = np.random.default_rng(count)
    runs = [rich_run(5 + i, f'run "{i}", low', rng) for i in range(count)]
    text, kept = write_kept(runs)
    described = from_plain(KeptData, json.loads(json.dumps(to_plain(kept, whole=False))))
    again = read_kept(text.encode(), described)
    for run, own in zip(runs, again, strict=True):
        for name in ("t", "x", "inputs", "unmeasured"):
            assert np.array_equal(getattr(run, name), getattr(own, name), equal_nan=True)
        assert (run.states, run.input_names, run.hold) == (own.states, own.input_names, own.hold)
        assert run.origin == own.origin
        assert np.array_equal(run.noise["a"].sd, own.noise["a"].sd)
        assert (own.noise["a"].share, own.noise["a"].sure) == (0.1, False)
        assert np.array_equal(run.sums["b"].values, own.sums["b"].values)
        assert own.sums["b"].others == {"a": 0.5} and own.sums["b"].noise.sure


def test_a_person_reads_the_table():
    """Headings have units; a cell that was not measured is empty; runs have their names."""
    text, _ = write_kept([rich_run(4, "low", np.random.default_rng(0)) for _ in range(2)])
    head, _, _, row, *_ = text.splitlines()
    assert head == "trajectory,t [h],a [mg/L],b,c,u,c curve,a sd,b sum,b sum sd"
    cells = row.split(",")
    assert cells[0] == "low" and cells[3] == cells[4] == "" and "" not in cells[5:]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Give the folder of a discovery in two noisy runs of a decay."""
    place = tmp_path_factory.mktemp("kept")
    t, rng = np.linspace(0, 4, 60), np.random.default_rng(0)
    runs = [
        Trajectory(t, (a * np.exp(-0.5 * t) + rng.normal(0, 0.01, 60))[:, None], ("x",))
        for a in (1.0, 2.0)
    ]
    write_csv(runs, place / "measured.csv")
    found = discover(place / "measured.csv", method=QUICK, out=place / "out", jobs=1)
    assert found.equations
    return place / "out"


@pytest.mark.slow
def test_a_folder_that_moved_is_enough(folder, tmp_path):
    """Profiles, exports with data, suggestions, scores and pictures need no other file."""
    moved = tmp_path / "moved"
    shutil.copytree(folder, moved)
    found = Discovery.load(moved / "discovery.json")
    assert [len(run) for run in found.trajectories] == [60, 60]
    assert np.isfinite(found.profiles()[0].low) and found.plot().axes
    assert np.all(np.isfinite(found.covariance()))
    assert "its data" in command("profile", moved).stdout
    command("suggest", moved, "--rows", 5)
    command("score", moved)
    pytest.importorskip("libsbml", reason="python-libsbml is not installed")
    command("export", moved, "--to", "petab", "-o", tmp_path / "problem")
    table = (tmp_path / "problem" / "measurements.tsv").read_text()
    assert table.count("\n") > 120


def test_a_table_that_was_changed_is_left_out(folder, tmp_path):
    """A warning names it, and what needs data asks for them."""
    changed = tmp_path / "changed"
    shutil.copytree(folder, changed)
    (changed / DATA).write_text((changed / DATA).read_text().replace("1.", "2."))
    with pytest.warns(DynsrWarning, match="was changed since it was saved"):
        found = Discovery.load(changed / "discovery.json")
    assert not found.trajectories and found.data_summary is not None
    with pytest.raises(InputError, match="not of dynsr"):
        keep(Discovery.load(folder / "discovery.json"), changed)


def test_a_folder_without_the_table_is_read_as_before(folder, tmp_path):
    """The formulas, constants and intervals are there; the command asks for the data."""
    bare = tmp_path / "bare"
    shutil.copytree(folder, bare)
    (bare / DATA).unlink()
    assert not Discovery.load(bare / "discovery.json").trajectories
    assert "name their file" in command("profile", bare, code=2).stderr
    assert "go with a file" in command("profile", folder, "--time", "t", code=2).stderr


def test_a_description_of_another_table_is_refused(folder, tmp_path):
    """Rows and columns that do not fit are one line, not other data."""
    runs = [rich_run(5, "a", np.random.default_rng(0))]
    text, kept = write_kept(runs)
    plain = to_plain(kept, whole=False)
    for change in (
        {"states": ["a"]},
        {"more": []},
        {"runs": plain["runs"] * 2},
        {"runs": [{**plain["runs"][0], "rows": 4}]},
        {"inputs": ["a"]},
    ):
        odd = from_plain(KeptData, {**plain, **change})
        with pytest.raises(InputError, match=r"does not fit its description|used twice"):
            read_kept(text.encode(), odd)


def test_data_too_many_to_copy_are_not_kept(monkeypatch, tmp_path):
    """The discovery is saved all the same."""
    monkeypatch.setattr("dynsr.data.kept._MOST_CELLS", 5)
    found = Discovery({}, {}, {}, {}, (rich_run(5, "a", np.random.default_rng(0)),))
    assert [file.name for file in keep(found, tmp_path)] == ["discovery.json"]
