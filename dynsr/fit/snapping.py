"""Simple numbers for the constants of a formula, where the description length says so.

AI Feynman 2.0 (Udrescu et al. 2020, section II.E) snaps each constant to zero, an integer, a
rational or fewer digits and looks at each result alone. Here one constant is snapped, all others
are fitted again, and the next is looked at: a constant that is surely 2 takes its error out of
the others, which then show what they are. A step is kept when the formula takes fewer bits, with
the bits of :mod:`dynsr.fit.description`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import (
    LARGEST_IN_FRACTION,
    ByText,
    complexity,
    expand_terms,
    marks,
    number_bits,
    round_constants,
    skeleton,
)
from dynsr.fit.candidates import Candidate, score_candidate
from dynsr.fit.constants import (
    Template,
    as_floats,
    refit,
)
from dynsr.fit.description import data_bits, description_length, shift_bits
from dynsr.fit.noise import Noise, noise_of
from dynsr.fit.settings import FIT, FitSettings
from dynsr.fit.simple import LARGEST_UNPINNED

# Longer decimals are no simple numbers: six digits cost as many bits as most data support.
_MOST_DIGITS = 6
_LARGEST = 10**_MOST_DIGITS


def simple_numbers(value: float, near: float = FIT.near) -> list[sympy.Rational]:
    """Simple numbers near ``value``: 0, integers, small fractions and short decimals.

    Fractions and decimals lie within the share ``near`` of the value.

    >>> [str(n) for n in simple_numbers(2.6665)][:4]
    ['0', '3', '8/3', '11/4']
    """
    if not math.isfinite(value):
        return []
    small = [Fraction(round(value * q), q) for q in range(2, LARGEST_IN_FRACTION + 1)]
    found = [f for f in small if abs(f.numerator) <= LARGEST_IN_FRACTION]
    found += [Fraction(f"{value:.{digits}e}") for digits in range(_MOST_DIGITS)]
    found = [f for f in found if abs(float(f) - value) <= near * abs(value)]
    exact = dict.fromkeys([Fraction(0), Fraction(round(value)), *found])
    numbers = [sympy.Rational(f.numerator, f.denominator) for f in exact]
    return sorted(numbers, key=lambda n: (number_bits(n), n))


def usable_numbers(value: float, error: float, settings: FitSettings = FIT) -> list[sympy.Rational]:
    """Give the simple numbers that a fit of this precision may take for a constant.

    Fractions of denominators above 8, and decimals of more than two digits, ask for a relative
    error below ``settings.pinned``. Without ``settings.snap`` only 0, 1 and -1 are left, which
    change the terms of a formula.

    >>> [str(n) for n in usable_numbers(0.9167, 0.01)]
    ['0', '1', '7/8', '9/10', '23/25']
    >>> sympy.Rational(11, 12) in usable_numbers(0.916668, 1e-6)
    True
    """
    found = simple_numbers(value, settings.near)
    if not settings.snap:
        return [n for n in found if abs(n) <= 1 and n.is_Integer]
    if error <= settings.pinned * abs(value):
        return found
    return [n for n in found if int(n.q) <= LARGEST_UNPINNED or _is_short(n)]


def _is_short(number: sympy.Rational) -> bool:
    """Whether a number is a decimal of one or two significant digits."""
    value, exact = float(number), Fraction(int(number.p), int(number.q))
    return any(Fraction(f"{value:.{digits}e}") == exact for digits in (0, 1))


@dataclass(frozen=True, eq=False)
class _Snapper:
    """Snaps the constants of one template, given one noise."""

    template: Template
    noise: Noise
    settings: FitSettings

    _frames: dict[tuple[int | None, ...], tuple[float, list[int]]] = field(default_factory=dict)

    def _bits(self, numbers: Sequence[sympy.Expr]) -> float:
        bits = self._formula_bits([*map(_special, numbers)], [*map(number_bits, numbers)])
        return bits + self._data_bits(_as_array(numbers))

    def _data_bits(self, values: np.ndarray) -> float:
        return data_bits(self.template.residual(values), self.noise)

    def _formula_bits(self, special: Sequence[int | None], costs: Sequence[float]) -> float:
        """Bits of the numbers, of which each costs these, and of the frame that they leave."""
        key = tuple(special)
        if key not in self._frames:
            self._frames[key] = self._frame(special)
        bits, present = self._frames[key]
        return bits + sum(costs[i] for i in present)

    def _frame(self, special: Sequence[int | None]) -> tuple[float, list[int]]:
        """Give the frame's bits and the places of the numbers that it still contains."""
        pairs = zip(special, marks(len(special)), strict=True)
        numbers = [mark if s is None else sympy.Integer(s) for s, mark in pairs]
        expr = self.template.put(numbers)
        if expr.has(sympy.nan, sympy.zoo, sympy.oo):
            return math.inf, []
        held = expr.atoms(sympy.Float)
        bits = complexity(expr) - sum(map(number_bits, held))
        return bits, [i for i, n in enumerate(numbers) if n in held]

    def snap(self) -> tuple[float, sympy.Expr]:
        """Give the bits of the snapped formula and itself."""
        template, unit = self.template, self.noise.floor
        values, free = template.values, np.ones(len(template.values), dtype=bool)
        if len(values) <= self.settings.most_constants:
            values = template.fit(values, free, unit)
        else:
            free[:] = False
        numbers = as_floats(values)
        least = self._bits(numbers)
        while free.any():
            ranked = sorted(self._options(numbers, free), key=lambda option: option[0])
            tried = [self._fix(numbers, free, *rest) for _, *rest in ranked[: self.settings.tried]]
            best = min(tried, key=lambda item: item[0], default=None)
            # A tie goes to the snapped one: later fits leave it alone.
            if best is None or not best[0] <= least:
                break
            least, numbers, free = best
        return least, template.put(numbers)

    def _options(
        self, numbers: list[sympy.Expr], free: np.ndarray
    ) -> Iterator[tuple[float, int, sympy.Expr, np.ndarray]]:
        """Give every simple number for every free constant, with the bits it is likely to take."""
        values = _as_array(numbers)
        covariance = self.template.covariance(values, free, self.noise.floor)
        now = self._data_bits(values)
        most = now + shift_bits(self.settings.surely_zero)
        special, costs = [*map(_special, numbers)], [*map(number_bits, numbers)]
        for place, i in enumerate(np.flatnonzero(free)):
            error = float(np.sqrt(max(covariance[place, place], 0.0)))
            for simple in usable_numbers(values[i], error, self.settings):
                moved = values.copy()
                moved[free] += _follow(covariance[:, place], place, float(simple) - values[i])
                moved[i] = float(simple)
                misses = self._data_bits(moved)
                # Zero saves a whole term, and others may seem to stand in for it while they are
                # free: only a term that the data do not ask for goes.
                if simple == 0 and misses > most:
                    continue
                bits = misses + self._formula_bits(
                    [*special[:i], _special(simple), *special[i + 1 :]],
                    [*costs[:i], number_bits(simple), *costs[i + 1 :]],
                )
                if math.isfinite(bits):
                    yield bits, int(i), simple, moved

    def _fix(
        self,
        numbers: list[sympy.Expr],
        free: np.ndarray,
        index: int,
        simple: sympy.Expr,
        moved: np.ndarray,
    ) -> tuple[float, list[sympy.Expr], np.ndarray]:
        """Fix one constant and fit the others again."""
        left = free.copy()
        left[index] = False
        values = self.template.fit(moved, left, self.noise.floor)
        kept = [*numbers[:index], simple, *numbers[index + 1 :]]
        both = zip(as_floats(values), kept, left, strict=True)
        found = [new if loose else old for new, old, loose in both]
        return self._bits(found), found, left


