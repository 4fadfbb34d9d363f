"""Constants refined by nonlinear least squares: the shape of a formula stays, its numbers move."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy
from scipy.optimize import least_squares

from dynsr.expression import compile_numpy
from dynsr.samples import Samples

# A residual that is not a finite number counts as this many times the size of the target.
_PENALTY = 1e3


@dataclass(frozen=True, eq=False)
class Template:
    """A formula with its floats taken out: ``shape`` in ``parameters``, and their ``values``.

    Integers and rationals are part of the shape. Floats that are equal share a parameter.

    >>> template = Template.of(sympy.sympify("2.5*x + 1.5*sin(2*x)"), ("x",))
    >>> template.values.tolist()
    [1.5, 2.5]
    >>> template.fill([1, 2.0])
    2.0*x + sin(2*x)
    """

    shape: sympy.Expr
    parameters: tuple[sympy.Symbol, ...]
    values: np.ndarray
    names: tuple[str, ...]

    @classmethod
    def of(cls, expr: sympy.Expr, names: Sequence[str]) -> Template:
        """Take the floats out of a formula in the variables ``names``."""
        floats = sorted(expr.atoms(sympy.Float), key=float)
        # A leading digit keeps the names apart from every variable, which are identifiers.
        parameters = tuple(sympy.Symbol(f"{i}_parameter") for i in range(len(floats)))
        shape = expr.xreplace(dict(zip(floats, parameters, strict=True)))
        return cls(shape, parameters, np.array([float(v) for v in floats]), tuple(names))

    def fill(self, values: Sequence[float | sympy.Expr] | np.ndarray) -> sympy.Expr:
        """Put numbers in; Python floats become floats, SymPy numbers stay what they are."""
        numbers = [
            v if isinstance(v, sympy.Basic) else sympy.Float(v) if isinstance(v, float) else
            sympy.sympify(v)
            for v in (values.tolist() if isinstance(values, np.ndarray) else values)
        ]  # fmt: skip
        return self.shape.xreplace(dict(zip(self.parameters, numbers, strict=True)))

    @cached_property
    def _compiled(self) -> object:
        exprs = [self.shape, *(sympy.diff(self.shape, p) for p in self.parameters)]
        return compile_numpy(exprs, [*self.names, *(str(p) for p in self.parameters)])

    def value_and_jacobian(self, X: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(1 + k, n) the formula at the n rows of ``X`` and its derivatives by k parameters."""
        rows = np.concatenate([X.T, np.broadcast_to(values[:, None], (len(values), len(X)))])
        return self._compiled(rows)  # type: ignore[operator]


@dataclass(frozen=True, eq=False)
class Refined:
    """A formula with fitted constants.

    ``covariance`` (k, k) is that of the ``template``'s parameters at their ``values`` (k,): the
    inverse of the weighted normal matrix times the weighted residual variance; infinite where the
    samples do not determine a parameter.
    """

    template: Template
    values: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray

    @property
    def expr(self) -> sympy.Expr:
        """The formula."""
        return self.template.fill(self.values)


def refine(expr: sympy.Expr, samples: Samples, scale: float | None = None) -> Refined:
    """Fit every float of a formula to samples, starting at its present value.

    Minimises sum_i (y_i - f(X_i))^2 or, with a ``scale`` s in units of y, the Cauchy loss
    sum_i s^2 log(1 + ((y_i - f(X_i)) / s)^2), for which large errors among small ones count
    little. Slopes of a trajectory that an adaptive solver made carry such errors.

    >>> x = np.linspace(0.0, 3.0, 50)
    >>> s = Samples(x[:, None], 3 * np.exp(-0.5 * x), ("x",), "x", "given", x)
    >>> refine(sympy.sympify("2.0*exp(-1.0*x)"), s).values.round(6).tolist()
    [-0.5, 3.0]
    """
    return refine_template(Template.of(expr, samples.names), samples, scale)


