"""Pool: tasks spread over workers by joblib, each of which keeps its record itself.

Neither Ctrl-C nor a kill of this process leaves workers behind.
"""

from __future__ import annotations

import base64
import ctypes
import math
import multiprocessing
import operator
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache, cached_property
from multiprocessing.util import Finalize
from typing import Any, TypeVar

import numpy as np
from joblib import Parallel, delayed, effective_n_jobs, parallel_config
from joblib.externals.loky import reusable_executor
from joblib.externals.loky.backend import resource_tracker
from joblib.externals.loky.process_executor import BrokenProcessPool
from joblib.parallel import BACKENDS, get_active_backend
from threadpoolctl import threadpool_limits

from dynsr.errors import DynsrError, InputError
from dynsr.jobs.budget import uncut
from dynsr.jobs.garbage import let_garbage_wait
from dynsr.jobs.progress import Reporter, Watch
from dynsr.jobs.store import PARTS, RunFolder, as_read, fingerprint
from dynsr.methods import AbstractKeeper, keeping

T = TypeVar("T")

_WATCH_SECONDS = 1.0
# What a kill costs a search at most, beside the part that it was in.
_SECONDS_BETWEEN_STATES = 1.0
_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux


@dataclass(frozen=True)
class Task:
    """One piece of work: ``work(*arguments, report)`` gives a record.

    Parameters
    ----------
    name : that of its record; no other task of the run has it.
    title : what it does, in words for those who watch.
    work, arguments : the function, which other processes can import, and what it is called with.
    kind : the dataclass of its record.
    key : digest of all that the record depends on.
    seconds : rough time it takes on one core.
    failed : gives the record of a task whose process died, from the reason in words; without it
        such a death ends the run.
    """

    name: str
    title: str
    work: Callable[..., Any]
    arguments: tuple[Any, ...]
    kind: type
    key: str = ""
    seconds: float = 10.0
    failed: Callable[[str], Any] | None = None


def check_jobs(jobs: int | None) -> int:
    """Give a number of jobs as joblib takes it, -1 for one per core.

    Raises InputError when it is neither -1, None nor a whole number from 1 up.

    >>> check_jobs(None), check_jobs(2)
    (-1, 2)
    """
    if jobs is None or jobs == -1:
        return -1
    whole = isinstance(jobs, (int, float)) and math.isfinite(jobs) and int(jobs) == jobs
    if not whole or jobs < 1:
        raise InputError(f"jobs {jobs} must be a whole number from 1 up, or -1 for one per core")
    return int(jobs)


def check_seed(seed: Any) -> int:
    """Give a seed as a whole number from 0 up; raises InputError when it is no seed.

    >>> check_seed(7)
    7
    """
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if number < 0:
        raise InputError(f"seed {str(seed)[:40]} must be a whole number from 0 up")
    return number


def run_tasks(
    tasks: Sequence[Task],
    folder: RunFolder,
    jobs: int,
    watch: Watch,
    apart: bool = False,
    finished: Callable[[Any], bool] = lambda record: True,
) -> list[Any]:
    """Run tasks side by side; gives their records in the order of the tasks.

    Records that the folder has are read, where ``finished`` holds for them; every other one is
    kept as soon as it is made, by the process that made it. ``watch`` hears of all of them, and
    of running tasks in between.

    Parameters
    ----------
    jobs : tasks at a time; -1 for one per core. The joblib backend in force is used, so
        ``joblib.parallel_config("dask")`` spreads the tasks over a cluster.
    apart : use processes of their own even for one task at a time.

    A worker that dies takes others with it: then what is unfinished is started again. If one dies
    again, they run one at a time, which shows whose fault it was. Raises DynsrError for a task
    whose process dies alone twice, unless it has a record for that.
    """
    records: dict[int, Any] = {}

    def look() -> list[int]:
        """Take what the folder has, and give the numbers of the tasks that have no record."""
        for number, task in enumerate(tasks):
            if number not in records:
                record = folder.load(task.name, task.key, task.kind, finished)
                if record is not None:
                    records[number] = record
                    watch(task.name, task.title, record)
        return [n for n in range(len(tasks)) if n not in records]

    def take(numbers: Sequence[int], jobs: int, apart: bool) -> None:
        calls = [(tasks[n], folder, watch.messages) for n in numbers]
        # Closed here and now, so that workers are gone before what they had is read.
        with closing(spread(_do, calls, jobs, apart)) as results:
            for i, record in results:
                records[numbers[i]] = record
                with uncut():
                    watch(tasks[numbers[i]].name, tasks[numbers[i]].title, record)

    # What a worker died of must not come into this process.
    for again in (False, True):
        with suppress(BrokenProcessPool):
            take(look(), jobs, apart or again)
    # Twice, as one may have been taken by others before it began.
    for number in 2 * look():
        if number in look():
            with suppress(BrokenProcessPool):
                take([number], 1, True)
    for number in look():
        records[number] = _give_up(tasks[number], folder)
        watch(tasks[number].name, tasks[number].title, records[number])
    return [records[number] for number in range(len(tasks))]


