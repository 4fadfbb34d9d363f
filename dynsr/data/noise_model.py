"""Noise of measured states: its size, how it grows with the state, and how many rows are outliers.

Nothing is fitted to a whole trajectory here: each row is compared with the polynomial through its
neighbours, so that neither a model nor a smoother can be wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynsr.data.forcing import find_forced
from dynsr.data.lines import last_digit
from dynsr.data.samples import barycentric_weights
from dynsr.data.solver_rows import solver_errors
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError

_MAD = 1.4826
# Rows of a column that has neighbours on either side of some row.
_FEWEST = 5
# Rows that are worked on at a time.
_AT_ONCE = 20_000
# Steps in a row without a change that show that values were rounded.
_SAME = 2


def is_still(values: np.ndarray, rounded: float = 0.0) -> bool:
    """Whether values (n,) of a column do not differ, but for this share of their size.

    >>> is_still(np.array([3.0, 3.0])), is_still(np.array([3.0, 3.1]))
    (True, False)
    """
    return bool(np.ptp(values) <= rounded * np.max(np.abs(values)))


def scale_of(values: np.ndarray) -> float:
    """Give the standard deviation of values (n,); of a column that is still its size, or 1.

    >>> scale_of(np.array([1.0, 3.0])), scale_of(np.array([3.0, 3.0])), scale_of(np.zeros(2))
    (1.0, 3.0, 1.0)
    """
    return float(np.max(np.abs(values)) if is_still(values) else np.std(values)) or 1.0


def robust_scale(values: np.ndarray, axis: int | tuple[int, ...] | None = None) -> np.ndarray:
    """Give 1.4826 times the median of |values|: the standard deviation of normal values.

    >>> float(robust_scale(np.array([-1.0, 1.0, 100.0])))
    1.4826
    """
    return np.asarray(_MAD * np.median(np.abs(values), axis=axis))


def scale_error(count: np.ndarray | float) -> np.ndarray:
    """Give the relative standard error of the robust scale of so many normal values.

    That of the median of their sizes, 1 / (4 q phi(q) sqrt(n)) with q their quartile, 0.6745.

    >>> float(scale_error(100).round(4))
    0.1166
    """
    quartile = 1 / _MAD
    density = np.exp(-(quartile**2) / 2) / np.sqrt(2 * np.pi)
    return np.asarray(1 / (4 * quartile * density * np.sqrt(count)))


def interpolation_weights(t: np.ndarray, order: int) -> np.ndarray:
    """Weights (n - order, order + 1), of norm 1, of each point's miss from its neighbours."""
    _, weights = barycentric_weights(np.lib.stride_tricks.sliding_window_view(t, order + 1))
    weights /= weights[:, [order // 2]]
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


def interpolation_residuals(t: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
    """Miss of each point from the polynomial through its ``order`` neighbours, per unit noise.

    Of times that are even but for rounding, all points have the same weights.
    """
    ulp = np.finfo(float).eps * max(abs(t[0]), abs(t[-1]))
    if np.ptp(np.diff(t)) <= 2 * ulp:
        weights = interpolation_weights(np.arange(order + 1.0), order)[0]
        shifted = (w * x[j : len(x) - order + j] for j, w in enumerate(weights))
        return np.asarray(sum(shifted))
    found = np.empty((len(t) - order, *x.shape[1:]))
    for first in range(0, len(found), _AT_ONCE):
        own = slice(first, first + _AT_ONCE + order)
        weights = interpolation_weights(t[own], order)
        values = np.lib.stride_tricks.sliding_window_view(x[own], order + 1, axis=0)
        found[first : first + _AT_ONCE] = np.einsum("ij,i...j->i...", weights, values)
    return found


def measurement_noise(trajectory: Trajectory) -> np.ndarray:
    """Estimate the standard deviation of measurement noise of every state, (k,), state units.

    Each point is compared with the polynomial through its neighbours (a high-order difference);
    the median absolute miss, scaled for the normal law, is noise plus what the polynomial cannot
    follow, so the smallest over orders 2 to 8 is taken. Rows that repeat one value, as at rest
    below the last digit, say nothing of it. Times may be uneven, and rows at which a
    state was not measured say nothing of it; NaN where that leaves fewer than 5. Kinks of
    inputs and of a solver's steps are no noise. Errors that are known are taken as they are, by
    their mean square.

    >>> t = np.linspace(0, 10, 500)
    >>> noisy = np.sin(t) + np.random.default_rng(0).normal(0, 0.01, 500)
    >>> bool(0.008 < measurement_noise(Trajectory(t, noisy[:, None], ("x",)))[0] < 0.012)
    True
    """
    found = _estimate_by_neighbours(trajectory)
    for state, known in trajectory.noise.items():
        own, place = trajectory.own_rows(state), trajectory.index(state)
        if known.sure and len(own):
            squares = known.at(trajectory.x[:, place])[own] ** 2
            found[place] = np.sqrt(np.mean(squares))
    return found


def _estimate_by_neighbours(trajectory: Trajectory) -> np.ndarray:
    parts = find_forced([trajectory])
    smooth = trajectory if parts is None else parts[0].taken_from(trajectory)
    if trajectory.unmeasured.size:
        found = np.full(len(trajectory.states), np.nan)
        for place, own in enumerate(smooth.measured.T):
            if np.count_nonzero(own) >= _FEWEST:
                found[[place]] = _noise_between(smooth.t[own], smooth.x[own, place, None])
        return found
    return _noise_between(smooth.t, smooth.x)


def _noise_between(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(k,) standard deviations of what columns (n, k) miss of their neighbours."""
    orders = [order for order in (2, 4, 6, 8) if len(t) > order + 2]
    if not orders:
        raise InputError(f"{len(t)} rows are too few to estimate noise; give at least 5")
    found = []
    for order in orders:
        misses = interpolation_residuals(t, x, order)
        found.append([_moving_scale(*pair, order) for pair in zip(misses.T, x.T, strict=True)])
    # Rows that a solver interpolated jump where its steps meet: that is no noise of theirs.
    return np.where(solver_errors(t, x) > 0, 0.0, np.min(found, axis=0))


def _moving_scale(misses: np.ndarray, x: np.ndarray, order: int) -> float:
    """Give the size of the residuals of rows whose neighbours are not all the same value."""
    moves = ~_repeats(x, order)
    return float(robust_scale(misses[moves])) if moves.any() else 0.0


def _repeats(x: np.ndarray, order: int) -> np.ndarray:
    """(n - order,) whether the rows of each window have one value."""
    steps = np.concatenate([[0], np.cumsum(np.diff(x) != 0)])
    return np.asarray(steps[order:] == steps[: len(steps) - order])


def rounding(values: np.ndarray) -> float:
    """Give the standard deviation of what values lose by their last digit.

    Parameters
    ----------
    values : (n,) numbers; those that are not finite do not count.

    >>> round(rounding(np.array([0.31, 0.2])), 5)
    0.00289
    """
    return last_digit(values[np.isfinite(values)]) / math.sqrt(12)


# Times, values, and what was taken from the values: noise may be a share of the sum.
Column = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class NoiseSettings:
    """How noise is estimated from neighbouring rows.

    Parameters
    ----------
    orders : orders of the interpolating polynomials tried; the least miss is taken.
    outlier : a row further than this many standard deviations off is an outlier.
    share : more outliers than this share of the rows are motion, not outliers.
    rounds : how often outliers are looked for again without those found before.
    steps : steps of the weighted fit of additive and multiplicative noise.
    """

    orders: tuple[int, ...] = (2, 4, 6, 8)
    outlier: float = 4.0
    share: float = 0.15
    rounds: int = 4
    steps: int = 30


@dataclass(frozen=True)
class StateNoise:
    """Noise of one measured state.

    Parameters
    ----------
    additive : standard deviation that does not depend on the state, in state units.
    multiplicative : standard deviation as a share of the state's size.
    outliers : share of the rows that lie further off than this noise explains.

    >>> StateNoise(3.0, 0.1).sd(np.array([0.0, 40.0]))
    array([3., 5.])
    """

    additive: float
    multiplicative: float = 0.0
    outliers: float = 0.0

    def sd(self, x: np.ndarray) -> np.ndarray:
        """Give the standard deviation of the noise at the true (smoothed) values ``x``."""
        return np.hypot(self.additive, self.multiplicative * np.asarray(x, dtype=float))


def neighbour_noise(columns: Sequence[Column], settings: NoiseSettings) -> StateNoise:
    """Estimate the noise of one state from the residuals of each row from its neighbours.

    Parameters
    ----------
    columns : (times, values, what was taken from the values) of the state in every trajectory.
    settings : how it is done.

    Gives no noise where no trajectory has 5 rows.
    """
    columns = [column for column in columns if len(column[0]) >= 5]
    if not columns:
        return StateNoise(0.0)
    whole = noise = _noise_of_misses(columns, settings)
    total, kept = sum(len(column[0]) for column in columns), columns
    for _ in range(settings.rounds):
        fresh = [find_outliers(t, x, noise, settings, taken) for t, x, taken in kept]
        kept = [
            (t[~out], x[~out], taken[~out]) for (t, x, taken), out in zip(kept, fresh, strict=True)
        ]
        left = sum(len(column[0]) for column in kept)
        if left < (1 - settings.share) * total:
            # So many rows off are no outliers: the polynomials do not follow the motion there.
            return whole
        noise = replace(_noise_of_misses(kept, settings), outliers=1 - left / total)
        if not any(np.any(out) for out in fresh):
            break
    return noise


def _noise_of_misses(columns: Sequence[Column], settings: NoiseSettings) -> StateNoise:
    """Fit additive and multiplicative noise to the residuals of the best order of interpolation."""
    best: tuple[float, list[tuple[np.ndarray, np.ndarray]]] | None = None
    for order in settings.orders:
        pieces = [_misses(*column, order) for column in columns if len(column[0]) > order + 2]
        pieces = [piece for piece in pieces if len(piece[0])]
        if pieces:
            scale = float(robust_scale(np.concatenate([p[0] for p in pieces])))
            if best is None or scale < best[0]:
                best = scale, pieces
    if best is None or best[0] == 0:
        return StateNoise(0.0)
    misses = np.concatenate([p[0] for p in best[1]])
    level = np.concatenate([p[1] for p in best[1]])
    # Neighbouring misses share rows: about half of them are independent.
    return fit_law(misses**2, level, np.full(len(misses), 0.5), settings, least_noise(columns))


def least_noise(columns: Sequence[Column]) -> float:
    """Give the noise that every row has: that of rounding, where rows that repeat a value show it.

    Parameters
    ----------
    columns : as in :func:`neighbour_noise`.
    """
    if not any(len(x) > _SAME and _repeats(x, _SAME).any() for _, x, _ in columns):
        return 0.0
    return rounding(np.concatenate([x + taken for _, x, taken in columns]))


def _misses(
    t: np.ndarray, x: np.ndarray, taken: np.ndarray | float, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Give :func:`_all_misses` of the rows that are not among neighbours of one value."""
    moves = ~_repeats(x, order)
    misses, level = _all_misses(t, x, taken, order)
    return misses[moves], level[moves]


def _all_misses(
    t: np.ndarray, x: np.ndarray, taken: np.ndarray | float, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of the inner rows per unit noise, and the mean squared level that they saw."""
    weights = interpolation_weights(t, order)
    windows = np.lib.stride_tricks.sliding_window_view(x, order + 1)
    # A measured level holds noise itself; that of a few rows holds less.
    smooth = np.convolve(np.pad(x + taken, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    levels = np.lib.stride_tricks.sliding_window_view(smooth, order + 1)
    return np.einsum("ij,ij->i", weights, windows), np.einsum("ij,ij->i", weights**2, levels**2)


def fit_law(
    squares: np.ndarray,
    level: np.ndarray,
    weights: np.ndarray,
    settings: NoiseSettings,
    least: float = 0.0,
) -> StateNoise:
    """Fit squares ~ a^2 + m^2 level; additive, multiplicative or both by the BIC.

    Parameters
    ----------
    squares : (n,) squared residuals.
    level : (n,) squared values of the state there.
    weights : (n,) share of each that is independent of the others.
    settings : cap and steps of the fit.
    least : standard deviation that every row has in addition.
    """
    scale = float(robust_scale(np.sqrt(squares))) ** 2
    columns, rows = np.stack([np.ones(len(squares)), level]), max(float(np.sum(weights)), 2.0)
    tried: list[tuple[float, np.ndarray]] = []
    starts = [(scale, 0.0), (0.0, scale / max(float(np.median(level)), 1e-300)), (0.0, 0.0)]
    for start in starts:
        law = np.array(start)
        if not np.any(law):
            law = 0.5 * (tried[0][1] + tried[1][1])
        law, loss = _ascend(squares, columns, weights, law, settings, least)
        tried.append((loss + 0.5 * np.sum(law > 0) * np.log(rows), law))
    additive, multiplicative = np.sqrt(min(tried, key=lambda pair: pair[0])[1])
    return StateNoise(float(np.hypot(additive, least)), float(multiplicative))


def _ascend(
    squares: np.ndarray,
    columns: np.ndarray,
    weights: np.ndarray,
    law: np.ndarray,
    settings: NoiseSettings,
    least: float,
) -> tuple[np.ndarray, float]:
    """Maximise the normal likelihood of squares ~ law @ columns, from ``law``; what is 0 stays 0.

    The updates keep the law positive. A squared residual counts at most as an outlier's would.
    """
    cap, floor = settings.outlier**2, 1e-12 * float(np.mean(squares)) + 1e-300 + least**2
    for _ in range(settings.steps):
        expected = law @ columns + floor
        ratio = weights * np.minimum(squares / expected, cap) / expected
        below = np.maximum(columns @ (weights / expected), 1e-300)
        law = law * np.sqrt((columns @ ratio) / below)
    expected = law @ columns + floor
    losses = np.log(expected) + np.minimum(squares / expected, cap)
    return law, float(weights @ losses) / 2


def find_outliers(
    t: np.ndarray,
    x: np.ndarray,
    noise: StateNoise,
    settings: NoiseSettings,
    taken: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Find the rows that miss the polynomial through their neighbours by far too much.

    Parameters
    ----------
    t, x : (n,) times and values of one state.
    noise : the noise that is expected.
    settings : how far is too far.
    taken : (n,) what was taken from the values.

    Gives (n,) flags; of neighbours only the worst has one.
    """
    found = np.zeros(len(t), dtype=bool)
    order = min(4, 2 * ((len(t) - 3) // 2))
    if order < 2 or noise.additive == noise.multiplicative == 0:
        return found
    misses, level = _all_misses(t, x, taken, order)
    z = np.abs(misses) / np.sqrt(noise.additive**2 + noise.multiplicative**2 * level)
    half = order // 2
    # An outlier spoils the misses of its neighbours: only the worst of a window is one.
    padded = np.pad(z, half)
    worst = np.lib.stride_tricks.sliding_window_view(padded, order + 1).max(axis=1)
    found[half : len(t) - half] = (z > settings.outlier) & (z >= worst)
    return found
