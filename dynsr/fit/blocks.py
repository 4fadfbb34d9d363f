"""Blocks: constants fitted to every row of long records, in one pass over blocks of rows.

Each block is fitted alone from constants that are near already. The blocks are independent
measurements of the same constants, so that all rows together say the sum of what each says: the
mean of the blocks, weighted by what each says, has the precision of a fit to all rows at once
(Le Cam's one-step estimate; a fixed-effect meta-analysis). How far the blocks differ from that mean
is a test of whether one law holds in all of them (Cochran 1954).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import sympy
from scipy.linalg import LinAlgError
from scipy.special import chdtri

from dynsr.data import SmoothedTrajectory, StateNoise, Trajectory, carry
from dynsr.expression import free_constants
from dynsr.fit.collocation import Collocation, Measurements, covariance_of
from dynsr.fit.noise import FLOOR
from dynsr.fit.polishing import simple_numbers
from dynsr.fit.settings import FIT, FitSettings
from dynsr.fit.shooting import INTERVALS, build_shooting, choose_pace, prepare
from dynsr.fit.simple import simple_value


@dataclass(frozen=True, eq=False)
class BlockFit:
    """Constants fitted to one block of rows.

    Parameters
    ----------
    run, first, last : place of the trajectory, the block's first row and the one after its last.
    constants : (P,) fitted values.
    information : (P, P) what the block says of them, in inverse squares of their units.
    mean_squares : (k,) mean squared residuals of the states in units of what is expected.
    """

    run: int
    first: int
    last: int
    constants: np.ndarray
    information: np.ndarray
    mean_squares: np.ndarray

    def distance(self, constants: np.ndarray) -> float:
        """Squared distance from other constants in the block's standard errors.

        Parameters
        ----------
        constants : (P,) the others.
        """
        shift = self.constants - constants
        return float(shift @ self.information @ shift)


def _weighted_mean(blocks: Sequence[BlockFit]) -> tuple[np.ndarray, np.ndarray]:
    """(P,) mean of the constants weighted by information, and (P, P) the information of all."""
    information = np.sum([block.information for block in blocks], axis=0)
    pull = np.sum([block.information @ block.constants for block in blocks], axis=0)
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(scale, scale)
    return np.linalg.lstsq(scaled, pull / scale, rcond=None)[0] / scale, information


@dataclass(frozen=True, eq=False)
class RowsFit:
    """Constants fitted to all rows.

    Parameters
    ----------
    exprs : state -> equation, whose constants are the start.
    blocks : the fits of all blocks that could be fitted.
    failed : (run, first row, row after the last) of those that could not.
    most : mean squared residual of a block up to which the equations are true in it.
    noisy : whether the states are noisy; their noise is then an estimate.
    """

    exprs: Mapping[str, sympy.Expr]
    blocks: tuple[BlockFit, ...]
    failed: tuple[tuple[int, int, int], ...]
    most: float
    noisy: bool

    @cached_property
    def _whole(self) -> tuple[np.ndarray, np.ndarray]:
        return _weighted_mean(self.blocks)

    @property
    def constants(self) -> np.ndarray:
        """(P,) in the order of the states and of their appearance."""
        return self._whole[0]

    @cached_property
    def covariance(self) -> np.ndarray:
        """(P, P) of the constants; inf where the data do not determine it."""
        return covariance_of(self._whole[1]) * self._scale

    @property
    def _scale(self) -> float:
        """Variance of the residuals in units of the noise that was given, which is an estimate."""
        if not self.noisy:
            return 1.0
        return max(float(np.median([np.mean(b.mean_squares) for b in self.blocks])), FLOOR)

    @property
    def errors(self) -> np.ndarray:
        """(P,) standard errors; inf where the data do not determine it."""
        return np.sqrt(np.diag(self.covariance))

    def put(self, numbers: Sequence[sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give the equations with P numbers in the places of the constants.

        Parameters
        ----------
        numbers : in the order of the constants.
        """
        found, place = {}, 0
        for state, expr in self.exprs.items():
            template, values = free_constants(expr, "constant ")
            own = numbers[place : place + len(values)]
            found[state] = template.xreplace(dict(zip(values, own, strict=True)))
            place += len(values)
        return found

    def differing(self, level: float) -> list[tuple[int, int, int]]:
        """Give (run, first row, row after the last) of the blocks in which the law does not hold.

        There the residuals are larger than they may be, or the constants are others than those of
        the blocks that agree; and blocks in which nothing could be fitted.

        Parameters
        ----------
        level : probability with which no block differs by chance.
        """
        by_chance = chdtri(max(len(self.constants), 1), (1 - level) / len(self.blocks))
        found = list(self.failed)
        alike = [block for block in self.blocks if np.all(block.mean_squares <= self.most)]
        # Constants of exact blocks differ by what solvers miss, which is no chance.
        while self.noisy and len(alike) > 1:
            mean = _weighted_mean(alike)[0]
            worst = max(alike, key=lambda block: block.distance(mean))
            if worst.distance(mean) <= by_chance * self._scale:
                break
            alike.remove(worst)
        found += [(b.run, b.first, b.last) for b in self.blocks if b not in alike]
        return sorted(found)

    def choose_numbers(
        self, written: Sequence[tuple[float, float]], settings: FitSettings = FIT
    ) -> list[sympy.Expr]:
        """Give the numbers with which the constants are written, simple ones where rows allow it.

        Parameters
        ----------
        written : (P,) numbers that the constants have in the equations, with the standard errors
            with which these were found. Simple ones stay unless the rows rule them out.
        settings : the numbers that decide.
        """
        simple = [simple_value(value, error, settings) for value, error in written]
        pairs = zip(simple, written, strict=True)
        kept = [n if n is not None and float(n) == value else None for n, (value, _) in pairs]
        if self.noisy:
            return simple_numbers(self, kept, settings)
        # What solvers miss by is no chance, so that no standard error bounds it.
        stays = np.abs([v for v, _ in written] - self.constants) <= settings.confirmed * np.abs(
            self.constants
        )
        return [
            (sympy.Float(value) if number is None else number) if same else sympy.Float(float(own))
            for number, (value, _), own, same in zip(
                kept, written, self.constants, stays, strict=True
            )
        ]


