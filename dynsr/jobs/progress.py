"""Progress: what running tasks report, the time left, and how they are asked to stop.

Tasks of this process report directly, those of other processes over a local connection. Where
there is none (a far machine), tasks run all the same and only their end is heard of.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from multiprocessing import AuthenticationError
from multiprocessing.connection import Client, Connection, Listener
from types import FrameType
from typing import TYPE_CHECKING, Any, Self, TypeVar

from dynsr.jobs.interrupts import heard_again, interrupt_again

# A worker loads this file before it knows its task, which says what else is needed.
if TYPE_CHECKING:
    import sympy

    from dynsr.fit import ParetoFront
    from dynsr.methods import Progress

_SECONDS_BETWEEN = 0.5
# Telling may take this share of a task's time at most.
_SHARE = 0.02
_DIGITS = 4
_MOST_CHARACTERS = 60
_POLL_SECONDS = 0.1
_BACKLOG = 64
# So many seconds' worth of belief in the guess; then the tasks that have ended count.
_BELIEF = 10.0
# Rough seconds of what is done in turn, of which nothing is known before.
_USUAL = 10.0
# A task that ends at once had nothing to search and tells nothing of the others.
_AT_ONCE = 0.3


def _no_front() -> ParetoFront:
    from dynsr.fit import ParetoFront

    return ParetoFront()


@dataclass(frozen=True)
class Running:
    """What one running task last said.

    ``best`` is its best formula so far with its error ("" where it has none yet); ``done`` of
    ``total`` (None while unknown) is how far its ``stage`` is; ``began`` is when it began, in
    seconds since the epoch. ``equations`` are the best of all states so far, where it finds them
    together.
    """

    task: str
    title: str
    stage: str = ""
    done: float = 0.0
    total: float | None = None
    best: str = ""
    began: float = field(default_factory=time.time)
    front: ParetoFront = field(default_factory=_no_front, repr=False)
    equations: Mapping[str, sympy.Expr] = field(default_factory=dict, repr=False)

    @property
    def seconds(self) -> float:
        """How long it has run."""
        return max(0.0, time.time() - self.began)


Item = TypeVar("Item")


@dataclass(frozen=True)
class Ended:
    """The record of what was done in turn: its seconds, and the best so far in a few words."""

    seconds: float
    summary: str


@dataclass(frozen=True)
class Step:
    """One report of a run.

    ``what`` names the task that has just ended, ``record`` is its record and ``found`` that in a
    few words; "", None and "" where the report only says how the ``running`` tasks go on.
    ``done`` of ``total`` tasks have ended, after ``seconds``; ``seconds_left`` is a rough
    estimate, None once all have ended.
    """

    what: str
    done: int
    total: int
    record: Any = None
    found: str = ""
    running: tuple[Running, ...] = ()
    seconds: float = 0.0
    seconds_left: float | None = None


def report_each(
    items: Sequence[Item], name: Callable[[Item], str], progress: Callable[[Step], None] | None
) -> Iterator[Item]:
    """Give items one by one and report each as its turn ends, with the time left.

    Parameters
    ----------
    items : what is done one after the other.
    name : says what an item is called.
    progress : is called with a :class:`Step` each time; None for no reports.

    >>> steps = []
    >>> [2 * item for item in report_each([1, 2], str, steps.append)]
    [2, 4]
    >>> [(step.what, step.done, step.total) for step in steps]
    [('1', 1, 2), ('2', 2, 2)]
    """
    began = time.monotonic()
    for done, item in enumerate(items, 1):
        yield item
        if progress is not None:
            seconds, more = time.monotonic() - began, len(items) - done
            left = seconds / done * more if more else None
            progress(Step(name(item), done, len(items), seconds=seconds, seconds_left=left))


def best_equation(front: ParetoFront) -> str:
    """Give the front's knee in a few characters, with its error; "" for an empty front.

    >>> import sympy
    >>> from dynsr.fit import Candidate, ParetoFront
    >>> best_equation(ParetoFront([Candidate(2 * sympy.Symbol("x"), 0.125, 3.0)]))
    '2*x  (error 0.12)'
    """
    if not len(front):
        return ""
    from dynsr.expression import shown
    from dynsr.fit import tidy

    text = shown(tidy(front.knee.expr), _DIGITS)
    text = text if len(text) <= _MOST_CHARACTERS else text[: _MOST_CHARACTERS - 3] + "..."
    return f"{text}  (error {front.knee.loss:.2g})"


def _address() -> str | None:
    """Give an address that ends with its process, where there are such; a socket's file stays."""
    return f"\0dynsr-{os.getpid()}-{os.urandom(8).hex()}" if sys.platform == "linux" else None


