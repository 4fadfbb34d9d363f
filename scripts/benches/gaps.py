"""Empty cells: a fit of each state where it was measured, and a peer on the complete rows.

Predator and prey, drawn again and again: 15 % of the cells of the prey are empty, and the predator
was counted at every third row. dynsr takes the table as it is. pysindy stops at empty cells, so it
gets the rows without one, tuned as for the zoo. A draw counts where both equations have the true
terms and no others; the error is the median of those of its constants, as a share of the true ones.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from statistics import median

import numpy as np
from joblib import Parallel, delayed
from scipy.integrate import solve_ivp
from vary import Equations, errors_of, is_right

from dynsr.benchmarks.zoo.peers import answer_stlsq
from dynsr.data import Trajectory
from dynsr.discovery import discover
from dynsr.expression import compile_numpy, parse

TRUTH = {"x": parse("1.127*x - 0.413*x*y"), "y": parse("0.107*x*y - 0.387*y")}
TIMES = np.linspace(0, 20, 201)


def draw(noise: float, seed: int) -> Trajectory:
    """Give the table, with noise as a share of the spread."""
    rng, slope = np.random.default_rng(seed), compile_numpy(list(TRUTH.values()), list(TRUTH))
    start, ends = [10.0, 5.0], (0, TIMES[-1])
    x = solve_ivp(lambda _, x: slope(x), ends, start, t_eval=TIMES, rtol=1e-10, atol=1e-12).y.T
    x = x + noise * x.std(axis=0) * rng.standard_normal(x.shape)
    x[rng.random(len(x)) < 0.15, 0] = np.nan
    x[np.arange(len(x)) % 3 != 0, 1] = np.nan
    return Trajectory(TIMES, x, tuple(TRUTH))


def search_complete(run: Trajectory) -> Equations:
    """Search the rows without an empty cell by pysindy."""
    return answer_stlsq(run.select(np.flatnonzero(np.isfinite(run.x).all(axis=1)))).equations


WAYS: Mapping[str, Callable[[Trajectory], Equations]] = {
    "dynsr, all cells": lambda run: discover(run, jobs=1, progress=False).equations,
    "PySINDy, complete rows": search_complete,
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=-1, help="searches at a time")
    asked = parser.parse_args()
    print("| noise | search | both equations right | error of a constant (median) |")
    print("| ---: | :--- | ---: | ---: |")
    for noise in (0.0, 0.01, 0.05):
        for way, search in WAYS.items():
            found = Parallel(asked.jobs)(
                delayed(search)(draw(noise, seed)) for seed in range(asked.draws)
            )
            right = [own for own in found if is_right(own, TRUTH)]
            errors = [error for own in right for error in errors_of(own, TRUTH)]
            size = f"{100 * median(errors):.2g} %" if errors else ""
            print(f"| {noise:.0%} | {way} | {len(right)} of {len(found)} | {size} |", flush=True)


if __name__ == "__main__":
    main()
