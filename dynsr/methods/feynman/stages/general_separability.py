"""General separability: f = F(g(x_S) + h(x_R)) (Udrescu et al. 2020)."""

from __future__ import annotations

from dataclasses import dataclass

import sympy

from dynsr.data import Samples
from dynsr.methods.feynman.stages.base import Surrogate
from dynsr.methods.feynman.stages.inner_functions import AbstractInnerSearch, inner_features
from dynsr.methods.feynman.stages.reduction import AbstractReduction, Support
from dynsr.methods.feynman.stages.separability import partitions


@dataclass(frozen=True)
class GeneralSeparability(AbstractInnerSearch):
    """Look for f = F(g(x_S) + h(x_R)): a sum inside one more function of one variable.

    Products are sums of logarithms, so F(g(x_S) h(x_R)) is found too where g and h have one sign.
    """

    max_cost: int = 6
    name = "general separability"

    def find(
        self, samples: Samples, surrogate: Surrogate, support: Support
    ) -> list[AbstractReduction]:
        """Find sums over each partition of the variables."""
        if not support.fills_space:
            return []
        gradient = surrogate.gradient(samples.X)
        found: list[AbstractReduction] = []
        for first, second in partitions(samples.X.shape[1]):
            features: list[sympy.Expr] = []
            for part in (first, second):
                columns = {samples.names[j]: samples.X[:, j] for j in part}
                features += inner_features(columns, self.max_cost, self.max_features // 2)
            everything = list(range(samples.X.shape[1]))
            inner = self._inner(samples, gradient, everything, features)
            found += self._accepted(inner, samples, surrogate)
        return found