class Messages:
    """What running tasks last said, by name; tasks of any process of this machine may say more."""

    def __init__(self) -> None:
        """Begin without any."""
        self.last: dict[str, Running] = {}
        self.stopped = self.closed = False
        self._lock = threading.Lock()
        self._listener: Listener | None = None
        self._key = os.urandom(32)

    def connect(self) -> Messages:
        """Give what a task of this process reports."""
        return self

    def send(self, running: Running) -> None:
        """Take what a task says."""
        self.last[running.task] = running

    def close(self) -> None:
        """End what :meth:`connect` gave; nothing has to be done in this process."""

    def __reduce__(self) -> Any:
        """Go to another process as the address of this one, which listens from now on."""
        with self._lock:
            if self._listener is None and not self.closed:
                self._listener = Listener(_address(), backlog=_BACKLOG, authkey=self._key)
                threading.Thread(target=self._listen, args=(self._listener,), daemon=True).start()
        address = None if self._listener is None else self._listener.address
        return Line, (address, self._key)

    def end(self) -> None:
        """Listen no more."""
        self.closed = True
        with self._lock:
            listener, self._listener = self._listener, None
        if listener is not None:
            # A call that says nothing wakes the thread that waits for calls.
            with suppress(OSError):
                Client(listener.address).close()
            listener.close()

    def _listen(self, listener: Listener) -> None:
        while not self.closed:
            with suppress(OSError, EOFError, AuthenticationError):
                line = listener.accept()
                threading.Thread(target=self._hear, args=(line,), daemon=True).start()

    def _hear(self, line: Connection) -> None:
        told = False
        with line, suppress(OSError, EOFError):
            while not self.closed:
                if line.poll(_POLL_SECONDS):
                    self.send(line.recv())
                elif self.stopped and not told:
                    line.send("stop")
                    told = True


