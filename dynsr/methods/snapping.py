"""Simple numbers for the constants of a formula, where the description length says so.

A constant is replaced by 0, an integer, a small rational or a short decimal, the other constants
are fitted again, and the formula with the fewest bits in all is kept (Udrescu et al. 2020,
section II.E, with the bits of :mod:`dynsr.methods.feynman.description`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import sympy

from dynsr.expression import compile_numpy, complexity, number_bits
from dynsr.methods.feynman.description import Noise, data_bits
from dynsr.methods.flow import free_constants
from dynsr.pareto import Candidate, score_candidate
from dynsr.samples import Samples

_LARGEST_DENOMINATOR = 12
_MOST_DIGITS = 6
_MOST_CONSTANTS = 12
_MOST_STEPS = 12
_MOST_TRIED = 4


def simple_numbers(value: float) -> list[sympy.Rational]:
    """Simple numbers near ``value``: 0, integers, small fractions and short decimals.

    >>> [str(n) for n in simple_numbers(2.6665)][:4]
    ['0', '3', '8/3', '27/10']
    """
    if not math.isfinite(value):
        return []
    near = [Fraction(0), Fraction(round(value))]
    near += [
        Fraction(round(value * q), q)
        for q in range(2, _LARGEST_DENOMINATOR + 1)
        if abs(value * q - round(value * q)) < 0.05 * q / _LARGEST_DENOMINATOR
    ]
    near += [Fraction(f"{value:.{digits}e}") for digits in range(_MOST_DIGITS)]
    found = [sympy.Rational(f.numerator, f.denominator) for f in dict.fromkeys(near)]
    return sorted(found, key=lambda n: (number_bits(n), n))


@dataclass(frozen=True, eq=False)
class _Form:
    """One structure on some samples: constants can be fitted and judged without compiling anew."""

    template: sympy.Expr
    symbols: tuple[sympy.Symbol, ...]
    samples: Samples

    @cached_property
    def _compiled(self) -> Callable[[np.ndarray], np.ndarray]:
        names = [*self.samples.names, *map(str, self.symbols)]
        slopes = [sympy.diff(self.template, symbol) for symbol in self.symbols]
        return compile_numpy([self.template, *slopes], names)

    @cached_property
    def _plain(self) -> Callable[[np.ndarray], np.ndarray]:
        return compile_numpy([self.template], [*self.samples.names, *map(str, self.symbols)])

    def _arguments(self, values: np.ndarray) -> np.ndarray:
        fixed = np.broadcast_to(values[:, None], (len(values), len(self.samples)))
        return np.concatenate([self.samples.X.T, fixed])

    def residual(self, values: np.ndarray) -> np.ndarray:
        """(n,) f(X) - y."""
        return self._plain(self._arguments(values))[0] - self.samples.y

    def put(self, numbers: Sequence[sympy.Expr]) -> sympy.Expr:
        return self.template.xreplace(dict(zip(self.symbols, numbers, strict=True)))

    def bits(self, numbers: Sequence[sympy.Expr], noise: Noise) -> float:
        expr = self.put(numbers)
        if expr.has(sympy.nan, sympy.zoo, sympy.oo):
            return math.inf
        residual = self.residual(np.array([float(n) for n in numbers]))
        return complexity(expr) + data_bits(residual, noise)

    @cached_property
    def _frame_bits(self) -> float:
        """Bits of the formula without its constants, none of which is 0, 1 or -1."""
        plain = [sympy.Float(0.1 + i / 1024) for i in range(len(self.symbols))]
        return complexity(self.put(plain)) - sum(map(number_bits, plain))

    def rough_bits(self, numbers: Sequence[sympy.Expr], noise: Noise) -> float:
        """Like :meth:`bits`, but quicker, since most constants do not change the formula's form."""
        if any(abs(n) in (0, 1) for n in numbers):
            return self.bits(numbers, noise)
        residual = self.residual(np.array([float(n) for n in numbers]))
        return self._frame_bits + sum(map(number_bits, numbers)) + data_bits(residual, noise)

    def fit(self, values: np.ndarray, free: np.ndarray, unit: float) -> np.ndarray:
        """Fit the ``free`` ones by reweighted Gauss-Newton steps for sum log(1 + (r / unit)^2)."""
        residual = self.residual(values)
        level = _level(residual, unit)
        for _ in range(_MOST_STEPS if free.any() else 0):
            found = self._compiled(self._arguments(values))
            root = 1 / np.sqrt(1 + (residual / unit) ** 2)
            slopes = found[1:][free] * root
            if not (np.all(np.isfinite(slopes)) and np.all(np.isfinite(residual))):
                break
            size = np.maximum(np.linalg.norm(slopes, axis=1), 1e-300)
            step = np.linalg.lstsq((slopes / size[:, None]).T, -residual * root, rcond=1e-12)[0]
            for share in (1.0, 0.3, 0.03):
                trial = values.copy()
                trial[free] += share * step / size
                residual_there = self.residual(trial)
                reached = _level(residual_there, unit)
                if reached < level:
                    break
            else:
                break
            gain, level = level - reached, reached
            values, residual = trial, residual_there
            if gain < 1e-6 * len(residual):
                break
        return values


