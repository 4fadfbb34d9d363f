"""Changes: what the linearised fit of a system expects of other equations.

Every change of an equation is a direction in the space of right-hand sides: v for sin(v), one
term fewer, one term more. One integration with the sensitivities to all of them gives their Gram
matrix, and from it the misses after any change, the other constants fitted anew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
import sympy

from dynsr.judging import Fit, Judge, form_of, term_bits
from dynsr.methods.variation import neighbours

_MOST_TRIED = 5
_MOST_PAIRED = 6
# Expected bits are rough; a change that seems to lose this many may still gain.
_MARGIN = 5.0
# A new constant starts here and is fitted.
_SMALL = sympy.Float(1e-6)
# Below this share of its size a direction is only rounding away from the others.
_NOTHING = 1e-9


@dataclass(frozen=True)
class Change:
    """One equation otherwise, and the bits that it is expected to take more (or less, below 0)."""

    state: str
    expr: sympy.Expr
    bits: float


@dataclass(frozen=True)
class _Move:
    """A change as columns of the Gram matrix: those taken out, put in whole, and set free."""

    state: str
    expr: sympy.Expr
    out: tuple[int, ...] = ()
    whole: tuple[int, ...] = ()
    free: tuple[int, ...] = ()


def promising_changes(judge: Judge, fit: Fit) -> list[Change]:
    """Give the changes of one equation that the linearised fit expects most of, the best first."""
    moves, probes = _make_moves(judge, fit)
    if not moves:
        return []
    gram = _gram(judge, fit, probes)
    if not np.all(np.isfinite(gram)):
        return []
    shares = judge.rows_of(fit) / fit.misses[:, 0].size
    per_square = float(np.mean(shares / fit.level)) / (2 * math.log(2))
    before = gram[-1, -1]
    price = judge.price_of(fit)
    values = fit.constants
    single = [(_left(gram, values, m) - before, m) for m in moves]
    paired = []
    for state in fit.exprs:
        mine = [(left, m) for left, m in single if m.state == state]
        grown = sorted((p for p in mine if p[1].free), key=lambda p: p[0])[:_MOST_PAIRED]
        pairs = [(m, more) for _, m in mine if not m.free for _, more in grown]
        lefts = [_left(gram, values, replace(m, free=more.free)) for m, more in pairs]
        best = np.argsort(lefts, kind="stable")[:_MOST_PAIRED]
        paired += [(lefts[i] - before, _join(pairs[i][0], pairs[i][1], fit)) for i in best]
    found = []
    for left, move in [*single, *paired]:
        dearer = term_bits(move.expr) - term_bits(fit.exprs[move.state])
        dearer += price * (len(move.free) - len(move.out))
        found.append(Change(move.state, move.expr, left * per_square + dearer))
    found = sorted((c for c in found if c.bits < _MARGIN), key=lambda c: (c.bits, str(c.expr)))
    return found[:_MOST_TRIED]


def _make_moves(judge: Judge, fit: Fit) -> tuple[list[_Move], list[tuple[int, sympy.Expr]]]:
    """Give all single changes; a probe has the column of its place after the constants'."""
    moves: list[_Move] = []
    probes: list[tuple[int, sympy.Expr]] = []
    terms = library(judge.runs[0].names)
    own = [str(c) for c in fit.shooting.flow.constants]
    count = len(own)
    for row, (state, expr) in enumerate(fit.exprs.items()):
        if expr.is_Symbol:
            # q' = v holds by definition far more often than not.
            continue
        for index in range(count):
            if own[index].startswith(f"constant {state} "):
                lost = expr.xreplace({sympy.Float(float(fit.constants[index])): sympy.S.Zero})
                if lost != expr and not lost.has(sympy.zoo, sympy.nan):
                    moves.append(_Move(state, lost, out=(index,)))
        changed = {
            form_of(e): e for e in [*neighbours(expr), *swap_everywhere(expr), *turn_terms(expr)]
        }
        for other in changed.values():
            moves.append(_Move(state, other, whole=(count + len(probes),)))
            probes.append((row, other - expr))
        bottom = sympy.fraction(expr)[1]
        have = {t.as_coeff_Mul()[1] for t in sympy.Add.make_args(sympy.fraction(expr)[0])}
        for term in terms:
            if term not in have:
                wider = expr + _SMALL * term / bottom
                moves.append(_Move(state, _over_one(wider), free=(count + len(probes),)))
                probes.append((row, term / bottom))
    return moves, probes


def _over_one(expr: sympy.Expr) -> sympy.Expr:
    """Put the terms over one fraction line again."""
    bottoms = {sympy.fraction(t)[1] for t in sympy.Add.make_args(expr)}
    if len(bottoms) != 1 or bottoms == {sympy.S.One}:
        return expr
    return sympy.Add(*[sympy.fraction(t)[0] for t in sympy.Add.make_args(expr)]) / bottoms.pop()


