"""Tasks of a discovery: searches of one state by one method, and the choice of its equation.

When Ctrl-C ends them, what they have found so far is put together.
"""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import sympy

from dynsr import errors
from dynsr.data import Samples, Trajectory
from dynsr.discovery.result import Discovery, with_words
from dynsr.discovery.start import SOURCE
from dynsr.expression import counting
from dynsr.fit import (
    Candidate,
    Measurements,
    ParetoFront,
    choose,
    loosen,
    refit,
    score_candidate,
    tidy,
    without_rounding,
)
from dynsr.jobs import End, Task, TimeUp, Turn, Watch, best_equation, finish_by, time_limit
from dynsr.methods import (
    AbstractMethod,
    Demands,
    Limits,
    Progress,
    Report,
    fit_polynomials,
    silent,
)
from dynsr.selection import (
    Look,
    Pick,
    SelectionSettings,
    explains_all,
    explore,
    look,
    look_around,
    pick_equation,
    rank_by_length,
    trivial_candidates,
)

NEVER = End(math.inf)
# Rows, and columns at most, that a fit in no time takes.
_SOON, _SOON_COLUMNS = 400, 12
# When all time is over, the choice among what tasks have found takes no longer; nor do
# polynomials of degree 2 of all states.
_SECONDS_TO_CHOOSE, _SECONDS_TO_FIT = 0.3, 1.0
# Rough seconds of a task on one core, from which the time left is first guessed.
_USUAL = {"rational": 6.0, "sindy": 4.0, "dynaifeynman": 15.0, "genetic": 10.0}
_USUAL_SEARCH, _USUAL_PICK = 10.0, 6.0
# What looks for sums of terms along noisy states, in the names of its tasks.
EXPLORATION = "states"
# Functions that hardly any law has are looked for where no other equation helps.
FIRST_LOOK, RARE_LOOK = "look", "look at rare functions"
MORE_LOOKS = ("second look", RARE_LOOK, "third look")
START = "start"
_USUAL_FIRST = {EXPLORATION: 3.0, FIRST_LOOK: 0.3, START: 0.5} | dict.fromkeys(MORE_LOOKS, 1.0)


@dataclass(frozen=True)
class Found:
    """What one method found for one state.

    Parameters
    ----------
    target, method : the state and the method's name.
    candidates : its formulas.
    seconds : wall time.
    error, kind : what ended the method in words, and the name of that exception; "" if nothing.
    cut : the time budget ended the search.
    final : nothing is left to search for this state.
    bits : of the candidates, where they were fitted to the states.
    """

    target: str
    method: str
    candidates: tuple[Candidate, ...]
    seconds: float
    error: str = ""
    kind: str = ""
    cut: bool = False
    final: bool = False
    bits: tuple[float, ...] = ()

    @cached_property
    def front(self) -> ParetoFront:
        """Those that no other is both simpler and better than."""
        return ParetoFront(self.candidates)

    @property
    def lead(self) -> ParetoFront:
        """What to show of it: the law alone where it is final, else the front."""
        return ParetoFront(self.candidates[:1]) if self.final else self.front

    @property
    def summary(self) -> str:
        """The best of them in a few words."""
        return f"failed: {self.error}" if self.error else best_equation(self.lead)


@dataclass(frozen=True)
class Choice:
    """The equation chosen for a state.

    Parameters
    ----------
    pick : the choice.
    seconds : wall time.
    failures : which methods it had to do without, in words; "" for none.
    cut : the time budget ended it.
    """

    pick: Pick
    seconds: float
    failures: str = ""
    cut: bool = False

    @property
    def summary(self) -> str:
        """The equation in a few words."""
        return best_equation(ParetoFront([self.pick.candidate]))


