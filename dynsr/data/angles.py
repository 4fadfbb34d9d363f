"""Angles: columns that go round, from 359 to 0 or from 180 to -180, go on instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynsr.data.trajectory import Trajectory

# A full turn in degrees and in radians.
_TURNS = (360.0, 2 * np.pi)
_IN_RADIANS = (
    " It is in degrees; sin() and cos() of it are found more surely in radians: times pi/180."
)
# A turn seen in a column may be short of a full one by this share: by the rows next to it.
_SHORT = 0.5
# The step over the turn is like those next to it: at most this many times as large. No step is
# more than this share of a turn, so that it is clear which way each goes.
_ALIKE, _STEP = 3.0, 0.25


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore")
def unwrap_angles(runs: Sequence[Trajectory]) -> tuple[list[Trajectory], list[str]]:
    """Give trajectories whose angles do not jump by a full turn, and a sentence for each of these.

    Parameters
    ----------
    runs : trajectories of the same columns. A state is such an angle where all values lie within
        one turn, of 360 or 2 pi, and it jumps by nearly a turn where it moves on as before.

    >>> angle = np.arange(0.0, 800.0, 25.0) % 360
    >>> (run,), said = unwrap_angles([Trajectory(np.arange(32.0), angle[:, None], ("phi",))])
    >>> run.x[-3:, 0], said[0][:49]
    (array([725., 750., 775.]), 'phi jumps by a full turn of 360 in 2 places, as a')
    """
    notes: list[str] = []
    found = list(runs)
    for place, state in enumerate(runs[0].states):
        pieces = [run.observed[:, place] for run in runs]
        turn = next((turn for turn in _TURNS if _lie_within(pieces, turn)), None)
        if turn is None:
            continue
        made = [_go_on(own, turn) for own in pieces]
        count = sum(jumps for _, jumps in made)
        if not count or any(jumps < 0 for _, jumps in made):
            continue
        for number, (values, _) in enumerate(made):
            x = found[number].observed.copy()
            x[:, place] = values
            found[number] = replace(found[number], x=x)
        notes.append(
            f"{state} jumps by a full turn of {turn:.4g} in {count} "
            f"{'place' if count == 1 else 'places'}, as an angle does: it was read as one that "
            f"goes on beyond it.{_IN_RADIANS if turn == _TURNS[0] else ''}"
        )
    return found, notes


def _lie_within(pieces: Sequence[np.ndarray], turn: float) -> bool:
    """Whether all values lie within one turn, from 0 or around 0."""
    there = np.concatenate([own[np.isfinite(own)] for own in pieces])
    # Whole numbers from 0 to 6 are days of a week, or count.
    if not there.size or (turn == _TURNS[1] and np.all(there % 1 == 0)):
        return False
    slack = 1e-6 * turn
    low, high = float(there.min()), float(there.max())
    ends = ((0.0, turn), (-turn / 2, turn / 2))
    return high - low > _SHORT * turn and any(
        begin - slack <= low and high <= end + slack for begin, end in ends
    )


def _go_on(values: np.ndarray, turn: float) -> tuple[np.ndarray, int]:
    """Give values that go on over the turns, and how many of these there are; -1 for other jumps.

    A jump is a turn where the step without it is like the one before it, or behind it, and small.
    """
    there = np.flatnonzero(np.isfinite(values))
    if len(there) < 3:
        return values, 0
    plain = np.diff(values[there])
    steps = np.diff(np.unwrap(values[there], period=turn))
    jumps = np.flatnonzero(np.abs(plain) > turn / 2)
    if jumps.size and np.abs(steps).max() > _STEP * turn:
        return values, -1
    for at in jumps:
        near = steps[[k for k in (at - 1, at + 1) if 0 <= k < len(steps)]]
        same = np.any((near * steps[at] > 0) & (np.abs(steps[at]) <= _ALIKE * np.abs(near)))
        if not same:
            return values, -1
    found = values.copy()
    found[there] = np.unwrap(values[there], period=turn)
    return found, len(jumps)
