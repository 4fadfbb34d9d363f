"""Robust Levenberg-Marquardt for multiple shooting: shared constants, own starts a window.

The normal equations have the shape of an arrow, one block a window, so the starts are eliminated
window by window (Schur complement; Bock 1981) and a step costs as much as the sensitivities do.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynsr.methods.flow import Flow, Windows

# loss -> (rho(z), rho'(z)) of the squared residual z in units of the misses.
LOSSES: dict[str, tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]] = {
    "linear": (lambda z: z, np.ones_like),
    "soft_l1": (lambda z: 2 * (np.sqrt(1 + z) - 1), lambda z: 1 / np.sqrt(1 + z)),
    "cauchy": (np.log1p, lambda z: 1 / (1 + z)),
}
# A relative gain below this is less than the constants' own uncertainty.
_GAIN = 1e-6


@dataclass(frozen=True, eq=False)
class Normal:
    """Weighted normal equations: ``shared`` (P, P), ``cross`` (W, P, k), ``own`` (W, k, k).

    ``pull`` (P,) and ``own_pull`` (W, k) are the gradients. Without free starts k is 0.
    """

    shared: np.ndarray
    cross: np.ndarray
    own: np.ndarray
    pull: np.ndarray
    own_pull: np.ndarray

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Solve with the diagonal raised by the share ``damping``: (P,) and (W, k)."""
        own = self.own + damping * _diagonal(self.own)
        eliminated = np.linalg.solve(own, self.cross.transpose(0, 2, 1))
        centre = self.shared + damping * _diagonal(self.shared)
        schur = centre - np.einsum("wpk,wkq->pq", self.cross, eliminated)
        alone = np.linalg.solve(own, self.own_pull[..., None])[..., 0]
        constants = np.linalg.solve(schur, self.pull - np.einsum("wpk,wk->p", self.cross, alone))
        return -constants, -(alone - eliminated @ constants)


def _diagonal(blocks: np.ndarray) -> np.ndarray:
    diagonal = np.einsum("...ii->...i", blocks)
    floor = 1e-12 * np.max(diagonal, axis=-1, keepdims=True, initial=1e-300)
    return np.maximum(diagonal, floor)[..., None] * np.eye(blocks.shape[-1])


