"""Discovery: find the equations behind data, score what was found, and report on it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynsr.commands import options, output
from dynsr.commands.known import read_equations
from dynsr.commands.progress import SearchProgress
from dynsr.errors import InputError

if TYPE_CHECKING:
    from dynsr.discovery import Discovery
    from dynsr.trajectory import Trajectory

Names = list[str] | None

TimeColumn = Annotated[
    str | None, typer.Option("--time", help="Time column.", rich_help_panel=options.DATA)
]
StateColumns = Annotated[
    Names, typer.Option("--states", help="State columns: x,y.", rich_help_panel=options.DATA)
]
Inputs = Annotated[
    Names,
    typer.Option(
        "--inputs",
        help='Input columns, or expressions in t: u or "F=0.5*sin(6*t)".',
        rich_help_panel=options.DATA,
    ),
]
TrajectoryColumn = Annotated[
    str | None,
    typer.Option(
        "--trajectory", help="Column that names trajectories.", rich_help_panel=options.DATA
    ),
]
MethodName = Annotated[
    str,
    typer.Option(
        "--method", help="auto, dynaifeynman, sindy or ga.", rich_help_panel=options.SEARCH
    ),
]
Preset = Annotated[
    str, typer.Option(help="best, or paper (as published).", rich_help_panel=options.SEARCH)
]
DiscoveryFile = Annotated[
    Path, typer.Argument(metavar="DISCOVERY.json", help="A discovery that was saved.")
]


def discover(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]...", help="CSV, TSV, Parquet or .npz; one or many."),
    ] = None,
    system: Annotated[
        str | None,
        typer.Option(
            help="Take the data of a known system instead.",
            autocompletion=options.complete_system,
            rich_help_panel=options.DATA,
        ),
    ] = None,
    time_column: TimeColumn = None,
    states: StateColumns = None,
    inputs: Inputs = None,
    trajectory: TrajectoryColumn = None,
    method: MethodName = "auto",
    preset: Preset = "best",
    targets: Annotated[
        Names,
        typer.Option(
            "--targets",
            "--target",
            help="States to find; all by default.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    known: Annotated[
        Names,
        typer.Option(
            help='Part of an equation that is known: "y\'=-3*y".',
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = -1,
    engine: options.Engine = "embedded",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder for discovery.json and report.html.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Find the equation of every state from data, and check them by integrating.

    Columns are guessed and the guess is shown; --time, --states, --inputs and --trajectory say
    otherwise. Ctrl-C ends the search with the best equations so far.
    """
    began = time.monotonic()
    check_engine(engine)
    if bool(files) == bool(system):
        raise InputError("give a file of data or --system, one of the two")
    folder = output.make_folder(out) if out else None
    if files:
        data = load_table(files, time_column, states, inputs, trajectory, quiet)
    else:
        data = [_training_data(str(system), engine)]
    with SearchProgress(quiet) as progress:
        found = _search(data, progress, method, preset, targets, known, seed, jobs, engine)
    seconds = time.monotonic() - began
    if folder:
        found.save(folder / "discovery.json")
        found.report(folder / "report.html")
    if json:
        output.print_json({**summarise(found), "seconds": seconds})
    else:
        show_discovery(found, seconds)
        if folder:
            output.note(f"saved: {folder / 'discovery.json'}; open: {folder / 'report.html'}")


def check_engine(engine: str) -> None:
    """Fail at once, before any search, when the engine is unknown or absent."""
    from dynsr.engines.select import find_engine

    find_engine(engine)


def load_table(
    files: Sequence[Path],
    time_column: str | None,
    states: Names,
    inputs: Names,
    trajectory: str | None,
    quiet: bool = False,
) -> list[Trajectory]:
    """Read the trajectories of files and say on stderr how their columns were understood."""
    from dynsr.tabular import read_trajectories

    table = read_trajectories(
        list(files) if len(files) > 1 else files[0],
        time_column,
        options.read_names(states),
        _read_inputs(inputs),
        trajectory,
    )
    if not quiet:
        output.note(table.guess)
    return table.trajectories


