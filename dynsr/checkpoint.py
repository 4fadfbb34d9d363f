"""Checkpoint: finished parts of a discovery as atomic JSON records in a folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from dynsr.errors import InputError
from dynsr.writing import write_json

Record = dict[str, Any]


def fingerprint(*parts: Any) -> str:
    """Digest of arrays, texts, numbers and (nested) sequences or mappings of them.

    >>> fingerprint(np.arange(3), "x") == fingerprint(np.arange(3), "x")
    True
    """
    digest = hashlib.sha256()
    _feed(digest, parts)
    return digest.hexdigest()[:16]


def _feed(digest: Any, part: Any) -> None:
    if isinstance(part, np.ndarray):
        digest.update(f"array {part.shape} {part.dtype}".encode())
        digest.update(np.ascontiguousarray(part).tobytes())
    elif isinstance(part, Mapping):
        _feed(digest, sorted(part.items()))
    elif isinstance(part, (list, tuple)):
        digest.update(f"{len(part)} parts".encode())
        for item in part:
            _feed(digest, item)
    else:
        digest.update(f"{type(part).__name__} {part}".encode())


@dataclass(frozen=True)
class RunFolder:
    """A folder of records, one file a finished part; ``None`` keeps nothing.

    A record counts only when its ``key`` is that of the data and settings asked for, so a folder
    may be used again for other data.
    """

    path: Path | None

    def __post_init__(self) -> None:
        """Raise InputError when the path cannot be a folder."""
        if self.path is not None:
            object.__setattr__(self, "path", Path(self.path))
            try:
                (self.path / "parts").mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(
                    f"cannot keep results in {str(self.path)!r} ({error.strerror}); "
                    "name another folder"
                ) from None

    def _file(self, name: str, key: str) -> Path:
        assert self.path is not None
        return self.path / "parts" / f"{name}-{key}.json"

    def load(self, name: str, key: str) -> Record | None:
        """Give the record of that part, or None when it is not finished (or damaged)."""
        if self.path is None:
            return None
        try:
            record = json.loads(self._file(name, key).read_text("utf-8"))
        except (OSError, ValueError):
            return None
        return record if isinstance(record, dict) and record.get("key") == key else None

    def save(self, name: str, key: str, record: Record) -> Record:
        """Keep a finished part; gives the record with its key."""
        whole = {**record, "key": key}
        if self.path is not None:
            write_json(self._file(name, key), whole)
        return whole


@dataclass(frozen=True)
class Part:
    """One piece of work: ``work(*arguments)`` gives a record, kept under ``name`` and ``key``."""

    name: str
    key: str
    work: Callable[..., Record]
    arguments: tuple[Any, ...]

    def run(self, folder: RunFolder) -> Record:
        """Do the work, unless it is done, and keep it at once, in the process that did it."""
        done = folder.load(self.name, self.key)
        return done or folder.save(self.name, self.key, self.work(*self.arguments))


def run_parts(
    parts: Sequence[Part],
    folder: RunFolder,
    jobs: int,
    finished: Callable[[Part, Record], None] = lambda part, record: None,
) -> list[Record]:
    """Run parts side by side through joblib; the records come back in the order of the parts.

    The joblib backend in force is used, so ``joblib.parallel_config("dask")`` spreads the parts
    over a cluster. ``finished`` is called in this process as parts end.
    """
    known = [folder.load(part.name, part.key) for part in parts]
    waiting = [i for i, record in enumerate(known) if record is None]
    for part, record in zip(parts, known, strict=True):
        if record is not None:
            finished(part, record)
    for i, record in _spread([parts[i] for i in waiting], folder, jobs):
        known[waiting[i]] = record
        finished(parts[waiting[i]], record)
    return [record for record in known if record is not None]


def _spread(parts: Sequence[Part], folder: RunFolder, jobs: int) -> Iterator[tuple[int, Record]]:
    if jobs == 1 or len(parts) < 2:
        yield from ((i, part.run(folder)) for i, part in enumerate(parts))
        return
    calls = [delayed(_run_numbered)(i, part, folder) for i, part in enumerate(parts)]
    try:
        pool = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    except ValueError:
        # This backend only gives all results at once.
        pool = Parallel(n_jobs=jobs, batch_size=1)
    yield from pool(calls)


def _run_numbered(index: int, part: Part, folder: RunFolder) -> tuple[int, Record]:
    return index, part.run(folder)
