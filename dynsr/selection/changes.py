"""Changes of one equation of a system, ranked by what the linearised fit expects of them.

Every change is a direction in the space of right-hand sides: a constant taken to 0, another
function in the place of one, one more term, a term that saturates. The normal equations with all
of them, at the fitted states, give the misses after any change without a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy
from scipy.linalg import LinAlgError

from dynsr.expression import OPERATORS, compile_columns
from dynsr.fit import (
    Probes,
    neighbours,
    precision_bits,
    shift_bits,
    skeleton,
    usual_scales,
    without_flat_line,
)
from dynsr.library import Written, write_down
from dynsr.selection.comparison import (
    Change,
    Equations,
    SystemComparison,
    SystemFit,
    owners_of,
)
from dynsr.selection.costs import bodies_of
from dynsr.selection.terms import Terms

# A new constant starts here, relative to the size of what it multiplies, and is fitted.
_SMALL = sympy.Float(1e-6)
# Share of the slopes' spread by which a term with a shorter line may be off before it is fitted.
_LIKE = 0.3
# Standard errors from 1 at which a factor may be none, and their share of it at most.
_LIKE_ONE, _KNOWN = 2.0, 0.3
# Below this share of its size a direction is only rounding away from the others.
_NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class _Move:
    """A change as columns of the Gram matrix: those taken out, put in whole, and set free.

    ``build`` makes the equation from that of the state, ``cost`` are the bits of its structure, and
    ``inside`` more constants that are free in it.
    """

    state: str
    build: Callable[[sympy.Expr], sympy.Expr]
    cost: float
    out: tuple[int, ...] = ()
    whole: tuple[int, ...] = ()
    free: tuple[int, ...] = ()
    inside: int = 0


@dataclass(eq=False)
class _Moves:
    """Moves with the slopes (state, values at all points) of their probes, made one by one."""

    first: int
    moves: list[_Move]
    rows: list[int]
    slopes: list[np.ndarray]

    def probe(self, row: int, slope: np.ndarray) -> int:
        """Add the slopes of a direction and give its column."""
        self.rows.append(row)
        self.slopes.append(slope)
        return self.first + len(self.rows) - 1


def promising_changes(comparison: SystemComparison, fit: SystemFit) -> list[Change]:
    """Give the changes of one equation that the linearised fit expects most of, the best first.

    Parameters
    ----------
    comparison : fits the systems.
    fit : the system.
    """
    # Searches from different systems end at the same one.
    if fit not in comparison.expected:
        comparison.expected[fit] = _promising_changes(comparison, fit)
    return comparison.expected[fit]


def _promising_changes(comparison: SystemComparison, fit: SystemFit) -> list[Change]:
    settings, found = comparison.settings, fit.fit
    points = fit.points
    moves = _make_moves(comparison, fit, points)
    if not moves.moves:
        return []
    slopes = np.array(moves.slopes).reshape(-1, points.shape[1])
    gram = gram_of(fit, Probes(np.array(moves.rows, dtype=int), slopes))
    if gram is None:
        return []
    per_square = shift_bits(1.0) / max(float(np.mean(found.mean_squares)), 1e-12)
    paired = settings.paired * settings.parts.has("move-pairs")
    scales = np.concatenate([fit.problem.scales(found), _usual(fit, moves.rows, slopes)])
    ranked = _rank(moves.moves, gram, found.constants, scales, paired)
    constants = precision_bits(found.information, scales[: moves.first])
    changes = []
    for squares, precision, move in ranked:
        bits = (squares - gram[-1, -1]) * per_square + move.cost + precision - constants
        bits += move.inside * constants / max(moves.first, 1)
        changes.append((bits, move))
    changes.sort(key=lambda pair: pair[0])
    best: list[Change] = []
    for bits, move in changes:
        if bits >= settings.margin or len(best) == settings.tried:
            break
        expr = move.build(fit.exprs[move.state])
        if not expr.has(sympy.zoo, sympy.nan, sympy.I):
            best.append(Change(move.state, expr, bits))
    return best


def _usual(fit: SystemFit, rows: Sequence[int], slopes: np.ndarray) -> np.ndarray:
    """(Q,) factors of probes with which they say as much as the equation that they stand in."""
    now = fit.problem.slope(*fit.points, *fit.fit.constants[:, None])
    return usual_scales(now, np.array(rows, dtype=int), slopes)


def _rank(
    moves: Sequence[_Move], gram: np.ndarray, values: np.ndarray, scales: np.ndarray, paired: int
) -> Iterator[tuple[float, float, _Move]]:
    """Give every move, and the best moves of a state with its best terms.

    With each come the squares that are expected, and the bits of the constants.
    """

    def expect(moves: Sequence[_Move]) -> list[tuple[float, float, _Move]]:
        pairs = zip(_expected(gram, values, scales, moves), moves, strict=True)
        return [(squares, bits, move) for (squares, bits), move in pairs]

    single = expect(moves)
    yield from single
    pairs = []
    for state in dict.fromkeys(m.state for m in moves):
        mine = sorted((p for p in single if p[-1].state == state), key=lambda pair: pair[0])
        grown = [m for *_, m in mine if m.free][:paired]
        others = [m for *_, m in mine if not m.free][: 4 * paired]
        for move in others:
            pairs += [_join(move, more) for more in grown]
    yield from expect(pairs)


def _without(expr: sympy.Expr, value: float) -> sympy.Expr | None:
    """Give an equation with a constant at 0; None where it lacks that constant or its value."""
    lost = expr.xreplace({sympy.Float(float(value)): sympy.S.Zero})
    return None if lost == expr or lost.has(sympy.zoo, sympy.nan) else lost


def drop_least(fit: SystemFit, state: str) -> sympy.Expr | None:
    """Give an equation without the constant whose loss the misses are expected to feel least.

    A constant of value c and standard error e is expected to raise the sum of squared misses by
    (c / e)^2 (Wald). None where nothing can go.

    Parameters
    ----------
    fit : the system.
    state : whose equation it is.
    """
    owners = owners_of(fit.exprs)
    values, errors = fit.fit.constants, fit.fit.errors
    with np.errstate(over="ignore"):
        ratios = np.abs(values) / np.maximum(errors, 1e-300)
    for index in np.argsort(ratios, kind="stable"):
        if owners[index] == state:
            lost = _without(fit.exprs[state], values[index])
            if lost is not None and lost != 0:
                return lost
    return None


def prune(comparison: SystemComparison, fit: SystemFit, state: str) -> SystemFit:
    """Take terms out of one equation, that expected to be missed least first, while bits fall.

    A fraction line below which hardly anything changes goes before all, and exponents become whole
    or half ones.

    Parameters
    ----------
    comparison : fits the systems.
    fit : the system.
    state : whose equation loses terms.
    """
    while comparison.settings.parts.has("pruning"):
        for system in _shorter_systems(comparison, fit, state):
            less = comparison.fit_near(system, fit)
            if less is not None and less.bits < fit.bits:
                fit = less
                break
        else:
            break
    return fit


def climb_while_better(
    make: Callable[[SystemFit], Iterable[SystemFit]],
    best: SystemFit,
    climb: Callable[[SystemFit], SystemFit],
    often: int,
) -> SystemFit:
    """Climb from the best of what is made of a system, for as long as that takes fewer bits.

    Parameters
    ----------
    make : gives other systems for one.
    best : the system that is begun with.
    climb : takes changes from a system for as long as they take fewer bits.
    often : times at most.
    """
    for _ in range(often):
        first = min(make(best), key=lambda f: f.bits, default=best)
        if first.bits >= best.bits:
            break
        best = climb(first)
    return best


def _shorter_systems(
    comparison: SystemComparison, fit: SystemFit, state: str
) -> Iterator[Equations]:
    for expr in _shorter(comparison, fit, state):
        if expr is not None:
            yield from comparison.changed(fit, state, expr)


def _shorter(
    comparison: SystemComparison, fit: SystemFit, state: str
) -> Iterator[sympy.Expr | None]:
    """Give shorter equations, each made when the one before it has been turned down."""
    yield _without_line(comparison, fit, state)
    yield _with_shorter_line(comparison, fit, state)
    yield _round_powers(fit.exprs[state])
    yield _without_one(fit, state)
    yield drop_least(fit, state)


def _round_powers(expr: sympy.Expr) -> sympy.Expr | None:
    """Give an equation with the nearest half for every exponent that was set free; None for none.

    >>> x = sympy.Symbol("x")
    >>> _round_powers(2.5 * x**1.97)
    2.5*x**2
    """
    free = [p for p in expr.atoms(sympy.Pow) if p.exp.is_Float]
    nearest = {p: p.base ** sympy.Rational(round(2 * float(p.exp)), 2) for p in free}
    return expr.xreplace(nearest) if free else None


def _with_shorter_line(
    comparison: SystemComparison, fit: SystemFit, state: str
) -> sympy.Expr | None:
    """Give an equation with one part alone below a line, the likest; None where none is like."""
    terms = sympy.Add.make_args(fit.exprs[state])
    others = []
    for i, term in enumerate(terms):
        lines = [1 / factor for factor in sympy.Mul.make_args(term)]
        for below in (line for line in lines if line.is_Add and line.free_symbols):
            changed = (term * below / part for part in below.args)
            others += [sympy.Add(*terms[:i], other, *terms[i + 1 :]) for other in changed]
    if not others:
        return None
    points = fit.points
    values = compile_columns([fit.exprs[state], *others], comparison.columns)(*points)
    with np.errstate(all="ignore"):
        apart = np.nan_to_num(np.std(values[1:] - values[0], axis=1), nan=np.inf)
    place = int(np.argmin(apart))
    return others[place] if apart[place] <= _LIKE * np.std(values[0]) else None


def _without_one(fit: SystemFit, state: str) -> sympy.Expr | None:
    """Give an equation without a factor inside a term that may be 1, the likest; None for none."""
    expr, owners = fit.exprs[state], owners_of(fit.exprs)
    inside = {float(number) for body in bodies_of(expr) for number in body.atoms(sympy.Float)}
    values, errors = np.abs(fit.fit.constants), fit.fit.errors
    with np.errstate(all="ignore"):
        apart = np.where(errors < _KNOWN * values, np.abs(values - 1) / errors, np.inf)
    for index in np.argsort(apart, kind="stable"):
        value = float(fit.fit.constants[index])
        if apart[index] <= _LIKE_ONE and owners[index] == state and value in inside:
            return expr.xreplace({sympy.Float(value): sympy.Integer(round(value))})
    return None


def _without_line(comparison: SystemComparison, fit: SystemFit, state: str) -> sympy.Expr | None:
    if not sympy.fraction(fit.exprs[state])[1].is_Add:
        return None
    points = fit.points
    columns = dict(zip(comparison.columns, points, strict=True))
    return without_flat_line(fit.exprs[state], columns)


def _join(move: _Move, more: _Move) -> _Move:
    """Make one change and then the other."""
    return replace(
        move,
        build=lambda expr: more.build(move.build(expr)),
        cost=move.cost + more.cost,
        free=more.free,
        inside=more.inside,
    )


def _make_moves(comparison: SystemComparison, fit: SystemFit, points: np.ndarray) -> _Moves:
    """Give all single changes; a probe has the column of its place after the constants'."""
    terms = comparison.terms
    values = terms.values(points[:-1])
    owners = owners_of(fit.exprs)
    moves = _Moves(len(owners), [], [], [])
    for row, (state, expr) in enumerate(fit.exprs.items()):
        if expr.is_Symbol:
            # q' = v holds by definition far more often than not.
            continue
        own = _Equation(comparison, fit.exprs, state, row, points, moves)
        for index, owner in enumerate(owners):
            if owner == state:
                lost = _without(expr, fit.fit.constants[index])
                if lost is not None:
                    own.change_to(lost, out=(index,))
        has = comparison.settings.parts.has
        if has("move-terms"):
            _add_terms(own, terms, values)
        if has("move-saturations"):
            _add_saturations(own)
        if has("move-powers"):
            _add_powers(own)
        if has("move-below"):
            _add_below(own)
        if has("move-swaps"):
            _add_swaps(own)
    return moves


