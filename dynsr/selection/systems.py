"""Whole systems compared on the measured states: which terms the data themselves ask for.

Slopes of noisy data are biased by their smoother, and a formula that follows the bias may beat the
true one on them. Here whole systems are compared on the states. First each equation alone, the
other states read off their smoothed curves: those of the pool, and sums of terms that a linear fit
expects most of; then the best of each state together; then the search climbs by changes of one
equation, for as long as that takes fewer bits.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import sympy
from scipy.linalg import LinAlgError

from dynsr.expression import compile_columns, evaluate
from dynsr.fit import (
    Collocation,
    Linearised,
    Measurements,
    constant_bits,
    r_squared,
    skeleton,
    structure_bits,
    with_floats,
)
from dynsr.selection.changes import promising_changes, prune
from dynsr.selection.comparison import (
    COMPARISON,
    ComparisonSettings,
    Equations,
    SystemComparison,
    SystemFit,
)
from dynsr.selection.couplings import try_couplings
from dynsr.selection.first_look import look
from dynsr.selection.stand_ins import try_stand_ins
from dynsr.selection.subsets import Subset, best_subsets
from dynsr.selection.terms import (
    Joint,
    citing_bits,
    move_inside,
    saturating,
    shape_bits,
    slopes_inside,
    term_bodies,
    unusual_bits,
)

# How much further apart different functions are where columns take any of their values.
_ASIDE = 5.0
# More terms may make up for a function that is none of theirs.
_PLAIN = 4
# Of the leaders of other equations, terms and plain terms that are offered to one together.
_CITED, _OFFERED, _PLAINEST = 3, 12, 40
# Correlation of a column's slopes with another column from which on that is its speed.
_SPEED = 0.99


@dataclass(frozen=True, eq=False)
class SystemChoice:
    """The system that the states support best.

    Parameters
    ----------
    exprs : state -> equation; one that nothing beat comes back as it was given.
    fit : its fit to the states; None where the states could not be used.
    others : state -> (formula, bits more) of the other formulas that were fitted in its place,
        the closest first; of one with no more constants the bits are those of the misses.
    """

    exprs: Equations
    fit: SystemFit | None = None
    others: Mapping[str, tuple[tuple[sympy.Expr, float], ...]] = field(default_factory=dict)

    def explains(self, settings: ComparisonSettings) -> bool:
        """Whether the system leaves nothing but noise, and reproduces the runs or pieces of them.

        Parameters
        ----------
        settings : the numbers that decide.
        """
        if self.fit is None or not leaves_noise(self.fit, settings):
            return False
        # Neighbours part on a chaotic run, so that no integration follows the whole of it.
        return any(
            integrate(self.fit, settings.evaluations, pieces) > settings.reproduces
            for pieces in (1, settings.pieces)
        )

    def different(
        self, share: float = COMPARISON.different
    ) -> dict[str, list[tuple[sympy.Expr, float]]]:
        """State -> (formula, bits more) of those that are other functions of the columns.

        A run may hold two columns so close to each other that different functions are one along it;
        what they say where each column takes any of its values tells them apart.

        Parameters
        ----------
        share : rms difference, as a share of the slopes' spread, from which on they are, along the
            fitted states; beside these it is five times as large, since constants are not sure.
        """
        assert self.fit is not None
        mesh = self.fit.problem.mesh
        columns = {**mesh.columns, **dict(zip(mesh.states, self.fit.fit.states.T, strict=True))}
        beside = _shuffle(columns)
        found: dict[str, list[tuple[sympy.Expr, float]]] = {}
        for state, others in self.others.items():
            mine = self.fit.exprs[state]
            own, aside = evaluate(mine, columns), evaluate(mine, beside)
            near = found[state] = []
            terms = _bare_terms(mine)
            # What has one term more than the law, and a small one, is no other law.
            for expr, more in [o for o in others[:60] if not terms <= _bare_terms(o[0])]:
                apart = _apart(own, expr, columns)
                if apart > share or _apart(aside, expr, beside) > _ASIDE * share:
                    near.append((expr, more))
            del near[3:]
        return found


def _shuffle(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Give the values of every column in an order of its own, always the same."""
    rng = np.random.default_rng(0)
    return {name: rng.permutation(values) for name, values in columns.items()}


