"""Understanding: what the columns of a source mean, step by step, until they are trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dynsr.data.calendars import join_calendar, unroll_months
from dynsr.data.columns import Columns
from dynsr.data.dosing import Dosing, split_after_doses
from dynsr.data.grouping import Grouping, guess_grouping
from dynsr.data.holding import HOLDS
from dynsr.data.known_noise import KnownNoise, check_noise
from dynsr.data.levels import find_levels
from dynsr.data.limits import Limits, Range, limit_cells
from dynsr.data.long_tables import describe_long, find_quantity, widen
from dynsr.data.name_parts import bracketed_unit
from dynsr.data.names import clean_name, find_column
from dynsr.data.nonmem import find_nonmem, read_nonmem
from dynsr.data.replicates import find_replicates, find_summaries, stack_replicates
from dynsr.data.roles import Roles, guess_roles
from dynsr.data.rows import Run, order_rows, pooled_noise
from dynsr.data.steps import between_rows, hold_on, is_noted_at_changes, is_set
from dynsr.data.table_checks import check_infinite, check_values, thin, to_numbers
from dynsr.data.time_columns import Times, find_time, in_seconds_or_units
from dynsr.data.trajectory import FEWEST_ROWS, Trajectory
from dynsr.data.turning import turn_rows
from dynsr.errors import InputError
from dynsr.expression import compile_numpy, parse

# The two sides of a limit.
_SIDES = ("below", "above")


@dataclass(frozen=True)
class Asked:
    """What the caller said of the columns; None where it is guessed.

    Parameters
    ----------
    states, inputs, trajectory : names in the source or in formulas.
    formulas : inputs that are expressions in ``t``, by name.
    quantity : the column of a long table that says which quantity a row is of; "" for none.
    errors : state -> the column of its measurement errors.
    doses : state -> the column of the amounts by which it jumps.
    max_rows : more rows than this are thinned.
    limits : state -> the limits of its measurement.
    """

    states: Sequence[str] | None = None
    inputs: Sequence[str] | None = None
    formulas: Mapping[str, str] = field(default_factory=dict)
    trajectory: Sequence[str] | None = None
    quantity: str | None = None
    errors: Mapping[str, str] = field(default_factory=dict)
    max_rows: int = 20_000_000
    doses: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, Range] = field(default_factory=dict)

    def keeping(self, states: Sequence[str], inputs: Sequence[str]) -> Asked:
        """Give what was asked of a source whose columns have their roles."""
        known = self.inputs if self.inputs is not None else [n for n in inputs if n not in states]
        return replace(
            self, states=[n for n in states if n not in known], inputs=known, quantity=""
        )


@dataclass(frozen=True, eq=False)
class Understood:
    """What a source was understood to be.

    Parameters
    ----------
    runs : the trajectories.
    roles : those of its columns.
    left_out : column that is not used -> the reason.
    notes : sentences on what was noticed or assumed.
    """

    runs: list[Trajectory]
    roles: Roles
    left_out: Mapping[str, str]
    notes: tuple[str, ...]


def understand(columns: Columns, time: str | Sequence[str] | None, asked: Asked) -> Understood:
    """Find what the columns of a source mean, and give its trajectories.

    Parameters
    ----------
    columns : the columns of the source.
    time : what the caller said of the time; None to guess.
    asked : what the caller said of the other columns.

    In this order: the time; runs side by side; quantities below each other; what distinguishes
    trajectories; the role of each column; rows in order of time, repeated ones averaged.
    Cells of states that are empty stay so: the state was not measured there.
    """
    notes = list(columns.notes)
    columns, said = turn_rows(_with_numbers(columns))
    notes += said
    columns = _without_kinds(columns, asked)
    if asked.states is None and asked.inputs is None:
        columns, said = unroll_months(columns)
        notes += said
    if time is None:
        said = [*(asked.states or ()), *(asked.inputs or ()), *(asked.trajectory or ())]
        columns = join_calendar(columns, _named(said, columns))
    times = find_time(columns, time)
    if not times.counted:  # a count of nanoseconds is no fault in a time
        columns.check_usable(times.columns)
    notes += times.notes
    columns, times, said = _with_times(columns, times)
    notes += said
    columns, times, said = _without_copies(columns, times)
    notes += said
    source = columns.names
    columns, times, said = _below_each_other(columns, times, asked)
    notes += said
    columns, times, quantity, said = _next_to_each_other(columns, times, asked)
    notes += said
    columns = _with_limits(columns, asked)
    grouping = _group(columns, times, asked)
    notes += _interleaved(times, grouping)
    roles = guess_roles(
        columns,
        times,
        grouping,
        asked.states,
        asked.inputs,
        asked.formulas,
        quantity,
        asked.errors,
        asked.doses,
    )
    gone = tuple(n for n in source if n not in columns.names and n != quantity)
    roles = replace(roles, reshaped=gone)
    grouping, dosing, said = _after_doses(columns, times, grouping, roles)
    notes += said
    runs, said = _order(columns, times, grouping, roles, asked)
    notes += said
    if roles.held:
        listed = " and ".join(map(repr, roles.held))
        keeps = "keeps its value over rows and steps" if len(roles.held) == 1 else "keep their"
        keeps = keeps if len(roles.held) == 1 else "keep their values over rows and step"
        what = "an input" if len(roles.held) == 1 else "inputs"
        notes.append(f"{listed} {keeps}, so taken for {what}; --states says otherwise.")
    guessed = asked.inputs is None and not columns.inputs
    others = (*roles.held, *roles.amounts, *roles.parameters, *roles.doses.values())
    for name in [n for n in roles.inputs if guessed and n not in others]:
        notes.append(f"{name!r} is called as an input, so taken for one; --states says otherwise.")
    for name in roles.amounts:
        count = sum(int(np.sum(run.values[name] != 0)) for run in runs)
        state, own = roles.renamed[roles.states[0]], roles.renamed[name]
        notes.append(
            f"{name!r} is 0 but in {count} {'row' if count == 1 else 'rows'}, and was taken for an "
            f"input that acts until the next row; if a state jumps by it, say which: --dose "
            f"{state}={own}."
        )
    trajectories = _make(columns, times, grouping, roles, runs, asked, dosing)
    notes += [note for note in _midnight(times, grouping) if note]
    return Understood(
        trajectories, roles, {**columns.left_out, **roles.left_out}, tuple(dict.fromkeys(notes))
    )


def _without_kinds(columns: Columns, asked: Asked) -> Columns:
    """Read rows of NONMEM as their codes say, and leave the columns of these out."""
    asked_for = [*(asked.states or ()), *(asked.inputs or ()), *(asked.trajectory or ())]
    said = _named(asked_for, columns)
    kinds = {n: why for n, why in find_nonmem(columns, columns.label).items() if n not in said}
    if not kinds:
        return columns
    before, columns = columns, read_nonmem(columns)
    for state, own in asked.doses.items() if columns.inputs != before.inputs else ():
        amounts = columns.values[columns.names.index(find_column(own, columns, "dose"))]
        if amounts.dtype.kind == "f" and not np.nan_to_num(amounts).any():
            raise InputError(
                f"all doses of {own!r} in {columns.label} are infusions, whose rate is an input: "
                f"{state} jumps by none; leave the dose out"
            )
    kept = columns.only([name for name in columns.names if name not in kinds])
    return replace(kept, left_out={**columns.left_out, **kinds})


def _at(columns: Columns, rows: np.ndarray) -> Columns:
    return replace(
        columns,
        values=tuple(values[rows] for values in columns.values),
        limits={name: own.select(rows) for name, own in columns.limits.items()},
    )


def _with_numbers(columns: Columns) -> Columns:
    """Give objects that are all numbers, or empty, as numbers."""
    found = [
        _as_numbers(v) if v.dtype.kind == "O" and name not in columns.faults else v
        for name, v in zip(columns.names, columns.values, strict=True)
    ]
    return replace(columns, values=tuple(found))


def _as_numbers(values: np.ndarray) -> np.ndarray:
    try:
        numbers = [np.nan if cell is None or cell == "" else float(cell) for cell in values]
    except (TypeError, ValueError, OverflowError):
        return values
    # A column without a value may be one of empty text.
    return np.array(numbers, dtype=float)


def _with_times(columns: Columns, times: Times) -> tuple[Columns, Times, list[str]]:
    """Leave rows without a time out."""
    bad = np.flatnonzero(np.isinf(times.values))
    if bad.size:
        raise InputError(
            f"time {times.name!r} of {columns.label} is {times.values[bad[0]]} in row "
            f"{bad[0] + 1}; remove or repair such rows"
        )
    there = np.flatnonzero(~np.isnan(times.values))
    empty = len(times.values) - len(there)
    if not empty:
        return columns, times, []
    if len(there) < FEWEST_ROWS:
        raise InputError(
            f"time {times.name!r} of {columns.label} is empty in {empty} of {len(times.values)} "
            f"rows; at least {FEWEST_ROWS} rows need a time"
        )
    first = np.flatnonzero(np.isnan(times.values))[0] + 1
    rows = f"row {first} was" if empty == 1 else f"{empty} rows (the first is row {first}) were"
    said = f"{rows[0].upper()}{rows[1:]} left out: {times.name!r} is empty there."
    return _at(columns, there), times.at(there), [said]


def _without_copies(columns: Columns, times: Times) -> tuple[Columns, Times, list[str]]:
    """Leave rows that are written twice out, where all others are in order of time.

    So are those of a logger that was read twice. Where runs have rows in common, such as the same
    start, the times of the others still begin again.
    """
    steps = np.diff(times.values)
    if times.daily or not np.any(steps < 0) or not np.any(steps > 0):
        return columns, times, []
    _, first, place = np.unique(times.values, return_index=True, return_inverse=True)
    if np.any(np.diff(first) < 0) or not all(_alike(v, v[first][place]) for v in columns.values):
        return columns, times, []
    columns, times, count = _at(columns, first), times.at(first), len(steps) + 1 - len(first)
    rows = f"{count} {'row is a copy' if count == 1 else 'rows are copies'}"
    said = f"{rows} of the row of the same time and {'was' if count == 1 else 'were'} left out."
    return columns, times, [said]


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether all cells are the same; empty ones are."""
    return bool(np.all((one == other) | ((one != one) & (other != other))))  # noqa: PLR0124


