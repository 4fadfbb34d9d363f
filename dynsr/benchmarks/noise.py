"""Noise: recovery of known systems at levels of noise, in cells that are kept as they end.

A cell is one system at one level with one draw of the noise; all its states are searched in one
discovery. Its record is written once, whole or not at all, so that a run that was killed goes on
where it stood, and tables and pictures are made from records alone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import sympy

from dynsr import __version__
from dynsr.benchmarks.recovery import NOISE_LEVELS, Recovery, measure_recovery
from dynsr.checkpoint import Part, Record, RunFolder, fingerprint, run_parts
from dynsr.discovery import Step, discover
from dynsr.errors import DynsrError
from dynsr.expression import parse
from dynsr.methods.base import AbstractMethod
from dynsr.scoring import equation_rmse
from dynsr.system import System
from dynsr.tables import Formula, Table
from dynsr.trajectory import Trajectory

Method = str | AbstractMethod | Sequence[str | AbstractMethod]


@dataclass(frozen=True)
class NoiseRow:
    """One state of one cell: what was found, and how far it is from the truth.

    ``equation_rmse`` is taken along the true states of the test span (units of the state a
    second); ``seconds`` is the time of the cell, which all its states share.
    """

    recovery: Recovery
    equation_rmse: float

    def as_dict(self) -> dict[str, Any]:
        """Give plain values; infinity is None."""
        values = {**asdict(self.recovery), "equation_rmse": self.equation_rmse}
        return {k: None if v == math.inf else v for k, v in values.items()}

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> NoiseRow:
        """Read back what :meth:`as_dict` gave."""
        values: dict[str, Any] = {k: math.inf if v is None else v for k, v in record.items()}
        rmse = values.pop("equation_rmse")
        return cls(Recovery(**values), rmse)


def run_noise(
    systems: Sequence[System],
    levels: Sequence[float] = NOISE_LEVELS,
    seeds: Sequence[int] = (0, 1, 2, 3, 4),
    *,
    method: Method = "auto",
    preset: str = "best",
    out: str | Path | None = None,
    jobs: int = 1,
    finished: Callable[[Sequence[NoiseRow]], None] = lambda rows: None,
) -> list[NoiseRow]:
    """Discover every system at every level with every seed; gives one row a state.

    Data are the paper's training data of the system with Gaussian noise on its states; inputs are
    given and exact. Without noise one seed is enough, since the data are the same.

    Parameters
    ----------
    levels : standard deviation of the noise in units of each state's own.
    out : folder of the records; cells found there are not computed again.
    jobs : cells at a time; each is searched by one process.
    finished : called with the rows of each cell as it ends.
    """
    folder = RunFolder(None if out is None else Path(out).absolute())
    parts = [
        _make_part(Cell(system, level, seed, method, preset), folder)
        for system in systems
        for level in levels
        for seed in (seeds if level else seeds[:1])
    ]
    records = run_parts(parts, folder, jobs, lambda _, record: finished(_rows(record)))
    return [row for record in records for row in _rows(record)]


@dataclass(frozen=True)
class Cell:
    """One system at one level with one draw of the noise, and how it is searched."""

    system: System
    level: float
    seed: int
    method: Method = "auto"
    preset: str = "best"

    @property
    def name(self) -> str:
        """Name of the cell and of its record."""
        return f"{self.system.name}-{self.level:g}-{self.seed}"


def _make_part(cell: Cell, folder: RunFolder) -> Part:
    system = cell.system
    words = {s: str(e) for s, e in zip(system.states, system.rhs, strict=True)}
    key = fingerprint(
        *(words, system.train, system.step, list(system.x0)),
        *(repr(cell.method), cell.preset, __version__),
    )
    searches = None if folder.path is None else folder.path / "searches" / cell.name
    return Part(cell.name, key, run_cell, (cell, searches))


def run_cell(cell: Cell, searches: Path | None = None, tell: Any = None) -> Record:
    """Discover the system of a cell; gives the record of its states.

    An error of the search is kept in the record, and every state then counts as not found.
    Finished searches are kept in the folder ``searches`` if one is given; their time counts, also
    where they were taken from there. ``tell`` is not called: what ends is told cell by cell.
    """
    failure: list[str] = []
    clock = _Clock()

    def search(data: Trajectory, seed: int) -> Mapping[str, sympy.Expr]:
        try:
            found = discover(
                data,
                method=cell.method,
                preset=cell.preset,
                inputs=dict(cell.system.inputs),
                seed=seed,
                jobs=1,
                out=searches,
                progress=clock,
            )
        except DynsrError as error:
            failure.append(str(error))
            return {}
        if not found.complete:
            # A cell that was stopped must not pass for finished.
            raise KeyboardInterrupt
        return found.equations

    found = measure_recovery([cell.system], search, [cell.level], [cell.seed])
    timed = [replace(r, seconds=r.seconds + clock.saved) for r in found]
    rows = [NoiseRow(r, _rmse(cell.system, r)).as_dict() for r in timed]
    return {"rows": rows, "failure": failure[0] if failure else None}


class _Clock:
    """Adds up the seconds that searches took which were now taken from their records."""

    def __init__(self) -> None:
        self.saved, self.last = 0.0, time.monotonic()

    def __call__(self, step: Step) -> None:
        if not step.what:
            return
        now = time.monotonic()
        self.saved += max(0.0, step.record.get("seconds", 0.0) - (now - self.last))
        self.last = now


def _rmse(system: System, recovery: Recovery) -> float:
    if not recovery.found:
        return math.inf
    return equation_rmse(system, parse(recovery.found), recovery.state)


def _rows(record: Record) -> list[NoiseRow]:
    return [NoiseRow.from_dict(row) for row in record["rows"]]


def noise_table(rows: Iterable[NoiseRow]) -> Table:
    """Make the table of systems and levels: what was recovered, how exactly, how fast.

    Constants and equation RMSE are medians over states and draws, the former of the states whose
    structure is right; seconds are the median of the cells.
    """
    lines = []
    for (system, level), group in _groups(rows):
        exact = [row for row in group if row.recovery.same_form]
        cells = {row.recovery.seed: row.recovery.seconds for row in group}
        lines.append(
            (
                system,
                100 * level,
                len(cells),
                f"{len(exact)} of {len(group)}",
                len(exact) / len(group),
                _share_of_cells(group),
                median(r.recovery.constants_off for r in exact) if exact else None,
                median(r.equation_rmse for r in group),
                median(cells.values()),
            )
        )
    columns = ("system", "noise (%)", "draws", "states exact", "share", "whole systems exact")
    return Table(
        "noise",
        "Recovery under noise",
        (*columns, "constants off (median)", "equation RMSE (median)", "seconds (median)"),
        tuple(lines),
    )


def _share_of_cells(group: Sequence[NoiseRow]) -> str:
    whole = {row.recovery.seed: True for row in group}
    for row in group:
        whole[row.recovery.seed] &= row.recovery.same_form
    return f"{sum(whole.values())} of {len(whole)}"


def formula_table(rows: Iterable[NoiseRow]) -> Table:
    """Make the table of every formula that was found."""
    lines = [
        (
            r.recovery.system,
            100 * r.recovery.noise,
            r.recovery.seed,
            r.recovery.state,
            Formula(r.recovery.found),
            "yes" if r.recovery.same_form else "no",
            r.recovery.constants_off if r.recovery.same_form else None,
            r.equation_rmse,
        )
        for r in rows
    ]
    columns = ("system", "noise (%)", "seed", "state", "found", "exact form", "constants off")
    return Table("noise-formulas", "What was found", (*columns, "equation RMSE"), tuple(lines))


def recovery_rates(rows: Iterable[NoiseRow]) -> tuple[list[float], dict[str, list[float]]]:
    """Give the levels, and for every system the share of states with exact structure at each."""
    shares = {
        key: sum(r.recovery.same_form for r in group) / len(group) for key, group in _groups(rows)
    }
    levels = sorted({level for _, level in shares})
    systems = dict.fromkeys(system for system, _ in shares)
    return levels, {s: [shares.get((s, v), math.nan) for v in levels] for s in systems}


def _groups(rows: Iterable[NoiseRow]) -> Iterator[tuple[tuple[str, float], list[NoiseRow]]]:
    groups: dict[tuple[str, float], list[NoiseRow]] = {}
    for row in rows:
        groups.setdefault((row.recovery.system, row.recovery.noise), []).append(row)
    yield from groups.items()
