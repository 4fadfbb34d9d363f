"""Profiles: the profile likelihood of each constant of the equations, and the intervals from it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import sympy

from dynsr.data import FEWEST_SMOOTH, Trajectory
from dynsr.errors import InputError
from dynsr.expression import free_constants
from dynsr.fit import (
    AlongFit,
    Measurements,
    ProfileSettings,
    Profiling,
    fit_along,
    loosen_all,
)
from dynsr.parameters.intervals import home_of, printed_places, take_apart, write_interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Ends of an interval; inf for a side that the data leave open, below too.
Ends: TypeAlias = tuple[float, float]


@dataclass(frozen=True, eq=False, repr=False)
class Profile:
    """The profile likelihood of one constant: how much worse the data are followed for each value.

    Parameters
    ----------
    name : of a parameter, "" of a single constant.
    state, index : whose constant it is, and its place in ``found.constants[state]``; of a
        parameter that several constants share, the first of these.
    of : the term that it belongs to.
    value : where the joint fit has it.
    values : (n,) at which it was fixed, increasing.
    criterion : (n,) half the rise of the chi-square there, which is the loss of log-likelihood,
        all other constants and the states fitted again.
    low, high : ends of the 95 % interval by the likelihood ratio; None where the data leave that
        side open: however far the constant goes, the others compensate for it.
    wald : the interval by the standard error.
    limit : criterion at which the interval ends: half the square of Student's quantile.
    """

    name: str
    state: str
    index: int
    of: str
    value: float
    values: np.ndarray
    criterion: np.ndarray
    low: float | None
    high: float | None
    wald: tuple[float, float]
    limit: float

    @property
    def bounded(self) -> tuple[bool, bool]:
        """Whether the data bound the constant below, and above."""
        return self.low is not None, self.high is not None

    @property
    def text(self) -> str:
        """The constant and its interval, to be read."""
        return f"{self.value:.6g} ({self.interval_text})"

    @property
    def interval_text(self) -> str:
        """The interval of the profile, to be read."""
        return write_interval(self.low, self.high)

    @property
    def wald_text(self) -> str:
        """The interval by the standard error, to be read."""
        low, high = (end if math.isfinite(end) else None for end in self.wald)
        return write_interval(low, high)

    def __repr__(self) -> str:
        """Write the constant, its interval and its term."""
        return f"<{self.title}: {self.text}>"

    @property
    def title(self) -> str:
        """What it is of, to be read."""
        return f"{self.name or 'constant'} of {self.of} in {self.state}'"

    def plot(self) -> Figure:
        """Draw the profile, its interval, and the parabola of the standard error."""
        from dynsr.report import draw_profiles

        return draw_profiles([self])


@dataclass(frozen=True, eq=False)
class Profiles:
    """The profiles of the constants of equations, made one by one from one joint fit.

    Parameters
    ----------
    equations : state -> right-hand side.
    profiling : the fit of all constants, as they are in the loosened equations.
    rule : the error of the rule in each of these; 0 where it is hidden by that of the data.
    fixed : terms whose factors are known.
    """

    equations: Mapping[str, sympy.Expr]
    profiling: Profiling
    rule: np.ndarray
    fixed: Collection[sympy.Expr] = ()

    @classmethod
    def of(
        cls,
        equations: Mapping[str, sympy.Expr],
        runs: Sequence[Trajectory],
        inputs: Mapping[str, sympy.Expr],
        derived: Mapping[str, sympy.Expr],
        rows: int,
        settings: ProfileSettings,
        fixed: Collection[sympy.Expr] = (),
    ) -> Profiles:
        """Fit all constants of equations to trajectories.

        Parameters
        ----------
        equations : state -> right-hand side.
        runs : the trajectories.
        inputs : input name -> expression in ``t`` where it is known.
        derived : state -> its slope, a column that was made from it.
        rows : rows of the data at most.
        settings : the numbers that decide a profile.
        fixed : terms whose factors are known.

        Raises InputError where the equations cannot be fitted to them.
        """
        shortest = min(map(len, runs))
        if shortest < FEWEST_SMOOTH:
            raise InputError(
                f"{shortest} rows are too few for a profile; give trajectories of {FEWEST_SMOOTH} "
                "or more"
            )
        made = {state: slope for state, slope in derived.items() if slope.is_Symbol}
        data = Measurements.of(runs, inputs, rows, made)
        fit, rule = _fit_finely(_loosen_but(equations, fixed), data, settings)
        if fit is None or not np.all(np.isfinite(fit.found.misses)):
            raise InputError(
                "the equations cannot be fitted along these data; their slopes diverge"
            )
        profiling = Profiling.of(fit, settings).at_rest()
        if profiling is None:
            raise InputError(
                "the fit of these equations along the data does not come to rest, as they do not "
                "follow the data; their constants have no profiles"
            )
        return cls(equations, profiling, rule, fixed)

    @property
    def places(self) -> list[tuple[str, int, int]]:
        """State, place among its printed constants, and place among all that were fitted."""
        found, first = [], 0
        loose = _loosen_but(self.equations, self.fixed)
        for state, expr in self.equations.items():
            printed, every = printed_places(expr), list(take_apart(expr)[1].values())
            fitted = list(free_constants(loose[state], "constant ")[1].values())
            if len(fitted) == len(every):
                own = list(enumerate(printed))
            else:
                # A known factor is printed as others are.
                own = [
                    (i, fitted.index(every[p])) for i, p in enumerate(printed) if every[p] in fitted
                ]
            found += [(state, index, first + place) for index, place in own]
            first += len(fitted)
        return found

    def profile(self, state: str, index: int) -> Profile:
        """Give the profile of one constant.

        Parameters
        ----------
        state : whose constant.
        index : its place among the printed ones.

        Raises InputError when there is none.
        """
        if state not in self.equations:
            known = ", ".join(self.equations)
            raise InputError(f"{state!r} has no equation; those that have: {known}")
        places = {own: place for name, own, place in self.places if name == state}
        if index not in places:
            raise InputError(
                f"{state} has {len(places)} constants, counted from 0; {index} is not one of them"
            )
        return self._make("", state, index, places[index], self.profiling)

    def named(self, name: str, names: Mapping[str, Sequence[str]]) -> Profile:
        """Give the profile of one parameter, which several constants may share.

        Parameters
        ----------
        name : the parameter.
        names : state -> the parameter of each printed constant, with a minus where it is less that.

        Raises InputError when there is none, or the data do not determine it.
        """
        tied, every, signed = self.tied(names)
        if name not in every:
            raise InputError(f"{name!r} is no parameter; those are {', '.join(every)}")
        first = self.places[signed.index(name)]
        return self._make(name, *first[:2], every.index(name), tied)

    def tied(
        self, names: Mapping[str, Sequence[str]]
    ) -> tuple[Profiling, tuple[str, ...], list[str]]:
        """Give the fit of the parameters, their names, and the name at each printed constant.

        Parameters
        ----------
        names : state -> the parameter of each printed constant, with a minus where it is less that.

        Raises InputError where the data do not determine it.
        """
        texts = [names[state][index] for state, index, _ in self.places]
        signed = [text.lstrip("-") for text in texts]
        every = tuple(dict.fromkeys(signed))
        ways = np.zeros((len(texts), len(every)))
        for text, name, (_, _, place) in zip(texts, signed, self.places, strict=True):
            ways[place, every.index(name)] = -1.0 if text.startswith("-") else 1.0
        try:
            return self.profiling.tied(ways), every, signed
        except np.linalg.LinAlgError:
            raise InputError("the fit to these data does not determine its parameters") from None

    def _make(self, name: str, state: str, index: int, place: int, begun: Profiling) -> Profile:
        rises = begun.profile(place)
        rule = float(np.max(self.rule * (begun.ways[:, place] != 0)))
        value, beside = rises.best.value, rule + begun.reach * float(begun.errors[place])
        fitted = float(begun.values[place])
        lowest = min(0.0, *(point.rise for point in rises.held))
        return Profile(
            name,
            state,
            index,
            home_of(self.equations[state], index),
            value,
            np.array([point.value for point in rises.held]),
            np.array([(point.rise - lowest) / 2 for point in rises.held]),
            None if rises.low is None else rises.low - rule,
            None if rises.high is None else rises.high + rule,
            (fitted - beside, fitted + beside),
            rises.limit / 2,
        )

    def ends(self) -> dict[str, tuple[Ends | None, ...]]:
        """State -> the interval of each printed constant where Wald's is wrong, None elsewhere."""
        found: dict[str, list[Ends | None]] = {
            state: [None] * len(printed_places(expr)) for state, expr in self.equations.items()
        }
        for state, index, place in self.places:
            wrong = not self.profiling.is_parabola(place)
            own = self.profile(state, index) if wrong else None
            found[state][index] = None if own is None else (_end(own.low), _end(own.high))
        return {s: tuple(own) for s, own in found.items() if any(own)}


