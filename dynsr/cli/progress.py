"""Progress of a run on stderr: the tasks that run, their stage and best equation, the time left."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from rich.markup import escape

from dynsr.cli.output import console, note
from dynsr.errors import printable

if TYPE_CHECKING:
    from dynsr.jobs import Step

_SECONDS_BETWEEN_LINES = 2.0
# Running tasks are told of after so many seconds, then twice as many, up to the longest gap.
_FIRST_GAP, _LONGEST_GAP = 10.0, 80.0
_LONGEST_FORMULA = 72


def _short(found: str) -> str:
    """Cut a long formula, and keep the error that follows it.

    >>> _short("x + " * 30 + "1  (error 0.1)")
    'x + x + x + x + x + x + x + x + x + x + x + x + x + x + x + x + x + x...  (error 0.1)'
    """
    formula, error, tail = found.rpartition("  (error")
    if len(formula) > _LONGEST_FORMULA:
        formula = formula[: _LONGEST_FORMULA - 3].rstrip(" +-*/(") + "..."
    return f"{formula}{error}{tail}"


class SearchProgress:
    """Shows how far a run is: a live line a running task on a terminal, now and then elsewhere.

    Use it as a context and call it with each :class:`dynsr.jobs.Step`.
    """

    def __init__(self, quiet: bool = False) -> None:
        """Prepare the lines; nothing is drawn before the context is entered."""
        from dynsr.jobs import LiveLines

        self._console = console(stderr=True)
        self._quiet = quiet
        self._live = self._console.is_terminal and not quiet
        self._lines = LiveLines(self._console, self._live)
        self._last, self._gap = -_SECONDS_BETWEEN_LINES, _FIRST_GAP
        self._told = 0.0

    def __enter__(self) -> Self:
        """Start to draw."""
        self._lines.bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Clear the lines away."""
        self._lines.bar.stop()

    def __call__(self, step: Step) -> None:
        """Show a report of a run."""
        if self._live:
            self._lines.update(step)
        elif not self._quiet:
            self._write(step)

    def say_start(self, *engines: str) -> None:
        """Say how long an engine takes before its first answer, where that is long."""
        from dynsr.engines import START_NOTES, is_configured

        for engine in engines:
            if engine in START_NOTES and is_configured():
                self.say(START_NOTES[engine])

    def say(self, line: str) -> None:
        """Write a line above the others."""
        if not self._quiet:
            self._console.print(escape(printable(line)), soft_wrap=True)

    def _write(self, step: Step) -> None:
        """Write a line for what has ended, at most one in two seconds, so that a log stays short.

        Between them, running tasks are reported, less and less often.
        """
        from dynsr.jobs import clock, say_left

        where = f"[{step.done}/{step.total}] {clock(step.seconds)}"
        if step.what:
            if step.seconds - self._last >= _SECONDS_BETWEEN_LINES or step.done == step.total:
                ended = f"{where} {step.what}: {_short(step.found)}".rstrip(": ")
                note("; ".join(filter(None, [ended, say_left(step)])))
                self._last = self._told = step.seconds
        elif step.seconds - self._told >= self._gap:
            for said in step.running:
                far = f"/{said.total:g}" if said.total else ""
                stage = f", {said.stage} {said.done:g}{far}" if said.stage else ""
                note(f"{where} {said.title}{stage}: {_short(said.best)}".rstrip(": "))
            self._told, self._gap = step.seconds, min(2 * self._gap, _LONGEST_GAP)
