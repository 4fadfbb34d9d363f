"""Sparse sums and ratios of features that grow from the variables alone.

Finds y = N(x) / D(x) where N and D are short sums of products of simple functions of the
variables (:mod:`dynsr.methods.feynman.features`), without being handed a library. It is the
implicit regression of Kaheman et al. (2020, SINDy-PI) with two changes: subsets are searched
directly instead of through a threshold, and the error that counts is that of N / D.
"""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy

from dynsr.expression import complexity
from dynsr.methods.base import AbstractMethod, Progress, Report, silent
from dynsr.methods.feynman.domain import Target, make_targets
from dynsr.methods.feynman.features import Features, build_features
from dynsr.methods.feynman.subsets import RatioFit, SubsetSearch, fit_ratio
from dynsr.pareto import Candidate, ParetoFront, rmse, score_candidate
from dynsr.samples import Samples

_EXACT = 1e-9


@dataclass(frozen=True)
class RationalSearch(AbstractMethod):
    """Search for a short sum of features, or a ratio of two.

    Parameters
    ----------
    max_terms : most coefficients in a formula, numerator and denominator together.
    costs : feature costs at which the search is run in turn; it ends early once a formula is
        exact, or the same at two costs.
    max_features : features at most in the numerator's library.
    denominators : search ratios too.
    width : subsets kept at each size.
    rounds : searches at each cost; from the second on samples are weighted by how well the best
        formula so far explains them (Cauchy weights), since slopes of trajectories carry a few
        large errors among many small ones.
    keep : formulas handed on at each size.
    max_rows : evenly spaced samples used at most.
    inverses : features are products of powers of the variables, negative ones too, and nothing
        else, up to the fourth degree above and below; for laws without a constant term.
    changes : domain changes of the target, names of ``domain.CHANGES``, that are searched after it.
    seconds : time after which nothing further is begun.

    >>> x = np.linspace(0.5, 2.0, 200)
    >>> samples = Samples(x[:, None], 3 * x / (2 + x**2), ("x",), "x", "given", x)
    >>> front = RationalSearch(costs=(2,)).search(samples, np.random.default_rng(0))
    >>> front.best_fit.loss < 1e-9
    True
    """

    max_terms: int = 6
    costs: tuple[int, ...] = (3, 4, 6)
    max_features: int = 1500
    denominators: bool = True
    width: int = 200
    rounds: int = 2
    keep: int = 4
    max_rows: int = 2000
    inverses: bool = False
    changes: tuple[str, ...] = ()
    seconds: float = math.inf

    name = "rational"

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search; ``rng`` is not used, since nothing here is left to chance."""
        front = ParetoFront()
        try:
            for done, candidates in enumerate(self.find(samples)):
                front = front.add(*candidates)
                report(Progress("rational", done + 1, len(self.costs) * self.rounds, front))
        except KeyboardInterrupt:
            pass
        return front

    def find(self, samples: Samples) -> Iterator[list[Candidate]]:
        """Yield the best formulas of every size, after each search."""
        if np.ptp(samples.y) == 0:
            yield [score_candidate(sympy.Float(float(samples.y[0])), samples, self.name)]
            return
        deadline = time.monotonic() + self.seconds
        for target in make_targets(samples.y, self.changes):
            if target.change.name == "y":
                exact = yield from self._find(samples, deadline)
            else:
                changed = replace(samples, y=target.values)
                exact = yield from self._find_back(changed, target, samples, deadline)
            if exact or time.monotonic() > deadline:
                return

    def _find_back(
        self, changed: Samples, target: Target, samples: Samples, deadline: float
    ) -> Generator[list[Candidate], None, bool]:
        """Find formulas for a changed target and turn them into formulas of the target itself."""
        search = self._find(changed, deadline)
        while True:
            try:
                found = next(search)
            except StopIteration as end:
                return bool(end.value)
            name = f"{self.name} of {target.name}"
            yield [score_candidate(target.build(c.expr), samples, name) for c in found]

    def _find(self, samples: Samples, deadline: float) -> Generator[list[Candidate], None, bool]:
        """Yield formulas after each search; give in the end whether one is exact."""
        rows = samples
        if len(samples) > self.max_rows:
            rows = samples.select(np.linspace(0, len(samples) - 1, self.max_rows).astype(int))
        weights = np.ones(len(rows))
        reached: sympy.Expr | None = None
        used = set(rows.names)
        for cost in self.costs:
            numerators = self._numerators(rows.columns, cost, used)
            for _ in range(self.rounds):
                ranked = self._search_once(rows, numerators, cost, weights, deadline)
                if not ranked:
                    return False
                yield [formula.score(samples) for group in ranked for formula in group[: self.keep]]
                plain = _plainest(ranked)
                if float(np.abs(plain.residual).max()) < _EXACT * float(np.ptp(rows.y)):
                    return True
                weights = 1 / (1 + (plain.residual / max(plain.median, 1e-300)) ** 2)
                if time.monotonic() > deadline:
                    return False
            if plain.shape == reached:
                return False
            reached = plain.shape
            used = {str(v) for f in _close_to_least(ranked)[:2] for v in f.expr.free_symbols}
        return False

    def _numerators(self, columns: dict[str, np.ndarray], cost: int, used: set[str]) -> Features:
        """Features of all variables; where those are too many, of the variables in use alone."""
        features = build_features(columns, cost, 4, self.max_features, self.inverses)
        if features.costs[-1] < cost and used < set(columns):
            few = {name: values for name, values in columns.items() if name in used}
            features = build_features(few, cost, 4, self.max_features, self.inverses)
        return features

    def _search_once(
        self,
        rows: Samples,
        numerators: Features,
        cost: int,
        weights: np.ndarray,
        deadline: float,
    ) -> list[list[_Formula]]:
        degree = 4 if self.inverses else 2
        denominators = build_features(rows.columns, min(cost, 4), degree, inverses=self.inverses)
        below = denominators.values[1:] if self.denominators else np.empty((0, len(rows)))
        subsets = SubsetSearch(numerators.values, below, rows.y, weights, self.width, deadline)
        fits = [
            [fit_ratio(subsets, support) for support in supports[: 5 * self.keep]]
            for supports in subsets.search(self.max_terms)
        ]
        if not fits:
            return []
        medians = [float(np.median(np.abs(fit.residual))) for group in fits for fit in group]
        floor = max(np.nanmin(medians), 1e-12 * float(np.abs(rows.y).max()))
        ranked = []
        for group in fits:
            formulas = [_Formula(fit, numerators, denominators, floor) for fit in group]
            ranked.append(sorted(formulas, key=lambda formula: formula.bits))
        return ranked


@dataclass(frozen=True, eq=False)
class _Formula:
    fit: RatioFit
    numerators: Features
    denominators: Features
    floor: float

    @cached_property
    def expr(self) -> sympy.Expr:
        """The formula itself; only those that are handed on need it."""
        return _expression(self.fit, self.numerators, self.denominators)

    @property
    def residual(self) -> np.ndarray:
        return self.fit.residual

    def score(self, samples: Samples) -> Candidate:
        """Make the candidate; its loss is at hand when the fit used all samples."""
        if len(samples) != len(self.residual):
            return score_candidate(self.expr, samples, RationalSearch.name)
        loss = rmse(self.residual, np.zeros(len(samples)))
        return Candidate(self.expr, loss, complexity(self.expr), RationalSearch.name)

    @property
    def median(self) -> float:
        value = float(np.median(np.abs(self.residual)))
        return value if math.isfinite(value) else math.inf

    @property
    def shape(self) -> sympy.Expr:
        """The formula with all its floats alike."""
        return self.expr.xreplace({number: sympy.S.Pi for number in self.expr.atoms(sympy.Float)})

    @property
    def bits(self) -> float:
        """Bits a sample of the residual above the floor."""
        with np.errstate(all="ignore"):
            data = float(np.mean(np.log2(1 + np.abs(self.residual) / self.floor)))
        return data if math.isfinite(data) else math.inf


def _close_to_least(ranked: list[list[_Formula]]) -> list[_Formula]:
    least = min(group[0].bits for group in ranked)
    return [group[0] for group in ranked if group[0].bits <= least + 0.25]


def _plainest(ranked: list[list[_Formula]]) -> _Formula:
    """The formula of fewest terms whose data bits are close to the least of all.

    More terms always explain slopes a little better, because their errors are not independent.
    """
    return _close_to_least(ranked)[0]


def _expression(fit: RatioFit, numerators: Features, denominators: Features) -> sympy.Expr:
    """Write N / D with the common factor that makes most coefficients simple."""
    top = [(numerators.exprs[i], c) for i, c in fit.numerator.items()]
    if not fit.denominator:
        return sympy.Add(*(sympy.Float(c) * e for e, c in top))
    bottom = [(sympy.S.One, 1.0)]
    bottom += [(denominators.exprs[j + 1], c) for j, c in fit.denominator.items()]
    scale, pinned = _common_factor([c for _, c in (*bottom, *top)])
    terms = [(e, c * scale) for e, c in (*bottom, *top)]
    numbers = [sympy.Float(c) for _, c in terms]
    # One number is free to choose in a ratio; as an integer it stays out of later refinement.
    numbers[pinned] = sympy.Integer(round(terms[pinned][1]))
    products = [number * e for number, (e, _) in zip(numbers, terms, strict=True)]
    return sympy.Add(*products[len(bottom) :]) / sympy.Add(*products[: len(bottom)])


def _common_factor(coefficients: list[float]) -> tuple[float, int]:
    """Factor that brings most coefficients near integers, and which one it makes an integer."""
    best = (math.inf, 1.0, 0)
    for index, coefficient in enumerate(coefficients):
        if coefficient == 0:
            continue
        for whole in (1, 2, 3, 4):
            factor = whole / abs(coefficient)
            price = sum(_price(c * factor) for c in coefficients)
            if price < best[0] - 1e-9:
                best = (price, factor, index)
    return best[1], best[2]


def _price(value: float) -> float:
    nearest = round(value)
    if nearest and abs(value - nearest) < 0.01 * abs(value) and abs(nearest) < 10:
        return math.log2(1 + abs(nearest))
    return 10 + abs(math.log2(max(abs(value), 1e-12)))