def refine_template(template: Template, samples: Samples, scale: float | None = None) -> Refined:
    """Fit a template's parameters to samples, starting at its values.

    A Cauchy loss whose scale is far below the residuals has a minimum at every sample, so the
    scale comes down to the one asked for by tenths of the median residual.
    """
    problem = _Residuals(template, samples)
    values = template.values
    if len(values):
        if scale is not None:
            scale = max(scale, 1e-12 * problem.size)
            for wider in _wider_scales(problem, values, scale):
                values = _minimise(problem, values, wider)
        values = _minimise(problem, values, scale)
    residual = problem.residual(values)
    return Refined(
        template, values, _covariance(problem.jacobian(values), residual, scale), residual
    )


class _Residuals:
    """The residuals y - f(X) and their Jacobian as functions of the parameters' values."""

    def __init__(self, template: Template, samples: Samples) -> None:
        self.template, self.samples = template, samples
        self.size = float(np.sqrt(np.mean(np.square(samples.y)))) or 1.0
        self._at: tuple[bytes, np.ndarray] = (b"nowhere", np.empty(0))

    def _both(self, values: np.ndarray) -> np.ndarray:
        key = values.tobytes()
        if key != self._at[0]:
            self._at = (key, self.template.value_and_jacobian(self.samples.X, values))
        return self._at[1]

    def residual(self, values: np.ndarray) -> np.ndarray:
        penalty = _PENALTY * self.size
        residual = self.samples.y - self._both(values)[0]
        return np.nan_to_num(residual, nan=penalty, posinf=penalty, neginf=-penalty)

    def jacobian(self, values: np.ndarray) -> np.ndarray:
        return np.nan_to_num(-self._both(values)[1:].T, posinf=0.0, neginf=0.0)


def _wider_scales(problem: _Residuals, values: np.ndarray, scale: float) -> list[float]:
    median = float(np.median(np.abs(problem.residual(values))))
    steps = math.ceil(math.log10(median / scale)) if median > 10 * scale else 0
    return [median / 10**i for i in range(steps)]


def _minimise(problem: _Residuals, start: np.ndarray, scale: float | None) -> np.ndarray:
    solution = least_squares(
        problem.residual,
        start,
        problem.jacobian,
        loss="linear" if scale is None else "cauchy",
        f_scale=1.0 if scale is None else scale,
        x_scale=np.maximum(np.abs(start), 1e-6),
        max_nfev=60,
    )
    return solution.x if np.all(np.isfinite(solution.x)) else start


def _covariance(jacobian: np.ndarray, residual: np.ndarray, scale: float | None) -> np.ndarray:
    weights = np.ones(len(residual)) if scale is None else 1 / (1 + (residual / scale) ** 2)
    variance = float(np.sum(weights * residual**2) / np.sum(weights))
    # Columns are brought to one size first: parameters may differ by many powers of ten.
    norms = np.sqrt(np.sum(weights[:, None] * jacobian**2, axis=0))
    if not np.all(norms > 0):
        return np.full((jacobian.shape[1],) * 2, math.inf)
    scaled = np.sqrt(weights)[:, None] * jacobian / norms
    inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    return inverse * variance / np.outer(norms, norms)


def fixed(template: Template, numbers: Mapping[int, sympy.Expr], values: np.ndarray) -> Template:
    """Give the template in which some parameters, by index, became exact numbers.

    >>> template = Template.of(sympy.sympify("2.01*x + 1.3"), ("x",))
    >>> fixed(template, {1: sympy.Integer(2)}, template.values).shape
    0_parameter + 2*x
    """
    shape = template.shape.xreplace({template.parameters[i]: v for i, v in numbers.items()})
    left = [
        i
        for i, parameter in enumerate(template.parameters)
        if i not in numbers and shape.has(parameter)
    ]
    return Template(
        shape, tuple(template.parameters[i] for i in left), values[left], template.names
    )
