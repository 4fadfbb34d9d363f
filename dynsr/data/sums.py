"""Sums: states that nobody measured alone, seen in a linear combination with others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dynsr.data.known_noise import KnownNoise


@dataclass(frozen=True, eq=False)
class MeasuredSum:
    """What was measured in the place of a state: the state, plus multiples of others.

    Parameters
    ----------
    values : (n,) the sum in units of the state; NaN where it was not measured.
    others : other state -> its factor.
    noise : the errors of the sum, where they are known.

    >>> MeasuredSum(np.array([3.0, 4.0]), {"x": 0.5}).without({"x": np.array([2.0, 2.0])})
    array([2., 3.])
    """

    values: np.ndarray
    others: Mapping[str, float]
    noise: KnownNoise | None = None

    def without(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Give the values (n,) less some of the other states.

        Parameters
        ----------
        columns : other state -> its values (n,).
        """
        taken = sum((self.others[name] * own for name, own in columns.items()), np.zeros(1))
        return np.asarray(self.values - taken)

    def select(self, rows: slice | np.ndarray) -> MeasuredSum:
        """Give the sum at some rows."""
        noise = None if self.noise is None else self.noise.select(rows)
        return replace(self, values=self.values[rows], noise=noise)

    def in_units(self, unit: float, units: Mapping[str, float]) -> MeasuredSum:
        """Give the sum where the states are counted in other units.

        Parameters
        ----------
        unit, units : of the state, and of the others.
        """
        others = {name: factor * units[name] / unit for name, factor in self.others.items()}
        noise = None if self.noise is None else self.noise.in_units(unit)
        return MeasuredSum(self.values / unit, others, noise)
