"""Relations: columns that lie on a curve of the second degree all along exact data.

There a ratio is many ratios: above and below its line any multiple of what vanishes can be added.
A polynomial of the third degree is many as well, by such multiples of every column. So where the
columns keep such a relation, the data say what these are along them and leave open what they are
beside them.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations_with_replacement

import numpy as np
import sympy

# Share of the largest direction that one which vanishes may be, and how far below the last that
# does not: along any short arc the directions become small one after another.
_VANISHES, _FALLS = 1e-6, 100.0
# Degree from which on a product of a column and what vanishes may stand in a polynomial.
_CUBIC = 3
# Rows that are enough.
_ROWS = 400


def is_left_open(expr: sympy.Expr, columns: Mapping[str, np.ndarray]) -> bool:
    """Whether a formula is a ratio, or cubic, in columns that keep a relation of degree two.

    Parameters
    ----------
    expr : the formula.
    columns : name -> (n,) values along exact data.

    >>> t = np.linspace(0.0, 6.0, 200)
    >>> circle = {"x": np.cos(t), "y": np.sin(t), "t": t}
    >>> x, y, s = sympy.symbols("x y t")
    >>> [is_left_open(expr, circle) for expr in (y / (3 + x), y / (3 + s), x * y**2, x * y)]
    [True, False, True, False]
    """
    clock = {"t"} - {str(symbol) for symbol in expr.free_symbols}
    bound = _bound([name for name in columns if name not in clock], columns)
    if not bound:
        return False
    line = sympy.denom(sympy.together(expr))
    # A line of one product has taken nothing in that vanishes.
    sums = [part for part in line.atoms(sympy.Add) if part.is_polynomial(*part.free_symbols)]
    if expr.is_polynomial(*expr.free_symbols):
        sums = [
            t for t in sympy.Add.make_args(sympy.expand(expr)) if sympy.total_degree(t) >= _CUBIC
        ]
    under = {str(symbol) for part in sums for symbol in part.free_symbols}
    if not under or not line.is_polynomial(*line.free_symbols):
        return False
    return bool(under & bound)


def _bound(names: list[str], columns: Mapping[str, np.ndarray]) -> set[str]:
    """Name the columns in a relation of the second degree; those of the first are not asked for."""
    rows = np.array([columns[name] for name in names], dtype=float)
    rows = rows[:, :: max(1, rows.shape[1] // _ROWS)]
    spread = np.std(rows, axis=1)
    if not (np.all(np.isfinite(rows)) and np.all(spread > 0)):
        return set()
    unit = (rows - rows.mean(axis=1)[:, None]) / spread[:, None]
    # Of columns that a straight line ties, the last ones say nothing of their own.
    kept: list[int] = []
    for place in range(len(names)):
        sizes = np.linalg.svd(unit[[*kept, place]], compute_uv=False)
        if sizes[-1] > _VANISHES * sizes[0]:
            kept.append(place)
    pairs = list(combinations_with_replacement(kept, 2))
    products = [unit[i] * unit[j] for i, j in pairs]
    terms = np.array([np.ones(unit.shape[1]), *unit[kept], *products])
    if terms.shape[1] <= len(terms):
        return set()
    terms /= np.linalg.norm(terms, axis=1)[:, None]
    directions, sizes, _ = np.linalg.svd(terms, full_matrices=False)
    floor = max(sizes[-1], 1e-15 * sizes[0])
    vanish = np.flatnonzero(sizes <= _VANISHES * sizes[0])
    falls = [i for i in vanish if i and sizes[i - 1] > _FALLS * max(sizes[i], floor)]
    if not falls:
        return set()
    weights = np.max(np.abs(directions[:, falls[0] :]), axis=1)
    of_pairs = weights[1 + len(kept) :]
    found = {k for pair, weight in zip(pairs, of_pairs, strict=True) if weight > 1e-3 for k in pair}
    return {names[k] for k in found}
