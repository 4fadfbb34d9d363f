"""Screen: what reaches a terminal is safe to show, and no output that is gone ends any work."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from dynsr.errors import printable

_lost: list[OSError] = []


@contextmanager
def printing(stderr: bool = False) -> Iterator[None]:
    """Print in here: where nobody reads, or the disk is full, the rest of the work goes on.

    What comes later goes nowhere. :func:`take_lost` says what was wrong with standard output.
    """
    try:
        yield
    except OSError as error:
        if not stderr:
            _lost.append(error)
        stream = sys.stderr if stderr else sys.stdout
        # Where a stream has no number there is nothing to redirect.
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)


def is_lost() -> bool:
    """Whether something that was printed on standard output did not arrive."""
    return bool(_lost)


def take_lost() -> OSError | None:
    """Give, once, what was first wrong with standard output; None where nothing was."""
    first = _lost[0] if _lost else None
    _lost.clear()
    return first


class Screen(Console):
    """A console of rich's that shows no sign of anybody's that would steer a terminal."""

    def __init__(self, **settings: Any) -> None:
        """Take the settings of rich's own."""
        super().__init__(emoji=False, **settings)

    def print(self, *objects: Any, **how: Any) -> None:
        """Print as rich does; see :func:`printing`."""
        with printing(self.stderr):
            super().print(*objects, **how)

    def render_str(self, text: str, **how: Any) -> Text:
        """Make text of a string, which is how rich measures it too."""
        return super().render_str(printable(text, "\n"), **how)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Give the pieces of something; those of text are safe, rich's own controls are kept."""
        for one in super().render(renderable, options):
            yield one if one.control else Segment(printable(one.text, "\n"), one.style)

    def on_broken_pipe(self) -> NoReturn:
        """Let :meth:`print` see it."""
        raise  # noqa: PLE0704 # rich calls it where the error is caught
