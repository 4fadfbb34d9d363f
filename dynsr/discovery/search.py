"""Discovery: from trajectories to the equations of every state, in one call."""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import sympy
from joblib import effective_n_jobs

from dynsr import __version__
from dynsr.data import Samples, Trajectory, choose_samples, split_held_back, take_trajectories
from dynsr.discovery.interruption import collect_best, stopping_at_interrupt
from dynsr.discovery.prediction import name_engines
from dynsr.discovery.result import Discovery
from dynsr.discovery.tasks import pick_one, search_one
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, find_engine, share_engine
from dynsr.errors import InputError
from dynsr.expression import arguments_of, compile_numpy, to_text
from dynsr.fit import Candidate, ParetoFront, is_noisy, polish, read_inputs, tidy
from dynsr.jobs import Part, RunFolder, Step, Watch, fingerprint, run_parts
from dynsr.methods import AUTO, DEFAULT_PRESET, AbstractMethod, choose_methods
from dynsr.selection import Pick, compare_systems, read_candidates, write_candidates

_MOST_ROWS = 4000


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
    out : folder that keeps every finished part; the same call on it goes on where it was killed.
    progress : called with a :class:`Step` as parts end, and every half second while they run.

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
    chosen, workers = find_engine(engine), effective_n_jobs(jobs)
    shared = share_engine(chosen, workers)
    runs, drives = take_trajectories(data, inputs)
    states = _choose_targets(targets, runs[0])
    parts_known = read_inputs(known or {}, (*runs[0].names, "t"))
    for state in parts_known:
        runs[0].index(state)
    scheme = scheme or ("forward" if preset == "paper" else "auto")
    methods = {n: m.with_engine(shared) for n, m in choose_methods(method, preset).items()}
    for own in (m.engine for m in methods.values() if m.engine is not None):
        share_engine(find_engine(own), workers)
    problem = _Problem(runs, scheme, slopes or {}, parts_known, seed, RunFolder(_path(out)))
    settings: dict[str, Any] = {
        "method": method if isinstance(method, str) else ",".join(methods),
        "methods": list(methods),
        **({"known": {s: to_text(e) for s, e in parts_known.items()}} if parts_known else {}),
        "preset": preset,
        "seed": seed,
        "scheme": scheme,
        "engine": chosen.name,
        "version": __version__,
    }
    problem.claim(states, methods, drives, settings)
    with problem.folder.live() as live, stopping_at_interrupt(live):
        watch = Watch(progress, live, _plan(states, methods), workers)
        try:
            with watch:
                found = problem.solve(states, methods, drives, jobs, watch)
        except KeyboardInterrupt:
            best = collect_best(states, watch.records, live.read(), problem.training, parts_known)
            if best is None:
                raise
            found = best
    settings["scheme"] = {s: problem.samples(s, runs).scheme for s in states}
    measured = bool(set(arguments_of(found.equations)) - set(drives))
    settings["engines"] = name_engines(methods.values(), chosen, measured)
    return replace(
        found,
        trajectories=tuple(runs),
        inputs=drives,
        engine=chosen,
        settings=settings,
        seconds=time.monotonic() - began,
    )


def _plan(states: Sequence[str], methods: Mapping[str, AbstractMethod]) -> dict[str, str]:
    """Name all parts to come, each with its method."""
    searches = {f"search-{s}-{name}": name for s in states for name in methods}
    return searches | {f"pick-{state}": "pick" for state in states}


def _whole_front(pool: Sequence[Candidate], pick: Pick) -> ParetoFront:
    """Merge what the methods found with what fitting and snapping made of it."""
    written = [replace(r.candidate, expr=tidy(r.candidate.expr)) for r in pick.ranked]
    return ParetoFront([*pool, *written])


def _why(settled: sympy.Expr, picked: sympy.Expr) -> str:
    """Say when the states themselves asked for another formula than the slopes did."""
    if settled == picked:
        return ""
    return " Fitted to the noisy states themselves, other terms take fewer bits; they were taken."


def _path(out: str | Path | None) -> Path | None:
    # A worker that outlives a change of folder must not take a relative path for its own.
    return None if out is None else Path(out).absolute()


def _choose_targets(targets: str | Sequence[str], run: Trajectory) -> tuple[str, ...]:
    if isinstance(targets, str):
        targets = run.states if targets == "all" else (targets,)
    for target in targets:
        run.index(target)
    if not targets:
        raise InputError("no target was given; use 'all'")
    return tuple(dict.fromkeys(targets))


