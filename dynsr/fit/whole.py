"""Whole runs: constants fitted to noisy states over windows as long as the system can be followed.

A window whose start is fitted says less about the constants the shorter it is: half of what it
measures goes into the start. So windows grow, from where the shorter ones ended, while the
residuals stay those of noise (a chaotic system ends this early). Once the system follows the data,
its own residuals show how noise grows with the states, and rows are weighed by that (generalised
least squares with an estimated variance function; Carroll and Ruppert 1988, chapter 2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy
from scipy.special import stdtrit

from dynsr.data import Trajectory, robust_scale, scale_error
from dynsr.fit.settings import FIT, FitSettings
from dynsr.fit.shooting import (
    STEP_ERROR,
    Shooting,
    build_shooting,
    choose_pace,
    first_length,
    fit_loss,
    prepare,
    psi_slope,
)

# Rows a step of the integration, longest first, that are tried on noisy data.
_STRIDES = (8, 4, 2, 1)
# Noise at a state's root mean square over noise at 0, relative and absolute noise in turn.
_RATIOS = (0.3, 1.0, 3.0, 10.0, 100.0)


@dataclass(frozen=True, eq=False)
class StatesFit:
    """Constants fitted to whole noisy runs.

    Parameters
    ----------
    shooting : the problem over its longest windows, at the weights of the last fit.
    constants : (P,) fitted values, in the order of the flow's symbols.
    starts : (k, W) fitted starts.
    misses : (rows, k, W) in units of the noise.
    covariance : (P, P) of the constants.
    """

    shooting: Shooting
    constants: np.ndarray
    starts: np.ndarray
    misses: np.ndarray
    covariance: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """(P,) standard errors."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0))

    @property
    def sizes(self) -> np.ndarray:
        """(k,) robust size of the residuals of every state, in state units."""
        return self.shooting.sizes(self.shooting.missed(self.misses))

    @property
    def freedom(self) -> int:
        """Measurements less the constants and starts that were fitted to them, 1 at least."""
        measured = int(np.sum(self.shooting.counts))
        return max(measured - len(self.constants) - self.starts.size, 1)

    def put(self, numbers: Sequence[sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give the equations with P numbers in the places of the constants."""
        given = dict(zip(self.shooting.flow.constants, numbers, strict=True))
        return {state: expr.xreplace(given) for state, expr in self.shooting.flow.rhs.items()}

    def ratio(self, other: Any) -> float:
        """Likelihood ratio statistic of a nested fit ``other`` at the same weights.

        Twice the difference of the losses, times mean(psi') / mean(psi^2) so that it is
        chi-squared also for a robust loss (Hampel et al. 1986, 7.3).
        """
        unit = self.shooting.unit(self.misses)[:, None]
        mine, theirs = self.misses / unit, other.misses / unit
        if mine.shape != theirs.shape or not np.all(np.isfinite(theirs)):
            return math.inf
        square = mine**2
        told = self.shooting.told
        curvature = float(psi_slope(square, told, None))
        score = float(np.mean(square / (1 + square) ** 2, where=told))
        lost = float(np.sum(np.log1p(theirs**2)) - np.sum(np.log1p(square)))
        if score == 0:
            return math.inf if lost > 0 else 0.0
        return lost * curvature / score


def interval_reach(freedom: float, level: float = 0.95) -> float:
    """Standard errors that an interval of ``level`` reaches to either side (Student's t).

    ``freedom`` are the measurements less what was fitted to them.

    >>> round(interval_reach(10), 3), round(interval_reach(1e9), 3)
    (2.228, 1.96)
    """
    return float(stdtrit(freedom, (1 + level) / 2))


def fit_states(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: FitSettings = FIT,
    near: StatesFit | None = None,
) -> StatesFit | None:
    """Fit every float of ``exprs`` to the noisy states; None where these cannot be followed.

    Parameters
    ----------
    exprs : state -> right-hand side.
    runs : trajectories of the same columns, three rows each at least.
    inputs : input name -> expression in ``t``, where it is known.
    settings : losses, windows and trials.
    near : a fit of similar equations, whose windows, weights and starts are taken over.
    """
    flow, values, _ = prepare(exprs, runs, inputs)
    if min(map(len, runs)) < 3:
        return None
    constants, last = np.array(values, dtype=float), _last(settings)
    if near is not None:
        # A column that only the other equations read still stands in their windows.
        taken = near.shooting.flow
        flow = replace(flow, driven=taken.driven, stride=taken.stride)
        begun = _Descent(replace(near.shooting, flow=flow), constants, near.starts)
        return _end(begun.fitted(last))
    longest = max(map(len, runs)) - 1
    best: _Descent | None = None
    for length in _lengths(first_length(longest), min(longest, settings.match_longest)):
        longer = build_shooting(flow, runs, inputs, length, True, settings)
        if best is None:
            trial = _Descent(longer, constants, longer.windows.x[0])
        else:
            trial = _Descent(longer, best.constants, best.starts_of(longer))
            if not best.reaches(trial, settings):
                break
        fitted = trial.in_steps(settings).fitted(settings if best is None else last)
        if fitted is None or (best is not None and best.is_below(fitted, settings)):
            break
        best = fitted
    if best is None:
        return None
    weighed = best.weighed()
    return _end(best if weighed is best else weighed.fitted(last))


def _last(settings: FitSettings) -> FitSettings:
    """Give the settings of a fit that begins near its end: the last loss alone."""
    return replace(settings, match_losses=settings.match_losses[-1:])


@dataclass(frozen=True, eq=False)
class _Descent:
    """Constants and starts of windows, on the way to the best ones.

    Parameters
    ----------
    shooting : the residuals over the windows.
    constants, starts : (P,) and (k, W) so far.
    """

    shooting: Shooting
    constants: np.ndarray
    starts: np.ndarray

    @property
    def misses(self) -> np.ndarray:
        """(rows, k, W) residuals."""
        return self.shooting.misses(self.constants, self.starts)

    def reaches(self, longer: _Descent, settings: FitSettings) -> bool:
        """Say whether longer windows begin with residuals that a descent can bring down.

        Where errors grow so much within a window, as in chaos, its residuals have a minimum at
        every turn, and a descent of hundreds of steps would end in one of them.
        """
        with np.errstate(all="ignore"):
            now = _large(self.shooting, self.misses)
            flow = replace(longer.shooting.flow, stride=self.shooting.flow.stride)
            at = replace(longer.shooting, flow=flow, pace=self.shooting.pace)
            then = _large(at, at.misses(self.constants, longer.starts))
        return bool(np.all(then <= settings.match_reach * now))

    def in_steps(self, settings: FitSettings) -> _Descent:
        """Take the longest step of the integration that moves states less than their residuals."""
        shooting, at = self.shooting, (self.constants, self.starts)
        steps = np.diff(shooting.windows.t, axis=0)
        even = np.ptp(steps) <= 1e-6 * np.mean(steps) and not shooting.windows.jumps
        strides = _STRIDES if even else (1,)
        with np.errstate(all="ignore"):
            trials = [replace(shooting, flow=replace(shooting.flow, stride=s)) for s in strides]
            longer, misses = trials[0], trials[0].misses(*at)
            for shorter in trials[1:]:
                finer = shorter.misses(*at)
                moved, size = np.max(np.abs(finer - misses)), np.median(np.abs(finer))
                if moved < STEP_ERROR * size:
                    return replace(self, shooting=longer)
                longer, misses = shorter, finer
            pace = choose_pace(longer, *at, settings.match_substeps)
        return replace(self, shooting=replace(longer, pace=pace))

    def fitted(self, settings: FitSettings) -> _Descent | None:
        """Fit constants and starts; None where the first or the last integration diverges."""
        with np.errstate(all="ignore"):
            if not np.all(np.isfinite(self.shooting.unit(self.misses))):
                return None
            constants, starts = fit_loss(self.shooting, self.constants, self.starts, settings)
            found = _Descent(self.shooting, constants, starts)
            return found if np.all(np.isfinite(found.misses)) else None

    def starts_of(self, longer: Shooting) -> np.ndarray:
        """Give starts of longer windows, (k, W), from the states that these windows came to."""
        windows, found = self.shooting.windows, self._run()
        known = {
            (float(windows.t[row, lane]), *windows.x[row, :, lane].tolist()): found[row, :, lane]
            for lane in range(windows.t.shape[1])
            for row in range(len(windows.t))
        }
        own = longer.windows
        begin = own.x[0].copy()
        for lane in range(own.t.shape[1]):
            key = (float(own.t[0, lane]), *own.x[0, :, lane].tolist())
            if key in known and np.all(np.isfinite(known[key])):
                begin[:, lane] = known[key]
        return begin

    def _run(self) -> np.ndarray:
        """(rows + 1, k, W) the states."""
        shooting = self.shooting
        with np.errstate(all="ignore"):
            return shooting.flow.run(shooting.windows, self.starts, self.constants, shooting.pace)

    def is_below(self, longer: _Descent, settings: FitSettings) -> bool:
        """Say whether a state's misses over longer windows are clearly larger than here."""
        sizes = []
        for one in (self, longer):
            misses, count = one.misses, np.maximum(one.shooting.counts, 1)
            # Each start takes the misses that it is fitted to.
            own = len(one.constants) / misses.shape[1]
            left = np.maximum(count - misses.shape[2] - own, 1)
            sizes.append(one.shooting.sizes(misses) * np.sqrt(count / left))
        chance = 1 + 2 * scale_error(count)
        return bool(np.any(sizes[1] > np.maximum(settings.match_follows, chance) * sizes[0]))

    def weighed(self) -> _Descent:
        """Give each row its own deviation, sqrt(a^2 + (b x)^2) of each state, where misses show b.

        The likelihood of the residuals decides, by 2 nats at least: one more number for a state.
        """
        found, misses = self._run(), self.misses
        spread, told = self.shooting.spread, self.shooting.told
        own = spread[None, :, None] if spread.ndim == 1 else spread
        own = np.broadcast_to(own, found.shape).copy()
        changed = False
        for j in range(found.shape[1]):
            share = (found[:, j] / math.sqrt(float(np.mean(found[:, j] ** 2)) or 1.0)) ** 2
            shapes = [np.ones_like(share), *(1 + ratio**2 * share for ratio in _RATIOS)]
            mine = told[:, j]
            fits = [_variance(misses[:, j][mine], shape[mine]) for shape in shapes]
            best = min(range(len(fits)), key=lambda i: fits[i][0])
            if fits[best][0] < fits[0][0] - 2:
                size = math.sqrt(fits[best][1])
                own[:, j] *= size * np.sqrt(shapes[best])
                changed = True
            else:
                own[:, j] *= math.sqrt(fits[0][1])
        return replace(self, shooting=replace(self.shooting, spread=own)) if changed else self


def _large(shooting: Shooting, misses: np.ndarray) -> np.ndarray:
    """(k,) size that a tenth of the residuals exceed: errors grow towards the end of a window."""
    sizes = zip(np.abs(misses).swapaxes(0, 1), shooting.told.swapaxes(0, 1), strict=True)
    return np.array([np.quantile(own[told], 0.9) if told.any() else 0.0 for own, told in sizes])


def _lengths(first: int, longest: int) -> list[int]:
    """Give window lengths from ``first`` to ``longest`` intervals, each three times the last."""
    found = [min(first, longest)]
    while found[-1] < longest:
        found.append(longest if 3 * found[-1] > longest / 1.5 else 3 * found[-1])
    return found


def _variance(misses: np.ndarray, shape: np.ndarray) -> tuple[float, float]:
    """Negative log likelihood of residuals whose variance has this shape, and its robust factor."""
    square = misses**2 / shape
    factor = max(float(robust_scale(np.sqrt(square))) ** 2, 1e-300)
    # Few wild rows must not look like noise that grows.
    capped = np.minimum(square / factor, 9.0)
    return float(np.sum(capped + np.log(factor * shape))) / 2, factor


def _end(found: _Descent | None) -> StatesFit | None:
    if found is None:
        return None
    shooting, constants, starts = found.shooting, found.constants, found.starts
    with np.errstate(all="ignore"):
        misses, covariance = found.misses, np.zeros((0, 0))
        if len(constants):
            try:
                covariance = shooting.covariance(constants, starts)
            except (np.linalg.LinAlgError, FloatingPointError):
                covariance = np.full((len(constants),) * 2, np.inf)
    covariance = np.where(np.isfinite(covariance), covariance, np.inf)
    return StatesFit(shooting, constants, starts, misses, covariance)
