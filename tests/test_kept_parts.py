"""Parts of long tasks: a run that is cut again and again ends as one that is not."""

import json
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import pytest

import dynsr
from dynsr.jobs import pool
from dynsr.jobs.pool import Parts
from dynsr.jobs.store import FolderTaken, RecordWarning, RunFolder
from dynsr.methods.parts import part

X = np.linspace(0.5, 2.0, 60)
T = np.linspace(0, 3, 61)
RUN = dynsr.Trajectory(
    T, np.column_stack([np.exp(-0.5 * T), np.exp(-0.5 * T) * (1 + T)]), ("x", "y")
)


class Killed(BaseException):
    """What ends a process: nothing catches it."""


def cut_after_each(monkeypatch, name="save"):
    """Have every run end as soon as it has kept one new part or state."""
    monkeypatch.setattr(pool, "_SECONDS_BETWEEN_STATES", 0.0)
    keep = getattr(RunFolder, name)

    def killed(self, *arguments):
        keep(self, *arguments)
        if "parts" in self.records:
            raise Killed

    monkeypatch.setattr(RunFolder, name, killed)


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
    "genetic": dynsr.GeneticAlgorithm(population=30, iterations=35),
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
    assert cuts >= {"genetic": 35, "feynman": 4, "network": 3}[name]
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
