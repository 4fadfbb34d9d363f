"""SINDy: the right-hand side as a sparse combination, or ratio of combinations, of a library.

A path of sparse models is made of many thresholds, then one term less at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import Samples
from dynsr.engines import (
    DEFAULT_ENGINE,
    AbstractEngine,
    Optimizer,
    Release,
    SparseProblem,
    SparseSolution,
    find_engine,
)
from dynsr.errors import InputError
from dynsr.expression import complexity, to_text
from dynsr.fit import (
    Candidate,
    ParetoFront,
    eliminate,
    fit_ratio,
    linearly_independent,
    rmse,
    score_candidate,
)
from dynsr.methods.base import AbstractMethod, Progress, Report, silent
from dynsr.methods.library import AbstractLibrary, GrownLibrary, Library, LimitedLibrary
from dynsr.methods.limits import Limits

_BEST = {"thresholds": tuple(np.geomspace(1e-3, 1.0, 13).tolist()), "max_iterations": 100}

Terms = tuple[int, ...]
# Gives coefficients for (theta, dx, threshold, implicit).
Regress = Callable[[np.ndarray, np.ndarray, float, bool], np.ndarray]


@dataclass(frozen=True, eq=False)
class Model:
    """dx = (numerator . theta) / (denominator . theta); no denominator means 1.

    ``numerator`` and ``denominator`` map a row of theta to its coefficient.
    """

    numerator: dict[int, float]
    denominator: dict[int, float]
    error: float

    @property
    def size(self) -> int:
        """Count the coefficients."""
        return len(self.numerator) + len(self.denominator)

    def predict(self, theta: np.ndarray) -> np.ndarray:
        """Evaluate on the rows of theta; inf or NaN where the denominator is 0."""
        top = np.array(list(self.numerator.values())) @ theta[list(self.numerator)]
        if not self.denominator:
            return top
        with np.errstate(all="ignore"):
            below = np.array(list(self.denominator.values())) @ theta[list(self.denominator)]
            return top / below


def explicit_models(
    theta: np.ndarray,
    dx: np.ndarray,
    regress: Regress,
    thresholds: Sequence[float],
) -> Iterator[list[Model]]:
    """Yield, after each threshold, models dx = c . theta with few terms.

    Thresholds act on the coefficients of rows and dx scaled to a root mean square of 1.

    Parameters
    ----------
    theta : (p, n) values of the library.
    dx : (n,) slopes in state units per second.
    regress : gives the coefficients (p,) of scaled theta and dx at a threshold.
    thresholds : those to try, in their order.
    """
    scaled, scale = _unit_rows(theta)
    size = float(np.sqrt(np.mean(dx**2)))
    seen: set[Terms] = set()
    supports = [tuple(range(len(theta)))]
    for threshold in thresholds:
        found = regress(scaled, dx / size, threshold, False)
        supports.append(tuple(np.flatnonzero(found).tolist()))
        yield [
            Model(dict(zip(terms, c * size / scale[list(terms)], strict=True)), {}, error)
            for support in supports
            for terms, c, error in _descend(scaled, dx / size, support, seen)
        ]
        supports = []


def _descend(
    columns: np.ndarray, target: np.ndarray, support: Terms, seen: set[Terms]
) -> Iterator[tuple[Terms, np.ndarray, float]]:
    """Eliminate from a support until a support comes that was seen before."""
    if not support:
        return
    index = list(support)
    for chosen, coefficients in eliminate(columns[index].T, target):
        terms = tuple(index[k] for k in chosen)
        if terms in seen:
            return
        seen.add(terms)
        residual = coefficients @ columns[list(terms)] - target
        yield terms, coefficients, float(np.sqrt(np.mean(residual**2)))


def implicit_models(
    theta: np.ndarray,
    dx: np.ndarray,
    regress: Regress,
    thresholds: Sequence[float],
    max_terms: int,
) -> Iterator[list[Model]]:
    """Yield, after each threshold, rational models found from relations [dx theta; theta]' q = 0.

    A relation makes dx N(x) - D(x) small, which a D near zero does by itself. Each support is
    therefore refitted to dx - N / D by reweighting with 1 / D (Sanathanan and Koerner 1963).

    Parameters
    ----------
    theta, dx, thresholds : as for :func:`explicit_models`.
    regress : gives the relation (2p,), of the denominator and then of the numerator.
    max_terms : models of more coefficients are not given.
    """
    scaled, scale = _unit_rows(theta)
    size = float(np.sqrt(np.mean(dx**2)))
    seen: set[tuple[Terms, Terms]] = set()
    p = len(theta)
    for threshold in thresholds:
        relation = regress(scaled, dx / size, threshold, True)
        den = tuple(np.flatnonzero(relation[:p]).tolist())
        num = tuple(np.flatnonzero(relation[p:]).tolist())
        found = []
        for fit in _thin(scaled, dx / size, num, den, seen, max_terms):
            top = {i: c * size / scale[i] for i, c in fit.numerator.items()}
            bottom = {i: c / scale[i] for i, c in fit.denominator.items()}
            found.append(Model(top, bottom, fit.error))
        yield found


def _thin(
    theta: np.ndarray,
    dx: np.ndarray,
    num: Terms,
    den: Terms,
    seen: set[tuple[Terms, Terms]],
    max_terms: int,
) -> Iterator[Model]:
    """Refit a ratio, and again with one term less, while numerator and denominator have terms."""
    while num and len(den) > 1 and (num, den) not in seen:
        seen.add((num, den))
        top, bottom, lead = theta[list(num)], theta[list(den[1:])], theta[den[0]]
        fit = fit_ratio(top, bottom, dx, lead)
        if len(num) + len(den) <= max_terms:
            yield Model(
                dict(zip(num, fit.numerator, strict=True)),
                dict(zip(den, (1.0, *fit.denominator), strict=True)),
                float(np.sqrt(np.mean(fit.residual**2))),
            )
        columns = np.vstack([top, dx * bottom]) * fit.weight
        fits = eliminate(columns.T, dx * lead * fit.weight)
        next(fits)
        kept = set(next(fits, ((), None))[0])
        num, den = (
            tuple(i for k, i in enumerate(num) if k in kept),
            (den[0], *(i for k, i in enumerate(den[1:], len(num)) if k in kept)),
        )


def _unit_rows(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    scale = np.sqrt(np.mean(theta**2, axis=1))
    return theta / scale[:, None], scale


@checked
@dataclass(frozen=True)
class SINDy(AbstractMethod):
    """Sparse identification (Brunton et al. 2016), explicit or implicit (Kaheman et al. 2020).

    Parameters
    ----------
    library : the candidate functions.
    optimizer : "SR3", "ADMM" or "STLSQ".
    settings : its numbers, see :class:`dynsr.engines.base.SparseProblem`.
    implicit : search dx = -(num . theta) / (den . theta) instead of dx = c . theta.
    release : whose algorithms: "2021", "2021-corrected", or None for today's.
    normalize : divide each function by its norm (releases of 2021).
    max_iterations : cap of the optimizer.
    thresholds : when given, a path instead of one regression: each threshold, on functions and
        slopes of unit root mean square, gives a support that is refitted and thinned out.
    max_terms : of a path, formulas of more coefficients are not kept.
    max_implicit : of a path, ratios are searched among the first 2, 4, 8, ... functions of the
        library, up to so many; 0 searches none.
    max_rows : of a path, evenly spaced samples used at most.
    engine : "embedded", "julia", or an engine; None takes the caller's, or the embedded one.

    >>> x = np.linspace(0.5, 2.0, 100)
    >>> samples = Samples(x[:, None], 3 * x - x**2, ("x",), "x", "given", x)
    >>> SINDy.preset("best").search(samples, np.random.default_rng(0)).best_fit.loss < 1e-9
    True
    """

    library: AbstractLibrary = GrownLibrary()
    optimizer: Optimizer = "STLSQ"
    settings: Mapping[str, Any] = field(default_factory=dict)
    implicit: bool = False
    release: Release | None = None
    normalize: bool = True
    max_iterations: int = 5000
    thresholds: tuple[float, ...] = ()
    max_terms: int = 12
    max_implicit: int = 25
    max_rows: int = 2000
    engine: str | AbstractEngine | None = None

    name = "sindy"
    presets: ClassVar = {
        "best": _BEST,
        "quick": _BEST,
        "paper": {
            "optimizer": "SR3",
            "settings": {"lambda": 0.01, "nu": 1.0},
            "implicit": True,
            "release": "2021",
        },
    }

    def within(self, limits: Limits) -> SINDy:
        """Give the search on the library of what is allowed; see AbstractMethod."""
        changed = replace(
            self,
            library=LimitedLibrary(self.library, limits),
            max_terms=limits.most_terms(self.max_terms),
        )
        if limits.vocabulary is None or limits.vocabulary.divide:
            return changed
        return replace(changed, max_implicit=0)

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search; ``rng`` is not used, since nothing here is left to chance."""
        library = self.library.for_columns(samples.columns)
        theta = _checked_values(library, samples)
        front = ParetoFront()
        try:
            if not self.thresholds:
                expr = self._formula(library, self.regress(samples).coefficients)
                front = front.add(
                    *([] if expr is None else [score_candidate(expr, samples, self.name)])
                )
                report(Progress("sindy", 1, 1, front))
                return front
            if np.ptp(samples.y) == 0:
                return front.add(score_candidate(_constant(samples), samples, self.name))
            for done, found in enumerate(self._follow(library, theta, samples)):
                front = front.add(*found) if found else front
                report(Progress("sindy", done + 1, None, front))
        except KeyboardInterrupt:
            pass
        return front

    def regress(self, samples: Samples) -> SparseSolution:
        """Solve the one regression of these settings; the path is not taken.

        Parameters
        ----------
        samples : the rows of X (n, p) and the slopes y (n,).

        Raises InputError when a function of the library is not finite on the samples,
        EngineUnavailable when the engine is absent.
        """
        library = self.library.for_columns(samples.columns)
        problem = SparseProblem(
            _checked_values(library, samples),
            samples.y,
            self.optimizer,
            self.settings,
            self.normalize,
            self.max_iterations,
            self.implicit,
            self.release,
        )
        return find_engine(self.engine or DEFAULT_ENGINE).regress(problem)

    def _formula(self, library: Library, coefficients: np.ndarray) -> sympy.Expr | None:
        """Write a solution as a formula; None when an implicit search came back empty."""
        if not self.implicit:
            return library.combine(coefficients)
        below, above = coefficients[: len(library)], coefficients[len(library) :]
        if not below.any():
            return None
        if self.release == "2021":
            return _as_found(library, above, below)
        return sympy.together(-library.combine(above) / library.combine(below))

    def _path(self, library: Library, theta: np.ndarray, y: np.ndarray) -> Iterator[list[Model]]:
        """Yield models, threshold by threshold: sums first, then ratios of growing libraries."""
        if len(y) > self.max_rows:
            rows = np.linspace(0, len(y) - 1, self.max_rows).astype(int)
            theta, y = theta[:, rows], y[rows]
        yield from explicit_models(theta, y, self._solve, self.thresholds)
        size, largest = 2, min(self.max_implicit, len(theta))
        while size <= largest:
            some = self.thresholds[::2]
            yield from implicit_models(theta[:size], y, self._solve, some, self.max_terms)
            size = largest if size < largest < 2 * size else 2 * size

    def _solve(
        self, theta: np.ndarray, dx: np.ndarray, threshold: float, implicit: bool
    ) -> np.ndarray:
        settings = {"threshold": threshold}
        problem = SparseProblem(
            theta, dx, self.optimizer, settings, False, self.max_iterations, implicit
        )
        return find_engine(self.engine or DEFAULT_ENGINE).regress(problem).coefficients

    def _follow(
        self, library: Library, theta: np.ndarray, samples: Samples
    ) -> Iterator[list[Candidate]]:
        """Yield the candidates of the path that are the best so far of their size."""
        kept = linearly_independent(theta)
        library, theta = library.select(kept), theta[kept]
        best: dict[int, float] = {}
        for models in self._path(library, theta, samples.y):
            found = []
            for model in models:
                if model.size <= self.max_terms and model.error < best.get(model.size, np.inf):
                    best[model.size] = model.error
                    expr = _ratio(library, model)
                    loss = rmse(model.predict(theta), samples.y)
                    found.append(Candidate(expr, loss, complexity(expr), self.name))
            yield found


