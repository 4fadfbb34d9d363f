"""Workers: calls spread over processes by joblib, which neither Ctrl-C nor a kill leaves behind."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from joblib import Parallel, delayed

_WATCH_SECONDS = 1.0


def spread(
    work: Callable[..., Any], calls: Sequence[tuple[Any, ...]], jobs: int
) -> Generator[tuple[int, Any], None, None]:
    """Give (number of the call, result) as calls end, in any order.

    The joblib backend in force is used. When this process is interrupted or the iterator is
    closed, workers of its own are killed; when it is killed, they end by themselves.
    """
    if jobs == 1 or len(calls) < 2:
        yield from ((i, work(*call)) for i, call in enumerate(calls))
        return
    numbered = [delayed(_run)(os.getpid(), i, work, call) for i, call in enumerate(calls)]
    try:
        pool = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    except ValueError:
        # This backend only gives all results at once.
        yield from Parallel(n_jobs=jobs, batch_size=1)(numbered)
        return
    with _shielded():
        results = pool(numbered)
    try:
        # Not "yield from", which would close joblib's generator before its warnings are off.
        for result in results:  # noqa: UP028
            yield result
    finally:
        # joblib warns that results are left, which is what an interrupt means.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            results.close()


def _run(parent: int, index: int, work: Callable[..., Any], call: tuple[Any, ...]) -> Any:
    if os.getpid() != parent and os.getppid() == parent:
        _follow(parent)
    return index, work(*call)


@contextmanager
def _shielded() -> Iterator[None]:
    """Hold Ctrl-C back while workers start: they inherit that it is not meant for them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@lru_cache(maxsize=1)
def _follow(parent: int) -> None:
    """End this worker once its parent is gone."""
    threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()


def _leave_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_SECONDS)
    os._exit(1)
