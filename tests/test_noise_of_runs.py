"""The noise of several short runs is one size, unless the runs show that it differs."""

import numpy as np
import pytest
import sympy

from dynsr.data import Trajectory
from dynsr.fit import Measurements, fit_along

T = np.array([0, 0.083, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 10, 12, 16, 20, 24])
STARTS = 10 * (1 + 0.2 * np.arange(8))


def two_compartments(draw, noise=0.04):
    """Eight runs of p' = -p + 0.4 q, q' = 0.8 p - 0.4 q in closed form, with relative noise."""
    rng = np.random.default_rng(draw)
    values, vectors = np.linalg.eig(np.array([[-1.0, 0.4], [0.8, -0.4]]))
    parts = np.linalg.solve(vectors, [1.0, 0.0])
    curve = np.exp(np.outer(T, values)) * parts @ vectors.T
    sizes = np.broadcast_to(noise, len(STARTS))
    return [
        Trajectory(T, a * curve * (1 + rng.normal(scale=s, size=curve.shape)), ("p", "q"))
        for a, s in zip(STARTS, sizes, strict=True)
    ]


def relative_noise(data):
    """Give for each run the noise of p as a share of p."""
    return np.array([np.median(own.noise[:, 0] / own.x[:, 0]) for own in data.smoothed])


@pytest.mark.slow
def test_runs_of_few_rows_have_one_noise():
    """Sizes that differ by chance become nearly one; one that is five times others stays large."""
    alike = relative_noise(Measurements.of(two_compartments(100), {}, 10_000))
    assert np.ptp(alike) < 0.1 * np.mean(alike)
    sizes = np.where(np.arange(8) == 3, 0.1, 0.02)
    differing = relative_noise(Measurements.of(two_compartments(0, sizes), {}, 10_000))
    assert differing[3] > 2 * np.median(differing)


@pytest.mark.slow
def test_intervals_of_short_runs_hold_the_truth():
    """Of 30 draws, 120 intervals of 95 %, 90 to 99 % hold the constants."""
    p, q = sympy.symbols("p q")
    equations = {"p": -1.0 * p + 0.4 * q, "q": 0.8 * p - 0.4 * q}
    off = []
    for draw in range(100, 130):
        data = Measurements.of(two_compartments(draw), {}, 10_000)
        fit = fit_along(equations, data)
        off += list((fit.constants - fit.problem.constants) / fit.errors)
    assert 0.9 <= np.mean(np.abs(off) < 1.96) <= 0.99
    # Wald's errors are neither too small nor too large.
    assert 0.85 < np.std(off) < 1.12
