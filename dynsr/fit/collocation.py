"""Collocation: a whole system fitted to the measured states without a march through time.

The states at every row and the constants are unknowns of one least-squares problem: squared
residuals in units of the noise, plus the squared defects of the fourth-order Lobatto IIIA rule
(Hermite and Simpson; Hargraves and Paris 1987) between rows times a weight that grows until the
system holds strictly. Only whole arrays are evaluated, the normal equations are banded, and the
smoothed data are the start, so that a fit takes milliseconds, cannot diverge, follows chaotic
motion over the whole run (a weak-constraint trajectory; Ramsay et al. 2007, Biegler 2010), and is
stable for stiff systems, since the rule is implicit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import sympy
from scipy.interpolate import CubicSpline
from scipy.linalg import LinAlgError, lapack

from dynsr.data import (
    Forced,
    KnownNoise,
    Samples,
    SmoothedTrajectory,
    StateNoise,
    Trajectory,
    carry,
    estimate_noise,
    find_forced,
    is_still,
    join_samples,
    scale_of,
    smooth,
    told_rows,
    within_limits,
)
from dynsr.expression import Program, compile_columns, free_constants
from dynsr.fit.censored import Censored, deviance
from dynsr.fit.linear import DAMPED, DAMPING, ROUNDING, invert_normal
from dynsr.fit.noise import FLOOR
from dynsr.fit.settings import FIT, CollocationSettings
from dynsr.fit.shooting import Driven, drives_of

COLLOCATION = CollocationSettings()
# How far one step may take a constant in a function, as a multiple of it, and an exponent.
_FACTOR, _EXPONENT = 3.0, 1.0
# Rows an oscillation from which on steps of order 4 are good, and most parts and rows for that.
_TURN, _PARTS, _NODES = 20.0, 4, 2000
# Times the usual one from which on a time between rows is cut no further.
_LONGEST = 10.0
# Noise, as a share of the spread, up to which it may be none.
_MAY_BE_EXACT = 1e-3
# Noise, as a share of the spread, that hides the errors of so many rows.
_HIDES = 5e-3
# In the origin of a run, which one it is.
_NUMBER = "number"
# Share of its spread in which the defects of a state that is not measured are counted.
_UNMEASURED = 0.01


@dataclass(frozen=True, eq=False)
class Mesh:
    """The rows of all runs, one below the other, and what is measured there.

    Rows that are far apart have others between them, at which nothing is measured. A row at which
    a held input jumps is there twice, with the input before and after it: the rule sees no jump,
    and the interval of no length between the two says that the states go on.

    Parameters
    ----------
    t : (n,) times; those of a new run follow those of the one before.
    left : (m,) rows at which an interval begins; it ends at the next row.
    x : (n, k) measured states, 0 where nothing is measured.
    weights : (n, k) 1 / standard deviation of the noise, 0 where nothing is measured.
    start : (n, k) smoothed states, from which a fit starts.
    driven : (d, n + m) driven columns at the rows, then in the middle of the intervals.
    states, driven_names : names of the columns; the last driven one is ``t``.
    known : (k,) whether the noise of a state is known; by default it is an estimate.
    mix : (k, k) what was measured in the place of each state, as a combination of all of them; None
        where each was measured itself.
    censored : the cells in which only a limit is known, whose weight is 0; None for none.
    sizes : (n, k) sizes of states that nobody measured, of which their defects are shares; the
        spread of each where that is smaller, and by default.
    """

    t: np.ndarray
    left: np.ndarray
    x: np.ndarray
    weights: np.ndarray
    start: np.ndarray
    driven: np.ndarray
    states: tuple[str, ...]
    driven_names: tuple[str, ...]
    known: np.ndarray = field(default_factory=lambda: np.zeros(1, dtype=bool))
    mix: np.ndarray | None = None
    censored: Censored | None = None
    sizes: np.ndarray | None = None

    def seen(self, states: np.ndarray) -> np.ndarray:
        """Give what is measured (k, n) of states (k, n)."""
        return states if self.mix is None else self.mix @ states

    @cached_property
    def h(self) -> np.ndarray:
        """(m,) lengths of the intervals."""
        steps: np.ndarray = self.t[self.left + 1] - self.t[self.left]
        return steps

    @cached_property
    def sixth(self) -> np.ndarray:
        """(m,) sixths of the intervals."""
        parts: np.ndarray = self.h / 6
        return parts

    @cached_property
    def eighth(self) -> np.ndarray:
        """(m,) eighths of the intervals."""
        parts: np.ndarray = self.h / 8
        return parts

    @cached_property
    def unit(self) -> np.ndarray:
        """(m, k) standard deviation of the noise around each interval: what defects are in."""
        deviation = np.empty_like(self.weights)
        nodes = np.arange(len(self.t))
        for j, own in enumerate(self.weights.T):
            rows = np.flatnonzero(own)
            if len(rows):
                # Between measured rows noise is what it is around them.
                deviation[:, j] = np.interp(nodes, rows, 1 / own[rows])
            else:
                sizes = np.inf if self.sizes is None else self.sizes[:, j]
                deviation[:, j] = _UNMEASURED * np.minimum(sizes, self.spread[j])
        smaller: np.ndarray = np.minimum(deviation[self.left], deviation[self.left + 1])
        return smaller

    @cached_property
    def ends(self) -> tuple[Any, Any]:
        """Where the (m,) intervals begin and end among rows; slices of a single run."""
        last = len(self.t) - 1
        if len(self.left) == last:
            return slice(0, last), slice(1, last + 1)
        return self.left, self.left + 1

    @cached_property
    def by_state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Measured states (k, n), their weights (k, n) and the unit of the defects (k, m)."""
        x, weights, unit = (np.ascontiguousarray(a.T) for a in (self.x, self.weights, self.unit))
        return x, weights, unit

    @cached_property
    def spread(self) -> np.ndarray:
        """(k,) scale of the smoothed states, more than their rounding."""
        scales = [scale_of(column) for column in self.start.T]
        return np.maximum(scales, ROUNDING * np.abs(self.start).max(axis=0))

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """Name -> (n,) smoothed states and driven columns at the rows."""
        rows = [*self.start.T, *self.driven[:, : len(self.t)]]
        return dict(zip((*self.states, *self.driven_names), rows, strict=True))

    @cached_property
    def measured(self) -> np.ndarray:
        """(n,) whether anything is measured at a row."""
        return np.asarray(self.weights.any(axis=1))

    @cached_property
    def rows(self) -> np.ndarray:
        """(k,) measured rows of every state."""
        return np.count_nonzero(self.weights, axis=0).astype(float)

    def with_noise(self, shares: np.ndarray) -> Mesh:
        """Give the same rows with other noise.

        Parameters
        ----------
        shares : (k,) the noise of each state, as a multiple of what it was.
        """
        cells = self.censored
        if cells is not None:
            cells = replace(cells, sure=cells.sure / shares[cells.places[0]])
        return replace(self, weights=self.weights / shares, censored=cells)

    def freedom(self, constants: int) -> int:
        """Give the measurements less the constants and starts that are fitted to them, 1 at least.

        Parameters
        ----------
        constants : how many constants are fitted.
        """
        starts = (len(self.t) - len(self.left)) * np.count_nonzero(self.rows)
        return max(int(self.rows.sum()) - constants - int(starts), 1)


@dataclass(frozen=True, eq=False)
class CollocationFit:
    """A system fitted to the states of a mesh.

    Parameters
    ----------
    exprs : state -> equation with its constants.
    constants : (P,) their values, in the order of the states and of their appearance.
    states : (n, k) the fitted trajectory at the rows of the mesh.
    misses : (n, k) fitted minus measured in units of the noise, 0 where nothing is measured.
    mean_squares : (k,) their mean squares, with those of the error of the steps. The squares that
        censored cells add are in it; the rows that divide it are those of measured cells alone,
        since only these have a density that the size of the noise is in.
    information : (P, P) what the data say of the constants, in inverse squares of their units.
    censored : (c,) residuals of the censored cells, the roots of their deviances.
    allowed : (k,) the part of the mean squares that censored cells would have on their limits.
    weight : that of the squared defects; None where it is the last of the settings.
    volume : twice the logarithm of how much less the states are known before the data than after,
        and of what the weight costs.
    """

    exprs: dict[str, sympy.Expr]
    constants: np.ndarray
    states: np.ndarray
    misses: np.ndarray
    mean_squares: np.ndarray
    information: np.ndarray
    censored: np.ndarray = field(default_factory=lambda: np.zeros(0))
    allowed: np.ndarray | float = 0.0
    weight: float | None = None
    volume: float = 0.0

    @property
    def squares(self) -> float:
        """Sum of the squared residuals, of measured and of censored cells."""
        return float(np.sum(self.misses**2)) + float(np.sum(self.censored**2))

    @cached_property
    def covariance(self) -> np.ndarray:
        """(P, P) of the constants at the noise that was given; inf where undetermined."""
        return covariance_of(self.information)

    @cached_property
    def errors(self) -> np.ndarray:
        """(P,) standard errors of the constants at the noise that was given; inf if unknown."""
        return np.sqrt(np.diag(self.covariance))


