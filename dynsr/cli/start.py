"""Start: what has to be right before the commands load."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from types import FrameType

from dynsr.jobs import let_garbage_wait

_INTERRUPTED = 130


def main() -> None:
    """Run the command line that the shell gave."""
    try:
        _prepare()
        from dynsr.cli.app import app

        app()
    except KeyboardInterrupt:  # before the command itself began
        sys.stderr.write("error: interrupted\n")
        sys.exit(_INTERRUPTED)
    finally:
        signal.signal(signal.SIGINT, _leave)


def _leave(number: int, frame: FrameType | None) -> None:
    """End at once, without a word: what is left to do is to wait for workers that end too."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(_INTERRUPTED)


def _prepare() -> None:
    """Let every name be printed, no window be opened, and garbage wait."""
    let_garbage_wait()
    # A terminal that knows no Greek letters, or the bytes of a file's name that are no text.
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    # Closed streams (>&-) are None, which libraries cannot print to.
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    # Pictures are drawn into files; a wrong backend would end matplotlib's import.
    os.environ["MPLBACKEND"] = "agg"
