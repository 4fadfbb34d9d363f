"""Whole systems compared on the measured states: which terms the data themselves ask for.

Slopes of noisy data are biased by their smoother, and a formula that follows the bias may beat the
true one on them. Here whole systems are compared on the states: every candidate system is
integrated over long windows with fitted starts and constants (multiple shooting; Bock 1981), and
costs the bits of :func:`dynsr.fit.information_criterion`. From the chosen equations the search
climbs: another formula of the front, one term fewer, v for sin(v) or sin(v) for v, one factor of a
term more or fewer, and one more term, all from one library. What the linearised fit expects most
of is tried first: every change is a direction in the space of right-hand sides, one integration
with the sensitivities to all of them gives their Gram matrix, and from it the misses after any
change.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import sympy

from dynsr.data import Trajectory
from dynsr.fit import (
    Flow,
    Shooting,
    Windows,
    constant_bits,
    cut_windows,
    drives_of,
    free_constants,
    independent_rows,
    information_criterion,
    neighbours,
    noise_and_spread,
    shift_bits,
    skeleton,
    structure_bits,
    with_floats,
)
from dynsr.methods import MonomialLibrary

Equations = dict[str, sympy.Expr]
Probes = Sequence[tuple[int, sympy.Expr]]

# A new constant starts here and is fitted.
_SMALL = sympy.Float(1e-6)
# Below this share of its size a direction is only rounding away from the others.
_NOTHING = 1e-9


@dataclass(frozen=True)
class ComparisonSettings:
    """Settings of a comparison of whole systems; they stand in a run's record.

    Parameters
    ----------
    terms : the library whose terms may be added and whose factors may come or go.
    noisy : systems are compared only where the median noise is above this share of the spread.
        Smaller noise is no larger than errors that a solver at a loose tolerance leaves in its
        states; those have a pattern, and terms would be found for it.
    alternatives : other formulas of each state's front that are tried.
    rounds, rounds_long : changes taken at most, on windows of the first and of the longer length.
    tried : changes, those expected to save most first, that are fitted in a round.
    paired : terms, and changes paired with one, that are looked at for each state.
    margin : a change expected to cost up to so many bits more is fitted too: expectations are
        rough.
    windows : pieces of the data at most.
    length, longest : intervals of a window at first and at most.
    follows : longer windows are taken while misses stay within this factor of the noise.
    strides : rows a step that are tried, longest first.
    stride_error : a stride may move a state by this share of the noise.
    steps, gain : most steps of a fit, and the relative gain below which it ends.
    cap : misses beyond this many noise units count as this many, so that few bad rows do not
        decide.
    """

    terms: MonomialLibrary = MonomialLibrary()
    noisy: float = 3e-3
    alternatives: int = 2
    rounds: int = 4
    rounds_long: int = 1
    tried: int = 5
    paired: int = 6
    margin: float = 5.0
    windows: int = 40
    length: int = 100
    longest: int = 1000
    follows: float = 1.25
    strides: tuple[int, ...] = (8, 5, 3, 2)
    stride_error: float = 0.05
    steps: int = 8
    gain: float = 1e-4
    cap: float = 6.0


@dataclass(frozen=True, eq=False)
class SystemFit:
    """A system fitted to the states.

    ``misses`` (rows, k, W) are in units of each state's noise, ``mean_squares`` (k,) their mean
    squares; ``bits`` is the system's description length.
    """

    exprs: Equations
    shooting: Shooting
    constants: np.ndarray
    starts: np.ndarray
    misses: np.ndarray
    mean_squares: np.ndarray
    bits: float = math.inf


@dataclass(frozen=True, eq=False)
class SystemComparison:
    """Fits systems to the states and counts their bits.

    Parameters
    ----------
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t`` where it is known.
    noise : (k,) standard deviation of each state's measurement noise.
    length : intervals of a window.
    stride : rows a step of the integration.
    rows : (k,) independent rows of each state; None takes those of each fit.
    settings : the numbers that decide.
    """

    runs: Sequence[Trajectory]
    inputs: Mapping[str, sympy.Expr]
    noise: np.ndarray
    length: int
    stride: int = 1
    rows: np.ndarray | None = None
    settings: ComparisonSettings = ComparisonSettings()
    _cache: dict[str, SystemFit | None] = field(default_factory=dict)

    @cached_property
    def windows(self) -> Windows:
        """The pieces of the data, as lanes."""
        driven = self.runs[0].input_names
        return cut_windows(
            [run.t for run in self.runs],
            [run.x for run in self.runs],
            drives_of(driven, self.runs, self.inputs),
            self.length,
            self.settings.windows,
        )

    def with_rows(self, rows: np.ndarray) -> SystemComparison:
        """Compare on the same data with other independent rows."""
        other = replace(self, rows=rows, _cache={})
        other.__dict__["windows"] = self.windows
        return other

    def fit(self, exprs: Equations, near: SystemFit | None = None) -> SystemFit | None:
        """Fit every constant and start; None where the system cannot be followed."""
        key = str({s: skeleton(e) for s, e in exprs.items()})
        if key not in self._cache:
            self._cache[key] = self._fit(exprs, near)
        return self._cache[key]

    def _fit(self, exprs: Equations, near: SystemFit | None) -> SystemFit | None:
        shooting, constants = self.shoot(exprs)
        starts = shooting.windows.x[0]
        if near is not None and near.starts.shape == starts.shape:
            starts = near.starts
        with np.errstate(all="ignore"):
            if not np.all(np.isfinite(shooting.misses(constants, starts))):
                return None
            constants, starts = shooting.minimise(
                constants, starts, "linear", math.inf, self.settings.steps, self.settings.gain
            )
            misses = shooting.misses(constants, starts)
        put = dict(zip(shooting.flow.constants, map(sympy.Float, constants), strict=True))
        fitted = {s: e.xreplace(put) for s, e in shooting.flow.rhs.items()}
        squares = np.mean(np.minimum(misses**2, self.settings.cap**2), axis=(0, 2))
        fit = SystemFit(fitted, shooting, constants, starts, misses, np.maximum(squares, 1e-12))
        return replace(fit, bits=self.bits(fit))

    def shoot(self, exprs: Equations, probes: Probes = ()) -> tuple[Shooting, np.ndarray]:
        """Give the boundary value problem of a system with ``probes``, and its constants."""
        rhs: Equations = {}
        values: dict[sympy.Symbol, float] = {}
        for state, expr in exprs.items():
            rhs[state], found = free_constants(expr, f"constant {state} ")
            values.update(found)
        numbered = [sympy.Symbol(f"probe {i}") for i in range(len(probes))]
        flow = Flow(rhs, self.runs[0].input_names, (*values, *numbered), self.stride, tuple(probes))
        constants = np.array([*values.values(), *[0.0] * len(probes)])
        return Shooting(flow, self.windows, self.noise, True), constants

    def rows_of(self, fit: SystemFit) -> np.ndarray:
        """(k,) independent rows that count."""
        return self.rows if self.rows is not None else independent_rows(fit.misses)

    def bits(self, fit: SystemFit) -> float:
        """Bits of misses, terms and constants."""
        rows, exprs = self.rows_of(fit), fit.exprs.values()
        return information_criterion(fit.mean_squares, rows, exprs, len(fit.constants))


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


def promising_changes(comparison: SystemComparison, fit: SystemFit) -> list[Change]:
    """Give the changes of one equation that the linearised fit expects most of, the best first."""
    settings = comparison.settings
    moves, probes = _make_moves(comparison, fit)
    if not moves:
        return []
    gram = _gram(comparison, fit, probes)
    if not np.all(np.isfinite(gram)):
        return []
    rows = comparison.rows_of(fit)
    # Squared misses over their mean square are squared z-scores, of independent rows alone.
    per_square = shift_bits(1.0) * float(np.mean(rows / fit.misses[:, 0].size / fit.mean_squares))
    before = gram[-1, -1]
    of_constant = constant_bits(float(np.max(rows)))
    values = fit.constants
    single = [(_expected_squares(gram, values, m) - before, m) for m in moves]
    paired = []
    for state in fit.exprs:
        mine = [(squares, m) for squares, m in single if m.state == state]
        grown = sorted((p for p in mine if p[1].free), key=lambda p: p[0])[: settings.paired]
        pairs = [(m, more) for _, m in mine if not m.free for _, more in grown]
        squares = [_expected_squares(gram, values, replace(m, free=more.free)) for m, more in pairs]
        best = np.argsort(squares, kind="stable")[: settings.paired]
        paired += [(squares[i] - before, _join(pairs[i][0], pairs[i][1], fit)) for i in best]
    found = []
    for gained, move in [*single, *paired]:
        cost = structure_bits(move.expr) - structure_bits(fit.exprs[move.state])
        cost += of_constant * (len(move.free) - len(move.out))
        found.append(Change(move.state, move.expr, gained * per_square + cost))
    found = [change for change in found if change.bits < settings.margin]
    return sorted(found, key=lambda c: (c.bits, str(c.expr)))[: settings.tried]


def _make_moves(
    comparison: SystemComparison, fit: SystemFit
) -> tuple[list[_Move], list[tuple[int, sympy.Expr]]]:
    """Give all single changes; a probe has the column of its place after the constants'."""
    moves: list[_Move] = []
    probes: list[tuple[int, sympy.Expr]] = []
    names = comparison.runs[0].names
    terms = comparison.settings.terms.for_names(names).functions
    factors = [factor for factor, *_ in comparison.settings.terms.factors(names)]
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
        others = [*neighbours(expr), *swap_everywhere(expr), *toggle_factors(expr, factors)]
        changed = {skeleton(e): e for e in others}
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


