"""One discovery: its data, what is given of them, and the steps from searches to equations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import islice
from typing import Any, TypeVar

import numpy as np
import sympy

from dynsr.arguments import checked, renamed
from dynsr.data import (
    FEWEST_SMOOTH,
    Samples,
    SlopeSettings,
    Trajectory,
    WindowSettings,
    columns_of,
    split_held_back,
)
from dynsr.discovery.asking import (
    Shares,
)
from dynsr.discovery.orders import Form, explain_velocity
from dynsr.discovery.result import Discovery
from dynsr.discovery.tasks import (
    Found,
)
from dynsr.expression import compile_numpy, evaluate, has_pole, ratio_forms, skeleton
from dynsr.fit import (
    Candidate,
    FitSettings,
    Loss,
    Match,
    Measurements,
    Noise,
    ParetoFront,
    ProfileSettings,
    approach,
    bits_of_misses,
    confirm,
    description_length,
    fit_along,
    is_nearly_confirmed,
    is_noisy,
    leaves_nothing,
    loosen_all,
    match_trajectories,
    noise_of,
    polish,
    refit,
    same_form,
    score_candidate,
    slope_size,
    tidy,
    with_floats,
    without_flat_line,
    without_rounding,
)
from dynsr.jobs import (
    Budget,
    finish_by,
)
from dynsr.library import structure_in
from dynsr.methods import (
    Demands,
)
from dynsr.parameters import FREE, DelaySettings, FreeSettings, VarySettings
from dynsr.selection import (
    HIDDEN,
    STOCHASTIC_SEARCH,
    ApproximationSettings,
    Compared,
    HiddenSettings,
    Pick,
    RankedCandidate,
    SelectionSettings,
    StochasticSearchSettings,
    SystemChoice,
    SystemComparison,
    best_so_far,
    compare_systems,
    conserve,
    families,
    follow_anything,
    lead_with,
    may_be_exact,
    noise_shown,
)
from dynsr.verdict import (
    LAW,
    Verdict,
    VerdictSettings,
    give_map_verdict,
    give_verdict,
    hold_to_slopes,
    keep_within,
    likely_cause,
    match_steps,
    untested,
)

T = TypeVar("T")
OtherFormulas = Mapping[str, Sequence[tuple[sympy.Expr, float]]]
# Misses in units of the noise below which there may be none.
_FAR_BELOW_NOISE = 0.2
# Times the loss of the most probable formula up to which others may be as good on slopes.
_AS_NEAR = 10.0
# What found a form that no search has on its list.
COMPARED = "comparing whole systems with the states"
# How often noise is believed to be as little as a system leaves.
_BELIEVED = 3


@renamed(followers="approximations")
@checked
@dataclass(frozen=True)
class DiscoverySettings:
    """The numbers that decide in a discovery outside its methods; its record has them.

    Parameters
    ----------
    rows : samples of a state at most; of more rows, evenly spaced ones are taken.
    slopes : how the data choose the scheme of their slopes.
    selection : how one equation per state is chosen, constants are fitted and systems compared.
    shares : how the steps share a time budget, where there is one.
    verdict : when equations are a law, an approximation, or not found.
    approximations : how sums of terms are chosen for their integration where no law is found.
    profile : where intervals of constants in noise come from profile likelihoods, and how.
    vary : which constants differ from run to run, where that is asked.
    delays : which delay it is, where delays are asked.
    windows : which rows of long records are searched.
    hidden : how a state that was not measured is looked for, where one is asked.
    free : how free functions in known equations are found.
    stochastic : how drift and diffusion are found, where noise in the motion is asked for.

    >>> DiscoverySettings(rows=2000).selection.compared
    5
    """

    rows: int = 4000
    slopes: SlopeSettings = SlopeSettings()
    selection: SelectionSettings = SelectionSettings()
    shares: Shares = Shares()
    verdict: VerdictSettings = VerdictSettings()
    approximations: ApproximationSettings = ApproximationSettings()
    profile: ProfileSettings = ProfileSettings()
    vary: VarySettings = VarySettings()
    delays: DelaySettings = DelaySettings()
    windows: WindowSettings = WindowSettings()
    hidden: HiddenSettings = HIDDEN
    free: FreeSettings = FREE
    stochastic: StochasticSearchSettings = STOCHASTIC_SEARCH

    def without_snapping(self) -> DiscoverySettings:
        """Give the same settings for constants that stay as fitted."""
        fit = replace(self.selection.fit, snap=False)
        return replace(self, selection=replace(self.selection, fit=fit))


DISCOVERY: DiscoverySettings = DiscoverySettings()


@dataclass(frozen=True, eq=False)
class Problem:
    """The data of one discovery and what is given of their equations.

    Parameters
    ----------
    runs : the trajectories, with the velocities that their order asks for.
    inputs : input name -> expression in ``t`` where it is known.
    scheme : how slopes are made.
    slopes : state -> the user's own.
    known : state -> the given part of its equation.
    form : order, time and kind of the equations.
    settings : the numbers that decide.
    demands : what the user asks of the equations.
    budget : the seconds that all may take.
    cut : names of the steps that the budget ended.
    confirmed : the fit of the equations that exact states leave no doubt of, once there is one.
    believed : the states with their noise as a system that follows them shows it, once one does.
    """

    runs: Sequence[Trajectory]
    inputs: Mapping[str, sympy.Expr]
    scheme: str
    slopes: Mapping[str, Any]
    known: Mapping[str, sympy.Expr]
    form: Form
    settings: DiscoverySettings
    demands: Demands
    budget: Budget
    cut: list[str] = field(default_factory=list)
    confirmed: list[Match] = field(default_factory=list)
    believed: list[Measurements] = field(default_factory=list)

    def until(self, share: str) -> float:
        """Give the time by which a step is to have ended, on the monotonic clock; inf for never.

        Parameters
        ----------
        share : the name of its share of the budget.
        """
        return self.budget.until(getattr(self.settings.shares, share))

    def counting(self, loss: Loss | None) -> Problem:
        """Give the same problem, in which the choice of a formula counts misses by a loss."""
        if loss is None:
            return self
        selection = replace(self.settings.selection, loss=loss)
        return replace(self, settings=replace(self.settings, selection=selection))

    def samples(
        self,
        state: str,
        runs: Sequence[Trajectory],
        known_left_out: bool = True,
        plain: bool = False,
    ) -> Samples:
        """Make the samples of a state, without the known part, thinned when there are many.

        ``plain`` ones are differences, where the data are noisy too.
        """
        if self.measurements is not None and not plain and state not in self.form.known.values():
            return self.form.with_time(self.measurements.samples(state))
        own = self.slopes.get(state)
        if own is not None and runs is not self.runs:
            # Own slopes fit the whole trajectories; the searches see all of them.
            runs = self.runs
        settings = self.settings.slopes
        if plain and self._noisy_measurements is not None:
            settings = replace(settings, clean=np.inf)
        found = self.form.samples(
            list(runs), state, scheme=self.scheme, slopes=own, settings=settings
        )
        rows = self.settings.rows
        if len(found) > rows:
            found = found.select(np.linspace(0, len(found) - 1, rows).astype(int))
        if state not in self.known or not known_left_out:
            return found
        given = compile_numpy([self.known[state]], [*found.names, "t"])
        values = given(np.concatenate([found.X.T, found.t[None]]))[0]
        return replace(found, y=found.y - values)

    def samples_in_time(self, state: str) -> Samples:
        """Make the samples of a state as they are searched, or in no time where there is none."""
        return finish_by(
            self.until("verdict"),
            lambda: self.samples(state, self.runs),
            lambda: self.samples_soon(state),
        )[0]

    def samples_soon(self, state: str) -> Samples:
        """Make the samples of a state in no time, by differences."""
        if self.form.discrete:
            return self.form.samples(list(self.runs), state)
        scheme = "central2" if min(map(len, self.runs)) >= FEWEST_SMOOTH else "forward"
        found = self.form.samples(list(self.runs), state, scheme=scheme)
        given = self.known.get(state, sympy.S.Zero)
        if len(found) > self.settings.rows:
            rows = np.linspace(0, len(found) - 1, self.settings.rows).astype(int)
            found = found.select(rows)
        return replace(found, y=found.y - evaluate(given, {**found.columns, "t": found.t}))

    def fit(
        self,
        picks: Mapping[str, Pick],
        pools: Mapping[str, list[Candidate]],
        notes: Mapping[str, str],
        settled: SystemChoice | None = None,
    ) -> tuple[Discovery, OtherFormulas | None]:
        """Compare whole systems, fit the constants of the best to all data, and explain it.

        Gives the discovery, and the formulas that came closest where systems were compared.
        """
        picked = {s: self.known.get(s, sympy.S.Zero) + self._allowed(p) for s, p in picks.items()}
        if self.form.discrete:
            return self._fit_map(picked, picks, pools, notes), None
        given = self.form.known
        picked = {
            s: given[s] if s in given else picked[s] for s in self.form.complete(tuple(picks))
        }
        choice, cut = finish_by(
            self.until("comparison"),
            lambda: settled or self.compare(picked, self._likely(picks, pools)),
            lambda: settled or best_so_far(picked, self._compared),
        )
        self.cut.extend(["comparison"] if cut else [])
        # Where other terms or the states turn a sign, the chosen terms that keep it stand.
        system = {
            s: e if self.demands.keeps(s, e, self.columns) else picked[s]
            for s, e in choice.exprs.items()
        } | given
        noise = {s: picks[self.form.velocities.get(s, s)].noise for s in system}
        fitted = self._polish(system, noise)
        mended = {s: self.demands.drop_broken(s, e) for s, e in fitted.exprs.items()}
        if mended != fitted.exprs:
            system = mended
            fitted = self._polish(system, noise)
        fitted = self._with_forced(fitted, picks)
        exact = self._confirm_fitted(fitted)
        if exact is not None:
            fitted, choice = self._polish(exact, noise), SystemChoice(picked)
        alternatives = None
        if choice.fit is not None:
            near = choice.different(self.settings.selection.comparison.apart)
            # The last fit may loosen what the comparison had as a simple number.
            alternatives = {
                s: [pair for pair in own if not _of_one_form(pair[0], fitted.exprs[s])]
                for s, own in near.items()
            }
        returned = {s: self._as_returned(p, fitted.exprs[s], pools[s]) for s, p in picks.items()}
        found = Discovery(
            equations=fitted.exprs,
            errors=fitted.errors,
            fitted=fitted.fitted,
            reach=fitted.reach,
            front={s: self._front(pools[s], p) for s, p in picks.items()},
            explanation={s: found_by(p.candidate.source) + notes[s] for s, p in returned.items()},
            details={
                s: p.explanation + _why(p, picks[s], choice.fit is not None)
                for s, p in returned.items()
            },
        )
        return with_velocities(found, self.form), alternatives

    def _as_returned(self, pick: Pick, expr: sympy.Expr, pool: Sequence[Candidate]) -> Pick:
        """Put the formula that is returned first, with the bits it takes and what found its form.

        Whole systems and the last fit may come to another form than slopes preferred.
        """
        own = expr - self.known.get(pick.state, sympy.S.Zero)
        if same_form(pick.candidate.expr, own):
            return pick
        source = next((c.source for c in pool if same_form(c.expr, own)), "")
        samples = self.samples_in_time(pick.state)
        return lead_with(pick, score_candidate(own, samples, source or COMPARED), samples)

    def with_equation(self, found: Discovery, state: str, expr: sympy.Expr) -> Discovery | None:
        """Put another equation of a state in the place of the one found, and fit all constants.

        None where that does not keep to what the user asks, or to data that are exact.

        Parameters
        ----------
        found : the equations.
        state, expr : whose equation is another one, and what it is.
        """
        system = {**found.equations, state: expr}
        if state in self.form.known or not self.is_allowed(state, expr):
            return None
        samples = {s: self.samples(s, self.runs, known_left_out=False) for s in system}
        noise = {
            s: noise_of([*found.front.get(s, ()), score_candidate(e, samples[s])], samples[s])
            for s, e in system.items()
        }
        if self.form.discrete:
            match = match_steps({s: tidy(e) for s, e in system.items()}, samples, found.reach)
        elif self.confirmed:
            exact = self._confirm(system)
            if exact is None:
                return None
            fit = self.settings.selection.fit
            match = polish(system, self.runs, self.inputs, samples, noise, fit, None, exact)
        else:
            match = self._polish(system, noise)
        if not self.is_allowed(state, match.exprs[state]):
            return None
        return self._as_answer(found, match, state, noise[state])

    def _as_answer(self, found: Discovery, match: Match, state: str, noise: Noise) -> Discovery:
        """Give a discovery with fitted equations, of which that of one state is another one."""
        given = self.known.get(state, sympy.S.Zero)
        samples = self.samples(state, self.runs)
        new, old = (match.exprs[state] - given, found.equations[state] - given)
        source = next((c.source for c in found.front.get(state, ()) if same_form(c.expr, new)), "")
        both = [score_candidate(e, samples, source or COMPARED) for e in (new, old)]
        ranked = [RankedCandidate(c, description_length(c, samples, noise), None) for c in both]
        details = Pick(state, tuple(ranked), noise).explanation
        _, _, notes = found.explanation.get(state, "").partition("Found by ")[2].partition(".")
        front = found.front.get(state, ParetoFront([])).add(both[0])
        return replace(
            found,
            equations=match.exprs,
            errors=match.errors,
            fitted=match.fitted,
            reach=match.reach,
            front={**found.front, state: front},
            explanation={**found.explanation, state: found_by(both[0].source) + notes},
            details={**found.details, state: self._named(state, details)},
        )

    def _named(self, state: str, details: str) -> str:
        """Write the details of a map with its own left side, x[n+1]."""
        return details.replace(f"{state}' =", f"{state}[n+1] =") if self.form.discrete else details

    def _confirm_fitted(self, fitted: Match) -> Mapping[str, sympy.Expr] | None:
        """Give equations that exact states confirm, which had looked noisy.

        With few rows per oscillation, neighbours differ as if there were noise. Equations that
        follow the rows far closer than this show that there is no noise.
        """
        data = self.measurements or self._gapped
        if self.confirmed or data is None or not len(fitted.misses):
            return None
        close = float(np.sqrt(np.mean(fitted.misses**2))) < _FAR_BELOW_NOISE
        if not close and data.parts == 1 and not data.may_be_exact:
            return None
        return self._confirmed(loosen_all(fitted.exprs))

    def _allowed(self, pick: Pick) -> sympy.Expr:
        """Give the best formula that keeps to the demands; the choice varies those of the pool."""
        formulas = (r.candidate.expr for r in pick.ranked)
        best = next(filter(self.demands.allows, formulas), pick.candidate.expr)
        forced = self.demands.force(pick.state, best, self.known.get(pick.state, sympy.S.Zero))
        return best if forced == best else refit(forced, self.samples(pick.state, self.runs))

    def _fit_map(
        self,
        exprs: Mapping[str, sympy.Expr],
        picks: Mapping[str, Pick],
        pools: Mapping[str, list[Candidate]],
        notes: Mapping[str, str],
    ) -> Discovery:
        """Take the maps as they were picked, with the errors of their constants on one step."""
        pairs = {s: self.samples(s, self.runs, known_left_out=False) for s in picks}
        final = {s: keep_within(tidy(e), pairs[s]) for s, e in exprs.items()}
        match = match_steps(final, pairs)
        return Discovery(
            equations=final,
            errors=match.errors,
            fitted=match.fitted,
            front={s: self._front(pools[s], p) for s, p in picks.items()},
            explanation={s: found_by(p.candidate.source) + notes[s] for s, p in picks.items()},
            details={s: self._named(s, p.explanation) for s, p in picks.items()},
        )

    def _polish(self, system: Mapping[str, sympy.Expr], noise: Mapping[str, Noise]) -> Match:
        samples = {s: self.samples(s, self.runs, known_left_out=False) for s in system}
        whole = self.settings.selection.fit
        shortly = replace(whole, snap_rounds=0, match_trials=2)
        as_chosen = {s: tidy(e) for s, e in system.items()}

        def hurry() -> Match:
            return finish_by(
                self.until("equations"),
                lambda: self._fit_constants(system, samples, noise, shortly),
                lambda: Match.untouched(as_chosen),
            )[0]

        fitted, cut = finish_by(
            self.until("polishing"),
            lambda: self._fit_constants(system, samples, noise, whole),
            hurry,
        )
        self.cut.extend(["polishing"] if cut else [])
        return fitted

    def _fit_constants(
        self,
        system: Mapping[str, sympy.Expr],
        samples: Mapping[str, Samples],
        noise: Mapping[str, Noise],
        settings: FitSettings,
    ) -> Match:
        data, exact = self.measurements or self._gapped, next(iter(self.confirmed), None)
        if exact is not None and exact.exprs.keys() == system.keys():
            return polish(
                exact.exprs, self.runs, self.inputs, samples, noise, settings, None, exact
            )
        return polish(system, self.runs, self.inputs, samples, noise, settings, data)

    def _with_forced(self, fitted: Match, picks: Mapping[str, Pick]) -> Match:
        """Put forced terms that snapping took for nothing back, with coefficients as fitted."""
        whole = {s: self.demands.force(s, e) for s, e in fitted.exprs.items()}
        if whole == fitted.exprs:
            return fitted
        samples = {s: self.samples(s, self.runs, known_left_out=False) for s in whole}
        begun = {s: refit(e, samples[s]) if e != fitted.exprs[s] else e for s, e in whole.items()}
        settings = self.settings.selection.fit
        match = match_trajectories(begun, self.runs, inputs=self.inputs, settings=settings)
        noise = {s: picks[self.form.velocities.get(s, s)].noise for s in whole}
        return polish(match.exprs, self.runs, self.inputs, samples, noise, settings, None, match)

    def _front(self, pool: Sequence[Candidate], pick: Pick) -> ParetoFront:
        """Merge what the methods found with what fitting and snapping made of it."""
        last = [replace(r.candidate, expr=tidy(r.candidate.expr)) for r in pick.ranked]
        given = self.known.get(pick.state, sympy.S.Zero)
        kept = (c for c in last if self.demands.allows(c.expr))
        whole = (c for c in kept if not self.demands.lacking(pick.state, given + c.expr))
        samples = self.samples_in_time(pick.state)
        return ParetoFront([*pool, *(without_rounding(c, samples) for c in whole)])

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Name -> (n,) values of all columns of the data, and the times."""
        return columns_of(self.runs)

    def without_poles(self, pools: Mapping[str, list[Candidate]]) -> dict[str, list[Candidate]]:
        """Leave out what divides by 0 along the runs, where that leaves anything.

        Parameters
        ----------
        pools : state -> formulas.
        """
        if self.form.discrete:
            return dict(pools)
        runs = [run.by_name for run in self.runs]

        def is_fine(candidate: Candidate) -> bool:
            return not any(has_pole(candidate.expr, run) for run in runs)

        return {state: list(filter(is_fine, pool)) or pool for state, pool in pools.items()}

    def _likely(
        self, picks: Mapping[str, Pick], pools: Mapping[str, Sequence[Candidate]]
    ) -> dict[str, list[sympy.Expr]]:
        """Give the other formulas of each state, those of least description length first."""
        likely = {}
        for state, pick in picks.items():
            samples = self.samples(state, self.runs)
            ranked = sorted(pools[state], key=lambda c: description_length(c, samples, pick.noise))
            others = [r.candidate for r in pick.ranked[1:]]
            likely[state] = [c.expr for c in [*others, *ranked]]
        return likely

    @property
    def measurements(self) -> Measurements | None:
        """The states with their noise and smoothed curves; None where slopes are good enough."""
        if self.confirmed:
            return None
        return self.believed[-1] if self.believed else self._noisy_measurements

    @cached_property
    def _noisy_measurements(self) -> Measurements | None:
        if self.form.discrete or self.known or self.slopes or self.scheme != "auto":
            return None
        if min(map(len, self.runs)) < FEWEST_SMOOTH or not is_noisy(self.runs):
            return None
        comparison = self.settings.selection.comparison
        data = Measurements.of(self.runs, self.inputs, comparison.rows, self.form.known)
        return data if comparison.ask(data) else None

    @property
    def _gaps(self) -> bool:
        """Whether a state was not measured at every row."""
        return any(run.unmeasured.size for run in self.runs)

    @cached_property
    def _gapped(self) -> Measurements | None:
        """The states with their noise and smoothed curves, where one has gaps; else None."""
        if not self._gaps or self.form.discrete:
            return None
        rows = self.settings.selection.comparison.rows
        return Measurements.of(self.runs, self.inputs, rows, self.form.known)

    def split(self) -> tuple[Sequence[Trajectory], Sequence[Trajectory]]:
        """Give the trajectories to search in, and those held back to choose by forecasts."""
        if self.form.discrete or self.measurements is not None or self._gaps:
            return self.runs, []
        return split_held_back(self.runs)

    def noise(self) -> list[np.ndarray] | None:
        """(n, k) standard deviations of the noise of each run; None where it is not known."""
        if self.confirmed:
            return [np.where(run.measured, 0.0, np.inf) for run in self.runs]
        data = self.measurements
        if data is None or any(
            len(a) != len(b) for a, b in zip(data.runs, self.runs, strict=False)
        ):
            return None
        return [smoothed.noise for smoothed in data.smoothed]

    def confirm(self, looked: Sequence[Found]) -> Mapping[str, sympy.Expr]:
        """Fit the most probable formulas to the states; gives those that these leave no doubt of.

        From then on the data count as exact.
        """
        confirms = self.settings.selection.parts.has("end-confirmed")
        if not confirms or not all(found.candidates for found in looked):
            return {}
        near = {f.target: _as_near(f.candidates)[: 1 if f.final else None] for f in looked}
        systems = families(near, self.form.complete(tuple(near)))
        tried = (self._tried(self._beside_known(exprs)) for exprs in systems)
        every = list(islice((match for match in tried if match is not None), 1))
        if not any(leaves_nothing(m) or _is_written_simply(m.exprs) for m in every):
            # What follows a law closely may be confirmed too; the law itself misses far less.
            others = (self._tried(own) for own in self._nearly(near))
            every += [match for match in others if match is not None]
        if every:
            structure = structure_in(self.columns)
            best = min(every, key=lambda match: bits_of_misses(match) + structure(match.exprs))
            self.confirmed.append(best)
            return {s: best.exprs[s] - self.known.get(s, sympy.S.Zero) for s in near}
        found = self._confirm_polynomials({s: pool[0] for s, pool in near.items()})
        return {s: found[s] for s in near} if found else {}

    def _nearly(self, near: Mapping[str, Sequence[sympy.Expr]]) -> Iterator[dict[str, sympy.Expr]]:
        """Exchange one equation for others as near to the slopes, where the states nearly agree.

        Rough slopes do not distinguish these.
        """
        first = {s: exprs[0] for s, exprs in near.items()}
        whole, fit = self._beside_known(first), self.settings.selection.fit
        if not self._in_time(lambda: is_nearly_confirmed(whole, self.runs, self.inputs, fit)):
            return
        for state, (_, *others) in near.items():
            yield from (self._beside_known({**first, state: other}) for other in others)

    def _beside_known(self, exprs: Mapping[str, sympy.Expr]) -> dict[str, sympy.Expr]:
        """Add what the user knows of each equation, and equations that nobody searches."""
        return self._with_known({s: self.known.get(s, sympy.S.Zero) + e for s, e in exprs.items()})

    def _confirm_polynomials(
        self, exprs: Mapping[str, sympy.Expr]
    ) -> Mapping[str, sympy.Expr] | None:
        """Give the sums of products that exact states between distant rows leave no doubt of."""
        data, comparison = self.measurements, self.settings.selection.comparison
        if data is None or data.parts == 1:
            return None
        if not comparison.parts.has("whole-polynomials"):
            return None
        whole, fit = self._with_known(exprs), self.settings.selection.fit

        def confirmed() -> Mapping[str, sympy.Expr] | None:
            for begun in follow_anything(whole, data, comparison):
                left = approach(begun.exprs, self.runs, self.inputs, fit)
                found = None if left is None else self._confirmed(left)
                if found is not None:
                    return found
            return None

        return self._in_time(confirmed)

    def _with_known(self, exprs: Mapping[str, sympy.Expr]) -> dict[str, sympy.Expr]:
        """Add equations such as q' = v, which nobody searches, to the others."""
        whole = {**exprs, **self.form.known}
        return {state: whole[state] for state in self.form.complete(tuple(exprs))}

    def _in_time(self, look: Callable[[], T | None]) -> T | None:
        """Give what a look finds in the time that searches have; None where it finds no end."""
        until = self.until("searches")
        found, cut = finish_by(until, look, lambda: None)
        self.cut.extend(["first look"] if cut else [])
        return found

    def _confirm(self, whole: Mapping[str, sympy.Expr]) -> Match | None:
        fit = self.settings.selection.fit
        return confirm(whole, self.runs, self.inputs, fit, structure_in(self.columns))

    def _tried(self, whole: Mapping[str, sympy.Expr]) -> Match | None:
        """Give a system that the states leave no doubt of, if the user allows it."""
        found = self._in_time(lambda: self._confirm(whole))
        allowed = found and all(self.is_allowed(s, e) for s, e in found.exprs.items())
        return found if allowed else None

    def _confirmed(self, whole: Mapping[str, sympy.Expr]) -> Mapping[str, sympy.Expr] | None:
        found = self._tried(whole)
        if found is None:
            return None
        self.confirmed.append(found)
        return found.exprs

    def conserve(self, exprs: Mapping[str, sympy.Expr]) -> Mapping[str, sympy.Expr]:
        """Write exact equations so that what rests along the runs rests from other starts too.

        Parameters
        ----------
        exprs : state -> equation, of all states.
        """
        if self.demands.asked or self.known or self.form.known:
            return exprs
        written = conserve(exprs, self.runs)
        if written == exprs or not self.confirmed:
            return written
        before = list(self.confirmed)
        self.confirmed.clear()
        again = self._confirmed(written)
        if again is None:
            self.confirmed.extend(before)
        return exprs if again is None else again

    def is_allowed(self, state: str, expr: sympy.Expr) -> bool:
        """Whether an equation keeps to all that the user asks."""
        return self.demands.keeps(state, expr, self.columns)

    def give_verdict_in_time(self, found: Discovery, alternatives: OtherFormulas | None) -> Verdict:
        """Say how sure the equations are, or that the time did not suffice to say it."""
        verdict, cut = finish_by(
            self.until("verdict"),
            lambda: self.give_verdict(found, alternatives),
            lambda: untested(found.equations),
        )
        self.cut.extend(["verdict"] if cut else [])
        return verdict

    def with_verdict(self, found: Discovery, alternatives: OtherFormulas | None) -> Discovery:
        """Give a discovery that says how sure its equations are."""
        return replace(found, verdict=self.give_verdict(found, alternatives))

    def give_verdict(self, found: Discovery, alternatives: OtherFormulas | None) -> Verdict:
        """Say how sure the equations are."""
        if self.form.discrete:
            front = {s: own for s, own in found.front.items() if s not in self.known}
            return give_map_verdict(found.equations, self.runs, front, self.settings.verdict)
        made = tuple(self.form.velocities.values()) if self.measurements is not None else ()
        verdict = give_verdict(
            found.equations,
            [run.without_measurements(made) for run in self.runs],
            self.inputs,
            noise=self.noise(),
            causes={s: likely_cause(self.runs, s) for s in made if s in found.equations},
            front={s: own for s, own in found.front.items() if s not in self.known},
            alternatives=alternatives,
            settings=self.settings.verdict,
            curves=self._curves(found.equations),
        )
        laws = {s: e for s, e in found.equations.items() if verdict.states[s].level == LAW}
        missed = self._missed_slopes(laws)
        return hold_to_slopes(verdict, missed, self.settings.verdict)

    def _curves(self, equations: Mapping[str, sympy.Expr]) -> list[np.ndarray]:
        """(n, k) states of each run that follow both noisy data and equations; or nothing.

        A chaotic flow that starts at a noisy row may end far from where the data go.
        """
        data = self.measurements
        if data is None or len(data.runs) != len(self.runs):
            return []
        fit = fit_along(equations, data)
        if fit is None:
            return []
        names = tuple(equations)
        along = data.along(fit.found.states, names).smoothed
        own = [self.runs[0].index(name) for name in names]
        return [
            np.column_stack([np.interp(run.t, one.t, one.x[:, place]) for place in own])
            for run, one in zip(self.runs, along, strict=True)
        ]

    def _missed_slopes(self, equations: Mapping[str, sympy.Expr]) -> dict[str, tuple[float, float]]:
        """State -> median miss of its slopes and their error, as shares of their size."""
        found: dict[str, tuple[float, float]] = {}
        # Slopes of what stands on a curve are none of the data.
        if self.measurements is not None or self.slopes or self._gaps:
            return found
        for state, expr in equations.items():
            own = self.samples(state, self.runs, known_left_out=False)
            if {str(symbol) for symbol in expr.free_symbols} <= set(own.names):
                with np.errstate(all="ignore"):
                    missed = float(np.median(np.abs(own.y - evaluate(expr, own.columns))))
                size = max(slope_size(own), 1e-300)
                found[state] = missed / size, float(own.noise or 0.0) / size
        return found

    def settle(self, explored: Sequence[Found]) -> SystemChoice | None:
        """Give the best system of these alone where other methods could not do better; else None.

        They go by slopes, which noise makes unsure. Of data that may be exact, such as those of a
        loose solver, they see more where the system leaves more than noise.
        """
        data = self.measurements
        assert data is not None
        pools = {f.target: [c.expr for c in f.candidates] for f in explored}
        if not all(pools.values()):
            return None
        exprs = self._with_known({state: pool[0] for state, pool in pools.items()})
        for found in explored:
            told = zip(pools[found.target], found.bits, strict=bool(found.bits))
            self._compared.told[found.target] = dict(told)
        choice, cut = finish_by(
            self.until("searches"),
            lambda: self.compare(exprs, pools),
            lambda: best_so_far(exprs, self._compared),
        )
        if cut:
            self.cut.append("comparison")
            return choice if choice.fit is not None else None
        fit = choice.fit
        if fit is None:
            return None
        if not may_be_exact(fit, data):
            return choice
        if self._confirmed(loosen_all(fit.exprs)):
            return SystemChoice(self.confirmed[-1].exprs)
        return choice if choice.explains(self.settings.selection.comparison) else None

    def compare(
        self, picked: Mapping[str, sympy.Expr], pools: Mapping[str, Sequence[sympy.Expr]]
    ) -> SystemChoice:
        """Let whole systems compete on the states where noise makes slopes unsure.

        The best is believed where it shows far less noise than was thought.
        """
        comparison, data = self.settings.selection.comparison, self._noisy_measurements
        if self.confirmed or data is None:
            return SystemChoice(dict(picked))
        self.believed.clear()
        choice = compare_systems(picked, pools, data, comparison, self._compared)
        fit = choice.fit
        believed = _BELIEVED * comparison.parts.has("belief")
        while fit is not None and len(self.believed) < believed:
            less = noise_shown(fit)
            if less is None or not (self.believed or choice.explains(comparison)):
                break
            data = data.with_noise(less)
            self.believed.append(data)
            fit = SystemComparison(data.mesh(tuple(fit.exprs)), comparison).fit(fit.exprs)
        return choice

    @cached_property
    def _compared(self) -> Compared:
        """What was learnt when systems were compared before."""
        return Compared()


