"""Angles: columns that go round, from 359 to 0 or from 180 to -180, go on instead.

So do counters of so many bits, which begin again at 0.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynsr.data.trajectory import Trajectory

# What needs no unit.
_ANY = ""
# A turn in a unit that says it, and in degrees and radians, which need none.
_TURNS = (
    (360.0, _ANY),
    (2 * math.pi, _ANY),
    (400.0, r"gon|grad(ian)?s?"),
    (1.0, r"rev(olution)?s?|turns?|cycles?|umdrehung(en)?|tours?"),
)
# Degrees in a radian.
RADIAN = math.degrees(1.0)
# A counter begins again after so many bits.
_BITS = (8, 10, 12, 13, 14, 16, 24, 32)
_DEGREES = re.compile(
    r"(\u00b0|\u00ba|deg(rees?)?)"
    r"(\s*[/*\u00b7 ]\s*(s(ec)?|min|h)[^\w\s]?[\d\u2212\u207b\u00b9\u00b2-]*)*",
    re.IGNORECASE,
)
_SAY = " Called such as phi [deg], and its rate such as w [deg/s], it is searched in radians."
# A turn seen in a column may be short of a full one by this share: by the rows next to it.
_SHORT = 0.5
# The step over the turn is like those of so many rows before and behind it: at most this many times
# as large. No step is more than this share of a turn, so that it is clear which way each goes.
_NEAR, _ALIKE, _STEP = 3, 3.0, 0.25


@dataclass(frozen=True)
class _Turn:
    """What a column begins again after, and how that is called.

    Parameters
    ----------
    size : of the turn.
    bits : those of a counter; 0 for an angle.
    """

    size: float
    bits: int = 0

    @property
    def words(self) -> tuple[str, str]:
        """What a column jumps by, and as what it does."""
        if self.bits:
            return f"{self.size:.0f}", f"a counter of {self.bits} bits"
        return f"a full turn of {self.size:.4g}", "an angle"


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore")
def unwrap_angles(runs: Sequence[Trajectory]) -> tuple[list[Trajectory], list[str]]:
    """Give trajectories whose angles do not jump by a full turn, and a sentence for each of these.

    Parameters
    ----------
    runs : trajectories of the same columns. A state is such an angle where all values lie within
        one turn, and it jumps by nearly a turn where it moves on as before. A turn is 360 or 2 pi,
        400 gon and 1 revolution where the unit says it, and a power of two for whole numbers.

    >>> angle = np.arange(0.0, 800.0, 25.0) % 360
    >>> (run,), said = unwrap_angles([Trajectory(np.arange(32.0), angle[:, None], ("phi",))])
    >>> run.x[-3:, 0], said[0][:49]
    (array([725., 750., 775.]), 'phi jumps by a full turn of 360 in 2 places, as a')
    """
    notes: list[str] = []
    found = list(runs)
    units = runs[0].origin.get("units") or {}
    for place, state in enumerate(runs[0].states):
        pieces = [run.observed[:, place] for run in runs]
        unit = units.get(state, "")
        tried = [
            (turn, [_go_on(own, turn.size) for own in pieces]) for turn in _turns(pieces, unit)
        ]
        if not tried:
            continue
        seen = [one for one in tried if all(jumps >= 0 for _, jumps in one[1])]
        if not seen and is_in_degrees(unit):
            notes.append(
                f"{state} goes by more than a quarter of a turn between rows, so that no one can "
                "say which way: measure more often, or give its sine and its cosine."
            )
        turn, made = next(iter(seen), tried[0])
        count = sum(jumps for _, jumps in made)
        if not seen or not count:
            continue
        for number, (values, _) in enumerate(made):
            x = found[number].observed.copy()
            x[:, place] = values
            found[number] = replace(found[number], x=x)
        by, what = turn.words
        notes.append(
            f"{state} jumps by {by} in {count} {'place' if count == 1 else 'places'}, as {what} "
            f"does: it was read as one that goes on beyond it."
            f"{_SAY if turn.size == _TURNS[0][0] and not unit else ''}"
        )
    return found, notes


def count_on(values: np.ndarray) -> tuple[np.ndarray, int] | None:
    """Give a count that rises and begins again after so many bits as one that goes on, and these.

    Parameters
    ----------
    values : (n,) numbers, such as milliseconds of a small computer. None for others, and for those
        that begin at 0, which may be those of several runs.

    >>> count_on(np.array([65000.0, 65200.0, 65400.0, 64.0, 264.0]))
    (array([65000., 65200., 65400., 65600., 65800.]), 16)
    """
    for turn in _turns([values], ""):
        found, jumps = _go_on(values, turn.size)
        steps = np.diff(found[np.isfinite(found)])
        if turn.bits and jumps > 0 and np.all(steps >= 0) and values[0] > steps.max():
            return found, turn.bits
    return None


def is_in_degrees(unit: str) -> bool:
    """Whether a unit is degrees of an angle, or those of its slopes.

    >>> [is_in_degrees(unit) for unit in ("deg", "\u00b0/s", "deg s^-2", "\u00b0C", "rad", "")]
    [True, True, True, False, False, False]
    """
    return _DEGREES.fullmatch(unit.strip()) is not None


def _turns(pieces: Sequence[np.ndarray], unit: str) -> Iterator[_Turn]:
    """Give the turns within which all values lie, from 0 or around 0, the most probable first."""
    there = np.concatenate([own[np.isfinite(own)] for own in pieces])
    if not there.size:
        return
    whole = bool(np.all(there % 1 == 0))
    low, high = float(there.min()), float(there.max())
    known = [_Turn(size) for size, own in _TURNS if _says(own, unit, size, whole)]
    counters = [_Turn(2.0**bits, bits) for bits in _BITS] if whole else []
    for turn in (*known, *counters):
        slack = 1e-6 * turn.size
        ends = ((0.0, turn.size), (-turn.size / 2, turn.size / 2))
        if high - low > _SHORT * turn.size and any(
            begin - slack <= low and high <= end + slack for begin, end in ends
        ):
            yield turn


def _says(form: str, unit: str, size: float, whole: bool) -> bool:
    """Whether a column may be an angle of such a turn."""
    if form != _ANY:
        return re.fullmatch(form, unit, re.IGNORECASE) is not None
    # Whole numbers from 0 to 6 are days of a week, or count.
    return not whole or size > 2 * math.pi


def _go_on(values: np.ndarray, turn: float) -> tuple[np.ndarray, int]:
    """Give values that go on over the turns, and how many of these there are; -1 for other jumps.

    A jump is a turn where the step without it is small, and like those of the rows around it.
    """
    there = np.flatnonzero(np.isfinite(values))
    if len(there) < 3:
        return values, 0
    plain = np.diff(values[there])
    steps = np.abs(np.diff(np.unwrap(values[there], period=turn)))
    jumps = np.flatnonzero(np.abs(plain) > turn / 2)
    if jumps.size and steps.max() > _STEP * turn:
        return values, -1
    for at in jumps:
        near = np.delete(steps, at)[max(at - _NEAR, 0) : at + _NEAR]
        if steps[at] > _ALIKE * near.max():
            return values, -1
    found = values.copy()
    found[there] = np.unwrap(values[there], period=turn)
    return found, len(jumps)
