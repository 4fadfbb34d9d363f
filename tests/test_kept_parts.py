"""Parts of long tasks: a run that is cut again and again ends as one that is not."""

import json
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import pytest

import dynsr
from dynsr.jobs import pool
from dynsr.jobs.pool import Parts
from dynsr.jobs.store import FolderTaken, RecordWarning, RunFolder, fingerprint
from dynsr.methods.parts import part

X = np.linspace(0.5, 2.0, 60)
T = np.linspace(0, 3, 61)
RUN = dynsr.Trajectory(
    T, np.column_stack([np.exp(-0.5 * T), np.exp(-0.5 * T) * (1 + T)]), ("x", "y")
)


class Killed(BaseException):
    """What ends a process: nothing catches it."""


def cut_after_each(monkeypatch, count=1):
    """Have every run end as soon as it has kept one new part or state, or so many."""
    monkeypatch.setattr(pool, "_SECONDS_BETWEEN_STATES", 0.0)
    keep, kept = RunFolder.save, []

    def killed(self, *arguments):
        keep(self, *arguments)
        if "parts" in self.records:
            kept.append(self)
            if len(kept) % count == 0:
                raise Killed

    monkeypatch.setattr(RunFolder, "save", killed)


def again_and_again(make, most=400):
    """Call until it ends; gives the result and how often it was cut."""
    for cuts in range(most):
        with suppress(Killed):
            return make(), cuts
    pytest.fail(f"cut {most} times, it has not ended")


def results_of(found):
    """Give what a discovery has found, without times."""
    return {k: v for k, v in found.as_record().items() if k != "seconds"}


