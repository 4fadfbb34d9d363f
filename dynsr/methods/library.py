"""Libraries: the candidate functions of a sparse regression, as SymPy expressions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
import sympy

from dynsr.errors import InputError
from dynsr.expression import compile_numpy, parse, to_text


class AbstractLibrary(ABC):
    """What can name its candidate functions once the variables are known."""

    @abstractmethod
    def for_names(self, names: Sequence[str]) -> Library:
        """Give the functions for data whose columns have these names; raises InputError."""


@dataclass(frozen=True)
class Library(AbstractLibrary):
    """p candidate functions in a fixed order.

    >>> Library.from_strings(["1", "x*sin(y)"]).values({"x": np.ones(2), "y": np.zeros(2)}).tolist()
    [[1.0, 1.0], [0.0, 0.0]]
    """

    functions: tuple[sympy.Expr, ...]

    def __post_init__(self) -> None:
        """Refuse an empty library and a function that is there twice."""
        if not self.functions:
            raise InputError("a library has no functions; give at least one, such as 'x'")
        seen: set[sympy.Expr] = set()
        for function in self.functions:
            if function in seen:
                raise InputError(f"the library has {to_text(function)} twice; name it once")
            seen.add(function)

    @classmethod
    def from_strings(cls, texts: Iterable[str]) -> Library:
        """Read the functions from text."""
        return cls(tuple(parse(text) for text in texts))

    def __len__(self) -> int:
        """Count the functions."""
        return len(self.functions)

    def __add__(self, other: Library) -> Library:
        """Give my functions and those of the other that I lack."""
        mine = set(self.functions)
        return Library((*self.functions, *(f for f in other.functions if f not in mine)))

    def for_names(self, names: Sequence[str]) -> Library:
        """Give the library itself, when every variable it uses is among the names."""
        for function in self.functions:
            parse(function, names)
        return self

    def values(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """(p, n) values of the functions on named columns of n samples; NaN where undefined."""
        names = list(columns)
        return compile_numpy(self.functions, names)(np.array([columns[n] for n in names]))

    def select(self, which: Sequence[int] | np.ndarray) -> Library:
        """Give the library of some of the functions."""
        return Library(tuple(self.functions[i] for i in which))

    def combine(self, coefficients: np.ndarray) -> sympy.Expr:
        """Sum of coefficient times function over the coefficients that are not zero.

        >>> Library.from_strings(["x", "y"]).combine(np.array([0.0, 2.0]))
        2.0*y
        """
        pairs = zip(coefficients, self.functions, strict=True)
        return sympy.Add(*(sympy.Float(float(c)) * f for c, f in pairs if c != 0))


def polynomials(names: Sequence[str], degree: int, constant: bool = True) -> Library:
    """All products of up to ``degree`` variables, lowest degree first.

    >>> polynomials(["x", "y"], 2).functions
    (1, x, y, x**2, x*y, y**2)
    """
    if degree < 0 or (degree == 0 and not constant):
        raise InputError(f"degree {degree} leaves no polynomial; give at least 1")
    symbols = [sympy.Symbol(name) for name in names]
    first = 0 if constant else 1
    return Library(
        tuple(
            sympy.Mul(*factors)
            for size in range(first, degree + 1)
            for factors in combinations_with_replacement(symbols, size)
        )
    )


def trigonometrics(names: Sequence[str], multiples: int = 1) -> Library:
    """Sine and cosine of each variable and of its multiples.

    >>> trigonometrics(["w"]).functions
    (sin(w), cos(w))
    """
    return Library(
        tuple(
            function(multiple * sympy.Symbol(name))
            for name in names
            for multiple in range(1, multiples + 1)
            for function in (sympy.sin, sympy.cos)
        )
    )


def products(left: Library, right: Library) -> Library:
    """Every function of one library times every function of the other, each product once.

    >>> products(Library.from_strings(["x", "y"]), Library.from_strings(["x", "1"])).functions
    (x**2, x, x*y, y)
    """
    return Library(tuple(dict.fromkeys(f * g for f in left.functions for g in right.functions)))


@dataclass(frozen=True)
class GrownLibrary(AbstractLibrary):
    """Functions for data of which nothing is known: polynomials, sines, cosines, products of them.

    Sizes are added simplest first for as long as no more than ``limit`` functions come out:
    polynomials up to degree 2; sine and cosine of each variable; these times each variable; higher
    polynomials up to ``degree``; products of two sines or cosines; and their products with the
    squares. The order matters where functions are dependent on the samples: the first is kept.

    >>> len(GrownLibrary(limit=40).for_names(["x", "y"]))
    37
    """

    degree: int = 4
    trigonometric: bool = True
    limit: int = 80

    def for_names(self, names: Sequence[str]) -> Library:
        """Grow the library for these variables."""
        grown = polynomials(names, min(self.degree, 1))
        for stage in self._stages(names):
            larger = grown + stage
            if len(larger) <= self.limit:
                grown = larger
        return grown

    def _stages(self, names: Sequence[str]) -> list[Library]:
        powers = [polynomials(names, d) for d in range(2, self.degree + 1)]
        if not self.trigonometric:
            return powers
        linear = polynomials(names, 1, constant=False)
        waves = trigonometrics(names)
        pairs = products(waves, waves)
        mixed = [products(waves, linear), pairs]
        if self.degree > 1:
            mixed.append(products(pairs, polynomials(names, 2)))
        return [*powers[:1], waves, mixed[0], *powers[1:2], *mixed[1:], *powers[2:]]
