"""Curved: whole systems in which some functions of one column are smooth curves.

The constants and the values of each curve at its knots are fitted together with the states. A curve
pays for its integrated squared second derivative. What that costs is chosen by the marginal
likelihood, in which the curve has the Gaussian prior of that penalty (REML; Wood 2011). The errors
are those of the posterior: their bands contain the truth about as often as they say, averaged over
the curve (Nychka 1988). They count that the cost is an estimate (Kass and Steffey 1989).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import sympy
from scipy.linalg import LinAlgError, block_diag
from scipy.optimize import least_squares, minimize

from dynsr.expression import Curve, Program, compile_columns, differentiate
from dynsr.fit.collocation import (
    Collocation,
    Mesh,
    Probes,
    _Gathered,
    _Point,
    covariance_of,
    usual_scales,
)
from dynsr.fit.description import residual_bits
from dynsr.fit.mixed import MixedMesh, ScaledFit
from dynsr.fit.settings import FIT, CollocationSettings


@dataclass(frozen=True)
class CurvedSettings:
    """The numbers that decide a fit of curves; they are in a discovery's record.

    Parameters
    ----------
    knots : numbers of knots of each curve, of which the first ones are tried until more take no
        fewer bits. They are halfway between where the data are and evenly spaced.
    rounds : times that the cost of bending is chosen at most, each time with another fit.
    close : change of its logarithm with which that ends, and between costs that errors average.
    widest : how far its logarithm may be from where bending weighs as the data do.
    starts : values of all constants from which a first fit begins; then one after the other is
        multiplied by the sizes of the columns.
    points : of the data at most at which slopes are fitted first.
    rough : share of their size to which slopes are then followed at best.
    faint : what bending costs then, as a share of what the points say: it only fills gaps.
    """

    knots: tuple[int, ...] = (28, 56)
    rounds: int = 6
    close: float = 0.2
    widest: float = 16.0
    starts: tuple[float, ...] = (1.0, 0.1, 10.0)
    points: int = 400
    rough: float = 1e-2
    faint: float = 1e-5


CURVED: CurvedSettings = CurvedSettings()


@dataclass(frozen=True, eq=False)
class Part:
    """A function of one column that is a curve.

    Parameters
    ----------
    name : of the function.
    of : the column.
    mean : what the mean of the curve over the data is fixed at; None where it is free.
    """

    name: str
    of: str
    mean: float | None = None

    @property
    def symbol(self) -> sympy.Symbol:
        """What is written in its place in equations."""
        # The space keeps the name apart from any name of a column.
        return sympy.Symbol(f"curve {self.name}")


@dataclass(frozen=True, eq=False)
class CurvedSystem:
    """Equations with constants and curves.

    Parameters
    ----------
    equations : state -> right-hand side in columns, constants and the symbols of the parts.
    constants : the names of the constants.
    parts : the curves.
    """

    equations: Mapping[str, sympy.Expr]
    constants: tuple[str, ...]
    parts: tuple[Part, ...]

    def program(self, mesh: Mesh) -> Program:
        """Make the right-hand sides of the states of a mesh a program of all that is in them.

        Parameters
        ----------
        mesh : the data.
        """
        return compile_columns([self.equations[s] for s in mesh.states], self._names(mesh))

    def by_numbers(self, mesh: Mesh) -> Program:
        """Make their derivatives such a program: of each by all constants, then by all curves.

        Parameters
        ----------
        mesh : the data.
        """
        names = self._names(mesh)
        by = [sympy.Symbol(name) for name in names[len(mesh.states) + len(mesh.driven_names) :]]
        slopes = [differentiate(self.equations[s], own) for s in mesh.states for own in by]
        return compile_columns(slopes, names)

    def _names(self, mesh: Mesh) -> list[str]:
        parts = [str(part.symbol) for part in self.parts]
        return [*mesh.states, *mesh.driven_names, *self.constants, *parts]

    def contains(self, state: str, name: str | sympy.Symbol) -> bool:
        """Whether the equation of a state contains a symbol.

        Parameters
        ----------
        state : the state.
        name : the symbol.
        """
        return sympy.Symbol(str(name)) in self.equations[state].free_symbols


def place_knots(values: np.ndarray, count: int) -> np.ndarray:
    """Give knots (K,) over the range of data: halfway between evenly spaced and equally many data.

    Parameters
    ----------
    values : (n,) the data.
    count : of the knots; fewer where so few values differ.

    >>> place_knots(np.array([0.0, 1.0, 2.0, 3.0, 4.0]), 3).tolist()
    [0.0, 2.0, 4.0]
    """
    own = np.unique(values)
    count = min(count, len(own))
    ranks = np.linspace(0.0, 1.0, len(own)) + (own - own[0]) / max(np.ptp(own), 1e-300)
    found = np.interp(np.linspace(0.0, 2.0, count), ranks, own)
    # A spline whose knots nearly coincide has no numbers to speak of next to them.
    kept = [found[-1]]
    for knot in found[-2::-1]:
        if kept[-1] - knot > np.ptp(own) / count**2:
            kept.append(knot)
    return np.array([found[0], *kept[-2::-1]]) if len(kept) > 1 else np.unique(found)


@dataclass(frozen=True, eq=False)
class _Bending(_Point):
    """Defects at a trial point, and the constants that they are of."""

    constants: np.ndarray


@dataclass(frozen=True, eq=False)
class _Curved(Collocation):
    """The least-squares problem of a system with curves.

    Parameters
    ----------
    system : the equations.
    curves : the curves, whose values are where they start.
    numbers : (constants,) where these start.
    costs : (parts,) what the squared second derivative of each curve costs.
    """

    system: CurvedSystem = CurvedSystem({}, (), ())
    curves: tuple[Curve, ...] = ()
    numbers: tuple[float, ...] = ()
    costs: tuple[float, ...] = ()

    @cached_property
    def places(self) -> list[tuple[int, int]]:
        """(equation, number) of every constant of the problem: in each equation it has its own.

        The numbers are the constants of the system, then the values of each curve.
        """
        first = np.cumsum([len(self.system.constants), *(len(c.knots) for c in self.curves)])
        found = []
        for owner, state in enumerate(self.mesh.states):
            own = [i for i, n in enumerate(self.system.constants) if self.system.contains(state, n)]
            for part, begin, end in zip(self.system.parts, first, first[1:], strict=False):
                if self.system.contains(state, part.symbol):
                    own += range(begin, end)
            found += [(owner, number) for number in own]
        return found

    @cached_property
    def ties(self) -> np.ndarray:
        """(P, N) which number each constant of the problem is."""
        start = np.concatenate([self.numbers, *(curve.values for curve in self.curves)])
        found = np.zeros((len(self.places), len(start)))
        found[np.arange(len(self.places)), self._numbered] = 1.0
        return found

    @cached_property
    def _numbered(self) -> np.ndarray:
        """(P,) which number each constant of the problem is."""
        return np.array([number for _, number in self.places], dtype=int)

    @property
    def constants(self) -> np.ndarray:
        """(P,) values with which the problem starts."""
        start: np.ndarray = np.concatenate([self.numbers, *(c.values for c in self.curves)])
        return start[self._numbered]

    @cached_property
    def _owners(self) -> tuple[np.ndarray, np.ndarray]:
        owners = np.array([owner for owner, _ in self.places], dtype=int)
        return owners, np.zeros_like(owners)

    @cached_property
    def _bent(self) -> tuple[np.ndarray, np.ndarray]:
        """(P,) whether a constant is in a function, and in an exponent; no value of a curve is."""
        inside, exponents = [], []
        for owner, number in self.places:
            expr = self.system.equations[self.mesh.states[owner]]
            mine = set()
            if number < len(self.system.constants):
                mine = {sympy.Symbol(self.system.constants[number])}
            terms = [t for t in sympy.Add.make_args(expr) if mine & t.free_symbols]
            inside.append(any(not mine & {*sympy.Mul.make_args(t)} for t in terms))
            powers = (power.exp.free_symbols for power in expr.atoms(sympy.Pow))
            exponents.append(any(mine & own for own in powers))
        return np.array(inside, dtype=bool), np.array(exponents, dtype=bool)

    @cached_property
    def _program(self) -> Program:
        return self.system.program(self.mesh)

    @cached_property
    def _arguments(self) -> list[int]:
        """The place of the column of each curve among states and driven columns."""
        names = [*self.mesh.states, *self.mesh.driven_names]
        return [names.index(part.of) for part in self.system.parts]

    def _read(self, constants: np.ndarray) -> tuple[np.ndarray, list[Curve]]:
        """Give the numbers of the system, and its curves, at constants (P,) of the problem."""
        numbers = np.zeros(self.ties.shape[1])
        numbers[self._numbered] = constants
        sizes = [len(self.system.constants), *(len(curve.knots) for curve in self.curves)]
        own, *values = np.split(numbers, np.cumsum(sizes)[:-1])
        pairs = zip(self.curves, values, strict=True)
        return own, [curve.with_values(value) for curve, value in pairs]

    @cached_property
    def slope(self) -> Any:
        """Right-hand sides (k, ...) of the states, the driven columns and P constants."""
        return self._slopes_at

    def _slopes_at(self, *arguments: Any) -> np.ndarray:
        count = len(self.mesh.states) + len(self.mesh.driven_names)
        columns = arguments[:count]
        numbers, curves = self._read(np.array(arguments[count:], dtype=float))
        heights = [c(columns[p]) for c, p in zip(curves, self._arguments, strict=True)]
        return self._program(*columns, *numbers, *heights)

    def _split(
        self, states: np.ndarray, constants: np.ndarray, driven: np.ndarray, steps: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        k, (numbers, curves) = len(states), self._read(constants)
        rows = np.repeat(states[:, None], 1 + k, axis=1)
        rows[np.arange(k), 1 + np.arange(k)] += steps[:k, None]
        columns = [*rows, *driven[:, None]]
        heights = [c(columns[p]) for c, p in zip(curves, self._arguments, strict=True)]
        found = self._program(*columns, *numbers, *heights)
        base = found[:, 0]
        by_states = (found[:, 1:] - base[:, None]) / steps[:k, None]
        # Each number moves all equations, of which each constant is one.
        plain = [*numbers, *(height[0] for height in heights)]
        sizes = [float(np.max(np.abs(own))) or 1.0 for own in plain]
        moves = self.settings.difference * np.array(sizes)
        turned = np.eye(len(plain)) * moves
        shifted = [own + turn[:, None] for own, turn in zip(plain, turned, strict=True)]
        moved = self._program(*states[:, None], *driven[:, None], *shifted)
        slopes = (moved - base[:, None]) / moves[:, None]
        every = [slopes[:, : len(numbers)]]
        for place, (curve, column) in enumerate(zip(curves, self._arguments, strict=True)):
            x = states[column] if column < k else driven[column - k]
            every.append(slopes[:, len(numbers) + place, None] * curve.weights(x).T)
        whole = np.concatenate(every, axis=1)
        owners, places = np.array(self.places, dtype=int).reshape(-1, 2).T
        return base, by_states, whole[owners, places]

    @cached_property
    def penalty(self) -> np.ndarray:
        """(N, N) what bending costs, as a quadratic form of the numbers."""
        none = np.zeros((len(self.system.constants),) * 2)
        pairs = zip(self.costs, self.curves, strict=True)
        return np.asarray(block_diag(none, *(cost * c.roughness for cost, c in pairs)))

    @cached_property
    def _price(self) -> np.ndarray:
        """(P, P) the same of the constants of the problem; those that are one share it."""
        share = self.ties / np.maximum(self.ties.sum(axis=0), 1.0)
        found: np.ndarray = share @ self.penalty @ share.T
        return found

    def _cost(self, states: np.ndarray, constants: np.ndarray, stiffness: float) -> float:
        own = super()._cost(states, constants, stiffness)
        return own + float(constants @ self._price @ constants)

    def _linearise(
        self, states: np.ndarray, constants: np.ndarray, probes: Probes | None = None
    ) -> _Point:
        point = super()._linearise(states, constants, probes)
        own = {one.name: getattr(point, one.name) for one in fields(point)}
        return _Bending(**own, constants=constants)

    def _gather(self, point: _Point, states: np.ndarray, stiffness: float) -> _Gathered:
        found = super()._gather(point, states, stiffness)
        assert isinstance(point, _Bending)
        pull = self._price @ point.constants
        products = found.products.copy()
        products[1:, 1:] += self._price
        products[0, 1:] += pull
        products[1:, 0] += pull
        return replace(found, products=products, squares=found.squares + point.constants @ pull)

    def put(self, numbers: Sequence[sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give the equations; the numbers are no part of them.

        Parameters
        ----------
        numbers : in the order of the constants.
        """
        return dict(self.exprs)


