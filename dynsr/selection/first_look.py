"""First look: the sum of a few terms of the library that clean slopes follow to their own error.

Most laws are such a sum, and exact slopes show it at once. What is found is final where it cannot
be chance: it leaves nothing but the error of the slopes, and either no other choice of terms comes
near, or all of its constants are simple numbers to many more digits than they have.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from types import MappingProxyType

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import added_bits, evaluate, free_constants, number_bits
from dynsr.fit import (
    FIT,
    Candidate,
    FitSettings,
    cauchy_bits,
    cauchy_scale,
    constant_bits,
    independent_rows,
    loosen,
    one_of_each_shape,
    refit,
    score_candidate,
    simplest_form,
    slope_size,
    with_floats,
)
from dynsr.library import (
    Place,
    Term,
    Written,
    exact_bits,
    find_turning,
    read_body,
    read_equation,
    textbooks,
    write_down,
)
from dynsr.methods import Limits
from dynsr.selection.evidence import Evidence
from dynsr.selection.joints import hinged_sums
from dynsr.selection.parts import Parts
from dynsr.selection.permuted import exchanged, shifted
from dynsr.selection.propose import EXACT, PROPOSALS, RARE, ProposalSettings, propose
from dynsr.selection.relations import have_a_fixed_sum, is_left_open

SOURCE = "the first look"
# Share of its size by which a column leaves its middle where functions must be the same.
_ASIDE = 0.5
# Share that different writings of one function differ by there at most.
_SAME = 1e-6
# Shares of their size that exact slopes err by, whatever they say of themselves: those of states
# of a strict solver, and of a loose one.
_STRICT, _LOOSE = 1e-8, 1e-6
# Share of themselves to which constants of exact slopes are sure where all are simple at once.
_TOGETHER = 5e-5
# Constants of a formula to each that is no simple number.
_TO_AN_ODD_ONE = 4


@dataclass(frozen=True)
class LookSettings:
    """Settings of the first look; they are in the record of a run.

    Parameters
    ----------
    most : terms of a formula that may be final.
    kept : formulas that are fitted to all rows, and of those that leave nothing are written in
        simple numbers.
    exact : the slopes' own error, as a share of their size, above which nothing is final.
    within : residuals up to so many times that error count as that error.
    wild : share of the rows whose residuals may be more than ten times larger, where solvers and
        differences fail.
    alike : residuals up to so many times the least of all are as good, where nothing explains them.
    uneven : residuals up to so many times the error of rough slopes may be of a law: what a solver
        leaves between its steps is not seen in differences.
    doubt : share of the probability that all other formulas have at most where one is final.
    stands_out : how many times larger the residuals of every other choice of terms must be.
    proposals : of the sums of terms of the library, where slopes are exact.
    parts : which parts of the search take part.

    >>> LookSettings().kept
    12
    """

    most: int = 6
    kept: int = 12
    exact: float = 1e-4
    within: float = 3.0
    wild: float = 0.1
    alike: float = 4.0
    uneven: float = 10.0
    doubt: float = 0.05
    stands_out: float = 30.0
    proposals: ProposalSettings = EXACT
    parts: Parts = Parts()


LOOK: LookSettings = LookSettings()


@dataclass(frozen=True)
class Look:
    """What the first look found: formulas, the best first, and whether that one is final."""

    candidates: tuple[Candidate, ...] = ()
    final: bool = False


def look(
    samples: Samples,
    limits: Limits | None = None,
    settings: LookSettings = LOOK,
    fit: FitSettings = FIT,
    known: Mapping[str, sympy.Expr] = MappingProxyType({}),
    earlier: Sequence[sympy.Expr] = (),
    *,
    rare: bool = False,
) -> Look:
    """Look for the equation among sums of a few terms.

    Parameters
    ----------
    samples : of the state whose equation is sought.
    limits : what the user allows.
    settings : the numbers that decide.
    fit : how simple numbers are taken, and whether any are written.
    known : equations of other states. What flows from one state to another is in the equations of
        both, and states of one kind obey one law.
    earlier : what was found for it before.
    rare : whether to look among functions that hardly any law has, and not among the others.

    >>> x = np.linspace(0.2, 3.0, 200)
    >>> s = Samples(x[:, None], 2 * x / (x + 0.5), ("x",), "x", "given", x)
    >>> seen = look(s)
    >>> str(seen.candidates[0].expr), seen.final
    ('2*x/(x + 1/2)', True)
    """
    if len(samples) < 2 * settings.most or not np.all(np.isfinite(samples.y)):
        return Look()
    others = {
        s: sympy.Add(*map(with_floats, sympy.Add.make_args(expr))) for s, expr in known.items()
    }
    search = _Search(samples, limits or Limits(), settings, fit, others)
    with np.errstate(all="ignore"):
        # A twin may have the same constants.
        twins = search.twins() if settings.parts.has("look-permuted") else []
        found = list(search.take([*earlier, *twins, *search.refitted(twins)]))
        seen = search.conclude(found)
        if _is_law(seen):
            return seen
        if rare:
            return search.conclude(search.rare(found))
        found = search.proposed(found)
        return search.conclude(found if search.within_errors(found) else search.weighted(found))


def look_around(
    samples: Samples,
    limits: Limits,
    known: Mapping[str, sympy.Expr],
    settings: LookSettings = LOOK,
    fit: FitSettings = FIT,
) -> Look:
    """Look whether the equation is that of another state, with columns as far from it in the table.

    The cells of a ring, the tanks of a chain or the oscillators of a lattice obey one law. Where it
    is found for one of them, the others need no search.

    Parameters
    ----------
    samples : of the state whose equation is sought.
    limits : what the user allows.
    known : equations of other states.
    settings : the numbers that decide.
    fit : how simple numbers are taken, and whether any are written.

    Gives a law, or nothing.

    >>> x = np.random.default_rng(0).uniform(1, 2, (60, 3))
    >>> s = Samples(x, 3 * x[:, 2] * x[:, 0], ("x", "y", "z"), "z", "given", np.arange(60.0))
    >>> look_around(s, Limits(), {"x": sympy.sympify("3*x*y")}).candidates[0].expr
    3*x*z
    """
    if not settings.parts.has("look-permuted"):
        return Look()
    terms = {s: sympy.Add.make_args(expr) for s, expr in known.items() if not expr.is_Symbol}
    others = {s: sympy.Add(*map(loosen, own)) for s, own in terms.items()}
    search = _Search(samples, limits, settings, fit, others)
    names = samples.names
    with np.errstate(all="ignore"):
        ways = (shifted(expr, s, samples.target, names) for s, expr in others.items())
        seen = search.conclude(list(search.take(search.refitted(one_of_each_shape(ways)))))
    # Where a sum of columns stays the same, another form of the equation may be the shorter one.
    return seen if _is_law(seen) and not have_a_fixed_sum(samples.columns) else Look()


@dataclass(frozen=True, eq=False)
class _Choice:
    """A formula, its terms, and what it misses in units of the slopes' size.

    Parameters
    ----------
    expr, terms : the formula and its terms without constants.
    shape, constants : bits of its structure, and how many constants it has.
    miss, wild : the median miss, and that of the rows that are missed most.
    scale, said : the most probable scale of a Cauchy law of the residuals, and mean bits by it.
    rows : residuals that are independent of each other.
    """

    expr: sympy.Expr
    terms: frozenset[Term]
    shape: float
    constants: int
    miss: float
    wild: float
    scale: float
    said: float
    rows: float

    def bits(self, rows: float) -> float:
        """Bits of the formula, of its constants and of so many independent residuals."""
        return rows * self.said + self.shape + self.constants * constant_bits(rows)


@dataclass(frozen=True, eq=False)
class _Search:
    """One state's slopes, and what is looked for in them."""

    samples: Samples
    limits: Limits
    settings: LookSettings
    fit: FitSettings
    known: Mapping[str, sympy.Expr]
    simple: dict[tuple[_Choice, float | None], sympy.Expr] = field(default_factory=dict)
    open: dict[_Choice, bool] = field(default_factory=dict)

    @cached_property
    def size(self) -> float:
        """Usual size of the slopes."""
        return slope_size(self.samples)

    @cached_property
    def error(self) -> float:
        """Error of the slopes."""
        return max(float(self.samples.noise or 0.0), _STRICT * self.size)

    @cached_property
    def _sd(self) -> np.ndarray:
        """(n,) error of each slope."""
        own = self.samples.slope_sd
        return np.maximum(self.error if own is None else own, self.error) * np.ones(
            len(self.samples)
        )

    @property
    def trust(self) -> np.ndarray:
        """(n,) how certain each slope is, as a share of the most certain one."""
        return self.error / self._sd

    @property
    def is_exact(self) -> bool:
        """Whether the slopes err so little that what follows them may be final."""
        return self.error <= self.settings.exact * self.size

    @cached_property
    def _place(self) -> Place:
        own = self.samples
        angles = find_turning(own.names, own.X.T, own.t)
        return Place(own.target, own.names, own.names, angles)

    @cached_property
    def _given(self) -> list[sympy.Expr]:
        """The terms that the user offers."""
        return [term.as_coeff_Mul()[1] for term in self.limits.terms]

    @cached_property
    def _thinned(self) -> tuple[np.ndarray, Samples]:
        """Some of the rows that are sure, as many where the states move as where they rest.

        Gives their places, and the samples there.
        """
        sure = np.flatnonzero(self.trust >= np.quantile(self.trust, self.settings.wild))
        points = np.column_stack([self.samples.X, self.samples.y])[sure]
        moved = np.abs(np.diff(points, axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-300)
        way = np.concatenate([[0.0], np.cumsum(moved.sum(axis=1))])
        way = way / max(way[-1], 1e-300) + np.linspace(0.0, 1.0, len(sure))
        at = np.linspace(0.0, way[-1], min(len(sure), self.settings.proposals.nodes))
        rows = np.unique(np.searchsorted(way, at).clip(max=len(sure) - 1))
        return sure[rows], self.samples.select(sure[rows])

    @cached_property
    def _evidence(self) -> Evidence:
        rows, few = self._thinned
        return Evidence.of_slopes(few, self._sd[rows])

    def twins(self) -> list[sympy.Expr]:
        """Give the equations of other states with names exchanged so that they are this one's."""
        own = self.samples
        return [
            expr
            for state, other in self.known.items()
            if not other.is_Symbol
            for expr in exchanged(other, state, own.target, own.names)
        ]

    def hinged(self) -> list[sympy.Expr]:
        """Give the ratios of terms of a joint, for each column that may be its angle."""
        prior, rows = textbooks(), len(self.samples)

        def cost(term: sympy.Expr) -> float:
            said = prior.term_bits(read_body(term), self._place, Written())
            return said + constant_bits(rows)

        least = rows * self.error**2
        return [
            expr
            for angle in self._place.angles or ()
            for expr in hinged_sums(
                self.samples,
                angle,
                self.limits.allow,
                cost,
                self.trust,
                least,
                self.settings.within**2 * least,
                self.settings.kept,
            )
        ]

    def weighted(self, found: Sequence[_Choice]) -> list[_Choice]:
        """Add sums that are proposed where the best one misses little, while that finds better.

        A solver errs from step to step by amounts of very different sizes, and within one step
        these depend on each other. The law misses most rows by little and a few by far.
        """
        found = list(found)
        gained = math.inf if found and self._is_explained(found) else 0.0
        while gained > 1:
            best, rows = self._shortest(found)
            view, others = self._weighted_by(best, rows), list(self.known.items())
            sums = propose(view, self._place, self.limits.check, self._given, others)
            found += self.take(self.refitted(sums[: self.settings.kept]))
            gained = best.bits(rows) - self._shortest(found)[0].bits(rows)
        return found

    def _weighted_by(self, best: _Choice, rows: float) -> Evidence:
        """Weight the slopes by how probable they are where a formula is the law."""
        places, few = self._thinned
        left = self._left(best.expr)[places]
        errors = np.hypot(left, best.scale) * self.size / self.trust[places]
        view = Evidence.of_slopes(few, errors)
        own = float(np.sum((self._sd[places] / errors) ** 2))
        return replace(view, rows=rows, beside=own)

    def _shortest(self, found: Iterable[_Choice]) -> tuple[_Choice, float]:
        """Give the choice of the fewest bits, and the independent residuals that these count."""
        rows = min(found, key=lambda c: c.scale).rows
        return min(found, key=lambda c: c.bits(rows)), rows

    def _is_explained(self, found: Sequence[_Choice]) -> bool:
        """Whether the best of the formulas leaves what may be the error of rough slopes."""
        return self._shortest(found)[0].scale * self.size <= self.settings.uneven * self.error

    def proposed(self, found: Sequence[_Choice]) -> list[_Choice]:
        """Add the sums of terms of the library that are expected to take the fewest bits.

        Ratios of terms of a joint cost as much as the most expensive of these.
        """
        allow, others = self.limits.check, list(self.known.items())
        found, looked = list(found), not (self.is_exact and self.settings.parts.has("joints"))

        def enough(sums: Iterator[sympy.Expr], left: int) -> bool:
            nonlocal looked
            some = self.refitted(islice(sums, self.settings.most))
            seen = self.conclude([*found, *self.take(some)])
            if left <= 1 and not looked and not _is_law(seen):
                looked = True
                found.extend(self.take(self.hinged()))
                seen = self.conclude(found)
            return _is_law(seen)

        # Rough slopes tell fewer sums apart.
        settings = self.settings.proposals if self.is_exact else PROPOSALS
        place, view, kept = self._place, self._evidence, self.settings.kept
        sums = propose(view, place, allow, self._given, others, settings, enough=enough)
        # The others show whether the best of them is alone.
        return [*found, *self.take([*self.refitted(sums[:kept]), *sums[kept:]])]

    def rare(self, found: Sequence[_Choice]) -> list[_Choice]:
        """Add sums with functions that hardly any law has, where slopes are exact."""
        if not self.is_exact:
            return list(found)
        sums = propose(self._evidence, self._place, self.limits.check, settings=RARE)
        return [*found, *self.take(self.refitted(sums[: self.settings.kept]))]

    def refitted(self, exprs: Iterable[sympy.Expr]) -> list[sympy.Expr]:
        """Fit formulas to all rows."""
        return [refit(expr, self.samples, self.error) for expr in exprs]

    def take(self, exprs: Iterable[sympy.Expr]) -> Iterator[_Choice]:
        """Take formulas for what is chosen, where the user allows them."""
        written = write_down(self.known.items())
        for expr in exprs:
            bodies = [term.as_coeff_Mul()[1] for term in sympy.Add.make_args(expr)]
            if not all(map(self.limits.allow, bodies)):
                continue
            left = self._left(expr)
            misses, scale = np.abs(left), cauchy_scale(left, self.error / self.size)
            yield _Choice(
                expr,
                frozenset(read_equation(expr)),
                self._length(expr, written),
                len(free_constants(expr, "c")[1]),
                float(np.median(misses)),
                float(np.quantile(misses, 1 - self.settings.wild)),
                scale,
                cauchy_bits(left, scale),
                float(independent_rows(left[:, None, None], 1.0)[0]),
            )

    def _left(self, expr: sympy.Expr) -> np.ndarray:
        """(n,) what a formula misses, in units of the slopes' size."""
        own = self.samples
        return np.asarray((own.y - evaluate(expr, own.columns)) * self.trust / self.size)

    def _cost(self, choice: _Choice) -> float:
        """Bits of a choice, its constants as they are fitted."""
        return choice.shape + choice.constants * constant_bits(len(self.samples))

    def _bits_as_written(self, pair: tuple[_Choice, sympy.Expr]) -> float:
        """Bits of a choice whose constants are simple numbers."""
        choice, simple = pair
        powers = {p.exp for p in simple.atoms(sympy.Pow) if p.exp.is_Rational}
        inside = sum(number_bits(one) for one in powers if not one.is_Integer)
        # A constant that is no simple number is known to as many bits as the slopes are exact.
        measured = len(simple.atoms(sympy.Float)) * math.log2(self.size / self.error)
        return choice.shape + exact_bits(simple) + inside + measured

    def _is_open(self, choice: _Choice) -> bool:
        """Whether a choice is one of many that are the same along the data."""
        if choice not in self.open:
            self.open[choice] = is_left_open(choice.expr, self.samples.columns)
        return self.open[choice]

    def _simplest(self, choice: _Choice, most: float) -> sympy.Expr | None:
        """Write a choice in simple numbers; None where that misses by more than allowed."""
        near: list[sympy.Expr] = []
        # What all constants are at once they are not by chance, though each may err by more.
        for share in (None, _TOGETHER):
            simple = self._in_simple_numbers(choice, share)
            misses = np.abs(self.samples.y - evaluate(simple, self.samples.columns)) * self.trust
            if np.median(misses) <= most:
                if _is_simple(simple):
                    return simple
                near.append(simple)
        return near[0] if near else None

    def _length(self, expr: sympy.Expr, written: Written | None = None) -> float:
        """Bits of a formula without its constants, by the textbooks, after what is written."""
        alone = textbooks().bits_together(expr, self._place, written or Written())
        return alone + added_bits(expr)

    def _in_simple_numbers(self, choice: _Choice, share: float | None) -> sympy.Expr:
        if (choice, share) not in self.simple:
            columns = self.samples.columns
            # That all constants are simple is no chance, whether they are written so or as fitted.
            fit = replace(self.fit, snap=True)
            self.simple[choice, share] = simplest_form(
                choice.expr, columns, fit, share, self._length
            )
        return self.simple[choice, share]

    def _stands_out(self, best: _Choice, found: Sequence[_Choice]) -> bool:
        """Whether every other function of the states misses far more.

        Where a short arc is followed by any few terms, it is by many choices of them.
        """
        bound = self.settings.stands_out * max(best.miss, self.error / self.size)
        near = [c for c in found if not c.terms >= best.terms and c.miss <= bound]
        return best.constants <= self.settings.most and all(self._same(best, c) for c in near)

    def _same(self, one: _Choice, other: _Choice) -> bool:
        """Whether two are the same function, also away from the trajectory."""
        X = self.samples.X
        middle, reach = X.mean(axis=0), np.maximum(np.ptp(X, axis=0), 1e-300) / 2
        # Along a short arc all that follow it are alike.
        wider = middle + np.maximum(2.0, _ASIDE * np.abs(middle) / reach) * (X - middle)
        beside = {
            name: np.roll(wider[:, i], i * len(X) // 5) for i, name in enumerate(self.samples.names)
        }
        a, b = evaluate(one.expr, beside), evaluate(other.expr, beside)
        finite = np.isfinite(a) & np.isfinite(b)
        gap, size = np.abs(a - b)[finite], np.abs(a)[finite]
        return bool(finite.any() and np.median(gap) <= _SAME * np.median(size))

    def within_errors(self, found: Sequence[_Choice]) -> list[_Choice]:
        """Give the formulas that leave nothing but the error of the slopes."""
        settings, good = self.settings, list[_Choice]()
        for error in (self.error / self.size, max(self.error / self.size, _LOOSE)):
            most = settings.within * error if error <= settings.exact else 0.0
            good = good or [c for c in found if max(c.miss, 0.1 * c.wild) <= most]
        return good

    def conclude(self, choices: Sequence[_Choice]) -> Look:
        """Take the shortest formula with negligible residuals; say whether chance explains it."""
        if not choices:
            return Look()
        found = list(dict.fromkeys(choices))
        settings, good = self.settings, self.within_errors(found)
        # One of many that are the same along the data gives way to what is alone there.
        settled = [c for c in good if not self._is_open(c)]
        if settled:
            found = [c for c in found if c in settled or c not in good]
            good = settled
        exprs: list[sympy.Expr] = []
        final = False
        if not good and self._is_explained(found):
            best, rows = self._shortest(found)
            ranked = sorted(found, key=lambda c: c.bits(rows))
            others = [c for c in ranked if not c.terms >= best.terms and not self._same(best, c)]
            weight = sum(2.0 ** (best.bits(rows) - c.bits(rows)) for c in others)
            ends = not self.is_exact and settings.parts.has("end-look")
            final = ends and weight <= settings.doubt and not self._is_open(best)
        else:
            # What nothing explains is the same for all that is near the law.
            bound = settings.alike * min(c.miss for c in found)
            near = good or [c for c in found if c.miss <= bound]
            ranked = sorted(near, key=self._cost)
            ranked += sorted((c for c in found if c not in near), key=lambda c: c.miss)
        if good:
            # What cannot be chance leads: a longer formula whose constants are all simple numbers.
            most = settings.within * max(self.error, max(c.miss for c in good) * self.size)
            first = ranked[: min(len(good), settings.kept)]
            written = [(c, self._simplest(c, most)) for c in first]
            simply = self.settings.parts.has("end-simple")
            sure = [(c, e) for c, e in written if e is not None and _is_simple(e) and simply]
            # Of several that are written in simple numbers it is the shortest as written.
            best, simple = min(sure, key=self._bits_as_written) if sure else written[0]
            if simple is not None:
                columns = self.samples.columns
                plain = simplest_form(best.expr, columns, self.fit, length=self._length)
                exprs.append(simple if self.fit.snap else plain)
            ranked.sort(key=lambda c: c is not best)
            alone = settings.parts.has("end-alone") and self._stands_out(best, found)
            final = bool(settled) and (bool(sure) or alone) and settings.parts.has("end-look")
        exprs += [c.expr for c in ranked[: settings.kept]]
        named = dict.fromkeys(exprs)
        return Look(tuple(score_candidate(e, self.samples, SOURCE) for e in named), final)


def _is_law(seen: Look) -> bool:
    """Whether what was found is final and in simple numbers: then it is the law, whatever comes."""
    return seen.final and _is_simple(seen.candidates[0].expr)


def _is_simple(expr: sympy.Expr) -> bool:
    """Whether the constants of a formula are simple numbers, all but one in four at most.

    A product of two of them may be none, as r / K is in r x (1 - x / K).
    """
    written = expr.replace(lambda e: e.is_Pow and e.exp.is_Integer, lambda e: e.base)
    numbers = [a for a in sympy.preorder_traversal(written) if a.is_Number and abs(a) != 1]
    return len(numbers) >= _TO_AN_ODD_ONE * sum(a.is_Float for a in numbers)
