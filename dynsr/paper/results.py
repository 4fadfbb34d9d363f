"""Results of a replication: the paper's tables and figure, made from its records alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from dynsr.data import SYSTEMS, System, find_system
from dynsr.engines import InitialValueProblem, find_engine
from dynsr.expression import parse
from dynsr.paper.auditing import AuditRow, audit
from dynsr.paper.printed import TABLE_1
from dynsr.paper.protocol import paper_method
from dynsr.paper.provenance import LOSS_FIELDS, LOSS_TITLES, engines_table, made_by_table
from dynsr.paper.records import Record
from dynsr.paper.stages import is_deterministic, stage_of
from dynsr.report import Formula, Spread, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dynsr.report import Panel

T = TypeVar("T")

METHOD_TITLES = {"dynaifeynman": "DynAIFeynman", "ga": "GA-Baseline", "sindy": "SINDy"}
_PAPER_NAMES = {"dynaifeynman": "DynAIFeynman", "ga": "GA", "sindy": "SINDy"}
SYSTEM_TITLES = {
    "lotka-volterra": "Lotka-Volterra",
    "pendulum": "Simple pendulum",
    "cart-pole": "Cart-pole",
}
UNITS = {"theta1": "rad", "theta2": "rad/s", "w": "rad", "x": "m", "y": "rad/s", "z": "m/s"}
FIGURE_1 = ("lotka-volterra", "cart-pole")
_FIGURE_POINTS = 1001
# Names of tables, and beginnings of those of the appendix and of stages.
TABLE_2, LOSSES, APPENDIX, STAGES = "table2", "losses", "appendix_", "stages_"
# Numbers of the tables in the paper; Table 9 has the three systems of SINDy.
_APPENDIX = {
    ("ga", "pendulum"): 3,
    ("ga", "lotka-volterra"): 4,
    ("ga", "cart-pole"): 5,
    ("dynaifeynman", "pendulum"): 6,
    ("dynaifeynman", "lotka-volterra"): 7,
    ("dynaifeynman", "cart-pole"): 8,
    ("sindy", "pendulum"): 9,
    ("sindy", "lotka-volterra"): 9,
    ("sindy", "cart-pole"): 9,
}
_NOTE_1 = (
    "Mean ± standard deviation (n - 1) of the loss over the runs, computed as the paper's numbers "
    "were computed. Paper: as printed there. Deterministic: the stage that found the formula uses "
    "no random numbers, so that every seed gives the same formula."
)
_NOTE_LOSSES = (
    "Mean ± standard deviation (n - 1) over the runs. As printed: the loss as the paper's "
    "numbers were computed, with mixed states and a wrong start of the pendulum. Corrected: "
    "all states, right start; the paper's side is computed from the expressions that it prints, "
    "whose digits are cut. Equation RMSE: the formula of the paper's text. Deterministic: the "
    "stage that found the formula uses no random numbers, so that every seed gives the same one."
)
_NOTE_STAGES = (
    "Formulas on the front: how many members of each run's Pareto front the stage found. Best fit: "
    "RMSE on the training samples of the stage's best formula, also where others beat it. Won: "
    "runs whose reported formula is the stage's. The network gives no formula itself; the stages "
    "below it ask it, unless a short formula already fits better than the network does."
)


@dataclass(frozen=True)
class Group:
    """The records of all runs of one method on one system."""

    system: str
    method: str
    records: tuple[Record, ...]

    @property
    def titles(self) -> tuple[str, str]:
        """System and method as they are written for reading."""
        system, method = self.system, self.method
        return SYSTEM_TITLES.get(system, system), METHOD_TITLES.get(method, method)

    @property
    def deterministic(self) -> bool:
        """Whether every formula comes from a stage that no seed changes."""
        return is_deterministic(record.source for record in self.done)

    @property
    def done(self) -> list[Record]:
        """The records that have a formula, the best one first."""
        return sorted((r for r in self.records if r.done), key=lambda r: r.trajectory_loss)


def groups(records: Iterable[Record]) -> list[Group]:
    """Put the runs of one method on one system together, in the paper's order, others after it."""
    found: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        found.setdefault((record.system, record.method), []).append(record)
    systems, methods = ([*titles] for titles in (SYSTEM_TITLES, METHOD_TITLES))

    def order(key: tuple[str, str]) -> tuple[int, int]:
        return _place(key[0], systems), _place(key[1], methods)

    return [Group(*key, tuple(found[key])) for key in sorted(found, key=order)]


def _place(name: T, names: Sequence[T]) -> int:
    return names.index(name) if name in names else len(names)


