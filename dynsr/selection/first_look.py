"""First look: the sum or ratio of a few terms that clean slopes follow down to their own error.

Most laws are such a sum or ratio, and exact slopes show it at once. What is found is final where
it cannot be chance: it leaves nothing but the error of the slopes, and either no other choice of
terms comes near, or all of its constants are simple numbers to many more digits than they have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import compile_columns, evaluate
from dynsr.fit import (
    FINEST_SLOPES,
    Candidate,
    constant_bits,
    eliminate,
    fit_ratio,
    score_candidate,
    simplest_form,
    slope_size,
    structure_bits,
)
from dynsr.methods import Limits
from dynsr.selection.subsets import best_subsets
from dynsr.selection.terms import (
    Joint,
    Terms,
    TermSettings,
    find_angles,
    products,
)

SOURCE = "the first look"
# Of more columns none is surely left out by chance; steps that are looked at; rounds of a fit.
_MOST_ELIMINATED, _LAST, _ROUNDS = 100, 4, 3
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


LOOK = LookSettings()


@dataclass(frozen=True)
class Look:
    """What the first look found: formulas, the likeliest first, and whether that one is final."""

    candidates: tuple[Candidate, ...] = ()
    final: bool = False


def look(samples: Samples, limits: Limits | None = None, settings: LookSettings = LOOK) -> Look:
    """Look for the equation among sums and ratios of a few terms.

    Parameters
    ----------
    samples : of the state whose equation is sought.
    limits : what the user allows.
    settings : the numbers that decide.

    >>> x = np.linspace(0.2, 3.0, 200)
    >>> s = Samples(x[:, None], 2 * x / (x + 0.5), ("x",), "x", "given", x)
    >>> seen = look(s)
    >>> str(seen.candidates[0].expr), seen.final
    ('2*x/(x + 1/2)', True)
    """
    if len(samples) < 2 * settings.most or not np.all(np.isfinite(samples.y)):
        return Look()
    with np.errstate(all="ignore"):
        allowed = limits or Limits()
        search = _Search.of(samples, allowed, settings)
        seen = search.conclude([one for kind in search.kinds() for one in search.choose(kind)])
        for angle in find_angles(samples.names, samples.X.T):
            if not seen.final:
                swings = _Search.around(angle, samples, allowed, settings)
                again = swings.conclude(list(swings.choose(np.arange(len(swings.exprs)))))
                seen = again if again.final else seen
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
    exprs: tuple[sympy.Expr, ...]
    above: int
    values: np.ndarray
    costs: np.ndarray
    error: float
    size: float
    fitted: dict[frozenset[int], _Choice | None] = field(default_factory=dict)

    @classmethod
    def of(cls, samples: Samples, limits: Limits, settings: LookSettings) -> _Search:
        names = samples.names
        angles = find_angles(names, samples.X.T)
        terms = Terms.grow(names, samples.X.T, settings.terms, angles, limits.terms)
        under = _factors(names, angles, settings.below)
        return cls._make(terms.exprs, terms.bits, under, samples, limits, settings)

    @classmethod
    def around(
        cls, angle: str, samples: Samples, limits: Limits, settings: LookSettings
    ) -> _Search:
        """Take what hangs from a joint: products with the sine and cosine of one angle."""
        joint = Joint.of(angle, samples.names, settings.below)
        bits = np.array([structure_bits(0.5 * e) for e in joint.above])
        sine, cosine = sympy.sin(sympy.Symbol(angle)), sympy.cos(sympy.Symbol(angle))
        under = [cosine, sine * cosine, sine**2]
        return cls._make(joint.above, bits, under, samples, limits, settings)

    @classmethod
    def _make(
        cls,
        above: Sequence[sympy.Expr],
        bits: np.ndarray,
        below: Sequence[sympy.Expr],
        samples: Samples,
        limits: Limits,
        settings: LookSettings,
    ) -> _Search:
        allowed = [i for i, e in enumerate(above) if limits.allow(e)]
        over = [above[i] for i in allowed]
        under = [e for e in below if limits.allow(1 / (1 + e))]
        values = compile_columns([*over, *under], samples.names)(*samples.X.T)
        values[len(over) :] *= -samples.y
        size = slope_size(samples)
        line = structure_bits(1 / (1 + sympy.Symbol("x"))) - structure_bits(sympy.Symbol("x"))
        costs = [*bits[allowed], *(structure_bits(0.5 * e) + line for e in under)]
        return cls(
            samples,
            settings,
            (*over, *under),
            len(over),
            values,
            np.array(costs) + constant_bits(len(samples)),
            max(float(samples.noise or 0.0), FINEST_SLOPES * size),
            size,
        )

    def kinds(self) -> Iterator[np.ndarray]:
        """Give the places of polynomials, of all terms, and of ratios of growing degree."""
        symbols = [sympy.Symbol(name) for name in self.samples.names]
        degree = np.array(
            [sympy.total_degree(e) if e.is_polynomial(*symbols) else np.inf for e in self.exprs],
            dtype=float,
        )
        over = np.arange(len(self.exprs)) < self.above
        yield np.flatnonzero(over & np.isfinite(degree))
        yield np.flatnonzero(over)
        for top, bottom in ((2, 1), (3, 1), (3, 2)):
            yield np.flatnonzero(degree <= np.where(over, top, bottom))
        yield np.arange(len(self.exprs))

    def choose(self, kind: np.ndarray) -> Iterator[_Choice]:
        """Give the choices of terms that a beam and a backward elimination end at."""
        values = self.values[kind]
        kind = kind[np.all(np.isfinite(values), axis=1) & np.any(values != 0, axis=1)]
        if not len(kind):
            return
        columns, y = self.values[kind], self.samples.y
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
        chosen += self._eliminate(columns)
        for places in dict.fromkeys(chosen):
            one = self._fit([int(kind[i]) for i in places])
            if one is not None:
                yield one

    def _eliminate(self, columns: np.ndarray) -> list[tuple[int, ...]]:
        """Take the terms out that are not missed, from all of them; none where all miss."""
        y = self.samples.y
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
        fit = fit_ratio(self.values[over], signed, y, rounds=_ROUNDS)
        misses, wild = np.abs(fit.residual), 1 - self.settings.wild
        if np.max(misses) > _FAR * np.median(misses):
            # Rows where differences fail would pull what all others say exactly.
            kept = (misses <= np.quantile(misses, wild)).astype(float)
            again = fit_ratio(self.values[over], signed, y, weights=kept, rounds=_ROUNDS)
            if np.median(np.abs(again.residual)) < np.median(misses):
                fit, misses = again, np.abs(again.residual)
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

    def _stands_out(self, best: _Choice, found: Sequence[_Choice]) -> bool:
        """Whether every other function of the states misses far more.

        Where a short arc is followed by any few terms, it is by many choices of them.
        """
        bound = self.settings.stands_out * max(best.miss, self.error / self.size)
        near = [c for c in found if not c.places >= best.places and c.miss <= bound]
        return len(best.places) <= self.settings.most and all(self._same(best, c) for c in near)

    def _same(self, one: _Choice, other: _Choice) -> bool:
        """Whether two are one function, beside the trajectory too."""
        shifts = enumerate(self.samples.names)
        beside = {
            name: 1.1 * np.roll(self.samples.X[:, i], i * len(self.samples) // 5)
            for i, name in shifts
        }
        a, b = evaluate(one.expr, beside), evaluate(other.expr, beside)
        finite = np.isfinite(a) & np.isfinite(b)
        gap, size = np.abs(a - b)[finite], np.abs(a)[finite]
        return bool(finite.any() and np.median(gap) <= 1e-4 * np.median(size))

    def conclude(self, choices: Sequence[_Choice]) -> Look:
        """Take the shortest that leaves nothing, and say whether it can be chance."""
        if not choices:
            return Look()
        found = list(dict.fromkeys(choices))
        settings, error = self.settings, self.error / self.size
        sure = error <= settings.exact
        good = [c for c in found if sure and max(c.miss, 0.1 * c.wild) <= settings.within * error]
        # What rough slopes miss is the same for all that is near the law.
        bound = settings.alike * min(c.miss for c in found)
        near = good or [c for c in found if c.miss <= bound]
        ranked = sorted(near, key=lambda c: (c.cost, c.order))
        ranked += sorted(set(found) - set(near), key=lambda c: (c.miss, c.order))
        best = ranked[0]
        exprs: list[sympy.Expr] = []
        final = False
        if good:
            simple = simplest_form(best.expr, self.samples.columns)
            misses = np.abs(self.samples.y - evaluate(simple, self.samples.columns))
            if np.median(misses) <= settings.within * self.error:
                exprs.append(simple)
            final = self._stands_out(best, found) or bool(exprs and not simple.has(sympy.Float))
        exprs += [c.expr for c in ranked[: settings.kept]]
        named = dict.fromkeys(exprs)
        return Look(tuple(score_candidate(e, self.samples, SOURCE) for e in named), final)


def _factors(names: Sequence[str], angles: Sequence[str], degree: int) -> list[sympy.Expr]:
    """Give what may stand below the line beside 1."""
    waves = [f(sympy.Symbol(name)) for name in angles for f in (sympy.sin, sympy.cos)]
    pairs = combinations_with_replacement(waves, 2)
    # cos^2 is 1 - sin^2.
    squares = [a * b for a, b in pairs if not (a == b and a.func is sympy.cos)]
    return [*products(names, degree), *waves, *squares]
