"""Seconds and memory of `dynsr discover` as tables get longer, wider, and more.

Each command is a process of its own. Seconds are those of the processor, of all its processes
together, and those of the clock; memory is the largest of one process. Longer: Lotka-Volterra with
2 % noise, one run, 100 rows a cycle. Wider: Lorenz' circle of 1996 without noise, 401 rows. More:
files of 151 rows of Lotka-Volterra, each with constants of its own, by `--batch`. An equation is
right where it is the law's within 1 % at rows whose columns are mixed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import sympy
from scipy.integrate import solve_ivp
from shell import DYNSR, is_near
from zoo import write_page

import dynsr
from dynsr.expression import compile_columns, evaluate, parse
from dynsr.report import Table

BEGIN, END = "<!-- scale -->\n", "<!-- end of scale -->\n"


@dataclass(frozen=True)
class Cost:
    """What a command took: seconds of the processor and of the clock, and megabytes."""

    processor: float
    clock: float
    memory: float


def read_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", default="1000,10000,100000,1000000", help="rows of the long CSV")
    parser.add_argument("--parquet", default="10000000", help="rows of the long Parquet table")
    parser.add_argument("--states", default="5,10,20", help="states of the wide tables")
    parser.add_argument("--files", default="2,8,32", help="numbers of tables")
    parser.add_argument("--page", type=Path, help="page of the docs to write the tables into")
    return parser.parse_args()


def read_sizes(text: str) -> list[int]:
    """Read a list of sizes; empty text is none."""
    return [int(size) for size in text.split(",") if size]


def predators(k: Sequence[float] | np.ndarray) -> dict[str, sympy.Expr]:
    """Give Lotka and Volterra's equations."""
    return {"x": parse(f"{k[0]}*x - {k[1]}*x*y"), "y": parse(f"{k[2]}*x*y - {k[3]}*y")}


def circle(states: int) -> dict[str, sympy.Expr]:
    """Give Lorenz' equations of 1996."""
    names = [f"x{i}" for i in range(states)]
    return {
        names[i]: parse(f"({names[(i + 1) % states]} - {names[i - 2]})*{names[i - 1]} - {own} + 8")
        for i, own in enumerate(names)
    }


