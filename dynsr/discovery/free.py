"""Free: known equations in which functions of one column are found, or stay curves.

First every free function is a curve that is fitted along the states together with all constants.
Then formulas for each are proposed by what the curve says, and fitted in its place. A formula is
the answer where it takes fewer bits than the curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import Any, TypeVar

import numpy as np
import sympy
from scipy.special import chdtri

from dynsr.data import Samples, Trajectory, carry
from dynsr.discovery.asked import choose_targets
from dynsr.discovery.free_model import FreeModel, finish_model, has_free, read_model
from dynsr.discovery.options import OF_PLAIN, Options, Search
from dynsr.discovery.problem import DiscoverySettings
from dynsr.discovery.result import Discovery, keep_if_asked
from dynsr.engines import find_engine
from dynsr.errors import InputError
from dynsr.expression import evaluate, free_constants, shown, skeleton, to_text
from dynsr.fit import (
    CurvedFit,
    CurvedSettings,
    CurvedSystem,
    FitSettings,
    Measurements,
    Mesh,
    MixedMesh,
    Noise,
    ParetoFront,
    Part,
    Slopes,
    constant_bits,
    description_length,
    first_numbers,
    fit_curved,
    flat_curves,
    loosen_all,
    measure_runs,
    refit,
    refit_curved,
    score_candidate,
    simple_numbers,
    tidy,
    with_floats,
)
from dynsr.jobs import Budget, Step
from dynsr.methods import Limits, make_method
from dynsr.parameters import (
    FreePart,
    FreeParts,
    FreeSettings,
    Parameter,
    Parameters,
    ParametricSystem,
    find_names,
    fits,
    take_apart,
)
from dynsr.selection import SystemComparison, look
from dynsr.verdict import (
    NOBODY,
    NOT_FOUND,
    Verdict,
    doubt_laws,
    explain,
    give_verdict,
    name_engines,
)

# Options of a search that have no meaning where all but some functions is known.
_REFUSED = (*OF_PLAIN, "terms", "must", "constraints", "nonnegative")
# Name of a constant of a formula; the space keeps it apart from any name of a column.
_OWN = "constant of "
# Name of a constant of an equation that was found.
_FOUND = "constant found in "
T = TypeVar("T")


def check_free(options: Options) -> bool:
    """Give whether known equations have free functions; refuse options that do not go with them.

    Raises InputError that names the option.
    """
    if not has_free(options.known):
        return False
    options.refuse(_REFUSED, "known", "a free function in known")
    return True


@dataclass(frozen=True, eq=False)
class _Answer:
    """Formulas for some functions, curves for the others, fitted together.

    Parameters
    ----------
    system : the equations.
    fit : its fit.
    bits : of residuals, constants, curves and formulas.
    laws : function -> its formula, in the constants of the system.
    """

    system: CurvedSystem
    fit: CurvedFit
    bits: float
    laws: Mapping[str, sympy.Expr] = field(default_factory=dict)

    @property
    def numbers(self) -> dict[sympy.Symbol, sympy.Expr]:
        """Constant -> its fitted number."""
        pairs = zip(self.system.constants, self.fit.constants.tolist(), strict=True)
        return {sympy.Symbol(name): sympy.Float(value) for name, value in pairs}


@dataclass(frozen=True, eq=False)
class _Study:
    """The data, and what is asked of them."""

    model: FreeModel
    data: Measurements
    rows: MixedMesh
    slopes: Slopes
    settings: DiscoverySettings
    limits: Limits
    units: Mapping[str, sympy.Rational]
    seed: int
    until: float
    begun: np.ndarray | None = None
    tried: dict[str, list[tuple[sympy.Expr, _Answer, float]]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        model: FreeModel,
        runs: Sequence[Trajectory],
        inputs: Mapping[str, sympy.Expr],
        settings: DiscoverySettings,
        limits: Limits,
        units: Mapping[str, sympy.Rational],
        seed: int,
        until: float,
    ) -> _Study:
        """Smooth the data."""
        data = measure_runs(carry(runs), inputs, settings.selection.comparison.rows, {})
        states = tuple(s for s in runs[0].states if s in model.equations)
        samples = {s: _samples(data, s) for s in runs[0].states}
        first = samples[states[0]]
        columns = {**first.columns, "t": first.t}
        slopes = Slopes(
            columns,
            np.array([samples[s].y for s in states]),
            np.array([samples[s].slope_sd for s in states]),
        )
        rng, rows = np.random.default_rng(seed), MixedMesh.of(data, states)
        begun, sizes = _begin(model, rows.mesh, slopes, settings.free.curved)
        settled = finish_model(model, columns, rng, settings.free, sizes)
        # Where nothing had to be fixed the curves start from this very fit.
        own = begun if settled is model else None
        return cls(settled, data, rows, slopes, settings, limits, units, seed, until, own)

    @property
    def late(self) -> bool:
        """Whether the time is over."""
        return monotonic() > self.until

    def curved(self) -> _Answer:
        """Fit every function as a curve; raises InputError where that cannot be done."""
        model = self.model
        system = CurvedSystem(model.equations, model.constants, model.parts)
        along = self.settings.selection.fit.along
        curved = self.settings.free.curved
        fit = fit_curved(system, self.rows, self.slopes, curved, along, self.begun)
        if fit is None:
            raise InputError(
                "the equations in known cannot be fitted to these data: their slopes are not "
                "finite; correct them, or give the constants that you know as numbers"
            )
        return _Answer(system, fit, fit.bits + self._structure(model.parts, {}))

    def explained(self, answer: _Answer, part: Part) -> _Answer:
        """Give the answer with the best formula for a function, or as it is.

        Parameters
        ----------
        answer : in which it is a curve.
        part : the function.
        """
        tried = self.tried[part.name] = []
        best = answer
        for expr in self._proposals(answer, part):
            if self.late:
                break
            other = self._with_law(answer, part, expr)
            if other is None:
                continue
            tried.append((other.laws[part.name], other, answer.bits))
            if other.bits < best.bits:
                best = other
        return best

    def _with_law(self, answer: _Answer, part: Part, expr: sympy.Expr) -> _Answer | None:
        """Fit a system with a formula in the place of a curve; None where that cannot be done."""
        template, values = free_constants(with_floats(expr), f"{_OWN}{part.name} ")
        laws = {**answer.laws, part.name: template}
        system = CurvedSystem(
            {s: e.xreplace({part.symbol: template}) for s, e in answer.system.equations.items()},
            (*answer.system.constants, *map(str, values)),
            tuple(p for p in answer.system.parts if p is not part),
        )
        numbers = [*answer.fit.constants, *values.values()]
        fit = refit_curved(system, answer.fit, numbers, self.settings.free.curved)
        if fit is None or not math.isfinite(fit.bits):
            return None
        return _Answer(system, fit, fit.bits + self._structure(system.parts, laws), laws)

    def _structure(self, parts: Sequence[Part], laws: Mapping[str, sympy.Expr]) -> float:
        """Bits of the functions without their constants.

        A curve is a line, and how much it bends is one more constant.
        """
        mesh, bits = self.rows.mesh, 0.0
        comparison = SystemComparison(mesh, self.settings.selection.comparison)
        for name, law in laws.items():
            marked = law.xreplace(_marks(law, mesh.columns))
            bits += comparison.structure({self._owner(name): marked})
        for part in parts:
            line = with_floats(sympy.Rational(4, 3) * sympy.Symbol(part.of) + sympy.Rational(3, 4))
            bits += comparison.structure({self._owner(part.name): line})
            bits += constant_bits(float(mesh.rows.sum()))
        return bits

    def _owner(self, name: str) -> str:
        """Give the first state whose equation contains a function."""
        part = next(part for part in self.model.parts if part.name == name)
        return next(s for s in self.rows.mesh.states if self.model.contains(s, part))

    def _proposals(self, answer: _Answer, part: Part) -> list[sympy.Expr]:
        """Give formulas that the curve of a function allows, the most probable first."""
        if not self.settings.free.fitted:
            return []
        samples = self._evidence(answer, part)
        selection, settings = self.settings.selection, self.settings.free
        x = sympy.Symbol(part.of)
        plain = [refit(e, samples) for e in (sympy.Float(1), 1.0 * x, 1.0 * x + sympy.Float(1))]
        found = list(look(samples, self.limits, selection.look, selection.fit).candidates)
        method = make_method("rational", "quick").within(self.limits)
        with suppress(InputError, ArithmeticError, np.linalg.LinAlgError):
            rng = np.random.default_rng(self.seed)
            found += [*method.search(samples, rng)]
        pool = [score_candidate(e, samples, "plain") for e in plain] + found
        noise = Noise(float(samples.noise or 0.0), float(len(samples)))
        ranked = sorted(pool, key=lambda c: description_length(c, samples, noise))
        shapes: dict[sympy.Expr, sympy.Expr] = {}
        for one in ranked:
            expr = _without_freedom(one.expr, part)
            if expr is not None and self.limits.allow(expr) and expr.free_symbols <= {x}:
                if one.complexity <= self.limits.max_complexity:
                    expr = expr.xreplace({x: x / self.units[part.of]})
                    shapes.setdefault(skeleton(with_floats(expr)), expr)
        return list(shapes.values())[: settings.fitted]

    def _evidence(self, answer: _Answer, part: Part) -> Samples:
        """Give what the curve of a function says of it, as samples; the column is in its unit."""
        place = [p.name for p in answer.system.parts].index(part.name)
        curve, block = answer.fit.curves[place], answer.fit.blocks[place]
        values = np.sort(self.rows.mesh.columns[part.of])
        shares = np.linspace(0, len(values) - 1, self.settings.free.points).astype(int)
        even = np.linspace(values[0], values[-1], self.settings.free.points)
        x = np.unique(np.concatenate([values[shares], even]))
        spread = answer.fit.covariance[block, block]
        weights = curve.weights(x)
        with np.errstate(all="ignore"):
            errors = np.sqrt(np.maximum(np.einsum("nk,kl,nl->n", weights, spread, weights), 0.0))
        size = float(np.max(np.abs(curve.values))) or 1.0
        errors = np.where(np.isfinite(errors), errors, size)
        noise = float(np.sqrt(np.mean(errors**2)))
        X = x[:, None] / float(self.units[part.of])
        return Samples(X, curve(x), (part.of,), part.name, "given", x, noise, errors)

    def points(self, answer: _Answer, part: Part) -> tuple[tuple[float, float], ...]:
        """Give (column, value) of what the slope at each row says of a function.

        There are none where the function is no factor of a term.

        Parameters
        ----------
        answer : in which all functions are curves.
        part : the function.
        """
        state, columns = self._owner(part.name), dict(self.slopes.columns)
        expr = answer.system.equations[state].xreplace(answer.numbers)
        for other, curve in zip(answer.system.parts, answer.fit.curves, strict=True):
            if other is not part:
                columns[str(other.symbol)] = curve(columns[other.of])
        factor = sympy.diff(expr, part.symbol)
        if part.symbol in factor.free_symbols:
            return ()
        rest = expr.xreplace({part.symbol: sympy.S.Zero})
        place = self.rows.mesh.states.index(state)
        with np.errstate(all="ignore"):
            by, error = evaluate(factor, columns), self.slopes.errors[place]
            values = (self.slopes.values[place] - evaluate(rest, columns)) / by
            unsure = error / np.abs(by)
        curve = answer.fit.curves[answer.system.parts.index(part)]
        # A row whose slope says nothing of the function would hide the others.
        told = np.flatnonzero(np.isfinite(values) & (unsure < np.max(np.abs(curve.values))))
        if not len(told):
            return ()
        some = told[np.unique(np.linspace(0, len(told) - 1, self.settings.free.drawn).astype(int))]
        return tuple(zip(columns[part.of][some].tolist(), values[some].tolist(), strict=True))

    def simplified(self, answer: _Answer) -> tuple[_Answer, dict[sympy.Symbol, sympy.Expr]]:
        """Give the answer with simple numbers for constants where the data allow all of them."""
        fitting = self.settings.selection.fit
        names = [sympy.Symbol(name) for name in answer.system.constants]
        numbers = simple_numbers(_Estimate(answer), [None] * len(names), fitting)
        simple = {n: v for n, v in zip(names, numbers, strict=True) if not v.is_Float}
        if not simple:
            return answer, dict(zip(names, numbers, strict=True))
        system = CurvedSystem(
            {s: e.xreplace(simple) for s, e in answer.system.equations.items()},
            tuple(str(name) for name in names if name not in simple),
            answer.system.parts,
        )
        left = [
            float(v) for n, v in zip(names, answer.fit.constants, strict=True) if n not in simple
        ]
        fit = refit_curved(system, answer.fit, left, self.settings.free.curved)
        if fit is None or _worse(fit, answer.fit, len(simple), fitting):
            return answer, answer.numbers
        again = _Answer(system, fit, answer.bits, answer.laws)
        return again, {**simple, **_written(again, fitting)}


@dataclass(frozen=True, eq=False)
class _Estimate:
    """The constants of an answer, as the choice of simple numbers asks for them."""

    answer: _Answer

    @property
    def constants(self) -> np.ndarray:
        """Their values."""
        return self.answer.fit.constants

    @property
    def covariance(self) -> np.ndarray:
        """Their covariance; the curves follow them."""
        count = len(self.constants)
        return self.answer.fit.covariance[:count, :count]

    @property
    def errors(self) -> np.ndarray:
        """Their standard errors."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def put(self, numbers: Sequence[sympy.Expr]) -> dict[str, sympy.Expr]:
        """Give the equations with numbers in the places of the constants."""
        names = map(sympy.Symbol, self.answer.system.constants)
        put = dict(zip(names, numbers, strict=True))
        return {s: e.xreplace(put) for s, e in self.answer.system.equations.items()}