@dataclass(frozen=True, eq=False)
class CurvedFit(ScaledFit):
    """A system with curves that was fitted."""

    problem: _Curved
    settings: CurvedSettings = CURVED

    @cached_property
    def constants(self) -> np.ndarray:
        """The values of the constants, in the order of the system."""
        return self.problem._read(self.found.constants)[0]  # noqa: SLF001

    @cached_property
    def curves(self) -> list[Curve]:
        """The curves."""
        return self.problem._read(self.found.constants)[1]  # noqa: SLF001

    @property
    def numbers(self) -> np.ndarray:
        """(N,) the constants, then the values of each curve."""
        values: np.ndarray = np.concatenate([self.constants, *(c.values for c in self.curves)])
        return values

    @cached_property
    def information(self) -> np.ndarray:
        """(Q, Q) what the data say of the numbers along the ways, without what bending costs."""
        free = replace(self.problem, costs=(0.0,) * len(self.problem.costs))
        tied = self.problem.ties @ self.ways
        own = free.normal(self.found.states, self.found.constants).information
        found: np.ndarray = tied.T @ own @ tied
        return found

    @cached_property
    def whole(self) -> np.ndarray:
        """(Q, Q) the same with what bending costs."""
        found: np.ndarray = self.information + self.ways.T @ self.problem.penalty @ self.ways
        return found

    @cached_property
    def effective(self) -> np.ndarray:
        """(1 + parts,) effective parameters: of the constants, then of each curve."""
        shares = np.linalg.pinv(self.whole, hermitian=True) @ self.information
        each = np.diag(self.ways @ shares @ np.linalg.pinv(self.ways))
        sizes = [len(self.constants), *(len(curve.knots) for curve in self.curves)]
        return np.array([part.sum() for part in np.split(each, np.cumsum(sizes)[:-1])])

    @property
    def fitted(self) -> int:
        """How many numbers were fitted: effective parameters, rounded up."""
        return math.ceil(float(self.effective.sum()))

    @cached_property
    def covariance(self) -> np.ndarray:
        """(N, N) of the numbers; inf where the data do not determine it.

        The cost of bending of each curve is one of many, by their likelihood. Other costs give
        other curves.
        """
        own = covariance_of(self.whole)
        if np.all(np.isfinite(own)):
            likelihood = _Likelihood.of(self)
            places = range(len(self.curves))
            own = own + sum((self._by_cost(likelihood, place, own) for place in places), 0.0)
        own = own * self.scale
        if np.all(np.isfinite(own)):
            found: np.ndarray = self.ways @ own @ self.ways.T
            return found
        unknown = np.abs(self.ways) @ ~np.isfinite(np.diag(own)) > 0
        own = self.ways @ np.where(np.isfinite(own), own, 0.0) @ self.ways.T
        own[unknown] = own[:, unknown] = np.inf
        return own

    def _by_cost(self, likelihood: _Likelihood, place: int, own: np.ndarray) -> np.ndarray:
        """(Q, Q) what the covariance gains where the cost of one curve is not known."""
        reach, step = self.settings.widest, self.settings.close
        moves = np.zeros((round(2 * reach / step) + 1, len(self.curves)))
        moves[:, place] = np.linspace(-reach, reach, len(moves))
        tried = [likelihood(move) for move in moves]
        values = np.array([value for value, _, _ in tried])
        weights = np.exp((np.min(values) - values) / 2)
        found: np.ndarray = np.zeros_like(own)
        for weight, (_, moved, other) in zip(weights / weights.sum(), tried, strict=True):
            # What weighs nothing may have no inverse.
            if weight > np.finfo(float).eps:
                found += weight * (other - own + np.outer(moved, moved) / self.scale)
        return found

    @cached_property
    def blocks(self) -> list[slice]:
        """Where the values of each curve are among the numbers."""
        ends = np.cumsum([len(self.constants), *(len(curve.knots) for curve in self.curves)])
        return [slice(a, b) for a, b in pairwise(ends.tolist())]

    @cached_property
    def bits(self) -> float:
        """Bits of the residuals, of the constants and of the curves, without those of the form.

        They are those of the marginal likelihood: a curve is believed to bend as little as its
        cost says, and to be of its own size; a constant to be of its usual size.
        """
        mesh, problem = self.problem.mesh, self.problem
        squares = np.maximum(self.found.mean_squares, np.maximum(self.least, 1e-300))
        bits = residual_bits(squares, mesh.rows, mesh.known)
        sizes = self._scales
        prior = np.diag(sizes**-2.0)
        believed = self.ways.T @ (prior + problem.penalty / self.scale) @ self.ways
        told = self.information / self.scale
        gained = np.linalg.slogdet(believed + told)[1] - np.linalg.slogdet(believed)[1]
        numbers = self.numbers
        bend = float(numbers @ problem.penalty @ numbers) / self.scale
        # A constant that is larger than usual, as where terms cancel each other, costs its size.
        count = len(self.constants)
        large = float(np.sum(np.log2(1 + np.abs(self.constants / sizes[:count]))))
        return bits + large + (gained + bend) / (2 * math.log(2))

    @cached_property
    def _scales(self) -> np.ndarray:
        """(N,) the usual size of each number."""
        problem = self.problem
        base, slopes = problem.slopes_of(self.found)
        own = usual_scales(base, problem._owners[0], slopes)  # noqa: SLF001
        # A formula that is 0 may leave no number in any equation.
        each = np.where(problem.ties > 0, own[:, None], np.inf)
        least = np.min(each, axis=0, initial=np.inf)
        for block, curve in zip(self.blocks, self.curves, strict=True):
            # All values together are as sure as one: a level moves them alike.
            least[block] = float(np.linalg.norm(curve.values)) or 1.0
        return np.where(np.isfinite(least), least, 1.0)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes of smoothed states, to which the first values of constants and curves are fitted.

    Parameters
    ----------
    columns : column -> (n,) its values.
    values, errors : (k, n) slopes of the states of a system, and their standard errors.
    """

    columns: Mapping[str, np.ndarray]
    values: np.ndarray
    errors: np.ndarray


def fit_curved(
    system: CurvedSystem,
    rows: MixedMesh,
    slopes: Slopes,
    settings: CurvedSettings = CURVED,
    along: CollocationSettings = FIT.along,
    begun: np.ndarray | None = None,
) -> CurvedFit | None:
    """Fit the constants and the curves of a system to the states; None where that cannot be done.

    Parameters
    ----------
    system : the equations.
    rows : the data.
    slopes : of the smoothed states, where the fit starts.
    settings, along : the numbers that decide.
    begun : (N,) what :func:`first_numbers` gave for the fewest knots, where that is known.

    More knots are taken for as long as they take fewer bits.
    """
    best: CurvedFit | None = None
    for count in settings.knots:
        curves = flat_curves(system, rows.mesh, count)
        if not curves:
            break
        if best is None:
            states = rows.mesh.start
            every = begun
            if every is None:
                every = first_numbers(system, rows.mesh, curves, slopes, settings)
            ends = np.cumsum([len(system.constants), *(len(c.knots) for c in curves)])[:-1]
            numbers, *values = np.split(every, ends)
        else:
            states, numbers = best.found.states, best.constants
            before = {curve.name: curve for curve in best.curves}
            values = [before[curve.name](curve.knots) for curve in curves]
        problem = _Curved(
            dict(system.equations),
            rows.mesh,
            along,
            system,
            tuple(c.with_values(v) for c, v in zip(curves, values, strict=True)),
            tuple(numbers.tolist()),
            (0.0,) * len(curves),
        )
        ways = _ways(system, rows.mesh, curves)
        problem = replace(problem, costs=tuple(_alike(problem)))
        fit = _solve(problem, ways, states, rows.least, settings)
        if fit is None or (best is not None and not fit.bits < best.bits - 1):
            break
        best = fit
    return best


def flat_curves(system: CurvedSystem, mesh: Mesh, count: int) -> list[Curve]:
    """Give a constant curve for each function; none where one has fewer than three values.

    Parameters
    ----------
    system, mesh : the functions, and the data.
    count : of the knots.
    """
    found = []
    for part in system.parts:
        own = mesh.columns[part.of]
        knots = place_knots(own, count)
        # What differs by rounding is one value.
        if len(knots) < 3 or np.ptp(own) < np.sqrt(np.finfo(float).eps) * np.max(np.abs(own)):
            return []
        found.append(Curve(part.name, knots, np.full(len(knots), part.mean or 0.0)))
    return found


def refit_curved(
    system: CurvedSystem,
    near: CurvedFit,
    numbers: Sequence[float],
    settings: CurvedSettings = CURVED,
) -> CurvedFit | None:
    """Fit a like system from where another fit ended; None where that cannot be done.

    Parameters
    ----------
    system : the equations; its curves are some of those of the fit.
    near : the fit.
    numbers : where its constants start.
    settings : the numbers that decide.
    """
    known = {
        part.name: (curve, cost)
        for part, curve, cost in zip(
            near.problem.system.parts, near.curves, near.problem.costs, strict=True
        )
    }
    kept = [known[part.name] for part in system.parts]
    problem = replace(
        near.problem,
        exprs=dict(system.equations),
        system=system,
        curves=tuple(curve for curve, _ in kept),
        numbers=tuple(numbers),
        costs=tuple(cost for _, cost in kept),
    )
    ways = _ways(system, problem.mesh, problem.curves)
    return _solve(problem, ways, near.found.states, near.least, settings)


def _solve(
    problem: _Curved,
    ways: np.ndarray,
    states: np.ndarray,
    least: np.ndarray,
    settings: CurvedSettings,
) -> CurvedFit | None:
    """Fit, and choose what bending costs, in turns."""
    fit: CurvedFit | None = None
    for _ in range(settings.rounds):
        found = problem.fit_tied(
            np.ascontiguousarray(states.T), problem.ties @ ways, fit is not None
        )
        if found is None or not np.all(np.isfinite(found.misses)):
            return fit
        fit, states = CurvedFit(problem, ways, found, least, settings), found.states
        if not problem.costs:
            break
        costs = _choose_costs(fit, settings)
        if np.max(np.abs(np.log(costs / np.array(problem.costs)))) < settings.close:
            break
        problem = replace(
            problem,
            costs=tuple(costs.tolist()),
            numbers=tuple(fit.constants.tolist()),
            curves=tuple(fit.curves),
        )
    return fit


def _ways(system: CurvedSystem, mesh: Mesh, curves: Sequence[Curve]) -> np.ndarray:
    """(N, Q) directions in which the numbers may go: some curves keep their mean over the data."""
    blocks = [np.eye(len(system.constants))]
    for part, curve in zip(system.parts, curves, strict=True):
        count = len(curve.knots)
        if part.mean is None:
            blocks.append(np.eye(count))
            continue
        mean = curve.weights(mesh.columns[part.of]).mean(axis=0)
        blocks.append(np.linalg.svd(mean[None])[2][1:].T)
    return np.asarray(block_diag(*blocks))


def _first_bending(
    curves: Sequence[Curve],
    sizes: np.ndarray,
    gaps: Callable[[np.ndarray], np.ndarray],
    settings: CurvedSettings,
) -> np.ndarray:
    """(N, N) what bending costs a first fit; the values of each curve begin at its size."""
    # What a curve moves by says what its bending is worth.
    level = np.ones(sizes[-1] + len(curves[-1].knots))
    blocks = [np.zeros((sizes[0], sizes[0]))]
    for curve, begin in zip(curves, sizes, strict=True):
        higher = level.copy()
        higher[begin : begin + len(curve.knots)] += 1.0
        worth = settings.faint * float(np.linalg.norm(gaps(higher) - gaps(level)))
        values, ways = np.linalg.eigh(curve.roughness)
        shares = np.sqrt(np.maximum(values, 0.0) / max(values.max(), 1e-300))
        blocks.append(worth * (shares * ways).T)
    return np.asarray(block_diag(*blocks))


def first_numbers(
    system: CurvedSystem,
    mesh: Mesh,
    curves: Sequence[Curve],
    slopes: Slopes,
    settings: CurvedSettings = CURVED,
) -> np.ndarray:
    """Fit constants, and the values of curves, to the slopes of the smoothed states.

    Parameters
    ----------
    system, mesh : the equations and the data.
    curves : what they start from.
    slopes : of the states.
    settings : the numbers that decide.

    Gives (N,): the constants, then the values of each curve.
    """
    ways = _ways(system, mesh, curves)
    rows = np.unique(np.linspace(0, slopes.values.shape[1] - 1, settings.points).astype(int))
    names = [*mesh.states, *mesh.driven_names]
    columns = [slopes.columns[name][rows] for name in names]
    weights = [
        c.weights(columns[names.index(p.of)]) for p, c in zip(system.parts, curves, strict=True)
    ]
    program, turning = system.program(mesh), system.by_numbers(mesh)
    count = len(system.constants)
    sizes = np.cumsum([count, *(len(curve.knots) for curve in curves)])[:-1]
    wanted, unit = slopes.values[:, rows], np.maximum(slopes.errors[:, rows], 1e-300)
    # A start need not follow slopes to more than a share of their size.
    unit = np.maximum(unit, settings.rough * np.std(wanted, axis=1, keepdims=True) + 1e-300)
    offset = np.concatenate([np.zeros(count), *(curve.values for curve in curves)])

    def arguments(numbers: np.ndarray) -> list[Any]:
        own, *values = np.split(numbers, sizes)
        return [*columns, *own, *(w @ v for w, v in zip(weights, values, strict=True))]

    def gaps(numbers: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            found = (program(*arguments(numbers)) - wanted) / unit
        return np.nan_to_num(found, posinf=0, neginf=0).ravel()

    def turns(numbers: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            found = turning(*arguments(numbers)).reshape(len(unit), -1, len(rows)) / unit[:, None]
        found = np.nan_to_num(found, posinf=0, neginf=0)
        heights = found[:, count:].swapaxes(0, 1)
        bent = [h[:, None] * w.T for h, w in zip(heights, weights, strict=True)]
        every = np.concatenate([found[:, :count], *bent], axis=1)
        return every.swapaxes(1, 2).reshape(-1, len(offset))

    rough = _first_bending(curves, sizes, gaps, settings)

    def missed(free: np.ndarray) -> np.ndarray:
        numbers = offset + ways @ free
        return np.concatenate([gaps(numbers), rough @ numbers])

    def moved(free: np.ndarray) -> np.ndarray:
        return np.concatenate([turns(offset + ways @ free), rough]) @ ways

    def descend(start: np.ndarray) -> tuple[float, np.ndarray]:
        first = ways.T @ (np.concatenate([start, np.ones(len(offset) - count)]) - offset)
        # How small a step ends the descent is said for constants near 1.
        units = np.concatenate([start, np.ones(len(first) - count)])
        found = least_squares(
            lambda free: missed(units * free),
            first / units,
            lambda free: moved(units * free) * units,
            x_scale="jac",
        )
        cost = float(found.cost)
        return cost if math.isfinite(cost) else math.inf, offset + ways @ (units * found.x)

    begun = [np.full(count, start) for start in settings.starts[: None if count else 1]]
    ends = [descend(start) for start in begun]
    least = min(cost for cost, _ in ends)
    # Of starts that end alike, the first.
    place = next((i for i, (cost, _) in enumerate(ends) if cost < least + 1), 0)
    start, (least, best) = begun[place], ends[place]
    # A constant may be as large as a column, or as one over it.
    logs = {round(math.log(float(np.std(own)) or 1.0)) for own in columns} - {0}
    factors = [math.exp(sign * own) for own in sorted(logs) for sign in (1, -1)]
    for _ in range(count):
        others = [
            start * np.where(np.arange(count) == i, f, 1.0) for i in range(count) for f in factors
        ]
        ends = [descend(other) for other in others]
        place = min(range(len(ends)), key=lambda i: ends[i][0], default=-1)
        if place < 0 or not ends[place][0] < least - 1:
            break
        start, (least, best) = others[place], ends[place]
    return best


def _alike(problem: _Curved) -> list[float]:
    """Give costs with which bending weighs as much as the data do."""
    free = replace(problem, costs=(0.0,) * len(problem.costs))
    try:
        found = free.normal(problem.mesh.start, problem.constants)
        own = problem.ties.T @ found.information @ problem.ties
    except (LinAlgError, ValueError):
        own = np.eye(problem.ties.shape[1])
    first, costs = len(problem.numbers), []
    for curve in problem.curves:
        block = slice(first, first + len(curve.knots))
        first = block.stop
        size = float(np.trace(own[block, block])) / float(np.trace(curve.roughness))
        costs.append(size if size > 0 and math.isfinite(size) else 1.0)
    return costs


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """The marginal likelihood of other costs of bending, near a fit.

    The sum of squares is taken for the parabola that it is near the fit.

    Parameters
    ----------
    told : (Q, Q) what the data say of the numbers.
    now : (parts,) the costs of the fit.
    forms, ahead, levels : of the bending of each curve, as a parabola in what the numbers move by.
    squares : the sum of squares of the fit.
    ranks : of the forms.
    rows : the degrees of freedom; 0 where noise is known.
    """

    told: np.ndarray
    now: np.ndarray
    forms: np.ndarray
    ahead: np.ndarray
    levels: np.ndarray
    squares: float
    ranks: tuple[int, ...]
    rows: int

    @classmethod
    def of(cls, fit: CurvedFit) -> _Likelihood:
        """Give that of a fit."""
        problem, ways = fit.problem, fit.ways
        # The numbers move from where they are; what the mean of a curve is fixed at stays.
        shapes, pulls, levels = [], [], []
        numbers = fit.numbers
        for block, curve in zip(fit.blocks, fit.curves, strict=True):
            shape = np.zeros((len(numbers),) * 2)
            shape[block, block] = curve.roughness
            shapes.append(ways.T @ shape @ ways)
            pulls.append(ways.T @ shape @ numbers)
            levels.append(float(numbers @ shape @ numbers))
        ranks = tuple(int(np.linalg.matrix_rank(shape, hermitian=True)) for shape in shapes)
        rows = problem.mesh.freedom(0) - (ways.shape[1] - sum(ranks))
        return cls(
            fit.information,
            np.array(problem.costs),
            np.array(shapes),
            np.array(pulls),
            np.array(levels),
            fit.found.squares,
            ranks,
            max(rows, 1) if math.isfinite(fit.freedom) else 0,
        )

    def __call__(self, moves: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Give minus twice the logarithm for costs, what the numbers move by, and their covariance.

        Parameters
        ----------
        moves : (parts,) of the logarithms of the costs.
        """
        costs = self.now * np.exp(moves)
        # At the fit the slope of the data's part is minus that of the bending.
        pull = np.einsum("j,jq->q", costs - self.now, self.ahead)
        whole = self.told + np.einsum("j,jpq->pq", costs, self.forms)
        inverse = np.linalg.pinv(whole, hermitian=True)
        step = -inverse @ pull
        paid = self.squares + float(costs @ self.levels) + float(pull @ step)
        logs = np.linalg.slogdet(whole)[1] - float(np.dot(self.ranks, np.log(costs)))
        found = self.rows * math.log(max(paid, 1e-300)) if self.rows else paid
        # Where the data say nothing of some direction, no cost is better than another.
        return found + float(logs) if np.isfinite(found + logs) else 1e300, step, inverse


def _choose_costs(fit: CurvedFit, settings: CurvedSettings) -> np.ndarray:
    """(parts,) the costs of bending with the largest marginal likelihood, near a fit."""
    likelihood = _Likelihood.of(fit)
    centre = np.log(likelihood.now)
    reach = settings.widest
    around = np.log(_alike(fit.problem)) - centre
    bounds = [(low - reach, low + reach) for low in around]
    starts = [np.zeros(len(centre)), around, around - reach / 2, around + reach / 2]
    tries = [
        minimize(
            lambda moves: likelihood(moves)[0],
            np.clip(s, *np.array(bounds).T),
            bounds=bounds,
            method="Nelder-Mead",
        )
        for s in starts
    ]
    best = min(tries, key=lambda one: float(one.fun))
    return np.asarray(np.exp(centre + best.x))