def _join(move: _Move, more: _Move, fit: SystemFit) -> _Move:
    """Make a change and add the term of another."""
    added = more.expr - fit.exprs[move.state]
    bottom = sympy.fraction(move.expr)[1]
    term = sympy.fraction(sympy.together(added))[0].as_coeff_Mul()[1]
    wider = _over_one(move.expr + _SMALL * term / bottom)
    return _Move(move.state, wider, move.out, move.whole, more.free)


def _gram(comparison: SystemComparison, fit: SystemFit, probes: Probes) -> np.ndarray:
    """Products of the slopes by constants and probes, and of the misses as the last column."""
    shooting, constants = comparison.shoot(fit.exprs, probes)
    with np.errstate(all="ignore"):
        misses, by_constant, by_start = shooting.linearise(constants, fit.starts)
        by_lane = misses.transpose(2, 0, 1).reshape(by_start.shape[0], -1, 1)
        columns = np.concatenate([by_constant, by_lane], axis=2)
        if not np.all(np.isfinite(columns)):
            return np.full((1, 1), np.nan)
    # What free starts can follow is no merit of a term.
    basis = np.linalg.qr(by_start)[0]
    columns = columns - basis @ (basis.transpose(0, 2, 1) @ columns)
    flat = columns.reshape(-1, columns.shape[-1])
    gram: np.ndarray = flat.T @ flat
    return gram


