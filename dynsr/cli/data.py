"""Data: list known systems, make data from them or from own equations, read what a user has."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynsr.cli import options, output
from dynsr.engines import DEFAULT_ENGINE
from dynsr.errors import InputError, quoted

# Relative and absolute error of an integration, unless others are asked for.
_RELTOL, _ABSTOL = 1e-6, 1e-9

if TYPE_CHECKING:
    import numpy as np

    from dynsr.data import System, Trajectory
    from dynsr.discovery import Discovery


def take_doses(
    files: Sequence[Path],
    doses: options.Names,
    time_column: str | None,
    trajectory: str | None,
    decimal: str | None,
) -> tuple[list[Any], dict[str, str] | None]:
    """Give the sources with the doses of a table of their own, and state -> column of amounts."""
    said, table = read_doses(doses)
    if table is None:
        return list(files), said
    from dynsr.data import load_with_doses

    return load_with_doses(files, table, said, time_column, trajectory, decimal)


def read_doses(doses: options.Names) -> tuple[dict[str, str] | None, Path | None]:
    """Give state -> column of amounts, and the table of doses, where --doses names one.

    >>> read_doses(["x=dose/2.5", "given.csv"])
    ({'x': 'dose/2.5'}, PosixPath('given.csv'))
    """
    texts = options.read_names(doses, "--doses") or []
    tables = [text for text in texts if "=" not in text and Path(text).suffix]
    if len(tables) > 1:
        raise InputError(f"--doses names {len(tables)} tables; put all doses into one")
    said = options.read_doses([text for text in texts if text not in tables])
    return said, Path(tables[0]) if tables else None


def load_table(
    files: Sequence[Any],
    time_column: str | None,
    states: options.Names,
    inputs: options.Names,
    trajectory: str | None,
    hold: options.Names = None,
    quantity: str | None = None,
    decimal: str | None = None,
    missing: str | None = None,
    say: Callable[[str], None] = output.note,
    noise: options.Names = None,
    doses: Mapping[str, str] | None = None,
    limits: options.Names = None,
) -> list[Trajectory]:
    """Read the trajectories of files and say how their columns were understood."""
    from dynsr.data import read_trajectories

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        table = read_trajectories(
            list(files) if len(files) > 1 else files[0],
            time_column,
            options.read_names(states, "--states"),
            inputs,
            trajectory,
            quantity=quantity,
            decimal=decimal,
            missing=missing,
            hold=options.read_hold(hold),
            noise=options.read_noise(noise),
            doses=doses,
            limits=options.read_limits(limits),
        )
    warned = {str(warning.message) for warning in caught}
    for own in caught:
        warnings.warn_explicit(own.message, own.category, own.filename, own.lineno)
    say(table.guess)
    for note in table.notes:
        if note not in warned:
            say(note)
    return table.trajectories


def load_discovery(path: Path) -> Discovery:
    """Load a saved discovery; raises InputError when the file is not one, or is cut short."""
    from dynsr.discovery import RECORD, Discovery

    if path.is_dir() and (path / RECORD).exists():
        path = path / RECORD
    if path.is_dir():
        raise InputError(f"{str(path)!r} is a directory without a {RECORD}; give the file")
    if not path.exists():
        raise InputError(f"there is no file {str(path)!r}; dynsr discover --out makes one")

    return Discovery.load(path)


def split_inputs(inputs: options.Names) -> tuple[options.Names, dict[str, str]]:
    """Separate columns, split at commas, from ``name=formula``; None where no column is named."""
    if inputs is None:
        return None, {}
    formulas = read_equations([text for text in inputs if "=" in text])
    return options.read_names([text for text in inputs if "=" not in text]), formulas


_LEFT_SIDE = re.compile(r"(?:d\s*(\w+)\s*/\s*d\s*t|(\w+)\s*'?)\s*")

SystemName = Annotated[
    str | None,
    typer.Argument(
        metavar="[SYSTEM]",
        help="A known system; dynsr systems lists them.",
        autocompletion=options.complete_system,
    ),
]
Equations = Annotated[
    list[str] | None,
    typer.Option(
        "--equations",
        help="Own system: \"x'=y; y'=-sin(x)\" (may be repeated).",
        rich_help_panel=options.DATA,
    ),
]
InputFormulas = Annotated[
    list[str] | None,
    typer.Option(
        "--inputs",
        help='Known input of the own system: "F=0.5*sin(6*t)".',
        rich_help_panel=options.DATA,
    ),
]


def systems(name: SystemName = None, json: options.Json = False) -> None:
    """List the known systems, or show one of them with its equations."""
    from dynsr.data import DEFINITIONS, find_definition

    chosen = [find_definition(name)] if name else list(DEFINITIONS.values())
    if json:
        from dynsr.data import SYSTEMS

        output.print_json([_describe(SYSTEMS[known.name]) for known in chosen])
        return
    rows = [
        (
            known.name,
            "\n".join(f"{s}' = {e}" for s, e in known.equations.items()),
            "\n".join(f"{n} = {e}" for n, e in known.inputs.items()),
            known.description,
        )
        for known in chosen
    ]
    output.print_table("Known systems", ("name", "equations", "inputs", "what it is"), rows)


def _describe(system: System) -> dict[str, Any]:
    return {
        "name": system.name,
        "description": system.description,
        "states": system.states,
        "equations": system.equations(),
        "inputs": system.inputs,
        "x0": system.x0,
        "train": system.train,
        "test": system.test,
        "step": system.step,
        "target": system.target,
    }


def describe(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="A table of trajectories; one file or many."),
    ],
    time_column: options.TimeColumn = None,
    states: options.StateColumns = None,
    inputs: options.Inputs = None,
    trajectory: options.TrajectoryColumn = None,
    quantity: options.Quantity = None,
    decimal: options.Decimal = None,
    missing: options.Missing = None,
    hold: options.Hold = None,
    noise: options.KnownNoise = None,
    limits: options.Limits = None,
    doses: options.Doses = None,
    json: options.Json = False,
) -> None:
    """Show how a table is understood and what looks odd in it, without a search.

    dynsr discover reads the same files in the same way. Shown are the time and its unit,
    trajectories, states, inputs, parameters, what is left out and why, and the options that change
    this.
    """
    from dynsr.data import describe as look

    columns, formulas = split_inputs(inputs)
    sources, given = take_doses(files, doses, time_column, trajectory, decimal)
    known = [*(columns or []), *(f"{name}={text}" for name, text in formulas.items())]
    found = look(
        sources if len(sources) > 1 else sources[0],
        time_column,
        options.read_names(states, "--states"),
        None if inputs is None else known,
        trajectory,
        quantity=quantity,
        decimal=decimal,
        missing=missing,
        hold=options.read_hold(hold),
        noise=options.read_noise(noise),
        doses=given,
        limits=options.read_limits(limits),
    )
    if json:
        output.print_json(found.to_dict())
    else:
        output.print_lines(*str(found).split("\n"))


def generate(
    name: SystemName = None,
    equations: Equations = None,
    inputs: InputFormulas = None,
    out: options.OutFile = None,
    force: options.Force = False,
    noise: Annotated[
        float,
        typer.Option(
            help="Gaussian noise, as a fraction of each state's standard deviation.",
            rich_help_panel=options.DATA,
        ),
    ] = 0.0,
    seed: options.Seed = 0,
    dt: options.Step = None,
    span: options.Span = None,
    x0: options.Start = None,
    engine: options.Engine = DEFAULT_ENGINE,
    reltol: options.Reltol = 1e-9,
    abstol: options.Abstol = 1e-12,
    json: options.Json = False,
) -> None:
    """Make data from a known system or your own equations: t, the states, then the inputs.

    Without --out the table goes to stdout. The paper's data are coarser: --reltol 1e-3 --abstol
    1e-6.
    """
    check_out(out, force)
    import numpy as np

    from dynsr.engines import add_noise
    from dynsr.engines import simulate as integrate

    system = choose_system(name, equations, inputs, x0)
    times = choose_times(system, span, dt)
    start = options.read_numbers(x0, "--x0", len(system.states))
    made = integrate(system, start, times, reltol, abstol, engine)
    made = add_noise(made, noise, np.random.default_rng(seed))
    about = {"system": system.name, "noise": noise, "seed": seed}
    deliver(made, out, json, about, force=force)


def choose_system(
    name: str | None,
    equations: Sequence[str] | None,
    inputs: Sequence[str] | None = None,
    x0: str | None = None,
) -> System:
    """Give the known system of that name, or the one that the equations describe."""
    from dynsr.data import System, find_system

    if bool(name) == bool(equations):
        raise InputError("give the name of a known system or --equations, one of the two")
    if name:
        if inputs:
            raise InputError(f"--inputs go with --equations; system {name!r} has its own")
        return find_system(name)
    pairs = read_equations(equations or [])
    formulas = read_equations(inputs or [])
    start = options.read_numbers(x0, "--x0", len(pairs))
    return System.from_strings(pairs, x0=start, inputs=formulas)


def read_equations(texts: Sequence[str]) -> dict[str, str]:
    """Read ``x'=y; y'=-x`` as {state: right-hand side}; raises InputError that names the piece.

    >>> read_equations(["x' = y; dy/dt = -x"])
    {'x': 'y', 'y': '-x'}
    """
    found: dict[str, str] = {}
    for piece in (piece.strip() for text in texts for piece in re.split(r"[;\n]", text)):
        if not piece:
            continue
        left, equals, right = piece.partition("=")
        match = _LEFT_SIDE.fullmatch(left.strip())
        if not equals or not match or not right.strip():
            raise InputError(f"cannot read equation {quoted(piece)}; write it like x'=y")
        state = match[1] or match[2]
        if state in found:
            raise InputError(f"{state!r} has two equations; give it one")
        found[state] = right.strip()
    return found


def choose_times(system: System, span: str | None, dt: float | None) -> np.ndarray:
    """Give the times of a span, the system's training span by default; bounded in number."""
    first, last = options.read_numbers(span, "--span", 2) or system.train
    step = system.step if dt is None else dt
    if not last > first:
        raise InputError(f"--span {first:g},{last:g} must run forward in time")
    if not 0 < step <= (last - first):
        raise InputError(f"--dt {step:g} must be above 0 and fit into the span of {last - first:g}")
    return system.times((first, last), step)


