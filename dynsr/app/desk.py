"""Desk: what the page shows, part by part, and the process that does its work."""

from __future__ import annotations

import asyncio
import multiprocessing
import shutil
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from dynsr.app.worker import END, LEAVE, STOP, run
from dynsr.errors import InputError, one_line

EXAMPLE = "prey-and-predators.csv"
READ, SEARCH, REDRAW, WRITE = "read", "search", "redraw", "write"
# What the page says of columns, by the arguments of the method READ.
OF_COLUMNS = ("roles", "units", "ways", "errors", "limits")
_KEEP, _RESTORE = "keep", "restore"
_DATA = "data-"
_RESULTS = ("found", "progress", "picture")
_SECONDS_TO_STOP = 10.0
_SECONDS_TO_LEAVE = 6.0
_SECONDS_TO_DRAW = 20.0
_NONE = "there are no equations; find them first"
_BUSY = "a search is running; cancel it first"
_TOO_LONG = "the equations take too long to integrate with these constants; those before are back"
_NO_START = "the process that is to do this does not start; the shell says why, or dynsr doctor"
_DIED = "the process that did this died, perhaps for want of memory; give fewer rows"


@dataclass(frozen=True, eq=False)
class _Job:
    """What the worker is asked for; ``ended`` has the line that says what went wrong, or ""."""

    verb: str
    arguments: Mapping[str, Any]
    ended: asyncio.Future[str]

    def end(self, error: str) -> None:
        if not self.ended.done():
            self.ended.set_result(error)


