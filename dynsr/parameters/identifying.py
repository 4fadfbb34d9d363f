"""Identifying: which parameters of a system can be known at all, and which combinations of them.

A parameter is structurally identifiable where no other value gives the same outputs, however exact
and dense they are. Whether that is so near a point shows in the rank of the sensitivities of the
outputs by parameters and unknown starts (Sedoglavic 2002, Journal of Symbolic Computation 33, 735):
here those of the coefficients of their power series in the time, at random points and with many
digits, so that rounding is no question. Directions that change no output are the null space. A
product of powers, or a sum of multiples, of parameters is known where no such direction changes it.

What data say of parameters that could be known is less: the information of the joint fit says it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.errors import InputError
from dynsr.expression import parse, shown
from dynsr.fit import Profiling
from dynsr.jobs import check_seed

_START = "{}(0)"


@dataclass(frozen=True)
class IdentifiabilitySettings:
    """The numbers that decide which parameters and combinations count as known.

    Parameters
    ----------
    bits : of steps in time; half as many are right in a sensitivity, and a direction in which
        they vanish to a third of them changes nothing.
    points : random points; an exponent of a product is the same at all of them.
    denominator : largest one of an exponent.
    mixed : parameters, at most, of which some are looked for with the exponential of others.
    powers : exponents in products that data may know though they do not know the factors.
    factors : most factors of such a product.
    """

    bits: int = 200
    points: int = 3
    denominator: int = 6
    mixed: int = 6
    powers: tuple[int, ...] = (-2, -1, 1, 2)
    factors: int = 3


IDENTIFIABILITY: IdentifiabilitySettings = IdentifiabilitySettings()


@dataclass(frozen=True)
class Combination:
    """A combination of parameters that is known though they are not.

    Parameters
    ----------
    expr : the combination.
    error : its relative standard error in the data; 0 where only the structure was asked.
    """

    expr: sympy.Expr
    error: float = 0.0

    @property
    def text(self) -> str:
        """The combination, with its error where data determine it, to be read."""
        return shown(self.expr) + (f" (to {self.error:.2g})" if self.error else "")


@dataclass(frozen=True, repr=False)
class Identifiability:
    """Which parameters of a system can be known, and which combinations of the others.

    Parameters
    ----------
    known : parameters that exact outputs determine.
    unknown : those that they do not, with starts of states that are not measured, as "z(0)".
    combinations : what is known of these: products of powers, sums of multiples, or one times the
        exponential of the other.
    beyond : known functions of them that are not of these forms.
    errors : parameter -> relative standard error in the data; empty where none were asked.
    weak : parameters that could be known, but whose 95 % interval in these data holds 0.
    weak_combinations : products of these that the data know.
    """

    known: tuple[str, ...]
    unknown: tuple[str, ...]
    combinations: tuple[Combination, ...] = ()
    beyond: int = 0
    errors: Mapping[str, float] = field(default_factory=dict)
    weak: tuple[str, ...] = ()
    weak_combinations: tuple[Combination, ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is known and what is not, one sentence each."""
        found = []
        if not self.unknown:
            found.append("Exact data of this kind determine every parameter.")
        else:
            found.append(f"No data of this kind determine {_listed(self.unknown)} alone.")
            found.append(_say_known("They determine", self.combinations, self.beyond))
        if self.weak:
            found.append(f"These data hardly bound {_listed(self.weak)}.")
            found.append(_say_known("They tell", self.weak_combinations))
        return tuple(sentence for sentence in found if sentence)

    def __repr__(self) -> str:
        """Write the sentences."""
        return "\n".join(self.sentences)


