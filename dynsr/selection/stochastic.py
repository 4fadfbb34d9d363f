"""Stochastic systems found: the drift and the diffusion of rows whose motion has noise itself.

The change of a state from row to row, over the time between, is its drift with the error
sqrt(D/h). That is evidence for sums of terms of the library. Those that are expected to take the
fewest bits are fitted by the probability of each step, and compared by all their bits. So are the
forms of the diffusion: sums of one or two products of columns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, combinations_with_replacement

import numpy as np
import sympy
from scipy.optimize import nnls

from dynsr.data import MotionNoise, Trajectory, measure_motion_noise
from dynsr.expression import evaluate, has_pole, skeleton
from dynsr.fit import (
    Series,
    StochasticFit,
    StochasticSettings,
    StochasticSystem,
    constant_bits,
    structure_bits,
)
from dynsr.library import Place, find_turning, structure_of
from dynsr.methods import Demands
from dynsr.selection.evidence import Evidence
from dynsr.selection.propose import ProposalSettings, propose
from dynsr.selection.shapes import bodies_of

Equations = Mapping[str, sympy.Expr]


@dataclass(frozen=True)
class StochasticSearchSettings:
    """Settings of the search for drift and diffusion; they are in the record of a run.

    Parameters
    ----------
    tried : formulas of a drift that are fitted, in each round.
    rounds : times that drifts and diffusions are searched in turn.
    compared : other formulas of a drift that the verdict compares.
    piece : rows of a piece of a run, where errors of measurement are fitted.
    rows : steps that are searched; the last fit is to all.
    chance : probability below which what the steps miss is no chance.
    degrees : of the products of columns that what they miss, and its squares, may not follow.
    products : of these to each step, at most.
    proposals : of sums of terms.
    fit : of the probability of each step.
    """

    tried: int = 12
    rounds: int = 3
    compared: int = 4
    piece: int = 100
    rows: int = 20_000
    chance: float = 1e-3
    degrees: tuple[int, int] = (3, 2)
    products: float = 0.1
    proposals: ProposalSettings = ProposalSettings()
    fit: StochasticSettings = StochasticSettings()


STOCHASTIC_SEARCH = StochasticSearchSettings()


@dataclass(frozen=True, eq=False)
class StochasticFound:
    """A stochastic system that was fitted, and its bits."""

    fit: StochasticFit
    bits: float

    @property
    def drift(self) -> dict[str, sympy.Expr]:
        """State -> its drift."""
        return self.fit.drift

    @property
    def diffusion(self) -> dict[str, sympy.Expr]:
        """State -> its diffusion."""
        return self.fit.diffusion


@dataclass(frozen=True, eq=False)
class StochasticSearch:
    """Looks for the drift and the diffusion of all states of a series.

    Parameters
    ----------
    series : the rows.
    noise : state -> what its differences say of its noise.
    demands : what the user asks of the drift.
    settings : the numbers that decide.
    """

    series: Series
    noise: Mapping[str, MotionNoise]
    demands: Demands = Demands()
    settings: StochasticSearchSettings = STOCHASTIC_SEARCH
    _cache: dict[object, StochasticFound | None] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        runs: Sequence[Trajectory],
        inputs: Mapping[str, sympy.Expr] | None = None,
        demands: Demands | None = None,
        settings: StochasticSearchSettings = STOCHASTIC_SEARCH,
    ) -> StochasticSearch:
        """Take trajectories of the same columns.

        Parameters
        ----------
        runs : the trajectories.
        inputs : input name -> expression in ``t`` where it is known.
        demands, settings : as for the search.
        """
        noise = {state: measure_motion_noise(runs, state) for state in runs[0].states}
        return cls(Series.of(runs, inputs), noise, demands or Demands(), settings)

    @cached_property
    def lag(self) -> int:
        """Rows from one value to the next one that is compared.

        The noise of the motion in between is four times what errors of measurement say, or more.
        """
        step = float(np.median(self.series.h[self.series.h > 0]))
        own = [
            math.ceil(4 * 2 * one.error**2 / (one.diffusion * step))
            for one in self.noise.values()
            if one.diffusion > 0 and one.share > 0
        ]
        return min(max([1, *own]), max(1, self.series.y.shape[1] // self.settings.proposals.nodes))

    @cached_property
    def steps(self) -> Series:
        """Steps between values that are far enough apart, each as a run of two rows."""
        return self.series.every(self.lag).apart(self.settings.rows)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns that a formula may contain; not the time."""
        return (*self.series.states, *self.series.driven_names[:-1])

    @cached_property
    def _angles(self) -> tuple[str, ...]:
        columns = self.series.columns
        return find_turning(self.names, [_filled(columns[name]) for name in self.names])

    def structure(self, drift: Equations, diffusion: Equations) -> float:
        """Bits of equations without their constants."""
        own = structure_of(drift, self.names, self.series.states, self._angles)
        return own + sum(map(structure_bits, diffusion.values()))

    def fit(
        self,
        drift: Equations,
        diffusion: Equations,
        free: tuple[str, ...] | None = None,
        series: Series | None = None,
        errors: Mapping[str, float] | None = None,
        correlations: Mapping[tuple[str, str], float] | None = None,
    ) -> StochasticFound | None:
        """Fit a system; None where it has no likelihood.

        Parameters
        ----------
        drift, diffusion : state -> formula.
        free : the states whose drift is fitted; by default all.
        series : the rows; by default the steps.
        errors, correlations : errors of measurement, and correlations, that are fitted too.
        """
        if not self.demands.keep_all(drift):
            return None
        rows = self.steps if series is None else series
        key = (
            tuple(drift.items() if free else map(skeleton, drift.values())),
            tuple(map(skeleton, diffusion.values())),
            free,
            series is None,
            tuple(errors or ()),
            tuple(correlations or ()),
        )
        if key not in self._cache:
            problem = StochasticSystem(
                drift, diffusion, rows, errors, correlations, free, self.settings.fit
            )
            made = problem.fit()
            self._cache[key] = None if made is None else self._count(made)
        return self._cache[key]

    def _count(self, fit: StochasticFit) -> StochasticFound | None:
        """Give a fit with its bits; None for one with a pole, or a constant inside that is lost.

        A constant inside a function that may as well be 0 or infinite tends to a shorter formula.
        """
        ratios = fit.ratios
        free = fit.problem.free or self.series.states
        inside = [place for s in free for part in fit.parts(s) for place in part.inside]
        if np.any(ratios[inside] < 1):
            return None
        columns = {name: _filled(row) for name, row in self.series.columns.items()}
        if any(has_pole(expr, columns) for expr in fit.drift.values()):
            return None
        bits = fit.data_bits + fit.constant_bits + self.structure(fit.drift, fit.diffusion)
        return StochasticFound(fit, bits) if math.isfinite(bits) else None

    def mean_of(self, expr: sympy.Expr) -> float:
        """Give the mean of a formula where the steps begin."""
        return float(np.mean(evaluate(expr, self.steps.columns)))

    def propose(self, state: str, drift: Equations, diffusion: Equations) -> list[sympy.Expr]:
        """Give the sums of terms of the library that are expected to take the fewest bits.

        Parameters
        ----------
        state : whose drift is proposed.
        drift, diffusion : what is known of all states.
        """
        evidence = self._evidence(state, diffusion[state])
        others = [(s, e) for s, e in drift.items() if s != state and e != 0]
        return propose(
            evidence,
            Place(state, self.series.states, self.names, self._angles),
            self.demands.limits(state).check,
            self.demands.offered,
            others,
            self.settings.proposals,
        )

    def _evidence(self, state: str, diffusion: sympy.Expr) -> Evidence:
        """Give what the changes of a state say of its drift, by the means of cells of near rows."""
        steps, place = self.steps, self.series.states.index(state)
        columns = steps.columns
        points = np.array([columns[n] for n in (*self.names, "t")])
        h = steps.h[:, 0]
        change = (steps.y[:, 1, place] - steps.y[:, 0, place]) / h
        variance = np.maximum(evaluate(diffusion, columns), np.finfo(float).tiny) / h
        weights = 1 / np.broadcast_to(variance, h.shape)
        cell = cells(points[:-1], self.settings.proposals.nodes)
        sums = np.bincount(cell, weights)
        middle = np.array([np.bincount(cell, weights * row) / sums for row in points])
        mean = np.bincount(cell, weights * change) / sums
        beside = float(np.sum(weights * (change - mean[cell]) ** 2))
        errors = 1 / np.sqrt(sums)
        names = (*self.names, "t")
        return Evidence(names, middle, mean / errors, 1 / errors, beside, float(len(h)))

    def run(self) -> Iterator[StochasticFound]:
        """Give what is found after each round; the last is the best."""
        states = self.series.states
        drift: dict[str, sympy.Expr] = dict.fromkeys(states, sympy.S.Zero)
        diffusion = {s: sympy.Float(self.noise[s].diffusion) for s in states}
        best = self.fit(drift, diffusion)
        if best is None:
            return
        searched: dict[str, object] = {}
        for _ in range(self.settings.rounds):
            before = best
            for state in states:
                # What a search depends on: the others' terms, and how certain each change is.
                about = [skeleton(e) for s, e in best.drift.items() if s != state]
                about.append(skeleton(best.diffusion[state]))
                if searched.get(state) != about:
                    searched[state] = about
                    best = self._better_drift(best, state)
            best = self.prune(best)
            for state in states:
                best = self._better_diffusion(best, state)
            yield best
            if best.bits >= before.bits - 1:
                return

    def _better_drift(self, best: StochasticFound, state: str) -> StochasticFound:
        """Give the best of the system and of those with another drift of one state."""
        proposed = self.propose(state, best.drift, best.diffusion)
        # What is the slope of another state, as a velocity is.
        others = [sympy.Symbol(name) for name in self.names if name != state]
        tried = [sympy.S.Zero, *others, *proposed[: self.settings.tried]]
        fitted = (self.fit({**best.drift, state: e}, best.diffusion, (state,)) for e in tried)
        alone = sorted(filter(None, fitted), key=lambda own: own.bits)
        pruned = [self.prune(one, (state,)) for one in alone[: self.settings.compared]]
        for one in sorted(pruned, key=lambda own: own.bits)[:2]:
            whole = self.fit(one.drift, one.diffusion)
            if whole is not None and whole.bits < best.bits:
                best = whole
        return best

    def prune(self, found: StochasticFound, free: tuple[str, ...] | None = None) -> StochasticFound:
        """Leave out terms of the drift, the least sure first, while that takes fewer bits.

        Parameters
        ----------
        found : the system.
        free : the states whose drift is fitted; by default all.
        """
        while True:
            # A constant that may as well be 0 takes next to no bits, and says nothing.
            most = found.bits if np.all(found.fit.ratios >= 1) else math.inf
            fitted = (self.fit(e, found.diffusion, free) for e in self._shortened(found))
            shorter = (one for one in fitted if one is not None and one.bits < most)
            one = next(shorter, None)
            if one is None:
                return found
            found = one

    def _shortened(self, found: StochasticFound) -> Iterator[dict[str, sympy.Expr]]:
        """Give the system without one of its terms, that with the least sure constant first."""
        ratios, free = found.fit.ratios, found.fit.problem.free
        ranked: list[tuple[float, str, sympy.Expr]] = []
        for state in free or self.series.states:
            parts = found.fit.parts(state)
            for part in parts:
                own = ratios[[*part.outside, *part.inside]]
                rest = sympy.Add(*[one.term for one in parts if one is not part])
                ranked.append((float(own.min(initial=math.inf)), state, rest))
        for _, state, rest in sorted(ranked, key=lambda one: one[0]):
            yield {**found.drift, state: rest}

    def _better_diffusion(self, best: StochasticFound, state: str) -> StochasticFound:
        """Give the best of the system and of those with another diffusion of one state."""
        problem = best.fit.problem
        series = None if problem.series is self.steps else problem.series
        for expr in self._diffusions(best, state):
            diffusion = {**best.diffusion, state: expr}
            errors = best.fit.system.errors
            other = self.fit(best.drift, diffusion, series=series, errors=errors)
            if other is not None and other.bits < best.bits:
                best = other
        return best

    def _diffusions(self, best: StochasticFound, state: str) -> list[sympy.Expr]:
        """Give sums of products of columns that the squares of the residuals follow."""
        place = self.series.states.index(state)
        white = best.fit.white[..., place].ravel()
        told = np.isfinite(white)
        columns = {n: _filled(row)[told] for n, row in best.fit.problem.series.columns.items()}
        squares = white[told] ** 2 * evaluate(best.diffusion[state], columns)
        bodies = self._bodies(state, columns)
        values = np.array([np.broadcast_to(evaluate(b, columns), squares.shape) for b in bodies])
        found: list[tuple[float, sympy.Expr]] = []
        for count in (1, 2):
            for chosen in combinations(range(len(bodies)), count):
                rows = values[list(chosen)]
                weights = _fit_variances(rows, squares)
                if np.all(weights > 0):
                    level = weights @ rows
                    bits = float(np.sum(np.log2(level) + squares / level / math.log(2))) / 2
                    expr = sympy.Add(
                        *[sympy.Float(w) * bodies[i] for w, i in zip(weights, chosen, strict=True)]
                    )
                    more = count * math.log2(len(squares)) / 2
                    found.append((bits + more + structure_bits(expr), expr))
        found.sort(key=lambda one: one[0])
        return [expr for _, expr in found[: self.settings.compared]]

    def _bodies(self, state: str, columns: Mapping[str, np.ndarray]) -> list[sympy.Expr]:
        """Give the products of one or two columns that are never below 0, and 1."""
        symbols = [sympy.Symbol(name) for name in self.names]
        own = sympy.Symbol(state)
        pairs = [one * two for one, two in combinations_with_replacement(symbols, 2)]
        bodies = [sympy.S.One, *symbols, *pairs]
        # Where a state comes to 0, noise that stays is another one.
        named = [b for b in bodies if b.is_number or own in b.free_symbols or len(symbols) <= 4]
        return [b for b in named if b.is_number or float(np.min(evaluate(b, columns))) > 0]

    def finish(self, best: StochasticFound) -> StochasticFound:
        """Fit to all rows, with errors of measurement and correlations where these save bits.

        Parameters
        ----------
        best : the system that was found on the steps.
        """
        best = self.fit(best.drift, best.diffusion, series=self.series.apart()) or best
        best = self._with_errors(best)
        if best.fit.system.errors:
            # Errors of measurement look like noise that is the same everywhere.
            for state in self.series.states:
                best = self._better_diffusion(best, state)
        return self._with_correlations(best)

    def _with_errors(self, best: StochasticFound) -> StochasticFound:
        rows = self.series.pieces(self.settings.piece)
        errors: dict[str, float] = {}
        for state, own in sorted(self.noise.items(), key=lambda pair: pair[1].share):
            if own.error > 0:
                more = {**errors, state: own.error}
                other = self.fit(best.drift, best.diffusion, series=rows, errors=more)
                if other is None or other.bits >= best.bits:
                    continue
                # The logarithm of an error that is not seen is not determined.
                if np.all(other.fit.error_sizes < 1):
                    best, errors = other, dict(other.fit.system.errors or {})
        return best

    def _with_correlations(self, best: StochasticFound) -> StochasticFound:
        states, found = self.series.states, dict[tuple[str, str], float]()
        series, errors = best.fit.problem.series, best.fit.system.errors
        white = best.fit.white.reshape(-1, len(states))
        least = best.fit.system.least
        noisy = [i for i, s in enumerate(states) if self.mean_of(best.diffusion[s]) > 2 * least[i]]
        for i, j in combinations(noisy, 2):
            both = white[:, i] * white[:, j]
            both = both[np.isfinite(both)]
            value = float(np.mean(both)) if len(both) else 0.0
            saved = -len(both) / 2 * math.log2(max(1 - value**2, np.finfo(float).tiny))
            if saved > constant_bits(len(both)) + 1:
                more = {**found, (states[i], states[j]): value}
                other = self.fit(
                    best.drift,
                    best.diffusion,
                    series=series,
                    errors=errors,
                    correlations=more,
                )
                if other is not None and other.bits < best.bits:
                    best, found = other, dict(other.fit.system.correlations or {})
        return best

    def alternatives(self, best: StochasticFound, state: str) -> list[tuple[sympy.Expr, float]]:
        """Give other drifts of one state, and the bits that they take more, the fewest first.

        One that has all terms of the best and more, and takes more bits, is left out: any law may
        have a term that is too small to be seen.

        Parameters
        ----------
        best : the system that was found on the steps.
        state : whose drift is another one.
        """
        shapes: dict[sympy.Expr, StochasticFound] = {}
        steps = [
            one
            for one in filter(None, self._cache.values())
            if one.fit.problem.series is self.steps
        ]
        for one in sorted(steps, key=lambda own: own.bits):
            shapes.setdefault(skeleton(one.drift[state]), one)
        shapes.pop(skeleton(best.drift[state]), None)
        found, own = [], set(bodies_of(best.drift[state]))
        for one in list(shapes.values())[: 3 * self.settings.compared]:
            whole = self.fit({**best.drift, state: one.drift[state]}, best.diffusion)
            if whole is None:
                continue
            bits = whole.bits - best.bits
            if bits < 0 or not own <= set(bodies_of(whole.drift[state])):
                found.append((whole.drift[state], bits))
        return sorted(found, key=lambda pair: pair[1])


