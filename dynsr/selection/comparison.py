"""Comparison: systems fitted to the whole trajectories, and the bits that they take.

Every candidate system is fitted to the measured states (:class:`dynsr.fit.Collocation`) and costs
the bits of its residuals (Schwarz 1978), of its constants and of its structure, as the prior of
textbooks has it (:class:`dynsr.library.Prior`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
import sympy

from dynsr.expression import evaluate, free_constants, has_pole, skeleton
from dynsr.fit import (
    FLOOR,
    Collocation,
    CollocationFit,
    CollocationSettings,
    Measurements,
    Mesh,
    precision_bits,
    residual_bits,
    shortened_bits,
    simplicity_bits,
)
from dynsr.library import (
    Place,
    Written,
    find_coordinates,
    find_turning,
    read_equation,
    structure_of,
    textbooks,
    unusual_bits,
)
from dynsr.methods import Demands, recalled
from dynsr.selection.evidence import Evidence
from dynsr.selection.mass_matrix import find_couplings
from dynsr.selection.parts import Parts
from dynsr.selection.permuted import with_permuted
from dynsr.selection.propose import ProposalSettings, propose, term_bits
from dynsr.selection.rates import SIGMA, shared_bits

Equations = dict[str, sympy.Expr]
# Starts of one shape at most, and the share by which a constant inside a function sets two apart.
_STARTS, _APART = 2, 0.5
# Range of the argument of a function below which the function is seen as no more than a line.
_BARE = 1e-4
# Mean squared miss of a state, in units of its noise, that noise does not leave.
_TOO_CLOSE = 0.3


@dataclass(frozen=True)
class ComparisonSettings:
    """Settings of a comparison of whole systems; they are kept in a run's record.

    Parameters
    ----------
    noisy : systems are compared only where the median noise is above this share of the spread.
        Smaller noise is no larger than errors that a solver at a loose tolerance leaves in its
        states; those have a pattern, and terms would be found for it.
    coarse, dense : the same where an oscillation takes fewer rows than ``dense``: what is between
        rows so far apart looks like noise, and slopes are rough.
    alone : formulas of each state that are fitted with the other states read from their curves.
    sums : sums of terms of other equations, and of a joint's acceleration, that are fitted alone.
    alone_softness : weight of the defects along smoothed states, which are not quite those of a
        system.
    softness : weight of the defects of a system that does not follow its data, and at the start of
        whole polynomials and of equations with a joint.
    pruned : of these, how many lose the terms that do not pay.
    again : how often masses are tied, and terms are looked for along the best hidden state.
    gain : bits that a change must save for others to be looked for.
    together : the best of them that enter whole systems.
    behind : bits that they may take more than the best of them.
    near : the same, once a system leaves nothing but noise.
    apart : rms difference of two equations, as a share of the slopes' spread, from which on one
        must be distinguished from the other: a formula that is 1 % off is another law.
    pieces : pieces of a run that are integrated where the whole cannot be.
    reproduces : least mean R2 of an integration from the fitted start over the whole run.
    evaluations : of the right-hand sides for each row that this integration takes at most.
    rounds : changes taken at most.
    tried : changes, those expected to save most first, that are fitted in a round.
    excess : mean squared residual beyond that of noise, in units of it, that is noise too: its size
        is an estimate.
    rows : rows of the data at most.
    parts : which parts of the search and of the bits take part.
    demands : what the user asks of the equations; a system that breaks one is not taken.
    fit : how a system is fitted.
    """

    noisy: float = 5e-4
    coarse: float = 5e-5
    dense: float = 50.0
    alone: int = 40
    proposals: ProposalSettings = ProposalSettings()
    sums: int = 15
    alone_softness: float = 1000.0
    softness: float = 100.0
    pruned: int = 12
    again: int = 2
    gain: float = 1.0
    together: int = 20
    behind: float = 40.0
    near: float = 12.0
    apart: float = 0.01
    pieces: int = 10
    reproduces: float = 0.9
    evaluations: int = 50
    rounds: int = 12
    tried: int = 8
    excess: float = 0.15
    rows: int = 2000
    parts: Parts = Parts()
    demands: Demands = Demands()
    fit: CollocationSettings = CollocationSettings(early=0.5, loose=textbooks().loose_bits)

    def ask(self, data: Measurements) -> bool:
        """Whether states are asked, and not their slopes alone.

        Slopes are also unsure where the curve of a state is, between the rows that have it.

        Parameters
        ----------
        data : the states.
        """
        unsure = max(data.noise_share, data.unsure_share)
        return unsure >= (self.coarse if data.period < self.dense else self.noisy)


COMPARISON: ComparisonSettings = ComparisonSettings()


@dataclass(frozen=True, eq=False)
class SystemFit:
    """A system fitted to the states, and its bits."""

    problem: Collocation
    fit: CollocationFit
    bits: float = math.inf

    @property
    def exprs(self) -> Equations:
        """State -> equation with its fitted constants."""
        return self.fit.exprs

    @cached_property
    def strict(self) -> CollocationFit:
        """The same system fitted so that the states follow it strictly; where that cannot be, it.

        A fit whose defects have a weight of their own says what the system leaves out of a step,
        and this one what it leaves out of the whole.
        """
        last = self.problem.settings.stiffness[-1]
        if self.fit.weight is None or self.fit.weight == last:
            return self.fit
        held = replace(self.problem.settings, loose=0.0)
        return replace(self.problem, settings=held, weight=None).fit(self.fit, True) or self.fit

    @property
    def points(self) -> np.ndarray:
        """Values of all columns, the time the last, at the rows and in the middle between them."""
        return self.problem.points(self.fit.states, self.fit.constants)


@dataclass(frozen=True, eq=False)
class SystemComparison:
    """Fits systems to the states of a mesh and counts their bits.

    Parameters
    ----------
    mesh : the data, with the states whose equations are compared.
    settings : the numbers that decide.
    states : all columns that move by equations; by default those of the mesh.
    """

    mesh: Mesh
    settings: ComparisonSettings = COMPARISON
    states: tuple[str, ...] = ()
    _cache: dict[tuple[sympy.Expr, ...], SystemFit | None] = field(default_factory=dict)
    _starts: dict[tuple[sympy.Expr, ...], list[np.ndarray]] = field(default_factory=dict)
    _tried: set[tuple[tuple[sympy.Expr, ...], SystemFit | None, bool]] = field(default_factory=set)
    _extents: dict[sympy.Expr, tuple[float, float]] = field(default_factory=dict)

    def fit(self, exprs: Equations, near: SystemFit | None = None) -> SystemFit | None:
        """Fit every constant and start; None where the system cannot be fitted."""
        if not self.settings.demands.keep_all(exprs):
            return None
        key = form_of(exprs)
        before = self._cache.get(key)
        problem = Collocation(exprs, self.mesh, self._how)
        if key not in self._cache or self._may_do_better(key, problem, before):
            self._starts.setdefault(key, []).append(problem.inside)
            fit = self._solve(problem, near)
            if before is None or (fit is not None and fit.bits < before.bits):
                self._cache[key] = fit
        return self._cache[key]

    def _may_do_better(
        self, key: tuple[sympy.Expr, ...], problem: Collocation, before: SystemFit | None
    ) -> bool:
        """Whether a fit that ended far off is to be tried from other constants inside functions."""
        tried = self._starts.get(key, [])
        if not tried or not len(tried[0]) or len(tried) == _STARTS:
            return False
        if before is not None:
            best = min(f.bits for f in self.fits())
            if before.bits <= best + self.settings.near:
                return False
        return all(np.any(np.abs(problem.inside - own) > _APART * np.abs(own)) for own in tried)

    def _solve(
        self, problem: Collocation, near: SystemFit | None, *, strict: bool = False
    ) -> SystemFit | None:
        """Fit from a start; None if it fails or was fitted before, when the better fit was kept."""
        key = (tuple(problem.exprs.values()), near, strict)
        if key in self._tried:
            return None
        self._tried.add(key)
        found = self._find(problem, None if near is None else near.fit, strict)
        if found is None and near is not None and not strict:
            found = self._find(problem, None)
        return self._count(problem, found)

    def _find(
        self, problem: Collocation, near: CollocationFit | None, strict: bool = False
    ) -> CollocationFit | None:
        """Fit a system; where a run keeps its fits, one that an earlier run made is taken."""
        mesh, begin = self.mesh, self.mesh.start if near is None else near.states
        data = (mesh.t, mesh.left, mesh.x, mesh.weights, mesh.driven, mesh.states)
        cells = () if mesh.censored is None else mesh.censored.arrays
        # The text of a formula has fewer digits than its constants.
        weight = near.weight if strict and near is not None else None
        system = (problem.exprs, problem.constants, begin, strict, weight)
        every = (*system, *data, *cells, mesh.driven_names, problem.settings)
        found = recalled("system", partial(problem.solve, near, strict), *every)
        return None if found is None else problem.as_fit(*found)

    def _count(self, problem: Collocation, found: CollocationFit | None) -> SystemFit | None:
        """Give a fit with its bits; None for none, and for one that is no system."""
        if found is None or self._has_pole(found) or any(map(self._is_bare, found.exprs.values())):
            return None
        # Terms whose constants came to be 0 or alike are no more in it.
        if len(owners_of(found.exprs)) < len(found.constants):
            return None
        bits = self.bits(found, problem.scales(found))
        problem = replace(problem, weight=found.weight)
        return SystemFit(problem, found, bits) if math.isfinite(bits) else None

    def _is_bare(self, expr: sympy.Expr) -> bool:
        """Whether a function takes so little of its argument that it is a line or a constant."""
        for function in expr.atoms(sympy.Function):
            factor, rest = function.args[0].as_coeff_Mul()
            if factor.is_Float and abs(float(factor)) * self._extent(rest)[0] < _BARE:
                return True
        return False

    def _extent(self, expr: sympy.Expr) -> tuple[float, float]:
        """Give range and root mean square of an expression of the columns along the data."""
        if expr not in self._extents:
            with np.errstate(all="ignore"):
                values = evaluate(expr, self.mesh.columns)
                size = float(np.sqrt(np.mean(np.square(values))))
                self._extents[expr] = float(np.ptp(values)), size
        return self._extents[expr]

    @property
    def _how(self) -> CollocationSettings:
        """How a system is fitted."""
        return self.settings.fit

    def fit_near(self, exprs: Equations, near: SystemFit) -> SystemFit | None:
        """Fit from a system that is almost the same, going back no further than needed.

        Another start may have led to a worse fit before, as it does on a chaotic run.

        Parameters
        ----------
        exprs : state -> equation.
        near : the system.
        """
        if not self.settings.demands.keep_all(exprs):
            return None
        key = form_of(exprs)
        before = self._cache.get(key)
        if before is not None and before.bits < near.bits:
            return before
        problem = Collocation(exprs, self.mesh, self._how)
        fit = self._solve(problem, near, strict=True)
        if fit is not None and (before is None or fit.bits < before.bits):
            self._cache[key] = before = fit
        # What misses by far does not come close from another start either.
        if before is None or near.bits <= before.bits < near.bits + self.settings.behind:
            self._cache.pop(key, None)
            again = self.fit(exprs, near)
            if before is not None and (again is None or before.bits <= again.bits):
                self._cache[key] = again = before
            before = again
        return before

    def changed(self, fit: SystemFit, state: str, expr: sympy.Expr) -> list[Equations]:
        """Give a system with one equation changed, and first with others changed as it is.

        These are its permuted equations, and those that contain what it loses.

        Parameters
        ----------
        fit : the system.
        state, expr : whose equation changes, and what it becomes.
        """
        if not self.settings.parts.has("changed-permuted"):
            return [{**fit.exprs, state: expr}]
        return with_permuted(fit.exprs, state, expr, self.mesh.states)

    def fit_again(self, exprs: Equations) -> SystemFit | None:
        """Fit from the constants given and the smoothed states; of two fits the better is kept.

        A fit that began far away may have missed the best constants.

        Parameters
        ----------
        exprs : state -> equation.
        """
        key = form_of(exprs)
        before = self._cache.pop(key, None)
        found = self.fit(exprs)
        if before is not None and (found is None or before.bits <= found.bits):
            self._cache[key] = found = before
        return found

    def bits(self, fit: CollocationFit, scales: np.ndarray) -> float:
        """Bits of residuals, terms and constants.

        Parameters
        ----------
        fit : the fit.
        scales : (P,) usual sizes of its constants.
        """
        has = self.settings.parts.has
        simple = simplicity_bits(fit.constants, fit.errors) * has("bits-simple")
        saved, cost = dict[tuple[int, ...], float](), 0.0
        if has("bits-shared"):
            saved, cost = shared_bits(fit.exprs, fit.constants, fit.covariance)
        for place, bits in enumerate(simple.tolist()):
            saved[(place,)] = max(bits, saved.get((place,), 0.0))
        told = shortened_bits(fit.information, scales, fit.constants, saved)
        if has("bits-inside"):
            cost += unusual_bits(fit.exprs.values(), lambda expr: self._extent(expr)[1])
        least = self.structure(fit.exprs) + told + cost
        # What a mass matrix ties together is said more shortly by each other.
        ties = find_couplings(fit.exprs, fit.constants, fit.covariance) if has("couplings") else ()
        for tie in ties:
            others = np.array(owners_of(fit.exprs)) != tie.state
            count = int(others.sum()) + len(tie.constants)
            few = precision_bits(fit.information, scales, fit.constants) * count / len(scales)
            less = float(np.sum(simple[others]))
            less += float(np.sum(simplicity_bits(tie.constants, tie.errors)))
            said = self.structure({**fit.exprs, tie.state: tie.expr})
            least = min(least, said + few - less + tie.loss)
        return self.missed_bits(fit) + least

    def missed_bits(self, fit: CollocationFit) -> float:
        """Bits of the residuals, and of defects that a fit leaves.

        Parameters
        ----------
        fit : the fit.
        """
        squares = np.maximum(fit.mean_squares, FLOOR)
        missed = residual_bits(squares, self.mesh.rows, self.mesh.known)
        return missed + fit.volume / (2 * math.log(2))

    def structure(self, exprs: Equations) -> float:
        """Bits of equations without their constants: by the textbooks, and the user's own.

        Parameters
        ----------
        exprs : state -> equation.
        """
        return structure_of(exprs, self.names, self.all_states, self.angles)

    def saved_bits(self, state: str, expr: sympy.Expr, written: Written) -> float:
        """Bits that an equation costs less together with others.

        Parameters
        ----------
        state, expr : whose equation it is, and the equation.
        written : what others have.
        """
        terms, place = read_equation(expr), self._place(state)
        alone = textbooks().equation_bits(terms, place, Written())
        return alone - textbooks().equation_bits(terms, place, written)

    def _place(self, state: str) -> Place:
        return Place(state, self.all_states, self.names, self.angles)

    def term_bits(self, term: sympy.Expr, state: str, written: Written) -> float:
        """Bits of one term without its constants.

        Parameters
        ----------
        term : a product.
        state : whose equation contains it.
        written : what other equations have.
        """
        return term_bits(term, self._place(state), written)

    def propose(
        self,
        state: str,
        evidence: Evidence,
        others: Sequence[tuple[str, sympy.Expr]] = (),
        *,
        functions: bool = True,
        near: sympy.Expr | None = None,
        from_nothing: bool = False,
    ) -> list[sympy.Expr]:
        """Give the sums of terms of the library that are expected to take the fewest bits.

        Parameters
        ----------
        state : whose equation is sought.
        evidence : what the data say of it.
        others : states and equations of theirs; terms in these cost less.
        functions : whether others than their terms and products of the columns are terms.
        near : an equation to start from; by default sums are grown from nothing.
        from_nothing : whether they are so with ``near`` too, which says then what they may cost.
        """
        demands, settings = self.settings.demands, self.settings.proposals
        place, allow = self._place(state), demands.limits(state).check
        offered = demands.offered
        return propose(
            evidence,
            place,
            allow,
            offered,
            others,
            settings,
            functions=functions,
            near=near,
            from_nothing=from_nothing,
        )

    def evidence(
        self, fit: SystemFit, parts: Mapping[str, tuple[float, sympy.Expr]]
    ) -> Evidence | None:
        """Give what is to replace parts of a system, with all the rest free; None for no such view.

        Parameters
        ----------
        fit, parts : the system and its parts, as :meth:`Evidence.in_place` takes them.
        """
        nodes = self.settings.proposals.nodes
        return Evidence.in_place(fit.fit, fit.problem, parts, self.columns, nodes, None)

    def _has_pole(self, fit: CollocationFit) -> bool:
        """Whether a denominator passes through 0 in the range of the columns."""
        return any(has_pole(expr, self.mesh.columns) for expr in fit.exprs.values())

    @property
    def all_states(self) -> tuple[str, ...]:
        """Columns that move by equations, those too that are read from their curves."""
        return self.states or self.mesh.states

    @property
    def names(self) -> tuple[str, ...]:
        """Columns that a formula may use: states, then driven ones; not the time."""
        return (*self.mesh.states, *self.mesh.driven_names[:-1])

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that equations may hold, the time the last."""
        return (*self.names, "t")

    @cached_property
    def _smoothed(self) -> dict[str, np.ndarray]:
        """Name -> (n,) values of each column where the smoothed states are."""
        begun = [self.mesh.start.T, self.mesh.driven[:-1, : len(self.mesh.t)]]
        return dict(zip(self.names, np.concatenate(begun), strict=True))

    @cached_property
    def angles(self) -> tuple[str, ...]:
        """Columns that may be angles: that take both signs, turn on and on, or have a speed."""
        return find_turning(self.names, self._smoothed.values(), self.mesh.t)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Columns whose speed is another one."""
        return find_coordinates(self._smoothed, self.mesh.t)

    def fits(self) -> Iterator[SystemFit]:
        """Give all systems that were fitted."""
        return (fit for fit in self._cache.values() if fit is not None)


def form_of(exprs: Equations) -> tuple[sympy.Expr, ...]:
    """Give what systems that differ in their constants alone have in common.

    Parameters
    ----------
    exprs : state -> equation.
    """
    return tuple(map(skeleton, exprs.values()))


def owners_of(exprs: Mapping[str, sympy.Expr]) -> list[str]:
    """Name the state of every constant of a system, in their order.

    Parameters
    ----------
    exprs : state -> equation.
    """
    return [s for s, expr in exprs.items() for _ in free_constants(expr, "c")[1]]


def leaves_noise(fit: SystemFit, settings: ComparisonSettings) -> bool:
    """Whether the residuals of every state are its noise.

    The mean square of n normal residuals in units of their noise is 1, give or take sqrt(2 / n).
    """
    rows = fit.problem.mesh.rows
    most = most_of_noise(rows, settings)

    def leaves(found: CollocationFit) -> bool:
        return bool(np.all((found.mean_squares - found.allowed <= most) | (rows == 0)))

    return leaves(fit.fit) and leaves(fit.strict)


def may_be_exact(fit: SystemFit, data: Measurements) -> bool:
    """Whether there may be no noise at all, but rows far apart that look like it.

    What is followed far closer than noise allows has none.

    Parameters
    ----------
    fit : a system.
    data : the measured states that it was fitted to.
    """
    return data.may_be_exact or float(np.min(fit.strict.mean_squares)) < _TOO_CLOSE


def noise_shown(fit: SystemFit) -> dict[str, float] | None:
    """State -> residuals of a system as a share of its noise; None where all are acceptable.

    Noise is estimated from how rows differ from their neighbours. With few rows per oscillation
    this is uncertain. Residuals of few rows are smaller than noise, since constants were fitted.

    Parameters
    ----------
    fit : the system.
    """
    mesh = fit.problem.mesh
    squares = np.sum(fit.strict.misses**2, axis=0) / np.maximum(mesh.rows, 1.0)
    fitted = mesh.rows.sum() / mesh.freedom(len(fit.fit.constants))
    shown = np.where((mesh.rows > 0) & ~mesh.known, squares * fitted, 1.0)
    if np.min(shown) >= _TOO_CLOSE:
        return None
    less = np.sqrt(np.minimum(shown, 1.0))
    return dict(zip(mesh.states, less.tolist(), strict=True))


def most_of_noise(rows: np.ndarray, settings: ComparisonSettings) -> np.ndarray:
    """Largest mean square of normal residuals that counts as noise, in units of that noise.

    Parameters
    ----------
    rows : measured rows, an array of any shape.
    settings : the numbers that decide.
    """
    return np.asarray(1 + settings.excess + SIGMA * np.sqrt(2 / np.maximum(rows, 1.0)))


def apart_by(own: np.ndarray, other: sympy.Expr, columns: Mapping[str, np.ndarray]) -> float:
    """Rms difference of an equation from slopes (n,), as a share of their spread; NaN for none.

    Parameters
    ----------
    own, other : the slopes and the equation.
    columns : name -> (n,) values of what it holds.
    """
    with np.errstate(all="ignore"):
        values = evaluate(other, columns)
        fine = np.isfinite(values) & np.isfinite(own)
        if 2 * np.count_nonzero(fine) < len(fine):
            return np.nan
        gap = float(np.sqrt(np.mean((values[fine] - own[fine]) ** 2)))
    return gap / max(float(np.std(own[fine])), 1e-300)


def shuffle(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Give the values of every column in an order of its own, always the same."""
    rng = np.random.default_rng(0)
    return {name: rng.permutation(values) for name, values in columns.items()}
