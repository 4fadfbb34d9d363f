"""The numbers that decide how constants are fitted, snapped and varied."""

from __future__ import annotations

from dataclasses import dataclass

from dynsr.expression import Vocabulary


@dataclass(frozen=True)
class CollocationSettings:
    """Settings of the fit of whole systems; they are kept in a run's record.

    Parameters
    ----------
    stiffness : weights of the squared defects, one stage after the other, in units of the noise.
        At 1e5 a system of 1000 rows may leave its own solution by a tenth of the noise at most.
    steps : steps of a stage at most.
    gain : a stage ends when a step lowers the sum of squares by less than this share.
    early : the same for the stages before the last, which lead to its start.
    difference : step of the numerical derivatives, relative to a state's spread and a constant.
    loose : bits that a smaller weight than the last costs, apart from how well it is known. It is
        taken where the evidence is greater by more; 0 where all have the last.
    """

    stiffness: tuple[float, ...] = (1e1, 1e3, 1e5)
    steps: int = 12
    gain: float = 1e-4
    difference: float = 1e-7
    loose: float = 0.0
    early: float = 1e-4


@dataclass(frozen=True)
class FitSettings:
    """Settings of the fits of constants; they change results, so they are kept in a run's record.

    Parameters
    ----------
    most_constants : formulas of more constants are neither fitted again nor snapped one by one.
    near : a fraction or decimal is tried for a constant when it lies this close, relative to it.
    tried : simple numbers, fewest expected bits first, that are fitted before one is taken.
    surely_zero : a constant becomes 0, or of noisy data a factor 1, only where that moves it by
        fewer standard errors than this.
    variation_rounds : how often a formula's best neighbour becomes the formula.
    varied : neighbours, fewest bits first, that are snapped in a round.
    longest : formulas of more bits are not varied: they have too many neighbours.
    snap_rounds : how often the surest constant of every state is snapped on the states.
    tie_bits : a simple number is taken where it costs at most this much more.
    finest : relative standard error that no constant falls below; integration is not surer.
    match_losses : losses of the fit to the states, each from where the one before ended.
    match_windows : windows of the data at most.
    match_gain : relative gain below which a fit to the states ends.
    match_trials : integrations of trial steps of one loss at most.
    match_substeps : steps of order 8 between two rows, at most, unless the equations are stiff.
    match_longest : intervals of the longest windows with fitted starts.
    match_follows : longer windows are taken while residuals grow by less than this factor.
    match_reach : longer windows are tried where their residuals are, before the fit, within this
        factor of those of the shorter ones.
    followed : residuals of a state beyond so many times its noise show a wrong equation; then each
        state is fitted alone.
    noisy_width : robust sizes of the residuals that are the unit of the Cauchy loss of noisy data;
        2.385 gives 95 % of the efficiency of least squares under Gaussian noise.
    snap : whether constants become simple numbers at all; 0, 1 and -1, which change what terms a
        formula has, are looked at in any case.
    alike : residuals on exact data within this factor are of the same size, and the shorter formula
        is taken.
    confirmed : share of the way that states go in ten intervals up to which equations may miss
        exact states.
    explained : share of the slopes' size above which residuals show that a formula is no law.
    pinned : relative standard error that denominators above 8 and more than two digits ask for.
    sure : probability, given the prior of use, above which a constant is taken for a simple number.
    within : a simple number lies within so many standard errors of the fitted value.
    joint : level of the likelihood ratio that all simple numbers together must pass.
    vocabulary : functions and operators that a varied formula may contain; None allows all.
    along : how constants are fitted along noisy states at the end; simple numbers are tested by
        differences of some units in a sum of squares of thousands, so that it takes more steps.
    strict : the same for a law that is fitted to all rows of long records, which keep to it
        strictly.
    """

    most_constants: int = 12
    near: float = 0.05
    tried: int = 4
    surely_zero: float = 3.0
    variation_rounds: int = 3
    varied: int = 3
    longest: float = 250.0
    snap_rounds: int = 8
    tie_bits: float = 0.5
    finest: float = 1e-9
    match_losses: tuple[str, ...] = ("linear", "soft_l1", "cauchy")
    match_windows: int = 400
    match_gain: float = 1e-6
    match_trials: int = 60
    match_substeps: int = 8
    match_longest: int = 300
    match_follows: float = 1.15
    match_reach: float = 3.0
    followed: float = 3.0
    noisy_width: float = 2.385
    snap: bool = True
    alike: float = 1.25
    confirmed: float = 3e-6
    explained: float = 0.01
    pinned: float = 1e-4
    sure: float = 0.75
    within: float = 2.0
    joint: float = 0.95
    vocabulary: Vocabulary | None = None
    along: CollocationSettings = CollocationSettings(steps=40, gain=1e-8, early=1e-8)
    strict: CollocationSettings = CollocationSettings(stiffness=(1e5, 1e7, 1e9))


FIT = FitSettings()
