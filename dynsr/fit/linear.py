"""Best constants of many linear problems at once, by least squares that bad rows cannot rule."""

from __future__ import annotations

import numpy as np

_ROUNDS = 5
# Rows that the first rounds look at.
_START = 250


def fit_linear(design: np.ndarray, z: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """Least squares of K problems: (K, n, k) designs, (K, n) or (n,) z -> (K, k) coefficients.

    ``roots`` (K, n) or (n,) are square roots of weights. By normal equations of columns scaled to
    norm 1, with one step of iterative refinement, which brings back the digits that squaring
    the condition number lost.

    >>> x = np.linspace(0.0, 1.0, 9)
    >>> design = np.column_stack([np.ones(9), x])[None]
    >>> bool(np.allclose(fit_linear(design, 3 - 2 * x, np.ones(9)), [[3.0, -2.0]]))
    True
    """
    columns = design * np.broadcast_to(roots, design.shape[:2])[:, :, None]
    right = np.broadcast_to(z, design.shape[:2]) * roots
    norms = np.sqrt(np.einsum("kni,kni->ki", columns, columns))
    norms[norms == 0] = 1.0
    columns = columns / norms[:, None, :]
    normal = columns.transpose(0, 2, 1) @ columns
    # Equal columns share their coefficient instead of stopping the whole batch.
    normal += 1e-14 * np.eye(design.shape[2])
    found = np.zeros((len(design), design.shape[2]))
    for _ in range(2):
        rest = right[:, :, None] - columns @ found[:, :, None]
        moments = columns.transpose(0, 2, 1) @ rest
        found = found + np.linalg.solve(normal, moments)[:, :, 0]
    return found / norms


def fit_robustly(design: np.ndarray, z: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Fit with Cauchy weights 1 / (1 + (r / s)^2), s twice the median of |r|, found by iteration.

    ``scales`` (n,) turn residuals of z into residuals of y. Slopes of trajectories carry a few
    large errors among many small ones; these weights leave them out. All rounds but the last two
    look at some hundred evenly spaced rows alone.
    """
    step = max(1, design.shape[1] // _START)
    few = slice(None, None, step)
    z = np.broadcast_to(z, design.shape[:2])
    start = np.broadcast_to(scales, design.shape[:2])[:, few]
    found = _reweight(design[:, few], z[:, few], scales[few], start, _ROUNDS - 1)
    if step == 1:
        return found
    return _reweight(design, z, scales, _weigh(design, z, scales, found), 1)


def _reweight(
    design: np.ndarray, z: np.ndarray, scales: np.ndarray, roots: np.ndarray, rounds: int
) -> np.ndarray:
    """Fit, and ``rounds`` times more with weights from the residuals of the fit before."""
    found = fit_linear(design, z, roots)
    for _ in range(rounds):
        found = fit_linear(design, z, _weigh(design, z, scales, found))
    return found


def _weigh(design: np.ndarray, z: np.ndarray, scales: np.ndarray, found: np.ndarray) -> np.ndarray:
    """(K, n) roots of the Cauchy weights of a fit's residuals."""
    rest = np.abs(z - (design @ found[:, :, None])[:, :, 0]) * scales
    size = _medians(np.abs(z * scales))
    middle = np.maximum(2 * _medians(rest), 1e-13 * size + 1e-300)
    return scales / np.sqrt(1 + (rest / middle) ** 2)


def _medians(values: np.ndarray) -> np.ndarray:
    """(K, 1) upper medians of rows."""
    half = values.shape[1] // 2
    return np.partition(values, half, axis=1)[:, half : half + 1]