@np.errstate(all="ignore")
def covariance_of(information: np.ndarray) -> np.ndarray:
    """(P, P) inverse of an information; inf for what has a share in a direction it says nothing of.

    Parameters
    ----------
    information : (P, P), in inverse squares of the units of P constants.
    """
    own = np.diag(information)
    # In these units its diagonal is 1, and 0 where nothing is said.
    scale = np.sqrt(np.where(own > 0, own, np.inf))
    scaled = information / np.outer(scale, scale)
    if not np.all(np.isfinite(scaled)):
        return np.full_like(information, np.inf)
    found = invert_normal(information)
    values, directions = np.linalg.eigh(scaled)
    silent = values < ROUNDING * values.max(initial=0.0)
    # The inverse gives no variance at all to what nothing tells of.
    unknown = np.sum(directions[:, silent] ** 2, axis=1) > 1e-6
    unknown |= ~(np.diag(found) > 0)
    found[unknown] = found[:, unknown] = np.inf
    return found


@dataclass(frozen=True, eq=False)
class Linearised:
    """The normal equations of a fit with its states eliminated.

    ``information`` (P, P) and ``pull`` (P,): half the second and half the first derivative of the
    sum of squares by the constants when the states follow; ``squares`` is what remains of it when
    the states alone move.
    """

    information: np.ndarray
    pull: np.ndarray
    squares: float

    @property
    def gram(self) -> np.ndarray:
        """(P + 1, P + 1) products of the slopes by all constants, and of the residuals last."""
        pull = self.pull[:, None]
        return np.block([[self.information, pull], [pull.T, np.array([[self.squares]])]])


@dataclass(frozen=True, eq=False)
class Probes:
    """Constants that a system might have: what each would move.

    Parameters
    ----------
    owners : (Q,) place of the equation that each is in.
    slopes : (Q, n + m) slopes of that equation by it, at the rows and in the middle of the
        intervals.
    """

    owners: np.ndarray
    slopes: np.ndarray


@dataclass(frozen=True, eq=False)
class _Point:
    """Defects (k, m) at a trial point, and their derivatives: (k, k, m) twice and (k, P, m).

    ``inside`` (k, k, m) are the slopes of the equations by the states in the middle.
    """

    defects: np.ndarray
    by_left: np.ndarray
    by_right: np.ndarray
    by_constant: np.ndarray
    inside: np.ndarray


@dataclass(frozen=True, eq=False)
class _Gathered:
    """The normal equations at a trial point, of states and constants together.

    ``band`` contains those of the states as LAPACK's pbtrf reads them, ``sides`` (n k, 1 + P) what
    they are pulled by, ``products`` (1 + P, 1 + P) the products of defects and their derivatives
    by constants, ``squares`` the sum of squared residuals. Where it is known, ``defects`` is what
    the defects bring into the band with a weight of 1.
    """

    band: np.ndarray
    sides: np.ndarray
    products: np.ndarray
    squares: float
    defects: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class _Weighed:
    """A fit at one weight of the defects, and what the data say of the weight.

    ``evidence`` is minus twice its logarithm, of which ``volume`` is the part of the states and of
    the ``price`` of the weight; ``left`` are the squared defects times their weight, and
    ``determined`` is the number of defects that the data determine: for the best weight they are
    equal (MacKay 1992). ``point`` is the fit made linear.
    """

    weight: float
    states: np.ndarray
    constants: np.ndarray
    point: _Point
    evidence: float
    volume: float
    left: float
    determined: float
    price: float

    @property
    def falls(self) -> bool:
        """Whether the evidence falls by more than the price of a weight with each factor e."""
        return self.left - self.determined > self.price

    @property
    def holds(self) -> bool:
        """Whether the defects are no larger than this weight expects, give or take chance."""
        return self.left <= self.determined + 2 * math.sqrt(2 * self.determined)


