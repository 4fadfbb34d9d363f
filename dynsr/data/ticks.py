"""Ticks: rows between which a coarse clock does not move on are later and later, not replicates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# As often as a fair coin shows it once in a hundred times, in standard deviations.
RARE = 2.6


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def spread_ticks(t: np.ndarray, states: Sequence[np.ndarray]) -> np.ndarray | None:
    """Give the times of rows that a clock of whole ticks wrote; None where it wrote none such.

    Parameters
    ----------
    t : (n,) times in the order of the file, some of them several times.
    states : (n,) values of each state; NaN where there is none.

    The rows are even ones: each time is within a tick of a line over their numbers. And they go on
    from each other: in some state, rows of one time are nearer to the line between the means
    of the times before and after than to their own mean, and than to a distance from it
    that is the same at all times, as of several runs. Replicates do neither.

    >>> t = np.arange(0.0, 24.0, 0.25)
    >>> spread_ticks(np.floor(t), [np.exp(-0.1 * t)])[:4].round(2)
    array([0.  , 0.25, 0.5 , 0.75])
    """
    steps = np.diff(t)
    if not np.all(steps >= 0) or not np.any(steps > 0):
        return None
    numbers, first = np.arange(len(t)), np.flatnonzero(steps > 0) + 1
    paces = [float(np.polyfit(numbers, t - t[0], 1)[0])]
    if len(first) > 1:  # the same number of rows in each tick
        paces.append(float((t[first[-1]] - t[first[0]]) / (first[-1] - first[0])))
    even = min((pace * numbers for pace in paces), key=lambda own: float(np.ptp(t - own)))
    # Each time is before, or after, that of its row by less than a tick.
    if np.ptp(t - even) > 2 * steps[steps > 0].min():
        return None
    surer = [own for values in states for own in _score(t, values)]
    goes_on = any(min(own) > RARE for own in surer) and all(min(own) > -RARE for own in surer)
    return t[0] + even if goes_on else None


def _score(t: np.ndarray, values: np.ndarray) -> list[tuple[float, float]]:
    """Give how much surer it is that rows go on than that they are replicates, or of runs.

    In standard deviations of a sum over the times; nothing where no time has several rows.
    """
    there = np.isfinite(values)
    times, place, count = np.unique(t[there], return_inverse=True, return_counts=True)
    own = values[there]
    means = np.bincount(place, own) / count
    rank = np.arange(len(own)) - np.searchsorted(place, place)
    inside = (count > 1) & (np.arange(len(times)) > 0) & (np.arange(len(times)) < len(times) - 1)
    if not inside.any():
        return []
    slopes = np.zeros(len(times))
    slopes[1:-1] = (means[2:] - means[:-2]) / 2
    off = own - means[place]
    line = slopes[place] * ((rank + 0.5) / count[place] - 0.5)
    each = np.unique(count[place] * (rank.max() + 1) + rank, return_inverse=True)[1]
    same = (np.bincount(each, off) / np.bincount(each))[each]
    found = []
    for other in (np.zeros(len(off)), same):
        gain = np.bincount(place, (off - other) ** 2 - (off - line) ** 2)[inside]
        size = float(np.sqrt(np.sum(gain**2)))
        found.append(float(np.sum(gain)) / size if size > 0 else 0.0)
    return [(found[0], found[1])]
