"""Tsit5 for many lanes at once: many start states, many right-hand sides of one shape, or both.

Every lane has its own step size and its own answer, the one that it would have alone; a lane
that has arrived or diverged leaves the arrays and costs nothing more.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import sympy

from dynsr.engines.base import DEFAULT_ABSTOL, DEFAULT_RELTOL
from dynsr.engines.tsit5.tableau import (
    BETA1,
    BETA2,
    ERROR,
    FIRST_ERROR,
    GAMMA,
    GROW_AT_MOST,
    INTERPOLANT,
    NODES,
    SHRINK_AT_MOST,
    STAGES,
    fast_powers,
)
from dynsr.errors import InputError
from dynsr.expression import compile_numpy

LaneSlopes = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class BatchIntegration:
    """States of every lane at the times asked for.

    ``x`` (lanes, n, k), NaN from the time on where a lane diverged or met a limit; ``success``,
    ``accepted``, ``rejected`` (lanes,) and ``reached`` (lanes,), the time each lane got to.
    """

    x: np.ndarray
    success: np.ndarray
    accepted: np.ndarray
    rejected: np.ndarray
    reached: np.ndarray


def lane_slopes(
    rhs: Sequence[sympy.Expr],
    states: Sequence[str],
    parameters: Sequence[str] = (),
    values: np.ndarray | None = None,
    shift: np.ndarray | None = None,
) -> LaneSlopes:
    """Compile k expressions into the slopes of many lanes.

    Parameters
    ----------
    rhs : k expressions in the states, ``t`` and the parameters.
    parameters, values : p names and their (p, lanes) numbers, when lanes differ in constants.
    shift : (lanes,) seconds that each lane's clock is ahead of the solver's.
    """
    function = compile_numpy(rhs, [*states, "t", *parameters])
    given = np.empty((0, 0)) if values is None else np.asarray(values, dtype=float)

    def slopes(x: np.ndarray, t: np.ndarray, lanes: np.ndarray) -> np.ndarray:
        clock = t if shift is None else t + shift[lanes]
        rows = [x, clock[None]] if not len(parameters) else [x, clock[None], given[:, lanes]]
        return function(np.concatenate(rows))

    return slopes


def solve_batch(
    slopes: LaneSlopes,
    x0: np.ndarray,
    t: np.ndarray,
    reltol: float = DEFAULT_RELTOL,
    abstol: float = DEFAULT_ABSTOL,
    max_steps: int = 100_000,
    max_seconds: float = 60.0,
) -> BatchIntegration:
    """Integrate every lane from its row of ``x0`` (lanes, k) at ``t[0]``; save at ``t`` (n,).

    ``slopes(x, t, lanes)`` takes states (k, L), times (L,) and the numbers (L,) of the lanes
    that still run, and gives slopes (k, L), NaN where there is none; :func:`lane_slopes` makes
    it from expressions. Raises InputError when shapes do not fit or times do not increase.

    >>> x = sympy.Symbol("x")
    >>> batch = solve_batch(lane_slopes([-x], ["x"]), np.array([[1.0], [2.0]]), np.array([0, 1.0]))
    >>> np.round(batch.x[:, -1, 0], 3).tolist()
    [0.368, 0.736]
    """
    x0, t = np.asarray(x0, dtype=float), np.asarray(t, dtype=float)
    if x0.ndim != 2 or t.ndim != 1 or len(t) < 2 or np.any(np.diff(t) <= 0):
        raise InputError(
            f"x0 {x0.shape} must be (lanes, states) and t {t.shape} at least two increasing times"
        )
    run = _Run(slopes, t, reltol, abstol, x0)
    deadline = time.perf_counter() + max_seconds
    with np.errstate(all="ignore"):
        run.start()
        tries = 0
        while run.lanes.size and tries < max_steps and time.perf_counter() < deadline:
            run.advance()
            tries += 1
    return BatchIntegration(
        run.saved, run.reached == t[-1], run.accepted, run.rejected, run.reached
    )


@dataclass(eq=False)
class _Run:
    """The lanes that still run: column j of ``x`` (k, L) belongs to lane ``lanes[j]``."""

    slopes: LaneSlopes
    times: np.ndarray
    reltol: float
    abstol: float
    x0: np.ndarray
    lanes: np.ndarray = field(init=False)

    def start(self) -> None:
        """Take the first slopes and step lengths, and drop lanes that have none."""
        count, k = self.x0.shape
        self.lanes = np.arange(count)
        self.x = self.x0.T.copy()
        self.t = np.full(count, self.times[0])
        self.saved = np.full((count, len(self.times), k), np.nan)
        self.saved[:, 0] = self.x0
        self.next = np.ones(count, dtype=int)
        self.accepted, self.rejected = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        self.reached = np.full(count, self.times[0])
        self.last_error = np.full(count, FIRST_ERROR)
        self.k1 = self.slopes(self.x, self.t, self.lanes)
        self.h = self._first_steps()
        self.end = float(self.times[-1])
        self.shortest = np.finfo(float).eps * max(abs(self.times[0]), abs(self.end))
        self._keep(np.isfinite(self.k1).all(axis=0) & np.isfinite(self.x).all(axis=0))

    def _first_steps(self) -> np.ndarray:
        scale = self.abstol + self.reltol * np.abs(self.x)
        d0, d1 = _rms(self.x / scale), _rms(self.k1 / scale)
        length = self.times[-1] - self.times[0]
        h0 = np.minimum(np.where((d0 < 1e-5) | (d1 < 1e-5), 1e-6, d0 / d1 / 100), length)
        k2 = self.slopes(self.x + h0 * self.k1, self.t + h0, self.lanes)
        d2 = _rms((k2 - self.k1) / scale) / h0
        largest = np.maximum(d1, d2)
        h1 = np.where(
            largest <= 1e-15, np.maximum(1e-6, h0 / 1000), 10.0 ** (-(2 + np.log10(largest)) / 5)
        )
        h1 = np.where((k2 == self.k1).all(axis=0), np.inf, h1)
        h = np.minimum(np.minimum(100 * h0, h1), length)
        return np.where(np.isfinite(k2).all(axis=0), h, h0)

    def advance(self) -> None:
        """Try one step in every lane; take it where its error allows."""
        h = np.minimum(self.h, self.end - self.t)
        error, new, stages = self._try(h)
        taken = error <= 1.0
        growth = fast_powers(error, BETA1)
        q = growth / fast_powers(self.last_error, BETA2) / GAMMA
        q = np.clip(q, 1.0 / GROW_AT_MOST, SHRINK_AT_MOST)
        self.h = h / np.where(taken, q, np.minimum(SHRINK_AT_MOST, growth / GAMMA))
        self.last_error = np.where(taken, np.maximum(error, FIRST_ERROR), self.last_error)
        t_new = self.t + h
        t_new = np.where(self.end - t_new < 100 * self.shortest, self.end, t_new)
        self._save(taken, t_new, h, new, stages)
        self.t = np.where(taken, t_new, self.t)
        self.x = np.where(taken, new, self.x)
        self.k1 = np.where(taken, stages[6], self.k1)
        self.accepted[self.lanes] += taken
        self.rejected[self.lanes] += ~taken
        self.reached[self.lanes] = self.t
        too_short = (np.minimum(self.h, self.end - self.t) <= self.shortest) & (self.t != 0.0)
        going = (self.t < self.end) & ~too_short & (self.t + self.h > self.t)
        if not going.all():
            self._keep(going)

    def _try(self, h: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        stages = np.empty((7, *self.x.shape))
        flat = stages.reshape(7, -1)
        stages[0] = self.k1
        for i in range(1, 7):
            y = self.x + h * (STAGES[i, :i] @ flat[:i]).reshape(self.x.shape)
            stages[i] = self.slopes(y, self.t + NODES[i] * h, self.lanes)
        scale = self.abstol + self.reltol * np.maximum(np.abs(self.x), np.abs(y))
        error = _rms(h * (ERROR @ flat).reshape(self.x.shape) / scale)
        fine = np.isfinite(error) & np.isfinite(y).all(axis=0)
        return np.where(fine, error, np.inf), y, stages

    def _save(
        self,
        taken: np.ndarray,
        t_new: np.ndarray,
        h: np.ndarray,
        new: np.ndarray,
        stages: np.ndarray,
    ) -> None:
        after = np.searchsorted(self.times, np.where(taken, t_new, self.t), side="right")
        count = np.maximum(after - self.next, 0)
        total = int(count.sum())
        if total:
            column = np.repeat(np.arange(len(h)), count)
            first = np.cumsum(count) - count
            point = np.arange(total) - first[column] + self.next[column]
            theta = ((self.times[point] - self.t[column]) / h[column])[:, None]
            powers = (np.tensordot(INTERPOLANT.T, stages, 1) * h).reshape(4 * len(new), -1)
            # One row a lane: its four coefficients of each state, then the state it starts from.
            rows = np.vstack([powers, self.x]).T.copy().take(column, axis=0)
            values = _polynomials(rows, theta)
            ends = np.flatnonzero(theta[:, 0] == 1.0)
            values[ends] = new.T[column[ends]]
            flat = self.saved.reshape(-1, len(new))
            flat[self.lanes[column] * len(self.times) + point] = values
        self.next = np.maximum(after, self.next)

    def _keep(self, going: np.ndarray) -> None:
        for name in ("lanes", "t", "h", "next", "last_error"):
            setattr(self, name, getattr(self, name)[going])
        self.x, self.k1 = self.x[:, going], self.k1[:, going]


def _polynomials(rows: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Evaluate k polynomials a row, of coefficients of theta, ..., theta^4, then the constant."""
    c1, c2, c3, c4, constant = np.split(rows, 5, axis=1)
    values = c4 * theta
    for coefficient in (c3, c2, c1):
        values += coefficient
        values *= theta
    values += constant
    return values


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(values * values, axis=0))
