"""Following: how closely equations, integrated from fitted starts, keep to measured trajectories.

The starts are fitted, since a measured start carries its noise into every later row. Over a run
whose errors grow too far to be followed as a whole, windows are followed, the longest that can be.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy

from dynsr.data import FEWEST_ROWS, Trajectory
from dynsr.expression import expand_terms, free_constants
from dynsr.fit import (
    ROUGH,
    Flow,
    Pace,
    Shooting,
    Windows,
    cut_windows,
    drives_of,
    finer_paces,
    independent_rows,
    loosen,
)

# Squared residuals in units of the noise below which nothing is distinguished.
LEAST_SQUARE = 1e-3
# Rows that are enough for a sum or a score; of more, evenly spaced ones are taken.
ENOUGH_ROWS = 200
# Robust sizes of residuals beyond which one is an outlier.
FAR = 6.0
# One over the shares of a window that a fit grows through.
_PARTS = (16, 4, 1)
# Miss in units of the noise below which starts and constants are as good as fitted.
_NOTHING = 0.01


def first_rows(shooting: Shooting, rows: int) -> Shooting:
    """Give the same misses over the first rows of every window."""
    own = shooting.windows
    windows = Windows(own.t[:rows], own.x[:rows], own.drive, own.jumps)
    return replace(shooting, windows=windows, spread=shooting.spread[:rows])


@dataclass(frozen=True)
class Place:
    """What one constant of a system is: the ``term`` of a state whose coefficient it is, or None.

    ``value`` is its number in the equation.
    """

    state: str
    term: sympy.Expr | None
    value: float


def open_constants(
    equations: Mapping[str, sympy.Expr], fixed: Collection[sympy.Expr] = ()
) -> tuple[dict[str, sympy.Expr], dict[sympy.Symbol, Place]]:
    """Put a symbol in the place of the coefficient of every term, and of every number inside one.

    Parameters
    ----------
    equations : state -> right-hand side.
    fixed : terms that stay as they are.

    >>> x = sympy.Symbol("x")
    >>> opened, places = open_constants({"x": x - 3 * x**2})
    >>> sorted((str(place.term), place.value) for place in places.values())
    [('x', 1.0), ('x**2', -3.0)]
    >>> [place.value for place in open_constants({"x": x / 4})[1].values()]
    [0.25]
    """
    opened: dict[str, sympy.Expr] = {}
    places: dict[sympy.Symbol, Place] = {}
    for state, expr in equations.items():
        lines: dict[sympy.Expr, tuple[sympy.Expr, sympy.Expr]] = {}
        written, terms = sympy.Add.make_args(expr), []
        for whole in written:
            if whole in fixed:
                terms.append(whole)
                continue
            top, bottom = _split(whole)
            # A ratio is given up to a factor, so that its last number below the line stays; terms
            # on one line have it together.
            if bottom not in lines:
                loose = loosen(1 / bottom) if bottom.free_symbols else sympy.S.One
                factor, over = loose.as_coeff_Mul()
                lines[bottom] = factor, _open_floats(over, state, places)
            factor, over = lines[bottom]
            for term in sympy.Add.make_args(expand_terms(top)):
                coefficient, rest = term.as_coeff_Mul()
                symbol = sympy.Symbol(f"constant {state} {len(places)}")
                # The line of all that there is goes without saying.
                named = rest if len(written) == 1 else rest / bottom
                places[symbol] = Place(state, named, float(coefficient * factor))
                rest = loosen(rest).as_coeff_Mul()[1] if rest.free_symbols else rest
                terms.append(symbol * _open_floats(rest, state, places) * over)
        opened[state] = sympy.Add(*terms)
    return opened, places


def _split(term: sympy.Expr) -> tuple[sympy.Expr, sympy.Expr]:
    """Give numerator and denominator; a denominator that is a number belongs to the term."""
    top, bottom = sympy.fraction(sympy.together(term), exact=True)
    return (top, bottom) if bottom.free_symbols else (term, sympy.S.One)


def _open_floats(expr: sympy.Expr, state: str, places: dict[sympy.Symbol, Place]) -> sympy.Expr:
    template, values = free_constants(expr, f"inner {state} {len(places)} ")
    places.update({symbol: Place(state, None, value) for symbol, value in values.items()})
    return template


@dataclass(frozen=True, eq=False)
class Course:
    """The measured side of following: runs thinned to what statistics need, with their noise.

    Parameters
    ----------
    runs : the trajectories.
    noise : for each run (n, k) standard deviations of the noise of its rows, above 0; inf where a
        state was not measured.
    states : the k states that are followed; other columns are read from the data.
    inputs : input name -> expression in ``t`` where it is known.
    thinned : how many measurements of the data one here replaces.
    curves : for each run (n, k) states at its rows, from which the fits of starts begin; nothing
        where they begin at the measurements.
    """

    runs: tuple[Trajectory, ...]
    noise: tuple[np.ndarray, ...]
    states: tuple[str, ...]
    inputs: Mapping[str, sympy.Expr]
    thinned: float = 1.0
    curves: tuple[np.ndarray, ...] = ()

    @classmethod
    def of(
        cls,
        runs: Sequence[Trajectory],
        noise: Sequence[np.ndarray],
        states: Sequence[str],
        inputs: Mapping[str, sympy.Expr],
        rows: int,
        curves: Sequence[np.ndarray] = (),
    ) -> Course:
        """Take every n-th row, so that at most ``rows`` remain."""
        every = max(1, math.ceil(sum(map(len, runs)) / rows))
        taken = [run.thin(every if len(run) >= FEWEST_ROWS * every else 1) for run in runs]
        pairs = [(i, rows) for i, own in enumerate(taken) for rows in own]
        thin = tuple(runs[i].select(rows) for i, rows in pairs)
        own = tuple(noise[i][rows] for i, rows in pairs)
        total, left = (sum(int(np.sum(run.measured)) for run in some) for some in (runs, thin))
        kept = tuple(curves[i][rows] for i, rows in pairs) if curves else ()
        return cls(thin, own, tuple(states), inputs, total / left, kept)

    @property
    def longest(self) -> int:
        """Intervals of the longest run."""
        return max(map(len, self.runs)) - 1

    def flow(self, equations: Mapping[str, sympy.Expr], constants: Sequence[sympy.Symbol]) -> Flow:
        """Make the flow of equations; columns that they use and do not give are read."""
        used = {str(s) for e in equations.values() for s in e.free_symbols}
        names = dict.fromkeys([*self.runs[0].names, *self.inputs])
        driven = tuple(n for n in names if n not in equations and n in used)
        return Flow(dict(equations), driven, tuple(constants))

    def shoot(self, flow: Flow, length: int, most: int) -> list[Shooting]:
        """Give the residuals of a flow over windows of ``length``; shorter runs are whole."""
        found = []
        for size in sorted({min(length, len(run) - 1) for run in self.runs}):
            some = [i for i, run in enumerate(self.runs) if min(length, len(run) - 1) == size]
            found.append(self._shoot(flow, some, size, most))
        return found

    def _shoot(self, flow: Flow, some: Sequence[int], size: int, most: int) -> Shooting:
        runs = [self.runs[i] for i in some]
        columns = [runs[0].index(state) for state in flow.rhs]
        places = [self.states.index(state) for state in flow.rhs]
        drives = drives_of(flow.driven, runs, self.inputs)
        times = [run.t for run in runs]
        windows = cut_windows(times, [r.x[:, columns] for r in runs], drives, size, most)
        level = [self.noise[i][:, places] for i in some]
        noise = cut_windows(times, level, drives, size, most).x
        begun = None
        if self.curves:
            curves = [self.curves[i][:, places] for i in some]
            begun = cut_windows(times, curves, drives, size, most).x[0]
        return Shooting(flow, windows, noise, True, begun=begun)


@dataclass(frozen=True, eq=False)
class Followed:
    """A system fitted to the trajectories: one entry for each group of windows of one length.

    ``misses`` are (rows, k, W) in units of the noise, 0 where nothing was measured; NaN where the
    equations diverge.
    """

    shootings: tuple[Shooting, ...]
    constants: np.ndarray
    starts: tuple[np.ndarray, ...]
    misses: tuple[np.ndarray, ...]
    length: int

    @property
    def finite(self) -> bool:
        """Say whether the equations can be integrated over all windows."""
        return all(bool(np.all(np.isfinite(z))) for z in self.misses)

    def sizes(self) -> np.ndarray:
        """(k,) mean squared residual of every state, in units of its noise."""
        total = sum(np.sum(z**2, axis=(0, 2)) for z in self.misses)
        found: np.ndarray = total / np.maximum(self.counts, 1)
        return found

    @cached_property
    def counts(self) -> np.ndarray:
        """(k,) measurements of every state that are followed."""
        return np.asarray(sum(s.counts for s in self.shootings))

    @property
    def told(self) -> np.ndarray:
        """(N,) whether there is a measurement, of all misses in the order of :meth:`linearise`."""
        return np.concatenate([s.told.transpose(2, 0, 1).reshape(-1) for s in self.shootings])

    def lanes(self, place: int) -> list[np.ndarray]:
        """Give the residuals of one state (rows, W) at its measurements, window by window."""
        found = []
        for shooting, z in zip(self.shootings, self.misses, strict=True):
            own = shooting.told[:, place]
            parts = [z[rows, place, [lane]][:, None] for lane, rows in enumerate(own.T)]
            found += [z[:, place]] if own.all() else [part for part in parts if len(part)]
        return found

    @cached_property
    def independent(self) -> np.ndarray:
        """(k,) independent rows of the residuals of every state."""
        lanes = [self.lanes(place) for place in range(len(self.counts))]
        return np.array([sum(independent_rows(z[:, None])[0] for z in own) for own in lanes])

    def linearise(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Misses (N,), their slopes by constants and all starts (N, P + k W), states (N,).

        Only measurements count.
        """
        count, lanes = len(self.constants), [s.shape[1] for s in self.starts]
        k = len(self.misses[0][0])
        columns = count + k * sum(lanes)
        misses, slopes, owners, first = [], [], [], count
        for shooting, starts in zip(self.shootings, self.starts, strict=True):
            z, by_constant, by_start = shooting.linearise(self.constants, starts)
            flat = z.transpose(2, 0, 1).reshape(len(by_constant), -1)
            for lane in range(starts.shape[1]):
                block = np.zeros((flat.shape[1], columns))
                block[:, :count] = by_constant[lane]
                block[:, first : first + k] = by_start[lane]
                first += k
                misses.append(flat[lane])
                slopes.append(block)
                owners.append(np.tile(np.arange(k), len(z)))
        told = self.told
        every = np.concatenate(misses), np.concatenate(slopes), np.concatenate(owners)
        return every if told.all() else (every[0][told], every[1][told], every[2][told])


