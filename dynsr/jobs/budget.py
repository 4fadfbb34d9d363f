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
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeVar

from dynsr.errors import InputError
from dynsr.jobs.interrupts import heard_again

if TYPE_CHECKING:
    from typing import Self

T = TypeVar("T")
# What answers an end with what it has found so far has this share of its time for that, and at
# least so many seconds; then it is ended again.
_GRACE, _LEAST_GRACE = 0.1, 0.2
# An end that fell where nothing may be cut comes again after so many seconds.
_AGAIN = 0.05
# Seconds of a step for which none are left.
_MOMENT = 1e-3
_IMPORTS = "<frozen importlib._bootstrap>"


class TimeUp(KeyboardInterrupt):
    """The time is over; a search answers it as it answers Ctrl-C, with its front so far."""

    def __init__(self, *arguments: object) -> None:
        """Say that it has arrived."""
        super().__init__(*arguments)
        _BELL.coming = False


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


def _now() -> float:
    return time.monotonic()


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
    began: float = field(default_factory=_now)

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

    @property
    def left(self) -> float | None:
        """Seconds that are left of it; None for as long as it takes."""
        return None if self.seconds is None else self.until(1.0) - time.monotonic()

    @property
    def is_over(self) -> bool:
        """Whether nothing is left of it."""
        return self.left is not None and self.left <= 0

    def rest(self, parts: int = 1) -> float | None:
        """Give the seconds that are left for each of some parts; None for as long as they take.

        Where none are left it is a moment, in which a search gives what needs no time.

        Parameters
        ----------
        parts : how many.
        """
        return None if self.left is None else max(self.left, _MOMENT) / parts


class Clock:
    """One end, and what was said last by the work that it ends: the block behind ``with``.

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

    def __enter__(self) -> Self:
        """Be in force; TimeUp of what lies around may come before that, and not in the midst."""
        if self.until == float("inf"):
            return self
        _BELL.sheltered += 1
        try:
            _BELL.settle()
            _BELL.clocks.append(self)
            _BELL.arm()
        except BaseException:
            _BELL.drop(self)
            raise
        finally:
            _BELL.sheltered -= 1
        return self

    def __exit__(self, *_: object) -> None:
        """Be no longer in force."""
        self.leave()

    def leave(self) -> None:
        """Be no longer in force, also where that was said before.

        Who catches a TimeUp says it once more: in a thread it may come at the very first moment of
        ``__exit__``, which then does nothing.
        """
        _BELL.sheltered += 1
        try:
            # One that is on its way is this end's, or comes again from one around it.
            try:
                _BELL.settle()
            except TimeUp:
                _BELL.lost()
            _BELL.drop(self)
        finally:
            _BELL.sheltered -= 1

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
        # Held while an exception is sent to this thread; whether one is on its way.
        self.sending = threading.Lock()
        self.coming = False
        self.ringer: ExitStack | None = None

    def due(self) -> list[Clock]:
        """Give the outermost of those whose time has come, and all within it."""
        return _due(self.clocks)

    def strike(self) -> None:
        """Raise TimeUp where an end has come."""
        if due := self.due():
            _mark(due)
            raise TimeUp

    def ring(self, number: int, frame: FrameType | None) -> None:
        """Answer an alarm, one that comes late or from elsewhere with nothing."""
        if not self.sheltered and not _is_whole(frame):
            self.strike()

    def lost(self) -> None:
        """Ring again, since an exception was lost."""
        for clock in self.clocks:
            clock.next = min(clock.next, time.monotonic()) if clock.over else clock.next

    def settle(self) -> None:
        """Have no exception on its way to this thread, which is sheltered already."""
        if self.ringer is None or _has_alarm():
            return
        try:
            with self.sending:
                pass
            if self.coming:
                # One that was lost never comes, a second one does. To withdraw it instead leaves
                # Python 3.11 with a flag set for good, at which traced code stands still.
                _send(threading.get_ident(), TimeUp)
            while self.coming:
                pass
        except TimeUp:
            self.lost()

    def arm(self) -> None:
        """Have the system ring when the first end comes, and from then on again and again."""
        if self.ringer is None:
            with ExitStack() as begun:
                begun.enter_context(_alarms() if _has_alarm() else _sent_exceptions())
                begun.enter_context(heard_again(TimeUp, self.lost))
                self.ringer = begun.pop_all()
        left = min(clock.next for clock in self.clocks) - time.monotonic()
        if _has_alarm():
            signal.setitimer(signal.ITIMER_REAL, max(left, 1e-3), _AGAIN)

    def drop(self, clock: Clock) -> None:
        """Forget an end and what lies within it; without any, nothing rings any more."""
        if clock in self.clocks:
            del self.clocks[self.clocks.index(clock) :]
            if self.clocks:
                self.arm()
        if not self.clocks and self.ringer is not None:
            ringer, self.ringer = self.ringer, None
            ringer.close()


_BELL = _Bell()


def _due(clocks: list[Clock]) -> list[Clock]:
    now = time.monotonic()
    return next((clocks[i:] for i, c in enumerate(clocks) if now >= c.next), [])


def _send(ident: int, kind: type[BaseException]) -> None:
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(ident), ctypes.py_object(kind))


def _mark(due: Iterable[Clock]) -> None:
    now = time.monotonic()
    for clock in due:
        clock.over, clock.next = True, now + clock.grace


def _is_whole(frame: FrameType | None) -> bool:
    """Whether a thread is where nothing may be cut: in an import, or as it leaves a block."""
    while frame is not None:
        if frame.f_code.co_filename == _IMPORTS or frame.f_code is Clock.__exit__.__code__:
            return True
        frame = frame.f_back
    return False


class _Uncut:
    """A block that no end falls into."""

    def __enter__(self) -> None:
        """Begin; an end may come before that."""
        _BELL.sheltered += 1
        try:
            _BELL.settle()
        except BaseException:
            _BELL.sheltered -= 1
            raise

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Raise what came meanwhile, unless the block has failed."""
        _BELL.sheltered -= 1
        if kind is None and not _BELL.sheltered:
            _BELL.strike()