def _expected_squares(gram: np.ndarray, values: np.ndarray, move: _Move) -> float:
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


def toggle_factors(expr: sympy.Expr, factors: Sequence[sympy.Expr]) -> list[sympy.Expr]:
    """Multiply one term above the fraction line by a factor, or divide it where it has that factor.

    >>> x, y = sympy.symbols("x y")
    >>> [str(e) for e in toggle_factors(2 * y * sympy.sin(x), [y, sympy.cos(x)])]
    ['2*sin(x)', '2*y*sin(x)*cos(x)']
    """
    top, bottom = sympy.fraction(expr)
    terms = sympy.Add.make_args(top)
    found = []
    for factor in factors:
        for i, term in enumerate(terms):
            has = factor in term.as_powers_dict()
            changed = term / factor if has else term * factor
            found.append(sympy.Add(*terms[:i], changed, *terms[i + 1 :]) / bottom)
    return found


def compare_systems(
    exprs: Mapping[str, sympy.Expr],
    alternatives: Mapping[str, Sequence[sympy.Expr]],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr] | None = None,
    settings: ComparisonSettings = ComparisonSettings(),
) -> Equations:
    """Give the equations whose terms the states support best, climbing from ``exprs``.

    Parameters
    ----------
    exprs : state -> the equation chosen so far; every state of the data has one.
    alternatives : state -> other formulas that were found for it.
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t`` where it is known.
    settings : the numbers that decide.

    An equation that nothing beats comes back as it was given, and so does one that is one bare
    column, such as q' = v. All come back so where the data cannot be followed, and where their
    noise is below 0.3 % of the spread: there slopes are good enough.
    """
    names = runs[0].states
    if set(exprs) != set(names):
        return dict(exprs)
    chosen = {s: with_floats(exprs[s]) for s in names}
    others = [
        {s: with_floats(e)} for s in names for e in alternatives.get(s, ())[: settings.alternatives]
    ]
    noise, spread = noise_and_spread(runs)
    if float(np.median(noise / np.maximum(spread, 1e-300))) < settings.noisy:
        return dict(exprs)
    noise = np.maximum(noise, 1e-9 * spread)
    comparison = SystemComparison(runs, inputs or {}, noise, settings.length, settings=settings)
    best = comparison.fit(chosen)
    if best is None:
        return dict(exprs)
    comparison = replace(comparison, stride=_choose_stride(comparison, best))
    best = _climb(comparison, best, others, settings.rounds)
    longest = min(settings.longest, max(map(len, runs)) - 1)
    for length in (longest, longest // 3):
        longer = replace(comparison, length=length, _cache={})
        refitted = longer.fit(best.exprs) if length > comparison.length else None
        if refitted is not None and np.max(refitted.mean_squares) < settings.follows**2:
            best = _climb(longer, refitted, [], settings.rounds_long)
            break
    same = {s: skeleton(best.exprs[s]) == skeleton(chosen[s]) for s in names}
    return {s: exprs[s] if same[s] else best.exprs[s] for s in names}


def _choose_stride(comparison: SystemComparison, fit: SystemFit) -> int:
    """Give the longest stride that moves no state by more than a share of the noise."""
    settings = comparison.settings
    even = all(np.ptp(np.diff(run.t)) <= 1e-6 * np.mean(np.diff(run.t)) for run in comparison.runs)
    for stride in settings.strides if even else ():
        shooting, constants = replace(comparison, stride=stride).shoot(fit.exprs)
        with np.errstate(all="ignore"):
            moved = np.max(np.abs(shooting.misses(constants, fit.starts) - fit.misses))
        if moved < settings.stride_error:
            return stride
    return 1


def _climb(
    comparison: SystemComparison, fit: SystemFit, alternatives: Sequence[Equations], rounds: int
) -> SystemFit:
    """Take the best change until none takes fewer bits; alternatives are tried in the first."""
    for number in range(rounds):
        # How many rows are independent is seen in the misses of the best system.
        comparison = comparison.with_rows(independent_rows(fit.misses))
        fit = replace(fit, bits=comparison.bits(fit))
        changes = [{c.state: c.expr} for c in promising_changes(comparison, fit)]
        trials = [{**fit.exprs, **c} for c in [*changes, *(() if number else alternatives)]]
        fits = [comparison.fit(exprs, fit) for exprs in trials]
        best = min([fit, *(f for f in fits if f is not None)], key=lambda f: f.bits)
        if best is fit:
            break
        fit = best
    return fit