def _special(number: sympy.Expr) -> int | None:
    """Give 0, 1 and -1, which alone change the frame that the numbers are in."""
    return int(number) if number in (0, 1, -1) else None


def _as_array(numbers: Sequence[sympy.Expr]) -> np.ndarray:
    return np.array([float(n) for n in numbers])


def _follow(column: np.ndarray, place: int, shift: float) -> np.ndarray:
    """Give the shifts with which all follow the one at ``place``, by its covariances."""
    if not (np.all(np.isfinite(column)) and column[place] > 0):
        return np.zeros(len(column))
    return column / column[place] * shift


def snap(
    expr: sympy.Expr, samples: Samples, noise: Noise, settings: FitSettings = FIT
) -> sympy.Expr:
    """Give the formula of the same form, or of fewer terms, that takes the fewest bits.

    The fit is a Cauchy fit of unit ``noise.floor``. Snapped constants come back as rationals, so
    that later fits leave them alone; :func:`tidy` writes them as they are to be read.

    >>> t = np.linspace(0, 6, 200)
    >>> s = Samples(t[:, None], 3 * np.sin(t) + 0.001 * np.cos(9 * t), ("x",), "x", "given", t)
    >>> snap(2.9996 * sympy.sin(sympy.Symbol("x")), s, Noise(7e-4, 100.0))
    3*sin(x)
    """
    ends = [
        _Snapper(Template.of(form, samples), noise, settings).snap() for form in normal_forms(expr)
    ]
    return min(ends, key=lambda end: (end[0], ByText(end[1])))[1]


