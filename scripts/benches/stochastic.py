"""Noise in the motion: how often the drift is found, and how often intervals hold the truth.

Paths of known stochastic systems (Euler and Maruyama, 20 steps a row), measured without error and
with one. A draw counts where every drift has the terms of the true one and no other.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from statistics import median

import numpy as np
import sympy
from joblib import Parallel, delayed
from rich.console import Console

from dynsr.data import Trajectory
from dynsr.discovery import Discovery, discover
from dynsr.expression import compile_columns, parse, skeleton
from dynsr.fit import loosen

_PARTS = 20


@dataclass(frozen=True)
class Case:
    """A stochastic system, its start, the length of its record and the rows."""

    drift: dict[str, str]
    diffusion: dict[str, str]
    start: tuple[float, ...]
    end: float
    rows: int

    def path(self, error: float, seed: int) -> Trajectory:
        """Draw a path, with errors of measurement as a share of the spread."""
        rng, states = np.random.default_rng(seed), list(self.drift)
        texts = [*self.drift.values(), *self.diffusion.values()]
        program = compile_columns([parse(text) for text in texts], states)
        t = np.linspace(0, self.end, self.rows)
        step, x, k = t[1] / _PARTS, np.array(self.start), len(states)
        rows = [x]
        for _ in range(self.rows - 1):
            for _ in range(_PARTS):
                found = program(*x[:, None])[:, 0]
                shaken = np.sqrt(step * np.maximum(found[k:], 0)) * rng.standard_normal(k)
                x = x + step * found[:k] + shaken
            rows.append(x)
        true = np.array(rows)
        noise = error * true.std(axis=0) * rng.standard_normal(true.shape)
        return Trajectory(t, true + noise, tuple(states))


CASES = {
    "Ornstein and Uhlenbeck": Case({"x": "-1.2*x"}, {"x": "0.5"}, (2.0,), 60.0, 1201),
    "double well": Case({"x": "1.1*x - 0.9*x^3"}, {"x": "0.5"}, (0.5,), 200.0, 4001),
    "growth": Case({"x": "0.9*x - 0.3*x^2"}, {"x": "0.04*x^2"}, (0.5,), 120.0, 2401),
    "prey and predator": Case(
        {"x": "1.1*x - 0.5*x*y", "y": "0.4*x*y - 0.8*y"},
        {"x": "0.002*x^2", "y": "0.002*y^2"},
        (2.0, 1.0),
        30.0,
        901,
    ),
    "van der Pol": Case(
        {"x": "v", "v": "0.9*v - 1.1*x^2*v - 1.2*x"}, {"x": "0", "v": "0.1"}, (1.0, 0.0), 40.0, 1201
    ),
    "FitzHugh and Nagumo": Case(
        {"v": "1.1*v - 0.35*v^3 - 0.9*w + 0.45", "w": "0.08*v - 0.06*w + 0.05"},
        {"v": "0.02", "w": "0.001"},
        (-1.0, -0.5),
        100.0,
        2001,
    ),
}


def count_held(found: Discovery, case: Case) -> tuple[int, int]:
    """Give how many intervals of constants hold the true value, and how many there are."""
    held = whole = 0
    for state, text in case.drift.items():
        truth = {t.as_coeff_Mul()[1]: float(t.as_coeff_Mul()[0]) for t in terms_of(parse(text))}
        for term in terms_of(found.equations[state]):
            value, body = term.as_coeff_Mul()
            for own in found.constants[state]:
                if np.isclose(own.value, float(value)) and own.low is not None:
                    held += own.low <= truth[body] <= (own.high or np.inf)
                    whole += 1
    for state, own in found.diffusion.items():
        wanted = sympy.Add.make_args(parse(case.diffusion[state]))
        if len(own.terms) == len(wanted) == 1 and own.terms[0].low is not None:
            value, body = wanted[0].as_coeff_Mul()
            if str(body) == own.terms[0].body:
                held += own.terms[0].low <= float(value) <= (own.terms[0].high or np.inf)
                whole += 1
    return held, whole


def terms_of(expr: sympy.Expr) -> tuple[sympy.Expr, ...]:
    """Give the terms of a sum."""
    return sympy.Add.make_args(sympy.expand(expr))


def run(name: str, error: float, seed: int) -> tuple[bool, str, float, int, int]:
    """Search one path: right terms, verdict, processor seconds, intervals that hold, and all."""
    case, began = CASES[name], time.process_time()
    found = discover(case.path(error, seed), jobs=1, progress=False, stochastic=True)
    seconds = time.process_time() - began
    right = all(
        skeleton(loosen(sympy.expand(found.equations[s]))) == skeleton(loosen(parse(e)))
        for s, e in case.drift.items()
    )
    held = count_held(found, case) if right else (0, 0)
    return right, found.verdict.level, seconds, *held


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20, help="paths of each system")
    parser.add_argument("--errors", default="0,0.02", help="errors of measurement, by commas")
    parser.add_argument("--seed", type=int, default=0, help="that of the first path")
    parser.add_argument("--jobs", type=int, default=-1, help="searches at a time")
    asked = parser.parse_args()
    console = Console(width=200)
    console.print(
        "| system | rows | errors | drift found | law said | of these right | intervals hold | s |"
    )
    console.print("|---|---|---|---|---|---|---|---|")
    for name, case in CASES.items():
        for error in map(float, asked.errors.split(",")):
            seeds = range(asked.seed, asked.seed + asked.draws)
            rows = Parallel(asked.jobs)(delayed(run)(name, error, seed) for seed in seeds)
            laws = [right for right, level, *_ in rows if level == "law"]
            held, whole = (sum(row[i] for row in rows) for i in (3, 4))
            cells = (
                name,
                case.rows,
                f"{error:.0%}",
                f"{sum(row[0] for row in rows)} of {len(rows)}",
                len(laws),
                sum(laws),
                f"{held} of {whole}",
                f"{median(row[2] for row in rows):.1f}",
            )
            console.print(f"| {' | '.join(map(str, cells))} |")


if __name__ == "__main__":
    main()
