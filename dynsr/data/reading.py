"""Reading: whatever the user has becomes trajectories of the same columns.

Files, frames, mappings and arrays become named columns; roles say which is the time, a state, an
input; checks name what is wrong and the remedy.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import sympy

from dynsr.data.angles import unwrap_angles
from dynsr.data.codes import Missing, without_codes
from dynsr.data.columns import Columns, beside, load_columns, names_of_states, with_times
from dynsr.data.description import Description, describe_runs, join_descriptions
from dynsr.data.dosing import clean_doses, columns_of_doses, cut_at_doses, read_doses, split_volume
from dynsr.data.formats import frame_of_rows
from dynsr.data.grouping import differ_as_parameter, find_restarts, is_number
from dynsr.data.joining import Source, join_sources
from dynsr.data.known_noise import KnownNoise, check_names, check_noise, read_noise
from dynsr.data.limits import limit_cells, read_limits
from dynsr.data.names import clean_name
from dynsr.data.noise_model import rounding
from dynsr.data.oddities import OddSettings, odd_marks
from dynsr.data.roles import Roles, constants_left_out
from dynsr.data.run_settings import (
    RunSettings,
    apply_settings,
    find_settings,
    settings_above,
)
from dynsr.data.steps import between_rows
from dynsr.data.time_columns import find_time
from dynsr.data.times import convert_times
from dynsr.data.trajectory import FEWEST_ROWS, Trajectory, as_floats, decide_hold
from dynsr.data.understanding import Asked, Understood, understand
from dynsr.data.usual_forms import in_known_form, is_step, times_of
from dynsr.data.writing import write_new
from dynsr.errors import DynsrWarning, InputError
from dynsr.expression import check_name, compile_numpy, parse

MAX_ROWS = 20_000_000


@dataclass(frozen=True, eq=False)
class Table:
    """Trajectories that were read, and how their columns were understood, as a sentence.

    ``description`` says the same as a value; ``roles`` column by column, None where several sources
    were read. ``left_out`` gives each column that is not used with the reason; ``notes`` are
    sentences on what was noticed or assumed; ``names`` are those of the trajectories: the values of
    the columns that distinguish them, joined by ", ", or else numbers from 1.
    """

    trajectories: list[Trajectory]
    guess: str
    description: Description
    roles: Roles | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    names: tuple[str, ...] = ()


def read_trajectories(
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
) -> Table:
    """Read one or many trajectories from a table, a file of one, or a list of such sources.

    Parameters
    ----------
    source : a file of delimited text, Excel (.xlsx, .xls, .ods), MATLAB (.mat), HDF5 (.h5), NetCDF
        (.nc), Parquet, .npz or .npy; a frame of pandas or polars; a dataset of xarray; a mapping of
        columns; a pair of arrays (t (n,), x (n, k)); an array whose first column is the time; a
        Trajectory; a list of rows as mappings; or a list of any of these, one or more trajectories
        each. Those of the same states are runs; those that share no state measured the same
        experiments and are joined on the time. A small table without a time, one of whose columns
        has the names of the runs, gives the parameters of each, such as a plate's layout.
    time : name of the time column, of the date and the clock ("date,clock"), or the (n,) times
        themselves, a list of them for each run, or the step from row to row; guessed by default.
    states : names of the state columns; every other column by default. A source without
        names, such as an array, takes these names.
    inputs : columns that are known inputs, or expressions in t, such as ``"F=0.5*sin(6*t)"`` or
        ``{"F": "0.5*sin(6*t)"}``.
    trajectory : the column, or columns, whose values together name the trajectory of a row.
    quantity : the column of a long table that says which quantity a row is of, each of which then
        gets a column of its own; guessed by default, and "none" for no such column.
    decimal : the decimal mark of numbers that are text, "." or ","; by default the cells show it.
    missing : the numbers that stand for no value, such as -999; "none" for no number. By default
        usual ones that are far from all others of their column are read so, with a note.
    hold : input -> what it does between rows: "previous" (keeps its value), "linear" or "smooth";
        or one of these words for all. By default the values show it.
    noise : state -> its measurement errors: a standard deviation in its units, a share of its size
        such as "5 %", or the column of them. By default they are estimated; those of a column that
        is called so, such as x_sd, then say how rows differ.
    doses : state -> column of the amounts by which it jumps right after a row; an empty cell is 0.
        The trajectories keep the column as an input, at which ``dynsr.discover`` cuts them.
    limits : state -> the limit of its measurement in its units: values at or below it, and cells
        such as "BDL", say only that it was below. Also the upper end of the range, such as ">100",
        both, such as "0.05..100", or the column of the limits of detection. Cells such as "<0.05"
        say their limit themselves.
    max_rows : more rows than this are thinned evenly, with a DynsrWarning.

    Times may be uneven, and rows may be in any order where it is known which belong together.
    Rows of one time are averaged, a state without a value in a row was not measured there, and what
    else was assumed is in the table's notes. Names that formulas cannot use are changed,
    with a DynsrWarning. Raises InputError, one line that names the value and the remedy, when the
    table cannot be used.

    >>> t = np.linspace(0, 1, 11)
    >>> table = read_trajectories({"t": t, "x": t**2, "y": t**3})
    >>> print(table.guess)
    the mapping: time 't', 11 rows from 0 to 1 every 0.1; states x, y
    """
    if max_rows < 1:
        raise InputError(f"max_rows {max_rows} must be a whole number from 1 up")
    source, time = in_known_form(source, time)
    errors = find_columns(noise)
    asked = Asked(
        _listed(states),
        *_split_inputs(inputs),
        _listed(trajectory),
        _chosen(quantity),
        errors,
        max_rows,
        columns_of_doses(doses),
        read_limits(limits),
    )
    if isinstance(source, list) and source and all(map(_is_record, source)):
        source = frame_of_rows(source)
    if isinstance(source, list):
        return _read_list(
            source,
            time,
            states,
            inputs,
            trajectory,
            quantity,
            decimal,
            missing,
            hold,
            noise,
            read_doses(doses),
            limits,
            max_rows,
        )
    times = None if time is None or _is_named(time, source) else time
    name: Any = time if times is None else "t"
    columns = _with_names(_load_with_times(source, times, decimal, missing), states)
    if isinstance(time, str) and time not in columns.names and is_number(time):
        columns, name = with_times(columns, times_of(float(time), columns.rows)), "t"
    for note in columns.notes:
        warnings.warn(note, DynsrWarning, stacklevel=2)
    if isinstance(source, Trajectory) and states is None:
        asked = asked.keeping(source.states, source.input_names)
    if isinstance(source, np.ndarray) and not columns.named and time is None:
        _check_first_column(columns.values[0], columns.label)
    found = understand(columns, name, asked)
    if isinstance(hold, Mapping):
        hold = {found.roles.renamed.get(name, name): way for name, way in hold.items()}
    if isinstance(source, Trajectory) and not isinstance(hold, str):
        hold = {**_given(source, found.runs), **(hold or {})}
    if isinstance(source, Trajectory) and [len(run) for run in found.runs] == [len(source)]:
        found = replace(found, runs=[replace(run, noise=source.noise) for run in found.runs])
    _check_dose_units(found.runs[0], read_doses(doses), found.roles)
    found = _look_at_values(found, isinstance(source, Trajectory))
    runs = say_limits(found.runs, limits, found.roles.renamed)
    found = replace(found, notes=(*found.notes, *_count_limits(runs, limits, found.roles)))
    runs = say_noise(runs, noise, found.roles.renamed)
    runs = decide_hold(runs, hold)
    found = _without_replaced(found, {*(noise or {})} - {*errors})
    understood = describe_runs(
        columns.label,
        runs,
        found.roles,
        asked.formulas,
        found.left_out,
        found.notes,
        _volumes(read_doses(doses), found.roles),
    )
    told = _told(runs, understood.sentence, understood)
    table = replace(told, roles=found.roles, left_out=found.left_out, notes=found.notes)
    above = settings_above(columns)
    return (_with_settings(table, [above], 1) if above else None) or table


def _with_settings(table: Table, found: Sequence[RunSettings], count: int) -> Table | None:
    """Give a table whose runs have what was set in each; None where the settings name others."""
    set_up = apply_settings(table.trajectories, table.description, found, count)
    if set_up is None:
        return None
    runs, whole = set_up
    told = _told(decide_hold(runs), whole.sentence, whole)
    return replace(told, roles=table.roles, left_out=whole.left_out, notes=whole.notes)


def _look_at_values(found: Understood, given: bool) -> Understood:
    """Say what looks odd in the values, and let angles go on unless the caller made the states."""
    runs, turns = (found.runs, []) if given else unwrap_angles(found.runs)
    notes = [*odd_marks(found.runs), *turns]
    for note in notes:
        warnings.warn(note, DynsrWarning, stacklevel=3)
    return replace(found, runs=runs, notes=(*found.notes, *notes))


def _without_replaced(found: Understood, given: Collection[str]) -> Understood:
    """Leave columns of errors out of the roles where the caller gives these as numbers."""
    roles = found.roles
    said = {n: own for n, own in roles.noise.items() if {n, roles.renamed[n]} & set(given)}
    why = {own: f"is not used: the noise of {n!r} is given" for n, own in said.items()}
    noise = {n: own for n, own in roles.noise.items() if n not in said}
    return replace(found, roles=replace(roles, noise=noise), left_out={**found.left_out, **why})


def _volumes(doses: Mapping[str, str], roles: Roles) -> dict[str, str]:
    """Give state of the source -> what its amounts are divided by, where they are."""
    split = {state: split_volume(text)[1] for state, text in doses.items()}
    return {
        name: volume if isinstance(volume, str) else f"{volume:g}"
        for state, volume in split.items()
        for name in roles.doses
        if volume != 1.0 and state in (name, roles.renamed[name])
    }


def _check_dose_units(run: Trajectory, doses: Mapping[str, str], roles: Roles) -> None:
    """Refuse amounts whose columns have another unit than their state, without a volume."""
    units: Mapping[str, str] = run.origin.get("units", {})
    for state, text in doses.items():
        column, volume = split_volume(text)
        own, given = (roles.renamed.get(name, clean_name(name)) for name in (state, column))
        unit, other = units.get(own), units.get(given)
        if unit and other and volume == 1.0 and unit != other:
            raise InputError(
                f"doses are in {other} and {own} is in {unit}; give the volume by which they are "
                f"divided, or a name of one that is fitted: --dose {own}={given}/V"
            )


def _given(source: Trajectory, runs: Sequence[Trajectory]) -> dict[str, str]:
    """Give what a trajectory says of those of its inputs that are inputs of the runs too."""
    return {name: way for name, way in source.hold.items() if name in runs[0].input_names}


def _is_record(source: Any) -> bool:
    """Whether a source is a row as JSON has it: name -> cell, or an object of cells."""
    return isinstance(source, dict) and all(
        cell is None or np.isscalar(cell) or _is_record(cell) for cell in source.values()
    )


def _is_named(time: Any, source: Any) -> bool:
    """Whether times are the names of columns, and not the times themselves."""
    if isinstance(time, str):
        return True
    few = isinstance(time, (list, tuple)) and len(time) < FEWEST_ROWS
    return few and all(isinstance(name, str) for name in time) and not isinstance(source, tuple)


def _chosen(quantity: str | None) -> str | None:
    """Give the column of quantities; "" where there is to be none."""
    return "" if quantity is not None and quantity.strip().lower() in ("", "none") else quantity


def _load_with_times(source: Any, t: Any, decimal: str | None, missing: Missing | None) -> Columns:
    """Load the columns of a source, and times that the caller gives; None where it has them."""
    if t is None:
        return load_columns(source, decimal, missing)
    if isinstance(source, (str, os.PathLike, Mapping)) or hasattr(source, "columns"):
        columns = load_columns(source, decimal, missing)
        return with_times(columns, times_of(t, columns.rows) if is_step(t) else t)
    return load_columns((t, source), missing=missing)


def _check_first_column(t: np.ndarray, label: str) -> None:
    """Refuse an array whose first column is no time; warn where it may be a state."""
    t = t if t.dtype.kind == "f" else np.arange(float(len(t)))
    codes = find_restarts(t)
    steps = np.diff(t)[np.diff(codes) == 0]
    if np.any(steps <= 0):
        raise InputError(
            f"the first column of {label} does not increase, so that it is no time; give the "
            "times too: (t, x), or time=t"
        )
    if steps.size and np.ptp(steps) > OddSettings().even * np.max(steps):
        warnings.warn(
            f"the first column of {label} was taken for the time, in uneven steps of "
            f"{steps.min():.3g} to {steps.max():.3g}; if it is a state, give the times too: (t, x)",
            DynsrWarning,
            stacklevel=3,
        )


def _told(runs: Sequence[Trajectory], guess: str, understood: Description) -> Table:
    """Let each trajectory hold how its columns were understood, and the first the whole table."""
    told = [replace(run, origin={**run.origin, "columns": guess}) for run in runs]
    told[0] = replace(told[0], origin={**told[0].origin, "table": understood.to_dict()})
    names = tuple(run.name for run in understood.trajectories)
    return Table(told, guess, understood, names=names)


def _read_list(
    sources: list[Any],
    time: float | str | Sequence[Any] | np.ndarray | None,
    states: Sequence[str] | str | None,
    inputs: Sequence[str] | Mapping[str, str] | str | None,
    trajectory: Sequence[str] | str | None,
    quantity: str | None,
    decimal: str | None,
    missing: Missing | None,
    hold: Mapping[str, str] | str | None,
    noise: Mapping[str, Any] | None,
    doses: Mapping[str, str],
    limits: Mapping[str, Any] | None,
    max_rows: int,
) -> Table:
    if not sources:
        raise InputError("no data was given; give at least one file, frame or array")
    _refuse_twice(sources)
    load_of = partial(_load_quietly, decimal=decimal, missing=missing)
    listed = [(s, find_settings(s, partial(load_of, s))) for s in sources]
    rest = [source for source, found in listed if not found]
    if 0 < len(rest) < len(sources):
        every = [own for _, found in listed for own in found]
        inputs_of_rest = _without_settings(inputs, every)
        table = read_trajectories(
            rest if len(rest) > 1 else rest[0],
            time,
            states,
            inputs_of_rest,
            trajectory,
            quantity=quantity,
            decimal=decimal,
            missing=missing,
            hold=hold,
            noise=noise,
            doses=doses or None,
            limits=limits,
            max_rows=max_rows,
        )
        if (whole := _with_settings(table, every, len(sources) - len(rest))) is not None:
            return whole
    share = max(max_rows // len(sources), FEWEST_ROWS)
    tables, constants = [], []
    for source in sources:
        load = cache(partial(_load_quietly, source, decimal, missing))
        own, known, errors = _those_of(source, load, states, inputs, noise, time)
        tables.append(
            read_trajectories(
                source,
                time,
                own,
                known,
                trajectory,
                quantity=quantity,
                decimal=decimal,
                missing=missing,
                noise=errors,
                doses=_doses_of(load, doses),
                limits=_limits_of(source, load, limits),
                max_rows=share,
            )
        )
        still = tables[-1].left_out
        constants.append(constants_left_out(load(), still) if still else {})
    tables = _with_constants(tables, constants)
    each = [len(table.trajectories) for table in tables]
    flat = _in_one_unit([run for table in tables for run in table.trajectories])
    ends = np.cumsum(each)
    parts = [
        Source(table.description.source, flat[end - count : end], bool(table.description.named_by))
        for table, count, end in zip(tables, each, ends, strict=True)
    ]
    runs, joined = join_sources(parts)
    asked = {clean_name(name) for name in _split_inputs(inputs)[0] or ()}
    moved = [n for n in runs[0].states if n in asked] if joined else []
    runs = [_as_inputs(run, moved) for run in runs]
    renamed = {old: new for table in tables for old, new in table.description.renamed.items()}
    runs = say_noise(say_limits(runs, limits, renamed), noise, renamed)
    if hold is None:
        # What one file says of an input holds for all.
        given: dict[str, str] = {}
        for source in sources:
            given |= _given(source, runs) if isinstance(source, Trajectory) else {}
        hold = given
    elif isinstance(hold, Mapping):
        hold = {renamed.get(name, name): way for name, way in hold.items()}
    runs = decide_hold([replace(run, hold={}) for run in runs], hold)
    understood = join_descriptions([table.description for table in tables], runs, joined)
    told = _told(runs, "; ".join(dict.fromkeys(table.guess for table in tables)), understood)
    return replace(told, left_out=understood.left_out, notes=understood.notes)


def _with_constants(tables: list[Table], constants: list[dict[str, float]]) -> list[Table]:
    """Give each source back the constant columns that move, or have another value, in others.

    Parameters
    ----------
    tables : what was read from each source.
    constants : for each, its column that was left out since it has one value -> that value.
    """
    runs = [table.trajectories[0] for table in tables]
    states = {name for run in runs for name in run.states}
    inputs = {name for run in runs for name in run.input_names}
    cleaned = [{clean_name(name): value for name, value in own.items()} for own in constants]
    shared = set.intersection(*map(set, cleaned))
    parameters = {
        name for name in shared if differ_as_parameter(name, [own[name] for own in cleaned])
    }
    found = []
    for table, own in zip(tables, constants, strict=True):
        back = {n: v for n, v in own.items() if clean_name(n) in states | inputs | parameters}
        still = {clean_name(name): value for name, value in back.items()}
        kept = {name: why for name, why in table.left_out.items() if name not in back}
        description = replace(
            table.description,
            left_out=kept,
            renamed={**table.description.renamed, **{n: clean_name(n) for n in back}},
            parameters=(*table.description.parameters, *(n for n in still if n in parameters)),
        )
        moved = [
            run.with_states({n: v for n, v in still.items() if n in states}).with_inputs(
                {n: v for n, v in still.items() if n not in states}
            )
            for run in table.trajectories
        ]
        found.append(
            replace(table, trajectories=moved, description=description, left_out=kept)
            if back
            else table
        )
    return found


def _without_settings(
    inputs: Sequence[str] | Mapping[str, str] | str | None, found: Sequence[RunSettings]
) -> Sequence[str] | Mapping[str, str] | str | None:
    """Give the inputs that are no settings of runs."""
    known, formulas = _split_inputs(inputs)
    called = {name for own in found for pair in own.renamed.items() for name in pair}
    if not known or not called & set(known):
        return inputs
    return [
        *(name for name in known if name not in called),
        *(f"{name}={text}" for name, text in formulas.items()),
    ]


def _load_quietly(source: Any, decimal: str | None, missing: Missing | None) -> Columns:
    """Give the columns of a source; what is said of them is said where they are read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_columns(source, decimal, missing)


