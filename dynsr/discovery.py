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

from dynsr import __version__
from dynsr.checkpoint import Part, Record, RunFolder, fingerprint, run_parts
from dynsr.derivatives import choose_samples
from dynsr.errors import InputError
from dynsr.expression import compile_numpy, parse, to_text
from dynsr.found import Discovery
from dynsr.intake import split_held_back, take_trajectories
from dynsr.methods.base import AbstractMethod
from dynsr.methods.matching import is_noisy, read_inputs
from dynsr.methods.snapping import as_decimals
from dynsr.pareto import Candidate, ParetoFront
from dynsr.polishing import polish
from dynsr.portfolio import choose_methods
from dynsr.samples import Samples
from dynsr.selection import (
    Pick,
    explains_all,
    pick_equation,
    read_candidates,
    trivial_candidates,
    write_candidates,
)
from dynsr.structure import settle
from dynsr.trajectory import Trajectory

_MOST_ROWS = 4000


@dataclass(frozen=True)
class Step:
    """One report of a running discovery: what ended, how many of how many, and its record."""

    what: str
    done: int
    total: int
    record: Record


def discover(
    data: Any,
    *,
    method: str | AbstractMethod | Sequence[str | AbstractMethod] = "auto",
    preset: str = "best",
    targets: str | Sequence[str] = "all",
    inputs: Mapping[str, str | sympy.Expr] | Sequence[str] | None = None,
    known: Mapping[str, str | sympy.Expr] | None = None,
    seed: int = 0,
    jobs: int = -1,
    engine: str = "embedded",
    scheme: str = "auto",
    slopes: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    progress: Callable[[Step], None] | None = None,
) -> Discovery:
    """Find the equation of every state from trajectories.

    Parameters
    ----------
    data : a Trajectory, a list of them, ``(t, x)`` arrays, or what
        :func:`dynsr.tabular.read_trajectories` reads: a file, a frame, a mapping.
    method : "auto", the name of a method, a method with its settings, or several.
    preset : "best", "quick" or "paper".
    targets : the states whose equations are sought; "all" of them by default.
    inputs : columns that are inputs, or input name -> expression in ``t``.
    known : state -> the part of its equation that is given; the rest is searched.
    seed : all chance comes from it; the result does not depend on ``jobs``.
    jobs : searches at a time; -1 uses every core.
    engine : what integrates the result ("embedded" or "julia").
    scheme : how slopes are made; "auto" lets the data choose.
    slopes : state -> the user's own slopes, one array (or one a trajectory).
    out : folder that keeps every finished part; the same call on it goes on where it was killed.
    progress : called as parts end.

    Part of the data is held back from the searches to choose among their formulas; then the
    constants are fitted to all of it. Raises InputError when the data cannot be used.

    >>> t = np.linspace(0, 3, 301)
    >>> found = discover((t, np.exp(-0.5 * t)[:, None]), preset="quick", jobs=1)
    >>> found.equations
    {'x': -0.5*x}
    """
    began = time.monotonic()
    runs, drives = take_trajectories(data, inputs)
    states = _choose_targets(targets, runs[0])
    parts_known = read_inputs(known or {}, (*runs[0].names, "t"))
    for state in parts_known:
        runs[0].index(state)
    methods = choose_methods(method, preset)
    problem = _Problem(runs, scheme, slopes or {}, parts_known, seed, RunFolder(_path(out)))
    tell = _Teller(progress, len(states) * (len(methods) + 1))
    pools = problem.search(states, methods, jobs, tell)
    picks = problem.pick(states, pools, jobs, tell)
    whole = {s: parts_known.get(s, sympy.S.Zero) + p.candidate.expr for s, p in picks.items()}
    settled = problem.settle(whole, picks, drives)
    polished = polish(
        settled,
        runs,
        drives,
        {s: problem.samples(s, runs, known_left_out=False) for s in states},
        {s: p.noise for s, p in picks.items()},
    )
    return Discovery(
        equations=polished.exprs,
        errors=polished.errors,
        front={s: _whole_front(pools[s], picks[s]) for s in states},
        explanation={s: p.explanation + _why(settled[s], whole[s]) for s, p in picks.items()},
        trajectories=tuple(runs),
        inputs=drives,
        settings={
            "method": method if isinstance(method, str) else ",".join(methods),
            "methods": list(methods),
            **({"known": {s: to_text(e) for s, e in parts_known.items()}} if parts_known else {}),
            "preset": preset,
            "seed": seed,
            "scheme": {s: problem.samples(s, runs).scheme for s in states},
            "engine": engine if isinstance(engine, str) else engine.name,
            "version": __version__,
        },
        seconds=time.monotonic() - began,
    )


