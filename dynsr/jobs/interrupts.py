"""Interrupts that arrive where Python cannot raise them, and are raised again."""

from __future__ import annotations

import signal
import sys
import threading
import time
from _thread import interrupt_main
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# A finaliser has ended by then.
_SECONDS_UNTIL_AGAIN = 0.02
_RECENT = 2.0
_repeats: list[float] = []


def signal_main(number: int) -> None:
    """Have the main thread handle a signal, also where it waits for something.

    Parameters
    ----------
    number : of the signal.
    """
    main = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main is not None:
        signal.pthread_kill(main, number)
    else:
        interrupt_main(signal.Signals(number))


def signal_again(number: int) -> None:
    """Have the main thread handle a signal, one that was lost, a little later.

    Parameters
    ----------
    number : of the signal.
    """
    threading.Timer(_SECONDS_UNTIL_AGAIN, signal_main, (number,)).start()


def interrupt_again() -> None:
    """Interrupt the main thread a little later, by the interrupt that was lost."""
    _repeats.append(time.monotonic())
    signal_again(signal.SIGINT)


def is_repeated() -> bool:
    """Whether the interrupt that is handled now was lost a moment ago; true once for each."""
    return bool(_repeats) and time.monotonic() - _repeats.pop() < _RECENT


@contextmanager
def heard_again(kind: type[BaseException], again: Callable[[], None]) -> Iterator[None]:
    """Have an interrupt repeated that is lost in a finaliser.

    A signal handler that raises does so wherever the program is. Inside a finaliser or the callback
    of a weak reference, Python prints the exception and goes on, so the interrupt would be lost.

    Parameters
    ----------
    kind : the interrupt; its subclasses are others'.
    again : called without arguments when one was lost. It may not raise, but see to it that the
        interrupt is raised a little later.

    >>> class Finaliser:
    ...     def __del__(self):
    ...         raise KeyboardInterrupt
    >>> with heard_again(KeyboardInterrupt, lambda: print("again")):
    ...     _ = Finaliser().__class__
    again
    """
    before = sys.unraisablehook

    def hook(lost: Any) -> None:
        if lost.exc_type is kind:
            again()
        else:
            before(lost)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before
