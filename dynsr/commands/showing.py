"""Showing a discovery to a reader: equations, reasons, scores, and where the files are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from dynsr.commands import output

if TYPE_CHECKING:
    from dynsr.discovery import Discovery

# Name in the scores -> heading, what it means.
_SCORES = {
    "slope_rmse": ("slopes off by", "error of the equation against the slopes of the data"),
    "forecast": ("forecast off by", "median miss of short forecasts, 1 = the state's spread"),
    "trajectory_rmse": ("run off by", "error of one integration over the whole data"),
    "equation_rmse": ("true slopes off by", "error against the true equation on the test span"),
    "printed_loss": ("paper's loss", "the loss that the paper prints"),
    "trajectory_loss": ("test run off by", "error of an integration over the test span"),
}


def show_discovery(
    found: Discovery,
    scores: Mapping[str, Any],
    told: Mapping[str, Sequence[str]],
    quiet: bool = False,
) -> None:
    """Print the equations, then why they were chosen, how they score and what was assumed.

    Quiet, the equations are all there is.
    """
    screen = output.console()
    lines = list(_equations(found))
    if screen.is_terminal and not quiet:
        block = Text("\n".join(lines), style="bold")
        heading = "Equations" if found.complete else "Equations so far"
        screen.print(Panel(block, title=heading, border_style="green", expand=False))
    else:
        typer.echo("\n".join(lines))
    if quiet:
        return
    for state, words in found.explanation.items():
        line = words if words.startswith(f"{state}' =") else f"{state}: {words}"
        screen.print(Text(line), soft_wrap=not screen.is_terminal)
    if scores:
        _print_scores(scores)
    for kind, items in told.items():
        for item in items:
            screen.print(Text(f"{kind}: {item}", style="dim"), soft_wrap=not screen.is_terminal)


def _equations(found: Discovery) -> Iterator[str]:
    from dynsr.exports import shown
    from dynsr.methods.snapping import as_decimals

    for state, expr in found.equations.items():
        yield f"{state}' = {shown(as_decimals(expr))}"


def by_state(scores: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Give {state: {score: value}} from the scores on the data and against the truth.

    >>> by_state({"data": {"x": {"forecast": 0.1}}, "truth": {"x": {"printed_loss": 2.0}}})
    {'x': {'forecast': 0.1, 'printed_loss': 2.0}}
    """
    rows: dict[str, dict[str, Any]] = {}
    for part in scores.values():
        for state, values in output.to_plain(part).items():
            rows.setdefault(state, {}).update(values)
    return rows


def _print_scores(scores: Mapping[str, Any]) -> None:
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
    screen.print(Text(meanings, style="dim"), soft_wrap=not screen.is_terminal)


def _number(value: Any) -> str:
    return "diverges" if value is None else f"{value:.3g}"


def show_files(found: Discovery, saved: Sequence[Path], folder: Path | None) -> None:
    """Say on stderr how long it took, where the files are, and how to go on after an interrupt."""
    output.note(f"{found.seconds:.1f} s")
    for path in saved:
        output.note(f"{'open' if path.suffix == '.html' else 'saved'}: {path}")
    if not found.complete:
        where = f"what is finished is kept in {folder}; " if folder is not None else ""
        goes_on = "the same command goes on from there" if where else "with --out it could go on"
        output.note(f"interrupted: these are the best equations so far; {where}{goes_on}")
