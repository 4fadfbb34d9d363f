"""Rows: those of each trajectory in order of time, with repeated ones averaged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dynsr.data.grouping import Grouping, is_rough
from dynsr.data.ticks import RARE, spread_ticks
from dynsr.errors import InputError

# Times written with few digits differ in their last one.
_UNEVEN = 0.1


@dataclass(frozen=True, eq=False)
class Run:
    """The rows of one trajectory.

    Parameters
    ----------
    name : that of the trajectory.
    rows : (n,) its rows in the source, in order of time.
    t : (n,) times.
    values : column -> (n,) numbers.
    spreads : column -> standard deviation of the rows of one time around their mean, where times
        repeat, with the degrees of freedom that it has.
    """

    name: str
    rows: np.ndarray
    t: np.ndarray
    values: Mapping[str, np.ndarray]
    spreads: Mapping[str, tuple[float, int]] = field(default_factory=dict)

    def at(self, kept: np.ndarray) -> Run:
        """Give some of its rows."""
        values = {name: own[kept] for name, own in self.values.items()}
        return Run(self.name, self.rows[kept], self.t[kept], values, self.spreads)


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore")
def order_rows(
    grouping: Grouping,
    t: np.ndarray,
    values: Mapping[str, np.ndarray],
    states: Sequence[str],
    time: str,
    label: str,
    summed: Sequence[str] = (),
    held: Sequence[str] = (),
) -> tuple[list[Run], list[str]]:
    """Give the rows of each trajectory in order of time, and sentences on what was done.

    Parameters
    ----------
    grouping : the trajectories.
    t : (n,) times.
    values : column -> (n,) numbers, NaN where there is none.
    states : the columns that move on their own.
    time, label : what a message calls the times and the source.
    summed : columns whose rows of one time are added up, as amounts are.
    held : columns that hold their value and step: of the rows of one time, as programs of models
        write them before and after a step, the last one counts.

    Rows of the same time are averaged, unless the clock is a coarse one, which is
    :func:`dynsr.data.ticks.spread_ticks`. Raises InputError where a single time is wrong, and where
    rows out of order may be those of several trajectories.
    """
    runs, notes = [], []
    moved = repeated = 0
    t, said = _without_ticks(grouping, t, [values[name] for name in states], time)
    notes += said
    for name, rows in grouping.rows():
        what = f"time {time!r}" + (f" of trajectory {name}" if len(grouping.names) > 1 else "")
        steps = np.diff(t[rows])
        if np.any(steps <= 0):
            _check_single(t, rows, what, label)
        if np.any(steps < 0):
            if not grouping.trajectory:
                _check_together(t, rows, [values[s] for s in states], what, label)
            rows = rows[np.argsort(t[rows], kind="stable")]
            moved += 1
        run = Run(name, rows, t[rows], {n: own[rows] for n, own in values.items()})
        if np.any(np.diff(run.t) == 0):
            run = _average(run, summed, held)
            repeated += 1
        runs.append(run)
    if moved:
        which = "The rows" if len(runs) == 1 else f"The rows of {moved} of {len(runs)} trajectories"
        notes.append(f"{which} were put in order of {time!r}.")
    if repeated:
        notes += _report_repeats(grouping, t, runs, values, states, time)
        if not any(pooled_noise(runs, states).values()):
            runs = [replace(run, spreads={}) for run in runs]
    return runs, notes


def _without_ticks(
    grouping: Grouping, t: np.ndarray, moving: Sequence[np.ndarray], time: str
) -> tuple[np.ndarray, list[str]]:
    """Give rows between which a coarse clock does not move on the times that they have."""
    found, steps = t.copy(), []
    for _, rows in grouping.rows():
        if not np.any(np.diff(t[rows]) == 0):
            continue
        own = spread_ticks(t[rows], [values[rows] for values in moving])
        if own is None:  # what one trajectory repeats are replicates in all
            return t, []
        found[rows] = own
        steps.append(float(own[1] - own[0]))
    if not steps:
        return t, []
    note = (
        f"Rows of one time of {time!r} go on from each other, so its clock is a coarse one: they "
        f"were taken for even ones, every {steps[0]:.4g}."
    )
    return found, [note]


def _check_single(t: np.ndarray, rows: np.ndarray, what: str, label: str) -> None:
    """Refuse a time that does not fit between its neighbours while all others do."""
    own = t[rows]
    steps = np.diff(own)
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    bad = np.flatnonzero(steps <= 0) + 1
    if not all(_is_single(own, i, usual) or _is_single(own, i - 1, usual) for i in bad.tolist()):
        return
    here, row = own[bad[0] - 1], rows[bad[0]]
    more = f" and {len(bad) - 1} more" if len(bad) > 1 else ""
    if own[bad[0]] == here:
        raise InputError(
            f"{what} repeats in row {row + 1} of {label} ({here:g} twice){more} and the next step "
            "is longer; correct that time, or leave the row out"
        )
    raise InputError(
        f"{what} runs backwards at row {row + 1} of {label} ({here:g} then {t[row]:g}){more}; "
        "correct that time, or leave the row out"
    )


def _is_single(t: np.ndarray, cell: int, usual: float) -> bool:
    """Whether a cell is wrong: its neighbours are two steps apart and it is not between them."""
    if not 0 < cell < len(t) - 1:
        return False
    before, after = t[cell - 1], t[cell + 1]
    return abs(after - before - 2 * usual) <= _UNEVEN * usual and not before < t[cell] < after


def _check_together(
    t: np.ndarray, rows: np.ndarray, moving: Sequence[np.ndarray], what: str, label: str
) -> None:
    """Refuse rows out of order that may be those of several trajectories."""
    own = t[rows]
    steps = np.diff(own)
    if np.all(steps <= 0):
        return
    order = rows[np.argsort(own, kind="stable")]
    if len(np.unique(own)) == len(own) and not any(is_rough(values[order]) for values in moving):
        return
    back = int(np.flatnonzero(steps < 0)[0])
    raise InputError(
        f"{what} runs backwards at row {rows[back + 1] + 1} of {label} ({own[back]:g} then "
        f"{own[back + 1]:g}) and nothing says which rows belong together; name the columns that "
        "distinguish trajectories (--trajectory), or correct that time"
    )


def _average(run: Run, summed: Sequence[str], held: Sequence[str]) -> Run:
    """Average rows of the same time, with their spread; amounts are added up."""
    times, index = np.unique(run.t, return_inverse=True)
    values: dict[str, np.ndarray] = {}
    spreads: dict[str, tuple[float, int]] = {}
    for name, own in run.values.items():
        there = np.isfinite(own)
        if name in held:
            values[name] = np.full(len(times), np.nan)
            values[name][index[there]] = own[there]  # the last of several
            continue
        number = np.bincount(index[there], minlength=len(times))
        sums = np.bincount(index[there], own[there], minlength=len(times))
        if name in summed:
            values[name] = sums.astype(float)
            continue
        with np.errstate(invalid="ignore", divide="ignore"):
            means = sums / number
        freedom = int(np.sum(np.maximum(number - 1, 0)))
        squares = float(np.sum((own[there] - means[index[there]]) ** 2))
        if freedom:
            spreads[name] = (float(np.sqrt(squares / freedom)), freedom)
        values[name] = means
    first_rows = np.searchsorted(run.t, times)
    return Run(run.name, run.rows[first_rows], times, values, spreads)


def _report_repeats(
    grouping: Grouping,
    t: np.ndarray,
    runs: Sequence[Run],
    values: Mapping[str, np.ndarray],
    states: Sequence[str],
    time: str,
) -> list[str]:
    noise = pooled_noise(runs, states)
    often = sum(len(rows) for _, rows in grouping.rows()) - sum(len(run.t) for run in runs)
    rows, were = ("1 row", "was") if often == 1 else (f"{often} rows", "were")
    place = f" ({_first_repeated(grouping, t):g})" if often == 1 else ""
    if not any(run.spreads for run in runs):
        return [
            f"{rows} had other columns filled than the row of the same time{place} and {were} put "
            "together with it."
        ]
    if not any(noise.values()):
        return [
            f"{rows} {'is a copy' if often == 1 else 'are copies'} of the row of the same time"
            f"{place} and {were} left out."
        ]
    spread = ", ".join(f"{name} {size:.3g}" for name, size in noise.items())
    notes = [
        f"{rows} {'repeats' if often == 1 else 'repeat'} a time of {time!r}{place} and {were} "
        f"averaged with it as replicates of one moment; their standard deviation is the noise: "
        f"{spread}."
    ]
    ordered = [name for name in states if _is_ordered(grouping, t, values[name])]
    if ordered and any(noise.values()):
        notes.append(
            f"Of rows of one time the first is nearly always higher, or lower, in {ordered[0]!r}: "
            "where they are of several trajectories, name the column that distinguishes them "
            "(--trajectory); where the clock is only coarse, give finer times."
        )
    return notes


def _first_repeated(grouping: Grouping, t: np.ndarray) -> float:
    """Give the first time that is there twice in a trajectory."""
    order = np.lexsort([t, grouping.codes])
    again = (np.diff(t[order]) == 0) & (np.diff(grouping.codes[order]) == 0)
    return float(t[order][1:][again][0])


def pooled_noise(runs: Sequence[Run], names: Sequence[str]) -> dict[str, float]:
    """Give the standard deviation of rows of one time, over all trajectories.

    Parameters
    ----------
    runs : the trajectories.
    names : the columns.
    """
    found = {}
    for name in names:
        parts = [run.spreads[name] for run in runs if name in run.spreads]
        freedom = sum(count for _, count in parts)
        if freedom:
            found[name] = float(np.sqrt(sum(s**2 * count for s, count in parts) / freedom))
    return found


def _is_ordered(grouping: Grouping, t: np.ndarray, values: np.ndarray) -> bool:
    """Whether rows of one time go on from each other as rows of several times would."""
    signs = []
    for _, rows in grouping.rows():
        own = rows[np.argsort(t[rows], kind="stable")]
        again = np.diff(t[own]) == 0
        signs.append(np.sign(np.diff(values[own])[again]))
    every = np.concatenate(signs)
    every = every[np.isfinite(every) & (every != 0)]
    return bool(len(every) and abs(np.sum(every)) > RARE * np.sqrt(len(every)))
