"""Noise: how often the true equations of known systems are found again, at levels of noise."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import sympy
from joblib import effective_n_jobs

from dynsr import __version__
from dynsr.data import System, Trajectory
from dynsr.discovery import discover
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, add_noise, training_trajectory
from dynsr.errors import DynsrError, InputError
from dynsr.expression import parse, to_text
from dynsr.fit import ParetoFront
from dynsr.jobs import RunFolder, Step, Task, Watch, fingerprint, run_tasks, to_plain
from dynsr.methods import DEFAULT_PRESET, AbstractMethod, Progress, Report, silent
from dynsr.report import Formula, Table
from dynsr.verdict import equation_rmse

NOISE_LEVELS = (0.0, 0.001, 0.01, 0.05)
_EXACT_WITHIN = 0.02
# Two constants inside a function, such as the 1 in sin(1*x), are the same to this many digits.
_DIGITS_INSIDE = 2
# Rough seconds of a discovery on one core.
_USUAL_SECONDS = 60.0

Search = Callable[[Trajectory, int], Mapping[str, sympy.Expr]]


@dataclass(frozen=True)
class Recovery:
    """What was found for one state of one system.

    ``same_form`` says whether the formula has exactly the terms of the true one;
    ``constants_off`` is then the largest relative error of its constants, and ``recovered``
    whether that is within 2 %.
    """

    system: str
    state: str
    noise: float
    seed: int
    found: str
    same_form: bool
    constants_off: float
    seconds: float

    @property
    def recovered(self) -> bool:
        """Whether the equation was found: its form, and each constant within 2 %."""
        return self.same_form and self.constants_off <= _EXACT_WITHIN


def measure_recovery(
    systems: Sequence[System],
    search: Search,
    noise: Sequence[float] = NOISE_LEVELS,
    seeds: Sequence[int] = (0,),
    engine: str | AbstractEngine = DEFAULT_ENGINE,
) -> Iterator[Recovery]:
    """Search each system's equations in its training data and compare them with the true ones.

    ``search`` gives {state: formula} for a trajectory and a seed. Noise is a fraction of each
    state's standard deviation; ``engine`` makes the data. Gives one Recovery a state as soon as it
    is known.
    """
    for level in noise:
        _check_level(level)
    for system in systems:
        clean = training_trajectory(system, engine)
        for level in noise:
            # Without noise the data are the same whatever the seed.
            for seed in seeds if level else seeds[:1]:
                data = add_noise(clean, level, np.random.default_rng(seed))
                began = time.perf_counter()
                found = search(data, seed)
                seconds = time.perf_counter() - began
                for state, true in zip(system.states, system.rhs, strict=True):
                    yield _compare(system.name, state, level, seed, found.get(state), true, seconds)


def _check_level(level: float) -> None:
    if not (np.isfinite(level) and level >= 0):
        raise InputError(f"noise {level} must be a number from 0 up, such as 0.01 for 1 %")


def _compare(
    system: str,
    state: str,
    noise: float,
    seed: int,
    found: sympy.Expr | None,
    true: sympy.Expr,
    seconds: float,
) -> Recovery:
    same, off = (False, float("inf")) if found is None else compare_formulas(found, true)
    text = "" if found is None else to_text(found)
    return Recovery(system, state, noise, seed, text, same, off, seconds)


def compare_formulas(found: sympy.Expr, true: sympy.Expr) -> tuple[bool, float]:
    """Say whether two formulas have the same terms, and how far their constants are apart.

    Both are brought to one fraction of sums, whose first term of the denominator has the constant
    1 (sin(v)^2 is taken as 1 - cos(v)^2); the distance is the largest relative one. Formulas of
    other terms are infinitely far apart.

    >>> from dynsr.expression import parse
    >>> same, off = compare_formulas(parse("x*(1.5 - 1.01*y)"), parse("1.5*x - x*y"))
    >>> same, round(off, 3)
    (True, 0.01)
    """
    ours, theirs = _terms(found), _terms(true)
    if ours.keys() != theirs.keys():
        return False, float("inf")
    return True, max((abs(ours[k] - c) / abs(c) for k, c in theirs.items()), default=0.0)


def _terms(expr: sympy.Expr) -> dict[Any, float]:
    """Give the constants of numerator and denominator by their term, normalised."""
    above, below = sympy.fraction(sympy.together(sympy.expand(_round_inside(expr))))
    parts = [_constants(above), _constants(below)]
    lead = parts[1][min(parts[1], key=sympy.default_sort_key)]
    return {(j, term): c / lead for j, part in enumerate(parts) for term, c in part.items()}


def _constants(expr: sympy.Expr) -> dict[sympy.Expr, float]:
    found: dict[sympy.Expr, float] = {}
    for term in sympy.Add.make_args(sympy.expand(_without_squared_sines(sympy.expand(expr)))):
        number, rest = term.as_coeff_Mul()
        found[rest] = found.get(rest, 0.0) + float(number)
    largest = max(map(abs, found.values()))
    # Terms that cancel leave rounding.
    return {term: number for term, number in found.items() if abs(number) > 1e-12 * largest}


def _without_squared_sines(expr: sympy.Expr) -> sympy.Expr:
    """Write sin(v)^2 as 1 - cos(v)^2: equal functions have equal terms."""

    def squared(node: sympy.Expr) -> bool:
        whole = node.is_Pow and node.exp.is_Integer and node.exp >= 2
        return bool(whole and isinstance(node.base, sympy.sin))

    def written(node: sympy.Expr) -> sympy.Expr:
        pairs, left = divmod(int(node.exp), 2)
        return (1 - sympy.cos(node.base.args[0]) ** 2) ** pairs * node.base**left

    return expr.replace(squared, written)


def _round_inside(expr: sympy.Expr) -> sympy.Expr:
    """Round the constants inside functions, so that sin(1.0001*x) and sin(x) are one term."""

    def rounded(node: sympy.Expr) -> sympy.Expr:
        numbers = {}
        for number in node.atoms(sympy.Float):
            text = f"{float(number):.{_DIGITS_INSIDE - 1}e}"
            numbers[number] = sympy.nsimplify(text, rational=True)
        return node.xreplace(numbers)

    return expr.replace(lambda node: isinstance(node, sympy.Function), rounded)


Method = str | AbstractMethod | Sequence[str | AbstractMethod]


@dataclass(frozen=True)
class NoiseRow:
    """One state of one discovery: what was found, and how far it is from the truth.

    ``equation_rmse`` is taken along the true states of the test span (units of the state a
    second); the ``seconds`` of the discovery are those of all its states.
    """

    recovery: Recovery
    equation_rmse: float


@dataclass(frozen=True)
class NoiseRecord:
    """What the discovery of one noisy system gave: a row per state, and why it failed if it did."""

    rows: tuple[NoiseRow, ...]
    seconds: float
    failure: str = ""

    @property
    def summary(self) -> str:
        """How many of the equations were found, in a few words."""
        exact = sum(row.recovery.same_form for row in self.rows)
        return self.failure or f"{exact} of {len(self.rows)} equations exact"


def run_noise(
    systems: Sequence[System],
    levels: Sequence[float] = NOISE_LEVELS,
    seeds: Sequence[int] = (0, 1, 2, 3, 4),
    *,
    method: Method = "auto",
    preset: str = DEFAULT_PRESET,
    out: str | Path | None = None,
    jobs: int = 1,
    progress: Callable[[Step], None] | None = None,
) -> list[NoiseRow]:
    """Discover every system at every level with every seed; gives one row per state.

    Data are the paper's training data of the system with Gaussian noise on its states; inputs are
    given and exact. Without noise one seed is enough, since the data are the same.

    Parameters
    ----------
    levels : standard deviation of the noise in units of each state's own.
    method, preset : as :func:`dynsr.discover` takes them.
    out : folder of the records; draws found there are not computed again.
    jobs : draws at a time; each is searched by one process.
    progress : called with a :class:`Step` as draws end, and every half second while they run.

    Raises InputError when a level is no number from 0 up, or ``out`` cannot be used or holds
    results of another method, preset or version of dynsr.
    """
    for level in levels:
        _check_level(level)
    folder = RunFolder(None if out is None else Path(out).absolute())
    settings = {"method": method, "preset": preset, "version": __version__}
    folder.claim("noise benchmark", settings, repr(method))
    tasks = [
        _make_task(system, level, seed, method, preset, folder)
        for system in systems
        for level in levels
        for seed in (seeds if level else seeds[:1])
    ]
    with Watch(progress, {t.name: t.seconds for t in tasks}, effective_n_jobs(jobs)) as watch:
        records = run_tasks(tasks, folder, jobs, watch)
    return [row for record in records for row in record.rows]


def _make_task(
    system: System, level: float, seed: int, method: Method, preset: str, folder: RunFolder
) -> Task:
    name = f"{system.name}-{level:g}-{seed}"
    key = fingerprint(to_plain(system), level, seed, repr(method), preset, __version__)
    searches = None if folder.path is None else folder.path / "searches" / name
    arguments = (system, level, seed, method, preset, searches)
    title = f"{system.name} at noise {level:g}, seed {seed}"
    return Task(name, title, discover_again, arguments, NoiseRecord, key, _USUAL_SECONDS)


def discover_again(
    system: System,
    level: float,
    seed: int,
    method: Method = "auto",
    preset: str = DEFAULT_PRESET,
    searches: Path | None = None,
    report: Report = silent,
) -> NoiseRecord:
    """Discover a known system from data with one draw of noise.

    An error of the search is kept in the record, and every state then counts as not found.
    Finished searches are kept in the folder ``searches`` if one is given; their time counts, also
    where they were taken from there.
    """
    failure: list[str] = []
    clock = _Clock(report)

    def search(data: Trajectory, seed: int) -> Mapping[str, sympy.Expr]:
        try:
            found = discover(
                data,
                method=method,
                preset=preset,
                inputs=dict(system.inputs),
                seed=seed,
                jobs=1,
                out=searches,
                progress=clock,
            )
        except DynsrError as error:
            failure.append(str(error))
            return {}
        if not found.complete:
            # A draw that was stopped must not pass for finished.
            raise KeyboardInterrupt
        return found.equations

    found = measure_recovery([system], search, [level], [seed])
    timed = [replace(r, seconds=r.seconds + clock.saved) for r in found]
    rows = tuple(NoiseRow(r, _rmse(system, r)) for r in timed)
    return NoiseRecord(rows, timed[0].seconds, failure[0] if failure else "")


class _Clock:
    """Adds up the seconds that searches took which were now taken from their records."""

    def __init__(self, report: Report) -> None:
        self.report, self.saved, self.last = report, 0.0, time.monotonic()

    def __call__(self, step: Step) -> None:
        self.report(Progress(step.what or "searching", step.done, step.total, ParetoFront()))
        if not step.what:
            return
        now = time.monotonic()
        self.saved += max(0.0, step.record.seconds - (now - self.last))
        self.last = now


def _rmse(system: System, recovery: Recovery) -> float:
    if not recovery.found:
        return math.inf
    return equation_rmse(system, parse(recovery.found), recovery.state)


def noise_table(rows: Iterable[NoiseRow]) -> Table:
    """Make the table of systems and levels: what was recovered, how exactly, how fast.

    Constants and equation RMSE are medians over states and draws, the former of the states whose
    structure is right; seconds are the median of the cells.
    """
    lines = []
    for (system, level), group in _groups(rows):
        exact = [row for row in group if row.recovery.same_form]
        cells = {row.recovery.seed: row.recovery.seconds for row in group}
        lines.append(
            (
                system,
                100 * level,
                len(cells),
                f"{len(exact)} of {len(group)}",
                len(exact) / len(group),
                _share_of_cells(group),
                median(r.recovery.constants_off for r in exact) if exact else None,
                median(r.equation_rmse for r in group),
                median(cells.values()),
            )
        )
    columns = ("system", "noise (%)", "draws", "states exact", "share", "whole systems exact")
    return Table(
        "noise",
        "Recovery under noise",
        (*columns, "constants off (median)", "equation RMSE (median)", "seconds (median)"),
        tuple(lines),
    )


def _share_of_cells(group: Sequence[NoiseRow]) -> str:
    whole = {row.recovery.seed: True for row in group}
    for row in group:
        whole[row.recovery.seed] &= row.recovery.same_form
    return f"{sum(whole.values())} of {len(whole)}"


def formula_table(rows: Iterable[NoiseRow]) -> Table:
    """Make the table of every formula that was found."""
    lines = [
        (
            r.recovery.system,
            100 * r.recovery.noise,
            r.recovery.seed,
            r.recovery.state,
            Formula(r.recovery.found),
            "yes" if r.recovery.same_form else "no",
            r.recovery.constants_off if r.recovery.same_form else None,
            r.equation_rmse,
        )
        for r in rows
    ]
    columns = ("system", "noise (%)", "seed", "state", "found", "exact form", "constants off")
    return Table("noise-formulas", "What was found", (*columns, "equation RMSE"), tuple(lines))


def recovery_rates(rows: Iterable[NoiseRow]) -> tuple[list[float], dict[str, list[float]]]:
    """Give the levels, and for every system the share of states with exact structure at each."""
    shares = {
        key: sum(r.recovery.same_form for r in group) / len(group) for key, group in _groups(rows)
    }
    levels = sorted({level for _, level in shares})
    systems = dict.fromkeys(system for system, _ in shares)
    return levels, {s: [shares.get((s, v), math.nan) for v in levels] for s in systems}


def _groups(rows: Iterable[NoiseRow]) -> Iterator[tuple[tuple[str, float], list[NoiseRow]]]:
    groups: dict[tuple[str, float], list[NoiseRow]] = {}
    for row in rows:
        groups.setdefault((row.recovery.system, row.recovery.noise), []).append(row)
    yield from groups.items()
