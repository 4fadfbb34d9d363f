"""Peers: pysindy's STLSQ and weak SINDy, each tuned on the trajectory that it is given.

Of many settings (libraries, thresholds, smoothers or widths of test functions) the one is chosen
whose equations, integrated, explain the measured trajectory best; of those that come within 0.005
of its R2, the one with the fewest terms. The truth and the unseen start play no part.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from scipy.integrate import odeint
from scipy.signal import savgol_filter

from dynsr.benchmarks.zoo.scoring import Answer
from dynsr.data import Trajectory
from dynsr.errors import need
from dynsr.expression import compile_scalar, parse
from dynsr.fit import r_squared

_THRESHOLDS = np.geomspace(1e-3, 1.0, 10)
# A small ridge keeps columns that are nearly alike from cancelling each other.
_RIDGE = 1e-6
_WINDOWS = (5, 9, 17, 33, 65)
_ORDER = 3
_WIDTHS = (0.025, 0.05, 0.1, 0.2)
_DOMAINS = 200
_TIE = 0.005
_MOST_CALLS, _FAR = 6000, 20.0
# What odeint says of an integration that went well.
_DONE = "Integration successful"


@dataclass(frozen=True, eq=False)
class _Library:
    """Columns of all libraries, once; each library is a choice of them."""

    features: tuple[sympy.Expr, ...]
    choices: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class _Model:
    """Coefficients (k, p) of the features, and where its integration begins."""

    coefficients: np.ndarray
    start: np.ndarray

    @property
    def terms(self) -> int:
        return int(np.count_nonzero(self.coefficients))


def answer_stlsq(data: Trajectory, seed: int = 0) -> Answer:
    """Find equations by sequentially thresholded least squares (Brunton et al. 2016).

    Slopes are finite differences, of the data and of Savitzky-Golay smooths of several windows;
    rows that are not evenly spaced are first brought to even times.

    Parameters
    ----------
    data : the trajectory.
    seed : no chance is used.

    Raises MissingExtra when pysindy is not installed.
    """
    need("pysindy", "pysindy", "a peer of the zoo")
    import pysindy

    library, function = _make_library(pysindy, len(data.states))
    models = []
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        for t, x, order in _smooths(data):
            slopes = np.asarray(pysindy.FiniteDifference(order=order)(x, t))
            theta = np.asarray(function.fit_transform(x))
            models += [_Model(c, x[0]) for c in _fits(pysindy, library, theta, slopes)]
        return _best(models, library, data)


def answer_weak(data: Trajectory, seed: int = 0) -> Answer:
    """Find equations by weak SINDy (Messenger and Bortz 2021, as in pysindy).

    Parameters
    ----------
    data : the trajectory.
    seed : what the places of the test functions are drawn from.

    Raises MissingExtra when pysindy is not installed.
    """
    need("pysindy", "pysindy", "a peer of the zoo")
    import pysindy

    library, function = _make_library(pysindy, len(data.states))
    models = []
    with warnings.catch_warnings(), np.errstate(all="ignore"), _seeded(seed):
        warnings.simplefilter("ignore")
        for theta, slopes in _weak_forms(pysindy, function, data):
            models += [_Model(c, data.x[0]) for c in _fits(pysindy, library, theta, slopes)]
        return _best(models, library, data)


class _seeded:  # noqa: N801 (a context, as a function would be)
    """Seed NumPy's global generator, from which pysindy draws, and leave it as it was."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def __enter__(self) -> None:
        self._state = np.random.get_state()  # noqa: NPY002 (pysindy's own)
        np.random.seed(self._seed)  # noqa: NPY002

    def __exit__(self, *error: object) -> None:
        np.random.set_state(self._state)  # noqa: NPY002


def _make_library(pysindy: Any, states: int) -> tuple[_Library, Any]:
    """Make the library of all columns: 1, polynomials to degree 3, sines and cosines.

    The choices are polynomials of degree 1 to 3, and degree 2 with sines and cosines, each with
    and without the constant.
    """
    polynomial = pysindy.PolynomialLibrary(3, include_bias=True)
    function = pysindy.ConcatLibrary([polynomial, pysindy.FourierLibrary(n_frequencies=1)])
    function.fit_transform(np.ones((4, states)))
    names = [name.replace(" ", "*") for name in function.get_feature_names()]
    features = tuple(parse(name) for name in names)
    wave = np.array([f.has(sympy.sin, sympy.cos) for f in features])
    degree = np.array(
        [0 if w else sympy.total_degree(f) for w, f in zip(wave, features, strict=True)]
    )
    sets = [(~wave & (degree <= d)) for d in (1, 2, 3)] + [wave | (degree <= 2)]
    constant = ~wave & (degree == 0)
    choices = [
        np.flatnonzero(s & ~without) for s in sets for without in (constant, 0 * constant > 0)
    ]
    return _Library(features, tuple(choices)), function


