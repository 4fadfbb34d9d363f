"""Terms that equations of measured systems are made of, with what each of them costs.

Sums of these terms are the first thing looked for where noise makes slopes unsure: products of the
variables, and of one function that textbooks use (saturation, inhibition, a root, a logarithm,
sine and cosine) with up to one variable. A function with a constant inside is there for a few
values of it, which a fit then refines.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations_with_replacement

import numpy as np
import sympy

from dynsr.expression import Program, bits_in_force, compile_columns, plausibility_bits
from dynsr.fit import skeleton, structure_bits

_NO_POLYNOMIAL = 99
# Bits of saying that a variable is an angle.
_ANGLE = 8.0
# Constants of sin^2 and of cos beside 1 below the line, from which a fit reaches any other.
_SQUARES, _COSINES = (-0.75, -0.5, 0.3, 1.0, 3.0), (-0.8, -0.5, 0.5, 0.8)
# Bits that a function costs beside its length: laws are mostly made of powers and their ratios.
FUNCTION_BITS = {
    sympy.log: 3.0,
    sympy.exp: 3.0,
    sympy.sin: 3.0,
    sympy.cos: 3.0,
    sympy.tanh: 5.0,
    sympy.Abs: 5.0,
}


def unusual_bits(expr: sympy.Expr, angles: Collection[str]) -> float:
    """Give the bits that the functions of a formula cost beside its length.

    Parameters
    ----------
    expr : the formula.
    angles : columns that may be angles.

    >>> x = sympy.Symbol("x")
    >>> unusual_bits(x / (1 + x), ()), unusual_bits(sympy.log(x), ())
    (0.0, 3.0)
    """
    functions = sum(FUNCTION_BITS.get(f.func, 3.0) for f in expr.atoms(sympy.Function))
    return functions + plausibility_bits(expr, angles)


def cited_bits(exprs: Iterable[sympy.Expr]) -> float:
    """Give the bits that equations save by the terms that they have in common.

    What leaves one species enters another: x' = a x - b x y and y' = c x y - d y. A term that was
    written out in one equation costs another no more than a variable of its own does.

    Parameters
    ----------
    exprs : the equations.

    >>> x, y = sympy.symbols("x y")
    >>> cited_bits([2.0 * x - 1.5 * x * y, 0.5 * x * y - y]) > cited_bits([2.0 * x, -y])
    True
    """
    times = Counter(body for expr in exprs for body in term_bodies(expr))
    return sum((n - 1) * citing_bits(body) for body, n in times.items() if n > 1)


def citing_bits(body: sympy.Expr) -> float:
    """Give the bits that a term saves where another equation has it.

    Parameters
    ----------
    body : the term without its coefficient.
    """
    factor = sympy.Float(0.5)
    return structure_bits(factor * body) - structure_bits(factor * sympy.Symbol("term"))


def term_bodies(expr: sympy.Expr) -> set[sympy.Expr]:
    """Give the terms of a sum without their coefficients, one of each shape.

    Parameters
    ----------
    expr : the sum.
    """
    above, below = sympy.fraction(expr)
    bodies = [skeleton(t.as_coeff_Mul()[1]) for t in sympy.Add.make_args(above)]
    bodies += [skeleton(below)] if below.is_Add else []
    return {b for b in bodies if b.free_symbols and not b.is_Symbol}


def in_coordinates(
    exprs: Sequence[sympy.Expr], angles: Iterable[str]
) -> tuple[list[sympy.Expr], float]:
    """Write equations in the sine and cosine of what is an angle; gives the bits of saying so too.

    A variable that stands in all equations inside sines and cosines only is an angle. Once that is
    said, these are two coordinates like others, which saves bits where they are used often.

    Parameters
    ----------
    exprs : the equations.
    angles : columns that may be angles.

    >>> w, v = sympy.symbols("w v")
    >>> joint = [(v * sympy.sin(w) - sympy.sin(w) * sympy.cos(w)) / (1.5 + sympy.sin(w) ** 2)]
    >>> in_coordinates(joint, ["w"])[0][0].free_symbols == {v, *sympy.symbols("sin_w cos_w")}
    True
    >>> in_coordinates([w * e for e in joint], ["w"])[1]
    0.0
    """
    found, said = list(exprs), 0.0
    for name in angles:
        angle = sympy.Symbol(name)
        waves = {f(angle): sympy.Symbol(f"{f}_{name}") for f in (sympy.sin, sympy.cos)}
        flat = [expr.xreplace(waves) for expr in found]
        if flat != found and not any(angle in expr.free_symbols for expr in flat):
            saved = sum(map(_written, found)) - sum(map(_written, flat))
            if saved > _ANGLE:
                found, said = flat, said + _ANGLE
    return found, said


def _written(expr: sympy.Expr) -> float:
    return structure_bits(expr) + unusual_bits(expr, ())


def find_angles(names: Iterable[str], rows: Iterable[np.ndarray]) -> tuple[str, ...]:
    """Name the columns that may be angles: those that take both signs.

    Parameters
    ----------
    names, rows : the columns and their values.
    """
    pairs = zip(names, rows, strict=True)
    return tuple(name for name, row in pairs if row.min() < 0 < row.max())


@dataclass(frozen=True)
class TermSettings:
    """Settings of the terms; they stand in a run's record.

    Parameters
    ----------
    degree : most variables in a product without a function.
    inside : values of a constant inside a function, in units of the median size of its variable.
    most : terms at most; the cheapest are kept.
    """

    degree: int = 3
    inside: tuple[float, ...] = (0.3, 1.0, 3.0)
    most: int = 600


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms that sums are made of.

    Parameters
    ----------
    names : the variables.
    exprs : the p terms.
    bits : (p,) bits of their structure and of unusual functions.
    inside : (p,) constants inside each.
    """

    names: tuple[str, ...]
    exprs: tuple[sympy.Expr, ...]
    bits: np.ndarray
    inside: np.ndarray

    @classmethod
    def grow(
        cls,
        names: Sequence[str],
        points: np.ndarray,
        settings: TermSettings,
        angles: Sequence[str],
        own: Sequence[sympy.Expr] = (),
    ) -> Terms:
        """Make the terms in variables whose values (len(names), n) are given.

        Terms that are not finite somewhere, constant although they have variables, or multiples of
        a cheaper one on these points are left out.

        Parameters
        ----------
        names, points : the variables, and values (len(names), n) that they take.
        settings : which terms.
        angles : variables that may be angles.
        own : terms of the user's own beside them.
        """
        functions = tuple(
            tuple(_functions(sympy.Symbol(name), values, settings, name in angles))
            for name, values in zip(names, points, strict=True)
        )
        exprs, bits, program = _make_terms(
            tuple(names), functions, settings, tuple(angles), tuple(own), bits_in_force()
        )
        kept = _distinct(program(*points))
        return cls(
            tuple(names),
            tuple(exprs[i] for i in kept),
            bits[kept],
            np.array([len(exprs[i].atoms(sympy.Float)) for i in kept]),
        )

    @cached_property
    def tiers(self) -> tuple[np.ndarray, ...]:
        """Places of the quadratic, polynomial, rational and all terms, each once."""
        symbols = [sympy.Symbol(name) for name in self.names]
        degree = [
            sympy.total_degree(e) if e.is_polynomial(*symbols) else _NO_POLYNOMIAL
            for e in self.exprs
        ]
        rational = np.array([e.is_rational_function(*symbols) for e in self.exprs], dtype=bool)
        degrees = np.array(degree)
        kinds = (degrees <= 2, degrees < _NO_POLYNOMIAL, rational, np.ones_like(rational))
        found = {int(kind.sum()): np.flatnonzero(kind) for kind in kinds if kind.any()}
        return tuple(found.values())

    @cached_property
    def _program(self) -> Callable[..., np.ndarray]:
        return compile_columns(self.exprs, self.names)

    def values(self, points: np.ndarray) -> np.ndarray:
        """(p, n) values at points (len(names), n)."""
        return self._program(*points)