def _named(names: Sequence[str] | None, columns: Columns) -> set[str]:
    """Give the columns that a caller's names mean, as far as there are such."""
    wanted = set(names or ())
    return {n for n in columns.names if n in wanted or (n and clean_name(n) in wanted)}


def _below_each_other(
    columns: Columns, times: Times, asked: Asked
) -> tuple[Columns, Times, list[str]]:
    """Put runs in columns side by side below each other."""
    if not columns.named:
        return columns, times, []
    taken = {*times.columns, *times.left_out}
    said = _named(
        [*(asked.states or ()), *(asked.inputs or ()), *(asked.trajectory or ())], columns
    )
    found = find_replicates(columns, [n for n in columns.names if n not in taken])
    if found is None or said & set(found.columns):
        return columns, times, []
    others = [n for n in columns.names if n not in {*taken, *found.columns, *said}]
    summaries = find_summaries(columns, found, others)
    if summaries:
        kept = columns.only([n for n in columns.names if n not in summaries])
        columns = replace(kept, left_out={**columns.left_out, **summaries})
    stacked, rows, label = stack_replicates(columns, found)
    first = found.columns[0]
    note = (
        f"Columns such as {first!r} are {', '.join(found.stems[:6])} of {len(found.members)} runs "
        f"side by side, called {label} {', '.join(list(found.members)[:6])}; --states "
        f"{','.join(map(clean_name, found.columns[:2]))},... takes them for states of one run."
    )
    return stacked, times.at(rows), [note]


