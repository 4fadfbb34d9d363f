"""Joining: sources that measured different states of the same experiments become one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynsr.data.holding import Hold
from dynsr.data.known_noise import KnownNoise
from dynsr.data.limits import Limits
from dynsr.data.steps import between_rows
from dynsr.data.times import convert_times
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError

# Share of the span of the times below which two of them are the same.
_SAME = 1e-9
# What times are, in words.
_COUNTED = {None: "in numbers", "date": "in dates", "clock": "in times of the day"}


@dataclass(frozen=True, eq=False)
class Source:
    """What was read from one source.

    Parameters
    ----------
    label : what a message calls it.
    runs : its trajectories.
    named : whether a column names them.
    """

    label: str
    runs: Sequence[Trajectory]
    named: bool = False

    @property
    def states(self) -> tuple[str, ...]:
        """The states that it measured."""
        return self.runs[0].states

    @property
    def names(self) -> list[str]:
        """Names of its trajectories."""
        return [str(run.origin.get("name", i)) for i, run in enumerate(self.runs, start=1)]


def join_sources(sources: Sequence[Source]) -> tuple[list[Trajectory], str]:
    """Give the trajectories of several sources, and a sentence where they were joined.

    Sources of the same states, in any order, are runs, one after the other. Sources that share no
    state measured the same experiments, and are joined on the time: what one of them did not
    measure at a time of another is empty there. Which trajectories belong together their names say,
    or else their order.

    Parameters
    ----------
    sources : what was read, all counted in one unit.

    Raises InputError where neither holds, or trajectories do not meet.

    >>> fast = Trajectory([0.0, 1.0, 2.0], [[1.0], [2.0], [3.0]], ("x",))
    >>> slow = Trajectory([0.0, 2.0], [[5.0], [6.0]], ("y",))
    >>> (run,), _ = join_sources([Source("fast.csv", [fast]), Source("slow.csv", [slow])])
    >>> run.x.tolist()
    [[1.0, 5.0], [2.0, nan], [3.0, 6.0]]
    """
    kinds: dict[tuple[str, ...], list[Source]] = {}
    for source in _in_one_order(sources):
        kinds.setdefault(source.states, []).append(source)
    if len(kinds) == 1:
        every = [run for own in kinds.values() for source in own for run in source.runs]
        _check_inputs(every)
        return every, ""
    groups = [_together(own) for own in kinds.values()]
    _check_apart(groups)
    found = [_join(own, groups) for own in _pair(groups)]
    _check_inputs(found)
    said = " and ".join(f"{group.label} ({', '.join(group.states)})" for group in groups)
    many = "one experiment" if len(found) == 1 else f"the same {len(found)} experiments"
    return found, f"{said} measured {many} and were joined on the time."


def _in_one_order(sources: Sequence[Source]) -> list[Source]:
    """Give the columns of each source in the order in which they are first met."""
    met: dict[frozenset[str], tuple[str, ...]] = {}
    return [replace(source, runs=[_ordered(run, met) for run in source.runs]) for source in sources]


def _ordered(run: Trajectory, met: dict[frozenset[str], tuple[str, ...]]) -> Trajectory:
    states, inputs = (met.setdefault(frozenset(n), n) for n in (run.states, run.input_names))
    if (states, inputs) == (run.states, run.input_names):
        return run
    places = [run.input_names.index(name) for name in inputs]
    return replace(run.of_states(states), inputs=run.inputs[:, places], input_names=inputs)


def _together(sources: Sequence[Source]) -> Source:
    labels = ", ".join(dict.fromkeys(source.label for source in sources))
    runs = [run for source in sources for run in source.runs]
    _check_inputs(runs)
    return Source(labels, runs, all(source.named for source in sources))


def _check_inputs(runs: Sequence[Trajectory]) -> None:
    for run in runs[1:]:
        if run.names != runs[0].names:
            raise InputError(
                f"the trajectories have different columns ({', '.join(runs[0].names)} and "
                f"{', '.join(run.names)}); give all the same columns"
            )


def _check_apart(groups: Sequence[Source]) -> None:
    """Refuse sources of which one measured a part of what another did."""
    for i, one in enumerate(groups):
        for other in groups[:i]:
            both = [state for state in one.states if state in other.states]
            if both:
                raise InputError(
                    f"the trajectories have different columns ({', '.join(other.states)} and "
                    f"{', '.join(one.states)}); give all the same columns, or, where they are one "
                    f"experiment, leave {both[0]!r} out of one of them or rename it there"
                )


def _pair(groups: Sequence[Source]) -> list[tuple[Trajectory, ...]]:
    """Give the trajectories of each experiment, one of each group."""
    first = groups[0]
    rows = [first.runs]
    for group in groups[1:]:
        by_name = dict(zip(group.names, group.runs, strict=True))
        unique = len(by_name) == len(group.runs) and len(set(first.names)) == len(first.runs)
        if unique and set(by_name) == set(first.names):
            rows.append([by_name[name] for name in first.names])
        elif len(group.runs) == len(first.runs) and not (first.named and group.named):
            rows.append(group.runs)
        else:
            raise InputError(
                f"{first.label} holds {_count(first)} of {', '.join(first.states)} and "
                f"{group.label} {_count(group)} of {', '.join(group.states)}; give one of each for "
                "every experiment, with the same names"
            )
    return list(zip(*rows, strict=True))


def _count(group: Source) -> str:
    count = len(group.runs)
    names = f" ({', '.join(group.names[:6])})" if group.named else ""
    return f"{count} {'trajectory' if count == 1 else 'trajectories'}{names}"


def _join(parts: Sequence[Trajectory], groups: Sequence[Source]) -> Trajectory:
    """Put what was measured of one experiment on all its times."""
    times = _on_one_clock(parts, groups)
    _check_overlap(times, groups)
    every = np.unique(np.concatenate(times))
    # Times that were computed differ in their last digits.
    apart = np.diff(every, prepend=-np.inf) > _SAME * max(np.ptp(every), np.abs(every).max())
    t = every[apart]
    middles = (t[1:] + t[:-1]) / 2
    places = [np.searchsorted(middles, own) for own in times]
    states = [state for part in parts for state in part.states]
    x = np.full((len(t), len(states)), np.nan)
    first = 0
    inputs: dict[str, np.ndarray] = {}
    noise: dict[str, KnownNoise] = {}
    limits: dict[str, Limits] = {}
    for part, rows in zip(parts, places, strict=True):
        x[rows, first : first + len(part.states)] = part.observed
        first += len(part.states)
        for state, known in part.noise.items():
            sd = np.full(len(t), np.sqrt(np.mean(known.sd**2)))
            sd[rows] = known.sd
            noise[state] = replace(known, sd=sd)
        for state, seen in part.limits.items():
            limits[state] = seen.at(rows, len(t))
        for name, column in zip(part.input_names, part.inputs.T, strict=True):
            own = inputs.setdefault(name, np.full(len(t), np.nan))
            own[rows] = np.where(np.isnan(own[rows]), column, own[rows])
    driven = [between_rows(t, column) for column in inputs.values()]
    holds: dict[str, Hold] = {}
    for part in parts:
        holds = {**part.hold, **holds}
    clash = [name for name in inputs if name in states]
    if clash:
        raise InputError(f"{clash[0]!r} is a state in one source and an input in another")
    return Trajectory(
        t,
        x,
        tuple(states),
        np.column_stack(driven) if driven else np.empty((0, 0)),
        tuple(inputs),
        _joined_origin(parts),
        holds,
        noise=noise,
        limits=limits,
    )


def _joined_origin(parts: Sequence[Trajectory]) -> dict[str, Any]:
    """Give what each part says of its columns, and of all else what the first does."""
    found: dict[str, Any] = {}
    for part in parts:
        for key, value in part.origin.items():
            if isinstance(value, Mapping):
                found[key] = {**value, **found.get(key, {})}
            else:
                found.setdefault(key, value)
    return found


def _on_one_clock(parts: Sequence[Trajectory], groups: Sequence[Source]) -> list[np.ndarray]:
    """Give the times of each part, those of dates from the earliest of all on."""
    begins = [part.origin.get("begins") for part in parts]
    kinds = {None if own is None else own[0] for own in begins}
    if kinds == {None}:
        return [part.t for part in parts]
    if len(kinds) > 1:
        counted = [
            f"{group.label} {_COUNTED[None if own is None else own[0]]}"
            for group, own in zip(groups, begins, strict=True)
        ]
        raise InputError(
            f"times are counted otherwise in each source: {', '.join(counted)}; give all the same"
        )
    starts = np.array([own[1] for own in begins if own is not None])
    shifts = convert_times(starts - starts.min(), "s", parts[0].time_unit)
    assert shifts is not None
    return [part.t + shift for part, shift in zip(parts, shifts, strict=True)]


def _check_overlap(times: Sequence[np.ndarray], groups: Sequence[Source]) -> None:
    for i, own in enumerate(times[1:], start=1):
        if own[0] > times[0][-1] or own[-1] < times[0][0]:
            raise InputError(
                f"{groups[0].label} was measured from {times[0][0]:g} to {times[0][-1]:g} and "
                f"{groups[i].label} from {own[0]:g} to {own[-1]:g}: they do not meet in time, and "
                "hold different columns; give both the same clock, or all the same columns"
            )
