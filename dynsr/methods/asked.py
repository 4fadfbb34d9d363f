"""Methods that keep to what the user asks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.engines import AbstractEngine
from dynsr.expression import evaluate
from dynsr.fit import Candidate, ParetoFront, eliminate, score_candidate
from dynsr.methods.base import AbstractMethod, Report, silent
from dynsr.methods.demands import Demands
from dynsr.methods.library import polynomials


@dataclass(frozen=True)
class AskedMethod(AbstractMethod):
    """A method that keeps to demands: it searches within their limits, and the rest is left out.

    Parameters
    ----------
    method : the method as it was chosen.
    demands : what is asked.
    known : state -> the given part of its equation.
    name : that of the method.
    engine : that of the method.
    """

    method: AbstractMethod
    demands: Demands
    known: tuple[tuple[str, sympy.Expr], ...] = ()
    name: str = ""
    engine: str | AbstractEngine | None = None

    @classmethod
    def of(
        cls, method: AbstractMethod, demands: Demands, known: Mapping[str, sympy.Expr]
    ) -> AskedMethod:
        """Wrap a method."""
        return cls(method, demands, tuple(known.items()), method.name, method.engine)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the method has to say."""
        return self.method.notes

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search within the limits; the user's own terms are tried in any case."""
        known = dict(self.known).get(samples.target, sympy.S.Zero)
        limited = self.method.within(self.demands.limits(samples.target))
        found = limited.search(samples, rng, report)
        pool = [
            *found,
            *found.best_by_source,
            *fit_terms(self.demands.limits(samples.target).terms, samples),
        ]
        return ParetoFront(self.demands.select(pool, samples, known))


def fit_terms(terms: Sequence[sympy.Expr], samples: Samples) -> list[Candidate]:
    """Give sums of the user's terms, of all columns and of 1, the least useful left out in turn.

    Parameters
    ----------
    terms : formulas in the columns.
    samples : what the sums are fitted to.
    """
    if not terms:
        return []
    exprs = [*terms, *(sympy.Symbol(name) for name in samples.names), sympy.S.One]
    return _fit_sums(exprs, samples, "your terms")


def fit_polynomials(samples: Samples, degree: int) -> list[Candidate]:
    """Give polynomials, the least useful term left out in turn: a search in no time.

    Parameters
    ----------
    samples : what they are fitted to.
    degree : the highest one.

    >>> x = np.linspace(0.0, 2.0, 20)
    >>> samples = Samples(x[:, None], 3 * x - x**2, ("x",), "x", "given", x)
    >>> ParetoFront(fit_polynomials(samples, 2)).best_fit.loss < 1e-9
    True
    """
    return _fit_sums(polynomials(samples.names, degree).functions, samples, "polynomial")


def _fit_sums(exprs: Sequence[sympy.Expr], samples: Samples, source: str) -> list[Candidate]:
    exprs = list(dict.fromkeys(exprs))
    values = np.array([np.broadcast_to(evaluate(e, samples.columns), len(samples)) for e in exprs])
    finite = np.isfinite(values).all(axis=1)
    exprs = [e for e, ok in zip(exprs, finite, strict=True) if ok]
    found = []
    for chosen, weights in eliminate(values[finite].T, samples.y):
        pairs = zip(weights, chosen, strict=True)
        expr = sympy.Add(*(sympy.Float(float(w)) * exprs[k] for w, k in pairs))
        found.append(score_candidate(expr, samples, source))
    return found
