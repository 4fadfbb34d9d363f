"""Reading sums: columns that are sums of states become states that nobody measured alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import sympy
from scipy.optimize import linear_sum_assignment

from dynsr.data.known_noise import KnownNoise
from dynsr.data.observation import carry
from dynsr.data.sums import MeasuredSum
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError, one_line
from dynsr.expression import check_name, parse


def read_sums(runs: Sequence[Trajectory], observed: Mapping[str, Any] | None) -> list[Trajectory]:
    """Put states that nobody measured alone in the place of columns that are sums of states.

    Parameters
    ----------
    runs : trajectories of the same columns.
    observed : column -> the linear combination of states that it is, such as "S + I".

    The values of such a state are those of the column less the other states: as these were measured
    at the same row, or from their curves. Fits of trajectories use the column itself.

    Raises InputError when the runs have no such column, a combination is not linear, or there is
    not one column for each state that nobody measured.

    >>> from dynsr.data import Trajectory
    >>> run = Trajectory([0.0, 1.0], [[1.0, 3.0], [2.0, 3.0]], ("S", "total"))
    >>> (read,) = read_sums([run], {"total": "S + I"})
    >>> read.states, read.x[:, 1].tolist()
    (('S', 'I'), [2.0, 1.0])
    """
    if not observed:
        return list(runs)
    if not isinstance(observed, Mapping):
        raise InputError(
            f"observed {observed!r} must map columns to sums of states, such as "
            '{"total": "S + I"}'
        )
    columns, first = tuple(observed), runs[0]
    for column in columns:
        if column not in first.states:
            raise InputError(
                f"observed names {column!r}, which is no state column; those are: "
                f"{', '.join(first.states)}"
            )
    alone = [state for state in first.states if state not in columns]
    factors = {column: _read(column, text, first) for column, text in observed.items()}
    hidden = list(dict.fromkeys(n for own in factors.values() for n in own if n not in alone))
    _check(factors, alone, hidden)
    weights = np.array([[factors[column].get(name, 0.0) for name in hidden] for column in columns])
    if np.linalg.matrix_rank(weights) < len(hidden):
        raise InputError(
            f"{', '.join(columns)} do not determine {', '.join(hidden)}; give other combinations"
        )
    chosen = linear_sum_assignment(np.abs(weights), maximize=True)[1]
    places = {column: hidden[place] for column, place in zip(columns, chosen, strict=True)}
    states = tuple(places.get(state, state) for state in first.states)
    matrix = np.eye(len(states))
    for column, state in places.items():
        own = factors[column]
        matrix[states.index(state)] = [own.get(name, 0.0) / own[state] for name in states]
    scales = np.array([factors[s][places[s]] if s in places else 1.0 for s in first.states])
    # Where a column is empty, its curve says what other states are less than the sum.
    filled = [run.x for run in carry(runs)]
    return [_seen(run, x, states, matrix, scales) for run, x in zip(runs, filled, strict=True)]


def _read(column: str, text: Any, run: Trajectory) -> dict[str, float]:
    """Read a linear combination as state -> factor."""
    expr = text if isinstance(text, sympy.Expr) else parse(str(text))
    names = sorted(map(str, expr.free_symbols))
    symbols = [sympy.Symbol(check_name(name, "state")) for name in names]
    slopes = {name: sympy.diff(expr, symbol) for name, symbol in zip(names, symbols, strict=True)}
    rest = expr.subs(dict.fromkeys(symbols, 0))
    if not names or rest != 0 or any(not slope.is_number for slope in slopes.values()):
        raise InputError(
            f"{column!r} is {one_line(str(text))[:60]!r}, which is no sum of states; "
            'give a linear combination, such as "S + I"'
        )
    if wrong := [name for name in names if name in run.input_names or name in (column, "t")]:
        raise InputError(f"{column!r} cannot contain {wrong[0]!r}, which is no state; leave it out")
    return {name: float(slope) for name, slope in slopes.items() if slope != 0}


def _check(
    factors: Mapping[str, Mapping[str, float]], alone: Sequence[str], hidden: Sequence[str]
) -> None:
    """Raise InputError where there is not one sum for each state that nobody measured."""
    for column, own in factors.items():
        if set(own) <= set(alone):
            raise InputError(
                f"every state of {column!r} was measured alone ({', '.join(own)}); leave the "
                "column out of the states and of observed"
            )
    if len(hidden) != len(factors):
        raise InputError(
            f"{', '.join(hidden)} were not measured alone, and {len(factors)} column"
            f"{'s are' if len(factors) > 1 else ' is'} a sum; give one sum for each such state"
        )


def _seen(
    run: Trajectory,
    filled: np.ndarray,
    states: tuple[str, ...],
    matrix: np.ndarray,
    scales: np.ndarray,
) -> Trajectory:
    """Give a run with hidden states in the place of sums."""
    x = np.linalg.solve(matrix, (filled / scales).T).T
    others = matrix - np.eye(len(states))
    sums: dict[str, MeasuredSum] = {}
    noise: dict[str, KnownNoise] = {}
    limits = {
        state: run.limits[column].in_units(float(scales[place]))
        for place, (state, column) in enumerate(zip(states, run.states, strict=True))
        if column in run.limits
    }
    for place, state in enumerate(states):
        known = run.noise.get(run.states[place])
        if known is not None and scales[place] != 1:
            known = known.in_units(abs(float(scales[place])))
        if not np.any(others[place]):
            noise |= {} if known is None else {state: known}
            continue
        parts = {n: float(f) for n, f in zip(states, others[place], strict=True) if f}
        values = run.observed[:, place] / scales[place]
        sums[state] = MeasuredSum(values, parts, known)
    units: Mapping[str, str] = run.origin.get("units", {})
    if units:
        # A state has the unit of its sum, unless it counts there by a factor.
        same = [s == c or f == 1 for s, c, f in zip(states, run.states, scales, strict=True)]
        units = {
            **{name: unit for name, unit in units.items() if name not in run.states},
            **{
                state: units[column]
                for state, column, kept in zip(states, run.states, same, strict=True)
                if kept and column in units
            },
        }
        run = replace(run, origin={**run.origin, "units": units})
    gaps = run.unmeasured
    return replace(run, x=x, states=states, unmeasured=gaps, noise=noise, sums=sums, limits=limits)
