"""Description: how the columns of a table were understood, as a value, as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import Any

import numpy as np

from dynsr.arguments import checked
from dynsr.data.name_parts import bare_name
from dynsr.data.names import clean_name
from dynsr.data.oddities import OddSettings
from dynsr.data.roles import Roles
from dynsr.data.trajectory import Trajectory

_UNITS = {"s": "seconds", "min": "minutes", "h": "hours"}
_HOLDS = {"previous": "held until the next row", "linear": "straight lines", "smooth": "smooth"}
_SHORT = {"previous": "held", "linear": "linear", "smooth": "smooth"}
_MOST_RUNS = 12


@dataclass(frozen=True)
class TimeColumn:
    """The times of a table.

    Parameters
    ----------
    column : the name in the source; those of the date and the clock, with a comma between.
    unit : "s", "min", "h", "days" or such; "" where nothing says it.
    step : the median of the steps, in that unit.
    steps : the shortest and the longest of them.
    begins : the date that is counted from, where the times are dates; else "".
    """

    column: str
    unit: str = ""
    step: float = 0.0
    steps: tuple[float, float] = (0.0, 0.0)
    begins: str = ""

    @property
    def even(self) -> bool:
        """Whether all steps are the same; times of few digits differ in the last one."""
        low, high = self.steps
        return high - low <= OddSettings().even * high

    @property
    def counted(self) -> str:
        """How the times are counted, in words that follow the column; "" if unknown."""
        since = f" since {self.begins}" if self.begins else ""
        return f" in {_UNITS.get(self.unit, self.unit)}{since}" if self.unit else ""

    @property
    def spacing(self) -> str:
        """How far the rows are apart, in words."""
        low, high = self.steps
        return (
            f"every {self.step:.4g}" if self.even else f"in uneven steps of {low:.3g} to {high:.3g}"
        )


@dataclass(frozen=True)
class RunRows:
    """The rows of one trajectory.

    Parameters
    ----------
    name : what its column of labels says, or its number.
    rows : how many there are.
    first, last : the times that it begins and ends at.
    """

    name: str
    rows: int
    first: float
    last: float


@checked
@dataclass(frozen=True)
class Description:
    """How a table is understood.

    Columns are called as in formulas, but for what is not used, which keeps its name in
    the source. ``print`` shows it, :meth:`to_dict` gives it as JSON has it.

    Parameters
    ----------
    source : what the table is called.
    time : the column of the times, with its unit and its steps.
    trajectories : the runs, each with its rows.
    states : what equations are searched for.
    inputs : what equations may contain in addition to the states.
    parameters : numbers that are constant within each trajectory and differ between them.
    named_by : the columns whose values together name a trajectory; () where only the time shows it.
    formulas : input that is an expression in ``t`` -> that expression.
    hold : input -> "previous", "linear" or "smooth": what it does between rows.
    units : column -> its unit, where the source says one.
    renamed : column of the source -> its name in formulas, where the two differ.
    noise : state -> the column of its measurement errors.
    doses : state -> the column of the amounts by which it jumps.
    given : state -> how many rows have such an amount.
    volumes : state -> what its amounts are divided by: a number, or the name of a volume that is
        fitted.
    labels : columns that only distinguish trajectories.
    left_out : column that is not used -> why.
    notes : sentences on what was noticed, assumed, or looks odd.
    options : what would change this: an option of the shell -> what comes of it.
    """

    source: str
    time: TimeColumn
    trajectories: tuple[RunRows, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    named_by: tuple[str, ...] = ()
    formulas: Mapping[str, str] = field(default_factory=dict)
    hold: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    renamed: Mapping[str, str] = field(default_factory=dict)
    noise: Mapping[str, str] = field(default_factory=dict)
    labels: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    options: Mapping[str, str] = field(default_factory=dict)
    doses: Mapping[str, str] = field(default_factory=dict)
    given: Mapping[str, int] = field(default_factory=dict)
    volumes: Mapping[str, str] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """How many rows all trajectories have together."""
        return sum(run.rows for run in self.trajectories)

    @property
    def sentence(self) -> str:
        """How the columns were understood, in one sentence."""
        time, runs = self.time, self.trajectories
        names = ", ".join(map(repr, self.named_by))
        many = f"named by {names}" if names else ", each starting the time again"
        head = f"time {time.column!r}{time.counted}, "
        head += f"{len(runs)} trajectories {many}, ".replace(" ,", ",") if len(runs) > 1 else ""
        first, last = min(run.first for run in runs), max(run.last for run in runs)
        clauses = [f"{head}{self.rows} rows from {first:g} to {last:g} {time.spacing}"]
        clauses.append(f"states {', '.join(self.states)}")
        inputs = [
            f"{name} = {self.formulas[name]}"
            if name in self.formulas
            else f"{name} ({_SHORT[self.hold[name]]})"
            for name in self.inputs
        ]
        if inputs:
            clauses.append(f"inputs {', '.join(inputs)}")
        clauses += [f"{state} jumps by {self._dose(state)}" for state in self.doses]
        if self.parameters:
            names = ", ".join(self.parameters)
            clauses.append(f"constant within each trajectory, so taken for parameters: {names}")
        if self.labels:
            names = ", ".join(map(repr, self.labels))
            clauses.append(f"taken for labels of trajectories, not used: {names}")
        if self.left_out:
            unused = [f"{name!r} ({why})" for name, why in self.left_out.items()]
            clauses.append(f"not used: {', '.join(unused)}")
        return f"{self.source}: {'; '.join(clauses)}"

    def to_dict(self) -> dict[str, Any]:
        """Give it as plain values, as JSON has them.

        >>> from dynsr.data import describe
        >>> t = np.linspace(0, 1, 11)
        >>> plain = describe({"t": t, "x": t**2}).to_dict()
        >>> plain["states"], plain["trajectories"]
        (['x'], [{'name': '1', 'rows': 11, 'from': 0.0, 'to': 1.0}])
        """
        return {
            "source": self.source,
            "time": {
                "column": self.time.column,
                "unit": self.time.unit,
                "step": self.time.step,
                "steps": list(self.time.steps),
                "begins": self.time.begins,
            },
            "trajectories": [
                {"name": run.name, "rows": run.rows, "from": run.first, "to": run.last}
                for run in self.trajectories
            ],
            "named_by": list(self.named_by),
            "states": list(self.states),
            "inputs": list(self.inputs),
            "parameters": list(self.parameters),
            "formulas": dict(self.formulas),
            "hold": dict(self.hold),
            "units": dict(self.units),
            "renamed": dict(self.renamed),
            "noise": dict(self.noise),
            "doses": dict(self.doses),
            "volumes": dict(self.volumes),
            "labels": list(self.labels),
            "left_out": dict(self.left_out),
            "notes": list(self.notes),
            "options": dict(self.options),
        }

    def __str__(self) -> str:
        """Give a line for each role, then what was noticed, then what would change it."""
        shown = [(head, lines) for head, lines in self._parts() if lines]
        width = max(len(head) for head, _ in shown)
        pairs = [(head, lines[0], lines[1:]) for head, lines in shown]
        text = [self.source]
        for head, first, rest in pairs:
            text.append(f"  {head:{width}}  {first}")
            text += [f"  {'':{width}}  {line}" for line in rest]
        return "\n".join(text)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"

    def _parts(self) -> Iterator[tuple[str, list[str]]]:
        time, runs = self.time, self.trajectories
        first, last = min(run.first for run in runs), max(run.last for run in runs)
        rows = f"{first:g} to {last:g} {time.spacing}"
        yield "time", [f"{time.column!r}{time.counted}, {self.rows} rows from {rows}"]
        if len(runs) > 1:
            names = ", ".join(map(repr, self.named_by))
            named = f"named by {names}" if names else "each starting the time again"
            yield "trajectories", [f"{len(runs)}, {named}:", *self._runs()]
        yield "states", [", ".join(map(self._named, self.states))]
        inputs = [n for n in self.inputs if n not in self.formulas]
        lines = [f"{self._named(name)}: {_HOLDS[self.hold[name]]}" for name in inputs]
        yield "inputs", [*lines, *(f"{name} = {text}" for name, text in self.formulas.items())]
        parameters = ", ".join(map(self._named, self.parameters))
        yield "parameters", [parameters] if parameters else []
        yield "noise", [f"of {state}: {column!r}" for state, column in self.noise.items()]
        yield (
            "doses",
            [
                f"{state} jumps by {self._dose(state)} after {_count_rows(self.given[state])}"
                if self.given[state]
                else f"{state} jumps by {self._dose(state)} where a trajectory begins"
                for state in self.doses
            ],
        )
        yield "labels", [", ".join(map(repr, self.labels))] if self.labels else []
        yield "left out", [f"{column!r}: {why}" for column, why in self.left_out.items()]
        yield "notes", list(self.notes)
        yield "to change", [f"{option}   {effect}" for option, effect in self.options.items()]

    def _dose(self, state: str) -> str:
        volume = self.volumes.get(state, "")
        fitted = volume.isidentifier()
        divided = f"{self.doses[state]}/{volume}" if volume else self.doses[state]
        return f"{divided} (the volume {volume} is fitted)" if fitted else divided

    def _named(self, name: str) -> str:
        said = f"{name} [{self.units[name]}]" if name in self.units else name
        own = next((column for column, new in self.renamed.items() if new == name), "")
        return f"{said} (column {own!r})" if own and bare_name(own) != name else said

    def _runs(self) -> list[str]:
        width = max(len(run.name) for run in self.trajectories[:_MOST_RUNS])
        lines = [
            f"{run.name:{width}}  {run.rows} rows from {run.first:g} to {run.last:g}"
            for run in self.trajectories[:_MOST_RUNS]
        ]
        hidden = len(self.trajectories) - _MOST_RUNS
        return [*lines, f"and {hidden} more"] if hidden > 0 else lines


def _count_rows(count: int) -> str:
    return "1 row" if count == 1 else f"{count} rows"


def _count_given(runs: Sequence[Trajectory], doses: Mapping[str, str]) -> dict[str, int]:
    """State -> in how many rows an amount is given to it."""
    return {
        state: sum(int(np.sum(run.by_name[column] != 0)) for run in runs)
        for state, column in doses.items()
    }


def describe_runs(
    source: str,
    runs: Sequence[Trajectory],
    roles: Roles,
    formulas: Mapping[str, str],
    left_out: Mapping[str, str],
    notes: Sequence[str],
    volumes: Mapping[str, str] | None = None,
) -> Description:
    """Say how a table was understood.

    Parameters
    ----------
    source : what a message calls it.
    runs : the trajectories that it became.
    roles : the roles of its columns.
    formulas : inputs that are expressions in ``t``.
    left_out : column that is not used -> why.
    notes : sentences on what was noticed.
    volumes : state of the source -> what its doses are divided by.
    """
    steps = np.concatenate([np.diff(run.t) for run in runs])
    time = TimeColumn(
        ", ".join([roles.time, *([roles.clock] if roles.clock else [])]),
        runs[0].time_unit,
        float(np.median(steps)),
        (float(steps.min()), float(steps.max())),
        _first_date(runs),
    )
    used = {name: roles.renamed[name] for name in (*roles.states, *roles.inputs)}
    parameters = tuple(used[name] for name in roles.parameters)
    doses = {used[state]: used[column] for state, column in roles.doses.items()}
    apart = {*roles.parameters, *roles.doses.values()}
    inputs = tuple(used[name] for name in roles.inputs if name not in apart)
    found = Description(
        source,
        time,
        tuple(_rows_of(run, number) for number, run in enumerate(runs, start=1)),
        tuple(used[name] for name in roles.states),
        (*inputs, *formulas),
        parameters,
        roles.trajectory,
        dict(formulas),
        {name: runs[0].holds[name] for name in inputs},
        dict(runs[0].origin.get("units", {})),
        {name: new for name, new in used.items() if name != new},
        {roles.renamed.get(state, state): column for state, column in roles.noise.items()},
        roles.labels,
        dict(left_out),
        tuple(notes),
        doses=doses,
        given=_count_given(runs, doses),
        volumes={used[state]: volume for state, volume in (volumes or {}).items()},
    )
    amounts = [used[name] for name in roles.amounts]
    return replace(found, options=dict(_options(found, amounts)))


def _first_date(runs: Sequence[Trajectory]) -> str:
    """Give the date that times are counted from, as ISO 8601 writes it; "" where there is none."""
    kind, seconds = runs[0].origin.get("begins", ("", 0.0))
    if kind != "date":
        return ""
    moment = np.datetime64(0, "s") + np.timedelta64(round(seconds), "s")
    day, clock = str(moment).split("T")
    return day if clock == "00:00:00" else f"{day} {clock.removesuffix(':00')}"


def _rows_of(run: Trajectory, number: int) -> RunRows:
    name = str(run.origin.get("name", number))
    return RunRows(name, len(run), float(run.t[0]), float(run.t[-1]))


def _options(found: Description, amounts: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Give the options that would change a description, with what comes of each."""
    columns = [name for name in found.inputs if name not in found.formulas]
    for name in amounts:
        for state in found.states[:2]:
            yield f"--dose {state}={name}", f"{state} jumps by {name}, right after such a row"
    for name in columns:
        yield f"--states {','.join([*found.states, name])}", f"{name} is a state too"
    for name in columns:
        if found.hold.get(name) == "previous":
            yield f"--hold {name}=linear", f"{name} runs straight from row to row"
        else:
            yield f"--hold {name}=previous", f"{name} keeps its value until the next row"
    for name in found.states[-1:] if len(found.states) > 1 else ():
        yield f"--inputs {','.join([*columns, name])}", f"{name} is an input and has no equation"
    if found.units:
        yield "--units columns", "checks the units of every equation, and gives constants theirs"
    for name in found.parameters if not found.named_by else ():
        yield f"--trajectory {name}", f"{name} only names the trajectories, and is in no equation"
    if found.labels and found.named_by:
        both = ",".join(map(clean_name, (*found.named_by, *found.labels)))
        yield f"--trajectory {both}", "these columns together name the trajectories"


