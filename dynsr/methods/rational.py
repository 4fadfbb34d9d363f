"""Sparse sums and ratios of features that grow from the variables alone.

The best small subsets for y = N(x) / D(x) are found by a beam search on Gram matrices.
"""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import Samples
from dynsr.expression import complexity, evaluate, number_bits, skeleton
from dynsr.fit import (
    Candidate,
    ParetoFront,
    RatioFit,
    cauchy_weights,
    fit_ratio,
    mean_error_bits,
    rmse,
    score_candidate,
)
from dynsr.methods.base import AbstractMethod, Progress, Report, silent
from dynsr.methods.features import Features, build_features
from dynsr.methods.feynman.problem import CHANGES, Target, make_targets
from dynsr.methods.limits import Limits

Support = frozenset[int]
# Subsets extended in one stack: enough to be quick, few enough to stay in the cache.
_CHUNK = 32


@dataclass(frozen=True, eq=False)
class SubsetSearch:
    """Search for few terms with y D(x) = N(x), linear in the coefficients of both.

    With D = 1 - sum_j b_j d_j(x) and N = sum_k a_k n_k(x) this is the regression of y on the
    columns n_k and y d_j. The error that matters is that of N / D, so a subset's score is
    sum (y D - N)^2 / mean(D^2): without the denominator a D that is nearly 0 everywhere would win.

    Parameters
    ----------
    numerators : (m, n) values of the features that N may hold.
    denominators : (q, n) values of the features that D may hold; q may be 0.
    y : (n,) target.
    weights : (n,) weight of each sample.
    width : how many subsets of each size are kept.
    deadline : ``time.monotonic()`` value after which no further subset is extended.
    collinear : a column adds nothing when the share of it that a subset does not explain is below.
    cancellation : no coefficient, of columns of norm 1, may exceed this many times the size of y.
    idle : the search ends when two more terms leave more than this share of the squared error.
    """

    numerators: np.ndarray
    denominators: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    width: int = 200
    deadline: float = math.inf
    collinear: float = 1e-7
    cancellation: float = 50.0
    idle: float = 0.81

    @cached_property
    def _columns(self) -> tuple[np.ndarray, np.ndarray]:
        columns = np.vstack([self.numerators, self.denominators * self.y])
        columns = columns * np.sqrt(self.weights)
        norms = np.linalg.norm(columns, axis=1)
        norms[norms == 0] = np.inf
        return columns / norms[:, None], norms

    @cached_property
    def _gram(self) -> tuple[np.ndarray, np.ndarray, float]:
        columns, _ = self._columns
        y = self.y * np.sqrt(self.weights)
        return columns @ columns.T, columns @ y, float(y @ y)

    @cached_property
    def _denominator_moments(self) -> tuple[np.ndarray, np.ndarray]:
        weighted = self.denominators * (self.weights / self.weights.sum())
        return weighted.sum(axis=1), weighted @ self.denominators.T

    def extend(self, supports: Sequence[Support]) -> np.ndarray:
        """(b, m + q) score of each of b subsets of one size with each column added.

        Useless additions score inf. By the bordered normal equations all additions to a subset of
        s columns together cost O((m + q) s^2).
        """
        gram, projections, total = self._gram
        chosen = np.array([sorted(support) for support in supports], dtype=int)
        rows = gram[chosen]
        systems = np.take_along_axis(rows, chosen[:, None, :], axis=2)
        right = np.concatenate([rows, projections[chosen][..., None]], axis=2)
        both = _solve(systems, right)
        solved, fitted = both[..., :-1], both[..., -1]
        pivots = 1 - np.einsum("bij,bij->bj", rows, solved)
        moments = projections - np.einsum("bij,bi->bj", rows, fitted)
        rest = total - np.einsum("bi,bi->b", projections[chosen], fitted)
        usable = pivots > self.collinear
        np.put_along_axis(usable, chosen, False, axis=1)
        added = np.where(usable, moments / np.where(usable, pivots, 1.0), 0.0)
        coefficients = fitted[..., None] - solved * added[:, None, :]
        size = np.maximum(np.abs(added), np.abs(coefficients).max(axis=1, initial=0.0))
        usable &= size < self.cancellation * np.sqrt(total)
        # The difference below is exact only to rounding of the total.
        error = np.maximum(rest[:, None] - added * moments, 1e-15 * total)
        square = self._mean_square_denominators(chosen, coefficients, added)
        return np.where(usable, error / np.maximum(square, 1e-9), np.inf)

    def _mean_square_denominators(
        self, chosen: np.ndarray, coefficients: np.ndarray, added: np.ndarray
    ) -> np.ndarray:
        """(b, m + q) mean of D^2 after each addition."""
        m = len(self.numerators)
        square = np.ones(added.shape)
        if not len(self.denominators):
            return square
        _, norms = self._columns
        first, second = self._denominator_moments
        own = added[:, m:] / norms[m:]
        square[:, m:] += -2 * own * first + own**2 * np.diag(second)
        # Columns of the numerator take no part in D: their coefficients count as 0 there.
        inside = chosen >= m
        index = np.where(inside, chosen - m, 0)
        b = np.where(inside[..., None], coefficients / norms[chosen][..., None], 0.0)
        square -= 2 * np.einsum("bs,bsj->bj", first[index], b)
        pairs = second[index[:, :, None], index[:, None, :]]
        square += np.einsum("bsj,bsj->bj", b, pairs @ b)
        square[:, m:] += 2 * own * np.einsum("bsj,bsj->bj", b[..., m:], second[index])
        return square

    def search(self, max_size: int) -> list[list[Support]]:
        """Give, for each size from 1 to ``max_size``, the best subsets found, best first.

        Every size starts from all additions to the subsets one smaller; then members are swapped,
        one at a time, until no swap improves the kept ones. Ends once two more terms lower the
        error by less than a tenth.
        """
        found: list[list[Support]] = []
        scores: list[float] = []
        parents: list[Support] = [frozenset()]
        for _ in range(max_size):
            pool: dict[Support, float] = {}
            self._grow(parents, 40, pool)
            kept = self._swap(pool)
            if not kept:
                break
            found.append(list(kept))
            scores.append(min(kept.values()))
            parents = found[-1]
            idle = len(scores) > 2 and scores[-1] > self.idle * scores[-3]
            if idle or time.monotonic() > self.deadline:
                break
        return found

    def fit(self, support: Support) -> tuple[Support, RatioFit]:
        """Fit a subset so that the error of N / D itself is least; gives it with its support."""
        m, chosen = len(self.numerators), sorted(support)
        above = self.numerators[[c for c in chosen if c < m]]
        below = self.denominators[[c - m for c in chosen if c >= m]]
        return support, fit_ratio(above, below, self.y, weights=self.weights)

    def _grow(self, supports: Sequence[Support], most: int, pool: dict[Support, float]) -> None:
        for start in range(0, len(supports), _CHUNK):
            if time.monotonic() > self.deadline:
                break
            chunk = supports[start : start + _CHUNK]
            scores = self.extend(chunk)
            most = min(most, scores.shape[1])
            best = np.argpartition(scores, most - 1, axis=1)[:, :most]
            values = np.take_along_axis(scores, best, axis=1)
            usable = np.isfinite(values)
            parents = (chunk[row] for row in np.nonzero(usable)[0].tolist())
            added = best[usable].tolist()
            for parent, column, value in zip(parents, added, values[usable].tolist(), strict=True):
                pool.setdefault(parent | {column}, value)

    def _best(self, pool: dict[Support, float]) -> dict[Support, float]:
        items = list(pool.items())
        if len(items) > self.width:
            # Most are far from the best: the order among them, dear to find, does not matter.
            worst = np.partition([value for _, value in items], self.width - 1)[self.width - 1]
            items = [item for item in items if item[1] <= worst]
        ordered = sorted(items, key=lambda item: (item[1], sorted(item[0])))
        return dict(ordered[: self.width])

    def _swap(self, pool: dict[Support, float]) -> dict[Support, float]:
        kept = self._best(pool)
        tried: set[Support] = set()
        reduced: set[Support] = set()
        for _ in range(8):
            waiting = [support for support in kept if support not in tried]
            if not waiting:
                break
            pool = dict(kept)
            tried.update(waiting)
            smaller = dict.fromkeys(s - {member} for s in waiting for member in sorted(s))
            fresh = [support for support in smaller if support not in reduced]
            reduced.update(fresh)
            self._grow(fresh, 10, pool)
            kept = self._best(pool)
        return kept


