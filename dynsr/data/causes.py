"""Causes: what may keep the equation of a column from being found, according to the data alone."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import minimize_scalar

from dynsr.data.determinism import Orbit, Pairs, forced_share, nearest_pairs
from dynsr.data.motion_noise import measure_motion_noise
from dynsr.data.noise_model import (
    interpolation_residuals,
    measurement_noise,
    robust_scale,
    scale_of,
)
from dynsr.data.observation import at_own_rows
from dynsr.data.samples import Samples
from dynsr.data.slopes import choose_samples, smooth_column
from dynsr.data.solver_rows import are_even, find_solver_rows
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError


@dataclass(frozen=True)
class DiagnosisSettings:
    """The numbers that decide what a diagnosis says.

    Parameters
    ----------
    rows : rows that are looked at; of more, evenly spaced ones are compared with each other.
    runs : trajectories that are looked at.
    few_rows : fewer rows for each state and one more are called few.
    rough : half the mean squared step as a share of the variance (von Neumann 1941) from which a
        column is called rough; 1 - cos(2 pi / p) for an oscillation of p rows, so 0.19 for 10.
    jumping : the same of all states from which on they may be a map; 0.6 is an oscillation of
        between 5 and 6 rows.
    follows : share of its variance that near neighbours leave open at most, where the next value
        follows from the last.
    noisy : noise, as a share of the spread, that hides an equation.
    slope_noise : variance of the slopes' noise, as a share of theirs, that hides an equation.
    stiff : share of the rows that holds ``stiff_part`` of all squared change, at most, where a
        motion is called stiff.
    stiff_part : see ``stiff``.
    unexplained : share of the slopes' variance that is left open at least, in addition to what
        noise and the distance of the neighbours explain, where a state is missing.
    unexplained_runs : the same in addition to noise alone, where the time is tried as a column of
        many runs.
    noise_factor : how far noise may be underestimated, in variance.
    second : the share that is left open at most, apart from noise and distance, where a column and
        its slope determine the second derivative.
    trend : degree of the polynomial of the columns that is taken off the slopes of near rows, which
        are not at the same place.
    rows_a_term : rows to each of its terms, at least.
    neighbours_within : neighbours further than this (in spreads) are left out.
    forced : share of the differences that a sinusoid in time explains at least, where time is
        named as the cause.
    nearest_part : share of the pairs, the nearest ones, that such a wave is sought in.
    reversal : share of the range that a lone column goes and comes back, at least, where it
        cannot be the only state.
    """

    rows: int = 1500
    runs: int = 20
    few_rows: int = 10
    rough: float = 0.19
    jumping: float = 0.6
    follows: float = 0.15
    noisy: float = 0.2
    slope_noise: float = 0.5
    stiff: float = 0.02
    stiff_part: float = 0.9
    unexplained: float = 0.05
    unexplained_runs: float = 0.01
    noise_factor: float = 5.0
    second: float = 0.005
    trend: int = 3
    rows_a_term: float = 5.0
    neighbours_within: float = 0.4
    forced: float = 0.9
    nearest_part: float = 0.3
    reversal: float = 0.2


_SETTINGS = DiagnosisSettings()
_EVEN_STEPS = (
    " If each row follows from the one before, as counts of generations do, try a map: --map."
)
# A column oscillates that goes up and down at least so often.
_OSCILLATES = 2


@dataclass(frozen=True)
class Cause:
    """Why the equation of a column may not be found, and what to do about it.

    Parameters
    ----------
    kind : "missing state", "second order", "time dependence", "map", "stiff",
        "sampling too coarse", "noise in the motion", "too few rows", "too much noise" or
        "interpolated".
    sentence : the same in words, with the column and the remedy.
    evidence : the numbers behind it.
    """

    kind: str
    sentence: str
    evidence: Mapping[str, float] = field(default_factory=dict)


def diagnose(
    runs: Trajectory | Sequence[Trajectory],
    target: str,
    settings: DiagnosisSettings = _SETTINGS,
) -> list[Cause]:
    """Say what may keep the equation of a column from being found; the most probable cause first.

    Whether the columns determine the slope of the target is shown by rows that are near to each
    other in state and not in time (:func:`dynsr.data.determinism.nearest_pairs`), against noise.
    An empty list says that nothing speaks against an equation ``x' = f(columns)``; it does not
    prove one.

    Parameters
    ----------
    runs : one trajectory or many, of the same columns.
    target : the state whose equation is sought.
    settings : the numbers that decide.

    Raises InputError when the target is no state.

    >>> t = np.linspace(0, 20, 400)
    >>> swing = Trajectory(t, np.sin(t)[:, None], ("z",))
    >>> [cause.kind for cause in diagnose(swing, "z")]
    ['second order', 'time dependence', 'missing state']
    >>> both = Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), ("z", "v"))
    >>> diagnose(both, "z")
    []
    """
    some = [runs] if isinstance(runs, Trajectory) else list(runs)
    some[0].index(target)
    picked = np.linspace(0, len(some) - 1, min(len(some), settings.runs)).astype(int)
    # What is said of a state rests on the rows at which it was measured.
    some = at_own_rows([some[i] for i in picked], target) or [some[0]]
    causes = list(_few_rows(some, target, settings))
    long = [run for run in some if len(run) >= settings.few_rows]
    if not long or np.ptp(np.concatenate([_column(run, target) for run in long])) == 0:
        return causes
    made = list(_of_solver(long, target, settings))
    shape = list(_of_shape(long, target, settings))
    if shape:
        return [*made, *shape, *causes]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [*made, *_of_slopes(long, target, settings), *causes]


def _column(run: Trajectory, target: str) -> np.ndarray:
    return run.x[:, run.index(target)]


def _few_rows(
    runs: Sequence[Trajectory], target: str, settings: DiagnosisSettings
) -> Iterator[Cause]:
    rows, states = sum(map(len, runs)), len(runs[0].states)
    wanted = settings.few_rows * (states + 1)
    if rows < wanted:
        yield Cause(
            "too few rows",
            f"{rows} rows are few for {states} state{'s' * (states > 1)}: several equations for "
            f"{target} may fit them equally well; {wanted} or more distinguish them better.",
            {"rows": rows, "wanted": wanted},
        )


def _of_solver(
    runs: Sequence[Trajectory], target: str, settings: DiagnosisSettings
) -> Iterator[Cause]:
    """Say that rows are polynomials of degree 4 at most between others that are further apart.

    Solvers of medium order give such rows between their steps, and splines do.
    """
    even = [run for run in runs if _are_even([run]) and len(run) >= settings.few_rows]
    if not even:
        return
    step = float(np.median(np.diff(even[0].t)))
    found = find_solver_rows([_column(run, target) for run in even], step)
    if found is not None and found.interpolated:
        yield Cause(
            "interpolated",
            f"{target} was interpolated: {100 * found.share:.0f} % of its rows lie on polynomials "
            "of degree 4 or less, which jump where they meet. Solvers such as solve_ivp make such "
            "rows between their steps, with the errors of these: solve again with rtol=1e-9 and "
            "atol=1e-12. Of measured data, give the rows that were measured.",
            {"share of rows": found.share, "error of slopes": found.relative},
        )


def _of_shape(
    runs: Sequence[Trajectory], target: str, settings: DiagnosisSettings
) -> Iterator[Cause]:
    """Give what is seen without slopes: fast layers, jumps, coarse sampling, noise."""
    columns = [_column(run, target) for run in runs]
    change = np.concatenate([np.diff(x) ** 2 for x in columns])
    variance = float(np.var(np.concatenate(columns)))
    fast = _share_of_rows(change, settings.stiff_part)
    if fast <= settings.stiff and len(change) * settings.stiff >= 1:
        most = _largest_jump(runs, columns)
        yield Cause(
            "stiff",
            f"{target} changes almost only in fast layers: {100 * fast:.2g} % of the rows hold "
            f"{100 * settings.stiff_part:.0f} % of its change, most of all from {most}. Measure "
            "the layers with more rows, at least 5 each; uneven times are fine. If the system was "
            "started again or changed there, name the parts in a column (--trajectory).",
            {"share of rows": fast},
        )
        return
    rough = float(np.mean(change)) / 2 / variance
    if rough <= settings.rough:
        noise = list(_of_noise(runs, target, settings))
        yield from noise and (_of_motion(runs, target) or noise)
        return
    following = min(_following(runs, target, lags, settings.rows) for lags in (1, 2))
    if following > min(settings.follows, rough / 2):
        stepped = _EVEN_STEPS if _are_even(runs) else ""
        yield from (
            replace(cause, sentence=cause.sentence + stepped)
            for cause in _of_noise(runs, target, settings)
        )
        return
    evidence = {"roughness": rough, "left open": following}
    if _jumps(runs, settings):
        yield Cause(
            "map",
            f"{target} jumps from row to row, yet each row follows from the one before: it looks "
            f"like a map {target}[n+1] = f(...); try --map. If it moves smoothly between the rows, "
            "measure at least 10 times as often.",
            evidence,
        )
        return
    yield Cause(
        "sampling too coarse",
        f"the rows are too far apart for slopes of {target}: {_seen_between_rows(runs, target)}",
        evidence,
    )


def _seen_between_rows(runs: Sequence[Trajectory], target: str) -> str:
    """Say how far apart the rows are: the rows of an oscillation, or the longest step of all."""
    run = max(runs, key=lambda one: _swings(_column(one, target)))
    x = _column(run, target)
    swings = _swings(x)
    if swings >= _OSCILLATES:
        return f"it takes about {len(x) / swings:.2g} rows an oscillation. Measure more often."
    steps = [np.abs(np.diff(_column(one, target))) for one in runs]
    number = int(np.argmax([step.max() for step in steps]))
    row = int(np.argmax(steps[number]))
    size = float(np.ptp(np.concatenate([_column(one, target) for one in runs])))
    begin, end = runs[number].t[row : row + 2]
    return (
        f"from t = {begin:.4g} to t = {end:.4g} alone it moves by "
        f"{100 * steps[number][row] / size:.0f} % of its range. Measure more often there."
    )


def _swings(x: np.ndarray) -> float:
    """Count how often a column goes through the middle of its range and back."""
    return np.count_nonzero(np.diff(x > (x.min() + x.max()) / 2)) / 2


def _of_motion(runs: Sequence[Trajectory], target: str) -> list[Cause]:
    """Give the cause where most of the noise is in the motion itself."""
    found = measure_motion_noise(runs, target)
    if not found.is_sure:
        return []
    sentence = (
        f"{target} seems to move by chance from row to row: of what a row is off the line through "
        f"its neighbours, {found.share:.0%} grows with the time between them. With stochastic=True "
        "(--stochastic) its drift and the variance of its noise are found."
    )
    return [Cause("noise in the motion", sentence, {"share": found.share})]


def _jumps(runs: Sequence[Trajectory], settings: DiagnosisSettings) -> bool:
    """Say whether every state jumps at even times; a flow has columns that move smoothly."""
    change = np.mean(np.concatenate([np.diff(run.x, axis=0) ** 2 for run in runs]), axis=0)
    variance = np.var(np.concatenate([run.x for run in runs]), axis=0)
    return _are_even(runs) and bool(np.all(change >= 2 * settings.jumping * variance))


def _are_even(runs: Sequence[Trajectory]) -> bool:
    return are_even(np.concatenate([np.diff(run.t) for run in runs]))


def _largest_jump(runs: Sequence[Trajectory], columns: Sequence[np.ndarray]) -> str:
    """Say between which times a column changes most."""
    number = int(np.argmax([np.max(np.abs(np.diff(x))) for x in columns]))
    row = int(np.argmax(np.abs(np.diff(columns[number]))))
    begin, end = runs[number].t[row : row + 2]
    return f"t = {begin:.4g} to {end:.4g}"


def _share_of_rows(change: np.ndarray, part: float) -> float:
    """Give the smallest share of rows that holds this part of all change."""
    whole = np.cumsum(np.sort(change)[::-1])
    return float(np.searchsorted(whole, part * whole[-1]) + 1) / len(change)


def _following(runs: Sequence[Trajectory], target: str, lags: int, rows: int) -> float:
    """Give what near rows leave open of the next value; 1 where that is unknown."""
    counts = [len(run) - lags for run in runs]
    points = [
        np.column_stack([run.columns[i : n + i] for i in range(lags)])
        for run, n in zip(runs, counts, strict=True)
    ]
    left = near_rows_leave_open(points, [_column(run, target)[lags:] for run in runs], rows)
    return left if np.isfinite(left) else 1.0


def near_rows_leave_open(
    points: Sequence[np.ndarray], values: Sequence[np.ndarray], most: int = 2000
) -> float:
    """Give the share of the values' variance that near points leave open; nan if none are near.

    Parameters
    ----------
    points : for each run (n, d) coordinates of its rows.
    values : for each run (n,) what should follow from them.
    most : rows that are looked at, at most.

    >>> x = np.random.default_rng(0).uniform(-1, 1, 500)
    >>> near_rows_leave_open([x[:, None]], [x**2]) < 0.01
    True
    """
    pieces = [
        Orbit(where, value, np.full(len(value), number), np.arange(len(value)))
        for number, (where, value) in enumerate(zip(points, values, strict=True))
    ]
    return nearest_pairs(join_orbits(pieces).thinned(most)).share


def join_orbits(pieces: Sequence[Orbit]) -> Orbit:
    """Put the rows of several orbits below each other."""
    return Orbit(
        np.concatenate([piece.points for piece in pieces]),
        np.concatenate([piece.values for piece in pieces]),
        np.concatenate([piece.run for piece in pieces]),
        np.concatenate([piece.row for piece in pieces]),
    )


def _of_noise(
    runs: Sequence[Trajectory], target: str, settings: DiagnosisSettings
) -> Iterator[Cause]:
    longest = max(runs, key=len)
    noise = float(measurement_noise(longest)[longest.index(target)])
    spread = float(np.std(_column(longest, target))) or 1.0
    if noise > settings.noisy * spread:
        yield Cause(
            "too much noise",
            f"the noise of {target} is {100 * noise / spread:.0f} % of its spread, or its rows are "
            "too far apart to follow its motion. Measure more precisely, more often, or the same "
            "run several times.",
            {"noise": noise, "spread": spread},
        )


@dataclass(frozen=True, eq=False)
class _Motion:
    """Slopes of the target: the samples of every run, and all of them as one orbit.

    ``columns`` are the target's values at all rows of these runs, those without a slope too, cut
    where inputs change; none where other states may move it meanwhile;
    ``noise`` is the variance of the slopes' noise as a share of theirs, of all rows together, and
    ``by_run`` (runs,) that of each run, where its mean square counts and not its median.
    """

    samples: tuple[Samples, ...]
    columns: tuple[list[np.ndarray], ...]
    orbit: Orbit
    t: np.ndarray
    noise: float
    by_run: np.ndarray

    def noise_of(self, pairs: Pairs, orbit: Orbit) -> float:
        """Give the noise that near rows have, but no less than that of all rows.

        Runs differ in their noise, and near rows may all be of the noisier ones.
        """
        if not len(pairs.first):
            return self.noise
        run = orbit.run[np.concatenate([pairs.first, pairs.second])]
        return max(self.noise, float(np.mean(self.by_run[run])))


def _samples(run: Trajectory, target: str) -> Samples | None:
    """Make the samples of a run; None where it is too short for slopes."""
    try:
        return choose_samples(run, target)
    except InputError:
        return None


def _while_inputs_rest(run: Trajectory, fewest: int) -> list[np.ndarray]:
    """Give the lone state of a run, cut where inputs change; [] where there are more states."""
    if len(run.states) > 1:
        return []
    changes = np.any(np.diff(run.inputs, axis=0) != 0, axis=1)
    pieces = np.split(run.x[:, 0], np.flatnonzero(changes) + 1)
    return [piece for piece in pieces if len(piece) >= fewest]


def _motion(runs: Sequence[Trajectory], target: str, settings: DiagnosisSettings) -> _Motion | None:
    pairs = [(run, found) for run in runs if (found := _samples(run, target)) is not None]
    if not pairs:
        return None
    samples = tuple(found for _, found in pairs)
    columns = tuple(_while_inputs_rest(run, settings.few_rows) for run, _ in pairs)
    orbit = join_orbits(
        [Orbit(s.X, s.y, np.full(len(s), i), np.arange(len(s))) for i, s in enumerate(samples)]
    )
    variance = float(np.var(orbit.values)) or 1.0
    own = np.array([(s.noise or 0.0) ** 2 for s in samples]) / variance
    uneven = np.array([_unevenness(run, target) for run, _ in pairs])
    t = np.concatenate([s.t for s in samples])
    return _Motion(samples, columns, orbit, t, float(np.mean(own)), own * uneven)


def _unevenness(run: Trajectory, target: str) -> float:
    """Give how far the mean square of the noise is above its median's, for noise that varies."""
    x = _column(run, target)[:, None]
    misses = [interpolation_residuals(run.t, x, o) for o in (2, 4, 6, 8) if len(run) > o + 2]
    size, miss = min(((float(robust_scale(m)), m) for m in misses), key=lambda pair: pair[0])
    return float(np.clip(np.mean(miss**2) / size**2, 1.0, 10.0)) if size > 0 else 1.0


