"""Structure: the bits of equations without their constants, and what the columns say for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import sympy

from dynsr.expression import added_bits, bits_in_force
from dynsr.library.prior import textbooks

# Share of its way that a phase makes in one direction.
_ONE_WAY = 0.9


def structure_of(
    exprs: Mapping[str, sympy.Expr], columns: Mapping[str, np.ndarray], states: Sequence[str] = ()
) -> float:
    """Give the bits of equations without their constants: by the textbooks, and the user's own.

    Parameters
    ----------
    exprs : state -> equation.
    columns : name -> (n,) values of the columns that a formula may contain, in order.
    states : of them, what moves by equations; by default those that are given.

    >>> x = sympy.Symbol("x")
    >>> data = {"x": np.linspace(1.0, 2.0, 9)}
    >>> structure_of({"x": 0.5 * x}, data) < structure_of({"x": 0.5 * sympy.sin(x)}, data)
    True
    """
    own = sum(map(added_bits, exprs.values())) if bits_in_force() else 0.0
    named = {name: row for name, row in columns.items() if name != "t"}
    angles = find_turning(named, named.values())
    return textbooks().system_bits(exprs, tuple(named), states, angles) + own


def find_angles(names: Iterable[str], rows: Iterable[np.ndarray]) -> tuple[str, ...]:
    """Name the columns that may be angles: those that take both signs.

    Parameters
    ----------
    names, rows : the columns and their values.
    """
    pairs = zip(names, rows, strict=True)
    return tuple(name for name, row in pairs if row.min() < 0 < row.max())


def find_turning(names: Iterable[str], rows: Iterable[np.ndarray]) -> tuple[str, ...]:
    """Name the columns that sines and cosines are tried of.

    Those that may be angles, and those that turn on and on: that go one way by more than half a
    turn.

    Parameters
    ----------
    names, rows : the columns and their values in order.

    >>> t = np.linspace(0.0, 9.0, 50)
    >>> find_turning(["u", "x", "phase"], [np.sin(t), 2 + np.sin(t), 0.1 + t])
    ('u', 'phase')
    """
    columns = dict(zip(names, rows, strict=True))
    angles = find_angles(columns, columns.values())
    return tuple(n for n, row in columns.items() if n in angles or keeps_turning(row))


def keeps_turning(row: np.ndarray) -> bool:
    """Whether a column goes one way by more than half a turn.

    Parameters
    ----------
    row : its values in order.
    """
    way = abs(float(row[-1] - row[0]))
    return way > np.pi and way > _ONE_WAY * float(np.sum(np.abs(np.diff(row))))
