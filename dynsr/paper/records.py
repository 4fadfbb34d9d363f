"""Records: what each cell of a replication gave."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, is_dataclass
from typing import Any

import sympy

from dynsr.expression import parse
from dynsr.jobs import to_plain


@dataclass(frozen=True)
class Record:
    """One run of one method on one system.

    Parameters
    ----------
    system, method, run, target : the cell; runs count from 1.
    seed : the entropy and spawn key of the ``numpy.random.SeedSequence`` of this cell.
    status : "done" or "failed"; then ``error`` says why in one line.
    expression : right-hand side of the target's equation, text that :func:`dynsr.parse` reads.
    fit_loss : its RMSE on the training samples, state units per second.
    complexity : its description length in bits.
    equation_rmse : root mean square of f_hat - f along the true test states (the paper's formula).
    printed_loss : the trajectory loss behind the numbers that the paper prints; None for a system
        that is not the paper's.
    trajectory_loss : the trajectory loss over all states from the right start.
    seconds : wall time of the search.
    engine, versions : what integrated and regressed, with the version of every part.
    preset, settings : the method's own settings, all of them.
    front : every formula of the Pareto front: expression, loss, complexity, source.
    source : the stage of the search that the formula comes from.
    stages : every stage that ran, in order: its name, how many formulas of the front are its own,
        and the RMSE of its best formula, on the front or not (None where it gave none).
    embedded : what the embedded engine makes of the cell, where another one computed it: how far
        its ``samples`` are from these, its three losses, its ``versions``, and for SINDy, which it
        regresses again, the ``expression`` that they belong to.
    """

    system: str
    method: str
    run: int
    target: str
    seed: tuple[int, ...]
    status: str
    engine: str
    versions: Mapping[str, str]
    preset: str
    settings: Mapping[str, Any]
    expression: str = ""
    fit_loss: float = math.inf
    complexity: float = math.inf
    equation_rmse: float = math.inf
    printed_loss: float | None = None
    trajectory_loss: float = math.inf
    seconds: float = math.inf
    error: str = ""
    front: tuple[Mapping[str, Any], ...] = field(default=())
    source: str = ""
    stages: tuple[Mapping[str, Any], ...] = field(default=())
    embedded: Mapping[str, Any] | None = None

    @property
    def done(self) -> bool:
        """Whether the cell gave a formula."""
        return self.status == "done"

    @property
    def expr(self) -> sympy.Expr:
        """The formula as a SymPy expression."""
        return parse(self.expression)

    @property
    def summary(self) -> str:
        """The formula, or why there is none, in a few words."""
        if not self.done:
            return f"failed: {self.error}"
        return f"{self.expression}  (error {self.fit_loss:.2g})"


def describe_settings(method: Any) -> dict[str, Any]:
    """Give the settings of a method (its fields) as values that JSON holds.

    >>> from dynsr.methods import GeneticAlgorithm
    >>> describe_settings(GeneticAlgorithm(bits=20))["bits"]
    20
    """
    if not is_dataclass(method):
        return {"name": str(getattr(method, "name", type(method).__name__))}
    settings: dict[str, Any] = to_plain(method)
    return settings
