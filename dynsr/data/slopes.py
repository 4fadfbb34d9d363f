"""Slopes: high-order differences and smoothers of one column, and the choice that the data make."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.polynomial import legendre
from scipy.interpolate import CubicSpline, make_smoothing_spline

from dynsr.data.forcing import Forced, find_forced
from dynsr.data.noise_model import interpolation_residuals, measurement_noise, robust_scale
from dynsr.data.observation import at_own_rows, carry, told_rows
from dynsr.data.samples import (
    CENTRAL,
    CENTRAL_ORDERS,
    SCHEMES,
    Samples,
    central_weights,
    difference,
    join_samples,
)
from dynsr.data.smoothing import (
    LONGEST_KEPT,
    SmoothColumn,
    as_bytes,
    estimate_noise,
    smooth_values,
)
from dynsr.data.solver_rows import solver_errors
from dynsr.data.trajectory import Trajectory, as_floats
from dynsr.data.weak import weak_slopes
from dynsr.errors import InputError, need

# The smoothers that have no settings.
SMOOTHERS = ("gp", "spline", "total-variation", "weak")
# Order up to which all central differences are looked at; higher ones while the errors fall.
_USUAL_ORDER = 6
# Rows of a state below which a run is not smoothed and says nothing of its slopes.
FEWEST_SMOOTH = 5
_SAVGOL = re.compile(r"savgol\((\d+),(\d+)\)")


@dataclass(frozen=True, eq=False)
class Smooth:
    """One column made smooth: the rows that have a slope, and the values and slopes there.

    ``slope_sd`` has the standard deviations of the slopes where the scheme knows them.
    """

    rows: slice
    x: np.ndarray
    slope: np.ndarray
    slope_sd: np.ndarray | None = None


def local_polynomial(
    t: np.ndarray, window: int, degree: int, derivatives: tuple[int, ...] = (0, 1)
) -> tuple[np.ndarray, ...]:
    """Weights (rows, window) for value and slope at the middle of every window of times.

    ``derivatives`` are their orders: 0 is the value, 1 the slope, 2 the second derivative.

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
    at_middle = np.column_stack([_legendre_at_0(degree, order) for order in derivatives])
    picked = np.linalg.solve(gram, np.broadcast_to(at_middle, (len(gram), *at_middle.shape)))
    weights = np.einsum("nwi,nik->knw", basis, picked)
    return tuple(w / scale**order for w, order in zip(weights, derivatives, strict=True))


def _legendre_at_0(degree: int, order: int) -> np.ndarray:
    """Derivative of an order of every Legendre polynomial up to a degree, at 0."""
    bases = [legendre.Legendre.basis(j) for j in range(degree + 1)]
    return np.array([b.deriv(order)(0.0) if order else b(0.0) for b in bases])


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


def _gaussian_process(t: np.ndarray, x: np.ndarray) -> Smooth:
    """Smooth by a Gaussian process; ends that say next to nothing about the slope are left out."""
    whole = _process_smooth(t.tobytes(), x.tobytes())
    sd, slope = whole.slope_sd, whole.slope
    told = np.flatnonzero(sd <= np.maximum(2 * np.median(sd), 0.2 * np.abs(slope)))
    most = len(t) // 10
    start = min(int(told[0]), most) if len(told) else 0
    stop = max(int(told[-1]) + 1, len(t) - most) if len(told) else len(t)
    rows = slice(start, stop)
    return Smooth(rows, whole.x[rows], slope[rows], sd[rows])


@lru_cache(maxsize=32)
def _process_smooth(times: bytes, values: bytes) -> SmoothColumn:
    """Smooth each column once, though the samples of every target want all of them."""
    t, x = np.frombuffer(times), np.frombuffer(values)
    noise = estimate_noise([Trajectory(t, x[:, None], ("x",))])[0]
    return smooth_values(t, x, noise)


