"""Suites in the public layout: a JSON list of systems, with right-hand sides as text."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dynsr.benchmarks.zoo.system import ZooSystem
from dynsr.errors import InputError

_SHAPE = "a list of entries with id, init and substituted"


def read_suite(path: str | Path, names: Sequence[str] = (), span: float = 10.0) -> list[ZooSystem]:
    """Read the systems of a suite; nothing in the file is ever run.

    Each entry has an ``id``, ``init``, a list of start states of which the second is kept from the
    search, and ``substituted``, the right-hand sides in ``x_0``, ``x_1``, ... with all constants
    put in, or a list of such lists, of which the first is taken. ``dim``, if given, must agree.

    Parameters
    ----------
    path : the file.
    names : ids that are read; all by default.
    span : seconds that every system is watched.

    Raises InputError, which names the entry, when the file is no such suite.
    """
    if not (math.isfinite(span) and span > 0):
        raise InputError(f"span {span} must be a positive number of seconds")
    try:
        entries = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {str(path)!r} ({error.strerror}); name a file") from None
    except (ValueError, RecursionError):
        raise InputError(f"{str(path)!r} is no whole JSON file; give {_SHAPE}") from None
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{str(path)!r} has no systems; give {_SHAPE}")
    named = {_name(entry, place): entry for place, entry in enumerate(entries)}
    if len(named) < len(entries):
        raise InputError(f"{str(path)!r} has an id twice; give each system its own")
    for name in names:
        if name not in named:
            raise InputError(f"unknown system {name!r}; they are: {', '.join(named)}")
    return [_read_entry(name, named[name], span) for name in names or named]


def _name(entry: Any, place: int) -> str:
    if not isinstance(entry, dict) or not isinstance(entry.get("id"), (int, str)):
        raise InputError(f"entry {place + 1} of the suite has no id; give {_SHAPE}")
    return str(entry["id"])[:80]


def _read_entry(name: str, entry: dict[str, Any], span: float) -> ZooSystem:
    texts = _innermost(entry.get("substituted"))
    if texts is None:
        raise InputError(f"system {name!r} of the suite has no right-hand sides in 'substituted'")
    starts = _read_starts(name, entry.get("init"), len(texts))
    if entry.get("dim", len(texts)) != len(texts):
        raise InputError(f"system {name!r} has dim {entry['dim']!r} but {len(texts)} equations")
    source = str(entry.get("source", ""))[:200]
    equations = {f"x_{i}": text for i, text in enumerate(texts)}
    animal = ZooSystem(name, "suite", source, equations, starts, span, "suite")
    try:
        assert animal.system.states
    except InputError as error:
        raise InputError(f"system {name!r} of the suite: {error}") from None
    return animal


def _innermost(value: Any) -> list[str] | None:
    """Give the first list of texts in lists of lists."""
    while isinstance(value, list) and value and isinstance(value[0], list):
        value = value[0]
    if isinstance(value, str):
        value = [value]
    whole = isinstance(value, list) and value and all(isinstance(v, str) for v in value)
    return value if whole else None


def _read_starts(name: str, value: Any, states: int) -> tuple[tuple[float, ...], ...]:
    rows = value if isinstance(value, list) else []
    if rows and not isinstance(rows[0], list):
        rows = [rows]
    try:
        starts = tuple(tuple(float(v) for v in row) for row in rows)
    except (TypeError, ValueError):
        starts = ()
    fit = all(len(s) == states and all(map(math.isfinite, s)) for s in starts)
    if not starts or not fit:
        raise InputError(
            f"the starts in 'init' of system {name!r} must be lists of {states} finite numbers"
        )
    return starts[:2]