def follow(
    shootings: Sequence[Shooting],
    constants: np.ndarray,
    *,
    starts: Sequence[np.ndarray] = (),
    free: bool = False,
) -> Followed:
    """Fit the starts, and with ``free`` the constants too.

    From growing parts of the windows, with steps that are short enough; or, where starts are given,
    over the whole at once, with the steps that the windows have.

    Parameters
    ----------
    shootings : groups of windows.
    constants : (P,) values.
    starts : where the starts begin, (k, W) for each group; the measured ones by default.
    free : fit the constants too; only for a single group, others keep their constants.
    """
    begin = list(starts) or [s.starts for s in shootings]
    parts = (1,) if starts else _PARTS
    with np.errstate(all="ignore"):
        chosen = list(shootings)
        if not starts:
            chosen = [replace(s, pace=_choose_pace(s, constants)) for s in shootings]
        if free and len(chosen) == 1:
            constants, begin[0] = _grow(chosen[0], constants, begin[0], parts)
        else:
            closed = chosen[0].flow.closed(constants)
            begin = [
                _grow(replace(s, flow=closed), np.empty(0), at, parts)[1]
                for s, at in zip(chosen, begin, strict=True)
            ]
        misses = tuple(s.misses(constants, at) for s, at in zip(chosen, begin, strict=True))
    length = max(len(z) for z in misses) - 1
    return Followed(tuple(chosen), constants, tuple(begin), misses, length)


