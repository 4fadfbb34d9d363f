"""Atoms: the functions that terms of laws are made of, each a row of one table.

An atom is a function of up to three columns with up to four constants inside. All else that is done
with it follows from its formula: its values, its slopes by the constants, how it is written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from functools import cached_property, partial
from itertools import product
from types import MappingProxyType

import numpy as np
import sympy

from dynsr.expression import Program, compile_columns, differentiate

V, W, U = PLACES = sympy.symbols("v w u")
K, L, M, N = NUMBERS = sympy.symbols("k l m n")


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
    SHARE = auto()


@dataclass(frozen=True)
class Inside:
    """A constant inside an atom, and where it is begun.

    A size is moved by factors, and never 0; all else is moved by what is added: to a number, steps
    of its own kind, and to what is signed, steps of the size that it starts from.

    Parameters
    ----------
    units : powers of the usual sizes of the columns that it has; none of a number.
    starts : multiples of a size, or values of a number; by default all sizes of the first column at
        which a function may bend.
    at : quantiles of the first column; it is begun as the constant before it times these.
    of_spread : whether the size is that of the column's spread.
    signed : whether it has a size and a sign.
    """

    units: tuple[int, ...] = ()
    starts: tuple[float, ...] = ()
    at: tuple[float, ...] = ()
    of_spread: bool = False
    signed: bool = False

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
        # Where a column decays, most of its values are next to nothing.
        usual = np.std(rows, axis=1) if self.of_spread else np.sqrt(np.mean(rows**2, axis=1))
        scale = float(np.prod(usual[1 : len(self.units)] ** np.array(self.units[1:])))
        if not self.starts:
            return np.asarray(sizes ** self.units[0] * scale)
        return np.array(self.starts) * float(usual[0]) ** self.units[0] * scale

    @property
    def sign(self) -> int:
        """The sign with which a step along its slope moves a size's logarithm; 0 of a number."""
        return next(filter(None, self.units), 0)

    @property
    def free(self) -> bool:
        """Whether it may go anywhere from where it is begun."""
        return self.signed or not (self.units or self.starts or self.at)

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
    formula : in ``v``, then ``w`` and ``u`` where it is of more columns, and the constants ``k``,
        ``l``, ``m`` and ``n``.
    domain : where all of its columns are.
    inside : its constants.
    most : other columns in one term with it.
    start : gives (g, c) constants to begin with for (columns, n) values; by default each constant
        is begun by itself.
    rare : whether it is looked for only where all others have failed.

    >>> decay = Atom("decay", sympy.exp(-K * V), inside=(Inside((-1,)),))
    >>> round(float(decay.values([[2.0]], np.array([[0.5]]))[0, 0]), 4)
    0.3679
    """

    name: str
    formula: sympy.Expr
    domain: Domain = Domain.ANY
    inside: tuple[Inside, ...] = ()
    most: int = 1
    start: Callable[[np.ndarray], np.ndarray] | None = None
    rare: bool = False

    @cached_property
    def columns(self) -> int:
        """How many columns it is of."""
        return len(self.formula.free_symbols & set(PLACES))

    def begin(self, rows: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """(g, c) values of the constants to begin with.

        Parameters
        ----------
        rows : (columns, n) values of its columns.
        sizes : (g,) sizes of the first at which it may bend.
        """
        if self.start is not None:
            return self.start(rows)
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
        slopes = [c.slope(self.formula, s) for c, s in zip(self.inside, NUMBERS, strict=False)]
        return compile_columns([self.formula, *slopes], list(map(str, (*PLACES, *NUMBERS))))

    def both(self, rows: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give values (g, n) and slopes (g, c, n) by the constants.

        The slope by a size is by the logarithm of what it stands for.

        Parameters
        ----------
        rows : (columns, n) values of its columns, or (columns, g, n).
        constants : (g, c) values of those inside.
        """
        rows, constants = np.asarray(rows, dtype=float), np.asarray(constants, dtype=float)
        shape = len(constants), rows.shape[-1]
        # Places that it does not have may hold anything.
        columns = [rows[min(i, len(rows) - 1)] for i in range(len(PLACES))]
        numbers = [*constants.T[:, :, None], *[np.ones((1, 1))] * len(NUMBERS)][: len(NUMBERS)]
        with np.errstate(all="ignore"):
            found = np.asarray(self._program(*columns, *numbers))
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
        columns, constants : what stands for ``v`` and so on, and for ``k`` and so on.
        """
        names = dict(zip(PLACES, columns, strict=False))
        numbers = zip(NUMBERS, map(sympy.Float, constants), strict=False)
        return self.formula.xreplace({**names, **dict(numbers)})


# Starts of a constant beside another one, as multiples of a usual size.
FEW = (0.3, 1.0, 3.0)
_SIZE, _RATE = Inside((1,)), Inside((-1,))
_POWER_APART = Inside((), (0.75, 1.25, 1.75))
_STEEP = Inside((-1,), (1.0, 2.5, 6.0), of_spread=True)
_STEEPNESS = Inside((), (1.5, 3.0, 6.0, 12.0))
_MIDDLE = Inside(at=(0.1, 0.3, 0.5, 0.7, 0.9))


# Multiples of a spread: middles of steps and bumps, and their widths.
_MIDDLES, _WIDTHS = (-1.5, -0.75, 0.0, 0.75, 1.5), (0.15, 0.4, 1.0)
# Powers, and how far beyond the values of a column they begin, as shares of its range.
_POWERS, _BEYOND = (0.5, 1.0, 2.0), (0.03, 0.3, 2.0)
# Radians that a wave turns over the range of its columns.
_WAVES = (1.5, 3.0, 6.0, 12.0)
_NUMBER, _SIGNED = Inside(), Inside(signed=True)


def _ways(columns: int) -> np.ndarray:
    """(d, columns) directions that a line of columns may have."""
    sizes = (-1.0, -0.4, 0.4, 1.0) if columns < 3 else (-1.0, 1.0)
    return np.array([way for way in product(sizes, repeat=columns) if 1.0 in map(abs, way)])


def _begin_steps(rows: np.ndarray) -> np.ndarray:
    """Begin steps along lines of columns: the threshold last."""
    spreads, means = np.std(rows, axis=1), np.mean(rows, axis=1)
    found = []
    for way in _ways(len(rows)):
        along = float(np.std(way @ ((rows - means[:, None]) / spreads[:, None])))
        for wide, at in product(_WIDTHS, _MIDDLES):
            slopes = way / spreads / (wide * max(along, 1e-6))
            found.append((*slopes, float(slopes @ means + at / wide)))
    return np.array(found)


def _begin_waves(rows: np.ndarray) -> np.ndarray:
    ways = [way for way in _ways(len(rows)) if way[0] > 0]
    sizes = [(way, float(np.ptp(way @ rows))) for way in ways]
    return np.array([way * turn / size for way, size in sizes for turn in _WAVES])


def _begin_bumps(rows: np.ndarray) -> np.ndarray:
    mean, spread = float(np.mean(rows)), float(np.std(rows))
    both = product(_WIDTHS, _MIDDLES)
    return np.array([((2 * wide * spread) ** -2, mean + at * spread) for wide, at in both])


def _begin_powers(rows: np.ndarray, end: int, powers: int = 1) -> np.ndarray:
    """Begin powers of how far a column is from an end below (-1) or above it (1): the end last."""
    low, high = float(rows.min()), float(rows.max())
    ends = [(low if end < 0 else high) + end * share * (high - low) for share in _BEYOND]
    return np.array([*product(*[_POWERS] * powers, ends)])


def _begin_cores(rows: np.ndarray) -> np.ndarray:
    length = float(np.median(np.hypot(*rows)))
    return np.array([*product((-0.5, 0.5, 1.0, 1.5, 2.0), (0.1 * length, length))])


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
        (_SIZE, Inside((-1,), FEW)),
        most=2,
    ),
    Atom("scaled sine", sympy.sin(K * V), Domain.TURNING, (_RATE,)),
    Atom("scaled cosine", sympy.cos(K * V), Domain.TURNING, (_RATE,)),
    Atom("phase sine", sympy.sin(V - W), Domain.TURNING, most=0),
    Atom("phase cosine", sympy.cos(V - W), Domain.TURNING, most=0),
    Atom("scaled phase sine", sympy.sin(K * (V - W)), Domain.TURNING, (_RATE,), most=0),
    Atom(
        "tanh of both",
        sympy.tanh(K * V + L * W),
        inside=(_RATE, Inside((0, -1), (-2.0, -0.5, 0.5, 2.0))),
    ),
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
        (_SIZE, Inside((1, -1), FEW)),
        most=2,
    ),
    Atom(
        "activates steeply",
        V**L / (V**L + K**L),
        Domain.POSITIVE,
        (_SIZE, _STEEPNESS),
        rare=True,
    ),
    Atom(
        "step of both",
        1 / (1 + sympy.exp(M - K * V - L * W)),
        inside=(_SIGNED, _SIGNED, _NUMBER),
        start=_begin_steps,
        rare=True,
    ),
    Atom(
        "step of three",
        1 / (1 + sympy.exp(N - K * V - L * W - M * U)),
        inside=(_SIGNED, _SIGNED, _SIGNED, _NUMBER),
        start=_begin_steps,
        rare=True,
    ),
    Atom(
        "bump apart",
        sympy.exp(-K * (V - L) ** 2),
        inside=(Inside((-2,)), _SIGNED),
        start=_begin_bumps,
        rare=True,
    ),
    *(
        Atom(
            f"{name} of both",
            wave(K * V + L * W),
            Domain.TURNING,
            (_SIGNED, _SIGNED),
            start=_begin_waves,
            rare=True,
        )
        for name, wave in (("sine", sympy.sin), ("cosine", sympy.cos))
    ),
    Atom(
        "power from",
        (V - L) ** K,
        inside=(_NUMBER, _SIGNED),
        start=partial(_begin_powers, end=-1),
        rare=True,
    ),
    Atom(
        "power to",
        (L - V) ** K,
        inside=(_NUMBER, _SIGNED),
        start=partial(_begin_powers, end=1),
        rare=True,
    ),
    # Growth that ends where its limit is reached (Blumberg 1968; Tsoularis and Wallace 2002).
    Atom(
        "growth to",
        V**K * (M - V) ** L,
        Domain.POSITIVE,
        (_NUMBER, _NUMBER, _SIGNED),
        start=partial(_begin_powers, end=1, powers=2),
        rare=True,
    ),
    # Of a share that is done, what is left goes on by itself and by what is done (Kamal 1974).
    Atom("left", (1 - V) ** K, Domain.SHARE, (Inside((), _POWERS),), rare=True),
    Atom(
        "done by done",
        V**K * (1 - V) ** L,
        Domain.SHARE,
        (_NUMBER, _NUMBER),
        start=lambda _: np.array([*product(_POWERS, _POWERS)]),
        rare=True,
    ),
    Atom(
        "powers of both",
        V**K * W**L,
        Domain.POSITIVE,
        (_NUMBER, _NUMBER),
        most=0,
        start=lambda _: np.array([*product((-1.0, -0.5, 0.5, 1.5), repeat=2)]),
        rare=True,
    ),
    Atom(
        "softened",
        (V**2 + W**2 + L**2) ** -K,
        Domain.ANY,
        (_NUMBER, _SIGNED),
        start=_begin_cores,
        rare=True,
    ),
    Atom(
        "difference",
        sympy.Abs(V - K * W),
        Domain.BOTH_SIGNS,
        (Inside((), (-1.0, 1.0)),),
        rare=True,
    ),
)
ATOMS: Mapping[str, Atom] = MappingProxyType({atom.name: atom for atom in _TABLE})