def _those_of(
    source: Any,
    load: Callable[[], Columns],
    states: Sequence[str] | str | None,
    inputs: Sequence[str] | Mapping[str, str] | str | None,
    noise: Mapping[str, Any] | None,
    time: Any,
) -> tuple[
    Sequence[str] | str | None,
    Sequence[str] | Mapping[str, str] | str | None,
    dict[str, str],
]:
    """Give the states, inputs and columns of errors asked for that one of several sources has.

    What none has is refused where it is read. A source of inputs alone has states until it is
    joined with others.
    """
    wanted, (known, formulas), errors = _listed(states), _split_inputs(inputs), find_columns(noise)
    if not (wanted or known or errors) or isinstance(source, Trajectory):
        return states, inputs, errors
    columns = load()
    if not columns.named:
        return states, inputs, errors
    names = {*columns.names, *map(clean_name, columns.names), *columns.left_out}
    own = [name for name in wanted or () if name in names] or states
    if known:
        kept = [name for name in known if name in names]
        kept = kept if _has_states(columns, kept, time) else []
        inputs = [*kept, *(f"{name}={text}" for name, text in formulas.items())]
    return own, inputs, {state: own for state, own in errors.items() if state in names}


def _has_states(columns: Columns, inputs: Sequence[str], time: Any) -> bool:
    """Whether a source has numbers other than times and these inputs."""
    try:
        times = find_time(columns, time if isinstance(time, str) else None).columns
    except InputError:  # said where it is read
        return True
    taken = {*inputs, *times}
    return any(
        values.dtype.kind == "f" and not {name, clean_name(name)} & taken
        for name, values in zip(columns.names, columns.values, strict=True)
    )


