"""Parameters: the constants of found equations as parameters that have names.

Constants that are one, such as what leaves one state for another, are one parameter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import System
from dynsr.errors import InputError, quoted, say_near
from dynsr.expression import check_name, slope_latex, to_latex_formula, write_line
from dynsr.fit import ROUNDING, pairs_alike
from dynsr.parameters.intervals import (
    Constant,
    leave_unknown,
    list_constants,
    printed_order,
    take_apart,
    write_interval,
)

if TYPE_CHECKING:
    import pandas as pd

# Letters before the numbers of parameters; the first that is no other name's beginning.
_LETTERS = ("k", "p", "c", "par", "parameter_")

Names = Mapping[str, Sequence[str]]


@checked
@dataclass(frozen=True)
class Parameter:
    """One parameter of found equations.

    Parameters
    ----------
    name : what it is called.
    value : the number that it stands for.
    error : its standard error; inf where the data do not determine it.
    low, high : the ends of its 95 % interval; None where the data do not determine it.
    unit : its unit; "" where the columns have none.
    of : the term that it belongs to, in the first equation that contains it.
    states : the states whose equations hold it.
    """

    name: str
    value: float
    error: float = math.inf
    low: float | None = None
    high: float | None = None
    unit: str = ""
    of: str = ""
    states: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Take ends that are not finite for unknown."""
        leave_unknown(self)

    @property
    def interval_text(self) -> str:
        """The interval, to be read."""
        return write_interval(self.low, self.high)


@checked
class Parameters(Mapping[str, Parameter]):
    """The parameters of a system by their names, in the order of the equations.

    Parameters
    ----------
    found : the parameters.

    >>> Parameters([Parameter("k1", 0.5, 0.01, 0.48, 0.52, "1/s", "x", ("x",))])
    name  value  standard error  95 % interval  unit  term
    k1    0.5    0.01            0.48 to 0.52   1/s   x of x'
    """

    def __init__(self, found: Sequence[Parameter]) -> None:
        self._found = {parameter.name: parameter for parameter in found}

    def __getitem__(self, name: str) -> Parameter:
        """Give the parameter of that name; raises KeyError that names those that there are."""
        try:
            return self._found[name]
        except KeyError:
            raise KeyError(_say_unknown(name, self._found)) from None

    def __iter__(self) -> Iterator[str]:
        """Go through the names."""
        return iter(self._found)

    def __len__(self) -> int:
        """Count the parameters."""
        return len(self._found)

    @property
    def numbers(self) -> dict[str, float]:
        """Name -> value."""
        return {name: parameter.value for name, parameter in self._found.items()}

    def rows(self) -> list[tuple[str, ...]]:
        """Give (name, value, error, interval, unit, place) of each that was fitted, to be read."""
        return [
            (
                p.name,
                f"{p.value:.6g}",
                f"{p.error:.2g}" if math.isfinite(p.error) else "unknown",
                p.interval_text,
                p.unit,
                f"{p.of} of {', '.join(s + chr(39) for s in p.states)}",
            )
            for p in self._found.values()
            if p.error > 0
        ]

    def to_frame(self) -> pd.DataFrame:
        """Give a frame of pandas, one row a parameter.

        >>> Parameters([Parameter("k1", 0.5)]).to_frame().loc["k1", "value"].item()
        0.5
        """
        import pandas as pd

        columns = ("value", "error", "low", "high", "unit", "of", "states")
        rows = [[getattr(p, name) for name in columns] for p in self._found.values()]
        return pd.DataFrame(rows, index=pd.Index(self._found, name="name"), columns=columns)

    def to_latex(self) -> str:
        r"""Write a table in LaTeX, the names as in formulas.

        >>> print(Parameters([Parameter("k1", 0.5)]).to_latex())
        \begin{tabular}{lrrl}
        parameter & value & standard error & 95\% interval \\
        \hline
        $k_{1}$ & 0.5 & unknown & unknown \\
        \end{tabular}
        """
        united = any(p.unit for p in self._found.values())
        head = ["parameter", "value", "standard error", r"95\% interval", *["unit"] * united]
        rows = [
            [f"${to_latex_formula(sympy.Symbol(name))}$", *row, *[_escape_latex(unit)] * united]
            for name, *row, unit, _ in self.rows()
        ]
        body = "\n".join(" & ".join(row) + r" \\" for row in rows)
        columns = "lrrl" + "l" * united
        first = " & ".join(head) + r" \\"
        return f"\\begin{{tabular}}{{{columns}}}\n{first}\n\\hline\n{body}\n\\end{{tabular}}"

    def __repr__(self) -> str:
        """Write a table."""
        columns = [column for column in zip(_HEAD, *self.rows(), strict=True) if any(column[1:])]
        return "\n".join(in_columns(list(zip(*columns, strict=True))))

    def _repr_html_(self) -> str:
        return as_html(_HEAD, self.rows())


