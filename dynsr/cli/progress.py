"""Progress of a run on stderr: the tasks that run, their stage and best equation, the time left."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn
from rich.table import Column
from typing_extensions import Self

from dynsr.cli.output import console, note

if TYPE_CHECKING:
    from dynsr.jobs import Step

_SECONDS_BETWEEN_LINES = 2.0
# Running tasks are told of after so many seconds, then twice as many, up to the longest gap.
_FIRST_GAP, _LONGEST_GAP = 10.0, 80.0


class SearchProgress:
    """Shows how far a run is: a live line a running task on a terminal, now and then elsewhere.

    Use it as a context and call it with each :class:`dynsr.jobs.Step`.
    """

    def __init__(self, quiet: bool = False) -> None:
        """Prepare the lines; nothing is drawn before the context is entered."""
        self._console = console(stderr=True)
        self._quiet = quiet
        self._live = self._console.is_terminal and not quiet
        self._bar = Progress(
            SpinnerColumn(),
            _text("what"),
            _text("stage", max_width=24),
            BarColumn(bar_width=10),
            _text("time"),
            _text("best", ratio=1),
            console=self._console,
            transient=True,
            expand=True,
            disable=not self._live,
        )
        self._whole = self._add("searching")
        self._tasks: dict[str, TaskID] = {}
        self._last, self._gap = -_SECONDS_BETWEEN_LINES, _FIRST_GAP
        self._told = 0.0

    def __enter__(self) -> Self:
        """Start to draw."""
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Clear the lines away."""
        self._bar.stop()

    def __call__(self, step: Step) -> None:
        """Show a report of a run."""
        if self._live:
            self._draw(step)
        elif not self._quiet:
            self._write(step)

    def say(self, line: str) -> None:
        """Write a line above the others."""
        if not self._quiet:
            self._console.print(escape(line), soft_wrap=True)

    def _add(self, what: str) -> TaskID:
        return self._bar.add_task("", total=None, what=escape(what), stage="", time="", best="")

    def _draw(self, step: Step) -> None:
        over = step.done == step.total
        self._bar.update(
            self._whole,
            what="finishing" if over else f"{step.done} of {step.total} tasks",
            total=step.total,
            completed=step.done,
            time=clock(step.seconds),
            best=_left(step),
        )
        running = {said.task: said for said in step.running}
        for name in [name for name in self._tasks if name not in running]:
            self._bar.remove_task(self._tasks.pop(name))
        for name, said in running.items():
            if name not in self._tasks:
                self._tasks[name] = self._add(said.title)
            self._bar.update(
                self._tasks[name],
                stage=escape(said.stage),
                total=said.total,
                completed=said.done,
                time=clock(said.seconds),
                best=escape(said.best),
            )

    def _write(self, step: Step) -> None:
        """Write a line for what has ended, at most one in two seconds, so that a log stays short.

        Between them, running tasks are told of at gaps that grow.
        """
        where = f"[{step.done}/{step.total}] {clock(step.seconds)}"
        if step.what:
            if step.seconds - self._last >= _SECONDS_BETWEEN_LINES or step.done == step.total:
                ended = f"{where} {step.what}: {step.found}".rstrip(": ")
                note("; ".join(filter(None, [ended, _left(step)])))
                self._last = self._told = step.seconds
        elif step.seconds - self._told >= self._gap:
            for said in step.running:
                far = f"/{said.total:g}" if said.total else ""
                stage = f", {said.stage} {said.done:g}{far}" if said.stage else ""
                note(f"{where} {said.title}{stage}: {said.best}".rstrip(": "))
            self._told, self._gap = step.seconds, min(2 * self._gap, _LONGEST_GAP)


def _text(name: str, **column: Any) -> TextColumn:
    shape = Column(no_wrap=True, overflow="ellipsis", **column)
    return TextColumn(f"{{task.fields[{name}]}}", table_column=shape)


def clock(seconds: float) -> str:
    """Write a time as minutes and seconds.

    >>> clock(83.2)
    '1:23'
    """
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def _left(step: Step) -> str:
    return "" if step.seconds_left is None else f"about {clock(step.seconds_left)} left"