# The same few choices of variables come again and again in one discovery.
@lru_cache(maxsize=64)
def _make_terms(
    names: tuple[str, ...],
    functions: tuple[tuple[sympy.Expr, ...], ...],
    settings: TermSettings,
    angles: tuple[str, ...],
    own: tuple[sympy.Expr, ...],
    counted: tuple[tuple[str, float], ...],
) -> tuple[tuple[sympy.Expr, ...], np.ndarray, Program]:
    """Give the cheapest terms in order, their bits, of which ``counted`` are own, and a program."""
    symbols = [sympy.Symbol(name) for name in names]
    found: dict[sympy.Expr, None] = dict.fromkeys(own)
    for degree in range(settings.degree + 1):
        for chosen in combinations_with_replacement(symbols, degree):
            found.setdefault(sympy.Mul(*chosen))
    waves = [f(sympy.Symbol(name)) for name in angles for f in (sympy.sin, sympy.cos)]
    pairs = [a * b for a, b in combinations_with_replacement(symbols, 2)]
    for symbol, factors in zip(symbols, functions, strict=True):
        for factor in factors:
            # What is divided by a column may be a product, or a sine of another one.
            more = [*pairs, *waves] if factor == 1 / symbol else []
            if factor.is_Pow or factor.is_Mul:
                more += [symbol * other for other in symbols]
            for other in (sympy.S.One, *symbols, *more):
                found.setdefault(factor * other)
    exprs = list(found)
    bits = np.array([structure_bits(sympy.Float(0.5) * e) + unusual_bits(e, angles) for e in exprs])
    order = np.argsort(bits, kind="stable")[: settings.most]
    cheapest = tuple(exprs[i] for i in order)
    return cheapest, bits[order], compile_columns(cheapest, names)


