"""A process of its own that answers requests, so that its crash is an error and never the end.

loky with one worker is not enough: it ends a worker that grows by 300 MB after its first call, as
Julia does on compiling, keeps no last lines of a crash, and has no way to report progress.

Messages are pickled pairs of a header and arrays. Both ends are dynsr's own, on pipes that nobody
else writes to: the worker takes them for itself before it loads anything foreign.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import queue
import re
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dynsr.errors import EngineError, EngineUnavailable

Announce = Callable[[str], None]
# Plain values by name, and float64 arrays by name.
Message = tuple[dict[str, Any], dict[str, np.ndarray]]
# A stage that is over sooner is not worth a line; the next lines of it come at growing gaps.
QUIET_SECONDS = 2.0
_GROWTH = 4
_TICK = 0.25
_LAST_LINES = 30
_LONGEST_WORDS, _LONGEST_CAUSE, _CAUSE_LINES = 500, 240, 4
# How Julia or Python begins to say what went wrong, a signal included; how a stack begins.
_CAUSE = re.compile(r"ERROR: |fatal: |(\[\d+\] )?signal \(?\d|Fatal Python error: ")
_STACK = re.compile(
    r"(Python )?[Ss]tacktrace:|\[\d+\] |in expression starting at|Allocations: |"
    r"(Current t|T)hread 0x"
)
_SIGNS_OF_PROGRESS = ("Precompiling", "Installing", "Installed", "Downloading", "Resolving")


class WorkerProcess:
    """One running worker: ``module.main()`` in a fresh Python, reached by messages over pipes.

    The worker answers each request with messages whose ``event`` is "progress" (a stage of its
    start, as text), "working" (the start is over, the time limit of the request counts),
    "answer", "error" or "unavailable".

    Parameters
    ----------
    module : the module whose ``main`` answers.
    name : what messages call the worker.
    environment : the environment variables of its process.
    """

    def __init__(self, module: str, name: str, environment: Mapping[str, str]) -> None:
        """Start the process; it answers as soon as it is up."""
        self.name = name
        self._owner = os.getpid()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _start_code(module)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=dict(environment),
            # Ctrl-C is for the user's session; it decides what becomes of the worker.
            start_new_session=True,
        )
        self._messages: queue.SimpleQueue[Message | None] = queue.SimpleQueue()
        self._reports = _Reports()
        self._threads = [
            threading.Thread(target=_receive, args=(self._process, self._messages), daemon=True),
            threading.Thread(target=_listen, args=(self._process, self._reports), daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        self._ending = weakref.finalize(self, _end, self._process, self._owner, self._threads)

    @property
    def alive(self) -> bool:
        """Whether it can be asked: running, and started by this very process."""
        return self._owner == os.getpid() and self._ending.alive and self._process.poll() is None

    def request(
        self,
        header: Mapping[str, Any],
        arrays: Mapping[str, np.ndarray],
        seconds: float,
        start_seconds: float,
        announce: Announce,
        check: Callable[[], None] = lambda: None,
    ) -> Message:
        """Send a request, wait for its answer and give it.

        Parameters
        ----------
        header : plain values by name.
        arrays : float64 arrays of any shape, by name.
        seconds : how long the work may take.
        start_seconds : how long the worker may take before it, to start and to compile.
        announce : is given a line when a stage of the start takes more than QUIET_SECONDS.
        check : is called while the answer is waited for; what it raises ends the wait.

        Raises EngineUnavailable when the worker reports that it cannot start, EngineError when it
        reports a failure, dies or is late; in all cases but a failure, and when the wait is
        interrupted, the worker is ended.
        """
        self._reports.forget_causes()
        try:
            self._send(header, arrays)
            return self._wait(seconds, start_seconds, announce, check)
        except _WorkerError as reported:
            if not isinstance(reported.error, EngineUnavailable):
                raise reported.error from None
            # What failed to load is not loaded by trying again. Once it has ended, all that it
            # wrote has arrived.
            self.close()
            raise EngineUnavailable(self._reports.explain(str(reported.error))) from None
        except BaseException:
            # An answer that came later would be taken for that of the next request.
            self.close()
            raise

    def close(self) -> None:
        """End the worker and give back its pipes; nothing happens when it has ended."""
        if self._owner == os.getpid():
            self._ending()

    def _send(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        assert self._process.stdin is not None
        try:
            values = {name: np.ascontiguousarray(v, dtype=float) for name, v in arrays.items()}
            pickle.dump((dict(header), values), self._process.stdin)
            self._process.stdin.flush()
        except OSError:
            raise EngineError(self._describe_end()) from None

    def _wait(
        self, seconds: float, start_seconds: float, announce: Announce, check: Callable[[], None]
    ) -> Message:
        deadline, limit, doing = time.monotonic() + start_seconds, start_seconds, "start"
        self._reports.begin(self._reports.stage)
        while True:
            left = deadline - time.monotonic()
            if left <= 0:
                raise EngineError(
                    f"{self.name} did not {doing} within {limit:g} s and was stopped; "
                    "it starts again on its next use"
                )
            try:
                message = self._messages.get(timeout=min(left, _TICK))
            except queue.Empty:
                self._reports.announce(self.name, announce)
                check()
                continue
            if message is None:
                raise EngineError(self._describe_end())
            header, _ = message
            if header["event"] == "progress":
                self._reports.begin(str(header["text"]))
            elif header["event"] == "working":
                self._reports.begin("")
                deadline, limit, doing = time.monotonic() + seconds, seconds, "answer"
            elif header["event"] == "answer":
                return message
            else:
                kind = EngineUnavailable if header["event"] == "unavailable" else EngineError
                raise _WorkerError(kind(str(header["message"])))

    def _describe_end(self) -> str:
        code: int | None
        try:
            code = self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            code = None
        self._threads[1].join(timeout=1)
        words = self._reports.causes() or " | ".join(list(self._reports.lines)[-3:]) or "none"
        return (
            f"{self.name} ended unexpectedly ({_manner(code)}) and starts again on its next use; "
            f"its last words: {words[:_LONGEST_WORDS]}"
        )


def _start_code(module: str) -> str:
    # The path is set before anything is imported: no file of the working directory or of the
    # package's own folders can stand in for a module of Python's.
    return f"import sys; sys.path[:] = {json.dumps(sys.path)}; from {module} import main; main()"


class _Reports:
    """What a worker reports: the stage of its start, the last lines it wrote, and what went wrong.

    A cause is a line that says so, with the few that belong to it; the stack below it is no cause.
    """

    def __init__(self) -> None:
        self.lines: deque[str] = deque(maxlen=_LAST_LINES)
        self.forget_causes()
        self.begin("starting")

    def forget_causes(self) -> None:
        """Begin again: what went wrong before is no cause of what comes."""
        self._causes: list[list[str]] = []
        self._open = False

    def note(self, line: str) -> None:
        """Keep a line that is not empty."""
        self.lines.append(line)
        if _CAUSE.match(line):
            self._causes.append([line.removeprefix("ERROR: ")])
            # The first is what others follow from, the last is what ended it.
            del self._causes[1:-1]
            self._open = True
        elif _STACK.match(line):
            self._open = False
        elif self._open and len(self._causes[-1]) < _CAUSE_LINES:
            self._causes[-1].append(line)

    def causes(self) -> str:
        """Give what went wrong in one line, "" where nothing said so."""
        return " | ".join(dict.fromkeys(" ".join(cause)[:_LONGEST_CAUSE] for cause in self._causes))

    def explain(self, problem: str) -> str:
        """Put what went wrong before what the worker said of it."""
        causes = self.causes()
        return f"{causes} ({problem})" if causes and causes not in problem else problem

    def begin(self, stage: str) -> None:
        """Note that a stage begins; an empty one is not announced."""
        self.stage, self._since, self._quiet = stage, time.monotonic(), QUIET_SECONDS

    def announce(self, name: str, announce: Announce) -> None:
        """Announce the stage when it takes long, and again at growing gaps with its seconds."""
        seconds = time.monotonic() - self._since
        if self.stage and seconds > self._quiet:
            so_far = f" ({seconds:.0f} s so far)" if self._quiet > QUIET_SECONDS else ""
            announce(f"{name}: {self.stage}{so_far}")
            self._quiet *= _GROWTH


class _WorkerError(Exception):
    """Carries an error that the worker reported and survived."""

    def __init__(self, error: EngineError) -> None:
        super().__init__(str(error))
        self.error = error


def _manner(code: int | None) -> str:
    if code is None:
        return "its stream broke off"
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"


def _receive(process: subprocess.Popen[bytes], messages: queue.SimpleQueue[Message | None]) -> None:
    assert process.stdout is not None
    # The stream ends, breaks off inside a message, or is closed.
    with contextlib.suppress(EOFError, pickle.UnpicklingError, OSError, ValueError):
        while True:
            messages.put(pickle.load(process.stdout))  # noqa: S301 (our own child)
    messages.put(None)


def _listen(process: subprocess.Popen[bytes], reports: _Reports) -> None:
    """Keep what the worker writes to its standard error; some lines name a stage."""
    assert process.stderr is not None
    try:
        for raw in process.stderr:
            line = raw.decode(errors="replace").strip()
            if line:
                reports.note(line)
            if any(sign in line[:40] for sign in _SIGNS_OF_PROGRESS):
                reports.begin(line[:100])
    except (OSError, ValueError):
        pass


def _end(process: subprocess.Popen[bytes], owner: int, threads: list[threading.Thread]) -> None:
    # A forked child inherits the finalizer, but the worker is its parent's.
    if os.getpid() != owner:
        return
    process.kill()
    process.wait()
    for thread in threads:
        thread.join(timeout=5)
    for stream in (process.stdin, process.stdout, process.stderr):
        if stream is not None:
            # What was still to be written to a dead process is lost, as it should be.
            with contextlib.suppress(OSError):
                stream.close()