def _of_slopes(
    runs: Sequence[Trajectory], target: str, settings: DiagnosisSettings
) -> Iterator[Cause]:
    motion = _motion(runs, target, settings)
    if motion is None or np.var(motion.orbit.values) == 0:
        return
    if motion.noise > settings.slope_noise:
        yield Cause(
            "too much noise",
            f"noise is {100 * np.sqrt(motion.noise):.0f} % of the slopes of {target}. Measure "
            "more precisely, or more often.",
            {"share of the slopes": float(np.sqrt(motion.noise))},
        )
        return
    orbit = motion.orbit.thinned(settings.rows)
    pairs = nearest_pairs(orbit)
    noise = motion.noise_of(pairs, orbit)
    if not _lacks(motion, pairs, noise, settings) or not _lacks(
        motion, _beside_trend(orbit, pairs, settings), noise, settings
    ):
        yield from _of_time_in_runs(motion, target, pairs, noise, settings)
        return
    second = _is_second_order(motion, target, pairs, settings)
    timed = _of_time(motion, target, pairs, settings, bool(second))
    timed = timed or list(_of_time_in_runs(motion, target, pairs, noise, settings))
    yield from [*second, *timed, _missing(motion, target, pairs)]


def _missing(motion: _Motion, target: str, pairs: Pairs) -> Cause:
    others = "" if len(motion.samples[0].names) == 1 else " (and all other columns)"
    return Cause(
        "missing state",
        f"{target}{others} comes back to the same values with different slopes: a state or an "
        f"input that moves {target} may be missing among the columns. Measure it too, if there is "
        "one, or search with a hidden state (hidden=).",
        {"left open": pairs.share, "noise": motion.noise, "distance": pairs.distance},
    )


