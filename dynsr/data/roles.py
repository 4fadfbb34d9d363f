"""Roles of columns: states, inputs, parameters, noise, or what only says the row or the time."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynsr.data.columns import Columns
from dynsr.data.dosing import find_amounts, refuse_amounts
from dynsr.data.grouping import Grouping, is_text
from dynsr.data.levels import find_levels
from dynsr.data.lines import ROUNDED, is_second_time, numbers_phases, numbers_rows
from dynsr.data.measurement_errors import (
    counts_values,
    find_measured,
    is_error_name,
    is_error_word,
)
from dynsr.data.moving_means import find_moving_means
from dynsr.data.name_parts import bare_name, bracketed_unit
from dynsr.data.names import clean_name, find_column, list_names, rename
from dynsr.data.noise_model import is_still
from dynsr.data.steps import is_noted_at_changes, is_set
from dynsr.data.time_columns import Times
from dynsr.data.times import is_time_name, unit_in_name
from dynsr.errors import DynsrWarning, InputError

# What programs of Modelica write next to each state.
_SLOPE = re.compile(r"der\((?P<of>.+)\)")
_INPUT = re.compile(r"(f|force|forcing)|(input|control|forcing)s?_?\w*|u_?\d*", re.IGNORECASE)
_MANY = 30

_IN_EVERY_ROW = "in every row"
_GIVEN = ", empty in all others; if it is given there, say to which state (--dose)"


@dataclass(frozen=True)
class Roles:
    """Columns by their role, under their names in the source.

    ``renamed`` gives every state and input the name that it has in formulas; ``chosen`` says that
    the caller named the states; ``parameters`` are those inputs that were taken for such since they
    are constant within each trajectory, and ``labels`` what only distinguishes trajectories in
    addition to ``trajectory``, the columns whose values together name one; ``noise`` maps a state
    to the column of its measurement errors; ``clock`` is the column of the time of the day where
    ``time`` has only the date, and ``quantity`` the column whose values became states or inputs;
    ``doses`` maps a state to the column of the amounts by which it jumps, one of the inputs;
    ``amounts`` are inputs that may be such amounts, where the caller did not say it;
    ``held`` are inputs that were taken for such since they keep their value and step;
    ``left_out`` gives each column that is not used with the reason; ``reshaped`` are columns of the
    source whose cells went into others: the values of quantities, or runs side by side.
    """

    time: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    trajectory: tuple[str, ...] = ()
    renamed: Mapping[str, str] = field(default_factory=dict)
    chosen: bool = False
    parameters: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    noise: Mapping[str, str] = field(default_factory=dict)
    clock: str | None = None
    quantity: str | None = None
    held: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    reshaped: tuple[str, ...] = ()
    doses: Mapping[str, str] = field(default_factory=dict)
    amounts: tuple[str, ...] = ()


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore")
def guess_roles(
    columns: Columns,
    time: Times,
    grouping: Grouping,
    states: Sequence[str] | None,
    inputs: Sequence[str] | None,
    formulas: Mapping[str, str],
    quantity: str | None = None,
    errors: Mapping[str, str] | None = None,
    doses: Mapping[str, str] | None = None,
) -> Roles:
    """Give each column its role: as the caller said, or else by its values and its name.

    Parameters
    ----------
    columns : the columns of the source.
    time : the times, all of which are there.
    grouping : the trajectories.
    states, inputs : names in the source or in formulas; None where guessed.
    formulas : inputs that are expressions in ``t``, by name.
    quantity : the column whose values were given columns of their own.
    errors : state -> the column of its measurement errors, where the caller says it.
    doses : state -> the column of the amounts by which it jumps, where the caller says it.

    Raises InputError that lists the columns when one that was named is not there, or when no column
    is left for a state.
    """
    look = _Look(columns, time, grouping)
    known = None if inputs is None else [find_column(name, columns, "input") for name in inputs]
    chosen = None if states is None else [find_column(name, columns, "state") for name in states]
    taken = {*time.columns, *grouping.trajectory, *grouping.labels, *(known or []), *(chosen or [])}
    said = _find_errors(errors or {}, columns)
    given = _find_doses(doses or {}, columns)
    taken |= {*said.values(), *given.values()}
    errors_of = {own: f"is the noise of {state!r}" for state, own in said.items()}
    left_out = {**time.left_out, **errors_of}
    free = [n for n in columns.names if n not in taken and n not in left_out]
    left_out |= {n: "is given as a formula" for n in free if clean_name(n) in formulas}
    free = [n for n in free if n not in left_out]
    amounts = find_amounts(columns, free, grouping.codes)
    apart = [n for n in (*grouping.parameters,) if n not in (known or ())]
    parameters: list[str] = []
    held: list[str] = []
    if chosen is None:
        unsaid = [n for n in free if n not in (*apart, *amounts)]
        left_out |= look.redundant(unsaid, known or [])
    moving = [n for n in free if n not in left_out and n not in apart]
    noise = look.noise_columns_of(chosen, moving, said)
    of_noise = {own: f"is the noise of {state!r}" for state, own in noise.items()}
    left_out |= of_noise | look.counts(noise, moving if chosen is None else ())
    free = [n for n in free if n not in left_out]
    if known is None:
        known = _guess_inputs([n for n in free if n not in apart], columns, chosen)
        rest = [n for n in free if n not in (*known, *apart, *(chosen or []))]
        held = look.held(rest, amounts, chosen is None)
        if chosen is None and len(held) == len(rest):
            held = []
        known += held
    if chosen is None:
        parameters = [n for n in grouping.parameters if n not in known and n not in left_out]
        known += parameters
        chosen = [n for n in free if n not in (*known, *apart)]
        still = look.constants(chosen)
        if len(still) < len(chosen):
            left_out |= still
            chosen = [n for n in chosen if n not in still]
    if states is None:
        refuse_amounts(columns, [n for n in amounts if n in held], chosen, columns.label)
    known += [n for n in given.values() if n not in known]
    _check_roles(time, chosen, known, columns, given, left_out)
    if states is None and len(chosen) + len(known) > _MANY:
        warnings.warn(
            f"{columns.label} has {len(chosen)} states, and an equation of each is searched; for a "
            "shorter search name those that matter (--states)",
            DynsrWarning,
            stacklevel=4,
        )
    used = [*chosen, *known]
    for name in columns.names:
        if name not in (*used, *time.columns, *grouping.trajectory, *grouping.labels):
            left_out.setdefault(
                name, "has no role" if states is None else "is not among the states asked for"
            )
    return Roles(
        time.name,
        tuple(chosen),
        tuple(known),
        grouping.trajectory,
        rename(used, formulas),
        states is not None,
        tuple(parameters),
        tuple(name for name in grouping.labels if name not in used),
        {state: own for state, own in {**noise, **said}.items() if state in chosen},
        time.clock,
        quantity,
        tuple(n for n in held if n not in amounts),
        left_out,
        doses=given,
        amounts=tuple(n for n in amounts if n in held),
    )


def _find_errors(errors: Mapping[str, str], columns: Columns) -> dict[str, str]:
    """Give the columns of errors that the caller named, by the columns whose errors they are."""
    return {
        find_column(state, columns, "noise of a state"): find_column(own, columns, "noise")
        for state, own in errors.items()
    }


def _find_doses(doses: Mapping[str, str], columns: Columns) -> dict[str, str]:
    """Give the columns of amounts that the caller named, by the states that jump."""
    return {
        find_column(state, columns, "state"): find_column(own, columns, "dose")
        for state, own in doses.items()
    }


def _check_roles(
    time: Times,
    states: Sequence[str],
    inputs: Sequence[str],
    columns: Columns,
    doses: Mapping[str, str],
    left_out: Mapping[str, str],
) -> None:
    both = [name for name in states if name in inputs or name in time.columns]
    if both:
        role = "the time" if both[0] in time.columns else "an input"
        raise InputError(f"column {both[0]!r} is both a state and {role}; give it one role")
    twice = [name for name, often in Counter([*states, *inputs]).items() if often > 1]
    if twice:
        raise InputError(f"column {twice[0]!r} is named twice; name each once")
    if not states:
        pairs = zip(columns.names, columns.values, strict=True)
        text = next(((n, v) for n, v in pairs if n in left_out and is_text(v)), None)
        why = "" if text is None else f", since {text[0]!r} {left_out[text[0]]}"
        why += "" if text is None else f" such as {str(text[1][0])[:40]!r}"
        raise InputError(
            f"{columns.label} has no column left for a state (columns: "
            f"{list_names(columns.names)}){why}; give a time column and at least one state"
        )
    odd = [state for state in doses if state not in states]
    if odd:
        raise InputError(
            f"doses are given to a state, and {odd[0]!r} is no state; the states are: "
            f"{', '.join(map(clean_name, states))}"
        )


def _is_called(name: str, own: str) -> bool:
    """Whether a column has a name that several columns have, perhaps with a number behind it."""
    return name == own or re.fullmatch(re.escape(own) + r"_\d+", name) is not None


class _Look:
    """Looks at the columns other than the times and the trajectories."""

    def __init__(self, columns: Columns, time: Times, grouping: Grouping) -> None:
        """Put the rows of each trajectory in order."""
        self._columns = columns
        self._codes = grouping.codes
        self._t = time.within(grouping.codes)
        self._rows = [rows[np.argsort(self._t[rows], kind="stable")] for _, rows in grouping.rows()]

    def _values(self, name: str) -> np.ndarray:
        return self._columns.values[self._columns.names.index(name)]

    def _is_number(self, name: str) -> bool:
        return self._values(name).dtype.kind == "f"

    def _pieces(self, name: str) -> list[np.ndarray]:
        return [self._values(name)[rows] for rows in self._rows]

    def redundant(self, names: Sequence[str], kept: Sequence[str]) -> dict[str, str]:
        """Give the columns that say nothing of the states, with the reason; not all of them."""
        found = {}
        for name in names:
            values = self._values(name)
            if name in self._columns.faults:
                continue  # they are numbers, and which ones is to be said
            slope = _SLOPE.fullmatch(name)
            if slope is not None and slope["of"] in self._columns.names:
                found[name] = f"is the slope of {slope['of']!r}"
            elif is_text(values) and self._is_remark(values):
                found[name] = "holds text"
            elif values.dtype.kind == "f":
                if not np.isfinite(values).any() and np.isnan(values).all():
                    found[name] = "has no value in any row"
                elif name not in self._columns.inputs and not _INPUT.fullmatch(bare_name(name)):
                    reason = self._as_line(name, values)
                    if reason:
                        found[name] = reason
        numbers = [n for n in names if n not in found and self._is_number(n)]
        means = find_moving_means({n: self._pieces(n) for n in numbers})
        found |= {n: f"is the mean of {k} rows of {of!r}" for n, (of, k) in means.items()}
        if len(found) == len(names):
            lines = [n for n in found if self._is_number(n) and np.isfinite(self._values(n)).any()]
            return {n: why for n, why in found.items() if n not in lines}
        return found

    @staticmethod
    def _is_remark(values: np.ndarray) -> bool:
        """Whether text is one of remarks: in few rows, or another in almost every one."""
        there = [cell for cell in values if isinstance(cell, str)]
        return len(there) < len(values) / 2 or 2 * len(set(there)) > len(there)

    def _as_line(self, name: str, values: np.ndarray) -> str:
        called = (is_time_name(bare_name(name)) and len(name) > 1) or bool(unit_in_name(name))
        # Where nothing has a name, what is the time to the last digit is no state.
        called = called or (not self._columns.named and np.array_equal(values, self._t))
        unit = self._columns.units.get(name) or bracketed_unit(name)
        # What is measured in a unit is more than a number of a row.
        if not np.all(np.isfinite(values)) or (unit and not unit_in_name(f"t [{unit}]")):
            return ""
        if numbers_rows(name, values, self._codes):
            return "numbers the rows"
        if numbers_phases(name, values):
            return "counts the steps of a program"
        codes = self._codes
        if is_time_name(bare_name(name)):  # it may begin again, as the time of a step does
            codes = np.cumsum(np.append(0, (np.diff(values) < 0) | (np.diff(codes) != 0)))
        return "is a second time" if is_second_time(values, self._t, codes, called) else ""

    def noise(self, names: Sequence[str]) -> dict[str, str]:
        """Give the columns of measurement errors, by the column whose errors they are."""
        numbers = [n for n in names if self._is_number(n)]
        found: dict[str, str] = {}
        for name in numbers:
            values = self._values(name)
            if np.any(values < 0):
                continue
            others = [n for n in numbers if n != name]
            state = self._right_before(name, others) or find_measured(name, others)
            if state is not None and state not in found.values() and state not in found:
                found[state] = name
        return found

    def _right_before(self, name: str, others: Sequence[str]) -> str | None:
        """Give the column before one of several that are all called sd, as in x, sd, y, sd."""
        called = next((own for own in self._columns.twice if _is_called(name, own)), "")
        if not is_error_word(called):
            return None
        before = self._columns.names[self._columns.names.index(name) - 1]
        return before if before in others and not is_error_name(before) else None

    def counts(self, noise: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
        """Give the columns that say how many values each mean with an error is of."""
        return {
            name: f"is how many values {state!r} is the mean of"
            for name in names
            if self._is_number(name)
            for state in noise
            if counts_values(name, state) and np.all(np.nan_to_num(self._values(name)) % 1 == 0)
        }

    def noise_columns_of(
        self, chosen: Sequence[str] | None, moving: Sequence[str], said: Mapping[str, str]
    ) -> dict[str, str]:
        """Give the columns of errors by what they are of: of the states, where these are chosen.

        Parameters
        ----------
        chosen : the states that the caller named; None where they are guessed.
        moving : columns that nobody gave a role.
        said : state -> column that the caller named.
        """
        states = tuple(chosen or ())
        found = self.noise([*states, *moving])
        return {
            state: own
            for state, own in found.items()
            if state not in said and own not in states and (chosen is None or state in states)
        }

    def held(self, names: Sequence[str], amounts: Sequence[str], guessed: bool) -> list[str]:
        """Give the columns that hold their value and step, and amounts where states are guessed.

        Where the caller named the states, amounts with empty cells have no role.
        """
        known = [n for n in amounts if guessed or np.isfinite(self._values(n)).all()]
        still = self.constants(names)
        rest = [n for n in names if n not in amounts and n not in still]
        return [n for n in names if n in known or (n in rest and self.is_held(n))]

    def is_held(self, name: str) -> bool:
        """Whether a column holds its value and steps."""
        if not self._is_number(name):
            return False
        pieces = self._pieces(name)
        if is_set(name, pieces) or is_noted_at_changes(name, pieces):
            return True
        levels = find_levels(pieces)
        return levels is not None and is_set(name, levels[0])

    def constants(self, names: Sequence[str]) -> dict[str, str]:
        """Give the columns that have one value in all rows."""
        found = {}
        for name in names:
            values = self._values(name)
            if values.dtype.kind == "f":
                there = values[np.isfinite(values)]
                if len(there) and is_still(there, ROUNDED):
                    few = len(there) < len(values) / 2
                    where = f"in {len(there)} of {len(values)} rows" if few else _IN_EVERY_ROW
                    found[name] = f"is {there[0]:g} {where}"
                    found[name] += _GIVEN if few else ""
        return found


def constants_left_out(columns: Columns, left_out: Mapping[str, str]) -> dict[str, float]:
    """Give the columns that were left out since they have one value, with that value.

    Parameters
    ----------
    columns : the columns of the source, before they had roles.
    left_out : column that is not used -> the reason.

    >>> columns = Columns(("t", "T"), (np.arange(3.0), np.full(3, 37.0)), "data.csv")
    >>> constants_left_out(columns, {"T": "is 37 in every row"})
    {'T': 37.0}
    """
    values = dict(zip(columns.names, columns.values, strict=True))
    said = [name for name, why in left_out.items() if why.endswith(_IN_EVERY_ROW)]
    return {
        name: float(values[name][0])
        for name in said
        if name in values and is_still(values[name], ROUNDED)
    }


def _guess_inputs(
    names: Sequence[str], columns: Columns, states: Sequence[str] | None
) -> list[str]:
    found = [name for name in names if name in columns.inputs]
    if found or (states is not None and set(names) == set(columns.inputs)):
        return found
    fits = [name for name in names if _INPUT.fullmatch(bare_name(name))]
    if {bare_name(name).lower() for name in names} & {"v", "w"}:  # u beside v or w is a state
        fits = [name for name in fits if bare_name(name).lower() != "u"]
    return fits if len(fits) < len(names) or states is not None else []
