"""A Gaussian process on one column: values and slopes with their uncertainty, on any grid.

The process is written in cosines of the (warped) time, whose coefficients are independent normal
variables with variances that fall like the spectral density of a Matern kernel (Solin and Sarkka
2020, "Hilbert space methods for reduced-rank Gaussian process regression"). One small matrix then
has all that the rows say, so that thousands of rows cost as little as hundreds, and the marginal
likelihood has a gradient in closed form. Amplitude, length scale and smoothness of the kernel, and
a factor on the noise that was estimated before, are those of greatest marginal likelihood.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, lapack, solve_triangular
from scipy.optimize import minimize

# Half the length of the interval on which the cosines live; the rows lie on [-1, 1]. Closer ends
# would force the slope to 0 there, more distant ones need more cosines.
_REACH = 1.4
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class ProcessSettings:
    """Bounds of a Gaussian process and of the search for its kernel.

    Parameters
    ----------
    cosines : most cosines used; each cycle of the motion takes about three.
    scales : length scales from which the search starts, as shares of half the record.
    roughness : least and greatest power of the spectral density; 3 is Matern-5/2, from about 20
        on it is a squared exponential.
    known : relative standard error that the estimated noise is taken to have with 1 row; it falls
        with the square root of the rows.
    finest : noise is never taken to be less than this share of the spread of the values, which
        bounds the condition of the equations.
    steps : most steps of a search for the kernel.
    negligible : variances that the rows determine by less than this share are left out.
    """

    cosines: int = 400
    scales: tuple[float, ...] = (0.02, 0.07, 0.2, 0.6)
    roughness: tuple[float, float] = (2.5, 20.0)
    known: float = 2.0
    finest: float = 1e-6
    steps: int = 25
    negligible: float = 1e-3


@dataclass(frozen=True, eq=False)
class Process:
    """A Gaussian process fitted to the rows of one column.

    Parameters
    ----------
    value, slope : (n,) posterior means at the rows; slopes per unit of the time given.
    value_sd, slope_sd : (n,) their standard deviations.
    evidence : logarithm of the marginal likelihood of the rows.
    left_out : (n,) miss of each row from the process fitted to all others, in standard deviations
        of that prediction.
    factor : by how much the noise was found to be larger than was said.
    kernel : the hyperparameters found: log variance, log length scale, log power, log of the
        squared factor on the noise.
    at : gives (4, m) value, slope and the standard deviations of both at m warped times, where no
        row needs to be, from ds/dt there.
    """

    value: np.ndarray
    slope: np.ndarray
    value_sd: np.ndarray
    slope_sd: np.ndarray
    evidence: float
    left_out: np.ndarray
    factor: float
    kernel: np.ndarray
    at: Callable[[np.ndarray, np.ndarray], np.ndarray]


class _Problem:
    """The rows of one column in cosines of a warped time."""

    def __init__(
        self, s: np.ndarray, y: np.ndarray, sd: np.ndarray, settings: ProcessSettings
    ) -> None:
        self.settings = settings
        self.middle, self.spread = float(np.mean(y)), float(np.std(y)) or 1.0
        self.y = (y - self.middle) / self.spread
        self.variance = np.maximum(sd / self.spread, settings.finest) ** 2
        self.s = s
        # A row for each half cycle is the finest motion that even rows can tell.
        self.most = min(max(int(np.ceil(_REACH * len(y))), 24), settings.cosines)
        self.omega = np.pi * np.arange(1, self.most + 1) / (2 * _REACH)
        self.basis = np.empty((len(y), 0))
        self.grow(24)
        self.prior_sd = settings.known / np.sqrt(len(y)) * 2  # of the log of the squared factor

    def grow(self, count: int) -> None:
        """Build the first cosines, at least ``count``, and what the rows say of them."""
        held = self.basis.shape[1] - 2
        if held >= min(count, self.most):
            return
        count = min(max(count, 2 * held), self.most)
        self.basis = np.empty((len(self.y), count + 2))
        self.basis[:, 0], self.basis[:, 1] = 1.0, self.s
        np.cos(np.outer(self.s + _REACH, self.omega[:count]), out=self.basis[:, 2:])
        weighted = self.basis / self.variance[:, None]
        # In the order of LAPACK, which then factors in place what is made of it.
        self.gram = np.asfortranarray(self.basis.T @ weighted)
        self.moments = weighted.T @ self.y

    def terms(self, s: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """(m, count) offset, trend and cosines at warped times, and their slopes per unit of s."""
        omega = self.omega[: count - 2]
        angles = np.outer(s + _REACH, omega)
        trend = np.broadcast_to([0.0, 1.0], (len(s), 2))
        values = np.hstack([np.ones((len(s), 1)), s[:, None], np.cos(angles)])
        return values, np.hstack([trend, -omega * np.sin(angles)])

    def variances(self, kernel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Prior variances of the coefficients that matter, and gradients of their logarithms."""
        level, scale, power = kernel[0], kernel[1], np.exp(kernel[2])
        q = (self.omega * np.exp(scale)) ** 2 / (2 * power)
        logs = level - power * np.log1p(q)
        # A cosine's squares sum to about half of all weights.
        told = logs - kernel[3] + np.log(self.gram[0, 0] / 2)
        used = max(1, int(np.searchsorted(-told, -np.log(self.settings.negligible))))
        self.grow(used)
        q, logs = q[:used], logs[:used]
        share = q / (1 + q)
        # Offset and trend have a prior so wide that it says nothing.
        every, gradient = np.full(used + 2, np.log(100.0)), np.zeros((3, used + 2))
        every[2:], gradient[0, 2:] = logs, 1.0
        gradient[1, 2:] = -2 * power * share
        gradient[2, 2:] = power * (share - np.log1p(q))
        return every, gradient

    def solve(self, kernel: np.ndarray) -> tuple[np.ndarray, ...]:
        """Give roots of the variances, Cholesky factor, whitened coefficients, log gradients."""
        logs, gradient = self.variances(kernel)
        root, m = np.exp(logs / 2), len(logs)
        inner = self.gram[:m, :m] * np.exp(-kernel[3])
        inner *= root[:, None]
        inner *= root
        # Rounding must not make the matrix indefinite where noise is far below the spread.
        diagonal = np.einsum("ii->i", inner)
        diagonal += 1.0 + m * _EPS * diagonal.max()
        # Where rows are few SciPy's checks of what it is given would take longer than all else.
        factor, wrong = lapack.dpotrf(inner, lower=1, clean=1, overwrite_a=1)
        if wrong:
            raise LinAlgError("the covariance of the process is not positive definite")
        right = root * self.moments[:m] * np.exp(-kernel[3])
        return root, factor, lapack.dpotrs(factor, right, lower=1)[0], gradient

    def loss(self, kernel: np.ndarray) -> tuple[float, np.ndarray]:
        """Negative log marginal likelihood (with the noise factor's prior), and its gradient."""
        root, factor, white, gradient = self.solve(kernel)
        m, noise = len(root), self.variance * np.exp(kernel[3])
        misses = self.y - self.basis[:, :m] @ (root * white)
        fit = float((misses**2 / noise).sum())
        logdet = 2 * float(np.log(factor.diagonal()).sum()) + float(np.log(noise).sum())
        inverse, _ = lapack.dtrtri(factor, lower=1)
        diagonal = (inverse**2).sum(axis=0)
        by_variance = 0.5 * (1 - white**2 - diagonal)
        strain = kernel[3] / self.prior_sd
        by_noise = 0.5 * (len(self.y) - fit - (m - float(diagonal.sum())))
        by_noise += strain / self.prior_sd
        value = 0.5 * (fit + float(white @ white) + logdet + strain**2)
        return value, np.array([*(gradient @ by_variance), by_noise])

    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of the four hyperparameters."""
        low, high = self.settings.roughness
        factor = min(3 * self.prior_sd, np.log(9.0))
        widths = (np.log(0.5 / self.omega[-1]), np.log(4.0))
        return [(-25.0, 12.0), widths, (np.log(low), np.log(high)), (-factor, factor)]

    def start(self) -> np.ndarray:
        """Give the best of a few kernels whose variance is that of the data."""
        best, least = np.zeros(4), np.inf
        for scale in sorted(self.settings.scales, reverse=True):
            level = np.log(scale * np.sqrt(2 * np.pi) / _REACH)
            kernel = np.array([level, np.log(scale), np.log(4.0), 0.0])
            loss = self.loss(kernel)[0]
            # The finer the scale, the more cosines: stop at the first that is worse.
            if loss > least:
                break
            best, least = kernel, loss
        return best

    def search(self, start: np.ndarray | None) -> np.ndarray:
        """Find the hyperparameters of greatest marginal likelihood."""
        bounds = self.bounds()
        begin = self.start() if start is None else start
        begin = np.clip(begin, *np.array(bounds).T)
        options = {"maxiter": self.settings.steps, "ftol": 1e-5, "gtol": 1e-3}
        found = minimize(
            self.loss, begin, jac=True, bounds=bounds, method="L-BFGS-B", options=options
        )
        return np.asarray(found.x)

    def process(self, kernel: np.ndarray, rate: np.ndarray) -> Process:
        """Give the posterior of values and slopes at the rows; ``rate`` is ds/dt there."""
        root, factor, white, _ = self.solve(kernel)
        noise = self.variance * np.exp(kernel[3])

        def posterior(s: np.ndarray, rate: np.ndarray) -> np.ndarray:
            # Beyond their ends the cosines come back.
            values, slopes = self.terms(np.clip(s, -_REACH, _REACH), len(root))
            both = values * root, slopes * root * rate[:, None]
            spread = [
                np.sqrt(
                    np.sum(solve_triangular(factor, b.T, lower=True, check_finite=False) ** 2, 0)
                )
                for b in both
            ]
            return np.array([*(b @ white for b in both), *spread])

        def in_units(found: np.ndarray) -> np.ndarray:
            return np.array([found[0] * self.spread + self.middle, *(found[1:] * self.spread)])

        rows = posterior(self.s, rate)
        leverage = np.minimum(rows[2] ** 2 / noise, 1 - 1e-9)
        misses = (self.y - rows[0]) / np.sqrt(noise * (1 - leverage))
        evidence = -self.loss(kernel)[0] - len(self.y) * np.log(self.spread * np.sqrt(2 * np.pi))

        def at(s: np.ndarray, rate: np.ndarray) -> np.ndarray:
            return in_units(posterior(s, rate))

        value, slope, value_sd, slope_sd = in_units(rows)
        factor_found = float(np.exp(kernel[3] / 2))
        return Process(value, slope, value_sd, slope_sd, evidence, misses, factor_found, kernel, at)


def fit_process(
    s: np.ndarray,
    rate: np.ndarray,
    y: np.ndarray,
    sd: np.ndarray,
    settings: ProcessSettings,
    start: np.ndarray | None = None,
) -> Process:
    """Fit a Gaussian process in the warped time s(t) to one column.

    Parameters
    ----------
    s : (n,) warped times of the rows, from -1 to 1, strictly increasing.
    rate : (n,) ds/dt at the rows.
    y : (n,) values.
    sd : (n,) standard deviations of their noise.
    settings : bounds of the search.
    start : hyperparameters to start from, as in ``Process.kernel``; None tries several.

    >>> t = np.linspace(-1, 1, 60)
    >>> y = np.sin(3 * t) + np.random.default_rng(0).normal(0, 0.05, 60)
    >>> found = fit_process(t, np.ones(60), y, np.full(60, 0.05), ProcessSettings())
    >>> bool(np.sqrt(np.mean((found.slope - 3 * np.cos(3 * t)) ** 2)) < 0.15)
    True
    """
    problem = _Problem(s, y, sd, settings)
    return problem.process(problem.search(start), rate)


def screen(
    s: np.ndarray, y: np.ndarray, sd: np.ndarray, settings: ProcessSettings
) -> tuple[float, np.ndarray]:
    """Give the evidence of the best of a few kernels, and its hyperparameters.

    The parameters are those of :func:`fit_process`.
    """
    problem = _Problem(s, y, sd, settings)
    kernel = problem.start()
    return -problem.loss(kernel)[0], kernel
