"""Delays: equations that contain a state or an input as it was some time before.

Which delay it is is seen by how well short sums of the library's terms explain the slopes, where
delayed states are read from smoothed curves. Then the delay is fitted together with the states and
all other constants, and delayed states are those of the fit (:mod:`dynsr.fit.delayed`). Along the
curves of a fit that follows the data, equations are searched as with any other input. An equation
with a delay is followed by the method of steps: over one delay after the other, the delayed state
is the solution before. A delayed input is a known function of the time, and is followed as such.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import sympy
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from dynsr.data import Hold, SmoothedTrajectory, Trajectory
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, Drive
from dynsr.errors import EngineError, InputError
from dynsr.expression import parse, skeleton
from dynsr.fit import (
    FIT,
    CollocationSettings,
    DelayedFit,
    DelayedMesh,
    DelayedSystem,
    Driven,
    Measurements,
    MixedMesh,
    drives_of,
    measure_runs,
    precision_bits,
)
from dynsr.library import Form, FormValues, Library, LibrarySettings, Written
from dynsr.parameters.intervals import leave_unknown, take_apart, write_interval
from dynsr.parameters.parameters import name_constants, put_names
from dynsr.selection import (
    ComparisonSettings,
    Evidence,
    Subset,
    SystemComparison,
    best_subsets,
    most_of_noise,
)
from dynsr.verdict import SLACK, Measured, predict

_ENDING = "_delayed"


@dataclass(frozen=True)
class DelaySettings:
    """The numbers that decide a delay; they are in a discovery's record.

    Parameters
    ----------
    grid : delays that are tried, evenly spaced.
    longest : the longest of them, as a share of the shortest run.
    rows : rows of a run at most.
    points : rows of all runs, evenly spaced, at which slopes are explained.
    terms : terms of the sums that explain slopes.
    sums : sums for each delay that are fitted.
    minima : delays, best first, that are fitted.
    constant_bits : bits of one of their constants.
    library : the terms.
    apart : a delay of states is not tried where the difference of a state and the delayed one
        explains the slope to within so many of its standard errors: every short one would do that.
    searched : delays with which equations are searched.
    fewest : rows of a run at least.
    margin : share by which a fit may make a delay longer than the history that was taken for it.
    hidden : share of an error that hides the error of the rule.
    finest : times as many rows between those of the data, at most, with which the rule is tested.
    far : share by which a fit may move the delay away from where it was searched.
    free : delays over which equations are integrated with their own delayed states, to test them.
    """

    grid: int = 40
    longest: float = 0.25
    rows: int = 500
    points: int = 120
    terms: int = 3
    sums: int = 5
    minima: int = 4
    constant_bits: float = 5.0
    library: LibrarySettings = LibrarySettings(degree=2, alone=3, apart=4.0, most=800)
    apart: float = 5.0
    searched: int = 2
    fewest: int = 5
    margin: float = 0.02
    hidden: float = 0.1
    finest: int = 8
    far: float = 0.3
    free: int = 4


@dataclass(frozen=True)
class Delay:
    """A state, or an input, as it was some time before.

    Parameters
    ----------
    state : the state or the input.
    value : how long before, in the unit of the times.
    error : its standard error; inf where the data do not determine it.
    low, high : the ends of its 95 % interval; None where the data do not determine it.

    >>> Delay("x", 1.6, 0.01, 1.58, 1.62).text
    'x(t - 1.6), the delay is 1.58 to 1.62'
    """

    state: str
    value: float
    error: float = math.inf
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        """Take ends that are not finite for unknown; raises InputError for no time."""
        leave_unknown(self)
        if not (math.isfinite(self.value) and self.value > 0):
            raise InputError(f"a delay of {self.value!r} is no time; give a number above 0")

    @property
    def text(self) -> str:
        """What it is, to be read."""
        interval = write_interval(self.low, self.high)
        return f"{self.state}(t - {self.value:.6g}), the delay is {interval}"


@dataclass(frozen=True, eq=False)
class Delayed:
    """Runs whose states are known before each of their rows, by curves, and whose inputs are too.

    Parameters
    ----------
    runs : the trajectories.
    data : the same with their noise, to which systems are fitted.
    curves : the curve of each of them: smoothed, or that of a system that follows it.
    inputs : the inputs of each of them as functions of the time.
    names : state or input -> the column of the delayed one; inputs are the last.
    settings : the numbers that decide.
    """

    runs: Sequence[Trajectory]
    data: Measurements
    curves: Sequence[SmoothedTrajectory]
    inputs: Sequence[Driven]
    names: Mapping[str, str]
    settings: DelaySettings

    @classmethod
    def of(cls, runs: Sequence[Trajectory], settings: DelaySettings) -> Delayed:
        """Smooth runs.

        Parameters
        ----------
        runs, settings : the data, and the numbers that decide.

        Raises InputError when a delayed column would have the name of another one, or a run has too
        few rows.
        """
        if (least := min(map(len, runs))) < settings.fewest:
            raise InputError(f"a trajectory of {least} rows shows no delay; leave it out")
        stride = max(1, -(-max(map(len, runs)) // settings.rows))
        some = [run.select(run.every(stride)) for run in runs]
        names = {name: f"{name}{_ENDING}" for name in runs[0].names}
        if taken := [name for name in names.values() if name in runs[0].names]:
            raise InputError(f"{taken[0]!r} is a column already; rename it, or leave delays out")
        data = measure_runs(some, {}, sum(map(len, some)), {})
        inputs = drives_of(runs[0].input_names, runs, {})
        return cls(some, data, data.smoothed, inputs, names, settings)

    @property
    def states(self) -> tuple[str, ...]:
        """The states, which are the first of the names."""
        return self.runs[0].states

    @property
    def longest(self) -> float:
        """The longest delay that is tried."""
        return self.settings.longest * min(float(np.ptp(run.t)) for run in self.runs)

    def columns(self, delay: float, begin: float) -> list[Trajectory]:
        """Give the runs from some time on, with the delayed states and inputs as inputs.

        Where a delayed input jumps or has a kink between rows, there is one more row, at which no
        state was measured.

        Parameters
        ----------
        delay : how long before.
        begin : time after the first row from which on rows are kept; the delay at least.
        """
        found = []
        for run, curve, inputs in zip(self.runs, self.curves, self.inputs, strict=True):
            kept = run.select(np.flatnonzero(run.t >= run.t[0] + begin))
            later = [drive.later(self.names[drive.name], delay) for drive in inputs.drives]
            rounding = SLACK * float(np.ptp(run.t))
            kept = _with_rows(kept, curve, inputs, later, rounding)
            known = {
                drive.name: drive.at(kept.t + (rounding if len(drive.kinks) else 0.0))
                for drive in later
            }
            before = curve.curve(kept.t - delay)
            columns = {self.names[s]: x for s, x in zip(self.states, before, strict=True)} | known
            ways: dict[str, Hold] = {self.names[state]: "smooth" for state in self.states}
            ways |= {self.names[name]: run.held(name) for name in run.input_names}
            found.append(
                replace(
                    kept,
                    inputs=np.column_stack([kept.inputs, *columns.values()]),
                    input_names=(*kept.input_names, *columns),
                    hold={**kept.hold, **ways},
                )
            )
        return found

    def candidates(
        self, comparison: ComparisonSettings, asked: Sequence[float] = ()
    ) -> Iterator[DelayFit]:
        """Give delays with the sums that they were fitted with, as they are found.

        Some have sums without a delay: what needs none competes with the others.

        Parameters
        ----------
        comparison : how bits are counted.
        asked : delays near which they are; by default anywhere up to the longest.
        """
        settings, scan = self.settings, _Scan.of(self, comparison)
        shortest = max(float(np.median(np.diff(run.t))) for run in self.runs)
        if asked:
            bounds = [(own * (1 - settings.far), own * (1 + settings.far)) for own in asked]
        else:
            bounds = self._minima(scan, shortest)
        begun: list[DelayFit] = []
        plain: dict[tuple[sympy.Expr, ...], DelayFit] = {}
        for pair in bounds:
            with np.errstate(invalid="ignore"):
                near = float(minimize_scalar(scan.bits, bounds=pair, method="bounded").x)
            fitted = []
            for _, exprs in scan.sums(near):
                shape = tuple(map(skeleton, exprs.values()))
                if shape not in plain and (fit := self.fit(exprs, near, comparison)) is not None:
                    yield fit
                    if fit.has_delay:
                        fitted.append(fit)
                    else:
                        plain[shape] = fit
            begun += sorted(fitted, key=lambda fit: fit.bits)[:1]
        begun += sorted(plain.values(), key=lambda fit: fit.bits)[:1]
        while begun:
            better = []
            for fit in begun:
                some = self._renewed(fit, comparison)
                yield from some
                best = min(some, key=lambda own: own.bits, default=fit)
                if best.bits < fit.bits - comparison.gain:
                    better.append(best)
            least = min((fit.bits for fit in better), default=math.inf)
            begun = [fit for fit in better if fit.bits <= least + comparison.behind]

    def _renewed(self, fit: DelayFit, comparison: ComparisonSettings) -> list[DelayFit]:
        """Give fits with other equations.

        Slopes at one delay are explained best with terms that replace its error. Along the states
        of a fit, with its delay free, terms are seen for what they are.
        """
        fits = (
            self.fit({**fit.equations, state: expr}, fit.delay, comparison)
            for state in fit.equations
            for expr in self._propose(fit, state, comparison)
        )
        return [f for f in fits if f is not None]

    def _propose(
        self, fit: DelayFit, state: str, comparison: ComparisonSettings
    ) -> list[sympy.Expr]:
        """Give sums that are expected to do best in the place of an equation, its delay free."""
        found, problem = fit.fit.found, fit.fit.problem
        systems = SystemComparison(problem.mesh, comparison)
        evidence = Evidence.in_place(
            found,
            problem,
            {state: (1.0, found.exprs[state])},
            systems.columns,
            comparison.proposals.nodes,
            # The states of a system that misses them are not quite those of another.
            None if leaves_only_noise(fit.fit, comparison) else comparison.softness,
        )
        return [] if evidence is None else systems.propose(state, evidence)[: comparison.tried]

    def _minima(self, scan: _Scan, shortest: float) -> list[tuple[float, float]]:
        """Give (low, high) around each of the delays with which short sums explain slopes best."""
        grid = np.linspace(shortest, self.longest, self.settings.grid)
        bits = np.array([scan.bits(delay) for delay in grid])
        # scipy.signal loads scipy.stats, which no other discovery needs.
        from scipy.signal import argrelmin

        inner = argrelmin(bits)[0]
        places = inner[np.isfinite(bits[inner])]
        if not len(places):
            places = np.flatnonzero(np.isfinite(bits) & (bits == bits.min()))[:1]
        best = sorted(places.tolist(), key=lambda place: bits[place])[: self.settings.minima]
        width = grid[1] - grid[0]
        return [(max(grid[i] - width, shortest), min(grid[i] + width, self.longest)) for i in best]

    def points(self, delay: float) -> tuple[np.ndarray, ...]:
        """Give states, delayed states, slopes and their errors (k, n), for all delays alike.

        Inputs and delayed inputs (m, n) are the last two.
        """
        parts = []
        each = -(-self.settings.points // len(self.runs))
        for run, curve, inputs in zip(self.runs, self.curves, self.inputs, strict=True):
            rows = np.flatnonzero(run.t >= run.t[0] + self.longest)
            rows = rows[np.unique(np.linspace(0, len(rows) - 1, each).astype(int))]
            times = run.t[rows]
            # The time is the last of what drives.
            driven = inputs(times)[:-1], inputs(times - delay)[:-1]
            states = curve.x[rows].T, curve.curve(times - delay)
            parts.append((*states, curve.slope[rows].T, curve.slope_sd[rows].T, *driven))
        return tuple(np.concatenate(own, axis=1) for own in zip(*parts, strict=True))

    def delays_in(
        self, equations: Mapping[str, sympy.Expr], delay: float, fit: DelayFit | None = None
    ) -> dict[str, Delay]:
        """Give column -> delay of the delayed states and inputs that equations contain.

        Parameters
        ----------
        equations : state -> right-hand side.
        delay, fit : the delay, and what gave its interval.
        """
        used = {str(s) for e in equations.values() for s in e.free_symbols}
        return {
            column: Delay(name, delay) if fit is None else fit.as_delay(name)
            for name, column in self.names.items()
            if column in used
        }

    def explained(
        self,
        equations: Mapping[str, sympy.Expr],
        delays: Mapping[str, Delay],
        inputs: Mapping[str, sympy.Expr],
    ) -> float:
        """Give the least R2 of the states by the method of steps, from many times on.

        Parameters
        ----------
        equations : state -> right-hand side in which delayed states are columns.
        delays : column -> the delay that it is.
        inputs : input name -> expression in ``t`` where it is known.

        It is -inf where a solution diverges.
        """
        delay = max((own.value for own in delays.values()), default=self.longest)
        missed, spread = np.zeros((2, len(equations)))
        for run, curve in zip(self.runs, self.curves, strict=True):
            places = [run.index(state) for state in equations]
            given: dict[str, object] = {
                name: inputs[name] if name in inputs else _measured(run, name)
                for name in run.input_names
            }
            given |= {
                column: put_off(given[own.state], own.value, column)
                for column, own in delays.items()
                if own.state in run.input_names
            }
            begin = run.t[0] + delay
            while begin < run.t[-1]:
                rows = np.flatnonzero(
                    (run.t > begin) & (run.t <= begin + self.settings.free * delay)
                )
                if len(rows):
                    times = np.append(begin, run.t[rows])
                    try:
                        x = follow(
                            equations,
                            delays,
                            _part_of(curve, places),
                            times,
                            given,
                        ).x[1:]
                    except EngineError:
                        return -math.inf
                    seen = run.observed[rows][:, places]
                    missed += np.nansum((x - seen) ** 2, axis=0)
                    spread += np.nansum(
                        (seen - np.nanmean(run.observed[:, places], axis=0)) ** 2, axis=0
                    )
                begin += self.settings.free * delay
        return float(np.min(1 - missed / np.maximum(spread, 1e-300)))

    def fit(
        self,
        equations: Mapping[str, sympy.Expr],
        delay: float,
        comparison: ComparisonSettings,
        begin: float | None = None,
        settings: CollocationSettings | None = None,
    ) -> DelayFit | None:
        """Fit a delay, all constants and the states; None where that cannot be done.

        Equations without a delayed column have the least history, of three rows.

        Parameters
        ----------
        equations : state -> right-hand side in which delayed states are columns.
        delay : where the fit starts.
        comparison : how bits are counted.
        begin : time after the first row from which on the states follow the equations; by default
            the longest delay that the fit may come to.
        settings : how it is fitted; by default as other systems that are compared.
        """
        named, signed, system = self._open(equations)
        theta = np.array([*(values[0] for values in signed.values()), delay])
        far = self.settings.far
        if not system.names:
            begin = max(float(run.t[3] - run.t[0]) for run in self.runs)
        begin = delay * (1 + far) if begin is None else begin
        rows = MixedMesh.of(self.data, tuple(equations))
        how = settings or comparison.fit
        found = system.fit(rows, theta, begin, how)
        if found is None:
            return None
        moved = abs(found.delay - delay)
        if system.names and (
            not moved < far * delay or found.delay > begin * (1 + self.settings.margin)
        ):
            return None
        numbers = dict(zip(map(sympy.Symbol, signed), map(sympy.Float, found.theta), strict=False))
        exprs = {s: e.xreplace(numbers) for s, e in named.items()}
        bits = found.bits + SystemComparison(found.problem.mesh, comparison).structure(exprs)
        own_numbers = slice(None if system.names else -1)
        bits += precision_bits(
            found.information[own_numbers, own_numbers],
            found.scales[own_numbers],
            found.theta[own_numbers],
        )
        # What follows noisy data is smoother than their smoothed curve.
        own = self
        if leaves_only_noise(found, comparison) and not np.any(rows.least):
            along = self.data.along(found.found.states, tuple(equations))
            own = replace(self, curves=along.smoothed)
        return DelayFit(found, found.delay, exprs, bits, own) if math.isfinite(bits) else None

    def _open(
        self, equations: Mapping[str, sympy.Expr]
    ) -> tuple[dict[str, sympy.Expr], dict[str, Any], DelayedSystem]:
        """Give equations with names for constants, their values, and the system of both."""
        named, signed = put_names(equations, name_constants(equations, self.runs[0].names))
        used = {str(symbol) for expr in named.values() for symbol in expr.free_symbols}
        names = {name: column for name, column in self.names.items() if column in used}
        inputs = self.inputs if names.keys() - {*self.states} else ()
        return named, signed, DelayedSystem(named, names, tuple(signed), inputs)

    def measured(self, fit: DelayFit, comparison: ComparisonSettings) -> DelayFit:
        """Give a fit whose errors count those of the rule, with the least history.

        Rows are put between those of the data until the delay and the constants move by a small
        share of their errors at most. The bits stay those of the fit.

        Parameters
        ----------
        fit : of these runs.
        comparison : how bits are counted.
        """
        last = self.fit(fit.equations, fit.delay, comparison, fit.delay, FIT.along)
        if last is None:
            return fit
        fineness = 1
        while fineness < self.settings.finest:
            fineness *= 2
            fine = replace(self, data=replace(self.data, fineness=fineness))
            again = fine.fit(last.equations, last.delay, comparison, last.delay, FIT.along)
            if again is None:
                break
            if len(again.fit.theta) < len(last.fit.theta):
                # Constants that came to one value are one: the next step says how far they move.
                last = again
                continue
            moved = again.fit.theta - last.fit.theta
            errors = np.sqrt(np.diag(again.fit.covariance))
            last = replace(again, fit=replace(again.fit, rule=moved))
            if np.all(np.abs(moved) <= self.settings.hidden * errors):
                break
        return replace(last, bits=fit.bits)


def leaves_only_noise(fit: DelayedFit, comparison: ComparisonSettings) -> bool:
    """Whether the residuals of every state, history apart, are its noise.

    Parameters
    ----------
    fit, comparison : the system, and how much counts as noise.
    """
    return bool(np.all(fit.mean_squares <= most_of_noise(fit.rows, comparison)))


@dataclass(frozen=True, eq=False)
class _Scan:
    """The short sums that explain slopes best, one delay after the other."""

    delayed: Delayed
    comparison: SystemComparison
    _costs: dict[tuple[Form, str], float] = field(default_factory=dict)

    @classmethod
    def of(cls, delayed: Delayed, settings: ComparisonSettings) -> _Scan:
        """Prepare the scan; its columns are those of any delay."""
        rows = delayed.data.mesh(delayed.states)
        mesh = DelayedMesh.of(rows, delayed.names, 0.0, delayed.inputs)
        return cls(delayed, SystemComparison(mesh.at(delayed.longest), settings))

    def bits(self, delay: float) -> float:
        """Bits of the slopes by the best short sums; inf for a delay of a slope."""
        found = self.sums(delay)
        return found[0][0] if found else math.inf

    def sums(self, delay: float) -> list[tuple[float, dict[str, sympy.Expr]]]:
        """Give the best short sums with their bits, best first; none for a delay of a slope.

        Inputs have such a delay too: their differences are no slopes of states.
        """
        settings, own = self.delayed.settings, self.delayed.states
        states, delayed, slopes, errors, inputs, late = self.delayed.points(delay)
        others = self.delayed.runs[0].input_names
        before = [self.delayed.names[name] for name in (*own, *others)]
        # How far differences over the delay are off the slopes, in standard errors of these.
        apart = np.sqrt(np.mean((slopes - (states - delayed) / delay) ** 2, axis=1))
        sizes = np.sqrt(np.mean(errors**2, axis=1))
        if np.any(apart / np.maximum(sizes, 1e-300) < settings.apart):
            if not others:
                return []
            delayed, before = delayed[:0], before[len(own) :]
        points = np.concatenate([states, inputs, delayed, late])
        names = [*own, *others, *before]
        library = Library.of(names, points, settings=settings.library)
        with np.errstate(all="ignore"):
            values, _ = FormValues(library, points).begun
            sizes = np.linalg.norm(values, axis=1)
        fine = np.flatnonzero(np.isfinite(sizes) & (sizes > 0))
        terms = values[fine] / sizes[fine, None]
        forms = [library.forms[owner] for owner in library.owners[fine]]
        inside = [library.constants[row].tolist() for row in fine]
        gram = terms @ terms.T

        def write(subset: Subset) -> sympy.Expr:
            parts = zip(subset.coefficients, subset.places, strict=True)
            return sympy.Add(
                *(
                    sympy.Float(factor / sizes[fine[i]]) * forms[i].write(names, inside[i])
                    for factor, i in parts
                )
            )

        each = []
        for state, slope in zip(own, slopes, strict=True):
            costs = [self._cost(f, c, names, state) for f, c in zip(forms, inside, strict=True)]
            each.append(
                best_subsets(
                    gram,
                    terms @ slope,
                    float(slope @ slope),
                    np.array(costs),
                    len(slope),
                    most=settings.terms,
                    keep=settings.sums,
                )
            )
        # The best sums of all states together, then the second best, ...
        return [
            (
                sum(one.bits for one in some),
                dict(zip(own, map(write, some), strict=True)),
            )
            for some in zip(*each, strict=False)
        ]

    def _cost(self, form: Form, inside: Sequence[float], names: Sequence[str], state: str) -> float:
        """Bits of a term, as textbooks have it, and of its constants."""
        key = form, state
        if key not in self._costs:
            body = form.write(names, inside)
            constants = self.delayed.settings.constant_bits * (1 + form.constants)
            self._costs[key] = constants + self.comparison.term_bits(body, state, Written())
        return self._costs[key]


def _part_of(
    curve: SmoothedTrajectory, places: Sequence[int]
) -> Callable[[np.ndarray], np.ndarray]:
    """Give some states (k, n) of a curve at n times."""

    def part(times: np.ndarray) -> np.ndarray:
        found: np.ndarray = curve.curve(times)[list(places)]
        return found

    return part


def _measured(run: Trajectory, name: str) -> Measured:
    place = run.input_names.index(name)
    return Measured(name, run.t, run.inputs[:, place], run.held(name))


def put_off(value: Any, delay: float, name: str) -> Any:
    """Give an input as it was some time before.

    Parameters
    ----------
    value : expression in ``t``, function of one time, or :class:`Measured` values.
    delay : how long before.
    name : of the delayed input.

    >>> put_off("sin(t)", 0.5, "u_delayed")
    sin(t - 0.5)
    """
    if isinstance(value, Measured):
        return value.later(name, delay)
    if callable(value) and not isinstance(value, sympy.Basic):
        return lambda t: value(t - delay)
    t = sympy.Symbol("t")
    return parse(value, ["t"]).xreplace({t: t - delay})


def _with_rows(
    run: Trajectory,
    curve: SmoothedTrajectory,
    inputs: Driven,
    later: Sequence[Drive],
    rounding: float,
) -> Trajectory:
    """Give a run with rows, at which nothing was measured, where some inputs jump or have kinks."""
    kinks = np.unique(np.concatenate([np.empty(0), *(drive.kinks for drive in later)]))
    kinks = kinks[(kinks > run.t[0]) & (kinks < run.t[-1])]
    after = np.searchsorted(run.t, kinks)
    gaps = np.minimum(run.t[after] - kinks, kinks - run.t[after - 1])
    # Two times that rounding alone sets apart are one.
    kinks = kinks[gaps > rounding]
    if not len(kinks):
        return run
    t = np.concatenate([run.t, kinks])
    order = np.argsort(t)
    new = order >= len(run)
    rows = np.where(new, np.searchsorted(run.t, t[order]) - 1, order)
    x, values, gaps = run.x[rows], run.inputs[rows], ~run.measured[rows]
    x[new], values[new], gaps[new] = curve.curve(t[order][new]).T, inputs(kinks)[:-1].T, True
    return replace(
        run,
        t=t[order],
        x=x,
        inputs=values,
        unmeasured=gaps,
        noise={state: own.select(rows) for state, own in run.noise.items()},
        sums={state: own.select(rows) for state, own in run.sums.items()},
    )


@dataclass(frozen=True, eq=False)
class DelayFit:
    """A delay that was fitted together with the other constants.

    Parameters
    ----------
    fit : the fit; its last number is the delay.
    delay : the delay.
    equations : state -> right-hand side with the fitted constants.
    bits : of residuals, structure and constants.
    delayed : the runs with the curves that delayed states were read from.
    """

    fit: DelayedFit
    delay: float
    equations: dict[str, sympy.Expr]
    bits: float
    delayed: Delayed

    @property
    def has_delay(self) -> bool:
        """Whether the equations contain a delayed column."""
        return self.fit.problem.mesh.count > 0

    @property
    def error(self) -> float:
        """The standard error of the delay; inf where the data do not determine it.

        Where data are exact, it is at least what times are rounded to.
        """
        rounded = float(np.spacing(np.max(np.abs(self.fit.problem.mesh.t))))
        return max(math.sqrt(float(self.fit.covariance[-1, -1])), rounded)

    def errors_of(
        self, equations: Mapping[str, sympy.Expr], sizes: Sequence[float]
    ) -> dict[str, tuple[tuple[float, float], ...]]:
        """Give state -> (value, standard error) of constants, whose errors count that of the delay.

        Parameters
        ----------
        equations : the equations, which may have simpler numbers in the places of the fitted ones.
        sizes : standard errors of the fitted numbers, in their order.
        """
        fitted = self.fit.theta[:-1]
        found = {}
        for state, expr in equations.items():
            values = np.array(list(take_apart(expr)[1].values()))
            near = [int(np.argmin(np.abs(np.abs(v) - np.abs(fitted)))) for v in values]
            found[state] = tuple(zip(values.tolist(), [sizes[i] for i in near], strict=True))
        return found

    def as_delay(self, state: str) -> Delay:
        """Give the delay of a state with its interval."""
        beside = self.fit.reach * self.error
        return Delay(state, self.delay, self.error, self.delay - beside, self.delay + beside)


def follow(
    equations: Mapping[str, sympy.Expr],
    delays: Mapping[str, Delay],
    history: Callable[[np.ndarray], np.ndarray],
    t: np.ndarray,
    inputs: Mapping[str, object],
    engine: str | AbstractEngine = DEFAULT_ENGINE,
    nodes: int = 40,
) -> Trajectory:
    """Integrate equations with delays by the method of steps.

    Parameters
    ----------
    equations : state -> right-hand side; delayed states are inputs.
    delays : input -> the delay that it is; those of inputs are among ``inputs``.
    history : gives the states (k, n) at n times up to the first one of ``t``.
    t : (m,) increasing times.
    inputs : all other inputs, as :func:`dynsr.discovery.predict` takes them.
    engine : what integrates.
    nodes : times of one step at which the solution is kept for the next one, at least.

    Raises InputError and EngineError where :func:`dynsr.discovery.predict` does.
    """
    states = list(equations)
    delays = {name: delay for name, delay in delays.items() if delay.state in equations}
    if not delays:
        return predict(equations, history(t[:1])[:, 0], t, inputs, engine)
    step = min(delay.value for delay in delays.values())
    ends = np.append(np.arange(t[0], t[-1], step), t[-1])
    solved: list[tuple[np.ndarray, np.ndarray]] = []
    start = history(t[:1])[:, 0]
    size = float(np.max(np.abs(history(np.linspace(t[0] - step, t[0], nodes)))))

    def before(times: np.ndarray, place: int) -> np.ndarray:
        own = history(np.minimum(times, t[0]))[place]
        if not solved:
            return own
        known = np.concatenate([part[0] for part in solved])
        values = np.concatenate([part[1][:, place] for part in solved])
        known, first = np.unique(known, return_index=True)
        curve = CubicSpline(known, values[first])
        return np.where(times < t[0], own, curve(np.clip(times, known[0], known[-1])))

    for low, high in pairwise(ends):
        times, inside = np.linspace(low, high, nodes), t[(t >= low) & (t <= high)]
        # Two times that rounding alone sets apart are one.
        near = np.abs(inside - times[np.rint((inside - low) / (times[1] - low)).astype(int)])
        times = np.unique(np.append(times, inside[near > SLACK * step]))
        given = dict(inputs)
        for name, delay in delays.items():
            values = before(times - delay.value, states.index(delay.state))
            given[name] = Measured(name, times, values, "smooth")
        x = predict(equations, start, times, given, engine, size=size).x
        size = max(size, float(np.max(np.abs(x))))
        solved.append((times, x))
        start = x[-1]
    found = np.column_stack([before(t, place) for place in range(len(states))])
    found[0] = history(t[:1])[:, 0]
    return Trajectory(t, found, tuple(states))


def read_history(
    run: Trajectory, states: Sequence[str], delays: Mapping[str, Delay]
) -> Callable[[np.ndarray], np.ndarray]:
    """Give the states (k, n) at n times up to the first of a run, from its delayed columns.

    Parameters
    ----------
    run : the run.
    states : the k states.
    delays : column -> the delay that it is.
    """
    columns = {own.state: (name, own.value) for name, own in delays.items() if own.state in states}
    curves = {
        state: CubicSpline(run.t - value, run.inputs[:, run.input_names.index(name)])
        for state, (name, value) in columns.items()
    }

    def history(times: np.ndarray) -> np.ndarray:
        return np.array(
            [
                curves[state](times)
                if state in curves
                else np.full(len(times), run.x[0, run.index(state)])
                for state in states
            ]
        )

    return history