def _next_to_each_other(
    columns: Columns, times: Times, asked: Asked
) -> tuple[Columns, Times, str | None, list[str]]:
    """Give each quantity of a long table a column of its own."""
    if asked.quantity == "" or not columns.named:
        return columns, times, None, []
    labels = None
    if asked.trajectory is not None:
        labels = [find_column(name, columns, "trajectory") for name in asked.trajectory]
    taken = {*times.columns, *times.left_out, *(labels or ())}
    known = _named([*(asked.states or ()), *(asked.inputs or ())], columns)
    if asked.quantity is not None:
        quantity = find_column(asked.quantity, columns, "quantity")
        if quantity in taken:
            raise InputError(f"column {quantity!r} is the quantity and more; give it one role")
        candidates = [n for n in columns.names if n not in taken]
        found, note = describe_long(columns, times, quantity, candidates, labels), ""
    else:
        candidates = [n for n in columns.names if n not in taken and n not in known]
        if not any(columns.values[columns.names.index(n)].dtype.kind == "O" for n in candidates):
            return columns, times, None, []
        long, note = find_quantity(columns, times, candidates, labels, asked.states)
        if long is None:
            return columns, times, None, [note] if note else []
        found = long
    keys = sorted(
        {str(k) for k in columns.values[columns.names.index(found.quantity)] if k is not None}
    )
    wide, rows = widen(columns, times, found)
    note = (
        f"Each value of {found.quantity!r} ({', '.join(keys[:6])}) was taken for a quantity of one "
        f"run, with {found.values[0]!r} as its values; --quantity none says otherwise."
    )
    return wide, times.at(rows), found.quantity, [note]


