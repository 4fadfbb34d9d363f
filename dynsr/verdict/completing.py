"""Completing: what censored cells may have been, so that residuals can be tested as if measured.

Of rows near a limit only errors to one side were measured: their residuals have no mean of 0, and
look like those of a wrong law. Where each censored cell is drawn from what the fitted law says of a
value beyond the limit, all residuals together are those of a complete table, if the law is right
(randomised quantile residuals: Dunn and Smyth 1996, *J. Comput. Graph. Stat.* 5, 236). A curve on
the wrong side of a limit gets a draw at the limit, and so a residual as large as it misses it by.
Constants and intervals are those of the likelihood; no draw is in them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy
from scipy.special import log_ndtr, ndtri_exp

from dynsr.data import Trajectory, carry, estimate_noise
from dynsr.fit import AlongFit, Measurements, fit_along


def complete_cells(
    equations: Mapping[str, sympy.Expr],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    noise: Sequence[np.ndarray] | None,
    rows: int,
) -> tuple[list[Trajectory], Sequence[np.ndarray] | None]:
    """Give runs whose censored cells are draws, with the noise of these; others stay as they are.

    Parameters
    ----------
    equations : state -> right-hand side.
    runs, inputs : the data.
    noise : for each run (n, k) standard deviations of the noise; None where they are not known.
        States without any stay as they are, too.
    rows : of more rows than this in all, evenly spaced ones are fitted.
    """
    names = [
        state
        for state in equations
        if any(state in run.limits and state not in run.sums for run in runs)
        and (noise is None or any(_is_noisy(own[:, runs[0].index(state)]) for own in noise))
    ]
    data = Measurements.of(runs, inputs, rows) if names else None
    fit = fit_along(equations, data) if data is not None and len(data.runs) == len(runs) else None
    if fit is None or data is None:
        return list(runs), noise
    along = data.along(fit.found.states, tuple(equations)).smoothed
    rng, sizes = np.random.default_rng(0), _sizes(fit)
    whole = []
    for run, curve in zip(runs, along, strict=True):
        x, gaps, limits = run.x.copy(), ~run.measured, dict(run.limits)
        for state in [s for s in names if s in run.limits]:
            place, own = run.index(state), limits.pop(state)
            cells = np.flatnonzero(own.known)
            middle = np.interp(run.t, curve.t, curve.x[:, place])[cells]
            sd = own.side[cells] * sizes[state]
            # A uniform share of the probability beyond the limit, which may be next to nothing.
            shares = np.log1p(-rng.random(len(cells))) + log_ndtr((own.level[cells] - middle) / sd)
            x[cells, place] = middle + sd * ndtri_exp(shares)
            gaps[cells, place] = False
        whole.append(replace(run, x=x, unmeasured=gaps, limits=limits))
    if noise is None:
        return whole, None
    laws, found = estimate_noise(carry(whole)), []
    for run, given in zip(whole, noise, strict=True):
        level = np.array(np.broadcast_to(given, run.x.shape))
        for state in names:
            place = run.index(state)
            level[:, place] = laws[place].sd(run.x[:, place])
        found.append(level)
    return whole, found


def _is_noisy(noise: np.ndarray) -> bool:
    return bool(np.any(np.isfinite(noise) & (noise > 0)))


def _sizes(fit: AlongFit) -> dict[str, float]:
    """State -> the noise that a fit has at the censored cells, their median."""
    mesh = fit.problem.mesh
    assert mesh.censored is not None
    states, sd = mesh.censored.places[0], 1 / np.abs(mesh.censored.sure)
    return {
        name: float(np.median(sd[states == i])) for i, name in enumerate(mesh.states) if i in states
    }