@dataclass(frozen=True, eq=False)
class _Equation:
    """One equation of a system, whose changes are gathered with the bits that they cost.

    These are without those of constants.

    Parameters
    ----------
    comparison, exprs : of the system.
    state, row : whose equation it is, and its place in the system.
    points : (columns, n) values of the columns.
    moves : takes the changes.
    """

    comparison: SystemComparison
    exprs: Equations
    state: str
    row: int
    points: np.ndarray
    moves: _Moves

    @property
    def expr(self) -> sympy.Expr:
        """The equation as it is."""
        return self.exprs[self.state]

    @property
    def names(self) -> Sequence[str]:
        """Columns, the time the last."""
        return self.comparison.columns

    def change_to(
        self,
        other: sympy.Expr,
        *,
        out: tuple[int, ...] = (),
        free: np.ndarray | None = None,
        whole: np.ndarray | None = None,
    ) -> None:
        """Add another equation in its place.

        Parameters
        ----------
        other : the equation.
        out : constants that it loses.
        free, whole : slopes by a constant that it has more, or of all that it says more.
        """
        cost = self.comparison.structure({**self.exprs, self.state: other}) - self._own
        more, all_of_it = (() if s is None else (self._probe(s),) for s in (free, whole))
        move = _Move(self.state, _always(other), cost, out=out, free=more, whole=all_of_it)
        self.moves.moves.append(move)

    def add(self, term: sympy.Expr, slope: np.ndarray, inside: int) -> None:
        """Add a term.

        Parameters
        ----------
        term, slope : the term and its values.
        inside : constants inside it.
        """
        cost = self.comparison.term_bits(term, self.state, self._beside)
        place = self._probe(slope)
        self.moves.moves.append(
            _Move(self.state, _adding(term), cost, free=(place,), inside=inside)
        )

    def _probe(self, slope: np.ndarray) -> int:
        return self.moves.probe(self.row, slope)

    @cached_property
    def _own(self) -> float:
        return self.comparison.structure(self.exprs)

    @cached_property
    def _beside(self) -> Written:
        return write_down((s, e) for s, e in self.exprs.items() if s != self.state)

    def parts(
        self,
    ) -> Iterator[tuple[sympy.Expr, sympy.Expr, np.ndarray, sympy.Symbol, np.ndarray]]:
        """Give every term, the others, its values; and with each every column with its values."""
        terms = sympy.Add.make_args(self.expr)
        values = compile_columns(list(terms), self.names)(*self.points)
        for i, (term, own) in enumerate(zip(terms, values, strict=True)):
            rest = sympy.Add(*terms[:i], *terms[i + 1 :])
            for name, column in zip(self.names[:-1], self.points[:-1], strict=True):
                yield term, rest, own, sympy.Symbol(name), column


