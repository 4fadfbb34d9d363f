"""Columns that never change: their equation is 0, and the others are found next to them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynsr.data import Trajectory, diagnose
from dynsr.discovery.search import discover
from dynsr.expression.parsing import parse
from dynsr.fit import Measurements
from dynsr.fit.whole import fit_states
from dynsr.selection import explore


@pytest.fixture(scope="module")
def hunted():
    """Give prey and hunters with 1 % noise, and their times."""
    t = np.linspace(0, 7.9, 80)

    def slope(t, s):
        return [1.5 * s[0] - s[0] * s[1], s[0] * s[1] - 3 * s[1]]

    x = solve_ivp(slope, (0, 7.9), [1.0, 0.5], t_eval=t, rtol=1e-9, atol=1e-9).y.T
    return t, x * (1 + 0.01 * np.random.default_rng(0).normal(size=x.shape))


def with_constant(pair, value):
    """Give the run with a third state that has one value at all times."""
    t, x = pair
    return Trajectory(t, np.column_stack([x, np.full(len(t), value)]), ("a", "b", "c"))


@pytest.mark.parametrize("value", [3.0, 0.0, 3e9])
@pytest.mark.slow
def test_a_constant_state_does_not_change_in_noise(hunted, value):
    """Alone as the target, it has the equation 0, which is a law."""
    found = discover([with_constant(hunted, value)], targets=["c"], preset="quick", jobs=1)
    assert found.equations == {"c": 0}
    assert found.verdict.states["c"].reason == "c does not change."
    assert found.verdict.states["c"].r2 == 1.0


@pytest.mark.slow
def test_a_state_that_is_another_constant_in_each_run_does_not_change(hunted):
    """Values that differ from run to run are no motion."""
    runs = [with_constant(hunted, value) for value in (3.0, 4.0)]
    found = discover(runs, targets=["c"], preset="quick", jobs=1)
    assert found.equations == {"c": 0} and found.verdict.level == "law"


@pytest.mark.parametrize("method", ["auto", "sindy"])
@pytest.mark.slow
def test_a_constant_state_has_no_velocity(method):
    """Equations of second order are those of what moves, and the system is a law all the same."""
    t = np.linspace(0, 6, 80)
    run = Trajectory(t, np.column_stack([np.cos(2 * t), np.full(80, 2.0)]), ("y", "c"))
    found = discover(run, order=2, method=method, preset="quick", jobs=1)
    assert {s: str(e) for s, e in found.equations.items()} == {
        "y": "y_dot",
        "y_dot": "-4*y",
        "c": "0",
    }
    assert found.verdict.level == "law"


@pytest.mark.slow
def test_noise_is_that_of_the_states_that_change(hunted):
    """A column without a change says nothing of the noise, and its terms can be explored."""
    plain = Measurements.of([Trajectory(*hunted, ("a", "b"))], {}, 100)
    beside = Measurements.of([with_constant(hunted, 3.0)], {}, 100)
    assert beside.noise_share == plain.noise_share
    assert next(iter(explore("c", beside))) == 0
    only = Trajectory(hunted[0], np.full((80, 1), 3.0), ("c",))
    assert Measurements.of([only], {}, 100).noise_share == 0.0


def test_fits_that_leave_nothing_are_compared(hunted):
    """A fit without residuals is as likely as itself, and far likelier than one with some."""
    run = Trajectory(hunted[0], np.full((80, 1), 3.0), ("c",))
    rest = fit_states({"c": parse("0")}, [run], {})
    moved = replace(rest, misses=rest.misses + 1.0)
    assert rest.ratio(rest) == 0.0 and rest.ratio(moved) == np.inf


def test_causes_are_sought_next_to_a_large_constant(hunted):
    """Distances are in units of what a column is, also where it has no spread."""
    run = with_constant(hunted, 3e9)
    assert isinstance(diagnose([run], "a"), list)


@pytest.mark.slow
@pytest.mark.parametrize(
    "asked",
    [
        {},
        {"known": {"c": "0"}},
        {"known": {"a": "1.5*a"}, "targets": ["a", "c"]},
        {"order": 2, "targets": ["c"]},
        {"discrete": True},
        {"vary": True, "method": "sindy"},
    ],
    ids=str,
)
def test_every_kind_of_search_takes_constant_states(hunted, asked):
    """Nothing fails, and the constant state stays what it is."""
    run = with_constant(hunted, 3.0)
    how = {"preset": "quick", "functions": [], "jobs": 1}
    found = discover([run, run] if "vary" in asked else [run], **how, **asked)
    last = list(found.equations)[-1] if "order" in asked else "c"
    assert found.equations[last] == (parse("c") if "discrete" in asked else 0)