def _begin(
    model: FreeModel,
    mesh: Mesh,
    slopes: Slopes,
    settings: CurvedSettings,
) -> tuple[np.ndarray, dict[str, float]]:
    """Give a first fit to the slopes, and the size of each constant and function in it."""
    system = CurvedSystem(model.equations, model.constants, model.parts)
    curves = flat_curves(system, mesh, settings.knots[0])
    if not curves:
        raise InputError(
            "a free function has fewer than three values of its column in these data; write what "
            "you know of it"
        )
    numbers = first_numbers(system, mesh, curves, slopes, settings)
    parts = np.cumsum([len(model.constants), *(len(curve.knots) for curve in curves)])[:-1]
    own, *values = np.split(numbers, parts)
    heights = [float(np.std(value)) or 1.0 for value in values]
    found = dict(zip(model.constants, np.abs(own).tolist(), strict=True))
    found |= {part.name: size for part, size in zip(model.parts, heights, strict=True)}
    return numbers, {name: size or 1.0 for name, size in found.items()}


def _samples(data: Measurements, state: str) -> Samples:
    """Give the smoothed slopes of a state at every row, also where it was not measured."""
    place = data.runs[0].index(state)
    names = data.runs[0].names
    x = [np.column_stack([s.x, r.inputs]) for r, s in zip(data.runs, data.smoothed, strict=True)]
    sd = np.concatenate([s.slope_sd[:, place] for s in data.smoothed])
    y = np.concatenate([s.slope[:, place] for s in data.smoothed])
    t = np.concatenate([run.t for run in data.runs])
    return Samples(np.concatenate(x), y, names, state, "gp", t, float(np.median(sd)), sd)


