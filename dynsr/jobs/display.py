"""Display: live lines of a run, on a terminal or in a notebook, that go when the run ends."""

from __future__ import annotations

import io
import sys
from typing import Any, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn
from rich.table import Column

from dynsr.jobs.progress import Step
from dynsr.jobs.screen import Screen

# Letters across a line in a notebook.
_WIDTH = 110
_PAGE = "<pre style='white-space:pre;overflow-x:auto;line-height:normal'>{code}</pre>"


class LiveLines:
    """One line for a whole run and one for each task that runs, drawn by rich.

    Parameters
    ----------
    console : where they are drawn.
    live : False draws nothing.
    """

    def __init__(self, console: Console, live: bool = True) -> None:
        """Prepare the lines; nothing is drawn before ``bar`` is started."""
        self.bar = Progress(
            SpinnerColumn(),
            _text("what"),
            _text("stage", max_width=24),
            BarColumn(bar_width=10),
            _text("time"),
            _text("best", ratio=1),
            console=console,
            transient=True,
            expand=True,
            disable=not live,
        )
        self._whole = self._add("searching")
        self._tasks: dict[str, TaskID] = {}

    def _add(self, what: str) -> TaskID:
        return self.bar.add_task("", total=None, what=escape(what), stage="", time="", best="")

    def update(self, step: Step) -> None:
        """Show a report of a run."""
        over = step.done == step.total
        self.bar.update(
            self._whole,
            what="finishing" if over else f"{step.done} of {step.total} tasks",
            total=step.total,
            completed=step.done,
            time=clock(step.seconds),
            best=say_left(step),
        )
        running = {said.task: said for said in step.running}
        for name in [name for name in self._tasks if name not in running]:
            self.bar.remove_task(self._tasks.pop(name))
        for name, said in running.items():
            if name not in self._tasks:
                self._tasks[name] = self._add(said.title)
            self.bar.update(
                self._tasks[name],
                stage=escape(said.stage),
                total=said.total,
                completed=said.done,
                time=clock(said.seconds),
                best=escape(said.best),
            )


class NotebookProgress:
    """Live lines in the output of a notebook's cell; use it as a context, call it with each Step.

    Nothing but IPython is needed, and nothing is left in the cell when it ends.
    """

    def __init__(self) -> None:
        """Prepare the lines; nothing is shown before the context is entered."""
        self._page = Screen(file=io.StringIO(), record=True, width=_WIDTH, force_jupyter=False)
        self._lines = LiveLines(self._page)
        self._handle: Any = None

    def __enter__(self) -> Self:
        """Take a place in the output of the cell."""
        from IPython.display import display

        self._handle = display(_as_output(""), raw=True, display_id=True)
        return self

    def __exit__(self, *error: object) -> None:
        """Leave the place empty."""
        self._handle.update(_as_output(""), raw=True)

    def __call__(self, step: Step) -> None:
        """Show a report of a run."""
        self._lines.update(step)
        self._page.print(self._lines.bar.get_renderable())
        drawn = self._page.export_html(inline_styles=True, code_format=_PAGE)
        self._handle.update(_as_output(drawn), raw=True)


class TerminalProgress:
    """Live lines on stderr; use it as a context and call it with each Step."""

    def __init__(self) -> None:
        """Prepare the lines; where stderr is no terminal, nothing is ever drawn."""
        console = Screen(stderr=True)
        self._lines = LiveLines(console, console.is_terminal)

    def __enter__(self) -> Self:
        """Start to draw."""
        self._lines.bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Clear the lines away."""
        self._lines.bar.stop()

    def __call__(self, step: Step) -> None:
        """Show a report of a run."""
        self._lines.update(step)


def _as_output(html: str) -> dict[str, str]:
    return {"text/html": html, "text/plain": ""}


def in_notebook() -> bool:
    """Whether this process is the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return getattr(shell, "kernel", None) is not None


def _text(name: str, **column: Any) -> TextColumn:
    shape = Column(no_wrap=True, overflow="ellipsis", **column)
    return TextColumn(f"{{task.fields[{name}]}}", table_column=shape)


def clock(seconds: float) -> str:
    """Write a time as minutes and seconds.

    >>> clock(83.2)
    '1:23'
    """
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def say_left(step: Step) -> str:
    """Say how long a run will go on; "" where nobody knows."""
    return "" if step.seconds_left is None else f"about {clock(step.seconds_left)} left"
