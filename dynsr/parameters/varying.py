"""Varying: one law for several runs, with constants that are shared or differ from run to run.

Each run alone gives its constants and how sure they are. Which of them are shared is decided by
description length: a constant for each run costs its digits as often as there are runs, and a
shared one costs what it misses. A constant that differs may follow a known number of the runs, or
another constant; the library's terms are tried for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count as counted

import numpy as np
import sympy
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from dynsr.data import FEWEST_SMOOTH, Trajectory
from dynsr.errors import InputError
from dynsr.expression import evaluate, free_constants, marks, shown, skeleton
from dynsr.fit import (
    Measurements,
    Mixed,
    MixedFit,
    MixedMesh,
    measure_runs,
    precision_bits,
    residual_bits,
    tidy,
)
from dynsr.library import Form, FormValues, Library, LibrarySettings
from dynsr.parameters.by_run import RunParameters
from dynsr.parameters.intervals import printed_order, take_apart
from dynsr.parameters.parameters import Parameter, name_constants, put_names
from dynsr.selection import ComparisonSettings, SystemComparison

Equations = Mapping[str, sympy.Expr]
Partition = tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class VarySettings:
    """The numbers that decide which constants differ; they are in a discovery's record.

    Parameters
    ----------
    searched : runs that are searched alone.
    joint : sets of shared constants, or functions of known numbers, that are fitted jointly.
    near : bits behind the best, by a quadratic approximation, up to which a set is fitted jointly.
    structures : structures that go so far, of those that fit each run.
    step : share of a number by which it is moved to see which constant it becomes.
    library : the functions of known numbers that a constant may be.
    """

    searched: int = 4
    joint: int = 3
    near: float = 12.0
    structures: int = 3
    step: float = 1e-3
    library: LibrarySettings = LibrarySettings(degree=2, alone=2)


@dataclass(frozen=True, eq=False)
class Structure:
    """Equations with named parameters, and each run's own fit of them.

    Parameters
    ----------
    equations : state -> right-hand side in columns and parameters.
    names : the parameters.
    each : the fit of every run alone.
    bits : of all of them together.
    """

    equations: dict[str, sympy.Expr]
    names: tuple[str, ...]
    each: tuple[MixedFit, ...]
    bits: float


@dataclass(frozen=True, eq=False)
class Law:
    """A law of all runs, and its bits.

    Parameters
    ----------
    fit : the joint fit.
    bits : of residuals, structure and constants.
    said : parameter that differs -> what it was found to be.
    """

    fit: MixedFit
    bits: float
    said: Mapping[str, sympy.Expr] = field(default_factory=dict)

    @property
    def mixed(self) -> Mixed:
        """The equations, and which parameters differ."""
        return self.fit.mixed


@dataclass(frozen=True, eq=False)
class Study:
    """Several runs, and what is asked of the constants of their law.

    Parameters
    ----------
    runs : the trajectories.
    data : their noise and smoothed curves.
    rows : their rows, ready for fits.
    comparison : what counts the bits of equations.
    states : states whose equations may have constants that differ.
    settings : the numbers that decide.
    """

    runs: Sequence[Trajectory]
    data: Measurements
    rows: MixedMesh
    comparison: SystemComparison
    states: tuple[str, ...]
    settings: VarySettings = VarySettings()

    @classmethod
    def of(
        cls,
        runs: Sequence[Trajectory],
        inputs: Mapping[str, sympy.Expr],
        derived: Mapping[str, sympy.Expr],
        order: Sequence[str],
        states: Sequence[str],
        comparison: ComparisonSettings,
        settings: VarySettings,
    ) -> Study:
        """Measure the runs.

        Parameters
        ----------
        runs, inputs : the data.
        derived : state -> its slope, a column that was made from it.
        order : states that have equations.
        states : those whose constants may differ.
        comparison, settings : the numbers that decide.

        Raises InputError when there is one run, or one is too short.
        """
        if len(runs) < 2:
            raise InputError(
                "one trajectory has one set of constants; give several, or say --trajectory"
            )
        shortest = min(map(len, runs))
        if shortest < FEWEST_SMOOTH:
            raise InputError(
                f"a trajectory of {shortest} rows determines no constants of its own; leave out "
                f"those of fewer than {FEWEST_SMOOTH} rows"
            )
        made = {s: slope for s, slope in derived.items() if slope.is_Symbol}
        data = measure_runs(runs, inputs, comparison.rows, made)
        rows = MixedMesh.of(data, order)
        counting = SystemComparison(rows.mesh, comparison)
        return cls(runs, data, rows, counting, tuple(states), settings)

    @property
    def noise(self) -> list[np.ndarray] | None:
        """(n, k) standard deviations of the noise of each run; None where rows were left out."""
        found = [smoothed.noise for smoothed in self.data.smoothed]
        return found if [*map(len, found)] == [*map(len, self.runs)] else None

    @cached_property
    def columns(self) -> list[str]:
        """Names that no parameter may have."""
        mesh = self.rows.mesh
        return [*mesh.states, *mesh.driven_names, *self.runs[0].names]

    @cached_property
    def known(self) -> dict[str, np.ndarray]:
        """Input that is constant along each run and differs between them -> (runs,) values."""
        found = {}
        for place, name in enumerate(self.runs[0].input_names):
            values = [run.inputs[:, place] for run in self.runs]
            first = np.array([own[0] for own in values])
            if all(np.ptp(own) == 0 for own in values) and len(set(first.tolist())) > 1:
                found[name] = first
        return found

    @cached_property
    def labels(self) -> dict[str, tuple[str, ...]]:
        """Column of labels -> what it says of each run."""
        found = [run.origin.get("labels") or {} for run in self.runs]
        names = [name for name in found[0] if all(name in own for own in found)]
        return {name: tuple(str(own[name]) for own in found) for name in names}

    @cached_property
    def partitions(self) -> list[tuple[int, ...]]:
        """Ways in which a constant may differ: not, by a label or known number, from run to run."""
        count = len(self.runs)
        return list(dict.fromkeys([(0,) * count, *self._ways.values(), tuple(range(count))]))

    @cached_property
    def _ways(self) -> dict[str, tuple[int, ...]]:
        """Column of labels, or known input -> the group of each run."""
        columns: dict[str, tuple[object, ...]] = {**self.labels}
        columns |= {name: tuple(own.tolist()) for name, own in self.known.items()}
        found = {}
        for name, own in columns.items():
            each = list(dict.fromkeys(own))
            found[name] = tuple(map(each.index, own))
        return found

    def called(self, groups: tuple[int, ...]) -> str:
        """Name the labels or the input that make some groups; "" where each run is one.

        Parameters
        ----------
        groups : the group of each run.
        """
        if len(set(groups)) == len(groups):
            return ""
        return next((name for name, own in self._ways.items() if own == groups), "")

    def fit_each(
        self, exprs: Equations, names: Mapping[str, Sequence[str]] | None = None
    ) -> Structure | None:
        """Fit equations to every run alone; None where one cannot be fitted.

        Parameters
        ----------
        exprs : state -> right-hand side with numbers, where the fits start.
        names : state -> the names of its constants; by default k1, k2, ...
        """
        equations, signed = put_names(exprs, names or name_constants(exprs, self.columns))
        start = np.array([values[0] for values in signed.values()])
        mixed = Mixed(equations, dict.fromkeys(signed, (0,)))
        found = [mixed.fit(own, start) for own in self.rows.runs]
        good = [fit.theta for fit in found if fit is not None]
        if not good:
            return None
        middle = np.median(good, axis=0)
        again = [fit or mixed.fit(o, middle) for fit, o in zip(found, self.rows.runs, strict=True)]
        each = tuple(fit for fit in again if fit is not None)
        if len(each) < len(again):
            return None
        # A fit from where the others ended may be the better one.
        each = tuple(
            self._better(mixed, f, middle, o) for f, o in zip(each, self.rows.runs, strict=True)
        )
        counts = np.array([fit.problem.mesh.rows for fit in each])
        squares = np.array([fit.mean_squares for fit in each])
        rows = counts.sum(axis=0)
        # A state that was made from another one has no rows, and costs nothing.
        missed = np.maximum((squares * counts).sum(axis=0) / np.maximum(rows, 1.0), 1e-300)
        bits = residual_bits(missed, rows, self.rows.mesh.known)
        bits += self._structure(equations, signed)
        bits += sum(precision_bits(f.information, f.scales, f.theta) for f in each)
        return Structure(equations, tuple(signed), each, bits) if math.isfinite(bits) else None

    @staticmethod
    def _better(mixed: Mixed, fit: MixedFit, start: np.ndarray, rows: MixedMesh) -> MixedFit:
        other = mixed.fit(rows, start)
        return fit if other is None or fit.cost <= other.cost else other

    def _structure(self, equations: Equations, names: Mapping[str, object]) -> float:
        """Bits of equations without their constants."""
        put = dict(zip(map(sympy.Symbol, names), marks(len(names)), strict=True))
        return self.comparison.structure({s: e.xreplace(put) for s, e in equations.items()})

    def law(self, mixed: Mixed, theta: np.ndarray, states: np.ndarray | None) -> Law | None:
        """Fit a mixed system jointly and count its bits; None where that cannot be done.

        Parameters
        ----------
        mixed : the system.
        theta : where its numbers start.
        states : (n, k) where the states start; by default where the smoothed data are.
        """
        fit = mixed.fit(self.rows, theta, states)
        if fit is None:
            return None
        mesh = self.rows.mesh
        bits = residual_bits(fit.mean_squares, mesh.rows, mesh.known)
        bits += self._structure(mixed.equations, mixed.groups)
        bits += precision_bits(fit.information, fit.scales, fit.theta)
        return Law(fit, bits) if math.isfinite(bits) else None

    def states_of(self, structure: Structure) -> np.ndarray:
        """(n, k) the trajectories of each run's own fit."""
        found = np.empty_like(self.rows.mesh.start)
        for number, fit in enumerate(structure.each):
            found[self.rows.run == number] = fit.found.states
        return found

    def choose(self, structure: Structure) -> Law | None:
        """Decide by the bits which constants of a structure are shared; None where no fit is found.

        Parameters
        ----------
        structure : the equations, fitted to each run.
        """
        rough = _Rough(self, structure)
        allowed = [self._allowed(structure, name) for name in structure.names]
        shared = tuple(own[0] for own in allowed)
        for start in (shared, tuple(own[-1] for own in allowed)):
            rough.descend(start, allowed)
        best: Law | None = None
        tried = set[Partition]()
        while True:
            near = [p for p in rough.near(self.settings.near) if p not in tried]
            if not near or len(tried) >= self.settings.joint:
                return best
            tried.add(near[0])
            law = self.fixed(structure, near[0])
            if law is not None and (best is None or law.bits < best.bits):
                best = law

    def _allowed(self, structure: Structure, name: str) -> list[tuple[int, ...]]:
        symbol = sympy.Symbol(name)
        own = [s for s, e in structure.equations.items() if symbol in e.free_symbols]
        return self.partitions if set(own) & set(self.states) else self.partitions[:1]

    def fixed(self, structure: Structure, partition: Partition) -> Law | None:
        """Fit a structure whose constants are shared as given.

        Parameters
        ----------
        structure : the equations, fitted to each run.
        partition : the group of each run, for each parameter.
        """
        mixed = Mixed(structure.equations, dict(zip(structure.names, partition, strict=True)))
        theta = _Rough(self, structure).theta(partition)
        laws = [self.law(mixed, theta, states) for states in (self.states_of(structure), None)]
        return min((law for law in laws if law is not None), key=lambda law: law.bits, default=None)

    def by_hand(
        self, exprs: Equations, names: Mapping[str, Sequence[str]], differing: Sequence[str]
    ) -> Law | None:
        """Fit equations in which some parameters differ from run to run, and all others are shared.

        Parameters
        ----------
        exprs : state -> right-hand side with numbers.
        names : state -> the names of its constants.
        differing : parameters that differ.
        """
        structure = self.fit_each(exprs, names)
        if structure is None:
            return None
        shared, own = self.partitions[0], self.partitions[-1]
        partition = tuple(own if name in differing else shared for name in structure.names)
        return self.fixed(structure, partition)

    def drop_terms(self, structure: Structure) -> Structure:
        """Leave out terms for as long as that takes fewer bits.

        Parameters
        ----------
        structure : the equations, fitted to each run.
        """
        while True:
            shorter = [self.fit_each(numbers) for numbers in _without_one(structure)]
            better = [s for s in shorter if s is not None and s.bits < structure.bits]
            if not better:
                return structure
            structure = min(better, key=lambda s: s.bits)

    def find(self, systems: Sequence[Equations]) -> Law | None:
        """Give the law of all runs, of structures that were found for some; None for none.

        Parameters
        ----------
        systems : state -> right-hand side with numbers, each.
        """
        fitted: dict[tuple[sympy.Expr, ...], Structure | None] = {}

        def fit(exprs: Equations) -> Structure | None:
            key = tuple(skeleton(exprs[s]) for s in self.rows.mesh.states)
            if key not in fitted:
                fitted[key] = self.fit_each(exprs)
            return fitted[key]

        found = [s for s in map(fit, systems) if s is not None]
        if not found:
            return None
        best = min(found, key=lambda s: s.bits)
        # The equation of one state may be better in another system.
        for state in self.rows.mesh.states:
            for other in systems:
                mixed = fit({**_numbers(best), state: other[state]})
                if mixed is not None and mixed.bits < best.bits:
                    best = mixed
        every = sorted((s for s in fitted.values() if s is not None), key=lambda s: s.bits)
        chosen = [self.drop_terms(s) for s in every[: self.settings.structures]]
        laws = [law for law in map(self.choose, chosen) if law is not None]
        return min(laws, key=lambda law: law.bits, default=None)

    def explain(self, law: Law) -> Law:
        """Say of constants that differ what known number, or other constant, they follow.

        Parameters
        ----------
        law : the law with its constants by run.
        """
        while True:
            better = [
                other
                for name in law.mixed.varied
                for other in self._explained(law, name)
                if other.bits < law.bits
            ]
            if not better:
                return law
            law = min(better, key=lambda one: one.bits)

    def _explained(self, law: Law, name: str) -> Iterator[Law]:
        """Fit laws in which a constant that differs is a function."""
        proposed = sorted(self._functions(law, name), key=lambda pair: pair[0])
        mixed = law.mixed
        for _, expr, numbers in proposed[: self.settings.joint]:
            fresh = _fresh([*mixed.groups, *law.said], self.columns)
            template, values = _with_names(expr, fresh)
            symbol = sympy.Symbol(name)
            equations = {s: e.xreplace({symbol: template}) for s, e in mixed.equations.items()}
            groups = {n: own for n, own in mixed.groups.items() if n != name}
            groups |= dict.fromkeys(values, (0,) * len(self.runs))
            other = Mixed(equations, groups)
            before = dict(zip(mixed.names(), law.fit.theta.tolist(), strict=True))
            before |= {(n, 0): v for n, v in zip(values, numbers, strict=True)}
            theta = np.array([before[key] for key in other.names()])
            found = self.law(other, theta, law.fit.found.states)
            if found is not None:
                earlier = {n: e.xreplace({symbol: template}) for n, e in law.said.items()}
                yield replace(found, said={**earlier, name: template})

    def _functions(
        self, law: Law, name: str
    ) -> Iterator[tuple[float, sympy.Expr, tuple[float, ...]]]:
        """Give functions that a constant may be, each with its bits by its values alone."""
        order = list(law.mixed.names())
        own = [i for i, (n, _) in enumerate(order) if n == name]
        values = law.fit.theta[own]
        spread = law.fit.covariance[np.ix_(own, own)]
        if not np.all(np.isfinite(spread)) or not np.all(np.diag(spread) > 0):
            return
        white = np.linalg.inv(np.linalg.cholesky(spread))
        groups = np.array(law.mixed.groups[name])
        first = [int(np.flatnonzero(groups == g)[0]) for g in range(len(own))]
        digits = float(np.mean(np.log2(1 + np.abs(values) / np.sqrt(np.diag(spread)))))
        for expr, numbers in self._proposals(law, name, values, white):
            put = {sympy.Symbol(name): expr}
            equations = {s: e.xreplace(put) for s, e in law.mixed.equations.items()}
            columns = {n: v[first] for n, v in self.known.items()} | self._others(law, name)
            miss = white @ (values - evaluate(expr, columns))
            bits = float(miss @ miss) / 2 / math.log(2) + digits * len(numbers)
            bits += self._structure(equations, law.mixed.groups)
            if math.isfinite(bits):
                yield bits, expr, numbers

    def _proposals(
        self, law: Law, name: str, values: np.ndarray, white: np.ndarray
    ) -> Iterator[tuple[sympy.Expr, tuple[float, ...]]]:
        """Give functions of known numbers, and multiples of other constants that differ alike."""
        groups = np.array(law.mixed.groups[name])
        first = [int(np.flatnonzero(groups == g)[0]) for g in range(len(values))]
        known = {n: v[first] for n, v in self.known.items() if np.array_equal(v, v[first][groups])}
        if known:
            points = np.array(list(known.values()))
            library = Library.of(list(known), points, settings=self.settings.library)
            for form, starts in zip(library.forms, library.starts, strict=True):
                for offset in (0, 1) if form.powers or form.factors else ():
                    if 1 + offset + form.constants < len(np.unique(points, axis=1).T):
                        yield from _fit_form(form, known, points, values, white, starts, offset)
        for other, own in self._others(law, name).items():
            form = Form(((0, 1),))
            yield from _fit_form(form, [other], own[None], values, white, np.zeros((1, 0)), 0)

    def _others(self, law: Law, name: str) -> dict[str, np.ndarray]:
        """Give constants that differ between the same groups as one, with their values."""
        groups = law.mixed.groups
        numbers = list(zip(law.mixed.names(), law.fit.theta.tolist(), strict=True))
        return {
            other: np.array([v for (n, _), v in numbers if n == other])
            for other in law.mixed.varied
            if other != name and groups[other] == groups[name]
        }


