"""Likeness: sums of a wide term and plain ones that are like a function, along known states."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy
from scipy import optimize

from dynsr.expression import compile_columns, lines_below
from dynsr.fit import free_constants
from dynsr.selection.costs import citing_bits, shape_bits
from dynsr.selection.subsets import best_subsets
from dynsr.selection.terms import Terms, degree_of, weighted_sum
from dynsr.selection.wide import DRAFTED, LARGEST, WideTerms

# Plain terms that may stand beside a wide one, and wide ones without a constant inside.
_PLAIN, _FIXED = 40, 40
# Wide terms of each kind that are looked at closely, terms beside one at most, sums of each number
# of terms that go on to more, and numbers of terms that are given.
_LIKEST, _BESIDE, _BEAM, _EACH = 8, 3, 8, 3
# Evaluations for each constant at most where constants are fitted; misses, in units of the largest
# value, that count as no larger.
_TRIES, _WILD = 12, 1e3
# Subsets that are asked for: all that there are.
_ALL = 10_000
# Misses, as a share of the spread, below which sums are alike, and how many of the shortest such
# sums are given.
ALIKE = ((0.01, 48), (0.001, 16))


@dataclass(frozen=True, eq=False)
class _Offered:
    """A term that sums are built on, its values and slopes (c, n) by what moves, and its bits."""

    expr: sympy.Expr
    block: np.ndarray
    bits: float


@dataclass(frozen=True, eq=False)
class Likeness:
    """Sums of terms are looked for that are like functions of the columns.

    Parameters
    ----------
    terms, wide : plain terms, and wide ones.
    names, points : columns that a sum may hold, and their values (names, n).
    each : bits of a constant.
    allow : whether a term may be used.
    alike : misses, as a share of the spread, below which sums are alike, and how many of the
        shortest such sums are given.
    drafted : how many wide terms have their constants moved, as for :meth:`WideTerms.likest`.
    fixed : wide terms without a constant inside that may stand beside others.
    """

    terms: Terms
    wide: WideTerms
    names: Sequence[str]
    points: np.ndarray
    each: float
    allow: Callable[[sympy.Expr], bool]
    alike: Sequence[tuple[float, int]] = ALIKE
    drafted: int = DRAFTED
    fixed: int = _FIXED

    def wide_sums(
        self, columns: np.ndarray, target: np.ndarray, most: float
    ) -> list[tuple[sympy.Expr, float]]:
        """Give sums with a wide term that are like a function, the likest first, with their bits.

        Parameters
        ----------
        columns : values of the wide terms, and their slopes, :meth:`WideTerms.values`.
        target : (n,) values of the function.
        most : bits of a sum at most.
        """
        if not _tells(target):
            return []
        said, (exprs, _, beside) = self._said, self._plain
        degrees = np.array([degree_of(e, self.terms.names) for e in exprs])
        others = [beside[degrees <= degree] for degree in (-1, 1, 2)]
        points = self.points[: len(self.wide.names)]
        fits = said < most
        likest = self.wide.likest(columns, target, others, fits, _LIKEST, points, self.drafted)
        offered = [
            _Offered(self.wide.write(one.place, one.constants), one.block, float(said[one.place]))
            for one in likest
        ]
        offered.append(_Offered(sympy.S.One, np.ones((1, len(target))), self.each))
        return self._around(offered, target, most)

    def fitted(self, expr: sympy.Expr, target: np.ndarray) -> sympy.Expr:
        """Give a sum the constants, those inside too, that make it most like a function.

        Parameters
        ----------
        expr : the sum.
        target : (n,) values of the function.
        """
        return fit_to(expr, dict(zip(self.names, self.points, strict=True)), target)

    @cached_property
    def _said(self) -> np.ndarray:
        """(p,) bits of the wide terms and their constants."""
        wide = self.wide
        return np.asarray(self.terms.bits[0] + wide.costs + self.each * (1 + wide.inside))

    @cached_property
    def _plain(self) -> tuple[list[sympy.Expr], np.ndarray, np.ndarray]:
        """Terms without a constant inside, their bits (p,) and values (p, n)."""
        terms, wide = self.terms, self.wide
        plain = [i for i in np.flatnonzero(terms.inside == 0) if self.allow(terms.exprs[i])]
        fixed = [i for i in np.flatnonzero(wide.inside == 0).tolist() if self.allow(wide.write(i))]
        fixed = sorted(fixed, key=lambda i: self._said[i])[: self.fixed]
        exprs = [*(terms.exprs[i] for i in plain[:_PLAIN]), *map(wide.write, fixed)]
        costs = np.concatenate([terms.bits[plain[:_PLAIN]] + self.each, self._said[fixed]])
        values = compile_columns(exprs, self.names)(*self.points)
        usable = np.all(np.isfinite(values), axis=1)
        values[~usable] = 0.0
        return exprs, np.where(usable, costs, np.inf), values

    def _around(
        self, offered: Sequence[_Offered], target: np.ndarray, most: float
    ) -> list[tuple[sympy.Expr, float]]:
        """Give sums of each of some terms and of what does best beside it, the likest first."""
        if not _tells(target):
            return []
        exprs, costs, beside = self._plain
        found: list[list[tuple[float, int, tuple[int, ...], float]]] = [[] for _ in self.alike]
        for number, one in enumerate(offered):
            if self.allow(one.expr):
                fits = np.where(one.bits + costs < most, costs, np.inf)
                near = _beside(one, beside, fits, target, [share for share, _ in self.alike])
                for own, likely in zip(found, near, strict=True):
                    for bits, places in likely:
                        cost = one.bits + float(costs[list(places)].sum())
                        if cost < most:
                            own.append((bits + one.bits, number, places, cost))
        given = {
            (number, places): cost
            for own, (_, count) in zip(found, self.alike, strict=True)
            for _, number, places, cost in sorted(own)[:count]
        }
        return [
            (_sum(offered[number], [exprs[i] for i in places], beside[list(places)], target), cost)
            for (number, places), cost in given.items()
        ]


def cited_terms(
    written: Sequence[sympy.Expr], names: Sequence[str], above: Sequence[sympy.Expr]
) -> dict[sympy.Expr, float]:
    """Give terms that are written already, and others over their lines, with their bits.

    Parameters
    ----------
    written : terms of other equations.
    names : columns that a term may hold.
    above : what may stand above a line beside 1.

    >>> x, y = sympy.symbols("x y")
    >>> [str(term) for term in cited_terms([x * y / (x + 1.5)], ["x", "y"], [x])]
    ['x*y/(x + 1.5)', '1/(x + 1.5)', 'x/(x + 1.5)']
    """
    allowed = {*map(sympy.Symbol, names)}
    term = sympy.Float(0.5) * sympy.Symbol("term")
    found: dict[sympy.Expr, float] = {}
    for own in (t for t in written if t.free_symbols and t.free_symbols <= allowed):
        if citing_bits(own) > 0:
            found.setdefault(own, shape_bits(term))
        for line in lines_below(own):
            for over in (sympy.S.One, *above):
                found.setdefault(over / line, shape_bits(term / over))
    return found


def fit_to(expr: sympy.Expr, columns: Mapping[str, np.ndarray], target: np.ndarray) -> sympy.Expr:
    """Give a formula the constants, those inside too, that make it most like a function.

    Parameters
    ----------
    expr : the formula.
    columns : name -> (n,) values.
    target : (n,) values of the function.

    >>> x = np.linspace(0.0, 2.0, 50)
    >>> found = fit_to(sympy.sympify("1.5*exp(-0.8*x)"), {"x": x}, 2 * np.exp(-x))
    >>> sorted(round(float(a), 6) for a in found.atoms(sympy.Float))
    [-1.0, 2.0]
    """
    shape, values = free_constants(expr, "constant ")
    program = compile_columns([shape], [*columns, *map(str, values)])
    far = _WILD * float(np.max(np.abs(target)))

    def missed(constants: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            off = program(*columns.values(), *constants)[0] - target
        return np.clip(np.nan_to_num(off, nan=far, posinf=far, neginf=-far), -far, far)

    begun = np.array(list(values.values()))
    if not 0 < len(begun) <= len(target):
        return expr
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = optimize.leastsq(missed, begun, maxfev=_TRIES * (1 + len(begun)))[0]
    given = zip(values, map(sympy.Float, np.atleast_1d(found).tolist()), strict=True)
    return shape.xreplace(dict(given))


def _tells(target: np.ndarray) -> bool:
    """Whether the values of a function change, and have squares."""
    return bool(np.ptp(target) > 0 and np.max(np.abs(target)) < LARGEST)


def _beside(
    one: _Offered,
    beside: np.ndarray,
    costs: np.ndarray,
    target: np.ndarray,
    shares: Sequence[float],
) -> list[list[tuple[float, tuple[int, ...]]]]:
    """Give the terms that do best beside one whose constants inside are free, with their bits.

    They are given for each size of misses that are alike.
    """
    own = np.linalg.qr(one.block.T)[0]
    own = own[:, np.linalg.norm(one.block @ own, axis=0) > 0]
    rest, goal = beside - (beside @ own) @ own.T, target - own @ (own.T @ target)
    rows, left = float(len(target)), float(goal @ goal)
    least = [rows * (share * float(np.std(target))) ** 2 for share in shares]
    subsets = best_subsets(
        rest @ rest.T,
        rest @ goal,
        left,
        costs,
        rows,
        beam=_BEAM,
        most=_BESIDE,
        keep=_ALL,
        least=min(least),
    )
    sums = [((), left), *((s.places, s.squares) for s in subsets)]
    given = []
    for floor in least:
        found: dict[int, tuple[float, tuple[int, ...]]] = {}
        for places, squares in sums:
            bits = rows / 2 * float(np.log2(max(squares, floor) / rows))
            ranked = bits + float(costs[list(places)].sum()), places
            found[len(places)] = min(found.get(len(places), ranked), ranked)
        given.append(sorted(found.values())[:_EACH])
    return given


def _sum(
    one: _Offered, others: Sequence[sympy.Expr], beside: np.ndarray, target: np.ndarray
) -> sympy.Expr:
    """Give terms the coefficients that make their sum like a function."""
    values = np.linalg.lstsq(np.concatenate([one.block[:1], beside]).T, target, rcond=None)[0]
    return weighted_sum(values, [one.expr, *others])
