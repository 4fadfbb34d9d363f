"""Features: the products of the library with their values on samples, repeats dropped."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.expression import OPERATORS
from dynsr.methods.library import FUNCTION_FACTORS, cut_by_cost, factors_of, monomials


@dataclass(frozen=True, eq=False)
class Features:
    """m features at n samples: ``exprs`` (m), ``values`` (m, n), ``costs`` (m), cheapest first."""

    exprs: tuple[sympy.Expr, ...]
    values: np.ndarray
    costs: np.ndarray

    def without(self, exprs: Collection[sympy.Expr]) -> Features:
        """Give all but some."""
        if not exprs:
            return self
        keep = [i for i, expr in enumerate(self.exprs) if expr not in exprs]
        return Features(tuple(self.exprs[i] for i in keep), self.values[keep], self.costs[keep])


@dataclass(frozen=True, eq=False)
class _Atom:
    expr: sympy.Expr
    values: np.ndarray
    cost: int
    max_power: int


def _atoms(
    columns: dict[str, np.ndarray], inverses: bool, functions: Sequence[str] | None
) -> list[_Atom]:
    factors = FUNCTION_FACTORS if functions is None else factors_of(functions)
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
        for token, (cost, power) in factors.items():
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
    functions: Sequence[str] | None = None,
    terms: Sequence[tuple[sympy.Expr, np.ndarray]] = (),
) -> Features:
    """Make all products of v, sin v, cos v, exp v, log v and sqrt v over the variables v.

    A variable costs 1, its sine or cosine 2, its exponential, logarithm or root 3, and a product
    the sum of its factors; the feature 1 costs nothing. Products of more than ``max_degree``
    factors or ``max_cost`` are left out, and so are those of the highest costs when there are
    more than ``max_count``, whole costs at a time. Features whose values repeat an earlier one's
    are dropped.

    With ``inverses`` the atoms are v and 1/v alone, each of cost 1. ``functions`` names other
    functions than these five. ``terms`` are further features with their values; each
    costs 1, and no products are made of them.

    >>> x = np.linspace(1.0, 2.0, 50)
    >>> [str(e) for e in build_features({"x": x}, max_cost=2).exprs]
    ['1', 'x', 'sin(x)', 'cos(x)', 'x**2']
    """
    atoms = _atoms(columns, inverses, functions)
    costs, powers = [a.cost for a in atoms], [a.max_power for a in atoms]
    found = monomials(costs, max_degree, most_cost=max_cost, powers=powers)
    totals = [sum(costs[i] for i in places) for places in found]
    kept = found[: cut_by_cost(totals, max_count)]
    rows = len(next(iter(columns.values())))
    made: dict[tuple[int, ...], tuple[sympy.Expr, np.ndarray]] = {(): (sympy.S.One, np.ones(rows))}
    for places in kept[1:]:
        expr, values = made[places[:-1]]
        atom = atoms[places[-1]]
        made[places] = expr * atom.expr, values * atom.values
    pairs = [made[()], *terms, *(made[p] for p in kept[1:])]
    costs = [0, *[1] * len(terms), *totals[1 : len(kept)]]
    return _drop_repeats([e for e, _ in pairs], [v for _, v in pairs], costs)


def _drop_repeats(exprs: list[sympy.Expr], rows: list[np.ndarray], costs: list[int]) -> Features:
    values = np.array(rows)
    scale = np.linalg.norm(values, axis=1, keepdims=True)
    good = np.isfinite(scale[:, 0]) & (scale[:, 0] > 0)
    rounded = np.round(values / np.where(scale > 0, scale, 1.0), 10)
    _, first = np.unique(rounded, axis=0, return_index=True)
    keep = [i for i in sorted(first) if good[i]]
    return Features(tuple(exprs[i] for i in keep), values[keep], np.array([costs[i] for i in keep]))
