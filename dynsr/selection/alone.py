"""Alone: the formulas of one state, the others read off their smoothed curves.

Sums of terms that a linear fit expects most of, sums of what hangs from a joint, and sums that hold
terms of other equations are fitted to one state and put in the order of their bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import sympy
from scipy.linalg import LinAlgError

from dynsr.expression import ByText, compile_columns, evaluate
from dynsr.fit import (
    Collocation,
    Linearised,
    Measurements,
    Probes,
    constant_bits,
    free_constants,
    skeleton,
    structure_bits,
)
from dynsr.library import Library
from dynsr.selection.changes import prune
from dynsr.selection.comparison import (
    SIGMA,
    ComparisonSettings,
    Equations,
    SystemComparison,
    SystemFit,
    apart_by,
    leaves_noise,
    most_of_noise,
)
from dynsr.selection.costs import (
    bodies_of,
    citing_bits,
    is_plain,
    saturating,
    shape_bits,
    term_bodies,
    unusual_bits,
    wide_factors,
)
from dynsr.selection.evidence import Evidence
from dynsr.selection.propose import Proposer, write_all
from dynsr.selection.several import Goal, SeveralInside
from dynsr.selection.subsets import Subset, best_subsets, solve_scaled, without
from dynsr.selection.terms import Joint, Terms, move_inside, slopes_inside, weighted_sum
from dynsr.selection.twins import exchanged

# Terms of other equations, and plain ones, that are offered to one together.
_OFFERED, _PLAINEST = 24, 40
# Points at which functions of several constants are evaluated.
_SPREAD = 160


@dataclass(frozen=True)
class Leader:
    """A formula of one state, the bits that it takes alone more than the best, and its constants.

    These have values (P,) and a covariance (P, P), in the order in which they appear.
    """

    expr: sympy.Expr
    behind: float
    constants: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True, eq=False)
class Alone:
    """One state fitted by itself, the others read off their smoothed curves."""

    state: str
    beside: Equations
    comparison: SystemComparison

    @classmethod
    def of(cls, state: str, data: Measurements, settings: ComparisonSettings) -> Alone:
        """Take one state of some data.

        Parameters
        ----------
        state : whose equation is sought.
        data : the measured states, their noise and smoothed curves.
        settings : the numbers that decide.
        """
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

    def lead(self, pool: Iterable[sympy.Expr]) -> list[Leader]:
        """Give those of the formulas that come close to the best."""
        self.rank(pool)
        return self._leaders({})

    def lead_citing(self, own: list[Leader], others: Sequence[Leader]) -> list[Leader]:
        """Give the formulas that come close, those too that hold terms of other equations.

        Parameters
        ----------
        own, others : what leads here, and in the equations of the other states.
        """
        terms = [term for one in others for term in bodies_of(one.expr)]
        whole: dict[sympy.Expr, tuple[sympy.Expr, float]] = {}
        for body in (body for term in terms for body in _ways_to_write(term)):
            if not body.is_Symbol and body.free_symbols and citing_bits(body) > 0:
                whole.setdefault(skeleton(body), (body, citing_bits(body)))
        # The speed that one axis is slowed down by slows down the other.
        shared: dict[sympy.Expr, tuple[sympy.Expr, float]] = {}
        for factor in (f for term in terms for f in sympy.Mul.make_args(term) if wide_factors(f)):
            body = factor * sympy.Symbol(self.state)
            if skeleton(body) not in whole:
                shared.setdefault(skeleton(body), (body, citing_bits(factor)))
        # Functions of several columns are few, and offered first.
        offered = shared | whole
        if not own or not offered:
            return own
        self.rank(self._sums_citing(dict([*offered.values()][:_OFFERED])))
        return self._leaders({shape: bits for shape, (_, bits) in offered.items()})

    def lead_twins(
        self, own: list[Leader], others: Mapping[str, Sequence[Leader]], states: Sequence[str]
    ) -> list[Leader]:
        """Give the formulas that come close, and after them those of other states as its own.

        Parameters
        ----------
        own : what leads here.
        others : what leads elsewhere, for each state.
        states : all of them, whose names may be exchanged.
        """
        if self.is_clear():
            return own
        known = {skeleton(one.expr) for one in own}
        offered = (
            expr
            for state, pool in others.items()
            for one in pool
            for expr in exchanged(one.expr, state, self.state, states)
        )
        shapes = {skeleton(expr): expr for expr in offered}
        self.rank(expr for shape, expr in shapes.items() if shape not in known)
        ranked, new = self._ranked(), shapes.keys() - known
        twins = [self._as_leader(f, f.bits - ranked[0].bits) for f in ranked]
        most = self.comparison.settings.behind
        return [*own, *(t for t in twins if t.behind <= most and skeleton(t.expr) in new)]

    def _as_leader(self, fit: SystemFit, behind: float) -> Leader:
        return Leader(fit.exprs[self.state], behind, fit.fit.constants, fit.fit.covariance)

    def _leaders(self, saved: Mapping[sympy.Expr, float]) -> list[Leader]:
        """Give the best, bits that terms save elsewhere taken off."""
        settings = self.comparison.settings
        found = []
        for fit in self.comparison.fits():
            expr = fit.exprs[self.state]
            less = sum(saved.get(body, 0.0) for body in term_bodies(expr)) if saved else 0.0
            found.append((fit.bits - less, fit))
        found.sort(key=lambda pair: pair[0])
        return [
            self._as_leader(f, bits - found[0][0])
            for bits, f in found[: settings.together]
            if bits - found[0][0] <= settings.behind
        ]

    def _sums_citing(self, bodies: Mapping[sympy.Expr, float]) -> list[sympy.Expr]:
        """Give the sums of cheap terms and of those of other equations that are expected best."""
        settings, terms = self.comparison.settings, self.comparison.terms
        allow = settings.demands.limits(self.state).allow
        plain = [e for e, free in zip(terms.exprs, terms.inside, strict=True) if not free]
        plain = [e for e in plain[:_PLAINEST] if allow(e)]
        exprs = [*(b for b in bodies if allow(b)), *(e for e in plain if e not in bodies)]
        curved = [e for e in exprs if len(e.atoms(sympy.Float)) == 1]
        slopes = np.full(len(exprs), -1)
        slopes[[exprs.index(e) for e in curved]] = len(exprs) + np.arange(len(curved))
        names, points = self.comparison.columns, self._points
        moved = slopes_inside(curved, names, points)
        normal = self._normal(np.concatenate([compile_columns(exprs, names)(*points), moved]))
        if normal is None:
            return []
        costs = np.array([self.term_bits(e) - bodies.get(e, 0.0) for e in exprs])
        subsets = best_subsets(
            normal.information, -normal.pull, normal.squares, costs, self.rows, slopes=slopes
        )
        told = [s for s in subsets if any(exprs[i] in bodies for i in s.places)]
        return [_sum_of(exprs, s) for s in told[: settings.sums]]

    def term_bits(self, body: sympy.Expr) -> float:
        """Give the bits of a term with its coefficient and the constants inside it.

        Parameters
        ----------
        body : the term.
        """
        written = shape_bits(sympy.Float(0.5) * body) + unusual_bits(body, self.comparison.angles)
        return written + constant_bits(self.rows) * (1 + len(body.atoms(sympy.Float)))

    def gram(self, bodies: Sequence[sympy.Expr], plain: Sequence[sympy.Expr]) -> np.ndarray | None:
        """Products of terms, of their slopes by the constant inside each, and of plain terms.

        As many slopes as terms; the last are products with the misses. None where these do not
        tell.

        Parameters
        ----------
        bodies : terms with one constant inside or none, whose slopes are 0 then.
        plain : terms without.
        """
        names, points = self.comparison.columns, self._points
        values = compile_columns([*bodies, *plain], names)(*points)
        curved = [i for i, body in enumerate(bodies) if body.atoms(sympy.Float)]
        slopes = np.zeros_like(values[: len(bodies)])
        slopes[curved] = slopes_inside([bodies[i] for i in curved], names, points)
        normal = self._normal(
            np.concatenate([values[: len(bodies)], slopes, values[len(bodies) :]])
        )
        return None if normal is None else normal.gram

    def fitted(self, bodies: Sequence[sympy.Expr]) -> sympy.Expr | None:
        """Give the sum of all of some terms that a linear fit expects; None where that fails.

        Parameters
        ----------
        bodies : the terms; what others of them say as well has a share of it.
        """
        normal = self._normal(compile_columns(bodies, self.comparison.columns)(*self._points))
        if normal is None:
            return None
        gram, places = normal.gram, list(range(len(bodies)))
        return weighted_sum((-solve_scaled(gram, places, gram[places, -1:])[:, 0]).tolist(), bodies)

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
        values = compile_columns(exprs, self.comparison.columns)(*self._points)
        rows, found = self.rows, []
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
                found += [
                    (s.bits, weighted_sum(s.coefficients, [exprs[i] for i in s.places]) / line)
                    for s in subsets
                ]
        found.sort(key=lambda pair: (pair[0], ByText(pair[1])))
        return [expr for _, expr in found[: self.comparison.settings.sums]]

    def sums_inside(self) -> list[sympy.Expr]:
        """Give sums with a function of several constants that are expected to take fewest bits.

        Terms are evaluated at some times, between which they are interpolated, and what their
        integrals leave of the measured states says what they are worth.
        """
        evidence = self._evidence(_SPREAD, self.comparison.settings.softness)
        if evidence is None:
            return []
        goal = Goal(evidence.names, evidence.points, self.state, evidence.y, evidence.maps)
        rows, angles = evidence.rows, self.comparison.angles
        each = constant_bits(rows)

        def bits(expr: sympy.Expr) -> float:
            return shape_bits(expr) + unusual_bits(expr, angles) + each * constants(expr)

        allow = self.comparison.settings.demands.limits(self.state).allow
        several = SeveralInside(goal, allow)
        return several.likely_sums(evidence.beside, rows, bits, each)

    def _evidence(self, nodes: int, softness: float) -> Evidence | None:
        """Give a view of the equation by so many points; None where the data do not tell."""
        return Evidence.of(self._still, self.comparison.names, self.rows, softness, nodes)

    @cached_property
    def _points(self) -> np.ndarray:
        """Values of all columns, the time the last, at the rows and between them."""
        return self._still.points(self.comparison.mesh.start, np.zeros(0))

    @property
    def _named(self) -> dict[str, np.ndarray]:
        return dict(zip(self.comparison.columns, self._points, strict=True))

    @cached_property
    def _still(self) -> Collocation:
        exprs = {**self.beside, self.state: sympy.S.Zero}
        return Collocation(exprs, self.comparison.mesh, self.comparison.settings.fit)

    @property
    def rows(self) -> float:
        """Measured rows of the state."""
        return float(np.max(self.comparison.mesh.rows))

    def _normal(self, values: np.ndarray) -> Linearised | None:
        """Give the normal equations of terms with these values; None where they do not tell."""
        still, mesh = self._still, self.comparison.mesh
        slopes = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
        probes = Probes(np.full(len(values), len(mesh.states) - 1), slopes)
        softness = self.comparison.settings.softness
        try:
            return still.normal(mesh.start, np.zeros(0), probes, softness)
        except LinAlgError:
            return None

    def best(self) -> SystemFit | None:
        """Give the fit of fewest bits."""
        return next(iter(self._ranked()), None)

    def _ranked(self) -> list[SystemFit]:
        return sorted(self.comparison.fits(), key=lambda f: f.bits)

    def propose(self) -> list[sympy.Expr]:
        """Give the sums of terms of the library that are expected to take the fewest bits."""
        comparison, demands = self.comparison, self.comparison.settings.demands
        settings = comparison.settings.proposals
        evidence = self._evidence(settings.nodes, settings.softness)
        if evidence is None:
            return []
        names, angles = comparison.names, comparison.angles
        library = Library.of(names, evidence.points, angles, demands.offered, settings.library)
        pairs = zip(library.forms, library.starts, strict=True)
        forms = [form.write(names, own[0]) for form, own in pairs]
        costs = np.array([self.term_bits(expr) for expr in forms])
        allow = demands.limits(self.state).allow
        costs[[not allow(expr) for expr in forms]] = np.inf
        sums = Proposer(evidence, library, costs, settings).best()
        others = [sympy.Symbol(name) for name in names if name != self.state]
        return [sympy.S.Zero, *others, *write_all(sums, library)]

    def rank_sums(self) -> list[sympy.Expr]:
        """Give sums of terms, fewest bits first: of powers alone where these leave no doubt."""
        if self.comparison.settings.parts.has("library"):
            return self.rank(self.propose())
        if self.comparison.settings.parts.has("powers-first"):
            found = self.rank(self.sums_of_terms(powers=True))
            if self.is_clear():
                return found
        return self.rank(self.sums_of_terms())

    def is_clear(self) -> bool:
        """Whether a short polynomial leaves only noise and leads all others by far."""
        ranked = self._ranked()
        if not ranked or not self.comparison.settings.parts.has("end-clear"):
            return False
        best, *others = ranked
        settings, expr = self.comparison.settings, best.exprs[self.state]
        if not (is_plain(expr) and (leaves_noise(best, settings) or self._needs_no_more(best))):
            return False
        columns = self.comparison.mesh.columns
        own = evaluate(expr, columns)
        near = (f for f in others if f.bits <= best.bits + settings.clear)
        return all(apart_by(own, f.exprs[self.state], columns) <= settings.different for f in near)

    def _needs_no_more(self, fit: SystemFit) -> bool:
        """Whether the sum of all powers explains no more than noise does of what a few leave.

        The curves of the others are off by their own noise, so that what is read off them leaves
        more than noise where it is held to its own solution strictly.
        """
        normal, settings = self._of_powers, self.comparison.settings
        used = [self.comparison.terms.exprs[i] for i in _places_of(self.comparison.terms.powers)]
        own = bodies_of(fit.exprs[self.state])
        if normal is None or not set(own) <= set(used):
            return False
        few, every = (
            float(without(normal.gram, places, len(used))[0, 0])
            for places in ([used.index(body) for body in own], list(range(len(used))))
        )
        count = len(used) - len(own)
        most = self.rows * float(most_of_noise(np.array(self.rows), settings))
        return few <= most and few - every <= count + SIGMA * math.sqrt(2 * count)

    @cached_property
    def _of_powers(self) -> Linearised | None:
        terms = self.comparison.terms
        return self._normal(columns_of(terms, terms.powers, self._points[:-1], curved=False))

    def sums_of_terms(self, *, powers: bool = False) -> list[sympy.Expr]:
        """Give the sums that a linear fit expects most of, the best first.

        Parameters
        ----------
        powers : whether products of whole powers alone are terms.
        """
        settings, terms = self.comparison.settings, self.comparison.terms
        tiers = terms.powers if powers else (*terms.tiers, terms.divisible_by(self.state))
        curved = not powers
        normal = self._of_powers
        if curved:
            normal = self._normal(columns_of(terms, tiers, self._points[:-1], curved=True))
        if normal is None:
            return [sympy.S.Zero]
        costs = terms.bits + constant_bits(self.rows) * (1 + terms.inside)
        limits = settings.demands.limits(self.state)
        costs[[not limits.allow(term) for term in terms.exprs]] = np.inf
        sums = expected_sums(normal, terms, tiers, costs, self.rows, settings.sums, curved=curved)
        others = [sympy.Symbol(n) for n in self.comparison.names if n != self.state]
        return [sympy.S.Zero, *others, *sums]


def constants(expr: sympy.Expr) -> int:
    """Count the constants of a formula that are fitted.

    Parameters
    ----------
    expr : the formula.
    """
    return len(free_constants(expr, "c")[1])


def _places_of(tiers: Sequence[np.ndarray]) -> np.ndarray:
    """Give the places of the terms of all tiers, each once."""
    return np.unique(np.concatenate(tiers))


def columns_of(
    terms: Terms, tiers: Sequence[np.ndarray], points: np.ndarray, *, curved: bool
) -> np.ndarray:
    """Values of the terms of some tiers at points, and the slopes of those that are curved.

    Parameters
    ----------
    terms, tiers : all terms, and the places of those that are looked through together.
    points : (names, n) values of the columns.
    curved : whether their slopes by the constants inside come after them.
    """
    values = terms.values(points)[_places_of(tiers)]
    return np.concatenate([values, terms.shifts(points)]) if curved else values


def expected_sums(
    normal: Linearised,
    terms: Terms,
    tiers: Sequence[np.ndarray],
    costs: np.ndarray,
    rows: float,
    count: int,
    *,
    curved: bool,
) -> list[sympy.Expr]:
    """Give the sums of terms that a linear fit expects most of, the best first.

    Parameters
    ----------
    normal : the normal equations of :func:`columns_of`.
    terms, tiers : all terms, and the places of those that are looked through together.
    costs : (p,) bits of each term with its constants.
    rows : m of the bits m / 2 log2(squares / m).
    count : sums of each tier that are given, and half of those that are best of all.
    curved : whether the slopes by the constants inside are there.
    """
    used = _places_of(tiers)
    slopes = terms.slopes if curved else np.full(len(used), -1)
    found: dict[tuple[int, ...], Subset] = {}
    first: dict[tuple[int, ...], None] = {}
    # A beam through few terms reaches sums that one through all of them passes by.
    for tier in tiers:
        places = np.searchsorted(used, tier)
        bent = slopes[places] >= 0
        columns = np.concatenate([places, slopes[places][bent]])
        own = np.where(bent, len(tier) + np.cumsum(bent) - 1, -1)
        gram, pull = normal.information[np.ix_(columns, columns)], -normal.pull[columns]
        subsets = best_subsets(gram, pull, normal.squares, costs[tier], rows, slopes=own)
        for rank, subset in enumerate(subsets):
            chosen = tuple(int(tier[i]) for i in subset.places)
            found.setdefault(chosen, replace(subset, places=chosen))
            if rank < count:
                first.setdefault(chosen)
    # Beside the best of every tier those that are best of all.
    ranked = sorted(found, key=lambda places: (found[places].bits, places))
    first |= dict.fromkeys(ranked[: 2 * count])
    return [_sum_of(terms.exprs, found[places]) for places in first]


def _ways_to_write(body: sympy.Expr) -> list[sympy.Expr]:
    """Give a term, and what it is beside a plain one: y/(x + k) and x y/(x + k).

    >>> x, y = sympy.symbols("x y")
    >>> _ways_to_write(y / (x + 1.5))
    [y/(x + 1.5), x*y/(x + 1.5)]
    """
    line = next(filter(None, (saturating(1 / f) for f in sympy.Mul.make_args(body))), None)
    if line is None:
        return [body]
    power = line[0]
    above = sympy.fraction(body)[0]
    held = (above / power).as_numer_denom()[1].free_symbols != power.free_symbols
    return [body, body / power if held else body * power]


def _sum_of(terms: Sequence[sympy.Expr], subset: Subset) -> sympy.Expr:
    """Give a sum of terms, the constants inside them moved as the linear fit expects."""
    exprs = [
        move_inside(terms[place], shift) if shift else terms[place]
        for place, shift in zip(subset.places, subset.shifts.tolist(), strict=True)
    ]
    return weighted_sum(subset.coefficients, exprs)
