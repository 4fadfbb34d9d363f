"""Crosscheck: what independent programs say about the same problems, row by row."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from types import ModuleType
from typing import Any

import numpy as np

from dynsr.checks.implicit import implicit_rows
from dynsr.checks.trajectories import CrosscheckRow, absent, trajectory_rows
from dynsr.engines import ENGINES, AbstractEngine, DiffeqpyEngine, SparseProblem, find_engine
from dynsr.errors import EngineError, EngineUnavailable, InputError, MissingExtra, need
from dynsr.jobs import Step, report_each
from dynsr.paper import PAPER_NAMES, SparseRecord, sparse_records

COEFFICIENT_LIMIT = 1e-6
# Both take the same steps, so that a cap changes what is compared, not how well it agrees.
PYSINDY_STEPS = 500


Section = Callable[[str, AbstractEngine], Iterator[CrosscheckRow]]


def crosscheck(
    systems: Sequence[str] = PAPER_NAMES,
    engines: Sequence[str] = ENGINES,
    sections: Sequence[str] | None = None,
    extra: Sequence[str] = (),
    progress: Callable[[Step], None] | None = None,
) -> list[CrosscheckRow]:
    """Compare engines with recorded answers and other programs, on the paper's systems.

    Parameters
    ----------
    systems : names of the paper's systems.
    engines : names of the engines to check.
    sections : names of SECTIONS; all by default.
    extra : further programs whose trajectories are compared: "diffeqpy".
    progress : called with a :class:`dynsr.jobs.Step` as each section of a system is compared.

    Raises InputError on an unknown system, engine, section or program.

    >>> rows = crosscheck(["cart-pole"], ["embedded"], ["corrected", "trajectories"])
    >>> {row.verdict for row in rows}
    {'agrees'}
    """
    chosen = tuple(SECTIONS) if sections is None else tuple(sections)
    for kind, names, known in (
        ("system", systems, PAPER_NAMES),
        ("section", chosen, tuple(SECTIONS)),
        ("program", extra, tuple(PROGRAMS)),
    ):
        for name in names:
            if name not in known:
                raise InputError(
                    f"unknown {kind} {name!r} of crosscheck; there are: {', '.join(known)}"
                )
    asked = [(*each, find_engine) for each in product(engines, chosen, systems)]
    asked += [(*each, _start_program) for each in product(extra, ("trajectories",), systems)]
    told = report_each(asked, lambda each: f"{each[0]}: {each[1]} of {each[2]}", progress)
    return [
        row for name, section, system, find in told for row in _compare(section, system, name, find)
    ]


def _compare(
    section: str, system: str, name: str, find: Callable[[str], AbstractEngine]
) -> list[CrosscheckRow]:
    try:
        return list(SECTIONS[section](system, find(name)))
    except EngineUnavailable as error:
        return [absent(section, system, name, "everything", str(error))]
    except EngineError as error:
        # An engine that is there and fails is as far off as can be.
        return [CrosscheckRow(section, system, "", name, "", 0, math.inf, 0.0, str(error))]


@cache
def _start_program(name: str) -> AbstractEngine:
    return PROGRAMS[name]()


def coefficient_difference(found: np.ndarray, expected: np.ndarray, implicit: bool) -> float:
    """Largest difference relative to the largest coefficient.

    Parameters
    ----------
    found, expected : (m,) coefficients of the same library.
    implicit : an implicit relation holds up to a factor, so both are first brought to largest
        magnitude 1.

    >>> coefficient_difference(np.array([1.0, 2.0]), np.array([-0.5, -1.0]), True)
    0.0
    """
    if implicit:
        found, expected = _unit(found), _unit(expected)
    size = float(np.abs(expected).max()) or 1.0
    return float(np.abs(found - expected).max()) / size


def _unit(relation: np.ndarray) -> np.ndarray:
    lead = relation[np.argmax(np.abs(relation) > 0.999 * np.abs(relation).max())]
    return relation / lead if lead else relation


def _row(
    section: str,
    subject: str,
    ours: str,
    theirs: str,
    differences: list[tuple[float, SparseRecord]],
) -> CrosscheckRow:
    largest, record = max(differences, key=lambda pair: pair[0])
    return CrosscheckRow(
        section,
        record.system,
        subject,
        ours,
        theirs,
        len(differences),
        largest,
        COEFFICIENT_LIMIT,
        record.title,
    )


def record_rows(system: str, engine: AbstractEngine) -> Iterator[CrosscheckRow]:
    """Compare an engine's coefficients with all that Julia's packages answered in our records."""
    for release, theirs in (
        ("2021", "DataDrivenDiffEq 0.5.7 (recorded)"),
        ("current", "DataDrivenSparse 0.1.2 (recorded)"),
    ):
        records = [r for r in sparse_records(release) if r.system == system]
        for implicit in (False, True):
            differences = []
            for record in records:
                if record.problem.implicit is implicit:
                    found = engine.regress(record.problem).coefficients
                    gap = coefficient_difference(found, record.coefficients, implicit)
                    differences.append((gap, record))
            kind = "implicit" if implicit else "explicit"
            ours = f"{engine.name} {release}"
            yield _row("records", f"{kind} coefficients", ours, theirs, differences)


def corrected_rows(system: str, engine: AbstractEngine) -> Iterator[CrosscheckRow]:
    """Ask that the corrected search never chooses a relation of a worse score than 2021 did.

    The score is ``|(|q|_0, |D'q|_2)|_2`` at largest magnitude 1, the number that the search of
    2021 sets out to make small. The difference is how much worse, or 0.
    """
    differences = []
    for record in sparse_records("2021"):
        if record.system == system and record.problem.implicit and record.iterations is not None:
            problem = replace(record.problem, release="2021-corrected")
            gap = _score(problem, engine.regress(problem).coefficients)
            differences.append((max(0.0, gap - _score(problem, record.coefficients)), record))
    ours = f"{engine.name} 2021-corrected"
    yield _row(
        "corrected", "implicit score", ours, "DataDrivenDiffEq 0.5.7 (recorded)", differences
    )


def _score(problem: SparseProblem, relation: np.ndarray) -> float:
    relation = relation / np.abs(relation).max()
    rows = np.vstack([problem.dx * problem.theta, problem.theta])
    return float(np.hypot(np.count_nonzero(relation), np.linalg.norm(relation @ rows)))


def pysindy_rows(system: str, engine: AbstractEngine) -> Iterator[CrosscheckRow]:
    """Compare explicit SR3 and STLSQ with pysindy on the same library, step for step."""
    try:
        need("pysindy", "pysindy", "the comparison with pysindy")
    except MissingExtra as missing:
        yield absent("pysindy", system, engine.name, "pysindy", str(missing))
        return
    import pysindy

    theirs = f"pysindy {pysindy.__version__}"
    for release in ("2021", "current"):
        for optimizer in ("SR3", "STLSQ"):
            differences = []
            for record in sparse_records(release):
                problem = record.problem
                if (record.system, problem.optimizer, problem.implicit) == (
                    system,
                    optimizer,
                    False,
                ):
                    cap = min(problem.max_iterations, PYSINDY_STEPS)
                    problem = replace(problem, max_iterations=cap)
                    solution = engine.regress(problem)
                    peer = _solve_by_pysindy(pysindy, problem, solution.iterations or 1)
                    gap = coefficient_difference(solution.coefficients, peer, False)
                    differences.append((gap, record))
            if differences:
                subject = f"explicit {optimizer}"
                yield _row("pysindy", subject, f"{engine.name} {release}", theirs, differences)


def _solve_by_pysindy(pysindy: ModuleType, problem: SparseProblem, steps: int) -> np.ndarray:
    """Put the problem in pysindy's own terms and take as many steps as we took.

    pysindy's nu is a length where today's Julia has its inverse; a hard threshold t is its
    L0 weight t^2 / (2 nu), a soft one its L1 weight t / nu.
    """
    settings: Mapping[str, Any] = dict(problem.settings)
    scale = np.linalg.norm(problem.theta, axis=1) if problem.normalize else np.ones(1)
    a = (problem.theta / scale.reshape(-1, 1)).T
    cut = 0.0
    if problem.optimizer == "STLSQ":
        # Its default solver squares the condition number, 9e6 for the cart-pole's library, and its
        # final refit drops singular values below 1e-6; dependent functions need that refit.
        full = np.linalg.matrix_rank(a) == a.shape[1]
        peer = pysindy.STLSQ(
            settings["threshold"],
            alpha=settings["rho"],
            max_iter=100,
            unbias=not full,
            ridge_kw={"solver": "svd"} if full else None,
        )
    elif problem.release == "2021":
        cut = math.sqrt(2 * settings["lambda"] / settings["nu"])
        weight = cut * settings["lambda"]
        # pysindy divides by max_iter // 10.
        peer = pysindy.SR3(weight, "L1", settings["nu"], tol=1e-300, max_iter=max(steps, 10))
    else:
        peer = _peer_of_today(pysindy, settings, a, problem.dx, steps)
    with warnings.catch_warnings():
        # That the cap is reached is intended, and a zero answer is an answer.
        warnings.simplefilter("ignore")
        peer.fit(a, problem.dx)
    found = np.ravel(peer.coef_full_ if cut else peer.coef_)
    return np.where(np.abs(found) < cut, 0.0, found) / scale


def _peer_of_today(
    pysindy: ModuleType, settings: Mapping[str, Any], a: np.ndarray, dx: np.ndarray, steps: int
) -> Any:
    threshold, nu = settings["threshold"], 1 / settings["nu"]
    hard = settings["proximal"] == "hard"
    weight = (threshold**2 / 2 if hard else threshold) / nu
    start = np.linalg.solve(a.T @ a + np.eye(a.shape[1]) / nu, a.T @ dx)[None]
    regularizer = "L0" if hard else "L1"
    return pysindy.SR3(
        weight, regularizer, nu, tol=1e-300, max_iter=max(steps, 10), initial_guess=start
    )


SECTIONS: dict[str, Section] = {
    "trajectories": trajectory_rows,
    "records": record_rows,
    "corrected": corrected_rows,
    "pysindy": pysindy_rows,
    "implicit": implicit_rows,
}

PROGRAMS: dict[str, Callable[[], AbstractEngine]] = {"diffeqpy": DiffeqpyEngine}
