"""What the user asks, brought into the settings, the targets and the result of a discovery."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from dynsr.data import Samples, Trajectory
from dynsr.discovery.result import Discovery
from dynsr.errors import InputError
from dynsr.expression import evaluate, free_constants, shown, to_text
from dynsr.fit import (
    ParetoFront,
    loosen,
    score_candidate,
)
from dynsr.methods import AbstractMethod, AskedMethod, Demands
from dynsr.selection import SelectionSettings


@dataclass(frozen=True)
class Shares:
    """The parts of a time budget after which each step of a discovery is to have ended.

    Parameters
    ----------
    searches : the searches of all states, and the first looks before them.
    choices : the choice among what they found.
    comparison : the comparison of whole systems.
    polishing : the fit of the constants of the chosen one.
    equations : all that gives equations; what is best by then is taken.
    verdict : the verdict on them, and the search for some that keep closer to the data.
    workers : seconds that a step must have for workers to be started, each of which takes some to
        load its libraries.
    """

    searches: float = 0.55
    choices: float = 0.62
    comparison: float = 0.72
    polishing: float = 0.8
    equations: float = 0.85
    verdict: float = 1.0
    workers: float = 10.0


def settle(settings: SelectionSettings, demands: Demands) -> SelectionSettings:
    """Give the settings of a choice whose later steps invent only functions that are allowed.

    Parameters
    ----------
    settings : those without demands.
    demands : what is asked.
    """
    return replace(
        settings,
        fit=replace(settings.fit, vocabulary=demands.vocabulary),
        comparison=replace(settings.comparison, demands=demands),
    )


def check_must(demands: Demands, runs: Sequence[Trajectory]) -> Demands:
    """Give the demands; refuse a term that must be in an equation and is finite at no row.

    >>> run = Trajectory(np.arange(3.0), np.ones((3, 1)), ("x",))
    >>> check_must(Demands(must=(("x", sympy.log(sympy.Symbol("x") - 5)),)), [run])
    Traceback (most recent call last):
    ...
    dynsr.errors.InputError: term 'log(x - 5)' of must is finite at no row of these data; ...
    """
    for _, term in demands.must:
        # A number within a term is fitted, and may move.
        if term.atoms(sympy.Float):
            continue
        with np.errstate(all="ignore"):
            values = [evaluate(term, run.by_name) for run in runs]
        if not any(np.any(np.isfinite(own)) for own in values):
            raise InputError(
                f"term {shown(term)!r} of must is finite at no row of these data; correct it, or "
                "leave it out"
            )
    return demands


def ask_methods(
    methods: Mapping[str, AbstractMethod], demands: Demands, known: Mapping[str, sympy.Expr]
) -> dict[str, AbstractMethod]:
    """Give methods that keep to the demands; as they are where nothing is asked.

    Parameters
    ----------
    methods : name -> method.
    demands : what is asked.
    known : state -> the given part of its equation.
    """
    if not demands.asked:
        return dict(methods)
    return {name: AskedMethod.of(method, demands, known) for name, method in methods.items()}


def searched_states(states: Sequence[str], demands: Demands) -> tuple[str, ...]:
    """Give the targets whose equations are searched: those that conservation gives are not.

    Raises InputError when the equation of a target follows from one that is no target, or a term
    must occur in an equation that is not searched.
    """
    for state, total in demands.conserved:
        missing = sorted({str(s) for s in total.free_symbols} - {*states})
        if state in states and missing:
            raise InputError(
                f"the equation of {state!r} follows from {to_text(total)}, which needs that of "
                f"{missing[0]!r}; make it a target too"
            )
    searched = tuple(state for state in states if state not in dict(demands.conserved))
    for state, term in demands.must:
        if state not in searched:
            raise InputError(
                f"must of {state!r} has {to_text(term)!r}, but its equation is not searched; "
                f"those searched are of: {', '.join(searched)}"
            )
    return searched


def add_conserved(
    found: Discovery, demands: Demands, samples: Mapping[str, Samples], order: Sequence[str]
) -> Discovery:
    """Give the discovery with the equations that follow from what is conserved.

    Parameters
    ----------
    found : the discovery of the other states.
    demands : what is asked.
    samples : the samples of the states that follow.
    order : all states.
    """
    equations = demands.complete(found.equations)
    errors, fitted = dict(found.errors), dict(found.fitted)
    fronts, why = dict(found.front), dict(found.explanation)
    known = [
        (value, error, before)
        for state, pairs in found.errors.items()
        for (value, error), before in zip(
            pairs, found.fitted.get(state, [v for v, _ in pairs]), strict=True
        )
    ]
    for state, total in demands.conserved:
        if state not in equations:
            continue
        expr = equations[state]
        values = free_constants(loosen(expr), "constant ")[1].values() if expr.args else ()
        repeated = [_repeat(value, known) for value in values]
        errors[state] = tuple((value, error) for value, error, _ in repeated)
        fitted[state] = tuple(before for *_, before in repeated)
        fronts[state] = ParetoFront([score_candidate(expr, samples[state], "conservation")])
        why[state] = f"{state}' follows from the others, since {to_text(total)} is conserved."
    placed = [state for state in order if state in equations]
    return replace(
        found,
        equations={s: equations[s] for s in placed},
        errors={s: errors[s] for s in placed},
        fitted={s: fitted[s] for s in placed if s in fitted},
        front={s: fronts[s] for s in placed},
        explanation={s: why[s] for s in dict.fromkeys([*placed, *why])},
    )


def _repeat(
    value: float, known: Sequence[tuple[float, float, float]]
) -> tuple[float, float, float]:
    """Give a constant with the error and the fitted value of the one that it repeats.

    One that repeats none, since terms of several equations have met in it, has the error inf.
    """
    for other, error, before in known:
        if math.isclose(abs(other), abs(value)):
            return value, error, before * math.copysign(1.0, other * value)
    return value, math.inf, value
