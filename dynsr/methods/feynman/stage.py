"""What a stage of the search is, and what all stages of one search share."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from dynsr.methods.base import Progress, Report, silent
from dynsr.pareto import Candidate, ParetoFront
from dynsr.samples import Samples


@dataclass
class Context:
    """What the stages of one search share.

    Parameters
    ----------
    rng : the generator that all chance comes from.
    deadline : ``time.monotonic()`` value after which no new part of the search is begun.
    report : where progress goes.
    front : best front so far of the caller's own problem (not of a reduced one).
    depth : how many reductions lie between the caller's problem and the present one.
    """

    rng: np.random.Generator
    deadline: float = math.inf
    report: Report = silent
    front: ParetoFront = field(default_factory=ParetoFront)
    depth: int = 0

    @property
    def seconds_left(self) -> float:
        """Seconds until the deadline; never negative."""
        return max(0.0, self.deadline - time.monotonic())

    def tell(self, stage: str, done: float, total: float | None) -> None:
        """Report how far a stage is, with the front so far."""
        name = stage if self.depth == 0 else f"{stage} (level {self.depth})"
        self.report(Progress(name, done, total, self.front))


class AbstractStage(ABC):
    """One way to find formulas for samples; subclasses are frozen dataclasses of settings."""

    name: str

    @abstractmethod
    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Give candidates f with y = f(X), scored on these samples."""
