"""Dimensions: which formulas make sense in the units of their columns, and those of coefficients.

A number of a formula may carry any unit, as a fitted constant does. What has no number to carry one
must fit: terms that are added, and the arguments of functions and exponents.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, reduce
from typing import Any

import sympy

from dynsr.errors import InputError, need, quoted

Powers = tuple[tuple[str, Fraction], ...]
# Functions that give back the unit of their argument; all others take and give plain numbers.
_KEEP = (sympy.Abs, sympy.Min, sympy.Max)
_UNITLESS = "1"
# Units may come with a file: what would compute without end is not read.
_LONGEST = 60
_TOWER = re.compile(r"\d\s*(\*\*|\^)")


@dataclass(frozen=True)
class Unit:
    """A unit: powers of dimensions, its size in base units, and its name as powers of symbols."""

    dimensions: Powers = ()
    size: float = 1.0
    symbols: Powers = ()

    def power(self, exponent: Fraction) -> Unit:
        """Give a power of it."""
        return Unit(
            _times(self.dimensions, (), exponent),
            self.size ** float(exponent),
            _times(self.symbols, (), exponent),
        )

    def times(self, other: Unit) -> Unit:
        """Give its product with another one."""
        return Unit(
            _times(self.dimensions, other.dimensions),
            self.size * other.size,
            _times(self.symbols, other.symbols),
        )

    def same(self, other: Unit) -> bool:
        """Whether numbers in the two may be added: one dimension, and one size."""
        return self.dimensions == other.dimensions and math.isclose(
            self.size, other.size, rel_tol=1e-6
        )

    def __str__(self) -> str:
        """Write it with symbols, such as m/s^2; 1 for a plain number."""
        above = [_raise(name, p) for name, p in self.symbols if p > 0]
        below = [_raise(name, -p) for name, p in self.symbols if p < 0]
        bottom = below[0] if len(below) == 1 else f"({'*'.join(below)})"
        return "*".join(above or [_UNITLESS]) + (f"/{bottom}" if below else "")


def _times(one: Powers, other: Powers, exponent: Fraction = Fraction(1)) -> Powers:
    found = {name: power * exponent for name, power in one}
    for name, power in other:
        found[name] = found.get(name, Fraction(0)) + power
    return tuple(sorted((name, power) for name, power in found.items() if power))


def _raise(name: str, power: Fraction) -> str:
    if power == 1:
        return name
    return f"{name}^{power}" if power.denominator == 1 else f"{name}^({power})"


PLAIN = Unit()


@dataclass(frozen=True)
class Units:
    """The units of columns, and of the time under ``t``.

    Parameters
    ----------
    columns : (name, unit) of those that are known; any other column may be in any unit.

    >>> one = Fraction(1)
    >>> metre = Unit((("[length]", one),), 1.0, (("m", one),))
    >>> second = Unit((("[time]", one),), 1.0, (("s", one),))
    >>> units = Units((("x", metre), ("y", second)))
    >>> x, y = sympy.symbols("x y")
    >>> [units.fault(e) for e in (x / y, 2 * x + 3 * y, sympy.sin(2 * x))]
    ['', '', '']
    >>> units.fault(sympy.exp(x))
    'exp(x) of a quantity in m'
    """

    columns: tuple[tuple[str, Unit], ...]

    def fault(self, expr: sympy.Expr) -> str:
        """Say where a formula adds or takes functions of what it may not; "" where nowhere.

        Terms of the whole sum are never at fault: each has a coefficient, which may be 1.

        Parameters
        ----------
        expr : the formula, the right-hand side of an equation.
        """
        try:
            for term in sympy.Add.make_args(expr):
                self._unit(term)
        except _Misfit as misfit:
            return str(misfit)
        return ""

    def of_coefficient(self, state: str, term: sympy.Expr) -> str:
        """Give the unit of the coefficient of a term in the equation of a state; "" if unknown.

        Parameters
        ----------
        state : whose slope the term is part of.
        term : the term without its coefficient.
        """
        known = dict(self.columns)
        try:
            unit = PLAIN if term == 1 else self._unit(term)
        except _Misfit:
            return ""
        if unit is None or state not in known or "t" not in known:
            return ""
        slope = known[state].times(known["t"].power(Fraction(-1)))
        return str(slope.times(unit.power(Fraction(-1))))

    def of_symbols(
        self, equations: Mapping[str, sympy.Expr], names: Collection[str]
    ) -> dict[str, str]:
        """Give name -> its unit, for the parameters of equations whose units the columns give.

        Parameters
        ----------
        equations : state -> right-hand side; its numbers are plain ones.
        names : of the parameters.

        >>> one = Fraction(1)
        >>> gram = Unit((("[mass]", one),), 1.0, (("g", one),))
        >>> hour = Unit((("[time]", one),), 3600.0, (("h", one),))
        >>> units = Units((("x", gram), ("t", hour)))
        >>> x, v, k = sympy.symbols("x v k")
        >>> units.of_symbols({"x": -v * x / (k + x)}, ["v", "k"])
        {'k': 'g', 'v': 'g/h'}
        """
        known = dict(self.columns)
        found: dict[str, Unit] = {}
        before = -1
        while before < len(found):
            before = len(found)
            for state, expr in equations.items():
                slope = None
                if state in known and "t" in known:
                    slope = known[state].times(known["t"].power(Fraction(-1)))
                tracing = _Tracing({**known, **found}, frozenset(names), found)
                tracing.follow(expr, slope)
        return {name: str(found[name]) for name in sorted(found)}

    def _unit(self, expr: sympy.Expr) -> Unit | None:
        """Give the unit of a formula, None where a number in it may carry any."""
        if expr.is_Symbol:
            return dict(self.columns).get(str(expr))
        if expr.is_number:
            return None
        if expr.is_Mul:
            return self._product([self._unit(a) for a in expr.args if a != -1])
        if expr.is_Pow:
            return self._power(expr)
        parts = [self._unit(a) for a in expr.args]
        if expr.is_Add or isinstance(expr, _KEEP):
            return self._sum(expr, [unit for unit in parts if unit is not None])
        for argument, unit in zip(expr.args, parts, strict=True):
            if unit is not None and not unit.same(PLAIN) and expr.func is not sympy.sign:
                raise _Misfit(f"{expr.func.__name__}({argument}) of a quantity in {unit}")
        return PLAIN

    def _product(self, units: list[Unit | None]) -> Unit | None:
        whole = PLAIN
        for unit in units:
            if unit is None:
                return None
            whole = whole.times(unit)
        return whole

    def _sum(self, expr: sympy.Expr, units: list[Unit]) -> Unit | None:
        for unit in units[1:]:
            if not unit.same(units[0]):
                raise _Misfit(f"{expr} of quantities in {units[0]} and {unit}")
        return units[0] if units else None

    def _power(self, expr: sympy.Expr) -> Unit | None:
        base, exponent = self._unit(expr.base), expr.exp
        if exponent.is_number:
            return None if base is None else base.power(_share(exponent))
        for unit in (base, self._unit(exponent)):
            if unit is not None and not unit.same(PLAIN):
                raise _Misfit(f"{expr} of a quantity in {unit}")
        return PLAIN


@dataclass(frozen=True)
class _Tracing:
    """Follows the unit of a whole formula down to the parameters in it."""

    known: dict[str, Unit]
    names: frozenset[str]
    found: dict[str, Unit]

    def of(self, expr: sympy.Expr) -> Unit | None:
        """Give the unit of a formula, None where a parameter or a column leaves it open."""
        if expr.is_Symbol:
            return self.known.get(str(expr)) or self.found.get(str(expr))
        if expr.is_number:
            return PLAIN
        if expr.is_Pow:
            base = self.of(expr.base)
            if base is None or not expr.exp.is_number:
                return PLAIN if base is not None and base.same(PLAIN) else None
            return base.power(_share(expr.exp))
        parts = [self.of(argument) for argument in expr.args]
        if expr.is_Mul:
            return None if None in parts else reduce(Unit.times, [p for p in parts if p], PLAIN)
        if expr.is_Add or isinstance(expr, _KEEP):
            return next((part for part in parts if part is not None), None)
        return PLAIN

    def follow(self, expr: sympy.Expr, unit: Unit | None) -> None:
        """Note the units of the parameters in a formula that is in a unit, None if unknown."""
        if expr.is_Symbol:
            if str(expr) in self.names and unit is not None:
                self.found.setdefault(str(expr), unit)
        elif expr.is_Mul:
            parts = {argument: self.of(argument) for argument in expr.args}
            for argument, own in parts.items():
                others = [other for a, other in parts.items() if a != argument]
                known = [other for other in others if other is not None]
                if own is None and unit is not None and len(known) == len(others):
                    own = unit.times(reduce(Unit.times, known, PLAIN).power(Fraction(-1)))
                self.follow(argument, own)
        elif expr.is_Pow and expr.exp.is_number:
            self.follow(expr.base, unit and unit.power(1 / _share(expr.exp)))
        elif expr.is_Add or isinstance(expr, _KEEP):
            for argument in expr.args:
                self.follow(argument, unit or self.of(expr))
        else:
            for argument in expr.args:
                self.follow(argument, PLAIN)


def _share(exponent: sympy.Expr) -> Fraction:
    return Fraction(float(exponent)).limit_denominator(1000)


def bare_term(term: sympy.Expr) -> sympy.Expr:
    """Give a term without its coefficient.

    >>> bare_term(3 * sympy.Symbol("x"))
    x
    """
    rest = term.as_independent(*term.free_symbols, as_Add=False)[1]
    return rest if term.free_symbols else sympy.S.One


class _Misfit(Exception):
    """What does not fit, in words."""


def read_units(units: Mapping[str, str]) -> Units:
    """Read the units of columns.

    Parameters
    ----------
    units : column, or ``t`` for the time, -> a unit as pint reads it: "m/s", "1/day", "mg/L".
        Angles are plain numbers, in radians.

    Raises InputError when one cannot be read or has an offset, MissingExtra without pint.
    """
    need("pint", "units", "a check of units")
    registry = _registry()
    return Units(tuple((str(name), _read(registry, name, text)) for name, text in units.items()))


@cache
def _registry() -> Any:
    import pint

    # It reads a long file of definitions.
    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


def _read(registry: Any, name: str, text: str) -> Unit:
    plain = str(text).strip() in ("", "1")
    if len(str(text)) > _LONGEST or _TOWER.search(str(text)):
        raise InputError(f"unit {quoted(text)} of {name!r} is too long; write it like m/s")
    try:
        if set(str(text)) & set(";=,"):  # pint would read "m;t=s" as a product of the three
            raise ValueError
        unit = registry.Unit("dimensionless" if plain else str(text).strip())
        one, two = (registry.Quantity(n, unit).to_base_units().magnitude for n in (1.0, 2.0))
    except Exception:  # pint's own, and those of the tokenizer that it reads with
        raise InputError(
            f"unit {quoted(text)} of {name!r} is unknown to pint; write it like m/s, or "
            "count for what is counted"
        ) from None
    if not math.isclose(two, 2 * one, rel_tol=1e-9):
        raise InputError(
            f"unit {text!r} of {name!r} counts from an offset; give kelvin, or delta_degC"
        )
    powers = {f"{registry.Unit(part):~}": p for part, p in unit._units.items()}  # noqa: SLF001
    named = {symbol: p for symbol, p in powers.items() if symbol != "count"}
    return Unit(_exact(unit.dimensionality), float(one), _exact(named))


def _exact(powers: Mapping[str, Any]) -> Powers:
    exact = {str(name): Fraction(float(p)).limit_denominator(1000) for name, p in powers.items()}
    return tuple(sorted((name, power) for name, power in exact.items() if power))
