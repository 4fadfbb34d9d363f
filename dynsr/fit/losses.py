"""Losses: what the user counts a residual for, in the place of its square."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from dynsr.data import Samples, robust_scale
from dynsr.errors import InputError, quoted
from dynsr.expression import ByText
from dynsr.fit.candidates import Candidate, score_candidate
from dynsr.fit.constants import Template, as_floats
from dynsr.fit.description import description_length
from dynsr.fit.noise import noise_of
from dynsr.fit.settings import FIT

LOSSES = ("squared", "absolute", "huber", "cauchy")
# Units in standard deviations of normal errors that keep 95 % of the efficiency of least squares.
_UNITS = {"huber": 1.345, "cauchy": FIT.noisy_width}
# Formulas whose constants are fitted by the loss, and the constants that one of them has at most.
_FITTED, _MOST_CONSTANTS = 8, 8

LossFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Loss:
    """A loss of each row, from predicted and actual values (n,).

    Parameters
    ----------
    kind : a name of LOSSES, or the user's own function.
    unit : size of the errors from which on a robust loss counts them less.
    """

    kind: str | LossFunction
    unit: float = 1.0

    def __call__(self, predicted: np.ndarray, actual: np.ndarray) -> np.ndarray:
        """Give the loss of each row, (n,)."""
        if not isinstance(self.kind, str):
            return _checked(self.kind(predicted, actual), predicted)
        size = np.abs(predicted - actual)
        if self.kind == "absolute":
            return size
        if self.kind == "huber":
            return np.where(size <= self.unit, size**2, 2 * self.unit * size - self.unit**2)
        if self.kind == "cauchy":
            return np.asarray(self.unit**2 * np.log1p((size / self.unit) ** 2))
        return np.asarray(size**2)

    @property
    def name(self) -> str:
        """The name, "own: " before that of a function."""
        if isinstance(self.kind, str):
            return self.kind
        return f"own: {getattr(self.kind, '__qualname__', type(self.kind).__name__)}"

    @property
    def values(self) -> list[float]:
        """What the loss gives on a few values, which distinguish functions of one name."""
        grid = np.linspace(-2.0, 2.0, 9)
        predicted, actual = (np.ravel(part) for part in np.meshgrid(grid, grid))
        found: list[float] = self(predicted, actual).tolist()
        return found


def read_loss(given: Any) -> Loss | None:
    """Read a loss; None for squared residuals, which everything counts by itself.

    Parameters
    ----------
    given : "squared", "absolute", "huber", "cauchy", or a function of predicted and actual values
        (n,) that gives the loss of each row, (n,), from 0 up.

    Raises InputError that names what it is.

    >>> read_loss("absolute").name, read_loss(None)
    ('absolute', None)
    """
    if given is None or given == "squared":
        return None
    if not callable(given) and given not in LOSSES:
        raise InputError(
            f"unknown loss {quoted(given)}; the losses are: {', '.join(LOSSES)}; or give a "
            "function of predicted and actual values"
        )
    loss = Loss(given)
    _ = loss.values
    return loss


def _checked(found: Any, predicted: np.ndarray) -> np.ndarray:
    losses = np.asarray(found, dtype=float)
    # Where the prediction is no number, nothing can be asked of its loss.
    known = losses[np.isfinite(predicted)] if losses.shape == predicted.shape else None
    if known is None or not np.all(known >= 0):
        said = f"shape {losses.shape}" if known is None else "losses below 0 or no numbers"
        raise InputError(
            f"the loss gives {said} for {len(predicted)} rows; it takes predicted and actual "
            "values and gives the loss of each row, from 0 up"
        )
    return losses


def choose_by_loss(
    pool: Iterable[Candidate], samples: Samples, loss: Loss
) -> tuple[list[Candidate], Samples]:
    """Give formulas as a loss counts them, and the samples on which everything does so.

    Of the formulas of least description length the constants are fitted by the loss too.

    Parameters
    ----------
    pool : formulas with constants as the searches fitted them, by least squares.
    samples : what they are compared on.
    loss : the loss; the unit of a robust one is taken from what the best of the pool misses.
    """
    found = list(pool)
    if loss.kind in _UNITS:
        size = float(robust_scale(np.array(noise_of(found, samples).floor)))
        loss = replace(loss, unit=_UNITS[str(loss.kind)] * size)
    judged = replace(samples, loss=loss)
    scored = [score_candidate(c.expr, judged, c.source) for c in found]
    noise = noise_of(scored, judged)
    ranked = sorted(scored, key=lambda c: (description_length(c, judged, noise), ByText(c.expr)))
    fitted = [_fit(c, judged) for c in ranked[:_FITTED]]
    return list({c.expr: c for c in [*scored, *fitted]}.values()), judged


def _fit(candidate: Candidate, samples: Samples) -> Candidate:
    """Fit the constants of a formula by the loss of the samples."""
    template = Template.of(candidate.expr, samples)
    start = template.values
    loss = samples.loss
    if loss is None or not 0 < len(start) <= _MOST_CONSTANTS:
        return candidate
    size = np.where(start == 0, 1.0, np.abs(start))

    def mean(scaled: np.ndarray) -> float:
        with np.errstate(all="ignore"):
            predicted = template.residual(scaled * size) + samples.y
            found = float(np.mean(loss(predicted, samples.y)))
        return found if math.isfinite(found) else 1e300

    options = {"xatol": 1e-9, "fatol": 0.0, "maxfev": 300 * len(start)}
    found = minimize(mean, start / size, method="Nelder-Mead", options=options)
    expr = template.put(as_floats(found.x * size))
    other = score_candidate(expr, samples, candidate.source)
    return other if other.loss < candidate.loss else candidate