def _constant(samples: Samples) -> sympy.Expr:
    return sympy.Float(float(samples.y[0]))


def _ratio(library: Library, model: Model) -> sympy.Expr:
    def total(part: dict[int, float]) -> sympy.Expr:
        return library.select(list(part)).combine(np.array(list(part.values())))

    numerator = total(model.numerator)
    return numerator / total(model.denominator) if model.denominator else numerator


def _as_found(library: Library, above: np.ndarray, below: np.ndarray) -> sympy.Expr:
    """Write -N / D with each library function whole, so that every coefficient can be read.

    SymPy would multiply out 0.67 (1.5 x - x y) and divide by a constant D. A constant D below
    0.01 is written as the factor 1 / D, as in the paper's cart-pole row.
    """

    def total(coefficients: np.ndarray) -> sympy.Expr:
        products = [
            _times(float(coefficients[i]), library.functions[i])
            for i in np.flatnonzero(coefficients)
        ]
        return sympy.Add(*products, evaluate=False) if len(products) > 1 else products[0]

    index = np.flatnonzero(below)
    if len(index) == 1 and library.functions[index[0]] == 1:
        value = float(below[index[0]])
        divisor = sympy.Float(value if abs(value) >= 0.01 else 1 / value)
        factor = sympy.Pow(divisor, -1, evaluate=False) if abs(value) >= 0.01 else divisor
    else:
        factor = sympy.Pow(total(below), -1, evaluate=False)
    return sympy.Mul(sympy.S.NegativeOne, total(above), factor, evaluate=False)


def _times(coefficient: float, function: sympy.Expr) -> sympy.Expr:
    number = sympy.Float(coefficient)
    return number if function == 1 else sympy.Mul(number, function, evaluate=False)


def _checked_values(library: Library, samples: Samples) -> np.ndarray:
    theta = library.values(samples.columns)
    bad = np.flatnonzero(~np.isfinite(theta).all(axis=1))
    if bad.size:
        raise InputError(
            f"library function {to_text(library.functions[bad[0]])} is not finite on the samples; "
            "leave it out"
        )
    return theta
