"""Levels: an input that holds its value and steps was measured with noise, as a scope does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynsr.data.lines import last_digit


@dataclass(frozen=True)
class LevelSettings:
    """How the values of a column say that it holds levels, but for noise.

    Parameters
    ----------
    white : half the mean squared step within its rests over the variance there (von Neumann 1941),
        which is 1 for noise alone and near 0 for what drifts.
    rest : rows of a rest; shorter ones are on the way between two, of which there are no more.
    gaussian : median size of a step of noise over its standard deviation.
    bits : what levels must say of the column beyond what a mean or a random walk says, in bits; few
        rows of chance look like levels else.
    """

    white: float = 0.5
    rest: int = 4
    gaussian: float = 0.6745
    bits: float = 10.0


_SETTINGS = LevelSettings()


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore")
def find_levels(
    pieces: Sequence[np.ndarray], settings: LevelSettings = _SETTINGS
) -> tuple[list[np.ndarray], float] | None:
    """Give a column without the noise of its levels, and this noise; None where it has none such.

    Parameters
    ----------
    pieces : its values in each trajectory, in order of time; NaN where a cell is empty.
    settings : the numbers that decide.

    It rests, but for noise that is independent from row to row, and then moves by a step that such
    noise shows in less than one row of all. Rests that are no such step apart are one level, and
    there are two levels at least.

    >>> rng = np.random.default_rng(0)
    >>> switch = 5.0 * (np.arange(90) // 15 % 2)
    >>> (found,), noise = find_levels([switch + rng.normal(0, 0.02, 90)])
    >>> sorted(set(found.round().tolist())), round(noise, 2)
    ([0.0, 5.0], 0.02)
    >>> find_levels([np.sin(np.arange(90.0))]) is None
    True
    """
    own = [piece[np.isfinite(piece)] for piece in pieces]
    steps = [np.diff(values) for values in own]
    every = np.abs(np.concatenate([np.empty(0), *steps]))
    if not len(every):
        return None
    size = max(float(np.median(every)) / settings.gaussian, last_digit(np.concatenate(own)))
    reach = size * float(np.sqrt(2 * np.log(len(every) + 1)))
    # The number of the rest that each row is of, over all trajectories.
    begins = [
        np.append(True, np.abs(step) > reach)[: len(x)] for step, x in zip(steps, own, strict=True)
    ]
    rests = np.cumsum(np.concatenate(begins)) - 1
    values = np.concatenate(own)
    counts = np.bincount(rests)
    if 2 * np.sum(counts >= settings.rest) < len(counts):
        return None
    off = values - (np.bincount(rests, values) / counts)[rests]
    squares, inside = float(np.sum(off**2)), np.diff(rests) == 0
    if not squares > 0 or np.sum(np.diff(values)[inside] ** 2) < 2 * settings.white * squares:
        return None
    levels = _join(values, rests, reach)
    if len(np.unique(levels[counts[rests] >= settings.rest])) < 2:
        return None
    if _saved(values, levels, every) < settings.bits:
        return None
    noise = float(np.sqrt(np.sum((values - levels) ** 2) / max(len(values) - len(counts), 1)))
    ends = np.cumsum([len(x) for x in own])[:-1]
    return [_put(p, part) for p, part in zip(pieces, np.split(levels, ends), strict=True)], noise


def _join(values: np.ndarray, rests: np.ndarray, reach: float) -> np.ndarray:
    """Give each row the mean of all rows of its level, of rests that are near to each other."""
    counts = np.bincount(rests)
    means = np.bincount(rests, values) / counts
    order = np.argsort(means)
    level = np.empty(len(means), dtype=int)
    level[order] = np.cumsum(np.append(0, np.diff(means[order]) > reach))
    sums, rows = np.bincount(level, means * counts), np.bincount(level, counts)
    return np.asarray((sums / rows)[level][rests])


def _saved(values: np.ndarray, levels: np.ndarray, sizes: np.ndarray) -> float:
    """Give by how many bits levels are shorter than one mean and than a random walk.

    Levels are numbers to the accuracy of their rows, and a row for each step between them. Steps
    from row to row have ``sizes``.
    """
    rows, place = len(values), np.log2(len(values))
    other = min(np.var(values), np.mean(sizes**2))
    spent = place * (np.sum(np.diff(levels) != 0) + (len(np.unique(levels)) - 1) / 2)
    return float(rows / 2 * np.log2(other / np.mean((values - levels) ** 2)) - spent)


def _put(piece: np.ndarray, values: np.ndarray) -> np.ndarray:
    found = piece.copy()
    found[np.isfinite(piece)] = values
    return found
