"""Doses: amounts given at a time, at which a state jumps.

A row is measured before what is given at its time. So the run goes on from there with the state
plus the amount: it is cut at every dose, and each part is a run of its own whose first row is the
last one of the part before, the amount added. No slope, fit or integration reaches over a jump.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dynsr.data.assembling import Columns, bare_name
from dynsr.data.names import clean_name
from dynsr.data.trajectory import FEWEST_ROWS, Trajectory
from dynsr.errors import DynsrWarning, InputError

_DOSE = re.compile(r".*(dose|dosing|dosis|bolus|inject|injektion|spike|gabe).*|amt", re.IGNORECASE)
# Columns of NONMEM next to AMT: what kind a row is, and what repeats or lengthens a dose.
_KINDS = ("evid", "mdv", "cmt")
_MORE = ("rate", "addl", "ii", "ss")


def read_doses(doses: Mapping[str, str] | None) -> dict[str, str]:
    """Give state -> column of amounts, as the caller says; raises InputError where it is not so.

    >>> read_doses({"x": "dose"}), read_doses(None)
    ({'x': 'dose'}, {})
    """
    if doses is None:
        return {}
    if not isinstance(doses, Mapping) or not doses:
        raise InputError(f'doses {doses!r} must say state -> column of amounts: {{"x": "dose"}}')
    return {str(state): str(column) for state, column in doses.items()}


def find_amounts(columns: Columns, names: Sequence[str], codes: np.ndarray) -> list[str]:
    """Find columns of amounts that are given at a moment: a few rows have one, none its neighbour.

    Parameters
    ----------
    columns : the columns of the source.
    names : those that may be so, of which the ones count that are called a dose or an amount.
    codes : (n,) the number of the trajectory of each row.

    >>> dose = np.array([10.0, np.nan, np.nan, np.nan, np.nan, 5.0, np.nan, np.nan])
    >>> columns = Columns(("t", "dose"), (np.arange(8.0), dose), "the mapping")
    >>> find_amounts(columns, ["dose"], np.zeros(8, dtype=int))
    ['dose']
    """
    found = []
    for name in names:
        values = columns.values[columns.names.index(name)]
        if values.dtype.kind != "f" or not _DOSE.fullmatch(bare_name(name)):
            continue
        given = np.nan_to_num(values) != 0
        alone = not np.any(given[1:] & given[:-1] & (np.diff(codes) == 0))
        if given.any() and alone and 3 * np.sum(given) <= len(given):
            found.append(name)
    return found


def refuse_amounts(
    columns: Columns, amounts: Sequence[str], states: Sequence[str], label: str
) -> None:
    """Raise InputError where a column of amounts is empty elsewhere, and nobody said what it is.

    Parameters
    ----------
    columns : the columns of the source.
    amounts : the columns that :func:`find_amounts` gives.
    states : the columns that are states.
    label : what a message calls the source.
    """
    for name in amounts:
        values = columns.values[columns.names.index(name)]
        if np.isfinite(values).all():
            continue
        count = int(np.sum(np.nan_to_num(values) != 0))
        rows = "1 row" if count == 1 else f"{count} rows"
        state, own = clean_name(states[0]) if states else "x", clean_name(name)
        raise InputError(
            f"column {name!r} of {label} has amounts in {rows} of {len(values)}; say which state "
            f"jumps by them, in the units of that state: --dose {state}={own}, or leave it out: "
            f"--states {','.join(map(clean_name, states)) or '...'}"
        )


def find_nonmem(columns: Columns, label: str) -> dict[str, str]:
    """Give the columns of NONMEM that only say what kind a row is, with the reason.

    Parameters
    ----------
    columns : the columns of the source.
    label : what a message calls the source.

    There must be a column AMT. Raises InputError where doses are repeated or last by other columns.
    """
    own = {name.lower(): name for name in columns.names}
    if "amt" not in own or not set(own) & {"evid", "mdv"}:
        return {}
    for key in _MORE:
        values = columns.values[columns.names.index(own[key])] if key in own else np.zeros(0)
        if values.dtype.kind == "f" and np.any(np.nan_to_num(values) != 0):
            row = int(np.flatnonzero(np.nan_to_num(values) != 0)[0])
            raise InputError(
                f"column {own[key]!r} of {label} is {values[row]:g} in row {row + 1}: doses are "
                "read one row each; write a row for each dose, and an infusion as a column of its "
                "rate, which is an input"
            )
    codes = [own[key] for key in (*_KINDS, *_MORE) if key in own]
    return dict.fromkeys(codes, "says what kind a row is (NONMEM)")


def split_after_doses(
    codes: np.ndarray, t: np.ndarray, amounts: np.ndarray, measured: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Begin a new part where a dose has a row of its own and a measurement of its time follows.

    Such a measurement is one after the dose, as in tables of NONMEM: the state has jumped already.

    Parameters
    ----------
    codes : (n,) the number of the trajectory of each row, in the order of the source.
    t : (n,) times.
    amounts : (n,) what is given, 0 for nothing.
    measured : (n,) whether any state was measured.

    Gives the (n,) number of the part of each row within its trajectory, and (n,) whether a row is
    such a dose, which is then no row of data.

    >>> codes, t = np.zeros(4, int), np.array([0.0, 1.0, 2.0, 2.0])
    >>> split_after_doses(codes, t, np.array([0.0, 0, 5, 0]), np.array([True, True, False, True]))
    (array([0, 0, 1, 1]), array([False, False,  True, False]))
    """
    part, given = np.zeros(len(t), dtype=int), np.zeros(len(t), dtype=bool)
    for row in np.flatnonzero((amounts != 0) & ~measured).tolist():
        own = codes == codes[row]
        later = own & ((t > t[row]) | ((t == t[row]) & (np.arange(len(t)) >= row)))
        if not np.any(measured & later & (t == t[row])):
            continue
        given[row] = True
        if np.any(measured & own & ~later):
            part[later] += 1
    return part, given


