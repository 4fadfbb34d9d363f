"""Serving: the page, to the browser of this machine that knows its address, and to nobody else.

The address contains a random token. Requests without it are refused, and so are requests that name
another host: a page of the network that a browser has open can neither guess the token nor be this
host. What is sent here is bounded; what the page loads comes from here alone.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import os
import re
import secrets
import signal
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, BinaryIO

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler, stream_request_body

from dynsr.app.desk import OF_COLUMNS, READ, REDRAW, SEARCH, WRITE, Desk
from dynsr.data import own_folder
from dynsr.errors import InputError, in_words, one_line

HOST = "127.0.0.1"
DEFAULT_MEGABYTES = 50
_MEGABYTE = 1 << 20
# Everything but a file of data is short.
_LARGEST_REQUEST = 1 << 18
_LARGEST_HEADER = 1 << 14
_TOKEN_BYTES = 24
_PATIENCE = 20.0
# What is too large is taken and thrown away up to so many times the limit; then the line is cut.
_DRAINED = 20
_TABLES = (".csv", ".tsv", ".txt", ".dat", ".lvm", ".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
# In bytes; a name may have 255.
_LONGEST_NAME, _LONGEST_SUFFIX = 80, 10
# Digits of the size of a file.
_LONGEST_SIZE = 18
_KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
_DOWNLOADS = {
    "report.html": "text/html",
    "model.py": "text/x-python",
    "discovery.json": "application/json",
}
_EXPORTED = r"found_[a-z_]+\.[A-Za-z0-9]+"
# Pictures and formulas have styles of their own; nothing else may come from elsewhere or inline.
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; connect-src 'self'; "
    "style-src 'self' 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def serve(
    data: Path | None = None,
    *,
    port: int = 0,
    jobs: int = -1,
    megabytes: float = DEFAULT_MEGABYTES,
    browse: bool = True,
    say: Callable[[str], None] = print,
) -> None:
    """Serve the page on this machine until Ctrl-C, or its own Quit, ends it.

    Parameters
    ----------
    data : a file to begin with; any that :func:`dynsr.discover` reads.
    port : the port; 0 takes a free one.
    jobs : searches at a time; -1 uses every core.
    megabytes : the largest file that may be dropped on the page.
    browse : whether a browser is opened.
    say : called with the address.

    Raises InputError when the file is not there or the port is taken.
    """
    if data is not None and not data.is_file():
        raise InputError(f"there is no file {str(data)!r}; check the name")
    # What is amiss with requests is no business of the terminal's.
    logging.getLogger("tornado").setLevel(logging.CRITICAL)
    own = data and data.absolute()
    with own_folder("dynsr-app-") as folder:
        ended_by = asyncio.run(_serve(folder, own, port, jobs, megabytes, browse, say))
    if ended_by:
        signal.raise_signal(ended_by)


async def _serve(
    folder: Path,
    data: Path | None,
    port: int,
    jobs: int,
    megabytes: float,
    browse: bool,
    say: Callable[[str], None],
) -> int:
    """Serve until the end; gives the number of the signal that ended it, or 0."""
    try:
        sockets = bind_sockets(port, HOST)
    except (OSError, OverflowError):
        raise InputError(f"port {port} of {HOST} cannot be used; give another, or 0") from None
    port = sockets[0].getsockname()[1]
    token, over = secrets.token_urlsafe(_TOKEN_BYTES), asyncio.Event()
    desk = Desk(folder, jobs)
    try:
        largest = int(megabytes * _MEGABYTE)
        desk.show("about", {"largest": largest, "tables": _TABLES})
        site = _make_site(token, port, largest, desk, over.set)
        server = HTTPServer(
            site,
            max_body_size=_LARGEST_REQUEST,
            max_header_size=_LARGEST_HEADER,
        )
        server.add_sockets(sockets)
        if data is not None:
            desk.ask(READ, path=str(data))
        address = f"http://{HOST}:{port}/{token}/"
        say(address)
        if browse:
            # A browser of the terminal lets nothing else go on.
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        with _noted_signals(over.set) as heard:
            await over.wait()
        # The answer to Quit is on its way.
        await asyncio.sleep(0.1)
        server.stop()
    finally:
        desk.close()
    return heard[0] if heard else 0


@contextmanager
def _noted_signals(end: Callable[[], None]) -> Iterator[list[int]]:
    """Have the first Ctrl-C or SIGTERM call ``end``; gives the list of what came.

    A handler that raises does so wherever the loop is. What the loop was about to call would be
    lost, and who waits for that, as tasks that are cancelled do, would wait forever.
    """
    loop, heard = asyncio.get_running_loop(), []
    before: dict[int, Any] = {}

    def give_back() -> None:
        while before:
            number, handler = before.popitem()
            loop.remove_signal_handler(number)
            signal.signal(number, handler)

    def note(number: int) -> None:
        # Whoever sends a second one has no more patience.
        give_back()
        heard.append(number)
        end()

    if threading.current_thread() is threading.main_thread() and sys.platform != "win32":
        for number in (signal.SIGINT, signal.SIGTERM):
            handler = signal.getsignal(number)
            if handler not in (None, signal.SIG_IGN):
                loop.add_signal_handler(number, note, number)
                before[number] = handler
    try:
        yield heard
    finally:
        give_back()


def _make_site(
    token: str, port: int, largest: int, desk: Desk, leave: Callable[[], None]
) -> Application:
    hosts = (f"{HOST}:{port}", f"localhost:{port}")
    common = {"token": token, "hosts": hosts, "desk": desk}
    wishes = "columns|example|search|stop|redraw|forget|quit"
    downloads = "|".join((*map(re.escape, _DOWNLOADS), _EXPORTED))
    return Application(
        [
            (r"/[^/]*/(|page\.css|page\.js)", _Page, common),
            (r"/[^/]*/changes", _Changes, common),
            (r"/[^/]*/data", _Upload, {**common, "largest": largest}),
            (rf"/[^/]*/({wishes})", _Wish, {**common, "leave": leave}),
            (rf"/[^/]*/({downloads})", _Download, common),
        ],
        default_handler_class=_Guarded,
        default_handler_args=common,
        log_function=lambda handler: None,
        compress_response=True,
    )


class _Guarded(RequestHandler):
    """Answers nobody who does not know the token, or came by another name; alone it has nothing."""

    def initialize(self, token: str, hosts: tuple[str, ...], desk: Desk) -> None:
        self.token, self.hosts, self.desk = token, hosts, desk
        self.trusted = False

    def set_default_headers(self) -> None:
        self.clear_header("Server")
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse what is not the page itself, before anything of it is read."""
        host, headers = self.request.host.lower(), self.request.headers
        own = (None, f"http://{host}")
        given = self.request.path.partition("/")[2].partition("/")[0]
        if (
            host not in self.hosts
            or headers.get("Origin") not in own
            or headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin")
        ):
            self.refuse(403)
            return
        if hmac.compare_digest(given.encode(errors="replace"), self.token.encode()):
            self.trusted = type(self) is not _Guarded
        if not self.trusted:
            self.refuse(404)

    def refuse(self, status: int, error: str = "") -> None:
        """Answer with an error, in one line or without a word."""
        self.set_status(status)
        self.finish({"error": one_line(error)} if error else None)

    def write_error(self, status_code: int, **about: Any) -> None:
        """Answer with the line that says what went wrong."""
        error = (about.get("exc_info") or (None, None))[1]
        if not self.trusted:
            # Whatever was odd about the request, it is nobody's that is answered.
            self.refuse(404)
            return
        if isinstance(error, InputError):
            self.set_status(400)
        elif isinstance(error, HTTPError):
            error = None
        self.finish({"error": in_words(error)} if error else None)

    def log_exception(self, kind: Any, error: Any, trace: Any) -> None:
        """Leave the terminal to what its user is to do; the page shows errors."""
        if os.environ.get("DYNSR_DEBUG"):
            super().log_exception(kind, error, trace)

    def data_received(self, chunk: bytes) -> None:
        """Take a piece of a body that comes bit by bit."""


