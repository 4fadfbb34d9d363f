"""Layers: residuals across jumps that no fixed step can follow, integrated adaptively.

Relaxation oscillations and other stiff systems move in layers of a few rows. Their equations are
integrated implicitly from the first row of each run, and again without each of their terms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from dynsr.data import Trajectory
from dynsr.errors import DynsrError
from dynsr.expression import expand_terms
from dynsr.verdict.prediction import predict

# Of longer systems the terms are not tried one by one.
_MOST_TERMS = 16


@dataclass(frozen=True)
class Crossing:
    """How closely equations keep to stiff runs from their first rows.

    Parameters
    ----------
    r2 : (k,) share of each state's variance that is explained.
    missed : (k,) rms miss of each state as a share of its spread.
    late : the same over the last quarter of the rows.
    idle : state -> terms without which all is missed by as little; None where there are too many.
    """

    r2: np.ndarray
    missed: np.ndarray
    late: np.ndarray
    idle: dict[str, list[sympy.Expr]] | None


def cross_layers(
    equations: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    times: float = 10.0,
) -> Crossing | None:
    """Integrate stiff equations over all runs; None where they end early or read measured columns.

    Parameters
    ----------
    equations : state -> right-hand side.
    runs : the measured trajectories.
    inputs : input name -> expression in ``t``.
    times : factor by which more is missed without a term that is needed.

    >>> t = np.linspace(0, 3, 31)
    >>> decay = Trajectory(t, np.exp(-2 * t)[:, None], ("x",))
    >>> found = cross_layers({"x": -2 * sympy.Symbol("x")}, [decay], {})
    >>> bool(found.missed[0] < 1e-6), found.idle
    (True, {'x': []})
    """
    used = {str(s) for e in equations.values() for s in e.free_symbols}
    if used - {*equations, *inputs, "t"}:
        return None
    gaps = _gaps(equations, runs, inputs)
    if gaps is None:
        return None
    columns = [runs[0].index(state) for state in equations]
    measured = np.concatenate([run.x[:, columns] for run in runs])
    spread = np.maximum(np.std(measured, axis=0), 1e-300)
    whole = _rms(gaps) / spread
    late = _rms([gap[-max(1, len(gap) // 4) :] for gap in gaps]) / spread
    terms = {s: sympy.Add.make_args(expand_terms(e)) for s, e in equations.items()}
    idle: dict[str, list[sympy.Expr]] | None = None
    if sum(map(len, terms.values())) <= _MOST_TERMS:
        idle = {state: [] for state in equations}
        for state, term in ((s, t) for s, own in terms.items() for t in own):
            # Taken from a product, a term would leave rounding that no step is short enough for.
            less = {**equations, state: sympy.Add(*(t for t in terms[state] if t != term))}
            other = _gaps(less, runs, inputs)
            most = times * max(float(np.max(whole)), 1e-6)
            if other is not None and np.max(_rms(other) / spread) < most:
                idle[state].append(term.as_coeff_Mul()[1])
    return Crossing(1 - whole**2, whole, late, idle)


def _gaps(
    equations: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
) -> list[np.ndarray] | None:
    """Give the residuals of each run, (n, k)."""
    gaps = []
    for run in runs:
        x = run.x[:, [run.index(state) for state in equations]]
        try:
            gaps.append(predict(equations, x[0], run.t, inputs).x - x)
        except (DynsrError, ArithmeticError):
            return None
    return gaps


def _rms(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)))
