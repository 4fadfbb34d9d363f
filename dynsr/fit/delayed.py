"""Delayed: a system whose equations contain its own columns as they were some time before.

States, constants and the delay are fitted together by collocation (:mod:`dynsr.fit.collocation`). A
column at an earlier time is interpolated between rows of the fitted states themselves, so that its
noise, and how it changes with the delay, are counted. The rule holds from some time after the first
row on, since the first part of a run is only history. There the states are those of a smoothing
spline of order 5 (Wahba 1978): their third derivative is white noise, as large as in the curves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import sympy
from scipy import sparse
from scipy.linalg import cho_solve_banded

from dynsr.fit.collocation import Linearised, Mesh, Probes, _Gathered, _Point
from dynsr.fit.description import residual_bits
from dynsr.fit.mixed import Mixed, MixedFit, MixedMesh, _Grouped
from dynsr.fit.settings import FIT, CollocationSettings

# Rows between which a column at an earlier time is interpolated.
_STENCIL = 6
_DELAY = "time before"
# Share of the delay by which one step may move it.
_STEP = 0.1


@dataclass(frozen=True, eq=False)
class DelayedMesh(Mesh):
    """The rows of runs whose columns are also needed as they were some time before.

    Parameters
    ----------
    sources : (e,) which of the states, and then of the driven columns, the first e driven columns
        are at an earlier time.
    begin : time after the first row of each run from which on states follow the equations.
    """

    sources: tuple[int, ...] = ()
    begin: float = 0.0

    @classmethod
    def of(cls, mesh: Mesh, names: Mapping[str, str], begin: float) -> DelayedMesh:
        """Give a mesh with columns at an earlier time.

        Parameters
        ----------
        mesh : the rows.
        names : column -> its name at an earlier time.
        begin : time after the first row of each run from which on states follow the equations.
        """
        driven = np.concatenate([np.zeros((len(names), mesh.driven.shape[1])), mesh.driven])
        columns = (*mesh.states, *names.values(), *mesh.driven_names)
        own = {f.name: getattr(mesh, f.name) for f in mesh.__dataclass_fields__.values()}
        own |= {"driven": driven, "driven_names": columns[len(mesh.states) :]}
        return cls(**own, sources=tuple(map(columns.index, names)), begin=begin)

    def at(self, delay: float) -> DelayedMesh:
        """Give the mesh with columns at an earlier time as the smoothed states were.

        Parameters
        ----------
        delay : how much earlier.
        """
        driven = self.driven.copy()
        driven[: len(self.sources)] = self.before(self.start.T, delay)[0]
        return replace(self, driven=driven)

    @cached_property
    def firsts(self) -> np.ndarray:
        """(n,) the first row of the run that each row is of."""
        inner = np.zeros(len(self.t), dtype=bool)
        inner[self.left + 1] = True
        found: np.ndarray = np.maximum.accumulate(np.where(inner, 0, np.arange(len(self.t))))
        return found

    @cached_property
    def follows(self) -> np.ndarray:
        """(n,) whether a row is no mere history."""
        found: np.ndarray = self.t - self.t[self.firsts] >= self.begin
        return found

    @cached_property
    def unit(self) -> np.ndarray:
        """(m, k) what defects are in; inf where states are free."""
        own: np.ndarray = Mesh.unit.func(self)  # type: ignore[attr-defined]
        return np.where(self.follows[self.left, None], own, np.inf)

    @cached_property
    def points(self) -> np.ndarray:
        """(n + m,) times of the rows, then of the middle of the intervals."""
        return np.concatenate([self.t, self.t[self.left] + self.h / 2])

    @cached_property
    def _segments(self) -> tuple[np.ndarray, np.ndarray]:
        """(n,) first and last row of the piece of a run, without a jump, that each row is in."""
        ends = np.ones(len(self.t), dtype=bool)
        ends[self.left[self.h > 0]] = False
        lasts = np.flatnonzero(ends)
        which = np.searchsorted(lasts, np.arange(len(self.t)))
        return np.append(0, lasts[:-1] + 1)[which], lasts[which]

    def weights_before(
        self, times: np.ndarray, delay: float
    ) -> tuple[sparse.csr_array, sparse.csr_array]:
        """Give (points, n) what rows count in the columns at an earlier time, and its derivative.

        Lagrange's polynomials through six rows, and their derivatives by the delay.

        Parameters
        ----------
        times : (m,) in the intervals, or (n + m,) at the rows and in the intervals, in their order.
        delay : how much earlier.
        """
        n, count = len(self.t), len(times)
        between = count == len(self.left)
        owner = self.left if between else np.concatenate([np.arange(n), self.left])
        first = self.firsts[owner]
        wanted = times - delay
        inside = wanted >= self.t[first]
        wanted = np.maximum(wanted, self.t[first])
        place = np.empty(count, dtype=int)
        bounds = [*np.flatnonzero(self.firsts == np.arange(n)), n]
        for a, b in pairwise(bounds):
            own = first == a
            place[own] = a + np.searchsorted(self.t[a:b], wanted[own], side="right") - 1
        # The last row of a piece begins no interval.
        low, high = (side[place] for side in self._segments)
        start = np.maximum(np.minimum(place - _STENCIL // 2 + 1, high - _STENCIL + 1), low)
        rows = start[:, None] + np.arange(_STENCIL)
        there = rows <= high[:, None]
        rows = np.minimum(rows, high[:, None])
        at = self.t[rows]
        value, slope = np.where(there, 1.0, 0.0), np.zeros(rows.shape)
        for i in range(_STENCIL):
            for j in range(_STENCIL):
                if i == j:
                    continue
                apart = np.where(there[:, j] & there[:, i], at[:, i] - at[:, j], np.inf)
                share = np.where(np.isinf(apart), 1.0, (wanted - at[:, j]) / apart)
                slope[:, i] = slope[:, i] * share + value[:, i] / apart
                value[:, i] *= share
        slope *= np.where(inside, -1.0, 0.0)[:, None]
        indices = np.arange(0, rows.size + 1, _STENCIL)
        return (
            sparse.csr_array((value.ravel(), rows.ravel(), indices), shape=(count, n)),
            sparse.csr_array((slope.ravel(), rows.ravel(), indices), shape=(count, n)),
        )

    @cached_property
    def _known_weights(self) -> dict[float, tuple[sparse.csr_array, sparse.csr_array]]:
        """Delay -> its weights at all points, of the last one: a step asks for them many times."""
        return {}

    def point_weights(self, delay: float) -> tuple[sparse.csr_array, sparse.csr_array]:
        """Give :meth:`weights_before` of all points.

        Parameters
        ----------
        delay : how much earlier.
        """
        if delay not in self._known_weights:
            self._known_weights.clear()
            self._known_weights[delay] = self.weights_before(self.points, delay)
        return self._known_weights[delay]

    def before(
        self, states: np.ndarray, delay: float, times: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Give (e, points) columns at an earlier time, and their derivatives by the delay.

        Parameters
        ----------
        states : (k, n) at the rows.
        delay, times : as for :meth:`weights_before`; by default all points.
        """
        rows = np.concatenate([states, self.driven[:, : len(self.t)]])[list(self.sources)]
        found = self.point_weights(delay) if times is None else self.weights_before(times, delay)
        weights, slopes = found
        return (weights @ rows.T).T, (slopes @ rows.T).T

    @cached_property
    def roughness(self) -> sparse.csr_array:
        """(r, n k) third derivatives of the history, in standard deviations of their noise."""
        n, k = len(self.t), len(self.states)
        high = self._segments[1]
        some = np.arange(n - 3)
        some = some[(high[some] >= some + 3) & ~self.follows[some + 2]]
        scales = self._wildness
        rows = some[:, None] + np.arange(4)
        at = self.t[rows]
        parts = np.ones(rows.shape)
        for i in range(4):
            for j in range(4):
                if i != j:
                    parts[:, i] /= at[:, i] - at[:, j]
        parts *= math.factorial(3) * np.sqrt((at[:, 3] - at[:, 0]) / 3)[:, None]
        blocks = []
        for j in range(k):
            place = (np.repeat(np.arange(len(some)), 4), rows.ravel() * k + j)
            blocks.append(
                sparse.csr_array(((parts / scales[j]).ravel(), place), shape=(len(some), n * k))
            )
        return sparse.csr_array(sparse.vstack(blocks))

    @cached_property
    def _wildness(self) -> np.ndarray:
        """(k,) root of the intensity of the third derivatives of the smoothed states.

        It is their mean square times the time over which they keep their sign, which is that in
        which second derivatives change by their own size.
        """
        low = self._segments[0]
        measured = np.flatnonzero(self.measured)
        second, third = [], []
        for own in np.unique(low):
            rows = measured[low[measured] == own]
            if len(rows) < 4:
                continue
            t, found = self.t[rows], self.start[rows]
            for order in (1, 2, 3):
                found = order * np.diff(found, axis=0) / (t[order:] - t[:-order])[:, None]
                if order == 2:
                    second.append(found)
            third.append(found)
        if not third:
            return np.full(len(self.states), np.inf)
        sizes = [np.mean(np.concatenate(own) ** 2, axis=0) for own in (second, third)]
        return np.maximum(np.sqrt(np.sqrt(sizes[0] * sizes[1])), 1e-300)