def _whole_front(pool: Sequence[Candidate], pick: Pick) -> ParetoFront:
    """Merge what the methods found with what fitting and snapping made of it."""
    rivals = [rival.candidate for rival in pick.rivals]
    written = [replace(c, expr=as_decimals(c.expr)) for c in rivals]
    return ParetoFront([*pool, *written])


def _why(settled: sympy.Expr, picked: sympy.Expr) -> str:
    """Say when the states themselves asked for another formula than the slopes did."""
    if settled == picked:
        return ""
    return " Fitted to the noisy states themselves, other terms take fewer bits; they were taken."


def _path(out: str | Path | None) -> Path | None:
    return None if out is None else Path(out)


def _choose_targets(targets: str | Sequence[str], run: Trajectory) -> tuple[str, ...]:
    if isinstance(targets, str):
        targets = run.states if targets == "all" else (targets,)
    for target in targets:
        run.index(target)
    if not targets:
        raise InputError("no target was given; use 'all'")
    return tuple(dict.fromkeys(targets))


class _Teller:
    """Counts finished parts and passes them on."""

    def __init__(self, progress: Callable[[Step], None] | None, total: int) -> None:
        self.progress, self.total, self.done = progress, total, 0

    def __call__(self, part: Part, record: Record) -> None:
        self.done += 1
        if self.progress is not None:
            self.progress(Step(part.name, self.done, self.total, record))


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

    def search(
        self,
        states: Sequence[str],
        methods: Mapping[str, AbstractMethod],
        jobs: int,
        tell: _Teller,
    ) -> dict[str, list[Candidate]]:
        """Run every method on every state; gives all fronts' members."""
        training, _ = split_held_back(self.runs)
        parts = []
        for state in states:
            samples = self.samples(state, training)
            for name, method in methods.items():
                words = [self.seed, zlib.crc32(state.encode()), zlib.crc32(name.encode())]
                arguments = (method, samples, np.random.SeedSequence(words))
                key = self._key(state, name, repr(method))
                parts.append(Part(f"search-{state}-{name}", key, search_one, arguments))
        # The dear searches of hard states first would be better balanced, but nobody knows them.
        records = run_parts(parts, self.folder, jobs, tell)
        pools: dict[str, list[Candidate]] = {state: [] for state in states}
        for part, record in zip(parts, records, strict=True):
            pools[part.arguments[1].target] += read_candidates(record["front"])
        return pools

    def pick(
        self, states: Sequence[str], pools: Mapping[str, list[Candidate]], jobs: int, tell: _Teller
    ) -> dict[str, Pick]:
        """Choose one equation a state."""
        training, held_back = split_held_back(self.runs)
        parts = []
        for state in states:
            samples = self.samples(state, training)
            known = to_text(self.known.get(state, sympy.S.Zero))
            written = write_candidates(pools[state])
            key = self._key(state, json.dumps(written), known)
            arguments = (written, samples, held_back, known)
            parts.append(Part(f"pick-{state}", key, pick_one, arguments))
        records = run_parts(parts, self.folder, jobs, tell)
        return {s: Pick.from_record(s, record) for s, record in zip(states, records, strict=True)}

    def settle(
        self,
        exprs: Mapping[str, sympy.Expr],
        picks: Mapping[str, Pick],
        inputs: Mapping[str, sympy.Expr],
    ) -> Mapping[str, sympy.Expr]:
        """Let whole systems compete on the states where noise makes slopes unsure."""
        if self.known or not is_noisy(self.runs):
            return exprs
        rivals = {s: [r.candidate.expr for r in p.rivals[1:]] for s, p in picks.items()}
        return settle(exprs, rivals, self.runs, inputs)


def search_one(
    method: AbstractMethod, samples: Samples, sequence: np.random.SeedSequence
) -> Record:
    """Search one target with one method; gives a record of its front."""
    began = time.monotonic()
    trivial = trivial_candidates(samples)
    found = [c for c in trivial if explains_all(c, samples)]
    if not found:
        found = list(method.search(samples, np.random.default_rng(sequence)))
    return {
        "target": samples.target,
        "method": method.name,
        "front": write_candidates([*trivial, *found]),
        "seconds": time.monotonic() - began,
    }


def pick_one(
    front: list[Record], samples: Samples, held_back: Sequence[Trajectory], known: str
) -> Record:
    """Choose the equation of one target; gives a record of the choice."""
    pool = read_candidates(front)
    return pick_equation(samples.target, pool, samples, held_back, parse(known)).as_record()
