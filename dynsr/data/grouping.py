"""Grouping: the rows of each trajectory, and the columns that only distinguish trajectories."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dynsr.data.columns import Columns
from dynsr.data.lines import ROUNDED
from dynsr.data.name_parts import is_label_name, is_run_name
from dynsr.data.time_columns import Times

_ROWS_EACH = 5
_MOST_TOGETHER = 3
# Rows that were put in order by time and change by more than this share of what independent ones
# would (von Neumann 1941) may be those of several trajectories.
_ROUGH = 0.5
# Rows of one time are of several trajectories where they differ so much that each of these changes
# by less than this share of it from one moment to the next.
_OWN = 0.5


@dataclass(frozen=True, eq=False)
class Grouping:
    """What distinguishes trajectories, and what it says of them.

    Parameters
    ----------
    codes : (n,) the number of the trajectory of each row, in order of appearance.
    names : those of the trajectories.
    trajectory : the columns that together name the trajectory of a row; none where the time alone
        shows it.
    labels : further columns that say no more than which trajectory it is.
    parameters : numbers that are constant within each trajectory and differ between them.
    """

    codes: np.ndarray
    names: tuple[str, ...]
    trajectory: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()

    def rows(self) -> Iterator[tuple[str, np.ndarray]]:
        """Give the name and the rows of each trajectory."""
        for code, name in enumerate(self.names):
            yield name, np.flatnonzero(self.codes == code)


def differ_as_parameter(name: str, values: Sequence[float]) -> bool:
    """Whether numbers, one for each source, differ and are more than the names of these.

    Parameters
    ----------
    name : the column.
    values : its number in each source.

    >>> differ_as_parameter("D", [0.05, 0.1]), differ_as_parameter("run", [1.0, 2.0])
    (True, False)
    """
    own = np.array(values)
    counts = np.array_equal(own, own[0] + np.arange(len(own))) and own[0] in (0, 1)
    return len(set(values)) > 1 and not is_label_name(name) and not (counts and len(own) > 2)


def is_text(values: np.ndarray) -> bool:
    """Whether all cells that are not empty are text and no numbers."""
    if values.dtype.kind != "O":
        return False
    there = [cell for cell in values if not _is_missing(cell)]
    return bool(there) and all(isinstance(cell, str) and not is_number(cell) for cell in there)


def find_restarts(t: np.ndarray) -> np.ndarray:
    """Give the number of the trajectory of each row where only the time shows it.

    Parameters
    ----------
    t : (n,) finite times.

    A trajectory begins where the time falls back to its first value, or to any time before the end
    of the rows before where it then rises over rows enough.

    >>> find_restarts(np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0]))
    array([0, 0, 0, 1, 1, 1])
    """
    falls = np.flatnonzero(np.diff(t) < 0) + 1
    if not len(falls):
        return np.zeros(len(t), dtype=int)
    # Beside a single cell that is wrong the times go on from those before it.
    falls = falls[falls + 1 < len(t)]
    falls = falls[(t[np.minimum(falls + 1, len(t) - 1)] <= t[falls - 1])]
    falls = falls[(falls < 2) | (t[falls] <= t[falls - 2])]
    ends = np.append(falls[1:], len(t)) if len(falls) else falls
    starts = np.append(0, falls[:-1]) if len(falls) else falls
    kept: list[int] = []
    for begin, fall, end in zip(starts.tolist(), falls.tolist(), ends.tolist(), strict=True):
        long = min(fall - begin, end - fall) >= _ROWS_EACH
        # Pieces of other times may be parts of one trajectory in the wrong order.
        over = np.max(t[fall:end]) > np.min(t[begin:fall])
        if t[fall] == t[0] or (long and over):
            kept.append(fall)
    codes = np.zeros(len(t), dtype=int)
    # Rows that fall back elsewhere too stand in no order that would tell.
    if set(falls.tolist()) <= set(kept):
        codes[kept] = 1
    return np.cumsum(codes)


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore")
def guess_grouping(
    columns: Columns,
    time: Times,
    candidates: Sequence[str],
    trajectory: Sequence[str] | None,
) -> Grouping:
    """Find what distinguishes trajectories.

    Parameters
    ----------
    columns : the columns of the source.
    time : its times, all of which are there.
    candidates : the columns that nobody gave a role.
    trajectory : the columns that the caller named; None to guess them.

    All columns that are called names of trajectories and have few values distinguish them; and as
    few as it needs of those of text, or else of few numbers, so that within each trajectory times
    increase, or no time repeats. A text that changes within what these give is one more such
    column where the other columns go on more smoothly within its values than across them.
    """
    look = _Look(columns, time)
    chosen = look.choose(candidates) if trajectory is None else list(trajectory)
    chosen.sort(key=columns.names.index)
    codes = look.join(chosen)
    if trajectory is None and chosen and not look.is_apart(codes):
        both = _number(np.column_stack([codes, look.restarts]))
        if look.increases(both) and len(both) >= _ROWS_EACH * (both.max() + 1):
            codes = both
    if not chosen:
        codes = look.restarts
        if trajectory is None and not look.is_apart(codes):
            codes = look.interleaved(codes)
    free = [name for name in candidates if name not in chosen]
    count = int(codes.max()) + 1
    constant = [name for name in free if look.is_constant(name, codes, count)]
    labels = [n for n in constant if look.is_text(n) or (count > 1 and look.is_label(n, codes))]
    if trajectory is None and not chosen and count > 1:
        numbers = [n for n in constant if n not in labels and look.is_whole(n) and look.differs(n)]
        chosen = look.fewest(labels, codes) or look.fewest([*labels, *numbers], codes)
        # Numbers alone say what was set in a trajectory; they do not name it.
        chosen = sorted(chosen if set(chosen) & set(labels) else [], key=columns.names.index)
    labels = [name for name in labels if name not in chosen]
    varied = [n for n in constant if count > 1 and n not in (*labels, *chosen) and look.differs(n)]
    if trajectory is None:
        varied += [n for n in chosen if look.is_parameter(n)]
    return Grouping(codes, look.name(codes, chosen), tuple(chosen), tuple(labels), tuple(varied))


def _number(keys: np.ndarray) -> np.ndarray:
    """Number the values of a column, or the rows of several, in order of appearance."""
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True, axis=0)
    return np.asarray(np.argsort(np.argsort(first))[inverse.reshape(-1)])


def label_of(cell: object) -> str:
    """Give a cell as the name of a trajectory; whole numbers have no decimals.

    >>> label_of(2.0), label_of("warm")
    ('2', 'warm')
    """
    if isinstance(cell, float):
        return "" if np.isnan(cell) else f"{cell:.12g}"
    return "" if cell is None else str(cell).strip()


def _is_missing(cell: object) -> bool:
    return cell is None or (isinstance(cell, float) and np.isnan(cell))


class _Look:
    """Looks at the columns of a source other than its times."""

    def __init__(self, columns: Columns, time: Times) -> None:
        """Remember the columns."""
        self.columns, self.time = columns, time
        self._one = np.zeros(len(time.values), dtype=int)
        self._texts: dict[str, np.ndarray] = {}
        self.restarts = find_restarts(time.within(self._one))

    def values(self, name: str) -> np.ndarray:
        """Give the cells of a column; a name that is once above its rows is that of all."""
        values = self.columns.values[self.columns.names.index(name)]
        if values.dtype.kind != "O":
            return values
        if name not in self._texts:
            cells = np.array([label_of(cell) for cell in values], dtype=object)
            there = np.flatnonzero(cells != "")
            starts = np.flatnonzero(np.diff(self.time.values, prepend=np.inf) < 0)
            if 0 < len(there) < len(cells) and np.array_equal(there, starts):
                cells = cells[there][np.cumsum(cells != "") - 1]
            self._texts[name] = cells
        return self._texts[name]

    def codes(self, name: str) -> np.ndarray:
        """Number the values of a column."""
        values = self.values(name)
        return _number(values.astype(str) if values.dtype.kind == "O" else values)

    def join(self, names: Sequence[str]) -> np.ndarray:
        """Number what several columns say together."""
        if not names:
            return self._one
        return _number(np.column_stack([self.codes(name) for name in names]))

    def name(self, codes: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
        """Name the trajectories by the values of columns; by number where those do not decide."""
        first = np.unique(codes, return_index=True)[1]
        found = [", ".join(filter(None, (self._label(n, row) for n in names))) for row in first]
        if not names:
            return tuple(str(i + 1) for i in range(len(first)))
        seen: dict[str, int] = {}
        for i, own in enumerate(found):
            seen[own] = seen.get(own, 0) + 1
            if found.count(own) > 1 or seen[own] > 1:
                found[i] = f"{own}, {seen[own]}"
        return tuple(found)

    def _label(self, name: str, row: int) -> str:
        cell = self.values(name)[row]
        words = self.columns.words.get(name, {})
        return words[cell] if cell in words else label_of(cell)

    def interleaved(self, codes: np.ndarray) -> np.ndarray:
        """Number rows of one time by their order, where these go on as runs of their own do.

        Rows of replicates of one moment differ as much as those of two; rows of different runs,
        which have the same order at every moment, change by less from one to the next.
        """
        t = self.time.within(codes)
        order = np.lexsort([np.arange(len(t)), t, codes])
        keys = np.column_stack([codes, t])[order]
        starts = np.flatnonzero(np.any(np.diff(keys, axis=0, prepend=np.inf) != 0, axis=1))
        counts = np.diff(np.append(starts, len(t)))
        if counts.min() != counts.max() or len(counts) < _ROWS_EACH:
            return codes
        apart, moved = [], []
        for values in self._numbers():
            table = values[order].reshape(len(counts), -1)
            table = table[:, np.all(np.isfinite(table), axis=0)]
            if table.shape[1] > 1 and np.ptp(table) > 0:
                apart.append(float(np.median(np.abs(np.diff(table, axis=1)))))
                moved.append(float(np.median(np.abs(np.diff(table, axis=0)))))
        if (
            not apart
            or sum(m < _OWN * a for m, a in zip(moved, apart, strict=True)) <= len(apart) / 2
        ):
            return codes
        place = np.empty(len(t), dtype=int)
        place[order] = np.tile(np.arange(counts[0]), len(counts))
        return _number(np.column_stack([codes, place]))

    def is_text(self, name: str) -> bool:
        """Whether a column holds text, and no numbers that wait for a word of the user."""
        return name not in self.columns.faults and is_text(
            self.columns.values[self.columns.names.index(name)]
        )

    def choose(self, free: Sequence[str]) -> list[str]:
        """Choose the columns that distinguish trajectories."""
        named = [n for n in free if is_run_name(n) and self.has_few(n)]
        texts = [n for n in free if n not in named and self.is_text(n) and self.has_few(n)]
        texts = [n for n in texts if self.differs(n)]
        base = self.join(named) if named else self.restarts
        if self.increases(base) and (named or base.any()):
            chosen = named or self.fewest(texts, base)
            return self._with_rough(chosen, texts) if chosen or not texts else []
        if not named and self.increases(base):
            # All times rise: a text that stands in one piece each names parts.
            pieces = [n for n in texts if np.all(np.diff(self.codes(n)) >= 0)]
            pieces.sort(key=lambda n: len(set(self.values(n))))
            return pieces[:1] or self._with_rough([], texts)
        for fits in (self.increases, self.is_apart):
            chosen = self._smallest(texts, named, fits)
            if chosen:
                return self._with_rough([*named, *chosen], texts)
            if fits(base if named else self._one):
                return self._with_rough(named, texts)
            numbers = [n for n in free if n not in (*named, *texts) and self.is_whole(n)]
            chosen = self._smallest(
                [*texts, *filter(self.has_few, numbers)], named, fits, only=True
            )
            if chosen:
                return self._with_rough([*named, *chosen], texts)
        # Several rows of one time within all that is known.
        return [*named, *(n for n in texts if is_label_name(n) or self._is_smoother(n, named))]

    def _smallest(
        self,
        pool: Sequence[str],
        named: Sequence[str],
        fits: Callable[[np.ndarray], bool],
        only: bool = False,
    ) -> list[str]:
        """Give the fewest columns, in addition to those named, that distinguish the rows of a time.

        ``only`` refuses to choose where several do as well.
        """
        for count in range(1, _MOST_TOGETHER + 1):
            sets = [list(own) for own in combinations(pool[: _MOST_TOGETHER * 4], count)]
            found = [own for own in sets if fits(self.join([*named, *own]))]
            few = [own for own in found if self._many_rows(self.join([*named, *own]))]
            if only and len({self.join([*named, *own]).tobytes() for own in few}) > 1:
                return []
            if few:
                return min(few, key=lambda own: int(self.join([*named, *own]).max()))
        return []

    def _many_rows(self, codes: np.ndarray) -> bool:
        return bool(codes.any()) and _ROWS_EACH * (int(codes.max()) + 1) <= len(codes)

    def _with_rough(self, chosen: Sequence[str], texts: Sequence[str]) -> list[str]:
        """Add texts within whose values the other columns go on more smoothly than across them."""
        found = list(chosen)
        for name in texts:
            codes = self.join(found)
            varies = name not in found and np.any(self.join([*found, name]) != codes)
            if varies and self._is_smoother(name, found):
                found.append(name)
        return found

    def _is_smoother(self, name: str, beside: Sequence[str]) -> bool:
        split, merged = self.join([*beside, name]), self.join(beside)
        if not self._many_rows(split):
            return False
        votes = []
        for values in self._numbers():
            alone, together = (self._step(values, codes) for codes in (split, merged))
            votes.append(alone < together)
        return bool(votes) and sum(votes) > len(votes) / 2

    def _numbers(self) -> list[np.ndarray]:
        names = [n for n in self.columns.names if n not in self.time.columns]
        columns = [self.columns.values[self.columns.names.index(n)] for n in names]
        return [v for v in columns if v.dtype.kind == "f" and len(np.unique(v)) > _ROWS_EACH]

    def _step(self, values: np.ndarray, codes: np.ndarray) -> float:
        """Give the usual change from one row to the next in time."""
        order = np.lexsort([self.time.within(codes), codes])
        steps, same = np.abs(np.diff(values[order])), np.diff(codes[order]) == 0
        there = steps[same & np.isfinite(steps)]
        return float(np.median(there)) if there.size else np.inf

    def fewest(self, texts: Sequence[str], codes: np.ndarray) -> list[str]:
        """Give the fewest columns that separate what is known to be apart."""
        for count in range(1, _MOST_TOGETHER + 1):
            for own in combinations(texts[: _MOST_TOGETHER * 4], count):
                if np.array_equal(self.join(own), codes):
                    return list(own)
        return []

    def is_whole(self, name: str) -> bool:
        """Whether a column holds whole numbers."""
        values = self.values(name)
        return values.dtype.kind == "f" and bool(
            np.isfinite(values).all() and np.all(values == np.round(values))
        )

    def has_few(self, name: str) -> bool:
        """Whether a column has several rows for each of its values."""
        values = self.values(name)
        if values.dtype.kind != "O" and not self.is_whole(name):
            return False
        return (int(self.codes(name).max()) + 1) * _ROWS_EACH <= len(values)

    def increases(self, codes: np.ndarray) -> bool:
        """Whether times increase from row to row within each trajectory."""
        t = self.time.within(codes)
        if np.all(np.diff(t) > 0):
            return True
        order = np.argsort(codes, kind="stable")
        steps, same = np.diff(t[order]), np.diff(codes[order]) == 0
        return bool(np.all(steps[same] > 0))

    def is_apart(self, codes: np.ndarray) -> bool:
        """Whether no time repeats within a trajectory, in whatever order its rows are."""
        t = self.time.within(codes)
        order = np.lexsort([t, codes])
        steps, same = np.diff(t[order]), np.diff(codes[order]) == 0
        return bool(np.all(steps[same] > 0))

    def is_constant(self, name: str, codes: np.ndarray, count: int) -> bool:
        """Whether a column has one value in each trajectory."""
        values = self.values(name)
        text = values.dtype.kind == "O"
        if text and not self.is_text(name):
            return False
        if not text and values.dtype.kind != "f":
            return False
        if count == 1:
            return text and len(set(values)) == 1
        first = values[np.unique(codes, return_index=True)[1]][codes]
        if text:
            return bool(np.all(values == first))
        return bool(np.all(np.abs(values - first) <= ROUNDED * np.abs(first)))

    def differs(self, name: str) -> bool:
        """Whether a column has more than one value."""
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
        return bool(is_label_name(name) or (alone and counts))

    def is_parameter(self, name: str) -> bool:
        """Whether numbers that help to distinguish trajectories may act in their equations too."""
        if self.is_text(name) or not self.is_whole(name) or is_label_name(name):
            return False
        own = np.unique(self.values(name))
        return not np.array_equal(own, np.arange(1, len(own) + 1))


def is_rough(values: np.ndarray) -> bool:
    """Whether values in order of time change as if several trajectories were put into one.

    Parameters
    ----------
    values : (n,) numbers; NaN where there is none.
    """
    there = values[np.isfinite(values)] if values.dtype.kind == "f" else values[:0]
    if len(there) < _ROWS_EACH or not np.ptp(there) > 0:
        return False
    return bool(np.mean(np.diff(there) ** 2) > 2 * _ROUGH * np.var(there))


def is_number(text: str) -> bool:
    """Whether a text is a number.

    Parameters
    ----------
    text : the text.
    """
    try:
        float(text)
    except ValueError:
        return False
    return True
