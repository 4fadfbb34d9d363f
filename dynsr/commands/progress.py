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
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from dynsr.commands.output import console, note

if TYPE_CHECKING:
    from dynsr.methods.base import Progress as Step
    from dynsr.pareto import ParetoFront

_SHOWN_EQUATION = 60
_SECONDS_BETWEEN_LINES = 2.0


class SearchProgress:
    """Shows the reports of a search: a live bar on a terminal, a line a stage elsewhere.

    Use it as a context; calling it takes a :class:`dynsr.methods.base.Progress`.
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
        self._tasks: dict[str, TaskID] = {}
        self._last = ("", 0.0)

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

    def __call__(self, step: Step) -> None:
        """Show one report."""
        if self._live:
            self._draw(step)
        elif not self._quiet:
            self._write(step)

    def say(self, line: str) -> None:
        """Write a line above the bar."""
        self._console.print(escape(line), soft_wrap=True)

    def _draw(self, step: Step) -> None:
        for name, task in self._tasks.items():
            if name != step.stage:
                self._bar.update(task, visible=False)
        if step.stage not in self._tasks:
            self._tasks[step.stage] = self._bar.add_task(escape(step.stage), best="")
        self._bar.update(
            self._tasks[step.stage],
            completed=step.done,
            total=step.total,
            best=escape(best_equation(step.front)),
            visible=True,
        )

    def _write(self, step: Step) -> None:
        """Write a line for a new stage, at most one in two seconds, so that a log stays short."""
        stage, since = self._last
        if step.stage != stage and time.monotonic() - since > _SECONDS_BETWEEN_LINES:
            note(f"{step.stage}: {best_equation(step.front)}".rstrip(": "))
            self._last = (step.stage, time.monotonic())


def best_equation(front: ParetoFront) -> str:
    """Give the front's knee in a few characters, its error beside it; "" for an empty front."""
    if not len(front):
        return ""
    from dynsr.expression import round_constants

    text = str(round_constants(front.knee.expr, 4))
    cut = text if len(text) <= _SHOWN_EQUATION else text[: _SHOWN_EQUATION - 3] + "..."
    return f"{cut}  (error {front.knee.loss:.2g})"
