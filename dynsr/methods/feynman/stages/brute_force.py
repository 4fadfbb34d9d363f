"""The enumeration of functions as a stage."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from dynsr.data import Samples
from dynsr.fit import Candidate
from dynsr.methods.feynman.enumeration.brute_force import (
    BruteForce,
    RunningSearch,
    search_samples,
)
from dynsr.methods.feynman.stages.base import AbstractStage, Context


@dataclass(frozen=True)
class Enumeration(AbstractStage):
    """Every function up to a size or a number of functions, each looked at once.

    Parameters
    ----------
    settings : letters, changes of the target and bounds.
    share : share of the time left that is taken at most; 0 < share <= 1.
    name : what the stage is called, since a search may enumerate twice, a little and a lot.
    """

    settings: BruteForce = field(default_factory=BruteForce)
    share: float = 0.5
    name: str = "brute force"

    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Give the formulas found."""
        seconds = min(self.settings.seconds, self.share * context.seconds_left)
        if seconds <= 0:
            return []
        settings = replace(self.settings, seconds=seconds)

        def tell(running: RunningSearch) -> None:
            context.tell(self.name, running.formed, None)

        result = search_samples(samples, settings, tell)
        if result.stopped == "interrupted":
            context.interrupt()
        return [replace(candidate, source=self.name) for candidate in result.candidates]
