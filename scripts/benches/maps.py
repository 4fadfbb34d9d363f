"""Noise maps: how often the exact terms of three flows are found, by noise and length of record.

Gaussian noise, a share of the standard deviation of all states pooled, as published for Lorenz'
flow (Fung et al. 2025). Neither a library nor the size of the noise is told. A draw counts where
every equation has the terms of the true one and no other. Every draw is kept in the folder of
--out; the next call goes on where this one was stopped. With --page the table goes into that page.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from statistics import median

import numpy as np
import sympy
from joblib import effective_n_jobs
from rich.console import Console

from dynsr import __version__
from dynsr.cli.progress import SearchProgress
from dynsr.data import System, Trajectory
from dynsr.discovery import DISCOVERY, discover
from dynsr.engines import simulate
from dynsr.errors import DynsrError, one_line
from dynsr.expression import parse, skeleton, to_text
from dynsr.fit import loosen
from dynsr.jobs import RunFolder, Task, Watch, fingerprint, run_tasks
from dynsr.methods import Report
from dynsr.report import Table

BEGIN, END = "<!-- maps -->\n", "<!-- end of maps -->\n"


@dataclass(frozen=True)
class Flow:
    """A flow, its start, the time between rows, and the lengths of its records in seconds."""

    equations: dict[str, str]
    start: tuple[float, ...]
    step: float
    lengths: tuple[float, ...]


FLOWS = {
    "lorenz": Flow(
        {"x": "10*y - 10*x", "y": "28*x - y - x*z", "z": "x*y - 8*z/3"},
        (-8.0, 8.0, 27.0),
        0.01,
        (4.0, 6.0, 8.0, 10.0),
    ),
    "rossler": Flow(
        {"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + x*z - 5.7*z"},
        (3.0, 5.0, 0.0),
        0.05,
        (10.0, 20.0, 30.0),
    ),
    "van-der-pol": Flow({"x": "y", "y": "2*y - 2*x^2*y - x"}, (0.0, 2.0), 0.05, (5.0, 10.0, 20.0)),
}


@dataclass(frozen=True)
class Draw:
    """One search: what was given, what was found, and whether it has the exact terms.

    ``seconds`` are those of the processor.
    """

    flow: str
    noise: float
    length: float
    seed: int
    equations: dict[str, str]
    exact: bool
    verdict: str
    seconds: float
    failure: str = ""

    @property
    def summary(self) -> str:
        """What came out in a few words."""
        return self.failure or f"{'exact' if self.exact else 'other terms'}, said {self.verdict}"


def make_data(flow: Flow, noise: float, length: float, seed: int) -> Trajectory:
    """Integrate a flow and add noise, a share of the deviation of all states pooled."""
    system = System.from_strings(flow.equations, x0=flow.start)
    times = np.arange(round(length / flow.step) + 1) * flow.step
    run = simulate(system, flow.start, times, 1e-10, 1e-12)
    rng = np.random.default_rng([seed, round(1e4 * noise), round(10 * length)])
    pooled = float(np.sqrt(np.mean(np.var(run.x, axis=0))))
    noisy = run.x + noise * pooled * rng.standard_normal(run.x.shape)
    return Trajectory(run.t, noisy, run.states)


def has_exact_terms(found: dict[str, sympy.Expr], flow: Flow) -> bool:
    """Whether every equation has the terms of the true one and no other, whatever its constants."""

    def shape(expr: sympy.Expr) -> sympy.Expr:
        return skeleton(loosen(sympy.expand(expr)))

    return all(shape(found[s]) == shape(parse(text)) for s, text in flow.equations.items())


def search(
    name: str,
    noise: float,
    length: float,
    seed: int,
    without: tuple[str, ...],
    report: Report | None = None,
) -> Draw:
    """Discover one draw as a user would."""
    flow = FLOWS[name]
    data = make_data(flow, noise, length, seed)
    settings = replace(DISCOVERY, selection=DISCOVERY.selection.without(*without))
    began = time.process_time()
    try:
        found = discover(data, jobs=1, settings=settings)
    except Exception as error:
        taken = time.process_time() - began
        return Draw(name, noise, length, seed, {}, False, "", taken, one_line(error)[:300])
    taken = time.process_time() - began
    return Draw(
        name,
        noise,
        length,
        seed,
        {s: to_text(e) for s, e in found.equations.items()},
        has_exact_terms(dict(found.equations), flow),
        found.verdict.level,
        taken,
    )


def read_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flows", nargs="*", default=list(FLOWS), help="all by default")
    parser.add_argument("--noise", default="0.1,0.15,0.2,0.25,0.3,0.4", help="shares, by commas")
    parser.add_argument("--lengths", help="seconds by commas; those of each flow by default")
    parser.add_argument("--draws", type=int, default=8, help="draws of a cell")
    parser.add_argument("--without", default="", help="parts of the searches left out, by commas")
    parser.add_argument("--jobs", type=int, default=-1, help="draws at a time")
    parser.add_argument("--out", type=Path, default=Path("results/maps"))
    parser.add_argument("--page", type=Path, help="page of the docs to write the table into")
    return parser.parse_args()


def make_tasks(options: argparse.Namespace) -> Iterator[Task]:
    """Give a task for every draw."""
    levels = [float(level) for level in options.noise.split(",")]
    without = tuple(name for name in options.without.split(",") if name)
    for name in options.flows:
        if name not in FLOWS:
            raise ValueError(f"unknown flow {name!r}; they are: {', '.join(FLOWS)}")
        given = options.lengths and [float(own) for own in options.lengths.split(",")]
        for noise, length, seed in product(
            levels, given or FLOWS[name].lengths, range(options.draws)
        ):
            what = (name, noise, length, seed, without)
            yield Task(
                f"{name}-{noise:g}-{length:g}-{seed}",
                f"{name} for {length:g} s, noise {noise:.0%}, draw {seed}",
                search,
                what,
                Draw,
                fingerprint(*what, __version__),
                20.0,
                partial(_fail, what),
            )


def _fail(what: tuple, reason: str) -> Draw:
    return Draw(*what[:4], {}, False, "", 0.0, reason)


def make_table(draws: Iterable[Draw]) -> Table:
    """Make the table of cells: share of exact terms, of verdicts of a law, and seconds."""
    cells: dict[tuple, list[Draw]] = {}
    for draw in draws:
        cells.setdefault((draw.flow, draw.noise, draw.length), []).append(draw)
    rows = [
        (
            name,
            100 * noise,
            length,
            len(own),
            sum(d.exact for d in own),
            sum(d.exact and d.verdict == "law" for d in own),
            sum(not d.exact and d.verdict == "law" for d in own),
            round(median(d.seconds for d in own), 1),
        )
        for (name, noise, length), own in sorted(cells.items())
    ]
    columns = (
        *("flow", "noise (%)", "seconds", "draws", "exact terms"),
        *("said law, exact", "said law, other terms", "processor s (median)"),
    )
    return Table("maps", "Noise maps", columns, tuple(rows))


def run(options: argparse.Namespace) -> Sequence[Draw]:
    """Search all draws; those that the folder keeps are read back."""
    tasks = list(make_tasks(options))
    folder = RunFolder(options.out.absolute())
    folder.claim("maps", {"version": __version__, "without": options.without})
    workers = effective_n_jobs(options.jobs)
    with (
        SearchProgress() as progress,
        Watch(progress, {task.name: task.seconds for task in tasks}, workers) as watch,
    ):
        return run_tasks(tasks, folder, options.jobs, watch)


def main() -> None:
    """Run, print and write."""
    options = read_options()
    try:
        draws = run(options)
    except (DynsrError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    table = make_table(draws)
    (options.out / "maps.md").write_text(table.to_markdown(), encoding="utf-8")
    if options.page is not None:
        from zoo import write_page

        write_page(options.page, table.to_markdown(), (BEGIN, END))
    Console(width=160).print(table.to_rich())


if __name__ == "__main__":
    main()
