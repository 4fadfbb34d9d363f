"""Benchmarks: how well and how fast known equations are found again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynsr.cli import options, output
from dynsr.cli.discovery import search
from dynsr.cli.progress import SearchProgress
from dynsr.engines import DEFAULT_ENGINE
from dynsr.errors import InputError
from dynsr.methods import AUTO, DEFAULT_PRESET

if TYPE_CHECKING:
    import sympy

    from dynsr.benchmarks import Recovery, Search, ZooRecord, ZooSystem
    from dynsr.data import Trajectory

BENCHMARKS = {
    "recovery": "equations of known systems found again from their data, at levels of noise",
    "zoo": "textbook systems with noisy data, tested on their trajectories, compared with pysindy",
    "random": "the same for mechanisms of textbooks put together by chance, drawn from --seed",
    "FILE.json": "the same for the systems of a suite: a list with id, init and substituted",
}
_DEFAULT_SYSTEMS = ("lotka-volterra", "pendulum", "lorenz")
_ZOO_NOISE = "0,0.01,0.05,0.1"
_DEFAULT_NOISE = {"recovery": "0,0.01", "zoo": _ZOO_NOISE, "random": _ZOO_NOISE, "suite": "0"}


def benchmark(
    name: Annotated[
        str | None,
        typer.Argument(metavar="[NAME|FILE]", help="Which one; without it, a list."),
    ] = None,
    systems: Annotated[
        list[str] | None, typer.Option(help="Systems, by commas.", rich_help_panel=options.DATA)
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            help="Noise levels, as shares: 0,0.05. The zoo adds each in two ways: as a share of "
            "each state's standard deviation, and of each value.",
            rich_help_panel=options.DATA,
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=1, help="Draws of the noise at each level (recovery).")
    ] = 1,
    count: Annotated[
        int, typer.Option(min=1, help="How many random systems.", rich_help_panel=options.DATA)
    ] = 20,
    beyond: Annotated[
        bool,
        typer.Option(
            help="Random systems with a mechanism that no method can write.",
            rich_help_panel=options.DATA,
        ),
    ] = False,
    rows: Annotated[
        int | None,
        typer.Option(
            min=8,
            help="Rows, evenly spaced; drawn from 50 to 1000 for zoo and random, 150 for a suite.",
            rich_help_panel=options.DATA,
        ),
    ] = None,
    span: Annotated[
        float, typer.Option(help="Seconds of a suite's runs.", rich_help_panel=options.DATA)
    ] = 10.0,
    competitors: Annotated[
        list[str] | None,
        typer.Option(
            "--methods",
            help="Who searches (zoo, random, suites): dynsr,stlsq,weak.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    method: options.MethodName = AUTO,
    preset: options.Preset = DEFAULT_PRESET,
    seed: options.Seed = 0,
    jobs: options.Jobs = -1,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder that keeps every case; the next call goes on from there; not of recovery.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    engine: options.Engine = DEFAULT_ENGINE,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Run a benchmark by name, or a suite in a file, or list the benchmarks."""
    if name is None:
        _list(json)
        return
    kind = "suite" if name.lower().endswith(".json") else name
    if kind not in _DEFAULT_NOISE:
        raise InputError(f"unknown benchmark {name!r}; the benchmarks are: {', '.join(BENCHMARKS)}")
    levels = options.read_numbers(noise or _DEFAULT_NOISE[kind], "--noise") or []
    chosen = options.read_names(systems, "--systems") or []
    if kind == "recovery":
        _run_recovery(chosen, levels, seeds, method, preset, jobs, engine, json, quiet)
        return
    from dynsr.benchmarks import draw_systems, find_animals, make_methods, read_suite
    from dynsr.engines import refuse_idle

    refuse_idle(engine, f"benchmark {name} is made and scored by the embedded engine")
    if kind == "random":
        if chosen:
            raise InputError("random systems have no names yet; leave --systems out, give --count")
        animals = draw_systems(count, seed, beyond=beyond)
    else:
        animals = read_suite(name, chosen, span) if kind == "suite" else find_animals(chosen)
    rows = rows or (150 if kind == "suite" else None)
    searchers = make_methods(options.read_names(competitors) or ["dynsr"], preset, method)
    _run_zoo(animals, levels, rows, searchers, seed, jobs, out, json, quiet)


