"""Benchmarks: how well and how fast known equations are found again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from dynsr.cli import options, output
from dynsr.cli.discovery import search
from dynsr.cli.progress import SearchProgress
from dynsr.engines import DEFAULT_ENGINE
from dynsr.errors import InputError
from dynsr.methods import AUTO, DEFAULT_PRESET

if TYPE_CHECKING:
    import sympy

    from dynsr.benchmarks import Recovery, Search
    from dynsr.data import Trajectory

BENCHMARKS = {
    "recovery": "equations of known systems found again from their data, at levels of noise",
}
_DEFAULT_SYSTEMS = ("lotka-volterra", "pendulum", "lorenz")


def benchmark(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Which one; without it, a list.")
    ] = None,
    systems: Annotated[
        list[str] | None, typer.Option(help="Systems, by commas.", rich_help_panel=options.DATA)
    ] = None,
    noise: Annotated[
        str,
        typer.Option(
            help="Noise levels, as fractions of each state's standard deviation.",
            rich_help_panel=options.DATA,
        ),
    ] = "0,0.01",
    seeds: Annotated[int, typer.Option(min=1, help="Draws of the noise at each level.")] = 1,
    method: options.MethodName = AUTO,
    preset: options.Preset = DEFAULT_PRESET,
    jobs: options.Jobs = -1,
    engine: options.Engine = DEFAULT_ENGINE,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Run a benchmark by name, or list them."""
    if name is None:
        _list(json)
        return
    if name not in BENCHMARKS:
        raise InputError(f"unknown benchmark {name!r}; the benchmarks are: {', '.join(BENCHMARKS)}")
    from dynsr.benchmarks import measure_recovery
    from dynsr.data import find_system
    from dynsr.engines import find_engine

    find_engine(engine)
    chosen = [find_system(s) for s in options.read_names(systems) or _DEFAULT_SYSTEMS]
    levels = options.read_numbers(noise, "--noise") or []
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
    typer.echo(f"{sum(row.recovered for row in rows)} of {len(rows)} equations recovered.")
