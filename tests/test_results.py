import csv
import io
import math
from dataclasses import replace

import numpy as np
import pytest
from fake_records import PRINTED, record
from scipy.integrate import solve_ivp

from dynsr.data.system import LORENZ, LOTKA_VOLTERRA, PENDULUM
from dynsr.expression.evaluation import compile_numpy
from dynsr.expression.parsing import parse
from dynsr.paper.results import (
    all_tables,
    appendix_table,
    drawable,
    figure_1,
    groups,
    loss_table,
    panel,
    table_1,
    table_2,
)


@pytest.fixture(scope="module")
def records():
    """Give the paper's printed GA expressions as if they were ours, and a failed cell."""
    done = [
        record(system, text, run)
        for system, texts in PRINTED.items()
        for run, text in enumerate(texts, 1)
    ]
    failed = replace(done[0], run=6, status="failed", error="no luck", expression="")
    return [*done, failed]


def test_table_1_is_three_by_three_as_printed_with_ours_next_to_it(records):
    """Every number of the paper's Table 1 is there; ours are where there are records."""
    table = table_1([*records[:-1], record("lorenz", "x*y")])
    assert [row[0] for row in table.rows] == ["DynAIFeynman", "GA-Baseline", "SINDy"]
    assert table.columns[1:3] == ("Lotka-Volterra, paper", "Lotka-Volterra, ours")
    printed = [[str(cell) for cell in row[1::2]] for row in table.rows]
    assert printed == [
        ["0.19 ± 0.05", "2.41 ± 0.13", "1.23 ± 0.36"],
        ["2.13 ± 1.11", "2.47 ± 0.003", "0.771 ± 0.79"],
        ["0.24", "2.19", "1.92"],
    ]
    ours = [[str(cell) for cell in row[2::2]] for row in table.rows]
    assert ours == [["", "", ""], ["2.134 ± 1.107", "", "0.7713 ± 0.7861"], ["", "", ""]]


def test_losses_of_the_papers_own_formulas_are_the_papers(records):
    """Mean and deviation of the printed expressions' losses are the printed Table 1, digits cut."""
    rows = list(csv.DictReader(io.StringIO(loss_table(records[:-1]).to_csv())))
    assert [(r["System"], r["Method"], r["Runs"]) for r in rows] == [
        ("Lotka-Volterra", "GA-Baseline", "5"),
        ("Cart-pole", "GA-Baseline", "5"),
    ]
    assert [r["As printed: paper"] for r in rows] == ["2.13 ± 1.11", "0.771 ± 0.79"]
    for row, (mean, deviation) in zip(rows, [(2.134, 1.107), (0.771, 0.786)], strict=True):
        assert float(row["As printed: ours, mean"]) == pytest.approx(mean, abs=1e-3)
        assert float(row["As printed: ours, deviation"]) == pytest.approx(deviation, abs=1e-3)
        for kind in ("Corrected", "Equation RMSE"):
            ours, paper = (float(row[f"{kind}: {who}, mean"]) for who in ("ours", "paper"))
            assert ours == pytest.approx(paper, rel=1e-9)


def test_failed_runs_are_counted_and_not_averaged(records):
    """A cell that failed shows in the runs and in its table of the appendix, and nowhere else."""
    table = loss_table(records)
    assert [row[2] for row in table.rows] == ["5 of 6", "5"]
    assert table.rows[0][3] == loss_table(records[:-1]).rows[0][3]
    (failed,) = [r for r in appendix_table(groups(records)[0]).rows if r[2] == "failed: no luck"]
    assert failed[:2] == ("ours", "6") and all(math.isnan(v) for v in failed[4:7])


def test_the_appendix_has_the_papers_numbers_and_each_formula_once(records):
    """In the paper's order; runs with one formula are one row, and the printed ones follow ours."""
    more = [*records, record("pendulum", "theta1", method="sindy")]
    tables = all_tables(more)
    assert [t.name for t in tables] == ["table1", "table2", "losses", "appendix_ga_lotka-volterra",
                                        "appendix_ga_cart-pole", "appendix_sindy_pendulum",
                                        "made_by"]  # fmt: skip
    assert [t.title[:8] for t in tables[3:6]] == ["Table 4:", "Table 5:", "Table 9:"]
    rows = tables[4].to_records()
    ours = {r["Formula"]: r for r in rows if r["By"] == "ours"}
    assert {formula: r["Runs"] for formula, r in ours.items()} == {
        "-12*w": "1", "-2*w - z^2/y": "2", "-2*w": "3, 5", "-4*w": "4",
    }  # fmt: skip
    assert ours["-4*w"]["As printed"] == pytest.approx(0.301, abs=1e-3)
    assert ours["-2*w"]["Seconds per run, mean"] == 2.0
    paper = [r for r in rows if r["By"] == "paper"]
    assert [(r["Runs"], r["As printed"]) for r in paper] == [
        ("1", 2.168), ("2", 0.552), ("3, 5", 0.417), ("4", 0.301),
    ]  # fmt: skip