def _apart(own: np.ndarray, other: sympy.Expr, columns: Mapping[str, np.ndarray]) -> float:
    """Rms difference of an equation from slopes (n,), as a share of their spread; NaN for none."""
    with np.errstate(all="ignore"):
        values = evaluate(other, columns)
        fine = np.isfinite(values) & np.isfinite(own)
        if 2 * np.count_nonzero(fine) < len(fine):
            return np.nan
        gap = float(np.sqrt(np.mean((values[fine] - own[fine]) ** 2)))
    return gap / max(float(np.std(own[fine])), 1e-300)


def leaves_noise(fit: SystemFit, settings: ComparisonSettings) -> bool:
    """Whether the misses of every state are those of its noise.

    The mean square of n normal misses in units of their noise is 1, give or take sqrt(2 / n).

    Parameters
    ----------
    fit : the system.
    settings : the numbers that decide.
    """
    rows = fit.problem.mesh.rows
    most = 1 + settings.excess + 3 * np.sqrt(2 / np.maximum(rows, 1.0))
    return bool(np.all((fit.fit.mean_squares <= most) | (rows == 0)))


def _bare_terms(expr: sympy.Expr) -> set[sympy.Expr]:
    return {skeleton(t.as_coeff_Mul()[1]) for t in sympy.Add.make_args(sympy.expand(expr))}


def compare_systems(
    exprs: Mapping[str, sympy.Expr],
    alternatives: Mapping[str, Iterable[sympy.Expr]],
    data: Measurements,
    settings: ComparisonSettings = COMPARISON,
) -> SystemChoice:
    """Give the equations whose terms the states support best, climbing from ``exprs``.

    Parameters
    ----------
    exprs : state -> the equation chosen so far.
    alternatives : state -> other formulas that were found for it, the likeliest first.
    data : the measured states, their noise and smoothed curves.
    settings : the numbers that decide.

    An equation that nothing beats comes back as it was given, and so does one that is one bare
    column, such as q' = v. All come back so where the data cannot be followed, and where their
    noise is below ``noisy``: there slopes are good enough.
    """
    if data.noise_share < settings.noisy:
        return SystemChoice(dict(exprs))
    states = tuple(exprs)
    force = settings.demands.force
    pools = {
        s: distinct_shapes(force(s, e) for e in [exprs[s], *alternatives.get(s, ())])
        for s in states
    }
    pools = {s: pool[: settings.alone] for s, pool in pools.items()}
    best, comparison = _search(pools, data, settings)
    if best is None:
        return SystemChoice(dict(exprs))
    # A system that follows the data is the best smoother: terms are looked for along it again.
    for number in range(settings.again):
        if (number or data.noise_share < settings.doubtful) and leaves_noise(best, settings):
            break
        follower = data.along(best.fit.states, states)
        found = {
            s: [best.exprs[s]]
            if best.exprs[s].is_Symbol
            else [best.exprs[s], *explore(s, follower, settings, ratios=False)]
            for s in states
        }
        other, _ = _search(found, follower, settings, comparison)
        if other is None or other.bits >= best.bits - settings.gain:
            break
        best = other
    best = try_stand_ins(comparison, best, lambda fit: _climb(comparison, fit, {}))
    best = try_couplings(comparison, best, lambda fit: _climb(comparison, fit, {}))
    for state in states:
        best = prune(comparison, best, state)
    best = _prefer_reproducing(comparison, best)
    same = {s: skeleton(best.exprs[s]) == skeleton(with_floats(exprs[s])) for s in states}
    chosen = {s: exprs[s] if same[s] else best.exprs[s] for s in states}
    return SystemChoice(chosen, best, _closest(comparison, best))


