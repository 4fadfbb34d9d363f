"""Watch: how far a running discovery is, what its searches have so far, and the time left."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from dynsr.jobs.checkpoint import Part, Record
from dynsr.jobs.live import LiveFolder

_SECONDS_BETWEEN = 0.5
# Rough seconds of a part on one core, from which the time left is first guessed.
_USUAL = {"rational": 6.0, "sindy": 4.0, "dynaifeynman": 15.0, "genetic": 10.0, "pick": 6.0}
_ELSE = 10.0
# So many seconds' worth of belief in the guess; then the parts that have ended count.
_BELIEF = 10.0
# A part that ends at once had nothing to search and tells nothing of the others.
_AT_ONCE = 0.3


@dataclass(frozen=True)
class Running:
    """What one running part last said.

    ``best`` is its best formula so far as text ("" where it has none yet) and ``loss`` that one's
    error; ``done`` of ``total`` (None while unknown) is how far its ``stage`` is.
    """

    part: str
    state: str
    method: str
    stage: str
    done: float
    total: float | None
    best: str
    loss: float | None
    seconds: float


@dataclass(frozen=True)
class Step:
    """One report of a running discovery.

    ``what`` is the part that has just ended and ``record`` its record, "" and {} where the report
    only says how the ``running`` parts go on; ``done`` of ``total`` parts have ended, after
    ``seconds``; ``seconds_left`` is a rough estimate, None once nothing is left.
    """

    what: str
    done: int
    total: int
    record: Record
    running: tuple[Running, ...] = ()
    seconds: float = 0.0
    seconds_left: float | None = None


class Watch:
    """Counts the parts that end, keeps their records, and reports while the others run.

    Reports come from this process, some of them from a thread of its own, never two at once.
    """

    def __init__(
        self,
        progress: Callable[[Step], None] | None,
        live: LiveFolder,
        plan: Mapping[str, str],
        workers: int,
    ) -> None:
        """Take the parts to come as name -> method."""
        self.progress, self.live, self.plan, self.workers = progress, live, plan, workers
        self.records: dict[str, Record] = {}
        self.began = time.monotonic()
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._report_on, daemon=True)

    def __enter__(self) -> Watch:
        """Begin to report."""
        if self.progress is not None:
            self._tell("", {})
            self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the reports."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def __call__(self, part: Part, record: Record) -> None:
        """Take a part that has ended."""
        self.records[part.name] = record
        self.live.remove(part.name)
        if self.progress is not None:
            self._tell(part.name, record)

    def running(self) -> tuple[Running, ...]:
        """Give what the running parts last said."""
        now = time.time()
        return tuple(
            _read(said, now) for said in self.live.read() if said["part"] not in self.records
        )

    def _report_on(self) -> None:
        while not self._over.wait(_SECONDS_BETWEEN):
            self._tell("", {})

    def _tell(self, what: str, record: Record) -> None:
        assert self.progress is not None
        running = self.running()
        spent = {r.part: r.seconds for r in running}
        left = estimate_left(self.plan, self.records, spent, self.workers)
        seconds = time.monotonic() - self.began
        step = Step(what, len(self.records), len(self.plan), record, running, seconds, left)
        with self._lock:
            self.progress(step)


def _read(said: Mapping[str, Any], now: float) -> Running:
    words = (said["part"], said["state"], said["method"], said["stage"])
    far = (said["done"], said["total"], said["best"], said["loss"])
    return Running(*words, *far, max(0.0, now - said["began"]))


def estimate_left(
    plan: Mapping[str, str],
    ended: Mapping[str, Record],
    spent: Mapping[str, float],
    workers: int,
) -> float | None:
    """Guess the seconds until all parts have ended; None when they have.

    Every method has its usual time, scaled by how long the ended parts took; ``spent`` holds the
    seconds that running parts have had.

    >>> estimate_left({"a": "rational", "b": "rational"}, {}, {"a": 2.0}, 1)
    10.0
    """
    taken = {name: float(ended[name].get("seconds", 0.0)) for name in plan if name in ended}
    telling = [name for name, seconds in taken.items() if seconds > _AT_ONCE]
    usual = {name: _USUAL.get(method, _ELSE) for name, method in plan.items()}
    scale = (_BELIEF + sum(taken[n] for n in telling)) / (_BELIEF + sum(usual[n] for n in telling))
    left = []
    for name in plan:
        if name not in ended:
            whole = usual[name] * scale
            # What has run longer than is usual may well run as long again by a quarter.
            left.append(max(whole - spent.get(name, 0.0), 0.25 * max(whole, spent.get(name, 0.0))))
    return max(sum(left) / max(workers, 1), max(left)) if left else None