class Desk:
    """The parts of the page, each with the version in which it changed, and one worker.

    Use it inside a running event loop, and :meth:`close` it at the end.

    Parameters
    ----------
    folder : where files for downloading are written.
    jobs : searches at a time.
    """

    def __init__(self, folder: Path, jobs: int = -1) -> None:
        """Start the worker, which loads what it needs while the page opens."""
        self.folder = folder
        self._jobs = jobs
        self._loop = asyncio.get_running_loop()
        self._news: asyncio.Future[None] = self._loop.create_future()
        self._version = 0
        self._parts: dict[str, tuple[int, Any]] = {}
        self._number = 0
        self._waiting: list[_Job] = []
        self._job: _Job | None = None
        self._stopped = False
        self._source: dict[str, Any] | None = None
        # What the search that runs was asked for, and state -> the best formula that it told.
        self._options: Mapping[str, Any] = {}
        self._best: dict[str, str] = {}
        # The folders of files that come in or wait to be read.
        self._coming: set[Path] = set()
        self._closed = self._lost = False
        self._start()
        self.show("busy", "")

    def show(self, name: str, content: Any) -> None:
        """Change a part of the page.

        Parameters
        ----------
        name : the part; None as ``content`` takes it away.
        content : plain values.
        """
        self._version += 1
        self._parts[name] = self._version, content
        if not self._news.done():
            self._news.set_result(None)

    async def changes(self, after: int, patience: float) -> dict[str, Any]:
        """Give the parts that changed after a version; waits for the first of them.

        Parameters
        ----------
        after : the version that is known.
        patience : seconds to wait at most.
        """
        if self._version <= after:
            if self._news.done():
                self._news = self._loop.create_future()
            await asyncio.wait({self._news}, timeout=patience)
        changed = {name: own for name, (v, own) in self._parts.items() if v > after}
        return {"version": self._version, "parts": changed}

    def part(self, name: str) -> Any:
        """Give a part of the page; None where there is none."""
        return self._parts.get(name, (0, None))[1]

    @property
    def _doing(self) -> str:
        return self._job.verb if self._job else ""

    def ask(self, verb: str, **arguments: Any) -> asyncio.Future[str]:
        """Have a job done as soon as the one before it is; gives the line that says what failed.

        Parameters
        ----------
        verb : READ, SEARCH, REDRAW or WRITE.
        arguments : those of the method of that name of :class:`dynsr.app.work.Work`.

        Raises InputError while a search runs.
        """
        # What is found is shown a moment before the search ends, and may be asked for then.
        if self._doing == SEARCH and (verb in (READ, SEARCH) or not self.part("found")):
            raise InputError(_BUSY)
        if verb == WRITE and not self.part("found"):
            raise InputError(_NONE)
        if verb in (READ, SEARCH):
            # Columns that were corrected a moment before are read first.
            self._drop(*(job for job in self._waiting if verb == READ or job.verb != READ))
            for name in _RESULTS:
                self.show(name, None)
        if verb == READ:
            self._source = arguments
        if verb == SEARCH:
            self._options, self._best = arguments["options"], {}
        # Of several pictures only the last will be looked at.
        self._drop(*(job for job in self._waiting if job.verb == verb == REDRAW))
        ended = self._put(verb, **arguments)
        self.show("said", "")
        self._go_on()
        return ended

    def ask_again(self, said: Mapping[str, Mapping[str, str]]) -> None:
        """Have the file read with other roles and units of its columns.

        Parameters
        ----------
        said : what the page says of columns, by the names of OF_COLUMNS, as for
            :meth:`dynsr.app.work.Work.read`.

        Raises InputError when there is none, or while a search runs.
        """
        if self._source is None:
            raise InputError("there are no data; drop a file first")
        self.ask(READ, **{**self._source, **said})

    def place_for(self, name: str) -> Path:
        """Give a path for a file that comes in; :meth:`read` or :meth:`drop` it in the end."""
        folder = Path(tempfile.mkdtemp(prefix=_DATA, dir=self.folder))
        self._coming.add(folder)
        return folder / name

    def read(self, path: Path) -> None:
        """Have a file read that came in; those before it, which nobody needs then, go.

        Raises InputError while a search runs.
        """

        def done(_: asyncio.Future[str]) -> None:
            self._coming.discard(path.parent)
            self._clear_away()

        self.ask(READ, path=str(path)).add_done_callback(done)

    def try_example(self) -> None:
        """Have the example read that comes with the page: prey and predators, with noise.

        Raises InputError while a search runs, or where the disk is full.
        """
        path = self.place_for(EXAMPLE)
        try:
            path.write_bytes(files("dynsr.app").joinpath("page").joinpath(EXAMPLE).read_bytes())
            self.read(path)
        except OSError as error:
            self.drop(path)
            raise InputError(f"the example cannot be kept: {one_line(error)}") from None
        except InputError:
            self.drop(path)
            raise

    def drop(self, path: Path) -> None:
        """Keep nothing of a file that came in."""
        self._coming.discard(path.parent)
        shutil.rmtree(path.parent, ignore_errors=True)

    def _clear_away(self) -> None:
        """Remove the files that were read, but that which the page is about."""
        needed = {*self._coming, *([Path(self._source["path"]).parent] if self._source else ())}
        for folder in self.folder.glob(f"{_DATA}*"):
            if folder not in needed:
                shutil.rmtree(folder, ignore_errors=True)

    @property
    def stem(self) -> str:
        """The name of the file without its suffix; "" where there is none."""
        return Path(self._source["path"]).stem if self._source else ""

    def _drop(self, *jobs: _Job) -> None:
        self._waiting = [job for job in self._waiting if job not in jobs]
        for job in jobs:
            job.end("another one was asked for")

    def stop(self) -> None:
        """Stop what is being done: politely, and by force where that takes too long."""
        if self._job is None or self._stopped:
            return
        self._stopped = True
        if self._doing in (READ, SEARCH):
            self.show("busy", "stopping")
        self._tell(self._number, STOP, {})
        self._loop.call_later(_SECONDS_TO_STOP, self._end, self._number)

    def forget(self) -> None:
        """Take everything away, for other data."""
        if self._doing == SEARCH:
            raise InputError(_BUSY)
        self._drop(*self._waiting)
        self._source = None
        for name in ("table", "preview", "found", "progress", "picture"):
            self.show(name, None)
        self.show("said", "")
        self._clear_away()

    def close(self) -> None:
        """End the worker and all that it started."""
        self._closed = True
        if self._lost:
            return
        self._tell(0, LEAVE, {})
        self._process.join(_SECONDS_TO_LEAVE)
        self._kill()

    def _start(self) -> None:
        self._heard = self._lost = False
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        # Not a daemon: those may have no workers of their own.
        self._process = context.Process(target=run, args=(theirs, self.folder, self._jobs))
        self._process.start()
        theirs.close()
        self._connection = ours
        threading.Thread(target=self._listen, args=(ours,), daemon=True).start()

    def _listen(self, connection: Connection) -> None:
        """Pass on what a worker says, until it is gone."""
        while True:
            try:
                name, content = connection.recv()
            except (EOFError, OSError):
                name, content = "", None
            with suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._hear, connection, name, content)
            if not name:
                connection.close()
                return

    def _hear(self, connection: Connection, name: str, content: Any) -> None:
        if connection is not self._connection or self._closed:
            return
        if not name:
            self._replace()
            return
        self._heard = True
        if name == END:
            number, error = content
            if number == self._number and self._job is not None:
                self._finish(self._job, error)
            return
        if name == "progress" and content["best"]:
            self._best = {s: one["formula"] for s, one in content["best"].items()}
        if not (name == "progress" and self._stopped):
            self.show(name, content)

    def _finish(self, job: _Job, error: str) -> None:
        """Take the end of a job, and go on with the next."""
        self._job = None
        if job.verb == SEARCH:
            self.show("progress", None)
        product = {READ: "table", SEARCH: "found"}.get(job.verb)
        if job.verb == SEARCH and self._best and not self.part("found"):
            self._keep()
        elif self._stopped and product and not error and not self.part(product):
            error = "stopped before anything was found"
        if self._stopped and job.verb == REDRAW:
            error = _TOO_LONG
        if error:
            self.show("said", error)
            if job.verb == READ:
                self.show("table", None)
                self.show("preview", None)
        job.end(error)
        self._go_on()

    def _go_on(self) -> None:
        if self._job is None and self._waiting:
            if self._lost:
                self._start()
            self._job = self._waiting.pop(0)
            self._number += 1
            self._stopped = False
            if self._job.verb in (READ, SEARCH):
                # What the job before it still had to tell.
                for name in filter(self.part, _RESULTS):
                    self.show(name, None)
            self._tell(self._number, self._job.verb, self._job.arguments)
            if self._job.verb == REDRAW:
                self._loop.call_later(_SECONDS_TO_DRAW, self._give_up, self._number)
        doing = {READ: READ, SEARCH: SEARCH, _KEEP: "stopping", _RESTORE: "stopping"}
        self.show("busy", doing.get(self._doing, ""))

    def _keep(self) -> None:
        """Have the formulas taken that a search had reported before it ended without a result."""
        formulas, self._best = self._best, {}
        self._put(_KEEP, formulas=formulas, options=self._options)
        self._put(REDRAW, values={}, run=0)

    def _put(self, verb: str, **arguments: Any) -> asyncio.Future[str]:
        job = _Job(verb, arguments, self._loop.create_future())
        self._waiting.append(job)
        return job.ended

    def _tell(self, number: int, verb: str, arguments: Mapping[str, Any]) -> None:
        with suppress(OSError, ValueError):  # it has died, of which another thread hears
            self._connection.send((number, verb, dict(arguments)))

    def _give_up(self, number: int) -> None:
        """Stop a picture that takes too long, as constants that make a system stiff may have it."""
        if number == self._number:
            self.stop()

    def _end(self, number: int) -> None:
        """End the worker where the job that was to be stopped goes on."""
        if self._job is not None and number == self._number and not self._closed:
            self._process.kill()

    def _replace(self) -> None:
        """Start another worker in the place of one that died, with the data and what was found."""
        self._kill()
        job, self._job = self._job, None
        found = self.part("found") and not (job and job.verb == _RESTORE)
        searched = job is not None and job.verb == SEARCH
        said, stopped = _DIED, self._stopped
        if stopped:
            said = _TOO_LONG if job and job.verb == REDRAW else "stopped"
        for one in (job, *self._waiting):
            if one is not None:
                one.end(said)
        self._waiting = []
        self.show("progress", None)
        if not self._heard:
            # Another one would end as this one did, until something is changed.
            self._lost = True
            self.show("busy", "")
            self.show("said", _NO_START)
            return
        self._start()
        if self._source is None or (job is not None and job.verb == READ):
            self._source = None
            self.show("table", None)
            self.show("preview", None)
            self.show("busy", "")
        else:
            best = self._best
            self.ask(READ, **self._source)
            if found:
                self._put(_RESTORE)
                # What was found may itself take too long to draw.
                if job is None or job.verb != REDRAW or job.arguments["values"]:
                    self._put(REDRAW, values={}, run=0)
            elif searched and best:
                self._keep()
                said = "" if stopped else f"{_DIED}; these are the best so far"
        self.show("said", said)

    def _kill(self) -> None:
        if self._process.is_alive():
            self._process.kill()
        self._process.join()
        self._process.close()
