"""Audit: every expression that the paper prints, scored again by its decoded protocol."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from decimal import ROUND_DOWN, Decimal

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import find_system
from dynsr.engines import AbstractEngine, find_engine
from dynsr.expression import to_text
from dynsr.jobs import Step, report_each
from dynsr.paper.printed import PrintedExpression, printed_expressions
from dynsr.paper.protocol import printed_loss, score_as_printed, sindy_samples
from dynsr.verdict import Score

Models = Callable[[AbstractEngine], Mapping[str, sympy.Expr]]


@dataclass(frozen=True)
class AuditRow:
    """One printed expression and its loss, with ours.

    ``printed`` is the loss as printed (``printed_digits`` with every digit), ``ours`` the loss
    as printed for that expression (see :mod:`dynsr.paper.protocol`), ``agrees`` whether ours
    cut (not rounded) to the printed digits is the printed one. ``corrected`` is the corrected
    trajectory loss and ``equation_rmse`` the formula of the text. Where the printed
    coefficients are too rounded to give the printed loss, ``unrounded_expression`` is our own
    model, ``unrounded`` its loss as printed, and ``unrounded_agrees`` whether that is the
    printed one.
    """

    system: str
    method: str
    run: int
    expression: str
    printed: float
    printed_digits: str
    ours: float
    agrees: bool
    corrected: float
    equation_rmse: float
    note: str
    unrounded_expression: str | None = None
    unrounded: float | None = None
    unrounded_agrees: bool | None = None


@checked
def audit(
    engine: str | AbstractEngine = "embedded",
    unrounded: Models | None = None,
    progress: Callable[[Step], None] | None = None,
) -> list[AuditRow]:
    """Score the 33 printed expressions again and compare with what is printed.

    Parameters
    ----------
    engine : what integrates and regresses.
    unrounded : gives the models of SINDy with all their digits, by system, for an engine; by
        default :func:`paper_models`, which finds them again.
    progress : called with a :class:`dynsr.jobs.Step` as each method on each system is scored.

    Raises InputError for an unknown engine, EngineUnavailable for one that is absent.

    >>> sum(row.agrees for row in audit(unrounded=lambda engine: {})) >= 31
    True
    """
    chosen = find_engine(engine)
    groups = report_each(_groups(), lambda group: f"{group[0].system} {group[0].method}", progress)
    rows = [row for group in groups for row in _audit_group(group, chosen)]
    missed = [row.system for row in rows if row.method == "SINDy" and not row.agrees]
    if missed:
        models = paper_models(chosen, missed) if unrounded is None else unrounded(chosen)
        rows = [_beside(row, models, chosen) for row in rows]
    return rows


def agrees_cut(printed: str, ours: float) -> bool:
    """Whether ``ours``, cut to the digits of ``printed``, is ``printed``.

    >>> agrees_cut("0.239", 0.2399), agrees_cut("0.239", 0.2400), agrees_cut("1.920", 1.92)
    (True, False, True)
    """
    if not math.isfinite(ours):
        return False
    wanted = Decimal(printed)
    return Decimal(repr(ours)).quantize(wanted, rounding=ROUND_DOWN) == wanted


def paper_models(engine: AbstractEngine, systems: Iterable[str]) -> dict[str, sympy.Expr]:
    """Find the paper's SINDy models again from its own data, with all their digits.

    Parameters
    ----------
    engine : what integrates and regresses; the embedded one takes the recorded steps, since the
        printed digits are what is asked for here.
    systems : names of systems of the paper.
    """
    # Here, because an audit with models of its own has no need of the search.
    from dynsr.paper.protocol import paper_method

    models = {}
    for name in systems:
        system = find_system(name)
        method = paper_method("sindy", system).with_engine(engine)
        samples = sindy_samples(system, engine, engine.name == "embedded")
        # The recipe holds no chance; the generator is there because every search takes one.
        models[name] = method.search(samples, np.random.default_rng(0)).best_fit.expr
    return models


def _groups() -> list[list[PrintedExpression]]:
    groups: dict[tuple[str, str], list[PrintedExpression]] = {}
    for row in printed_expressions():
        groups.setdefault((row.system, row.method), []).append(row)
    return list(groups.values())


def _audit_group(group: list[PrintedExpression], engine: AbstractEngine) -> list[AuditRow]:
    system = find_system(group[0].system)
    exprs = [row.expr for row in group]
    scores = score_as_printed(system, exprs, group[0].method, engine=engine)
    return [_row(printed, score) for printed, score in zip(group, scores, strict=True)]


def _row(printed: PrintedExpression, score: Score) -> AuditRow:
    return AuditRow(
        system=printed.system,
        method=printed.method,
        run=printed.run,
        expression=printed.expression,
        printed=printed.loss,
        printed_digits=printed.printed,
        ours=score.losses["printed_loss"],
        agrees=agrees_cut(printed.printed, score.losses["printed_loss"]),
        corrected=score.trajectory_loss,
        equation_rmse=score.equation_rmse,
        note=printed.note,
    )


def _beside(row: AuditRow, models: Mapping[str, sympy.Expr], engine: AbstractEngine) -> AuditRow:
    """Add our model with all its digits to a row of SINDy that does not agree."""
    if row.agrees or row.method != "SINDy" or row.system not in models:
        return row
    model = models[row.system]
    loss = printed_loss(find_system(row.system), model, row.method, engine=engine)
    return replace(
        row,
        unrounded_expression=to_text(model),
        unrounded=loss,
        unrounded_agrees=agrees_cut(row.printed_digits, loss),
    )
