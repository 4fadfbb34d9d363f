"""Plausibility: the bits by which a formula's functions are unusual among laws that people write.

A formula costs its length whatever it means. Over the range of one noisy record cos(0.25 V - 1)
may be as short and as close as the growth law behind the data, though V is a volume and no angle.
These bits are the negative log2 of prior odds, to be added to those of the length.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import sympy

PERIODIC = (sympy.sin, sympy.cos, sympy.tan)
RARE = (sympy.tan, sympy.asin, sympy.acos, sympy.sinh, sympy.cosh)


@dataclass(frozen=True)
class Prior:
    """Bits that unusual places of a formula cost; 8 bits are odds of 1 to 256.

    Parameters
    ----------
    nested : a function inside the argument of another, such as exp(sin(x)).
    nonlinear : an argument that is no linear form of columns, such as that of exp(1/(S + 1)). A
        power product of one column, such as E/T or x**2, costs half; in a logarithm or root it is
        free, since log(K/V) is log(K) - log(V).
    mixed : a linear argument of several columns; of a periodic function it is free where the
        columns enter whole, as in sin(theta1 - theta2).
    frequency : a periodic function of a column times a number that is not whole: an angle needs
        no unit. Time, named in ``times``, may have one.
    phase : an offset in the argument of a periodic function of a column.
    no_angle : a periodic function of a column that is not one of the ``angles``, where these are
        given.
    power : an exponent that is no small whole number or half; of a column it costs twice as much.
    rare : tan, asin, acos, sinh or cosh.
    """

    nested: float = 8.0
    nonlinear: float = 8.0
    mixed: float = 3.0
    frequency: float = 8.0
    phase: float = 4.0
    no_angle: float = 4.0
    power: float = 3.0
    rare: float = 3.0


PRIOR = Prior()
_LARGEST_POWER = 4


def plausibility_bits(
    expr: sympy.Expr,
    angles: Collection[str] | None = None,
    times: Collection[str] = ("t",),
    prior: Prior = PRIOR,
) -> float:
    """Give the bits of all unusual places of a formula; sums and ratios of powers cost none.

    Parameters
    ----------
    expr : the formula.
    angles : columns that may be angles, such as those that take both signs; None: all of them.
    times : columns that are times, whose periodic functions have a frequency and a phase.
    prior : what each place costs.

    >>> V, S = sympy.symbols("V S")
    >>> plausibility_bits(0.3 * V * sympy.log(8.0 / V)), plausibility_bits(2 * S / (0.5 + S))
    (0.0, 0.0)
    >>> plausibility_bits(sympy.cos(0.25 * V - 1)), plausibility_bits(sympy.exp(1 / (S + 1)))
    (12.0, 8.0)
    """
    bits = 0.0
    for node in sympy.preorder_traversal(expr):
        if node.is_Function:
            bits += _function_bits(node, angles, times, prior)
        elif node.is_Pow:
            bits += _power_bits(node, prior)
    return bits


def _function_bits(
    node: sympy.Expr, angles: Collection[str] | None, times: Collection[str], prior: Prior
) -> float:
    bits = prior.rare if isinstance(node, RARE) else 0.0
    argument = node.args[0]
    bits += prior.nested * bool(argument.atoms(sympy.Function) or _roots(argument))
    form = _linear(argument)
    if form is None:
        if not _is_power_product(argument):
            return bits + prior.nonlinear
        return bits + (0.0 if isinstance(node, sympy.log) else prior.nonlinear / 2)
    offset, slopes = form
    if not isinstance(node, PERIODIC):
        return bits + prior.mixed * (len(slopes) > 1)
    whole = [_is_whole(slope) for slope in slopes.values()]
    names = {str(symbol) for symbol in slopes}
    if not names <= set(times):
        bits += prior.frequency * (not all(whole)) + prior.phase * (not _is_turn(offset))
        bits += prior.mixed * (len(slopes) > 1 and not all(whole))
    if angles is not None and not names <= {*angles, *times}:
        bits += prior.no_angle
    return bits


def _power_bits(node: sympy.Pow, prior: Prior) -> float:
    exponent, base = node.exp, node.base
    if exponent.free_symbols:
        return 2 * prior.power
    twice = 2 * exponent
    whole = twice.is_number and float(twice).is_integer()
    bits = 0.0 if whole and abs(float(exponent)) <= _LARGEST_POWER else prior.power
    if whole and not float(exponent).is_integer():
        # A root is a function: of a column or power product it is usual.
        bits += prior.nested * bool(base.atoms(sympy.Function))
        usual = _linear(base) is not None or _is_power_product(base)
        bits += 0.0 if usual else prior.nonlinear / 2
    return bits


def _roots(argument: sympy.Expr) -> bool:
    return any(
        not p.exp.is_number or not float(p.exp).is_integer() for p in argument.atoms(sympy.Pow)
    )


def _linear(argument: sympy.Expr) -> tuple[sympy.Expr, dict[sympy.Symbol, sympy.Expr]] | None:
    """Give offset and slopes of a linear form of columns; None where it is not one."""
    offset = sympy.S.Zero
    slopes: dict[sympy.Symbol, sympy.Expr] = {}
    for term in sympy.Add.make_args(sympy.expand(argument)):
        coefficient, rest = term.as_independent(*term.free_symbols, as_Add=False)
        if not term.free_symbols:
            offset += term
        elif rest.is_Symbol:
            slopes[rest] = slopes.get(rest, sympy.S.Zero) + coefficient
        else:
            return None
    return offset, slopes


def _is_power_product(argument: sympy.Expr) -> bool:
    return all(
        factor.is_number or factor.is_Symbol or (factor.is_Pow and factor.base.is_Symbol)
        for factor in sympy.Mul.make_args(argument)
    )


def _is_whole(number: sympy.Expr) -> bool:
    return bool(number.is_number and float(number).is_integer())


def _is_turn(offset: sympy.Expr) -> bool:
    """Whether an offset is a whole number of quarter turns."""
    return _is_whole(offset / (sympy.pi / 2))
