"""Approximations: sums of terms whose integration is closest to the measured trajectories.

A formula that fits the slopes well may still diverge when it is integrated. Where no law was found,
a sum of many terms may follow the motion. Candidates are sums of several libraries, fitted to the
slopes of several smoothers by sequentially thresholded least squares (Brunton et al. 2016). All are
integrated from the start of every run. Those that explain the states best are given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy

from dynsr.data import SmoothedTrajectory, Trajectory, smooth_column
from dynsr.expression import Program, compile_columns
from dynsr.fit import (
    Flow,
    Pace,
    Windows,
    cut_windows,
    drives_of,
    explained_shares,
    runge_kutta_step,
)
from dynsr.methods import Demands, Library, polynomials, trigonometrics

Equations = dict[str, sympy.Expr]


@dataclass(frozen=True)
class ApproximationSettings:
    """The numbers that decide among sums of terms that are integrated.

    Parameters
    ----------
    degrees : of the polynomials, each a library.
    beside_waves : degree of the polynomials in the library that has sines and cosines too.
    terms : terms of a library at most; of many columns lower degrees are taken.
    thresholds : least size of a term as a share of the slope's size.
    ridge : weight of the coefficients, which keeps like terms from cancelling each other.
    windows : rows of the local polynomials that smooth.
    degree : of these.
    steps : of an integration over a run, at least.
    rows : rows of all runs that are compared, at most.
    runs : runs that are integrated, at most.
    reach : spreads by which an integration may leave the data.
    tie : R2 within which the sum of fewest terms is the better one.
    given : sums that are given as an answer.
    """

    degrees: tuple[int, ...] = (1, 2, 3)
    beside_waves: int = 2
    terms: int = 120
    thresholds: tuple[float, ...] = tuple(np.geomspace(1e-3, 1.0, 12).tolist())
    ridge: float = 1e-9
    windows: tuple[int, ...] = (5, 9, 17, 33, 65)
    degree: int = 3
    steps: int = 800
    rows: int = 500
    runs: int = 10
    reach: float = 20.0
    tie: float = 0.005
    given: int = 4


APPROXIMATING = ApproximationSettings()


@dataclass(frozen=True)
class Approximation:
    """Equations, and the share of the variance of the states that their integration explains."""

    exprs: Equations
    r2: float

    @property
    def terms(self) -> int:
        """Terms of all equations."""
        return sum(len(sympy.Add.make_args(expr)) for expr in self.exprs.values())


@dataclass(frozen=True, eq=False)
class MeasuredRuns:
    """Measured runs to be followed as a whole, each from its first row.

    Parameters
    ----------
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t`` where it is known; others are read from the data.
    states : the k states that are followed; others are read from the data too.
    smoothed : the runs made smooth, where they are noisy; they begin where these do.
    settings : the numbers that decide.

    >>> t = np.linspace(0.0, 3.0, 31)
    >>> decay = Trajectory(t, np.exp(-0.5 * t)[:, None], ("x",))
    >>> MeasuredRuns([decay], {}, ("x",)).r2({"x": -sympy.Symbol("x") / 2}).round(6)
    array([1.])
    """

    runs: Sequence[Trajectory]
    inputs: Mapping[str, sympy.Expr]
    states: tuple[str, ...]
    smoothed: Sequence[SmoothedTrajectory] | None = None
    settings: ApproximationSettings = APPROXIMATING

    @cached_property
    def driven(self) -> tuple[str, ...]:
        """Columns that are read from the data, and inputs."""
        names = dict.fromkeys([*self.runs[0].names, *self.inputs])
        return tuple(name for name in names if name not in self.states)

    @cached_property
    def _places(self) -> list[int]:
        return [self.runs[0].index(state) for state in self.states]

    @cached_property
    def windows(self) -> list[tuple[Windows, np.ndarray]]:
        """The runs, thinned, as one window each, and their first states (k, 1)."""
        drives = drives_of(self.driven, self.runs, self.inputs)
        some = range(min(len(self.runs), self.settings.runs))
        stride = max(1, math.ceil(sum(len(self.runs[i]) for i in some) / self.settings.rows))
        found = []
        for i in some:
            run, own = self.runs[i], max(1, min(stride, (len(self.runs[i]) - 1) // 4))
            rows = run.thin(own)[0]
            rows = np.union1d(rows, [len(run) - 1]) if rows[-1] > len(run) - 1 - own else rows
            whole = self.smoothed is not None and len(self.smoothed[i].t) == len(run)
            start = self.smoothed[i].x[0] if whole and self.smoothed is not None else run.x[0]
            x = run.x[rows][:, self._places]
            windows = cut_windows([run.t[rows]], [x], [drives[i]], len(rows) - 1, 1)
            found.append((windows, start[self._places, None]))
        return found

    def pace(self, windows: Windows) -> Pace:
        """Steps of the integration between two rows."""
        return Pace(math.ceil(self.settings.steps / (len(windows.t) - 1)))

    def r2(self, exprs: Mapping[str, sympy.Expr]) -> np.ndarray:
        """(k,) share of the variance of each state that an integration explains, from -1 up.

        Parameters
        ----------
        exprs : state -> right-hand side.

        Runge and Kutta's steps are even ones, so that stiff equations may count as diverging: -1.
        """
        flow = Flow({s: exprs[s] for s in self.states}, self.driven, ())
        found = [
            flow.run(windows, start, np.zeros(0), self.pace(windows))
            for windows, start in self.windows
        ]
        return np.asarray(self._score(found)[:, 0])

    def _score(self, found: Sequence[np.ndarray]) -> np.ndarray:
        """R2 (k, M) of M integrations, (rows, k, M) for every run."""
        measured = np.concatenate([windows.x for windows, _ in self.windows])
        return explained_shares(measured, np.concatenate(found))

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest states (k, 1) that an integration may come to."""
        x = np.concatenate([run.x[:, self._places] for run in self.runs])
        low, high = x.min(axis=0)[:, None], x.max(axis=0)[:, None]
        far = self.settings.reach * (high - low)
        return low - far, high + far

    def march(self, program: Program, coefficients: np.ndarray) -> np.ndarray:
        """Mean R2 (M,) of M sums of terms with ``coefficients`` (k, M, p) of the p terms."""

        def slope(x: np.ndarray, driven: np.ndarray) -> np.ndarray:
            return np.einsum("kmp,pm->km", coefficients, program(*x, *driven[:, None]))

        found = self._score(
            [
                self._march(slope, windows, start, coefficients.shape[1])
                for windows, start in self.windows
            ]
        )
        return np.asarray(np.mean(found, axis=0))

    def _march(
        self,
        slope: Callable[[np.ndarray, np.ndarray], np.ndarray],
        windows: Windows,
        start: np.ndarray,
        count: int,
    ) -> np.ndarray:
        """Integrate ``count`` systems from one start; NaN from where they leave the bounds."""
        pace = self.pace(windows)
        stages = windows.driven_at(pace)[..., 0]
        low, high = self.bounds
        x = np.repeat(start, count, axis=1)
        found = [x]
        with np.errstate(all="ignore"):
            steps = windows.stages(pace).reshape(-1, pace.substeps, 3)
            for h, nodes in zip(np.diff(windows.t[:, 0]) / pace.substeps, steps, strict=True):
                for at in nodes:
                    x = runge_kutta_step(slope, x, h, tuple(stages[at]))
                x = np.where(np.all((x > low) & (x < high), axis=0), x, np.nan)
                found.append(x)
        return np.stack(found)

    def slopes(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Columns (n, k + d + 1) and slopes (n, k), by one smoother after the other."""
        short = min(map(len, self.runs))
        noisy = ("gp",) if self.smoothed is not None else ()
        local = [
            f"savgol({w},{self.settings.degree})" for w in self.settings.windows if w <= short // 2
        ]
        for scheme in ("central2", "central4", *noisy, *local):
            if scheme == "central4" and short < 9:
                continue
            pieces = [self._smooth(i, scheme) for i in range(len(self.runs))]
            columns, slopes = (np.concatenate(own) for own in zip(*pieces, strict=True))
            yield columns, slopes

    def _smooth(self, place: int, scheme: str) -> tuple[np.ndarray, np.ndarray]:
        run = self.runs[place]
        if scheme == "gp":
            assert self.smoothed is not None
            own = self.smoothed[place]
            t, x, slope = own.t, own.x[:, self._places], own.slope[:, self._places]
        else:
            smooths = [smooth_column(run.t, run.x[:, i], scheme) for i in self._places]
            t = run.t[smooths[0].rows]
            x, slope = (
                np.stack(c, axis=1) for c in zip(*((s.x, s.slope) for s in smooths), strict=True)
            )
        driven = drives_of(self.driven, [run], self.inputs)[0](t)
        return np.column_stack([x, driven.T]), slope


def find_approximations(
    measured_runs: MeasuredRuns,
    demands: Demands,
    given: Mapping[str, sympy.Expr] | None = None,
    explicit_time: bool = False,
) -> list[Approximation]:
    """Give the sums of terms that follow the runs best, the first chosen, the others by R2.

    Parameters
    ----------
    measured_runs : the runs.
    demands : what the user asks of the equations; what breaks them is not given.
    given : state -> its equation where that is known, such as a bare velocity.
    explicit_time : whether terms may contain the time.

    >>> t = np.linspace(0.0, 3.0, 31)
    >>> decay = Trajectory(t, np.exp(-0.5 * t)[:, None], ("x",))
    >>> best = find_approximations(MeasuredRuns([decay], {}, ("x",)), Demands())[0]
    >>> sorted(map(str, best.exprs["x"].free_symbols)), round(best.r2, 3)
    (['x'], 1.0)
    """
    settings = measured_runs.settings
    names = [*measured_runs.states, *measured_runs.driven, "t"]
    used = names if explicit_time else names[:-1]
    libraries = _Libraries.of(used, demands, settings)
    program = compile_columns(libraries.whole.functions, names)
    held = {measured_runs.states.index(s): libraries.place(e) for s, e in (given or {}).items()}
    found: dict[bytes, np.ndarray] = {}
    for columns, slopes in measured_runs.slopes():
        values = program(*columns.T).T
        fine = np.isfinite(values).all(axis=0) & (np.ptp(values, axis=0) < np.inf)
        allowed = [libraries.allowed(s, demands) & fine for s in measured_runs.states]
        for choice in libraries.choices:
            for sums in _thin(values, slopes, [choice & own for own in allowed], settings):
                for row, place in held.items():
                    sums[row] = 0.0
                    sums[row, place] = 1.0
                # Of sums of the same terms the smoothers give others.
                found.setdefault(np.round(sums, 12).tobytes(), sums)
    sums = np.stack(list(found.values()), axis=1)
    r2 = measured_runs.march(program, sums)
    return _choose(measured_runs, libraries.whole, sums, r2, demands, given or {})


@dataclass(frozen=True, eq=False)
class _Libraries:
    """All terms once, and the libraries as choices (p,) of them."""

    whole: Library
    choices: tuple[np.ndarray, ...]

    @classmethod
    def of(
        cls, names: Sequence[str], demands: Demands, settings: ApproximationSettings
    ) -> _Libraries:
        sizes = {d: len(polynomials(names, d)) for d in settings.degrees}
        degrees = [d for d in settings.degrees if sizes[d] <= settings.terms or d == 1]
        powers = polynomials(names, max(degrees))
        whole = powers + trigonometrics(names)
        own = [e for e in demands.offered if e not in whole.functions]
        whole = whole + Library(tuple(own)) if own else whole
        degree = np.array([_degree(e) for e in whole.functions])
        asked = np.array([e in own for e in whole.functions])
        plain = {d: (degree >= 0) & (degree <= d) for d in (*degrees, settings.beside_waves)}
        sets = [*(plain[d] for d in degrees), plain[settings.beside_waves] | (degree == -1)]
        choices = [mine | asked for every in sets for mine in (every & (degree != 0), every)]
        return cls(whole, tuple(choices))

    def place(self, expr: sympy.Expr) -> int:
        return self.whole.functions.index(expr)

    def allowed(self, state: str, demands: Demands) -> np.ndarray:
        limits = demands.limits(state)
        return np.array([limits.allow(e) for e in self.whole.functions])


def _degree(term: sympy.Expr) -> int:
    """Degree of a product of columns; -1 for any other term."""
    symbols = sorted(term.free_symbols, key=str)
    return int(sympy.total_degree(term)) if term.is_polynomial(*symbols) else -1


def _thin(
    values: np.ndarray,
    slopes: np.ndarray,
    choices: Sequence[np.ndarray],
    settings: ApproximationSettings,
) -> Iterator[np.ndarray]:
    """Coefficients (k, p) of the sums that every threshold leaves, each choice of terms once.

    Terms and slopes are counted in units of their sizes, so that no unit of a column matters.
    """
    size = np.maximum(np.sqrt(np.mean(values**2, axis=0)), 1e-300)
    scaled, unit = values / size, np.maximum(np.std(slopes, axis=0), 1e-300)
    gram, pull = scaled.T @ scaled / len(values), scaled.T @ (slopes / unit) / len(values)
    seen = set()
    for threshold in settings.thresholds:
        sums = np.zeros((slopes.shape[1], values.shape[1]))
        for row, choice in enumerate(choices):
            places, weights = _threshold(gram, pull[:, row], choice, threshold, settings.ridge)
            sums[row, places] = weights * unit[row] / size[places]
        key = (sums != 0).tobytes()
        if key not in seen and np.isfinite(sums).all():
            seen.add(key)
            yield sums


def _threshold(
    gram: np.ndarray, pull: np.ndarray, choice: np.ndarray, threshold: float, ridge: float
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares on the terms whose coefficients stay above the threshold, repeated."""
    places = np.flatnonzero(choice)
    weights = np.zeros(len(places))
    while len(places):
        own = gram[np.ix_(places, places)] + ridge * np.eye(len(places))
        try:
            weights = np.linalg.solve(own, pull[places])
        except np.linalg.LinAlgError:
            return places[:0], weights[:0]
        large = np.abs(weights) >= threshold
        if large.all():
            break
        places, weights = places[large], weights[large]
    return places, weights


def _choose(
    measured_runs: MeasuredRuns,
    library: Library,
    sums: np.ndarray,
    r2: np.ndarray,
    demands: Demands,
    given: Mapping[str, sympy.Expr],
) -> list[Approximation]:
    """Give the sum of fewest terms of the best, then the others by R2."""
    settings = measured_runs.settings
    terms = np.count_nonzero(sums, axis=(0, 2))
    best = float(np.max(r2))
    order = np.argsort(-r2, kind="stable")
    near = [i for i in order if r2[i] >= best - settings.tie]
    first = min(near, key=lambda i: terms[i])
    found: list[Approximation] = []
    for i in [first, *(i for i in order if i != first)]:
        if len(found) == settings.given or r2[i] <= 0:
            break
        exprs = {s: library.combine(sums[row, i]) for row, s in enumerate(measured_runs.states)}
        exprs |= given
        if demands.keep_all(exprs):
            found.append(Approximation(exprs, float(r2[i])))
    return found
