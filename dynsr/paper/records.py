"""Records: what each cell of a replication gave, one JSON file a cell, written in one move.

A folder of results holds ``manifest.json``, which names the settings that every cell shares, and
``cells/``. A record is either there as a whole or not there: it is written beside its place and
moved in. It carries a checksum, so that one which was damaged later is known.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import sympy

from dynsr.errors import DynsrError, DynsrWarning, InputError
from dynsr.expression import parse, to_text
from dynsr.jobs import write_text

FORMAT = "dynsr replication 1"
MANIFEST = "manifest.json"
_NUMBERS = (
    "fit_loss",
    "complexity",
    "equation_rmse",
    "printed_loss",
    "trajectory_loss",
    "seconds",
)
# What a folder may hold before it has a manifest: a call may end between any two files.
_OURS = ("cells", "tables")
_STALE_SECONDS = 3600.0


class RecordError(DynsrError, ValueError):
    """A file is not the whole, undamaged record that it should be."""


class RecordWarning(DynsrWarning):
    """A record could not be used; its cell is computed again."""


@dataclass(frozen=True)
class Record:
    """One run of one method on one system.

    Parameters
    ----------
    system, method, run, target : the cell; runs count from 1.
    seed : the entropy and spawn key of the ``numpy.random.SeedSequence`` of this cell.
    status : "done" or "failed"; then ``error`` says why in one line.
    expression : right-hand side of the target's equation, text that :func:`dynsr.parse` reads.
    fit_loss : its RMSE on the training samples, state units per second.
    complexity : its description length in bits.
    equation_rmse : root mean square of f_hat - f along the true test states (the paper's formula).
    printed_loss : the trajectory loss behind the numbers that the paper prints; None for a system
        that is not the paper's.
    trajectory_loss : the trajectory loss over all states from the right start.
    seconds : wall time of the search.
    engine, versions : what integrated and regressed, with the version of every part.
    preset, settings : the method's own settings, all of them.
    front : every formula of the Pareto front: expression, loss, complexity, source.
    source : the stage of the search that the formula comes from.
    stages : every stage that ran, in order: its name, how many formulas of the front are its own,
        and the RMSE of its best formula, on the front or not (None where it gave none).
    """

    system: str
    method: str
    run: int
    target: str
    seed: tuple[int, ...]
    status: str
    engine: str
    versions: Mapping[str, str]
    preset: str
    settings: Mapping[str, Any]
    expression: str = ""
    fit_loss: float = math.inf
    complexity: float = math.inf
    equation_rmse: float = math.inf
    printed_loss: float | None = None
    trajectory_loss: float = math.inf
    seconds: float = math.nan
    error: str = ""
    front: tuple[Mapping[str, Any], ...] = field(default=())
    source: str = ""
    stages: tuple[Mapping[str, Any], ...] = field(default=())

    @property
    def done(self) -> bool:
        """Whether the cell gave a formula."""
        return self.status == "done"

    @property
    def expr(self) -> sympy.Expr:
        """The formula as a SymPy expression."""
        return parse(self.expression)


def write_record(record: Record, path: Path) -> None:
    """Write a record to ``path`` in one move, with its checksum."""
    body = plain_values(asdict(record))
    write_text(path, _dumps({**body, "checksum": _checksum(body)}))


def read_record(path: Path) -> Record:
    """Read a record back; raises RecordError that says what is wrong with the file."""
    try:
        body = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise RecordError(f"{path} is no whole record ({type(error).__name__})") from None
    if not isinstance(body, dict) or set(body) != {f.name for f in fields(Record)} | {"checksum"}:
        raise RecordError(f"{path} does not have the parts of a record")
    if body.pop("checksum") != _checksum(body):
        raise RecordError(f"{path} was changed or damaged: its checksum differs")
    body["seed"], body["front"] = tuple(body["seed"]), tuple(map(_numbers, body["front"]))
    body["stages"] = tuple(body["stages"])
    return Record(**_numbers(body))


def open_folder(out: str | Path, settings: Mapping[str, Any]) -> Path:
    """Make a folder of results, or continue one that has the same settings.

    Raises InputError when it cannot be written, holds other things, or has other settings.
    """
    folder = Path(out).absolute()
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; give a folder for the results")
    try:
        content = sorted(p.name for p in folder.iterdir()) if folder.exists() else []
        if MANIFEST in content:
            _check_manifest(folder / MANIFEST, settings)
        elif foreign := [n for n in content if not (n in _OURS or _is_part(n))]:
            raise InputError(
                f"{folder} holds {foreign[0]!r} and no results of dynsr; "
                "give a new or an empty folder"
            )
        (folder / "cells").mkdir(parents=True, exist_ok=True)
        # Written anew each time, so that a folder that cannot be written is known at once.
        write_text(folder / MANIFEST, _dumps({"format": FORMAT, "settings": dict(settings)}))
        _remove_stale(folder)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(
            f"cannot write results into {folder}: {reason}; give another folder"
        ) from None
    return folder


def describe_settings(method: Any) -> dict[str, Any]:
    """Give the settings of a method (its fields) as values that JSON holds.

    >>> from dynsr.methods import GeneticAlgorithm
    >>> describe_settings(GeneticAlgorithm(bits=20))["bits"]
    20
    """
    if not is_dataclass(method):
        return {"name": str(getattr(method, "name", type(method).__name__))}
    return plain_values({f.name: getattr(method, f.name) for f in fields(method)})


def _check_manifest(path: Path, settings: Mapping[str, Any]) -> None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        old = found["settings"]
        ours = found["format"] == FORMAT and isinstance(old, dict)
    except (UnicodeDecodeError, ValueError, TypeError, KeyError):
        ours = False
    if not ours:
        raise InputError(f"{path} is no manifest of dynsr; give a new or an empty folder")
    for key, value in plain_values(settings).items():
        if old.get(key) != value:
            raise InputError(
                f"{path.parent} holds results with {key} {old.get(key)}, not {value}; "
                f"give another folder, or {key} {old.get(key)} to continue them"
            )


def _is_part(name: str) -> bool:
    return name.startswith(".") and name.endswith(".part")


def _remove_stale(folder: Path) -> None:
    """Remove what a killed process left half written long ago."""
    for part in [*folder.glob(".*.part"), *folder.glob("cells/.*.part")]:
        if time.time() - part.stat().st_mtime > _STALE_SECONDS:
            part.unlink(missing_ok=True)


def _checksum(body: Mapping[str, Any]) -> str:
    return hashlib.sha256(_dumps(body).encode()).hexdigest()


def _dumps(body: Mapping[str, Any]) -> str:
    return json.dumps(body, indent=1, sort_keys=True, allow_nan=False) + "\n"


def plain_values(value: Any) -> Any:
    """Bring values to what strict JSON holds.

    Expressions become text, and so do the numbers that are not finite ("inf", "nan").
    """
    if isinstance(value, Mapping):
        return {str(k): plain_values(v) for k, v in value.items()}
    if isinstance(value, (set, frozenset)):
        return sorted(map(plain_values, value), key=str)
    if isinstance(value, (list, tuple)):
        return [plain_values(v) for v in value]
    if isinstance(value, sympy.Basic):
        return to_text(value)
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return plain_values({f.name: getattr(value, f.name) for f in fields(value)})
    if hasattr(value, "tolist"):
        return plain_values(value.tolist())
    return str(getattr(value, "__name__", type(value).__name__))


def _numbers(body: Mapping[str, Any]) -> dict[str, Any]:
    """Read back the numbers that were written as text."""
    keys = (*_NUMBERS, "loss")
    return {k: float(v) if k in keys and isinstance(v, str) else v for k, v in body.items()}
