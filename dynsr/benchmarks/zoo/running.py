"""Runs of the zoo: every system under every condition by every method, kept case by case."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import sympy
from joblib import effective_n_jobs

from dynsr import __version__
from dynsr.benchmarks.zoo.conditions import Condition, draw_conditions, measure
from dynsr.benchmarks.zoo.peers import answer_stlsq, answer_weak
from dynsr.benchmarks.zoo.scoring import Answer, Interval, score_answer
from dynsr.benchmarks.zoo.system import ZooSystem
from dynsr.data import Trajectory
from dynsr.discovery import DISCOVERY, Discovery, discover
from dynsr.errors import InputError, one_line
from dynsr.expression import free_constants, to_text
from dynsr.fit import loosen
from dynsr.jobs import RunFolder, Step, Task, Watch, fingerprint, run_tasks, to_plain
from dynsr.methods import DEFAULT_PRESET, Report
from dynsr.report import Table

LAW, APPROXIMATION, NOT_FOUND = LEVELS = ("law", "approximation", "not found")
_FOLLOWS, _FOLLOWS_CLOSELY = 0.9, 0.99
_USUAL_SECONDS = {"dynsr": 60.0}

Method = Callable[[Trajectory, int], Answer]


@dataclass(frozen=True)
class ZooRecord:
    """One case: a system under a condition, what a method found, and how good that is.

    Parameters
    ----------
    system, group, method : which system, "seen" or "drawn", and who searched.
    noise, kind, rows, dropped : the condition.
    equations : state -> what was found, as text.
    verdict : what the method says of it, "" where it says nothing.
    reproduced, unseen : R2 from the trained and from the second start.
    exact, constants_off, slopes_off, covered, constants : as in ``scoring.Scores``.
    is_law : whether it is the law, in form or as a function.
    seconds : wall time of the search.
    failure : why nothing was found.
    processor : seconds of the search on the processor.
    """

    system: str
    group: str
    method: str
    noise: float
    kind: str
    rows: int
    dropped: bool
    equations: dict[str, str]
    verdict: str
    reproduced: float
    unseen: float
    exact: bool
    constants_off: float
    slopes_off: float
    covered: int
    constants: int
    is_law: bool
    seconds: float
    failure: str = ""
    processor: float = 0.0

    @property
    def right(self) -> bool | None:
        """Whether the verdict is right; None without one, and of an approximation.

        "law" is right of the law, "not found" of equations that do not reproduce the true
        trajectory with an R2 above 0.9. Of an approximation nothing can be wrong.
        """
        if self.verdict not in (LAW, NOT_FOUND):
            return None
        if self.verdict == LAW:
            return self.is_law
        return self.reproduced <= _FOLLOWS

    @property
    def summary(self) -> str:
        """How good it is, in a few words."""
        if self.failure:
            return f"failed: {self.failure[:100]}"
        exact = ", exact" if self.exact else ""
        said = f", said {self.verdict}" if self.verdict else ""
        return f"R2 {self.reproduced:.3f}, unseen {self.unseen:.3f}{exact}{said}"


def answer_dynsr(
    data: Trajectory,
    seed: int = 0,
    preset: str = DEFAULT_PRESET,
    method: Any = "auto",
    without: Sequence[str] = (),
) -> Answer:
    """Discover as a user would: only the states' names are given.

    Parameters
    ----------
    data, seed, preset, method : as :func:`dynsr.discover` takes them.
    without : parts of the searches that are left out, of :data:`dynsr.selection.parts.PARTS`.

    Raises KeyboardInterrupt when the search was stopped: what it has by then is no answer.
    """
    settings = replace(DISCOVERY, selection=DISCOVERY.selection.without(*without))
    found = discover(data, preset=preset, method=method, seed=seed, jobs=1, settings=settings)
    if not found.complete:
        raise KeyboardInterrupt
    verdict = getattr(getattr(found, "verdict", None), "level", "")
    return Answer(found.equations, verdict, _intervals(found))


def _intervals(found: Discovery) -> dict[str, tuple[sympy.Expr, tuple[Interval, ...]]]:
    """Give the formula of every state that has as many floats as intervals, with these."""
    given = {}
    for state, expr in found.equations.items():
        intervals = tuple(_each_interval(found, state))
        for form in (expr, loosen(expr)):
            if intervals and len(free_constants(form, "constant ")[1]) == len(intervals):
                given[state] = (form, intervals)
    return given


def _each_interval(found: Discovery, state: str) -> Iterator[Interval]:
    pairs = found.errors.get(state, ())
    centres = found.fitted.get(state) or tuple(value for value, _ in pairs)
    for (value, error), centre in zip(pairs, centres, strict=True):
        yield value, centre - found.reach * error, centre + found.reach * error


def make_methods(
    names: Sequence[str] = ("dynsr",), preset: str = DEFAULT_PRESET, method: Any = "auto"
) -> dict[str, Method]:
    """Give those who search, by name.

    Parameters
    ----------
    names : "dynsr", "stlsq" and "weak".
    preset, method : of dynsr.

    Raises InputError for another name.
    """
    known: dict[str, Method] = {
        "dynsr": partial(answer_dynsr, preset=preset, method=method),
        "stlsq": answer_stlsq,
        "weak": answer_weak,
    }
    for name in names:
        if name not in known:
            raise InputError(f"unknown competitor {name!r}; they are: {', '.join(known)}")
    return {name: known[name] for name in names}


def run_zoo(
    animals: Sequence[ZooSystem],
    methods: Mapping[str, Method],
    draw: Callable[[str], Sequence[Condition]] = draw_conditions,
    *,
    seed: int = 0,
    out: str | Path | None = None,
    jobs: int = 1,
    progress: Callable[[Step], None] | None = None,
) -> list[ZooRecord]:
    """Give every system under its conditions to every method; one record a case.

    Parameters
    ----------
    animals : the systems.
    methods : name -> function of (trajectory, seed) that gives an Answer.
    draw : gives the conditions of a system of that name.
    seed : noise, lost rows and searches come from it.
    out : folder of the records; cases found there are not run again.
    jobs : cases at a time, -1 for one per core; each is searched by one process.
    progress : called with a :class:`Step` as cases end, and every half second while they run.

    Raises InputError when ``out`` cannot be used or holds results of other settings.
    """
    folder = RunFolder(None if out is None else Path(out).absolute())
    how = {name: _describe(method) for name, method in methods.items()}
    folder.claim("zoo", {"seed": seed, "version": __version__})
    tasks = [
        _make_task(animal, condition, name, method, how[name], seed)
        for animal in animals
        for condition in draw(animal.name)
        for name, method in methods.items()
    ]
    with Watch(progress, {t.name: t.seconds for t in tasks}, effective_n_jobs(jobs)) as watch:
        return run_tasks(tasks, folder, jobs, watch)


def _describe(method: Method) -> Any:
    """Write what a method is called with, for the key of its records."""
    return to_plain(getattr(method, "keywords", {}))


def _make_task(
    animal: ZooSystem, condition: Condition, name: str, method: Method, how: Any, seed: int
) -> Task:
    case = re.sub(r"[^A-Za-z0-9_.-]+", "-", f"{animal.name}-{condition.name}-{name}")
    key = fingerprint(to_plain(animal), to_plain(condition), name, how, seed, __version__)
    title = f"{name} on {animal.name}, {condition.name}, {condition.rows} rows"
    seconds = _USUAL_SECONDS.get(name, 5.0)
    arguments = (animal, condition, name, method, seed)
    return Task(
        case,
        title,
        run_case,
        arguments,
        ZooRecord,
        key,
        seconds,
        partial(_give_up, animal, condition, name),
    )


def run_case(
    animal: ZooSystem,
    condition: Condition,
    name: str,
    method: Method,
    seed: int,
    report: Report | None = None,
) -> ZooRecord:
    """Measure a system, have a method search, and score its answer.

    Whatever error ends a search, or an answer brings about, is kept in the record: no method may
    take the others' cases along.

    Parameters
    ----------
    animal, condition : the system and how it is measured.
    name, method : who searches.
    seed : of noise, lost rows and search.
    report : not used; the rows of the progress are whole cases.
    """
    measured = measure(animal, condition, seed)
    began, used = time.perf_counter(), time.process_time()
    try:
        answer = method(measured.data, seed)
    except Exception as error:
        answer = Answer({}, failure=f"{type(error).__name__}: {one_line(error)[:300]}")
    seconds, used = time.perf_counter() - began, time.process_time() - used
    try:
        scores = score_answer(answer, animal, measured)
    except Exception as error:
        answer = Answer({}, failure=f"cannot be scored: {one_line(error)[:300]}")
        scores = score_answer(answer, animal, measured)
    return ZooRecord(
        system=animal.name,
        group=animal.group,
        method=name,
        noise=float(condition.noise),
        kind=condition.kind,
        rows=condition.rows,
        dropped=condition.dropped,
        equations={s: to_text(e) for s, e in answer.equations.items()},
        verdict=answer.verdict,
        **vars(scores),
        is_law=scores.is_law,
        seconds=seconds,
        failure=answer.failure,
        processor=used,
    )


def _give_up(animal: ZooSystem, condition: Condition, name: str, reason: str) -> ZooRecord:
    def fail(data: Trajectory, seed: int) -> Answer:
        return Answer({}, failure=reason)

    return run_case(animal, condition, name, fail, 0)


def score_table(records: Iterable[ZooRecord]) -> Table:
    """Make the table of noise levels and methods: what share of cases was reproduced, and so on.

    Parameters
    ----------
    records : cases of any systems, conditions and methods.
    """
    columns = (
        *("noise (%)", "method", "cases", "R2 > 0.9 (%)", "R2 > 0.99 (%)"),
        *("unseen > 0.9 (%)", "unseen > 0.99 (%)", "law exact (%)", "same function (%)"),
        *("intervals right (%)", "failed", "seconds (median)", "seconds (worst)"),
    )
    lines = [
        (
            100 * noise,
            method,
            len(group),
            *_shares([r.reproduced for r in group]),
            *_shares([r.unseen for r in group]),
            _percent([r.exact for r in group]),
            _percent([r.is_law for r in group]),
            _coverage(group),
            sum(bool(r.failure) for r in group),
            median(r.processor for r in group),
            max(r.processor for r in group),
        )
        for (noise, method), group in _groups(records)
    ]
    return Table("zoo", "Systems found again", columns, tuple(lines))


def verdict_table(records: Iterable[ZooRecord]) -> Table:
    """Make the table of verdicts: how often each was given, and how often it was right.

    Parameters
    ----------
    records : cases of any systems, conditions and methods; methods without verdicts are left out.
    """
    lines = []
    for (noise, method), group in _groups(records):
        for level in LEVELS:
            said = [r for r in group if r.verdict == level]
            if said:
                right = [r.right for r in said if r.right is not None]
                known = (sum(right), _percent(right)) if right else (None, None)
                lines.append((100 * noise, method, level, len(said), *known))
    columns = ("noise (%)", "method", "verdict", "said", "right", "right (%)")
    return Table("zoo-verdicts", "What was said of them", columns, tuple(lines))


def _groups(
    records: Iterable[ZooRecord],
) -> Iterator[tuple[tuple[float, str], list[ZooRecord]]]:
    groups: dict[tuple[float, str], list[ZooRecord]] = {}
    for record in records:
        groups.setdefault((record.noise, record.method), []).append(record)
    order = list(dict.fromkeys(method for _, method in groups))
    yield from sorted(groups.items(), key=lambda item: (item[0][0], order.index(item[0][1])))


def _shares(values: Sequence[float]) -> tuple[float | None, float | None]:
    """Give the shares above both bounds; a case without a second start does not count."""
    known = [v for v in values if v <= 1]
    return tuple(_percent([v > b for v in known]) for b in (_FOLLOWS, _FOLLOWS_CLOSELY))  # type: ignore[return-value]


def _percent(hits: Sequence[bool]) -> float | None:
    return round(100 * sum(hits) / len(hits), 1) if hits else None


def _coverage(group: Sequence[ZooRecord]) -> float | None:
    count = sum(r.constants for r in group if r.noise)
    return round(100 * sum(r.covered for r in group if r.noise) / count, 1) if count else None