def _read_inputs(inputs: Names) -> list[str] | None:
    """Split columns at commas, but not formulas, which may hold commas of their own."""
    if inputs is None:
        return None
    formulas = [text for text in inputs if "=" in text]
    return [*formulas, *(options.read_names([t for t in inputs if "=" not in t]) or [])]


def _training_data(name: str, engine: str) -> Trajectory:
    from dynsr.catalogue import find_system
    from dynsr.simulate import training_trajectory

    return training_trajectory(find_system(name), engine)


def _search(
    data: list[Trajectory],
    progress: SearchProgress,
    method: str,
    preset: str,
    targets: Names,
    known: Names,
    seed: int,
    jobs: int,
    engine: str,
) -> Discovery:
    from dynsr.discovery import discover as search

    return search(
        data,
        method=method,
        preset=preset,
        targets=options.read_names(targets) or "all",
        known=read_equations(known) if known else None,
        seed=seed,
        jobs=jobs,
        engine=engine,
        report=progress,
    )


def load_discovery(path: Path) -> Discovery:
    """Load a saved discovery; raises InputError when the file is not one, or is cut short."""
    if path.is_dir() and (path / "discovery.json").exists():
        path = path / "discovery.json"
    if path.is_dir():
        raise InputError(f"{str(path)!r} is a directory without a discovery.json; give the file")
    if not path.exists():
        raise InputError(f"there is no file {str(path)!r}; dynsr discover --out makes one")
    from dynsr.discovery import Discovery

    return Discovery.load(path)


def summarise(found: Discovery) -> dict[str, Any]:
    """Give what a program wants of a discovery: equations, fronts, scores, provenance."""
    return {
        "equations": found.equations,
        "scores": found.scores,
        "front": found.front,
        "engine": found.engine,
        "seed": found.seed,
    }


def show_discovery(found: Discovery, seconds: float) -> None:
    """Print the equations and the words that explain the choice."""
    output.console().print(found)
    output.note(f"{seconds:.1f} s")


def score(
    model: DiscoveryFile,
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Data to score it on.")],
    time_column: TimeColumn = None,
    states: StateColumns = None,
    inputs: Inputs = None,
    trajectory: TrajectoryColumn = None,
    json: options.Json = False,
) -> None:
    """Score a saved discovery on data that it has not seen: slopes, and integrated states."""
    found = load_discovery(model)
    data = load_table(files, time_column, states, inputs, trajectory, quiet=json)
    scores = found.score(data)
    if json:
        output.print_json(scores)
        return
    plain = output.to_plain(scores)
    output.print_table(
        f"{model} on {', '.join(map(str, files))}", ("score", "value"), list(plain.items())
    )


def report(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="DISCOVERY.json|RESULTS", help="A saved discovery, or a replication's folder."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="HTML file; beside the source by default.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    json: options.Json = False,
) -> None:
    """Make one self-contained HTML report of a saved discovery or of a replication's results."""
    from dynsr.records import MANIFEST

    if (source / MANIFEST).exists():
        _report_replication(source, out, json)
        return
    found = load_discovery(source)
    target = out or (source if source.is_dir() else source.parent) / "report.html"
    found.report(target)
    if json:
        output.print_json({"report": target})
    else:
        output.note(f"open: {target}")


def _report_replication(folder: Path, out: Path | None, json: bool) -> None:
    from dynsr.commands.experiments import deliver_results, load_results
    from dynsr.records import write_text
    from dynsr.report import render_replication

    records, settings = load_results(folder)
    if out is None:
        deliver_results(folder, records, settings, json)
        return
    write_text(out, render_replication(records, settings))
    if json:
        output.print_json({"report": out})
    else:
        output.note(f"open: {out}")