class _Page(_Guarded):
    def get(self, name: str) -> None:
        """Give the page or what belongs to it."""
        name = name or "page.html"
        kind = _KINDS[name[name.rindex(".") :]]
        self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.finish(files("dynsr.app").joinpath("page").joinpath(name).read_bytes())


class _Changes(_Guarded):
    async def get(self) -> None:
        """Give what has changed since a version, as soon as something has."""
        try:
            after = int(self.get_query_argument("after", "0"))
        except ValueError:
            raise InputError("after must be a number; load the page again") from None
        self.finish(await self.desk.changes(after, _PATIENCE))


class _Wish(_Guarded):
    def initialize(self, leave: Callable[[], None], **common: Any) -> None:  # type: ignore[override]
        super().initialize(**common)
        self.leave = leave

    def post(self, wish: str) -> None:
        """Do what a button of the page is for."""
        given = self._read()
        if wish == "columns":
            self.desk.ask_again({name: _words(given, name) for name in OF_COLUMNS})
        elif wish == "search":
            self.desk.ask(SEARCH, options=_mapping(given, "options"))
        elif wish == "redraw":
            values, run = _mapping(given, "values"), given.get("run", 0)
            if not isinstance(run, int):
                raise InputError("run must be a number; load the page again")
            self.desk.ask(REDRAW, values={s: _numbers(v) for s, v in values.items()}, run=run)
        else:
            {
                "example": self.desk.try_example,
                "stop": self.desk.stop,
                "forget": self.desk.forget,
                "quit": self.leave,
            }[wish]()
        self.finish({})

    def _read(self) -> dict[str, Any]:
        try:
            given = json.loads(self.request.body or b"{}")
        except (ValueError, RecursionError):
            given = None
        if not isinstance(given, dict):
            raise InputError("this is no JSON object; load the page again")
        return given


