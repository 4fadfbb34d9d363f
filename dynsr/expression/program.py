"""Programs: expressions as lists of array operations, made in microseconds.

Where thousands of formulas are each evaluated a few dozen times, compiling them costs more than all
their evaluations. A program is made by one walk over the expression; equal subexpressions are
computed once.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import sympy

from dynsr.expression.evaluation import differentiate
from dynsr.expression.operators import FUNCTIONS

_BY_CLASS: dict[Any, Callable[..., Any]] = {
    known.sympy: known.numpy for known in FUNCTIONS.values() if isinstance(known.sympy, type)
}

_INNER = sympy.Symbol("inner")

# What floats do among themselves as arrays do, and several times quicker.
_PLAIN: dict[Callable[..., Any], Callable[..., Any]] = {
    np.add: operator.add,
    np.multiply: operator.mul,
    np.divide: operator.truediv,
}


@dataclass(frozen=True, eq=False)
class Program:
    """Operations on a growing list of values: the arguments, then every result.

    ``steps`` are (function, places of its arguments); ``results`` the places of the expressions.
    ``constants`` follow the arguments.
    """

    count: int
    constants: tuple[float, ...]
    steps: tuple[tuple[Callable[..., Any], tuple[int, ...]], ...]
    results: tuple[int, ...]

    def __call__(self, *columns: Any) -> np.ndarray:
        """Give (k, ...) values of the k expressions on arguments that broadcast."""
        values: list[Any] = [*columns, *self.constants]
        with np.errstate(all="ignore"):
            for function, places in self.steps:
                if len(places) == 2:
                    values.append(function(values[places[0]], values[places[1]]))
                else:
                    values.append(function(values[places[0]]))
        shapes = {column.shape if isinstance(column, np.ndarray) else () for column in columns}
        shapes.discard(())
        shape = shapes.pop() if len(shapes) == 1 else np.broadcast_shapes(*shapes)
        out = np.empty((len(self.results), *shape))
        for row, place in enumerate(self.results):
            out[row] = values[place]
        return out

    def at(self, *numbers: float) -> list[float]:
        """Give the values of the k expressions at p plain floats, bit for bit as a call does.

        Many times quicker than a call, for integrations point by point. The caller says what
        becomes of warnings.

        Parameters
        ----------
        numbers : the p arguments.
        """
        values: list[Any] = [*numbers, *self.constants]
        try:
            for function, places in self._plain:
                values.append(function(*[values[place] for place in places]))
        except ZeroDivisionError:
            whole: list[float] = self(*numbers).tolist()
            return whole
        return [float(values[place]) for place in self.results]

    @cached_property
    def _plain(self) -> list[tuple[Callable[..., Any], tuple[int, ...]]]:
        return [(_PLAIN.get(function, function), places) for function, places in self.steps]


class _Writer:
    """Writes a program, each node once."""

    def __init__(self, names: Sequence[str]) -> None:
        self.count = len(names)
        self.known: dict[Any, int] = {sympy.Symbol(n): i for i, n in enumerate(names)}
        self.constants: list[float] = []
        self.steps: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []
        self.functions: dict[Callable[..., Any], Any] = {}
        self.slopes: dict[tuple[int, int], int | None] = {}

    # Constants come behind the arguments, results behind those: while both grow, constants are
    # numbered from -1 down.
    def number(self, value: float) -> int:
        key = ("number", value)
        if key not in self.known:
            self.constants.append(value)
            self.known[key] = -len(self.constants)
        return self.known[key]

    def step(self, function: Callable[..., Any], *places: int) -> int:
        key = (function, places)
        if key not in self.known:
            self.steps.append((function, places))
            self.known[key] = self.count + len(self.steps) - 1
        return self.known[key]

    def write(self, node: sympy.Basic) -> int:
        found = self.known.get(node)
        if found is None:
            found = self.known[node] = self._write(node)
        return found

    def _write(self, node: sympy.Basic) -> int:
        if node.is_Add or node.is_Mul:
            return self._chain(node)
        if node.is_Pow:
            return self._power(node.base, node.exp)
        own = _BY_CLASS.get(node.func) or getattr(node.func, "_imp_", None)
        if own is not None:
            self.functions[own] = node.func
            return self.step(own, self.write(node.args[0]))
        if node.is_Symbol:
            raise KeyError(str(node))
        try:
            return self.number(float(node))
        except TypeError:  # an imaginary number or complex infinity
            return self.number(float("nan"))

    def _chain(self, node: sympy.Basic) -> int:
        if node.is_Add:
            above, below = [self.write(a) for a in node.args], []
        else:
            parts = [(a, a.is_Pow and a.exp.is_Rational and a.exp < 0) for a in node.args]
            above = [self.write(a) for a, under in parts if not under]
            below = [self._power(a.base, -a.exp) for a, under in parts if under]
        function: Callable[..., Any] = np.add if node.is_Add else np.multiply
        found = above[0] if above else self.number(1.0)
        for place in above[1:]:
            found = self.step(function, found, place)
        for place in below:
            found = self.step(np.divide, found, place)
        return found

    def _power(self, base: sympy.Expr, exponent: sympy.Expr) -> int:
        inner = self.write(base)
        if exponent.is_Rational and exponent < 0:
            return self.step(np.divide, self.number(1.0), self._power(base, -exponent))
        if exponent == sympy.Rational(1, 2):
            return self.step(np.sqrt, inner)
        if exponent.is_Integer and 1 <= int(exponent) <= 4:
            found = inner
            for _ in range(int(exponent) - 1):
                found = self.step(np.multiply, found, inner)
            return found
        return self.step(np.power, inner, self.write(exponent))

    def slope(self, place: int, by: int) -> int | None:
        """Write the derivative of a value by an argument, by the chain rule; None where it is 0."""
        if place == by:
            return self.number(1.0)
        # Constants, and other arguments.
        if place < self.count:
            return None
        if (place, by) not in self.slopes:
            self.slopes[place, by] = self._slope(place, by)
        return self.slopes[place, by]

    def _slope(self, place: int, by: int) -> int | None:
        function, places = self.steps[place - self.count]
        turned = [self.slope(own, by) for own in places]
        if all(one is None for one in turned):
            return None
        if function is np.add:
            return self._sum(turned)
        if function is np.multiply:
            pairs = zip(turned, reversed(places), strict=True)
            return self._sum([self._product(own, other) for own, other in pairs])
        if function is np.divide:
            less = self._product(turned[1], place)
            whole = self._sum([turned[0], self._product(less, self.number(-1.0))])
            return None if whole is None else self.step(np.divide, whole, places[1])
        if function is np.power:
            return self._slope_of_power(place, places, turned)
        if function is np.sqrt:
            half = self._product(turned[0], self.number(0.5))
            return None if half is None else self.step(np.divide, half, place)
        outer = _slope_of(self.functions[function])
        # A symbol of its own: the same formula of another value is another value.
        inner = sympy.Symbol(f"inner {places[0]}")
        self.known[inner] = places[0]
        return self._product(turned[0], self.write(outer.xreplace({_INNER: inner})))

    def _slope_of_power(
        self, place: int, places: tuple[int, ...], turned: Sequence[int | None]
    ) -> int | None:
        base, exponent = places
        less = self.step(np.add, exponent, self.number(-1.0))
        outer = self.step(np.multiply, exponent, self.step(np.power, base, less))
        logged = None
        if turned[1] is not None:
            by_exponent = self.step(np.multiply, place, self.step(np.log, base))
            logged = self._product(turned[1], by_exponent)
        return self._sum([self._product(turned[0], outer), logged])

    def _sum(self, places: Sequence[int | None]) -> int | None:
        found: int | None = None
        for place in (own for own in places if own is not None):
            found = place if found is None else self.step(np.add, found, place)
        return found

    def _product(self, place: int | None, other: int) -> int | None:
        if place is None or other == self.known.get(("number", 1.0)):
            return place
        if place == self.known.get(("number", 1.0)):
            return other
        return self.step(np.multiply, place, other)


@lru_cache(maxsize=256)
def _slope_of(function: Any) -> sympy.Expr:
    """Give the derivative of a function of one variable."""
    return differentiate(function(_INNER), _INNER)


def compile_columns(
    exprs: Sequence[sympy.Expr], names: Sequence[str], by: Sequence[str] = ()
) -> Program:
    """Make a program of k expressions in p variables: a function of p arrays that broadcast.

    Values outside an expression's domain become NaN or inf without a warning.

    Parameters
    ----------
    exprs : the k expressions.
    names : names of the p arguments, in their order.
    by : arguments by which slopes are given too: after the k values those of the first expression
        by each of them, then of the next one.

    Raises KeyError for a variable without an argument.

    >>> from dynsr.expression import parse
    >>> f = compile_columns([parse("a*x"), parse("sin(x)/x")], ["a", "x"])
    >>> f(np.array([[1.0], [2.0]]), np.array([3.0, 4.0]))[0].tolist()
    [[3.0, 4.0], [6.0, 8.0]]
    >>> compile_columns([parse("a*x^2")], ["a", "x"], by=["x"])(2.0, 3.0).tolist()
    [18.0, 12.0]
    """
    writer = _Writer(names)
    results = [writer.write(expr) for expr in exprs]
    columns = [writer.known[sympy.Symbol(name)] for name in by]
    slopes = [writer.slope(place, column) for place in results for column in columns]
    results += [writer.number(0.0) if place is None else place for place in slopes]
    first, shift = writer.count, len(writer.constants)

    def placed(place: int) -> int:
        if place < 0:
            return first - 1 - place
        return place if place < first else place + shift

    steps = tuple((function, tuple(map(placed, places))) for function, places in writer.steps)
    return Program(first, tuple(writer.constants), steps, tuple(map(placed, results)))
