"""Measurement errors that the user, or a column of the data, says."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import sympy
from scipy.stats import binom

from dynsr import InputError, Trajectory, discover
from dynsr.data import (
    KnownNoise,
    carry,
    describe,
    estimate_noise,
    measurement_noise,
    read_trajectories,
    smooth,
    take_trajectories,
)
from dynsr.fit import Measurements, fit_along, residual_bits
from dynsr.verdict.flow_verdict import give_verdict
from tests.command_line import run

X = sympy.Symbol("x")
DECAY = {"x": -0.5 * X}
T = np.linspace(0, 6, 121)
TRUE = 4 * np.exp(-0.5 * T)
# A sensor that is ten times worse in the first half.
UNEVEN = np.where(T < 3, 0.2, 0.02)


def decay(sd: np.ndarray | float, seed: int = 0) -> np.ndarray:
    """Give a decay with errors of known size."""
    return TRUE + np.random.default_rng(seed).normal(0, 1, len(T)) * sd


def known(sd: np.ndarray | float, said: KnownNoise, seed: int = 0) -> Trajectory:
    """Give a run of it whose errors are said."""
    return Trajectory(T, decay(sd, seed)[:, None], ("x",), noise={"x": said})


def test_errors_are_said_in_four_ways():
    """A number, a share, a column, one value a row: each run has them at its own rows."""
    table = {"t": T, "x": decay(0.1), "y": decay(0.1, 1), "x_sd": UNEVEN}
    said = {"x": "x_sd", "y": "5 %"}
    (run,), _ = take_trajectories(table, noise=said)
    assert run.states == ("x", "y")
    assert np.array_equal(run.noise["x"].sd, UNEVEN) and run.noise["x"].sure
    assert np.allclose(run.noise["y"].at(TRUE), 0.05 * TRUE)
    assert run.origin["said_noise"] == said
    part = run.select(slice(50, 70)).of_states(["x"])
    assert np.array_equal(part.noise["x"].sd, UNEVEN[50:70])
    (plain,), _ = take_trajectories((T, decay(0.1)), noise={"x": 0.1})
    assert np.array_equal(plain.noise["x"].sd, np.full(121, 0.1))
    runs, _ = take_trajectories([(T, decay(0.1))] * 2, noise={"x": [UNEVEN, 2 * UNEVEN]})
    assert np.array_equal(runs[1].noise["x"].sd, 2 * UNEVEN)
    beside = Trajectory(T, decay(0.1)[:, None], ("x",), UNEVEN[:, None], ("err",))
    (run,), _ = take_trajectories(beside, noise={"x": "err"})
    assert run.input_names == () and np.array_equal(run.noise["x"].sd, UNEVEN)


def test_what_is_said_of_errors_replaces_their_column():
    """The description does not name a column that is not used, by either name of the state."""
    t = np.linspace(0, 1, 11)
    table = {"t": t, "x (g)": t**2, "x_sd": 0 * t + 0.1, "y": t**3, "y_sd": 0 * t + 0.2}
    for name in ("x (g)", "x"):
        read = read_trajectories(table, noise={name: "5 %"})
        assert read.description.noise == {"y": "y_sd"} and "not used" in read.left_out["x_sd"]
        assert read.trajectories[0].noise["x"].share == 0.05


def test_a_column_of_errors_says_how_rows_differ():
    """x_sd beside x weighs the rows; only where it is named is its size believed."""
    table = pd.DataFrame({"t": T, "x": decay(UNEVEN), "x_sd": UNEVEN})
    (run,) = read_trajectories(table).trajectories
    assert run.states == ("x",) and not run.noise["x"].sure
    assert read_trajectories(table, noise={"x": "x_sd"}).trajectories[0].noise["x"].sure
    (named,) = read_trajectories(table, states=["x"]).trajectories
    assert np.array_equal(named.noise["x"].sd, UNEVEN)
    assert describe(table, noise={"x": "x_sd"}).noise == {"x": "x_sd"}
    # A row without an error has the usual one; a column without any says nothing.
    holes = table.assign(x_sd=np.where(T < 1, 0.0, UNEVEN))
    (run,) = read_trajectories(holes).trajectories
    assert np.allclose(run.noise["x"].sd[T < 1], np.sqrt(np.mean(UNEVEN[T >= 1] ** 2)))
    (run,) = read_trajectories(table.assign(x_sd=0.0, y=decay(0.1))).trajectories
    assert "x" not in run.noise


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        ({"z": 0.1}, "noise names 'z', which is no state; the states are: x"),
        ({"x": 0.0}, "give a standard deviation above 0"),
        ({"x": -1}, "give a standard deviation above 0"),
        ({"x": "nan"}, "give a standard deviation above 0"),
        ({"x": "-5 %"}, "the noise of 'x' is '-5 %'; give a standard deviation above 0"),
        ({"x": "much"}, "'much' for the noise"),
        ({"x": np.ones(3)}, r"has shape \(3,\) but there are 121 rows"),
    ],
)
def test_errors_that_cannot_be_are_refused(noise, said):
    """One line names the value and the remedy."""
    with pytest.raises(InputError, match=said):
        discover({"t": T, "x": decay(0.1)}, noise=noise, jobs=1)


def test_noise_that_is_known_is_not_estimated():
    """Estimates, curves and weights have the errors as they were said, whatever the rows show."""
    run = known(0.1, KnownNoise(2 * UNEVEN))
    assert np.allclose(smooth(run, estimate_noise([run])).noise[:, 0], 2 * UNEVEN)
    assert np.isclose(measurement_noise(run)[0], np.sqrt(np.mean((2 * UNEVEN) ** 2)))
    share = known(0.05 * TRUE, KnownNoise(np.zeros(121), 0.05))
    found = smooth(share, estimate_noise([share]))
    assert np.allclose(found.noise[:, 0], 0.05 * found.x[:, 0])
    assert np.sqrt(np.mean((found.x[:, 0] - TRUE) ** 2)) < 0.05


def test_a_size_that_is_not_sure_is_found():
    """Errors that only say how rows differ come out at their true size, here twice that."""
    run = known(UNEVEN, KnownNoise(UNEVEN / 2, sure=False), 3)
    ratio = smooth(run, estimate_noise([run])).noise[:, 0] / UNEVEN
    assert np.ptp(ratio) < 1e-9 and 0.75 < ratio[0] < 1.3


def test_errors_of_constants_are_those_of_the_noise():
    """Standard errors are those of the linear problem at the noise said, and go with it."""
    runs = [known(UNEVEN, KnownNoise(factor * UNEVEN)) for factor in (1.0, 2.0)]
    one, two = (fit_along(DECAY, Measurements.of([run], {}, 2000)) for run in runs)
    assert np.isclose(two.errors[0], 2 * one.errors[0], rtol=1e-2)
    # x = a exp(-k t), at the true values.
    slopes = np.column_stack([np.exp(-0.5 * T), -T * TRUE]) / UNEVEN[:, None]
    exact = np.sqrt(np.linalg.inv(slopes.T @ slopes)[1, 1])
    assert np.isclose(one.errors[0], exact, rtol=0.03)
    guess = fit_along(DECAY, Measurements.of([Trajectory(T, runs[0].x, ("x",))], {}, 2000))
    assert guess.errors[0] > 1.2 * one.errors[0]


def test_bits_of_known_noise_are_those_of_its_likelihood():
    """Twice the noise in n rows costs 3 n / (2 ln 2) bits, and n where the noise is estimated."""
    rows = np.array([100.0])

    def bits(square: float, said: bool) -> float:
        return residual_bits(np.array([square]), rows, known=said)

    assert np.isclose(bits(4.0, True) - bits(1.0, True), 3 * 100 / (2 * np.log(2)))
    assert np.isclose(bits(4.0, False) - bits(1.0, False), 100)
    assert bits(1.0, True) == bits(1.0, False)


@pytest.mark.parametrize(("said", "level"), [(1.0, "law"), (0.2, "approximation")])
def test_a_verdict_goes_by_what_was_said(said, level):
    """Misses five times as large as the errors said are not noise."""
    x = decay(0.1)
    verdict = give_verdict(DECAY, [Trajectory(T, x[:, None], ("x",), noise={"x": _sd(said * 0.1)})])
    assert verdict.level == level
    expected = np.mean((x - TRUE) ** 2) / (said * 0.1) ** 2
    assert np.isclose(verdict.states["x"].chi_square, expected, rtol=0.1)


def _sd(size: float) -> KnownNoise:
    return KnownNoise(np.full(len(T), size))


@pytest.mark.slow
def test_a_search_takes_what_is_known():
    """The law, its intervals and the record, in data of huge numbers."""
    scale = 1e9
    data = {"t": T, "x": scale * decay(UNEVEN, 5), "err": scale * UNEVEN}
    found = discover(data, noise={"x": "err"}, jobs=1)
    (value, error) = found.errors["x"][0]
    assert set(found.equations) == {"x"} and abs(value + 0.5) < 4 * error < 0.05
    assert found.settings["said_noise"] == {"x": "err"}
    assert np.allclose(found.trajectories[0].noise["x"].sd, scale * UNEVEN)


def test_errors_are_known_where_something_was_measured():
    """Empty cells and known errors go together."""
    run = known(UNEVEN, KnownNoise(UNEVEN))
    x = run.x.copy()
    x[::3] = np.nan
    runs = carry([Trajectory(T, x, ("x",), noise=run.noise)])
    noise = Measurements.of(runs, {}, 2000).smoothed[0].noise[:, 0]
    assert np.isinf(noise[::3]).all() and np.allclose(noise[1::3], UNEVEN[1::3])


@pytest.mark.slow
@pytest.mark.parametrize("sd", [0.05 * TRUE, UNEVEN], ids=["5 %", "uneven"])
def test_intervals_hold_the_truth_where_noise_is_known(sd):
    """95 % intervals from 10 rows of known errors hold the truth in 90 to 98 % of draws."""
    draws, rows, held = 120, slice(None, None, 12), 0
    for seed in range(draws):
        run = known(sd, KnownNoise(sd), seed).select(rows)
        fit = fit_along(DECAY, Measurements.of([run], {}, 2000))
        held += bool(abs(fit.constants[0] + 0.5) <= 1.96 * fit.errors[0])
    low, high = binom.ppf([0.01, 0.99], draws, [0.90, 0.98])
    assert low <= held <= high


def test_the_shell_takes_known_noise(tmp_path):
    """--noise x=0.1,y=5%,z=z_sd; what is no such pair is refused in one line."""
    path = tmp_path / "decay.csv"
    pd.DataFrame({"t": T, "x": decay(0.1), "err": 0.1}).to_csv(path, index=False)
    assert "of x: 'err'" in run("describe", path, "--noise", "x=err").output
    wrong = run("describe", path, "--noise", "x", code=2).output
    assert "--noise 'x' must be a state and its errors" in wrong


def test_a_share_of_zero_is_no_noise_of_zero():
    """1 % of a cell 0.00 is what its last digit hides."""
    t = np.arange(8.0)
    x = np.round(5 * np.exp(-t), 2)
    runs, _ = take_trajectories({"t": t, "x": x}, noise={"x": "1 %"})
    assert runs[0].noise["x"].select(slice(2)).at(np.array([0.0, 5.0])) == pytest.approx(
        [0.01 / np.sqrt(12), np.hypot(0.05, 0.01 / np.sqrt(12))]
    )
