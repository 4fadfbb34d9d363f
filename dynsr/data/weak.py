"""The weak form: slopes in the mean over windows, without a derivative of the measured states.

With a bump phi that vanishes at the ends of a window, the integral of phi x' is minus that of
phi' x (Schaeffer and McCalla 2017; Messenger and Bortz 2021). Both integrals are sums over rows, so
that a law x' = f holds as ``matrix @ f(rows) = y`` for whatever f.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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


_SETTINGS = WeakSettings()


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
            f"{rows} rows hold no window of {', '.join(map(str, lengths))} steps; "
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
