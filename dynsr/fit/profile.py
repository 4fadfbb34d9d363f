"""Profile likelihood: what the data say of one constant when all others are fitted again.

The constant is fixed at one value after the other; the other constants and the states of the joint
fit (:mod:`dynsr.fit.collocation`) are fitted again at each. How far the sum of squares rises bounds
the constant (Raue et al. 2009, Bioinformatics 25, 1923): the interval ends where the rise over the
estimated variance of the residuals passes the square of Student's quantile, and where it never does
the data leave that side open. Near a fit whose sum of squares is a parabola this is Wald's interval
from the standard error; elsewhere that one is wrong and this one is not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

from dynsr.fit.collocation import AlongFit, Collocation, covariance_of
from dynsr.fit.whole import interval_reach


@dataclass(frozen=True)
class ProfileSettings:
    """The numbers that decide a profile likelihood; they are kept in a discovery's record.

    Parameters
    ----------
    level : of the intervals.
    points : fits from the best value to the end of the interval where the profile is a parabola.
    beyond : the profile goes on until it rises so many times as high as the interval ends.
    farthest : a side is open where the interval has not ended so many times the constant, or so
        many of its standard errors, away.
    first : step, as a share of the constant, where its standard error is no guide.
    most : fits of one side.
    halvings : times that a step is halved at most where the profile rises too steeply or the
        system cannot be fitted.
    growth : factor by which a step grows at most.
    sharp : share of the rise at the end of an interval within which the end is found.
    better : rise below which a profile has found a better fit than the one it began at.
    restarts : times that it then begins again.
    parabola : factor within which the rises at the ends of Wald's interval must be what they are on
        a parabola for that interval to be kept; otherwise the profile gives the interval.
    hidden : share of an error that hides the error of the rule.
    finest : times as many steps between rows, at most, with which the rule is tested.
    """

    level: float = 0.95
    points: int = 6
    beyond: float = 1.3
    farthest: float = 100.0
    first: float = 0.1
    most: int = 60
    halvings: int = 12
    growth: float = 4.0
    sharp: float = 0.02
    better: float = 0.02
    restarts: int = 3
    parabola: float = 1.3
    hidden: float = 0.1
    finest: int = 8


PROFILE: ProfileSettings = ProfileSettings()


@dataclass(frozen=True, eq=False)
class Held:
    """A fit with one constant fixed.

    Parameters
    ----------
    value : at which it is fixed.
    rise : of the sum of squares above the best fit, in units of the variance of the residuals.
    constants : (P,) all constants.
    states : (k, n) the trajectory.
    """

    value: float
    rise: float
    constants: np.ndarray = field(repr=False)
    states: np.ndarray = field(repr=False)


@dataclass(frozen=True, eq=False)
class Rises:
    """The profile of one constant.

    Parameters
    ----------
    held : the fits, by the value of the constant.
    best : the fit in which nothing is fixed.
    low, high : the ends of the interval; None where the data leave that side open.
    limit : the rise at which the interval ends.
    """

    held: tuple[Held, ...]
    best: Held
    low: float | None
    high: float | None
    limit: float


@dataclass(frozen=True, eq=False)
class Profiling:
    """Profiles of the parameters of one fitted system.

    Parameters
    ----------
    problem : the least-squares problem.
    ways : (P, Q) how each of P constants goes with each of Q parameters: the identity, or one
        column for constants that are one, 1 or -1 at each of them.
    best : the fit in which nothing is fixed, with a rise of 0.
    errors : (Q,) standard errors there.
    cost : the sum of squares there.
    scale : variance of the residuals in units of the noise that was given.
    freedom : measurements less what was fitted to them.
    settings : the numbers that decide.
    """

    problem: Collocation
    ways: np.ndarray
    best: Held
    errors: np.ndarray
    cost: float
    scale: float
    freedom: float
    settings: ProfileSettings = PROFILE

    @classmethod
    def of(cls, fit: AlongFit, settings: ProfileSettings = PROFILE) -> Profiling:
        """Begin at a fit.

        Parameters
        ----------
        fit : constants fitted along whole runs.
        settings : the numbers that decide.
        """
        states = np.ascontiguousarray(fit.found.states.T)
        best = Held(math.nan, 0.0, fit.constants, states)
        cost = fit.problem.cost(states, fit.constants)
        ways = np.eye(len(fit.constants))
        return cls(fit.problem, ways, best, fit.errors, cost, fit.scale, fit.freedom, settings)

    def at_rest(self, again: bool = True) -> Profiling | None:
        """Begin where no better fit is near; None where the fit does not come to rest.

        Only there a rise says how far a parameter may be off.

        Parameters
        ----------
        again : whether a better fit is taken, once.
        """
        lower = self._begin_again(self.best)
        if lower.cost < self.cost - self.settings.better * self.limit * self.scale:
            return lower.at_rest(again=False) if again else None
        return self

    def tied(self, ways: np.ndarray) -> Profiling:
        """Give the profiles of parameters that several constants may share.

        Parameters
        ----------
        ways : (P, Q) how each constant goes with each parameter.

        Raises LinAlgError where the data do not determine it.
        """
        constants = ways @ (np.linalg.pinv(ways) @ self.best.constants)
        moved = self.problem.fit_free(self.best.states, constants, ways)
        states, constants, cost = moved or (self.best.states, constants, math.inf)
        information = self.problem.normal(states.T, constants).information
        covariance = covariance_of(ways.T @ information @ ways)
        errors = np.sqrt(np.diag(covariance) * self.scale)
        best = Held(math.nan, 0.0, constants, states)
        freedom = self.freedom + ways.shape[0] - ways.shape[1]
        return replace(self, ways=ways, best=best, errors=errors, cost=cost, freedom=freedom)

    def relative_spread(self, values: np.ndarray, some: Sequence[int]) -> np.ndarray:
        """(S, S) covariance of the logarithms of some parameters; huge where undetermined.

        Parameters
        ----------
        values : (Q,) sizes of all parameters.
        some : their places.
        """
        best = self.best
        information = self.problem.normal(best.states.T, best.constants).information
        own = self.ways.T @ information @ self.ways * np.outer(values, values) / self.scale
        sizes, directions = np.linalg.eigh(own)
        # What is smaller than rounding is no information.
        sizes = np.maximum(sizes, np.finfo(float).eps * sizes.max(initial=0.0))
        spread: np.ndarray = (directions / sizes) @ directions.T
        return spread[np.ix_(some, some)]

    @cached_property
    def values(self) -> np.ndarray:
        """(Q,) the best values of the parameters."""
        return self._values(self.best.constants)

    def _values(self, constants: np.ndarray) -> np.ndarray:
        found: np.ndarray = np.linalg.pinv(self.ways) @ constants
        return found

    @cached_property
    def reach(self) -> float:
        """Standard errors that Wald's interval reaches to either side."""
        return interval_reach(self.freedom, self.settings.level)

    @property
    def limit(self) -> float:
        """The rise at which an interval ends."""
        return self.reach**2

    def hold(self, index: int, value: float, near: Held) -> Held | None:
        """Fix one parameter and fit the rest again; None where the system cannot be fitted there.

        Parameters
        ----------
        index : its place.
        value : at which it is fixed.
        near : the fit that is the start.
        """
        step = value - self._values(near.constants)[index]
        constants = near.constants + step * self.ways[:, index]
        free = np.delete(self.ways, index, axis=1)
        moved = self.problem.fit_free(near.states, constants, free)
        if moved is None:
            return None
        states, constants, cost = moved
        return Held(value, (cost - self.cost) / self.scale, constants, states)

    def is_parabola(self, index: int) -> bool:
        """Whether the rises at both ends of Wald's interval are about what they are on a parabola.

        Parameters
        ----------
        index : the place of the parameter.
        """
        error = self.errors[index]
        if not math.isfinite(error):
            return False
        most = self.settings.parabola
        for sign in (-1, 1):
            value = self.values[index] + sign * self.reach * error
            end = self.hold(index, value, self.best)
            if end is None or not self.limit / most <= end.rise <= self.limit * most:
                return False
        return True

    def profile(self, index: int) -> Rises:
        """Give the profile of one parameter.

        Parameters
        ----------
        index : its place.
        """
        own, settings = self, self.settings
        for _ in range(settings.restarts):
            found = own._both_sides(index)
            lowest = min(found.held, key=lambda held: held.rise)
            if lowest.rise >= -settings.better * own.limit:
                break
            own = own._begin_again(lowest)
        return found

    def _begin_again(self, near: Held) -> Profiling:
        """Begin at the better fit that a profile came past."""
        moved = self.problem.fit_free(near.states, near.constants, self.ways)
        states, constants, cost = moved or (near.states, near.constants, math.inf)
        cost = min(cost, self.cost + near.rise * self.scale)
        return replace(self, best=Held(math.nan, 0.0, constants, states), cost=cost)

    def _both_sides(self, index: int) -> Rises:
        value = float(self.values[index])
        best = Held(value, 0.0, self.best.constants, self.best.states)
        (below, low), (above, high) = (self._side(index, best, sign) for sign in (-1, 1))
        held = sorted([*below, best, *above], key=lambda point: point.value)
        return Rises(tuple(held), best, low, high, self.limit)

    def _side(self, index: int, best: Held, sign: int) -> tuple[list[Held], float | None]:
        """Give the fits on one side of the best value, and the end of the interval there."""
        settings, at, points = self.settings, best, list[Held]()
        size, error = abs(best.value), float(self.errors[index])
        told = math.isfinite(error) and error < settings.farthest * max(size, 1e-300)
        aim = self.reach / settings.points
        step = aim * error if told else settings.first * (size or 1.0)
        far = settings.farthest * max(size, error if told else 0.0, step)
        halved = 0
        while len(points) < settings.most and abs(at.value - best.value) < far:
            point = self.hold(index, at.value + sign * step, at)
            more = math.inf if point is None else _root(point) - _root(at)
            if (point is None or more > 2 * aim) and halved < settings.halvings:
                step, halved = step / 2, halved + 1
                continue
            if point is None:
                # Here the system ends: nothing beyond fits the data at all.
                return points, at.value
            points.append(point)
            if point.rise > self.limit * settings.beyond:
                break
            at, halved = point, 0
            step *= min(settings.growth, aim / max(more, aim / settings.growth))
        return points, self._end(index, [best, *points])

    def _end(self, index: int, points: Sequence[Held]) -> float | None:
        """Find where the profile passes the limit; None where it does not."""
        after = next((i for i, point in enumerate(points) if point.rise > self.limit), None)
        if after is None:
            return None
        inner, outer = points[after - 1], points[after]
        top = _root(outer)

        def above(value: float) -> float:
            point = self.hold(index, value, inner)
            return (top if point is None else _root(point)) - self.reach

        if above(outer.value) <= 0:
            return outer.value
        gap = abs(outer.value - inner.value)
        end, _ = brentq(
            above,
            inner.value,
            outer.value,
            xtol=self.settings.sharp * gap,
            full_output=True,
            disp=False,
        )
        return float(end)


def _root(point: Held) -> float:
    """Root of a rise: straight along a parabola."""
    return math.sqrt(max(point.rise, 0.0))
