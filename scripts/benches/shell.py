"""Seconds of `dynsr discover FILE` from the shell, beside pysindy on the same file.

Lotka-Volterra, the damped pendulum and the cart-pole with its force without noise, 1001 rows of ten
seconds, and Lorenz' flow with 1 % noise. "Shown" is when the last of the right equations stands on
the screen, "finished" when the command has ended, its files written. pysindy is the zoo's tuned
STLSQ (up to 560 models; the one that explains the trajectory best), in a process of its own too.
Medians of several runs.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np
import sympy

from dynsr.expression import evaluate, parse
from dynsr.report import Table

DYNSR = Path(sys.executable).with_name("dynsr")
BEGIN, END = "<!-- shell -->\n", "<!-- end of shell -->\n"
STLSQ = """
import sys
from dynsr.benchmarks.zoo.peers import answer_stlsq
from dynsr.data import read_trajectories
(data,) = read_trajectories(sys.argv[1]).trajectories
for state, equation in answer_stlsq(data).equations.items():
    print(f"{state}' = {equation}", flush=True)
"""


@dataclass(frozen=True)
class Case:
    """A system as the shell is asked for it, and the seconds that are wanted."""

    name: str
    equations: dict[str, str]
    start: str
    shown: float | None
    finished: float
    noise: float = 0.0
    inputs: dict[str, str] = field(default_factory=dict)


CASES = (
    Case("Lotka-Volterra", {"x": "1.5*x - x*y", "y": "x*y - 3*y"}, "1,1", 1.5, 3.0),
    Case(
        "damped pendulum",
        {"theta1": "theta2", "theta2": "-0.1*theta2 - 9.81*sin(theta1)"},
        "1,0",
        1.5,
        3.0,
    ),
    Case(
        "cart-pole with F",
        {
            "w": "y",
            "x": "z",
            "y": "(-19.62*sin(w) - cos(w)*F - cos(w)*sin(w)*y^2)/(2 - cos(w)^2)",
            "z": "(F + 9.81*sin(w)*cos(w) + sin(w)*y^2)/(2 - cos(w)^2)",
        },
        "0.3,0,1,0",
        None,
        15.0,
        inputs={"F": "-0.2 + 0.5*sin(6*t)"},
    ),
    Case(
        "Lorenz, 1 % noise",
        {"x": "10*(y - x)", "y": "28*x - y - x*z", "z": "x*y - 8*z/3"},
        "-8,7,27",
        None,
        12.0,
        noise=0.01,
    ),
)


def read_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3, help="runs of each command")
    parser.add_argument("--page", type=Path, help="page of the docs to write the table into")
    return parser.parse_args()


def write_data(case: Case, folder: Path) -> Path:
    """Have the shell make the table of a case."""
    path = folder / f"{case.name.split(',')[0].replace(' ', '-').lower()}.csv"
    words = ["generate", "--equations", "; ".join(f"{s}'={e}" for s, e in case.equations.items())]
    words += ["--x0", case.start, "--span", "0,10", "--dt", "0.01", "--noise", str(case.noise)]
    for name, formula in case.inputs.items():
        words += ["--inputs", f"{name}={formula}"]
    subprocess.run([DYNSR, *words, "--out", path], check=True, capture_output=True)
    return path


def is_right(state: str, text: str, case: Case, columns: dict[str, np.ndarray]) -> bool:
    """Whether a printed right-hand side is the law's to 1 % of its size, at mixed rows."""
    try:
        found = evaluate(parse(text), columns)
    except (ValueError, KeyError, sympy.SympifyError):
        return False
    return is_near(found, evaluate(parse(case.equations[state]), columns))


def is_near(found: np.ndarray, true: np.ndarray) -> bool:
    """Whether values are the law's to 1 % of its size."""
    return bool(np.max(np.abs(found - true)) < 0.01 * np.max(np.abs(true)))


def mix(path: Path) -> dict[str, np.ndarray]:
    """Columns of a table, each in another order, so that no relation among them holds."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    rng = np.random.default_rng(0)
    return {name: rng.permutation(table[name]) for name in table.dtype.names}


def time_command(words: list[object], case: Case, path: Path) -> tuple[float | None, float]:
    """Seconds until the last right equation is shown, None where one never is, and to the end."""
    columns, right = mix(path), {}
    began = time.perf_counter()
    with subprocess.Popen(
        [str(w) for w in words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        seen = [(time.perf_counter() - began, line) for line in process.stdout]
    ended = time.perf_counter() - began
    for seconds, line in seen:
        left, equals, text = line.strip().partition("' = ")
        if equals and left in case.equations and left not in right:
            if is_right(left, text, case, columns):
                right[left] = seconds
    return (max(right.values()) if right.keys() == case.equations.keys() else None), ended


def time_case(case: Case, folder: Path, runs: int) -> list[str]:
    """Give the row of one case."""
    path = write_data(case, folder)
    ours, theirs = [], []
    for run in range(runs):
        inputs = ["--inputs", ",".join(case.inputs)] if case.inputs else []
        out = ["--out", folder / f"{path.stem}-{run}"]
        ours.append(time_command([DYNSR, "discover", path, *inputs, *out], case, path))
        if not case.inputs:
            theirs.append(time_command([sys.executable, "-c", STLSQ, path], case, path))
    shown = [seconds for seconds, _ in ours if seconds is not None]
    finished = median(seconds for _, seconds in ours)
    other = median(seconds for _, seconds in theirs) if theirs else None
    return [
        case.name,
        f"{median(shown):.2f}" if len(shown) == runs else "no",
        f"{case.shown:g}" if case.shown else "",
        f"{finished:.2f}",
        f"{case.finished:g}",
        f"{other:.2f}" if other else "",
        ("yes" if all(s is not None for s, _ in theirs) else "no") if theirs else "",
        f"{finished / other:.2f}" if other else "",
    ]


def main() -> None:
    """Time all cases and print the table."""
    options = read_options()
    heads = ("data", "right law shown (s)", "at most", "finished (s)", "at most", "pysindy (s)")
    heads += ("right law", "times pysindy's")
    with tempfile.TemporaryDirectory() as folder:
        rows = [tuple(time_case(case, Path(folder), options.runs)) for case in CASES]
    text = Table("shell", "Seconds from the shell", heads, tuple(rows)).to_markdown()
    if options.page is not None:
        from zoo import write_page

        write_page(options.page, text, (BEGIN, END))
    print(text)


if __name__ == "__main__":
    main()