def _search(
    pools: Mapping[str, Sequence[sympy.Expr]],
    data: Measurements,
    settings: ComparisonSettings,
    comparison: SystemComparison | None = None,
) -> tuple[SystemFit | None, SystemComparison]:
    """Rank each state's formulas alone, put the best together and climb."""
    # What is one bare column, such as q' = v, is known well enough.
    alone = {s: _Alone.of(s, data, settings) for s, pool in pools.items() if not pool[0].is_Symbol}
    given = {s: [_Leader(pool[0], 0.0)] for s, pool in pools.items()}
    first = given | {s: own.lead(pools[s]) or given[s] for s, own in alone.items()}
    # What leaves one state enters another: terms of the one are cheap in the other.
    leaders = first | {
        s: own.lead_citing(first[s], [e for o in first if o != s for e in first[o][:_CITED]])
        for s, own in alone.items()
    }
    together = comparison or SystemComparison(data.mesh(tuple(pools)), settings)
    fits = [fit for own in (first, leaders) if (fit := _compose(together, own)) is not None]
    ends = []
    for pruned in {id(fit): fit for fit in fits}.values():
        # Alone, terms make up for the errors of the curves that the others are read off.
        for state in pools:
            pruned = prune(together, pruned, state)
        ends.append(_climb(together, pruned, leaders))
    return min(ends, key=lambda f: f.bits, default=None), together


def distinct_shapes(pool: Iterable[sympy.Expr]) -> list[sympy.Expr]:
    """Give formulas with free constants, one of each shape."""
    found: dict[sympy.Expr, sympy.Expr] = {}
    for expr in pool:
        loose = with_floats(expr)
        found.setdefault(skeleton(loose), loose)
    return list(found.values())


def explore(
    state: str, data: Measurements, settings: ComparisonSettings, *, ratios: bool = True
) -> list[sympy.Expr]:
    """Give sums of terms that follow one state best, the others read off their curves.

    The terms are evaluated along the smoothed states, and their integrals are fitted to the
    measured ones (the weak form of Schaeffer and McCalla 2017, with windows of all lengths); the
    best subsets take the fewest bits. Their exact fits put them in order.

    Parameters
    ----------
    state : whose equation is sought.
    data : the measured states, their noise and smoothed curves.
    settings : the numbers that decide.
    ratios : whether ratios that follow the smoothed slopes are tried too.
    """
    alone = _Alone.of(state, data, settings)
    found = alone.rank(alone.sums_of_terms())
    best = alone.best()
    if not ratios or (best and _is_plain(best.exprs[state]) and leaves_noise(best, settings)):
        return found
    seen = look(data.samples(state), settings.demands.limits(state))
    angles = [a for a in alone.comparison.angles if _turns(a, data)]
    joints = [one for angle in angles for one in alone.sums_around(angle)]
    return alone.rank([*joints, *(c.expr for c in seen.candidates)])


def _turns(name: str, data: Measurements) -> bool:
    """Whether the speed of a column is another column, as of a joint's angle."""
    if name not in data.runs[0].states:
        return False
    samples = data.samples(name)
    with np.errstate(all="ignore"):
        alike = np.abs(np.corrcoef(samples.X.T, samples.y)[-1, :-1])
    return bool(np.nanmax(alike) > _SPEED)


def _is_plain(expr: sympy.Expr) -> bool:
    """Whether a formula is a polynomial of few terms."""
    few = len(sympy.Add.make_args(expr)) <= _PLAIN
    return few and bool(expr.is_polynomial(*expr.free_symbols))


def other_in_halves(
    state: str, expr: sympy.Expr, data: Measurements, settings: ComparisonSettings = COMPARISON
) -> sympy.Expr | None:
    """Give the formula that half of the rows ask for instead of one; None where both keep it.

    A form that the data determine is found in either half again (stability selection;
    Meinshausen and Buehlmann 2010).

    Parameters
    ----------
    state : whose equation it is.
    expr : the equation.
    data : the measured states.
    settings : the numbers that decide.
    """
    own = with_floats(expr)
    # The likeliest few show whether there is another.
    few = replace(settings, sums=settings.halved)
    for which in (0, 1):
        alone = _Alone.of(state, data.half(which), few)
        mine = alone.comparison.fit({**alone.beside, state: own})
        alone.rank(alone.sums_of_terms())
        best = alone.best()
        if mine is None or best is None:
            continue
        other = best.exprs[state]
        columns = alone.comparison.mesh.columns
        apart = _apart(evaluate(mine.exprs[state], columns), other, columns)
        if best.bits < mine.bits and apart > settings.different:
            return other
    return None