@dataclass(frozen=True, eq=False)
class _Late(_Point):
    """The same, with the derivatives ``by_states`` (k m, n k) of the defects by all states.

    Rows are those of the first equation, of the second, ...; columns the states of the first row
    of the mesh, of the second, ...
    """

    by_states: sparse.csr_array


@dataclass(frozen=True, eq=False)
class DelayedCollocation(_Grouped):
    """The least-squares problem of a system with columns at an earlier time.

    The last of its constants is the delay.
    """

    mesh: DelayedMesh

    @property
    def _count(self) -> int:
        return len(self.mesh.sources)

    def _reach(self, constants: np.ndarray) -> np.ndarray:
        reach = super()._reach(constants)
        reach[-1] = _STEP * abs(constants[-1])
        return reach

    def driven(self, states: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """(d, n + m) driven columns, of which the first are those of the states before.

        Parameters
        ----------
        states : (k, n) the trajectory.
        constants : (P,) values.
        """
        found = self.mesh.driven.copy()
        found[: self._count] = self.mesh.before(states, constants[-1])[0]
        return found

    def _quarters(self, states: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sides = super()._quarters(states, constants)
        middle = self.mesh.points[len(self.mesh.t) :]
        for found, sign in zip(sides, (-1, 1), strict=True):
            times = middle + sign * self.mesh.h / 4
            found[: self._count] = self.mesh.before(states, constants[-1], times)[0]
        return sides

    def _by_earlier(
        self, states: np.ndarray, constants: np.ndarray, driven: np.ndarray
    ) -> np.ndarray:
        """(k, e, points) derivatives of the right-hand sides by the columns at an earlier time."""
        count, e = self._count, np.arange(self._count)
        sizes = np.abs(driven[:count]).max(axis=1, initial=0.0)
        steps = self.settings.difference * np.maximum(sizes, 1e-300)
        rows = np.repeat(driven[:, None], 1 + count, axis=1)
        rows[e, 1 + e] += steps[:, None]
        found = self.slope(*states[:, None], *rows, *constants)
        by: np.ndarray = (found[:, 1:] - found[:, :1]) / steps[:, None]
        return by

    def slopes_at_rows(
        self, states: np.ndarray, constants: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(k, n) right-hand sides at the rows, and their derivatives by the delay.

        Parameters
        ----------
        states : (k, n) the trajectory.
        constants : (P,) values.
        """
        n = len(self.mesh.t)
        driven = self.driven(states, constants)[:, :n]
        moved = self.mesh.before(states, constants[-1])[1][:, :n]
        by = self._by_earlier(states, constants, driven)
        return self.slope(*states, *driven, *constants), np.einsum("aen,en->an", by, moved)

    def _linearise(
        self, states: np.ndarray, constants: np.ndarray, probes: Probes | None = None
    ) -> _Late:
        point = super()._linearise(states, constants, probes)
        mesh, n = self.mesh, len(self.mesh.t)
        (left, right), sixth, eighth = mesh.ends, mesh.sixth, mesh.eighth
        driven, middle = self.driven(states, constants), self._along(states, constants)[1]
        at_rows = self._by_earlier(states, constants, driven[:, :n])
        inside = self._by_earlier(middle, constants, driven[:, n:])
        low, high = at_rows[..., left], at_rows[..., right]
        unit = mesh.by_state[2][:, None]
        earlier = (
            -sixth * (low + 4 * eighth * np.einsum("acm,cem->aem", point.inside, low)) / unit,
            -sixth * (high - 4 * eighth * np.einsum("acm,cem->aem", point.inside, high)) / unit,
            -sixth * 4 * inside / unit,
        )
        moved = mesh.before(states, constants[-1])[1]
        by_constant = point.by_constant.copy()
        by_constant[:, len(constants) - 1] = sum(
            np.einsum("aem,em->am", by, to)
            for by, to in zip(
                earlier, (moved[:, :n][:, left], moved[:, :n][:, right], moved[:, n:]), strict=True
            )
        )
        by_states = self._by_states(point, earlier, constants[-1])
        own = {f: getattr(point, f) for f in _Point.__dataclass_fields__}
        return _Late(**{**own, "by_constant": by_constant}, by_states=by_states)

    def _cost(self, states: np.ndarray, constants: np.ndarray, stiffness: float) -> float:
        rough = self.mesh.roughness @ states.T.ravel()
        return super()._cost(states, constants, stiffness) + float(rough @ rough)

    def _by_states(
        self, point: _Point, earlier: Sequence[np.ndarray], delay: float
    ) -> sparse.csr_array:
        """(k m, n k) derivatives of the defects by the states.

        Parameters
        ----------
        point : where.
        earlier : (k, e, m) derivatives by the columns at an earlier time, at the left end of each
            interval, at its right end and in its middle.
        delay : how much earlier.
        """
        mesh = self.mesh
        (k, m), n, (left, right) = point.defects.shape, len(mesh.t), mesh.ends
        every, span = np.arange(n), np.arange(m)
        weights = mesh.point_weights(delay)[0]
        parts = (weights[every[left]], weights[every[right]], weights[n:])
        total = sparse.csr_array((k * m, n * k))
        for a in range(k):
            for b in range(k):
                rows = np.concatenate([span, span])
                columns = np.concatenate([every[left], every[right]]) * k + b
                values = np.concatenate([point.by_left[a, b], point.by_right[a, b]])
                total += sparse.csr_array((values, (a * m + rows, columns)), shape=total.shape)
            for e, source in enumerate(mesh.sources):
                if source >= k:
                    continue
                for by, part in zip(earlier, parts, strict=True):
                    own = (sparse.diags_array(by[a, e]) @ part).tocoo()
                    place = (a * m + own.row, own.col * k + source)
                    total += sparse.csr_array((own.data, place), shape=total.shape)
        return total

    @np.errstate(all="ignore")
    def _gather(self, point: _Point, states: np.ndarray, stiffness: float) -> _Gathered:
        """Form the normal equations, whose band is as wide as the delay."""
        assert isinstance(point, _Late)
        mesh, (k, n) = self.mesh, states.shape
        x, weights, _ = mesh.by_state
        mix = np.eye(k) if mesh.mix is None else mesh.mix
        missed, more = (mesh.seen(states) - x) * weights, 0.0
        if mesh.censored is not None:
            bend, pull, more = mesh.censored.terms(mesh.seen(states))
            root = np.sqrt(bend)
            weights = weights.copy()
            weights[mesh.censored.places] = root
            missed[mesh.censored.places] = np.divide(
                pull, root, out=np.zeros_like(root), where=root > 0
            )
            more -= float(np.sum(missed[mesh.censored.places] ** 2))
        seen = sparse.diags_array(weights.T.ravel()) @ sparse.kron(sparse.eye_array(n), mix)
        by_states, rough = point.by_states, mesh.roughness
        pulls = np.concatenate([point.defects[:, None], point.by_constant], axis=1)
        flat = pulls.transpose(1, 0, 2).reshape(pulls.shape[1], -1)
        missed = missed.T.ravel()
        bent = rough @ states.T.ravel()
        normal = seen.T @ seen + stiffness * (by_states.T @ by_states) + rough.T @ rough
        sides = stiffness * (by_states.T @ flat.T)
        sides[:, 0] += seen.T @ missed + rough.T @ bent
        squares = float(missed @ missed + bent @ bent) + more
        return _Gathered(_banded(normal), sides, stiffness * (flat @ flat.T), squares)

    def _solved(
        self, states: np.ndarray, constants: np.ndarray
    ) -> tuple[_Late, _Gathered, Linearised, np.ndarray]:
        """Give derivatives, normal equations, those without the states, and the factor of these."""
        with np.errstate(all="ignore"):
            point = self._linearise(states, constants)
        gathered = self._gather(point, states, self.settings.stiffness[-1])
        return point, gathered, *self._eliminate(gathered, 0.0)[:2]

    def volume_bits(self, states: np.ndarray, constants: np.ndarray) -> float:
        """Give the bits of the states: how much less than all they are once the data are known.

        Of a normal distribution of all states, the residuals at its mean and this are the bits of
        the data (Laplace). It makes fits comparable of which one takes more rows for history.

        Parameters
        ----------
        states : (k, n) the trajectory.
        constants : (P,) values.
        """
        mesh, (point, _, _, factor) = self.mesh, self._solved(states, constants)
        bound = mesh.follows[mesh.left]
        # A density of the defect is one of the next state times how fast the defect moves with it.
        ends = np.moveaxis(point.by_right[..., bound], -1, 0)
        ends = ends * math.sqrt(self.settings.stiffness[-1])
        rough = mesh.roughness
        last = np.abs(rough.data[rough.indptr[1:] - 1])
        prior = np.sum(np.linalg.slogdet(ends)[1]) + np.sum(np.log(last))
        return float(np.sum(np.log(factor[-1])) - prior) / math.log(2)

    def absorbed(self, states: np.ndarray, constants: np.ndarray) -> float:
        """Give how many of the measurements states and constants follow whatever they are.

        It is the trace of the matrix that takes measurements to what is fitted to them.

        Parameters
        ----------
        states : (k, n) the trajectory.
        constants : (P,) values.
        """
        mesh, (_, gathered, found, factor) = self.mesh, self._solved(states, constants)
        moved = cho_solve_banded((factor, False), gathered.sides[:, 1:])
        weights = mesh.weights.ravel()
        (rows,) = np.nonzero(weights)
        total = 0.0
        for some in np.array_split(rows, math.isqrt(len(rows)) + 1):
            one = np.zeros((len(weights), len(some)))
            one[some, np.arange(len(some))] = 1.0
            solved = cho_solve_banded((factor, False), one)
            total += float(np.sum(weights[some] ** 2 * solved[some, np.arange(len(some))]))
        by = weights[:, None] * moved
        return total + float(np.sum(np.linalg.pinv(found.information) * (by.T @ by)))


def _banded(normal: sparse.csr_array) -> np.ndarray:
    """Write a symmetric matrix in the upper form of LAPACK's pbtrf."""
    upper = sparse.triu(normal).tocoo()
    width = int(np.max(upper.col - upper.row, initial=0))
    band = np.zeros((width + 1, normal.shape[0]), order="F")
    band[width + upper.row - upper.col, upper.col] = upper.data
    return band


@dataclass(frozen=True, eq=False)
class DelayedFit(MixedFit):
    """A system with columns at an earlier time that was fitted; the last number is the delay.

    Parameters
    ----------
    rule : (Q,) how far the numbers moved when the rule had half as long steps; 0 where that was not
        tried.
    """

    problem: DelayedCollocation
    rule: np.ndarray = field(default_factory=lambda: np.zeros(1))

    @property
    def delay(self) -> float:
        """The delay."""
        return float(self.theta[-1])

    @cached_property
    def freedom(self) -> float:
        """Measurements less those that states and numbers follow whatever they are."""
        mesh = self.problem.mesh
        if np.all(mesh.known):
            return np.inf
        own = np.ascontiguousarray(self.found.states.T)
        return max(float(mesh.rows.sum()) - self.problem.absorbed(own, self.found.constants), 1.0)

    @cached_property
    def rows(self) -> np.ndarray:
        """(k,) measured rows of the states that are no history."""
        mesh = self.problem.mesh
        return np.count_nonzero(mesh.weights[mesh.follows], axis=0).astype(float)

    @cached_property
    def mean_squares(self) -> np.ndarray:
        """(k,) mean squared residuals, in units of the noise, of the rows that are no history."""
        mesh = self.problem.mesh
        history = np.where(mesh.follows[:, None], 0.0, self.found.misses)
        squares = self.found.mean_squares * mesh.rows - np.sum(history**2, axis=0)
        return np.maximum(squares / np.maximum(self.rows, 1.0), np.maximum(self.least, 1e-300))

    @cached_property
    def bits(self) -> float:
        """Bits of all rows, history or not, given the equations with their numbers."""
        mesh = self.problem.mesh
        own = np.ascontiguousarray(self.found.states.T)
        rough = (mesh.roughness @ self.found.states.ravel()).reshape(len(mesh.states), -1)
        squares = self.found.mean_squares + np.sum(rough**2, axis=1) / np.maximum(mesh.rows, 1.0)
        squares = np.maximum(squares, np.maximum(self.least, 1e-300))
        volume = self.problem.volume_bits(own, self.found.constants)
        return residual_bits(squares, mesh.rows, mesh.known) + volume

    @cached_property
    def covariance(self) -> np.ndarray:
        """(Q, Q) of the numbers, with the error of the rule; inf where nothing determines it."""
        found: np.ndarray = MixedFit.covariance.func(self) + np.outer(self.rule, self.rule)  # type: ignore[attr-defined]
        return found

    @cached_property
    def scales(self) -> np.ndarray:
        """(Q,) changes of the numbers that change an equation by as much as it says."""
        found: np.ndarray = MixedFit.scales.func(self)  # type: ignore[attr-defined]
        own = np.ascontiguousarray(self.found.states.T)
        slopes = self.problem.slopes_at_rows(own, self.found.constants)
        sizes, moved = (np.sqrt(np.mean(some**2, axis=1)) for some in slopes)
        with np.errstate(all="ignore"):
            own_scales = sizes / moved
        usable = own_scales[np.isfinite(own_scales) & (own_scales > 0)]
        found[-1] = usable.min(initial=np.inf) if len(usable) else 1.0
        return found


@dataclass(frozen=True, eq=False)
class DelayedSystem:
    """Equations with parameters and with columns at an earlier time.

    Parameters
    ----------
    equations : state -> right-hand side in columns, columns at an earlier time and parameters.
    names : column -> its name at an earlier time.
    parameters : names of the parameters.
    """

    equations: Mapping[str, sympy.Expr]
    names: Mapping[str, str]
    parameters: Sequence[str]

    @cached_property
    def _mixed(self) -> Mixed:
        """The same with delayed columns as any others."""
        return Mixed(self.equations, dict.fromkeys(self.parameters, (0,)))

    def problem(
        self,
        rows: MixedMesh,
        theta: np.ndarray,
        begin: float,
        settings: CollocationSettings = FIT.along,
    ) -> tuple[DelayedCollocation, np.ndarray]:
        """Give the least-squares problem, and (P, Q) which of its constants each number is.

        Parameters
        ----------
        rows, theta, begin, settings : as for :meth:`fit`.
        """
        delay = float(theta[-1])
        mesh = DelayedMesh.of(rows.mesh, self.names, begin).at(delay)
        plain, ways = self._mixed.problem(replace(rows, mesh=mesh), theta[:-1], settings)
        problem = DelayedCollocation(
            plain.exprs,
            mesh,
            settings,
            (*plain.places, (mesh.states[0], _DELAY, 0, "")),
            (*plain.values, delay),
        )
        ways = np.block([[ways, np.zeros((len(ways), 1))], [np.zeros(len(theta) - 1), 1.0]])
        return problem, ways

    def fit(
        self,
        rows: MixedMesh,
        theta: np.ndarray,
        begin: float,
        settings: CollocationSettings = FIT.along,
    ) -> DelayedFit | None:
        """Fit all numbers, the delay and the states; None where that cannot be done.

        Parameters
        ----------
        rows : the data.
        theta : (Q,) where the parameters and the delay start.
        begin : time after the first row of each run from which on states follow the equations.
        settings : the numbers that decide.
        """
        problem, ways = self.problem(rows, theta, begin, settings)
        found = problem.fit_tied(np.ascontiguousarray(problem.mesh.start.T), ways)
        if found is None or not np.all(np.isfinite(found.misses)):
            return None
        return DelayedFit(problem, ways, found, rows.least, self._mixed)