def _choose_pace(shooting: Shooting, constants: np.ndarray) -> Pace:
    """Take finer steps until the last ones move no state by more than what is nothing to fit."""
    starts = shooting.starts
    pace, coarse = shooting.pace, shooting.misses(constants, starts)
    for pace in finer_paces(1, 16):
        fine = replace(shooting, pace=pace).misses(constants, starts)
        if np.max(np.abs(fine - coarse)) < _NOTHING:
            break
        coarse = fine
    return pace


def _grow(
    shooting: Shooting, constants: np.ndarray, starts: np.ndarray, parts: Sequence[int] = _PARTS
) -> tuple[np.ndarray, np.ndarray]:
    """Fit over growing parts of the windows; near its end a fit needs the last loss alone.

    Where nothing is missed beyond a hundredth of the noise there is nothing to fit.
    """
    if np.max(np.abs(shooting.misses(constants, starts))) < _NOTHING:
        return constants, starts
    rows = len(shooting.windows.t)
    closed = shooting.flow.closed(constants) if len(constants) else shooting.flow
    losses = ("linear", "soft_l1") if len(parts) > 1 else ("soft_l1",)
    for part in dict.fromkeys(max(min(rows, FEWEST_ROWS), rows // share) for share in parts):
        some = first_rows(shooting, part)
        if not np.all(np.isfinite(some.misses(constants, starts))):
            break
        # Over a part of a window constants are not known yet; whole windows tell them.
        if part < rows and len(constants):
            _, starts = _fit(replace(some, flow=closed), np.empty(0), starts, "linear")
            continue
        for loss in losses if part == rows else ("linear",):
            constants, starts = _fit(some, constants, starts, loss)
    return constants, starts


def _fit(
    shooting: Shooting, constants: np.ndarray, starts: np.ndarray, loss: str
) -> tuple[np.ndarray, np.ndarray]:
    """Fit by few steps; that a state follows is seen before its fit is exact."""
    return shooting.minimise(constants, starts, loss, most=6, gain=ROUGH)
