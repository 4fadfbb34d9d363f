"""Polynomial fits: every degree in full, and sparse ones by backward elimination."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.errors import InputError
from dynsr.expression import complexity
from dynsr.fit import Candidate, ParetoFront, eliminate, rmse, score_candidate
from dynsr.methods.feynman.stages.base import AbstractStage, Context
from dynsr.methods.library import monomials

Exponents = tuple[int, ...]
# Above so many columns an eighth of them is eliminated at a time; one at a time below.
_FEW = 24


def monomial_exponents(variables: int, degree: int) -> list[Exponents]:
    """Exponents of all monomials of total degree up to ``degree``, lowest degree first.

    >>> monomial_exponents(2, 1)
    [(0, 0), (1, 0), (0, 1)]
    """
    found = monomials([1] * variables, degree)
    return [tuple(places.count(j) for j in range(variables)) for places in found]


def design(X: np.ndarray, exponents: list[Exponents]) -> np.ndarray:
    """(n, k) values of k monomials at the n rows of ``X``."""
    highest = max((max(e) for e in exponents if e), default=0)
    powers = np.stack([X**k for k in range(highest + 1)])
    columns = np.arange(X.shape[1])
    return np.stack([np.prod(powers[list(e), :, columns], axis=0) for e in exponents], axis=1)


@dataclass(frozen=True)
class Polynomial(AbstractStage):
    """Least squares over all monomials up to ``degree`` (the paper's appendix: degree 4).

    Every degree from 0 up is given in full; one that has more terms than half the rows is left
    out. A full polynomial whose fit to the first rows misses the last ones is left out too: it
    follows the samples and diverges as soon as it leaves them.

    Parameters
    ----------
    degree : highest total degree; at least 0.
    sparse : also thin each degree out: the term that explains least is dropped and the others
        fitted again, by plain and by robust (Cauchy) least squares, down to one term.
    max_terms : sparse sums of more terms are not given.
    fitted : share of the rows, the first ones, that the test of a full polynomial fits.
    excess : how many times the error on those rows it may miss the others by.

    Raises InputError when ``degree`` is negative.
    """

    degree: int = 4
    sparse: bool = True
    max_terms: int = 24
    fitted: float = 0.8
    excess: float = 10.0
    name = "polynomial"

    def __post_init__(self) -> None:
        """Check the degree."""
        if not self.degree >= 0:
            raise InputError(f"degree {self.degree!r} must be at least 0")

    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Fit every degree; see the class."""
        front = ParetoFront()
        for degree in range(self.degree + 1):
            context.tell(self.name, degree, self.degree + 1)
            if math.comb(degree + samples.X.shape[1], degree) > max(1, len(samples) // 2):
                break
            if carries_over(samples, degree, self.fitted, self.excess):
                front = front.add(fit_full(samples, degree))
            if self.sparse and degree:
                front = front.add(*thin_out(samples, degree, self.max_terms, robust=False))
                front = front.add(*thin_out(samples, degree, self.max_terms, robust=True))
        return list(front)


def carries_over(samples: Samples, degree: int, fitted: float = 0.8, excess: float = 10.0) -> bool:
    """Whether the fit of a degree to the first share ``fitted`` of the rows holds on the others.

    It does when it misses those by at most ``excess`` times its own RMSE.
    """
    centre, scale = standard_coordinates(samples.X)
    values = design((samples.X - centre) / scale, monomial_exponents(samples.X.shape[1], degree))
    first = max(1, int(fitted * len(samples)))
    weights = np.linalg.lstsq(values[:first], samples.y[:first], rcond=None)[0]
    residual = samples.y - values @ weights
    own, tail = residual[:first], residual[first:]
    if not len(tail):
        return True
    floor = 1e-7 * float(np.std(samples.y))
    limit = excess * max(float(np.sqrt(np.mean(own**2))), floor)
    return bool(np.sqrt(np.mean(tail**2)) <= limit)


def fit_full(samples: Samples, degree: int) -> Candidate:
    """Fit all monomials up to a degree by least squares in standardised coordinates.

    The coefficients are taken back to the variables themselves without rounding; where that
    would lose digits (columns far from zero) the formula stays in centred variables.
    """
    exponents = monomial_exponents(samples.X.shape[1], degree)
    centre, scale = standard_coordinates(samples.X)
    values = design((samples.X - centre) / scale, exponents)
    weights = np.linalg.lstsq(values, samples.y, rcond=None)[0]
    raw = expand_shift(dict(zip(exponents, weights, strict=True)), centre, scale)
    source = f"{Polynomial.name}: degree {degree}"
    candidate = score_candidate(_as_expression(raw, samples.names), samples, source)
    spread = float(np.std(samples.y)) or 1.0
    if candidate.loss > rmse(values @ weights, samples.y) + 1e-9 * spread:
        symbols = {
            sympy.Symbol(n): (sympy.Symbol(n) - m) / s
            for n, m, s in zip(samples.names, centre.tolist(), scale.tolist(), strict=True)
        }
        centred = _as_expression(dict(zip(exponents, weights, strict=True)), samples.names)
        candidate = score_candidate(centred.xreplace(symbols), samples, source)
    return candidate


def standard_coordinates(X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each column; a constant column has scale 1."""
    scale = np.std(X, axis=0)
    return np.mean(X, axis=0), np.where(scale > 0, scale, 1.0)


def expand_shift(
    terms: dict[Exponents, float], centre: np.ndarray, scale: np.ndarray
) -> dict[Exponents, float]:
    """Turn a polynomial in (x - centre) / scale into one in x.

    >>> expand_shift({(2,): 4.0}, np.array([1.0]), np.array([2.0]))
    {(0,): 1.0, (1,): -2.0, (2,): 1.0}
    """
    out: dict[Exponents, float] = {}
    for exponents, weight in terms.items():
        factors = [
            [math.comb(e, k) * (-m) ** (e - k) / s**e for k in range(e + 1)]
            for e, m, s in zip(exponents, centre.tolist(), scale.tolist(), strict=True)
        ]
        for powers in product(*(range(e + 1) for e in exponents)):
            share = math.prod(f[k] for f, k in zip(factors, powers, strict=True))
            out[powers] = out.get(powers, 0.0) + float(weight) * share
    return out


def _as_expression(terms: dict[Exponents, float], names: tuple[str, ...]) -> sympy.Expr:
    symbols = [sympy.Symbol(name) for name in names]
    return sympy.Add(
        *(
            sympy.Float(weight)
            * sympy.Mul(*(s**e for s, e in zip(symbols, exponents, strict=True)))
            for exponents, weight in terms.items()
            if weight != 0.0
        )
    )


def thin_out(samples: Samples, degree: int, max_terms: int, robust: bool) -> list[Candidate]:
    """Sparse polynomials of few terms, by backward elimination from all monomials."""
    exponents = monomial_exponents(samples.X.shape[1], degree)
    values = design(samples.X, exponents)
    found = []
    for kept, weights in eliminate(values, samples.y, robust=robust, few=_FEW):
        if len(kept) > max_terms:
            continue
        expr = _as_expression(
            {exponents[j]: w for j, w in zip(kept, weights, strict=True)}, samples.names
        )
        loss = rmse(values[:, kept] @ weights, samples.y)
        found.append(Candidate(expr, loss, complexity(expr), f"{Polynomial.name}: sparse"))
    return found