class Line:
    """The way from a task of another process to the run that it belongs to."""

    def __init__(self, address: Any, key: bytes) -> None:
        """Take the address of the run, and what proves to it that the task is its own."""
        self._address, self._key = address, key
        self._connection: Connection | None = None
        self._stopped = False

    def connect(self) -> Line:
        """Open the line, if there is anyone at its end."""
        if self._address is not None:
            with suppress(OSError, EOFError, AuthenticationError):
                self._connection = Client(self._address, authkey=self._key)
        return self

    def send(self, running: Running) -> None:
        """Say how the task goes on."""
        if self._connection is not None:
            try:
                self._connection.send(running)
            except OSError:
                self.close()

    @property
    def stopped(self) -> bool:
        """Whether the task was asked to stop."""
        if self._connection is not None and not self._stopped:
            try:
                self._stopped = self._connection.poll() and self._connection.recv() == "stop"
            except (OSError, EOFError):
                self.close()
        return self._stopped

    def close(self) -> None:
        """Say no more."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None


class Reporter:
    """Takes the reports of one running task and passes them on, not too often.

    Raises KeyboardInterrupt once the tasks are asked to stop, which a search answers with its
    front so far.
    """

    def __init__(self, messages: Messages | Line, task: str, title: str) -> None:
        """Say that the task has begun."""
        self._line = messages.connect()
        self._said, self._next = Running(task, title), 0.0
        self._line.send(self._said)

    def __call__(self, progress: Progress) -> None:
        """Take a report."""
        if self._line.stopped:
            raise KeyboardInterrupt
        began = time.monotonic()
        if began < self._next:
            return
        stage, done, total, front = progress.stage, progress.done, progress.total, progress.front
        said = replace(self._said, stage=stage, done=done, total=total)
        if front is not self._said.front and len(front):
            said = replace(said, best=best_equation(front), front=front)
        self._said = said
        self._line.send(said)
        ended = time.monotonic()
        self._next = ended + max(_SECONDS_BETWEEN, (ended - began) / _SHARE)

    def end(self, record: Any) -> None:
        """Keep the front of the record, if it has one, until the end of the task is heard of.

        Raises KeyboardInterrupt when the task was asked to stop before.
        """
        stopped = self._line.stopped
        self._line.send(replace(self._said, front=getattr(record, "front", self._said.front)))
        if stopped:
            raise KeyboardInterrupt

    def close(self) -> None:
        """End the reports."""
        self._line.close()


class Watch:
    """Counts the tasks that end, keeps their records, and reports while the others run.

    As a context it also has Ctrl-C, and SIGTERM where someone handles it, tell the tasks to stop:
    none of them passes for finished, whatever a library makes of the exception that the signal
    raises. Reports come from this process, some of them from a thread of its own, never two at
    once.

    Parameters
    ----------
    progress : called with every :class:`Step`.
    plan : the tasks to come: name -> rough seconds it takes on one core.
    workers : how many of them run at a time.
    """

    def __init__(
        self, progress: Callable[[Step], None] | None, plan: Mapping[str, float], workers: int
    ) -> None:
        """Take who listens, what is to come and how much of it at a time."""
        self.progress, self.plan, self.workers = progress, plan, workers
        self.records: dict[str, Any] = {}
        self.messages = Messages()
        self.began = time.monotonic()
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._report_on, daemon=True)
        self._handlers: dict[int, Any] = {}
        self._hook = ExitStack()

    def __enter__(self) -> Self:
        """Begin to report."""
        # A Ctrl-C here, or a fault of the caller's own reporter, leaves the handlers as they were.
        with ExitStack() as hook:
            if threading.current_thread() is threading.main_thread():
                hook.enter_context(heard_again(KeyboardInterrupt, interrupt_again))
                for number in (signal.SIGINT, signal.SIGTERM):
                    handler = signal.getsignal(number)
                    if callable(handler):
                        self._handlers[number] = handler
                        hook.callback(self._give_back, number)
                        signal.signal(number, self._stop)
            if self.progress is not None:
                self._tell()
                self._thread.start()
            self._hook = hook.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        """End the reports."""
        with self._hook:
            self._over.set()
            if self._thread.is_alive():
                self._thread.join()
            self.messages.end()

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.messages.stopped = True
        self._handlers[number](number, frame)

    def _give_back(self, number: int) -> None:
        # A handler that has put another in its place is done.
        if signal.getsignal(number) == self._stop:
            signal.signal(number, self._handlers[number])

    def __call__(self, task: str, title: str, record: Any) -> None:
        """Take a task that has ended."""
        self.records[task] = record
        if self.progress is not None:
            self._tell(title, record, getattr(record, "summary", ""))

    def skip(self, tasks: Iterable[str]) -> None:
        """Take tasks out of the plan that are not needed any more; what has ended stays in it."""
        gone = set(tasks) & self.plan.keys() - self.records.keys()
        self.plan = {name: usual for name, usual in self.plan.items() if name not in gone}
        # Nothing may come after it that would tell.
        if gone and self.progress is not None:
            self._tell()

    def running(self) -> tuple[Running, ...]:
        """Give what the tasks that have not ended last said, by name."""
        said = dict(self.messages.last)
        return tuple(said[name] for name in sorted(said) if name not in self.records)

    def _report_on(self) -> None:
        while not self._over.wait(_SECONDS_BETWEEN):
            self._tell()

    def _tell(self, what: str = "", record: Any = None, found: str = "") -> None:
        assert self.progress is not None
        running = self.running()
        taken = {name: float(getattr(r, "seconds", 0.0)) for name, r in self.records.items()}
        left = estimate_left(self.plan, taken, {r.task: r.seconds for r in running}, self.workers)
        counts = len(self.records), len(self.plan)
        seconds = time.monotonic() - self.began
        with self._lock:
            self.progress(Step(what, *counts, record, found, running, seconds, left))


class Turns:
    """Items that are done one after the other, reported as each ends and while it runs.

    As a context it reports; going through it gives the items.

    Parameters
    ----------
    items : what is done.
    name : says what an item is called.
    progress : is called with a :class:`Step`; None for no reports.

    >>> steps = []
    >>> with Turns([1, 2], str, steps.append) as turns:
    ...     done = [2 * item for item in turns]
    >>> done, [(step.what, step.done, step.total) for step in steps if step.what]
    ([2, 4], [('1', 1, 2), ('2', 2, 2)])
    """

    def __init__(
        self,
        items: Sequence[Any],
        name: Callable[[Any], str],
        progress: Callable[[Step], None] | None,
    ) -> None:
        """Take what is to come."""
        self._items = {name(item): item for item in items}
        self._watch = Watch(progress, dict.fromkeys(self._items, _USUAL), 1)
        self._said: Running | None = None

    def __enter__(self) -> Self:
        """Begin to report."""
        self._watch.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        """End the reports."""
        self._watch.__exit__(*error)

    def __iter__(self) -> Iterator[Any]:
        """Give the items, and say when each of them ends."""
        for title, item in self._items.items():
            best = {} if self._said is None else self._said.equations
            self._said = Running(title, title)
            self.say(best)
            began = time.monotonic()
            yield item
            self._watch(title, title, Ended(time.monotonic() - began, self._said.best))

    def say(self, equations: Mapping[str, sympy.Expr]) -> None:
        """Say what the best equations of all states are so far.

        Parameters
        ----------
        equations : state -> its equation.
        """
        from dynsr.expression import shown
        from dynsr.fit import tidy

        assert self._said is not None
        lines = [f"{state}' = {shown(tidy(e), _DIGITS)}" for state, e in equations.items()]
        self._said = replace(self._said, best=", ".join(lines), equations=dict(equations))
        self._watch.messages.send(self._said)


def estimate_left(
    plan: Mapping[str, float],
    taken: Mapping[str, float],
    spent: Mapping[str, float],
    workers: int,
) -> float | None:
    """Guess the seconds until all tasks have ended; None when they have.

    Every task has its usual seconds in ``plan``, scaled by how long the ended ones took, which is
    in ``taken``; ``spent`` has the seconds that running tasks have had.

    >>> estimate_left({"a": 6.0, "b": 6.0}, {}, {"a": 2.0}, 1)
    10.0
    """
    telling = [name for name, seconds in taken.items() if name in plan and seconds > _AT_ONCE]
    usual = _BELIEF + sum(plan[name] for name in telling)
    scale = (_BELIEF + sum(taken[name] for name in telling)) / usual
    left = []
    for name, seconds in plan.items():
        if name not in taken:
            whole, had = seconds * scale, spent.get(name, 0.0)
            # What has run longer than is usual may well run as long again by a quarter.
            left.append(max(whole - had, 0.25 * max(whole, had)))
    return max(sum(left) / max(workers, 1), *left) if left else None