def _is_open(pairs: Pairs, noise: float, settings: DiagnosisSettings) -> bool:
    """Say whether near rows differ in slope by more than noise and their distance explain."""
    bound = settings.unexplained + settings.noise_factor * noise + pairs.distance**2
    return bool(pairs.distance <= settings.neighbours_within and pairs.share > bound)


def _beside_trend(orbit: Orbit, pairs: Pairs, settings: DiagnosisSettings) -> Pairs:
    """Give the same pairs with what a polynomial of the columns leaves of their differences.

    Rows of few runs are near, not equal: slopes that bend between them differ as well. What an
    equation of the columns explains of that is no missing state.
    """
    scales = [scale_of(column) for column in orbit.points.T]
    points = (orbit.points - orbit.points.mean(axis=0)) / scales
    rows, width = points.shape
    best, left = pairs, pairs.share
    for degree in range(1, settings.trend + 1):
        columns = np.column_stack(
            [np.ones(rows)]
            + [
                np.prod(points[:, list(chosen)], axis=1)
                for power in range(1, degree + 1)
                for chosen in combinations_with_replacement(range(width), power)
            ]
        )
        freedom = rows - columns.shape[1]
        if columns.shape[1] > rows / settings.rows_a_term:
            break
        weights, *_ = np.linalg.lstsq(columns, orbit.values, rcond=None)
        rest = orbit.values - columns @ weights
        difference = (rest[pairs.first] - rest[pairs.second]) * np.sqrt(rows / freedom)
        share = float(np.mean(difference**2)) / 2 / float(np.var(orbit.values))
        if share < left:
            best, left = replace(pairs, difference=difference, share=share), share
    return best