def _do(task: Task, folder: RunFolder, messages: Any) -> Any:
    """Do a task and keep its record; raises KeyboardInterrupt when it was asked to stop."""
    # A budget that ends here would leave a file of threadpoolctl open.
    with uncut():
        one_thread = threadpool_limits(1)
    with one_thread, closing(Reporter(messages, task.name, task.title)) as report:
        parts = Parts(folder, task.name, task.key)
        with keeping(parts):
            record = task.work(*task.arguments, report)
        with uncut():
            record = as_read(task.kind, record)
            report.end(record)
            folder.save(task.name, task.key, record)
            parts.remove()
    return record


@dataclass(frozen=True)
class _Array:
    """An array of float64 with all its bits, in the order that it has in memory."""

    shape: tuple[int, ...]
    turned: bool
    content: str

    def __post_init__(self) -> None:
        """Raise ValueError where it is no number of them."""
        self.read()

    @classmethod
    def of(cls, array: np.ndarray) -> _Array:
        """Take an array."""
        turned = not array.flags.c_contiguous
        rows = array.T if turned else array
        content = base64.b64encode(rows.astype("<f8").tobytes()).decode("ascii")
        return cls(rows.shape, turned, content)

    def read(self) -> np.ndarray:
        """Give the array."""
        flat = np.frombuffer(base64.b64decode(self.content, validate=True), dtype="<f8")
        rows = flat.astype(float).reshape(self.shape)
        return rows.T if self.turned else rows


@dataclass(frozen=True)
class _Fits:
    """Fits by the digest of what each depends on; without arrays where there is none."""

    fits: dict[str, tuple[_Array, ...] | None]


class Parts(AbstractKeeper):
    """Keeps the parts of one task in a folder of its own until the task has its record.

    Each part is a record with a checksum. Its name is its place: the third part within the second
    is ``1.name/2.other``, whatever is read back and whatever is made.

    Parameters
    ----------
    folder : of the run.
    task, key : the task's name, and the digest of all that it depends on.
    """

    def __init__(self, folder: RunFolder, task: str, key: str) -> None:
        """Begin with the first part."""
        records = f"{PARTS}/{folder.file(task).stem}" if folder.path is not None else ""
        self._folder = RunFolder(folder.path, records)
        self._key = key
        self._places: list[int] = [0]
        self._names: list[str] = []
        self._new: dict[str, tuple[_Array, ...] | None] = {}
        self._saved, self._before = 0, time.monotonic()

    def take(
        self, name: str, kind: type[T], make: Callable[[], T], is_whole: Callable[[T], bool]
    ) -> T:
        """Give a part as it was kept, else make and keep it."""
        place, full = self._next(name)
        kept = self._folder.load(full, self._key, kind)
        if kept is not None:
            return kept
        self._names.append(place)
        self._places.append(0)
        try:
            made = make()
        finally:
            self._names.pop()
            self._places.pop()
        with uncut():
            # What a search goes on with is the same whether it was made or read.
            made = as_read(kind, made)
            if is_whole(made):
                self._folder.save(full, self._key, made)
        return made

    def begin(self, name: str, kind: type[T]) -> tuple[T | None, Callable[[Callable[[], T]], None]]:
        """Give the last state that was kept, and what keeps another."""
        _, full = self._next(name)
        before = time.monotonic()

        def keep(make: Callable[[], T]) -> None:
            nonlocal before
            if time.monotonic() - before >= _SECONDS_BETWEEN_STATES:
                with uncut():
                    self._folder.save(full, self._key, make())
                before = time.monotonic()

        return self._folder.load(full, self._key, kind), keep

    @cached_property
    def _kept(self) -> dict[str, tuple[_Array, ...] | None]:
        """The fits of earlier runs, which came in files of many."""
        kept: dict[str, tuple[_Array, ...] | None] = {}
        while self._folder.file(self._batch).exists():
            batch = self._folder.load(self._batch, self._key, _Fits)
            kept |= {} if batch is None else batch.fits
            self._saved += 1
        return kept

    @property
    def _batch(self) -> str:
        return f"fits-{self._saved}"

    def recall(
        self, name: str, make: Callable[[], Sequence[np.ndarray] | None], given: Sequence[Any]
    ) -> Sequence[np.ndarray] | None:
        """Give the arrays as they were kept, else make and keep them."""
        if self._folder.path is None:
            return make()
        key = fingerprint(name, given)
        if key in self._kept:
            fit = self._kept[key]
        else:
            made = make()
            with uncut():
                fit = None if made is None else tuple(map(_Array.of, made))
                self._new[key] = fit
                if time.monotonic() - self._before >= _SECONDS_BETWEEN_STATES:
                    self._folder.save(self._batch, self._key, _Fits(self._new))
                    self._saved, self._new, self._before = self._saved + 1, {}, time.monotonic()
        return None if fit is None else [array.read() for array in fit]

    def _next(self, name: str) -> tuple[str, str]:
        """Give the place of the part that is asked for now, and its name."""
        place = f"{self._places[-1]}.{name}"
        self._places[-1] += 1
        return place, "/".join([*self._names, place])

    def remove(self) -> None:
        """Remove what was kept."""
        self._folder.remove()


