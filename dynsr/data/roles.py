"""Roles of columns: which is the time, which are states, inputs, or the name of a trajectory."""

from __future__ import annotations

import re
import unicodedata
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynsr.data.columns import Columns, bare_name
from dynsr.data.grouping import guess_grouping
from dynsr.data.times import read_times, unit_in_name
from dynsr.errors import DynsrWarning, InputError
from dynsr.expression import check_name

_TIME = re.compile(
    r"t|time|times|timestamps?|datetime|date|sec|secs|seconds?|zeit|temps", re.IGNORECASE
)
_INPUT = re.compile(r"(f|force|forcing)|(input|control|forcing)s?_?\w*|u_?\d*", re.IGNORECASE)


_MANY = 30


@dataclass(frozen=True)
class Roles:
    """Columns by their role, under their names in the source.

    ``renamed`` gives every state and input the name that it has in formulas; ``ignored`` are
    columns that no role was found for; ``chosen`` says that the caller named the states;
    ``parameters`` are those inputs that were taken for such since they are constant within each
    trajectory, and ``labels`` what only tells trajectories apart beside ``trajectory``; ``noise``
    maps a state to the column of its measurement errors. ``trajectory`` are the columns whose
    values together name a trajectory; ``clock`` is the column of the time of the day where ``time``
    holds only the date, and ``quantity`` the column whose values became states or inputs.
    """

    time: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    trajectory: tuple[str, ...] = ()
    renamed: Mapping[str, str] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()
    chosen: bool = False
    parameters: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    noise: Mapping[str, str] = field(default_factory=dict)
    clock: str | None = None
    quantity: str | None = None


def guess_roles(
    columns: Columns,
    time: str,
    t: np.ndarray,
    states: Sequence[str] | None,
    inputs: Sequence[str] | None,
    formulas: Mapping[str, str],
    trajectory: str | None,
) -> Roles:
    """Give each column its role: as the caller said, or else by its name and its values.

    Parameters
    ----------
    columns : the columns of the source.
    time : name of the time column in the source, as :func:`find_time` gives it.
    t : (n,) its numbers.
    states, inputs, trajectory : names in the source or in formulas; None where guessed.
    formulas : inputs that are expressions in ``t``, by name.

    Raises InputError that lists the columns when one that was named is not there, when no column
    can be the time, or when no column is left for a state.
    """
    if trajectory:
        trajectory = _find(trajectory, columns, "trajectory")
    known = None if inputs is None else [_find(name, columns, "input") for name in inputs]
    chosen = None if states is None else [_find(name, columns, "state") for name in states]
    said = {time, *(chosen or []), *(known or []), *columns.inputs}
    candidates = [name for name in columns.names if name not in said]
    grouping = guess_grouping(columns, t, candidates, trajectory or None)
    others = [name for name in columns.names if name not in (time, grouping.trajectory)]
    apart = (*grouping.labels, *grouping.parameters)
    parameters: tuple[str, ...] = ()
    if known is None:
        free = [n for n in others if n not in (chosen or []) and clean_name(n) not in formulas]
        known = _guess_inputs([n for n in free if n not in apart], columns, chosen)
        if chosen is None:
            parameters = tuple(n for n in grouping.parameters if n in free)
            known += parameters
    if chosen is None:
        given = [n for n in others if clean_name(n) in formulas or _is_row_number(n, columns)]
        chosen = [n for n in others if n not in (*known, *given, *apart)]
    _check_roles(time, chosen, known, columns)
    if states is None and len(chosen) + len(known) > _MANY:
        warnings.warn(
            f"{columns.label} has {len(chosen)} states, and a search grows with the square of "
            "their number; name those that matter (--states)",
            DynsrWarning,
            stacklevel=4,
        )
    used = [*chosen, *known]
    return Roles(
        time,
        tuple(chosen),
        tuple(known),
        () if grouping.trajectory is None else (grouping.trajectory,),
        _rename(used, formulas),
        tuple(name for name in others if name not in (*used, *grouping.labels)),
        states is not None,
        parameters,
        tuple(name for name in grouping.labels if name not in used),
    )


