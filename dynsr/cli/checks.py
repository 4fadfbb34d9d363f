"""Care: what is installed and works, and whether the engines agree."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from dynsr.cli import options, output
from dynsr.cli.group import BAD_INPUT
from dynsr.cli.progress import SearchProgress
from dynsr.engines import ENGINES


def crosscheck(
    systems: Annotated[
        list[str] | None, typer.Option(help="Systems of the paper, by commas; all by default.")
    ] = None,
    engines: Annotated[list[str] | None, typer.Option(help="Engines to check, by commas.")] = None,
    sections: Annotated[
        list[str] | None, typer.Option(help="Kinds of comparison, by commas; all by default.")
    ] = None,
    extra: Annotated[
        list[str] | None, typer.Option("--with", help="A further program: diffeqpy.")
    ] = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Compare engines with recorded answers and other programs.

    Runs with what is installed and reports what it left out. The exit code is 2 when a row differs.
    Other programs are compared with a known law, which does not change the exit code.
    """
    from dynsr.checks import crosscheck as run

    asked = {"systems": systems, "engines": engines, "sections": sections, "extra": extra}
    chosen: dict[str, Any] = {n: options.read_names(v, f"--{n}") for n, v in asked.items() if v}
    with SearchProgress(quiet) as progress:
        progress.say_start(*chosen.get("engines", ENGINES))
        rows = run(**chosen, progress=progress)
    if json:
        output.print_json(rows)
    else:
        output.print_rows("Crosscheck", rows)
    differing = sum(row.verdict == "differs" for row in rows)
    if differing:
        output.note(f"{differing} of {len(rows)} comparisons differ")
        raise typer.Exit(BAD_INPUT)


def doctor(
    install: Annotated[
        bool, typer.Option("--install", help="Set up Julia and its packages first.")
    ] = False,
    json: options.Json = False,
) -> None:
    """Report what is installed, what works, what is missing, and how to fix it.

    Exit code 1 when something that is there or set up fails, 2 when something that dynsr needs is
    missing.
    """
    from dynsr.checks import examine, is_healthy
    from dynsr.checks import install as set_up

    if install:
        for line in set_up().splitlines():
            output.note(line)
    found = examine()
    if json:
        output.print_json(found)
    else:
        rows = [(check.name, check.state, check.detail, check.remedy) for check in found]
        output.print_table("Doctor", ("what", "state", "detail", "how to fix it"), rows)
    if any(check.state == "fails" for check in found):
        raise typer.Exit(1)
    if not is_healthy(found):
        raise typer.Exit(BAD_INPUT)
