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
# Correlation of a column's slopes with another column from which on that is its speed.
_SPEED = 0.99


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
    angles = find_turning(named, named.values(), columns.get("t"))
    return partial(structure_of, columns=tuple(named), angles=angles)


def find_turning(
    names: Iterable[str], rows: Iterable[np.ndarray], t: np.ndarray | None = None
) -> tuple[str, ...]:
    """Name the columns that sines and cosines are tried of.

    Those that take both signs, those that turn on and on: that go one way by more than half a
    turn, and those whose speed is another column, as that of a body's angle is.

    Parameters
    ----------
    names, rows : the columns and their values in order.
    t : (n,) times of the rows, run after run; without them no speeds are looked for.

    >>> t = np.linspace(0.0, 9.0, 50)
    >>> find_turning(["u", "x", "phase"], [np.sin(t), 2 + np.sin(t), 0.1 + t])
    ('u', 'phase')
    >>> find_turning(["x", "y", "v"], [2 + np.sin(t), 2 + np.sin(t / 2), np.cos(t)], t)
    ('x', 'v')
    """
    found = dict(zip(names, rows, strict=True))
    moved = () if t is None else find_coordinates(found, t)
    return tuple(
        name
        for name, row in found.items()
        if row.min() < 0 < row.max() or keeps_turning(row) or name in moved
    )


def find_coordinates(columns: Mapping[str, np.ndarray], t: np.ndarray) -> tuple[str, ...]:
    """Name the columns whose speed is another column, as that of a joint's angle is.

    Parameters
    ----------
    columns : name -> (n,) values in order.
    t : (n,) times of the rows, run after run.
    """
    step = np.diff(t)
    within = step > 0
    rows = np.array([*columns.values()]).reshape(len(columns), len(t))
    slopes = np.diff(rows)[:, within] / step[within]
    means = ((rows[:, 1:] + rows[:, :-1]) / 2)[:, within]
    with np.errstate(all="ignore"):
        alike = np.abs(np.corrcoef(slopes, means)[: len(rows), len(rows) :])
    np.fill_diagonal(alike, 0.0)
    most = np.nan_to_num(alike).max(axis=1, initial=0.0)
    return tuple(name for name, own in zip(columns, most, strict=True) if own > _SPEED)


def keeps_turning(row: np.ndarray) -> bool:
    """Whether a column goes one way by more than half a turn.

    Parameters
    ----------
    row : its values in order.
    """
    way = abs(float(row[-1] - row[0]))
    return way > np.pi and way > _ONE_WAY * float(np.sum(np.abs(np.diff(row))))
