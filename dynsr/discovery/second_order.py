"""Second order where the order is left to the data: positions alone have no law of first order.

A solution of ``x' = f(x)`` is monotone. One state that comes back to the same values with other
slopes has no such law, and ``x'' = f(x, x')`` is searched first. Where each of several states lacks
another one, equations of second order are searched if those of first order are no law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynsr.data import Trajectory, carry, diagnose, turns_back
from dynsr.discovery.options import Options, Search
from dynsr.discovery.orders import read_form
from dynsr.discovery.result import Discovery, keep_if_asked, with_words
from dynsr.errors import InputError
from dynsr.jobs import Budget
from dynsr.verdict import LAW

# Options that say something of the equations of first order.
_OF_FIRST = (
    "discrete",
    "explicit_time",
    "slopes",
    "known",
    "must",
    "constraints",
    "conserved",
    "nonnegative",
    "start",
)


def search_orders(search: Search, runs: Sequence[Trajectory], asked: Options) -> Discovery:
    """Search equations of first order, or of second order where the data ask for these.

    Parameters
    ----------
    search : takes trajectories and options.
    runs : the trajectories.
    asked : options of the search. An order that is given, and what says something of equations of
        first order, leaves no choice.

    The better verdict is returned. The explanation says so where the order became 2.
    """
    free = asked.order is None and not asked.says("targets")
    if not free or any(map(asked.says, _OF_FIRST)):
        return search(runs, asked)
    budget, states = Budget(asked.time_budget), runs[0].states
    alone = len(runs[0].names) == 1
    second = alone and turns_back(runs, states[0]) and "second order" in _causes(runs, states[0])
    found = _search(search, runs, replace(asked, order=2)) if second else None
    if found is None:
        found = search(runs, replace(asked, order=1))
        second = False
    decided = not found.complete or not found.verdict.tested or found.verdict.level == LAW
    if decided or budget.is_over or not (second or (not alone and _are_positions(runs))):
        return _say(found, states) if second else found
    rest = replace(asked, order=1 if second else 2, time_budget=budget.rest(), out=None)
    other = _search(search, runs, rest)
    best = found if other is None else min(found, other, key=_rank)
    keep_if_asked(best, asked.out if best is other else None)
    if second is (best is found):
        return _say(best, states)
    no_better = "" if other is None else " Equations of second order are no better."
    return with_words(best, no_better)


def _search(search: Search, runs: Sequence[Trajectory], asked: Options) -> Discovery | None:
    """Search in one order; None where a column has the name of a velocity, or rows are too few."""
    try:
        return search(runs, asked)
    except InputError:
        if asked.order == 1:
            raise
        return None


def _are_positions(runs: Sequence[Trajectory]) -> bool:
    """Whether several states lack another one each, and none with their velocities as columns."""
    states = runs[0].states
    if not all("missing state" in _causes(runs, state) for state in states):
        return False
    try:
        form = read_form(2, explicit_time=False, discrete=False, runs=runs, targets=states)
        wide = form.prepare(carry(runs))
    except InputError:
        return False
    return not any(_causes(wide, velocity) for velocity in form.velocities.values())


def _causes(runs: Sequence[Trajectory], state: str) -> set[str]:
    return {cause.kind for cause in diagnose(runs, state)}


def _rank(found: Discovery) -> tuple[int, float]:
    """The better verdict is first; of two alike, the one that keeps closer to the data."""
    own = found.verdict.states.values()
    return found.verdict.rank, -min((state.r2 for state in own), default=0.0)


def _say(found: Discovery, states: Sequence[str]) -> Discovery:
    """Say, and keep in the record, that the data made the order 2."""
    words = dict.fromkeys(states, f" {explain_order(states)}")
    return with_words(found, words, order_by_data=list(states))


def explain_order(states: Sequence[str]) -> str:
    """Say why equations are of second order though nobody asked for that.

    Parameters
    ----------
    states : whose equations are.

    >>> explain_order(["x", "y"])[:46]
    'x and y come back to the same values with othe'
    """
    names, one = " and ".join(states), len(states) == 1
    return (
        f"{names} come{'s' * one} back to the same values with other slopes, which no equations of "
        "first order in these columns do. So the order is 2; order=1 (--order 1) sets it back."
    )
