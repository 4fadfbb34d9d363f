"""Options that several commands share, each written once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from dynsr.engines import ENGINES
from dynsr.methods import AUTO, METHODS, PRESETS, describe_methods, describe_presets

OUTPUT, SEARCH, DATA, NUMERICS = "Output", "Search", "Data", "Numerics"


def complete_system(incomplete: str) -> Iterator[tuple[str, str]]:
    """Offer the names of the known systems to the shell."""
    from dynsr.data import DEFINITIONS

    for name, system in DEFINITIONS.items():
        if name.startswith(incomplete):
            yield name, system.description


def complete_method(incomplete: str) -> list[str]:
    """Offer the names of the methods to the shell."""
    return [name for name in (AUTO, *METHODS) if name.startswith(incomplete)]


def complete_preset(incomplete: str) -> Iterator[tuple[str, str]]:
    """Offer the presets to the shell, with what they mean."""
    for name, meaning in PRESETS.items():
        if name.startswith(incomplete):
            yield name, meaning


def complete_engine(incomplete: str) -> list[str]:
    """Offer the names of the engines to the shell."""
    return [name for name in ENGINES if name.startswith(incomplete)]


Json = Annotated[
    bool, typer.Option("--json", help="Print JSON alone on stdout.", rich_help_panel=OUTPUT)
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show no progress.", rich_help_panel=OUTPUT)
]
Engine = Annotated[
    str,
    typer.Option(
        help="embedded, or julia (DifferentialEquations.jl and DataDrivenDiffEq.jl).",
        autocompletion=complete_engine,
        rich_help_panel=NUMERICS,
    ),
]
OwnEngine = Annotated[
    str | None,
    typer.Option(
        "--engine",
        help="embedded or julia; that of the discovery by default.",
        autocompletion=complete_engine,
        rich_help_panel=NUMERICS,
    ),
]
Seed = Annotated[
    int, typer.Option(min=0, help="Seed of all chance; same seed, same result.", show_default=True)
]
Jobs = Annotated[int, typer.Option("--jobs", "-j", help="Processes; -1 uses every core.")]
Reltol = Annotated[float, typer.Option(help="Relative tolerance.", rich_help_panel=NUMERICS)]
Abstol = Annotated[float, typer.Option(help="Absolute tolerance.", rich_help_panel=NUMERICS)]
Step = Annotated[
    float | None, typer.Option("--dt", help="Seconds between samples.", rich_help_panel=DATA)
]
Span = Annotated[
    str | None,
    typer.Option(help="First and last time in seconds, such as 0,10.", rich_help_panel=DATA),
]
Start = Annotated[
    str | None,
    typer.Option("--x0", help="Start state, one number a state: 1,1.", rich_help_panel=DATA),
]
OutFile = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="File to write (.csv or .tsv).", rich_help_panel=OUTPUT),
]


Names = list[str] | None

TimeColumn = Annotated[
    str | None, typer.Option("--time", help="Time column.", rich_help_panel=DATA)
]
StateColumns = Annotated[
    Names, typer.Option("--states", help="State columns: x,y.", rich_help_panel=DATA)
]
Inputs = Annotated[
    Names,
    typer.Option(
        "--inputs",
        help='Input columns, or expressions in t: u or "F=0.5*sin(6*t)".',
        rich_help_panel=DATA,
    ),
]
TrajectoryColumn = Annotated[
    str | None,
    typer.Option("--trajectory", help="Column that names trajectories.", rich_help_panel=DATA),
]
MethodName = Annotated[
    str,
    typer.Option(
        "--method",
        help=f"{describe_methods()}. Several by commas.",
        autocompletion=complete_method,
        rich_help_panel=SEARCH,
    ),
]
Preset = Annotated[
    str,
    typer.Option(
        help=f"{describe_presets()}.", autocompletion=complete_preset, rich_help_panel=SEARCH
    ),
]


def read_numbers(text: str | None, option: str, count: int | None = None) -> list[float] | None:
    """Read ``1,2.5`` as numbers; raises InputError that names the option.

    >>> read_numbers("0, 10", "--span", 2)
    [0.0, 10.0]
    """
    from dynsr.errors import InputError

    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    finite = all(abs(number) < float("inf") for number in numbers)
    if not numbers or not finite or (count is not None and len(numbers) != count):
        many = "numbers" if count is None else f"{count} numbers"
        raise InputError(f"{option} {text!r} is not {many}; write them like 0,10")
    return numbers


def read_names(values: Sequence[str] | None) -> list[str] | None:
    """Split repeated or comma-separated names; None where the option was not given.

    >>> read_names(["x,y", "z"])
    ['x', 'y', 'z']
    """
    if not values:
        return None
    return [part.strip() for value in values for part in value.split(",") if part.strip()]
