"""Saved discoveries: keep them, show them, score them on other data, and report on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynsr.cli import options, output
from dynsr.cli.data import load_discovery, load_table, read_doses, take_doses
from dynsr.errors import InputError

if TYPE_CHECKING:
    from dynsr.data import Trajectory
    from dynsr.discovery import Discovery

DiscoveryFile = Annotated[
    Path, typer.Argument(metavar="DISCOVERY.json", help="A discovery that was saved.")
]
OwnData = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[FILE]...",
        help="The data that it was found in; by default data.csv next to the discovery.",
    ),
]


def check_keeping(folder: Path) -> None:
    """Raise FolderTaken where what is to be kept would replace what dynsr did not write."""
    from dynsr.data import DATA, check_replaceable, is_own_page
    from dynsr.discovery import RECORD, is_own_data, is_own_record
    from dynsr.jobs import REPORT, FolderTaken

    try:
        check_replaceable(folder / RECORD, is_own_record)
        check_replaceable(folder / DATA, is_own_data(folder))
        check_replaceable(folder / REPORT, is_own_page)
    except InputError as error:
        raise FolderTaken(str(error)) from None


def keep(found: Discovery, folder: Path | None) -> list[Path]:
    """Save a discovery and its data in a folder; gives the files.

    One cut short replaces no complete one.
    """
    from dynsr.data import DATA
    from dynsr.discovery import keep as save

    if folder is None:
        return []
    files = save(found, folder)
    if files and found.trajectories and folder / DATA not in files:
        output.note("the data are too many to copy; commands on this discovery need their file")
    return files


def keep_report(found: Discovery, folder: Path | None) -> list[Path]:
    """Write the report of a discovery that was not cut short; gives the file."""
    from dynsr.jobs import REPORT

    return [] if folder is None or not found.complete else [found.report(folder / REPORT)]


def score_discovery(
    found: Discovery, data: Sequence[Trajectory], system: str | None, engine: str
) -> dict[str, Any]:
    """Score on the data, and for a known system against the truth by every loss that it has.

    Of long records, whose windows were searched, these are the data.
    """
    from dynsr.discovery import name_windows

    scored = found.trajectories if name_windows(found.settings) else data
    scores: dict[str, Any] = {"data": found.score(list(scored))}
    if system is not None:
        from dynsr.data import find_system
        from dynsr.paper import score_as_printed

        truth = find_system(system)
        method = ",".join(found.settings.get("methods", ()))
        scores["truth"] = {
            state: score_as_printed(truth, [expr], method, target=state, engine=engine)[0].losses
            for state, expr in found.equations.items()
        }
    return scores


def summarise(found: Discovery) -> dict[str, Any]:
    """Give what a program wants of a discovery: equations, verdict, constants, provenance."""
    from dynsr.discovery import write_lines

    return {
        "kind": found.settings.get("kind", "flow"),
        "equations": found.equations,
        "text": write_lines(found.equations, found.settings),
        "verdict": {
            "system": found.verdict.level,
            "reason": found.verdict.reason,
            "span": found.verdict.span,
            "states": found.verdict.states,
        }
        if found.verdict.tested
        else None,
        "constants": found.constants,
        "errors": found.errors,
        "front": {state: front.candidates for state, front in found.front.items()},
        "explanation": found.explanation,
        "details": found.details,
        "ensemble": found.ensemble,
        **({"by_run": found.by_run} if found.by_run.runs else {}),
        **({"delays": found.delays} if found.delays else {}),
        **({"volumes": found.volumes} if found.volumes else {}),
        **({"free": found.free} if found.free.parts else {}),
        **({"hidden": found.hidden_notes} if found.hidden else {}),
        **({"diffusion": found.diffusion} if found.diffusion else {}),
        "inputs": found.inputs,
        "settings": found.settings,
        "seconds": found.seconds,
        "complete": found.complete,
        "engine": found.settings["engine"],
        "seed": found.settings["seed"],
    }


def flatten(scores: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Give nested scores as lines of a table.

    >>> list(flatten({"data": {"x": 1.0}, "rows": 3}))
    [('data x', 1.0), ('rows', 3)]
    """
    if isinstance(scores, Mapping):
        for key, value in scores.items():
            yield from flatten(value, f"{name} {key}".strip())
    else:
        yield name, scores