def _doses_of(load: Callable[[], Columns], doses: Mapping[str, str]) -> dict[str, str] | None:
    """Give the doses whose columns one of several sources has."""
    if not doses:
        return None
    columns = load()
    names = {*columns.names, *map(clean_name, columns.names)}
    return {state: own for state, own in doses.items() if split_volume(own)[0] in names} or None


def _limits_of(
    source: Any, load: Callable[[], Columns], limits: Mapping[str, Any] | None
) -> dict[str, Any] | None:
    """Give the limits of the states that one of several sources has."""
    if not limits or isinstance(source, Trajectory):
        return None
    columns = load()
    names = {*columns.names, *map(clean_name, columns.names)}
    return {state: own for state, own in limits.items() if state in names} or None


def _refuse_twice(sources: Sequence[Any]) -> None:
    """Refuse a file that is given twice: its rows are no second measurement."""
    seen: dict[bytes, str] = {}
    for source in sources:
        if not isinstance(source, (str, os.PathLike)) or not os.path.isfile(source):
            continue
        content = hashlib.sha256(Path(source).read_bytes()).digest()
        if content in seen:
            both = f"{seen[content]!r} and {str(source)!r}"
            raise InputError(f"files {both} are the same rows twice; give them once")
        seen[content] = str(source)