@dataclass(frozen=True, eq=False)
class Collocation:
    """The least-squares problem of one system on one mesh.

    Parameters
    ----------
    exprs : state -> equation; a state of the mesh each, in its order.
    mesh : the data.
    settings : the numbers that decide.
    weight : that of the squared defects; by default the last of the settings.

    >>> t = np.linspace(0, 2, 41)
    >>> x = np.exp(-0.7 * t)[:, None]
    >>> times = np.concatenate([t, (t[1:] + t[:-1]) / 2])[None]
    >>> mesh = Mesh(t, np.arange(40), x, np.full_like(x, 1e4), x, times, ("x",), ("t",))
    >>> fit = Collocation({"x": -0.5 * sympy.Symbol("x")}, mesh).fit()
    >>> round(float(fit.constants[0]), 5)
    -0.7
    """

    exprs: Mapping[str, sympy.Expr]
    mesh: Mesh
    settings: CollocationSettings = COLLOCATION
    weight: float | None = field(default=None, kw_only=True)

    @property
    def _last(self) -> float:
        """Weight of the squared defects at the end of a fit."""
        return self.settings.stiffness[-1] if self.weight is None else self.weight

    @cached_property
    def _template(self) -> tuple[dict[str, sympy.Expr], dict[sympy.Symbol, float]]:
        shapes: dict[str, sympy.Expr] = {}
        values: dict[sympy.Symbol, float] = {}
        for state in self.mesh.states:
            shapes[state], own = free_constants(self.exprs[state], f"constant {state} ")
            values |= own
        return shapes, values

    @cached_property
    def slope(self) -> Program:
        """Right-hand sides (k, ...) of the states, the driven columns and the constants."""
        shapes, values = self._template
        names = [*self.mesh.states, *self.mesh.driven_names, *map(str, values)]
        return compile_columns(list(shapes.values()), names)

    @property
    def constants(self) -> np.ndarray:
        """(P,) values that the constants have in the equations."""
        return np.array(list(self._template[1].values()))

    @cached_property
    def _owners(self) -> tuple[np.ndarray, np.ndarray]:
        """(P,) place of the equation of each constant, and its place among those there."""
        states = self.mesh.states
        counts = [len(free_constants(self.exprs[s], f"constant {s} ")[1]) for s in states]
        ranks = np.concatenate([np.arange(count) for count in counts])
        return np.repeat(np.arange(len(counts)), counts), ranks

    def put(self, numbers: Sequence[sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give the equations with P numbers in the places of the constants.

        Parameters
        ----------
        numbers : in the order of the constants.
        """
        shapes, values = self._template
        given = dict(zip(values, numbers, strict=True))
        return {state: expr.xreplace(given) for state, expr in shapes.items()}

    @cached_property
    def _bent(self) -> tuple[np.ndarray, np.ndarray]:
        """(P,) whether a constant is no factor of a term, and whether it is in an exponent."""
        shapes, values = self._template
        inside, exponents = set(values), set()
        for expr in shapes.values():
            for term in sympy.Add.make_args(expr):
                inside -= set(sympy.Mul.make_args(term))
            for power in expr.atoms(sympy.Pow):
                exponents |= power.exp.free_symbols
        both = [[value in own for value in values] for own in (inside, exponents)]
        return np.array(both[0], dtype=bool), np.array(both[1], dtype=bool)

    @property
    def inside(self) -> np.ndarray:
        """Values of the constants that are no factors of terms, in the order of all."""
        return self.constants[self._bent[0]]

    def _reach(self, constants: np.ndarray) -> np.ndarray:
        """(P,) how far a step may take the constants; inf for factors of terms."""
        inside, exponents = self._bent
        reach = np.where(inside, _FACTOR * np.abs(constants), np.inf)
        return np.where(exponents, _EXPONENT, reach)

    def _steps(self, constants: np.ndarray) -> np.ndarray:
        """(k + P,) steps of the numerical derivatives by states and constants."""
        sizes = np.concatenate([self.mesh.spread, np.maximum(np.abs(constants), 1e-3)])
        return self.settings.difference * sizes

    def _split(
        self, states: np.ndarray, constants: np.ndarray, driven: np.ndarray, steps: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slopes (k, points), their derivatives by states (k, k, points), own constants (P, ..).

        Each state is moved a little, then the first constant of every equation, the second, ...: a
        constant moves its own equation alone (Curtis, Powell and Reid 1974).
        """
        k, own, (owners, ranks) = len(states), np.arange(len(steps)), self._owners
        count = 1 + k + int(ranks.max(initial=-1)) + 1
        rows = np.repeat(states[:, None], count, axis=1)
        rows[own[:k], 1 + own[:k]] += steps[:k, None]
        shifts = np.repeat(constants[:, None], count, axis=1)
        shifts[own[: len(constants)], 1 + k + ranks] += steps[k:]
        found = self.slope(*rows, *driven[:, None], *shifts[..., None])
        base = found[:, 0]
        by_states = (found[:, 1 : 1 + k] - base[:, None]) / steps[:k, None]
        by_constants = (found[owners, 1 + k + ranks] - base[owners]) / steps[k:, None]
        return base, by_states, by_constants

    def scales(self, fit: CollocationFit) -> np.ndarray:
        """(P,) changes of the constants that change their equation by as much as it says.

        Parameters
        ----------
        fit : of this problem.
        """
        base, by_constants = self.slopes_of(fit)
        return usual_scales(base, self._owners[0], by_constants)

    def slopes_of(self, fit: CollocationFit) -> tuple[np.ndarray, np.ndarray]:
        """Give right-hand sides (k, n) of a fit at the rows, and slopes (P, n) by their constants.

        Parameters
        ----------
        fit : of this problem.
        """
        states, constants = fit.states.T, fit.constants
        driven = self.driven(states, constants)[:, : len(self.mesh.t)]
        with np.errstate(all="ignore"):
            base, _, slopes = self._split(states, constants, driven, self._steps(constants))
        return base, slopes

    def driven(self, states: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """(d, n + m) driven columns at the rows and in the middle of intervals.

        Parameters
        ----------
        states : (k, n) the trajectory.
        constants : (P,) values.
        """
        del states, constants
        return self.mesh.driven

    def _quarters(self, states: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(d, m) driven columns half way from the middle of intervals to their left, and right."""
        n, (left, right) = len(self.mesh.t), self.mesh.ends
        driven = self.driven(states, constants)
        between = driven[:, n:]
        return (driven[:, :n][:, left] + between) / 2, (driven[:, :n][:, right] + between) / 2

    def _middle(self, states: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        left, right = self.mesh.ends
        ends = (states[:, left] + states[:, right]) / 2
        middle: np.ndarray = ends + self.mesh.eighth * (slopes[:, left] - slopes[:, right])
        return middle

    def _along(
        self, states: np.ndarray, constants: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slopes (k, n) at the rows; states and slopes (k, m) in the middle of the intervals."""
        n, driven = len(self.mesh.t), self.driven(states, constants)
        at_rows = self.slope(*states, *driven[:, :n], *constants)
        middle = self._middle(states, at_rows)
        inside = self.slope(*middle, *driven[:, n:], *constants)
        return at_rows, middle, inside

    def _defects(self, states: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """(k, m) how far each step misses the next state, in units of the noise."""
        left, right = self.mesh.ends
        at_rows, _, inside = self._along(states, constants)
        step = self.mesh.sixth * (at_rows[:, left] + 4 * inside + at_rows[:, right])
        found: np.ndarray = (states[:, right] - states[:, left] - step) / self.mesh.by_state[2]
        return found

    def _linearise(
        self, states: np.ndarray, constants: np.ndarray, probes: Probes | None = None
    ) -> _Point:
        """Defects and their derivatives, by more constants too where ``probes`` are given."""
        n, sixth, eighth = len(self.mesh.t), self.mesh.sixth, self.mesh.eighth
        (left, right), steps = self.mesh.ends, self._steps(constants)
        driven = self.driven(states, constants)
        f, by_x, by_c = self._split(states, constants, driven[:, :n], steps)
        middle = self._middle(states, f)
        fm, mid_x, mid_c = self._split(middle, constants, driven[:, n:], steps)
        owners = self._owners[0]
        if probes is not None:
            owners = np.concatenate([owners, probes.owners])
            by_c = np.concatenate([by_c, probes.slopes[:, :n]])
            mid_c = np.concatenate([mid_c, probes.slopes[:, n:]])
        one = np.eye(len(states))[..., None]
        low, high = by_x[..., left], by_x[..., right]
        by_left = -one - sixth * (low + 4 * _times(mid_x, one / 2 + eighth * low))
        by_right = one - sixth * (high + 4 * _times(mid_x, one / 2 - eighth * high))
        low, high, own = by_c[:, left], by_c[:, right], (owners, np.arange(len(owners)))
        # What moves the middle of a step moves all equations there, what moves a slope its own.
        inside = mid_x[:, owners] * (eighth * (low - high))
        inside[own] += mid_c
        inside *= 4
        inside[own] = low + inside[own] + high
        by_constant = -sixth * inside
        step = sixth * (f[:, left] + 4 * fm + f[:, right])
        unit = self.mesh.by_state[2]
        return _Point(
            (states[:, right] - states[:, left] - step) / unit,
            by_left / unit[:, None],
            by_right / unit[:, None],
            by_constant / unit[:, None],
            mid_x,
        )

    def _cost(self, states: np.ndarray, constants: np.ndarray, stiffness: float) -> float:
        x, weights, _ = self.mesh.by_state
        with np.errstate(all="ignore"):
            defects = self._defects(states, constants)
            misses = (self.mesh.seen(states) - x) * weights
            cost = float(np.vdot(misses, misses) + stiffness * np.vdot(defects, defects))
            if self.mesh.censored is not None:
                cost += float(np.sum(self.mesh.censored.deviances(self.mesh.seen(states))))
        return cost if np.isfinite(cost) else np.inf

    def fit(
        self, near: CollocationFit | None = None, strict: bool = False
    ) -> CollocationFit | None:
        """Fit states and constants; None where the right-hand sides are not finite on the data.

        Parameters
        ----------
        near : a fit of a like system, whose states are the start; by default the smoothed data.
        strict : whether the states follow the system from the first step on, and not in stages:
            from a fit of almost the same system nothing is to be gone back to.
        """
        found = self.solve(near, strict)
        return None if found is None else self.as_fit(*found)

    def fit_tied(
        self, states: np.ndarray, ways: np.ndarray, begun: bool = False
    ) -> CollocationFit | None:
        """Fit states and constants, of which some are one; None where slopes are not finite.

        Parameters
        ----------
        states : (k, n) where they start.
        ways : (P, Q) directions in which the constants may go.
        begun : whether the start follows the system already.
        """
        found = self._in_stages(states, begun, ways)
        return None if found is None else self.as_fit(*found)

    def solve(
        self, near: CollocationFit | None = None, strict: bool = False
    ) -> tuple[np.ndarray, ...] | None:
        """Give the arrays that a fit ends with, as :meth:`as_fit` takes them; None as for a fit.

        Parameters
        ----------
        near, strict : as for a fit.
        """
        begun = np.ascontiguousarray((self.mesh.start if near is None else near.states).T)
        if not self.settings.loose:
            return self._in_stages(begun, strict)
        return self._by_evidence(begun, (near.weight or 0.0) if strict and near else 0.0)

    def cost(self, states: np.ndarray, constants: np.ndarray) -> float:
        """Sum of squares that a fit ends in: misses, and defects times their last weight.

        Parameters
        ----------
        states : (k, n) the trajectory.
        constants : (P,) values.
        """
        return self._cost(states, constants, self._last)

    def fit_free(
        self, states: np.ndarray, constants: np.ndarray, ways: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Fit the states, and the constants along some directions, from a start near by.

        Parameters
        ----------
        states : (k, n) where the trajectory starts.
        constants : (P,) where the constants start.
        ways : (P, F) directions in which the constants may go.

        Gives states, constants and :meth:`cost`; None where the slopes are not finite.
        """
        stiffness = self._last
        moved = self._stage(states, constants, stiffness, ways)
        return None if moved is None else (*moved, self._cost(*moved, stiffness))

    def _finish(
        self, states: np.ndarray, constants: np.ndarray, at: _Weighed | None = None
    ) -> tuple[np.ndarray, ...] | None:
        """Give states, constants, mean squares and information; None where this is not known.

        Parameters
        ----------
        states, constants : where the fit ended.
        at : the weight of the defects there, which comes last with its volume.
        """
        weight = self._last if at is None else at.weight
        try:
            if at is None:
                information = self.normal(states.T, constants, None, weight).information
            else:
                information = self._normal(states, at.point, weight).information
        except (LinAlgError, ValueError):
            return None
        squares = np.sum(self._missed(states) ** 2, axis=1) + self._unresolved(states, constants)
        if self.mesh.censored is not None:
            own = self.mesh.censored.deviances(self.mesh.seen(states))
            squares += self.mesh.censored.by_state(own, len(squares))
        # Where the steps came to rest early, the states do not follow the system yet.
        defects = self._defects(states, constants)
        squares += weight * np.sum(defects**2, axis=1)
        squares /= np.maximum(self.mesh.rows, 1.0)
        evidence = () if at is None else (np.array([at.weight, at.volume]),)
        return states, constants, squares, information, *evidence

    def as_fit(
        self,
        states: np.ndarray,
        constants: np.ndarray,
        mean_squares: np.ndarray,
        information: np.ndarray,
        evidence: np.ndarray | None = None,
    ) -> CollocationFit:
        """Give the fit that ends in given arrays; see :class:`CollocationFit`.

        Parameters
        ----------
        states : (k, n) the trajectory.
        constants, mean_squares, information : as there.
        evidence : (2,) its weight and volume.
        """
        exprs = self.put([sympy.Float(c) for c in constants.tolist()])
        misses = self._missed(states).T
        found = CollocationFit(exprs, constants, states.T, misses, mean_squares, information)
        if evidence is not None:
            found = replace(found, weight=float(evidence[0]), volume=float(evidence[1]))
        if self.mesh.censored is None:
            return found
        own = self.mesh.censored.residuals(self.mesh.seen(states))
        # A curve at its limit is not a wrong one.
        most = np.minimum(own**2, deviance(np.zeros(1)))
        allowed = self.mesh.censored.by_state(most, len(states))
        return replace(found, censored=own, allowed=allowed / np.maximum(self.mesh.rows, 1.0))

    def _missed(self, states: np.ndarray) -> np.ndarray:
        """(k, n) states minus measured ones in units of the noise."""
        x, weights, _ = self.mesh.by_state
        missed: np.ndarray = (self.mesh.seen(states) - x) * weights
        return missed

    def _unresolved(self, states: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """(k,) sums of squares of what half steps would change, in units of the noise.

        A right-hand side that jumps between rows would follow anything there.
        """
        (left, right), sixth, eighth = self.mesh.ends, self.mesh.sixth, self.mesh.eighth
        with np.errstate(all="ignore"):
            f, middle, fm = self._along(states, constants)
            change = -sixth * (f[:, left] + 4 * fm + f[:, right])
            sides = zip((left, right), (1.0, -1.0), self._quarters(states, constants), strict=True)
            for at, sign, driven in sides:
                # The cubic through the end and the middle, half way between the two.
                end, slope = states[:, at], f[:, at]
                quarter = (end + middle) / 2 + sign * eighth / 2 * (slope - fm)
                inside = self.slope(*quarter, *driven, *constants)
                change = change + sixth / 2 * (slope + 4 * inside + fm)
            found: np.ndarray = np.sum((change / self.mesh.by_state[2]) ** 2, axis=1)
        return np.where(np.isfinite(found), found, np.inf)

    def _in_stages(
        self, states: np.ndarray, begun: bool, ways: np.ndarray | None = None
    ) -> tuple[np.ndarray, ...] | None:
        """Fit from states (k, n); where these follow the system already, in the last stage alone.

        The stages before lead to its start, which need not be exact.
        """
        constants, last = self.constants, self._last
        early = [] if begun else [one for one in self.settings.stiffness if one < last]
        stages = [(weight, self.settings.early) for weight in early]
        for weight, gain in (*stages, (last, self.settings.gain)):
            moved = self._stage(states, constants, weight, ways, gain)
            if moved is None:
                return None
            states, constants = moved
        return self._finish(states, constants)

    def _by_evidence(self, states: np.ndarray, begun: float) -> tuple[np.ndarray, ...] | None:
        """Fit with the weight of the defects for which the evidence is greatest.

        The weight grows by stages for as long as the evidence does. Where that falls, the best
        weight is sought between these, or below the first.

        Parameters
        ----------
        states : (k, n) where they start.
        begun : the weight of a like fit that these are from; 0 for curves of the data.
        """
        above = [weight for weight in self.settings.stiffness if weight > begun]
        at: tuple[np.ndarray, np.ndarray, _Point | None] = (states, self.constants, None)
        found = list[_Weighed]()
        for weight in [begun, *above] if begun else above:
            if (one := self._weigh(*at, weight)) is None:
                break
            found.append(one)
            if one.falls:
                break
            at = one.states, one.constants, one.point
        if found and not found[-1].holds:
            found += self._seek(found)
        if not found:
            return None
        best = min(found, key=lambda one: one.evidence)
        return self._finish(best.states, best.constants, best)

    def _seek(self, found: Sequence[_Weighed]) -> Iterator[_Weighed]:
        """Give fits at weights between the last that holds and the first that does not.

        Parameters
        ----------
        found : fits at weights that grow; the last one does not hold.
        """
        low = max((one for one in found if one.holds), key=lambda one: one.weight, default=None)
        one = high = min((o for o in found if not o.holds), key=lambda one: one.weight)
        for _ in range(3):
            # The weight of the best evidence, if as many defects are determined there (MacKay).
            weight = one.weight * one.determined / one.left if one.left else math.inf
            if low is not None and not low.weight < weight < high.weight:
                weight = math.sqrt(low.weight * high.weight)
            # Where the data determine next to no defect, there is no weight to be sought.
            change = weight / one.weight
            if not 0 < change < math.inf or abs(math.log(change)) < 0.5:
                return
            near = one if low is None else low
            sought = self._weigh(near.states, near.constants, near.point, weight)
            if sought is None:
                return
            yield sought
            one = sought
            low, high = (one, high) if one.holds else (low, one)

    def _weigh(
        self, states: np.ndarray, constants: np.ndarray, point: _Point | None, weight: float
    ) -> _Weighed | None:
        """Fit at one weight; where it may grow, no further than to see that."""
        last, one = weight == self.settings.stiffness[-1], None
        for gain in [self.settings.gain] if last else [self.settings.early, self.settings.gain]:
            moved = self._stage(states, constants, weight, None, gain, point)
            if moved is None:
                return one
            states, constants = moved
            try:
                one = self._evidence_at(states, constants, weight)
            except (LinAlgError, ValueError):
                return None
            # What is left may be how far the fit is from its end.
            if one.holds:
                break
            point = one.point
        return one

    def evidence(self, states: np.ndarray, constants: np.ndarray) -> float:
        """Give minus twice the logarithm of the evidence for equations and weight of the defects.

        The evidence is the probability of the measured states, whatever the true ones are (Laplace;
        exact for linear equations), given the constants. The factor that depends on the noise alone
        is left out.

        Parameters
        ----------
        states : (k, n) the most probable trajectory.
        constants : (P,) values.

        Raises LinAlgError where the data do not determine the states.
        """
        return self._evidence_at(states, constants, self._last).evidence

    @np.errstate(all="ignore")
    def _evidence_at(self, states: np.ndarray, constants: np.ndarray, weight: float) -> _Weighed:
        point = self._linearise(states, constants)
        count, step = point.defects.size, math.sqrt(self.settings.difference)
        gathered = self._gather(point, states, weight)
        if gathered.defects is None:
            beyond = self._gather(point, states, weight * (1 + step)).band
        else:
            beyond = gathered.band + weight * step * gathered.defects
        first, more = _log_det(gathered.band), _log_det(beyond)
        determined = max(count - (more - first) / math.log1p(step), np.finfo(float).tiny)
        # A density of the defect is one of the next state times how fast the defect moves with it.
        ends = np.linalg.slogdet(np.moveaxis(point.by_right, -1, 0))[1]
        volume = first - 2 * float(np.sum(ends)) - count * math.log(weight)
        left = weight * float(np.vdot(point.defects, point.defects))
        price = self._price_of(weight, determined)
        evidence = self._cost(states, constants, weight) + volume + price
        if not math.isfinite(evidence + left):
            raise LinAlgError
        return _Weighed(
            weight, states, constants, point, evidence, volume + price, left, determined, price
        )

    def _price_of(self, weight: float, determined: float) -> float:
        """Twice the logarithm of what a weight below the last costs, as one constant more."""
        if not self.settings.loose or weight >= self.settings.stiffness[-1]:
            return 0.0
        far = math.log(self.settings.stiffness[-1] / weight)
        return 2 * math.log(2) * self.settings.loose + math.log1p(far**2 * determined / 2)

    def _stage(
        self,
        states: np.ndarray,
        constants: np.ndarray,
        stiffness: float,
        ways: np.ndarray | None = None,
        gain: float | None = None,
        point: _Point | None = None,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Levenberg and Marquardt's steps at one weight of the defects.

        ``point`` is where they begin made linear, where that is known.
        """
        gain = self.settings.gain if gain is None else gain
        cost, damping = self._cost(states, constants, stiffness), 1e-6
        if not np.isfinite(cost):
            return None
        for _ in range(self.settings.steps):
            before = cost
            if point is None:
                with np.errstate(all="ignore"):
                    point = self._linearise(states, constants)
            if not all(np.all(np.isfinite(a)) for a in (point.by_left, point.by_constant)):
                break
            gathered, reach = self._gather(point, states, stiffness), self._reach(constants)
            point = None
            while damping < 1e6:
                try:
                    step = self._step(gathered, damping, reach, ways)
                except (LinAlgError, ValueError):
                    damping = max(damping * DAMPING**2, DAMPED)
                    continue
                reached = self._cost(states + step[0], constants + step[1], stiffness)
                if reached < cost:
                    states, constants, cost = states + step[0], constants + step[1], reached
                    damping /= DAMPING
                    break
                damping = max(damping * DAMPING, DAMPED)
            if not cost < before * (1 - gain):
                break
        return states, constants

    @np.errstate(all="ignore")
    def _step(
        self,
        gathered: _Gathered,
        damping: float,
        reach: np.ndarray,
        ways: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        found, factor, white = self._eliminate(gathered, damping)
        pull, centre = found.pull, found.information
        if ways is not None:
            pull, centre = ways.T @ pull, ways.T @ centre @ ways
            reach = np.min(np.where(ways, reach[:, None], np.inf), axis=0)
        count = centre.shape[0]
        shift = np.zeros(0)
        if count:
            scale = np.sqrt(np.maximum(np.diag(centre), 1e-300))
            scaled = centre / np.outer(scale, scale) + damping * np.eye(count)
            shift = -np.linalg.solve(scaled, pull / scale) / scale
            # A linear step says nothing of what is far away.
            shift = np.clip(shift, -reach, reach)
        if not np.all(np.isfinite(shift)):
            raise LinAlgError
        if ways is not None:
            shift = ways @ shift
        moved, _ = lapack.dtbtrs(factor, -(white @ np.append(1.0, shift)), uplo="U")
        if not np.all(np.isfinite(moved)):
            raise LinAlgError
        return moved.reshape(-1, len(self.mesh.states)).T, shift

    @np.errstate(all="ignore")
    def _gather(self, point: _Point, states: np.ndarray, stiffness: float) -> _Gathered:
        """Form the normal equations, which are the same for every damping."""
        (k, n), (left, right) = states.shape, self.mesh.ends
        low, high, by_c, defects = point.by_left, point.by_right, point.by_constant, point.defects
        x, weights, _ = self.mesh.by_state
        own, squared, misses = np.arange(k), weights**2, self.mesh.seen(states) - x
        diagonal, held, beside = np.zeros((3, k, k, n))
        pulled, squares = squared * misses, np.sum(squared * misses**2)
        if self.mesh.censored is not None:
            places = self.mesh.censored.places
            bend, pull, more = self.mesh.censored.terms(self.mesh.seen(states))
            squared[places], pulled[places], squares = bend, pull, squares + more
        if self.mesh.mix is None:
            diagonal[own, own] = squared
        else:
            diagonal += np.einsum("ca,cb,cn->abn", self.mesh.mix, self.mesh.mix, squared)
            pulled = self.mesh.mix.T @ pulled
        held[..., left] += _products(low, low)
        held[..., right] += _products(high, high)
        beside[..., left] = _products(low, high)
        # What the states are pulled by: their misses and defects, then each constant.
        pulls = np.concatenate([defects[:, None], by_c], axis=1)
        count = by_c.shape[1]
        border = np.zeros((k, 1 + count, n))
        border[:, 0] = pulled
        border[..., left] += stiffness * _products(low, pulls)
        border[..., right] += stiffness * _products(high, pulls)
        sides = np.ascontiguousarray(border.transpose(1, 2, 0)).reshape(1 + count, n * k)
        flat = pulls.transpose(1, 0, 2).reshape(1 + count, -1)
        defects = _band(held, beside)
        band = stiffness * defects + _band(diagonal)
        return _Gathered(band, sides.T, stiffness * (flat @ flat.T), squares, defects)

    @np.errstate(all="ignore")
    def _eliminate(
        self, gathered: _Gathered, damping: float
    ) -> tuple[Linearised, np.ndarray, np.ndarray]:
        """Take the states out: what remains, the factor of their banded block, and what it whitens.

        The whitened pulls are (n k, 1 + P): that of the residuals and defects, then of the
        constants.
        """
        band = gathered.band.copy(order="F")
        band[-1] *= 1 + damping * 1e-3
        factor, failed = lapack.dpbtrf(band, overwrite_ab=1)
        if failed:
            raise LinAlgError
        white, _ = lapack.dtbtrs(factor, gathered.sides, uplo="U", trans="T")
        if not np.all(np.isfinite(white)):
            raise LinAlgError
        left_over = gathered.products - white.T @ white
        centre = left_over[1:, 1:]
        squares = float(gathered.squares + left_over[0, 0])
        found = Linearised((centre + centre.T) / 2, left_over[1:, 0], squares)
        return found, factor, white

    def normal(
        self,
        states: np.ndarray,
        constants: np.ndarray,
        probes: Probes | None = None,
        stiffness: float | None = None,
    ) -> Linearised:
        """Give the normal equations with the states eliminated.

        Parameters
        ----------
        states : (n, k) where.
        constants : (P,) where.
        probes : more constants; they come after the system's own.
        stiffness : weight of the defects; the last one by default.

        Raises LinAlgError when the system does not determine them.
        """
        columns = np.ascontiguousarray(states.T)
        with np.errstate(all="ignore"):
            point = self._linearise(columns, constants, probes)
        return self._normal(columns, point, self._last if stiffness is None else stiffness)

    def _normal(self, states: np.ndarray, point: _Point, weight: float) -> Linearised:
        return self._eliminate(self._gather(point, states, weight), 0.0)[0]

    def points(self, states: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """(k + d, n + m) states and driven columns at the rows and in the middle of intervals."""
        n, driven = len(self.mesh.t), self.driven(states.T, constants)
        values = [np.asarray(c) for c in constants]
        slopes = self.slope(*states.T, *driven[:, :n], *values)
        both = np.concatenate([states.T, self._middle(states.T, slopes)], axis=1)
        return np.concatenate([both, driven])


def _log_det(band: np.ndarray) -> float:
    """Logarithm of the determinant of the normal equations of the states."""
    factor, failed = lapack.dpbtrf(band)
    if failed:
        raise LinAlgError
    return 2 * float(np.sum(np.log(factor[-1])))


def usual_scales(own: np.ndarray, owners: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """(Q,) factors with which slopes say as much as the equations that they belong to.

    Parameters
    ----------
    own : (k, n) values of the equations.
    owners, slopes : (Q,) places of the equations, and (Q, n) the slopes.
    """
    with np.errstate(all="ignore"):
        sizes, more = (np.sqrt(np.mean(values**2, axis=-1)) for values in (own, slopes))
        scales: np.ndarray = sizes[owners] / more
    return np.where(np.isfinite(scales) & (scales > 0), scales, 1.0)


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measured trajectories with their noise and smoothed curves, ready to fit systems to.

    Parameters
    ----------
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t`` where it is known; other inputs are interpolated.
    smoothed : the runs made smooth, with the noise of every row.
    derived : state -> its slope, a column that was made from it and is not measured itself.
    finest : share of a state's spread below which no noise is believed.
    fineness : times as many parts between rows as noise asks for.
    sums : (n, k) noise of what was measured in the place of states, for each run; nothing where
        each was measured itself.
    places : for each run (n,) where its rows are among those of a mesh; by default the time between
        two is cut as their states ask for.
    """

    runs: Sequence[Trajectory]
    inputs: Mapping[str, sympy.Expr]
    smoothed: Sequence[SmoothedTrajectory]
    derived: Mapping[str, sympy.Symbol] = field(default_factory=dict)
    finest: float = 1e-5
    fineness: int = 1
    sums: Sequence[np.ndarray] = ()
    places: Sequence[np.ndarray] | None = None

    @classmethod
    def of(
        cls,
        runs: Sequence[Trajectory],
        inputs: Mapping[str, sympy.Expr],
        rows: int,
        derived: Mapping[str, sympy.Symbol] | None = None,
    ) -> Measurements:
        """Estimate the noise of runs and smooth them.

        Parameters
        ----------
        runs, inputs : the data.
        rows : of more rows than this in all, evenly spaced ones are kept; of the longest run
            five rows at least.
        derived : state -> its slope that was made from it.
        """
        runs = carry(runs)
        if never := [s for s in runs[0].states if not any(len(run.own_rows(s)) for run in runs)]:
            return cls._with_curves(runs, inputs, rows, derived, never)
        noise = estimate_noise(runs)
        longest = max(map(len, runs))
        stride = max(1, min(-(-sum(map(len, runs)) // rows), (longest - 1) // 4))
        long = [run for run in runs if len(run) > 4 * stride]
        thinned = [run.select(rows) for run in long for rows in run.thin(stride)]
        parts: Sequence[Forced | None] = find_forced(thinned) or [None] * len(thinned)
        smoothed = [
            smooth(run, noise, forced=part) for run, part in zip(thinned, parts, strict=True)
        ]
        smoothed = _with_common_noise(thinned, smoothed, noise)
        return cls(thinned, inputs, smoothed, derived or {}, sums=_noise_of_sums(thinned, smoothed))

    @classmethod
    def _with_curves(
        cls,
        runs: Sequence[Trajectory],
        inputs: Mapping[str, sympy.Expr],
        rows: int,
        derived: Mapping[str, sympy.Symbol] | None,
        never: Sequence[str],
    ) -> Measurements:
        """Estimate the noise of runs of which some states have a curve and were never measured."""
        kept = [state for state in runs[0].states if state not in never]
        numbered = [
            replace(run.of_states(kept), origin={**run.origin, _NUMBER: number})
            for number, run in enumerate(runs)
        ]
        data = cls.of(numbered, inputs, rows, derived)
        for state in never:
            curves = []
            for run in data.runs:
                whole = runs[run.origin[_NUMBER]]
                curves.append(np.interp(run.t, whole.t, whole.x[:, whole.index(state)]))
            data = data.with_hidden(state, curves)
        return data

    def with_hidden(self, name: str, curves: Sequence[np.ndarray]) -> Measurements:
        """Give the same data with one more state, which is measured nowhere.

        Parameters
        ----------
        name : of the state.
        curves : for each run its first curve (n,) at the rows.
        """
        runs, smoothed = [], []
        for run, own, curve in zip(self.runs, self.smoothed, curves, strict=True):
            states, none = (*run.states, name), np.zeros_like(curve)
            slope = CubicSpline(own.t, curve)(own.t, 1)
            more = {
                "x": curve,
                "slope": slope,
                "x_sd": none,
                "slope_sd": none,
                "noise": none + np.inf,
                **({} if own.before is None else {"before": slope}),
            }
            wider = {n: np.column_stack([getattr(own, n), column]) for n, column in more.items()}
            method = (*own.method, "hidden")
            smoothed.append(replace(own, **wider, method=method, states=states))
            gaps = np.column_stack([~run.measured, np.ones(len(run), dtype=bool)])
            x = np.column_stack([run.x, curve])
            runs.append(replace(run, x=x, states=states, unmeasured=gaps))
        sums = [np.column_stack([own, np.full(len(own), np.inf)]) for own in self.sums]
        return replace(self, runs=runs, smoothed=smoothed, sums=sums)

    def known(self, states: Sequence[str]) -> np.ndarray:
        """(k,) whether the noise of states is known, and not an estimate.

        Parameters
        ----------
        states : the k of them.
        """
        said = [[_told_noise(run, state) for run in self.runs] for state in states]
        sure = [all(own is not None and own.sure for own in each) for each in said]
        # Of what was never measured there is no noise to be estimated.
        never = [not any(len(run.own_rows(state)) for run in self.runs) for state in states]
        return np.logical_or(sure, never)

    @cached_property
    def _seen(self) -> list[np.ndarray]:
        """What was measured of each state."""
        columns = np.concatenate([run.observed for run in self.runs]).T
        return [own[~np.isnan(own)] for own in columns]

    @cached_property
    def _spread(self) -> np.ndarray:
        """(k,) scale of what was measured of each state; 0 where nothing was."""
        return np.array([scale_of(own) if len(own) else 0.0 for own in self._seen])

    @cached_property
    def deviations(self) -> list[np.ndarray]:
        """(n, k) standard deviation of the noise of each run; inf where nothing is measured."""
        spread = self._spread
        made = {str(slope) for slope in self.derived.values()}
        hidden = [state in made for state in self.runs[0].states]
        lowest = np.maximum(self.finest * spread, 1e-300)
        noise = self.sums or [s.noise for s in self.smoothed]
        return [np.where(hidden, np.inf, np.maximum(own, lowest)) for own in noise]

    @cached_property
    def noise_share(self) -> float:
        """Median over the measured states of the noise, its root mean square, as a share of spread.

        Noise may grow with the state: rows at rest near 0, however many, say little of it. A state
        that never changes says nothing of it.
        """
        noise = np.concatenate(self.deviations)
        moving = np.array([len(own) > 0 and not is_still(own) for own in self._seen])
        measured = np.any(np.isfinite(noise), axis=0) & moving
        own = [math.sqrt(np.mean(column[np.isfinite(column)] ** 2)) for column in noise.T[measured]]
        return float(np.median(own / self._spread[measured])) if own else 0.0

    @cached_property
    def unsure_share(self) -> float:
        """Greatest over the states of the error of the curve where the state was not measured.

        Root mean square as a share of spread; 0 where all states were measured at every row. A
        velocity was measured nowhere: its error is that of the slope of its state.
        """
        found = [0.0]
        names = self.runs[0].states
        for state, slope in self.derived.items():
            own = [smoothed.slope_sd[:, names.index(state)] for smoothed in self.smoothed]
            spread = self._spread[names.index(str(slope))]
            if spread > 0:
                found.append(math.sqrt(np.mean(np.concatenate(own) ** 2)) / spread)
        for place, spread in enumerate(self._spread):
            own = [
                smoothed.x_sd[~run.measured[:, place], place]
                for run, smoothed in zip(self.runs, self.smoothed, strict=True)
            ]
            squares = np.concatenate(own) ** 2
            if len(squares) and spread > 0:
                found.append(math.sqrt(np.mean(squares)) / spread)
        return float(max(found))

    @property
    def may_be_exact(self) -> bool:
        """Whether noise is so little that it may be none, and all of rows far apart."""
        return self.noise_share <= _MAY_BE_EXACT

    @cached_property
    def period(self) -> float:
        """Rows that an oscillation of the fastest state takes.

        Its steps are 2 pi / p of its amplitude over p rows, so that 1 - cos(2 pi / p) is half their
        mean square (von Neumann 1941).
        """
        x = np.concatenate([smoothed.x for smoothed in self.smoothed])
        steps = np.concatenate([np.diff(smoothed.x, axis=0) for smoothed in self.smoothed])
        rough = np.mean(steps**2, axis=0) / np.maximum(2 * np.var(x, axis=0), 1e-300)
        # Rows at rest have no turn.
        turn = float(np.arccos(1 - min(float(np.max(rough)), 1.0)))
        return 2 * math.pi / max(turn, 1e-300)

    @property
    def parts(self) -> int:
        """Parts that the time between two rows is cut into for a fit, where it is the usual one.

        So many that the fastest state takes twenty rows an oscillation, and up to forty where noise
        is so small that it does not hide the errors of the rule, which are of order four.
        """
        return int(self._cut(np.ones(1))[0])

    def _cut(self, lengths: np.ndarray) -> np.ndarray:
        """(m,) parts of times between rows, which are given as multiples of the usual one."""
        rows = sum(len(smoothed.x) for smoothed in self.smoothed)
        most = max(1, min(_PARTS, _NODES // rows))
        finer = float(np.clip((_HIDES / max(self.noise_share, 1e-300)) ** 0.25, 1.0, 2.0))
        wanted = np.ceil(_TURN * finer / self.period * lengths)
        found: np.ndarray = np.clip(wanted, 1, np.ceil(most * lengths)).astype(int)
        return self.fineness * found

    @cached_property
    def _places(self) -> Sequence[np.ndarray]:
        """(n,) where the rows of each run are among those that are put between them too.

        Where rows were lost the time between two is cut into more parts, so that these are as long
        as elsewhere.
        """
        if self.places is not None:
            return self.places
        steps = [np.diff(run.t) for run in self.runs]
        every = np.concatenate(steps)
        longest = _LONGEST * float(np.median(every))
        # The period counts rows by the mean square of what happens between two.
        usual = np.sqrt(np.mean(np.minimum(every, longest) ** 2))
        # Even times are so but for rounding.
        lengths = [np.round(np.minimum(own, longest) / usual, 6) for own in steps]
        found = []
        for own, jumps in zip(lengths, self._jumps, strict=True):
            parts = self._cut(own)
            # The second of the two nodes of a row that is there twice.
            parts[jumps] += 1
            found.append(np.concatenate([[0], np.cumsum(parts)]))
        return found

    @cached_property
    def _drives(self) -> list[Driven]:
        return drives_of(self.runs[0].input_names, self.runs, self.inputs)

    @cached_property
    def _jumps(self) -> list[np.ndarray]:
        """Rows of each run, neither the first nor the last, at which an input jumps."""
        pairs = zip(self.runs, self._drives, strict=True)
        return [1 + np.flatnonzero(np.isin(run.t[1:-1], drive.jumps)) for run, drive in pairs]

    @cached_property
    def _nodes(self) -> list[np.ndarray]:
        """Times of the rows of each run, those between them and the second ones included."""
        found = []
        for run, rows, jumps in zip(self.runs, self._places, self._jumps, strict=True):
            places, times = np.append(rows, rows[jumps] + 1), np.append(run.t, run.t[jumps])
            order = np.argsort(places)
            found.append(np.interp(np.arange(rows[-1] + 1), places[order], times[order]))
        return found

    def samples(self, state: str) -> Samples:
        """Give the smoothed states and slopes of one state as samples, where it was measured.

        Parameters
        ----------
        state : the target.
        """
        place = self.runs[0].index(state)
        pieces = [
            Samples(
                np.column_stack([smoothed.x, run.inputs]),
                smoothed.slope[:, place],
                run.names,
                state,
                "gp",
                run.t,
                float(np.sqrt(np.mean(smoothed.slope_sd[:, place] ** 2))),
                smoothed.slope_sd[:, place],
            ).select(rows)
            for run, smoothed, rows in zip(
                self.runs, self.smoothed, told_rows(self.runs, state), strict=True
            )
        ]
        return join_samples(pieces)

    def with_noise(self, shares: Mapping[str, float]) -> Measurements:
        """Give the same data with other noise.

        Parameters
        ----------
        shares : state -> its noise, as a multiple of what it was.
        """
        factors = np.array([shares.get(state, 1.0) for state in self.runs[0].states])
        smoothed = [replace(own, noise=own.noise * factors) for own in self.smoothed]
        return replace(self, smoothed=smoothed, sums=[own * factors for own in self.sums])

    def along(self, states: np.ndarray, names: Sequence[str]) -> Measurements:
        """Give the same data with other smoothed states: those of a system that follows them.

        Parameters
        ----------
        states : (n, k) states at the rows of the mesh, run below run.
        names : the k of them.
        """
        own = [self.runs[0].index(name) for name in names]
        first, smoothed = 0, []
        for smooth_run, rows, nodes in zip(self.smoothed, self._places, self._nodes, strict=True):
            x, slope = smooth_run.x.copy(), smooth_run.slope.copy()
            found = states[first : first + len(nodes)]
            x[:, own] = found[rows]
            slope[:, own] = _slopes_at(nodes, found, rows)
            smoothed.append(replace(smooth_run, x=x, slope=slope))
            first += len(nodes)
        # Other curves may ask for other steps, but these states are those of the mesh as it was.
        return replace(self, smoothed=smoothed, places=self._places)

    def beside(self, state: str) -> dict[str, sympy.Expr]:
        """Give the equations without which a state cannot be fitted: x' = v of a made column v.

        Parameters
        ----------
        state : whose equation is fitted.
        """
        return {s: slope for s, slope in self.derived.items() if str(slope) == state}

    def mesh(self, states: Sequence[str]) -> Mesh:
        """Give the rows of all runs for the fit of some states; the others are read from curves.

        Parameters
        ----------
        states : whose equations are fitted.
        """
        own = [self.runs[0].index(state) for state in states]
        others = [s for s in self.runs[0].states if s not in states]
        inputs = self.runs[0].input_names
        beside = [self.runs[0].index(state) for state in others]
        pieces, first, censored = [], 0, []
        for run, deviation, smoothed, drive, rows, t, jumps in zip(
            self.runs,
            self.deviations,
            self.smoothed,
            self._drives,
            self._places,
            self._nodes,
            self._jumps,
            strict=True,
        ):
            both = np.concatenate([t, (t[1:] + t[:-1]) / 2])
            curve = smoothed.curve(both)
            if run.limits:
                curve[:, rows] = within_limits(run, curve[:, rows].T).T
            read = drive(both)
            read[:, rows[jumps]] = drive(run.t[jumps], before=True)
            driven = np.concatenate([curve[beside], read])
            x, weights = np.zeros((2, len(t), len(own)))
            x[rows], weights[rows] = run.x[:, own], 1 / deviation[:, own]
            for place, state in enumerate(states):
                if state in run.sums:
                    summed = run.sums[state]
                    apart = [s for s in summed.others if s not in states]
                    seen = summed.without({s: smoothed.x[:, run.index(s)] for s in apart})
                    x[rows, place] = np.where(run.measured[:, own[place]], seen, 0.0)
            if run.limits:
                censored += self._censored(run, states, deviation, smoothed, first + rows)
            pieces.append(
                (
                    t,
                    first + np.arange(len(t) - 1),
                    x,
                    weights,
                    curve[own, : len(t)].T,
                    driven[:, : len(t)],
                    driven[:, len(t) :],
                )
            )
            first += len(t)
        times, left, measured, sure, start, at, between = zip(*pieces, strict=True)
        return Mesh(
            np.concatenate(times),
            np.concatenate(left),
            np.concatenate(measured),
            np.concatenate(sure),
            np.concatenate(start),
            np.concatenate([*at, *between], axis=1),
            tuple(states),
            (*others, *inputs, "t"),
            self.known(states),
            _mix(self.runs[0], states),
            _join_censored(censored),
        )

    def _censored(
        self,
        run: Trajectory,
        states: Sequence[str],
        deviation: np.ndarray,
        smoothed: SmoothedTrajectory,
        nodes: np.ndarray,
    ) -> list[Censored]:
        """Give the censored cells of a run, one list of them a state.

        Their noise is what it is around them; where the run has no measured row, the usual one.
        """
        found = []
        for place, state in enumerate(states):
            if state not in run.limits:
                continue
            limits, column = run.limits[state], run.index(state)
            rows = np.flatnonzero(limits.known)
            level = limits.level[rows]
            if state in run.sums:
                apart = {s: f for s, f in run.sums[state].others.items() if s not in states}
                level = level - sum(f * smoothed.x[rows, run.index(s)] for s, f in apart.items())
            own = np.isfinite(deviation[:, column])
            noise = deviation[own, column] if own.any() else self._usual_noise[column : column + 1]
            sd = np.interp(rows, np.flatnonzero(own) if own.any() else [0], noise)
            places = np.full(len(rows), place), nodes[rows]
            found.append(Censored(places, level, limits.side[rows] / sd))
        return found

    @cached_property
    def _usual_noise(self) -> np.ndarray:
        """(k,) median noise of what was measured of each state; inf of one that never was."""
        every = np.concatenate(self.deviations)
        return np.array(
            [
                np.median(own[np.isfinite(own)]) if np.isfinite(own).any() else np.inf
                for own in every.T
            ]
        )


def _join_censored(parts: Sequence[Censored]) -> Censored | None:
    if not parts:
        return None
    states, rows = (np.concatenate([own.places[i] for own in parts]) for i in (0, 1))
    limits, sure = (np.concatenate([getattr(own, n) for own in parts]) for n in ("limits", "sure"))
    return Censored((states, rows), limits, sure)


def _told_noise(run: Trajectory, state: str) -> KnownNoise | None:
    """Give the errors that are known of what was measured of a state."""
    return run.sums[state].noise if state in run.sums else run.noise.get(state)


def _mix(run: Trajectory, states: Sequence[str]) -> np.ndarray | None:
    """(k, k) what was measured in the place of states; None where each was measured itself."""
    if not set(run.sums) & set(states):
        return None
    found = np.eye(len(states))
    for place, state in enumerate(states):
        own = run.sums[state].others if state in run.sums else {}
        found[place] += [own.get(name, 0.0) for name in states]
    return found


def _with_common_noise(
    runs: Sequence[Trajectory],
    smoothed: Sequence[SmoothedTrajectory],
    laws: Sequence[StateNoise],
) -> list[SmoothedTrajectory]:
    """Give smoothed runs whose noise differs no more than the runs show.

    Each run estimates the size of its noise from its own rows. Of few rows it is small by chance,
    and that run then counts too much. Each logarithm of a size is moved to their mean by the share
    of its variance that is chance (Efron and Morris 1973); what is not is found from all runs
    (DerSimonian and Laird 1986).
    """
    if len(runs) < 2:
        return list(smoothed)
    noise = [own.noise.copy() for own in smoothed]
    for place, (state, law) in enumerate(zip(runs[0].states, laws, strict=True)):
        if any(state in run.noise or state in run.sums for run in runs):
            continue
        found = [
            _size_of_noise(run, own, place, law) for run, own in zip(runs, smoothed, strict=True)
        ]
        seen = [i for i, (size, rows) in enumerate(found) if size > 0 and rows > 0]
        if len(seen) < 2:
            continue
        sizes, rows = (np.array([found[i][j] for i in seen]) for j in (0, 1))
        apart = np.log(sizes) - math.log(np.sum(rows * sizes**2) / np.sum(rows)) / 2
        # The logarithm of a size that n rows tell has a variance of 1 / 2n.
        weights = 2 * rows
        beyond_chance = np.sum(weights * apart**2) - (len(seen) - 1)
        spread = np.sum(weights) - np.sum(weights**2) / np.sum(weights)
        differs = max(0.0, float(beyond_chance / spread))
        for i, step in zip(seen, apart / (1 + weights * differs), strict=True):
            noise[i][:, place] *= math.exp(-step)
    return [replace(own, noise=sd) for own, sd in zip(smoothed, noise, strict=True)]


def _size_of_noise(
    run: Trajectory, own: SmoothedTrajectory, place: int, law: StateNoise
) -> tuple[float, float]:
    """Give the noise of a state in a run as a multiple of its law, and the rows behind it."""
    rows = run.own_rows(run.states[place])
    sd, noise = own.x_sd[rows, place], own.noise[rows, place]
    expected = law.sd(np.hypot(own.x[rows, place], sd))
    there = (expected > 0) & (noise > 0)
    if not there.any():
        return 0.0, 0.0
    leverage = np.minimum((sd[there] / noise[there]) ** 2, 1.0)
    size = float(np.median(noise[there] / expected[there]))
    return size, float(np.sum(1 - leverage))


def _noise_of_sums(
    runs: Sequence[Trajectory], smoothed: Sequence[SmoothedTrajectory]
) -> list[np.ndarray]:
    """(n, k) noise of what was measured in the place of states; nothing without sums."""
    if not runs[0].sums:
        return []
    seen = []
    for run in runs:
        x, noise = run.x.copy(), dict(run.noise)
        for state, own in run.sums.items():
            place = run.index(state)
            rest = sum(f * run.x[:, run.index(s)] for s, f in own.others.items())
            x[:, place] = np.where(np.isfinite(own.values), own.values, run.x[:, place] + rest)
            noise |= {} if own.noise is None else {state: own.noise}
        seen.append(replace(run, x=x, noise=noise, sums={}))
    size = estimate_noise(seen)
    found = []
    places = [runs[0].index(state) for state in runs[0].sums]
    for run, curves in zip(seen, smoothed, strict=True):
        noise_there = curves.noise.copy()
        noise_there[:, places] = smooth(run, size).noise[:, places]
        found.append(noise_there)
    return found


def _slopes_at(nodes: np.ndarray, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Slopes at some of the (n,) times, by a cubic spline between every two jumps.

    At a jump, where a time is there twice, it is the slope before it.
    """
    slope = np.empty_like(x)
    ends = np.flatnonzero(np.diff(nodes) == 0) + 1
    for begin, end in pairwise([0, *ends, len(nodes)]):
        part = slice(begin, end)
        spline = CubicSpline(nodes[part], x[part])
        slope[part] = spline(nodes[part], 1)
    found: np.ndarray = slope[rows]
    return found


def _times(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Products (a, c, m) of matrices (a, b, m) and (b, c, m), one for each of m."""
    return np.einsum("abm,bcm->acm", left, right)


def _products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Products (b, c, m) of transposed matrices (a, b, m) and (a, c, m)."""
    return np.einsum("abm,acm->bcm", left, right)


def _band(diagonal: np.ndarray, beside: np.ndarray | None = None) -> np.ndarray:
    """Write blocks (k, k, n) on and right of the diagonal in the upper form of LAPACK's pbtrf."""
    k, _, n = diagonal.shape
    width = 2 * k - 1
    # Column after column, as LAPACK reads it.
    band = np.zeros((n, k, width + 1))
    for i in range(k):
        for j in range(i, k):
            band[:, j, width + i - j] = diagonal[i, j]
        for j in range(k):
            # Column (row + 1, j), row (row, i): k + j - i to the right.
            offset = k + j - i
            if beside is not None and offset <= width:
                band[1:, j, width - offset] = beside[i, j, :-1]
    return band.reshape(n * k, width + 1).T


@dataclass(frozen=True, eq=False)
class AlongFit:
    """Constants fitted to whole noisy runs by collocation.

    Parameters
    ----------
    problem : the least-squares problem.
    found : its solution.
    """

    problem: Collocation
    found: CollocationFit

    @property
    def constants(self) -> np.ndarray:
        """(P,) fitted values, in the order of the states and of their appearance."""
        return self.found.constants

    @property
    def freedom(self) -> float:
        """Measurements less the constants and starts that were fitted to them, 1 at least.

        Where all noise is known, nothing is estimated by them, and there is no end to it.
        """
        return math.inf if self._certain else self.problem.mesh.freedom(len(self.constants))

    @property
    def _certain(self) -> bool:
        return bool(np.all(self.problem.mesh.known))

    @cached_property
    def scale(self) -> float:
        """Variance of the residuals in units of the noise that was given: noise is an estimate."""
        if self._certain:
            return 1.0
        return max(float(np.sum(self.found.misses**2)) / self.freedom, FLOOR)

    @property
    def shown_noise(self) -> np.ndarray:
        """(k,) noise that the residuals of measured cells show, as a multiple of what was given.

        1 where it is known, or nothing was measured. Censored cells are left out: to the size of
        the noise those below the limit add what those above it take, but for chance.
        """
        mesh = self.problem.mesh
        squares = np.sum(self.found.misses**2, axis=0) / np.maximum(mesh.rows, 1.0)
        fitted = mesh.rows.sum() / mesh.freedom(len(self.constants))
        free = (mesh.rows > 0) & ~mesh.known & (squares > 0)
        return np.sqrt(np.where(free, squares * fitted, 1.0))

    @cached_property
    def covariance(self) -> np.ndarray:
        """(P, P) of the constants."""
        return self.found.covariance * self.scale

    @property
    def errors(self) -> np.ndarray:
        """(P,) standard errors; inf where the data say nothing."""
        return self.found.errors * math.sqrt(self.scale)

    @property
    def misses(self) -> np.ndarray:
        """(n, k, 1) at the measured rows, in units of the noise."""
        return self.found.misses[self.problem.mesh.measured][..., None]

    def put(self, numbers: Sequence[sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give the equations with P numbers in the places of the constants.

        Parameters
        ----------
        numbers : in the order of the constants.
        """
        return self.problem.put(numbers)

    def ratio(self, other: Any) -> float:
        """Likelihood ratio statistic of a nested fit ``other``.

        Parameters
        ----------
        other : the fit of fewer constants.
        """
        return (other.found.squares - self.found.squares) / self.scale


def fit_along(
    exprs: Mapping[str, sympy.Expr],
    data: Measurements,
    settings: CollocationSettings = FIT.along,
    near: AlongFit | None = None,
) -> AlongFit | None:
    """Fit every float of ``exprs`` to the noisy states; None where that cannot be done.

    Parameters
    ----------
    exprs : state -> right-hand side; other states are read from their smoothed curves.
    data : the measured states, their noise and smoothed curves.
    settings : the numbers that decide.
    near : a fit of similar equations of the same states, which gives the start.
    """
    mesh = data.mesh(tuple(exprs)) if near is None else near.problem.mesh
    problem = Collocation(exprs, mesh, settings)
    found = problem.fit(None if near is None else near.found)
    if found is None:
        return None
    fit = AlongFit(problem, found)
    return fit if mesh.censored is None or near is not None else _with_own_noise(fit)


def _with_own_noise(fit: AlongFit) -> AlongFit:
    """Fit again in the noise that the residuals show, until the two agree.

    How much a censored cell says depends on the noise. Of rows near a limit only errors to one side
    were measured, so that their neighbours show too little of it.
    """
    for _ in range(fit.problem.settings.steps):
        shown = fit.shown_noise
        if np.max(np.abs(shown - 1)) < math.sqrt(fit.problem.settings.gain):
            break
        problem = replace(fit.problem, mesh=fit.problem.mesh.with_noise(shown))
        found = problem.fit(fit.found, strict=True)
        if found is None:
            break
        fit = AlongFit(problem, found)
    return fit
