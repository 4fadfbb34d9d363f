"""Relations: columns that lie on a curve of the second degree, or keep a product of powers.

There a ratio is many ratios: a multiple of what vanishes can be added to both of its sides.
A polynomial of the third degree is many as well, by such multiples of every column. Where a product
of powers stays the same, as an angular momentum r^2 w does, a term is many terms: it may be
multiplied by any power of that product, which changes its coefficient alone. So where the columns
keep such a relation, the data determine these formulas on the relation, and not away from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations_with_replacement, compress

import numpy as np
import sympy

from dynsr.expression import LARGEST_IN_FRACTION, expand_terms

# Share of the largest, or of its size, that what vanishes may be, and how far below the last that
# does not: along any short arc the directions become small one after another.
VANISHES, _FALLS = 1e-6, 100.0
# Degree from which on a product of a column and what vanishes may stand in a polynomial.
_CUBIC = 3
# Rows that are enough.
_ROWS = 400
# The smallest value of a column, as a share of its largest, from which on it has a logarithm, and
# the share by which whole coefficients that are no chance may differ.
_POSITIVE, _WHOLE = 1e-3, 1e-6
# Weight from which on a column has a part in a direction.
_PART = 1e-3
# Powers of a product that are looked at.
_WAYS = 7


def is_left_open(expr: sympy.Expr, columns: Mapping[str, np.ndarray]) -> bool:
    """Whether a formula is one of many that are the same along columns that keep a relation.

    In columns that keep a relation of the second degree, a ratio or a cubic is. In columns whose
    product of powers is constant, a term is that is no plain product of two, unless its coefficient
    is a whole number and no other coefficient is.

    Parameters
    ----------
    expr : the formula.
    columns : name -> (n,) values along exact data.

    >>> t = np.linspace(0.0, 6.0, 200)
    >>> circle = {"x": np.cos(t), "y": np.sin(t), "t": t}
    >>> x, y, s = sympy.symbols("x y t")
    >>> [is_left_open(expr, circle) for expr in (y / (3 + x), y / (3 + s), x * y**2, x * y)]
    [True, False, True, False]
    >>> orbit = {"x": 2 + np.cos(t), "y": 1.3 / (2 + np.cos(t)) ** 2, "s": np.sin(t)}
    >>> [is_left_open(expr, orbit) for expr in (1.3 * s * y / x, s * y / x, 0.3 * x, 0.3 * s**3)]
    [True, False, False, False]
    """
    clock = {"t"} - {str(symbol) for symbol in expr.free_symbols}
    names = [name for name in columns if name not in clock]
    tied = _tied(names, columns)
    terms = sympy.Add.make_args(expand_terms(expr)) if tied else ()
    if any(_may_be_multiplied(term, tied) for term in terms):
        return True
    bound = _bound(names, columns)
    if not bound:
        return False
    line = sympy.denom(sympy.together(expr))
    # A line of one product has taken nothing in that vanishes.
    sums = [part for part in line.atoms(sympy.Add) if part.is_polynomial(*part.free_symbols)]
    if expr.is_polynomial(*expr.free_symbols):
        sums = [
            t for t in sympy.Add.make_args(expand_terms(expr)) if sympy.total_degree(t) >= _CUBIC
        ]
    under = {str(symbol) for part in sums for symbol in part.free_symbols}
    if not under or not line.is_polynomial(*line.free_symbols):
        return False
    return bool(under & bound)


def _may_be_multiplied(term: sympy.Expr, tied: Mapping[str, bool]) -> bool:
    """Whether a product of powers that stays the same may be in a term or not."""
    coefficient, body = term.as_coeff_Mul()
    symbols = body.free_symbols
    held = [tied[str(symbol)] for symbol in symbols if str(symbol) in tied]
    if not held or (body.is_polynomial(*symbols) and sympy.total_degree(body) < _CUBIC):
        return False
    return not (all(held) and _is_whole(float(coefficient)))


def _is_whole(value: float) -> bool:
    size = abs(value)
    return bool(0 < round(size) <= LARGEST_IN_FRACTION and abs(size - round(size)) <= _WHOLE * size)


def _tied(names: list[str], columns: Mapping[str, np.ndarray]) -> dict[str, bool]:
    """Name the columns of which a product of powers stays the same.

    With each goes whether powers of that product are no whole numbers, so that these decide.
    """
    sizes = {name: np.abs(np.asarray(columns[name], dtype=float)) for name in names}
    sizes = {name: own[:: max(1, len(own) // _ROWS)] for name, own in sizes.items()}
    logs = {
        name: np.log(own)
        for name, own in sizes.items()
        if np.all(np.isfinite(own)) and np.min(own) > _POSITIVE * np.max(own)
    }
    rows = np.array([own - own.mean() for own in logs.values()])
    if len(rows) < 2 or not np.all(np.std(rows, axis=1) > 0):
        return {}
    lengths = np.linalg.norm(rows, axis=1)
    directions, found, _ = np.linalg.svd(rows / lengths[:, None], full_matrices=False)
    if found[-1] > VANISHES * found[0] or not _falls(found, len(found) - 1):
        return {}
    weights = directions[:, -1]
    kept = np.abs(weights) > _PART
    powers = np.where(kept, weights / lengths, 0.0)
    product = float(powers @ [own.mean() for own in logs.values()]) / float(np.max(np.abs(powers)))
    # The smallest whole powers are not known: those of the product to the first few are looked at.
    tell = not any(_is_whole(math.exp(abs(n * product))) for n in range(1, _WAYS))
    return {name: tell for name, own in zip(logs, kept, strict=True) if own}


def have_a_fixed_sum(columns: Mapping[str, np.ndarray]) -> bool:
    """Whether some weighted sum of the columns stays the same, or one of them does.

    Parameters
    ----------
    columns : name -> (n,) values along exact data.

    >>> t = np.linspace(0.0, 6.0, 200)
    >>> have_a_fixed_sum({"x": np.exp(-t), "y": 2 - 3 * np.exp(-t)})
    True
    >>> have_a_fixed_sum({"x": np.exp(-t), "y": np.sin(t)})
    False
    """
    unit = _standardised(list(columns), columns)
    if unit is None:
        return True
    sizes = np.linalg.svd(unit, compute_uv=False)
    return bool(sizes[-1] <= VANISHES * sizes[0])


def _falls(sizes: np.ndarray, place: int) -> bool:
    """Whether a direction is far smaller than the one before, both above rounding."""
    return bool(sizes[place - 1] > _FALLS * max(sizes[place], 1e-15 * sizes[0]))


def _standardised(names: list[str], columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """(names, n) some rows less their means, over their spreads; None where one stays the same."""
    rows = np.array([columns[name] for name in names], dtype=float)
    rows = rows[:, :: max(1, rows.shape[1] // _ROWS)]
    spread = np.std(rows, axis=1)
    if not (np.all(np.isfinite(rows)) and np.all(spread > 0)):
        return None
    unit: np.ndarray = (rows - rows.mean(axis=1)[:, None]) / spread[:, None]
    return unit


def _bound(names: list[str], columns: Mapping[str, np.ndarray]) -> set[str]:
    """Name the columns in a relation of the second degree; those of the first are not asked for."""
    unit = _standardised(names, columns)
    if unit is None:
        return set()
    # Of columns that a straight line ties, the last ones say nothing of their own.
    kept: list[int] = []
    for place in range(len(names)):
        sizes = np.linalg.svd(unit[[*kept, place]], compute_uv=False)
        if sizes[-1] > VANISHES * sizes[0]:
            kept.append(place)
    pairs = list(combinations_with_replacement(kept, 2))
    products = [unit[i] * unit[j] for i, j in pairs]
    terms = np.array([np.ones(unit.shape[1]), *unit[kept], *products])
    if terms.shape[1] <= len(terms):
        return set()
    terms /= np.linalg.norm(terms, axis=1)[:, None]
    directions, sizes, _ = np.linalg.svd(terms, full_matrices=False)
    vanish = np.flatnonzero(sizes <= VANISHES * sizes[0])
    falls = [i for i in vanish.tolist() if i and _falls(sizes, i)]
    if not falls:
        return set()
    weights = np.max(np.abs(directions[:, falls[0] :]), axis=1)
    of_pairs = weights[1 + len(kept) :]
    found = {k for pair in compress(pairs, of_pairs > _PART) for k in pair}
    return {names[k] for k in found}
