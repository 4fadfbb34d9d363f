"""Doses: amounts given at a time, at which a state jumps.

A row is measured before what is given at its time. So the run goes on from there with the state
plus the amount: it is cut at every dose, and each part is a run of its own whose first row is the
last one of the part before, the amount added. No slope, fit or integration reaches over a jump.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from dynsr.data.assembling import Columns
from dynsr.data.name_parts import bare_name
from dynsr.data.names import clean_name
from dynsr.data.trajectory import FEWEST_ROWS, Trajectory
from dynsr.errors import DynsrWarning, InputError
from dynsr.expression import check_name

_DOSE = re.compile(
    r".*(dose|dosing|dosis|bolus|inject|injektion|spike|gabe).*|amt|amounts?", re.IGNORECASE
)
# A column of amounts that is divided by a named volume, or by a number.
_VOLUME = re.compile(
    r"(?P<column>.+?)\s*/\s*(?:(?P<name>[^\W\d]\w*)|(?P<number>\d[\d.]*(?:e[-+]?\d+)?))\s*"
)


@dataclass(frozen=True)
class Dosing:
    """What was given to one subject, and where its states were before.

    Parameters
    ----------
    given : (time, state, amount) of each dose, in order of time.
    before : time of the last row that was measured before the first dose; None if there is none.
    start : state -> its value in that row, where it was measured.

    >>> doses = {"c": np.array([0.0, 5.0, 0.0])}
    >>> Dosing.of(np.arange(3.0), ["c"], np.array([[1.0], [np.nan], [4.0]]), doses)
    Dosing(given=((1.0, 'c', 5.0),), before=0.0, start={'c': 1.0})
    """

    given: tuple[tuple[float, str, float], ...]
    before: float | None = None
    start: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        t: np.ndarray,
        states: Sequence[str],
        x: np.ndarray,
        doses: Mapping[str, np.ndarray],
    ) -> Dosing:
        """Read it from the rows of a subject, in which a state is measured before a dose.

        Parameters
        ----------
        t : (n,) times.
        states : the names of the k states.
        x : (n, k) their values, NaN where there is none.
        doses : state -> (n,) amounts.
        """
        given = [
            (float(t[row]), state, float(amounts[row]))
            for state, amounts in doses.items()
            for row in np.flatnonzero(amounts)
        ]
        given.sort(key=lambda one: one[0])
        own = np.any([amounts != 0 for amounts in doses.values()], axis=0)
        there = np.isfinite(x).any(axis=1)
        first = min((time for time, *_ in given), default=np.inf)
        # A row of its own for the dose is above what was measured after it.
        before = np.flatnonzero(there & ((t < first) | ((t == first) & own)))
        if not before.size:
            return cls(tuple(given))
        row = before[np.argmax(t[before])]
        values = zip(states, x[row].tolist(), strict=True)
        return cls(tuple(given), float(t[row]), {s: v for s, v in values if np.isfinite(v)})

    def at(self, in_unit: Callable[[np.ndarray], np.ndarray]) -> Dosing:
        """Count its times in another unit.

        Parameters
        ----------
        in_unit : gives (n,) times in that unit.
        """
        times = in_unit(np.array([time for time, *_ in self.given])).tolist()
        given = tuple((t, *rest) for t, (_, *rest) in zip(times, self.given, strict=True))
        before = None if self.before is None else float(in_unit(np.array([self.before]))[0])
        return Dosing(given, before, self.start)


def split_volume(text: str) -> tuple[str, float | str]:
    """Take ``column/volume`` apart: the column of amounts, and a number or the name of a constant.

    Parameters
    ----------
    text : the column, divided by a volume or not.

    >>> split_volume("dose"), split_volume("dose/V"), split_volume("dose/2.5")
    (('dose', 1.0), ('dose', 'V'), ('dose', 2.5))
    """
    found = _VOLUME.fullmatch(text)
    if found is None:
        return text, 1.0
    if found["name"]:
        return found["column"], check_name(found["name"], "volume")
    size = float(found["number"])
    if not 0 < size < np.inf:
        raise InputError(
            f"doses are divided by {found['number']}; give a number above 0, or a name"
        )
    return found["column"], size


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


def is_dose_name(name: str) -> bool:
    """Whether a column of that name has amounts that are given.

    Parameters
    ----------
    name : of the column, without its unit.

    >>> is_dose_name("AMT"), is_dose_name("conc")
    (True, False)
    """
    return _DOSE.fullmatch(name) is not None


def columns_of_doses(doses: Mapping[str, str] | None) -> dict[str, str]:
    """Give state -> column of amounts, without the volumes by which they are divided.

    Parameters
    ----------
    doses : state -> column, or ``column/volume``; None for no doses.

    >>> columns_of_doses({"c": "dose/V"})
    {'c': 'dose'}
    """
    return {state: split_volume(text)[0] for state, text in read_doses(doses).items()}


def clean_dose(text: str) -> str:
    """Give ``column/volume`` with the column as formulas name it.

    Parameters
    ----------
    text : the column, divided by a volume or not.

    >>> clean_dose("dose (mg)/V")
    'dose/V'
    """
    column, volume = split_volume(text)
    return clean_name(column) + ("" if volume == 1.0 else f"/{volume}")


def clean_doses(doses: Mapping[str, str] | None) -> dict[str, str]:
    """Give state -> ``column/volume``, both as formulas name them.

    Parameters
    ----------
    doses : by the names of the source; None for no doses.

    >>> clean_doses({"conc (mg/L)": "dose (mg)/V"})
    {'conc': 'dose/V'}
    """
    return {clean_name(state): clean_dose(text) for state, text in read_doses(doses).items()}


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
        if values.dtype.kind != "f" or not is_dose_name(bare_name(name)):
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
            f"jumps by them: --dose {state}={own} in the units of that state, --dose "
            f"{state}={own}/V with a volume V that is fitted; or leave it out: --states "
            f"{','.join(map(clean_name, states)) or '...'}"
        )


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
        Behind a slash is the volume by which amounts are divided, a number or a name; where it is
        a name, it is unknown, and a part begins at the row after the dose.
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
    said = read_doses(doses)
    volumes = {state: split_volume(text)[1] for state, text in said.items()}
    doses = columns_of_doses(said)
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
    parts = [part for run in runs for part in _cut(run, doses, states, volumes, said)]
    kept = [part for part in parts if len(part) >= fewest]
    if not kept:
        raise InputError(
            f"there are {max(map(len, parts))} rows between doses at most; give at least {fewest}"
        )
    if len(kept) < len(parts):
        every, used = sum(map(len, parts)), sum(map(len, kept))
        warnings.warn(
            f"{len(parts) - len(kept)} of {len(parts)} parts between doses have fewer than "
            f"{fewest} rows and are left out: {every - used} of {every} rows; where that is much, "
            "measure more often between doses",
            DynsrWarning,
            stacklevel=2,
        )
    return kept


def _cut(
    run: Trajectory,
    doses: Mapping[str, str],
    states: Sequence[str],
    volumes: Mapping[str, float | str],
    said: Mapping[str, str],
) -> list[Trajectory]:
    columns, given = run.by_name, np.zeros((len(run), len(states)))
    unknown = np.zeros(len(run), dtype=bool)
    for state, column in doses.items():
        # An empty cell says that nothing was given.
        amounts, volume = np.nan_to_num(columns[column]), volumes[state]
        if isinstance(volume, str):
            unknown |= amounts != 0
        else:
            given[:, states.index(state)] += amounts / volume
    inputs = [name for name in run.input_names if name not in doses.values()]
    plain = replace(
        run.of_states(states),
        inputs=run.inputs[:, [run.input_names.index(name) for name in inputs]],
        input_names=tuple(inputs),
        hold={name: way for name, way in run.hold.items() if name in inputs},
        origin={**run.origin, "doses": dict(said)},
    )
    if unknown.any() or "dosing" in run.origin:
        amounts = {state: np.nan_to_num(columns[own]) for state, own in doses.items()}
        own = Dosing.of(run.t, states, plain.observed, amounts)
        plain = replace(plain, origin={"dosing": own, **plain.origin})
    # What is given at the last row is followed by none.
    at = np.flatnonzero(given[:-1].any(axis=1) | unknown[:-1])
    parts = []
    for begin, end in pairwise([-1, *at.tolist(), len(run) - 1]):
        if begin < 0 and end == 0:
            continue
        if begin >= 0 and unknown[begin]:
            # Where the states are right after such a dose is not known.
            begin, end = begin + 1, max(end, begin + 1)
        part = plain.select(slice(max(begin, 0), end + 1))
        if begin >= 0 and given[begin].any() and not unknown[begin]:
            x = part.x.copy()
            x[0] += given[begin]
            part = replace(part, x=x)
        parts.append(_measured(part))
    return parts


def _measured(part: Trajectory) -> Trajectory:
    """Leave rows at the ends out in which only a dose was written."""
    seen = [np.isfinite(part.observed).any(axis=1), *(own.there for own in part.limits.values())]
    there = np.flatnonzero(np.any(seen, axis=0))
    return part.select(slice(there[0], there[-1] + 1)) if there.size else part
