"""First look: the sum or ratio of a few terms that clean slopes follow down to their own error.

Most laws are such a sum or ratio, and exact slopes show it at once. What is found is final where
it cannot be chance: it leaves nothing but the error of the slopes, and either no other choice of
terms comes near, or all of its constants are simple numbers to many more digits than they have.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations_with_replacement, islice
from itertools import count as counting
from types import MappingProxyType

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import compile_columns, evaluate, number_bits
from dynsr.fit import (
    FIT,
    Candidate,
    FitSettings,
    constant_bits,
    eliminate,
    fit_ratio,
    refit,
    score_candidate,
    simplest_form,
    slope_size,
    structure_bits,
    with_floats,
)
from dynsr.library import Place, exact_bits, find_angles, find_turning
from dynsr.methods import Limits
from dynsr.selection.costs import shape_bits, unusual_bits
from dynsr.selection.evidence import Evidence
from dynsr.selection.parts import Parts
from dynsr.selection.propose import EXACT, ProposalSettings, cited_terms, propose
from dynsr.selection.relations import is_left_open
from dynsr.selection.several import SeveralInside
from dynsr.selection.subsets import best_subsets
from dynsr.selection.terms import (
    Joint,
    Terms,
    TermSettings,
    products,
)
from dynsr.selection.twins import exchanged

SOURCE = "the first look"
# Of more columns none is surely left out by chance; steps that are looked at; rounds of a fit.
_MOST_ELIMINATED, _LAST, _ROUNDS = 100, 4, 3
# Share of its size by which a column leaves its middle where functions must be the same.
_ASIDE = 0.5
# Share that different writings of one function differ by there at most.
_SAME = 1e-6
# Of those that leave nothing, how many are written in simple numbers.
_WRITTEN = 12
# Shares of their size that exact slopes err by, whatever they say of themselves: those of states
# of a strict solver, and of a loose one.
_STRICT, _LOOSE = 1e-8, 1e-6
# Share of themselves to which constants of exact slopes are sure where all are simple at once.
_TOGETHER = 5e-5
# Constants of a formula to each that is no simple number.
_TO_AN_ODD_ONE = 4
# Bits of saying whose twin an equation is, and which names change places.
_SAID = 8.0
# Rows at which functions of several constants are fitted.
_FEW = 80
# Times the median miss beyond which a row may be one where differences fail.
_FAR = 10.0


@dataclass(frozen=True)
class LookSettings:
    """Settings of the first look; they stand in a run's record.

    Parameters
    ----------
    terms : the terms of sums, and of what stands above the line of a ratio.
    below : degree of the products below the line.
    most : terms at most.
    kept : choices of terms of each kind that are fitted.
    exact : the slopes' own error, as a share of their size, above which nothing is final.
    within : misses of up to so many times that error are nothing but it.
    wild : share of the rows that may miss by more than ten times as much, where solvers and
        differences fail.
    alike : misses up to so many times the least of all are as good where slopes are rough.
    sparse : rows up to which data that look noisy may be exact ones far apart.
    stands_out : how many times larger the misses of every other choice of terms must be.
    proposals : of the sums of terms of the library.
    parts : which parts of the search take part.

    >>> LookSettings().below
    2
    """

    terms: TermSettings = TermSettings(inside=())
    below: int = 2
    most: int = 6
    kept: int = 12
    exact: float = 1e-4
    within: float = 3.0
    wild: float = 0.1
    alike: float = 4.0
    sparse: int = 300
    stands_out: float = 30.0
    proposals: ProposalSettings = EXACT
    parts: Parts = Parts()


LOOK: LookSettings = LookSettings()


@dataclass(frozen=True)
class Look:
    """What the first look found: formulas, the likeliest first, and whether that one is final."""

    candidates: tuple[Candidate, ...] = ()
    final: bool = False


def look(
    samples: Samples,
    limits: Limits | None = None,
    settings: LookSettings = LOOK,
    fit: FitSettings = FIT,
    known: Mapping[str, sympy.Expr] = MappingProxyType({}),
    earlier: Sequence[sympy.Expr] = (),
) -> Look:
    """Look for the equation among sums and ratios of a few terms.

    Parameters
    ----------
    samples : of the state whose equation is sought.
    limits : what the user allows.
    settings : the numbers that decide.
    fit : how simple numbers are taken, and whether any are written.
    known : equations of other states. What flows from one state to another stands in the equations
        of both, and what is of one kind obeys one law.
    earlier : what was found for it before.

    >>> x = np.linspace(0.2, 3.0, 200)
    >>> s = Samples(x[:, None], 2 * x / (x + 0.5), ("x",), "x", "given", x)
    >>> seen = look(s)
    >>> str(seen.candidates[0].expr), seen.final
    ('2*x/(x + 1/2)', True)
    """
    if len(samples) < 2 * settings.most or not np.all(np.isfinite(samples.y)):
        return Look()
    with np.errstate(all="ignore"):
        allowed, parts = limits or Limits(), settings.parts
        others = {s: _in_floats(expr) for s, expr in known.items()}
        search = _Search.of(samples, allowed, settings, fit, others)
        found = [one for kind in search.kinds() for one in search.choose(kind)]
        twins = search.twins(others) if parts.has("look-twins") else []
        found += search.take([*earlier, *search.refitted(twins)], allowed)
        # Said by whose twin it is, one with the same constants is shorter than whatever else it is.
        found += [replace(one, cost=_SAID) for one in search.take(twins, allowed)]
        seen = search.conclude(found)
        for angle in find_angles(samples.names, samples.X.T):
            if not seen.final and not known and parts.has("look-angles"):
                swings = _Search.around(angle, samples, allowed, settings, fit)
                again = swings.conclude(list(swings.choose(np.arange(len(swings.exprs)))))
                seen = again if again.final else seen
        # What is written in simple numbers is the law, whatever else comes near.
        if search.is_exact and not (seen.final and _is_simple(seen.candidates[0].expr)):
            for sums in (search.proposed, search.several):
                found += search.take(sums(allowed, others), allowed)
                again = search.conclude(found)
                seen = again if again.final or not seen.final else seen
                if again.final:
                    break
        return seen


@dataclass(frozen=True, eq=False)
class _Choice:
    """Some terms with their coefficients, and what they miss in units of the slopes' size.

    ``above`` and ``below`` the line are pairs of a coefficient and its term.
    """

    places: frozenset[int]
    above: tuple[tuple[float, sympy.Expr], ...]
    below: tuple[tuple[float, sympy.Expr], ...]
    cost: float
    miss: float
    wild: float

    @cached_property
    def expr(self) -> sympy.Expr:
        """The formula; most choices need none."""
        over, under = (
            sympy.Add(*[sympy.Float(c) * e for c, e in part]) for part in (self.above, self.below)
        )
        return over / (1 + under) if self.below else over

    @property
    def order(self) -> tuple[int, ...]:
        """What decides between equals."""
        return tuple(sorted(self.places))


@dataclass(frozen=True, eq=False)
class _Search:
    """Columns (p, n) that sum to the slopes: terms above the line, then slopes times those below.

    f = N / (1 + D) is N - f D = f: linear in all coefficients.
    """

    samples: Samples
    settings: LookSettings
    fit: FitSettings
    exprs: tuple[sympy.Expr, ...]
    above: int
    values: np.ndarray
    costs: np.ndarray
    error: float
    size: float
    trust: np.ndarray
    cited: np.ndarray | None = None
    fitted: dict[frozenset[int], _Choice | None] = field(default_factory=dict)
    simple: dict[tuple[_Choice, float | None], sympy.Expr] = field(default_factory=dict)
    open: dict[_Choice, bool] = field(default_factory=dict)
    # What formulas have for terms, which are no columns.
    numbers: Iterator[int] = field(default_factory=lambda: counting(-1, -1))

    @classmethod
    def of(
        cls,
        samples: Samples,
        limits: Limits,
        settings: LookSettings,
        fit: FitSettings,
        known: Mapping[str, sympy.Expr] | None = None,
    ) -> _Search:
        names = samples.names
        angles = find_angles(names, samples.X.T)
        cited = cited_terms((known or {}).values(), samples.target)
        own = (*limits.terms, *cited)
        terms = Terms.grow(names, samples.X.T, settings.terms, angles, own)
        under = _factors(names, angles, settings.below)
        found = cls._make(terms.exprs, terms.bits, under, samples, limits, settings, fit)
        return replace(found, cited=np.array([expr in cited for expr in found.exprs]))

    @classmethod
    def around(
        cls,
        angle: str,
        samples: Samples,
        limits: Limits,
        settings: LookSettings,
        fit: FitSettings,
    ) -> _Search:
        """Take what hangs from a joint: products with the sine and cosine of one angle."""
        joint = Joint.of(angle, samples.names, settings.below)
        bits = np.array([structure_bits(0.5 * e) for e in joint.above])
        sine, cosine = sympy.sin(sympy.Symbol(angle)), sympy.cos(sympy.Symbol(angle))
        under = [cosine, sine * cosine, sine**2]
        return cls._make(joint.above, bits, under, samples, limits, settings, fit)

    @classmethod
    def _make(
        cls,
        above: Sequence[sympy.Expr],
        bits: np.ndarray,
        below: Sequence[sympy.Expr],
        samples: Samples,
        limits: Limits,
        settings: LookSettings,
        fit: FitSettings,
    ) -> _Search:
        allowed = [i for i, e in enumerate(above) if limits.allow(e)]
        over = [above[i] for i in allowed]
        under = [e for e in below if limits.allow(1 / (1 + e))]
        values = compile_columns([*over, *under], samples.names)(*samples.X.T)
        values[len(over) :] *= -samples.y
        size, sd = slope_size(samples), samples.slope_sd
        error = max(float(samples.noise or 0.0), _STRICT * size)
        line = structure_bits(1 / (1 + sympy.Symbol("x"))) - structure_bits(sympy.Symbol("x"))
        costs = [*bits[allowed], *(structure_bits(0.5 * e) + line for e in under)]
        return cls(
            samples,
            settings,
            fit,
            (*over, *under),
            len(over),
            values,
            np.array(costs) + constant_bits(len(samples)),
            error,
            size,
            error / np.maximum(error if sd is None else sd, error) * np.ones(len(samples)),
        )

    @property
    def is_exact(self) -> bool:
        """Whether the slopes err so little that what follows them may be final."""
        return self.error <= self.settings.exact * self.size

    def kinds(self) -> Iterator[np.ndarray]:
        """Give the places of polynomials, of cited and all terms, and of ratios of each degree."""
        symbols = [sympy.Symbol(name) for name in self.samples.names]
        degree = np.array(
            [sympy.total_degree(e) if e.is_polynomial(*symbols) else np.inf for e in self.exprs],
            dtype=float,
        )
        over, parts = np.arange(len(self.exprs)) < self.above, self.settings.parts
        if parts.has("look-polynomials"):
            yield np.flatnonzero(over & np.isfinite(degree))
        if self.cited is not None and self.cited.any() and parts.has("look-cited"):
            # What flows from one state to another is in the equations of both.
            for most in (1, 2, 3):
                yield np.flatnonzero(over & (self.cited | (degree <= most)))
        yield np.flatnonzero(over)
        if parts.has("look-ratios"):
            for top, bottom in ((2, 1), (3, 1), (3, 2)):
                yield np.flatnonzero(degree <= np.where(over, top, bottom))
            yield np.arange(len(self.exprs))

    def choose(self, kind: np.ndarray) -> Iterator[_Choice]:
        """Give the choices of terms that a beam and a backward elimination end at."""
        values = self.values[kind]
        kind = kind[np.all(np.isfinite(values), axis=1) & np.any(values != 0, axis=1)]
        if not len(kind):
            return
        columns, y = self.values[kind] * self.trust, self.samples.y * self.trust
        unit = np.linalg.norm(columns, axis=1)
        columns = columns / unit[:, None]
        # Between distant rows slopes are rougher than their misses: these alone say which is best.
        least = len(y) * min(self.error, self.settings.exact * self.size) ** 2
        subsets = best_subsets(
            columns @ columns.T,
            columns @ y,
            float(y @ y),
            self.costs[kind],
            float(len(y)),
            most=self.settings.most,
            keep=self.settings.kept,
            least=least,
        )
        chosen = [subset.places for subset in subsets]
        chosen += self._eliminate(columns) if self.settings.parts.has("look-elimination") else []
        for places in dict.fromkeys(chosen):
            one = self._fit([int(kind[i]) for i in places])
            if one is not None:
                yield one

    @cached_property
    def _thinned(self) -> Samples:
        """Some of the rows that are sure, as many where the states move as where they rest."""
        sure = np.flatnonzero(self.trust >= np.quantile(self.trust, self.settings.wild))
        points = np.column_stack([self.samples.X, self.samples.y])[sure]
        moved = np.abs(np.diff(points, axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-300)
        way = np.concatenate([[0.0], np.cumsum(moved.sum(axis=1))])
        way = way / max(way[-1], 1e-300) + np.linspace(0.0, 1.0, len(sure))
        at = np.linspace(0.0, way[-1], min(len(sure), self.settings.proposals.nodes))
        rows = np.unique(np.searchsorted(way, at).clip(max=len(sure) - 1))
        return self.samples.select(sure[rows])

    def twins(self, known: Mapping[str, sympy.Expr]) -> list[sympy.Expr]:
        """Give the equations of other states with names exchanged so that they are this one's.

        Parameters
        ----------
        known : those equations.
        """
        own = self.samples
        return [
            expr
            for state, other in known.items()
            if not other.is_Symbol
            for expr in exchanged(other, state, own.target, own.names)
        ]

    def proposed(self, limits: Limits, known: Mapping[str, sympy.Expr]) -> list[sympy.Expr]:
        """Give the sums of terms of the library that are expected to take the fewest bits.

        Parameters
        ----------
        limits : what the user allows.
        known : equations of other states.
        """
        if not self.settings.parts.has("look-library"):
            return []
        few, names = self._thinned, self.samples.names
        angles = find_turning(names, self.samples.X.T)
        place = Place(few.target, names, names, angles)
        sure = self.error if few.slope_sd is None else np.maximum(few.slope_sd, self.error)
        evidence = Evidence.of_slopes(few, sure * np.ones(len(few)))
        others, given = list(known.items()), self._given(limits)
        sums = propose(evidence, place, limits.allow, given, others, self.settings.proposals)
        # The others show whether the best of them is alone.
        kept = self.settings.kept
        return [*self.refitted(sums[:kept]), *sums[kept:]]

    def several(self, limits: Limits, known: Mapping[str, sympy.Expr]) -> list[sympy.Expr]:
        """Give sums with functions of several constants that are none of the library.

        Parameters
        ----------
        limits : what the user allows.
        known : equations of other states; where there are any, these sums were looked at before.
        """
        if known or not self.settings.parts.has("look-several-inside"):
            return []
        rows = np.unique(np.linspace(0, len(self._thinned) - 1, _FEW).astype(int))
        most = self.settings.within * max(self.error, _LOOSE * self.size)
        own = SeveralInside.of(self._thinned.select(rows), limits.allow)
        return self.refitted(own.sums([self.settings.within * self.error, most]))

    @staticmethod
    def _given(limits: Limits) -> list[sympy.Expr]:
        return [term.as_coeff_Mul()[1] for term in limits.terms]

    def refitted(self, exprs: Iterable[sympy.Expr]) -> list[sympy.Expr]:
        """Fit formulas to all rows.

        Parameters
        ----------
        exprs : the formulas.
        """
        return [refit(expr, self.samples, self.error) for expr in exprs]

    def take(self, exprs: Sequence[sympy.Expr], limits: Limits) -> Iterator[_Choice]:
        """Take formulas for what is chosen, where the user allows them.

        Parameters
        ----------
        exprs : the formulas.
        limits : what the user allows.
        """
        own = self.samples
        for expr in exprs:
            terms = sympy.Add.make_args(expr)
            if not all(limits.allow(term.as_coeff_Mul()[1]) for term in terms):
                continue
            misses = np.abs(own.y - evaluate(expr, own.columns)) * self.trust
            count = len(terms) + len(
                {a for term in terms for a in term.as_coeff_Mul()[1].atoms(sympy.Float)}
            )
            bits = sum(shape_bits(term) + unusual_bits(term, ()) for term in terms)
            yield _Choice(
                frozenset(islice(self.numbers, count)),
                ((1.0, expr),),
                (),
                bits + count * constant_bits(len(own)),
                float(np.median(misses)) / self.size,
                float(np.quantile(misses, 1 - self.settings.wild)) / self.size,
            )

    def _eliminate(self, columns: np.ndarray) -> list[tuple[int, ...]]:
        """Take the terms out that are not missed, from all of them; none where all miss."""
        y = self.samples.y * self.trust
        found: list[tuple[int, ...]] = []
        if len(columns) > min(len(y) // 3, _MOST_ELIMINATED):
            return found
        # The errors of slopes differ along a run: the last few steps are all looked at.
        most = 10 * self.settings.within * self.error * np.sqrt(len(y))
        for kept, coefficients in eliminate(columns.T, y):
            if np.linalg.norm(y - coefficients @ columns[list(kept)]) > most:
                break
            found.append(kept)
        return found[-_LAST:]

    def _fit(self, places: Sequence[int]) -> _Choice | None:
        """Fit a choice once, however many kinds hold it."""
        own = frozenset(places)
        if own not in self.fitted:
            self.fitted[own] = self._fit_anew(places)
        return self.fitted[own]

    def _fit_anew(self, places: Sequence[int]) -> _Choice | None:
        over = [i for i in places if i < self.above]
        below = [i for i in places if i >= self.above]
        if not over:
            return None
        y = self.samples.y
        signed = np.where(y == 0, 0.0, -self.values[below] / np.where(y == 0, 1.0, y))
        weights = self.trust**2
        fit = fit_ratio(self.values[over], signed, y, weights=weights, rounds=_ROUNDS)
        misses, wild = np.abs(fit.residual) * self.trust, 1 - self.settings.wild
        if np.max(misses) > _FAR * np.median(misses):
            # Rows where differences fail would pull what all others say exactly.
            kept = weights * (misses <= np.quantile(misses, wild))
            again = fit_ratio(self.values[over], signed, y, weights=kept, rounds=_ROUNDS)
            if np.median(np.abs(again.residual) * self.trust) < np.median(misses):
                fit, misses = again, np.abs(again.residual) * self.trust
        bottom = 1 + fit.denominator @ signed
        if np.min(np.abs(bottom)) < 1e-6 * np.max(np.abs(bottom)):
            return None
        return _Choice(
            frozenset(places),
            tuple(zip(fit.numerator, [self.exprs[i] for i in over], strict=True)),
            tuple(zip(fit.denominator, [self.exprs[i] for i in below], strict=True)),
            float(self.costs[list(places)].sum()),
            float(np.median(misses)) / self.size,
            float(np.quantile(misses, wild)) / self.size,
        )

    def _bits_as_written(self, pair: tuple[_Choice, sympy.Expr]) -> float:
        """Bits of a choice whose constants are simple numbers."""
        choice, simple = pair
        powers = {p.exp for p in simple.atoms(sympy.Pow) if p.exp.is_Rational}
        inside = sum(number_bits(one) for one in powers if not one.is_Integer)
        # A constant that is no simple number is known to as many bits as the slopes are exact.
        measured = len(simple.atoms(sympy.Float)) * math.log2(self.size / self.error)
        shape = choice.cost - len(choice.places) * constant_bits(len(self.samples))
        return shape + exact_bits(simple) + inside + measured

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

    def _in_simple_numbers(self, choice: _Choice, share: float | None) -> sympy.Expr:
        if (choice, share) not in self.simple:
            columns = self.samples.columns
            # That all constants are simple is no chance, whether they are written so or as fitted.
            fit = replace(self.fit, snap=True)
            self.simple[choice, share] = simplest_form(choice.expr, columns, fit, share)
        return self.simple[choice, share]

    def _stands_out(self, best: _Choice, found: Sequence[_Choice]) -> bool:
        """Whether every other function of the states misses far more.

        Where a short arc is followed by any few terms, it is by many choices of them.
        """
        bound = self.settings.stands_out * max(best.miss, self.error / self.size)
        near = [c for c in found if not c.places >= best.places and c.miss <= bound]
        return len(best.places) <= self.settings.most and all(self._same(best, c) for c in near)

    def _same(self, one: _Choice, other: _Choice) -> bool:
        """Whether two are one function, beside the trajectory too."""
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

    def conclude(self, choices: Sequence[_Choice]) -> Look:
        """Take the shortest that leaves nothing, and say whether it can be chance."""
        if not choices:
            return Look()
        found = list(dict.fromkeys(choices))
        settings = self.settings
        good: list[_Choice] = []
        for error in (self.error / self.size, max(self.error / self.size, _LOOSE)):
            most = settings.within * error if error <= settings.exact else 0.0
            good = good or [c for c in found if max(c.miss, 0.1 * c.wild) <= most]
        # One of many that are the same along the data gives way to what is alone there.
        settled = [c for c in good if not self._is_open(c)]
        if settled:
            found = [c for c in found if c in settled or c not in good]
            good = settled
        # What rough slopes miss is the same for all that is near the law.
        bound = settings.alike * min(c.miss for c in found)
        near = good or [c for c in found if c.miss <= bound]
        ranked = sorted(near, key=lambda c: (c.cost, c.order))
        ranked += sorted(set(found) - set(near), key=lambda c: (c.miss, c.order))
        exprs: list[sympy.Expr] = []
        final = False
        if good:
            # What cannot be chance leads: a longer formula whose constants are all simple numbers.
            most = settings.within * max(self.error, max(c.miss for c in good) * self.size)
            written = [(c, self._simplest(c, most)) for c in ranked[: min(len(good), _WRITTEN)]]
            simply = self.settings.parts.has("end-simple")
            sure = [(c, e) for c, e in written if e is not None and _is_simple(e) and simply]
            # Of several that are written in simple numbers it is the shortest as written.
            best, simple = min(sure, key=self._bits_as_written) if sure else written[0]
            if simple is not None:
                plain = simplest_form(best.expr, self.samples.columns, self.fit)
                exprs.append(simple if self.fit.snap else plain)
            ranked.sort(key=lambda c: c is not best)
            alone = settings.parts.has("end-alone") and self._stands_out(best, found)
            final = bool(settled) and (bool(sure) or alone) and settings.parts.has("end-look")
        exprs += [c.expr for c in ranked[: settings.kept]]
        named = dict.fromkeys(exprs)
        return Look(tuple(score_candidate(e, self.samples, SOURCE) for e in named), final)


def _in_floats(expr: sympy.Expr) -> sympy.Expr:
    return sympy.Add(*map(with_floats, sympy.Add.make_args(expr)))


def _is_simple(expr: sympy.Expr) -> bool:
    """Whether the constants of a formula are simple numbers, all but one in four at most.

    A product of two of them may be none, as r / K is in r x (1 - x / K).
    """
    written = expr.replace(lambda e: e.is_Pow and e.exp.is_Integer, lambda e: e.base)
    numbers = [a for a in sympy.preorder_traversal(written) if a.is_Number and abs(a) != 1]
    return len(numbers) >= _TO_AN_ODD_ONE * sum(a.is_Float for a in numbers)


def _factors(names: Sequence[str], angles: Sequence[str], degree: int) -> list[sympy.Expr]:
    """Give what may stand below the line beside 1."""
    waves = [f(sympy.Symbol(name)) for name in angles for f in (sympy.sin, sympy.cos)]
    pairs = combinations_with_replacement(waves, 2)
    # cos^2 is 1 - sin^2.
    squares = [a * b for a, b in pairs if not (a == b and a.func is sympy.cos)]
    return [*products(names, degree), *waves, *squares]
