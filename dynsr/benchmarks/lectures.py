"""Forty equations of the Feynman Lectures on Physics, with data made from stated ranges.

R. P. Feynman, R. B. Leighton, M. Sands, "The Feynman Lectures on Physics", volumes I to III; the
number in front is volume, chapter and equation. Formulas and choice of ranges are ours: every
variable is drawn evenly from its range, which keeps clear of poles and domain ends.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.errors import InputError
from dynsr.expression import evaluate, parse

Range = tuple[float, float]


@dataclass(frozen=True)
class Lecture:
    """One equation: its number, what it gives, the formula, and the range of each variable."""

    number: str
    title: str
    formula: str
    ranges: tuple[tuple[str, Range], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables."""
        return tuple(name for name, _ in self.ranges)

    @cached_property
    def expr(self) -> sympy.Expr:
        """The formula in SymPy."""
        return parse(self.formula, self.names)

    def samples(self, rows: int, rng: np.random.Generator, widen: float = 0.0) -> Samples:
        """Draw samples; ``widen`` moves both ends of every range out by that part of its width.

        >>> LECTURES[0].samples(5, np.random.default_rng(0)).X.shape
        (5, 1)
        """
        low = np.array([a - widen * (b - a) for _, (a, b) in self.ranges])
        high = np.array([b + widen * (b - a) for _, (a, b) in self.ranges])
        X = rng.uniform(low, high, (rows, len(low)))
        y = evaluate(self.expr, dict(zip(self.names, X.T, strict=True)))
        return Samples(X, y, self.names, "y", "given", np.arange(float(rows)))


def _read() -> tuple[Lecture, ...]:
    text = files("dynsr.benchmarks").joinpath("lectures.json").read_text(encoding="utf-8")
    return tuple(
        Lecture(
            row["number"],
            row["title"],
            row["formula"],
            tuple((name, (low, high)) for name, (low, high) in row["ranges"].items()),
        )
        for row in json.loads(text)
    )


LECTURES: tuple[Lecture, ...] = _read()


def find_lectures(numbers: Sequence[str]) -> list[Lecture]:
    """Give the lectures of some numbers, all for none named.

    >>> [lecture.title for lecture in find_lectures(["I.12.2"])]
    ['Coulomb force']
    """
    known = {lecture.number: lecture for lecture in LECTURES}
    for number in numbers:
        if number not in known:
            raise InputError(f"unknown equation {number!r}; they are: {', '.join(known)}")
    return [known[number] for number in numbers] or list(LECTURES)