class _Rough:
    """The quadratic approximation of joint fits by each run's own."""

    def __init__(self, study: Study, structure: Structure) -> None:
        self._each = structure.each
        self._names = structure.names
        self._rows = float(study.rows.mesh.rows.sum())
        self._known = bool(np.all(study.rows.mesh.known))
        self._squares = sum(
            float(fit.mean_squares @ fit.problem.mesh.rows) for fit in structure.each
        )
        self._scales = np.median([fit.scales for fit in structure.each], axis=0)
        self._found: dict[Partition, float] = {}

    def _ways(self, partition: Partition) -> np.ndarray:
        """(runs Q, numbers) which number each constant of each run is."""
        sizes = [max(own) + 1 for own in partition]
        first = np.cumsum([0, *sizes])
        ways = np.zeros((len(self._each) * len(partition), int(first[-1])))
        for run in range(len(self._each)):
            for place, own in enumerate(partition):
                ways[run * len(partition) + place, first[place] + own[run]] = 1.0
        return ways

    def _solve(self, partition: Partition) -> tuple[np.ndarray, np.ndarray, float]:
        ways = self._ways(partition)
        told = block_diag(*[fit.information for fit in self._each])
        own = np.concatenate([fit.theta for fit in self._each])
        information = ways.T @ told @ ways
        units = np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information / np.outer(units, units)
        theta = np.linalg.pinv(scaled, hermitian=True) @ (ways.T @ told @ own / units) / units
        apart = ways @ theta - own
        return theta, information, max(float(apart @ told @ apart), 0.0)

    def theta(self, partition: Partition) -> np.ndarray:
        """Give the numbers that a joint fit would have."""
        return self._solve(partition)[0]

    def bits(self, partition: Partition) -> float:
        """Give the bits of the joint fit, less what all have."""
        if partition not in self._found:
            theta, information, more = self._solve(partition)
            scales = np.repeat(self._scales, [max(own) + 1 for own in partition])
            missed = (
                more / 2 / math.log(2)
                if self._known
                else self._rows / 2 * math.log2(1 + more / self._squares)
            )
            self._found[partition] = missed + precision_bits(information, scales, theta)
        return self._found[partition]

    def descend(self, start: Partition, allowed: Sequence[Sequence[tuple[int, ...]]]) -> Partition:
        """Change how one constant differs for as long as that takes fewer bits."""
        best = start
        while True:
            others = [
                (*best[:place], way, *best[place + 1 :])
                for place, ways in enumerate(allowed)
                for way in ways
            ]
            lowest = min([best, *others], key=self.bits)
            if self.bits(lowest) >= self.bits(best):
                return best
            best = lowest

    def near(self, bits: float) -> list[Partition]:
        """Give what was looked at and takes at most so many bits more than the best of it."""
        least = min(self._found.values())
        order = sorted(self._found, key=self._found.__getitem__)
        return [p for p in order if self._found[p] <= least + bits]


