"""Progress of a search on stderr: the stage, the time left and the best equation so far."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from dynsr.commands.output import console, note

if TYPE_CHECKING:
    from dynsr.pareto import ParetoFront

_SHOWN_EQUATION = 60
_SECONDS_BETWEEN_LINES = 2.0


class SearchProgress:
    """Shows how far a search is: a live bar on a terminal, a line a stage elsewhere.

    Use it as a context and call it with each report.
    """

    def __init__(self, quiet: bool = False) -> None:
        """Prepare the bar; nothing is drawn before the context is entered."""
        self._console = console(stderr=True)
        self._quiet = quiet
        self._live = self._console.is_terminal and not quiet
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[best]}"),
            console=self._console,
            transient=True,
            disable=not self._live,
        )
        self._task = self._bar.add_task("starting", total=None, best="")
        self._last = ("", -_SECONDS_BETWEEN_LINES)

    def __enter__(self) -> SearchProgress:
        """Start to draw."""
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Clear the bar away."""
        self._bar.stop()

    def __call__(self, stage: str, done: float, total: float | None, best: str) -> None:
        """Show the stage, how far it is, and the best equation so far in a few words."""
        if self._live:
            self._bar.update(
                self._task,
                description=escape(stage),
                completed=done,
                total=total,
                best=escape(best),
            )
        elif not self._quiet:
            self._write(stage, done, total, best)

    def say(self, line: str) -> None:
        """Write a line above the bar."""
        if not self._quiet:
            self._console.print(escape(line), soft_wrap=True)

    def _write(self, stage: str, done: float, total: float | None, best: str) -> None:
        """Write a line for a new stage, at most one in two seconds, so that a log stays short."""
        last, since = self._last
        now = time.monotonic()
        if stage != last and (now - since >= _SECONDS_BETWEEN_LINES or done == total):
            share = f"[{done:g}/{total:g}] " if total else ""
            note(f"{share}{stage}: {best}".rstrip(": "))
            self._last = (stage, now)


def best_equation(front: ParetoFront) -> str:
    """Give the front's knee in a few characters, its error beside it; "" for an empty front."""
    if not len(front):
        return ""
    from dynsr.expression import round_constants

    text = str(round_constants(front.knee.expr, 4))
    cut = text if len(text) <= _SHOWN_EQUATION else text[: _SHOWN_EQUATION - 3] + "..."
    return f"{cut}  (error {front.knee.loss:.2g})"
