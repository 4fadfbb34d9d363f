"""Smoothing whole trajectories: states and slopes with uncertainty at every row, ends included.

Every state is a Gaussian process in a time that may be warped. A transient that ends in a tenth
of the record, or a jump between slow phases, has no one length scale in plain time; it has one in
the logarithm of the time since the start, or along the arc of the motion. The warp of greatest
marginal likelihood is taken, and so is the logarithm of the values where their noise is a share of
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator

from dynsr.data.forcing import Forced, find_forced
from dynsr.data.gaussian_process import Process, ProcessSettings, fit_process, screen
from dynsr.data.known_noise import KnownNoise
from dynsr.data.noise_model import (
    Column,
    NoiseSettings,
    StateNoise,
    find_outliers,
    fit_law,
    least_noise,
    neighbour_noise,
)
from dynsr.data.trajectory import FEWEST_ROWS, Trajectory
from dynsr.errors import InputError

# What is worked out from longer columns is not kept for the next who asks.
LONGEST_KEPT = 20_000
# Usual distances of its rows over which a curve comes to rest beyond the last of them.
_COASTS = 5.0
_NOWHERE = np.empty((4, 0))


@dataclass(frozen=True)
class SmoothSettings:
    """How trajectories are smoothed.

    Parameters
    ----------
    starts : times, as shares of the record, from which on a transient may last; the logarithm of
        the time since the start (and to the end) counts from there.
    arcs : powers of the speed by which time is stretched.
    still : least speed that counts, as a share of the root mean square one.
    cost : evidence that stretching by the speed costs, since the speed comes from the rows.
    outlier : a row that misses the prediction from all others by more than this many standard
        deviations, and whose neighbours do not, is an outlier.
    rare : probability of an outlier.
    rounds : how often outliers and the size of the noise at each row are found again.
    screened : about as many rows decide which logarithm of the time is tried.
    refined : up to so many rows noise is estimated from the smoothed trajectory too.
    unknown : ``process.known`` while it is.
    certain : the same where it is said.
    chunk : most rows smoothed at once; longer trajectories are smoothed in overlapping pieces.
    overlap : rows that two pieces share.
    fewest : rows of a state below which it is not smoothed.
    process : settings of the Gaussian process.
    noise : settings of the estimate of the noise.
    """

    starts: tuple[float, ...] = (0.003, 0.02, 0.1)
    arcs: tuple[float, ...] = (0.5, 1.0)
    still: float = 0.03
    cost: float = 3.0
    outlier: float = 4.0
    rare: float = 0.02
    rounds: int = 3
    screened: int = 150
    refined: int = 600
    unknown: float = 10.0
    certain: float = 1e-3
    chunk: int = 1000
    overlap: int = 60
    fewest: int = 4
    process: ProcessSettings = field(default_factory=ProcessSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)


_SETTINGS = SmoothSettings()


@dataclass(frozen=True, eq=False)
class SmoothedTrajectory:
    """States and slopes of one run made smooth, with standard deviations, at every row.

    Parameters
    ----------
    t : (n,) times in seconds.
    x : (n, k) smoothed states.
    slope : (n, k) their slopes in state units per second.
    x_sd, slope_sd : (n, k) standard deviations of both.
    noise : (n, k) standard deviation of the measurement noise found at every row; an outlier's is
        as large as its residual.
    before : (n, k) slopes before a held input steps at the row; ``slope`` is that after it.
    method : for each state, what was smoothed: "time", "log start 0.01", "arc 0.5", ..., with
        "of log" where the logarithm of the values was.
    states : names of the k states.
    """

    t: np.ndarray
    x: np.ndarray
    slope: np.ndarray
    x_sd: np.ndarray
    slope_sd: np.ndarray
    noise: np.ndarray
    method: tuple[str, ...]
    states: tuple[str, ...]
    before: np.ndarray | None = None

    def curve(self, times: np.ndarray) -> np.ndarray:
        """Give the smoothed states (k, m) at m times within the record, by cubic Hermite pieces."""
        inside = np.clip(times, self.t[0], self.t[-1])
        smooth = np.asarray(CubicHermiteSpline(self.t, self.x, self.slope)(inside)).T
        if self.before is None:
            return smooth
        # What a step at the end of a piece changes there.
        place = np.clip(np.searchsorted(self.t, inside, side="right") - 1, 0, len(self.t) - 2)
        h = self.t[place + 1] - self.t[place]
        share = (inside - self.t[place]) / h
        change = (self.before - self.slope)[place + 1]
        return smooth + (h * share**2 * (share - 1) * change.T)


@dataclass(frozen=True, eq=False)
class SmoothColumn:
    """One column made smooth; fields as in SmoothedTrajectory, (n,) each.

    ``leverage`` is the share that each row has in its own fit, ``outlier`` flags outliers.
    ``between`` (4, m) has values, slopes and the standard deviations of both at other times.
    """

    x: np.ndarray
    slope: np.ndarray
    x_sd: np.ndarray
    slope_sd: np.ndarray
    noise: np.ndarray
    method: str
    leverage: np.ndarray
    outlier: np.ndarray
    between: np.ndarray


def smooth(
    run: Trajectory,
    noise: Sequence[StateNoise],
    settings: SmoothSettings = _SETTINGS,
    forced: Forced | None = None,
) -> SmoothedTrajectory:
    """Smooth every state of a trajectory by a Gaussian process, with uncertainty.

    Parameters
    ----------
    run : the trajectory; times may be uneven; 4 rows are enough. A state that was not measured at
        every row is smoothed from its own rows; where it was not measured its noise is inf.
    noise : the noise of each state, of :func:`dynsr.data.smoothing.estimate_noise`. It may be
        found to be somewhat larger or smaller, the less so the more rows there are.
    settings : what is tried.
    forced : the part that held inputs bend, which is not smoothed; by default found in this run.

    Raises InputError when there are fewer than 4 rows.

    >>> t = np.linspace(0, 10, 80)
    >>> noisy = np.sin(t) + np.random.default_rng(0).normal(0, 0.1, 80)
    >>> run = Trajectory(t, noisy[:, None], ("x",))
    >>> found = smooth(run, estimate_noise([run]))
    >>> bool(np.sqrt(np.mean((found.slope[:, 0] - np.cos(t)) ** 2)) < 0.15)
    True
    """
    if len(run) < 4:
        raise InputError(f"{len(run)} rows are too few to smooth; give at least 4 a trajectory")
    if forced is None:
        found = find_forced([run])
        forced = None if found is None else found[0]
    taken = np.zeros_like(run.x) if forced is None else forced.x
    columns = [
        _smooth_own(
            run.t,
            run.x[:, k] - taken[:, k],
            noise[k],
            settings,
            taken[:, k],
            own,
            run.noise.get(run.states[k]),
        )
        for k, own in enumerate(run.measured.T)
    ]
    names = ("x", "slope", "x_sd", "slope_sd", "noise")
    stacked = {name: np.column_stack([getattr(c, name) for c in columns]) for name in names}
    if forced is not None:
        before = stacked["slope"] + forced.before
        slope = stacked["slope"] + forced.slope
        stacked |= {"x": stacked["x"] + taken, "slope": slope, "before": before}
    return SmoothedTrajectory(
        t=run.t, method=tuple(c.method for c in columns), states=run.states, **stacked
    )


def _smooth_own(
    t: np.ndarray,
    x: np.ndarray,
    noise: StateNoise,
    settings: SmoothSettings,
    taken: np.ndarray,
    own: np.ndarray,
    known: KnownNoise | None,
) -> SmoothColumn:
    """Smooth one column from its own rows, and read the curve at the others."""
    if own.all():
        return _smooth_known(t, x, noise, settings, taken, known)
    sd = noise.sd(x + taken) if known is None else known.at(x + taken)
    sd = np.where(own, sd, np.inf)
    rest, none = np.zeros(len(t)), np.zeros(len(t), dtype=bool)
    rows = np.flatnonzero(own)
    if len(rows) < settings.fewest:
        # Too few to bend a curve through: what stands between them is a line.
        wide = np.full(len(t), float(np.std(x)))
        return SmoothColumn(x, np.gradient(x, t), wide, wide, sd, "line", rest, none, _NOWHERE)
    told = None if known is None else known.select(rows)
    found = _smooth_known(t[rows], x[rows], noise, settings, taken[rows], told, t[~own])
    value, slope = read_curve(t[rows], found.x, _sure_slopes(t[rows], found), t)
    value[rows], slope[rows] = found.x, found.slope
    sd[rows], rest[rows], none[rows] = found.noise, found.leverage, found.outlier
    x_sd, slope_sd = np.empty(len(t)), np.empty(len(t))
    x_sd[rows], slope_sd[rows] = found.x_sd, found.slope_sd
    x_sd[~own], slope_sd[~own] = found.between[2:]
    return SmoothColumn(value, slope, x_sd, slope_sd, sd, found.method, rest, none, found.between)


def _smooth_known(
    t: np.ndarray,
    x: np.ndarray,
    noise: StateNoise,
    settings: SmoothSettings,
    taken: np.ndarray,
    known: KnownNoise | None,
    others: np.ndarray = _NOWHERE[0],
) -> SmoothColumn:
    """Smooth one column; where its errors are known they are used, or their size alone is found."""
    if known is None:
        return smooth_values(t, x, noise, settings, taken, None, others)
    certain = settings.certain if known.sure else settings.unknown
    settings = replace(settings, process=replace(settings.process, known=certain))
    if not known.sure:
        return smooth_values(t, x, noise, settings, taken, known.sd, others)
    sd = known.sd
    if known.share:
        sd = known.at(smooth_values(t, x, noise, settings, taken).x + taken)
    found = smooth_values(t, x, noise, settings, taken, sd, others)
    # A row that misses by more is no outlier: its error is known.
    return replace(found, noise=known.at(found.x + taken))


def _sure_slopes(t: np.ndarray, found: SmoothColumn) -> np.ndarray:
    """Give the slopes of a smoothed column; where they are unsure, those of a spline through it.

    The uncertainty of the spline's is that of another one, which never overshoots.
    """
    spline = CubicSpline(t, found.x)(t, 1)
    apart = spline - PchipInterpolator(t, found.x)(t, 1)
    size = np.maximum(found.slope_sd**2 + apart**2, 1e-300)
    return np.asarray((found.slope * apart**2 + spline * found.slope_sd**2) / size)


def read_curve(
    own: np.ndarray, x: np.ndarray, slope: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Give values and slopes at times (n,) of a curve through rows with values and slopes.

    Between the rows it is a cubic; beyond them it goes on in its last direction, and comes to rest
    over the usual distance of a few rows, since nothing is known there.

    Parameters
    ----------
    own, x, slope : (m,) times, values and slopes of the rows.
    t : (n,) times.

    >>> own = np.array([0.0, 1.0, 2.0])
    >>> read_curve(own, own**2, 2 * own, np.array([0.5, 1.5]))[0].tolist()
    [0.25, 2.25]
    """
    inside = np.clip(t, own[0], own[-1])
    spline = CubicHermiteSpline(own, x, slope)
    beyond, rest = t - inside, _COASTS * float(np.median(np.diff(own)))
    slopes = spline(inside, 1) * np.exp(-np.abs(beyond) / rest)
    last = spline(inside, 1) * np.sign(beyond) * rest * -np.expm1(-np.abs(beyond) / rest)
    return np.asarray(spline(inside) + last), np.asarray(slopes)


