"""How many of forty equations of the Feynman Lectures are recovered exactly, and how fast.

Recovered exactly means: the chosen formula agrees with the true one to 1e-6 of the largest value
at fresh points from ranges 5 % wider on either side. The formula is chosen from the data alone, by
the preset "best" of DynAIFeynman.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from dynsr.benchmarks.lectures import LECTURES, Lecture, find_lectures
from dynsr.data import Samples
from dynsr.expression.evaluation import evaluate
from dynsr.fit.candidates import Candidate
from dynsr.methods.feynman.search import DynAIFeynman

TOLERANCE, WIDEN = 1e-6, 0.05


def is_exact(candidate: Candidate, fresh: Samples) -> bool:
    """Whether a formula agrees with the truth at fresh points."""
    error = np.abs(evaluate(candidate.expr, fresh.columns) - fresh.y)
    return bool(np.all(error <= TOLERANCE * np.abs(fresh.y).max()))


def run(lecture: Lecture, options: argparse.Namespace) -> tuple[bool, float, list[str]]:
    """Search one equation; give whether it was recovered, the seconds and a row of the table."""
    learn, check = np.random.default_rng([options.seed, LECTURES.index(lecture)]).spawn(2)
    samples = lecture.samples(options.rows, learn)
    began, cpu = time.perf_counter(), time.process_time()
    method = DynAIFeynman.preset("best", time_budget=options.seconds)
    chosen = method.choose(method.search(samples, np.random.default_rng(options.seed)), samples)
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    exact = is_exact(chosen, lecture.samples(1000, check, WIDEN))
    shown = str(chosen.expr) if len(str(chosen.expr)) < 70 else str(chosen.expr)[:67] + "..."
    row = [
        lecture.number,
        lecture.formula,
        "yes" if exact else "NO",
        f"{seconds:.2f}",
        f"{cpu:.2f}",
        chosen.source,
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
    options = parser.parse_args()
    console = Console(width=200)
    table = Table("equation", "formula", "exact", "wall s", "CPU s", "stage", "found")
    missed, total, times, cpu = [], 0.0, [], 0.0
    lectures = find_lectures(options.numbers)
    for lecture in lectures:
        exact, seconds, row = run(lecture, options)
        console.print(
            f"{row[0]:9} {'exact' if exact else 'MISSED':6} {seconds:6.2f} s, CPU {row[4]} s, "
            f"{row[5]}",
            highlight=False,
        )
        table.add_row(*row)
        total += seconds
        times.append(seconds)
        cpu += float(row[4])
        if not exact:
            missed.append(lecture.number)
    console.print(table)
    recovered = len(lectures) - len(missed)
    console.print(
        f"recovered exactly: {recovered} of {len(lectures)} in {total:.0f} s, CPU {cpu:.0f} s "
        f"(median {np.median(times):.2f} s, longest {max(times):.2f} s, "
        f"budget {options.seconds:g} s)"
    )
    console.print(f"not recovered: {', '.join(missed) or 'none'}")


if __name__ == "__main__":
    main()
