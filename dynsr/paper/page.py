"""The page of a replication: its tables, pictures and facts, and all of them as files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dynsr.data import write_bytes, write_page
from dynsr.jobs import REPORT
from dynsr.paper.provenance import ENGINES_BESIDE, MADE_BY
from dynsr.paper.records import Record
from dynsr.paper.results import (
    APPENDIX,
    FIGURE_1,
    LOSSES,
    STAGES,
    SYSTEM_TITLES,
    TABLE_2,
    all_tables,
    drawable,
    figure_1,
)
from dynsr.report import Picture, Table, render_page, write_table


def render_replication(
    records: Sequence[Record], settings: Mapping[str, Any], tables: Sequence[Table] | None = None
) -> str:
    """Give the report of a replication as one page: tables, pictures, and how it was made.

    Parameters
    ----------
    records : one for each cell.
    settings : what the cells share, as the manifest of their folder holds it.
    tables : those of :func:`dynsr.paper.results.all_tables`, if they are made already.
    """
    engine = str(settings["engine"])
    pictures = [
        Picture.of(figure_1(records, [system], engine), caption)
        for system, caption in _pictures(records)
    ]
    failed = [r for r in records if not r.done]
    tables = tables or all_tables(records, settings["recorded_steps"])

    def some(*names: str) -> list[Table]:
        return [table for table in tables if table.name.startswith(names)]

    return render_page(
        "replication.html.j2",
        summary=_summary(records),
        quick=settings["quick"],
        failures=[f"{r.system}, {r.method}, run {r.run}: {r.error}" for r in failed],
        table1=tables[0],
        table2=some(TABLE_2),
        losses=some(LOSSES),
        formulas=some(APPENDIX),
        stages=some(STAGES),
        recorded_steps=settings["recorded_steps"],
        pictures=pictures,
        made=some(MADE_BY, ENGINES_BESIDE),
        facts=_facts(records, settings),
    )


def write_results(
    folder: Path, records: Sequence[Record], settings: Mapping[str, Any]
) -> list[Path]:
    """Write the tables as CSV, Markdown and LaTeX, Figure 1 and report.html; give their paths."""
    from dynsr.report import to_bytes

    written = []
    tables = all_tables(records, settings["recorded_steps"])
    for table in tables:
        written += write_table(table, folder / "tables")
    systems, _ = drawable(records)
    if systems:
        figure = figure_1(records, systems, str(settings["engine"]))
        for kind in ("png", "pdf"):
            written.append(folder / f"figure1.{kind}")
            write_bytes(written[-1], to_bytes(figure, kind, 200), links=False)
    written.append(folder / REPORT)
    write_page(written[-1], render_replication(records, settings, tables))
    return written


def _pictures(records: Iterable[Record]) -> list[tuple[str, str]]:
    """Give the system of each picture and what it shows."""
    of_paper, others = drawable(records)
    names = {
        **dict(zip(FIGURE_1, ("Figure 1, left", "Figure 1, right"), strict=True)),
        **dict.fromkeys(others, "Not in the paper's Figure 1"),
    }
    return [
        (
            system,
            f"{names[system]}. {SYSTEM_TITLES.get(system, system)}, the state whose equation was "
            "sought: the truth, and what each method inferred over the test span.",
        )
        for system in (*of_paper, *others)
    ]


def _summary(records: Sequence[Record]) -> str:
    def some(count: int, one: str) -> str:
        return f"{count} {one}{'' if count == 1 else 's'}"

    systems, methods = {r.system for r in records}, {r.method for r in records}
    runs = max((r.run for r in records), default=0)
    return (
        f"{some(len(methods), 'method')} on {some(len(systems), 'system')}, "
        f"{some(runs, 'run')} each: {some(len(records), 'cell')}, "
        f"{sum(r.done for r in records)} with a formula."
    )


def _facts(records: Sequence[Record], settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    versions: dict[str, str] = {}
    for record in records:
        versions.update(record.versions)
    total = sum(r.seconds for r in records if r.done)
    return [
        ("command", _command(records, settings)),
        ("seed", str(settings["seed"])),
        ("engine", str(settings["engine"])),
        ("settings", "quick" if settings["quick"] else "the paper's"),
        (
            "steps of SINDy's samples",
            "recorded" if settings["recorded_steps"] else "the engine's own",
        ),
        ("time of the searches", f"{total:.0f} s, all cells together"),
        *sorted(versions.items()),
    ]


def _command(records: Sequence[Record], settings: Mapping[str, Any]) -> str:
    """Give the command that makes these records."""
    systems = ",".join(dict.fromkeys(r.system for r in records))
    methods = ",".join(dict.fromkeys(r.method for r in records))
    runs = max((r.run for r in records), default=0)
    flags = " --quick" if settings["quick"] else ""
    flags += " --recorded-steps" if settings["recorded_steps"] else ""
    return (
        f"dynsr replicate --systems {systems} --methods {methods} --runs {runs}{flags} "
        f"--seed {settings['seed']} --engine {settings['engine']}"
    )