def _with_limits(columns: Columns, asked: Asked) -> Columns:
    """Take the limits of states from the columns that the caller named for them."""
    for state, own in asked.limits.items():
        if not own.column:
            continue
        name = find_column(state, columns, "limit of a state")
        column = find_column(own.column, columns, "limit")
        by_name = dict(zip(columns.names, columns.values, strict=True))
        x, below = (to_numbers(by_name[n], n, columns.label) for n in (name, column))
        x, limits = limit_cells(x, columns.limits.get(name), below)
        del by_name[column]
        columns = replace(
            columns,
            names=tuple(by_name),
            values=tuple({**by_name, name: x}.values()),
            limits={**columns.limits, name: limits},
            left_out={**columns.left_out, column: f"is the limit of {name!r}"},
        )
    return columns


def _group(columns: Columns, times: Times, asked: Asked) -> Grouping:
    chosen = None
    if asked.trajectory:
        chosen = [find_column(name, columns, "trajectory") for name in asked.trajectory]
    # Names that are wrong are refused with the roles.
    known = _named([*(asked.states or ()), *(asked.inputs or ())], columns)
    taken = {*times.columns, *times.left_out, *columns.inputs, *known}
    candidates = [name for name in columns.names if name not in taken]
    return guess_grouping(columns, times, candidates, chosen)


def _interleaved(times: Times, grouping: Grouping) -> list[str]:
    """Say where rows of one time were taken for those of several runs."""
    t = times.within(grouping.codes)
    together = len(np.unique(t)) < len(t) and not grouping.trajectory and len(grouping.names) > 1
    mixed = bool(np.any(np.diff(grouping.codes) < 0))
    if not together or not mixed:
        return []
    return [
        f"Rows of one time of {times.name!r} go on as {len(grouping.names)} trajectories in the "
        "same order, and were taken for these; name the column that distinguishes them, if there "
        "is one (--trajectory)."
    ]


