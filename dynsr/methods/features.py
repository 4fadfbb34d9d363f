"""A library of features that grows from the variables alone: products of simple functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.expression import OPERATORS


@dataclass(frozen=True, eq=False)
class Features:
    """m features at n samples: ``exprs`` (m), ``values`` (m, n), ``costs`` (m), cheapest first."""

    exprs: tuple[sympy.Expr, ...]
    values: np.ndarray
    costs: np.ndarray


@dataclass(frozen=True, eq=False)
class _Atom:
    expr: sympy.Expr
    values: np.ndarray
    cost: int
    max_power: int


# function -> (cost, highest power that a product may hold). sin^2 is left out: cos^2 and 1 span it.
_ATOM_FUNCTIONS = {"sin": (2, 1), "cos": (2, 2), "exp": (3, 1), "log": (3, 1), "sqrt": (3, 1)}


def _atoms(columns: dict[str, np.ndarray], inverses: bool) -> list[_Atom]:
    atoms = []
    for name, values in columns.items():
        if np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
            continue
        symbol = sympy.Symbol(name)
        atoms.append(_Atom(symbol, values, 1, 4))
        if inverses:
            if np.abs(values).min() > 1e-6 * np.abs(values).max():
                atoms.append(_Atom(1 / symbol, 1 / values, 1, 2))
            continue
        for token, (cost, power) in _ATOM_FUNCTIONS.items():
            with np.errstate(all="ignore"):
                image = OPERATORS[token].numpy(values)
            if np.all(np.isfinite(image)) and np.abs(image).max() < 1e8:
                atoms.append(_Atom(OPERATORS[token].sympy(symbol), image, cost, power))
    return atoms


def build_features(
    columns: dict[str, np.ndarray],
    max_cost: int = 6,
    max_degree: int = 4,
    max_count: int = 2500,
    inverses: bool = False,
) -> Features:
    """Make all products of v, sin v, cos v, exp v, log v and sqrt v over the variables v.

    A variable costs 1, its sine or cosine 2, its exponential, logarithm or root 3, and a product
    the sum of its factors; the feature 1 costs nothing. Products of more than ``max_degree``
    factors or ``max_cost`` are left out, and so are the dearest when there are more than
    ``max_count``, whole costs at a time. Features whose values repeat an earlier one's are dropped.

    With ``inverses`` the atoms are v and 1/v alone, each of cost 1.

    >>> x = np.linspace(1.0, 2.0, 50)
    >>> [str(e) for e in build_features({"x": x}, max_cost=2).exprs]
    ['1', 'x', 'sin(x)', 'cos(x)', 'x**2']
    """
    atoms = _atoms(columns, inverses)
    count = len(next(iter(columns.values())))
    found: list[tuple[int, int, sympy.Expr, np.ndarray]] = [(0, 0, sympy.S.One, np.ones(count))]
    # Each entry: cost, degree, expression, values, index of its last atom, power of that atom.
    level = [(0, sympy.S.One, np.ones(count), 0, 0)]
    for degree in range(1, max_degree + 1):
        following = []
        for cost, expr, values, first, power in level:
            for index in range(first, len(atoms)):
                atom = atoms[index]
                raised = power + 1 if index == first and degree > 1 else 1
                if cost + atom.cost > max_cost or raised > atom.max_power:
                    continue
                entry = (cost + atom.cost, expr * atom.expr, values * atom.values, index, raised)
                following.append(entry)
                found.append((entry[0], degree, entry[1], entry[2]))
        level = following
    found.sort(key=lambda item: (item[0], item[1]))
    return _drop_repeats(_cut(found, max_count))


def _cut(
    found: list[tuple[int, int, sympy.Expr, np.ndarray]], max_count: int
) -> list[tuple[int, int, sympy.Expr, np.ndarray]]:
    if len(found) <= max_count:
        return found
    last = found[max_count][0]
    return [item for item in found if item[0] < last] or found[:max_count]


def _drop_repeats(found: list[tuple[int, int, sympy.Expr, np.ndarray]]) -> Features:
    values = np.array([item[3] for item in found])
    scale = np.linalg.norm(values, axis=1, keepdims=True)
    good = np.isfinite(scale[:, 0]) & (scale[:, 0] > 0)
    rounded = np.round(values / np.where(scale > 0, scale, 1.0), 10)
    _, first = np.unique(rounded, axis=0, return_index=True)
    keep = [i for i in sorted(first) if good[i]]
    return Features(
        tuple(found[i][2] for i in keep), values[keep], np.array([found[i][0] for i in keep])
    )