def _listed(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _say_known(verb: str, some: Sequence[Combination], beyond: int = 0) -> str:
    texts = [one.text for one in some]
    if beyond:
        texts.append(f"{beyond} more combination{'s' * (beyond > 1)}, of no simple form")
    return f"{verb} {_listed(texts)}." if texts else ""


@checked
def identifiability(
    equations: Mapping[str, str | sympy.Expr],
    *,
    observed: Mapping[str, str | sympy.Expr] | Sequence[str] | None = None,
    inputs: Sequence[str] = (),
    seed: int = 0,
    settings: IdentifiabilitySettings = IDENTIFIABILITY,
) -> Identifiability:
    """Say which parameters of a system its outputs determine, and which combinations of the others.

    Parameters
    ----------
    equations : state -> right-hand side, in states, inputs, ``t`` and parameters: every other name.
    observed : the states that are measured, or output -> expression; all states by default.
    inputs : columns that are known at all times; they are taken to move in any way.
    seed : the random points come from it.
    settings : the numbers that decide.

    It is what holds near almost every point; two values far apart may still give the same outputs.
    Raises InputError when the equations cannot be read or have no parameter.

    >>> identifiability({"x": "a*b*x - c*x**2"})
    No data of this kind determine a and b alone.
    They determine a*b.
    """
    rhs = {state: _read(expr) for state, expr in equations.items()}
    outputs = _read_outputs(observed, rhs) if rhs else {}
    used = {str(s) for e in (*rhs.values(), *outputs.values()) for s in e.free_symbols}
    parameters = sorted(used - {*rhs, *inputs, "t"})
    if not parameters:
        raise InputError("there is no parameter; write one by a name, such as {'x': '-k*x'}")
    return identify(rhs, outputs, parameters, inputs, check_seed(seed), settings)


def _read(expr: str | sympy.Expr) -> sympy.Expr:
    return parse(expr) if isinstance(expr, str) else expr


def _read_outputs(
    observed: Mapping[str, str | sympy.Expr] | Sequence[str] | None, rhs: Mapping[str, sympy.Expr]
) -> dict[str, sympy.Expr]:
    if isinstance(observed, Mapping):
        return {name: _read(expr) for name, expr in observed.items()}
    names = list(rhs) if observed is None else list(observed)
    if odd := [name for name in names if name not in rhs]:
        raise InputError(f"{odd[0]!r} is no state; the states are {', '.join(rhs)}")
    if not names:
        raise InputError("nothing is observed; name a state, or give an output its expression")
    return {name: sympy.Symbol(name) for name in names}


def identify(
    rhs: Mapping[str, sympy.Expr],
    outputs: Mapping[str, sympy.Expr],
    parameters: Sequence[str],
    inputs: Sequence[str],
    seed: int,
    settings: IdentifiabilitySettings = IDENTIFIABILITY,
) -> Identifiability:
    """Say which parameters outputs determine.

    Parameters
    ----------
    rhs, outputs : state and output -> expression.
    parameters, inputs : names.
    seed, settings : as in :func:`identifiability`.
    """
    hidden = [s for s in rhs if sympy.Symbol(s) not in outputs.values()]
    # What can be said of a start is said in parameters: these come last in the reduced form.
    names = [*(_START.format(s) for s in hidden), *parameters]
    system = _Series(rhs, outputs, tuple(parameters), tuple(inputs), settings)
    rng = np.random.default_rng(seed)
    points = [system.draw(rng) for _ in range(settings.points)]
    place = {name: i for i, name in enumerate([*parameters, *map(_START.format, rhs)])}
    own = [place[name] for name in names]
    free = [np.array([v[own] for v in system.null_space(p)], dtype=object) for p in points]
    some = [i for i in range(len(names)) if any(system.moves(v[i]) for f in free for v in f)]
    unknown = tuple(names[i] for i in some)
    known = tuple(name for name in parameters if name not in unknown)
    if not some:
        return Identifiability(known, ())
    values = [np.array([p[own[i]] for i in some], dtype=object) for p in points]
    ways = [f[:, some] for f in free]
    symbols = [sympy.Symbol(name) for name in unknown]
    wanted = len(some) - min(len(f) for f in free)
    found: list[tuple[sympy.Expr, np.ndarray]] = []
    for inside in _coordinates(len(some), settings):
        units = [np.where(inside, v**0, v) for v in values]
        rows = np.concatenate([f / u for f, u in zip(ways, units, strict=True)])
        for powers in system.whole_null_space(rows) if len(found) < wanted else ():
            slope = np.array(powers, dtype=object) / units[0]
            if system.rank([slope, *(own for _, own in found)]) > len(found):
                found.append((_combine(symbols, powers, inside), slope))
    texts = tuple(Combination(expr) for expr, _ in found)
    return Identifiability(known, unknown, texts, wanted - len(texts))


def _coordinates(count: int, settings: IdentifiabilitySettings) -> Iterator[np.ndarray]:
    """Say which parameters count as they are, and which by their logarithm; all by it first."""
    every = itertools.product([False, True], repeat=count)
    order = sorted(every, key=lambda inside: (min(sum(inside), count - sum(inside)), inside))
    for inside in order if count <= settings.mixed else [order[0], (True,) * count]:
        yield np.array(inside)


def _combine(
    symbols: Sequence[sympy.Symbol], powers: Sequence[int], inside: np.ndarray
) -> sympy.Expr:
    """Write a product of powers, a sum of multiples, or one times the exponential of the other."""
    pairs = list(zip(symbols, powers, inside, strict=True))
    whole = sympy.Mul(*(s**p for s, p, own in pairs if not own))
    added = sympy.Add(*(p * s for s, p, own in pairs if own))
    return added if whole == 1 else whole * sympy.exp(added)


@dataclass(frozen=True, eq=False)
class _Series:
    """Power series of the outputs of a system, and what they depend on, with many digits.

    Parameters
    ----------
    rhs, outputs : state and output -> expression.
    parameters, inputs : names.
    settings : the digits.
    """

    rhs: Mapping[str, sympy.Expr]
    outputs: Mapping[str, sympy.Expr]
    parameters: tuple[str, ...]
    inputs: tuple[str, ...]
    settings: IdentifiabilitySettings

    @cached_property
    def _function(self) -> Callable[..., list[Any]]:
        names = [*self.rhs, *self.inputs, "t", *self.parameters]
        symbols = list(map(sympy.Symbol, names))
        dummies = [sympy.Dummy() for _ in symbols]
        put = dict(zip(symbols, dummies, strict=True))
        exprs = [e.xreplace(put) for e in (*self.rhs.values(), *self.outputs.values())]
        # SymPy would take the functions of another context, with fewer digits.
        known = {n: getattr(self._context, n) for n in dir(self._context) if n[0] != "_"}
        found: Callable[..., list[Any]] = sympy.lambdify(
            dummies, exprs, modules=[known, "mpmath"], cse=True
        )
        return found

    @property
    def _unknowns(self) -> int:
        return len(self.parameters) + len(self.rhs)

    @cached_property
    def _context(self) -> Any:
        """Own decimal arithmetic, with the precision that the order of a series needs."""
        import mpmath

        context = mpmath.MPContext()
        context.prec = self.settings.bits
        return context

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """(Q + inputs + 1,) a random point: parameters, starts, coefficients of inputs, the time.

        Parameters
        ----------
        rng : where chance comes from.
        """
        mp, unknowns = self._context, self._unknowns
        count = unknowns + (unknowns + 1) * len(self.inputs) + 1
        return np.array([mp.mpf(1) / 2 + mp.mpf(v) for v in rng.random(count)], dtype=object)

    def null_space(self, point: np.ndarray) -> list[np.ndarray]:
        """Directions of parameters and starts, (Q,) each, that change no output.

        Parameters
        ----------
        point : where.
        """
        order = -(-self._unknowns // len(self.outputs)) + 1
        while True:
            slopes = self._slopes(point, order)
            # The rank grows with every order until it stays for good (Hermann and Krener 1977).
            before = slopes[: order * len(self.outputs)]
            if self.rank(before) == self.rank(slopes) or order > self._unknowns:
                return self._null_space(slopes)
            order *= 2

    def _slopes(self, point: np.ndarray, order: int) -> np.ndarray:
        """(outputs * (order + 1), Q) what parameters and starts do to the outputs' series."""
        mp = self._context
        # Differences of that order lose as many digits as often as they are taken.
        mp.prec = self.settings.bits * (order + 2)
        step = mp.ldexp(1, -(self.settings.bits // 2))
        base = self._coefficients(point, order)
        slopes = []
        for i in range(self._unknowns):
            moved = point.copy()
            moved[i] = moved[i] + step
            slopes.append((self._coefficients(moved, order) - base) / step)
        return np.array(slopes, dtype=object).T

    def _coefficients(self, point: np.ndarray, order: int) -> np.ndarray:
        """(outputs * (order + 1),) coefficients of the outputs' series in the time.

        Coefficient n of a right-hand side is a difference of order n along the series of the states
        so far, over steps so small that what it is off by is beyond the digits asked for.
        """
        mp, last = self._context, self._unknowns
        count, k = len(self.parameters), len(self.rhs)
        parameters, states = point[:count], [[value] for value in point[count:last]]
        drives = np.array_split(point[last:-1], len(self.inputs)) if self.inputs else []
        start = point[-1]
        h = mp.ldexp(1, -self.settings.bits)
        outputs: list[Any] = []
        for n in range(order + 1):
            rows = []
            for j in range(n + 1):
                at = j * h
                x = [mp.polyval(own[::-1], at) for own in states]
                u = [mp.polyval(list(own)[::-1], at) for own in drives]
                rows.append(self._function(*x, *u, start + at, *parameters))
            signs = [(-1) ** (n - j) * math.comb(n, j) for j in range(n + 1)]
            scale = mp.factorial(n) * h**n
            sums = [
                mp.fsum(s * row[i] for s, row in zip(signs, rows, strict=True)) / scale
                for i in range(k + len(self.outputs))
            ]
            outputs += sums[k:]
            for own, slope in zip(states, sums[:k], strict=True):
                own.append(slope / (n + 1))
        return np.array(outputs, dtype=object)

    @cached_property
    def _nothing(self) -> Any:
        return self._context.ldexp(1, -(self.settings.bits // 3))

    def moves(self, value: Any) -> bool:
        """Whether a part of a direction is more than rounding.

        Parameters
        ----------
        value : the part; the largest of a direction is about 1.
        """
        return bool(abs(value) > self._nothing)

    def _reduce(self, rows: np.ndarray) -> tuple[np.ndarray, list[int]]:
        """Reduced rows, and the column of the pivot of each, the largest remaining entry."""
        left = np.array([row / size for row in rows if (size := max(map(abs, row)))], dtype=object)
        pivots: list[int] = []
        for r in range(min(left.shape) if left.size else 0):
            columns = [j for j in range(left.shape[1]) if j not in pivots]
            size, i, j = max((abs(left[i, j]), i, j) for i in range(r, len(left)) for j in columns)
            if size <= self._nothing:
                break
            left[[r, i]] = left[[i, r]]
            left[r] = left[r] / left[r, j]
            for other in range(len(left)):
                if other != r:
                    left[other] = left[other] - left[other, j] * left[r]
            pivots.append(j)
        return left[: len(pivots)], pivots

    def rank(self, rows: Sequence[np.ndarray] | np.ndarray) -> int:
        """Count independent rows.

        Parameters
        ----------
        rows : (Q,) each.
        """
        return len(self._reduce(np.array(rows, dtype=object))[1])

    def _null_space(self, rows: np.ndarray) -> list[np.ndarray]:
        """Basis of the null space of the rows; each vector has a 1 and factors of pivots."""
        reduced, pivots = self._reduce(rows)
        found = []
        for j in range(rows.shape[1]):
            if j not in pivots:
                vector = np.array([self._context.mpf(0)] * rows.shape[1], dtype=object)
                vector[j] = self._context.mpf(1)
                for row, pivot in zip(reduced, pivots, strict=True):
                    vector[pivot] = -row[j]
                found.append(vector)
        return found

    def whole_null_space(self, rows: np.ndarray) -> list[tuple[int, ...]]:
        """Give independent vectors of whole numbers that all rows send to 0, in reduced form.

        Parameters
        ----------
        rows : (n, U) directions.
        """
        whole = []
        for vector in self._null_space(rows):
            parts = [
                Fraction(float(v)).limit_denominator(self.settings.denominator) for v in vector
            ]
            exact = [self._context.mpf(p.numerator) / p.denominator for p in parts]
            if not any(self.moves(v - e) for v, e in zip(vector, exact, strict=True)):
                whole.append([sympy.Rational(p.numerator, p.denominator) for p in parts])
        if not whole:
            return []
        # Pivots follow the random point; the reduced form of what they span does not.
        reduced = sympy.Matrix(whole).rref()[0].tolist()
        common = [math.lcm(*(int(v.q) for v in row)) for row in reduced]
        return [tuple(int(v * c) for v in row) for row, c in zip(reduced, common, strict=True)]


def with_data(
    structure: Identifiability,
    names: Sequence[str],
    profiling: Profiling,
) -> Identifiability:
    """Say what data determine of parameters that could be known.

    Parameters
    ----------
    structure : what could be known.
    names : of the parameters of the fit.
    profiling : the fit.
    """
    values = np.abs(profiling.values)
    with np.errstate(all="ignore"):
        errors = np.where(values > 0, profiling.errors / values, math.inf)
    told = dict(zip(names, errors.tolist(), strict=True))
    most = 1 / profiling.reach
    weak = [i for i, name in enumerate(names) if name in structure.known and errors[i] > most]
    some = tuple(_known_products(names, weak, values, profiling, most))
    return Identifiability(
        structure.known,
        structure.unknown,
        structure.combinations,
        structure.beyond,
        told,
        tuple(names[i] for i in weak),
        some,
    )


def _known_products(
    names: Sequence[str],
    weak: Sequence[int],
    values: np.ndarray,
    profiling: Profiling,
    most: float,
) -> Iterator[Combination]:
    """Give the products of powers of weak parameters that data know best, independent ones."""
    spread = profiling.relative_spread(values, weak)
    places, tried = range(len(weak)), []
    for count in range(2, min(IDENTIFIABILITY.factors, len(weak)) + 1):
        for some in itertools.combinations(places, count):
            for powers in itertools.product(IDENTIFIABILITY.powers, repeat=count):
                if powers[0] > 0 and math.gcd(*powers) == 1:
                    vector = np.zeros(len(weak))
                    vector[list(some)] = powers
                    error = math.sqrt(max(float(vector @ spread @ vector), 0.0))
                    tried.append((error, count, tuple(map(int, vector))))
    symbols = [sympy.Symbol(names[i]) for i in weak]
    taken: list[tuple[int, ...]] = []
    for error, _, own in sorted(tried):
        if error > most or len(taken) == len(weak) - 1:
            break
        if np.linalg.matrix_rank(np.array([*taken, own])) > len(taken):
            taken.append(own)
            yield Combination(sympy.Mul(*(s**p for s, p in zip(symbols, own, strict=True))), error)
