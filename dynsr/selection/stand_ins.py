"""Stand-ins: functions of one variable that noise may hardly tell from each other.

A saturation, a logarithm, a root or a reciprocal may each do for the others over the range of one
record. Where a system holds one of them, all the others are fitted in its place, so that what
cannot be told apart is seen beside it, and what does better takes its place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import sympy

from dynsr.expression import evaluate
from dynsr.fit import skeleton
from dynsr.selection.changes import prune
from dynsr.selection.comparison import SystemComparison, SystemFit
from dynsr.selection.terms import weighted_sum

# Share of the slopes' spread by which a stand-in may be off before anything is fitted.
_LIKE = 0.5
# Values of a constant inside, in units of the median size of its variable, that are tried first.
_SHARES = (0.3, 1.0, 3.0)
# Powers of cooperation beside 2, and exponents from which a fit reaches any other.
_HILL, _POWERS = (3, 4), (-1.5, -0.7, 0.7, 1.5)


def stand_ins(expr: sympy.Expr, columns: Mapping[str, np.ndarray]) -> Iterator[sympy.Expr]:
    """Give an equation with another function in the place of one that is no whole power.

    Sines and cosines keep their place: of an angle they are no matter of choice.

    Parameters
    ----------
    expr : the equation.
    columns : name -> values of the variables, whose sizes the first constants come from.

    >>> x, y = sympy.symbols("x y")
    >>> columns = {"x": np.linspace(1.0, 3.0, 9), "y": np.ones(9)}
    >>> found = {str(e) for e in stand_ins(2.0 * y * sympy.log(x), columns)}
    >>> len(found) > 5 and not any("log(x)*y" in e for e in found)
    True
    """
    values = evaluate(expr, columns)
    own = skeleton(expr)
    best: dict[sympy.Expr, tuple[float, sympy.Expr]] = {}
    for others, rest, symbol in _places(expr):
        for other in _functions(symbol, columns[str(symbol)]):
            missed, changed = _like(values, [*others, rest * other], columns)
            shape = skeleton(changed)
            if shape != own and missed < best.get(shape, (np.inf,))[0]:
                best[shape] = missed, changed
    spread = float(np.linalg.norm(values - np.mean(values)))
    for missed, changed in best.values():
        if missed <= _LIKE * spread:
            yield changed


def _places(expr: sympy.Expr) -> Iterator[tuple[list[sympy.Expr], sympy.Expr, sympy.Symbol]]:
    """Give (other terms, factor, variable) where factor times functions of the variable stand.

    Several terms of one factor are one function of the variable in parts: a v^2 - b v^3.
    """
    terms = sympy.Add.make_args(expr)
    for symbol in sorted(expr.free_symbols, key=str):
        groups: dict[sympy.Expr, list[tuple[sympy.Expr, sympy.Expr]]] = {}
        for term in terms:
            rest, own = term.as_independent(symbol, as_Add=False)
            if own.free_symbols == {symbol}:
                groups.setdefault(rest.as_coeff_Mul()[1], []).append((term, own))
        for rest, pairs in groups.items():
            if any(own.has(sympy.sin, sympy.cos) for _, own in pairs):
                continue
            places = [[pair] for pair in pairs if not pair[1].is_polynomial(symbol)]
            places += [pairs] if len(pairs) > 1 else []
            for place in places:
                gone = [term for term, _ in place]
                yield [t for t in terms if t not in gone], rest, symbol


def _like(
    values: np.ndarray, terms: Sequence[sympy.Expr], columns: Mapping[str, np.ndarray]
) -> tuple[float, sympy.Expr]:
    """Give the sum of terms the coefficients that make it most like some values.

    From there the fit of the constants inside finds its way.
    """
    bodies = list(dict.fromkeys(term.as_coeff_Mul()[1] for term in terms))
    with np.errstate(all="ignore"):
        block = np.array([evaluate(body, columns) for body in bodies]).T
    if not np.all(np.isfinite(block)):
        return np.inf, sympy.Add(*terms)
    size = np.maximum(np.linalg.norm(block, axis=0), 1e-300)
    found = np.linalg.lstsq(block / size, values, rcond=1e-10)[0] / size
    missed = float(np.linalg.norm(block @ found - values))
    return missed, weighted_sum(found, bodies)


def _functions(symbol: sympy.Symbol, values: np.ndarray) -> Iterator[sympy.Expr]:
    size = float(np.median(np.abs(values))) or 1.0
    positive = bool(np.min(values) > 0)
    yield symbol
    yield symbol**2
    yield sympy.tanh(symbol)
    for share in _SHARES:
        scale = sympy.Float(float(f"{share * size:.3g}"))
        yield sympy.tanh(symbol / scale)
        yield sympy.exp(-symbol / scale)
        yield 1 / (symbol**2 + scale**2)
        yield symbol / (symbol**2 + scale**2)
        yield symbol**2 / (symbol**2 + scale**2)
        for power in _HILL if positive else ():
            yield symbol**power / (symbol**power + scale**power)
            yield 1 / (symbol**power + scale**power)
        if positive:
            yield symbol / (symbol + scale)
            yield 1 / (symbol + scale)
    if positive:
        yield sympy.sqrt(symbol)
        yield sympy.log(symbol)
        yield symbol * sympy.log(symbol)
        for exponent in _POWERS:
            yield symbol ** sympy.Float(exponent)
    if np.min(values) > 0.1 * size:
        yield 1 / symbol


def try_stand_ins(
    comparison: SystemComparison,
    best: SystemFit,
    climb: Callable[[SystemFit], SystemFit],
) -> SystemFit:
    """Fit every stand-in of a system's functions; gives the system of fewest bits.

    Parameters
    ----------
    comparison : fits the systems, and keeps them for who asks what came close.
    best : the system.
    climb : takes changes from a system for as long as they take fewer bits.
    """
    settings = comparison.settings
    for _ in range(settings.again):
        before = best
        found = []
        for state, expr in before.exprs.items():
            for other in stand_ins(expr, comparison.mesh.columns):
                fit = comparison.fit_anew({**before.exprs, state: other})
                found += [] if fit is None else [(state, fit)]
        # What is far off does not come close by the terms that it could do without.
        most = before.bits + settings.behind
        close = [prune(comparison, fit, state) for state, fit in found if fit.bits <= most]
        # What another function made superfluous, or asks for, shows from there.
        for fit in sorted(close, key=lambda f: f.bits)[: settings.stand_ins]:
            best = min(best, climb(fit), key=lambda f: f.bits)
        if best is before:
            break
    return best
