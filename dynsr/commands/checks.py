"""Care: what is installed and works, whether the engines agree, how fast they are."""

from __future__ import annotations

from typing import Annotated

import typer

from dynsr.commands import options, output


def crosscheck(
    extra: Annotated[
        list[str] | None, typer.Option("--with", help="A further engine: diffeqpy.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Compare engines and peers: trajectories and sparse coefficients, a verdict a row."""
    from dynsr.crosscheck import crosscheck as run

    rows = run(**({"extra": extra} if extra else {}))
    if json:
        output.print_json(rows)
        return
    output.print_rows("Crosscheck", rows)


def benchmark(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Which one; all are listed without it.")
    ] = None,
    systems: Annotated[
        list[str] | None, typer.Option(help="Systems, by commas.", rich_help_panel=options.DATA)
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            help="Noise levels, as fractions of each state's standard deviation: 0,0.01.",
            rich_help_panel=options.DATA,
        ),
    ] = None,
    json: options.Json = False,
) -> None:
    """Run a benchmark by name, or list them."""
    del name, json


def doctor(
    install: Annotated[bool, typer.Option(help="Install Julia and its packages first.")] = False,
    json: options.Json = False,
) -> None:
    """Say what is installed, what works, what is missing, and the line that mends it."""
    from dynsr.doctor import examine
    from dynsr.doctor import install as install_julia

    if install:
        install_julia()
    rows = examine()
    if json:
        output.print_json(rows)
        return
    output.print_rows("Doctor", rows)
