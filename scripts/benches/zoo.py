"""How often badly measured textbook systems are found again, beside pysindy on the same data.

Every case (system, condition, method) is kept in the folder of --out as it ends; the next call
goes on where this one was stopped. Writes zoo.md and zoo-cases.csv there and, with --page, the
tables into that page of the docs, between its marks.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from rich.console import Console

from dynsr import __version__
from dynsr.benchmarks import (
    ZooRecord,
    ZooSystem,
    draw_conditions,
    draw_systems,
    find_animals,
    make_methods,
    run_zoo,
    score_table,
    verdict_table,
)
from dynsr.cli.progress import SearchProgress
from dynsr.errors import DynsrError
from dynsr.report import Table

MARKS = "<!-- measured -->\n", "<!-- end of measured -->\n"
RANDOM_MARKS = "<!-- random -->\n", "<!-- end of random -->\n"


def read_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("systems", nargs="*", help="systems of the zoo; all by default")
    parser.add_argument("--random", type=int, help="so many random systems of --seed instead")
    parser.add_argument("--beyond", action="store_true", help="with a mechanism none can write")
    parser.add_argument("--noise", default="0,0.01,0.05,0.1", help="levels, by commas")
    parser.add_argument("--methods", default="dynsr,stlsq,weak", help="who searches, by commas")
    parser.add_argument("--preset", default="best", help="of dynsr")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=-1, help="cases at a time")
    parser.add_argument("--out", type=Path, default=Path("results/zoo"))
    parser.add_argument("--page", type=Path, help="page of the docs to write the tables into")
    return parser.parse_args()


def find_systems(options: argparse.Namespace) -> list[ZooSystem]:
    """Give the systems of the zoo, or draw them."""
    if options.random is None:
        return find_animals(options.systems)
    return draw_systems(options.random, options.seed, beyond=options.beyond)


def write_cases(records: Sequence[ZooRecord], out: Path) -> None:
    """Write every case as a row of a CSV file."""
    columns = (*asdict(records[0]), "right")
    rows = []
    for record in records:
        fields = asdict(record)
        fields["equations"] = "; ".join(f"{s}' = {e}" for s, e in record.equations.items())
        rows.append((*fields.values(), record.right))
    table = Table("zoo-cases", "Cases", columns, tuple(rows))
    (out / "zoo-cases.csv").write_text(table.to_csv(), encoding="utf-8")


def system_table(records: Sequence[ZooRecord], method: str) -> Table:
    """Make the table of systems: in how many of its cases a method reproduced each."""
    lines = []
    for name in dict.fromkeys(r.system for r in records):
        own = [r for r in records if r.system == name and r.method == method]
        shares = (
            sum(r.reproduced > 0.9 for r in own),
            sum(0.9 < r.unseen <= 1 for r in own),
            sum(r.is_law for r in own),
        )
        lines.append((name, len(own), *shares))
    columns = ("system", "cases", "reproduced", "unseen start", "the law")
    return Table("zoo-systems", f"By system: {method}", columns, tuple(lines))


def write_tables(records: Sequence[ZooRecord], options: argparse.Namespace) -> str:
    """Give all tables as Markdown, with what they were measured by."""
    count = len({r.system for r in records})
    who = "The zoo" if options.random is None else "Drawn by chance"
    parts = [
        f"{who}, {count} systems; seed {options.seed}, preset {options.preset}, "
        f"dynsr {__version__}.\n",
        score_table(records).to_markdown(),
    ]
    for kind in ("additive", "multiplicative"):
        own = [r for r in records if r.kind == kind]
        if own:
            title = f"{kind.capitalize()} noise alone"
            parts.append(replace(score_table(own), title=title).to_markdown())
    said = verdict_table(records)
    if said.rows:
        parts.append(said.to_markdown())
    parts += [
        system_table(records, method).to_markdown()
        for method in dict.fromkeys(r.method for r in records)
        if method == "dynsr" and options.random is None
    ]
    return "\n".join(parts)


def write_page(page: Path, text: str, marks: tuple[str, str] = MARKS) -> None:
    """Put the tables between the marks of a page."""
    begin, end = marks
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, last, after = rest.partition(end)
    if not (found and last):
        raise SystemExit(f"error: {page} lacks the marks {begin.strip()} and {end.strip()}")
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def main() -> None:
    """Run, print and write."""
    options = read_options()
    try:
        levels = [float(level) for level in options.noise.split(",")]
        with SearchProgress() as progress:
            records = run_zoo(
                find_systems(options),
                make_methods(options.methods.split(","), options.preset),
                partial(draw_conditions, levels=levels, seed=options.seed),
                seed=options.seed,
                out=options.out,
                jobs=options.jobs,
                progress=progress,
            )
    except (DynsrError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    text = write_tables(records, options)
    (options.out / "zoo.md").write_text(text, encoding="utf-8")
    write_cases(records, options.out)
    if options.page is not None:
        write_page(options.page, text, MARKS if options.random is None else RANDOM_MARKS)
    for table in (score_table(records), verdict_table(records)):
        Console(width=180).print(table.to_rich())


if __name__ == "__main__":
    main()