def smooth_values(
    t: np.ndarray,
    x: np.ndarray,
    noise: StateNoise,
    settings: SmoothSettings = _SETTINGS,
    taken: np.ndarray | None = None,
    known: np.ndarray | None = None,
    others: np.ndarray = _NOWHERE[0],
) -> SmoothColumn:
    """Smooth one column; the parameters are those of :func:`smooth`, for (n,) times and values.

    ``taken`` (n,) is what was taken from the values, whose noise is that of the sum; ``known`` (n,)
    are their errors, where these are said; ``others`` (m,) are times where no value is, and at
    which the curve is asked for too.
    """
    taken = np.zeros(len(t)) if taken is None else taken
    if len(t) > LONGEST_KEPT:
        return _smooth_again(t, x, noise, settings, taken, known, others)
    said = b"" if known is None else as_bytes(known)
    where = as_bytes(others)
    return _smooth_once(as_bytes(t), as_bytes(x), noise, settings, as_bytes(taken), said, where)


def as_bytes(values: np.ndarray) -> bytes:
    """Write (n,) numbers as a key that can be looked up."""
    return np.asarray(values, dtype=float).tobytes()


# A search smooths what its report then shows.
@lru_cache(maxsize=32)
def _smooth_once(
    times: bytes,
    values: bytes,
    noise: StateNoise,
    settings: SmoothSettings,
    taken: bytes,
    known: bytes,
    others: bytes,
) -> SmoothColumn:
    t, x, part, where = (np.frombuffer(own) for own in (times, values, taken, others))
    said = np.frombuffer(known) if known else None
    return _smooth_again(t, x, noise, settings, part, said, where)


