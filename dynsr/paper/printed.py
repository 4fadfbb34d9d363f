"""The 33 expressions of the paper's appendix with their printed losses, and its table 1."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import sympy

from dynsr.data import find_system
from dynsr.expression import parse

METHODS = ("DynAIFeynman", "GA", "SINDy")


@dataclass(frozen=True)
class PrintedExpression:
    """One row of the appendix (tables 3 to 9 of Weilbach et al. 2021).

    ``expression`` is the printed ``latex`` as text that :func:`dynsr.parse` reads; ``printed``
    the loss as printed, digit for digit; ``note`` says how a doubtful print was read.
    """

    system: str
    method: str
    run: int
    expression: str
    printed: str
    latex: str
    note: str

    @property
    def loss(self) -> float:
        """Printed loss as a number."""
        return float(self.printed)

    @property
    def expr(self) -> sympy.Expr:
        """Right-hand side that is printed for the last state."""
        system = find_system(self.system)
        return parse(self.expression, [*system.states, *system.inputs, "t"])


@dataclass(frozen=True)
class PrintedCell:
    """One cell of table 1: mean and spread over the five runs, as printed; SINDy has no spread."""

    mean: str
    spread: str | None

    def __str__(self) -> str:
        """Write it as it is printed."""
        return self.mean if self.spread is None else f"{self.mean} ± {self.spread}"


# Table 1 ("RMSE scores"); the cart-pole's SINDy adds up all four states, the others two.
TABLE_1: Mapping[tuple[str, str], PrintedCell] = {
    ("DynAIFeynman", "lotka-volterra"): PrintedCell("0.19", "0.05"),
    ("DynAIFeynman", "pendulum"): PrintedCell("2.41", "0.13"),
    ("DynAIFeynman", "cart-pole"): PrintedCell("1.23", "0.36"),
    ("GA", "lotka-volterra"): PrintedCell("2.13", "1.11"),
    ("GA", "pendulum"): PrintedCell("2.47", "0.003"),
    ("GA", "cart-pole"): PrintedCell("0.771", "0.79"),
    ("SINDy", "lotka-volterra"): PrintedCell("0.24", None),
    ("SINDy", "pendulum"): PrintedCell("2.19", None),
    ("SINDy", "cart-pole"): PrintedCell("1.92", None),
}


@cache
def printed_expressions() -> tuple[PrintedExpression, ...]:
    """Give all 33 rows in the order system, method, run.

    >>> len(printed_expressions())
    33
    """
    text = files("dynsr.paper").joinpath("expressions.json").read_text(encoding="utf-8")
    return tuple(PrintedExpression(**row) for row in json.loads(text))


def rows_of(system: str, method: str) -> tuple[PrintedExpression, ...]:
    """Give the runs of one system and method; none when the paper has none."""
    return tuple(
        row for row in printed_expressions() if (row.system, row.method) == (system, method)
    )
