"""Parts: the work of a discovery that runs apart, each with a record as its result."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from dynsr.data import Samples, Trajectory
from dynsr.expression import parse
from dynsr.fit import ParetoFront
from dynsr.jobs import Record
from dynsr.methods import AbstractMethod, Progress, Report, silent
from dynsr.selection import (
    explains_all,
    pick_equation,
    read_candidates,
    trivial_candidates,
    write_candidates,
)


def search_one(
    method: AbstractMethod,
    samples: Samples,
    sequence: np.random.SeedSequence,
    report: Report = silent,
) -> Record:
    """Search one target with one method; gives a record of its front."""
    began = time.monotonic()
    trivial = trivial_candidates(samples)
    found = [c for c in trivial if explains_all(c, samples)]
    if not found:
        found = list(method.search(samples, np.random.default_rng(sequence), report))
    return {
        "target": samples.target,
        "method": method.name,
        "front": write_candidates([*trivial, *found]),
        "seconds": time.monotonic() - began,
    }


def pick_one(
    front: list[Record],
    samples: Samples,
    held_back: Sequence[Trajectory],
    known: str,
    report: Report = silent,
) -> Record:
    """Choose the equation of one target; gives a record of the choice."""
    began = time.monotonic()
    pool = read_candidates(front)
    report(Progress("choosing", 0, None, ParetoFront(pool)))
    pick = pick_equation(samples.target, pool, samples, held_back, parse(known))
    return {**pick.as_record(), "seconds": time.monotonic() - began}