def test_runs_with_one_formula_are_named_together():
    """Five equal runs are "1 to 5"."""
    runs = [record("lorenz", "x*y", run) for run in range(1, 6)]
    (row,) = appendix_table(groups(runs)[0]).rows
    assert row[:2] == ("ours", "1 to 5") and str(row[-1]) == "1.5 ± 0.7906"


def test_a_system_that_the_paper_lacks_has_empty_columns():
    """Lorenz has our general losses, no printed loss, and nothing on the paper's side."""
    runs = [record("lorenz", "x*y - 8/3*z")]
    table = loss_table(runs)
    row = table.to_records()[0]
    assert table.rows[0][3].count == 0
    assert appendix_table(groups(runs)[0]).to_records()[0]["As printed"] is None
    assert row["As printed: paper"] == "" and math.isnan(row["Corrected: paper, mean"])
    assert row["Corrected: ours, mean"] < 1.0


def test_table_2_is_the_printed_one():
    """Bitstring length, candidates and iterations are those of the paper's Table 2."""
    assert [row[1:] for row in table_2().rows] == [(20, 20, 60), (70, 70, 100), (100, 40, 100)]


def test_curves_of_the_figure_are_solutions_of_the_formulas():
    """Truth and inferred curve agree with scipy's DOP853 at tight tolerance; best run first."""
    runs = [record("lotka-volterra", text, run) for run, text in enumerate(["x - 3", "-y*(3 - x)"])]
    shown = panel(LOTKA_VOLTERRA, groups(runs))
    for found, curve in ((-1, shown.truth), (0, shown.found["GA-Baseline"][1])):
        text = "x - 3" if found == 0 else "-y*(3 - x)"
        system = LOTKA_VOLTERRA.with_rhs("y", parse(text))
        rhs = compile_numpy(system.closed_rhs(), [*system.states, "t"])
        exact = solve_ivp(
            lambda t, x, f=rhs: f(np.array([*x, t])),
            (10, 15),
            system.x0,
            method="DOP853",
            t_eval=shown.t,
            rtol=1e-10,
            atol=1e-10,
        )
        np.testing.assert_allclose(curve, exact.y[1], atol=0.02)
    np.testing.assert_allclose(shown.found["GA-Baseline"][0], shown.truth, atol=1e-12)


def test_a_formula_that_diverges_ends_its_curve():
    """A run that explodes is NaN from there on, and the picture is still drawn."""
    shown = panel(PENDULUM, groups([record("pendulum", "exp(theta2^2)")]))
    curve = shown.found["GA-Baseline"][0]
    assert np.isfinite(curve[0]) and np.isnan(curve[-1]) and np.isfinite(shown.truth).all()


def test_figure_1_has_the_papers_two_panels(records):
    """Lotka-Volterra and the cart-pole, each with its target; other systems are apart."""
    figure = figure_1(records)
    assert [axis.get_title() for axis in figure.axes] == ["Lotka-Volterra", "Cart-pole"]
    assert [axis.get_ylabel() for axis in figure.axes] == ["y", "z (m/s)"]
    assert [len(axis.lines) for axis in figure.axes] == [6, 6]
    more = [*records, record("pendulum", "theta1"), record(LORENZ.name, "z")]
    assert drawable(more) == (["lotka-volterra", "cart-pole"], ["pendulum", "lorenz"])


def test_only_runs_without_chance_are_called_deterministic():
    """Runs of brute force that agree are deterministic; those of the GA are not."""
    for method, source, expected in (
        ("dynaifeynman", "brute force", "1.035 ± 0 (deterministic)"),
        ("dynaifeynman", "symmetry: scaling in x*y", "1.035 ± 0"),
        ("ga", "ga", "1.035 ± 0"),
    ):
        runs = [record("lotka-volterra", "x - 3", r, method, source=source) for r in (1, 2)]
        row = loss_table(runs).rows[0]
        assert [str(value) for value in (row[3], row[5])] == [expected] * 2
        assert appendix_table(groups(runs)[0]).to_records()[0]["Stage"] == source
