"""Constants of a formula: taken out, fitted to samples, put back; the shape stays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import Program, compile_columns, free_constants, skeleton
from dynsr.fit.linear import ROUNDING, cauchy_scale, cauchy_weights, fit_columns

# A residual that is not a finite number counts as this many times the size of the target.
_PENALTY = 1e3
_MOST_STEPS = 12
_MOST_PLAIN_STEPS = 60
# Shares of a step that are tried in turn, and the gains below which a fit has come to its end:
# in nats a row with a unit (all constants are then far within their errors), else relative.
_SHARES = (1.0, 0.3, 0.1, 0.01)
_GAIN, _PLAIN_GAIN = 1e-6, 1e-12
# Share of a scale below which a smaller one is worth another fit.
_LESS = 0.9


def one_of_each_shape(exprs: Iterable[sympy.Expr]) -> list[sympy.Expr]:
    """Give the first of the formulas of every shape.

    Parameters
    ----------
    exprs : the formulas.

    >>> one_of_each_shape(map(sympy.sympify, ["2.5*x", "x**2", "1.5*x"]))
    [2.5*x, x**2]
    """
    found: dict[sympy.Expr, sympy.Expr] = {}
    for expr in exprs:
        found.setdefault(skeleton(expr), expr)
    return list(found.values())


def as_floats(values: np.ndarray) -> list[sympy.Expr]:
    """Give SymPy floats of twelve digits: no data are surer, more would only show rounding."""
    return [sympy.Float(float(f"{v:.11e}")) for v in values]


@dataclass(frozen=True, eq=False)
class Template:
    """A formula with its k floats taken out, on n samples; compiled once for all values of them.

    >>> x = np.linspace(0.0, 3.0, 50)
    >>> s = Samples(x[:, None], 3 * np.exp(-0.5 * x), ("x",), "x", "given", x)
    >>> template = Template.of(sympy.sympify("2.0*exp(-1.0*x)"), s)
    >>> template.put(as_floats(template.fit(template.values)))
    3.0*exp(-0.5*x)
    """

    shape: sympy.Expr
    parameters: tuple[sympy.Symbol, ...]
    values: np.ndarray
    samples: Samples

    @classmethod
    def of(cls, expr: sympy.Expr, samples: Samples) -> Template:
        """Take the floats out of a formula in the variables of the samples."""
        # The space keeps these names apart from any name of a column.
        shape, values = free_constants(expr, "constant ")
        return cls(shape, tuple(values), np.array(list(values.values())), samples)

    def put(self, numbers: Sequence[sympy.Expr]) -> sympy.Expr:
        """Put k numbers in."""
        return self.shape.xreplace(dict(zip(self.parameters, numbers, strict=True)))

    @cached_property
    def _sensitive(self) -> Program:
        numbers = list(map(str, self.parameters))
        return compile_columns([self.shape], [*self.samples.names, *numbers], numbers)

    @cached_property
    def _plain(self) -> Program:
        names = [*self.samples.names, *map(str, self.parameters)]
        return compile_columns([self.shape], names)

    @cached_property
    def _size(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.samples.y)))) or 1.0

    def residual(self, values: np.ndarray) -> np.ndarray:
        """(n,) f(X) - y; NaN or inf outside the domain."""
        return np.asarray(self._plain(*self.samples.X.T, *values)[0] - self.samples.y)

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """(k, n) derivatives of f by the parameters; 0 where they are not finite."""
        found = self._sensitive(*self.samples.X.T, *values)[1:]
        return found if np.all(np.isfinite(found)) else np.nan_to_num(found, posinf=0, neginf=0)

    def _tame(self, values: np.ndarray) -> np.ndarray:
        penalty = _PENALTY * self._size
        residual = self.residual(values)
        if np.all(np.isfinite(residual)):
            return residual
        return np.nan_to_num(residual, nan=penalty, posinf=penalty, neginf=-penalty)

    def fit(
        self, values: np.ndarray, free: np.ndarray | None = None, unit: float | None = None
    ) -> np.ndarray:
        """Fit the ``free`` (k,) parameters, all by default, from ``values``; gives all values.

        Minimises the sum of squared residuals or, with a ``unit`` u in units of y, the Cauchy
        loss sum_i log(1 + (r_i / s)^2), for which large errors among small ones count little. A
        Cauchy loss whose scale s is far below the residuals has a minimum at every sample, so s is
        the most probable scale of the residuals, and the unit is its lower limit.
        """
        chosen = np.ones(len(values), dtype=bool) if free is None else free
        if not chosen.any():
            return values
        if unit is None:
            return self._descend(values, chosen, None)
        unit = max(unit, ROUNDING * self._size)
        scale = cauchy_scale(self._tame(values), unit)
        for _ in range(_MOST_STEPS):
            before, values = scale, self._descend(values, chosen, scale)
            scale = cauchy_scale(self._tame(values), unit)
            if not scale < _LESS * before:
                break
        return values

    def _descend(self, values: np.ndarray, free: np.ndarray, unit: float | None) -> np.ndarray:
        """Take reweighted Gauss-Newton steps, shortened until they gain.

        ``scipy.optimize.least_squares`` (trf with its Cauchy loss, lm without) was measured on a
        ratio of six constants and 1000 rows: one and a half to five times the time, and where the
        unit is near rounding it ended at a higher loss.
        """
        residual = self._tame(values)
        level = _level(residual, unit)
        for _ in range(_MOST_PLAIN_STEPS if unit is None else _MOST_STEPS):
            root = _root_weights(residual, unit)
            slopes = self.slopes(values)[free] * root
            step = fit_columns(slopes.T, -residual * root)
            for share in _SHARES:
                trial = values.copy()
                trial[free] += share * step
                residual_there = self._tame(trial)
                reached = _level(residual_there, unit)
                if reached < level:
                    break
            else:
                return values
            gain, level = level - reached, reached
            values, residual = trial, residual_there
            if gain < (_PLAIN_GAIN * level if unit is None else _GAIN * len(residual)):
                break
        return values

    def covariance(
        self, values: np.ndarray, free: np.ndarray | None = None, unit: float | None = None
    ) -> np.ndarray:
        """Covariance of the ``free`` parameters, the others being known, at ``values``.

        The inverse of the weighted normal matrix times the weighted residual variance; infinite
        where the samples do not determine a parameter.
        """
        residual = self._tame(values)
        root = _root_weights(residual, unit)
        variance = float(np.sum((root * residual) ** 2) / np.sum(root**2))
        scaled = self.slopes(values)[slice(None) if free is None else free] * root
        # Parameters may differ by many powers of ten.
        norms = np.linalg.norm(scaled, axis=1)
        if not np.all(norms > 0):
            return np.full((len(norms),) * 2, math.inf)
        scaled = scaled / norms[:, None]
        inverse = np.linalg.pinv(scaled @ scaled.T, hermitian=True)
        return inverse * variance / np.outer(norms, norms)


def _root_weights(residual: np.ndarray, unit: float | None) -> np.ndarray:
    return np.ones(len(residual)) if unit is None else np.sqrt(cauchy_weights(residual, unit))


def _level(residual: np.ndarray, unit: float | None) -> float:
    with np.errstate(all="ignore"):
        level = np.sum(residual**2 if unit is None else np.log1p((residual / unit) ** 2))
    return float(level) if math.isfinite(level) else math.inf


def refit(expr: sympy.Expr, samples: Samples, unit: float | None = None) -> sympy.Expr:
    """Fit the floats of a formula to samples; see :meth:`Template.fit`.

    >>> t = np.linspace(0, 1, 20)
    >>> s = Samples(t[:, None], 3 * t, ("x",), "x", "given", t)
    >>> refit(sympy.Float(2.5) * sympy.Symbol("x"), s, 1e-3)
    3.0*x
    """
    template = Template.of(expr, samples)
    return template.put(as_floats(template.fit(template.values, unit=unit)))