@dataclass(frozen=True)
class _Leader:
    """A formula of one state, and the bits that it takes alone more than the best."""

    expr: sympy.Expr
    behind: float


@dataclass(frozen=True, eq=False)
class _Alone:
    """One state fitted by itself, the others read off their smoothed curves."""

    state: str
    beside: Equations
    comparison: SystemComparison

    @classmethod
    def of(cls, state: str, data: Measurements, settings: ComparisonSettings) -> _Alone:
        beside = data.beside(state)
        return cls(state, beside, SystemComparison(data.mesh((*beside, state)), settings))

    def rank(self, pool: Iterable[sympy.Expr]) -> list[sympy.Expr]:
        """Give the formulas that can be fitted, fewest bits first."""
        force = self.comparison.settings.demands.force
        for expr in pool:
            self.comparison.fit({**self.beside, self.state: force(self.state, expr)})
        for fit in self._ranked()[: self.comparison.settings.pruned]:
            prune(self.comparison, fit, self.state)
        return [f.exprs[self.state] for f in self._ranked()]

    def lead(self, pool: Iterable[sympy.Expr]) -> list[_Leader]:
        """Give those of the formulas that come close to the best."""
        self.rank(pool)
        return self._leaders({})

    def lead_citing(self, own: list[_Leader], others: Sequence[_Leader]) -> list[_Leader]:
        """Give the formulas that come close, those too that hold terms of other equations.

        Parameters
        ----------
        own, others : what leads here, and in the equations of the other states.
        """
        bodies: dict[sympy.Expr, sympy.Expr] = {}
        for one in others:
            for term in sympy.Add.make_args(one.expr):
                for body in _ways_to_write(term.as_coeff_Mul()[1]):
                    if not body.is_Symbol and body.free_symbols and citing_bits(body) > 0:
                        bodies.setdefault(skeleton(body), body)
        new = list(bodies.values())
        if not own or not new:
            return own
        self.rank(self._sums_citing(new[:_OFFERED]))
        return self._leaders({shape: citing_bits(body) for shape, body in bodies.items()})

    def _leaders(self, saved: Mapping[sympy.Expr, float]) -> list[_Leader]:
        """Give the best, bits that terms save elsewhere taken off."""
        settings = self.comparison.settings
        found = []
        for fit in self.comparison.fits():
            expr = fit.exprs[self.state]
            less = sum(saved.get(body, 0.0) for body in term_bodies(expr)) if saved else 0.0
            found.append((fit.bits - less, expr))
        found.sort(key=lambda pair: pair[0])
        close = [_Leader(e, bits - found[0][0]) for bits, e in found[: settings.together]]
        return [one for one in close if one.behind <= settings.behind]

    def _sums_citing(self, bodies: Sequence[sympy.Expr]) -> list[sympy.Expr]:
        """Give the sums of cheap terms and of those of other equations that are expected best."""
        settings, terms = self.comparison.settings, self.comparison.terms
        allow = settings.demands.limits(self.state).allow
        plain = [e for e, free in zip(terms.exprs, terms.inside, strict=True) if not free]
        plain = [e for e in plain[:_PLAINEST] if allow(e)]
        exprs = [*(b for b in bodies if allow(b)), *(e for e in plain if e not in bodies)]
        curved = [e for e in exprs if len(e.atoms(sympy.Float)) == 1]
        slopes = np.full(len(exprs), -1)
        slopes[[exprs.index(e) for e in curved]] = len(exprs) + np.arange(len(curved))
        names, points = self.comparison.names, self._points
        moved = slopes_inside(curved, names, points)
        normal = self._normal(np.concatenate([compile_columns(exprs, names)(*points), moved]))
        if normal is None:
            return []
        rows, angles = self._rows, self.comparison.angles
        costs = np.array(
            [
                shape_bits(sympy.Float(0.5) * e)
                + unusual_bits(e, angles)
                - (citing_bits(e) if e in bodies else 0.0)
                + constant_bits(rows) * (1 + len(e.atoms(sympy.Float)))
                for e in exprs
            ]
        )
        subsets = best_subsets(
            normal.information, -normal.pull, normal.squares, costs, rows, slopes=slopes
        )
        told = [s for s in subsets if any(exprs[i] in bodies for i in s.places)]
        return [_sum_of(exprs, s) for s in told[: settings.sums]]

    def sums_around(self, angle: str) -> list[sympy.Expr]:
        """Give sums of what hangs from a joint that a linear fit expects most of.

        Below the line stands 1 + c sin^2 or 1 + c cos of the angle, with c near one of a few.

        Parameters
        ----------
        angle : of the joint.
        """
        joint = Joint.of(angle, self.comparison.names)
        allow = self.comparison.settings.demands.limits(self.state).allow
        exprs = [e for e in joint.above if allow(e)]
        bits = np.array([structure_bits(0.5 * e) for e in exprs])
        values = compile_columns(exprs, self.comparison.names)(*self._points)
        rows, found = self._rows, []
        for below in joint.below:
            line = 1 + below
            normal = None
            if allow(1 / line):
                normal = self._normal(values / evaluate(line, self._named))
            if normal is not None:
                subsets = best_subsets(
                    normal.information,
                    -normal.pull,
                    normal.squares,
                    bits + constant_bits(rows),
                    rows,
                )
                found += [(s.bits, _add(exprs, s.places, s.coefficients) / line) for s in subsets]
        found.sort(key=lambda pair: (pair[0], str(pair[1])))
        return [expr for _, expr in found[: self.comparison.settings.sums]]

    @cached_property
    def _points(self) -> np.ndarray:
        """Values of all columns but the time at the rows and between them."""
        return self._still.points(self.comparison.mesh.start, np.zeros(0))[:-1]

    @property
    def _named(self) -> dict[str, np.ndarray]:
        return dict(zip(self.comparison.names, self._points, strict=True))

    @cached_property
    def _still(self) -> Collocation:
        exprs = {**self.beside, self.state: sympy.S.Zero}
        return Collocation(exprs, self.comparison.mesh, self.comparison.settings.fit)

    @property
    def _rows(self) -> float:
        return float(np.max(self.comparison.mesh.rows))

    def _normal(self, values: np.ndarray) -> Linearised | None:
        """Give the normal equations of terms with these values; None where they do not tell."""
        mesh = self.comparison.mesh
        slopes = np.zeros((len(mesh.states), len(values), values.shape[1]))
        slopes[-1] = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
        softness = self.comparison.settings.softness
        try:
            return self._still.normal(mesh.start, np.zeros(0), slopes, softness)
        except LinAlgError:
            return None

    def best(self) -> SystemFit | None:
        """Give the fit of fewest bits."""
        return next(iter(self._ranked()), None)

    def _ranked(self) -> list[SystemFit]:
        return sorted(self.comparison.fits(), key=lambda f: f.bits)

    def sums_of_terms(self) -> list[sympy.Expr]:
        """Give the sums that a linear fit expects most of, the best first."""
        settings, terms = self.comparison.settings, self.comparison.terms
        points, slopes = self._points, terms.slopes
        normal = self._normal(np.concatenate([terms.values(points), terms.shifts(points)]))
        if normal is None:
            return [sympy.S.Zero]
        rows = self._rows
        costs = terms.bits + constant_bits(rows) * (1 + terms.inside)
        limits = settings.demands.limits(self.state)
        costs[[not limits.allow(term) for term in terms.exprs]] = np.inf
        found: dict[tuple[int, ...], Subset] = {}
        first: dict[tuple[int, ...], None] = {}
        # A beam through few terms reaches sums that one through all of them passes by.
        for tier in (*terms.tiers, terms.divisible_by(self.state)):
            curved = slopes[tier] >= 0
            columns = np.concatenate([tier, slopes[tier][curved]])
            own = np.where(curved, len(tier) + np.cumsum(curved) - 1, -1)
            gram, pull = normal.information[np.ix_(columns, columns)], -normal.pull[columns]
            subsets = best_subsets(gram, pull, normal.squares, costs[tier], rows, slopes=own)
            for rank, subset in enumerate(subsets):
                places = tuple(int(tier[i]) for i in subset.places)
                found.setdefault(places, replace(subset, places=places))
                if rank < settings.sums:
                    first.setdefault(places)
        # Beside the best of every tier those that are best of all.
        ranked = sorted(found, key=lambda places: (found[places].bits, places))
        first |= dict.fromkeys(ranked[: 2 * settings.sums])
        sums = [_sum_of(terms.exprs, found[places]) for places in first]
        others = [sympy.Symbol(n) for n in self.comparison.names if n != self.state]
        return [sympy.S.Zero, *others, *sums]


