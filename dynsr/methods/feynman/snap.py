"""Constants snapped to simple numbers, one at a time, as far as the data allow it.

AI Feynman 2.0 (Udrescu et al. 2020, section 3.3) snaps each constant to zero, an integer, a
rational or fewer digits and looks at each result alone. Here one constant is snapped, all others
are fitted again, and the next is looked at: a constant that is surely 2 takes its error out of
the others, which then show what they are. A step is kept when the description length falls.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction

import numpy as np
import sympy

from dynsr.expression import complexity, round_constants
from dynsr.methods.feynman.description import Noise, data_bits, noise_of, residuals
from dynsr.methods.feynman.refine import Refined, fixed, refine, refine_template
from dynsr.pareto import Candidate, score_candidate
from dynsr.samples import Samples

_MOST_DIGITS = 5
_LARGEST_DENOMINATOR = 12
# A simple number is looked at when it lies this close, relative to the value.
_NEAR = 0.05
# Simple numbers looked at, by predicted description length, before a constant counts as real.
_PATIENCE = 4


def simple_numbers(value: float) -> list[sympy.Expr]:
    """Give the simple numbers near a value: zero, integers, fractions, and 1 to 5 digits.

    >>> simple_numbers(0.4999)
    [0, 1/2, 4999/10000]
    """
    options = {Fraction(0), Fraction(round(value))}
    options |= {Fraction(value).limit_denominator(q) for q in range(2, _LARGEST_DENOMINATOR + 1)}
    options |= {Fraction(f"{value:.{digits - 1}e}") for digits in range(1, _MOST_DIGITS + 1)}
    near = [o for o in options if o == 0 or abs(float(o) - value) <= _NEAR * abs(value)]
    return [sympy.Rational(o.numerator, o.denominator) for o in sorted(near, key=_length)]


def _length(number: Fraction) -> tuple[int, Fraction]:
    return (abs(number.numerator) * number.denominator, number)


def snap(expr: sympy.Expr, samples: Samples, noise: Noise) -> sympy.Expr:
    """Refine a formula's floats and snap those to simple numbers that the samples let go.

    The fit is a Cauchy fit of scale ``noise.floor``. Integers and short fractions come back as
    exact numbers, decimals as floats.

    >>> x = np.linspace(0.0, 3.0, 200)
    >>> y = 1.5 * x + 9.81 * np.sin(x) + 0.001 * np.cos(40 * x)
    >>> s = Samples(x[:, None], y, ("x",), "x", "given", x)
    >>> snap(sympy.sympify("1.4999*x + 9.8104*sin(x)"), s, Noise(0.001, 200))
    3*x/2 + 9.81*sin(x)
    """
    best = refine(expr, samples, noise.floor)
    bits = _bits(best, noise)
    while len(best.values):
        step = _snapped_once(best, bits, samples, noise)
        if step is None:
            break
        best, bits = step
    return tidy(best.expr)


def _bits(refined: Refined, noise: Noise) -> float:
    return complexity(tidy(refined.expr)) + data_bits(refined.residual, noise)


def _snapped_once(
    now: Refined, bits: float, samples: Samples, noise: Noise
) -> tuple[Refined, float] | None:
    for _, index, number in _options(now, samples, noise)[:_PATIENCE]:
        template = fixed(now.template, {index: number}, _moved(now, index, float(number)))
        if template.shape.has(sympy.zoo, sympy.nan, sympy.oo):
            continue
        tried = refine_template(template, samples, noise.floor)
        found = _bits(tried, noise)
        if found < bits:
            return tried, found
    return None


def _options(now: Refined, samples: Samples, noise: Noise) -> list[tuple[float, int, sympy.Expr]]:
    """Every simple number for every constant, least predicted description length first."""
    options = []
    for index, value in enumerate(now.values):
        for number in simple_numbers(float(value)):
            moved = _moved(now, index, float(number))
            predicted = now.template.value_and_jacobian(samples.X, moved)[0]
            data = data_bits(samples.y - predicted, noise)
            if math.isfinite(data):
                numbers: list[float | sympy.Expr] = [float(v) for v in moved]
                numbers[index] = tidy(number)
                options.append((data + complexity(now.template.fill(numbers)), index, number))
    return sorted(options, key=lambda option: (option[0], option[1], str(option[2])))


def _moved(now: Refined, index: int, value: float) -> np.ndarray:
    """Give the values when one is set and the others follow it as their covariance says."""
    column = now.covariance[:, index]
    if not (np.all(np.isfinite(column)) and column[index] > 0):
        moved = now.values.copy()
    else:
        moved = now.values + column / column[index] * (value - now.values[index])
    moved[index] = value
    return moved


def tidy(expr: sympy.Expr) -> sympy.Expr:
    """Write fractions of long numbers as floats, 981/100 as 9.81; short fractions stay.

    >>> tidy(sympy.sympify("981*x/100 + y/3"))
    9.81*x + y/3
    """
    long = {
        a: sympy.Float(float(a))
        for a in expr.atoms(sympy.Rational)
        if not a.is_Integer and max(abs(a.p), a.q) > _LARGEST_DENOMINATOR
    }
    return expr.xreplace(long)


def skeleton(expr: sympy.Expr) -> str:
    """Write a formula with all its floats alike; formulas of one shape have one skeleton.

    >>> skeleton(sympy.sympify("2.5*x + 1.1")) == skeleton(sympy.sympify("0.3*x - 7.0"))
    True
    """
    return str(expr.xreplace({a: sympy.Float(1.0) for a in expr.atoms(sympy.Float)}))


def polish(candidates: Iterable[Candidate], samples: Samples, top: int = 8) -> list[Candidate]:
    """Refine and snap the ``top`` candidates of least description length, one of each shape.

    Gives the polished candidates, least description length first. The noise is estimated from
    all candidates, and again once the best are refined.
    """
    pool = [c for c in candidates if math.isfinite(c.loss)]
    if not pool:
        return []
    noise = noise_of(pool, samples)

    def length(candidate: Candidate, noise: Noise) -> float:
        return complexity(candidate.expr) + data_bits(residuals(candidate, samples), noise)

    def rounded_length(candidate: Candidate) -> tuple[float, str]:
        rounded = round_constants(candidate.expr, 4)
        return length(Candidate(rounded, 0.0, 0.0), noise), str(candidate.expr)

    chosen: dict[str, Candidate] = {}
    for candidate in sorted(pool, key=rounded_length):
        chosen.setdefault(skeleton(candidate.expr), candidate)
        if len(chosen) == top:
            break
    refined = [
        score_candidate(refine(c.expr, samples, noise.floor).expr, samples, c.source)
        for c in chosen.values()
    ]
    noise = noise_of([*pool, *refined], samples)
    snapped = {snap(c.expr, samples, noise): c.source for c in refined}
    polished = [score_candidate(expr, samples, source) for expr, source in snapped.items()]
    return sorted(polished, key=lambda c: (length(c, noise), str(c.expr)))