def _lacks(motion: _Motion, pairs: Pairs, noise: float, settings: DiagnosisSettings) -> bool:
    """Say whether the columns cannot be all states.

    The orbit of x' = f(x) is monotone, and so is that of x' = f(x, u) while u rests: a lone column
    of one run that does not come back contradicts nothing, however its near rows differ, and one
    that does comes back to other slopes.
    """
    opened = _is_open(pairs, noise, settings)
    both = zip(motion.samples, motion.columns, strict=True)
    back = [own for own, pieces in both if _any_turns_back(pieces, settings)]
    if len(motion.samples) == 1 and len(motion.samples[0].names) == 1:
        return bool(back) and (opened or _is_smooth(back[0]))
    return opened or any(map(_is_smooth, back))


def _any_turns_back(pieces: Sequence[np.ndarray], settings: DiagnosisSettings) -> bool:
    """Whether a piece of a column goes and comes back, by a share of what the whole moves."""
    whole = float(np.ptp(np.concatenate(pieces))) if pieces else 0.0
    return any(_goes_back(x) > settings.reversal * whole for x in pieces)


def _goes_back(x: np.ndarray) -> float:
    fall = float(np.max(np.maximum.accumulate(x) - x))
    rise = float(np.max(x - np.minimum.accumulate(x)))
    return min(fall, rise)


