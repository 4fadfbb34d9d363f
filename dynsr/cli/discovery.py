"""Discovery: find the equations behind data, show them, and say where the files are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from dynsr.cli import options, output
from dynsr.cli.data import (
    load_table,
    read_doses,
    read_equations,
    split_inputs,
    take_doses,
)
from dynsr.cli.output import Notes
from dynsr.cli.progress import SearchProgress
from dynsr.cli.results import check_keeping, keep, keep_report, score_discovery, summarise
from dynsr.engines import DEFAULT_ENGINE
from dynsr.errors import InputError
from dynsr.methods import AUTO, DEFAULT_PRESET, PAPER_METHODS

if TYPE_CHECKING:
    from dynsr.data import Trajectory
    from dynsr.discovery import Discovery
    from dynsr.methods import AbstractMethod

# Name in the scores -> heading, what it means.
_SCORES = {
    "slope_rmse": ("slope error", "rms error of the equation against the slopes of the data"),
    "step_rmse": ("step error", "rms error of the equations over one row"),
    "step_size": ("share", "its mean square in units of what the noise adds up to"),
    "forecast": ("forecast error", "median error of short forecasts, 1 = the state's spread"),
    "trajectory_rmse": ("trajectory error", "rms error of one integration over the whole data"),
    "equation_rmse": ("true slope error", "error against the true equation on the test span"),
    "printed_loss": ("paper's loss", "the loss as the paper's tables were made"),
    "trajectory_loss": ("test error", "error of an integration over the test span"),
}


# Level of a verdict -> colour of the frame around it and the equations.
_COLOURS = {"law": "green", "approximation": "yellow", "not found": "red"}


def show_equations(found: Discovery, quiet: bool = False) -> None:
    """Print the verdict and the equations; quiet, as plain lines."""
    from dynsr.discovery import write_lines

    lines = write_lines(found.equations, found.settings)
    if quiet:
        output.print_lines(found.heading, *lines)
    else:
        _print_equations(found, lines)


def show_reasons(
    found: Discovery,
    scores: Mapping[str, Any],
    told: Mapping[str, Sequence[str]],
    details: bool = False,
) -> None:
    """Print what the heading does not: doubts, constants, an ensemble, scores, warnings.

    With details, the reason of every verdict, the fitted constants, how formulas compared in bits,
    and how the columns were understood.
    """
    for state, words in found.explanation.items():
        said = words.strip() if details or not found.verdict.tested else _doubt(found, state)
        if said:
            _say(said if said.startswith(f"{state}' =") else f"{state}: {said}")
    for own in found.delays.values():
        _say(f"{own.text}.")
    for words in found.free.sentences:
        _say(words)
    # Details have these in the reasons.
    for words in () if details else (*found.hidden_notes.values(), *found.noise_notes.values()):
        _say(words)
    from dynsr.discovery import explain_order

    if not details and (positions := found.settings.get("order_by_data")):
        _say(explain_order(positions))
    _print_constants(found, details)
    for words in found.volume_notes:
        _say(words)
    for state, kept in found.ensemble.items():
        _say(f"{state}', ensemble: " + "; ".join(one.text for one in kept))
    for words in found.details.values() if details else ():
        _say(words)
    if scores:
        from dynsr.discovery import name_windows

        _print_scores(scores, name_windows(found.settings))
    # What is on the screen already is not shown again.
    again = ("guessed", "warned") if details else ("warned",)
    for kind in () if output.is_one_place() else again:
        for item in told.get(kind, ()):
            _say(f"{kind}: {item}", "dim")


def _doubt(found: Discovery, state: str) -> str:
    """Give why an equation is no law, unless the heading says so, and what is to be known of it."""
    own = found.verdict.states.get(state)
    if own is None or own.level == "law":
        return ""
    # States of one level share a reason in the heading, but for their numbers.
    shared = own.level == found.verdict.level and _bare(own.reason) in _bare(found.heading)
    reason = "" if shared else f"{own.level}; {own.reason}"
    # Notes follow the name of the method.
    notes = found.explanation[state].partition("Found by ")[2].partition(".")[2]
    return f"{reason} {notes.strip()}".strip()


def _bare(words: str) -> str:
    return re.sub(r"[\d.]+", "", words)


def _say(words: str, style: str = "") -> None:
    screen = output.console()
    screen.print(Text(words, style=style), soft_wrap=not screen.is_terminal)


def _print_equations(found: Discovery, lines: Sequence[str]) -> None:
    """Print the verdict and below it the equations, on a terminal in one frame."""
    screen = output.console()
    if screen.is_terminal:
        colour = _COLOURS.get(found.verdict.level if found.verdict.tested else "", "blue")
        block = Group(
            Text(found.heading, style=f"bold {colour}"),
            "",
            Text("\n".join(lines), style="bold"),
        )
        screen.print(Panel(block, border_style=colour, expand=False))
    else:
        _say(found.heading)
        output.print_lines(*lines)


def _print_constants(found: Discovery, details: bool = False) -> None:
    """Print the constants in the order of the formulas, each with its interval and its unit.

    An interval means something only where the equation follows the data. With details, constants
    of other equations are shown too, and all as they were fitted, before they became simple.
    """
    if found.by_run.constants:
        output.console().print()
        output.console().print(Text(str(found.by_run)), soft_wrap=True)
    wrong = {s for s, own in found.verdict.states.items() if own.level == "not found"}
    in_units = "column_units" in found.settings
    units = found.constant_units if in_units else {}
    rows = [
        (s, one, unit)
        for s, own in found.constants.items()
        for one, unit in zip(own, units.get(s, [""] * len(own)), strict=True)
        if not one.fixed and (details or s not in wrong)
    ]
    if not rows:
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    left = ("", "constant of", "unit")
    fitted = ("fitted",) if details else ()
    for heading in (*left[:2], "value", *fitted, "95 % interval", *(left[2:] if in_units else ())):
        table.add_column(heading, justify="left" if heading in left else "right")
    for state, one, unit in rows:
        cells = [f"{state}'", one.of, f"{one.value:.6g}"]
        cells += [one.fitted_text] if details else []
        cells += [one.interval_text, *([unit] if in_units else [])]
        table.add_row(*map(Text, cells))
    screen = output.console()
    screen.print()
    screen.print(table)


def by_state(scores: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Give {state: {score: value}} from the scores on the data and against the truth.

    >>> by_state({"data": {"x": {"forecast": 0.1}}, "truth": {"x": {"printed_loss": 2.0}}})
    {'x': {'forecast': 0.1, 'printed_loss': 2.0}}
    """
    from dynsr.jobs import to_plain

    rows: dict[str, dict[str, Any]] = {}
    for part in scores.values():
        for state, values in to_plain(part).items():
            rows.setdefault(state, {}).update(values)
    return rows


