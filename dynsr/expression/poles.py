"""Poles: whether a formula divides by 0 where its columns are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import sympy

from dynsr.expression.evaluation import evaluate

# Points at which the line below a fraction is looked at, so that even a narrow pole shows.
_ACROSS = 201
# Share of its range that a bare column reaches to either side of 0 where no noise brings it there.
_EITHER = 0.05


def lines_below(expr: sympy.Expr) -> Iterator[sympy.Expr]:
    """Give the denominators of a formula, except bare columns.

    Parameters
    ----------
    expr : the formula.

    >>> x = sympy.Symbol("x")
    >>> list(lines_below(2 / (x + 3) + 1 / x))
    [x + 3]
    """
    for power in expr.atoms(sympy.Pow):
        if power.base.is_Add and power.exp.is_negative and power.free_symbols:
            yield power.base


def has_pole(expr: sympy.Expr, columns: Mapping[str, np.ndarray], beside: float = 0.0) -> bool:
    """Whether a denominator passes through 0 where the columns of one run are, or between.

    Denominators of anything but columns are left out. A bare column passes through 0 where it
    reaches to both sides of it.

    Parameters
    ----------
    expr : the formula.
    columns : name -> (n,) values of what it holds.
    beside : share of a column's range that is looked at beyond either end of it, for lines of one
        column.

    >>> x = sympy.Symbol("x")
    >>> rows = {"x": np.array([1.0, 2.0])}
    >>> has_pole(1 / (x - 1.5), rows), has_pole(1 / (x - 2.05), rows)
    (True, False)
    >>> has_pole(1 / x, rows), has_pole(1 / x, {"x": np.array([-1.0, 2.0])})
    (False, True)
    >>> has_pole(1 / (x - 2.05), rows, beside=0.1)
    True
    """
    for line in dict.fromkeys(lines_below(expr)):
        names = [str(symbol) for symbol in line.free_symbols]
        if not set(names) <= set(columns):
            continue
        with np.errstate(all="ignore"):
            if len(names) == 1:
                low, high = columns[names[0]].min(), columns[names[0]].max()
                reach = beside * (high - low)
                across = np.linspace(low - reach, high + reach, _ACROSS)
                values = evaluate(line, {names[0]: across})
            else:
                values = evaluate(line, columns)
        if not (np.min(values) > 0 or np.max(values) < 0):
            return True
    bare = (p.base for p in expr.atoms(sympy.Pow) if p.base.is_Symbol and p.exp.is_negative)
    return any(_crosses(columns[str(symbol)]) for symbol in bare if str(symbol) in columns)


def _crosses(values: np.ndarray) -> bool:
    low, high = np.min(values), np.max(values)
    return bool(min(-low, high) > _EITHER * (high - low))
