"""Mixed: a system whose parameters are shared by all runs, or differ between groups of runs.

The joint fit of states and constants (:mod:`dynsr.fit.collocation`) is that of all runs together. A
parameter that differs is one constant for each group of runs, times a column that is 1 along those
runs and 0 along others. Places of one parameter are kept alike.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy
from scipy.linalg import LinAlgError

from dynsr.data import Trajectory
from dynsr.fit.collocation import (
    Collocation,
    CollocationFit,
    Measurements,
    Mesh,
    covariance_of,
    usual_scales,
)
from dynsr.fit.settings import FIT, CollocationSettings
from dynsr.fit.whole import interval_reach

# Origin of a trajectory that says which run it is a part of.
_RUN = "run of a mixed fit"
Groups = Mapping[str, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class MixedMesh:
    """The rows of some runs, and which run each is of.

    Parameters
    ----------
    mesh : the rows.
    run : (n,) the run of every row.
    least : (k,) mean squared residual of a state, in units of its noise, below which nothing is
        believed: 1 where so little noise was found that none is, and 0 elsewhere.
    """

    mesh: Mesh
    run: np.ndarray
    least: np.ndarray

    @classmethod
    def of(cls, data: Measurements, states: Sequence[str]) -> MixedMesh:
        """Give the rows of all runs.

        Parameters
        ----------
        data : measurements of :func:`measure_runs`.
        states : whose equations are fitted.
        """
        mesh = data.mesh(states)
        begins = np.ones(len(mesh.t), dtype=bool)
        begins[mesh.left + 1] = False
        marks = np.array([int(run.origin[_RUN]) for run in data.runs])
        own = [data.runs[0].index(state) for state in states]
        noise = np.concatenate([smoothed.noise[:, own] for smoothed in data.smoothed])
        given = np.concatenate([deviation[:, own] for deviation in data.deviations])
        raised = np.any(np.isfinite(given) & (noise < given), axis=0)
        return cls(mesh, marks[np.cumsum(begins) - 1], raised.astype(float))

    @property
    def count(self) -> int:
        """How many runs there are."""
        return int(self.run.max()) + 1

    @cached_property
    def runs(self) -> list[MixedMesh]:
        """The rows of each run alone, as those of a first one."""
        return [self._only(number) for number in range(self.count)]

    def _only(self, number: int) -> MixedMesh:
        mesh, own = self.mesh, self.run == number
        between = own[mesh.left]
        place = np.cumsum(own) - 1
        kept = np.concatenate([own, between])
        part = replace(
            mesh,
            t=mesh.t[own],
            left=place[mesh.left[between]],
            x=mesh.x[own],
            weights=mesh.weights[own],
            start=mesh.start[own],
            driven=mesh.driven[:, kept],
            censored=None if mesh.censored is None else mesh.censored.at(own),
        )
        return MixedMesh(part, np.zeros(len(part.t), dtype=int), self.least)

    def with_groups(self, groups: Groups) -> tuple[Mesh, dict[str, list[str]]]:
        """Give the rows with columns that are 1 along a group of runs; parameter -> their names.

        Parameters
        ----------
        groups : parameter -> the group of each run; one group needs no column.
        """
        mesh = self.mesh
        run = np.concatenate([self.run, self.run[mesh.left]])
        named, rows = dict[str, list[str]](), []
        for name, own in groups.items():
            each = np.asarray(own)[run]
            count = max(own) + 1
            named[name] = [f"{name} of group {i}" for i in range(count)] if count > 1 else []
            rows += [(each == i).astype(float) for i in range(count)] if count > 1 else []
        names = (*mesh.driven_names[:-1], *(n for own in named.values() for n in own), "t")
        driven = np.concatenate([mesh.driven[:-1], *[row[None] for row in rows], mesh.driven[-1:]])
        return replace(mesh, driven=driven, driven_names=names), named


def measure_runs(
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    rows: int,
    derived: Mapping[str, sympy.Symbol],
) -> Measurements:
    """Estimate the noise of runs and smooth them; each knows which one it is, and none is left out.

    Parameters
    ----------
    runs, inputs, derived : as for :meth:`Measurements.of`.
    rows : of more rows than this in all, evenly spaced ones are kept, of each run enough.
    """
    marked = [replace(run, origin={**run.origin, _RUN: i}) for i, run in enumerate(runs)]
    coarsest = max(1, (min(map(len, runs)) - 1) // 4)
    least = -(-sum(map(len, runs)) // coarsest)
    return Measurements.of(marked, inputs, max(rows, least), derived)


@dataclass(frozen=True, eq=False)
class _Grouped(Collocation):
    """A system whose constants are those of groups of runs.

    Parameters
    ----------
    places : (state, parameter, group, column) of every constant; the column is "" for all runs.
    values : of the constants.
    """

    places: tuple[tuple[str, str, int, str], ...] = ()
    values: tuple[float, ...] = ()

    @cached_property
    def _template(self) -> tuple[dict[str, sympy.Expr], dict[sympy.Symbol, float]]:
        symbols = [_constant(state, name, group) for state, name, group, _ in self.places]
        return dict(self.exprs), dict(zip(symbols, self.values, strict=True))

    @cached_property
    def _owners(self) -> tuple[np.ndarray, np.ndarray]:
        """Constants of one parameter for several groups may be moved together: one rank."""
        ranks: list[int] = []
        known: dict[str, list[str]] = {}
        for state, name, _, _ in self.places:
            own = known.setdefault(state, [])
            if name not in own:
                own.append(name)
            ranks.append(own.index(name))
        owners = [self.mesh.states.index(state) for state, *_ in self.places]
        return np.array(owners, dtype=int), np.array(ranks, dtype=int)

    @cached_property
    def _columns(self) -> tuple[np.ndarray, np.ndarray]:
        """(P,) whether a constant is of all runs, and the place of its column otherwise."""
        names = self.mesh.driven_names
        found = [names.index(column) if column else 0 for *_, column in self.places]
        return np.array([not column for *_, column in self.places]), np.array(found, dtype=int)

    def _split(
        self, states: np.ndarray, constants: np.ndarray, driven: np.ndarray, steps: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        base, by_states, by_constants = super()._split(states, constants, driven, steps)
        everywhere, columns = self._columns
        own = np.where(everywhere[:, None], 1.0, driven[columns])
        return base, by_states, by_constants * own


def _constant(state: str, name: str, group: int) -> sympy.Symbol:
    return sympy.Symbol(f"constant {state} {name} {group}")


@dataclass(frozen=True, eq=False)
class Mixed:
    """Equations with parameters, each shared by all runs or one for each group of them.

    Parameters
    ----------
    equations : state -> right-hand side in columns and parameters.
    groups : parameter -> the group of each run, from 0.
    """

    equations: Mapping[str, sympy.Expr]
    groups: Groups

    @property
    def counts(self) -> dict[str, int]:
        """Parameter -> how many groups it has."""
        return {name: max(own) + 1 for name, own in self.groups.items()}

    @property
    def varied(self) -> tuple[str, ...]:
        """Parameters that differ."""
        return tuple(name for name, count in self.counts.items() if count > 1)

    def names(self) -> Iterator[tuple[str, int]]:
        """Give parameter and group of every number that is fitted."""
        return ((name, group) for name, count in self.counts.items() for group in range(count))

    def problem(
        self, rows: MixedMesh, theta: np.ndarray, settings: CollocationSettings = FIT.along
    ) -> tuple[_Grouped, np.ndarray]:
        """Give the least-squares problem, and (P, Q) which of its constants each number is.

        Parameters
        ----------
        rows : the data.
        theta : (Q,) the numbers, in the order of :meth:`names`.
        settings : the numbers that decide.
        """
        mesh, columns = rows.with_groups(self.groups)
        order = list(self.names())
        number = {key: i for i, key in enumerate(order)}
        shapes, places = {}, list[tuple[str, str, int, str]]()
        for state in mesh.states:
            expr = self.equations[state]
            for name, own in columns.items():
                symbol = sympy.Symbol(name)
                if symbol not in expr.free_symbols:
                    continue
                each = [_constant(state, name, group) for group in range(max(len(own), 1))]
                parts = [c * sympy.Symbol(j) for c, j in zip(each, own, strict=False)] or each
                expr = _put(expr, symbol, parts)
                places += [(state, name, g, own[g] if own else "") for g in range(len(each))]
            shapes[state] = expr
        which = [number[name, group] for _, name, group, _ in places]
        ways = np.zeros((len(places), len(order)))
        ways[np.arange(len(places)), which] = 1.0
        values = tuple(np.asarray(theta, dtype=float)[which].tolist())
        return _Grouped(shapes, mesh, settings, tuple(places), values), ways

    def fit(
        self,
        rows: MixedMesh,
        theta: np.ndarray,
        states: np.ndarray | None = None,
        settings: CollocationSettings = FIT.along,
    ) -> MixedFit | None:
        """Fit all numbers and the states; None where that cannot be done.

        Parameters
        ----------
        rows : the data.
        theta : (Q,) where the numbers start.
        states : (n, k) where the states start; by default where the smoothed data are.
        settings : the numbers that decide.
        """
        problem, ways = self.problem(rows, theta, settings)
        begin = rows.mesh.start if states is None else states
        start = np.ascontiguousarray(begin.T)
        found = problem.fit_tied(start, ways, states is not None)
        if found is None or not np.all(np.isfinite(found.misses)):
            return None
        return MixedFit(problem, ways, found, rows.least, self)


def _put(expr: sympy.Expr, symbol: sympy.Symbol, parts: Sequence[sympy.Expr]) -> sympy.Expr:
    """Put a sum in the place of a parameter; a factor of a term makes a term of each part."""
    terms = []
    for term in sympy.Add.make_args(expr):
        if symbol in sympy.Mul.make_args(term):
            terms += [term.xreplace({symbol: part}) for part in parts]
        else:
            terms.append(term.xreplace({symbol: sympy.Add(*parts)}))
    return sympy.Add(*terms)


@dataclass(frozen=True, eq=False)
class ScaledFit(ABC):
    """A fit to states whose noise is an estimate: what it misses says how large noise is.

    Parameters
    ----------
    problem : the least-squares problem.
    ways : (N, Q) directions in which its numbers could go.
    found : its solution.
    least : (k,) mean squared residual of a state, in units of its noise, below which nothing is
        believed.
    """

    problem: Collocation
    ways: np.ndarray
    found: CollocationFit
    least: np.ndarray

    @property
    @abstractmethod
    def fitted(self) -> int:
        """How many numbers were fitted."""

    @property
    def freedom(self) -> float:
        """Measurements less what was fitted to them; without end where the noise is known."""
        mesh = self.problem.mesh
        return math.inf if bool(np.all(mesh.known)) else float(mesh.freedom(self.fitted))

    @property
    def reach(self) -> float:
        """Standard errors that a 95 % interval reaches to either side."""
        return interval_reach(self.freedom)

    @cached_property
    def scale(self) -> float:
        """Variance of the residuals in units of the noise that was given: noise is an estimate."""
        if not math.isfinite(self.freedom):
            return 1.0
        own = np.sum(self.found.misses**2, axis=0)
        least = self.least * self.problem.mesh.rows
        return max(float(np.sum(np.maximum(own, least))) / self.freedom, np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class MixedFit(ScaledFit):
    """A mixed system that was fitted; its ways (P, Q) say which of its constants each number is.

    Parameters
    ----------
    mixed : the system.
    """

    problem: _Grouped
    mixed: Mixed

    @cached_property
    def mean_squares(self) -> np.ndarray:
        """(k,) mean squared residuals of the states in units of their noise."""
        return np.maximum(self.found.mean_squares, np.maximum(self.least, 1e-300))

    @cached_property
    def cost(self) -> float:
        """Sum of squares that the fit ends in."""
        return self.problem.cost(np.ascontiguousarray(self.found.states.T), self.found.constants)

    @cached_property
    def theta(self) -> np.ndarray:
        """(Q,) the fitted numbers, in the order of the system's names."""
        values: np.ndarray = self.ways.T @ self.found.constants / self.ways.sum(axis=0)
        return values

    @cached_property
    def information(self) -> np.ndarray:
        """(Q, Q) what the data say of the numbers, at the noise that was given."""
        own: np.ndarray = self.ways.T @ self.found.information @ self.ways
        return own

    @property
    def fitted(self) -> int:
        """How many numbers were fitted."""
        return len(self.theta)

    @cached_property
    def covariance(self) -> np.ndarray:
        """(Q, Q) of the numbers; inf where the data do not determine it."""
        try:
            return covariance_of(self.information) * self.scale
        except LinAlgError:
            return np.full_like(self.information, np.inf)

    @cached_property
    def scales(self) -> np.ndarray:
        """(Q,) changes of the numbers that change an equation by as much as it says.

        That of one group is what it would be for all runs.
        """
        problem, mesh = self.problem, self.problem.mesh
        base, slopes = problem.slopes_of(self.found)
        kinds: dict[tuple[str, str], int] = {}
        kind = np.array([kinds.setdefault(key[:2], len(kinds)) for key in problem.places], int)
        # Groups do not meet: their slopes add up to that of all runs.
        every = np.zeros((len(kinds), slopes.shape[1]))
        np.add.at(every, kind, slopes)
        owners = np.array([mesh.states.index(state) for state, _ in kinds], int)
        own = usual_scales(base, owners, every)[kind]
        return np.min(np.where(self.ways > 0, own[:, None], np.inf), axis=0, initial=np.inf)
