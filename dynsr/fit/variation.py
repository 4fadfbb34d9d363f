"""Small changes of a formula: one factor for its sine, one function for its argument, and so on.

Over a short range w and sin(w) are nearly the same column, so a search that ranks by squared
error may prefer the wrong one. Each change is fitted and its bits are counted; the best is changed
again until none is better.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import ByText, Vocabulary, complexity, expand_terms, skeleton
from dynsr.fit.candidates import Candidate, score_candidate
from dynsr.fit.constants import refit
from dynsr.fit.description import description_length
from dynsr.fit.noise import Noise
from dynsr.fit.settings import FIT, FitSettings
from dynsr.fit.snapping import map_numbers, score_snapped


def neighbours(expr: sympy.Expr, vocabulary: Vocabulary | None = None) -> list[sympy.Expr]:
    """Give the formulas that differ in one place: v for sin(v) or sin(v) for v.

    Parameters
    ----------
    expr : the formula.
    vocabulary : what formulas may hold; None allows everything.

    >>> x, y = sympy.symbols("x y")
    >>> [str(n) for n in neighbours(x * y)]
    ['x*sin(y)', 'y*sin(x)']
    """
    found = {n for n in _swap(expr, False) if n != expr}
    if vocabulary is not None:
        found = {n for n in found if vocabulary.allows(n)}
    return sorted(found, key=lambda n: (complexity(n), ByText(n)))


def _swap(node: sympy.Expr, inside: bool) -> Iterator[sympy.Expr]:
    if node.is_Symbol:
        if not inside:
            yield sympy.sin(node)
        return
    if node.func in (sympy.sin, sympy.tan, sympy.tanh) and node.args[0].is_Symbol:
        yield node.args[0]
    for index, argument in enumerate(node.args):
        for changed in _swap(argument, inside or node.is_Function):
            yield node.func(*node.args[:index], changed, *node.args[index + 1 :])


def improve(
    candidate: Candidate, samples: Samples, noise: Noise, settings: FitSettings = FIT
) -> Candidate:
    """Climb from a candidate to its best neighbour until none takes fewer bits.

    Long formulas are handed back as they are: they have too many neighbours to be worth it.
    """
    best, least = candidate, description_length(candidate, samples, noise)
    for _ in range(settings.variation_rounds):
        if complexity(best.expr) > settings.longest:
            break
        mine, *fitted = [
            score_candidate(refit(loosen(e), samples, noise.floor), samples)
            for e in [best.expr, *neighbours(best.expr, settings.vocabulary)]
        ]
        # Before snapping all constants cost many bits: only such formulas are comparable.
        bound = description_length(mine, samples, noise)
        bits = [description_length(c, samples, noise) for c in fitted]
        order = [i for i in np.argsort(bits, kind="stable") if bits[i] < bound][: settings.varied]
        snapped = [
            replace(score_snapped(fitted[i], samples, noise, settings), source=candidate.source)
            for i in order
        ]
        bits = [description_length(c, samples, noise) for c in snapped]
        if not bits or min(bits) >= least:
            break
        least = min(bits)
        best = snapped[bits.index(least)]
    return best


def loosen(expr: sympy.Expr) -> sympy.Expr:
    """Make every coefficient of the sums of numerator and denominator a float again.

    The last coefficient of the denominator stays, since the whole is only given up to a factor;
    where it is a float, both sides are divided by it.

    >>> x, y = sympy.symbols("x y")
    >>> loosen((x - 3 * y) / (2 - x)), loosen(3 * y / (1 + 1.5 * x))
    ((1.0*x - 3.0*y)/(2.0 - x), 2.0*y/(x + 0.666666666666667))
    """
    top, bottom = sympy.fraction(expr)
    above = [_loose_term(t) for t in sympy.Add.make_args(expand_terms(top))]
    if bottom == 1:
        return sympy.Add(*above)
    terms = sorted(sympy.Add.make_args(bottom), key=lambda t: (len(t.free_symbols) > 0, ByText(t)))
    below, last = [_loose_term(t) for t in terms[:-1]], terms[-1]
    factor, rest = last.as_coeff_Mul()
    if factor.is_Float:
        above, below = ([term / factor for term in side] for side in (above, below))
        last = rest
    return sympy.Add(*above) / sympy.Add(*below, last)


def with_floats(expr: sympy.Expr, fixed: Collection[sympy.Expr] = ()) -> sympy.Expr:
    """Make every coefficient a float again, unless the whole is one bare column or number.

    Parameters
    ----------
    expr : the formula.
    fixed : terms that stay as they are.

    >>> x = sympy.Symbol("x")
    >>> with_floats(3 * x), with_floats(x), with_floats(3 * x - x**2, [-(x**2)])
    (3.0*x, x, -x**2 + 3.0*x)
    """
    if fixed:
        terms = sympy.Add.make_args(expr)
        rest = with_floats(sympy.Add(*(term for term in terms if term not in fixed)))
        return sympy.Add(rest, *(term for term in terms if term in fixed))
    return expr if expr.is_Symbol or expr.is_Number else loosen(expr)


def same_form(one: sympy.Expr, other: sympy.Expr) -> bool:
    """Whether formulas differ in nothing but their constants.

    >>> x = sympy.Symbol("x")
    >>> same_form(2 * x + 1, 0.3 * x - 7), same_form(2 * x, x**2)
    (True, False)
    """
    return bool(skeleton(with_floats(one)) == skeleton(with_floats(other)))


def _loose_term(term: sympy.Expr) -> sympy.Expr:
    coefficient, rest = term.as_coeff_Mul()
    functions = {f: map_numbers(f, _loose_number) for f in rest.atoms(sympy.Function)}
    return sympy.Float(float(coefficient)) * rest.xreplace(functions)


def _loose_number(number: sympy.Expr) -> sympy.Expr:
    return number if abs(number) == 1 or number == 0 else sympy.Float(float(number))
