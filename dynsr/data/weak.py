"""The weak form: slopes in the mean over windows, without a derivative of the measured states.

With a bump phi that vanishes at the ends of a window, the integral of phi x' is minus that of
phi' x (Schaeffer and McCalla 2017; Messenger and Bortz 2021). Both integrals are sums over rows, so
that a law x' = f is true as ``matrix @ f(rows) = y`` for whatever f.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import spsolve

from dynsr.data.samples import barycentric_weights
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError


@dataclass(frozen=True)
class WeakSettings:
    """Windows and bumps of the weak form.

    Parameters
    ----------
    shares : lengths of the windows as shares of the record.
    least : least number of steps in a window.
    density : windows begin every so-manyth part of their length.
    power : the bump is (1 - s^2)^power on [-1, 1]; all derivatives below that order vanish at its
        ends, so that the trapezoidal rule integrates it to that order of an even step.
    finer : sums run over so many even steps for each row of a window, on cubics through four rows.
    """

    shares: tuple[float, ...] = (0.05, 0.1, 0.2)
    least: int = 8
    density: int = 4
    power: int = 4
    finer: int = 4


@dataclass(frozen=True)
class WeakSlopeSettings:
    """How slopes are made from the weak form.

    Parameters
    ----------
    lengths : steps in the windows that are tried, at most a third of the rows.
    density : windows begin every so-manyth part of their length.
    pieces : cubic pieces of the slope in the length of a window.
    alike : of the lengths whose curves foretell the rows within this factor of the best, the
        longest is taken: its slopes have the least noise.
    ridge : share of the largest weight of a piece that is added to all; the ends are uncertain.
    """

    lengths: tuple[int, ...] = (5, 7, 10, 14, 20, 28, 40, 56, 80, 112, 160)
    density: int = 8
    pieces: float = 1.5
    alike: float = 1.01
    ridge: float = 1e-6


_SETTINGS = WeakSettings()
_SLOPES = WeakSlopeSettings()
_FEWEST = 16
_AT_A_TIME = 500


@dataclass(frozen=True, eq=False)
class WeakForm:
    """Integrals over w windows of one trajectory of n rows.

    Parameters
    ----------
    matrix : (w, n) weights; ``matrix @ f`` are the means of a function's values over the windows,
        each row of the matrix has the sum 1.
    slope : (w, n) weights; ``slope @ x`` are the same means of the slope of x.
    y : (w,) these means for the target, in state units per second.
    windows : (w, 2) first and last row of each window.
    """

    matrix: np.ndarray
    slope: np.ndarray
    y: np.ndarray
    windows: np.ndarray


def weak_form(
    run: Trajectory,
    target: str,
    lengths: Sequence[int] | None = None,
    settings: WeakSettings = _SETTINGS,
) -> WeakForm:
    """Give the weak form of one state's equation over windows of several lengths.

    Parameters
    ----------
    run : the trajectory; times may be uneven.
    target : the state whose equation it is.
    lengths : steps in the windows; None takes ``settings.shares`` of the rows.
    settings : windows and bumps.

    Raises InputError when no window fits into the rows.

    >>> t = np.linspace(0, 3, 61)
    >>> weak = weak_form(Trajectory(t, np.exp(-t)[:, None], ("x",)), "x")
    >>> bool(np.allclose(weak.matrix @ -np.exp(-t), weak.y, rtol=1e-3))
    True
    """
    rows = len(run)
    if lengths is None:
        least = min(settings.least, rows - 1)
        lengths = sorted({max(least, int(share * rows)) for share in settings.shares})
    windows = [
        (start, start + length)
        for length in lengths
        for start in range(0, rows - length, max(1, length // settings.density))
    ]
    if not windows or min(lengths) < 4:
        raise InputError(
            f"{rows} rows have no window of {', '.join(map(str, lengths))} steps; "
            "give windows of 4 steps or more, and more rows than that"
        )
    matrix, slope = np.zeros((len(windows), rows)), np.zeros((len(windows), rows))
    for i, (start, stop) in enumerate(windows):
        inside = slice(start, stop + 1)
        matrix[i, inside], slope[i, inside] = _weights(run.t[inside], settings)
    x = run.x[:, run.index(target)]
    return WeakForm(matrix, slope, slope @ x, np.array(windows))


def _weights(t: np.ndarray, settings: WeakSettings) -> tuple[np.ndarray, np.ndarray]:
    """Weights (n,) of the values and of the slope, for the n times of one window.

    Sums run over fine even steps by the trapezoidal rule, between the rows on cubics through four.
    """
    fine = np.linspace(t[0], t[-1], settings.finer * len(t) + 1)
    s = np.linspace(-1, 1, len(fine))
    bump = (1 - s**2) ** settings.power
    slope = s * (1 - s**2) ** (settings.power - 1)
    # A constant has itself for its mean, and a line its slope.
    onto = _cubic_weights(t, fine)
    return bump @ onto / np.sum(bump), slope @ onto / (slope @ fine)


def _cubic_weights(t: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """Weights (m, n) that give values at m fine times from those at n times, by local cubics."""
    first = np.clip(np.searchsorted(t, fine, side="right") - 2, 0, len(t) - 4)
    columns = first[:, None] + np.arange(4)
    gaps = fine[:, None] - t[columns]
    hit = np.abs(gaps) < 1e-12 * (t[-1] - t[0])
    _, weights = barycentric_weights(t[columns])
    share = np.where(hit, 1.0, weights / np.where(hit, 1.0, gaps))
    share = np.where(hit.any(axis=1, keepdims=True), hit, share)
    onto = np.zeros((len(fine), len(t)))
    np.put_along_axis(onto, columns, share / share.sum(axis=1, keepdims=True), axis=1)
    return onto


@lru_cache(maxsize=32)
def weak_slopes(
    times: bytes, values: bytes, settings: WeakSlopeSettings = _SLOPES
) -> tuple[slice, np.ndarray, np.ndarray]:
    """Give the slope whose means over all windows are those of the weak form, and its integral.

    The slope is a cubic spline; of several lengths of windows, generalised cross-validation of the
    integral on the rows chooses (Craven and Wahba 1979).

    Parameters
    ----------
    times, values : bytes of (n,) times and of the values of one column, float64; the samples of
        every target want all columns, and each is made once.
    settings : the numbers that decide.

    Gives the rows that have a slope, and values and slopes there; half a window at either end has
    none. Raises InputError for fewer than 16 rows.

    >>> t = np.linspace(0, 3, 91)
    >>> rows, x, slope = weak_slopes(t.tobytes(), np.exp(-t).tobytes())
    >>> bool(np.allclose(slope, -np.exp(-t[rows]), rtol=2e-3))
    True
    """
    t, x = np.frombuffer(times), np.frombuffer(values)
    if len(t) < _FEWEST:
        raise InputError(f"{len(t)} rows are too few for scheme 'weak'; give at least {_FEWEST}")
    lengths = [length for length in settings.lengths if 3 * length <= len(t)]
    tried = []
    for length in lengths or settings.lengths[:1]:
        slope, integral, freedom = _fit_slope(t, x, length, settings)
        rows = slice(length // 2, len(t) - length // 2)
        miss = float(np.mean((x - integral)[rows] ** 2)) / (1 - min(freedom / len(t), 0.9)) ** 2
        tried.append((miss, rows, integral[rows], slope[rows]))
    least = min(miss for miss, *_ in tried)
    return next(found for miss, *found in reversed(tried) if miss <= settings.alike**2 * least)


def _fit_slope(
    t: np.ndarray, x: np.ndarray, length: int, settings: WeakSlopeSettings
) -> tuple[np.ndarray, np.ndarray, int]:
    """Give slopes (n,), their integral (n,) at the level of the values, and its free numbers."""
    n = len(t)
    means, slope = _sparse_weights(t, length, max(1, length // settings.density))
    pieces = max(1, round(settings.pieces * (n - 1) / length))
    inner = np.interp(np.linspace(0, n - 1, pieces + 1), np.arange(n), t)
    knots = np.concatenate([[t[0]] * 3, inner, [t[-1]] * 3])
    design = (means @ BSpline.design_matrix(t, knots, 3)).tocsc()
    normal = (design.T @ design).tocsc()
    size = normal.shape[0]
    normal = normal + settings.ridge * normal.diagonal().max() * eye_array(size, format="csc")
    found = BSpline(knots, spsolve(normal, design.T @ (slope @ x)), 3)
    integral = found.antiderivative()(t)
    return found(t), integral + np.mean(x - integral), size + 1


def _sparse_weights(t: np.ndarray, length: int, every: int) -> tuple[csr_array, csr_array]:
    """Weights (w, n) of the means of values and of the slope over windows of one length."""
    starts = np.arange(0, len(t) - length, every)
    windows = np.lib.stride_tricks.sliding_window_view(t, length + 1)[::every]
    steps = np.diff(t)
    if np.ptp(steps) <= 1e-6 * steps.mean():
        once = np.array(_weights(t[: length + 1], _SETTINGS))
        pairs = np.broadcast_to(once, (len(starts), 2, length + 1))
    else:
        pairs = np.concatenate(
            [
                _uneven_weights(windows[i : i + _AT_A_TIME], _SETTINGS)
                for i in range(0, len(starts), _AT_A_TIME)
            ]
        )
    columns = (starts[:, None] + np.arange(length + 1)).ravel()
    ends = np.arange(len(starts) + 1) * (length + 1)
    shape = (len(starts), len(t))
    means, slope = (csr_array((pairs[:, k].ravel(), columns, ends), shape) for k in (0, 1))
    return means, slope


def _uneven_weights(windows: np.ndarray, settings: WeakSettings) -> np.ndarray:
    """Weights (w, 2, m) of the values and of the slope for windows (w, m) of uneven times.

    Values are taken on lines between rows: cubics through rows that are close together would raise
    their noise.
    """
    count, m = windows.shape
    s = np.linspace(-1, 1, settings.finer * m + 1)
    bumps = np.array([(1 - s**2) ** settings.power, s * (1 - s**2) ** (settings.power - 1)])
    first, last = windows[:, :1], windows[:, -1:]
    fine = first + (s + 1) / 2 * (last - first)
    left = np.clip(np.sum(windows[:, :, None] <= fine[:, None], axis=1) - 1, 0, m - 2)
    begin = np.take_along_axis(windows, left, axis=1)
    share = (fine - begin) / (np.take_along_axis(windows, left + 1, axis=1) - begin)
    place = left + m * np.arange(count)[:, None]
    found = [
        np.bincount(place.ravel(), (bump * (1 - share)).ravel(), count * m)
        + np.bincount(place.ravel() + 1, (bump * share).ravel(), count * m)
        for bump in bumps
    ]
    means, slope = (one.reshape(count, m) for one in found)
    level = means.sum(axis=1, keepdims=True)
    line = np.sum(slope * windows, axis=1, keepdims=True)
    return np.stack([means / level, slope / line], axis=1)
