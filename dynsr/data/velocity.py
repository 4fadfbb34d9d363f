"""Velocity: a column's first and second derivative, for equations of second order."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynsr.data.forcing import Forced, find_forced
from dynsr.data.noise_model import StateNoise, is_still, measurement_noise
from dynsr.data.observation import at_own_rows, carry
from dynsr.data.samples import SCHEMES, Samples, join_samples
from dynsr.data.slopes import (
    Choice,
    SlopeSettings,
    choose_scheme,
    local_polynomial,
    smooth_column,
)
from dynsr.data.smoothing import estimate_noise, smooth
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError

_SETTINGS = SlopeSettings()
_SAVGOL = re.compile(r"savgol\((\d+),(\d+)\)")


def add_velocities(
    runs: Sequence[Trajectory],
    velocities: Mapping[str, str],
    scheme: str = "auto",
    settings: SlopeSettings = _SETTINGS,
) -> list[Trajectory]:
    """Add the slopes of some states to the columns, as states of their own.

    The slopes are those of the scheme that the data choose for them, smoothed where there is noise;
    rows at the ends that have none go. The states themselves stay as they were measured. Where a
    state was not measured at every row, the slopes are those of the curves of
    :func:`dynsr.data.smoothing.smooth`.

    Parameters
    ----------
    runs : trajectories of the same columns.
    velocities : state -> the name of its slope.
    scheme : "auto", or a scheme of :func:`dynsr.data.slopes.smooth_column` to use instead.
    settings : what the choice of scheme rests on.

    Raises InputError when a state is unknown or there are too few rows.

    >>> t = np.linspace(0, 6, 301)
    >>> swing = Trajectory(t, np.sin(t)[:, None], ("x",))
    >>> (run,) = add_velocities([swing], {"x": "v"})
    >>> run.states, bool(np.allclose(run.x[:, 1], np.cos(run.t), atol=1e-6))
    (('x', 'v'), True)
    """
    runs = carry(runs)
    if any(run.unmeasured.size for run in runs):
        noise = estimate_noise(runs)
        return [_with_slopes(run, velocities, noise) for run in runs]
    parts: Sequence[Forced | None] = find_forced(runs) or [None] * len(runs)
    pairs = zip(runs, parts, strict=True)
    return [_with_velocities(run, velocities, scheme, settings, part) for run, part in pairs]


def _with_velocities(
    run: Trajectory,
    velocities: Mapping[str, str],
    scheme: str,
    settings: SlopeSettings,
    forced: Forced | None,
) -> Trajectory:
    slopes = []
    smoothed = run if forced is None else forced.taken_from(run)
    for state in velocities:
        x = smoothed.x[:, run.index(state)]
        chosen = scheme if scheme != "auto" else _choose_first(smoothed, state, settings).scheme
        found = smooth_column(run.t, x, chosen)
        # A state that does not change has no slope, but for the rounding of what fits it.
        slopes.append(replace(found, slope=np.zeros_like(found.slope)) if is_still(x) else found)
    rows = slice(max(s.rows.start for s in slopes), min(s.rows.stop for s in slopes))
    columns = [s.slope[rows.start - s.rows.start : rows.stop - s.rows.start] for s in slopes]
    if forced is not None:
        bent = [forced.slope[rows, run.index(state)] for state in velocities]
        columns = [column + own for column, own in zip(columns, bent, strict=True)]
    kept = run.select(rows)
    states = (*kept.states, *velocities.values())
    return replace(kept, x=np.column_stack([kept.x, *columns]), states=states)


def _with_slopes(
    run: Trajectory, velocities: Mapping[str, str], noise: Sequence[StateNoise]
) -> Trajectory:
    """Give a run with the slopes of its curves, for states not measured at every row."""
    places = [run.index(state) for state in velocities]
    gaps = ~run.measured
    gaps = np.column_stack([gaps, gaps[:, places]])
    x = np.column_stack([run.x, smooth(run, noise).slope[:, places]])
    return replace(run, x=x, states=(*run.states, *velocities.values()), unmeasured=gaps)


def _choose_first(run: Trajectory, state: str, settings: SlopeSettings) -> Choice:
    sigma = float(measurement_noise(run)[run.index(state)])
    return choose_scheme(run.t, run.x[:, run.index(state)], sigma, settings)


@dataclass(frozen=True, eq=False)
class _Twice:
    """A column made smooth, with two derivatives, on the rows that have both."""

    rows: slice
    x: np.ndarray
    slope: np.ndarray
    second: np.ndarray


def choose_second_samples(
    runs: Sequence[Trajectory],
    velocities: Mapping[str, str],
    target: str,
    scheme: str = "auto",
    settings: SlopeSettings = _SETTINGS,
) -> Samples:
    """Make the samples of a velocity: its slope is the second derivative of its state.

    Without noise a central difference is taken of the velocities; with noise value, slope and
    second derivative are those of one local polynomial, in a wider window than that for slopes.

    Parameters
    ----------
    runs : what :func:`add_velocities` gave.
    velocities : state -> the name of its slope.
    target : the velocity whose slope is wanted.
    scheme : "auto", or a scheme of :func:`dynsr.data.slopes.smooth_column` to use twice.
    settings : what the choice of scheme rests on.

    Raises InputError when there are too few rows.

    >>> t = np.linspace(0, 6, 301)
    >>> swing = Trajectory(t, np.sin(t)[:, None], ("x",))
    >>> samples = choose_second_samples(add_velocities([swing], {"x": "v"}), {"x": "v"}, "v")
    >>> bool(np.allclose(samples.y, -samples.columns["x"], atol=1e-4))
    True
    """
    runs = at_own_rows(runs, target)
    parts, measured = find_forced(runs), runs
    if parts is not None:
        runs = [_take(run, part, velocities) for run, part in zip(runs, parts, strict=True)]
    longest = max(runs, key=len)
    choices = {s: _choose(longest, s, velocities, scheme, settings) for s in longest.states}
    shortest = min(len(longest), _rows_of(choices.values()))
    some = [i for i, run in enumerate(runs) if len(run) >= shortest]
    pieces = [_samples(runs[i], velocities, target, choices) for i in some]
    if parts is not None:
        pieces = [
            _add(piece, measured[i], parts[i], velocities)
            for i, piece in zip(some, pieces, strict=True)
        ]
    return replace(join_samples(pieces), scheme=pieces[0].scheme)


def _take(run: Trajectory, forced: Forced, velocities: Mapping[str, str]) -> Trajectory:
    """Take what held inputs bend from the states, and its slope from their velocities."""
    plain = forced.taken_from(run)
    x = plain.x.copy()
    for state, velocity in velocities.items():
        own = run.index(velocity)
        x[:, own] = run.x[:, own] - forced.slope[:, run.index(state)]
    return replace(plain, x=x)


def _add(
    samples: Samples, run: Trajectory, forced: Forced, velocities: Mapping[str, str]
) -> Samples:
    """Add it again: to the states, their velocities and the slopes of these."""
    rows, X = np.searchsorted(run.t, samples.t), samples.X.copy()
    for place, state in enumerate(run.states):
        if state not in velocities.values():
            X[:, place] += forced.x[rows, place]
    for state, velocity in velocities.items():
        X[:, run.index(velocity)] += forced.slope[rows, run.index(state)]
    (state,) = (s for s, velocity in velocities.items() if velocity == samples.target)
    return replace(samples, X=X, y=samples.y + forced.second[rows, run.index(state)])


def _rows_of(choices: Iterable[Choice]) -> int:
    """Give the rows that a trajectory needs for every scheme to be applied."""
    numbers = [re.search(r"\d+", choice.scheme) for choice in choices]
    windows = [int(number[0]) for number in numbers if number]
    return 2 * max(windows, default=2) + 1


def _choose(
    run: Trajectory,
    state: str,
    velocities: Mapping[str, str],
    scheme: str,
    settings: SlopeSettings,
) -> Choice:
    """Choose for the second derivative of a state with a velocity, else for its slope."""
    first = _choose_first(run, state, settings)
    if scheme != "auto":
        return Choice(scheme, first.noise)
    if state not in velocities:
        return first
    if first.scheme in SCHEMES:
        velocity = run.x[:, run.index(velocities[state])]
        # The slope errs by what the velocity errs from row to row.
        return choose_scheme(run.t, velocity, 0.0, replace(settings, clean=np.inf))
    match = _SAVGOL.fullmatch(first.scheme)
    sigma = float(measurement_noise(run)[run.index(state)])
    return first if match is None else _widen(run.t, sigma, int(match[1]) / int(match[2]), settings)


def _widen(t: np.ndarray, sigma: float, length: float, settings: SlopeSettings) -> Choice:
    """Choose the polynomial whose window, for each of its degrees, is longer by a third.

    A window of twice the degree and twice the length passes the same frequencies, with less bias,
    so that the highest degree is taken where it fits into half of the rows. Second derivatives of
    noise are larger than slopes: on oscillators with 1 and 5 % of noise, the best windows are 1.3
    times as long as those of the slopes.
    """
    pairs = [(w, d) for w in settings.windows for d in settings.degrees if d + 1 < w <= len(t) // 2]
    if not pairs:
        raise InputError(f"{len(t)} rows are too few for second derivatives; give at least 25")
    wanted = 4 / 3 * length
    # Half a step of the windows, which grow by a third, is near enough for the higher degree.
    window, degree = min(pairs, key=lambda p: (max(abs(np.log(p[0] / p[1] / wanted)), 0.2), -p[1]))
    (weights,) = local_polynomial(t, window, degree, (2,))
    error = sigma * float(np.linalg.norm(weights[len(weights) // 2]))
    return Choice(f"savgol({window},{degree})", error)


def _differentiate_twice(t: np.ndarray, x: np.ndarray, v: np.ndarray, scheme: str) -> _Twice:
    if match := _SAVGOL.fullmatch(scheme):
        window, degree = int(match[1]), int(match[2])
        weights = local_polynomial(t, window, degree, (0, 1, 2))
        windows = np.lib.stride_tricks.sliding_window_view(x, window)
        value, slope, second = (np.sum(windows * w, axis=1) for w in weights)
        return _Twice(slice(window // 2, len(t) - window // 2), value, slope, second)
    if scheme in SCHEMES:
        again = smooth_column(t, v, scheme)
        return _Twice(again.rows, x[again.rows], again.x, again.slope)
    first = smooth_column(t, x, scheme)
    again = smooth_column(t[first.rows], first.slope, scheme)
    rows = slice(first.rows.start + again.rows.start, first.rows.start + again.rows.stop)
    return _Twice(rows, first.x[again.rows], first.slope[again.rows], again.slope)


def _samples(
    run: Trajectory, velocities: Mapping[str, str], target: str, choices: Mapping[str, Choice]
) -> Samples:
    columns, start, stop = run.columns.copy(), 0, len(run)
    seconds = {}
    for state, choice in choices.items():
        if state in velocities.values():
            continue
        place = run.index(state)
        if state in velocities:
            velocity = run.index(velocities[state])
            twice = _differentiate_twice(run.t, run.x[:, place], run.x[:, velocity], choice.scheme)
            rows = twice.rows
            columns[rows, place], columns[rows, velocity] = twice.x, twice.slope
            seconds[velocities[state]] = rows.start, twice.second, choice
        elif choice.scheme in SCHEMES:
            continue
        else:
            found = smooth_column(run.t, run.x[:, place], choice.scheme)
            rows = found.rows
            columns[rows, place] = found.x
        start, stop = max(start, rows.start), min(stop, rows.stop)
    first, second, choice = seconds[target]
    inside = slice(start - first, stop - first)
    return Samples(
        columns[start:stop],
        second[inside],
        run.names,
        target,
        choice.scheme,
        run.t[start:stop],
        choice.noise,
    )
