"""Care: what is installed and works, and whether the engines agree."""

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