def _mapping(given: dict[str, Any], name: str) -> dict[str, Any]:
    found = given.get(name, {})
    if not isinstance(found, dict):
        raise InputError(f"{name} must be an object; load the page again")
    return found


def _words(given: dict[str, Any], name: str) -> dict[str, str]:
    return {key: str(value) for key, value in _mapping(given, name).items()}


def _numbers(values: Any) -> list[float]:
    if isinstance(values, list) and all(type(v) in (int, float) for v in values):
        with suppress(OverflowError):
            return [float(v) for v in values]
    raise InputError("constants must be numbers; write them like 1.5")


@stream_request_body
class _Upload(_Guarded):
    """Takes a file bit by bit; of one that is too large, or of another kind, nothing is kept."""

    def initialize(self, largest: int, **common: Any) -> None:  # type: ignore[override]
        super().initialize(**common)
        self.largest = largest
        self.name = self.error = ""
        self.status = 400
        self.target: Path | None = None
        self.file: BinaryIO | None = None

    def prepare(self) -> None:
        """Look at name and size before the first byte comes."""
        super().prepare()
        if self._finished or self.request.method != "POST":
            return
        size = self.request.headers.get("Content-Length", "")
        if not size.isdecimal() or len(size) > _LONGEST_SIZE:
            self.refuse(411)
            return
        # A browser that is refused before it has sent all shows no reason.
        self.request.connection.set_max_body_size(_DRAINED * self.largest)  # type: ignore[union-attr]
        self.name = _clean(self.get_query_argument("name", "data.csv"))
        self.error = self._fault(int(size))
        if not self.error:
            with self._disk():
                self.target = self.desk.place_for(self.name)
                self.file = self.target.open("xb")

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Write in here; where that cannot be, nothing is kept, and the reason names no place."""
        try:
            yield
        except OSError as error:
            self.status = 507
            self.error = f"{self.name!r} cannot be kept: {error.strerror or type(error).__name__}"
            self._drop()

    def _fault(self, size: int) -> str:
        if size > self.largest:
            self.status = 413
            return (
                f"{self.name!r} has {size / _MEGABYTE:.1f} MB, more than the "
                f"{self.largest / _MEGABYTE:g} MB that are taken; give fewer rows, or start dynsr "
                "app with a larger --megabytes"
            )
        if Path(self.name).suffix.lower() not in _TABLES:
            return (
                f"{self.name!r} is no table that the page takes ({', '.join(_TABLES)}); save the "
                "data as CSV, or start dynsr app with the file"
            )
        return ""

    def data_received(self, chunk: bytes) -> None:
        """Keep a piece of the file."""
        if self.file is not None:
            with self._disk():
                self.file.write(chunk)

    def post(self) -> None:
        """Have the file read."""
        if self.file is not None:
            with self._disk():
                # A disk may be full at the last moment.
                self.file.close()
        if self.file is None or self.target is None:
            self.refuse(self.status, self.error)
            return
        self.desk.read(self.target)
        # It is the desk's now.
        self.file = self.target = None
        self.finish({})

    def on_finish(self) -> None:
        """Keep nothing of a file that nobody reads, whatever the request was."""
        self._drop()

    def on_connection_close(self) -> None:
        """Keep nothing of a file that did not come whole."""
        self._drop()

    def _drop(self) -> None:
        """Keep nothing of this file."""
        if self.file is not None:
            with suppress(OSError):
                self.file.close()
        if self.target is not None:
            self.desk.drop(self.target)
        self.file = self.target = None


def _clean(name: str) -> str:
    """Give the name of a file without folders and odd signs, at most so many bytes."""
    name = re.sub(r"[^\w .()+,=-]", "_", name.replace("\\", "/").rpartition("/")[2]).lstrip(". ")
    stem, dot, suffix = name.rpartition(".")
    return f"{_cut(stem or 'data', _LONGEST_NAME)}{dot}{_cut(suffix, _LONGEST_SUFFIX)}"


def _cut(text: str, count: int) -> str:
    """Give the first whole letters that take no more bytes."""
    return text.encode(errors="replace")[:count].decode(errors="ignore")


class _Download(_Guarded):
    async def get(self, name: str) -> None:
        """Give a file of what was found, which is written now."""
        if error := await self.desk.ask(WRITE, name=name):
            raise InputError(error)
        stem = re.sub(r"[^\w.-]", "_", self.desk.stem, flags=re.ASCII) or "dynsr"
        kind = "application/zip" if name.endswith(".zip") else "text/plain"
        self.set_header("Content-Type", f"{_DOWNLOADS.get(name, kind)}; charset=utf-8")
        self.set_header("Content-Disposition", f'attachment; filename="{stem}-{name}"')
        self.finish((self.desk.folder / name).read_bytes())