def _add_terms(own: _Equation, terms: Terms, values: np.ndarray) -> None:
    have = set(bodies_of(sympy.fraction(own.expr)[0]))
    allowed = own.comparison.settings.demands.limits(own.state).allow
    for term, inside, slope in zip(terms.exprs, terms.inside, values, strict=True):
        if term not in have and np.all(np.isfinite(slope)) and allowed(term):
            own.add(term, slope, int(inside))


def _adding(term: sympy.Expr) -> Callable[[sympy.Expr], sympy.Expr]:
    return lambda expr: expr + _SMALL * term


def _always(expr: sympy.Expr) -> Callable[[sympy.Expr], sympy.Expr]:
    return lambda _: expr


def _add_saturations(own: _Equation) -> None:
    """Divide one term of a sum by 1 + c v or 1 + c v^2."""
    for term, rest, values, symbol, column in own.parts():
        for power in (1, 2) if term.free_symbols else ():
            if power == 1 and column.min() <= 0:
                continue
            size = float(np.median(np.abs(column))) ** power or 1.0
            start = sympy.Float(float(f"{0.1 / size:.3g}"))
            other = rest + term / (1 + start * symbol**power)
            own.change_to(other, free=-values * column**power)


def _add_powers(own: _Equation) -> None:
    """Set the exponent of a positive column in one term of a sum free."""
    for term, rest, values, symbol, column in own.parts():
        free = any(p.base == symbol and p.exp.is_Float for p in term.atoms(sympy.Pow))
        if column.min() > 0 and not free:
            own.change_to(rest + term * symbol**_SMALL, free=values * np.log(column))


