"""How many of forty equations of the Feynman Lectures are recovered exactly, and how fast.

Recovered exactly means: the chosen formula agrees with the true one to 1e-6 of the largest value
at fresh points from ranges 5 % wider on either side. The formula is chosen from the data alone.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from dynsr.benchmarks.lectures import Lecture, find_lectures
from dynsr.expression import evaluate
from dynsr.methods.feynman.bruteforce import BruteForce, search_values
from dynsr.methods.feynman.description import choose
from dynsr.methods.feynman.rational import RationalSearch
from dynsr.pareto import Candidate
from dynsr.samples import Samples

TOLERANCE, WIDEN = 1e-6, 0.05


def find(samples: Samples, seconds: float, candidates: float) -> tuple[Candidate, str]:
    """Give the formula chosen, and what the enumeration looked at."""
    settings = BruteForce(seconds=seconds, max_candidates=candidates, ratios=True)
    result = search_values(samples.X, samples.y, samples.names, settings)
    pool = list(result.candidates)
    if result.stopped != "exact":
        front = RationalSearch(costs=(2, 3)).search(samples, np.random.default_rng(0))
        pool += list(front)
    looked = f"{result.distinct:.1e} functions, size {result.complete}, {result.stopped}"
    return choose(pool, samples), looked


def is_exact(candidate: Candidate, fresh: Samples) -> bool:
    """Whether a formula agrees with the truth at fresh points."""
    error = np.abs(evaluate(candidate.expr, fresh.columns) - fresh.y)
    return bool(np.all(error <= TOLERANCE * np.abs(fresh.y).max()))


def run(lecture: Lecture, place: int, options: argparse.Namespace) -> tuple[bool, float, list[str]]:
    """Search one equation; give whether it was recovered, the seconds and a row of the table."""
    learn, check = np.random.default_rng([options.seed, place]).spawn(2)
    samples = lecture.samples(options.rows, learn)
    began = time.perf_counter()
    chosen, looked = find(samples, options.seconds, options.candidates)
    seconds = time.perf_counter() - began
    exact = is_exact(chosen, lecture.samples(1000, check, WIDEN))
    shown = str(chosen.expr) if len(str(chosen.expr)) < 70 else str(chosen.expr)[:67] + "..."
    row = [lecture.number, lecture.formula, "yes" if exact else "NO", f"{seconds:.2f}", looked]
    return exact, seconds, [*row, shown]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "numbers", nargs="*", help="equations to run, such as I.12.2; all by default"
    )
    parser.add_argument("--rows", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=15.0, help="budget of one enumeration")
    parser.add_argument("--candidates", type=float, default=5e5)
    options = parser.parse_args()
    console = Console(width=200)
    table = Table("equation", "formula", "exact", "s", "looked at", "found")
    missed, total, times = [], 0.0, []
    lectures = find_lectures(options.numbers)
    for place, lecture in enumerate(lectures):
        exact, seconds, row = run(lecture, place, options)
        console.print(
            f"{row[0]:9} {'exact' if exact else 'MISSED':6} {seconds:6.2f} s", highlight=False
        )
        table.add_row(*row)
        total += seconds
        times.append(seconds)
        if not exact:
            missed.append(lecture.number)
    console.print(table)
    recovered = len(lectures) - len(missed)
    console.print(
        f"recovered exactly: {recovered} of {len(lectures)} in {total:.0f} s "
        f"(median {np.median(times):.2f} s an equation)"
    )
    console.print(f"not recovered: {', '.join(missed) or 'none'}")


if __name__ == "__main__":
    main()
