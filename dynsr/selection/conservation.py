"""Conservation: what does not change along exact data is conserved by the equations too.

Along a run on which a sum of states rests, each equation can be written with one state in the place
of the others, and a constant. The writings differ at every other sum. Those of a closed system add
up to nothing there too; so where the equations found do not, one of them follows from the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import sympy

from dynsr.data import Trajectory, columns_of
from dynsr.expression import evaluate, expand_terms
from dynsr.fit import structure_bits
from dynsr.selection.relations import VANISHES

# Share of the spread by which a sum that rests may move; largest weight of a state in it.
_RESTING, _WEIGHT = 1e-7, 4
# Bits that another writing may take more.
_LONGER = 15.0


def find_conserved(runs: Sequence[Trajectory], states: Sequence[str]) -> list[dict[str, int]]:
    """Give the sums of states with small whole weights that rest along all runs, at no 0.

    Parameters
    ----------
    runs : exact trajectories.
    states : that may be in them.

    >>> t = np.linspace(0, 3, 20)
    >>> x = np.stack([np.exp(-t), 2 - np.exp(-t), np.sin(t)], axis=1)
    >>> find_conserved([Trajectory(t, x, ("a", "b", "c"))], ("a", "b", "c"))
    [{'a': 1, 'b': 1}]
    """
    places = [runs[0].index(state) for state in states]
    whole = np.concatenate([run.x[:, places] for run in runs])
    moved = np.concatenate([run.x[:, places] - run.x[0, places] for run in runs])
    spread = np.std(moved, axis=0)
    if len(states) < 2 or not np.all(spread > 0) or len(moved) <= len(states):
        return []
    _, sizes, directions = np.linalg.svd(moved / spread, full_matrices=False)
    weights = directions[sizes <= _RESTING * sizes[0]] / spread
    found = []
    for row in _reduced(weights):
        least = float(np.min(np.abs(row[np.abs(row) > VANISHES * np.abs(row).max()])))
        whole_row = np.round(row / least)
        total = whole @ whole_row
        if (
            np.allclose(row / least, whole_row, atol=1e-4)
            and np.max(np.abs(whole_row)) <= _WEIGHT
            # Two states that move as one say nothing of other runs.
            and np.min(np.abs(total)) > 1e-3 * np.max(np.abs(whole * whole_row))
        ):
            found.append({s: int(w) for s, w in zip(states, whole_row, strict=True) if w})
    return found


def _reduced(rows: np.ndarray) -> np.ndarray:
    """Give rows that span the same with as many zeros as elimination makes (Gauss and Jordan)."""
    rows, done = rows.copy(), 0
    for column in range(rows.shape[1]):
        if done == len(rows):
            break
        best = done + int(np.argmax(np.abs(rows[done:, column])))
        if np.abs(rows[best, column]) < VANISHES * np.abs(rows).max():
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] /= rows[done, column]
        for other in range(len(rows)):
            if other != done:
                rows[other] -= rows[other, column] * rows[done]
        done += 1
    return rows[:done]


def conserve(exprs: Mapping[str, sympy.Expr], runs: Sequence[Trajectory]) -> dict[str, sympy.Expr]:
    """Write equations so that what rests along exact runs rests from every other start too.

    Parameters
    ----------
    exprs : state -> equation.
    runs : exact trajectories.

    Gives other writings of the same slopes along the runs; the equations as they are where these
    conserve it, or where every other writing is much longer.

    >>> t = np.linspace(0, 3, 20)
    >>> run = Trajectory(t, np.stack([np.exp(-t), 2 - np.exp(-t)], axis=1), ("a", "b"))
    >>> a, b = sympy.symbols("a b")
    >>> conserve({"a": -a, "b": 2 - b}, [run])["b"]
    a
    """
    found = dict(exprs)
    for weights in find_conserved(runs, tuple(exprs)):
        if _vanishes(found, weights, runs):
            continue
        # A constant in the place of a state is a term more wherever it is carried over.
        other = min(_follow(found, weights), key=lambda one: (_terms(one), _bits(one)))
        if _bits(other) <= _bits(found) + _LONGER:
            found = other
    return found


def _terms(exprs: Mapping[str, sympy.Expr]) -> int:
    return sum(len(sympy.Add.make_args(expr)) for expr in exprs.values())


def _bits(exprs: Mapping[str, sympy.Expr]) -> float:
    return float(sum(structure_bits(expr) for expr in exprs.values()))


def _follow(
    exprs: Mapping[str, sympy.Expr], weights: Mapping[str, int]
) -> Iterator[dict[str, sympy.Expr]]:
    """Give the systems in which one equation follows from the others."""
    for state in weights:
        rest = sympy.Add(*[-w * exprs[s] for s, w in weights.items() if s != state])
        yield {**exprs, state: expand_terms(rest / weights[state])}


def _vanishes(
    exprs: Mapping[str, sympy.Expr], weights: Mapping[str, int], runs: Sequence[Trajectory]
) -> bool:
    """Whether equations add up to nothing where each column takes any of its values."""
    rng, columns = np.random.default_rng(0), columns_of(runs)
    columns |= {name: rng.permutation(columns[name]) for name in runs[0].names}
    with np.errstate(all="ignore"):
        parts = [w * evaluate(exprs[s], columns) for s, w in weights.items()]
        total, size = np.abs(np.sum(parts, axis=0)), np.sum(np.abs(parts), axis=0)
        return bool(np.nanmedian(total) <= VANISHES * np.nanmedian(size))
