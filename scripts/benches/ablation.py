"""What each part of the searches costs and earns: all cases with it, and again without it.

Random systems of each seed, and systems of the zoo's list with --zoo, are measured once a level and
kind of noise. "lost" counts the cases whose law is found with all parts and not without this one,
"gained" the opposite; what earns nothing within one standard error of that difference may go.
Processor seconds are those of the cases that both ran. Every case is kept in the folder of --out;
the next call goes on where this one was stopped. --together leaves several parts out at once.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from dynsr.benchmarks import (
    ZooRecord,
    ZooSystem,
    draw_conditions,
    draw_systems,
    find_animals,
    run_zoo,
)
from dynsr.benchmarks.zoo.running import answer_dynsr
from dynsr.cli.progress import SearchProgress
from dynsr.errors import DynsrError
from dynsr.report import Table
from dynsr.selection.parts import PARTS

ALL = "all parts"


def read_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", default="each", help="names by commas; each of all by default")
    parser.add_argument("--together", action="append", default=[], help="left out at once, commas")
    parser.add_argument("--seeds", default="101,102", help="of random systems, by commas")
    parser.add_argument("--count", type=int, default=10, help="random systems of each seed")
    parser.add_argument("--zoo", type=int, default=0, help="so many systems of the zoo too")
    parser.add_argument("--noise", default="0,0.01,0.05", help="levels, by commas")
    parser.add_argument("--jobs", type=int, default=-1, help="cases at a time")
    parser.add_argument("--out", type=Path, default=Path("results/ablation"))
    parser.add_argument("--page", type=Path, help="page of the docs to write")
    return parser.parse_args()


def find_systems(options: argparse.Namespace) -> list[ZooSystem]:
    """Draw the systems, and take those of the zoo."""
    found = [
        animal
        for seed in map(int, options.seeds.split(","))
        for animal in draw_systems(options.count, seed)
    ]
    return [*found, *find_animals()[: options.zoo]]


def find_methods(options: argparse.Namespace) -> dict[str, partial]:
    """Give the search with all parts, and those without some."""
    named = list(PARTS) if options.parts == "each" else options.parts.split(",")
    left_out = [(name,) for name in named if name] + [
        tuple(names.split(",")) for names in options.together
    ]
    found = {ALL: partial(answer_dynsr, without=())}
    return found | {" ".join(names): partial(answer_dynsr, without=names) for names in left_out}


def compare(records: Sequence[ZooRecord], name: str, noise: float) -> tuple | None:
    """Give the row of a part at one level of noise."""
    cases: dict[str, dict[tuple, ZooRecord]] = {ALL: {}, name: {}}
    for record in records:
        if record.method in cases and record.noise == noise:
            key = (record.system, record.kind, record.rows, record.dropped)
            cases[record.method][key] = record
    both = cases[ALL].keys() & cases[name].keys()
    if not both:
        return None
    pairs = [(cases[ALL][key], cases[name][key]) for key in sorted(both)]
    lost = sum(a.is_law and not b.is_law for a, b in pairs)
    gained = sum(b.is_law and not a.is_law for a, b in pairs)
    whole, less = zip(*pairs, strict=True)
    seconds = [sum(r.processor for r in own) for own in (whole, less)]
    right = [sum(r.verdict == "law" and r.is_law for r in own) for own in (whole, less)]
    wrong = [sum(r.verdict == "law" and not r.is_law for r in own) for own in (whole, less)]
    return (
        name,
        100 * noise,
        len(pairs),
        sum(r.is_law for r in whole),
        lost,
        gained,
        f"{lost - gained} ± {math.sqrt(lost + gained):.1f}",
        f"{right[0]} -> {right[1]}",
        f"{wrong[0]} -> {wrong[1]}",
        round(100 * (1 - seconds[1] / max(seconds[0], 1e-9))),
    )


def make_table(records: Sequence[ZooRecord], names: Sequence[str]) -> Table:
    """Make the table of parts and levels."""
    levels = sorted({record.noise for record in records})
    rows = [compare(records, name, level) for name in names for level in levels]
    columns = (
        *("left out", "noise (%)", "cases", "laws with it", "lost", "gained", "earns"),
        *("said law, right", "said law, wrong", "seconds saved (%)"),
    )
    return Table("ablation", "What each part earns", columns, tuple(r for r in rows if r))


def main() -> None:
    """Run, print and write."""
    options = read_options()
    try:
        levels = [float(level) for level in options.noise.split(",")]
        methods = find_methods(options)
        with SearchProgress() as progress:
            records = run_zoo(
                find_systems(options),
                methods,
                partial(draw_conditions, levels=levels),
                out=options.out,
                jobs=options.jobs,
                progress=progress,
            )
    except (DynsrError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    table = make_table(records, [name for name in methods if name != ALL])
    Console(width=180).print(table.to_rich())
    (options.out / "ablation.csv").write_text(table.to_csv(), encoding="utf-8")
    if options.page is not None:
        from zoo import write_page

        write_page(options.page, table.to_markdown())


if __name__ == "__main__":
    main()