def _after_doses(
    columns: Columns, times: Times, grouping: Grouping, roles: Roles
) -> tuple[Grouping, dict[str, Dosing], list[str]]:
    """Begin a trajectory where a measurement is written below a dose of its time.

    Gives also what was given to each of these trajectories, whose doses have no row left.
    """
    if not roles.doses:
        return grouping, {}, []
    by_name = dict(zip(columns.names, columns.values, strict=True))
    given = {s: np.nan_to_num(by_name[n].astype(float)) for s, n in roles.doses.items()}
    amounts = np.sum([np.abs(own) for own in given.values()], axis=0)
    cells = np.array([to_numbers(by_name[name], name, columns.label) for name in roles.states])
    measured = np.any(np.isfinite(cells), axis=0)
    t = times.within(grouping.codes)
    part, above = split_after_doses(grouping.codes, t, amounts, measured)
    if not above.any():
        return grouping, {}, []
    pairs = np.column_stack([grouping.codes, part])[~above]
    every, codes = np.unique(pairs, axis=0, return_inverse=True)
    found = np.full(len(t), -1)
    found[~above] = codes.reshape(-1)
    names = [
        grouping.names[run] + (f", {number + 1}" if part.any() else "")
        for run, number in every.tolist()
    ]
    states = [roles.renamed[state] for state in roles.states]
    named = {roles.renamed[state]: own for state, own in given.items()}
    whole = {
        run: Dosing.of(
            t[own], states, cells[:, own].T, {s: given[own] for s, given in named.items()}
        )
        for run in np.unique(every[:, 0]).tolist()
        for own in [np.flatnonzero(grouping.codes == run)]
    }
    rows = "1 row" if above.sum() == 1 else f"{above.sum()} rows"
    return (
        replace(grouping, codes=found, names=tuple(names)),
        {name: whole[run] for name, run in zip(names, every[:, 0].tolist(), strict=True)},
        [
            f"{rows} of doses {'is' if above.sum() == 1 else 'are'} above a measurement of the "
            "same time, which was taken for one after the dose; a trajectory begins there."
        ],
    )


def _order(
    columns: Columns, times: Times, grouping: Grouping, roles: Roles, asked: Asked
) -> tuple[list[Run], list[str]]:
    """Give the rows of each trajectory in order of time, and what was done to them."""
    used = [*roles.states, *roles.inputs, *roles.noise.values()]
    columns.check_usable([*used, *roles.trajectory])
    by_name = dict(zip(columns.names, columns.values, strict=True))
    values = {name: to_numbers(by_name[name], name, columns.label) for name in used}
    for name, own in values.items():
        check_infinite(own, name, columns.label)
    t = times.within(grouping.codes)
    if len(t) < FEWEST_ROWS:
        raise InputError(
            f"{columns.label} has {len(t)} row{'s' * (len(t) != 1)}, which cannot show an "
            f"equation; give at least {FEWEST_ROWS}"
        )
    given = tuple(roles.doses.values())
    limits, unknown = _limits_of(columns, roles, asked)
    values |= {
        _limit_name(n, side): getattr(own, side) for n, own in limits.items() for side in _SIDES
    }
    # An empty cell says that nothing was given, and doses of one time are given together.
    values |= {name: np.nan_to_num(values[name]) for name in given}
    label, inputs = columns.label, [n for n in roles.inputs if n not in given]
    rows = [own[np.argsort(t[own], kind="stable")] for _, own in grouping.rows()]
    held = [n for n in inputs if is_set(n, [values[n][own] for own in rows])]
    runs, notes = order_rows(grouping, t, values, roles.states, times.name, label, given, held)
    runs = _held(runs, roles)
    runs, said = _on_levels(runs, roles)
    notes += said
    runs, said = _observed(runs, roles, columns.label)
    notes += said
    runs, said = _long_enough(runs, columns.label)
    return runs, [*notes, *unknown, *said]


def _limit_name(state: str, side: str) -> str:
    """Name the column in which the limits of a state go along with its rows."""
    return f"{state}\0{side}"


