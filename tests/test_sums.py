"""Sums of states: a state that nobody measured alone is found in its sum with others."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr import InputError, Trajectory, discover
from dynsr.data import MeasuredSum, carry, column_units, read_sums, take_trajectories
from dynsr.fit import Measurements, fit_along
from tests.command_line import run

S, I = sympy.symbols("S I")
LAW = {"S": -0.5 * S * I, "I": 0.5 * S * I - 0.1 * I}
T = np.linspace(0, 60, 121)
SUSCEPTIBLE, INFECTED = solve_ivp(
    lambda _, y: [-0.5 * y[0] * y[1], 0.5 * y[0] * y[1] - 0.1 * y[1]],
    (0, 60),
    [0.99, 0.01],
    t_eval=T,
    rtol=1e-9,
    atol=1e-12,
).y


def epidemic(noise: float, seed: int = 0, every: int = 1) -> dict[str, np.ndarray]:
    """Give S and the total of S and I, the total at each so-manieth row alone."""
    rng = np.random.default_rng(seed)
    total = SUSCEPTIBLE + INFECTED
    table = {"t": T, "S": SUSCEPTIBLE + noise * SUSCEPTIBLE.std() * rng.normal(size=len(T))}
    total = total + noise * total.std() * rng.normal(size=len(T))
    total[np.arange(len(T)) % every != 0] = np.nan
    return {**table, "total": total}


def as_run(noise: float, seed: int = 0, every: int = 1) -> Trajectory:
    """Give the same as a run of S and I, of which I was not measured alone."""
    table = epidemic(noise, seed, every)
    columns = np.column_stack([table["S"], table["total"]])
    (read,) = read_sums([Trajectory(T, columns, ("S", "total"))], {"total": "S + I"})
    return read


def test_a_state_has_the_unit_of_its_sum():
    """Units of the columns are those of the states in their place, unless a factor is between."""
    table = epidemic(0.0)
    frame = {"t [d]": T, "S [g]": table["S"], "total [g]": table["total"], "F [N]": T**2}
    runs, _ = take_trajectories(frame, inputs=["F"])
    for text, more in (("S + I", {"I": "g"}), ("S + 1000*I", {})):
        (read,) = read_sums(runs, {"total": text})
        assert column_units(read, "columns") == {"t": "days", "S": "g", "F": "N", **more}


def test_a_state_takes_the_place_of_its_sum():
    """Its values are the sum less the other states; the sum itself stays with the run."""
    read = as_run(0.0)
    assert read.states == ("S", "I")
    assert read.x[:, 1] == pytest.approx(INFECTED, abs=1e-12)
    assert read.sums["I"].values == pytest.approx(SUSCEPTIBLE + INFECTED)
    assert dict(read.sums["I"].others) == {"S": 1.0}
    assert read.select(slice(0, 9)).sums["I"].values.shape == (9,)
    assert not read.of_states(["I"]).sums


def test_two_combinations_give_two_states_that_nobody_measured():
    """The half sum and the difference of x and y are solved for both, whatever their factors."""
    x, y = np.exp(-0.2 * T), np.cos(0.1 * T)
    mean_and_gap = Trajectory(T, np.column_stack([(x + y) / 2, x - y]), ("mean", "gap"))
    (read,) = read_sums([mean_and_gap], {"mean": "x/2 + y/2", "gap": "x - y"})
    assert set(read.states) == {"x", "y"}
    assert read.x[:, read.index("x")] == pytest.approx(x, abs=1e-12)
    assert read.x[:, read.index("y")] == pytest.approx(y, abs=1e-12)


@pytest.mark.parametrize("noise", [0.0, pytest.param(0.05, marks=pytest.mark.slow)])
def test_an_epidemic_is_found_from_those_who_may_fall_ill_and_a_total(noise):
    """S and S + I alone: the law of both, with the rates that were put in."""
    found = discover(epidemic(noise, 2), observed={"total": "S + I"}, jobs=1)
    assert set(found.equations) == {"S", "I"}
    assert found.verdict.level == "law"
    rates = sorted(found.parameters.numbers.values())
    assert rates == pytest.approx([0.1, 0.5], rel=max(noise, 1e-6))
    assert found.settings["observed"] == {"total": "S + I"}


@pytest.mark.slow
def test_a_sum_may_have_times_of_its_own():
    """The total at each fifth row: nothing is filled in, and I counts where the total does."""
    read = as_run(0.01, every=5)
    assert read.measured[:, 1].sum() == 25
    data = Measurements.of([read], {}, 2000)
    mesh = data.mesh(("S", "I"))
    assert mesh.rows.tolist() == [121.0, 25.0]
    fit = fit_along(LAW, data)
    assert sorted(np.abs(fit.constants)) == pytest.approx([0.1, 0.5, 0.5], rel=0.02)


@pytest.mark.slow
def test_what_is_fitted_is_the_sum_itself():
    """Of noise of S alone, the rows of I have as much and the sum has none: its weight shows it."""
    rng = np.random.default_rng(1)
    noisy = SUSCEPTIBLE + 0.03 * rng.normal(size=len(T))
    total = SUSCEPTIBLE + INFECTED + 0.001 * rng.normal(size=len(T))
    (read,) = read_sums(
        [Trajectory(T, np.column_stack([noisy, total]), ("S", "total"))], {"total": "S + I"}
    )
    data = Measurements.of([read], {}, 2000)
    alone, summed = np.median(data.deviations[0], axis=0)
    assert alone == pytest.approx(0.03, rel=0.3)
    assert summed == pytest.approx(0.001, rel=0.4)
    assert data.smoothed[0].noise[:, 1].mean() == pytest.approx(0.03, rel=0.3)


@pytest.mark.slow
def test_intervals_hold_the_truth_in_90_to_98_percent():
    """Over 40 draws, at 1 % and 5 % in turn; errors of a state and of its sum with another are not
    taken for one.
    """
    truth = np.array([-0.5, 0.5, -0.1])
    inside = []
    for seed in range(40):
        data = Measurements.of([as_run((0.01, 0.05)[seed % 2], seed)], {}, 2000)
        fit = fit_along(LAW, data)
        order = [float(c) for e in LAW.values() for c in e.atoms(sympy.Float)]
        assert sorted(order) == sorted(truth)
        near = truth[np.argmin(np.abs(fit.constants[:, None] - truth), axis=1)]
        inside += (np.abs(fit.constants - near) <= 1.98 * fit.errors).tolist()
    assert 0.90 <= np.mean(inside) <= 0.98


def test_known_errors_of_a_sum_are_those_of_the_sum():
    """`noise={"total": 0.1}` weighs the sum, and the state it gives has none that are known."""
    table = epidemic(0.05)
    columns = np.column_stack([table["S"], table["total"]])
    (given,) = carry([Trajectory(T, columns, ("S", "total"))])
    from dynsr.data import take_trajectories

    (known,), _ = take_trajectories(given, noise={"total": 0.1})
    (read,) = read_sums([known], {"total": "S + 2*I"})
    assert "I" not in read.noise
    assert read.sums["I"].noise.sd[0] == pytest.approx(0.05)
    units = MeasuredSum(np.ones(2), {"S": 0.5}).in_units(10.0, {"S": 2.0})
    assert units.values.tolist() == [0.1, 0.1] and units.others == {"S": 0.1}


@pytest.mark.slow
def test_the_shell_takes_sums(tmp_path):
    """`--observed "total=S+I"` searches S and I, and scores them on the same table."""
    pd.DataFrame(epidemic(0.0)).to_csv(tmp_path / "data.csv", index=False)
    words = ("--observed", "total=S+I", "--json", "-j", "1")
    answer = json.loads(run("discover", tmp_path / "data.csv", *words).stdout)
    assert set(answer["equations"]) == {"S", "I"}
    assert answer["scores"]["data"]["I"]["forecast"] < 1e-3


@pytest.mark.parametrize(
    ("observed", "said"),
    [
        ({"sum": "S + I"}, "observed names 'sum', which is no state column; those are: S, total"),
        ("total=S + I", "observed 'total=S . I' must map columns to sums of states, such as"),
        ({"total": "S*I"}, "'total' is 'S.I', which is no sum of states; give a linear"),
        ({"total": "S + I + 1"}, "is no sum of states"),
        ({"total": "2"}, "is no sum of states"),
        ({"total": "2*S"}, "every state of 'total' was measured alone .S.; leave the column out"),
        ({"total": "S + I + R"}, "I, R were not measured alone, and 1 column is a sum; give one"),
        ({"total": "S + t"}, "'total' cannot contain 't', which is no state"),
        ({"total": "S + total"}, "'total' cannot contain 'total'"),
        ({"S": "x + y", "total": "2*x + 2*y"}, "S, total do not determine x, y"),
    ],
)
def test_what_is_no_sum_is_refused_in_one_line(observed, said):
    """Unknown columns, products, offsets, and sums that leave a state open."""
    with pytest.raises(InputError, match=said):
        discover(epidemic(0.0), observed=observed)