def products(names: Sequence[str], degree: int) -> list[sympy.Expr]:
    """Give the products of one variable up to as many as the degree says.

    Parameters
    ----------
    names, degree : the variables, and how many a product has at most.
    """
    symbols = [sympy.Symbol(name) for name in names]
    degrees = range(1, degree + 1)
    chosen = (c for power in degrees for c in combinations_with_replacement(symbols, power))
    return list(dict.fromkeys(sympy.Mul(*c) for c in chosen))


@dataclass(frozen=True, eq=False)
class Joint:
    """What hangs from a joint: products with the sine and cosine of one angle.

    ``above`` are the terms above the line of such an acceleration, ``below`` what may stand beside
    1 below it, with a few values of its constant.
    """

    above: tuple[sympy.Expr, ...]
    below: tuple[sympy.Expr, ...]

    @classmethod
    def of(cls, angle: str, names: Sequence[str], degree: int = 2) -> Joint:
        """Make the terms of one angle.

        Parameters
        ----------
        angle, names : the angle among the variables.
        degree : most other variables in a term.
        """
        sine, cosine = sympy.sin(sympy.Symbol(angle)), sympy.cos(sympy.Symbol(angle))
        others = (sympy.S.One, *products([n for n in names if n != angle], degree))
        waves = (sympy.S.One, sine, cosine, sine * cosine)
        bottoms = [sympy.Float(c) * sine**2 for c in _SQUARES]
        bottoms += [sympy.Float(c) * cosine for c in _COSINES]
        return cls(tuple(w * o for w in waves for o in others), (sympy.S.Zero, *bottoms))


def _functions(
    symbol: sympy.Symbol, values: np.ndarray, settings: TermSettings, angle: bool
) -> Iterator[sympy.Expr]:
    size = float(np.median(np.abs(values)))
    positive = bool(np.min(values) > 0)
    # Close to 0 a reciprocal would follow whatever the first rows hold.
    apart = bool(np.min(values) > 0.1 * size)
    if angle:
        yield sympy.sin(symbol)
        yield sympy.cos(symbol)
        yield sympy.Abs(symbol)
    yield sympy.tanh(symbol)
    if positive:
        yield sympy.sqrt(symbol)
        yield sympy.log(symbol)
    if apart:
        yield 1 / symbol
    for share in settings.inside if size > 0 else ():
        scale = sympy.Float(float(f"{share * size:.3g}"))
        if np.max(np.abs(values)) < 50 * float(scale):
            yield sympy.exp(-symbol / scale)
        if positive:
            yield 1 / (symbol + scale)
        yield 1 / (symbol**2 + scale**2)
        yield symbol**2 / (symbol**2 + scale**2)


def _distinct(values: np.ndarray, same: float = 1e-8) -> list[int]:
    """Give the places of the rows that are finite and no multiple of an earlier one."""
    kept: list[int] = []
    units = np.empty_like(values)
    with np.errstate(all="ignore"):
        norms = np.linalg.norm(values, axis=1)
    for place, (row, norm) in enumerate(zip(values, norms, strict=True)):
        if not (np.isfinite(norm) and 0 < norm < 1e150):
            continue
        unit = row / norm
        if kept and np.max(np.abs(units[: len(kept)] @ unit)) > 1 - same:
            continue
        units[len(kept)] = unit
        kept.append(place)
    return kept