def pool_formulas(
    searched: Sequence[Found],
    samples: Mapping[str, Samples],
    demands: Demands,
    known: Mapping[str, sympy.Expr],
) -> dict[str, list[Candidate]]:
    """Put together what all methods found for each state and the demands leave."""
    pools: dict[str, list[Candidate]] = {state: [] for state in samples}
    for found in searched:
        own = samples[found.target]
        some = [without_rounding(c, own) for c in found.candidates]
        plain = (without_flat_line(c.expr, own.columns) for c in some)
        pools[found.target] += some
        pools[found.target] += [
            score_candidate(e, own, c.source)
            for c, e in zip(some, plain, strict=True)
            if e is not None
        ]
    return {
        state: demands.select(pool, samples[state], known.get(state, sympy.S.Zero))
        for state, pool in pools.items()
    }


def with_velocities(found: Discovery, form: Form) -> Discovery:
    """Add the equations x' = x_dot, which nobody searched, to the others, with their reason."""
    known = {s: e for s, e in form.known.items() if str(e) in found.equations}
    names = form.complete([s for s in found.equations if s not in known])
    whole = {**known, **found.equations}
    return replace(
        found,
        equations={s: whole[s] for s in names},
        errors={**dict.fromkeys(known, ()), **found.errors},
        front={**{s: ParetoFront([]) for s in known}, **found.front},
        explanation={
            **found.explanation,
            **{s: f" {explain_velocity(s, str(e))}" for s, e in known.items()},
        },
    )