def score(
    model: DiscoveryFile,
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILE]...", help="Data to score it on; by default those that it was found in."
        ),
    ] = None,
    time_column: options.TimeColumn = None,
    states: options.StateColumns = None,
    inputs: options.Inputs = None,
    hold: options.Hold = None,
    trajectory: options.TrajectoryColumn = None,
    quantity: options.Quantity = None,
    decimal: options.Decimal = None,
    missing: options.Missing = None,
    engine: options.OwnEngine = None,
    doses: options.Doses = None,
    json: options.Json = False,
) -> None:
    """Score a saved discovery on data that it has not seen: slopes, and integrated states."""
    found = load_discovery(model)
    how = (trajectory, hold, quantity, decimal, missing, _say_to(json))
    data = _load_for(found, files, time_column, states, inputs, doses, how)
    scores = found.score(data, engine, options.read_hold(hold))
    if json:
        output.print_json(scores)
        return
    rows = [(name, _told(value)) for name, value in flatten(scores)]
    output.print_table(f"{model} on {_names(files)}", ("score", "value"), rows)


def _load_for(
    found: Discovery,
    files: Sequence[Path] | None,
    time_column: str | None,
    states: options.Names,
    inputs: options.Names,
    doses: options.Names,
    how: tuple[Any, Any, Any, Any, Any, Any],
) -> list[Trajectory] | None:
    """Read files with the columns of a discovery, where they have them and no others are named.

    Without files it is None, for the data of the discovery itself.
    """
    from dynsr.data import clean_doses, cut_at_doses

    if not files:
        if any((time_column, states, inputs, doses, *how[:-1])):
            raise InputError("options on how data are read go with a file; name it")
        if not found.trajectories:
            raise InputError("the data are not next to the discovery; name their file")
        return None
    trajectory, _, _, decimal, _, say = how
    said, _ = read_doses(doses)
    sources, of_table = take_doses(files, doses, time_column, trajectory, decimal)
    asked = found.columns_asked if states is None and inputs is None else {}
    own = (asked["states"], asked["inputs"]) if asked else (states, inputs)

    def load(given: dict[str, str] | None) -> list[Trajectory]:
        runs = load_table(sources, time_column, *own, *how, doses=given)
        return cut_at_doses(runs, clean_doses(given) or None)

    if said:
        return load(said)
    if asked:
        # Other data may have no doses, or other columns.
        for given in [*filter(None, (found.doses, of_table)), None]:
            with suppress(InputError):
                runs = load(given)
                if found.doses and given is None:
                    columns = ", ".join(found.doses.values())
                    say(f"no doses ({columns}) are in the data; --doses gives a table of them")
                return runs
    return load_table(sources, time_column, states, inputs, *how)


