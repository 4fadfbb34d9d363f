"""One Julia for a whole run: the process that started the workers lets its Julia answer them too.

A Julia takes 600 to 800 MB and some seconds to start; one in each worker would cost all of that.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing import AuthenticationError
from multiprocessing.connection import Client, Connection, Listener
from typing import Any

import numpy as np

from dynsr.engines.julia.process import Announce, Message
from dynsr.errors import EngineError, EngineUnavailable

# Of one process, for those that it starts: its number, the address, the key.
VARIABLE = "DYNSR_JULIA_HOST"
_BACKLOG, _PAUSE = 64, 0.05
# A request with its limits in seconds; the last argument raises when nobody waits any more.
Ask = Callable[
    [Mapping[str, Any], Mapping[str, np.ndarray], float, float, Callable[[], None]], Message
]


class Host:
    """Answers processes that this one starts, each on a line and a thread of its own.

    Parameters
    ----------
    ask : answers one request; it is called from several threads.
    """

    def __init__(self, ask: Ask) -> None:
        """Listen, and tell the processes that will be started where."""
        self._ask = ask
        key = os.urandom(32)
        self._listener = Listener(_address(), backlog=_BACKLOG, authkey=key)
        os.environ[VARIABLE] = f"{os.getpid()} {key.hex()} {_written(self._listener.address)}"
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        while True:
            try:
                line = self._listener.accept()
            except (OSError, EOFError, AuthenticationError):
                # Who called has gone, or is no process of ours; or files have run out for now.
                time.sleep(_PAUSE)
                continue
            threading.Thread(target=self._hear, args=(line,), daemon=True).start()

    def _hear(self, line: Connection) -> None:
        def check() -> None:
            # Who waits for an answer says nothing: what comes is the end of the line.
            if line.poll():
                raise EngineError("nobody waits for the answer any more")

        with line, suppress(OSError, EOFError):
            while True:
                header, arrays, seconds, start_seconds = line.recv()
                try:
                    answer: tuple[str, Any] = (
                        "answer",
                        self._ask(header, arrays, seconds, start_seconds, check),
                    )
                except EngineUnavailable as problem:
                    answer = ("unavailable", str(problem))
                except EngineError as problem:
                    answer = ("error", str(problem))
                line.send(answer)


class Guest:
    """The Julia of the process that started this one, as if it were a worker of our own."""

    def __init__(self, line: Connection) -> None:
        """Ask on an open line."""
        self._line = line

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return not self._line.closed

    def request(
        self,
        header: Mapping[str, Any],
        arrays: Mapping[str, np.ndarray],
        seconds: float,
        start_seconds: float,
        announce: Announce,
    ) -> Message:
        """Send a request, wait for its answer and give it; the host announces what takes long.

        The time until the requests of others are answered does not count. Raises as
        :meth:`dynsr.engines.julia.process.WorkerProcess.request` does.
        """
        values = {name: np.ascontiguousarray(v, dtype=float) for name, v in arrays.items()}
        try:
            self._line.send((dict(header), values, seconds, start_seconds))
            event, answer = self._line.recv()
        except (OSError, EOFError):
            self.close()
            raise EngineError(
                "the process that holds julia ended; it starts again on its next use"
            ) from None
        except BaseException:
            # An answer that came later would be taken for that of the next request.
            self.close()
            raise
        if event == "answer":
            return answer
        raise (EngineUnavailable if event == "unavailable" else EngineError)(answer)

    def close(self) -> None:
        """End the line."""
        self._line.close()


def has_host() -> bool:
    """Whether the process that started this one offers its Julia.

    One further up may have ended, and knows nothing of the run.
    """
    return os.environ.get(VARIABLE, "").split(" ")[0] == str(os.getppid())


def find_host() -> Guest | None:
    """Give the Julia of the process that started this one; None where it offers none."""
    if not has_host():
        return None
    _, _, rest = os.environ[VARIABLE].partition(" ")
    key, _, address = rest.partition(" ")
    with suppress(OSError, EOFError, AuthenticationError, ValueError):
        return Guest(Client(_readable(address), authkey=bytes.fromhex(key)))
    return None


def _address() -> str | None:
    """Give an address that ends with its process, where there are such."""
    if sys.platform != "linux":
        return None
    return f"\0dynsr-julia-{os.getpid()}-{os.urandom(8).hex()}"


def _written(address: Any) -> str:
    """Write an address down; Linux gives bytes, whose first, zero, no variable can hold."""
    text = address.decode() if isinstance(address, bytes) else str(address)
    return text.replace("\0", "@", 1)


def _readable(address: str) -> str:
    """Undo what :func:`_written` does."""
    return address.replace("@", "\0", 1) if address.startswith("@") else address