def check_out(out: Path | None, force: bool) -> None:
    """Raise InputError, before anything is computed, where a table cannot go to that file."""
    from dynsr.data import check_new

    if out is None:
        return
    if out.suffix.lower() not in (".csv", ".tsv"):
        raise InputError(f"cannot write {str(out)!r}; give a name that ends in .csv or .tsv")
    check_new(out, force)


def deliver(
    trajectory: Trajectory,
    out: Path | None,
    json: bool,
    about: dict[str, Any],
    *,
    force: bool,
) -> None:
    """Write a trajectory to a file or to stdout, as a table or as JSON."""
    from dynsr.data import write_csv

    columns = {"t": trajectory.t}
    columns.update(zip(trajectory.names, trajectory.columns.T, strict=True))
    if out is not None:
        write_csv(trajectory, out, force=force)
    summary = {
        **about,
        "path": out,
        "rows": len(trajectory),
        "states": trajectory.states,
        "inputs": trajectory.input_names,
        "origin": trajectory.origin,
    }
    if json:
        output.print_json(summary if out is not None else {**summary, "columns": columns})
    elif out is None:
        _print_table(columns)
    else:
        output.note(f"{out}: {len(trajectory)} rows of {', '.join(columns)}")


def _print_table(columns: dict[str, np.ndarray]) -> None:
    import numpy as np

    from dynsr.jobs import is_lost

    output.print_lines(",".join(columns))
    for row in np.column_stack(list(columns.values())).tolist():
        if is_lost():
            return
        output.print_lines(",".join(map(repr, row)))