def _marks(expr: sympy.Expr, columns: Mapping[str, Any]) -> dict[sympy.Symbol, sympy.Expr]:
    """Give each constant of a formula a float of its own, none of which is a simple number."""
    names = sorted((s for s in expr.free_symbols if str(s) not in columns), key=str)
    return {name: sympy.Float(1 + 1 / (3 + i)) for i, name in enumerate(names)}


def _without_freedom(expr: sympy.Expr, part: Part) -> sympy.Expr | None:
    """Leave out of a formula what another function takes up: a constant, or a factor."""
    if part.mean is None:
        return expr
    if part.mean == 0:
        rest = expr.as_independent(*expr.free_symbols, as_Add=True)[1] if expr.free_symbols else 0
        return rest or None
    factor, rest = expr.as_coeff_Mul()
    return rest if factor != 1 else None


def _worse(fit: CurvedFit, before: CurvedFit, count: int, settings: FitSettings) -> bool:
    """Whether constants that were fixed make the fit worse than chance does."""
    rise = (fit.found.squares - before.found.squares) / before.scale
    return rise > chdtri(count, 1 - settings.joint)


def _written(answer: _Answer, settings: FitSettings) -> dict[sympy.Symbol, sympy.Expr]:
    """Write the fitted constants with the digits that their errors support."""
    names = map(sympy.Symbol, answer.system.constants)
    numbers = simple_numbers(
        _Estimate(answer), [None] * len(answer.system.constants), replace(settings, snap=False)
    )
    return dict(zip(names, numbers, strict=True))