def _smooths(data: Trajectory) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """Give times, states and the order of differences: as measured, and smoothed on even times."""
    yield data.t, data.x, 2
    yield data.t, data.x, 4
    even = np.linspace(data.t[0], data.t[-1], len(data))
    x = np.column_stack([np.interp(even, data.t, column) for column in data.x.T])
    for window in _WINDOWS:
        if _ORDER < window <= len(data) // 2:
            yield even, savgol_filter(x, window, _ORDER, axis=0), 2


def _weak_forms(
    pysindy: Any, function: Any, data: Trajectory
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Give the integrals of all columns and of the slopes, for several widths of test functions."""
    span = data.t[-1] - data.t[0]
    for width in _WIDTHS:
        half = max(width * span, 3 * float(np.diff(data.t).max()))
        if half >= 0.45 * span:
            continue
        weak = pysindy.WeakPDELibrary(
            function_library=function,
            spatiotemporal_grid=data.t,
            K=_DOMAINS,
            H_xt=half,
            p=4,
        )
        x = pysindy.AxesArray(data.x, {"ax_time": 0, "ax_coord": 1})
        yield np.asarray(weak.fit_transform([x])[0]), np.asarray(weak.convert_u_dot_integral(x))


def _fits(
    pysindy: Any, library: _Library, theta: np.ndarray, slopes: np.ndarray
) -> Iterator[np.ndarray]:
    """Give the coefficients (k, p) of every library and threshold; each choice of terms once."""
    seen = set()
    for choice in library.choices:
        for threshold in _THRESHOLDS:
            optimizer = pysindy.STLSQ(threshold=threshold, alpha=_RIDGE)
            try:
                found = optimizer.fit(theta[:, choice], slopes).coef_
            except (ValueError, np.linalg.LinAlgError):
                continue
            whole = np.zeros((slopes.shape[1], len(library.features)))
            whole[:, choice] = found
            key = (whole != 0).tobytes()
            if key not in seen and np.isfinite(whole).all():
                seen.add(key)
                yield whole


def _best(models: Sequence[_Model], library: _Library, data: Trajectory) -> Answer:
    """Give the model that explains the data best, of those about as good the shortest."""
    names = [f"x{i}" for i in range(len(data.states))]
    evaluate = compile_scalar(library.features, names)
    scored = [(r_squared(data.x, _integrate(m, evaluate, data)), m) for m in models]
    if not scored:
        return Answer({}, failure="no settings gave a model")
    most = max(score for score, _ in scored)
    chosen = min((m.terms, -s, i) for i, (s, m) in enumerate(scored) if s >= most - _TIE)
    return Answer(_write(scored[chosen[2]][1], library, names, data.states))


def _write(
    model: _Model, library: _Library, names: Sequence[str], states: Sequence[str]
) -> dict[str, sympy.Expr]:
    own = {sympy.Symbol(n): sympy.Symbol(s) for n, s in zip(names, states, strict=True)}
    return {
        state: sympy.Add(
            *(sympy.Float(c) * f for c, f in zip(row, library.features, strict=True) if c)
        ).xreplace(own)
        for state, row in zip(states, model.coefficients, strict=True)
    }


class _Lost(Exception):
    """An integration left the region of the data, or takes too many steps."""


def _integrate(model: _Model, evaluate: Any, data: Trajectory) -> np.ndarray:
    """Integrate a model over the times of the data; NaN where it goes astray."""
    used = np.flatnonzero(model.coefficients.any(axis=0))
    weights = model.coefficients[:, used]
    low, high = data.x.min(axis=0), data.x.max(axis=0)
    reach = _FAR * (high - low) + np.abs(low) + np.abs(high)
    calls = 0

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls > _MOST_CALLS or not np.all(np.abs(x) < reach):
            raise _Lost
        features = np.array(evaluate(*x.tolist()), dtype=float)
        return weights @ features[used]

    try:
        found, notes = odeint(
            slope, model.start, data.t, rtol=1e-6, atol=1e-8, tfirst=True, full_output=True
        )
    except (_Lost, OverflowError, ValueError):
        return np.full(data.x.shape, np.nan)
    return found if notes["message"].startswith(_DONE) else np.full(data.x.shape, np.nan)