def search_one(
    method: AbstractMethod,
    samples: Samples,
    sequence: np.random.SeedSequence,
    turn: Turn | None = None,
    report: Report = silent,
) -> Found:
    """Search one target with one method; a method that fails takes no other one with it."""
    began = time.monotonic()
    trivial = trivial_candidates(samples)
    found = [c for c in trivial if explains_all(c, samples)]
    error = kind = ""
    cut = False
    if not found:
        clock = time_limit(math.inf if turn is None else turn.until())
        try:
            with clock:
                report = report if turn is None else clock.through(report)
                found = list(method.search(samples, np.random.default_rng(sequence), report))
            cut = clock.over
        except TimeUp:
            clock.leave()
            cut = True
            # It did not answer in time, but it had said what it has.
            found = [] if clock.last is None else list(clock.last.front)
        except Exception as failure:
            error, kind = errors.one_line(failure)[:500], type(failure).__name__
            if errors.is_of_memory(failure):
                # Libraries call it by names of their own.
                error, kind = error or "there is not enough memory", MemoryError.__name__
    if cut:
        found += fit_soon(samples)
    taken = time.monotonic() - began
    return Found(samples.target, method.name, (*trivial, *found), taken, error, kind, cut)


def fit_soon(samples: Samples, until: float = math.inf) -> list[Candidate]:
    """Fit polynomials of degree 2, so that however little time there was, there is a choice.

    Parameters
    ----------
    samples : what they are fitted to; of many, few are taken.
    until : when those of degree 1 are taken instead, in seconds of the monotonic clock.
    """
    few = samples.select(np.linspace(0, len(samples) - 1, min(len(samples), _SOON)).astype(int))
    if few.X.shape[1] > _SOON_COLUMNS:
        return []

    def fit(degree: int) -> list[Candidate]:
        return [score_candidate(c.expr, samples, c.source) for c in fit_polynomials(few, degree)]

    return finish_by(until, partial(fit, 2), partial(fit, 1))[0]


def late_search(samples: Samples, task: str) -> Found:
    """Give the record of a search that the time budget ended before it had begun or answered.

    Parameters
    ----------
    samples : of the state.
    task : its name.
    """
    began = time.monotonic()
    method = task.split("-", 2)[2]
    pool = (*trivial_candidates(samples), *fit_soon(samples))
    return Found(samples.target, method, pool, time.monotonic() - began, cut=True)


def late_choice(pool: Sequence[Candidate], samples: Samples, failures: str) -> Choice:
    """Give the record of a choice that the time budget ended: by the bits of formulas as they are.

    Parameters
    ----------
    pool : the formulas.
    samples : of the state.
    failures : which methods it had to do without.
    """
    return Choice(rank_by_length(samples.target, pool, samples), 0.0, failures, cut=True)


def explore_one(
    state: str,
    data: Measurements,
    settings: SelectionSettings,
    report: Report = silent,
) -> Found:
    """Look for the sums of terms that follow one state best, along the smoothed states."""
    began = time.monotonic()
    found = explore(state, data, settings.comparison)
    samples = data.samples(state)
    named = "sums of terms fitted to the states"
    candidates = tuple(score_candidate(expr, samples, named) for expr in found)
    report(Progress("sums of terms", 0, None, ParetoFront(candidates)))
    taken = time.monotonic() - began
    return Found(state, EXPLORATION, candidates, taken, bits=tuple(found.values()))


def look_one(
    samples: Samples,
    known: Mapping[str, sympy.Expr],
    limits: Limits,
    settings: SelectionSettings,
    report: Report = silent,
) -> Found:
    """Look for a sum or ratio of a few terms that exact slopes leave no doubt of."""
    began = time.monotonic()
    trivial = trivial_candidates(samples)
    found = Look(tuple(c for c in trivial if explains_all(c, samples)), final=True)
    if not found.candidates and known:
        found = look_around(samples, limits, known, settings.look, settings.fit)
    if not found.candidates:
        found = look(samples, limits, settings.look, settings.fit)
    report(Progress("first look", 0, None, ParetoFront(found.candidates)))
    taken = time.monotonic() - began
    pool = (*found.candidates, *trivial)
    return Found(samples.target, FIRST_LOOK, pool, taken, final=found.final)


