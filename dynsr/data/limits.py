"""Limits: cells that say only that a state was below, or above, a limit of its measurement."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Limits:
    """The cells of one state in which only a limit is known: what was measured is beyond it.

    Parameters
    ----------
    below : (n,) limits that the measured value was below; NaN at other rows. inf says that it was
        below a limit that is not known.
    above : (n,) limits that the measured value was above; NaN at other rows.

    >>> limits = Limits(np.array([np.nan, 0.5, np.inf]), np.full(3, np.nan))
    >>> limits.there.tolist(), limits.known.tolist()
    ([False, True, True], [False, True, False])
    """

    below: np.ndarray
    above: np.ndarray

    @classmethod
    def none(cls, rows: int) -> Limits:
        """Give limits of so many rows of which none has one."""
        return cls(np.full(rows, np.nan), np.full(rows, np.nan))

    @property
    def there(self) -> np.ndarray:
        """(n,) whether a row has a limit, known or not."""
        return ~(np.isnan(self.below) & np.isnan(self.above))

    @property
    def known(self) -> np.ndarray:
        """(n,) whether a row has a limit that is known."""
        return np.isfinite(self.below) | np.isfinite(self.above)

    def select(self, rows: slice | np.ndarray) -> Limits:
        """Give the limits of some rows."""
        return Limits(self.below[rows], self.above[rows])

    def where(self, kept: np.ndarray) -> Limits:
        """Give the same rows with the limits of some of them, and no others.

        Parameters
        ----------
        kept : (n,) booleans.
        """
        return Limits(np.where(kept, self.below, np.nan), np.where(kept, self.above, np.nan))

    def in_units(self, unit: float) -> Limits:
        """Give the limits where the state is counted in another unit; a negative one turns them."""
        both = self.below / unit, self.above / unit
        return Limits(*both) if unit > 0 else Limits(*both[::-1])

    def within(self, x: np.ndarray) -> np.ndarray:
        """Give values (n,) with those on the wrong side of a limit moved to it."""
        found: np.ndarray = np.fmax(np.fmin(x, self.below), self.above)
        return found

    def with_words(self, limit: float) -> Limits:
        """Give the same limits, with a number in the place of those that are not known."""
        return replace(self, below=np.where(np.isinf(self.below), limit, self.below))
