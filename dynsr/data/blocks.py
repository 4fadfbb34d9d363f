"""Blocks: times and quantities of each run in columns of their own, side by side."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynsr.data.amounts import is_missing
from dynsr.data.cells import read_columns
from dynsr.data.name_parts import NUMBERED, SAYING, bare_name, bracketed_unit
from dynsr.data.times import is_time_name, read_times, unit_in_name


@dataclass(frozen=True)
class Blocks:
    """Columns in blocks, each of which begins with a time.

    Parameters
    ----------
    columns : the columns of each block.
    names : what the columns of the first block are called, without what names the block; the time
        alone where each block has quantities of its own.
    runs : what names each block; () where each has quantities of its own.
    word : what the runs are called.
    """

    columns: tuple[tuple[int, ...], ...]
    names: tuple[str, ...]
    runs: tuple[str, ...]
    word: str = "run"

    @property
    def sentence(self) -> str:
        """What was found, behind "the table has"."""
        count = len(self.columns)
        if not self.runs:
            return f"{count} columns of times, each for the columns that follow it"
        many = ", ".join(self.runs[:6]) + (", ..." if len(self.runs) > 6 else "")
        return f"{count} runs side by side, called {self.word} {many}"


def find_blocks(names: Sequence[str], columns: Sequence[np.ndarray]) -> Blocks | None:
    """Find columns in blocks that each begin with a time; None where there are none.

    Parameters
    ----------
    names : one per column; "" for none.
    columns : one array (n,) each.

    Blocks of the same names are runs. So are those whose names have a word such as run and a
    number, a condition such as ``c0=0.5``, or the number that their time has too. Blocks whose
    names all differ are quantities that were measured at times of their own.

    >>> cells = [np.arange(3.0)] * 4
    >>> find_blocks(["t", "S", "t", "S"], cells).runs
    ('1', '2')
    >>> find_blocks(["t1", "S1", "t2", "S2"], cells).names
    ('t', 'S')
    >>> find_blocks(["t", "x1", "x2", "y"], cells) is None
    True
    """
    used = [j for j, name in enumerate(names) if name or not _is_empty(columns[j])]
    if len(used) < 4 or not all(names[j] for j in used):
        return None
    for patterns in (SAYING, (NUMBERED,)):
        found = [_split(names[j], patterns) for j in used]
        stems = [stem for stem, *_ in found]
        starts = [place for place, stem in enumerate(stems) if stem == stems[0]]
        sizes = {b - a for a, b in pairwise([*starts, len(used)])}
        if len(starts) < 2 or len(sizes) > 1 or not _is_time(stems[0]):
            continue
        size = sizes.pop()
        if size < 2:
            continue
        blocks = [range(start, start + size) for start in starts]
        places = tuple(tuple(used[place] for place in own) for own in blocks)
        if len({tuple(stems[place] for place in own) for own in blocks}) == 1:
            said = [[found[place][1:] for place in own] for own in blocks]
            labels = _labels(said, alike=NUMBERED in patterns)
            if labels is not None:
                word = said[0][-1][0] or "run"
                return Blocks(places, tuple(stems[:size]), labels, word)
    return _find_own_times(used, names, columns)


def _find_own_times(
    used: Sequence[int], names: Sequence[str], columns: Sequence[np.ndarray]
) -> Blocks | None:
    """Find quantities at times of their own: each time is before those that were measured then."""
    following = [*(bare_name(names[j]) for j in used[1:]), ""]
    tagged = [_tagged_time(bare_name(names[j]), f) for j, f in zip(used, following, strict=True)]
    first = tagged[0] or (bare_name(names[used[0]]) if _is_time(names[used[0]]) else "")
    called = [names[j] for j in used]
    starts = [
        p for p, name in enumerate(called) if first and (name == called[0] or tagged[p] == first)
    ]
    values = [name for p, name in enumerate(called) if p not in starts]
    times = [columns[used[place]] for place in starts]
    if len(starts) < 2 or starts[0] or len(set(values)) < len(values):
        return None
    ends = [*starts[1:], len(used)]
    if any(b - a < 2 for a, b in zip(starts, ends, strict=True)) or _are_equal(times):
        return None
    own_names = {called[place] for place in starts}
    units = set(map(bracketed_unit, own_names))
    if len(units) > 1 or (len(own_names) > 1 and not all(map(_rises, times))):
        return None
    own = tuple(tuple(used[a:b]) for a, b in zip(starts, ends, strict=True))
    unit = units.pop()
    return Blocks(own, (f"{first} [{unit}]" if unit else first,), ())


def _tagged_time(name: str, following: str) -> str:
    """Give the name of a time without a number or the name of the next column; "" for no time."""
    match = re.fullmatch(rf"(?i)(.+?)[\W_]+{re.escape(following)}", name) if following else None
    match = match or re.fullmatch(rf"(?i){re.escape(following)}[\W_]+(.+)", name)
    match = match or re.fullmatch(r"(.+?)[\W_]*\d+", name)
    return match[1] if match and is_time_name(match[1]) else ""


def _rises(column: np.ndarray) -> bool:
    """Whether numbers are in order; what is no number is not asked."""
    values = read_columns([column])[0].values
    return values.dtype.kind != "f" or bool(np.all(np.diff(values[np.isfinite(values)]) > 0))


def _split(name: str, patterns: Sequence[re.Pattern[str]]) -> tuple[str, str, str]:
    """Give the name of a column without that of its run, and the word and the name of the run."""
    for pattern in patterns:
        for own, unit in ((name, ""), (bare_name(name), bracketed_unit(name))):
            if match := pattern.fullmatch(own):
                stem = match["stem"].strip(" _.-([")
                word = match.groupdict().get("word") or ""
                return f"{stem} [{unit}]" if unit else stem, word, match["which"]
    return name, "", ""


def _labels(said: Sequence[Sequence[tuple[str, str]]], *, alike: bool) -> tuple[str, ...] | None:
    """Give the names of blocks, from the words and numbers in the names of their columns."""
    given = [{which for _, which in own if which} for own in said]
    words = {word.lower() for own in said for word, _ in own if word}
    if not any(given):
        return None if alike else tuple(str(number) for number in range(1, len(said) + 1))
    whole = all(len(own) == 1 for own in given) and len(words) <= 1
    if not whole or (alike and not all(which for own in said for _, which in own)):
        return None
    labels = tuple(next(iter(own)) for own in given)
    return labels if len(set(labels)) == len(labels) else None


def stack_blocks(
    blocks: Blocks, names: Sequence[str], columns: Sequence[np.ndarray], units: Sequence[str]
) -> tuple[list[str], list[np.ndarray], list[str]]:
    """Put blocks below each other; gives names, columns and units of the new table.

    Parameters
    ----------
    blocks : the columns of each.
    names, columns, units : as in the source.
    """
    rows = [
        np.array([not is_missing(cell) and str(cell).strip() != "" for cell in columns[own[0]]])
        for own in blocks.columns
    ]
    told = [units[j] if j < len(units) else "" for j in range(len(names))]
    first = blocks.columns[0]
    if blocks.runs:
        stacked = [
            _join([columns[own[k]][there] for own, there in zip(blocks.columns, rows, strict=True)])
            for k in range(len(first))
        ]
        label = np.repeat(np.array(blocks.runs, dtype=object), [there.sum() for there in rows])
        heads = [blocks.word, *blocks.names]
        return heads, [label, *stacked], ["", *(told[j] for j in first)]
    heads, own_units = list(blocks.names), [told[first[0]]]
    times = _join([columns[c[0]][r] for c, r in zip(blocks.columns, rows, strict=True)])
    stacked = [times]
    counts = [int(there.sum()) for there in rows]
    for place, own in enumerate(blocks.columns):
        for j in own[1:]:
            parts = [np.full(count, None, dtype=object) for count in counts]
            parts[place] = columns[j][rows[place]]
            heads.append(names[j])
            stacked.append(_join(parts))
            own_units.append(told[j])
    order = _order(times)
    return heads, [column[order] for column in stacked], own_units


def _order(times: np.ndarray) -> np.ndarray:
    """Give the rows in order of time, where the times can be read by themselves."""
    read = read_columns([times])[0].values
    found = read_times(read) if read.dtype.kind == "O" else None
    values = found.seconds if found is not None else read
    return np.argsort(values, kind="stable") if values.dtype.kind in "fmM" else np.arange(len(read))


def _join(parts: Sequence[np.ndarray]) -> np.ndarray:
    kinds = {part.dtype.kind for part in parts}
    alike = len(kinds) == 1 or kinds <= set("fiu")
    return np.concatenate(parts if alike else [part.astype(object) for part in parts])


def _is_time(name: str) -> bool:
    bare = re.sub(r"\s*[\[(].*", "", name).strip()
    return is_time_name(bare) or bool(unit_in_name(name))


def _is_empty(column: np.ndarray) -> bool:
    return all(is_missing(cell) or not str(cell).strip() for cell in column.tolist())


def _are_equal(columns: Sequence[np.ndarray]) -> bool:
    return all(column.tolist() == columns[0].tolist() for column in columns[1:])
