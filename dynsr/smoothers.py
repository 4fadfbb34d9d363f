"""Smoothers of one column: values and slopes by local polynomials, splines or differences."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.interpolate import make_smoothing_spline

from dynsr.errors import InputError
from dynsr.samples import derivative_weights

CENTRAL = ("central2", "central4", "central6", "central8")
# Schemes that leave the values as they are.
DIFFERENCES = ("forward", "backward", *CENTRAL)
_SAVGOL = re.compile(r"savgol\((\d+),(\d+)\)")
_MAD = 1.4826


@dataclass(frozen=True, eq=False)
class Smooth:
    """One column made smooth: which rows are left, and the values and slopes there."""

    rows: slice
    x: np.ndarray
    slope: np.ndarray


def interpolation_residuals(t: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
    """Miss of each point from the polynomial through its ``order`` neighbours, per unit noise."""
    half = order // 2
    nodes = np.lib.stride_tricks.sliding_window_view(t, order + 1)
    values = np.lib.stride_tricks.sliding_window_view(x, (order + 1), axis=0)
    gaps = nodes[:, :, None] - nodes[:, None, :]
    diagonal = np.arange(order + 1)
    gaps[:, diagonal, diagonal] = 1.0
    weights = 1.0 / np.prod(gaps / np.abs(gaps).max(axis=(1, 2), keepdims=True), axis=2)
    weights /= weights[:, [half]]
    misses = np.einsum("ij,i...j->i...", weights, values)
    norm = np.linalg.norm(weights, axis=1)
    return misses / norm.reshape(-1, *[1] * (x.ndim - 1))


def local_polynomial(t: np.ndarray, window: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (rows, window) for value and slope at the middle of every window of times."""
    nodes = np.lib.stride_tricks.sliding_window_view(t, window)
    steps = np.diff(t)
    if np.ptp(steps) <= 1e-6 * steps.mean():
        nodes = nodes[:1]
    offset = nodes - nodes[:, [window // 2]]
    scale = np.abs(offset).max(axis=1, keepdims=True)
    # Legendre polynomials keep the normal equations well conditioned up to degree 6.
    basis = legendre.legvander(offset / scale, degree)
    gram = np.einsum("nwi,nwj->nij", basis, basis)
    at_middle = np.stack([legendre.legvander(np.zeros(1), degree)[0], _legendre_slopes(degree)])
    picked = np.linalg.solve(gram, np.broadcast_to(at_middle.T, (len(gram), degree + 1, 2)))
    weights = np.einsum("nwi,nik->knw", basis, picked)
    return weights[0], weights[1] / scale


def _legendre_slopes(degree: int) -> np.ndarray:
    """Slope of every Legendre polynomial up to a degree, at 0."""
    slopes = [legendre.Legendre.basis(j).deriv()(0.0) if j else 0.0 for j in range(degree + 1)]
    return np.array(slopes)


def _savgol(t: np.ndarray, x: np.ndarray, window: int, degree: int) -> Smooth:
    """Fit a polynomial around every time (Savitzky and Golay 1964; here on any grid)."""
    value, slope = local_polynomial(t, window, degree)
    windows = np.lib.stride_tricks.sliding_window_view(x, window)
    half = window // 2
    if len(value) == 1:
        values, slopes = windows @ value[0], windows @ slope[0]
    else:
        values = np.einsum("ij,ij->i", value, windows)
        slopes = np.einsum("ij,ij->i", slope, windows)
    return Smooth(slice(half, len(t) - half), values, slopes)


def _spline(t: np.ndarray, x: np.ndarray) -> Smooth:
    """Cubic smoothing spline, strength by generalised cross-validation (Woltring 1986)."""
    # The search for the strength is on a log scale around 1 for unit steps and unit values.
    step, scale = float(np.mean(np.diff(t))), float(np.std(x)) or 1.0
    spline = make_smoothing_spline((t - t[0]) / step, x / scale)
    # The ends of a smoothing spline are its worst part.
    cut = max(1, min(len(t) // 50, 20))
    rows = slice(cut, len(t) - cut)
    at = (t[rows] - t[0]) / step
    return Smooth(rows, spline(at) * scale, spline.derivative()(at) * scale / step)


def _total_variation(t: np.ndarray, x: np.ndarray) -> Smooth:
    """Slope of least total variation, by the library ``derivative`` (Tibshirani 2014)."""
    try:
        import derivative
    except ImportError:
        raise InputError(
            "scheme 'total-variation' needs the package derivative; run: pip install derivative"
        ) from None
    scale = float(np.std(x)) or 1.0
    misses = interpolation_residuals(t, x[:, None] / scale, 2)
    alpha = max(float(_MAD * np.median(np.abs(misses))) ** 2, 1e-10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        slope = scale * derivative.dxdt(x / scale, t, kind="trend_filtered", order=1, alpha=alpha)
    integral = np.concatenate([[0.0], np.cumsum(np.diff(t) * (slope[1:] + slope[:-1]) / 2)])
    values = integral + np.mean(x - integral)
    cut = max(1, len(t) // 50)
    rows = slice(cut, len(t) - cut)
    return Smooth(rows, values[rows], slope[rows])


def central_weights(t: np.ndarray, order: int) -> np.ndarray:
    """Weights (rows, order + 1) of the central difference of that order at every inner time."""
    nodes = np.lib.stride_tricks.sliding_window_view(t, order + 1)
    return derivative_weights(nodes - nodes[:, [order // 2]], order // 2)


def _central(t: np.ndarray, x: np.ndarray, order: int) -> Smooth:
    windows = np.lib.stride_tricks.sliding_window_view(x, order + 1)
    slope = np.einsum("ij,ij->i", central_weights(t, order), windows)
    rows = slice(order // 2, len(t) - order // 2)
    return Smooth(rows, x[rows], slope)


def _one_sided(t: np.ndarray, x: np.ndarray, scheme: str) -> Smooth:
    rows = slice(0, len(t) - 1) if scheme == "forward" else slice(1, len(t))
    return Smooth(rows, x[rows], np.diff(x) / np.diff(t))


def smooth_column(t: np.ndarray, x: np.ndarray, scheme: str) -> Smooth:
    """Differentiate one column by a named scheme.

    ``scheme`` is "forward", "backward", "central2" to "central8", "savgol(WINDOW,DEGREE)", "spline"
    or "total-variation". Raises InputError on any other name.

    >>> t = np.linspace(0.0, 1.0, 21)
    >>> bool(np.allclose(smooth_column(t, t**2, "savgol(5,2)").slope, 2 * t[2:-2]))
    True
    """
    if scheme == "spline":
        return _spline(t, x)
    if scheme == "total-variation":
        return _total_variation(t, x)
    if scheme in ("forward", "backward"):
        return _one_sided(t, x, scheme)
    if scheme in CENTRAL:
        return _central(t, x, int(scheme.removeprefix("central")))
    if match := _SAVGOL.fullmatch(scheme):
        return _savgol(t, x, int(match[1]), int(match[2]))
    known = ", ".join([*DIFFERENCES, "savgol(WINDOW,DEGREE)", "spline", "total-variation"])
    raise InputError(f"unknown scheme {scheme!r}; the schemes are: {known}")
