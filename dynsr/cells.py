"""Cells: one run of one method on one system, from its seed to its record."""

from __future__ import annotations

import os
import signal
import threading
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.engines.select import find_engine
from dynsr.expression import to_text
from dynsr.methods.base import AbstractMethod
from dynsr.methods.select import make_method
from dynsr.paper.bases import STATE_STEPS
from dynsr.paper.recipes import sindy_samples
from dynsr.records import Record, describe_settings, write_record
from dynsr.samples import Samples, forward_difference
from dynsr.scoring import score_expressions
from dynsr.simulate import training_trajectory
from dynsr.system import System

_WATCH_SECONDS = 1.0
MakeMethod = Callable[[str, str, str | None], AbstractMethod]


@dataclass(frozen=True)
class Plan:
    """What every cell of a replication shares.

    ``make`` gives a method for its name, a preset and the name of a system.
    """

    seed: int
    preset: str
    engine: str
    make: MakeMethod = make_method


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

        >>> from dynsr.catalogue import PENDULUM
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
    method = plan.make(cell.method, plan.preset, cell.system.name)
    if is_dataclass(method) and any(f.name == "engine" and f.init for f in fields(method)):
        changed: AbstractMethod = replace(method, engine=plan.engine)
        return changed
    return method


def cell_samples(cell: Cell, engine: str) -> Samples:
    """Give the training samples of a cell.

    They are forward differences of the training trajectory (the paper's section 3 says backward,
    its printed numbers forward); SINDy's on the paper's systems are those that its rows were made
    from. On those systems the other methods see the states alone: no formula that the paper
    prints for the cart-pole holds the force, and its polynomial has the terms of four variables.
    """
    system = cell.system
    if cell.method == "sindy" and system.name in STATE_STEPS:
        return sindy_samples(system, engine)
    samples = forward_difference(training_trajectory(system, engine), system.target)
    if system.name not in STATE_STEPS:
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
    samples = cell_samples(cell, plan.engine)
    start = time.perf_counter()
    front = method.search(samples, cell.generator(plan.seed))
    seconds = time.perf_counter() - start
    if not len(front):
        raise ArithmeticError("no formula of the search has finite values on all samples")
    best = front.best_fit
    score = score_expressions(cell.system, [best.expr], cell.method, engine=plan.engine)[0]
    return {
        "expression": to_text(best.expr),
        "fit_loss": best.loss,
        "complexity": best.complexity,
        "seconds": seconds,
        "equation_rmse": score.equation_rmse,
        "printed_loss": score.printed_loss,
        "trajectory_loss": score.trajectory_loss,
        "front": tuple(
            {"expression": to_text(c.expr), "loss": c.loss, "complexity": c.complexity}
            for c in front
        ),
    }


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}"[:500]