def _check_roles(time: str, states: Sequence[str], inputs: Sequence[str], columns: Columns) -> None:
    both = [name for name in states if name in inputs or name == time]
    if both:
        role = "the time" if both[0] == time else "an input"
        raise InputError(f"column {both[0]!r} is both a state and {role}; give it one role")
    twice = [name for name, often in Counter([*states, *inputs]).items() if often > 1]
    if twice:
        raise InputError(f"column {twice[0]!r} is named twice; name each once")
    if not states:
        raise InputError(
            f"{columns.label} has no column left for a state (columns: {_shown(columns.names)}); "
            "give a time column and at least one state"
        )


def _shown(names: Sequence[str]) -> str:
    listed = ", ".join(names[:12])
    return listed if len(names) <= 12 else f"{listed}, ... ({len(names)} in all)"


def _find(name: str, columns: Columns, role: str) -> str:
    """Find a column by its name in the source or by the name it gets in formulas."""
    if name in columns.twice:
        raise InputError(
            f"column name {name!r} for the {role} is used twice in {columns.label}; rename one"
        )
    if name in columns.names:
        return name
    if name in columns.left_out:
        raise InputError(
            f"column {name!r} of {columns.label} was left out since it {columns.left_out[name]}; "
            f"it cannot be the {role}"
        )
    # A name that looks the same may be written otherwise, as the micro sign is.
    alike = unicodedata.normalize("NFKC", name)
    for original in columns.names:
        if clean_name(original) == name or unicodedata.normalize("NFKC", original) == alike:
            return original
    raise InputError(
        f"no column {name!r} for the {role} in {columns.label}; "
        f"its columns are: {_shown(columns.names)}"
    )


def find_time(columns: Columns, time: str | None) -> str:
    """Give the column of the times: as the caller said, or else by its name and its values.

    Parameters
    ----------
    columns : the columns of the source.
    time : its name in the source or in formulas; None to guess it.

    Raises InputError that lists the columns when it is not there or none can be the time.
    """
    if time:
        return _find(time, columns, "time")
    for name in columns.names:
        if _TIME.fullmatch(bare_name(name)) or re.fullmatch(r"(t|time)_\w+", name, re.IGNORECASE):
            return name
    if not columns.named:
        return columns.names[0]
    for name, values in zip(columns.names, columns.values, strict=True):
        if values.dtype.kind in "mM" or (
            values.dtype.kind == "O" and read_times(values) is not None
        ):
            return name
        rising = values.dtype.kind == "f" and len(values) > 1 and bool(np.all(np.diff(values) > 0))
        if rising and name:
            return name
    counted = [name for name in columns.names if unit_in_name(name)]
    if len(counted) == 1:
        return counted[0]
    raise InputError(
        f"no column of {columns.label} looks like the time (columns: {_shown(columns.names)}); "
        "name it, e.g. --time seconds, or add a column t"
    )


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


def _is_row_number(name: str, columns: Columns) -> bool:
    values = columns.values[columns.names.index(name)]
    unnamed = not name or name.startswith("Unnamed:") or name == "index"
    return unnamed and values.dtype.kind == "f" and bool(np.all(np.diff(values) == 1))


def clean_name(name: str) -> str:
    """Give the name that a column has in formulas: its own where that can stand in one.

    Units in brackets go, other signs become underscores, and names of functions get a number.

    >>> [clean_name(name) for name in ("theta (rad)", "x-1", "sin", "2nd", "inf_")]
    ['theta', 'x_1', 'sin_1', 'x2nd', 'inf_']
    """
    text = unicodedata.normalize("NFKC", bare_name(name) or name)
    if not text.isidentifier():
        text = re.sub(r"_{2,}", "_", re.sub(r"\W", "_", text)).strip("_") or "x"
    if not text.isidentifier():
        text = f"x{text}"
    try:
        return check_name(text)
    except InputError:
        return f"{text}_1"


def _rename(names: Sequence[str], formulas: Mapping[str, str]) -> dict[str, str]:
    renamed: dict[str, str] = {}
    taken = {"t", *formulas}
    own = {name for name in names if clean_name(name) == name} - taken
    for name in names:
        new, number = clean_name(name), 1
        while new in taken or (new in own and new != name):
            number += 1
            new = f"{clean_name(name)}_{number}"
        taken.add(new)
        renamed[name] = new
    changed = {name: new for name, new in renamed.items() if name != new}
    if changed:
        shown = ", ".join(f"{name[:60]!r} -> {new}" for name, new in changed.items())
        warnings.warn(
            f"columns were renamed so that they can stand in formulas: {shown}",
            DynsrWarning,
            stacklevel=4,
        )
    return renamed