def cut_at_doses(
    runs: Sequence[Trajectory], doses: Mapping[str, str] | None, fewest: int = FEWEST_ROWS
) -> list[Trajectory]:
    """Cut runs where an amount is given; the columns of amounts are no states and no inputs then.

    Parameters
    ----------
    runs : trajectories of the same columns.
    doses : state -> column of the amounts that are given to it right after each row, 0 elsewhere.
    fewest : parts of fewer rows are left out, with a DynsrWarning.

    Raises InputError when a state or a column is unknown, or no part is long enough.

    >>> t = np.arange(20.0)
    >>> given = np.where(t == 9, 5.0, 0.0)
    >>> run = Trajectory(t, np.where(t > 9, 5.0, 0.0)[:, None], ("x",), given[:, None], ("dose",))
    >>> before, after = cut_at_doses([run], {"x": "dose"})
    >>> before.names, before.t.tolist()[-1], after.t.tolist()[0], after.x.tolist()[0]
    (('x',), 9.0, 9.0, [5.0])
    """
    if doses is None:
        return list(runs)
    doses = read_doses(doses)
    columns, names = list(dict.fromkeys(doses.values())), runs[0].names
    states = [state for state in runs[0].states if state not in columns]
    for state, column in doses.items():
        if column not in names:
            raise InputError(f"there is no column {column!r}; the columns are: {', '.join(names)}")
        if state not in states:
            raise InputError(
                f"doses are given to a state, and {state!r} is no state; the states are: "
                f"{', '.join(states)}"
            )
    parts = [part for run in runs for part in _cut(run, doses, states)]
    kept = [part for part in parts if len(part) >= fewest]
    if not kept:
        raise InputError(
            f"there are {max(map(len, parts))} rows between doses at most; give at least {fewest}"
        )
    if len(kept) < len(parts):
        warnings.warn(
            f"{len(parts) - len(kept)} of {len(parts)} parts between doses have fewer than "
            f"{fewest} rows and are left out",
            DynsrWarning,
            stacklevel=2,
        )
    return kept


def _cut(run: Trajectory, doses: Mapping[str, str], states: Sequence[str]) -> list[Trajectory]:
    columns, given = run.by_name, np.zeros((len(run), len(states)))
    for state, column in doses.items():
        # An empty cell says that nothing was given.
        given[:, states.index(state)] += np.nan_to_num(columns[column])
    inputs = [name for name in run.input_names if name not in doses.values()]
    plain = replace(
        run.of_states(states),
        inputs=run.inputs[:, [run.input_names.index(name) for name in inputs]],
        input_names=tuple(inputs),
        hold={name: way for name, way in run.hold.items() if name in inputs},
        origin={**run.origin, "doses": dict(doses)},
    )
    # What is given at the last row is followed by none.
    at = np.flatnonzero(given[:-1].any(axis=1))
    parts = []
    for begin, end in pairwise([-1, *at.tolist(), len(run) - 1]):
        if begin < 0 and end == 0:
            continue
        part = plain.select(slice(max(begin, 0), end + 1))
        if begin >= 0:
            x = part.x.copy()
            x[0] += given[begin]
            part = replace(part, x=x)
        parts.append(part)
    return parts
