"""Compositionality: f = F(h(x)) (Udrescu et al. 2020)."""

from __future__ import annotations

from dataclasses import dataclass

from dynsr.data import Samples
from dynsr.methods.feynman.stages.base import Surrogate
from dynsr.methods.feynman.stages.inner_functions import AbstractInnerSearch
from dynsr.methods.feynman.stages.reduction import AbstractReduction, Support


@dataclass(frozen=True)
class Compositionality(AbstractInnerSearch):
    """Look for f = F(h(x)) with h a short sum of features, by the direction of the gradient.

    An inner function counts when y, ordered by h, is a smooth curve to within the tolerance.
    """

    name = "compositionality"

    def find(
        self, samples: Samples, surrogate: Surrogate, support: Support
    ) -> list[AbstractReduction]:
        """Find inner functions of all variables."""
        if not support.fills_space:
            return []
        everything = list(range(samples.X.shape[1]))
        inner = self._inner(samples, surrogate.gradient(samples.X), everything)
        return self._accepted(inner, samples, surrogate)
