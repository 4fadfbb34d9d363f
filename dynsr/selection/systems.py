"""Whole systems compared on the measured states: which terms the data themselves ask for.

Slopes of noisy data are biased by their smoother, and a formula that follows the bias may beat the
true one on them. Here whole systems compete on the states: every candidate system is integrated
over long windows with fitted starts and constants (multiple shooting; Bock 1981), and pays

    L = sum over states of m/2 log2(mean squared miss) + bits of the terms + log2(m)/2 a constant,

with m independent rows a state (the Bayesian information criterion in bits; Schwarz 1978). From
the chosen equations the search climbs: another formula of the front, one term fewer, v for sin(v)
or sin(v) for v, and one more term. What the linearised fit expects most of is tried first: every
change is a direction in the space of right-hand sides, one integration with the sensitivities to
all of them gives their Gram matrix, and from it the misses after any change.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
import sympy

from dynsr.data import Trajectory, estimate_noise
from dynsr.expression import complexity
from dynsr.fit import (
    KeptWindows,
    ProbedFlow,
    Shooting,
    Windows,
    cut_windows,
    drives_of,
    free_constants,
    loosen,
    neighbours,
)

Equations = dict[str, sympy.Expr]
Probes = Sequence[tuple[int, sympy.Expr]]

_MOST_LANES = 40
_STEPS = 8
_GAIN = 1e-4
# Misses beyond this many units count as this many: a few bad rows do not decide.
_CAP = 6.0
_FOREVER = math.inf


@dataclass(frozen=True, eq=False)
class Fit:
    """A system fitted to the states: its equations, their misses (rows, k, W) and its bits."""

    exprs: Equations
    shooting: Shooting
    constants: np.ndarray
    starts: np.ndarray
    misses: np.ndarray
    bits: float = _FOREVER

    @property
    def level(self) -> np.ndarray:
        """(k,) mean squared miss of every state, in units of its noise."""
        mean: np.ndarray = np.mean(np.minimum(self.misses**2, _CAP**2), axis=(0, 2))
        return np.maximum(mean, 1e-12)


@dataclass(frozen=True, eq=False)
class Judge:
    """Fits systems to the states and counts their bits.

    ``noise`` (k,) is the standard deviation of each state's measurement noise; ``rows`` (k,) how
    many independent rows it has, None until a first fit has shown it.
    """

    runs: Sequence[Trajectory]
    inputs: Mapping[str, sympy.Expr]
    noise: np.ndarray
    length: int
    stride: int = 1
    rows: np.ndarray | None = None
    _cache: dict[str, Fit | None] = field(default_factory=dict)

    @cached_property
    def windows(self) -> Windows:
        """The pieces of the data, as lanes."""
        driven = self.runs[0].input_names
        plain = cut_windows(
            [run.t for run in self.runs],
            [run.x for run in self.runs],
            drives_of(driven, self.runs, self.inputs),
            self.length,
            _MOST_LANES,
        )
        return KeptWindows(plain.t, plain.x, plain.drive)

    def with_rows(self, rows: np.ndarray) -> Judge:
        """Judge the same data by other independent rows."""
        judge = replace(self, rows=rows, _cache={})
        judge.__dict__["windows"] = self.windows
        return judge

    def fit(self, exprs: Equations, near: Fit | None = None) -> Fit | None:
        """Fit every constant and start; None where the system cannot be followed."""
        key = str({s: form_of(e) for s, e in exprs.items()})
        if key not in self._cache:
            self._cache[key] = self._fit(exprs, near)
        return self._cache[key]

    def _fit(self, exprs: Equations, near: Fit | None) -> Fit | None:
        shooting, constants = self.shoot(exprs)
        starts = shooting.windows.x[0]
        if near is not None and near.starts.shape == starts.shape:
            starts = near.starts
        with np.errstate(all="ignore"):
            if not np.all(np.isfinite(shooting.misses(constants, starts))):
                return None
            constants, starts = shooting.minimise(
                constants, starts, "linear", _FOREVER, _STEPS, _GAIN
            )
            misses = shooting.misses(constants, starts)
        put = dict(zip(shooting.flow.constants, map(sympy.Float, constants), strict=True))
        fitted = {s: e.xreplace(put) for s, e in shooting.flow.rhs.items()}
        fit = Fit(fitted, shooting, constants, starts, misses)
        return replace(fit, bits=self.bits(fit))

    def shoot(self, exprs: Equations, probes: Probes = ()) -> tuple[Shooting, np.ndarray]:
        """Give the boundary value problem of a system with ``probes``, and its constants."""
        rhs: Equations = {}
        values: dict[sympy.Symbol, float] = {}
        for state, expr in exprs.items():
            rhs[state], found = free_constants(expr, f"constant {state} ")
            values.update(found)
        numbered = [sympy.Symbol(f"probe {i}") for i in range(len(probes))]
        flow = ProbedFlow(
            rhs, self.runs[0].input_names, (*values, *numbered), self.stride, tuple(probes)
        )
        constants = np.array([*values.values(), *[0.0] * len(probes)])
        return Shooting(flow, self.windows, self.noise, True), constants

    def rows_of(self, fit: Fit) -> np.ndarray:
        """(k,) independent rows that count."""
        return self.rows if self.rows is not None else independent_rows(fit.misses)

    def price_of(self, fit: Fit) -> float:
        """Bits of one constant."""
        return math.log2(max(float(np.max(self.rows_of(fit))), 2.0)) / 2

    def bits(self, fit: Fit) -> float:
        """Bits of misses, terms and constants."""
        data = float(np.sum(self.rows_of(fit) / 2 * np.log2(fit.level)))
        terms = sum(map(term_bits, fit.exprs.values()))
        return data + terms + self.price_of(fit) * len(fit.constants)


def independent_rows(misses: np.ndarray) -> np.ndarray:
    """(k,) independent rows among misses (rows, k, W): two a run of one sign, as in white noise."""
    runs = misses.shape[2] + np.count_nonzero(np.diff(np.signbit(misses), axis=0), axis=(0, 2))
    return np.minimum(2.0 * runs, misses.shape[0] * misses.shape[2])


def term_bits(expr: sympy.Expr) -> float:
    """Bits of a formula without its constants.

    >>> x = sympy.Symbol("x")
    >>> term_bits(2.5 * x) == term_bits(-0.1 * x)
    True
    """
    template, values = free_constants(expr, "constant ")
    one = sympy.Symbol("constant")
    distinct = {s: one * sympy.Integer(1) for s in values}
    # Equal placeholders would merge like terms; a term count does not.
    return complexity(template.xreplace(distinct))


def form_of(expr: sympy.Expr) -> str:
    """Text of a formula that is the same whatever its constants are."""
    return str(free_constants(expr, "c")[0])


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