def search_free(
    search: Search,
    runs: Sequence[Trajectory],
    options: Options,
    units: Mapping[str, sympy.Rational],
) -> Discovery:
    """Find the free functions of known equations, and search the equations of the other states.

    Parameters
    ----------
    search : finds equations of trajectories.
    runs : the data.
    options : of the search.
    units : column, or ``t`` -> the unit in which it is a number near 1; 1 where it is so anyway.

    Raises InputError where the known equations cannot be read or fitted.
    """
    began, details = monotonic(), options.details
    run, known, inputs = runs[0], dict(options.known or {}), options.drives
    model = read_model(known, run.states, (*run.names, "t"))
    demands = options.demands(run.states, run.names)
    budget, seed = Budget(options.time_budget), options.seed
    limits = demands.limits(next(iter(model.equations)))
    until = budget.until(details.shares.choices)
    study = _Study.of(model, runs, inputs, details, limits, units, seed, until)
    # What cannot be fitted is refused before anything is searched.
    others = _search_others(search, runs, options, model)
    if others is not None and others.complete and others.verdict.level != NOT_FOUND:
        # What the other states do is then known better than their smoothed curves.
        whole = _with_others(model, others)
        study = _Study.of(whole, runs, inputs, details, limits, units, seed, until)
    steps = ["the curves", *(part.name for part in study.model.parts)]
    complete = True

    def report(done: int) -> None:
        if options.report is not None:
            options.report(Step(steps[done - 1], done, len(steps), seconds=monotonic() - began))

    curved = answer = study.curved()
    report(1)
    try:
        for done, part in enumerate(study.model.parts, 2):
            answer = study.explained(answer, part)
            report(done)
        # A formula for one function may show what another one is.
        while answer.laws and not study.late:
            before = answer
            for part in before.system.parts:
                answer = study.explained(answer, part)
            if answer is before or not answer.system.parts:
                break
        loose, (answer, numbers) = answer, study.simplified(answer)
    except KeyboardInterrupt:
        complete, loose, numbers = False, answer, answer.numbers
    engine = find_engine(options.engine)
    record: dict[str, Any] = {
        **demands.as_record(),
        **options.record("free", run),
        **({"ended_by_budget": ["free functions"]} if study.late else {}),
        "known": {s: to_text(e) if isinstance(e, sympy.Expr) else str(e) for s, e in known.items()},
        "methods": ["free", *(others.settings["methods"] if others else ())],
        "engine": engine.name,
    }
    given = tuple(model.equations)
    found = _as_discovery(study, curved, loose, answer, numbers, others, given, runs, inputs)
    found = _tested(found, study, answer, details) if complete else replace(found, complete=False)
    record["engines"] = name_engines([], engine, found.equations, inputs, along=True)
    found = replace(found, settings=record, engine=engine, seconds=monotonic() - began)
    keep_if_asked(found, options.out)
    return found


