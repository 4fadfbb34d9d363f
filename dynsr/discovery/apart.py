"""Apart: runs whose constants differ are searched one by one, and fitted together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from dynsr import __version__
from dynsr.data import Trajectory
from dynsr.discovery.options import Options, Search
from dynsr.discovery.records import say_data
from dynsr.discovery.result import Discovery, keep_if_asked
from dynsr.engines import find_engine
from dynsr.errors import InputError
from dynsr.expression import to_text
from dynsr.fit import ParetoFront, read_inputs
from dynsr.jobs import RunFolder, fingerprint, to_plain
from dynsr.verdict import LAW, name_engines

Asked = bool | tuple[str, ...]


def check_vary(asked: Any, runs: Sequence[Trajectory], discrete: bool) -> Asked:
    """Give whether constants may differ from run to run, or the states in whose equations.

    Parameters
    ----------
    asked : what :func:`dynsr.discover` was given.
    runs, discrete : the data, and whether the equations are a map.

    Raises InputError when it is neither, there is one run, or the equations are a map.
    """
    if isinstance(asked, bool):
        found: Asked = asked
    else:
        found = (asked,) if isinstance(asked, str) else tuple(asked)
        if unknown := [name for name in found if name not in runs[0].states]:
            raise InputError(
                f"vary names {unknown[0]!r}, which is no state; the states are: "
                f"{', '.join(runs[0].states)}. To let one parameter of the equations found differ, "
                f"ask them: found.vary([{unknown[0]!r}])"
            )
    if found and discrete:
        raise InputError("a map has no joint fit of its states; leave vary out")
    if found and len(runs) < 2:
        raise InputError(
            "constants can differ between trajectories, and there is one; give several, or name "
            "the column that names them (--trajectory)"
        )
    return found


def search_apart(
    search: Search, runs: Sequence[Trajectory], options: Options, asked: Asked
) -> Discovery:
    """Search some runs alone and give the law of all, with constants that may differ.

    Where equations are known for all states, they come first, with the constants of each run: the
    numbers that are given cannot be right in every run. Where they are a law, nothing is searched.
    Where none differs, or what differs leaves no law, all runs are searched together too.

    Parameters
    ----------
    search : finds equations of trajectories.
    runs : the data.
    options : of the search.
    asked : what :func:`check_vary` gave.
    """
    began = monotonic()
    _claim(runs, options, asked)
    found = _search_apart(search, runs, options, asked)
    record = {**found.settings, "vary": asked if isinstance(asked, bool) else list(asked)}
    found = replace(found, settings=record, seconds=monotonic() - began)
    keep_if_asked(found, options.out)
    return found


def _claim(runs: Sequence[Trajectory], options: Options, asked: Asked) -> None:
    """Make the folder that of this discovery; raises FolderTaken when it is another one's.

    Each search has a folder of its own in it.
    """
    left_out = ("out", "progress", "jobs")
    own = {f.name: getattr(options, f.name) for f in fields(options) if f.name not in left_out}
    about = {
        "vary": asked if isinstance(asked, bool) else list(asked),
        "version": __version__,
        "data": say_data(runs),
    }
    key = fingerprint(repr(to_plain(own)))
    RunFolder(options.folder).claim("discovery", about, key)


def _inside(options: Options, name: str) -> Path | None:
    """Give a subfolder of the folder that was asked for; None where none was."""
    return None if options.folder is None else options.folder / name


def _search_apart(
    search: Search, runs: Sequence[Trajectory], options: Options, asked: Asked
) -> Discovery:
    known = _as_known(runs, options)
    given = None if known is None else _vary([known], runs, asked)
    if given is not None and given.by_run.constants and given.verdict.level == LAW:
        return given
    varying = options.settings.vary
    alone: list[Discovery] = []
    faults: list[InputError] = []
    chosen = _most_telling(runs)[: varying.searched]
    if options.time_budget is not None:
        options = replace(options, time_budget=options.time_budget / (1 + len(chosen)))
    for place in chosen:
        own = replace(options, out=_inside(options, f"run-{place + 1}"))
        try:
            alone.append(search([_without_constants(runs[place])], own))
        except InputError as error:
            faults.append(error)
    if alone and not all(found.complete for found in alone):
        return _of_all(alone[0], runs)
    every = replace(options, out=_inside(options, "together"))
    varied = _vary(alone, runs, asked)
    if varied is not None and varied.by_run.constants and varied.verdict.level == LAW:
        return varied
    if varied is not None and varied.by_run.follows and not varied.by_run.constants:
        # It is a law of the known inputs of the runs as any other.
        found = search(runs, replace(every, start=options.start or varied))
        return replace(found, by_run=varied.by_run) if found.verdict.level == LAW else varied
    together = search(runs, every)
    if not together.complete or together.verdict.level == LAW:
        return together
    again = _vary([*alone, together], runs, asked)
    better = [found for found in (varied, again) if found is not None and found.by_run.runs]
    return min([*better, together], key=lambda found: found.verdict.rank)


def _as_known(runs: Sequence[Trajectory], options: Options) -> Discovery | None:
    """Give the known equations as a discovery; None where they are not those of all states."""
    run, inputs = runs[0], dict(options.drives)
    equations = read_inputs(options.known or {}, (*run.names, "t"))
    if set(equations) != set(run.states) or not options.first_order:
        return None
    engine = find_engine(options.engine)
    record = {
        **options.record("known", run),
        "known": {s: to_text(e) for s, e in equations.items()},
        "engine": engine.name,
        "engines": name_engines([], engine, equations, inputs, along=True),
    }
    nothing = {s: ParetoFront() for s in equations}
    return Discovery(equations, {}, nothing, {}, tuple(runs), inputs, record, engine=engine)


def _vary(found: Sequence[Discovery], runs: Sequence[Trajectory], asked: Asked) -> Discovery | None:
    if not found:
        return None
    first, *others = (_of_all(one, runs) for one in found)
    try:
        return first.vary(asked, others=others)
    except InputError:  # no equation can be fitted along every run
        return None


def _of_all(found: Discovery, runs: Sequence[Trajectory]) -> Discovery:
    return replace(found, trajectories=tuple(run.as_measured() for run in runs))


def _most_telling(runs: Sequence[Trajectory]) -> list[int]:
    """Places of the runs, first those with most rows and the widest motion."""
    spread = np.array([np.nanstd(run.observed, axis=0) for run in runs])
    usual = np.maximum(spread.max(axis=0), 1e-300)
    told = [len(run) * float(np.mean(own / usual)) for run, own in zip(runs, spread, strict=True)]
    return sorted(range(len(runs)), key=lambda place: -told[place])


def _without_constants(run: Trajectory) -> Trajectory:
    """Give a run without inputs that are constant along it: one run cannot determine them."""
    kept = [i for i in range(len(run.input_names)) if np.ptp(run.inputs[:, i]) > 0]
    names = tuple(run.input_names[i] for i in kept)
    hold = {name: way for name, way in run.hold.items() if name in names}
    return replace(run, inputs=run.inputs[:, kept], input_names=names, hold=hold)