def fit_blocks(
    exprs: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    noise: Sequence[StateNoise] | None,
    exact: float,
    rows: int,
    settings: FitSettings = FIT,
) -> RowsFit | None:
    """Fit every float of equations to all rows, block after block.

    Parameters
    ----------
    exprs : state -> right-hand side, with constants that are near already.
    runs : trajectories of the same columns.
    inputs : input name -> expression in ``t``, where it is known.
    noise : the noise of each state of the runs; None for exact states.
    exact : of exact states, the root mean square that windows of ten intervals may miss by, as a
        share of a state's spread.
    rows : rows of a block.
    settings : the numbers that decide.

    Gives None where no block can be fitted.

    >>> t = np.linspace(0, 20, 2001)
    >>> x = np.exp(-0.5 * t) + 1e-3 * np.random.default_rng(0).standard_normal(2001)
    >>> decay = Trajectory(t, x[:, None], ("x",))
    >>> start = {"x": -0.49 * sympy.Symbol("x")}
    >>> found = fit_blocks(start, [decay], {}, [StateNoise(1e-3)], 0.0, 500)
    >>> len(found.blocks), bool(abs(found.constants[0] + 0.5) < 2 * found.errors[0] < 1e-3)
    (4, True)
    """
    spread = _spread_of(runs, list(exprs))
    fineness = 1 if noise is None else None
    fits, failed = [], []
    for place, first, last in cut_blocks([len(run) for run in runs], rows):
        block = runs[place].select(slice(first, last))
        if noise is None:
            found = _fit_exact(exprs, block, inputs, exact * spread, settings)
        else:
            if fineness is None:
                total = sum(map(len, runs)) / (last - first)
                fineness = _choose_fineness(exprs, block, inputs, noise, total, settings)
            found = _fit_noisy(exprs, block, inputs, noise, fineness, settings)
        if found is None:
            failed.append((place, first, last))
        else:
            fits.append(BlockFit(place, first, last, *found))
    most = 1.0 if noise is None else settings.followed**2
    return (
        RowsFit(dict(exprs), tuple(fits), tuple(failed), most, noise is not None) if fits else None
    )


def cut_blocks(lengths: Sequence[int], rows: int) -> Iterator[tuple[int, int, int]]:
    """Cut trajectories into blocks of like length.

    Parameters
    ----------
    lengths : rows of each trajectory.
    rows : rows of a block, about.

    Gives (place of the trajectory, first row, row after the last).

    >>> list(cut_blocks([10, 4], 5))
    [(0, 0, 5), (0, 5, 10), (1, 0, 4)]
    """
    for place, length in enumerate(lengths):
        ends = np.linspace(0, length, max(1, round(length / rows)) + 1).astype(int)
        yield from ((place, int(a), int(b)) for a, b in pairwise(ends))


