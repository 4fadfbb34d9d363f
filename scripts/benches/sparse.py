"""Time the implicit SR3 search of the cart-pole, and how it grows with p and m.

The search has p = 27 functions, so 54 regressions, at m = 1000 samples with 5000 iterations. It is
measured on one core, beside a plain loop over the 54 left-hand sides in the same process, and set
against the 1.4834 s and 1.3775 s (lambda 0.01 and 0.1) that DataDrivenDiffEq.jl 0.5.7 took under
Julia 1.5.3 on one core of a two-core machine, as the reference records say.
"""

from __future__ import annotations

import argparse
import json
import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import time  # noqa: E402 (threads are fixed before numpy starts)
from collections.abc import Callable  # noqa: E402

import numpy as np  # noqa: E402

from dynsr.engines.base import SparseProblem  # noqa: E402
from dynsr.engines.sparse.solve import solve_sparse  # noqa: E402
from dynsr.paper.reference import reference_problem  # noqa: E402

JULIA_SECONDS = 1.4
TARGET_SECONDS = 0.3
ITERATIONS = 5000


def best_seconds(
    call: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Give the shortest of several runs: the one that the machine disturbed least."""
    seconds = []
    for _ in range(repeats):
        start = clock()
        call()
        seconds.append(clock() - start)
    return min(seconds)


def problem_of(theta: np.ndarray, dx: np.ndarray) -> SparseProblem:
    """Pose the search with the paper's settings."""
    settings = {"lambda": 0.01, "nu": 1.0}
    return SparseProblem(theta, dx, "SR3", settings, True, ITERATIONS, True, "2021")


def loop_one_by_one(theta: np.ndarray, dx: np.ndarray) -> list[np.ndarray]:
    """Solve every left-hand side alone, in the plain way: one p x p iteration after another."""
    rows = np.vstack([dx * theta, theta])
    tau = np.sqrt(0.02)
    answers = []
    for j in range(len(rows)):
        others = np.delete(rows, j, axis=0)
        a = (others / np.linalg.norm(others, axis=1)[:, None]).T
        w = np.linalg.lstsq(a, -rows[j], rcond=None)[0]
        inverse = np.linalg.inv(a.T @ a + np.eye(a.shape[1]))
        right = -a.T @ rows[j]
        for _ in range(ITERATIONS):
            x = inverse @ (right + w)
            new = np.sign(x) * np.maximum(np.abs(x) - 0.01 * tau, 0.0)
            if np.linalg.norm(new - w) < np.finfo(float).eps:
                break
            w = new
        answers.append(x)
    return answers


def enlarged(theta: np.ndarray, dx: np.ndarray, p: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Give p functions at m samples: the first ones, or products of pairs besides; tiled rows."""
    extra = [theta[i] * theta[j] for i in range(1, len(theta)) for j in range(i, len(theta))]
    rows = np.vstack([theta, *extra])[:p]
    picks = np.arange(m) % theta.shape[1]
    # A little noise keeps repeated samples from being the same equation twice.
    noise = 1 + 1e-6 * np.random.default_rng(0).standard_normal((p, m))
    return rows[:, picks] * noise, dx[picks]


def growth(repeats: int) -> list[dict[str, float]]:
    """Time the search with one size changed at a time."""
    theta, dx = reference_problem("cart-pole")
    sizes = [(p, 1000) for p in (7, 14, 27, 54)] + [(27, m) for m in (250, 4000, 16_000)]
    rows = []
    for p, m in sizes:
        problem = problem_of(*enlarged(theta, dx, p, m))
        seconds = best_seconds(lambda problem=problem: solve_sparse(problem), repeats)  # type: ignore[misc]
        rows.append({"p": p, "m": m, "seconds": seconds})
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="benchmark of the sparse search")
    parser.add_argument("--repeats", type=int, default=5, help="runs, of which the best counts")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    theta, dx = reference_problem("cart-pole")
    problem = problem_of(theta, dx)
    seconds = best_seconds(lambda: solve_sparse(problem), max(options.repeats, 1))
    processor = best_seconds(
        lambda: solve_sparse(problem), max(options.repeats, 1), time.process_time
    )
    loop = best_seconds(lambda: loop_one_by_one(theta, dx), 1)
    result = {
        "p": len(theta),
        "m": len(dx),
        "iterations": ITERATIONS,
        "seconds": seconds,
        "processor_seconds": processor,
        "target_seconds": TARGET_SECONDS,
        "julia_2021_seconds": JULIA_SECONDS,
        "share_of_julia": seconds / JULIA_SECONDS,
        "plain_loop_seconds": loop,
        "times_faster_than_loop": loop / seconds,
        "growth": growth(max(options.repeats // 2, 1)),
    }
    print(json.dumps(result, indent=2) if options.json else as_text(result))


def as_text(result: dict) -> str:
    """Write the figures as lines."""
    lines = [
        f"implicit SR3, cart-pole: p = {result['p']}, m = {result['m']}, {ITERATIONS} iterations",
        f"  dynsr, one core        {result['seconds']:.3f} s (target {TARGET_SECONDS} s)",
        f"  its processor time     {result['processor_seconds']:.3f} s (the same on a free core)",
        f"  2021's Julia, recorded {JULIA_SECONDS:.3f} s: {result['share_of_julia']:.2f} of it",
        f"  plain loop over j      {result['plain_loop_seconds']:.3f} s: "
        f"{result['times_faster_than_loop']:.1f} times as long",
        "growth",
    ]
    for row in result["growth"]:
        lines.append(f"  p = {row['p']:3d}  m = {row['m']:6d}  {row['seconds']:.3f} s")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