def _print_scores(scores: Mapping[str, Any], windows: str) -> None:
    rows = by_state(scores)
    names = [name for name in _SCORES if any(name in row for row in rows.values())]
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    for name in names:
        table.add_column(_SCORES[name][0], justify="right")
    for state, row in rows.items():
        table.add_row(f"{state}'", *(_number(row.get(name)) for name in names))
    screen = output.console()
    screen.print()
    screen.print(table)
    meanings = "; ".join(f"{_SCORES[name][0]}: {_SCORES[name][1]}" for name in names)
    meanings += f"; the data here are {windows}" if windows else ""
    screen.print(Text(meanings, style="dim"), soft_wrap=not screen.is_terminal)


def _number(value: Any) -> str:
    return "diverges" if value is None else f"{value:.3g}"


def show_files(found: Discovery, saved: Sequence[Path], folder: Path | None) -> None:
    """Say on stderr how long it took, where the files are, and how to go on after an interrupt."""
    from dynsr.data import DATA
    from dynsr.discovery import name_windows

    output.note(f"{found.seconds:.1f} s")
    windows = name_windows(found.settings)
    kept = [
        f"{path.name} ({windows})" if windows and path.name == DATA else path.name
        for path in saved
        if path.suffix != ".html"
    ]
    pages = [f"open {path}" for path in saved if path.suffix == ".html"]
    if saved:
        output.note("; ".join([f"saved in {folder}: {', '.join(kept)}", *pages]))
    if not found.complete:
        where = f"what is finished is kept in {folder}; " if folder is not None else ""
        goes_on = "the same command goes on from there" if where else "with --out it could go on"
        output.note(f"interrupted: these are the best equations so far; {where}{goes_on}")


