"""Interrupts that arrive where Python cannot raise them, and are raised again."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


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