def _add_below(own: _Equation) -> None:
    """Put one more positive column below a fraction line: x / (k + x) to x / (k + x + c y)."""
    terms = sympy.Add.make_args(own.expr)
    for term in terms:
        for line in sympy.Mul.make_args(term):
            below = 1 / line
            if not (below.is_Add and below.free_symbols):
                continue
            values, size = compile_columns([term * line, below], own.names)(*own.points)
            for name, column in zip(own.names[:-1], own.points[:-1], strict=True):
                symbol = sympy.Symbol(name)
                if column.min() <= 0 or symbol in below.args or below.coeff(symbol) != 0:
                    continue
                start = 0.1 * float(np.median(np.abs(size)) / np.median(column))
                more = term * below / (below + sympy.Float(float(f"{start:.3g}")) * symbol)
                other = sympy.Add(*[t for t in terms if t is not term], more)
                own.change_to(other, free=-values * column)


def _add_swaps(own: _Equation) -> None:
    """Put sin(v) for v or back, and take a factor of a term in or out."""
    expr, names, comparison = own.expr, own.names, own.comparison
    angles = {sympy.Symbol(name) for name in comparison.angles}
    columns = [sympy.Symbol(name) for name in comparison.names]
    functions = [OPERATORS[name].sympy for name in comparison.settings.functions]
    factors = [f for c in columns for f in (c, *(wave(c) for wave in functions if c in angles))]
    others = [*sum_series(expr, map(sympy.Symbol, names)), *toggle_factors(expr, factors)]
    if expr.free_symbols & angles or expr.has(sympy.sin):
        others = [*neighbours(expr), *swap_everywhere(expr), *others]
    changed = list({skeleton(e): e for e in others}.values())
    if not changed:
        return
    values = compile_columns([other - expr for other in changed], names)(*own.points)
    for other, slope in zip(changed, values, strict=True):
        if np.all(np.isfinite(slope)):
            own.change_to(other, whole=slope)


