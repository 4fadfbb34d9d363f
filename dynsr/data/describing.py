"""Describing: what a table is taken for and what looks odd in it, without a search."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dynsr.arguments import checked
from dynsr.data.codes import Missing
from dynsr.data.description import Description
from dynsr.data.names import RENAMED
from dynsr.data.oddities import OddSettings, merge_places, odd_states, odd_times, odd_values
from dynsr.data.reading import MAX_ROWS, Table, read_trajectories
from dynsr.data.trajectory import FEWEST_ROWS, columns_of
from dynsr.errors import DynsrWarning, one_line

_SETTINGS = OddSettings()


@checked
def describe(
    source: Any,
    time: float | str | Sequence[Any] | np.ndarray | None = None,
    states: Sequence[str] | str | None = None,
    inputs: Sequence[str] | Mapping[str, str] | str | None = None,
    trajectory: Sequence[str] | str | None = None,
    *,
    quantity: str | None = None,
    decimal: str | None = None,
    missing: Missing | None = None,
    hold: Mapping[str, str] | str | None = None,
    noise: Mapping[str, Any] | None = None,
    doses: Mapping[str, str] | None = None,
    limits: Mapping[str, Any] | None = None,
    max_rows: int = MAX_ROWS,
    settings: OddSettings = _SETTINGS,
) -> Description:
    """Say how a table is understood, and what looks odd in it; nothing is searched.

    It is what :func:`dynsr.discover` would take the same table for, with the same arguments.

    Parameters
    ----------
    source : what :func:`dynsr.data.read_trajectories` reads: a file, a frame, a mapping of columns,
        arrays, a Trajectory, or a list of these.
    time, states, inputs, trajectory, quantity, decimal, missing, hold, noise, doses, limits,
        max_rows : as for :func:`dynsr.data.read_trajectories`.
    settings : the numbers that decide what looks odd.

    Raises InputError, one line that names the value and the remedy, when the table cannot be used.

    >>> t = np.linspace(0, 1, 11)
    >>> found = describe({"t": t, "x": t**2, "y": np.floor(2 * t)})
    >>> found.states, round(found.time.step, 6)
    (('x', 'y'), 0.1)
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", DynsrWarning)
        table = read_trajectories(
            source,
            time,
            states,
            inputs,
            trajectory,
            quantity=quantity,
            decimal=decimal,
            missing=missing,
            hold=hold,
            noise=noise,
            doses=doses,
            limits=limits,
            max_rows=max_rows,
        )
    heard = [one_line(w.message) for w in caught if issubclass(w.category, DynsrWarning)]
    return describe_table(table, heard, settings)


def describe_table(
    table: Table, heard: Sequence[str] = (), settings: OddSettings = _SETTINGS
) -> Description:
    """Say how a table that was read is understood, and what looks odd in it.

    Parameters
    ----------
    table : what :func:`dynsr.data.read_trajectories` gives.
    heard : what was warned of on reading it.
    settings : the numbers that decide what looks odd.
    """
    # The description shows the new names itself.
    own = [words for words in heard if not words.startswith(RENAMED)]
    notes = (*table.description.notes, *own, *_odd(table, settings))
    return replace(table.description, notes=tuple(dict.fromkeys(notes)))


def _odd(table: Table, settings: OddSettings) -> Iterator[str]:
    """Say what looks odd in the times and the states of a table."""
    found, count = table.description, len(table.trajectories)
    most = max(settings.looks // len(found.states), 1)
    picked = np.linspace(0, count - 1, min(count, most)).astype(int)
    runs = [(found.trajectories[i].name, table.trajectories[i]) for i in picked]
    # Many columns would else show by chance what no single one does.
    each = replace(settings, chance=settings.chance / (len(runs) * len(found.states)))
    clocks = [(name, odd) for name, run in runs for odd in odd_times(run.t, each, run.time_unit)]
    yield from merge_places(clocks, f"time {found.time.column!r}", count == 1)
    for state in found.states:
        seen = [
            (name, odd)
            for name, run in runs
            for odd in odd_values(run.t, run.observed[:, run.index(state)], each)
            if odd.kind != "mark"  # that was noted on reading
        ]
        yield from merge_places(seen, state, count == 1)
    full = [run.select(np.all(run.measured, axis=1)) for run in table.trajectories]
    if sum(map(len, full)) < FEWEST_ROWS:  # the states were measured at times of their own
        return
    together = columns_of(full)
    for _, sentence in odd_states({state: together[state] for state in found.states}, settings):
        yield (
            f"{sentence}, so that its equation follows from the others'; leave it out, or say that "
            "a sum does not change (--conserved)"
        )
