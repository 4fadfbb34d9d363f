"""The replication: every (system x method x run) cell of the paper's experiment, in parallel.

A cell is one run of one method on one system, from its seed to its record.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, is_dataclass, replace
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
from joblib import effective_n_jobs

from dynsr import __version__
from dynsr.arguments import checked
from dynsr.data import (
    SYSTEMS,
    Samples,
    System,
    check_replaceable,
    find_system,
    is_own_page,
    make_samples,
)
from dynsr.engines import find_engine, share_engine, training_trajectory
from dynsr.errors import InputError, one_line
from dynsr.expression import to_text
from dynsr.jobs import (
    REPORT,
    RunFolder,
    Step,
    Task,
    Watch,
    check_jobs,
    check_seed,
    fingerprint,
    run_tasks,
    to_plain,
)
from dynsr.methods import PAPER_METHODS, AbstractMethod, Progress, Report, silent
from dynsr.paper.page import write_results
from dynsr.paper.protocol import (
    PAPER_NAMES,
    check_replays,
    is_of_paper,
    paper_method,
    score_as_printed,
    sindy_samples,
)
from dynsr.paper.provenance import EMBEDDED, sample_difference
from dynsr.paper.records import Record, describe_settings
from dynsr.paper.results import all_tables, prepare
from dynsr.paper.stages import describe_stages
from dynsr.report import Table

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
    prints for the cart-pole contains the force, and its polynomial has the terms of four variables.
    """
    system = cell.system
    if cell.method == "sindy" and is_of_paper(system):
        return sindy_samples(system, engine, recorded_steps)
    samples = make_samples(training_trajectory(system, engine), system.target)
    if not is_of_paper(system):
        return samples
    count = len(system.states)
    return replace(samples, X=samples.X[:, :count], names=samples.names[:count])


def compute_cell(cell: Cell, plan: Plan, report: Report = silent) -> Record:
    """Search, score and describe one cell; whatever goes wrong becomes a failed record."""
    record = failed_record(cell, plan, "")
    try:
        find_engine(plan.engine)
        done = replace(record, status="done", **_search(cell, plan, report))
        return (
            done if plan.engine == EMBEDDED else replace(done, embedded=_beside(cell, plan, done))
        )
    # One cell that fails must not take the others with it; its record says what happened.
    except Exception as error:
        return replace(record, error=_one_line(error))


def failed_record(cell: Cell, plan: Plan, reason: str) -> Record:
    """Give the record of a cell that gave no formula, with all that is known of it."""
    versions, settings = {}, {}
    with suppress(Exception):
        versions = find_engine(plan.engine).versions()
        settings = describe_settings(cell_method(cell, plan))
    return Record(
        system=cell.system.name,
        method=cell.method,
        run=cell.run,
        target=cell.system.target,
        seed=cell.seed(plan.seed),
        status="failed",
        engine=plan.engine,
        versions=versions,
        preset=plan.preset,
        settings=settings,
        error=reason,
    )


def _search(cell: Cell, plan: Plan, report: Report) -> dict[str, Any]:
    method = cell_method(cell, plan)
    samples = cell_samples(cell, plan.engine, plan.recorded_steps)
    ran: dict[str, None] = {}

    def note(progress: Progress) -> None:
        ran.setdefault(progress.stage)
        report(progress)

    start = time.perf_counter()
    front = method.search(samples, cell.generator(plan.seed), note)
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


def _beside(cell: Cell, plan: Plan, done: Record) -> dict[str, Any]:
    """Give what the embedded engine makes of a cell that another one computed."""
    here = replace(plan, engine=EMBEDDED)
    samples = cell_samples(cell, EMBEDDED)
    expr, found = done.expr, {}
    if cell.method == "sindy":
        expr = cell_method(cell, here).search(samples, cell.generator(plan.seed)).best_fit.expr
        found["expression"] = to_text(expr)
    score = score_as_printed(cell.system, [expr], cell.method, engine=EMBEDDED)[0]
    return {
        **found,
        "samples": sample_difference(cell_samples(cell, plan.engine), samples),
        **score.losses,
        "versions": find_engine(EMBEDDED).versions(),
    }


def _one_line(error: Exception) -> str:
    return f"{type(error).__name__}: {one_line(error)}"[:500]


RUNS, QUICK_RUNS = 5, 2
# Rough seconds of a cell on one core, for the time left and for starting the long ones first.
_USUAL = {"dynaifeynman": 60.0}
_USUAL_CELL = 2.0
# What a folder may hold before it has a manifest.
_OURS = ("cells", "tables")


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
        """Table 1 compared with the paper's, then the tables of the appendix."""
        return all_tables(self.records, self.settings["recorded_steps"])

    def write(self) -> list[Path]:
        """Write tables, Figure 1 and report.html into the folder, from the records alone."""
        return write_results(self.folder, self.records, self.settings)


@checked
def replicate(
    systems: Sequence[str | System] = PAPER_NAMES,
    methods: Sequence[str] = PAPER_METHODS,
    runs: int | None = None,
    seed: int = 0,
    jobs: int | None = None,
    out: str | Path = "results",
    quick: bool = False,
    engine: str = "embedded",
    progress: Callable[[Step], None] | None = None,
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
    jobs : worker processes; one per core by default. The result does not depend on it.
    out : folder of the results; made when it is not there, continued when it is.
    quick : small search budgets, for a first look; every record says so.
    engine : "embedded" or "julia": what makes the samples, solves SINDy's regressions and
        integrates what was found. What the embedded one makes of a cell is computed too.
    progress : called with a :class:`Step` as cells end, and every half second while they run.
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
    plan = Plan(check_seed(seed), preset, engine, make, recorded_steps)
    jobs = check_jobs(jobs)
    # Cells run in processes of their own, however many at a time.
    share_engine(find_engine(engine), max(2, effective_n_jobs(jobs)))
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
    folder = RunFolder(Path(out).absolute(), "cells")
    folder.claim("replication", settings, alone=_OURS)
    check_replaceable(Path(out) / REPORT, is_own_page)
    # The cells run in processes of their own; this one would wait for them.
    ready = Thread(target=prepare, daemon=True)
    if report:
        ready.start()
    tasks = sorted((_make_task(cell, plan) for cell in cells), key=lambda task: -task.seconds)
    with Watch(progress, {t.name: t.seconds for t in tasks}, effective_n_jobs(jobs)) as watch:
        run_tasks(tasks, folder, jobs, watch, apart=True, finished=lambda record: record.done)
    records = tuple(watch.records[cell.name] for cell in cells)
    result = Replication(Path(out).absolute(), settings, records)
    if report:
        ready.join()
        result.write()
    return result


def _make_task(cell: Cell, plan: Plan) -> Task:
    method = cell_method(cell, plan)
    settings = repr(method) if is_dataclass(method) else method.name
    return Task(
        cell.name,
        f"{cell.system.name} by {cell.method}, run {cell.run}",
        compute_cell,
        (cell, plan),
        Record,
        fingerprint(to_plain(cell), cell.seed(plan.seed), plan.engine, plan.preset, settings),
        _USUAL.get(cell.method, _USUAL_CELL),
        partial(failed_record, cell, plan),
    )


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
