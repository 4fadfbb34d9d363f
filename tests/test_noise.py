import csv
import io
import json
import runpy
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
import sympy

from dynsr.benchmarks.noise import (
    NoiseRow,
    Recovery,
    formula_table,
    noise_table,
    recovery_rates,
    run_noise,
)
from dynsr.data.system import CART_POLE, LOTKA_VOLTERRA, SYSTEMS, System
from dynsr.errors import InputError
from dynsr.fit.candidates import ParetoFront, score_candidate
from dynsr.jobs.store import from_plain, to_plain
from dynsr.methods.base import AbstractMethod, silent

ROOT = Path(__file__).parent.parent
# A decay of few rows has the name of a system that there is: what is kept, and for whom, is the
# same for any equations.
DECAY = replace(
    System.from_strings({"x": "-x/2", "y": "x - y"}, x0=(2.0, 1.0), name=LOTKA_VOLTERRA.name),
    train=(0.0, 3.0),
    step=0.06,
)


@dataclass(frozen=True)
class Truth(AbstractMethod):
    """Give the true form for x and a straight line for y, and count the calls."""

    log: str = ""
    prey: bool = False
    name: str = field(default="truth", init=False)

    def search(self, samples, rng, report=silent):
        """Note the call; the generator is not needed."""
        if self.log:
            with open(self.log, "a", encoding="utf-8") as file:
                file.write(f"{samples.target}\n")
        x, y = sympy.symbols("x y")
        true = 1.4 * x - 0.9 * x * y if self.prey else -0.4 * x
        expr = {"x": true, "y": 0.3 * x - 0.5}[samples.target]
        return ParetoFront([score_candidate(expr, samples, self.name)])


def row(state, seed, same, off, rmse, noise=0.01, system="pendulum"):
    """Make one row."""
    return NoiseRow(Recovery(system, state, noise, seed, "2*x", same, off, 3.0 + seed), rmse)


@pytest.mark.slow
def test_draws_are_kept_and_taken_from_their_records(tmp_path):
    """A second run searches only the draws that the folder lacks, and gives the same rows."""
    log = tmp_path / "log"
    method = Truth(str(log))
    told = []

    def tell(step):
        if step.what:
            told.extend(step.record.rows)

    first = run_noise(
        [DECAY], [0.0, 0.0002], [0], method=method, out=tmp_path / "out", progress=tell
    )
    assert first == told and len(first) == 4 and len(log.read_text().split()) == 4
    again = run_noise([DECAY], [0.0, 0.0002], [0], method=method, out=tmp_path / "out")
    assert again == first and len(log.read_text().split()) == 4
    run_noise([DECAY], [0.0, 0.0002], [0, 1], method=method, out=tmp_path / "out")
    # Without noise all draws are one.
    assert len(log.read_text().split()) == 6
    for lost in (tmp_path / "out" / "records").iterdir():
        lost.unlink()
    resumed = run_noise([DECAY], [0.0], [0], method=method, out=tmp_path / "out")
    # The searches themselves are kept too.
    assert len(log.read_text().split()) == 6
    assert [r.recovery.found for r in resumed] == [r.recovery.found for r in first[:2]]


@pytest.mark.slow
def test_a_folder_holds_the_draws_of_one_method(tmp_path):
    """Another method does not mix its records with those that are there."""
    run_noise([DECAY], [0.0], [0], method=Truth(), out=tmp_path)
    with pytest.raises(InputError, match="holds results with preset best, not quick"):
        run_noise([DECAY], [0.0], [0], method=Truth(), preset="quick", out=tmp_path)


@pytest.mark.slow
def test_what_is_found_is_judged_against_the_truth():
    """The right form counts as exact with its errors; a line, which no noise mends, does not."""
    x, y = run_noise([LOTKA_VOLTERRA], [0.0], [0], method=Truth(prey=True))
    assert x.recovery.same_form and 0 <= x.recovery.constants_off < 0.02
    assert x.equation_rmse < 0.1 < y.equation_rmse
    assert not y.recovery.same_form


def test_failed_searches_count_as_not_found(tmp_path):
    """A method that the discovery refuses leaves a record in which nothing was found."""
    found = run_noise([CART_POLE], [0.01], [3], method="no-such-method", out=tmp_path)
    assert [r.recovery.state for r in found] == list(CART_POLE.states)
    assert not any(r.recovery.same_form for r in found)
    assert "no-such-method" in next((tmp_path / "records").iterdir()).read_text()


def test_rows_survive_their_record():
    """A row is read back from its record as it was, also where the error is infinite."""
    for one in (row("a", 0, True, 0.01, 0.5), row("b", 1, False, float("inf"), float("inf"))):
        assert from_plain(NoiseRow, json.loads(json.dumps(to_plain(one)))) == one


def test_table_of_the_levels():
    """Shares count all states, constants the exact ones alone, seconds the discoveries."""
    rows = [
        row("a", 0, True, 0.01, 0.5),
        row("b", 0, False, float("inf"), 4.0),
        row("a", 1, True, 0.03, 0.1),
        row("b", 1, True, 0.02, 0.2),
        row("a", 0, False, float("inf"), 9.0, noise=0.05),
    ]
    first, second = csv.DictReader(io.StringIO(noise_table(rows).to_csv()))
    assert first["states exact"] == "3 of 4" and float(first["share"]) == 0.75
    assert first["whole systems exact"] == "1 of 2" and first["draws"] == "2"
    assert float(first["constants off (median)"]) == pytest.approx(0.02)
    assert float(first["equation RMSE (median)"]) == pytest.approx(0.35)
    assert float(first["seconds (median)"]) == pytest.approx(3.5)
    assert second["states exact"] == "0 of 1" and second["constants off (median)"] == ""
    assert recovery_rates(rows) == ([0.01, 0.05], {"pendulum": [0.75, 0.0]})
    assert len(formula_table(rows).rows) == 5


@pytest.mark.slow
def test_the_script_writes_tables_and_pictures(tmp_path, monkeypatch, capsys):
    """The benchmark prints every equation and writes what it found; a bad level is one line."""
    words = ["--quick", "--levels", "0", "--method", "rational", "--preset", "quick"]
    words += ["--out", str(tmp_path)]
    monkeypatch.setitem(SYSTEMS, DECAY.name, DECAY)
    monkeypatch.setattr(sys, "argv", ["noise.py", DECAY.name, *words])
    script = runpy.run_path(str(ROOT / "scripts" / "benches" / "noise.py"))
    script["main"]()
    assert capsys.readouterr().out.count("exact, off") == 2
    assert "| lotka-volterra | 0 | 1 | 2 of 2 | 1 |" in (tmp_path / "noise.md").read_text()
    assert (tmp_path / "noise.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "noise-formulas.csv").read_text().count("lotka-volterra") == 2
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--levels", "-1"])
    with pytest.raises(SystemExit) as end:
        script["main"]()
    said = capsys.readouterr().err
    assert end.value.code == 2 and said.startswith("error: ") and said.count("\n") == 1
