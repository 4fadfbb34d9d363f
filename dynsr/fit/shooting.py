"""Shooting: the constants of a whole system, fitted to the measured states.

Multiple shooting (Bock 1981): shared constants, own starts a window, robust Levenberg-Marquardt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import sympy

from dynsr.data import Trajectory, carry, robust_scale
from dynsr.engines import Drive, jumps_of
from dynsr.errors import InputError
from dynsr.expression import compile_numpy, free_constants, parse
from dynsr.fit.flow import PLAIN, Flow, Pace, Track, Windows, cut_windows
from dynsr.fit.linear import DAMPED, DAMPING, ROUNDING, cauchy_weights
from dynsr.fit.noise import independent_rows, is_noisy, noise_and_spread, spread_of
from dynsr.fit.settings import FIT, FitSettings

# Runge-Kutta 4 is stable for |eigenvalue| * step up to about 2.8 (Hairer and Wanner 1996, IV.2).
STABLE = 2.5
# Misses below this share of the spread are those of solvers.
_SOLVER = 1e-9
# An interval is cut into at most 2^6 stable steps; what is stiffer still diverges.
_MOST_HALVINGS = 6
# Intervals of the windows of exact states.
INTERVALS = 10
# Share of the median residual by which a step of the integration may move a state.
STEP_ERROR = 0.01
# Share of the loss by which a step lowers it at least where a fit need not be exact.
ROUGH = 1e-3


@dataclass(frozen=True, eq=False)
class Normal:
    """Weighted normal equations: ``shared`` (P, P), ``cross`` (W, P, k), ``own`` (W, k, k).

    ``pull`` (P,) and ``own_pull`` (W, k) are the gradients. Without free starts k is 0.
    """

    shared: np.ndarray
    cross: np.ndarray
    own: np.ndarray
    pull: np.ndarray
    own_pull: np.ndarray

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Solve with the diagonal raised by the share ``damping``: (P,) and (W, k)."""
        own = self.own + damping * _diagonal(self.own)
        eliminated = np.linalg.solve(own, self.cross.transpose(0, 2, 1))
        centre = self.shared + damping * _diagonal(self.shared)
        schur = centre - np.einsum("wpk,wkq->pq", self.cross, eliminated)
        alone = np.linalg.solve(own, self.own_pull[..., None])[..., 0]
        constants = np.linalg.solve(schur, self.pull - np.einsum("wpk,wk->p", self.cross, alone))
        return -constants, -(alone - eliminated @ constants)


def _diagonal(blocks: np.ndarray) -> np.ndarray:
    diagonal = np.einsum("...ii->...i", blocks)
    floor = ROUNDING * np.max(diagonal, axis=-1, keepdims=True, initial=1e-300)
    return np.maximum(diagonal, floor)[..., None] * np.eye(blocks.shape[-1])


