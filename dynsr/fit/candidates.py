"""Candidates and the Pareto front of description length against error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING

import numpy as np
import sympy

from dynsr.arguments import Renamed, checked
from dynsr.data import Samples
from dynsr.expression import ByText, abridged, complexity, evaluate, shown, to_latex_formula

if TYPE_CHECKING:
    import pandas as pd


@checked
@dataclass(frozen=True)
class Candidate:
    """One formula found for a target.

    Parameters
    ----------
    expr : the formula.
    loss : its RMSE on the samples, state units per second; with a loss of the user's own the root
        of the mean loss.
    complexity : its description length in bits, :func:`dynsr.expression.complexity`.
    source : the stage that found it, with how after a colon.

    >>> Candidate(2 * sympy.Symbol("x"), loss=0.1, complexity=4.0, source="polynomial").expr
    2*x
    """

    expr: sympy.Expr
    loss: float
    complexity: float
    source: str = ""


def rmse(predicted: np.ndarray, actual: np.ndarray) -> float:
    """Root of the mean squared difference; inf where a prediction is not a finite number.

    Actual values that are NaN, where nothing was measured, are not compared with.
    """
    told = ~np.isnan(actual)
    with np.errstate(all="ignore"):
        value = float(np.sqrt(np.mean((np.asarray(predicted) - actual) ** 2, where=told)))
    return value if math.isfinite(value) else math.inf


def score_candidate(expr: sympy.Expr, samples: Samples, source: str = "") -> Candidate:
    """Evaluate an expression on samples and make the candidate.

    >>> s = Samples(np.array([[1.0], [2.0]]), np.array([2.0, 4.0]), ("x",), "x", "given",
    ...             np.arange(2.0))
    >>> score_candidate(2 * sympy.Symbol("x"), s).loss
    0.0
    """
    predicted = evaluate(expr, samples.columns)
    missed = rmse(predicted, samples.y)
    if samples.loss is not None:
        missed = rmse(samples.residuals(predicted), np.zeros(len(samples)))
    return Candidate(expr, missed, complexity(expr), source)


@checked
@dataclass(frozen=True, repr=False)
class ParetoFront:
    """Candidates of which none is both simpler and better than another, simplest first.

    ``candidates`` are those that it is made of, in any order; ``best_by_source``
    has the most accurate candidate of every source, also where others are better, so that the
    result of each stage of a search can be seen.

    >>> a = Candidate(sympy.Symbol("x"), 1.0, 1.0)
    >>> b = Candidate(sympy.Symbol("y"), 2.0, 2.0)
    >>> len(ParetoFront([a]).add(b))
    1
    """

    candidates: tuple[Candidate, ...] = ()
    best_by_source: tuple[Candidate, ...] = field(default=(), compare=False, repr=False)

    leaders = Renamed("best_by_source")

    def __init__(self, candidates: Iterable[Candidate] = ()) -> None:
        """Keep the undominated ones of the candidates; those with loss inf or NaN are dropped."""
        kept: list[Candidate] = []
        best: dict[str, Candidate] = {}
        ordered = sorted(
            (c for c in candidates if math.isfinite(c.loss) and math.isfinite(c.complexity)),
            key=lambda c: (c.complexity, c.loss, ByText(c.expr)),
        )
        for candidate in ordered:
            if not kept or candidate.loss < kept[-1].loss:
                kept.append(candidate)
            known = best.setdefault(candidate.source, candidate)
            if candidate.loss < known.loss:
                best[candidate.source] = candidate
        object.__setattr__(self, "candidates", tuple(kept))
        object.__setattr__(self, "best_by_source", tuple(best.values()))

    def __iter__(self) -> Iterator[Candidate]:
        """Go through the candidates, simplest first."""
        return iter(self.candidates)

    def __len__(self) -> int:
        """Count the candidates."""
        return len(self.candidates)

    def __getitem__(self, index: int) -> Candidate:
        """Give one candidate; 0 is the simplest, -1 the most accurate."""
        return self.candidates[index]

    def __repr__(self) -> str:
        """Write how many formulas there are, the simplest and the most accurate."""
        ends = [*self.candidates[:1], *self.candidates[1:][-1:]]
        formulas = (abridged(shown(c.expr, 4)) for c in ends)
        said = " ... ".join(
            f"{formula} ({c.complexity:.0f} bits, RMSE {c.loss:.3g})"
            for formula, c in zip(formulas, ends, strict=True)
        )
        return f"<ParetoFront of {len(self)}: {said}>" if ends else "<ParetoFront of 0>"

    def to_pandas(self) -> pd.DataFrame:
        """Give the front as a data frame, simplest first.

        ``formula`` as text, its ``bits``, its ``rmse`` on the slopes in state units per second, and
        ``source``, what found it. The row's number is that of :meth:`__getitem__`.

        >>> ParetoFront([Candidate(sympy.Symbol("x"), 1.0, 2.0, "sindy")]).to_pandas()
          formula  bits  rmse source
        0       x   2.0   1.0  sindy
        """
        import pandas as pd

        rows = [(shown(c.expr), c.complexity, c.loss, c.source) for c in self.candidates]
        return pd.DataFrame(rows, columns=["formula", "bits", "rmse", "source"])

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{k}</td><td>{c.complexity:.0f}</td><td>{c.loss:.3g}</td>"
            f'<td style="text-align:left">${escape(to_latex_formula(c.expr))}$</td>'
            f'<td style="text-align:left">{escape(c.source)}</td></tr>'
            for k, c in enumerate(self.candidates)
        )
        return (
            "<table><tr><th>k</th><th>bits</th><th>RMSE</th><th>formula</th><th>found by</th></tr>"
            f"{rows}</table>"
        )

    def add(self, *candidates: Candidate) -> ParetoFront:
        """Give the front of these candidates and those of this front."""
        return ParetoFront((*self.candidates, *self.best_by_source, *candidates))

    def merge(self, other: ParetoFront) -> ParetoFront:
        """Give the front of the candidates of this one and an ``other``."""
        return self.add(*other.candidates, *other.best_by_source)

    @property
    def best_fit(self) -> Candidate:
        """The candidate of lowest loss, which the paper reports; ValueError on an empty front."""
        if not self.candidates:
            raise ValueError("the front is empty")
        return self.candidates[-1]

    @cached_property
    def knee(self) -> Candidate:
        """The candidate at the sharpest bend: the largest drop in log loss a bit of complexity.

        Measured as the distance under the straight line that joins the ends of the front in the
        plane of complexity and log loss.
        """
        if len(self.candidates) < 3:
            return self.best_fit
        x = np.array([c.complexity for c in self.candidates])
        y = np.log2([max(c.loss, 1e-300) for c in self.candidates])
        x, y = (x - x[0]) / (x[-1] - x[0]), (y - y[-1]) / (y[0] - y[-1])
        return self.candidates[int(np.argmax(1 - x - y))]


def r_squared(truth: np.ndarray, found: np.ndarray) -> float:
    """Give the mean over states of R2 = 1 - sum (x - y)^2 / sum (x - mean x)^2, each from -1 up.

    Parameters
    ----------
    truth, found : (n, k) states; where ``found`` is not finite, R2 is -1.

    >>> r_squared(np.array([[0.0], [2.0]]), np.array([[0.0], [1.0]]))
    0.5
    """
    return float(np.mean(explained_shares(truth, found)))


def explained_shares(truth: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Give R2 of every state, from -1 up; (k,) or, of many integrations at once, (k, M).

    Parameters
    ----------
    truth : (n, k) or (n, k, 1) states.
    found : (n, k) or (n, k, M); where it is not finite, R2 is -1.

    >>> explained_shares(np.array([[0.0], [2.0]]), np.array([[np.nan], [1.0]])).tolist()
    [-1.0]
    """
    with np.errstate(all="ignore"):
        missed = np.sum(np.square(found - truth), axis=0)
        spread = np.sum(np.square(truth - truth.mean(axis=0)), axis=0)
        each = 1 - missed / np.where(spread > 0, spread, np.finfo(float).tiny)
    return np.where(np.isfinite(each), np.maximum(each, -1.0), -1.0)
