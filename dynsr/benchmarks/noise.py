"""Noise: how often the true equations of known systems are found again, at levels of noise."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import sympy

from dynsr import __version__
from dynsr.data import System, Trajectory
from dynsr.discovery import discover, equation_rmse
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, add_noise, training_trajectory
from dynsr.errors import DynsrError, InputError
from dynsr.expression import parse, to_text
from dynsr.jobs import Part, Record, RunFolder, Step, fingerprint, run_parts
from dynsr.methods import DEFAULT_PRESET, AbstractMethod
from dynsr.report import Formula, Table

NOISE_LEVELS = (0.0, 0.001, 0.01, 0.05)
_EXACT_WITHIN = 0.02
# Two constants inside a function, such as the 1 in sin(1*x), are the same to this many digits.
_DIGITS_INSIDE = 2

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
        if not (np.isfinite(level) and level >= 0):
            raise InputError(f"noise {level} must be a number from 0 up, such as 0.01 for 1 %")
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
                    yield _judge(system.name, state, level, seed, found.get(state), true, seconds)


def _judge(
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
    """One state of one cell: what was found, and how far it is from the truth.

    ``equation_rmse`` is taken along the true states of the test span (units of the state a
    second); ``seconds`` is the time of the cell, which all its states share.
    """

    recovery: Recovery
    equation_rmse: float

    def as_dict(self) -> dict[str, Any]:
        """Give plain values; infinity is None."""
        values = {**asdict(self.recovery), "equation_rmse": self.equation_rmse}
        return {k: None if v == math.inf else v for k, v in values.items()}

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> NoiseRow:
        """Read back what :meth:`as_dict` gave."""
        values: dict[str, Any] = {k: math.inf if v is None else v for k, v in record.items()}
        rmse = values.pop("equation_rmse")
        return cls(Recovery(**values), rmse)


def run_noise(
    systems: Sequence[System],
    levels: Sequence[float] = NOISE_LEVELS,
    seeds: Sequence[int] = (0, 1, 2, 3, 4),
    *,
    method: Method = "auto",
    preset: str = DEFAULT_PRESET,
    out: str | Path | None = None,
    jobs: int = 1,
    finished: Callable[[Sequence[NoiseRow]], None] = lambda rows: None,
) -> list[NoiseRow]:
    """Discover every system at every level with every seed; gives one row a state.

    Data are the paper's training data of the system with Gaussian noise on its states; inputs are
    given and exact. Without noise one seed is enough, since the data are the same.

    Parameters
    ----------
    levels : standard deviation of the noise in units of each state's own.
    out : folder of the records; cells found there are not computed again.
    jobs : cells at a time; each is searched by one process.
    finished : called with the rows of each cell as it ends.
    """
    folder = RunFolder(None if out is None else Path(out).absolute())
    parts = [
        _make_part(Cell(system, level, seed, method, preset), folder)
        for system in systems
        for level in levels
        for seed in (seeds if level else seeds[:1])
    ]
    records = run_parts(parts, folder, jobs, lambda _, record: finished(_rows(record)))
    return [row for record in records for row in _rows(record)]


@dataclass(frozen=True)
class Cell:
    """One system at one level with one draw of the noise, and how it is searched."""

    system: System
    level: float
    seed: int
    method: Method = "auto"
    preset: str = DEFAULT_PRESET

    @property
    def name(self) -> str:
        """Name of the cell and of its record."""
        return f"{self.system.name}-{self.level:g}-{self.seed}"


def _make_part(cell: Cell, folder: RunFolder) -> Part:
    system = cell.system
    words = {s: str(e) for s, e in zip(system.states, system.rhs, strict=True)}
    key = fingerprint(
        *(words, system.train, system.step, list(system.x0)),
        *(repr(cell.method), cell.preset, __version__),
    )
    searches = None if folder.path is None else folder.path / "searches" / cell.name
    return Part(cell.name, key, run_cell, (cell, searches))


def run_cell(cell: Cell, searches: Path | None = None, tell: Any = None) -> Record:
    """Discover the system of a cell; gives the record of its states.

    An error of the search is kept in the record, and every state then counts as not found.
    Finished searches are kept in the folder ``searches`` if one is given; their time counts, also
    where they were taken from there. ``tell`` is not called: what ends is told cell by cell.
    """
    failure: list[str] = []
    clock = _Clock()

    def search(data: Trajectory, seed: int) -> Mapping[str, sympy.Expr]:
        try:
            found = discover(
                data,
                method=cell.method,
                preset=cell.preset,
                inputs=dict(cell.system.inputs),
                seed=seed,
                jobs=1,
                out=searches,
                progress=clock,
            )
        except DynsrError as error:
            failure.append(str(error))
            return {}
        if not found.complete:
            # A cell that was stopped must not pass for finished.
            raise KeyboardInterrupt
        return found.equations

    found = measure_recovery([cell.system], search, [cell.level], [cell.seed])
    timed = [replace(r, seconds=r.seconds + clock.saved) for r in found]
    rows = [NoiseRow(r, _rmse(cell.system, r)).as_dict() for r in timed]
    return {"rows": rows, "failure": failure[0] if failure else None}


class _Clock:
    """Adds up the seconds that searches took which were now taken from their records."""

    def __init__(self) -> None:
        self.saved, self.last = 0.0, time.monotonic()

    def __call__(self, step: Step) -> None:
        if not step.what:
            return
        now = time.monotonic()
        self.saved += max(0.0, step.record.get("seconds", 0.0) - (now - self.last))
        self.last = now


def _rmse(system: System, recovery: Recovery) -> float:
    if not recovery.found:
        return math.inf
    return equation_rmse(system, parse(recovery.found), recovery.state)


def _rows(record: Record) -> list[NoiseRow]:
    return [NoiseRow.from_dict(row) for row in record["rows"]]


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
