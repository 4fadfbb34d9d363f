"""Curves: smooth functions of one variable that are known by their values, and no formula.

A curve is a natural cubic spline: of all functions through its knots it bends least, and beyond
them it is a straight line (Green and Silverman 1994). It can be a function in expressions, which
are then evaluated, differentiated and integrated as others are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import sympy
from scipy.interpolate import CubicSpline

from dynsr.errors import InputError


# A fit moves the values of a curve thousands of times, and never its knots.
@lru_cache(maxsize=32)
def _ones(knots: bytes) -> CubicSpline:
    """Give the curves that are 1 at one knot and 0 at the others."""
    own = np.frombuffer(knots)
    return CubicSpline(own, np.eye(len(own)), bc_type="natural")


@dataclass(frozen=True, eq=False)
class Curve:
    """A natural cubic spline.

    Parameters
    ----------
    name : what the function is called.
    knots : (K,) increasing numbers, three at least.
    values : (K,) its values there.

    Raises InputError when there are too few knots, they do not increase, or a number is not finite.

    >>> curve = Curve("f", np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]))
    >>> curve(np.array([0.5, 3.0])).tolist()
    [0.5, 3.0]
    """

    name: str
    knots: np.ndarray
    values: np.ndarray

    def __post_init__(self) -> None:
        """Check the numbers."""
        knots, values = (np.asarray(own, dtype=float) for own in (self.knots, self.values))
        if len(knots) < 3 or knots.shape != values.shape:
            raise InputError(f"the curve {self.name!r} needs three knots, and a value at each")
        if not (np.all(np.isfinite(values)) and np.all(np.diff(knots) > 0)):
            raise InputError(f"the curve {self.name!r} has knots that do not increase")
        object.__setattr__(self, "knots", knots)
        object.__setattr__(self, "values", values)

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.knots, self.values, bc_type="natural")

    @property
    def _every(self) -> CubicSpline:
        return _ones(self.knots.tobytes())

    def __eq__(self, other: object) -> bool:
        """Whether two curves have the same name and numbers, as expressions ask."""
        return isinstance(other, Curve) and self._key == other._key

    def __hash__(self) -> int:
        """Give what is the same for equal curves."""
        return hash(self._key)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the numbers alone: the function in expressions refers to the curve."""
        return Curve, (self.name, self.knots, self.values)

    @cached_property
    def _key(self) -> tuple[str, bytes, bytes]:
        return self.name, self.knots.tobytes(), self.values.tobytes()

    def __call__(self, x: Any) -> Any:
        """Give the values at points.

        Parameters
        ----------
        x : a number, or points (...,).
        """
        return self._read(self._spline, x)

    def slope(self, x: Any) -> Any:
        """Give the derivative at points.

        Parameters
        ----------
        x : a number, or points (...,).
        """
        return self._spline(self._inside(x), 1)

    def weights(self, x: np.ndarray) -> np.ndarray:
        """Give what the value at each knot counts at points, (..., K).

        Parameters
        ----------
        x : points (...,).
        """
        found: np.ndarray = self._read(self._every, x)
        return found

    def _inside(self, x: Any) -> Any:
        return np.clip(x, self.knots[0], self.knots[-1])

    def _read(self, spline: CubicSpline, x: Any) -> Any:
        inside = self._inside(x)
        found = spline(inside)
        beyond = np.asarray(x - inside)
        if beyond.any():
            slopes = spline(inside, 1)
            found = (
                found + beyond.reshape(beyond.shape + (1,) * (slopes.ndim - beyond.ndim)) * slopes
            )
        return found

    @cached_property
    def roughness(self) -> np.ndarray:
        """(K, K) form of the values that is the integral of the squared second derivative."""
        bend = self._every(self.knots, 2)
        # The second derivative is linear between knots.
        left, right, h = bend[:-1], bend[1:], np.diff(self.knots)[:, None, None]
        pairs = left[:, :, None] * left[:, None] + right[:, :, None] * right[:, None]
        mixed = left[:, :, None] * right[:, None]
        found: np.ndarray = np.sum(h / 3 * (pairs + (mixed + mixed.swapaxes(1, 2)) / 2), axis=0)
        return found

    @cached_property
    def function(self) -> Callable[..., sympy.Expr]:
        """The function of that name in expressions of SymPy, with these values."""
        found: Callable[..., sympy.Expr] = sympy.Function(
            self.name, _imp_=self, fdiff=_differentiate, curve=self
        )
        return found

    def formula(self, x: sympy.Expr) -> sympy.Expr:
        """Write the curve as a formula: a line and a multiple of the cube of each distance.

        Parameters
        ----------
        x : what it is a function of.

        >>> curve = Curve("f", np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 0.0]))
        >>> formula = curve.formula(sympy.Symbol("x"))
        >>> round(float(formula.subs("x", 0.5)), 6), round(float(curve(0.5)), 6)
        (0.6875, 0.6875)
        """
        middle, size = (self.knots[0] + self.knots[-1]) / 2, np.ptp(self.knots) / 2
        u = (self.knots - middle) / size
        line = np.column_stack([np.ones_like(u), u])
        cubes = np.abs(u[:, None] - u) ** 3
        whole = np.block([[cubes, line], [line.T, np.zeros((2, 2))]])
        found = np.linalg.solve(whole, np.append(self.values, [0.0, 0.0]))
        *bends, level, slope = found.tolist()
        terms = [
            sympy.Float(bend / size**3) * sympy.Abs(x - sympy.Float(knot)) ** 3
            for bend, knot in zip(bends, self.knots.tolist(), strict=True)
        ]
        start = level - slope * middle / size
        return sympy.Add(sympy.Float(start), sympy.Float(slope / size) * x, *terms)

    def with_values(self, values: np.ndarray) -> Curve:
        """Give the curve of the same knots with other values.

        Parameters
        ----------
        values : (K,) values at the knots.
        """
        return replace(self, values=values)


@dataclass(frozen=True)
class _Slope:
    """The derivative of a curve, as a function in expressions."""

    curve: Curve

    def __call__(self, x: Any) -> Any:
        return self.curve.slope(x)


def _differentiate(own: sympy.Expr, _: int = 1) -> sympy.Expr:
    """Give the derivative of a curve in an expression, as SymPy asks for it."""
    curve = own.func.curve
    return sympy.Function(f"{curve.name}_slope", _imp_=_Slope(curve))(own.args[0])


def write_out(expr: sympy.Expr) -> sympy.Expr:
    """Give an expression with formulas in the places of its curves.

    Parameters
    ----------
    expr : the expression.
    """
    return expr.replace(
        lambda node: hasattr(node.func, "curve"),
        lambda node: node.func.curve.formula(node.args[0]),
    )