def turns_back(
    runs: Sequence[Trajectory], target: str, settings: DiagnosisSettings = _SETTINGS
) -> bool:
    """Whether a state goes and comes back in a run, which no lone state of ``x' = f(x)`` does.

    Parameters
    ----------
    runs : trajectories of the same columns.
    target : the state.
    settings : the numbers that decide.

    >>> t = np.linspace(0, 20, 400)
    >>> turns_back([Trajectory(t, np.sin(t)[:, None], ("z",))], "z")
    True
    """
    columns = (run.observed[:, run.index(target)] for run in runs)
    there = (column[np.isfinite(column)] for column in columns)
    return any(_any_turns_back([column], settings) for column in there if len(column))


def _is_smooth(samples: Samples) -> bool:
    """Say whether the slopes are surer than they are large, so that a return is no noise."""
    return (samples.noise or 0.0) ** 2 < 0.05 * float(np.var(samples.y))


def _second_orbit(samples: Samples, number: int) -> Orbit | None:
    """Give the rows where a second derivative should follow; None where a run is too short."""
    try:
        again = smooth_column(samples.t, samples.y, samples.scheme)
    except InputError:
        return None
    points = np.column_stack([samples.X, samples.y])[again.rows]
    order = np.arange(len(points))
    return Orbit(points, again.slope, np.full(len(points), number), order)


