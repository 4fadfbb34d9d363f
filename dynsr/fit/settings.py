"""The numbers that decide how constants are fitted, snapped and varied."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FitSettings:
    """Settings of the fits of constants; they change results, so they stand in a run's record.

    Parameters
    ----------
    most_constants : formulas of more constants are neither fitted again nor snapped one by one.
    near : a fraction or decimal is tried for a constant when it lies this close, relative to it.
    tried : simple numbers, fewest expected bits first, that are fitted before one is taken.
    surely_zero : a constant becomes 0 only where that moves it by fewer standard errors than this.
    variation_rounds : how often a formula's best neighbour becomes the formula.
    varied : neighbours, fewest bits first, that are snapped in a round.
    longest : formulas of more bits are not varied: they have too many neighbours.
    snap_rounds : how often the surest constant of every state is snapped on the states.
    tie_bits : a simple number is taken where it costs at most this much more.
    finest : relative standard error that no constant falls below; integration is not surer.
    match_losses : losses of the fit to the states, each from where the one before ended.
    match_windows : windows of the data at most.
    match_gain : relative gain below which a fit to the states ends.
    match_seconds : time after which the best constants found so far are taken.
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
    match_seconds: float = 10.0


FIT = FitSettings()
