"""Reductions: one problem in many variables becomes one or two in fewer, and the way back.

A reducer looks for a property of the function behind the samples (a symmetry, a separation, an
inner function) by asking a surrogate of it. A property counts only when it holds to within what
the surrogate is known to be wrong by, and only where there are samples near the points asked
for: a trajectory is a thin curve, and off it a surrogate knows nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy
from scipy.spatial import cKDTree

from dynsr.data import Samples
from dynsr.expression import evaluate
from dynsr.fit import Candidate, ParetoFront, choose, score_candidate
from dynsr.methods.feynman.stages.base import AbstractStage, Context, Surrogate
from dynsr.methods.limits import Limits


@dataclass(frozen=True)
class Reach:
    """Where a surrogate is believed.

    Parameters
    ----------
    spacings : a point is near the samples when the nearest one is no farther than this many times
        the 0.99 quantile of the samples' own spacing.
    spread : samples fill the space when, in their neighbourhoods, the narrowest direction is at
        least this share of the widest (medians of singular values); else gradients are unknown.
    least_rows, share : a test needs so many rows near the samples, and this share of all.
    """

    spacings: float = 1.5
    spread: float = 0.15
    least_rows: int = 20
    share: float = 0.05


@dataclass(frozen=True, eq=False)
class Support:
    """Where the samples are: which points are close to some, and whether they fill the space.

    Parameters
    ----------
    X : (n, p) samples; distances are in standard deviations of its columns.
    reach : what counts as close, filled and enough.
    """

    X: np.ndarray
    reach: Reach = Reach()

    def _standard(self, X: np.ndarray) -> np.ndarray:
        scale = np.std(self.X, axis=0)
        return (X - self.X.mean(axis=0)) / np.where(scale > 0, scale, 1.0)

    def near(self, X: np.ndarray) -> np.ndarray:
        """(n,) whether each row is about as close to a sample as samples are to each other."""
        own = self._standard(self.X)
        tree = cKDTree(own)
        spacing = tree.query(own, k=2)[0][:, 1]
        limit = self.reach.spacings * np.quantile(spacing, 0.99)
        return tree.query(self._standard(X))[0] <= limit

    def enough(self, rows: np.ndarray) -> bool:
        """Whether so many rows, an (n,) mask, can speak for all."""
        return int(rows.sum()) >= max(self.reach.least_rows, int(self.reach.share * len(rows)))

    @cached_property
    def fills_space(self) -> bool:
        """Whether neighbours differ in every direction, so that a full gradient can be known."""
        own = self._standard(self.X)
        # So many neighbourhoods fix a median; ten points for each direction fix a shape.
        rows = np.linspace(0, len(own) - 1, min(200, len(own))).astype(int)
        count = min(10 * own.shape[1], len(own))
        neighbours = own[cKDTree(own).query(own[rows], k=count)[1]]
        extent = np.linalg.svd(
            neighbours - neighbours.mean(axis=1, keepdims=True), compute_uv=False
        )
        narrow = extent[:, -1] / np.maximum(extent[:, 0], 1e-300)
        return bool(np.median(narrow) > self.reach.spread)


class AbstractReduction(ABC):
    """One way to take a problem apart; ``kind`` says which, ``error`` (units of y) how surely."""

    kind: str
    error: float

    @abstractmethod
    def solve(self, samples: Samples, context: Context) -> list[sympy.Expr]:
        """Solve the smaller problems and give formulas of the whole one."""


@dataclass(frozen=True, eq=False)
class Substitution(AbstractReduction):
    """The variables ``replaced`` enter only through ``inner``, a formula in them."""

    kind: str
    error: float
    inner: sympy.Expr
    replaced: tuple[str, ...]

    def reduce(self, samples: Samples) -> tuple[Samples, sympy.Symbol]:
        """Give the samples with one new first column instead of the replaced ones."""
        kept = [j for j, name in enumerate(samples.names) if name not in self.replaced]
        name = fresh_name(samples.names)
        column = evaluate(self.inner, samples.columns)
        smaller = replace(
            samples,
            X=np.column_stack([column, samples.X[:, kept]]),
            names=(name, *(samples.names[j] for j in kept)),
        )
        return smaller, sympy.Symbol(name)

    def solve(self, samples: Samples, context: Context) -> list[sympy.Expr]:
        """Solve the smaller problem and put the inner formula back."""
        smaller, symbol = self.reduce(samples)
        if not np.all(np.isfinite(smaller.X)):
            return []
        found = context.solve(smaller, context.deeper())
        return [candidate.expr.xreplace({symbol: self.inner}) for candidate in found]


def fresh_name(names: tuple[str, ...]) -> str:
    """Give a variable name that is not among ``names``.

    >>> fresh_name(("x", "u_1"))
    'u_2'
    """
    number = 1
    while f"u_{number}" in names:
        number += 1
    return f"u_{number}"


def leading(candidates: list[Candidate], samples: Samples, count: int = 3) -> list[Candidate]:
    """The few candidates worth going on with: the chosen one, then the most accurate."""
    front = ParetoFront(candidates)
    if not len(front):
        return []
    ordered = [choose(front, samples), *reversed(front.candidates)]
    return list(dict.fromkeys(ordered))[:count]


class AbstractReducer(AbstractStage):
    """A stage that finds reductions; frozen dataclasses with the setting ``tolerance``.

    A reduction is accepted when its error is at most ``tolerance`` times the surrogate's
    validation error.
    """

    tolerance: float

    def within(self, limits: Limits) -> AbstractReducer:
        """Give the reducer with the functions that are allowed; one without any as it is."""
        return self

    @abstractmethod
    def find(
        self, samples: Samples, surrogate: Surrogate, support: Support
    ) -> list[AbstractReduction]:
        """Give the reductions that pass, in any order; ``support`` is that of the samples."""

    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Apply the surest reduction alone."""
        return Reduce((self,), branches=1).run(samples, context)