def look_again_one(
    samples: Samples,
    known: Mapping[str, sympy.Expr],
    earlier: Found,
    limits: Limits,
    settings: SelectionSettings,
    source: str,
    report: Report = silent,
) -> Found:
    """Look again with what is known of other states; keep what was found before."""
    began = time.monotonic()
    before = [c.expr for c in earlier.candidates]
    rare = source == RARE_LOOK
    seen = look(samples, limits, settings.look, settings.fit, known, before, rare=rare)
    candidates = tuple({c.expr: c for c in (*seen.candidates, *earlier.candidates)}.values())
    report(Progress(source, 0, None, ParetoFront(candidates)))
    taken = time.monotonic() - began
    return Found(samples.target, source, candidates, taken, final=seen.final)


def start_one(exprs: Sequence[sympy.Expr], samples: Samples, report: Report = silent) -> Found:
    """Fit the formulas of an earlier discovery to one state's samples."""
    began = time.monotonic()
    fitted = dict.fromkeys(refit(e, samples) for expr in exprs for e in (expr, loosen(expr)))
    finite = (score_candidate(e, samples, SOURCE) for e in fitted)
    candidates = tuple(c for c in finite if math.isfinite(c.loss))
    report(Progress(SOURCE, 0, None, ParetoFront(candidates)))
    return Found(samples.target, START, candidates, time.monotonic() - began)


def _task(
    state: str, method: str, said: str, work: Callable[..., Found], arguments: Any, key: str
) -> Task:
    """Give the task of a search of one state; the key digests all that its result depends on."""
    name, title = _search_name(state, method), f"{state}' {said}"
    return Task(name, title, work, arguments, Found, key)


def start_tasks(
    formulas: Mapping[str, Sequence[sympy.Expr]], samples: Mapping[str, Samples], key: str
) -> list[Task]:
    """Give a task for every state that fits the formulas of an earlier discovery."""
    return [
        _task(state, START, "from the start", start_one, (formulas[state], own), key)
        for state, own in samples.items()
    ]


def look_task(
    samples: Samples,
    found: Sequence[Found],
    demands: Demands,
    settings: SelectionSettings,
    key: str,
) -> Task:
    """Give the task of a state that has a first look at its slopes.

    Parameters
    ----------
    samples : of the state.
    found : what was found of the states before it.
    demands, settings, key : what the user asks, the numbers that decide, and the key of the task.
    """
    known = {f.target: f.candidates[0].expr for f in found if f.final}
    arguments = samples, known, demands.limits(samples.target), settings
    return _task(samples.target, FIRST_LOOK, "at a first look", look_one, arguments, key)


def look_again_tasks(
    samples: Mapping[str, Samples],
    found: Sequence[Found],
    demands: Demands,
    settings: SelectionSettings,
    source: str,
    key: str,
) -> list[Task]:
    """Give a task for every state that no look has ended yet.

    Parameters
    ----------
    samples : state -> its samples.
    found : what the looks before it found, of every state.
    source : which look it is.
    demands, settings, key : as for :func:`look_task`.
    """
    known = {f.target: f.candidates[0].expr for f in found if f.final}
    return [
        _task(
            f.target,
            source,
            f"at a {source}",
            look_again_one,
            (samples[f.target], known, f, demands.limits(f.target), settings, source),
            key,
        )
        for f in found
        if not f.final
    ]


def explore_tasks(
    states: Sequence[str], data: Measurements, settings: SelectionSettings, key: str
) -> list[Task]:
    """Give a task for every state that looks for sums of terms along the states."""
    return [
        _task(state, EXPLORATION, "from the states", explore_one, (state, data, settings), key)
        for state in states
    ]