def _search_others(
    search: Search, runs: Sequence[Trajectory], options: Options, model: FreeModel
) -> Discovery | None:
    """Search the equations that are not given; None where all targets are."""
    left = [s for s in choose_targets(options.targets, runs[0]) if s not in model.equations]
    if not left:
        return None
    half = None if options.time_budget is None else options.time_budget / 2
    return search(runs, replace(options, known=None, targets=left, out=None, time_budget=half))


def _with_others(model: FreeModel, others: Discovery) -> FreeModel:
    """Give the known equations together with others that were found."""
    equations, constants = dict(model.equations), list(model.constants)
    for state, expr in others.equations.items():
        equations[state], values = free_constants(
            loosen_all({state: expr})[state], f"{_FOUND}{state} "
        )
        constants += map(str, values)
    return replace(model, equations=equations, constants=tuple(constants))


def _as_discovery(
    study: _Study,
    curved: _Answer,
    loose: _Answer,
    answer: _Answer,
    numbers: Mapping[sympy.Symbol, sympy.Expr],
    others: Discovery | None,
    given_states: tuple[str, ...],
    runs: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
) -> Discovery:
    """Give the equations with their constants and functions.

    ``given_states`` are those of the known equations, and ``loose`` is the answer before its
    constants became simple numbers.
    """
    model, fit = study.model, loose.fit
    parts = {p.name: _as_part(study, curved, answer, p, numbers) for p in model.parts}
    functions = {p.symbol: parts[p.name].law for p in answer.system.parts}
    laws = {p.symbol: answer.laws[p.name] for p in model.parts if p.name in answer.laws}
    given = {s: e.xreplace(laws) for s, e in model.equations.items()}

    def put(own: Mapping[sympy.Symbol, sympy.Expr]) -> dict[str, sympy.Expr]:
        return {s: tidy(e.xreplace(dict(own))).xreplace(functions) for s, e in given.items()}

    equations = put(numbers)
    errors, fitted = _errors(put, numbers, loose, study.settings.free.step)
    sizes = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    constants = {
        name: _as_parameter(name, numbers, float(value), float(size), fit.reach, model)
        for name, value, size in zip(loose.system.constants, fit.constants, sizes, strict=False)
        if name in model.constants and not name.startswith(_FOUND)
    }
    named = {s: e.xreplace(functions) for s, e in given.items()}
    names = {} if others else _names(equations, named, numbers)
    free = FreeParts(parts, constants, _notes(model, answer), given_states)
    found = others or Discovery({}, {}, {}, {})
    order = [s for s in runs[0].states if s in {**equations, **found.equations}]

    def both(own: Mapping[str, T], theirs: Mapping[str, T]) -> dict[str, T]:
        whole = {**theirs, **own}
        return {s: whole[s] for s in order if s in whole}

    words = {s: _words(study, s) for s in equations}
    return replace(
        found,
        equations=both(equations, found.equations),
        errors=both(errors, found.errors),
        fitted=both(fitted, found.fitted),
        front=both({s: ParetoFront() for s in equations}, found.front),
        explanation=both(dict.fromkeys(equations, ""), found.explanation),
        trajectories=tuple(run.as_measured() for run in runs),
        inputs=dict(inputs),
        reach=fit.reach,
        verdict=NOBODY,
        details=both({s: own for s, own in words.items() if own}, found.details),
        parameter_names=names,
        profiled={},
        summary=None,
        free=free,
    )