def normal_forms(expr: sympy.Expr) -> list[sympy.Expr]:
    """Give a ratio in every form in which one coefficient of the denominator is 1; else itself.

    A ratio does not change when both sides are multiplied by a number, so its constants are only
    simple in the right form.

    >>> x = sympy.Symbol("x")
    >>> [str(f) for f in normal_forms(1.5 * x / (1 + 0.5 * x))]
    ['1.5*x/(0.5*x + 1)', '3.0*x/(x + 2.0)']
    """
    top, bottom = sympy.fraction(expr)
    if not bottom.is_Add:
        return [expr]
    top_terms = sympy.Add.make_args(expand_terms(top))
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


def tidy(expr: sympy.Expr) -> sympy.Expr:
    """Write numbers as they are read best: 981/100 as 9.81, 3/2 as 1.5, 8/3 as it is, 2.0 as 2.

    A fraction stays where it is no short decimal and has no number above 12, as in 8/3, and where
    it is an exponent; 251/9 becomes a decimal.

    >>> tidy(sympy.sympify("981*x/100 + 8*y/3 + sqrt(x) + 2.0"))
    sqrt(x) + 9.81*x + 8*y/3 + 2
    """
    # Term by term: one SymPy product would multiply a float into a sum.
    return sympy.Add(*[map_numbers(t, _tidied) for t in sympy.Add.make_args(expr)])


def readable(expr: sympy.Expr) -> sympy.Expr:
    """Write a formula as textbooks do: tidy numbers, and saturations as 1.2*x/(x + 0.8).

    One coefficient of a denominator is 1: that of its leading term, or of another term if only then
    all numbers are short decimals. Whole numbers stay where nothing makes them short decimals.

    Parameters
    ----------
    expr : the formula; what is given is the same function.

    >>> readable(sympy.sympify("-6*x/(5*x + 4)")), readable(sympy.sympify("x/(7*x + 3)"))
    (-1.2*x/(x + 0.8), x/(7*x + 3))
    >>> readable(sympy.sympify("77*x/(37*x + 100)"))
    0.77*x/(0.37*x + 1)
    """
    # Before numbers are decimals: 1000/11 has an end where 69/(1000 x/11 + 100) is divided by it.
    return tidy(sympy.Add(*[_led_by_one(term) for term in sympy.Add.make_args(expr)]))


def _led_by_one(term: sympy.Expr) -> sympy.Expr:
    longest = max((len(part.args) for part in term.atoms(sympy.Add)), default=1)
    ways = (_led_by(term, place) for place in range(longest))
    return next((way for way in ways if way is not term), term)