def simulate(
    model: Annotated[
        str | None,
        typer.Argument(
            metavar="[SYSTEM|DISCOVERY.json]",
            help="A known system, or a discovery that was saved.",
            autocompletion=options.complete_system,
        ),
    ] = None,
    equations: Equations = None,
    inputs: InputFormulas = None,
    x0: options.Start = None,
    span: options.Span = None,
    dt: options.Step = None,
    out: options.OutFile = None,
    force: options.Force = False,
    engine: options.OwnEngine = None,
    reltol: options.Reltol = _RELTOL,
    abstol: options.Abstol = _ABSTOL,
    json: options.Json = False,
) -> None:
    """Integrate a known system, own equations or a saved discovery from a start state.

    A discovery begins where its data begin, and ends where they end. Without --out the table goes
    to stdout.
    """
    check_out(out, force)
    from dynsr.engines import simulate as integrate

    if model and (model.endswith(".json") or Path(model).exists()):
        found = load_discovery(Path(model))
        if (reltol, abstol) != (_RELTOL, _ABSTOL):
            raise InputError(
                "a discovery is integrated with a relative error of 1e-8 in each step; leave "
                "--reltol and --abstol out"
            )
        made = _integrate(found, inputs, x0, span, dt, engine)
        deliver(made, out, json, {"system": Path(model).stem}, force=force)
        return
    system = choose_system(model, equations, inputs, x0)
    times = choose_times(system, span, dt)
    start = options.read_numbers(x0, "--x0", len(system.states))
    made = integrate(system, start, times, reltol, abstol, engine or DEFAULT_ENGINE)
    deliver(made, out, json, {"system": system.name}, force=force)


def _integrate(
    found: Discovery,
    inputs: Sequence[str] | None,
    x0: str | None,
    span: str | None,
    dt: float | None,
    engine: str | None,
) -> Trajectory:
    """Integrate a discovery, or iterate a map; by default from the start to the end of its data."""
    import sympy

    from dynsr.data import System

    states, known, here = tuple(found.equations), found.data_summary, bool(found.trajectories)
    begin = {} if known is None else known.start
    own = [begin[s] for s in states] if begin.keys() >= set(states) else None
    start = options.read_numbers(x0, "--x0", len(states)) or own
    if start is None:
        raise InputError(
            "a discovery without its data needs a start state: --x0, one number a state"
        )
    # With the data come the inputs, and the history of delays.
    first = None if x0 is None and here else start
    given = read_equations(inputs or [])
    if here and span is None and dt is None:
        return found.simulate(first, None, given, engine)
    resting = System("discovery", states, (sympy.S.Zero,) * len(states), tuple(map(float, start)))
    if known is not None:
        resting = replace(resting, train=known.span, step=known.step)
    times = choose_times(resting, span, 1.0 if dt is None and found.is_map else dt)
    return found.simulate(first, times, given, engine)
