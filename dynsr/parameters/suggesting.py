"""Suggesting: the next experiment, whose data give most information.

Where other equations follow the data nearly as well, it is the start (and the course of the inputs)
at which they and the answer part most: the expected rise of the chi-square when one is true and the
other is fitted, which may still move its constants as far as the data so far allow, and its start
(Box and Hill 1967, Technometrics 9, 57). Where there is no other equation, it is the one
that determines the constants best: the bits by which their uncertainty shrinks (Lindley 1956).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy

from dynsr.engines import Drive
from dynsr.errors import InputError
from dynsr.expression import bare_term, expand_terms, ratio_forms, shown, skeleton
from dynsr.fit import (
    Flow,
    Measurements,
    Shooting,
    Windows,
    constant_bits,
    drives_of,
    finer_paces,
    fit_along,
    loosen_all,
    prepare,
    tidy,
    with_floats,
)
from dynsr.library import structure_in
from dynsr.parameters.parameters import in_columns
from dynsr.verdict import count_constants

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Equations = Mapping[str, sympy.Expr]


@dataclass(frozen=True)
class SuggestionSettings:
    """The numbers that decide a suggestion.

    Parameters
    ----------
    starts : that are tried, drawn evenly over the range of the states.
    beyond : share of that range by which they lie outside of it at most; no start is below 0 where
        no state was.
    farthest : an experiment that leaves the range by so many times its width is left out.
    shown : experiments that are given, the best first.
    apart : share of the range by which their starts differ, where inputs do the same.
    looked : formulas of each state that are fitted as alternatives, those of least loss.
    refined : of the experiments, those for which systems are fitted to each other and not only
        along a line, the best first.
    steps, damping : of such a fit, and the factor by which it is damped more after a bad step.
    enough : bits beyond which more are of no use; of such experiments the start nearest to the
        range of the data is the best.
    plausible : bits that an alternative may take more than the answer to be one.
    alternatives : of them, at most, those of the fewest bits.
    levels : shares of its range at which an input is held constant.
    courses : runs whose course of the inputs is tried again.
    rows : of an experiment, at most.
    prior : standard deviation of a constant of which the data say nothing, as a multiple of it.
    error : of the integration, in units of the noise.
    finest : steps of order 8 between two rows at most.
    """

    starts: int = 100
    beyond: float = 0.5
    farthest: float = 3.0
    shown: int = 5
    apart: float = 0.1
    looked: int = 8
    refined: int = 8
    steps: int = 8
    damping: float = 10.0
    enough: float = 40.0
    plausible: float = 40.0
    alternatives: int = 3
    levels: tuple[float, ...] = (0.0, 0.5, 1.0)
    courses: int = 3
    rows: int = 200
    prior: float = 10.0
    error: float = 0.1
    finest: int = 16


SUGGESTION: SuggestionSettings = SuggestionSettings()


@dataclass(frozen=True)
class Alternative:
    """Another system that follows the data.

    Parameters
    ----------
    equations : state -> right-hand side, fitted to the data.
    state : whose equation is another one.
    bits : that it takes more than the answer.
    """

    equations: Equations
    state: str
    bits: float

    @property
    def text(self) -> str:
        """The equation that is another one."""
        return f"{self.state}' = {shown(tidy(self.equations[self.state]), 4)}"

    @property
    def distance(self) -> str:
        """How many bits it takes more than the answer, or fewer, in words.

        >>> Alternative({}, "x", 3.0).distance, Alternative({}, "x", -12.5).distance
        ('3 bits behind', '12.5 bits ahead')
        """
        return f"{abs(self.bits):.3g} bits {'behind' if self.bits >= 0 else 'ahead'}"


@dataclass(frozen=True)
class Experiment:
    """One experiment that could be made.

    Parameters
    ----------
    start : state -> value at its first row.
    inputs : what the inputs do, in words; "" where there are none.
    bits : that it is expected to give: between answer and alternatives, each by its probability,
        or of the constants.
    each : bits between the answer and each alternative.
    """

    start: Mapping[str, float]
    inputs: str
    bits: float
    each: tuple[float, ...] = ()


@dataclass(frozen=True, repr=False)
class Suggestion:
    """Experiments that give most information, the best first.

    Parameters
    ----------
    experiments : the best of those that were tried.
    again : the first run of the data made once more, for comparison; None where the equations, or
        those of an alternative, cannot be integrated over it.
    alternatives : what they distinguish from the answer; empty where they determine its constants.
    equations : the answer, fitted to the data.
    times : (n,) rows of each experiment.
    noise : state -> standard deviation of its noise; inf where it is not measured.
    curves : (1 + A, n, k) what the answer and each alternative do in the best experiment.
    enough : bits between two systems beyond which more are not counted.
    """

    experiments: tuple[Experiment, ...]
    again: Experiment | None
    alternatives: tuple[Alternative, ...]
    equations: Equations
    times: np.ndarray
    noise: Mapping[str, float]
    curves: np.ndarray
    enough: float

    @property
    def best(self) -> Experiment:
        """The experiment that gives most information."""
        return self.experiments[0]

    @property
    def heading(self) -> str:
        """What the bits measure, in a sentence."""
        if not self.alternatives:
            return "No other equation is left: the bits are of the constants."
        others = "; ".join(f"{a.text} ({a.distance})" for a in self.alternatives)
        most_of_one = max(bits for own in self.experiments for bits in own.each)
        if most_of_one < 1:
            return (
                f"No experiment of {self.size} that was tried distinguishes the equations found "
                f"from {others}: none gives a bit. Take a longer span, or measure better."
            )
        most = f"{self.enough:g} at most"
        return f"The bits, {most}, are between the equations found and {others}."

    @property
    def columns(self) -> tuple[str, ...]:
        """Headings of :meth:`table`."""
        states = [f"{state}(0)" for state in self.best.start]
        return ("experiment", *states, *["inputs"] * bool(self.best.inputs), "bits")

    def table(self) -> list[tuple[Any, ...]]:
        """Give a row for each experiment, and one for the first run made again."""
        named = [(str(i), own) for i, own in enumerate(self.experiments, 1)]
        named += [] if self.again is None else [("first run again", self.again)]
        return [
            (name, *own.start.values(), *[own.inputs] * bool(self.best.inputs), own.bits)
            for name, own in named
        ]

    def to_frame(self) -> pd.DataFrame:
        """Give the table as a frame of pandas."""
        import pandas as pd

        return pd.DataFrame(self.table(), columns=list(self.columns))

    def __repr__(self) -> str:
        """Write the heading, the span and the table."""
        rows = [self.columns, *(tuple(map(_read, row)) for row in self.table())]
        return "\n".join([self.heading, f"{self.size}:", *in_columns(rows)])

    @property
    def size(self) -> str:
        """Rows and span of each experiment, in words."""
        return f"{len(self.times)} rows over {self.times[-1] - self.times[0]:.4g}"

    def plot(self) -> Figure:
        """Draw what the answer and the alternatives do in the best experiment."""
        from dynsr.report import draw_suggestion

        return draw_suggestion(self)


def _read(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True, eq=False)
class _Model:
    """A system fitted to the data, and how far its constants may move.

    Parameters
    ----------
    flow : the system; its P constants are states that rest, so that each experiment has its own.
    constants : (P,) values.
    spread : (P, P) a root of their covariance.
    """

    flow: Flow
    constants: np.ndarray
    spread: np.ndarray


@dataclass(frozen=True, eq=False)
class _Courses:
    """What a model does in every experiment, in units of the noise.

    Parameters
    ----------
    found : (W, N) its states at the rows.
    moves : (W, N, k + P) what the start, and then the constants, do to them.
    """

    found: np.ndarray
    moves: np.ndarray


@dataclass(frozen=True, eq=False)
class _Plan:
    """Experiments of one course of the inputs.

    Parameters
    ----------
    label : the course, in words.
    drive : driven columns (d + 1, n) at n times, the time the last.
    starts : (k, W) starts.
    """

    label: str
    drive: Any
    starts: np.ndarray


def suggest(
    equations: Equations,
    others: Mapping[str, Iterable[sympy.Expr]],
    data: Measurements,
    rng: np.random.Generator,
    rows: int | None = None,
    span: float | None = None,
    settings: SuggestionSettings = SUGGESTION,
) -> Suggestion:
    """Give the experiments with most information.

    Parameters
    ----------
    equations : state -> right-hand side, of every state that was measured.
    others : state -> formulas that may take the place of its equation, the most probable first.
    data : the measurements so far.
    rng : where the starts come from.
    rows, span : of an experiment; those of the longest run by default.
    settings : the numbers that decide.

    Raises InputError where the equations cannot be fitted to the data or not be integrated.
    """
    answer = fit_along(loosen_all(equations), data)
    if answer is None:
        raise InputError("the equations cannot be fitted along these data; their slopes diverge")
    alternatives = list(_fit_alternatives(equations, others, data, answer, settings))
    alternatives.sort(key=lambda pair: pair[0].bits)
    taken = alternatives[: settings.alternatives]
    longest = max(data.runs, key=len)
    times = np.linspace(
        0.0,
        span or float(longest.t[-1] - longest.t[0]),
        rows or min(len(longest), settings.rows),
    )
    times = times + float(longest.t[0])
    noise = _noise_of(data, list(equations)) * math.sqrt(answer.scale)
    models = [_model(answer, data, settings), *(_model(fit, data, settings) for _, fit in taken)]
    behind = [own.bits for own, _ in taken]
    tried = _Trial(models, behind, times, noise, _range(data, equations), settings)
    states, driven = list(equations), _driven(models, data)
    plans = list(_plans(data, states, driven, tried, rng, settings))
    found = [own for plan in plans for own in tried.experiments(plan, states)]
    first = [own for own in found if own.again]
    others_tried = [own for own in found if not own.again]
    if not others_tried:
        raise InputError(
            f"the equations cannot be integrated over an experiment of {np.ptp(times):.4g}; ask "
            "for a shorter span"
        )
    near = tried.best_of(others_tried, settings.refined)
    again = next((tried.refine(own) for own in first), None)
    near = [tried.refine(own) for own in near]
    best = tried.best_of(near, settings.shown)
    return Suggestion(
        tuple(own.experiment for own in best),
        None if again is None else again.experiment,
        tuple(own for own, _ in taken),
        answer.found.exprs,
        times,
        dict(zip(equations, noise.tolist(), strict=True)),
        best[0].curves * np.where(np.isfinite(noise), noise, np.nan),
        settings.enough,
    )


def _driven(models: Sequence[_Model], data: Measurements) -> tuple[str, ...]:
    """Name the columns that any of the models reads, in the order of the data."""
    used = {name for model in models for name in model.flow.driven}
    return tuple(n for n in dict.fromkeys([*data.runs[0].names, *data.inputs]) if n in used)


@dataclass(frozen=True, eq=False)
class _Tried:
    """An experiment that was tried.

    Parameters
    ----------
    experiment : what it is expected to show.
    plan : the experiment alone.
    curves : (1 + A, n, k) what the models do in it, in units of the noise.
    outside : how far its start is outside of the range of the data, in shares of that.
    again : whether it is the first run once more.
    """

    experiment: Experiment
    plan: _Plan
    curves: np.ndarray
    outside: float
    again: bool


def _fit_alternatives(
    equations: Equations,
    others: Mapping[str, Iterable[sympy.Expr]],
    data: Measurements,
    answer: Any,
    settings: SuggestionSettings,
) -> Iterator[tuple[Alternative, Any]]:
    """Fit systems with another equation of one state; those far behind are no alternatives."""
    measured = float(answer.problem.mesh.rows.sum())
    cost = answer.problem.cost(answer.found.states.T, answer.constants)
    structure = structure_in(answer.problem.mesh.columns)
    written = {state: with_floats(expr) for state, expr in equations.items()}
    for state, formulas in others.items():
        own = equations[state]
        known = _shapes(own)
        for expr in list(formulas)[: settings.looked]:
            shapes = _shapes(expr)
            # What holds the answer's terms and more can do as it does, and is not told from it.
            wider = _terms(own) <= _terms(expr)
            if wider or not known.isdisjoint(shapes) or not expr.free_symbols:
                continue
            known |= shapes
            fit = fit_along(loosen_all({**equations, state: expr}), data)
            if fit is None:
                continue
            rise = fit.problem.cost(fit.found.states.T, fit.constants) - cost
            more = count_constants(expr) - count_constants(own)
            bits = rise / answer.scale / (2 * math.log(2)) + more * constant_bits(measured)
            bits += structure({**written, state: with_floats(expr)}) - structure(written)
            if bits <= settings.plausible:
                yield Alternative(fit.found.exprs, state, float(bits)), fit


def _terms(expr: sympy.Expr) -> set[sympy.Expr]:
    """Give the shapes of the terms: their factors and the numbers inside them do not count."""
    terms = sympy.Add.make_args(expand_terms(expr))
    return {skeleton(with_floats(bare_term(term))) for term in terms}


def _shapes(expr: sympy.Expr) -> set[sympy.Expr]:
    """Give the shapes of a formula, however its ratios are written."""
    return {skeleton(with_floats(form)) for form in ratio_forms(sympy.together(expr))}


def _model(fit: Any, data: Measurements, settings: SuggestionSettings) -> _Model:
    """Give the flow of a fit, and how far its constants may move."""
    flow, _, _ = prepare(fit.problem.exprs, data.runs, data.inputs)
    constants = fit.constants
    prior = settings.prior * np.maximum(np.abs(constants), 1e-300)
    scaled = fit.found.information * np.outer(prior, prior) / fit.scale
    values, directions = np.linalg.eigh(scaled + np.eye(len(constants)))
    spread = prior[:, None] * directions / np.sqrt(np.maximum(values, 1.0))
    resting = {str(symbol): sympy.S.Zero for symbol in flow.constants}
    return _Model(Flow({**flow.rhs, **resting}, flow.driven, ()), constants, spread)


def _noise_of(data: Measurements, states: Sequence[str]) -> np.ndarray:
    """(k,) standard deviation of the noise of each state; inf where none is measured."""
    noise = np.concatenate(data.deviations)
    places = [data.runs[0].index(state) for state in states]
    found = []
    for column in noise.T[places]:
        told = column[np.isfinite(column)]
        found.append(float(np.median(told)) if len(told) else math.inf)
    return np.array(found)


def _range(data: Measurements, states: Iterable[str]) -> np.ndarray:
    """(2, k) lowest and highest value of each state in the smoothed data."""
    places = [data.runs[0].index(state) for state in states]
    x = np.concatenate([own.x for own in data.smoothed])[:, places]
    return np.stack([x.min(axis=0), x.max(axis=0)])


def _plans(
    data: Measurements,
    states: Sequence[str],
    driven: tuple[str, ...],
    trial: _Trial,
    rng: np.random.Generator,
    settings: SuggestionSettings,
) -> Iterator[_Plan]:
    """Give the experiments, those of the first run's start first."""
    low, high = trial.range
    width = np.maximum(high - low, 1e-300)
    bottom = low - settings.beyond * width
    # Noise takes what is never below 0 there.
    least = np.where(np.isfinite(trial.noise), -trial.noise, 0.0)
    bottom = np.where((low >= least) & (bottom < 0), 0.0, bottom)
    top = high + settings.beyond * width
    starts = bottom[:, None] + (top - bottom)[:, None] * rng.random((len(low), settings.starts))
    places = [data.runs[0].index(state) for state in states]
    first = data.smoothed[0].x[0, places][:, None]
    measured = [n for n in driven if n not in data.inputs]
    runs = data.runs[: settings.courses if measured else 1]
    names = [f"as in run {i}" if measured else "" for i in range(1, len(runs) + 1)]
    for place, (name, drive) in enumerate(
        zip(names, drives_of(driven, runs, data.inputs), strict=True)
    ):
        own = np.concatenate([first, starts], axis=1) if place == 0 else starts
        yield _Plan(name, drive, own)
    begin = np.array([float(data.runs[0].t[0])])
    base = drives_of(driven, data.runs[:1], data.inputs)[0]
    columns = {
        n: np.concatenate([run.columns[:, run.names.index(n)] for run in data.runs])
        for n in measured
    }
    for name in measured:
        for share in settings.levels:
            value = float(columns[name].min() + share * np.ptp(columns[name]))
            held = {n: float(np.mean(own)) for n, own in columns.items()} | {name: value}
            drives = tuple(Drive(n, begin, np.array([[held[n]]])) for n in measured)
            yield _Plan(f"{name} = {value:.3g}", replace(base, drives=drives), starts)