def _in_one_unit(runs: list[Trajectory]) -> list[Trajectory]:
    """Count all times in the unit of the first trajectory; raise InputError where that fails."""
    unit = runs[0].time_unit
    others = [run.time_unit for run in runs if bool(run.time_unit) != bool(unit)]
    if others:
        raise InputError(
            f"times are counted in {unit or 'no unit'} and in {others[0] or 'no unit'}; give all "
            "trajectories the same"
        )
    return in_unit(runs, unit)


def in_unit(runs: Sequence[Trajectory], unit: str) -> list[Trajectory]:
    """Give trajectories whose times are counted in a unit; those of no unit stay as they are.

    Parameters
    ----------
    runs : the trajectories.
    unit : "s", "min", "h", "days" or "years"; "" leaves all as they are.

    Raises InputError where a unit cannot be brought to it.

    >>> day = Trajectory([0.0, 1.0], [[1.0], [2.0]], ("x",), origin={"time_unit": "days"})
    >>> in_unit([day], "h")[0].t.tolist()
    [0.0, 24.0]
    """
    found = []
    for run in runs:
        if not unit or not run.time_unit:
            found.append(run)
            continue
        t = convert_times(run.t, run.time_unit, unit)
        if t is None:
            raise InputError(
                f"times are counted in {unit} and in {run.time_unit}; give all trajectories the "
                "same"
            )
        found.append(replace(run, t=t, origin={**run.origin, "time_unit": unit}))
    return found


