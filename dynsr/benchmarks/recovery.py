"""Recovery: how often the true equations of known systems are found again, at levels of noise."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from dynsr.errors import InputError
from dynsr.expression import to_text
from dynsr.simulate import add_noise, training_trajectory
from dynsr.system import System
from dynsr.trajectory import Trajectory

NOISE_LEVELS = (0.0, 0.001, 0.01, 0.05)
_EXACT_WITHIN = 0.02
# Two constants inside a function, such as the 1 in sin(1*x), are the same to this many digits.
_DIGITS_INSIDE = 2

Search = Callable[[Trajectory, int], Mapping[str, sympy.Expr]]


@dataclass(frozen=True)
class Recovery:
    """What was found for one state of one system.

    ``same_form`` says whether the formula has exactly the terms of the true one;
    ``constants_off`` is then the largest relative error of its constants, and ``recovered``
    whether that is within 2 %.
    """

    system: str
    state: str
    noise: float
    seed: int
    found: str
    same_form: bool
    constants_off: float
    seconds: float

    @property
    def recovered(self) -> bool:
        """Whether the equation was found: its form, and each constant within 2 %."""
        return self.same_form and self.constants_off <= _EXACT_WITHIN


def measure_recovery(
    systems: Sequence[System],
    search: Search,
    noise: Sequence[float] = NOISE_LEVELS,
    seeds: Sequence[int] = (0,),
) -> Iterator[Recovery]:
    """Search each system's equations in its training data and compare them with the true ones.

    ``search`` gives {state: formula} for a trajectory and a seed. Noise is a fraction of each
    state's standard deviation. Gives one Recovery a state as soon as it is known.
    """
    for level in noise:
        if not (np.isfinite(level) and level >= 0):
            raise InputError(f"noise {level} must be a number from 0 up, such as 0.01 for 1 %")
    for system in systems:
        clean = training_trajectory(system)
        for level in noise:
            # Without noise the data are the same whatever the seed.
            for seed in seeds if level else seeds[:1]:
                data = add_noise(clean, level, np.random.default_rng(seed))
                began = time.perf_counter()
                found = search(data, seed)
                seconds = time.perf_counter() - began
                for state, true in zip(system.states, system.rhs, strict=True):
                    yield _judge(system.name, state, level, seed, found.get(state), true, seconds)


def _judge(
    system: str,
    state: str,
    noise: float,
    seed: int,
    found: sympy.Expr | None,
    true: sympy.Expr,
    seconds: float,
) -> Recovery:
    same, off = (False, float("inf")) if found is None else compare_formulas(found, true)
    text = "" if found is None else to_text(found)
    return Recovery(system, state, noise, seed, text, same, off, seconds)


def compare_formulas(found: sympy.Expr, true: sympy.Expr) -> tuple[bool, float]:
    """Say whether two formulas have the same terms, and how far their constants are apart.

    Both are brought to one fraction of sums, whose first term of the denominator has the constant
    1 (sin(v)^2 is taken as 1 - cos(v)^2); the distance is the largest relative one. Formulas of
    other terms are infinitely far apart.

    >>> from dynsr.expression import parse
    >>> same, off = compare_formulas(parse("x*(1.5 - 1.01*y)"), parse("1.5*x - x*y"))
    >>> same, round(off, 3)
    (True, 0.01)
    """
    ours, theirs = _terms(found), _terms(true)
    if ours.keys() != theirs.keys():
        return False, float("inf")
    return True, max((abs(ours[k] - c) / abs(c) for k, c in theirs.items()), default=0.0)


def _terms(expr: sympy.Expr) -> dict[Any, float]:
    """Give the constants of numerator and denominator by their term, normalised."""
    above, below = sympy.fraction(sympy.together(sympy.expand(_round_inside(expr))))
    parts = [_constants(above), _constants(below)]
    lead = parts[1][min(parts[1], key=sympy.default_sort_key)]
    return {(j, term): c / lead for j, part in enumerate(parts) for term, c in part.items()}


def _constants(expr: sympy.Expr) -> dict[sympy.Expr, float]:
    found: dict[sympy.Expr, float] = {}
    for term in sympy.Add.make_args(sympy.expand(_without_squared_sines(sympy.expand(expr)))):
        number, rest = term.as_coeff_Mul()
        found[rest] = found.get(rest, 0.0) + float(number)
    largest = max(map(abs, found.values()))
    # Terms that cancel leave rounding.
    return {term: number for term, number in found.items() if abs(number) > 1e-12 * largest}


def _without_squared_sines(expr: sympy.Expr) -> sympy.Expr:
    """Write sin(v)^2 as 1 - cos(v)^2: equal functions have equal terms."""

    def squared(node: sympy.Expr) -> bool:
        whole = node.is_Pow and node.exp.is_Integer and node.exp >= 2
        return bool(whole and isinstance(node.base, sympy.sin))

    def written(node: sympy.Expr) -> sympy.Expr:
        pairs, left = divmod(int(node.exp), 2)
        return (1 - sympy.cos(node.base.args[0]) ** 2) ** pairs * node.base**left

    return expr.replace(squared, written)


def _round_inside(expr: sympy.Expr) -> sympy.Expr:
    """Round the constants inside functions, so that sin(1.0001*x) and sin(x) are one term."""

    def rounded(node: sympy.Expr) -> sympy.Expr:
        numbers = {}
        for number in node.atoms(sympy.Float):
            text = f"{float(number):.{_DIGITS_INSIDE - 1}e}"
            numbers[number] = sympy.nsimplify(text, rational=True)
        return node.xreplace(numbers)

    return expr.replace(lambda node: isinstance(node, sympy.Function), rounded)
