"""Grouping: which rows belong to one trajectory, and which columns only tell trajectories apart."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynsr.data.columns import Columns, bare_name

_NAMED = re.compile(
    r"(traj(ectory)?|run|trial|episode|experiment|series|replicate|sample|group)(_?(id|no|nr))?|id",
    re.IGNORECASE,
)
# Names of what is watched, which as numbers may count it too.
_SUBJECT = re.compile(
    r"(wells?|subjects?|mouse|mice|rat|animals?|patients?|plants?|specimen|individuals?|participants?|"
    r"person|cage|batch|colony|culture|device|tank|plot|station|unit|cell|fish|bird)"
    r"(_?(id|no|nr|number|name))?|\w+_id",
    re.IGNORECASE,
)
_ROWS_EACH = 5


@dataclass(frozen=True)
class Grouping:
    """What tells trajectories apart, and what it says of them.

    Parameters
    ----------
    trajectory : the column that names the trajectory of a row; None where the time alone tells.
    labels : columns that say no more than which trajectory it is.
    parameters : numbers that are constant within each trajectory and differ between them.
    """

    trajectory: str | None = None
    labels: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()


def is_run_name(name: str) -> bool:
    """Whether a column of that name is one that tells trajectories apart."""
    return _NAMED.fullmatch(bare_name(name)) is not None


def group_rows(labels: np.ndarray | None, t: np.ndarray) -> dict[str, np.ndarray]:
    """Give the rows of each trajectory, in order of appearance; a time that restarts begins one.

    Parameters
    ----------
    labels : (n,) names of the trajectories, or None where only the time tells.
    t : (n,) times.

    >>> group_rows(None, np.array([0.0, 1.0, 0.0, 1.0]))
    {'1': array([0, 1]), '2': array([2, 3])}
    """
    if labels is not None:
        whole = labels.dtype.kind == "f" and bool(np.all(labels == np.round(labels)))
        text = np.array([f"{label:.0f}" if whole else str(label) for label in labels])
        _, first, inverse = np.unique(text, return_index=True, return_inverse=True)
        return {text[first[g]]: np.flatnonzero(inverse == g) for g in np.argsort(first)}
    starts = np.flatnonzero((np.diff(t) < 0) & (t[1:] == t[0])) + 1
    pieces = np.split(np.arange(len(t)), starts)
    return {str(i + 1): piece for i, piece in enumerate(pieces)}


def guess_grouping(
    columns: Columns, t: np.ndarray, candidates: Sequence[str], trajectory: str | None
) -> Grouping:
    """Find what tells trajectories apart.

    Parameters
    ----------
    columns : the columns of the source.
    t : (n,) times.
    candidates : the columns that nobody gave a role.
    trajectory : the column that the caller named; None to guess it.

    A column is taken for the name of the trajectory when it is called so and has few values; when
    it is text and times increase within each of its values; or when it holds few whole numbers,
    within which times increase and without which they do not.
    """
    look = _Look(columns, t)
    free = [name for name in candidates if name != trajectory]
    if trajectory is None:
        trajectory = look.trajectory(free)
        free = [name for name in free if name != trajectory]
    label = None if trajectory is None else columns.values[columns.names.index(trajectory)]
    codes = _number(label) if label is not None else look.restarts
    count = int(codes.max()) + 1
    constant = [name for name in free if look.is_constant(name, codes, count)]
    labels = [n for n in constant if look.is_text(n) or (count > 1 and look.is_label(n, codes))]
    varied = [n for n in constant if count > 1 and n not in labels and look.differs(n)]
    if trajectory is None and count > 1:
        trajectory = next((name for name in labels if look.separates(name)), None)
    labels = [name for name in labels if name != trajectory]
    return Grouping(trajectory, tuple(labels), tuple(varied))


def _number(labels: np.ndarray) -> np.ndarray:
    """Number the values of a column in order of appearance."""
    keys = labels if labels.dtype.kind == "f" else np.array([str(label) for label in labels])
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]


@dataclass(frozen=True, eq=False)
class _Look:
    """Looks at the columns of a source beside its times."""

    columns: Columns
    t: np.ndarray

    @property
    def restarts(self) -> np.ndarray:
        """The number of the trajectory of each row where only the time tells."""
        again = (np.diff(self.t) < 0) & (self.t[1:] == self.t[0])
        return np.concatenate([[0], np.cumsum(again)])

    def values(self, name: str) -> np.ndarray:
        return self.columns.values[self.columns.names.index(name)]

    def is_text(self, name: str) -> bool:
        values = self.values(name)
        return values.dtype.kind == "O" and all(
            isinstance(cell, str) and not _is_number(cell) for cell in values
        )

    def trajectory(self, free: Sequence[str]) -> str | None:
        named = [n for n in free if is_run_name(n) and self.has_few(n)]
        if named:
            return named[0]
        texts = [n for n in free if self.is_text(n) and self.has_few(n) and self.separates(n)]
        if texts:
            return min(texts, key=lambda n: len(set(self.values(n))))
        if self.increases(self.restarts):
            return None
        whole = [n for n in free if self.is_whole(n) and self.has_few(n) and self.separates(n)]
        return whole[0] if len(whole) == 1 else None

    def is_whole(self, name: str) -> bool:
        values = self.values(name)
        return values.dtype.kind == "f" and bool(
            np.isfinite(values).all() and np.all(values == np.round(values))
        )

    def has_few(self, name: str) -> bool:
        values = self.values(name)
        if values.dtype.kind != "O" and not self.is_whole(name):
            return False
        distinct = len(set(map(str, values)) if values.dtype.kind == "O" else np.unique(values))
        return distinct * _ROWS_EACH <= len(values)

    def separates(self, name: str) -> bool:
        """Whether times increase within each value of a column, of which there are several.

        Where times increase as a whole, a value must stand in one piece: day and night do not.
        """
        codes = _number(self.values(name))
        if not codes.any() or not self.increases(codes):
            return False
        one_piece = bool(np.all(np.diff(codes) >= 0))
        return one_piece or not self.increases(np.zeros(len(codes), dtype=int))

    def increases(self, codes: np.ndarray) -> bool:
        if np.all(np.diff(self.t) > 0):
            return True
        order = np.argsort(codes, kind="stable")
        steps, same = np.diff(self.t[order]), np.diff(codes[order]) == 0
        return bool(np.all(steps[same] > 0))

    def is_constant(self, name: str, codes: np.ndarray, count: int) -> bool:
        values = self.values(name)
        text = values.dtype.kind == "O"
        if text and not self.is_text(name):
            return False
        if not text and values.dtype.kind != "f":
            return False
        if count == 1:
            return text and len(set(values)) == 1
        first = np.unique(codes, return_index=True)[1]
        return bool(np.all(values == values[first][codes]))

    def differs(self, name: str) -> bool:
        values = self.values(name)
        return bool(np.any(values != values[0]))

    def is_label(self, name: str, codes: np.ndarray) -> bool:
        """Whether numbers, one a trajectory, are called a name or count from 0 or 1."""
        if not self.is_whole(name) or not self.differs(name):
            return False
        first = np.unique(codes, return_index=True)[1]
        own = self.values(name)[first]
        alone = len(np.unique(own)) == len(own)
        counts = np.array_equal(own - own[0], np.arange(len(own))) and own[0] in (0, 1)
        called = _SUBJECT.fullmatch(bare_name(name)) or is_run_name(name)
        return bool(alone and (called or counts))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
