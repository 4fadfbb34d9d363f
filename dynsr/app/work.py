"""Work: what the page asks for, done with the public interface, as plain values and markup.

All of it runs in a process of its own, so that the page answers while a search runs, and a search
can be ended whatever it does.
"""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynsr.app.fields import in_fields
from dynsr.data import (
    Columns,
    bracketed_unit,
    clean_dose,
    column_units,
    cut_at_doses,
    describe_table,
    in_unit,
    load_columns,
    read_sums,
    read_trajectories,
    write_bytes,
    write_text,
)
from dynsr.discovery import (
    RECORD,
    Discovery,
    discover,
    keep,
    keep_formulas,
    next_to_data,
    write_lines,
)
from dynsr.errors import DynsrError, DynsrWarning, InputError, one_line, quoted
from dynsr.export import Source, list_formats, name_file, pack_format
from dynsr.expression import (
    NAMED_FUNCTIONS,
    arguments_of,
    left_of,
    parse,
    shown,
    to_mathml,
    to_text,
)
from dynsr.fit import ParetoFront, tidy
from dynsr.jobs import REPORT, clock, say_left
from dynsr.methods import DEFAULT_PRESET, PRESETS
from dynsr.report import (
    Picture,
    draw_states,
    list_by_run,
    list_fixed_points,
    show_branches,
    show_flow,
    show_noise,
)
from dynsr.verdict import write_map_mathml

if TYPE_CHECKING:
    import sympy

    from dynsr.data import Description, Limits, Trajectory
    from dynsr.jobs import Step
    from dynsr.report import Table

# What the page calls the files, and what they are.
CODE = "model.py"
FILES = (REPORT, CODE, RECORD)
# What was found, for a process that takes the place of one that was ended by force.
_KEPT = "kept"
TIME, TRAJECTORY, QUANTITY = "time", "trajectory", "quantity"
STATE, INPUT, DOSE, UNUSED = "state", "input", "dose", "unused"
SUM, ERROR = "sum", "error"
_PREVIEW_ROWS = 8
_LONGEST_CELL = 40
# A picture of more rows shows no more, and more columns are no preview.
_MOST_ROWS = 2000
_MOST_STEPS = 200
_MOST_COLUMNS = 200
_MOST_PANELS = 4
# What is kept of a search that was ended by force.
_OF_RECORD = ("order", "explicit_time", "discrete", "preset", "seed", "column_units")
_NUMBERS = ("max_complexity", "time_budget", "seed")
# In the place of names or numbers: the data decide.
_BY_DATA = "*"
_NOTHING = "there are no equations yet; press Find equations first"
_SWITCHES = ("snap", "explicit_time", "discrete", "ensemble", "stochastic")

Say = Callable[[str, Any], None]


