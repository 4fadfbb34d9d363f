"""The paper: its experiment run again, and its printed numbers scored again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynsr.cli import options, output
from dynsr.cli.progress import SearchProgress
from dynsr.engines import DEFAULT_ENGINE
from dynsr.errors import InputError
from dynsr.methods import PAPER_METHODS

if TYPE_CHECKING:
    from dynsr.paper import AuditRow, Record


def replicate(
    systems: Annotated[
        options.Names, typer.Option(help="Systems, by commas; the paper's three by default.")
    ] = None,
    methods: Annotated[
        options.Names, typer.Option(help=f"{', '.join(PAPER_METHODS)}; all three by default.")
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
    recorded_steps: Annotated[
        bool,
        typer.Option(help="Take the steps that the solver of 2021 took, for SINDy's samples."),
    ] = False,
    engine: options.Engine = DEFAULT_ENGINE,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Run the paper's experiment again: Table 1, the appendix tables, Figure 1 and a report.

    If it is stopped, the next call with the same folder continues.
    """
    from dynsr.paper import PAPER_NAMES
    from dynsr.paper import replicate as run

    try:
        with SearchProgress(quiet) as progress:
            progress.say_start(engine)
            found = run(
                systems=options.read_names(systems, "--systems") or PAPER_NAMES,
                methods=options.read_names(methods, "--methods") or PAPER_METHODS,
                runs=runs,
                seed=seed,
                jobs=jobs,
                out=out,
                quick=quick,
                recorded_steps=recorded_steps,
                engine=engine,
                progress=progress,
                # They are written where they are shown.
                report=False,
            )
    except KeyboardInterrupt:
        if not quiet:
            output.note(f"finished cells are kept in {out}; the same command goes on from there")
        raise
    deliver_results(found.folder, found.records, found.settings, json)


def deliver_results(
    folder: Path, records: Sequence[Record], settings: Mapping[str, Any], json: bool
) -> None:
    """Write every table, figure and the report of a replication, and show its Table 1."""
    from dynsr.jobs import REPORT
    from dynsr.paper import loss_table, table_1, write_results

    written = write_results(folder, records, settings)
    table = table_1(records)
    if json:
        output.print_json(
            {
                "settings": settings,
                "table_1": table.to_records(),
                "losses": loss_table(records).to_records(),
                "records": records,
                "files": written,
            }
        )
        return
    output.console().print(table.to_rich())
    for record in records:
        if not record.done:
            output.note(f"failed: {record.system} {record.method} {record.run}: {record.error}")
    output.note(f"open: {folder / REPORT}")


def load_results(folder: Path) -> tuple[list[Record], dict[str, Any]]:
    """Load the records and the settings of a replication from its folder.

    Raises InputError when the folder has no results, RecordError when a file is damaged.
    """
    from dynsr.jobs import read_manifest, read_record
    from dynsr.paper import Record

    settings = read_manifest(folder, "replication")
    records = [read_record(p, Record)[0] for p in sorted((folder / "cells").glob("[!.]*.json"))]
    if not records:
        raise InputError(f"{str(folder)!r} has no finished cell; run dynsr replicate first")
    return records, settings


def audit(
    engine: options.Engine = DEFAULT_ENGINE,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Score the 33 printed expressions of the paper again and compare digit by digit."""
    from dynsr.paper import audit as run

    with SearchProgress(quiet) as progress:
        progress.say_start(engine)
        rows = run(engine, progress=progress)
    if json:
        output.print_json(rows)
        return
    output.print_table(
        "Printed losses, scored again",
        ("system", "method", "run", "printed", "ours", "agrees", "corrected", "note"),
        [
            (
                row.system,
                row.method,
                row.run,
                row.printed_digits,
                f"{row.ours:.6g}",
                "yes" if row.agrees else "no",
                row.corrected,
                _unrounded(row),
            )
            for row in rows
        ],
    )
    agreeing = sum(row.agrees for row in rows)
    output.print_lines(
        f"{agreeing} of {len(rows)} printed losses agree to every printed digit (cut)."
    )


def _unrounded(row: AuditRow) -> str:
    if row.unrounded is None:
        return row.note
    return f"{row.note} unrounded: {row.unrounded_expression}, loss {row.unrounded:.6g}".strip()
