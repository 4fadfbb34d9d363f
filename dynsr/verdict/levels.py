"""Levels: what a verdict is, the numbers that decide it, and how it is said."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import sympy

from dynsr.arguments import Renamed, renamed
from dynsr.data import Trajectory, diagnose
from dynsr.errors import InputError, quoted
from dynsr.expression import abridged, shown, write_line
from dynsr.fit import tidy
from dynsr.verdict.by_state import ByState
from dynsr.verdict.drift import DRIFT, DriftSettings

LAW, APPROXIMATION, NOT_FOUND = LEVELS = ("law", "approximation", "not found")

# Of equations that nobody has judged, as where a search was cut short.
NOT_TESTED = "not judged"


@renamed(rivals="alternatives", rival_bits="alternative_bits")
@dataclass(frozen=True)
class VerdictSettings:
    """The numbers that decide a verdict; a discovery's record contains them.

    Parameters
    ----------
    r2 : share of a state's variance, less that of its noise, that an approximation explains at
        least.
    follows : share of it that equations explain over windows that they follow, without noise.
    finest : share of a state's spread that its noise is never thought below.
    exact : noise, as a share of the spread, below which data are clean, as solvers write them.
    solver : error of solvers of low accuracy over a whole run, as a share of the spread; an error
        of less than twice that reproduces clean data, less with more than three constants.
    within_solver : times the errors that a solver left in slopes, as rows between its steps show
        them, that a law misses these by at most.
    slopes, sharp : median error of slopes, as a share of their size, that is no law's, and the
        error of the slopes themselves below which this is tested.
    excess : mean squared residual in units of the noise that is still noise, beyond its own spread.
    correlated : correlation of neighbouring residuals above which they are no noise, if
        significant.
    sure : smallest ratio of a term to its standard error in a law.
    alternative_bits : bits by which every different formula is worse than a law.
    probable : probability of a law in noise among the formulas that were compared; a formula that
        takes b bits more has 2^-b of its weight.
    alternatives : formulas of the front that are fitted to the trajectories, for each state.
    adopted : of those that seem better, how many are tried in the place of the answer, for each
        state.
    different : rms difference, in shares of the slopes' spread, of formulas that are different.
    held_back : share of each trajectory's end that is forecast.
    rows : rows that are tested, at most; of more, evenly spaced ones are.
    fewest : rows a constant below which nothing is a law.
    growth : growth of a start's error over a run above which windows of it are followed.
    hopeless : growth above which a run is not tried as a whole.
    windows : windows that a run is cut into, at most.
    steps : steps of the free runs of a map.
    free : error of free runs of a map, in units of the sum of the residuals of its single steps,
        above which these do not explain it.
    differs : rms difference of two maps as a share of the spread, from which on they are different.
    drift : the terms in the time, and in every column, that equations are compared with.
    """

    r2: float = 0.9
    follows: float = 0.99
    finest: float = 5e-5
    exact: float = 2e-4
    solver: float = 2e-3
    within_solver: float = 3.0
    slopes: float = 1e-5
    sharp: float = 1e-6
    excess: float = 1.6
    correlated: float = 0.25
    sure: float = 4.0
    alternative_bits: float = 8.0
    probable: float = 0.95
    alternatives: int = 3
    adopted: int = 3
    different: float = 1e-5
    held_back: float = 0.25
    rows: int = 400
    fewest: float = 8.0
    growth: float = 50.0
    hopeless: float = 1e3
    windows: int = 64
    steps: int = 5
    free: float = 3.0
    differs: float = 0.02
    drift: DriftSettings = DRIFT


VERDICT: VerdictSettings = VerdictSettings()

# Share of the spread below which nothing is said of how much less is missed.
_LEAST = 1e-3

_EVERY = "every equation reproduces and forecasts the data within their noise."

# Of more terms that the data are not sure of, the first are named.
_NAMED = 5

# Causes that leave an equation unsure which explains all.
_OF_MORE = ("too few rows", "too much noise", "map", "interpolated")

# Causes that the same data may have, of which all are said.
_ALIKE = ("second order", "time dependence", "missing state")


@dataclass(frozen=True)
class TermCertainty:
    """One term of an equation: its ratio to its standard error, and the probability it belongs.

    The probability is that of the Bayesian information criterion (Raftery 1995), with the term or
    without: 1 / (1 + sqrt(n) exp(-ratio^2 / 2)) for n rows.
    """

    term: str
    ratio: float
    probability: float

    @classmethod
    def of(cls, term: sympy.Expr | None, ratio: float, rows: float) -> TermCertainty:
        """Give the certainty of a term.

        Parameters
        ----------
        term : the term without its constant; None for a constant inside it.
        ratio : of the constant to its standard error.
        rows : independent rows.

        >>> TermCertainty.of(sympy.Symbol("x"), 3.0, 100.0)
        TermCertainty(term='x', ratio=3.0, probability=0.900017)
        """
        doubt = math.exp(-ratio * ratio / 2) * math.sqrt(rows)
        name = "a constant inside it" if term is None else shown(term)
        return cls(name, round_off(ratio), round_off(1 / (1 + doubt)))


@dataclass(frozen=True)
class OtherFormula:
    """A different formula for a state, and the bits it takes more than the equation found."""

    equation: str
    bits: float

    @classmethod
    def of(cls, expr: sympy.Expr, bits: float) -> OtherFormula:
        """Write a formula that takes so many bits more."""
        return cls(shown(tidy(expr), 4), round_off(bits))


def _check_level(level: str) -> None:
    if level not in LEVELS:
        raise InputError(f"a verdict is {', '.join(LEVELS)}, not {quoted(level)}")


@renamed(rivals="alternatives")
@dataclass(frozen=True)
class StateVerdict:
    """What is to be thought of one equation.

    Parameters
    ----------
    level : "law", "approximation" or "not found".
    reason : why, in words.
    r2 : share of the state's variance that the integrated equations explain; -inf where they
        diverge.
    chi_square : mean squared residual in units of the noise, per degree of freedom; 1 is noise.
    forecast : rms error at the held-back end, forecast by constants fitted to what comes before, as
        a share of the spread; None where it was not tried.
    noise : the noise of the state as a share of its spread.
    rows : independent rows of the residuals; 0 where they were not tested.
    terms : how sure each term is.
    alternatives : different formulas that were compared, the closest first.
    """

    level: str
    reason: str
    r2: float
    chi_square: float = math.inf
    forecast: float | None = None
    noise: float = 0.0
    rows: float = field(default=0.0, repr=False)
    terms: tuple[TermCertainty, ...] = field(default=(), repr=False)
    alternatives: tuple[OtherFormula, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        """Check the level; raises InputError."""
        _check_level(self.level)


@dataclass(frozen=True)
class Verdict:
    """What is to be thought of the equations of a system.

    Parameters
    ----------
    level : that of the weakest state; ``"not judged"`` where the equations were not tested, as
        where the search was cut short or other numbers were put in.
    reason : why, in words.
    states : state -> its own verdict.
    span : time over which the equations were followed in one piece.

    >>> Verdict("law", "it follows", {}).level
    'law'
    """

    level: str
    reason: str
    states: dict[str, StateVerdict] = field(default_factory=dict, repr=False)
    span: float = field(default=0.0, repr=False)

    def __post_init__(self) -> None:
        """Check the level; raises InputError."""
        object.__setattr__(self, "states", ByState(self.states))
        if self.tested:
            _check_level(self.level)

    @property
    def tested(self) -> bool:
        """Whether the equations were tested at all."""
        return self.level != NOT_TESTED

    @property
    def rank(self) -> int:
        """Place among verdicts from the best one on; one that was not given comes last."""
        return LEVELS.index(self.level) if self.tested else len(LEVELS)

    judged = Renamed("tested")
    rivals = Renamed("alternatives")

    @property
    def alternatives(self) -> dict[str, tuple[OtherFormula, ...]]:
        """State -> different formulas that were compared, the closest first."""
        return ByState({state: own.alternatives for state, own in self.states.items()})


# The verdict of nobody.
NOBODY = Verdict(NOT_TESTED, "these equations have no verdict")


def is_probable(others: Sequence[float], settings: VerdictSettings) -> bool:
    """Say whether an equation is probable enough for a law in noise.

    Parameters
    ----------
    others : bits that each other formula takes more; one of b more has 2^-b of its weight.
    settings : the numbers that decide.

    >>> is_probable([5.0, 8.0], VERDICT), is_probable([5.0, 4.0], VERDICT)
    (True, False)
    """
    with np.errstate(over="ignore"):
        weight = float(np.sum(np.exp2(-np.array(others, dtype=float))))
    return 1 / (1 + weight) >= settings.probable


def most_by_chance(count: int) -> float:
    """Give twice the mean square of so many errors by chance, and four of its standard errors."""
    return 2 + 4 * math.sqrt(2 / max(count, 1))


def open_terms(terms: Sequence[TermCertainty], settings: VerdictSettings) -> list[TermCertainty]:
    """Give the terms that the data may do without.

    Parameters
    ----------
    terms, settings : how sure each is, and the numbers that decide.
    """
    return [term for term in terms if term.ratio < settings.sure]


def doubt_terms(terms: Sequence[TermCertainty], settings: VerdictSettings) -> list[str]:
    """Say which terms the data leave open; nothing where there are none."""
    unsure = list(dict.fromkeys(t.term for t in open_terms(terms, settings)))
    some = unsure if len(unsure) <= _NAMED else [*unsure[: _NAMED - 1], "others"]
    return [f"the data leave it open whether it needs {join_words(some)}"] if some else []


def untested(equations: Iterable[str]) -> Verdict:
    """Give the verdict where the time did not suffice for one: nothing is shown of the equations.

    Parameters
    ----------
    equations : the states that have one.
    """
    reason = "the time budget ended before the equations were tested; give more time."
    own = StateVerdict(NOT_FOUND, reason, -math.inf)
    return Verdict(NOT_FOUND, reason, dict.fromkeys(equations, own))


def doubt(law: StateVerdict, why: str) -> StateVerdict:
    """Take a law for an approximation.

    Parameters
    ----------
    law : the verdict of a law.
    why : what is to be said after "but".
    """
    said = f"{law.reason.removesuffix('.')}, but {why}"
    return replace(law, level=APPROXIMATION, reason=said)


def doubt_laws(verdict: Verdict, doubts: Mapping[str, str]) -> Verdict:
    """Take laws for approximations; the verdict as it is where no law has a doubt.

    Parameters
    ----------
    verdict : on all states.
    doubts : state -> what is to be said after "but".
    """
    states = {
        state: doubt(own, doubts[state]) if own.level == LAW and state in doubts else own
        for state, own in verdict.states.items()
    }
    return verdict if states == verdict.states else summarise(states, verdict.span)


def least_r2(noise: float, settings: VerdictSettings = VERDICT) -> float:
    """Give the R2 that an approximation has at least: noise is not there to be explained.

    Parameters
    ----------
    noise : its standard deviation as a share of the spread of the state.
    settings : the numbers that decide.

    >>> round(least_r2(0.0), 3), round(least_r2(0.3), 3)
    (0.9, 0.819)
    """
    return settings.r2 * (1 - min(float(noise), 1.0) ** 2)


def followed_r2(noise: float | np.ndarray, settings: VerdictSettings = VERDICT) -> np.ndarray:
    """Give the R2 over windows that equations follow: noise takes its part of the variance.

    Parameters
    ----------
    noise : standard deviations of the noise as shares of the spread of each state.
    settings : the numbers that decide; noise may be larger than it seems by ``excess``.

    >>> followed_r2(np.array([0.0, 0.2])).round(3)
    array([0.99 , 0.926])
    """
    return np.asarray(settings.follows - settings.excess * np.minimum(noise, 1.0) ** 2)


def follows_to(r2: float) -> str:
    """Say how closely equations follow the data.

    Parameters
    ----------
    r2 : share of the variance of a state that they explain.

    >>> follows_to(0.9), follows_to(1.0)
    ('follows the data to 32 % of the spread', 'follows the data to less than 0.1 % of the spread')
    """
    # Of R2 six digits are kept.
    missed = math.sqrt(max(0.0, 1 - r2))
    said = percent(missed) if missed >= _LEAST else f"less than {percent(_LEAST)}"
    return f"follows the data to {said} of the spread"


def likely_cause(runs: Sequence[Trajectory], state: str, explained: bool = False) -> str:
    """Say what the data themselves show of why an equation is not found; "" for nothing.

    Parameters
    ----------
    runs : the trajectories.
    state : whose equation it is.
    explained : whether an equation leaves nothing but noise, so that nothing is missing but rows
        or precision.

    >>> t = np.linspace(0, 20, 400)
    >>> likely_cause([Trajectory(t, np.sin(t)[:, None], ("z",))], "z")[:21]
    'z looks second-order:'
    """
    told = [c for c in diagnose(runs, state) if not explained or c.kind in _OF_MORE]
    alike = [c for c in told if told[0].kind in _ALIKE and c.kind in _ALIKE][:2]
    return " ".join(c.sentence for c in alike or told[:1])


def explain(
    state: str,
    expr: sympy.Expr,
    verdict: StateVerdict,
    discrete: bool = False,
    settings: VerdictSettings = VERDICT,
) -> str:
    """Say in words what is to be thought of an equation, and which different one comes next.

    Parameters
    ----------
    state, expr : the equation.
    verdict : what is thought of it.
    discrete : whether it is a map.
    settings : the numbers that decide.

    >>> explain("x", sympy.Symbol("y"), StateVerdict("law", "reproduces the data exactly.", 1.0))
    "x' = y: law; reproduces the data exactly."
    """
    line = write_line(state, tidy(expr), discrete)
    said = f"{line}: {verdict.level}; {verdict.reason}"
    if not verdict.alternatives or verdict.level == NOT_FOUND:
        return said
    alternative = verdict.alternatives[0]
    if alternative.equation in verdict.reason:
        return said
    other = abridged(alternative.equation)
    if alternative.bits < 0:
        return f"{said} A different formula, {other}, follows the trajectories better."
    if alternative.bits < settings.alternative_bits:
        return f"{said} A different formula, {other}, does as well."
    return f"{said} The next different formula, {other}, follows the data clearly worse."


def hold_to_slopes(
    verdict: Verdict, missed: Mapping[str, tuple[float, float]], settings: VerdictSettings = VERDICT
) -> Verdict:
    """Take for an approximation what misses slopes that are exact, however closely it follows.

    Over a run errors of either sign cancel, so that what follows it to a thousandth may be no law.

    Parameters
    ----------
    verdict : what the trajectories show.
    missed : state -> the error of its equation in the slopes, and the error of these, as shares of
        their size.
    settings : the numbers that decide.

    >>> law = summarise({"x": StateVerdict("law", "it follows.", 1.0)}, 2.0)
    >>> hold_to_slopes(law, {"x": (1e-3, 1e-8)}).reason
    'x: it follows, but misses the slopes of the data, which are exact, by 0.1 % of their size.'
    """
    said = "misses the slopes of the data, which are exact, by"
    doubts = {
        state: f"{said} {percent(share)} of their size."
        for state, (share, error) in missed.items()
        if share > settings.slopes and error < settings.sharp
    }
    return doubt_laws(verdict, doubts)


def summarise(states: Mapping[str, StateVerdict], span: float, law: str = _EVERY) -> Verdict:
    """Give the verdict of a system: that of its weakest state.

    Parameters
    ----------
    states : state -> its own verdict.
    span : time over which the equations were followed in one piece.
    law : the reason where every state has a law.

    >>> summarise({"x": StateVerdict("not found", "it diverges.", -1.0)}, 2.0).reason
    'x: it diverges.'
    """
    level = max((own.level for own in states.values()), key=LEVELS.index)
    weak = [state for state, own in states.items() if own.level == level]
    first = f"{weak[0]}: {states[weak[0]].reason}"
    found = first if len(weak) == 1 else f"{join_words(weak)}. {first}"
    return Verdict(level, law if level == LAW else found, dict(states), span)


def percent(share: float) -> str:
    """Write a share to two digits, such as 0.123 as "12 %"."""
    return f"{100 * share:.2g} %"


def join_words(words: Sequence[str]) -> str:
    """Write different words as a list, such as a, b and c."""
    some = list(dict.fromkeys(words))
    return some[0] if len(some) == 1 else f"{', '.join(some[:-1])} and {some[-1]}"


def round_off(value: float) -> float:
    """Round off what differs from machine to machine: beyond six digits, and below 1e-9."""
    return float(f"{round(float(value), 9):.6g}") if math.isfinite(value) else float(value)
