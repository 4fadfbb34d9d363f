"""Checkpoint: finished parts of a discovery as atomic JSON records in a folder."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.errors import InputError
from dynsr.jobs.live import LiveFolder, Teller
from dynsr.jobs.pool import spread
from dynsr.jobs.store import write_json

Record = dict[str, Any]
_MARK = "run.json"


class FolderTaken(InputError):
    """The folder holds the results of another run."""


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


def _words(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


@dataclass(frozen=True)
class RunFolder:
    """A folder of records, one file a finished part; ``None`` keeps nothing.

    A record counts only when its ``key`` is that of the data and settings asked for.
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

    def claim(self, key: str, about: Mapping[str, Any]) -> None:
        """Mark the folder as that of one run; raises FolderTaken when it is another's.

        ``about`` is what a reader tells runs apart by; the first difference is named.
        """
        if self.path is None:
            return
        try:
            other = json.loads((self.path / _MARK).read_text("utf-8"))
        except (OSError, ValueError):
            other = None
        if not isinstance(other, dict) or "key" not in other:
            write_json(self.path / _MARK, {"key": key, **about})
        elif other["key"] != key:
            differing = [n for n, v in about.items() if fingerprint(other.get(n)) != fingerprint(v)]
            name = next(iter(differing), "options")
            values = f" ({_words(other.get(name))} there, {_words(about.get(name))} here)"
            raise FolderTaken(
                f"{str(self.path)!r} holds a discovery with other {name}"
                f"{values if differing else ''}; "
                "name another folder"
            )

    @contextmanager
    def live(self) -> Iterator[LiveFolder]:
        """Give a folder for what running parts say, which goes when the run ends."""
        if self.path is None:
            made = Path(tempfile.mkdtemp(prefix="dynsr-"))
        else:
            made = self.path / "live"
            # What a killed run left is of no use any more.
            shutil.rmtree(made, ignore_errors=True)
            made.mkdir(exist_ok=True)
        try:
            yield LiveFolder(made)
        finally:
            shutil.rmtree(made, ignore_errors=True)


@dataclass(frozen=True)
class Part:
    """One piece of work: ``work(*arguments, report)`` gives a record, kept under name and key.

    ``about`` says what it works on, for those who watch: its state and its method.
    """

    name: str
    key: str
    work: Callable[..., Record]
    arguments: tuple[Any, ...]
    about: Mapping[str, str] = field(default_factory=dict)

    def run(self, folder: RunFolder, live: LiveFolder) -> Record:
        """Do the work, unless it is done, and keep it at once, in the process that did it.

        Raises KeyboardInterrupt when it was asked to stop: what it has then is not finished.
        """
        done = folder.load(self.name, self.key)
        if done is not None:
            return done
        teller = Teller(live, self.name, self.about)
        record = self.work(*self.arguments, teller)
        teller.end(record)
        return folder.save(self.name, self.key, record)


def run_parts(
    parts: Sequence[Part],
    folder: RunFolder,
    jobs: int,
    finished: Callable[[Part, Record], None] = lambda part, record: None,
    live: LiveFolder = LiveFolder(),  # noqa: B008 (a frozen value)
) -> list[Record]:
    """Run parts side by side through joblib; the records come back in the order of the parts.

    The joblib backend in force is used, so ``joblib.parallel_config("dask")`` spreads the parts
    over a cluster. ``finished`` is called in this process as parts end; running ones tell of
    themselves in ``live``.
    """
    known = [folder.load(part.name, part.key) for part in parts]
    waiting = [i for i, record in enumerate(known) if record is None]
    for part, record in zip(parts, known, strict=True):
        if record is not None:
            finished(part, record)
    calls = [(parts[i], folder, live) for i in waiting]
    # Closed here and now, so that workers are gone before what they had is read.
    with closing(spread(Part.run, calls, jobs)) as results:
        for i, record in results:
            known[waiting[i]] = record
            finished(parts[waiting[i]], record)
    return [record for record in known if record is not None]
