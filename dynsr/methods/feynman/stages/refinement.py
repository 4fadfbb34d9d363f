"""Refit and snapping as the last stage: every formula on the front gets the constants it needs."""

from __future__ import annotations

from dataclasses import dataclass

import sympy

from dynsr.data import Samples
from dynsr.fit import Candidate, FitSettings, ParetoFront, refit, score_candidate, snap_best
from dynsr.methods.feynman.stages.base import AbstractStage, Context


@dataclass(frozen=True)
class Refinement(AbstractStage):
    """Fit the constants of formulas already found, and snap them to simple numbers.

    Parameters
    ----------
    snapping : also snap the ``top`` formulas of least description length, with robust refits.
    top : how many shapes are snapped.
    most_constants : formulas with more floats are left as they are.
    """

    snapping: bool = True
    top: int = 8
    most_constants: int = FitSettings.most_constants
    name = "refinement"

    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Refine the Pareto front by plain least squares; then snap."""
        front = [c for c in ParetoFront(context.found) if self._constants(c) <= self.most_constants]
        found: list[Candidate] = []
        for done, candidate in enumerate(front):
            if context.seconds_left <= 0:
                break
            context.tell(self.name, done, len(front))
            if self._constants(candidate):
                expr = refit(candidate.expr, samples)
                found.append(score_candidate(expr, samples, candidate.source))
        if self.snapping and context.seconds_left > 0:
            context.tell("snapping", 0, None)
            small = [c for c in context.found if self._constants(c) <= self.most_constants]
            found += snap_best(small, samples, self.top)
        return found

    def _constants(self, candidate: Candidate) -> int:
        return len(candidate.expr.atoms(sympy.Float))
