"""The command group: what ends a command, as an exit code and one line on stderr.

0 done, 2 bad input or an absent engine, 130 ended by Ctrl-C, 1 a fault of dynsr itself.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from dynsr.errors import DynsrError, DynsrWarning, one_line

BAD_INPUT = 2
INTERRUPTED = 130
# typer may carry its own copy of click, so click's errors are found through typer's.
_CLICK_ERROR: type[Exception] = typer.BadParameter.__mro__[2]


class CommandGroup(TyperGroup):
    """Runs a command; every error that has a remedy ends in one line and exit code 2."""

    def main(self, *args: Any, **options: Any) -> NoReturn:
        """Run the command line and exit with its code."""
        options["standalone_mode"] = False
        with _warnings_as_lines(), _noted_interrupts() as interrupts:
            code = self._run(args, options)
        sys.exit(INTERRUPTED if interrupts and code == 0 else code)

    def invoke(self, ctx: Any) -> Any:
        """Run the command chosen; it ends quietly when the reader of its output is gone."""
        try:
            result = super().invoke(ctx)
            sys.stdout.flush()
            return result
        except BrokenPipeError:
            # Python flushes stdout once more at its end, which must not fail again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return None

    def _run(self, args: tuple[Any, ...], options: dict[str, Any]) -> int:
        try:
            result = super().main(*args, **options)
            code = result if isinstance(result, int) else 0
            return _end("interrupted", code) if code == INTERRUPTED else code
        except (KeyboardInterrupt, typer.Abort):
            return _end("interrupted", INTERRUPTED)
        except DynsrError as error:
            return _end(error, BAD_INPUT)
        except _CLICK_ERROR as error:
            return _end_usage(error)
        except OSError as error:
            where = f" {str(error.filename)!r}" if error.filename else ""
            return _end(f"cannot use{where}: {error.strerror or error}", BAD_INPUT)
        except MemoryError:
            return _end("out of memory; give fewer rows or a smaller search", BAD_INPUT)
        except Exception as error:
            return _end_fault(error)


def _end(reason: object, code: int) -> int:
    typer.echo("error: " + one_line(reason), err=True)
    return code


def _end_usage(error: Any) -> int:
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "dynsr"
    return _end(f"{error.format_message().rstrip('.')}; see: {path} --help", BAD_INPUT)


def _end_fault(error: Exception) -> int:
    """Report a fault of our own; DYNSR_DEBUG=1 lets the traceback through."""
    if os.environ.get("DYNSR_DEBUG"):
        raise error
    return _end(
        f"this is a fault in dynsr: {type(error).__name__}: {error} (DYNSR_DEBUG=1 shows where)", 1
    )


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Show each warning about the user's data as one line; drop those of libraries."""

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        if issubclass(category, DynsrWarning) or os.environ.get("DYNSR_DEBUG"):
            typer.echo("warning: " + one_line(message), err=True)

    with warnings.catch_warnings():
        warnings.simplefilter("default" if os.environ.get("DYNSR_DEBUG") else "ignore")
        warnings.simplefilter("always", DynsrWarning)
        warnings.showwarning = show
        yield


def _end_at_once() -> NoReturn:
    if sys.stderr.isatty():
        sys.stderr.write("\x1b[?25h")  # the cursor, which a live display hides
    _end("interrupted twice", INTERRUPTED)
    os._exit(INTERRUPTED)


@contextmanager
def _noted_interrupts() -> Iterator[list[int]]:
    """Remember Ctrl-C even where a search swallows it to give its best front so far.

    A second one ends the process at once; its workers see that it is gone and end too.
    """
    noted: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        if len(noted) > 1:
            _end_at_once()
        signal.default_int_handler(number, frame)

    ours = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if ours:
        signal.signal(signal.SIGINT, note)
    try:
        yield noted
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
