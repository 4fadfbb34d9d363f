"""Censored cells: a state that was only seen to be below, or above, a limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy
from scipy.optimize import approx_fprime, minimize
from scipy.special import log_ndtr
from scipy.stats import norm, truncnorm

from dynsr import InputError, Trajectory
from dynsr.data import (
    KnownNoise,
    Limits,
    carry,
    read_kept,
    read_sums,
    take_trajectories,
    write_kept,
)
from dynsr.fit import Measurements, fit_along
from dynsr.fit.censored import Censored, deviance, residual, residual_slope, steepness

X = sympy.Symbol("x")
T = np.linspace(0, 6, 61)
TRUE = np.exp(-0.7 * T)
LIMIT = float(np.exp(-0.7 * 3))


def decay(noise: float, seed: int = 0, how: str = "limit") -> Trajectory:
    """Give a decay, whose cells below a limit are censored, left out, or filled with a number."""
    y = TRUE + noise * np.random.default_rng(seed).normal(size=len(T))
    low = y < LIMIT
    x = np.where(low, {"half": LIMIT / 2, "at it": LIMIT}.get(how, np.nan), y)
    none = np.full(len(T), np.nan)
    limits = {"x": Limits(np.where(low, LIMIT, np.nan), none)} if how == "limit" else {}
    return Trajectory(T, x[:, None], ("x",), limits=limits)


def fit(run: Trajectory, rate: float = -0.65):
    """Fit the rate of the decay."""
    return fit_along({"x": rate * X}, Measurements.of([run], {}, 2000))


def test_the_likelihood_is_that_of_a_normal_measurement_beyond_its_limit():
    """Deviance, slopes and curvature agree with SciPy's normal distribution, far out too."""
    z = np.linspace(-30, 9, 79)
    assert np.allclose(deviance(z), -2 * norm.logcdf(z), rtol=1e-12)
    assert np.allclose(steepness(z), np.exp(norm.logpdf(z) - norm.logcdf(z)), rtol=1e-9)
    assert np.allclose(residual(z) ** 2, deviance(z))
    small = z[(z > -5) & (z < 5)]
    slopes = (residual(small - 1e-5) - residual(small + 1e-5)) / 2e-5
    assert np.allclose(residual_slope(small), slopes, rtol=1e-5)
    assert residual_slope(np.array([1e3])) == 0 and deviance(np.array([1e3])) == 0
    assert np.isclose(deviance(np.array([-1e8]))[0], 1e16)
    # The curvature is 1 less the variance of what is beyond the limit.
    for place, side in ((z, 1.0), (z, -1.0)):
        cells = Censored((np.zeros(79, int), np.arange(79)), place, np.full(79, side))
        bend, pull, total = cells.terms(np.zeros((1, 79)))
        inner = side * place
        variance = truncnorm.var(-np.inf, inner)
        assert np.allclose(bend, 1 - variance, atol=1e-6)
        assert np.allclose(pull, side * steepness(inner)) and np.isclose(
            total, deviance(inner).sum()
        )
        assert np.all(np.sign(cells.residuals(np.zeros((1, 79)))) == side)
    far = Censored((np.zeros(3, int), np.arange(3)), -np.array([1e3, 1e6, 1e9]), np.ones(3))
    bend, pull, _ = far.terms(np.zeros((1, 3)))
    assert np.allclose(bend, 1) and np.allclose(pull, [1e3, 1e6, 1e9])


def test_limits_go_with_their_rows_and_units():
    """Rows that are taken, other units and other states: limits are those of their cells."""
    run = decay(0.01)
    there = run.limits["x"].there
    assert there.sum() == np.isnan(run.x).sum() > 25
    part = run.select(slice(20, 40))
    assert np.array_equal(part.limits["x"].there, there[20:40])
    other = run.limits["x"].in_units(2.0)
    assert np.allclose(other.below[there], LIMIT / 2)
    turned = run.limits["x"].in_units(-1.0)
    assert np.allclose(turned.above[there], -LIMIT) and np.isnan(turned.below).all()
    # A cell that was measured has no limit, and limits of other columns go.
    full = Trajectory(T, TRUE[:, None], ("x",), limits=run.limits)
    assert full.limits == {} and replace(run, states=("y",)).limits == {}
    # Rows in which nothing else is known are kept where rows are thinned.
    assert np.isin(np.flatnonzero(there)[::4], run.every(4)).all()
    with pytest.raises(InputError, match=r"limits \(3,\) of 'x' do not fit 61 rows"):
        Trajectory(T, run.x, ("x",), limits={"x": Limits(np.ones(3), np.ones(3))})
    (carried,) = carry([run])
    assert np.all(carried.x[there, 0] <= LIMIT)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_fit_is_that_of_the_whole_likelihood(sign):
    """With known noise, rate, error and cost are those of SciPy on the closed form; turned, too."""
    noise = 0.05
    run = decay(noise, 3)
    limits = run.limits["x"]
    said = KnownNoise(np.full(len(T), noise))
    turned = replace(run, x=sign * run.x, limits={"x": limits.in_units(sign)}, noise={"x": said})
    found = fit(turned)
    low = limits.there

    def cost(p):
        x = p[0] * np.exp(p[1] * T)
        z = (x - run.x[:, 0])[~low] / noise
        return np.sum(z**2) / 2 - np.sum(log_ndtr((LIMIT - x[low]) / noise))

    best = minimize(
        cost, [1.0, -0.7], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12}
    )
    step = 1e-4
    second = np.array(
        [
            (approx_fprime(best.x + d, cost, 1e-6) - approx_fprime(best.x - d, cost, 1e-6))
            / (2 * step)
            for d in step * np.eye(2)
        ]
    )
    assert found.constants[0] == pytest.approx(best.x[1], abs=2e-4)
    assert found.errors[0] == pytest.approx(np.sqrt(np.linalg.inv(second)[1, 1]), rel=0.02)
    assert found.found.squares == pytest.approx(2 * best.fun, rel=1e-3)
    assert found.problem.mesh.rows[0] == np.sum(~low)


