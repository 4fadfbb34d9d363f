import json
import math
import statistics

import pytest
import sympy

from dynsr.data.system import find_system
from dynsr.expression.parsing import parse
from dynsr.jobs import to_plain
from dynsr.paper.auditing import agrees_cut, audit


@pytest.fixture(scope="module")
def rows():
    """Audit once, without the search for SINDy's own models."""
    return audit(unrounded=lambda engine: {})


@pytest.mark.slow
def test_all_but_two_printed_losses_are_reproduced(rows):
    """31 of 33 agree to every printed digit; the two that cannot have rounded coefficients."""
    assert len(rows) == 33
    missed = {(row.system, row.method) for row in rows if not row.agrees}
    assert missed == {("pendulum", "SINDy"), ("lotka-volterra", "SINDy")}


def test_digits_are_cut_not_rounded():
    """0.2139 agrees with a printed 0.213 but not with 0.214."""
    assert agrees_cut("0.213", 0.2139) and not agrees_cut("0.214", 0.2139)
    assert not agrees_cut("0.213", 0.2129999) and not agrees_cut("0.213", math.inf)


def test_every_row_has_its_corrected_value(rows):
    """The pendulum's first run is 0.187 from the right start, SINDy's 0.237, as measured."""
    assert all(math.isfinite(row.corrected) and row.equation_rmse > 0 for row in rows)
    by_key = {(row.system, row.method, row.run): row for row in rows}
    assert by_key["pendulum", "DynAIFeynman", 1].corrected == pytest.approx(0.187, abs=6e-4)
    assert by_key["pendulum", "SINDy", 1].corrected == pytest.approx(0.237, abs=6e-4)
    assert by_key["pendulum", "DynAIFeynman", 2].corrected == pytest.approx(3.0, abs=0.05)


def test_means_over_the_runs_are_the_appendix_ones(rows):
    """Our own losses have the means that the printed ones have, to the digits printed."""
    for key in {(row.system, row.method) for row in rows} - {("lotka-volterra", "SINDy")}:
        ours = [row.ours for row in rows if (row.system, row.method) == key]
        printed = [float(row.printed) for row in rows if (row.system, row.method) == key]
        tolerance = 0.02 if key == ("pendulum", "SINDy") else 1e-3
        assert statistics.fmean(ours) == pytest.approx(statistics.fmean(printed), abs=tolerance)


def test_rows_are_json(rows):
    """A row holds the names that other programs read, and nothing that JSON lacks."""
    record = json.loads(json.dumps(to_plain(rows[0]), allow_nan=False))
    assert {"system", "method", "run", "printed", "ours", "agrees", "note"} <= set(record)
    assert record["printed"] == 1.035 and record["agrees"] is True


def test_unrounded_models_stand_beside_the_rows_that_miss():
    """A model with all its digits is scored by the same protocol, only where it is needed."""

    def models(engine):
        return {
            "pendulum": parse("-(sin(theta1) - 0.0079752*theta1 + 0.0147241*theta2)/0.1008029"),
            "cart-pole": sympy.Float(0.0),
        }

    rows = audit(unrounded=models)
    beside = {row.system: row for row in rows if row.unrounded is not None}
    assert set(beside) == {"pendulum"}
    assert agrees_cut(beside["pendulum"].printed_digits, beside["pendulum"].unrounded)
    text = beside["pendulum"].unrounded_expression
    assert parse(text, find_system("pendulum").states) == models(None)["pendulum"]


@pytest.mark.slow
def test_the_papers_own_recipe_gives_the_digits_it_rounded_away():
    """SINDy on the paper's data, scored the same way: the pendulum's printed loss to every digit,
    and 0.240 +- 0.001 for Lotka-Volterra (printed 0.239), where the printed digits give 0.673.
    """
    beside = {row.system: row for row in audit() if row.unrounded is not None}
    assert set(beside) == {"pendulum", "lotka-volterra"}
    assert agrees_cut("2.186", beside["pendulum"].unrounded)
    assert beside["pendulum"].unrounded_agrees is True
    assert beside["lotka-volterra"].unrounded == pytest.approx(0.240, abs=1e-3)