@dataclass(frozen=True, eq=False)
class Shooting:
    """Misses of a flow at the rows of all windows, in units of each state's ``spread``.

    With ``free`` starts each window begins at a fitted state and is compared with its own first
    measurement too; otherwise it begins at that measurement.
    """

    flow: Flow
    windows: Windows
    spread: np.ndarray
    free: bool
    substeps: int = 1

    def misses(self, constants: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """(rows, k, W) found minus measured; NaN where the flow diverges."""
        found = self.flow.run(self.windows, starts, constants, self.substeps)
        return self._compare(found)

    def _compare(self, found: np.ndarray) -> np.ndarray:
        return ((found - self.windows.x) / self.spread[:, None])[0 if self.free else 1 :]

    def linearise(
        self, constants: np.ndarray, starts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Misses, their slopes by the constants (W, rows * k, P) and by the starts (.., k or 0)."""
        found, sensitivity = self.flow.run_sensitive(self.windows, starts, constants, self.substeps)
        slopes = (sensitivity / self.spread[:, None, None])[0 if self.free else 1 :]
        lanes = slopes.transpose(3, 0, 1, 2).reshape(starts.shape[1], -1, slopes.shape[2])
        count = len(constants)
        return self._compare(found), lanes[..., :count], lanes[..., count if self.free else None :]

    def unit(self, misses: np.ndarray) -> np.ndarray:
        """(k,) robust size of the misses of every state, never below rounding."""
        return np.maximum(1.4826 * np.median(np.abs(misses), axis=(0, 2)), 1e-13)

    def minimise(
        self,
        constants: np.ndarray,
        starts: np.ndarray,
        loss: str,
        deadline: float,
        most: int = 25,
        gain: float = _GAIN,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fit constants (P,) and starts (k, W), misses weighed in units of their present size.

        Ends after ``most`` steps, or when one lowers the loss by less than the share ``gain``.
        """
        rho, weigh = LOSSES[loss]
        misses = self.misses(constants, starts)
        unit = self.unit(misses)[:, None]
        level, damping = _level(rho, misses / unit), 1e-4
        for _ in range(most):
            misses, by_constant, by_start = self.linearise(constants, starts)
            weights = weigh((misses / unit) ** 2) / unit**2
            try:
                normal = _normal(_by_lane(misses), by_constant, by_start, _by_lane(weights))
            except FloatingPointError:
                break
            before = level
            while damping < 1e8 and time.monotonic() < deadline:
                trial = self._try(normal, damping, constants, starts)
                reached = np.inf if trial is None else _level(rho, self.misses(*trial) / unit)
                if trial is not None and reached < level:
                    (constants, starts), level, damping = trial, reached, damping / 10
                    break
                damping *= 10
            if not level < before * (1 - gain):
                break
        return constants, starts

    def _try(
        self, normal: Normal, damping: float, constants: np.ndarray, starts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        try:
            shared, own = normal.step(damping)
        except np.linalg.LinAlgError:
            return None
        if not self.free:
            return constants + shared, starts
        return constants + shared, starts + own.T

    def standard_errors(self, constants: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """(P,) sandwich estimate; without free starts the misses of one window hang together."""
        misses, by_constant, by_start = self.linearise(constants, starts)
        unit = self.unit(misses)[:, None]
        weights = _by_lane(1 / (1 + (misses / unit) ** 2) / unit**2)
        flat = _by_lane(misses)
        normal = _normal(flat, by_constant, by_start, weights)
        if self.free:
            eliminated = np.linalg.solve(
                normal.own + 1e-12 * _diagonal(normal.own), normal.cross.transpose(0, 2, 1)
            )
            by_constant = by_constant - by_start @ eliminated
        # Columns of like size keep the pseudo-inverse from dropping a small constant.
        scale = np.sqrt(np.einsum("wrp,wr,wrp->p", by_constant, weights, by_constant))
        scaled = by_constant / np.maximum(scale, 1e-300)
        bread = np.linalg.pinv(np.einsum("wrp,wr,wrq->pq", scaled, weights, scaled))
        pulls = scaled * (weights * flat)[..., None]
        if not self.free and len(pulls) > len(constants):
            pulls = pulls.sum(axis=1, keepdims=True)
        rows = pulls.reshape(-1, pulls.shape[-1])
        variance = np.diag(bread @ (rows.T @ rows) @ bread)
        return np.sqrt(np.maximum(variance, 0)) / np.maximum(scale, 1e-300)


def _by_lane(values: np.ndarray) -> np.ndarray:
    """(rows, k, W) -> (W, rows * k)."""
    return values.transpose(2, 0, 1).reshape(values.shape[2], -1)


def _level(rho: Callable[..., np.ndarray], misses: np.ndarray) -> float:
    with np.errstate(all="ignore"):
        level = float(np.sum(rho(misses**2)))
    return level if np.isfinite(level) else np.inf


def _normal(
    misses: np.ndarray, by_constant: np.ndarray, by_start: np.ndarray, weights: np.ndarray
) -> Normal:
    """Build the normal equations; raises FloatingPointError where a slope is not finite."""
    weighted = by_constant * weights[..., None]
    own = by_start * weights[..., None]
    normal = Normal(
        np.tensordot(weighted, by_constant, axes=([0, 1], [0, 1])),
        weighted.transpose(0, 2, 1) @ by_start,
        own.transpose(0, 2, 1) @ by_start,
        np.einsum("wrp,wr->p", weighted, misses),
        np.einsum("wrk,wr->wk", own, misses),
    )
    if not (np.all(np.isfinite(normal.shared)) and np.all(np.isfinite(normal.own))):
        raise FloatingPointError
    return normal