@dataclass(frozen=True, eq=False)
class _Trial:
    """What experiments would show.

    Parameters
    ----------
    models : the answer, then the alternatives.
    behind : bits that each alternative takes more than the answer.
    times : (n,) rows of an experiment.
    noise : (k,) standard deviation of the noise of each state.
    range : (2, k) lowest and highest value of each state so far.
    settings : the numbers that decide.
    """

    models: Sequence[_Model]
    behind: Sequence[float]
    times: np.ndarray
    noise: np.ndarray
    range: np.ndarray
    settings: SuggestionSettings

    def experiments(self, plan: _Plan, states: Sequence[str]) -> Iterator[_Tried]:
        """Give each experiment that can be made, with what it shows along a line."""
        courses = [self._follow(model, plan, None) for model in self.models]
        again = len(plan.starts[0]) > self.settings.starts
        for lane, start in enumerate(plan.starts.T):
            finite = all(np.all(np.isfinite(own.found[lane])) for own in courses)
            if not finite or not self._is_near(courses[0].found[lane]):
                continue
            each = tuple(
                min(self._apart(0, i, courses, lane), self._apart(i, 0, courses, lane))
                for i in range(1, len(courses))
            )
            bits = self._mean(each) if each else self._told(courses[0], lane)
            named = dict(zip(states, start.tolist(), strict=True))
            shape = (len(courses), len(self.times), -1)
            yield _Tried(
                Experiment(named, plan.label, bits, each),
                replace(plan, starts=start[:, None]),
                np.array([course.found[lane] for course in courses]).reshape(shape),
                float(
                    np.max(np.maximum(self.range[0] - start, start - self.range[1]) / self._width)
                ),
                again and lane == 0,
            )

    @property
    def _width(self) -> np.ndarray:
        """(k,) width of the range of each state."""
        return np.maximum(self.range[1] - self.range[0], 1e-300)

    def _mean(self, each: Sequence[float]) -> float:
        """Bits to be expected: those of each alternative by its probability."""
        weights = np.exp2(-np.maximum(self.behind, 0.0))
        return float(np.average(np.minimum(each, self.settings.enough), weights=weights))

    def refine(self, own: _Tried) -> _Tried:
        """Fit each system to what the other does, where before only a line was followed."""
        if len(self.models) == 1:
            return own
        each = tuple(
            min(self._fitted_apart(0, i, own), self._fitted_apart(i, 0, own))
            for i in range(1, len(self.models))
        )
        bits = self._mean(each)
        return replace(own, experiment=replace(own.experiment, bits=bits, each=each))

    def _fitted_apart(self, true: int, fitted: int, own: _Tried) -> float:
        """Bits between two models where one is true and the other is fitted, by damped steps."""
        aim, model = own.curves[true].ravel(), self.models[fitted]
        scale = self._scale(model)
        begin = np.concatenate([own.plan.starts[:, 0], model.constants])
        moved, cost, damping = np.zeros(len(begin)), math.inf, 0.0
        step = moved
        for _ in range(self.settings.steps):
            tried = moved + step
            at = (begin + scale @ tried)[:, None]
            course = self._follow(model, own.plan, at)
            gap = aim - course.found[0]
            reached = float(gap @ gap + tried @ tried) if np.all(np.isfinite(gap)) else math.inf
            if reached < cost and np.all(np.isfinite(course.moves)):
                gained, moved, cost = cost - reached, tried, reached
                damping /= self.settings.damping
                if gained < self.settings.error:
                    break
            elif not np.any(step):
                return 0.0
            else:
                damping = max(self.settings.damping * damping, 1.0)
                course = self._follow(model, own.plan, (begin + scale @ moved)[:, None])
                gap = aim - course.found[0]
            slopes = course.moves[0] @ scale
            root = np.eye(len(moved))
            columns = np.concatenate([slopes, root, math.sqrt(damping) * root])
            target = np.concatenate([gap, -moved, np.zeros(len(moved))])
            step = np.linalg.lstsq(columns, target, rcond=None)[0]
        return cost / (2 * math.log(2))

    def _scale(self, model: _Model) -> np.ndarray:
        """(k + P, k + P) what start and constants may move: the range, and as the data allow."""
        count, k = len(model.constants), len(self.noise)
        found = np.zeros((k + count, k + count))
        found[:k, :k] = np.diag(self._width)
        found[k:, k:] = model.spread
        return found

    def best_of(self, tried: Sequence[_Tried], most: int) -> list[_Tried]:
        """Give the best experiments, the best first, none like one before it.

        Parameters
        ----------
        tried : all of them.
        most : experiments at most.
        """
        found: list[_Tried] = []
        for own in sorted(tried, key=lambda one: (-one.experiment.bits, one.outside)):
            near = (
                np.max(np.abs(own.plan.starts - one.plan.starts)[:, 0] / self._width)
                < self.settings.apart
                for one in found
                if one.plan.label == own.plan.label
            )
            if not any(near):
                found.append(own)
            if len(found) == most:
                break
        return found

    def _is_near(self, found: np.ndarray) -> bool:
        """Whether the answer stays near what the states were."""
        low, high = self.range
        told = np.isfinite(self.noise)
        x = (found.reshape(len(self.times), -1) * np.where(told, self.noise, 0.0))[:, told]
        room = self.settings.farthest * (high - low)[told]
        return bool(np.all(x >= low[told] - room) and np.all(x <= high[told] + room))

    def _follow(self, model: _Model, plan: _Plan, at: np.ndarray | None) -> _Courses:
        """Integrate a model through all experiments, in steps that are short enough.

        ``at`` (k + P, W) are starts and constants; by default those of plan and model.
        """
        k, lanes = plan.starts.shape
        if at is None:
            rest = np.repeat(model.constants[:, None], lanes, axis=1)
            at = np.concatenate([plan.starts, rest])
        t = np.repeat(self.times[:, None], lanes, axis=1)
        names = [*plan.drive.names, "t"]
        own = [names.index(name) for name in (*model.flow.driven, "t")]

        def drive(times: np.ndarray, before: bool = False) -> np.ndarray:
            found: np.ndarray = plan.drive(times.ravel(), before)[own]
            return found.reshape(len(found), *times.shape)

        jumps = bool(len(plan.drive.jumps))
        windows = Windows(t, np.zeros((len(t), len(at), lanes)), drive, jumps)
        noise = np.concatenate([self.noise, np.full(len(at) - k, np.inf)])
        shooting, nothing = Shooting(model.flow, windows, noise, True), np.empty(0)
        with np.errstate(all="ignore"):
            coarse = shooting.misses(nothing, at)
            for pace in finer_paces(1, self.settings.finest):
                shooting = replace(shooting, pace=pace)
                fine = shooting.misses(nothing, at)
                off = np.max(np.abs(fine - coarse), axis=(0, 1))
                if np.all((off < self.settings.error) | ~np.isfinite(off)):
                    break
                coarse = fine
            z, _, moves = shooting.linearise(nothing, at)
        found = z[:, :k].transpose(2, 0, 1).reshape(lanes, -1)
        moves = moves.reshape(lanes, len(t), len(at), -1)[:, :, :k].reshape(lanes, len(t) * k, -1)
        return _Courses(found, moves)

    def _apart(self, true: int, fitted: int, courses: Sequence[_Courses], lane: int) -> float:
        """Bits expected along a line where one model is true and the other fitted."""
        gap = courses[true].found[lane] - courses[fitted].found[lane]
        moves = courses[fitted].moves[lane] @ self._scale(self.models[fitted])
        if not np.all(np.isfinite(moves)):
            return 0.0
        # What the moves, each of which costs its square, cannot compensate for.
        columns = np.concatenate([moves, np.eye(moves.shape[1])])
        aim = np.concatenate([gap, np.zeros(moves.shape[1])])
        left = aim - columns @ np.linalg.lstsq(columns, aim, rcond=None)[0]
        return float(left @ left / (2 * math.log(2)))

    def _told(self, own: _Courses, lane: int) -> float:
        """Bits by which the uncertainty of the constants is expected to shrink."""
        moves = own.moves[lane] @ self._scale(self.models[0])
        if not np.all(np.isfinite(moves)):
            return 0.0
        start = moves[:, : len(self.noise)]
        told = [np.log1p(np.linalg.svd(part, compute_uv=False) ** 2) for part in (moves, start)]
        return float((told[0].sum() - told[1].sum()) / (2 * math.log(2)))
