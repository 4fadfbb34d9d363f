"""Ensembles: how sure are the terms and constants of an equation, by the bootstrap.

Every member of an ensemble sees trajectories, or windows of them, drawn with replacement, fits
the terms again and drops those that do not pay for themselves. The share of members that keep a
term is its inclusion probability, and the spread of its coefficient an interval (the bagging of
Fasel et al. 2022, "Ensemble-SINDy", with the description length in the place of a threshold).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy
from joblib import Parallel, delayed

from dynsr.derivatives import choose_samples
from dynsr.errors import InputError
from dynsr.expression import compile_numpy
from dynsr.found import Discovery
from dynsr.methods.feynman.description import Noise, data_bits, estimate_noise
from dynsr.samples import Samples, join

_WINDOWS = 20
# Bits of a coefficient and of the term it stands before.
_TERM_BITS = 20.0


@dataclass(frozen=True)
class Term:
    """One term of an equation: how often it was kept, and the interval of its coefficient."""

    expr: sympy.Expr
    probability: float
    median: float
    interval: tuple[float, float]


def bootstrap(
    found: Discovery,
    *,
    members: int = 100,
    level: float = 0.95,
    rivals: int = 3,
    seed: int = 0,
    jobs: int = 1,
) -> dict[str, list[Term]]:
    """Give every term of every equation, and of the next best formulas, with its certainty.

    Parameters
    ----------
    found : a discovery that still has its data.
    members : ensembles drawn.
    level : share of members that the interval holds.
    rivals : formulas of the front whose terms compete with those of the equation.
    seed, jobs : the result depends on the seed, not on the jobs.

    Windows of a twentieth of a trajectory are drawn, and whole trajectories where there are five
    or more. Raises InputError when the data are not there.

    >>> from dynsr.discovery import discover
    >>> t = np.linspace(0, 3, 301)
    >>> found = discover((t, np.exp(-0.5 * t)[:, None]), preset="quick", jobs=1)
    >>> [(str(term.expr), term.probability) for term in bootstrap(found, members=20)["x"]][0]
    ('x', 1.0)
    """
    if not found.trajectories:
        raise InputError("the data are not here; discover again before asking for an ensemble")
    if members < 2 or not 0 < level < 1:
        raise InputError(f"{members} members at level {level}; give two or more and 0 < level < 1")
    result = {}
    sequences = np.random.SeedSequence(seed).spawn(len(found.equations))
    for (state, expr), sequence in zip(found.equations.items(), sequences, strict=True):
        parts = [choose_samples(run, state) for run in found.trajectories]
        blocks = _cut_blocks(parts)
        terms = _terms(expr, [c.expr for c in list(found.front[state])[-rivals:]])
        noise = estimate_noise([_residual(expr, s) for s in [join(parts)]], join(parts).y)
        draws = Parallel(n_jobs=jobs)(
            delayed(_fit_member)(blocks, terms, noise, child) for child in sequence.spawn(members)
        )
        result[state] = _summarise(terms[0], np.array(list(draws)), level)
    return result


def _cut_blocks(parts: Sequence[Samples]) -> list[Samples]:
    if len(parts) >= 5:
        return list(parts)
    blocks = []
    for part in parts:
        edges = np.linspace(0, len(part), min(_WINDOWS, len(part) // 4) + 1).astype(int)
        blocks += [
            part.select(slice(a, b)) for a, b in zip(edges, edges[1:], strict=False) if b > a
        ]
    return blocks


def _terms(
    expr: sympy.Expr, rivals: Sequence[sympy.Expr]
) -> tuple[tuple[sympy.Expr, ...], sympy.Expr]:
    """Terms of the equation and, where it is a sum, of its rivals; and its denominator."""
    top, bottom = sympy.fraction(sympy.together(expr)) if _is_ratio(expr) else (expr, sympy.S.One)
    found = list(sympy.Add.make_args(sympy.expand(top)))
    if bottom == 1:
        for rival in rivals:
            found += [] if _is_ratio(rival) else sympy.Add.make_args(sympy.expand(rival))
    bare = dict.fromkeys(term.as_coeff_Mul()[1] for term in found if term != 0)
    return tuple(bare), bottom


def _is_ratio(expr: sympy.Expr) -> bool:
    return bool(sympy.fraction(expr)[1].free_symbols)


def _residual(expr: sympy.Expr, samples: Samples) -> np.ndarray:
    evaluated = compile_numpy([expr], [*samples.names, "t"])
    return evaluated(np.concatenate([samples.X.T, samples.t[None]]))[0] - samples.y


def _fit_member(
    blocks: Sequence[Samples],
    terms: tuple[tuple[sympy.Expr, ...], sympy.Expr],
    noise: Noise,
    sequence: np.random.SeedSequence,
) -> np.ndarray:
    """(m,) coefficients on one draw; 0 for a term that was dropped."""
    rng = np.random.default_rng(sequence)
    drawn = join([blocks[i] for i in rng.integers(0, len(blocks), len(blocks))])
    exprs, bottom = terms
    evaluated = compile_numpy([*exprs, bottom], [*drawn.names, "t"])
    *rows, below = evaluated(np.concatenate([drawn.X.T, drawn.t[None]]))
    values = np.array(rows) / below
    keep = list(range(len(exprs)))
    coefficients, bits = _fit(values, keep, drawn.y, noise)
    while len(keep) > 1:
        trials = [_fit(values, [k for k in keep if k != out], drawn.y, noise) for out in keep]
        best = int(np.argmin([bits for _, bits in trials]))
        if trials[best][1] - _TERM_BITS >= bits:
            break
        coefficients, bits = trials[best]
        keep.pop(best)
    full = np.zeros(len(exprs))
    full[keep] = coefficients
    return full


def _fit(
    values: np.ndarray, keep: Sequence[int], y: np.ndarray, noise: Noise
) -> tuple[np.ndarray, float]:
    """Fit robustly (Cauchy weights); gives coefficients and the bits of the misses."""
    columns = values[list(keep)]
    weights = np.ones(len(y))
    coefficients = np.zeros(len(keep))
    for _ in range(5):
        coefficients = np.linalg.lstsq((columns * weights).T, y * weights, rcond=None)[0]
        misses = y - coefficients @ columns
        weights = 1 / np.sqrt(1 + (misses / noise.floor) ** 2)
    return coefficients, data_bits(misses, noise)


def _summarise(exprs: Sequence[sympy.Expr], draws: np.ndarray, level: float) -> list[Term]:
    tails = [(1 - level) / 2, (1 + level) / 2]
    terms = []
    for expr, column in zip(exprs, draws.T, strict=True):
        kept = column[column != 0]
        low, high = np.quantile(kept, tails) if len(kept) else (0.0, 0.0)
        middle = float(np.median(kept)) if len(kept) else 0.0
        share = len(kept) / len(column)
        terms.append(Term(expr, share, middle, (float(low), float(high))))
    return sorted(terms, key=lambda term: (-term.probability, str(term.expr)))


def intervals(terms: Mapping[str, Sequence[Term]]) -> list[tuple[str, str, float, float, float]]:
    """Give rows (state, term, probability, low, high) for a table."""
    return [
        (state, str(term.expr), term.probability, *term.interval)
        for state, found in terms.items()
        for term in found
    ]
