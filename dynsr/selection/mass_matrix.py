"""Accelerations that one mass matrix couples, and how short one is when it contains another.

Where masses are coupled, M(q) q'' = f, every acceleration alone is a fraction with the determinant
of M as its denominator, which contains the sine and cosine of an angle. Written with another
acceleration it needs no denominator: for a pole on a cart, y' = cos(w) z' - g sin(w), together with
the fraction of z'. In noise this distinguishes fractions that are alike along the data: only the
right one is short.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations

import numpy as np
import sympy
from scipy.optimize import linear_sum_assignment

from dynsr.expression import free_constants
from dynsr.fit import shift_bits
from dynsr.selection.subsets import SINGULAR

# Powers of the two waves by which an acceleration may enter another.
FACTORS = ((0, 0), (1, 0), (0, 1))
# Share of what it is the difference of below which a number is only error.
_CANCELLED = 0.1
# Bits of the data from which on a coupling does not hold.
_BROKEN = 40.0
_POWERS, _LARGEST = 12, 3
# (what stands beside the waves, power of the second wave) -> numbers by powers of the first.
_Sums = dict[tuple[sympy.Expr, int], np.ndarray]


@dataclass(frozen=True)
class _Term:
    """A product: ``factor`` times the constant ``place`` (none: -1), other things and waves."""

    place: int
    factor: float
    beside: sympy.Expr
    waves: tuple[int, int]


@dataclass(frozen=True)
class Ratio:
    """A fraction whose denominator contains the sine or cosine of one angle, plain or squared.

    Parameters
    ----------
    main, other : the wave in the line, and the angle's other one.
    above, below : the terms; the constants in them are numbered in their order in the formula.
    constants : how many there are.
    degree : power of the wave in the line.
    """

    main: sympy.Expr
    other: sympy.Expr
    above: tuple[_Term, ...]
    below: tuple[_Term, ...]
    constants: int
    degree: int

    def line(self, constants: np.ndarray) -> tuple[np.float64, np.float64]:
        """Give the numbers of the denominator: the constant, and the factor of the wave.

        Parameters
        ----------
        constants : their values.
        """
        sums = _sum_up(self.below, constants, (0, 0))[sympy.S.One, 0]
        return sums[0], sums[self.degree]

    def divide(self, constants: np.ndarray, factor: tuple[int, int]) -> tuple[_Sums, _Sums]:
        """Divide a multiple of the ratio: give the quotient, and the rest over the denominator.

        In the denominator the wave has the factor 1.

        Parameters
        ----------
        constants : their values.
        factor : powers of the two waves in the multiple.
        """
        first, last = self.line(constants)
        even, rest = {}, {}
        for key, sums in _sum_up(self.above, constants, factor).items():
            left, out = sums / last, np.zeros(_POWERS)
            for power in range(_POWERS - 1, self.degree - 1, -1):
                out[power - self.degree] = left[power]
                left[power - self.degree] -= left[power] * first / last
                left[power] = 0.0
            even[key], rest[key] = out, left
        return even, rest

    def put_in(
        self, expr: sympy.Expr, size: float, factor: tuple[int, int], beside: sympy.Expr
    ) -> sympy.Expr:
        """Write out a multiple of the ratio plus a sum, over the denominator of the ratio.

        What cancels but for errors is left out.

        Parameters
        ----------
        expr : the ratio itself, with its constants.
        size, factor : the multiple's number, and its powers of the two waves.
        beside : sum of products.
        """
        constants = np.array(list(free_constants(expr, "c")[1].values()))
        first, last = self.line(constants)
        own = _sum_up(self.above, size * constants, factor)
        other = _sum_up(_read_terms(beside, (self.main, self.other), ()), constants, (0, 0))
        sums: _Sums = {}
        for key in own.keys() | other.keys():
            multiple, more = own.get(key, np.zeros(_POWERS)), other.get(key, np.zeros(_POWERS))
            raised = last * np.roll(more, self.degree)
            row = sums[key] = multiple + first * more + raised
            sizes = np.abs(multiple) + np.abs(first * more) + np.abs(raised)
            row[np.abs(row) <= _CANCELLED * sizes] = 0.0
        return self.write(sums) / sympy.fraction(expr)[1]

    def write(self, sums: _Sums) -> sympy.Expr:
        """Write sums as a formula.

        Parameters
        ----------
        sums : the numbers; none that is 0 is written.
        """
        return sympy.Add(
            *[
                sympy.Float(float(size)) * beside * self.main**power * self.other**second
                for (beside, second), row in sums.items()
                for power, size in enumerate(row)
                if size
            ]
        )


def _sum_up(terms: Iterable[_Term], constants: np.ndarray, factor: tuple[int, int]) -> _Sums:
    """Add terms times a factor; the square of the second wave is 1 less that of the first."""
    found: _Sums = {}
    for term in terms:
        main, other = (a + b for a, b in zip(term.waves, factor, strict=True))
        pairs, second = divmod(other, 2)
        own = found.setdefault((term.beside, second), np.zeros(_POWERS))
        size = term.factor * (1.0 if term.place < 0 else float(constants[term.place]))
        for k in range(pairs + 1):
            own[main + 2 * k] += size * (-1) ** k * math.comb(pairs, k)
    return found


def read_ratio(expr: sympy.Expr) -> Ratio | None:
    """Read a formula as a fraction with one wave of an angle in the denominator; else None.

    >>> w, F = sympy.symbols("w F")
    >>> found = read_ratio((1.5 * F * sympy.cos(w) - 9.81 * sympy.sin(w)) / (2 - sympy.cos(w) ** 2))
    >>> found.main, found.degree, len(found.above)
    (sin(w), 2, 2)
    >>> read_ratio(F / (1 + F)) is None
    True
    """
    shape, values = free_constants(expr, "constant ")
    return _read_ratio(shape, tuple(values))


@lru_cache(maxsize=4096)
def _read_ratio(shape: sympy.Expr, constants: tuple[sympy.Symbol, ...]) -> Ratio | None:
    above, below = sympy.fraction(shape)
    angles = {wave.args[0] for wave in below.atoms(sympy.sin, sympy.cos)}
    angle = angles.pop() if len(angles) == 1 else sympy.S.Zero
    if not (below.is_Add and angle.is_Symbol):
        return None
    # Numbers that cancel by chance alone.
    probes = np.sqrt(np.arange(2.0, 2.0 + len(constants)))
    for waves in permutations((sympy.sin(angle), sympy.cos(angle))):
        top, bottom = (_read_terms(part, waves, constants) for part in (above, below))
        if not top or not bottom:
            return None
        sums = _sum_up(bottom, probes, (0, 0))
        if sums.keys() == {(sympy.S.One, 0)}:
            powers = np.flatnonzero(sums[sympy.S.One, 0]).tolist()
            if powers in ([0, 1], [0, 2]):
                return Ratio(waves[0], waves[1], top, bottom, len(constants), powers[1])
    return None


def _read_terms(
    expr: sympy.Expr, waves: tuple[sympy.Expr, ...], constants: tuple[sympy.Symbol, ...]
) -> tuple[_Term, ...]:
    """Give the products of a sum; none where one is no product of a constant and powers."""
    found = []
    for term in sympy.Add.make_args(sympy.expand(expr)):
        number, body = term.as_coeff_Mul()
        powers = dict(body.as_powers_dict())
        main, other = (powers.pop(wave, sympy.S.Zero) for wave in waves)
        places = [constants.index(base) for base in powers if base in constants]
        beside = sympy.Mul(*[b**power for b, power in powers.items() if b not in constants])
        plain = all(power.is_Integer and 0 <= power <= _LARGEST for power in (main, other))
        if len(places) > 1 or not plain or beside.free_symbols & set(constants):
            return ()
        if places and powers[constants[places[0]]] != 1:
            return ()
        place = places[0] if places else -1
        found.append(_Term(place, float(number), beside, (int(main), int(other))))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Coupling:
    """An equation said by the left side of another one.

    Parameters
    ----------
    state : whose equation it is.
    expr : what it is; the other's left side is a symbol of its own.
    constants, errors : the numbers in it with their standard errors.
    loss : bits that the data lose where it holds strictly.
    """

    state: str
    expr: sympy.Expr
    constants: np.ndarray
    errors: np.ndarray
    loss: float


def find_couplings(
    exprs: Mapping[str, sympy.Expr], constants: np.ndarray, covariance: np.ndarray
) -> Iterator[Coupling]:
    """Give the equations of a fitted system that become short with another of the same denominator.

    The covariance shows whether the rest over the denominator is error alone (Wald).

    Parameters
    ----------
    exprs : state -> equation with its constants.
    constants, covariance : (P,) and (P, P), in the order of the states and of their appearance.
    """
    ratios = {state: read_ratio(expr) for state, expr in exprs.items()}
    if sum(ratio is not None for ratio in ratios.values()) < 2:
        return
    owned = _places(exprs, constants)
    for state, by in permutations(exprs, 2):
        own, other = ratios[state], ratios[by]
        if own is None or other is None or (own.main, own.degree) != (other.main, other.degree):
            continue
        places = owned[state] + owned[by]
        for factor in FACTORS:
            tie = _Tie(own, other, factor)
            with np.errstate(all="ignore"):
                found = tie.solve(constants[places], covariance[np.ix_(places, places)])
            if found is not None:
                size, sums, errors, loss = found
                wave = own.main ** factor[0] * own.other ** factor[1]
                expr = sympy.Float(size) * wave * slope_of(by) + own.write(sums)
                sizes = [size, *(v for row in sums.values() for v in row if v)]
                yield Coupling(state, expr, np.array(sizes), errors, loss)


def _places(exprs: Mapping[str, sympy.Expr], constants: np.ndarray) -> dict[str, list[int]]:
    """Give the places of each equation's constants, in their order there.

    Values that were put in may change the order of the terms.
    """
    found: dict[str, list[int]] = {}
    first = 0
    for state, expr in exprs.items():
        values = np.array(list(free_constants(expr, "c")[1].values()))
        apart = np.abs(values[:, None] - constants[first : first + len(values)])
        found[state] = (first + linear_sum_assignment(apart)[1]).tolist()
        first += len(values)
    return found


def slope_of(state: str) -> sympy.Symbol:
    """Give what stands for the left side of an equation."""
    return sympy.Symbol(f"slope of {state}")


@dataclass(frozen=True)
class _Tie:
    """A ratio less a multiple of another one, in the constants of both."""

    own: Ratio
    other: Ratio
    factor: tuple[int, int]

    def _divide(self, constants: np.ndarray) -> tuple[tuple[_Sums, _Sums], tuple[_Sums, _Sums]]:
        mine, others = np.split(constants, [self.own.constants])
        return self.own.divide(mine, (0, 0)), self.other.divide(others, self.factor)

    def _numbers(self, constants: np.ndarray, keys: list[tuple[sympy.Expr, int]]) -> np.ndarray:
        """(2, k, 2, 12): of both ratios by keys, what comes out even and the rest.

        The rest of the constant power 11 of the first key, which no law has, holds by how much
        the lines differ.
        """
        none = np.zeros(_POWERS)
        found = np.array(
            [
                [[part.get(key, none) for part in parts] for key in keys]
                for parts in self._divide(constants)
            ]
        )
        mine, others = np.split(constants, [self.own.constants])
        lines = [first / last for first, last in (self.own.line(mine), self.other.line(others))]
        found[0, 0, 1, -1] = lines[0] - lines[1]
        return found

    def solve(
        self, constants: np.ndarray, covariance: np.ndarray
    ) -> tuple[float, _Sums, np.ndarray, float] | None:
        """Give the multiple, the sum added to it, the errors of both and the bits that are lost."""
        if not np.all(np.isfinite(covariance)):
            return None
        divided = self._divide(constants)
        keys = list(dict.fromkeys([*divided[0][0], *divided[1][0]]))
        mine = constants[: self.own.constants]
        steps = 1e-6 * np.maximum(np.abs(constants), 1e-3)
        here = self._numbers(constants, keys)
        beside = [
            (self._numbers(constants + h, keys) - self._numbers(constants - h, keys))
            for h in np.diag(steps)
        ]
        by = np.moveaxis(np.array(beside) / (2 * steps[:, None, None, None, None]), 0, -1)
        rest, rest_by = here[:, :, 1].reshape(2, -1), by[:, :, 1].reshape(2, -1, len(steps))
        told = np.any(rest_by != 0, axis=(0, 2))
        if not (np.all(np.isfinite(here)) and np.all(np.isfinite(by))):
            return None
        if np.any(rest[0, ~told]) or np.any(rest[1, ~told]) or not rest[0] @ rest[1]:
            return None
        rest, rest_by = rest[:, told], rest_by[:, told]
        size = float(rest[0] @ rest[1] / (rest[1] @ rest[1]))
        for _ in range(2):
            slopes = rest_by[0] - size * rest_by[1]
            inverse = _invert(slopes @ covariance @ slopes.T, np.abs(rest).max(axis=0))
            weights = inverse @ rest[1] / (rest[1] @ inverse @ rest[1])
            size = float(weights @ rest[0])
        left = rest[0] - size * rest[1]
        loss = shift_bits(math.sqrt(max(float(left @ inverse @ left), 0.0)))
        if not loss < _BROKEN or self._superfluous(
            here[0, :, 1] - size * here[1, :, 1], mine, keys
        ):
            return None
        even, even_by = here[:, :, 0].reshape(2, -1), by[:, :, 0].reshape(2, -1, len(steps))
        sums = even[0] - size * even[1]
        sums[np.abs(sums) <= _CANCELLED * np.abs(even).max(axis=0)] = 0.0
        moved = weights @ slopes
        even_slopes = even_by[0] - size * even_by[1] - np.outer(even[1], moved)
        both = np.concatenate([moved[None], even_slopes[sums != 0]])
        errors = np.sqrt(np.maximum(np.einsum("ap,pq,aq->a", both, covariance, both), 0.0))
        return size, dict(zip(keys, sums.reshape(len(keys), -1), strict=True)), errors, loss

    def _superfluous(
        self, left: np.ndarray, constants: np.ndarray, keys: Sequence[tuple[sympy.Expr, int]]
    ) -> bool:
        """Whether the rest (k, 12) over the denominator is mostly a term of the ratio."""
        last = self.own.line(constants)[1]
        own = _sum_up(self.own.above, constants, (0, 0))
        rows = np.array([own.get(key, np.zeros(_POWERS)) for key in keys]) / last
        return bool(np.any((rows != 0) & (2 * np.abs(left) > np.abs(rows))))


def _invert(covariance: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Invert the covariance of numbers of some sizes, which are rounded at least."""
    units = np.maximum(np.sqrt(np.maximum(np.diag(covariance), 0.0)), SINGULAR * sizes)
    both = np.outer(units, units)
    # What cannot be otherwise has next to no variance, not none.
    return np.asarray(np.linalg.inv(covariance / both + SINGULAR * np.eye(len(units))) / both)
