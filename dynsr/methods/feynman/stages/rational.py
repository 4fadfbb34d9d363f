"""Short sums and ratios of features as a stage."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from dynsr.data import Samples
from dynsr.fit import Candidate
from dynsr.methods.feynman.stages.base import AbstractStage, Context
from dynsr.methods.rational import RationalSearch


@dataclass(frozen=True)
class Rational(AbstractStage):
    """The search for short sums and ratios; each round's formulas go to the front at once.

    Parameters
    ----------
    settings : which features, how many terms, and whether ratios.
    share : share of the time left that is taken at most; 0 < share <= 1.
    name : what the stage is called, since a search may run it on several kinds of features.
    """

    settings: RationalSearch = field(default_factory=RationalSearch)
    share: float = 0.4
    name: str = "rational"

    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Give the best formulas of every size."""
        found: list[Candidate] = []
        total = len(self.settings.costs) * self.settings.rounds
        context.tell(self.name, 0, total)
        seconds = min(self.settings.seconds, self.share * context.seconds_left)
        settings = replace(self.settings, seconds=seconds)
        for done, candidates in enumerate(settings.find(samples), start=1):
            labelled = [replace(c, source=self._label(c.source)) for c in candidates]
            found += labelled
            context.offer(labelled)
            context.tell(self.name, done, total)
            if context.seconds_left <= 0:
                break
        return found

    def _label(self, source: str) -> str:
        """``rational of square`` becomes ``NAME: of square``."""
        how = source.removeprefix(RationalSearch.name).strip()
        return f"{self.name}: {how}" if how else self.name
