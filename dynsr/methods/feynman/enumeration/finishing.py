"""From functions that the screen or the Gram matrices picked to formulas with all their constants.

Formulas found so far are pooled with their errors on all rows and written out only at the end.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial

import numpy as np
import sympy

from dynsr.expression import REAL_RESOLUTION, complexity
from dynsr.fit import Candidate, Noise, data_bits, fit_robustly, mean_error_bits
from dynsr.methods.feynman.enumeration.bank import Bank
from dynsr.methods.feynman.problem import Problem

Writer = Callable[[], sympy.Expr]


@dataclass(frozen=True)
class Finishing:
    """How chosen functions become formulas, and which formulas are kept.

    Parameters
    ----------
    kept : formulas of fewest error bits that are kept in addition to the Pareto fronts.
    each : formulas of one fit that are looked at: so many of fewest error bits, and of least RMSE.
    letter_bits : bits of a letter in a formula's code of k log2(n) bits
        (:func:`dynsr.expression.complexity`), for n = 64 kinds: an upper bound that needs
        no formula written out.
    constant_letters : what a fitted constant counts in letters.
    change_letters : what a change of the target counts in letters.
    snap : an exponent this close to a multiple of 1/2 or 1/3 is that multiple.
    few_rows : many functions are compared on so many rows before some are fitted on all.
    first : how many those are: so many of fewest error bits, and of least RMSE.
    """

    kept: int = 24
    each: int = 4
    letter_bits: float = 6.0
    constant_letters: float = 4.0
    change_letters: float = 2.0
    snap: float = 0.02
    few_rows: int = 200
    first: int = 4


@dataclass(frozen=True, eq=False)
class Found:
    """A formula: its ``size`` in letters, the error ``bits`` a row, its RMSE, and how to write it.

    bits = mean log2(1 + |r| / (2^-30 size of y)), which a few bad rows do not decide (Udrescu et
    al. 2020, eq. 5).
    """

    size: float
    bits: float
    loss: float
    residual: np.ndarray
    write: Writer

    def resembles(self, other: Found | None) -> bool:
        """Whether another is as long and differs by less than half of the residuals."""
        if other is None or other.size != self.size:
            return False
        apart = np.median(np.abs(self.residual - other.residual))
        return bool(apart <= 0.5 * np.median(np.abs(self.residual)))


def measure(
    predicted: np.ndarray,
    y: np.ndarray,
    write: Callable[[int], tuple[float, Writer]],
    each: int,
) -> list[Found]:
    """Make Founds of the best rows of (K, n) predictions at all samples.

    Best are the ``each`` of least bits and those of least RMSE. ``write(k)`` gives size and
    writer of row k.
    """
    with np.errstate(all="ignore"):
        residuals = y - predicted
        losses = np.sqrt(np.einsum("kn,kn->k", residuals, residuals) / len(y))
        scale = REAL_RESOLUTION * (float(np.sqrt(np.mean(y * y))) or 1.0)
        bits = mean_error_bits(residuals, scale)
    finite = np.flatnonzero(np.isfinite(losses) & np.isfinite(bits))
    best = [finite[np.argsort(error[finite], kind="stable")[:each]] for error in (bits, losses)]
    found = []
    for k in np.unique(np.concatenate(best)):
        size, writer = write(int(k))
        found.append(Found(size, float(bits[k]), float(losses[k]), residuals[k].copy(), writer))
    return found


class Pool:
    """Formulas that nothing beats in size and bits, or in size and RMSE, and the best in bits."""

    def __init__(self, settings: Finishing) -> None:
        """Start empty."""
        self.settings = settings
        self.found: list[Found] = []

    def add(self, found: Iterable[Found]) -> None:
        """Take formulas in and drop what is not worth keeping."""
        everything = [*self.found, *found]
        by_bits = sorted(everything, key=lambda f: (f.bits, f.size))[: self.settings.kept]
        kept = [*_front(everything, "bits"), *_front(everything, "loss"), *by_bits]
        chosen = {id(f) for f in kept}
        self.found = [f for f in everything if id(f) in chosen]

    @property
    def best(self) -> Found | None:
        """The formula of fewest error bits."""
        return min(self.found, key=lambda f: (f.bits, f.size), default=None)

    @property
    def shortest(self) -> Found | None:
        """The formula of least description length, letters counted at ``letter_bits`` bits.

        The noise floor is the least median residual of all, and every row counts.
        """
        floor = min((float(np.median(np.abs(f.residual))) for f in self.found), default=0.0)
        return min(
            self.found,
            key=lambda f: (
                data_bits(f.residual, Noise(floor or 1e-300, len(f.residual)))
                + self.settings.letter_bits * f.size
            ),
            default=None,
        )

    def candidates(self, source: str) -> list[Candidate]:
        """Write the formulas out, simplest first, equal ones once."""
        written: dict[sympy.Expr, Candidate] = {}
        for found in sorted(self.found, key=lambda f: (f.size, f.bits)):
            expr = found.write()
            if expr not in written and not expr.has(sympy.zoo, sympy.nan, sympy.oo, sympy.I):
                written[expr] = Candidate(expr, found.loss, complexity(expr), source)
        return list(written.values())


def _front(found: list[Found], error: str) -> list[Found]:
    kept: list[Found] = []
    for one in sorted(found, key=lambda f: (f.size, getattr(f, error))):
        if not kept or getattr(one, error) < getattr(kept[-1], error):
            kept.append(one)
    return kept


# A term of a sum below this part of the largest is rounding.
_NOTHING = 1e-11


class Finisher:
    """Fits the constants of chosen functions of a bank to a problem on all rows."""

    def __init__(
        self,
        bank: Bank,
        X: np.ndarray,
        y: np.ndarray,
        settings: Finishing,
        law: tuple[np.ndarray, Sequence[sympy.Expr]] | None = None,
    ) -> None:
        """Take the bank and all rows, (n, p) and (n,).

        ``law`` holds values and symbols of the variables whose powers problems have in their
        background, where those are not the bank's.
        """
        self.bank, self.X, self.y, self.settings = bank, X, y, settings
        self._law, self._symbols = law or (X, bank.leaves)
        self._values: dict[int, np.ndarray] = {}

    def finish(self, problem: Problem, groups: Sequence[tuple[int, ...]]) -> list[Found]:
        """Give formulas for groups of equally many function numbers."""
        if not groups:
            return []
        values = np.empty((len(groups), len(groups[0]), len(self.y)))
        for k, group in enumerate(groups):
            for place, number in enumerate(group):
                values[k, place] = self._evaluate(number)
        features = problem.feature(values)
        good = np.isfinite(features).all(axis=(1, 2))
        chosen = np.flatnonzero(good)
        if len(chosen) > 2 * self.settings.first:
            chosen = chosen[_most_promising(problem, features[chosen], self.settings)]
        if not len(chosen):
            return []
        kept = [groups[int(k)] for k in chosen]
        if problem.target.change.name == "log" and (problem.by_log or problem.powers):
            return self._finish_products(problem, kept, values[chosen], features[chosen])
        return self._finish_sums(problem, kept, features[chosen])

    def _evaluate(self, number: int) -> np.ndarray:
        if number not in self._values:
            self._values[number] = self.bank.evaluate(number, self.X)
        return self._values[number]

    def _finish_sums(
        self, problem: Problem, groups: list[tuple[int, ...]], features: np.ndarray
    ) -> list[Found]:
        """T(y) = sum c_i f_i + d, the same with d = 0, and for one function with c = 1."""
        design = np.concatenate([np.ones((len(groups), 1, len(self.y))), features], axis=1)
        design = design.transpose(0, 2, 1)
        scales, z = problem.target.weights, problem.target.values
        full = fit_robustly(design, z, scales)
        forms = [full]
        if features.shape[1]:
            bare = fit_robustly(design[:, :, 1:], z, scales)
            forms.append(np.column_stack([np.zeros(len(bare)), bare]))
        if features.shape[1] == 1:
            one = np.ones(len(full))
            shift = fit_robustly(design[:, :, :1], z - features[:, 0], scales)[:, 0]
            forms += [np.column_stack([shift, one]), np.column_stack([0 * one, one])]
        found = []
        for numbers in forms:
            size = np.abs(numbers) * np.sqrt(np.einsum("kni,kni->ki", design, design))
            numbers = np.where(size > _NOTHING * size.max(axis=1, keepdims=True), numbers, 0.0)
            fitted = np.einsum("kni,ki->kn", design, numbers)
            write = partial(self._sum, problem, groups, numbers)
            found += measure(problem.target.invert(fitted), self.y, write, self.settings.each)
        return found

    def _sum(
        self, problem: Problem, groups: list[tuple[int, ...]], numbers: np.ndarray, k: int
    ) -> tuple[float, Writer]:
        group, constants = groups[k], numbers[k]
        prices = self.settings
        size = sum(self.bank.size(f) + 1.0 for f in group)
        size += prices.change_letters * (problem.name != "y")
        size += prices.constant_letters * np.count_nonzero((constants != 0) & (constants != 1))

        def write() -> sympy.Expr:
            functions = map(self.bank.expression, group)
            terms = [_number(c) * f for c, f in zip(constants[1:], functions, strict=True)]
            return problem.target.build(sympy.Add(*terms, _number(constants[0])))

        return size, write

    def _finish_products(
        self,
        problem: Problem,
        groups: list[tuple[int, ...]],
        values: np.ndarray,
        features: np.ndarray,
    ) -> list[Found]:
        """y = C prod x^a prod f^b, or C prod x^a exp(sum b f), exponents as fitted and snapped."""
        logs = np.broadcast_to(problem.logs, (len(groups), *problem.logs.shape))
        ones = np.ones((*logs.shape[:2], 1))
        inside = features.transpose(0, 2, 1)
        scales, z = problem.target.weights, problem.target.values
        fitted = fit_robustly(np.concatenate([ones, logs, inside], axis=2), z, scales)[:, 1:]
        split = len(problem.powers)
        found: list[Found] = []
        done = fitted[:0]
        for snap in (True, False):
            numbers = (
                snap_all(fitted, len(fitted.T) if problem.by_log else split, self.settings.snap)
                if snap
                else fitted
            )
            if snap and not problem.by_log:
                left = z - numbers[:, :split] @ problem.logs.T
                rates = fit_robustly(np.concatenate([ones, inside], axis=2), left, scales)
                numbers = np.concatenate([numbers[:, :split], rates[:, 1:]], axis=1)
            elif not snap and np.array_equal(numbers, done):
                break
            done = numbers
            found += self._products(problem, groups, values, features, numbers)
        return found

    def _products(
        self,
        problem: Problem,
        groups: list[tuple[int, ...]],
        values: np.ndarray,
        features: np.ndarray,
        numbers: np.ndarray,
    ) -> list[Found]:
        """Formulas with given exponents; the factor C of each is fitted."""
        split = len(problem.powers)
        exponents, inner = numbers[:, :split], numbers[:, split:]
        with np.errstate(all="ignore"):
            predicted = np.exp(
                exponents @ problem.logs.T + np.einsum("kmn,km->kn", features, inner)
            )
            for place, column in enumerate(problem.powers):
                predicted *= signs_of(self._law[:, column], exponents[:, place])
            if problem.by_log:
                for k in range(len(groups)):
                    for v, b in zip(values[k], inner[k], strict=True):
                        predicted[k] *= signs_of(v, np.array([b]))[0]
        good = np.isfinite(predicted).all(axis=1) & predicted.any(axis=1)
        if not good.any():
            return []
        factors = np.full(len(groups), np.nan)
        design = predicted[good][:, :, None]
        factors[good] = fit_robustly(design, self.y, np.ones(len(self.y)))[:, 0]
        write = partial(self._product, problem, groups, values, numbers, factors)
        return measure(factors[:, None] * predicted, self.y, write, self.settings.each)

    def _product(
        self,
        problem: Problem,
        groups: list[tuple[int, ...]],
        values: np.ndarray,
        numbers: np.ndarray,
        factors: np.ndarray,
        k: int,
    ) -> tuple[float, Writer]:
        split = len(problem.powers)
        powers = [as_power(a) for a in numbers[k, :split]]
        inner = [as_power(b) if problem.by_log else sympy.Float(b) for b in numbers[k, split:]]
        constant = self.settings.constant_letters
        size = sum(self.bank.size(f) for f in groups[k]) + constant
        size += _price([*powers, *inner], constant)

        def write() -> sympy.Expr:
            functions = [self.bank.expression(f) for f in groups[k]]
            if problem.by_log:
                parts = [*map(write_power, functions, values[k], inner)]
            else:
                parts = [sympy.exp(sympy.Add(*map(operator.mul, inner, functions)))]
            return sympy.Mul(_number(factors[k]), *self._write_powers(problem, powers), *parts)

        return size, write

    def _write_powers(self, problem: Problem, powers: list[sympy.Expr]) -> list[sympy.Expr]:
        return [
            write_power(self._symbols[j], self._law[:, j], power)
            for j, power in zip(problem.powers, powers, strict=True)
        ]


def _most_promising(problem: Problem, features: np.ndarray, settings: Finishing) -> np.ndarray:
    """Places of the ``first`` of least error bits and those of least RMSE on some rows."""
    few = slice(None, None, max(1, features.shape[2] // settings.few_rows))
    logs = np.broadcast_to(problem.background[few], (len(features), *problem.background[few].shape))
    design = np.concatenate([logs, features[:, :, few].transpose(0, 2, 1)], axis=2)
    scales, z = problem.target.weights[few], problem.target.values[few]
    fitted = fit_robustly(design, z, scales)
    rest = np.abs(z - (design @ fitted[:, :, None])[:, :, 0]) * scales
    size = REAL_RESOLUTION * (float(np.sqrt(np.mean((z * scales) ** 2))) or 1.0)
    errors = mean_error_bits(rest, size), np.square(rest).mean(axis=1)
    return np.unique([np.argsort(error, kind="stable")[: settings.first] for error in errors])


def _number(value: float) -> sympy.Expr:
    return sympy.Integer(int(value)) if value in (0, 1) else sympy.Float(float(value))


def snap_all(numbers: np.ndarray, columns: int, near_enough: float) -> np.ndarray:
    """Bring numbers of the first columns to a multiple of 1/2 or 1/3 where one is close."""
    snapped = numbers.copy()
    steps = np.array([1.0, 2.0, 3.0])
    near = np.round(numbers[:, :columns, None] * steps) / steps
    distance = np.abs(near - numbers[:, :columns, None])
    best = np.argmin(distance - 1e-9 / steps, axis=2)[:, :, None]
    close = np.take_along_axis(distance, best, axis=2)[:, :, 0] < near_enough
    snapped[:, :columns] = np.where(
        close, np.take_along_axis(near, best, axis=2)[:, :, 0], numbers[:, :columns]
    )
    return snapped


def as_power(value: float) -> sympy.Expr:
    """A multiple of 1/2 or 1/3 as the rational it is; a float otherwise."""
    near = Fraction(float(value)).limit_denominator(3)
    if abs(float(near) - value) < 1e-12:
        return sympy.Rational(near.numerator, near.denominator)
    return sympy.Float(float(value))


def signs_of(base: np.ndarray, exponents: np.ndarray) -> np.ndarray:
    """(k, n) signs of base^exponent: NaN for a fraction of a base of mixed sign.

    A base that is negative throughout counts as -base under a fraction.
    """
    negative = base < 0
    if not negative.any():
        return np.ones((len(exponents), 1))
    whole = np.abs(exponents - np.round(exponents)) < 1e-12
    odd = whole & (np.round(exponents) % 2 == 1)
    signs = np.where(negative & odd[:, None], -1.0, 1.0)
    return signs if negative.all() else np.where(whole[:, None], signs, np.nan)


def write_power(base: sympy.Expr, values: np.ndarray, power: sympy.Expr) -> sympy.Expr:
    """base^power, or (-base)^power for a fraction of a negative base."""
    return base**power if power.is_Integer or not (values < 0).any() else (-base) ** power


def _price(powers: list[sympy.Expr], constant: float) -> float:
    """Letters that exponents cost: none for 0, two for 1, three for another simple number."""
    prices = {True: 0.0, False: 3.0}
    return sum(
        3.0 + constant if p.is_Float else 2.0 if abs(p) == 1 else prices[p == 0] for p in powers
    )
