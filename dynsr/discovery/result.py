"""Found: what a discovery gives back, to read, simulate, score, export and keep."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import (
    DATA,
    Hold,
    KeptData,
    Samples,
    System,
    Trajectory,
    carry,
    check_hold,
    check_replaceable,
    check_time_unit,
    choose_samples,
    cut_at_doses,
    decide_hold,
    digest,
    in_formulas,
    in_unit,
    read_kept,
    read_sums,
    sample_input,
    split_volume,
    take_trajectories,
    write_kept,
    write_own,
)
from dynsr.discovery.orders import form_of, write_lines
from dynsr.discovery.records import FORMAT, RECORD, read_discovery, write_discovery
from dynsr.discovery.summary import DataSummary, summarise
from dynsr.discovery.unmeasured import (
    coupling_of,
    describe_hidden,
    estimate_hidden,
    fit_starts,
    refuse_hidden,
)
from dynsr.engines import (
    DEFAULT_ENGINE,
    AbstractEngine,
    Branches,
    FixedPoint,
    Linearisation,
    find_engine,
    find_fixed_points,
    follow_parameter,
    linearise,
    refuse_idle,
)
from dynsr.errors import DynsrError, DynsrWarning, EngineError, EngineUnavailable, InputError, need
from dynsr.expression import (
    Units,
    arguments_of,
    bare_term,
    counting,
    evaluate,
    parse,
    read_own_bits,
    read_units,
    shown,
    to_latex,
    to_numpy,
    to_text,
    write_line,
    write_out,
)
from dynsr.fit import (
    FitSettings,
    Flow,
    Measurements,
    Noise,
    ParetoFront,
    ProfileSettings,
    StochasticFit,
    drives_of,
    is_noisy,
    measure_covariance,
    noise_of,
    polish,
    rmse,
    score_candidate,
)
from dynsr.jobs import RecordError, check_seed, from_plain, read_json, to_plain
from dynsr.parameters import (
    SUGGESTION,
    Constant,
    Delay,
    Delayed,
    DelaySettings,
    Diffusion,
    Ends,
    FreeParts,
    Identifiability,
    Law,
    Parameter,
    Parameters,
    ParametricSystem,
    Profile,
    Profiles,
    RunParameters,
    Study,
    Suggestion,
    SuggestionSettings,
    VarySettings,
    as_trajectories,
    check_values,
    draw_paths,
    find_names,
    fits,
    follow,
    identify,
    list_constants,
    list_parameters,
    measure_steps,
    name_by_role,
    name_constants,
    put_constants,
    put_names,
    put_off,
    put_values,
    read_constant,
    read_history,
    refuse_curves,
    rename,
    score_steps,
    suggest,
    with_data,
    write_answer,
)
from dynsr.selection import ComparisonSettings, forecast_error
from dynsr.verdict import (
    MORE_CONSTANTS,
    NOBODY,
    NOT_FOUND,
    ByState,
    Measured,
    Verdict,
    VerdictSettings,
    count_constants,
    explain,
    give_map_verdict,
    give_verdict,
    inputs_in,
    is_sampled,
    iterate,
    match_steps,
    measure_step_covariance,
    pair_rows,
    predict,
    predict_with_doses,
    score_map,
    write_map_latex,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure
    from rich.table import Table as RichTable

    from dynsr.discovery.hybrid import EquationModule, HybridModel

T = TypeVar("T")
# A measured column that differs from an expression by less than this share was written from it.
_ROUNDED = 1e-6
# Fields that a record has where there is something in them.
_OPTIONAL = ("ensemble", "parameter_names", "profiled", "delays", "volumes", "free", "diffusion")
# Fields of a discovery that have something of each state.
_OF_STATES = ("equations", "errors", "front", "explanation", "fitted", "details", "ensemble")


@dataclass(frozen=True)
class Inclusion:
    """One term of an ensemble of fits.

    Parameters
    ----------
    term : the term, as text.
    probability : the share of the fits that keep it.
    low, high : the ends of the 95 % interval of its coefficient in those fits.
    """

    term: str
    probability: float
    low: float
    high: float

    @property
    def text(self) -> str:
        """The term with its certainty, to be read."""
        return f"{self.term}: {self.probability:.0%}, {self.low:.4g} to {self.high:.4g}"


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Discovery:
    """The equations found for the states of a system, with everything that led to them.

    Parameters
    ----------
    equations : state -> right-hand side, state units per second.
    errors : state -> (value, standard error) of its constants in order.
    fitted : state -> what each of these constants was before it became a simple number; an
        interval lies around that.
    reach : standard errors that a 95 % interval reaches to either side of the fitted value.
    front : state -> all formulas found, from simple to accurate.
    explanation : state -> what is to be thought of this equation, in words.
    trajectories : the data; empty where they are not there.
    inputs : input name -> expression in ``t`` where it is known.
    settings : how it was found: methods, preset, seed, scheme, engines, and every setting.
    seconds : wall time.
    complete : False when Ctrl-C ended the searches and these are the best formulas so far.
    engine : what integrates the equations.
    verdict : whether the equations are a law, an approximation or not found; its level is "not
        judged" where they were not tested, as where the search was cut short.
    details : state -> how its formulas compared in bits, in words.
    ensemble : state -> the terms of an ensemble, where one was asked for.
    parameter_names : state -> the names of its constants in their order, where :meth:`rename` gave
        some; a sign before a name says that the constant is minus the parameter.
    profiled : state -> the 95 % interval of each constant, in the order of ``constants[state]``, by
        the profile likelihood where the one by the standard error is wrong, None elsewhere; inf is
        for a side that the data leave open.
    summary : what is known of the data where they are not there, as after :meth:`load`.
    by_run : the parameters that differ from run to run, see :meth:`vary`. Equations contain them as
        inputs that are constant in each run.
    delays : input -> the state, or other input, and the delay that it is, where ``discover`` was
        given ``delays``.
    volumes : name -> the volume by which amounts are divided, where ``discover`` was given
        ``doses={"c": "dose/V"}``; a :class:`Parameter` with its interval.
    free : the functions of one column that ``discover`` found in known equations, see
        :class:`FreeParts`. Equations contain those that stay curves as functions, ``f(x)``.
    diffusion : state -> the noise in its motion, where ``discover`` was asked for
        it or saw it. The equations are then the drift.

    >>> x = sympy.Symbol("x")
    >>> Discovery({"x": -2 * x}, {"x": ()}, {}, {}).simulate([1.0], [0.0, 1.0]).x[-1].round(4)
    array([0.1353])
    """

    equations: dict[str, sympy.Expr]
    errors: dict[str, tuple[tuple[float, float], ...]]
    front: dict[str, ParetoFront]
    explanation: dict[str, str]
    trajectories: tuple[Trajectory, ...] = ()
    inputs: Mapping[str, sympy.Expr] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    complete: bool = True
    engine: str | AbstractEngine = DEFAULT_ENGINE
    fitted: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    reach: float = 1.96
    verdict: Verdict = NOBODY
    details: Mapping[str, str] = field(default_factory=dict)
    ensemble: Mapping[str, tuple[Inclusion, ...]] = field(default_factory=dict)
    parameter_names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    profiled: Mapping[str, tuple[Ends | None, ...]] = field(default_factory=dict)
    summary: DataSummary | None = None
    by_run: RunParameters = RunParameters()
    delays: Mapping[str, Delay] = field(default_factory=dict)
    volumes: Mapping[str, Parameter] = field(default_factory=dict)
    free: FreeParts = FreeParts()
    diffusion: Mapping[str, Diffusion] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Have a name that is no state's answered with those there are."""
        for name in _OF_STATES:
            object.__setattr__(self, name, ByState(getattr(self, name)))

    @property
    def constants(self) -> dict[str, tuple[Constant, ...]]:
        """State -> its constants as its printed formula has them, each with its 95 % interval."""
        return ByState(
            {
                s: list_constants(
                    e,
                    self.errors.get(s, ()),
                    self.fitted.get(s),
                    self.reach,
                    self.profiled.get(s, ()),
                )
                for s, e in self.equations.items()
            }
        )

    @classmethod
    def from_system(
        cls,
        system: System | ParametricSystem,
        data: Trajectory | Sequence[Trajectory] = (),
    ) -> Discovery:
        """Take equations that are known as if they had been found: to score, report and start from.

        Parameters
        ----------
        system : the equations; parameters keep their names where each is alone.
        data : trajectories of its states, if there are any.

        The result has no verdict, and its parameters have no intervals.

        >>> from dynsr.data import find_system
        >>> known = Discovery.from_system(find_system("sir"))
        >>> known.parameters.numbers
        {'k1': 0.4, 'k2': 0.1}
        """
        if isinstance(system, System):
            system = ParametricSystem.of(system)
        runs = (data,) if isinstance(data, Trajectory) else tuple(data)
        equations = system.in_numbers
        settings = {"engine": DEFAULT_ENGINE, "seed": 0, "system": system.name}
        settings |= {"kind": "map"} if system.discrete else {}
        settings |= {"time_unit": system.time_unit} if system.time_unit else {}
        settings |= {"column_units": dict(system.units)} if system.units else {}
        return cls(
            equations,
            dict.fromkeys(equations, ()),
            {state: ParetoFront() for state in equations},
            {},
            runs,
            {name: expr for name, expr in system.inputs.items() if expr is not None},
            settings,
            parameter_names=find_names(system),
        )

    @property
    def parameters(self) -> Parameters:
        """The constants as parameters with names, k1, k2, ... unless :meth:`rename` gave others.

        Constants that are one, such as what leaves one state for another, are one parameter; a
        parameter has the sign that makes it positive.

        >>> x, y = sympy.symbols("x y")
        >>> found = Discovery({"x": -2 * x * y, "y": 2 * x * y - y / 4}, {}, {}, {})
        >>> found.parameters.numbers
        {'k1': 2.0, 'k2': 0.25}
        """
        names = self.constant_names
        units = {}
        if isinstance(self.settings.get("column_units"), Mapping) and not self.is_map:
            with suppress(InputError):  # none that pint, which may be absent, can read
                named, signed = put_names(self.equations, names)
                units = self._units().of_symbols(named, signed)
        return list_parameters(self.equations, names, self.constants, units)

    @property
    def system(self) -> ParametricSystem:
        """The equations with named parameters, from the start and over the times of the data.

        >>> x = sympy.Symbol("x")
        >>> Discovery({"x": -2 * x}, {"x": ()}, {}, {}).system
        x' = -k1*x, k1 = 2
        """
        given = self.settings.get("column_units")
        bare = ParametricSystem(
            put_names(self.equations, self.constant_names)[0],
            self.parameters,
            {name: self.inputs.get(name) for name in arguments_of(self.equations)},
            time_unit=self.time_unit,
            units={str(k): str(v) for k, v in given.items()} if isinstance(given, Mapping) else {},
            discrete=self.is_map,
        )
        data = self.data_summary
        if data is None:
            return bare
        return replace(bare, x0=data.start, span=data.span, step=data.step)

    @property
    def data_summary(self) -> DataSummary | None:
        """Where the data begin, how far they go, and how widely they spread; None if unknown."""
        if not self.trajectories:
            return self.summary
        try:
            return summarise(self.carried, tuple(self.equations))
        except InputError:  # a state of which nothing is known at the first time
            return None

    @cached_property
    def constant_names(self) -> Mapping[str, tuple[str, ...]]:
        """State -> the names of its constants in the order of :attr:`constants`.

        A minus before a name says that the constant is minus the parameter.

        >>> x = sympy.Symbol("x")
        >>> Discovery({"x": -2 * x}, {"x": ()}, {}, {}).constant_names
        {'x': ('-k1',)}
        """
        # Names of a damaged record or of other equations are none.
        own = self.parameter_names
        return own if own and fits(self.equations, own) else name_constants(self.equations)

    def rename(self, names: Mapping[str, str] | Literal["role"]) -> Discovery:
        """Give parameters other names.

        Parameters
        ----------
        names : name -> the new one; or "role" for names that say what each does, such as
            ``x_growth``, ``x_decay``, ``x_from_y``, ``x_by_x_y``.

        Raises InputError when there is no such parameter, or a new name is another's already.

        >>> x, y = sympy.symbols("x y")
        >>> found = Discovery({"x": 3 * x - x * y}, {}, {}, {})
        >>> found.rename({"k2": "birth"}).system
        x' = birth*x - k1*x*y, k1 = 1, birth = 3
        >>> list(found.rename("role").parameters)
        ['x_by_x_y', 'x_growth']
        """
        own = self.constant_names
        if isinstance(names, str):
            if names != "role":
                raise InputError(f'names {names!r} must be "role", or old name -> new name')
            names = name_by_role(self.equations, own)
        columns = [name for run in self.trajectories[:1] for name in run.names]
        taken = [*self.equations, *arguments_of(self.equations), *columns, "t"]
        return replace(self, parameter_names=rename(own, names, taken))

    def with_parameters(self, **values: float) -> Discovery:
        """Put other numbers in the place of parameters, to see what they do.

        Parameters
        ----------
        values : parameter -> its value; other parameters stay as they are.

        The result has no verdict and no errors. Raises InputError when there is no such parameter
        or a value is no finite number.

        >>> x, y = sympy.symbols("x y")
        >>> found = Discovery({"x": -2 * x * y, "y": 2 * x * y}, {}, {}, {})
        >>> found.with_parameters(k1=5.0).equations
        {'x': -5.0*x*y, 'y': 5.0*x*y}
        """
        names = self.constant_names
        check_values(values, dict.fromkeys(self.parameters))
        equations, left = put_values(self.equations, names, values)
        return self._with_others(equations, left)

    def _with_others(
        self, equations: Mapping[str, sympy.Expr], names: Mapping[str, tuple[str, ...]]
    ) -> Discovery:
        """Put equations with other numbers in the place of those found; nobody has tested them."""
        return replace(
            self,
            free=self.free.only_curves,
            equations=dict(equations),
            errors={},
            fitted={},
            profiled={},
            summary=self._changed(),
            verdict=NOBODY,
            explanation={},
            parameter_names=names,
        )

    def covariance(self) -> pd.DataFrame:
        """Give the covariance of the parameters as a frame of pandas, by their names.

        Its diagonal are the squares of the standard errors of :attr:`parameters`; inf where the
        data do not determine them. A saved discovery has it too. Raises InputError when neither the
        data nor it are there.

        >>> t = np.linspace(0.0, 1.0, 51)
        >>> run = Trajectory(t, np.exp(-2 * t)[:, None] + 1e-3 * np.cos(40 * t)[:, None], ("x",))
        >>> x = sympy.Symbol("x")
        >>> found = Discovery({"x": -2 * x}, {"x": ((-2.0, 0.01),)}, {}, {}, (run,))
        >>> found.covariance().loc["k1", "k1"].round(6).item()
        0.0001
        """
        import pandas as pd

        names = list(self.parameters)
        found = self._covariance()
        if len(found) != len(names):
            raise InputError("the data are not here; discover again before asking for covariances")
        return pd.DataFrame(found, index=names, columns=names)

    def _covariance(self) -> np.ndarray:
        """Give the (p, p) covariance of the parameters; nothing where it is not known."""
        if not self.trajectories:
            return np.array(self.summary.covariance if self.summary else ())
        named, _ = put_names(self.equations, self.constant_names)
        parameters, fixed = self.parameters, self._fixed
        free = [i for i, name in enumerate(parameters) if sympy.Symbol(name) not in fixed]
        named = {s: e.xreplace(fixed) for s, e in named.items()}
        symbols = tuple(sympy.Symbol(name) for name in np.array([*parameters])[free])
        values = [list(parameters.numbers.values())[i] for i in free]
        if self.is_map:
            spread = measure_step_covariance(named, symbols, values, self.trajectories)
        else:
            used = {str(s) for e in named.values() for s in e.free_symbols} - {*parameters, *named}
            driven = tuple(sorted(used - {"t"}))
            flow = Flow(named, driven, symbols)
            spread = measure_covariance(flow, values, self.carried, self.inputs)
        errors = np.array([parameter.error for parameter in parameters.values()])
        if fixed:
            whole = np.zeros((len(errors), len(errors)))
            whole[np.ix_(free, free)] = spread
            spread = whole
        own = np.sqrt(np.diag(spread))
        known = np.isfinite(errors) & np.isfinite(own) & (own > 0)
        found = np.full(spread.shape, np.inf)
        place = np.ix_(known, known)
        found[place] = spread[place] * np.outer(
            errors[known] / own[known], errors[known] / own[known]
        )
        # What was chosen is known.
        chosen = [i for i in range(len(errors)) if i not in free]
        found[chosen] = found[:, chosen] = 0.0
        found[np.diag_indices(len(errors))] = errors**2
        return found

    def _summarise(self) -> DataSummary | None:
        """Give what a file keeps of the data, with the covariance of what was tested."""
        data = self.data_summary
        if data is None or not self.trajectories or not self.verdict.tested:
            return data
        # What cannot be computed is not kept; the equations are.
        with suppress(DynsrError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            return replace(data, covariance=tuple(map(tuple, self._covariance().tolist())))
        return data

    def _changed(self) -> DataSummary | None:
        """Give what stays known of the data when the constants are others."""
        return self.summary and replace(self.summary, covariance=())

    def profile(self, which: str | tuple[str, int], data: Any = None) -> Profile:
        """Give the profile likelihood of one constant: what the data say of it.

        The constant is fixed at the values of a grid, and the other constants and the states are
        fitted again at each value (Raue et al. 2009). Where the profile is no parabola, the
        interval of the standard error is wrong, and ``constants`` has that of the profile.

        Parameters
        ----------
        which : a name in ``parameters``, such as "k1"; or a state and the place of a constant in
            ``constants[state]``, such as ``("x", 0)`` or "x:0". Constants that are one parameter
            are fixed together by its name, and one by one by their place.
        data : what :func:`dynsr.discover` takes; the data of the discovery by default.

        Raises InputError when there is no such constant or no data, the equations are a map, or
        they cannot be fitted along the data.

        >>> import dynsr
        >>> t = np.linspace(0, 5, 60)
        >>> x = np.exp(-0.5 * t) + 0.02 * np.random.default_rng(0).normal(size=60)
        >>> found = dynsr.discover((t, x[:, None]), preset="quick", jobs=1)
        >>> own = found.profile("k1")
        >>> own.low < 0.5 < own.high
        True
        """
        own, asked = self._profiles(data), read_constant(which)
        return (
            own.named(asked, self.constant_names) if isinstance(asked, str) else own.profile(*asked)
        )

    def profiles(self, data: Any = None) -> tuple[Profile, ...]:
        """Give the profile likelihood of every constant, in the order of ``constants``.

        Parameters
        ----------
        data : what :func:`dynsr.discover` takes; the data of the discovery by default.

        Raises InputError where :meth:`profile` does.
        """
        own = self._profiles(data)
        return tuple(own.profile(state, index) for state, index, _ in own.places)

    def identifiability(self, data: Any = None) -> Identifiability:
        """Say which parameters data can determine at all, and which these data do.

        The first is a matter of the equations alone: a*b*x has one parameter where it seems to have
        two (:func:`dynsr.identifiability`). The second is that of the joint fit: far below
        saturation a*x/(b + x) determines a/b alone.

        Parameters
        ----------
        data : what :func:`dynsr.discover` takes; the data of the discovery by default. Without any
            the equations alone are asked.

        Raises InputError when the equations are a map, have no parameter, or cannot be fitted along
        the data.

        >>> x = sympy.Symbol("x")
        >>> Discovery({"x": -2 * x / (3 * x + 5)}, {}, {}, {}).identifiability()
        Exact data of this kind determine every parameter.
        """
        self._refuse("identifiability", "identifiability is that of formulas")
        system = self.system
        if not system.parameters:
            raise InputError("the equations have no parameters")
        rhs = dict(system.equations)
        rhs = {s: e.xreplace(self._fixed) for s, e in rhs.items()}
        outputs = {s: sympy.Symbol(s) for s in rhs if s not in self.hidden}
        names = [name for name in system.parameters if sympy.Symbol(name) not in self._fixed]
        drives = arguments_of(self.equations)
        structure = identify(rhs, outputs, names, drives, 0)
        if data is None and not self.trajectories:
            return structure
        profiling, every, _ = self._profiles(data).tied(self.constant_names)
        return with_data(structure, every, profiling)

    def suggest(
        self,
        data: Any = None,
        *,
        rows: int | None = None,
        span: float | None = None,
        seed: int = 0,
        settings: SuggestionSettings = SUGGESTION,
    ) -> Suggestion:
        """Give the next experiment: the start and the inputs that give most information.

        Where other formulas explain the data nearly as well, it is where their forecasts differ
        most from the answer's, within the uncertainty of their constants. Otherwise it is where the
        constants are determined best.

        Parameters
        ----------
        data : what :func:`dynsr.discover` takes; the data of the discovery by default.
        rows, span : rows of the experiment, and its time from first to last; those of the longest
            run by default.
        seed : the starts that are tried come from it.
        settings : the numbers that decide.

        Raises InputError when the equations are a map, a state has no equation, there are no data,
        or the equations cannot be fitted along them.

        >>> import dynsr
        >>> t = np.linspace(0, 5, 60)
        >>> x = np.exp(-0.5 * t) + 0.02 * np.random.default_rng(0).normal(size=60)
        >>> found = dynsr.discover((t, x[:, None]), preset="quick", jobs=1)
        >>> found.suggest().best.bits > 0
        True
        """
        formulas = "experiments are suggested for formulas"
        self._refuse("an experiment", formulas, "an experiment starts")
        if rows is not None and rows < 2:
            raise InputError(f"an experiment of {rows} rows shows no motion; give 2 or more")
        if span is not None and not (np.isfinite(span) and span > 0):
            raise InputError(f"a span of {span} is no time; give a number above 0")
        form = form_of(self.settings)
        prepared = form.prepare(self._runs(data))
        self._need_columns(prepared)
        if lacking := [s for s in prepared[0].states if s not in self.equations]:
            raise InputError(
                f"{lacking[0]!r} has no equation; an experiment needs one of each state"
            )
        most = self._settings(ComparisonSettings, "selection", "comparison").rows
        measured = Measurements.of(prepared, self._known_inputs(prepared), most, form.known)
        rng = np.random.default_rng(check_seed(seed))
        others = {s: self._alternatives(s) for s in self.equations}
        return suggest(self.equations, others, measured, rng, rows, span, settings)

    def _alternatives(self, state: str) -> list[sympy.Expr]:
        """Other formulas of a state: those that the verdict names, then those of the front."""
        judged = self.verdict.states
        most = self._settings(VerdictSettings, "verdict").alternatives
        named = judged[state].alternatives[:most] if state in judged else ()
        allowed = count_constants(self.equations[state]) + MORE_CONSTANTS
        front = sorted(self.front.get(state, ()), key=lambda c: c.loss)
        near = [c.expr for c in front if count_constants(c.expr) <= allowed]
        return [*(parse(alternative.equation) for alternative in named), *near]

    def _profiles(self, data: Any = None, settings: ProfileSettings | None = None) -> Profiles:
        self._refuse("profiles", "profiles are those of formulas")
        if self.by_run.constants:
            raise InputError(
                "parameters differ from run to run; ask for_run(NAME) for the profiles of one run"
            )
        form, runs = form_of(self.settings), self._runs(data)
        prepared = form.prepare(runs)
        self._need_columns(prepared)
        settings = settings or self._settings(ProfileSettings, "profile")
        rows = self._settings(ComparisonSettings, "selection", "comparison").rows
        known = self._known_inputs(prepared)
        return Profiles.of(
            self.equations, prepared, known, form.known, rows, settings, [*self.hidden.values()]
        )

    def with_profiles(self, settings: ProfileSettings | None = None) -> Discovery:
        """Take intervals from profile likelihoods where those by standard errors are wrong.

        Wald's interval is kept where the chi-square at both of its ends, all other constants fitted
        again, has risen by about as much as on a parabola.

        Parameters
        ----------
        settings : what "about" is; by default those of the discovery.

        Raises InputError where :meth:`profile` does.
        """
        return replace(self, profiled=self._profiles(None, settings).ends())

    def vary(
        self,
        which: bool | str | Sequence[str] = True,
        *,
        others: Sequence[Discovery] = (),
        settings: VarySettings | None = None,
    ) -> Discovery:
        """Let constants differ from run to run, and fit all of them again, together.

        A constant that differs becomes an input of the equations that is constant in each run;
        :attr:`by_run` has its values with 95 % intervals. Where it follows a known input of the
        runs, or is a multiple of another constant, that function takes its place, and
        ``by_run.follows`` says so.

        Parameters
        ----------
        which : True lets the description length decide for each constant whether it is shared,
            differs with a label or known input of the runs, or from run to run. A state, or
            several, does so for the constants of their equations. Names of parameters are those
            that differ from run to run: all others are shared.
        others : discoveries of the same states whose equations are tried too.
        settings : the numbers that decide; those of the discovery by default.

        Where no constant differs, the result is this discovery. Raises InputError when the data are
        not here, there is one run, one is too short, the equations are a map or cannot be fitted,
        or there is no such parameter.

        >>> x, t = sympy.Symbol("x"), np.linspace(0.0, 2.0, 41)
        >>> runs = tuple(Trajectory(t, np.exp(-k * t)[:, None], ("x",)) for k in (0.5, 0.9))
        >>> found = Discovery({"x": -0.7 * x}, {}, {}, {}, runs)
        >>> found.vary().by_run
        run  k1   95 % interval
        1    0.5  0.4999... to 0.5000...
        2    0.9  0.8999... to 0.9000...
        """
        differ = "constants differ from run to run"
        what = "constants that differ from run to run"
        self._refuse(what, f"{differ} in formulas", differ, "its constants do not differ")
        if not self.trajectories:
            raise InputError("the data are not here; discover again before constants can differ")
        if self.by_run.constants:
            raise InputError("constants differ already; vary the discovery from before that")
        form = form_of(self.settings)
        runs = form.prepare(self.carried)
        known = self._known_inputs(runs)
        comparison = self._settings(ComparisonSettings, "selection", "comparison")
        own = settings or self._settings(VarySettings, "vary")
        names = self.parameters
        asked = [which] if isinstance(which, str) else which
        chosen = [] if isinstance(asked, bool) else list(asked)
        states = [name for name in chosen if name in self.equations]
        if (mixed := [n for n in chosen if n not in self.equations and n not in names]) or (
            states and len(states) < len(chosen)
        ):
            raise InputError(
                f"{(mixed or chosen)[0]!r} cannot differ; give parameters ({', '.join(names)}), or "
                f"states ({', '.join(self.equations)})"
            )
        study = Study.of(
            runs,
            known,
            form.known,
            tuple(self.equations),
            states or tuple(self.equations),
            comparison,
            own,
        )
        if chosen and not states:
            law = study.by_hand(self.equations, self.constant_names, chosen)
        elif asked:
            law = study.find([f.equations for f in (self, *others)])
            law = law and study.explain(law)
        else:
            return self
        if law is None:
            raise InputError("the equations cannot be fitted along every run; their slopes diverge")
        if not law.mixed.varied and not law.said and not others:
            return self
        return self._vary_as(study, law)

    def _vary_as(self, study: Study, law: Law) -> Discovery:
        """Give the discovery of a law whose constants differ."""
        labels = [str(run.origin.get("name", i)) for i, run in enumerate(self.trajectories, 1)]
        names = (
            labels if len(set(labels)) == len(labels) else list(map(str, range(1, len(labels) + 1)))
        )
        answer = write_answer(study, law, names)
        columns = {n: [p.value for p in own] for n, own in answer.by_run.constants.items()}
        runs = [
            run.with_inputs({name: values[i] for name, values in columns.items()})
            for i, run in enumerate(self.trajectories)
        ]
        judging = self._settings(VerdictSettings, "verdict")
        prepared = form_of(self.settings).prepare(carry(runs))
        noise = study.noise if is_noisy(prepared) else None
        known = self._known_inputs(runs)
        verdict = give_verdict(
            answer.equations, prepared, known, noise=noise, settings=judging, by_run=tuple(columns)
        )
        said = "".join(f" {words}" for words in answer.by_run.sentences)
        return replace(
            self,
            equations=answer.equations,
            errors=answer.errors,
            front={state: ParetoFront() for state in answer.equations},
            trajectories=tuple(run.as_measured() for run in runs),
            fitted={s: tuple(v for v, _ in pairs) for s, pairs in answer.errors.items()},
            reach=answer.reach,
            profiled={},
            ensemble={},
            details={},
            summary=None,
            verdict=verdict,
            explanation={
                s: explain(s, e, verdict.states[s], False, judging) + said
                for s, e in answer.equations.items()
            },
            parameter_names=answer.names,
            by_run=answer.by_run,
        )

    def for_run(self, run: str | int) -> Discovery:
        """Give the equations of one run, with numbers for the parameters that differ.

        Parameters
        ----------
        run : its name in :attr:`by_run`, or its place from 0.

        Raises InputError when there is no such run.

        >>> x, t = sympy.Symbol("x"), np.linspace(0.0, 2.0, 41)
        >>> runs = tuple(Trajectory(t, np.exp(-k * t)[:, None], ("x",)) for k in (0.5, 0.9))
        >>> found = Discovery({"x": -0.7 * x}, {}, {}, {}, runs).vary()
        >>> round(found.for_run(1).parameters["k1"].value, 6)
        0.9
        """
        place = self.by_run.place(run)
        put = {sympy.Symbol(n): sympy.Float(v) for n, v in self.by_run.numbers(place).items()}
        own = [values[place] for values in self.by_run.constants.values()]
        pairs = tuple((sign * p.value, p.error) for p in own for sign in (1.0, -1.0))
        return replace(
            self,
            equations={s: e.xreplace(put) for s, e in self.equations.items()},
            errors={s: (*known, *pairs) for s, known in self.errors.items()},
            fitted={},
            front={state: ParetoFront() for state in self.equations},
            trajectories=self.trajectories[place : place + 1],
            summary=None,
            by_run=RunParameters(),
            parameter_names={},
        )

    @property
    def constant_units(self) -> Mapping[str, tuple[str, ...]]:
        """State -> the units of its constants in the order of :attr:`constants`, "" if unknown."""
        parameters = self.parameters
        return {
            state: tuple(parameters[name.removeprefix("-")].unit for name in names)
            for state, names in self.constant_names.items()
        }

    def coefficient_units(self) -> dict[str, dict[str, str]]:
        """State -> term -> the unit of its coefficient: :attr:`constant_units` has these now.

        Raises InputError when there are none, MissingExtra without pint.
        """
        warnings.warn(
            "Discovery.coefficient_units() ends next release; constant_units has the units of all "
            "constants, and parameters shows them",
            DeprecationWarning,
            stacklevel=3,
        )
        units = self._units()
        return {
            state: {
                shown(term): units.of_coefficient(state, term)
                for term in map(bare_term, sympy.Add.make_args(expr))
            }
            for state, expr in self.equations.items()
        }

    def unit_faults(self) -> dict[str, str]:
        """State -> what its equation does that its units do not allow; nothing where all is well.

        Raises InputError when no units were given, MissingExtra without pint.
        """
        units = self._units()
        found = {state: units.fault(expr) for state, expr in self.equations.items()}
        return {state: fault for state, fault in found.items() if fault}

    def _units(self) -> Units:
        given = self.settings.get("column_units")
        if not isinstance(given, Mapping) or not given:
            raise InputError('the columns have no units; give discover units={"x": "m", "t": "s"}')
        return read_units(given)

    def with_choice(self, state: str, k: int) -> Discovery:
        """Adopt another formula of a state's front, fit all constants again and test it.

        Parameters
        ----------
        state : whose equation is to be another one.
        k : its place in ``front[state]``, simplest first; -1 is the most accurate.

        Raises InputError when the data are not there, or the front has no such formula.
        """
        if not self.trajectories:
            raise InputError("the data are not here; discover again before choosing otherwise")
        self.trajectories[0].index(state)
        if state in self.free.states:
            raise InputError(
                f"the equation of {state} was given; write another formula for its free function "
                "in known, and discover again"
            )
        front = list(self.front.get(state) or ())
        if not -len(front) <= k < len(front):
            raise InputError(f"the front of {state} has {len(front)} formulas; k = {k} is none")
        given = parse(str(self.settings.get("known", {}).get(state, "0")))
        with counting(self.own_bits):
            return self._adopt({**self.equations, state: given + front[k].expr}, state)

    @property
    def own_bits(self) -> dict[str, float]:
        """Function or operator -> the bits of the user's own that each of it was counted with."""
        return read_own_bits(self.settings.get("complexity"))

    def _adopt(self, chosen: dict[str, sympy.Expr], state: str) -> Discovery:
        self._refuse_noise("another formula")
        judging = self._settings(VerdictSettings, "verdict")
        fitting = self._settings(FitSettings, "selection", "fit")
        if self.is_map:
            pairs = {s: pair_rows(self.trajectories, s) for s in chosen}
            match = match_steps(chosen, pairs, self.reach)
            verdict = give_map_verdict(chosen, self.trajectories, self.front, judging)
        else:
            slopes = self._slopes_of(chosen)
            match = polish(chosen, self.carried, self.inputs, *slopes, fitting)
            verdict = give_verdict(
                match.exprs,
                self.carried,
                self.inputs,
                front=self.front,
                settings=judging,
                by_run=tuple(self.by_run.constants),
            )
        origin = {s: f" {self._origin(s)}" for s in chosen} | {state: " Chosen by hand."}
        return replace(
            self,
            equations=match.exprs,
            errors=match.errors,
            fitted=match.fitted,
            reach=match.reach,
            profiled={},
            summary=self._changed(),
            verdict=verdict,
            explanation={
                s: explain(s, e, verdict.states[s], self.is_map, judging) + origin[s]
                for s, e in match.exprs.items()
            },
            parameter_names={},
        )

    def _settings(self, kind: type[T], *path: str) -> T:
        """Give settings as they are in the record; the usual ones where it has none of this kind.

        An older version may have had other fields.
        """
        found = self.settings.get("details", {})
        try:
            for name in path:
                found = found[name]
            settings: T = from_plain(kind, found)
        except (KeyError, TypeError, ValueError):
            return kind()
        return settings

    def with_constants(self, values: Mapping[str, Sequence[float]]) -> Discovery:
        """Put other numbers in the place of constants, to see what they do.

        Parameters
        ----------
        values : state -> its constants in the order of ``constants[state]``; the equations of
            other states stay as they are.

        The result has no verdict and no errors. Raises InputError when a state has no equation or
        another number of constants.

        >>> x = sympy.Symbol("x")
        >>> Discovery({"x": -2 * x}, {"x": ()}, {}, {}).with_constants({"x": [-3.0]})
        No verdict.
        x' = -3*x
        """
        if unknown := [state for state in values if state not in self.equations]:
            raise InputError(
                f"{unknown[0]!r} has no equation; those that have: {', '.join(self.equations)}"
            )
        changed = {s: put_constants(self.equations[s], own) for s, own in values.items()}
        return self._with_others({**self.equations, **changed}, {})

    def _origin(self, state: str) -> str:
        _, found, rest = self.explanation.get(state, "").partition("Found by ")
        return found + rest

    def _slopes_of(
        self, equations: Mapping[str, sympy.Expr]
    ) -> tuple[dict[str, Samples], dict[str, Noise]]:
        samples = {s: choose_samples(list(self.trajectories), s) for s in equations}
        noise = {
            s: noise_of([*self.front[s], score_candidate(e, samples[s])], samples[s])
            for s, e in equations.items()
        }
        return samples, noise

    @property
    def hidden(self) -> dict[str, sympy.Expr]:
        """State that nobody measured -> the term with which it enters; its factor was chosen."""
        found = self.settings.get("hidden")
        # A saved discovery may come from anyone.
        pairs = found.items() if isinstance(found, Mapping) else ()
        return {n: coupling_of(n, parse(str(text)), self.equations).term for n, text in pairs}

    @property
    def measured(self) -> tuple[Trajectory, ...]:
        """The data of the states that were measured."""
        return tuple(
            run.of_states([state for state in run.states if state not in self.hidden])
            for run in self.trajectories
        )

    @property
    def hidden_notes(self) -> dict[str, str]:
        """Hidden state -> what cannot be known of it, and what the data determine."""
        pairs = self.hidden.items()
        return {name: describe_hidden(name, term, self.equations) for name, term in pairs}

    @property
    def _fixed(self) -> dict[sympy.Symbol, sympy.Expr]:
        """Parameters that are the factor of a hidden state, which is chosen, with their values."""
        pairs = self.parameters.items() if self.hidden else ()
        return {sympy.Symbol(n): sympy.Float(p.value) for n, p in pairs if p.error == 0}

    @property
    def time_unit(self) -> str:
        """The unit of the times, such as "days"; "" where the data did not say it."""
        # A comment of exported code holds it, and a saved discovery may come from anyone.
        return check_time_unit(self.settings.get("time_unit", ""))

    @property
    def is_map(self) -> bool:
        """Whether the equations are a map ``x[n+1] = f(x[n])`` instead of slopes."""
        return form_of(self.settings).discrete

    def simulate(
        self,
        x0: Mapping[str, float] | Sequence[float] | np.ndarray | None = None,
        t: Sequence[float] | np.ndarray | None = None,
        inputs: Mapping[str, Any] | None = None,
        engine: str | AbstractEngine | None = None,
        hold: Mapping[str, str] | str | None = None,
        doses: Mapping[str, Any] | None = None,
        history: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> Trajectory:
        """Integrate the equations; by default from the start and at the times of the data.

        A map is iterated, once for every time after the first. Equations with delays are followed
        by the method of steps. A delayed input needs its values before the first time: an
        expression and a function have them, and before values at the times are those of the data.

        Parameters
        ----------
        x0 : (k,) start states in the order of the equations, or state -> its start.
        t : (n,) increasing times, in the unit of the data's.
        inputs : name -> expression in ``t``, function of one time, or (n,) values at the times; by
            default those of the data.
        engine : "embedded", "julia" or an engine; the discovery's own by default. A map has none.
        hold : input -> what it does between the values that are given, "previous", "linear" or
            "smooth", or one word for all; by default what it did in the data.
        doses : state -> (n,) amounts that are given right after each time; none by default. The
            state jumps by them, divided by its volume where the discovery has one.
        history : of equations with delays, the states (k, n) at n times before the first; by
            default those of the data, or ``x0`` at all times where that is given.

        Raises InputError when something is missing or a map is given an engine other than the
        embedded one, EngineUnavailable when the engine is absent, EngineError when the solution
        diverges.
        """
        start, times = self._from(x0, t)
        if self.delays:
            if hold is not None or doses is not None:
                raise InputError("equations with delays are followed without hold and doses")
            given = self.inputs_of() | self._with_delayed(inputs or {}, times)
            return self._follow(start, times, given, engine, history)
        if history is not None:
            raise InputError("the equations have no delays; leave history out")
        start = self._first if start is None else start
        if self.is_map:
            refuse_idle(engine, "a map is iterated")
            if hold is not None or doses is not None:
                raise InputError("a map has no time between rows; leave hold and doses out")
            own = inputs_in(self.carried[0], self.equations) if t is None else self.inputs
            return iterate(self.equations, start, times, {**own, **(inputs or {})})
        given = self.inputs_of() | self._as_held(inputs or {}, times)
        chosen = engine or self.engine
        jumps = {s: self._jumps(s, amounts) for s, amounts in (doses or {}).items()}
        return predict_with_doses(self.equations, start, times, jumps, given, chosen, hold)

    def _from(
        self,
        x0: Mapping[str, float] | Sequence[float] | np.ndarray | None,
        t: Sequence[float] | np.ndarray | None,
    ) -> tuple[Sequence[float] | np.ndarray | None, np.ndarray]:
        """Give a start in the order of the equations, None for that of the data, and the times."""
        if (x0 is None or t is None) and not self.trajectories:
            raise InputError("the data are not here; give x0 and t")
        start = self._in_order(x0) if isinstance(x0, Mapping) else x0
        return start, self.trajectories[0].t if t is None else np.asarray(t, dtype=float)

    @property
    def _first(self) -> np.ndarray:
        """(k,) where the equations begin in the first run."""
        found: np.ndarray = self.carried[0].x[0][self._positions()]
        return found

    def _in_order(self, start: Mapping[str, float]) -> list[float]:
        """Give start states by name, as the data or the equations call them, in order."""
        start = in_formulas(start, self.trajectories[0]) if self.trajectories else start
        if set(start) != set(self.equations):
            raise InputError(
                f"x0 names {', '.join(map(str, start)) or 'nothing'}; give a start for each of: "
                f"{', '.join(self.equations)}"
            )
        return [float(start[state]) for state in self.equations]

    def simulate_paths(
        self,
        count: int = 100,
        x0: Mapping[str, float] | Sequence[float] | np.ndarray | None = None,
        t: Sequence[float] | np.ndarray | None = None,
        inputs: Mapping[str, Any] | None = None,
        seed: int = 0,
        parts: int = 20,
    ) -> tuple[Trajectory, ...]:
        """Draw paths of equations with noise in the motion (Euler and Maruyama).

        :meth:`simulate` follows the drift alone.

        Parameters
        ----------
        count : how many.
        x0, t : the start (k,), or state -> its start, and the times (n,); by default those of the
            data.
        inputs : input name -> expression in ``t``; by default those of the data.
        seed : the source of chance.
        parts : steps of a path between two times.

        Raises InputError when the equations have no such noise or something is missing, EngineError
        when a path leaves the finite numbers.

        >>> from dynsr.parameters.diffusion import DiffusionTerm
        >>> noise = {"x": Diffusion((DiffusionTerm("1", 0.5),), ("x",))}
        >>> x = sympy.Symbol("x")
        >>> found = Discovery({"x": -2 * x}, {"x": ()}, {}, {}, diffusion=noise)
        >>> paths = found.simulate_paths(1000, [1.0], [0.0, 1.0, 2.0])
        >>> [round(float(np.std([path.x[i, 0] for path in paths])), 1) for i in range(3)]
        [0.0, 0.4, 0.4]
        """
        if not self.diffusion:
            raise InputError(
                "these equations have no noise in the motion; discover with stochastic=True"
            )
        begin, times = self._from(x0, t)
        if count < 1:
            raise InputError(f"count must be 1 or more; it is {count}")
        start = np.asarray(self._first if begin is None else begin, dtype=float)
        if start.shape != (len(self.equations),):
            raise InputError(f"x0 has shape {start.shape}; give {len(self.equations)} start states")
        names = arguments_of(self.equations | {s: d.expr for s, d in self.diffusion.items()})
        names = tuple(name for name in names if name not in self.equations)
        exact = {n: parse(e, ["t"]) for n, e in {**self.inputs, **(inputs or {})}.items()}
        runs = self.carried[:1] or (Trajectory(times, np.zeros((len(times), 1)), ("t_",)),)
        (driven,) = drives_of(names, runs, exact)
        rng = np.random.default_rng(check_seed(seed))
        paths = draw_paths(self.equations, self.diffusion, start, times, driven, count, rng, parts)
        return as_trajectories(paths, times, tuple(self.equations))

    def path_and_band(
        self, run: Trajectory | None = None, count: int = 200, share: float = 0.95
    ) -> tuple[Trajectory, dict[str, tuple[np.ndarray, np.ndarray]]]:
        """Give a path with noise in the motion, and the ends (n,) of the band of most of them.

        Parameters
        ----------
        run : whose start and times they have; by default the first of the data.
        count : how many paths the band is made of.
        share : of the paths that the band contains.
        """
        source = run or self.carried[0]
        start = [source.x[0, source.index(state)] for state in self.equations]
        paths = self.simulate_paths(count, start, source.t, parts=4)
        low, high = np.quantile(
            np.array([path.x for path in paths]), [(1 - share) / 2, (1 + share) / 2], axis=0
        )
        return paths[0], {s: (low[:, i], high[:, i]) for i, s in enumerate(self.equations)}

    def _refuse(
        self, what: str, formulas: str, hidden: str = "", of_map: str = "its errors are of one step"
    ) -> None:
        """Raise InputError where no formulas are fitted to the states, or a hidden one is no use.

        The words are what is asked for, and what is said of formulas, hidden states and maps.
        """
        if self.is_map:
            raise InputError(f"a map has no joint fit of its states; {of_map}")
        if hidden:
            refuse_hidden(self.hidden, hidden)
        refuse_curves(self.free, formulas)
        self._refuse_noise(what)

    def _refuse_noise(self, what: str) -> None:
        """Raise InputError for what a joint fit says, where the motion has noise."""
        if self.diffusion:
            raise InputError(
                f"{what}: the motion has noise, so no curve is fitted to all rows; found.constants "
                "has the intervals of the drift"
            )

    @property
    def noise_notes(self) -> dict[str, str]:
        """State -> what is known of the noise in its motion, in words."""
        return {state: own.text(state) for state, own in self.diffusion.items()}

    @property
    def volume_notes(self) -> list[str]:
        """The volumes by which amounts are divided, with their 95 % intervals, in words."""
        return [
            f"{own.name} = {own.value:.6g} (95 %: {own.interval_text}), {own.of}."
            for own in self.volumes.values()
        ]

    def _jumps(self, state: str, amounts: Any) -> Any:
        """Give what a state jumps by: amounts by its volume."""
        _, volume = split_volume(self.doses.get(state, ""))
        if isinstance(volume, str):
            if volume not in self.volumes:
                raise InputError(f"the volume {volume!r} of {state!r} is not known; discover again")
            volume = self.volumes[volume].value
        return amounts if volume == 1.0 or callable(amounts) else np.asarray(amounts) / volume

    def _follow(
        self,
        x0: Sequence[float] | np.ndarray | None,
        times: np.ndarray,
        inputs: Mapping[str, Any],
        engine: str | AbstractEngine | None,
        history: Callable[[np.ndarray], np.ndarray] | None,
        run: Trajectory | None = None,
    ) -> Trajectory:
        """Follow equations with delays from a history, that of a run by default."""
        count = len(self.equations)
        if history is None and x0 is None:
            history = read_history(run or self.carried[0], tuple(self.equations), self.delays)
        start = np.zeros(count) if x0 is None else np.asarray(x0, dtype=float)
        if start.shape != (count,):
            raise InputError(f"x0 has shape {start.shape}; give {count} start states")

        def before(t: np.ndarray) -> np.ndarray:
            given = start[:, None] if history is None else history(t)
            return np.broadcast_to(np.asarray(given, dtype=float), (count, len(t)))

        own = {name for name, delay in self.delays.items() if delay.state in self.equations}
        others = {name: value for name, value in inputs.items() if name not in own}
        return follow(self.equations, self.delays, before, times, others, engine or self.engine)

    def _as_held(self, inputs: Mapping[str, Any], times: np.ndarray) -> dict[str, Any]:
        """Give inputs; what is given at the times themselves is taken as the data were."""
        return {
            name: Measured(name, times, sample_input(name, value, times), self.hold[name])
            if name in self.hold and is_sampled(value)
            else value
            for name, value in inputs.items()
        }

    def _with_delayed(self, inputs: Mapping[str, Any], times: np.ndarray) -> dict[str, Any]:
        """Give inputs with those that are delayed, as they were before.

        Raises InputError where neither they nor the data say what they were before.
        """
        found = self._as_held(inputs, times)
        for column, delay in self.delays.items():
            if (value := found.get(delay.state)) is None or column in found:
                continue
            if is_sampled(value):
                values = sample_input(delay.state, value, times)
                value = Measured(delay.state, times, values, self.hold.get(column))
            if isinstance(value, Measured):
                value = replace(value, past=value.past or self._past_of(delay.state, column))
                begin = float(times[0]) - delay.value
                if not value.is_known_from(begin):
                    raise InputError(
                        f"{column!r} is {delay.state!r} {delay.value:g} before, and nothing says "
                        f"what {delay.state!r} was from t = {begin:g} on; give it as an expression "
                        "or a function of the time"
                    )
            found[column] = put_off(value, delay.value, column)
        return found

    def _past_of(self, name: str, column: str) -> Measured | None:
        """Give an input as it was in the first run; its delayed column has its first values."""
        past = None
        for run in self.carried[:1]:
            for own, later in ((column, self.delays[column].value), (name, 0.0)):
                if own in run.input_names:
                    values = run.inputs[:, run.input_names.index(own)]
                    past = Measured(name, run.t - later, values, run.held(own), past)
        return past

    @cached_property
    def carried(self) -> tuple[Trajectory, ...]:
        """The data, in which a state is on its curve where it was not measured.

        Its start is that of the equations.
        """
        return tuple(self._carry(self.trajectories)) if self.trajectories else ()

    def _carry(self, runs: Sequence[Trajectory]) -> list[Trajectory]:
        """Give runs whose empty cells are on curves, and whose starts follow the equations."""
        carried = carry(runs)
        if self.is_map or self.delays or self.diffusion or self.hidden or self.free.curves:
            return carried
        known = self._known_inputs(carried)
        needed = {*self.equations, *arguments_of(self.equations)} - set(known)
        if not needed <= set(carried[0].names):
            return carried
        rows = self._settings(ComparisonSettings, "selection", "comparison").rows
        made = {s: own for s, own in form_of(self.settings).known.items() if own.is_Symbol}
        return fit_starts(carried, self.equations, known, made, rows)

    @property
    def hold(self) -> dict[str, Hold]:
        """Measured input -> what it did between rows: "previous", "linear" or "smooth"."""
        given = self.settings.get("hold")
        # A saved discovery may come from anyone.
        return check_hold(given, list(given)) if isinstance(given, Mapping) else {}

    def _positions(self) -> list[int]:
        return [self.trajectories[0].index(state) for state in self.equations]

    def inputs_of(self, run: Trajectory | None = None) -> dict[str, Any]:
        """Inputs as they were in a ``run``, by default the first, as :func:`predict` takes them.

        States without an equation are read from there too. An input that is known as an expression
        in ``t`` is that, unless the run measured another one.
        """
        # All runs together say enough of a state, one of them may be short.
        source = carry([run])[0] if run else next(iter(self.carried), None)
        given: dict[str, Any] = self._known_inputs([] if source is None else [source])
        for name in arguments_of(self.equations):
            if name not in given and source is not None and name in source.names:
                column = source.columns[:, source.names.index(name)]
                given[name] = Measured(name, source.t, column, source.held(name))
        return given

    def _known_inputs(self, runs: Sequence[Trajectory]) -> dict[str, sympy.Expr]:
        """Inputs as expressions in ``t``, without those of which a run measured other values."""
        return {
            name: expr
            for name, expr in self.inputs.items()
            if all(_agrees(run, name, expr) for run in runs)
        }

    def _still(
        self, inputs: Mapping[str, float] | None, t: float | None
    ) -> tuple[dict[str, sympy.Expr], dict[str, float]]:
        """Give the equations without inputs, and the value of each input.

        A measured input is its mean, and one that is a formula what it is at the time.
        """
        held: dict[str, float] = {}
        for name in arguments_of(self.equations):
            given = (inputs or {}).get(name)
            formula = self.inputs.get(name)
            columns = [run.columns[:, run.names.index(name)] for run in self.trajectories]
            if given is not None:
                held[name] = float(given)
            elif formula is not None and (t is not None or not formula.free_symbols):
                held[name] = float(evaluate(formula, {"t": np.asarray(t or 0.0)}))
            elif formula is None and columns:
                held[name] = float(np.nanmean(np.concatenate(columns)))
            else:
                raise InputError(f"nothing says what {name!r} is; give inputs={{{name!r}: value}}")
        if unknown := [name for name in inputs or {} if name not in held]:
            raise InputError(f"the equations have no input {unknown[0]!r}; leave it out")
        put = {sympy.Symbol(name): sympy.Float(value) for name, value in held.items()}
        if t is not None:
            put[sympy.Symbol("t")] = sympy.Float(float(t))
        return {s: e.xreplace(put) for s, e in self.equations.items()}, held

    def linearise(
        self,
        at: Mapping[str, float] | Sequence[float] | FixedPoint,
        inputs: Mapping[str, float] | None = None,
        t: float = 0.0,
    ) -> Linearisation:
        """Linearise the equations at a point: the slope of a small deviation x is A x + B u.

        Parameters
        ----------
        at : state -> value, values in the order of the equations, or a fixed point.
        inputs : input -> value; by default the mean of what was measured, or the formula's value.
        t : the time, where the equations or an input contain it.

        Raises InputError when a value is missing or the equations have no slope there.

        >>> x, u = sympy.symbols("x u")
        >>> found = Discovery({"x": u - x**2}, {}, {}, {})
        >>> near = found.linearise([1.0], {"u": 1.0})
        >>> near.A.tolist(), near.B.tolist(), near.eigenvalues.tolist()
        ([[-2.0]], [[1.0]], [-2.0])
        """
        if isinstance(at, FixedPoint):
            at = at.at
        if not isinstance(at, Mapping):
            if len(at) != len(self.equations):
                raise InputError(f"the point has {len(at)} values; give {len(self.equations)}")
            at = dict(zip(self.equations, map(float, at), strict=True))
        _, held = self._still(inputs, t)
        return linearise(self.equations, at, held, t)

    @property
    def _box(self) -> dict[str, tuple[float, float]]:
        """Give the span of each state in the data; -1 to 1 where they are not there."""
        if not self.trajectories:
            return dict.fromkeys(self.equations, (-1.0, 1.0))
        x = np.concatenate([run.x[:, self._positions()] for run in self.trajectories])
        ends = zip(np.nanmin(x, axis=0), np.nanmax(x, axis=0), strict=True)
        return {s: (float(a), float(b)) for s, (a, b) in zip(self.equations, ends, strict=True)}

    def fixed_points(
        self,
        inputs: Mapping[str, float] | None = None,
        t: float | None = None,
        box: Mapping[str, tuple[float, float]] | None = None,
    ) -> tuple[FixedPoint, ...]:
        """Find the fixed points of the equations, and whether they are stable.

        Parameters
        ----------
        inputs : input -> value, as in :meth:`linearise`.
        t : the time, where the equations or an input contain it.
        box : state -> (low, high) of the search, and half as much on either side; by default
            where the data are.

        Raises InputError when the equations contain a time or an input that is not given.

        >>> x = sympy.Symbol("x")
        >>> found = Discovery({"x": x - 4 * x**3}, {}, {}, {})
        >>> [point.text for point in found.fixed_points()]
        ['x = -0.5: stable node', 'x = 0: unstable node', 'x = 0.5: stable node']
        """
        if inputs is None and t is None and not box:
            return self._fixed_points
        still, _ = self._still(inputs, t)
        return find_fixed_points(still, {**self._box, **(box or {})}, self.is_map)

    @cached_property
    def _fixed_points(self) -> tuple[FixedPoint, ...]:
        # A report asks for them three times.
        return find_fixed_points(self._still(None, None)[0], self._box, self.is_map)

    def bifurcation(
        self,
        parameter: str,
        values: Sequence[float] | np.ndarray,
        inputs: Mapping[str, float] | None = None,
        box: Mapping[str, tuple[float, float]] | None = None,
    ) -> Branches:
        """Follow the fixed points along a parameter; cycles are not followed.

        Parameters
        ----------
        parameter : its name, of :attr:`parameters`.
        values : its values, in order.
        inputs, box : as in :meth:`fixed_points`.

        Raises InputError when there is no such parameter.

        >>> x = sympy.Symbol("x")
        >>> found = Discovery({"x": x / 4 - x**3}, {}, {}, {})
        >>> found.bifurcation("k2", [0.1, 0.3]).changes()
        []
        """
        check_values(dict.fromkeys([parameter], 0.0), self.parameters)
        _, held = self._still(inputs, None)
        system = self.system
        rest = {n: v for n, v in {**system.parameters.numbers, **held}.items() if n != parameter}
        put = {sympy.Symbol(n): sympy.Float(v) for n, v in rest.items()}
        equations = {s: e.xreplace(put) for s, e in system.equations.items()}
        order = np.asarray(values, dtype=float)
        return follow_parameter(
            equations, parameter, order, {**self._box, **(box or {})}, self.is_map
        )

    def phase_portrait(
        self, inputs: Mapping[str, float] | None = None, t: float | None = None
    ) -> Figure:
        """Draw the flow of two states: directions, nullclines, fixed points and the data.

        Parameters
        ----------
        inputs, t : as in :meth:`fixed_points`.

        Raises InputError when there are not two states or the equations are a map.
        """
        from dynsr.report import draw_flow

        if len(self.equations) != 2 or self.is_map:
            raise InputError("a phase portrait draws the flow of two states; these are others")
        still, _ = self._still(inputs, t)
        return draw_flow(still, self._box, self.fixed_points(inputs, t), self.trajectories)

    def score(
        self,
        data: Any = None,
        engine: str | AbstractEngine | None = None,
        hold: Mapping[str, str] | str | None = None,
    ) -> dict[str, dict[str, float]]:
        """Score on data (the data of the discovery by default), each state that was measured.

        ``slope_rmse`` is the error of the right-hand side against the chosen slopes,
        ``forecast`` the median miss of forecasts over 50 rows in units of the state's spread,
        ``trajectory_rmse`` the error of one integration from the first row to the last (inf when
        it diverges). Inputs are those of the data: a column of the data goes before the expression
        of the discovery. A map is scored by :func:`dynsr.verdict.maps.score_map`, and steps with
        noise in the motion by :func:`dynsr.parameters.diffusion.score_steps`.

        Parameters
        ----------
        data : what :func:`dynsr.discover` takes.
        engine : what integrates the whole trajectories; the discovery's own by default. The many
            short forecasts are integrated by the embedded one.
        hold : input -> what it does between rows, or one word for all; by default what it did in
            the data of the discovery.

        Raises InputError when there are no data or a map is given an engine other than the embedded
        one, EngineUnavailable when the engine is absent.
        """
        chosen = find_engine(engine or self.engine)
        if self.is_map:
            refuse_idle(engine, "a map is iterated")
        runs = self._runs(data, hold)
        if self.is_map:
            return ByState(score_map(self.equations, runs))
        if self.diffusion:
            self._need_columns(runs)
            return ByState(score_steps(self.steps_of(runs)))
        form = form_of(self.settings)
        runs = self._carry(form.prepare(carry(runs)))
        self._need_columns(runs)
        whole = [self._whole(run, chosen) for run in runs]
        known, scores = self._known_inputs(runs), ByState[dict[str, float]]()
        for state, expr in self.equations.items():
            if state in self.hidden:
                continue
            samples = form.samples(runs, state)
            truth = np.concatenate([run.observed[:, run.index(state)] for run in runs])
            position = list(self.equations).index(state)
            scores[state] = {
                "slope_rmse": rmse(evaluate(expr, samples.timed), samples.y),
                "forecast": forecast_error({state: expr}, runs, inputs=known),
                "trajectory_rmse": rmse(np.concatenate([w[:, position] for w in whole]), truth),
            }
        return scores

    def steps_of(self, runs: Sequence[Trajectory] = ()) -> StochasticFit:
        """Give the steps of rows with the equations, where these have noise in the motion.

        Parameters
        ----------
        runs : trajectories; by default those of the discovery.
        """
        some = list(runs) or self._runs(None)
        return measure_steps(self.equations, self.diffusion, some, self._known_inputs(some))

    def _runs(self, data: Any, hold: Mapping[str, str] | str | None = None) -> list[Trajectory]:
        """Give trajectories in the unit and with the inputs of the discovery; its own for None."""
        runs = list(self.trajectories) if data is None else self._read(data)
        if not runs:
            raise InputError("the data are not here; give some")
        own = {n: way for n, way in self.hold.items() if n in runs[0].input_names}
        asked = check_hold(hold, runs[0].input_names)
        found = self._by_name(in_unit(decide_hold(runs, {**own, **asked}), self.time_unit))
        rows = self._settings(ComparisonSettings, "selection", "comparison").rows
        for name, term in self.hidden.items():
            if name not in found[0].names:
                known = self._known_inputs(found)
                found = estimate_hidden(found, name, term, self.equations, known, rows)
        return found

    def _by_name(self, runs: list[Trajectory]) -> list[Trajectory]:
        """Give runs their delayed columns, and parameters that differ as in runs of their name.

        Raises InputError where parameters differ and runs have other names.
        """
        if self.delays and not set(self.delays) <= set(runs[0].names):
            delay = max(own.value for own in self.delays.values())
            settings = self._settings(DelaySettings, "delays")
            runs = Delayed.of(runs, settings).columns(delay, delay)
        own = self.by_run
        if not own.constants or set(own.constants) <= set(runs[0].names):
            return runs
        plain = own.runs if len(runs) == len(own.runs) else [""] * len(runs)
        names = [run.origin.get("name", name) for run, name in zip(runs, plain, strict=True)]
        if not set(names) <= set(own.runs):
            raise InputError(
                f"{', '.join(own.constants)} differ from run to run, and these runs are others; "
                "give columns of these names, or ask for_run(NAME)"
            )
        return [run.with_inputs(own.numbers(name)) for run, name in zip(runs, names, strict=True)]

    def _need_columns(self, runs: Sequence[Trajectory]) -> None:
        if missing := [n for n in arguments_of(self.equations) if n not in runs[0].names]:
            raise InputError(
                f"the equations need the input {missing[0]!r}, which the data do not have; "
                "give its column"
            )

    @property
    def columns_asked(self) -> dict[str, list[str]]:
        """The states and inputs of the table that was searched; {} where there was none."""
        table = self.settings.get("table")
        if not isinstance(table, Mapping):
            return {}
        formulas = table.get("formulas", {})
        inputs = [*table.get("inputs", ()), *table.get("parameters", ())]
        return {
            "states": list(map(str, table.get("states", ()))),
            "inputs": [str(name) for name in inputs if name not in formulas],
        }

    @property
    def doses(self) -> dict[str, str]:
        """State -> the column of the amounts by which it jumped; {} where there were none."""
        given = self.settings.get("doses")
        return {str(s): str(own) for s, own in given.items()} if isinstance(given, Mapping) else {}

    def _take(self, data: Any) -> list[Trajectory]:
        """Read data with the roles of columns in the search, where their names agree."""
        asked = self.columns_asked
        table = isinstance(data, (str, Path, Mapping)) or hasattr(data, "columns")
        if asked and table and not isinstance(data, Trajectory):
            formulas = [f"{name}={to_text(expr)}" for name, expr in self.inputs.items()]
            inputs = [*asked["inputs"], *formulas]
            # Other data may have no doses, or other columns.
            for doses in dict.fromkeys((tuple(self.doses.items()), ())):
                with suppress(InputError):
                    return take_trajectories(
                        data, inputs, states=asked["states"], doses=dict(doses) or None
                    )[0]
        return take_trajectories(data, self.inputs)[0]

    def _read(self, data: Any) -> list[Trajectory]:
        """Read other data, cut at doses as those of the discovery were."""
        runs, given = self._take(data), self.doses
        observed = self.settings.get("observed")
        if isinstance(observed, Mapping) and set(observed) <= set(runs[0].states):
            runs = read_sums(runs, observed)
        # Trajectories of the discovery itself are cut already.
        if given and {split_volume(own)[0] for own in given.values()} <= set(runs[0].names):
            return cut_at_doses(runs, given)
        return runs

    def _whole(self, run: Trajectory, engine: AbstractEngine) -> np.ndarray:
        start = [run.x[0, run.index(state)] for state in self.equations]
        try:
            if self.delays:
                return self._follow(None, run.t, self.inputs_of(run), engine, None, run).x
            return predict(self.equations, start, run.t, self.inputs_of(run), engine).x
        except EngineUnavailable:
            raise
        except EngineError:
            return np.full((len(run), len(self.equations)), np.nan)

    def latex(self, *, names: bool = False) -> str:
        r"""Write the equations as LaTeX.

        Parameters
        ----------
        names : whether there are parameters in the place of numbers, with a table of their values.

        >>> x = sympy.Symbol("x")
        >>> print(Discovery({"x": -2 * x}, {"x": ()}, {}, {}).latex(names=True))
        \begin{aligned}
        \dot{x} &= - k_{1} x
        \end{aligned}
        <BLANKLINE>
        \begin{tabular}{lrrl}
        parameter & value & standard error & 95\% interval \\
        \hline
        $k_{1}$ & 2 & unknown & unknown \\
        \end{tabular}
        """
        if not names:
            return self._write_latex(self.equations, self.time_unit)
        system = self.system
        text = self._write_latex(system.equations, self.time_unit, system.parameters)
        return f"{text}\n\n{system.parameters.to_latex()}"

    def to_latex(self, *, names: bool = False) -> str:
        """Write the equations as LaTeX, as :meth:`latex` does.

        Parameters
        ----------
        names : whether there are parameters in the place of numbers, with a table of their values.
        """
        return self.latex(names=names)

    def to_sympy(self) -> dict[str, sympy.Expr]:
        """Give state -> right-hand side (SymPy), to change at will.

        >>> x = sympy.Symbol("x")
        >>> Discovery({"x": -2 * x}, {"x": ()}, {}, {}).to_sympy()
        {'x': -2*x}
        """
        return dict(self.equations)

    def export(self, format: str, path: str | Path | None = None, *, force: bool = False) -> str:  # noqa: A002
        """Write the equations with named parameters for another tool; gives the text.

        Parameters
        ----------
        format : "python", "torch", "jax", "c", "fortran", "matlab", "r", "julia",
            "modelingtoolkit", "catalyst", "modelica", "sbml", "petab", "casadi", "control",
            "do-mpc", "latex", "mathml", "markdown" or "bibtex".
        path : the file to write as well, a folder for "petab".
        force : whether files that are there are replaced.

        Raises InputError when there is no such format, it cannot express these equations, or a file
        is there; MissingExtra when what writes it is not installed.

        >>> x = sympy.Symbol("x")
        >>> print(Discovery({"x": -2 * x}, {"x": ()}, {}, {}).export("catalyst").splitlines()[-5])
            k1, x --> ∅
        """
        from dynsr.export import Source, save_format, write_format

        if path is None:
            return write_format(Source.of(self), format)
        return save_format(Source.of(self), format, Path(path), force)[-1].read_text("utf-8")

    def cite(self) -> str:
        """Give BibTeX of dynsr, of the methods that ran, of the score and of what integrated.

        >>> x = sympy.Symbol("x")
        >>> print(Discovery({"x": -2 * x}, {"x": ()}, {}, {}).cite()[:16])
        @software{dynsr,
        """
        return self.export("bibtex")

    def to_python(self) -> str:
        """Write the equations with their numbers as a Python function for ``solve_ivp``.

        Inputs are taken as in :meth:`to_numpy`; ``export("python")`` is the same with named
        parameters.

        Of a map it is ``step(t, state)``, which gives the next state.
        """
        return self._write_numbers("python")

    def to_numpy(self) -> Callable[..., np.ndarray]:
        """Give the right-hand side as a function ``rhs(t, state, inputs...)`` of arrays.

        An input is a function of the time or its value there, by its place, in the order of the
        alphabet, or by name; :meth:`to_python` and :meth:`to_torch` take it alike, and
        :meth:`to_julia` in the named tuple ``p``.
        """
        return to_numpy(self.equations)

    def to_julia(self) -> str:
        """Write the equations with their numbers as a Julia function for DifferentialEquations.jl.

        Inputs are functions of the time, or numbers, in the named tuple ``p``;
        ``export("julia")`` is the same with named parameters.

        Of a map it is ``step!(du, u, p, t)`` for a ``DiscreteProblem``.
        """
        return self._write_numbers("julia")

    def _write_numbers(self, format: str) -> str:  # noqa: A002
        from dynsr.export import Source, write_format

        return write_format(Source.of(self).in_numbers, format)

    def to_torch(self) -> EquationModule:
        """Give the right-hand side as a torch module whose constants can be trained.

        Raises MissingExtra when torch is not installed.
        """
        need("torch", "torch", "a torch module")
        from dynsr.discovery.hybrid import EquationModule

        return EquationModule({s: write_out(e) for s, e in self.equations.items()})

    def to_casadi(self) -> Any:
        """Give the equations as a ``casadi.Function`` of ``t``, ``x``, ``u`` and ``p``.

        ``u`` are the inputs that were measured, in the order of the alphabet, and ``p`` the
        parameters in the order of :attr:`parameters`. Of a map it gives the next state.

        Raises MissingExtra when CasADi is not installed.
        """
        from dynsr.export import Source, make_casadi

        return make_casadi(Source.of(self).written_out)

    def to_control(self) -> Any:
        """Give the equations as a ``control.nlsys`` with named states, inputs and parameters.

        Its outputs are the states. Of a map it is a system in discrete time.

        Raises MissingExtra when python-control is not installed.
        """
        from dynsr.export import Source, make_control

        return make_control(Source.of(self).written_out)

    def to_do_mpc(self) -> Any:
        """Give the equations as a ``do_mpc.model.Model`` that is set up.

        The time, where equations hold it, is one more state; ``export("do-mpc")`` writes a
        simulator and a controller too.

        Raises MissingExtra when do-mpc is not installed.
        """
        from dynsr.export import Source, make_do_mpc

        return make_do_mpc(Source.of(self).written_out)

    def hybrid(
        self, *, width: int = 32, epochs: int = 400, rate: float = 0.01, seed: int = 0
    ) -> HybridModel:
        """Train networks on the residuals of the slopes.

        Parameters
        ----------
        width, epochs, rate, seed : neurons in each hidden layer, passes over the samples, rate of
            Adam at the start, and what all chance comes from.

        Raises InputError when the data are not there, MissingExtra when torch is not installed.
        """
        if self.is_map:
            raise InputError("a hybrid model corrects slopes; a map has none")
        refuse_hidden(self.hidden, "a hybrid model corrects slopes")
        need("torch", "torch", "a hybrid model")
        from dynsr.discovery.hybrid import fit_hybrid

        return fit_hybrid(
            self.equations,
            self.trajectories,
            self.inputs,
            width=width,
            epochs=epochs,
            rate=rate,
            seed=seed,
        )

    def plot(self) -> Figure:
        """Draw the data and the equations integrated from their start; gives the figure.

        Of equations with noise in the motion it is one path, with the band of 95 % of them.
        """
        from dynsr.report import draw_states

        if not self.trajectories:
            raise InputError("the data are not here; discover again before plotting")
        if self.diffusion:
            return draw_states(self.trajectories[0], *self.path_and_band())
        return draw_states(self.trajectories[0], self.simulate())

    def report(self, path: str | Path) -> Path:
        """Write one self-contained HTML page to ``path``; gives the path."""
        from dynsr.report import write_report

        return write_report(self, Path(path))

    def save(self, path: str | Path) -> Path:
        """Write everything but the data as JSON, whole or not at all; gives the path.

        Raises InputError when it cannot be written, or a file that is no discovery is there.
        """
        return write_discovery(Path(path), self.as_record())

    def as_record(self) -> dict[str, Any]:
        """Give everything but the data as plain values."""
        return {
            "format": FORMAT,
            "equations": {s: to_text(e) for s, e in self.equations.items()},
            "errors": {s: [list(pair) for pair in pairs] for s, pairs in self.errors.items()},
            "fitted": {s: list(values) for s, values in self.fitted.items()},
            "reach": self.reach,
            "front": {
                s: [[to_text(c.expr), c.loss, c.complexity, c.source] for c in front]
                for s, front in self.front.items()
            },
            "explanation": dict(self.explanation),
            "inputs": {name: to_text(e) for name, e in self.inputs.items()},
            "settings": dict(self.settings),
            "seconds": self.seconds,
            "complete": self.complete,
            "verdict": to_plain(self.verdict) if self.verdict.tested else None,
            "details": dict(self.details),
            **({"summary": to_plain(kept)} if (kept := self._summarise()) else {}),
            **({"by_run": to_plain(self.by_run)} if self.by_run.runs else {}),
            **{name: to_plain(own) for name in _OPTIONAL if (own := getattr(self, name))},
        }

    @classmethod
    def load(cls, path: str | Path) -> Discovery:
        """Read a discovery that was saved; nothing in it is ever run.

        Parameters
        ----------
        path : the JSON file, or the folder that ``discover(..., out=...)`` kept it in.

        Its data come with it where they are next to it, as ``discover(..., out=...)`` keeps them.
        A table that was changed since is left out, with a warning. Raises InputError when there is
        no such file or it holds something else.
        """
        further = {
            "fitted": dict[str, tuple[float, ...]],
            "reach": float,
            "details": dict[str, str],
            "ensemble": dict[str, tuple[Inclusion, ...]],
            "parameter_names": dict[str, tuple[str, ...]],
            "profiled": dict[str, tuple[Ends | None, ...]],
            "summary": DataSummary,
            "by_run": RunParameters,
            "delays": dict[str, Delay],
            "volumes": dict[str, Parameter],
            "free": FreeParts,
            "diffusion": dict[str, Diffusion],
            "data": KeptData,
        }
        place = Path(path)
        place = place / RECORD if place.is_dir() else place
        fields = read_discovery(place, _functions_of, **further, verdict=Verdict | None)
        runs = _read_data(place, fields.pop("data", None))
        return cls(**{**fields, "verdict": fields.get("verdict") or NOBODY, "trajectories": runs})

    def __repr__(self) -> str:
        """Write the verdict, and below it the equations, one per line."""
        lines = write_lines(self.equations, self.settings)
        more = [*(part.text for part in self.free.parts.values()), *self.noise_notes.values()]
        return "\n".join([self.heading, *lines, *more])

    def _repr_latex_(self) -> str:
        return f"$$\n{self._write_latex(self.equations)}\n$$"

    def _write_latex(
        self, equations: Mapping[str, sympy.Expr], time_unit: str = "", first: Collection[str] = ()
    ) -> str:
        if self.is_map:
            return write_map_latex(equations, first)
        return to_latex(equations, time_unit, first)

    def _repr_html_(self) -> str:
        rows = "".join(
            f'<tr><td style="text-align:left">${escape(self._latex_line(s))}$'
            f"<br><code>{escape(write_line(s, e, self.is_map), quote=False)}</code>"
            f'</td><td style="text-align:left">{escape(self._said_of(s))}</td>'
            f'<td style="text-align:left">{escape(self.explanation.get(s, ""))}</td></tr>'
            for s, e in self.equations.items()
        )
        unit = f"<p>The time is in {escape(self.time_unit)}.</p>" if self.time_unit else ""
        return (
            f"<p><b>{escape(self.heading)}</b></p><table><tr><th>equation</th>"
            f"<th>constants</th><th>why</th></tr>{rows}</table>{unit}"
        )

    def _latex_line(self, state: str) -> str:
        """Write the equation of one state as LaTeX within a line."""
        block = self._write_latex({state: self.equations[state]})
        return r"\displaystyle " + block.splitlines()[1].replace(" &= ", " = ")

    @property
    def heading(self) -> str:
        """The verdict on the system in one sentence."""
        so_far = "" if self.complete else "The search was interrupted; the best so far. "
        if not self.verdict.tested:
            return f"{so_far}No verdict."
        return f"{so_far}{self.verdict.level.capitalize()}: {self.verdict.reason}"

    def _said_of(self, state: str) -> str:
        named = zip(self.constant_names[state], self.constants[state], strict=True)
        return "; ".join(f"{name} = {constant.text}" for name, constant in named)

    def __rich__(self) -> RichTable:
        """Give a table for rich terminals."""
        from rich.table import Table
        from rich.text import Text

        names = ("state", "equation", "constants", "why")
        table = Table(*names, title=Text(self.heading), show_lines=True)
        for state, expr in self.equations.items():
            why = Text(self.explanation.get(state, ""), style="dim")
            said = Text(self._said_of(state))
            table.add_row(Text(f"{state}'"), Text(shown(expr), style="bold"), said, why)
        return table


def with_profiles(found: Discovery, settings: ProfileSettings) -> Discovery:
    """Give a discovery whose intervals are those of profiles where others are wrong.

    Slopes of exact data leave no doubt of the parabola, and what is no equation of the data has no
    constants to be sure of: those stay as they are.
    """
    judged = found.verdict.tested and found.verdict.level != NOT_FOUND
    if (
        found.by_run.runs
        or not (found.complete and judged)
        or found.is_map
        or found.diffusion
        or not is_noisy(found.measured)
    ):
        return found
    try:
        return found.with_profiles(settings)
    except (InputError, KeyboardInterrupt):
        # The search is over, and what it found is not lost.
        return found


def keep(found: Discovery, folder: Path) -> list[Path]:
    """Save a discovery in a folder and give the file; one cut short replaces no complete one.

    Its data are saved next to it unless they are very many, so that the folder is all that later
    steps need.

    Parameters
    ----------
    found : the discovery.
    folder : the folder of :data:`RECORD` and :data:`dynsr.data.DATA`.

    Raises InputError when a file cannot be written, or one is there that dynsr did not write.
    """
    saved = folder / RECORD
    if not found.complete and _is_complete(saved):
        return []
    written = write_kept(found.trajectories)
    if written is None:
        return [found.save(saved)]
    text, kept = written
    table, same = folder / DATA, text.encode()
    # Before a record is written that no longer says what this file was.
    check_replaceable(table, lambda content: content == same or is_own_data(folder)(content))
    write_discovery(saved, {**found.as_record(), "data": to_plain(kept, whole=False)})
    write_own(table, text, lambda _: True)
    return [saved, table]


def is_own_data(folder: Path) -> Callable[[bytes], bool]:
    """Give what knows the content of the data that :func:`keep` saved in a folder.

    Parameters
    ----------
    folder : that of the discovery.
    """

    def is_own(content: bytes) -> bool:
        try:
            return bool(read_json(folder / RECORD)["data"]["sha256"] == digest(content))
        except (RecordError, LookupError, TypeError):
            return False

    return is_own


def _read_data(path: Path, kept: KeptData | None) -> tuple[Trajectory, ...]:
    """Give the data of a saved discovery; none where no table or another one is next to it."""
    table = path.parent / DATA
    if kept is None or not table.is_file():
        return ()
    content = table.read_bytes()
    if digest(content) != kept.sha256:
        said = f"{str(table)!r} was changed since it was saved and is left out; give the data again"
        warnings.warn(said, DynsrWarning, stacklevel=4)
        return ()
    return read_kept(content, kept)


def with_words(found: Discovery, words: str | Mapping[str, str], **record: Any) -> Discovery:
    """Give a discovery that says more of its equations, in their explanations and in its record.

    Parameters
    ----------
    found : the discovery.
    words : what the explanation of every state ends in; or state -> what its own does.
    record : what is added to its settings, by name.
    """
    own = words if isinstance(words, Mapping) else dict.fromkeys(found.explanation, words)
    said = {state: why + own.get(state, "") for state, why in found.explanation.items()}
    return replace(found, explanation=said, settings={**found.settings, **record})


def ended_early(found: Discovery, steps: Sequence[str], words: str = "") -> Discovery:
    """Give a discovery whose record says which steps a time budget ended.

    Parameters
    ----------
    found, words : as for :func:`with_words`.
    steps : their names.
    """
    ended = [*found.settings.get("ended_by_budget", ()), *steps]
    return with_words(found, words, ended_by_budget=ended)


def keep_if_asked(found: Discovery, out: Any) -> None:
    """Save a discovery in the folder that was asked for, where that can be done.

    What was found is not lost where it cannot be kept.

    Parameters
    ----------
    found : the discovery.
    out : the folder; None where none was asked for.
    """
    if out is not None:
        with suppress(InputError, OSError):
            keep(found, Path(out).absolute())


def _is_complete(path: Path) -> bool:
    try:
        return Discovery.load(path).complete
    except InputError:
        return False


@checked
def load(path: str | Path) -> Discovery:
    """Read a saved discovery, as :meth:`Discovery.load` does; nothing in it is ever run.

    Parameters
    ----------
    path : the JSON file, or the folder that ``discover(..., out=...)`` kept it in.

    Raises InputError when there is no such file or it holds something else.

    >>> load("nowhere.json")
    Traceback (most recent call last):
    ...
    dynsr.errors.InputError: ...
    """
    return Discovery.load(path)


def _functions_of(fields: Mapping[str, Any]) -> dict[str, Callable[..., sympy.Expr]]:
    """Give the functions of equations that no table has: name -> the curve."""
    free = fields.get("free", FreeParts())
    return {name: part.curve.function for name, part in free.curves.items()}


def _agrees(run: Trajectory, name: str, expr: sympy.Expr) -> bool:
    """Say whether a run has no column of that name, or the values of the expression."""
    if name not in run.names:
        return True
    column = run.columns[:, run.names.index(name)]
    miss = np.abs(column - evaluate(expr, {"t": run.t}))
    return bool(np.all(miss <= _ROUNDED * np.max(np.abs(column), initial=0.0)))
