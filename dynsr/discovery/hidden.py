"""Hidden: equations are searched with one state that nobody measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import monotonic

import numpy as np
import sympy

from dynsr.data import KnownNoise, Trajectory, carry
from dynsr.discovery.asking import settle
from dynsr.discovery.options import OF_PLAIN, Options
from dynsr.discovery.problem import DiscoverySettings
from dynsr.discovery.result import Discovery
from dynsr.discovery.unmeasured import describe_hidden, number_runs, with_columns
from dynsr.engines import find_engine
from dynsr.errors import InputError
from dynsr.expression import check_name, skeleton, to_text
from dynsr.fit import (
    Measurements,
    ParetoFront,
    fit_along,
    interval_reach,
    simple_numbers,
    tidy,
    with_floats,
)
from dynsr.jobs import Budget, Turns, collect_by
from dynsr.methods import AUTO, Demands, choose_methods
from dynsr.parameters import match_constants
from dynsr.selection import (
    ComparisonSettings,
    HiddenFit,
    SystemFit,
    best_alone,
    different_laws,
    find_hidden,
    find_without,
)
from dynsr.verdict import NOBODY, explain, give_verdict, name_engines

_NAME = "hidden"
# Options of a search that have no meaning where one state was not measured.
_REFUSED = ("known", *OF_PLAIN, "method", "targets")


def check_hidden(runs: Sequence[Trajectory], options: Options) -> str:
    """Give the name of the state that was not measured, "" where none is asked for.

    Parameters
    ----------
    runs, options : the data, and what is asked: the name, or 1 or True for "hidden".

    Raises InputError where it is not one of these, the name is that of a column, or another option
    does not go with it.

    >>> run = Trajectory(np.arange(3.0), np.ones((3, 1)), ("x",))
    >>> [check_hidden([run], Options(hidden=asked)) for asked in (1, "y", 0)]
    ['hidden', 'y', '']
    """
    asked = options.hidden
    if asked in (False, 0):
        return ""
    if not isinstance(asked, str) and asked != 1:
        raise InputError(f"hidden={asked!r}: one state can be hidden; give its name, or 1")
    name = asked if isinstance(asked, str) else _NAME
    check_name(name, "column")
    if name in (*runs[0].names, "t"):
        raise InputError(f"{name!r} is a column of the data; give the hidden state another name")
    options.refuse(_REFUSED, "hidden", "a hidden state")
    choose_methods(AUTO, options.preset)
    return name


def search_hidden(runs: Sequence[Trajectory], options: Options, name: str) -> Discovery | None:
    """Search the equations of the measured states and of one that was not measured.

    None where those of the measured states alone take fewer bits, or none has it, also in the time
    that there is.

    Parameters
    ----------
    runs, options : the data, and what is asked of them.
    name : of the hidden state.
    """
    began, details, inputs = monotonic(), options.details, options.drives
    states, names = (*runs[0].states, name), (*runs[0].names, name)
    demands = options.demands(states, names)
    _check_terms(demands, name)
    selection = settle(details.selection, demands)
    runs = number_runs(carry(runs))
    engine = find_engine(options.engine)
    record = {
        **demands.as_record(),
        **options.record(_NAME, runs[0]),
        "engine": engine.name,
    }
    options.claim(record, runs, {_NAME: name})
    every: list[HiddenFit] = []
    alone: list[SystemFit | None] = []

    def title(state: str) -> str:
        return f"{state}' with {name}" if state else f"without {name}"

    def look() -> None:
        # With defects of any size a hidden state would follow whatever the others leave.
        fit = replace(selection.comparison.fit, loose=0.0)
        how = replace(selection.comparison, fit=fit)
        leading: dict[str, SystemFit | None] = {}
        data = _as_noisy(runs, inputs, how)
        with Turns(["", *states[:-1]], title, options.report) as turns:
            for state in turns:
                if not state:
                    leading |= best_alone(data, how)
                    alone.append(find_without(data, leading, how))
                    turns.say({} if alone[0] is None else alone[0].exprs)
                    continue
                for one in find_hidden(data, name, state, leading[state], how, details.hidden):
                    every.append(one)
                    turns.say(min(every, key=lambda fit: fit.bits).fit.exprs)

    until = Budget(options.time_budget).until(details.shares.choices)
    cut, complete = collect_by(until, look, every)
    best = min(every, key=lambda one: one.bits, default=None)
    if best is None or (alone[0] is not None and alone[0].bits <= best.bits):
        return None
    deciding = replace(details, selection=selection)
    found = _discover(best, every, alone[0], runs, inputs, deciding, complete)
    record |= {
        **found.settings,
        "engines": name_engines([], engine, found.equations, inputs, along=True),
        **({"ended_by_budget": [_NAME]} if cut else {}),
    }
    return replace(found, engine=engine, settings=record, seconds=monotonic() - began)


def _check_terms(demands: Demands, name: str) -> None:
    """Refuse terms with a state that has no values, as it is known up to a function of others."""
    asked = [("must", s, term) for s, term in demands.must]
    asked += [("terms", "", term) for term in demands.terms]
    for option, state, term in asked:
        if state == name or sympy.Symbol(name) in term.free_symbols:
            raise InputError(
                f"{option} has {to_text(term)!r}{f' of {state!r}' if state else ''}, but nobody "
                f"measured {name}, which may be written in many ways; name terms of measured "
                "columns in the equations of measured states"
            )


def _as_noisy(
    runs: Sequence[Trajectory], inputs: Mapping[str, sympy.Expr], settings: ComparisonSettings
) -> Measurements:
    """Give measurements; exact ones have errors as small as those of a solver.

    What exact states miss by less than these says nothing of a law, and terms would be found for
    it.
    """
    data = Measurements.of(runs, inputs, settings.rows)
    if data.noise_share >= settings.noisy:
        return data
    columns = np.concatenate([run.observed for run in runs])
    sizes = settings.noisy * np.nanstd(columns, axis=0)
    states = runs[0].states
    known = [
        {s: KnownNoise(np.full(len(run), size)) for s, size in zip(states, sizes, strict=True)}
        for run in runs
    ]
    exact = [replace(run, noise=own) for run, own in zip(runs, known, strict=True)]
    return Measurements.of(exact, inputs, settings.rows)


def _discover(
    best: HiddenFit,
    every: Sequence[HiddenFit],
    alone: SystemFit | None,
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    settings: DiscoverySettings,
    complete: bool,
) -> Discovery:
    """Give a system with the constants that fit best, and its verdict."""
    selection = settings.selection
    coupling, exprs, data = best.signed()
    if data.known(runs[0].states).all() and not any(run.noise for run in runs):
        # The constants of exact states are exact too.
        finer = data.finest / selection.comparison.noisy
        data = data.with_noise(dict.fromkeys(runs[0].states, finer))
    # A factor of 1 is a constant too, but for that of the hidden state.
    fixed = {coupling.state: [coupling.term]}
    loose = {s: with_floats(e, fixed.get(s, ())) for s, e in exprs.items()}
    fit = fit_along(loose, data, selection.fit.along)
    if fit is None:
        raise InputError("no system with a hidden state can be fitted to these data")
    numbers = simple_numbers(fit, [None] * len(fit.constants), selection.fit)
    final = {s: tidy(e) for s, e in fit.put(numbers).items()}
    left = zip(map(float, numbers), fit.errors.tolist(), fit.constants.tolist(), strict=True)
    # The factor of the hidden state is known: it has no error.
    errors, fitted = match_constants(final, [*left], {coupling.state: float(coupling.sign)})
    whole = with_columns(runs, data, coupling.name)
    others = different_laws(best, every, settings.verdict.alternative_bits, settings.hidden)
    if coupling != best.coupling:
        others = [(best.coupling.turned(other)[1], bits) for other, bits in others]
    alternatives = _by_state(others, exprs, coupling.name)
    if alone is not None:
        # Without a hidden state, the equation that shows it is another one.
        own = alone.exprs[coupling.state], alone.bits - best.bits
        alternatives.setdefault(coupling.state, []).append(own)
    verdict = (
        give_verdict(
            final,
            whole,
            inputs,
            alternatives=alternatives,
            causes=dict.fromkeys(final, ""),
            settings=settings.verdict,
            fixed=[coupling.term],
        )
        if complete
        else NOBODY
    )
    said = {coupling.name: f" {describe_hidden(coupling.name, coupling.term, final)}"}
    return Discovery(
        final,
        errors,
        {s: ParetoFront([]) for s in final},
        {
            s: (explain(s, e, verdict.states[s]) if verdict.tested else "") + said.get(s, "")
            for s, e in final.items()
        },
        tuple(whole),
        dict(inputs),
        {"hidden": {coupling.name: to_text(coupling.term)}},
        complete=complete,
        fitted=fitted,
        reach=interval_reach(fit.freedom),
        verdict=verdict,
    )


def _by_state(
    others: Sequence[tuple[Mapping[str, sympy.Expr], float]],
    exprs: Mapping[str, sympy.Expr],
    name: str,
) -> dict[str, list[tuple[sympy.Expr, float]]]:
    """Give alternatives for the state by whose equation they differ, the hidden one first."""
    found: dict[str, list[tuple[sympy.Expr, float]]] = {}
    for other, bits in others:
        differing = [s for s in (name, *exprs) if skeleton(other[s]) != skeleton(exprs[s])]
        own = (differing or [name])[0]
        found.setdefault(own, []).append((other[own], bits))
    return found
