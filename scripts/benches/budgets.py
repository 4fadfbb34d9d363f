"""What a time budget really takes: ten systems of one to four states, exact and with noise.

    scripts/bench budgets --budgets 2 5 8 --systems lorenz pendulum

Libraries are loaded before anything is measured, as they are not counted against a budget. A row
with more than 1.1 times the budget and 1 s of processor time is marked.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

from dynsr import Trajectory, discover
from dynsr.expression import compile_numpy, parse

# Name -> right-hand sides, start, end in seconds, rows.
SYSTEMS: dict[str, tuple[dict[str, str], list[float], float, int]] = {
    "decay": ({"x": "-0.63*x + 0.4"}, [3.0], 6.0, 61),
    "allee": ({"n": "0.9*n*(1 - n/4.3)*(n/0.7 - 1)"}, [0.9], 6.0, 121),
    "pendulum": ({"q": "w", "w": "-2.7*sin(q) - 0.13*w"}, [2.1, 0.0], 15.0, 301),
    "oregon": ({"a": "1.1 - 3.7*a + a^2*b", "b": "2.7*a - a^2*b"}, [1.4, 2.3], 20.0, 401),
    "toggle": ({"u": "3.1/(1 + v^2) - u", "v": "2.7/(1 + u^3) - v"}, [0.4, 0.6], 10.0, 101),
    "prey": (
        {"r": "1.3*r - 0.7*r*f/(1 + 0.4*r)", "f": "0.5*r*f/(1 + 0.4*r) - 0.6*f"},
        [2, 1],
        25,
        251,
    ),
    "lorenz": (
        {"x": "9.3*(y - x)", "y": "x*(27.1 - z) - y", "z": "x*y - 2.4*z"},
        [1, 2, 20],
        10,
        801,
    ),
    "epidemic": (
        {"s": "-0.9*s*i", "i": "0.9*s*i - 0.3*i", "r": "0.3*i"},
        [0.99, 0.01, 0.0],
        30,
        121,
    ),
    "chain": (
        {
            "a": "-0.7*a/(0.3 + a)",
            "b": "0.7*a/(0.3 + a) - 0.4*b",
            "c": "0.4*b - 0.2*c",
            "d": "0.2*c",
        },
        [2.0, 0.1, 0.0, 0.0],
        20,
        201,
    ),
    "swings": (
        {"p": "v", "v": "-3.1*p + 0.9*(q - p)", "q": "w", "w": "-1.7*q + 0.9*(p - q)^3"},
        [1.0, 0.0, -0.4, 0.5],
        15,
        301,
    ),
}


def make(name: str, noise: float, seed: int) -> Trajectory:
    """Integrate one system and disturb its states by a share of their deviation."""
    texts, start, end, rows = SYSTEMS[name]
    law = {state: parse(text) for state, text in texts.items()}
    slope = compile_numpy(list(law.values()), list(law))
    t = np.linspace(0, end, rows)
    x = solve_ivp(lambda _, x: slope(x), (0, end), start, t_eval=t, rtol=1e-10, atol=1e-12).y.T
    rng = np.random.default_rng(seed)
    return Trajectory(t, x + noise * x.std(axis=0) * rng.normal(size=x.shape), tuple(law))


def spent() -> float:
    """Give the processor time of this process and of its children that have ended."""
    return sum(time.clock_gettime(clock) for clock in [time.CLOCK_PROCESS_CPUTIME_ID])


def main() -> None:
    """Print one row for every system, noise and budget."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--systems", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    parser.add_argument("--budgets", nargs="+", type=float, default=[2.0, 5.0, 8.0])
    parser.add_argument("--noise", nargs="+", type=float, default=[0.0, 0.03])
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    discover(make("prey", 0.0, 0), preset="quick", jobs=1)
    discover(make("decay", 0.05, 0), jobs=1)
    console = Console(width=160)
    table = Table("system", "noise", "budget", "processor", "wall", "late", "verdict", "ended")
    for name in asked.systems:
        for noise in asked.noise:
            run = make(name, noise, asked.seed)
            for budget in asked.budgets:
                wall, used = time.monotonic(), spent()
                found = discover(run, jobs=1, time_budget=budget)
                used, wall = spent() - used, time.monotonic() - wall
                table.add_row(
                    name,
                    f"{100 * noise:g} %",
                    f"{budget:g} s",
                    f"{used:.2f} s",
                    f"{wall:.2f} s",
                    "late" if used > 1.1 * budget + 1 else "",
                    found.verdict.level,
                    ", ".join(found.settings.get("ended_by_budget", ())),
                )
                console.print(name, noise, budget, f"{used:.2f} {wall:.2f}", style="dim")
    console.print(table)


if __name__ == "__main__":
    main()
