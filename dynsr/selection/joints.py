"""Joints: ratios of products with the sine and cosine of the angle of a joint.

Every acceleration of a chain of bodies is such a ratio, and all have the same denominator.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import compile_columns
from dynsr.fit import RatioFit, fit_ratio
from dynsr.library import FEW
from dynsr.selection.relations import VANISHES
from dynsr.selection.subsets import best_subsets
from dynsr.selection.terms import products, weighted_sum

# Constants of sin^2 and of cos next to 1 in the denominator, from which a fit reaches any other.
_SQUARES, _COSINES = (-0.75, -0.5, *FEW), (-0.8, -0.5, 0.5, 0.8)


@dataclass(frozen=True, eq=False)
class Joint:
    """The terms of a joint: products with the sine and cosine of its angle.

    ``above`` are the terms of the numerator of such an acceleration. ``below`` are the terms that
    may be next to 1 in the denominator, with a few values of their constant.
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


def hinged_sums(
    samples: Samples,
    angle: str,
    allow: Callable[[sympy.Expr], bool],
    cost: Callable[[sympy.Expr], float],
    trust: np.ndarray,
    least: float,
    most: float,
    kept: int,
) -> list[sympy.Expr]:
    """Give ratios that follow exact slopes best.

    f = N / (1 + D) is N - f D = f: linear in all constants.

    Parameters
    ----------
    samples : the slopes.
    angle : of the joint.
    allow : whether a term may be one.
    cost : bits of a term with its coefficient.
    trust : (n,) how sure each slope is.
    least, most : sums of squares below which nothing is gained, and up to which it is nothing but
        the error of the slopes.
    kept : ratios at most.
    """
    names, wave = samples.names, sympy.Symbol(angle)
    sine, cosine = sympy.sin(wave), sympy.cos(wave)
    above = [e for e in Joint.of(angle, names).above if allow(e)]
    below = [e for e in (cosine, sine * cosine, sine**2) if allow(1 / (1 + e))]
    values = compile_columns([*above, *below], names)(*samples.X.T)
    lines = values[len(above) :].copy()
    values[len(above) :] *= -samples.y
    rows, y = values * trust, samples.y * trust
    subsets = best_subsets(
        rows @ rows.T,
        rows @ y,
        float(y @ y),
        np.array([cost(e) for e in (*above, *below)]),
        float(len(y)),
        keep=kept,
        least=least,
    )
    weights = trust**2

    def split(places: Sequence[int]) -> tuple[list[int], list[int]]:
        over = [i for i in places if i < len(above)]
        return over, [i - len(above) for i in places[len(over) :]]

    def fit(places: Sequence[int]) -> RatioFit:
        over, under = split(places)
        return fit_ratio(values[over], lines[under], samples.y, weights=weights)

    def missed(places: Sequence[int]) -> float:
        return float(np.sum(weights * fit(places).residual ** 2))

    def thin(places: tuple[int, ...]) -> tuple[int, ...]:
        """Leave out what exact slopes do not need."""
        shorter = (places[:i] + places[i + 1 :] for i in range(len(places)))
        some = [(missed(p), p) for p in shorter if p and p[0] < len(above)]
        left, best = min(some, key=lambda pair: pair[0], default=(math.inf, ()))
        return places if left > most else thin(best)

    found = []
    for subset in subsets:
        places = tuple(sorted(subset.places))
        if places[0] >= len(above):
            continue
        own = thin(places) if missed(places) <= most else places
        ratio, (over, under) = fit(own), split(own)
        line = 1 + ratio.denominator @ lines[under]
        if under and np.min(np.abs(line)) >= VANISHES * np.max(np.abs(line)):
            top = weighted_sum(ratio.numerator, [above[i] for i in over])
            found.append(top / (1 + weighted_sum(ratio.denominator, [below[i] for i in under])))
    return list(dict.fromkeys(found))