def _led_by(term: sympy.Expr, place: int) -> sympy.Expr:
    """Divide denominators by one of their coefficients; the term as it is if that is no shorter."""
    number, rest = term.as_coeff_Mul()
    kept, scale = [], sympy.S.One
    for factor in sympy.Mul.make_args(rest):
        below = factor.is_Pow and factor.exp.is_Integer and factor.exp < 0 and factor.base.is_Add
        terms = factor.base.as_ordered_terms() if below else []
        numbers = [part.as_coeff_Mul()[0] for part in terms]
        if not numbers or any(abs(own) == 1 for own in numbers):
            kept.append(factor)
            continue
        lead = abs(_exact(numbers[min(place, len(numbers) - 1)]))
        parts = [part.as_coeff_Mul() for part in factor.base.args]
        base = sympy.Add(*[_exact(own) / lead * other for own, other in parts])
        kept.append(base**factor.exp)
        scale *= lead**factor.exp
    if scale == 1:
        return term
    factor = _exact(number) * scale
    above = next((part for part in kept if part.is_Add), None)
    if above is not None:  # its coefficients take the factor, of which there is none then
        parts = [part.as_coeff_Mul() for part in above.args]
        kept[kept.index(above)] = sympy.Add(*[_exact(own) * factor * p for own, p in parts])
        factor = sympy.S.One
    decimals = {a for part in (factor, *kept) for a in part.atoms(sympy.Rational)}
    if not term.has(sympy.Float) and any(_LARGEST % int(a.q) for a in decimals):
        return term
    return _decimal(factor) * sympy.Mul(*[map_numbers(part, _decimal) for part in kept])


def _exact(number: sympy.Expr) -> sympy.Rational:
    return sympy.Rational(repr(float(number))) if number.is_Float else number


def _decimal(number: sympy.Expr) -> sympy.Expr:
    return number if number.is_Integer or not number.is_Rational else sympy.Float(float(number))


def _tidied(number: sympy.Expr) -> sympy.Expr:
    if number.is_Float and float(number).is_integer() and abs(number) < _LARGEST:
        return sympy.Integer(int(number))
    if not number.is_Rational or number.is_Integer:
        return number
    finite = 10 ** (_MOST_DIGITS + 1) % int(number.q) == 0
    short = max(abs(int(number.p)), int(number.q)) <= LARGEST_IN_FRACTION
    return number if short and not finite else as_floats(np.array([float(number)]))[0]


def map_numbers(expr: sympy.Expr, change: Callable[[sympy.Expr], sympy.Expr]) -> sympy.Expr:
    """Change every number of a formula but the exponents.

    >>> map_numbers(sympy.sympify("2*x**2"), lambda n: n + 1)
    3*x**2
    """
    if expr.is_Number:
        return change(expr)
    if expr.is_Pow:
        return expr.func(map_numbers(expr.base, change), expr.exp)
    if not expr.args:
        return expr
    return expr.func(*[map_numbers(argument, change) for argument in expr.args])


def one_a_shape(ranked: Iterable[Candidate]) -> list[Candidate]:
    """Keep the first of the formulas that differ in constants alone."""
    shapes: dict[sympy.Expr, Candidate] = {}
    for candidate in ranked:
        shapes.setdefault(skeleton(candidate.expr), candidate)
    return list(shapes.values())


def score_snapped(
    candidate: Candidate, samples: Samples, noise: Noise, settings: FitSettings = FIT
) -> Candidate:
    """Snap a candidate and score it again."""
    expr = snap(candidate.expr, samples, noise, settings)
    return score_candidate(expr, samples, candidate.source)


def snap_best(candidates: Iterable[Candidate], samples: Samples, top: int = 8) -> list[Candidate]:
    """Refit and snap the ``top`` candidates of least description length, one of each shape.

    Gives the snapped candidates, least description length first. The noise is estimated from all
    candidates, and again once the best are fitted.
    """
    pool = [c for c in candidates if math.isfinite(c.loss)]
    if not pool:
        return []
    noise = noise_of(pool, samples)

    def rounded_length(candidate: Candidate) -> tuple[float, ByText]:
        rounded = Candidate(round_constants(candidate.expr, 4), 0.0, 0.0)
        return description_length(rounded, samples, noise), ByText(candidate.expr)

    fitted = [
        score_candidate(refit(c.expr, samples, noise.floor), samples, c.source)
        for c in one_a_shape(sorted(pool, key=rounded_length))[:top]
    ]
    noise = noise_of([*pool, *fitted], samples)
    snapped = {tidy(snap(c.expr, samples, noise)): c.source for c in fitted}
    found = [score_candidate(expr, samples, source) for expr, source in snapped.items()]
    return sorted(found, key=lambda c: (description_length(c, samples, noise), ByText(c.expr)))
