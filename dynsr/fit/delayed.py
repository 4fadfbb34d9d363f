"""Delayed: a system whose equations contain its own columns as they were some time before.

States, constants and the delay are fitted together by collocation (:mod:`dynsr.fit.collocation`). A
column at an earlier time is interpolated between rows of the fitted states themselves, so that its
noise, and how it changes with the delay, are counted. The rule holds from some time after the first
row on, since the first part of a run is only history. There the states are those of a smoothing
spline of order 5 (Wahba 1978): their third derivative is white noise, as large as in the curves.

An input at an earlier time is a known function of the time. One that jumps, or has kinks, does so
between rows, at times that move with the delay. There a step is cut: each part has its own rule,
and the states between parts follow from those at its beginning.
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

from dynsr.engines import Drive
from dynsr.fit.collocation import Linearised, Mesh, Probes, _Gathered, _Point
from dynsr.fit.description import residual_bits
from dynsr.fit.mixed import Mixed, MixedFit, MixedMesh, _Grouped
from dynsr.fit.settings import FIT, CollocationSettings
from dynsr.fit.shooting import Driven

# Rows between which a column at an earlier time is interpolated.
_STENCIL = 6
_DELAY = "time before"
# Share of the delay by which one step may move it.
_STEP = 0.1


@dataclass(frozen=True, eq=False)
class _Cuts:
    """The steps in which inputs at an earlier time jump or have kinks, cut there.

    Parameters
    ----------
    own : (c,) which intervals they are.
    run : (c,) the run of each.
    times : (c, p + 1) where the parts begin and end; parts at the end may have no length.
    moves : (c, p + 1) whether a time moves with the delay.
    """

    own: np.ndarray
    run: np.ndarray
    times: np.ndarray
    moves: np.ndarray

    @property
    def halved(self) -> _Cuts:
        """The same with each part cut in its middle."""
        middle = (self.times[:, 1:] + self.times[:, :-1]) / 2
        times = np.empty((len(self.own), 2 * middle.shape[1] + 1))
        times[:, ::2], times[:, 1::2] = self.times, middle
        return replace(self, times=times, moves=np.zeros(times.shape, dtype=bool))


@dataclass(frozen=True, eq=False)
class DelayedMesh(Mesh):
    """The rows of runs whose columns are also needed as they were some time before.

    Parameters
    ----------
    sources : (e,) which of the states, and then of the driven columns, the first e driven columns
        are at an earlier time.
    begin : time after the first row of each run from which on states follow the equations.
    drives : for each run the f inputs that the next f driven columns are at an earlier time.
    silent : intervals of which nothing is asked.
    """

    sources: tuple[int, ...] = ()
    begin: float = 0.0
    drives: tuple[tuple[Drive, ...], ...] = ()
    silent: tuple[int, ...] = ()

    @classmethod
    def of(
        cls, mesh: Mesh, names: Mapping[str, str], begin: float, inputs: Sequence[Driven] = ()
    ) -> DelayedMesh:
        """Give a mesh with columns at an earlier time.

        Parameters
        ----------
        mesh : the rows.
        names : column -> its name at an earlier time; inputs are the last.
        begin : time after the first row of each run from which on states follow the equations.
        inputs : the inputs of each run as functions of the time.
        """
        driven = np.concatenate([np.zeros((len(names), mesh.driven.shape[1])), mesh.driven])
        columns = (*mesh.states, *names.values(), *mesh.driven_names)
        known = [{drive.name: drive for drive in run.drives} for run in inputs]
        drives = tuple(tuple(run[name] for name in names if name in run) for run in known)
        own = {f.name: getattr(mesh, f.name) for f in mesh.__dataclass_fields__.values()}
        own |= {"driven": driven, "driven_names": columns[len(mesh.states) :]}
        sources = tuple(columns.index(n) for n in names if not known or n not in known[0])
        return cls(**own, sources=sources, begin=begin, drives=drives)

    @property
    def count(self) -> int:
        """How many columns are at an earlier time."""
        return len(self.sources) + (len(self.drives[0]) if self.drives else 0)

    def at(self, delay: float) -> DelayedMesh:
        """Give the mesh with columns at an earlier time as the smoothed states were.

        Parameters
        ----------
        delay : how much earlier.
        """
        driven = self.driven.copy()
        driven[: self.count] = self.before(self.start.T, delay)[0]
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
        """(n,) whether a row is no mere history, give or take the rounding of its time."""
        since, rounding = self.t - self.t[self.firsts], 4 * np.finfo(float).eps
        found: np.ndarray = since >= self.begin - rounding * np.abs(self.t).max()
        return found

    @cached_property
    def unit(self) -> np.ndarray:
        """(m, k) what defects are in; inf where states are free."""
        own: np.ndarray = Mesh.unit.func(self)  # type: ignore[attr-defined]
        return np.where(self.bound[:, None], own, np.inf)

    @cached_property
    def bound(self) -> np.ndarray:
        """(m,) whether something is asked of an interval: a jump of an input moves no state."""
        found: np.ndarray = self.follows[self.left] | (self.h == 0)
        found[list(self.silent)] = False
        return found

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

    def _wanted(self, times: np.ndarray, delay: float) -> tuple[np.ndarray, ...]:
        """(points,) first rows of their runs, times that are asked for, whether these are there."""
        n = len(self.t)
        between = len(times) == len(self.left)
        owner = self.left if between else np.concatenate([np.arange(n), self.left])
        first, wanted = self.firsts[owner], times - delay
        begins = self.t[first]
        return first, np.maximum(wanted, begins), wanted >= begins

    @cached_property
    def _begins(self) -> np.ndarray:
        """First rows of the runs."""
        return np.flatnonzero(self.firsts == np.arange(len(self.t)))

    @cached_property
    def _rounding(self) -> float:
        """A time below which two times are one: sums of two are rounded twice."""
        return 4 * float(np.spacing(np.max(np.abs(self.t))))

    def inputs_before(self, times: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
        """Give (f, points) inputs at an earlier time, after a jump there, and their derivatives.

        Parameters
        ----------
        times, delay : as for :meth:`weights_before`.
        """
        first, wanted, inside = self._wanted(times, delay)
        found, moved = np.zeros((2, self.count - len(self.sources), len(times)))
        for begin, drives in zip(self._begins, self.drives, strict=True):
            own = first == begin
            for place, drive in enumerate(drives):
                at = wanted[own] + (self._rounding if len(drive.kinks) else 0.0)
                found[place, own] = drive.at(at)
                moved[place, own] = np.where(inside[own], -drive.slope.at(at), 0.0)
        return found, moved

    def jump_rates(self, delay: float) -> np.ndarray:
        """(f, n) squares of the jumps of inputs at an earlier time after each row, over all time.

        Parameters
        ----------
        delay : how much earlier.
        """
        found = np.zeros((self.count - len(self.sources), len(self.t)))
        bounds = [*self._begins, len(self.t)]
        for (a, b), drives in zip(pairwise(bounds), self.drives, strict=False):
            for place, drive in enumerate(drives):
                size = drive.at(drive.jumps) - drive.at(drive.jumps, before=True)
                rows = a - 1 + np.searchsorted(self.t[a:b], drive.jumps + delay)
                here = drive.jumps + delay <= self.t[b - 1]
                np.add.at(found[place], rows[here], size[here] ** 2)
        return found / float(np.sum(self.h))

    def cuts(self, delay: float) -> _Cuts | None:
        """Give the steps in which inputs at an earlier time jump or have kinks; None for none.

        A step that ends there is one of them, and one that begins there is not.

        Parameters
        ----------
        delay : how much earlier.
        """
        owners, when = [np.empty(0, dtype=int)], [np.empty(0)]
        bounds = [*self._begins, len(self.t)]
        for (a, b), drives in zip(pairwise(bounds), self.drives, strict=False):
            kinks = np.unique(np.concatenate([np.empty(0), *(drive.kinks for drive in drives)]))
            times = kinks[kinks > self.t[a]] + delay
            times = times[times <= self.t[b - 1] + self._rounding]
            some = np.flatnonzero((self.left >= a) & (self.left < b))
            place = np.searchsorted(self.t[self.left[some]], times - self._rounding) - 1
            owners.append(some[place])
            when.append(times)
        owner, times = np.concatenate(owners), np.concatenate(when)
        kept = self.follows[self.left[owner]]
        owner, times = owner[kept], times[kept]
        if not len(owner):
            return None
        own, first, counts = np.unique(owner, return_index=True, return_counts=True)
        places = np.arange(counts.max()) + first[:, None]
        there = np.arange(counts.max()) < counts[:, None]
        low, high = self.t[self.left[own]], self.t[self.left[own] + 1]
        inner = np.where(there, times[np.minimum(places, len(times) - 1)], high[:, None])
        run = np.searchsorted(self._begins, self.firsts[self.left[own]])
        still = np.zeros((len(own), 1), dtype=bool)
        return _Cuts(
            own,
            run,
            np.column_stack([low, inner, high]),
            np.concatenate([still, there, still], axis=1),
        )

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
        first, wanted, inside = self._wanted(times, delay)
        place = np.empty(count, dtype=int)
        for a, b in pairwise([*self._begins, n]):
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
        states_before = (weights @ rows.T).T, (slopes @ rows.T).T
        if not self.drives:
            return states_before
        inputs = self.inputs_before(self.points if times is None else times, delay)
        first, second = map(np.concatenate, zip(states_before, inputs, strict=True))
        return first, second

    @cached_property
    def roughness(self) -> sparse.csr_array:
        """(r, n k) third derivatives of the history, in standard deviations of their noise."""
        n, k = len(self.t), len(self.states)
        # A row at which an input jumps is there twice, and the history continues there.
        once = np.flatnonzero(np.append(True, np.diff(self.t) != 0) | (self.firsts == np.arange(n)))
        rows = once[np.arange(len(once) - 3)[:, None] + np.arange(4)]
        rows = rows[
            (self.firsts[rows[:, 0]] == self.firsts[rows[:, 3]]) & ~self.follows[rows[:, 2]]
        ]
        scales = self._wildness
        at = self.t[rows]
        parts = np.ones(rows.shape)
        for i in range(4):
            for j in range(4):
                if i != j:
                    parts[:, i] /= at[:, i] - at[:, j]
        parts *= math.factorial(3) * np.sqrt((at[:, 3] - at[:, 0]) / 3)[:, None]
        blocks = []
        for j in range(k):
            place = (np.repeat(np.arange(len(rows)), 4), rows.ravel() * k + j)
            blocks.append(
                sparse.csr_array(((parts / scales[j]).ravel(), place), shape=(len(rows), n * k))
            )
        return sparse.csr_array(sparse.vstack(blocks))

    @cached_property
    def _wildness(self) -> np.ndarray:
        """(k,) root of the intensity of the third derivatives of the smoothed states.

        It is their mean square times the time over which they keep their sign, which is that in
        which second derivatives change by their own size.
        """
        measured = np.flatnonzero(self.measured)
        second, third = [], []
        for own in self._begins:
            rows = measured[self.firsts[measured] == own]
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
class _PartMesh(Mesh):
    """Parts of steps: each has two rows of its own, and defects in the units of the states."""

    whole: Mesh | None = None

    @cached_property
    def unit(self) -> np.ndarray:
        """(m, k) what defects are in."""
        return np.ones((len(self.left), len(self.states)))

    @cached_property
    def spread(self) -> np.ndarray:
        """(k,) scale of the states."""
        assert self.whole is not None
        return self.whole.spread


@dataclass(frozen=True, eq=False)
class _Part(_Grouped):
    """The least-squares problem of one part of each step that is cut, after the other parts."""

    def missed(self, pair: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """(k, c) defects, in units of the states.

        Parameters
        ----------
        pair : (k, 2 c) the states at the beginning and the end of each part.
        constants : (P,) values.
        """
        return self._defects(pair, constants)

    def linearised(self, pair: np.ndarray, constants: np.ndarray) -> _Point:
        """Give the defects and their derivatives.

        Parameters
        ----------
        pair, constants : as for :meth:`missed`.
        """
        return self._linearise(pair, constants)

    def middle(self, pair: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """(k, c) states in the middle.

        Parameters
        ----------
        pair, constants : as for :meth:`missed`.
        """
        return self._along(pair, constants)[1]


@dataclass(frozen=True, eq=False)
class _Walk:
    """The steps that are cut, at a trial point.

    Parameters
    ----------
    cuts : which they are.
    defects : (k, c) how far each misses the next state, in units of the states.
    states : (p, k, 2 c) the states at both ends of the parts.
    parts : the problem of each part of the steps.
    """

    cuts: _Cuts
    defects: np.ndarray
    states: list[np.ndarray]
    parts: list[_Part]


@dataclass(frozen=True, eq=False)
class DelayedCollocation(_Grouped):
    """The least-squares problem of a system with columns at an earlier time.

    The last of its constants is the delay.
    """

    mesh: DelayedMesh

    @property
    def _count(self) -> int:
        return self.mesh.count

    def _shares(self, cuts: _Cuts, times: np.ndarray) -> np.ndarray:
        """(3, c, ...) shares of the values at both ends and in the middle of steps, at times."""
        low, h = self.mesh.t[self.mesh.left[cuts.own]], self.mesh.h[cuts.own]
        share = (times - low[:, None]) / h[:, None]
        return np.array(
            [(1 - share) * (1 - 2 * share), share * (2 * share - 1), 4 * share * (1 - share)]
        )

    def _parts(
        self, cuts: _Cuts, driven: np.ndarray, delay: float, moved: float = 0.0
    ) -> list[_Part]:
        """Give the problems of the parts, with inputs at an earlier time as they are there.

        Other driven columns are parabolas through both ends and the middle of the step.

        Parameters
        ----------
        cuts : which steps are cut, at the delay.
        driven : (d, n + m) driven columns.
        delay, moved : the delay, and how far it is moved from there.
        """
        mesh, n, count = self.mesh, len(self.mesh.t), len(self.mesh.sources)
        columns = [driven[:, :n][:, mesh.left[cuts.own]], driven[:, :n][:, mesh.left[cuts.own] + 1]]
        columns.append(driven[:, n:][:, cuts.own])
        ends = cuts.times + moved * cuts.moves
        found = []
        for part in range(ends.shape[1] - 1):
            low, high = ends[:, part], ends[:, part + 1]
            times = np.column_stack([low, high, (low + high) / 2])
            shares = self._shares(cuts, times)
            own = sum(c[..., None] * share for c, share in zip(columns, shares, strict=True))
            # The pieces of inputs that jump are those in the middle, wherever the ends move.
            middle = (cuts.times[:, part] + cuts.times[:, part + 1]) / 2
            inside = np.repeat(middle[:, None] - delay, 3, axis=1)
            for run, drives in enumerate(mesh.drives):
                here = cuts.run == run
                for place, drive in enumerate(drives):
                    at = times[here] - delay - moved
                    where = inside[here] if len(drive.kinks) else None
                    own[count + place, here] = drive.at(at, inside=where)
            pairs = own[..., :2].reshape(len(own), -1)
            small = _PartMesh(
                times[:, :2].ravel(),
                2 * np.arange(len(times)),
                np.zeros((2 * len(times), len(mesh.states))),
                np.zeros((2 * len(times), len(mesh.states))),
                np.zeros((2 * len(times), len(mesh.states))),
                np.concatenate([pairs, own[..., 2]], axis=1),
                mesh.states,
                mesh.driven_names,
                whole=mesh,
            )
            found.append(_Part(self.exprs, small, self.settings, self.places, self.values))
        return found

    def _walk(
        self, cuts: _Cuts, states: np.ndarray, constants: np.ndarray, driven: np.ndarray
    ) -> _Walk:
        """Go through the parts of steps, from their beginnings on."""
        mesh, parts = self.mesh, self._parts(cuts, driven, float(constants[-1]))
        now, end = states[:, mesh.left[cuts.own]], states[:, mesh.left[cuts.own] + 1]
        pairs = []
        for place, part in enumerate(parts):
            after, last = end, place == len(parts) - 1
            if not last:
                length, rest = part.mesh.h, cuts.times[:, -1] - cuts.times[:, place]
                after = now + (end - now) * length / np.where(rest > 0, rest, np.inf)
            size = np.inf
            while not last and size > 0:
                pair = np.stack([now, after], axis=-1).reshape(len(now), -1)
                point = part.linearised(pair, constants)
                if not np.all(np.isfinite(point.by_right)):
                    break
                # Newton's steps, until rounding alone makes them.
                step = _solve(point.by_right, point.defects[:, None])[:, 0]
                after, before = after - step, size
                size = float(np.max(np.abs(step) / mesh.spread[:, None]))
                if not size < before / 2:
                    break
            pair = np.stack([now, after], axis=-1).reshape(len(now), -1)
            pairs.append(pair)
            now = after
        return _Walk(cuts, parts[-1].missed(pairs[-1], constants), pairs, parts)

    def _defects(self, states: np.ndarray, constants: np.ndarray) -> np.ndarray:
        found = super()._defects(states, constants)
        cuts = self.mesh.cuts(float(constants[-1]))
        if cuts is not None:
            walk = self._walk(cuts, states, constants, self.driven(states, constants))
            found[:, cuts.own] = walk.defects / self.mesh.by_state[2][:, cuts.own]
        return found

    def _unresolved(self, states: np.ndarray, constants: np.ndarray) -> np.ndarray:
        cuts = self.mesh.cuts(float(constants[-1]))
        if cuts is None:
            return super()._unresolved(states, constants)
        whole = replace(self, mesh=replace(self.mesh, silent=tuple(cuts.own)))
        found = super(DelayedCollocation, whole)._unresolved(states, constants)
        driven = self.driven(states, constants)
        with np.errstate(all="ignore"):
            once, twice = (
                self._walk(own, states, constants, driven).defects for own in (cuts, cuts.halved)
            )
            change = (twice - once) / self.mesh.by_state[2][:, cuts.own]
        total = found + np.sum(change**2, axis=1)
        return np.where(np.isfinite(total), total, np.inf)

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
        count = self._count
        e = np.arange(count)
        sizes = np.abs(driven[:count]).max(axis=1, initial=0.0)
        steps = self.settings.difference * np.maximum(sizes, 1e-300)
        rows = np.repeat(driven[:, None], 1 + count, axis=1)
        rows[e, 1 + e] += steps[:, None]
        found = self.slope(*states[:, None], *rows, *constants)
        by: np.ndarray = (found[:, 1:] - found[:, :1]) / steps[:, None]
        return by

    def delay_scales(self, states: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """(2 k,) changes of the delay that change right-hand sides by as much as they are.

        The first are those by slopes of columns at an earlier time. Where these jump, the square
        of the change grows as the delay.

        Parameters
        ----------
        states : (k, n) the trajectory.
        constants : (P,) values.
        """
        mesh, n = self.mesh, len(self.mesh.t)
        driven = self.driven(states, constants)[:, :n]
        moved = mesh.before(states, constants[-1])[1][:, :n]
        by = self._by_earlier(states, constants, driven)
        slopes = np.einsum("aen,en->an", by, moved)
        sizes = np.mean(self.slope(*states, *driven, *constants) ** 2, axis=1)
        found = [np.sqrt(sizes) / np.sqrt(np.mean(slopes**2, axis=1))]
        if mesh.drives:
            inputs, rates = by[:, len(mesh.sources) :], mesh.jump_rates(constants[-1])
            found.append(sizes / np.einsum("aen,en->a", inputs**2, rates))
        return np.concatenate(found)

    def _linearise(
        self, states: np.ndarray, constants: np.ndarray, probes: Probes | None = None
    ) -> _Late:
        point = super()._linearise(states, constants, probes)
        mesh, n = self.mesh, len(self.mesh.t)
        left, right = mesh.ends
        driven, middle = self.driven(states, constants), self._along(states, constants)[1]
        at_rows = self._by_earlier(states, constants, driven[:, :n])
        inside = self._by_earlier(middle, constants, driven[:, n:])
        unit = mesh.by_state[2][:, None]
        earlier = _by_columns(point, mesh, at_rows, inside) / unit
        moved = mesh.before(states, constants[-1])[1]
        moved = np.array([moved[:, :n][:, left], moved[:, :n][:, right], moved[:, n:]])
        delay = len(constants) - 1
        point.by_constant[:, delay] = np.einsum("iaem,iem->am", earlier, moved)
        cuts = mesh.cuts(float(constants[-1]))
        if cuts is not None:
            own, count, k = cuts.own, len(mesh.sources), len(states)
            defects, by = self._linearise_cuts(cuts, states, constants, driven)
            unit = unit[..., own]
            point.defects[:, own] = defects / unit[:, 0]
            point.by_left[..., own] = by[:, :k] / unit
            point.by_right[..., own] = by[:, k : 2 * k] / unit
            point.by_constant[:, : delay + 1, own] = by[:, 2 * k : 2 * k + delay + 1] / unit
            # What inputs do when the delay moves is counted already.
            earlier[..., own] = 0.0
            columns = by[:, 2 * k + delay + 1 :].reshape(k, 3, count, len(own)).swapaxes(0, 1)
            earlier[:, :, :count, own] = columns / unit
            point.by_constant[:, delay, own] += np.einsum(
                "iaec,iec->ac", earlier[..., own], moved[..., own]
            )
        by_states = self._by_states(point, tuple(earlier), constants[-1])
        fields = {f: getattr(point, f) for f in _Point.__dataclass_fields__}
        return _Late(**fields, by_states=by_states)

    def _linearise_cuts(
        self, cuts: _Cuts, states: np.ndarray, constants: np.ndarray, driven: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Defects (k, c) of steps that are cut, and their derivatives (k, q, c).

        These are by the states at both ends, by the constants, where the delay moves the inputs
        and the cuts, and by the states at an earlier time at both ends and in the middle.
        """
        k, count, delay = len(states), len(self.mesh.sources), float(constants[-1])
        walk = self._walk(cuts, states, constants, driven)
        shift = self.settings.difference * delay
        others = self._parts(cuts, driven, delay, shift)
        width = 2 * k + len(constants) + 3 * count
        by = np.zeros((k, width, len(cuts.own)))
        by[:, :k] = np.eye(k)[..., None]
        defects = walk.defects
        for place, (part, other, pair) in enumerate(
            zip(walk.parts, others, walk.states, strict=True)
        ):
            point = part.linearised(pair, constants)
            by = np.einsum("abc,bqc->aqc", point.by_left, by)
            own = point.by_constant.copy()
            own[:, -1] += (other.missed(pair, constants) - point.defects) / shift
            by[:, 2 * k : 2 * k + len(constants)] += own
            if count:
                by[:, 2 * k + len(constants) :] += self._by_sources(
                    cuts, part, point, pair, place, constants
                )
            if place == len(walk.parts) - 1:
                defects = point.defects
                by[:, k : 2 * k] = point.by_right
            else:
                by = -_solve(point.by_right, by)
        return defects, by

    def _by_sources(
        self,
        cuts: _Cuts,
        part: _Part,
        point: _Point,
        pair: np.ndarray,
        place: int,
        constants: np.ndarray,
    ) -> np.ndarray:
        """(k, 3 e, c) derivatives of the defects of a part by states before, of its whole step."""
        count, small = len(self.mesh.sources), part.mesh
        ends, middle = len(small.t), part.middle(pair, constants)
        at_rows = self._by_earlier(pair, constants, small.driven[:, :ends])[:, :count]
        inside = self._by_earlier(middle, constants, small.driven[:, ends:])[:, :count]
        by = _by_columns(point, small, at_rows, inside)
        times = cuts.times[:, place : place + 2]
        shares = self._shares(cuts, np.column_stack([times, times.mean(axis=1)]))
        found = np.einsum("iaec,wci->awec", by, shares)
        return found.reshape(len(pair), 3 * count, len(cuts.own))

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
        bound = mesh.bound
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