@dataclass(frozen=True)
class Reduce(AbstractStage):
    """Train the surrogate, ask every reducer, and solve what the surest reductions leave.

    Nothing is taken apart when a short formula already follows the samples more closely than the
    surrogate does: what the surrogate shows can then not be distinguished from its own errors.

    Parameters
    ----------
    reducers : which properties to look for.
    branches : how many reductions are followed, surest first.
    max_depth : how many reductions may follow each other.
    max_constants : a formula is short when it has at most so many free constants.
    reach : where the surrogate is believed.
    """

    reducers: tuple[AbstractReducer, ...]
    branches: int = 2
    max_depth: int = 3
    max_constants: int = 8
    reach: Reach = Reach()
    name = "reduction"

    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Find reductions and follow them; nothing for one variable or without a surrogate."""
        if samples.X.shape[1] < 2 or context.surrogate is None or context.depth >= self.max_depth:
            return []
        if not self.reducers or context.seconds_left <= 0:
            return []
        context.tell("network", 0, 1)
        surrogate = context.surrogate(samples, context)
        explained = (c.loss for c in short(context.front, self.max_constants))
        if context.depth == 0 and min(explained, default=np.inf) <= surrogate.validation_error:
            return []
        support = Support(samples.X, self.reach)
        found: list[AbstractReduction] = []
        for done, reducer in enumerate(self.reducers):
            context.tell(reducer.name, done, len(self.reducers))
            found += reducer.find(samples, surrogate, support)
        candidates = []
        for reduction in sorted(found, key=lambda r: (r.error, r.kind))[: self.branches]:
            if context.seconds_left <= 0:
                break
            context.tell(reduction.kind, 0, None)
            for expr in reduction.solve(samples, context):
                candidates.append(score_candidate(expr, samples, reduction.kind))
        return candidates


def short(candidates: Iterable[Candidate], most: int) -> list[Candidate]:
    """Give the formulas of at most so many free constants."""
    return [c for c in candidates if len(c.expr.atoms(sympy.Float)) <= most]
