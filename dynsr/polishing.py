"""Polishing: the constants of the chosen equations, together, on all the data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import sympy

from dynsr.expression import number_bits
from dynsr.methods.feynman.description import Noise
from dynsr.methods.flow import free_constants
from dynsr.methods.matching import Match, is_noisy, match_trajectories
from dynsr.methods.snapping import as_decimals, simple_numbers, snap
from dynsr.methods.variation import loosen
from dynsr.samples import Samples
from dynsr.trajectory import Trajectory

_MOST_ROUNDS = 8
# Bits that a term saves besides its number, when its constant becomes 0.
_TERM_BITS = 6.0
# A tie goes to the simple number.
_TIE_BITS = 0.5
_DIGITS = 8
_SUREST = 1e-9
# The median of 3000 misses (1000 rows, 3 states) is itself only sure to 2 %.
_AS_GOOD = 1.02


def polish(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    samples: Mapping[str, Samples],
    noise: Mapping[str, Noise],
) -> Match:
    """Give the equations with final constants.

    Clean slopes are trusted: their constants are snapped on all samples, and those that stay
    floats are fitted to the states. Slopes of noisy data are biased by their smoother: there all
    constants are fitted to the states first and snapped by their standard errors.
    """
    if not is_noisy(runs):
        snapped = {s: snap(_as_loose(e), samples[s], noise[s]) for s, e in exprs.items()}
        match = match_trajectories(snapped, runs, inputs=inputs)
        if not match.success:
            return _written(_unmatched(snapped))
        return _written(_snap_by_errors(match, runs, inputs))
    match = match_trajectories({s: loosen(e) for s, e in exprs.items()}, runs, inputs=inputs)
    if not match.success:
        return _written(_unmatched(exprs))
    # All simple constants at once: one at a time, constants that hang together block each other.
    simple = match_trajectories(exprs, runs, inputs=inputs)
    if simple.success and simple.loss <= _AS_GOOD * match.loss:
        return _written(_snap_by_errors(simple, runs, inputs, match))
    return _written(_snap_by_errors(match, runs, inputs))


def _as_loose(expr: sympy.Expr) -> sympy.Expr:
    """Floats again, unless the whole is one bare column."""
    return expr if expr.is_Symbol or expr.is_Number else loosen(expr)


def _unmatched(exprs: Mapping[str, sympy.Expr]) -> Match:
    return Match(dict(exprs), {s: () for s in exprs}, math.inf, False)


def _snap_by_errors(
    match: Match,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    free: Match | None = None,
) -> Match:
    """Snap each state's surest constant, fit the others again, and so on."""
    first = free or match
    for _ in range(_MOST_ROUNDS):
        snapped = {s: _snap_surest(e, match.errors[s]) for s, e in match.exprs.items()}
        if snapped == match.exprs:
            break
        following = match_trajectories(snapped, runs, inputs=inputs)
        worse = math.isfinite(following.loss) and following.loss > 1.05 * first.loss + _SUREST
        if worse or not following.success:
            break
        match = following
    # Errors of the fit in which every constant was free: snapping does not make them sure.
    return Match(match.exprs, first.errors, match.loss, True)


def _snap_surest(expr: sympy.Expr, pairs: Sequence[tuple[float, float]]) -> sympy.Expr:
    template, values = free_constants(expr, "constant ")
    best: tuple[float, sympy.Symbol, sympy.Expr] | None = None
    for symbol, (value, error) in zip(values, pairs, strict=True):
        rounded = _rounded(value, error)
        stay = number_bits(sympy.Float(rounded))
        for simple in simple_numbers(value):
            gain = stay - number_bits(simple) - _miss_bits(float(simple), value, error)
            gain += _TERM_BITS if simple == 0 else 0.0
            if gain > -_TIE_BITS and (best is None or gain > best[0]):
                best = (gain, symbol, simple)
    if best is None:
        return expr
    kept = {s: sympy.Float(v) for s, v in values.items() if s != best[1]}
    return template.xreplace({**kept, best[1]: best[2]})


def _miss_bits(simple: float, value: float, error: float) -> float:
    """Bits that the data lose when a constant moves: half its squared z-score, in base 2."""
    if not math.isfinite(error):
        return 0.0
    # Integration itself is not surer than this.
    sure = max(error, _SUREST * abs(value), 1e-300)
    return ((simple - value) / sure) ** 2 / (2 * math.log(2))


def _rounded(value: float, error: float) -> float:
    """Round to the digits that the standard error supports."""
    if not (math.isfinite(error) and error > 0 and value != 0):
        return float(f"{value:.{_DIGITS}e}")
    digits = max(0, min(_DIGITS, math.ceil(math.log10(abs(value) / error))))
    return float(f"{value:.{digits}e}")


def _written(match: Match) -> Match:
    exprs = {s: as_decimals(_round_floats(e)) for s, e in match.exprs.items()}
    return Match(exprs, match.errors, match.loss, match.success)


def _round_floats(expr: sympy.Expr) -> sympy.Expr:
    return expr.xreplace(
        {a: sympy.Float(float(f"{float(a):.9e}")) for a in expr.atoms(sympy.Float)}
    )