@cache
def _paper_rows() -> Mapping[tuple[str, str], tuple[AuditRow, ...]]:
    """Score what the paper prints; (the paper's name of a method, system) -> a row per run."""
    found: dict[tuple[str, str], list[AuditRow]] = {}
    for row in audit(unrounded=lambda engine: {}):
        found.setdefault((row.method, row.system), []).append(row)
    return {key: tuple(rows) for key, rows in found.items()}


def prepare() -> None:
    """Score what the paper prints, and load what draws, before there are records.

    What fails here fails again where it is used, and is said there.
    """
    with suppress(Exception):
        from dynsr.report import draw_panels  # noqa: F401

        _paper_rows()


def table_1(records: Sequence[Record]) -> Table:
    """Give the paper's Table 1 as it is printed, three methods on three systems, with ours.

    Methods and systems that the paper does not have are not in it.
    """
    own = {(group.system, group.method): group for group in groups(records)}
    columns = (f"{title}, {who}" for title in SYSTEM_TITLES.values() for who in ("paper", "ours"))
    rows = tuple(
        (
            title,
            *(
                value
                for system in SYSTEM_TITLES
                for value in (
                    str(TABLE_1[_PAPER_NAMES[method], system]),
                    _printed(own[system, method]) if (system, method) in own else "",
                )
            ),
        )
        for method, title in METHOD_TITLES.items()
    )
    title = "Table 1: RMSE scores of the paper, and ours"
    return Table("table1", title, ("Method", *columns), rows, _NOTE_1)


def _printed(group: Group) -> Spread:
    losses = (r.printed_loss for r in group.done if r.printed_loss is not None)
    return Spread.of(losses, group.deterministic)


def loss_table(records: Sequence[Record]) -> Table:
    """Give our losses and the paper's: as printed, corrected, and equation RMSE."""
    columns = (
        "System",
        "Method",
        "Runs",
        "As printed: ours",
        "As printed: paper",
        "Corrected: ours",
        "Corrected: paper",
        "Equation RMSE: ours",
        "Equation RMSE: paper",
        "Seconds per run",
    )
    rows = tuple(_losses(group) for group in groups(records))
    return Table(LOSSES, "Three kinds of loss, ours and the paper's", columns, rows, _NOTE_LOSSES)


def _losses(group: Group) -> tuple[Any, ...]:
    paper = _printed_rows(group)
    printed = TABLE_1.get((_PAPER_NAMES.get(group.method, ""), group.system))
    done, all_ = len(group.done), len(group.records)

    def spread(values: Iterable[float | None]) -> Spread:
        return Spread.of((v for v in values if v is not None), group.deterministic)

    return (
        *group.titles,
        str(all_) if done == all_ else f"{done} of {all_}",
        _printed(group),
        "" if printed is None else str(printed),
        spread(r.trajectory_loss for r in group.done),
        Spread.of(row.corrected for row in paper),
        spread(r.equation_rmse for r in group.done),
        Spread.of(row.equation_rmse for row in paper),
        Spread.of(r.seconds for r in group.done),
    )


def appendix_table(group: Group) -> Table:
    """Give one table of the paper's appendix: our formulas and the printed ones, each once.

    Runs that gave the same formula are one row.
    """
    columns = ("By", "Runs", "Formula", "Stage", *LOSS_TITLES, "Seconds per run")
    ours = [
        (
            "ours",
            _name_runs([r.run for r in same]),
            Formula(first.expression) if first.done else f"failed: {first.error}",
            ", ".join(dict.fromkeys(r.source for r in same)),
            *(getattr(first, loss) if first.done else math.nan for loss in LOSS_FIELDS),
            Spread.of(r.seconds for r in same if r.done),
        )
        for same in _alike(group.records, lambda r: (r.expression, r.error))
        for first in same[:1]
    ]
    printed = [
        (
            "paper",
            _name_runs([row.run for row in same]),
            Formula(first.expression),
            "",
            *(float(first.printed_digits), first.corrected, first.equation_rmse),
            Spread.of([]),
        )
        for same in _alike(_printed_rows(group), lambda row: parse(row.expression))
        for first in same[:1]
    ]
    system, method = group.titles
    target = group.records[0].target
    number = _APPENDIX.get((group.method, group.system))
    return Table(
        f"{APPENDIX}{group.method}_{group.system}",
        f"{f'Table {number}: ' if number else ''}{method} on {system}, formulas of d{target}/dt",
        columns,
        (*ours, *printed),
    )


def _alike(items: Iterable[T], of: Callable[[T], Any]) -> list[list[T]]:
    """Put together what is equal, in the order of the first of each."""
    found: dict[Any, list[T]] = {}
    for item in items:
        found.setdefault(of(item), []).append(item)
    return list(found.values())


