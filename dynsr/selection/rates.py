"""Rates: terms that several equations of a system hold, with one and the same constant.

What leaves one species enters another: s' = -k s x / (m + s) and x' = k s x / (m + s) - d x have
two constants of the rate between them, not four (stoichiometry). Where fitted values of two agree
within their errors, the second says next to nothing new.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.fit import free_constants, skeleton
from dynsr.selection.costs import citing_bits, shape_bits

# Shares of the terms of two equations that have one constant: of products, of bare columns.
_SAME, _BARE = 0.5, 0.2
# Bits from which on constants agree.
_SURE = 1.0
# Integration itself is not surer, as a share of the value.
_FINEST = 1e-6


@dataclass(frozen=True, eq=False)
class _Term:
    """A term of an equation: its shape, its own value and the places of its constants."""

    shape: sympy.Expr
    value: sympy.Expr
    sign: float
    places: list[int]


def shared_bits(
    exprs: Mapping[str, sympy.Expr], constants: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, float]:
    """Bits that each constant (P,) saves because another equation has it too, and those of writing.

    The first are the logarithm of Bayes' factor of one value for both, up to the sign, against two
    of one size: with the difference d of their sizes and its standard error s it is
    1 - p + 2 p |c| phi(d/s)/s. Several terms that two equations hold with the same constants, all
    of one sign or all of the other, are written once, as the rate of a reversible reaction is.

    Parameters
    ----------
    exprs : state -> equation with its constants.
    constants, covariance : (P,) and (P, P), in the order of the states and of their appearance.

    >>> x, y = sympy.symbols("x y")
    >>> system = {"x": -0.5 * x * y, "y": 0.5 * x * y - 0.3 * y}
    >>> bits, _ = shared_bits(system, np.array([-0.5, 0.5, -0.3]), 1e-6 * np.eye(3))
    >>> [round(float(b), 1) for b in bits]
    [0.0, 7.1, 0.0]
    """
    saved, written = np.zeros(len(constants)), 0.0
    known: list[dict[sympy.Expr, _Term]] = []
    for own in _terms(exprs, constants):
        least = 0.0
        for other in known:
            groups: dict[float, list[_Term]] = {}
            for shape, mine in own.items():
                if shape not in other:
                    continue
                theirs = other[shape]
                share = _SAME if shape.free_symbols and not shape.is_Symbol else _BARE
                gained = [
                    _agreement(constants, covariance, first, second, share)
                    for first, second in zip(theirs.places, mine.places, strict=True)
                ]
                if shape.free_symbols:
                    saved[mine.places] = np.maximum(saved[mine.places], gained)
                if min(gained) >= _SURE:
                    groups.setdefault(mine.sign * theirs.sign, []).append(mine)
            least = max([least, *(_written_once(group) for group in groups.values())])
        written += least
        known.append(own)
    return saved, written


def _written_once(group: Sequence[_Term]) -> float:
    """Bits that terms save as one rate, beyond those of each that is written elsewhere."""
    if len(group) < 2 or not any(term.shape.free_symbols for term in group):
        return 0.0
    cited = sum(
        citing_bits(skeleton(t.value.as_coeff_Mul()[1]))
        for t in group
        if t.shape.free_symbols and not t.shape.is_Symbol
    )
    whole = shape_bits(sympy.Add(*[term.value for term in group]))
    return max(whole - cited - shape_bits(sympy.Symbol("rate")), 0.0)


def _terms(
    exprs: Mapping[str, sympy.Expr], constants: np.ndarray
) -> Iterator[dict[sympy.Expr, _Term]]:
    """Give the terms of every equation by their shapes.

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
                places = [first + int(np.argmin(np.abs(own - v))) for v in values]
                found[shape] = _Term(shape, term, math.copysign(1.0, values[0]), places)
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
