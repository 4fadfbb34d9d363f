"""Terms that equations of measured systems are made of, with what each of them costs.

Sums of these terms are the first thing looked for where noise makes slopes unsure: products of the
variables, and of one function that textbooks use (saturation, inhibition, a root, a logarithm,
sine and cosine) with up to one variable. A function with a constant inside is there for a few
values of it, which a fit then refines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations, combinations_with_replacement

import numpy as np
import sympy

from dynsr.expression import Program, bits_in_force, compile_columns
from dynsr.library import keeps_turning
from dynsr.selection.costs import shape_bits, unusual_bits

# Share of its largest value by which a column may fall below 0 that is never negative.
_BELOW = 0.03


@dataclass(frozen=True)
class TermSettings:
    """Settings of the terms; they stand in a run's record.

    Parameters
    ----------
    degree : most variables in a product without a function.
    alone : further powers of a variable that is the only one.
    inside : values of a constant inside a function, in units of the median size of its variable.
    powers : exponents of a positive variable from which a fit reaches any other.
    most : terms at most; the cheapest are kept.
    """

    degree: int = 3
    alone: tuple[int, ...] = (4, 5)
    inside: tuple[float, ...] = (0.3, 1.0, 3.0)
    powers: tuple[float, ...] = (-1.5, -0.5, 0.35, 0.7, 1.5)
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
        pairs = (*_shared(names, points, settings), *_phases(names, points))
        exprs, bits, program = _make_terms(
            tuple(names), functions, settings, tuple(angles), (*own, *pairs), bits_in_force()
        )
        kept = _distinct(program(*points))
        return cls(
            tuple(names),
            tuple(exprs[i] for i in kept),
            bits[kept],
            np.array([len(exprs[i].atoms(sympy.Float)) for i in kept]),
        )

    @cached_property
    def _program(self) -> Callable[..., np.ndarray]:
        return compile_columns(self.exprs, self.names)

    def values(self, points: np.ndarray) -> np.ndarray:
        """(p, n) values at points (len(names), n)."""
        return self._program(*points)


def move_inside(term: sympy.Expr, shift: float) -> sympy.Expr:
    """Multiply the one constant inside a term by exp(shift).

    Parameters
    ----------
    term, shift : the term, and the logarithm.
    """
    return term.xreplace({c: c * sympy.Float(np.exp(shift)) for c in term.atoms(sympy.Float)})


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
    if len(symbols) == 1:
        # Beside others they would be so many more polynomials that follow any curve.
        found |= dict.fromkeys(symbols[0] ** power for power in settings.alone)
    waves = [f(sympy.Symbol(name)) for name in angles for f in (sympy.sin, sympy.cos)]
    pairs = [a * b for a, b in combinations_with_replacement(symbols, 2)]
    for symbol, factors in zip(symbols, functions, strict=True):
        for factor in factors:
            # What is divided by a column may be a product, or a sine of another one.
            more = [*pairs, *waves] if factor == 1 / symbol else []
            if (factor.is_Pow and not factor.exp.is_Float) or factor.is_Mul:
                more += [symbol * other for other in symbols]
            for other in (sympy.S.One, *symbols, *more):
                found.setdefault(factor * other)
    exprs = list(found)
    bits = np.array([shape_bits(sympy.Float(0.5) * e) + unusual_bits(e, angles) for e in exprs])
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


def weighted_sum(values: Iterable[float], exprs: Iterable[sympy.Expr]) -> sympy.Expr:
    """Give the sum of terms, each times its coefficient.

    Parameters
    ----------
    values, exprs : as many coefficients as terms.
    """
    return sympy.Add(*[sympy.Float(c) * e for c, e in zip(values, exprs, strict=True)])


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
        yield from (symbol ** sympy.Float(p) for p in settings.powers)
        yield sympy.sqrt(symbol)
        yield sympy.log(symbol)
    if apart:
        yield 1 / symbol
    for share in settings.inside if size > 0 else ():
        scale = sympy.Float(float(f"{share * size:.3g}"))
        if np.max(np.abs(values)) < 50 * float(scale):
            yield sympy.exp(-symbol / scale)
        if angle:
            yield sympy.tanh(symbol / scale)
        if never_negative(values):
            yield 1 / (symbol + scale)
        yield 1 / (symbol**2 + scale**2)
        yield symbol**2 / (symbol**2 + scale**2)


def never_negative(values: np.ndarray) -> bool:
    """Whether a column is never negative; what begins at nothing is a little below 0 in noise.

    Parameters
    ----------
    values : (n,) of the column.

    >>> never_negative(np.array([-0.01, 0.5, 1.0])), never_negative(np.array([-0.5, 0.5, 1.0]))
    (True, False)
    """
    return bool(np.min(values) > -_BELOW * np.max(np.abs(values)))


def _shared(
    names: Sequence[str], points: np.ndarray, settings: TermSettings
) -> Iterator[sympy.Expr]:
    """Give what two positive columns share out: x y / (x + c y), as in frequencies and ratios."""
    sizes = {
        n: float(np.median(row)) for n, row in zip(names, points, strict=True) if row.min() > 0
    }
    for first, second in combinations(sizes, 2):
        x, y = sympy.Symbol(first), sympy.Symbol(second)
        for share in settings.inside:
            scale = sympy.Float(float(f"{share * sizes[first] / sizes[second]:.3g}"))
            yield x * y / (x + scale * y)


def _phases(names: Sequence[str], points: np.ndarray) -> Iterator[sympy.Expr]:
    """Give the sine and cosine of how far one column that turns on and on is before another."""
    turning = [sympy.Symbol(n) for n, row in zip(names, points, strict=True) if keeps_turning(row)]
    for x, y in combinations(turning, 2):
        yield from (sympy.sin(x - y), sympy.cos(x - y))


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