def profile(
    model: DiscoveryFile,
    files: OwnData = None,
    constant: Annotated[
        list[str] | None,
        typer.Option(
            "--constant",
            help="A parameter such as k1, or state and place of a constant, x:1 (may be repeated);"
            " by default all.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    time_column: options.TimeColumn = None,
    states: options.StateColumns = None,
    inputs: options.Inputs = None,
    hold: options.Hold = None,
    trajectory: options.TrajectoryColumn = None,
    quantity: options.Quantity = None,
    decimal: options.Decimal = None,
    missing: options.Missing = None,
    doses: options.Doses = None,
    json: options.Json = False,
) -> None:
    """Show how well the data determine each constant: its profile likelihood.

    The constant is fixed at the values of a grid, and all others are fitted again. The interval
    ends where the fit becomes clearly worse. If it never does, that side is open. Then the command
    reports which parameters and combinations data of this kind can determine at all.
    """
    found = load_discovery(model)
    how = (trajectory, hold, quantity, decimal, missing, _say_to(json))
    data = _load_for(found, files, time_column, states, inputs, doses, how)
    named = [found.profile(one, data) for one in constant or ()]
    profiles = named or found.profiles(data)
    known = found.identifiability(data)
    if json:
        output.print_json({"profiles": profiles, "identifiability": known})
        return
    rows = [
        (own.state, own.index, own.of, own.value, own.interval_text, own.wald_text)
        for own in profiles
    ]
    names = ("state", "place", "constant of", "value", "95 % interval", "by standard error")
    output.print_table(f"{model} on {_names(files)}", names, rows)
    output.print_lines(*known.sentences)


def suggest(
    model: DiscoveryFile,
    files: OwnData = None,
    rows: Annotated[
        int | None,
        typer.Option(
            "--rows",
            min=2,
            help="Rows of the experiment; those of the longest run by default.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    span: Annotated[
        float | None,
        typer.Option(
            "--span",
            help="Time from its first row to its last; that of the longest run by default.",
            rich_help_panel=options.SEARCH,
        ),
    ] = None,
    beyond: Annotated[
        float,
        typer.Option(
            "--beyond",
            min=0.0,
            help="Share of the range of the states by which a start may lie outside of it.",
            rich_help_panel=options.SEARCH,
        ),
    ] = 0.5,
    seed: options.Seed = 0,
    time_column: options.TimeColumn = None,
    states: options.StateColumns = None,
    inputs: options.Inputs = None,
    hold: options.Hold = None,
    trajectory: options.TrajectoryColumn = None,
    quantity: options.Quantity = None,
    decimal: options.Decimal = None,
    missing: options.Missing = None,
    doses: options.Doses = None,
    json: options.Json = False,
) -> None:
    """Suggest the next experiment: the start that gives most information.

    If other formulas explain the data nearly as well, it is the start where their forecasts differ
    most. Otherwise it is the start that determines the constants best. The information is in bits.
    """
    from dynsr.parameters import SuggestionSettings

    found = load_discovery(model)
    how = (trajectory, hold, quantity, decimal, missing, _say_to(json))
    data = _load_for(found, files, time_column, states, inputs, doses, how)
    settings = SuggestionSettings(beyond=beyond)
    made = found.suggest(data, rows=rows, span=span, seed=seed, settings=settings)
    if json:
        output.print_json(made)
        return
    output.print_lines(made.heading)
    output.print_table(f"Next experiments: {made.size}", made.columns, made.table())


def _names(files: Sequence[Path] | None) -> str:
    return ", ".join(map(str, files)) if files else "its data"


def _told(value: Any) -> Any:
    """Give a value for a table; one that is not finite as a word."""
    finite = not isinstance(value, float) or math.isfinite(value)
    return value if finite and value is not None else "diverges"


def _say_to(json: bool) -> Callable[[str], None]:
    return (lambda words: None) if json else output.note


def import_(
    model: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL", help="A model of SBML (.xml, .sbml) or a PEtab problem (.yaml)."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder to write: discovery.json, and data.csv of a PEtab problem.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Replace data.csv if it is there.", rich_help_panel=options.OUTPUT
        ),
    ] = False,
    json: options.Json = False,
) -> None:
    """Read a model of another tool: equations to simulate, score and start from, and its data."""
    from dynsr.data import DATA
    from dynsr.discovery import Discovery, write_lines
    from dynsr.export import read_petab, read_sbml

    runs: Sequence[Trajectory] = ()
    if model.suffix.lower() in (".yaml", ".yml"):
        system, runs = read_petab(model)
    else:
        system = read_sbml(model)
    found = Discovery.from_system(system, runs)
    files: list[Path] = []
    if out is not None:
        if force:
            (out / DATA).unlink(missing_ok=True)
        files = keep(found, out)
    if json:
        about: dict[str, Any] = {"equations": found.equations}
        about |= {"parameters": system.parameters.numbers}
        units = {**system.units, **{p.name: p.unit for p in system.parameters.values() if p.unit}}
        about |= {"start": system.x0, "units": units, "runs": len(runs), "files": files}
        output.print_json(about)
        return
    output.print_lines(*write_lines(system.equations, found.settings))
    rows = [(p.name, p.value, p.unit) for p in system.parameters.values()]
    head = ("parameter", "value", "unit")
    united = 3 if any(unit for *_, unit in rows) else 2
    output.print_table("Parameters", head[:united], [row[:united] for row in rows])
    if files:
        output.note(f"written: {', '.join(map(str, files))}")


def complete_format(incomplete: str) -> Iterator[tuple[str, str]]:
    """Offer the names of the formats to the shell, with what they are."""
    from dynsr.export import FORMATS

    for name, one in FORMATS.items():
        if name.startswith(incomplete):
            yield name, one.title


def export(
    model: Annotated[
        Path | None,
        typer.Argument(metavar="[DISCOVERY.json]", help="A discovery that was saved."),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="What to write it as; without it, the formats are listed.",
            autocompletion=complete_format,
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="File to write, a folder for petab; stdout by default.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    files: Annotated[
        list[Path] | None,
        typer.Option(
            "--data",
            help="The data, which petab needs; by default data.csv next to the discovery.",
            rich_help_panel=options.DATA,
        ),
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Write a saved discovery, with named parameters, for another tool."""
    from dataclasses import replace

    from dynsr.export import FORMATS, Source, find_format, save_format, write_format

    if to is None:
        rows = [(name, one.title, one.suffix or "folder") for name, one in FORMATS.items()]
        if json:
            output.print_json(
                [dict(zip(("format", "title", "file"), r, strict=True)) for r in rows]
            )
        else:
            output.print_table("Formats", ("format", "what it is", "file"), rows)
        return
    find_format(to)
    if model is None:
        raise InputError(f"give the discovery to write as {to}, its folder or its discovery.json")
    found = load_discovery(model)
    if files:
        how = (None, None, None, None, None, _say_to(json))
        runs = _load_for(found, files, None, None, None, None, how)
        found = replace(found, trajectories=tuple(runs or ()))
    source = Source.of(found)
    if out is not None:
        written = save_format(source, to, out, force)
        if json:
            output.print_json({"format": to, "files": written})
        else:
            output.note(f"written: {', '.join(map(str, written))}")
        return
    text = write_format(source, to)
    if json:
        output.print_json({"format": to, "text": text})
    else:
        output.print_lines(*text.rstrip("\n").split("\n"))


def report(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="DISCOVERY.json|RESULTS",
            help="A saved discovery, or the folder of a batch or a replication.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="HTML file; by default in the folder of the source.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    json: options.Json = False,
) -> None:
    """Make one self-contained HTML report of a saved discovery, a batch or a replication."""
    from dynsr.discovery import EACH, RECORD
    from dynsr.jobs import MANIFEST, REPORT

    if (source / EACH).is_dir():
        _report_batch(source, out, json)
        return
    if (source / MANIFEST).exists() and not (source / RECORD).exists():
        _report_replication(source, out, json)
        return
    found = load_discovery(source)
    target = out or (source if source.is_dir() else source.parent) / REPORT
    found.report(target)
    if json:
        output.print_json({"report": target})
    else:
        output.note(f"open: {target}")


def _report_batch(folder: Path, out: Path | None, json: bool) -> None:
    from dynsr.discovery import read_batch
    from dynsr.report import write_batch

    if out is not None:
        raise InputError("the page of a batch is in its folder, next to the reports; leave -o out")
    _, page = files = write_batch(read_batch(folder), folder)
    if json:
        output.print_json({"report": page, "files": files})
    else:
        output.note(f"open: {page}")


def _report_replication(folder: Path, out: Path | None, json: bool) -> None:
    from dynsr.cli.paper import deliver_results, load_results
    from dynsr.data import write_page
    from dynsr.paper import render_replication

    records, settings = load_results(folder)
    if out is None:
        deliver_results(folder, records, settings, json)
        return
    write_page(out, render_replication(records, settings))
    if json:
        output.print_json({"report": out})
    else:
        output.note(f"open: {out}")