def _numbers(structure: Structure) -> dict[str, sympy.Expr]:
    """Give equations with the median over the runs as each constant."""
    middle = np.median([fit.theta for fit in structure.each], axis=0)
    pairs = zip(structure.names, middle.tolist(), strict=True)
    put = _as_symbols({name: value or 1.0 for name, value in pairs})
    return {s: e.xreplace(put) for s, e in structure.equations.items()}


def _without_one(structure: Structure) -> Iterator[dict[str, sympy.Expr]]:
    """Give the equations with one term left out, where another is left."""
    numbers = _numbers(structure)
    for state, expr in numbers.items():
        terms = sympy.Add.make_args(expr)
        if len(terms) > 1:
            for term in terms:
                yield {**numbers, state: expr - term}


def _fresh(taken: Sequence[str], columns: Sequence[str]) -> Iterator[str]:
    """Give names that no parameter has: those of the others, counted on."""
    letters = next((name.rstrip("0123456789") for name in taken), "k")
    return (n for n in (f"{letters}{i}" for i in counted(1)) if n not in {*taken, *columns})


def _with_names(expr: sympy.Expr, fresh: Iterator[str]) -> tuple[sympy.Expr, list[str]]:
    """Put names in the place of numbers."""
    template, values = free_constants(expr, "constant ")
    names = {symbol: next(fresh) for symbol in values}
    return template.xreplace({s: sympy.Symbol(n) for s, n in names.items()}), list(names.values())