def _fit_variances(rows: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Give the weights (s,) of rows (s, n) whose sum is the variance of what has these squares."""
    if len(rows) == 1:
        # The likelihood has its top where the mean of the squares in its unit is 1.
        return np.array([float(np.mean(squares / rows[0]))])
    level = np.full(len(squares), float(squares.mean()))
    for _ in range(2 * len(rows) + 2):
        scaled = rows / level
        weights: np.ndarray = nnls(scaled @ scaled.T, scaled @ (squares / level))[0]
        level = np.maximum(weights @ rows, np.finfo(float).tiny)
    return weights


def _filled(row: np.ndarray) -> np.ndarray:
    return np.nan_to_num(row, nan=float(np.nanmean(row)))


def cells(points: np.ndarray, count: int) -> np.ndarray:
    """Give the cell (n,) of each of n points, about ``count`` cells of equally many near points.

    Parameters
    ----------
    points : (d, n) coordinates.
    count : cells at most.

    >>> cells(np.array([[0.0, 3.0, 1.0, 2.0]]), 2).tolist()
    [0, 1, 0, 1]
    """
    spread = np.ptp(points, axis=1)
    scaled = points / np.where(spread > 0, spread, 1.0)[:, None]
    groups = [np.arange(points.shape[1])]
    while 2 * len(groups) <= count and min(map(len, groups)) > 1:
        groups = list(_halves(scaled, groups))
    found = np.empty(points.shape[1], dtype=int)
    for number, own in enumerate(groups):
        found[own] = number
    return found


def _halves(points: np.ndarray, groups: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    for own in groups:
        inside = points[:, own]
        order = np.argsort(inside[int(np.argmax(np.ptp(inside, axis=1)))], kind="stable")
        yield own[order[: len(own) // 2]]
        yield own[order[len(own) // 2 :]]
