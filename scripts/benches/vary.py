"""Runs that differ: one fit of all runs, compared with a search of each run alone.

Known systems whose constants differ from run to run, drawn again and again. dynsr searches all runs
at once (vary=True), and each run alone. pysindy has no constants that differ, so that it searches
each run alone, tuned as for the zoo. A run counts where every equation has the true terms and no
others; the error is the median of those of its constants, as a share of the true ones.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
import sympy
from joblib import Parallel, delayed
from rich.console import Console
from scipy.integrate import solve_ivp

from dynsr.benchmarks.zoo.peers import answer_stlsq
from dynsr.data import Trajectory
from dynsr.discovery import discover
from dynsr.expression import compile_columns, parse, skeleton
from dynsr.fit import loosen

Equations = Mapping[str, sympy.Expr]


@dataclass(frozen=True)
class Case:
    """A law with constants a and b that differ, their values in each run, its start and rows."""

    law: dict[str, str]
    values: tuple[dict[str, float], ...]
    start: tuple[float, ...]
    end: float
    rows: int

    def truth(self, run: int) -> dict[str, sympy.Expr]:
        """Give the equations of one run."""
        return {s: parse(text).subs(self.values[run]) for s, text in self.law.items()}

    def runs(self, noise: float, seed: int) -> list[Trajectory]:
        """Draw all runs, with noise as a share of the spread."""
        rng, found = np.random.default_rng(seed), []
        t = np.linspace(0, self.end, self.rows)
        for run in range(len(self.values)):
            slope = compile_columns(list(self.truth(run).values()), list(self.law))
            start = np.array(self.start) * rng.uniform(0.8, 1.2, len(self.start))
            x = solve_ivp(
                lambda _, x, slope=slope: slope.at(*x),
                (0, self.end),
                start,
                t_eval=t,
                rtol=1e-10,
                atol=1e-12,
            ).y.T
            x = x + noise * x.std(axis=0) * rng.standard_normal(x.shape)
            found.append(Trajectory(t, x, tuple(self.law)))
        return found


CASES = {
    "growth, both constants differ": Case(
        {"x": "a*x - b*x^2"},
        tuple(
            {"a": a, "b": b}
            for a, b in ((0.713, 0.107), (0.886, 0.293), (1.117, 0.154), (1.328, 0.409))
        ),
        (0.4,),
        10.0,
        40,
    ),
    "prey and predator, one of four differs": Case(
        {"x": "1.127*x - 0.413*x*y", "y": "0.287*x*y - a*y"},
        tuple({"a": a} for a in (0.617, 0.823, 1.043, 1.291)),
        (3.0, 1.5),
        15.0,
        80,
    ),
    "van der Pol, one of three differs": Case(
        {"x": "1.173*v", "v": "a*v - 0.817*x^2*v - 0.924*x"},
        tuple({"a": a} for a in (0.327, 0.719, 1.184, 1.613)),
        (1.0, 0.5),
        15.0,
        80,
    ),
}


def search_all(runs: Sequence[Trajectory]) -> list[Equations]:
    """Search all runs at once."""
    found = discover(runs, vary=True, jobs=1, progress=False)
    if not found.by_run.constants:
        return [found.equations] * len(runs)
    return [found.for_run(i).equations for i in range(len(runs))]


def search_each(runs: Sequence[Trajectory]) -> list[Equations]:
    """Search each run alone."""
    return [discover(run, jobs=1, progress=False).equations for run in runs]


def search_peer(runs: Sequence[Trajectory]) -> list[Equations]:
    """Search each run alone by pysindy."""
    return [answer_stlsq(run).equations for run in runs]


WAYS: Mapping[str, Callable[[Sequence[Trajectory]], list[Equations]]] = {
    "dynsr, all runs at once": search_all,
    "dynsr, each run alone": search_each,
    "pysindy, each run alone": search_peer,
}


def terms_of(expr: sympy.Expr) -> dict[sympy.Expr, float]:
    """Give the terms of a sum: what stands behind a number, and the number."""
    pairs = (t.as_coeff_Mul()[::-1] for t in sympy.Add.make_args(sympy.expand(expr)))
    return {body: float(number) for body, number in pairs}


def is_right(found: Equations, truth: Equations) -> bool:
    """Whether all equations have the true terms and no others."""
    return all(
        s in found
        and skeleton(loosen(sympy.expand(found[s]))) == skeleton(loosen(sympy.expand(own)))
        for s, own in truth.items()
    )


def errors_of(found: Equations, truth: Equations) -> list[float]:
    """Give the errors of all constants, as shares of the true ones."""
    given = [(terms_of(found[s]), terms_of(own)) for s, own in truth.items()]
    return [abs(own[body] / value - 1) for own, true in given for body, value in true.items()]


def run(name: str, way: str, noise: float, seed: int) -> tuple[list[bool], list[float], float]:
    """Search one draw: which runs are right, the errors of their constants, processor seconds."""
    case = CASES[name]
    runs, began = case.runs(noise, seed), time.process_time()
    found = WAYS[way](runs)
    seconds = time.process_time() - began
    pairs = [(own, case.truth(i)) for i, own in enumerate(found)]
    right = [is_right(*pair) for pair in pairs]
    errors = [e for fine, pair in zip(right, pairs, strict=True) if fine for e in errors_of(*pair)]
    return right, errors, seconds


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=10, help="draws of each system")
    parser.add_argument("--noise", default="0,0.01,0.05", help="shares of the spread, by commas")
    parser.add_argument("--jobs", type=int, default=-1, help="searches at a time")
    asked = parser.parse_args()
    console = Console(width=200)
    console.print(
        "| system | noise | search | laws, all runs right | runs right | error of a constant | s |"
    )
    console.print("|---|---|---|---|---|---|---|")
    for name in CASES:
        for noise in map(float, asked.noise.split(",")):
            for way in WAYS:
                rows = Parallel(asked.jobs)(
                    delayed(run)(name, way, noise, seed) for seed in range(asked.draws)
                )
                right = [fine for own, *_ in rows for fine in own]
                errors = [error for _, own, _ in rows for error in own]
                cells = (
                    name,
                    f"{noise:.0%}",
                    way,
                    f"{sum(all(own) for own, *_ in rows)} of {len(rows)}",
                    f"{sum(right)} of {len(right)}",
                    f"{100 * median(errors):.2g} %" if errors else "",
                    f"{median(row[2] for row in rows):.1f}",
                )
                console.print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
