"""Inputs that step between rows: they are seen, and the intervals of the steps do not count."""

from itertools import pairwise

import numpy as np
import pytest

import dynsr
from dynsr.data import Trajectory, cut_at_unseen_steps, find_unseen_steps
from dynsr.errors import DynsrWarning


def circuit(
    ago: float, noise: float = 0.0, rows: int = 160, period: int = 20, step: float = 0.1
) -> Trajectory:
    """Give v' = 2 (u - v) in closed form; u steps so many rows before the row that shows it."""
    t = np.arange(rows) * step
    edges = (np.arange(0, rows, period) - ago) * step
    # On both rows and edges each stretch has one value of u.
    times = np.unique(np.append(t, edges[edges > 0]))
    levels = 5.0 * ((np.searchsorted(edges, times, side="right") - 1) % 2)
    v = [0.0]
    for u, length in zip(levels, np.diff(times), strict=False):
        v.append(u + (v[-1] - u) * np.exp(-2 * length))
    x = np.array(v)[np.isin(times, t)][:, None]
    x = x + np.random.default_rng(0).normal(size=x.shape) * noise * x.std()
    u = 5.0 * ((np.arange(rows) // period) % 2)
    return Trajectory(t, x, ("v",), u[:, None], ("u",))


def swept(noise: float) -> Trajectory:
    """Give v' = 2 (u - v) in closed form for an input that goes up and down in straight lines."""
    t = np.arange(160) * 0.1
    corner = t[::20]
    u = np.interp(t, corner, np.arange(len(corner)) % 2)
    v = [0.3]
    for begin, end in pairwise(u):
        slope = (end - begin) / 0.1
        # v = u - slope / 2 solves it along a line.
        v.append(end - slope / 2 + (v[-1] - begin + slope / 2) * np.exp(-0.2))
    x = np.array(v)[:, None]
    x = x + np.random.default_rng(0).normal(size=x.shape) * noise * x.std()
    return Trajectory(t, x, ("v",), u[:, None], ("u",))


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("ago", [0.3, 0.5, 1.0])
def test_steps_between_rows_are_seen(ago: float, noise: float) -> None:
    """A step before the row that shows the new value is seen, up to a whole row before."""
    found = find_unseen_steps([circuit(ago, noise)])
    assert found is not None
    assert found.inputs == ("u",)
    assert found.rows[0].tolist() == list(range(19, 159, 20))


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_steps_at_rows_are_no_steps_between_them(noise: float) -> None:
    """An input that is held from row to row, or goes in straight lines, has none."""
    assert find_unseen_steps([circuit(0.0, noise)]) is None
    assert find_unseen_steps([swept(noise)]) is None


@pytest.mark.slow
def test_steps_at_rows_are_seldom_taken_for_others() -> None:
    """Of 200 draws of noise, where one in a thousand is expected, two at most."""
    run = circuit(0.0)
    rng, wrong = np.random.default_rng(1), 0
    for _ in range(200):
        x = run.x + rng.normal(scale=0.05, size=run.x.shape)
        wrong += find_unseen_steps([Trajectory(run.t, x, ("v",), run.inputs, ("u",))]) is not None
    assert wrong <= 2


def test_a_noisy_input_may_step_too() -> None:
    """What steps by far more than it moves elsewhere steps, though it never repeats a value."""
    run = circuit(0.5, 0.01)
    u = run.inputs + np.random.default_rng(2).normal(scale=0.02, size=run.inputs.shape)
    found = find_unseen_steps([Trajectory(run.t, run.x, ("v",), u, ("u",))])
    assert found is not None
    assert found.rows[0].tolist() == list(range(19, 159, 20))


def test_cutting_keeps_what_is_long_enough() -> None:
    """Parts of fewer than eight rows are left out; where these are most, nothing is cut."""
    run = circuit(0.5, period=9)
    steps = find_unseen_steps([run])
    assert steps is not None
    parts = cut_at_unseen_steps([run], steps)
    assert parts is not None
    assert {len(part) for part in parts} == {9}
    short = circuit(0.5, period=6)
    steps = find_unseen_steps([short])
    assert steps is None or cut_at_unseen_steps([short], steps) is None


@pytest.mark.slow
def test_a_whole_run_shows_steps_that_no_single_row_shows() -> None:
    """Where noise hides what happens at each step, the residuals of whole runs show it."""
    run = circuit(0.5, 0.03, rows=900, period=100, step=0.01)
    assert find_unseen_steps([run]) is None
    with pytest.warns(DynsrWarning, match="u steps between rows"):
        found = dynsr.discover(run, jobs=1)
    assert found.verdict.level == "law"
    assert {str(term) for term in found.equations["v"].free_symbols} == {"u", "v"}
    assert len(found.equations["v"].args) == 2


@pytest.mark.slow
def test_steps_between_rows_hide_no_law() -> None:
    """The law is found, its constants are right, and one line says what is wrong with the table."""
    with pytest.warns(DynsrWarning, match=r"u steps between rows, such as from t = 1\.9 to 2\. "):
        found = dynsr.discover(circuit(0.5), jobs=1)
    assert found.verdict.level == "law"
    assert float(found.equations["v"].coeff("u")) == pytest.approx(2, abs=0.02)
    assert float(found.equations["v"].coeff("v")) == pytest.approx(-2, abs=0.02)
    assert len(found.equations["v"].args) == 2
    record = found.settings["unseen_steps"]
    times = record.pop("times")
    assert record == {"inputs": ["u"], "intervals": 7, "cut": True}
    # Each step is between two rows, 0.1 apart.
    assert len(times) == 7 and times[0] == pytest.approx([1.9, 2.0])
    assert [end - begin for begin, end in times] == pytest.approx([0.1] * 7)
    assert "Measure more often around the steps" in found.explanation["v"]