def find_columns(noise: Mapping[str, Any] | None) -> dict[str, str]:
    """Give what is said of measurement errors by the name of a column.

    Parameters
    ----------
    noise : state -> its errors, as :func:`read_trajectories` takes them.

    >>> find_columns({"x": "x_sd", "y": "5 %", "z": 0.1})
    {'x': 'x_sd'}
    """
    said = {s: own for s, own in (noise or {}).items() if isinstance(own, str)}
    read = {state: read_noise(state, own, 1) for state, own in said.items()}
    return {state: own for state, own in read.items() if isinstance(own, str)}


def say_limits(
    runs: Sequence[Trajectory], limits: Mapping[str, Any] | None, renamed: Mapping[str, str]
) -> list[Trajectory]:
    """Give runs whose values beyond the limits that the caller says are known as such alone.

    Parameters
    ----------
    runs : the trajectories.
    limits : state -> its limits, as :func:`read_trajectories` takes them.
    renamed : name in the source -> name in formulas.

    Raises InputError when something is no state, or no limit.
    """
    named = read_limits(limits).items()
    said = {renamed.get(state, clean_name(state)): own for state, own in named}
    for state in said:
        if state not in runs[0].states:
            raise InputError(
                f"limits names {state!r}, which is no state; the states are: "
                f"{', '.join(runs[0].states)}"
            )
    found = []
    for run in runs:
        x, own = run.observed.copy(), dict(run.limits)
        words = dict(run.origin.get("said_limits", {}))
        for state, given in said.items():
            place = run.index(state)
            if not given.column:
                cells = x[:, place], own.get(state), given.below, given.above
                x[:, place], own[state] = limit_cells(*cells)
            elif words.get(state) != given.column:
                raise InputError(
                    f"the limit of {state!r} is no number and no column: {given.column!r}; the "
                    f"columns are: {', '.join(run.names)}"
                )
            words[state] = given.words
        origin = {**run.origin, "said_limits": words}
        found.append(replace(run, x=x, limits=own, origin=origin) if said else run)
    return found


def _count_limits(
    runs: Sequence[Trajectory], limits: Mapping[str, Any] | None, roles: Roles
) -> list[str]:
    """Say in how many rows states are beyond the limits that the caller says."""
    rows = sum(map(len, runs))
    counts = {}
    for name in limits or {}:
        state = roles.renamed.get(name, name)
        own = [run.limits[state] for run in runs if state in run.limits]
        counts[state] = sum(int(np.sum(one.known)) for one in own)
    return [
        f"{state!r} is beyond a limit in {count} of {rows} rows, which counts in place of a value."
        for state, count in counts.items()
    ]


def say_noise(
    runs: Sequence[Trajectory], noise: Mapping[str, Any] | None, renamed: Mapping[str, str]
) -> list[Trajectory]:
    """Give runs that know the measurement errors that the caller says.

    Parameters
    ----------
    runs : the trajectories.
    noise : state -> its errors, as :func:`take_trajectories` takes them.
    renamed : name in the source -> name in formulas.

    Raises InputError when something is no state, or its errors cannot be used.
    """
    if not noise:
        return list(runs)
    said = {renamed.get(state, state): own for state, own in noise.items()}
    check_names(said, runs[0].states)
    found = list(runs)
    for state, value in said.items():
        apart = _is_list_for(value, len(runs))
        for i, run in enumerate(found):
            found[i] = _with_noise(run, state, value[i] if apart else value)
    return found


def _with_noise(run: Trajectory, state: str, value: Any) -> Trajectory:
    noise = read_noise(state, value, len(run))
    words = value if isinstance(value, (str, int, float)) else "a value for each row"
    told = {**run.origin.get("said_noise", {}), state: words}
    if isinstance(noise, str):
        if state in run.noise and noise not in run.names:
            # It was read with the table.
            return run
        run, sd = _without(run, noise, state)
        noise = check_noise(state, KnownNoise(sd), f"column {noise!r}")
    if noise.share > 0:  # where the state is 0 what its last digit hides is left
        least = rounding(run.x[:, run.index(state)])
        noise = replace(noise, sd=np.hypot(noise.sd, least))
    return replace(
        run, noise={**run.noise, state: noise}, origin={**run.origin, "said_noise": told}
    )


def _without(run: Trajectory, column: str, state: str) -> tuple[Trajectory, np.ndarray]:
    """Take the column of the errors of a state out of a trajectory."""
    if column not in run.names or column == state:
        raise InputError(
            f"the noise of {state!r} is no number and no column: {column!r}; the columns are: "
            f"{', '.join(run.names)}"
        )
    if column in run.states:
        sd = run.observed[:, run.index(column)]
        return run.of_states([s for s in run.states if s != column]), sd
    place = run.input_names.index(column)
    names = tuple(n for n in run.input_names if n != column)
    less = replace(
        run,
        inputs=np.delete(run.inputs, place, axis=1),
        input_names=names,
        hold={n: way for n, way in run.hold.items() if n != column},
    )
    return less, run.inputs[:, place]


def _listed(names: Sequence[str] | str | None) -> list[str] | None:
    if names is None:
        return None
    given = names.split(",") if isinstance(names, str) else names
    return [str(name).strip() for name in given if str(name).strip()]


def _with_names(columns: Columns, states: Sequence[str] | str | None) -> Columns:
    """Let the caller's state names name the columns of a source that has none."""
    wanted = _listed(states)
    if columns.named or not wanted or set(wanted) <= set(columns.names):
        return columns
    if len(wanted) != len(columns.names) - 1:
        raise InputError(
            f"{len(wanted)} state names ({', '.join(wanted)}) do not fit {columns.label} with "
            f"{len(columns.names) - 1} columns and the time; give one name for each column"
        )
    names = ("t", *wanted)
    old = zip(columns.names, names, strict=True)
    limits = {new: columns.limits[own] for own, new in old if own in columns.limits}
    return replace(columns, names=names, limits=limits)


