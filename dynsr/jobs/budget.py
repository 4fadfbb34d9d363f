"""Time budgets: work that ends by a time, with what it has by then.

Times are those of the monotonic clock, which nobody sets. Every step of a run has an end, and the
ends of steps lie within those of what they are steps of. An end raises :class:`TimeUp` wherever the
work is, as Ctrl-C does: in the main thread by an alarm, in another one by an exception that is sent
to it. So no loop has to ask for the time. What is not cut: a report and the keeping of a record,
which are over soon, and an import, which could not be done again.
"""

from __future__ import annotations

import ctypes
import platform
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, TypeVar

from dynsr.errors import InputError
from dynsr.jobs.interrupts import heard_again

T = TypeVar("T")
# What answers an end with what it has found so far has this share of its time for that, and at
# least so many seconds; then it is ended again.
_GRACE, _LEAST_GRACE = 0.1, 0.2
# An end that fell where nothing may be cut comes again after so many seconds.
_AGAIN = 0.05
_IMPORTS = "<frozen importlib._bootstrap>"


class TimeUp(KeyboardInterrupt):
    """The time is over; a search answers it as it answers Ctrl-C, with its front so far."""


@dataclass(frozen=True)
class End:
    """When something must have ended; another process, of another machine too, reads it right.

    Parameters
    ----------
    at : seconds of the monotonic clock; inf for never.

    >>> End(time.monotonic() + 5.0).left > 4.0
    True
    """

    at: float

    @property
    def left(self) -> float:
        """Seconds until then, 0 when it is over."""
        return max(0.0, self.at - time.monotonic())

    def __reduce__(self) -> Any:
        """Go elsewhere with the clock on the wall, which far machines have in common."""
        return _read_end, (self.at, time.time() + self.at - time.monotonic(), platform.node())


def _read_end(at: float, on_the_wall: float, node: str) -> End:
    same = node == platform.node()
    return End(at if same else time.monotonic() + on_the_wall - time.time())


@dataclass(frozen=True)
class Turn:
    """When a task must end, so that those behind it have their time too.

    Parameters
    ----------
    end : when all tasks must have ended.
    share : this task's part of the work of itself and those behind it, 0 to 1.
    workers : tasks at a time.
    """

    end: End
    share: float
    workers: int

    def until(self) -> float:
        """Give the time by which the task must end when it begins now."""
        return time.monotonic() + self.end.left * min(1.0, self.share * self.workers)


@dataclass(frozen=True)
class Budget:
    """The seconds that a whole run may take; None for as long as it takes.

    Parameters
    ----------
    seconds : of the whole run.
    began : when it began, in seconds of the monotonic clock.

    >>> Budget(None).until(0.5)
    inf
    """

    seconds: float | None = None
    began: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        """Check the seconds; raises InputError."""
        value = self.seconds
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if value is not None and not (number and 0 < value < float("inf")):
            raise InputError(
                f"time_budget {value!r} must be a positive number of seconds, such as 60"
            )

    def until(self, share: float) -> float:
        """Give the time at which a part of the budget is used, on the monotonic clock.

        Parameters
        ----------
        share : the part, 0 to 1.
        """
        return float("inf") if self.seconds is None else self.began + share * self.seconds


class Clock:
    """One end, and what was said last by the work that it ends.

    Parameters
    ----------
    until : seconds of the monotonic clock.

    ``over`` says whether it has come, ``last`` is the last report that went :meth:`through` it.
    """

    def __init__(self, until: float) -> None:
        """Begin."""
        self.until = self.next = until
        self.grace = max(_GRACE * (until - time.monotonic()), _LEAST_GRACE)
        self.over = False
        self.last: Any = None

    def through(self, report: Callable[[Any], None]) -> Callable[[Any], None]:
        """Give a report that is never cut in two, which would spoil all that follow it.

        Parameters
        ----------
        report : takes what the work says of itself.
        """

        def tell(progress: Any) -> None:
            with uncut():
                self.last = progress
                report(progress)

        return tell


