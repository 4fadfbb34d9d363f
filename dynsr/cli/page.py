"""The local page, for those who do not program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynsr.cli import options, output


def app(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="Data to begin with; or drop them on the page."),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 takes a free one.")] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
    megabytes: Annotated[
        float, typer.Option(min=0.001, max=2000, help="Largest file that may be dropped.")
    ] = 50,
    jobs: options.Jobs = -1,
    json: options.Json = False,
) -> None:
    """Open a page in the browser: drop a table, press a button, read the equations.

    It is served on this machine alone, at an address that nobody else knows, and loads nothing over
    a network. Ctrl-C, or Quit on the page, ends it.
    """
    from dynsr.errors import need

    need("tornado", "app", "the page")
    from dynsr.app import serve
    from dynsr.jobs import take_lost

    def say(address: str) -> None:
        if json:
            output.print_json({"address": address})
        else:
            output.print_lines(f"open: {address}")
            output.note("Ctrl-C ends it")
        # A page that nobody knows the address of is of no use.
        if error := take_lost():
            raise error

    serve(file, port=port, jobs=jobs, megabytes=megabytes, browse=browser, say=say)