def _split_inputs(
    inputs: Sequence[str] | Mapping[str, str] | str | None,
) -> tuple[list[str] | None, dict[str, str]]:
    """Separate input columns from ``name=expression in t``; None means that inputs are guessed."""
    if inputs is None:
        return None, {}
    if isinstance(inputs, Mapping):
        return None, {clean_name(k): str(v) for k, v in inputs.items()}
    columns: list[str] = []
    formulas: dict[str, str] = {}
    for item in [inputs] if isinstance(inputs, str) and "=" in inputs else _listed(inputs) or []:
        name, equals, text = item.partition("=")
        if equals:
            formulas[clean_name(name.strip())] = text.strip()
        else:
            columns.append(name)
    return (None if formulas and not columns else columns), formulas


def write_csv(
    trajectories: Trajectory | Sequence[Trajectory],
    path: str | os.PathLike[str],
    *,
    force: bool = False,
) -> None:
    """Write t, the states and the inputs as text, to full precision.

    Parameters
    ----------
    trajectories : one or many; many get a first column ``trajectory`` that counts from 1.
    path : the file, delimited by tabs when its name ends in .tsv, else by commas.
    force : whether a file that is there is replaced.

    Where only a limit is known the cell says so, such as "<0.05". The file appears whole or not at
    all. Raises InputError when it cannot be written, a file is
    there and ``force`` is not given, or the trajectories have different columns.
    """
    import pandas

    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    if not runs:
        raise InputError("there is no trajectory to write; give at least one")
    frames = []
    for number, run in enumerate(runs, start=1):
        if run.names != runs[0].names:
            raise InputError("the trajectories have different columns; write them to several files")
        table = np.column_stack([run.t, run.observed, run.inputs])
        frame = pandas.DataFrame(table, columns=["t", *run.names])
        for state, limits in run.limits.items():
            cells = frame[state].astype(object)
            for mark, limit in (("<", limits.below), (">", limits.above)):
                beyond = np.isfinite(limit)
                cells[beyond] = [f"{mark}{value!r}" for value in limit[beyond].tolist()]
            frame[state] = cells
        if len(runs) > 1:
            frame.insert(0, "trajectory", number)
        frames.append(frame)
    target = Path(path)
    mark = "\t" if target.suffix.lower() == ".tsv" else ","
    text = pandas.concat(frames).to_csv(index=False, sep=mark, lineterminator="\n")
    write_new(target, text, force)


def take_trajectories(
    data: Any,
    inputs: Mapping[str, Any] | Sequence[str] | str | None = None,
    time: float | str | Sequence[Any] | np.ndarray | None = None,
    states: Sequence[str] | str | None = None,
    trajectory: Sequence[str] | str | None = None,
    hold: Mapping[str, str] | str | None = None,
    doses: Mapping[str, str] | None = None,
    quantity: str | None = None,
    decimal: str | None = None,
    noise: Mapping[str, Any] | None = None,
    limits: Mapping[str, Any] | None = None,
    missing: Missing | None = None,
) -> tuple[list[Trajectory], dict[str, sympy.Expr]]:
    """Give the trajectories of the data, and the inputs that are known as expressions in ``t``.

    Parameters
    ----------
    data : a Trajectory, a list of them, ``(t, x)`` arrays or a list of such pairs, a
        :class:`dynsr.data.reading.Table`, or a source of
        :func:`dynsr.data.reading.read_trajectories`.
    inputs : names of columns that are inputs, or expressions such as "F=sin(t)"; or input name ->
        expression in ``t``, function of one time, or values at the times, (n,) or a list of one
        such array a trajectory.
    time, states, trajectory, hold, quantity, decimal : as for
        :func:`dynsr.data.reading.read_trajectories`.
    doses : state -> column of amounts: the state jumps by the amount right after that row, which
        was measured before. Each part between doses counts as a trajectory.
    noise : state -> its measurement errors, as for
        :func:`dynsr.data.reading.read_trajectories`; or (n,) standard deviations at the times, or a
        list of one such array a trajectory.
    limits : state -> the limits of its measurement, as for
        :func:`dynsr.data.reading.read_trajectories`.
    missing : as for :func:`dynsr.data.reading.read_trajectories`.

    Raises InputError when nothing usable is there.

    >>> runs, inputs = take_trajectories(([0.0, *range(1, 9)], np.ones((9, 1))), {"F": "sin(t)"})
    >>> runs[0].names, inputs
    (('x', 'F'), {'F': sin(t)})
    """
    data, time = in_known_form(data, time)
    columns, named = _sort_inputs(inputs)
    errors = find_columns(noise)
    given = read_doses(doses)
    if any(own is not None for own in (time, states, trajectory, quantity, decimal)):
        runs = _read_columns(
            data,
            columns,
            time,
            states,
            trajectory,
            quantity,
            decimal,
            errors,
            given or None,
            limits,
            missing,
        )
    else:
        runs = _read(data, columns, errors, given or None, limits, missing)
    if not runs:
        raise InputError("there is no trajectory in the data; give at least one")
    first = runs[0]
    runs = [_as_inputs(run, in_formulas(columns or [], first)) for run in runs]
    if any(run.names != runs[0].names for run in runs):
        raise InputError("the trajectories have different columns; give all the same columns")
    runs = say_limits(runs, in_formulas(limits or {}, first), {})
    runs = say_noise(runs, in_formulas(noise, first), {})
    runs = cut_at_doses(runs, clean_doses(given or None) or None)
    short = min(runs, key=len)
    if len(short) < FEWEST_ROWS:
        raise InputError(
            f"{len(short)} rows are too few to find equations in; "
            f"give at least {FEWEST_ROWS} a trajectory"
        )
    values = {name: value for name, value in named.items() if not _is_formula(value)}
    drives = {check_name(n, "input"): parse(e, ["t"]) for n, e in named.items() if n not in values}
    runs = [_with_values(run, values, i, len(runs)) for i, run in enumerate(runs)]
    known = [name for name in drives if isinstance(hold, Mapping) and name in hold]
    if known:
        raise InputError(
            f"input {known[0]!r} is an expression in t, which says what it is between rows; "
            "leave it out of hold"
        )
    return decide_hold([with_drives(run, drives) for run in runs], in_formulas(hold, first)), drives


