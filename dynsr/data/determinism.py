"""Determinism: how far one column's value follows from others, by near neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from dynsr.data.noise_model import scale_of


@dataclass(frozen=True, eq=False)
class Orbit:
    """Rows of one or more runs: where the system was, and a value that should follow from it.

    Parameters
    ----------
    points : (n, d) coordinates, any units.
    values : (n,) what should follow from them.
    run : (n,) number of the run that each row is of.
    row : (n,) number of the row in its run.

    >>> t = np.linspace(0, 20, 400)
    >>> rows = np.arange(400)
    >>> circle = Orbit(np.sin(t)[:, None], np.cos(t), np.zeros(400), rows)
    >>> nearest_pairs(circle).share > 0.5
    True
    """

    points: np.ndarray
    values: np.ndarray
    run: np.ndarray
    row: np.ndarray

    def thinned(self, most: int) -> Orbit:
        """Give at most so many rows, evenly spaced."""
        if len(self.values) <= most:
            return self
        kept = np.linspace(0, len(self.values) - 1, most).astype(int)
        return Orbit(self.points[kept], self.values[kept], self.run[kept], self.row[kept])


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of rows that are near to each other and not neighbours in time.

    Parameters
    ----------
    first, second : (m,) the rows of each pair, the nearest pair first.
    difference : (m,) value of the first less that of the second.
    distance : root mean square of their distances, in spreads of the coordinates.
    share : half the mean squared difference as a share of the variance of the values: 0 where
        the coordinates determine the value, 1 where they say nothing of it; nan without pairs.
    """

    first: np.ndarray
    second: np.ndarray
    difference: np.ndarray
    distance: float
    share: float

    def nearer(self, part: float) -> Pairs:
        """Give the nearest of the pairs, this share of them; from near to far."""
        kept = slice(None, int(np.ceil(part * len(self.first))))
        return replace(
            self,
            first=self.first[kept],
            second=self.second[kept],
            difference=self.difference[kept],
        )


def nearest_pairs(orbit: Orbit, neighbours: int = 6, nearest: float = 0.5) -> Pairs:
    """Pair every row with the nearest rows of other passes, and keep the nearer of the pairs.

    Half the mean squared difference of the values of near rows is the variance that their
    coordinates leave open (the delta test of Pi and Peterson 1994). Rows near in time are near in
    state too and would hide a state that is missing (Theiler 1986): they are left out for as long
    as the values stay correlated by more than a half.

    Parameters
    ----------
    orbit : the rows.
    neighbours : pairs a row.
    nearest : share of all pairs, the nearest ones, that is kept.
    """
    points = orbit.points / [scale_of(column) for column in orbit.points.T]
    gap = memory(orbit)
    asked = min(len(points), 2 * gap + 1 + neighbours)
    # A query for one neighbour gives flat arrays, and finds nothing but the row itself.
    distance, other = cKDTree(points).query(points, max(asked, 2))
    own = np.arange(len(points))[:, None]
    other = np.minimum(other, len(points) - 1)
    same = orbit.run[other] == orbit.run[own]
    close = same & (np.abs(orbit.row[other] - orbit.row[own]) <= gap * _stride(orbit))
    distance = np.where(close | (other == own), np.inf, distance)
    order = np.argsort(distance, axis=1)[:, :neighbours]
    distance = np.take_along_axis(distance, order, axis=1)
    other = np.take_along_axis(other, order, axis=1)
    first, column = np.nonzero(np.isfinite(distance))
    distance, second = distance[first, column], other[first, column]
    kept = np.argsort(distance, kind="stable")[: int(np.ceil(nearest * len(distance)))]
    first, second, distance = first[kept], second[kept], distance[kept]
    difference = orbit.values[first] - orbit.values[second]
    variance = float(np.var(orbit.values))
    if not len(kept) or variance == 0:
        return Pairs(first, second, difference, np.inf, np.nan)
    share = float(np.mean(difference**2)) / 2 / variance
    return Pairs(first, second, difference, float(np.sqrt(np.mean(distance**2))), share)


def _stride(orbit: Orbit) -> float:
    steps = np.diff(orbit.row)
    return float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0


def memory(orbit: Orbit, most: float = 0.1) -> int:
    """Count the rows over which the values stay correlated by more than a half.

    At most the share ``most`` of all rows, so that pairs are left.
    """
    values = orbit.values - np.mean(orbit.values)
    size = float(values @ values)
    last = int(most * len(values))
    if size == 0 or last < 1:
        return last
    for lag in range(1, last):
        if values[lag:] @ values[:-lag] < 0.5 * size:
            return lag
    return last


def forced_share(
    pairs: Pairs, times: np.ndarray, periods: Sequence[float] | np.ndarray
) -> tuple[float, float]:
    """Give how much of the pairs' differences a sinusoid of the time explains, and its period.

    Where y = f(x) + a cos(w t) + b sin(w t), the values of near rows differ by the forcing alone.

    Parameters
    ----------
    pairs : near rows and how their values differ.
    times : (n,) time of every row.
    periods : the periods tried.

    >>> t = np.linspace(0, 40, 800)
    >>> rows = np.arange(800)
    >>> pairs = nearest_pairs(Orbit(np.sin(t)[:, None], np.cos(t), np.zeros(800), rows))
    >>> share, period = forced_share(pairs, t, [3.0, 2 * np.pi, 11.0])
    >>> share > 0.99, round(period, 2)
    (True, 6.28)
    """
    size = float(pairs.difference @ pairs.difference)
    best, found = 0.0, np.nan
    for period in periods if size else ():
        angle = 2 * np.pi / period * times
        wave = np.column_stack([np.cos(angle), np.sin(angle)])
        columns = wave[pairs.first] - wave[pairs.second]
        weights, *_ = np.linalg.lstsq(columns, pairs.difference, rcond=None)
        left = pairs.difference - columns @ weights
        share = 1 - float(left @ left) / size
        if share > best:
            best, found = share, float(period)
    return best, found