def _level(residual: np.ndarray, unit: float) -> float:
    with np.errstate(all="ignore"):
        level = float(np.sum(np.log1p((residual / unit) ** 2)))
    return level if math.isfinite(level) else math.inf


def _form(expr: sympy.Expr, samples: Samples) -> tuple[_Form, np.ndarray]:
    template, values = free_constants(expr, "constant ")
    return _Form(template, tuple(values), samples), np.array(list(values.values()))


def _as_floats(values: np.ndarray) -> list[sympy.Expr]:
    # Twelve digits are beyond any slope; more would only show rounding.
    return [sympy.Float(float(f"{v:.11e}")) for v in values]


def refit(expr: sympy.Expr, samples: Samples, unit: float) -> sympy.Expr:
    """Fit the floats of a formula to the slopes, misses beyond ``unit`` counted by their log.

    >>> t = np.linspace(0, 1, 20)
    >>> s = Samples(t[:, None], 3 * t, ("x",), "x", "given", t)
    >>> refit(sympy.Float(2.5) * sympy.Symbol("x"), s, 1e-3)
    3.0*x
    """
    form, values = _form(expr, samples)
    if not 0 < len(values) <= _MOST_CONSTANTS:
        return expr
    return form.put(_as_floats(form.fit(values, np.ones(len(values), dtype=bool), unit)))


def snap(expr: sympy.Expr, samples: Samples, noise: Noise) -> sympy.Expr:
    """Give the formula of the same form, or of fewer terms, that takes the fewest bits.

    Snapped constants come back as rationals, so that later fits leave them alone;
    :func:`as_decimals` writes them as the decimals they are.

    >>> t = np.linspace(0, 6, 200)
    >>> s = Samples(t[:, None], 3 * np.sin(t) + 0.001 * np.cos(9 * t), ("x",), "x", "given", t)
    >>> snap(2.9996 * sympy.sin(sympy.Symbol("x")), s, Noise(7e-4, 100.0))
    3*sin(x)
    """
    ends = [_snap_form(form, samples, noise) for form in normal_forms(expr)]
    return min(ends, key=lambda end: (end[0], str(end[1])))[1]


def _snap_form(expr: sympy.Expr, samples: Samples, noise: Noise) -> tuple[float, sympy.Expr]:
    form, values = _form(expr, samples)
    free = np.ones(len(values), dtype=bool)
    if len(values) > _MOST_CONSTANTS:
        return form.bits(_as_floats(values), noise), expr
    values = form.fit(values, free, noise.floor)
    numbers = _as_floats(values)
    least = form.bits(numbers, noise)
    while free.any():
        ranked = sorted(_snap_one(form, numbers, free, noise), key=lambda item: item[0])
        tried = [_follow(form, numbers, free, noise, *item) for item in ranked[:_MOST_TRIED]]
        best = min(tried, key=lambda item: item[0], default=None)
        # A tie goes to the snapped one: later fits leave it alone.
        if best is None or best[0] > least:
            break
        least, numbers, free = best
    return least, form.put(numbers)


