"""Reference answers: sparse regressions and trajectories as the Julia packages gave them."""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Literal

import numpy as np

from dynsr.data import Samples, Trajectory, find_system, make_samples
from dynsr.engines import SparseProblem
from dynsr.expression import compile_numpy
from dynsr.methods import Library
from dynsr.paper.protocol import find_protocol

_SETTINGS = ("lambda", "threshold", "nu", "rho", "proximal")


@dataclass(frozen=True, eq=False)
class SparseRecord:
    """One regression and Julia's answer.

    ``iterations`` is None where the search came back empty; ``coefficients`` are in the order of
    :class:`dynsr.engines.base.SparseSolution`.
    """

    system: str
    problem: SparseProblem
    coefficients: np.ndarray
    iterations: int | None

    @property
    def title(self) -> str:
        """What was asked, in one line."""
        numbers = " ".join(f"{k}={v}" for k, v in self.problem.settings.items())
        kind = "implicit" if self.problem.implicit else "explicit"
        scale = " normalised" if self.problem.normalize else ""
        return f"{self.system} {kind} {self.problem.optimizer} {numbers}{scale}"


@cache
def reference_samples(system_name: str) -> Samples:
    """Samples on which the answers were made: 1000 forward differences of the last state.

    >>> len(reference_samples("pendulum"))
    1000
    """
    system = find_system(system_name)
    path = files("dynsr.paper") / "references" / f"{system_name}.csv.gz"
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    t = table[:, 0]
    inputs = compile_numpy(list(system.inputs.values()), ["t"])(t[None]).T
    trajectory = Trajectory(t, table[:, 1:], system.states, inputs, tuple(system.inputs))
    return make_samples(trajectory, system.target, "forward")


@cache
def reference_problem(system_name: str) -> tuple[np.ndarray, np.ndarray]:
    """theta (p, 1000) of the paper's basis, and dx (1000,)."""
    samples = reference_samples(system_name)
    library = Library.from_strings(find_protocol(find_system(system_name)).basis)
    return library.values(samples.columns), samples.y


def sparse_records(release: str) -> list[SparseRecord]:
    """Give the records of release "2021" or "current".

    >>> sparse_records("2021")[0].title
    'pendulum explicit SR3 lambda=0.01 nu=1.0 normalised'
    """
    path = files("dynsr.paper") / "references" / f"sindy_{release}.json"
    return [_read(row, release) for row in json.loads(path.read_text(encoding="utf-8"))]


def _read(row: dict[str, Any], release: str) -> SparseRecord:
    theta, dx = reference_problem(row["system"])
    old = release == "2021"
    problem = SparseProblem(
        theta,
        dx,
        row["optimizer"],
        {key: row[key] for key in _SETTINGS if key in row},
        row["normalize"] if old else False,
        row["maxiter" if old else "maxiters"],
        row["kind"] == "implicit",
        "2021" if old else None,
    )
    steps = row["iterations" if old else "iterations_reported"]
    return SparseRecord(row["system"], problem, np.array(row["coefficients"], dtype=float), steps)


Case = Literal["steps", "tight"]


@cache
def trajectory_record(system_name: str, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Give times (n,) and states (n, k).

    ``steps``: the end of every accepted step at the default tolerances; ``tight``: every 0.1 s
    at relative and absolute tolerances of 1e-10.

    >>> t, x = trajectory_record("pendulum", "tight")
    >>> t.shape, x.shape
    ((101,), (101, 2))
    """
    path = files("dynsr.paper") / "references" / f"{system_name}_tsit5_{case}.csv.gz"
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    return table[:, 0], table[:, 1:]