class Work:
    """What has been read and found so far, and the jobs that the page can ask for.

    Parameters
    ----------
    folder : where the files for downloading are written.
    say : called with the name of a part of the page and its new content, from any thread.
    jobs : searches at a time; -1 uses every core.
    """

    def __init__(self, folder: Path, say: Say, jobs: int = -1) -> None:
        """Begin without data."""
        self._folder, self._jobs = folder, jobs
        self._say: Say = lambda name, content: say(name, in_fields(content))
        self._source: tuple[str, Columns] | None = None
        self._reshaped: tuple[str, ...] = ()
        # Column that is called the errors of a state -> that state.
        self._called: dict[str, str] = {}
        self._runs: list[Trajectory] = []
        self._names: list[str] = []
        self._units: dict[str, str] = {}
        self._doses: dict[str, str] = {}
        self._sums: dict[str, str] = {}
        self._states: tuple[str, ...] = ()
        self._found: Discovery | None = None

    def offer(self) -> None:
        """Say what can be chosen."""
        self._say(
            "choices",
            {"presets": PRESETS, "preset": DEFAULT_PRESET, "functions": NAMED_FUNCTIONS},
        )

    def read(
        self,
        path: str,
        roles: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        ways: Mapping[str, str] | None = None,
        errors: Mapping[str, str] | None = None,
        limits: Mapping[str, str] | None = None,
    ) -> None:
        """Read a file and show its columns, with the roles that are guessed or given.

        Parameters
        ----------
        path : the file.
        roles : column -> its role; guessed by default.
        units : column -> its unit; by default that in its name.
        ways : input -> what it does between rows; column of doses -> the state that jumps by them,
            with ``/V`` behind it where they are divided by a volume that is fitted; sum -> the sum
            of states that it is; column of errors -> the state whose errors they are, with ``*``
            behind it where only their ratios are known.
        errors : state -> its errors of measurement, such as "0.1" or "5 %".
        limits : state -> the limit of its measurement, such as "0.05".

        Columns are shown also where they cannot be used, with the reason. Raises InputError where
        not even columns can be distinguished.
        """
        self._runs, self._found = [], None
        if self._source is None or self._source[0] != path:
            self._source = None
            with _heard() as notes, _by_name(path):
                columns = load_columns(path)
            self._source = path, replace(columns, notes=(*columns.notes, *notes))
        columns = self._source[1]
        said = _Said.of(columns.names, roles, units, ways, errors, limits)
        with _heard() as notes:
            try:
                view = self._understand(columns, said)
            except InputError as error:
                self._runs = []
                guessed = roles or {n: STATE for n in columns.names if _is_number(columns, n)}
                view = self._describe(columns, replace(said, roles=guessed))
                view["error"] = one_line(error)
        self._say("table", {**view, "notes": list(dict.fromkeys([*notes, *view["seen"]]))})
        self._say("preview", self._preview() if self._runs else None)

    def _preview(self) -> dict[str, str]:
        """Draw the first trajectory, and say which it is and what of it is drawn."""
        run, count = self._runs[0], len(self._runs)
        which = f"Trajectory {self._names[0]!r}, the first of {count}." if count > 1 else ""
        left = len(run.states) - _MOST_PANELS
        some = f"The first {_MOST_PANELS} of {len(run.states)} states." if left > 0 else ""
        svg = _draw(_at_a_glance(run), None)
        return {"svg": svg, "said": " ".join(filter(None, (which, some)))}

    def _understand(self, columns: Columns, said: _Said) -> dict[str, Any]:
        roles, units, ways = said.roles, said.units, said.ways
        if roles is None:
            table = read_trajectories(columns)
        else:
            of = {role: [n for n in columns.names if roles.get(n) == role] for role in _ROLES}
            if len(of[QUANTITY]) > 1:
                both = " and ".join(map(repr, of[QUANTITY][:2]))
                raise InputError(f"columns {both} are both the quantity; choose one")
            # A limit or an error may be the name of a column.
            other = {*said.errors.values(), *said.limits.values()}
            used = columns.only(
                [n for n in columns.names if roles.get(n, UNUSED) != UNUSED or n in other]
            )
            measured = [n for n in columns.names if roles.get(n) in _MEASURED]
            noise = {n: said.errors[n] for n in measured if n in said.errors}
            # States of such columns have names of their own.
            reshaped = bool(self._reshaped) and set(self._reshaped) <= set(of[STATE])
            table = read_trajectories(
                used,
                tuple(of[TIME]) or None,
                None if reshaped or of[QUANTITY] else measured,
                of[INPUT],
                of[TRAJECTORY] or None,
                quantity=next(iter(of[QUANTITY]), "none"),
                hold={n: ways[n] for n in of[INPUT] if ways.get(n)} or None,
                doses=_given_to(of[DOSE], of[STATE], ways),
                noise={**noise, **_errors_of(of[ERROR], measured, ways)} or None,
                limits={n: said.limits[n] for n in measured if n in said.limits} or None,
            )
        found = table.roles
        assert found is not None
        if roles is None:
            named = dict.fromkeys((found.time, found.clock), TIME)
            named |= dict.fromkeys(found.inputs, INPUT)
            named |= dict.fromkeys(found.doses.values(), DOSE)
            named |= dict.fromkeys(found.trajectory, TRAJECTORY)
            named |= dict.fromkeys((*found.states, *found.reshaped), STATE)
            self._called = {column: state for state, column in found.noise.items()}
            named |= dict.fromkeys(self._called, ERROR)
            ways = {column: f"{state}{_RATIOS}" for column, state in self._called.items()}
            named[found.quantity] = QUANTITY
            roles = {n: named.get(n, UNUSED) for n in columns.names}
            self._reshaped = () if found.quantity else found.reshaped
            own = {n: bracketed_unit(n) for n in columns.names}
            units = {**own, found.time: table.trajectories[0].time_unit or own[found.time]}
        self._runs = _counted_in(table.trajectories, units.get(found.time, ""))
        sums = [n for n in columns.names if roles.get(n) == SUM]
        if unsaid := [name for name in sums if not ways.get(name)]:
            raise InputError(f"column {unsaid[0]!r} is a sum; type of which states, such as S + I")
        self._sums = {found.renamed.get(name, name): ways[name] for name in sums}
        self._states = read_sums(self._runs, self._sums)[0].states
        self._units = {
            name: units[own]
            for own, name in {**found.renamed, found.time: "t"}.items()
            if units.get(own)
        }
        described = describe_table(table)
        self._names = [run.name for run in described.trajectories]
        asked = _given_to(list(found.doses.values()), list(found.doses), ways) or {}
        self._doses = {found.renamed.get(s, s): clean_dose(text) for s, text in asked.items()}
        given = ways
        ways = {n: described.hold.get(found.renamed.get(n, ""), "") for n in found.inputs}
        of_states = {**found.doses, **found.noise}
        ways |= {column: given.get(column) or state for state, column in of_states.items()}
        ways |= {name: given[name] for name in sums}
        return {
            **self._describe(columns, replace(said, roles=roles, units=units, ways=ways)),
            "guess": table.guess,
            "seen": _seen(described),
            "states": list(self._states),
            "runs": len(self._names),
        }

    def _describe(self, columns: Columns, said: _Said) -> dict[str, Any]:
        """Give what the page shows of columns: names, roles, what is said, and the first rows."""
        shown_names = columns.names[:_MOST_COLUMNS]
        kinds = {"f": "number", "M": "date", "m": "duration"}
        roles = said.roles or {}
        # States of quantities, and of runs side by side, have no columns of their own.
        apart = columns.names if QUANTITY in roles.values() else self._reshaped
        return {
            "rows": len(columns.values[0]),
            "hidden": len(columns.names) - len(shown_names),
            "columns": [
                {
                    "name": name,
                    "kind": kinds.get(values.dtype.kind, "text"),
                    "role": roles.get(name, UNUSED),
                    "unit": said.units.get(name, ""),
                    "way": said.ways.get(name, ""),
                    "error": said.errors.get(name, ""),
                    "limit": said.limits.get(name, ""),
                    "own": name not in apart,
                    "open": bool(name in columns.limits and _is_open(columns.limits[name])),
                    "called": self._called.get(name, ""),
                    "cells": _cells(values[:_PREVIEW_ROWS], columns.limits.get(name)),
                }
                for name, values in zip(shown_names, columns.values, strict=False)
            ],
            "loaded": list(columns.notes),
            "guess": "",
            "seen": [],
            "states": [],
            "runs": 0,
            "error": "",
        }

    def search(self, options: Mapping[str, Any]) -> None:
        """Search the equations of what was read; reports how it goes on, and what was found.

        Parameters
        ----------
        options : what the page asks for, by the names of :func:`dynsr.discover`; ``units`` says
            whether those of the columns are used, ``second_order`` and ``nonnegative`` that all
            states are so.
        """
        if not self._runs:
            raise InputError("there are no data to search; drop a file first")
        self._found = None
        settings = self._read_options(options)
        watch = Live(self._states, self._say)
        with _heard() as notes:
            found = discover(
                list(self._runs),
                jobs=self._jobs,
                progress=watch,
                doses=self._doses or None,
                observed=self._sums or None,
                **settings,
            )
        self._take(found, notes)
        self.redraw({}, 0)

    def keep(self, formulas: Mapping[str, str], options: Mapping[str, Any]) -> None:
        """Take the formulas, without a verdict, that a search reported before its forced end.

        Parameters
        ----------
        formulas : state -> the formula.
        options : what the search was asked for.
        """
        asked = self._read_options(options)
        asked |= {"column_units": asked["units"]} if "units" in asked else {}
        known = {n: asked[n] for n in _OF_RECORD if n in asked}
        exprs = {state: parse(text) for state, text in formulas.items()}
        found = keep_formulas(exprs, self._parts(), **known)
        if odd := [
            n for n in arguments_of(found.equations) if n not in found.trajectories[0].names
        ]:
            raise InputError(
                f"the best so far contains {odd[0]!r}, which only a whole search determines; "
                "search again"
            )
        self._take(found, [])

    def restore(self) -> None:
        """Take again what was found by a process that was ended by force later."""
        found = Discovery.load(self._folder / _KEPT)
        # Very many data are not kept.
        self._take(found if found.trajectories else next_to_data(found, self._parts()), [])

    def _parts(self) -> list[Trajectory]:
        """Give the trajectories as a search has them: cut at doses, with the states of sums."""
        return read_sums(cut_at_doses(self._runs, self._doses or None), self._sums)

    def _read_options(self, options: Mapping[str, Any]) -> dict[str, Any]:
        settings = read_options(options, self._states)
        if options.get("units"):
            if not self._units:
                raise InputError("no column has a unit; type one below its name")
            settings["units"] = column_units(self._runs[0], self._units)
        return settings

    def _take(self, found: Discovery, notes: Sequence[str]) -> None:
        self._found = found
        # One that is complete would else stay in the place of one that is not.
        shutil.rmtree(self._folder / _KEPT, ignore_errors=True)
        keep(found, self._folder / _KEPT)
        count = len(found.carried)
        names = self._names if len(self._names) == count else [str(i + 1) for i in range(count)]
        more = {"notes": list(dict.fromkeys(notes)), "runs": names}
        self._say("found", {**show_found(found), **more})

    def write(self, name: str) -> None:
        """Write one of FILES of what was found, or a file of an export, for downloading.

        Parameters
        ----------
        name : its name.
        """
        found, target = self._found, self._folder / name
        if found is None:
            raise InputError(_NOTHING)
        if name == REPORT:
            found.report(target)
        elif name == RECORD:
            found.save(target)
        elif name == CODE:
            write_text(target, found.to_python())
        else:
            source = Source.of(found)
            own = next((f for f in list_formats(source) if name_file(f) == name), None)
            if own is None:
                raise InputError(f"no file {name!r} can be made of these equations")
            write_bytes(target, pack_format(source, own)[1])
        self._say("written", name)

    def redraw(self, values: Mapping[str, Sequence[float]], run: int) -> None:
        """Draw the data against the equations with other constants.

        Parameters
        ----------
        values : state -> its constants in their order; {} for those found.
        run : the number of the trajectory, from 0.
        """
        if self._found is None:
            raise InputError(_NOTHING)
        found = self._found.with_constants(values) if values else self._found
        chosen = found.carried[run % len(found.carried)]
        every = max(1, len(chosen) // _MOST_ROWS)
        rows = slice(_MOST_STEPS) if found.is_map else chosen.every(every)
        thin = chosen.select(rows)
        lines, said = write_lines(found.equations, found.settings), ""
        # Steps by chance, and a history, are those of all rows.
        whole = bool(found.diffusion or found.delays)
        try:
            curve = _follow(found, chosen if whole else thin)
            curve = curve.select(rows) if whole else curve
        except DynsrError as error:
            curve, said = None, one_line(error)
        svg = _draw(thin, curve)
        moved = {state: list(own) for state, own in values.items()}
        content = {"svg": svg, "run": run, "lines": lines, "said": said, "values": moved}
        self._say("picture", content)


# Behind the state of doses: they are divided by a volume that is fitted.
_BY_VOLUME = "/V"
# Behind the state of errors: they say how rows differ, and not how large errors are.
_RATIOS = "*"
_MEASURED = (STATE, SUM)
_ROLES = (TIME, TRAJECTORY, QUANTITY, *_MEASURED, INPUT, DOSE, ERROR, UNUSED)


@dataclass(frozen=True)
class _Said:
    """What the page says of columns: column -> its role, its unit, and so on.

    ``roles`` is None where they are guessed. What is empty is not there.
    """

    roles: Mapping[str, str] | None
    units: Mapping[str, str]
    ways: Mapping[str, str]
    errors: Mapping[str, str]
    limits: Mapping[str, str]

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        roles: Mapping[str, str] | None,
        *more: Mapping[str, str] | None,
    ) -> _Said:
        """Take what is said of columns that there are."""
        return cls(
            roles,
            *(
                {n: own[n].strip() for n in names if own.get(n, "").strip()}
                for own in (one or {} for one in more)
            ),
        )