def _as_part(
    study: _Study,
    curved: _Answer,
    answer: _Answer,
    part: Part,
    numbers: Mapping[sympy.Symbol, sympy.Expr],
) -> FreePart:
    """Give a function as it was found, with its curve."""
    # The curve of a function with a formula is that of the fit of all curves.
    source = answer if part in answer.system.parts else curved
    place = source.system.parts.index(part)
    curve, block = source.fit.curves[place], source.fit.blocks[place]
    law = answer.laws.get(part.name)
    tried = sorted(study.tried.get(part.name, ()), key=lambda pair: pair[1].bits)
    bits = {
        _shown(expr, own, study.settings.free): own.bits - before for expr, own, before in tried
    }
    return FreePart(
        part.name,
        part.of,
        tuple(curve.knots.tolist()),
        tuple(curve.values.tolist()),
        tuple(map(tuple, source.fit.covariance[block, block].tolist())),
        source.fit.reach,
        float(source.fit.effective[1 + place]),
        "" if law is None else to_text(tidy(law.xreplace(dict(numbers)))),
        study.points(curved, part),
        dict(list(bits.items())[: study.settings.free.shown]),
    )


def _as_parameter(
    name: str,
    numbers: Mapping[sympy.Symbol, sympy.Expr],
    fitted: float,
    error: float,
    reach: float,
    model: FreeModel,
) -> Parameter:
    """Give a constant of the known equations; its interval reaches to its simple number."""
    symbol = sympy.Symbol(name)
    value, beside = float(numbers[symbol]), reach * error
    states = tuple(s for s, e in model.equations.items() if symbol in e.free_symbols)
    low, high = min(fitted - beside, value), max(fitted + beside, value)
    return Parameter(name, value, error, low, high, states=states)


