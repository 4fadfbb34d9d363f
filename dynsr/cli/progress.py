"""Progress of a search on stderr: what runs, its stage, its best equation and the time left."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn
from rich.table import Column

from dynsr.cli.output import console, note

if TYPE_CHECKING:
    from dynsr.fit import ParetoFront
    from dynsr.jobs import Running, Step

_SHOWN_EQUATION = 60
_SECONDS_BETWEEN_LINES = 2.0
# Running searches are told of after so many seconds, then twice as many, up to the longest gap.
_FIRST_GAP, _LONGEST_GAP = 10.0, 80.0


class SearchProgress:
    """Shows how far a search is: a live line a running part on a terminal, now and then elsewhere.

    Use it as a context and call it with each :class:`dynsr.jobs.watch.Step`.
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
        """Clear the lines away."""
        self._bar.stop()

    def __call__(self, step: Step) -> None:
        """Show a report of a running discovery."""
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
            what="fitting the constants" if over else f"{step.done} of {step.total} parts",
            total=step.total,
            completed=step.done,
            time=clock(step.seconds),
            best=_left(step),
        )
        running = {part.part: part for part in step.running}
        for name in [name for name in self._tasks if name not in running]:
            self._bar.remove_task(self._tasks.pop(name))
        for name, part in running.items():
            if name not in self._tasks:
                self._tasks[name] = self._add(title(part.state, part.method))
            self._bar.update(
                self._tasks[name],
                stage="" if part.stage == part.method else escape(part.stage),
                total=part.total,
                completed=part.done,
                time=clock(part.seconds),
                best=escape(_found(part)),
            )

    def _write(self, step: Step) -> None:
        """Write a line for what has ended, at most one in two seconds, so that a log stays short.

        Between them, running parts are told of at gaps that grow.
        """
        where = f"[{step.done}/{step.total}] {clock(step.seconds)}"
        if step.what:
            if step.seconds - self._last >= _SECONDS_BETWEEN_LINES or step.done == step.total:
                note("; ".join(filter(None, [f"{where} {_ended(step)}", _left(step)])))
                self._last = self._told = step.seconds
        elif step.seconds - self._told >= self._gap:
            for part in step.running:
                far = f"/{part.total:g}" if part.total else ""
                stage = f", {part.stage} {part.done:g}{far}" if part.stage else ""
                words = f"{title(part.state, part.method)}{stage}: {_cut(_found(part))}"
                note(f"{where} {words}".rstrip(": "))
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


def title(state: str, method: str) -> str:
    """Say in words what a part does.

    >>> title("x", "sindy"), title("x", "pick")
    ("x' by sindy", "x' being chosen")
    """
    return f"{state}' being chosen" if method == "pick" else f"{state}' by {method}"


def _left(step: Step) -> str:
    return "" if step.seconds_left is None else f"about {clock(step.seconds_left)} left"


def _found(part: Running) -> str:
    return f"{part.best}  (error {part.loss:.2g})" if part.best and part.loss is not None else ""


def _cut(text: str) -> str:
    return text if len(text) <= _SHOWN_EQUATION else text[: _SHOWN_EQUATION - 3] + "..."


def _ended(step: Step) -> str:
    """Say which part has ended, and with which equation."""
    record: Mapping[str, Any] = step.record
    what = step.what
    if "ranked" in record:
        what = f"{record['target']}' chosen"
    elif "method" in record:
        what = title(record["target"], record["method"])
    return f"{what}: {best_of(record)}".rstrip(": ")


def best_of(record: Mapping[str, Any]) -> str:
    """Give the best equation in the record of a finished part, as a few words."""
    from dynsr.fit import ParetoFront
    from dynsr.selection import read_candidates

    chosen = [ranked["candidate"] for ranked in record.get("ranked", [])[:1]]
    return best_equation(ParetoFront(read_candidates(chosen or record.get("front", []))))


def best_equation(front: ParetoFront) -> str:
    """Give the front's knee in a few characters, its error beside it; "" for an empty front."""
    if not len(front):
        return ""
    from dynsr.expression import shown
    from dynsr.fit import tidy

    return f"{_cut(shown(tidy(front.knee.expr), 4))}  (error {front.knee.loss:.2g})"
