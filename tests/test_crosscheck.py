"""The comparison of engines with records and peers."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from dynsr.checks import implicit
from dynsr.checks.crosschecks import (
    SECTIONS,
    CrosscheckRow,
    absent,
    coefficient_difference,
    crosscheck,
)
from dynsr.data.system import CART_POLE
from dynsr.engines.base import SparseProblem, SparseSolution
from dynsr.engines.embedded import EmbeddedEngine
from dynsr.errors import EngineError, EngineUnavailable, InputError, say_install
from dynsr.jobs import to_plain
from dynsr.paper.protocol import PAPER_NAMES

CASES = [(s, system) for s in ("corrected", "pysindy") for system in PAPER_NAMES]


# Each record is held by a test of its own; here one system shows that they make rows.
@pytest.mark.parametrize(("section", "system"), [("records", "cart-pole"), *CASES])
@pytest.mark.slow
def test_the_embedded_engine_agrees_with_julia_and_pysindy(section: str, system: str):
    """Every sparse row of every system is filled, and its verdict is that both agree."""
    rows = crosscheck([system], ["embedded"], [section])
    assert rows
    assert {row.verdict for row in rows} == {"agrees"}
    assert all(row.compared > 0 for row in rows)


class _Skewed(EmbeddedEngine):
    """An engine whose coefficients are off by one part in ten thousand."""

    name = "skewed"

    def regress(self, problem: SparseProblem) -> SparseSolution:
        solution = super().regress(problem)
        skewed = solution.coefficients.copy()
        nonzero = np.flatnonzero(skewed)
        skewed[nonzero[np.argmax(np.abs(skewed[nonzero]))]] *= 1.0001
        return SparseSolution(skewed, solution.iterations, solution.converged)


@pytest.mark.slow
@pytest.mark.parametrize(("section", "system"), [("records", "cart-pole"), ("pysindy", "pendulum")])
def test_a_wrong_engine_is_found_out(section: str, system: str):
    """An error of 1e-4 in one coefficient turns the verdict of every row."""
    rows = list(SECTIONS[section](system, _Skewed()))
    assert {row.verdict for row in rows} == {"differs"}
    assert all(row.difference == pytest.approx(1e-4, rel=0.5) for row in rows)


def test_without_pysindy_the_row_says_so(monkeypatch: pytest.MonkeyPatch):
    """An absent peer is a row with the remedy, not an error."""
    monkeypatch.setitem(sys.modules, "pysindy", None)
    (row,) = crosscheck(["pendulum"], ["embedded"], ["pysindy"])
    assert row.verdict == "absent"
    assert row.difference is None
    assert say_install("pysindy") in row.worst


def test_without_an_engine_each_section_says_so(monkeypatch: pytest.MonkeyPatch):
    """An engine that is not installed gives one absent row a section and system."""

    def unavailable(name: str) -> None:
        raise EngineUnavailable("Julia is not installed; run dynsr doctor --install")

    monkeypatch.setattr("dynsr.checks.crosschecks.find_engine", unavailable)
    rows = crosscheck(["pendulum"], engines=["julia"])
    assert [row.section for row in rows] == list(SECTIONS)
    assert {row.verdict for row in rows} == {"absent"}


def test_relations_are_compared_up_to_a_factor_and_sums_are_not():
    """A multiple of a relation is the same relation; a multiple of a sum is another sum."""
    a = np.array([1.0, -2.0, 0.5])
    assert coefficient_difference(-3 * a, a, True) < 1e-15
    assert coefficient_difference(3 * a, a, False) == pytest.approx(2.0)


def test_a_difference_at_the_limit_agrees_and_one_above_does_not():
    """The verdict follows from the difference and the limit alone."""

    def verdict(difference: float | None) -> str:
        return CrosscheckRow("s", "y", "t", "a", "b", 1, difference, 1e-6).verdict

    assert [verdict(d) for d in (1e-6, 2e-6, np.nan, None)] == [
        "agrees",
        "differs",
        "differs",
        "absent",
    ]


@pytest.mark.slow
def test_who_finds_the_law_of_the_cart_pole_is_told_right_or_wrong():
    """From exact slopes both threshold methods have its five terms; from differences, neither."""
    rows = crosscheck(["cart-pole", "pendulum"], ["embedded"], ["implicit"])
    told = {(row.ours, row.subject): row for row in rows if row.verdict != "absent"}
    found = {
        (who, scheme): row
        for (name, subject), row in told.items()
        for who in ("embedded STLSQ", "ensemble of STLSQ", "SINDyPI")
        for scheme in ("exact slopes", "forward differences")
        if name.endswith(who) and subject.endswith(scheme)
    }
    assert len(found) == len(told) >= 4 and {row.system for row in rows} == {"cart-pole"}
    for who in ("embedded STLSQ", "ensemble of STLSQ"):
        exact, rough = found[who, "exact slopes"], found[who, "forward differences"]
        assert exact.verdict == "right" and exact.difference < 1e-13
        assert exact.worst == "5 terms where the law has 5"
        assert rough.verdict == "wrong" and rough.difference > 0.1
    # L1 leaves the law's terms with shrunken coefficients, and more terms in differences.
    for (who, scheme), row in found.items():
        if who == "SINDyPI":
            assert row.verdict == "wrong"
            assert row.worst.startswith("5 ") == (scheme == "exact slopes")


@pytest.mark.slow
def test_the_law_is_a_relation_of_the_functions_given():
    """Written by hand, it has no miss over either span; a changed coefficient has one."""
    count = len(implicit.FUNCTIONS)
    law = np.zeros(2 * count)
    for place, text, value in [
        *((0, "1", 2.0), (0, "cos(w)^2", -1.0), (count, "F", 1.0)),
        *((count, "y^2*sin(w)", 1.0), (count, "cos(w)*sin(w)", 9.81)),
    ]:
        law[place + implicit.FUNCTIONS.index(text)] = value
    assert np.count_nonzero(law) == implicit.TERMS_OF_THE_LAW
    for span in (CART_POLE.train, CART_POLE.test):
        assert implicit.pose(span, exact=True).miss(law) < 1e-14
    assert implicit.pose(CART_POLE.test, exact=True).miss(law * np.where(law == 2, 1.01, 1)) > 1e-3
    assert implicit.pose(CART_POLE.train, exact=False).scheme == "forward differences"


def test_a_peer_that_is_wrong_is_no_disagreement():
    """Held to a law, a program is right or wrong; the chance of its draws is put back."""
    row = CrosscheckRow("s", "y", "t", "a", "the law", 1, 2.0, 1e-6, judged=True)
    assert row.verdict == "wrong" and replace(row, difference=1e-7).verdict == "right"
    assert replace(row, difference=None).verdict == "absent"
    state = np.random.get_state()[1].tolist()  # noqa: NPY002
    with implicit._seeded():
        first = np.random.rand()  # noqa: NPY002
    with implicit._seeded():
        assert np.random.rand() == first  # noqa: NPY002
    assert np.random.get_state()[1].tolist() == state  # noqa: NPY002


def test_unknown_names_are_refused():
    """The message lists the systems, the sections or the further programs."""
    with pytest.raises(InputError, match="cart-pole"):
        crosscheck(["lorenz"])
    with pytest.raises(InputError, match="records"):
        crosscheck(["pendulum"], sections=["weather"])
    with pytest.raises(InputError, match="diffeqpy"):
        crosscheck(["pendulum"], extra=["matlab"])


def test_an_engine_that_fails_is_no_absence(monkeypatch: pytest.MonkeyPatch):
    """An engine that is there and breaks down differs, and the row holds its words."""

    class Failing(EmbeddedEngine):
        def integrate(self, problem):
            raise EngineError("julia ended unexpectedly")

    monkeypatch.setattr("dynsr.checks.crosschecks.find_engine", lambda name: Failing())
    (row,) = crosscheck(["pendulum"], ["julia"], ["trajectories"])
    assert (row.verdict, row.worst) == ("differs", "julia ended unexpectedly")


def test_rows_are_plain_data():
    """Every row, an absent one too, can be written as strict JSON with its verdict."""
    rows = [
        absent("s", "pendulum", "julia", "everything", "not installed"),
        CrosscheckRow("s", "pendulum", "t", "a", "b", 1, 1e-9, 1e-8),
        CrosscheckRow("s", "pendulum", "t", "a", "b", 1, np.inf, 1e-8),
    ]
    found = json.loads(json.dumps(to_plain(rows), allow_nan=False))
    assert [row["verdict"] for row in found] == ["absent", "agrees", "differs"]
    assert found[0]["limit"] is None
