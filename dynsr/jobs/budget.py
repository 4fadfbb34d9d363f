"""Time budgets: work that ends by a time, with what it has by then."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, TypeVar

from dynsr.errors import InputError
from dynsr.jobs.interrupts import heard_again

T = TypeVar("T")


class TimeUp(KeyboardInterrupt):
    """The time is over; a search answers it as it answers Ctrl-C, with its front so far."""


@dataclass(frozen=True)
class Turn:
    """When a task must end, so that those behind it have their time too.

    Times are those of the clock on the wall, since tasks run in processes of their own.

    Parameters
    ----------
    end : seconds since the epoch at which all tasks must have ended.
    share : this task's part of the work of itself and those behind it, 0 to 1.
    workers : tasks at a time.
    """

    end: float
    share: float
    workers: int

    def until(self) -> float:
        """Give the time by which the task must end when it begins now."""
        left = max(0.0, self.end - time.time())
        return time.time() + left * min(1.0, self.share * self.workers)


@dataclass(frozen=True)
class Budget:
    """The seconds that a whole run may take; None for as long as it takes.

    Parameters
    ----------
    seconds : of the whole run.
    began : when it began, in seconds since the epoch.

    >>> Budget(None).until(0.5)
    inf
    """

    seconds: float | None = None
    began: float = field(default_factory=time.time)

    def __post_init__(self) -> None:
        """Check the seconds; raises InputError."""
        value = self.seconds
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if value is not None and not (number and 0 < value < float("inf")):
            raise InputError(
                f"time_budget {value!r} must be a positive number of seconds, such as 60"
            )

    def until(self, share: float) -> float:
        """Give the time at which a part of the budget is used, in seconds since the epoch.

        Parameters
        ----------
        share : the part, 0 to 1.
        """
        return float("inf") if self.seconds is None else self.began + share * self.seconds


class _Clock:
    """Raises TimeUp once: from the reports that pass through it, or from an alarm."""

    def __init__(self, until: float) -> None:
        self.until = until
        self.over = self.busy = False

    def check(self) -> None:
        if not self.over and time.time() >= self.until:
            self.over = True
            raise TimeUp

    def once_more(self) -> None:
        self.over = False

    def ring(self, number: int, frame: FrameType | None) -> None:
        # A report that is cut in two would spoil all that follow it; it checks by itself.
        if not self.busy:
            self.check()

    def through(self, report: Callable[[Any], None]) -> Callable[[Any], None]:
        """Give a report that also looks at the clock."""

        def tell(progress: Any) -> None:
            self.busy = True
            try:
                report(progress)
            finally:
                self.busy = False
            self.check()

        return tell


@contextmanager
def time_limit(until: float) -> Iterator[_Clock]:
    """Raise TimeUp in the block, once, when the time is over.

    In the main thread of a process, where the system has an alarm, wherever the block is; elsewhere
    where the block reports through the clock that is given.

    Parameters
    ----------
    until : seconds since the epoch; inf for never.

    >>> with time_limit(float("inf")) as clock:
    ...     clock.over
    False
    """
    clock = _Clock(until)
    main = threading.current_thread() is threading.main_thread()
    if until == float("inf") or not main or not hasattr(signal, "setitimer"):
        yield clock
        return
    began = time.time()
    handler = signal.signal(signal.SIGALRM, clock.ring)
    # Every tenth of a second again, since a ring during a report is let pass.
    left, interval = signal.setitimer(signal.ITIMER_REAL, max(until - began, 1e-3), 0.1)
    try:
        with heard_again(TimeUp, clock.once_more):
            yield clock
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL if handler is None else handler)
        if left:
            passed = time.time() - began
            signal.setitimer(signal.ITIMER_REAL, max(left - passed, 1e-3), interval)


def finish_by(until: float, work: Callable[[], T], otherwise: Callable[[], T]) -> tuple[T, bool]:
    """Do some work by a time, or else something shorter; gives the result and whether it was cut.

    Parameters
    ----------
    until : seconds since the epoch; inf for never.
    work : what is wanted.
    otherwise : what is done where the time does not suffice.

    >>> finish_by(float("inf"), lambda: 1, lambda: 2)
    (1, False)
    """
    try:
        with time_limit(until):
            return work(), False
    except TimeUp:
        return otherwise(), True
