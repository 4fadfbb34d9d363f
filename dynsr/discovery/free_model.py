"""Free models: equations that are known but for some constants and functions of one column.

Which of them exact data could determine is a question to the equations alone. A change of the
constants and functions that changes no slope, at any values of the columns, cannot be seen: the
sensitivities of the slopes at random points show it (Chis et al. 2011).
"""

from __future__ import annotations

import ast
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Any

import numpy as np
import sympy

from dynsr.errors import InputError
from dynsr.expression import FUNCTIONS, check_name, compile_columns, parse, unknown_calls
from dynsr.fit import Part
from dynsr.parameters import FREE, FreeSettings


@dataclass(frozen=True)
class FreeModel:
    """Equations with constants and free functions.

    Parameters
    ----------
    equations : state -> right-hand side in columns, constants and the symbols of the parts.
    constants : the names of the constants that are fitted.
    parts : the free functions.
    fixed : constants that cannot be known -> the number that was chosen for each.
    notes : what cannot be known, in words.
    """

    equations: Mapping[str, sympy.Expr]
    constants: tuple[str, ...]
    parts: tuple[Part, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def contains(self, state: str, part: Part) -> bool:
        """Whether the equation of a state contains a function."""
        return part.symbol in self.equations[state].free_symbols


def has_free(known: Any) -> bool:
    """Whether a known part of an equation contains a function that is not in the operator table.

    Parameters
    ----------
    known : state -> the part, as :func:`dynsr.discover` takes it.

    >>> has_free({"x": "a - f(x)*y"}), has_free({"x": "-sin(x)"}), has_free(None)
    (True, False, False)
    """
    if not isinstance(known, Mapping):
        return False
    return any(_free_names(expr) for expr in known.values())


def _free_names(expr: Any) -> set[str]:
    if isinstance(expr, sympy.Expr):
        return {str(own.func) for own in expr.atoms(sympy.core.function.AppliedUndef)}
    return {name for name, _ in unknown_calls(str(expr))}


def read_model(known: Mapping[str, Any], states: Sequence[str], names: Sequence[str]) -> FreeModel:
    """Read equations with free functions.

    Parameters
    ----------
    known : state -> right-hand side. A name that is no column is a constant, and a function that is
        not in the operator table is free. Its argument is one column.
    states, names : the states, and all columns with ``t``.

    Raises InputError, one line, when an equation is of no state or cannot be read, or a free
    function has another argument than one column.

    >>> model = read_model({"x": "a - f(x)*y"}, ["x", "y"], ["x", "y", "t"])
    >>> model.constants, [(part.name, part.of) for part in model.parts]
    (('a',), [('f', 'x')])
    """
    equations: dict[str, sympy.Expr] = {}
    parts: dict[str, Part] = {}
    for state, given in known.items():
        if state not in states:
            raise InputError(
                f"known has an equation of {str(state)!r:.40}, which is no state; the states are: "
                f"{', '.join(states)}"
            )
        text = str(given)
        for name, call in unknown_calls(text):
            _check_call(name, call, state, names)
        free = _free_names(given)
        functions = {name: sympy.Function(name) for name in free}
        expr = given if isinstance(given, sympy.Expr) else parse(text, functions=functions)
        for own in sorted(expr.atoms(sympy.core.function.AppliedUndef), key=str):
            part = _read_part(own, state, names, parts)
            expr = expr.xreplace({own: part.symbol})
        equations[state] = expr
    symbols = {part.symbol for part in parts.values()}
    found = {str(s) for e in equations.values() for s in e.free_symbols - symbols}
    constants = tuple(sorted(found - {*names}))
    for name in constants:
        check_name(name, "constant")
        if name in parts:
            raise InputError(f"{name!r} is a function and a constant in known; rename one of them")
    return FreeModel(equations, constants, tuple(parts.values()))


def _check_call(name: str, call: ast.Call, state: str, names: Collection[str]) -> None:
    """Check the text of one call; raises InputError that names the remedy."""
    shown = ast.unparse(call).replace("**", "^")
    where = f"{shown!r} in known of {state!r}"
    if name in names:
        raise InputError(f"{where} calls the column {name!r}; write {name}*(...), or rename it")
    if len(call.args) != 1 or call.keywords:
        raise InputError(
            f"{where} has {len(call.args)} arguments; a free function has one column, such as "
            f"{name}({next(iter(names))})"
        )
    (argument,) = call.args
    if not isinstance(argument, ast.Name):
        raise InputError(
            f"{where} is a function of a formula; give a free function one column, such as "
            f"{name}({next(iter(names))}), or make the formula a column of the data"
        )
    if argument.id not in names:
        raise InputError(
            f"{where} is a function of {argument.id!r}, which is no column; the columns are: "
            f"{', '.join(names)}"
        )


def _read_part(own: sympy.Expr, state: str, names: Collection[str], parts: dict[str, Part]) -> Part:
    name = check_name(str(own.func), "function")
    near = get_close_matches(name.lower(), FUNCTIONS, 1, 3 / 4)
    if near or hasattr(math, name):
        what = f"written nearly as {near[0]}" if near else "a function that formulas do not have"
        raise InputError(
            f"{name!r} in known of {state!r} is {what}; correct it, or give the free function "
            "another name, such as f"
        )
    if len(own.args) != 1 or not own.args[0].is_Symbol or str(own.args[0]) not in names:
        raise InputError(
            f"'{own}' in known of {state!r} must be a function of one column; the columns are: "
            f"{', '.join(names)}"
        )
    part = parts.setdefault(name, Part(name, str(own.args[0])))
    if part.of != str(own.args[0]):
        raise InputError(
            f"{name} is a function of {part.of!r} and of {own.args[0]} in known; give the second "
            "one another name"
        )
    return part


def finish_model(
    model: FreeModel,
    columns: Mapping[str, np.ndarray],
    rng: np.random.Generator,
    settings: FreeSettings = FREE,
    sizes: Mapping[str, float] | None = None,
) -> FreeModel:
    """Fix what exact data could not determine, and say so.

    A constant that cannot be known becomes 0, or 1 where the functions would vanish with it. Where
    only functions are involved, the mean of one of them over the data is fixed so.

    Parameters
    ----------
    model : the equations.
    columns : column -> its values in the data.
    rng : draws the points.
    settings : the numbers that decide.
    sizes : constant or function -> its usual size in these data; 1 by default.

    Raises InputError where two functions cannot be distinguished at all.

    >>> model = read_model({"x": "a - f(x)"}, ["x"], ["x", "t"])
    >>> found = finish_model(model, {"x": np.linspace(1, 2, 9)}, np.random.default_rng(0))
    >>> found.fixed
    {'a': 0.0}
    >>> print(found.notes[0])
    a cannot be known: f(x) can take up any change of it. Here a = 0. If you know a, write its \
number.
    """
    while True:
        # What a point hides, as where terms differ much in size, another one shows.
        pairs = [_unseen(model, columns, rng, settings, own) for own in ({}, sizes or {})]
        unseen = min(pairs, key=lambda own: own.shape[1])
        if not unseen.size:
            return model
        count = len(model.constants)
        moves = np.linalg.norm(unseen[:count], axis=1)
        if moves.max(initial=0.0) > math.sqrt(settings.unseen):
            place = int(np.argmax(moves))
            # The direction that moves this constant says what takes up its change.
            way = np.abs(unseen @ unseen[place])
            model = _fix_constant(model, place, way > math.sqrt(settings.unseen) * way.max())
        else:
            moved = np.linalg.norm(unseen[count:], axis=1) > math.sqrt(settings.unseen)
            model = _fix_mean(model, moved.reshape(len(model.parts), -1).any(axis=1))


def _fix_constant(model: FreeModel, place: int, moved: np.ndarray) -> FreeModel:
    """Choose the number of a constant that cannot be known."""
    name, count = model.constants[place], len(model.constants)
    others = [n for n, own in zip(model.constants, moved, strict=False) if own and n != name]
    blocks = moved[count:].reshape(len(model.parts), -1)
    others += [f"{p.name}({p.of})" for p, own in zip(model.parts, blocks, strict=True) if own.any()]
    number = 0.0 if _keeps(model, sympy.Symbol(name)) else 1.0
    put = {sympy.Symbol(name): sympy.Integer(int(number))}
    why = f"{' and '.join(others)} can take up any change of it" if others else "it has no effect"
    note = (
        f"{name} cannot be known: {why}. Here {name} = {number:g}. If you know {name}, write its "
        "number."
    )
    return replace(
        model,
        equations={s: e.xreplace(put) for s, e in model.equations.items()},
        constants=tuple(n for n in model.constants if n != name),
        fixed={**model.fixed, name: number},
        notes=(*model.notes, note),
    )


def _fix_mean(model: FreeModel, moved: np.ndarray) -> FreeModel:
    """Fix the mean of a function that another one can take the place of."""
    involved = [part for part, own in zip(model.parts, moved, strict=True) if own]
    open_ = [part for part in involved if part.mean is None]
    names = " and ".join(f"{part.name}({part.of})" for part in involved)
    if not open_ or len(involved) < 2:
        raise InputError(
            f"{names} cannot be determined from these equations: other functions give the same "
            "slopes; leave one function free, and write what you know of the others"
        )
    part = open_[-1]
    mean = 0.0 if _keeps(model, part.symbol) else 1.0
    note = (
        f"{names} can take up changes of each other. Here the mean of {part.name} over the data is "
        f"{mean:g}."
    )
    parts = tuple(replace(p, mean=mean) if p is part else p for p in model.parts)
    return replace(model, parts=parts, notes=(*model.notes, note))


def _keeps(model: FreeModel, symbol: sympy.Symbol) -> bool:
    """Whether all other constants and functions stay in the equations where a symbol becomes 0."""
    named = {sympy.Symbol(name) for name in model.constants}
    free = {part.symbol for part in model.parts} | named
    for expr in model.equations.values():
        without = expr.xreplace({symbol: sympy.S.Zero})
        if (expr.free_symbols & free) - {symbol} != without.free_symbols & free:
            return False
        if without.has(sympy.zoo, sympy.nan, sympy.oo):
            return False
    return True


def _unseen(
    model: FreeModel,
    columns: Mapping[str, np.ndarray],
    rng: np.random.Generator,
    settings: FreeSettings,
    sizes: Mapping[str, float],
) -> np.ndarray:
    """(constants + parts * values, d) directions that change no slope.

    They are in units of what each changes.

    A function is free at every value of its column on a grid.
    """
    count, points = settings.grid, settings.grid * settings.seen
    names = sorted({str(s) for e in model.equations.values() for s in e.free_symbols})
    names = list(dict.fromkeys([*(n for n in names if n in columns), *(p.of for p in model.parts)]))
    ends = {name: (np.nanmin(columns[name]), np.nanmax(columns[name])) for name in names}
    grids = {name: rng.uniform(*ends[name], size=count) for name in names}
    at = {name: rng.integers(count, size=points) for name in names}
    numbers = [sizes.get(n, 1.0) * (0.5 + rng.uniform()) for n in model.constants]
    heights = [sizes.get(p.name, 1.0) * (0.5 + rng.uniform(size=count)) for p in model.parts]
    given = [grids[name][at[name]] for name in names]
    given += [np.full(points, number) for number in numbers]
    given += [own[at[p.of]] for p, own in zip(model.parts, heights, strict=True)]
    symbols = [*map(sympy.Symbol, model.constants), *(part.symbol for part in model.parts)]
    arguments = [*names, *map(str, symbols)]
    rows = []
    for expr in model.equations.values():
        slopes = compile_columns([sympy.diff(expr, s) for s in symbols], arguments)(*given)
        own = np.zeros((points, len(model.constants) + len(model.parts) * count))
        own[:, : len(model.constants)] = slopes[: len(model.constants)].T
        for place, part in enumerate(model.parts):
            first = len(model.constants) + place * count
            own[np.arange(points), first + at[part.of]] = slopes[len(model.constants) + place]
        rows.append(own[np.all(np.isfinite(own), axis=1)])
    for place, part in enumerate(model.parts):
        if part.mean is not None:
            fixed = np.zeros((1, rows[0].shape[1]))
            first = len(model.constants) + place * count
            fixed[0, first : first + count] = 1.0
            rows.append(fixed)
    whole = np.concatenate(rows)
    if not whole.size:
        raise InputError(
            "the equations in known have no finite slopes at these data; correct them, such as a "
            "logarithm of a negative number"
        )
    moved = np.linalg.norm(whole, axis=0)
    _, values, ways = np.linalg.svd(whole / np.where(moved > 0, moved, 1.0), full_matrices=True)
    seen = np.zeros(ways.shape[0])
    seen[: len(values)] = values
    found: np.ndarray = ways[seen <= settings.unseen * max(seen.max(), 1e-300)].T
    return found
