"""The replication: every (system x method x run) cell of the paper's experiment, in parallel.

A cell is one run of one method on one system, from its seed to its record.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from joblib import cpu_count
from joblib.externals.loky import ProcessPoolExecutor, as_completed
from joblib.externals.loky.process_executor import BrokenProcessPool
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from dynsr import __version__
from dynsr.data import SYSTEMS, Samples, System, find_system, make_samples
from dynsr.engines import find_engine, training_trajectory
from dynsr.errors import InputError
from dynsr.expression import to_text
from dynsr.methods import PAPER_METHODS, AbstractMethod
from dynsr.paper.page import write_results
from dynsr.paper.protocol import (
    PAPER_NAMES,
    check_replays,
    is_of_paper,
    paper_method,
    score_as_printed,
    sindy_samples,
)
from dynsr.paper.records import (
    Record,
    RecordError,
    RecordWarning,
    describe_settings,
    open_folder,
    plain_values,
    read_record,
    write_record,
)
from dynsr.paper.results import all_tables
from dynsr.paper.stages import describe_stages
from dynsr.report import Table

_WATCH_SECONDS = 1.0
MakeMethod = Callable[[str, System, bool], AbstractMethod]


@dataclass(frozen=True)
class Plan:
    """What every cell of a replication shares.

    ``make`` gives a method for its name, a system, and whether its search is to be short;
    ``recorded_steps`` is that of :func:`replicate`.
    """

    seed: int
    preset: str
    engine: str
    make: MakeMethod = paper_method
    recorded_steps: bool = False


@dataclass(frozen=True)
class Cell:
    """One run, counted from 1, of the method of that name on a system."""

    system: System
    method: str
    run: int

    @property
    def name(self) -> str:
        """Name of the cell and of its file."""
        return f"{self.system.name}.{self.method}.{self.run}"

    def seed(self, seed: int) -> tuple[int, ...]:
        """Give the numbers that seed this cell, whatever other cells there are.

        >>> from dynsr.data.system import PENDULUM
        >>> Cell(PENDULUM, "ga", 1).seed(7)[0]
        7
        """
        names = (self.system.name, self.method)
        return (seed, *(zlib.crc32(name.encode()) for name in names), self.run)

    def generator(self, seed: int) -> np.random.Generator:
        """Give the generator that all chance of this cell comes from."""
        entropy, *key = self.seed(seed)
        return np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=tuple(key)))


def cell_method(cell: Cell, plan: Plan) -> AbstractMethod:
    """Give the method of a cell with all its settings; its engine is the plan's."""
    quick = plan.preset == "quick"
    return plan.make(cell.method, cell.system, quick).with_engine(plan.engine)


def cell_samples(cell: Cell, engine: str, recorded_steps: bool = False) -> Samples:
    """Give the training samples of a cell.

    They are forward differences of the training trajectory (the paper's section 3 says backward,
    its printed numbers forward); SINDy's on the paper's systems are those that its rows were made
    from. On those systems the other methods see the states alone: no formula that the paper
    prints for the cart-pole holds the force, and its polynomial has the terms of four variables.
    """
    system = cell.system
    if cell.method == "sindy" and is_of_paper(system):
        return sindy_samples(system, engine, recorded_steps)
    samples = make_samples(training_trajectory(system, engine), system.target)
    if not is_of_paper(system):
        return samples
    count = len(system.states)
    return replace(samples, X=samples.X[:, :count], names=samples.names[:count])


def compute_cell(cell: Cell, plan: Plan) -> Record:
    """Search, score and describe one cell; whatever goes wrong becomes a failed record."""
    record = Record(
        system=cell.system.name,
        method=cell.method,
        run=cell.run,
        target=cell.system.target,
        seed=cell.seed(plan.seed),
        status="failed",
        engine=plan.engine,
        versions={},
        preset=plan.preset,
        settings={},
    )
    try:
        record = replace(record, versions=find_engine(plan.engine).versions())
        method = cell_method(cell, plan)
        record = replace(record, settings=describe_settings(method))
        return replace(record, status="done", **_search(cell, plan, method))
    # One cell that fails must not take the others with it; its record says what happened.
    except Exception as error:
        return replace(record, error=_one_line(error))


def failed_record(cell: Cell, plan: Plan, reason: str) -> Record:
    """Give the record of a cell whose process did not live to write one."""
    return Record(
        cell.system.name,
        cell.method,
        cell.run,
        cell.system.target,
        cell.seed(plan.seed),
        "failed",
        plan.engine,
        {},
        plan.preset,
        {},
        error=reason,
    )


def record_cell(cell: Cell, plan: Plan, path: Path) -> Record:
    """Compute a cell and write its record to ``path`` in one move."""
    record = compute_cell(cell, plan)
    write_record(record, path)
    return record