def _errors_of(
    columns: Sequence[str], states: Sequence[str], ways: Mapping[str, str]
) -> dict[str, str]:
    """Give state -> column of its errors, but for those of which only ratios are known.

    These are found by their names. Where the page named no state it is the first.
    """
    found: dict[str, str] = {}
    for name in columns if states else ():
        state = ways.get(name) or states[0]
        if state in found:
            both = f"columns {found[state]!r} and {name!r} are both errors of {state!r}"
            raise InputError(f"{both}; choose one")
        if not state.endswith(_RATIOS):
            found[state] = name
    return found


def _given_to(
    columns: Sequence[str], states: Sequence[str], ways: Mapping[str, str]
) -> dict[str, str] | None:
    """Give state -> column of its doses, by a volume where the page asked for one.

    Where the page named no state it is the first.
    """
    found: dict[str, str] = {}
    for place, name in enumerate(columns, 1):
        state = ways.get(name) or next(iter(states), "")
        divided = state.endswith(_BY_VOLUME)
        state = state.removesuffix(_BY_VOLUME)
        if state in found:
            raise InputError(
                f"columns {found[state]!r} and {name!r} are both doses of {state!r}; add them up"
            )
        found[state] = f"{name}{_BY_VOLUME}{place if len(columns) > 1 else ''}" if divided else name
    return found or None


