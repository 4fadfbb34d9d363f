"""From functions that the screen or the Gram matrices picked to formulas with all their constants.

Here, and only here, all rows are looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
import sympy

from dynsr.methods.feynman.bank import Bank
from dynsr.methods.feynman.fitting import fit_robustly
from dynsr.methods.feynman.pool import Found, measure
from dynsr.methods.feynman.problem import Problem

# What a fitted constant and a change of the target count in letters.
_CONSTANT, _CHANGE = 4.0, 2.0
_SNAP = 0.02
Write = Callable[[], sympy.Expr]


class Finisher:
    """Fits the constants of chosen functions of a bank to a problem on all rows."""

    def __init__(self, bank: Bank, X: np.ndarray, y: np.ndarray) -> None:
        self.bank, self.X, self.y = bank, X, y
        self._values: dict[int, np.ndarray] = {}

    def finish(self, problem: Problem, groups: Sequence[tuple[int, ...]]) -> list[Found | None]:
        """Give formulas for groups of equally many function numbers."""
        if not groups:
            return []
        values = np.empty((len(groups), len(groups[0]), len(self.y)))
        for k, group in enumerate(groups):
            for place, number in enumerate(group):
                values[k, place] = self._evaluate(number)
        features = problem.feature(values)
        good = np.isfinite(features).all(axis=(1, 2))
        kept = [group for group, fine in zip(groups, good, strict=True) if fine]
        if not kept:
            return []
        if problem.target.change.name == "log" and (problem.by_log or problem.powers):
            return self._finish_products(problem, kept, values[good], features[good])
        return self._finish_sums(problem, kept, features[good])

    def _evaluate(self, number: int) -> np.ndarray:
        if number not in self._values:
            self._values[number] = self.bank.evaluate(number, self.X)
        return self._values[number]

    def _finish_sums(
        self, problem: Problem, groups: list[tuple[int, ...]], features: np.ndarray
    ) -> list[Found | None]:
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
        for coefficients in forms:
            predicted = np.einsum("kni,ki->kn", design, coefficients)
            for group, numbers, z_fit in zip(groups, coefficients, predicted, strict=True):
                found.append(self._sum(problem, group, numbers, z_fit))
        return found

    def _sum(
        self, problem: Problem, group: tuple[int, ...], numbers: np.ndarray, fitted: np.ndarray
    ) -> Found | None:
        constants = np.count_nonzero((numbers != 0) & (numbers != 1))
        size = sum(self.bank.size(f) + 1.0 for f in group) + _CONSTANT * constants
        size += _CHANGE * (problem.name != "y")

        def write() -> sympy.Expr:
            terms = [
                _number(c) * self.bank.expression(f)
                for f, c in zip(group, numbers[1:], strict=True)
            ]
            return problem.target.build(sympy.Add(*terms, _number(numbers[0])))

        return measure(problem.target.invert(fitted), self.y, size, write)

    def _finish_products(
        self,
        problem: Problem,
        groups: list[tuple[int, ...]],
        values: np.ndarray,
        features: np.ndarray,
    ) -> list[Found | None]:
        """y = C prod |x|^a prod f^b, or C prod |x|^a exp(sum b f), exponents as fitted and snapped."""
        n = len(self.y)
        logs = np.broadcast_to(problem.logs, (len(groups), n, problem.logs.shape[1]))
        ones = np.ones((len(groups), n, 1))
        design = np.concatenate([ones, logs, features.transpose(0, 2, 1)], axis=2)
        scales, z = problem.target.weights, problem.target.values
        fitted = fit_robustly(design, z, scales)
        k = 1 + len(problem.powers)
        found: list[Found | None] = []
        for group, numbers, inside in zip(groups, fitted, values, strict=True):
            for snap in (True, False):
                powers = [_snap(a) if snap else sympy.Float(a) for a in numbers[1:k]]
                if problem.by_log:
                    inner = [_snap(b) if snap else sympy.Float(b) for b in numbers[k:]]
                    found.append(self._product(problem, powers, group, inner, inside))
                else:
                    rates = numbers[k:]
                    if snap:
                        shown = np.array([float(a) for a in powers])
                        left = np.concatenate([ones[0], inside.T], axis=1)[None]
                        rates = fit_robustly(left, z - problem.logs @ shown, scales)[0, 1:]
                    found.append(self._exponential(problem, powers, group, rates, inside))
        return found

    def _product(
        self,
        problem: Problem,
        powers: list[sympy.Expr],
        group: tuple[int, ...],
        inner: list[sympy.Expr],
        inside: np.ndarray,
    ) -> Found | None:
        columns = [self.X[:, j] for j in problem.powers]
        predicted = np.ones(len(self.y))
        for base, power in zip((*columns, *inside), (*powers, *inner), strict=True):
            predicted = predicted * _raise(base, power)

        def write() -> sympy.Expr:
            inner_parts = [
                _write_power(self.bank.expression(f), v, b)
                for f, v, b in zip(group, inside, inner, strict=True)
            ]
            return sympy.Mul(*self._write_powers(problem, powers), *inner_parts)

        letters = sum(self.bank.size(f) for f in group) + _price([*powers, *inner])
        return self._scaled(predicted, letters, write)

    def _exponential(
        self,
        problem: Problem,
        powers: list[sympy.Expr],
        group: tuple[int, ...],
        rates: np.ndarray,
        inside: np.ndarray,
    ) -> Found | None:
        with np.errstate(all="ignore"):
            predicted = np.exp(rates @ inside)
        for j, power in zip(problem.powers, powers, strict=True):
            predicted = predicted * _raise(self.X[:, j], power)

        def write() -> sympy.Expr:
            terms = [
                sympy.Float(b) * self.bank.expression(f) for f, b in zip(group, rates, strict=True)
            ]
            return sympy.Mul(*self._write_powers(problem, powers), sympy.exp(sympy.Add(*terms)))

        letters = sum(self.bank.size(f) + 1 + _CONSTANT for f in group) + _price(powers)
        return self._scaled(predicted, letters, write)

    def _scaled(self, predicted: np.ndarray, letters: float, write: Write) -> Found | None:
        """Fit the factor C of y = C predicted."""
        if not np.isfinite(predicted).all() or not predicted.any():
            return None
        factor = fit_robustly(predicted[None, :, None], self.y, np.ones(len(self.y)))[0, 0]
        return measure(
            factor * predicted, self.y, letters + _CONSTANT, lambda: _number(factor) * write()
        )

    def _write_powers(self, problem: Problem, powers: list[sympy.Expr]) -> list[sympy.Expr]:
        return [
            _write_power(self.bank.leaves[j], self.X[:, j], power)
            for j, power in zip(problem.powers, powers, strict=True)
        ]


def _number(value: float) -> sympy.Expr:
    return sympy.Integer(int(value)) if value in (0, 1) else sympy.Float(float(value))


def _snap(value: float) -> sympy.Expr:
    """Give the nearest multiple of 1/2 or 1/3 when it is close, the number itself when not."""
    near = min((Fraction(round(value * q), q) for q in (1, 2, 3)), key=lambda f: abs(f - value))
    if abs(float(near) - value) < _SNAP:
        return sympy.Rational(near.numerator, near.denominator)
    return sympy.Float(value)


def _raise(base: np.ndarray, power: sympy.Expr) -> np.ndarray:
    """base^power; of -base for a fraction of a negative base; NaN where the sign is mixed."""
    exponent = float(power)
    with np.errstate(all="ignore"):
        if power.is_Integer or not (base < 0).any():
            return base**exponent
        return (-base) ** exponent


def _write_power(base: sympy.Expr, values: np.ndarray, power: sympy.Expr) -> sympy.Expr:
    return base**power if power.is_Integer or not (values < 0).any() else (-base) ** power


def _price(powers: list[sympy.Expr]) -> float:
    """Letters that exponents cost: none for 0, two for 1, three for another simple number."""
    prices = {True: 0.0, False: 3.0}
    return sum(
        3.0 + _CONSTANT if p.is_Float else 2.0 if abs(p) == 1 else prices[p == 0] for p in powers
    )
