"""Reference answers of sparse regression, as DataDrivenDiffEq.jl and DataDrivenSparse.jl gave them.

Two sets: "2021", the numerical core of DataDrivenDiffEq.jl 0.5.7 under Julia 1.5.3, and "current",
DataDrivenSparse.jl 0.1.2 under Julia 1.10.5, on the same three trajectories.
"""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from dynsr.catalogue import find_system
from dynsr.engines.base import SparseProblem
from dynsr.expression import compile_numpy
from dynsr.methods.library import Library
from dynsr.paper.bases import BASES
from dynsr.samples import Samples, make_samples
from dynsr.trajectory import Trajectory

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
    return Library.from_strings(BASES[system_name]).values(samples.columns), samples.y


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
