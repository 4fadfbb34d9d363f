"""Long tables: one column of numbers, and one that says which quantity each of them is."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynsr.data.columns import Columns
from dynsr.data.grouping import find_restarts, is_text, label_of
from dynsr.data.measurement_errors import is_error_name
from dynsr.data.name_parts import bare_name, is_label_name
from dynsr.data.time_columns import Times
from dynsr.errors import InputError

# A column of such a name says which quantity it is, whatever else there is.
_QUANTITY = re.compile(
    r"(variable|quantity|quantities|analyte|parameter|param|metabolite|compound|substance|chemical|"
    r"signal|measure|measurand|measurement|metric|observable|observed|channel|sensor|tag|_?field|dv_?name|"
    r"gr(ö|oe)(ß|ss)e|messgr(ö|oe)(ß|ss)e|kanal|stoff|merkmal|grandeur|magnitud|variable\w*)"
    r"([ _.-]?(id|name|type|code))?",
    re.IGNORECASE,
)
# So does one of these, where nothing else names runs.
_KIND = re.compile(
    r"(species|specie|type|kind|name|what|item|key|component|state|column|attribute|population|"
    r"element|molecule|protein|gene|taxon|organism|compartment|class|art|spezies|esp(è|e)ces?|"
    r"especies?|nom|nombre|typ|zustand|komponente|label)([ _.-]?(id|name))?",
    re.IGNORECASE,
)
# Names of runs: a letter or a word and a number.
_CODE = re.compile(
    r"[a-z]?\d+[a-z]?|[a-z]|(rep\w*|run|trial|exp\w*|batch|sample|group|control|ctrl)[\s_.-]*\w?\d*",
    re.IGNORECASE,
)
_MOST = 30
_UNIT = re.compile(r"units?|einheit(en)?|unit(é|e)s?|unidad(es)?", re.IGNORECASE)


@dataclass(frozen=True)
class Long:
    """A column that says which quantity each row is of.

    Parameters
    ----------
    quantity : the column.
    values : the columns of numbers.
    labels : the columns that name runs.
    unit : the column of the unit that goes with the quantity; None where there is none.
    again : the columns that only say again which quantity it is, such as its number.
    """

    quantity: str
    values: tuple[str, ...]
    labels: tuple[str, ...]
    unit: str | None = None
    again: tuple[str, ...] = ()


def find_quantity(
    columns: Columns,
    time: Times,
    candidates: Sequence[str],
    labels: Sequence[str] | None,
    states: Sequence[str] | None,
) -> tuple[Long | None, str]:
    """Find the column that says which quantity a row is of, by what it holds and is called.

    Parameters
    ----------
    columns : the columns of the source.
    time : its times.
    candidates : the columns that nobody gave a role.
    labels : the columns that the caller named for runs; None where guessed.
    states : the states that the caller named.

    There must be one more column of numbers. Every value must be there at the same times
    within each run, or the column must be called a quantity, have a unit next to it, or have the
    states asked for: each quantity is then measured at times of its own. Gives it, or None; and a
    sentence where it may be one but is not taken so.
    """
    look = _Look(columns, time)
    texts = [n for n in candidates if is_text(look.values(n))]
    for name in texts:
        count = len(set(look.keys(name)))
        if not 2 <= count <= _MOST or is_label_name(name) or count * 5 > len(time.values):
            continue
        unit = look.unit_of(name, texts)
        again = [n for n in look.of_each(name, candidates) if n not in (unit, *(labels or ()))]
        own = [n for n in candidates if n not in again]
        named = look.labels(name, unit, texts, candidates) if labels is None else list(labels)
        others = [n for n in named if n not in again]
        numbers = look.numbers([n for n in own if n not in others], others)
        measured = [n for n in numbers if not is_error_name(n)]
        wanted = states is not None and set(states) <= set(look.keys(name))
        strong = bool(_QUANTITY.fullmatch(bare_name(name))) or unit is not None or wanted
        if len(measured) != 1 or len(numbers) > 2:
            continue
        # What is called a quantity may have times of its own.
        if not (look.share_times(name, others) or (strong and look.is_once(name, others))):
            continue
        found = Long(name, tuple(numbers), tuple(others), unit, tuple(again))
        strong |= labels is not None and not look.apart(others)
        kind = _KIND.fullmatch(bare_name(name)) and not named
        codes = all(_CODE.fullmatch(key) for key in set(look.keys(name)))
        if strong or (kind and not codes):
            return found, ""
        if not codes:
            return None, (
                f"The values of {name!r} are there at the same times, so that they may be "
                f"quantities of one run and not runs; then say so (--quantity {name})."
            )
    return None, ""


def describe_long(
    columns: Columns,
    time: Times,
    quantity: str,
    candidates: Sequence[str],
    labels: Sequence[str] | None,
) -> Long:
    """Give the parts of a long table whose column of quantities is known.

    Parameters
    ----------
    columns, time, candidates, labels : as for :func:`find_quantity`.
    quantity : the column.

    Raises InputError when there is no other column of numbers.
    """
    look = _Look(columns, time)
    texts = [n for n in candidates if n != quantity and is_text(look.values(n))]
    unit = look.unit_of(quantity, texts)
    again = [n for n in look.of_each(quantity, candidates) if n not in (unit, *(labels or ()))]
    others = look.labels(quantity, unit, texts, candidates) if labels is None else list(labels)
    others = [n for n in others if n not in again]
    numbers = look.numbers([n for n in candidates if n not in (quantity, *others, *again)], others)
    if not numbers:
        raise InputError(
            f"{columns.label} has no column of numbers in addition to the quantity {quantity!r}; "
            "name another column"
        )
    return Long(quantity, tuple(numbers), tuple(others), unit, tuple(again))


def widen(columns: Columns, time: Times, long: Long) -> tuple[Columns, np.ndarray]:
    """Give every quantity a column of its own.

    Parameters
    ----------
    columns : the columns of the source.
    time : its times.
    long : which of them are what.

    Gives the columns, and the row of the source that each of their rows begins with; a quantity
    that is not there at a time is NaN, and one that is there more than once makes more rows.
    """
    look = _Look(columns, time)
    keys = np.array(look.keys(long.quantity))
    _, index = look.moments(long.labels)
    # The first row of a quantity at a moment, the second, and so on.
    which = [f"{i}\0{key}" for i, key in zip(index, keys, strict=True)]
    seen: dict[str, int] = {}
    repeat = np.zeros(len(keys), dtype=int)
    for row, own in enumerate(which):
        repeat[row] = seen.get(own, 0)
        seen[own] = repeat[row] + 1
    _, first, place = np.unique(
        np.column_stack([repeat, index]), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    if not repeat.any() and not time.daily:
        # The quantities of one run, whose times may differ, stand below each other.
        runs = look.runs(long.labels)
        order = np.lexsort([time.values[first], runs[first]])
    place = np.argsort(order)[place.reshape(-1)]
    rows = first[order]
    dropped = {long.quantity, *long.values, *long.again, *([long.unit] if long.unit else [])}
    kept = [n for n in columns.names if n not in dropped]
    names, values = list(kept), [look.values(n)[rows] for n in kept]
    units = {n: u for n, u in columns.units.items() if n not in dropped}
    limits = {n: own.select(rows) for n, own in columns.limits.items() if n not in dropped}
    single = len([n for n in long.values if not is_error_name(n)]) == 1
    for number in long.values:
        for key in dict.fromkeys(keys.tolist()):
            name = f"{number}_{key}"
            if single:
                name = f"{key}_sd" if is_error_name(number) else key
            own = keys == key
            column = np.full(len(rows), np.nan)
            column[place[own]] = look.values(number)[own]
            names.append(name if name not in names else f"{name}_{number}")
            values.append(column)
            if number in columns.limits:
                limits[names[-1]] = columns.limits[number].select(own).at(place[own], len(rows))
            if long.unit is not None:
                units[names[-1]] = label_of(look.values(long.unit)[own][0])
            elif number in columns.units:
                units[names[-1]] = columns.units[number]
    inputs = tuple(n for n in columns.inputs if n in names)
    wide = replace(
        columns,
        names=tuple(names),
        values=tuple(values),
        units=units,
        inputs=inputs,
        time_unit="",
        limits=limits,
    )
    return wide, rows


class _Look:
    """Looks at the columns of a long table."""

    def __init__(self, columns: Columns, time: Times) -> None:
        """Remember the columns."""
        self._columns, self._time = columns, time

    def values(self, name: str) -> np.ndarray:
        """Give the cells of a column."""
        return self._columns.values[self._columns.names.index(name)]

    def keys(self, name: str) -> list[str]:
        """Give the cells of a column as text."""
        return [label_of(cell) for cell in self.values(name).tolist()]

    def numbers(self, names: Sequence[str], labels: Sequence[str]) -> list[str]:
        """Give the columns of numbers that are not the same for all quantities of a moment."""
        found = [n for n in names if self.values(n).dtype.kind == "f"]
        _, index = self.moments(labels)
        first = np.unique(index, return_index=True)[1][index]
        if len(set(index.tolist())) == len(index):  # no two quantities share a moment
            return found
        return [n for n in found if np.any(self.values(n) != self.values(n)[first])]

    def unit_of(self, quantity: str, texts: Sequence[str]) -> str | None:
        """Give the column that has one value for each quantity and is called a unit."""
        called = [n for n in texts if n != quantity and _UNIT.fullmatch(bare_name(n))]
        return next((n for n in called if self._has_one_each(quantity, n)), None)

    def of_each(self, quantity: str, names: Sequence[str]) -> list[str]:
        """Give the columns that have one value for each quantity, and not the same for all."""
        found = [n for n in names if n != quantity and len(set(self.keys(n))) > 1]
        return [n for n in found if self._has_one_each(quantity, n)]

    def _has_one_each(self, quantity: str, name: str) -> bool:
        keys = self.keys(quantity)
        return len(set(zip(keys, self.keys(name), strict=True))) == len(set(keys))

    def labels(
        self, quantity: str, unit: str | None, texts: Sequence[str], candidates: Sequence[str]
    ) -> list[str]:
        """Give the columns that may name runs in addition to a quantity."""
        found = [n for n in texts if n not in (quantity, unit) and len(set(self.keys(n))) > 1]
        named = [n for n in candidates if n not in texts and is_label_name(n)]
        return [*found, *(n for n in named if len(set(self.keys(n))) * 5 <= len(self.keys(n)))]

    def moments(self, labels: Sequence[str]) -> tuple[list[str], np.ndarray]:
        """Number the moments of all runs."""
        parts = [self.keys(name) for name in labels]
        runs = ["\0".join(own) for own in zip(*parts, strict=True)] if parts else None
        t = self._time.values
        own = [
            f"{run}\0{when!r}" for run, when in zip(runs or [""] * len(t), t.tolist(), strict=True)
        ]
        names = list(dict.fromkeys(own))
        place = {name: i for i, name in enumerate(names)}
        return names, np.array([place[name] for name in own])

    def runs(self, labels: Sequence[str]) -> np.ndarray:
        """Number the runs that labels name, in order of appearance."""
        names = list(zip(*(self.keys(name) for name in labels), strict=True)) if labels else []
        place = {name: i for i, name in enumerate(dict.fromkeys(names))}
        return np.array([place[name] for name in names] or [0] * len(self._time.values))

    def share_times(self, quantity: str, labels: Sequence[str]) -> bool:
        """Whether every value of a column is there once at every moment of every run."""
        keys = np.array(self.keys(quantity))
        moments, index = self.moments(labels)
        every = sorted(set(keys.tolist()))
        sizes = {key: index[keys == key] for key in every}
        return all(
            len(own) == len(moments) and len(np.unique(own)) == len(moments)
            for own in sizes.values()
        )

    def is_once(self, quantity: str, labels: Sequence[str]) -> bool:
        """Whether no value of a column is there twice at a moment of a run."""
        _, index = self.moments(labels)
        pairs = set(zip(self.keys(quantity), index.tolist(), strict=True))
        return len(pairs) == len(index)

    def apart(self, labels: Sequence[str]) -> bool:
        """Whether no moment repeats within the runs."""
        moments, index = self.moments(labels)
        return len(moments) == len(index) or bool(find_restarts(self._time.values).any())