def _errors(
    put: Callable[[Mapping[sympy.Symbol, sympy.Expr]], dict[str, sympy.Expr]],
    numbers: Mapping[sympy.Symbol, sympy.Expr],
    loose: _Answer,
    share: float,
) -> tuple[dict[str, tuple[tuple[float, float], ...]], dict[str, tuple[float, ...]]]:
    """Give state -> (value, standard error), and fitted value, of the constants of equations.

    A product of two numbers is one constant: its error follows from theirs.
    """

    def constants(own: Mapping[sympy.Symbol, sympy.Expr]) -> dict[str, np.ndarray]:
        return {s: np.array([*take_apart(e)[1].values()]) for s, e in put(own).items()}

    count = len(loose.system.constants)
    spread = loose.fit.covariance[:count, :count]
    base, turned, gaps = constants(numbers), dict[str, list[np.ndarray]](), []
    for name, value in zip(loose.system.constants, loose.fit.constants.tolist(), strict=True):
        symbol = sympy.Symbol(name)
        own = float(numbers[symbol])
        gaps.append(value - own)
        step = share * (abs(own) or 1.0)
        moved = constants({**numbers, symbol: sympy.Float(own + step)})
        for state, before in base.items():
            turned.setdefault(state, []).append((_aligned(moved[state], before) - before) / step)
    errors, fitted = {}, {}
    for state, values in base.items():
        slopes = np.array(turned.get(state, [])).reshape(count, len(values))
        with np.errstate(all="ignore"):
            variance = np.einsum("pi,pq,qi->i", slopes, spread, slopes)
        sizes = [math.sqrt(v) if v >= 0 and math.isfinite(v) else math.inf for v in variance]
        errors[state] = tuple(zip(values.tolist(), sizes, strict=True))
        fitted[state] = tuple((values + np.array(gaps) @ slopes).tolist())
    return errors, fitted