@dataclass(frozen=True, eq=False)
class _Problem:
    """The data of one discovery and what is asked of them."""

    runs: Sequence[Trajectory]
    scheme: str
    slopes: Mapping[str, Any]
    known: Mapping[str, sympy.Expr]
    seed: int
    folder: RunFolder

    def samples(
        self, state: str, runs: Sequence[Trajectory], known_left_out: bool = True
    ) -> Samples:
        """Make the samples of a state, without the known part, thinned when there are many."""
        own = self.slopes.get(state)
        if own is not None and runs is not self.runs:
            # Own slopes fit the whole trajectories; the searches see all of them.
            runs = self.runs
        found = choose_samples(list(runs), state, scheme=self.scheme, slopes=own)
        if len(found) > _MOST_ROWS:
            found = found.select(np.linspace(0, len(found) - 1, _MOST_ROWS).astype(int))
        if state not in self.known or not known_left_out:
            return found
        given = compile_numpy([self.known[state]], [*found.names, "t"])
        values = given(np.concatenate([found.X.T, found.t[None]]))[0]
        return Samples(
            found.X, found.y - values, found.names, state, found.scheme, found.t, found.noise
        )

    def _key(self, *parts: Any) -> str:
        data = [[run.t, run.columns, run.names] for run in self.runs]
        return fingerprint(
            data, self.scheme, self.slopes, self.known, self.seed, __version__, *parts
        )

    def claim(
        self,
        states: Sequence[str],
        methods: Mapping[str, AbstractMethod],
        drives: Mapping[str, sympy.Expr],
        settings: Mapping[str, Any],
    ) -> None:
        """Mark the folder as this discovery's; raises FolderTaken when it is another's."""
        rows = f"{sum(map(len, self.runs))} rows of {', '.join(self.runs[0].names)}"
        about = {k: v for k, v in settings.items() if k != "method"}
        about |= {"targets": list(states), "data": f"{rows}, {self._key()}"}
        self.folder.claim(self._key(repr(dict(methods)), about, drives), about)

    def training(self, state: str) -> Samples:
        """Give the samples that the searches of a state see."""
        return self.samples(state, split_held_back(self.runs)[0])

    def solve(
        self,
        states: Sequence[str],
        methods: Mapping[str, AbstractMethod],
        drives: Mapping[str, sympy.Expr],
        jobs: int,
        watch: Watch,
    ) -> Discovery:
        """Search, choose and polish."""
        pools = self.search(states, methods, jobs, watch)
        picks = self.pick(states, pools, jobs, watch)
        whole = {s: self.known.get(s, sympy.S.Zero) + p.candidate.expr for s, p in picks.items()}
        settled = self.settle(whole, picks, drives)
        polished = polish(
            settled,
            self.runs,
            drives,
            {s: self.samples(s, self.runs, known_left_out=False) for s in states},
            {s: p.noise for s, p in picks.items()},
        )
        notes = "".join(f" {note}." for method in methods.values() for note in method.notes)
        return Discovery(
            equations=polished.exprs,
            errors=polished.errors,
            front={s: _whole_front(pools[s], picks[s]) for s in states},
            explanation={
                s: p.explanation + _why(settled[s], whole[s]) + notes for s, p in picks.items()
            },
        )

    def settle(
        self,
        exprs: Mapping[str, sympy.Expr],
        picks: Mapping[str, Pick],
        inputs: Mapping[str, sympy.Expr],
    ) -> Mapping[str, sympy.Expr]:
        """Let whole systems compete on the states where noise makes slopes unsure."""
        if self.known or not is_noisy(self.runs):
            return exprs
        alternatives = {s: [r.candidate.expr for r in p.ranked[1:]] for s, p in picks.items()}
        return compare_systems(exprs, alternatives, self.runs, inputs)

    def search(
        self,
        states: Sequence[str],
        methods: Mapping[str, AbstractMethod],
        jobs: int,
        watch: Watch,
    ) -> dict[str, list[Candidate]]:
        """Run every method on every state; gives all fronts' members."""
        parts = []
        for state in states:
            samples = self.training(state)
            for name, method in methods.items():
                words = [self.seed, zlib.crc32(state.encode()), zlib.crc32(name.encode())]
                arguments = (method, samples, np.random.SeedSequence(words))
                key = self._key(state, name, repr(method))
                about = {"state": state, "method": name}
                parts.append(Part(f"search-{state}-{name}", key, search_one, arguments, about))
        # The dear searches of hard states first would be better balanced, but nobody knows them.
        records = run_parts(parts, self.folder, jobs, watch, watch.live)
        pools: dict[str, list[Candidate]] = {state: [] for state in states}
        for part, record in zip(parts, records, strict=True):
            pools[part.arguments[1].target] += read_candidates(record["front"])
        return pools

    def pick(
        self, states: Sequence[str], pools: Mapping[str, list[Candidate]], jobs: int, watch: Watch
    ) -> dict[str, Pick]:
        """Choose one equation a state."""
        _, held_back = split_held_back(self.runs)
        parts = []
        for state in states:
            samples = self.training(state)
            known = to_text(self.known.get(state, sympy.S.Zero))
            written = write_candidates(pools[state])
            key = self._key(state, json.dumps(written), known)
            arguments = (written, samples, held_back, known)
            about = {"state": state, "method": "pick"}
            parts.append(Part(f"pick-{state}", key, pick_one, arguments, about))
        records = run_parts(parts, self.folder, jobs, watch, watch.live)
        return {s: Pick.from_record(s, record) for s, record in zip(states, records, strict=True)}