def _limits_of(columns: Columns, roles: Roles, asked: Asked) -> tuple[dict[str, Limits], list[str]]:
    """Give the limits of states that are known, and what is said of words that name none."""
    found, notes = {}, []
    for name in roles.states:
        own = columns.limits.get(name)
        if own is None:
            continue
        new = roles.renamed[name]
        given = asked.limits.get(name, asked.limits.get(new))
        if given is not None:
            own = own.with_words(given.below, given.above)
        for side, limits in (("below", own.below), ("above", own.above)):
            if count := int(np.sum(np.isinf(limits))):
                cells = "1 cell says" if count == 1 else f"{count} cells say"
                shown = f"{new}=..." if side == "below" else f"'{new}=>...'"
                notes.append(
                    f"{cells} that {name!r} was {side} a limit that is not written, and so without "
                    f"a value; say the limit, and they count: --limit {shown}"
                )
        own = own.where(own.known)
        if own.there.any():
            found[name] = own
    return found, notes


def _held(runs: Sequence[Run], roles: Roles) -> list[Run]:
    """Let inputs that are noted only at their changes keep their value between them."""
    noted = [
        name
        for name in roles.inputs
        if name not in roles.doses.values()
        and is_noted_at_changes(name, [run.values[name] for run in runs], FEWEST_ROWS)
    ]
    return [
        replace(run, values={**run.values, **{n: hold_on(run.values[n]) for n in noted}})
        for run in runs
    ]


def _on_levels(runs: Sequence[Run], roles: Roles) -> tuple[list[Run], list[str]]:
    """Take the noise off inputs that hold levels: what acts on the states has none of it."""
    runs, notes = list(runs), []
    for name in (n for n in roles.inputs if n not in roles.doses.values()):
        found = find_levels([run.values[name] for run in runs])
        if found is None:
            continue
        pairs = zip(runs, found[0], strict=True)
        runs = [replace(run, values={**run.values, name: own}) for run, own in pairs]
        notes.append(
            f"{name!r} holds its value but for noise of {found[1]:.2g}, and steps: the mean of "
            "each level was taken for it."
        )
    return runs, notes


def _observed(runs: Sequence[Run], roles: Roles, label: str) -> tuple[list[Run], list[str]]:
    """Give the rows where something was measured, and say which states were not at every one.

    An input is known at all rows by what it does between its own. Rows in which there is nothing
    but a time, and those before the first or after the last value of any state, say nothing.
    """
    total = sum(len(run.t) for run in runs)
    gaps = _count_empty(runs, roles.inputs)
    told = [f"{name!r}, an input, in {count}" for name, count in gaps.items()]
    found = [_with_inputs(run, roles) for run in runs]
    found = [_without_limits_of_values(run, roles.states) for run in found]
    found = [run.at(_rows_told(run, roles)) for run in found]
    kept = sum(len(run.t) for run in found)
    without = _count_empty(found, roles.states)
    limited = [
        (n, int(own.there.sum())) for r in found for n, own in _limits_in(r, roles.states).items()
    ]
    empty = {n: c - sum(own for m, own in limited if m == n) for n, c in without.items()}
    empty = {name: count for name, count in empty.items() if count}
    for name in roles.states:
        count = kept - without.get(name, 0)
        if count < FEWEST_ROWS:
            others = ",".join(clean_name(n) for n in roles.states if n != name) or "..."
            raise InputError(
                f"{name!r} has {count} value{'s' * (count != 1)} in the {total} rows of {label}; "
                f"at least {FEWEST_ROWS} are needed: give more of them, or leave {name!r} out "
                f"(--states {others})"
            )
    notes = []
    if kept < total:
        lost = total - kept
        rows = "1 row was" if lost == 1 else f"{lost} rows were"
        notes.append(f"{rows} left out: no state has a value there.")
    if empty:
        listed = [f"{n!r} in {c}" for n, c in sorted(empty.items(), key=lambda own: -own[1])]
        notes.append(
            f"Of {kept} rows, cells are empty: {', '.join(listed)}; each state counts where it was "
            "measured."
        )
    if told:
        notes.append(
            f"Of {total} rows, cells are empty: {', '.join(told)}; its value there is that between "
            "its rows (--hold)."
        )
    return found, notes


