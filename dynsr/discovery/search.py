"""Discovery: from trajectories to the equations of every state, in one call."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import Any
from warnings import warn

import sympy
from joblib import effective_n_jobs

from dynsr import __version__
from dynsr.arguments import checked
from dynsr.data import (
    Samples,
    Trajectory,
    carry,
    column_units,
    take_trajectories,
)
from dynsr.discovery.adoption import adopt_better, adopt_in_time
from dynsr.discovery.asked import check_asked, choose_targets
from dynsr.discovery.asking import (
    add_conserved,
    ask_methods,
    check_must,
    searched_states,
    settle,
)
from dynsr.discovery.last_resort import follow_anyway
from dynsr.discovery.maps import ENGINES
from dynsr.discovery.orders import Order, read_form
from dynsr.discovery.prediction import name_engines, record_hold
from dynsr.discovery.problem import (
    DISCOVERY,
    DiscoverySettings,
    OtherFormulas,
    Problem,
    pool_formulas,
    with_velocities,
)
from dynsr.discovery.records import say_data
from dynsr.discovery.result import Discovery, keep
from dynsr.discovery.scaling import in_fitting_units
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
from dynsr.discovery.verdict import LAW, NOBODY, Verdict, explain
from dynsr.discovery.watching import with_progress
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, find_engine, refuse_idle, share_engine
from dynsr.errors import InputError, one_line
from dynsr.expression import arguments_of, read_own_bits, to_text
from dynsr.fit import (
    Candidate,
    Loss,
    LossFunction,
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
    DEFAULT_PRESET,
    AbstractMethod,
    Constraints,
    Must,
    choose_methods,
    keeping,
    read_demands,
)
from dynsr.selection import lead_with, rank_by_length


@checked
@with_progress
@in_fitting_units
def discover(
    data: Any,
    *,
    time: str | Sequence[Any] | None = None,
    states: Sequence[str] | str | None = None,
    trajectory: Sequence[str] | str | None = None,
    quantity: str | None = None,
    decimal: str | None = None,
    method: str | AbstractMethod | Sequence[str | AbstractMethod] = AUTO,
    preset: str = DEFAULT_PRESET,
    targets: str | Sequence[str] = "all",
    inputs: Mapping[str, Any] | Sequence[str] | str | None = None,
    hold: Mapping[str, str] | str | None = None,
    doses: Mapping[str, str] | None = None,
    noise: Mapping[str, Any] | None = None,
    limits: Mapping[str, Any] | None = None,
    observed: Mapping[str, str | sympy.Expr] | None = None,
    known: Mapping[str, str | sympy.Expr] | None = None,
    seed: int = 0,
    jobs: int = -1,
    engine: str | AbstractEngine = DEFAULT_ENGINE,
    scheme: str | None = None,
    slopes: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    progress: Callable[[Step], None] | bool | None = None,
    snap: bool = True,
    order: Order | None = None,
    explicit_time: bool = False,
    discrete: bool = False,
    settings: DiscoverySettings = DISCOVERY,
    functions: Sequence[str] | None = None,
    max_complexity: float | None = None,
    complexity: Mapping[str, float] | None = None,
    loss: str | LossFunction | None = None,
    terms: Sequence[str | sympy.Expr] = (),
    must: Must | None = None,
    constraints: Constraints | None = None,
    conserved: Sequence[str | sympy.Expr] = (),
    nonnegative: Sequence[str] = (),
    units: Mapping[str, str] | str | None = None,
    time_budget: float | None = None,
    vary: bool | str | Sequence[str] = False,
    delays: bool | float | Sequence[float] = False,
    hidden: bool | int | str = False,
    stochastic: bool = False,
    ensemble: bool | int = False,
    start: Discovery | Start | str | Path | None = None,
) -> Discovery:
    """Find the equation of every state from trajectories.

    Parameters
    ----------
    data : a Trajectory, a list of them, ``(t, x)`` arrays, or what
        :func:`dynsr.data.reading.read_trajectories` reads or gives: a file, a frame, a mapping.
        Cells may be empty (NaN): each state is used where it was measured. In a list, sources
        without a common state are one experiment, joined on the time.
    time : the name of the time column, or the (n,) times; guessed by default.
    states : the names of the state columns; every other column by default.
    trajectory : the column, or columns, whose values together name the trajectory of a row.
    quantity : the column of a long table that names the quantity of each row. Each quantity gets
        its own column. Guessed by default; "none" for a table without such a column.
    decimal : the decimal mark of numbers that are text, "." or ","; guessed by default.
    method : "auto", the name of a method, a method with its settings, or several.
    preset : "best", "quick" or "paper".
    targets : the states whose equations are searched; "all" by default.
    inputs : columns that are inputs; or input name -> expression in ``t``, function of one time,
        or values at the times.
    hold : input -> what it does between rows: "previous" (keeps its value), "linear" or "smooth".
        One word applies to all inputs. Chosen from the values by default.
    doses : state -> column of amounts. The state jumps by the amount right after that row. Each
        part between doses counts as a trajectory. "dose/V" divides the amounts by a volume V,
        which is fitted; "dose/2.5" by a number.
    noise : state -> its known measurement errors: a standard deviation in its units, a share of
        its value such as "5 %", a column of errors, or a value for each row. They weight the rows
        and are not estimated. A column such as x_sd that is not named here gives relative errors,
        whose size is estimated.
    limits : state -> the limit of its measurement in its units. Values at or below it, and cells
        such as "BDL", say only that the state was below it, which counts by its likelihood. Also
        the upper end of the range, such as ">100", both, such as "0.05..100", or the column of the
        limits of detection. Cells such as "<0.05" say their limit themselves.
    observed : column -> the linear combination of states that it is, such as {"total": "S + I"}.
        A state in it that has no column was not measured alone: it takes the place of the column.
        Each such state needs one sum.
    known : state -> the given part of its equation; the rest is searched. A function that has no
        other meaning is free, as in "a - f(x)*y": it is found, or stays a curve. Then all of these
        equations are whole, and names that are no columns are constants. See ``found.free``.
    seed : the source of all randomness; the result does not depend on ``jobs``.
    jobs : the number of searches at a time; -1 uses every core.
    engine : "embedded", "julia" or an engine, for regression and integration. Searches for
        constants on the states always use the embedded engine. The record says which engine did
        what (``settings["engines"]``). Another engine also integrates the result over the data
        (``settings["confirmed"]``).
    scheme : how slopes are estimated. "auto" lets the data choose. It is the default, except for
        preset "paper", which uses forward differences. Other names are those of
        :func:`dynsr.data.slopes.smooth_column`; "weak" is the weak form. In noise, "auto" is
        better than any of them, because it uses no slopes.
    slopes : state -> your own slopes, one array, or one for each trajectory.
    out : a folder that keeps every finished task, the result as discovery.json, and the data as
        data.csv (of long records, the windows that were searched), with which :func:`dynsr.load`
        reads it. The same call on it continues where it stopped.
    progress : a function that is called with a :class:`Step` as tasks end, and every half second
        while they run. True shows live lines, as a notebook does by default; False shows none.
    snap : whether constants become simple numbers where the data allow it. False leaves them as
        fitted. Terms are chosen in both cases, and exponents stay whole.
    order : 1, or 2 for ``x'' = f(x, x', ...)``, for all targets or state -> order. By default 1, or
        2 where states that come back to the same values with other slopes ask for it. The velocity
        ``x_dot`` is estimated from the data and is a state, with ``x' = x_dot``.
    explicit_time : whether equations may contain the time ``t``.
    discrete : whether to find a map ``x[n+1] = f(x[n])`` from row to row. Then nothing is
        differentiated or integrated, and the constants are those of least squares on one step.
    settings : the numbers that decide outside the methods.
    functions : functions and operators that equations may contain, such as ["exp", "/"]. Sums,
        products and whole powers are always allowed. None allows what each method has; [] allows
        sums and ratios of powers. See :meth:`dynsr.expression.Vocabulary.read`.
    max_complexity : the most bits of an equation; each fitted constant counts as one symbol
        (:func:`dynsr.fit.structure_bits`).
    complexity : function or operator -> bits that it adds to the description length of a formula,
        such as {"sin": 8, "/": 4}, wherever bits are counted.
    loss : "squared", "absolute", "huber", "cauchy", or a function of predicted and actual slopes
        (n,) that gives the loss of each row. It ranks formulas on slopes and fits the constants of
        the best ones. It does not affect the searches, the comparison of whole systems in noise,
        the last fit to the states, the verdict, or errors on fronts.
    terms : terms in the columns that every method searches in addition to its own.
    must : state -> a term, or several, that its equation must contain, with fitted coefficients;
        or lines such as "x: x*y". Floats inside a term are fitted too.
    constraints : state -> term -> "+", "-" or 0: the sign of its coefficient in the expanded
        equation; or lines such as "x: x*y < 0".
    conserved : linear combinations of states that do not change, such as "S + I + R". The equation
        of the last state of each follows from the others.
    nonnegative : states that never fall below 0: their slope at 0 is not negative.
    units : column, or "t" for the time, -> its unit as pint reads it, such as "m/s"; "columns"
        reads units in brackets from the names of the columns. No equation adds different units, or
        takes a function of a number with a unit. Coefficients may have any unit.
    time_budget : seconds after which the best result is taken, without the time for loading
        libraries. A budget that ends a search makes the result depend on the machine, and the
        record names what it ended. A budget that does not changes nothing.
    vary : True if constants may differ from run to run. Some runs are searched alone, all are
        fitted together, and the description length decides which constants are shared. A state,
        or several, allows it in their equations only. See :meth:`Discovery.vary`.
    delays : True if equations may contain states and inputs as they were some time before, such as
        ``x(t - 1.6)``. The data determine the delay, one for all columns, or that none is needed. A
        number, or several, is where its fit starts. ``found.delays`` has it with its interval.
    hidden : the name of one more state, which nobody measured and whose equation is searched too.
        True or 1 names it "hidden". Its scale, its sign and a function of the measured states that
        is added to it cannot be known: the simplest form is given. The explanation says what the
        data determine.
    stochastic : True if the motion itself has noise, ``dx = f dt + sqrt(D) dW``: the drift f of
        each state is found, with the variance D of its noise, which may depend on the columns.
        Errors of measurement are fitted with it where they are seen. ``found.diffusion`` has D
        with its intervals, and ``found.simulate_paths()`` draws paths.
    ensemble : True, or a number of draws: how often each term is kept, and the interval of its
        coefficient, in fits to data drawn with replacement (:func:`dynsr.bootstrap`). The result
        is in ``found.ensemble``, in the report and in the shell's output.
    start : an earlier discovery of the same columns, or the file or folder that it was saved to.
        Its formulas are fitted to these data and are candidates. If they are a law of these data
        too, the search ends.

    Ctrl-C ends the searches and gives what they have found: a Discovery whose ``complete`` is
    False, without a verdict. The same call on the same ``out`` continues. If nothing was found
    yet, it raises KeyboardInterrupt.

    The searches do not see a part of the data, which then chooses among their formulas. The
    constants are fitted to all of the data. Raises InputError when the data cannot be used,
    ``out`` has another discovery or the engine is unknown, EngineUnavailable when it is absent.

    >>> import numpy as np
    >>> t = np.linspace(0, 3, 301)
    >>> found = discover((t, np.exp(-0.5 * t)[:, None]), preset="quick", jobs=1)
    >>> found.equations
    {'x': -0.5*x}
    """
    began = monotonic()
    settings = settings if snap else settings.without_snapping()
    budget = Budget(time_budget)
    jobs = check_jobs(jobs)
    chosen, workers = find_engine(engine), effective_n_jobs(jobs)
    shared = share_engine(chosen, workers)
    runs, drives = take_trajectories(
        data, inputs, time, states, trajectory, hold, doses, quantity, decimal, noise, limits
    )
    seed = check_asked(
        runs[0].states,
        seed,
        method=method,
        targets=targets,
        known=known,
        slopes=slopes,
        scheme=scheme,
        out=out,
        progress=progress,
        settings=settings,
    )
    targeted = choose_targets(targets, runs[0])
    scheme = scheme or ("forward" if preset == "paper" else "auto")
    form = read_form(
        1 if order is None else order, explicit_time, discrete, runs[0], targeted, slopes
    )
    runs = form.prepare(carry(runs), scheme, settings.slopes)
    demands = read_demands(
        runs[0].states,
        runs[0].names,
        functions=functions,
        max_complexity=max_complexity,
        terms=terms,
        must=must,
        constraints=constraints,
        conserved=conserved,
        nonnegative=nonnegative,
        units=column_units(runs[0], units),
    )
    settings = replace(settings, selection=settle(settings.selection, check_must(demands, runs)))
    states = searched_states(form.searched(targeted), demands)
    bits = read_own_bits(complexity)
    given = read_inputs(known or {}, (*runs[0].names, "t"))
    for state in given:
        runs[0].index(state)
    methods = {n: m.with_engine(shared) for n, m in choose_methods(method, preset).items()}
    for own in (m.engine for m in methods.values() if m.engine is not None):
        share_engine(find_engine(own), workers)
    if discrete and all(m.engine is None for m in methods.values()):
        refuse_idle(chosen, "a map is iterated, and no method here solves regressions")
    methods = ask_methods(methods, demands, given)
    problem = Problem(runs, drives, scheme, slopes or {}, given, form, settings, demands, budget)
    problem = problem.counting(read_loss(loss))
    begun = None if start is None else Start.read(start).check(runs[0], form)
    record: dict[str, Any] = {
        "method": method if isinstance(method, str) else ",".join(methods),
        "methods": list(methods),
        **({"known": {s: to_text(e) for s, e in given.items()}} if given else {}),
        **form.record,
        **record_hold(runs[0], drives, discrete, hold),
        **demands.as_record(),
        **({} if units is None else {"column_units": column_units(runs[0], units)}),
        **({"complexity": bits} if bits else {}),
        **({} if loss in (None, "squared") else {"loss": Loss(loss).name}),
        **({} if begun is None else {"start": begun.record}),
        **({} if time_budget is None else {"time_budget": time_budget}),
        "preset": preset,
        "seed": seed,
        "scheme": scheme,
        "engine": chosen.name,
        "version": __version__,
        "details": {
            "methods": {name: to_plain(method) for name, method in methods.items()},
            **to_plain(settings),
        },
    }
    # A worker that outlives a change of folder must not take a relative path for its own.
    folder = RunFolder(None if out is None else Path(out).absolute())
    key = _claim(folder, problem, states, methods, record)
    first, _ = finish_by(
        problem.until("searches"),
        lambda: _choose_first(method, preset, problem, chosen),
        lambda: (),
    )
    first = first if begun is None else (START, *first)
    steps = _Steps(problem, states, methods, seed, key, folder, jobs, workers, first, bits, begun)
    found, alternatives, cut = steps.run(progress if callable(progress) else None, record)
    if demands.conserved:
        follow = {s: problem.samples_in_time(s) for s, _ in demands.conserved}
        found = add_conserved(found, demands, follow, runs[0].states)
    record["scheme"] = {s: problem.samples_in_time(s).scheme for s in states}
    measured = bool(set(arguments_of(found.equations)) - set(drives))
    shown = set(record.get("first_look", ()))
    ran = [m for n, m in methods.items() if n in record["methods"] and not shown >= set(states)]
    along = EXPLORATION in first and not shown
    record["engines"] = name_engines(ran, chosen, measured, along, FIRST_LOOK in first)
    record["engines"] |= ENGINES if discrete else {}
    found = replace(found, verdict=NOBODY) if demands.conserved else found
    found = _give_verdict(
        problem, found, alternatives, record, _left_to_us(method, preset), steps.parts
    )
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
                other, verdict = adopt_in_time(problem, found, verdict, alternatives)
                if follow:
                    other, verdict = _follow(problem, other, verdict, record)
        except KeyboardInterrupt:
            return replace(found, complete=False)
        found = replace(other, verdict=verdict)
    parts.remove()
    return found


def _follow(
    problem: Problem, found: Discovery, verdict: Verdict, record: dict[str, Any]
) -> tuple[Discovery, Verdict]:
    """Take equations that keep closer to the data where those found part from them."""
    if not problem.settings.selection.parts.has("approximations"):
        return found, verdict
    other, cut = finish_by(
        problem.until("verdict"), lambda: follow_anyway(problem, found, verdict), lambda: None
    )
    problem.cut.extend(["following"] if cut else [])
    if other is None:
        return found, verdict
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


def _left_to_us(method: str | AbstractMethod | Sequence[str | AbstractMethod], preset: str) -> bool:
    """Whether other ways than those of the methods named may be gone."""
    asked = [method] if isinstance(method, (str, AbstractMethod)) else method
    return preset != "paper" and AUTO in asked


def _choose_first(
    method: str | AbstractMethod | Sequence[str | AbstractMethod],
    preset: str,
    problem: Problem,
    engine: AbstractEngine,
) -> tuple[str, ...]:
    """Name what looks at every state before the methods, where these are left to us."""
    if not _left_to_us(method, preset):
        return ()
    # Who names an engine wants the methods that regress in it.
    looked = not problem.form.discrete and engine.name == DEFAULT_ENGINE
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
        found, verdict = adopt_better(
            problem, found, problem.give_verdict(found, alternatives), alternatives
        )
        if verdict.level != LAW:
            return None
        record["methods"] = [START]
        first = [name for name in self.first if name != START]
        watch.skip([*tasks_of(self.states, self.methods), *plan_tasks(self.states, {}, first)])
        return replace(found, verdict=verdict), alternatives

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
