"""Atoms: the functions that terms of laws are made of, each a row of one table.

An atom is a function of one or two columns with at most one constant inside. Everything else that
is done with it follows from its formula: its values, its slope by the constant, how it is written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from functools import cached_property
from types import MappingProxyType

import numpy as np
import sympy

from dynsr.expression import Program, compile_columns, differentiate

V, W, K = sympy.symbols("v w k")


class Domain(Enum):
    """Where the columns of an atom are."""

    ANY = auto()
    NEVER_NEGATIVE = auto()
    POSITIVE = auto()
    AWAY_FROM_0 = auto()
    BOTH_SIGNS = auto()
    TURNING = auto()


@dataclass(frozen=True)
class Atom:
    """A function that may be a factor of a term.

    Parameters
    ----------
    name : what it is called.
    formula : in ``v``, ``w`` where it is of two columns, and the constant ``k``.
    domain : where all of its columns are.
    starts : values of a constant that is no size, to begin with.
    units : powers of the usual sizes of the columns that the constant has.
    most : other columns in one term with it.

    >>> round(float(Atom("decay", sympy.exp(-K * V), units=(-1,)).values([[2.0]], 0.5)[0]), 4)
    0.3679
    """

    name: str
    formula: sympy.Expr
    domain: Domain = Domain.ANY
    starts: tuple[float, ...] = ()
    units: tuple[int, ...] = (0,)
    most: int = 1

    @property
    def has_constant(self) -> bool:
        """Whether there is a constant inside."""
        return K in self.formula.free_symbols

    @property
    def is_scaled(self) -> bool:
        """Whether the constant is a size, which is moved by factors, and never 0."""
        return any(self.units)

    @property
    def columns(self) -> int:
        """How many columns it is of."""
        return 1 + (W in self.formula.free_symbols)

    def begin(self, sizes: np.ndarray, second: float = 1.0) -> np.ndarray:
        """(g,) values of the constant to begin with.

        Parameters
        ----------
        sizes : (g,) sizes of ``v`` at which it may matter.
        second : usual size of ``w``.
        """
        if not self.is_scaled:
            return np.array(self.starts)
        return np.asarray(sizes ** self.units[0] * second ** sum(self.units[1:]))

    @cached_property
    def _program(self) -> Program:
        by = differentiate(self.formula, K) * (self.units[0] * K if self.is_scaled else 1)
        return compile_columns([self.formula, by], ["v", "w", "k"])

    def both(self, rows: np.ndarray, constant: np.ndarray | float = 1.0) -> np.ndarray:
        """Give values and slopes by the constant, (2, ..., n).

        The slope is by the logarithm of the size of ``v`` that a constant stands for.

        Parameters
        ----------
        rows : (columns, n) values of its columns.
        constant : value, or values of any shape (..., 1).
        """
        second = rows[1] if len(rows) > 1 else rows[0]
        with np.errstate(all="ignore"):
            return np.asarray(self._program(np.asarray(rows[0]), second, np.asarray(constant)))

    def values(self, rows: np.ndarray, constant: np.ndarray | float = 1.0) -> np.ndarray:
        """Give values (..., n) as :meth:`both` does."""
        return np.asarray(self.both(rows, constant)[0])

    def moved(self, constant: float, step: float) -> float:
        """Give the constant after a step in the direction of the slope that :meth:`both` gives."""
        return constant * float(np.exp(self.units[0] * step)) if self.is_scaled else constant + step

    def write(self, columns: tuple[sympy.Symbol, ...], constant: sympy.Expr | None) -> sympy.Expr:
        """Write it in its columns.

        Parameters
        ----------
        columns, constant : what stands for ``v``, ``w`` and ``k``.
        """
        names = dict(zip((V, W), columns, strict=False))
        return self.formula.xreplace(names if constant is None else {**names, K: constant})


def _saturates(power: int) -> Atom:
    domain = Domain.NEVER_NEGATIVE if power % 2 else Domain.ANY
    formula = V**power / (V**power + K)
    return Atom(f"saturates{power}", formula, domain, units=(power,))


def _inhibits(power: int) -> Atom:
    domain = Domain.NEVER_NEGATIVE if power % 2 else Domain.ANY
    return Atom(f"inhibits{power}", 1 / (V**power + K), domain, units=(power,))


_TABLE = (
    Atom("inverse", 1 / V, Domain.AWAY_FROM_0, most=2),
    Atom("inverse square", V**-2, Domain.AWAY_FROM_0),
    Atom("root", sympy.sqrt(V), Domain.POSITIVE),
    Atom("logarithm", sympy.log(V), Domain.POSITIVE),
    Atom("size", sympy.Abs(V), Domain.BOTH_SIGNS),
    Atom("sine", sympy.sin(V), Domain.TURNING, most=2),
    Atom("cosine", sympy.cos(V), Domain.TURNING, most=2),
    Atom("power", V**K, Domain.POSITIVE, (-1.5, -0.5, 0.35, 0.7, 1.5, 2.5)),
    *map(_saturates, (1, 2, 3, 4)),
    *map(_inhibits, (1, 2, 3, 4)),
    Atom("decay", sympy.exp(-K * V), units=(-1,)),
    Atom("growth", sympy.exp(K * V), units=(-1,)),
    Atom("bump", sympy.exp(-K * V**2), units=(-2,)),
    Atom("tanh", sympy.tanh(K * V), units=(-1,)),
    Atom("phase sine", sympy.sin(V - W), Domain.TURNING, most=0),
    Atom("phase cosine", sympy.cos(V - W), Domain.TURNING, most=0),
    Atom("shared", V * W / (V + K * W), Domain.POSITIVE, units=(1, -1), most=0),
)
ATOMS: Mapping[str, Atom] = MappingProxyType({atom.name: atom for atom in _TABLE})
