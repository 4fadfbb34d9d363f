"""Conditions: how badly a system of the zoo is measured, drawn once from a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from dynsr.benchmarks.zoo.system import ZooSystem
from dynsr.data import Trajectory
from dynsr.engines import simulate
from dynsr.errors import InputError

LEVELS = (0.0, 0.01, 0.05, 0.1)
ROWS = (50, 100, 150, 300, 1000)
CLEAN, ADDITIVE, MULTIPLICATIVE = "clean", "additive", "multiplicative"
_RELTOL, _ABSTOL = 1e-10, 1e-12


@dataclass(frozen=True)
class Condition:
    """One way to measure a trajectory.

    Parameters
    ----------
    noise : standard deviation of the noise as a share, 0.05 for 5 %.
    kind : "clean"; "additive", a share of each state's standard deviation; or "multiplicative", a
        share of each value.
    rows : rows that are given to a search.
    dropped : whether these are half of twice as many evenly spaced ones, the others lost at random;
        else they are evenly spaced themselves, both ends of the span included.
    """

    noise: float
    kind: str
    rows: int
    dropped: bool

    @property
    def name(self) -> str:
        """Noise and kind in one word."""
        return f"{self.kind}-{self.noise:g}" if self.noise else CLEAN


def draw_conditions(
    name: str,
    levels: Sequence[float] = LEVELS,
    seed: int = 0,
    rows: Sequence[int] = ROWS,
    drop: bool = True,
) -> list[Condition]:
    """Draw the conditions of a system: each level with both kinds of noise, clean data once.

    Parameters
    ----------
    name : the system; what is drawn for it does not depend on what else is run.
    levels : shares of noise.
    seed : all chance comes from it.
    rows : numbers of rows, of which one is drawn for each condition.
    drop : whether half of the conditions, drawn too, have lost half of their rows.

    Raises InputError for a level that is no share from 0 up and for fewer than two rows.

    >>> [condition.name for condition in draw_conditions("logistic", [0.0, 0.05])]
    ['clean', 'additive-0.05', 'multiplicative-0.05']
    """
    for level in levels:
        if not (np.isfinite(level) and level >= 0):
            raise InputError(f"noise {level} must be a number from 0 up, such as 0.01 for 1 %")
    if min(rows) < 8:
        raise InputError(f"{min(rows)} rows are too few; give at least 8")
    kinds = [(v, k) for v in levels for k in ((ADDITIVE, MULTIPLICATIVE) if v else (CLEAN,))]
    drawn = []
    for level, kind in kinds:
        rng = np.random.default_rng([seed, crc32(f"{name} {kind} {level:g}".encode())])
        count, lost = int(rng.choice(rows)), bool(rng.random() < 0.5)
        drawn.append(Condition(level, kind, count, drop and lost))
    return drawn


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a search is given of a system, and what its answer is compared with.

    Parameters
    ----------
    data : the rows that were measured.
    truth : the states without noise at the same times.
    unseen : the states from the second start at the same times; None where there is none.
    """

    data: Trajectory
    truth: Trajectory
    unseen: Trajectory | None


def measure(animal: ZooSystem, condition: Condition, seed: int = 0) -> Measurement:
    """Integrate a system from both starts and measure the first under a condition.

    Parameters
    ----------
    animal, condition : the system and how it is measured.
    seed : what the noise and the lost rows are drawn from, with the names of both.

    Raises EngineError when a true solution diverges.

    >>> from dynsr.benchmarks.zoo.catalogue import find_animals
    >>> condition = Condition(0.05, "additive", 50, True)
    >>> len(measure(find_animals(["logistic"])[0], condition).data)
    50
    """
    rng = np.random.default_rng([seed, crc32(f"{animal.name} {condition.name} data".encode())])
    count = 2 * condition.rows if condition.dropped else condition.rows
    times = np.linspace(0.0, animal.span, count)
    runs = [simulate(animal.system, s, times, _RELTOL, _ABSTOL) for s in animal.starts]
    x = runs[0].x
    size = np.abs(x) if condition.kind == MULTIPLICATIVE else np.std(x, axis=0)
    noisy = x + condition.noise * size * rng.standard_normal(x.shape)
    kept = np.sort(rng.choice(count, condition.rows, replace=False))
    data = Trajectory(times[kept], noisy[kept], runs[0].states)
    truth = [Trajectory(run.t[kept], run.x[kept], run.states) for run in runs]
    return Measurement(data, truth[0], truth[1] if len(truth) > 1 else None)
