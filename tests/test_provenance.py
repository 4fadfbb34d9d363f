"""What made each number of a replication, and the embedded engine beside another, cell by cell."""

from dataclasses import replace

import numpy as np
import pytest

from dynsr.data.system import PENDULUM
from dynsr.engines import registry
from dynsr.engines.testing import RecordingEngine
from dynsr.jobs.store import read_record, write_record
from dynsr.paper.page import render_replication
from dynsr.paper.provenance import engines_table, made_by_table
from dynsr.paper.records import Record
from dynsr.paper.replication import Cell, Plan, compute_cell
from dynsr.paper.results import all_tables

VERSIONS = {
    "julia": "1.10.5",
    "OrdinaryDiffEqTsit5": "1.1.0",
    "DataDrivenDiffEq": "1.5.0",
    "DataDrivenSparse": "0.1.2",
    "juliacall": "0.9.31",
}
OFF = 1e-6


class Other(RecordingEngine):
    """An engine whose states are off by one part in a million, with versions of its own."""

    def integrate(self, problem):
        """Be off."""
        solved = super().integrate(problem)
        return replace(solved, x=solved.x * (1 + OFF))

    def versions(self):
        """Name the packages of Julia."""
        return VERSIONS


@pytest.fixture(scope="module")
def records():
    """Compute a cell of SINDy and one of the GA by that engine, and one by the embedded one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(registry._STARTED, "julia", Other("julia"))
        by_julia = [
            compute_cell(Cell(PENDULUM, method, 1), Plan(0, "quick", "julia"))
            for method in ("sindy", "ga")
        ]
    assert all(r.done for r in by_julia), by_julia
    return [*by_julia, compute_cell(Cell(PENDULUM, "sindy", 1), Plan(0, "quick", "embedded"))]


@pytest.mark.slow
def test_a_cell_by_another_engine_has_what_the_embedded_one_makes_of_it(records):
    """Its samples are off as that engine is; its own losses and SINDy's formula stand beside."""
    sindy, ga, plain = records
    assert plain.embedded is None and sindy.versions == VERSIONS
    # Slopes are differences of states over 0.01 s, and one part in a million is off in each.
    assert sindy.embedded["samples"] == pytest.approx(OFF, rel=0.01)
    assert sindy.embedded["expression"] == plain.expression != sindy.expression
    for loss in ("printed_loss", "trajectory_loss", "equation_rmse"):
        assert sindy.embedded[loss] == getattr(plain, loss)
        assert ga.embedded[loss] == pytest.approx(getattr(ga, loss), rel=0.01)
    assert "expression" not in ga.embedded and "numpy" in ga.embedded["versions"]


def test_the_two_engines_stand_beside_each_other_cell_by_cell(records):
    """A row a cell; what the embedded engine did not search again is the same formula."""
    rows = engines_table(records).to_records()
    assert [(r["System"], r["Method"], r["Run"]) for r in rows] == [
        ("pendulum", "sindy", 1),
        ("pendulum", "ga", 1),
    ]
    assert rows[0]["Formula, julia"] == records[0].expression
    assert rows[0]["Formula, embedded"] == records[2].expression
    assert rows[1]["Formula, embedded"] == "the same"
    assert rows[0]["Corrected: embedded"] == records[2].trajectory_loss
    assert rows[1]["As printed: julia"] == records[1].printed_loss


def test_each_number_names_its_engine_and_versions(records):
    """Samples, formulas, errors, losses, the paper's side: none is left out."""
    rows = {r["Number"]: r for r in made_by_table(records[:2]).to_records()}
    assert set(rows) == {
        "samples",
        "formulas of SINDy",
        "formulas of the other methods",
        "errors on the samples, bits",
        "our losses, the curves of Figure 1",
        "the paper's losses, corrected",
    }
    samples, sindy = rows["samples"], rows["formulas of SINDy"]
    assert samples["Made by"] == "julia: Tsit5"
    assert samples["Versions"].startswith("julia 1.10.5, OrdinaryDiffEqTsit5 1.1.0, juliacall 0.9")
    assert "optimizers of DataDrivenDiffEq.jl 0.5" in sindy["Made by"]
    others = rows["formulas of the other methods"]
    assert (
        others["Made by"].startswith("no engine")
        and f"numpy {np.__version__}" in others["Versions"]
    )
    assert rows["the paper's losses, corrected"]["Made by"] == "embedded: Tsit5"
    recorded = made_by_table(records[2:], recorded_steps=True).to_records()
    assert recorded[0]["Made by"] == "embedded: Tsit5 on the steps of 2021"


@pytest.mark.slow
def test_the_page_shows_both_tables(records):
    """The page of a replication in Julia holds both; that of an embedded one only the second."""
    settings = {"seed": 0, "engine": "embedded", "quick": True, "recorded_steps": False}
    page = render_replication(records[:2], settings)
    assert "Embedded against julia, cell by cell" in page and "What made each number" in page
    assert "Embedded against" not in render_replication(records[2:], settings)
    names = [table.name for table in all_tables(records)]
    assert names[-2:] == ["engines", "made_by"] and "engines" not in [
        table.name for table in all_tables(records[2:])
    ]


def test_records_keep_the_comparison(records, tmp_path):
    """What a record says of the embedded engine is read back, and so is one that says nothing."""
    path = tmp_path / "record.json"
    for one in records:
        write_record(path, one)
        assert read_record(path, Record)[0] == one
