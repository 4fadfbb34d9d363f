"""Ensembles: how sure are the terms and constants of an equation, by the bootstrap.

Every member of an ensemble sees trajectories, or windows of them, drawn with replacement, fits
the terms again and drops those that do not pay for themselves. The share of members that keep a
term is its inclusion probability, and the spread of its coefficient an interval (the bagging of
Fasel et al. 2022, "Ensemble-SINDy", with the description length in the place of a threshold).

The fit is that of the weak form (Schaeffer and McCalla 2017): with a bump phi that vanishes at the
ends of a window, the integral of phi' x is minus that of phi f(x). No slope is ever taken, so no
smoother biases the intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import Trajectory, at_own_rows, weak_form
from dynsr.discovery.result import Discovery, Inclusion
from dynsr.discovery.unmeasured import refuse_hidden
from dynsr.errors import InputError
from dynsr.expression import ByText, compile_numpy, counting, expand_terms, shown
from dynsr.fit import (
    Noise,
    ParetoFront,
    constant_bits,
    data_bits,
    eliminate,
    residual_noise,
    structure_bits,
)
from dynsr.jobs import check_seed, spread

_TOO_FEW = "{} rows are too few for an ensemble; give at least 24"


@dataclass(frozen=True)
class Term:
    """One term of an equation: how often it was kept, and the interval of its coefficient."""

    expr: sympy.Expr
    probability: float
    median: float
    interval: tuple[float, float]


@checked
def bootstrap(
    found: Discovery,
    *,
    members: int = 100,
    level: float = 0.95,
    alternatives: int = 3,
    pieces: int = 20,
    seed: int = 0,
    jobs: int = 1,
) -> dict[str, list[Term]]:
    """Give every term of every equation, and of the next best formulas, with its certainty.

    Parameters
    ----------
    found : a discovery that still has its data.
    members : ensembles drawn.
    level : share of members that the interval holds.
    alternatives : formulas of the front whose terms compete with those of the equation.
    pieces : pieces of equal length that each trajectory is drawn in, where there are fewer than
        five trajectories; otherwise these are drawn whole.
    seed, jobs : the result depends on the seed, not on the jobs.

    A term costs :func:`term_bits`, and a member keeps the terms of least description length.
    Raises InputError when the data are not there or the equations are a map.

    >>> from dynsr.discovery.search import discover
    >>> t = np.linspace(0, 3, 301)
    >>> found = discover((t, np.exp(-0.5 * t)[:, None]), preset="quick", jobs=1)
    >>> [(str(term.expr), term.probability) for term in bootstrap(found, members=20)["x"]][0]
    ('x', 1.0)
    """
    if not found.trajectories:
        raise InputError("the data are not here; discover again before asking for an ensemble")
    if found.is_map:
        raise InputError("an ensemble fits slopes; a map has none, its errors are of one step")
    refuse_hidden(found.hidden, "an ensemble fits slopes")
    if members < 2 or not 0 < level < 1:
        raise InputError(f"{members} members at level {level}; give two or more and 0 < level < 1")
    result = {}
    sequences = np.random.SeedSequence(check_seed(seed)).spawn(len(found.equations))
    for (state, expr), sequence in zip(found.equations.items(), sequences, strict=True):
        exprs, bottom = _terms(expr, [c.expr for c in list(found.front[state])[-alternatives:]])
        own = at_own_rows(found.carried, state)
        runs = [_weaken(run, state, exprs, bottom, pieces) for run in own]
        blocks = [_join(run) for run in runs] if len(runs) >= 5 else [b for r in runs for b in r]
        whole = _join(blocks)
        coefficients = np.linalg.lstsq(whole.values.T, whole.y, rcond=None)[0]
        noise = residual_noise([whole.y - coefficients @ whole.values], whole.y)
        with counting(found.own_bits):
            bits = term_bits(exprs, noise)
        calls = [(blocks, noise, bits, child) for child in sequence.spawn(members)]
        draws = dict(spread(_fit_member, calls, jobs))
        result[state] = _summarise(exprs, np.array([draws[i] for i in range(members)]), level)
    return result


@dataclass(frozen=True, eq=False)
class _Weak:
    """Integrals of terms, (m, r), and of the slope, (r,), over the windows of one block."""

    values: np.ndarray
    y: np.ndarray


def _join(blocks: Sequence[_Weak]) -> _Weak:
    return _Weak(
        np.concatenate([b.values for b in blocks], axis=1), np.concatenate([b.y for b in blocks])
    )


def _weaken(
    run: Trajectory, state: str, exprs: Sequence[sympy.Expr], bottom: sympy.Expr, pieces: int
) -> list[_Weak]:
    """Give one block for each piece of a trajectory, of the bumps whose middle lies there."""
    evaluated = compile_numpy([*exprs, bottom], [*run.names, "t"])
    *rows, below = evaluated(np.concatenate([run.columns.T, run.t[None]]))
    values = np.array(rows) / below
    width = max(8, len(run) // pieces)
    try:
        weak = weak_form(run, state, [width])
    except InputError:
        raise InputError(_TOO_FEW.format(len(run))) from None
    count = len(weak.y)
    if count < 4:
        raise InputError(_TOO_FEW.format(len(run)))
    owner = np.arange(count) * pieces // count
    integrals = values @ weak.matrix.T
    return [_Weak(integrals[:, owner == b], weak.y[owner == b]) for b in np.unique(owner)]


def _terms(
    expr: sympy.Expr, alternatives: Sequence[sympy.Expr]
) -> tuple[tuple[sympy.Expr, ...], sympy.Expr]:
    """Terms of the equation and, where it is a sum, of the alternatives; and its denominator."""
    top, bottom = sympy.fraction(sympy.together(expr)) if _is_ratio(expr) else (expr, sympy.S.One)
    found = list(sympy.Add.make_args(expand_terms(top)))
    if bottom == 1:
        for other in alternatives:
            terms = sympy.Add.make_args(expand_terms(other))
            found += [] if any(map(_has_constants, terms)) else terms
    bare = dict.fromkeys(term.as_coeff_Mul()[1] for term in found if term != 0)
    return tuple(bare), bottom


def _has_constants(term: sympy.Expr) -> bool:
    """Whether a term has constants inside, which an ensemble does not fit."""
    return bool(sympy.fraction(term)[1].is_Add or term.as_coeff_Mul()[1].atoms(sympy.Float))


def _is_ratio(expr: sympy.Expr) -> bool:
    return bool(sympy.fraction(expr)[1].free_symbols)


def term_bits(exprs: Sequence[sympy.Expr], noise: Noise) -> np.ndarray:
    """(m,) bits that each of m terms adds to the sum of them all, its coefficient included."""
    terms = [sympy.Float(0.5) * e for e in exprs]
    whole = structure_bits(sympy.Add(*terms))
    without = [structure_bits(sympy.Add(*terms[:i], *terms[i + 1 :])) for i in range(len(terms))]
    return whole - np.array(without) + constant_bits(noise.effective_rows)


def _fit_member(
    blocks: Sequence[_Weak], noise: Noise, bits: np.ndarray, sequence: np.random.SeedSequence
) -> np.ndarray:
    """(m,) coefficients on one draw; 0 for a term that was dropped."""
    rng = np.random.default_rng(sequence)
    drawn = _join([blocks[i] for i in rng.integers(0, len(blocks), len(blocks))])
    found, least = np.zeros(len(bits)), np.inf
    for kept, coefficients in eliminate(drawn.values.T, drawn.y, robust=True, unit=noise.floor):
        chosen = list(kept)
        misses = drawn.y - coefficients @ drawn.values[chosen]
        length = data_bits(misses, noise) + float(np.sum(bits[chosen]))
        if length < least:
            least, found = length, np.zeros(len(bits))
            found[chosen] = coefficients
    return found


def _summarise(exprs: Sequence[sympy.Expr], draws: np.ndarray, level: float) -> list[Term]:
    tails = [(1 - level) / 2, (1 + level) / 2]
    terms = []
    for expr, column in zip(exprs, draws.T, strict=True):
        kept = column[column != 0]
        low, high = np.quantile(kept, tails) if len(kept) else (0.0, 0.0)
        middle = float(np.median(kept)) if len(kept) else 0.0
        share = len(kept) / len(column)
        terms.append(Term(expr, share, middle, (float(low), float(high))))
    return sorted(terms, key=lambda term: (-term.probability, ByText(term.expr)))


# Draws of an ensemble that is asked for by its name alone.
MEMBERS = 100
_FEWEST_ROWS = 24
# Formulas of the front of at most so many terms more compete with the equation.
_MORE_TERMS = 2


def check_ensemble(ensemble: bool | int, runs: Sequence[Trajectory], discrete: bool) -> int:
    """Give the draws of an ensemble, 0 for none.

    Parameters
    ----------
    ensemble : True, or how many draws.
    runs : the data.
    discrete : whether a map is sought.

    Raises InputError where there can be none.

    >>> check_ensemble(True, [], False)
    100
    """
    if ensemble is True or not ensemble:
        members = MEMBERS if ensemble else 0
    elif not isinstance(ensemble, int) or ensemble < 2:
        raise InputError(f"ensemble {ensemble!r} must be True, or a number of draws, 2 or more")
    else:
        members = ensemble
    if members and discrete:
        raise InputError("an ensemble fits slopes; a map has none, its errors are of one step")
    short = min(map(len, runs), default=_FEWEST_ROWS)
    if members and short < _FEWEST_ROWS:
        raise InputError(_TOO_FEW.format(short))
    return members


def _alternatives(expr: sympy.Expr, front: ParetoFront) -> ParetoFront:
    """Give the formulas of a front that have few more terms than the equation."""
    most = len(sympy.Add.make_args(expand_terms(expr))) + _MORE_TERMS
    return ParetoFront(c for c in front if len(sympy.Add.make_args(expand_terms(c.expr))) <= most)


def with_ensemble(found: Discovery, members: int, seed: int) -> Discovery:
    """Give a discovery with the terms of an ensemble of fits.

    Parameters
    ----------
    found : a discovery that still has its data.
    members : ensembles drawn; 0 gives the discovery as it is.
    seed : all chance comes from it.
    """
    if not members or not found.complete:
        return found
    front = {
        state: _alternatives(found.equations[state], own) for state, own in found.front.items()
    }
    terms = bootstrap(replace(found, front=front), members=members, seed=seed)
    ensemble = {
        state: tuple(Inclusion(shown(t.expr), t.probability, *t.interval) for t in own)
        for state, own in terms.items()
    }
    return replace(found, ensemble=ensemble)
