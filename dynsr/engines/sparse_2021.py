"""Sparse regression as DataDrivenDiffEq.jl 0.5 did it in spring 2021, when the paper was written.

SR3 and ADMM with their least-squares start, fixed thresholds on normalised coefficients and stop
at machine precision, and the implicit search over every left-hand side (SINDy-PI, Kaheman et al.
2020). Every problem of a stack is iterated in the same product and frozen when it stops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynsr.engines.stack import EPSILON, Stack

Solver = Callable[[Stack, int], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class SR3:
    """Sparse relaxed regularised regression with an L1 penalty (Zheng et al. 2018).

    X = (A'A + I/nu)^-1 (A'y + W/nu), then W = soft(X, tau nu lambda), with
    tau = sqrt(2 lambda / nu). The answer is X, its entries below tau set to zero.
    """

    weight: float
    nu: float = 1.0

    @classmethod
    def at_threshold(cls, threshold: float, nu: float) -> SR3:
        """Settings whose tau is the threshold: lambda = threshold^2 nu / 2."""
        return cls(threshold**2 * nu / 2, nu)

    @property
    def threshold(self) -> float:
        """Coefficients of smaller magnitude than this become zero."""
        return float(np.sqrt(2 * self.weight / self.nu))

    def iterate(self, stack: Stack, cap: int) -> tuple[np.ndarray, np.ndarray]:
        """Give the (k, n) coefficients and the k iteration counts."""
        width = self.threshold * self.nu * self.weight
        resolvent = stack.resolvent(1 / self.nu)
        w = stack.start()
        answer, counts = np.zeros_like(w), np.full(len(w), cap)
        right, active = stack.correlation, np.arange(len(w))
        x, new, work = np.empty_like(w), np.empty_like(w), np.empty_like(w)
        for iteration in range(1, cap + 1):
            np.multiply(w, 1 / self.nu, out=new)
            np.add(new, right, out=new)
            resolvent.apply(new, x, work)
            _soft(x, width, new, work)
            stopped = _distances(w, new, work) / self.nu < EPSILON
            w, new = new, w
            if stopped.any():
                answer[active[stopped]] = x[stopped]
                counts[active[stopped]] = iteration
                keep = ~stopped
                active, right, x, w = active[keep], right[keep], x[keep], w[keep]
                if not active.size:
                    break
                resolvent = resolvent.select(np.flatnonzero(keep))
                new, work = np.empty_like(w), np.empty_like(w)
        answer[active] = x
        return np.where(np.abs(answer) < self.threshold, 0.0, answer), counts


@dataclass(frozen=True)
class ADMM:
    """Lasso by the alternating direction method of multipliers (Boyd et al. 2011).

    x = (A'A + rho I)^-1 (A'y + rho X - u), X = soft(x + u/rho, tau), u += rho (x - X), with
    tau = lambda / rho. The answer is X, its entries below tau set to zero.
    """

    weight: float
    rho: float = 1.0

    @classmethod
    def at_threshold(cls, threshold: float, rho: float) -> ADMM:
        """Settings whose tau is the threshold: lambda = threshold rho."""
        return cls(threshold * rho, rho)

    @property
    def threshold(self) -> float:
        """Coefficients of smaller magnitude than this become zero."""
        return self.weight / self.rho

    def iterate(self, stack: Stack, cap: int) -> tuple[np.ndarray, np.ndarray]:
        """Give the (k, n) coefficients and the k iteration counts."""
        resolvent = stack.resolvent(self.rho)
        x = stack.start()
        answer, counts = np.zeros_like(x), np.full(len(x), cap)
        right, active = stack.correlation, np.arange(len(x))
        u, inner, new, work = np.zeros_like(x), np.empty_like(x), np.empty_like(x), np.empty_like(x)
        for iteration in range(1, cap + 1):
            np.multiply(x, self.rho, out=new)
            np.subtract(new, u, out=new)
            np.add(new, right, out=new)
            resolvent.apply(new, inner, work)
            np.divide(u, self.rho, out=u)
            np.add(u, inner, out=u)
            _soft(u, self.threshold, new, work)
            # u/rho + x - X is the new u/rho.
            np.subtract(u, new, out=u)
            np.multiply(u, self.rho, out=u)
            stopped = _distances(x, new, work) < EPSILON
            x, new = new, x
            if stopped.any():
                answer[active[stopped]] = x[stopped]
                counts[active[stopped]] = iteration
                keep = ~stopped
                active, right, x, u = active[keep], right[keep], x[keep], u[keep]
                if not active.size:
                    break
                resolvent = resolvent.select(np.flatnonzero(keep))
                new, inner, work = np.empty_like(x), np.empty_like(x), np.empty_like(x)
        answer[active] = x
        return np.where(np.abs(answer) < self.threshold, 0.0, answer), counts


def _soft(x: np.ndarray, width: float, out: np.ndarray, work: np.ndarray) -> None:
    np.minimum(x, width, out=work)
    np.maximum(work, -width, out=work)
    np.subtract(x, work, out=out)


def _distances(a: np.ndarray, b: np.ndarray, work: np.ndarray) -> np.ndarray:
    np.subtract(a, b, out=work)
    return np.sqrt(np.einsum("ij,ij->i", work, work))
