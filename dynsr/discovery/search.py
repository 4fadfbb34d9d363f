"""Discovery: from trajectories to the equations of every state, in one call."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import sympy
from joblib import effective_n_jobs

from dynsr import __version__
from dynsr.data import (
    Samples,
    SlopeSettings,
    Trajectory,
    choose_samples,
    split_held_back,
    take_trajectories,
)
from dynsr.discovery.prediction import name_engines
from dynsr.discovery.result import Discovery
from dynsr.discovery.tasks import (
    Found,
    check_found,
    collect_best,
    pick_tasks,
    plan_tasks,
    search_tasks,
)
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, find_engine, share_engine
from dynsr.errors import InputError
from dynsr.expression import arguments_of, compile_numpy, to_text
from dynsr.fit import Candidate, ParetoFront, is_noisy, polish, read_inputs, tidy
from dynsr.jobs import RunFolder, Step, Watch, check_jobs, fingerprint, run_tasks, to_plain
from dynsr.methods import AUTO, DEFAULT_PRESET, AbstractMethod, choose_methods
from dynsr.selection import Pick, SelectionSettings, compare_systems


@dataclass(frozen=True)
class DiscoverySettings:
    """The numbers that decide in a discovery outside its methods; they stand in its record.

    Parameters
    ----------
    rows : samples of a state at most; of more rows, evenly spaced ones are taken.
    slopes : how the data choose the scheme of their slopes.
    selection : how one equation a state is chosen, constants are fitted and systems compared.

    >>> DiscoverySettings(rows=2000).selection.compared
    5
    """

    rows: int = 4000
    slopes: SlopeSettings = SlopeSettings()
    selection: SelectionSettings = SelectionSettings()


def discover(
    data: Any,
    *,
    method: str | AbstractMethod | Sequence[str | AbstractMethod] = AUTO,
    preset: str = DEFAULT_PRESET,
    targets: str | Sequence[str] = "all",
    inputs: Mapping[str, str | sympy.Expr] | Sequence[str] | None = None,
    known: Mapping[str, str | sympy.Expr] | None = None,
    seed: int = 0,
    jobs: int = -1,
    engine: str | AbstractEngine = DEFAULT_ENGINE,
    scheme: str | None = None,
    slopes: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    progress: Callable[[Step], None] | None = None,
    settings: DiscoverySettings = DiscoverySettings(),
) -> Discovery:
    """Find the equation of every state from trajectories.

    Parameters
    ----------
    data : a Trajectory, a list of them, ``(t, x)`` arrays, or what
        :func:`dynsr.data.reading.read_trajectories` reads: a file, a frame, a mapping.
    method : "auto", the name of a method, a method with its settings, or several.
    preset : "best", "quick" or "paper".
    targets : the states whose equations are sought; "all" of them by default.
    inputs : columns that are inputs, or input name -> expression in ``t``.
    known : state -> the part of its equation that is given; the rest is searched.
    seed : all chance comes from it; the result does not depend on ``jobs``.
    jobs : searches at a time; -1 uses every core.
    engine : "embedded", "julia" or an engine: what regresses and integrates. The searches for
        constants on the states stay in the embedded one; the record says which did what
        (``settings["engines"]``).
    scheme : how slopes are made; by default forward differences with preset "paper", as there,
        and with the others "auto", which lets the data choose.
    slopes : state -> the user's own slopes, one array (or one a trajectory).
    out : folder that keeps every finished task; the same call on it goes on where it was killed.
    progress : called with a :class:`Step` as tasks end, and every half second while they run.
    settings : the numbers that decide outside the methods.

    Ctrl-C ends the searches: what they have found is given as a Discovery whose ``complete`` is
    False, and the same call on the same ``out`` goes on from there; with nothing found yet it
    raises KeyboardInterrupt.

    Part of the data is held back from the searches to choose among their formulas; then the
    constants are fitted to all of it. Raises InputError when the data cannot be used, ``out``
    holds another discovery or the engine is unknown, EngineUnavailable when it is absent.

    >>> t = np.linspace(0, 3, 301)
    >>> found = discover((t, np.exp(-0.5 * t)[:, None]), preset="quick", jobs=1)
    >>> found.equations
    {'x': -0.5*x}
    """
    began = time.monotonic()
    jobs = check_jobs(jobs)
    chosen, workers = find_engine(engine), effective_n_jobs(jobs)
    shared = share_engine(chosen, workers)
    runs, drives = take_trajectories(data, inputs)
    states = _choose_targets(targets, runs[0])
    given = read_inputs(known or {}, (*runs[0].names, "t"))
    for state in given:
        runs[0].index(state)
    scheme = scheme or ("forward" if preset == "paper" else "auto")
    methods = {n: m.with_engine(shared) for n, m in choose_methods(method, preset).items()}
    for own in (m.engine for m in methods.values() if m.engine is not None):
        share_engine(find_engine(own), workers)
    problem = _Problem(runs, drives, scheme, slopes or {}, given, settings)
    record: dict[str, Any] = {
        "method": method if isinstance(method, str) else ",".join(methods),
        "methods": list(methods),
        **({"known": {s: to_text(e) for s, e in given.items()}} if given else {}),
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
    training, held_back = split_held_back(runs)
    samples = {s: problem.samples(s, training) for s in states}
    with Watch(progress, plan_tasks(states, methods), workers) as watch:
        try:
            tasks = search_tasks(samples, methods, seed, key)
            searched = run_tasks(tasks, folder, jobs, watch, finished=lambda found: not found.error)
            failures = check_found(searched, states)
            pools = _pool(searched, states)
            tasks = pick_tasks(pools, samples, held_back, given, settings.selection, failures, key)
            # A choice among other formulas, since another method had failed, is none among these.
            choices = run_tasks(
                tasks, folder, jobs, watch, finished=lambda c: c.failures == failures[c.pick.state]
            )
            notes = "".join(f" {note}." for method in methods.values() for note in method.notes)
            said = {s: failures[s] + notes for s in states}
            found = problem.fit({c.pick.state: c.pick for c in choices}, pools, said)
        except KeyboardInterrupt:
            best = collect_best(watch, samples, given)
            if best is None:
                raise
            found = best
    record["scheme"] = {s: problem.samples(s, runs).scheme for s in states}
    measured = bool(set(arguments_of(found.equations)) - set(drives))
    record["engines"] = name_engines(methods.values(), chosen, measured)
    return replace(
        found,
        trajectories=tuple(runs),
        inputs=drives,
        engine=chosen,
        settings=record,
        seconds=time.monotonic() - began,
    )


def _choose_targets(targets: str | Sequence[str], run: Trajectory) -> tuple[str, ...]:
    if isinstance(targets, str):
        targets = run.states if targets == "all" else (targets,)
    for target in targets:
        run.index(target)
    if not targets:
        raise InputError("no target was given; use 'all'")
    return tuple(dict.fromkeys(targets))


def _claim(
    folder: RunFolder,
    problem: _Problem,
    states: Sequence[str],
    methods: Mapping[str, AbstractMethod],
    record: Mapping[str, Any],
) -> str:
    """Make the folder that of this discovery; gives the digest of all that its result depends on.

    Raises FolderTaken when the folder is another discovery's.
    """
    if folder.path is None:
        return ""
    runs, names = problem.runs, ", ".join(problem.runs[0].names)
    digest = fingerprint([[run.t, run.columns, run.names] for run in runs])
    about = {k: v for k, v in record.items() if k not in ("method", "details")}
    about |= {"targets": list(states), "data": f"{sum(map(len, runs))} rows of {names}, {digest}"}
    details = record["details"]
    key = fingerprint(
        about, details, problem.slopes, problem.known, problem.inputs, repr(dict(methods))
    )
    folder.claim("discovery", about, key)
    return key


def _pool(searched: Sequence[Found], states: Sequence[str]) -> dict[str, list[Candidate]]:
    """Put together what all methods found for each state."""
    pools: dict[str, list[Candidate]] = {state: [] for state in states}
    for found in searched:
        pools[found.target] += found.candidates
    return pools


@dataclass(frozen=True, eq=False)
class _Problem:
    """The data of one discovery and what is given of their equations."""

    runs: Sequence[Trajectory]
    inputs: Mapping[str, sympy.Expr]
    scheme: str
    slopes: Mapping[str, Any]
    known: Mapping[str, sympy.Expr]
    settings: DiscoverySettings

    def samples(
        self, state: str, runs: Sequence[Trajectory], known_left_out: bool = True
    ) -> Samples:
        """Make the samples of a state, without the known part, thinned when there are many."""
        own = self.slopes.get(state)
        if own is not None and runs is not self.runs:
            # Own slopes fit the whole trajectories; the searches see all of them.
            runs = self.runs
        found = choose_samples(
            list(runs), state, scheme=self.scheme, slopes=own, settings=self.settings.slopes
        )
        rows = self.settings.rows
        if len(found) > rows:
            found = found.select(np.linspace(0, len(found) - 1, rows).astype(int))
        if state not in self.known or not known_left_out:
            return found
        given = compile_numpy([self.known[state]], [*found.names, "t"])
        values = given(np.concatenate([found.X.T, found.t[None]]))[0]
        return Samples(
            found.X, found.y - values, found.names, state, found.scheme, found.t, found.noise
        )

    def fit(
        self,
        picks: Mapping[str, Pick],
        pools: Mapping[str, list[Candidate]],
        notes: Mapping[str, str],
    ) -> Discovery:
        """Compare whole systems, fit the constants of the best to all data, and explain it."""
        picked = {s: self.known.get(s, sympy.S.Zero) + p.candidate.expr for s, p in picks.items()}
        system = self._compare_systems(picked, picks)
        fitted = polish(
            system,
            self.runs,
            self.inputs,
            {s: self.samples(s, self.runs, known_left_out=False) for s in picks},
            {s: p.noise for s, p in picks.items()},
            self.settings.selection.fit,
        )
        return Discovery(
            equations=fitted.exprs,
            errors=fitted.errors,
            front={s: _whole_front(pools[s], p) for s, p in picks.items()},
            explanation={
                s: p.explanation + _why(system[s], picked[s]) + notes[s] for s, p in picks.items()
            },
        )

    def _compare_systems(
        self, exprs: Mapping[str, sympy.Expr], picks: Mapping[str, Pick]
    ) -> Mapping[str, sympy.Expr]:
        """Let whole systems compete on the states where noise makes slopes unsure."""
        if self.known or not is_noisy(self.runs):
            return exprs
        others = {s: [r.candidate.expr for r in p.ranked[1:]] for s, p in picks.items()}
        return compare_systems(
            exprs, others, self.runs, self.inputs, self.settings.selection.comparison
        )


def _whole_front(pool: Sequence[Candidate], pick: Pick) -> ParetoFront:
    """Merge what the methods found with what fitting and snapping made of it."""
    last = [ranked.candidate for ranked in pick.ranked]
    return ParetoFront([*pool, *(replace(c, expr=tidy(c.expr)) for c in last)])


def _why(system: sympy.Expr, picked: sympy.Expr) -> str:
    """Say when the states themselves asked for another formula than the slopes did."""
    if system == picked:
        return ""
    return " Fitted to the noisy states themselves, other terms take fewer bits; they were taken."