def in_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Give the lines of a table whose columns are as wide as their longest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def as_html(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Give a table as HTML."""
    lines = [
        f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in row)}</tr>"
        for tag, row in [("th", head), *(("td", row) for row in rows)]
    ]
    return f"<table>{''.join(lines)}</table>"


def _escape_latex(text: str) -> str:
    return "".join(f"\\{sign}" if sign in "&%$#_{}^" else sign for sign in text)


_HEAD = ("name", "value", "standard error", "95 % interval", "unit", "term")


def _say_unknown(name: object, known: Mapping[str, Any]) -> str:
    names, hint = ", ".join(known) or "none", say_near(name, known)
    return f"unknown parameter {str(name)!r}{hint}; the parameters are: {names}"


@checked
@dataclass(frozen=True, repr=False)
class ParametricSystem:
    """Equations with parameters that have names: what is simulated, fitted or written elsewhere.

    Parameters
    ----------
    equations : state -> right-hand side in states, inputs, parameters and ``t``.
    parameters : name -> parameter.
    inputs : input -> expression in ``t``, None where it was measured.
    x0 : state -> value at the first time.
    span : (first, last) time.
    step : from one time to the next.
    name : what to call it.
    time_unit : the unit of the times; "" where the data did not say it.
    units : column -> its unit, where units were given.
    discrete : whether it is a map from row to row.

    Raises InputError where a first value is of a state that has no equation.

    >>> x, k = sympy.symbols("x k")
    >>> decay = ParametricSystem({"x": -k * x}, Parameters([Parameter("k", 2.0)]))
    >>> decay
    x' = -k*x, k = 2
    >>> decay.with_parameters(k=3.0).in_numbers
    {'x': -3.0*x}
    """

    equations: Mapping[str, sympy.Expr]
    parameters: Parameters
    inputs: Mapping[str, sympy.Expr | None] = field(default_factory=dict)
    x0: Mapping[str, float] = field(default_factory=dict)
    span: tuple[float, float] = (0.0, 10.0)
    step: float = 0.01
    name: str = "found"
    time_unit: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    discrete: bool = False

    def __post_init__(self) -> None:
        """Check that first values are of states; raises InputError."""
        if odd := self.x0.keys() - self.equations.keys():
            raise InputError(f"x0 has a value for {quoted(min(odd))}, which has no equation")

    @classmethod
    def of(cls, system: System) -> ParametricSystem:
        """Give a system of the catalogue, or of your own, with names for its constants.

        Parameters
        ----------
        system : the system.

        >>> ParametricSystem.of(System.from_strings({"x": "3*x - 2*x*y", "y": "2*x*y - y"}))
        x' = -k1*x*y + k2*x, y' = k1*x*y - k3*y, k1 = 2, k2 = 3, k3 = 1
        """
        equations = dict(zip(system.states, system.rhs, strict=True))
        names = name_constants(equations, system.inputs)
        constants = {state: list_constants(expr, ()) for state, expr in equations.items()}
        return cls(
            put_names(equations, names)[0],
            list_parameters(equations, names, constants),
            dict(system.inputs),
            dict(zip(system.states, system.x0, strict=True)),
            system.train,
            system.step,
            system.name,
        )

    @cached_property
    def in_numbers(self) -> dict[str, sympy.Expr]:
        """State -> right-hand side with the numbers of the parameters."""
        put = {sympy.Symbol(n): sympy.Float(v) for n, v in self.parameters.numbers.items()}
        return {state: expr.xreplace(put) for state, expr in self.equations.items()}

    def with_parameters(self, **values: float) -> ParametricSystem:
        """Give the same system with other values; their errors are those no more.

        Parameters
        ----------
        values : parameter -> its value.

        Raises InputError when there is no such parameter or a value is no finite number.
        """
        check_values(values, self.parameters)
        changed = [
            Parameter(n, float(values[n]), unit=p.unit, of=p.of, states=p.states)
            if n in values
            else p
            for n, p in self.parameters.items()
        ]
        return replace(self, parameters=Parameters(changed))

    def to_system(self) -> System:
        """Give it as a :class:`dynsr.System` with numbers, from its start and over its times.

        Raises InputError when it is a map, or an input is known by its measured values alone.

        >>> ParametricSystem.of(System.from_strings({"x": "-2*x"})).to_system().rhs
        (-2.0*x,)
        """
        if self.discrete:
            raise InputError("a map is no system of differential equations; iterate it")
        inputs = {name: expr for name, expr in self.inputs.items() if expr is not None}
        if missing := [name for name in self.inputs if name not in inputs]:
            raise InputError(
                f"input {missing[0]!r} is known by its measured values alone; use found.simulate"
            )
        start, end = self.span
        numbers = self.in_numbers
        return System(
            self.name,
            tuple(numbers),
            tuple(numbers.values()),
            tuple(self.x0.get(state, 1.0) for state in numbers),
            inputs,
            train=self.span,
            test=(end, end + (end - start) / 2),
            step=self.step,
        )

    def _repr_html_(self) -> str:
        """Show the equations with names, and a table of what these stand for, in a notebook."""
        left = _next_latex if self.discrete else slope_latex
        lines = [
            f"<p>$\\displaystyle {left(state)} = "
            f"{to_latex_formula(expr, first=self.parameters)}$</p>"
            for state, expr in self.equations.items()
        ]
        return "".join(lines) + self.parameters._repr_html_()

    def __repr__(self) -> str:
        """Write the equations with names, and what these stand for."""
        lines = [
            write_line(state, e, self.discrete, first=self.parameters)
            for state, e in self.equations.items()
        ]
        values = [f"{name} = {value:.6g}" for name, value in self.parameters.numbers.items()]
        return ", ".join([*lines, *values])


def _next_latex(state: str) -> str:
    return f"{{{to_latex_formula(sympy.Symbol(state))}}}_{{n+1}}"


def check_values(values: Mapping[str, float], known: Mapping[str, Any]) -> None:
    """Raise InputError where a parameter is unknown or its value is no finite number.

    Parameters
    ----------
    values : parameter -> its new value.
    known : the names that there are.
    """
    for name, value in values.items():
        if name not in known:
            raise InputError(_say_unknown(name, known))
        number = isinstance(value, (int, float, np.integer, np.floating))
        if not number or isinstance(value, bool) or not math.isfinite(value):
            raise InputError(f"parameter {name!r} is {value!r}; give a finite number")


def name_constants(
    equations: Mapping[str, sympy.Expr], others: Sequence[str] | Mapping[str, Any] = ()
) -> dict[str, tuple[str, ...]]:
    """Name the constants of equations k1, k2, ... in the order in which they are read.

    Parameters
    ----------
    equations : state -> right-hand side with numbers.
    others : names that are taken in addition to those of the equations.

    A sign before a name says that the constant is minus the parameter. Constants of one value at
    one place of like terms are one parameter.

    >>> x, y = sympy.symbols("x y")
    >>> name_constants({"x": 2 * x - 3 * x * y, "y": 3 * x * y - y})
    {'x': ('-k1', 'k2'), 'y': ('k1', '-k3')}
    """
    parts = {state: _read(state, expr) for state, expr in equations.items()}
    shapes = {state: template for state, (template, _) in parts.items()}
    values = {symbol: v for _, own in parts.values() for symbol, v in own.items()}
    order = [
        symbol
        for template, own in parts.values()
        for symbol in (list(own)[i] for i in printed_order(template, own))
    ]
    places = {symbol: i for i, symbol in enumerate(order)}
    leader = list(range(len(order)))
    for pair in pairs_alike(shapes, order):
        one, other = sorted(leader[i] for i in pair)
        sizes = [abs(values[order[i]]) for i in (one, other)]
        if math.isclose(*sizes, rel_tol=ROUNDING):
            leader = [one if i == other else i for i in leader]
    used = {str(s) for e in equations.values() for s in e.free_symbols} | {*equations, *others}
    letter = next(a for a in _LETTERS if not any(_is_numbered(name, a) for name in used))
    numbers = {i: n for n, i in enumerate(sorted(set(leader)), 1)}
    names = {
        symbol: f"{'-' if values[symbol] < 0 else ''}{letter}{numbers[leader[places[symbol]]]}"
        for symbol in order
    }
    return {
        state: tuple(names[list(own)[i]] for i in printed_order(template, own))
        for state, (template, own) in parts.items()
    }


def _is_numbered(name: str, letter: str) -> bool:
    return name.startswith(letter) and name[len(letter) :].isdigit()


def _read(state: str, expr: sympy.Expr) -> tuple[sympy.Expr, dict[sympy.Symbol, float]]:
    """Take the constants out, each as a symbol of its own in all the equations."""
    template, values = take_apart(expr)
    own = {symbol: sympy.Symbol(f"constant {state} {i}") for i, symbol in enumerate(values)}
    return template.xreplace(own), {own[symbol]: value for symbol, value in values.items()}


def find_names(system: ParametricSystem) -> dict[str, tuple[str, ...]]:
    """Give the names of the constants of a system in numbers; nothing where they are unknown.

    Parameters
    ----------
    system : the system; a parameter that is alone in a place is found again by its value.

    >>> x, rate = sympy.symbols("x rate")
    >>> find_names(ParametricSystem({"x": -rate * x}, Parameters([Parameter("rate", 2.0)])))
    {'x': ('-rate',)}
    """
    names: dict[str, tuple[str, ...]] = {}
    for state, expr in system.in_numbers.items():
        own = {str(s) for s in system.equations[state].free_symbols} & set(system.parameters)
        template, values = take_apart(expr)
        found = []
        for place in printed_order(template, values):
            value = list(values.values())[place]
            near = [
                f"{'-' if math.copysign(1.0, system.parameters[n].value) * value < 0 else ''}{n}"
                for n in sorted(own)
                if math.isclose(abs(system.parameters[n].value), abs(value), rel_tol=ROUNDING)
            ]
            if len(near) != 1:
                return {}
            found += near
        names[state] = tuple(found)
    return names if fits(system.in_numbers, names) else {}


def fits(equations: Mapping[str, sympy.Expr], names: Names) -> bool:
    """Whether names are as many as the constants, and one name stands for one value.

    Parameters
    ----------
    equations : state -> right-hand side with numbers.
    names : state -> the names of its constants, as :func:`name_constants` gives them.
    """
    if set(names) != set(equations):
        return False
    try:
        named, signed = put_names(equations, names)
    except (InputError, ValueError):
        return False
    taken = {str(s) for e in equations.values() for s in e.free_symbols} | {*equations, "t"}
    alike = all(math.isclose(v, own[0], rel_tol=ROUNDING) for own in signed.values() for v in own)
    return bool(named) and alike and not taken & signed.keys()


def put_names(
    equations: Mapping[str, sympy.Expr], names: Names
) -> tuple[dict[str, sympy.Expr], dict[str, list[float]]]:
    """Give the equations with named parameters, and name -> its value at each place.

    Parameters
    ----------
    equations : state -> right-hand side with numbers.
    names : state -> the names of its constants.
    """
    named: dict[str, sympy.Expr] = {}
    signed: dict[str, list[float]] = {}
    for state, expr in equations.items():
        template, values = _read(state, expr)
        put = {}
        order = printed_order(template, values)
        for i, text in zip(order, names[state], strict=True):
            symbol = list(values)[i]
            sign, name = _signed(text)
            put[symbol] = sign * sympy.Symbol(check_name(name, "parameter"))
            signed.setdefault(name, []).append(sign * values[symbol])
        named[state] = template.xreplace(put)
    return named, signed


def _signed(text: str) -> tuple[int, str]:
    return (-1, text[1:]) if text.startswith("-") else (1, text)


def put_values(
    equations: Mapping[str, sympy.Expr], names: Names, values: Mapping[str, float]
) -> tuple[dict[str, sympy.Expr], dict[str, tuple[str, ...]]]:
    """Give the equations with other values of parameters, and the names of the rest.

    Parameters
    ----------
    equations : state -> right-hand side with numbers.
    names : state -> the names of its constants.
    values : parameter -> its new value; one that is 0 leaves no constant.
    """
    changed, left = {}, {}
    for state, expr in equations.items():
        template, numbers = _read(state, expr)
        order = [list(numbers)[i] for i in printed_order(template, numbers)]
        called = dict(zip(order, names[state], strict=True))
        for symbol, text in called.items():
            sign, name = _signed(text)
            if name in values:
                numbers[symbol] = sign * float(values[name])
        if not any(name in values for _, name in map(_signed, called.values())):
            changed[state], left[state] = expr, tuple(names[state])
            continue
        rest = template.xreplace({s: sympy.S.Zero for s, v in numbers.items() if v == 0})
        if rest.has(sympy.zoo, sympy.nan, sympy.oo):
            zero = next(_signed(t)[1] for s, t in called.items() if numbers[s] == 0)
            raise InputError(
                f"parameter {zero!r} of {state} cannot be 0: the formula has no value then"
            )
        kept = {s: v for s, v in numbers.items() if s in rest.free_symbols}
        changed[state] = rest.xreplace({s: sympy.Float(v) for s, v in kept.items()})
        left[state] = tuple(called[list(kept)[i]] for i in printed_order(rest, kept))
    return changed, left


def rename(names: Names, new: Mapping[str, str], taken: Sequence[str]) -> dict[str, Any]:
    """Give the names of constants with some of them changed.

    Parameters
    ----------
    names : state -> the names of its constants.
    new : name -> the new one.
    taken : names that are no parameter's: states, inputs, the time.

    Raises InputError when there is no such parameter, or a new name is another's already.

    >>> rename({"x": ("k1", "-k2")}, {"k2": "loss"}, ["x", "t"])
    {'x': ('k1', '-loss')}
    """
    known = {_signed(text)[1]: None for own in names.values() for text in own}
    for old, name in new.items():
        if old not in known:
            raise InputError(_say_unknown(old, known))
        check_name(name, "parameter")
        if name in taken:
            raise InputError(f"parameter {name!r} is named as a state, an input or the time t")
    after = [new.get(name, name) for name in known]
    if double := [name for name in after if after.count(name) > 1]:
        raise InputError(f"two parameters are named {double[0]!r}; give each its own name")

    def call(text: str) -> str:
        sign, name = _signed(text)
        return f"{'-' if sign < 0 else ''}{new.get(name, name)}"

    return {state: tuple(map(call, own)) for state, own in names.items()}


_ROLES = {True: "growth", False: "decay"}


def name_by_role(equations: Mapping[str, sympy.Expr], names: Names) -> dict[str, str]:
    """Give parameter -> a name that says what it does: x_growth, x_decay, x_from_y, x_source.

    Parameters
    ----------
    equations : state -> right-hand side with numbers.
    names : state -> the names of its constants.

    A parameter in another place is named by the equation and its columns; a name that would be
    another's gets a number.

    >>> x, y = sympy.symbols("x y")
    >>> found = {"x": 2 * x - 3 * x * y}
    >>> name_by_role(found, name_constants(found))
    {'k1': 'x_by_x_y', 'k2': 'x_growth'}
    """
    named, _ = put_names(equations, names)
    known = {_signed(text)[1]: None for own in names.values() for text in own}
    roles: dict[str, str] = {}
    taken = {*equations, *(str(s) for e in equations.values() for s in e.free_symbols), "t"}
    for name in known:
        state, expr = next((s, e) for s, e in named.items() if sympy.Symbol(name) in e.free_symbols)
        role = base = _role(state, expr, sympy.Symbol(name), set(map(sympy.Symbol, known)))
        count = 1
        while role in taken:
            count += 1
            role = f"{base}_{count}"
        taken.add(role)
        roles[name] = role
    return roles


def _role(state: str, expr: sympy.Expr, symbol: sympy.Symbol, own: set[sympy.Symbol]) -> str:
    slope = sympy.diff(expr, symbol)
    columns = sorted(map(str, slope.free_symbols - own))
    if slope.free_symbols & own:
        return f"{state}_constant"
    plain = slope.subs(dict.fromkeys(slope.free_symbols, 1))
    rises = bool(plain.is_positive)
    if not columns:
        return f"{state}_{'source' if rises else 'loss'}"
    if columns == [state] and not sympy.diff(slope, sympy.Symbol(state)).free_symbols:
        return f"{state}_{_ROLES[rises]}"
    if len(columns) == 1 and columns[0] != state and rises:
        return f"{state}_from_{columns[0]}"
    return f"{state}_by_{'_'.join(columns)}"


def list_parameters(
    equations: Mapping[str, sympy.Expr],
    names: Names,
    constants: Mapping[str, Sequence[Constant]],
    units: Mapping[str, str] | None = None,
) -> Parameters:
    """Give the parameters with what the fit says of them; the surest place of each counts.

    Parameters
    ----------
    equations : state -> right-hand side with numbers.
    names : state -> the names of its constants.
    constants : state -> its constants with their intervals, in the same order.
    units : parameter -> its unit.
    """
    found: dict[str, Parameter] = {}
    for state in equations:
        for text, constant in zip(names[state], constants[state], strict=True):
            sign, name = _signed(text)
            low, high, error = constant.low, constant.high, constant.error
            if sign < 0:
                low, high = (None if end is None else -end for end in (high, low))
            first = found.get(name)
            if first is not None:
                states = tuple(dict.fromkeys([*first.states, state]))
                if error >= first.error:
                    found[name] = replace(first, states=states)
                    continue
                found[name] = replace(first, error=error, low=low, high=high, states=states)
                continue
            value = sign * constant.value + 0.0
            unit = (units or {}).get(name, "")
            found[name] = Parameter(name, value, error, low, high, unit, constant.of, (state,))
    return Parameters(list(found.values()))
