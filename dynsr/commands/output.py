"""What commands print: results on stdout, as tables or as JSON; everything else on stderr."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.table import Table

_WIDE = 160


def console(stderr: bool = False) -> Console:
    """Give a console that does not fold its tables where nobody watches."""
    found = Console(stderr=stderr, highlight=False, soft_wrap=False)
    return found if found.is_terminal else Console(stderr=stderr, highlight=False, width=_WIDE)


def print_json(value: Any) -> None:
    """Print a value as JSON, alone on stdout."""
    typer.echo(json.dumps(to_plain(value), indent=2, ensure_ascii=False))


def to_plain(value: Any) -> Any:
    """Turn a value into what JSON can hold: arrays to lists, formulas to text, inf and NaN to null.

    >>> to_plain({"x": (1, float("inf"))})
    {'x': [1, None]}
    """
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return {part.name: to_plain(getattr(value, part.name)) for part in fields(value)}
    if hasattr(value, "tolist"):  # an array or a number of numpy's
        return to_plain(value.tolist())
    if hasattr(value, "free_symbols"):
        from dynsr.expression import to_text

        return to_text(value)
    if isinstance(value, Iterable):
        return [to_plain(item) for item in value]
    return str(value)


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a table on stdout; numbers are set right."""
    table = Table(title=title, title_justify="left", title_style="bold")
    listed = [list(row) for row in rows]
    for column, heading in enumerate(headings):
        number = all(isinstance(row[column], (int, float)) for row in listed) and listed
        table.add_column(heading, justify="right" if number else "left", overflow="fold")
    for row in listed:
        table.add_row(*(show(cell) for cell in row))
    console().print(table)


def show(cell: Any) -> str:
    """Show one cell: a number to four digits, nothing as a dash; no markup is read from it."""
    from rich.markup import escape

    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return escape(f"{cell:.4g}" if isinstance(cell, float) else str(cell))


def note(message: str) -> None:
    """Say something about the run, on stderr."""
    typer.echo(message, err=True)


def make_folder(path: Path) -> Path:
    """Make a folder for results; raises InputError when that cannot be written to."""
    from dynsr.errors import InputError

    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".dynsr-writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"cannot write to folder {str(path)!r}: {reason}; choose another"
        ) from None
    return path


def write_text(path: Path, text: str) -> None:
    """Write a file in one move, so that a reader never sees half of it."""
    from dynsr.errors import InputError

    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot write {str(path)!r}: {reason}; choose another file") from None
