"""Structure: the bits of equations without their constants, and what the columns say for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import numpy as np
import sympy

from dynsr.expression import added_bits
from dynsr.library.prior import textbooks

# Share of its way that a phase makes in one direction.
_ONE_WAY = 0.9


def structure_of(
    exprs: Mapping[str, sympy.Expr],
    columns: Sequence[str],
    states: Sequence[str] = (),
    angles: Sequence[str] | None = None,
) -> float:
    """Give the bits of equations without their constants: by the textbooks, and the user's own.

    Parameters
    ----------
    exprs : state -> equation.
    columns : names of all columns.
    states : of them, what moves by equations; by default those that are given.
    angles : columns that may be angles; by default all of them.
    """
    own = sum(map(added_bits, exprs.values()))
    return textbooks().system_bits(exprs, columns, states, angles) + own


def structure_in(columns: Mapping[str, np.ndarray]) -> Callable[[Mapping[str, sympy.Expr]], float]:
    """Give what counts the bits of equations without their constants.

    Parameters
    ----------
    columns : name -> (n,) values of the columns that a formula may contain, in order.

    >>> x = sympy.Symbol("x")
    >>> bits = structure_in({"x": np.linspace(1.0, 2.0, 9)})
    >>> bits({"x": 0.5 * x}) < bits({"x": 0.5 * sympy.sin(x)})
    True
    """
    named = {name: row for name, row in columns.items() if name != "t"}
    angles = find_turning(named, named.values())
    return partial(structure_of, columns=tuple(named), angles=angles)


def find_turning(names: Iterable[str], rows: Iterable[np.ndarray]) -> tuple[str, ...]:
    """Name the columns that sines and cosines are tried of.

    Those that take both signs, and those that turn on and on: that go one way by more than half a
    turn.

    Parameters
    ----------
    names, rows : the columns and their values in order.

    >>> t = np.linspace(0.0, 9.0, 50)
    >>> find_turning(["u", "x", "phase"], [np.sin(t), 2 + np.sin(t), 0.1 + t])
    ('u', 'phase')
    """
    pairs = zip(names, rows, strict=True)
    return tuple(n for n, row in pairs if row.min() < 0 < row.max() or keeps_turning(row))


def keeps_turning(row: np.ndarray) -> bool:
    """Whether a column goes one way by more than half a turn.

    Parameters
    ----------
    row : its values in order.
    """
    way = abs(float(row[-1] - row[0]))
    return way > np.pi and way > _ONE_WAY * float(np.sum(np.abs(np.diff(row))))
