"""Rates: terms that several equations of a system hold, with one and the same constant.

What leaves one species enters another: s' = -k s x / (m + s) and x' = k s x / (m + s) - d x have
two constants of the rate between them, not four (stoichiometry). Where fitted values of two agree
within their errors, the second says next to nothing new.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
import sympy

from dynsr.fit import free_constants, skeleton

# Shares of the terms of two equations that have one constant: of products, of bare columns.
_SAME, _BARE = 0.5, 0.2
# Bits from which on constants agree.
_SURE = 1.0
# Integration itself is not surer, as a share of the value.
_FINEST = 1e-6


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


def with_shared(
    exprs: Mapping[str, sympy.Expr], state: str, expr: sympy.Expr
) -> list[dict[str, sympy.Expr]]:
    """Give a system with one equation changed, and what it shares with others changed there too.

    Where other equations contain terms that the equation loses, these are replaced by those that it
    gains, in the same proportion. Nothing is given where no other equation contains such terms.

    Parameters
    ----------
    exprs : state -> equation.
    state, expr : whose equation changes, and what it becomes.

    >>> x, y = sympy.symbols("x y")
    >>> system = {"x": -1.5 * x * y, "y": 0.75 * x * y - 0.3 * y}
    >>> with_shared(system, "x", -2.0 * x * y / (x + 0.5))
    [{'x': -2.0*x*y/(x + 0.5), 'y': 1.0*x*y/(x + 0.5) - 0.3*y}]
    """
    before, after = _by_shape(exprs[state]), _by_shape(expr)
    kept = {shape for shape, _, _ in before} & {shape for shape, _, _ in after}
    lost = {
        shape: number for shape, number, _ in before if shape not in kept and shape.free_symbols
    }
    gained = [number * body for shape, number, body in after if shape not in kept]
    changed = {**exprs, state: expr}
    for other, own in exprs.items():
        terms = _by_shape(own)
        ratios = [number / lost[shape] for shape, number, _ in terms if shape in lost]
        if other != state and ratios:
            rest = [number * body for shape, number, body in terms if shape not in lost]
            changed[other] = sympy.Add(*rest, *(ratios[0] * term for term in gained))
    return [changed] if any(changed[o] != exprs[o] for o in exprs if o != state) else []


def _by_shape(expr: sympy.Expr) -> list[tuple[sympy.Expr, sympy.Expr, sympy.Expr]]:
    """Give the shape of each term of a sum, its factor and the rest of it."""
    pairs = (term.as_coeff_Mul() for term in sympy.Add.make_args(expr))
    return [(skeleton(body), number, body) for number, body in pairs]


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
    error = max(math.sqrt(max(float(variance), 0.0)), _FINEST * size, 1e-300)
    z = float(sizes[0] - sizes[1]) / error
    density = math.exp(-z * z / 2) / math.sqrt(2 * math.pi) / error
    return max(math.log2(1 - share + share * 2 * size * density), 0.0)