def _ways_to_write(body: sympy.Expr) -> list[sympy.Expr]:
    """Give a term, and what it is beside a plain one: y/(x + k) and x y/(x + k).

    >>> x, y = sympy.symbols("x y")
    >>> _ways_to_write(y / (x + 1.5))
    [y/(x + 1.5), x*y/(x + 1.5)]
    """
    power = next(filter(None, (saturating(1 / f) for f in sympy.Mul.make_args(body))), None)
    if power is None:
        return [body]
    above = sympy.fraction(body)[0]
    held = (above / power).as_numer_denom()[1].free_symbols != power.free_symbols
    return [body, body / power if held else body * power]


def _sum_of(terms: Sequence[sympy.Expr], subset: Subset) -> sympy.Expr:
    """Give a sum of terms, the constants inside them moved as the linear fit expects."""
    exprs = [
        move_inside(terms[place], shift) if shift else terms[place]
        for place, shift in zip(subset.places, subset.shifts.tolist(), strict=True)
    ]
    return _add(exprs, range(len(exprs)), subset.coefficients)


def _add(exprs: Sequence[sympy.Expr], places: Sequence[int], values: np.ndarray) -> sympy.Expr:
    return sympy.Add(*[sympy.Float(c) * exprs[i] for c, i in zip(values, places, strict=True)])


