"""Forcing: the part of the states that bends at rows where a held input steps.

A state whose equation reads a held input has a kink at every step of it, and states that read that
one have a kink in their slopes. No smooth curve and no difference of high order follows that. So a
part with the same kinks is taken from the states, the rest is smooth, and is smoothed or
differentiated like any other; then the part is added again, with its slopes in closed form.

The part is a sum of responses of chains of first-order lags to steps of the input, of products of
it, and of the other states: where x' = f(x) + g(x) u, a step changes the slope by g(x) times
the step (a Chen-Fliess expansion; Isidori, Nonlinear Control Systems, 3.1). Its coefficients are
those that leave least with the polynomial through the neighbours of each row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np
from scipy.linalg import expm

from dynsr.data.samples import barycentric_weights
from dynsr.data.trajectory import Trajectory


@dataclass(frozen=True)
class ForcingSettings:
    """How the part of the states that a held input bends is found.

    Parameters
    ----------
    chains : lags of the longest chain tried; the response of k lags has a kink in its derivative
        of order k.
    degrees : of the products of the input and the states that are tried.
    orders : of the polynomials through neighbours.
    lag : time of a lag, in usual steps between rows.
    each : columns at most for each step of an input.
    """

    chains: tuple[int, ...] = (1, 2, 3, 4)
    degrees: tuple[int, ...] = (1, 2, 3)
    orders: tuple[int, ...] = (2, 4, 6, 8)
    lag: float = 10.0
    each: float = 0.5


_SETTINGS = ForcingSettings()


@dataclass(frozen=True, eq=False)
class Forced:
    """The part of the states of one run that bends where its held inputs step.

    Parameters
    ----------
    x : (n, k) its values at the rows.
    slope, second : (n, k) its slope and second derivative, where an input steps those after it.
    before : (n, k) its slope before a step.
    """

    x: np.ndarray
    slope: np.ndarray
    second: np.ndarray
    before: np.ndarray

    def taken_from(self, run: Trajectory) -> Trajectory:
        """Give a run without this part: a smooth one, whatever its inputs do.

        Parameters
        ----------
        run : the run that it was found in.
        """
        return replace(run, x=run.x - self.x, hold=dict.fromkeys(run.input_names, "linear"))


def find_forced(
    runs: Sequence[Trajectory], settings: ForcingSettings = _SETTINGS
) -> list[Forced] | None:
    """Find the part of the states of every run that its held inputs bend; None where none does.

    Parameters
    ----------
    runs : trajectories of the same columns; the coefficients are those of all together.
    settings : what is tried.

    >>> t = np.linspace(0.0, 4.0, 41)
    >>> x = np.where(t < 2, t, 4 - t)
    >>> u = np.where(t < 2, 1.0, -1.0)
    >>> run = Trajectory(t, x[:, None], ("x",), u[:, None], ("u",), hold={"u": "previous"})
    >>> part = find_forced([run])[0]
    >>> left = x - part.x[:, 0]
    >>> bool(np.max(np.abs(np.diff(left, 2))) < 0.02), round(float(part.slope[20, 0]), 1)
    (True, -2.0)
    """
    return _find_once(tuple(runs), settings) if runs[0].input_names else None


# The slopes of every state, their noise and the smoothed states want it.
@lru_cache(maxsize=8)
def _find_once(runs: tuple[Trajectory, ...], settings: ForcingSettings) -> list[Forced] | None:
    held = [i for i, n in enumerate(runs[0].input_names) if runs[0].holds[n] == "previous"]
    steps = sum(int(np.sum(np.any(np.diff(run.inputs[:, held], axis=0), axis=1))) for run in runs)
    if not steps:
        return None
    step = float(np.median(np.concatenate([np.diff(run.t) for run in runs])))
    count = len(runs[0].states)
    scale = np.maximum(np.max(np.abs(np.concatenate([r.x for r in runs])), axis=0), 1e-300)
    size = np.maximum(np.max(np.abs(np.concatenate([r.inputs for r in runs])), axis=0), 1e-300)
    longest = max(settings.chains)
    chains = [
        _Chains.of(run, run.inputs[:, held] / size[held], run.x / scale, settings, step)
        for run in runs
    ]
    choices = [
        (degree, chain)
        for degree in settings.degrees
        for chain in settings.chains
        if chains[0].width(degree) * chain <= max(settings.each * steps, 1)
    ]
    found = [np.zeros((len(run), count, 4)) for run in runs]
    for place in range(count):
        x = [run.x[:, place] for run in runs]
        chosen = _choose(x, chains, choices, settings)
        if chosen is None:
            continue
        columns, coefficients = chosen
        for own, chain in zip(found, chains, strict=True):
            own[:, place] = chain.parts(columns, longest) @ coefficients
    return [Forced(*np.moveaxis(own, 2, 0)) for own in found]


@dataclass(frozen=True, eq=False)
class _Chains:
    """Responses (n, q + 1, m) of chains of 0 to q lags to m products, for one run.

    ``before`` (n, m) is what the products come to before the step at each row.
    """

    t: np.ndarray
    values: np.ndarray
    before: np.ndarray
    degrees: np.ndarray
    lag: float

    @classmethod
    def of(
        cls,
        run: Trajectory,
        u: np.ndarray,
        x: np.ndarray,
        settings: ForcingSettings,
        step: float,
    ) -> _Chains:
        """Let the products of inputs and states step where the inputs do, and lag behind them."""
        products = [
            chosen
            for degree in range(1, max(settings.degrees) + 1)
            for chosen in combinations_with_replacement(range(u.shape[1] + x.shape[1]), degree)
            if chosen[0] < u.shape[1]
        ]
        after, before = (
            np.column_stack([own, x])[1:, :] for own in (u, np.concatenate([u[:1], u[:-1]]))
        )
        jumps = np.column_stack(
            [np.prod(after[:, p], axis=1) - np.prod(before[:, p], axis=1) for p in products]
        )
        level = np.concatenate([np.zeros((1, len(products))), np.cumsum(jumps, axis=0)])
        longest, lag = max(settings.chains), settings.lag * step
        move = np.diag([0.0] + [-1.0 / lag] * longest) + np.diag([1.0 / lag] * longest, -1)
        over = expm(np.diff(run.t)[:, None, None] * move)
        values = np.zeros((len(run), longest + 1, len(products)))
        for i in range(len(run) - 1):
            values[i, 0] = level[i]
            values[i + 1] = over[i] @ values[i]
        values[:, 0] = level
        return cls(
            run.t,
            values,
            np.concatenate([level[:1], level[:-1]]),
            np.array([len(p) for p in products]),
            lag,
        )

    def width(self, degree: int) -> int:
        """Count the products of up to a degree."""
        return int(np.sum(self.degrees <= degree))

    def columns(self, degree: int, chain: int) -> np.ndarray:
        """Responses (n, columns) of up to ``chain`` lags to products of up to a degree."""
        own = self.values[:, 1 : chain + 1, self.degrees <= degree]
        return own.reshape(len(own), -1)

    def parts(self, choice: tuple[int, int], longest: int) -> np.ndarray:
        """Give (n, 4, columns): the responses, their slopes, second derivatives, slopes before."""
        some = self.degrees <= choice[0]
        before = self.values[:, :, some].copy()
        before[:, 0] = self.before[:, some]
        after = self.values[:, :, some]
        slope = np.zeros_like(after)
        slope[:, 1:] = (after[:, :-1] - after[:, 1:]) / self.lag
        second = np.zeros_like(after)
        second[:, 1:] = (slope[:, :-1] - slope[:, 1:]) / self.lag
        earlier = np.zeros_like(after)
        earlier[:, 1:] = (before[:, :-1] - before[:, 1:]) / self.lag
        kept = slice(1, choice[1] + 1)
        parts = [one[:, kept].reshape(len(one), -1) for one in (after, slope, second, earlier)]
        return np.stack(parts, axis=1)


def _choose(
    x: Sequence[np.ndarray],
    chains: Sequence[_Chains],
    choices: Sequence[tuple[int, int]],
    settings: ForcingSettings,
) -> tuple[tuple[int, int], np.ndarray] | None:
    """Give the products and lags, with coefficients, that leave least for their number (BIC)."""
    best, chosen = np.inf, None
    for order in settings.orders:
        some = [i for i, own in enumerate(x) if len(own) > order + 2]
        weights = [_weights(chains[i].t, order) for i in some]
        if not some:
            continue
        missed = np.concatenate(
            [_apply(w, x[i][:, None]) for w, i in zip(weights, some, strict=True)]
        )[:, 0]
        rows = len(missed)
        for columns in [None, *choices]:
            left, coefficients = missed, np.zeros(0)
            if columns is not None:
                bent = np.concatenate(
                    [
                        _apply(w, chains[i].columns(*columns))
                        for w, i in zip(weights, some, strict=True)
                    ]
                )
                if bent.shape[1] * 2 > rows:
                    continue
                unit = np.maximum(np.linalg.norm(bent, axis=0), 1e-300)
                coefficients = np.linalg.lstsq(bent / unit, missed, rcond=1e-11)[0] / unit
                left = missed - bent @ coefficients
            bits = rows * np.log(max(float(np.mean(left**2)), 1e-300)) / 2
            bits += len(coefficients) * np.log(rows) / 2
            if bits / rows < best:
                best = bits / rows
                chosen = None if columns is None else (columns, coefficients)
    return chosen


def _weights(t: np.ndarray, order: int) -> np.ndarray:
    """Weights (n - order, order + 1), of norm 1, of each row's miss from its neighbours."""
    _, weights = barycentric_weights(np.lib.stride_tricks.sliding_window_view(t, order + 1))
    found: np.ndarray = weights / np.linalg.norm(weights, axis=1, keepdims=True)
    return found


def _apply(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Misses (n - order, c) of columns (n, c) from the polynomials through neighbours."""
    windows = np.lib.stride_tricks.sliding_window_view(values, weights.shape[1], axis=0)
    return np.einsum("nw,ncw->nc", weights, windows)
