"""Rates: terms that several equations of a system hold, with one and the same constant.

What leaves one species enters another: s' = -k s x / (m + s) and x' = k s x / (m + s) - d x have
two constants of the rate between them, not four (stoichiometry). Where fitted values of two agree
within their errors, the second says next to nothing new.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.expression import evaluate, free_constants, skeleton
from dynsr.fit import FINEST
from dynsr.library import INSIDE, find_repeats, textbooks

_Terms = Mapping[sympy.Expr, tuple[sympy.Expr, sympy.Expr]]
# How many times a term is that of another equation, and the error of that.
_Shares = Mapping[sympy.Expr, tuple[float, float]]
# Standard errors beyond which a difference is no noise.
SIGMA = 3.0


def shared_bits(
    exprs: Mapping[str, sympy.Expr], constants: np.ndarray, covariance: np.ndarray
) -> tuple[dict[tuple[int, ...], float], float]:
    """Bits that constants save because terms of one form often share them, and bits of saying so.

    A share p of the textbooks' terms that repeat a form has the constants of an earlier one. For k
    constants with the sizes c and the differences d, of covariance D, values of their own are
    1 - p probable, and with an earlier place's there is p B more, where B = prod(2 c) N(d; 0, D)
    is Bayes' factor of one value for both, up to the sign of a factor, against two of one size.

    Parameters
    ----------
    exprs : state -> equation with its constants.
    constants, covariance : (P,) and (P, P), in the order of the states and of their appearance.

    Gives what constants save together, by their places, and what all such choices cost.

    >>> x, y = sympy.symbols("x y")
    >>> system = {"x": -0.5 * x * y, "y": 0.5 * x * y - 0.3 * y}
    >>> saved, cost = shared_bits(system, np.array([-0.5, 0.5, -0.3]), 1e-6 * np.eye(3))
    >>> {at: round(bits, 1) for at, bits in saved.items()}, round(cost, 1)
    ({(1,): 8.1}, 1.0)
    """
    places = _places(exprs, constants)
    saved: dict[tuple[int, ...], float] = {}
    cost = 0.0
    for repeat in find_repeats(exprs):
        own = places[list(repeat.own)]
        same = textbooks().share(repeat.choice)
        signed = repeat.choice == INSIDE
        factors = [
            _agreement(constants, covariance, own, places[list(other)], signed)
            for other in repeat.earlier
        ]
        cost -= math.log2(1 - same)
        key = tuple(own.tolist())
        bits = math.log2(1 + same / (1 - same) * float(np.mean(factors)))
        saved[key] = max(bits, saved.get(key, 0.0))
    return saved, cost


@dataclass(frozen=True)
class Flux:
    """A sum of terms that several equations of a system contain, each in its own proportion.

    Parameters
    ----------
    parts : state -> the factor by which its equation contains the sum, that of the first is 1, and
        the sum as it is there.
    rest : state -> what else its equation contains.
    """

    parts: Mapping[str, tuple[float, sympy.Expr]]
    rest: Mapping[str, sympy.Expr]

    def replaced(self, exprs: Mapping[str, sympy.Expr], expr: sympy.Expr) -> dict[str, sympy.Expr]:
        """Give the system with another sum in the place of this one.

        Parameters
        ----------
        exprs : state -> equation.
        expr : the other sum.
        """
        changed = {s: self.rest[s] + sympy.Float(f) * expr for s, (f, _) in self.parts.items()}
        return {**exprs, **changed}


def fluxes(
    exprs: Mapping[str, sympy.Expr],
    constants: np.ndarray,
    errors: np.ndarray,
    columns: Mapping[str, np.ndarray],
) -> list[Flux]:
    """Give the sums of terms that equations share, those of most equations first.

    Of the terms of one form in two equations, those are a flux whose proportions agree within their
    errors. The proportion is that of their values, since constants inside may differ. A bare
    column, as in x' = v, is no flux.

    Parameters
    ----------
    exprs : state -> equation with its constants.
    constants, errors : (P,) and their standard errors.
    columns : name -> (n,) values of what the equations hold.

    >>> x, y = sympy.symbols("x y")
    >>> system = {"x": 0.5 * x - 1.5 * x * y, "y": 0.75 * x * y - 0.3 * y}
    >>> data = {"x": np.array([1.0, 2.0]), "y": np.array([0.5, 0.4])}
    >>> (flux,) = fluxes(system, np.array([0.5, -1.5, 0.75, -0.3]), np.full(4, 0.01), data)
    >>> flux.parts
    {'x': (1.0, -1.5*x*y), 'y': (-0.5, 0.75*x*y)}
    >>> flux.replaced(system, -2.0 * x * y**2)["y"]
    1.0*x*y**2 - 0.3*y
    """
    terms = {s: _by_shape(expr) for s, expr in exprs.items() if not expr.is_Symbol}
    error_of = dict(zip(constants.tolist(), errors.tolist(), strict=True))
    found: dict[frozenset[sympy.Expr], Flux] = {}
    for place, first in enumerate(terms):
        every = {s: _proportions(terms[first], own, error_of, columns) for s, own in terms.items()}
        for shares in [*every.values()][place + 1 :]:
            for shapes in dict.fromkeys(_agreeing(shares, one) for one in shares):
                if shapes not in found:
                    found[shapes] = _flux_of(shapes, terms, every)
    return sorted(found.values(), key=lambda one: -len(one.parts))


def _flux_of(
    shapes: frozenset[sympy.Expr],
    terms: Mapping[str, _Terms],
    every: Mapping[str, _Shares],
) -> Flux:
    """Give the flux of all equations that have these terms in one proportion to those of a lead."""
    parts, rest = {}, {}
    for state, own in terms.items():
        there = {shape: share for shape, share in every[state].items() if shape in shapes}
        sure = min(there, key=lambda one: there[one][1] / abs(there[one][0]), default=None)
        if sure is not None and _agreeing(there, sure) == shapes:
            bodies = {shape: number * body for shape, (number, body) in own.items()}
            parts[state] = there[sure][0], sympy.Add(*(bodies.pop(shape) for shape in there))
            rest[state] = sympy.Add(*bodies.values())
    return Flux(parts, rest)


def _proportions(
    own: _Terms,
    other: _Terms,
    error_of: Mapping[float, float],
    columns: Mapping[str, np.ndarray],
) -> _Shares:
    """Give how many times the values of one's own each term of another has, and the error."""
    found = {}
    for shape, (number, body) in own.items():
        if shape not in other or not shape.free_symbols:
            continue
        numbers = float(number), float(other[shape][0])
        with np.errstate(all="ignore"):
            mine = numbers[0] * evaluate(body, columns)
            theirs = numbers[1] * evaluate(other[shape][1], columns)
            factor = float(np.sum(mine * theirs) / np.sum(mine * mine))
        if math.isfinite(factor) and factor != 0:
            unsure = math.hypot(*(error_of.get(one, 0.0) / one for one in numbers))
            found[shape] = factor, abs(factor) * unsure
    return found