def _name_runs(numbers: Iterable[int]) -> str:
    """Write the numbers of runs.

    >>> _name_runs([1, 2, 3, 5]), _name_runs([4, 5])
    ('1 to 3, 5', '4, 5')
    """
    parts: list[list[int]] = []
    for number in sorted(numbers):
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    texts = (
        f"{part[0]} to {part[-1]}" if len(part) > 2 else ", ".join(map(str, part)) for part in parts
    )
    return ", ".join(texts)


def _printed_rows(group: Group) -> tuple[AuditRow, ...]:
    return _paper_rows().get((_PAPER_NAMES.get(group.method, ""), group.system), ())


def stage_table(group: Group) -> Table:
    """Give what each stage of a method's search came to on a system, over its runs."""
    columns = ("Stage", "Runs", "Formulas on the front", "Best fit", "Won")
    found: dict[str, list[tuple[Record, Mapping[str, Any]]]] = {}
    for record in group.records:
        for stage in record.stages:
            found.setdefault(stage["stage"], []).append((record, stage))
    rows = tuple(
        (
            name,
            len(runs),
            ", ".join(str(stage["formulas"]) for _, stage in runs),
            Spread.of(s["best_loss"] for _, s in runs if s["best_loss"] is not None),
            sum(stage_of(record.source) == name for record, _ in runs),
        )
        for name, runs in found.items()
    )
    system, method = group.titles
    name = f"{STAGES}{group.method}_{group.system}"
    return Table(
        name, f"{method} on {system}: where its formulas come from", columns, rows, _NOTE_STAGES
    )


def all_tables(records: Sequence[Record], recorded_steps: bool = False) -> list[Table]:
    """Give Tables 1 and 2, our losses, the appendix in its order, and the stages of searches.

    Last come what made each number and, where another engine than the embedded one did, the two
    next to each other.
    """
    found = groups(records)
    order = [*_APPENDIX]
    appendix = sorted(found, key=lambda group: _place((group.method, group.system), order))
    staged = [group for group in found if any(len(r.stages) > 1 for r in group.records)]
    compared = [engines_table(records)] if any(r.embedded for r in records) else []
    return [
        table_1(records),
        *([table_2()] if any(group.method == "ga" for group in found) else []),
        loss_table(records),
        *map(appendix_table, appendix),
        *map(stage_table, staged),
        *compared,
        made_by_table(records, recorded_steps),
    ]


def table_2() -> Table:
    """Give the paper's Table 2 from the genetic algorithm's own settings."""
    methods = [paper_method("ga", find_system(name)) for name in SYSTEM_TITLES]
    settings = {
        "bitstring length": "bits",
        "# of candidates": "population",
        "iterations": "iterations",
    }
    rows = tuple((label, *(getattr(m, s) for m in methods)) for label, s in settings.items())
    title = "Table 2: hyperparameter setting of the GA"
    return Table(TABLE_2, title, ("Setting", *SYSTEM_TITLES.values()), rows)


def panel(system: System, some: Sequence[Group], engine: str = "embedded") -> Panel:
    """Integrate what each method found on a system, for a picture of its target over the test span.

    Every run starts from the system's own start; the best run of each method comes first.
    """
    from dynsr.report import Panel

    start, end = system.test
    t = system.times(system.test, (end - start) / (_FIGURE_POINTS - 1))
    at = system.index(system.target)
    done = {group.titles[1]: group.done for group in some if group.done}
    right_sides = [system.rhs[at], *(r.expr for runs in done.values() for r in runs)]
    solved = find_engine(engine).integrate_all(
        [
            InitialValueProblem(one.closed_rhs(), one.states, np.array(one.x0), t)
            for one in (system.with_rhs(system.target, expr) for expr in right_sides)
        ]
    )
    curves = iter([solution.x[:, at] for solution in solved])
    truth = next(curves)
    found = {title: np.array([next(curves) for _ in runs]) for title, runs in done.items()}
    unit = UNITS.get(system.target, "") if system.name != "lotka-volterra" else ""
    title = SYSTEM_TITLES.get(system.name, system.name)
    return Panel(title, system.target, t, truth, found, unit)


def figure_1(
    records: Sequence[Record], systems: Sequence[str] = FIGURE_1, engine: str = "embedded"
) -> Figure:
    """Draw Figure 1: true and inferred trajectories of each method; the paper shows two systems."""
    from dynsr.report import draw_panels

    found = groups(records)
    panels = [panel(find_system(s), [g for g in found if g.system == s], engine) for s in systems]
    return draw_panels(panels, [group.titles[1] for group in found])


def drawable(records: Iterable[Record]) -> tuple[list[str], list[str]]:
    """Give the systems of Figure 1 that have records, and the other ones."""
    present = dict.fromkeys(r.system for r in records if r.system in SYSTEMS)
    return [s for s in FIGURE_1 if s in present], [s for s in present if s not in FIGURE_1]