def _by_columns(point: _Point, mesh: Mesh, at_rows: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """(3, k, e, m) derivatives of defects by columns at both ends, and in the middle of steps.

    They are in the units of the states.

    Parameters
    ----------
    point : where.
    mesh : the rows.
    at_rows, inside : (k, e, n) and (k, e, m) derivatives of the right-hand sides by the columns.
    """
    (left, right), sixth, eighth = mesh.ends, mesh.sixth, mesh.eighth
    low, high = at_rows[..., left], at_rows[..., right]
    return np.array(
        [
            -sixth * (low + 4 * eighth * np.einsum("acm,cem->aem", point.inside, low)),
            -sixth * (high - 4 * eighth * np.einsum("acm,cem->aem", point.inside, high)),
            -sixth * 4 * inside,
        ]
    )


def _solve(matrices: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """(k, q, c) solutions of c systems of equations (k, k, c) with q right-hand sides each."""
    found = np.linalg.solve(np.moveaxis(matrices, -1, 0), np.moveaxis(sides, -1, 0))
    return np.moveaxis(found, 0, -1)


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
        with np.errstate(all="ignore"):
            own_scales = self.problem.delay_scales(own, self.found.constants)
        usable = own_scales[np.isfinite(own_scales) & (own_scales > 0)]
        found[-1] = usable.min(initial=np.inf) if len(usable) else 1.0
        return found


@dataclass(frozen=True, eq=False)
class DelayedSystem:
    """Equations with parameters and with columns at an earlier time.

    Parameters
    ----------
    equations : state -> right-hand side in columns, columns at an earlier time and parameters.
    names : column -> its name at an earlier time; inputs are the last.
    parameters : names of the parameters.
    inputs : the inputs of each run as functions of the time, where one is at an earlier time.
    """

    equations: Mapping[str, sympy.Expr]
    names: Mapping[str, str]
    parameters: Sequence[str]
    inputs: Sequence[Driven] = ()

    def _mixed(self, runs: int) -> Mixed:
        """Give the same with delayed columns as any others, for so many runs."""
        return Mixed(self.equations, dict.fromkeys(self.parameters, (0,) * runs))

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
        mesh = DelayedMesh.of(rows.mesh, self.names, begin, self.inputs).at(delay)
        plain, ways = self._mixed(rows.count).problem(
            replace(rows, mesh=mesh), theta[:-1], settings
        )
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
        return DelayedFit(problem, ways, found, rows.least, self._mixed(rows.count))