@contextmanager
def _heard() -> Iterator[list[str]]:
    """Give a list that warnings about the data are written to."""
    said: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", DynsrWarning)
        try:
            yield said
        finally:
            said += [one_line(w.message) for w in caught if issubclass(w.category, DynsrWarning)]


@contextmanager
def _by_name(path: str) -> Iterator[None]:
    """Let an error call a file by its name: where it is kept is no business of its owner's."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error).replace(path, Path(path).name)) from None


def _is_number(columns: Columns, name: str) -> bool:
    return columns.values[columns.names.index(name)].dtype.kind == "f"


def _seen(found: Description) -> list[str]:
    """Say what is not used and why, and what was noticed or looks odd."""
    errors = found.noise.values()
    rest = {name: why for name, why in found.left_out.items() if name not in errors}
    unused = [f"{name!r} is left out: {why}" for name, why in rest.items()]
    return [*unused, *found.notes]


def _counted_in(runs: Sequence[Trajectory], unit: str) -> list[Trajectory]:
    """Count the times in a unit: those of dates are converted, plain numbers are taken as such."""
    if any(run.time_unit for run in runs) or not unit:
        return in_unit(runs, unit)
    return [replace(run, origin={**run.origin, "time_unit": unit}) for run in runs]


def _is_open(limits: Limits) -> bool:
    """Whether a cell says that a state was below a limit that is not written."""
    return bool(np.isinf(limits.below).any())


def _cells(values: np.ndarray, limits: Limits | None) -> list[str]:
    """Write the first cells of a column; those beyond a limit as such."""
    if limits is None:
        return [_cell(value) for value in values]
    ends = zip(values, limits.below, limits.above, strict=False)
    return [_cell_within(value, float(low), float(high)) for value, low, high in ends]


def _cell_within(value: Any, below: float, above: float) -> str:
    if np.isinf(below):
        return "below a limit"
    if np.isfinite(below):
        return f"<{below:.6g}"
    return f">{above:.6g}" if np.isfinite(above) else _cell(value)


def _cell(value: Any) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else one_line(value)
    return text if len(text) <= _LONGEST_CELL else text[: _LONGEST_CELL - 1] + "…"


def read_options(options: Mapping[str, Any], states: Sequence[str]) -> dict[str, Any]:
    """Read what the page asks for as the arguments of :func:`dynsr.discover`.

    Parameters
    ----------
    options : name -> value, as JSON has them; "" and what is not there leave the default.
    states : the states of the data.

    Raises InputError that names what cannot be read.

    >>> read_options({"preset": "quick", "second_order": True, "time_budget": "30"}, ["x"])
    {'preset': 'quick', 'order': 2, 'time_budget': 30.0}
    >>> read_options({"vary": "*", "delays": "1.5"}, ["x"])
    {'vary': True, 'delays': [1.5]}
    """
    found: dict[str, Any] = {}
    for name, value in options.items():
        if value in ("", None) or name == "units":
            continue
        if name in _NUMBERS:
            found[name] = _number(name, value)
        elif name in _SWITCHES:
            found[name] = bool(value)
        elif name == "second_order":
            found |= {"order": 2} if value else {}
        elif name == "nonnegative":
            found |= {"nonnegative": tuple(states)} if value else {}
        elif name == "functions":
            found[name] = _names(name, value)
        elif name in ("terms", "conserved"):
            found[name] = [part.strip() for part in str(value).split(",") if part.strip()]
        elif name in ("preset", "scheme", "hidden"):
            found[name] = str(value)
        elif name == "vary":
            found[name] = True if value == _BY_DATA else [str(value)]
        elif name == "delays":
            parts = str(value).split(",")
            found[name] = True if value == _BY_DATA else [_number("delay", one) for one in parts]
        else:
            raise InputError(f"unknown option {quoted(name)}; load the page again")
    return found


def _number(name: str, value: Any) -> float | int:
    words = name.replace("_", " ")
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{words} {quoted(value)} is not a number; write one, or none") from None
    return int(number) if name == "seed" and number.is_integer() else number


def _names(name: str, value: Any) -> list[str]:
    if not isinstance(value, list):
        raise InputError(f"{name} must be a list of names; load the page again")
    return [str(one) for one in value]


@dataclass(frozen=True)
class _Best:
    """The best formula of a state so far."""

    expr: sympy.Expr
    loss: float
    source: str


class Live:
    """Shows how a search goes on: tasks, time left, and the best equation of each state.

    Parameters
    ----------
    states : the states of the data.
    say : called with "progress" and its content.
    """

    def __init__(self, states: Sequence[str], say: Say) -> None:
        """Begin without an equation."""
        self._say = say
        self._fronts: dict[str, ParetoFront] = {state: ParetoFront() for state in states}
        self._chosen: dict[str, ParetoFront] = {}
        self._shown: dict[str, tuple[sympy.Expr, dict[str, str]]] = {}

    def __call__(self, step: Step) -> None:
        """Take a report of the search."""
        running: dict[str, ParetoFront] = {}
        for one in step.running:
            state = _state_of(one.title)
            running[state] = running.get(state, ParetoFront()).merge(one.front)
        self._take(step.record)
        best = {}
        for state in {**self._fronts, **running}:
            front = self._fronts.get(state, ParetoFront()).merge(running.get(state, ParetoFront()))
            front = self._chosen.get(state, front)
            if len(front):
                best[state] = self._show(state, front)
        together = {s: e for one in step.running for s, e in one.equations.items()}
        best |= {state: self._show_equation(state, expr) for state, expr in together.items()}
        share = sum(_share(one.done, one.total) for one in step.running)
        # Tasks that are not needed any more leave the plan.
        over = step.done >= step.total
        self._say(
            "progress",
            {
                "share": None if over else min(1.0, (step.done + 0.9 * share) / step.total),
                "tasks": "" if over else f"{step.done} of {step.total} tasks",
                "time": clock(step.seconds),
                "left": "fitting constants and making the verdict" if over else say_left(step),
                "running": [{"title": one.title, "stage": one.stage} for one in step.running],
                "best": best,
            },
        )

    def _take(self, record: Any) -> None:
        pick = getattr(record, "pick", None)
        if pick is not None:
            self._chosen[pick.state] = ParetoFront([pick.candidate])
        elif isinstance(getattr(record, "lead", None), ParetoFront):
            known = self._fronts.get(record.target, ParetoFront())
            self._fronts[record.target] = known.merge(record.lead)

    def _show(self, state: str, front: ParetoFront) -> dict[str, str]:
        knee = front.knee
        stage = "chosen, no verdict yet" if state in self._chosen else "best so far"
        return self._show_equation(state, knee.expr, f"misses the slopes by {knee.loss:.2g}", stage)

    def _show_equation(
        self, state: str, expr: sympy.Expr, error: str = "", stage: str = "best so far"
    ) -> dict[str, str]:
        """Show an equation; what is shown already is not written again."""
        if self._shown.get(state, (None,))[0] != expr:
            own = tidy(expr)
            words = {"mathml": to_mathml(own, state), "text": f"{state}' = {shown(own, 4)}"}
            words |= {"error": error, "stage": stage, "formula": to_text(own)}
            self._shown[state] = expr, words
        return self._shown[state][1]


def _state_of(title: str) -> str:
    return title.partition("'")[0]


def _share(done: float, total: float | None) -> float:
    return min(1.0, done / total) if total else 0.0


def show_found(found: Discovery) -> dict[str, Any]:
    """Give what the page shows of a discovery: verdict, equations, constants with intervals, code.

    Parameters
    ----------
    found : the discovery.
    """
    write, left = write_map_mathml if found.is_map else to_mathml, left_of("", found.is_map)
    verdicts = found.verdict.states
    units = found.constant_units
    return {
        "heading": found.heading,
        "level": found.verdict.level if found.verdict.tested else "",
        "complete": found.complete,
        "seconds": round(found.seconds, 1),
        "equations": [
            {
                "state": state,
                "mathml": write(expr, state),
                "text": f"{state}{left} = {shown(expr)}",
                "level": verdicts[state].level if state in verdicts else "",
                "why": _without(
                    f"{state}{left} = {shown(expr)}: ", found.explanation.get(state, "")
                ),
            }
            for state, expr in found.equations.items()
        ],
        "constants": [
            {
                "state": state,
                "of": one.of,
                "name": name.removeprefix("-"),
                "value": one.value,
                "fitted": one.fitted_text,
                "interval": one.interval_text,
                "unit": unit,
                "fixed": one.fixed,
            }
            for state, own in found.constants.items()
            for one, name, unit in zip(own, found.constant_names[state], units[state], strict=True)
        ],
        "left": left,
        "units": "column_units" in found.settings,
        "facts": list(_say_facts(found)),
        "moving": list(_say_moving(found)),
        "by_run": _as_shown(list_by_run(found)),
        "noise": list(found.noise_notes.values()),
        "steps": steps.svg if (steps := show_noise(found)) else "",
        "latex": found.latex(),
        "python": found.to_python(),
        "points": [point.text for point in list_fixed_points(found)],
        "flow": flow.svg if (flow := show_flow(found)) else "",
        "branches": asdict(branches) if (branches := show_branches(found)) else None,
        "exports": [
            {"title": one.title, "file": name_file(name)}
            for name, one in list_formats(Source.of(found)).items()
        ],
    }


def _without(begin: str, text: str) -> str:
    """Leave out what is shown as a formula above."""
    if not text.startswith(begin):
        return text
    text = text.removeprefix(begin)
    return text[:1].upper() + text[1:]


def _say_facts(found: Discovery) -> Iterator[str]:
    """Say what was found that neither equations nor tables have."""
    for delay in found.delays.values():
        yield f"{delay.text}."
    yield from found.volume_notes
    # A table of constants says these too.
    if not found.by_run.constants:
        yield from found.by_run.sentences


def _say_moving(found: Discovery) -> Iterator[str]:
    """Say what is done with the equations where constants are moved, if it is anything special."""
    if found.diffusion:
        yield "The picture has one path with noise in the motion, and the band of 95 % of paths."
    if found.delays:
        yield "What was before the first row is read from the data."
    if found.hidden:
        yield f"Nobody measured {', '.join(found.hidden)}: the curve begins at its fitted start."
    if found.by_run.constants:
        names = ", ".join(found.by_run)
        yield f"No slider moves {names}: the picture uses the values of the trajectory it shows."


def _as_shown(table: Table | None) -> dict[str, Any] | None:
    """Give a table as the page shows it: heads, cells and what is to be known of it."""
    if table is None:
        return None
    return {"head": table.columns, "rows": table.rows, "note": table.note}


@dataclass(frozen=True, eq=False)
class _Curve:
    """What equations do over a run, and the band around it where chance acts on it."""

    model: Trajectory
    bands: Mapping[str, tuple[np.ndarray, np.ndarray]]

    def select(self, rows: slice | np.ndarray) -> _Curve:
        """Give the curve at some rows."""
        bands = {s: (low[rows], high[rows]) for s, (low, high) in self.bands.items()}
        return _Curve(self.model.select(rows), bands)


def _follow(found: Discovery, run: Trajectory) -> _Curve:
    """Integrate the equations over a run from its first row, or draw paths where chance acts."""
    alone = replace(found, trajectories=(run,))
    return _Curve(*alone.path_and_band()) if found.diffusion else _Curve(alone.simulate(), {})


def _draw(run: Trajectory, curve: _Curve | None) -> str:
    words = "the data"
    if curve is None:
        return Picture.of(draw_states(run), words).svg
    run = run.of_states([state for state in run.states if state in curve.model.states])
    words += ", and the equations integrated from the first row"
    if curve.bands:
        words += " with noise in the motion: one path, and the band of 95 % of such paths"
    return Picture.of(draw_states(run, curve.model, curve.bands), words).svg


def _at_a_glance(run: Trajectory) -> Trajectory:
    """Give what a small picture has room for."""
    thin = run.select(run.every(max(1, len(run) // _MOST_ROWS)))
    return thin.of_states(run.states[:_MOST_PANELS])