def _sort_inputs(
    inputs: Mapping[str, Any] | Sequence[str] | str | None,
) -> tuple[list[str] | None, dict[str, Any]]:
    """Separate inputs that are columns from those that are given separately."""
    return (None, dict(inputs)) if isinstance(inputs, Mapping) else _split_inputs(inputs)


def _is_formula(value: Any) -> bool:
    return isinstance(value, (str, sympy.Basic, int, float))


def _read(
    data: Any,
    inputs: Sequence[str] | None,
    noise: Mapping[str, str] | None = None,
    doses: Mapping[str, str] | None = None,
    limits: Mapping[str, Any] | None = None,
    missing: Missing | None = None,
) -> list[Trajectory]:
    if isinstance(data, Table):
        return data.trajectories
    if isinstance(data, Trajectory):
        return [data]
    if isinstance(data, (list, tuple)) and data and all(isinstance(d, Trajectory) for d in data):
        if len({run.names for run in data}) == 1:
            return list(data)
        sources = [Source(f"trajectory {i}", [run]) for i, run in enumerate(data, start=1)]
        return join_sources(sources)[0]
    if _is_pair(data):
        return [_from_arrays(data[0], data[1], missing)]
    # A tuple of runs is a list of runs.
    data = list(data) if isinstance(data, tuple) and data else data
    if isinstance(data, list) and data and all(map(_is_pair, data)):
        return _in_one_unit([_from_arrays(pair[0], pair[1], missing) for pair in data])
    return read_trajectories(
        data, inputs=inputs, noise=noise, doses=doses, limits=limits, missing=missing
    ).trajectories


def _read_columns(
    data: Any,
    inputs: Sequence[str] | None,
    time: float | str | Sequence[Any] | np.ndarray | None,
    states: Sequence[str] | str | None,
    trajectory: Sequence[str] | str | None,
    quantity: str | None,
    decimal: str | None,
    noise: Mapping[str, str] | None = None,
    doses: Mapping[str, str] | None = None,
    limits: Mapping[str, Any] | None = None,
    missing: Missing | None = None,
) -> list[Trajectory]:
    """Read trajectories whose columns the caller names."""
    data = data.trajectories if isinstance(data, Table) else data
    apart = time is not None and not _is_named(time, data)
    if apart and states is None and isinstance(data, np.ndarray) and not data.dtype.names:
        return [_from_arrays(time, data, missing)]
    return read_trajectories(
        data,
        time,
        states,
        inputs,
        trajectory,
        quantity=quantity,
        decimal=decimal,
        missing=missing,
        noise=noise,
        doses=doses,
        limits=limits,
    ).trajectories


def _is_pair(data: Any) -> bool:
    """Whether data are times and states, not two runs."""
    if not isinstance(data, tuple) or len(data) != 2 or isinstance(data[0], str):
        return False
    t = data[0]
    runs = isinstance(t, tuple) and any(map(_length, t))
    flat = len(getattr(t, "shape", (1,))) == 1
    return flat and not runs and not isinstance(t, (Trajectory, Mapping))


def _length(part: Any) -> int:
    """Count the values of a sequence; 0 for a plain value."""
    if isinstance(part, (list, tuple)):
        return len(part)
    shape = getattr(part, "shape", ())
    return int(shape[0]) if shape else 0


def _from_arrays(t: Any, x: Any, missing: Missing | None) -> Trajectory:
    for name, values in (("t", t), ("x", x)):
        lengths = {*map(_length, values)} if isinstance(values, (list, tuple)) else {0}
        if len(lengths) > 1:
            raise InputError(
                f"{name} has parts of {min(lengths)} and {max(lengths)} values; give runs of their "
                "own times as a list of pairs, [(t1, x1), (t2, x2)]"
            )
    table, unit = beside(t, x)
    names = names_of_states(table.shape[1] - 1)
    origin = {"time_unit": unit} if unit else {}
    found = without_codes(Columns(("t", *names), tuple(table.T), "the arrays"), missing)
    for note in found.notes:
        warnings.warn(note, DynsrWarning, stacklevel=2)
    x = dict(zip(found.names, found.values, strict=True))
    made = Trajectory(x["t"], np.column_stack([x[n] for n in names]), names, origin=origin)
    (run,), turns = unwrap_angles([made])
    for note in turns:
        warnings.warn(note, DynsrWarning, stacklevel=2)
    return run


def in_formulas(asked: Any, run: Trajectory) -> Any:
    """Give what a caller says of columns with the names that these have in formulas.

    Parameters
    ----------
    asked : the name of a column, a list of them, or a mapping from them; all else stays as it is.
    run : one of the trajectories.

    >>> t = np.arange(9.0)
    >>> (run,) = read_trajectories({"t": t, "x (m)": t**2}).trajectories
    >>> in_formulas({"x (m)": "-x"}, run), in_formulas(["x", "all"], run), in_formulas(True, run)
    ({'x': '-x'}, ['x', 'all'], True)
    """
    renamed: Mapping[str, str] = run.origin.get("table", {}).get("renamed", {})

    def own(name: Any) -> Any:
        if not isinstance(name, str) or name in run.names:
            return name
        new = renamed.get(name) or clean_name(name)
        return new if new in run.names else name

    if isinstance(asked, Mapping):
        return {own(name): value for name, value in asked.items()}
    return [own(name) for name in asked] if isinstance(asked, (list, tuple)) else own(asked)


