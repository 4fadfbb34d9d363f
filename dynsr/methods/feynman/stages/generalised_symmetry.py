"""Generalised symmetry: f = F(h(x_S), x_R) (Udrescu et al. 2020)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

from dynsr.data import Samples
from dynsr.methods.feynman.stages.base import Surrogate
from dynsr.methods.feynman.stages.inner_functions import AbstractInnerSearch, shown
from dynsr.methods.feynman.stages.reduction import AbstractReduction, Substitution, Support


@dataclass(frozen=True)
class GeneralisedSymmetry(AbstractInnerSearch):
    """Look for f = F(h(x_S), x_R) with two or more, but not all, of the variables in h.

    The gradient restricted to x_S must have the direction of grad h for all values of the others.
    An inner function is accepted when its gradient is within ``angle`` (radians, root mean square)
    of that direction.
    """

    max_features: int = 36
    angle: float = 0.05
    name = "generalised symmetry"

    def find(
        self, samples: Samples, surrogate: Surrogate, support: Support
    ) -> list[AbstractReduction]:
        """Try every subset of the variables."""
        count = samples.X.shape[1]
        if count < 3 or not support.fills_space:
            return []
        gradient = surrogate.gradient(samples.X)
        found: list[AbstractReduction] = []
        for size in range(2, count):
            for which in combinations(range(count), size):
                names = tuple(samples.names[j] for j in which)
                for h in self._inner(samples, gradient, list(which))[:1]:
                    if h.misalignment <= self.angle**2:
                        error = surrogate.validation_error * h.misalignment / self.angle**2
                        kind = f"{self.name}: {shown(h.expr)}"
                        found.append(Substitution(kind, error, h.expr, names))
        return found
