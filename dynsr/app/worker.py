"""Worker: the process behind the page, which does one job after the other and can be stopped.

A job is stopped as Ctrl-C stops a command: searches answer with the best that they have.
"""

from __future__ import annotations

import os
import shutil
import signal
import threading
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from dynsr.app.fields import in_fields
from dynsr.errors import in_words
from dynsr.jobs import signal_main

if TYPE_CHECKING:
    from dynsr.app.work import Work

# What is said to the worker beside jobs, and what it says beside parts of the page.
STOP, LEAVE, END = "stop", "leave", "end"
_SECONDS_TO_LEAVE = 4.0


def run(connection: Connection, folder: Path, jobs: int) -> None:
    """Do jobs until the page, or the process that serves it, is gone.

    Parameters
    ----------
    connection : gives (number, verb, arguments) of jobs, (number, STOP, {}) to stop one and
        (0, LEAVE, {}); takes (name, content) of parts of the page, and (END, (number, error)).
    folder : where files for downloading are written.
    jobs : searches at a time.
    """
    # Ctrl-C in a terminal is meant for the process that serves the page, which says what to do.
    if hasattr(os, "setsid"):
        os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # Only here: no Ctrl-C of the terminal falls into these imports any more.
    from dynsr.jobs import let_garbage_wait

    let_garbage_wait()
    worker = _Worker(connection, folder)
    teller = threading.Thread(target=worker.tell, daemon=True)
    teller.start()
    with suppress(KeyboardInterrupt):
        threading.Thread(target=worker.listen, daemon=True).start()
        worker.work(jobs)
    with suppress(KeyboardInterrupt):
        # Who asks it to leave interrupts it too, which may come when it is leaving already.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    worker.said.put(None)
    teller.join(_SECONDS_TO_LEAVE)
    # What a job wrote meanwhile.
    worker.clear()


class _Worker:
    """The job that is done, and the threads that receive other jobs and report on it.

    A thread of its own reports, since what an interrupt cuts short could not be read.
    """

    def __init__(self, connection: Connection, folder: Path) -> None:
        self._connection, self._folder = connection, folder
        self._jobs: SimpleQueue[tuple[int, str, dict[str, Any]]] = SimpleQueue()
        self.said: SimpleQueue[tuple[str, Any] | None] = SimpleQueue()
        self._current = self._taken = 0
        self._loaded = self._leaving = self.orphaned = False

    def listen(self) -> None:
        """Take jobs, and requests to stop, until nobody is there any more."""
        verb = ""
        while verb != LEAVE:
            try:
                number, verb, arguments = self._connection.recv()
            except (EOFError, OSError):
                verb = ""
                break
            if verb == STOP and number == self._current:
                signal_main(signal.SIGINT)
            elif verb not in (STOP, LEAVE):
                self._jobs.put((number, verb, arguments))
        self._leaving = True
        loaded = self._loaded
        # Who made the folder may be gone without a word, and data are not left behind. First of
        # all: what ends with the main thread is this thread too.
        self.orphaned = verb != LEAVE
        self.clear()
        if loaded:
            signal_main(signal.SIGINT)
            self._jobs.put((0, LEAVE, {}))
        else:
            # Compiled modules tell an interrupt of their import as an error of their own.
            os._exit(0)
        # Of itself the process ends before that, with all that it started.
        time.sleep(_SECONDS_TO_LEAVE)
        self.clear()
        os._exit(1)

    def clear(self) -> None:
        """Remove the folder where nobody else will."""
        if self.orphaned:
            shutil.rmtree(self._folder, ignore_errors=True)

    def tell(self) -> None:
        """Send what is said."""
        with suppress(OSError):
            while (one := self.said.get()) is not None:
                self._connection.send(one)

    def work(self, jobs: int) -> None:
        """Do jobs, one after the other."""
        from dynsr.app.work import Work

        self._loaded = True
        work = Work(self._folder, lambda name, content: self.said.put((name, content)), jobs)
        work.offer()
        while not self._leaving:
            error = ""
            with suppress(KeyboardInterrupt):
                self._taken, verb, arguments = self._jobs.get()
                if self._leaving:
                    break
                self._current = self._taken
                error = _do(work, verb, arguments)
            with suppress(KeyboardInterrupt):
                self._current = 0
            self.said.put((END, (self._taken, error)))


def _do(work: Work, verb: str, arguments: dict[str, Any]) -> str:
    """Do a job; gives the line that says what ended it, "" where nothing did."""
    try:
        getattr(work, verb)(**arguments)
    except Exception as error:
        if os.environ.get("DYNSR_DEBUG"):
            import traceback

            traceback.print_exc()
        return in_fields(in_words(error))
    return ""