def join_descriptions(
    parts: Sequence[Description], runs: Sequence[Trajectory], joined: str = ""
) -> Description:
    """Say how several tables were understood together.

    Parameters
    ----------
    parts : how each one was understood.
    runs : their trajectories, all counted in one unit.
    joined : says that they measured the same experiments; "" where each holds runs of its own.
    """
    names = [_name_within(part, run) for part in parts for run in part.trajectories]
    if joined:
        names = [str(run.origin.get("name", "")) for run in runs]
    if len(set(names)) < len(names):
        names = [str(number) for number in range(1, len(names) + 1)]
    steps = np.concatenate([np.diff(run.t) for run in runs])
    first = parts[0]
    rows = [
        RunRows(name, len(run), float(run.t[0]), float(run.t[-1]))
        for name, run in zip(names, runs, strict=True)
    ]
    notes = [*([joined] if joined else []), *(note for part in parts for note in part.notes)]
    doses = {state: column for part in parts for state, column in part.doses.items()}
    apart = {*doses.values(), *(name for part in parts for name in part.parameters)}
    inputs = [name for name in runs[0].input_names if name not in apart]
    formulas = {name: text for part in parts for name, text in part.formulas.items()}
    return replace(
        first,
        source=", ".join(dict.fromkeys(part.source for part in parts)),
        time=TimeColumn(
            first.time.column,
            runs[0].time_unit,
            float(np.median(steps)),
            (float(steps.min()), float(steps.max())),
        ),
        trajectories=tuple(rows),
        states=runs[0].states,
        inputs=tuple(inputs),
        parameters=tuple(dict.fromkeys(name for part in parts for name in part.parameters)),
        formulas=formulas,
        hold={name: runs[0].holds[name] for name in inputs if name not in formulas},
        units={name: unit for part in parts for name, unit in part.units.items()},
        renamed={old: new for part in parts for old, new in part.renamed.items()},
        noise={state: column for part in parts for state, column in part.noise.items()},
        labels=tuple(dict.fromkeys(name for part in parts for name in part.labels)),
        left_out={name: why for part in parts for name, why in part.left_out.items()},
        notes=tuple(dict.fromkeys(notes)),
        doses=doses,
        given=_count_given(runs, doses),
        volumes={state: volume for part in parts for state, volume in part.volumes.items()},
    )


def _name_within(part: Description, run: RunRows) -> str:
    return part.source if len(part.trajectories) == 1 else f"{part.source}: {run.name}"