def check_found(searched: Sequence[Found], states: Sequence[str]) -> dict[str, str]:
    """Say for every state which methods failed, "" where none did.

    Raises what ended the first of them where all methods of a state failed.
    """
    said = {}
    for state in states:
        own = [found for found in searched if found.target == state]
        failed = [found for found in own if found.error]
        if failed and len(failed) == len(own):
            raise _kinds().get(failed[0].kind, RuntimeError)(failed[0].error)
        said[state] = "".join(
            f" Without {found.method}, which failed ({found.kind}: {found.error})."
            for found in failed
        )
    return said


def _kinds() -> dict[str, type[Exception]]:
    """Name -> an error of dynsr that a task may end with, or want of memory."""
    found = {n: k for n, k in vars(errors).items() if isinstance(k, type)}
    own = {n: k for n, k in found.items() if issubclass(k, errors.DynsrError)}
    return {**own, MemoryError.__name__: MemoryError}


def pick_one(
    pool: Sequence[Candidate],
    samples: Samples,
    held_back: Sequence[Trajectory],
    known: sympy.Expr,
    settings: SelectionSettings,
    failures: str,
    until: End = NEVER,
    report: Report = silent,
) -> Choice:
    """Choose the equation of one target; past the time, by the bits of formulas as they are."""
    began = time.monotonic()
    report(Progress("choosing", 0, None, ParetoFront(pool)))
    choice, _ = finish_by(
        until.at,
        lambda: Choice(
            pick_equation(samples.target, pool, samples, held_back, known, settings), 0.0, failures
        ),
        lambda: late_choice(pool, samples, failures),
    )
    return replace(choice, seconds=time.monotonic() - began)


def plan_tasks(
    states: Iterable[str], methods: Mapping[str, AbstractMethod], first: Sequence[str] = ()
) -> dict[str, float]:
    """Give the name of every task to come with its rough seconds.

    ``first`` names what looks at every state before the methods do.
    """
    return (
        {_search_name(s, name): _USUAL_FIRST[name] for s in states for name in first}
        | {
            _search_name(s, name): _USUAL.get(name, _USUAL_SEARCH)
            for s in states
            for name in methods
        }
        | {_pick_name(state): _USUAL_PICK for state in states}
    )


def tasks_of(states: Sequence[str], methods: Collection[str], picked: bool = True) -> list[str]:
    """Give the names of the searches of some states, and of the choices of their equations."""
    searches = [_search_name(s, name) for s in states for name in methods]
    return searches + [_pick_name(s) for s in states if picked]


def search_tasks(
    samples: Mapping[str, Samples],
    methods: Mapping[str, AbstractMethod],
    seed: int,
    key: str,
    turns: Mapping[str, Turn] | None = None,
) -> list[Task]:
    """Give a task for every state and method; all its chance comes from the seed and the names."""
    tasks, turns = [], turns or {}
    # The longest searches first would be better balanced, but nobody knows them.
    for state, own in samples.items():
        for name, method in methods.items():
            entropy = [seed, zlib.crc32(state.encode()), zlib.crc32(name.encode())]
            turn = turns.get(_search_name(state, name))
            arguments = method, own, np.random.SeedSequence(entropy), turn
            one = _task(state, name, f"by {name}", search_one, arguments, key)
            tasks.append(replace(one, failed=partial(_died, state, name)))
    return tasks


def give_turns(
    states: Sequence[str], methods: Mapping[str, AbstractMethod], end: float, workers: int
) -> dict[str, Turn]:
    """Give the name of every search its turn, by the usual seconds of those behind it.

    Parameters
    ----------
    states, methods : what is searched, in this order.
    end : when the searches must have ended, on the monotonic clock; inf for never.
    workers : searches at a time.
    """
    if math.isinf(end):
        return {}
    names = {
        _search_name(state, name): _USUAL.get(name, _USUAL_SEARCH)
        for state in states
        for name in methods
    }
    left = math.fsum(names.values())
    turns = {}
    for name, seconds in names.items():
        turns[name] = Turn(End(end), seconds / left, workers)
        left -= seconds
    return turns