def _as_inputs(run: Trajectory, columns: Sequence[str]) -> Trajectory:
    """Move state columns to the inputs."""
    moved = [name for name in columns if name not in run.input_names]
    for name in moved:
        run.index(name)
    if not moved:
        return run
    kept = [name for name in run.states if name not in moved]
    if not kept:
        raise InputError("every column is an input; leave at least one state")
    extra = [between_rows(run.t, run.observed[:, run.index(name)]) for name in moved]
    inputs = np.column_stack([run.inputs, *extra])
    return replace(run.of_states(kept), inputs=inputs, input_names=(*run.input_names, *moved))


def column_units(run: Trajectory, units: Mapping[str, str] | str | None) -> dict[str, str] | None:
    """Give the units of columns as the caller says, and that of the time where the data show it.

    Parameters
    ----------
    run : a trajectory.
    units : column, or "t", -> unit; "columns" for those in the names of the columns; or lines such
        as "x=m, t=s"; None for none.

    Raises InputError when they cannot be read or the columns say none.
    """
    if units is None:
        return None
    if units == "columns":
        # A column of doses has a unit too, and is in no equation.
        own: Mapping[str, str] = run.origin.get("units", {})
        given = {name: unit for name, unit in own.items() if name in run.names}
        if not given:
            raise InputError(
                "no column has a unit in its name, such as 'x [m]'; name them: x=m,t=s"
            )
    elif isinstance(units, str):
        pairs = [pair.partition("=") for pair in units.split(",") if pair.strip()]
        given = {name.strip(): text.strip() for name, _, text in pairs}
    else:
        given = {str(name): str(text) for name, text in units.items()}
    return {**({"t": run.time_unit} if run.time_unit else {}), **given}


def _with_values(run: Trajectory, given: Mapping[str, Any], number: int, count: int) -> Trajectory:
    """Put inputs that are functions of the time or values to the columns of one of the runs."""
    for name, value in given.items():
        if check_name(name, "input") in run.names:
            raise InputError(f"input {name!r} is a column already; give it another name")
        own = value[number] if _is_list_for(value, count) else value
        column = sample_input(name, own, run.t)
        inputs = np.column_stack([run.inputs, column])
        run = replace(run, inputs=inputs, input_names=(*run.input_names, name))
    return run


def _is_list_for(value: Any, count: int) -> bool:
    """Whether an input is a list of one array a trajectory."""
    return (
        isinstance(value, (list, tuple))
        and len(value) == count
        and all(callable(own) or np.ndim(own) == 1 for own in value)
    )


def sample_input(name: str, value: Any, t: np.ndarray) -> np.ndarray:
    """Give the values of an input at times.

    Parameters
    ----------
    name : what a message calls it.
    value : a function of one time or of all of them, or the (n,) values.
    t : (n,) times.

    Raises InputError when they do not fit the times or are not finite.

    >>> sample_input("F", lambda t: 2 * t, np.array([0.0, 1.0])).tolist()
    [0.0, 2.0]
    """
    found = value
    if callable(value):
        try:
            found = np.asarray(value(t), dtype=float)
        except (TypeError, ValueError):  # a function of one time
            found = None
        if found is None or found.shape != t.shape:
            found = [value(one) for one in t.tolist()]
    found = as_floats(found, f"input {name!r}")
    if found.shape != t.shape:
        raise InputError(
            f"input {name!r} has shape {found.shape} but there are {len(t)} times; give one value "
            "a time, an expression in t, or a function of t"
        )
    bad = np.flatnonzero(~np.isfinite(found))
    if bad.size:
        raise InputError(
            f"input {name!r} is {found[bad[0]]} at t = {t[bad[0]]:g}; it must be finite"
        )
    return found


def with_drives(run: Trajectory, drives: Mapping[str, sympy.Expr]) -> Trajectory:
    """Add the values of inputs that are expressions to the columns.

    Parameters
    ----------
    run, drives : the run, and input name -> expression in ``t``; columns that are there stay.

    Raises InputError where a name is that of a state.
    """
    new = {name: expr for name, expr in drives.items() if name not in run.input_names}
    clash = [name for name in new if name in run.states]
    if clash:
        raise InputError(f"input {clash[0]!r} is already a state; give it another name")
    if not new:
        return run
    values = compile_numpy(list(new.values()), ["t"])(run.t[None]).T
    inputs = np.column_stack([run.inputs, values])
    return replace(run, inputs=inputs, input_names=(*run.input_names, *new))


def split_held_back(
    runs: Sequence[Trajectory], share: float = 0.2, fewest: int = 12
) -> tuple[list[Trajectory], list[Trajectory]]:
    """Hold rows back: whole trajectories when there are enough of them, else each one's tail.

    Parameters
    ----------
    runs : the trajectories.
    share : the share of the trajectories, or of each one's rows, that is held back.
    fewest : a tail of fewer rows shows nothing, so that nothing is held back.

    >>> t = np.arange(100.0)
    >>> training, held_back = split_held_back([Trajectory(t, t[:, None], ("x",))])
    >>> len(training[0]), len(held_back[0])
    (80, 20)
    """
    if len(runs) * share >= 1:
        last = round(share * len(runs))
        return list(runs[:-last]), list(runs[-last:])
    cuts = [round((1 - share) * len(run)) for run in runs]
    if min(len(run) - cut for run, cut in zip(runs, cuts, strict=True)) < fewest:
        return list(runs), []
    return (
        [run.select(slice(None, cut)) for run, cut in zip(runs, cuts, strict=True)],
        [run.select(slice(cut, None)) for run, cut in zip(runs, cuts, strict=True)],
    )
