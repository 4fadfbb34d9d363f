"""Reactions: equations of mass action as what is consumed and what is produced at which rate.

A term ``k*x*y`` that is in several equations is one reaction: what it takes from one state and
gives to another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import sympy

from dynsr.errors import InputError
from dynsr.export.source import Source


@dataclass(frozen=True)
class Reaction:
    """One reaction.

    Parameters
    ----------
    rate : its whole rate, the product of a constant and what is consumed.
    constant : the constant alone, which may hold inputs.
    consumed, produced : state -> how many.
    """

    rate: sympy.Expr
    constant: sympy.Expr
    consumed: Mapping[str, int]
    produced: Mapping[str, int]


def find_reactions(source: Source) -> list[Reaction]:
    """Give the reactions of equations that are mass action.

    Parameters
    ----------
    source : what is written.

    Raises InputError, which names the term, where the equations are not mass action.
    """
    columns = {sympy.Symbol(state): state for state in source.states}
    changes: dict[sympy.Expr, dict[str, int]] = {}
    for state, expr in source.equations.items():
        for term in sympy.Add.make_args(sympy.expand(expr)):
            if term == 0:
                continue
            size, bare = term.as_coeff_Mul()
            count, factor = (
                (int(size), 1) if size.is_Integer else (1 if size > 0 else -1, abs(size))
            )
            found = changes.setdefault(factor * bare, {})
            found[state] = found.get(state, 0) + count
    return [_reaction(rate, moved, columns) for rate, moved in changes.items()]


def _reaction(
    rate: sympy.Expr, moved: Mapping[str, int], columns: Mapping[sympy.Symbol, str]
) -> Reaction:
    consumed: dict[str, int] = {}
    constant = sympy.S.One
    for factor, power in rate.as_powers_dict().items():
        if factor in columns and power.is_Integer and power > 0:
            consumed[columns[factor]] = int(power)
        elif factor.free_symbols & columns.keys() or power.free_symbols & columns.keys():
            raise InputError(f"the equations are not mass action: {rate} is no product of states")
        else:
            constant *= factor**power
    left = {state: consumed.get(state, 0) + moved.get(state, 0) for state in {**consumed, **moved}}
    if short := [state for state, count in left.items() if count < 0]:
        raise InputError(
            f"the equations are not mass action: {rate} leaves {short[0]} and is not in it"
        )
    return Reaction(rate, constant, consumed, {s: n for s, n in left.items() if n})