def _compose(
    comparison: SystemComparison, leaders: Mapping[str, Sequence[_Leader]]
) -> SystemFit | None:
    """Fit the system of each state's best formulas, or of the next where that cannot be fitted."""
    for place in range(max(map(len, leaders.values()))):
        exprs = {s: pool[min(place, len(pool) - 1)].expr for s, pool in leaders.items()}
        found = comparison.fit(exprs)
        if found is not None:
            return found
    return None


def _climb(
    comparison: SystemComparison, fit: SystemFit, leaders: Mapping[str, Sequence[_Leader]]
) -> SystemFit:
    """Take the best change until none takes fewer bits."""
    for number in range(comparison.settings.rounds):
        changes = [{c.state: c.expr} for c in promising_changes(comparison, fit)]
        # Where nothing but noise is left, what is worse alone is worse together.
        settled = number > 1 or leaves_noise(fit, comparison.settings)
        most = comparison.settings.near if settled else comparison.settings.behind
        changes += [
            {s: one.expr} for s, pool in leaders.items() for one in pool if one.behind < most
        ]
        fits = [comparison.fit({**fit.exprs, **change}, fit) for change in changes]
        best = min([fit, *(f for f in fits if f is not None)], key=lambda f: f.bits)
        if best is fit:
            break
        fit = best
    return fit


def _prefer_reproducing(comparison: SystemComparison, best: SystemFit) -> SystemFit:
    """Give the best system that an integration from its start confirms, if one is close enough."""
    settings = comparison.settings
    close = [f for f in comparison.fits() if f.bits <= best.bits + settings.unfollowed]
    for fit in sorted(close, key=lambda f: f.bits)[:12]:
        if integrate(fit, settings.evaluations) > settings.reproduces:
            return fit
    return best


