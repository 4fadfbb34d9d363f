"""Best constants of many linear problems at once, by least squares that bad rows cannot rule."""

from __future__ import annotations

import numpy as np

_ROUNDS = 5


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
        rest = right - np.einsum("kni,ki->kn", columns, found)
        moments = np.einsum("kni,kn->ki", columns, rest)
        found = found + np.linalg.solve(normal, moments[:, :, None])[:, :, 0]
    return found / norms


def fit_robustly(design: np.ndarray, z: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Fit with Cauchy weights 1 / (1 + (r / s)^2), s twice the median of |r|, found by iteration.

    ``scales`` (n,) turn residuals of z into residuals of y. Slopes of trajectories carry a few
    large errors among many small ones; these weights leave them out.
    """
    roots = np.broadcast_to(scales, design.shape[:2])
    size = _medians(np.abs(np.broadcast_to(z, roots.shape) * scales))
    for _ in range(_ROUNDS):
        found = fit_linear(design, z, roots)
        rest = np.abs(z - np.einsum("kni,ki->kn", design, found)) * scales
        middle = np.maximum(2 * _medians(rest), 1e-13 * size + 1e-300)
        roots = scales / np.sqrt(1 + (rest / middle) ** 2)
    return found


def _medians(values: np.ndarray) -> np.ndarray:
    """(K, 1) upper medians of rows."""
    half = values.shape[1] // 2
    return np.partition(values, half, axis=1)[:, half : half + 1]
