"""Diffusion: what the noise in the motion of each state is, and paths that have such noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import sympy

from dynsr.data import Trajectory
from dynsr.errors import EngineError
from dynsr.expression import compile_columns, evaluate, parse, shown
from dynsr.fit import Driven, Series, StochasticFit, StochasticSystem
from dynsr.parameters.intervals import write_interval


@dataclass(frozen=True)
class DiffusionTerm:
    """One term of a diffusion: a positive factor of a product of columns.

    Parameters
    ----------
    body : the product, as text; "1" for noise that is the same everywhere.
    value : its factor.
    low, high : the ends of the 95 % interval of the factor; None where the data leave it open.
    """

    body: str
    value: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Diffusion:
    """The noise in the motion of a state: dx = f dt + sqrt(D) dW, in the sense of Ito.

    Parameters
    ----------
    terms : of D, the variance of the change in unit time.
    columns : names that they may contain.
    error : standard deviation of the errors of measurement, which come on top; 0 where none are
        seen.
    correlations : other state -> the correlation of the noise of the two.

    >>> own = Diffusion((DiffusionTerm("x**2", 0.04, 0.037, 0.043),), ("x",))
    >>> own.expr, own.text("x")
    (0.04*x**2, 'Noise in the motion of x: variance 0.04*x**2 in unit time (0.037 to 0.043).')
    """

    terms: tuple[DiffusionTerm, ...]
    columns: tuple[str, ...]
    error: float = 0.0
    correlations: Mapping[str, float] = field(default_factory=dict)

    @property
    def expr(self) -> sympy.Expr:
        """D as an expression in the columns."""
        return sympy.Add(
            *[sympy.Float(own.value) * parse(own.body, self.columns) for own in self.terms]
        )

    @property
    def is_seen(self) -> bool:
        """Whether there is any noise."""
        return any(own.value > 0 for own in self.terms)

    def text(self, state: str) -> str:
        """Say what it is, to be read.

        Parameters
        ----------
        state : whose noise it is.
        """
        said = f"No noise in the motion of {state} is seen"
        if self.is_seen:
            ends = ", ".join(write_interval(own.low, own.high) for own in self.terms)
            variance = shown(self.expr, 4)
            said = f"Noise in the motion of {state}: variance {variance} in unit time ({ends})"
        if self.error > 0:
            said += f"; errors of measurement of {self.error:.3g}"
        for other, value in self.correlations.items():
            said += f"; correlation of {value:.2g} with the noise of {other}"
        return f"{said}."

    def in_units(self, state: str, units: Mapping[str, sympy.Expr], time: sympy.Expr) -> Diffusion:
        """Give it for columns in other units.

        Parameters
        ----------
        state : whose noise it is.
        units : column -> its unit here, in units of there.
        time : the unit of the time, likewise.
        """
        places = {sympy.Symbol(n): sympy.Symbol(n) / u for n, u in units.items()}
        found = []
        for own in self.terms:
            body = parse(own.body, self.columns)
            factor = float(body.xreplace(places) / body * units[state] ** 2 / time)
            ends = (None if end is None else end * factor for end in (own.low, own.high))
            found.append(DiffusionTerm(own.body, own.value * factor, *ends))
        error = self.error * float(units[state])
        return Diffusion(tuple(found), self.columns, error, self.correlations)


def draw_paths(
    drift: Mapping[str, sympy.Expr],
    diffusion: Mapping[str, Diffusion],
    start: Sequence[float] | np.ndarray,
    t: np.ndarray,
    driven: Driven,
    count: int,
    rng: np.random.Generator,
    parts: int,
) -> np.ndarray:
    """Draw paths (count, n, k) of a stochastic system (Euler and Maruyama).

    Parameters
    ----------
    drift, diffusion : state -> its drift, and its diffusion.
    start : (k,) states at the first time.
    t : (n,) times.
    driven : the inputs.
    count : how many paths.
    rng : the source of chance.
    parts : steps between two rows.

    Raises EngineError where a path leaves the finite numbers.
    """
    states = list(drift)
    exprs = [*drift.values(), *(diffusion[s].expr for s in states)]
    program = compile_columns(exprs, [*states, *driven.names, "t"])
    mixed = np.eye(len(states))
    for i, state in enumerate(states):
        for other, value in diffusion[state].correlations.items():
            mixed[i, states.index(other)] = value
    root = np.linalg.cholesky(mixed)
    x = np.broadcast_to(np.asarray(start, dtype=float)[:, None], (len(states), count)).copy()
    rows = [x.T]
    for begin, end in pairwise(t):
        step = (end - begin) / parts
        inputs = driven(begin + step * np.arange(parts))
        for now in inputs.T:
            with np.errstate(all="ignore"):
                found = program(*x, *(np.broadcast_to(v, count) for v in now))
                noise = root @ rng.standard_normal(x.shape)
                k = len(states)
                x = x + step * found[:k] + np.sqrt(step * np.maximum(found[k:], 0.0)) * noise
        if not np.all(np.isfinite(x)):
            raise EngineError(f"a path leaves the finite numbers before t = {end:g}")
        rows.append(x.T)
    return np.stack(rows, axis=1)


def measure_steps(
    drift: Mapping[str, sympy.Expr],
    diffusion: Mapping[str, Diffusion],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
) -> StochasticFit:
    """Take a stochastic system and the steps of rows, to ask what each step misses.

    Parameters
    ----------
    drift, diffusion : state -> its drift, and its diffusion.
    runs : trajectories with columns of these names.
    inputs : input name -> expression in ``t`` where it is known.
    """
    series = Series.of(runs, inputs)
    order = series.states
    none = sympy.Float(np.finfo(float).tiny)
    own = {s: diffusion[s].expr if diffusion[s].is_seen else none for s in order}
    errors = {s: diffusion[s].error for s in order if diffusion[s].error > 0}
    system = StochasticSystem(
        {s: drift[s] for s in order}, own, series if errors else series.apart(), errors
    )
    count = len(system.start)
    return StochasticFit(system, system.start, 0.0, np.eye(count))


def score_steps(fit: StochasticFit) -> dict[str, dict[str, float]]:
    """Score what each step misses.

    ``step_rmse`` is its root mean square; ``step_size`` its mean square in units of what the noise
    in the motion and the errors of measurement add up to, 1 where these are right.

    Parameters
    ----------
    fit : of :func:`measure_steps`.
    """
    misses, white = fit.misses, fit.white
    return {
        state: {
            "step_rmse": math.sqrt(float(np.nanmean(misses[..., i] ** 2))),
            "step_size": float(np.nanmean(white[..., i] ** 2)),
        }
        for i, state in enumerate(fit.problem.series.states)
    }


@dataclass(frozen=True, eq=False)
class Cells:
    """What the changes of a state are in cells of near rows, and what its equations say of them.

    Parameters
    ----------
    state : whose changes these are.
    of : what the first cells are near in: the state where it is the only column, or the drift.
    at : (c,) its mean in each of them.
    slope, error : (c,) mean change there in unit time, and its standard error.
    drift : (c,) the mean of the drift found.
    value : (d,) the mean of the state in cells that are near in it.
    variance : (d,) mean square there in unit time of what a step misses.
    diffusion : (d,) the mean of the diffusion found.
    """

    state: str
    of: str
    at: np.ndarray
    slope: np.ndarray
    error: np.ndarray
    drift: np.ndarray
    value: np.ndarray
    variance: np.ndarray
    diffusion: np.ndarray


def cells_of(fit: StochasticFit, count: int = 24) -> list[Cells]:
    """Compare the changes of each state with the equations, in cells of near rows.

    Parameters
    ----------
    fit : of :func:`measure_steps`.
    count : cells of each state.
    """
    series = fit.problem.series.apart()
    columns, h = series.columns, series.h[:, 0]
    alone = len(series.states) + len(series.driven_names) == 2
    found = []
    for i, state in enumerate(series.states):
        drift, noise = (
            np.broadcast_to(evaluate(part[state], columns), h.shape)
            for part in (fit.problem.drift, fit.problem.diffusion)
        )
        own = columns[state]
        slope = (series.y[:, 1, i] - series.y[:, 0, i]) / h
        among = own if alone else drift
        near, level = (_split(values, count) for values in (among, own))
        error = [float(slope[p].std() / math.sqrt(len(p))) for p in near]
        found.append(
            Cells(
                state,
                state if alone else "drift found",
                _means(among, near),
                _means(slope, near),
                np.array(error),
                _means(drift, near),
                _means(own, level),
                _means((slope - drift) ** 2 * h, level),
                _means(noise, level),
            )
        )
    return found


def _split(values: np.ndarray, count: int) -> list[np.ndarray]:
    """Give the places of values in cells of equally many, the least values first."""
    parts = np.array_split(np.argsort(values, kind="stable"), count)
    return [own for own in parts if len(own) > 1]


def _means(values: np.ndarray, parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.array([float(values[own].mean()) for own in parts])


def as_trajectories(
    paths: np.ndarray, t: np.ndarray, states: Sequence[str]
) -> tuple[Trajectory, ...]:
    """Give paths (count, n, k) as trajectories."""
    return tuple(
        Trajectory(t, own, tuple(states), origin={"engine": "Euler and Maruyama"}) for own in paths
    )


def log_interval(value: float, error: float, reach: float) -> tuple[float | None, float | None]:
    """Give the interval of a positive constant, None for ends that its error leaves open.

    Parameters
    ----------
    value : the constant.
    error : standard error of its logarithm.
    reach : standard errors that an interval reaches to either side.

    >>> low, high = log_interval(1.0, 0.1, 2.0)
    >>> round(low, 2), round(high, 2)
    (0.82, 1.22)
    """
    if not math.isfinite(error) or reach * error > math.log(1 / np.finfo(float).eps):
        return None, None
    return value * math.exp(-reach * error), value * math.exp(reach * error)
