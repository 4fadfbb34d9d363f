"""Reference trajectories of the paper's systems, as OrdinaryDiffEqTsit5 1.1.0 gave them.

Run under Julia 1.10.5 with OrdinaryDiffEqCore 1.1.0, over the training span (0, 10).
"""

from __future__ import annotations

import gzip
from functools import cache
from importlib.resources import files
from typing import Literal

import numpy as np

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
