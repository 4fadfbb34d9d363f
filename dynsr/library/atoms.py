"""Atoms: the functions that terms of laws are made of, each a row of one table.

An atom is a function of one or two columns with up to two constants inside. All else that is done
with it follows from its formula: its values, its slopes by the constants, how it is written.
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

V, W, K, L = sympy.symbols("v w k l")


class Domain(Enum):
    """Where the columns of an atom are; of two, each, or their difference or distance from 0."""

    ANY = auto()
    NEVER_NEGATIVE = auto()
    POSITIVE = auto()
    AWAY_FROM_0 = auto()
    BOTH_SIGNS = auto()
    TURNING = auto()
    APART_POSITIVE = auto()
    APART_BOTH_SIGNS = auto()
    FAR_FROM_0 = auto()


@dataclass(frozen=True)
class Inside:
    """A constant inside an atom, and where it is begun.

    A size is moved by factors, and never 0; all else is moved by what is added.

    Parameters
    ----------
    units : powers of the usual sizes of the columns that it has; none of a number.
    starts : multiples of a size, or values of a number; by default all sizes of the first column at
        which a function may bend.
    at : quantiles of the first column; it is begun as the constant before it times these.
    of_spread : whether the size is that of the column's spread.
    """

    units: tuple[int, ...] = ()
    starts: tuple[float, ...] = ()
    at: tuple[float, ...] = ()
    of_spread: bool = False

    def begin(
        self, rows: np.ndarray, sizes: np.ndarray, before: np.ndarray | None = None
    ) -> np.ndarray:
        """(g,) values to begin with.

        Parameters
        ----------
        rows : (columns, n) values of the atom's columns.
        sizes : (g,) sizes of the first at which the atom may bend.
        before : the constant before it.
        """
        if self.at:
            assert before is not None
            return np.asarray(before * np.quantile(rows[0], self.at))
        if not self.units:
            return np.array(self.starts)
        usual = np.std(rows, axis=1) if self.of_spread else np.median(np.abs(rows), axis=1)
        scale = float(np.prod(usual[1 : len(self.units)] ** np.array(self.units[1:])))
        if not self.starts:
            return np.asarray(sizes ** self.units[0] * scale)
        return np.array(self.starts) * float(usual[0]) ** self.units[0] * scale

    @property
    def sign(self) -> int:
        """The sign with which a step along its slope moves a size's logarithm; 0 of a number."""
        return next(filter(None, self.units), 0)

    def slope(self, formula: sympy.Expr, symbol: sympy.Symbol) -> sympy.Expr:
        """Give the slope of a formula by it; of a size, by the logarithm of what it stands for.

        Parameters
        ----------
        formula, symbol : the formula, and its name in it.
        """
        by = differentiate(formula, symbol)
        return by * self.sign * symbol if self.sign else by


