"""Measure bias and coverage of a rate constant where half of all rows are below a limit.

Drawn again and again is a decay with a true rate of 0.7. The cells below the limit are censored,
left out, or filled with the limit or half of it. Prints the table of the page on limits.
"""

import argparse

import numpy as np
import sympy
from scipy.stats import t as student

from dynsr.data import Trajectory, take_trajectories
from dynsr.fit import Measurements, fit_along

TIMES = np.linspace(0, 6, 61)
RATE = 0.7
LIMIT = float(np.exp(-RATE * 3))
WAYS = {"censored": np.nan, "left out": np.nan, "the limit": LIMIT, "half the limit": LIMIT / 2}


def fit(values: np.ndarray, way: str) -> tuple[float, bool]:
    """Fit the rate; gives it, and whether the true one is in the 95 % interval."""
    limits = {"x": LIMIT} if way == "censored" else None
    kept = values if way == "censored" else np.where(values <= LIMIT, WAYS[way], values)
    run = Trajectory(TIMES, kept[:, None], ("x",))
    runs, _ = take_trajectories(run, limits=limits)
    found = fit_along({"x": -0.65 * sympy.Symbol("x")}, Measurements.of(runs, {}, 2000))
    reach = student.ppf(0.975, found.freedom)
    rate = -float(found.constants[0])
    return rate, abs(rate - RATE) <= reach * found.errors[0]


def main() -> None:
    """Print a row for each size of the noise and each way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=200)
    draws = parser.parse_args().draws
    print("| noise | cells below the limit | mean rate | standard deviation | in the interval |")
    print("|---|---|---|---|---|")
    for noise in (0.001, 0.01, 0.05):
        for way in WAYS:
            found = []
            for seed in range(draws):
                chance = np.random.default_rng(seed).normal(size=len(TIMES))
                found.append(fit(np.exp(-RATE * TIMES) + noise * chance, way))
            rates, inside = map(np.array, zip(*found, strict=True))
            cells = f"{rates.mean():.4f} | {rates.std():.4f} | {100 * inside.mean():.1f} %"
            print(f"| {100 * noise:g} % | {way} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