def _aligned(moved: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Give the numbers that others became, where one more or less is there.

    A factor of 1 is no constant, until it is moved.
    """
    if len(moved) == len(before):
        return moved
    left, found = moved.tolist(), []
    for value in before.tolist():
        near = min(left, key=lambda one: abs(one - value), default=value)
        if near in left:
            left.remove(near)
        found.append(near)
    return np.array(found)


def _names(
    equations: Mapping[str, sympy.Expr],
    named: Mapping[str, sympy.Expr],
    numbers: Mapping[sympy.Symbol, sympy.Expr],
) -> dict[str, tuple[str, ...]]:
    """Give the names of the constants of equations, where each is one of the known equations."""
    plain = {
        symbol: sympy.Symbol(str(symbol).removeprefix(_OWN).removeprefix(_FOUND).replace(" ", "_"))
        for symbol in numbers
    }
    parameters = [Parameter(str(plain[s]), float(number)) for s, number in numbers.items()]
    written = {s: e.xreplace(plain) for s, e in named.items()}
    names = find_names(ParametricSystem(written, Parameters(parameters)))
    return names if fits(equations, names) else {}


def _notes(model: FreeModel, answer: _Answer) -> tuple[str, ...]:
    """Say what cannot be determined, and what was chosen."""
    found = list(model.notes)
    for part in model.parts:
        if part.mean is not None and part.name in answer.laws:
            what = "constant" if part.mean == 0 else "factor"
            found.append(f"The formula of {part.name} has no {what} of its own for that reason.")
    return tuple(found)


def _shown(expr: sympy.Expr, answer: _Answer, settings: FreeSettings) -> str:
    """Write a formula for a function with its fitted numbers."""
    return shown(tidy(expr.xreplace(answer.numbers)), settings.digits)


def _words(study: _Study, state: str) -> str:
    """Say how formulas for the functions of an equation compare with curves, in bits."""
    found = []
    for part in study.model.parts:
        tried = sorted(study.tried.get(part.name, ()), key=lambda own: own[1].bits)
        if not study.model.contains(state, part) or not tried:
            continue
        settings = study.settings.free
        each = (
            f"{_shown(expr, own, settings)} {own.bits - before:+.1f}"
            for expr, own, before in tried[: settings.shown]
        )
        found.append(f"Bits more than those of a curve for {part.name}: {'; '.join(each)}.")
    return " ".join(found)


def _tested(
    found: Discovery, study: _Study, answer: _Answer, details: DiscoverySettings
) -> Discovery:
    """Give a discovery with its verdict; what contains a curve is no law."""
    alternatives = {s: _alternatives(study, answer, s, details) for s in study.model.equations}
    verdict = give_verdict(
        found.equations,
        carry(found.trajectories),
        found.inputs,
        front={s: own for s, own in found.front.items() if s not in study.model.equations},
        alternatives=alternatives,
        settings=details.verdict,
    )
    verdict = _with_curves(verdict, study.model, found.free)
    said = {s: _said(study, s, found.free) for s in study.model.equations}
    explanation = {
        s: explain(s, e, verdict.states[s], False, details.verdict)
        + said.get(s, found.explanation.get(s, ""))
        for s, e in found.equations.items()
    }
    return replace(found, verdict=verdict, explanation=explanation)


def _with_curves(verdict: Verdict, model: FreeModel, free: FreeParts) -> Verdict:
    """Take for an approximation what was a law but for its curves."""
    doubts = {}
    for state in model.equations:
        parts = [p for p in model.parts if model.contains(state, p) and free[p.name].is_curve]
        if names := " and ".join(f"{part.name}({part.of})" for part in parts):
            are = "is a curve" if len(parts) == 1 else "are curves"
            doubts[state] = f"{names} {are} and no formula."
    return doubt_laws(verdict, doubts)


def _said(study: _Study, state: str, free: FreeParts) -> str:
    """Say what the functions of an equation are, and what cannot be known."""
    own = [p.name for p in study.model.parts if study.model.contains(state, p)]
    words = []
    for name in own:
        part = free[name]
        best = next(iter(part.bits.items()), None)
        if part.is_curve and best is not None:
            words.append(
                f"{part.text}. The best formula, {best[0]}, takes {best[1]:.0f} bits more."
            )
        elif part.is_curve:
            words.append(f"{part.text}.")
        elif best is not None:
            words.append(f"{part.text} takes {-best[1]:.0f} bits less than a curve.")
    first = next(iter(study.model.equations))
    return "".join(f" {one}" for one in [*words, *(free.notes if state == first else ())])


def _alternatives(
    study: _Study, answer: _Answer, state: str, details: DiscoverySettings
) -> list[tuple[sympy.Expr, float]]:
    """Give equations with other formulas for a function, and the bits that they take more.

    One of more constants contains the answer, and one of the same values is the answer.
    """
    mesh, found = study.rows.mesh, []
    for part in study.model.parts:
        law = answer.laws.get(part.name)
        if law is None or not study.model.contains(state, part):
            continue
        x = {part.of: mesh.columns[part.of]}
        mine = [own for expr, own, _ in study.tried[part.name] if expr == law]
        if not mine:
            continue
        values = evaluate(law.xreplace(mine[0].numbers), x)
        spread = max(float(np.std(values)), 1e-300)
        for expr, own, _ in study.tried[part.name]:
            more = len(own.system.constants) > len(mine[0].system.constants)
            apart = evaluate(expr.xreplace(own.numbers), x) - values
            if more or not np.sqrt(np.mean(apart**2)) > details.verdict.different * spread:
                continue
            curves = dict(zip(own.system.parts, own.fit.curves, strict=True))
            functions = {p.symbol: c.function(sympy.Symbol(p.of)) for p, c in curves.items()}
            equation = own.system.equations[state].xreplace(own.numbers).xreplace(functions)
            found.append((tidy(equation), own.bits - mine[0].bits))
    return sorted(found, key=lambda pair: pair[1])[: study.settings.free.shown]