@dataclass(frozen=True)
class Atom:
    """A function that may be a factor of a term.

    Parameters
    ----------
    name : what it is called.
    formula : in ``v``, ``w`` where it is of two columns, and the constants ``k`` and ``l``.
    domain : where all of its columns are.
    inside : its constants.
    most : other columns in one term with it.

    >>> decay = Atom("decay", sympy.exp(-K * V), inside=(Inside((-1,)),))
    >>> round(float(decay.values([[2.0]], np.array([[0.5]]))[0, 0]), 4)
    0.3679
    """

    name: str
    formula: sympy.Expr
    domain: Domain = Domain.ANY
    inside: tuple[Inside, ...] = ()
    most: int = 1

    @cached_property
    def columns(self) -> int:
        """How many columns it is of."""
        return 1 + (W in self.formula.free_symbols)

    def begin(self, rows: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """(g, c) values of the constants to begin with.

        Parameters
        ----------
        rows : (columns, n) values of its columns.
        sizes : (g,) sizes of the first at which it may bend.
        """
        if not self.inside:
            return np.zeros((1, 0))
        first, *more = self.inside
        own = first.begin(rows, sizes if not more else sizes[::2])
        if not more:
            return own[:, None]
        (second,) = more
        pairs = [[a, b] for a in own for b in second.begin(rows, sizes, a)]
        return np.array(pairs)

    @cached_property
    def _program(self) -> Program:
        slopes = [c.slope(self.formula, s) for c, s in zip(self.inside, (K, L), strict=False)]
        return compile_columns([self.formula, *slopes], ["v", "w", "k", "l"])

    def both(self, rows: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give values (g, n) and slopes (g, c, n) by the constants.

        The slope by a size is by the logarithm of what it stands for.

        Parameters
        ----------
        rows : (columns, n) values of its columns.
        constants : (g, c) values of those inside.
        """
        rows, constants = np.asarray(rows, dtype=float), np.asarray(constants, dtype=float)
        shape = len(constants), rows.shape[1]
        one, other = (*constants.T[:, :, None], *[np.ones((1, 1))] * 2)[:2]
        with np.errstate(all="ignore"):
            found = np.asarray(self._program(rows[0], rows[-1], one, other))
        values = np.broadcast_to(found[0], shape)
        return values, np.broadcast_to(
            found[1:].swapaxes(0, 1), (shape[0], len(found) - 1, shape[1])
        )

    def values(self, rows: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """Give values (g, n) as :meth:`both` does."""
        return self.both(rows, constants)[0]

    def write(self, columns: tuple[sympy.Symbol, ...], constants: tuple[float, ...]) -> sympy.Expr:
        """Write it in its columns.

        Parameters
        ----------
        columns, constants : what stands for ``v`` and ``w``, and for ``k`` and ``l``.
        """
        names = dict(zip((V, W), columns, strict=False))
        numbers = zip((K, L), map(sympy.Float, constants), strict=False)
        return self.formula.xreplace({**names, **dict(numbers)})


# Starts of a constant beside another one, as multiples of a usual size.
_FEW = (0.3, 1.0, 3.0)
_SIZE, _RATE = Inside((1,)), Inside((-1,))
_POWER_APART = Inside((), (0.75, 1.25, 1.75))
_STEEP = Inside((-1,), (1.0, 2.5, 6.0), of_spread=True)
_STEEPNESS = Inside((), (1.5, 3.0, 6.0, 12.0))
_MIDDLE = Inside(at=(0.1, 0.3, 0.5, 0.7, 0.9))


def _saturates(power: int) -> Atom:
    domain = Domain.NEVER_NEGATIVE if power % 2 else Domain.ANY
    formula = V**power / (V**power + K)
    return Atom(f"saturates{power}", formula, domain, (Inside((power,)),))


def _inhibits(power: int) -> Atom:
    domain = Domain.NEVER_NEGATIVE if power % 2 else Domain.ANY
    return Atom(f"inhibits{power}", 1 / (V**power + K), domain, (Inside((power,)),))


_TABLE = (
    Atom("inverse", 1 / V, Domain.AWAY_FROM_0, most=2),
    Atom("inverse square", V**-2, Domain.AWAY_FROM_0),
    Atom("inverse cube", V**-3, Domain.AWAY_FROM_0),
    Atom("root", sympy.sqrt(V), Domain.POSITIVE),
    Atom("logarithm", sympy.log(V), Domain.POSITIVE),
    Atom("size", sympy.Abs(V), Domain.BOTH_SIGNS),
    Atom("sine", sympy.sin(V), most=2),
    Atom("cosine", sympy.cos(V), Domain.TURNING, most=2),
    Atom("power", V**K, Domain.POSITIVE, (Inside((), (-1.5, -0.5, 0.35, 0.7, 1.5, 2.5)),)),
    *map(_saturates, (1, 2, 3, 4)),
    *map(_inhibits, (1, 2, 3, 4)),
    Atom("inhibits steeply", 1 / (V**L + K**L), Domain.POSITIVE, (_SIZE, _STEEPNESS)),
    Atom("decay", sympy.exp(-K * V), inside=(_RATE,), most=2),
    Atom("growth", sympy.exp(K * V), inside=(_RATE,)),
    Atom("activation", sympy.exp(-K / V), Domain.AWAY_FROM_0, (_SIZE,)),
    Atom("bump", sympy.exp(-K * V**2), inside=(Inside((-2,)),)),
    Atom("tanh", sympy.tanh(K * V), inside=(_RATE,)),
    Atom("levels off", V / sympy.sqrt(V**2 + K), inside=(Inside((2,)),)),
    Atom("rise", 1 / (1 + sympy.exp(L - K * V)), inside=(_STEEP, _MIDDLE)),
    Atom("fall", 1 / (1 + sympy.exp(K * V - L)), inside=(_STEEP, _MIDDLE)),
    Atom(
        "inhibits itself",
        1 / (V + K + L * V**2),
        Domain.NEVER_NEGATIVE,
        (_SIZE, Inside((-1,), _FEW)),
        most=2,
    ),
    Atom("scaled sine", sympy.sin(K * V), Domain.TURNING, (_RATE,)),
    Atom("scaled cosine", sympy.cos(K * V), Domain.TURNING, (_RATE,)),
    Atom("phase sine", sympy.sin(V - W), Domain.TURNING, most=0),
    Atom("phase cosine", sympy.cos(V - W), Domain.TURNING, most=0),
    Atom("scaled phase sine", sympy.sin(K * (V - W)), Domain.TURNING, (_RATE,), most=0),
    Atom("tanh of both", sympy.tanh(K * V + L * W), inside=(_RATE, Inside((0, -1), (-1.0, 1.0)))),
    Atom("distance", sympy.Abs(V - W), Domain.APART_BOTH_SIGNS),
    Atom("root apart", sympy.sqrt(V - W), Domain.APART_POSITIVE),
    Atom("power apart", (V - W) ** K, Domain.APART_POSITIVE, (_POWER_APART,), most=0),
    Atom("cube apart", (V - W) ** 3, most=0),
    Atom("length", sympy.sqrt(V**2 + W**2)),
    Atom("attraction", (V**2 + W**2) ** sympy.Rational(-3, 2), Domain.FAR_FROM_0),
    Atom("shared", V * W / (V + K * W), Domain.NEVER_NEGATIVE, (Inside((1, -1)),), most=0),
    Atom("shared evenly", V * W / (V + W), Domain.NEVER_NEGATIVE, most=0),
    Atom(
        "inhibit together",
        1 / (V + K + L * W),
        Domain.NEVER_NEGATIVE,
        (_SIZE, Inside((1, -1), _FEW)),
        most=2,
    ),
)
ATOMS: Mapping[str, Atom] = MappingProxyType({atom.name: atom for atom in _TABLE})
