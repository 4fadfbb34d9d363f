"""Replicates: runs in columns side by side are put below each other."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynsr.data.columns import Columns
from dynsr.data.limits import Limits
from dynsr.data.lines import last_digit
from dynsr.data.measurement_errors import is_error_word
from dynsr.data.name_parts import (
    BEFORE,
    BEHIND,
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
# The names that tables give to columns of one name.
_COPY = re.compile(r"(?P<name>.+)(?P<mark>[._])(?P<number>\d+)")
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
    given : the values of the condition that the word is, one for each run; None for another word.
    """

    word: str
    members: Mapping[str, Mapping[str, str]]
    given: tuple[float, ...] | None = None

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
    say it, or with a condition such as ``c0=0.5``, of which there may be several runs; so do six
    names of wells of a plate. With a number or a letter alone they do where the columns are copies
    of each other within noise; so do columns that are all called the same.
    """
    numbers = [n for n in names if columns.values[columns.names.index(n)].dtype.kind == "f"]
    copies = _find_copies(numbers)
    for condition in CONDITIONS:
        found = _arrange_given(numbers, condition, copies)
        if found is not None:
            return found
    for pattern in SAYING:
        found = _arrange(numbers, pattern)
        if found is not None:
            return found
    wells = _arrange(numbers, WELL)
    if wells is not None and len(wells.members) >= FEWEST_WELLS:
        return replace(wells, word="well")
    same = [n for n in numbers if n in copies or any(n == own for own, _ in copies.values())]
    parts = [(n, *copies.get(n, (n, "1")), "") for n in same if not is_error_word(n)]
    for found in (_of_runs(parts), _arrange(numbers, NUMBERED), _arrange(numbers, LETTERED)):
        if found is not None and _are_copies(columns, found):
            return found
    return None


def _find_copies(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Give the columns that have the name of another with a number, as readers of tables add it.

    These are ``x_2, x_3``, or ``x.1, x.2`` as pandas writes them, next to ``x``.
    """
    found = {name: match for name in names if (match := _COPY.fullmatch(name))}
    return {
        name: (match["name"], str(int(match["number"]) + (match["mark"] == ".")))
        for name, match in found.items()
        if match["name"] in names
    }


def _arrange_given(
    names: Sequence[str], pattern: re.Pattern[str], copies: Mapping[str, tuple[str, str]]
) -> SideBySide | None:
    """Arrange columns by the condition in their names and the run that they add to it."""
    parts, given = [], {}
    for name in names:
        own, which = copies.get(name, (name, ""))
        if repeat := BEHIND.fullmatch(own) or BEFORE.fullmatch(own):
            own, which = repeat["stem"].strip(), repeat["which"]
        if (split := _split(own, pattern)) is None:
            continue
        stem, value, word = split
        run = f"{value} ({which})" if which and which != "1" else value
        given[run] = float(value.replace(",", "."))
        parts.append((name, stem, run, word))
    found = _of_runs(parts)
    return None if found is None else replace(found, given=tuple(given[r] for r in found.members))


def _arrange(names: Sequence[str], pattern: re.Pattern[str]) -> SideBySide | None:
    """Arrange columns by what their names say of the run."""
    split = ((name, _split(name, pattern)) for name in names)
    return _of_runs([(name, own[0], own[1], own[2].lower()) for name, own in split if own])


def _split(name: str, pattern: re.Pattern[str]) -> tuple[str, str, str] | None:
    """Give the quantity that a column is, its run, and what its runs are called."""
    own = name if pattern.fullmatch(name) else bare_name(name)
    match = pattern.fullmatch(own)
    if match is None:
        return None
    unit = "" if own == name else bracketed_unit(name)
    stem = match["stem"].strip(" _.-([") or "x"
    which = match["which"] if pattern is WELL else match["which"].lower()
    return f"{stem} [{unit}]" if unit else stem, which, match.groupdict().get("word") or ""


def _of_runs(parts: Sequence[tuple[str, str, str, str]]) -> SideBySide | None:
    """Put columns together; None unless each run has the same quantities, and all have one word.

    Parameters
    ----------
    parts : column, quantity, run and word of each.
    """
    members: dict[str, dict[str, str]] = {}
    for name, stem, run, _ in parts:
        if stem in members.setdefault(run, {}):
            return None
        members[run][stem] = name
    same = len({tuple(sorted(own)) for own in members.values()}) == 1
    if len(members) < 2 or not same or len({word.lower() for *_, word in parts}) > 1:
        return None
    first = list(next(iter(members.values())))
    in_order = {run: {s: own[s] for s in first} for run, own in members.items()}
    return SideBySide(parts[0][-1], in_order)


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
    called = np.array(found.given or list(found.members), float if found.given else object)
    values.append(np.repeat(called, rows))
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
