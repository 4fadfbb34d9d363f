"""Parsimony where data are exact: a term stays only if residuals grow clearly without it.

On exact data the residuals are no noise. They are the error of the solver that made the states, and
of the differences that made the slopes. They have a pattern, so a longer formula can follow a
little of it on thousands of rows, which seems worth many bits. A term of the law does more:
without it the residuals are as large as the term. So shorter limits of a formula are tested: one
term less, a constant at 0, a slowly varying function at its limit. The shorter formula is kept if
the residuals stay of the same size.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import ByText, complexity, evaluate
from dynsr.fit.candidates import Candidate, score_candidate
from dynsr.fit.constants import refit
from dynsr.fit.description import description_length
from dynsr.fit.noise import FINEST_SLOPES, Noise, is_exact, slope_size
from dynsr.fit.settings import FIT, FitSettings
from dynsr.fit.snapping import score_snapped
from dynsr.fit.variation import with_floats

# First terms of functions at 0, and exp's other limit is that of its argument.
_AT_ZERO: dict[Any, Callable[[sympy.Expr], sympy.Expr]] = {
    sympy.sin: lambda u: u,
    sympy.tan: lambda u: u,
    sympy.tanh: lambda u: u,
    sympy.asin: lambda u: u,
    sympy.atan: lambda u: u,
    sympy.cos: lambda _: sympy.S.One,
    sympy.exp: lambda _: sympy.S.One,
}


def limits(expr: sympy.Expr) -> list[sympy.Expr]:
    """Give the formulas that a formula tends to as one of its numbers or functions vanishes.

    A sum loses a term, in a numerator or denominator or inside a function; a function of a small
    argument becomes the first term of its series.

    >>> x, y = sympy.symbols("x y")
    >>> [str(e) for e in limits(x + 2 * sympy.exp(y))]
    ['x', 'x + 2', '2*exp(y)']
    """
    found = {e for e in _shorter(expr) if e != expr and not e.has(sympy.zoo, sympy.nan, sympy.oo)}
    return sorted(found, key=lambda e: (complexity(e), ByText(e)))


def _shorter(node: sympy.Expr) -> Iterator[sympy.Expr]:
    if node.is_Add:
        for index in range(len(node.args)):
            yield sympy.Add(*node.args[:index], *node.args[index + 1 :])
    if node.func in _AT_ZERO:
        yield _AT_ZERO[node.func](node.args[0])
    if node.is_Pow:
        for changed in _shorter(node.base):
            yield changed**node.exp
        return
    for index, argument in enumerate(node.args):
        for changed in _shorter(argument):
            yield node.func(*node.args[:index], changed, *node.args[index + 1 :])


def without_flat_line(expr: sympy.Expr, columns: Mapping[str, np.ndarray]) -> sympy.Expr | None:
    """Give a ratio with the mean of its denominator where that hardly changes; else None.

    In noisy slopes it cannot be distinguished from the ratio, which has a constant more.

    Parameters
    ----------
    expr : the formula.
    columns : name -> (n,) values on which it is looked at.

    >>> x = sympy.Symbol("x")
    >>> without_flat_line((4000.0 * x**2 + 2000.0) / (x + 2000.0), {"x": np.array([0.5, 1.5])})
    1.99900049975012*x**2 + 0.999500249875062
    """
    # Most formulas are no ratios, and bringing a long sum under one line is dear.
    if not any(power.exp.could_extract_minus_sign() for power in expr.atoms(sympy.Pow)):
        return None
    top, bottom = sympy.fraction(sympy.together(expr))
    if not bottom.is_Add or not bottom.free_symbols:
        return None
    line = np.asarray(evaluate(bottom, columns), dtype=float)
    middle = float(np.mean(line))
    if not math.isfinite(middle) or not np.all(np.abs(line - middle) <= _FLAT * abs(middle)):
        return None
    return sympy.expand(sympy.expand(top) / sympy.Float(middle))


def collapse(
    candidate: Candidate,
    others: Iterable[Candidate],
    samples: Samples,
    noise: Noise,
    settings: FitSettings = FIT,
) -> Candidate:
    """Give the shortest limit of a candidate, or other candidate, that misses no more than it.

    Parameters
    ----------
    candidate : the formula that has been chosen.
    others : formulas found next to it; a shorter one with as small residuals takes its place.
    samples, noise : what it is fitted to, and what cannot be explained there.
    settings : ``alike``, the factor within which residuals are of the same size.

    What takes more bits in all is not taken. Where the slopes are noisy, or where nothing explains
    them, the candidate stays: there bits decide.

    >>> x = sympy.Symbol("x")
    >>> t = np.linspace(0.5, 2, 60)
    >>> s = Samples(t[:, None], -(t**3), ("x",), "x", "central4", t, 1e-9)
    >>> long = score_candidate(-(x**3) * sympy.exp(sympy.Float(-5e-10) * x**8), s, "search")
    >>> collapse(long, [], s, Noise(1e-7, 60.0)).expr
    -x**3
    """
    floor = max(samples.noise or 0.0, FINEST_SLOPES * slope_size(samples))
    bound = settings.alike * _misses(candidate, samples) + floor
    if not is_exact(samples) or bound[0] > settings.explained * slope_size(samples):
        return candidate
    shorter = [c for c in others if c.complexity < candidate.complexity]
    fitting = [c for c in shorter if np.all(_misses(c, samples) <= bound)]
    best = min([candidate, *fitting], key=lambda c: (c.complexity, ByText(c.expr)))
    most = description_length(candidate, samples, noise)
    if description_length(best, samples, noise) > most:
        best = candidate
    while True:
        found = _next(best, bound, samples, noise, settings)
        if found is None or description_length(found, samples, noise) > most:
            return best
        best = found


def _next(
    candidate: Candidate, bound: np.ndarray, samples: Samples, noise: Noise, settings: FitSettings
) -> Candidate | None:
    """Give the shortest limit within the bound, with constants fitted and snapped; None if none."""
    for expr in limits(candidate.expr):
        loose = with_floats(expr)
        if len(loose.atoms(sympy.Float)) > settings.most_constants:
            continue
        fitted = score_candidate(refit(loose, samples, noise.floor), samples, candidate.source)
        if not np.all(_misses(fitted, samples) <= bound):
            continue
        snapped = score_snapped(fitted, samples, noise, settings)
        shorter = [snapped, fitted, score_candidate(expr, samples, candidate.source)]
        for other in sorted(shorter, key=lambda c: c.complexity):
            if other.complexity < candidate.complexity and np.all(_misses(other, samples) <= bound):
                return other
    return None


def _misses(candidate: Candidate, samples: Samples) -> np.ndarray:
    """Quantiles of the sizes of the residuals: also of the few rows where a term is at work."""
    misses = np.abs(samples.y - evaluate(candidate.expr, samples.columns))
    if not np.all(np.isfinite(misses)):
        return np.full(len(_QUANTILES), np.inf)
    return np.asarray(np.quantile(misses, _QUANTILES))


# Share by which what stands below a line may vary on the data and still say nothing.
_FLAT = 0.05
_QUANTILES: Sequence[float] = (0.5, 0.8, 0.95, 0.99)
