"""Stochastic: equations of states whose motion itself has noise, dx = f dt + sqrt(D) dW.

The drift f is found as an equation is, and the variance D of the noise with it. A drift is a law of
the data where each step is missed by chance alone: by what no column explains, in its size as in
its sign, and what neighbouring steps do not share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import monotonic

import numpy as np
import sympy
from scipy.special import chdtrc

from dynsr.data import Trajectory
from dynsr.discovery.options import OF_PLAIN, Options
from dynsr.discovery.problem import DiscoverySettings
from dynsr.discovery.result import Discovery
from dynsr.engines import DEFAULT_ENGINE, refuse_idle
from dynsr.errors import InputError
from dynsr.expression import shown, to_text
from dynsr.fit import (
    Candidate,
    ParetoFront,
    StochasticFit,
    StochasticSystem,
    interval_reach,
    simple_numbers,
    structure_bits,
    tidy,
)
from dynsr.jobs import Budget, Turns, collect_by
from dynsr.methods import AUTO, choose_methods
from dynsr.parameters import Diffusion, DiffusionTerm, log_interval, match_constants
from dynsr.selection import (
    StochasticFound,
    StochasticSearch,
    StochasticSearchSettings,
)
from dynsr.verdict import (
    APPROXIMATION,
    LAW,
    NOBODY,
    NOT_FOUND,
    OtherFormula,
    StateVerdict,
    TermCertainty,
    Verdict,
    VerdictSettings,
    chance_of,
    doubt_terms,
    explain,
    is_probable,
    most_by_chance,
    products_of,
    summarise,
)

_NAME = "stochastic"
# Options of a search that have no meaning where the motion has noise.
_REFUSED = ("known", *OF_PLAIN, "method", "targets", "nonnegative", "must", "constraints")


def check_stochastic(runs: Sequence[Trajectory], options: Options) -> bool:
    """Say whether noise in the motion is asked for.

    Parameters
    ----------
    runs, options : the data, and what is asked of them.

    Raises InputError where it is neither, or another option does not go with it.

    >>> run = Trajectory(np.arange(3.0), np.ones((3, 1)), ("x",))
    >>> check_stochastic([run], Options(stochastic=True))
    True
    """
    asked = options.stochastic
    if not asked:
        return False
    options.refuse(_REFUSED, "stochastic", "stochastic")
    if known := [state for run in runs for state in run.noise]:
        raise InputError(
            f"the known measurement errors of {known[0]} do not go with stochastic, which fits "
            f"them; leave noise out, and columns of errors by naming the states (--states)"
        )
    choose_methods(AUTO, options.preset)
    refuse_idle(options.engine, "each step of the rows is fitted by itself")
    return True


def search_stochastic(runs: Sequence[Trajectory], options: Options) -> Discovery:
    """Search the drift and the diffusion of every state.

    Parameters
    ----------
    runs, options : the data, and what is asked of them.
    """
    began, details, inputs = monotonic(), options.details, options.drives
    states, names = runs[0].states, runs[0].names
    demands = options.demands(states, names)
    record = {
        **demands.as_record(),
        **options.record(_NAME, runs[0]),
        "engine": DEFAULT_ENGINE,
    }
    options.claim(record, runs, {_NAME: True})
    search = StochasticSearch.of(runs, inputs, demands, details.stochastic)
    if len(search.steps.h) < details.verdict.fewest:
        raise InputError(
            f"{len(search.steps.h)} steps between rows with every state measured are too few to "
            "see noise in the motion; give more rows"
        )
    rounds: list[StochasticFound] = []
    whole: list[StochasticFound] = []

    def look() -> None:
        stages = ("drift and diffusion", "errors of measurement")
        with Turns(stages, str, options.report) as turns:
            for stage in turns:
                if stage == stages[0]:
                    for found in search.run():
                        rounds.append(found)
                        turns.say(found.drift)
                else:
                    whole.append(search.finish(rounds[-1]))

    until = Budget(options.time_budget).until(details.shares.choices)
    cut, complete = collect_by(until, look, rounds)
    if not rounds:
        raise InputError(
            "no equations with noise in the motion were found in this time; give more"
            if cut
            else "the steps of these data have no probability: are all rows the same?"
        )
    best = (whole or rounds)[-1]
    found = _discover(best, rounds[-1], search, runs, inputs, details, complete)
    record |= {
        "engines": {
            "search": "none (NumPy on the steps between rows)",
            "fit": "embedded (probability of each step)",
            "simulate": "embedded",
        },
        **({"ended_by_budget": [_NAME]} if cut else {}),
    }
    return replace(found, settings=record, seconds=monotonic() - began)


def _discover(
    best: StochasticFound,
    on_steps: StochasticFound,
    search: StochasticSearch,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: DiscoverySettings,
    complete: bool,
) -> Discovery:
    """Give the system with its verdict."""
    fit, states = best.fit, search.series.states
    own = fit.estimate
    numbers = simple_numbers(own, [None] * len(own.constants), settings.selection.fit)
    final = {s: tidy(e) for s, e in own.put(numbers).items()}
    sizes = fit.sizes[: len(numbers)].tolist()
    known = list(zip(map(float, numbers), sizes, own.constants.tolist(), strict=True))
    errors, fitted = match_constants(final, known)
    others = {s: search.alternatives(on_steps, s) for s in states} if complete else {}
    verdict = (
        _Tests(best, search, settings.verdict, search.settings).give(others) if complete else NOBODY
    )
    freedom = max(int(np.count_nonzero(np.isfinite(fit.white))) - len(fit.values), 1)
    reach = interval_reach(freedom)
    diffusion = _describe(best, search, reach)
    front = {
        s: ParetoFront(
            Candidate(expr, bits, structure_bits(expr), _NAME)
            for expr, bits in [(on_steps.drift[s], 0.0), *others.get(s, [])]
        )
        for s in states
    }
    return Discovery(
        final,
        errors,
        front,
        {s: explain(s, e, verdict.states[s]) if verdict.tested else "" for s, e in final.items()},
        tuple(runs),
        dict(inputs),
        complete=complete,
        fitted=fitted,
        reach=reach,
        verdict=verdict,
        diffusion=diffusion,
    )


def _describe(
    best: StochasticFound, search: StochasticSearch, reach: float
) -> dict[str, Diffusion]:
    """Give the noise in the motion of each state, with the intervals of its constants."""
    fit, names = best.fit, search.names
    system, found = fit.system, {}
    for state, expr in fit.diffusion.items():
        unseen = search.mean_of(expr) <= 2 * system.least[search.series.states.index(state)]
        terms = []
        for part in () if unseen else fit.noise_parts(state):
            (place,) = part.outside
            low, high = log_interval(part.factor, float(fit.sizes[place]), reach)
            terms.append(DiffusionTerm(to_text(part.body), part.factor, low, high))
        correlations = {
            other: value
            for pair, value in (system.correlations or {}).items()
            for own, other in (pair, pair[::-1])
            if own == state
        }
        found[state] = Diffusion(
            tuple(terms),
            names,
            (system.errors or {}).get(state, 0.0),
            correlations,
        )
    return found


@dataclass(frozen=True, eq=False)
class _Tests:
    """Tests what each step misses."""

    best: StochasticFound
    search: StochasticSearch
    settings: VerdictSettings
    chances: StochasticSearchSettings

    def give(self, others: Mapping[str, Sequence[tuple[sympy.Expr, float]]]) -> Verdict:
        """Give the verdict on all states.

        Parameters
        ----------
        others : state -> other drifts, and the bits that they take more.
        """
        surprise = self._surprise()
        states = {s: self._test(s, others.get(s, ()), surprise) for s in self.search.series.states}
        law = "with noise in the motion; each step is missed by chance alone."
        return summarise(states, float(np.median(self.search.steps.h)), law)

    def _test(
        self, state: str, others: Sequence[tuple[sympy.Expr, float]], surprise: bool
    ) -> StateVerdict:
        place = self.search.series.states.index(state)
        white = self._along.white[..., place]
        told = np.isfinite(white)
        chi = float(np.mean(white[told] ** 2))
        terms = self._terms(state)
        compared = tuple(
            OtherFormula.of(expr, bits) for expr, bits in others[: self.settings.alternatives]
        )
        spread = float(self.search.series.scale[place])
        error = (self.best.fit.system.errors or {}).get(state, 0.0)
        found = StateVerdict(
            NOT_FOUND,
            "",
            self._r2(place),
            chi,
            noise=float(f"{error / spread:.6g}"),
            rows=float(np.count_nonzero(told)),
            terms=terms,
            alternatives=compared,
        )
        seen = self._shown(white, surprise)
        doubts = [*seen, *self._doubts(terms, others)]
        drift = self.best.drift[state]
        follows = "each step is missed by" if drift != 0 else "it moves by"
        if not doubts:
            return replace(found, level=LAW, reason=f"{follows} chance alone.")
        level = NOT_FOUND if drift == 0 and seen else APPROXIMATION
        return replace(found, level=level, reason=f"{'; '.join(doubts)}.")

    def _r2(self, place: int) -> float:
        """Share of the variance of a state that a step from the row before explains."""
        misses = self.best.fit.misses[..., place]
        misses = misses[np.isfinite(misses)]
        found = 1 - float(np.mean(misses**2)) / float(self.search.series.scale[place]) ** 2
        return float(f"{found:.6g}")

    def _terms(self, state: str) -> tuple[TermCertainty, ...]:
        fit, rows = self.best.fit, float(len(self.search.steps.h))
        found = []
        for part in fit.parts(state):
            found += [(part.body, place) for place in part.outside]
            found += [(None, place) for place in part.inside]
        return tuple(TermCertainty.of(t, float(fit.ratios[place]), rows) for t, place in found)

    def _shown(self, white: np.ndarray, surprise: bool) -> list[str]:
        """Give what the steps show to be no chance."""
        found = []
        of_misses, of_squares = self.chances.degrees
        if self._follows(white, of_misses):
            found.append("what its steps miss depends on the columns")
        if self._follows(white**2, of_squares):
            found.append("the size of its noise depends on the columns in another way")
        if self._is_correlated(white):
            found.append(
                "what neighbouring steps miss is alike: the motion remembers more than its state, "
                "or a state is missing"
            )
        if surprise:
            found.append(f"the last {self.settings.held_back:.0%} of the data are missed by more")
        return found

    def _doubts(
        self, terms: Sequence[TermCertainty], others: Sequence[tuple[sympy.Expr, float]]
    ) -> list[str]:
        """Give what leaves the drift itself open."""
        found = doubt_terms(terms, self.settings)
        if not is_probable([bits for _, bits in others], self.settings):
            near, bits = others[0]
            how = "does better" if bits < 0 else "does as well"
            found.append(f"{shown(tidy(near), 4)} {how}")
        return found

    @cached_property
    def _along(self) -> StochasticFit:
        """The fit with its steps in the order of the rows."""
        fit = self.best.fit
        rows = self.search.series.pieces(self.chances.piece)
        return replace(fit, problem=replace(fit.problem, series=rows))

    def _follows(self, values: np.ndarray, degree: int) -> bool:
        """Say whether products of the columns explain values at the steps (Fisher's test)."""
        series, flat = self._along.problem.series, values.ravel()
        columns = np.array([series.columns[name] for name in (*self.search.names, "t")])
        told = np.isfinite(flat)
        while degree:
            design = products_of(columns, degree)[told]
            count = design.shape[1]
            if count <= self.chances.products * np.count_nonzero(told):
                break
            degree -= 1
        if not degree:
            return False
        own = flat[told] - flat[told].mean()
        return chance_of(design, own, count - 1) < self.chances.chance

    def _is_correlated(self, white: np.ndarray) -> bool:
        """Say whether neighbouring steps are missed by the same (Ljung and Box 1978)."""
        total, lags = 0.0, min(self.settings.steps, white.shape[1] - 1)
        for lag in range(1, lags + 1):
            pairs = white[:, lag:] * white[:, :-lag]
            own = pairs[np.isfinite(pairs)]
            total += float(np.sum(own)) ** 2 / max(len(own), 1)
        return bool(lags and chdtrc(lags, total) < self.chances.chance)

    def _surprise(self) -> bool:
        """Say whether constants of the first rows miss the last ones by more than chance."""
        steps = self.best.fit.problem.series.apart()
        held = max(1, int(self.settings.held_back * len(steps.h)))
        order = np.argsort(steps.driven[0, -1, :, 0], kind="stable")
        before, after = (steps.some(own) for own in (order[:-held], order[-held:]))
        fit = self.best.fit
        system = replace(fit.system, errors=None, correlations=None)
        first = StochasticSystem(system.drift, system.diffusion, before).fit()
        if first is None:
            return False
        white = replace(first, problem=replace(first.problem, series=after)).white
        chi = float(np.mean(white**2))
        return chi > most_by_chance(white.size)
