"""Known parts of an equation: any method searches for what is left, and gives whole formulas."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import sympy

from dynsr.errors import InputError
from dynsr.expression import evaluate, parse
from dynsr.methods.base import AbstractMethod, Progress, Report, silent
from dynsr.pareto import Candidate, ParetoFront, score_candidate
from dynsr.samples import Samples

# Rows where the known factor is this small against its largest value say nothing of the rest.
_SMALL = 1e-6


@dataclass(frozen=True)
class WithKnown(AbstractMethod):
    """A method that is told a part of the answer: f = factor * g + term, and g is sought.

    The inner method sees (y - term) / factor. Its candidates come back as whole formulas, scored
    on y. Rows where the factor vanishes are left out of the inner search.

    Parameters
    ----------
    method : any method.
    term : the part that is added, as text or SymPy expression in the columns of the samples.
    factor : the part that is multiplied.

    Raises InputError when a known part cannot be read, and, in the search, when it has a variable
    that the samples lack or no finite value on them.

    >>> from dynsr.methods.feynman.rational import RationalSearch
    >>> x = np.linspace(0.5, 2.0, 100)
    >>> samples = Samples(x[:, None], 3 * x - 9.81 * np.sin(x), ("x",), "x", "given", x)
    >>> method = WithKnown(RationalSearch(costs=(2,), max_terms=1), "-9.81*sin(x)")
    >>> front = method.search(samples, np.random.default_rng(0))
    >>> front.best_fit.loss < 1e-12
    True
    """

    method: AbstractMethod
    term: str | sympy.Expr = "0"
    factor: str | sympy.Expr = "1"

    def __post_init__(self) -> None:
        """Read both parts once, so that a misprint is told before the search."""
        parse(self.term)
        if parse(self.factor) == 0:
            raise InputError("known factor 0 leaves nothing to search for; give another factor")

    @property
    def name(self) -> str:  # type: ignore[override]  # the inner method's, which a field cannot be
        """Name of the inner method."""
        return self.method.name

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search for the rest with the inner method; see :meth:`AbstractMethod.search`."""
        rest = self.remove(samples)

        def tell(progress: Progress) -> None:
            report(replace(progress, front=self._restore(progress.front, samples)))

        found = self.method.search(rest, rng, silent if report is silent else tell)
        return self._restore(found, samples)

    def remove(self, samples: Samples) -> Samples:
        """Give the samples of g: the known term taken off, the known factor divided out."""
        term, factor = self._values(self.term, samples), self._values(self.factor, samples)
        rows = np.abs(factor) > _SMALL * float(np.abs(factor).max())
        if rows.sum() < 2:
            raise InputError(f"known factor {self.factor} is 0 on the samples; give another factor")
        kept = samples.select(rows)
        return replace(kept, y=(kept.y - term[rows]) / factor[rows])

    def choose(self, front: ParetoFront, samples: Samples) -> Candidate:
        """Choose as the inner method does; its most accurate member where it has no say."""
        inner = getattr(self.method, "choose", None)
        return inner(front, samples) if inner is not None else front.best_fit

    def _values(self, part: str | sympy.Expr, samples: Samples) -> np.ndarray:
        values = np.broadcast_to(
            evaluate(parse(part, samples.names), samples.columns), len(samples)
        )
        if not np.all(np.isfinite(values)):
            raise InputError(f"known part {part} has no finite value on some samples; change it")
        return values

    def _restore(self, front: ParetoFront, samples: Samples) -> ParetoFront:
        term, factor = parse(self.term, samples.names), parse(self.factor, samples.names)
        return ParetoFront(
            score_candidate(factor * c.expr + term, samples, c.source) for c in front
        )
