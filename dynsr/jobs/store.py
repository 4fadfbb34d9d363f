"""Store: files written whole or not at all, JSON of plain values, and folders of records.

One rule for numbers that are not finite: JSON has none, so they are null, and where a number is due
null reads back as infinity; what is None is left out of a record. Every finite float64 reads back
with all its bits.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from dynsr import __version__
from dynsr.data import is_part, remove_stale, write_text
from dynsr.errors import DynsrError, DynsrWarning, InputError, quoted

T = TypeVar("T")

MANIFEST = "manifest.json"
# The page of what a folder holds.
REPORT = "report.html"
# Where the parts of tasks are that have not ended.
PARTS = "parts"
_MOST_BYTES = 1 << 30
_LONGEST_NAME = 100
# Records nest some ten levels; Python follows about a thousand.
_DEEPEST = 64


class RecordError(DynsrError, ValueError):
    """A file is not the whole, undamaged record that it should be."""


class RecordWarning(DynsrWarning):
    """A record could not be used; its task is done again."""


class FolderTaken(InputError):
    """The folder has the results of another run, or what dynsr did not write."""


def read_json(path: Path) -> Any:
    """Read a file of strict JSON; raises RecordError when it is not one, or no regular file."""
    try:
        # A pipe or a device may never end.
        if path.exists() and not path.is_file():
            raise RecordError(f"{str(path)!r} is no regular file")
        if path.stat().st_size > _MOST_BYTES:
            raise RecordError(f"{str(path)!r} is larger than any record")
        found = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
        if _is_deep(found):
            raise RecordError(f"{str(path)!r} is nested deeper than {_DEEPEST} levels")
        # Half of a pair of UTF-16 could not be written again.
        json.dumps(found, ensure_ascii=False).encode("utf-8")
        return found
    except OSError as error:
        raise RecordError(f"cannot read {str(path)!r}: {error.strerror}") from None
    except RecordError:
        raise
    except (ValueError, RecursionError, MemoryError):
        raise RecordError(f"{str(path)!r} is no whole JSON file") from None


def _is_deep(value: Any) -> bool:
    """Whether lists and mappings are nested so deeply that what reads them could not follow."""
    level = [value] if isinstance(value, (dict, list)) else []
    for _ in range(_DEEPEST):
        inner = [v.values() if isinstance(v, dict) else v for v in level]
        level = [v for items in inner for v in items if isinstance(v, (dict, list))]
        if not level:
            return False
    return True


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not of JSON")


def whole_text(text: str) -> str:
    """Give a text that a file can contain: bytes of a name that are no text become numbers."""
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


def to_json(value: Any) -> str:
    """Give a value as the text of strict JSON."""
    return _dumps(to_plain(value))


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON in one move; folders that are not there are made.

    A link of that name goes: what it leads to may be anybody's.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, to_json(value), links=False)


def _dumps(plain: Any) -> str:
    return json.dumps(plain, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def to_plain(value: Any, whole: bool = True) -> Any:
    """Bring a value to what strict JSON holds.

    Dataclasses become mappings of their fields, arrays and sets lists, formulas and paths text;
    a number that is not finite becomes None, and anything else its name or that of its class.
    Unless ``whole``, fields that are None are left out, so that they read back as None.

    >>> to_plain({"x": (1, float("inf"))})
    {'x': [1, None]}
    """
    return _bring(value, whole)


def _bring(value: Any, whole: bool) -> Any:
    """Bring a value to what JSON holds; unless ``whole``, fields that are None are left out."""
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (str, os.PathLike)):
        return whole_text(os.fsdecode(value))
    if isinstance(value, Mapping):
        return {whole_text(str(key)): _bring(item, whole) for key, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        items = {f.name: getattr(value, f.name) for f in fields(value)}
        return {k: _bring(v, whole) for k, v in items.items() if whole or v is not None}
    if isinstance(value, (set, frozenset)):
        return sorted((_bring(item, whole) for item in value), key=str)
    if hasattr(value, "tolist"):  # an array or a number of numpy's
        return _bring(value.tolist(), whole)
    if hasattr(value, "free_symbols"):
        from dynsr.expression import to_text

        return to_text(value)
    if isinstance(value, Iterable):
        return [_bring(item, whole) for item in value]
    return str(getattr(value, "__name__", type(value).__name__))


def from_plain(kind: Any, value: Any) -> Any:
    """Read back a value of that type from what :func:`to_plain` made of it.

    ``kind`` is a dataclass, a type of plain values, ``sympy.Expr``, or tuples, mappings and
    optional ones of these. An optional field that is left out is None; one that is null is a
    number that was not finite. Text is never run. Raises ValueError (InputError for a formula) or
    TypeError when the value is of another type.

    >>> from_plain(tuple[float, ...], [1, None])
    (1.0, inf)
    """
    origin, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin in (Union, UnionType):
        (chosen,) = (k for k in inner if k is not NoneType)
        return None if value is None and chosen is not float else from_plain(chosen, value)
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            raise TypeError(f"{quoted(value)} is no list")
        kinds = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        return tuple(from_plain(k, v) for k, v in zip(kinds, value, strict=True))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise TypeError(f"{quoted(value)} is no mapping")
        return {str(k): from_plain(inner[1], v) for k, v in value.items()}
    if is_dataclass(kind):
        return _read_dataclass(kind, value)
    if kind is float:
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise TypeError(f"{quoted(value)} is no number")
        return math.inf if value is None else float(value)
    if hasattr(kind, "free_symbols"):
        from dynsr.expression import parse

        return parse(str(value))
    if not isinstance(value, kind):
        raise TypeError(f"{quoted(value)} is no {kind.__name__}")
    return value


def _read_dataclass(kind: Any, value: Any) -> Any:
    hints = _hints(kind)
    left_out = {n: None for n, hint in hints.items() if NoneType in get_args(hint)}
    # Records of the release before have the names of then.
    before = getattr(kind, "names_before", {})
    if isinstance(value, dict):
        value = {before.get(name, name): own for name, own in value.items()}
    if not isinstance(value, dict) or {**left_out, **value}.keys() != hints.keys():
        raise ValueError(f"it does not have the fields of a {kind.__name__}")
    return kind(**{**left_out, **{n: from_plain(hints[n], v) for n, v in value.items()}})


@cache
def _hints(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {f.name: hints[f.name] for f in fields(kind)}


def fingerprint(*values: Any) -> str:
    """Digest of arrays, texts, numbers and (nested) sequences or mappings of them.

    >>> fingerprint([1.5, {"a": "b"}]) == fingerprint([1.5, {"a": "b"}])
    True
    """
    digest = hashlib.sha256()
    _feed(digest, values)
    return digest.hexdigest()[:16]


def _feed(digest: Any, value: Any) -> None:
    if hasattr(value, "tobytes"):
        digest.update(f"array {value.shape} {value.dtype}".encode())
        digest.update(value.tobytes())
    elif isinstance(value, Mapping):
        _feed(digest, sorted(value.items()))
    elif isinstance(value, (list, tuple)):
        digest.update(f"{len(value)} items".encode())
        for item in value:
            _feed(digest, item)
    else:
        digest.update(f"{type(value).__name__} {value}".encode())


def write_record(path: Path, record: Any, key: str = "") -> None:
    """Write a dataclass as a record: its fields, the key, the version of dynsr, a checksum."""
    body = {**_bring(record, False), "key": key, "version": __version__}
    write_json(path, {**body, "checksum": checksum(body)})


def as_read(kind: type[T], record: T) -> T:
    """Give a record as it will be when it is read back, so that a rerun has the very same one.

    SymPy's text reads back as an equal formula, yet not always in the same form: 1/4*y/(x - 1/2) is
    written as y/(4*(x - 1/2)) and read as y/(4*x - 2).
    """
    try:
        found: T = from_plain(kind, json.loads(json.dumps(_bring(record, False))))
    except (ValueError, TypeError, AttributeError, ArithmeticError):
        return record  # what cannot be read is made again by a rerun, and is the same
    return found


def read_record(path: Path, kind: type[T]) -> tuple[T, str]:
    """Read back a record of that type, and its key.

    Raises RecordError that says what is wrong with the file.
    """
    body = read_json(path)
    if not isinstance(body, dict) or not {"key", "version", "checksum"} <= body.keys():
        raise RecordError(f"{path} does not have the fields of a record")
    if body.pop("checksum") != checksum(body):
        raise RecordError(f"{path} was changed or damaged: its checksum differs")
    key = body.pop("key")
    del body["version"]
    try:
        found: T = from_plain(kind, body)
    except (ValueError, TypeError, AttributeError, ArithmeticError) as error:
        raise RecordError(f"{path} cannot be read: {error}") from None
    return found, key


def checksum(body: Mapping[str, Any]) -> str:
    """Digest of a mapping as JSON, in any order of its keys."""
    return hashlib.sha256(json.dumps(to_plain(body), sort_keys=True).encode()).hexdigest()


def read_manifest(folder: Path, work: str) -> dict[str, Any]:
    """Give the settings of the run whose results a folder holds.

    ``work`` is what kind of run it must be, such as "replication". Raises RecordError.
    """
    path = folder / MANIFEST
    try:
        found = read_json(path)
        settings = found["settings"]
        if found["format"] == _format(work) and isinstance(settings, dict):
            return {**settings}
    except (RecordError, TypeError, KeyError):
        pass
    raise RecordError(f"{path} is damaged or no manifest of a dynsr {work}")


def _format(work: str) -> str:
    return f"dynsr {work} 1"


@dataclass(frozen=True)
class RunFolder:
    """A folder that keeps the results of one run, one file a task; ``None`` keeps nothing.

    It holds ``manifest.json``, the settings that all its tasks share, and the folder ``records``
    of that name. A record is there as a whole or not at all.
    """

    path: Path | None
    records: str = "records"

    def claim(
        self, work: str, settings: Mapping[str, Any], key: str = "", alone: Iterable[str] = ()
    ) -> None:
        """Make the folder that of one run, or go on with the run that it is of.

        ``work`` names the kind of run; ``settings`` are what distinguishes runs for a reader, and
        ``key`` digests all that its results depend on. ``alone`` are the empty folders that
        one without a manifest may hold; none by default. Raises FolderTaken, which names the first
        difference, when it is another run's, and InputError when it cannot be used.
        """
        if self.path is None:
            return
        folder = self.path
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder} is a file; give a folder for the results")
        try:
            content = sorted(folder.iterdir()) if folder.exists() else []
            if MANIFEST in [path.name for path in content]:
                self._check(work, settings, key)
            elif foreign := [p.name for p in content if not _may_be_there(p, tuple(alone))]:
                raise FolderTaken(
                    f"{folder} holds {foreign[0]!r} and no results of dynsr; "
                    "give a new or an empty folder"
                )
            for name in (self.records, PARTS):
                if (folder / name).is_symlink():
                    raise FolderTaken(
                        f"{folder} contains a link {name!r} to another folder; "
                        "give a new or an empty folder"
                    )
            # Written anew each time, so that a folder that cannot be written is known at once; and
            # first, since by it the folder is known again.
            manifest = {"format": _format(work), "key": key, "settings": settings}
            write_json(folder / MANIFEST, manifest)
            (folder / self.records).mkdir(exist_ok=True)
            parts = [p for p in (folder / PARTS).glob("*") if p.is_dir() and not p.is_symlink()]
            for place in (folder, folder / self.records, *parts):
                remove_stale(place)
        except OSError as error:
            reason = error.strerror or type(error).__name__
            raise InputError(
                f"cannot write results into {folder}: {reason}; give another folder"
            ) from None

    def _check(self, work: str, settings: Mapping[str, Any], key: str) -> None:
        assert self.path is not None
        try:
            old = read_manifest(self.path, work)
        except RecordError as error:
            raise FolderTaken(f"{error}; give a new or an empty folder") from None
        new = to_plain(settings)
        for name in dict.fromkeys([*new, *old]):
            there, here = old.get(name), new.get(name)
            if there == here:
                continue
            if there is None or here is None:
                which = f"with {name} {_words(there)}" if here is None else f"without {name}"
                asked = "none" if here is None else f"{name} {_words(here)}"
                raise FolderTaken(
                    f"{self.path} holds results {which}, and {asked} is asked for; give another "
                    "folder, or ask the same to continue them"
                )
            raise FolderTaken(
                f"{self.path} holds results with {name} {_words(there)}, not {_words(here)}; "
                f"give another folder, or {name} {_words(there)} to continue them"
            )
        if read_json(self.path / MANIFEST).get("key") != key:
            raise FolderTaken(f"{self.path} holds results with other options; give another folder")

    def file(self, name: str) -> Path:
        """Give the path of the record of a task."""
        assert self.path is not None
        plain = re.sub(r"[^a-z0-9._-]", "_", name)[:_LONGEST_NAME]
        # Of other letters a file system may make the same, or none; and names may be too long.
        digest = "" if plain == name else f"-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
        return self.path / self.records / f"{plain}{digest}.json"

    def load(
        self,
        name: str,
        key: str,
        kind: type[T],
        finished: Callable[[T], bool] = lambda record: True,
    ) -> T | None:
        """Give the record of a task; None when there is none, or none that is ``finished``.

        Warns of one that is damaged or has another key, which counts for none.
        """
        if self.path is None or not self.file(name).exists():
            return None
        try:
            record, found = read_record(self.file(name), kind)
            if not finished(record):
                return None
            if found != key:
                raise RecordError(
                    f"{self.file(name)} was made from other data or with other settings"
                )
            return record
        except RecordError as error:
            warnings.warn(f"{error}; computing it again", RecordWarning, stacklevel=4)
            return None

    def save(self, name: str, key: str, record: Any) -> None:
        """Keep the record of a task."""
        if self.path is not None:
            write_record(self.file(name), record, key)

    def remove(self) -> None:
        """Remove the records of this folder, and folders that are empty then."""
        if self.path is None:
            return
        here = self.path / self.records
        for path in here.glob("*"):
            if path.suffix == ".json" or is_part(path):
                path.unlink(missing_ok=True)
        with suppress(OSError):
            here.rmdir()
            here.parent.rmdir()


def _may_be_there(path: Path, alone: tuple[str, ...]) -> bool:
    # A call may end between any two files.
    empty = path.is_dir() and not path.is_symlink() and not any(path.iterdir())
    return is_part(path) or (path.name in alone and empty)


def _words(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
