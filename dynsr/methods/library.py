"""Libraries of terms, as SymPy expressions: products of variables and of functions of one.

Every search that needs terms takes them from here: sparse regression, polynomials, the features of
ratios, and the terms that a comparison of whole systems may add.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from dynsr.errors import InputError
from dynsr.expression import OPERATORS, compile_numpy, parse, to_text
from dynsr.methods.limits import Limits

# Function of one variable -> (its cost, the highest power that a product may hold); a variable
# costs 1. sin^2 is left out: cos^2 and 1 span it.
FUNCTION_FACTORS = {"sin": (2, 1), "cos": (2, 2), "exp": (3, 1), "log": (3, 1), "sqrt": (3, 1)}
_WAVES = ("sin", "cos")


def factors_of(functions: Iterable[str]) -> dict[str, tuple[int, int]]:
    """Give name -> (cost, highest power) of functions; those without a place of their own cost 3.

    Parameters
    ----------
    functions : names of :data:`dynsr.expression.NAMED_FUNCTIONS`.

    >>> factors_of(["tanh", "cos"])
    {'tanh': (3, 1), 'cos': (2, 2)}
    """
    return {name: FUNCTION_FACTORS.get(name, (3, 1)) for name in functions}


def monomials(
    costs: Sequence[int],
    degree: int,
    *,
    most_cost: float = math.inf,
    powers: Sequence[int] | None = None,
) -> list[tuple[int, ...]]:
    """Every product of up to ``degree`` of q factors, as the places of its factors.

    Parameters
    ----------
    costs : (q,) cost of each factor; a product costs their sum.
    degree : most factors of a product.
    most_cost : products that cost more are left out.
    powers : (q,) highest power of each factor; ``degree`` by default.

    Cheapest first, of equal cost those of fewer factors; () is the product 1.

    >>> monomials([1, 2], 2, most_cost=3)
    [(), (0,), (1,), (0, 0), (0, 1)]
    """
    found: list[tuple[int, tuple[int, ...]]] = [(0, ())]
    level = found
    for _ in range(degree):
        level = [
            (cost + costs[i], (*places, i))
            for cost, places in level
            for i in range(places[-1] if places else 0, len(costs))
            if cost + costs[i] <= most_cost and (powers is None or places.count(i) < powers[i])
        ]
        found = [*found, *level]
    return [places for _, places in sorted(found, key=lambda item: (item[0], len(item[1])))]


def cut_by_cost(costs: Sequence[int], most: int) -> int:
    """How many of the first products are kept so that at most ``most`` are, whole costs at a time.

    ``costs`` ascend; where the cheapest alone are too many, ``most`` of them are.

    >>> cut_by_cost([0, 1, 1, 2, 2], 4), cut_by_cost([1, 1, 1], 2)
    (3, 2)
    """
    if len(costs) <= most:
        return len(costs)
    return sum(cost < costs[most] for cost in costs) or most


class AbstractLibrary(ABC):
    """What can name its candidate functions once the variables are known."""

    @abstractmethod
    def for_names(self, names: Sequence[str]) -> Library:
        """Give the functions for data whose columns have these names; raises InputError."""

    def for_columns(self, columns: Mapping[str, np.ndarray]) -> Library:
        """Give the functions for data; those for their names, unless the values matter.

        Parameters
        ----------
        columns : name -> (n,) values.
        """
        return self.for_names(list(columns))


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
    found = monomials([1] * len(symbols), degree)
    return Library(
        tuple(sympy.Mul(*(symbols[i] for i in p)) for p in found[0 if constant else 1 :])
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


@dataclass(frozen=True)
class MonomialLibrary(AbstractLibrary):
    """All products of the variables and of functions of one variable, bounded by cost and count.

    Parameters
    ----------
    functions : names of functions; those of :data:`FUNCTION_FACTORS` have costs of their own.
    degree : most factors of a product.
    cost : most that a product costs: a variable 1, a sine or cosine 2, other functions 3.
    limit : most products; where there are more, the highest costs are left out, each as a whole.
    own : additional terms of the user.

    >>> [str(f) for f in MonomialLibrary(cost=2).for_names(["x"]).functions]
    ['1', 'x', 'sin(x)', 'cos(x)', 'x**2']
    """

    functions: tuple[str, ...] = ("sin", "cos")
    degree: int = 3
    cost: int = 4
    limit: int = 120
    own: tuple[sympy.Expr, ...] = ()

    def factors(self, names: Sequence[str]) -> list[tuple[sympy.Expr, int, int]]:
        """Give (expression, cost, highest power) of every factor for these variables."""
        found = []
        for symbol in map(sympy.Symbol, names):
            found.append((symbol, 1, self.degree))
            for name in self.functions:
                found.append((OPERATORS[name].sympy(symbol), *factors_of([name])[name]))
        return found

    def for_names(self, names: Sequence[str]) -> Library:
        """Make the products for these variables."""
        exprs, costs, powers = zip(*self.factors(names), strict=True)
        found = monomials(costs, self.degree, most_cost=self.cost, powers=powers)
        count = cut_by_cost([sum(costs[i] for i in places) for places in found], self.limit)
        made = [sympy.Mul(*(exprs[i] for i in p)) for p in found[:count]]
        return Library(tuple(dict.fromkeys([*made, *self.own])))


@dataclass(frozen=True)
class LimitedLibrary(AbstractLibrary):
    """A library within limits: the user's terms first, then what is allowed of its own functions.

    A grown library also has the other functions asked for, of each variable and times each, where
    they are finite on the samples.

    Parameters
    ----------
    library : the library without limits.
    limits : functions and operators allowed, terms added and left out.

    >>> from dynsr.expression import Vocabulary
    >>> few = LimitedLibrary(GrownLibrary(degree=2), Limits(Vocabulary(("exp",))))
    >>> [str(f) for f in few.for_names(["x"]).functions]
    ['1', 'x', 'x**2', 'exp(x)', 'x*exp(x)']
    """

    library: AbstractLibrary
    limits: Limits

    def for_names(self, names: Sequence[str]) -> Library:
        """Give the functions for these variables."""
        waves = self.limits.functions(_WAVES)
        library = self.library
        extras: list[sympy.Expr] = []
        if isinstance(library, GrownLibrary):
            library = replace(library, trigonometric=bool({*waves} & {*_WAVES}))
            extras = self._extras(names)
        own = [e for e in library.for_names(names).functions if self.limits.allow(e)]
        constant = [e for e in own if e == 1]
        ordered = [*constant, *self.limits.terms, *own, *extras]
        if not ordered:
            raise InputError("the limits leave no function in the library; allow more")
        return Library(tuple(dict.fromkeys(ordered)))

    def for_columns(self, columns: Mapping[str, np.ndarray]) -> Library:
        """Give the functions that are finite on the data, and the user's terms in any case."""
        library = self.for_names(list(columns))
        finite = np.isfinite(library.values(columns)).all(axis=1)
        kept = [
            e in self.limits.terms or bool(ok)
            for e, ok in zip(library.functions, finite, strict=True)
        ]
        return library.select(np.flatnonzero(kept))

    def _extras(self, names: Sequence[str]) -> list[sympy.Expr]:
        vocabulary = self.limits.vocabulary
        asked = [f for f in vocabulary.functions if f not in _WAVES] if vocabulary else []
        symbols = [sympy.Symbol(name) for name in names]
        images = [OPERATORS[f].sympy(symbol) for symbol in symbols for f in asked]
        found = [*images, *(symbol * image for image in images for symbol in symbols)]
        return [e for e in found if self.limits.allow(e)]