def uncut() -> AbstractContextManager[None]:
    """Let no end fall into the block, which is over soon; it comes right behind.

    >>> with uncut():
    ...     print("whole")
    whole
    """
    return _Uncut()


def time_limit(until: float) -> Clock:
    """Raise TimeUp in the block when the time is over, and again where that did not end it.

    Who catches TimeUp and asks the clock has it before the block, since the end of what lies around
    may come as the block is entered; and has it :meth:`~Clock.leave` then.

    Parameters
    ----------
    until : seconds of the monotonic clock; inf for never.

    >>> with time_limit(float("inf")) as clock:
    ...     clock.over
    False
    """
    return Clock(until)


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
    clocks, own, sending = _BELL.clocks, vars(_BELL), _BELL.sending

    def watch() -> None:
        while not over.wait(_AGAIN):
            # Who shelters and then had this lock knows that nothing more is sent.
            with sending:
                due = _due(clocks)
                frame = sys._current_frames().get(ident)  # noqa: SLF001 (no other way to it)
                if due and not own["sheltered"] and not _is_whole(frame):
                    _mark(due)
                    own["coming"] = True
                    _send(ident, TimeUp)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


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
    if time.monotonic() < until:
        clock = time_limit(until)
        try:
            with clock:
                return work(), False
        except TimeUp:
            clock.leave()
            if any(clock.over for clock in _BELL.clocks):
                raise
    return otherwise(), True


def collect_by(
    until: float, look: Callable[[], None], found: Collection[object]
) -> tuple[bool, bool]:
    """Let a search fill a list by a time or until Ctrl-C.

    Parameters
    ----------
    until : seconds of the monotonic clock; inf for never.
    look : the search.
    found : what it fills.

    Gives whether the time cut it, and whether it is complete but for that: Ctrl-C did not end it.
    Raises KeyboardInterrupt where Ctrl-C left nothing.

    >>> found = []
    >>> collect_by(float("inf"), lambda: found.append(1), found)
    (False, True)
    """
    try:
        return finish_by(until, look, lambda: None)[1], True
    except KeyboardInterrupt:
        if not found:
            raise
        return False, False