def _snap_one(
    form: _Form, numbers: list[sympy.Expr], free: np.ndarray, noise: Noise
) -> Iterator[tuple[float, int, sympy.Expr]]:
    for i in np.flatnonzero(free):
        for simple in simple_numbers(float(numbers[i])):
            snapped = [*numbers[:i], simple, *numbers[i + 1 :]]
            yield form.rough_bits(snapped, noise), int(i), simple


def _follow(
    form: _Form,
    numbers: list[sympy.Expr],
    free: np.ndarray,
    noise: Noise,
    bits: float,
    index: int,
    simple: sympy.Expr,
) -> tuple[float, list[sympy.Expr], np.ndarray]:
    """Fix one constant and let the others follow."""
    snapped = [*numbers[:index], simple, *numbers[index + 1 :]]
    left = free.copy()
    left[index] = False
    values = form.fit(np.array([float(n) for n in snapped]), left, noise.floor)
    fitted = _as_floats(values)
    moved = [new if loose else old for new, old, loose in zip(fitted, snapped, left, strict=True)]
    after = form.bits(moved, noise)
    return (after, moved, left) if after < bits else (bits, snapped, left)


def normal_forms(expr: sympy.Expr) -> list[sympy.Expr]:
    """Give a ratio in every form in which one coefficient below the line is 1; else itself.

    A ratio does not change when both sides are multiplied by a number, so its constants are only
    simple in the right form.

    >>> x = sympy.Symbol("x")
    >>> [str(f) for f in normal_forms(1.5 * x / (1 + 0.5 * x))]
    ['1.5*x/(0.5*x + 1)', '3.0*x/(x + 2.0)']
    """
    top, bottom = sympy.fraction(expr)
    if not bottom.is_Add:
        return [expr]
    top_terms = sympy.Add.make_args(sympy.expand(top))
    forms = [expr]
    for term in bottom.args:
        divisor = term.as_coeff_Mul()[0]
        if abs(divisor) == 1 or divisor == 0:
            continue
        above = sympy.Add(*[_divide(part, divisor) for part in top_terms])
        below = sympy.Add(*[_divide(part, divisor) for part in bottom.args])
        forms.append(above / below)
    return forms


def _divide(term: sympy.Expr, divisor: sympy.Expr) -> sympy.Expr:
    coefficient, rest = term.as_coeff_Mul()
    value = float(coefficient / divisor)
    return (sympy.Integer(int(value)) if abs(value) == 1 else sympy.Float(value)) * rest


def as_decimals(expr: sympy.Expr) -> sympy.Expr:
    """Write rationals that are finite decimals, such as 981/100, as decimals; 8/3 stays.

    >>> as_decimals(sympy.Rational(981, 100) * sympy.Symbol("x") / 3)
    3.27*x
    """
    finite = {
        number: sympy.Float(float(number))
        for number in expr.atoms(sympy.Rational)
        if not number.is_Integer and 10**_MOST_DIGITS * 10 % int(number.q) == 0
    }
    return sympy.Add(*[_keep_powers(t, finite) for t in sympy.Add.make_args(expr)])


def _keep_powers(expr: sympy.Expr, numbers: dict[sympy.Expr, sympy.Expr]) -> sympy.Expr:
    if expr in numbers:
        return numbers[expr]
    if expr.is_Pow:
        return expr.func(_keep_powers(expr.base, numbers), expr.exp)
    if not expr.args:
        return expr
    return expr.func(*[_keep_powers(argument, numbers) for argument in expr.args])


def score_snapped(candidate: Candidate, samples: Samples, noise: Noise) -> Candidate:
    """Snap a candidate and score it anew."""
    return score_candidate(snap(candidate.expr, samples, noise), samples, candidate.source)
