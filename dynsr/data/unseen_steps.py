"""Unseen steps: inputs that step between two rows, at a time that no row shows.

How long the input had which value in such an interval is not known. No reading of the input is
right there, neither a constant nor a line. A fit that takes one of them for right pays with terms
that are in no law. What happens on either side of the interval is known as well as elsewhere. So a
run is cut there, and each part begins at a state of its own.

Whether steps are between rows is seen without any equation. The row after a step was measured
before the new value acted, if it acts from that row on. Then the motion before the step, continued
to that row, has no larger residual there than at the rows before. The residuals are compared step
by step, each with those of the same stretch, and their probabilities are combined (Fisher 1925).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from scipy.special import chdtrc, fdtrc

from dynsr.data.noise_model import NoiseSettings, robust_scale, rounding
from dynsr.data.trajectory import FEWEST_ROWS, Trajectory


@dataclass(frozen=True)
class UnseenStepSettings:
    """How steps between rows are recognised.

    Parameters
    ----------
    chance : probability of what happens at the steps, if they are at rows, below which they are
        between rows.
    degrees : of the polynomials that continue the motion.
    times : rows of each, in multiples of the fewest that determine it.
    before : rows before a step that are compared with the row after it, at most.
    steps : steps that are looked at; of more, evenly spaced ones.
    kept : share of the rows that must be in parts that are long enough, where runs are cut.
    """

    chance: float = 1e-3
    degrees: tuple[int, ...] = (1, 2, 3, 4)
    times: tuple[int, ...] = (1, 2, 3)
    before: int = 30
    steps: int = 200
    kept: float = 0.5


_SETTINGS = UnseenStepSettings()
# Residuals before a step, at least, that its own is compared with.
_FEWEST = 2


@dataclass(frozen=True, eq=False)
class UnseenSteps:
    """Steps of inputs that lie between rows.

    Parameters
    ----------
    inputs : the inputs that step between rows.
    rows : for each run the rows, from 0, before the next of which one of them steps.
    probability : how probable what is seen at the steps would be if all were at rows.
    """

    inputs: tuple[str, ...]
    rows: tuple[np.ndarray, ...]
    probability: float

    @property
    def count(self) -> int:
        """The intervals in which an input steps."""
        return sum(map(len, self.rows))

    def parts(self, runs: Sequence[Trajectory]) -> list[list[slice]]:
        """Give for each run the rows of its parts between the steps, of those that are long enough.

        Parameters
        ----------
        runs : the trajectories in which the steps were found.
        """
        edges = [
            [0, *(own + 1).tolist(), len(run)] for run, own in zip(runs, self.rows, strict=True)
        ]
        return [[slice(a, b) for a, b in pairwise(own) if b - a >= FEWEST_ROWS] for own in edges]


def find_unseen_steps(
    runs: Sequence[Trajectory],
    known: Collection[str] = (),
    settings: UnseenStepSettings = _SETTINGS,
) -> UnseenSteps | None:
    """Find the inputs that step between rows; None where none does, or nothing shows it.

    Parameters
    ----------
    runs : trajectories of the same columns, whose inputs have a way between rows.
    known : inputs whose values are known at all times.
    settings : the numbers that decide.

    >>> t = np.arange(100.0)
    >>> u = np.floor(t / 25) % 2
    >>> at = np.array([0, 25, 50, 75, 100])
    >>> late, early = (np.interp(t, at - ago, [0, 0, 25, 25, 50]) for ago in (0.0, 0.5))
    >>> runs = [Trajectory(t, x[:, None], ("x",), u[:, None], ("u",)) for x in (late, early)]
    >>> find_unseen_steps(runs[:1]) is None, find_unseen_steps(runs[1:]).rows[0].tolist()
    (True, [24, 49, 74])
    """
    steps = _steps(runs, known)
    if not steps:
        return None
    every = _together(list(steps.values()))
    places, found = range(len(runs[0].states)), {}
    for name, own in steps.items():
        chance = min(_probability(runs, place, own, every, settings) for place in places)
        # So many tests are made, of which one alone may say it.
        chance *= len(steps) * len(places)
        if chance < settings.chance:
            found[name] = chance
    if not found:
        return None
    rows = _together([steps[name] for name in found])
    return UnseenSteps(tuple(found), tuple(rows), min(found.values()))


def find_steps(runs: Sequence[Trajectory], known: Collection[str] = ()) -> UnseenSteps | None:
    """Find all steps of inputs, wherever they are between rows; None where no input steps.

    Parameters
    ----------
    runs : trajectories of the same columns, whose inputs have a way between rows.
    known : inputs whose values are known at all times.

    >>> t = np.arange(30.0)
    >>> run = Trajectory(t, t[:, None], ("x",), np.floor(t / 10)[:, None], ("u",))
    >>> find_steps([run]).rows[0].tolist()
    [9, 19]
    """
    steps = _steps(runs, known)
    rows = _together(list(steps.values())) if steps else []
    return UnseenSteps(tuple(steps), tuple(rows), 1.0) if steps else None


def cut_at_unseen_steps(
    runs: Sequence[Trajectory], steps: UnseenSteps, settings: UnseenStepSettings = _SETTINGS
) -> list[Trajectory] | None:
    """Cut runs where inputs step between rows; None where too little would be left.

    Parameters
    ----------
    runs : the trajectories in which the steps were found.
    steps : what was found.
    settings : the numbers that decide.

    >>> run = Trajectory(np.arange(30.0), np.ones((30, 1)), ("x",))
    >>> parts = cut_at_unseen_steps([run], UnseenSteps(("u",), (np.array([9]),), 0.0))
    >>> [len(part) for part in parts]
    [10, 20]
    """
    pairs = zip(runs, steps.parts(runs), strict=True)
    parts = [run.select(rows) for run, own in pairs for rows in own]
    return parts if sum(map(len, parts)) >= settings.kept * sum(map(len, runs)) else None


def _steps(runs: Sequence[Trajectory], known: Collection[str]) -> dict[str, list[np.ndarray]]:
    """Input that steps -> for each run the rows before the next of which it does."""
    found = {
        name: [_steps_of(run, place) for run in runs]
        for place, name in enumerate(runs[0].input_names)
        if name not in known and runs[0].holds[name] != "smooth"
    }
    return {name: own for name, own in found.items() if any(map(len, own))}


def _together(steps: Sequence[Sequence[np.ndarray]]) -> list[np.ndarray]:
    """Give for each run the rows of all inputs."""
    return [np.unique(np.concatenate(own)) for own in zip(*steps, strict=True)]


def _steps_of(run: Trajectory, place: int) -> np.ndarray:
    """Give the rows before the next of which an input steps."""
    changes = np.diff(run.inputs[:, place])
    if run.holds[run.input_names[place]] == "previous":
        return np.flatnonzero(changes)
    noise = NoiseSettings()
    away = np.abs(changes - np.median(changes))
    far = np.flatnonzero(away > max(noise.outlier * float(robust_scale(away)), 0.0))
    # So many are no steps but the motion of the input.
    return far if len(far) <= noise.share * len(changes) else far[:0]


def _probability(
    runs: Sequence[Trajectory],
    place: int,
    steps: Sequence[np.ndarray],
    every: Sequence[np.ndarray],
    settings: UnseenStepSettings,
) -> float:
    """Give how probable the rows after steps are, if the steps are at those rows."""
    some = [(i, row) for i, own in enumerate(steps) for row in own.tolist()]
    if len(some) > settings.steps:
        some = [some[k] for k in np.linspace(0, len(some) - 1, settings.steps).astype(int)]
    values = np.concatenate([run.observed[:, place] for run in runs])
    least = rounding(values)
    best: tuple[float, list[np.ndarray]] | None = None
    for degree, times in product(settings.degrees, settings.times):
        width = times * (degree + 1)
        each = [_missed(runs[i], place, row, every[i], degree, width, settings) for i, row in some]
        found = [missed for missed in each if len(missed) > _FEWEST]
        if found:
            size = float(robust_scale(np.concatenate([missed[:-1] for missed in found])))
            if best is None or size < best[0]:
                best = size, found
    if best is None:
        return 1.0
    total, count = 0.0, 0
    for *before, miss in best[1]:
        usual = float(np.mean(np.square(before))) + least**2
        # Neighbouring misses share rows: about half of them are independent.
        chance = float(fdtrc(1, len(before) / 2, miss**2 / max(usual, 1e-300)))
        total -= 2 * np.log(max(chance, 1e-300))
        count += 1
    return float(chdtrc(2 * count, total))


def _missed(
    run: Trajectory,
    place: int,
    row: int,
    every: np.ndarray,
    degree: int,
    width: int,
    settings: UnseenStepSettings,
) -> np.ndarray:
    """Give by how much rows miss the polynomial through those before; the last is after a step."""
    earlier = every[every < row]
    begin = int(earlier[-1]) + 1 if len(earlier) else 0
    first = max(begin, row + 1 - settings.before - width)
    t, x = run.t[first : row + 2], run.observed[first : row + 2, place]
    if len(t) < width + 3:
        return np.empty(0)
    times = np.lib.stride_tricks.sliding_window_view(t, width + 1)
    windows = np.lib.stride_tricks.sliding_window_view(x, width + 1)
    scaled = (times - times[:, :1]) / (times[:, -1:] - times[:, :1]) * 2 - 1
    powers = scaled[..., None] ** np.arange(degree + 1)
    inside, ahead = powers[:, :-1], powers[:, -1]
    gram = np.einsum("nij,nik->njk", inside, inside)
    weights = np.einsum("nij,nj->ni", inside, np.linalg.solve(gram, ahead[..., None])[..., 0])
    # In units of the noise, whatever the times between the rows are.
    size = np.sqrt(1 + np.sum(weights**2, axis=1))
    missed = (windows[:, -1] - np.einsum("ni,ni->n", weights, windows[:, :-1])) / size
    if not np.isfinite(missed[-1]):
        return np.empty(0)
    return missed[np.isfinite(missed)]