def integrate(
    law: Mapping[str, sympy.Expr], start: Sequence[float] | np.ndarray, t: np.ndarray
) -> pd.DataFrame:
    """Give the table of a law from a start at given times."""
    slopes = compile_columns(list(law.values()), list(law))
    solved = solve_ivp(
        lambda _, x: slopes(*x), (t[0], t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-9
    )
    return pd.DataFrame({"t": t, **dict(zip(law, solved.y, strict=True))})


def long_table(rows: int) -> tuple[pd.DataFrame, dict[str, sympy.Expr]]:
    """Give a long noisy table and its law: one cycle, integrated once, again and again."""
    law = predators((1.5, 1.0, 1.0, 3.0))
    slopes = compile_columns(list(law.values()), list(law))

    cycle = solve_ivp(
        lambda _, x: slopes(*x),
        (0, 20),
        (1.0, 1.0),
        events=lambda _, x: x[0] - 1,
        dense_output=True,
        rtol=1e-10,
        atol=1e-12,
    )
    crossings = zip(cycle.t_events[0], cycle.y_events[0], strict=True)
    period = next(t for t, x in crossings if t > 1 and slopes(*x)[0] > 0)
    t = np.arange(rows) * period / 99.5
    table = pd.DataFrame({"t": t, **dict(zip(law, cycle.sol(t % period), strict=True))})
    rng = np.random.default_rng(rows)
    for state in law:
        table[state] += 0.02 * table[state].std() * rng.standard_normal(rows)
    return table, law


def wide_table(states: int) -> tuple[pd.DataFrame, dict[str, sympy.Expr]]:
    """Give an exact table of many states and its law."""
    law = circle(states)
    start = 8 + 0.5 * np.random.default_rng(states).standard_normal(states)
    return integrate(law, start, np.linspace(0, 8, 401)), law


def discover(*words: object) -> Cost:
    """Run one command to its end."""
    began = time.perf_counter()
    with subprocess.Popen(
        [str(word) for word in (DYNSR, "discover", *words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"error: dynsr discover {words[0]} ended with {process.returncode}")
    megabytes = used.ru_maxrss / (1024 if sys.platform != "darwin" else 1024**2)
    return Cost(used.ru_utime + used.ru_stime, time.perf_counter() - began, megabytes)


def count_right(
    found: Mapping[str, sympy.Expr], law: Mapping[str, sympy.Expr], table: pd.DataFrame
) -> int:
    """Count the equations that are the law's within 1 % at rows whose columns are mixed."""
    rng = np.random.default_rng(0)
    columns = {name: rng.permutation(table[name].to_numpy()) for name in law}
    pairs = ((evaluate(found[s], columns), evaluate(law[s], columns)) for s in law)
    return sum(is_near(*pair) for pair in pairs)


def measure(
    make: Callable[[int], tuple[pd.DataFrame, dict[str, sympy.Expr]]],
    counts: Sequence[int],
    folder: Path,
    parquet: bool = False,
) -> Iterator[tuple[int, Cost, str]]:
    """Give for tables of so many rows or states what each took, and how many are right."""
    for count in counts:
        table, law = make(count)
        path = folder / f"{make.__name__}-{count}.{'parquet' if parquet else 'csv'}"
        table.to_parquet(path) if parquet else table.to_csv(path, index=False)
        # A new process is counted with the memory of the one that began it.
        table = table.sample(min(len(table), 2000), random_state=0)
        out = path.with_suffix("")
        cost = discover(path, "--out", out)
        found = dynsr.load(out / "discovery.json")
        right = count_right(found.equations, law, table)
        yield count, cost, f"{right} of {len(law)}, {found.verdict.level}"
        path.unlink()


def measure_batches(counts: Sequence[int], folder: Path) -> Iterator[tuple[int, Cost, str]]:
    """Give for so many files what a batch took, and how many of their equations are right."""
    for count in counts:
        rng, laws, own = np.random.default_rng(count), {}, folder / f"files-{count}"
        own.mkdir()
        for number in range(count):
            law = predators(rng.uniform((1.0, 0.6, 0.6, 2.0), (2.0, 1.4, 1.4, 3.0)).round(2))
            table = integrate(law, (1.0, 1.0), np.linspace(0, 10, 151))
            table.to_csv(own / f"culture{number}.csv", index=False)
            laws[f"culture{number}"] = law, table
        out = own / "laws"
        cost = discover(*sorted(own.glob("*.csv")), "--batch", "--out", out)
        right = 0
        for path in out.rglob("discovery.json"):
            law, table = laws[path.parent.name.partition("-")[0]]
            right += count_right(dynsr.load(path).equations, law, table) == len(law)
        yield count, cost, f"{right} of {count} files"


def tabulate(name: str, caption: str, size: str, found: Sequence[tuple[int, Cost, str]]) -> str:
    """Write a table, and below it how the processor's seconds grow."""
    heads = (size, "processor (s)", "clock (s)", "memory (MB)", "right equations")
    rows = tuple(
        (f"{count:,}", f"{c.processor:.1f}", f"{c.clock:.1f}", f"{c.memory:.0f}", right)
        for count, c, right in found
    )
    text = Table(name, caption, heads, rows).to_markdown()
    if len(found) < 2:
        return text
    sizes, seconds = np.log([(count, c.processor) for count, c, _ in found]).T
    slope = np.polyfit(sizes, seconds, 1)[0]
    return f"{text}\nThe processor's seconds grow as {size} to the power {slope:.2f}.\n"


def main() -> None:
    """Measure, print and write."""
    options = read_options()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        more = list(measure_batches(read_sizes(options.files), folder))
        wide = list(measure(wide_table, read_sizes(options.states), folder))
        long = [
            *measure(long_table, read_sizes(options.rows), folder),
            *measure(long_table, read_sizes(options.parquet), folder, parquet=True),
        ]
    kinds = (
        ("rows", "Longer tables", "rows", long),
        ("states", "More states", "states", wide),
        ("files", "More files", "files", more),
    )
    text = "\n".join(tabulate(*kind) for kind in kinds if kind[-1])
    if options.page is not None:
        write_page(options.page, text, (BEGIN, END))
    print(text)


if __name__ == "__main__":
    main()
