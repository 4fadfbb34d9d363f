"""The paper: its experiment run again, and its printed numbers scored again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynsr.commands import options, output

Names = list[str] | None


def replicate(
    systems: Annotated[
        Names, typer.Option(help="Systems, by commas; the paper's three by default.")
    ] = None,
    methods: Annotated[
        Names, typer.Option(help="dynaifeynman, sindy, ga; all three by default.")
    ] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help="Runs of each; 5 as in the paper, 2 when quick.")
    ] = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = -1,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="Folder of the results.", rich_help_panel=options.OUTPUT),
    ] = Path("results"),
    quick: Annotated[bool, typer.Option(help="Small searches, for a first look.")] = False,
    engine: options.Engine = "embedded",
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Run the paper's experiment again: Table 1, the appendix tables, Figure 1 and a report.

    Whatever ends it, the next call with the same folder goes on where it stopped.
    """
    from dynsr.replicate import PAPER_NAMES
    from dynsr.replicate import replicate as run

    named = options.read_names(methods)
    found = run(
        systems=options.read_names(systems) or PAPER_NAMES,
        **({"methods": named} if named else {}),
        runs=runs,
        seed=seed,
        jobs=jobs,
        out=out,
        quick=quick,
        engine=engine,
        progress=not quiet,
    )
    del found, json


def audit(
    engine: options.Engine = "embedded",
    json: options.Json = False,
) -> None:
    """Score the 33 printed expressions of the paper again and compare digit by digit."""
    from dynsr.audit import audit as run

    rows = run(engine)
    if json:
        output.print_json(rows)
        return
    output.print_table(
        "Printed losses, scored again (agreement to every printed digit, digits cut)",
        ("system", "method", "run", "printed", "ours", "agrees", "corrected", "note"),
        [
            (r.system, r.method, r.run, r.printed, r.ours, r.agrees, r.corrected, r.note)
            for r in rows
        ],
    )
    agreeing = sum(row.agrees for row in rows)
    typer.echo(f"{agreeing} of {len(rows)} printed losses agree to every printed digit.")