def discover(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILE]...",
            help="Text (CSV), Excel (book.xlsx:Sheet), Parquet, JSON, .mat, .h5, .nc, .npz. "
            "Several files are several runs, or one experiment if they share no state. A table of "
            "a row for each run gives its parameters. Cells may be empty.",
        ),
    ] = None,
    system: Annotated[
        str | None,
        typer.Option(
            help="Use the data of a known system instead.",
            autocompletion=options.complete_system,
            rich_help_panel=options.DATA,
        ),
    ] = None,
    time_column: options.TimeColumn = None,
    states: options.StateColumns = None,
    inputs: options.Inputs = None,
    hold: options.Hold = None,
    doses: options.Doses = None,
    noise: options.KnownNoise = None,
    limits: options.Limits = None,
    observed: options.Observed = None,
    trajectory: options.TrajectoryColumn = None,
    quantity: options.Quantity = None,
    decimal: options.Decimal = None,
    missing: options.Missing = None,
    method: options.MethodName = AUTO,
    preset: options.Preset = DEFAULT_PRESET,
    targets: Annotated[
        options.Names,
        typer.Option(
            "--targets",
            "--target",
            help="States to find; all by default.",
            autocompletion=options.complete_column,
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    known: Annotated[
        options.Names,
        typer.Option(
            help='Part of an equation that is known: "y\'=-3*y". A function that has no other '
            'meaning is found, or stays a curve: "x\'=a - f(x)*y". Then the equation is whole, and '
            "a name that is no column is a constant.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    scheme: Annotated[
        str | None,
        typer.Option(
            help="How slopes are estimated: auto (the data choose), forward, central4, weak, ... "
            "The default is auto; with preset paper it is forward.",
            autocompletion=options.complete_scheme,
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    snap: Annotated[
        bool,
        typer.Option(
            "--snap/--no-snap",
            help="Round constants to simple numbers where the data allow it, or leave them as "
            "fitted.",
            rich_help_panel=options.SEARCH,
        ),
    ] = True,
    order: Annotated[
        options.Names,
        typer.Option(
            help="2 for equations x'' = f(x, x', ...), of all states or of one: x=2. By default "
            "the data decide.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    explicit_time: Annotated[
        bool,
        typer.Option(
            "--explicit-time",
            help="Let equations contain the time t.",
            rich_help_panel=options.SEARCH,
        ),
    ] = False,
    discrete: Annotated[
        bool,
        typer.Option(
            "--map",
            help="Find a map x(n+1) = f(x(n)) from row to row instead of slopes.",
            rich_help_panel=options.SEARCH,
        ),
    ] = False,
    functions: options.Functions = None,
    max_complexity: options.MaxComplexity = None,
    complexity: options.Complexity = None,
    loss: options.Loss = None,
    terms: options.Terms = None,
    must: options.Must = None,
    constraints: options.Constraint = None,
    conserved: options.Conserved = None,
    nonnegative: options.Nonnegative = None,
    units: options.Units = None,
    time_budget: options.TimeBudget = None,
    vary: options.Vary = None,
    delays: options.Delays = None,
    hidden: options.Hidden = None,
    stochastic: Annotated[
        bool,
        typer.Option(
            "--stochastic",
            help="Noise is in the motion itself: find its drift, and the variance of the noise.",
            rich_help_panel=options.SEARCH,
        ),
    ] = False,
    ensemble: Annotated[
        bool,
        typer.Option(
            "--ensemble",
            help="Report how often each term is kept in fits to data drawn with replacement.",
            rich_help_panel=options.SEARCH,
        ),
    ] = False,
    start: Annotated[
        Path | None,
        typer.Option(
            help="Start from the formulas of an earlier discovery: its discovery.json or folder.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = -1,
    engine: options.Engine = DEFAULT_ENGINE,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder for discovery.json, report.html and a copy of the data; by default it is "
            "named after the file, data-dynsr.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    batch: Annotated[
        bool,
        typer.Option(
            "--batch",
            help="Each file is a system of its own: find the equations of each, and make a table. "
            "The same command continues; files may be added.",
            rich_help_panel=options.SEARCH,
        ),
    ] = False,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Spread the search, or the files of a batch, over the workers of a Dask "
            "scheduler: tcp://node1:8786.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    details: Annotated[
        bool,
        typer.Option(
            "--details",
            help="Report also the reasons, errors, fitted constants and the bits of other "
            "formulas.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    json: options.Json = False,
    quiet: Annotated[
        bool,
        typer.Option(
            "--quiet",
            "-q",
            help="Print only the verdict, the equations and warnings.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
) -> None:
    """Find the equation of every state from data, and check it by integration.

    The roles of the columns are guessed and shown; --time, --states, --inputs and --trajectory
    change them. Ctrl-C ends the search with the best equations so far.
    """
    from dynsr.engines import find_engine
    from dynsr.jobs import on_cluster

    # An engine that is unknown or absent is reported before anything is read.
    find_engine(engine)
    if bool(files) == bool(system):
        raise InputError("give a file of data or --system, one of the two")
    columns, formulas = split_inputs(inputs)
    asked: dict[str, Any] = {
        "method": _choose_methods(method, preset, system),
        "preset": preset,
        "scheme": scheme,
        "targets": options.read_names(targets, "--targets") or "all",
        "observed": options.read_observed(observed),
        "known": read_equations(known) if known else None,
        "snap": snap,
        "order": options.read_orders(order) if order else None,
        "explicit_time": explicit_time,
        "discrete": discrete,
        "functions": options.read_functions(functions),
        "max_complexity": max_complexity,
        "loss": loss,
        "complexity": options.read_pairs(complexity, "--complexity"),
        "terms": options.read_names(terms) or (),
        "must": options.read_names(must),
        "constraints": options.read_names(constraints),
        "conserved": options.read_names(conserved) or (),
        "nonnegative": options.read_names(nonnegative) or (),
        "units": units,
        "time_budget": time_budget,
        "vary": options.read_vary(vary),
        "delays": options.read_delays(delays),
        "hidden": hidden or False,
        "stochastic": stochastic,
        "ensemble": ensemble,
        "start": start,
        "seed": seed,
        "engine": engine,
    }
    if batch:
        if system:
            raise InputError("--batch goes with files of data; leave --system out")
        said, table = read_doses(doses)
        asked |= {
            "time": time_column,
            "states": options.read_names(states, "--states"),
            "inputs": inputs and [*(columns or []), *(f"{n}={e}" for n, e in formulas.items())],
            "trajectory": trajectory,
            "hold": options.read_hold(hold),
            "quantity": quantity,
            "decimal": decimal,
            "missing": missing,
            "noise": options.read_noise(noise),
            "limits": options.read_limits(limits),
            "doses": said,
            "dose_table": table,
        }
        with on_cluster(cluster):
            _discover_each(files or [], out, asked, jobs, json, quiet)
        return
    notes = Notes(quiet)
    with notes:
        given_doses = options.read_doses(doses) if system else None
        if files:
            sources, given_doses = take_doses(files, doses, time_column, trajectory, decimal)
            data = load_table(
                sources,
                time_column,
                states,
                columns,
                trajectory,
                hold,
                quantity,
                decimal,
                missing,
                notes.say,
                noise,
                given_doses,
                limits,
            )
        else:
            given = [*(columns or []), *formulas]
            given_beside = [*(hold or []), *(doses or []), *(noise or []), *(limits or [])]
            _refuse_columns(
                time_column, states, trajectory, given, given_beside, quantity, decimal, missing
            )
            data, formulas = _training_data(str(system), engine)
        with on_cluster(cluster), SearchProgress(quiet) as progress:
            found, folder = _search_in(
                _folders(out, files[0].stem if files else str(system), json),
                data,
                progress,
                inputs=formulas or None,
                doses=given_doses,
                jobs=jobs,
                **asked,
            )
        # What was found is safe before it is shown, which nobody may read to its end; it is shown
        # also where it cannot be saved. The report takes longer than many a search.
        try:
            saved = keep(found, folder)
        finally:
            if not json:
                show_equations(found, quiet)
        saved += keep_report(found, folder)
        # A known system has a truth to compare with.
        scored = found.complete and (json or (not quiet and (details or system is not None)))
        scores = score_discovery(found, data, system, engine) if scored else {}
    if json:
        output.print_json({**summarise(found), "scores": scores, "files": saved, **notes.told})
    elif not quiet:
        show_reasons(found, scores, notes.told, details)
    if ended := found.settings.get("ended_by_budget"):
        steps = "a step" if len(ended) == 1 else f"{len(ended)} steps"
        output.note(f"warning: the time budget ended {steps} early; more seconds may find better")
    if not quiet:
        show_files(found, saved, folder)


def _discover_each(
    files: Sequence[Path],
    out: Path | None,
    asked: Mapping[str, Any],
    jobs: int,
    json: bool,
    quiet: bool,
) -> None:
    """Find the equations of each file, and print a table of them."""
    from dynsr.discovery import discover_each
    from dynsr.jobs import REPORT, to_plain

    folder = out or Path("batch-dynsr")
    output.make_folder(folder)
    with SearchProgress(quiet) as progress:
        rows = discover_each(files, folder, jobs=jobs, progress=progress, **asked)
    if json:
        output.print_json([to_plain(row) for row in rows])
        return
    cells = [
        (row.file, row.level, "\n".join(row.equations) or row.reason, f"{row.seconds:.1f}")
        for row in rows
    ]
    output.print_table("Discoveries", ("file", "verdict", "equations", "seconds"), cells)
    if not quiet:
        output.note(f"saved in {folder}: discoveries.csv; open {folder / REPORT}")


def _refuse_columns(
    time_column: str | None,
    states: options.Names,
    trajectory: str | None,
    inputs: list[str],
    hold: list[str],
    quantity: str | None,
    decimal: str | None,
    missing: str | None,
) -> None:
    """A known system has its columns; only a file leaves them open."""
    for option, value in (
        ("--time", time_column),
        ("--states", states),
        ("--trajectory", trajectory),
        ("--inputs", inputs),
        ("--hold, --dose or --noise", hold),
        ("--quantity", quantity),
        ("--decimal", decimal),
        ("--missing", missing),
    ):
        if value:
            raise InputError(f"{option} goes with a file of data; a known system has its own")


def _training_data(name: str, engine: str) -> tuple[list[Trajectory], dict[str, Any]]:
    from dynsr.data import find_system
    from dynsr.engines import training_trajectory

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
    from dynsr.jobs import FolderTaken

    taken = None
    for folder in folders:
        if taken is not None:
            progress.say(f"{str(taken).partition(';')[0]}; this one goes to {str(folder)!r}")
        try:
            if folder is not None:
                output.make_folder(folder)
                check_keeping(folder)
            return search(data, progress, out=folder, **settings), folder
        except FolderTaken as error:
            taken = error
    assert taken is not None
    raise taken


def _choose_methods(names: str, preset: str, system: str | None) -> Sequence[str | AbstractMethod]:
    """Give the paper's own settings for a system of the paper; else the names are enough."""
    from dynsr.data import find_system
    from dynsr.methods import find_method, make_method
    from dynsr.paper import is_of_paper, paper_method

    asked = options.read_names([names]) or []
    if preset != "paper" or system is None or not is_of_paper(find_system(system)):
        return asked[0] if len(asked) == 1 else asked
    ours = {find_method(name).name: name for name in PAPER_METHODS}
    chosen = ours if AUTO in asked else [find_method(name).name for name in asked]
    known = find_system(system)
    return [paper_method(ours[n], known) if n in ours else make_method(n, preset) for n in chosen]


def search(
    data: Sequence[Trajectory],
    progress: SearchProgress,
    *,
    method: str | Sequence[str | AbstractMethod],
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