def _smooth_again(
    t: np.ndarray,
    x: np.ndarray,
    noise: StateNoise,
    settings: SmoothSettings,
    taken: np.ndarray,
    known: np.ndarray | None = None,
    others: np.ndarray = _NOWHERE[0],
) -> SmoothColumn:
    """Smooth one column, in pieces where it is long; ``known`` (n,) are its errors."""
    if len(t) <= settings.chunk:
        return _smooth_piece(t, x, noise, settings, taken, known, others)
    count = int(np.ceil((len(t) - settings.overlap) / (settings.chunk - settings.overlap)))
    edges = np.linspace(0, len(t), count + 1).astype(int)
    homes = np.searchsorted(t[edges[1:-1]], others, side="right")
    between, pieces = np.empty((4, len(others))), []
    for home, (start, stop) in enumerate(pairwise(edges)):
        low = max(start - settings.overlap // 2, 0)
        rows = slice(low, min(stop + settings.overlap // 2, len(t)))
        own = None if known is None else known[rows]
        mine = homes == home
        piece = _smooth_piece(t[rows], x[rows], noise, settings, taken[rows], own, others[mine])
        between[:, mine] = piece.between
        pieces.append((piece, slice(start - low, stop - low)))
    names = ("x", "slope", "x_sd", "slope_sd", "noise", "leverage", "outlier")
    joined = {n: np.concatenate([getattr(p, n)[rows] for p, rows in pieces]) for n in names}
    methods = dict.fromkeys(p.method for p, _ in pieces)
    return SmoothColumn(method=", ".join(methods), between=between, **joined)


@dataclass(frozen=True, eq=False)
class _Warp:
    """A time s(t) from -1 to 1 at the rows, and ds/dt there."""

    name: str
    s: np.ndarray
    rate: np.ndarray

    def between(self, t: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give s (m,) and ds/dt at other times than the rows at (n,) t; beyond these it is even."""
        inside = np.clip(others, t[0], t[-1])
        rate = np.interp(inside, t, self.rate)
        return PchipInterpolator(t, self.s)(inside) + rate * (others - inside), rate


def _warp(name: str, s: np.ndarray, rate: np.ndarray) -> _Warp:
    scale = 2 / (s[-1] - s[0])
    return _Warp(name, (s - s[0]) * scale - 1, rate * scale)


def _fixed_warps(t: np.ndarray, settings: SmoothSettings) -> list[_Warp]:
    """Plain time, and the logarithm of the time since the start or to the end."""
    warps = [_warp("time", t, np.ones(len(t)))]
    for share in settings.starts:
        since, until = t - t[0], t[-1] - t
        lag = share * since[-1]
        warps.append(_warp(f"log start {share:g}", np.log1p(since / lag), 1 / (lag + since)))
        warps.append(_warp(f"log end {share:g}", -np.log1p(until / lag), 1 / (lag + until)))
    return warps


def _arc_warps(t: np.ndarray, pilot: Process, settings: SmoothSettings) -> list[_Warp]:
    """Stretch time where a pilot moves fast."""
    from scipy.ndimage import gaussian_filter1d

    # Averaged over neighbours, so that turning points are no rest.
    squares = gaussian_filter1d(pilot.slope**2, max(1.0, len(t) / 100), mode="nearest")
    speed = np.sqrt(squares + settings.still**2 * np.mean(squares))
    if not np.all(np.isfinite(speed)) or np.max(speed) == 0:
        return []
    warps = []
    for power in settings.arcs:
        rate = (speed / np.max(speed)) ** power
        warps.append(_warp(f"arc {power:g}", PchipInterpolator(t, rate).antiderivative()(t), rate))
    return warps


def _smooth_piece(
    t: np.ndarray,
    x: np.ndarray,
    noise: StateNoise,
    settings: SmoothSettings,
    taken: np.ndarray,
    known: np.ndarray | None = None,
    others: np.ndarray = _NOWHERE[0],
) -> SmoothColumn:
    """Smooth one column of few enough rows: as it is, or its logarithm."""
    spread = float(np.std(x))
    if spread == 0:
        zero = np.zeros(len(t))
        sd = noise.sd(x + taken) if known is None else known
        rest = np.outer([x[0], 0.0, float(np.max(sd)), 0.0], np.ones(len(others)))
        return SmoothColumn(x, zero, sd, zero, sd, "constant", zero, zero > 0, rest)
    found, evidence = _smooth_plain(t, x, noise, settings, taken, known, others)
    if np.any(taken):
        # The logarithm of what is left says nothing of that of the sum.
        return found
    typical = float(np.median(np.abs(x)))
    if np.min(x * np.sign(x[0])) <= 0 or noise.multiplicative * typical < noise.additive:
        return found
    relative = (noise.sd(found.x) if known is None else known) / np.abs(found.x)
    if not np.max(relative) < 0.5:
        return found
    logs = np.log(np.abs(x)) + relative**2 / 2
    other, other_evidence = _smooth_plain(t, logs, noise, settings, taken, relative, others)
    if other_evidence - float(np.sum(np.log(np.abs(x)))) <= evidence:
        return found
    logs = np.array([other.x, other.slope, other.x_sd, other.slope_sd])
    value, slope, x_sd, slope_sd = _of_logs(logs, np.sign(x[0]))
    return replace(
        other,
        x=value,
        slope=slope,
        x_sd=x_sd,
        slope_sd=slope_sd,
        noise=np.abs(value) * other.noise,
        method=f"{other.method} of log",
        between=_of_logs(other.between, np.sign(x[0])),
    )


def _of_logs(found: np.ndarray, sign: float) -> np.ndarray:
    """(4, m) values, slopes and their deviations of what has these logarithms."""
    log, slope, sd, slope_sd = found
    value = np.exp(log) * sign
    slopes = value * slope
    return np.array([value, slopes, np.abs(value) * sd, np.hypot(value * slope_sd, slopes * sd)])


def _smooth_plain(
    t: np.ndarray,
    x: np.ndarray,
    noise: StateNoise,
    settings: SmoothSettings,
    taken: np.ndarray,
    known: np.ndarray | None = None,
    others: np.ndarray = _NOWHERE[0],
) -> tuple[SmoothColumn, float]:
    """Smooth in the warp of greatest evidence; gives that too.

    ``known`` is the standard deviation of every row where the noise is that of a logarithm, or
    said.
    """
    from scipy.ndimage import gaussian_filter1d, median_filter

    level = median_filter(x, 3, mode="nearest")
    usual = gaussian_filter1d(level, 1.0, mode="nearest") + taken
    sd = noise.sd(usual) if known is None else known
    sd = np.maximum(sd, 0.1 * np.median(sd))
    outliers = np.zeros(len(t), dtype=bool)
    if known is None:
        outliers = _spikes(t, x, noise, settings, taken)
    used = np.where(outliers, np.hypot(sd, x - level), sd)
    warp, best = _best_warp(t, x, used, settings)
    for _ in range(settings.rounds):
        if known is None:
            sd = noise.sd(np.hypot(best.value + taken, best.value_sd))
        # What an outlier misses by is judged by the noise that it would have as a row like others.
        reach = np.where(outliers, np.hypot(sd * best.factor, best.value_sd), np.inf)
        far = np.where(outliers, np.abs(x - best.value) / reach, np.abs(best.left_out))
        found = _isolated(far > settings.outlier)
        if known is not None and np.array_equal(found, outliers):
            break
        settled, outliers = np.array_equal(found, outliers), found
        used = np.where(outliers, np.hypot(sd, x - best.value), sd)
        best = _fit(warp, x, used, settings, best.kernel)
        if settled:
            break
    rows = np.maximum(used, settings.process.finest * np.std(x)) * best.factor
    leverage = np.minimum((best.value_sd / rows) ** 2, 1.0)
    evidence = best.evidence + np.sum(outliers) * np.log(settings.rare)
    column = SmoothColumn(
        best.value,
        best.slope,
        best.value_sd,
        best.slope_sd,
        rows,
        warp.name,
        leverage,
        outliers,
        best.at(*warp.between(t, others)),
    )
    return column, float(evidence)


def _best_warp(
    t: np.ndarray, x: np.ndarray, sd: np.ndarray, settings: SmoothSettings
) -> tuple[_Warp, Process]:
    """Give the warp of greatest evidence, and the process in it."""
    plain, *others = _fixed_warps(t, settings)
    # Some rows are enough to tell which logarithm is worth a search.
    few = slice(None, None, max(1, len(t) // settings.screened))
    guesses = [(w, *screen(w.s[few], x[few], sd[few], settings.process)) for w in others]
    guess = max(guesses, key=lambda g: g[1])
    tried = [
        (plain, _fit(plain, x, sd, settings)),
        (guess[0], _fit(guess[0], x, sd, settings, guess[2])),
    ]
    first = max(tried, key=lambda pair: pair[1].evidence)
    tried += [
        (w, _fit(w, x, sd, settings, first[1].kernel)) for w in _arc_warps(t, first[1], settings)
    ]
    # A warp that was made from the rows themselves must be better by more than its own freedom.
    return max(tried, key=lambda p: p[1].evidence - settings.cost * p[0].name.startswith("arc"))


def _spikes(
    t: np.ndarray, x: np.ndarray, noise: StateNoise, settings: SmoothSettings, taken: np.ndarray
) -> np.ndarray:
    """Flag rows that neighbours do not explain; where there are many, that is motion."""
    found = find_outliers(t, x, noise, settings.noise, taken)
    return found if np.mean(found) <= settings.noise.share else np.zeros(len(t), dtype=bool)


def _fit(
    warp: _Warp,
    x: np.ndarray,
    sd: np.ndarray,
    settings: SmoothSettings,
    start: np.ndarray | None = None,
) -> Process:
    return fit_process(warp.s, warp.rate, x, sd, settings.process, start)


def _isolated(flags: np.ndarray) -> np.ndarray:
    """Give the flags whose neighbours have none: several in a row are motion, not outliers."""
    padded = np.pad(flags, 1)
    return flags & ~padded[:-2] & ~padded[2:]


def estimate_noise(
    runs: Sequence[Trajectory], settings: SmoothSettings = _SETTINGS
) -> tuple[StateNoise, ...]:
    """Estimate the noise of every state: additive, multiplicative, or both; and its outliers.

    Each row is compared with the polynomial through its neighbours. For noise of variance
    a^2 + m^2 x^2 the squared residual has the expectation sum_j c_j^2 (a^2 + m^2 x_j^2) with the
    weights c of the interpolation; a and m are those of greatest likelihood, and a two-parameter
    law is used only where it lowers the Bayesian information criterion. Where rows are few or far
    apart such a polynomial is wrong by more than the noise. The residuals of the smoothed
    trajectory, divided by the share that no row itself takes of its own fit, then replace those.

    Parameters
    ----------
    runs : one or many, of the same columns; noise belongs to the instrument and is the same in all.
    settings : how it is done.

    Gives one StateNoise a state; noise 0 when no trajectory has 5 rows.

    >>> t = np.linspace(0, 10, 400)
    >>> x = 5 + 4 * np.sin(t)
    >>> noisy = x * (1 + np.random.default_rng(0).normal(0, 0.05, 400))
    >>> found = estimate_noise([Trajectory(t, noisy[:, None], ("x",))])[0]
    >>> found.additive, bool(0.04 < found.multiplicative < 0.06)
    (0.0, True)
    """
    if not runs:
        raise InputError("no trajectory was given; give at least one")
    parts = find_forced(runs)
    taken = [np.zeros_like(run.x) for run in runs] if parts is None else [p.x for p in parts]
    return tuple(
        _said_noise(runs, state) or _state_noise(_own_columns(runs, taken, k), settings)
        for k, state in enumerate(runs[0].states)
    )


def _said_noise(runs: Sequence[Trajectory], state: str) -> StateNoise | None:
    """Give the noise of a state where its errors are known in every run; None where they are not.

    Errors that differ from row to row are taken by their mean square.
    """
    said = [run.noise.get(state) for run in runs]
    known = [own for own in said if own is not None and own.sure]
    if len(known) < len(runs):
        return None
    squares = [own.sd[run.own_rows(state)] ** 2 for own, run in zip(known, runs, strict=True)]
    return StateNoise(float(np.sqrt(np.mean(np.concatenate(squares)))), known[0].share)


def _own_columns(
    runs: Sequence[Trajectory], taken: Sequence[np.ndarray], place: int
) -> list[Column]:
    """Give times, values and what was taken from these where a state was measured.

    Of rows near a limit only errors to one side were measured, as if there were less noise.
    """
    columns = []
    for run, part in zip(runs, taken, strict=True):
        own = run.measured[:, place]
        if run.states[place] in run.limits:
            far = own & ~_near(run.limits[run.states[place]].there)
            own = far if np.count_nonzero(far) >= FEWEST_ROWS else own
        if np.count_nonzero(own) >= 5:
            columns.append((run.t[own], (run.x - part)[own, place], part[own, place]))
    return columns


def _near(rows: np.ndarray) -> np.ndarray:
    """(n,) whether one of some rows (n,) is at most two rows away."""
    found: np.ndarray = np.convolve(rows, np.ones(5))[2:-2] > 0
    return found


def _state_noise(columns: Sequence[Column], settings: SmoothSettings) -> StateNoise:
    """Estimate the noise of one state from neighbours, then from the smoothed trajectories."""
    noise = neighbour_noise(columns, settings.noise)
    values = np.concatenate([x for _, x, _ in columns]) if columns else np.zeros(1)
    taken = np.concatenate([part for _, _, part in columns]) if columns else np.zeros(1)
    typical = float(np.sqrt(np.mean(noise.sd(values + taken) ** 2)))
    if len(values) > settings.refined or typical <= 10 * settings.process.finest * np.std(values):
        return noise
    least = least_noise(columns)
    free = replace(settings, process=replace(settings.process, known=settings.unknown))
    for _ in range(settings.rounds - 1):
        smooths = [smooth_values(t, x, noise, free, part) for t, x, part in columns]
        level = np.concatenate([s.x for s in smooths])
        share = 1 - np.concatenate([s.leverage for s in smooths])
        outlying = np.concatenate([s.outlier for s in smooths])
        kept = ~outlying & (share > 0.05)
        if np.sum(share[kept]) < 2:
            break
        squares = (values - level)[kept] ** 2 / share[kept]
        law = fit_law(squares, (level + taken)[kept] ** 2, share[kept], settings.noise, least)
        noise = replace(law, outliers=float(np.mean(outlying)))
    return noise