def gram_of(fit: SystemFit, probes: Probes, stiffness: float | None = None) -> np.ndarray | None:
    """Products of the slopes by constants and probes, and of the misses as the last column.

    Parameters
    ----------
    fit : the system.
    probes : Q constants that the system might have.
    stiffness : weight of the defects; by default that of the fit.
    """
    found = fit.fit
    try:
        gram = fit.problem.normal(found.states, found.constants, probes, stiffness).gram
    except (LinAlgError, ValueError):
        return None
    return gram if np.all(np.isfinite(gram)) else None


def _expected(
    gram: np.ndarray, values: np.ndarray, scales: np.ndarray, moves: Sequence[_Move]
) -> list[tuple[float, float]]:
    """Sums of squared misses that the linearised fit expects after each change, and precision."""
    loose = [[i for i in range(len(values)) if i not in m.out] + list(m.free) for m in moves]
    found, precision = np.empty(len(moves)), np.zeros(len(moves))
    for size in set(map(len, loose)):
        alike = [i for i, own in enumerate(loose) if len(own) == size]
        shifts = np.zeros((len(alike), len(gram)))
        shifts[:, -1] = 1.0
        for shift, move in zip(shifts, (moves[i] for i in alike), strict=True):
            shift[list(move.out)] = -values[list(move.out)]
            shift[list(move.whole)] = 1.0
        pulls = shifts @ gram
        found[alike] = np.einsum("bi,bi->b", pulls, shifts)
        if not size:
            continue
        own = np.array([loose[i] for i in alike])
        scale = np.sqrt(np.maximum(np.diag(gram)[own], 1e-300))
        alone = gram[own[:, :, None], own[:, None]]
        scaled = alone / (scale[:, :, None] * scale[:, None])
        usual = scales[own]
        units = np.eye(size) + alone * usual[:, :, None] * usual[:, None]
        precision[alike] = np.linalg.slogdet(units)[1] / (2 * np.log(2))
        pull = np.take_along_axis(pulls, own, axis=1) / scale
        steps = np.linalg.solve(scaled + _NOTHING * np.eye(size), pull[..., None])[..., 0]
        found[alike] -= np.einsum("bi,bi->b", steps, pull)
    return list(zip(found.tolist(), precision.tolist(), strict=True))


def sum_series(expr: sympy.Expr, columns: Iterable[sympy.Symbol]) -> list[sympy.Expr]:
    """Put sin(v) for the first two terms of its series.

    Parameters
    ----------
    expr : the formula.
    columns : variables that may be angles; one that takes no other sign may be one too.

    >>> x, v = sympy.symbols("x v")
    >>> sum_series(0.2 * x**3 - 1.2 * x - v, [x])
    [-v - 1.2*sin(x)]
    """
    terms = dict(zip(bodies_of(expr), sympy.Add.make_args(expr), strict=True))
    return [
        expr - terms[v] - terms[v**3] + terms[v].subs(v, sympy.sin(v))
        for v in sorted(columns, key=str)
        if v in terms and v**3 in terms and (terms[v] / v) * (terms[v**3] / v**3) < 0
    ]


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
