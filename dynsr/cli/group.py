"""The command group: what ends a command, as an exit code and one line on stderr.

0 done, 2 bad input or an absent engine, 130 ended by Ctrl-C, 143 by SIGTERM, 1 a fault of dynsr
itself.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import FrameType
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from dynsr.errors import DynsrError, DynsrWarning, in_words, one_line
from dynsr.jobs import (
    heard_again,
    interrupt_again,
    is_repeated,
    printing,
    signal_again,
    take_lost,
)

BAD_INPUT = 2
INTERRUPTED = 130
TERMINATED = 143
# typer may carry its own copy of click, so click's errors are found through typer's.
_CLICK_ERROR: type[Exception] = typer.BadParameter.__mro__[2]


class CommandGroup(TyperGroup):
    """Runs a command; every error that has a remedy ends in one line and exit code 2."""

    def main(self, *args: Any, **options: Any) -> NoReturn:
        """Run the command line and exit with its code."""
        options["standalone_mode"] = False
        with _warnings_as_lines(), _orderly_end() as ends, _noted_interrupts() as interrupts:
            take_lost()
            code = _flush(self._run(args, options, _ended_by_signals(ends, interrupts)))
        sys.exit(INTERRUPTED if interrupts and code == 0 else code)

    def _run(
        self, args: tuple[Any, ...], options: dict[str, Any], signals: AbstractContextManager[None]
    ) -> int:
        try:
            with signals:
                result = super().main(*args, **options)
            code = result if isinstance(result, int) else 0
            return _end("interrupted", code) if code == INTERRUPTED else code
        except (KeyboardInterrupt, typer.Abort):
            return _end("interrupted", INTERRUPTED)
        except DynsrError as error:
            return _end(error, BAD_INPUT)
        except _CLICK_ERROR as error:
            return _end_usage(error)
        except SystemExit as end:
            # Where the reader of the output has enough, click and rich end with 1, we never.
            return 0 if end.code == 1 else int(end.code or 0)
        except BrokenPipeError:
            return 0
        except (OSError, MemoryError) as error:
            return _end(in_words(error), BAD_INPUT)
        except Exception as error:
            return _end_fault(error)


@contextmanager
def _ended_by_signals(ends: Sequence[int], interrupts: Sequence[int]) -> Iterator[None]:
    """Let the end by a signal be that, whatever others made of the exception that it raised.

    Compiled code that calls Python may raise an error of its own in place of any exception, or go
    on. After Ctrl-C, which a search may answer, an error that has a remedy is still reported.
    """
    told = (DynsrError, _CLICK_ERROR, typer.Abort, OSError, MemoryError)
    try:
        yield
    except Exception as error:
        if ends:
            raise SystemExit(TERMINATED) from error
        if interrupts and not isinstance(error, told):
            raise KeyboardInterrupt from error
        raise
    if ends:
        raise SystemExit(TERMINATED)


def _flush(code: int) -> int:
    """Write what is left of the output; gives the exit code, which says if that cannot be done."""
    # Python flushes once more at its end, which must not fail again.
    with printing():
        sys.stdout.flush()
    lost = take_lost()
    if lost is None or isinstance(lost, BrokenPipeError):
        return code
    return _end(f"cannot write the output: {lost.strerror or lost}", code or BAD_INPUT)


def _end(reason: object, code: int) -> int:
    with printing(stderr=True):
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
    return _end(in_words(error), 1)


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Show each warning about the user's data as one line; drop those of libraries."""

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        if issubclass(category, DynsrWarning) or os.environ.get("DYNSR_DEBUG"):
            with printing(stderr=True):
                typer.echo("warning: " + one_line(message), err=True)

    with warnings.catch_warnings():
        warnings.simplefilter("default" if os.environ.get("DYNSR_DEBUG") else "ignore")
        warnings.simplefilter("always", DynsrWarning)
        warnings.showwarning = show
        yield


@contextmanager
def _orderly_end() -> Iterator[list[int]]:
    """Let SIGTERM end workers and temporary folders too, as Ctrl-C does; remember it."""
    said: list[int] = []

    def end(number: int, frame: FrameType | None) -> NoReturn:
        signal.signal(number, signal.SIG_DFL)
        if not said:
            # What was being written is not finished, so that this goes around Python's buffers.
            os.write(2, b"error: terminated\n")
        said.append(number)
        raise SystemExit(TERMINATED)

    def again() -> None:
        signal.signal(signal.SIGTERM, end)
        signal_again(signal.SIGTERM)

    ours = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    )
    if ours:
        signal.signal(signal.SIGTERM, end)
    try:
        with heard_again(SystemExit, again) if ours else nullcontext():
            yield said
    finally:
        if ours:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


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
        if not is_repeated():
            noted.append(number)
        if len(noted) > 1:
            _end_at_once()
        signal.default_int_handler(number, frame)

    ours = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if ours:
        # What earlier work in this process repeated is none of this command's.
        while is_repeated():
            pass
        signal.signal(signal.SIGINT, note)
    try:
        with heard_again(KeyboardInterrupt, interrupt_again):
            yield noted
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
