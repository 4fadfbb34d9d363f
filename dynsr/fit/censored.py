"""Censored cells: the likelihood of a state that was only seen to be below, or above, a limit.

A measurement y = x + e with normal noise e of standard deviation s is below the limit L with the
probability Phi((L - x)/s), and above it with Phi((x - L)/s), Phi being the normal distribution
(Tobin 1958, *Econometrica* 26, 24). Minus twice its logarithm, the deviance, is in the sum of
squares what the squared residual of a measured cell is. It is convex in x, so that its own second
derivative is taken in the normal equations, and not the square of a first one: near the limit this
square is smaller by a third, and intervals would be too wide. Far on the wrong side the two are
those of a cell that was measured at the limit; far on the right side there is nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erfcx, log_ndtr


def deviance(z: np.ndarray) -> np.ndarray:
    """Give minus twice log Phi(z).

    Parameters
    ----------
    z : how far a state is on the right side of its limit, in units of the noise.

    >>> deviance(np.array([-1e9, 0.0, 9.0])).round(3).tolist()
    [1e+18, 1.386, 0.0]
    """
    found: np.ndarray = -2 * log_ndtr(z)
    return found


def steepness(z: np.ndarray) -> np.ndarray:
    """Give the slope of log Phi at z: the density over the probability (Mills 1926).

    Parameters
    ----------
    z : as for :func:`deviance`.

    >>> steepness(np.array([-1e9, 0.0, 99.0])).round(3).tolist()
    [1000000000.0, 0.798, 0.0]
    """
    with np.errstate(over="ignore"):
        found: np.ndarray = math.sqrt(2 / math.pi) / erfcx(-z / math.sqrt(2))
    return found


def residual(z: np.ndarray) -> np.ndarray:
    """Give the root of the deviance, which is in the place of a residual in units of the noise.

    Parameters
    ----------
    z : as for :func:`deviance`.
    """
    return np.sqrt(deviance(z))


@dataclass(frozen=True, eq=False)
class Censored:
    """The censored cells of a mesh.

    Parameters
    ----------
    places : (c,) states, and (c,) rows of the mesh.
    limits : (c,) limits in the units of the states.
    sure : (c,) 1 / standard deviation of the noise; negative where the state was above its limit.
    """

    places: tuple[np.ndarray, np.ndarray]
    limits: np.ndarray
    sure: np.ndarray

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """All that it consists of."""
        return (*self.places, self.limits, self.sure)

    def at(self, kept: np.ndarray) -> Censored | None:
        """Give the cells in some rows of the mesh, which get new numbers; None for none.

        Parameters
        ----------
        kept : (n,) booleans.
        """
        states, rows = self.places
        own = kept[rows]
        if not own.any():
            return None
        places = states[own], (np.cumsum(kept) - 1)[rows[own]]
        return replace(self, places=places, limits=self.limits[own], sure=self.sure[own])

    def inside(self, seen: np.ndarray) -> np.ndarray:
        """Give how far states (k, n) are on the right side, (c,) in units of the noise."""
        found: np.ndarray = self.sure * (self.limits - seen[self.places])
        return found

    def deviances(self, seen: np.ndarray) -> np.ndarray:
        """Give what the cells add (c,) to the sum of squares of states (k, n)."""
        return deviance(self.inside(seen))

    def residuals(self, seen: np.ndarray) -> np.ndarray:
        """Give the roots of the deviances (c,), positive where states (k, n) are to be lower."""
        return np.copysign(residual(self.inside(seen)), self.sure)

    def terms(self, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Half the second and half the first derivative of the deviances by states, and their sum.

        Parameters
        ----------
        seen : (k, n) what is seen of the states.
        """
        z = self.inside(seen)
        steep = steepness(z)
        # Far on the wrong side the difference is rounding; of what is beyond a limit there, the
        # variance, which is missing to 1, is less than 1 / z^2.
        least = 1 - np.divide(1.0, z**2, out=np.ones_like(z), where=z < -1)
        bend = np.clip(steep * (steep + z), least, 1.0)
        return self.sure**2 * bend, self.sure * steep, float(np.sum(deviance(z)))

    def by_state(self, squares: np.ndarray, states: int) -> np.ndarray:
        """Add up squares (c,) to (k,) of the states."""
        return np.bincount(self.places[0], squares, minlength=states)