def _spread_of(runs: Sequence[Trajectory], states: Sequence[str]) -> np.ndarray:
    """(k,) standard deviation of what was measured of states, over all runs."""
    columns = [runs[0].index(state) for state in states]
    found: np.ndarray = np.nanstd(
        np.concatenate([run.observed[:, columns] for run in runs]), axis=0
    )
    return found


def _fit_noisy(
    exprs: Mapping[str, sympy.Expr],
    block: Trajectory,
    inputs: Mapping[str, sympy.Expr],
    noise: Sequence[StateNoise],
    fineness: int,
    settings: FitSettings,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Give constants, their information and the mean squares, from the rows as they are."""
    block = carry([block])[0]
    gaps = ~block.measured
    sizes = [
        own.sd(x) if known is None else known.at(x)
        for own, x, known in zip(noise, block.x.T, map(block.noise.get, block.states), strict=True)
    ]
    sd = np.where(gaps, np.inf, np.column_stack(sizes))
    slope = np.gradient(block.x, block.t, axis=0)
    rough = SmoothedTrajectory(block.t, block.x, slope, sd, sd, sd, (), block.states)
    data = Measurements([block], inputs, [rough], fineness=fineness)
    mesh, strict = data.mesh(tuple(exprs)), settings.strict
    # From constants that are near, the last stages are enough but where noise is large.
    for stages in (strict.stiffness, (*settings.along.stiffness, *strict.stiffness[1:])):
        try:
            fit = Collocation(exprs, mesh, replace(strict, stiffness=stages)).fit()
        except (LinAlgError, ArithmeticError, ValueError):
            continue
        if fit is not None and np.all(fit.mean_squares <= settings.followed**2):
            break
    if fit is None or not np.all(np.isfinite(fit.information)):
        return None
    return fit.constants, fit.information, fit.mean_squares


def _choose_fineness(
    exprs: Mapping[str, sympy.Expr],
    block: Trajectory,
    inputs: Mapping[str, sympy.Expr],
    noise: Sequence[StateNoise],
    blocks: float,
    settings: FitSettings,
) -> int:
    """Give the parts between rows with which the rule moves constants less than chance does.

    All rows are surer of the constants than one block is, but the error of the rule stays.
    """
    coarse = _fit_noisy(exprs, block, inputs, noise, 1, settings)
    for fineness in (1, 2):
        fine = _fit_noisy(exprs, block, inputs, noise, 2 * fineness, settings)
        if coarse is None or fine is None:
            break
        chance = np.sqrt(np.diag(covariance_of(fine[1])) / blocks)
        if np.all(np.abs(fine[0] - coarse[0]) <= chance / 2):
            return fineness
        coarse = fine
    return 4


def _fit_exact(
    exprs: Mapping[str, sympy.Expr],
    block: Trajectory,
    inputs: Mapping[str, sympy.Expr],
    unit: np.ndarray,
    settings: FitSettings,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Give the same where rows are exact: every tenth row is the start of a window."""
    flow, values, _ = prepare(exprs, [block], inputs)
    lanes = replace(settings, match_windows=len(block))
    constants = np.array(values, dtype=float)
    with np.errstate(all="ignore"):
        shooting = build_shooting(flow, [block], inputs, INTERVALS, False, lanes)
        starts = shooting.windows.x[0]
        pace = choose_pace(shooting, constants, starts, settings.match_substeps)
        shooting = replace(shooting, pace=pace)
        if not np.all(np.isfinite(shooting.misses(constants, starts))):
            return None
        constants, starts = shooting.minimise(constants, starts, "linear", settings.match_trials)
        missed = shooting.missed(shooting.misses(constants, starts))
        squares = np.sum(missed**2, axis=(0, 2)) / np.maximum(shooting.counts, 1)
        mean_squares = squares / np.maximum(unit, 1e-300) ** 2
        if not len(constants):
            return constants, np.zeros((0, 0)), mean_squares
        try:
            covariance = shooting.covariance(constants, starts)
        except (LinAlgError, FloatingPointError):
            return None
        if not np.all(np.isfinite(covariance)):
            return None
        least = (settings.finest * np.maximum(np.abs(constants), 1e-300)) ** 2
        information = np.linalg.pinv(covariance + np.diag(least), hermitian=True)
    return (constants, information, mean_squares) if math.isfinite(squares.sum()) else None
