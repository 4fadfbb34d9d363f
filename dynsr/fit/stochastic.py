"""Stochastic systems: dx = f(x) dt + sqrt(D(x)) dW, fitted to rows by the probability of each step.

From row to row the mean and the covariance of the states move by

    m' = E[f],    V' = E[(x - m) f^T] + E[f (x - m)^T] + E[D],

where the expectations are those of a normal distribution, by points on both sides of the mean along
each axis (the unscented rule of Julier and Uhlmann 1997; Sarkka 2007). A row that is measured
without error is where the next step starts. Errors of measurement make this the unscented Kalman
filter. The constants are those of the greatest likelihood, by Fisher's scoring.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy
from scipy.linalg import LinAlgError

from dynsr.data import Trajectory
from dynsr.expression import Program, compile_columns, free_constants
from dynsr.fit.collocation import covariance_of, usual_scales
from dynsr.fit.description import precision_bits
from dynsr.fit.shooting import drives_of

_EPS = float(np.finfo(float).eps)
# Relative step of numerical derivatives, and spread of a state that is known, as a share of its
# scale: the points of the rule may not coincide.
_STEP = math.sqrt(_EPS)


@dataclass(frozen=True)
class StochasticSettings:
    """Settings of a fit of a stochastic system.

    Parameters
    ----------
    rounds : steps of Fisher's scoring at most.
    gain : natural logarithm of the likelihood that a step must gain for another one.
    farthest : that a step takes the logarithm of a variance.
    least : share of the variance of a state that chance takes from row to row, always: the rule of
        the steps errs, and so did what made the states.
    block : values of a state that are moved at a time.
    """

    rounds: int = 40
    gain: float = 0.05
    farthest: float = 3.0
    least: float = 1e-8
    block: int = 200_000


STOCHASTIC = StochasticSettings()


@dataclass(frozen=True, eq=False)
class Series:
    """Rows of runs side by side, as a filter reads them.

    Parameters
    ----------
    y : (R, N, k) measured states; NaN where one is not measured, and after the end of a run.
    h : (R, N - 1) times from row to row; 0 after the end of a run.
    driven : (3, d, R, N - 1) driven columns at the beginning, the middle and the end of each step;
        the last one is the time.
    states, driven_names : names of the columns; the last driven one is ``t``.
    """

    y: np.ndarray
    h: np.ndarray
    driven: np.ndarray
    states: tuple[str, ...]
    driven_names: tuple[str, ...]

    @classmethod
    def of(
        cls, runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr] | None = None
    ) -> Series:
        """Take trajectories of the same columns.

        Parameters
        ----------
        runs : the trajectories.
        inputs : input name -> expression in ``t`` where it is known.

        >>> run = Trajectory([0.0, 1.0, 3.0], [[1.0], [2.0], [3.0]], ("x",))
        >>> Series.of([run]).h.tolist()
        [[1.0, 2.0]]
        """
        states, known = runs[0].states, inputs or {}
        names = (*runs[0].input_names, *(n for n in known if n not in runs[0].names))
        longest = max(len(run.t) for run in runs)
        y = np.full((len(runs), longest, len(states)), np.nan)
        h = np.zeros((len(runs), longest - 1))
        driven = np.zeros((3, len(names) + 1, len(runs), longest - 1))
        for i, (run, drive) in enumerate(zip(runs, drives_of(names, runs, known), strict=True)):
            n = len(run.t)
            y[i, :n] = np.where(run.measured, run.x, np.nan)
            h[i, : n - 1] = np.diff(run.t)
            begin, end = run.t[:-1], run.t[1:]
            driven[0, :, i, : n - 1] = drive(begin)
            driven[1, :, i, : n - 1] = drive((begin + end) / 2)
            driven[2, :, i, : n - 1] = drive(end, before=True)
        return cls(y, h, driven, states, (*names, "t"))

    @cached_property
    def scale(self) -> np.ndarray:
        """(k,) spread of each state."""
        with np.errstate(all="ignore"):
            spread = np.nanstd(self.y, axis=(0, 1))
            size = np.nanmax(np.abs(self.y), axis=(0, 1))
        found: np.ndarray = np.where(spread > _STEP * size, spread, np.where(size > 0, size, 1.0))
        return found

    def every(self, lag: int) -> Series:
        """Give every row that is so many after the one before; each run begins at its first."""
        if lag == 1:
            return self
        ends = np.concatenate([np.zeros((len(self.h), 1)), np.cumsum(self.h, axis=1)], axis=1)
        rows = np.arange(0, self.y.shape[1], lag)
        inside = np.concatenate([np.ones((len(self.h), 1), dtype=bool), self.h > 0], axis=1)
        h = np.where(inside[:, rows[1:]], np.diff(ends[:, rows], axis=1), 0.0)
        begin, end = self.driven[0][..., rows[:-1]], self.driven[2][..., rows[1:] - 1]
        middle = self.driven[0][..., (rows[:-1] + rows[1:]) // 2]
        return replace(self, y=self.y[:, rows], h=h, driven=np.stack([begin, middle, end]))

    def apart(self, most: int | None = None) -> Series:
        """Give steps between rows that are wholly measured, each as a run of two rows.

        Parameters
        ----------
        most : steps at most, those of evenly spaced rows; by default all.
        """
        told = np.all(np.isfinite(self.y), axis=-1)
        runs, rows = np.nonzero((self.h > 0) & told[:, :-1] & told[:, 1:])
        if most is not None and len(runs) > most:
            some = np.linspace(0, len(runs) - 1, most).astype(int)
            runs, rows = runs[some], rows[some]
        y = np.stack([self.y[runs, rows], self.y[runs, rows + 1]], axis=1)
        driven = self.driven[:, :, runs, rows]
        return replace(self, y=y, h=self.h[runs, rows][:, None], driven=driven[..., None])

    def some(self, runs: np.ndarray) -> Series:
        """Give some of the runs."""
        return replace(self, y=self.y[runs], h=self.h[runs], driven=self.driven[:, :, runs])

    def pieces(self, rows: int) -> Series:
        """Cut runs into pieces of so many rows, each of which begins with the last row before.

        Parameters
        ----------
        rows : of a piece.
        """
        count = self.h.shape[1]
        if count < 2 * rows:
            return self
        begin = np.arange(0, count, rows)
        more = int(begin[-1]) + rows - count
        y = np.pad(self.y, ((0, 0), (0, more), (0, 0)), constant_values=np.nan)
        h = np.pad(self.h, ((0, 0), (0, more)))
        driven = np.pad(self.driven, ((0, 0), (0, 0), (0, 0), (0, more)))
        k, d = y.shape[2], driven.shape[1]
        cut = begin[:, None] + np.arange(rows + 1)
        h = h[:, cut[:, :-1]].reshape(-1, rows)
        some = h[:, 0] > 0
        driven = driven[..., cut[:, :-1]].reshape(3, d, -1, rows)
        y = y[:, cut].reshape(-1, rows + 1, k)
        return replace(self, y=y, h=h, driven=driven).some(np.flatnonzero(some))

    def blocks(self, size: int) -> Iterator[Series]:
        """Give the runs in groups of so many."""
        for first in range(0, len(self.y), size):
            yield self.some(np.arange(first, min(first + size, len(self.y))))

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Name -> (R (N - 1),) states and driven columns where the steps begin."""
        rows = [*self.y[:, :-1].reshape(-1, len(self.states)).T]
        rows += [own.ravel() for own in self.driven[0]]
        return dict(zip((*self.states, *self.driven_names), rows, strict=True))