METHODS = {
    "genetic": dynsr.GeneticAlgorithm(population=30, iterations=12),
    "feynman": dynsr.DynAIFeynman.preset("quick"),
    "network": dynsr.DynAIFeynman(
        stages=("polynomial", "symmetry", "separability", "refinement", "snapping"), epochs=20
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_a_search_that_is_cut_after_each_part_ends_in_the_same(name, tmp_path, monkeypatch):
    """Generations, stages and a trained network are made once; fronts are equal to the last bit."""
    if name == "network":
        pytest.importorskip("torch")
    asked = {"method": [METHODS[name]], "jobs": 1, "scheme": "central2"}
    whole = results_of(dynsr.discover(RUN, **asked, out=tmp_path / "whole"))
    without = results_of(dynsr.discover(RUN, **asked))
    with monkeypatch.context() as patch:
        cut_after_each(patch)
        found, cuts = again_and_again(lambda: dynsr.discover(RUN, **asked, out=tmp_path / "cut"))
    assert cuts >= {"genetic": 12, "feynman": 4, "network": 3}[name]
    assert results_of(found) == whole == without
    assert not (tmp_path / "cut" / "parts").exists()
    assert not (tmp_path / "whole" / "parts").exists()


@pytest.mark.slow
def test_a_cell_of_a_replication_goes_on_where_it_was_cut(tmp_path, monkeypatch):
    """What a cut run has kept is read, not made again; the record is that of an uncut one."""
    system = dynsr.find_system("lotka-volterra")
    asked = {"systems": [system], "methods": ["ga"], "runs": 1, "jobs": 1, "quick": True}

    # In this process, where it can be seen.
    def here(work, calls, jobs, apart=False):
        yield from ((i, work(*call)) for i, call in enumerate(calls))

    monkeypatch.setattr(pool, "spread", here)
    whole = dynsr.replicate(**asked, out=tmp_path / "whole", report=False)
    cut_after_each(monkeypatch)
    found, cuts = again_and_again(
        lambda: dynsr.replicate(**asked, out=tmp_path / "cut", report=False)
    )
    assert cuts > 3
    assert [replace(r, seconds=0.0) for r in found.records] == [
        replace(r, seconds=0.0) for r in whole.records
    ]


def parts_of(tmp_path, key="k"):
    """Give the parts of a task of that folder."""
    return Parts(RunFolder(tmp_path), "search-x-own", key)


@dataclass(frozen=True)
class Piece:
    """A part."""

    value: float


def test_parts_within_parts_have_a_place_of_their_own(tmp_path):
    """Two of one name are two, whatever was read and whatever was made."""
    made = []

    def make(value):
        def piece():
            made.append(value)
            return Piece(value)

        return piece

    def outer(keeper):
        def both():
            first = keeper.take("inner", Piece, make(1.0), lambda _: True)
            second = keeper.take("inner", Piece, make(2.0), lambda _: True)
            return Piece(first.value + second.value)

        last = keeper.take("outer", Piece, both, lambda _: True)
        return last, keeper.take("inner", Piece, make(9.0), lambda _: True)

    first = outer(parts_of(tmp_path))
    assert outer(parts_of(tmp_path)) == first == (Piece(3.0), Piece(9.0))
    assert made == [1.0, 2.0, 9.0]


def test_a_part_that_is_damaged_or_of_another_run_is_made_again(tmp_path):
    """Each has a checksum and the digest of what it depends on; one that was cut is never kept."""
    keeper = parts_of(tmp_path)
    keeper.take("one", Piece, lambda: Piece(1.0), lambda _: True)
    keeper.take("cut", Piece, lambda: Piece(2.0), lambda _: False)
    (path,) = (tmp_path / "parts").rglob("*.json")
    with pytest.warns(RecordWarning, match="other data or with other settings"):
        other = parts_of(tmp_path, "other").take("one", Piece, lambda: Piece(3.0), lambda _: True)
    assert other == Piece(3.0)
    record = json.loads(path.read_text())
    path.write_text(json.dumps({**record, "value": 7.0}))
    with pytest.warns(RecordWarning, match="checksum differs"):
        again = parts_of(tmp_path, "other").take("one", Piece, lambda: Piece(4.0), lambda _: True)
    assert again == Piece(4.0)


def test_without_a_run_a_part_is_made_as_it_is_asked_for():
    """A search by hand keeps nothing."""
    assert part("any", Piece, lambda: Piece(1.0)) == Piece(1.0)


def test_a_link_in_the_place_of_parts_is_not_followed(tmp_path):
    """Parts go into the folder of the run, or nowhere."""
    (tmp_path / "run").mkdir()
    (tmp_path / "elsewhere").mkdir()
    folder = RunFolder(tmp_path / "run")
    folder.claim("discovery", {"seed": 0})
    (tmp_path / "run" / "parts").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FolderTaken, match="a link 'parts' to another folder"):
        folder.claim("discovery", {"seed": 0})


def noisy_run():
    """Give logistic growth with 2 % of noise, whose formulas are compared along the states."""
    t = np.linspace(0, 10, 201)
    x = 1 / (1 + 9 * np.exp(-t))
    noisy = x + 0.01 * np.random.default_rng(5).normal(size=x.shape)
    return dynsr.Trajectory(t, noisy[:, None], ("x",))


@pytest.mark.slow
def test_fits_of_whole_systems_are_made_once_however_often_a_run_is_cut(tmp_path, monkeypatch):
    """A repeated run takes those of the comparison and the verdict, and ends in the same."""
    made, recall = [], Parts.recall

    def counted(self, name, make, given):
        def one():
            made.append((name, fingerprint(given)))
            return make()

        return recall(self, name, one, given)

    monkeypatch.setattr(Parts, "recall", counted)
    run, asked = noisy_run(), {"jobs": 1, "seed": 2}
    whole = results_of(dynsr.discover(run, **asked, out=tmp_path / "whole"))
    usual = sorted(made)
    assert {name for name, _ in usual} == {"system"}
    with monkeypatch.context() as patch:
        cut_after_each(patch, 20)
        made.clear()
        found, cuts = again_and_again(
            lambda: dynsr.discover(run, **asked, out=tmp_path / "cut"), len(usual)
        )
    assert cuts > 1
    assert sorted(made) == usual
    assert results_of(found) == whole
    assert not (tmp_path / "cut" / "parts").exists()


def test_kept_fits_have_all_their_bits_and_their_order(tmp_path):
    """What is read is what was made: not finite numbers, no rows, columns first, and no fit."""
    arrays = [np.array([[1 / 3, np.nan, -0.0], [np.inf, 5e-324, 1e308]]), np.zeros((0, 2))]
    arrays += [arrays[0].T, np.array(2.5)]
    first = parts_of(tmp_path)
    first._before = -np.inf
    first.recall("none", lambda: None, ["none"])
    first._before = -np.inf
    made = first.recall("some", lambda: arrays, [arrays[0], "some", 1])
    again = parts_of(tmp_path)
    assert again.recall("none", pytest.fail, ["none"]) is None
    read = again.recall("some", pytest.fail, [arrays[0], "some", 1])
    for one, other, array in zip(made, read, arrays, strict=True):
        assert one.tobytes() == other.tobytes() == array.tobytes()
        assert one.shape == other.shape == array.shape
        assert one.flags.c_contiguous == other.flags.c_contiguous == array.flags.c_contiguous
    other = [np.nextafter(arrays[0], 0), "some", 1]
    assert again.recall("some", lambda: [np.ones(1)], other)[0].tolist() == [1.0]


def test_kept_fits_that_are_damaged_are_made_again(tmp_path):
    """A file of them is used whole or not at all, and the others still are."""
    first = parts_of(tmp_path)
    for name in ("a", "b"):
        first._before = -np.inf
        first.recall(name, lambda: [np.ones(2)], [name])
    (path,) = (tmp_path / "parts").rglob("fits-0.json")
    path.write_text(path.read_text().replace('"turned": false', '"turned": true'))
    again = parts_of(tmp_path)
    with pytest.warns(RecordWarning, match="checksum differs"):
        assert again.recall("a", lambda: [np.zeros(2)], ["a"])[0].tolist() == [0.0, 0.0]
    assert again.recall("b", pytest.fail, ["b"])[0].tolist() == [1.0, 1.0]