class _Bell(threading.local):
    """The ends that are in force in a thread, the outermost first, and what rings for them."""

    def __init__(self) -> None:
        self.clocks: list[Clock] = []
        self.sheltered = 0

    def due(self) -> list[Clock]:
        """Give the outermost of those whose time has come, and all within it."""
        now = time.monotonic()
        return next((self.clocks[i:] for i, c in enumerate(self.clocks) if now >= c.next), [])

    def strike(self) -> None:
        """Raise TimeUp where an end has come."""
        if due := self.due():
            _mark(due)
            raise TimeUp

    def ring(self, number: int, frame: FrameType | None) -> None:
        """Answer an alarm."""
        if not self.sheltered and not _is_importing(frame):
            self.strike()

    def lost(self) -> None:
        """Ring again, since an exception was lost."""
        for clock in self.clocks:
            clock.next = min(clock.next, time.monotonic()) if clock.over else clock.next

    def arm(self) -> None:
        """Have the system ring when the first end comes, and from then on again and again."""
        left = min((clock.next for clock in self.clocks), default=0.0) - time.monotonic()
        if self.clocks and _has_alarm():
            signal.setitimer(signal.ITIMER_REAL, max(left, 1e-3), _AGAIN)


_BELL = _Bell()


def _mark(due: Iterable[Clock]) -> None:
    now = time.monotonic()
    for clock in due:
        clock.over, clock.next = True, now + clock.grace


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == _IMPORTS:
            return True
        frame = frame.f_back
    return False


@contextmanager
def uncut() -> Iterator[None]:
    """Let no end fall into the block, which is over soon; it comes right behind.

    >>> with uncut():
    ...     print("whole")
    whole
    """
    _BELL.sheltered += 1
    try:
        yield
    finally:
        _BELL.sheltered -= 1
    if not _BELL.sheltered:
        _BELL.strike()


@contextmanager
def time_limit(until: float) -> Iterator[Clock]:
    """Raise TimeUp in the block when the time is over, and again where that did not end it.

    Parameters
    ----------
    until : seconds of the monotonic clock; inf for never.

    >>> with time_limit(float("inf")) as clock:
    ...     clock.over
    False
    """
    clock = Clock(until)
    if until == float("inf"):
        yield clock
        return
    with ExitStack() as bell:
        if not _BELL.clocks:
            bell.enter_context(_alarms() if _has_alarm() else _sent_exceptions())
            bell.enter_context(heard_again(TimeUp, _BELL.lost))
        _BELL.clocks.append(clock)
        _BELL.arm()
        try:
            yield clock
        finally:
            # An exception that came while the block was left may have had it removed before.
            with suppress(ValueError):
                _BELL.clocks.remove(clock)
            _BELL.arm()


def _has_alarm() -> bool:
    main = threading.current_thread() is threading.main_thread()
    return main and hasattr(signal, "setitimer")


@contextmanager
def _alarms() -> Iterator[None]:
    """Have the system ring in this thread, the main one of the process."""
    began = time.monotonic()
    handler = signal.signal(signal.SIGALRM, _BELL.ring)
    left, interval = signal.setitimer(signal.ITIMER_REAL, 0.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL if handler is None else handler)
        if left:
            passed = time.monotonic() - began
            signal.setitimer(signal.ITIMER_REAL, max(left - passed, 1e-3), interval)


@contextmanager
def _sent_exceptions() -> Iterator[None]:
    """Have a thread of its own send exceptions to this one, which no signal reaches."""
    ident, over = threading.get_ident(), threading.Event()
    # What the other thread sees of this one's.
    clocks, own = _BELL.clocks, vars(_BELL)
    send = ctypes.pythonapi.PyThreadState_SetAsyncExc

    def watch() -> None:
        while not over.wait(_AGAIN):
            now = time.monotonic()
            due = next((clocks[i:] for i, c in enumerate(clocks) if now >= c.next), [])
            frame = sys._current_frames().get(ident)  # noqa: SLF001 (there is no other way to it)
            if due and not own["sheltered"] and not _is_importing(frame):
                _mark(due)
                send(ctypes.c_ulong(ident), ctypes.py_object(TimeUp))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        # One that was sent and has not come yet is not for what follows.
        with suppress(TimeUp):
            send(ctypes.c_ulong(ident), None)


def finish_by(until: float, work: Callable[[], T], otherwise: Callable[[], T]) -> tuple[T, bool]:
    """Do some work by a time, or else something shorter; gives the result and whether it was cut.

    Parameters
    ----------
    until : seconds of the monotonic clock; inf for never.
    work : what is wanted; not begun where the time is over.
    otherwise : what is done where the time does not suffice; it has no end of its own, but where
        that of what this is a step of has come too, TimeUp is raised.

    >>> finish_by(float("inf"), lambda: 1, lambda: 2)
    (1, False)
    >>> finish_by(time.monotonic(), lambda: 1, lambda: 2)
    (2, True)
    """
    around = len(_BELL.clocks)
    if time.monotonic() < until:
        try:
            with time_limit(until):
                return work(), False
        except TimeUp:
            del _BELL.clocks[around:]
            if any(clock.over for clock in _BELL.clocks):
                raise
    return otherwise(), True
