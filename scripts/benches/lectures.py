"""How many of forty equations of the Feynman Lectures are recovered exactly, and how fast.

Recovered exactly means: the chosen formula agrees with the true one to 1e-6 of the largest value
at fresh points from ranges 5 % wider on either side. The formula is chosen from the data alone.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from dynsr.benchmarks.lectures import Lecture, find_lectures
from dynsr.data.samples import Samples
from dynsr.expression.evaluation import evaluate
from dynsr.fit.candidates import Candidate
from dynsr.fit.description import choose
from dynsr.methods.feynman.enumeration.brute_force import BruteForce, search_values
from dynsr.methods.feynman.search import DynAIFeynman
from dynsr.methods.rational import RationalSearch

TOLERANCE, WIDEN, EXACT = 1e-6, 0.05, 1e-10


# Sums and ratios of products of powers, the square of the target too; then sums with functions.
RATIOS = RationalSearch(costs=(4,), rounds=1, width=64, inverses=True, changes=("square", "inv"))
SUMS = RationalSearch(
    costs=(6,), rounds=1, width=64, denominators=False, max_features=2500, changes=("square",)
)


def find_with_both(samples: Samples, seconds: float, candidates: float) -> tuple[Candidate, str]:
    """Give the formula chosen of enumeration and sums and ratios, and what was looked at."""
    began = time.monotonic()
    quick = BruteForce(seconds=0.4 * seconds, max_candidates=1e5, ratios=True, combinations=True)
    deep = BruteForce(max_candidates=candidates, changes=("square",), ratios=True, keep=8)
    pool: list[Candidate] = []
    looked = ""
    for method in (quick, RATIOS, SUMS, deep):
        left = seconds - (time.monotonic() - began)
        if left <= 0.05 * seconds:
            break
        limited = replace(method, seconds=min(left, method.seconds))
        if isinstance(limited, BruteForce):
            result = search_values(samples.X, samples.y, samples.names, limited)
            pool += result.candidates
            looked = f"{result.distinct:.1e} functions, size {result.complete}, {result.stopped}"
        else:
            pool += limited.search(samples, np.random.default_rng(0))
            looked += f"; {limited.name}"
        if min(c.loss for c in pool) <= EXACT * np.abs(samples.y).max():
            break
    return choose(pool, samples), looked


def find_with_preset(samples: Samples, seconds: float, candidates: float) -> tuple[Candidate, str]:
    """Give the formula that DynAIFeynman's "best" preset chooses, and its source."""
    method = DynAIFeynman.preset("best", time_budget=seconds)
    front = method.search(samples, np.random.default_rng(0))
    chosen = method.choose(front, samples)
    return chosen, chosen.source


METHODS = {"both": find_with_both, "best": find_with_preset}


def is_exact(candidate: Candidate, fresh: Samples) -> bool:
    """Whether a formula agrees with the truth at fresh points."""
    error = np.abs(evaluate(candidate.expr, fresh.columns) - fresh.y)
    return bool(np.all(error <= TOLERANCE * np.abs(fresh.y).max()))


def run(lecture: Lecture, place: int, options: argparse.Namespace) -> tuple[bool, float, list[str]]:
    """Search one equation; give whether it was recovered, the seconds and a row of the table."""
    learn, check = np.random.default_rng([options.seed, place]).spawn(2)
    samples = lecture.samples(options.rows, learn)
    began, cpu = time.perf_counter(), time.process_time()
    chosen, looked = METHODS[options.method](samples, options.seconds, options.candidates)
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    exact = is_exact(chosen, lecture.samples(1000, check, WIDEN))
    shown = str(chosen.expr) if len(str(chosen.expr)) < 70 else str(chosen.expr)[:67] + "..."
    row = [
        lecture.number,
        lecture.formula,
        "yes" if exact else "NO",
        f"{seconds:.2f}",
        f"{cpu:.2f}",
        looked,
    ]
    return exact, seconds, [*row, shown]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "numbers", nargs="*", help="equations to run, such as I.12.2; all by default"
    )
    parser.add_argument("--rows", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=15.0, help="budget of one equation")
    parser.add_argument("--method", choices=METHODS, default="both")
    parser.add_argument("--candidates", type=float, default=2.5e6)
    options = parser.parse_args()
    console = Console(width=200)
    table = Table("equation", "formula", "exact", "wall s", "CPU s", "looked at", "found")
    missed, total, times = [], 0.0, []
    lectures = find_lectures(options.numbers)
    for place, lecture in enumerate(lectures):
        exact, seconds, row = run(lecture, place, options)
        console.print(
            f"{row[0]:9} {'exact' if exact else 'MISSED':6} {seconds:6.2f} s, CPU {row[4]} s",
            highlight=False,
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
        f"(median {np.median(times):.2f} s, longest {max(times):.2f} s, "
        f"budget {options.seconds:g} s)"
    )
    console.print(f"not recovered: {', '.join(missed) or 'none'}")


if __name__ == "__main__":
    main()
