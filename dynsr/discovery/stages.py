"""Stages: one search in its steps, from looks at slopes to the fit of whole systems."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import monotonic
from typing import Any
from warnings import warn

import sympy
from joblib import effective_n_jobs

from dynsr import __version__
from dynsr.data import (
    Samples,
    Trajectory,
    carry,
    column_units,
    take_trajectories,
)
from dynsr.discovery.adoption import adopt_better, adopt_in_time
from dynsr.discovery.asked import KINDS, check_asked, choose_targets
from dynsr.discovery.asking import (
    add_conserved,
    ask_methods,
    check_must,
    searched_states,
    settle,
)
from dynsr.discovery.last_resort import follow_anyway
from dynsr.discovery.options import Options
from dynsr.discovery.orders import read_form
from dynsr.discovery.problem import (
    OtherFormulas,
    Problem,
    pool_formulas,
    with_velocities,
)
from dynsr.discovery.records import say_data
from dynsr.discovery.result import Discovery, keep
from dynsr.discovery.start import Start
from dynsr.discovery.tasks import (
    EXPLORATION,
    FIRST_LOOK,
    MORE_LOOKS,
    RARE_LOOK,
    START,
    Choice,
    Found,
    answer_soon,
    check_found,
    collect_best,
    cut_notes,
    cut_tasks,
    explore_tasks,
    give_turns,
    late_choice,
    late_search,
    look_again_tasks,
    look_task,
    pick_tasks,
    plan_tasks,
    search_tasks,
    start_tasks,
    state_of,
    tasks_of,
    with_bits,
)
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, find_engine, refuse_idle, share_engine
from dynsr.errors import InputError, one_line
from dynsr.expression import read_own_bits, to_text
from dynsr.fit import (
    Candidate,
    Loss,
    read_inputs,
    read_loss,
)
from dynsr.jobs import (
    Budget,
    End,
    Parts,
    RunFolder,
    Step,
    Task,
    TimeUp,
    Watch,
    check_jobs,
    fingerprint,
    finish_by,
    run_tasks,
    time_limit,
    to_plain,
)
from dynsr.methods import (
    AUTO,
    AbstractMethod,
    choose_methods,
    keeping,
)
from dynsr.selection import lead_with, rank_by_length
from dynsr.verdict import LAW, NOBODY, explain, name_engines, record_hold


def search_once(data: Sequence[Trajectory], asked: Options) -> Discovery:
    """Search the equations of trajectories in their own units, all with one set of constants."""
    began = monotonic()
    jobs = check_jobs(asked.jobs)
    chosen, workers = find_engine(asked.engine), effective_n_jobs(jobs)
    problem, targets = _pose(data, asked)
    methods = _prepare_methods(asked, problem, chosen, workers)
    problem = problem.counting(read_loss(asked.loss))
    runs, drives, demands = problem.runs, problem.inputs, problem.demands
    states = searched_states(problem.form.searched(targets), demands)
    begun = None if asked.start is None else Start.read(asked.start).check(runs[0], problem.form)
    bits = read_own_bits(asked.complexity)
    record = _begin_record(asked, problem, methods, begun)
    folder = RunFolder(asked.folder)
    key = _claim(folder, problem, states, methods, record)
    first, _ = finish_by(
        problem.until("searches"),
        lambda: _choose_first(asked, problem, chosen),
        lambda: (),
    )
    first = first if begun is None else (START, *first)
    steps = _Steps(
        problem, states, methods, asked.seed, key, folder, jobs, workers, first, bits, begun
    )
    found, alternatives, cut = steps.run(asked.report, record)
    if demands.conserved:
        follow = {s: problem.samples_in_time(s) for s, _ in demands.conserved}
        found = add_conserved(found, demands, follow, runs[0].states)
    record["scheme"] = {s: problem.samples_in_time(s).scheme for s in states}
    shown = set(record.get("first_look", ()))
    ran = [m for n, m in methods.items() if n in record["methods"] and not shown >= set(states)]
    along = EXPLORATION in first and not shown
    looked = FIRST_LOOK in first
    record["engines"] = name_engines(
        ran, chosen, found.equations, drives, along, looked, asked.discrete
    )
    found = replace(found, verdict=NOBODY) if demands.conserved else found
    left = _left_to_us(asked)
    found = _give_verdict(problem, found, alternatives, record, left, steps.parts)
    if cut := list(dict.fromkeys([*cut, *problem.cut])):
        record["ended_by_budget"] = cut
    found = replace(
        found,
        explanation=_explain(found, problem),
        trajectories=tuple(run.as_measured() for run in runs),
        inputs=drives,
        engine=chosen,
        settings=record,
        seconds=monotonic() - began,
    )
    _save(found, folder)
    return found


def _pose(data: Sequence[Trajectory], asked: Options) -> tuple[Problem, tuple[str, ...]]:
    """Give what is searched: the data and all that is said of their equations, and the targets."""
    settings, budget = asked.details, Budget(asked.time_budget)
    runs, drives = take_trajectories(data, asked.inputs, hold=asked.hold)
    check_asked(runs[0].states, asked.seed, **{name: getattr(asked, name) for name in KINDS})
    targets = choose_targets(asked.targets, runs[0])
    scheme = asked.scheme or ("forward" if asked.preset == "paper" else "auto")
    order = 1 if asked.order is None else asked.order
    form = read_form(order, asked.explicit_time, asked.discrete, runs, targets, asked.slopes)
    runs = form.prepare(carry(runs), scheme, settings.slopes)
    units = column_units(runs[0], asked.units)
    demands = asked.demands(runs[0].states, runs[0].names, units)
    settings = replace(settings, selection=settle(settings.selection, check_must(demands, runs)))
    known = read_inputs(asked.known or {}, (*runs[0].names, "t"))
    for state in known:
        runs[0].index(state)
    slopes = asked.slopes or {}
    return Problem(runs, drives, scheme, slopes, known, form, settings, demands, budget), targets


def _prepare_methods(
    asked: Options, problem: Problem, engine: AbstractEngine, workers: int
) -> dict[str, AbstractMethod]:
    """Give the methods that were chosen, as the demands ask for them."""
    shared, found = share_engine(engine, workers), choose_methods(asked.method, asked.preset)
    methods = {name: method.with_engine(shared) for name, method in found.items()}
    for own in (m.engine for m in methods.values() if m.engine is not None):
        share_engine(find_engine(own), workers)
    if asked.discrete and all(m.engine is None for m in methods.values()):
        refuse_idle(engine, "a map is iterated, and no method here solves regressions")
    return ask_methods(methods, problem.demands, problem.known)


def _begin_record(
    asked: Options,
    problem: Problem,
    methods: Mapping[str, AbstractMethod],
    begun: Start | None,
) -> dict[str, Any]:
    """Give what the record of a search says of how it was asked for."""
    runs, known, discrete = problem.runs, problem.known, problem.form.discrete
    bits, units = read_own_bits(asked.complexity), column_units(runs[0], asked.units)
    return {
        "method": asked.method if isinstance(asked.method, str) else ",".join(methods),
        "methods": list(methods),
        **({"known": {s: to_text(e) for s, e in known.items()}} if known else {}),
        **problem.form.record,
        **record_hold(runs[0], problem.inputs, discrete, asked.hold),
        **problem.demands.as_record(),
        **({} if units is None else {"column_units": units}),
        **({"complexity": bits} if bits else {}),
        **({} if asked.loss in (None, "squared") else {"loss": Loss(asked.loss).name}),
        **({} if begun is None else {"start": begun.record}),
        **({} if asked.time_budget is None else {"time_budget": asked.time_budget}),
        "preset": asked.preset,
        "seed": asked.seed,
        "scheme": problem.scheme,
        "engine": find_engine(asked.engine).name,
        "version": __version__,
        "details": {
            "methods": {name: to_plain(method) for name, method in methods.items()},
            **to_plain(problem.settings),
        },
    }


def _save(found: Discovery, folder: RunFolder) -> None:
    """Save the result in the folder; where that fails, say so: what was found is not lost."""
    if folder.path is None:
        return
    try:
        keep(found, folder.path)
    except (InputError, OSError) as error:
        warn(f"{one_line(error)}; the result is returned all the same", stacklevel=3)


def _explain(found: Discovery, problem: Problem) -> dict[str, str]:
    """Put what the verdict says before the words on where each equation comes from."""
    states = found.verdict.states
    form, settings = problem.form, problem.settings.verdict
    said = {
        s: explain(s, found.equations[s], own, form.discrete, settings) for s, own in states.items()
    }
    return {s: said.get(s, "") + why for s, why in found.explanation.items()}


def _give_verdict(
    problem: Problem,
    found: Discovery,
    alternatives: OtherFormulas | None,
    record: dict[str, Any],
    follow: bool,
    parts: Parts,
) -> Discovery:
    """Give the equations with their verdict, or others that are better or keep closer to the data.

    If Ctrl-C ends this, the equations stay as they were, without a verdict. Its finished parts,
    which were kept, are deleted at the end.
    """
    if not found.complete:
        return found
    if not found.verdict.tested:
        try:
            with keeping(parts):
                verdict = problem.give_verdict_in_time(found, alternatives)
                other = adopt_in_time(problem, replace(found, verdict=verdict), alternatives)
                if follow:
                    other = _follow(problem, other, record)
        except KeyboardInterrupt:
            return replace(found, complete=False)
        found = other
    parts.remove()
    return found


def _follow(problem: Problem, found: Discovery, record: dict[str, Any]) -> Discovery:
    """Take equations that keep closer to the data where those found part from them."""
    if not problem.settings.selection.parts.has("approximations"):
        return found
    other, cut = finish_by(
        problem.until("verdict"), lambda: follow_anyway(problem, found), lambda: None
    )
    problem.cut.extend(["following"] if cut else [])
    if other is None:
        return found
    record["followed_anyway"] = True
    return other


def _claim(
    folder: RunFolder,
    problem: Problem,
    states: Sequence[str],
    methods: Mapping[str, AbstractMethod],
    record: Mapping[str, Any],
) -> str:
    """Make the folder that of this discovery; gives the digest of all that its result depends on.

    Raises FolderTaken when the folder is another discovery's.
    """
    if folder.path is None:
        return ""
    about = {k: v for k, v in record.items() if k not in ("method", "details")}
    about |= {"targets": list(states), "data": say_data(problem.runs)}
    details = record["details"]
    key = fingerprint(
        about, details, problem.slopes, problem.known, problem.inputs, repr(dict(methods))
    )
    if problem.settings.selection.loss is not None:
        # Two functions may have one name.
        key = fingerprint(key, problem.settings.selection.loss.values)
    folder.claim("discovery", about, key)
    return key


def _with_equations(
    found: Sequence[Found], exprs: Mapping[str, sympy.Expr]
) -> dict[str, Candidate]:
    """Give the best candidate of each state, with the equation that was confirmed for it."""
    return {
        f.target: replace(f.candidates[0], expr=exprs[f.target]) for f in found if f.target in exprs
    }


def _left_to_us(asked: Options) -> bool:
    """Whether other ways than those of the methods named may be gone."""
    named = [asked.method] if isinstance(asked.method, (str, AbstractMethod)) else asked.method
    return asked.preset != "paper" and AUTO in named


def _choose_first(asked: Options, problem: Problem, engine: AbstractEngine) -> tuple[str, ...]:
    """Name what looks at every state before the methods, where these are left to us."""
    if not _left_to_us(asked):
        return ()
    # Who names an engine wants the methods that regress in it.
    looked = engine.name == DEFAULT_ENGINE
    data = problem.measurements
    if data is None:
        has = problem.settings.selection.parts.has
        again = [name for name in MORE_LOOKS if name == RARE_LOOK or has("look-again")]
        again = [name for name in again if name != RARE_LOOK or has("look-rare")]
        return (FIRST_LOOK, *again) if looked else ()
    # Exact rows that are far apart look as if they were noisy.
    exact = data.parts > 1 or data.may_be_exact
    return (FIRST_LOOK, EXPLORATION) if looked and exact else (EXPLORATION,)


@dataclass(frozen=True, eq=False)
class _Steps:
    """The steps of one discovery that take time, in tasks."""

    problem: Problem
    states: Sequence[str]
    methods: Mapping[str, AbstractMethod]
    seed: int
    key: str
    folder: RunFolder
    jobs: int
    workers: int
    first: tuple[str, ...]
    bits: Mapping[str, float]
    begun: Start | None = None

    @cached_property
    def parts(self) -> Parts:
        """What keeps the fits of whole systems until the discovery is whole."""
        return Parts(self.folder, "systems", self.key)

    def run(
        self, progress: Callable[[Step], None] | None, record: dict[str, Any]
    ) -> tuple[Discovery, OtherFormulas | None, list[str]]:
        """Give the discovery, what came closest to it, and the steps that a budget ended."""
        problem = self.problem
        plan = plan_tasks(self.states, self.methods, self.first)
        samples: dict[str, Samples] = {}
        with Watch(progress, plan, self.workers) as watch, keeping(self.parts):
            clock = time_limit(problem.until("equations"))
            try:
                with clock:
                    return self._run(watch, samples, record)
            except TimeUp:
                clock.leave()
                soon = {s: samples.get(s) or problem.samples_soon(s) for s in self.states}
                answer = answer_soon(watch, soon, problem.known, problem.demands)
                late = [name for name in watch.plan if name not in watch.records]
                cut = [*cut_tasks(list(watch.records.values())), *late, "equations"]
                return with_velocities(answer, problem.form), None, cut
            except KeyboardInterrupt:
                best = collect_best(watch, samples, problem.known)
                if best is None:
                    raise
                return with_velocities(best, problem.form), None, []

    def _run(
        self, watch: Watch, samples: dict[str, Samples], record: dict[str, Any]
    ) -> tuple[Discovery, OtherFormulas | None, list[str]]:
        problem, states = self.problem, self.states
        plain = FIRST_LOOK in self.first
        if self.first:
            samples |= {s: problem.samples(s, problem.runs, plain=plain) for s in states}
        begun = self._begin(watch, samples)
        ended = self._end_with(watch, begun, samples, record)
        if ended is not None:
            return *ended, problem.cut
        looked = self._look(watch, samples) if plain else []
        final = self._end_early(watch, looked, record)
        open_ = EXPLORATION in self.first and not final
        explored = self._explore(watch, samples) if open_ else []
        settled = problem.settle(explored) if explored else None
        only = bool(self.first) and not problem.settings.selection.parts.has("methods")
        methods = {} if settled is not None or only else self.methods
        if settled is not None:
            record["methods"] = [EXPLORATION]
            watch.skip(tasks_of(states, self.methods, picked=False))
            if problem.confirmed:
                final = _with_equations(explored, settled.exprs)
                settled = None
        training, held_back = problem.split()
        samples |= {s: problem.samples(s, training) for s in states}
        rest = {s: own for s, own in samples.items() if s not in final}
        searched = [*begun, *explored, *looked, *self._search(watch, methods, rest)]
        failures = check_found(searched, states)
        pools = pool_formulas(searched, samples, problem.demands, problem.known)
        pools = problem.without_poles(pools)
        choices = self._choose(watch, pools, samples, held_back, failures, final)
        picks = {c.pick.state: c.pick for c in choices}
        notes = "".join(f" {note}." for method in methods.values() for note in method.notes)
        said = {s: failures[s] + cut_notes(searched, s) + notes for s in states}
        found, alternatives = problem.fit(picks, pools, said, settled)
        return found, alternatives, [*cut_tasks([*searched, *choices]), *problem.cut]

    def _take(
        self,
        watch: Watch,
        tasks: Sequence[Task],
        share: str,
        late: Callable[[Task], Any],
        jobs: int = 1,
        finished: Callable[[Any], bool] = lambda record: True,
    ) -> list[Any]:
        """Give the records of tasks by a part of the budget; those of late ones by ``late``."""
        until, bits = self.problem.until(share), with_bits(tasks, self.bits)
        # Workers would take longer to start than the tasks have.
        jobs = jobs if End(until).left > self.problem.settings.shares.workers else 1
        ended = watch.records
        return finish_by(
            until,
            lambda: run_tasks(bits, self.folder, jobs, watch, finished=finished),
            lambda: [ended[t.name] if t.name in ended else late(t) for t in tasks],
        )[0]

    def _begin(self, watch: Watch, samples: Mapping[str, Samples]) -> list[Found]:
        """Fit the formulas of the earlier discovery to these data."""
        if self.begun is None:
            return []
        known = self.problem.known
        formulas = {s: self.begun.formulas(s, known.get(s, sympy.S.Zero)) for s in samples}
        tasks = start_tasks(formulas, samples, self.key)
        return self._take(watch, tasks, "searches", _late_in(samples))

    def _end_with(
        self,
        watch: Watch,
        begun: Sequence[Found],
        samples: Mapping[str, Samples],
        record: dict[str, Any],
    ) -> tuple[Discovery, OtherFormulas | None] | None:
        """Give the discovery of the earlier formulas where they are a law of these data."""
        problem = self.problem
        if not begun or not all(found.candidates for found in begun):
            return None
        pools = pool_formulas(begun, samples, problem.demands, problem.known)
        picks = {s: rank_by_length(s, pool, samples[s]) for s, pool in pools.items()}
        held = " It holds on these data too, and nothing else was searched."
        found, alternatives = problem.fit(picks, pools, dict.fromkeys(picks, held))
        if not all(problem.is_allowed(s, e) for s, e in found.equations.items()):
            return None
        found = adopt_better(problem, problem.with_verdict(found, alternatives), alternatives)
        if found.verdict.level != LAW:
            return None
        record["methods"] = [START]
        first = [name for name in self.first if name != START]
        watch.skip([*tasks_of(self.states, self.methods), *plan_tasks(self.states, {}, first)])
        return found, alternatives

    def _look(self, watch: Watch, samples: Mapping[str, Samples]) -> list[Found]:
        """Look at the slopes of every state first, then again with the results of others."""
        problem, settings = self.problem, self.problem.settings.selection
        demands = problem.demands
        found: list[Found] = []
        # Workers take longer to start than all of it, and each state is looked at with the others.
        for own in samples.values():
            task = look_task(own, found, demands, settings, self.key)
            found += self._take(watch, [task], "searches", _late_in(samples))
        ended: list[str] = []
        for source in (name for name in MORE_LOOKS if name in self.first):
            now = [f.target for f in found if f.final]
            tasks = look_again_tasks(samples, found, demands, settings, source, self.key)
            if source != RARE_LOOK:
                # One more look sees more only where the ones before it ended a state.
                tasks, ended = (tasks if now != ended else []), now
            coming = {task.name for task in tasks}
            planned = tasks_of(self.states, [source], picked=False)
            watch.skip(name for name in planned if name not in coming)
            known = {f.target: f for f in found}

            def unseen(task: Task, known: Mapping[str, Found] = known) -> Found:
                return known[state_of(task.name)]

            later = self._take(watch, tasks, "searches", unseen, self.jobs)
            again = {f.target: f for f in later}
            found = [again.get(f.target, f) for f in found]
        return found

    def _end_early(
        self, watch: Watch, looked: Sequence[Found], record: dict[str, Any]
    ) -> dict[str, Candidate]:
        """Give the equations that need no search.

        Slopes show some at once. Between distant rows they are too rough for that, and the states
        themselves decide.
        """
        problem = self.problem
        best = {f.target: f.candidates[0] for f in looked if f.candidates}
        final = {
            f.target: best[f.target]
            for f in looked
            if f.final
            and problem.measurements is None
            and problem.is_allowed(f.target, best[f.target].expr)
        }
        if len(final) < len(looked):
            final |= _with_equations(looked, problem.confirm(looked))
        if final and len(final) == len(looked):
            written = problem.conserve({s: c.expr for s, c in final.items()})
            final = {s: replace(c, expr=written[s]) for s, c in final.items()}
        if final:
            record["first_look"] = sorted(final)
            watch.skip([*tasks_of(tuple(final), self.methods), *plan_tasks(final, {}, self.first)])
        return final

    def _explore(self, watch: Watch, samples: Mapping[str, Samples]) -> list[Found]:
        """Look for sums of terms along the states."""
        selection = self.problem.settings.selection
        assert self.problem.measurements is not None
        tasks = explore_tasks(self.states, self.problem.measurements, selection, self.key)
        return self._take(watch, tasks, "searches", _late_in(samples), self.jobs)

    def _search(
        self,
        watch: Watch,
        methods: Mapping[str, AbstractMethod],
        samples: Mapping[str, Samples],
    ) -> list[Found]:
        """Search every state with every method."""
        until = self.problem.until("searches")
        turns = give_turns(self.states, methods, until, self.workers)
        tasks = search_tasks(samples, methods, self.seed, self.key, turns)
        return self._take(
            watch, tasks, "choices", _late_in(samples), self.jobs, lambda f: not f.error
        )

    def _choose(
        self,
        watch: Watch,
        pools: Mapping[str, Sequence[Candidate]],
        samples: Mapping[str, Samples],
        held_back: Sequence[Trajectory],
        failures: Mapping[str, str],
        final: Mapping[str, Candidate],
    ) -> list[Choice]:
        """Choose a formula of each state on its slopes; where systems are compared, roughly."""
        problem = self.problem
        ended = []
        for state, candidate in final.items():
            others = rank_by_length(state, pools[state], samples[state])
            ended.append(Choice(lead_with(others, candidate, samples[state]), 0.0))
        pools = {s: pool for s, pool in pools.items() if s not in final}
        if problem.measurements is not None:
            picks = [rank_by_length(s, pool, samples[s]) for s, pool in pools.items()]
            return [Choice(pick, 0.0, failures[pick.state]) for pick in picks]
        until, selection = End(problem.until("choices")), problem.settings.selection
        tasks = pick_tasks(
            pools, samples, held_back, problem.known, selection, failures, self.key, until
        )

        def late(task: Task) -> Choice:
            state = state_of(task.name)
            return late_choice(pools[state], samples[state], failures[state])

        # A choice among other formulas, since another method had failed, is none among these.
        return ended + self._take(
            watch,
            tasks,
            "comparison",
            late,
            self.jobs,
            lambda c: c.failures == failures[c.pick.state],
        )


def _late_in(samples: Mapping[str, Samples]) -> Callable[[Task], Found]:
    """Give what gives the record of a task that is late."""
    return lambda task: late_search(samples[state_of(task.name)], task.name)
