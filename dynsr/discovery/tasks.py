"""Tasks of a discovery: searches of one state by one method, and the choice of its equation.

When Ctrl-C ends them, what they have found so far is put together.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy

from dynsr import errors
from dynsr.data import Samples, Trajectory
from dynsr.discovery.result import Discovery
from dynsr.fit import Candidate, ParetoFront, choose, tidy
from dynsr.jobs import Task, Watch, best_equation
from dynsr.methods import AbstractMethod, Progress, Report, silent
from dynsr.selection import Pick, SelectionSettings, explains_all, pick_equation, trivial_candidates

# Rough seconds of a task on one core, from which the time left is first guessed.
_USUAL = {"rational": 6.0, "sindy": 4.0, "dynaifeynman": 15.0, "genetic": 10.0}
_USUAL_SEARCH, _USUAL_PICK = 10.0, 6.0


@dataclass(frozen=True)
class Found:
    """What one method found for one state.

    Parameters
    ----------
    target, method : the state and the method's name.
    candidates : its formulas.
    seconds : wall time.
    error, kind : what ended the method in words, and the name of that exception; "" if nothing.
    """

    target: str
    method: str
    candidates: tuple[Candidate, ...]
    seconds: float
    error: str = ""
    kind: str = ""

    @cached_property
    def front(self) -> ParetoFront:
        """Those that no other is both simpler and better than."""
        return ParetoFront(self.candidates)

    @property
    def summary(self) -> str:
        """The best of them in a few words."""
        return f"failed: {self.error}" if self.error else best_equation(self.front)


@dataclass(frozen=True)
class Choice:
    """The equation chosen for a state.

    Parameters
    ----------
    pick : the choice.
    seconds : wall time.
    failures : which methods it had to do without, in words; "" for none.
    """

    pick: Pick
    seconds: float
    failures: str = ""

    @property
    def summary(self) -> str:
        """The equation in a few words."""
        return best_equation(ParetoFront([self.pick.candidate]))


def search_one(
    method: AbstractMethod,
    samples: Samples,
    sequence: np.random.SeedSequence,
    report: Report = silent,
) -> Found:
    """Search one target with one method; a method that fails takes no other one with it."""
    began = time.monotonic()
    trivial = trivial_candidates(samples)
    found = [c for c in trivial if explains_all(c, samples)]
    error = kind = ""
    if not found:
        try:
            found = list(method.search(samples, np.random.default_rng(sequence), report))
        except Exception as failure:
            error, kind = errors.one_line(failure)[:500], type(failure).__name__
    taken = time.monotonic() - began
    return Found(samples.target, method.name, (*trivial, *found), taken, error, kind)


def check_found(searched: Sequence[Found], states: Sequence[str]) -> dict[str, str]:
    """Say for every state which methods failed, "" where none did.

    Raises what ended the first of them where all methods of a state failed.
    """
    said = {}
    for state in states:
        own = [found for found in searched if found.target == state]
        failed = [found for found in own if found.error]
        if failed and len(failed) == len(own):
            raise getattr(errors, failed[0].kind, RuntimeError)(failed[0].error)
        said[state] = "".join(
            f" Without {found.method}, which failed ({found.kind}: {found.error})."
            for found in failed
        )
    return said


def pick_one(
    pool: Sequence[Candidate],
    samples: Samples,
    held_back: Sequence[Trajectory],
    known: sympy.Expr,
    settings: SelectionSettings,
    failures: str,
    report: Report = silent,
) -> Choice:
    """Choose the equation of one target."""
    began = time.monotonic()
    report(Progress("choosing", 0, None, ParetoFront(pool)))
    pick = pick_equation(samples.target, pool, samples, held_back, known, settings)
    return Choice(pick, time.monotonic() - began, failures)


def plan_tasks(states: Sequence[str], methods: Mapping[str, AbstractMethod]) -> dict[str, float]:
    """Give the name of every task to come with its rough seconds."""
    return {
        _search_name(s, name): _USUAL.get(name, _USUAL_SEARCH) for s in states for name in methods
    } | {_pick_name(state): _USUAL_PICK for state in states}


def search_tasks(
    samples: Mapping[str, Samples], methods: Mapping[str, AbstractMethod], seed: int, key: str
) -> list[Task]:
    """Give a task for every state and method; all its chance comes from the seed and the names."""
    tasks = []
    # The longest searches first would be better balanced, but nobody knows them.
    for state, own in samples.items():
        for name, method in methods.items():
            entropy = [seed, zlib.crc32(state.encode()), zlib.crc32(name.encode())]
            arguments = (method, own, np.random.SeedSequence(entropy))
            title = f"{state}' by {name}"
            tasks.append(Task(_search_name(state, name), title, search_one, arguments, Found, key))
    return tasks


def pick_tasks(
    pools: Mapping[str, Sequence[Candidate]],
    samples: Mapping[str, Samples],
    held_back: Sequence[Trajectory],
    known: Mapping[str, sympy.Expr],
    settings: SelectionSettings,
    failures: Mapping[str, str],
    key: str,
) -> list[Task]:
    """Give a task for every state that chooses among the formulas found for it."""
    return [
        Task(
            _pick_name(state),
            f"choice of {state}'",
            pick_one,
            (
                pool,
                samples[state],
                held_back,
                known.get(state, sympy.S.Zero),
                settings,
                failures[state],
            ),
            Choice,
            key,
        )
        for state, pool in pools.items()
    ]


def _search_name(state: str, method: str) -> str:
    return f"search-{state}-{method}"


def _pick_name(state: str) -> str:
    return f"pick-{state}"


def state_of(task: str) -> str:
    """Give the state that a task of this name works on.

    >>> state_of("search-x-sindy"), state_of("pick-theta1")
    ('x', 'theta1')
    """
    return task.split("-")[1]


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
