"""Kept data: the trajectories of a discovery as a table next to it, from which they are read back.

People read the table: one row a time, and an empty cell where a state was not measured. What a
table cannot say is in a description of it, which the discovery keeps.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynsr.data.dosing import Dosing
from dynsr.data.holding import check_hold
from dynsr.data.known_noise import KnownNoise
from dynsr.data.limits import Limits
from dynsr.data.sums import MeasuredSum
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError, one_line

# The file of the data in the folder of a discovery.
DATA = "data.csv"
# Of more cells no copy is made: their file is larger than what people send to each other.
_MOST_CELLS = 2_000_000
# What is kept of the origin of a trajectory.
_ORIGIN = ("name", "time_unit", "units", "labels", "dosing")


@dataclass(frozen=True)
class KeptNoise:
    """Errors that are known, but for the column of their size; fields as in KnownNoise."""

    share: float
    sure: bool


@dataclass(frozen=True)
class KeptSum:
    """The sum in which a state was measured, but for the columns of its values and their errors.

    Parameters
    ----------
    others : other state -> its factor.
    noise : its errors, where they are known.
    """

    others: dict[str, float]
    noise: KeptNoise | None = None


@dataclass(frozen=True)
class KeptRun:
    """What the table does not say of one run.

    Parameters
    ----------
    rows : how many rows of the table it has.
    hold : input -> what it does between rows.
    noise : state whose errors are known -> what the table does not say of them.
    sums : state -> the sum in which it was measured.
    name, time_unit, units, labels : as in the origin of a trajectory.
    dosing : what was given to this subject.
    """

    rows: int
    hold: dict[str, str] = field(default_factory=dict)
    noise: dict[str, KeptNoise] = field(default_factory=dict)
    sums: dict[str, KeptSum] = field(default_factory=dict)
    name: str | None = None
    time_unit: str | None = None
    units: dict[str, str] | None = None
    labels: dict[str, str] | None = None
    dosing: Dosing | None = None


@dataclass(frozen=True)
class KeptData:
    """The description of a table of trajectories.

    Parameters
    ----------
    sha256 : digest of the file.
    states, inputs : the names of its columns.
    more : the columns after those: state and "curve", "sd", "sum", "sum sd", "below" or "above".
    runs : the runs, in the order of their rows.
    """

    sha256: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    more: tuple[tuple[str, str], ...]
    runs: tuple[KeptRun, ...]


def write_kept(runs: Sequence[Trajectory]) -> tuple[str, KeptData] | None:
    """Write trajectories as a table and its description; None where they are too many to copy.

    Parameters
    ----------
    runs : trajectories of the same columns.

    >>> text, kept = write_kept([Trajectory([0.0, 1.0], [[2.0], [np.nan]], ("x",))])
    >>> text.split()
    ['t,x', '0.0,2.0', '1.0,']
    >>> read_kept(text.encode(), kept)[0].own_rows("x")
    array([0])
    """
    if not runs or sum(map(len, runs)) * (1 + len(runs[0].names)) > _MOST_CELLS:
        return None
    columns = [_columns_of(run) for run in runs]
    more = tuple(dict.fromkeys(name for own in columns for name in own))
    units: Mapping[str, str] = runs[0].origin.get("units") or {}
    units = {**units, **({"t": runs[0].time_unit} if runs[0].time_unit else {})}
    head = [f"{n} [{units[n]}]" if units.get(n) else n for n in ("t", *runs[0].names)]
    several = len(runs) > 1
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([*(["trajectory"] if several else []), *head, *map(" ".join, more)])
    for number, (run, own) in enumerate(zip(runs, columns, strict=True), start=1):
        none = np.full(len(run), np.nan)
        extra = [own.get(name, none) for name in more]
        table = np.column_stack([run.t, run.observed, run.inputs, *extra])
        label = [str(run.origin.get("name") or number)] if several else []
        writer.writerows([*label, *map(_cell, row)] for row in table.tolist())
    text = file.getvalue()
    described = tuple(map(_describe, runs))
    names = (runs[0].states, runs[0].input_names, more)
    return text, KeptData(digest(text.encode()), *names, described)


def _cell(value: float) -> str:
    return "" if math.isnan(value) else repr(value)


def _columns_of(run: Trajectory) -> dict[tuple[str, str], np.ndarray]:
    """Give what a run has for each row next to its states and inputs."""
    found: dict[tuple[str, str], np.ndarray] = {}
    hidden = np.where(run.measured, np.nan, run.x)
    for state, curve in zip(run.states, hidden.T, strict=True):
        if not np.isnan(curve).all():
            found[state, "curve"] = curve
    for state, noise in run.noise.items():
        found[state, "sd"] = noise.sd
    for state, own in run.sums.items():
        found[state, "sum"] = own.values
        if own.noise is not None:
            found[state, "sum sd"] = own.noise.sd
    for state, limits in run.limits.items():
        found[state, "below"], found[state, "above"] = limits.below, limits.above
    return found


def _describe(run: Trajectory) -> KeptRun:
    origin = {name: run.origin[name] for name in _ORIGIN if run.origin.get(name)}
    if "name" in origin:
        origin["name"] = str(origin["name"])
    return KeptRun(
        len(run),
        dict(run.hold),
        {state: _describe_noise(own) for state, own in run.noise.items()},
        {
            state: KeptSum(dict(own.others), _describe_noise(own.noise) if own.noise else None)
            for state, own in run.sums.items()
        },
        **origin,
    )


def _describe_noise(own: KnownNoise) -> KeptNoise:
    return KeptNoise(float(own.share), bool(own.sure))


def digest(content: bytes) -> str:
    """Give the digest by which a table is known again."""
    return hashlib.sha256(content).hexdigest()


def read_kept(content: bytes, kept: KeptData) -> tuple[Trajectory, ...]:
    """Read trajectories back from their table, every number with all its bits.

    Parameters
    ----------
    content : the file.
    kept : its description.

    Raises InputError where the two do not fit.
    """
    import pandas

    try:
        frame = pandas.read_csv(io.BytesIO(content), dtype=str)
        table = frame.iloc[:, int(len(kept.runs) > 1) :].to_numpy(dtype=float)
        width = 1 + len(kept.states) + len(kept.inputs) + len(kept.more)
        if table.shape != (sum(run.rows for run in kept.runs), width):
            raise IndexError("other rows or columns")
        ends = np.cumsum([run.rows for run in kept.runs])[:-1]
        parts = zip(np.split(table, ends), kept.runs, strict=True)
        return tuple(_read_run(rows, own, kept) for rows, own in parts)
    except (ValueError, LookupError) as error:
        raise InputError(f"{DATA} does not fit its description: {one_line(error)}") from None


def _read_run(rows: np.ndarray, own: KeptRun, kept: KeptData) -> Trajectory:
    places = np.cumsum([1, len(kept.states), len(kept.inputs)])
    t, x, inputs, extra = np.split(rows, places, axis=1)
    more = dict(zip(kept.more, extra.T, strict=True))
    curves = [more.get((state, "curve"), np.full(len(rows), np.nan)) for state in kept.states]
    gaps = np.isnan(x)
    sums = {}
    for state, one in own.sums.items():
        noise = _read_noise(more[state, "sum sd"], one.noise) if one.noise else None
        sums[state] = MeasuredSum(more[state, "sum"], one.others, noise)
    limits = {s: Limits(more[s, "below"], more[s, "above"]) for s, n in kept.more if n == "below"}
    return Trajectory(
        t[:, 0],
        np.where(gaps, np.column_stack(curves), x),
        kept.states,
        inputs,
        kept.inputs,
        {name: value for name in _ORIGIN if (value := getattr(own, name))},
        check_hold(own.hold, kept.inputs),
        gaps,
        {state: _read_noise(more[state, "sd"], one) for state, one in own.noise.items()},
        sums,
        limits,
    )


def _read_noise(sd: np.ndarray, kept: KeptNoise) -> KnownNoise:
    return KnownNoise(sd, kept.share, kept.sure)