def _fit_finely(
    equations: Mapping[str, sympy.Expr], data: Measurements, settings: ProfileSettings
) -> tuple[AlongFit | None, np.ndarray]:
    """Fit constants with short steps; gives the fit, and what the error of its rule may still be.

    In exact data the errors of the constants are so small that the error of the rule shows. So the
    steps between rows are halved until the constants stay where they are.
    """
    fit = fit_along(equations, data)
    rule = np.zeros(0 if fit is None else len(fit.constants))
    while fit is not None and data.fineness < settings.finest:
        data = replace(data, fineness=2 * data.fineness)
        again = fit_along(equations, data)
        if again is None:
            break
        moved = np.abs(again.constants - fit.constants)
        if np.all(moved <= settings.hidden * fit.errors):
            return fit, np.zeros_like(rule)
        # The error of the rule falls with each halving; what does not is none of it.
        grows = bool(rule.any() and np.any(moved > np.maximum(rule, settings.hidden * fit.errors)))
        fit, rule = again, moved
        if grows:
            break
    return fit, rule


def _loosen_but(
    equations: Mapping[str, sympy.Expr], fixed: Collection[sympy.Expr]
) -> dict[str, sympy.Expr]:
    """Make coefficients floats, but for those of fixed terms."""
    kept = {s: [t for t in sympy.Add.make_args(e) if t in fixed] for s, e in equations.items()}
    rest = {s: e - sympy.Add(*kept[s]) for s, e in equations.items()}
    return {s: own + sympy.Add(*kept[s]) for s, own in loosen_all(rest).items()}


def _end(value: float | None) -> float:
    return math.inf if value is None else value


def read_constant(which: str | tuple[str, int]) -> tuple[str, int] | str:
    """Give state and place of a constant from a pair or text such as "x:0", or a name as it is.

    Parameters
    ----------
    which : the state, and the place of the constant in ``found.constants[state]``, from 0.

    Raises InputError when it is not one of these.

    >>> read_constant("x:1"), read_constant("k1")
    (('x', 1), 'k1')
    """
    if isinstance(which, str) and ":" not in which:
        return which
    pair = which.rpartition(":")[::2] if isinstance(which, str) else which
    try:
        state, index = pair
        place = int(index)
    except (TypeError, ValueError):
        place, state = -1, ""
    if not state or place < 0 or not math.isfinite(place):
        raise InputError(
            f'{which!r} names no constant; give a parameter, or state and place from 0: ("x", 0)'
        )
    return state, place