def _is_written_simply(exprs: Mapping[str, sympy.Expr]) -> bool:
    """Whether all constants of exact equations are simple numbers, which no chance makes them."""
    return not any(expr.has(sympy.Float) for expr in exprs.values())


def _as_near(candidates: Sequence[Candidate]) -> list[sympy.Expr]:
    """Give the first formula and those that come as near to the slopes."""
    first, *others = candidates
    return [first.expr, *(c.expr for c in others if c.loss <= _AS_NEAR * first.loss)]


def _of_one_form(one: sympy.Expr, other: sympy.Expr) -> bool:
    """Whether formulas differ in their constants alone, however their ratios are written."""
    # Bringing a sum under one line is dear.
    if one.free_symbols != other.free_symbols:
        return False
    return not _ways_to_write(one).isdisjoint(_ways_to_write(other))


@lru_cache(maxsize=1000)
def _ways_to_write(expr: sympy.Expr) -> frozenset[sympy.Expr]:
    """Give the shapes of a formula, and where it is a ratio of the ways to write that."""
    forms = ratio_forms(sympy.together(expr))
    return frozenset(skeleton(with_floats(form)) for form in forms)


def found_by(source: str) -> str:
    """Say in a sentence what found a formula.

    >>> found_by("rational")
    ' Found by rational.'
    """
    return f" Found by {source or 'search'}."


def _why(returned: Pick, picked: Pick, compared: bool) -> str:
    """Say when the states themselves asked for another formula than the slopes did."""
    if returned is picked or not compared:
        return ""
    return " Fitted to the noisy states themselves, this form takes fewer bits than the others."