def _solve(systems: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a stack of normal equations; a singular one as if barely regular."""
    if not systems.shape[1]:
        return np.zeros(right.shape)
    try:
        return np.linalg.solve(systems, right)
    except np.linalg.LinAlgError:
        return np.linalg.solve(systems + 1e-12 * np.eye(systems.shape[1]), right)


@checked
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
    collinear, cancellation, idle : bounds of the subset search, see :class:`SubsetSearch`.
    layered : how many times wider the first two are where the states pass fast layers: elsewhere
        the law's terms cancel each other almost entirely.
    exact : largest residual, as a share of the target's range, at which a formula is exact.
    functions : functions whose products are features; None for sin, cos, exp, log and sqrt.
    terms : features of the user's own, in the columns of the samples.
    left_out : features that no numerator may have.
    close : bits a row within which a formula of fewer terms is as good as the best; more terms
        always explain slopes a little better, because their errors are not independent.

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
    collinear: float = 1e-7
    cancellation: float = 50.0
    layered: float = 1e4
    idle: float = 0.81
    exact: float = 1e-9
    close: float = 0.25
    functions: tuple[str, ...] | None = None
    terms: tuple[sympy.Expr, ...] = ()
    left_out: tuple[sympy.Expr, ...] = ()

    name = "rational"
    presets: ClassVar = {"best": {}, "quick": {"costs": (3, 4)}, "paper": {}}

    def within(self, limits: Limits) -> RationalSearch:
        """Give the search with the functions, terms and lengths allowed; see AbstractMethod."""
        vocabulary = limits.vocabulary
        changed = replace(
            self,
            max_terms=limits.most_terms(self.max_terms),
            terms=limits.terms,
            left_out=limits.left_out,
        )
        if vocabulary is None:
            return changed
        return replace(
            changed,
            functions=vocabulary.functions,
            denominators=self.denominators and vocabulary.divide,
            inverses=self.inverses and vocabulary.divide,
            changes=tuple(c for c in self.changes if vocabulary.has(CHANGES[c].back)),
        )

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
        """Yield the best formulas for the samples of every size, after each search."""
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
                plain = self._close_to_least(ranked)[0]
                if float(np.abs(plain.residual).max()) < self.exact * float(np.ptp(rows.y)):
                    return True
                weights = cauchy_weights(plain.residual, max(plain.median, 1e-300))
                if time.monotonic() > deadline:
                    return False
            before, reached = reached, skeleton(plain.expr)
            if reached == before:
                return False
            used = {str(v) for f in self._close_to_least(ranked)[:2] for v in f.expr.free_symbols}
        return False

    def _numerators(self, columns: dict[str, np.ndarray], cost: int, used: set[str]) -> Features:
        """Features of all variables; where those are too many, of the variables in use alone."""
        features = self._features(columns, cost, columns)
        if features.costs[-1] < cost and used < set(columns):
            few = {name: values for name, values in columns.items() if name in used}
            features = self._features(few, cost, columns)
        return features.without(self.left_out)

    def _features(
        self, some: dict[str, np.ndarray], cost: int, columns: dict[str, np.ndarray]
    ) -> Features:
        own = [(term, evaluate(term, columns)) for term in self.terms]
        return build_features(some, cost, 4, self.max_features, self.inverses, self.functions, own)

    def _search_once(
        self,
        rows: Samples,
        numerators: Features,
        cost: int,
        weights: np.ndarray,
        deadline: float,
    ) -> list[list[_Formula]]:
        degree = 4 if self.inverses else 2
        denominators = build_features(
            rows.columns,
            min(cost, 4),
            degree,
            inverses=self.inverses,
            functions=self.functions,
        )
        below = denominators.values[1:] if self.denominators else np.empty((0, len(rows)))
        wider = self.layered if rows.layers else 1.0
        subsets = SubsetSearch(
            numerators.values,
            below,
            rows.y,
            weights,
            self.width,
            deadline,
            self.collinear / wider,
            self.cancellation * wider,
            self.idle,
        )
        fits = [
            [subsets.fit(support) for support in supports[: 5 * self.keep]]
            for supports in subsets.search(self.max_terms)
        ]
        if not fits:
            return []
        medians = [float(np.median(np.abs(fit.residual))) for group in fits for _, fit in group]
        floor = max(np.nanmin(medians), 1e-12 * float(np.abs(rows.y).max()))
        ranked = []
        for group in fits:
            formulas = [_Formula(*fit, numerators, denominators, floor) for fit in group]
            ranked.append(sorted(formulas, key=lambda formula: formula.bits))
        return ranked

    def _close_to_least(self, ranked: list[list[_Formula]]) -> list[_Formula]:
        """The best of every size that are close to the best of all, fewest terms first."""
        least = min(group[0].bits for group in ranked)
        return [group[0] for group in ranked if group[0].bits <= least + self.close]


@dataclass(frozen=True, eq=False)
class _Formula:
    support: Support
    fit: RatioFit
    numerators: Features
    denominators: Features
    floor: float

    @cached_property
    def expr(self) -> sympy.Expr:
        """The formula itself; only those that are handed on need it."""
        m = len(self.numerators.exprs)
        chosen = sorted(self.support)
        above = [self.numerators.exprs[c] for c in chosen if c < m]
        # The first feature of a denominator is the constant, which has the coefficient 1.
        below = [self.denominators.exprs[c - m + 1] for c in chosen if c >= m]
        return _expression(
            list(zip(above, self.fit.numerator.tolist(), strict=True)),
            [(sympy.S.One, 1.0), *zip(below, self.fit.denominator.tolist(), strict=True)],
        )

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
    def bits(self) -> float:
        """Bits a sample of the residual above the floor."""
        data = float(mean_error_bits(self.residual, self.floor))
        return data if math.isfinite(data) else math.inf


Terms = list[tuple[sympy.Expr, float]]


def _expression(top: Terms, bottom: Terms) -> sympy.Expr:
    """Write N / D with the common factor that makes most coefficients simple."""
    if len(bottom) == 1:
        return sympy.Add(*(sympy.Float(c) * e for e, c in top))
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
            bits = sum(_bits_of_coefficient(c * factor) for c in coefficients)
            if bits < best[0] - 1e-9:
                best = (bits, factor, index)
    return best[1], best[2]


def _bits_of_coefficient(value: float) -> float:
    """Bits of a fitted number, which counts as the integer that it is within 1 %."""
    near = round(value)
    simple = 0 < abs(near) < 10 and abs(value - near) < 0.01 * abs(value)
    return number_bits(sympy.Integer(near) if simple else sympy.Float(value))
