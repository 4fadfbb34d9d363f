"""What every method is: settings as fields, and one verb, ``search``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynsr.data import Samples
from dynsr.fit import ParetoFront


@dataclass(frozen=True)
class Progress:
    """One report of a running search: the stage, how far it is, and the front so far.

    ``total`` is None while the end is not known.
    """

    stage: str
    done: float
    total: float | None
    front: ParetoFront


Report = Callable[[Progress], None]


def silent(progress: Progress) -> None:
    """Report nothing."""


class AbstractMethod(ABC):
    """A search for the equation of one target. Subclasses are frozen dataclasses of settings."""

    name: str

    @abstractmethod
    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search for formulas f with y = f(X).

        All chance comes from ``rng``: the same samples, settings and generator state give the
        same front. ``report`` is called as the search goes on. KeyboardInterrupt ends the search
        early with the best front so far.
        """
