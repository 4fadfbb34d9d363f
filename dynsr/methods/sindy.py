"""SINDy: the right-hand side as a sparse combination, or ratio of combinations, of a library."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy

from dynsr.engines.base import AbstractEngine, Optimizer, Release, SparseProblem, SparseSolution
from dynsr.engines.select import find_engine
from dynsr.errors import InputError
from dynsr.expression import complexity, to_text
from dynsr.methods.base import AbstractMethod, Progress, Report, silent
from dynsr.methods.library import AbstractLibrary, GrownLibrary, Library
from dynsr.methods.sindy_path import Model, explicit_models, implicit_models, independent_rows
from dynsr.pareto import Candidate, ParetoFront, rmse, score_candidate
from dynsr.samples import Samples

PRESETS = ("paper", "best", "quick")


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
    engine : "embedded", "julia", or an engine.

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
    engine: str | AbstractEngine = "embedded"

    name = "sindy"

    @classmethod
    def preset(cls, name: str = "best", system_name: str | None = None) -> SINDy:
        """Give the settings called "paper" (of one of its systems), "best" or "quick".

        Raises InputError on other names.

        >>> SINDy.preset("paper", "lotka-volterra").optimizer
        'ADMM'
        """
        if name == "paper":
            return cls._of_paper(system_name)
        if name == "best":
            return cls(thresholds=tuple(np.geomspace(1e-3, 1.0, 13).tolist()))
        if name == "quick":
            return cls(
                library=GrownLibrary(degree=3, limit=40),
                thresholds=tuple(np.geomspace(1e-2, 1.0, 5).tolist()),
                max_implicit=15,
                max_rows=500,
            )
        raise InputError(f"unknown preset {name!r} of SINDy; the presets are: {', '.join(PRESETS)}")

    @classmethod
    def _of_paper(cls, system_name: str | None) -> SINDy:
        from dynsr.paper.bases import BASES, OPTIMIZERS

        if system_name not in BASES:
            raise InputError(
                f"SINDy has no paper settings for {system_name!r}; they exist for "
                f"{', '.join(BASES)}; use preset best for other data"
            )
        optimizer, settings, cap = OPTIMIZERS[system_name]
        return cls(
            library=Library.from_strings(BASES[system_name]),
            optimizer=optimizer,
            settings=settings,
            implicit=True,
            release="2021",
            max_iterations=cap,
        )

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search; ``rng`` is not used, since nothing here is left to chance."""
        library = self.library.for_names(samples.names)
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
        """Solve the one regression of these settings; the path is not taken."""
        library = self.library.for_names(samples.names)
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
        return find_engine(self.engine).regress(problem)

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
        engine = find_engine(self.engine)
        yield from explicit_models(theta, y, engine, self.optimizer, self.thresholds)
        size, largest = 2, min(self.max_implicit, len(theta))
        while size <= largest:
            yield from implicit_models(
                theta[:size], y, engine, self.optimizer, self.thresholds[::2], self.max_terms
            )
            size = largest if size < largest < 2 * size else 2 * size

    def _follow(
        self, library: Library, theta: np.ndarray, samples: Samples
    ) -> Iterator[list[Candidate]]:
        """Yield the candidates of the path that are the best so far of their size."""
        kept = independent_rows(theta)
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
