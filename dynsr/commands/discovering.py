"""Discovery: find the equations behind data, score what was found, and report on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynsr.commands import options, output
from dynsr.commands.known import read_equations
from dynsr.commands.progress import SearchProgress, best_equation
from dynsr.commands.reading import load_table, split_inputs
from dynsr.commands.saved import keep, score_discovery, show_discovery, summarise
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
    if files:
        data = load_table(files, time_column, states, columns, trajectory, quiet)
    else:
        _refuse_columns(time_column, states, trajectory, [*(columns or []), *formulas])
        data, formulas = _training_data(str(system), engine)
    folder = _choose_folder(out, files[0].stem if files else str(system), json)
    with SearchProgress(quiet) as progress:
        found = search(
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
            out=folder,
        )
    saved = keep(found, folder)
    scores = score_discovery(found, data, system, engine)
    if json:
        output.print_json({**summarise(found), "scores": scores, "files": saved})
    else:
        show_discovery(found, scores)
        for path in saved:
            output.note(f"{'open' if path.suffix == '.html' else 'saved'}: {path}")


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


def _choose_folder(out: Path | None, stem: str, json: bool) -> Path | None:
    """Give the folder to keep results in: the one asked for, or for readers one named after data.

    Programs, which read JSON, get files only where they ask for them.
    """
    if out is None and json:
        return None
    return output.make_folder(out or Path(f"{stem}-dynsr"))


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
    from dynsr.discovery import Step
    from dynsr.discovery import discover as run

    def tell(step: Step) -> None:
        progress(step.what, step.done, step.total, _best(step.record))

    progress("searching", 0, None, "")
    try:
        return run(list(data), method=method, out=out, progress=tell, **settings)
    except KeyboardInterrupt:
        if out is not None:
            progress.say(f"what is finished is kept in {out}; the same command goes on from there")
        raise


def _best(record: Mapping[str, Any]) -> str:
    """Give the best equation in the record of a finished part, as a few words."""
    from dynsr.discovery import read_candidates
    from dynsr.pareto import ParetoFront

    rivals = [rival["candidate"] for rival in record.get("rivals", [])[:1]]
    found = best_equation(ParetoFront(read_candidates(rivals or record.get("front", []))))
    return f"{record['target']}' = {found}" if found and "target" in record else found