def _join(move: _Move, more: _Move, fit: Fit) -> _Move:
    """Make a change and add the term of another."""
    added = more.expr - fit.exprs[move.state]
    bottom = sympy.fraction(move.expr)[1]
    term = sympy.fraction(sympy.together(added))[0].as_coeff_Mul()[1]
    wider = _over_one(move.expr + _SMALL * term / bottom)
    return _Move(move.state, wider, move.out, move.whole, more.free)


def _gram(judge: Judge, fit: Fit, probes: Sequence[tuple[int, sympy.Expr]]) -> np.ndarray:
    """Products of the slopes by constants and probes, and of the misses as the last column."""
    shooting, constants = judge.shoot(fit.exprs, probes)
    with np.errstate(all="ignore"):
        misses, by_constant, by_start = shooting.linearise(constants, fit.starts)
        left = misses.transpose(2, 0, 1).reshape(by_start.shape[0], -1, 1)
        columns = np.concatenate([by_constant, left], axis=2)
        if not np.all(np.isfinite(columns)):
            return np.full((1, 1), np.nan)
    # What free starts can follow is no merit of a term.
    basis = np.linalg.qr(by_start)[0]
    columns = columns - basis @ (basis.transpose(0, 2, 1) @ columns)
    flat = columns.reshape(-1, columns.shape[-1])
    gram: np.ndarray = flat.T @ flat
    return gram


def _left(gram: np.ndarray, values: np.ndarray, move: _Move) -> float:
    """Sum of squared misses that the linearised fit expects after a change."""
    shift = np.zeros(len(gram))
    shift[-1] = 1.0
    shift[list(move.out)] = -values[list(move.out)]
    shift[list(move.whole)] = 1.0
    loose = [i for i in range(len(values)) if i not in move.out] + list(move.free)
    total = float(shift @ gram @ shift)
    if not loose:
        return total
    block, pull = gram[np.ix_(loose, loose)], gram[loose] @ shift
    scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
    steps = np.linalg.lstsq(block / np.outer(scale, scale), pull / scale, rcond=_NOTHING)[0]
    return total - float(steps @ (pull / scale))


def swap_everywhere(expr: sympy.Expr) -> list[sympy.Expr]:
    """Put sin(v) for every bare v, and v for every sin(v).

    >>> x = sympy.Symbol("x")
    >>> [str(e) for e in swap_everywhere(x / (x**2 + 1))]
    ['sin(x)/(sin(x)**2 + 1)']
    """
    found = []
    for symbol in sorted(expr.free_symbols, key=str):
        hidden = {f: sympy.Dummy() for f in expr.atoms(sympy.Function)}
        bare = expr.xreplace(hidden).xreplace({symbol: sympy.sin(symbol)})
        found.append(bare.xreplace({d: f for f, d in hidden.items()}))
        found.append(expr.xreplace({sympy.sin(symbol): symbol}))
    return [f for f in found if f != expr]


def turn_terms(expr: sympy.Expr) -> list[sympy.Expr]:
    """Multiply one term above the fraction line by cos(v), v an angle, or take its cosine away.

    >>> x, y = sympy.symbols("x y")
    >>> [str(e) for e in turn_terms(y * sympy.sin(x))]
    ['y*sin(x)*cos(x)']
    """
    top, bottom = sympy.fraction(expr)
    terms = sympy.Add.make_args(top)
    angles = {f.args[0] for f in expr.atoms(sympy.sin, sympy.cos) if f.args[0].is_Symbol}
    found = []
    for cosine in (sympy.cos(v) for v in sorted(angles, key=str)):
        for i, term in enumerate(terms):
            turned = term / cosine if term.has(cosine) else term * cosine
            found.append(sympy.Add(*terms[:i], turned, *terms[i + 1 :]) / bottom)
    return found


def library(names: Sequence[str]) -> list[sympy.Expr]:
    """Give the terms that may be added: 1, v, sin, cos, and products of two or three of them.

    >>> [str(term) for term in library(["x"])][:5]
    ['1', 'x', 'sin(x)', 'cos(x)', 'x**2']
    """
    columns = [sympy.Symbol(name) for name in names]
    single = [f for v in columns for f in (v, sympy.sin(v), sympy.cos(v))]
    pairs = [sympy.Mul(*pair) for pair in combinations_with_replacement(columns, 2)]
    mixed = [u * f(v) for u in columns for v in columns for f in (sympy.sin, sympy.cos)]
    squares = [u**2 * sympy.sin(v) for u in columns for v in columns if u != v]
    cubes = [v**3 for v in columns]
    return list(dict.fromkeys([sympy.S.One, *single, *pairs, *mixed, *squares, *cubes]))
