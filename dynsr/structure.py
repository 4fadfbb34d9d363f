"""Structure: which terms the measured states themselves ask for.

Slopes of noisy data are biased by their smoother, and a formula that follows the bias may beat the
true one on them. Here whole systems compete on the states: every rival is integrated over long
windows with fitted starts and constants (multiple shooting; Bock 1981), and pays

    L = sum over states of m/2 log2(mean squared miss) + bits of the terms + log2(m)/2 a constant,

with m independent rows a state (the Bayesian information criterion in bits; Schwarz 1978). From
the chosen equations the search climbs: another formula of the front, one term fewer, v for sin(v)
or sin(v) for v, and one more term. What the linearised fit expects most of is tried first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy

from dynsr.changes import promising_changes
from dynsr.derivatives import estimate_noise
from dynsr.judging import Equations, Fit, Judge, form_of, independent_rows
from dynsr.methods.variation import loosen
from dynsr.trajectory import Trajectory

_FIRST_LENGTH = 100
_LONGEST = 1000
_STRIDES = (8, 5, 3, 2, 1)
_ROUNDS = 4
_ROUNDS_LONG = 1
# Noise below this share of the spread is no larger than errors of the kind that a solver at a
# loose tolerance leaves in its states; those have a pattern, and terms would be found for it.
_NOISY = 3e-3
_MOST_RIVALS = 2
# Longer windows are taken while misses stay within this factor of the noise.
_FITS = 1.25


def settle(
    exprs: Mapping[str, sympy.Expr],
    rivals: Mapping[str, Sequence[sympy.Expr]],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr] | None = None,
) -> Equations:
    """Give the equations whose terms the states support best, climbing from ``exprs``.

    Parameters
    ----------
    exprs : state -> the equation chosen so far; every state of the data has one.
    rivals : state -> other formulas that were found for it.
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t`` where it is known.

    An equation that nothing beats comes back as it was given, and so does one that is one bare
    column, such as q' = v. All come back so where the data cannot be followed, and where their
    noise is below 0.3 % of the spread: there slopes are good enough.
    """
    names = runs[0].states
    if set(exprs) != set(names):
        return dict(exprs)
    chosen = {s: _loose(exprs[s]) for s in names}
    others = {s: [_loose(e) for e in rivals.get(s, ())] for s in names}
    noise = np.mean([estimate_noise(run) for run in runs], axis=0)
    spread = np.std(np.concatenate([run.x for run in runs]), axis=0)
    if float(np.median(noise / np.maximum(spread, 1e-300))) < _NOISY:
        return dict(exprs)
    judge = Judge(runs, inputs or {}, np.maximum(noise, 1e-9 * spread), _FIRST_LENGTH)
    best = judge.fit(chosen)
    if best is None:
        return dict(exprs)
    judge = replace(judge, stride=_choose_stride(judge, best))
    best, judge = _climb(judge, best, others)
    longest = min(_LONGEST, max(map(len, runs)) - 1)
    for length in (longest, longest // 3):
        longer = replace(judge, length=length, rows=None, _cache={})
        refitted = longer.fit(best.exprs) if length > judge.length else None
        if refitted is not None and float(np.max(refitted.level)) < _FITS**2:
            best, judge = _climb(longer, refitted, {}, _ROUNDS_LONG)
            break
    same = {s: form_of(best.exprs[s]) == form_of(chosen[s]) for s in names}
    return {s: exprs[s] if same[s] else best.exprs[s] for s in names}


def _loose(expr: sympy.Expr) -> sympy.Expr:
    """Floats for all coefficients, unless the whole is one bare column."""
    return expr if expr.is_Symbol or expr.is_Number else loosen(expr)


def _choose_stride(judge: Judge, fit: Fit) -> int:
    """Give the longest stride that moves no state by more than a twentieth of the noise."""
    even = all(np.ptp(np.diff(run.t)) <= 1e-6 * np.mean(np.diff(run.t)) for run in judge.runs)
    for stride in _STRIDES if even else ():
        shooting, constants = replace(judge, stride=stride).shoot(fit.exprs)
        with np.errstate(all="ignore"):
            moved = np.max(np.abs(shooting.misses(constants, fit.starts) - fit.misses))
        if moved < 0.05:
            return stride
    return 1


def _climb(
    judge: Judge, fit: Fit, rivals: Mapping[str, Sequence[sympy.Expr]], rounds: int = _ROUNDS
) -> tuple[Fit, Judge]:
    """Take the best change until none takes fewer bits; gives the fit and how it was judged."""
    for number in range(rounds):
        # Rows that hang together are seen in what the best system leaves over.
        judge = judge.with_rows(independent_rows(fit.misses))
        fit = replace(fit, bits=judge.bits(fit))
        trials = [{**fit.exprs, c.state: c.expr} for c in promising_changes(judge, fit)]
        if number == 0:
            trials += [
                {**fit.exprs, s: e} for s, found in rivals.items() for e in found[:_MOST_RIVALS]
            ]
        fits = [judge.fit(exprs, fit) for exprs in trials]
        best = min([fit, *(f for f in fits if f is not None)], key=lambda f: f.bits)
        if best is fit:
            break
        fit = best
    return fit, judge
