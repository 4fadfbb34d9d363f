"""The ``dynsr`` command: one verb for each task, every one with ``--help`` and ``--json``.

Exit codes: 0 done, 2 bad input or an absent engine, 130 ended by Ctrl-C.
"""

from __future__ import annotations

import inspect
from typing import Annotated

import typer

from dynsr import __version__
from dynsr.cli import benchmarks, checks, data, discovery, page, paper, results
from dynsr.cli.group import CommandGroup

app = typer.Typer(
    name="dynsr",
    cls=CommandGroup,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Example: dynsr generate lorenz -o l.csv --noise 0.01 && dynsr discover l.csv",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"dynsr {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _dynsr(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and end."
        ),
    ] = False,
) -> None:
    """Give it trajectories of a dynamical system; get its equations back as formulas."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _flow(text: str) -> str:
    """Put each paragraph on one line, so that it fills a terminal of any width."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


_DATA, _DISCOVERY, _PAPER, _CARE = (
    "Systems and data",
    "Discovery",
    "The paper",
    "Installation and checks",
)

for _panel, _command, _example in (
    (_DATA, data.systems, "systems pendulum"),
    (_DATA, data.generate, "generate lorenz -o l.csv --noise 0.01 --seed 1"),
    (_DATA, data.simulate, "simulate pendulum --x0 0.5,0 --span 0,20 -o p.csv"),
    (_DATA, data.describe, "describe l.csv"),
    (_DISCOVERY, discovery.discover, "discover l.csv --out lorenz"),
    (_DISCOVERY, page.app, "app l.csv"),
    (_DISCOVERY, results.score, "score lorenz other.csv"),
    (_DISCOVERY, results.profile, "profile lorenz --constant x:0"),
    (_DISCOVERY, results.import_, "import model.xml -o model"),
    (_DISCOVERY, results.export, "export lorenz --to julia -o lorenz.jl"),
    (_DISCOVERY, results.suggest, "suggest lorenz --rows 100"),
    (_DISCOVERY, results.report, "report lorenz -o report.html"),
    (_PAPER, paper.replicate, "replicate --systems pendulum --methods sindy"),
    (_PAPER, paper.audit, "audit --json"),
    (_CARE, checks.crosscheck, "crosscheck"),
    (_CARE, benchmarks.benchmark, "benchmark recovery --systems lorenz --noise 0,0.01"),
    (_CARE, checks.doctor, "doctor --install"),
):
    # A word that Python keeps for itself has an underscore there.
    _name = _command.__name__.rstrip("_")
    app.command(
        _name,
        help=_flow(inspect.getdoc(_command) or ""),
        rich_help_panel=_panel,
        epilog=f"Example: dynsr {_example}",
    )(_command)
