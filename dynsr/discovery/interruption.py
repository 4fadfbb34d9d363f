"""Interruption: what the searches of a discovery have found when Ctrl-C ends them."""

from __future__ import annotations

from collections.abc import Mapping

import sympy

from dynsr.data import Samples
from dynsr.discovery.result import Discovery
from dynsr.discovery.tasks import Choice, Found, state_of
from dynsr.fit import ParetoFront, choose, tidy
from dynsr.jobs import Watch


def collect_best(
    watch: Watch, samples: Mapping[str, Samples], known: Mapping[str, sympy.Expr]
) -> Discovery | None:
    """Give the best formulas of the tasks that have ended and of those that ran; None without any.

    A state whose equation was chosen has that one; else the formula of least description length
    among all that its searches have. A state without any has no equation, and words that say so.
    """
    equations, fronts, why = {}, {}, {}
    running = watch.running()
    for state, own in samples.items():
        records = [r for name, r in watch.records.items() if state_of(name) == state]
        ended = [record for record in records if isinstance(record, Found)]
        stopped = [said for said in running if state_of(said.task) == state and len(said.front)]
        pool = [c for found in ended for c in found.candidates]
        pool += [c for said in stopped for c in said.front]
        choices = [record.pick for record in records if isinstance(record, Choice)]
        if not choices and not pool:
            why[state] = "nothing yet; no search of its equation had a formula."
            continue
        best = choices[0].candidate if choices else choose(pool, own)
        equations[state] = tidy(known.get(state, sympy.S.Zero) + best.expr)
        fronts[state] = ParetoFront(pool)
        why[state] = (
            choices[0].explanation
            if choices
            else f"the best so far, found by {best.source or 'search'}; searches that had ended: "
            f"{len(ended)}, that still ran: {len(stopped)}."
        )
    if not equations:
        return None
    return Discovery(equations, dict.fromkeys(equations, ()), fronts, why, complete=False)