class _TooLong(Exception):
    """An integration takes more evaluations than any that reproduces the data."""


def integrate(fit: SystemFit, evaluations: int = COMPARISON.evaluations, pieces: int = 1) -> float:
    """Integrate a system from its fitted states over the runs or pieces of them; gives the mean R2.

    R2 is 1 - sum (x - y)^2 / sum (y - mean y)^2 of each measured state, from -1 up.

    Parameters
    ----------
    fit : the system.
    evaluations : of the right-hand sides for each row; a run that takes more counts as missed.
    pieces : of each run; a chaotic one parts from the data over the whole.
    """
    from scipy.integrate import solve_ivp

    mesh, constants = fit.problem.mesh, fit.fit.constants
    slope = fit.problem.slope.at
    used = {str(symbol) for expr in fit.exprs.values() for symbol in expr.free_symbols}
    read = [name in used for name in mesh.driven_names]
    numbers = constants.tolist()
    first = np.setdiff1d(np.arange(len(mesh.t)), mesh.left + 1)
    found = np.full(mesh.x.shape, np.nan)
    ends = [*first[1:], len(mesh.t)]
    cuts = [
        np.unique(np.linspace(a, b, pieces + 1).astype(int))
        for a, b in zip(first, ends, strict=True)
    ]
    for begin, end in [pair for cut in cuts for pair in pairwise(cut)]:
        t, driven = mesh.t[begin:end], mesh.driven[:, begin:end]
        left = iter(range(evaluations * len(t)))

        def rhs(
            at: float,
            x: np.ndarray,
            t: np.ndarray = t,
            u: np.ndarray = driven,
            left: Iterator[int] = left,
        ) -> list[float]:
            if next(left, None) is None:
                raise _TooLong
            driven = [
                float(np.interp(at, t, row)) if needed else 0.0
                for row, needed in zip(u, read, strict=True)
            ]
            return slope(*x.tolist(), *driven, *numbers)

        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            start = fit.fit.states[begin]
            try:
                solved = solve_ivp(rhs, (t[0], t[-1]), start, "LSODA", t, rtol=1e-5, atol=1e-8)
            except _TooLong:
                continue
        if solved.y.shape[1] == len(t):
            found[begin:end] = solved.y.T
    own = np.ix_(mesh.measured, mesh.rows > 0)
    return r_squared(mesh.x[own], found[own])


def _closest(
    comparison: SystemComparison, best: SystemFit
) -> dict[str, tuple[tuple[sympy.Expr, float], ...]]:
    """Give the other formulas of each state that were fitted beside the best of the others."""
    shapes = {s: skeleton(e) for s, e in best.exprs.items()}
    found: dict[str, list[tuple[sympy.Expr, float]]] = {s: [] for s in shapes}
    for fit in comparison.fits():
        changed = [s for s, e in fit.exprs.items() if skeleton(e) != shapes[s]]
        if len(changed) == 1:
            found[changed[0]].append((fit.exprs[changed[0]], _bits_above(fit, best)))
    return {s: tuple(sorted(o, key=lambda p: (p[1], str(p[0])))) for s, o in found.items()}


def _bits_above(other: SystemFit, best: SystemFit) -> float:
    """Bits that a system takes more than the best one, by what the data tell of it.

    How plainly a formula is written says nothing of whether the data exclude it: that counts for
    one of more constants only, which may follow anything.
    """
    more = len(other.fit.constants) - len(best.fit.constants)
    rows = best.problem.mesh.rows
    squares = [np.log2(np.maximum(f.fit.mean_squares, 1e-12)) for f in (other, best)]
    told = float(np.sum(rows / 2 * (squares[0] - squares[1])))
    told += more * constant_bits(float(np.max(rows)))
    bits = other.bits - best.bits
    return bits if more > 0 else min(bits, told)
