"""Discovery: find the equations behind data, score what was found, and report on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynsr.commands import options, output
from dynsr.commands.known import read_equations
from dynsr.commands.notes import Notes
from dynsr.commands.progress import SearchProgress
from dynsr.commands.reading import load_table, split_inputs
from dynsr.commands.saved import keep, score_discovery, summarise
from dynsr.commands.showing import show_discovery, show_files
from dynsr.errors import InputError

if TYPE_CHECKING:
    from dynsr.discovery import Discovery
    from dynsr.methods.base import AbstractMethod
    from dynsr.trajectory import Trajectory


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
    time_column: options.TimeColumn = None,
    states: options.StateColumns = None,
    inputs: options.Inputs = None,
    trajectory: options.TrajectoryColumn = None,
    method: options.MethodName = "auto",
    preset: options.Preset = "best",
    targets: Annotated[
        options.Names,
        typer.Option(
            "--targets",
            "--target",
            help="States to find; all by default.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    known: Annotated[
        options.Names,
        typer.Option(
            help='Part of an equation that is known: "y\'=-3*y".',
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    scheme: Annotated[
        str | None,
        typer.Option(
            help="How slopes are made: auto, forward, central4, ... The data choose by default.",
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
    check_engine(engine)
    if bool(files) == bool(system):
        raise InputError("give a file of data or --system, one of the two")
    columns, formulas = split_inputs(inputs)
    notes = Notes(quiet)
    with notes:
        if files:
            data = load_table(files, time_column, states, columns, trajectory, notes.say)
        else:
            _refuse_columns(time_column, states, trajectory, [*(columns or []), *formulas])
            data, formulas = _training_data(str(system), engine)
        with SearchProgress(quiet) as progress:
            found, folder = _search_in(
                _folders(out, files[0].stem if files else str(system), json),
                data,
                progress,
                method=_choose_method(method, preset, system, engine),
                preset=preset,
                scheme=scheme or ("forward" if preset == "paper" else "auto"),
                targets=options.read_names(targets) or "all",
                inputs=formulas or None,
                known=read_equations(known) if known else None,
                seed=seed,
                jobs=jobs,
                engine=engine,
            )
        saved = keep(found, folder)
        scores = score_discovery(found, data, system, engine) if found.complete else {}
    if json:
        output.print_json({**summarise(found), "scores": scores, "files": saved, **notes.told})
    else:
        show_discovery(found, scores, notes.told, quiet)
    if not quiet:
        show_files(found, saved, folder)


def check_engine(engine: str) -> None:
    """Fail at once, before any search, when the engine is unknown or absent."""
    from dynsr.engines.select import find_engine

    find_engine(engine)


def _refuse_columns(
    time_column: str | None, states: options.Names, trajectory: str | None, inputs: list[str]
) -> None:
    """A known system has its columns; only a file leaves them open."""
    for option, value in (
        ("--time", time_column),
        ("--states", states),
        ("--trajectory", trajectory),
        ("--inputs", inputs),
    ):
        if value:
            raise InputError(f"{option} goes with a file of data; a known system has its own")


def _training_data(name: str, engine: str) -> tuple[list[Trajectory], dict[str, Any]]:
    from dynsr.catalogue import find_system
    from dynsr.simulate import training_trajectory

    system = find_system(name)
    return [training_trajectory(system, engine)], dict(system.inputs)


def _folders(out: Path | None, stem: str, json: bool) -> Iterator[Path | None]:
    """Give the folder asked for; or for readers those named after the data, in their order.

    Programs, which read JSON, get files only where they ask for them.
    """
    if out is not None or json:
        yield out
        return
    yield Path(f"{stem}-dynsr")
    for number in count(2):
        yield Path(f"{stem}-dynsr-{number}")


def _search_in(
    folders: Iterator[Path | None],
    data: Sequence[Trajectory],
    progress: SearchProgress,
    **settings: Any,
) -> tuple[Discovery, Path | None]:
    """Search, with results in the first of the folders that is not another discovery's."""
    from dynsr.checkpoint import FolderTaken

    taken = None
    for folder in folders:
        if folder is not None:
            output.make_folder(folder)
        if taken is not None:
            progress.say(f"{str(taken).partition(';')[0]}; this one goes to {str(folder)!r}")
        try:
            return search(data, progress, out=folder, **settings), folder
        except FolderTaken as error:
            taken = error
    assert taken is not None
    raise taken


def _choose_method(
    method: str, preset: str, system: str | None, engine: str
) -> str | list[AbstractMethod]:
    """Give the paper's own settings for a system of the paper; else the name is enough."""
    from dynsr.catalogue import PAPER_SYSTEMS
    from dynsr.methods.select import METHODS, make_method

    ours = preset == "paper" and system in [known.name for known in PAPER_SYSTEMS]
    if not ours or (method != "auto" and method not in METHODS):
        return method
    names = METHODS if method == "auto" else (method,)
    made = [make_method(name, preset, system) for name in names]
    # Methods are frozen dataclasses of settings, which their interface does not say.
    return [replace(m, engine=engine) if hasattr(m, "engine") else m for m in made]  # type: ignore[type-var]


def search(
    data: Sequence[Trajectory],
    progress: SearchProgress,
    *,
    method: str | list[AbstractMethod],
    out: Path | None = None,
    **settings: Any,
) -> Discovery:
    """Run a discovery and show its progress; what is finished is kept in ``out``."""
    from dynsr.discovery import discover as run

    try:
        return run(list(data), method=method, out=out, progress=progress, **settings)
    except KeyboardInterrupt:
        if out is not None:
            progress.say(f"what is finished is kept in {out}; the same command goes on from there")
        raise
