"""Translational and scaling symmetries: two variables that enter only as one combination."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.methods.feynman.stages.base import Surrogate
from dynsr.methods.feynman.stages.reduction import (
    AbstractReducer,
    AbstractReduction,
    Substitution,
    Support,
)

Move = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Symmetry(AbstractReducer):
    """Look for f(x_i - x_j), f(x_i + x_j), f(x_i / x_j) and f(x_i x_j) in every pair.

    Both variables are moved so that the combination stays (Udrescu et al. 2020) and the surrogate
    is asked whether its value stays too. Moving one of the two alone must change it much more.

    Parameters
    ----------
    tolerance : accepted median change, in validation errors of the surrogate.
    translation : look for x_i - x_j and x_i + x_j.
    scaling : look for x_i / x_j and x_i x_j.
    step : how far variables are moved, in the smaller of their standard deviations.
    factor : what variables are multiplied and divided by.
    contrast : moving one of the two alone must change the surrogate by more than so many times.
    """

    tolerance: float = 2.0
    translation: bool = True
    scaling: bool = True
    step: float = 0.5
    factor: float = 1.2
    contrast: float = 5.0
    name = "symmetry"

    def find(
        self, samples: Samples, surrogate: Surrogate, support: Support
    ) -> list[AbstractReduction]:
        """Test every pair and kind."""
        here = surrogate.predict(samples.X)
        found: list[AbstractReduction] = []
        for i, j in combinations(range(samples.X.shape[1]), 2):
            for kind, inner, move in self._moves(samples, i, j):
                error, alone = _change(samples.X, i, j, move, surrogate, here, support)
                small = error <= self.tolerance * surrogate.validation_error
                if small and alone > self.contrast * error:
                    replaced = (samples.names[i], samples.names[j])
                    label = f"{self.name}: {kind} in {inner}"
                    found.append(Substitution(label, error, inner, replaced))
        return found

    def _moves(self, samples: Samples, i: int, j: int) -> Iterator[tuple[str, sympy.Expr, Move]]:
        a, b = sympy.Symbol(samples.names[i]), sympy.Symbol(samples.names[j])
        x, z = samples.X[:, i], samples.X[:, j]
        step = self.step * min(float(np.std(x)), float(np.std(z)))
        if self.translation:
            yield "translational", a - b, lambda p, q: (p + step, q + step)
            yield "translational", a + b, lambda p, q: (p + step, q - step)
        if self.scaling:
            factor = self.factor
            if np.abs(z).min() > 1e-6 * np.abs(z).max():
                yield "scaling", a / b, lambda p, q: (p * factor, q * factor)
            yield "scaling", a * b, lambda p, q: (p * factor, q / factor)


def _change(
    X: np.ndarray,
    i: int,
    j: int,
    move: Move,
    surrogate: Surrogate,
    here: np.ndarray,
    support: Support,
) -> tuple[float, float]:
    """Median change of the surrogate when both variables move, and when one of them does."""
    both, one, other = X.copy(), X.copy(), X.copy()
    both[:, i], both[:, j] = move(X[:, i], X[:, j])
    one[:, i], other[:, j] = both[:, i], both[:, j]
    rows = support.near(both)
    if not support.enough(rows):
        return np.inf, 0.0

    def median(moved: np.ndarray) -> float:
        return float(np.median(np.abs(surrogate.predict(moved[rows]) - here[rows])))

    return median(both), min(median(one), median(other))
