"""Polishing: the constants of the chosen equations, together, on all the data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy

from dynsr.data import Samples, Trajectory
from dynsr.expression import complexity, number_bits
from dynsr.fit.constants import free_constants
from dynsr.fit.description import Noise, data_bits, estimate_noise
from dynsr.fit.shooting import Match, is_noisy, match_trajectories, measure_errors
from dynsr.fit.snapping import simple_numbers, snap, tidy
from dynsr.fit.variation import loosen

_MOST_ROUNDS = 8
# Bits that a term saves besides its number, when its constant becomes 0.
_TERM_BITS = 6.0
# A tie goes to the simple number.
_TIE_BITS = 0.5
_DIGITS = 8
_SUREST = 1e-9


def polish(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    samples: Mapping[str, Samples],
    noise: Mapping[str, Noise],
) -> Match:
    """Give the equations with final constants, and the standard error of each of these.

    Clean slopes are trusted: their constants are snapped on all samples, and those that stay
    floats are fitted to the states. Slopes of noisy data are biased by their smoother: there all
    constants are fitted to the states first. A simpler formula is kept when formula and states
    together take fewer bits with it.
    """
    noisy = is_noisy(runs)
    start = {
        s: loosen(e) if noisy else snap(_as_loose(e), samples[s], noise[s])
        for s, e in exprs.items()
    }
    match = match_trajectories(start, runs, inputs=inputs)
    if match.success and len(match.misses):
        level = estimate_noise([match.misses], np.ones(len(match.misses)))
        # All simple constants at once: one at a time, those that hang together block each other.
        simple = match_trajectories(exprs, runs, inputs=inputs) if noisy else match
        if simple.success and _bits(simple, level) <= _bits(match, level):
            match = simple
        match = _snap_by_errors(match, runs, inputs, level)
    elif not match.success:
        match = Match.untouched(exprs if noisy else start)
    final = {s: tidy(_round_floats(e)) for s, e in match.exprs.items()}
    loose = {s: e if e.is_Symbol or e == 0 else loosen(e) for s, e in final.items()}
    errors = measure_errors(loose, runs, inputs)
    return replace(match, exprs=final, errors=errors)


def _as_loose(expr: sympy.Expr) -> sympy.Expr:
    """Floats again, unless the whole is one bare column."""
    return expr if expr.is_Symbol or expr.is_Number else loosen(expr)


def _bits(match: Match, level: Noise) -> float:
    """Bits of formulas and misses, each constant with the digits that its error supports."""
    written = 0.0
    for state, expr in match.exprs.items():
        template, values = free_constants(expr, "constant ")
        pairs = zip(values, match.errors[state], strict=True)
        written += complexity(
            template.xreplace({c: sympy.Float(_rounded(*pair)) for c, pair in pairs})
        )
    return written + data_bits(match.misses, level)


def _snap_by_errors(
    match: Match, runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr], level: Noise
) -> Match:
    """Snap each state's surest constant, fit the others again, and so on, while bits fall."""
    least = _bits(match, level)
    for _ in range(_MOST_ROUNDS):
        snapped = {s: _snap_surest(e, match.errors[s]) for s, e in match.exprs.items()}
        if snapped == match.exprs:
            break
        following = match_trajectories(snapped, runs, inputs=inputs)
        reached = _bits(following, level) if following.success else math.inf
        if not reached <= least + _TIE_BITS:
            break
        match, least = following, reached
    return match


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


def _round_floats(expr: sympy.Expr) -> sympy.Expr:
    return expr.xreplace(
        {a: sympy.Float(float(f"{float(a):.9e}")) for a in expr.atoms(sympy.Float)}
    )
