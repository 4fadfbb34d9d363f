"""Rates: terms that several equations of a system hold, with one and the same constant.

What leaves one species enters another: s' = -k s x / (m + s) and x' = k s x / (m + s) - d x have
two constants of the rate between them, not four (stoichiometry). Where fitted values of two agree
within their errors, the second says next to nothing new.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import sympy

from dynsr.fit import FINEST, free_constants, skeleton

# Shares of the terms of two equations that have one constant: of products, of bare columns.
_SAME, _BARE = 0.5, 0.2
_Terms = Mapping[sympy.Expr, tuple[sympy.Expr, sympy.Expr]]
# Standard errors beyond which a difference is no noise.
SIGMA = 3.0


def shared_bits(
    exprs: Mapping[str, sympy.Expr], constants: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """Bits that each constant (P,) saves because another equation has it too.

    They are the logarithm of Bayes' factor of one value for both, up to the sign, against two of
    one size: with the difference d of their sizes and its standard error s it is
    1 - p + 2 p |c| phi(d/s)/s.

    Parameters
    ----------
    exprs : state -> equation with its constants.
    constants, covariance : (P,) and (P, P), in the order of the states and of their appearance.

    >>> x, y = sympy.symbols("x y")
    >>> system = {"x": -0.5 * x * y, "y": 0.5 * x * y - 0.3 * y}
    >>> bits = shared_bits(system, np.array([-0.5, 0.5, -0.3]), 1e-6 * np.eye(3))
    >>> [round(float(b), 1) for b in bits]
    [0.0, 7.1, 0.0]
    """
    saved = np.zeros(len(constants))
    known: list[dict[sympy.Expr, list[int]]] = []
    for own in _terms(exprs, constants):
        for other in known:
            for shape, mine in own.items():
                if shape not in other or not shape.free_symbols:
                    continue
                share = _BARE if shape.is_Symbol else _SAME
                gained = [
                    _agreement(constants, covariance, first, second, share)
                    for first, second in zip(other[shape], mine, strict=True)
                ]
                saved[mine] = np.maximum(saved[mine], gained)
        known.append(own)
    return saved


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
    exprs: Mapping[str, sympy.Expr], constants: np.ndarray, errors: np.ndarray
) -> list[Flux]:
    """Give the sums of terms that equations share, those of most equations first.

    A term whose factors in two equations differ from those of the others by more than their errors
    is shared with the flux, and there once more by itself. A bare column, as in x' = v, is no flux.

    Parameters
    ----------
    exprs : state -> equation with its constants.
    constants, errors : (P,) and their standard errors.

    >>> x, y = sympy.symbols("x y")
    >>> system = {"x": 0.5 * x - 1.5 * x * y, "y": 0.75 * x * y - 0.3 * y}
    >>> (flux,) = fluxes(system, np.array([0.5, -1.5, 0.75, -0.3]), np.full(4, 0.01))
    >>> flux.parts
    {'x': (1.0, -1.5*x*y), 'y': (-0.5, 0.75*x*y)}
    >>> flux.replaced(system, -2.0 * x * y**2)["y"]
    1.0*x*y**2 - 0.3*y
    """
    terms = {s: _by_shape(expr) for s, expr in exprs.items() if not expr.is_Symbol}
    error_of = dict(zip(constants.tolist(), errors.tolist(), strict=True))
    found: dict[frozenset[sympy.Expr], Flux] = {}
    for first, second in combinations(terms, 2):
        shapes = [x for x in terms[first] if x in terms[second] and x.free_symbols]
        holders = [s for s, own in terms.items() if shapes and own.keys() >= set(shapes)]
        if holders and frozenset(shapes) not in found:
            flux = {shape: terms[holders[0]][shape] for shape in shapes}
            parts, rest = {}, {}
            for state in holders:
                parts[state], rest[state] = _split(terms[state], flux, error_of)
            found[frozenset(shapes)] = Flux(parts, rest)
    return sorted(found.values(), key=lambda one: -len(one.parts))


def _split(
    own: _Terms, flux: _Terms, error_of: Mapping[float, float]
) -> tuple[tuple[float, sympy.Expr], sympy.Expr]:
    """Give the factor that most terms of a flux have in an equation, these terms, and the rest."""

    def apart(shape: sympy.Expr, factor: float) -> tuple[float, bool]:
        mine, theirs = float(own[shape][0]), float(flux[shape][0])
        error = math.hypot(error_of.get(mine, 0.0), factor * error_of.get(theirs, 0.0))
        return mine - factor * theirs, abs(mine - factor * theirs) > SIGMA * error

    factors = [float(own[shape][0] / flux[shape][0]) for shape in flux]
    factor = min(factors, key=lambda one: sum(apart(shape, one)[1] for shape in flux))
    shared: list[sympy.Expr] = []
    left = [n * body for shape, (n, body) in own.items() if shape not in flux]
    for shape in flux:
        number, body = own[shape]
        more, is_apart = apart(shape, factor)
        (left if is_apart else shared).append((more if is_apart else number) * body)
    return (factor, sympy.Add(*shared)), sympy.Add(*left)


def _by_shape(expr: sympy.Expr) -> _Terms:
    """Give the shape of each term of a sum -> its factor and the rest of it."""
    pairs = (term.as_coeff_Mul() for term in sympy.Add.make_args(expr))
    return {skeleton(body): (number, body) for number, body in pairs}


def _terms(
    exprs: Mapping[str, sympy.Expr], constants: np.ndarray
) -> Iterator[dict[sympy.Expr, list[int]]]:
    """Give the places of the constants of every equation's terms, by their shapes.

    Constants are found by their values: their order may change as values are put in.
    """
    first = 0
    for expr in exprs.values():
        count = len(free_constants(expr, "c")[1])
        own = constants[first : first + count]
        found = {}
        for term in sympy.Add.make_args(expr):
            coefficient, body = term.as_coeff_Mul()
            if coefficient.is_Float:
                shape, inside = free_constants(body, "c")
                values = [float(coefficient), *inside.values()]
                found[shape] = [first + int(np.argmin(np.abs(own - v))) for v in values]
        yield found
        first += count


def _agreement(
    constants: np.ndarray, covariance: np.ndarray, first: int, second: int, share: float
) -> float:
    pair = covariance[np.ix_([first, second], [first, second])]
    if not np.all(np.isfinite(pair)):
        return 0.0
    sides, sizes = np.sign(constants[[first, second]]), np.abs(constants[[first, second]])
    variance = pair[0, 0] + pair[1, 1] - 2 * sides[0] * sides[1] * pair[0, 1]
    size = float(sizes.mean())
    error = max(math.sqrt(max(float(variance), 0.0)), FINEST * size, 1e-300)
    z = float(sizes[0] - sizes[1]) / error
    density = math.exp(-z * z / 2) / math.sqrt(2 * math.pi) / error
    return max(math.log2(1 - share + share * 2 * size * density), 0.0)
