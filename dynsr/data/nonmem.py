"""NONMEM: tables in which codes say whether a row is a dose, a measurement or one below a limit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dynsr.data.columns import Columns
from dynsr.data.limits import Limits
from dynsr.errors import InputError

# What kind a row is; which values are beyond a limit; what repeats a dose, or lengthens it.
_KINDS = ("evid", "mdv", "cmt")
_CENSORED = ("cens", "lloq", "uloq", "limit", "blq")
_REPEATS = ("addl", "ii")
_LASTING = ("rate", "ss")
# What numbers the quantity that was measured.
_QUANTITIES = ("dvid", "cmt")
_KIND = "says what kind a row is (NONMEM)"
_MOST_DOSES = 10_000


def find_nonmem(columns: Columns, label: str) -> dict[str, str]:
    """Give the columns of NONMEM that only say what kind a row is, with the reason.

    Parameters
    ----------
    columns : the columns of the source.
    label : what a message calls the source.

    There must be a column AMT. Raises InputError where infusions last for an unknown time, or doses
    are in a steady state.
    """
    table = _Table.of(columns)
    if table is None:
        return {}
    rate = table.numbers("rate")
    for key, values in (("rate", np.minimum(rate, 0.0)), ("ss", table.numbers("ss"))):
        if np.any(values != 0):
            row = int(np.flatnonzero(values)[0])
            raise InputError(
                f"column {table.named[key]!r} of {label} is {values[row]:g} in row {row + 1}: "
                "doses are read one row each; write a row for each dose, and an infusion with its "
                "rate"
            )
    codes = [key for key in (*_KINDS, *_REPEATS, *_LASTING) if key in table.named]
    codes = [key for key in codes if key != "rate" or not np.any(rate)]
    found = {table.named[key]: _KIND for key in codes}
    if table.quantity:
        found[table.named[table.quantity]] = "says which quantity a row is of (NONMEM)"
    if "cens" in table.named:
        limits = [table.named[key] for key in _CENSORED if key in table.named]
        found |= dict.fromkeys(limits, "says which values are beyond a limit (NONMEM)")
    return found


def read_nonmem(columns: Columns) -> Columns:
    """Give a table of NONMEM as its codes say; any other table as it is.

    Parameters
    ----------
    columns : the columns of the source.

    A value in a row of a dose was not measured. One that is censored is below, or above, its
    limit. A dose that is given again has a row for each time. Values of several quantities, by the
    numbers in ``DVID`` or ``CMT``, get a column each. A dose with a rate is an infusion: ``RATE``
    is then an input, which keeps its value until the amount is given.

    >>> names = ("ID", "TIME", "AMT", "DV", "MDV", "CENS")
    >>> rows = [[1, 0, 10, 0, 1, 0], [1, 1, 0, 4, 0, 0], [1, 2, 0, 2, 0, 1]]
    >>> found = read_nonmem(Columns(names, tuple(np.array(rows, float).T), "pk.csv"))
    >>> found.values[3], found.limits["DV"].below
    (array([nan,  4., nan]), array([nan, nan,  2.]))
    """
    table = _Table.of(columns)
    return columns if table is None else _apart(_with_infusions(_with_repeats(table.measured())))


@dataclass(frozen=True, eq=False)
class _Table:
    """A table of NONMEM: its columns, and what each is called, by its name in small letters."""

    columns: Columns
    named: Mapping[str, str]

    @classmethod
    def of(cls, columns: Columns) -> _Table | None:
        """Give the table; None for another one."""
        named = {name.lower(): name for name in columns.names}
        nonmem = "amt" in named and set(named) & {"evid", "mdv"}
        return cls(columns, named) if nonmem else None

    def numbers(self, key: str, nothing: float = 0.0) -> np.ndarray:
        """(n,) numbers of a column, and something else where there is none."""
        name = self.named.get(key)
        values = None if name is None else self.columns.values[self.columns.names.index(name)]
        if values is None or values.dtype.kind != "f":
            return np.full(len(self.columns.values[0]), nothing)
        return np.where(np.isfinite(values), values, nothing)

    @property
    def quantity(self) -> str:
        """The column that numbers the quantities, where several were measured; "" for none."""
        there = np.isfinite(self.numbers("dv", np.nan)) & (self.numbers("evid") == 0)
        there &= self.numbers("mdv") == 0
        several = (key for key in _QUANTITIES if len(set(self.numbers(key)[there].tolist())) > 1)
        return next(several, "")

    def measured(self) -> Columns:
        """Give the columns without values in rows of doses, and with the limits of others."""
        columns, name = self.columns, self.named.get("dv", "")
        unmeasured, dose = self.numbers("mdv") != 0, self.numbers("evid") != 0
        dose = dose if "evid" in self.named else unmeasured & (self.numbers("amt") != 0)
        by_name = dict(zip(columns.names, columns.values, strict=True))
        amounts = by_name[self.named["amt"]]
        if amounts.dtype.kind == "f" and dose.any():
            # 0 in a row of a measurement is no amount; whether there are others decides what the
            # column is.
            by_name[self.named["amt"]] = np.where(dose | (amounts != 0), amounts, np.nan)
        limits = dict(columns.limits)
        if name and by_name[name].dtype.kind == "f":
            unmeasured |= dose
            x, side = by_name[name], np.where(unmeasured, 0, self.numbers("cens"))
            if side.any():
                own = limits.get(name, Limits.none(len(x)))
                below, above = np.where(side > 0, x, own.below), np.where(side < 0, x, own.above)
                limits[name] = Limits(below, above)
            by_name[name] = np.where(unmeasured | (side != 0), np.nan, x)
        return replace(columns, values=tuple(by_name.values()), limits=limits)


def _with_repeats(columns: Columns) -> Columns:
    """Give a row to each time at which a dose is given again, ``ADDL`` times after ``II`` each."""
    import pandas

    table = _Table.of(columns)
    assert table is not None
    more, between = table.numbers("addl"), table.numbers("ii")
    rows = np.flatnonzero((more > 0) & (between > 0))
    if not rows.size or "time" not in table.named or np.sum(more[rows]) > _MOST_DOSES:
        return columns
    again = np.repeat(rows, more[rows].astype(int))
    turns = np.concatenate([np.arange(1, int(count) + 1) for count in more[rows]])
    every = np.concatenate([np.arange(len(more)), again])
    pairs = zip(columns.names, columns.values, strict=True)
    by_name = {name: own[every] for name, own in pairs}
    times = by_name[table.named["time"]]
    if times.dtype.kind != "f":
        return columns
    times[len(more) :] += turns * between[again]
    subject = by_name[table.named["id"]] if "id" in table.named else 0 * times
    order = pandas.factorize(subject)[0]
    # A measurement at the time of a dose that has no row of its own was taken before it.
    place = np.lexsort((np.arange(len(every)) >= len(more), times, order))
    limits = {name: own.select(every[place]) for name, own in columns.limits.items()}
    return replace(columns, values=tuple(own[place] for own in by_name.values()), limits=limits)


def _with_infusions(columns: Columns) -> Columns:
    """Give the rate of the infusions that run at each row, and a row to the end of each."""
    import pandas

    table = _Table.of(columns)
    assert table is not None
    rate, amount, times = table.numbers("rate"), table.numbers("amt"), table.numbers("time", np.nan)
    rows = np.flatnonzero((rate > 0) & (amount > 0) & np.isfinite(times))
    if not rows.size:
        return columns
    ends = times[rows] + amount[rows] / rate[rows]
    every = np.concatenate([np.arange(len(rate)), rows])
    by_name = {n: own[every] for n, own in zip(columns.names, columns.values, strict=True)}
    when = np.concatenate([times, ends])
    subject = by_name[table.named["id"]] if "id" in table.named else 0 * when
    who = pandas.factorize(subject)[0]
    begun = (who[:, None] == who[rows]) & (when[:, None] >= times[rows])
    running = begun & (when[:, None] < ends)
    name, own = table.named["rate"], table.named["amt"]
    by_name[table.named["time"]], by_name[name] = when, running @ rate[rows]
    given = np.isin(np.arange(len(every)), [*rows, *range(len(rate), len(every))])
    by_name[own] = np.where(given, np.nan, by_name[own])
    place = np.lexsort((when, who))
    return replace(
        columns,
        values=tuple(cells[place] for cells in by_name.values()),
        limits={n: limit.select(every[place]) for n, limit in columns.limits.items()},
        inputs=(*columns.inputs, name),
    )


def _apart(columns: Columns) -> Columns:
    """Give each quantity a column of its own, called by its number."""
    table = _Table.of(columns)
    assert table is not None
    if not table.quantity:
        return columns
    name, which = table.named["dv"], table.numbers(table.quantity)
    by_name = dict(zip(columns.names, columns.values, strict=True))
    x, own = by_name.pop(name), columns.limits.get(name)
    known = np.isfinite(x) | (False if own is None else own.there)
    limits = {n: one for n, one in columns.limits.items() if n != name}
    for number in np.unique(which[known]):
        new, here = f"{name}_{number:g}", known & (which == number)
        by_name[new] = np.where(here, x, np.nan)
        if own is not None and np.any(own.there & here):
            limits[new] = own.where(here)
    return replace(columns, names=tuple(by_name), values=tuple(by_name.values()), limits=limits)