def _fit_form(
    form: Form,
    names: Iterable[str],
    points: np.ndarray,
    values: np.ndarray,
    white: np.ndarray,
    starts: np.ndarray,
    offset: int,
) -> Iterator[tuple[sympy.Expr, tuple[float, ...]]]:
    """Fit a factor, a constant added to it and what is inside; nothing where that is not finite."""
    target, columns = white @ values, tuple(names)
    own = FormValues(Library(columns, (form,), (starts,)), points)

    def solve(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        term = own.of(np.zeros(1, dtype=int), inside[None])[0][0]
        terms = white @ np.column_stack([term, *[np.ones_like(term)] * offset])
        if not np.all(np.isfinite(terms)):
            return np.zeros(1 + offset), target
        factors = np.linalg.lstsq(terms, target, rcond=None)[0]
        return factors, terms @ factors - target

    with np.errstate(all="ignore"):
        best = min(starts, key=lambda inside: float(np.sum(solve(inside)[1] ** 2)))
        if len(best):
            best = least_squares(lambda c: solve(c)[1], best, x_scale=np.abs(best)).x
        factors, _ = solve(best)
    if not np.all(np.isfinite(factors)) or not np.all(factors):
        return
    term = sympy.Float(factors[0]) * form.write(columns, best.tolist())
    expr = term + (sympy.Float(factors[1]) if offset else 0)
    yield expr, tuple(free_constants(expr, "constant ")[1].values())


@dataclass(frozen=True)
class Answer:
    """A law of several runs in the terms of a discovery.

    Parameters
    ----------
    equations : state -> right-hand side; parameters that differ are columns.
    errors : state -> (value, standard error) of its constants in order.
    names : state -> the names of its constants.
    reach : standard errors that a 95 % interval reaches to either side.
    by_run : the parameters that differ.
    """

    equations: dict[str, sympy.Expr]
    errors: dict[str, tuple[tuple[float, float], ...]]
    names: dict[str, tuple[str, ...]]
    reach: float
    by_run: RunParameters


def write_answer(study: Study, law: Law, names: Sequence[str]) -> Answer:
    """Give the equations of a law, their constants, and those that differ by run.

    Parameters
    ----------
    study : the runs.
    law : the law.
    names : of the runs.
    """
    fit, mixed = law.fit, law.mixed
    order, reach = list(mixed.names()), fit.reach
    varied = mixed.varied

    def shared(theta: np.ndarray) -> dict[str, float]:
        pairs = zip(order, theta.tolist(), strict=True)
        return {name: value for (name, _), value in pairs if name not in varied}

    def put(theta: np.ndarray) -> dict[str, sympy.Expr]:
        numbers = _as_symbols(shared(theta))
        return {s: tidy(e.xreplace(numbers)) for s, e in mixed.equations.items()}

    def constants(theta: np.ndarray) -> dict[str, np.ndarray]:
        return {s: np.array(list(take_apart(e)[1].values())) for s, e in put(theta).items()}

    own = constants(fit.theta)
    turned: dict[str, list[np.ndarray]] = {state: [] for state in own}
    # A product of two numbers is one constant: its error follows from theirs.
    for place in range(len(order)):
        moved = fit.theta.copy()
        moved[place] *= 1 + study.settings.step
        step = moved[place] - fit.theta[place]
        for state, values in constants(moved).items():
            turned[state].append((values - own[state]) / step)
    errors = {}
    for state, values in own.items():
        slopes = np.array(turned[state]).reshape(len(order), len(values))
        with np.errstate(all="ignore"):
            spread = np.einsum("pi,pq,qi->i", slopes, fit.covariance, slopes)
        sizes = [math.sqrt(v) if v >= 0 and math.isfinite(v) else math.inf for v in spread]
        errors[state] = tuple(zip(values.tolist(), sizes, strict=True))
    sure = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    found_at = {key: i for i, key in enumerate(order)}
    differing = {
        name: tuple(
            _as_parameter(mixed, name, fit.theta[i], sure[i], reach)
            for i in (found_at[name, group] for group in mixed.groups[name])
        )
        for name in varied
    }
    known = shared(fit.theta)
    numbers = _as_symbols(known)
    by_run = RunParameters(
        tuple(names),
        differing,
        {name: own for name, own in study.labels.items() if own != tuple(names)},
        {name: tuple(own.tolist()) for name, own in study.known.items()},
        {name: shown(tidy(expr.xreplace(numbers))) for name, expr in law.said.items()},
        {name: way for name in varied if (way := study.called(mixed.groups[name]))},
    )
    equations = put(fit.theta)
    fresh = _fresh([*mixed.groups, *law.said], study.columns)
    called = {state: _call(expr, known, fresh) for state, expr in equations.items()}
    return Answer(equations, errors, called, reach, by_run)


def _as_symbols(values: Mapping[str, float]) -> dict[sympy.Symbol, sympy.Expr]:
    return {sympy.Symbol(name): sympy.Float(value) for name, value in values.items()}


def _call(expr: sympy.Expr, known: Mapping[str, float], fresh: Iterator[str]) -> tuple[str, ...]:
    """Name the constants of an equation as the parameters that they are; others get a new name."""
    template, values = take_apart(expr)
    numbers = list(values.values())
    found = []
    for place in printed_order(template, values):
        own = (n for n, v in known.items() if math.isclose(abs(v), abs(numbers[place])))
        name = next(own, None) or next(fresh)
        sign = -math.copysign(1.0, known.get(name, 1.0)) * math.copysign(1.0, numbers[place])
        found.append(f"{'-' if sign > 0 else ''}{name}")
    return tuple(found)


def _as_parameter(mixed: Mixed, name: str, value: float, error: float, reach: float) -> Parameter:
    symbol = sympy.Symbol(name)
    states = tuple(s for s, e in mixed.equations.items() if symbol in e.free_symbols)
    terms = sympy.Add.make_args(mixed.equations[states[0]])
    term = next(term for term in terms if symbol in term.free_symbols)
    known = set(map(sympy.Symbol, mixed.groups))
    home = sympy.Mul(*(f for f in sympy.Mul.make_args(term) if f not in known and not f.is_Number))
    low, high = value - reach * error, value + reach * error
    return Parameter(name, float(value), float(error), low, high, "", shown(home), states)