def _limits_in(run: Run, states: Sequence[str]) -> dict[str, Limits]:
    """State -> its limits, for those that have any."""
    return {
        name: Limits(*(run.values[_limit_name(name, side)] for side in _SIDES))
        for name in states
        if _limit_name(name, _SIDES[0]) in run.values
    }


def _without_limits_of_values(run: Run, states: Sequence[str]) -> Run:
    """Leave limits out where the mean of other rows of the same time has a value."""
    left = {n: own.where(np.isnan(run.values[n])) for n, own in _limits_in(run, states).items()}
    more = {_limit_name(n, side): getattr(own, side) for n, own in left.items() for side in _SIDES}
    return replace(run, values={**run.values, **more})


def _count_empty(runs: Sequence[Run], names: Sequence[str]) -> dict[str, int]:
    """Column -> how many of its cells are empty, where any is."""
    counts = {name: sum(int(np.sum(np.isnan(run.values[name]))) for run in runs) for name in names}
    return {name: count for name, count in counts.items() if count}


def _with_inputs(run: Run, roles: Roles) -> Run:
    inputs = {name: between_rows(run.t, run.values[name]) for name in roles.inputs}
    return replace(run, values={**run.values, **inputs})


def _rows_told(run: Run, roles: Roles) -> np.ndarray:
    """Give the rows where a state has a value; with inputs, those between two such rows too."""
    there = np.any([np.isfinite(run.values[name]) for name in roles.states], axis=0)
    for limits in _limits_in(run, roles.states).values():
        there |= limits.there
    for name in roles.doses.values():
        there |= run.values[name] != 0
    known = np.all([np.isfinite(run.values[name]) for name in roles.inputs], axis=0)
    own = np.flatnonzero(there & known)
    if not roles.inputs or not len(own):
        return own
    between = np.arange(own[0], own[-1] + 1)
    return between[np.broadcast_to(known, run.t.shape)[between]]


def _long_enough(runs: Sequence[Run], label: str) -> tuple[list[Run], list[str]]:
    """Leave trajectories of too few rows out, where they are the lesser part."""
    short = [run for run in runs if len(run.t) < FEWEST_ROWS]
    if not short:
        return list(runs), []
    lost, total = sum(len(run.t) for run in short), sum(len(run.t) for run in runs)
    few = min(short, key=lambda run: len(run.t))
    rows = f"{len(few.t)} row{'s' * (len(few.t) != 1)}"
    if 2 * lost > total or len(runs) == len(short):
        where = f"trajectory {few.name} of {label}" if len(runs) > 1 else label
        raise InputError(f"{where} has {rows}; give each trajectory at least {FEWEST_ROWS}")
    names = ", ".join(run.name for run in short[:6])
    more = f" and {len(short) - 6} more" if len(short) > 6 else ""
    one = len(short) == 1
    said = (
        f"Trajectory {names} was left out: it has {rows}, fewer than {FEWEST_ROWS}."
        if one
        else f"Trajectories {names}{more} were left out: they have fewer than {FEWEST_ROWS} rows."
    )
    return [run for run in runs if run not in short], [said]