def _is_second_order(
    motion: _Motion, target: str, pairs: Pairs, settings: DiagnosisSettings
) -> list[Cause]:
    orbits = [_second_orbit(s, i) for i, s in enumerate(motion.samples)]
    pieces = [orbit for orbit in orbits if orbit is not None]
    if not pieces:
        return []
    second = nearest_pairs(join_orbits(pieces).thinned(settings.rows))
    bound = settings.second + settings.noise_factor * motion.noise + second.distance**2
    if second.distance > settings.neighbours_within or not second.share <= min(
        bound, pairs.share / 4
    ):
        return []
    alone = len(motion.samples[0].names) == 1
    return [
        Cause(
            "second order",
            f"{target} looks second-order: {target} and its own slope determine how that slope "
            f"changes; try --order {'2' if alone else f'{target}=2'}.",
            {"left open": second.share, "distance": second.distance},
        )
    ]


def _of_time(
    motion: _Motion, target: str, pairs: Pairs, settings: DiagnosisSettings, second: bool
) -> list[Cause]:
    """Give the cause that a wave in time is."""
    rows = np.linspace(0, len(motion.t) - 1, min(len(motion.t), settings.rows)).astype(int)
    span = min(float(np.ptp(s.t)) for s in motion.samples)
    # The nearest differ by the forcing alone, not by their distance.
    share, period = _best_period(pairs.nearer(settings.nearest_part), motion.t[rows], span)
    if share <= settings.forced:
        return []
    also = ", which these data cannot distinguish from that" if second else ""
    return [
        Cause(
            "time dependence",
            f"a wave in time of period {period:.3g} explains why {target} has different slopes at "
            f"the same values{also}; try --explicit-time.",
            {"explained": share, "period": period},
        )
    ]


def _of_time_in_runs(
    motion: _Motion, target: str, pairs: Pairs, noise: float, settings: DiagnosisSettings
) -> Iterator[Cause]:
    """Give the cause that the time since the start is, where many runs agree on it."""
    if len(motion.samples) < 2 or not (
        pairs.share > settings.unexplained_runs + settings.noise_factor * noise
    ):
        return
    rows = motion.orbit
    points = np.column_stack([rows.points, motion.t])
    timed = nearest_pairs(replace(rows, points=points).thinned(settings.rows))
    if timed.distance <= settings.neighbours_within and timed.share < pairs.share / 4:
        yield Cause(
            "time dependence",
            f"runs of {target} agree where the time is the same: its slope depends on the time; "
            "try --explicit-time.",
            {"left open": timed.share, "without time": pairs.share},
        )


def _best_period(pairs: Pairs, t: np.ndarray, span: float) -> tuple[float, float]:
    """Search the periods that fit at least twice into a run, and refine the best."""
    cycles = np.arange(2.0, min(len(t) / 10, 60.0), 0.25)
    share, period = forced_share(pairs, t, span / cycles)
    if not np.isfinite(period):
        return share, period
    middle = span / period
    found = minimize_scalar(
        lambda c: -forced_share(pairs, t, [span / c])[0],
        bounds=(middle - 0.25, middle + 0.25),
        method="bounded",
        options={"maxiter": 20},
    )
    refined = forced_share(pairs, t, [span / found.x])
    return max((share, period), refined)