def start_worker(parent: int) -> None:
    """Prepare a worker process: Ctrl-C is its parent's, and it does not outlive it.

    A search would answer an interrupt with what it has found so far, which is no result here.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()


def _leave_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_SECONDS)
    os._exit(1)


def _search(cell: Cell, plan: Plan, method: AbstractMethod) -> dict[str, Any]:
    samples = cell_samples(cell, plan.engine, plan.recorded_steps)
    start = time.perf_counter()
    ran: dict[str, None] = {}
    front = method.search(
        samples, cell.generator(plan.seed), lambda progress: ran.setdefault(progress.stage)
    )
    seconds = time.perf_counter() - start
    if not len(front):
        raise ArithmeticError("no formula of the search has finite values on all samples")
    best = front.best_fit
    score = score_as_printed(cell.system, [best.expr], cell.method, engine=plan.engine)[0]
    return {
        "expression": to_text(best.expr),
        "fit_loss": best.loss,
        "complexity": best.complexity,
        "seconds": seconds,
        **score.losses,
        "front": tuple(
            {
                "expression": to_text(c.expr),
                "loss": c.loss,
                "complexity": c.complexity,
                "source": c.source,
            }
            for c in front
        ),
        "source": best.source,
        "stages": describe_stages(front, ran, method),
    }


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}"[:500]


RUNS, QUICK_RUNS = 5, 2
# Rough cost of a cell, for the time left and for starting the long ones first.
_COST = {"dynaifeynman": 30.0}
_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}


@dataclass(frozen=True)
class Replication:
    """What a replication gave: its folder, the settings its cells share, a record a cell."""

    folder: Path
    settings: dict[str, Any]
    records: tuple[Record, ...]

    @property
    def failed(self) -> tuple[Record, ...]:
        """The records of cells that gave no formula."""
        return tuple(record for record in self.records if not record.done)

    @property
    def tables(self) -> list[Table]:
        """Table 1 beside the paper's, then the tables of the appendix."""
        return all_tables(self.records)

    def write(self) -> list[Path]:
        """Write tables, Figure 1 and report.html into the folder, from the records alone."""
        return write_results(self.folder, self.records, self.settings)

    def as_dict(self) -> dict[str, Any]:
        """Give settings, records and Table 1 as JSON can hold them."""
        return {
            "settings": self.settings,
            "folder": str(self.folder),
            "table1": [plain_values(row) for row in self.tables[0].to_records()],
            "cells": [plain_values(asdict(record)) for record in self.records],
        }


def replicate(
    systems: Sequence[str | System] = PAPER_NAMES,
    methods: Sequence[str] = PAPER_METHODS,
    runs: int | None = None,
    seed: int = 0,
    jobs: int | None = None,
    out: str | Path = "results",
    quick: bool = False,
    engine: str = "embedded",
    progress: bool = False,
    report: bool = True,
    recorded_steps: bool = False,
    make: MakeMethod = paper_method,
) -> Replication:
    """Run the cells that have no record in ``out`` yet; give and write up the results of all.

    Parameters
    ----------
    systems, methods : their names; all of the paper's by default.
    runs : of each method on each system; 5 by default, 2 when quick.
    seed : all chance comes from it; a cell's own from it and the cell's names.
    jobs : worker processes; one a core by default. The result does not depend on it.
    out : folder of the results; made when it is not there, continued when it is.
    quick : small search budgets, for a first look; every record says so.
    engine : "embedded" or "julia".
    progress : show a bar with the time left on the terminal.
    report : write the tables, Figure 1 and report.html into ``out`` at the end.
    recorded_steps : make the samples of SINDy's rows with the steps that the release of 2021 took,
        :func:`dynsr.paper.protocol.recorded_ends`, instead of our own; on the embedded engine.
    make : gives a method for its name, a system, and whether its search is to be short.

    A cell that fails leaves a record that says why; the next call tries it again. Raises
    InputError when something asked for is unknown, or ``out`` cannot be used or holds results
    with another seed, engine, quick, recorded_steps or version of dynsr.
    """
    cells = _cells(systems, methods, _check_runs(runs, quick))
    preset = "quick" if quick else "paper"
    plan = Plan(_check_seed(seed), preset, engine, make, recorded_steps)
    workers = _check_jobs(jobs)
    find_engine(engine)
    if recorded_steps:
        check_replays(engine)
    for cell in {(c.system.name, c.method): c for c in cells}.values():
        cell_method(cell, plan)
    settings = {
        "seed": plan.seed,
        "engine": engine,
        "quick": quick,
        "recorded_steps": recorded_steps,
        "version": __version__,
    }
    folder = open_folder(out, settings)
    records = _complete(cells, plan, folder, workers, progress)
    result = Replication(folder, settings, tuple(records[cell.name] for cell in cells))
    if report:
        result.write()
    return result


def _complete(
    cells: Sequence[Cell], plan: Plan, folder: Path, workers: int, progress: bool
) -> dict[str, Record]:
    """Give the record of every cell by its name; those that are not there yet are computed."""
    records = {c.name: r for c in cells if (r := _usable_record(c, plan, folder)) is not None}
    todo = [cell for cell in cells if cell.name not in records]
    todo.sort(key=lambda cell: -_COST.get(cell.method, 1.0))
    with _bar(cells, todo, progress) as finished:
        for cell, record in _compute(todo, plan, folder, workers):
            records[cell.name] = record
            finished(cell, record)
    return records


