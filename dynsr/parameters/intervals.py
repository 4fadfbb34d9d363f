"""Intervals: the constants of an equation in the order in which they are read, each with its own.

The order in which SymPy keeps the constants of a formula is not that in which it prints them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import sympy

from dynsr.errors import InputError
from dynsr.expression import free_constants, marks, shown
from dynsr.fit import loosen, tidy


@dataclass(frozen=True, repr=False)
class Constant:
    """One constant of an equation.

    Parameters
    ----------
    value : the number that the equation holds.
    fitted : the number before it was made a simple one.
    low, high : the ends of its 95 % interval; None where the data do not determine it. A number
        that further constants determine together with it may be beyond; the interval reaches to it.
    of : the term that it multiplies, "1" for one alone, or the function that it is in.
    error : its standard error; inf where the data do not determine it.
    profiled : whether the interval is that of the profile likelihood, since the one by the standard
        error is wrong there. One end alone may then be unknown: the data leave that side open.
    """

    value: float
    fitted: float
    low: float | None
    high: float | None
    of: str
    error: float = math.inf
    profiled: bool = False

    def __repr__(self) -> str:
        """Write the constant, its interval and its term."""
        return f"<{self.text} of {self.of}>"

    @property
    def fixed(self) -> bool:
        """Whether it is a number of the form, such as 1 before a parameter, and was not fitted."""
        return self.error == 0

    @property
    def text(self) -> str:
        """The constant and its interval, to be read."""
        kept = "" if _close(self.fitted, self.value) else f", fitted {self.fitted_text}"
        return f"{self.value:.6g} ({self.interval_text}{kept})"

    @property
    def fitted_text(self) -> str:
        """The fitted number, with as many digits as its interval supports."""
        return f"{self.fitted:.{_digits_of(self.low, self.high)}g}"

    @property
    def interval_text(self) -> str:
        """The interval, to be read."""
        return write_interval(self.low, self.high)


def leave_unknown(found: object) -> None:
    """Take ends that are not finite, as a file has those that are unknown, for unknown."""
    for name in ("low", "high"):
        end = getattr(found, name)
        if end is not None and not math.isfinite(end):
            object.__setattr__(found, name, None)


def write_interval(low: float | None, high: float | None) -> str:
    """Write an interval to be read.

    Parameters
    ----------
    low, high : its ends; None for a side that is open.

    >>> write_interval(0.98765, 1.02345), write_interval(0.5, None), write_interval(None, None)
    ('0.9877 to 1.023', '0.5 or more', 'unknown')
    >>> write_interval(1.5 - 3e-12, 1.5 + 3e-12)
    '1.499999999997 to 1.500000000003'
    """
    if low is None and high is None:
        return "unknown"
    if low is None:
        return f"{high:.3g} or less"
    if high is None:
        return f"{low:.3g} or more"
    digits = _digits_of(low, high)
    return f"{low:.{digits}g} to {high:.{digits}g}"


def _digits_of(low: float | None, high: float | None) -> int:
    """Digits enough that the ends of an interval differ in the last two."""
    if low is None or high is None or not 0 < high - low < math.inf:
        return 6
    size = max(abs(low), abs(high))
    # A float has no more digits.
    most = sys.float_info.dig + 2
    return min(most, max(2, math.ceil(math.log10(size / (high - low))) + 2))


def _close(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-300)


def list_constants(
    expr: sympy.Expr,
    errors: Sequence[tuple[float, float]],
    fitted: Sequence[float] | None = None,
    reach: float = 1.96,
    ends: Sequence[tuple[float, float] | None] = (),
) -> tuple[Constant, ...]:
    """Give the constants of an equation in the order of its printed text.

    Parameters
    ----------
    expr : the equation.
    errors : (value, standard error) of its constants in the order in which SymPy keeps them.
    fitted : their values before they were made simple numbers, in the same order.
    reach : standard errors that a 95 % interval reaches to either side.
    ends : intervals in the place of these, in the order of the printed text; None keeps one,
        inf is for a side that is open.

    >>> x, y = sympy.symbols("x y")
    >>> found = list_constants(2 * x - 3 * x * y, [(-3.0, 0.1), (2.0, 0.2)])
    >>> [constant.value for constant in found]
    [-3.0, 2.0]
    >>> str(2 * x - 3 * x * y)
    '-3*x*y + 2*x'
    """
    template, values = take_apart(expr)
    kept = list(values.values())
    before = list(fitted or ())
    before = before if len(before) == len(errors) else [value for value, _ in errors]
    known = [(v, e, f) for (v, e), f in zip(errors, before, strict=True)]
    paired, found = _pair(kept, known), []
    for i in printed_order(template, values):
        error, middle = paired[i]
        beside = reach * error
        low, high = (middle - beside, middle + beside) if math.isfinite(beside) else (None, None)
        home = _home(template, list(values), i, kept)
        found.append(_reaching(Constant(kept[i], middle, low, high, home, error)))
    if len(ends) == len(found):
        found = [_with_ends(one, pair) for one, pair in zip(found, ends, strict=True)]
    return tuple(found)


def _with_ends(constant: Constant, ends: tuple[float, float] | None) -> Constant:
    if ends is None:
        return constant
    low, high = (end if math.isfinite(end) else None for end in ends)
    return replace(_reaching(replace(constant, low=low, high=high)), profiled=True)


def _reaching(constant: Constant) -> Constant:
    """Let an interval reach to the number that is in the equation."""
    low, high, value = constant.low, constant.high, constant.value
    return replace(
        constant,
        low=None if low is None else min(low, value),
        high=None if high is None else max(high, value),
    )


def printed_places(expr: sympy.Expr) -> list[int]:
    """Give the place that each printed constant of an equation has among those of its loose form.

    Parameters
    ----------
    expr : the equation; :func:`dynsr.fit.loosen_all` makes it loose.

    >>> x, y = sympy.symbols("x y")
    >>> printed_places(2 * x - 3 * x * y)
    [1, 0]
    """
    return printed_order(*take_apart(expr))


def home_of(expr: sympy.Expr, index: int) -> str:
    """Say which term a constant belongs to.

    Parameters
    ----------
    expr : the equation.
    index : the place of the constant in its printed text.
    """
    template, values = take_apart(expr)
    place = printed_order(template, values)[index]
    return _home(template, list(values), place, list(values.values()))


def take_apart(expr: sympy.Expr) -> tuple[sympy.Expr, dict[sympy.Symbol, float]]:
    """Give an equation with symbols in the places of its constants, and what these stand for.

    Parameters
    ----------
    expr : the equation; a bare column, q' = v, and 0 are structure.
    """
    plain = expr.is_Symbol or expr == 0
    return free_constants(expr if plain else loosen(expr), "constant ")


def match_constants(
    equations: Mapping[str, sympy.Expr],
    numbers: Sequence[tuple[float, float, float]],
    known: Mapping[str, float] = MappingProxyType({}),
) -> tuple[dict[str, tuple[tuple[float, float], ...]], dict[str, tuple[float, ...]]]:
    """Give state -> (value, standard error), and fitted value, of the constants of equations.

    Parameters
    ----------
    equations : state -> equation.
    numbers : (value, standard error, fitted value) of the constants of all equations.
    known : state -> a constant without an error. Any other that is not among the numbers has an
        error that nobody knows.

    >>> x = sympy.Symbol("x")
    >>> match_constants({"x": 3 * x - x**2}, [(3.0, 0.1, 2.98)])
    ({'x': ((3.0, 0.1), (-1.0, inf))}, {'x': (2.98, -1.0)})
    """
    errors: dict[str, tuple[tuple[float, float], ...]] = {}
    fitted: dict[str, tuple[float, ...]] = {}
    left = list(numbers)
    for state, expr in equations.items():
        pairs = []
        chosen = [known[state]] if state in known else []
        for value in take_apart(expr)[1].values():
            near = next((one for one in left if math.isclose(one[0], value)), None)
            if near is not None:
                left.remove(near)
            elif value in chosen:
                chosen.remove(value)
                near = value, 0.0, value
            pairs.append(near or (value, math.inf, value))
        errors[state] = tuple((value, error) for value, error, _ in pairs)
        fitted[state] = tuple(own for *_, own in pairs)
    return errors, fitted


def put_constants(expr: sympy.Expr, values: Sequence[float]) -> sympy.Expr:
    """Give the equation with other numbers for its constants.

    Parameters
    ----------
    expr : the equation.
    values : one finite number a constant, in the order of :func:`list_constants`.

    Raises InputError when there are not as many, or one is not finite.

    >>> x, y = sympy.symbols("x y")
    >>> put_constants(2 * x - 3 * x * y, [-1.5, 4.0])
    -1.5*x*y + 4.0*x
    """
    template, known = take_apart(expr)
    order = printed_order(template, known)
    if len(values) != len(order) or not all(map(math.isfinite, values)):
        raise InputError(
            f"{list(values)!r} are not {len(order)} finite numbers; give one a constant"
        )
    symbols = list(known)
    return template.xreplace(
        {symbols[i]: sympy.Float(float(v)) for i, v in zip(order, values, strict=True)}
    )


def _home(
    template: sympy.Expr,
    symbols: Sequence[sympy.Symbol],
    index: int,
    values: Sequence[float],
) -> str:
    """Say which term a constant belongs to."""
    mine = symbols[index]
    top, bottom = sympy.fraction(template)
    numbers = {s: sympy.Float(v) for s, v in zip(symbols, values, strict=True)}
    for part, above in ((top, True), (bottom, False)):
        for term in sympy.Add.make_args(part):
            if mine not in term.free_symbols:
                continue
            factors = [f for f in sympy.Mul.make_args(term) if f != mine]
            inside = next((f for f in factors if mine in f.free_symbols), None)
            rest = inside if inside is not None else sympy.Mul(*factors)
            words = shown(tidy(rest.xreplace(numbers)))
            return words if above else f"{words} in the denominator"
    return "1"


def _pair(
    values: Sequence[float], known: Sequence[tuple[float, float, float]]
) -> list[tuple[float, float]]:
    """Give each value its (error, fitted value): by its place, or where that differs by its number.

    ``known`` are (value, error, fitted value).
    """
    if len(values) == len(known) and all(map(_close, values, [k[0] for k in known])):
        return [(error, middle) for _, error, middle in known]
    left, found = list(known), []
    for value in values:
        match = next((k for k in left if math.isclose(k[0], value, rel_tol=1e-4)), None)
        if match is not None:
            left.remove(match)
        found.append(match[1:] if match else (math.inf, value))
    return found


def printed_order(template: sympy.Expr, values: dict[sympy.Symbol, float]) -> list[int]:
    """Give the places of constants in the order in which the formula is printed.

    Parameters
    ----------
    template : the formula with symbols in the places of its constants.
    values : symbol -> the number that it stands for.
    """
    # A number of its own for each constant shows where it stands.
    pairs = list(zip(values.items(), marks(len(values)), strict=True))
    signed = {symbol: -mark if value < 0 else mark for (symbol, value), mark in pairs}
    text = shown(template.xreplace(signed), 12)
    places = [text.find(f"{float(mark):.12g}") for _, mark in pairs]
    return sorted(range(len(places)), key=lambda i: (places[i] < 0, places[i], i))
