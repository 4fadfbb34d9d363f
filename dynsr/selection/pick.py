"""Selection: from all that was found for one state to one equation, and why it was chosen."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from dynsr.data import Samples, Trajectory, scale_error
from dynsr.expression import ByText, abridged, evaluate, shown
from dynsr.fit import (
    FIT,
    Candidate,
    FitSettings,
    Loss,
    Noise,
    build_shooting,
    choose_by_loss,
    choose_pace,
    collapse,
    description_length,
    improve,
    noise_of,
    one_a_shape,
    prepare,
    score_candidate,
    score_snapped,
    tidy,
)
from dynsr.selection.comparison import ComparisonSettings
from dynsr.selection.first_look import LookSettings
from dynsr.selection.parts import Parts


def forecast_errors(
    exprs: Mapping[str, sympy.Expr],
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    inputs: Mapping[str, sympy.Expr] | None = None,
    window: int = 50,
    fit: FitSettings = FIT,
) -> np.ndarray:
    """Give the absolute errors of W forecasts over ``window`` intervals, (window, k, W).

    Each starts at its first measurement; states without an expression are read from the data.
    In units of the spread; inf where a forecast diverges, NaN where nothing was measured. ``fit``
    says how many there are, and how finely they are integrated.

    >>> t = np.linspace(0, 1, 51)
    >>> decay = Trajectory(t, np.exp(-2 * t)[:, None], ("x",))
    >>> forecast_errors({"x": -2 * sympy.Symbol("x")}, decay).shape
    (50, 1, 1)
    """
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    flow, values, _ = prepare(exprs, runs, inputs or {})
    shooting = build_shooting(flow, runs, inputs or {}, window, False, fit)
    with np.errstate(all="ignore"):
        starts, constants = shooting.windows.x[0], np.array(values)
        pace = choose_pace(shooting, constants, starts, fit.match_substeps)
        misses = np.abs(replace(shooting, pace=pace).misses(constants, starts))
    misses = np.nan_to_num(misses, nan=np.inf, posinf=np.inf)
    return misses if shooting.told.all() else np.where(shooting.told, misses, np.nan)


def forecast_error(
    exprs: Mapping[str, sympy.Expr],
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    inputs: Mapping[str, sympy.Expr] | None = None,
) -> float:
    """Give the median of :func:`forecast_errors`; inf when most forecasts diverge."""
    return float(np.nanmedian(forecast_errors(exprs, trajectories, inputs=inputs)))


@dataclass(frozen=True)
class SelectionSettings:
    """Settings of the choice of one equation per state; they are kept in a run's record.

    Parameters
    ----------
    snapped : formulas, fewest bits first, whose constants are fitted and snapped.
    improved : snapped formulas whose neighbours are tried.
    compared : formulas that are compared on held-back data.
    window : intervals of a forecast.
    errors : medians of forecast errors within so many standard errors of their ratio are equal.
    finest : share of the spread below which forecast errors are equal.
    fit : how constants are fitted and snapped.
    comparison : how whole systems are compared.
    look : the first look at exact slopes.
    loss : the user's own loss, by which description lengths count residuals; None for squares.
    """

    snapped: int = 6
    improved: int = 3
    compared: int = 5
    window: int = 50
    errors: float = 2.0
    finest: float = 1e-7
    fit: FitSettings = FitSettings()
    comparison: ComparisonSettings = ComparisonSettings()
    look: LookSettings = LookSettings()
    loss: Loss | None = None

    @property
    def parts(self) -> Parts:
        """Which parts of the searches take part."""
        return self.comparison.parts

    def without(self, *names: str) -> SelectionSettings:
        """Give the same settings without some parts of the searches.

        Parameters
        ----------
        names : of :data:`dynsr.selection.parts.PARTS`.

        Raises InputError for a name that is no part.

        >>> SELECTION.without("citing").parts.has("citing")
        False
        """
        parts = Parts(tuple(dict.fromkeys((*self.parts.off, *names))))
        return replace(
            self,
            comparison=replace(self.comparison, parts=parts),
            look=replace(self.look, parts=parts),
        )


SELECTION = SelectionSettings()
# What found 0, a constant and a bare column.
TRIVIAL = "trying every column and a constant alone"


@dataclass(frozen=True)
class RankedCandidate:
    """A formula of the last comparison: its bits in all and its error on held-back data.

    ``held_back`` is the median miss of short forecasts in units of the state's spread; None where
    nothing was held back.
    """

    candidate: Candidate
    bits: float
    held_back: float | None


@dataclass(frozen=True)
class Pick:
    """The equation chosen for a state: candidates ranked, the chosen one first, and why."""

    state: str
    ranked: tuple[RankedCandidate, ...]
    noise: Noise

    @property
    def candidate(self) -> Candidate:
        """The chosen candidate."""
        return self.ranked[0].candidate

    @property
    def explanation(self) -> str:
        """Say why the first candidate was chosen."""
        winner, *others = self.ranked
        formula = shown(tidy(winner.candidate.expr))
        sentences = [
            f"{self.state}' = {formula} takes {winner.bits:.0f} bits in all, "
            f"{winner.candidate.complexity:.0f} of them for the formula; found by "
            f"{winner.candidate.source or 'search'}."
        ]
        if winner.held_back is not None:
            sentences.append(
                f"On held-back data it misses by {winner.held_back:.2g} of the spread."
            )
        sentences += [self._compare(winner, other) for other in others[:1]]
        return " ".join(sentences)

    def _compare(self, winner: RankedCandidate, other: RankedCandidate) -> str:
        formula = abridged(shown(tidy(other.candidate.expr), 4))
        if other.bits >= winner.bits:
            return f"The next best, {formula}, takes {other.bits - winner.bits:.0f} bits more."
        less = f"{formula} takes {winner.bits - other.bits:.0f} bits less"
        if other.held_back is None:
            return f"{less} on the slopes alone."
        return f"{less}, but misses by {other.held_back:.2g} on held-back data."


def pick_equation(
    state: str,
    pool: Iterable[Candidate],
    samples: Samples,
    held_back: Sequence[Trajectory] = (),
    known: sympy.Expr = sympy.S.Zero,
    settings: SelectionSettings = SELECTION,
) -> Pick:
    """Choose by description length among formulas that forecast held-back data equally well.

    The constants of the shortest formulas are fitted and snapped, the best are varied, and the
    rest are compared on held-back data.

    Parameters
    ----------
    state : whose equation it is.
    pool : all that was found for it.
    samples : its samples.
    held_back : trajectories that no search has seen; never the test data.
    known : the given part of the equation, which ``samples.y`` leaves out.
    settings : the numbers that decide.

    Raises ValueError when the pool is empty.
    """
    candidates = _distinct(pool)
    if not candidates:
        raise ValueError(f"nothing was found for {state}")
    noise, judged, own = noise_of(candidates, samples), samples, []
    level = noise
    if settings.loss is not None:
        candidates, judged = choose_by_loss(candidates, samples, settings.loss)
        level = noise_of(candidates, judged)
        own = _rank(candidates, judged, level)[: settings.snapped]
    ranked = one_a_shape(_rank(candidates, judged, level))[: settings.snapped]
    fit = settings.fit
    # Constants are snapped by the errors of the slopes, whatever a miss counts.
    scored = _distinct(score_snapped(c, samples, noise, fit) for c in ranked)
    snapped = _rank(scored, judged, level)
    varied = [improve(c, samples, noise, fit) for c in snapped[: settings.improved]]
    last = _rank(_distinct([*varied, *snapped, *own]), judged, level)[: settings.compared]
    # What is no shorter than another that misses as little cannot be the choice.
    last = _rank(
        _distinct(collapse(c, [*last, *candidates], samples, noise, fit) for c in last),
        judged,
        level,
    )
    misses = {
        c.expr: forecast_errors({state: known + c.expr}, held_back, window=settings.window, fit=fit)
        for c in last
        if held_back
    }
    compared = [
        RankedCandidate(
            c if judged is samples else score_candidate(c.expr, samples, c.source),
            description_length(c, judged, level),
            float(np.median(misses[c.expr])) if held_back else None,
        )
        for c in last
    ]
    # The misses of one forecast are correlated: each forecast counts once.
    forecasts = min((m.shape[-1] for m in misses.values()), default=1)
    return Pick(state, tuple(rank_candidates(compared, forecasts, settings)), noise)


def rank_by_length(state: str, pool: Iterable[Candidate], samples: Samples) -> Pick:
    """Order formulas by description length alone: where systems are compared, they decide.

    Parameters
    ----------
    state : whose equation it is.
    pool : all that was found for it.
    samples : its samples.

    Raises ValueError when the pool is empty.
    """
    candidates = _distinct(pool)
    if not candidates:
        raise ValueError(f"nothing was found for {state}")
    noise = noise_of(candidates, samples)
    ranked = _rank(candidates, samples, noise)[: SELECTION.compared]
    lengths = [description_length(c, samples, noise) for c in ranked]
    return Pick(
        state,
        tuple(RankedCandidate(c, b, None) for c, b in zip(ranked, lengths, strict=True)),
        noise,
    )


def lead_with(pick: Pick, candidate: Candidate, samples: Samples) -> Pick:
    """Put a candidate first, whatever its description length.

    Parameters
    ----------
    pick : the others.
    candidate : what is known to be the equation.
    samples : the samples of the state.
    """
    bits = description_length(candidate, samples, pick.noise)
    rest = (r for r in pick.ranked if r.candidate.expr != candidate.expr)
    return replace(pick, ranked=(RankedCandidate(candidate, bits, None), *rest))


def rank_candidates(
    candidates: Sequence[RankedCandidate],
    forecasts: int,
    settings: SelectionSettings = SELECTION,
) -> list[RankedCandidate]:
    """Order by bits, behind those whose held-back error is clearly above the least.

    Clearly: by more than twice the standard error of the ratio of two medians of ``forecasts``
    errors, sqrt(2) times that of the median of sizes of normal errors.
    """
    misses = [
        c.held_back for c in candidates if c.held_back is not None and np.isfinite(c.held_back)
    ]
    equal = 1 + settings.errors * math.sqrt(2) * float(scale_error(forecasts))
    bound = equal * min(misses) + settings.finest if misses else np.inf
    return sorted(candidates, key=lambda c: ((c.held_back or 0.0) > bound, c.bits))


def _distinct(pool: Iterable[Candidate]) -> list[Candidate]:
    return list({c.expr: c for c in pool}.values())


def _rank(pool: list[Candidate], samples: Samples, noise: Noise) -> list[Candidate]:
    bits = {c.expr: description_length(c, samples, noise) for c in pool}
    finite = [c for c in pool if np.isfinite(bits[c.expr])]
    return sorted(finite or pool, key=lambda c: (bits[c.expr], ByText(c.expr)))


def trivial_candidates(samples: Samples) -> list[Candidate]:
    """Give 0, every column and the mean slope as candidates: q' = v is found without a search.

    The mean comes last: of formulas that are equal along the data it alone has a constant.
    """
    exprs = [sympy.S.Zero, *map(sympy.Symbol, samples.names), sympy.Float(float(samples.y.mean()))]
    return [score_candidate(expr, samples, TRIVIAL) for expr in exprs]


def explains_all(candidate: Candidate, samples: Samples) -> bool:
    """Say whether the median miss of a formula is at most 0.05 % of the slopes' root mean square.

    A few outliers may have large residuals, but not the slopes that make up most of the sum of
    squares: compared with short bursts everything else is small, and 0 would explain it.

    >>> t = np.arange(9.0)
    >>> s = Samples(t[:, None], t, ("v",), "q", "given", t)
    >>> explains_all(score_candidate(sympy.Symbol("v"), s), s)
    True
    """
    misses = np.abs(samples.y - evaluate(candidate.expr, samples.columns))
    size = float(np.sqrt(np.mean(samples.y**2)))
    most = np.sum(misses**2) <= 0.5 * np.sum(samples.y**2)
    return bool(most and np.median(misses) <= 5e-4 * size)