@dataclass(frozen=True, eq=False)
class Innovations:
    """What each step misses: (Q, R, N - 1, k) of Q sets of values, and its covariance."""

    misses: np.ndarray
    covariance: np.ndarray
    told: np.ndarray

    @cached_property
    def inverse(self) -> np.ndarray:
        """The inverse covariance."""
        return np.asarray(np.linalg.inv(self.covariance))

    @cached_property
    def log_likelihood(self) -> np.ndarray:
        """(Q,) the natural logarithm of the likelihood."""
        sizes = np.einsum("...i,...ij,...j->...", self.misses, self.inverse, self.misses)
        signs, logs = np.linalg.slogdet(self.covariance)
        # What is no covariance has no likelihood.
        logs = np.where(signs > 0, logs, np.inf)
        counted = np.count_nonzero(self.told, axis=-1) * math.log(2 * math.pi)
        found: np.ndarray = -(sizes + logs + counted).sum(axis=(-1, -2)) / 2
        return found


@dataclass(frozen=True, eq=False)
class StochasticSystem:
    """A stochastic system and the rows that it is fitted to.

    Parameters
    ----------
    drift : state -> f, its mean change in unit time.
    diffusion : state -> D, the variance of its change in unit time, with positive floats.
    series : the rows.
    errors : state -> standard deviation of its measurement, fitted too; none for exact ones.
    correlations : pair of states -> correlation of their noise, fitted too; 0 for others.
    free : the states whose drift is fitted; by default all.
    settings : the numbers that decide.

    >>> rng, x = np.random.default_rng(0), [1.0]
    >>> for _ in range(400):
    ...     x.append(x[-1] * 0.95 + 0.3 * rng.standard_normal())
    >>> run = Trajectory(0.05 * np.arange(401.0), np.array(x)[:, None], ("x",))
    >>> own = sympy.Symbol("x")
    >>> system = StochasticSystem({"x": -0.5 * own}, {"x": sympy.Float(1.0)}, Series.of([run]))
    >>> fit = system.fit()
    >>> bool(abs(fit.values[0] + 1.026) < 2 * fit.sizes[0]), fit.diffusion["x"].round(1)
    (True, 1.9)
    """

    drift: Mapping[str, sympy.Expr]
    diffusion: Mapping[str, sympy.Expr]
    series: Series
    errors: Mapping[str, float] | None = None
    correlations: Mapping[tuple[str, str], float] | None = None
    free: tuple[str, ...] | None = None
    settings: StochasticSettings = STOCHASTIC

    @cached_property
    def _templates(self) -> tuple[list[sympy.Expr], list[str], np.ndarray]:
        """Drift and diffusion with names for their constants, those names, and their values."""
        exprs: list[sympy.Expr] = []
        values: dict[sympy.Symbol, float] = {}
        states = self.series.states
        for state in states:
            expr = self.drift[state]
            if self.free is None or state in self.free:
                expr, own = free_constants(expr, f"constant {state} ")
                values |= own
            exprs.append(expr)
        for state in states:
            expr, own = free_constants(self.diffusion[state], f"diffusion {state} ")
            exprs.append(expr)
            values |= own
        return exprs, [str(name) for name in values], np.array(list(values.values()))

    @cached_property
    def _program(self) -> Program:
        exprs, names, _ = self._templates
        return compile_columns(exprs, [*self.series.states, *self.series.driven_names, *names])

    @cached_property
    def least(self) -> np.ndarray:
        """(k,) least diffusion of each state."""
        step = float(np.median(self.series.h[self.series.h > 0]))
        found: np.ndarray = self.settings.least * self.series.scale**2 / step
        return found

    @cached_property
    def _one(self) -> np.ndarray:
        return np.eye(len(self.series.states))

    @cached_property
    def _ways(self) -> np.ndarray:
        """(2 k + 1, k) ways from a mean to the points at which slopes are taken."""
        return np.concatenate([np.zeros_like(self._one[:1]), self._one, -self._one])

    @cached_property
    def owners(self) -> tuple[str, ...]:
        """The state of each constant of the drift."""
        names = self._templates[1]
        return tuple(name.split()[1] for name in names if name.startswith("constant"))

    @cached_property
    def _counts(self) -> tuple[int, int, int, int]:
        """How many values are in the drift, the diffusion, the errors and the correlations."""
        drift = len(self.owners)
        diffusion = len(self._templates[1]) - drift
        return drift, diffusion, len(self.errors or {}), len(self.correlations or {})

    @cached_property
    def start(self) -> np.ndarray:
        """(P,) values that a fit begins with.

        Constants of the drift, logarithms of those of the diffusion and of errors, and the inverse
        hyperbolic tangents of correlations.
        """
        drift, values = self._counts[0], self._templates[2]
        logs = np.log([*values[drift:], *(self.errors or {}).values()])
        turned = np.arctanh(list((self.correlations or {}).values()))
        return np.concatenate([values[:drift], logs, turned])

    def _split(self, values: np.ndarray) -> tuple[list[np.ndarray], np.ndarray | None, np.ndarray]:
        """Constants (Q, 1, 1) each, variances of the errors (Q, k), correlations (Q, k, k)."""
        drift, diffusion, errors, _ = self._counts
        states, k = self.series.states, len(self.series.states)
        constants = [*values[:, :drift].T, *np.exp(values[:, drift : drift + diffusion]).T]
        own = values[:, drift + diffusion : drift + diffusion + errors]
        variances = None
        if self.errors:
            variances = np.zeros((len(values), k))
            places = [states.index(state) for state in self.errors]
            variances[:, places] = np.exp(2 * own)
        mixed = np.broadcast_to(np.eye(k), (len(values), k, k)).copy()
        for place, (one, other) in enumerate(self.correlations or {}):
            i, j = states.index(one), states.index(other)
            mixed[:, i, j] = mixed[:, j, i] = np.tanh(values[:, drift + diffusion + errors + place])
        return [c[:, None, None] for c in constants], variances, mixed

    def _rates(
        self,
        constants: list[np.ndarray],
        mixed: np.ndarray,
        driven: np.ndarray,
        mean: np.ndarray,
        spread: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Give m' (Q, R, k) and V' (Q, R, k, k); ``driven`` is (d, R)."""
        k = mean.shape[-1]
        own = np.einsum("...ii->...i", spread)
        # The fourth moment of a normal variable, which the points give too.
        kurtosis = 3
        # A step of the covariance is linear in it, also where a stage is no covariance yet.
        far = np.sqrt(kurtosis * np.maximum(own, 0.0) + (_STEP * self.series.scale) ** 2)
        points = mean[..., None, :] + far[..., None, :] * self._ways
        columns = [*points.transpose(3, 0, 1, 2), *driven[:, None, :, None]]
        found = self._program(*columns, *constants)
        slopes, variances = found[:k], np.maximum(found[k:], self.least[:, None, None, None])
        middle, ahead, behind = slopes[..., :1], slopes[..., 1 : k + 1], slopes[..., k + 1 :]
        bent = ((ahead + behind - 2 * middle) / (2 * kurtosis)).sum(axis=-1)
        drift = (middle[..., 0] + bent).transpose(1, 2, 0)
        turned = ((ahead - behind) / (2 * far)).transpose(1, 2, 0, 3) @ spread
        sizes = np.sqrt(variances)
        middle, ahead, behind = sizes[..., :1], sizes[..., 1 : k + 1], sizes[..., k + 1 :]
        if self.correlations:
            roots = middle[..., 0]
            noise = np.einsum("iqr,jqr,qij->qrij", roots, roots, mixed)
        else:
            mean_of = (ahead**2 + behind**2 - 2 * middle**2).sum(axis=-1) / (2 * kurtosis)
            noise = (middle[..., 0] ** 2 + mean_of).transpose(1, 2, 0)[..., None] * self._one
        return drift, turned + turned.swapaxes(-1, -2) + noise

    def _move(
        self,
        constants: list[np.ndarray],
        mixed: np.ndarray,
        h: np.ndarray,
        driven: np.ndarray,
        mean: np.ndarray,
        spread: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Move mean and covariance over one step (Runge and Kutta of order 4)."""
        one, two = h[:, None], h[:, None, None]
        sums = [np.zeros_like(mean), np.zeros_like(spread)]
        m, v = mean, spread
        for stage, (place, weight, next_one) in enumerate(
            ((0, 1, 0.5), (1, 2, 0.5), (1, 2, 1.0), (2, 1, 0.0))
        ):
            dm, dv = self._rates(constants, mixed, driven[place], m, v)
            sums[0] += weight * dm
            sums[1] += weight * dv
            if stage < len(sums) + 1:
                m, v = mean + next_one * one * dm, spread + next_one * two * dv
        whole = sum((1, 2, 2, 1))
        return mean + one / whole * sums[0], spread + two / whole * sums[1]

    def innovations(self, values: np.ndarray, series: Series | None = None) -> Innovations:
        """Give what each step misses, with (Q, P) values; raises LinAlgError where that fails."""
        series = self.series if series is None else series
        constants, errors, mixed = self._split(values)
        (runs, rows, k), sets = series.y.shape, len(values)
        misses = np.zeros((sets, runs, rows - 1, k))
        covariance = np.broadcast_to(np.eye(k), (*misses.shape, k)).copy()
        told = np.isfinite(series.y)
        noise = np.zeros((sets, 1, k)) if errors is None else errors[:, None]
        one = self._one
        first = np.where(told[:, 0], series.y[:, 0], np.nanmean(series.y, axis=(0, 1)))
        known = np.where(told[:, 0], noise, self.series.scale**2)
        mean = np.broadcast_to(first, (sets, runs, k)).copy()
        spread = known[..., None] * one
        for row in range(rows - 1):
            going = series.h[:, row] > 0
            some = slice(None) if np.all(going) else np.flatnonzero(going)
            moved, wider = self._move(
                constants,
                mixed,
                series.h[some, row],
                series.driven[:, :, some, row],
                mean[:, some],
                spread[:, some],
            )
            seen = told[some, row + 1]
            both = seen[:, :, None] & seen[:, None, :]
            size = np.where(both, wider + noise[..., None] * one, one)
            missed = np.where(seen, series.y[some, row + 1] - moved, 0.0)
            misses[:, some, row], covariance[:, some, row] = missed, size
            if rows == 2:
                break
            gain = np.where(seen[:, None, :], wider, 0.0) @ np.linalg.inv(size)
            mean[:, some] = moved + np.einsum("qrij,qrj->qri", gain, missed)
            left = wider - gain @ np.where(seen[:, :, None], wider, 0.0)
            spread[:, some] = (left + left.swapaxes(-1, -2)) / 2
        if not (np.all(np.isfinite(misses)) and np.all(np.isfinite(covariance))):
            raise LinAlgError
        steps = np.where(series.h[..., None] > 0, told[:, 1:], False)
        return Innovations(misses, covariance, steps)

    @property
    def rows_at_a_time(self) -> int:
        """Runs that are moved at a time."""
        k = len(self.series.states)
        each = (len(self.start) + 1) * (2 * k + 1) * math.isqrt(self.series.h.shape[1])
        return max(1, self.settings.block // each)

    def log_likelihood(self, values: np.ndarray) -> float:
        """Give the natural logarithm of the likelihood of (P,) values; -inf where it has none."""
        found = 0.0
        try:
            with np.errstate(all="ignore"):
                for some in self.series.blocks(self.rows_at_a_time):
                    found += float(self.innovations(values[None], some).log_likelihood[0])
        except LinAlgError:
            return -math.inf
        return found if math.isfinite(found) else -math.inf

    def _scoring(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give the slope (P,) of the log-likelihood and Fisher's information (P, P)."""
        steps = _STEP * np.maximum(np.abs(values), self.units(values))
        sets = np.concatenate([values[None], values + np.diag(steps)])
        pull, information = np.zeros(len(values)), np.zeros((len(values),) * 2)
        for some in self.series.blocks(self.rows_at_a_time):
            found = self.innovations(sets, some)
            by = steps[:, None, None, None]
            shifts = (found.misses[1:] - found.misses[0]) / by
            wider = (found.covariance[1:] - found.covariance[0]) / by[..., None]
            inverse, misses = found.inverse[0], found.misses[0]
            white = np.einsum("rnij,rnj->rni", inverse, misses)
            pull -= np.einsum("prni,rni->p", shifts, white)
            relative = np.einsum("rnij,prnjk->prnik", inverse, wider)
            pull += np.einsum("prnij,rni,rnj->p", wider, white, white) / 2
            pull -= np.einsum("prnii->p", relative) / 2
            information += np.einsum("prni,rnij,qrnj->pq", shifts, inverse, shifts, optimize=True)
            information += np.einsum("prnij,qrnji->pq", relative, relative, optimize=True) / 2
        return pull, information

    def units(self, values: np.ndarray) -> np.ndarray:
        """(P,) usual sizes of values: changes that change an equation by as much as it says.

        Parameters
        ----------
        values : (P,) where the system is.
        """
        drift, columns = self._counts[0], self.series.columns
        count = drift + self._counts[1]
        rows = [columns[n] for n in (*self.series.states, *self.series.driven_names)]
        rows = [np.nan_to_num(row, nan=np.nanmean(row)) for row in rows]
        numbers = np.concatenate([values[:drift], np.exp(values[drift:count])])
        found = np.ones(len(values))
        if not drift:
            return found
        own = self._program(*rows, *numbers)
        places = [self.series.states.index(state) for state in self.owners]
        steps = _STEP * np.maximum(np.abs(numbers), _STEP)
        slopes = [
            (self._program(*rows, *(numbers + steps * (np.arange(count) == i)))[p] - own[p])
            / steps[i]
            for i, p in enumerate(places)
        ]
        found[:drift] = usual_scales(own, np.array(places), np.array(slopes))
        return found

    def fit(self) -> StochasticFit | None:
        """Fit the values; None where the start has no likelihood."""
        values, damping, drift = self.start, 0.0, self._counts[0]
        far = self.settings.farthest
        reached = self.log_likelihood(values)
        if not math.isfinite(reached):
            return None
        for _ in range(self.settings.rounds):
            try:
                with np.errstate(all="ignore"):
                    pull, information = self._scoring(values)
            except LinAlgError:
                break
            before = reached
            own = np.sqrt(np.maximum(np.diag(information), _EPS**2))
            scaled = information / np.outer(own, own)
            while damping < 1 / _STEP:
                shift = np.linalg.lstsq(
                    scaled + damping * np.eye(len(values)), pull / own, rcond=None
                )[0]
                step = shift / own
                # What a logarithm is far from, its slope says little of.
                step[drift:] = np.clip(step[drift:], -far, far)
                now = self.log_likelihood(values + step)
                if now > reached:
                    values, reached, damping = values + step, now, damping / 4
                    break
                damping = max(4 * damping, self.settings.least)
            if reached < before + self.settings.gain:
                break
        return self._finish(values, reached)

    def _finish(self, values: np.ndarray, reached: float) -> StochasticFit | None:
        try:
            with np.errstate(all="ignore"):
                information = self._scoring(values)[1]
        except LinAlgError:
            return None
        if not np.all(np.isfinite(information)):
            return None
        return StochasticFit(self, values, reached, information)

    def put_drift(self, numbers: Sequence[sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give the drift with numbers in the places of its constants.

        Parameters
        ----------
        numbers : in their order.
        """
        exprs, names, _ = self._templates
        given = dict(zip(map(sympy.Symbol, names), numbers, strict=False))
        return {s: e.xreplace(given) for s, e in zip(self.series.states, exprs, strict=False)}

    def put(self, values: np.ndarray) -> StochasticSystem:
        """Give the system with (P,) values in the place of its own."""
        exprs, names, _ = self._templates
        drift, diffusion, errors, _ = self._counts
        numbers = [*values[:drift], *np.exp(values[drift : drift + diffusion])]
        given = {sympy.Symbol(n): sympy.Float(v) for n, v in zip(names, numbers, strict=True)}
        written = [expr.xreplace(given) for expr in exprs]
        states, k = self.series.states, len(self.series.states)
        rest = values[drift + diffusion :]
        return replace(
            self,
            drift=dict(zip(states, written[:k], strict=True)),
            diffusion=dict(zip(states, written[k:], strict=True)),
            errors=dict(zip(self.errors or {}, np.exp(rest[:errors]).tolist(), strict=True)),
            correlations=dict(
                zip(self.correlations or {}, np.tanh(rest[errors:]).tolist(), strict=True)
            ),
        )


@dataclass(frozen=True)
class Part:
    """One term of a fitted sum.

    Parameters
    ----------
    body : the term without its factor.
    factor : its factor; 1 where it has none.
    outside, inside : places of the constants that are its factor, and of those inside it.
    """

    body: sympy.Expr
    factor: float
    outside: tuple[int, ...]
    inside: tuple[int, ...]

    @property
    def term(self) -> sympy.Expr:
        """The whole term."""
        return sympy.Float(self.factor) * self.body if self.outside else self.body


@dataclass(frozen=True, eq=False)
class DriftEstimate:
    """The constants of a drift with their covariance.

    Parameters
    ----------
    system : the stochastic system.
    constants : (C,) values, in the order of the states and of their appearance.
    covariance : (C, C) theirs.
    """

    system: StochasticSystem
    constants: np.ndarray
    covariance: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """(C,) their standard errors."""
        return np.sqrt(np.diag(self.covariance))

    def put(self, numbers: Sequence[sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give the drift with numbers in the places of the constants.

        Parameters
        ----------
        numbers : in their order.
        """
        return self.system.put_drift(numbers)


@dataclass(frozen=True, eq=False)
class StochasticFit:
    """A stochastic system that was fitted.

    Parameters
    ----------
    problem : the system that the fit began with.
    values : (P,) in the order of :attr:`StochasticSystem.start`.
    log_likelihood : natural logarithm of the likelihood.
    information : (P, P) Fisher's information of the values.
    """

    problem: StochasticSystem
    values: np.ndarray
    log_likelihood: float
    information: np.ndarray

    @cached_property
    def system(self) -> StochasticSystem:
        """The system with its fitted values."""
        return self.problem.put(self.values)

    @property
    def ratios(self) -> np.ndarray:
        """(C,) constants of the drift in units of their standard errors; 0 where undetermined."""
        own = slice(len(self.problem.owners))
        found: np.ndarray = np.abs(self.values[own]) / np.maximum(self.sizes[own], 1e-300)
        return found

    def parts(self, state: str) -> list[Part]:
        """Give the terms of the drift of a state, with the constants that are in each.

        SymPy keeps the terms of a formula in another order once its constants are others, so they
        are those of the formula that the fit began with.

        Parameters
        ----------
        state : one whose drift is fitted.
        """
        first = self.problem.owners.index(state) if state in self.problem.owners else 0
        return self._take_apart(self.problem.drift[state], first, self.values)

    def noise_parts(self, state: str) -> list[Part]:
        """Give the terms of the diffusion of a state likewise; errors are those of logarithms.

        Parameters
        ----------
        state : one of the states.
        """
        first, values = len(self.problem.owners), self.values.copy()
        values[first:] = np.exp(values[first:])
        for other in self.problem.series.states[: self.problem.series.states.index(state)]:
            first += len(free_constants(self.problem.diffusion[other], "c")[1])
        return self._take_apart(self.problem.diffusion[state], first, values)

    def _take_apart(self, expr: sympy.Expr, first: int, values: np.ndarray) -> list[Part]:
        template, own = free_constants(expr, "c")
        places = {symbol: first + i for i, symbol in enumerate(own)}
        put = {symbol: sympy.Float(values[place]) for symbol, place in places.items()}
        found = []
        for term in sympy.Add.make_args(template):
            factors = [symbol for symbol in own if symbol in sympy.Mul.make_args(term)]
            rest = term / sympy.Mul(*factors)
            found.append(
                Part(
                    rest.xreplace(put),
                    math.prod(float(values[places[symbol]]) for symbol in factors),
                    tuple(places[symbol] for symbol in factors),
                    tuple(places[symbol] for symbol in own if symbol in rest.free_symbols),
                )
            )
        return found

    @property
    def error_sizes(self) -> np.ndarray:
        """Standard errors of the logarithms of the errors of measurement."""
        first = len(self.values) - len(self.problem.correlations or {})
        return self.sizes[first - len(self.problem.errors or {}) : first]

    @property
    def estimate(self) -> DriftEstimate:
        """The constants of the drift."""
        own = slice(len(self.problem.owners))
        return DriftEstimate(self.problem, self.values[own], self.covariance[own, own])

    @property
    def drift(self) -> dict[str, sympy.Expr]:
        """State -> its drift."""
        return dict(self.system.drift)

    @property
    def diffusion(self) -> dict[str, sympy.Expr]:
        """State -> its diffusion."""
        return dict(self.system.diffusion)

    @cached_property
    def covariance(self) -> np.ndarray:
        """(P, P) of the values; inf where undetermined."""
        return covariance_of(self.information)

    @property
    def sizes(self) -> np.ndarray:
        """(P,) standard errors of the values."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def data_bits(self) -> float:
        """Bits of the data: minus the logarithm of the likelihood in base 2."""
        return -self.log_likelihood / math.log(2)

    @property
    def constant_bits(self) -> float:
        """Bits of all values, each to the precision that the data give it."""
        units = self.problem.units(self.values)
        drift = self.values.copy()
        drift[len(self.problem.owners) :] = 0.0
        return precision_bits(self.information, units, drift)

    @cached_property
    def misses(self) -> np.ndarray:
        """(R, N - 1, k) what each step misses; NaN where unmeasured."""
        return self._each(lambda own: own.misses[0])

    @cached_property
    def white(self) -> np.ndarray:
        """(R, N - 1, k) what each step misses, with unit covariance; NaN where unmeasured."""

        def whiten(own: Innovations) -> np.ndarray:
            roots = np.linalg.cholesky(own.covariance[0])
            return np.asarray(np.linalg.solve(roots, own.misses[0][..., None])[..., 0])

        return self._each(whiten)

    def _each(self, give: Callable[[Innovations], np.ndarray]) -> np.ndarray:
        blocks = self.problem.series.blocks(self.problem.rows_at_a_time)
        parts = (self.problem.innovations(self.values[None], some) for some in blocks)
        return np.concatenate([np.where(own.told, give(own), np.nan) for own in parts])
