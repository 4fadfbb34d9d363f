"""Permuted equations: equations that are equal when the names of their columns are exchanged.

Examples are two pendulums on one spring, two species that compete, and three genes in a ring. Once
one such equation is written, the others cost only the names that are exchanged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import sympy

from dynsr.expression import skeleton
from dynsr.fit import (
    Names,
    exchanges,
    one_of_each_shape,
    ways_alike,
    with_floats,
)
from dynsr.selection.shapes import bodies_of


def exchanged(expr: sympy.Expr, state: str, other: str, columns: Sequence[str]) -> list[sympy.Expr]:
    """Write an equation for another state, in every way of exchanging names that gives another.

    Parameters
    ----------
    expr : the equation.
    state, other : whose it is, and whose it is to be.
    columns : names that may be exchanged.

    >>> x, y, z = sympy.symbols("x y z")
    >>> exchanged(2.5 * x * y - 0.5 * x, "x", "y", ["x", "y", "z"])
    [2.5*x*y - 0.5*y, 2.5*y*z - 0.5*y]
    """
    ways = exchanges(expr, state, other, columns)
    return one_of_each_shape(expr.xreplace(names) for names in ways)


def shifted(expr: sympy.Expr, state: str, other: str, columns: Sequence[str]) -> sympy.Expr:
    """Write an equation for another state, each column as far from it in the table as before.

    Parameters
    ----------
    expr : the equation.
    state, other : whose it is, and whose it is to be.
    columns : names in the order of the table, which is taken for a circle.

    >>> x, y, z = sympy.symbols("x y z")
    >>> shifted(2.5 * x * y - 0.5 * x, "x", "z", ["x", "y", "z"])
    2.5*x*z - 0.5*z
    """
    names = [sympy.Symbol(name) for name in columns]
    far = columns.index(other) - columns.index(state)
    return expr.xreplace({n: names[(i + far) % len(names)] for i, n in enumerate(names)})


def with_permuted(
    exprs: Mapping[str, sympy.Expr], state: str, expr: sympy.Expr, columns: Sequence[str]
) -> list[dict[str, sympy.Expr]]:
    """Give a system with one equation changed, and first with its permuted equations changed too.

    Parameters
    ----------
    exprs : state -> equation.
    state, expr : whose equation changes, and what it becomes.
    columns : names that may be exchanged.

    >>> x, y = sympy.symbols("x y")
    >>> twins = {"x": 2.0 * x - 1.5 * x * y, "y": 0.5 * y - 0.3 * x * y}
    >>> with_permuted(twins, "x", 1.9 * x - 1.2 * x * y - 0.1 * x**2, ["x", "y"])[0]["y"]
    -0.3*x*y - 0.1*y**2 + 0.5*y
    """
    alone = {**exprs, state: expr}
    both = dict(alone)
    for other, own in exprs.items():
        names = None if other == state else _find(exprs[state], state, own, other, columns)
        if names is not None:
            both[other] = _with_terms_of(own, expr.xreplace(names))
    return [alone] if both == alone else [both, alone]


def families(
    found: Mapping[str, Sequence[sympy.Expr]], columns: Sequence[str]
) -> list[dict[str, sympy.Expr]]:
    """Give the system of the most probable equations, then those with permuted equations of one.

    Parameters
    ----------
    found : state -> candidates for its equation, the most probable first.
    columns : names that may be exchanged.

    >>> x, y = sympy.symbols("x y")
    >>> found = {"x": [2.0 * x - 1.5 * x * y], "y": [0.7 / y, 0.5 * y - 0.3 * x * y]}
    >>> families(found, ["x", "y"])[1]
    {'x': -1.5*x*y + 2.0*x, 'y': -0.3*x*y + 0.5*y}
    """
    loose = {state: [with_floats(expr) for expr in own] for state, own in found.items()}
    systems = [{state: own[0] for state, own in found.items()}]
    for state, (lead, *_) in loose.items():
        family = {
            other: next(
                (
                    expr
                    for expr, own in zip(exprs, loose[other], strict=True)
                    if other != state and _find(lead, state, own, other, columns)
                ),
                exprs[0],
            )
            for other, exprs in found.items()
        }
        systems += [family] if family not in systems else []
    return systems


def _with_terms_of(own: sympy.Expr, changed: sympy.Expr) -> sympy.Expr:
    """Give the sum of the terms of one equation, in the constants of another that has them too."""
    known = {skeleton(body): term for body, term in _terms(own)}
    return sympy.Add(*[known.get(skeleton(body), term) for body, term in _terms(changed)])


def _terms(expr: sympy.Expr) -> Iterator[tuple[sympy.Expr, sympy.Expr]]:
    yield from zip(bodies_of(expr), sympy.Add.make_args(expr), strict=True)


def _find(
    expr: sympy.Expr, state: str, twin: sympy.Expr, other: str, columns: Sequence[str]
) -> Names | None:
    """Give the first names by which one equation is another; None where there are no such names."""
    return next(iter(ways_alike(expr, state, twin, other, columns)), None)