def _cells(systems: Sequence[str | System], methods: Sequence[str], runs: int) -> list[Cell]:
    found = [s if isinstance(s, System) else find_system(s) for s in systems]
    if not found or not methods:
        raise InputError("there is nothing to replicate; name at least one system and one method")
    for system in found:
        # Records and tables go by name, and a name of the catalogue stands for its own system.
        if system != SYSTEMS.get(system.name, system):
            raise InputError(
                f"{system.name!r} is not the system of that name in dynsr.SYSTEMS; give it another "
                "name"
            )
    unique = dict.fromkeys(methods)
    by_name = {s.name: s for s in found}
    return [Cell(s, m, r + 1) for s in by_name.values() for m in unique for r in range(runs)]


def _check_runs(runs: int | None, quick: bool) -> int:
    if runs is None:
        return QUICK_RUNS if quick else RUNS
    if int(runs) != runs or runs < 1:
        raise InputError(f"runs {runs} must be a whole number from 1 up")
    return int(runs)


def _check_seed(seed: int) -> int:
    if int(seed) != seed or seed < 0:
        raise InputError(f"seed {seed} must be a whole number from 0 up")
    return int(seed)


def _check_jobs(jobs: int | None) -> int:
    if jobs is None or jobs == -1:
        return cpu_count()
    if int(jobs) != jobs or jobs < 1:
        raise InputError(f"jobs {jobs} must be a whole number from 1 up, or -1 for one a core")
    return int(jobs)


def _path(cell: Cell, folder: Path) -> Path:
    return folder / "cells" / f"{cell.name}.json"


def _usable_record(cell: Cell, plan: Plan, folder: Path) -> Record | None:
    """Give the record of a cell if there is a good one; warn about one that is of no use."""
    path = _path(cell, folder)
    if not path.exists():
        return None
    try:
        record = read_record(path)
        _check_same(record, cell, plan, path)
    except RecordError as error:
        warnings.warn(f"{error}; computing it again", RecordWarning, stacklevel=5)
        return None
    return record if record.done else None


def _check_same(record: Record, cell: Cell, plan: Plan, path: Path) -> None:
    where = (record.system, record.method, record.run, record.seed, record.engine, record.preset)
    if where != (
        cell.system.name,
        cell.method,
        cell.run,
        cell.seed(plan.seed),
        plan.engine,
        plan.preset,
    ):
        raise RecordError(f"{path} belongs to another cell")
    if record.done and record.settings != describe_settings(cell_method(cell, plan)):
        raise RecordError(f"{path} was made with other settings of the method")


def _compute(
    cells: Sequence[Cell], plan: Plan, folder: Path, jobs: int
) -> Iterator[tuple[Cell, Record]]:
    """Compute cells and give each with its record as it is done, in any order."""
    given = set()
    try:
        for cell, record in _compute_in_pool(cells, plan, folder, min(jobs, len(cells) or 1)):
            given.add(cell.name)
            yield cell, record
    except BrokenProcessPool:
        # A worker died (killed, or out of memory) and took its fellows with it. One cell at
        # a time shows which one it is.
        for cell in (c for c in cells if c.name not in given):
            try:
                yield from _compute_in_pool([cell], plan, folder, 1)
            except BrokenProcessPool:
                record = failed_record(cell, plan, "its process died, perhaps for want of memory")
                write_record(record, _path(cell, folder))
                yield cell, record


def _compute_in_pool(
    cells: Sequence[Cell], plan: Plan, folder: Path, jobs: int
) -> Iterator[tuple[Cell, Record]]:
    if not cells:
        return
    pool = ProcessPoolExecutor(
        jobs, initializer=start_worker, initargs=(os.getpid(),), env=_ONE_THREAD
    )
    try:
        futures = {pool.submit(record_cell, c, plan, _path(c, folder)): c for c in cells}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BaseException:
        pool.shutdown(wait=True, kill_workers=True)
        raise
    pool.shutdown(wait=True)


@contextmanager
def _bar(
    cells: Iterable[Cell], todo: Sequence[Cell], show: bool
) -> Iterator[Callable[[Cell, Record], None]]:
    """Show a bar over the cost of all cells; gives what to call for each that is finished."""
    cost = {cell.name: _COST.get(cell.method, 1.0) for cell in cells}
    left = sum(cost[cell.name] for cell in todo)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[cells]} cells"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), disable=not show) as progress:
        done = len(cost) - len(todo)
        task = progress.add_task(
            "replicating", total=sum(cost.values()), cells=f"{done}/{len(cost)}"
        )
        progress.advance(task, sum(cost.values()) - left)

        def finished(cell: Cell, record: Record) -> None:
            nonlocal done
            done += 1
            progress.advance(task, cost[cell.name])
            progress.update(task, cells=f"{done}/{len(cost)}")
            if not record.done:
                progress.console.print(f"{cell.name} failed: {record.error}", style="red")

        yield finished
