"""Slopes: high-order differences and smoothers of one column, and the choice that the data make."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from scipy.interpolate import CubicSpline, make_smoothing_spline

from dynsr.data.samples import (
    SCHEMES,
    Samples,
    barycentric_weights,
    central_weights,
    difference,
    join,
)
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError, need

_SAVGOL = re.compile(r"savgol\((\d+),(\d+)\)")
_MAD = 1.4826


@dataclass(frozen=True, eq=False)
class Smooth:
    """One column made smooth: the rows that have a slope, and the values and slopes there."""

    rows: slice
    x: np.ndarray
    slope: np.ndarray


def robust_scale(values: np.ndarray, axis: int | tuple[int, ...] | None = None) -> np.ndarray:
    """Give 1.4826 times the median of |values|: the standard deviation of normal values.

    >>> float(robust_scale(np.array([-1.0, 1.0, 100.0])))
    1.4826
    """
    return np.asarray(_MAD * np.median(np.abs(values), axis=axis))


def interpolation_residuals(t: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
    """Miss of each point from the polynomial through its ``order`` neighbours, per unit noise."""
    _, weights = barycentric_weights(np.lib.stride_tricks.sliding_window_view(t, order + 1))
    weights /= weights[:, [order // 2]]
    values = np.lib.stride_tricks.sliding_window_view(x, order + 1, axis=0)
    misses = np.einsum("ij,i...j->i...", weights, values)
    norm = np.linalg.norm(weights, axis=1)
    return misses / norm.reshape(-1, *[1] * (x.ndim - 1))


def local_polynomial(t: np.ndarray, window: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (rows, window) for value and slope at the middle of every window of times.

    Even times have one row of weights. They are scipy.signal.savgol_coeffs', which knows even
    times only and works with monomials: at 129 times and degree 6 its weights err by 2e-6, these
    by 1e-15.
    """
    nodes = np.lib.stride_tricks.sliding_window_view(t, window)
    steps = np.diff(t)
    if np.ptp(steps) <= 1e-6 * steps.mean():
        nodes = nodes[:1]
    offset = nodes - nodes[:, [window // 2]]
    scale = np.abs(offset).max(axis=1, keepdims=True)
    # Legendre polynomials keep the normal equations well conditioned up to degree 6.
    basis = legendre.legvander(offset / scale, degree)
    gram = np.einsum("nwi,nwj->nij", basis, basis)
    at_middle = np.stack([legendre.legvander(np.zeros(1), degree)[0], _legendre_slopes(degree)])
    picked = np.linalg.solve(gram, np.broadcast_to(at_middle.T, (len(gram), degree + 1, 2)))
    weights = np.einsum("nwi,nik->knw", basis, picked)
    return weights[0], weights[1] / scale


def _legendre_slopes(degree: int) -> np.ndarray:
    """Slope of every Legendre polynomial up to a degree, at 0."""
    slopes = [legendre.Legendre.basis(j).deriv()(0.0) if j else 0.0 for j in range(degree + 1)]
    return np.array(slopes)


def _savgol(t: np.ndarray, x: np.ndarray, window: int, degree: int) -> Smooth:
    """Fit a polynomial around every time (Savitzky and Golay 1964; here on any grid)."""
    value, slope = local_polynomial(t, window, degree)
    windows = np.lib.stride_tricks.sliding_window_view(x, window)
    half = window // 2
    if len(value) == 1:
        values, slopes = windows @ value[0], windows @ slope[0]
    else:
        values = np.einsum("ij,ij->i", value, windows)
        slopes = np.einsum("ij,ij->i", slope, windows)
    return Smooth(slice(half, len(t) - half), values, slopes)


def _spline(t: np.ndarray, x: np.ndarray) -> Smooth:
    """Cubic smoothing spline, strength by generalised cross-validation (Woltring 1986)."""
    # The search for the strength is on a log scale around 1 for unit steps and unit values.
    step, scale = float(np.mean(np.diff(t))), float(np.std(x)) or 1.0
    spline = make_smoothing_spline((t - t[0]) / step, x / scale)
    # The ends of a smoothing spline are its least accurate.
    cut = max(1, min(len(t) // 50, 20))
    rows = slice(cut, len(t) - cut)
    at = (t[rows] - t[0]) / step
    return Smooth(rows, spline(at) * scale, spline.derivative()(at) * scale / step)


def _total_variation(t: np.ndarray, x: np.ndarray) -> Smooth:
    """Slope of least total variation, by the library ``derivative`` (Tibshirani 2014)."""
    need("derivative", "pysindy", "scheme 'total-variation'")
    import derivative

    scale = float(np.std(x)) or 1.0
    misses = interpolation_residuals(t, x[:, None] / scale, 2)
    alpha = max(float(robust_scale(misses)) ** 2, 1e-10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        slope = scale * derivative.dxdt(x / scale, t, kind="trend_filtered", order=1, alpha=alpha)
    integral = np.concatenate([[0.0], np.cumsum(np.diff(t) * (slope[1:] + slope[:-1]) / 2)])
    values = integral + np.mean(x - integral)
    cut = max(1, len(t) // 50)
    rows = slice(cut, len(t) - cut)
    return Smooth(rows, values[rows], slope[rows])


def smooth_column(t: np.ndarray, x: np.ndarray, scheme: str) -> Smooth:
    """Differentiate one column by a named scheme.

    Parameters
    ----------
    t : (n,) times in seconds, strictly increasing.
    x : (n,) values of one state.
    scheme : "forward", "backward", "central2" to "central8", "savgol(WINDOW,DEGREE)", "spline" or
        "total-variation".

    Raises InputError on any other name, and when there are too few rows for a difference.

    >>> t = np.linspace(0.0, 1.0, 21)
    >>> bool(np.allclose(smooth_column(t, t**2, "savgol(5,2)").slope, 2 * t[2:-2]))
    True
    """
    if scheme == "spline":
        return _spline(t, x)
    if scheme == "total-variation":
        return _total_variation(t, x)
    if scheme in SCHEMES:
        rows, slope = difference(t, x, scheme)
        return Smooth(rows, x[rows], slope)
    if match := _SAVGOL.fullmatch(scheme):
        window, degree = int(match[1]), int(match[2])
        if window % 2 == 0 or not degree < window <= len(t):
            raise InputError(
                f"scheme {scheme!r} does not fit {len(t)} rows; give an odd window of at most that "
                "many, larger than the degree"
            )
        return _savgol(t, x, int(match[1]), int(match[2]))
    known = ", ".join([*SCHEMES, "savgol(WINDOW,DEGREE)", "spline", "total-variation"])
    raise InputError(f"unknown scheme {scheme!r}; the schemes are: {known}")


@dataclass(frozen=True)
class SlopeSettings:
    """How the data choose the scheme of their slopes.

    Parameters
    ----------
    clean : noise that makes slopes of neighbouring rows err by less than this share of their
        size (RMS) is not worth smoothing.
    finest : a central difference that errs by less than this share is not made wider, since a
        wider one reaches further across kinks.
    quantile : which quantile of the rows' errors a central difference is chosen by. The bias is
        large where the motion is fast, which a median would not see; the few rows beside the
        kinks of an adaptive solver, which higher orders spread, must not decide.
    windows : odd numbers of rows of the local polynomials tried.
    degrees : even degrees of the local polynomials tried; an odd one has the slopes of the even
        one above it.
    reference : a window of little bias is at most this share of the one best for the values.
    biased : a share of bias in given slopes from which on they are warned about.
    """

    clean: float = 1e-5
    finest: float = 1e-7
    quantile: float = 0.8
    windows: tuple[int, ...] = (5, 7, 9, 13, 17, 23, 31, 41, 55, 73, 97, 129)
    degrees: tuple[int, ...] = (2, 4, 6)
    reference: float = 0.7
    biased: float = 0.01


_SETTINGS = SlopeSettings()


class BiasWarning(UserWarning):
    """The slopes are biased by the difference scheme at this step."""


@dataclass(frozen=True)
class Choice:
    """A scheme, and the error of its slopes to expect (RMS, units per second)."""

    scheme: str
    noise: float


def measurement_noise(trajectory: Trajectory) -> np.ndarray:
    """Estimate the standard deviation of measurement noise of every state, (k,), state units.

    Each point is compared with the polynomial through its neighbours (a high-order difference);
    the median absolute miss, scaled for the normal law, is noise plus what the polynomial cannot
    follow, so the smallest over orders 2 to 8 is taken. Times may be uneven.

    >>> t = np.linspace(0, 10, 500)
    >>> noisy = np.sin(t) + np.random.default_rng(0).normal(0, 0.01, 500)
    >>> bool(0.008 < measurement_noise(Trajectory(t, noisy[:, None], ("x",)))[0] < 0.012)
    True
    """
    orders = [order for order in (2, 4, 6, 8) if len(trajectory) > order + 2]
    if not orders:
        raise InputError(f"{len(trajectory)} rows are too few to estimate noise; give at least 5")
    found = [
        robust_scale(interpolation_residuals(trajectory.t, trajectory.x, o), axis=0) for o in orders
    ]
    return np.min(found, axis=0)


def choose_scheme(
    t: np.ndarray, x: np.ndarray, sigma: float, settings: SlopeSettings = _SETTINGS
) -> Choice:
    """Choose how to differentiate one column: by a central difference, or smoothed.

    Parameters
    ----------
    t : (n,) times in seconds, strictly increasing.
    x : (n,) values of one state.
    sigma : standard deviation of their noise, in state units.
    settings : what the choice rests on.

    Raises InputError when there are too few rows.

    >>> t = np.linspace(0, 10, 1001)
    >>> choose_scheme(t, np.sin(t), 0.0).scheme
    'central4'
    """
    step = float(np.median(np.diff(t)))
    slopes = np.diff(x) / np.diff(t)
    size = float(np.sqrt(np.mean(slopes**2))) or 1.0
    central = _choose_central(t, x, sigma, size, settings)
    if sigma / step <= settings.clean * size or len(t) < 2 * settings.windows[0]:
        return central
    return _choose_smoother(t, x, sigma, settings)


def _choose_central(
    t: np.ndarray, x: np.ndarray, sigma: float, size: float, settings: SlopeSettings
) -> Choice:
    orders = [order for order in (2, 4, 6, 8) if len(t) > order + 1]
    if len(orders) < 2:
        if not orders:
            raise InputError(f"{len(t)} rows are too few for slopes; give at least 4 a trajectory")
        return Choice("central2", sigma / float(np.median(np.diff(t))))
    slopes = [smooth_column(t, x, f"central{order}").slope for order in orders]
    best = Choice("central2", np.inf)
    for order, low, high in zip(orders, slopes, slopes[1:], strict=False):
        random = sigma * float(np.median(np.linalg.norm(central_weights(t, order), axis=1)))
        error = float(np.quantile(np.abs(high - low[1:-1]), settings.quantile)) + random
        if error < best.noise and best.noise > settings.finest * size:
            best = Choice(f"central{order}", error)
    return best


def _choose_smoother(t: np.ndarray, x: np.ndarray, sigma: float, settings: SlopeSettings) -> Choice:
    """Choose the local polynomial whose slopes have the least expected squared error.

    With slopes D y of one window and R y of a reference of little bias, both linear in the data,
    mean((D y - R y)^2) - sigma^2 |D - R|^2 + sigma^2 |D|^2 is an unbiased estimate of bias^2 +
    variance of D y (Mallows' Cp, carried over from values to slopes).
    """
    base, other = _slopes_and_weights(t, x, *_reference(t, x, sigma, settings))
    best = Choice(f"savgol({settings.windows[0]},{settings.degrees[0]})", np.inf)
    for window, degree in _windows(len(t), settings):
        smooth, middle = _slopes_and_weights(t, x, window, degree)
        start, stop = max(smooth.rows.start, base.rows.start), min(smooth.rows.stop, base.rows.stop)
        mine = smooth.slope[start - smooth.rows.start : stop - smooth.rows.start]
        theirs = base.slope[start - base.rows.start : stop - base.rows.start]
        size = max(len(middle), len(other))
        gap = np.pad(middle, (size - len(middle)) // 2) - np.pad(other, (size - len(other)) // 2)
        variance = sigma**2 * float(middle @ middle)
        risk = float(np.mean((mine - theirs) ** 2)) - sigma**2 * float(gap @ gap) + variance
        # By chance an estimate may fall below what noise alone must cause.
        error = float(np.sqrt(max(risk, variance)))
        if error < best.noise:
            best = Choice(f"savgol({window},{degree})", error)
    return best


def _slopes_and_weights(
    t: np.ndarray, x: np.ndarray, window: int, degree: int
) -> tuple[Smooth, np.ndarray]:
    """Smooth, and give the slope weights of the middle row (typical, on uneven times)."""
    _, weights = local_polynomial(t, window, degree)
    return smooth_column(t, x, f"savgol({window},{degree})"), weights[len(weights) // 2]


def _windows(rows: int, settings: SlopeSettings) -> list[tuple[int, int]]:
    """Give the windows of at most a third of the rows, each with the degrees that it can smooth."""
    widest = max(rows // 3, settings.windows[0])
    return [(w, d) for w in settings.windows for d in settings.degrees if d + 1 < w <= widest]


def _reference(
    t: np.ndarray, x: np.ndarray, sigma: float, settings: SlopeSettings
) -> tuple[int, int]:
    """Give a window of little bias: narrower than the one best for the *values* (Mallows' Cp)."""
    pairs = _windows(len(t), settings)
    degree = max((d for _, d in pairs), default=settings.degrees[0])
    windows = [w for w, d in pairs if d == degree]
    best, least = settings.windows[0], np.inf
    for window in windows:
        value, _ = local_polynomial(t, window, degree)
        smooth = smooth_column(t, x, f"savgol({window},{degree})")
        # Mallows' Cp: squared residuals plus twice the weight of a point in its own fit.
        risk = float(np.mean((smooth.x - x[smooth.rows]) ** 2))
        risk += 2 * sigma**2 * float(np.mean(value[:, window // 2]))
        if risk < least:
            best, least = window, risk
    return max((w for w in windows if w <= settings.reference * best), default=best), degree


def choose_samples(
    trajectories: Trajectory | Sequence[Trajectory],
    target: str,
    *,
    scheme: str = "auto",
    slopes: Sequence[np.ndarray] | np.ndarray | None = None,
    settings: SlopeSettings = _SETTINGS,
) -> Samples:
    """Make the samples of one target with slopes that the data themselves choose.

    Parameters
    ----------
    trajectories : one or many, of the same columns; times may be uneven and differ.
    target : the state whose slope is wanted.
    scheme : "auto", or a scheme of :func:`dynsr.data.slopes.smooth_column` to use instead.
    slopes : the user's own slopes of the target at every time, one array (n,) a trajectory, in
        state units per second.
    settings : what the choice of scheme rests on.

    ``Samples.scheme`` names the choice and ``Samples.noise`` the slope error to expect. When a
    column is noisy its smoothed values replace it in ``X``. Warns with BiasWarning when own
    slopes do not fit the states. Raises InputError when there are too few rows.

    >>> t = np.linspace(0, 10, 1001)
    >>> circle = Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), ("x", "y"))
    >>> choose_samples(circle, "x").scheme
    'central4'
    """
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    if not runs:
        raise InputError("no trajectory was given; give at least one")
    if any(run.names != runs[0].names for run in runs):
        raise InputError("the trajectories have different columns; give all the same columns")
    given = _own_slopes(runs, target, slopes, settings)
    # The longest trajectory decides for all: noise and step belong to the instrument.
    longest = max(runs, key=len)
    choices = {state: _choose(longest, state, scheme, settings) for state in runs[0].states}
    pieces = []
    for run, own in zip(runs, given, strict=True):
        fitting = choices if run is longest else _fitting(run, choices, settings)
        pieces.append(_combine(run, target, fitting, own))
    return replace(join(pieces), scheme=pieces[runs.index(longest)].scheme)


def _choose(trajectory: Trajectory, state: str, scheme: str, settings: SlopeSettings) -> Choice:
    sigma = float(measurement_noise(trajectory)[trajectory.index(state)])
    x = trajectory.x[:, trajectory.index(state)]
    if scheme == "auto":
        return choose_scheme(trajectory.t, x, sigma, settings)
    return Choice(scheme, sigma / float(np.median(np.diff(trajectory.t))))


def _fitting(
    trajectory: Trajectory, choices: Mapping[str, Choice], settings: SlopeSettings
) -> dict[str, Choice]:
    """Choose anew for a trajectory that is too short for the windows of the longest."""
    fitting = {}
    for state, choice in choices.items():
        x = trajectory.x[:, trajectory.index(state)]
        try:
            enough = len(smooth_column(trajectory.t, x, choice.scheme).x) >= len(trajectory) // 2
        except ValueError:
            enough = False
        fitting[state] = choice if enough else _choose(trajectory, state, "auto", settings)
    return fitting


def _combine(
    trajectory: Trajectory, target: str, choices: Mapping[str, Choice], own: np.ndarray | None
) -> Samples:
    """Put the smoothed columns and the slopes of the target together on the rows all have."""
    smooth: dict[str, Smooth] = {}
    for state, choice in choices.items():
        x = trajectory.x[:, trajectory.index(state)]
        if choice.scheme in SCHEMES and state != target:
            continue
        smooth[state] = smooth_column(trajectory.t, x, choice.scheme)
    start = max([s.rows.start for s in smooth.values()], default=0)
    stop = min([s.rows.stop for s in smooth.values()], default=len(trajectory))
    columns = trajectory.columns[start:stop]
    for state, s in smooth.items():
        inside = slice(start - s.rows.start, stop - s.rows.start)
        columns[:, trajectory.index(state)] = s.x[inside]
    mine = smooth[target]
    slope = mine.slope[start - mine.rows.start : stop - mine.rows.start]
    choice = choices[target] if own is None else Choice("given", _spread(own[start:stop] - slope))
    y = slope if own is None else own[start:stop]
    t = trajectory.t[start:stop]
    return Samples(columns, y, trajectory.names, target, choice.scheme, t, choice.noise)


def _spread(values: np.ndarray) -> float:
    return float(robust_scale(values - np.median(values)))


def _own_slopes(
    runs: Sequence[Trajectory],
    target: str,
    slopes: Sequence[np.ndarray] | np.ndarray | None,
    settings: SlopeSettings,
) -> list[np.ndarray | None]:
    if slopes is None:
        return [None] * len(runs)
    single = isinstance(slopes, np.ndarray) and slopes.ndim == 1
    given = [np.asarray(own, dtype=float) for own in ([slopes] if single else slopes)]
    if [len(own) for own in given] != [len(run) for run in runs]:
        raise InputError(
            f"own slopes of {target} have {[len(own) for own in given]} rows but the trajectories "
            f"{[len(r) for r in runs]}; give one slope a row"
        )
    if not all(np.all(np.isfinite(own)) for own in given):
        raise InputError(f"own slopes of {target} hold NaN or infinity; fill or drop such rows")
    for run, own in zip(runs, given, strict=True):
        warn_if_biased(run, target, run.t, own, "the slopes given", settings)
    return list(given)


def slope_bias(
    trajectory: Trajectory,
    target: str,
    t: np.ndarray,
    slopes: np.ndarray,
    settings: SlopeSettings = _SETTINGS,
) -> float:
    """Share of the slopes (RMS) that is bias, against the slopes of the scheme that data choose.

    The mean product of neighbouring differences is bias^2, since white noise is uncorrelated from
    one row to the next; the error of the chosen scheme is subtracted. Good but noisy slopes have
    a share near 0.

    Parameters
    ----------
    trajectory : the data that the slopes belong to.
    target : the state whose slopes they are.
    t : (n,) times of the slopes, in seconds.
    slopes : (n,) slopes in state units per second.
    settings : what the choice of scheme rests on.
    """
    choice = _choose(trajectory, target, "auto", settings)
    x = trajectory.x[:, trajectory.index(target)]
    best = smooth_column(trajectory.t, x, choice.scheme)
    inside = (t >= trajectory.t[best.rows][0]) & (t <= trajectory.t[best.rows][-1])
    if inside.sum() < 4:
        return 0.0
    reference = CubicSpline(trajectory.t[best.rows], best.slope)(t[inside])
    miss = slopes[inside] - reference
    common = float(np.mean(miss[1:] * miss[:-1]))
    size = float(np.mean(reference**2)) or 1.0
    return float(np.sqrt(max(common - choice.noise**2, 0.0) / size))


def warn_if_biased(
    trajectory: Trajectory,
    target: str,
    t: np.ndarray,
    slopes: np.ndarray,
    what: str,
    settings: SlopeSettings = _SETTINGS,
) -> float:
    """Warn with BiasWarning when too much of the slopes is bias; gives the share of slope_bias.

    ``what`` is what the message calls the slopes; the others are those of slope_bias.
    """
    share = slope_bias(trajectory, target, t, slopes, settings)
    if share > settings.biased:
        warnings.warn(
            f"{what} of {target} look biased by {100 * share:.1f} % at this step; "
            "use scheme 'auto' or a smaller step",
            BiasWarning,
            stacklevel=3,
        )
    return share
