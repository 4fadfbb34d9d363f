"""What commands print: results on stdout, as tables or as JSON; everything else on stderr.

Notes say what was guessed and what was warned of in a run at once, and again with the results where
these go elsewhere.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self

import typer

from dynsr.errors import DynsrWarning, one_line, printable
from dynsr.jobs import Screen, printing

_WIDE = 160


def console(stderr: bool = False) -> Screen:
    """Give a console that does not fold its tables where nobody watches."""
    found = Screen(stderr=stderr, highlight=False, soft_wrap=False)
    return found if found.is_terminal else Screen(stderr=stderr, highlight=False, width=_WIDE)


def print_lines(*lines: str) -> None:
    """Print lines on stdout."""
    with printing():
        typer.echo("\n".join(map(printable, lines)))


def print_json(value: Any) -> None:
    """Print a value as JSON, alone on stdout."""
    from dynsr.jobs import to_plain

    plain = (getattr(sys.stdout, "encoding", None) or "").lower().replace("-", "") != "utf8"
    text = json.dumps(to_plain(value), indent=2, ensure_ascii=plain, allow_nan=False)
    with printing():
        typer.echo(printable(text, "\n", json.dumps))


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], note: str = ""
) -> None:
    """Print a table on stdout."""
    from dynsr.report import Table

    table = Table("", title, tuple(columns), tuple(tuple(row) for row in rows), note)
    console().print(table.to_rich())


def print_rows(title: str, rows: Sequence[Any]) -> None:
    """Print a table of dataclass instances or mappings that all have the same fields."""
    from dynsr.jobs import to_plain

    records = [to_plain(row) for row in rows]
    columns = list(records[0]) if records else []
    print_table(title, columns, [[_cell(record[key]) for key in columns] for record in records])


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return json.dumps(value) if isinstance(value, (dict, list)) else value


def note(message: str) -> None:
    """Say something about the run, on a line of stderr."""
    with printing(stderr=True):
        typer.echo(printable(message), err=True)


def is_one_place() -> bool:
    """Whether stdout and stderr go to one terminal, file or pipe, so that both are read there."""
    try:
        one, other = (os.fstat(stream.fileno()) for stream in (sys.stdout, sys.stderr))
    except (AttributeError, OSError, ValueError):
        return False
    return os.path.samestat(one, other)


def make_folder(path: Path) -> Path:
    """Make a folder for results; raises InputError when that cannot be written to."""
    from dynsr.data import open_part
    from dynsr.errors import InputError

    try:
        path.mkdir(parents=True, exist_ok=True)
        probe, file = open_part(path)
        try:
            file.close()
        finally:
            probe.unlink()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"cannot write to folder {str(path)!r}: {reason}; choose another"
        ) from None
    return path


class Notes:
    """Keeps the guesses that are said to it and, as a context, the warnings about the data."""

    def __init__(self, quiet: bool = False) -> None:
        """Take whether guesses are shown; warnings always are."""
        self._quiet = quiet
        self.guessed: list[str] = []
        self.warned: list[str] = []

    @property
    def told(self) -> dict[str, list[str]]:
        """Give both lists by name."""
        return {"guessed": self.guessed, "warned": self.warned}

    def say(self, words: str) -> None:
        """Keep a guess and show it on stderr."""
        self.guessed.append(words)
        if not self._quiet:
            note(words)

    def __enter__(self) -> Self:
        """Begin to listen."""
        self._before = warnings.showwarning
        warnings.showwarning = self._hear
        return self

    def __exit__(self, *error: object) -> None:
        """Listen no more."""
        warnings.showwarning = self._before

    def _hear(
        self, message: Warning | str, category: type[Warning], *where: Any, **more: Any
    ) -> None:
        if issubclass(category, DynsrWarning):
            self.warned.append(one_line(message))
        self._before(message, category, *where, **more)
