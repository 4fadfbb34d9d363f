"""Polishing: the constants of the chosen equations, together, on all the data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy

from dynsr.data import Samples, Trajectory
from dynsr.expression import complexity
from dynsr.fit.constants import free_constants
from dynsr.fit.description import data_bits, shift_bits, written_bits, written_constant
from dynsr.fit.noise import Noise, is_noisy, residual_noise
from dynsr.fit.settings import FIT, FitSettings
from dynsr.fit.shooting import Match, match_trajectories, measure_errors
from dynsr.fit.snapping import simple_numbers, snap, tidy
from dynsr.fit.variation import loosen, with_floats


def polish(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    samples: Mapping[str, Samples],
    noise: Mapping[str, Noise],
    settings: FitSettings = FIT,
) -> Match:
    """Give the equations with final constants, and the standard error of each of these.

    Clean slopes are trusted: their constants are snapped on all samples, and those that stay
    floats are fitted to the states. Slopes of noisy data are biased by their smoother: there all
    constants are fitted to the states first. A simpler formula is kept when formula and states
    together take fewer bits with it.

    Parameters
    ----------
    exprs : state -> the equation chosen for it.
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t``, where it is known.
    samples, noise : state -> its samples, and what cannot be explained in them.
    settings : the numbers that decide.
    """
    noisy = is_noisy(runs)
    start = {
        s: loosen(e) if noisy else snap(with_floats(e), samples[s], noise[s], settings)
        for s, e in exprs.items()
    }
    match = match_trajectories(start, runs, inputs=inputs, settings=settings)
    if match.success and len(match.misses):
        level = residual_noise([match.misses], np.ones(len(match.misses)))
        # All simple constants at once: one at a time, correlated ones block each other.
        simple = match
        if noisy:
            simple = match_trajectories(exprs, runs, inputs=inputs, settings=settings)
        if simple.success and _bits(simple, level) <= _bits(match, level):
            match = simple
        match = _snap_by_errors(match, runs, inputs, level, settings)
    elif not match.success:
        match = Match.untouched(exprs if noisy else start)
    final = {s: tidy(_round_floats(e)) for s, e in match.exprs.items()}
    loose = {s: e if e.is_Symbol or e == 0 else loosen(e) for s, e in final.items()}
    errors = measure_errors(loose, runs, inputs, settings)
    return replace(match, exprs=final, errors=errors)


def _bits(match: Match, level: Noise) -> float:
    """Description length of formulas and states, each constant written as its error supports."""
    return written_bits(match.exprs, match.errors) + data_bits(match.misses, level)


def _snap_by_errors(
    match: Match,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    level: Noise,
    settings: FitSettings,
) -> Match:
    """Snap each state's surest constant, fit the others again, and so on, while bits fall."""
    least = _bits(match, level)
    for _ in range(settings.snap_rounds):
        snapped = {s: _snap_surest(e, match.errors[s], settings) for s, e in match.exprs.items()}
        if snapped == match.exprs:
            break
        following = match_trajectories(snapped, runs, inputs=inputs, settings=settings)
        reached = _bits(following, level) if following.success else math.inf
        if not reached <= least + settings.tie_bits:
            break
        match, least = following, reached
    return match


def _snap_surest(
    expr: sympy.Expr, pairs: Sequence[tuple[float, float]], settings: FitSettings
) -> sympy.Expr:
    """Snap the constant for which that saves most bits; the formula itself where none does."""
    template, values = free_constants(expr, "constant ")
    written = {
        c: sympy.Float(written_constant(*pair)) for c, pair in zip(values, pairs, strict=True)
    }
    before = complexity(template.xreplace(written))
    best: tuple[float, sympy.Symbol, sympy.Expr] | None = None
    for symbol, (value, error) in zip(values, pairs, strict=True):
        # Integration itself is not surer than the finest; inf costs nothing.
        sure = max(error, settings.finest * abs(value), 1e-300)
        for simple in simple_numbers(value, settings.near):
            changed = template.xreplace({**written, symbol: simple})
            if changed.has(sympy.zoo, sympy.nan):
                continue
            gain = before - complexity(changed) - shift_bits(float(simple) - value, sure)
            if gain > -settings.tie_bits and (best is None or gain > best[0]):
                best = (gain, symbol, simple)
    if best is None:
        return expr
    kept = {s: sympy.Float(v) for s, v in values.items() if s != best[1]}
    return template.xreplace({**kept, best[1]: best[2]})


def _round_floats(expr: sympy.Expr) -> sympy.Expr:
    return expr.xreplace(
        {a: sympy.Float(float(f"{float(a):.9e}")) for a in expr.atoms(sympy.Float)}
    )