def _run_zoo(
    animals: Sequence[ZooSystem],
    levels: Sequence[float],
    rows: int | None,
    searchers: Mapping[str, Any],
    seed: int,
    jobs: int,
    out: Path | None,
    json: bool,
    quiet: bool,
) -> None:
    from dynsr.benchmarks import draw_conditions, run_zoo

    draw = partial(draw_conditions, levels=levels, seed=seed)
    if rows is not None:
        draw = partial(draw, rows=(rows,), drop=False)
    with SearchProgress(quiet) as progress:
        records = run_zoo(
            animals, searchers, draw, seed=seed, jobs=jobs, out=out, progress=progress
        )
    _deliver_zoo(records, json)


def _deliver_zoo(records: Sequence[ZooRecord], json: bool) -> None:
    from dynsr.benchmarks import score_table, verdict_table

    tables = [score_table(records), verdict_table(records)]
    if json:
        found = {t.name: [dict(zip(t.columns, row, strict=True)) for row in t.rows] for t in tables}
        output.print_json({"cases": [{**vars(r), "right": r.right} for r in records], **found})
        return
    for table in tables:
        if table.rows:
            output.console().print(table.to_rich())


def _run_recovery(
    systems: Sequence[str],
    levels: Sequence[float],
    seeds: int,
    method: str,
    preset: str,
    jobs: int,
    engine: str,
    json: bool,
    quiet: bool,
) -> None:
    from dynsr.benchmarks import measure_recovery
    from dynsr.data import find_system
    from dynsr.engines import find_engine

    find_engine(engine)
    chosen = [find_system(s) for s in systems or _DEFAULT_SYSTEMS]
    rows: list[Recovery] = []
    with SearchProgress(quiet) as progress:
        find = _make_search(progress, method, preset, jobs, engine)
        for row in measure_recovery(chosen, find, levels, range(seeds), engine):
            rows.append(row)
            if not quiet:
                progress.say(_line(row))
    _deliver(rows, json)


def _list(json: bool) -> None:
    if json:
        output.print_json([{"name": name, "what": what} for name, what in BENCHMARKS.items()])
    else:
        output.print_table("Benchmarks", ("name", "what it measures"), list(BENCHMARKS.items()))


def _make_search(
    progress: SearchProgress, method: str, preset: str, jobs: int, engine: str
) -> Search:
    def find(data: Trajectory, seed: int) -> Mapping[str, sympy.Expr]:
        found = search(
            [data], progress, method=method, preset=preset, seed=seed, jobs=jobs, engine=engine
        )
        return found.equations

    return find


def _line(row: Recovery) -> str:
    verdict = "recovered" if row.recovered else f"not recovered ({row.found[:80]})"
    return f"{row.system} {row.state}' at noise {row.noise:g}, seed {row.seed}: {verdict}"


def _deliver(rows: Sequence[Recovery], json: bool) -> None:
    if json:
        output.print_json([{**asdict(row), "recovered": row.recovered} for row in rows])
        return
    output.print_table(
        "Equations found again (form exact, constants within 2 %)",
        ("system", "state", "noise", "seed", "recovered", "constants off", "seconds"),
        [
            (
                row.system,
                row.state,
                row.noise,
                row.seed,
                "yes" if row.recovered else "no",
                row.constants_off if row.same_form else None,
                row.seconds,
            )
            for row in rows
        ],
    )
    output.print_lines(f"{sum(row.recovered for row in rows)} of {len(rows)} equations recovered.")