def _agreeing(shares: _Shares, one: sympy.Expr) -> frozenset[sympy.Expr]:
    """Give the terms whose proportions are that of one of them, within errors."""
    factor, error = shares[one]
    return frozenset(
        shape
        for shape, (other, unsure) in shares.items()
        if abs(other - factor) <= SIGMA * math.hypot(error, unsure)
    )


def _by_shape(expr: sympy.Expr) -> _Terms:
    """Give the shape of each term of a sum -> its factor and the rest of it."""
    pairs = (term.as_coeff_Mul() for term in sympy.Add.make_args(expr))
    return {skeleton(body): (number, body) for number, body in pairs}


def _places(exprs: Mapping[str, sympy.Expr], constants: np.ndarray) -> np.ndarray:
    """Give where each float of a system is among its constants (P,).

    Constants are found by their values: their order may change as values are put in.
    """
    places: list[int] = []
    for expr in exprs.values():
        values = np.array([*free_constants(expr, "c")[1].values()])
        own = constants[len(places) : len(places) + len(values)]
        nearest = np.argmin(np.abs(own - values[:, None]), axis=1) if len(values) else []
        places += [len(places) + int(place) for place in nearest]
    return np.array(places, dtype=int)


def _agreement(
    constants: np.ndarray, covariance: np.ndarray, own: np.ndarray, other: np.ndarray, signed: bool
) -> float:
    """Give Bayes' factor of some constants being others, against values of one size."""
    both = np.concatenate([own, other])
    among, sides = covariance[np.ix_(both, both)], np.sign(constants[both])
    if not np.all(np.isfinite(among)) or (signed and np.any(constants[own] * constants[other] < 0)):
        return 0.0
    # Sizes differ by this times all of them.
    step = np.hstack([np.diag(sides[: len(own)]), -np.diag(sides[len(own) :])])
    sizes = (np.abs(constants[own]) + np.abs(constants[other])) / 2
    scaled = step / np.maximum(sizes, 1e-300)[:, None]
    apart = scaled @ constants[both]
    variance = scaled @ among @ scaled.T + FINEST**2 * np.eye(len(own))
    # A normal density; that of scipy.stats takes longer to import than all of these to compute.
    try:
        root = np.linalg.cholesky(2 * math.pi * variance)
    except np.linalg.LinAlgError:
        return 0.0
    z = np.linalg.solve(root, apart)
    return float(2 ** len(own) * math.exp(-math.pi * z @ z) / np.prod(np.diag(root)))
