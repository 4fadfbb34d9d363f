"""Records: a discovery as a file, and what of such a file is believed when it is read back."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, get_args

import sympy

from dynsr.data import Trajectory, write_own
from dynsr.engines import DEFAULT_ENGINE
from dynsr.errors import InputError, one_line, quoted
from dynsr.expression import abridged, arguments_of, check_name, parse
from dynsr.fit import Candidate, ParetoFront
from dynsr.jobs import RecordError, checksum, fingerprint, from_plain, read_json, to_json

_FORMAT = "dynsr discovery "
FORMAT = f"{_FORMAT}1"
# The file of a discovery in its folder.
RECORD = "discovery.json"
# A formula of more bits, or one that is simpler than nothing, is none of ours.
_MOST_BITS = 1e9


def say_data(runs: Sequence[Trajectory]) -> str:
    """Give what identifies the data of a discovery: rows, names and a digest."""
    limits = [[s, own.below, own.above] for run in runs for s, own in run.limits.items()]
    digest = fingerprint([*([run.t, run.columns, run.names] for run in runs), *limits])
    return f"{sum(map(len, runs))} rows of {', '.join(runs[0].names)}, {digest}"


def write_discovery(path: Path, record: Mapping[str, Any]) -> Path:
    """Write the record of a discovery with its checksum, whole or not at all; gives the path.

    Raises InputError when it cannot be written, or a file that is no record is there.
    """
    write_own(path, to_json({**record, "checksum": checksum(record)}), is_own_record)
    return path


def is_own_record(content: bytes) -> bool:
    """Whether this is all of a file that :func:`write_discovery` wrote."""
    try:
        record = json.loads(content)
        known = record.pop("checksum")
        return str(record["format"]).startswith(_FORMAT) and bool(known == checksum(record))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return False


@dataclass(frozen=True)
class _Settings:
    """Those of the settings that other parts of dynsr read."""

    method: str = ""
    methods: tuple[str, ...] = ()
    preset: str = ""
    seed: int = 0
    engine: str = DEFAULT_ENGINE
    scheme: Mapping[str, str] | None = None
    known: Mapping[str, str] | None = None
    velocities: Mapping[str, str] | None = None
    ended_by_budget: tuple[str, ...] = ()
    version: str = ""


_FIELDS = {
    "equations": Mapping[str, str],
    "errors": Mapping[str, tuple[tuple[float, float], ...]],
    "front": Mapping[str, tuple[tuple[str, float, float, str], ...]],
    "explanation": Mapping[str, str],
    "inputs": Mapping[str, str],
    "settings": Mapping[str, Any],
    "seconds": float,
}


def read_discovery(
    path: Path,
    functions: Callable[[Mapping[str, Any]], Mapping[str, Callable[..., sympy.Expr]]],
    **further: Any,
) -> dict[str, Any]:
    """Read what :func:`write_discovery` wrote as the fields of a discovery; nothing is ever run.

    Parameters
    ----------
    path : the file.
    functions : gives those that equations may contain in addition to the usual ones, by further.
    further : field -> its type, for :func:`dynsr.jobs.from_plain`; these may be absent.

    Raises InputError, one line that says what is wrong, when it is no such file.
    """
    label = str(path)
    try:
        record = read_json(path)
    except RecordError as error:
        remedy = "save it again" if path.exists() else "check its name"
        raise InputError(f"{error}; {remedy}") from None
    if not isinstance(record, dict) or not str(record.get("format")).startswith(_FORMAT):
        raise InputError(f"{label!r} is no saved discovery; give one that save() wrote")
    if record["format"] != FORMAT:
        raise InputError(
            f"{label!r} is a {quoted(record['format'])}, not {FORMAT!r}; discover again"
        )
    missing = [name for name in _FIELDS if name not in record]
    if missing:
        raise InputError(f"{label!r} lacks parts of a discovery ({missing[0]!r}); save it again")
    known = record.pop("checksum", None)
    if known is not None and known != checksum(record):
        raise InputError(f"{label!r} was changed or damaged: its checksum differs; save it again")
    try:
        plain = {name: _take(kind, record[name], name) for name, kind in _FIELDS.items()}
        extra = {n: _take(k, record[n], n) for n, k in further.items() if n in record}
        complete = _take(bool, record.get("complete", True), "complete")
        found = _read(plain, complete, functions(extra))
    except InputError as error:
        raise InputError(f"in {label!r}: {error}") from None
    return {**found, **extra}


def _take(kind: Any, value: Any, name: str) -> Any:
    """Bring one field to its type; raises InputError that names it."""
    try:
        if value is None and NoneType not in get_args(kind):
            raise TypeError("nothing is there")
        return from_plain(kind, value)
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise InputError(
            f"{name!r} is damaged ({abridged(one_line(error))}); save it again"
        ) from None


def _read(
    plain: Mapping[str, Any], complete: bool, functions: Mapping[str, Callable[..., sympy.Expr]]
) -> dict[str, Any]:
    """Make the fields of a discovery from values of the right types."""
    for state in plain["equations"]:
        if check_name(state, "state") == "t":
            raise InputError("a state is named 't', which is the time; rename it")
    for name in plain["inputs"]:
        if check_name(name, "input") in {*plain["equations"], "t"}:
            raise InputError(f"input {name!r} is also a state or the time; rename it")
    equations = {s: parse(text, functions=functions) for s, text in plain["equations"].items()}
    if not equations:
        raise InputError("there is no equation; discover again")
    for name in arguments_of(equations):
        check_name(name, "input")
    for part in ("errors", "front"):
        _check_states(plain[part], equations, part)
    settings = plain["settings"]
    fields = {n: settings[n] for n in _Settings.__dataclass_fields__ if n in settings}
    used = _take(_Settings, {**_DEFAULTS, **fields}, "settings")
    return {
        "equations": equations,
        "errors": {state: plain["errors"].get(state, ()) for state in equations},
        "front": {
            state: ParetoFront(_candidate(*row) for row in plain["front"].get(state, ()))
            for state in equations
        },
        "explanation": plain["explanation"],
        "inputs": {name: parse(text, ["t"]) for name, text in plain["inputs"].items()},
        "settings": settings,
        "seconds": plain["seconds"],
        "complete": complete,
        "engine": used.engine,
    }


_DEFAULTS = {
    n: f.default for n, f in _Settings.__dataclass_fields__.items() if f.default is not None
}


def _check_states(part: Mapping[str, Any], equations: Mapping[str, sympy.Expr], name: str) -> None:
    if odd := part.keys() - equations.keys():
        raise InputError(f"{name!r} is of a state without an equation, {quoted(min(odd))}")


def _candidate(text: str, loss: float, bits: float, source: str) -> Candidate:
    if not (loss >= 0 and (0 <= bits <= _MOST_BITS or math.isinf(bits))):
        raise InputError(f"a formula has loss {loss:g} and {bits:g} bits; save it again")
    return Candidate(parse(text), loss, bits, source)
