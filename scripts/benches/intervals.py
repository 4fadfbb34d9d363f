"""How often intervals of 95 % hold the truth: constants fitted to noisy draws of known systems.

    scripts/bench intervals --draws 50 --systems logistic lotka-volterra --rows 100 500

Each draw disturbs the exact states anew; the right-hand side has its true form. Beside the share
stands the deviation of (fitted - true) / standard error, which is 1 for honest errors.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

from dynsr.data.trajectory import Trajectory
from dynsr.expression import compile_numpy
from dynsr.expression.parsing import parse
from dynsr.fit.shooting import prepare
from dynsr.fit.whole import fit_states, interval_reach

# System -> right-hand sides, start, end in seconds.
SYSTEMS: dict[str, tuple[dict[str, str], list[float], float]] = {
    "lotka-volterra": (
        {"x": "1.37*x - 0.83*x*y", "y": "0.91*x*y - 2.63*y"},
        [1.0, 1.0],
        10.0,
    ),
    "oscillator": ({"x": "1.0*v", "v": "-2.3*x - 0.17*v"}, [1.0, 0.0], 12.0),
    "logistic": ({"x": "0.73*x - 0.31*x^2"}, [0.1], 12.0),
}
# Kind of noise, and its share: of the state's deviation, or of the value itself.
NOISE = (("additive", 0.01), ("additive", 0.05), ("multiplicative", 0.05))


def scores(name: str, rows: int, kind: str, share: float, draws: int) -> Iterator[np.ndarray]:
    """Give (fitted - true) / reach of the interval, and / standard error, of every draw's fit."""
    texts, start, end = SYSTEMS[name]
    law = {state: parse(text) for state, text in texts.items()}
    slope = compile_numpy(list(law.values()), list(law))
    t = np.linspace(0, end, rows)
    exact = solve_ivp(lambda _, x: slope(x), (0, end), start, t_eval=t, rtol=1e-10, atol=1e-12).y.T
    size = share * (np.abs(exact) if kind == "multiplicative" else exact.std(axis=0))
    rng = np.random.default_rng(0)
    for _ in range(draws):
        run = Trajectory(t, exact + size * rng.normal(size=exact.shape), tuple(law))
        fit = fit_states(law, [run], {})
        if fit is not None:
            truth = np.array(prepare(law, [run], {})[1])
            z = (fit.constants - truth) / fit.errors
            yield np.array([z / interval_reach(fit.freedom), z])


def main() -> None:
    """Print one row for every system, number of rows and noise."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--systems", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    parser.add_argument("--rows", nargs="+", type=int, default=[100, 500])
    asked = parser.parse_args()
    table = Table("system", "rows", "noise", "intervals", "hold the truth", "deviation", "seconds")
    for name in asked.systems:
        for rows in asked.rows:
            for kind, share in NOISE:
                began = time.monotonic()
                found = np.array(list(scores(name, rows, kind, share, asked.draws)))
                inside, z = np.abs(found[:, 0]) <= 1, found[:, 1]
                table.add_row(
                    name,
                    str(rows),
                    f"{kind} {100 * share:g} %",
                    str(inside.size),
                    f"{100 * np.mean(inside):.1f} %",
                    f"{np.std(z):.2f}",
                    f"{(time.monotonic() - began) / asked.draws:.2f} a draw",
                )
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