def smooth_column(t: np.ndarray, x: np.ndarray, scheme: str) -> Smooth:
    """Differentiate one column by a named scheme.

    Parameters
    ----------
    t : (n,) times in seconds, strictly increasing.
    x : (n,) values of one state.
    scheme : "forward", "backward", "central2" to "central14", "savgol(WINDOW,DEGREE)", "gp" (a
        Gaussian process), "spline", "total-variation" or "weak" (the slope that has the weak
        form's means over windows, and its integral; no row is differentiated).

    Raises InputError on any other name, and when there are too few rows for a difference.

    >>> t = np.linspace(0.0, 1.0, 21)
    >>> bool(np.allclose(smooth_column(t, t**2, "savgol(5,2)").slope, 2 * t[2:-2]))
    True
    """
    if scheme == "spline":
        return _spline(t, x)
    if scheme == "gp":
        if len(t) < 4:
            raise InputError(f"{len(t)} rows are too few for scheme 'gp'; give at least 4")
        return _gaussian_process(t, x)
    if scheme == "weak":
        return Smooth(*weak_slopes(t.tobytes(), x.tobytes()))
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
    known = ", ".join([*SCHEMES, "savgol(WINDOW,DEGREE)", *SMOOTHERS])
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
        large where the motion is fast, which a median would not see; the few rows next to the
        kinks of an adaptive solver, which higher orders spread, must not decide.
    windows : odd numbers of rows of the local polynomials tried.
    degrees : even degrees of the local polynomials tried; an odd one has the slopes of the even
        one above it.
    processed : up to so many rows a Gaussian process competes with the local polynomials; it
        weighs less and costs more the more rows there are.
    prefer : a local polynomial is preferred when its mean squared residual of left-out rows is less
        than this share of the process's; values are foretold as well by curves whose slopes differ.
    capped : most standard deviations that a residual counts there.
    reference : a window of little bias is at most this share of the one best for the values.
    biased : a share of bias in given slopes from which on they are warned about.
    steep : data have layers where the slopes (RMS) are this many times larger than those that
        ``quantile`` of the rows stay below.
    unresolved, exact : shares of a row's slope, and of the slope that ``quantile`` of the rows stay
        below, above which a central difference is wrong and below which it is exact.
    calm, told : the share of rows that must be exact, and the share of their slopes (the median)
        that their errors may be, for the rows without slopes in layers to be left out.
    """

    clean: float = 1e-5
    finest: float = 1e-7
    quantile: float = 0.8
    windows: tuple[int, ...] = (5, 7, 9, 13, 17, 23, 31, 41, 55, 73, 97, 129)
    degrees: tuple[int, ...] = (2, 4, 6)
    processed: int = 600
    prefer: float = 0.9
    capped: float = 4.0
    reference: float = 0.7
    biased: float = 0.01
    steep: float = 10.0
    unresolved: float = 1e-3
    exact: float = 1e-6
    calm: float = 0.8
    told: float = 1e-4


_SETTINGS = SlopeSettings()


class BiasWarning(UserWarning):
    """The slopes are biased by the difference scheme at this step."""


@dataclass(frozen=True)
class Choice:
    """A scheme, and the error of its slopes to expect (RMS, units per second)."""

    scheme: str
    noise: float


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
    if len(t) > LONGEST_KEPT:
        return _choose_again(t, x, sigma, settings)
    return _choose_once(as_bytes(t), as_bytes(x), sigma, settings)


# The samples of every target want the choices for all columns, and a report wants them again.
@lru_cache(maxsize=64)
def _choose_once(times: bytes, values: bytes, sigma: float, settings: SlopeSettings) -> Choice:
    return _choose_again(np.frombuffer(times), np.frombuffer(values), sigma, settings)


def _choose_again(
    t: np.ndarray, x: np.ndarray, sigma: float, settings: SlopeSettings = _SETTINGS
) -> Choice:
    step = float(np.median(np.diff(t)))
    slopes = np.diff(x) / np.diff(t)
    if find_layers(t, x, settings) is not None:
        return Choice("central8", sigma / step)
    size = float(np.sqrt(np.mean(slopes**2))) or 1.0
    central = _choose_central(t, x, sigma, size, settings)
    if sigma / step <= settings.clean * size or len(t) < 2 * settings.windows[0]:
        return central
    best = _choose_smoother(t, x, sigma, settings)
    if len(t) <= settings.processed:
        best = _compare_process(t, x, best, settings)
    return central if central.noise < best.noise else best


def _compare_process(t: np.ndarray, x: np.ndarray, best: Choice, settings: SlopeSettings) -> Choice:
    """Take a Gaussian process unless the local polynomial foretells left-out rows better.

    Mallows' estimate of a local polynomial's error sees no bias that its reference has too, which
    is most of it where rows are few; what is foretold of a row from all others is seen.
    """
    whole = _process_smooth(t.tobytes(), x.tobytes())
    match = _SAVGOL.fullmatch(best.scheme)
    assert match
    window = int(match[1])
    other = smooth_column(t, x, best.scheme)
    value, _ = local_polynomial(t, window, int(match[2]))
    theirs = (x[other.rows] - other.x) / (1 - value[:, window // 2])
    mine = ((x - whole.x) / np.maximum(1 - whole.leverage, 1e-3))[other.rows]
    kept = ~whole.outlier[other.rows]
    scale = np.hypot(whole.noise, whole.x_sd)[other.rows]
    # Errors are capped: one row must not decide.
    misses = [np.minimum(np.abs(e / scale)[kept], settings.capped) for e in (mine, theirs)]
    if np.mean(misses[1] ** 2) < settings.prefer * np.mean(misses[0] ** 2):
        return best
    sd = smooth_column(t, x, "gp").slope_sd
    assert sd is not None
    return Choice("gp", float(np.sqrt(np.mean(np.square(sd)))))


def find_layers(
    t: np.ndarray, x: np.ndarray, settings: SlopeSettings = _SETTINGS
) -> np.ndarray | None:
    """Say which rows of an eighth-order difference lie in layers that are passed between two rows.

    A relaxation oscillator rests, and then jumps about as fast as it is sampled. A difference
    across a jump is wrong, and larger than all others. Where the slopes of the other rows are
    exact, they contain the law. The error of a row is estimated by the difference of sixth order.

    Parameters
    ----------
    t : (n,) times in seconds, strictly increasing.
    x : (n,) values of one state.
    settings : when a slope is too wrong, and what is exact.

    Gives (n - 8,), all False where the jumps are resolved; None where there are none, and for fewer
    than 30 rows.

    >>> t = np.linspace(0.0, 10.0, 500)
    >>> jump = np.tanh(1000 * (t - 5)) + 0.01 * np.sin(t)
    >>> t[4:-4][find_layers(t, jump)].round(1).tolist()
    [4.9, 4.9, 5.0, 5.0, 5.0, 5.0, 5.1, 5.1]
    """
    if len(t) < 30:
        return None
    slopes = smooth_column(t, x, "central8").slope
    errors, sizes = np.abs(slopes - smooth_column(t, x, "central6").slope[1:-1]), np.abs(slopes)
    usual = np.quantile(sizes, settings.quantile)
    wrong = errors > settings.unresolved * (sizes + usual)
    calm = errors <= settings.exact * (sizes + usual)
    steep = np.mean(sizes**2) > (settings.steep * usual) ** 2
    if not steep or np.mean(calm) < settings.calm:
        return None
    if np.median(errors[calm]) > settings.told * np.median(sizes[calm]):
        return None
    return ~calm if wrong.any() else wrong


def _choose_central(
    t: np.ndarray, x: np.ndarray, sigma: float, size: float, settings: SlopeSettings
) -> Choice:
    orders = [order for order in CENTRAL_ORDERS if len(t) > order + 1]
    if len(orders) < 2:
        if not orders:
            raise InputError(f"{len(t)} rows are too few for slopes; give at least 4 a trajectory")
        return Choice("central2", sigma / float(np.median(np.diff(t))))
    best = Choice("central2", np.inf)
    for order, higher in pairwise(orders):
        gaps, random = _gaps(t, x, order, higher, sigma)
        error = float(np.quantile(gaps, settings.quantile)) + float(np.median(random))
        if error < best.noise:
            best = Choice(f"central{order}", error)
        elif order >= _USUAL_ORDER:
            break
        if best.noise <= settings.finest * size:
            break
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
    column is noisy its smoothed values replace it in ``X``. The rows are those at which the target
    was measured; another state that was not is on its curve there. Warns with BiasWarning when
    own slopes do not fit the states. Raises InputError when there are too few rows.

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
    runs = carry(runs)
    given = _own_slopes(runs, target, slopes, settings)
    if any(run.unmeasured.size for run in runs):
        rows = told_rows(runs, target)
        both = [(g, own) for g, own in zip(given, rows, strict=True) if len(own) >= FEWEST_SMOOTH]
        given = [None if g is None else g[own] for g, own in both]
        runs = at_own_rows(runs, target, FEWEST_SMOOTH)
        if not runs:
            raise InputError(f"{target} was measured in too few rows for slopes; give more of them")
    resolve = scheme == "auto" and slopes is None
    parts = find_forced(runs) if resolve else None
    measured = runs
    if parts is not None:
        runs = [part.taken_from(run) for run, part in zip(runs, parts, strict=True)]
    # The longest trajectory decides for all: noise and step belong to the instrument.
    longest = {state: _longest(runs, state) for state in runs[0].states}
    deciding = {id(run): run for run in longest.values()}
    noise = {key: measurement_noise(run) for key, run in deciding.items()}
    choices = {
        state: _choose(run, state, scheme, settings, noise[id(run)])
        for state, run in longest.items()
    }
    pieces = []
    for run, own in zip(runs, given, strict=True):
        fitting = choices if deciding.keys() == {id(run)} else _fitting(run, choices, settings)
        piece = _combine(run, target, fitting, own)
        pieces.append(_without_layers(piece, run, settings) if resolve else piece)
    if parts is not None:
        added = zip(pieces, measured, parts, strict=True)
        pieces = [_add_forced(piece, run, part) for piece, run, part in added]
    return replace(join_samples(pieces), scheme=pieces[runs.index(longest[target])].scheme)


def _add_forced(samples: Samples, run: Trajectory, forced: Forced) -> Samples:
    """Add what held inputs bend to samples of the rest without it."""
    rows = np.searchsorted(run.t, samples.t)
    X = samples.X.copy()
    X[:, : len(run.states)] += forced.x[rows]
    y = samples.y + forced.slope[rows, run.index(samples.target)]
    return replace(samples, X=X, y=y)


def _longest(runs: Sequence[Trajectory], state: str) -> Trajectory:
    """Give the longest run in which a state moves: one at rest says nothing of its slopes."""
    place = runs[0].index(state)
    moving = [run for run in runs if np.ptp(run.x[:, place]) > 0]
    return max(moving or runs, key=len)


def _choose(
    trajectory: Trajectory, state: str, scheme: str, settings: SlopeSettings, noise: np.ndarray
) -> Choice:
    """Choose for one state, by the noise (k,) of all."""
    place = trajectory.index(state)
    x, sigma = trajectory.x[:, place], float(noise[place])
    if scheme == "auto":
        choice = choose_scheme(trajectory.t, x, sigma, settings)
        return replace(
            choice, noise=max(choice.noise, float(solver_errors(trajectory.t, x[:, None])[0]))
        )
    return Choice(scheme, sigma / float(np.median(np.diff(trajectory.t))))


def _fitting(
    trajectory: Trajectory, choices: Mapping[str, Choice], settings: SlopeSettings
) -> dict[str, Choice]:
    """Choose again for a trajectory that is too short for the windows of the longest."""
    fitting = {}
    noise = measurement_noise(trajectory)
    for state, choice in choices.items():
        x = trajectory.x[:, trajectory.index(state)]
        try:
            enough = len(smooth_column(trajectory.t, x, choice.scheme).x) >= len(trajectory) // 2
        except ValueError:
            enough = False
        fitting[state] = choice if enough else _choose(trajectory, state, "auto", settings, noise)
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
    sd, scheme = mine.slope_sd, choices[target].scheme
    if scheme in CENTRAL:
        sd = _errors(trajectory, target, scheme)
    if sd is not None:
        sd = sd[start - mine.rows.start : stop - mine.rows.start]
        if own is not None:
            # What they differ by from those of the states, but for the errors of these.
            apart = _with_neighbours(np.abs(y - slope))
            sd = np.sqrt(np.maximum(apart**2 - sd**2, 0.0))
    return Samples(columns, y, trajectory.names, target, choice.scheme, t, choice.noise, sd)


def _errors(trajectory: Trajectory, state: str, scheme: str) -> np.ndarray | None:
    """Errors of the slopes of a central difference: what the next order changes, and noise."""
    t, place = trajectory.t, CENTRAL.index(scheme) + 1
    if place == len(CENTRAL) or len(t) <= CENTRAL_ORDERS[place]:
        return None
    column = trajectory.index(state)
    x, sigma = trajectory.x[:, column], float(measurement_noise(trajectory)[column])
    gaps, random = _gaps(t, x, CENTRAL_ORDERS[place - 1], CENTRAL_ORDERS[place], sigma)
    # By chance two orders agree at a row, but not at its neighbours too.
    return _with_neighbours(np.pad(gaps, 1, mode="edge")) + random


def _with_neighbours(gaps: np.ndarray) -> np.ndarray:
    """Give the largest (n,) gap of each row and the two next to it."""
    padded = np.pad(gaps, 1, mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 3).max(axis=1))


def _gaps(
    t: np.ndarray, x: np.ndarray, order: int, higher: int, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """What a higher order changes in slopes (n - higher,), and their error by noise (n - order,).

    Noise that two orders do not differ by is no noise: rows far apart look noisy.
    """
    low, high = (smooth_column(t, x, f"central{which}").slope for which in (order, higher))
    lower, upper = central_weights(t, order), central_weights(t, higher)
    gaps = np.abs(high - low[1:-1])
    upper[:, 1:-1] -= lower[1:-1]
    shown = float(robust_scale(gaps / np.linalg.norm(upper, axis=1)))
    return gaps, min(sigma, shown) * np.linalg.norm(lower, axis=1)


def _without_layers(samples: Samples, trajectory: Trajectory, settings: SlopeSettings) -> Samples:
    """Leave the rows out that lie in layers; they have a state but no slope."""
    x = trajectory.x[:, trajectory.index(samples.target)]
    layers = find_layers(trajectory.t, x, settings) if samples.scheme == "central8" else None
    if layers is None:
        return samples
    times = trajectory.t[4:-4][layers]
    kept = samples.select(np.flatnonzero(~np.isin(samples.t, times)))
    return replace(kept, layers=True)


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
    given = [as_floats(own, f"slopes of {target}") for own in ([slopes] if single else slopes)]
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
    parts, place = find_forced([trajectory]), trajectory.index(target)
    if parts is not None:
        trajectory = parts[0].taken_from(trajectory)
        slopes = slopes - np.interp(t, trajectory.t, parts[0].slope[:, place])
    x, sigma = trajectory.x[:, place], float(measurement_noise(trajectory)[place])
    choice = choose_scheme(trajectory.t, x, sigma, settings)
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
