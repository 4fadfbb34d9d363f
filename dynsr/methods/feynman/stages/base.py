"""What a stage of the search is, and what all stages of one search share."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from dynsr.data import Samples
from dynsr.fit import Candidate, ParetoFront
from dynsr.methods.base import Progress, Report, silent


class Surrogate(Protocol):
    """A smooth stand-in for the unknown function, such as the network trained on its samples.

    ``validation_error`` is its RMSE, in units of y, on rows it was not fitted to.
    """

    @property
    def validation_error(self) -> float:
        """RMSE on rows it was not fitted to."""

    def predict(self, X: np.ndarray) -> np.ndarray:
        """(n,) values at n rows."""

    def gradient(self, X: np.ndarray) -> np.ndarray:
        """(n, p) derivatives at n rows."""


@dataclass(frozen=True)
class NetworkSettings:
    """The network that serves as surrogate (Udrescu et al. 2020).

    Parameters
    ----------
    hidden : units of each hidden layer.
    batch : samples of one step of Adam.
    peak_rate : the largest learning rate.
    validation : share of the samples that training does not see.
    """

    hidden: tuple[int, ...] = (128, 128, 64, 64)
    batch: int = 256
    peak_rate: float = 5e-3
    validation: float = 0.2


@dataclass
class Context:
    """What the stages of one search share.

    Parameters
    ----------
    rng : the generator that all chance comes from.
    deadline : ``time.monotonic()`` value after which no new part of the search is begun.
    report : where progress goes.
    front : best front so far of the caller's own problem (not of a reduced one).
    found : formulas that a refining stage begins with.
    depth : how many reductions lie between the caller's problem and the present one.
    solve : finds formulas for a reduced problem; by default none.
    surrogate : gives the stand-in for the function behind some samples.
    interrupted : set by a stage that was interrupted and gave what it had; the search then ends.
    above : that of the problem that this one was reduced from.
    """

    rng: np.random.Generator
    deadline: float = math.inf
    report: Report = silent
    front: ParetoFront = field(default_factory=ParetoFront)
    found: tuple[Candidate, ...] = ()
    depth: int = 0
    solve: Callable[[Samples, Context], list[Candidate]] = lambda samples, context: []
    surrogate: Callable[[Samples, Context], Surrogate] | None = None
    interrupted: bool = False
    above: Context | None = None

    @property
    def seconds_left(self) -> float:
        """Seconds until the deadline; never negative."""
        return max(0.0, self.deadline - time.monotonic())

    def tell(self, stage: str, done: float, total: float | None) -> None:
        """Report how far a stage is, with the front so far."""
        name = stage if self.depth == 0 else f"{stage} (level {self.depth})"
        self.report(Progress(name, done, total, self.front))

    def offer(self, candidates: Iterable[Candidate]) -> None:
        """Put formulas of the caller's own problem on the front as soon as they are there."""
        if self.depth == 0:
            self.front = self.front.add(*candidates)

    def deeper(self) -> Context:
        """Give the context of a problem reduced from this one."""
        return replace(self, depth=self.depth + 1, above=self)

    def interrupt(self) -> None:
        """Have the search end, and that of every problem above."""
        self.interrupted = True
        if self.above is not None:
            self.above.interrupt()


class AbstractStage(ABC):
    """One way to find formulas for samples; subclasses are frozen dataclasses of settings.

    The ``source`` of a candidate is the ``name`` of the stage that found it, alone or followed by
    a colon and how: "symmetry: scaling in a/b". Refinement keeps the source.
    """

    name: str

    @abstractmethod
    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Give candidates f with y = f(X), scored on these samples."""
