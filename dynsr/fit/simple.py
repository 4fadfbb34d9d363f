"""Simple numbers with a prior of use: which number a fitted constant may stand for.

People write some constants as 2, 1/2, 0.1 or 9.81, and measure the others. Near a value v each
kind of simple number has a spacing d and a share of use w; a value that is no simple number may be
anything. With a fitted value of standard error s, Bayes' rule gives a number at z standard errors
the weight w d phi(z) / s against the share of all that is not simple: a number is believed when
its kind is often used and so thinly sown that none would lie there by chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import sympy

from dynsr.expression import LARGEST_IN_FRACTION
from dynsr.fit.linear import know
from dynsr.fit.settings import FIT, FitSettings


@dataclass(frozen=True)
class Kind:
    """A kind of simple numbers: its share of use, and whether it asks for a pinned value."""

    use: float
    pinned: bool = False


# SymPy's fractions are made of the one that is chosen alone.
Number: TypeAlias = Fraction | sympy.Expr

# Shares of constants in textbooks and handbooks by kind, to a factor of two; what is left is
# measured. Denominators above 8, and decimals of three digits or more, ask for precision.
WHOLE, HALF, SMALL_PARTS, PARTS = Kind(0.3), Kind(0.1), Kind(0.05), Kind(0.005)
LARGE_PARTS = Kind(0.002, True)
DIGITS = {1: Kind(0.15), 2: Kind(0.15), 3: Kind(0.02, True), 4: Kind(0.01, True)}
KNOWN = Kind(0.01)
MEASURED = 0.25
# The largest denominator of fractions that do not ask for precision.
LARGEST_UNPINNED = 8
# Share of a constant below which no error of a fit along states is believed.
FINEST = 1e-6
# Numbers of physics and mathematics that have names.
_NAMED: tuple[Number, ...] = (Fraction(981, 100), sympy.pi, 2 * sympy.pi)
_LARGEST_WHOLE = 100


@lru_cache(maxsize=10_000)
def simple_value(value: float, error: float, settings: FitSettings = FIT) -> sympy.Expr | None:
    """Give the simple number that a fitted value stands for; None where that is not sure.

    Parameters
    ----------
    value, error : the fitted value and its standard error.
    settings : ``within`` so many standard errors, ``sure`` to this probability.

    >>> simple_value(1.502, 0.003), simple_value(0.8304, 0.0006)
    (3/2, 83/100)
    >>> simple_value(0.9104, 0.05) is None
    True
    """
    if not (math.isfinite(value) and math.isfinite(error)) or value == 0:
        return None
    # Integration itself is not surer than the finest.
    error = max(error, settings.finest * abs(value), 1e-300)
    weights: dict[Number, float] = {}
    for number, use, gap in _numbers(abs(value), error <= settings.pinned * abs(value)):
        z = (float(number) - abs(value)) / error
        density = math.exp(-z * z / 2) / math.sqrt(2 * math.pi) / error
        weights[number] = weights.get(number, 0.0) + use * gap * density
    if not weights:
        return None
    best = max(weights, key=lambda n: (weights[n], str(n)))
    near = abs(float(best) - abs(value)) <= reach(best, settings) * error
    if not (near and weights[best] >= settings.sure * (sum(weights.values()) + MEASURED)):
        return None
    simple = sympy.Rational(best) if isinstance(best, Fraction) else best
    return simple if value > 0 else -simple


@lru_cache(maxsize=10_000)
def simple_number_bits(number: sympy.Expr) -> float:
    """Give the bits of a simple number: -log2(w d / v) for the size v, see the top of this file.

    Parameters
    ----------
    number : what :func:`simple_value` gives.

    >>> [round(simple_number_bits(sympy.Rational(n))) for n in ("0.2", "0.58", "1.044")]
    [4, 9, 17]
    """
    value = abs(float(number))
    near = _numbers(value, True)
    uses = [use * gap for own, use, gap in near if own == abs(number)]
    return math.log2(value / max(uses)) if uses else math.inf


def simplicity_bits(values: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """(P,) bits that constants save where they are whole, half or short decimal numbers.

    Constant by constant; one that lies on none saves nothing.

    Parameters
    ----------
    values, errors : (P,) fitted values and their standard errors.
    """
    return np.asarray(np.maximum(use_bits(values, errors), 0.0))


def use_bits(values: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """(P,) logarithm of Bayes' factor of the prior of use against that of measured constants alone.

    It is negative where a constant lies on no simple number.

    Parameters
    ----------
    values, errors : (P,) fitted values and their standard errors.

    >>> use_bits(np.array([1.0005, 1.0237]), np.array([0.001, 0.001])).round()
    array([ 7., -2.])
    """
    size = np.maximum(np.abs(values), 1e-300)
    finest = np.where(np.isfinite(errors), np.maximum(errors, FINEST * size), np.inf)
    decade = 10.0 ** np.floor(np.log10(size))
    kinds = (
        (WHOLE, np.ones_like(size), 0.0),
        (HALF, np.ones_like(size), 0.5),
        (DIGITS[1], decade, 0.0),
        (DIGITS[2], decade / 10, 0.0),
    )
    found, most = np.full_like(size, MEASURED), MEASURED
    for kind, gap, first in kinds:
        nearest = np.maximum(np.round(size / gap - first), 0.0 if first else 1.0) + first
        z = (size / gap - nearest) * gap / finest
        density = np.exp(-z * z / 2) / math.sqrt(2 * math.pi) * gap / finest
        # Where the error spans several of them, one lies near whatever the value is.
        found += kind.use * np.where(finest > gap / 2, 1.0, density)
        most += kind.use
    return np.asarray(np.log2(found / most))


def use_bits_together(
    values: np.ndarray, covariance: np.ndarray, written: np.ndarray
) -> np.ndarray:
    """(P,) the same of constants that were fitted together, by the chain rule of probability.

    The constant that lies on a simple number most surely is known then, which leaves the others
    smaller errors.

    Parameters
    ----------
    values, covariance : (P,) fitted values, and their covariance (P, P).
    written : (P,) the numbers that are written for them.

    >>> both = np.array([[1.0, 0.999], [0.999, 1.0]])
    >>> use_bits_together(np.array([1.0, 2.0]), 1e-4 * both, np.array([1.0, 2.0])).round()
    array([4., 9.])
    """
    found, left = np.full(len(values), np.log2(MEASURED)), list(range(len(values)))
    while left:
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        bits = use_bits(values[left], errors[left])
        best = int(np.argmax(bits))
        if not bits[best] > 0:
            break
        place = left.pop(best)
        found[place] = bits[best]
        values, covariance = know(values, covariance, place, written[place])
    return found


def reach(number: Number, settings: FitSettings = FIT) -> float:
    """Give the standard errors within which a number may stand for a constant.

    A factor 1 is no number of a formula but its absence, like a term whose factor is 0, and is
    tested like that.

    >>> reach(sympy.Rational(3, 2)), reach(sympy.Integer(-1))
    (2.0, 3.0)
    """
    return settings.surely_zero if abs(number) == 1 else settings.within


def _numbers(value: float, pinned: bool) -> list[tuple[Number, float, float]]:
    """Give (number, share of use, spacing of its kind) of the simple numbers around a value."""
    found: list[tuple[Number, float, float]] = []

    def add(numbers: set[Fraction], kind: Kind, gap: float) -> None:
        if pinned or not kind.pinned:
            found.extend((n, kind.use, gap) for n in numbers if n > 0)

    if value < _LARGEST_WHOLE:
        add(_around(value, Fraction(1)), WHOLE, 1.0)
        for q in range(2, LARGEST_IN_FRACTION + 1):
            parts = PARTS if q <= LARGEST_UNPINNED else LARGE_PARTS
            kind = HALF if q == 2 else SMALL_PARTS if q <= 4 else parts
            numbers = {n for n in _around(value, Fraction(1, q)) if n.denominator == q}
            coprime = sum(math.gcd(p, q) == 1 for p in range(q))
            add({n for n in numbers if n.numerator <= LARGEST_IN_FRACTION}, kind, 1 / coprime)
    for digits, kind in DIGITS.items():
        exponent = math.floor(math.log10(value)) - digits + 1
        step = Fraction(10) ** exponent
        add(_around(value, step), kind, float(step))
    found.extend((n, KNOWN.use, value) for n in _NAMED if abs(float(n) - value) < 0.1 * value)
    return found


def _around(value: float, step: Fraction) -> set[Fraction]:
    """Give the multiples of ``step`` below and above a value."""
    over, under = value.as_integer_ratio()
    below = over * step.denominator // (under * step.numerator)
    return {below * step, (below + 1) * step}