def _give_up(task: Task, folder: RunFolder) -> Any:
    reason = "its process died, perhaps for want of memory"
    if task.failed is None:
        raise DynsrError(f"{task.title}: {reason}; give fewer rows or a smaller search")
    record = task.failed(reason)
    folder.save(task.name, task.key, record)
    return record


def spread(
    work: Callable[..., Any], calls: Sequence[tuple[Any, ...]], jobs: int, apart: bool = False
) -> Generator[tuple[int, Any], None, None]:
    """Give (number of the call, result) as calls end, in any order.

    The joblib backend in force is used; ``apart`` never uses this process. When this process is
    interrupted or the iterator is closed, workers of its own are killed; when it is killed, they
    end by themselves. Raises BrokenProcessPool when a worker dies.
    """
    if not calls or (not apart and (jobs == 1 or len(calls) < 2)):
        yield from ((i, work(*call)) for i, call in enumerate(calls))
        return
    _end_workers_with(os.getpid())
    numbered = [delayed(_run)(i, work, call) for i, call in enumerate(calls)]
    results = None
    try:
        with _shielded():
            results = _make_pool(jobs, apart, len(calls))(numbered)
        # Not "yield from", which would close joblib's generator before its warnings are off.
        for result in results:  # noqa: UP028
            yield result
    finally:
        # One that is left open would end the workers of a later call when it is collected.
        if isinstance(results, Generator):
            # joblib warns that results are left, which is what an interrupt means.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                results.close()


@cache
def _end_workers_with(process: int) -> None:
    """Have a process of multiprocessing end its workers at its own end, which would wait for them.

    Any other process does so by itself.
    """
    if multiprocessing.parent_process() is not None:
        Finalize(None, _end_workers, exitpriority=100)


def _end_workers() -> None:
    executor = reusable_executor._executor  # noqa: SLF001
    if executor is not None:
        executor.shutdown(wait=True, kill_workers=True)


def _make_pool(jobs: int, apart: bool, count: int) -> Parallel:
    backend, _ = get_active_backend()
    # A worker without a task would take memory and the time to start.
    workers = min(effective_n_jobs(jobs), count)
    options: dict[str, Any] = {"n_jobs": workers, "batch_size": 1}
    if apart and workers == 1:
        # joblib has no pool of one; of two workers, one is given work at a time.
        options |= {"n_jobs": 2, "pre_dispatch": 1}
    local = type(backend) in (BACKENDS["loky"], BACKENDS["multiprocessing"])
    if local or backend.supports_return_generator:
        options["return_as"] = "generator_unordered"
    if not local:
        return Parallel(**options)
    # Processes of this machine are always loky's: forks beside threads can hang, and a pool of
    # multiprocessing waits forever for a worker that died. One thread each, so that sums are
    # formed in the same order for any number of workers.
    threads = getattr(backend, "inner_max_num_threads", None) or 1
    with parallel_config("loky", inner_max_num_threads=threads):
        # On Linux a child ends with the thread that started it, which may end before the process.
        lasting = threading.current_thread() is threading.main_thread()
        return Parallel(**options, initializer=_belong_to, initargs=(os.getpid(), lasting))


def _run(index: int, work: Callable[..., Any], call: tuple[Any, ...]) -> Any:
    return index, work(*call)


@contextmanager
def _shielded() -> Iterator[None]:
    """Hold Ctrl-C back while workers start: half a pool could not be closed.

    The workers inherit that it is not meant for them.
    """
    held: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    ours = threading.current_thread() is threading.main_thread() and handler is not None
    # The start of loky's tracker would lift the block.
    resource_tracker.ensure_running()
    masks = hasattr(signal, "pthread_sigmask")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else set()
    if ours:
        # Other threads take the signal too, and have this one handle it.
        signal.signal(signal.SIGINT, lambda number, frame: held.append(number))
    try:
        yield
    finally:
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if ours:
            signal.signal(signal.SIGINT, handler)
        if held:
            signal.raise_signal(signal.SIGINT)


def _belong_to(parent: int, lasting: bool) -> None:
    """Leave Ctrl-C to the parent of this worker, and end the worker once that is gone.

    ``lasting`` says that the thread which started it lasts as long as the parent.

    A search would answer an interrupt with what it has found so far, which is no result here.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Before the task and its libraries load.
    let_garbage_wait()
    if lasting and sys.platform == "linux":
        # At once, even from within a long call that lets no other thread run.
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()


def _leave_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_SECONDS)
    os._exit(1)