@pytest.mark.slow
def test_censored_cells_take_the_bias_away():
    """Half of all rows below the limit: bias and intervals against the ways in which it is done."""
    off, held = {}, {}
    for how in ("limit", "out", "half", "at it"):
        found = [fit(decay(0.05, seed, how)) for seed in range(24)]
        rates = np.array([own.constants[0] for own in found])
        off[how] = abs(np.mean(rates) + 0.7)
        held[how] = np.mean([abs(own.constants[0] + 0.7) < 2 * own.errors[0] for own in found])
    assert off["limit"] < 0.02 < 0.5 * min(off["out"], off["half"], off["at it"]) + 0.01
    assert held["limit"] >= 0.85 > max(held["out"], held["half"], held["at it"])


def test_clean_and_almost_clean_decays_have_their_rate():
    """With noise of 1 % and less the rate is right, and censored cells do no harm."""
    assert fit(decay(1e-4)).constants[0] == pytest.approx(-0.7, abs=5e-4)
    rates = [fit(decay(0.01, seed)).constants[0] for seed in range(12)]
    assert np.mean(rates) == pytest.approx(-0.7, abs=0.006)


@pytest.mark.slow
def test_the_noise_is_that_of_measured_rows():
    """The fit finds the noise that was put in, although rows near the limit show too little."""
    shown = []
    for seed in range(12):
        weights = fit(decay(0.05, seed)).problem.mesh.weights
        shown.append(1 / np.median(weights[weights > 0]))
    assert np.median(shown) == pytest.approx(0.05, rel=0.2)


def test_limits_are_kept_joined_and_turned_into_those_of_sums():
    """A saved table, two sources of one experiment and a sum of states have the same limits."""
    run = decay(0.01)
    text, kept = write_kept([run])
    (again,) = read_kept(text.encode(), kept)
    assert np.array_equal(again.limits["x"].below, run.limits["x"].below, equal_nan=True)
    assert np.isnan(again.limits["x"].above).all()
    fast = Trajectory(np.linspace(0, 6, 121), np.ones((121, 1)), ("y",))
    (joined,) = take_trajectories([fast, run])[0]
    there = joined.limits["x"].there
    assert np.array_equal(joined.t[there], run.t[run.limits["x"].there])
    both = Trajectory(T, np.column_stack([run.x[:, 0], TRUE]), ("total", "y"), limits=both_of(run))
    (summed,) = read_sums([both], {"total": "y - 2*z"})
    low = run.limits["x"].there
    assert np.allclose(summed.limits["z"].above[low], -LIMIT / 2)
    assert np.isnan(summed.limits["z"].below).all()


def both_of(run: Trajectory) -> dict[str, Limits]:
    """Give the limits of x to the column total."""
    return {"total": run.limits["x"]}


def test_a_sum_below_its_limit_counts_in_the_fit():
    """A fit of x + y below a limit has no greater cost than what the truth has, and its rates."""
    truth = np.column_stack([np.exp(-0.7 * T), 0.5 * np.exp(-0.2 * T)])
    noisy = truth + 0.01 * np.random.default_rng(0).normal(size=truth.shape)
    total = noisy[:, 0] + truth[:, 1]
    low = total < 0.4
    limits = {"total": Limits(np.where(low, 0.4, np.nan), np.full(len(T), np.nan))}
    x = np.column_stack([np.where(low, np.nan, total), noisy[:, 1]])
    runs = read_sums([Trajectory(T, x, ("total", "y"), limits=limits)], {"total": "x + y"})
    found = fit_along({"x": -0.5 * X, "y": -0.3 * sympy.Symbol("y")}, Measurements.of(runs, {}, 99))
    assert found.constants == pytest.approx([-0.7, -0.2], abs=0.02)
    assert len(found.found.censored) == low.sum() > 15
    assert np.all(np.abs(found.found.censored) < 3)


def test_rows_of_a_mesh_take_their_cells_along():
    """The cells of some rows are those of a mesh of these rows alone, run by run."""
    runs = [replace(decay(0.02, seed), origin={"run": seed}) for seed in range(3)]
    mesh = Measurements.of(runs, {}, 2000).mesh(("x",))
    cells, n = mesh.censored, len(mesh.t)
    assert len(cells.limits) == sum(np.isnan(run.x).sum() for run in runs)
    states, rows = cells.places
    assert np.all(mesh.weights[rows, states] == 0) and np.all(cells.sure > 0)
    kept = np.arange(n) >= n // 3
    some = cells.at(kept)
    assert np.array_equal(mesh.t[kept][some.places[1]], mesh.t[rows[kept[rows]]])
    assert cells.at(np.zeros(n, dtype=bool)) is None
    double = mesh.with_noise(np.array([2.0]))
    assert np.allclose(2 * double.censored.sure, cells.sure)
    assert np.allclose(2 * double.weights, mesh.weights)