def cut_notes(searched: Sequence[Found], state: str) -> str:
    """Say which searches of a state the time budget ended; "" where it ended none."""
    names = [found.method for found in searched if found.target == state and found.cut]
    return f" The time budget ended {', '.join(names)} early." if names else ""


def cut_tasks(records: Sequence[Found | Choice]) -> list[str]:
    """Give the names of the tasks that the time budget ended."""
    names = []
    for record in records:
        if record.cut:
            if isinstance(record, Choice):
                names.append(_pick_name(record.pick.state))
            else:
                names.append(_search_name(record.target, record.method))
    return names


def _died(state: str, method: str, reason: str) -> Found:
    """Give the record of a search whose process died: its method failed, as others may."""
    return Found(state, method, (), 0.0, reason, "DynsrError")


def pick_tasks(
    pools: Mapping[str, Sequence[Candidate]],
    samples: Mapping[str, Samples],
    held_back: Sequence[Trajectory],
    known: Mapping[str, sympy.Expr],
    settings: SelectionSettings,
    failures: Mapping[str, str],
    key: str,
    until: End = NEVER,
) -> list[Task]:
    """Give a task for every state that chooses among the formulas found for it, by a time."""
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
                until,
            ),
            Choice,
            key,
        )
        for state, pool in pools.items()
    ]


def with_bits(tasks: Sequence[Task], bits: Mapping[str, float]) -> Sequence[Task]:
    """Give tasks that count the user's own bits, wherever they run; the same where there are none.

    Parameters
    ----------
    tasks : of a discovery.
    bits : function or operator -> bits.
    """
    if not bits:
        return tasks
    return [replace(task, work=partial(_count, bits, task.work)) for task in tasks]


def _count(bits: Mapping[str, float], work: Callable[..., Any], *arguments: Any) -> Any:
    with counting(bits):
        return work(*arguments)


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


def answer_soon(
    watch: Watch,
    samples: Mapping[str, Samples],
    known: Mapping[str, sympy.Expr],
    demands: Demands,
) -> Discovery:
    """Give an equation of every state when the time is over, whatever there is of it.

    Parameters
    ----------
    watch : what the tasks have.
    samples : state -> its samples.
    known : state -> the given part of its equation.
    demands : what the user asks.
    """
    clock = time_limit(time.monotonic() + _SECONDS_TO_CHOOSE)
    with suppress(TimeUp), clock:
        best = collect_best(watch, samples, known)
        if best is not None and all(
            s in best.equations and demands.keeps(s, best.equations[s], own.columns)
            for s, own in samples.items()
        ):
            searched = [r for r in watch.records.values() if isinstance(r, Found)]
            cut = {state: cut_notes(searched, state) for state in best.explanation}
            return replace(with_words(best, cut), complete=True)
    clock.leave()
    equations, fronts = {}, {}
    end = End(time.monotonic() + _SECONDS_TO_FIT)
    for done, (state, own) in enumerate(samples.items()):
        given = known.get(state, sympy.S.Zero)
        until = time.monotonic() + end.left / (len(samples) - done)
        pool = demands.select([*trivial_candidates(own), *fit_soon(own, until)], own, given)
        equations[state] = tidy(given + choose(pool, own).expr)
        fronts[state] = ParetoFront(pool)
    why = dict.fromkeys(equations, " Fitted in no time, when the time budget was over.")
    return Discovery(equations, dict.fromkeys(equations, ()), fronts, why)


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
        fronts[state] = ParetoFront(without_rounding(c, own) for c in pool)
        why[state] = f" Found by {best.source or 'search'}" + (
            "."
            if choices
            else "; the best so far; searches that had ended: "
            f"{len(ended)}, that still ran: {len(stopped)}."
        )
    if not equations:
        return None
    return Discovery(equations, dict.fromkeys(equations, ()), fronts, why, complete=False)
