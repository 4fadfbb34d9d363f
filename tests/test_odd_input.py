"""Data and settings that are small, odd or broken end in an answer or in one line."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from dynsr.data.reading import take_trajectories
from dynsr.data.slopes import choose_samples
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.discovery.search import discover
from dynsr.errors import EngineError, InputError
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import ParetoFront, score_candidate
from dynsr.fit.linear import eliminate
from dynsr.methods.base import AbstractMethod
from dynsr.methods.rational import RationalSearch
from dynsr.methods.registry import choose_methods

QUICK = RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1)


@dataclass(frozen=True)
class Failing(AbstractMethod):
    """A method that ends in an exception of its own."""

    error: Exception = ArithmeticError("the ground\n gave way")
    name = "failing"

    def search(self, samples, rng, report=None):
        """Fail."""
        raise self.error


def decay(rows: int = 60):
    """Give x = 2 exp(-t/2)."""
    t = np.linspace(0, 6, rows)
    return t, 2 * np.exp(-t / 2)[:, None]


def swings(rows: int, states: int):
    """Give waves of one period, far from 0, of so many rows and states."""
    t = np.arange(float(rows))
    x = np.column_stack([30 + 20 * np.sin(t / 1.6 + j) for j in range(states)])
    return Trajectory(t, x, tuple("abc")[:states])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_eight_rows_give_an_answer_and_never_a_fault():
    """The smallest table goes through a whole quick search, and no method fails."""
    found = discover(swings(8, 1), preset="quick", jobs=1)
    assert set(found.equations) == {"a"}
    assert "failed" not in found.explanation["a"]


@pytest.mark.slow
@pytest.mark.parametrize("rows", [8, 21])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_fewer_rows_than_terms_give_formulas(rows):
    """Every quick method has formulas where its library has more terms than there are rows."""
    samples = choose_samples(swings(rows, 3), "a")
    for method in choose_methods("auto", "quick").values():
        front = method.search(samples, np.random.default_rng(0))
        assert front.best_by_source and all(np.isfinite(one.loss) for one in front.best_by_source)


def test_elimination_with_fewer_rows_than_columns_explains_them_all():
    """With 4 rows and 9 columns the first fits are exact, and every size follows."""
    rng = np.random.default_rng(0)
    columns, y = rng.normal(size=(4, 9)), rng.normal(size=4)
    fits = list(eliminate(columns, y))
    assert [len(kept) for kept, _ in fits] == list(range(9, 0, -1))
    for kept, coefficients in fits[:6]:
        np.testing.assert_allclose(columns[:, list(kept)] @ coefficients, y, atol=1e-9)


def test_a_method_that_fails_is_a_note_and_not_the_end():
    """The other method's equation comes, and the explanation says who failed and of what."""
    found = discover(decay(), method=[QUICK, Failing()], jobs=1)
    assert str(found.equations["x"]) == "-0.5*x"
    assert "failing, which failed (ArithmeticError: the ground gave way)" in found.explanation["x"]


@pytest.mark.slow
def test_a_failure_is_tried_again_and_a_good_end_is_kept(tmp_path):
    """The record of a failed search is no result: the same call searches again."""
    for _ in range(2):
        found = discover(decay(), method=[QUICK, Failing()], jobs=1, out=tmp_path)
        assert "which failed" in found.explanation["x"]


@dataclass(frozen=True)
class FailingOnce(AbstractMethod):
    """A method that fails the first time, and then has the one right formula."""

    mark: Path
    name = "failing-once"

    def search(self, samples, rng, report=None):
        """Fail while the mark is not there, and leave it."""
        if not self.mark.exists():
            self.mark.touch()
            raise ArithmeticError("not yet")
        return ParetoFront([score_candidate(parse("-0.5*x"), samples, self.name)])


@dataclass(frozen=True)
class Poor(AbstractMethod):
    """A method that finds one formula, of another law."""

    name = "poor"

    def search(self, samples, rng, report=None):
        """Give exp(-x) alone."""
        return ParetoFront([score_candidate(parse("exp(-x)"), samples, self.name)])


@pytest.mark.slow
def test_a_choice_made_without_a_failed_method_is_made_again_once_it_succeeds(tmp_path):
    """What the method finds the second time competes; the choice of the first does not stay."""
    methods = [Poor(), FailingOnce(tmp_path / "mark")]
    first = discover(decay(), method=methods, jobs=1, out=tmp_path / "out")
    again = discover(decay(), method=methods, jobs=1, out=tmp_path / "out")
    assert str(first.equations["x"]) != "-0.5*x"
    assert "failing-once, which failed" in first.explanation["x"]
    assert "failed" not in again.explanation["x"]
    assert any(c.source == "failing-once" for c in again.front["x"].best_by_source)
    assert str(again.equations["x"]) == "-0.5*x"


@pytest.mark.parametrize(
    "error", [InputError("12 rows are too few; give 20"), EngineError("Julia ended")]
)
def test_where_every_method_fails_its_own_error_comes(error):
    """The error keeps its kind, and so its exit code, and its one line."""
    with pytest.raises(type(error), match=str(error)):
        discover(decay(), method=Failing(error), jobs=1)


@pytest.mark.parametrize("jobs", [0, -2, 1.5])
def test_an_impossible_number_of_jobs_is_refused(jobs):
    """The line names the number."""
    with pytest.raises(InputError, match=f"jobs {jobs} must be a whole number"):
        discover(decay(), method=QUICK, jobs=jobs)


@pytest.mark.parametrize("scheme", ["savgol(4,2)", "savgol(5,9)", "savgol(999,2)"])
def test_a_smoother_that_does_not_fit_is_refused(scheme):
    """Even windows, degrees as large as the window, and windows longer than the data."""
    with pytest.raises(InputError, match=r"does not fit \d+ rows; give an odd window"):
        discover(decay(), method=QUICK, jobs=1, scheme=scheme)


def test_masked_values_are_not_measured_and_never_data():
    """Wherever a masked array comes in, the values below its mask do not; a time must be there."""
    t, x = decay()
    masked = np.ma.masked_array(x, mask=np.zeros_like(x, dtype=bool))
    masked[7, 0] = np.ma.masked
    for make in (
        lambda: take_trajectories((t, masked)),
        lambda: take_trajectories({"t": t, "x": masked[:, 0]}),
        lambda: take_trajectories(np.ma.column_stack([t, masked])),
        lambda: Trajectory(t, masked, ("x",)),
    ):
        made = make()
        run = made if isinstance(made, Trajectory) else made[0][0]
        rows = run.own_rows("x")
        assert np.array_equal(run.t[rows], np.delete(t, 7))
        assert np.array_equal(run.x[rows], np.delete(x, 7, axis=0))
    with pytest.raises(InputError, match="time in row 8 is nan"):
        Trajectory(np.ma.masked_array(t, mask=np.arange(len(t)) == 7), x, ("x",))
    whole = np.ma.masked_array(x, mask=np.zeros_like(x, dtype=bool))
    assert take_trajectories((t, whole))[0][0].x[7, 0] == x[7, 0]


def test_a_result_nested_without_end_is_refused(tmp_path):
    """JSON a hundred thousand lists deep is one line, not the end of the stack."""
    path = tmp_path / "deep.json"
    path.write_text("[" * 100_000 + "]" * 100_000)
    with pytest.raises(InputError, match="no whole JSON"):
        Discovery.load(path)