@dataclass(frozen=True, eq=False)
class Shooting:
    """Residuals of a flow at the rows of all windows, in units of each state's ``spread``.

    Where a spread is inf nothing was measured: the residual is 0 and does not count.

    With ``free`` starts each window begins at a fitted state and is compared with its own first
    measurement too; otherwise it begins at that measurement. Where ``begun`` (k, W) is given, fits
    of the starts begin there. ``spread`` is (k,), or (m + 1, k, W)
    where each row has its own. ``width`` widens the unit of the weights: at 2.385 a Cauchy fit has
    95 % of the efficiency of least squares under Gaussian noise (Holland and Welsch 1977); at 1 it
    trusts the best half of the rows.
    """

    flow: Flow
    windows: Windows
    spread: np.ndarray
    free: bool
    pace: Pace = PLAIN
    width: float = 1.0
    begun: np.ndarray | None = None

    @property
    def starts(self) -> np.ndarray:
        """(k, W) where fits of the starts begin; at the first measurements by default."""
        return self.windows.x[0] if self.begun is None else self.begun

    def misses(self, constants: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """(rows, k, W) found minus measured; NaN where the flow diverges."""
        return self._compare(self._track(constants, starts).rows)

    def _track(self, constants: np.ndarray, starts: np.ndarray) -> Track:
        return self.flow.track(self.windows, starts, constants, self.pace)

    def _compare(self, found: np.ndarray) -> np.ndarray:
        return ((found - self.windows.x) / self._spreads())[0 if self.free else 1 :]

    def _spreads(self) -> np.ndarray:
        return self.spread[:, None] if self.spread.ndim == 1 else self.spread

    def linearise(
        self, constants: np.ndarray, starts: np.ndarray, track: Track | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Misses, their slopes by the constants (W, rows * k, P) and by the starts (.., k or 0).

        ``track`` is where the flow goes from there, when that is known.
        """
        found, sensitivity = self.flow.run_sensitive(
            self.windows, starts, constants, self.pace, track
        )
        slopes = (sensitivity / self._spreads()[..., None, :])[0 if self.free else 1 :]
        lanes = slopes.transpose(3, 0, 1, 2).reshape(starts.shape[1], -1, slopes.shape[2])
        count = len(constants)
        last = lanes.shape[2] if self.free else count
        return self._compare(found), lanes[..., :count], lanes[..., count:last]

    @cached_property
    def told(self) -> np.ndarray:
        """(rows, k, W) whether a state was measured, at the rows of the residuals."""
        there = np.broadcast_to(np.isfinite(self._spreads()), self.windows.x.shape)
        return there[0 if self.free else 1 :]

    @cached_property
    def counts(self) -> np.ndarray:
        """(k,) measurements of every state among the residuals."""
        return np.asarray(np.count_nonzero(self.told, axis=(0, 2)))

    def missed(self, misses: np.ndarray) -> np.ndarray:
        """Give misses (rows, k, W) in the units of the states; 0 where nothing was measured."""
        spread = np.broadcast_to(self._spreads(), self.windows.x.shape)[0 if self.free else 1 :]
        return misses * np.where(self.told, spread, 0.0)

    def sizes(self, misses: np.ndarray) -> np.ndarray:
        """(k,) robust size of the residuals where there are measurements."""
        if self.told.all():
            return robust_scale(misses, axis=(0, 2))
        pairs = zip(misses.swapaxes(0, 1), self.told.swapaxes(0, 1), strict=True)
        each = [own[told] for own, told in pairs]
        return np.array([robust_scale(own) if len(own) else 0.0 for own in each])

    def unit(self, misses: np.ndarray) -> np.ndarray:
        """(k,) unit of the weights: ``width`` robust sizes of the residuals, not below rounding."""
        return np.maximum(self.width * self.sizes(misses), ROUNDING)

    def minimise(
        self,
        constants: np.ndarray,
        starts: np.ndarray,
        loss: str,
        trials: float = np.inf,
        most: int = 25,
        gain: float = FIT.match_gain,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fit constants (P,) and starts (k, W), misses weighed in units of their present size.

        Ends after ``most`` steps or ``trials`` integrations of trial steps, or when a step lowers
        the loss by less than the share ``gain``, or than a thousandth where residuals are rounding.
        """
        track = self._track(constants, starts)
        misses = self._compare(track.rows)
        unit = self.unit(misses)[:, None]
        level, damping = _level(loss, misses / unit), DAMPED
        if np.max(unit) < _SOLVER:
            gain = max(gain, ROUGH)
        for _ in range(most):
            misses, by_constant, by_start = self.linearise(constants, starts, track)
            weights = _weigh(loss, (misses / unit) ** 2) / unit**2
            try:
                normal = _normal(_by_lane(misses), by_constant, by_start, _by_lane(weights))
            except FloatingPointError:
                break
            before = level
            while damping < 1e8 and trials > 0:
                trials -= 1
                trial = self._try(normal, damping, constants, starts)
                if trial is not None:
                    tried = self._track(*trial)
                    reached = _level(loss, self._compare(tried.rows) / unit)
                    if reached < level:
                        (constants, starts), track, level = trial, tried, reached
                        damping /= DAMPING
                        break
                damping *= DAMPING
            if not level < before * (1 - gain):
                break
        return constants, starts

    def _try(
        self, normal: Normal, damping: float, constants: np.ndarray, starts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        try:
            shared, own = normal.step(damping)
        except np.linalg.LinAlgError:
            return None
        if not self.free:
            return constants + shared, starts
        return constants + shared, starts + own.T

    def covariance(self, constants: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """(P, P) covariance of the constants by the sandwich A^-1 B A^-1 (Huber 1981, 6.3).

        With residuals z in units of their robust size, the score of the Cauchy loss is
        psi = z / (1 + z^2): B sums its squares over rows, and A = mean(psi') sum x x', with
        psi' = (1 - z^2) / (1 + z^2)^2 averaged over each state. Without free starts residuals of
        one window are correlated, and B takes the sum of a window for one row. With free starts
        each score is divided by 1 - h, h the share of a measurement in its own fit, and the whole
        is multiplied by how many rows count as one where residuals keep their sign longer than
        noise.
        """
        misses, by_constant, by_start = self.linearise(constants, starts)
        unit = self.unit(misses)[:, None]
        weights = _by_lane(cauchy_weights(misses, unit) / unit**2)
        flat = _by_lane(misses)
        normal = _normal(flat, by_constant, by_start, weights)
        if self.free:
            eliminated = np.linalg.solve(
                normal.own + ROUNDING * _diagonal(normal.own), normal.cross.transpose(0, 2, 1)
            )
            by_constant = by_constant - by_start @ eliminated
        # Columns of like size keep the pseudo-inverse from dropping a small constant.
        scale = np.sqrt(np.einsum("wrp,wr,wrp->p", by_constant, weights, by_constant))
        scale = np.maximum(scale, 1e-300)
        scaled = by_constant / scale
        square = (misses / unit) ** 2
        level = psi_slope(square, self.told, (0, 2))[:, None] / unit**2
        expected = _by_lane(np.broadcast_to(level, misses.shape))
        bread = np.linalg.pinv(np.einsum("wrp,wr,wrq->pq", scaled, expected, scaled))
        pulls = scaled * (weights * flat)[..., None]
        if self.free:
            # A row that the fit leans on misses less than its noise (HC3: MacKinnon, White 1985).
            own = np.linalg.pinv(normal.own)
            leaned = np.einsum("wrp,pq,wrq->wr", scaled, bread, scaled)
            leaned = leaned + np.einsum("wrk,wkl,wrl->wr", by_start, own, by_start) * (
                weights / np.maximum(expected, 1e-300)
            )
            share = np.clip(leaned * expected, 0.0, 0.9)
            pulls = pulls / (1 - share)[..., None]
        if not self.free and len(pulls) > len(constants):
            pulls = pulls.sum(axis=1, keepdims=True)
        rows = pulls.reshape(-1, pulls.shape[-1])
        inflated = self._inflation(misses) if self.free else 1.0
        found: np.ndarray = inflated * (bread @ (rows.T @ rows) @ bread) / np.outer(scale, scale)
        return found

    def _inflation(self, misses: np.ndarray) -> float:
        """Give the rows that count as one of the state whose residuals keep their sign longest."""
        if not self.told.all():
            # Signs are those of one measured row after another.
            return max(self._inflation_of(misses[:, [i]], i) for i in range(misses.shape[1]))
        each = misses.shape[0] * misses.shape[2]
        runs = independent_rows(misses)
        # White noise itself has fewer runs than n / 2 by chance, by sqrt(n) / 2 at one sigma.
        return float(np.max(each / np.minimum(runs + 2 * np.sqrt(each), each)))

    def _inflation_of(self, misses: np.ndarray, place: int) -> float:
        """Give the same of one state, of its measured rows."""
        lanes = [misses[own, 0, lane] for lane, own in enumerate(self.told[:, place].T)]
        each = sum(map(len, lanes))
        runs = sum(float(independent_rows(own[:, None, None])[0]) for own in lanes if len(own))
        return each / min(runs + 2 * math.sqrt(each), each) if each else 1.0


def _by_lane(values: np.ndarray) -> np.ndarray:
    """(rows, k, W) -> (W, rows * k)."""
    return values.transpose(2, 0, 1).reshape(values.shape[2], -1)


def _rho(loss: str, z: np.ndarray) -> np.ndarray:
    """Give a loss, "linear", "soft_l1" or "cauchy", of squared residuals in their units."""
    if loss == "linear":
        return z
    return np.log1p(z) if loss == "cauchy" else 2 * (np.sqrt(1 + z) - 1)


def _weigh(loss: str, z: np.ndarray) -> np.ndarray:
    """Give the derivative of a loss by the squared residuals: the weights of the rows."""
    if loss == "linear":
        return np.ones_like(z)
    return np.asarray(1 / (1 + z) if loss == "cauchy" else 1 / np.sqrt(1 + z))


def _level(loss: str, misses: np.ndarray) -> float:
    with np.errstate(all="ignore"):
        level = float(np.sum(_rho(loss, misses**2)))
    return level if np.isfinite(level) else np.inf


def psi_slope(square: np.ndarray, told: np.ndarray, axis: tuple[int, ...] | None) -> np.ndarray:
    """Mean slope of the score of the Cauchy loss at squared residuals of measured cells."""
    curved = (1 - square) / (1 + square) ** 2 * told
    mean = np.sum(curved, axis=axis) / np.maximum(np.count_nonzero(told, axis=axis), 1)
    # Below a tenth the residuals are no noise about a fit, and nothing is there to divide by.
    return np.asarray(np.maximum(mean, 0.1))


def _normal(
    misses: np.ndarray, by_constant: np.ndarray, by_start: np.ndarray, weights: np.ndarray
) -> Normal:
    """Build the normal equations; raises FloatingPointError where a slope is not finite."""
    weighted = by_constant * weights[..., None]
    own = by_start * weights[..., None]
    normal = Normal(
        np.tensordot(weighted, by_constant, axes=([0, 1], [0, 1])),
        weighted.transpose(0, 2, 1) @ by_start,
        own.transpose(0, 2, 1) @ by_start,
        np.einsum("wrp,wr->p", weighted, misses),
        np.einsum("wrk,wr->wk", own, misses),
    )
    if not (np.all(np.isfinite(normal.shared)) and np.all(np.isfinite(normal.own))):
        raise FloatingPointError
    return normal


@dataclass(frozen=True, eq=False)
class Match:
    """Equations whose constants fit the states.

    ``errors`` gives for every state its constants in order of appearance as (value, standard
    error); ``misses`` are those of the integrated states, window after window, in units of each
    state's spread, and ``loss`` is the median of their sizes; ``success`` says whether the fit
    could be done at all. ``fitted`` gives for every state, next to ``errors``, what each constant
    was before it became a simple number, and ``reach`` how many standard errors a 95 % interval
    around that reaches to either side.
    """

    exprs: dict[str, sympy.Expr]
    errors: dict[str, tuple[tuple[float, float], ...]]
    misses: np.ndarray
    success: bool
    fitted: dict[str, tuple[float, ...]] = field(default_factory=dict)
    reach: float = 1.96

    @property
    def loss(self) -> float:
        """Give the median size of the residuals; inf where there are none."""
        return float(np.median(np.abs(self.misses))) if len(self.misses) else np.inf

    @classmethod
    def untouched(cls, exprs: Mapping[str, sympy.Expr], success: bool = False) -> Match:
        """Equations as they came, without a fit."""
        return cls(dict(exprs), dict.fromkeys(exprs, ()), np.empty(0), success)


def match_trajectories(
    exprs: Mapping[str, sympy.Expr],
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    inputs: Mapping[str, sympy.Expr] | None = None,
    window: int | None = None,
    settings: FitSettings = FIT,
) -> Match:
    """Refine every float constant of ``exprs`` so that the integrated states fit the data.

    Parameters
    ----------
    exprs : state -> right-hand side in the states, the inputs and ``t``. States without one are
        read from the data like inputs.
    trajectories : one or many, of the same columns.
    inputs : input name -> expression in ``t``, where it is known; other inputs are interpolated.
    window : intervals a window; by default 10 for clean data, and for noisy data, where the start
        of each window is fitted too, a tenth of the longest trajectory but 20 to 100.
    settings : losses, windows, gain and trials of the fit.

    Integers and rationals are structure and stay. Raises InputError when a state is unknown.

    >>> t = np.linspace(0, 1, 51)
    >>> decay = Trajectory(t, np.exp(-2 * t)[:, None], ("x",))
    >>> match = match_trajectories({"x": sympy.Float(-1.9) * sympy.Symbol("x")}, decay)
    >>> round(match.errors["x"][0][0], 6)
    -2.0
    """
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    flow, values, owners = prepare(exprs, runs, inputs or {})
    if min(map(len, runs)) < 3:
        return Match.untouched(exprs, success=not len(values))
    shooting = _usual_shooting(flow, runs, inputs or {}, settings, window)
    fitted = _fit(shooting, np.array(values), settings)
    return Match.untouched(exprs) if fitted is None else _match(flow, owners, *fitted)


def _usual_shooting(
    flow: Flow,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings,
    window: int | None = None,
) -> Shooting:
    """Cut runs into the windows that clean data, or noisy ones, ask for."""
    free = is_noisy(runs)
    usual = first_length(max(map(len, runs))) if free else INTERVALS
    return build_shooting(flow, runs, inputs, window or usual, free, settings)


def first_length(length: int) -> int:
    """Give the intervals of the windows with fitted starts that are tried first."""
    return min(100, max(20, length // 10))


def build_shooting(
    flow: Flow,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    length: int,
    free: bool,
    settings: FitSettings = FIT,
) -> Shooting:
    """Cut the runs into windows of ``length`` intervals, starts ``free`` or measured.

    Residuals are in units of each state's spread.
    """
    runs = carry(runs)
    columns = [runs[0].index(state) for state in flow.rhs]
    spread = np.maximum(spread_of(runs)[columns], 1e-300)
    drives, times = drives_of(flow.driven, runs, inputs), [run.t for run in runs]
    x, most = [run.x[:, columns] for run in runs], settings.match_windows
    windows = cut_windows(times, x, drives, length, most)
    if any(run.unmeasured.size for run in runs):
        whole = noise_and_spread(runs)[1]
        own = [np.where(run.measured, whole, np.inf)[:, columns] for run in runs]
        spread = np.maximum(
            cut_windows(times, own, drives, length, most).x, ROUNDING * spread[:, None]
        )
    return Shooting(flow, windows, spread, free, width=settings.noisy_width if free else 1.0)


def measure_errors(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings = FIT,
) -> dict[str, tuple[tuple[float, float], ...]]:
    """Give (value, standard error) of every float of equations that stay as they are.

    The errors are those which the constants would have if they were fitted, so also a constant
    that was made a simple number has one; inf where the data do not determine it.

    >>> t = np.linspace(0, 1, 51)
    >>> x = np.exp(-2 * t) + 1e-3 * np.cos(40 * t)
    >>> decay = Trajectory(t, x[:, None], ("x",))
    >>> measure_errors({"x": sympy.Float(-2.0) * sympy.Symbol("x")}, [decay], {})["x"][0][0]
    -2.0
    """
    flow, values, owners = prepare(exprs, runs, inputs)
    spread = measure_covariance(flow, values, runs, inputs, settings)
    errors = np.sqrt(np.maximum(np.diag(spread), 0))
    pairs = list(zip(owners, values, errors.tolist(), strict=True))
    return {s: tuple((v, e) for owner, v, e in pairs if owner == s) for s in exprs}


def measure_covariance(
    flow: Flow,
    values: Sequence[float],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings = FIT,
) -> np.ndarray:
    """Give the covariance (P, P) that the constants of a flow would have if they were fitted.

    Parameters
    ----------
    flow : the equations with their P constants as symbols, which may be in several places.
    values : (P,) of the constants.
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t``, where it is known.
    settings : the numbers that decide.

    Infinite where the data do not determine it.

    >>> t = np.linspace(0, 1, 51)
    >>> decay = Trajectory(t, np.exp(-2 * t)[:, None] + 1e-3 * np.cos(40 * t)[:, None], ("x",))
    >>> x, k = sympy.symbols("x k")
    >>> spread = measure_covariance(Flow({"x": -k * x}, (), (k,)), [2.0], [decay], {})
    >>> bool(0 < spread[0, 0] < 0.01)
    True
    """
    if not len(values) or min(map(len, runs)) < 3:
        return np.full((len(values),) * 2, np.inf)
    shooting = _usual_shooting(flow, runs, inputs, settings)
    fixed = replace(shooting, flow=flow.closed(values))
    with np.errstate(all="ignore"):
        starts = shooting.windows.x[0]
        fixed = replace(
            fixed, pace=choose_pace(fixed, np.empty(0), starts, settings.match_substeps)
        )
        _, starts = fit_loss(fixed, np.empty(0), starts, settings)
        return _covariance(replace(shooting, pace=fixed.pace), np.array(values), starts)


def fitted_values(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings = FIT,
) -> dict[str, tuple[float, ...]]:
    """Give what every float of fitted equations becomes when all are fitted to the states again.

    In the order of :func:`measure_errors`; the values themselves where no fit can be done. They are
    near already, so that the last loss is enough.

    >>> t = np.linspace(0, 1, 51)
    >>> decay = Trajectory(t, np.exp(-2 * t)[:, None], ("x",))
    >>> round(fitted_values({"x": sympy.Float(-1.9) * sympy.Symbol("x")}, [decay], {})["x"][0], 6)
    -2.0
    """
    flow, values, owners = prepare(exprs, runs, inputs)
    if len(values) and min(map(len, runs)) >= 3:
        shooting = _usual_shooting(flow, runs, inputs, settings)
        near = replace(settings, match_losses=settings.match_losses[-1:])
        fitted = _fit(shooting, np.array(values), near)
        values = values if fitted is None else fitted[0].tolist()
    pairs = list(zip(owners, values, strict=True))
    return {s: tuple(value for owner, value in pairs if owner == s) for s in exprs}


def read_inputs(
    exprs: Mapping[str, str | sympy.Expr], names: Sequence[str]
) -> dict[str, sympy.Expr]:
    """Read expressions in ``names``, one a key; raises InputError where one cannot be read."""
    return {key: parse(expr, names) for key, expr in exprs.items()}


def prepare(
    exprs: Mapping[str, sympy.Expr], runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr]
) -> tuple[Flow, list[float], list[str]]:
    """Give the flow, its constants' values and the states that own these; raises InputError."""
    if not runs or any(run.names != runs[0].names for run in runs):
        raise InputError("the trajectories have different columns; give all the same columns")
    rhs: dict[str, sympy.Expr] = {}
    constants: list[sympy.Symbol] = []
    values: list[float] = []
    owners: list[str] = []
    for state, expr in exprs.items():
        runs[0].index(state)
        # The space keeps these names apart from any name of a column.
        template, found = free_constants(expr, f"constant {state} ")
        rhs[state] = template
        constants += found
        values += found.values()
        owners += [state] * len(found)
    others = [n for n in (*runs[0].names, *inputs) if n not in rhs]
    used = {str(s) for expr in rhs.values() for s in expr.free_symbols}
    driven = tuple(dict.fromkeys(n for n in others if n in used))
    return Flow(rhs, driven, tuple(constants)), values, owners


@dataclass(frozen=True, eq=False)
class Driven:
    """The driven columns of a run, and the time as the last one, as functions of the time.

    Parameters
    ----------
    names : the d columns.
    exact : those that are known as expressions in ``t``, by name.
    drives : the others, as they were measured.
    """

    names: tuple[str, ...]
    exact: Mapping[str, sympy.Expr]
    drives: tuple[Drive, ...]

    @cached_property
    def _known(self) -> Callable[[np.ndarray], np.ndarray]:
        return compile_numpy([self.exact[name] for name in self.exact], ["t"])

    @cached_property
    def jumps(self) -> np.ndarray:
        """Times, increasing, at which a column changes its value at once."""
        return jumps_of(self.drives)

    def __call__(self, t: np.ndarray, before: bool = False) -> np.ndarray:
        """Give the columns (d + 1, n) at n times; ``before`` a jump, or after it."""
        rows = dict(zip(self.exact, self._known(t[None]), strict=True))
        rows |= {drive.name: drive.at(t, before) for drive in self.drives}
        return np.array([*(rows[name] for name in self.names), t])


def drives_of(
    driven: Sequence[str], runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr]
) -> list[Driven]:
    """Give for every trajectory its driven columns and the time, (d + 1, n), at any n times.

    A column without an expression goes from row to row as the trajectory says.
    """
    exact = {name: inputs[name] for name in driven if name in inputs}
    return [
        Driven(
            tuple(driven),
            exact,
            tuple(
                Drive.through(name, run.t, run.columns[:, run.names.index(name)], run.held(name))
                for name in driven
                if name not in exact
            ),
        )
        for run in runs
    ]


def _fit(
    shooting: Shooting, constants: np.ndarray, settings: FitSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Give the constants, their errors and the residuals; None when the start diverges."""
    starts = shooting.windows.x[0]
    with np.errstate(all="ignore"):
        pace = choose_pace(shooting, constants, starts, settings.match_substeps)
        shooting = replace(shooting, pace=pace)
        if not np.all(np.isfinite(shooting.unit(shooting.misses(constants, starts)))):
            return None
        constants, starts = fit_loss(shooting, constants, starts, settings)
        # Along time, so that signs that stay show correlated errors.
        misses = shooting.misses(constants, starts).transpose(2, 1, 0).ravel()
        misses = misses[shooting.told.transpose(2, 1, 0).ravel()]
        variance = np.diag(_covariance(shooting, constants, starts))
        return constants, np.sqrt(np.maximum(variance, 0)), misses


def fit_loss(
    shooting: Shooting, constants: np.ndarray, starts: np.ndarray, settings: FitSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Fit constants (P,) and starts (k, W), each loss from where the one before ended."""
    for loss in settings.match_losses if len(constants) or shooting.free else ():
        constants, starts = shooting.minimise(
            constants, starts, loss, settings.match_trials, gain=settings.match_gain
        )
    return constants, starts


def _covariance(shooting: Shooting, constants: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Give the covariance (P, P) of the constants, infinite where the data do not determine it."""
    unknown = np.full((len(constants),) * 2, np.inf)
    if not len(constants):
        return unknown
    try:
        found = shooting.covariance(constants, starts)
    except (np.linalg.LinAlgError, FloatingPointError):
        return unknown
    return np.where(np.isfinite(found), found, np.inf)


def choose_pace(
    shooting: Shooting, constants: np.ndarray, starts: np.ndarray, most: int = FIT.match_substeps
) -> Pace:
    """Take finer steps until that moves the states less than rounding or than their residuals.

    Stiff systems begin with steps short enough to be stable, of which an interval has 64 at most.
    """
    stable = shooting.flow.stiffness(shooting.windows, constants) / STABLE
    first = 2 ** min(max(math.ceil(math.log2(max(stable, 1.0))), 0), _MOST_HALVINGS)
    pace = Pace(first)
    coarse = replace(shooting, pace=pace).misses(constants, starts)
    for finer in finer_paces(first, max(most, first)):
        fine = replace(shooting, pace=finer).misses(constants, starts)
        moved = np.nanmax(np.abs(fine - coarse), initial=0.0)
        if moved < _SOLVER or moved < STEP_ERROR * np.nanmedian(np.abs(fine)):
            return pace
        coarse, pace = fine, finer
    return pace


def finer_paces(first: int, most: int) -> list[Pace]:
    """Give what may follow ``first`` steps of order 4: twice as many, then up to ``most`` of 8.

    One step of order 8 is closer than four of order 4, and costs less.
    """
    found = [Pace(2 * first), Pace(max(1, first // 2), True)]
    while found[-1].substeps < most:
        found.append(Pace(2 * found[-1].substeps, True))
    return found


def _match(
    flow: Flow, owners: Sequence[str], values: np.ndarray, errors: np.ndarray, misses: np.ndarray
) -> Match:
    exprs = dict(flow.closed(values).rhs)
    pairs = list(zip(owners, values.tolist(), errors.tolist(), strict=True))
    ordered = {
        state: _in_order(expr, {v: e for owner, v, e in pairs if owner == state})
        for state, expr in exprs.items()
    }
    return Match(exprs, ordered, misses, True)


def _in_order(expr: sympy.Expr, errors: Mapping[float, float]) -> tuple[tuple[float, float], ...]:
    """Pair constants with their errors as they now appear: SymPy sorts terms by their numbers."""
    _, found = free_constants(expr, "constant ")
    return tuple((value, errors.get(value, np.inf)) for value in found.values())