def _make(
    columns: Columns,
    times: Times,
    grouping: Grouping,
    roles: Roles,
    runs: Sequence[Run],
    asked: Asked,
    dosing: Mapping[str, Dosing],
) -> list[Trajectory]:
    wanted = [*roles.states, *roles.inputs]
    every = [np.concatenate([run.values[name] for run in runs]) for name in wanted]
    check_values(every, wanted, roles, columns.label)
    start = np.min(times.within(grouping.codes)) if times.from_first else 0.0
    steps = np.concatenate([np.diff(run.t) for run in runs])

    def in_unit(t: np.ndarray) -> tuple[np.ndarray, str]:
        return in_seconds_or_units(times, t - start, steps)

    counted = [in_unit(run.t) for run in runs]
    unit = counted[0][1]
    functions = compile_numpy([parse(text, ["t"]) for text in asked.formulas.values()], ["t"])
    own = {name: columns.units.get(name) or bracketed_unit(name) for name in wanted}
    units = {roles.renamed[name]: text for name, text in own.items() if text}
    noise = pooled_noise(runs, roles.states)
    begins = None if times.first is None else (times.first[0], times.first[1] + float(start))
    origin = {
        "source": columns.label,
        **({} if begins is None else {"begins": begins}),
        **({"time_unit": unit} if unit else {}),
        **({"units": units} if units else {}),
        **({"noise": {roles.renamed[n]: size for n, size in noise.items()}} if noise else {}),
    }
    said = {roles.renamed[state]: own for state, own in roles.noise.items()}
    if said:
        origin["said_noise"] = said
    if columns_said := {n: own.column for n, own in asked.limits.items() if own.column}:
        origin["said_limits"] = {roles.renamed.get(n, n): own for n, own in columns_said.items()}
    held = dict.fromkeys((roles.renamed[n] for n in roles.doses.values()), HOLDS[0])
    names = [roles.renamed[name] for name in wanted]
    count = len(roles.states)
    found = []
    kept = thin([len(run.t) for run in runs], asked.max_rows, columns.label)
    for run, (t, _), rows in zip(runs, counted, kept, strict=True):
        extra = functions(t[None]).T
        _check_formulas(extra[rows], t[rows], asked.formulas)
        table = np.column_stack([run.values[name] for name in wanted])
        whole = Trajectory(
            t,
            table[:, :count],
            tuple(names[:count]),
            np.column_stack([table[:, count:], extra]),
            (*names[count:], *asked.formulas),
            {
                **origin,
                "name": run.name,
                **_label(run.name, grouping.trajectory),
                **(
                    {"dosing": dosing[run.name].at(lambda t: in_unit(t)[0])}
                    if run.name in dosing
                    else {}
                ),
            },
            noise=_read_errors(run, roles, asked),
            hold=held,
            limits={roles.renamed[n]: own for n, own in _limits_in(run, roles.states).items()},
        )
        # A state that is measured seldom keeps its rows.
        some = whole.every(rows.step or 1) if whole.unmeasured.size else rows
        found.append(whole.select(some))
    return found


def _read_errors(run: Run, roles: Roles, asked: Asked) -> dict[str, KnownNoise]:
    """Give the measurement errors in separate columns.

    Those that the caller named are used as they are; others say how rows differ.
    """
    found = {}
    for state, column in roles.noise.items():
        name = roles.renamed[state]
        sure = state in asked.errors or name in asked.errors
        noise = KnownNoise(run.values[column], sure=sure)
        if sure or np.any(noise.sd > 0):
            found[name] = check_noise(name, noise, f"column {column!r}")
    return found


def _midnight(times: Times, grouping: Grouping) -> list[str]:
    if not times.daily:
        return []
    days = np.sum(times.within(grouping.codes) != times.values)
    passes = bool(days)
    return [f"{times.name!r} passes midnight and goes on on the next day."] if passes else []


def _check_formulas(values: np.ndarray, t: np.ndarray, formulas: Mapping[str, str]) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        row, column = bad[0]
        name, text = list(formulas.items())[column]
        raise InputError(
            f"input {name} = {text} is {values[row, column]} at t = {t[row]:g}; "
            "give a formula that is finite over the whole data"
        )


def _label(name: str, columns: Sequence[str]) -> dict[str, dict[str, str]]:
    """Give what each column of labels says of a trajectory, which is named by them."""
    said = name.split(", ")
    return {"labels": dict(zip(columns, said, strict=True))} if len(said) == len(columns) else {}
