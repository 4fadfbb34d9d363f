"""Replicates: runs in columns side by side are put below each other."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynsr.data.columns import Columns
from dynsr.data.limits import Limits
from dynsr.data.lines import last_digit
from dynsr.data.name_parts import (
    CONDITIONS,
    FEWEST_WELLS,
    LETTERED,
    NUMBERED,
    SAYING,
    WELL,
    bare_name,
    bracketed_unit,
)

_FEWEST = 8
# Copies differ by less than this share of how far they move, and the difference of one row tells
# little of the next: half its mean squared step over its variance is 1 for independent values.
_ALIKE = 0.3
_WHITE = 0.5
# Last digits that a summary moves by at least, so that nothing else is taken for one.
_DIGITS = 20


@dataclass(frozen=True)
class SideBySide:
    """Columns of the same quantities, once for each run.

    Parameters
    ----------
    word : what the runs are called; "" where only numbers distinguish them.
    members : name of a run -> quantity -> its column.
    given : whether the word is a condition of the runs, whose names are its values.
    """

    word: str
    members: Mapping[str, Mapping[str, str]]
    given: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """All the columns."""
        return tuple(name for own in self.members.values() for name in own.values())

    @property
    def stems(self) -> tuple[str, ...]:
        """The quantities."""
        return tuple(next(iter(self.members.values())))


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore")
def find_replicates(columns: Columns, names: Sequence[str]) -> SideBySide | None:
    """Find columns that are the same quantities in several runs; None where there are none.

    Parameters
    ----------
    columns : the columns of the source.
    names : those that may be so.

    Each run must have the same quantities. Names with a word such as rep, run or trial and a number
    say it, or with a condition such as ``c0=0.5``; so do six names of wells of a plate. With a
    number or a letter alone they do where the columns are copies of each other within noise.
    """
    numbers = [n for n in names if columns.values[columns.names.index(n)].dtype.kind == "f"]
    for pattern in SAYING:
        found = _arrange(numbers, pattern)
        if found is not None:
            return found
    wells = _arrange(numbers, WELL)
    if wells is not None and len(wells.members) >= FEWEST_WELLS:
        return replace(wells, word="well")
    for pattern in (NUMBERED, LETTERED):
        found = _arrange(numbers, pattern)
        if found is not None and _are_copies(columns, found):
            return found
    return None


def _arrange(names: Sequence[str], pattern: re.Pattern[str]) -> SideBySide | None:
    members: dict[str, dict[str, str]] = {}
    words: list[str] = []
    for name in names:
        own, unit = (name, "") if pattern.fullmatch(name) else (bare_name(name), "")
        if own != name:
            unit = bracketed_unit(name)
        match = pattern.fullmatch(own)
        if match is None:
            continue
        stem = match["stem"].strip(" _.-([") or "x"
        which = match["which"] if pattern is WELL else match["which"].lower()
        run = members.setdefault(which, {})
        if stem in run:
            return None
        run[f"{stem} [{unit}]" if unit else stem] = name
        words.append(match.groupdict().get("word") or "")
    same = len({tuple(sorted(own)) for own in members.values()}) == 1
    if len(members) < 2 or not same or len(set(map(str.lower, words))) > 1:
        return None
    first = list(next(iter(members.values())))
    return SideBySide(
        words[0] if pattern in CONDITIONS else words[0].lower(),
        {run: {s: own[s] for s in first} for run, own in members.items()},
        pattern in CONDITIONS,
    )


def _are_copies(columns: Columns, found: SideBySide) -> bool:
    if len(columns.values[0]) < _FEWEST:
        return False
    by_name = dict(zip(columns.names, columns.values, strict=True))
    for stem in found.stems:
        table = np.column_stack([by_name[own[stem]] for own in found.members.values()])
        table = table[np.isfinite(table).all(axis=1)]
        if len(table) < _FEWEST:
            return False
        mean = table.mean(axis=1, keepdims=True)
        off = table - mean
        # One of several follows from the others.
        noise = float(np.sum(off**2)) / (len(table) * (table.shape[1] - 1))
        if not 0 < noise < _ALIKE**2 * float(np.var(mean)):
            return False
        steps = float(np.mean(np.diff(off, axis=0) ** 2))
        if steps < 2 * _WHITE * float(np.mean(off**2)):
            return False
    return True


def find_summaries(columns: Columns, found: SideBySide, names: Sequence[str]) -> dict[str, str]:
    """Give the columns that are the mean or the standard deviation of the runs, with the reason.

    Parameters
    ----------
    columns : the columns of the source.
    found : the columns of the runs.
    names : those that may be so.

    >>> columns = Columns(("a1", "a2", "m"), tuple(np.array([[0, 90], [2, 94], [1, 92.0]])), "")
    >>> find_summaries(columns, SideBySide("", {"1": {"a": "a1"}, "2": {"a": "a2"}}), ["m"])
    {'m': 'is the mean of a1, a2'}
    """
    by_name = dict(zip(columns.names, columns.values, strict=True))
    said: dict[str, str] = {}
    numbers = [name for name in names if by_name[name].dtype.kind == "f"]
    digits = {name: last_digit(_finite(by_name[name])) for name in numbers}
    for stem in found.stems:
        own = [member[stem] for member in found.members.values()]
        table = np.column_stack([by_name[name] for name in own])
        spread = np.std(table, axis=1, ddof=1)
        # A mean of cells that were rounded is off by as much as they are.
        rounded = max(last_digit(_finite(by_name[name])) for name in own)
        for kind, made in (
            ("mean", table.mean(axis=1)),
            ("standard deviation", spread),
            ("standard deviation", np.std(table, axis=1)),
            ("standard error", spread / np.sqrt(table.shape[1])),
        ):
            for name in numbers:
                values = by_name[name]
                if name in said:
                    continue
                there = np.isfinite(values - made)
                digit = rounded + digits[name]
                # Where they move by few digits, other columns would be as close.
                moves = there.any() and np.ptp(made[there]) > _DIGITS * digit
                if moves and np.all(np.abs(values - made)[there] <= digit):
                    said[name] = f"is the {kind} of {', '.join(own)}"
    return said


def _finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def stack_replicates(columns: Columns, found: SideBySide) -> tuple[Columns, np.ndarray, str]:
    """Put runs in columns side by side below each other.

    Parameters
    ----------
    columns : the columns of the source.
    found : the columns of the runs.

    Gives the columns, the row of the source that each of their rows has, and the name of the new
    column that names the run.
    """
    count, rows = len(found.members), len(columns.values[0])
    label = found.word or "replicate"
    while label in (*columns.names, *found.stems):
        label = f"{label}_"
    by_name = dict(zip(columns.names, columns.values, strict=True))
    source = np.tile(np.arange(rows), count)
    kept = [n for n in columns.names if n not in found.columns]
    names = [*kept, label, *found.stems]
    values = [by_name[name][source] for name in kept]
    called: list[Any] = list(found.members)
    if found.given:
        called = [float(which.replace(",", ".")) for which in called]
    values.append(np.repeat(np.array(called, dtype=float if found.given else object), rows))
    values += [
        np.concatenate([by_name[own[stem]] for own in found.members.values()])
        for stem in found.stems
    ]
    units = {**columns.units}
    for own in found.members.values():
        units |= {s: columns.units[n] for s, n in own.items() if n in columns.units}
    limits = {n: columns.limits[n].select(source) for n in kept if n in columns.limits}
    none = Limits.none(rows)
    for stem in found.stems:
        members = [own[stem] for own in found.members.values()]
        if set(members) & set(columns.limits):
            limits[stem] = Limits.join([columns.limits.get(n, none) for n in members])
    return (
        replace(columns, names=tuple(names), values=tuple(values), units=units, limits=limits),
        source,
        label,
    )
