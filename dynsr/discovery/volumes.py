"""Volumes: what amounts are divided by to become the jump of a state, fitted to the data.

An amount such as 100 mg makes a concentration jump by amount/volume. The equations are searched
without the volume, in the parts between doses. Then each subject is followed from before its first
dose over all its doses, and the volume is the one with the smallest squared residuals. Its standard
error adds, by the delta method, that of the constants of the equations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import sympy
from scipy.optimize import approx_fprime, least_squares

from dynsr.data import Dosing, Trajectory, split_volume
from dynsr.discovery.result import Discovery, with_words
from dynsr.errors import EngineError, InputError
from dynsr.parameters import Parameter
from dynsr.verdict import Measured, predict_with_doses


def with_volumes(found: Discovery) -> Discovery:
    """Fit the unknown volumes of the doses; the result has them in ``volumes``.

    Parameters
    ----------
    found : a discovery with its data, which were cut at doses.

    Where the equations cannot be followed over the doses, the explanation of the state says so.
    """
    split = {state: split_volume(text)[1] for state, text in found.doses.items()}
    unknown = {s: v for s, v in split.items() if isinstance(v, str) and s in found.equations}
    if not unknown or not found.trajectories or found.is_map or not found.complete:
        return found
    try:
        volumes = _fit(found, split, unknown)
        said = {state: f"{name} is {_text(volumes[name])}" for state, name in unknown.items()}
    except (InputError, EngineError) as error:
        volumes = {}
        said = {state: f"{name} could not be fitted: {error}" for state, name in unknown.items()}
    words = {s: f" The volume {text}." for s, text in said.items()}
    return replace(with_words(found, words), volumes=volumes)


def _text(volume: Parameter) -> str:
    return f"{volume.value:.6g} (95 %: {volume.interval_text})"


@dataclass(frozen=True, eq=False)
class _Doses:
    """The parts between doses, and by what the amounts of each state are divided.

    Parameters
    ----------
    parts : the trajectories.
    volumes : state -> a number, or the name of an unknown one.
    unknown : those of them that are unknown.
    """

    parts: Sequence[Trajectory]
    volumes: Mapping[str, float | str]
    unknown: Mapping[str, str]

    @cached_property
    def names(self) -> list[str]:
        """The unknown volumes, each once."""
        return list(dict.fromkeys(self.unknown.values()))

    @cached_property
    def spread(self) -> float:
        """Standard deviation of all measured values; 1 where there is none."""
        spread = float(np.std(np.concatenate([part.observed.ravel() for part in self.parts])))
        return spread if spread > 0 else 1.0

    def residuals(self, found: Discovery, sizes: np.ndarray) -> np.ndarray:
        """Give the residuals of the states with unknown volumes, in units of the spread.

        Parameters
        ----------
        found : the equations.
        sizes : logarithms of the unknown volumes.
        """
        by_name = dict(zip(self.names, np.exp(sizes).tolist(), strict=True))
        known = {s: by_name[v] if isinstance(v, str) else v for s, v in self.volumes.items()}
        rows = []
        states = list(found.equations)
        for part in self.parts:
            x = _follow(found, part, known)
            for state in self.unknown:
                seen = part.observed[:, part.index(state)]
                there = np.isfinite(seen)
                rows.append((x[:, states.index(state)] - seen)[there])
        return np.concatenate(rows) / self.spread


def _fit(
    found: Discovery, volumes: Mapping[str, float | str], unknown: Mapping[str, str]
) -> dict[str, Parameter]:
    parts = [part for part in found.trajectories if isinstance(part.origin.get("dosing"), Dosing)]
    if not any(_given_before(part, set(unknown)) for part in parts):
        raise InputError("no trajectory has rows after a dose")
    doses = _Doses(parts, volumes, unknown)
    names = doses.names
    guess = [_guess(parts, {s for s, own in unknown.items() if own == name}) for name in names]
    fit = least_squares(partial(doses.residuals, found), np.log(guess), method="lm")
    rows = len(fit.fun) - len(names)
    if rows < 1 or not np.all(np.isfinite(fit.x)):
        raise InputError("the rows after doses are too few")
    inverse = np.linalg.pinv(fit.jac.T @ fit.jac)
    spread = inverse * float(fit.fun @ fit.fun) / rows
    spread = spread + _from_constants(found, doses, fit.x, inverse @ fit.jac.T)
    errors = np.sqrt(np.diag(spread))
    fitted = {}
    for name, size, error in zip(names, fit.x.tolist(), errors.tolist(), strict=True):
        own = tuple(state for state, volume in unknown.items() if volume == name)
        low, high = (float(np.exp(size + side * found.reach * error)) for side in (-1, 1))
        value = math.exp(size)
        of = f"the volume of doses of {', '.join(own)}"
        fitted[name] = Parameter(name, value, value * error, low, high, of=of, states=own)
    return fitted


def _from_constants(
    found: Discovery, doses: _Doses, sizes: np.ndarray, gain: np.ndarray
) -> np.ndarray:
    """Give the covariance that volumes have from that of the constants of the equations."""
    parameters = found.parameters
    if not parameters:
        return np.zeros((len(sizes), len(sizes)))
    spread = found.covariance().to_numpy()
    values = np.array(list(parameters.numbers.values()))

    def at(constants: np.ndarray) -> np.ndarray:
        own = dict(zip(parameters, constants.tolist(), strict=True))
        return doses.residuals(found.with_parameters(**own), sizes)

    # A step by a fraction of the standard errors moves the residuals beyond the solver's errors.
    steps = np.sqrt(np.diag(spread)) / 4
    if not np.all(np.isfinite(steps) & (steps > 0)):
        return np.full((len(sizes), len(sizes)), np.inf)
    slopes = np.reshape(approx_fprime(values, at, steps), (-1, len(values)))
    turned = gain @ slopes
    return np.asarray(turned @ spread @ turned.T)


def _given_before(part: Trajectory, states: set[str]) -> list[tuple[float, float]]:
    """Give (time, amount) of what was given to states before the last row of a part."""
    return [
        (time, amount)
        for time, state, amount in part.origin["dosing"].given
        if state in states and time < part.t[-1]
    ]


def _guess(parts: Sequence[Trajectory], states: set[str]) -> float:
    """Give a volume to begin with: the last amount before a part by the state at its begin."""
    found = []
    for part in parts:
        before = [amount for time, amount in _given_before(part, states) if time <= part.t[0]]
        state = next(iter(states))
        values = part.observed[:, part.index(state)]
        size = np.abs(values[np.isfinite(values)][:1])
        if before and size.size and size[0] > 0:
            found.append(abs(before[-1]) / float(size[0]))
    return float(np.median(found)) if found else 1.0


def _follow(found: Discovery, part: Trajectory, volumes: Mapping[str, float]) -> np.ndarray:
    """Give the states at the rows of a part, from before the first dose over all of them."""
    own: Dosing = part.origin["dosing"]
    begin = own.given[0][0] if own.before is None else own.before
    first = {s: part.x[0, part.index(s)] for s in found.equations}
    # Of what has doses there is nothing before the first, unless it was measured.
    first |= {s: 0.0 for s in volumes if s in first}
    start = [own.start.get(state, float(value)) for state, value in first.items()]
    given = [one for one in own.given if begin <= one[0] < part.t[-1]]
    times = np.unique([begin, *(time for time, *_ in given), *part.t.tolist()])
    doses = {state: np.zeros(len(times)) for state in volumes if state in found.equations}
    for time, state, amount in given:
        doses[state][np.searchsorted(times, time)] += amount / volumes[state]
    inputs: dict[str, Any] = {
        name: sympy.Float(value.values[0])
        if isinstance(value, Measured) and not np.ptp(value.values)
        else value
        for name, value in found.inputs_of(part).items()
    }
    x = predict_with_doses(found.equations, start, times, doses, inputs, found.engine).x
    rows = np.searchsorted(times, part.t)
    found_x = x[rows]
    # A first row at the time of a dose was measured after it.
    if rows[0] or own.before is None:
        for place, state in enumerate(found.equations):
            found_x[0, place] += doses[state][rows[0]] if state in doses else 0.0
    return found_x
